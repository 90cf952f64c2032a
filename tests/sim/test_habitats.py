"""The recipes of the wide worlds keep to their ranges, and what they make can be flown in."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from dream.geometry import Bounds
from dream.protocol import DREAM_V2
from dream.sim.files import load_world, save_world, world_hash
from dream.sim.habitats import HABITATS, beds, mounds, rocks, small
from dream.sim.habitats.arena import Arena, arena_in, steps_for
from dream.sim.habitats.growth import islands
from dream.sim.sampling import rotated
from dream.sim.solids import Solids
from dream.sim.terrain import SPACING, grid
from dream.sim.validity import problems
from dream.sim.water import WATERS, water_of
from dream.sim.world import World
from dream.sim.worlds import make_world
from tests.sim.arenas import arena as small_arena
from tests.sim.made import made

Float64Array = npt.NDArray[np.float64]

LEAST = {
    "mound": 1.5, "ledge": 1.5, "carpet": 3.0, "tiny": 0.4, "dense": 1.5, "rocks": 0.7,
    "holes": 1.5, "border": 1.5, "walls": 1.5, "wide": 1.5,
}  # fmt: skip
"""Least radius of a group of each family; of two habitats, the lesser of both."""
MANY = range(1, 13)
FAMILIES = [name.removeprefix("reef/") for name in HABITATS]
every_family = pytest.mark.parametrize("family", FAMILIES)
every_world = pytest.mark.parametrize(
    ("family", "seed"),
    [
        pytest.param(family, seed, marks=[pytest.mark.slow, pytest.mark.rare] if seed > 2 else [])
        for family in FAMILIES
        for seed in MANY
    ],
)


def rng_of(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def arenas() -> list[Arena]:
    return [arena_in(rng_of(seed)) for seed in MANY]


def surface(world: World) -> Float64Array:
    """(T, 3, 3) the triangles of all obstacles."""
    table = world.obstacles
    parts = [np.empty((0, 3, 3))]
    for k in range(len(table)):
        mesh = world.meshes[table.mesh[k]]
        points = rotated(table.wxyz[k], mesh.vertices.astype(float) * table.scale[k]) + table.position[k]
        parts.append(points[mesh.faces])
    return np.concatenate(parts)


def away_from(point: Float64Array, triangles: Float64Array) -> float:
    """Metres from a point to the nearest of some triangles (T, 3, 3): to its face, or else to its sides."""
    a, b, c = triangles.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height = ((point - a) * normal).sum(axis=1)
    foot = point - height[:, None] * normal
    inside = np.ones(len(a), np.bool_)
    best = np.full(len(a), np.inf)
    for one, other in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(other - one, foot - one) * normal).sum(axis=1) >= 0.0
        side = other - one
        t = np.clip(((point - one) * side).sum(axis=1) / (side * side).sum(axis=1), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(point - one - t[:, None] * side, axis=1))
    return float(np.where(inside, np.abs(height), best).min())


def up_axes(world: World) -> Float64Array:
    """(N, 3) which way each individual grows."""
    w, x, y, z = world.targets.wxyz.astype(float).T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)


def bed_normals(world: World, x: Float64Array, y: Float64Array) -> Float64Array:
    h, d = world.terrain.height, 0.1
    east, north = (h(x + d, y) - h(x - d, y)) / (2 * d), (h(x, y + d) - h(x, y - d)) / (2 * d)
    normals = np.stack([-east, -north, np.ones_like(east)], axis=1)
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def radii(world: World) -> list[float]:
    places, group = world.targets.position[:, :2].astype(np.float64), world.targets.group
    own = [places[group == k] for k in range(int(group.max()) + 1)]
    return [float(np.hypot(*(each - each.mean(axis=0)).T).max()) for each in own]


@pytest.mark.few(4)
@every_world
def test_an_arena_can_be_surveyed_on_one_battery(family: str, seed: int) -> None:
    world = made(f"reef/{family}", seed)
    box, seen = world.bounds, world.water.visibility
    assert 30.0 <= box.width <= 100.0
    assert 30.0 <= box.depth <= 100.0
    assert box.width != box.depth
    assert all(side % 2.0 == 0.0 for side in (box.width, box.depth))
    assert 3.0 - 1e-4 <= seen <= 15.0 + 1e-4
    assert world.water.name == f"visibility {round(seen, 1):g} m"
    steps = 300.0 * box.width * box.depth / 45.0**2 * 7.0 / min(7.0, 2.0 * seen / 1.7)
    assert steps == pytest.approx(steps_for(box, world.water))
    assert steps <= 1200.0


def test_sides_and_visibility_take_their_whole_range_whatever_the_other() -> None:
    found = [arena_in(rng_of(seed)) for seed in range(300)]
    sides = np.array([(each.bounds.width, each.bounds.depth) for each in found])
    seen = np.array([each.water.visibility for each in found])
    assert sides.min() <= 32.0
    assert sides.max() >= 94.0
    assert (seen.min(), seen.max()) == (pytest.approx(3.1, abs=0.15), pytest.approx(14.9, abs=0.15))
    # Murky water leaves out the widest arenas, so that a look there is worth as much.
    area = sides.prod(axis=1)
    assert area[seen < 4.0].max() < 6000.0 < area[seen > 6.0].max()


@every_world
def test_a_world_keeps_what_it_promises_of_its_groups_and_of_its_number(family: str, seed: int) -> None:
    world = made(f"reef/{family}", seed)
    assert not list(problems(world))
    assert 60 <= len(world.targets) <= 6000
    assert not world.hull.any()
    least = LEAST.get(family) or min(LEAST["mound"], LEAST["tiny"] if world.group_radius < 1.0 else 3.0)
    assert world.group_radius == least
    assert min(radii(world)) >= least
    assert world.protocol == DREAM_V2.name


@every_world
def test_a_mission_begins_in_free_water(family: str, seed: int) -> None:
    world = made(f"reef/{family}", seed)
    starts = [(s.x, s.y, DREAM_V2.launch_height(float(world.terrain.height(s.x, s.y)))) for s in world.starts]
    solids = Solids(world)
    assert len(starts) == 4
    assert solids.free_at(starts, DREAM_V2).all()
    # And so is the water about it that is known to be.
    around = [
        (x + 2.4 * math.cos(turn), y + 2.4 * math.sin(turn), z + 0.2)
        for x, y, z in starts
        for turn in np.arange(8) * math.pi / 4.0
    ]
    assert solids.free_at(around, DREAM_V2).all()


@every_world
def test_individuals_stand_on_what_they_grow_on_and_away_from_it(family: str, seed: int) -> None:
    world = made(f"reef/{family}", seed)
    points, ups = world.targets.position.astype(np.float64), up_axes(world)
    # The widest sits 15 % of 0.35 m deep.
    deepest = 0.055
    if family != "rocks":
        x, y, z = points.T
        normals = bed_normals(world, x, y)
        off = (z - world.terrain.height(x, y)) * normals[:, 2]
        # On the rim of a ledge the bed bends within the depth that an individual sits at.
        bound = 0.3 if family in ("ledge", "two") else deepest + 0.01
        assert np.abs(off).max() <= bound
        assert np.median(off) < 0.0
        lean = np.degrees(np.arccos(np.clip((ups * normals).sum(axis=1), -1.0, 1.0)))
        assert np.percentile(lean, 95.0) <= 20.0
    else:
        triangles = surface(world)
        middles = triangles.mean(axis=1)
        for point in points[:: max(len(points) // 60, 1)]:
            near = np.linalg.norm(middles - point, axis=1) <= 1.3
            assert away_from(point, triangles[near]) <= deepest
        # Outwards: with the open water above it, but under an overhang or a higher rock.
        tips = points + 0.3 * ups
        solids = Solids(world)
        above = [solids.ranges(tip, [[0.0, 0.0, 1.0]], limit=4.0)[0][0] for tip in tips]
        assert np.isfinite(above).mean() < 0.03
        # On tops, on sides, and on both.
        assert (ups[:, 2] > 0.8).any()
        assert (np.abs(ups[:, 2]) < 0.35).mean() > 0.1


@pytest.mark.few(3)
@every_family
def test_the_same_seed_gives_the_same_world(family: str) -> None:
    assert world_hash(make_world(f"reef/{family}", 1)) == world_hash(made(f"reef/{family}"))
    assert world_hash(made(f"reef/{family}", 2)) != world_hash(made(f"reef/{family}"))


def test_mounds_rise_as_high_and_as_steeply_as_is_published() -> None:
    counts = set()
    for seed, arena in zip(MANY, arenas(), strict=True):
        found = mounds.mounds_in(arena, arena.bounds, rng_of(seed))
        counts.add(len(found.mounds))
        x, y = grid(arena.bounds, SPACING)
        relief = found.relief(x, y)
        assert min(mound.height for mound in found.mounds) >= 0.5
        assert relief.max() <= 2.0 + 0.1
        slopes = np.degrees(np.arctan(np.hypot(*np.gradient(relief, SPACING))))
        assert np.percentile(slopes[relief > 0.1], 99.0) <= 37.0
        assert slopes.max() >= 12.0
        for start in arena.starts:
            around = np.hypot(x - start.x, y - start.y) <= 2.85
            assert relief[around].max(initial=0.0) <= 0.02
    assert {1, 5} <= counts <= {1, 2, 3, 4, 5}


def test_ledges_step_up_to_two_metres_beside_their_starts() -> None:
    for seed, arena in zip(MANY, arenas(), strict=True):
        try:
            found = mounds.ledges_in(arena, arena.bounds, rng_of(seed))
        except ValueError:
            # The families draw another arena then.
            continue
        assert 1 <= len(found.edges) <= 3
        assert 0.5 <= found.low <= found.high <= 2.0
        x, y = grid(arena.bounds, SPACING)
        relief = found.relief(x, y)
        assert np.degrees(np.arctan(np.hypot(*np.gradient(relief, SPACING)))).max() >= 40.0
        for start in arena.starts:
            around = np.hypot(x - start.x, y - start.y) <= 2.85
            # No step, but the bed swells above one.
            assert np.degrees(np.arctan(np.hypot(*np.gradient(relief, SPACING))[around])).max() <= 20.0


@pytest.mark.parametrize(
    ("family", "cover", "density"),
    [
        ("carpet", (0.2, 0.5), (0.2, 1.0)),
        ("dense", (0.5, 0.7), (0.5, 13.0)),
        ("border", (0.0, 0.8), (2.0, 13.0)),
    ],
)
def test_beds_cover_and_are_as_dense_as_is_published(
    family: str, cover: tuple[float, float], density: tuple[float, float]
) -> None:
    for seed, arena in zip(MANY, arenas(), strict=True):
        box, rng = arena.bounds, rng_of(seed)
        if family == "border":
            found: beds.Beds | beds.Borders = beds.borders_in(arena, rng)
            published = beds.BORDER
        elif family == "carpet":
            found = beds.beds_in(arena, box, beds.SPARSE, (9.0, 14.0), beds.CARPET, (0.0, 0.0), 3.0, rng)
            published = beds.CARPET
        else:
            found = beds.beds_in(arena, box, beds.DENSE, (4.0, 9.0), beds.BED, beds.HEIGHT, 1.5, rng)
            published = beds.BED
        assert published == density
        label = islands(found, box, found.group_radius)
        assert cover[0] <= (label > 0).mean() <= cover[1]


@pytest.mark.parametrize("family", ["carpet", "dense", "border"])
def test_no_square_of_a_bed_has_more_individuals_than_is_published(family: str) -> None:
    most = {"carpet": 1.0, "dense": 13.0, "border": 13.0}[family]
    for seed in (1, 2):
        places = made(f"reef/{family}", seed).targets.position[:, :2]
        _, counts = np.unique(np.floor(places / 4.0), axis=0, return_counts=True)
        # Dense stretches have some more than the mean, which is what is published.
        assert np.percentile(counts / 16.0, 90.0) <= 1.8 * most


@pytest.mark.slow
def test_tiny_groups_are_small_and_far_apart() -> None:
    for seed in MANY:
        world = made("reef/tiny", seed)
        found = radii(world)
        assert 6 <= len(found) <= 15
        assert 0.4 <= min(found) <= max(found) <= 0.9 + 0.005
        group = world.targets.group
        middles = [world.targets.position[group == k, :2].mean(axis=0) for k in range(len(found))]
        gaps = [float(np.hypot(*(a - b))) for a, b in itertools.combinations(middles, 2)]
        assert min(gaps) >= 3.9
    assert small.DENSITY == (8.0, 13.0)


def test_holes_are_bare_and_as_wide_as_said() -> None:
    for seed, arena in zip(MANY[:4], arenas(), strict=False):
        box, rng = arena.bounds, rng_of(seed)
        bed = beds.beds_in(arena, box, beds.LARGE, (9.0, 14.0), beds.BED, beds.HEIGHT, 1.5, rng)
        holed = beds.holed(bed, box, rng)
        assert len(holed.holes) >= 1
        turn = np.arange(36) * math.pi / 18.0
        for x, y, radius in holed.holes:
            assert 2.0 <= 2.0 * radius <= 6.0
            inner, outer = (
                (x + share * radius * np.cos(turn), y + share * radius * np.sin(turn))
                for share in (0.89, 1.2)
            )
            assert (holed.share(*inner) == 0.0).all()
            assert (holed.share(*outer) > 0.0).mean() > 0.6


@pytest.mark.slow
def test_a_border_cuts_the_reef() -> None:
    for seed in MANY:
        world = made("reef/border", seed)
        x, y, _ = world.targets.position.astype(np.float64).T
        box = world.bounds
        away = np.min([x - box.x_min, box.x_max - x, y - box.y_min, box.y_max - y], axis=0)
        assert away.min() < 0.3
        assert away.max() <= 9.2


@pytest.mark.slow
@pytest.mark.parametrize("seed", MANY)
def test_walls_cut_reefs_and_leave_passages_to_every_part(seed: int) -> None:
    rng = rng_of(seed)
    arena = arena_in(rng)
    found = rocks.walls_in(arena, rocks.WALLS, rng)
    assert all(1.0 <= wall.height <= 2.5 for wall in found.walls)
    if seed > 4:
        return
    world = made("reef/walls", seed)
    # So low over the bed that no wall can be passed above.
    low = dataclasses.replace(DREAM_V2, altitude=0.8)
    solids = Solids(world)
    lattice = solids.lattice(low)
    assert lattice.reachable.mean() > 0.85
    # What is free and not reached is the inside of a wall or of a boulder, and has its top above it.
    for x, y in lattice.positions[lattice.free & ~lattice.reachable]:
        inside = (x, y, float(world.terrain.height(x, y)) + low.altitude)
        above, _ = solids.ranges(inside, [[0.0, 0.0, 1.0]], limit=5.0)
        assert np.isfinite(above).all()


def test_walls_are_as_high_as_they_are_said_to_be() -> None:
    for seed in (1, 2, 3):
        world = made("reef/walls", seed)
        for k in range(len(world.obstacles)):
            mesh = world.meshes[world.obstacles.mesh[k]]
            if len(mesh.vertices) % 6 or not np.array_equal(world.obstacles.scale[k], [1, 1, 1]):
                continue
            points = mesh.vertices.astype(float) + world.obstacles.position[k]
            over = points[:, 2] - world.terrain.height(points[:, 0], points[:, 1])
            assert 0.9 <= over.max() <= 2.5 + 0.6


def test_rocks_are_no_higher_than_two_metres() -> None:
    for seed, arena in zip(MANY, arenas(), strict=True):
        found = rocks.rocks_in(arena, np.empty((0, 3)), rng_of(seed))
        assert len(found.rocks) >= 8
        assert all(0.5 <= rock.top <= 2.0 for rock in found.rocks)
        for rock in found.rocks:
            assert all(math.hypot(rock.x - s.x, rock.y - s.y) >= rock.radius + 3.05 for s in arena.starts)


@pytest.mark.slow
def test_two_habitats_lie_in_two_parts() -> None:
    kinds = set()
    for seed in MANY:
        world = made("reef/two", seed)
        slopes = np.hypot(*np.gradient(world.terrain.heights.astype(float), SPACING))
        kinds.add((bool(slopes.max() > 1.0), world.group_radius))
        box = world.bounds
        along = world.targets.position[:, 0 if box.width > box.depth else 1].astype(float)
        longer = max(box.width, box.depth)
        # Somewhere about the middle, nothing grows for four metres, but for what a ledge sways.
        middle = np.sort(along[np.abs(along) < 0.3 * longer])
        assert np.diff(middle, prepend=-0.3 * longer, append=0.3 * longer).max() > (
            2.0 if slopes.max() > 1.0 else 4.0
        )
    assert len(kinds) == 4


def test_only_reefs_of_dream_v1_age_or_lie_about_a_wreck() -> None:
    with pytest.raises(ValueError, match="expected a reef of dream-v1"):
        make_world("reef/tiny+1y1", 1)
    with pytest.raises(ValueError, match="no world"):
        make_world("wreck/1+reef/tiny", 1)


def test_the_least_radius_of_a_group_survives_the_disk_and_counts_for_the_hash(tmp_path: Path) -> None:
    usual = small_arena()
    other = dataclasses.replace(usual, group_radius=0.4)
    assert usual.group_radius == 1.5
    assert world_hash(other) != world_hash(usual)
    save_world(other, tmp_path)
    again = load_world(tmp_path)
    assert again.group_radius == 0.4
    assert world_hash(again) == world_hash(other)
    content = json.loads((tmp_path / "world.json").read_text())
    del content["group_radius"]
    (tmp_path / "world.json").write_text(json.dumps(content))
    assert world_hash(load_world(tmp_path)) == world_hash(usual)


@pytest.mark.parametrize("radius", [0.04, 50.5, math.nan, -1.0])
def test_a_radius_that_no_group_has_is_refused(radius: float) -> None:
    found = list(problems(dataclasses.replace(small_arena(), group_radius=radius)))
    assert found == [f"group_radius: expected 0.05 to 50 m, got {radius:g}"]


@pytest.mark.parametrize("seen", [3.0, 4.2, 7.0, 7.3, 10.0, 10.5, 12.0, 14.9, 15.0, 20.0])
def test_water_of_a_visibility_is_that_clear(seen: float) -> None:
    water = water_of(seen)
    assert water.attenuation_length == pytest.approx(seen / 1.7, rel=1e-4)
    assert water.name == f"visibility {seen:g} m"
    murkier = water_of(0.9 * seen)
    assert all(a < b for a, b in zip(water.attenuation, murkier.attenuation, strict=True))


@pytest.mark.parametrize("name", list(WATERS))
def test_water_of_the_visibility_of_a_named_type_is_that_type(name: str) -> None:
    known = WATERS[name]
    found = water_of(known.visibility)
    for field in ("attenuation", "backscatter", "veil"):
        assert getattr(found, field) == pytest.approx(getattr(known, field), abs=2e-6)
    assert found.particles == pytest.approx(known.particles, abs=1e-3)


def test_murky_water_keeps_the_colour_of_the_murkiest_type() -> None:
    bay, soup = WATERS["turbid"], water_of(0.5 * WATERS["turbid"].visibility)
    assert soup.attenuation == pytest.approx([2.0 * a for a in bay.attenuation], abs=2e-6)
    assert soup.backscatter == pytest.approx([2.0 * b for b in bay.backscatter], abs=2e-6)
    assert soup.veil == bay.veil


@pytest.mark.parametrize("seen", [0.5, 31.0, math.nan])
def test_no_water_is_so_clear_or_so_murky(seen: float) -> None:
    with pytest.raises(ValueError, match="visibility: expected 1 to 30 m"):
        water_of(seen)


def test_a_box_is_widened_on_all_sides() -> None:
    assert Bounds(0.0, 1.0, 4.0, 7.0).widened(2.0) == Bounds(-2.0, -1.0, 6.0, 9.0)
    assert Bounds(0.0, 1.0, 4.0, 7.0).area == 24.0
