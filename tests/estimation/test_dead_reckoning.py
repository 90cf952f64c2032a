"""Dead reckoning: exact where nothing errs, and off by what its time constants say where something does."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dream.estimation import DeadReckoning, DeadReckoningState, Mounting
from dream.geometry import SE3
from dream.measurements import Heading, Imu
from tests.estimation.flights import DVL, PRESSURE, Flight, Log, Sensors, sense, survey

RECKONING = DeadReckoning(mounting=Mounting(DVL, PRESSURE))
PERFECT = Sensors(
    gyro_noise=0.0,
    accelerometer_noise=0.0,
    gyro_walk=0.0,
    accelerometer_walk=0.0,
    dvl_sigma=1e-9,
    dvl_every=1,
    depth_sigma=1e-9,
    heading_sigma=1e-9,
)


def fly(chosen: DeadReckoning, flight: Flight, log: Log) -> DeadReckoningState:
    state = chosen.begin(0.0, flight.pose(0), flight.velocities[0])
    for k, imu in enumerate(log.imu, start=1):
        state = chosen.predict(state, imu, flight.dt)
        for measurement in log.after.get(k, ()):
            state = chosen.correct(state, measurement)
    return state


def test_with_perfect_sensors_it_is_where_it_is() -> None:
    flight = survey(30.0)
    last = fly(replace(RECKONING, tilt_time=1e6), flight, sense(flight, PERFECT, np.random.default_rng(0)))
    np.testing.assert_allclose(last.rotation, flight.rotations[-1], atol=1e-5)
    np.testing.assert_allclose(last.velocity, flight.velocities[-1], atol=1e-5)
    np.testing.assert_allclose(last.position, flight.positions[-1], atol=0.01)
    assert last.time == pytest.approx(30.0)


def test_it_levels_itself_with_its_time_constant() -> None:
    tilted = Rotation.from_euler("ZYX", [0.5, 0.1, -0.08]).as_matrix()
    state = RECKONING.begin(0.0, SE3(tilted, np.zeros(3)))
    still = Imu(0.0, np.zeros(3), np.array([0.0, 0.0, 9.81]))
    for _ in range(200):
        state = RECKONING.predict(state, still, 0.01)
    left = math.acos(state.rotation[2, 2]) / math.acos(tilted[2, 2])
    assert left == pytest.approx(math.exp(-2.0 / RECKONING.tilt_time), rel=0.01)


@pytest.mark.parametrize("rate", [0.2, 10.0])
def test_the_heading_draws_with_its_time_constant_however_often_it_comes(rate: float) -> None:
    state = RECKONING.begin(0.0, SE3.level(0.0, 0.0, 0.0, 0.0))
    still = Imu(0.0, np.zeros(3), np.array([0.0, 0.0, 9.81]))
    state = RECKONING.correct(state, Heading(0.0, 0.0, 0.01))
    for _ in range(round(5.0 * rate)):
        state = RECKONING.predict(state, still, 1.0 / rate)
        state = RECKONING.correct(state, Heading(state.time, 3.0, 0.01))
    assert 3.0 - state.pose.yaw == pytest.approx(3.0 * math.exp(-5.0 / RECKONING.heading_time), rel=1e-6)


def test_the_first_heading_is_believed_at_once() -> None:
    state = RECKONING.begin(0.0, SE3.level(0.0, 0.0, 0.0, 0.0))
    assert RECKONING.correct(state, Heading(0.0, -2.0, 0.01)).pose.yaw == pytest.approx(-2.0)


def test_a_bias_of_the_gyro_tilts_it_by_bias_times_time_constant() -> None:
    bias = 0.01
    state = RECKONING.begin(0.0, SE3.level(0.0, 0.0, 0.0, 0.0))
    for _ in range(3000):
        state = RECKONING.predict(
            state, Imu(0.0, np.array([bias, 0.0, 0.0]), np.array([0.0, 0.0, 9.81])), 0.01
        )
    assert math.asin(state.rotation[2, 1]) == pytest.approx(bias * RECKONING.tilt_time, rel=0.01)
