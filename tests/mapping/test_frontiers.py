"""The edge of the known, against scipy."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from dream.mapping import frontiers
from tests.mapping.analytic import empty_map, look_around, map_with

CROSS = ndimage.generate_binary_structure(2, 1)


@settings(max_examples=15)
@given(seed=st.integers(0, 2**31), share=st.sampled_from([0.0, 0.05, 0.5, 0.9, 1.0]))
def test_frontiers_and_their_clusters_are_those_of_scipy(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    explored = rng.random((96, 96)) < share
    occupancy = map_with(explored=explored, solid=rng.random((96, 96)) < 0.1)
    known = occupancy.explored | occupancy.solid
    mask = known & ~occupancy.solid & ndimage.binary_dilation(~known, CROSS)
    labels, count = ndimage.label(mask, np.ones((3, 3)))
    found = frontiers(occupancy)
    assert len(found) == count
    for number, frontier in enumerate(found, start=1):
        cells = np.argwhere(labels == number)
        np.testing.assert_array_equal(frontier.cells, cells)
        assert frontier.size == len(cells)
        np.testing.assert_allclose(frontier.centroid, np.ravel(occupancy.center_of(*cells.mean(axis=0))))


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
