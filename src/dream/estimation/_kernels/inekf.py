"""Steps of the right-invariant filter on SE_2(3); `dream.estimation.inekf` says what they mean.

The error is X = Exp(ξ) X̂, b = b̂ + δb, ordered (ξ_R, ξ_v, ξ_p, δb_g, δb_a).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.estimation._kernels import kalman
from dream.estimation._kernels.groups import (
    apply,
    cross,
    moved,
    mul,
    se23_adjoint,
    se23_exp,
    se23_log,
    skew,
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
    """Fields of `dream.estimation.InEkfState`, but for the outcome."""

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
    rotation: Float64Array


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
    velocity, position = moved(s.rotation, s.velocity, s.position, once, twice, a, q.gravity, dt)
    of_gyro, of_force = squared_densities(q, gyro, force)
    P = s.covariance.copy()
    _add_noise(P, s, of_gyro * dt, of_force * dt)
    add_walks(P, q, dt)
    P = _carry(_bias_columns(q.gravity, s, dt), q.gravity, dt, P)
    return State(
        s.time + dt,
        velocity,
        position,
        s.gyro_bias.copy(),
        s.accelerometer_bias.copy(),
        P,
        gyro.copy(),
        gyro_variance(q, gyro),
        s.begun,
        s.refused_since.copy(),
        mul(s.rotation, whole),
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
def dvl_innovation(q: Parameters, s: State, velocity: Float64Array, covariance: Float64Array) -> Innovation:
    """Of a velocity over ground (3,) in the frame of the DVL.

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
    return Innovation(apply(R, body) - s.velocity, H, N)


@njit(cache=True, nogil=True)
def depth_innovation(q: Parameters, s: State, z: float, sigma: float) -> Innovation:
    """Of the pressure sensor's height in the world."""
    at = s.position + apply(s.rotation, q.pressure_position)
    H = np.zeros((1, 15))
    H[0, 0], H[0, 1], H[0, 8] = at[1], -at[0], 1.0
    return Innovation(np.array([z - at[2]]), H, np.array([[sigma * sigma]]))


@njit(cache=True, nogil=True)
def heading_innovation(s: State, yaw: float, sigma: float) -> Innovation:
    """Of a yaw; NaN, which is never taken, where the pitch is too steep."""
    H = np.zeros((1, 15))
    H[0, :3] = yaw_slope(s.rotation)
    return Innovation(np.array([wrap(yaw - yaw_of(s.rotation))]), H, np.array([[sigma * sigma]]))


@njit(cache=True, nogil=True)
def rest_innovation(q: Parameters, s: State) -> Innovation:
    """Of a velocity of zero."""
    H = np.zeros((3, 15))
    H[0, 3] = H[1, 4] = H[2, 5] = 1.0
    return Innovation(-s.velocity, H, q.rest_sigma**2 * np.eye(3))


@njit(cache=True, nogil=True)
def correct(q: Parameters, s: State, innovation: Innovation, sensor: np.int64) -> tuple[State, int, float]:
    """The state after a measurement, with `code` and `nis` of its `kalman.Correction`."""
    c = kalman.correction(q, s, innovation, sensor)
    turn, velocity, position = se23_exp(c.step[:9])
    after = State(
        s.time,
        velocity + apply(turn, s.velocity),
        position + apply(turn, s.position),
        s.gyro_bias + c.step[9:12],
        s.accelerometer_bias + c.step[12:15],
        c.covariance,
        s.gyro,
        s.gyro_variance,
        c.begun,
        c.refused_since,
        mul(turn, s.rotation),
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
def correct_rest(q: Parameters, s: State) -> tuple[State, int, float]:
    """After the word that the vehicle rests; see `correct`."""
    return correct(q, s, rest_innovation(q, s), kalman.OTHER)


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
    return float(kalman.spread(s.covariance, heading_innovation(s, 0.0, 0.0).H)[0, 0])
