"""The filter of choice: an extended Kalman filter whose errors live on the group of extended poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dream.estimation._kernels import inekf
from dream.estimation.intake import VERDICTS, Outcome, Source, Verdict, refusal
from dream.estimation.kalman import KalmanFilter, KalmanState
from dream.geometry import SE3
from dream.measurements import Dvl

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class InEkfState(KalmanState):
    """What the filter knows at one time. Vectors are in the world unless named otherwise.

    The error is (ξ_R, ξ_v, ξ_p, δb_g, δb_a) with X = Exp(ξ) X̂ and b = b̂ + δb: in the world, so that rotations
    turn about its origin and not about the vehicle. `position_covariance` is what users want.
    """

    kernels: ClassVar[Any] = inekf

    rotation: Float64Array
    """(3, 3) base to world."""

    @property
    def heading_attitude(self) -> Float64Array:
        """(3, 3) the rotation."""
        return self.rotation

    @property
    def pose(self) -> SE3:
        """T_world_base."""
        return SE3(self.rotation.copy(), self.position.copy())

    @property
    def position_covariance(self) -> Float64Array:
        """(3, 3) m², of the position in the world."""
        covariance: Float64Array = inekf.position_covariance(self.packed)
        return covariance

    @property
    def velocity_covariance(self) -> Float64Array:
        """(3, 3) m²/s², of the velocity over ground in the world."""
        covariance: Float64Array = inekf.velocity_covariance(self.packed)
        return covariance


@dataclass(frozen=True, slots=True)
class InEkf(KalmanFilter[InEkfState]):
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

    state: ClassVar[type[InEkfState]] = InEkfState

    rest_after: float = 0.5
    """Seconds since it was told to stop."""
    rest_speed: float = 0.05
    """m/s, above which it is not at rest; for the estimate and for the DVL."""
    rest_rate: float = 0.05
    """rad/s, above which it is not at rest."""

    @staticmethod
    def _beginning(
        rotation: Float64Array, velocity: Float64Array, position: Float64Array, sigmas: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        return inekf.initial_covariance(rotation, velocity, position, sigmas), rotation

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
        after, code, nis = inekf.correct_rest(self.compiled, state.packed)
        return InEkfState(*after, outcome=Outcome(Source.REST, VERDICTS[code], nis))
