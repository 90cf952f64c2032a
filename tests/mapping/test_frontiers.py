"""The edge of the known, against a walk from cell to cell."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dream.mapping import frontiers
from dream.types import BoolArray
from tests.mapping.analytic import empty_map, look_around, map_with


def clusters(mask: BoolArray) -> list[list[list[int]]]:
    """Cells that touch, diagonally too, found one by one."""
    left = {(int(row), int(col)) for row, col in np.argwhere(mask)}
    found = []
    while left:
        todo = [min(left)]
        left.remove(todo[0])
        mine = []
        while todo:
            row, col = todo.pop()
            mine.append([row, col])
            around = {(row + i, col + j) for i in (-1, 0, 1) for j in (-1, 0, 1)} & left
            left -= around
            todo.extend(around)
        found.append(sorted(mine))
    return found


@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), share=st.sampled_from([0.0, 0.05, 0.5, 0.9, 1.0]))
def test_frontiers_lie_beside_the_unknown_and_clusters_hold_what_touches(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    explored = rng.random((96, 96)) < share
    occupancy = map_with(explored=explored, solid=rng.random((96, 96)) < 0.1)
    known = occupancy.explored | occupancy.solid
    unknown = np.pad(~known, 1)
    beside = unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    expected = clusters(known & ~occupancy.solid & beside)
    found = frontiers(occupancy)
    assert [frontier.cells.tolist() for frontier in found] == expected
    for frontier, cells in zip(found, expected, strict=True):
        middle = np.mean(cells, axis=0)
        np.testing.assert_allclose(frontier.centroid, np.ravel(occupancy.center_of(*middle)))


def test_an_empty_map_has_no_frontier_and_neither_has_a_full_one() -> None:
    assert frontiers(empty_map()) == []
    assert frontiers(map_with(explored=np.ones((96, 96), np.bool_))) == []


def test_after_a_look_around_the_frontier_is_a_ring_at_the_reach() -> None:
    occupancy = empty_map()
    look_around(occupancy, 0.0, 0.0)
    (ring,) = [frontier for frontier in frontiers(occupancy) if frontier.size > 20]
    np.testing.assert_allclose(ring.centroid, (0.0, 0.0), atol=0.05)
    distance = np.hypot(*occupancy.center_of(*ring.cells.T))
    assert distance.min() > 7.5
    assert distance.max() < 8.2
