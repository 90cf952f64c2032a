"""An anytime-valid interval holds at every number of values at once, and is what its mathematics says."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.special import betaln
from scipy.stats import binom

from dream.evaluation.anytime import anytime_interval, anytime_p_value, log_capital
from dream.evaluation.statistics import share_interval

UNIT = (0.0, 1.0)
ALPHA = 0.05
Draw = Callable[[np.random.Generator, int], npt.NDArray[np.float64]]


def _bernoulli(p: float) -> Draw:
    return lambda rng, n: (rng.random(n) < p).astype(float)


# Name, how values are drawn, and their mean.
LAWS: dict[str, tuple[Draw, float]] = {
    "success nearly always": (_bernoulli(0.98), 0.98),
    "a fair coin": (_bernoulli(0.5), 0.5),
    "success hardly ever": (_bernoulli(0.02), 0.02),
    "coverage, skewed": (lambda rng, n: 1.0 - rng.beta(0.2, 3.0, n), 1.0 - 0.2 / 3.2),
    "times, some cut at the cap": (lambda rng, n: np.where(rng.random(n) < 0.1, 1.0, 0.2), 0.28),
    "no spread to speak of": (lambda rng, n: rng.uniform(0.49, 0.51, n), 0.5),
}


@pytest.mark.parametrize("law", LAWS)
def test_the_mean_is_hardly_ever_outside_at_any_of_500_looks(law: str) -> None:
    draw, mean = LAWS[law]
    rng, tries = np.random.default_rng(20), 400
    values = np.stack([draw(rng, 500) for _ in range(tries)])
    missed = int((log_capital(values, mean).max(axis=1) >= -math.log(ALPHA)).sum())
    # As many as this would come once in a thousand runs if the probability were the whole 5 %.
    assert missed <= binom.ppf(0.999, tries, ALPHA)


def test_looking_again_and_again_needs_another_interval_than_wilsons() -> None:
    rng, outside = np.random.default_rng(21), 0
    for _ in range(100):
        successes = np.cumsum(rng.random(500) < 0.5)
        looks = (share_interval(float(successes[n - 1]), n) for n in range(10, 501, 10))
        outside += any(not look.low <= 0.5 <= look.high for look in looks)
    assert outside > 15  # Where 5 % is asked; so the law above can fail.


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=40), st.floats(0.01, 0.99))
def test_a_mean_is_inside_exactly_where_bets_against_it_earned_too_little(
    values: list[float], mean: float
) -> None:
    found = anytime_interval(np.array(values), UNIT)
    capital = float(log_capital(np.array(values), mean)[-1])
    if abs(capital + math.log(ALPHA)) > 1e-6:
        assert (found.low <= mean <= found.high) == (capital < -math.log(ALPHA))
    p = anytime_p_value(np.array(values), UNIT, mean)
    assert p == pytest.approx(min(math.exp(-capital), 1.0), rel=1e-6)
    assert found.low <= found.value + 1e-9
    assert found.value <= found.high + 1e-9


def _exact_capital(values: list[Fraction], mean: Fraction) -> Fraction:
    """The slow twin: the product as a polynomial of the bet, with the moments of Beta(1/2, 1/2)."""
    zero, polynomial = Fraction(0), [Fraction(1)]
    for value in values:
        constant, slope = (1 - value) / (1 - mean), value / mean - (1 - value) / (1 - mean)
        polynomial = [
            constant * here + slope * before
            for here, before in zip([*polynomial, zero], [zero, *polynomial], strict=True)
        ]
    moments = (Fraction(math.comb(2 * k, k), 4**k) for k in itertools.count())
    return sum((each * moment for each, moment in zip(polynomial, moments, strict=False)), zero)


def test_the_capital_is_the_integral_over_all_constant_bets() -> None:
    values = [Fraction(k, 20) for k in (20, 20, 3, 0, 17, 20, 11, 1, 19, 20, 20, 5)]
    for mean in (Fraction(1, 50), Fraction(1, 3), Fraction(2, 3), Fraction(9, 10)):
        exact = [math.log(_exact_capital(values[:n], mean)) for n in range(1, len(values) + 1)]
        found = log_capital(np.array(values, float), float(mean))
        np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-9)
        p = anytime_p_value(np.array(values, float), UNIT, float(mean))
        assert p == pytest.approx(math.exp(-max(exact[-1], 0.0)), rel=1e-9)


@pytest.mark.parametrize(("successes", "count"), [(60, 60), (59, 60), (30, 60), (0, 60), (490, 500), (1, 1)])
def test_of_shares_it_is_robbins_mixture_in_closed_form(successes: int, count: int) -> None:
    failures = count - successes

    def above(p: float) -> float:
        against = betaln(successes + 0.5, failures + 0.5) - betaln(0.5, 0.5)
        return float(against - successes * math.log(p) - failures * math.log1p(-p) + math.log(ALPHA))

    share = successes / count
    found = anytime_interval(np.repeat([1.0, 0.0], [successes, failures]), UNIT)
    assert found.low == pytest.approx(
        brentq(above, 1e-12, min(share, 1 - 1e-12)) if successes else 0.0, abs=1e-8
    )
    assert found.high == pytest.approx(
        brentq(above, max(share, 1e-12), 1 - 1e-12) if failures else 1.0, abs=1e-8
    )


def test_it_is_wider_than_wilsons_and_not_by_more_than_twice() -> None:
    for count in (60, 120, 300, 500):
        for share in (0.5, 0.9, 1.0):
            successes = round(count * share)
            ours = anytime_interval(np.repeat([1.0, 0.0], [successes, count - successes]), UNIT)
            wilson = share_interval(successes, count)
            assert 1.0 < (ours.high - ours.low) / (wilson.high - wilson.low) < 2.0


def test_many_values_of_one_number_and_none() -> None:
    nothing = anytime_interval(np.array([]), UNIT)
    assert nothing.count == 0
    assert math.isnan(nothing.value + nothing.low + nothing.high)
    assert anytime_p_value(np.array([]), UNIT, 0.5) == 1.0
    zeros, ones = (anytime_interval(np.full(100, value), UNIT) for value in UNIT)
    assert (ones.value, ones.high) == (1.0, 1.0)
    assert 0.9 < ones.low < 1.0
    assert (zeros.low, zeros.high) == pytest.approx((0.0, 1.0 - ones.low))
    halves = anytime_interval(np.full(100, 0.5), UNIT)
    assert halves.low < 0.5 < halves.high
    assert halves.low == pytest.approx(1.0 - halves.high)
    # The same after more values than the sum over bets is exact for.
    many = anytime_interval(np.tile([1.0, 0.0], 2000), UNIT)
    assert many.low < 0.5 < many.high
    assert many.high - many.low < 0.07


def test_limits_only_scale_it_and_the_order_does_not_matter() -> None:
    values = np.random.default_rng(5).uniform(-0.2, 0.7, 40)
    found = anytime_interval(values, (-1.0, 1.0))
    scaled = anytime_interval(100.0 + 30.0 * values[::-1], (70.0, 130.0))
    assert (scaled.value, scaled.low, scaled.high) == pytest.approx(
        (100 + 30 * found.value, 100 + 30 * found.low, 100 + 30 * found.high)
    )
    p = anytime_p_value(values, (-1.0, 1.0), found.low)
    assert p == pytest.approx(ALPHA, rel=1e-6)


def test_values_outside_their_limits_are_refused() -> None:
    for values in ([0.5, 1.2], [-0.1, 0.5], [math.nan, 0.5]):
        with pytest.raises(ValueError, match="values: expected 0 to 1, got"):
            anytime_interval(np.array(values), UNIT)
