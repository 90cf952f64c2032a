"""Steps of dead reckoning; `dream.estimation.dead_reckoning` says what they mean."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.estimation._kernels.groups import apply, cross, mul, so3_integrals, wrap, yaw_of
from dream.estimation._kernels.sensors import STEEP

Float64Array = npt.NDArray[np.float64]


class Parameters(NamedTuple):
    """Fields of `dream.estimation.DeadReckoning`, ready for the loops."""

    tilt_time: float
    heading_time: float
    dvl_rotation: Float64Array
    dvl_position: Float64Array
    pressure_position: Float64Array


class State(NamedTuple):
    """Where it is by the last readings."""

    time: float
    rotation: Float64Array
    own_velocity: Float64Array
    """(3,) in `base`, as the DVL last saw it."""
    position: Float64Array
    gyro: Float64Array
    heading_time: float
    """Of the last heading; NaN before the first."""


@njit(cache=True, nogil=True)
def levelled(rotation: Float64Array, force: Float64Array, tilt_time: float) -> Float64Array:
    """(3,) rad/s, in `base`, that turn up towards where the force points, within some `tilt_time`.

    Mahony, Hamel and Pflimlin, IEEE TAC 2008: the proportional part of the explicit complementary filter.
    """
    strength = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    if strength == 0.0:
        return np.zeros(3)
    return cross(force, rotation[2]) / (strength * tilt_time)


@njit(cache=True, nogil=True)
def turned(rotation: Float64Array, angle: float) -> Float64Array:
    """The attitude turned to the left about the vertical."""
    c, s = math.cos(angle), math.sin(angle)
    out = rotation.copy()
    out[0] = c * rotation[0] - s * rotation[1]
    out[1] = s * rotation[0] + c * rotation[1]
    return out


@njit(cache=True, nogil=True)
def predict(q: Parameters, s: State, gyro: Float64Array, force: Float64Array, dt: float) -> State:
    """Turn by the gyro, levelled by the accelerometer; move as the DVL last said."""
    whole, once, _ = so3_integrals(dt * (gyro + levelled(s.rotation, force, q.tilt_time)))
    return State(
        s.time + dt,
        mul(s.rotation, whole),
        s.own_velocity.copy(),
        s.position + dt * apply(s.rotation, apply(once, s.own_velocity)),
        gyro.copy(),
        s.heading_time,
    )


@njit(cache=True, nogil=True)
def correct_dvl(
    q: Parameters, s: State, velocity: Float64Array, covariance: Float64Array
) -> tuple[State, int, float]:
    """The velocity is what the DVL says; the covariance is not looked at."""
    own = apply(q.dvl_rotation, velocity) + cross(q.dvl_position, s.gyro)
    return State(s.time, s.rotation, own, s.position, s.gyro, s.heading_time), 1, math.nan


@njit(cache=True, nogil=True)
def correct_depth(q: Parameters, s: State, z: float, sigma: float) -> tuple[State, int, float]:
    """The height is what the pressure says."""
    position = s.position.copy()
    position[2] = z - apply(s.rotation, q.pressure_position)[2]
    return State(s.time, s.rotation, s.own_velocity, position, s.gyro, s.heading_time), 1, math.nan


@njit(cache=True, nogil=True)
def correct_heading(q: Parameters, s: State, yaw: float, sigma: float) -> tuple[State, int, float]:
    """Turn towards the heading, the further the longer ago the last one was."""
    if s.rotation[0, 0] ** 2 + s.rotation[1, 0] ** 2 < STEEP:
        return s, 3, math.nan
    share = 1.0
    if not math.isnan(s.heading_time):
        share = 1.0 - math.exp(-max(s.time - s.heading_time, 0.0) / q.heading_time)
    rotation = turned(s.rotation, share * wrap(yaw - yaw_of(s.rotation)))
    return State(s.time, rotation, s.own_velocity, s.position, s.gyro, s.time), 1, math.nan
