"""Intervals of a mean that hold at every number of worlds at once, whenever whoever looks stops.

Somebody bets, world after world, that the mean of bounded values is not m. Where it is m no bet gains on
average, so that the capital exceeds 1 / α at any time at all with a probability of at most α (Ville 1939).
The interval holds those means against which the bets have not earned so much: betting confidence sequences,
after Waudby-Smith and Ramdas, JRSS-B 86, 2024.

The bets are Cover's universal portfolio of two assets: capital is spread over constant bets p by the weights
Beta(½, ½), and none is moved. For values of 0 and 1 this is Robbins' mixture (Ann. Math. Stat. 41, 1970); for
others see Orabona and Jun, IEEE Trans. Inf. Theory 70, 2024. There is nothing to tune, and the order of the
values does not matter.

It is assumed that the values are bounded, and that each is drawn by the same lot whatever came before it: the
worlds of a sealed test (`dream.evaluation.sealed`) are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq

from dream.evaluation.statistics import LEVEL, FloatArray, Interval

NODES = 256
"""Constant bets at most that share the capital. A sum over so many is the integral over the weights, up to
fewer than twice as many values (Gauss and Chebyshev); of more it is a mixture of its own, which holds too."""
EDGE = 1e-12
"""How near to 0 and 1 a mean is looked for."""


def log_capital(values: FloatArray, mean: float) -> FloatArray:
    """Logarithm of what bets against a mean have made of a capital of 1, after each value.

    Args:
        values: (..., n) from 0 to 1, in the order in which they came.
        mean: In the open interval (0, 1).

    Returns:
        (..., n) after each value. Where that is the mean, all n are below log(1 / α) with a probability of
        at least 1 − α.
    """
    bets = _bets(NODES)
    capital = np.full((*values.shape[:-1], NODES), 1.0 / NODES)
    logs, told = np.zeros(values.shape[:-1]), np.empty(values.shape)
    for number in range(values.shape[-1]):
        value = values[..., number, np.newaxis]
        capital *= (value / mean) * bets + ((1.0 - value) / (1.0 - mean)) * (1.0 - bets)
        grown = capital.sum(axis=-1)
        capital /= grown[..., np.newaxis]
        logs = logs + np.log(grown)
        told[..., number] = logs
    return told


def anytime_interval(values: FloatArray, limits: tuple[float, float], *, level: float = LEVEL) -> Interval:
    """The mean of (n,) values with the interval that holds at every n at once.

    That the true mean is ever outside, at whatever n, has a probability of at most 1 − `level`. So more
    worlds may follow as long as anybody likes, for whatever reason, and the last interval still holds.

    Args:
        values: One a world.
        limits: What a value can be at all, finite.
        level: Of the interval.

    Raises:
        ValueError: A value is outside the limits.
    """
    count = len(values)
    if count == 0:
        return Interval(math.nan, math.nan, math.nan, 0)
    share, counts = _shares(values, limits)
    middle = float(share @ counts) / count
    capital = _last_log_capital(share, counts)

    def above(mean: float) -> float:
        return capital(mean) + math.log(1.0 - level)

    # The capital is log-convex in the mean, and at most 1 at the sample's own: one end on each side of it.
    low, high = 0.0, 1.0
    if middle > EDGE and above(EDGE) > 0.0:
        low = float(brentq(above, EDGE, min(middle, 1.0 - EDGE)))
    if middle < 1.0 - EDGE and above(1.0 - EDGE) > 0.0:
        high = float(brentq(above, max(middle, EDGE), 1.0 - EDGE))
    least, width = limits[0], limits[1] - limits[0]
    return Interval(float(np.mean(values)), least + width * low, least + width * high, count)


def anytime_p_value(values: FloatArray, limits: tuple[float, float], mean: float) -> float:
    """P-value of the hypothesis that (n,) values have this mean, whenever whoever looks stops.

    It is 1 over the capital of who bets against it, at most 1: below 1 − `level` exactly where the mean is
    outside `anytime_interval`. 1 where there are no values.
    """
    if not len(values):
        return 1.0
    share, counts = _shares(values, limits)
    told = _last_log_capital(share, counts)((mean - limits[0]) / (limits[1] - limits[0]))
    return math.exp(-max(told, 0.0))


def _shares(values: FloatArray, limits: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Where between the limits the values lie, each that occurs once, and how often it does."""
    share, counts = np.unique((values - limits[0]) / (limits[1] - limits[0]), return_counts=True)
    if not (share[0] >= 0.0 and share[-1] <= 1.0):
        raise ValueError(
            f"values: expected {limits[0]:g} to {limits[1]:g}, got {np.min(values):g} to {np.max(values):g}"
        )
    return share, counts.astype(np.float64)


def _last_log_capital(share: FloatArray, counts: FloatArray) -> Callable[[float], float]:
    """The last of `log_capital` by the mean, since the order of the values does not matter."""
    count = float(counts.sum())
    bets = _bets(min(int(count) // 2 + 1, NODES))
    staked, kept = np.outer(share, bets), np.outer(1.0 - share, 1.0 - bets)

    def capital(mean: float) -> float:
        logs = counts @ np.log(staked * (1.0 - mean) + kept * mean)
        most = float(logs.max())
        average = math.log(float(np.exp(logs - most).mean()))
        return most + average - count * math.log(mean * (1.0 - mean))

    return capital


@lru_cache
def _bets(nodes: int) -> FloatArray:
    """(nodes,) constant bets, equally much on each: which share of the capital is staked on 1."""
    bets = np.asarray(0.5 + 0.5 * np.cos((np.arange(nodes) + 0.5) * math.pi / nodes), np.float64)
    bets.setflags(write=False)
    return bets
