"""What a region encloses, against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from dream.mapping._kernels.outline import filled, outline
from dream.mapping.nearness import columns_near, within
from dream.types import BoolArray

shapes = st.tuples(st.integers(1, 24), st.integers(1, 24))
seeds = st.integers(0, 10_000)


def slow_filled(mask: BoolArray) -> BoolArray:
    """The mask, and all parts of the rest that do not come to the border."""
    parts, _ = ndimage.label(~mask)
    outside = np.unique(np.concatenate((parts[0], parts[-1], parts[:, 0], parts[:, -1])))
    return np.asarray(mask | ~np.isin(parts, outside))


@given(seed=seeds, shape=shapes, share=st.sampled_from([0.0, 0.3, 0.45, 0.6, 0.8, 1.0]))
def test_a_hole_is_what_no_way_leads_to_from_the_border(
    seed: int, shape: tuple[int, int], share: float
) -> None:
    mask = np.random.default_rng(seed).random(shape) < share
    np.testing.assert_array_equal(filled(mask), slow_filled(mask))


@given(seed=seeds, shape=shapes, share=st.sampled_from([0.02, 0.1, 0.3]), margin=st.integers(0, 4))
def test_an_outline_is_what_lies_near_with_its_holes(
    seed: int, shape: tuple[int, int], share: float, margin: int
) -> None:
    mask = np.random.default_rng(seed).random(shape) < share
    found = outline(mask, columns_near(margin, 1.0))
    np.testing.assert_array_equal(found, slow_filled(within(mask, margin, 1.0)))


@pytest.mark.parametrize(("row", "closed"), [(0, False), (1, True)])
def test_a_gap_at_a_corner_lets_nothing_through(row: int, closed: bool) -> None:
    ring = np.zeros((7, 7), np.bool_)
    ring[1:6, 1:6] = True
    ring[2:5, 2:5] = False
    ring[1, 1] = False  # Its neighbours meet at the corner, no side.
    ring[1, 3] = bool(row)
    assert filled(ring)[3, 3] == closed
