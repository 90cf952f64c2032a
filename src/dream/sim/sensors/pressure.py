"""State → height by water pressure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.measurements import Depth
from dream.sim.sensors import _kernels
from dream.sim.vehicle import State

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PressureGauge:
    """A gauge that is set to zero at the surface before the dive.

    What it does: reads its own height with white noise in steps of its resolution; its zero walks with
    temperature, tide and weather, and a wrong density of the water stretches the scale.
    Reference: Blue Robotics Bar30, a TE Connectivity MS5837-30BA (data sheet of 12/2019): 30 bar, 0.2 mbar or
    2 mm of resolution.
    Assumes: waves and the flow past the vehicle make no pressure.
    """

    rate: float = 10.0
    """Hertz: how often it is read."""
    position: tuple[float, float, float] = (-0.2, 0.0, 0.0)
    """Metres in `base`. Assumption: in the end cap, behind."""
    noise: float = 0.003
    """Metres. Assumption: the step of resolution and what a moving vehicle adds."""
    resolution: float = 0.002
    """Metres."""
    zero: float = 0.01
    """Metres: deviation of the zero after it was set at the surface. Assumption."""
    walk: float = 0.0002
    """m/√s by which the zero walks. Assumption: 12 mm in an hour."""
    density_error: float = 0.002
    """Deviation of the share by which the density is wrong. Assumption: the operator has told sea, which is a
    share of 0.03 denser, from fresh water."""
    max_depth: float = 300.0
    """Metres."""

    def __post_init__(self) -> None:
        for name in ("rate", "resolution", "max_depth"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"pressure.{name}: expected a number above 0, got {getattr(self, name)}")
        for name in ("noise", "zero", "walk", "density_error"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"pressure.{name}: expected 0 or more, got {getattr(self, name)}")

    @property
    def constants(self) -> _kernels.Pressure:
        """As the kernels take it; a whole number among them would have the kernels compiled once more."""
        return _kernels.Pressure(
            np.array(self.position, np.float64),
            float(self.noise),
            float(self.walk),
            float(self.resolution),
            float(self.max_depth),
        )

    @property
    def sigma(self) -> float:
        """Metres: noise and rounding, which is what it reports; zero and density it does not know of."""
        return math.sqrt(self.noise**2 + self.resolution**2 / 12.0)

    @property
    def stuck_rise(self) -> float:
        """Metres that it rises or sinks while readings are the same, to the bit, by which it is stuck."""
        return 20.0 * self.sigma

    @property
    def stuck_readings(self) -> float:
        """Readings that are the same as the one before, on end, by which it is stuck, whatever moves.

        In the middle of a step of its resolution a reading is the same again with a probability of
        erf(resolution / (√8 noise)); so many are by chance once in 10^11. Infinite without noise.
        """
        again = math.erf(self.resolution / (math.sqrt(8.0) * self.noise)) if self.noise > 0.0 else 1.0
        return math.ceil(math.log(1e-11) / math.log(again)) if again < 1.0 else math.inf

    def begin(self, rng: np.random.Generator) -> Float64Array:
        """(2,) zero in metres and share of the density that a mission begins with."""
        return np.array([self.zero, self.density_error]) * rng.standard_normal(2)

    def read(
        self, time: float, state: State, error: Float64Array, rng: np.random.Generator
    ) -> tuple[Depth, Float64Array]:
        """A reading 1 / rate seconds after the last, and the error (2,) that the next one begins with."""
        later = np.array(error, np.float64)
        z = _kernels.pressure(self.constants, State.of(state.vector).vector, 1.0 / self.rate, later, rng)
        return Depth(time, z, self.sigma), later


BAR30 = PressureGauge()
"""The depth sensor of a BlueROV2."""
