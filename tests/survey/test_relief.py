"""Heights above a membrane, and roughness, where both are known on paper."""

import math

import numpy as np
import pytest

from dream.survey import relief


def hidden(shape: tuple[int, int]) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    """A patch in the middle."""
    rows, cols = np.indices(shape)
    return np.asarray(np.hypot(rows - shape[0] / 2, cols - shape[1] / 2) < min(shape) / 3)


def test_a_plane_is_spanned_as_it_is() -> None:
    rows, cols = np.indices((20, 24))
    plane = -9.0 + 0.02 * rows - 0.05 * cols
    under = hidden(plane.shape)
    surface = relief.spanned(np.where(under, 7.0, plane), under)
    assert np.abs(surface - plane).max() < 1e-9


def test_a_membrane_is_the_mean_of_its_neighbours_and_nowhere_beyond_its_rim() -> None:
    rng = np.random.default_rng(1)
    ground = rng.normal(size=(20, 20))
    under = hidden(ground.shape)
    surface = relief.spanned(ground, under)
    mean = 0.25 * (surface[:-2, 1:-1] + surface[2:, 1:-1] + surface[1:-1, :-2] + surface[1:-1, 2:])
    inner = under[1:-1, 1:-1]
    assert np.abs(surface[1:-1, 1:-1] - mean)[inner].max() < 1e-9
    assert (surface[~under] == ground[~under]).all()
    assert ground[~under].min() <= surface[under].min() <= surface[under].max() <= ground[~under].max()


def test_ground_that_was_not_seen_beside_a_reef_is_spanned_and_nothing_from_nothing() -> None:
    under = hidden((16, 16))
    ground = np.full((16, 16), -8.0)
    ground[:6] = np.nan
    assert relief.spanned(ground, under)[under] == pytest.approx(-8.0)
    assert np.isnan(relief.spanned(np.full((16, 16), np.nan), under)).all()


def test_means_over_squares_leave_out_what_is_not_valid() -> None:
    values = np.array([[1.0, 3.0, 5.0], [np.nan, 3.0, np.nan]])
    mean, count = relief.averaged(values, np.isfinite(values), 2)
    assert mean.tolist() == [[pytest.approx(7.0 / 3.0), 5.0]]
    assert count.tolist() == [[3.0, 1.0]]


@pytest.mark.parametrize("slope", [0.0, 0.3, 1.0])
def test_a_chain_on_a_slope_is_longer_by_its_secant(slope: float) -> None:
    rows, _ = np.indices((30, 30))
    ratio = relief.chain_ratio(
        np.asarray(rows * relief.CHAIN * slope, np.float64), np.ones((30, 30), np.bool_)
    )
    # Half of the links run along the contour.
    assert ratio == pytest.approx(0.5 + 0.5 * math.hypot(1.0, slope))


def test_a_chain_needs_ten_links() -> None:
    flat = np.full((3, 3), np.nan)
    assert relief.chain_ratio(flat, np.ones((3, 3), np.bool_)) is None
    assert relief.chain_ratio(np.zeros((3, 3)), np.zeros((3, 3), np.bool_)) is None
