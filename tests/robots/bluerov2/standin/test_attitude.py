"""The stand-in's attitude filter."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dream.geometry import wrap_angle
from dream.measurements import Depth, Heading, Imu
from dream.robots.bluerov2.standin.attitude import Ahrs
from dream.robots.bluerov2.standin.tank import BEAT, Tank
from dream.sim.sensors import BAR30
from dream.sim.worlds import make_world

UP = np.array([0.0, 0.0, 9.81])


def level(
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0), yaw: float = 0.4
) -> tuple[Imu, Heading, Depth]:
    return Imu(0.0, np.array(rates), UP), Heading(0.0, yaw, 0.01), Depth(0.0, -1.0, 0.01)


def test_it_begins_at_what_it_feels() -> None:
    roll, pitch = 0.2, -0.1
    felt = 9.81 * np.array(
        [-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch)]
    )
    ahrs = Ahrs(Imu(0.0, np.zeros(3), felt), Heading(0.0, 0.7, 0.01), Depth(0.0, -1.0, 0.01))
    assert ahrs.euler == pytest.approx((roll, pitch, 0.7))
    assert ahrs.z == -1.0


def test_held_still_it_learns_its_bias_and_then_turns_by_the_rest() -> None:
    bias = (0.01, -0.02, 0.03)
    imu, heading, depth = level(bias)
    ahrs = Ahrs(imu, heading, depth)
    for _ in range(100):
        ahrs.feel(imu, BEAT)
    assert ahrs.bias == pytest.approx(bias)
    for _ in range(100):
        ahrs.feel(Imu(0.0, np.array([0.01, -0.02, 0.53]), UP), BEAT)
    assert ahrs.euler[2] == pytest.approx(0.4 + 0.5, abs=0.01)


def test_a_tilt_that_is_not_felt_is_levelled_and_a_compass_followed() -> None:
    ahrs = Ahrs(*level())
    ahrs.q = (math.cos(0.1), math.sin(0.1), 0.0, 0.0)
    for k in range(6000):
        ahrs.feel(level()[0], BEAT)
        if k % 10 == 0:
            ahrs.face(Heading(0.0, 1.0, 0.01))
    roll, pitch, yaw = ahrs.euler
    assert abs(roll) < 0.02
    assert abs(pitch) < 0.02
    assert yaw == pytest.approx(1.0, abs=0.01)


def test_depth_follows_the_gauge() -> None:
    ahrs = Ahrs(*level())
    for k in range(1000):
        ahrs.feel(level()[0], BEAT)
        if k % 10 == 0:
            ahrs.sink(Depth(0.0, -1.0 - 0.1 * 0.01 * k, 0.01))
    assert ahrs.z == pytest.approx(-2.0, abs=0.02)
    assert ahrs.climb == pytest.approx(-0.1, abs=0.01)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_on_a_moving_vehicle_it_stays_within_degrees_of_the_truth(seed: int) -> None:
    tank = Tank(make_world("pool/arc", 1), seed=seed)
    ahrs = Ahrs(tank.imu, tank.heading, tank.depth)
    for beat in range(1500):
        if beat == 200:
            tank.release()
        push = 0.25 * math.sin(0.01 * beat)
        tank.advance([push, push, -push, -push, 0.12 * push, 0.0, 0.0, -0.1 * push])
        ahrs.feel(tank.imu, BEAT)
        if tank.heading.time == tank.time:
            ahrs.face(tank.heading)
        if tank.depth.time == tank.time:
            ahrs.sink(tank.depth)
    r = tank.T_world_base.rotation
    true = math.atan2(r[2, 1], r[2, 2]), -math.asin(r[2, 0]), math.atan2(r[1, 0], r[0, 0])
    off = [math.degrees(wrap_angle(a - b)) for a, b in zip(ahrs.euler, true, strict=True)]
    assert max(map(abs, off[:2])) < 4.0
    # Offset and iron of the compass are its own.
    assert abs(off[2]) < 8.0
    # Where the gauge is: the vehicle, which nobody levels, stands on its tail by then.
    assert ahrs.z == pytest.approx((tank.T_world_base @ np.array(BAR30.position))[2], abs=0.1)
