"""The textbook's filter, to compare with: a quaternion, and an error in the frame of the vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dream.estimation._kernels import ekf
from dream.estimation._kernels.groups import quaternion_from, rotation_from
from dream.estimation.kalman import KalmanFilter, KalmanState
from dream.geometry import SE3

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class EkfState(KalmanState):
    """What the filter knows at one time. Vectors are in the world unless named otherwise.

    The error is (δθ, δv, δp, δb_g, δb_a) with q = q̂ ⊗ Exp(δθ), so in `base`, and differences in all else.
    """

    kernels: ClassVar[Any] = ekf

    wxyz: Float64Array
    """(4,) base to world."""

    @property
    def rotation(self) -> Float64Array:
        """(3, 3) base to world."""
        rotation: Float64Array = rotation_from(self.wxyz)
        return rotation

    @property
    def heading_attitude(self) -> Float64Array:
        """(3, 3) the rotation."""
        return self.rotation

    @property
    def pose(self) -> SE3:
        """T_world_base."""
        return SE3(self.rotation, self.position)

    @property
    def position_covariance(self) -> Float64Array:
        """(3, 3) m², of the position in the world."""
        return self.covariance[6:9, 6:9].copy()


@dataclass(frozen=True, slots=True)
class Ekf(KalmanFilter[EkfState]):
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

    state: ClassVar[type[EkfState]] = EkfState

    @staticmethod
    def _beginning(
        rotation: Float64Array, velocity: Float64Array, position: Float64Array, sigmas: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        # The sigmas of velocity and position are the same along all axes, and so in the world.
        return np.diag(sigmas * sigmas), quaternion_from(rotation)
