"""Sizes from extents that scatter, of individuals that are not like the others."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from dream.survey.calibration import SCATTERED, SHARP, Calibration
from dream.survey.individuals import Peaks
from dream.survey.sizes import SIZES, Sizes, sizes_of

Float64Array = npt.NDArray[np.float64]


def peaks(across: Float64Array, lone: npt.NDArray[np.bool_], stature: Float64Array) -> Peaks:
    near = np.full(len(across), 3.0)
    return Peaks(np.zeros((len(across), 3)), near, near, across, lone, stature)


def measured(found: Peaks, calibration: Calibration = SHARP) -> Sizes:
    every = np.ones(len(found), np.bool_)
    return sizes_of(found, np.ones(len(found)), every, calibration)


def extents(rng: np.random.Generator, sizes: Float64Array, calibration: Calibration) -> Float64Array:
    """As the calibration says that they scatter."""
    share, mean, sigma = np.array(calibration.extent).T
    which = rng.choice(len(share), len(sizes), p=share / share.sum())
    return np.asarray(sizes * np.exp(rng.normal(mean[which], sigma[which])))


@pytest.mark.parametrize("calibration", [SHARP, SCATTERED])
def test_two_generations_are_told_apart_though_their_extents_run_together(calibration: Calibration) -> None:
    rng = np.random.default_rng(1)
    young, old = rng.uniform(0.165, 0.19, 300), rng.normal(0.3, 0.03, 500)
    sizes = np.concatenate([young, old])
    found = measured(peaks(extents(rng, sizes, calibration), np.ones(800, bool), sizes), calibration)
    told = {one.name: one for one in found.measures()}
    true, _ = np.histogram(sizes, np.arange(0.1, 0.46, 0.05))
    held = []
    for k, share in enumerate(true / len(sizes)):
        one = told.get(f"size_share_{10 + 5 * k:03d}_{15 + 5 * k:03d}_cm")
        held.append(share < 0.05 if one is None else (one.low or 0.0) <= share <= (one.high or 0.0))
    assert sum(held) >= len(held) - 1
    assert sum(one.value or 0.0 for name, one in told.items() if name != "median_size") == pytest.approx(1.0)
    median = told["median_size"]
    assert median.value == pytest.approx(np.median(sizes), rel=0.05)
    assert found.below(0.24) == pytest.approx(300 / 800, abs=0.08)
    # A quarter of the extents is beyond the largest of the sizes; of the individuals that hardly is one.
    assert found.below(0.4) > 0.95


def test_those_that_stand_clear_are_weighed_to_be_as_all() -> None:
    """Of the small half stand clear, of the tall a quarter."""
    rng = np.random.default_rng(2)
    sizes = np.concatenate([np.full(500, 0.17), np.full(500, 0.32)])
    lone = np.concatenate([rng.random(500) < 0.5, rng.random(500) < 0.25])
    found = measured(peaks(extents(rng, sizes, SHARP), lone, 0.3 * sizes + rng.normal(0.0, 0.002, 1000)))
    assert found.below(0.24) == pytest.approx(0.5, abs=0.07)
    # Without weights there are two small ones for each large one.
    alike = measured(peaks(extents(rng, sizes, SHARP), lone, np.full(1000, 0.1)))
    assert alike.below(0.24) == pytest.approx(2 / 3, abs=0.05)
    assert found.sample < alike.sample == pytest.approx(lone.sum())


def test_the_interval_of_a_median_between_two_heaps_spans_them() -> None:
    """Whether a few more are of the one or of the other decides where the middle is."""
    rng = np.random.default_rng(3)

    def width(low: float, high: float) -> float:
        sizes = np.concatenate([np.full(200, low), np.full(200, high)])
        median, *_ = measured(peaks(extents(rng, sizes, SHARP), np.ones(400, bool), sizes)).measures()
        assert median.low is not None
        assert median.high is not None
        return median.high - median.low

    assert width(0.17, 0.32) > 2.0 * width(0.24, 0.25)


def test_sizes_of_single_individuals_are_drawn_to_what_is_likely_and_those_in_a_crust_to_all() -> None:
    rng = np.random.default_rng(4)
    sizes = rng.uniform(0.2, 0.3, 400)
    lone = np.arange(400) < 200
    found = measured(peaks(extents(rng, sizes, SHARP), lone, sizes))
    assert np.array_equal(found.clear, lone)
    off = found.size[:200] - sizes[:200]
    assert np.abs(np.mean(off)) < 0.01
    assert np.mean(np.abs(off) < 1.96 * found.error[:200]) > 0.9
    assert np.unique(found.size[200:]).tolist() == pytest.approx([sizes.mean()], rel=0.03)
    assert found.error[300] > 0.8 * sizes.std()


@pytest.mark.parametrize("count", [0, 2, 3])
def test_sizes_are_told_from_three_that_stand_clear(count: int) -> None:
    across = np.full(20, 0.25)
    found = measured(peaks(across, np.arange(20) < count, across))
    median, *shares = found.measures()
    assert (median.value is None) == (found.typical is None) == (not shares) == (count < 3)
    # Of fewer, each is a guess like all others.
    assert np.count_nonzero(found.clear) == found.count == (3 if count == 3 else 0)
    assert (found.size > 0.0).all()
    assert (found.error > 0.0).all()


def test_what_makes_up_the_cover_is_the_size_by_area() -> None:
    share = np.zeros(len(SIZES))
    small, large = np.searchsorted(SIZES, (0.1, 0.3))
    share[small], share[large] = 0.8, 0.2
    told = Sizes(share, SIZES, SIZES, 100.0, np.ones(100, np.bool_), SHARP)
    # Four fifths cover 0.8 · 0.1², one fifth covers 0.2 · 0.3², more than half.
    assert told.typical == pytest.approx(0.3, rel=0.05)
    assert told.quantile(0.5) == pytest.approx(0.1, rel=0.05)


def test_the_wider_of_two_calibrations_has_the_wider_interval() -> None:
    rng = np.random.default_rng(5)
    sizes = rng.uniform(0.2, 0.3, 400)
    found = peaks(extents(rng, sizes, SHARP), np.ones(400, bool), sizes)
    near, far = (
        measured(found, replace(SHARP, rank_spread=spread, share_spread=spread)).measures()
        for spread in (0.02, 0.2)
    )
    for one, other in zip(near, far, strict=True):
        assert (one.high or 0.0) - (one.low or 0.0) < (other.high or 0.0) - (other.low or 0.0)
