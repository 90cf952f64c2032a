from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from dream.geometry import SE3, Bounds, camera_mount
from dream.protocol import DREAM_V1, DREAM_V2
from dream.protocol import DREAM_V2_TRUE as PROTOCOL
from dream.sim.inspection import NODE_SHARE, NODES, SHARE, Inspected, Inspection, kept
from dream.sim.inspection.points import POINTS, UP
from dream.sim.render import Renderer
from dream.sim.solids import Solids
from dream.sim.world import Instances, Mesh, World
from dream.sim.worlds import make_world
from tests.sim.arenas import FLOOR, NOTHING, arena, box, placed

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

REEFS = ("reef/string", "reef/fringing", "reef/patch", "reef/mixed", "reef/K")
WRECKS = tuple(f"wreck/{number}" for number in range(1, 6))
DIFFERING = 0.003
"""Share of the points about which two ray casters may differ: rays that graze an edge."""


def hull(*patches: npt.ArrayLike, two_sided: bool = False, obstacles: Instances = NOTHING) -> World:
    """A world whose individuals are patches of hull: quadrilaterals (Q, 4, 3), counter-clockwise outside."""
    meshes = []
    for patch in patches:
        corners = np.asarray(patch, np.float32).reshape(-1, 3)
        quads = np.arange(len(corners), dtype=np.int32).reshape(-1, 4)
        faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        meshes.append(Mesh(corners, faces, np.zeros((len(corners), 3), np.uint8), two_sided))
    targets = replace(
        placed(0, np.zeros((len(patches), 3)), 1.0), mesh=np.arange(1, len(patches) + 1, dtype=np.int32)
    )
    world = arena(obstacles, targets)
    return replace(world, meshes=(box(), *meshes), hull=np.ones(len(world.targets), np.bool_))


def flat(x: float, y: float, z: float, size: float) -> list[list[float]]:
    """A square that faces up."""
    h = 0.5 * size
    return [[x - h, y - h, z], [x + h, y - h, z], [x + h, y + h, z], [x - h, y + h, z]]


def upright(x: float, y0: float, y1: float, z0: float, z1: float) -> list[list[float]]:
    """A rectangle that faces west, towards −x."""
    return [[x, y0, z0], [x, y0, z1], [x, y1, z1], [x, y1, z0]]


def look_at(inspection: Inspection, eye: npt.ArrayLike, target: npt.ArrayLike) -> Inspected:
    """From the eye, with the target in the middle of the image."""
    x, y, z = (float(way) for way in np.subtract(target, eye))
    ex, ey, ez = (float(at) for at in np.asarray(eye))
    return inspection.look(SE3.level(ex, ey, ez, math.atan2(y, x)), math.atan2(-z, math.hypot(x, y)))


@pytest.mark.parametrize(
    ("degrees", "inspected"), [(0.0, True), (45.0, True), (69.0, True), (71.5, False), (88.0, False)]
)
def test_a_plate_is_inspected_up_to_seventy_degrees_and_seen_beyond(degrees: float, inspected: bool) -> None:
    at = (0.0, 0.0, FLOOR + 2.0)
    inspection = Inspection(hull(flat(*at, 0.1)), PROTOCOL)
    angle = math.radians(degrees)
    for azimuth in (0.0, 2.0, 4.5):
        way = [math.sin(angle) * math.cos(azimuth), math.sin(angle) * math.sin(azimuth), math.cos(angle)]
        look = look_at(inspection, np.add(at, 4.0 * np.array(way)), at)
        assert look.seen.tolist() == [True]
        assert look.inspected.tolist() == [inspected]
    assert inspection.inspected(SE3.level(0.0, 0.0, FLOOR + 5.0, 0.0), 0.5 * math.pi).tolist() == [True]
    assert inspection.seen(SE3.level(0.0, 0.0, FLOOR + 5.0, 0.0), -0.5).tolist() == [False]


@pytest.mark.parametrize("two_sided", [False, True])
def test_only_what_has_two_sides_counts_from_behind(two_sided: bool) -> None:
    at = (0.0, 0.0, FLOOR + 4.0)
    inspection = Inspection(hull(flat(*at, 0.5), two_sided=two_sided), PROTOCOL)
    below = look_at(inspection, [-1.0, 0.0, FLOOR + 1.0], at)
    assert below.seen.tolist() == below.inspected.tolist() == [two_sided]
    assert look_at(inspection, [-1.0, 0.0, FLOOR + 6.0], at).inspected.all()


def test_reach_is_straight_through_the_water() -> None:
    inspection = Inspection(hull(flat(0, 0, FLOOR + 0.5, 0.1)), PROTOCOL)
    for away, within in ((7.9, True), (8.1, False)):
        look = look_at(inspection, [-1e-3, 0.0, FLOOR + 0.5 + away], [0.0, 0.0, FLOOR + 0.5])
        assert look.inspected.tolist() == [within]


@pytest.mark.parametrize(
    ("bearing", "shows"), [(-48, False), (-42, True), (0, True), (42, True), (48, False)]
)
def test_the_image_ends_at_half_a_right_angle(bearing: float, shows: bool) -> None:
    inspection = Inspection(hull(flat(0, 0, FLOOR + 1.0, 0.1)), PROTOCOL)
    pose = SE3.level(-2.0, 0.0, FLOOR + 1.5, math.radians(bearing))
    assert inspection.seen(pose, 0.0).tolist() == [shows]


def test_a_clump_behind_a_clump_is_hidden_and_stops_nobody() -> None:
    clumps = placed(0, [[4.0, 0, FLOOR], [3.0, 0, FLOOR]], [[0.3, 0.3, 0.3], [0.3, 0.6, 1.2]])
    both, one = arena(targets=clumps), arena(targets=clumps.chosen(np.array([True, False])))
    eye, target = [0.0, 0.0, FLOOR + 2.0], [4.0, 0.0, FLOOR + 0.3]
    assert look_at(Inspection(one, PROTOCOL), eye, target).inspected.tolist() == [True]
    look = look_at(Inspection(both, PROTOCOL), eye, target)
    assert look.seen.tolist() == [False, True]
    # From the other side the small one is in front, and hides nothing.
    assert look_at(Inspection(both, PROTOCOL), [6.0, 0.0, FLOOR + 2.4], target).inspected.all()
    assert Solids(both).free_at([[3.0, 0.0, FLOOR + 0.5]], PROTOCOL).all()


def test_the_points_of_a_clump_lie_on_faces_that_look_up() -> None:
    inspection = Inspection(arena(targets=placed(0, [[1.0, 2.0, FLOOR]], 0.3)), PROTOCOL)
    assert len(inspection.surface.points) == POINTS
    assert np.allclose(inspection.surface.points[:, 2], FLOOR + 0.3, atol=1e-6)
    reef = Inspection(make_world("reef/string", 1), PROTOCOL).surface
    assert (reef.normals[:, 2] >= UP).all()
    assert (np.linalg.norm(reef.normals, axis=1) == pytest.approx(1.0)) is True


def test_a_plate_behind_a_plate_is_hidden_until_the_eye_moves_aside() -> None:
    patches = [upright(5, -0.5, 0.5, FLOOR + 1, FLOOR + 2), upright(3, -0.5, 0.5, FLOOR + 1, FLOOR + 2)]
    inspection = Inspection(hull(*patches), PROTOCOL)
    target = [5.0, 0.0, FLOOR + 1.5]
    look = look_at(inspection, [0.0, 0.0, FLOOR + 1.5], target)
    assert look.seen.tolist() == look.inspected.tolist() == [False, True]
    assert look_at(inspection, [2.0, 2.0, FLOOR + 1.5], target).inspected.tolist() == [True, True]


def test_an_overhang_hides_from_above_what_shows_from_the_side() -> None:
    roof = placed(0, [[0, 0, FLOOR + 2.0]], [4, 4, 0.1])
    at = (0.0, 0.0, FLOOR + 0.3)
    inspection = Inspection(hull(flat(*at, 0.5), obstacles=roof), PROTOCOL)
    assert not look_at(inspection, [0.5, 0.0, FLOOR + 5.0], at).seen.any()
    assert look_at(inspection, [-3.0, 0.0, FLOOR + 1.8], at).inspected.all()


def test_the_terrain_hides() -> None:
    at = (5.0, 0.0, FLOOR + 0.1)
    world = hull(flat(*at, 0.3))
    x = world.terrain.x0 + world.terrain.spacing * np.arange(world.terrain.heights.shape[1])
    ridge = np.where(np.abs(x - 3.0) < 0.1, 1.5, 0.0).astype(np.float32)
    hilly = replace(world, terrain=replace(world.terrain, heights=world.terrain.heights + ridge))
    for place, shows in ((world, True), (hilly, False)):
        look = look_at(Inspection(place, PROTOCOL), [0.0, 0.0, FLOOR + 2.5], at)
        assert look.inspected.tolist() == [shows]


@pytest.mark.parametrize(
    ("shown", "seen", "inspected"), [(0.0, False, False), (0.09, True, False), (0.4, True, True)]
)
def test_enough_of_a_patch_must_show(shown: float, seen: bool, inspected: bool) -> None:
    # A wall halfway to a patch 1 m wide leaves so much of it to be seen.
    edge = 0.5 * (0.5 - shown) if shown else 1.0
    wall = placed(0, [[2.0, edge - 2.0, FLOOR]], [0.01, 4.0, 4.0])
    patch = upright(4, -0.5, 0.5, FLOOR + 1, FLOOR + 2)
    inspection = Inspection(hull(patch, obstacles=wall), PROTOCOL)
    look = look_at(inspection, [0.0, 0.0, FLOOR + 1.5], [4.0, 0.0, FLOOR + 1.5])
    assert (look.seen.tolist(), look.inspected.tolist()) == ([seen], [inspected])
    assert (look.points > 0).mean() == pytest.approx(shown, abs=0.12)
    assert inspected is bool((look.points == 2).mean() >= SHARE)


def test_what_is_buried_bears_no_points_and_has_no_area() -> None:
    surface = Inspection(hull(upright(3, -1, 1, FLOOR - 1, FLOOR + 0.5)), PROTOCOL).surface
    assert (surface.points[:, 2] > FLOOR).all()
    assert surface.area == pytest.approx([1.0])
    assert surface.points[:, 1].min() < -0.5
    assert surface.points[:, 1].max() > 0.5


def test_what_something_covers_bears_no_points() -> None:
    patch = upright(3, -0.5, 0.5, FLOOR + 1, FLOOR + 2)
    # Two centimetres in front of two thirds of it, and 1 m wider on its other sides.
    cover = upright(2.98, -1.5, 0.17, FLOOR, FLOOR + 3)
    inspection = Inspection(hull(patch, cover), PROTOCOL)
    surface = inspection.surface
    assert (surface.points[surface.owner == 0][:, 1] > 0.1).all()
    assert look_at(inspection, [0.0, 0.0, FLOOR + 1.5], [3.0, 0.0, FLOOR + 1.5]).inspected.all()
    # One that is covered all over keeps its points, and is never seen.
    hidden = Inspection(hull(patch, upright(2.98, -1.5, 1.5, FLOOR, FLOOR + 3)), PROTOCOL)
    assert (hidden.surface.owner == 0).sum() == POINTS
    assert look_at(hidden, [0.0, 0.0, FLOOR + 1.5], [3.0, 0.0, FLOOR + 1.5]).seen.tolist() == [False, True]


def test_a_mast_counts_by_the_side_that_shows() -> None:
    turn = np.linspace(0.0, 2.0 * math.pi, 13)
    foot = np.column_stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), np.full(13, FLOOR + 1.0)])
    up = np.array([0.0, 0.0, 2.0])
    mast = [[a, b, b + up, a + up] for a, b in pairwise(foot)]
    inspection = Inspection(hull(mast), PROTOCOL)
    for azimuth in np.linspace(0.0, 6.0, 9):
        eye = [3.0 * math.cos(azimuth), 3.0 * math.sin(azimuth), FLOOR + 2.0]
        look = look_at(inspection, eye, [0.0, 0.0, FLOOR + 2.0])
        assert look.inspected.tolist() == [True]
        assert (look.points > 0).sum() < 0.7 * POINTS


def every_triangle(world: World) -> Array:
    """(T, 3, 3) of targets, obstacles and the two halves of every square of the terrain."""
    z = world.terrain.heights.astype(np.float64)
    rows, cols = z.shape
    x = world.terrain.x0 + np.arange(cols) * world.terrain.spacing
    y = world.terrain.y0 + np.arange(rows) * world.terrain.spacing
    points = np.dstack([*np.meshgrid(x, y), z])
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    parts = [np.stack([a, b, c], axis=2).reshape(-1, 3, 3), np.stack([a, c, d], axis=2).reshape(-1, 3, 3)]
    for instances in (world.targets, world.obstacles):
        for k, mesh in enumerate(instances.mesh):
            w, *xyz = instances.wxyz[k].astype(np.float64)
            at = Rotation.from_quat([*xyz, w]).apply(
                world.meshes[mesh].vertices.astype(np.float64) * instances.scale[k].astype(np.float64)
            )
            parts.append((at + instances.position[k].astype(np.float64))[world.meshes[mesh].faces])
    return np.concatenate(parts)


def met(triangles: Array, boxes: Array, eye: Array, point: Array) -> bool:
    """Is any triangle crossed up to a millimetre before the end? A 3 × 3 solve for each whose box is near."""
    near = np.arange(len(boxes))
    for axis in range(3):
        low, high = sorted((eye[axis], point[axis]))
        near = near[(boxes[near, 0, axis] <= high + 1e-6) & (boxes[near, 1, axis] >= low - 1e-6)]
    a, b, c = triangles[near].transpose(1, 0, 2)
    ray = point - eye
    columns = np.stack([np.broadcast_to(-ray, a.shape), b - a, c - a], axis=-1)
    sound = np.abs(np.linalg.det(columns)) > 1e-14
    t, u, v = np.linalg.solve(columns[sound], (eye - a[sound])[..., None])[..., 0].T
    end = 1.0 - 1e-3 / np.linalg.norm(ray)
    return bool(((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < end)).any())


def poses_near(inspection: Inspection, count: int, rng: np.random.Generator) -> list[tuple[SE3, float]]:
    """Poses in open water, with something in front of the camera."""
    points = inspection.surface.points
    found: list[tuple[SE3, float]] = []
    while len(found) < count:
        x, y, z = points[rng.integers(len(points))]
        yaw, away = rng.uniform(-math.pi, math.pi), rng.uniform(1.0, 7.0)
        eye = x - away * math.cos(yaw), y - away * math.sin(yaw), z + rng.uniform(-0.5, 4.0)
        # Under the open sky: what is free may lie inside of something closed.
        open_sky = np.isinf(inspection.solids.ranges(eye, [[0.0, 0.0, 1.0]], limit=20.0)[0]).all()
        if open_sky and inspection.solids.free_at([eye], PROTOCOL).all():
            found.append((SE3.level(eye[0], eye[1], eye[2], yaw), float(rng.choice(PROTOCOL.tilts))))
    return found


def compare_with_every_triangle(name: str, poses: int, most: int) -> None:
    """Point by point, with as many points of a pose."""
    world = make_world(name, 3)
    inspection, triangles = Inspection(world, PROTOCOL), every_triangle(world)
    boxes = np.stack([triangles.min(axis=1), triangles.max(axis=1)], axis=1)
    surface, camera = inspection.surface, PROTOCOL.camera
    rng = np.random.default_rng(5)
    count = differing = shown = hidden = 0
    for T_world_base, tilt in poses_near(inspection, poses, rng):
        look = inspection.look(T_world_base, tilt)
        eye = np.asarray(T_world_base.translation, np.float64)
        T_world_camera = T_world_base @ camera_mount(tilt)
        pixel, depth = camera.project(T_world_camera.inverse @ surface.points)
        away = np.linalg.norm(surface.points - eye, axis=1)
        cosine = ((eye - surface.points) * surface.normals).sum(axis=1) / away
        cosine = np.where(surface.two_sided[surface.owner], np.abs(cosine), cosine)
        inside = (away <= PROTOCOL.reach) & (depth >= PROTOCOL.min_depth) & (depth <= PROTOCOL.max_depth)
        inside &= (
            (pixel >= 0).all(axis=1) & (pixel < (camera.width, camera.height)).all(axis=1) & (cosine > 0)
        )
        assert not look.points[~inside].any()
        near = (np.abs(boxes - eye).min(axis=1) <= PROTOCOL.reach).all(axis=1)
        near |= ((boxes[:, 0] <= eye) & (boxes[:, 1] >= eye)).any(axis=1)
        here = triangles[near], boxes[near]
        for i in rng.permutation(np.flatnonzero(inside))[:most]:
            square = cosine[i] >= math.cos(math.radians(70.0))
            blocked = met(*here, eye, surface.points[i])
            expected = 0 if blocked else 2 if square else 1
            count, differing = count + 1, differing + (expected != look.points[i])
            shown, hidden = shown + (expected > 0), hidden + (expected == 0)
    assert min(shown, hidden) > 0.05 * count > 0
    assert differing <= DIFFERING * count, f"{differing} of {count} points differ"


@pytest.mark.rare
@pytest.mark.parametrize("name", ["reef/string", "wreck/4"])
def test_a_look_agrees_with_every_triangle_one_by_one(name: str) -> None:
    compare_with_every_triangle(name, poses=5, most=25)


@pytest.mark.slow
@pytest.mark.rare
@pytest.mark.parametrize("name", REEFS + WRECKS)
def test_a_look_at_every_kind_of_world_agrees_with_every_triangle(name: str) -> None:
    compare_with_every_triangle(name, poses=12, most=300)


def compare_with_the_renderer(name: str, poses: int) -> None:
    """Who shows many pixels within reach is seen, and who is inspected shows one.

    But for a few: of a patch at the edge of the image, or of a clump between others, a part without a point
    may show.
    """
    world = make_world(name, 4)
    inspection, renderer = Inspection(world, PROTOCOL), Renderer(world)
    camera, rng = PROTOCOL.camera, np.random.default_rng(6)
    counts = np.zeros(4, np.intp)
    for T_world_base, tilt in poses_near(inspection, poses, rng):
        T_world_camera = T_world_base @ camera_mount(tilt)
        frame = renderer.measure(camera, T_world_camera)
        points = camera.back_project(frame.depth, T_world_camera)
        near = np.linalg.norm(points - T_world_camera.translation, axis=-1) <= PROTOCOL.reach
        pixels = np.bincount(frame.ids[near & (frame.ids >= 0)], minlength=len(inspection))
        look, many = inspection.look(T_world_base, tilt), pixels >= 40
        each = many, many & look.seen, look.inspected, look.inspected & (pixels > 0)
        counts += [int(which.sum()) for which in each]
    showing, seen, inspected, shown = counts
    least = 0.98 if world.hull.all() else 0.94
    assert seen >= least * showing > 0, f"{seen} of {showing}"
    assert shown >= 0.995 * inspected > 0, f"{shown} of {inspected}"


@pytest.mark.rare
@pytest.mark.parametrize("name", ["reef/mixed", "wreck/1"])
def test_a_look_agrees_with_the_pixels_of_the_renderer(name: str) -> None:
    compare_with_the_renderer(name, poses=15)


@pytest.mark.slow
@pytest.mark.rare
@pytest.mark.parametrize("name", REEFS + WRECKS)
def test_a_look_at_every_kind_of_world_agrees_with_the_renderer(name: str) -> None:
    compare_with_the_renderer(name, poses=40)


def small(world: World) -> World:
    """Between walls of nothing 6 m apart."""
    return replace(world, bounds=Bounds(-3, -3, 3, 3))


def shaft(x: float, y: float, side: float, height: float) -> Instances:
    """Four walls around a square of that side."""
    off = 0.5 * side + 0.05
    places = [[x + off, y, FLOOR], [x - off, y, FLOOR], [x, y + off, FLOOR], [x, y - off, FLOOR]]
    wide = side + 0.2
    sizes = [[0.1, wide, height], [0.1, wide, height], [wide, 0.1, height], [wide, 0.1, height]]
    return placed(0, places, sizes)


def test_what_a_vehicle_can_show_is_what_enough_places_inspect() -> None:
    # One plate in the open, one at the bottom of a shaft too narrow to enter, one upside down on the ground.
    down = flat(-1.5, -1.5, FLOOR + 0.01, 0.5)[::-1]
    plates = (flat(1.0, -1.0, FLOOR + 0.5, 0.5), flat(1.0, 1.5, FLOOR + 0.1, 0.2), down)
    world = small(hull(*plates, obstacles=shaft(1.0, 1.5, 0.3, 1.8)))
    inspection = Inspection(world, PROTOCOL)
    space, surface = inspection.free_space, inspection.surface
    level_, row, col = np.nonzero(space.reachable)
    nodes = (np.array(space.first) + np.column_stack([col, row, level_])) * space.spacing
    shows, within = np.zeros(3, np.intp), np.zeros(3, np.intp)
    for i in range(3):
        middle = surface.points[surface.owner == i].mean(axis=0)
        for x, y, z in nodes[np.linalg.norm(nodes - middle, axis=1) <= PROTOCOL.reach]:
            heading = PROTOCOL.heading_index(math.atan2(middle[1] - y, middle[0] - x))
            down_angle = math.atan2(z - middle[2], math.hypot(middle[0] - x, middle[1] - y))
            tilt = PROTOCOL.tilts[np.abs(np.subtract(PROTOCOL.tilts, down_angle)).argmin()]
            pose = SE3.level(x, y, z, heading * PROTOCOL.heading_step)
            within[i] += 1
            shows[i] += inspection.inspected(pose, tilt)[i]
    enough = np.maximum(np.ceil(NODE_SHARE * within), NODES)
    assert inspection.worked_out().tolist() == (shows >= enough).tolist() == [True, False, False], shows
    assert 0 < shows[1] < enough[1]
    assert shows[0] > 10 * enough[0]
    # The number of places that show the one in the shaft is just enough, one more is not.
    for least, counts in ((int(shows[1]), True), (int(shows[1]) + 1, False)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("dream.sim.inspection.NODES", least)
            patch.setattr("dream.sim.inspection.NODE_SHARE", 0.0)
            assert inspection.worked_out()[1] == counts


def test_the_area_that_is_dropped_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DREAM_CACHE", str(tmp_path))
    plates = (flat(1.0, -1.0, FLOOR + 0.5, 0.5), flat(-1.0, 1.5, FLOOR + 0.01, 1.0)[::-1])
    inspection = Inspection(small(hull(*plates)), PROTOCOL)
    assert inspection.countable.tolist() == [True, False]
    assert inspection.surface.area == pytest.approx([0.25, 1.0])
    assert inspection.dropped == pytest.approx(0.8)


def test_what_is_countable_is_kept_by_world_and_rules(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DREAM_CACHE", str(tmp_path / "kept"))
    calls = []

    def work_out() -> BoolArray:
        calls.append(1)
        return np.array([True, False])

    plates = (flat(1.0, -1.0, FLOOR + 0.5, 0.5), flat(-1.0, 1.5, FLOOR + 0.5, 1.0))
    world = hull(*plates)
    for _ in range(2):
        assert kept.countable(world, PROTOCOL, work_out).tolist() == [True, False]
    # Noise has no part in it; reach, another world and a file that is broken do.
    kept.countable(world, DREAM_V2, work_out)
    assert len(calls) == 1
    kept.countable(world, replace(PROTOCOL, reach=7.0), work_out)
    kept.countable(small(world), PROTOCOL, work_out)
    assert len(calls) == 3
    for path in (tmp_path / "kept").iterdir():
        path.write_bytes(b"no array")
    kept.countable(world, PROTOCOL, work_out)
    assert len(calls) == 4
    # Where nothing can be written, it is worked out each time.
    (tmp_path / "file").touch()
    monkeypatch.setenv("DREAM_CACHE", str(tmp_path / "file"))
    for _ in range(2):
        assert kept.countable(world, PROTOCOL, work_out).tolist() == [True, False]
    assert len(calls) == 6


def test_what_its_frames_show_is_kept_by_world_and_rules(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DREAM_CACHE", str(tmp_path / "kept"))
    calls = []

    def work_out() -> dict[str, npt.NDArray[np.int32]]:
        calls.append(1)
        return {"first": np.arange(3, dtype=np.int32), "who": np.array([7], np.int32)}

    world = hull(flat(1.0, -1.0, FLOOR + 0.5, 0.5))
    for protocol in (PROTOCOL, DREAM_V2):
        tables = kept.tables("frames", world, protocol, work_out)
        assert {name: table.tolist() for name, table in tables.items()} == {"first": [0, 1, 2], "who": [7]}
    assert len(calls) == 1
    kept.tables("other", world, PROTOCOL, work_out)
    assert len(calls) == 2
    for path in (tmp_path / "kept").iterdir():
        path.write_bytes(b"no arrays")
    kept.tables("frames", world, PROTOCOL, work_out)
    assert len(calls) == 3


def test_a_planar_protocol_inspects_nothing() -> None:
    with pytest.raises(ValueError, match="one that moves in space, got dream-v1"):
        Inspection(arena(), DREAM_V1)


def test_a_world_without_individuals_is_looked_at() -> None:
    inspection = Inspection(arena(), PROTOCOL)
    look = inspection.look(SE3.level(0.0, 0.0, FLOOR + 2.0, 0.0), 0.3)
    assert look.seen.shape == look.inspected.shape == look.points.shape == (0,)
    assert inspection.worked_out().shape == (0,)
