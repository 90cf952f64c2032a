"""The search over moves: its slow twin, and what its paths mean."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise

import numpy as np
import pytest

from dream.control import guard, setpoint
from dream.geometry import SE2, Bounds
from dream.mapping import OccupancyMap
from dream.mapping.lattice import offsets_of
from dream.planning._kernels.search import keep_to, search
from dream.planning.travel import UNREACHED, Travel, travel_from
from dream.protocol import DREAM_V1
from dream.types import Decision

START = SE2(0.5, -0.5, math.pi / 2)


@pytest.fixture(scope="module")
def occupancy() -> OccupancyMap:
    """Two launch discs that overlap: an hourglass of free ground, and nothing else known."""
    known = OccupancyMap(Bounds(-10.0, -10.0, 10.0, 10.0), DREAM_V1)
    known.clear_launch(0.0, 0.0)
    known.clear_launch(3.5, 1.0)
    return known


@pytest.fixture(scope="module")
def travel(occupancy: OccupancyMap) -> Travel:
    return travel_from(START, occupancy)


def _slow_steps(occupancy: OccupancyMap) -> dict[SE2, int]:
    """Breadth-first search that asks the guard about every single move."""
    steps = {START: 0}
    queue = deque([START])
    while queue:
        here = queue.popleft()
        for turn in DREAM_V1.turn_angles:
            for advance in (0.0, *DREAM_V1.advances):
                asked = Decision(turn, advance)
                if guard(asked, here, occupancy, DREAM_V1).decision != asked:
                    continue
                goal = setpoint(here, asked, DREAM_V1)
                pose = DREAM_V1.snap(SE2(goal.x, goal.y, goal.yaw))
                if pose not in steps:
                    steps[pose] = steps[here] + 1
                    queue.append(pose)
    return steps


def test_steps_equal_a_slow_search_through_the_guard(occupancy: OccupancyMap, travel: Travel) -> None:
    slow = _slow_steps(occupancy)
    rows, cols, headings = np.nonzero(travel.steps >= 0)
    fast = {}
    for row, col, heading in zip(rows, cols, headings, strict=True):
        x, y = travel.position(row, col)
        pose = DREAM_V1.snap(SE2(float(x), float(y), heading * DREAM_V1.heading_step))
        fast[pose] = int(travel.steps[row, col, heading])
    assert fast == slow
    assert max(slow.values()) >= 3


@pytest.mark.parametrize("seed", range(5))
def test_every_pose_is_reached_from_the_first_that_leads_there(seed: int) -> None:
    """The queue by hand, over moves at random."""
    generator = np.random.default_rng(seed)
    rows, cols, headings, start = 7, 9, DREAM_V1.headings, (3, 4, 2)
    offsets = offsets_of(DREAM_V1)
    edges = generator.random((rows, cols, *offsets.shape[:2])) < 0.15
    good = generator.random((rows, cols)) < 0.8
    good[start[:2]] = seed % 2
    free = edges.astype(np.uint8)
    keep_to(free, offsets, good, *start[:2])
    steps, parent, nearest = search(free, offsets, np.array(DREAM_V1.turns), *start)
    came: dict[tuple[int, int, int], tuple[int, int, int] | None] = {start: None}
    queue = deque([start])
    while queue:
        row, col, heading = here = queue.popleft()
        for turn in DREAM_V1.turns:
            to = (heading + turn) % headings
            ends = [(row, col, to)]
            for (east, north), is_free in zip(offsets[to], edges[row, col, to], strict=True):
                end = row + int(north), col + int(east), to
                inside = 0 <= end[0] < rows and 0 <= end[1] < cols
                leaves = good[row, col] or (row, col) == start[:2]
                if is_free and leaves and inside and good[end[:2]]:
                    ends.append(end)
            for end in ends:
                if end not in came:
                    came[end] = here
                    queue.append(end)
    assert len(came) > 100
    for pose in np.ndindex(rows, cols, headings):
        before = came.get(pose)
        expected = -1 if before is None else int(np.ravel_multi_index(before, parent.shape))
        assert parent[pose] == expected
        assert (steps[pose] >= 0) == (pose in came)
        assert before is None or steps[pose] == steps[before] + 1
    np.testing.assert_array_equal(nearest, np.where(steps < 0, UNREACHED, steps).min(axis=2))
    assert (nearest == UNREACHED).any()


def test_following_a_path_by_its_moves_ends_where_it_says(travel: Travel) -> None:
    rows, cols, headings = np.nonzero(travel.steps == travel.steps.max())
    goal = (int(rows[0]), int(cols[0]), int(headings[0]))
    path = travel.path(goal)
    assert len(path) == travel.steps[goal] + 1
    pose = START
    for before, after in pairwise(path):
        turn, advance = travel.move(before, after)
        end = setpoint(pose, Decision(turn, advance), DREAM_V1)
        pose = SE2(end.x, end.y, end.yaw)
    np.testing.assert_allclose((pose.x, pose.y), travel.position(goal[0], goal[1]))
    assert DREAM_V1.heading_index(pose.yaw) == goal[2]


def test_ground_never_seen_is_not_reached(travel: Travel) -> None:
    rows, cols = np.nonzero(travel.reached)
    x, y = travel.position(rows, cols).T
    near = np.minimum(np.hypot(x, y), np.hypot(x - 3.5, y - 1.0))
    assert near.max() <= DREAM_V1.launch_radius - DREAM_V1.body_radius
    assert (x > 3.0).any(), "the second disc is reached through the first"


def test_a_first_move_is_one_that_the_guard_lets_pass_from_where_the_vehicle_is(
    occupancy: OccupancyMap,
) -> None:
    """It swims: it is never quite on the lattice, and the guard looks from there."""
    rng, narrow = np.random.default_rng(0), 0
    for _ in range(40):
        x, y = rng.uniform(-0.2, 0.2, 2)
        here = SE2(2.0 + x, 0.5 + y, 0.0)
        travel = travel_from(here, occupancy)
        row, col, _ = travel.start
        for heading in range(DREAM_V1.headings):
            for k, advance in enumerate(DREAM_V1.advances):
                turn = heading * DREAM_V1.heading_step
                end = setpoint(SE2(here.x, here.y, turn), Decision(0.0, advance), DREAM_V1)
                passes = occupancy.passable(np.array([[here.x, here.y]]), np.array([[end.x, end.y]]))[0]
                assert passes or not travel.free[row, col, heading, k]
                narrow += not passes
    assert narrow
