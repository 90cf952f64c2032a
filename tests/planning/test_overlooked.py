"""What may have been overlooked on the ground: the looks that are kept, and what they leave."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dream.geometry import SE3, camera_mount
from dream.mapping import OccupancyMap
from dream.planning.space.in_water import DOUBTED, LEFT, MISSED, SEARCHED, STANDS, TOLD, InWater
from dream.planning.space.overlooked import MISSED as MISSES
from dream.planning.space.overlooked import PARTS, Overlooked
from dream.protocol import DREAM_V2 as ERRING
from dream.protocol import DREAM_V2_TRUE as PROTOCOL
from dream.types import Decision, Observation
from tests.planning.standing import BOUNDS, SEABED, forget, middles_in, mission, observed, solid, vote, water

Array = np.ndarray[Any, Any]
HEIGHT = 3.5
SPOT = 0.6, 0.4
DOWN = math.radians(45.0)


def looking(x: float, y: float, yaw: float, height: float = HEIGHT, tilt: float = DOWN) -> Observation:
    """A frame of a level seabed."""
    camera = PROTOCOL.camera
    pose, mount = SE3.level(x, y, SEABED + height, yaw), camera_mount(tilt)
    rays = camera.back_project(np.ones((camera.height, camera.width)), SE3.level(0.0, 0.0, 0.0, yaw) @ mount)
    depth = np.where(rays[..., 2] < -1e-3, -height / np.minimum(rays[..., 2], -1e-3), np.nan)
    depth[~(depth < PROTOCOL.max_depth)] = np.nan
    return replace(observed(x, y, SEABED + height, yaw), depth=depth, T_world_base=pose, T_base_camera=mount)


def looking_at(spot: tuple[float, float], bearing: float, angle: float) -> Observation:
    """A frame of a spot from a bearing as seen from it, at an angle to the vertical; radians."""
    away = HEIGHT * math.tan(angle)
    at = spot[0] + away * math.cos(bearing), spot[1] + away * math.sin(bearing)
    return looking(*at, math.remainder(bearing + math.pi, 2.0 * math.pi))


def after(*frames: Observation) -> Overlooked:
    looks = Overlooked(mission())
    for frame in frames:
        looks.take(frame)
    return looks


def left_at(looks: Overlooked, spot: tuple[float, float] = SPOT) -> float:
    row, col = OccupancyMap(BOUNDS, PROTOCOL).cell_of(*spot)
    return float(looks.share[row, col])


def law(angle: float) -> float:
    """What one look leaves."""
    return MISSES * (1.0 - math.cos(angle)) ** 2


@pytest.mark.rare
def test_looks_are_kept_as_a_plain_loop_would() -> None:
    frames = [looking(-2.0, 1.0, 0.4), looking(3.0, -2.0, 2.5, height=2.0, tilt=math.radians(20.0))]
    kept = np.zeros((PARTS, *OccupancyMap(BOUNDS, PROTOCOL).shape))
    for frame in frames:
        points = frame.camera.back_project(frame.depth, frame.T_world_camera)
        for point in points[np.isfinite(points).all(axis=-1)]:
            way = frame.T_world_camera.translation - point
            away = float(np.linalg.norm(way))
            col, row = np.floor((point[:2] - [BOUNDS.x_min, BOUNDS.y_min]) / PROTOCOL.cell).astype(int)
            if away > PROTOCOL.reach or not (0 <= row < kept.shape[1] and 0 <= col < kept.shape[2]):
                continue
            part = int(math.atan2(way[1], way[0]) % (2.0 * math.pi) / (2.0 * math.pi) * PARTS)
            kept[part, row, col] = max(kept[part, row, col], way[2] / away)
    assert (kept > 0.0).sum() > 1000
    # A ray along the edge of a cell or of an eighth may fall to either side.
    assert (np.abs(after(*frames)._steepest - kept) > 1e-5).mean() < 1e-3


@pytest.mark.parametrize("angle", [20.0, 40.0, 55.0])
def test_a_look_leaves_more_the_more_slanted_it_is(angle: float) -> None:
    assert left_at(after()) == 1.0
    left = left_at(after(looking_at(SPOT, 0.3, math.radians(angle))))
    # The cell's own steepest pixel lies up to half its diagonal nearer.
    assert law(math.radians(angle - 4.0)) < left <= law(math.radians(angle + 0.5))


def test_looks_from_different_sides_multiply_and_of_those_from_one_the_steepest_counts() -> None:
    one, other = looking_at(SPOT, 0.3, math.radians(40.0)), looking_at(SPOT, 2.3, math.radians(50.0))
    assert left_at(after(one, other)) == pytest.approx(left_at(after(one)) * left_at(after(other)), rel=1e-5)
    slanted = looking_at(SPOT, 0.35, math.radians(55.0))
    assert left_at(after(slanted, one)) == left_at(after(one, slanted)) == left_at(after(one))


def test_beyond_the_reach_nothing_is_looked_at() -> None:
    angle = math.acos(HEIGHT / (PROTOCOL.reach + 0.3))
    assert left_at(after(looking_at(SPOT, 0.3, angle))) == 1.0


@pytest.fixture
def searched() -> tuple[InWater, Any]:
    """A search of a square all of which was seen, a quarter of it told to be target."""
    over, every = InWater(mission()), np.ones(OccupancyMap(BOUNDS, PROTOCOL).shape, np.bool_)
    over.told[: every.shape[0] // 2, : every.shape[1] // 2] = True
    return over, SimpleNamespace(seen=every.copy(), observed=every.copy(), to_see=every.copy())


def test_what_is_missed_is_told_by_the_looks_at_targets(searched: tuple[InWater, Any]) -> None:
    over, occupancy = searched
    assert over.missed(occupancy) == 1.0
    one = law(math.radians(50.0))
    over.left[:] = one
    assert over.missed(occupancy) == pytest.approx(one)
    assert not over.searched(occupancy)[over.told].any()
    assert over.searched(occupancy)[~over.told].all()
    # Looks at bare ground add nothing.
    over.left[~over.told] = 0.0
    assert over.missed(occupancy) == pytest.approx(one)
    over.left[:] = one**2
    assert over.missed(occupancy) == pytest.approx(one**2)
    assert one**2 < MISSED < one
    assert one**2 < SEARCHED < one
    assert over.searched(occupancy).all()


def test_unseen_ground_holds_what_lies_beside_it(searched: tuple[InWater, Any]) -> None:
    over, occupancy = searched
    over.left[:] = 0.0
    assert over.missed(occupancy) == 0.0
    hole = np.s_[:6, :6]
    occupancy.seen[hole] = over.told[hole] = False
    over.left[hole] = 1.0
    assert over.missed(occupancy) == pytest.approx(36 / (over.told.sum() + 36))
    over.told[hole] = occupancy.seen[:] = True
    over.left[:], bare = 0.0, np.s_[-6:, -6:]
    occupancy.seen[bare], over.left[bare] = False, 1.0
    assert over.missed(occupancy) == 0.0
    occupancy.seen[:] = False
    assert over.missed(occupancy) == 1.0


def test_targets_are_told_where_a_twentieth_of_the_votes_is_for_them() -> None:
    volume, frame = water(), looking(0.0, 0.0, 0.0)
    occupancy = OccupancyMap(BOUNDS, PROTOCOL)
    occupancy.volume = volume
    over, patch = InWater(mission()), occupancy.cell_of(2.0, 2.0)
    found = []
    for share in (0.0, 0.5 * TOLD, 1.5 * TOLD):
        vote(volume, middles_in((1.0, 1.0, SEABED - PROTOCOL.cell), (3.0, 3.0, SEABED)), share)
        occupancy._look_from_above(0.0, 0.0, SEABED + 2.0)
        occupancy._changed()
        over.take(frame, occupancy)
        assert not over.told[occupancy.cell_of(-2.0, -2.0)]
        found.append(bool(over.told[patch]))
        # No cell has most of its votes for target.
        assert not occupancy.target.any()
    assert found == [False, False, True]


def test_what_stands_up_is_to_be_looked_at_from_all_around_unless_depths_are_estimated() -> None:
    volume, frame = water(), looking(0.0, 0.0, 0.0)
    solid(volume, (1.5, -0.5, SEABED), (2.5, 0.5, SEABED + 1.0))
    occupancy = OccupancyMap(BOUNDS, PROTOCOL)
    occupancy.volume = volume
    occupancy._look_from_above(0.0, 0.0, SEABED + 2.0)
    occupancy._changed()
    told, by_sight, rock = InWater(mission()), InWater(mission()), occupancy.cell_of(2.0, 0.0)
    assert occupancy.solid[rock]
    told.take(frame, occupancy)
    by_sight.take(replace(frame, error=np.full_like(frame.depth, 0.1)), occupancy)
    assert told.left[rock] == 1.0 - 1.0 / STANDS
    assert by_sight.left[rock] == by_sight.overlooked.share[rock] < 0.2
    bare = occupancy.seen & ~occupancy.solid
    assert np.array_equal(told.left[bare], by_sight.left[bare])


def test_by_sight_ground_that_was_looked_at_is_searched_also_where_the_map_has_a_hole() -> None:
    volume, frame, hole = water(), looking(0.0, 0.0, 0.0), (3.0, 0.0)
    forget(volume, (2.0, -1.0, SEABED - PROTOCOL.cell), (4.0, 1.0, SEABED))
    occupancy = OccupancyMap(BOUNDS, PROTOCOL)
    occupancy.volume = volume
    occupancy._look_from_above(0.0, 0.0, SEABED + 2.0)
    occupancy._changed()
    cell = occupancy.cell_of(*hole)
    assert not occupancy.seen[cell]
    hiding = np.zeros(occupancy.shape, np.bool_)
    hiding[cell] = True
    for error, searched in ((None, False), (np.full_like(frame.depth, 0.1), True)):
        over = InWater(mission())
        over.take(replace(frame, error=error), occupancy)
        assert over.searched(occupancy)[cell] == searched
        assert (over.share_in_holes(hiding, occupancy) == 0.0) == searched


def test_it_ends_when_little_ground_is_unseen_and_little_is_missed(searched: tuple[InWater, Any]) -> None:
    over, occupancy = searched
    nothing = np.zeros(occupancy.seen.shape, np.bool_)
    assert not over.enough(nothing, occupancy)
    over.left[:] = law(math.radians(40.0)) ** 2
    assert over.enough(nothing, occupancy)
    # A hole wide enough to be gone back for, in bare ground: of the whole it is too much.
    side = math.ceil(math.sqrt(LEFT * occupancy.seen.size)) + 1
    hiding = nothing.copy()
    hiding[-side:, -side:] = True
    occupancy.observed[-side:, -side:] = False
    assert not over.enough(hiding, occupancy)
    left = side**2 / occupancy.seen.size
    words = (
        f"{left:.1%} of the ground that can be seen lies in holes wider than 1 m, and 0.2% of all individuals"
    )
    told = over.ended(Decision(done=True), hiding, occupancy)
    assert told.done
    assert told.reasoning.completion.startswith(words)
    occupancy.observed[-side:, -side:] = True
    assert over.enough(hiding, occupancy)


def test_the_map_to_a_pilot_tells_what_is_still_to_be_seen_of_each_cell() -> None:
    occupancy = OccupancyMap(BOUNDS, PROTOCOL)
    occupancy.volume = water()
    occupancy._look_from_above(0.0, 0.0, SEABED + 2.0)
    occupancy._changed()
    over = InWater(mission())
    once, twice, bare = ((20, 20), (24, 20), (20, 24))
    over.told[once] = over.told[twice] = True
    over.left[once] = over.left[bare] = 2.0 * SEARCHED
    over.left[twice] = 0.5 * SEARCHED
    near = over.from_above(occupancy)
    assert occupancy.seen[once]
    assert near.unseen[once] == np.float32(2.0 * SEARCHED)
    assert near.unseen[twice] == near.unseen[bare] == 0.0
    assert (near.unseen[~occupancy.seen] == 1.0).all()
    assert np.array_equal(near.seen, near.unseen == 0.0)
    assert np.array_equal(occupancy.unseen, ~occupancy.seen)


def test_what_stands_up_is_to_be_looked_at_from_four_sides() -> None:
    volume = water()
    solid(volume, (SPOT[0] - 0.5, SPOT[1] - 0.5, SEABED), (SPOT[0] + 0.5, SPOT[1] + 0.5, SEABED + 1.5))
    occupancy = OccupancyMap(BOUNDS, PROTOCOL)
    occupancy.volume = volume
    occupancy._look_from_above(0.0, 0.0, SEABED + 2.0)
    occupancy._changed()
    rock, bare = occupancy.cell_of(*SPOT), occupancy.cell_of(SPOT[0] + 1.5, SPOT[1])
    assert occupancy.solid[rock]
    assert not occupancy.solid[bare]
    over, found = InWater(mission()), []
    for number in range(STANDS):
        over.take(looking_at(SPOT, 0.3 + 0.5 * math.pi * number, math.radians(30.0)), occupancy)
        found.append(float(over.left[rock]))
        assert over.left[bare] == pytest.approx(float(over.overlooked.share[bare]))
    assert found[:-1] == [1.0 - (number + 1) / STANDS for number in range(STANDS - 1)]
    assert found[-1] == pytest.approx(float(over.overlooked.share[rock]))
    assert found[-1] < SEARCHED


def test_small_pieces_are_looked_at_last_beside_a_large_one() -> None:
    volume, frame = water(), looking(0.0, 0.0, 0.0)
    occupancy = OccupancyMap(BOUNDS, ERRING)
    occupancy.volume = volume
    large, small = occupancy.cell_of(-1.5, -1.5), occupancy.cell_of(3.0, 3.0)

    def taken(radius: float) -> InWater:
        over = InWater(replace(mission(), protocol=replace(ERRING, group_radius=radius)))
        occupancy._look_from_above(0.0, 0.0, SEABED + 2.0)
        occupancy._changed()
        over.take(frame, occupancy)
        return over

    vote(volume, middles_in((2.7, 2.7, SEABED - PROTOCOL.cell), (3.3, 3.3, SEABED)), 1.0)
    alone = taken(1.1)
    assert alone.told[small]
    assert not alone.doubted.any()
    vote(volume, middles_in((-4.0, -4.0, SEABED - PROTOCOL.cell), (1.0, 1.0, SEABED)), 1.0)
    beside = taken(1.1)
    assert beside.told[large]
    assert beside.doubted[small]
    assert not beside.doubted[large]
    beside.left[small] = 1.0
    assert beside.from_above(occupancy).unseen[small] == np.float32(DOUBTED)
    # What may go on where nothing was seen has no size yet.
    piece = np.nonzero(beside.doubted)
    known = occupancy.seen.copy()
    known[piece[0].max() + 1, piece[1].max()] = False
    assert not beside._doubted(known).any()
    # No wider than a piece of wrong labels, a group is not known by its size.
    assert not taken(0.4).doubted.any()
