"""Measures with their 95 % intervals, from standard errors."""

from __future__ import annotations

import math

from dream.survey.survey import Measure

LEVEL = 1.96
"""Standard errors on each side of an interval of 95 %."""


def around(
    name: str, value: float, error: float, unit: str, note: str = "", *, least: float = 0.0
) -> Measure:
    """Equally far on both sides, but not below `least`."""
    low, high = value - LEVEL * error, value + LEVEL * error
    return Measure(name, value, min(max(low, least), value), high, unit, note)


def in_ratio(name: str, value: float, error: float, unit: str, note: str = "") -> Measure:
    """Equally far on both sides as a ratio: `error` is that of the logarithm."""
    factor = math.exp(LEVEL * error)
    return Measure(name, value, value / factor, value * factor, unit, note)


def unknown(name: str, unit: str, why: str) -> Measure:
    """What could not be measured, and why."""
    return Measure(name, None, None, None, unit, why)


def together(*errors: float) -> float:
    """The standard error of a sum of independent parts."""
    return math.sqrt(math.fsum(error * error for error in errors))
