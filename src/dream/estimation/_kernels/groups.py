"""Rotations SO(3), extended poses SE_2(3) and unit quaternions, with small matrices written out.

A twist is ordered (ξ_R, ξ_v, ξ_p). Quaternions are Hamilton's, wxyz. Signs and formulas: Barrau and Bonnabel,
IEEE TAC 2017 (arXiv 1410.1465); Solà, arXiv 1711.02508.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

Float64Array = npt.NDArray[np.float64]

SMALL = 1e-3
"""Squared angle below which the series are as exact as float64: their next term is under 1e-17."""


@njit(cache=True, nogil=True)
def mul(a: Float64Array, b: Float64Array) -> Float64Array:
    """a b. For 3 × 3, a call to BLAS takes ten times as long as the product."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for j in range(b.shape[1]):
                out[i, j] += a[i, k] * b[k, j]
    return out


@njit(cache=True, nogil=True)
def apply(a: Float64Array, x: Float64Array) -> Float64Array:
    """a x."""
    out = np.zeros(a.shape[0])
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            out[i] += a[i, k] * x[k]
    return out


@njit(cache=True, nogil=True)
def apply_transposed(a: Float64Array, x: Float64Array) -> Float64Array:
    """aᵀ x."""
    out = np.zeros(a.shape[1])
    for k in range(a.shape[0]):
        for i in range(a.shape[1]):
            out[i] += a[k, i] * x[k]
    return out


@njit(cache=True, nogil=True)
def cross(a: Float64Array, b: Float64Array) -> Float64Array:
    """a × b."""
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


@njit(cache=True, nogil=True)
def skew(a: Float64Array) -> Float64Array:
    """(3, 3) a^×, so that a^× b = a × b."""
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -a[2], a[1], -a[0]
    out[1, 0], out[2, 0], out[2, 1] = a[2], -a[1], a[0]
    return out


@njit(cache=True, nogil=True)
def _polynomial(identity: float, first: float, second: float, turn: Float64Array) -> Float64Array:
    """identity · I + first · θ^× + second · (θ^×)²."""
    x, y, z = turn[0], turn[1], turn[2]
    out = np.empty((3, 3))
    out[0, 0] = identity - second * (y * y + z * z)
    out[1, 1] = identity - second * (x * x + z * z)
    out[2, 2] = identity - second * (x * x + y * y)
    out[0, 1], out[1, 0] = second * x * y - first * z, second * x * y + first * z
    out[0, 2], out[2, 0] = second * x * z + first * y, second * x * z - first * y
    out[1, 2], out[2, 1] = second * y * z - first * x, second * y * z + first * x
    return out


@njit(cache=True, nogil=True)
def _coefficients(t: float) -> tuple[float, float, float, float]:
    """sinθ/θ, (1 − cosθ)/θ², (θ − sinθ)/θ³ and (θ² + 2cosθ − 2)/(2θ⁴), given t = θ²."""
    if t < SMALL:
        return (
            1.0 - t / 6.0 * (1.0 - t / 20.0 * (1.0 - t / 42.0)),
            0.5 - t / 24.0 * (1.0 - t / 30.0 * (1.0 - t / 56.0)),
            1.0 / 6.0 - t / 120.0 * (1.0 - t / 42.0 * (1.0 - t / 72.0)),
            1.0 / 24.0 - t / 720.0 * (1.0 - t / 56.0 * (1.0 - t / 90.0)),
        )
    angle = math.sqrt(t)
    sine, chord = math.sin(angle), 2.0 * math.sin(0.5 * angle)
    # 2 − 2cosθ is the chord squared; a difference of squares taken as a product does not cancel.
    return (
        sine / angle,
        0.5 * chord * chord / t,
        (angle - sine) / (t * angle),
        (angle - chord) * (angle + chord) / (2.0 * t * t),
    )


@njit(cache=True, nogil=True)
def so3_integrals(turn: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Γ0 = Exp(θ), Γ1 = ∫₀¹ Exp(sθ) ds (the left Jacobian) and Γ2 = ∫₀¹∫₀ˢ Exp(rθ) dr ds, each (3, 3)."""
    a, b, c, d = _coefficients(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    return _polynomial(1.0, a, b, turn), _polynomial(1.0, b, c, turn), _polynomial(0.5, c, d, turn)


@njit(cache=True, nogil=True)
def moved(
    rotation: Float64Array,
    velocity: Float64Array,
    position: Float64Array,
    once: Float64Array,
    twice: Float64Array,
    force: Float64Array,
    gravity: float,
    dt: float,
) -> tuple[Float64Array, Float64Array]:
    """Velocity and position (3,) after `dt`, exactly for a turn rate and a force that are constant in `base`.

    `once` and `twice` are Γ1 and Γ2 of the turn in that time; gravity pulls along −z of the world.
    """
    later = velocity + dt * apply(rotation, apply(once, force))
    there = position + dt * velocity + dt * dt * apply(rotation, apply(twice, force))
    later[2] -= gravity * dt
    there[2] -= 0.5 * gravity * dt * dt
    return later, there


@njit(cache=True, nogil=True)
def so3_exp(turn: Float64Array) -> Float64Array:
    """(3, 3) the rotation about `turn` by its length."""
    a, b, _, _ = _coefficients(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    return _polynomial(1.0, a, b, turn)


@njit(cache=True, nogil=True)
def so3_log(rotation: Float64Array) -> Float64Array:
    """(3,) the shortest turn, at most π long. Exact near π too, since it goes by the quaternion."""
    return quaternion_log(quaternion_from(rotation))


@njit(cache=True, nogil=True)
def so3_left_jacobian(turn: Float64Array) -> Float64Array:
    """(3, 3) J with Exp(θ + δ) ≈ Exp(J δ) Exp(θ)."""
    _, b, c, _ = _coefficients(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    return _polynomial(1.0, b, c, turn)


@njit(cache=True, nogil=True)
def so3_left_jacobian_inverse(turn: Float64Array) -> Float64Array:
    """(3, 3) its inverse; there is none for a full turn."""
    t = turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2
    if t < SMALL:
        second = 1.0 / 12.0 + t / 720.0 * (1.0 + t / 42.0 * (1.0 + t / 40.0))
    else:
        half = 0.5 * math.sqrt(t)
        second = (1.0 - half * math.cos(half) / math.sin(half)) / t
    return _polynomial(1.0, -0.5, second, turn)


@njit(cache=True, nogil=True)
def se23_exp(twist: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Rotation (3, 3), velocity (3,) and position (3,) of a twist (9,)."""
    rotation, jacobian, _ = so3_integrals(twist[:3])
    return rotation, apply(jacobian, twist[3:6]), apply(jacobian, twist[6:9])


@njit(cache=True, nogil=True)
def se23_log(rotation: Float64Array, velocity: Float64Array, position: Float64Array) -> Float64Array:
    """(9,) the twist of an extended pose."""
    twist = np.empty(9)
    twist[:3] = so3_log(rotation)
    inverse = so3_left_jacobian_inverse(twist[:3])
    twist[3:6] = apply(inverse, velocity)
    twist[6:9] = apply(inverse, position)
    return twist


@njit(cache=True, nogil=True)
def se23_adjoint(rotation: Float64Array, velocity: Float64Array, position: Float64Array) -> Float64Array:
    """(9, 9) Ad with X Exp(ξ) = Exp(Ad ξ) X."""
    out = np.zeros((9, 9))
    out[:3, :3] = out[3:6, 3:6] = out[6:, 6:] = rotation
    out[3:6, :3] = mul(skew(velocity), rotation)
    out[6:, :3] = mul(skew(position), rotation)
    return out


@njit(cache=True, nogil=True)
def quaternion_product(a: Float64Array, b: Float64Array) -> Float64Array:
    """a ⊗ b."""
    out = np.empty(4)
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    return out


@njit(cache=True, nogil=True)
def quaternion_conjugate(a: Float64Array) -> Float64Array:
    """The inverse of a unit quaternion."""
    out = -a
    out[0] = a[0]
    return out


@njit(cache=True, nogil=True)
def normalised(a: Float64Array) -> Float64Array:
    """The vector with length 1; it must have a length."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * a[i]
    return a / math.sqrt(total)


@njit(cache=True, nogil=True)
def quaternion_exp(turn: Float64Array) -> Float64Array:
    """(4,) the rotation about `turn` (3,) by its length."""
    t = 0.25 * (turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    a, _, _, _ = _coefficients(t)
    out = np.empty(4)
    out[0] = math.cos(math.sqrt(t))
    out[1:] = 0.5 * a * turn
    return out


@njit(cache=True, nogil=True)
def quaternion_log(quaternion: Float64Array) -> Float64Array:
    """(3,) the shortest turn; q and −q are the same rotation."""
    sign = -1.0 if quaternion[0] < 0.0 else 1.0
    length = math.sqrt(quaternion[1] ** 2 + quaternion[2] ** 2 + quaternion[3] ** 2)
    if length == 0.0:
        return np.zeros(3)
    return sign * 2.0 * math.atan2(length, sign * quaternion[0]) / length * quaternion[1:]


@njit(cache=True, nogil=True)
def rotation_from(quaternion: Float64Array) -> Float64Array:
    """(3, 3) of a unit quaternion."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    out = np.empty((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
    )
    out[1, 0], out[1, 1], out[1, 2] = (
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
    )
    out[2, 0], out[2, 1], out[2, 2] = (
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )
    return out


@njit(cache=True, nogil=True)
def quaternion_from(rotation: Float64Array) -> Float64Array:
    """(4,) by its greatest component, so that nothing is divided by a small one (Shepperd, 1978)."""
    out = np.empty(4)
    trace = rotation[0, 0] + rotation[1, 1] + rotation[2, 2]
    greatest, value = 0, trace
    for i in range(3):
        if rotation[i, i] > value:
            greatest, value = i + 1, rotation[i, i]
    if greatest == 0:
        out[0] = 1.0 + trace
        out[1] = rotation[2, 1] - rotation[1, 2]
        out[2] = rotation[0, 2] - rotation[2, 0]
        out[3] = rotation[1, 0] - rotation[0, 1]
        return normalised(out)
    i = greatest - 1
    j, k = (i + 1) % 3, (i + 2) % 3
    out[0] = rotation[k, j] - rotation[j, k]
    out[1 + i] = 1.0 + 2.0 * rotation[i, i] - trace
    out[1 + j] = rotation[j, i] + rotation[i, j]
    out[1 + k] = rotation[k, i] + rotation[i, k]
    return normalised(out)


@njit(cache=True, nogil=True)
def wrap(angle: float) -> float:
    """The same direction in [−π, π)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@njit(cache=True, nogil=True)
def yaw_of(rotation: Float64Array) -> float:
    """Heading of the x axis."""
    return math.atan2(rotation[1, 0], rotation[0, 0])
