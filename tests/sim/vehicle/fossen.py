"""The equations of motion as the book has them: 6 × 6 matrices, one line an equation, slow."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from dream.sim.vehicle import Current, Vehicle
from dream.vehicle import GRAVITY

Array = npt.NDArray[np.float64]


def skew(a: npt.ArrayLike) -> Array:
    x, y, z = np.asarray(a, np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def coriolis(M: Array, nu: Array) -> Array:
    """Fossen (2011), theorem 3.2: skew-symmetric, from any 6 × 6 mass matrix."""
    top, bottom = M[:3, :3] @ nu[:3] + M[:3, 3:] @ nu[3:], M[3:, :3] @ nu[:3] + M[3:, 3:] @ nu[3:]
    C = np.zeros((6, 6))
    C[:3, 3:], C[3:, :3], C[3:, 3:] = -skew(top), -skew(top), -skew(bottom)
    return C


def rigid(vehicle: Vehicle) -> Array:
    return np.diag([vehicle.hull.mass] * 3 + list(vehicle.hull.moments))


def added(vehicle: Vehicle) -> Array:
    return np.diag(vehicle.hull.added)


def line(vehicle: Vehicle, z: float, velocity: Array, current: Current, gust: npt.ArrayLike) -> Array:
    """Drag of a straight line from the vehicle to the surface, in 2000 slices."""
    assert vehicle.tether is not None
    part = (np.arange(2000) + 0.5) / 2000
    water = np.array([current.velocity(z * p, gust) for p in part])
    through = (part[:, None] * velocity - water)[:, :2]
    density = 0.5 * 1000.0 * vehicle.tether.drag_coefficient * vehicle.tether.diameter * -z
    force = np.mean(part[:, None] * density * np.linalg.norm(through, axis=1)[:, None] * through, axis=0)
    return -np.array([*force, 0.0])


def rates(
    vehicle: Vehicle,
    x: Array,
    targets: Array,
    current: Current,
    gust: npt.ArrayLike = (0.0, 0.0),
    pull: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> Array:
    """The time derivative of a state vector."""
    hull = vehicle.hull
    R = Rotation.from_quat(x[[4, 5, 6, 3]]).as_matrix()
    nu = x[7:13]
    water = np.concatenate([R.T @ current.velocity(x[2], gust), np.zeros(3)])
    nu_r = nu - water
    D = np.diag(np.array(hull.linear) + np.array(hull.quadratic) * np.abs(nu_r))
    at = np.array(hull.centre_of_buoyancy)
    under = np.clip(0.5 - (x[2] + (R @ at)[2]) / hull.height, 0.0, 1.0)
    buoyancy = R.T @ np.array([0.0, 0.0, under * (hull.weight + hull.net_buoyancy)])
    weight = R.T @ np.array([0.0, 0.0, -hull.mass * GRAVITY])
    tau = vehicle.thrusters.allocation @ x[13:]
    restoring = np.concatenate([weight + buoyancy, np.cross(at, buoyancy)])
    pulled, fixed = np.array(pull, np.float64), np.zeros(3)
    if vehicle.tether is not None:
        fixed = np.array(vehicle.tether.attachment)
        pulled = pulled + line(vehicle, x[2], R @ (nu[:3] + np.cross(nu[3:], fixed)), current, gust)
    tether = np.concatenate([R.T @ pulled, np.cross(fixed, R.T @ pulled)])
    turning = np.concatenate([-np.cross(nu[3:], water[:3]), np.zeros(3)])
    M_RB, M_A = rigid(vehicle), added(vehicle)
    forces = (
        tau + restoring + tether - coriolis(M_RB, nu) @ nu - coriolis(M_A, nu_r) @ nu_r - D @ nu_r
    ) + M_A @ turning
    w, i, j, k = x[3:7]
    p, q, r = nu[3:]
    turn = 0.5 * np.array(
        [-i * p - j * q - k * r, w * p + j * r - k * q, w * q + k * p - i * r, w * r + i * q - j * p]
    )
    lag = (targets - x[13:]) / vehicle.thrusters.lag
    return np.concatenate([R @ nu[:3], turn, np.linalg.solve(M_RB + M_A, forces), lag])


def step(
    vehicle: Vehicle,
    x: Array,
    commands: Array,
    dt: float,
    current: Current,
    gust: npt.ArrayLike = (0.0, 0.0),
    pull: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> Array:
    """One step of the fourth order."""
    targets = vehicle.thrusters.forces(commands)

    def f(at: Array) -> Array:
        return rates(vehicle, at, targets, current, gust, pull)

    a = f(x)
    b = f(x + 0.5 * dt * a)
    c = f(x + 0.5 * dt * b)
    d = f(x + dt * c)
    y = x + dt / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    y[3:7] /= np.linalg.norm(y[3:7])
    return y
