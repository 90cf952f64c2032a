"""Steps of the error-state filter with a quaternion; `dream.estimation.ekf` says what they mean.

The error is q = q̂ ⊗ Exp(δθ), and the difference in all else, ordered (δθ, δv, δp, δb_g, δb_a).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.estimation._kernels import kalman
from dream.estimation._kernels.groups import (
    apply,
    apply_transposed,
    cross,
    mul,
    normalised,
    quaternion_conjugate,
    quaternion_exp,
    quaternion_from,
    quaternion_log,
    quaternion_product,
    rotation_from,
    skew,
    so3_exp,
    so3_integrals,
    wrap,
    yaw_of,
)
from dream.estimation._kernels.sensors import STEEP, Parameters, gate, gyro_variance, squared_density

Float64Array = npt.NDArray[np.float64]


class State(NamedTuple):
    """What the filter knows."""

    time: float
    wxyz: Float64Array
    velocity: Float64Array
    position: Float64Array
    gyro_bias: Float64Array
    accelerometer_bias: Float64Array
    covariance: Float64Array
    """(15, 15) of the error."""
    gyro: Float64Array
    """The last sample, its bias included."""
    gyro_variance: float
    """Of each axis of that sample."""
    begun: float
    """The time when it began, or began anew after it had been lost."""
    refused_since: Float64Array
    """(2,) when the DVL and the depth began to be refused; NaN where the last was taken."""


@njit(cache=True, nogil=True)
def predict(q: Parameters, s: State, gyro: Float64Array, force: Float64Array, dt: float) -> State:
    """Carry the state over one sample, exactly, and P⁺ = F P Fᵀ + Q to first order (Solà, section 5)."""
    rate, a = gyro - s.gyro_bias, force - s.accelerometer_bias
    R = rotation_from(s.wxyz)
    _, once, twice = so3_integrals(dt * rate)
    velocity = s.velocity + dt * apply(R, apply(once, a))
    position = s.position + dt * s.velocity + dt * dt * apply(R, apply(twice, a))
    velocity[2] -= q.gravity * dt
    position[2] -= 0.5 * q.gravity * dt * dt
    F = np.eye(15)
    F[:3, :3] = so3_exp(-dt * rate)
    F[3:6, :3] = -dt * mul(R, skew(a))
    F[3:6, 12:] = -dt * R
    for i in range(3):
        F[i, 9 + i] = -dt
        F[6 + i, 3 + i] = dt
    of_gyro = squared_density(gyro, q.gyro_noise, q.gyro_range, q.clipped)
    of_force = squared_density(force, q.accelerometer_noise, q.accelerometer_range, q.clipped)
    P = F @ s.covariance @ F.T
    for i in range(3):
        P[i, i] += of_gyro * dt
        P[3 + i, 3 + i] += of_force * dt
        P[9 + i, 9 + i] += q.gyro_walk**2 * dt
        P[12 + i, 12 + i] += q.accelerometer_walk**2 * dt
    return State(
        s.time + dt,
        normalised(quaternion_product(s.wxyz, quaternion_exp(dt * rate))),
        velocity,
        position,
        s.gyro_bias.copy(),
        s.accelerometer_bias.copy(),
        0.5 * (P + P.T),
        gyro.copy(),
        gyro_variance(q, gyro),
        s.begun,
        s.refused_since.copy(),
    )


@njit(cache=True, nogil=True)
def dvl_rows(
    q: Parameters, s: State, velocity: Float64Array, covariance: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Innovation, its rows and its noise of z = R_dᵀ (Rᵀ v + (ω_m − b_g) × t), in the frame of the DVL."""
    R, t = rotation_from(s.wxyz), q.dvl_position
    to_dvl = q.dvl_rotation.T.copy()
    own = apply_transposed(R, s.velocity)
    expected = apply(to_dvl, own + cross(s.gyro - s.gyro_bias, t))
    arm = mul(to_dvl, skew(t))
    H = np.zeros((3, 15))
    H[:, :3] = mul(to_dvl, skew(own))
    H[:, 3:6] = mul(to_dvl, R.T)
    H[:, 9:12] = arm
    N = kalman.floored(covariance, q.dvl_floor) + s.gyro_variance * mul(arm, arm.T)
    return velocity - expected, H, N


@njit(cache=True, nogil=True)
def depth_rows(
    q: Parameters, s: State, z: float, sigma: float
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Innovation, its row and its noise of z = e₃ᵀ (p + R t)."""
    R, t = rotation_from(s.wxyz), q.pressure_position
    H = np.zeros((1, 15))
    H[0, :3] = cross(t, R[2])
    H[0, 8] = 1.0
    return np.array([z - s.position[2] - apply(R, t)[2]]), H, np.array([[sigma * sigma]])


@njit(cache=True, nogil=True)
def heading_rows(s: State, yaw: float, sigma: float) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Innovation, its row and its noise of a yaw; NaN, which is never taken, where the pitch is too steep."""
    R = rotation_from(s.wxyz)
    level = R[0, 0] ** 2 + R[1, 0] ** 2
    if level < STEEP:
        level = math.nan
    about = np.array([-R[2, 0] * R[0, 0] / level, -R[2, 0] * R[1, 0] / level, 1.0])
    H = np.zeros((1, 15))
    H[0, :3] = apply_transposed(R, about)
    return np.array([wrap(yaw - yaw_of(R))]), H, np.array([[sigma * sigma]])


@njit(cache=True, nogil=True)
def correct(
    q: Parameters, s: State, V: Float64Array, H: Float64Array, N: Float64Array, sensor: np.int64
) -> tuple[State, int, float]:
    """The state after a measurement, what became of it (see `kalman`), and its normalised innovation squared.

    `sensor` is its place in `refused_since`, or negative for one that is refused as long as it disagrees.
    """
    limit = gate(q, len(V), s.time - s.begun)
    code, nis, step, P, since = kalman.correct_in_time(
        s.covariance, H, V, N, limit, s.time, s.refused_since, sensor, q.patience
    )
    after = State(
        s.time,
        normalised(quaternion_product(s.wxyz, quaternion_exp(step[:3]))),
        s.velocity + step[3:6],
        s.position + step[6:9],
        s.gyro_bias + step[9:12],
        s.accelerometer_bias + step[12:15],
        P,
        s.gyro,
        s.gyro_variance,
        s.time if code == kalman.INSISTED else s.begun,
        since,
    )
    return after, code, nis


@njit(cache=True, nogil=True)
def correct_dvl(
    q: Parameters, s: State, velocity: Float64Array, covariance: Float64Array
) -> tuple[State, int, float]:
    """After a velocity over ground; see `correct`."""
    V, H, N = dvl_rows(q, s, velocity, covariance)
    return correct(q, s, V, H, N, kalman.DVL)


@njit(cache=True, nogil=True)
def correct_depth(q: Parameters, s: State, z: float, sigma: float) -> tuple[State, int, float]:
    """After a depth; see `correct`."""
    V, H, N = depth_rows(q, s, z, sigma)
    return correct(q, s, V, H, N, kalman.DEPTH)


@njit(cache=True, nogil=True)
def correct_heading(q: Parameters, s: State, yaw: float, sigma: float) -> tuple[State, int, float]:
    """After a heading; see `correct`."""
    V, H, N = heading_rows(s, yaw, sigma)
    return correct(q, s, V, H, N, kalman.OTHER)


@njit(cache=True, nogil=True)
def error(
    s: State,
    rotation: Float64Array,
    velocity: Float64Array,
    position: Float64Array,
    gyro_bias: Float64Array,
    accelerometer_bias: Float64Array,
) -> Float64Array:
    """(15,) the error of a truth."""
    out = np.empty(15)
    turn = quaternion_product(quaternion_conjugate(s.wxyz), quaternion_from(rotation))
    out[:3] = quaternion_log(turn)
    out[3:6], out[6:9] = velocity - s.velocity, position - s.position
    out[9:12], out[12:15] = gyro_bias - s.gyro_bias, accelerometer_bias - s.accelerometer_bias
    return out


@njit(cache=True, nogil=True)
def yaw_variance(s: State) -> float:
    """Of the heading; NaN where the pitch is too steep for one."""
    _, H, _ = heading_rows(s, 0.0, 0.0)
    return float(kalman.spread(s.covariance, H)[0, 0])
