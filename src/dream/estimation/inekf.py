"""The filter of choice: an extended Kalman filter whose errors live on the group of extended poses."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from dream.estimation._kernels import inekf as kernels
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
from dream.estimation.intake import (
    VERDICTS,
    Outcome,
    Source,
    Verdict,
    carried,
    corrected,
    plain,
    refusal,
)
from dream.geometry import SE3
from dream.measurements import Dvl, Imu, Measurement

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class InEkfState:
    """What the filter knows at one time. Vectors are in the world unless named otherwise."""

    time: float
    rotation: Float64Array
    """(3, 3) base to world."""
    velocity: Float64Array
    """(3,) m/s over ground."""
    position: Float64Array
    """(3,) metres."""
    gyro_bias: Float64Array
    """(3,) rad/s, in `base`."""
    accelerometer_bias: Float64Array
    """(3,) m/s², in `base`."""
    covariance: Float64Array
    """(15, 15) of the error (ξ_R, ξ_v, ξ_p, δb_g, δb_a) with X = Exp(ξ) X̂ and b = b̂ + δb: in the world, so
    that rotations turn about its origin and not about the vehicle. `position_covariance` is what users
    want."""
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
    def pose(self) -> SE3:
        """T_world_base."""
        return SE3(self.rotation.copy(), self.position.copy())

    @property
    def angular_velocity(self) -> Float64Array:
        """(3,) rad/s, in `base`, without the bias."""
        return self.gyro - self.gyro_bias

    @property
    def position_covariance(self) -> Float64Array:
        """(3, 3) m², of the position in the world."""
        covariance: Float64Array = kernels.position_covariance(packed(self))
        return covariance

    @property
    def velocity_covariance(self) -> Float64Array:
        """(3, 3) m²/s², of the velocity over ground in the world."""
        covariance: Float64Array = kernels.velocity_covariance(packed(self))
        return covariance

    @property
    def yaw_sigma(self) -> float:
        """Radians; NaN beyond 84° of pitch, where there is no heading."""
        return math.sqrt(kernels.yaw_variance(packed(self)))

    def error(
        self,
        T_world_base: SE3,
        velocity: Float64Array,
        gyro_bias: Float64Array,
        accelerometer_bias: Float64Array,
    ) -> Float64Array:
        """(15,) what a truth differs by, in the coordinates of `covariance`."""
        truth = (T_world_base.rotation, velocity, T_world_base.translation, gyro_bias, accelerometer_bias)
        error: Float64Array = kernels.error(packed(self), *map(plain, truth))
        return error


@dataclass(frozen=True, slots=True)
class InEkf:
    """Attitude, velocity, position and the biases of the IMU, from IMU, DVL, pressure and heading.

    What it does: carries the extended pose (R, v, p) of SE_2(3) by the IMU, exactly for samples of constant
    rate and force, and corrects it by what the other sensors say, each behind a gate on its innovation. As
    the error is defined in the world (right-invariant), its propagation does not depend on the trajectory
    but through the biases, and what cannot be observed stays so: without a heading, yaw and horizontal
    position never grow more certain.
    Reference: Barrau and Bonnabel, IEEE TAC 2017 (arXiv 1410.1465); Potokar, Norman and Mangelson, RA-L
    2021. The rate of the lever arm is freed of the gyro's bias, with its column in the rows; depth is one
    scalar row, which is the same as the three with infinite variance on x and y that the second paper uses.
    Assumes: the IMU at the origin of `base` and aligned with it; white noise of the stated densities;
    biases that walk; a world that does not turn (the Earth's 7e-5 rad/s is taken for bias).
    Fails when: a scale error of the DVL is not in its covariance: it goes into the position in full, since
    nothing here observes it. A DVL that is wrong, and sure of itself, for longer than `patience` is
    believed.
    """

    imu: InertialErrors = field(default_factory=InertialErrors)
    mounting: Mounting = field(default_factory=Mounting)
    start: Start = field(default_factory=Start)
    trust: Trust = field(default_factory=Trust)
    gap: Gap = field(default_factory=Gap)
    rest_after: float = 0.5
    """Seconds since it was told to stop."""
    rest_speed: float = 0.05
    """m/s, above which it is not at rest; for the estimate and for the DVL."""
    rest_rate: float = 0.05
    """rad/s, above which it is not at rest."""

    def begin(self, time: float, T_world_base: SE3, velocity: npt.ArrayLike = (0.0, 0.0, 0.0)) -> InEkfState:
        """The state at the start: a pose and a velocity over ground (3,), as certain as the fields say."""
        start = (T_world_base.rotation, velocity, T_world_base.translation)
        rotation, speed, position = map(plain, start)
        sigmas = np.array(start_sigmas(self.start))
        covariance = kernels.initial_covariance(rotation, speed, position, sigmas)
        # Before the first sample nothing is known of the rate: one radian a second.
        return InEkfState(
            time,
            rotation,
            speed,
            position,
            np.zeros(3),
            np.zeros(3),
            covariance,
            np.zeros(3),
            1.0,
            time,
            np.full(2, np.nan),
        )

    def predict(self, state: InEkfState, imu: Imu, dt: float) -> InEkfState:
        """The state `dt` seconds later, after an inertial sample that stands for all of them.

        Raises:
            ValueError: The sample is not finite, or `dt` not above 0.
        """
        moved = carried(kernels, _parameters(self), packed(state), imu, dt)
        return InEkfState(*moved, outcome=state.outcome)

    def bridge(self, state: InEkfState, imu: Imu, dt: float) -> InEkfState:
        """The state `dt` seconds later, where samples are missing and one stands in for them.

        It moves as by `predict`, and is as uncertain as `Gap` says.

        Raises:
            ValueError: The sample is not finite, or `dt` not above 0.
        """
        moved = carried(kernels, _unsensed(self), packed(state), imu, dt)
        return InEkfState(*moved, outcome=state.outcome)

    def correct(self, state: InEkfState, measurement: Measurement) -> InEkfState:
        """The state after a measurement of its own time; where that is refused, the outcome says why."""
        after, outcome = corrected(kernels, _parameters(self), packed(state), measurement, state.rotation)
        return InEkfState(*after, outcome=outcome)

    def rest(self, state: InEkfState, stopped_for: float, dvl: Dvl | None) -> InEkfState:
        """The state after the word that the vehicle rests, where nothing speaks against it.

        A vehicle that hovers in a current which no sensor sees is not at rest over ground: without a DVL this
        locks a drift out of the estimate. So it is weak, and meant to be said about once a second, not at
        every sample.

        Args:
            state: Where it is said.
            stopped_for: Seconds since the last command was to stop.
            dvl: Its latest report; None where there was none of late.
        """
        still = (
            stopped_for >= self.rest_after
            and bool(np.linalg.norm(state.velocity) < self.rest_speed)
            and bool(np.linalg.norm(state.angular_velocity) < self.rest_rate)
            and (
                dvl is None
                or refusal(dvl) is not None
                or bool(np.linalg.norm(dvl.velocity) < self.rest_speed)
            )
        )
        if not still:
            return replace(state, outcome=Outcome(Source.REST, Verdict.MOVING))
        after, code, nis = kernels.correct_rest(_parameters(self), packed(state))
        return InEkfState(*after, outcome=Outcome(Source.REST, VERDICTS[code], nis))

    @property
    def compiled(self) -> Parameters:
        """The fields as the kernels take them, for loops that are compiled themselves."""
        return _parameters(self)


@lru_cache(maxsize=64)
def _parameters(chosen: InEkf) -> Parameters:
    return parameters(chosen.imu, chosen.mounting, chosen.trust)


@lru_cache(maxsize=64)
def _unsensed(chosen: InEkf) -> Parameters:
    return unsensed(_parameters(chosen), chosen.gap)


def packed(state: InEkfState) -> kernels.State:
    """A state as the kernels take it."""
    return kernels.State(*(getattr(state, name) for name in kernels.State._fields))
