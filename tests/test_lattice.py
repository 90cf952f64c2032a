"""The lattice of poses: where they lie, and which moves lead from one to another."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.control import setpoint
from dream.geometry import SE2, Bounds
from dream.lattice import lattice_of
from dream.protocol import DREAM_V1, POOL_V1, SurveyProtocol
from dream.types import Decision

BOUNDS = Bounds(-2.25, 1.0, 3.1, 5.75)
LATTICE = lattice_of(BOUNDS, DREAM_V1)
poses = st.integers(0, LATTICE.poses - 1)


def test_its_nodes_are_all_multiples_of_the_spacing_in_the_bounds_from_the_south_west_row_by_row() -> None:
    x, y = np.arange(-2.0, 3.1, 0.5), np.arange(1.0, 5.8, 0.5)
    expected = [(east, north) for north in y for east in x]
    np.testing.assert_array_equal(LATTICE.positions, expected)
    assert LATTICE.shape == (len(y), len(x))
    assert LATTICE.nodes == len(expected)
    assert LATTICE.poses == len(expected) * DREAM_V1.headings


def test_a_bound_that_only_rounding_puts_off_the_lattice_is_on_it() -> None:
    assert lattice_of(Bounds(0.1 + 0.2, 0.0, 0.7 - 0.1, 0.3), POOL_V1).shape == (7, 7)


@given(poses)
def test_a_pose_is_found_again_by_where_it_lies(pose: int) -> None:
    there = LATTICE.world(pose)
    assert LATTICE.pose(there) == pose
    assert LATTICE.pose(SE2(there.x + 0.2, there.y - 0.2, there.yaw + 0.2)) == pose
    assert LATTICE.pose(SE2(there.x, there.y, there.yaw - 2.0 * math.pi)) == pose
    assert LATTICE.pose_at(int(LATTICE.node_of(pose)), LATTICE.heading_of(pose)) == pose
    assert 0.0 <= there.yaw < 2.0 * math.pi
    assert (there.x, there.y) == tuple(LATTICE.position(pose))


@pytest.mark.parametrize("place", [(-2.3, 2.0), (3.3, 2.0), (0.0, 0.7), (0.0, 5.8)])
def test_a_position_out_of_bounds_is_refused(place: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="pose: expected a position inside"):
        LATTICE.node(*place)


@given(poses, st.sampled_from(DREAM_V1.turn_angles), st.sampled_from((0.0, *DREAM_V1.advances)))
def test_an_action_leads_where_its_setpoint_does_and_is_told_from_its_ends(
    pose: int, turn: float, advance: float
) -> None:
    goal = setpoint(LATTICE.world(pose), Decision(turn, advance), DREAM_V1)
    k = DREAM_V1.turn_angles.index(turn)
    end = int(LATTICE.graph.turned[pose, k])
    if advance:
        end = int(LATTICE.graph.ahead[end, DREAM_V1.advances.index(advance)])
    try:
        expected = LATTICE.pose(SE2(goal.x, goal.y, goal.yaw))
    except ValueError:
        expected = -1
    assert end == expected
    if end >= 0:
        assert LATTICE.move(pose, end) == pytest.approx((turn, advance))
        assert LATTICE.turned_to(pose, end) == LATTICE.graph.turned[pose, k]
        which = None if advance == 0.0 else DREAM_V1.advances.index(advance)
        assert LATTICE.advance_to(pose, end) == which


def test_pairs_hold_one_heading_on_two_nodes_by_two() -> None:
    col, row = LATTICE.graph.place[LATTICE.node_of(np.arange(LATTICE.poses))].T
    heading = np.arange(LATTICE.poses) % DREAM_V1.headings
    _, same = np.unique(np.stack([row // 2, col // 2, heading]), axis=1, return_inverse=True)
    _, pairs = np.unique(LATTICE.graph.pair, return_inverse=True)
    both = set(zip(same.ravel().tolist(), pairs.tolist(), strict=True))
    assert len(both) == same.max() + 1 == pairs.max() + 1
    assert LATTICE.graph.pair.min() >= 0
    assert LATTICE.graph.pair.max() < LATTICE.poses


@pytest.mark.parametrize("n", [2, 3, 4])
def test_every_so_many_nodes_are_so_far_apart(n: int) -> None:
    chosen = LATTICE.positions[LATTICE.every(n)] - LATTICE.positions[0]
    np.testing.assert_allclose(chosen / (0.5 * n), np.rint(chosen / (0.5 * n)))
    rows, cols = LATTICE.shape
    assert len(chosen) == math.ceil(rows / n) * math.ceil(cols / n)


def test_neighbours_on_a_chessboard_differ() -> None:
    board = LATTICE.checkered[LATTICE.graph.grid]
    assert board[0, 0]
    assert (board[1:] != board[:-1]).all()
    assert (board[:, 1:] != board[:, :-1]).all()


def test_the_grid_says_which_node_lies_where() -> None:
    for row, col in np.ndindex(*LATTICE.shape):
        assert LATTICE.graph.place[LATTICE.graph.grid[row, col]].tolist() == [col, row]


@pytest.mark.parametrize("protocol", [DREAM_V1, POOL_V1], ids=lambda protocol: protocol.name)
def test_no_advance_is_longer_than_the_longest(protocol: SurveyProtocol) -> None:
    lattice = lattice_of(Bounds(0.0, 0.0, 5.0, 5.0), protocol)
    start, move = np.nonzero(lattice.graph.ahead >= 0)
    way = lattice.position(lattice.graph.ahead[start, move]) - lattice.position(start)
    assert np.hypot(*way.T).max() == pytest.approx(lattice.longest)


def test_it_is_made_once_for_a_protocol_in_some_bounds() -> None:
    made = lattice_of(BOUNDS, DREAM_V1)
    assert lattice_of(replace(BOUNDS), replace(DREAM_V1)) is made
    assert lattice_of(BOUNDS, POOL_V1) is not made
