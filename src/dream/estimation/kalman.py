"""What the Kalman filters share: all but the error whose covariance they carry."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from dream.estimation._kernels.sensors import Parameters
from dream.estimation.estimator import Estimator, State
from dream.estimation.instruments import (
    Gap,
    InertialErrors,
    Mounting,
    Start,
    Trust,
    parameters,
    start_sigmas,
    unsensed,
)
from dream.estimation.intake import plain
from dream.geometry import SE3
from dream.measurements import Imu

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class KalmanState(State):
    """Velocity, position and biases, with the covariance of an error; a filter adds its attitude."""

    velocity: Float64Array
    """(3,) m/s over ground."""
    position: Float64Array
    """(3,) metres."""
    gyro_bias: Float64Array
    """(3,) rad/s, in `base`."""
    accelerometer_bias: Float64Array
    """(3,) m/s², in `base`."""
    covariance: Float64Array
    """(15, 15) of the error of attitude, velocity, position and both biases, as the filter defines it."""
    gyro: Float64Array
    """(3,) rad/s, the last sample, its bias included: the lever arm of the DVL needs it."""
    gyro_variance: float
    """(rad/s)² of each axis of it."""
    begun: float
    """The time when it began, or began anew after it had been lost."""
    refused_since: Float64Array
    """(2,) when the DVL and the depth began to be refused, each time since; NaN where the last was taken."""

    @property
    @abstractmethod
    def position_covariance(self) -> Float64Array:
        """(3, 3) m², of the position in the world."""

    @property
    def angular_velocity(self) -> Float64Array:
        """(3,) rad/s, in `base`, without the bias."""
        return self.gyro - self.gyro_bias

    @property
    def yaw_sigma(self) -> float:
        """Radians; NaN beyond 84° of pitch, where there is no heading."""
        return math.sqrt(self.kernels.yaw_variance(self.packed))

    def error(
        self,
        T_world_base: SE3,
        velocity: Float64Array,
        gyro_bias: Float64Array,
        accelerometer_bias: Float64Array,
    ) -> Float64Array:
        """(15,) what a truth differs by, in the coordinates of `covariance`."""
        truth = (T_world_base.rotation, velocity, T_world_base.translation, gyro_bias, accelerometer_bias)
        error: Float64Array = self.kernels.error(self.packed, *map(plain, truth))
        return error


K = TypeVar("K", bound=KalmanState)


@dataclass(frozen=True, slots=True)
class KalmanFilter(Estimator[K]):
    """Attitude, velocity, position and the biases of the IMU, from IMU, DVL, pressure and heading.

    What it does: carries the state by the IMU, exactly for samples of constant rate and force, and corrects
    it by what the other sensors say, each behind a gate on its innovation, in Joseph's form.
    """

    state: ClassVar[type[Any]]
    """What it carries."""

    imu: InertialErrors = field(default_factory=InertialErrors)
    mounting: Mounting = field(default_factory=Mounting)
    start: Start = field(default_factory=Start)
    trust: Trust = field(default_factory=Trust)
    gap: Gap = field(default_factory=Gap)

    @staticmethod
    @abstractmethod
    def _beginning(
        rotation: Float64Array, velocity: Float64Array, position: Float64Array, sigmas: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """Covariance of errors in the frame of the vehicle with these sigmas (15,), and the attitude."""

    def begin(self, time: float, T_world_base: SE3, velocity: npt.ArrayLike = (0.0, 0.0, 0.0)) -> K:
        """The state at the start: a pose and a velocity over ground (3,), as certain as the fields say."""
        start = (T_world_base.rotation, velocity, T_world_base.translation)
        rotation, speed, position = (plain(given).copy() for given in start)
        covariance, attitude = self._beginning(rotation, speed, position, np.array(start_sigmas(self.start)))
        # Before the first sample nothing is known of the rate: one radian a second.
        state: K = self.state(
            time,
            speed,
            position,
            np.zeros(3),
            np.zeros(3),
            covariance,
            np.zeros(3),
            1.0,
            time,
            np.full(2, np.nan),
            attitude,
        )
        return state

    def bridge(self, state: K, imu: Imu, dt: float) -> K:
        """The state `dt` seconds later, where samples are missing and one stands in for them.

        It moves as by `predict`, and is as uncertain as `Gap` says.

        Raises:
            ValueError: The sample is not finite, or `dt` not above 0.
        """
        return self._carried(_unsensed(self), state, imu, dt)

    @property
    def compiled(self) -> Parameters:
        """The fields as the kernels take them, for loops that are compiled themselves."""
        return _parameters(self)


@lru_cache(maxsize=64)
def _parameters(chosen: KalmanFilter[Any]) -> Parameters:
    return parameters(chosen.imu, chosen.mounting, chosen.trust)


@lru_cache(maxsize=64)
def _unsensed(chosen: KalmanFilter[Any]) -> Parameters:
    return unsensed(_parameters(chosen), chosen.gap)
