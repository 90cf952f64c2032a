"""Steps of the error-state filter with a quaternion; `dream.estimation.ekf` says what they mean.

The error is q = q̂ ⊗ Exp(δθ), and the difference in all else, ordered (δθ, δv, δp, δb_g, δb_a).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.estimation._kernels import kalman
from dream.estimation._kernels.groups import (
    apply,
    apply_transposed,
    cross,
    moved,
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
from dream.estimation._kernels.kalman import Innovation
from dream.estimation._kernels.sensors import (
    Parameters,
    add_walks,
    gyro_variance,
    squared_densities,
    yaw_slope,
)

Float64Array = npt.NDArray[np.float64]


class State(NamedTuple):
    """Fields of `dream.estimation.EkfState`, but for the outcome."""

    time: float
    velocity: Float64Array
    position: Float64Array
    gyro_bias: Float64Array
    accelerometer_bias: Float64Array
    covariance: Float64Array
    gyro: Float64Array
    gyro_variance: float
    begun: float
    refused_since: Float64Array
    wxyz: Float64Array


@njit(cache=True, nogil=True)
def predict(q: Parameters, s: State, gyro: Float64Array, force: Float64Array, dt: float) -> State:
    """Carry the state over one sample, exactly, and P⁺ = F P Fᵀ + Q to first order (Solà, section 5)."""
    rate, a = gyro - s.gyro_bias, force - s.accelerometer_bias
    R = rotation_from(s.wxyz)
    _, once, twice = so3_integrals(dt * rate)
    velocity, position = moved(R, s.velocity, s.position, once, twice, a, q.gravity, dt)
    F = np.eye(15)
    F[:3, :3] = so3_exp(-dt * rate)
    F[3:6, :3] = -dt * mul(R, skew(a))
    F[3:6, 12:] = -dt * R
    for i in range(3):
        F[i, 9 + i] = -dt
        F[6 + i, 3 + i] = dt
    of_gyro, of_force = squared_densities(q, gyro, force)
    P = F @ s.covariance @ F.T
    for i in range(3):
        P[i, i] += of_gyro * dt
        P[3 + i, 3 + i] += of_force * dt
    add_walks(P, q, dt)
    return State(
        s.time + dt,
        velocity,
        position,
        s.gyro_bias.copy(),
        s.accelerometer_bias.copy(),
        0.5 * (P + P.T),
        gyro.copy(),
        gyro_variance(q, gyro),
        s.begun,
        s.refused_since.copy(),
        normalised(quaternion_product(s.wxyz, quaternion_exp(dt * rate))),
    )


@njit(cache=True, nogil=True)
def dvl_innovation(q: Parameters, s: State, velocity: Float64Array, covariance: Float64Array) -> Innovation:
    """Of a velocity over ground z = R_dᵀ (Rᵀ v + (ω_m − b_g) × t), in the frame of the DVL."""
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
    return Innovation(velocity - expected, H, N)


@njit(cache=True, nogil=True)
def depth_innovation(q: Parameters, s: State, z: float, sigma: float) -> Innovation:
    """Of the pressure sensor's height z = e₃ᵀ (p + R t) in the world."""
    R, t = rotation_from(s.wxyz), q.pressure_position
    H = np.zeros((1, 15))
    H[0, :3] = cross(t, R[2])
    H[0, 8] = 1.0
    return Innovation(np.array([z - s.position[2] - apply(R, t)[2]]), H, np.array([[sigma * sigma]]))


@njit(cache=True, nogil=True)
def heading_innovation(s: State, yaw: float, sigma: float) -> Innovation:
    """Of a yaw; NaN, which is never taken, where the pitch is too steep."""
    R = rotation_from(s.wxyz)
    H = np.zeros((1, 15))
    H[0, :3] = apply_transposed(R, yaw_slope(R))
    return Innovation(np.array([wrap(yaw - yaw_of(R))]), H, np.array([[sigma * sigma]]))


@njit(cache=True, nogil=True)
def correct(q: Parameters, s: State, innovation: Innovation, sensor: np.int64) -> tuple[State, int, float]:
    """The state after a measurement, with `code` and `nis` of its `kalman.Correction`."""
    c = kalman.correction(q, s, innovation, sensor)
    after = State(
        s.time,
        s.velocity + c.step[3:6],
        s.position + c.step[6:9],
        s.gyro_bias + c.step[9:12],
        s.accelerometer_bias + c.step[12:15],
        c.covariance,
        s.gyro,
        s.gyro_variance,
        c.begun,
        c.refused_since,
        normalised(quaternion_product(s.wxyz, quaternion_exp(c.step[:3]))),
    )
    return after, c.code, c.nis


@njit(cache=True, nogil=True)
def correct_dvl(
    q: Parameters, s: State, velocity: Float64Array, covariance: Float64Array
) -> tuple[State, int, float]:
    """After a velocity over ground; see `correct`."""
    return correct(q, s, dvl_innovation(q, s, velocity, covariance), kalman.DVL)


@njit(cache=True, nogil=True)
def correct_depth(q: Parameters, s: State, z: float, sigma: float) -> tuple[State, int, float]:
    """After a depth; see `correct`."""
    return correct(q, s, depth_innovation(q, s, z, sigma), kalman.DEPTH)


@njit(cache=True, nogil=True)
def correct_heading(q: Parameters, s: State, yaw: float, sigma: float) -> tuple[State, int, float]:
    """After a heading; see `correct`. Iron can turn a compass for long, so it never insists."""
    return correct(q, s, heading_innovation(s, yaw, sigma), kalman.OTHER)


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
    return float(kalman.spread(s.covariance, heading_innovation(s, 0.0, 0.0).H)[0, 0])
