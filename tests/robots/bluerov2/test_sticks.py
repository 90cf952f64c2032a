from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from dream.robots.bluerov2.sticks import (
    NEUTRAL,
    STILL,
    VELOCITY_AND_YAW_RATE,
    Joystick,
    Sticks,
    forward_right_down,
)
from dream.types import BodyVelocity
from dream.vehicle import VECTORED, VECTORED_6DOF, Thrusters

BOTH = pytest.mark.parametrize("thrusters", [VECTORED, VECTORED_6DOF], ids=["vectored", "6dof"])
forces = st.floats(-60.0, 60.0)
directions = st.floats(-math.pi, math.pi)
gains = st.sampled_from([0.25, 0.5, 0.75, 1.0])

# ArduSub's own mixing (AP_Motors6DOF): factors of yaw, forward and lateral of motors 1 to 4. Where its
# motor pushes with a positive command is the opposite of where ours does.
ARDUSUB = np.array([[1, -1, 1], [-1, -1, -1], [-1, 1, 1], [1, 1, -1]], np.float64)


def ardusub_wrench(thrusters: Thrusters, gain: float, sticks: Sticks) -> np.ndarray:
    """Slow twin: channels in µs, ArduSub's table, the T200, and where thrusters sit."""
    channel = {name: (0.4 * gain * getattr(sticks, name)) / 400.0 for name in "xyr"}
    total = np.zeros(3)
    for motor in range(4):
        command = ARDUSUB[motor] @ [channel["r"], channel["x"], channel["y"]]
        force = float(thrusters.forces(-command))
        (px, py, _), (dx, dy, _) = thrusters.positions[motor], thrusters.directions[motor]
        total += force * np.array([dx, dy, px * dy - py * dx])
    return total


@BOTH
@given(st.integers(-1000, 1000), st.integers(-1000, 1000), st.integers(-1000, 1000), gains)
def test_the_wrench_is_that_of_ardusubs_table(
    thrusters: Thrusters, x: int, y: int, r: int, gain: float
) -> None:
    sticks = Sticks(x, y, 500, r)
    wrench = Joystick(thrusters, gain=gain).wrench(sticks)
    assert np.allclose(wrench, ardusub_wrench(thrusters, gain, sticks), atol=1e-9)


def test_full_stick_ahead_by_hand() -> None:
    # Half gain: 200 µs, so commands of ±0.5: 17.8 N ahead and 14.1 N astern, two of each, at 45°.
    ahead, left = Joystick().force(Sticks(x=1000))
    assert ahead == pytest.approx(2 * (17.8 + 14.1) * math.sqrt(0.5))
    assert left == pytest.approx(0.0, abs=1e-12)


def test_signs() -> None:
    joystick = Joystick()
    assert joystick.sticks(20.0, 0.0).x > 100
    assert joystick.sticks(20.0, 0.0).y == 0
    assert joystick.sticks(0.0, 20.0).y < -100  # y is to the right
    assert joystick.sticks(0.0, 0.0, turn_rate=0.3).r < -100  # r is clockwise
    assert joystick.sticks(0.0, 0.0, climb_rate=0.1).z > 600
    assert joystick.manual(0.0, 0.0, 5.0).r < -100
    assert joystick.wrench(Sticks(r=500))[2] < -1.0


def test_nothing_asked_is_neutral() -> None:
    assert Joystick().sticks(0.0, 0.0) == NEUTRAL == Sticks(0, 0, 500, 0)
    assert Joystick().manual(0.0, 0.0, 0.0) == NEUTRAL
    assert forward_right_down(STILL) == (0.0, 0.0, 0.0, 0.0)


@BOTH
@given(st.floats(0.2, 1.0), directions, gains)
def test_a_force_within_reach_is_met(thrusters: Thrusters, share: float, angle: float, gain: float) -> None:
    joystick = Joystick(thrusters, gain=gain)
    size = share * joystick.force(Sticks(x=1000))[0] * math.sqrt(0.5)
    wanted = size * math.cos(angle), size * math.sin(angle)
    got = joystick.force(joystick.sticks(*wanted))
    # A stick step is at most 0.001 of a command, and a thruster's steepest 0.07 N for that.
    assert np.allclose(got, wanted, atol=0.25)


@given(st.floats(50.0, 1e6), directions, gains)
def test_a_force_beyond_reach_keeps_its_direction(size: float, angle: float, gain: float) -> None:
    joystick = Joystick(gain=gain)
    wanted = np.array([size * math.cos(angle), size * math.sin(angle)])
    sticks = joystick.sticks(*wanted)
    got = np.array(joystick.force(sticks))
    assume(np.linalg.norm(got) < 0.98 * size)
    assert max(abs(sticks.x), abs(sticks.y)) > 990 or gain > 0.5
    assert np.linalg.norm(got) > 3.0
    turned = (got[0] * wanted[1] - got[1] * wanted[0]) / (np.linalg.norm(got) * size)
    assert abs(turned) < 0.03


@given(forces, forces)
def test_a_smaller_force_is_never_more_stick_on_a_diagonal(a: float, b: float) -> None:
    joystick = Joystick()
    low, high = sorted((abs(a), abs(b)))
    less, more = joystick.sticks(low, low), joystick.sticks(high, high)
    assert less.x <= more.x
    assert less.y >= more.y


def test_the_dead_band_is_stepped_over() -> None:
    # 0.05 N a thruster still needs 7 % of throttle: 140 of the stick at half gain.
    assert Joystick().sticks(0.1, 0.0).x >= 140
    assert Joystick().force(Sticks(x=139)) == (0.0, 0.0)


def test_a_weaker_battery_takes_more_stick() -> None:
    full, flat = replace(VECTORED, voltage=16.8), replace(VECTORED, voltage=13.0)
    assert Joystick(flat).sticks(20.0, 0.0).x > Joystick(full).sticks(20.0, 0.0).x + 20


@given(st.floats(-15.0, 15.0), st.floats(-15.0, 15.0), st.floats(-2.5, 2.5))
def test_force_and_moment_are_met_nearly(ahead: float, left: float, moment: float) -> None:
    joystick = Joystick(gain=1.0)
    got = joystick.wrench(joystick.manual(ahead, left, moment))
    arm = 0.24
    error = np.array(got) - (ahead, left, moment)
    scale = math.hypot(ahead, left, moment / arm)
    assert math.hypot(error[0], error[1], error[2] / arm) < 0.12 * scale + 1.5


def test_a_moment_beyond_reach_saturates() -> None:
    assert Joystick().manual(0.0, 0.0, 1e9).r == -1000
    assert Joystick().manual(1e9, 0.0, 0.0).x == 1000


@given(st.floats(-1.1, 1.1))
def test_turn_rate_round_trip(rate: float) -> None:
    joystick = Joystick()
    assume(rate == 0.0 or abs(rate) > 0.02)
    # One step of the stick is 0.08°/s … 0.1°/s at half gain.
    assert joystick.turn_rate(joystick.sticks(0.0, 0.0, turn_rate=rate)) == pytest.approx(rate, abs=0.002)


def test_turn_rate_by_hand() -> None:
    # r = 300, half gain: 60 µs, less the dead zone of 20, of 380 left: 4500·40/380·3.375 cd/s = 15.99°/s.
    assert math.degrees(Joystick().turn_rate(Sticks(r=300))) == pytest.approx(-15.987, abs=1e-3)
    assert Joystick().turn_rate(Sticks(r=99)) == 0.0
    assert Joystick().sticks(0.0, 0.0, turn_rate=50.0).r == -1000


@given(st.floats(-1.5, 1.5))
def test_climb_rate_round_trip(rate: float) -> None:
    joystick = Joystick()
    assume(rate == 0.0 or abs(rate) > 0.02)
    assert joystick.climb_rate(joystick.sticks(0.0, 0.0, climb_rate=rate)) == pytest.approx(rate, abs=0.02)


def test_climb_rate_by_hand() -> None:
    # z = 200, half gain: 1380 µs, read as 1000·250/770 = 324.7; the band begins at 480 − 50: 105.3/430·5 m/s.
    assert Joystick().climb_rate(Sticks(z=200)) == pytest.approx(-5.0 * (430 - 324.675) / 430, abs=1e-4)
    assert Joystick().climb_rate(Sticks(z=560)) == 0.0
    assert Joystick().climb_rate(NEUTRAL) == 0.0
    assert Joystick().sticks(0.0, 0.0, climb_rate=9.0).z == 1000
    assert Joystick().sticks(0.0, 0.0, climb_rate=-9.0).z == 0


@given(st.floats(0.1, 1.0), st.integers(0, 300))
def test_the_dead_zone_of_z_shrinks_with_the_gain_so_that_sticks_leave_it_at_the_same_place(
    gain: float, dead: int
) -> None:
    joystick = Joystick(gain=gain, throttle_dead_zone=dead)
    # 0.8·gain µs a stick and 1000/770 a µs, against a band of dead·gain about 480 of 480.5.
    edge = (dead * gain + 480.0 - 480.5195) / (0.8 * gain * 1000.0 / 770.0)
    for z in range(500, 1001, 20):
        if abs(z - 500 - edge) > 1e-3:
            assert (joystick.climb_rate(Sticks(z=z)) > 0.0) == (z - 500 > edge)
    # And no stick that asks for something is within it.
    for rate in (0.05, -0.05):
        asked = joystick.climb_rate(joystick.sticks(0.0, 0.0, climb_rate=rate))
        assert math.copysign(1.0, asked) == math.copysign(1.0, rate)
        one = joystick.climb * 0.8 * gain * (1000.0 / 770.0) / (1000.0 - 480.0 - dead * gain)
        assert asked == pytest.approx(rate, abs=one)


def test_parameters_of_a_vehicle() -> None:
    names = {"FRAME_CONFIG": 2.0, "JS_GAIN_DEFAULT": 0.75, "PILOT_SPEED_UP": 50.0, "PILOT_SPEED_DN": 0.0}
    joystick = Joystick.of(names)
    assert joystick.thrusters is VECTORED_6DOF
    assert joystick.gain == 0.75
    assert joystick.climb == joystick.sink == 0.5
    assert Joystick.of({}, gain=1.0) == Joystick(gain=1.0)
    with pytest.raises(ValueError, match=r"1 \(VECTORED\) or 2"):
        Joystick.of({"FRAME_CONFIG": 7.0})
    with pytest.raises(ValueError, match="gain"):
        Joystick.of({"JS_GAIN_DEFAULT": 0.0})


def test_velocity_by_hand() -> None:
    assert forward_right_down(BodyVelocity(0.3, 0.1, 0.2, 0.5)) == (0.3, -0.1, -0.2, -0.5)
    # Bits 0–2 position, 6–8 acceleration, 10 yaw: 7 + 448 + 1024.
    assert VELOCITY_AND_YAW_RATE == 7 + 448 + 1024


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_nan_is_refused_everywhere(bad: float) -> None:
    joystick = Joystick()
    for arguments in ((bad, 0.0), (0.0, bad)):
        with pytest.raises(ValueError, match="finite"):
            joystick.sticks(*arguments)
        with pytest.raises(ValueError, match="velocity"):
            forward_right_down(BodyVelocity(*arguments, 0.0, 0.0))
    for name in ("turn_rate", "climb_rate"):
        with pytest.raises(ValueError, match=name):
            joystick.sticks(0.0, 0.0, **{name: bad})
    with pytest.raises(ValueError, match="moment"):
        joystick.manual(0.0, 0.0, bad)
    with pytest.raises(ValueError, match="velocity"):
        forward_right_down(BodyVelocity(0.0, 0.0, 0.0, bad))


@pytest.mark.parametrize("axes", [{"x": 1001}, {"y": -1001}, {"z": -1}, {"z": 1001}, {"r": 1001}, {"x": 1.0}])
def test_sticks_out_of_range_are_refused(axes: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="sticks"):
        Sticks(**axes)


def test_too_fast_is_refused() -> None:
    with pytest.raises(ValueError, match="at most 2"):
        forward_right_down(BodyVelocity(1.5, 1.5, 0.0, 0.0))
    with pytest.raises(ValueError, match="π"):
        forward_right_down(BodyVelocity(0.0, 0.0, 0.0, 4.0))
