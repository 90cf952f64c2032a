"""The navigator: from messages of real devices to a pose, and a clear no where there is none."""

import math
from dataclasses import replace

import numpy as np
import pytest

from dream.geometry import SE2, SE3, wrap_angle
from dream.measurements import Depth, Dvl, Heading, Imu, Measurement
from dream.robots.bluerov2.navigation import ESTIMATORS, Instruments, Navigator, NotReady

RATE = 50.0
START = SE2(1.0, -0.5, math.radians(40.0))
COMPASS_OFF = math.radians(25.0)
BIAS = np.array([0.002, -0.001, 0.003])


def messages(
    begins: float,
    seconds: float,
    *,
    surge: float = 0.0,
    yaw_rate: float = 0.0,
    pose: SE2 = START,
    height: float = -0.9,
    altitude: float = 0.6,
    tilt: float = 0.0,
) -> tuple[list[Imu | Measurement], SE2]:
    """What all sensors of a vehicle say that swims evenly on a circle, and where it ends."""
    instruments = Instruments()
    rng, x, y, yaw = np.random.default_rng(3), pose.x, pose.y, pose.yaw
    lever = np.asarray(instruments.mounting.T_base_dvl.translation)
    said: list[Imu | Measurement] = []
    dt = 1.0 / RATE
    for k in range(1, round(seconds * RATE) + 1):
        time = begins + k * dt
        middle = yaw + 0.5 * yaw_rate * dt
        x, y, yaw = x + surge * math.cos(middle) * dt, y + surge * math.sin(middle) * dt, yaw + yaw_rate * dt
        force = np.array([-9.81 * math.sin(tilt), surge * yaw_rate, 9.81 * math.cos(tilt)])
        said.append(Imu(time, np.array([0, 0, yaw_rate]) + BIAS + 1e-4 * rng.standard_normal(3), force))
        if k % 5 == 0:
            gauge = height + 0.2 * math.sin(tilt)
            said.append(Depth(time, gauge, 0.005))
            said.append(Heading(time, wrap_angle(yaw + COMPASS_OFF), 0.02))
            velocity = np.array([surge, 0.0, 0.0]) + np.cross([0.0, 0.0, yaw_rate], lever)
            said.append(Dvl(time, velocity, 1e-5 * np.eye(3), altitude + lever[2], True))
    return said, SE2(x, y, wrap_angle(yaw))


def aligned(estimator: str = "inekf") -> Navigator:
    clock = [3.0]
    navigator = Navigator(Instruments(estimator=estimator), lambda: clock[0])
    navigator.align(START, messages(0.0, 3.0)[0])
    return navigator


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_it_follows_a_vehicle_on_a_circle(estimator: str) -> None:
    navigator = aligned(estimator)
    said, end = messages(3.0, 10.0, surge=0.2, yaw_rate=0.15)
    for message in said:
        navigator.deliver(message)
        fix = navigator.update()
    assert fix.T_world_base.se2.distance(end) < (0.01 if estimator in ("inekf", "ekf") else 0.1)
    assert abs(wrap_angle(fix.T_world_base.yaw - end.yaw)) < math.radians(3.0)
    assert fix.altitude == pytest.approx(0.5)
    assert fix.seabed == pytest.approx(-1.5, abs=0.02)


def test_the_map_has_the_heading_that_the_operator_states() -> None:
    navigator = aligned()
    fix = navigator.update()
    assert fix.T_world_base.se2.distance(START) < 1e-9
    assert abs(wrap_angle(fix.T_world_base.yaw - START.yaw)) < 1e-9
    assert fix.T_world_base.translation[2] == pytest.approx(-0.9)
    said, _ = messages(3.0, 5.0)
    for message in said:
        navigator.deliver(message)
    assert abs(wrap_angle(navigator.update().T_world_base.yaw - START.yaw)) < math.radians(0.5)


def test_a_tilted_vehicle_begins_tilted_and_at_its_own_depth() -> None:
    navigator = Navigator(Instruments(), lambda: 3.0)
    navigator.align(START, messages(0.0, 3.0, tilt=0.1)[0])
    pose = navigator.update().T_world_base
    # Pitched by 0.1 rad the nose is down in axes that are forward-left-up.
    assert pose.rotation[2, 0] == pytest.approx(-math.sin(0.1), abs=1e-3)
    force = pose.rotation.T @ np.array([0.0, 0.0, 9.81])
    assert force == pytest.approx([-9.81 * math.sin(0.1), 0.0, 9.81 * math.cos(0.1)], abs=1e-6)


def test_the_pose_of_a_picture_lies_on_the_way() -> None:
    navigator = aligned()
    said, _ = messages(3.0, 2.0, surge=0.1)
    for message in said:
        navigator.deliver(message)
        navigator.update()
    early, late = navigator.at(4.0).se2, navigator.at(4.5).se2
    assert early.distance(late) == pytest.approx(0.05, abs=0.01)
    between = navigator.at(4.013)
    assert isinstance(between, SE3)
    assert early.distance(between.se2) == pytest.approx(0.0013, abs=6e-4)
    assert navigator.at(99.0).se2 == navigator.update().T_world_base.se2
    with pytest.raises(NotReady, match="within the last"):
        navigator.at(1.0)


@pytest.mark.parametrize(
    "spoil, wrong",
    [
        (lambda said: [m for m in said if not isinstance(m, Imu)], "inertial samples"),
        (lambda said: [m for m in said if not isinstance(m, Depth)], "depths"),
        (lambda said: [m for m in said if not isinstance(m, Heading)], "headings"),
        (lambda said: [replace(m, valid=False) if isinstance(m, Dvl) else m for m in said], "bottom lock"),
        (
            lambda said: [
                replace(m, angular_velocity=m.angular_velocity + math.sin(9.0 * m.time))
                if isinstance(m, Imu)
                else m
                for m in said
            ],
            "lies still",
        ),
        (
            lambda said: [
                replace(m, specific_force=0.1 * m.specific_force) if isinstance(m, Imu) else m for m in said
            ],
            "specific force",
        ),
    ],
)
def test_it_does_not_begin_without_its_sensors(spoil, wrong: str) -> None:  # type: ignore[no-untyped-def]
    navigator = Navigator(Instruments(), lambda: 3.0)
    with pytest.raises(NotReady, match=wrong):
        navigator.align(START, spoil(messages(0.0, 3.0)[0]))
    with pytest.raises(NotReady, match="align"):
        navigator.update()


def test_what_is_refused_is_counted_and_ages_grow() -> None:
    clock = [3.0]
    navigator = Navigator(Instruments(), lambda: clock[0])
    navigator.align(START, messages(0.0, 3.0)[0])
    navigator.deliver(Imu(3.02, np.array([np.nan, 0.0, 0.0]), np.array([0.0, 0.0, 9.81])))
    navigator.deliver(Dvl(2.98, np.full(3, np.nan), np.full((3, 3), np.nan), math.nan, False))
    clock[0] = 5.0
    fix = navigator.update()
    assert sum(navigator.refused.values()) == 2
    assert fix.imu_age == pytest.approx(2.0, abs=0.03)
    assert fix.dvl_age == pytest.approx(2.0, abs=0.11)
    assert math.isnan(fix.altitude)


def test_messages_that_were_lost_are_the_end_of_the_estimate() -> None:
    navigator = aligned()
    for message in messages(3.0, 70.0)[0]:
        navigator.deliver(message)
    with pytest.raises(NotReady, match="others are lost"):
        navigator.update()


def test_an_estimator_that_there_is_not_is_named() -> None:
    with pytest.raises(ValueError, match="expected one of inekf, ekf, cipg"):
        Instruments(estimator="ukf")
