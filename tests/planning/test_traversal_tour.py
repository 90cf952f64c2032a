"""The tour over what is left to traverse: each kernel against a slow twin, and what a tour promises."""

from __future__ import annotations

import itertools
import math
from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import minimum_spanning_tree

from dream.geometry import SE2, Bounds
from dream.lattice import Pose, lattice_of
from dream.mapping import OccupancyMap, traversal_margin
from dream.planning._kernels import search as kernels
from dream.planning._kernels.moves import FREE, UNKNOWN
from dream.planning.travel import Travel, careful_travel
from dream.planning.traversal_tour import HORIZON, TraversalTour
from dream.protocol import POOL_V1
from dream.traversal import traversed
from dream.types import BoolArray, Mission
from tests.mapping.test_traversed import SIDE, START, TANK, cells, tank

MISSION = Mission(POOL_V1, TANK, 200)
NEAR = (POOL_V1.traversal or 0.0) - traversal_margin(POOL_V1)
LINE = np.s_[30, 40:52]
"""Cells ahead of `START`."""


def planned(
    target: BoolArray, occupancy: OccupancyMap | None = None, pose: SE2 = START
) -> tuple[TraversalTour, list[Pose], Travel]:
    occupancy = tank(target) if occupancy is None else occupancy
    walk, travel = TraversalTour(MISSION), careful_travel(pose, occupancy)
    return walk, walk.plan(np.argwhere(target), travel, travel.free), travel


def passed_from(pose: Pose, travel: Travel) -> BoolArray:
    """The slow twin of a footprint: every cell by itself."""
    here = travel.lattice.world(pose)
    col, row = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    east, north = TANK.x_min + (col + 0.5) * POOL_V1.cell, TANK.y_min + (row + 0.5) * POOL_V1.cell
    margin = traversal_margin(POOL_V1)
    return traversed(east - here.x, north - here.y, here.yaw, POOL_V1, margin=margin)


def test_a_walk_traverses_the_cells_that_its_poses_do_but_for_its_start() -> None:
    walk, path, travel = planned(cells(LINE))
    expected = np.zeros((SIDE, SIDE), np.bool_)
    for pose in path[1:]:
        expected |= passed_from(pose, travel)
    np.testing.assert_array_equal(walk.traverses(path), expected)
    # At the bounds the footprint is cut off, not wrapped around.
    edge = travel.lattice.pose_at(travel.lattice.graph.grid[0, 3], 7)
    np.testing.assert_array_equal(walk.traverses([edge, edge]), passed_from(edge, travel))


def test_a_walk_leaves_nothing_and_every_move_of_it_is_free() -> None:
    generator = np.random.default_rng(1)
    for _ in range(4):
        target = np.zeros((SIDE, SIDE), np.bool_)
        target[tuple(generator.integers(2, SIDE - 2, (2, 40)))] = True
        walk, path, travel = planned(target)
        assert not (target & ~walk.traverses(path)).any()
        assert path[0] == travel.start
        for before, after in itertools.pairwise(path):
            assert before != after
            advance = travel.lattice.advance_to(before, after)
            if advance is None:
                assert travel.lattice.node_of(before) == travel.lattice.node_of(after)
            else:
                assert travel.free[travel.lattice.turned_to(before, after), advance]


@pytest.mark.parametrize("past", [40, 44, 48, 52])
def test_straight_ahead_a_walk_takes_no_step_too_many(past: int) -> None:
    walk, path, _ = planned(cells(np.s_[30, 34:past]))
    middle = TANK.x_min + (past - 0.5) * POOL_V1.cell
    away = math.sqrt(NEAR**2 - (0.5 * POOL_V1.cell) ** 2)
    assert len(path) - 1 == max(math.ceil((middle - away) / max(POOL_V1.advances) - 1e-9), 1)
    assert len(walk.path) == len(path)


def test_what_lies_behind_takes_one_turn() -> None:
    _, path, travel = planned(cells(np.s_[30, 19:21]))
    assert len(path) == 2
    assert travel.lattice.node_of(path[1]) == travel.lattice.node_of(travel.start)


def test_a_walk_is_gone_on_with_to_its_end() -> None:
    target = cells(np.s_[30, 40:52], np.s_[44:50, 20], np.s_[10, 10:14])
    walk, path, _ = planned(target)
    left, pose = target.copy(), START
    occupancy = tank(target)
    steps = 0
    while left.any():
        travel = careful_travel(pose, occupancy)
        ahead = walk.plan(np.argwhere(left), travel, travel.free)
        assert len(ahead) <= len(path) - steps, "never farther than it was"
        left &= ~passed_from(ahead[1], travel)
        pose = travel.lattice.world(ahead[1])
        steps += 1
    assert steps <= len(path) - 1


def test_no_walk_leads_to_what_is_out_of_reach() -> None:
    target = cells(np.s_[2, 2])
    occupancy = tank(target)
    occupancy._write("log_odds", (0, 0), 20 * cells(np.s_[:16, 15], np.s_[15, :16]))
    walk, path, travel = planned(target, occupancy)
    assert path == [travel.start]
    assert not walk.traverses(path).any()
    both = cells(np.s_[2, 2], np.s_[30, 48])
    _, path, _ = planned(both, occupancy)
    assert len(path) > 1


def test_the_first_move_is_known_to_be_free_and_later_ones_need_not_be() -> None:
    target = cells(np.s_[30, 52])
    travel = careful_travel(START, tank(target))
    unknown = np.where(travel.free, UNKNOWN, 0).astype(np.uint8)
    path = TraversalTour(MISSION).plan(np.argwhere(target), travel, unknown)
    start, first, *_, last = travel.lattice.node_of(path).tolist()
    assert first == start, "it can only turn"
    assert last != start, "and then goes on"
    known, here = unknown.copy(), travel.lattice.node_of(np.arange(travel.lattice.poses)) == start
    known[here] = np.minimum(unknown[here], FREE)
    ahead = TraversalTour(MISSION).plan(np.argwhere(target), travel, known)
    assert len(ahead) == len(path) - 1


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 1000))
def test_ways_to_parts_are_breadth_first(seed: int) -> None:
    generator = np.random.default_rng(seed)
    lattice = lattice_of(Bounds(0.0, 0.0, 0.55, 0.55), POOL_V1)
    ahead = lattice.graph.ahead
    moves = ((generator.random(ahead.shape) < 0.1) & (ahead >= 0)).astype(np.uint8)
    reached = generator.random(lattice.nodes) < 0.7
    spots = np.unique(generator.integers(0, 12, (6, 2)), axis=0) + 0.5
    part_of, near = generator.integers(0, 3, len(spots)), 3.2
    ways = kernels.ways_to(part_of, 3, spots, lattice.graph, moves, reached, near)
    for part in range(3):
        count = np.zeros(lattice.nodes, int)
        for spot in spots[part_of == part]:
            count += (np.hypot(*(lattice.graph.place - spot).T) <= near) & reached
        away = np.full(lattice.nodes, kernels.NO_WAY)
        if count.max() > 0:
            away[count == count.max()] = 0
        todo = deque(np.flatnonzero(away == 0).tolist())
        while todo:
            node = todo.popleft()
            for heading in range(POOL_V1.headings):
                pose = lattice.pose_at(node, heading)
                for to in lattice.node_of(ahead[pose][moves[pose] > 0]).tolist():
                    if away[to] == kernels.NO_WAY:
                        away[to] = away[node] + 1
                        todo.append(to)
        np.testing.assert_array_equal(ways[part], away)
    between = kernels.ways_between(ways)
    for i, k in np.ndindex(3, 3):
        at = ways[i] == 0
        assert between[i, k] == (ways[k][at].min() if at.any() else kernels.NO_WAY)


@given(st.integers(1, 7), st.integers(0, 1000))
def test_the_tree_is_the_shortest(n: int, seed: int) -> None:
    between = np.random.default_rng(seed).integers(1, 50, (8, 8))
    between = np.minimum(between, between.T)
    which = np.random.default_rng(seed).permutation(8)
    part = between[np.ix_(which[:n], which[:n])].astype(float)
    assert kernels.tree(between, which, n) == minimum_spanning_tree(np.triu(part, 1)).sum()


def test_the_search_stops_at_its_horizon() -> None:
    assert len(planned(cells(np.s_[2:58:4, 2:58:4]))[1]) - 1 <= HORIZON


def test_near_a_place_are_the_cells_whose_middles_are_surely_traversed_from_there() -> None:
    places = np.array([[-1.1, 0.4], [0.6, -0.7]])
    every = np.argwhere(cells(np.s_[:, :]))
    x, y = TANK.x_min + (every[:, 1] + 0.5) * POOL_V1.cell, TANK.y_min + (every[:, 0] + 0.5) * POOL_V1.cell
    away = np.hypot(x[:, None] - places[:, 0], y[:, None] - places[:, 1]).min(axis=1)
    near = TraversalTour(MISSION)._near(every, places)
    assert 0 < len(near) < len(every)
    np.testing.assert_array_equal(near, every[away <= NEAR])
