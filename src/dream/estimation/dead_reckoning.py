"""The baseline: go by what the instruments last said."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dream.estimation._kernels import dead_reckoning as kernels
from dream.estimation.estimator import Estimator, State
from dream.estimation.instruments import Mounting
from dream.estimation.intake import plain
from dream.geometry import SE3
from dream.measurements import Imu

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class DeadReckoningState(State):
    """Where the vehicle is by the last readings."""

    kernels: ClassVar[Any] = kernels

    rotation: Float64Array
    """(3, 3) base to world."""
    own_velocity: Float64Array
    """(3,) m/s over ground, in `base`, as the DVL last saw it."""
    position: Float64Array
    """(3,) metres in the world."""
    gyro: Float64Array
    """(3,) rad/s, the last sample."""
    heading_time: float
    """Of the last heading; NaN before the first."""

    @property
    def heading_attitude(self) -> Float64Array:
        """(3, 3) the rotation."""
        return self.rotation

    @property
    def pose(self) -> SE3:
        """T_world_base."""
        return SE3(self.rotation, self.position)

    @property
    def velocity(self) -> Float64Array:
        """(3,) m/s over ground, in the world."""
        return self.rotation @ self.own_velocity

    @property
    def angular_velocity(self) -> Float64Array:
        """(3,) rad/s, in `base`, bias and all."""
        return self.gyro.copy()


@dataclass(frozen=True, slots=True)
class DeadReckoning(Estimator[DeadReckoningState]):
    """Attitude by a complementary filter, velocity from the DVL, height from the pressure.

    What it does: turns by the gyro, drawn level by the accelerometer and to the north by the compass; moves
    as the DVL last said, for as long as it says nothing else. What it is told it believes.
    Reference: for the levelling, Mahony, Hamel and Pflimlin, IEEE TAC 2008.
    Assumes: no bias of the gyro, and accelerations that are small beside gravity.
    Fails when: the gyro has a bias, which tilts and turns it by bias × time constant; the DVL is lost on a
    turn. There is no covariance, so nothing is ever found unlikely.
    """

    mounting: Mounting = field(default_factory=Mounting)
    tilt_time: float = 5.0
    """Seconds in which an error of roll or pitch falls to a third. Ours."""
    heading_time: float = 2.0
    """Seconds in which an error of the yaw falls to a third. Ours."""

    def begin(
        self, time: float, T_world_base: SE3, velocity: npt.ArrayLike = (0.0, 0.0, 0.0)
    ) -> DeadReckoningState:
        """The state at the start: a pose and a velocity over ground (3,) in the world."""
        rotation = plain(T_world_base.rotation).copy()
        position = plain(T_world_base.translation).copy()
        return DeadReckoningState(time, rotation, rotation.T @ plain(velocity), position, np.zeros(3), np.nan)

    def bridge(self, state: DeadReckoningState, imu: Imu, dt: float) -> DeadReckoningState:
        """As `predict`: without a covariance, there is nothing to tell of what is missing."""
        return self.predict(state, imu, dt)

    @property
    def compiled(self) -> kernels.Parameters:
        """The fields as the kernels take them, for loops that are compiled themselves."""
        return _parameters(self)


@lru_cache(maxsize=64)
def _parameters(chosen: DeadReckoning) -> kernels.Parameters:
    return kernels.Parameters(
        tilt_time=chosen.tilt_time,
        heading_time=chosen.heading_time,
        dvl_rotation=plain(chosen.mounting.T_base_dvl.rotation),
        dvl_position=plain(chosen.mounting.T_base_dvl.translation),
        pressure_position=plain(chosen.mounting.pressure_sensor),
    )
