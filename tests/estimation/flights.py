"""Motions with exact inertial samples, and what a vehicle that makes them senses; no simulator is behind."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from dream.geometry import SE3
from dream.measurements import Depth, Dvl, Heading, Imu, Measurement

Array = npt.NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, -9.81])
DVL = SE3(Rotation.from_euler("ZYX", [0.4, 0.05, -0.03]).as_matrix(), np.array([-0.15, 0.05, -0.12]))
PRESSURE = (-0.2, 0.03, 0.05)


@dataclass(frozen=True, eq=False)
class Flight:
    """A truth: n samples between n + 1 states, each sample of constant rate and force."""

    dt: float
    rotations: Array
    """(n + 1, 3, 3) base to world."""
    velocities: Array
    positions: Array
    rates: Array
    """(n, 3) rad/s, in `base`."""
    forces: Array
    """(n, 3) m/s², in `base`."""

    @property
    def steps(self) -> int:
        return len(self.rates)

    @property
    def distance(self) -> float:
        """Metres along the path."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    def pose(self, step: int) -> SE3:
        return SE3(self.rotations[step], self.positions[step])


def survey(duration: float, *, dt: float = 0.01, aggressive: bool = False) -> Flight:
    """Legs of 20 s at 0.5 m/s with a quarter turn after each, two to the left and two to the right.

    Aggressive adds a swing of the yaw by 60 degrees at 0.25 Hz, with up to 1.6 rad/s.
    """
    t = dt * np.arange(round(duration / dt) + 1)
    yaw = np.full_like(t, 0.3)
    for leg in range(math.ceil(duration / 26.0)):
        s = np.clip((t - 20.0 - 26.0 * leg) / 6.0, 0.0, 1.0)
        turn = 0.5 * math.pi * (1.0 if leg % 4 < 2 else -1.0)
        yaw += turn * (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5)
    sway = 0.05 * np.sin(0.7 * t)
    if aggressive:
        yaw += math.radians(60.0) * np.sin(0.5 * math.pi * t)
    pitch, roll = 0.06 * np.sin(0.9 * t), 0.08 * np.sin(1.3 * t + 0.4)
    attitude = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=-1))
    course = Rotation.from_euler("Z", yaw[:, None])
    along = np.stack([0.5 + 0.05 * np.sin(0.31 * t), sway, 0.08 * np.sin(0.21 * t)], axis=-1)
    return from_motion(dt, attitude, course.apply(along), np.array([0.0, 0.0, -3.0]))


def from_motion(dt: float, attitude: Rotation, velocities: Array, start: Array) -> Flight:
    """The samples of constant rate and force that lead exactly through these attitudes and velocities."""
    turns = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
    once, twice = _integrals(turns)
    R = attitude.as_matrix()
    pushed = np.einsum("nji,nj->ni", R[:-1], np.diff(velocities, axis=0) - GRAVITY * dt)
    forces = np.linalg.solve(once, pushed[..., None])[..., 0] / dt
    moves = velocities[:-1] * dt + 0.5 * GRAVITY * dt**2
    moves += np.einsum("nij,njk,nk->ni", R[:-1], twice, forces) * dt**2
    positions = start + np.concatenate([np.zeros((1, 3)), np.cumsum(moves, axis=0)])
    return Flight(dt, R, velocities, positions, turns / dt, forces)


def carried(dt: float, start: SE3, velocity: Array, rates: Array, forces: Array) -> Flight:
    """Where these samples lead."""
    turns = Rotation.from_rotvec(rates * dt)
    once, twice = _integrals(rates * dt)
    R, v, p = [np.asarray(start.rotation)], [velocity], [np.asarray(start.translation)]
    for k, turn in enumerate(turns.as_matrix()):
        p.append(p[-1] + v[-1] * dt + 0.5 * GRAVITY * dt**2 + R[-1] @ twice[k] @ forces[k] * dt**2)
        v.append(v[-1] + GRAVITY * dt + R[-1] @ once[k] @ forces[k] * dt)
        R.append(R[-1] @ turn)
    return Flight(dt, np.array(R), np.array(v), np.array(p), rates, forces)


def _integrals(turns: Array) -> tuple[Array, Array]:
    """Γ1 and Γ2 (n, 3, 3) by their series, for turns under one radian."""
    K = np.zeros((len(turns), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -turns[:, 2], turns[:, 1], -turns[:, 0]
    K -= K.transpose(0, 2, 1)
    power = np.broadcast_to(np.eye(3), K.shape)
    once, twice = np.zeros_like(K), np.zeros_like(K)
    for k in range(12):
        once += power / math.factorial(k + 1)
        twice += power / math.factorial(k + 2)
        power = power @ K
    return once, twice


@dataclass(frozen=True)
class Sensors:
    """How the sensors err. The defaults are those of `InEkf`, so that its noise is matched."""

    gyro_noise: float = 7.0e-5
    accelerometer_noise: float = 9.8e-4
    gyro_walk: float = 1e-5
    accelerometer_walk: float = 1e-4
    gyro_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accelerometer_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    dvl_sigma: float = 0.01
    dvl_scale: float = 1.0
    dvl_every: int = 10
    """Inertial samples between two reports; depth and heading come as often."""
    dvl_lost: tuple[float, float] = (math.inf, math.inf)
    """Seconds from when to when there is no bottom lock."""
    depth_sigma: float = 0.02
    heading_sigma: float = math.radians(1.0)
    heading_off: tuple[float, float, float] = (math.inf, math.inf, 0.0)
    """Seconds from when to when iron turns the compass, and by how much."""
    heading_told: float | None = None
    """The sigma that comes with a heading; the true one where None."""
    has_heading: bool = True


@dataclass(frozen=True, eq=False)
class Log:
    """What one flight's sensors said."""

    imu: list[Imu]
    """Sample k ends at (k + 1) dt."""
    after: dict[int, list[Measurement]]
    """By the number of samples before them."""
    gyro_biases: Array
    """(n + 1, 3) the truth."""
    accelerometer_biases: Array
    dt: float = field(default=0.01)

    def messages(self) -> Iterator[Imu | Measurement]:
        """All in the order of their times."""
        for k, imu in enumerate(self.imu):
            yield imu
            yield from self.after.get(k + 1, ())


def sense(
    flight: Flight,
    sensors: Sensors,
    rng: np.random.Generator,
    *,
    T_base_dvl: SE3 = DVL,
    pressure: tuple[float, float, float] = PRESSURE,
) -> Log:
    """One draw of all the noise."""
    n, dt = flight.steps, flight.dt

    def wander(start: tuple[float, float, float], density: float) -> Array:
        steps = density * math.sqrt(dt) * rng.standard_normal((n, 3))
        walk: Array = np.array(start) + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
        return walk

    gyro_biases = wander(sensors.gyro_bias, sensors.gyro_walk)
    accelerometer_biases = wander(sensors.accelerometer_bias, sensors.accelerometer_walk)
    rates = flight.rates + gyro_biases[:-1]
    rates += sensors.gyro_noise / math.sqrt(dt) * rng.standard_normal((n, 3))
    forces = flight.forces + accelerometer_biases[:-1]
    forces += sensors.accelerometer_noise / math.sqrt(dt) * rng.standard_normal((n, 3))
    imu = [Imu((k + 1) * dt, rates[k], forces[k]) for k in range(n)]
    after: dict[int, list[Measurement]] = {}
    covariance = sensors.dvl_sigma**2 * np.eye(3)
    for k in range(sensors.dvl_every, n + 1, sensors.dvl_every):
        time, R = k * dt, flight.rotations[k]
        body = R.T @ flight.velocities[k] + np.cross(flight.rates[k - 1], T_base_dvl.translation)
        seen = sensors.dvl_scale * (T_base_dvl.rotation.T @ body)
        seen = seen + sensors.dvl_sigma * rng.standard_normal(3)
        lock = not sensors.dvl_lost[0] <= time < sensors.dvl_lost[1]
        z = float(flight.positions[k, 2] + R[2] @ np.array(pressure))
        yaw = math.atan2(R[1, 0], R[0, 0])
        if sensors.heading_off[0] <= time < sensors.heading_off[1]:
            yaw += sensors.heading_off[2]
        yaw += sensors.heading_sigma * float(rng.standard_normal())
        told = sensors.heading_sigma if sensors.heading_told is None else sensors.heading_told
        after[k] = [
            Dvl(time, seen, covariance, 2.0, lock),
            Depth(time, z + sensors.depth_sigma * float(rng.standard_normal()), sensors.depth_sigma),
        ]
        if sensors.has_heading:
            after[k].append(Heading(time, math.remainder(yaw, 2.0 * math.pi), told))
    return Log(imu, after, gyro_biases, accelerometer_biases, dt)
