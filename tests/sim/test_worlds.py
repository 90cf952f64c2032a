from __future__ import annotations

import itertools
import math

import numpy as np
import numpy.typing as npt
import pytest

from dream.protocol import DREAM_V1
from dream.sim.files import world_hash
from dream.sim.habitats import HABITATS
from dream.sim.sampling import rotated
from dream.sim.world import World
from dream.sim.worlds import BUILDERS, WORLDS, make_world
from tests.sim.made import made

SEEDS = range(11, 20)


def wreck(number: int) -> World:
    return made(f"wreck/{number}")


def patch(seed: int) -> World:
    """A cheap family with boulders like the others'."""
    return made("reef/patch", seed)


def formations(world: World) -> dict[int, npt.NDArray[np.float64]]:
    """All vertices of each formation of boulders, in the world."""
    table = world.obstacles
    parts: dict[int, list[npt.NDArray[np.float64]]] = {}
    for k in range(len(table)):
        points = (
            rotated(table.wxyz[k], world.meshes[table.mesh[k]].vertices * table.scale[k]) + table.position[k]
        )
        parts.setdefault(int(table.group[k]), []).append(points)
    return {number: np.concatenate(points) for number, points in parts.items()}


def gap(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> float:
    """Metres over ground between two sets of vertices."""
    dx, dy = a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1]
    return math.sqrt(float((dx * dx + dy * dy).min()))


def test_every_name_of_the_protocol_page_has_a_world() -> None:
    reefs = [f"reef/{kind}" for kind in ("fringing", "string", "patch", "mixed", "L", "S", "O", "K", "E")]
    wrecks = [f"wreck/{k}" for k in range(1, 6)]
    assert set(WORLDS) == {*reefs, *wrecks, "pool/arc", "flat/empty", *HABITATS}
    assert tuple(BUILDERS) == WORLDS


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("name", "seed", "digits"),
    [
        ("reef/string", 4, "90d9502b3d8c572f"),
        ("reef/mixed", 3, "9779918a0c680b97"),
        ("reef/K", 2, "3844eaa2fe6b5cb8"),
        ("wreck/4", 2, "dc4dab90c1849c42"),
        ("wreck/2+reef/mixed", 3, "2e2af325ace8cad4"),
    ],
)
def test_worlds_of_square_arenas_are_what_they_were(name: str, seed: int, digits: str) -> None:
    assert world_hash(made(name, seed))[:16] == digits


def test_an_unknown_world_is_answered_with_the_nearest_name() -> None:
    with pytest.raises(ValueError, match=r'no world "reef/fringe"\. Did you mean "reef/fringing"'):
        make_world("reef/fringe", 1)


@pytest.mark.parametrize("seed", [-1, 2**63, 10**30])
def test_a_seed_that_a_saved_world_cannot_hold_is_refused(seed: int) -> None:
    with pytest.raises(ValueError, match=f"seed: expected 0 to {2**63 - 1}, got {seed}"):
        make_world("flat/empty", seed)


def test_the_largest_seed_makes_a_world() -> None:
    assert make_world("flat/empty", 2**63 - 1).seed == 2**63 - 1


def test_arenas_come_in_three_sizes_centred_at_the_origin() -> None:
    boxes = [patch(seed).bounds for seed in SEEDS]
    assert {box.width for box in boxes} == {40.0, 45.0, 50.0}
    assert all((box.x_min, box.y_min) == (-box.x_max, -box.y_max) and box.depth == box.width for box in boxes)


def test_some_missions_begin_in_the_middle_and_some_near_an_edge() -> None:
    away = [max(abs(patch(s).starts[0].x), abs(patch(s).starts[0].y)) / patch(s).bounds.x_max for s in SEEDS]
    assert min(away) < 0.25
    assert max(away) > 0.65


def test_at_least_half_of_the_formations_bar_the_way() -> None:
    for seed in SEEDS:
        world = patch(seed)
        rises = []
        for points in formations(world).values():
            ground = world.terrain.height(points[:, 0].mean(), points[:, 1].mean())
            rises.append(points[:, 2].max() - ground > 2.4)
        assert 6 <= len(rises) <= 16
        assert 2 * sum(rises) >= len(rises)


def test_a_tall_formation_is_still_broad_where_the_vehicle_passes() -> None:
    for seed in SEEDS:
        for points in formations(patch(seed)).values():
            ground = float(patch(seed).terrain.height(points[:, 0].mean(), points[:, 1].mean()))
            level = points[np.abs(points[:, 2] - ground - DREAM_V1.altitude) < 0.25]
            if points[:, 2].max() - ground > 2.4:
                assert np.ptp(level[:, 0]) > 0.6


def test_formations_leave_passages_and_a_ring_leaves_ways_out() -> None:
    rings = 0
    for seed in SEEDS:
        world = patch(seed)
        start = np.array([[world.starts[0].x, world.starts[0].y]])
        places = formations(world)
        ring = {k for k, points in places.items() if gap(points, start) < 5.0}
        rings += len(ring) >= 4
        for (j, a), (k, b) in itertools.combinations(places.items(), 2):
            if math.hypot(*(a.mean(axis=0) - b.mean(axis=0))[:2]) > 8.0:
                continue
            assert gap(a, b) >= (1.6 if {j, k} <= ring else 2.0)
    assert 1 <= rings <= 7


def test_obstacles_stand_in_the_ground() -> None:
    for seed in SEEDS:
        world = patch(seed)
        for points in formations(world).values():
            lowest = points[np.argmin(points[:, 2])]
            assert lowest[2] < world.terrain.height(lowest[0], lowest[1])


def test_the_bare_seabed_is_gentle() -> None:
    for seed in SEEDS:
        heights = patch(seed).terrain.heights.astype(np.float64)
        slopes = np.hypot(*np.gradient(heights, patch(seed).terrain.spacing))
        assert abs(np.median(heights) + 10.0) < 0.2
        assert np.abs(heights + 10.0).max() < 0.9
        assert np.percentile(slopes, 98) < 0.2


@pytest.mark.parametrize("number", [1, 5])
def test_a_vehicle_can_go_all_round_a_wreck(number: int) -> None:
    world = wreck(number)
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for k in range(len(world.targets)):
        points = (world.meshes[world.targets.mesh[k]].vertices + world.targets.position[k])[:, :2]
        low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    box = world.bounds
    assert box.contains(float(low[0]), float(low[1]), 3.999)
    assert box.contains(float(high[0]), float(high[1]), 3.999)
    assert world.hull.all()
    assert (world.targets.scale == 1.0).all()


def test_neighbouring_patches_of_a_hull_share_their_vertices() -> None:
    world = wreck(1)
    corners = [
        np.rint(
            (world.meshes[world.targets.mesh[k]].vertices.astype(float) + world.targets.position[k]) * 1000.0
        )
        for k in range(len(world.targets))
    ]
    seen: dict[tuple[float, ...], set[int]] = {}
    for k, points in enumerate(corners):
        for point in np.unique(points, axis=0):
            seen.setdefault(tuple(point.tolist()), set()).add(k)
    shared = sum(len(owners) > 1 for owners in seen.values())
    assert shared > 0.3 * len(seen)
