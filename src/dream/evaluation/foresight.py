"""What an area will take: the spread over simulated missions, and how sure that is of one more.

A further mission lies between two of n missions that are like it with a probability that no distribution
changes, so that what is told holds for few missions as well, and says how few they are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from dream import __version__
from dream.evaluation.results import Flown
from dream.evaluation.suites import Case
from dream.homeward import Budget
from dream.protocol import SurveyProtocol
from dream.sim.sampling import index
from dream.sim.sizes import Size

Float64Array = npt.NDArray[np.float64]

SHARES = (0.1, 0.5, 0.9)
"""Quantiles that are told."""
POINTS = 121
"""Moments at which coverage over time is told."""
HOME = ("done", "returned")
"""Ends of a mission that is home."""


def cases_in(size: Size, kinds: Sequence[str], missions: int, first: int) -> tuple[Case, ...]:
    """Worlds of that size, one a mission; each is of any of the kinds, all alike likely.

    More missions from the same first seed begin with the same worlds.

    Args:
        size: Of the area, and its water.
        kinds: Names of `dream.sim.worlds.SIZABLE`.
        missions: How many.
        first: Seed of the first world; the others follow.
    """
    return tuple(
        Case(f"{kinds[index(np.random.default_rng(seed), len(kinds))]}+{size}", seed)
        for seed in range(first, first + missions)
    )


def quantile(values: Sequence[float], share: float) -> float:
    """The value that a further one lies below with that probability.

    Of n values the k-th from below is exceeded with probability 1 − k/(n + 1), whatever their distribution
    (order statistics; Hyndman and Fan 1996, Am. Stat. 50: 361-365, definition 6). Between two of them it is
    interpolated, beyond the outermost it is the outermost.

    Args:
        values: One or more, of missions that are alike.
        share: In [0, 1].
    """
    return float(np.quantile(np.asarray(values, np.float64), share, method="weibull"))


def held(missions: int) -> float:
    """Probability that a further mission lies between the outer of the quantiles that are told.

    Less than it should be where the missions are too few for such quantiles.
    """
    low, _, high = (min(max(share, 1 / (missions + 1)), missions / (missions + 1)) for share in SHARES)
    return high - low


@dataclass(frozen=True, slots=True)
class Quantiles:
    """Of one figure over missions."""

    low: float
    """10 % of missions have less."""
    median: float
    high: float
    """90 % have less."""
    at_least: tuple[bool, bool, bool]
    """Of each of the three: it is a lower bound, since missions that it counts on were cut short."""

    def as_dict(self) -> dict[str, Any]:
        """For a file."""
        values = {name: round(getattr(self, name), 4) for name in ("low", "median", "high")}
        return {**values, "at_least": list(self.at_least)}


def spread(values: Sequence[float], cut: Sequence[bool] | None = None) -> Quantiles:
    """The quantiles of a figure.

    Args:
        values: One a mission.
        cut: Was it cut short, so that it would have been more? None where nothing is.
    """
    low, median, high = (quantile(values, share) for share in SHARES)
    least = min((v for v, over in zip(values, cut or [], strict=False) if over), default=math.inf)
    # What is cut short below a quantile may belong above it.
    bounds = (least <= low, least <= median, least <= high)
    return Quantiles(low, median, high, bounds)


@dataclass(frozen=True)
class Foresight:
    """What missions of one kind took: all that end by themselves, or all that had a budget."""

    flown: tuple[Flown, ...]
    """Two or more, each with a clock."""
    budget: Budget | None = None
    """What each might spend; None where they had no limit."""

    def __post_init__(self) -> None:
        if len(self.flown) < 2:
            raise ValueError(f"missions: expected 2 or more to tell a spread, got {len(self.flown)}")

    @property
    def ended(self) -> dict[str, int]:
        """How many ended in which way."""
        ends = [one.row.ended for one in self.flown]
        return {end: ends.count(end) for end in dict.fromkeys(ends)}

    @property
    def home(self) -> int:
        """How many were home, and in time."""
        return sum(
            one.row.ended in HOME and (self.budget is None or seconds <= self.budget.seconds + 1e-6)
            for one, seconds in zip(self.flown, self.seconds, strict=True)
        )

    @property
    def complete(self) -> int:
        """How many the planner held to be complete."""
        return sum(one.row.ended == "done" for one in self.flown)

    @cached_property
    def seconds(self) -> list[float]:
        """Of each mission, until it was home."""
        return [_last(one.trace.seconds) for one in self.flown]

    @cached_property
    def watt_hours(self) -> list[float]:
        """Likewise."""
        return [_last(one.trace.drawn_wh) for one in self.flown]

    def spreads(self) -> dict[str, Quantiles]:
        """Of time, way, battery and steps until a mission is home, and of the coverage then."""
        cut = None if self.budget is not None else [one.row.ended != "done" for one in self.flown]
        figures = {
            "time_s": self.seconds,
            "way_m": [one.row.distance_m for one in self.flown],
            "battery_wh": self.watt_hours,
            "steps": [float(one.row.steps) for one in self.flown],
        }
        told = {name: spread(values, cut) for name, values in figures.items()}
        return {**told, "coverage": spread([one.row.instances for one in self.flown])}

    @cached_property
    def moments(self) -> Float64Array:
        """(T,) seconds, from the first look to the end of the longest mission."""
        return np.linspace(0.0, max(self.seconds), POINTS)

    @cached_property
    def coverage(self) -> Float64Array:
        """(missions, T) shares seen by each of `moments`; what a mission ended with stays."""
        rows = []
        for one in self.flown:
            assert one.trace.seconds is not None
            at = np.searchsorted(one.trace.seconds, self.moments, side="right") - 1
            rows.append(one.trace.instances[np.maximum(at, 0)])
        return np.array(rows)

    def band(self) -> Float64Array:
        """(3, T) quantiles of `coverage`."""
        return np.quantile(self.coverage, SHARES, axis=0, method="weibull")

    def as_dict(self) -> dict[str, Any]:
        """For `plan.json`."""
        low, median, high = self.band().round(4).tolist()
        return {
            "missions": len(self.flown),
            "ended": self.ended,
            "complete": self.complete,
            "home": self.home,
            **{name: one.as_dict() for name, one in self.spreads().items()},
            "curve": {
                "time_s": self.moments.round(2).tolist(),
                "low": low,
                "median": median,
                "high": high,
            },
            "each": [
                {
                    "world": one.row.world,
                    "seed": one.row.seed,
                    "ended": one.row.ended,
                    "time_s": round(seconds, 2),
                    "way_m": one.row.distance_m,
                    "battery_wh": round(watt_hours, 3),
                    "steps": one.row.steps,
                    "coverage": one.row.instances,
                }
                for one, seconds, watt_hours in zip(self.flown, self.seconds, self.watt_hours, strict=True)
            ],
        }


def _last(column: Float64Array | None) -> float:
    if column is None:
        raise ValueError("missions: expected a clock and a battery in each trace, got one without")
    return float(column[-1])


@dataclass(frozen=True, slots=True)
class Foreseen:
    """A plan: what an area will take."""

    size: Size
    kinds: tuple[str, ...]
    """What may lie there: names of worlds, all alike likely."""
    planner: str
    protocol: SurveyProtocol
    free: Foresight
    """Missions that went home when they were complete."""
    within: Foresight | None
    """The same worlds with a budget; None where there is none."""

    def as_dict(self) -> dict[str, Any]:
        """`plan.json`."""
        within = None
        if self.within is not None:
            assert self.within.budget is not None
            within = {"budget": self.within.budget.as_dict(), **self.within.as_dict()}
        return {
            "version": __version__,
            "east_m": self.size.east,
            "north_m": self.size.north,
            "visibility_m": self.size.visibility,
            "worlds": list(self.kinds),
            "planner": self.planner,
            "protocol": self.protocol.name,
            "held": round(held(len(self.free.flown)), 4),
            "free": self.free.as_dict(),
            "within": within,
        }
