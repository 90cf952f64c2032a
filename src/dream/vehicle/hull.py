"""What a vehicle weighs, and how the water holds it back."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

Six = tuple[float, float, float, float, float, float]

GRAVITY = 9.81
"""m/s², as at middle latitudes."""


@dataclass(frozen=True, slots=True)
class Hull:
    """Masses, buoyancy and drag of a hull with three planes of symmetry.

    Axes are surge, sway, heave, roll, pitch and yaw. All numbers are magnitudes: added mass adds, drag slows.
    """

    name: str
    mass: float
    """kg, with the water that is shut in."""
    moments: tuple[float, float, float]
    """kg m² about the centre of gravity."""
    added: Six
    """kg and kg m²."""
    linear: Six
    """N s/m and N m s: drag per speed through the water."""
    quadratic: Six
    """N s²/m² and N m s²: drag per its square."""
    net_buoyancy: float
    """N, upwards. Vehicles are trimmed a little light, so that a dead one comes up."""
    centre_of_buoyancy: tuple[float, float, float]
    """Metres in `base`."""
    height: float = 0.25
    """Metres. Near the surface, buoyancy goes with the part of it that is under water."""

    def __post_init__(self) -> None:
        for name in ("mass", "height"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"hull.{name}: expected a number above 0, got {getattr(self, name)}")
        if not all(0.0 < value < math.inf for value in self.moments):
            raise ValueError(f"hull.moments: expected numbers above 0, got {self.moments}")
        for name in ("added", "linear", "quadratic"):
            values = getattr(self, name)
            if len(values) != 6 or not all(0.0 <= value < math.inf for value in values):
                raise ValueError(f"hull.{name}: expected six magnitudes, 0 or more, got {values}")
        if not np.isfinite([self.net_buoyancy, *self.centre_of_buoyancy]).all():
            raise ValueError(f"hull: expected finite buoyancy and its centre, got {self}")

    @property
    def overturning(self) -> float:
        """m/s through the water beyond which nothing but thrusters keeps its nose level; infinite for a hull
        that the water turns the other way.

        What the water does to the nose (Munk's moment, the difference of the added masses times u² sin θ)
        then outgrows what the centre of buoyancy gives back.
        """
        munk = self.added[2] - self.added[0]
        righting = (self.weight + self.net_buoyancy) * self.centre_of_buoyancy[2]
        if munk <= 0.0:
            return math.inf
        return math.sqrt(max(righting, 0.0) / munk)

    @property
    def weight(self) -> float:
        """N."""
        return self.mass * GRAVITY
