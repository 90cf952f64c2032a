"""The right-invariant filter as its equations stand in the papers: 5 × 5 matrices, `expm`, `inv`, nothing
saved.

The pose is X = [[R, v, p], [0, I]]. With W = [[ω^×, a, 0], [0, 0, 1], [0, 0, 0]] and G = [[0, g, 0], [0, 0,
−1], [0, 0, 0]] the motion is X' = G X + X W, so that X⁺ = expm(G dt) X expm(W dt).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag, expm

Array = npt.NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, -9.81])


def hat(a: Array) -> Array:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def extended(rotation: Array, velocity: Array, position: Array) -> Array:
    X = np.eye(5)
    X[:3, :3], X[:3, 3], X[:3, 4] = rotation, velocity, position
    return X


def group(xi: Array) -> Array:
    """Exp of SE_2(3)."""
    lie = np.zeros((5, 5))
    lie[:3, :3], lie[:3, 3], lie[:3, 4] = hat(xi[:3]), xi[3:6], xi[6:9]
    moved: Array = expm(lie)
    return moved


def adjoint(X: Array) -> Array:
    R, v, p, zero = X[:3, :3], X[:3, 3], X[:3, 4], np.zeros((3, 3))
    return np.block([[R, zero, zero], [hat(v) @ R, R, zero], [hat(p) @ R, zero, R]])


def slope(X: Array) -> Array:
    """A of the error's linear motion."""
    R, v, p = X[:3, :3], X[:3, 3], X[:3, 4]
    zero, one = np.zeros((3, 3)), np.eye(3)
    return np.block(
        [
            [zero, zero, zero, -R, zero],
            [hat(GRAVITY), zero, zero, -hat(v) @ R, -R],
            [zero, one, zero, -hat(p) @ R, zero],
            [np.zeros((6, 15))],
        ]
    )


def predict(
    X: Array, b: Array, P: Array, gyro: Array, force: Array, dt: float, densities: Array
) -> tuple[Array, Array]:
    """Pose and covariance after a sample; densities of gyro, accelerometer and their biases."""
    W, G = np.zeros((5, 5)), np.zeros((5, 5))
    W[:3, :3], W[:3, 3], W[3, 4] = hat(gyro - b[:3]), force - b[3:], 1.0
    G[:3, 3], G[3, 4] = GRAVITY, -1.0
    Q = np.diag(np.repeat([densities[0], densities[1], 0.0, densities[2], densities[3]], 3) ** 2)
    Ad = block_diag(adjoint(X), np.eye(6))
    Phi = expm(slope(X) * dt)
    return expm(G * dt) @ X @ expm(W * dt), Phi @ (P + Ad @ Q @ Ad.T * dt) @ Phi.T


def correct(X: Array, b: Array, P: Array, V: Array, H: Array, N: Array) -> tuple[Array, Array, Array, float]:
    """Pose, biases and covariance after an innovation, and its normalised square."""
    S = H @ P @ H.T + N
    K = P @ H.T @ np.linalg.inv(S)
    step = K @ V
    L = np.eye(15) - K @ H
    return group(step[:9]) @ X, b + step[9:], L @ P @ L.T + K @ N @ K.T, float(V @ np.linalg.inv(S) @ V)


def dvl(
    X: Array, b: Array, gyro: Array, gyro_variance: float, z: Array, cov: Array, R_d: Array, t: Array
) -> tuple[Array, Array, Array]:
    R = X[:3, :3]
    V = R @ (R_d @ z + hat(t) @ (gyro - b[:3])) - X[:3, 3]
    zero = np.zeros((3, 3))
    H = np.hstack([zero, np.eye(3), zero, R @ hat(t), zero])
    N = R @ (R_d @ cov @ R_d.T + gyro_variance * hat(t) @ hat(t).T) @ R.T
    return V, H, N


def depth(X: Array, z: float, sigma: float, t: Array) -> tuple[Array, Array, Array]:
    at = X[:3, 4] + X[:3, :3] @ t
    H = np.zeros((1, 15))
    H[0, :3], H[0, 8] = -hat(at)[2], 1.0
    return np.array([z - at[2]]), H, np.array([[sigma**2]])


def heading(X: Array, yaw: float, sigma: float) -> tuple[Array, Array, Array]:
    R: Any = X[:3, :3]
    psi, theta = np.arctan2(R[1, 0], R[0, 0]), -np.arcsin(R[2, 0])
    H = np.zeros((1, 15))
    H[0, :3] = np.tan(theta) * np.cos(psi), np.tan(theta) * np.sin(psi), 1.0
    difference = (yaw - psi + np.pi) % (2 * np.pi) - np.pi
    return np.array([difference]), H, np.array([[sigma**2]])
