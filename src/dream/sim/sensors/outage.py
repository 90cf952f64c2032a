"""When a sensor says nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]

SENSORS = ("imu", "dvl", "depth", "compass")


@dataclass(frozen=True, slots=True)
class Outage:
    """A sensor that is silent for a while. It is read, and its errors go on; nobody hears of it."""

    sensor: Literal["imu", "dvl", "depth", "compass"]
    begins: float
    """Seconds of the mission."""
    lasts: float | None = None
    """Seconds; for good unless given."""

    def __post_init__(self) -> None:
        if self.sensor not in SENSORS:
            raise ValueError(f"outage.sensor: expected one of {', '.join(SENSORS)}, got {self.sensor}")
        if not 0.0 <= self.begins < math.inf:
            raise ValueError(f"outage.begins: expected 0 s or more, got {self.begins}")
        if self.lasts is not None and not 0.0 < self.lasts < math.inf:
            raise ValueError(f"outage.lasts: expected more than 0 s, got {self.lasts}")


@dataclass(frozen=True, slots=True)
class Bursts:
    """A sensor that falls silent again and again.

    What it does: a chain of two states, one in which everything is heard and one in which nothing is; how
    long each lasts is drawn from an exponential distribution. Missions begin in the good one.
    Reference: Gilbert, *Bell Syst. Tech. J.* 39 (1960), with a good state without losses.
    """

    share: float = 0.0
    """Of the time in which it is silent. None by default: no figures for a DVL over a reef are published, and
    what shuts one out (bubbles, a slope, something in between) differs from dive to dive."""
    lasts: float = 3.0
    """Seconds that a silence lasts on average. Assumption."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.share < 1.0:
            raise ValueError(f"bursts.share: expected 0 or more and less than 1, got {self.share}")
        if not 0.0 < self.lasts < math.inf:
            raise ValueError(f"bursts.lasts: expected a time above 0 s, got {self.lasts}")

    @property
    def means(self) -> Float64Array:
        """(2,) mean seconds of the good state, which may be infinite, and of the silent one."""
        good = self.lasts * (1.0 - self.share) / self.share if self.share > 0.0 else math.inf
        return np.array([good, self.lasts])


def table(outages: Sequence[Outage]) -> Float64Array:
    """(n, 3) sensor (its place in `SENSORS`), begin and end of each, as the kernels take it."""
    rows = [
        (
            SENSORS.index(each.sensor),
            each.begins,
            math.inf if each.lasts is None else each.begins + each.lasts,
        )
        for each in outages
    ]
    return np.array(rows, np.float64).reshape(-1, 3)
