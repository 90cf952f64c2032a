from __future__ import annotations

import itertools
import json
import math
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from dream.geometry import wrap_angle
from dream.measurements import Depth, Heading, Imu
from dream.robots.bluerov2.limits import SAG
from dream.robots.bluerov2.mavlink import LIFELINE, LOST, PERIOD, RATES, REASON, Link, Refused, Restored
from dream.robots.bluerov2.motion import LONGEST, ExpiringOrders
from dream.robots.bluerov2.reports import GRAVITY, SEA
from dream.robots.bluerov2.standin.ardusub import ArduSub
from dream.robots.bluerov2.standin.lockstep import LockStep
from dream.robots.bluerov2.standin.tank import Conditions, Tank
from dream.robots.bluerov2.sticks import NEUTRAL, STILL, Sticks
from dream.robots.bluerov2.telemetry import HEADING_SIGMA, LOCAL, SLIPPED, Sag
from dream.robots.bluerov2.wire import Udp
from dream.sim.worlds import make_world
from dream.types import BodyVelocity
from dream.vehicle import VECTORED_6DOF
from tests.robots.bluerov2.diver import Diver, afloat
from tests.robots.bluerov2.waiting import until

AHEAD = Sticks(x=400, r=-100)
FASTER = BodyVelocity(0.3, 0.1, -0.05, 0.4)
NO_MESSAGES: dict[str, float] = {}
PARAMETERS = {
    "MAV_GCS_SYSID": 255.0,
    "FS_PILOT_INPUT": 1.0,
    "FS_PILOT_TIMEOUT": 3.0,
    "FS_GCS_ENABLE": 2.0,
    "FS_LEAK_ENABLE": 1.0,
    "FRAME_CONFIG": 2.0,
    "JS_GAIN_DEFAULT": 0.5,
    "JS_THR_GAIN": 1.0,
    "PILOT_SPEED_UP": 50.0,
    "BTN13_FUNCTION": 33.0,
    "BTN14_FUNCTION": 32.0,
}


class Clock:
    """A clock that a test winds."""

    def __init__(self) -> None:
        self.time = 100.0

    def __call__(self) -> float:
        return self.time


class Vehicle:
    """A scripted ArduSub at the end of a wire without length: it answers while it is spoken to."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.clock = clock
        self.writer = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self.reader = dialect.MAVLink(None)
        self.hear: Callable[[bytes], None] = lambda _: None
        self.sent: list[tuple[float, Any]] = []
        self.parameters = dict(PARAMETERS)
        self.mode, self.armed = 19, False
        self.state = dialect.MAV_STATE_ACTIVE
        self.deaf = Counter[str]()
        self.results: dict[int, int] = {}
        self.why = ""
        self.booted = 90.0
        self.tilt, self.tilt_reported = 0.0, True
        self.lights, self.buttons = 0.0, 0
        self.stuck = ""

    # The wire

    def send(self, data: bytes) -> bool:
        for message in self.reader.parse_buffer(data) or ():
            self.sent.append((self.clock(), message))
            self.answer(message)
        return True

    def receive(self) -> bytes:
        time.sleep(0.01)
        return b""

    def answered(self, lost: float) -> None: ...

    def close(self) -> None: ...

    def pack(self, message: Any, system: int = 1, component: int = 1) -> bytes:
        self.writer.srcSystem, self.writer.srcComponent = system, component
        data = bytes(message.pack(self.writer))
        self.writer.seq = (self.writer.seq + 1) % 256
        return data

    def say(self, message: Any, system: int = 1, component: int = 1) -> None:
        self.hear(self.pack(message, system, component))

    # What it says

    @property
    def boot_ms(self) -> int:
        return round(1000 * (self.clock() - self.booted))

    def heartbeat(self) -> None:
        armed = dialect.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0
        self.say(dialect.MAVLink_heartbeat_message(12, 3, 1 | armed, self.mode, self.state, 3))

    def attitude(self, yaw: float = 0.0, roll: float = 0.0, pitch: float = 0.0) -> None:
        self.say(dialect.MAVLink_attitude_message(self.boot_ms, roll, pitch, yaw, 0.0, 0.0, 0.0))

    def pressure(self, hpa: float) -> None:
        self.say(dialect.MAVLink_scaled_pressure2_message(self.boot_ms, hpa, 0.0, 2000))

    def imu(self, acc: tuple[int, int, int], gyro: tuple[int, int, int] = (0, 0, 0)) -> None:
        self.say(dialect.MAVLink_raw_imu_message(1000 * self.boot_ms, *acc, *gyro, 0, 0, 0))

    def status(self, volts: float = 15.8) -> None:
        numbers = 0, 0, 0, 0, round(1000 * volts), -1, 62, 0, 0, 0, 0, 0, 0
        self.say(dialect.MAVLink_sys_status_message(*numbers))

    def named(self, name: str, value: float) -> None:
        self.say(dialect.MAVLink_named_value_float_message(self.boot_ms, name.encode(), value))

    # How it answers

    def answer(self, message: Any) -> None:
        kind = message.get_type()
        if self.deaf[kind] > 0:
            self.deaf[kind] -= 1
            return
        if kind == "COMMAND_LONG":
            result = self.results.get(message.command, 0)
            if self.why:
                self.say(dialect.MAVLink_statustext_message(2, self.why.encode()))
            self.say(dialect.MAVLink_command_ack_message(message.command, result))
            if result == 0:
                self.obey(message)
        elif kind == "PARAM_REQUEST_READ" and message.param_id in self.parameters:
            self.value(message.param_id)
        elif kind == "PARAM_SET" and message.param_id in self.parameters:
            if message.param_id != self.stuck:
                self.parameters[message.param_id] = message.param_value
            self.value(message.param_id)
        elif kind == "TIMESYNC" and message.tc1 == 0:
            self.say(dialect.MAVLink_timesync_message(self.boot_ms * 1_000_000 + 1, message.ts1))
        elif kind == "MANUAL_CONTROL":
            pressed = message.buttons & ~self.buttons
            self.buttons = message.buttons
            if pressed & 1 << 14 or pressed & 1 << 13:
                step = 0.125 if pressed & 1 << 14 else -0.125
                self.lights = min(1.0, max(0.0, self.lights + step))
                self.named("Lights1", self.lights)

    def value(self, name: str) -> None:
        self.say(dialect.MAVLink_param_value_message(name.encode(), self.parameters[name], 9, 900, 7))

    def obey(self, message: Any) -> None:
        if message.command == dialect.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 == 1.0
            self.heartbeat()
        elif message.command == dialect.MAV_CMD_DO_SET_MODE:
            self.mode = int(message.param2)
            self.heartbeat()
        elif message.command == dialect.MAV_CMD_REQUEST_MESSAGE:
            self.say(
                dialect.MAVLink_autopilot_version_message(
                    0, 4 << 24 | 5 << 16 | 6 << 8, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0
                )
            )
        elif message.command == dialect.MAV_CMD_DO_MOUNT_CONTROL:
            self.tilt = message.param1
            if self.tilt_reported:
                self.say(dialect.MAVLink_mount_status_message(255, 190, round(100 * self.tilt), 0, 0))

    # What a test asks of it

    def heard(self, kind: str) -> list[Any]:
        return [message for _, message in self.sent if message.get_type() == kind]

    def moves(self) -> list[Any]:
        return self.heard("MANUAL_CONTROL") + self.heard("SET_POSITION_TARGET_LOCAL_NED")


def is_neutral(message: Any) -> bool:
    if message.get_type() == "MANUAL_CONTROL":
        return (message.x, message.y, message.z, message.r) == (0, 0, 500, 0)
    if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
        assert message.type_mask == 0x5C7
        assert message.coordinate_frame == 8
        return (message.vx, message.vy, message.vz, message.yaw_rate) == (0.0, 0.0, 0.0, 0.0)
    return True


class Dive:
    """A link, its vehicle, and the clock of both."""

    def __init__(self, **options: Any) -> None:
        self.clock = Clock()
        self.vehicle = Vehicle(self.clock)
        self.delivered: list[Any] = []
        self.tapped: list[tuple[float, str, bool, Any]] = []
        self.link = Link(
            self.vehicle,
            now=self.clock,
            deliver=self.delivered.append,
            tap=lambda *record: self.tapped.append(record),
            rates=options.pop("rates", NO_MESSAGES),
            retry=0.01,
            **options,
        )
        self.vehicle.hear = self.link.receive

    def run(self, seconds: float, *, alive: bool = True, heartbeat: bool = True) -> None:
        """Beat as the sending thread does; the vehicle's heartbeat comes five times a second."""
        end = self.clock.time + seconds
        beats = 0
        while self.clock.time < end - 1e-9:
            if alive:
                self.link.operator_alive()
            if heartbeat and beats % 4 == 0:
                self.vehicle.heartbeat()
            pause = self.link.beat()
            assert pause > 0.0
            self.clock.time = min(end, self.clock.time + min(pause, PERIOD))
            beats += 1

    def armed(self, mode: str = "ALT_HOLD") -> Dive:
        self.vehicle.heartbeat()
        self.link.connect(0.1)
        self.link.set_mode(mode)
        self.link.arm()
        self.vehicle.sent.clear()
        return self


@pytest.fixture
def dive() -> Dive:
    return Dive()


# Motion


def test_nothing_is_sent_before_arming(dive: Dive) -> None:
    dive.vehicle.heartbeat()
    dive.link.connect(0.1)
    dive.link.command(AHEAD, dive.clock() + 0.4)
    dive.run(1.0)
    dive.link.stop()
    assert dive.vehicle.moves() == []
    assert dive.vehicle.heard("HEARTBEAT")


def test_sticks_are_neutral_before_the_vehicle_arms(dive: Dive) -> None:
    dive.vehicle.heartbeat()
    dive.link.arm()
    kinds = [message.get_type() for _, message in dive.vehicle.sent]
    assert kinds.index("MANUAL_CONTROL") < kinds.index("COMMAND_LONG")
    assert all(map(is_neutral, dive.vehicle.moves()))
    assert dive.link.engaged


def test_a_vehicle_that_somebody_else_armed_does_not_move(dive: Dive) -> None:
    dive.vehicle.armed = True
    dive.vehicle.heartbeat()
    dive.link.connect(0.1)
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.run(0.5)
    assert not dive.link.engaged
    assert dive.vehicle.moves() == []


def test_who_somebody_else_armed_is_not_touched(dive: Dive) -> None:
    dive.vehicle.armed = True
    dive.vehicle.heartbeat()
    dive.link.connect(0.1)
    checks = dive.link.check_parameters()
    assert any(not check.ok for check in checks)
    assert "armed, and not by this link. Somebody else drives: have it disarmed" in dive.link.busy
    for touch in (
        dive.link.arm,
        lambda: dive.link.correct(checks),
        lambda: dive.link.set_param("FS_LEAK_ENABLE", 2.0),
        lambda: dive.link.set_lights(0.5),
        lambda: dive.link.tilt_camera(-0.5),
    ):
        with pytest.raises(Refused, match="expected a vehicle that nobody else drives, got: it is armed"):
            touch()
    dive.run(2.0)
    assert dive.vehicle.parameters == PARAMETERS
    # Its own station may be lost: a heartbeat of ours would hide that from its failsafe.
    assert {message.get_type() for _, message in dive.vehicle.sent} == {
        "COMMAND_LONG",
        "PARAM_REQUEST_READ",
        "TIMESYNC",
    }
    assert {m.command for m in dive.vehicle.heard("COMMAND_LONG")} == {
        dialect.MAV_CMD_REQUEST_MESSAGE,
    }


def test_busy_is_who_else_is_there(dive: Dive) -> None:
    dive.armed()
    assert dive.link.busy == ""
    with pytest.raises(Refused, match="expected a disarmed vehicle, got one that this link armed"):
        dive.link.arm()
    dive.link.disarm()
    assert dive.link.busy == ""
    dive.vehicle.mode = 19
    dive.vehicle.heartbeat()
    assert dive.link.busy.startswith("mode MANUAL instead of ALT_HOLD, which nobody here asked for")
    assert "begin anew" in dive.link.busy
    with pytest.raises(Refused, match="mode MANUAL"):
        dive.link.arm()
    dive.link.resume()
    assert dive.link.busy == ""
    dive.vehicle.say(rivals()[0], 255, 200)
    assert dive.link.busy == dive.link.rival
    with pytest.raises(Refused, match="another station uses our system id"):
        dive.link.set_param("FS_PILOT_INPUT", 2.0)


def test_an_order_is_repeated_at_20_hz_until_it_expires_and_neutral_follows(dive: Dive) -> None:
    dive.armed()
    start = dive.clock()
    assert dive.link.command(AHEAD, start + 0.27) == start + 0.27
    dive.run(1.0)
    sticks = [(t - start, m) for t, m in dive.vehicle.sent if m.get_type() == "MANUAL_CONTROL"]
    moving = [t for t, m in sticks if not is_neutral(m)]
    assert len(moving) == 6
    assert max(moving) < 0.27
    after = [t for t, m in sticks if is_neutral(m)]
    assert after[0] == pytest.approx(0.27)  # not at the next turn: at once
    assert len(after) >= 12
    assert np.diff([t for t, _ in sticks]).max() <= PERIOD + 1e-9
    assert {(m.x, m.r) for t, m in sticks if t < 0.26} == {(400, -100)}


def test_an_expiry_far_ahead_is_cut(dive: Dive) -> None:
    dive.armed()
    start = dive.clock()
    assert dive.link.command(AHEAD, start + 60.0) == start + LONGEST
    dive.run(1.0)
    moving = [t for t, m in dive.vehicle.sent if not is_neutral(m)]
    assert moving
    assert max(moving) < start + LONGEST


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["command", "pilot", "stop", "velocity", "mode", "rival", "disarm", "resume"]),
            st.floats(-0.2, 1.0),
            st.floats(0.0, 0.7),
        ),
        max_size=12,
    )
)
def test_never_a_motion_without_a_valid_order_of_an_armed_vehicle(
    script: list[tuple[str, float, float]],
) -> None:
    dive = Dive().armed()
    link, vehicle, clock = dive.link, dive.vehicle, dive.clock
    valid = -math.inf
    for what, ahead, wait in script:
        if what in ("command", "velocity"):
            order = AHEAD if what == "command" else FASTER
            valid = max(valid, link.command(order, clock() + ahead))
        elif what == "pilot":
            valid = max(valid, link.pilot(Sticks(y=-300), clock() + ahead))
        elif what == "stop":
            link.stop()
            valid = -math.inf
        elif what == "mode":
            vehicle.mode = 4 if vehicle.mode == 2 else 2
            vehicle.heartbeat()
        elif what == "rival":
            vehicle.say(dialect.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0), system=255)
        elif what == "disarm":
            vehicle.armed = False
            vehicle.heartbeat()
        else:
            link.resume()
        quiet = bool(link.yielding)
        vehicle.sent.clear()
        dive.run(wait)
        for when, message in vehicle.sent:
            if not is_neutral(message):
                assert when < valid
                assert link.engaged
                assert not quiet
        if quiet:
            assert vehicle.moves() == []
            valid = -math.inf


def test_stop_sends_neutral_at_once(dive: Dive) -> None:
    dive.armed()
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.run(0.1)
    dive.vehicle.sent.clear()
    dive.link.stop()
    assert [is_neutral(m) for m in dive.vehicle.moves()] == [True]
    dive.run(0.3)
    assert all(map(is_neutral, dive.vehicle.moves()))


def test_in_guided_a_velocity_goes_out_and_stopping_clears_the_yaw_rate(dive: Dive) -> None:
    dive.armed("GUIDED")
    start = dive.clock()
    dive.link.command(FASTER, start + 0.2)
    dive.run(0.6)
    targets = [(t, m) for t, m in dive.vehicle.sent if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
    moving = [m for t, m in targets if t < start + 0.2]
    assert moving
    first = moving[0]
    assert (first.vx, first.vy, first.vz, first.yaw_rate) == pytest.approx((0.3, -0.1, 0.05, -0.4))
    assert (first.target_system, first.target_component) == (1, 1)
    still = [m for t, m in targets if t >= start + 0.2]
    assert len(still) > 5
    assert all(map(is_neutral, still))
    # The pilot's time-out acts in GUIDED, too: sticks at neutral go out beside the velocity.
    assert all(map(is_neutral, dive.vehicle.heard("MANUAL_CONTROL")))
    assert len(dive.vehicle.heard("MANUAL_CONTROL")) >= len(targets) - 1


def test_leaving_guided_first_clears_velocity_and_yaw_rate(dive: Dive) -> None:
    dive.armed("GUIDED")
    dive.link.command(FASTER, dive.clock() + 0.5)
    dive.run(0.1)
    dive.vehicle.sent.clear()
    dive.link.set_mode("ALT_HOLD")
    kinds = [m.get_type() for _, m in dive.vehicle.sent]
    assert kinds.index("SET_POSITION_TARGET_LOCAL_NED") < kinds.index("COMMAND_LONG")
    assert all(map(is_neutral, dive.vehicle.moves()))


def test_sticks_are_no_order_in_guided_nor_a_velocity_elsewhere() -> None:
    motion = ExpiringOrders()
    motion.command(FASTER, 0.4, 0.0)
    assert motion.due(0.1, guided=True) == (NEUTRAL, FASTER)
    assert motion.due(0.1, guided=False) == (NEUTRAL, None)
    motion.command(AHEAD, 0.4, 0.0)
    assert motion.due(0.1, guided=True) == (NEUTRAL, STILL)
    assert motion.due(0.1, guided=False) == (AHEAD, None)
    assert motion.due(0.4, guided=False) == (NEUTRAL, None)


def test_a_person_outranks_the_mission_as_long_as_renewed(dive: Dive) -> None:
    dive.armed()
    person = Sticks(y=500)
    for _ in range(10):
        dive.link.command(AHEAD, dive.clock() + 0.5)
        dive.link.pilot(person, dive.clock() + 0.15)
        dive.run(0.1)
    assert {(m.x, m.y) for m in dive.vehicle.heard("MANUAL_CONTROL")} == {(0, 500)}
    dive.vehicle.sent.clear()
    dive.run(0.3)
    assert (400, 0) in {(m.x, m.y) for m in dive.vehicle.heard("MANUAL_CONTROL")}


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_orders_that_are_none_are_refused_and_the_last_one_holds(dive: Dive, bad: float) -> None:
    dive.armed()
    dive.link.command(AHEAD, dive.clock() + 0.3)
    with pytest.raises(ValueError, match="expires"):
        dive.link.command(AHEAD, bad)
    with pytest.raises(ValueError, match="velocity"):
        dive.link.command(BodyVelocity(bad, 0.0, 0.0, 0.0), dive.clock() + 0.3)
    with pytest.raises(ValueError, match="velocity"):
        dive.link.command(BodyVelocity(0.0, 0.0, 0.0, 50.0), dive.clock() + 0.3)
    dive.run(0.1)
    assert {m.x for m in dive.vehicle.heard("MANUAL_CONTROL")} == {400}


def test_a_vehicle_that_is_not_heard_is_not_driven(dive: Dive) -> None:
    dive.armed()
    for _ in range(30):
        dive.link.command(AHEAD, dive.clock() + 0.4)
        dive.run(0.2, heartbeat=False)
    assert not dive.link.connected
    late = [m for t, m in dive.vehicle.sent if t > dive.clock() - 6.0 + LOST + 0.1]
    assert late
    assert all(map(is_neutral, late))


# Signs of life


def test_the_heartbeat_goes_at_1_hz_and_stops_when_it_is_not_renewed(dive: Dive) -> None:
    dive.armed()
    dive.run(5.0)
    assert 4 <= len(dive.vehicle.heard("HEARTBEAT")) <= 6
    dive.vehicle.sent.clear()
    dive.link.command(AHEAD, dive.clock() + 0.5)
    silent = dive.clock() + LIFELINE
    dive.run(10.0, alive=False)
    times = [t for t, _ in dive.vehicle.sent]
    assert times
    # Sticks refresh the same failsafe as heartbeats: they must end, too.
    assert max(times) <= silent + 1e-9
    dive.vehicle.sent.clear()
    dive.link.stop()  # but whoever says so stops it
    assert [is_neutral(m) for m in dive.vehicle.moves()] == [True]
    dive.run(1.2)
    assert dive.vehicle.heard("MANUAL_CONTROL")[-1].x == 0


def test_a_heartbeat_of_ours_is_that_of_a_ground_station(dive: Dive) -> None:
    dive.run(0.2)
    heartbeat = dive.vehicle.heard("HEARTBEAT")[0]
    assert (heartbeat.type, heartbeat.autopilot) == (dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID)
    assert (heartbeat.get_srcSystem(), heartbeat.get_srcComponent()) == (255, 190)


# Others


def rivals() -> list[Any]:
    return [
        dialect.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0),
        dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3),
        dialect.MAVLink_rc_channels_override_message(1, 1, *[1500] * 8),
        dialect.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0),
        dialect.MAVLink_set_mode_message(1, 1, 0),
    ]


@pytest.mark.parametrize("message", rivals(), ids=lambda m: m.get_type())
def test_another_station_with_our_id_is_left_the_vehicle(dive: Dive, message: Any) -> None:
    dive.armed()
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.vehicle.say(message, system=255, component=191)
    assert message.get_type() in dive.link.rival
    dive.run(0.2)
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.link.stop()
    dive.run(0.5)
    assert dive.vehicle.moves() == []
    with pytest.raises(RuntimeError, match="station"):
        dive.link.arm()
    dive.link.resume()
    assert dive.link.yielding == ""
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.run(0.2)
    assert dive.vehicle.heard("MANUAL_CONTROL")[-1].x == 400


def test_our_own_messages_sent_back_are_no_rival(dive: Dive) -> None:
    dive.armed()
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.run(0.3)
    for _, message in list(dive.vehicle.sent):
        dive.link.receive(bytes(message.get_msgbuf()))
    assert dive.link.rival == ""
    assert dive.link.refused["our own, sent back"] == len(dive.vehicle.sent)


def test_a_mode_that_nobody_asked_for_makes_it_yield(dive: Dive) -> None:
    dive.armed()
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.vehicle.mode = 19
    dive.run(0.4)
    assert "MANUAL" in dive.link.mode_changed_by_other
    dive.vehicle.sent.clear()
    dive.run(0.5)
    assert dive.vehicle.moves() == []
    dive.link.resume()
    dive.run(0.3)
    assert dive.vehicle.moves()
    assert all(map(is_neutral, dive.vehicle.moves()))


def test_on_its_way_up_the_vehicle_keeps_neutral_sticks(dive: Dive) -> None:
    # SURFACE is what a leak makes of it; without a pilot's sticks it would disarm under way.
    dive.armed()
    dive.vehicle.mode = 9
    dive.run(0.5)
    dive.vehicle.sent.clear()
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.run(0.5)
    assert dive.link.mode_changed_by_other
    assert dive.vehicle.heard("MANUAL_CONTROL")
    assert all(map(is_neutral, dive.vehicle.moves()))
    dive.vehicle.say(rivals()[0], system=255)  # unless a rival gives them
    dive.vehicle.sent.clear()
    dive.run(0.5)
    assert dive.vehicle.moves() == []


@pytest.mark.parametrize(("up", "ours"), [(None, True), (-0.2, True), (-0.9, True), (-1.1, False)])
def test_a_surface_that_becomes_alt_hold_is_the_autopilots_own_doing_near_the_top(
    dive: Dive, up: float | None, ours: bool
) -> None:
    dive.armed()
    dive.link.set_mode("SURFACE")
    dive.run(20.0)  # it may take long
    if up is not None:
        dive.vehicle.say(own_altitude(up))
    dive.vehicle.mode = 2
    dive.run(0.5)
    assert (dive.link.yielding == "") == ours
    # It is once: what comes after it is somebody's.
    dive.vehicle.mode = 9
    dive.run(0.5)
    assert "SURFACE instead of ALT_HOLD" in dive.link.yielding or not ours


def test_a_surface_that_ends_before_it_ever_showed_is_ours_too(dive: Dive) -> None:
    dive.armed("MANUAL")
    obey = dive.vehicle.obey

    def surfaced(message: Any) -> None:
        message.param2 = 2.0 if message.param2 == 9.0 else message.param2
        obey(message)

    dive.vehicle.obey = surfaced  # type: ignore[method-assign]
    dive.link.set_mode("SURFACE")
    dive.run(1.0)
    assert dive.link.telemetry.mode == "ALT_HOLD"
    assert dive.link.yielding == ""


def test_a_failsafe_that_brings_it_up_is_told_and_is_nobody_else(dive: Dive) -> None:
    dive.armed()
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.vehicle.say(dialect.MAVLink_statustext_message(2, b"Leak Detected"))
    dive.vehicle.mode, dive.vehicle.state = 9, dialect.MAV_STATE_CRITICAL
    dive.vehicle.heartbeat()
    assert dive.link.yielding == ""
    assert dive.link.engaged
    assert 'a failsafe of the vehicle brings it up. It said: "Leak Detected"' in dive.link.surfacing
    dive.vehicle.sent.clear()
    dive.run(0.3)
    assert dive.vehicle.moves()
    assert all(map(is_neutral, dive.vehicle.moves()))
    # At the top it ends by itself, and is still ours to disarm.
    dive.vehicle.say(own_altitude(-0.1))
    dive.vehicle.mode = 2
    dive.run(0.5)
    assert dive.link.yielding == ""


def test_modes_that_we_ask_for_are_ours(dive: Dive) -> None:
    dive.armed()
    for mode in ("GUIDED", "ALT_HOLD", "POSHOLD"):
        dive.link.set_mode(mode)
        dive.run(0.5)
        assert dive.link.yielding == ""
        assert dive.link.telemetry.mode == mode


@pytest.mark.parametrize(
    ("words", "ours"),
    [
        (b"Lost manual control", True),
        (b"MYGCS: 255, heartbeat lost", True),
        (b"MYGCS: 7, heartbeat lost", True),
        (b"Leak Detected", False),
        (b"Internal pressure critical", False),
    ],
)
def test_a_vehicle_that_hears_nothing_of_us_is_told_in_words_for_its_owner(
    words: bytes, ours: bool, dive: Dive
) -> None:
    dive.armed()
    dive.vehicle.say(dialect.MAVLink_statustext_message(2, words))
    dive.vehicle.armed = False
    dive.vehicle.heartbeat()
    assert f'It said: "{words.decode()}"' in dive.link.armed_by_other
    assert dive.link.armed_by_other.endswith("this computer, or the link, did not keep up") == ours


def test_a_disarm_that_nobody_asked_for_ends_it(dive: Dive) -> None:
    dive.armed()
    dive.vehicle.say(dialect.MAVLink_statustext_message(2, b"Lost manual control"))
    dive.vehicle.armed = False
    dive.vehicle.heartbeat()
    assert "disarmed" in dive.link.armed_by_other
    assert "Lost manual control" in dive.link.armed_by_other
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.run(0.5)
    assert dive.vehicle.moves() == []
    dive.link.resume()
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.run(0.5)
    assert all(map(is_neutral, dive.vehicle.moves()))


def test_a_heartbeat_that_comes_late_or_twice_changes_nothing(dive: Dive) -> None:
    dive.vehicle.heartbeat()
    old = dive.vehicle.pack(dialect.MAVLink_heartbeat_message(12, 3, 1, 19, 4, 3))
    dive.armed()
    dive.link.receive(old)
    assert dive.link.yielding == ""
    assert dive.link.telemetry.armed
    assert dive.link.refused["HEARTBEAT: repeated or overtaken"] == 1


def test_a_heartbeat_that_other_messages_overtook_is_news(dive: Dive) -> None:
    dive.vehicle.heartbeat()
    held = dive.vehicle.pack(dialect.MAVLink_heartbeat_message(12, 3, 1, 2, 4, 3))
    for _ in range(100):
        dive.vehicle.say(dialect.MAVLink_system_time_message(0, dive.vehicle.boot_ms))
    dive.clock.time += 2.0
    assert dive.link.age >= 2.0
    dive.link.receive(held)
    assert dive.link.age == 0.0
    assert dive.link.refused == {}


def test_other_systems_and_components_are_counted_and_not_believed(dive: Dive) -> None:
    dive.armed()
    before = dive.link.telemetry.mode
    dive.vehicle.say(dialect.MAVLink_heartbeat_message(12, 3, 128, 19, 4, 3), system=2)
    dive.vehicle.say(dialect.MAVLink_heartbeat_message(18, 8, 128, 19, 4, 3), component=194)
    dive.vehicle.say(dialect.MAVLink_heartbeat_message(2, 3, 128, 19, 4, 3))
    assert dive.link.telemetry.mode == before
    assert dive.link.refused["from system 2"] == 1
    assert dive.link.refused["from component 194"] == 1
    assert dive.link.refused["heartbeat: not of an ArduSub"] == 1


def test_a_reboot_ends_our_arming(dive: Dive) -> None:
    dive.armed()
    dive.run(1.0)
    dive.vehicle.attitude()
    dive.vehicle.booted = dive.clock() - 0.5
    dive.vehicle.attitude()
    assert dive.link.telemetry.reboots == 0  # one packet may have come late
    dive.clock.time += 0.1
    dive.vehicle.attitude(yaw=0.1)
    assert dive.link.telemetry.reboots == 1
    assert not dive.link.engaged
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.vehicle.sent.clear()
    dive.run(0.3)
    assert all(map(is_neutral, dive.vehicle.moves()))
    assert abs(dive.delivered[-1].time - (dive.clock() - 0.3)) < 0.01


def test_after_a_reboot_messages_are_asked_for_again() -> None:
    dive = Dive(rates={"ATTITUDE": 20.0})
    dive.vehicle.heartbeat()
    dive.link.connect(0.1)
    dive.vehicle.attitude()
    dive.vehicle.booted = dive.clock()
    for _ in range(2):
        dive.clock.time += 0.1
        dive.vehicle.attitude()
    dive.vehicle.sent.clear()
    dive.run(2.5)
    asked = [m for m in dive.vehicle.heard("COMMAND_LONG") if m.command == 511]
    assert [(m.param1, m.param2) for m in asked] == [(30.0, 50000.0)]


# Measurements


def test_at_rest_and_level_the_specific_force_is_g_up(dive: Dive) -> None:
    dive.vehicle.imu((0, 0, -1000))
    (imu,) = dive.delivered
    assert isinstance(imu, Imu)
    assert np.allclose(imu.specific_force, [0.0, 0.0, 9.80665])
    assert imu.time == pytest.approx(100.0)


def test_imu_by_hand(dive: Dive) -> None:
    dive.vehicle.imu((100, 200, -900), (10, -20, 500))
    imu = dive.delivered[0]
    assert np.allclose(imu.specific_force, [0.980665, -1.96133, 8.825985])
    assert np.allclose(imu.angular_velocity, [0.01, 0.02, -0.5])


def test_scaled_imu2_is_the_same() -> None:
    dive = Dive(imu_from="SCALED_IMU2")
    dive.vehicle.imu((0, 0, -1000))
    dive.vehicle.say(dialect.MAVLink_scaled_imu2_message(10000, 0, 0, -1000, 0, 0, 250, 0, 0, 0))
    (imu,) = dive.delivered
    assert np.allclose(imu.specific_force, [0.0, 0.0, 9.80665])
    assert np.allclose(imu.angular_velocity, [0.0, 0.0, -0.25])


@given(st.floats(-math.pi, math.pi), st.floats(-3.0, 3.0), st.floats(-1.5, 1.5))
def test_headings_agree_whichever_message_brings_them(yaw_ned: float, roll: float, pitch: float) -> None:
    one, two = Dive(), Dive(heading_from="ATTITUDE_QUATERNION")
    one.vehicle.attitude(yaw_ned, roll, pitch)
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw_ned / 2), math.sin(yaw_ned / 2)
    q = (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    two.vehicle.say(dialect.MAVLink_attitude_quaternion_message(10000, *q, 0.0, 0.0, 0.0))
    a, b = one.delivered[0], two.delivered[0]
    assert isinstance(a, Heading)
    assert abs(wrap_angle(a.yaw - b.yaw)) < 1e-5
    assert abs(wrap_angle(a.yaw - (math.pi / 2 - yaw_ned))) < 1e-6
    assert a.sigma == HEADING_SIGMA


def test_heading_by_hand(dive: Dive) -> None:
    dive.vehicle.attitude(yaw=math.radians(90.0), pitch=0.1, roll=0.2)  # compass east
    assert dive.delivered[0].yaw == pytest.approx(0.0, abs=1e-7)
    attitude = dive.link.telemetry.attitude
    assert attitude is not None
    assert attitude.pitch == pytest.approx(-0.1)  # nose up about the axis to the left is negative
    assert attitude.roll == pytest.approx(0.2)


def test_depth_by_hand() -> None:
    dive = Dive(density=SEA, surface_pressure=1013.25)
    dive.vehicle.pressure(1013.25 + SEA * GRAVITY * 2.0 / 100.0)
    (depth,) = dive.delivered
    assert isinstance(depth, Depth)
    assert depth.z == pytest.approx(-2.0, abs=1e-5)
    assert dive.link.telemetry.depth == pytest.approx(2.0, abs=1e-5)


def test_depth_waits_for_the_pressure_at_the_surface(dive: Dive) -> None:
    with pytest.raises(RuntimeError, match="5 readings"):
        dive.link.zero_depth()
    for k in range(10):
        dive.clock.time += 0.05
        dive.vehicle.pressure(1000.0 + 0.1 * (k % 3))
    assert dive.delivered == []
    assert dive.link.zero_depth() == pytest.approx(1000.1)
    dive.clock.time += 0.05
    dive.vehicle.pressure(1000.1 + 997.0 * GRAVITY / 100.0)
    assert dive.delivered[0].z == pytest.approx(-1.0, abs=1e-4)
    dive.clock.time += 0.05
    dive.vehicle.pressure(1100.0)
    with pytest.raises(RuntimeError, match="float still"):
        dive.link.zero_depth()


def test_stamps_are_mapped_onto_the_dives_clock(dive: Dive) -> None:
    rng = np.random.default_rng(3)
    for _ in range(400):
        truth = dive.clock.time
        stamp = dive.vehicle.boot_ms
        dive.clock.time += 0.003 + rng.exponential(0.01)
        dive.vehicle.say(dialect.MAVLink_attitude_message(stamp, 0, 0, 0.0, 0, 0, 0))
        dive.clock.time = max(dive.clock.time, truth + 0.02)
        if dive.delivered:
            assert dive.delivered[-1].time <= dive.clock.time
    times = np.array([m.time for m in dive.delivered])
    assert (np.diff(times) > 0.0).all()
    assert np.std(np.diff(times)[50:]) < 0.02
    assert dive.link.telemetry.jitter < 0.05


def test_round_trips_take_half_of_a_constant_way_out() -> None:
    dive = Dive()
    dive.armed()
    delays = 0.04

    def later(data: bytes) -> None:
        dive.clock.time += delays
        dive.link.receive(data)

    for _ in range(10):
        dive.vehicle.hear = later
        stamp = dive.clock.time
        dive.vehicle.attitude()
        lateness = dive.delivered[-1].time - stamp
        dive.vehicle.hear = dive.link.receive
        dive.run(0.3)
    assert lateness < 0.012


@pytest.mark.parametrize("slip", [0.3, -0.3])
def test_a_clock_of_the_autopilot_that_is_set_is_told_at_the_next_round_trip_and_for_a_while(
    dive: Dive, slip: float
) -> None:
    dive.armed()
    for _ in range(4):
        dive.vehicle.attitude()
        dive.run(1.0)
    assert dive.link.telemetry.slipped == ""
    dive.vehicle.booted -= slip
    dive.run(1.1)
    assert dive.link.telemetry.slipped == f"the autopilot's clock slipped by {slip:+.2f} s"
    # What it measures now is of now.
    dive.vehicle.attitude(yaw=0.2)
    assert dive.delivered[-1].time == pytest.approx(dive.clock(), abs=0.01)
    dive.run(SLIPPED)
    assert dive.link.telemetry.slipped == ""


def test_what_repeats_or_is_overtaken_is_delivered_once(dive: Dive) -> None:
    data = dive.vehicle.pack(dialect.MAVLink_attitude_message(10000, 0, 0, 0, 0, 0, 0))
    older = dive.vehicle.pack(dialect.MAVLink_attitude_message(9990, 0, 0, 0, 0, 0, 0))
    for packet in (data, data, older):
        dive.link.receive(packet)
    assert len(dive.delivered) == 1
    assert dive.link.refused["ATTITUDE: repeated or overtaken"] == 2


# Rubbish


def test_garbage_truncation_and_wrong_checksums_do_no_harm(dive: Dive) -> None:
    good = dive.vehicle.pack(dialect.MAVLink_raw_imu_message(1, 0, 0, -1000, 0, 0, 0, 0, 0, 0))
    bad = bytearray(good)
    bad[-1] ^= 0xFF
    for packet in (
        b"\x00\x01garbage",
        b"\xfd",
        good[:9],
        good[:-3],
        bytes(bad),
        b"\xfd" * 300,
        b"\xfe\xff\x00",
    ):
        dive.link.receive(packet)
    assert dive.delivered == []
    dive.link.receive(b"\x00\x01\x02" + good)
    assert len(dive.delivered) == 1
    assert dive.link.refused["wrong checksum"] == 1
    assert dive.link.refused["truncated packet"] >= 3


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=400))
def test_no_bytes_raise(data: bytes) -> None:
    dive = Dive()
    dive.link.receive(data)
    dive.link.receive(b"\xfd" + data)
    dive.vehicle.imu((0, 0, -1000))
    assert len(dive.delivered) == 1


def own_altitude(up: float) -> Any:
    return dialect.MAVLink_global_position_int_message(1, 0, 0, 437_000, round(1000 * up), 0, 0, 0, 0)


def own_place(up: float) -> Any:
    return dialect.MAVLink_local_position_ned_message(1, 0.0, 0.0, -up, 0.0, 0.0, 0.0)


def pulses(*driven: int, port: int = 0) -> Any:
    return dialect.MAVLink_servo_output_raw_message(0, port, *driven, *[0] * (8 - len(driven)))


def strange() -> list[tuple[str, Any]]:
    nan, huge = math.nan, 1e30
    d = dialect
    return [
        ("attitude", d.MAVLink_attitude_message(1, nan, 0.0, 0.0, 0.0, 0.0, 0.0)),
        ("attitude", d.MAVLink_attitude_message(1, 0.0, 0.0, huge, 0.0, 0.0, 0.0)),
        ("attitude", d.MAVLink_attitude_quaternion_message(1, nan, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        ("attitude", d.MAVLink_attitude_quaternion_message(1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        ("pressure", d.MAVLink_scaled_pressure2_message(1, nan, 0.0, 0)),
        ("pressure", d.MAVLink_scaled_pressure2_message(1, 0.0, 0.0, 0)),
        ("pressure", d.MAVLink_scaled_pressure2_message(1, huge, 0.0, 0)),
        ("own altitude", own_altitude(501.0)),
        ("own altitude", own_altitude(-2e6)),
        ("own altitude", own_place(nan)),
        ("own altitude", own_place(-huge)),
        ("servo output", pulses(1500, 2201)),
        ("servo output", pulses(799)),
        ("imu: force", d.MAVLink_raw_imu_message(1, 32767, 0, 0, 0, 0, 0, 0, 0, 0)),
        ("imu: turn rate", d.MAVLink_raw_imu_message(1, 0, 0, -1000, 0, 0, 32767, 0, 0, 0)),
        ("camera tilt", d.MAVLink_mount_orientation_message(1, 0.0, nan, 0.0)),
        ("camera tilt", d.MAVLink_gimbal_device_attitude_status_message(0, 0, 1, 0, [nan] * 4, 0, 0, 0, 0)),
        ("named value", d.MAVLink_named_value_float_message(1, b"PilotGain", nan)),
    ]


@pytest.mark.parametrize(("reason", "message"), strange())
def test_numbers_that_cannot_be_are_refused(reason: str, message: Any) -> None:
    dive = Dive(surface_pressure=1000.0)
    before = repr(dive.link.telemetry)
    dive.vehicle.say(message)
    assert dive.delivered == []
    assert [r for r in dive.link.refused if r.startswith(reason)]
    assert repr(dive.link.telemetry).replace("reboots", "") == before.replace("reboots", "")


# Telemetry


def test_telemetry(dive: Dive) -> None:
    assert dive.link.telemetry.heartbeat_age == math.inf
    dive.armed()
    vehicle = dive.vehicle
    vehicle.status()
    vehicle.named("PilotGain", 0.75)
    vehicle.named("InputHold", 1.0)
    vehicle.imu((0, 0, -1000))
    dive.clock.time += 0.5
    telemetry = dive.link.telemetry
    assert (telemetry.mode, telemetry.armed) == ("ALT_HOLD", True)
    assert (telemetry.voltage, telemetry.battery) == (15.8, 0.62)
    assert (telemetry.pilot_gain, telemetry.input_hold) == (0.75, True)
    assert telemetry.version == "4.5.6"
    assert telemetry.imu_age == pytest.approx(0.5)
    assert telemetry.pressure_age == math.inf
    assert not telemetry.leak
    vehicle.say(dialect.MAVLink_statustext_message(1, b"Leak Detected"))
    assert dive.link.telemetry.leak
    assert dive.link.texts[-1][1:] == (1, "Leak Detected")


def test_the_autopilots_own_altitude_is_its_own(dive: Dive) -> None:
    dive.armed()
    assert math.isnan(dive.link.telemetry.own_altitude)
    assert dive.link.telemetry.own_altitude_age == math.inf
    # Heights above the sea are none: 0 for ever, or off by the altitude of the water.
    dive.vehicle.say(dialect.MAVLink_vfr_hud_message(0.0, 0.0, 0, 0, 437.0, 0.0))
    assert math.isnan(dive.link.telemetry.own_altitude)
    dive.vehicle.say(own_altitude(-1.25))
    dive.clock.time += 0.3
    assert dive.link.telemetry.own_altitude == -1.25
    assert dive.link.telemetry.own_altitude_age == pytest.approx(0.3)
    assert math.isnan(dive.link.telemetry.depth)


def test_its_position_tells_its_altitude_where_it_has_one_and_is_gone_after_a_second(dive: Dive) -> None:
    dive.armed()

    def told(message: Any) -> tuple[float, str]:
        dive.vehicle.say(message)
        telemetry = dive.link.telemetry
        return telemetry.own_altitude, telemetry.own_altitude_from

    assert told(own_altitude(-1.25)) == (-1.25, "GLOBAL_POSITION_INT")
    # With a position, `relative_alt` counts from above the sea: both come, and one alone is gone by.
    for _ in range(20):
        assert told(own_place(-1.5)) == (-1.5, "LOCAL_POSITION_NED")
        assert told(own_altitude(49.0)) == (-1.5, "LOCAL_POSITION_NED")
        dive.clock.time += LOCAL - 0.05
    assert told(own_altitude(49.0)) == (-1.5, "LOCAL_POSITION_NED")
    # What does not count does not keep it fresh.
    assert dive.link.telemetry.own_altitude_age == pytest.approx(LOCAL - 0.05)
    dive.clock.time += 0.1
    assert told(own_altitude(49.0)) == (49.0, "GLOBAL_POSITION_INT")
    assert told(own_place(-1.5)) == (-1.5, "LOCAL_POSITION_NED")


def test_an_autopilot_that_begins_anew_takes_its_zero_with_it(dive: Dive) -> None:
    dive.armed()
    boot = 500_000
    dive.vehicle.say(dialect.MAVLink_local_position_ned_message(boot, 0.0, 0.0, 1.5, 0.0, 0.0, 0.0))
    assert dive.link.telemetry.own_altitude == -1.5
    # Once may be a packet that came late.
    for k in range(2):
        assert dive.link.telemetry.reboots == 0
        dive.vehicle.say(dialect.MAVLink_attitude_message(10 + 20 * k, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    telemetry = dive.link.telemetry
    assert telemetry.reboots == 1
    assert math.isnan(telemetry.own_altitude)
    assert telemetry.own_altitude_age == math.inf
    # Nothing is left that would keep the other message out.
    dive.vehicle.say(dialect.MAVLink_global_position_int_message(60, 0, 0, 0, -700, 0, 0, 0, 0))
    telemetry = dive.link.telemetry
    assert (telemetry.own_altitude, telemetry.own_altitude_from) == (-0.7, "GLOBAL_POSITION_INT")


def test_its_thrust_is_that_of_the_hardest_working_thruster(dive: Dive) -> None:
    dive.armed()
    assert math.isnan(dive.link.telemetry.thrust)
    dive.vehicle.say(pulses(1500, 1700, 1200, 1500, 1500, 1500))
    # Lights and grippers are on the other port, or their channels say nothing.
    dive.vehicle.say(pulses(1900, 1900, port=1))
    assert dive.link.telemetry.thrust == 0.75
    dive.vehicle.status()
    dive.clock.time += 0.2
    assert dive.link.telemetry.status_age == pytest.approx(0.2)


def test_the_heartbeat_is_asked_for_at_5_hz_where_the_vehicle_allows_that() -> None:
    for result in (0, 3):
        dive = Dive(rates={"HEARTBEAT": RATES["HEARTBEAT"]})
        dive.vehicle.results[dialect.MAV_CMD_SET_MESSAGE_INTERVAL] = result
        dive.vehicle.heartbeat()
        dive.link.connect(0.1)
        asked = dive.vehicle.heard("COMMAND_LONG")[0]
        assert (asked.param1, asked.param2) == (dialect.MAVLINK_MSG_ID_HEARTBEAT, 200_000)


def test_the_stand_in_counts_altitude_from_a_zero_of_its_own(dive: Dive) -> None:
    conditions = Conditions(depth_zero=-0.4)
    tank = Tank(make_world("pool/arc", 1), conditions=conditions)
    sub = ArduSub(tank, lambda data, _: dive.link.receive(data))

    def swim(seconds: float) -> None:
        for _ in range(round(100.0 * seconds)):
            dive.clock.time += 0.01
            tank.advance(sub.commands)
            sub.beat()

    swim(2.0)
    truth = tank.state.position[2]
    assert dive.link.telemetry.own_altitude == pytest.approx(truth + 0.4, abs=0.05)


def test_a_leak_shows_in_the_sensors_health_too(dive: Dive) -> None:
    extended = dialect.MAV_SYS_STATUS_EXTENSION_USED
    leak = dialect.MAV_SYS_STATUS_SENSOR_LEAK
    status = dialect.MAVLink_sys_status_message
    seen = []
    for health in (leak, 0):
        dive.vehicle.say(status(extended, 0, 0, 0, 0, -1, -1, 0, 0, 0, 0, 0, 0, leak, leak, health))
        seen.append(dive.link.telemetry.leak)
    assert seen == [False, True]
    assert math.isnan(dive.link.telemetry.voltage)


def test_what_was_drawn_is_the_sum_of_volts_times_amperes_also_over_a_gap(dive: Dive) -> None:
    def tell(volts: float, amperes: float | None) -> float:
        current = -1 if amperes is None else round(100.0 * amperes)
        numbers = 0, 0, 0, 0, round(1000.0 * volts), current, 62, 0, 0, 0, 0, 0, 0
        dive.vehicle.say(dialect.MAVLink_sys_status_message(*numbers))
        return dive.link.telemetry.drawn_wh

    assert math.isnan(tell(15.0, None))
    assert tell(15.0, 4.0) == 0.0
    dive.clock.time += 60.0
    assert tell(15.0, 4.0) == pytest.approx(1.0)
    dive.clock.time += 60.0
    assert tell(15.0, None) == pytest.approx(1.0)
    dive.clock.time += 60.0
    assert tell(15.0, 8.0) == pytest.approx(1.0 + 15.0 * 6.0 * 120.0 / 3600.0)


def lasting(told: list[tuple[float, float]]) -> float:
    """The least voltage of which none was above it for `SAG` seconds on end, by all stretches of time; NaN
    without any. A longer one without a voltage is none."""
    least = math.inf
    for last, (end, _) in enumerate(told):
        for first in range(last + 1):
            stretch = told[first : last + 1]
            gaps = [later - earlier for (earlier, _), (later, _) in itertools.pairwise(stretch)]
            known = not any(math.isnan(volts) for _, volts in stretch) and all(gap <= SAG for gap in gaps)
            if known and end - stretch[0][0] >= SAG:
                least = min(least, max(volts for _, volts in stretch))
    return least if least < math.inf else math.nan


@given(
    st.lists(
        st.tuples(st.sampled_from([0.25, 0.5, 1.0, 3.0, 3.5]), st.sampled_from([13.5, 14.3, 16.0, math.nan])),
        max_size=24,
    )
)
def test_a_voltage_counts_once_it_has_lasted_whoever_asks(told: list[tuple[float, float]]) -> None:
    sag, now, heard, found = Sag(), 0.0, list[tuple[float, float]](), math.nan
    for wait, volts in told:
        now += wait
        heard.append((now, volts))
        found = sag(now, volts)
    assert found == pytest.approx(lasting(heard), nan_ok=True)


def test_a_moments_load_is_no_sag_and_one_that_lasted_is_not_forgotten(dive: Dive) -> None:
    def tell(volts: float, seconds: float) -> float:
        for _ in range(round(2.0 * seconds)):
            dive.clock.time += 0.5
            dive.vehicle.status(volts)
        return dive.link.telemetry.sagged

    assert math.isnan(tell(16.0, 1.0))
    assert tell(16.0, 5.0) == 16.0
    for _ in range(5):
        assert tell(13.0, SAG - 0.5) == 16.0
        assert tell(16.0, 0.5) == 16.0
    # With the load gone it recovers, and who asks then hears of it all the same.
    assert tell(14.3, SAG + 0.5) == 14.3
    assert tell(16.0, 10.0) == 14.3


def test_loss_is_counted_by_sequence_numbers(dive: Dive) -> None:
    for k in range(300):
        dive.clock.time += 0.01
        if k % 10 == 9:
            dive.vehicle.writer.seq = (dive.vehicle.writer.seq + 1) % 256  # one that never came
        data = dive.vehicle.pack(dialect.MAVLink_system_time_message(0, dive.vehicle.boot_ms))
        dive.link.receive(data)
        dive.link.receive(data)  # a second copy is no loss
    assert dive.link.telemetry.loss == pytest.approx(30 / 330, abs=1e-9)


def test_every_message_is_tapped(dive: Dive) -> None:
    dive.armed()
    sent = [m for _, channel, out, m in dive.tapped if out and channel == "mavlink"]
    came = [m for _, channel, out, m in dive.tapped if not out and channel == "mavlink"]
    assert {m.get_type() for m in sent} >= {"COMMAND_LONG", "MANUAL_CONTROL"}
    assert {m.get_type() for m in came} >= {"HEARTBEAT", "COMMAND_ACK"}


def test_a_log_that_fails_does_not_stop_the_motion(caplog: pytest.LogCaptureFixture) -> None:
    dive = Dive().armed("GUIDED")

    def full(*_: object) -> None:
        raise OSError("no space left on device")

    dive.link._tap = full
    dive.link.command(FASTER, dive.clock() + 0.3)
    dive.run(0.3)
    assert len(dive.vehicle.heard("MANUAL_CONTROL")) > 4
    assert len(dive.vehicle.heard("SET_POSITION_TARGET_LOCAL_NED")) > 4
    assert "not logged" in caplog.text


# Questions


def test_lost_questions_are_asked_three_times(dive: Dive) -> None:
    dive.vehicle.heartbeat()
    dive.vehicle.deaf["COMMAND_LONG"] = 2
    dive.link.arm()
    assert len(dive.vehicle.heard("COMMAND_LONG")) == 3
    dive.vehicle.deaf["COMMAND_LONG"] = 3
    with pytest.raises(TimeoutError, match=r"COMPONENT_ARM_DISARM.*3 tries"):
        dive.link.disarm()


def test_a_refusal_says_why(dive: Dive) -> None:
    dive.vehicle.heartbeat()
    dive.vehicle.results[dialect.MAV_CMD_COMPONENT_ARM_DISARM] = dialect.MAV_RESULT_FAILED
    dive.vehicle.why = "Arm: Check your compass"
    with pytest.raises(Refused, match=r"FAILED.*Check your compass"):
        dive.link.arm()
    assert not dive.link.engaged
    dive.vehicle.sent.clear()
    dive.run(0.3)
    assert dive.vehicle.moves() == []


def test_a_refused_mode_changes_nothing(dive: Dive) -> None:
    dive.armed()
    dive.vehicle.results[dialect.MAV_CMD_DO_SET_MODE] = dialect.MAV_RESULT_FAILED
    with pytest.raises(Refused, match="DO_SET_MODE"):
        dive.link.set_mode("GUIDED")
    with pytest.raises(ValueError, match="expected one of"):
        dive.link.set_mode("LOITER")
    dive.run(0.3)
    assert dive.link.yielding == ""
    assert dive.link.telemetry.mode == "ALT_HOLD"


def test_disarming_sends_neutral_first_and_nothing_after(dive: Dive) -> None:
    dive.armed()
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.link.disarm()
    assert all(map(is_neutral, dive.vehicle.moves()))
    assert not dive.link.engaged
    assert dive.link.yielding == ""
    dive.vehicle.sent.clear()
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.run(0.5)
    assert dive.vehicle.moves() == []


def test_connecting_asks_for_messages_and_says_who_is_missing() -> None:
    dive = Dive(rates={"RAW_IMU": 50.0, "NAMED_VALUE_FLOAT": 2.0})
    with pytest.raises(TimeoutError, match="heartbeat of system 1"):
        dive.link.connect(0.02)
    dive.vehicle.say(dialect.MAVLink_heartbeat_message(12, 3, 0, 0, 4, 3), system=3)
    with pytest.raises(TimeoutError, match="from system 3"):
        dive.link.connect(0.02)
    dive.vehicle.heartbeat()
    assert dive.link.connect(0.1).mode == "MANUAL"
    asked = [m for m in dive.vehicle.heard("COMMAND_LONG") if m.command == 511]
    assert [(m.param1, m.param2) for m in asked] == [(27.0, 20000.0), (251.0, 500000.0)]
    with pytest.raises(ValueError, match="hertz"):
        dive.link.set_message_interval("RAW_IMU", 0.0)
    with pytest.raises(ValueError, match="a name of MAVLink"):
        dive.link.set_message_interval("RAW_IMUU", 1.0)


@pytest.mark.parametrize("name", ["MAV_GCS_SYSID", "SYSID_MYGCS"])
def test_the_stations_id_is_found_by_either_name(dive: Dive, name: str) -> None:
    dive.vehicle.parameters.pop("MAV_GCS_SYSID")
    dive.vehicle.parameters[name] = 254.0
    for asked in ("MAV_GCS_SYSID", "SYSID_MYGCS"):
        assert dive.link.param(asked) == 254.0
    dive.link.set_param("MAV_GCS_SYSID", 255.0)
    assert dive.vehicle.parameters[name] == 255.0
    assert dive.link.restore() == Restored({name: 254.0}, {})
    assert dive.vehicle.parameters[name] == 254.0
    assert dive.link.restore() == Restored({}, {})


def test_parameters_are_set_seen_and_restored(dive: Dive) -> None:
    before = dict(dive.vehicle.parameters)
    dive.vehicle.deaf["PARAM_SET"] = 2
    dive.link.set_param("FS_PILOT_TIMEOUT", 1.0)
    dive.link.set_param("FS_PILOT_TIMEOUT", 0.5)
    dive.link.set_param("FS_PILOT_INPUT", 2.0)
    assert dive.vehicle.parameters["FS_PILOT_TIMEOUT"] == 0.5
    assert dive.link.restore().done == {"FS_PILOT_INPUT": 1.0, "FS_PILOT_TIMEOUT": 3.0}
    assert dive.vehicle.parameters == before


def test_one_parameter_that_stays_changed_keeps_no_other_so(
    dive: Dive, caplog: pytest.LogCaptureFixture
) -> None:
    dive.link.set_param("FS_PILOT_TIMEOUT", 1.0)
    dive.link.set_param("FS_PILOT_INPUT", 2.0)
    dive.link.set_param("FS_LEAK_ENABLE", 2.0)
    dive.vehicle.stuck = "FS_PILOT_INPUT"
    restored = dive.link.restore()
    assert restored.done == {"FS_PILOT_TIMEOUT": 3.0, "FS_LEAK_ENABLE": 1.0}
    assert restored.left.keys() == {"FS_PILOT_INPUT"}
    assert "expected 1.0, got 2.0" in restored.left["FS_PILOT_INPUT"]
    assert "FS_PILOT_INPUT was 1 and is not put back" in caplog.text
    dive.vehicle.stuck = ""
    assert dive.link.restore() == Restored({"FS_PILOT_INPUT": 1.0}, {})
    assert dive.vehicle.parameters == PARAMETERS


def test_nothing_is_put_back_while_the_vehicle_is_armed(dive: Dive) -> None:
    dive.armed()
    dive.link.set_param("FS_PILOT_TIMEOUT", 1.0)
    restored = dive.link.restore()
    assert restored.done == {}
    assert "the vehicle is armed" in restored.left["FS_PILOT_TIMEOUT"]
    assert dive.vehicle.parameters["FS_PILOT_TIMEOUT"] == 1.0
    dive.link.disarm()
    # A failsafe that changed the mode is no reason to leave the vehicle changed.
    dive.vehicle.mode = 9
    dive.vehicle.heartbeat()
    assert dive.link.busy
    assert dive.link.restore().done == {"FS_PILOT_TIMEOUT": 3.0}


def test_old_values_are_on_disk_before_the_first_is_changed(tmp_path: Path) -> None:
    file = tmp_path / "before.json"
    dive = Dive(keep=file)
    seen = []
    obey = dive.vehicle.value
    dive.vehicle.value = lambda name: (seen.append(file.exists()), obey(name))[1]  # type: ignore[func-returns-value, method-assign]
    dive.link.set_param("FS_PILOT_TIMEOUT", 1.0)
    assert seen == [False, True]  # asked for its value, and then changed
    dive.link.set_param("FS_PILOT_TIMEOUT", 0.5)
    dive.link.set_param("FS_PILOT_INPUT", 2.0)
    dive.link.restore()
    dive.link.set_param("FS_LEAK_ENABLE", 2.0)
    assert json.loads(file.read_text()) == {
        "FS_PILOT_TIMEOUT": 3.0,
        "FS_PILOT_INPUT": 1.0,
        "FS_LEAK_ENABLE": 1.0,
    }
    assert list(tmp_path.iterdir()) == [file]


def test_what_cannot_be_kept_is_not_changed(tmp_path: Path) -> None:
    dive = Dive(keep=tmp_path / "no such folder" / "before.json")
    with pytest.raises(OSError, match=r"could not write .*before\.json \(No such file or directory\)"):
        dive.link.set_param("FS_PILOT_TIMEOUT", 1.0)
    assert dive.vehicle.heard("PARAM_SET") == []


def test_a_parameter_that_keeps_its_value_is_a_refusal(dive: Dive) -> None:
    dive.vehicle.stuck = "FS_PILOT_INPUT"
    with pytest.raises(Refused, match=r"expected 2\.0, got 1\.0"):
        dive.link.set_param("FS_PILOT_INPUT", 2.0)
    with pytest.raises(TimeoutError, match=r"NO_SUCH_ONE.*no answer"):
        dive.link.param("NO_SUCH_ONE")
    with pytest.raises(ValueError, match="finite"):
        dive.link.set_param("FS_PILOT_INPUT", math.nan)


def test_checking_changes_nothing_and_correcting_only_what_is_wrong(dive: Dive) -> None:
    checks = dive.link.check_parameters()
    assert dive.vehicle.heard("PARAM_SET") == []
    wrong = {check.name for check in checks if not check.ok}
    assert wrong == {"FS_PILOT_INPUT", "FS_PILOT_TIMEOUT"}
    dive.link.correct(checks)
    assert {m.param_id for m in dive.vehicle.heard("PARAM_SET")} == wrong
    assert all(check.ok for check in dive.link.check_parameters())
    dive.vehicle.parameters["MAV_GCS_SYSID"] = 252.0
    dive.vehicle.parameters["MAV_GCS_SYSID_HI"] = 255.0
    dive.link.correct(dive.link.check_parameters())
    assert dive.vehicle.parameters["MAV_GCS_SYSID"] == 255.0
    dive.vehicle.parameters["MAV_GCS_SYSID"] = 252.0
    dive.vehicle.parameters["MAV_GCS_SYSID_HI"] = 254.0
    dive.vehicle.parameters["FRAME_CONFIG"] = 7.0
    del dive.vehicle.parameters["FS_GCS_ENABLE"]
    wrong = {check.name for check in dive.link.check_parameters() if not check.ok}
    assert wrong == {"MAV_GCS_SYSID", "MAV_GCS_SYSID_HI", "FRAME_CONFIG", "FS_GCS_ENABLE"}


def test_the_joystick_is_that_of_the_vehicle(dive: Dive) -> None:
    joystick = dive.link.joystick()
    assert joystick.thrusters is VECTORED_6DOF
    assert (joystick.gain, joystick.climb, joystick.yaw_p) == (0.5, 0.5, 3.375)
    dive.vehicle.named("PilotGain", 0.75)
    assert dive.link.joystick().gain == 0.75


def test_the_camera_is_tilted_and_seen_to_be(dive: Dive) -> None:
    dive.vehicle.heartbeat()
    assert dive.link.tilt_camera(math.radians(-30.0)) == pytest.approx(math.radians(-30.0), abs=1e-4)
    (command,) = dive.vehicle.heard("COMMAND_LONG")
    assert (command.command, command.param1, command.param7) == (205, pytest.approx(-30.0), 2.0)
    dive.vehicle.tilt_reported = False
    dive.clock.time += 1.0
    with pytest.raises(TimeoutError, match="camera tilt"):
        dive.link.tilt_camera(0.2, timeout=0.02)
    with pytest.raises(ValueError, match="60"):
        dive.link.tilt_camera(math.nan)


# On a simulated clock, with threads


@pytest.mark.parametrize(("after", "told"), [(0.0, True), (0.25, True), (0.4, False)])
def test_a_reason_that_comes_a_moment_after_the_refusal_is_told_and_not_waited_for_longer(
    after: float, told: bool
) -> None:
    diver = Diver(
        LockStep(), refuses=Counter(SURFACE=1), why="Depth sensor is not connected", why_after=after
    )
    with afloat(diver) as link:
        asked = diver.clock()
        with pytest.raises(Refused, match="DO_SET_MODE: expected ACCEPTED, got FAILED") as refused:
            link.set_mode("SURFACE")
        assert ("Depth sensor is not connected" in str(refused.value)) == told
        assert diver.clock() - asked == pytest.approx(min(after, REASON), abs=0.06)


def moving(diver: Diver, since: float) -> list[Any]:
    return [m for m in diver.heard("MANUAL_CONTROL", since) if not is_neutral(m)]


def test_a_vehicle_is_ours_until_its_heartbeat_shows_that_it_is_disarmed() -> None:
    diver = Diver(LockStep())
    with afloat(diver) as link:
        diver.heartbeats = False
        began = diver.clock()
        disarming = diver.clock.start(link.disarm, "disarms")
        for _ in range(20):
            # Whoever goes on to give orders moves nothing.
            link.command(AHEAD, diver.clock() + 0.4)
            diver.clock.sleep(0.1)
            assert link.engaged
        assert not diver.armed
        assert diver.heard("MANUAL_CONTROL", began)
        assert moving(diver, began) == []
        diver.heartbeats = True
        diver.clock.sleep(0.3)
        assert not link.engaged
        disarming.join(1.0)
        assert not disarming.is_alive()
        assert link.yielding == ""


def test_one_that_does_not_let_itself_be_disarmed_is_still_ours_to_move() -> None:
    diver = Diver(LockStep(), refuses=Counter(disarm=1))
    with afloat(diver) as link:
        with pytest.raises(Refused, match="COMPONENT_ARM_DISARM"):
            link.disarm()
        assert link.engaged
        assert link.yielding == ""
        refused = diver.clock()
        link.command(AHEAD, refused + 0.4)
        diver.clock.sleep(0.3)
        assert moving(diver, refused)
        link.disarm()
        assert not link.engaged


def test_a_question_is_asked_again_and_given_up_after_its_time() -> None:
    diver = Diver(LockStep())
    with afloat(diver) as link:
        diver.deaf = lambda message: message.get_type() == "COMMAND_LONG"
        asked = diver.clock()
        with pytest.raises(TimeoutError, match="got none in 3 tries"):
            link.set_mode("SURFACE")
        assert diver.clock() - asked == pytest.approx(1.5, abs=0.1)


# Over a real socket, with threads


@pytest.fixture
def wired() -> Iterator[tuple[Link, Vehicle, Callable[[], float]]]:
    begin = time.monotonic()

    def now() -> float:
        return time.monotonic() - begin

    vehicle = Vehicle(now)
    vehicle.booted = -1.0
    link = Link("127.0.0.1:0", now=now, rates=NO_MESSAGES, retry=0.1)
    wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    wire.bind(("127.0.0.1", 0))
    wire.settimeout(0.05)
    there = "127.0.0.1", link.port
    vehicle.hear = lambda data: (wire.sendto(data, there), None)[1]
    ended = threading.Event()

    def work() -> None:
        beat = 0.0
        while not ended.is_set():
            if now() > beat:
                beat = now() + 0.1
                vehicle.heartbeat()
                wire.sendto(b"\xfd\x09garbage", there)
            try:
                vehicle.send(wire.recv(2048))
            except TimeoutError:
                continue

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    with link:
        yield link, vehicle, now
    ended.set()
    thread.join(2.0)
    wire.close()


def test_a_dive_over_a_socket(wired: tuple[Link, Vehicle, Callable[[], float]]) -> None:
    link, vehicle, now = wired
    assert link.connect(5.0).mode == "MANUAL"
    link.set_mode("ALT_HOLD")
    link.arm()
    vehicle.sent.clear()
    expires = link.command(AHEAD, now() + 0.3)
    assert until(lambda: sum(map(is_neutral, vehicle.heard("MANUAL_CONTROL"))) > 4)
    moving = [t for t, m in list(vehicle.sent) if not is_neutral(m)]
    assert moving
    assert max(moving) < expires + PERIOD
    assert link.connected
    assert link.problem == ""
    link.disarm()
    assert not vehicle.armed


def test_lights_are_switched_by_buttons(wired: tuple[Link, Vehicle, Callable[[], float]]) -> None:
    link, vehicle, _ = wired
    link.connect(5.0)
    vehicle.parameters |= {f"BTN{n}_FUNCTION": 0.0 for n in range(16) if n not in (13, 14)}
    vehicle.named("Lights1", 0.0)
    assert link.set_lights(0.4) == pytest.approx(0.375)
    assert link.set_lights(0.0) == pytest.approx(0.0, abs=0.07)
    assert all(map(is_neutral, vehicle.moves()))
    with pytest.raises(ValueError, match="share"):
        link.set_lights(1.5)


def test_closing_sends_neutral_and_frees_the_port() -> None:
    dive = Dive().armed()
    dive.link.command(AHEAD, dive.clock() + 0.5)
    dive.link.close()
    dive.link.close()
    assert is_neutral(dive.vehicle.moves()[-1])
    link = Link("127.0.0.1:0", now=time.monotonic)
    port = link.port
    with link, pytest.raises(OSError, match="got one that another program has"):
        Link(f"udpin:127.0.0.1:{port}", now=time.monotonic)
    with Link(f"udpin:127.0.0.1:{port}", now=time.monotonic):
        pass


def test_who_speaks_up_later_is_neither_heard_nor_answered_while_the_first_is_there() -> None:
    pipe = Udp("127.0.0.1", 0, listen=True)
    first, second = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    try:
        for peer in (first, second):
            peer.bind(("127.0.0.1", 0))
            peer.settimeout(2.0)
        assert not pipe.send(b"to nobody")
        for peer in (first, second):  # nobody is known yet
            peer.sendto(b"hello", ("127.0.0.1", pipe.port))
            assert pipe.receive() == b"hello"
        first.sendto(b"heartbeat", ("127.0.0.1", pipe.port))
        assert pipe.receive() == b"heartbeat"
        pipe.answered(60.0)
        assert pipe.send(b"to the first")
        assert first.recv(100) == b"to the first"
        second.sendto(b"again", ("127.0.0.1", pipe.port))
        assert pipe.receive() == b""
        assert pipe.refused == {"from another address": 1}
        first.sendto(b"last words", ("127.0.0.1", pipe.port))
        assert pipe.receive() == b"last words"
        pipe.answered(-1.0)  # the first is gone
        second.sendto(b"me", ("127.0.0.1", pipe.port))
        assert pipe.receive() == b"me"
        pipe.answered(-1.0)
        pipe.send(b"to the second")
        assert second.recv(100) == b"to the second"
    finally:
        for each in (pipe, first, second):
            each.close()


def _sent(wire: socket.socket, port: int, data: bytes) -> None:
    wire.sendto(data, ("127.0.0.1", port))


def test_two_vehicles_of_one_id_are_never_mixed() -> None:
    ours, theirs = Vehicle(time.monotonic), Vehicle(time.monotonic)
    wires = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    try:
        with Link("127.0.0.1:0", now=time.monotonic, rates=NO_MESSAGES) as link:
            for vehicle, wire in zip((ours, theirs), wires, strict=True):
                vehicle.hear = partial(_sent, wire, link.port)
            ours.heartbeat()
            assert until(lambda: link.connected)
            theirs.armed, theirs.mode = True, 2
            theirs.heartbeat()
            assert until(lambda: link.refused["from another address"] == 1)
            ours.named("PilotGain", 0.5)
            assert until(lambda: link.telemetry.pilot_gain == 0.5)
            assert (link.telemetry.mode, link.telemetry.armed) == ("MANUAL", False)
            assert not link.yielding
    finally:
        for wire in wires:
            wire.close()


@pytest.mark.parametrize("address", ["127.0.0.1", "udpin:127.0.0.1:99999", "tcp::1", "udpout:host:x"])
def test_addresses_are_checked(address: str) -> None:
    with pytest.raises(ValueError, match="address"):
        Link(address, now=time.monotonic)


@pytest.mark.parametrize("pressure", [1.013, 29.92, 101.3, 299.0, 1201.0, 101325.0, math.inf])
def test_a_pressure_in_other_units_is_no_surface(pressure: float) -> None:
    with pytest.raises(ValueError, match=r"surface_pressure: expected 300 to 1200 hPa, got .* 1 bar is 1000"):
        Link("127.0.0.1:0", now=time.monotonic, surface_pressure=pressure)


def test_a_tcp_peer_that_is_not_there_is_a_problem_and_no_error() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with Link(f"tcp:127.0.0.1:{port}", now=time.monotonic) as link:
        assert until(lambda: "refused" in link.problem)
        with socket.create_server(("127.0.0.1", port)) as server:
            server.settimeout(5.0)
            peer, _ = server.accept()
            with peer:
                vehicle = Vehicle(time.monotonic)
                vehicle.hear = peer.sendall
                vehicle.heartbeat()
                assert until(lambda: link.connected)
                assert link.problem == ""


@pytest.mark.parametrize(
    "options", [{"vehicle": 0}, {"system": 256}, {"system": 1}, {"density": 1.0}, {"rates": {"NONE": 1.0}}]
)
def test_options_are_checked(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="expected"):
        Dive(**options)
