"""Cells near others, against every cell with every other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.mapping import within


@given(
    seed=st.integers(0, 10_000),
    shape=st.tuples(st.integers(1, 24), st.integers(1, 24)),
    share=st.sampled_from([0.01, 0.1, 0.9]),
    cells=st.sampled_from([0.0, 1.0, 1.5, 3.0, 5.0, 40.0]),
)
def test_near_is_what_some_cell_is_near(
    seed: int, shape: tuple[int, int], share: float, cells: float
) -> None:
    mask = np.random.default_rng(seed).random(shape) < share
    expected = np.zeros(shape, np.bool_)
    for row, col in np.argwhere(mask):
        # In whole cells, so that rounding cannot decide.
        away = (np.arange(shape[0])[:, None] - row) ** 2 + (np.arange(shape[1])[None, :] - col) ** 2
        expected |= away <= cells**2
    np.testing.assert_array_equal(within(mask, 0.25 * cells, 0.25), expected)


@pytest.mark.parametrize("cell", [0.05, 0.25])
def test_nothing_is_near_nothing_and_a_cell_is_near_itself(cell: float) -> None:
    mask = np.zeros((5, 7), np.bool_)
    assert not within(mask, 10.0, cell).any()
    mask[4, 6] = True
    np.testing.assert_array_equal(within(mask, 0.5 * cell, cell), mask)
    assert within(mask, 10.0, cell).all()
