from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from dream.geometry import SE2, Bounds
from dream.protocol import DREAM_V1
from dream.protocol import DREAM_V2_TRUE as DREAM_V2
from dream.sim.solids import FreeSpace, Solids
from dream.sim.world import Mesh, World
from tests.sim.arenas import EYE, FLOOR, HALF, arena, flat, placed

Array = npt.NDArray[np.float64]


def soup(rng: np.random.Generator, count: int) -> World:
    """Random triangles of all sizes in a random landscape."""
    centres = np.column_stack(
        [rng.uniform(-HALF, HALF, (count, 2)), rng.uniform(FLOOR - 0.5, FLOOR + 3, count)]
    )
    vertices = (
        centres[:, None] + rng.normal(size=(count, 3, 3)) * rng.uniform(0.05, 1.2, (count, 1, 1))
    ).reshape(-1, 3)
    mesh = Mesh(
        vertices.astype(np.float32),
        np.arange(3 * count, dtype=np.int32).reshape(-1, 3),
        np.zeros((3 * count, 3), np.uint8),
    )
    ground = flat()
    heights = (ground.heights + rng.uniform(-0.8, 0.8, ground.heights.shape)).astype(np.float32)
    return replace(
        arena(placed(0, [[0, 0, 0]], 1.0), terrain=replace(ground, heights=heights)), meshes=(mesh,)
    )


def all_triangles(world: World) -> Array:
    """(T, 3, 3) of the first mesh, where it is, and of the two halves of every square of the terrain."""
    mesh = world.meshes[0]
    z = world.terrain.heights.astype(np.float64)
    rows, cols = z.shape
    x = world.terrain.x0 + np.arange(cols) * world.terrain.spacing
    y = world.terrain.y0 + np.arange(rows) * world.terrain.spacing
    points = np.dstack([*np.meshgrid(x, y), z])
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    ground = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)
    return np.concatenate([mesh.vertices.astype(np.float64)[mesh.faces], ground])


def slow_sight(triangles: Array, eye: Array, point: Array) -> bool:
    """No triangle is crossed up to a millimetre before the end: one 3 × 3 solve each."""
    ray = point - eye
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    columns = np.stack([np.broadcast_to(-ray, a.shape), b - a, c - a], axis=-1)
    sound = np.abs(np.linalg.det(columns)) > 1e-12
    t, u, v = np.linalg.solve(columns[sound], (eye - a[sound])[..., None])[..., 0].T
    end = 1.0 - 1e-3 / np.linalg.norm(ray)
    return not ((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < end)).any()


def slow_clearance(triangles: Array, x: float, y: float, low: float, high: float) -> float:
    """Cut each triangle within 4 m by both planes (Sutherland and Hodgman), measure to what remains."""
    best = math.inf
    heights, away = triangles[..., 2], triangles[..., :2] - (x, y)
    near = (away.max(axis=1) > -4.0).all(axis=1) & (away.min(axis=1) < 4.0).all(axis=1)
    for triangle in triangles[near & (heights.max(axis=1) >= low) & (heights.min(axis=1) <= high)]:
        polygon = list(triangle)
        for sign, level in ((1.0, low), (-1.0, high)):
            cut = []
            for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True):
                dp, dq = sign * (p[2] - level), sign * (q[2] - level)
                if dp >= 0:
                    cut.append(p)
                if dp * dq < 0:
                    cut.append(p + (q - p) * dp / (dp - dq))
            polygon = cut
        if not polygon:
            continue
        corners = np.array(polygon)[:, :2] - (x, y)
        following = np.roll(corners, -1, axis=0)
        turn = corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]
        if len(corners) > 2 and ((turn > 0).all() or (turn < 0).all()):
            return 0.0
        side = following - corners
        length = np.maximum((side**2).sum(axis=1), 1e-300)
        part = np.clip(-(corners * side).sum(axis=1) / length, 0.0, 1.0)
        best = min(best, float(np.hypot(*(corners + part[:, None] * side).T).min()))
    return best


def test_a_wall_hides_exactly_what_lies_in_its_shadow() -> None:
    # A wall 1 m high from x = 3 to 4; the eye is 2 m up: its shadow ends 8 m off.
    solids = Solids(arena(placed(0, [[3.5, 0, FLOOR]], [1, 4, 1])))
    along = np.array([2.99, 3.5, 4.2, 6.0, 7.99, 8.01, 10.0])
    points = np.column_stack([along, np.zeros(7), np.full(7, FLOOR)])
    clear = solids.line_of_sight([0, 0, EYE], points)
    assert clear.tolist() == [True, False, False, False, False, True, True]
    # The wall ends at y = 2; its near corner, at x = 3, casts the shadow's edge.
    edge = 6.0 * 2.0 / 3.0
    beside = [[6.0, edge - 0.01, FLOOR], [6.0, edge + 0.01, FLOOR]]
    assert solids.line_of_sight([0, 0, EYE], beside).tolist() == [False, True]


def test_a_low_boulder_is_seen_over() -> None:
    boulder = placed(0, [[3.5, 0, FLOOR]], [1, 4, 1])
    tall = placed(0, [[3.5, 0, FLOOR]], [1, 4, 2.5])
    point = [[8.5, 0.0, FLOOR]]
    assert Solids(arena(boulder)).line_of_sight([0, 0, EYE], point).all()
    assert not Solids(arena(tall)).line_of_sight([0, 0, EYE], point).any()


def test_a_hill_hides_what_lies_behind_it() -> None:
    ground = flat()
    x = ground.x0 + ground.spacing * np.arange(ground.heights.shape[1])
    ridge = np.where(np.abs(x - 5.0) < 0.1, 1.0, 0.0).astype(np.float32)
    solids = Solids(arena(terrain=replace(ground, heights=ground.heights + ridge)))
    # The crest at x = 5 is 1 m high and the eye 2 m: the shadow ends at x = 10.
    points = [[4.0, 0, FLOOR], [7.0, 0, FLOOR], [9.9, 0, FLOOR], [10.1, 0, FLOOR]]
    assert solids.line_of_sight([0, 0, EYE], points).tolist() == [True, False, False, True]


def test_a_point_under_the_ground_is_not_seen() -> None:
    clear = Solids(arena()).line_of_sight([0, 0, EYE], [[0, 0, FLOOR - 0.01], [0, 0, FLOOR]])
    assert clear.tolist() == [False, True]


@pytest.mark.parametrize("seed", range(3))
def test_line_of_sight_agrees_with_every_triangle_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = soup(rng, 60)
    solids, triangles = Solids(world), all_triangles(world)
    eye = np.array([*rng.uniform(-5, 5, 2), EYE])
    xy = rng.uniform(-HALF, HALF, (60, 2))
    points = np.column_stack([xy, world.terrain.height(*xy.T) + rng.uniform(0.02, 2.5, 60)])
    points[:10, :2] = eye[:2] + rng.uniform(-0.01, 0.01, (10, 2))
    clear = solids.line_of_sight(eye, points)
    assert clear.tolist() == [slow_sight(triangles, eye, point) for point in points]
    assert 0 < clear.sum() < 60


@pytest.mark.parametrize("seed", range(3))
def test_clearance_agrees_with_every_triangle_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(10 + seed)
    world = soup(rng, 60)
    # A body low enough to meet the rough ground itself, too.
    low = replace(DREAM_V1, altitude=0.9)
    solids, triangles = Solids(world), all_triangles(world)
    for x, y in rng.uniform(-HALF, HALF, (8, 2)):
        z = float(world.terrain.height(x, y)) + low.altitude
        slow = slow_clearance(triangles, x, y, z - 0.5 * low.body_height, z + 0.5 * low.body_height)
        assert solids.clearance(x, y, low, limit=3.0) == pytest.approx(
            min(slow - low.body_radius, 3.0), abs=1e-9
        )


def test_the_body_touches_a_wall_that_is_nearer_than_its_radius() -> None:
    solids = Solids(arena(placed(0, [[2.0, 0, FLOOR]], [2, 6, 4])))
    assert solids.clearance(1.0 - 0.36, 0.0, DREAM_V1) == pytest.approx(0.01)
    assert solids.clearance(1.0 - 0.34, 0.0, DREAM_V1) == pytest.approx(-0.01)
    assert solids.free([[0.64, 0.0], [0.66, 0.0]], DREAM_V1).tolist() == [True, False]
    assert solids.clearance(-10.0, 0.0, DREAM_V1, limit=4.0) == 4.0


@pytest.mark.parametrize(("height", "touches"), [(1.79, False), (1.81, True)])
def test_the_body_passes_over_what_stays_below_it(height: float, touches: bool) -> None:
    solids = Solids(arena(placed(0, [[3.0, 0, FLOOR]], [1, 1, height])))
    sweep = solids.sweep(SE2(0, 0, 0), SE2(6, 0, 0), DREAM_V1)
    assert sweep.contact is touches
    if touches:
        # The wall begins at x = 2.5.
        assert 6.0 * sweep.free == pytest.approx(2.5 - DREAM_V1.body_radius, abs=1e-4)
    else:
        assert sweep.free == 1.0
        assert sweep.clearance == 5.0


def test_a_cliff_stops_the_body() -> None:
    ground = flat()
    x = ground.x0 + ground.spacing * np.arange(ground.heights.shape[1])
    cliff = np.where(x > 4.9, 3.0, 0.0).astype(np.float32)
    solids = Solids(arena(terrain=replace(ground, heights=ground.heights + cliff)))
    sweep = solids.sweep(SE2(0, 0, 0), SE2(4.4, 0, 0), DREAM_V1)
    # From x = 4.5 to 5 the ground rises by 3 m; the body's lower edge, 1.8 m up, meets it at x = 4.8.
    assert sweep.free == 1.0
    assert sweep.clearance == pytest.approx(4.8 - 4.4 - DREAM_V1.body_radius, abs=1e-3)
    sweep = solids.sweep(SE2(0, 0, 0), SE2(4.5, 0, 0), DREAM_V1)
    assert 4.5 * sweep.free == pytest.approx(4.8 - DREAM_V1.body_radius, abs=1e-3)


def test_a_sweep_tells_the_least_clearance_on_the_way() -> None:
    solids = Solids(arena(placed(0, [[3.0, 2.0, FLOOR]], [1, 1, 4])))
    sweep = solids.sweep(SE2(0, 0, 0), SE2(6, 0, 0), DREAM_V1)
    assert sweep.free == 1.0
    assert sweep.clearance == pytest.approx(1.5 - DREAM_V1.body_radius)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_there_and_back_agree_about_contact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rocks = placed(
        0, np.column_stack([rng.uniform(-8, 8, (20, 2)), np.full(20, FLOOR)]), rng.uniform(1, 3, (20, 3))
    )
    solids = Solids(arena(rocks))
    a, b = (SE2(float(x), float(y), 0.0) for x, y in rng.uniform(-8, 8, (2, 2)))
    there, back = solids.sweep(a, b, DREAM_V1), solids.sweep(b, a, DREAM_V1)
    assert there.contact == back.contact
    if not there.contact:
        assert there.clearance == pytest.approx(back.clearance, abs=1e-9)
    else:
        # Coming from both sides, the free stretches do not overlap.
        assert there.free + back.free <= 1.0


def test_the_lattice_knows_what_is_free_and_what_can_be_reached() -> None:
    # Four walls around a yard of 4 × 4 m, 0.2 m thick and taller than the vehicle flies.
    walls = placed(
        0,
        [[6, 8, FLOOR], [6, 4, FLOOR], [4, 6, FLOOR], [8, 6, FLOOR]],
        [[4.2, 0.2, 4], [4.2, 0.2, 4], [0.2, 4.2, 4], [0.2, 4.2, 4]],
    )
    solids = Solids(arena(walls))
    lattice = solids.lattice(DREAM_V1)
    assert lattice.positions[0, 0].tolist() == [-HALF, -HALF]
    assert lattice.positions[-1, -1].tolist() == [HALF, HALF]
    assert (lattice.free.ravel() == solids.free(lattice.positions.reshape(-1, 2), DREAM_V1)).all()
    yard = (np.abs(lattice.positions - 6.0) < 1.5).all(axis=-1)
    assert lattice.free[yard].all()
    assert not lattice.reachable[yard].any()
    outside = (np.abs(lattice.positions - 6.0) > 2.6).any(axis=-1)
    assert lattice.reachable[outside].all()
    assert (lattice.reachable <= lattice.free).all()


def test_every_reachable_move_is_a_free_sweep() -> None:
    """The short cuts that the search of the lattice takes change nothing."""
    rng = np.random.default_rng(4)
    where = rng.uniform(-8, 8, (60, 2))
    where = where[np.hypot(*where.T) > 2.2]
    sizes = rng.uniform([1, 1, 1.4], [2.6, 2.6, 3], (len(where), 3))
    rocks = placed(0, np.column_stack([where, np.full(len(where), FLOOR)]), sizes)
    solids = Solids(replace(arena(rocks), bounds=Bounds(-6, -6, 6, 6)))
    lattice = solids.lattice(DREAM_V1)
    nodes = [tuple(n) for n in np.argwhere(lattice.free)]
    start = (round(-lattice.first[1]), round(-lattice.first[0]))
    moves = {DREAM_V1.offset(h, a) for h in range(12) for a in DREAM_V1.advances}
    done, waiting = {start} & set(nodes), list({start} & set(nodes))
    while waiting:
        row, col = waiting.pop()
        for east, north in moves:
            to = (row + north, col + east)
            if to in done or to not in nodes:
                continue
            a, b = (SE2(float(x), float(y), 0.0) for x, y in lattice.positions[[row, to[0]], [col, to[1]]])
            if solids.sweep(a, b, DREAM_V1).free == 1.0:
                done.add(to)
                waiting.append(to)
    assert {tuple(n) for n in np.argwhere(lattice.reachable)} == done
    assert 50 < len(done) < len(nodes)


def test_bad_input_is_refused() -> None:
    solids = Solids(arena())
    with pytest.raises(ValueError, match=r"eye: expected \(3,\), got \(2,\)"):
        solids.line_of_sight([0, 0], [[0, 0, 0]])
    with pytest.raises(ValueError, match=r"points: expected \(N, 3\), got \(3,\)"):
        solids.line_of_sight([0, 0, 0], [0, 0, 0])
    with pytest.raises(ValueError, match=r"points: expected finite numbers, got .*nan.* in row 2"):
        solids.line_of_sight([0, 0, 0], [[0.0, 0.0, 0.0], [0.0, math.nan, 0.0]])
    with pytest.raises(ValueError, match="position: expected finite"):
        solids.clearance(math.nan, 0.0, DREAM_V1)


def slow_range(triangles: Array, eye: Array, way: Array) -> tuple[float, float]:
    """The nearest of all triangles along a ray, one 3 × 3 solve each, and its cosine of incidence."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    columns = np.stack([np.broadcast_to(-way, a.shape), b - a, c - a], axis=-1)
    sound = np.flatnonzero(np.abs(np.linalg.det(columns)) > 1e-12)
    t, u, v = np.linalg.solve(columns[sound], (eye - a[sound])[..., None])[..., 0].T
    met = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
    if not np.isfinite(met).any():
        return math.inf, math.nan
    k = sound[met.argmin()]
    normal = np.cross(b[k] - a[k], c[k] - a[k])
    return float(met.min()), float(abs(normal @ way) / np.linalg.norm(normal))


def test_ranges_are_those_of_all_triangles() -> None:
    rng = np.random.default_rng(11)
    world = soup(rng, 150)
    solids, triangles = Solids(world), all_triangles(world)
    met = 0
    for _ in range(60):
        eye = np.array([*rng.uniform(-HALF, HALF, 2), rng.uniform(FLOOR + 1.0, FLOOR + 6.0)])
        ways = rng.normal(size=(5, 3))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        fast, cosines = solids.ranges(eye, ways, limit=40.0)
        for way, distance, cosine in zip(ways, fast, cosines, strict=True):
            slow = slow_range(triangles, eye, way)
            if slow[0] > 40.0:
                assert distance == math.inf
                assert math.isnan(cosine)
                continue
            met += 1
            assert distance == pytest.approx(slow[0], abs=1e-6)
            assert cosine == pytest.approx(slow[1], abs=1e-6)
    assert met > 100


def test_what_a_large_triangle_meets_far_off_may_lie_behind_a_small_one() -> None:
    # A ramp that the ray meets at x = 0 and that lies over the cell where it starts; a sliver at x = −2.
    ramp = [[-5.0, -6.0, -10.0], [-5.0, 6.0, -10.0], [7.0, 0.0, -5.2]]
    sliver = [[-2.0, -0.3, -8.3], [-2.0, 0.3, -8.3], [-2.0, 0.0, -7.5]]
    for parts, distance in (([ramp], 4.0), ([ramp, sliver], 2.0)):
        vertices = np.array(parts, np.float32).reshape(-1, 3)
        faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
        mesh = Mesh(vertices, faces, np.zeros((len(vertices), 3), np.uint8))
        solids = Solids(replace(arena(placed(0, [[0, 0, 0]], 1.0)), meshes=(mesh,)))
        found = solids.ranges([-4.0, 0.0, -8.0], [[1.0, 0.0, 0.0]], limit=20.0)[0]
        assert found == pytest.approx(distance)


def test_a_range_ends_at_the_limit_and_at_the_edge_of_the_terrain() -> None:
    solids = Solids(arena())
    down = [[0.0, 0.0, -2.0]]
    assert solids.ranges([0, 0, EYE], down, limit=5.0)[0] == pytest.approx(EYE - FLOOR)
    assert solids.ranges([0, 0, EYE], down, limit=1.9)[0] == math.inf
    assert solids.ranges([HALF + 30.0, 0, EYE], down, limit=5.0)[0] == math.inf
    slanted = solids.ranges([0, 0, EYE], [[1.0, 0.0, -1.0]], limit=5.0)
    assert slanted[0] == pytest.approx(math.sqrt(2.0) * (EYE - FLOOR))
    assert slanted[1] == pytest.approx(math.sqrt(0.5))
    with pytest.raises(ValueError, match="lengths above 0"):
        solids.ranges([0, 0, EYE], [[0.0, 0.0, 0.0]], limit=5.0)


def in_terrain(world: World, x: float, y: float, z: float) -> bool:
    return z <= float(world.terrain.height(x, y))


@pytest.mark.parametrize("seed", range(3))
def test_clearance_at_any_height_agrees_with_every_triangle_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(20 + seed)
    world = soup(rng, 60)
    solids, triangles = Solids(world), all_triangles(world)
    points = np.column_stack([rng.uniform(-HALF, HALF, (12, 2)), rng.uniform(FLOOR - 2, FLOOR + 5, 12)])
    half = 0.5 * DREAM_V1.body_height
    expected = []
    for x, y, z in points:
        buried = in_terrain(world, x, y, z - half)
        slow = 0.0 if buried else slow_clearance(triangles, x, y, z - half, z + half)
        expected.append(min(slow - DREAM_V1.body_radius, 3.0))
        assert solids.clearance_at([x, y, z], DREAM_V1, limit=3.0) == pytest.approx(expected[-1], abs=1e-9)
    free = [distance > 0.0 for distance in expected]
    assert solids.free_at(points, DREAM_V1).tolist() == free
    assert 0 < sum(free) < len(free)


@pytest.mark.parametrize(
    ("z", "touches"),
    [
        # A slab 0.1 m thick, 3 m up; the body's half height is 0.2 m.
        (FLOOR + 2.79, False),
        (FLOOR + 2.81, True),
        (FLOOR + 3.29, True),
        (FLOOR + 3.31, False),
        # The ground, from above and from within.
        (FLOOR + 0.21, False),
        (FLOOR + 0.19, True),
        (FLOOR - 3.0, True),
    ],
)
def test_the_body_is_touched_from_above_and_from_below(z: float, touches: bool) -> None:
    solids = Solids(arena(placed(0, [[0, 0, FLOOR + 3.0]], [4, 4, 0.1])))
    assert solids.free_at([[0.3, 0.2, z]], DREAM_V1).tolist() == [not touches]
    assert (solids.clearance_at([0.3, 0.2, z], DREAM_V1) <= 0.0) is touches


def test_a_climb_ends_under_a_slab_and_a_dive_on_the_ground() -> None:
    solids = Solids(arena(placed(0, [[0, 0, FLOOR + 3.0]], [4, 4, 0.05])))
    up = solids.sweep_through([0, 0, FLOOR + 1.0], [0, 0, FLOOR + 5.0], DREAM_V1)
    assert up.contact
    assert 4.0 * up.free == pytest.approx(1.8, abs=1e-4)
    down = solids.sweep_through([0, 0, FLOOR + 1.0], [3.0, 0, FLOOR - 3.0], DREAM_V1)
    assert 4.0 * down.free == pytest.approx(0.8, abs=1e-4)
    # Past the slab's edge, 2 m off, by a hand's breadth.
    beside = solids.sweep_through([2.45, 0, FLOOR + 1.0], [2.45, 0, FLOOR + 5.0], DREAM_V1)
    assert not beside.contact
    assert beside.clearance == pytest.approx(0.1, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_ways_in_space_agree_there_and_back_and_with_the_many_at_once(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solids = Solids(soup(rng, 80))
    a, b = np.column_stack([rng.uniform(-8, 8, (2, 2)), rng.uniform(FLOOR + 0.5, FLOOR + 4.5, 2)])
    there, back = solids.sweep_through(a, b, DREAM_V1), solids.sweep_through(b, a, DREAM_V1)
    assert there.contact == back.contact
    assert solids.passes_through([a, b], [b, a], DREAM_V1).tolist() == [not there.contact] * 2
    if not there.contact:
        assert there.clearance == pytest.approx(back.clearance, abs=1e-9)


def test_a_level_way_over_level_ground_is_the_planar_one() -> None:
    rng = np.random.default_rng(7)
    rocks = placed(
        0, np.column_stack([rng.uniform(-8, 8, (20, 2)), np.full(20, FLOOR)]), rng.uniform(1, 3, (20, 3))
    )
    solids = Solids(arena(rocks))
    starts, ends = rng.uniform(-8, 8, (40, 2)), rng.uniform(-8, 8, (40, 2))
    level = np.full((40, 1), EYE)
    passed = solids.passes(starts, ends, DREAM_V1)
    through = solids.passes_through(np.hstack([starts, level]), np.hstack([ends, level]), DREAM_V1)
    assert through.tolist() == passed.tolist()
    assert 0 < passed.sum() < 40


def nodes_of(space: FreeSpace, which: npt.NDArray[np.bool_]) -> Array:
    """(K, 3) metres."""
    level, row, col = np.nonzero(which)
    return (np.array(space.first) + np.column_stack([col, row, level])) * space.spacing


def test_free_space_keeps_to_the_heights_of_the_protocol() -> None:
    # A block 3 m high and 2 m wide; the surface is at z = 0 and the seabed at −10 m.
    world = arena(placed(0, [[2.0, 0, FLOOR]], [2, 2, 3]))
    space = Solids(world).free_space(DREAM_V2)
    nodes = nodes_of(space, space.reachable)
    away = np.abs(nodes[:, :2] - (2.0, 0.0)).max(axis=1)
    over, far = nodes[away < 1.0], nodes[away > 2.5]
    # 0.8 m over ground, and 5 m over ground or over the block; 0.2 m of the body are below its centre.
    assert (far[:, 2].min(), far[:, 2].max()) == (-9.0, -5.0)
    assert (over[:, 2].min(), over[:, 2].max()) == (-6.5, -2.0)
    shallow = replace(world, terrain=replace(world.terrain, heights=world.terrain.heights + 6.0))
    high = Solids(shallow).free_space(DREAM_V2)
    assert nodes_of(high, high.reachable)[:, 2].max() == -0.5


def test_every_place_that_is_reached_in_space_is_reached_by_free_sweeps() -> None:
    # A room with a door in its roof, one without, and rocks about.
    walls = [
        (1.75, 0, 0.2, 3.2, 3.0),
        (-1.75, 0, 0.2, 3.2, 3.0),
        (0, 1.75, 3.7, 0.2, 3.0),
        (0, -1.75, 3.7, 0.2, 3.0),
    ]
    boxes = [(2.5 + x, y - 2.5, FLOOR, w, d, h) for x, y, w, d, h in walls]
    boxes += [(-2.5 + x, y + 2.5, FLOOR, w, d, h) for x, y, w, d, h in walls]
    boxes += [(-2.5, 2.5, FLOOR + 3.0, 3.7, 3.7, 0.1), (3.5, -2.5, FLOOR + 3.0, 1.7, 3.7, 0.1)]
    boxes += [(-3.0, -3.0, FLOOR, 1.3, 1.1, 1.6), (3.2, 3.1, FLOOR, 1.2, 1.4, 2.6)]
    rows = np.array(boxes)
    world = replace(arena(placed(0, rows[:, :3], rows[:, 3:])), bounds=Bounds(-4.5, -4.5, 4.5, 4.5))
    solids = Solids(world)
    # Fewer moves than the protocol has: all of them are tried below.
    assert DREAM_V2.space is not None
    fewer = replace(DREAM_V2, advances=(1.0,), space=replace(DREAM_V2.space, climbs=(-0.5, 0.5)))
    space = solids.free_space(fewer)
    assert space.free[space.reachable].all()
    index = {tuple(n): k for k, n in enumerate(np.argwhere(space.free))}
    ahead = {fewer.offset(h, a) for h in range(12) for a in (0.0, *fewer.advances)}
    moves = [(round(c / 0.5), n, e) for e, n in ahead for c in fewer.climbs if (e, n, c) != (0, 0, 0.0)]
    at = (np.argwhere(space.free)[:, ::-1] + np.array(space.first)) * space.spacing
    pairs = [
        (k, index[to])
        for n, k in index.items()
        for move in moves
        if (to := tuple(int(v) for v in np.add(n, move))) in index
    ]
    starts, ends = np.array(pairs).T
    passed = solids.passes_through(at[starts], at[ends], DREAM_V2)
    graph = coo_matrix((np.ones(int(passed.sum())), (starts[passed], ends[passed])), shape=(len(at), len(at)))
    _, part = connected_components(graph, directed=False)
    start = index[tuple(np.rint(np.array([-8.0, 0.0, 0.0]) / 0.5).astype(int) - np.array(space.first)[::-1])]
    assert (space.reachable[space.free] == (part == part[start])).all()
    inside = (np.abs(at[:, :2] - (-2.5, 2.5)) < 1.6).all(axis=1) & (at[:, 2] < FLOOR + 3.0)
    below_door = (np.abs(at[:, :2] - (2.5, -2.5)) < 1.6).all(axis=1) & (at[:, 2] < FLOOR + 2.0)
    assert inside.sum() > 20
    assert not space.reachable[space.free][inside].any()
    assert space.reachable[space.free][below_door].all()


def test_only_a_protocol_in_space_has_free_space() -> None:
    with pytest.raises(ValueError, match="one that moves in space, got dream-v1"):
        Solids(arena()).free_space(DREAM_V1)
