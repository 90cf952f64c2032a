"""Forecasts that are right, sharp or neither, whose scores are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.evaluation.calibration import PROBABILITIES, ForecastTally, brier, reliability_curve, tally

FORECASTS = st.lists(st.tuples(st.floats(0.0, 1.0), st.booleans()), min_size=1, max_size=40)


def _tally(forecasts: list[tuple[float, bool]]) -> ForecastTally:
    told, true = zip(*forecasts, strict=True)
    return tally(np.array(told), np.array(true))


@given(FORECASTS)
def test_the_score_is_the_mean_squared_error(forecasts: list[tuple[float, bool]]) -> None:
    expected = np.mean([(p - came) ** 2 for p, came in forecasts])
    assert brier([_tally(forecasts)]).score == pytest.approx(expected)


@given(st.lists(st.tuples(st.sampled_from((0.001, 0.04, 0.25, 1.0)), st.booleans()), min_size=1, max_size=40))
def test_its_parts_add_up_where_a_bin_holds_one_probability(forecasts: list[tuple[float, bool]]) -> None:
    """Murphy's decomposition."""
    score = brier([_tally(forecasts)])
    assert score.score == pytest.approx(score.reliability - score.resolution + score.uncertainty)


@given(FORECASTS, FORECASTS)
def test_two_worlds_score_as_all_their_forecasts_do(
    one: list[tuple[float, bool]], other: list[tuple[float, bool]]
) -> None:
    together = brier([_tally(one + other)])
    apart, summed = brier([_tally(one), _tally(other)]), brier([_tally(one) + _tally(other)])
    for name in ("score", "reliability", "resolution", "uncertainty"):
        assert getattr(apart, name) == pytest.approx(getattr(together, name))
        assert getattr(summed, name) == pytest.approx(getattr(together, name))


def test_who_knows_all_has_no_error_and_who_knows_the_base_rate_none_but_uncertainty() -> None:
    true = np.arange(10) < 2
    knowing, indifferent = brier([tally(true * 1.0, true)]), brier([tally(np.full(10, 0.2), true)])
    assert (knowing.score, knowing.reliability) == (0.0, 0.0)
    assert knowing.resolution == pytest.approx(knowing.uncertainty)
    assert indifferent.score == pytest.approx(0.2 * 0.8)
    assert indifferent.reliability == pytest.approx(0.0)
    assert indifferent.resolution == pytest.approx(0.0)


def test_a_curve_shows_what_was_told_and_what_came_true_bin_by_bin() -> None:
    told = np.array([0.04, 0.04, 0.04, 0.04, 0.25, 0.25, 1.0])
    true = np.array([True, False, False, False, True, False, True])
    curve = reliability_curve([tally(told, true), tally(told, true)], ["a", "a"])
    assert [(point.low, point.high) for point in curve] == [(0.03, 0.05), (0.2, 0.3), (0.5, 1.0)]
    assert [point.count for point in curve] == [8, 4, 2]
    assert [point.told for point in curve] == [pytest.approx(p) for p in (0.04, 0.25, 1.0)]
    assert [point.true.value for point in curve] == [0.25, 0.5, 1.0]


def test_intervals_hold_what_is_true_of_worlds_that_differ() -> None:
    """Of worlds that are drawn anew: 95 % should hold it, 85 % at least of 60."""
    rng, held = np.random.default_rng(3), 0
    for seed in range(60):
        chances = rng.beta(2.0, 18.0, size=20)  # 0.1 in the mean, unlike in each world
        worlds = [tally(np.full(200, 0.12), rng.random(200) < chance) for chance in chances]
        (point,) = reliability_curve(worlds, ["a"] * 20, seed=seed)
        held += point.true.low <= 0.1 <= point.true.high
    assert 51 <= held < 60


@pytest.mark.parametrize("told", [[1.01], [-0.01], [np.nan]])
def test_what_is_no_probability_is_refused(told: list[float]) -> None:
    with pytest.raises(ValueError, match="from 0 to 1"):
        tally(np.array(told), np.array([True]))


def test_forecasts_of_which_nobody_says_what_came_of_them_are_refused() -> None:
    with pytest.raises(ValueError, match="one length"):
        tally(np.array([0.1, 0.2]), np.array([True]))
    with pytest.raises(ValueError, match="at least one forecast"):
        brier([tally(np.zeros(0), np.zeros(0, np.bool_))])


def test_every_probability_has_a_bin() -> None:
    told = np.array([*PROBABILITIES, 0.999])
    assert tally(told, told > 2.0).count.sum() == len(told)
