"""The search over moves: its slow twin, and what its paths mean."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise

import numpy as np
import pytest

from dream.control import guard, setpoint
from dream.geometry import SE2, Bounds
from dream.lattice import lattice_of
from dream.mapping import OccupancyMap, check_completion
from dream.planning._kernels.moves import keep_to
from dream.planning._kernels.search import search
from dream.planning.travel import Travel, careful_travel, nearest_open, travel_from
from dream.protocol import DREAM_V1
from dream.types import Decision
from tests.mapping.analytic import map_with

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
    reached = np.flatnonzero(travel.steps >= 0).tolist()
    fast = {DREAM_V1.snap(travel.lattice.world(pose)): int(travel.steps[pose]) for pose in reached}
    assert fast == slow
    assert max(slow.values()) >= 3


@pytest.mark.parametrize("seed", range(5))
def test_every_pose_is_reached_from_the_first_that_leads_there(seed: int) -> None:
    """The queue by hand, over moves at random."""
    generator = np.random.default_rng(seed)
    lattice = lattice_of(Bounds(1.0, -2.0, 5.0, 1.0), DREAM_V1)
    node = int(lattice.graph.grid[3, 4])
    start = lattice.pose_at(node, 2)
    edges = generator.random((lattice.poses, len(DREAM_V1.advances))) < 0.15
    good = generator.random(lattice.nodes) < 0.8
    good[node] = seed % 2
    free = edges.astype(np.uint8)
    keep_to(free, lattice.graph, good, node)
    steps, parent, nearest = search(lattice.graph, free, start)
    came = {start: -1}
    queue = deque([start])
    while queue:
        here = queue.popleft()
        at, heading = lattice.node_of(here), lattice.heading_of(here)
        for turn in DREAM_V1.turns:
            to = lattice.pose_at(int(at), (heading + turn) % DREAM_V1.headings)
            ends = [to]
            for end, is_free in zip(lattice.graph.ahead[to].tolist(), edges[to], strict=True):
                leaves = good[at] or at == node
                if is_free and leaves and end >= 0 and good[lattice.node_of(end)]:
                    ends.append(end)
            for end in ends:
                if end not in came:
                    came[end] = here
                    queue.append(end)
    assert len(came) > 100
    for pose in range(lattice.poses):
        before = came.get(pose, -1)
        assert parent[pose] == before
        assert (steps[pose] >= 0) == (pose in came)
        assert before < 0 or steps[pose] == steps[before] + 1
    fewest = np.where(steps < 0, len(steps), steps).reshape(lattice.nodes, -1).min(axis=1)
    np.testing.assert_array_equal(nearest, np.where(fewest == len(steps), -1, fewest))
    assert (nearest == -1).any()


def test_following_a_path_by_its_moves_ends_where_it_says(travel: Travel) -> None:
    goal = int(np.flatnonzero(travel.steps == travel.steps.max())[0])
    path = travel.path(goal)
    assert len(path) == travel.steps[goal] + 1
    pose = START
    for before, after in pairwise(path):
        turn, advance = travel.move(before, after)
        end = setpoint(pose, Decision(turn, advance), DREAM_V1)
        pose = SE2(end.x, end.y, end.yaw)
    assert travel.lattice.pose(pose) == goal
    np.testing.assert_allclose((pose.x, pose.y), travel.lattice.position(goal))


def test_a_way_to_a_position_ends_there_in_the_fewest_steps(travel: Travel) -> None:
    for node in np.flatnonzero(travel.reached)[::5].tolist():
        path = travel.path_to_node(node)
        assert travel.lattice.node_of(path[-1]) == node
        steps = travel.steps_to(np.array([node]))[0]
        assert len(path) - 1 == travel.nearest[node] == steps[steps >= 0].min()


def test_ground_never_seen_is_not_reached(travel: Travel) -> None:
    x, y = travel.lattice.positions[travel.reached].T
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
        for heading in range(DREAM_V1.headings):
            for k, advance in enumerate(DREAM_V1.advances):
                turn = heading * DREAM_V1.heading_step
                end = setpoint(SE2(here.x, here.y, turn), Decision(0.0, advance), DREAM_V1)
                passes = occupancy.passable(np.array([[here.x, here.y]]), np.array([[end.x, end.y]]))[0]
                at = travel.lattice.pose(SE2(here.x, here.y, turn))
                assert passes or not travel.free[at, k]
                narrow += not passes
    assert narrow


def test_a_search_is_made_once_for_a_pose_and_a_standoff_until_the_map_changes() -> None:
    known = OccupancyMap(Bounds(-10.0, -10.0, 10.0, 10.0), DREAM_V1)
    known.clear_launch(0.0, 0.0)
    first = travel_from(START, known)
    assert travel_from(SE2(START.x, START.y, START.yaw), known) is first
    # The guard looks at a first move from exactly where the vehicle is.
    for other in (travel_from(SE2(START.x + 1e-3, START.y, START.yaw), known), careful_travel(START, known)):
        assert other is not first
    known.clear_launch(3.5, 1.0)
    assert travel_from(START, known).reached.sum() > first.reached.sum()


@pytest.mark.parametrize("seed", range(4))
def test_the_nearest_open_region_is_the_one_whose_edge_is_fewest_steps_away(seed: int) -> None:
    generator = np.random.default_rng(seed)
    target, explored = np.zeros((2, 96, 96), np.bool_)
    for row, col in generator.integers(0, 94, (12, 2)):
        target[row : row + 3, col : col + 3] = True
    explored[10:86, 10:86] = True
    explored[generator.random(explored.shape) < 0.01] = False
    occupancy = map_with(explored=explored, target=target)
    completion, travel = check_completion(occupancy, START), travel_from(START, occupancy)
    reached = np.flatnonzero(travel.reached)
    fewest = []
    for region in completion.regions:
        steps = [math.inf]
        for x, y in np.stack(occupancy.center_of(*region.open_cells.T), axis=-1):
            away = np.hypot(*(travel.lattice.positions[reached] - (x, y)).T)
            # Of several that are as near any may be asked.
            steps.append(travel.nearest[reached][away <= away.min() + 1e-9].min())
        fewest.append(steps)
    found = nearest_open(completion, travel, occupancy)
    assert found is not None
    at = [region is found for region in completion.regions].index(True)
    assert min(fewest[at]) == min(map(min, fewest))
    assert sum(not region.enclosed for region in completion.regions) > 3


def test_where_all_regions_are_enclosed_none_is_the_nearest_open() -> None:
    target = np.zeros((96, 96), np.bool_)
    target[50:53, 60:64] = True
    occupancy = map_with(explored=np.ones_like(target), target=target)
    travel = travel_from(START, occupancy)
    assert nearest_open(check_completion(occupancy, START), travel, occupancy) is None
