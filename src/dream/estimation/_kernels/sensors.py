"""What the filters with a covariance know of the sensors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

Float64Array = npt.NDArray[np.float64]

STEEP = 0.01
"""Squared cosine of the pitch below which a heading means nothing: 84 degrees."""
CLIPS_FOR = 1.0
"""Seconds that an axis which clips errs alike."""
WIDE = 10.0
"""How many times as wide the gates are while a filter settles."""


class Parameters(NamedTuple):
    """`InertialErrors`, `Mounting` and `Trust` of `dream.estimation.instruments`, ready for the loops."""

    gyro_noise: float
    accelerometer_noise: float
    gyro_walk: float
    accelerometer_walk: float
    gyro_range: float
    accelerometer_range: float
    clipped: float
    rate: float
    gravity: float
    dvl_rotation: Float64Array
    """(3, 3) of T_base_dvl."""
    dvl_position: Float64Array
    pressure_position: Float64Array
    dvl_floor: float
    rest_sigma: float
    gate_of_one: float
    """Greatest normalised innovation squared of one row."""
    gate_of_three: float
    patience: float
    settling: float


@njit(cache=True, nogil=True)
def squared_density(sample: Float64Array, density: float, limit: float, clipped: float) -> float:
    """Of the noise of a sample. One that clips says only that the truth lies beyond.

    Then it errs by `clipped` of its range, and alike for as long as it clips: for CLIPS_FOR seconds.
    """
    if max(abs(sample[0]), abs(sample[1]), abs(sample[2])) < limit:
        return density**2
    return density**2 + (clipped * limit) ** 2 * CLIPS_FOR


@njit(cache=True, nogil=True)
def gyro_variance(q: Parameters, gyro: Float64Array) -> float:
    """(rad/s)² of each axis of a whole sample, however short the part of it that a filter is carried over."""
    variance = q.gyro_noise**2 * q.rate
    if max(abs(gyro[0]), abs(gyro[1]), abs(gyro[2])) < q.gyro_range:
        return variance
    return variance + (q.clipped * q.gyro_range) ** 2


@njit(cache=True, nogil=True)
def gate(q: Parameters, rows: int, age: float) -> float:
    """Greatest normalised innovation squared that is believed by a filter so many seconds after its start."""
    limit = q.gate_of_one if rows == 1 else q.gate_of_three
    return WIDE * limit if age < q.settling else limit
