"""What may enter a filter, and what became of it."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.estimation._kernels.sensors import STEEP
from dream.measurements import Depth, Dvl, Heading, Imu, Measurement

Float64Array = npt.NDArray[np.float64]

NEAREST_FLOOR = 0.05
"""Metres of altitude below which a DVL of the size of Water Linked's A50 is no use."""
NOISIEST = 0.4
"""m/s, one sigma: where bluerobotics/BlueOS-Water-Linked-DVL has no confidence left."""


class Source(enum.StrEnum):
    """Where a word about the motion comes from."""

    IMU = "imu"
    DVL = "dvl"
    DEPTH = "depth"
    HEADING = "heading"
    REST = "rest"
    """The vehicle's own word that it was told to stop and stands still."""


class Verdict(enum.StrEnum):
    """What became of a message. All but those that are `taken` are refusals and move nothing."""

    TAKEN = "taken"
    WAITING = "it is ahead of the inertial samples"
    BRIDGED = "taken, and stretched over the samples that are missing before it"
    INSISTED = "taken, as it has been refused for long: the state was less certain than it said"
    UNLIKELY = "too far from what was expected"
    NO_LOCK = "the DVL has no bottom lock"
    TOO_CLOSE = "the DVL is too close to the ground"
    TOO_NOISY = "its noise is as large as a motion"
    UNSOUND = "the filter's own covariance is not positive"
    NOT_FINITE = "not a finite number"
    TOO_STEEP = "no heading at this pitch"
    MOVING = "not at rest"
    LATE = "older than what is remembered"
    AHEAD = "its time has not come: are the clocks the same?"
    AGAIN = "another of its kind was taken for the same time"
    BACKWARDS = "inertial samples go forward"

    @property
    def taken(self) -> bool:
        """Has it changed the state, or may it yet?"""
        return self in (Verdict.TAKEN, Verdict.INSISTED, Verdict.WAITING, Verdict.BRIDGED)


VERDICTS = (Verdict.UNLIKELY, Verdict.TAKEN, Verdict.INSISTED, Verdict.UNSOUND)
"""By the codes of `_kernels.kalman`."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of the last measurement of a state."""

    source: Source
    verdict: Verdict
    nis: float = math.nan
    """Normalised innovation squared Vᵀ S⁻¹ V, χ² in a consistent filter; NaN where there is none."""


def source_of(message: Imu | Measurement) -> Source:
    """Which sensor sent it."""
    return Source[type(message).__name__.upper()]


def refusal(measurement: Measurement) -> Verdict | None:
    """Why no filter can take a measurement, whatever its state; None where one can."""
    if not math.isfinite(measurement.time):
        return Verdict.NOT_FINITE
    if isinstance(measurement, Dvl):
        if not measurement.valid:
            return Verdict.NO_LOCK
        if not (_finite(measurement.velocity, (3,)) and _finite(measurement.covariance, (3, 3))):
            return Verdict.NOT_FINITE
        if measurement.altitude < NEAREST_FLOOR:
            return Verdict.TOO_CLOSE
        variances = np.diagonal(measurement.covariance)
        if variances.max() > NOISIEST**2 or variances.min() < 0.0:
            return Verdict.TOO_NOISY
        return None
    value = measurement.z if isinstance(measurement, Depth) else measurement.yaw
    if not (math.isfinite(value) and math.isfinite(measurement.sigma) and measurement.sigma > 0.0):
        return Verdict.NOT_FINITE
    return None


def too_steep(measurement: Measurement, rotation: Float64Array) -> bool:
    """Is it a heading, and the vehicle upright on its nose or tail?"""
    level = rotation[0, 0] ** 2 + rotation[1, 0] ** 2
    return isinstance(measurement, Heading) and bool(level < STEEP)


def finite(imu: Imu) -> bool:
    """Is everything in an inertial sample a finite number?"""
    return (
        math.isfinite(imu.time) and _finite(imu.angular_velocity, (3,)) and _finite(imu.specific_force, (3,))
    )


def check_sample(imu: Imu, dt: float) -> None:
    """Raise a ValueError unless a filter can be carried over the sample.

    A filter that is carried nowhere, backwards or by NaN is of no use to anyone, so this is the caller's
    mistake; `Timeline` keeps such samples of a real device away.
    """
    if not 0.0 < dt < math.inf:
        raise ValueError(f"dt: expected seconds above 0, got {dt}. Did the clock stand still or go back?")
    if not finite(imu):
        raise ValueError(
            f"imu: expected finite turn rates (3,) and forces (3,), got {imu}. `Timeline` leaves such out"
        )


def plain(array: npt.ArrayLike) -> Float64Array:
    """The array as the kernels are compiled for: float64, row by row."""
    return np.ascontiguousarray(array, dtype=np.float64)


def _finite(array: Float64Array, shape: tuple[int, ...]) -> bool:
    return np.shape(array) == shape and bool(np.isfinite(array).all())
