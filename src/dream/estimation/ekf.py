"""The textbook's filter, to compare with: a quaternion, and an error in the frame of the vehicle."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from dream.estimation._kernels import ekf as kernels
from dream.estimation._kernels.groups import quaternion_from, rotation_from
from dream.estimation._kernels.sensors import Parameters
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
from dream.estimation.intake import Outcome, carried, corrected, plain
from dream.geometry import SE3
from dream.measurements import Imu, Measurement

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class EkfState:
    """What the filter knows at one time. Vectors are in the world unless named otherwise."""

    time: float
    wxyz: Float64Array
    """(4,) base to world."""
    velocity: Float64Array
    """(3,) m/s over ground."""
    position: Float64Array
    """(3,) metres."""
    gyro_bias: Float64Array
    """(3,) rad/s, in `base`."""
    accelerometer_bias: Float64Array
    """(3,) m/s², in `base`."""
    covariance: Float64Array
    """(15, 15) of the error (δθ, δv, δp, δb_g, δb_a) with q = q̂ ⊗ Exp(δθ), so in `base`, and differences."""
    gyro: Float64Array
    """(3,) rad/s, the last sample as it came."""
    gyro_variance: float
    """(rad/s)² of each axis of it."""
    begun: float
    """The time when it began, or began anew after it had been lost."""
    refused_since: Float64Array
    """(2,) when the DVL and the depth began to be refused, each time since; NaN where the last was taken."""
    outcome: Outcome | None = None
    """What became of the last measurement; None where there was none."""

    @property
    def rotation(self) -> Float64Array:
        """(3, 3) base to world."""
        rotation: Float64Array = rotation_from(self.wxyz)
        return rotation

    @property
    def pose(self) -> SE3:
        """T_world_base."""
        return SE3(self.rotation, self.position)

    @property
    def angular_velocity(self) -> Float64Array:
        """(3,) rad/s, in `base`, without the bias."""
        return self.gyro - self.gyro_bias

    @property
    def position_covariance(self) -> Float64Array:
        """(3, 3) m², of the position in the world."""
        return self.covariance[6:9, 6:9].copy()

    @property
    def yaw_sigma(self) -> float:
        """Radians; NaN beyond 84° of pitch, where there is no heading."""
        return math.sqrt(kernels.yaw_variance(_packed(self)))

    def error(
        self,
        T_world_base: SE3,
        velocity: Float64Array,
        gyro_bias: Float64Array,
        accelerometer_bias: Float64Array,
    ) -> Float64Array:
        """(15,) what a truth differs by, in the coordinates of `covariance`."""
        truth = (T_world_base.rotation, velocity, T_world_base.translation, gyro_bias, accelerometer_bias)
        error: Float64Array = kernels.error(_packed(self), *map(plain, truth))
        return error


@dataclass(frozen=True, slots=True)
class Ekf:
    """Attitude, velocity, position and the biases of the IMU, by the usual extended Kalman filter.

    What it does: the same as `InEkf` with the same sensors, gates and Joseph form, but with the error in
    the frame of the vehicle. The motion is as exact, since Euler's rule would err by more than the IMU does
    at 100 Hz.
    Reference: Solà, Quaternion kinematics for the error-state Kalman filter, arXiv 1711.02508. The reset
    after a correction leaves the covariance as it is (right to first order).
    Assumes: what `InEkf` does.
    Fails when: its errors are large. What its rows observe depends on the estimate, so that without a
    heading it comes to believe that it knows the yaw, which nothing told it.
    """

    imu: InertialErrors = field(default_factory=InertialErrors)
    mounting: Mounting = field(default_factory=Mounting)
    start: Start = field(default_factory=Start)
    trust: Trust = field(default_factory=Trust)
    gap: Gap = field(default_factory=Gap)

    def begin(self, time: float, T_world_base: SE3, velocity: npt.ArrayLike = (0.0, 0.0, 0.0)) -> EkfState:
        """The state at the start: a pose and a velocity over ground (3,), as certain as the fields say."""
        sigmas = np.array(start_sigmas(self.start))
        # The sigmas of velocity and position are the same along all axes, and so in the world.
        return EkfState(
            time,
            quaternion_from(plain(T_world_base.rotation)),
            plain(velocity).copy(),
            plain(T_world_base.translation).copy(),
            np.zeros(3),
            np.zeros(3),
            np.diag(sigmas * sigmas),
            np.zeros(3),
            1.0,
            time,
            np.full(2, np.nan),
        )

    def predict(self, state: EkfState, imu: Imu, dt: float) -> EkfState:
        """The state `dt` seconds later, after an inertial sample that stands for all of them.

        Raises:
            ValueError: The sample is not finite, or `dt` not above 0.
        """
        moved = carried(kernels, _parameters(self), _packed(state), imu, dt)
        return EkfState(*moved, outcome=state.outcome)

    def bridge(self, state: EkfState, imu: Imu, dt: float) -> EkfState:
        """The state `dt` seconds later, where samples are missing and one stands in for them.

        It moves as by `predict`, and is as uncertain as `Gap` says.

        Raises:
            ValueError: The sample is not finite, or `dt` not above 0.
        """
        moved = carried(kernels, _unsensed(self), _packed(state), imu, dt)
        return EkfState(*moved, outcome=state.outcome)

    def correct(self, state: EkfState, measurement: Measurement) -> EkfState:
        """The state after a measurement of its own time; where that is refused, the outcome says why."""
        after, outcome = corrected(kernels, _parameters(self), _packed(state), measurement, state.rotation)
        return EkfState(*after, outcome=outcome)

    @property
    def compiled(self) -> Parameters:
        """The fields as the kernels take them, for loops that are compiled themselves."""
        return _parameters(self)


@lru_cache(maxsize=64)
def _parameters(chosen: Ekf) -> Parameters:
    return parameters(chosen.imu, chosen.mounting, chosen.trust)


@lru_cache(maxsize=64)
def _unsensed(chosen: Ekf) -> Parameters:
    return unsensed(_parameters(chosen), chosen.gap)


def _packed(state: EkfState) -> kernels.State:
    return kernels.State(*(getattr(state, name) for name in kernels.State._fields))
