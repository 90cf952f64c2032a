"""The pilot: a person's sticks outrank the mission at once, and never outlive the person."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from dream.geometry import SE2, SE3, Bounds, wrap_angle
from dream.robots.bluerov2.bridge import Bridge, Stance
from dream.robots.bluerov2.devices import Addresses, Devices
from dream.robots.bluerov2.drives import AltHold
from dream.robots.bluerov2.limits import LastResort, Limits
from dream.robots.bluerov2.log import read_wire
from dream.robots.bluerov2.mavlink import LIFELINE, PERIOD, Link
from dream.robots.bluerov2.navigation import Fix, Instruments
from dream.robots.bluerov2.standin.ardusub import ArduSub
from dream.robots.bluerov2.standin.tank import Tank
from dream.robots.bluerov2.station import BURST, EXPIRY, HANDS_OFF, LARGEST, LOST, MOST, Hands, Station
from dream.robots.bluerov2.sticks import NEUTRAL, Joystick, Sticks
from dream.sim.worlds import make_world
from dream.vehicle import VECTORED_6DOF
from tests.robots.bluerov2.test_bridge import fix_at
from tests.robots.bluerov2.test_drives import Home
from tests.robots.bluerov2.test_mavlink import Dive, is_neutral, own_altitude
from tests.robots.bluerov2.waiting import until

HERE, THERE = ("127.0.0.1", 40001), ("127.0.0.1", 40002)
GOAL = SE2(0.5, 0.0, 0.0)
LIMITS = Limits(area=Bounds(-2.0, -2.0, 2.0, 2.0), depth=100.0)
LEFT = {"y": -600}
Stick = dict[str, int]


class Door:
    """A port whose datagrams a test hands over."""

    def __init__(self) -> None:
        self.sent: list[tuple[Any, Any]] = []
        self._reader = dialect.MAVLink(None)

    def send(self, data: bytes, to: Any) -> None:
        self.sent += [(message, to) for message in self._reader.parse_buffer(data) or ()]

    def receive(self) -> None:
        time.sleep(0.01)

    def close(self) -> None: ...

    def heard(self, kind: str) -> list[Any]:
        return [message for message, _ in self.sent if message.get_type() == kind]


class Person:
    """A ground station with a joystick: sticks 25 times a second, a heartbeat once a second."""

    def __init__(self, station: Station, clock: Callable[[], float], address: Any = HERE) -> None:
        self.station, self.clock, self.address = station, clock, address
        self.writer = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        self.sticks: Stick | None = {}
        """None for silence."""
        self._beat = self._stick = -math.inf

    def pack(self, message: Any) -> bytes:
        self.writer.seq = (self.writer.seq + 1) % 256
        return bytes(message.pack(self.writer))

    def say(self, message: Any) -> bool:
        return self.station.receive(self.pack(message), self.address)

    def stick(
        self, x: int = 0, y: int = 0, z: int = 500, r: int = 0, buttons: int = 0, target: int = 1
    ) -> None:
        self.say(dialect.MAVLink_manual_control_message(target, x, y, z, r, buttons))

    def heartbeat(self, kind: int = 6) -> None:
        self.say(dialect.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3))

    def command(self, number: int, *values: float) -> None:
        self.say(dialect.MAVLink_command_long_message(1, 1, number, 0, *values, *[0.0] * (7 - len(values))))

    def live(self) -> None:
        if self.sticks is None:
            return
        if self.clock() >= self._beat + 1.0:
            self._beat = self.clock()
            self.heartbeat()
        if self.clock() >= self._stick + 0.04 - 1e-9:
            self._stick = self.clock()
            self.stick(**self.sticks)


class Scene:
    """Link, bridge, drive, station and person on one clock; where the vehicle is, a test says."""

    def __init__(self, **options: Any) -> None:
        self.dive = Dive(**options)
        self.clock, self.vehicle, self.link = self.dive.clock, self.dive.vehicle, self.dive.link
        self.vehicle.parameters |= {f"BTN{n}_FUNCTION": 0.0 for n in range(13)}
        self.vehicle.parameters |= {"BTN4_FUNCTION": 4.0, "BTN6_FUNCTION": 2.0, "BTN15_FUNCTION": 6.0}
        self.door, self.tapped = Door(), []  # type: ignore[var-annotated]
        self.station = Station(
            self.door, self.link, now=self.clock, tap=lambda *record: self.tapped.append(record)
        )
        self.person = Person(self.station, self.clock)
        self.fix = fix_at()
        self.dive.armed()
        self.station.learn_buttons()
        self.home = Home()
        drive = AltHold(self.link, Joystick(), self.home)  # type: ignore[arg-type]
        self.vehicle.say(own_altitude(-0.9))
        self.bridge = Bridge(self, drive, LIMITS, self.clock, pilot=self.station)  # type: ignore[arg-type]
        self.bridge.go(GOAL, 0.6)
        self.mission = True
        self.run(0.5)
        self.vehicle.sent.clear()

    def update(self) -> Fix:
        return self.fix

    def run(self, seconds: float, *, bridge: bool = True) -> None:
        end = self.clock.time + seconds
        step = 0
        while self.clock.time < end - 1e-9:
            self.person.live()
            if step % 5 == 0:
                self.station.beat()
            if step % 4 == 0 and bridge:
                self.bridge.renew()
                self.bridge.beat()
            if step % 10 == 0:
                self.vehicle.say(own_altitude(-0.9))
            if step % 20 == 0:
                self.vehicle.heartbeat()
                self.vehicle.status()
            self.link.beat()
            self.clock.time += 0.01
            step += 1

    def push(self, seconds: float = 0.5, **sticks: int) -> None:
        self.person.sticks = sticks or LEFT
        self.run(seconds)

    def stance(self) -> Stance:
        return self.bridge.standing.stance

    def moved(self, since: float = -math.inf) -> list[tuple[float, tuple[int, int, int, int]]]:
        return [
            (t, (m.x, m.y, m.z, m.r))
            for t, m in self.vehicle.sent
            if m.get_type() == "MANUAL_CONTROL" and t >= since
        ]


@pytest.fixture
def scene() -> Scene:
    return Scene()


# Taking and giving back


def test_sticks_at_neutral_leave_the_mission_alone(scene: Scene) -> None:
    scene.run(3.0)
    assert scene.stance() is Stance.GO
    assert not scene.station.has
    assert all(x > 0 for _, (x, *_) in scene.moved())
    assert "hands off" in scene.station.words


@pytest.mark.parametrize("sticks", [{"x": -51}, {"y": 51}, {"r": -51}, {"z": 449}, {"z": 551}])
def test_any_stick_takes_over_within_one_period_of_sending(scene: Scene, sticks: Stick) -> None:
    scene.run(1.0)
    scene.person.sticks = sticks
    began = scene.clock()
    scene.run(1.0)
    theirs = tuple(({"x": 0, "y": 0, "z": 500, "r": 0} | sticks).values())
    first = min(t for t, sent in scene.moved(began) if sent == theirs)
    # One period of the station, and one of the link.
    assert first - began <= 0.04 + PERIOD + 1e-9
    assert {sent for t, sent in scene.moved(first)} == {theirs}
    assert scene.stance() is Stance.YIELD
    assert scene.bridge.standing.reason == "the pilot has the sticks"
    assert "has the sticks" in scene.station.words


def test_no_climb_of_the_missions_mixes_with_the_pilots_dive(scene: Scene) -> None:
    scene.bridge.go(GOAL, 0.9)  # 0.3 m up
    scene.run(0.2)
    assert scene.moved()[-1][1][2] > 500
    scene.push(0.2, z=100)
    scene.vehicle.sent.clear()
    scene.run(5.0)
    assert {sent for _, sent in scene.moved()} == {(0, 0, 100, 0)}


def test_within_the_dead_zone_is_neutral(scene: Scene) -> None:
    scene.push(2.0, x=50, y=-50, z=550, r=50)
    assert not scene.station.has
    assert scene.stance() is Stance.GO


def test_hands_off_give_it_back_after_a_second_and_the_goal_is_followed_from_where_it_is(
    scene: Scene,
) -> None:
    scene.push(2.0)
    scene.fix = fix_at(1.5)  # a metre beyond its goal
    scene.person.sticks = {"x": 20}
    off = scene.clock()
    scene.run(HANDS_OFF + 1.0)
    waiting = [sent for t, sent in scene.moved(off + 0.1) if t < off + HANDS_OFF - 0.01]
    assert len(waiting) > 10
    assert set(waiting) == {(0, 0, 500, 0)}
    assert scene.stance() is Stance.GO
    again = [(t, sent) for t, sent in scene.moved(off + 0.1) if sent != (0, 0, 500, 0)]
    # At once: the last neutral of the person does not hold the mission up.
    assert off + HANDS_OFF - 0.01 <= again[0][0] <= off + HANDS_OFF + 0.2
    # Backwards, gently: the reference begins where it is, so nothing is made up for at a stroke.
    assert all(x < 0 for _, (x, *_) in again)
    assert abs(again[0][1][0]) < 300
    assert scene.bridge.goal == GOAL


def test_a_short_rest_of_the_sticks_is_not_hands_off(scene: Scene) -> None:
    scene.push()
    for _ in range(4):
        scene.person.sticks = {}
        scene.run(0.9 * HANDS_OFF)
        assert scene.station.has
        scene.push(0.2)
    assert scene.stance() is Stance.YIELD


def test_it_outranks_limits_and_silence_for_as_long_as_it_takes(scene: Scene) -> None:
    scene.push()
    scene.fix = fix_at(9.0, dvl_age=60.0)  # far outside, and blind
    scene.bridge.renew_operator(0.0)
    scene.vehicle.sent.clear()
    scene.run(20.0)
    assert scene.stance() is Stance.YIELD
    assert {sent for _, sent in scene.moved()} == {(0, -600, 500, 0)}
    scene.person.sticks = {}
    scene.run(HANDS_OFF + 0.5)
    assert scene.stance() is Stance.OVER
    assert "outside the area" in scene.bridge.standing.reason


def test_after_a_last_resort_the_pilot_may_still_steer() -> None:
    scene = Scene()
    scene.bridge.end("a wire came loose")
    scene.run(6.0)
    assert set(scene.home.begun) == {LastResort.SURFACE}
    scene.link.set_mode("SURFACE")
    scene.push()
    scene.vehicle.sent.clear()
    scene.run(1.0)
    assert {sent for _, sent in scene.moved()} == {(0, -600, 500, 0)}
    scene.person.sticks = {}
    scene.run(HANDS_OFF + 0.5)
    assert scene.stance() is Stance.OVER
    assert scene.bridge.standing.reason == "a wire came loose"


# Who is gone


def test_a_station_that_vanishes_with_pushed_sticks_is_neutral_within_half_a_second(scene: Scene) -> None:
    scene.push()
    scene.person.sticks = None
    silent = scene.clock()
    scene.run(30.0)
    last = max(t for t, sent in scene.moved() if sent != (0, 0, 500, 0))
    assert last < silent + EXPIRY
    # Nor does the mission go on by itself, or by an order that slipped through: neutral is sent all the time.
    scene.vehicle.sent.clear()
    scene.link.command(Sticks(x=400), scene.clock() + EXPIRY)
    scene.run(20.0)
    assert all(map(is_neutral, scene.vehicle.heard("MANUAL_CONTROL")))
    assert len(scene.moved()) > 300
    assert scene.stance() is Stance.YIELD
    assert "gone" in scene.bridge.standing.reason
    assert scene.station.gone


def test_it_goes_on_when_the_station_is_back_with_neutral_sticks(scene: Scene) -> None:
    scene.push()
    scene.person.sticks = None
    scene.run(10.0)
    back = scene.clock()
    scene.person.sticks = {}
    scene.run(0.8 * HANDS_OFF)
    assert scene.station.has
    scene.run(0.5)
    assert scene.stance() is Stance.GO
    assert all(sent == (0, 0, 500, 0) for t, sent in scene.moved(back) if t < back + 0.9 * HANDS_OFF)


def test_who_comes_back_pushing_after_long_is_not_obeyed_before_neutral(scene: Scene) -> None:
    scene.push()
    scene.person.sticks = None
    scene.run(LOST + 1.0)
    scene.vehicle.sent.clear()
    scene.push(2.0)
    assert {sent for _, sent in scene.moved()} == {(0, 0, 500, 0)}
    assert scene.station.gone
    scene.person.sticks = {}
    scene.run(0.1)
    scene.push(0.3)
    assert scene.moved()[-1][1] == (0, -600, 500, 0)


def test_a_gap_of_a_second_in_one_push_is_forgiven(scene: Scene) -> None:
    scene.push()
    scene.person.sticks = None
    scene.run(1.0)
    assert scene.station.gone
    scene.push(0.2)
    assert scene.moved()[-1][1] == (0, -600, 500, 0)


def test_the_operator_resumes_for_who_is_gone_but_not_for_who_steers(scene: Scene) -> None:
    scene.push()
    scene.station.release()
    scene.run(0.2)
    assert scene.stance() is Stance.YIELD
    scene.person.sticks = None
    scene.run(2.0)
    scene.station.release()
    scene.run(0.3)
    assert scene.stance() is Stance.GO
    assert scene.moved()[-1][1][0] > 0


def test_who_is_gone_keeps_neither_limits_nor_the_operator_from_ending_it(scene: Scene) -> None:
    scene.push()
    scene.person.sticks = None
    scene.run(2.0)
    assert scene.stance() is Stance.YIELD
    scene.fix = fix_at(9.0)
    scene.run(1.0)
    assert scene.stance() is Stance.OVER
    assert all(map(is_neutral, scene.vehicle.heard("MANUAL_CONTROL")[-10:]))


def test_a_throttle_that_rests_at_its_end_does_not_dive_the_vehicle() -> None:
    scene = Scene()
    scene.person = Person(scene.station, scene.clock, THERE)
    scene.clock.time += LOST + 0.1
    scene.vehicle.sent.clear()
    scene.push(3.0, z=0)
    assert scene.stance() is Stance.GO
    assert {z for _, (_, _, z, _) in scene.moved()} == {500}
    assert scene.station.refused["MANUAL_CONTROL: not at neutral yet"] > 50
    assert "neutral" in scene.station.said


def test_sticks_end_in_neutral_before_the_link_of_a_dive_that_hangs_falls_silent(scene: Scene) -> None:
    scene.push()
    scene.vehicle.sent.clear()
    hung = scene.clock()
    scene.run(LIFELINE + 3.0, bridge=False)
    sent = scene.moved()
    assert (0, -600, 500, 0) in {sticks for _, sticks in sent}
    assert sent[-1][0] <= hung + LIFELINE + 1e-9
    assert sent[-1][1] == (0, 0, 500, 0)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(["push", "rest", "gone"]), st.floats(0.02, 2.0)), max_size=12))
def test_no_stick_outlives_its_person_and_no_mission_goes_on_under_a_hand(
    script: list[tuple[str, float]],
) -> None:
    hands = Hands()
    now, pushed, rested = 0.0, -math.inf, 0.0
    held = False
    """Has somebody pushed, and not yet rested for a second without a gap?"""
    for what, seconds in script:
        end = now + seconds
        while now < end:
            sticks = {"push": Sticks(r=300), "rest": Sticks(x=10), "gone": None}[what]
            if sticks is None:
                hands.look(now)
                rested = 0.0
            else:
                sent = hands.take(sticks, now)
                rested = rested + 0.04 if what == "rest" else 0.0
                if what == "push" and hands.trusted:
                    pushed, held = now, True
                assert sent in (None, NEUTRAL, sticks)
            held = held and rested <= HANDS_OFF + 0.08
            if hands.has:
                assert held
            if now - pushed < HANDS_OFF - 0.08:
                assert hands.has or hands.gone
            assert not (hands.has and hands.gone)
            now += 0.04


# In the water


class Swim:
    """Link, bridge and person on the tank's clock; the vehicle is the stand-in, the estimate is the truth."""

    def __init__(self) -> None:
        self.tank = Tank(make_world("pool/arc", 1), start=SE2(0.0, -0.8, 0.5 * math.pi))
        self.under_way: deque[bytes] = deque()
        self.link = Link(self, now=self.clock, rates={}, surface_pressure=1013.25)
        self.sub = ArduSub(self.tank, lambda data, _: self.link.receive(data))
        self.station = Station(Door(), self.link, now=self.clock)
        self.person = Person(self.station, self.clock)
        self.bridge: Bridge | None = None
        self.swim(2.0)  # held still, while it finds its level
        self.asking(lambda: self.link.set_mode("ALT_HOLD"))
        self.asking(self.link.arm)
        up = 0.01 * self.sub.parameters["PILOT_SPEED_UP"]
        joystick = Joystick(thrusters=VECTORED_6DOF, climb=up, sink=up)
        drive = AltHold(self.link, joystick, Home())  # type: ignore[arg-type]
        limits = Limits(area=self.tank.world.bounds, last_resort=LastResort.HOLD)
        self.bridge = Bridge(self, drive, limits, self.clock, pilot=self.station)  # type: ignore[arg-type]

    def clock(self) -> float:
        return self.tank.time

    def asking(self, question: Callable[[], None]) -> None:
        """Time passes while an answer is waited for."""
        thread = threading.Thread(target=question)
        thread.start()
        while thread.is_alive():
            self.advance()
            time.sleep(0.001)

    def send(self, data: bytes) -> bool:
        self.under_way.append(data)
        return True

    def receive(self) -> bytes:
        return b""

    def answered(self, lost: float) -> None: ...

    def close(self) -> None: ...

    def update(self) -> Fix:
        state = self.tank.state
        x, y, _ = state.position
        return fix_at(
            time=self.tank.time,
            T_world_base=state.T_world_base,
            velocity=state.velocity_world,
            angular_velocity=state.angular_velocity,
            seabed=float(self.tank.world.terrain.height(x, y)),
        )

    def advance(self) -> None:
        while self.under_way:
            self.sub.hear(self.under_way.popleft(), ("127.0.0.1", 14550))
        self.tank.advance(self.sub.commands)
        self.sub.beat()
        self.person.live()
        if self.tank.beats % 5 == 0:
            self.station.beat()
        if self.tank.beats % 4 == 0 and self.bridge is not None:
            self.bridge.renew()
            self.bridge.beat()
        self.link.beat()

    def stance(self) -> Stance:
        assert self.bridge is not None
        return self.bridge.standing.stance

    def swim(self, seconds: float) -> SE3:
        for _ in range(round(100 * seconds)):
            self.advance()
        return self.tank.T_world_base


@pytest.mark.rare
def test_in_the_tank_a_person_takes_the_vehicle_aside_and_the_mission_brings_it_back() -> None:
    swim = Swim()
    goal = SE2(0.0, -0.6, 0.5 * math.pi)
    assert swim.bridge is not None
    swim.bridge.go(goal, 0.6)
    held = swim.swim(12.0)
    assert held.se2.distance(goal) < 0.05
    # Aside, up and around, for four seconds.
    swim.person.sticks = {"y": -500, "z": 650, "r": 300}
    aside = swim.swim(4.0)
    assert aside.se2.distance(goal) > 0.3
    assert aside.translation[2] > held.translation[2] + 0.1
    assert abs(wrap_angle(aside.yaw - goal.yaw)) > 0.3
    # The cable goes: it stays about there, for as long as it takes.
    swim.person.sticks = None
    swim.swim(3.0)
    alone = swim.tank.T_world_base
    later = swim.swim(5.0)
    assert alone.se2.distance(later.se2) < 0.1
    assert abs(wrap_angle(later.yaw - alone.yaw)) < 0.1
    assert swim.stance() is Stance.YIELD
    # Back, with a hand that rests: the mission goes to its goal, without a jolt.
    swim.person.sticks = {}
    swim.swim(HANDS_OFF + 0.2)
    assert swim.stance() is Stance.GO
    speeds = []
    for _ in range(200):
        swim.swim(0.1)
        speeds.append(float(np.hypot(*swim.tank.state.velocity_world[:2])))
    assert max(speeds) < 0.4
    assert swim.tank.T_world_base.se2.distance(goal) < 0.05
    assert swim.tank.T_world_base.translation[2] == pytest.approx(held.translation[2], abs=0.1)
    assert swim.sub.armed


# What else a station says


def test_commands_modes_and_parameters_are_told_denied_and_kept_from_the_vehicle(scene: Scene) -> None:
    scene.run(1.0)
    scene.vehicle.sent.clear()
    asked = [
        dialect.MAVLink_command_long_message(1, 1, 400, 0, 1.0, 0, 0, 0, 0, 0, 0),  # arm
        dialect.MAVLink_command_long_message(1, 1, 176, 0, 1.0, 19.0, 0, 0, 0, 0, 0),  # mode
        dialect.MAVLink_command_long_message(1, 1, 65000, 0, 1.0, 19.0, 0, 0, 0, 0, 0),
        dialect.MAVLink_command_int_message(1, 1, 0, 400, 0, 0, math.nan, 0, 0, 0, 0, 0, 0),
        dialect.MAVLink_set_mode_message(1, 1, 19),
        dialect.MAVLink_param_set_message(1, 1, b"FS_GCS_ENABLE", 0.0, 9),
        dialect.MAVLink_rc_channels_override_message(1, 1, *[1900] * 8),
    ]
    for message in asked:
        scene.person.say(message)
    kinds = {m.get_type() for _, m in scene.vehicle.sent}
    scene.run(0.5)
    assert kinds == set()
    assert scene.vehicle.armed
    assert scene.vehicle.mode == 2
    assert scene.stance() is Stance.GO
    for name in ("DO_SET_MODE", "SET_MODE", "PARAM_SET", "RC_CHANNELS_OVERRIDE", "an unknown command"):
        assert scene.station.refused[name] == 1
    assert scene.station.refused["COMPONENT_ARM_DISARM"] == 2
    assert "ask for it in DREAM's console" in scene.station.words
    assert [ack.result for ack in scene.door.heard("COMMAND_ACK")] == [2] * 4
    assert scene.door.heard("STATUSTEXT")


def test_what_stations_ask_by_themselves_bothers_nobody(scene: Scene) -> None:
    scene.run(0.2)
    scene.person.say(dialect.MAVLink_param_request_list_message(1, 1))
    scene.person.command(512, 148.0)
    assert scene.station.refused == {"PARAM_REQUEST_LIST": 1, "REQUEST_MESSAGE": 1}
    assert scene.station.said == ""
    assert scene.vehicle.heard("PARAM_REQUEST_LIST") == []


def disarmed(scene: Scene) -> None:
    thread = scene.station._disarming
    assert thread is not None
    thread.join(5.0)
    scene.run(0.5)
    assert not scene.vehicle.armed
    assert scene.stance() is Stance.OVER
    assert scene.bridge.standing.reason == "the pilot disarmed the vehicle"
    assert is_neutral(scene.vehicle.moves()[-1])


@pytest.mark.parametrize("force", [0.0, 21196.0])
def test_a_disarm_is_obeyed_and_ends_the_dive(scene: Scene, force: float) -> None:
    scene.push()
    scene.person.command(400, 0.0, force)
    disarmed(scene)
    assert [ack.result for ack in scene.door.heard("COMMAND_ACK")] == [0]


@pytest.mark.parametrize("button", [4, 6])
def test_a_button_that_disarms_does(scene: Scene, button: int) -> None:
    scene.run(0.2)
    scene.person.stick(buttons=1 << button)
    disarmed(scene)


def test_other_buttons_do_nothing_and_are_told(scene: Scene) -> None:
    scene.run(0.2)
    for _ in range(5):
        scene.person.stick(buttons=1 << 15 | 1 << 14)
    scene.run(1.0)
    assert scene.vehicle.armed
    assert scene.station.refused["a button"] == 2
    assert {m.buttons for m in scene.vehicle.heard("MANUAL_CONTROL")} == {0}
    assert "button" in scene.station.said


def test_a_disarm_that_fails_is_told_and_the_dive_is_over_all_the_same(scene: Scene) -> None:
    scene.run(0.2)
    scene.vehicle.results[400] = 4
    scene.person.command(400, 0.0)
    assert scene.station._disarming is not None
    scene.station._disarming.join(5.0)
    scene.run(0.5)
    assert scene.stance() is Stance.OVER
    assert "not disarmed" in scene.station.said
    assert [ack.result for ack in scene.door.heard("COMMAND_ACK")] == [4]


def test_once_dismissed_sticks_do_nothing(scene: Scene) -> None:
    scene.push()
    scene.station.dismiss()
    scene.bridge.end("ended by the operator")
    scene.vehicle.sent.clear()
    scene.run(3.0)
    assert {sent for _, sent in scene.moved()} == {(0, 0, 500, 0)}
    assert scene.stance() is Stance.OVER


# Others, rubbish, floods


def test_sticks_for_another_vehicle_or_out_of_range_are_none(scene: Scene) -> None:
    scene.run(0.2)
    for bad in ({"target": 2}, {"target": 0}, {"x": 1001}, {"z": -1}, {"r": 32767}, {"y": -32768}):
        scene.person.stick(**({"x": 500} | bad))
    assert not scene.station.has
    assert scene.station.refused == {
        "MANUAL_CONTROL: for another vehicle": 2,
        "MANUAL_CONTROL: out of range": 4,
    }


def test_there_is_one_station_at_a_time(scene: Scene) -> None:
    other = Person(scene.station, scene.clock, THERE)
    scene.run(0.2)
    other.heartbeat()
    other.stick()
    other.stick(x=900)
    assert not scene.station.has
    assert scene.station.refused["from another address"] == 3
    scene.person.sticks = None
    scene.run(LOST + 0.1)
    other.stick(x=900)
    assert scene.station.refused["before a heartbeat"] == 1
    other.heartbeat()
    other.stick()
    other.stick(x=900)
    assert scene.station.has


def test_only_a_ground_station_is_one() -> None:
    scene = Scene()
    other = Person(scene.station, scene.clock, THERE)
    scene.clock.time += LOST + 0.1
    other.heartbeat(kind=18)
    other.writer.srcSystem = 1
    other.heartbeat()
    other.stick()
    assert not scene.station.connected
    assert scene.station.refused["HEARTBEAT: not of a ground station"] == 1
    assert scene.station.refused["from the vehicle's own system id"] == 2


@settings(max_examples=150, deadline=None)
@given(st.lists(st.binary(max_size=300), max_size=5), st.integers(0, 40), st.integers(0, 255))
def test_no_bytes_raise_nor_steer(rubbish: list[bytes], cut: int, flip: int) -> None:
    dive = Dive()
    station = Station(Door(), dive.link, now=dive.clock)
    person = Person(station, dive.clock)
    person.heartbeat()
    person.stick()
    good = person.pack(dialect.MAVLink_manual_control_message(1, 900, 0, 500, 0, 0))
    broken = bytearray(good)
    broken[min(cut, len(good) - 1)] ^= flip or 1
    for data in (*rubbish, *(b"\xfd" + r for r in rubbish), good[:cut][: len(good) - 1], bytes(broken)):
        station.receive(data, HERE)
        station.beat()
    assert not station.has
    station.receive(good, HERE)
    assert station.has


def test_a_datagram_that_is_too_long_is_not_read(scene: Scene) -> None:
    scene.run(0.2)
    push = scene.person.pack(dialect.MAVLink_manual_control_message(1, 900, 0, 500, 0, 0))
    scene.station.receive(push + bytes(LARGEST), HERE)
    assert scene.station.refused["too long"] == 1
    assert not scene.station.has


def test_a_flood_is_cut_to_its_rate(scene: Scene) -> None:
    scene.push()
    push = dialect.MAVLink_manual_control_message(1, 0, 900, 500, 0, 0)
    began, read, flood = scene.clock(), 0, 20_000
    for _ in range(flood):
        read += scene.person.say(push)
        scene.clock.time += 2.0 / flood
    assert read <= BURST + MOST * (scene.clock() - began) + 1
    assert scene.station.refused["too fast"] == flood - read
    assert len(scene.tapped) < 2 * (BURST + MOST * 3.0)


def test_a_log_that_fails_does_not_stop_the_sticks(scene: Scene, caplog: pytest.LogCaptureFixture) -> None:
    def full(*_: object) -> None:
        raise OSError("no space left on device")

    scene.station._tap = full
    scene.push()
    assert scene.moved()[-1][1] == (0, -600, 500, 0)
    assert "not logged" in caplog.text


def test_all_that_comes_and_is_decided_is_tapped(scene: Scene) -> None:
    scene.push()
    assert {channel for _, channel, _, _ in scene.tapped} == {"pilot"}
    came = {m.get_type() for _, _, sent, m in scene.tapped if not sent}
    assert came == {"HEARTBEAT", "MANUAL_CONTROL"}
    said = [m["said"] for _, _, sent, m in scene.tapped if sent and isinstance(m, dict)]
    assert said == ["the pilot has the sticks"]


# What the station sees


def forwarding(scene: Scene) -> None:
    """As `Devices` does it."""
    before = scene.link._tap
    assert before is not None

    def tap(time: float, channel: str, sent: bool, message: Any) -> None:
        before(time, channel, sent, message)
        if not sent:
            scene.station.forward(message)

    scene.link._tap = tap


def test_telemetry_goes_to_the_station_byte_for_byte_and_answers_do_not(scene: Scene) -> None:
    scene.run(0.2)
    forwarding(scene)
    vehicle = scene.vehicle
    vehicle.heartbeat()
    vehicle.attitude(yaw=0.7)
    vehicle.pressure(1100.0)
    vehicle.say(dialect.MAVLink_statustext_message(4, b"bad compass"))
    vehicle.say(dialect.MAVLink_vfr_hud_message(0, 0, 40, 0, -1.0, 0))
    vehicle.say(dialect.MAVLink_sys_status_message(0, 0, 0, 0, 15800, -1, 62, 0, 0, 0, 0, 0, 0))
    vehicle.say(dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), component=194)
    vehicle.value("FS_GCS_ENABLE")
    vehicle.imu((0, 0, -1000))
    came = [m for _, channel, sent, m in scene.dive.tapped if channel == "mavlink" and not sent][-9:]
    shown = ["HEARTBEAT", "ATTITUDE", "SCALED_PRESSURE2", "STATUSTEXT", "VFR_HUD", "SYS_STATUS"]
    assert [m.get_type() for m, _ in scene.door.sent] == shown
    assert [bytes(m.get_msgbuf()) for m, _ in scene.door.sent] == [bytes(m.get_msgbuf()) for m in came[:6]]
    assert {to for _, to in scene.door.sent} == {HERE}


def test_telemetry_is_thinned_and_nobody_gets_it_when_nobody_is_there(scene: Scene) -> None:
    forwarding(scene)
    for _ in range(200):
        scene.clock.time += 0.02
        scene.person.heartbeat()
        scene.vehicle.attitude()
    assert 30 <= len(scene.door.heard("ATTITUDE")) <= 51
    scene.clock.time += LOST + 0.1
    scene.door.sent.clear()
    scene.vehicle.attitude()
    assert scene.door.sent == []
    assert "nobody" in scene.station.words


# On real sockets and threads


@pytest.fixture
def threaded() -> Iterator[tuple[Station, socket.socket, Dive]]:
    dive = Dive()
    dive.clock = time.monotonic  # type: ignore[assignment]
    dive.link._now = time.monotonic
    dive.link.operator_alive()
    with (
        Station("udpin:127.0.0.1:0", dive.link, now=time.monotonic) as station,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground,
    ):
        ground.settimeout(5.0)
        ground.connect(("127.0.0.1", station.port))
        yield station, ground, dive


def test_over_udp_a_station_steers_vanishes_and_sees_telemetry(
    threaded: tuple[Station, socket.socket, Dive],
) -> None:
    station, ground, dive = threaded
    person = Person(station, time.monotonic)
    for message in (
        dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3),
        dialect.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0),
        dialect.MAVLink_manual_control_message(1, 700, 0, 500, 0, 0),
    ):
        ground.send(person.pack(message))
    assert until(lambda: dive.link._motion.due(time.monotonic(), guided=False)[0] == Sticks(x=700))
    assert dialect.MAVLink(None).parse_buffer(ground.recv(2000))[0].get_type() == "STATUSTEXT"
    assert until(lambda: station.gone)
    assert dive.link._motion.due(time.monotonic(), guided=False)[0] == NEUTRAL
    station.close()
    assert not any(thread.name == "pilot" for thread in threading.enumerate())


@pytest.mark.parametrize("address", ["udpout:127.0.0.1:1", "127.0.0.1:14551", "udpin:14551", "udpin:h:99999"])
def test_an_address_that_is_none_is_told(address: str) -> None:
    dive = Dive()
    with pytest.raises(ValueError, match="udpin:HOST:PORT"):
        Station(address, dive.link, now=dive.clock)


def test_among_all_devices_it_sees_the_vehicle_and_is_in_the_log(tmp_path: Path) -> None:
    addresses = Addresses("udpin:127.0.0.1:0", "127.0.0.1:9", "rtp:0", "udpin:127.0.0.1:0")
    with (
        Devices(addresses, Instruments(), tmp_path, epoch_ns=1_795_000_000_000_000_000) as devices,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
    ):
        station = devices.station
        assert station is not None
        ground.settimeout(5.0)
        ground.connect(("127.0.0.1", station.port))
        ground.send(Person(station, devices.now).pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
        assert until(lambda: station.connected)
        speaker = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        beat = bytes(dialect.MAVLink_heartbeat_message(12, 3, 1, 19, 4, 3).pack(speaker))
        vehicle.sendto(beat, ("127.0.0.1", devices.link.port))
        assert ground.recv(2000) == beat
    assert [sent for _, sent, _ in read_wire(tmp_path / "log.mcap", "pilot")] == [False]
