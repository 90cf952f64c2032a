"""Where targets are to be expected: closed forms, a slow twin and the model drawn at random."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from dream.geometry import Bounds
from dream.mapping import OccupancyMap, could_hide
from dream.planning.distribution import (
    GLIMPSED,
    OBSERVED,
    Calibration,
    Groups,
    blurred,
    expectation,
)
from dream.protocol import DREAM_V1, POOL_V1, SurveyProtocol
from dream.types import BoolArray
from tests.mapping.analytic import AREA, empty_map, map_with
from tests.planning.flights import SIDE

RADIUS, PRIOR, WEIGHT = 1.5, 0.03, 0.2
EDGE = SIDE // 2
"""First column beyond a half plane."""


def _half_plane() -> BoolArray:
    cells = np.zeros((SIDE, SIDE), np.bool_)
    cells[:, :EDGE] = True
    return cells


def _normal(x: float) -> float:
    """Share of a Gaussian below x standard deviations."""
    return 0.5 * math.erfc(-x / math.sqrt(2.0))


# --------------------------------------------------------------------------------------------- expectation


def _expected(
    occupancy: OccupancyMap, prior: float = PRIOR, weight: float = WEIGHT
) -> npt.NDArray[np.float32]:
    """Asked about everywhere."""
    return expectation(occupancy, RADIUS, prior, weight, np.ones(occupancy.shape, np.bool_))


def test_beside_a_half_plane_of_targets_it_falls_as_a_gaussian_says() -> None:
    occupancy = map_with(explored=_half_plane(), target=_half_plane())
    expected = _expected(occupancy)
    for col in range(EDGE, EDGE + 24):
        known = _normal(-(col + 0.5 - EDGE) * DREAM_V1.cell / RADIUS)
        # The blur is cut off at three standard deviations.
        closed = (known + PRIOR * WEIGHT) / (known + WEIGHT)
        assert expected[EDGE, col] == pytest.approx(closed, abs=0.01)


def test_beside_a_half_plane_without_targets_it_is_the_prior_diluted() -> None:
    expected = _expected(map_with(explored=_half_plane()))
    for col in range(EDGE, EDGE + 24):
        known = _normal(-(col + 0.5 - EDGE) * DREAM_V1.cell / RADIUS)
        assert expected[EDGE, col] == pytest.approx(PRIOR * WEIGHT / (known + WEIGHT), rel=0.02)


def test_where_observed_nothing_more_is_expected() -> None:
    occupancy = map_with(explored=_half_plane(), target=_half_plane())
    assert not _expected(occupancy)[:, :EDGE].any()


def test_far_from_all_that_is_known_the_prior_holds() -> None:
    far = EDGE + math.ceil(3.0 * RADIUS / DREAM_V1.cell) + 1
    for target in (None, _half_plane()):
        expected = _expected(map_with(explored=_half_plane(), target=target))
        np.testing.assert_allclose(expected[:, far:], PRIOR, rtol=1e-5)
    np.testing.assert_allclose(_expected(empty_map()), PRIOR, rtol=1e-5)


@given(seed=st.integers(0, 1000), quarters=st.integers(1, 3))
def test_turning_the_map_by_quarters_turns_what_is_expected(seed: int, quarters: int) -> None:
    explored, target = _patches(seed), _patches(seed + 1)
    expected, turned = (
        _expected(map_with(explored=np.rot90(explored, k), target=np.rot90(explored & target, k)))
        for k in (0, quarters)
    )
    np.testing.assert_allclose(turned, np.rot90(expected, quarters), atol=1e-6)


@given(seed=st.integers(0, 1000), prior=st.floats(1e-3, 1.0), weight=st.floats(1e-3, 10.0))
def test_it_is_a_probability_and_one_more_target_never_lowers_it(
    seed: int, prior: float, weight: float
) -> None:
    explored, target = _patches(seed), _patches(seed + 1)
    fewer = _expected(map_with(explored=explored, target=target & explored), prior, weight)
    more = _expected(map_with(explored=explored, target=explored), prior, weight)
    assert fewer.min() >= 0.0
    assert more.max() <= 1.0
    assert (more >= fewer - 1e-6).all()


@given(seed=st.integers(0, 1000))
def test_it_is_the_same_wherever_else_one_asks_and_nothing_where_nobody_does(seed: int) -> None:
    explored, where = _patches(seed), _patches(seed + 2)
    occupancy = map_with(explored=explored, target=explored & _patches(seed + 1))
    found = expectation(occupancy, RADIUS, PRIOR, WEIGHT, where)
    np.testing.assert_array_equal(found, np.where(where, _expected(occupancy), 0.0))


@given(
    seed=st.integers(0, 1000),
    radius=st.sampled_from([0.1, 0.6, 1.5, 4.0]),
    share=st.sampled_from([0.01, 0.5]),
)
def test_a_blur_is_that_of_scipy_where_it_is_asked_for(seed: int, radius: float, share: float) -> None:
    generator = np.random.default_rng(seed)
    mask, where = generator.random((2, SIDE, SIDE)) < np.array([0.3, share])[:, None, None]
    slow = gaussian_filter(mask.astype(np.float32), radius / DREAM_V1.cell, mode="nearest", truncate=3.0)
    found = blurred(mask, radius, empty_map(), where)
    np.testing.assert_allclose(found, np.where(where, slow, 0.0), rtol=1e-6)


def _patches(seed: int) -> BoolArray:
    """Some squares of two metres, those of one seed."""
    return np.kron(np.random.default_rng(seed).random((12, 12)) < 0.4, np.ones((8, 8))).astype(np.bool_)


# ---------------------------------------------------------------------------------------------- could hide


def _slow_could_hide(occupancy: OccupancyMap, radius: float, hopeless: BoolArray) -> BoolArray:
    """Every cell of the map against every known one."""
    y, x = (np.indices(occupancy.shape) + 0.5) * DREAM_V1.cell
    fits = min(radius, DREAM_V1.group_radius)
    free = (x >= fits) & (x <= AREA.width - fits) & (y >= fits) & (y <= AREA.depth - fits)
    for row, col in np.argwhere(occupancy.observed | hopeless):
        # In whole cells, so that rounding cannot decide.
        away = (np.arange(SIDE)[:, None] - row) ** 2 + (np.arange(SIDE)[None, :] - col) ** 2
        free &= away > (radius / DREAM_V1.cell) ** 2
    return np.asarray(free, np.bool_)


@given(seed=st.integers(0, 1000), radius=st.sampled_from([0.125, 0.6, 1.5, 3.0, 7.3]))
def test_a_group_could_hide_where_no_cell_of_its_disc_is_known(seed: int, radius: float) -> None:
    generator = np.random.default_rng(seed)
    explored = generator.random((SIDE, SIDE)) < 0.003
    hopeless = generator.random((SIDE, SIDE)) < 0.001
    occupancy = map_with(explored=explored)
    found = could_hide(occupancy, radius, hopeless)
    np.testing.assert_array_equal(found, _slow_could_hide(occupancy, radius, hopeless))


def test_with_nothing_known_a_group_could_hide_wherever_the_smallest_fits_in_the_bounds() -> None:
    nothing = np.zeros((SIDE, SIDE), np.bool_)
    found = could_hide(empty_map(), 3.0, nothing)
    np.testing.assert_array_equal(found, _slow_could_hide(empty_map(), 3.0, nothing))
    assert found.any()
    assert could_hide(empty_map(), 13.0, nothing).any(), "a large group may reach past the bounds"
    assert not could_hide(empty_map(), 3.0, ~nothing).any(), "but not where all is hopeless"


def test_in_an_arena_that_is_narrower_than_a_large_group_one_could_hide() -> None:
    narrow = OccupancyMap(Bounds(0.0, 0.0, 5.5, 40.0), DREAM_V1)
    assert could_hide(narrow, 3.0, np.zeros(narrow.shape, np.bool_)).any()


@pytest.mark.parametrize("protocol", [DREAM_V1, POOL_V1])
def test_where_all_must_be_seen_every_cell_could_hide_something(protocol: SurveyProtocol) -> None:
    occupancy = OccupancyMap(Bounds(0.0, 0.0, 20.0 * protocol.cell, 30.0 * protocol.cell), protocol)
    assert could_hide(occupancy, 0.5 * protocol.cell, np.zeros(occupancy.shape, np.bool_)).all()


# -------------------------------------------------------------------------------------------------- groups

counts, areas = st.integers(0, 20), st.floats(0.0, 5000.0)
priors = st.builds(Groups, shape=st.floats(0.01, 20.0), area=st.floats(1.0, 5000.0))


@pytest.mark.parametrize(
    ("found", "searched", "hidden"), [(0, 400.0, 300.0), (2, 400.0, 300.0), (4, 900.0, 60.0)]
)
def test_the_risk_is_that_of_the_model_drawn_at_random(found: int, searched: float, hidden: float) -> None:
    """Draw an intensity, then the groups in both parts; keep the worlds in which as many were found."""
    groups, generator = Groups(0.8, 300.0), np.random.default_rng(1)
    intensity = generator.gamma(groups.shape, 1.0 / groups.area, 2_000_000)
    like_this = generator.poisson(intensity * searched) == found
    missed = generator.poisson(intensity[like_this] * hidden)
    error = 4.0 * 0.5 / math.sqrt(like_this.sum())
    assert like_this.sum() > 20_000
    groups = groups.after(found, searched)
    assert groups.risk(hidden) == pytest.approx((missed > 0).mean(), abs=error)
    expected = groups.intensity * hidden
    assert expected == pytest.approx(missed.mean(), abs=4.0 * missed.std() / math.sqrt(len(missed)))


@given(groups=priors, found=counts, searched=areas, hidden=areas, more=st.floats(0.0, 1000.0))
def test_the_risk_grows_with_what_is_hidden_and_found_and_falls_with_what_was_searched(
    groups: Groups, found: int, searched: float, hidden: float, more: float
) -> None:
    risk = groups.after(found, searched).risk(hidden)
    assert 0.0 <= risk <= 1.0
    assert groups.after(found, searched).risk(hidden + more) >= risk - 1e-12
    assert groups.after(found + 1, searched).risk(hidden) >= risk - 1e-12
    assert groups.after(found, searched + more).risk(hidden) <= risk + 1e-12


@given(groups=priors, found=counts, searched=areas)
def test_nothing_hidden_is_no_risk_and_a_little_is_as_much_as_its_expected_groups(
    groups: Groups, found: int, searched: float
) -> None:
    groups, little = groups.after(found, searched), 1e-3
    assert groups.risk(0.0) == 0.0
    assert groups.risk(little) == pytest.approx(groups.intensity * little, rel=0.02)


@given(groups=priors, found=counts, searched=areas, hidden=areas)
def test_the_risk_is_at_most_the_groups_that_are_expected(
    groups: Groups, found: int, searched: float, hidden: float
) -> None:
    groups = groups.after(found, searched)
    assert groups.risk(hidden) <= groups.intensity * hidden + 1e-9


CALIBRATIONS = pytest.mark.parametrize("line", [OBSERVED, GLIMPSED, Calibration(0.5, 0.7)])


@CALIBRATIONS
@given(risk=st.floats(0.0, 1.0), more=st.floats(0.0, 1.0))
def test_a_risk_that_is_calibrated_keeps_its_order_and_its_ends_and_can_be_taken_back(
    line: Calibration, risk: float, more: float
) -> None:
    less, more = sorted((risk, more))
    assert 0.0 <= line.calibrated(less) <= line.calibrated(more) <= 1.0
    assert line.calibrated(0.0) == line.uncalibrated(0.0) == 0.0
    assert line.calibrated(1.0) == line.uncalibrated(1.0) == 1.0
    assert line.uncalibrated(line.calibrated(risk)) == pytest.approx(risk, abs=1e-6)
    assert line.calibrated(line.uncalibrated(risk)) == pytest.approx(risk, abs=1e-6)


@CALIBRATIONS
@pytest.mark.parametrize("risk", [0.001, 0.02, 0.3, 0.9])
def test_the_odds_of_a_risk_are_calibrated_along_a_line_in_their_logarithm(
    line: Calibration, risk: float
) -> None:
    came = line.calibrated(risk)
    odds, odds_of_it = risk / (1.0 - risk), came / (1.0 - came)
    assert math.log(odds_of_it) == pytest.approx(math.log(line.scale) + line.power * math.log(odds))


@pytest.mark.parametrize("name", ["shape", "area"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_a_prior_out_of_range_is_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected"):
        Groups(**{"shape": 1.0, "area": 1.0, name: value})
