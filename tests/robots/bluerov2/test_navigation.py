"""The navigator: from messages of real devices to a pose, and a clear no where there is none."""

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from dream.geometry import SE2, SE3, wrap_angle
from dream.measurements import Depth, Dvl, Heading, Imu, Measurement
from dream.robots.bluerov2.navigation import (
    CLIMBED,
    ESTIMATORS,
    GAUGE_DRIFTS,
    HEADING_JUMP,
    HEADING_MISSED,
    HEADING_STUCK,
    SAME_VELOCITIES,
    Fix,
    Instruments,
    Navigator,
    NotReady,
)
from dream.robots.bluerov2.standin.ardusub import ArduSub
from dream.robots.bluerov2.standin.helm import ALT_HOLD
from dream.robots.bluerov2.standin.tank import Tank
from dream.sim.worlds import make_world

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
            # None of a real one says the same twice.
            velocity = np.array([surge, 0.0, 0.0]) + np.cross([0.0, 0.0, yaw_rate], lever)
            velocity += 1e-4 * rng.standard_normal(3)
            said.append(Dvl(time, velocity, 1e-5 * np.eye(3), altitude + lever[2], True))
    return said, SE2(x, y, wrap_angle(yaw))


def aligned(estimator: str = "inekf") -> Navigator:
    clock = [3.0]
    navigator = Navigator(Instruments(estimator=estimator), lambda: clock[0])
    navigator.align(START, messages(0.0, 3.0)[0])
    return navigator


@pytest.mark.few(3)
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


def sinking(
    seconds: float, rate: float, altitude: Callable[[float], float], late: float = 0.0
) -> list[Imu | Measurement]:
    """What all sensors say of a vehicle that goes down evenly from its launch; DVL reports come later."""
    lever = np.asarray(Instruments().mounting.T_base_dvl.translation)
    said: list[tuple[float, Imu | Measurement]] = []
    for k in range(1, round(seconds * RATE) + 1):
        passed = k / RATE
        time, z = 3.0 + passed, -0.9 - rate * passed
        said.append((time, Imu(time, BIAS, np.array([0.0, 0.0, 9.81]))))
        if k % 5 == 0:
            said.append((time, Depth(time, z, 0.005)))
            said.append((time, Heading(time, wrap_angle(START.yaw + COMPASS_OFF), 0.02)))
            # One that is never the same to the last bit.
            velocity = np.array([0.0, 0.0, -rate + 1e-9 * k])
            said.append((time + late, Dvl(time, velocity, 1e-5 * np.eye(3), altitude(z + lever[2]), True)))
    return [message for _, message in sorted(said, key=lambda pair: pair[0])]


def test_an_altitude_that_does_not_change_with_the_depth_is_named() -> None:
    clock = [3.0]
    navigator = Navigator(Instruments(), lambda: clock[0])
    navigator.align(START, messages(0.0, 3.0)[0])
    fix = navigator.update()
    assert fix.altitude_problem == ""
    assert fix.seabed == pytest.approx(-1.5, abs=0.01)
    assert fix.altitude_age < 0.2
    found = math.inf
    for message in sinking(4.0, 0.2, lambda z: 0.5):
        navigator.deliver(message)
        clock[0] = message.time
        fix = navigator.update()
        if fix.altitude_problem:
            found = min(found, message.time)
    assert fix.altitude_problem == "the DVL's altitude is stuck at 0.5 m"
    assert math.isnan(fix.seabed)
    assert math.isnan(fix.altitude)
    assert fix.altitude_age == pytest.approx(7.0 - found, abs=0.2)
    # A way down of 0.2 m, and no longer than it takes to see that.
    assert found - 3.0 < 0.2 / 0.2 + 3.0


@pytest.mark.parametrize("late", [0.0, 0.4])
def test_an_altitude_is_held_against_the_height_of_its_own_time(late: float) -> None:
    navigator = Navigator(Instruments(), lambda: 7.0)
    navigator.align(START, messages(0.0, 3.0, altitude=1.4)[0])
    floors = []
    for message in sinking(4.0, 0.2, lambda z: z + 2.3, late):
        navigator.deliver(message)
        fix = navigator.update()
        floors.append(fix.seabed)
        assert fix.altitude_problem == ""
    assert floors[-1] == pytest.approx(-2.3, abs=0.03)


def test_messages_that_were_lost_are_the_end_of_the_estimate() -> None:
    navigator = aligned()
    for message in messages(3.0, 70.0)[0]:
        navigator.deliver(message)
    with pytest.raises(NotReady, match="others are lost"):
        navigator.update()


def test_an_estimator_that_there_is_not_is_named() -> None:
    with pytest.raises(ValueError, match="expected one of inekf, ekf, cipg"):
        Instruments(estimator="ukf")


# Headings that jump, stand still, or are turned by whoever turns


Message = Imu | Measurement
Spoil = Callable[[Message], Message | None]
"""What becomes of a message; None where it is lost."""


def follow(navigator: Navigator, said: list[Message], spoil: Spoil = lambda message: message) -> list[Fix]:
    """The estimate after each tenth of a second of messages, as they come in."""
    fixes, due = [], said[0].time
    navigator._now = lambda: now
    for message in said:
        now = message.time
        came = spoil(message)
        if came is not None:
            navigator.deliver(came)
        if now >= due:
            due += 0.1
            fixes.append(navigator.update())
    fixes.append(navigator.update())
    return fixes


def turned_by(jump: float, since: float) -> Spoil:
    def spoil(message: Message) -> Message:
        if isinstance(message, Heading) and message.time > since:
            return replace(message, yaw=wrap_angle(message.yaw + jump))
        return message

    return spoil


@pytest.mark.few(3)
@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("jump_deg", [3.8, -3.8, 20.0, 179.0])
def test_a_heading_that_jumps_under_way_has_a_new_zero_and_nobody_is_turned(
    jump_deg: float, estimator: str
) -> None:
    jump = math.radians(jump_deg)
    navigator, steady = aligned(estimator), aligned(estimator)
    said, end = messages(3.0, 8.0, surge=0.2, yaw_rate=0.15)
    fix, same = follow(navigator, said, turned_by(jump, since=6.0))[-1], follow(steady, said)[-1]
    ((time, by),) = navigator.new_zeros
    assert time == pytest.approx(6.0, abs=0.11)
    assert by == pytest.approx(jump, abs=math.radians(0.5))
    assert abs(wrap_angle(fix.T_world_base.yaw - end.yaw)) < math.radians(3.0)
    # All that is left of it is what the vehicle turned between two headings, by gyroscopes alone.
    assert abs(wrap_angle(fix.T_world_base.yaw - same.T_world_base.yaw)) < math.radians(0.5)
    assert fix.T_world_base.se2.distance(same.T_world_base.se2) < 0.01
    assert steady.new_zeros == []


LEAST_JUMP = HEADING_JUMP + HEADING_MISSED * 0.1
"""Of a new zero, with ten headings a second: less may be what the gyroscopes missed between two."""


@settings(max_examples=10)
@given(st.lists(st.floats(-math.pi, math.pi).filter(lambda jump: abs(jump) > 1.1 * LEAST_JUMP), max_size=4))
@example([1.11 * LEAST_JUMP, -1.11 * LEAST_JUMP])
def test_any_number_of_new_zeros_leaves_the_map_where_it_was(jumps: list[float]) -> None:
    navigator = aligned()
    said, end = messages(3.0, 6.0, surge=0.1, yaw_rate=-0.2)

    def spoil(message: Message) -> Message | None:
        for k, jump in enumerate(jumps):
            turned = turned_by(jump, since=4.0 + k)(message)
            assert turned is not None
            message = turned
        return message

    fix = follow(navigator, said, spoil)[-1]
    zeros = [by for _, by in navigator.new_zeros]
    # Half a turn is one either way.
    assert len(zeros) == len(jumps)
    assert all(abs(wrap_angle(by - jump)) < 0.01 for by, jump in zip(zeros, jumps, strict=True))
    assert abs(wrap_angle(fix.T_world_base.yaw - end.yaw)) < math.radians(1.0)


def turn_of_90_degrees(begins: float = 3.0) -> tuple[list[Message], SE2]:
    """At 60° a second, and what is said in the second after."""
    turning, pose = messages(begins, 1.5, yaw_rate=math.radians(60.0))
    resting, pose = messages(begins + 1.5, 1.5, pose=pose)
    assert abs(wrap_angle(pose.yaw - START.yaw - math.radians(90.0))) < 1e-6
    return turning + resting, pose


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_vehicle_that_really_turns_has_the_zero_that_it_had(estimator: str) -> None:
    navigator = aligned(estimator)
    said, end = turn_of_90_degrees()
    fix = follow(navigator, said)[-1]
    assert navigator.new_zeros == []
    assert abs(wrap_angle(fix.T_world_base.yaw - end.yaw)) < math.radians(3.0)


def test_what_was_turned_while_nothing_was_heard_is_no_new_zero() -> None:
    # The link is dead for the last 0.7 s of the turn: nobody knows how far it went meanwhile.
    navigator = aligned()
    said, end = turn_of_90_degrees()
    fix = follow(navigator, said, lambda message: None if 3.8 < message.time <= 4.5 else message)[-1]
    assert navigator.new_zeros == []
    assert abs(wrap_angle(fix.T_world_base.yaw - end.yaw)) < math.radians(6.0)


def test_headings_that_are_lost_while_it_turns_are_no_new_zero() -> None:
    navigator = aligned()
    said, _ = turn_of_90_degrees()
    follow(navigator, said, lambda m: None if isinstance(m, Heading) and 3.2 < m.time < 4.3 else m)
    assert navigator.new_zeros == []


@pytest.mark.parametrize("estimator", ["inekf", "dead-reckoning"])
def test_a_heading_that_stands_still_while_the_vehicle_turns_grows_old_and_turns_it_back_no_more(
    estimator: str,
) -> None:
    navigator = aligned(estimator)
    said, end = messages(3.0, 5.0, yaw_rate=math.radians(46.0))
    frozen: list[float] = []

    def spoil(message: Message) -> Message:
        if isinstance(message, Heading) and message.time > 4.0:
            frozen.append(message.yaw)
            return replace(message, yaw=frozen[0])
        return message

    fixes = follow(navigator, said, spoil)
    for fix in fixes:
        if fix.time > 4.0 + HEADING_STUCK + 0.3:
            assert fix.heading_age == pytest.approx(fix.time - 4.0, abs=HEADING_STUCK + 0.2)
        else:
            assert fix.heading_age < HEADING_STUCK + 0.4
    assert fixes[-1].heading_age > 3.4
    assert navigator.refused["heading: the same to the last bit"] > 25
    assert abs(wrap_angle(fixes[-1].T_world_base.yaw - end.yaw)) < math.radians(4.0)
    # It goes on again, and what was turned meanwhile is no new zero.
    more, _ = messages(8.0, 1.0, pose=end, yaw_rate=0.1)
    assert follow(navigator, more)[-1].heading_age < 0.2
    assert navigator.new_zeros == []


def test_only_what_the_estimate_takes_is_young() -> None:
    navigator = aligned()
    said, _ = messages(3.0, 3.0)
    late: deque[Message] = deque()

    def spoil(message: Message) -> Message | None:
        """From 4 s on inertial samples come in 1.5 s late, which is too late for any."""
        if not isinstance(message, Imu) or message.time < 4.0:
            return message
        late.append(message)
        return late.popleft() if late[0].time < message.time - 1.5 else None

    fix = follow(navigator, said, spoil)[-1]
    assert fix.imu_age > 1.4


@pytest.mark.parametrize("kind", [Dvl, Depth, Heading])
def test_what_is_no_number_is_as_good_as_none(kind: type) -> None:
    navigator = aligned()
    said, _ = messages(3.0, 3.0, yaw_rate=0.1)
    none = {Dvl: {"velocity": np.full(3, np.nan)}, Depth: {"z": math.nan}, Heading: {"yaw": math.nan}}[kind]
    fix = follow(navigator, said, lambda m: replace(m, **none) if isinstance(m, kind) else m)[-1]  # type: ignore[arg-type]
    ages = {Dvl: fix.dvl_age, Depth: fix.depth_age, Heading: fix.heading_age}
    assert ages.pop(kind) > 2.8
    assert max(ages.values()) < 0.2


def test_a_dvl_that_repeats_itself_to_the_last_bit_is_none_after_the_third_time() -> None:
    navigator = aligned()
    said, end = messages(3.0, 6.0, surge=0.2)
    frozen: list[np.ndarray] = []

    def spoil(message: Message) -> Message:
        if isinstance(message, Dvl) and 5.0 < message.time < 7.0:
            frozen.append(message.velocity)
            return replace(message, velocity=frozen[0], altitude=0.6 + 0.01 * len(frozen))
        return message

    fixes = follow(navigator, said, spoil)
    assert navigator.refused["dvl: the same to the last bit"] == len(frozen) - SAME_VELOCITIES
    stuck = next(fix for fix in fixes if fix.time > 6.8)
    # Of one that stands still the altitude is none either.
    assert stuck.dvl_age == pytest.approx(6.8 - 5.1 - 0.1 * (SAME_VELOCITIES - 1), abs=0.15)
    assert stuck.altitude == pytest.approx(0.6 + 0.01 * SAME_VELOCITIES)
    # It goes on again as soon as it says something else, or says that it has no bottom.
    assert fixes[-1].dvl_age < 0.15
    assert fixes[-1].T_world_base.se2.distance(end) < 0.05


def test_a_dvl_without_bottom_may_say_the_same_for_ever() -> None:
    navigator = aligned()
    said, _ = messages(3.0, 3.0)
    lost = {"velocity": np.zeros(3), "valid": False}
    follow(navigator, said, lambda m: replace(m, **lost) if isinstance(m, Dvl) else m)  # type: ignore[arg-type]
    assert "dvl: the same to the last bit" not in navigator.refused


# Gauge and DVL


@given(st.floats(-0.3, 0.3), st.floats(1.0, 30.0))
@settings(max_examples=10)
def test_what_gauge_and_dvl_climb_differently_is_forgotten_in_its_time(rate: float, seconds: float) -> None:
    navigator = aligned("dead-reckoning")
    said, _ = messages(3.0, seconds)
    drifting = [replace(m, z=m.z + rate * (m.time - 3.0)) if isinstance(m, Depth) else m for m in said]
    fix = follow(navigator, drifting)[-1]
    # dx/dt = rate - x / CLIMBED.
    known = rate * CLIMBED * -math.expm1(-(seconds - 0.1) / CLIMBED)
    assert fix.drifts == pytest.approx(known, abs=0.01 + 0.02 * abs(known))


class Swim:
    """The tank's vehicle with the tank's own instruments, sent about by a pilot who cannot keep still."""

    def __init__(self, seed: int) -> None:
        self.tank = Tank(make_world("pool/arc", 1), seed=seed)
        self.sub = ArduSub(self.tank, lambda *_: None)
        self.navigator = Navigator(Instruments(), lambda: self.tank.time)
        self.writer = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        self.rng = np.random.default_rng(seed)
        self.pings: deque[tuple[float, Dvl]] = deque()
        self.goal, self.turn = np.array([0.0, 0.0, -0.6]), 0
        heard: list[Message] = []
        for _ in range(300):
            heard.extend(self.said())
        self.navigator.align(self.tank.T_world_base.se2, heard)
        self.sub.set_mode(ALT_HOLD)
        self.sub.arm()

    def said(self) -> Iterator[Message]:
        """What is heard in a beat."""
        tank = self.tank
        tank.advance(self.sub.commands)
        self.sub.beat()
        if tank.beats % 2 == 0:
            yield tank.imu
            yield Heading(tank.time, self.sub.ahrs.euler[2], 0.05)
        if tank.beats % 10 == 0:
            yield tank.depth
        if tank.beats % 12 == 0:
            ping = tank.ping()
            self.pings.append((ping.arrives, ping.dvl))
        while self.pings and self.pings[0][0] <= tank.time:
            yield self.pings.popleft()[1]

    def pilot(self) -> None:
        tank, rng = self.tank, self.rng
        if tank.beats % 300 == 0:
            self.goal = rng.uniform((-1.2, -1.2, -1.0), (1.2, 1.2, -0.3))
            self.turn = int(rng.choice([0, 600, -600]))
        T = tank.T_world_base
        ahead, left, up = T.rotation.T @ (self.goal - T.translation)
        x, y = (int(min(max(250 * value, -250), 250)) for value in (ahead, -left))
        z = int(min(max(500 + 500 * up, 250), 750))
        sticks = dialect.MAVLink_manual_control_message(1, x, y, z, self.turn, 0)
        self.sub.hear(bytes(sticks.pack(self.writer)))

    def swim(self, seconds: float, spoil: Spoil = lambda message: message) -> Iterator[Fix]:
        for _ in range(round(100 * seconds)):
            if self.tank.beats % 10 == 0:
                self.pilot()
            for message in self.said():
                came = spoil(message)
                if came is not None:
                    self.navigator.deliver(came)
            if self.tank.beats % 4 == 0:
                yield self.navigator.update()


@pytest.mark.rare
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_honest_dive_keeps_its_zeros_and_its_gauge(seed: int) -> None:
    swim = Swim(seed)
    fixes = list(swim.swim(30.0))
    assert max(abs(fix.drifts) for fix in fixes) < 0.4 * GAUGE_DRIFTS
    assert swim.navigator.new_zeros == []
    assert max(fix.heading_age for fix in fixes) < 0.2
    assert "heading: the same to the last bit" not in swim.navigator.refused


def sliding(swim: Swim, rate: float) -> Spoil:
    began = swim.tank.time
    return lambda m: replace(m, z=m.z + rate * (m.time - began)) if isinstance(m, Depth) else m


def rising(swim: Swim, rate: float) -> Spoil:
    return lambda m: replace(m, velocity=m.velocity + np.array([0.0, 0.0, rate])) if isinstance(m, Dvl) else m


@pytest.mark.few(3)
@pytest.mark.parametrize("rate", [0.05, -0.05])
@pytest.mark.parametrize("fault", [sliding, rising])
def test_a_gauge_or_a_floor_that_moves_by_five_centimetres_a_second_is_told_within_ten(
    fault: Callable[[Swim, float], Spoil], rate: float
) -> None:
    swim = Swim(5)
    list(swim.swim(5.0))
    began = swim.tank.time
    parted = next(fix for fix in swim.swim(20.0, fault(swim, rate)) if abs(fix.drifts) > GAUGE_DRIFTS)
    assert swim.tank.time - began < 10.0 + 0.5
    assert (parted.drifts > 0.0) == ((rate > 0.0) == (fault is sliding))
