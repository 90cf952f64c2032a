"""Steps of the right-invariant filter on SE_2(3); `dream.estimation.inekf` says what they mean.

The error is X = Exp(ξ) X̂, b = b̂ + δb, ordered (ξ_R, ξ_v, ξ_p, δb_g, δb_a).
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
    cross,
    mul,
    se23_adjoint,
    se23_exp,
    se23_log,
    skew,
    so3_integrals,
    wrap,
    yaw_of,
)
from dream.estimation._kernels.sensors import STEEP, Parameters, gate, gyro_variance, squared_density

Float64Array = npt.NDArray[np.float64]


class State(NamedTuple):
    """What the filter knows."""

    time: float
    rotation: Float64Array
    velocity: Float64Array
    position: Float64Array
    gyro_bias: Float64Array
    accelerometer_bias: Float64Array
    covariance: Float64Array
    """(15, 15) of the error."""
    gyro: Float64Array
    """The last sample, its bias included: the lever arm of the DVL needs it."""
    gyro_variance: float
    """Of each axis of that sample."""
    begun: float
    """The time when it began, or began anew after it had been lost."""
    refused_since: Float64Array
    """(2,) when the DVL and the depth began to be refused; NaN where the last was taken."""


@njit(cache=True, nogil=True)
def initial_covariance(
    rotation: Float64Array, velocity: Float64Array, position: Float64Array, sigmas: Float64Array
) -> Float64Array:
    """Covariance (15, 15) of independent errors in the body frame with these sigmas (15,)."""
    adjoint = se23_adjoint(rotation, velocity, position)
    out = np.diag(sigmas * sigmas)
    out[:9, :9] = mul(adjoint, mul(out[:9, :9], adjoint.T))
    return out


@njit(cache=True, nogil=True)
def predict(q: Parameters, s: State, gyro: Float64Array, force: Float64Array, dt: float) -> State:
    """Carry the state over one sample, exactly for turn rate and force that are constant during it.

    Covariance: P⁺ = Φ (P + Q̄ dt) Φᵀ with Φ = I + A dt + A² dt²/2 + A³ dt³/6, where it ends, since A⁴ = 0.
    """
    rate, a = gyro - s.gyro_bias, force - s.accelerometer_bias
    whole, once, twice = so3_integrals(rate * dt)
    rotation = mul(s.rotation, whole)
    velocity = s.velocity + dt * apply(s.rotation, apply(once, a))
    position = s.position + dt * s.velocity + dt * dt * apply(s.rotation, apply(twice, a))
    velocity[2] -= q.gravity * dt
    position[2] -= 0.5 * q.gravity * dt * dt

    of_gyro = squared_density(gyro, q.gyro_noise, q.gyro_range, q.clipped)
    of_force = squared_density(force, q.accelerometer_noise, q.accelerometer_range, q.clipped)
    P = s.covariance.copy()
    _add_noise(P, s, of_gyro * dt, of_force * dt)
    for i in range(9, 12):
        P[i, i] += q.gyro_walk**2 * dt
        P[i + 3, i + 3] += q.accelerometer_walk**2 * dt
    P = _carry(_bias_columns(q.gravity, s, dt), q.gravity, dt, P)
    return State(
        s.time + dt,
        rotation,
        velocity,
        position,
        s.gyro_bias.copy(),
        s.accelerometer_bias.copy(),
        P,
        gyro.copy(),
        gyro_variance(q, gyro),
        s.begun,
        s.refused_since.copy(),
    )


@njit(cache=True, nogil=True)
def _add_noise(P: Float64Array, s: State, turn: float, push: float) -> None:
    """Add Ad diag(turn, push, 0) Adᵀ in place. The noise is the same along all axes, so R drops out."""
    T = np.zeros((9, 3))
    T[0, 0] = T[1, 1] = T[2, 2] = 1.0
    T[3:6] = skew(s.velocity)
    T[6:9] = skew(s.position)
    for i in range(9):
        for j in range(9):
            P[i, j] += turn * (T[i, 0] * T[j, 0] + T[i, 1] * T[j, 1] + T[i, 2] * T[j, 2])
    for i in range(3, 6):
        P[i, i] += push


@njit(cache=True, nogil=True)
def _bias_columns(gravity: float, s: State, dt: float) -> Float64Array:
    """(9, 6) of Φ: what a bias does to rotation, velocity and position within dt."""
    R = s.rotation
    C = np.zeros((9, 6))
    vR, pR = mul(skew(s.velocity), R), mul(skew(s.position), R)
    for j in range(3):
        # g^× x for gravity along −z.
        gR = (gravity * R[1, j], -gravity * R[0, j], 0.0)
        for i in range(3):
            C[i, j] = -dt * R[i, j]
            C[3 + i, j] = -dt * vR[i, j] - dt**2 / 2.0 * gR[i]
            C[6 + i, j] = -dt * pR[i, j] - dt**2 / 2.0 * vR[i, j] - dt**3 / 6.0 * gR[i]
            C[3 + i, 3 + j] = -dt * R[i, j]
            C[6 + i, 3 + j] = -(dt**2) / 2.0 * R[i, j]
    return C


@njit(cache=True, nogil=True)
def _carry(C: Float64Array, gravity: float, dt: float, P: Float64Array) -> Float64Array:
    """Φ P Φᵀ, by the blocks of Φ that are not zero."""
    half = _rows(C, gravity, dt, P)
    out = _rows(C, gravity, dt, half.T.copy())
    for i in range(15):
        for j in range(i):
            out[i, j] = out[j, i] = 0.5 * (out[i, j] + out[j, i])
    return out


@njit(cache=True, nogil=True)
def _rows(C: Float64Array, gravity: float, dt: float, M: Float64Array) -> Float64Array:
    """Φ M."""
    out = M.copy()
    for i in range(9):
        for k in range(6):
            for j in range(15):
                out[i, j] += C[i, k] * M[9 + k, j]
    for j in range(15):
        gx, gy = gravity * M[1, j], -gravity * M[0, j]
        out[3, j] += dt * gx
        out[4, j] += dt * gy
        out[6, j] += dt * M[3, j] + 0.5 * dt * dt * gx
        out[7, j] += dt * M[4, j] + 0.5 * dt * dt * gy
        out[8, j] += dt * M[5, j]
    return out


@njit(cache=True, nogil=True)
def dvl_rows(
    q: Parameters, s: State, velocity: Float64Array, covariance: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Innovation, its rows and its noise of a velocity over ground (3,) in the frame of the DVL.

    The IMU moves with R_d z + t × (ω_m − b_g), t being where the DVL is.
    """
    t, R = q.dvl_position, s.rotation
    body = apply(q.dvl_rotation, velocity) + cross(t, s.gyro - s.gyro_bias)
    arm = mul(R, skew(t))
    H = np.zeros((3, 15))
    H[0, 3] = H[1, 4] = H[2, 5] = 1.0
    H[:, 9:12] = arm
    to_world = mul(R, q.dvl_rotation)
    N = mul(to_world, mul(kalman.floored(covariance, q.dvl_floor), to_world.T))
    N += s.gyro_variance * mul(arm, arm.T)
    return apply(R, body) - s.velocity, H, N


@njit(cache=True, nogil=True)
def depth_rows(
    q: Parameters, s: State, z: float, sigma: float
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Innovation, its row and its noise of the pressure sensor's height in the world."""
    at = s.position + apply(s.rotation, q.pressure_position)
    H = np.zeros((1, 15))
    H[0, 0], H[0, 1], H[0, 8] = at[1], -at[0], 1.0
    return np.array([z - at[2]]), H, np.array([[sigma * sigma]])


@njit(cache=True, nogil=True)
def heading_rows(s: State, yaw: float, sigma: float) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Innovation, its row and its noise of a yaw; NaN, which is never taken, where the pitch is too steep."""
    R = s.rotation
    level = R[0, 0] ** 2 + R[1, 0] ** 2
    if level < STEEP:
        level = math.nan
    H = np.zeros((1, 15))
    # tanθ (cosψ, sinψ) of the pitch θ, which is positive nose down.
    H[0, 0], H[0, 1], H[0, 2] = -R[2, 0] * R[0, 0] / level, -R[2, 0] * R[1, 0] / level, 1.0
    return np.array([wrap(yaw - yaw_of(R))]), H, np.array([[sigma * sigma]])


@njit(cache=True, nogil=True)
def rest_rows(q: Parameters, s: State) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Innovation, its rows and its noise of a velocity of zero."""
    H = np.zeros((3, 15))
    H[0, 3] = H[1, 4] = H[2, 5] = 1.0
    return -s.velocity, H, q.rest_sigma**2 * np.eye(3)


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
    turn, velocity, position = se23_exp(step[:9])
    velocity += apply(turn, s.velocity)
    position += apply(turn, s.position)
    after = State(
        s.time,
        mul(turn, s.rotation),
        velocity,
        position,
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
    """After a heading; see `correct`. Iron can turn a compass for long, so it never insists."""
    V, H, N = heading_rows(s, yaw, sigma)
    return correct(q, s, V, H, N, kalman.OTHER)


@njit(cache=True, nogil=True)
def correct_rest(q: Parameters, s: State) -> tuple[State, int, float]:
    """After the word that the vehicle rests; see `correct`."""
    V, H, N = rest_rows(q, s)
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
    """(15,) Log(X X̂⁻¹) and b − b̂ of a truth."""
    turn = mul(rotation, s.rotation.T)
    out = np.empty(15)
    out[:9] = se23_log(turn, velocity - apply(turn, s.velocity), position - apply(turn, s.position))
    out[9:12] = gyro_bias - s.gyro_bias
    out[12:15] = accelerometer_bias - s.accelerometer_bias
    return out


@njit(cache=True, nogil=True)
def position_covariance(s: State) -> Float64Array:
    """(3, 3) J P Jᵀ with J = [−p^×, 0, I, 0, 0]."""
    J = np.zeros((3, 15))
    J[:, :3] = -skew(s.position)
    J[0, 6] = J[1, 7] = J[2, 8] = 1.0
    return kalman.spread(s.covariance, J)


@njit(cache=True, nogil=True)
def velocity_covariance(s: State) -> Float64Array:
    """(3, 3) J P Jᵀ with J = [−v^×, I, 0, 0, 0]."""
    J = np.zeros((3, 15))
    J[:, :3] = -skew(s.velocity)
    J[0, 3] = J[1, 4] = J[2, 5] = 1.0
    return kalman.spread(s.covariance, J)


@njit(cache=True, nogil=True)
def yaw_variance(s: State) -> float:
    """Of the heading; NaN where the pitch is too steep for one."""
    _, H, _ = heading_rows(s, 0.0, 0.0)
    return float(kalman.spread(s.covariance, H)[0, 0])
