"""Two states → turn rate and specific force."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.measurements import Imu
from dream.sim.sensors import _kernels
from dream.sim.vehicle import State
from dream.vehicle import GRAVITY

Float64Array = npt.NDArray[np.float64]

DEGREE = math.pi / 180.0


@dataclass(frozen=True, slots=True)
class InertialUnit:
    """Gyroscopes and accelerometers at the origin of `base`, aligned with it.

    What it does: a sample is the constant turn rate and specific force that carry a strapdown integration
    from one state to the next, plus a bias that walks and white noise, and ends at the range of the unit.
    Reference: the densities and ranges of the TDK InvenSense ICM-20602 (DS-000176 rev. 1.0), which the Blue
    Robotics Navigator and most ArduSub autopilots of its time carry.
    Assumes: no scale errors, misalignment or lever arm; vibration counts as noise.
    """

    rate: float = 100.0
    """Hertz: how often it is read."""
    gyro_noise: float = 0.004 * DEGREE
    """rad/s/√Hz: 4 mdps/√Hz."""
    accel_noise: float = 100e-6 * GRAVITY
    """m/s²/√Hz: 100 µg/√Hz."""
    gyro_bias: float = 1.0 / 3.0 * DEGREE
    """rad/s: deviation of the first bias. Assumption: three of them are 1°/s, before any calibration."""
    accel_bias: float = 0.025 / 3.0 * GRAVITY
    """m/s²: deviation of the first bias. Assumption: three of them are 25 mg."""
    gyro_walk: float = 1e-5
    """rad/s/√s. Assumption: 0.03°/s in an hour."""
    accel_walk: float = 1e-4
    """m/s²/√s. Assumption: 6 mm/s² in an hour."""
    gyro_range: float = 2000.0 * DEGREE
    """rad/s."""
    accel_range: float = 16.0 * GRAVITY
    """m/s²."""

    def __post_init__(self) -> None:
        for name in ("rate", "gyro_range", "accel_range"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"imu.{name}: expected a number above 0, got {getattr(self, name)}")
        for name in ("gyro_noise", "accel_noise", "gyro_bias", "accel_bias", "gyro_walk", "accel_walk"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"imu.{name}: expected 0 or more, got {getattr(self, name)}")

    @property
    def constants(self) -> _kernels.Inertial:
        """As the kernels take it; a whole number among them would have the kernels compiled once more."""
        return _kernels.Inertial(
            float(self.gyro_noise),
            float(self.gyro_walk),
            float(self.accel_noise),
            float(self.accel_walk),
            float(self.gyro_range),
            float(self.accel_range),
            GRAVITY,
        )

    def begin(self, rng: np.random.Generator) -> Float64Array:
        """(6,) the biases that a mission begins with: rad/s, then m/s²."""
        return np.repeat([self.gyro_bias, self.accel_bias], 3) * rng.standard_normal(6)

    def read(
        self,
        time: float,
        before: State,
        after: State,
        bias: Float64Array,
        rng: np.random.Generator,
    ) -> tuple[Imu, Float64Array]:
        """A sample, and the bias (6,) that the next one begins with.

        Args:
            time: When the sample ends.
            before: The state 1 / rate seconds earlier.
            after: The state at `time`.
            bias: (6,) from `begin` or the last sample.
            rng: Of the mission.
        """
        later, out = np.array(bias, np.float64), np.empty(6)
        first, last = State.of(before.vector).vector, State.of(after.vector).vector
        _kernels.inertial(self.constants, first, last, 1.0 / self.rate, later, rng, out)
        return Imu(time, out[:3].copy(), out[3:].copy()), later


ICM_20602 = InertialUnit()
"""The unit of the Navigator."""
