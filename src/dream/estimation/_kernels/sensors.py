"""What the Kalman filters know of the sensors: noise, gates, and where a heading means something."""

from __future__ import annotations

import math
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
def squared_densities(q: Parameters, gyro: Float64Array, force: Float64Array) -> tuple[float, float]:
    """Of the noise of a sample: of its rates and of its forces."""
    return (
        _squared_density(gyro, q.gyro_noise, q.gyro_range, q.clipped),
        _squared_density(force, q.accelerometer_noise, q.accelerometer_range, q.clipped),
    )


@njit(cache=True, nogil=True)
def _squared_density(sample: Float64Array, density: float, limit: float, clipped: float) -> float:
    """A sample that clips says only that the truth lies beyond.

    Then it errs by `clipped` of its range, and alike for as long as it clips: for CLIPS_FOR seconds.
    """
    if max(abs(sample[0]), abs(sample[1]), abs(sample[2])) < limit:
        return density**2
    return density**2 + (clipped * limit) ** 2 * CLIPS_FOR


@njit(cache=True, nogil=True)
def add_walks(P: Float64Array, q: Parameters, dt: float) -> None:
    """Add in place what the biases, the last six of an error (15,), wander within `dt`."""
    for i in range(9, 12):
        P[i, i] += q.gyro_walk**2 * dt
        P[i + 3, i + 3] += q.accelerometer_walk**2 * dt


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


@njit(cache=True, nogil=True)
def yaw_slope(R: Float64Array) -> Float64Array:
    """(3,) by how much the yaw of R grows with a turn in the world; NaN where the pitch is too steep for one.

    It is [tanθ cosψ, tanθ sinψ, 1] of the yaw ψ and the pitch θ, which is positive nose down.
    """
    level = R[0, 0] ** 2 + R[1, 0] ** 2
    if level < STEEP:
        level = math.nan
    return np.array([-R[2, 0] * R[0, 0] / level, -R[2, 0] * R[1, 0] / level, 1.0])
