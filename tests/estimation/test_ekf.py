"""The textbook's filter: its slopes, and where it falls short of the invariant one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from dream.estimation import Ekf, EkfState, InertialErrors, Mounting, Start, Verdict
from dream.estimation._kernels import ekf as kernels
from dream.geometry import SE3
from dream.measurements import Depth, Dvl, Heading, Imu, Measurement
from tests.estimation.flights import DVL, PRESSURE, Flight, Log, Sensors, sense, survey

Array = npt.NDArray[np.float64]

FILTER = Ekf(mounting=Mounting(DVL, PRESSURE))
NOISELESS = replace(FILTER, imu=InertialErrors(0.0, 0.0, 0.0, 0.0))


def some_state(seed: int) -> EkfState:
    rng = np.random.default_rng(seed)
    yaw, pitch, roll = rng.uniform([-3, -1, -1], [3, 1, 1])
    pose = SE3(Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix(), rng.uniform(-20.0, 20.0, 3))
    root = 0.05 * rng.standard_normal((15, 15))
    return replace(
        FILTER.begin(0.0, pose, rng.uniform(-1.0, 1.0, 3)),
        gyro_bias=rng.uniform(-0.01, 0.01, 3),
        accelerometer_bias=rng.uniform(-0.1, 0.1, 3),
        covariance=root @ root.T + 1e-4 * np.eye(15),
        gyro=rng.uniform(-0.5, 0.5, 3),
        gyro_variance=1e-4,
        begun=-math.inf,
    )


def moved_by(state: EkfState, error: Array) -> EkfState:
    turned = state.rotation @ Rotation.from_rotvec(error[:3]).as_matrix()
    x, y, z, w = Rotation.from_matrix(turned).as_quat()
    return replace(
        state,
        wxyz=np.array([w, x, y, z]),
        velocity=state.velocity + error[3:6],
        position=state.position + error[6:9],
        gyro_bias=state.gyro_bias + error[9:12],
        accelerometer_bias=state.accelerometer_bias + error[12:],
    )


def difference(truth: EkfState, state: EkfState) -> Array:
    return state.error(truth.pose, truth.velocity, truth.gyro_bias, truth.accelerometer_bias)


def fly(chosen: Ekf, state: EkfState, flight: Flight, log: Log, every: int = 10) -> list[EkfState]:
    states = [state]
    for k, imu in enumerate(log.imu, start=1):
        state = chosen.predict(state, imu, flight.dt)
        for measurement in log.after.get(k, ()):
            state = chosen.correct(state, measurement)
        if k % every == 0:
            states.append(state)
    return states


@pytest.mark.parametrize("seed", range(3))
def test_errors_move_as_the_covariance_says(seed: int) -> None:
    state, dt, small = some_state(seed), 0.01, 1e-6
    rng = np.random.default_rng(seed)
    imu = Imu(dt, rng.uniform(-1.0, 1.0, 3), rng.uniform(-2.0, 2.0, 3) + np.array([0.0, 0.0, 9.8]))
    for axis in np.eye(15):
        nominal = NOISELESS.predict(replace(state, covariance=np.outer(axis, axis)), imu, dt)
        ahead = NOISELESS.predict(moved_by(state, small * axis), imu, dt)
        behind = NOISELESS.predict(moved_by(state, -small * axis), imu, dt)
        slope = (difference(ahead, nominal) - difference(behind, nominal)) / (2.0 * small)
        # F leaves out terms of dt², such as the acceleration's part of the position.
        np.testing.assert_allclose(nominal.covariance, np.outer(slope, slope), atol=12.0 * dt**2)


@pytest.mark.parametrize("seed", range(3))
def test_rows_are_slopes_of_the_innovations(seed: int) -> None:
    state, small = some_state(seed), 1e-6
    q, covariance = FILTER.compiled, 1e-4 * np.eye(3)

    def seen(truth: EkfState) -> list[tuple[Array, Array, Array]]:
        body = truth.rotation.T @ truth.velocity
        body = body + np.cross(truth.gyro - truth.gyro_bias, DVL.translation)
        z = float(truth.position[2] + truth.rotation[2] @ np.array(PRESSURE))
        return [
            kernels.dvl_innovation(q, state.packed, DVL.rotation.T @ body, covariance),
            kernels.depth_innovation(q, state.packed, z, 0.01),
            kernels.heading_innovation(state.packed, truth.pose.yaw, 0.01),
        ]

    for V, _, _ in seen(state):
        np.testing.assert_allclose(V, np.zeros(len(V)), atol=1e-12)
    for axis in np.eye(15):
        ahead, behind = seen(moved_by(state, small * axis)), seen(moved_by(state, -small * axis))
        for (V, H, _), (V_behind, _, _) in zip(ahead, behind, strict=True):
            np.testing.assert_allclose((V - V_behind) / (2.0 * small), H @ axis, atol=1e-7)


@pytest.mark.rare
def test_errors_are_as_large_as_the_covariance_says_where_it_begins_near_the_truth() -> None:
    flight, seeds, total = survey(30.0), 12, 0.0
    chosen = replace(FILTER, start=Start(tilt=0.01, yaw=0.01, accelerometer_bias=0.01))
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        log = sense(flight, Sensors(), rng)
        start = chosen.begin(0.0, flight.pose(0), flight.velocities[0])
        sigmas = np.sqrt(np.diagonal(start.covariance))
        last = fly(chosen, moved_by(start, sigmas * rng.standard_normal(15)), flight, log, flight.steps)[-1]
        truth = (log.gyro_biases[-1], log.accelerometer_biases[-1])
        error = last.error(flight.pose(flight.steps), flight.velocities[-1], *truth)
        total += float(error @ np.linalg.solve(last.covariance, error))
    low, high = chi2.interval(0.99, 15 * seeds)
    assert low < total < high


def test_without_a_heading_it_believes_to_learn_the_yaw() -> None:
    """The law that the invariant filter keeps (`test_inekf`) can fail: here is one that breaks it."""
    flight = survey(40.0, aggressive=True)
    log = sense(flight, Sensors(has_heading=False), np.random.default_rng(3))
    chosen = replace(FILTER, start=Start(position=0.1))
    start = chosen.begin(0.0, flight.pose(0), flight.velocities[0])
    start = moved_by(
        start, np.sqrt(np.diagonal(start.covariance)) * np.random.default_rng(4).standard_normal(15)
    )
    states = fly(chosen, start, flight, log, every=10)

    def known(state: EkfState) -> float:
        """Along a turn of the whole world about the vertical."""
        up = np.array([0.0, 0.0, 1.0])
        turn = [
            state.rotation.T @ up,
            np.cross(up, state.velocity),
            np.cross(up, state.position),
            np.zeros(6),
        ]
        direction = np.concatenate(turn)
        return float(direction @ np.linalg.solve(state.covariance, direction))

    assert known(states[-1]) > 2.0 * known(states[0])


def test_it_refuses_what_is_unlikely_and_recovers_from_ten_seconds_without_bottom_lock() -> None:
    flight = survey(60.0)
    log = sense(flight, Sensors(dvl_lost=(35.0, 45.0)), np.random.default_rng(2))
    start = FILTER.begin(0.0, flight.pose(0), flight.velocities[0])
    last = fly(FILTER, start, flight, log, flight.steps)[-1]
    assert np.linalg.norm(last.velocity - flight.velocities[-1]) < 0.03
    assert abs(math.remainder(last.pose.yaw - flight.pose(flight.steps).yaw, 2.0 * math.pi)) < 0.01
    wrong: list[Measurement] = [
        Dvl(last.time, np.full(3, 5.0), 1e-4 * np.eye(3), 2.0, True),
        Depth(last.time, 30.0, 0.01),
        Heading(last.time, last.pose.yaw + 2.0, 0.01),
    ]
    for measurement in wrong:
        outcome = FILTER.correct(last, measurement).outcome
        assert outcome is not None
        assert outcome.verdict is Verdict.UNLIKELY
