"""What pulls a vehicle off its way: the current and the tether."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.sim.vehicle import _kernels

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Current:
    """Water that moves: evenly, faster with height, and in gusts.

    What it does: mean + shear · (z − level), and on both horizontal axes an Ornstein-Uhlenbeck process.
    Reference: Fossen, *Handbook of Marine Craft Hydrodynamics and Motion Control* (2011), section 8.3, uses a
    first-order Gauss-Markov process for the speed; two axes need no special case where it passes zero.
    Assumes: gusts change slowly, so that the force of accelerating water is left out.
    """

    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """m/s in the world, at height `level`."""
    shear: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """m/s more of it per metre upwards."""
    level: float = 0.0
    """Metres in the world."""
    gust: float = 0.0
    """m/s: standard deviation of each horizontal axis. A tank that a vehicle has stirred has 0.05 to 0.1."""
    gust_time: float = 20.0
    """Seconds after which a gust has fallen to 1/e."""

    def __post_init__(self) -> None:
        if not np.isfinite([*self.mean, *self.shear, self.level]).all():
            raise ValueError(f"current: expected finite numbers, got {self}")
        if not 0.0 <= self.gust < math.inf:
            raise ValueError(f"current.gust: expected 0 or more, got {self.gust}")
        if not 0.0 < self.gust_time < math.inf:
            raise ValueError(f"current.gust_time: expected a number above 0, got {self.gust_time}")

    @property
    def flow(self) -> _kernels.Flow:
        """As the kernels take it."""
        return _kernels.Flow(
            np.array(self.mean, np.float64),
            np.array(self.shear, np.float64),
            float(self.level),
            float(self.gust),
            float(self.gust_time),
        )

    def begin(self, rng: np.random.Generator) -> Float64Array:
        """(2,) a first gust: how gusts are distributed at any time."""
        return self.gust * rng.standard_normal(2)

    def stirred(self, gust: Float64Array, dt: float, rng: np.random.Generator) -> Float64Array:
        """(2,) the gust dt seconds later."""
        later = np.array(gust, np.float64)
        _kernels.stir(self.flow, dt, rng, later)
        return later

    def velocity(self, z: float, gust: npt.ArrayLike = (0.0, 0.0)) -> Float64Array:
        """(3,) m/s of the water at height z."""
        mean = np.array(self.mean, np.float64) + np.array(self.shear, np.float64) * (z - self.level)
        mean[:2] += np.asarray(gust, np.float64)
        return mean


STILL = Current()
"""Water that does not move."""


@dataclass(frozen=True, slots=True)
class Tether:
    """A neutral cable straight up from the vehicle to a fixed point at the surface.

    What it does: drags horizontally. A part of the cable moves with the vehicle in proportion to its distance
    from the surface, its drag is that of a cylinder across the flow, and the vehicle carries of it what a
    lever about the surface leaves to its end. In still water this is ρ C_d d L v² / 8.
    Assumes: no stretch, no inertia, no weight, and slack enough that the vehicle never reaches its end.
    Fails when: the cable lies aslant or in a bight: then it drags less, or more.
    """

    diameter: float = 0.0076
    """Metres; the Fathom ROV tether of Blue Robotics."""
    drag_coefficient: float = 1.2
    """A smooth cylinder across the flow below the drag crisis (Hoerner, *Fluid-Dynamic Drag*, 1965)."""
    attachment: tuple[float, float, float] = (-0.2, 0.0, 0.0)
    """Metres in `base`."""

    def __post_init__(self) -> None:
        for name in ("diameter", "drag_coefficient"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"tether.{name}: expected a number above 0, got {getattr(self, name)}")
