"""Where and how long a vehicle may be, and what is done with one that must not go on."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from dream.geometry import Bounds

SAG = 3.0
"""Seconds that the battery may be below its limit: thrusters make its voltage sag for a moment."""
RESERVE = 0.4
"""Volts above that limit, 0.1 a cell, below which a mission goes home: what is between has to bring it there.
From 3.6 to 3.5 V a cell at rest that is a tenth of the charge (`standin.tank.OPEN_CIRCUIT`), 1.9 Ah: some
sixteen minutes at 100 W, in which a BlueROV2 comes farther at 0.5 m/s than its tether reaches. Below 3.4 V a
cell it is a thirtieth, five minutes."""
LOW_SHARE = 0.2
"""Share of the battery's charge at which it does, where the vehicle tells that."""


class LastResort(enum.StrEnum):
    """What is done with a vehicle that must not go on."""

    HOLD = "hold"
    """Depth and heading, for the operator to take over."""
    SURFACE = "surface"
    DISARM = "disarm"


@dataclass(frozen=True, slots=True)
class Limits:
    """Where and how long the vehicle may be."""

    area: Bounds
    """Of the map's frame."""
    margin: float = 0.5
    """Metres beyond the area at which the dive is over."""
    depth: float = 10.0
    """Metres below the surface, at most."""
    minutes: float = 60.0
    voltage: float = 14.0
    """Volts, at least: four cells of 3.5 V."""
    patience: float = 5.0
    """Seconds of neutral, while it may mend, after which the last resort is taken."""
    last_resort: LastResort = LastResort.SURFACE
    altitude: float = 0.2
    """Metres of the DVL above the seabed, at least."""

    @property
    def homing_voltage(self) -> float:
        """Volts below which a mission goes home."""
        return self.voltage + RESERVE

    @property
    def shorter(self) -> float:
        """Metres of the area's shorter side."""
        return min(self.area.x_max - self.area.x_min, self.area.y_max - self.area.y_min)

    def __post_init__(self) -> None:
        for name in ("depth", "minutes", "patience"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected a limit above 0, got {getattr(self, name)}")
        for name in ("margin", "voltage", "altitude"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected 0 or more, got {getattr(self, name)}")
