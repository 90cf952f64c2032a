"""Probabilities that were told → do they come true: reliability curve and Brier score."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.evaluation.statistics import DRAWS, FloatArray, Interval, resampling_weights
from dream.types import BoolArray

PROBABILITIES = (0.0, 0.003, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0)
"""Edges of the bins; most of what a searcher is told of is unlikely."""


@dataclass(frozen=True, slots=True, eq=False)
class ForecastTally:
    """The forecasts of one world, bin by bin: sums, which add up over a mission's steps."""

    count: FloatArray
    """(bins,) forecasts."""
    told: FloatArray
    """(bins,) sum of the probabilities."""
    true: FloatArray
    """(bins,) how many came true."""
    squares: float
    """Sum of the squared differences."""

    def __add__(self, other: ForecastTally) -> ForecastTally:
        return ForecastTally(
            self.count + other.count,
            self.told + other.told,
            self.true + other.true,
            self.squares + other.squares,
        )


@dataclass(frozen=True, slots=True)
class Brier:
    """The mean squared error of forecasts, and what it is made of (Murphy, J. Appl. Meteor. 12, 1973).

    `reliability` − `resolution` + `uncertainty` is the score of forecasts rounded to the means of their bins.
    """

    score: float
    reliability: float
    """What is lost by probabilities that are not those which come true; 0 is best."""
    resolution: float
    """What is gained by telling cells apart; at most the uncertainty."""
    uncertainty: float
    """The score of one who always tells the base rate."""


@dataclass(frozen=True, slots=True)
class Bin:
    """One point of a reliability curve."""

    low: float
    high: float
    count: int
    told: float
    """Mean probability told."""
    true: Interval
    """Share that came true; the interval resamples worlds."""


def tally(told: npt.NDArray[np.floating[Any]], true: BoolArray) -> ForecastTally:
    """Sums over forecasts.

    Args:
        told: (n,) probabilities.
        true: (n,) whether each came true.

    Raises:
        ValueError: The shapes differ, or a probability is none.
    """
    if told.shape != true.shape or told.ndim != 1:
        raise ValueError(f"forecasts: expected two rows of one length, got {told.shape} and {true.shape}")
    p = told.astype(np.float64)
    if not ((p >= 0.0) & (p <= 1.0)).all():
        raise ValueError("told: expected probabilities from 0 to 1")
    bins = len(PROBABILITIES) - 1
    which = np.clip(np.searchsorted(PROBABILITIES, p, side="right") - 1, 0, bins - 1)
    sums = [np.bincount(which, weights, bins).astype(np.float64) for weights in (np.ones(len(p)), p, true)]
    return ForecastTally(sums[0], sums[1], sums[2], float(((p - true) ** 2).sum()))


NOTHING = tally(np.zeros(0), np.zeros(0, np.bool_))
"""Of no forecasts."""


def brier(tallies: Sequence[ForecastTally]) -> Brier:
    """Over all forecasts of all worlds; ValueError where there are none."""
    whole = sum(tallies, NOTHING)
    total = float(whole.count.sum())
    if total == 0.0:
        raise ValueError("tallies: expected at least one forecast, got none")
    used = whole.count > 0.0
    count = whole.count[used]
    told, true, share = whole.told[used] / count, whole.true[used] / count, count / total
    base = float(share @ true)
    return Brier(
        score=whole.squares / total,
        reliability=float(share @ (told - true) ** 2),
        resolution=float(share @ (true - base) ** 2),
        uncertainty=base * (1.0 - base),
    )


def reliability_curve(tallies: Sequence[ForecastTally], strata: Sequence[str], *, seed: int = 0) -> list[Bin]:
    """The bins that hold forecasts, each with what was told and what came true.

    Args:
        tallies: One a world.
        strata: The family of each world.
        seed: Of the worlds that are drawn for the intervals.
    """
    count, told, true = (np.array([getattr(one, of) for one in tallies]) for of in ("count", "told", "true"))
    weights = resampling_weights(strata, np.random.default_rng(seed), DRAWS)
    drawn, came = weights @ count, weights @ true
    curve = []
    for k, (low, high) in enumerate(pairwise(PROBABILITIES)):
        n = count[:, k].sum()
        if n == 0.0:
            continue
        # Draws without any world that has such forecasts say nothing of them.
        shares = came[drawn[:, k] > 0.0, k] / drawn[drawn[:, k] > 0.0, k]
        ends = np.percentile(shares, [2.5, 97.5])
        share = Interval(
            float(true[:, k].sum() / n), float(ends[0]), float(ends[1]), int((count[:, k] > 0).sum())
        )
        curve.append(Bin(low, high, int(n), float(told[:, k].sum() / n), share))
    return curve
