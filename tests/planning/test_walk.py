"""The walk over what is left to traverse: each kernel against a slow twin, and what a walk promises."""

from __future__ import annotations

import itertools
import math
from collections import deque

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import minimum_spanning_tree

from dream.geometry import SE2
from dream.mapping import OccupancyMap, traversal_margin
from dream.mapping.lattice import offsets_of
from dream.planning._kernels import walk as kernels
from dream.planning._kernels.lookahead import FREE, UNKNOWN
from dream.planning.travel import Pose, Travel, careful_travel
from dream.planning.walk import HORIZON, Walk
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
) -> tuple[Walk, list[Pose], Travel]:
    occupancy = tank(target) if occupancy is None else occupancy
    walk, travel = Walk(MISSION), careful_travel(pose, occupancy)
    return walk, walk.plan(np.argwhere(target), travel, travel.free), travel


def passed_from(pose: Pose, travel: Travel) -> BoolArray:
    """The slow twin of a footprint: every cell by itself."""
    x, y = travel.position(pose[0], pose[1])
    col, row = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    east, north = TANK.x_min + (col + 0.5) * POOL_V1.cell - x, TANK.y_min + (row + 0.5) * POOL_V1.cell - y
    yaw = pose[2] * POOL_V1.heading_step
    return traversed(east, north, yaw, POOL_V1, margin=traversal_margin(POOL_V1))


def test_a_walk_traverses_the_cells_that_its_poses_do_but_for_its_start() -> None:
    walk, path, travel = planned(cells(LINE))
    expected = np.zeros((SIDE, SIDE), np.bool_)
    for pose in path[1:]:
        expected |= passed_from(pose, travel)
    np.testing.assert_array_equal(walk.traverses(path), expected)
    # At the bounds the footprint is cut off, not wrapped around.
    edge = (0, 3, 7)
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
            turn, advance = travel.move(before, after)
            assert turn or advance
            if advance:
                assert travel.free[(*before[:2], after[2], POOL_V1.advances.index(advance))]
            else:
                assert before[:2] == after[:2]


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
    assert path[1][:2] == travel.start[:2]


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
        x, y = travel.position(ahead[1][0], ahead[1][1])
        pose = SE2(float(x), float(y), ahead[1][2] * POOL_V1.heading_step)
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
    path = Walk(MISSION).plan(np.argwhere(target), travel, unknown)
    assert path[1][:2] == path[0][:2], "it can only turn"
    assert path[-1][:2] != path[0][:2], "and then goes on"
    known = unknown.copy()
    known[travel.start[:2]] = np.minimum(unknown[travel.start[:2]], FREE)
    ahead = Walk(MISSION).plan(np.argwhere(target), travel, known)
    assert len(ahead) == len(path) - 1


def _inside(moves: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Without those that leave the lattice."""
    offsets = offsets_of(POOL_V1)
    rows, cols, headings, advances = moves.shape
    for h, a in np.ndindex(headings, advances):
        east, north = offsets[h, a]
        row, col = np.ogrid[:rows, :cols]
        out = (row + north < 0) | (row + north >= rows) | (col + east < 0) | (col + east >= cols)
        moves[..., h, a][out] = 0
    return moves


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 1000))
def test_ways_to_parts_are_breadth_first(seed: int) -> None:
    generator = np.random.default_rng(seed)
    moves = _inside((generator.random((12, 12, 4, 1)) < 0.6).astype(np.uint8).repeat(6, 2)[..., [0, 0]])
    offsets = offsets_of(POOL_V1)
    reached = generator.random((12, 12)) < 0.7
    marks = np.unique(generator.integers(0, 12, (6, 2)), axis=0)
    part_of = generator.integers(0, 3, len(marks))
    grid, near = (0, 0, 1), 3.2
    ways = kernels.ways_to(part_of, 3, marks, moves, offsets, reached, near, grid)
    for part in range(3):
        count = np.zeros((12, 12), int)
        for row, col in marks[part_of == part]:
            r, c = np.ogrid[:12, :12]
            count += (np.hypot(row + 0.5 - r, col + 0.5 - c) <= near) & reached
        away = np.full((12, 12), float(kernels.NO_WAY))
        if count.max() > 0:
            away[count == count.max()] = 0.0
        todo = deque(map(tuple, np.argwhere(away == 0.0)))
        while todo:
            r, c = todo.popleft()
            for h, a in np.argwhere(moves[r, c]):
                to = r + offsets[h, a, 1], c + offsets[h, a, 0]
                if away[to] == kernels.NO_WAY:
                    away[to] = away[r, c] + 1
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
