from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, cKDTree

from dream.sim.wrecks import Wreck, wreck
from dream.sim.wrecks.hull import HullForm
from dream.sim.wrecks.paint import RUST
from dream.sim.wrecks.patches import individuals
from dream.sim.wrecks.shapes import Part, beam, box, inside_out, resample, rounded, turn

Array = npt.NDArray[np.float64]

NUMBERS = (1, 2, 3, 4, 5)
STEEL = (1, 2, 3, 4)
FORM = HullForm(
    length=15.0,
    beam=5.0,
    depth=3.4,
    sheer_fore=1.0,
    sheer_aft=0.3,
    bulwark=0.8,
    entrance=4.5,
    run=3.0,
    rake=0.8,
    overhang=1.2,
)


@cache
def built(number: int) -> Wreck:
    return wreck(number, np.random.default_rng(7))


@cache
def corners(found: Wreck) -> Array:
    """(F, 3, 3) all triangles."""
    return np.concatenate([mesh.vertices[mesh.faces] for mesh in found.meshes]).astype(np.float64)


def areas(triangles: Array) -> Array:
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def middles(found: Wreck) -> Array:
    return np.array([mesh.vertices.mean(axis=0, dtype=np.float64) for mesh in found.meshes])


def tops(found: Wreck) -> Array:
    return np.array([float(mesh.vertices[:, 2].max()) for mesh in found.meshes])


def volume(part: Part) -> float:
    """Enclosed by a closed surface that is counter-clockwise from outside."""
    a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def islands(found: Wreck, chosen: npt.NDArray[np.intp], gap: float) -> list[int]:
    """Sizes of the sets of patches that hang together within a gap, largest first."""
    points = np.concatenate([found.meshes[i].vertices for i in chosen])
    owner = np.repeat(np.arange(len(chosen)), [len(found.meshes[i].vertices) for i in chosen])
    pairs = owner[cKDTree(points).query_pairs(gap, output_type="ndarray")]
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(chosen),) * 2)
    return sorted(np.bincount(connected_components(links, directed=False)[1]).tolist(), reverse=True)


def edges(found: Wreck) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The edges (E, 2, 3) in millimetres, and in how many triangles each is."""
    millimetres = np.rint(corners(found) * 1000).astype(np.int64).reshape(-1, 3)
    key = (millimetres + 50_000) @ np.array([1 << 40, 1 << 20, 1])
    places, first, index = np.unique(key, return_index=True, return_inverse=True)
    triangles = index.reshape(-1, 3)
    sides = np.sort(np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    pairs, counts = np.unique(sides[:, 0] * len(places) + sides[:, 1], return_counts=True)
    return millimetres[first][np.stack(np.divmod(pairs, len(places)), axis=1)], counts


@pytest.mark.few(3)
@pytest.mark.parametrize("number", NUMBERS)
def test_what_stands_is_12_to_25_metres_long_and_lies_about_the_origin(number: int) -> None:
    found = built(number)
    standing = np.concatenate([m.vertices[m.vertices[:, 2] > 0.7] for m in found.meshes]).astype(np.float64)
    axis = np.linalg.svd(standing[:, :2] - standing[:, :2].mean(axis=0), full_matrices=False)[2][0]
    assert 12.0 <= np.ptp(standing[:, :2] @ axis) <= 25.0
    assert abs(axis[0]) > 0.85
    everything = corners(found).reshape(-1, 3)
    low, high = everything.min(axis=0), everything.max(axis=0)
    assert np.abs(low + high)[:2].max() < 0.3
    assert np.hypot(everything[:, 0], everything[:, 1]).max() == pytest.approx(found.radius, abs=1e-5)
    assert found.radius < 16.0


@pytest.mark.parametrize("number", NUMBERS)
def test_an_individual_is_a_patch_of_about_half_a_metre(number: int) -> None:
    found = built(number)
    widths = np.array(
        [np.linalg.norm(m.vertices[:, None] - m.vertices[None], axis=2).max() for m in found.meshes]
    )
    surface = np.array([areas(m.vertices[m.faces].astype(np.float64)).sum() for m in found.meshes])
    assert widths.max() <= 0.901
    assert np.mean((widths > 0.4) & (widths < 0.85)) > 0.85
    assert 0.15 < np.median(surface) < 0.45
    assert np.mean(surface < 0.05) < 0.01
    assert 700 <= len(found.meshes) <= 2500
    assert sum(len(mesh.faces) for mesh in found.meshes) <= 25_000
    assert max(len(mesh.faces) for mesh in found.meshes) <= 40


@pytest.mark.parametrize("number", NUMBERS)
def test_meshes_are_sound(number: int) -> None:
    for mesh in built(number).meshes:
        assert [array.dtype.str for array in (mesh.vertices, mesh.faces, mesh.colors)] == [
            "<f4",
            "<i4",
            "|u1",
        ]
        assert mesh.colors.shape == mesh.vertices.shape
        assert np.isfinite(mesh.vertices).all()
        assert set(mesh.faces.ravel().tolist()) == set(range(len(mesh.vertices)))
        assert areas(mesh.vertices[mesh.faces].astype(np.float64)).min() > 1e-5
        assert len(np.unique(np.sort(mesh.faces, axis=1), axis=0)) == len(mesh.faces)


@pytest.mark.parametrize("number", NUMBERS)
def test_vertices_lie_on_whole_millimetres(number: int) -> None:
    points = corners(built(number)).reshape(-1, 3)
    assert np.abs(points - np.rint(points * 1000) / 1000).max() < 2e-6


@pytest.mark.parametrize("number", NUMBERS)
def test_nothing_is_wholly_buried(number: int) -> None:
    assert corners(built(number))[:, :, 2].max(axis=1).min() > -0.1


@pytest.mark.few(3)
@pytest.mark.parametrize("number", [*(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2, 3)), 4, 5])
def test_the_same_generator_builds_the_same_wreck(number: int) -> None:
    first, again = built(number), wreck(number, np.random.default_rng(7))
    assert len(first.meshes) == len(again.meshes)
    for a, b in zip(first.meshes, again.meshes, strict=True):
        assert a.vertices.tobytes() == b.vertices.tobytes()
        assert a.faces.tobytes() == b.faces.tobytes()
        assert a.colors.tobytes() == b.colors.tobytes()
    assert first.group.tobytes() == again.group.tobytes()
    assert first.radius == again.radius


@pytest.mark.parametrize("number", [4, 5])
def test_another_generator_builds_another_wreck(number: int) -> None:
    first, other = built(number), wreck(number, np.random.default_rng(8))
    assert corners(first).tobytes() != corners(other).tobytes()
    assert first.radius != other.radius


@pytest.mark.parametrize("number", NUMBERS)
def test_groups_are_parts_that_hang_together(number: int) -> None:
    found = built(number)
    counts = np.bincount(found.group)
    assert found.group.shape == (len(found.meshes),)
    assert found.group.dtype == np.int32
    assert 15 <= len(counts) <= 30
    assert counts.min() >= 15
    place = middles(found)
    extents = np.array([np.ptp(place[found.group == k], axis=0).max() for k in range(len(counts))])
    assert 2.0 < np.median(extents) < 6.5
    assert extents.max() < 10.5
    height = tops(found)
    for label in range(len(counts)):
        chosen = np.flatnonzero(found.group == label)
        if np.median(height[chosen]) > 0.7:
            assert islands(found, chosen, 1.0)[0] > 0.9 * len(chosen)


@pytest.mark.parametrize("number", STEEL)
def test_a_steel_hull_rises_into_the_way_of_the_vehicle(number: int) -> None:
    assert np.mean(tops(built(number)) > 2.5) > 0.25
    assert tops(built(number)).max() < 8.0


def upright(found: Wreck) -> npt.NDArray[np.bool_]:
    """Which patches face sideways rather than up or down: sides and walls, not decks and roofs."""
    facing = []
    for mesh in found.meshes:
        a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(np.float64) for k in range(3))
        normal = np.cross(b - a, c - a).sum(axis=0)
        facing.append(abs(normal[2]) < 0.7 * np.linalg.norm(normal))
    return np.array(facing)


@pytest.mark.parametrize("number", STEEL)
def test_what_stands_upright_is_low_enough_for_the_camera_of_a_vehicle(number: int) -> None:
    found = built(number)
    side, height = upright(found), middles(found)[:, 2]
    surface = np.array([areas(m.vertices[m.faces].astype(np.float64)).sum() for m in found.meshes])
    # The camera sees 16.9° upward: at most 4.4 m above the ground where it still trusts what it sees.
    assert surface[side & (height < 3.6)].sum() > 0.85 * surface[side].sum()
    assert surface[side & (height > 4.4)].sum() < 0.08 * surface[side].sum()


def outline(found: Wreck, height: float) -> Array:
    """(P, 2) where the edges of the triangles of patches that hang together pass a height."""
    triangles = corners(found)
    points = []
    for k in range(3):
        a, b = triangles[:, k], triangles[:, (k + 1) % 3]
        crossing = (a[:, 2] - height) * (b[:, 2] - height) < 0
        share = ((height - a[crossing, 2]) / (b[crossing, 2] - a[crossing, 2]))[:, None]
        points.append((a + 0.0)[crossing, :2] + share * (b - a)[crossing, :2])
    return np.concatenate(points)


@pytest.mark.parametrize("number", [1, 3, 4])
def test_sides_hang_hardly_over_the_ground_beside_them(number: int) -> None:
    # More would keep the ground beneath them from being mapped. Fenders stand out a little farther.
    foot = ConvexHull(outline(built(number), 0.5)).equations
    for height in (1.8, 2.0, 2.2):
        out = (outline(built(number), height) @ foot[:, :2].T + foot[:, 2]).max(axis=1)
        assert np.quantile(out, 0.95) < 0.3
        assert out.max() < 0.45


def test_the_wooden_hull_is_low_but_its_ribs_reach_the_height_of_the_vehicle() -> None:
    height = tops(built(5))
    assert np.mean(height > 2.5) < 0.06
    assert np.mean(height < 1.0) > 0.5
    assert np.sum(height > 1.8) > 12
    assert height.max() < 3.2


def test_the_five_are_clearly_different() -> None:
    high = {number: tops(built(number)).max() for number in NUMBERS}
    assert high[5] < 3.2 < high[3] < 4.4 < 4.9 < min(high[1], high[2], high[4])
    standing = {n: np.flatnonzero(middles(built(n))[:, 2] > 0.8) for n in NUMBERS}
    length = {n: np.ptp(middles(built(n))[standing[n], 0]) for n in NUMBERS}
    assert length[4] < 15.5 < 18.0 < length[1]
    pieces = {n: islands(built(n), standing[n], 0.3) for n in (1, 2, 4)}
    assert pieces[2][1] > 250, "the halves of the broken hull lie apart"
    assert pieces[1][0] > 0.9 * len(standing[1])
    assert pieces[4][0] > 0.9 * len(standing[4])
    # The barge's hold is open to port: seen from there, the wall is deeper than from starboard.
    barge = middles(built(3))
    level = (barge[:, 2] > 1.5) & (barge[:, 2] < 2.5) & (np.abs(barge[:, 0] - 1.5) < 1.5)
    centre = 0.5 * (barge[level, 1].min() + barge[level, 1].max())
    assert np.sum(barge[level, 1] < centre) > np.sum(barge[level, 1] > centre)


@pytest.mark.parametrize("number", NUMBERS)
def test_debris_away_from_the_wreck_stays_low(number: int) -> None:
    found = built(number)
    place, height = middles(found)[:, :2], tops(found)
    tall = cKDTree(place[height > (1.2 if number == 5 else 2.0)])
    away = np.asarray(tall.query(place)[0])
    assert height[away > 3.0].max() < 0.6
    assert np.sum(away > 2.0) > 40, "there is debris"
    assert away.max() < 9.0


@pytest.mark.parametrize("number", NUMBERS)
def test_surfaces_are_coloured_unevenly(number: int) -> None:
    colours = np.concatenate([mesh.colors for mesh in built(number).meshes]).astype(np.float64)
    assert (colours.std(axis=0) > 12).all()
    assert 60 < colours.mean() < 170
    brightness = {n: np.concatenate([m.colors for m in built(n).meshes]).mean() for n in (1, 5)}
    assert brightness[5] < brightness[1]


@pytest.mark.parametrize("number", NUMBERS)
def test_neighbours_share_their_edges(number: int) -> None:
    found = built(number)
    _, counts = edges(found)
    # Open edges are those of plates, holes and the cut at the seabed: far fewer than the shared ones.
    assert np.mean(counts == 1) < 0.17
    # An edge may belong to three triangles where the sides of the bow meet, hardly to more.
    assert np.mean(counts > 3) < 0.005


def test_a_whole_hull_is_open_only_along_its_rail_and_at_the_seabed() -> None:
    parts = [FORM.hull("side", RUST), FORM.bulwarks("side", RUST)]
    sunk = [part.moved(np.eye(3), (0.0, 0.0, -0.7)) for part in parts]
    meshes, group = individuals(sunk, np.random.default_rng(0))
    unique, counts = edges(Wreck(meshes, group, 8.0))
    ends = unique[counts == 1] / 1000.0
    rail = FORM.deck_edge(ends[..., 0].ravel()).reshape(-1, 2) * (1 + FORM.bulwark / FORM.depth) - 0.7
    at_rail = (np.abs(ends[..., 2] - rail) < 0.02).all(axis=1)
    buried = (ends[..., 2] < 0.0).any(axis=1)
    assert len(ends) > 50
    assert (at_rail | buried).all()
    assert counts.max() == 2


def test_a_hull_faces_outward() -> None:
    part = FORM.hull("side", RUST)
    a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    sound = (np.linalg.norm(normal, axis=1) > 1e-3) & (np.abs(part.centroids[:, 1]) > 0.3)
    assert (normal[sound, 1] * np.sign(part.centroids[sound, 1]) > -1e-9).mean() > 0.995


def test_closed_parts_enclose_their_volume() -> None:
    crate = box((-1, -0.5, 0), (1, 0.5, 0.75), "a", RUST)
    assert volume(crate) == pytest.approx(1.5)
    assert volume(inside_out(crate)) == pytest.approx(-1.5)
    assert volume(crate.moved(turn("x", 0.7) @ turn("z", 2.0), (3, 1, 2))) == pytest.approx(1.5)
    path = np.array([(0.0, 0.0, 0.0), (2.0, 1.0, 0.5)])
    pole = beam(path, 0.2 * rounded(12), "a", RUST)
    expected = 12 / 2 * np.sin(2 * np.pi / 12) * 0.2**2 * np.sqrt(5.25)
    assert volume(pole) == pytest.approx(expected)


def test_points_along_a_curve_are_equally_far_apart() -> None:
    angles = np.linspace(0, np.pi, 2001) ** 1.5 / np.sqrt(np.pi)
    curve = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    steps = np.linalg.norm(np.diff(resample(curve, 10), axis=0), axis=1)
    assert steps == pytest.approx(2 * np.sin(np.pi / 20), rel=1e-4)
    assert (resample(curve, 10)[[0, -1]] == curve[[0, -1]]).all()


@pytest.mark.parametrize("number", NUMBERS)
def test_whoever_looks_from_outside_sees_the_outside(number: int) -> None:
    found = built(number)
    triangles = corners(found)
    two_sided = np.concatenate([np.full(len(m.faces), m.two_sided) for m in found.meshes])
    a = triangles[:, 0]
    u, v = triangles[:, 1] - a, triangles[:, 2] - a
    normal = np.cross(u, v)
    rng = np.random.default_rng(3)
    seen = wrong = 0
    for angle in np.linspace(0, 2 * np.pi, 48, endpoint=False):
        eye = np.array([30 * np.cos(angle), 30 * np.sin(angle), 1.0 + 5 * rng.random()])
        aim = np.array([8 * rng.random() - 4, 2 * rng.random() - 1, 0.3 + 2 * rng.random()])
        ray = (aim - eye) / np.linalg.norm(aim - eye)
        # Möller and Trumbore, one ray against all triangles.
        p = np.cross(ray, v)
        determinant = (u * p).sum(axis=1)
        inverse = 1 / np.where(np.abs(determinant) < 1e-12, 1e-12, determinant)
        s = ((eye - a) * p).sum(axis=1) * inverse
        q = np.cross(eye - a, u)
        t = (ray * q).sum(axis=1) * inverse
        distance = (v * q).sum(axis=1) * inverse
        hit = (s >= 0) & (t >= 0) & (s + t <= 1) & (distance > 0)
        if not hit.any():
            continue
        first = int(np.argmin(np.where(hit, distance, np.inf)))
        seen += 1
        wrong += bool(not two_sided[first] and normal[first] @ ray > 0)
    assert seen > (10 if number == 5 else 40)
    assert wrong == 0


@pytest.mark.parametrize("number", [0, 6, -1])
def test_there_is_no_sixth_wreck(number: int) -> None:
    with pytest.raises(ValueError, match="expected a number from 1 to 5"):
        wreck(number, np.random.default_rng(0))
