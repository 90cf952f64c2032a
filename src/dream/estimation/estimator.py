"""What all estimators do alike: take in samples and measurements, and have their kernels move the state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from dream.estimation.intake import (
    VERDICTS,
    Outcome,
    Verdict,
    check_sample,
    plain,
    refusal,
    source_of,
    too_steep,
)
from dream.geometry import SE3
from dream.measurements import Depth, Dvl, Imu, Measurement

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class State(ABC):
    """What an estimator knows at one time. Vectors are in the world unless named otherwise."""

    kernels: ClassVar[Any]
    """The estimator compiled: `State`, with these fields but for the outcome; `predict`, `correct_dvl`,
    `correct_depth` and `correct_heading`."""

    time: float
    outcome: Outcome | None = field(default=None, kw_only=True)
    """What became of the last measurement; None where there was none."""

    @property
    @abstractmethod
    def pose(self) -> SE3:
        """T_world_base."""

    @property
    @abstractmethod
    def angular_velocity(self) -> Float64Array:
        """(3,) rad/s, in `base`."""

    @property
    @abstractmethod
    def heading_attitude(self) -> Float64Array:
        """(3, 3) base to world, by whose roll and pitch a heading is read."""

    @property
    def packed(self) -> Any:
        """The state as the kernels take it."""
        return self.kernels.State(*(getattr(self, name) for name in self.kernels.State._fields))


S = TypeVar("S", bound=State)


@dataclass(frozen=True, slots=True)
class Estimator(ABC, Generic[S]):
    """Parameters of an estimator, and its steps; none of them changes what it is given."""

    @abstractmethod
    def begin(self, time: float, T_world_base: SE3, velocity: npt.ArrayLike = (0.0, 0.0, 0.0)) -> S:
        """The state at the start: a pose and a velocity over ground (3,), in the world."""

    @property
    @abstractmethod
    def compiled(self) -> Any:
        """The fields as the kernels take them, for loops that are compiled themselves."""

    def predict(self, state: S, imu: Imu, dt: float) -> S:
        """The state `dt` seconds later, after an inertial sample that stands for all of them.

        Raises:
            ValueError: The sample is not finite, or `dt` not above 0.
        """
        return self._carried(self.compiled, state, imu, dt)

    @abstractmethod
    def bridge(self, state: S, imu: Imu, dt: float) -> S:
        """As `predict`, where samples are missing and one stands in for them."""

    def correct(self, state: S, measurement: Measurement) -> S:
        """The state after a measurement of its own time; where that is refused, the outcome says why."""
        source, refused = source_of(measurement), refusal(measurement)
        if refused is None and too_steep(measurement, state.heading_attitude):
            refused = Verdict.TOO_STEEP
        if refused is not None:
            return replace(state, outcome=Outcome(source, refused))
        kernels, packed = state.kernels, state.packed
        if isinstance(measurement, Dvl):
            velocity, covariance = plain(measurement.velocity), plain(measurement.covariance)
            after, code, nis = kernels.correct_dvl(self.compiled, packed, velocity, covariance)
        elif isinstance(measurement, Depth):
            z, sigma = float(measurement.z), float(measurement.sigma)
            after, code, nis = kernels.correct_depth(self.compiled, packed, z, sigma)
        else:
            yaw, sigma = float(measurement.yaw), float(measurement.sigma)
            after, code, nis = kernels.correct_heading(self.compiled, packed, yaw, sigma)
        return type(state)(*after, outcome=Outcome(source, VERDICTS[code], nis))

    def _carried(self, parameters: Any, state: S, imu: Imu, dt: float) -> S:
        """The state `dt` seconds later, by these parameters of the kernels."""
        check_sample(imu, dt)
        rates, forces = plain(imu.angular_velocity), plain(imu.specific_force)
        moved = state.kernels.predict(parameters, state.packed, rates, forces, dt)
        return type(state)(*moved, outcome=state.outcome)
