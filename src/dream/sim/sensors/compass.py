"""State → yaw by the Earth's field."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.measurements import Heading
from dream.sim.sensors import _kernels
from dream.sim.vehicle import State

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Dipole:
    """A piece of steel, seen from some metres away."""

    position: tuple[float, float, float]
    """Metres in the world."""
    moment: tuple[float, float, float]
    """m³, in the world: ahead of it, at distance r, its field is 2 |moment| / r³ of the Earth's horizontal
    one. A compact ton of steel that the Earth magnetises has about 0.2 (0.13 m³, magnetised to ten times the
    field that reaches it, which is twice its horizontal part); what is welded may have several times that."""


@dataclass(frozen=True, slots=True)
class Compass:
    """A compass that is levelled by its attitude, as in an attitude and heading reference.

    What it does: reads the direction of the horizontal field, of which the vehicle's own iron and pieces of
    steel nearby are a part, with a constant offset, an error that wanders (a Gauss-Markov process) and noise.
    Assumes: levelling is perfect and declination is known. All figures are assumptions: a heading of a
    calibrated magnetometer on a small vehicle is good to 2 to 3°.
    """

    rate: float = 10.0
    """Hertz: how often it is read."""
    offset: float = math.radians(1.5)
    """Radians: deviation of the constant offset of a mission, from mounting and declination."""
    iron: float = 0.02
    """Share of the horizontal field: deviation, on either axis, of the vehicle's own that calibration left
    over. It errs by once around the compass."""
    wander: float = math.radians(0.5)
    """Radians: deviation of what wanders, with the current in the thrusters and the like."""
    wander_time: float = 30.0
    """Seconds after which it has fallen to 1/e."""
    noise: float = math.radians(0.3)
    """Radians, in each reading anew."""
    steel: tuple[Dipole, ...] = ()
    """What disturbs the field: wrecks, piles. None by default."""

    def __post_init__(self) -> None:
        for name in ("rate", "wander_time"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"compass.{name}: expected a number above 0, got {getattr(self, name)}")
        for name in ("offset", "iron", "wander", "noise"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"compass.{name}: expected 0 or more, got {getattr(self, name)}")

    @property
    def constants(self) -> _kernels.Magnetic:
        """As the kernels take it; a whole number among them would have the kernels compiled once more."""
        steel = [[*piece.position, *piece.moment] for piece in self.steel]
        return _kernels.Magnetic(
            float(self.noise),
            float(self.wander),
            float(self.wander_time),
            np.array(steel, np.float64).reshape(-1, 6),
        )

    @property
    def sigma(self) -> float:
        """Radians: all errors but those of steel nearby, which it does not know of."""
        return math.sqrt(self.offset**2 + self.iron**2 + self.wander**2 + self.noise**2)

    def begin(self, rng: np.random.Generator) -> Float64Array:
        """(4,) offset and what wanders, radians; iron ahead and to the left, shares."""
        return np.array([self.offset, self.wander, self.iron, self.iron]) * rng.standard_normal(4)

    def read(
        self, time: float, state: State, error: Float64Array, rng: np.random.Generator
    ) -> tuple[Heading, Float64Array]:
        """A reading 1 / rate seconds after the last, and the error (4,) that the next one begins with."""
        later = np.array(error, np.float64)
        yaw = _kernels.heading(self.constants, State.of(state.vector).vector, 1.0 / self.rate, later, rng)
        return Heading(time, yaw, self.sigma), later


AHRS = Compass()
"""The heading of an autopilot such as ArduSub's."""
