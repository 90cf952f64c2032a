"""Sticks, mixing tables, and what they make a vehicle do."""

from __future__ import annotations

import numpy as np
import pytest

from dream.robots.bluerov2.standin import motors
from dream.robots.bluerov2.standin.motors import FRAMES, Channels
from dream.vehicle import VECTORED, VECTORED_6DOF, Thrusters

ONES = np.ones(8)
AXES = ("roll", "pitch", "yaw", "throttle", "forward", "lateral")


@pytest.mark.parametrize(
    ("config", "thrusters", "axis"),
    [
        *((1, VECTORED, axis) for axis in AXES if axis != "pitch"),
        *((2, VECTORED_6DOF, axis) for axis in AXES),
    ],
)
def test_each_axis_pushes_the_vehicle_its_way(config: int, thrusters: Thrusters, axis: str) -> None:
    """Forward-right-down moments and forces, by where the thrusters sit. Six cannot pitch."""
    table = np.array(FRAMES[config][1])
    wanted = np.array([0.3 * (name == axis) for name in AXES])
    pulses = motors.mixed(wanted, table, ONES[: len(table)])
    wrench = thrusters.allocation @ motors.commands(pulses)
    # Of forward-left-up: x, y, z, then moments; right is −y, nose up is −pitch, clockwise is −yaw.
    along = {
        "forward": (0, 1),
        "lateral": (1, -1),
        "throttle": (2, 1),
        "roll": (3, 1),
        "pitch": (4, -1),
        "yaw": (5, -1),
    }
    k, sign = along[axis]
    assert sign * wrench[k] > 0.05
    forces = wrench[:3] if k >= 3 else np.delete(wrench[:3], k)
    np.testing.assert_allclose(forces, 0.0, atol=1e-9)


@pytest.mark.parametrize("config", [1, 2])
def test_the_tables_are_those_of_the_firmware(config: int) -> None:
    name, table = FRAMES[config]
    assert (name, len(table)) == (("VECTORED", 6), ("VECTORED_6DOF", 8))[config - 1]
    by_hand = [
        [0, 0, 1, 0, -1, 1],
        [0, 0, -1, 0, -1, -1],
        [0, 0, -1, 0, 1, 1],
        [0, 0, 1, 0, 1, -1],
    ]
    lifts = [[[1, 0, 0, -1, 0, 0], [-1, 0, 0, -1, 0, 0]]]
    lifts += [[[1, -1, 0, -1, 0, 0], [-1, -1, 0, -1, 0, 0], [1, 1, 0, -1, 0, 0], [-1, 1, 0, -1, 0, 0]]]
    np.testing.assert_array_equal(table, by_hand + lifts[config - 1])


def test_sticks_are_pulses_by_the_law_of_the_joystick() -> None:
    sticks = Channels.of(1000, -500, 750, 250, gain=0.5, throttle_gain=1.0)
    assert (sticks.forward, sticks.lateral, sticks.throttle, sticks.yaw) == (1700, 1400, 1600, 1550)
    assert (sticks.pitch, sticks.roll) == (1500, 1500)
    full = Channels.of(1000, -1000, 0, 1000, gain=1.0, throttle_gain=0.5)
    assert (full.forward, full.lateral, full.throttle, full.yaw) == (1900, 1100, 1300, 1900)
    beyond = Channels.of(32767, -32768, 32767, 0, gain=1.0, throttle_gain=1.0)
    assert (beyond.forward, beyond.lateral, beyond.throttle) == (1900, 1100, 1900)


def test_too_much_is_scaled_with_eight_and_cut_with_six() -> None:
    eight, six = np.array(FRAMES[2][1]), np.array(FRAMES[1][1])
    # Half a turn, forward and lateral at once ask 0.5, −2.5, 1.5 and 0.5 of the horizontal motors.
    wanted = [0.0, 0.0, 0.5, 0.0, 1.0, 1.0]
    assert motors.mixed(wanted, eight, ONES)[:4] == [1580, 1100, 1740, 1580]
    assert motors.mixed(wanted, six, ONES[:6])[:4] == [1700, 1100, 1900, 1700]


def test_a_direction_turns_its_motor_around() -> None:
    table = np.array(FRAMES[1][1])
    turned = motors.mixed([0, 0, 0, 0, 0.5, 0], table, np.array([-1.0, 1, 1, 1, 1, 1]))
    assert turned == [1700, 1300, 1700, 1700, 1500, 1500]
