"""Two observers in a row, each a least-squares problem over the last samples: our reconstruction of C-IPG."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dream.estimation._kernels import cipg as kernels
from dream.estimation._kernels.groups import quaternion_from
from dream.estimation.estimator import Estimator, State
from dream.estimation.instruments import Mounting
from dream.estimation.intake import plain
from dream.geometry import SE3
from dream.measurements import Imu

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class CipgState(State):
    """What the observer knows at one time. Vectors are in the world unless named otherwise."""

    kernels: ClassVar[Any] = kernels

    rotation: Float64Array
    """(3, 3) base to world."""
    velocity: Float64Array
    """(3,) m/s over ground."""
    position: Float64Array
    """(3,) metres."""
    gyro: Float64Array
    """(3,) rad/s, the last sample."""
    reference: Float64Array
    """(3, 3) the attitude that lends the headings its roll and pitch; its yaw means nothing."""
    turn: Float64Array
    """(4,) wxyz of the turn since the last sample of the window, in the frame it had there."""
    push: Float64Array
    """(3,) m/s that forces added since, in that frame."""
    span: float
    """Seconds since."""
    window: kernels.Window
    estimate: kernels.Estimate

    @property
    def heading_attitude(self) -> Float64Array:
        """(3, 3) the reference."""
        return self.reference

    @property
    def pose(self) -> SE3:
        """T_world_base."""
        return SE3(self.rotation, self.position)

    @property
    def angular_velocity(self) -> Float64Array:
        """(3,) rad/s, in `base`, bias and all."""
        return self.gyro.copy()


@dataclass(frozen=True, slots=True)
class Cipg(Estimator[CipgState]):
    """Cascaded iteratively preconditioned gradient observer, a reconstruction.

    What it does: the first stage fits the attitude at the start of a window of samples to the attitudes
    measured in it, the second then the velocity to what the DVL measured; between samples both go by the
    integrated IMU. Each makes a few iterations w ← w − δ K Jᵀ(H(w) − Y), K ← K − α((JᵀJ + βI)K − I), and
    both start where they were left.
    Reference: Joshi, Liu and Chopra 2025, arXiv 2504.15235, of which we know the abstract alone, so this is
    no measure of the paper; for the iteration, Chakrabarti and Chopra, arXiv 2405.09137. Left out: what
    aligns the sensors' times continuously. The attitude's measurement is the heading with roll and pitch of
    a complementary filter, since no sensor here measures all three.
    Assumes: a heading several times a second, and no biases.
    Fails when: the gyro has a bias; the vehicle accelerates for long, which tilts the complementary filter,
    and with it gravity; a measurement is far off, since a sliding mean without covariance believes all that
    comes in.
    """

    mounting: Mounting = field(default_factory=Mounting)
    samples: int = 10
    """Greatest number of samples in the window."""
    iterations: int = 2
    """After each measurement, in each stage."""
    step: float = 1.0
    """δ of the iteration, above 0 and at most 1."""
    relaxation: float = 0.5
    """α of the iteration times its number of rows, above 0 and below 2."""
    regularisation: float = 0.0
    """β of the iteration, in rows."""
    tilt_time: float = 5.0
    """Seconds in which an error of roll or pitch of the measured attitude falls to a third. Ours."""
    depth_share: float = 0.5
    """Share of the way that the height goes to what the pressure says. Ours."""
    gravity: float = 9.81
    """m/s²."""

    def __post_init__(self) -> None:
        if self.samples < 1 or self.iterations < 1:
            raise ValueError(
                f"samples, iterations: expected at least 1, got {self.samples} and {self.iterations}"
            )
        if not (0.0 < self.step <= 1.0 and 0.0 < self.relaxation < 2.0 and self.regularisation >= 0.0):
            raise ValueError(
                "step, relaxation, regularisation: expected (0, 1], (0, 2) and at least 0, "
                f"got {self.step}, {self.relaxation} and {self.regularisation}"
            )

    def begin(self, time: float, T_world_base: SE3, velocity: npt.ArrayLike = (0.0, 0.0, 0.0)) -> CipgState:
        """The state at the start: a pose and a velocity over ground (3,)."""
        rotation, speed = plain(T_world_base.rotation).copy(), plain(velocity).copy()
        return CipgState(
            time=time,
            rotation=rotation,
            velocity=speed,
            position=plain(T_world_base.translation).copy(),
            gyro=np.zeros(3),
            reference=rotation.copy(),
            turn=np.array([1.0, 0.0, 0.0, 0.0]),
            push=np.zeros(3),
            span=0.0,
            window=kernels.begun(self.samples),
            estimate=kernels.Estimate(quaternion_from(rotation), speed.copy(), 1.0, 1.0, 0, 0),
        )

    def bridge(self, state: CipgState, imu: Imu, dt: float) -> CipgState:
        """As `predict`: without a covariance, there is nothing to tell of what is missing."""
        return self.predict(state, imu, dt)

    @property
    def compiled(self) -> kernels.Parameters:
        """The fields as the kernels take them, for loops that are compiled themselves."""
        return _parameters(self)


@lru_cache(maxsize=64)
def _parameters(chosen: Cipg) -> kernels.Parameters:
    return kernels.Parameters(
        samples=chosen.samples,
        iterations=chosen.iterations,
        step=float(chosen.step),
        relaxation=float(chosen.relaxation),
        regularisation=float(chosen.regularisation),
        tilt_time=float(chosen.tilt_time),
        depth_share=float(chosen.depth_share),
        gravity=float(chosen.gravity),
        dvl_rotation=plain(chosen.mounting.T_base_dvl.rotation),
        dvl_position=plain(chosen.mounting.T_base_dvl.translation),
        pressure_position=plain(chosen.mounting.pressure_sensor),
    )
