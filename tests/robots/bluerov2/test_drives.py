"""The drives: what goes out on the wire, and what is left of it when all has to stop."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dream.geometry import SE2, SE3
from dream.robots.bluerov2.bridge import LEASE
from dream.robots.bluerov2.drives import (
    ASTRAY_DEPTH,
    ASTRAY_YAW,
    CLIMB_LAG,
    GENTLE,
    LEVEL_DEPTH,
    LEVEL_YAW,
    TURN_LAG,
    AltHold,
    Guided,
)
from dream.robots.bluerov2.limits import LastResort
from dream.robots.bluerov2.mavlink import PERIOD
from dream.robots.bluerov2.standin.lockstep import LockStep
from dream.robots.bluerov2.sticks import Joystick, Sticks
from dream.types import BodyVelocity
from dream.vehicle import VECTORED_6DOF
from tests.robots.bluerov2.diver import JOYSTICK, Diver, afloat
from tests.robots.bluerov2.test_bridge import fix_at

BEAT = 0.04


@dataclass
class Wire:
    """A link that only remembers."""

    age: float = 0.1
    own_altitude: float = -0.4
    """Half a metre above what our own reckoning has: the autopilot has its zero elsewhere."""
    own_altitude_from: str = "GLOBAL_POSITION_INT"
    time: float = 0.0
    mode: str = "ALT_HOLD"
    thrust: float = math.nan
    surfacing: str = ""
    sent: list[tuple[Sticks | BodyVelocity, float]] = field(default_factory=list)
    stops: int = 0
    modes: list[str] = field(default_factory=list)
    armed_by_other: str = ""
    yielding: str = ""

    @property
    def telemetry(self) -> SimpleNamespace:
        return SimpleNamespace(
            time=self.time,
            mode=self.mode,
            own_altitude=self.own_altitude,
            own_altitude_age=self.age,
            own_altitude_from=self.own_altitude_from,
            thrust=self.thrust,
            armed=True,
            heartbeat_age=0.1,
            imu_age=0.02,
            imu_heard=0.02,
            status_age=0.4,
            slipped="it was set",
            voltage=15.0,
            depth=0.9,
            leak=False,
            reboots=0,
        )

    def command(self, order: Sticks | BodyVelocity, expires: float) -> None:
        self.sent.append((order, expires))

    def stop(self) -> None:
        self.stops += 1

    def operator_alive(self) -> None:
        pass

    def set_mode(self, name: str) -> None:
        self.modes.append(name)


@dataclass
class Home:
    """A way home that is not gone."""

    begun: list[LastResort] = field(default_factory=list)

    def begin(self, how: LastResort) -> None:
        self.begun.append(how)


STICK_STEP = 0.001
"""m/s of a rate of climb that a stick of whole numbers can be off by."""


def alt_hold(wire: Wire) -> AltHold:
    drive = AltHold(wire, JOYSTICK, Home())  # type: ignore[arg-type]
    drive.begin(fix_at())
    return drive


def guided(wire: Wire) -> Guided:
    drive = Guided(wire, Joystick(thrusters=VECTORED_6DOF), Home())  # type: ignore[arg-type]
    drive.begin(fix_at())
    return drive


def steer(drive: AltHold | Guided, z: float, *, goal: SE2 | None = None, beats: int = 1) -> None:
    for k in range(beats):
        drive.steer(fix_at(time=0.04 * k), goal or SE2(0.0, 0.0, 0.0), z, 0.04, 1.0, 0.4)


@given(st.floats(-100.0, 100.0), st.sampled_from(["LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"]))
def test_where_the_autopilot_has_its_zero_changes_nothing_that_is_sent(zero: float, source: str) -> None:
    usual, other = Wire(), Wire(own_altitude=zero, own_altitude_from=source)
    for wire in (usual, other):
        steer(alt_hold(wire), -0.6, goal=SE2(0.3, 0.0, 0.4), beats=10)
    assert usual.sent == other.sent
    blind = Wire(own_altitude=math.nan, age=math.inf)
    steer(alt_hold(blind), -0.6, goal=SE2(0.3, 0.0, 0.4), beats=10)
    assert blind.sent == usual.sent


def test_where_all_has_to_stop_no_climb_is_left() -> None:
    wire = Wire()
    drive = alt_hold(wire)
    steer(drive, -0.4, beats=10)
    assert climbs(wire)[-1] > 0.0
    wire.sent.clear()
    drive.neutral()
    drive.neutral()
    assert (wire.stops, wire.sent) == (2, [])


def test_it_pushes_towards_its_goal_within_its_time() -> None:
    wire = Wire()
    drive = alt_hold(wire)
    steer(drive, -0.9, goal=SE2(1.0, 0.0, 0.0), beats=10)
    sticks, expires = wire.sent[-1]
    assert isinstance(sticks, Sticks)
    assert sticks.x > 100
    assert abs(sticks.y) < 50
    assert sticks.z == 500
    assert expires == 0.4
    wire.sent.clear()
    turning = alt_hold(wire)
    steer(turning, -0.9, goal=SE2(0.0, 0.0, 1.0), beats=10)
    # To the left is counter-clockwise; the stick counts the other way.
    assert wire.sent[-1][0].r < -50  # type: ignore[union-attr]


def test_by_velocities_it_goes_no_faster_than_it_may() -> None:
    wire = Wire()
    steer(guided(wire), -0.9, goal=SE2(3.0, 4.0, 0.0))
    velocity = wire.sent[-1][0]
    assert isinstance(velocity, BodyVelocity)
    assert math.hypot(velocity.surge, velocity.sway) == pytest.approx(GENTLE.speed)
    assert velocity.sway / velocity.surge == pytest.approx(4.0 / 3.0)
    assert velocity.heave == pytest.approx(0.0)
    for z, heave in ((-0.4, GENTLE.speed), (-9.0, -GENTLE.speed), (-0.8, 0.08), (-1.0, -0.08)):
        drive = guided(wire)
        steer(drive, z)
        velocity = wire.sent[-1][0]
        assert isinstance(velocity, BodyVelocity)
        assert velocity.heave == pytest.approx(heave)


def test_what_the_vehicle_says_is_passed_on() -> None:
    wire = Wire(yielding="another station", surfacing="a leak")
    craft = alt_hold(wire).craft()
    assert (craft.taken, craft.lost, craft.voltage) == ("another station", "", 15.0)
    assert (craft.surfacing, craft.slipped, craft.imu_heard, craft.status_age) == (
        "a leak",
        "it was set",
        0.02,
        0.4,
    )
    assert craft.own_depth == 0.4
    assert (craft.own_depth_from, craft.own_depth_age) == ("GLOBAL_POSITION_INT", 0.1)
    # What it said long ago is not what it is.
    wire.age = 2.0
    assert math.isnan(alt_hold(wire).craft().own_depth)


@pytest.mark.parametrize("how", LastResort)
def test_the_last_resort_is_left_to_the_way_home(how: LastResort) -> None:
    wire = Wire()
    drive = alt_hold(wire)
    drive.resort(how)
    drive.resort(how)
    assert drive.home.begun == [how, how]  # type: ignore[attr-defined]
    assert (wire.modes, wire.sent, wire.stops) == ([], [], 0)


def climbs(wire: Wire) -> list[float]:
    """m/s upwards that sticks ask for."""
    return [JOYSTICK.climb_rate(order) for order, _ in wire.sent if isinstance(order, Sticks)]


# Height


def climbed(
    goal: float, height: Callable[[deque[tuple[float, float]], float], float], seconds: float = 12.0
) -> Iterator[tuple[AltHold, float, float]]:
    """The drive, the rate of climb that its sticks ask for and the height, beat for beat.

    All heights are from where it begins. The height is made of where the reference was when, newest last,
    and of the time.
    """
    wire = Wire()
    drive = alt_hold(wire)
    references = deque([(0.0, 0.0)])
    for k in range(1, round(seconds / BEAT)):
        now = BEAT * k
        z = height(references, now)
        fix = fix_at(time=now, T_world_base=SE3.level(0.0, 0.0, z - 0.9, 0.0))
        drive.steer(fix, SE2(0.0, 0.0, 0.0), goal - 0.9, BEAT, 1.0, 0.4)
        references.append((now, drive._reference_z + 0.9))
        yield drive, climbs(wire)[-1], z


def climbing_late(references: deque[tuple[float, float]], now: float) -> float:
    """As far behind the reference as a vehicle is that follows it."""
    return [z for t, z in references if t <= now - CLIMB_LAG or t == 0.0][-1]


@pytest.mark.rare
@given(st.floats(-1.5, 1.5))
def test_a_vehicle_that_climbs_by_its_lag_is_asked_for_the_references_rate_and_no_more(goal: float) -> None:
    reference = 0.0
    for k, (drive, rate, _) in enumerate(climbed(goal, climbing_late)):
        moved, reference = drive._reference_z + 0.9 - reference, drive._reference_z + 0.9
        if BEAT * k > CLIMB_LAG:
            assert rate == pytest.approx(moved / BEAT, abs=STICK_STEP)
    # It comes to rest: then the autopilot holds the depth itself.
    assert rate == 0.0
    assert reference == pytest.approx(goal)


@pytest.mark.rare
@settings(max_examples=20)
@given(st.floats(-1.0, 1.0), st.floats(0.3, 0.9), st.floats(0.0, 0.5))
def test_a_depth_that_answers_late_comes_to_rest_and_overshoots_by_no_more_than_its_lag_was_misjudged(
    goal: float, lag: float, slow: float
) -> None:
    """Part of the lag is a delay, part of it (`slow`) the time of a loop that is slow to speed up."""
    delay = lag * (1.0 - slow)
    asked: deque[tuple[float, float]] = deque([(0.0, 0.0)])
    state = [0.0, 0.0]

    def height(references: deque[tuple[float, float]], now: float) -> float:
        while len(asked) > 1 and asked[1][0] <= now - delay:
            asked.popleft()
        state[1] += min(BEAT / max(lag * slow, BEAT), 1.0) * (asked[0][1] - state[1])
        state[0] += BEAT * state[1]
        return state[0]

    most, rates = 0.0, []
    for k, (_, rate, z) in enumerate(climbed(goal, height, 20.0)):
        asked.append((BEAT * (k + 1), rate))
        rates.append(rate)
        most = max(most, math.copysign(1.0, goal) * z)
    misjudged = abs(lag - CLIMB_LAG) + 2.0 * BEAT
    assert most - abs(goal) < GENTLE.speed * misjudged + LEVEL_DEPTH
    assert abs(z - goal) < ASTRAY_DEPTH
    # No limit cycle: for the last eight seconds nothing is asked for.
    assert set(rates[-200:]) == {0.0}


@pytest.mark.parametrize("goal", [1.0, -1.0])
def test_one_that_cannot_climb_as_fast_as_its_reference_gets_there_late_and_no_further(goal: float) -> None:
    state = [0.0, 0.0]

    def height(references: deque[tuple[float, float]], now: float) -> float:
        state[0] += BEAT * max(min(state[1], 0.1), -0.1)
        return state[0]

    most = 0.0
    for _, rate, z in climbed(goal, height, 16.0):
        state[1] = rate
        most = max(most, math.copysign(1.0, goal) * z)
    assert most < abs(goal) + LEVEL_DEPTH
    assert abs(z - goal) < ASTRAY_DEPTH
    assert rate == 0.0


@given(st.lists(st.floats(-0.99, 0.99), min_size=5, max_size=40))
def test_what_its_depth_hunts_by_itself_is_left_to_the_autopilot(shares: list[float]) -> None:
    errors = iter([0.0] * 20 + [share * ASTRAY_DEPTH for share in shares] + [0.0] * 1000)
    for _, rate, _ in climbed(0.0, lambda references, now: next(errors), 3.0):
        assert rate == 0.0


@given(st.floats(1.02, 20.0), st.sampled_from([-1.0, 1.0]))
def test_a_depth_astray_is_brought_back_until_it_is_level(astray: float, side: float) -> None:
    error = side * astray * ASTRAY_DEPTH
    levels = [0.0] * 20 + [error] * 5 + [side * 1.02 * LEVEL_DEPTH] * 5 + [side * 0.98 * LEVEL_DEPTH] * 1000
    heights = iter(levels)
    rates = [rate for _, rate, _ in climbed(0.0, lambda references, now: next(heights), 2.0)]
    assert rates[:20] == [0.0] * 20
    assert all(side * rate < 0.0 for rate in rates[20:30])
    assert set(rates[30:]) == {0.0}


@given(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.sampled_from([1.0, 0.4]))
def test_it_climbs_no_faster_than_it_may_wherever_it_is_and_is_sent(
    z: float, goal: float, pace: float
) -> None:
    wire = Wire()
    drive = alt_hold(wire)
    for k in range(30):
        fix = fix_at(time=BEAT * k, T_world_base=SE3.level(0.0, 0.0, z, 0.0))
        drive.steer(fix, SE2(0.0, 0.0, 0.0), goal, BEAT, pace, 0.4)
    assert max(map(abs, climbs(wire))) <= 1.5 * pace * GENTLE.speed + STICK_STEP


def test_begun_anew_it_makes_up_for_nothing() -> None:
    wire = Wire()
    drive = alt_hold(wire)
    steer(drive, -0.4, beats=50)
    # Somebody else had it, and left it elsewhere.
    below = fix_at(time=10.0, T_world_base=SE3.level(0.0, 0.0, -2.0, 0.0))
    drive.begin(below)
    wire.sent.clear()
    drive.steer(below, SE2(0.0, 0.0, 0.0), -2.0, BEAT, 1.0, 10.4)
    assert climbs(wire) == [0.0]
    drive.steer(below, SE2(0.0, 0.0, 0.0), -0.4, BEAT, 1.0, 10.4)
    # The reference sets out from there, at its speed, and no faster.
    assert climbs(wire)[-1] == pytest.approx(GENTLE.speed, abs=STICK_STEP)


# Heading


def turned(
    goal: float, heading: Callable[[deque[tuple[float, float]], float], float], seconds: float = 12.0
) -> Iterator[tuple[Guided, BodyVelocity, float]]:
    """The drive, what it asks for and the heading, beat for beat.

    The heading is made of where the reference was when, newest last, and of the time.
    """
    wire = Wire()
    drive = guided(wire)
    references = deque([(0.0, 0.0)])
    for k in range(1, round(seconds / BEAT)):
        now = BEAT * k
        yaw = heading(references, now)
        fix = fix_at(time=now, T_world_base=SE3.level(0.0, 0.0, -0.9, yaw))
        drive.steer(fix, SE2(0.0, 0.0, goal), -0.9, BEAT, 1.0, 0.4)
        assert drive._helm is not None
        references.append((now, float(drive._helm.memory[3])))
        order = wire.sent[-1][0]
        assert isinstance(order, BodyVelocity)
        yield drive, order, yaw


def lagging(references: deque[tuple[float, float]], now: float) -> float:
    """As far behind the reference as a vehicle is that follows it."""
    return [yaw for t, yaw in references if t <= max(now - TURN_LAG, 0.0)][-1]


@pytest.mark.rare
@given(st.floats(-3.1, 3.1))
def test_a_vehicle_that_follows_by_its_lag_is_asked_for_the_references_rate_and_no_more(goal: float) -> None:
    for k, (drive, order, _) in enumerate(turned(goal, lagging)):
        assert drive._helm is not None
        if BEAT * k > TURN_LAG:
            assert order.yaw_rate == pytest.approx(float(drive._helm.memory[7]), abs=1e-6)
    # It comes to rest, whatever rounding leaves of it: then the autopilot holds the heading itself.
    assert order.yaw_rate == 0.0


@settings(max_examples=20)
@given(st.floats(-3.1, 3.1), st.floats(0.2, 0.5))
def test_a_heading_that_answers_late_overshoots_by_no_more_than_its_lag_was_misjudged(
    goal: float, lag: float
) -> None:
    rates: deque[tuple[float, float]] = deque([(0.0, 0.0)])
    state = [0.0]

    def heading(references: deque[tuple[float, float]], now: float) -> float:
        while len(rates) > 1 and rates[1][0] <= now - lag:
            rates.popleft()
        state[0] += BEAT * rates[0][1]
        return state[0]

    most = 0.0
    for k, (_, order, yaw) in enumerate(turned(goal, heading)):
        rates.append((BEAT * (k + 1), order.yaw_rate))
        most = max(most, math.copysign(1.0, goal) * yaw)
    misjudged = abs(lag - TURN_LAG) + 2.0 * BEAT
    assert most - abs(goal) < GENTLE.turn_rate * misjudged
    assert abs(yaw - goal) < ASTRAY_YAW
    assert order.yaw_rate == 0.0


@given(st.lists(st.floats(-0.99, 0.99), min_size=5, max_size=40))
def test_what_the_autopilot_hunts_by_itself_is_left_to_it(shares: list[float]) -> None:
    errors = iter([0.0] * 12 + [share * ASTRAY_YAW for share in shares] + [0.0] * 1000)
    for _, order, _ in turned(0.0, lambda references, now: next(errors), 3.0):
        assert order.yaw_rate == 0.0


@given(st.floats(1.02, 20.0), st.sampled_from([-1.0, 1.0]))
def test_astray_it_is_turned_back_until_it_is_level(astray: float, side: float) -> None:
    # By velocities it is left alone within twice as much: there a rate of 0 is no heading hold.
    error, level = side * astray * 1.6 * ASTRAY_YAW, side * 2.0 * LEVEL_YAW
    levels = iter([0.0] * 12 + [error] * 5 + [1.02 * level] * 5 + [0.98 * level] * 1000)
    rates = [order.yaw_rate for _, order, _ in turned(0.0, lambda references, now: next(levels), 2.0)]
    assert rates[:12] == [0.0] * 12
    assert all(side * rate < 0.0 for rate in rates[12:22])
    assert set(rates[22:]) == {0.0}


# Effort


def test_the_effort_of_sticks_is_the_hardest_and_that_of_velocities_the_thrust() -> None:
    wire = Wire()
    drive = alt_hold(wire)
    assert drive.effort == 0.0
    steer(drive, -0.9, goal=SE2(3.0, 0.0, 0.0), beats=40)
    sticks = wire.sent[-1][0]
    assert isinstance(sticks, Sticks)
    assert drive.effort == max(abs(sticks.x), abs(sticks.y), abs(sticks.r)) / 1000.0 > 0.1
    by_velocity = guided(wire)
    assert by_velocity.effort == 0.0
    wire.thrust = 0.7
    assert by_velocity.effort == 0.7


# With a link and a vehicle


def steered(drive: AltHold, diver: Diver, depth: float, seconds: float) -> None:
    """Hold it to a depth for a while, by its true one."""
    clock = diver.clock
    end = clock() + seconds
    while clock() < end:
        fix = fix_at(time=clock(), T_world_base=SE3.level(0.0, 0.0, -diver.depth, 0.0))
        drive.steer(fix, SE2(0.0, 0.0, 0.0), -depth, BEAT, 1.0, clock() + LEASE)
        clock.sleep(BEAT)


def in_water(link: Any, depth: float) -> AltHold:
    drive = AltHold(link, JOYSTICK, Home())  # type: ignore[arg-type]
    drive.begin(fix_at(T_world_base=SE3.level(0.0, 0.0, -depth, 0.0)))
    return drive


@pytest.mark.few(3)
@pytest.mark.parametrize("to", [2.6, 3.4])
@pytest.mark.parametrize("placed", [False, True])
@pytest.mark.parametrize("zero", [0.0, 49.0, -49.0])
def test_it_goes_to_a_depth_and_stays_whatever_its_autopilot_counts_from(
    zero: float, placed: bool, to: float
) -> None:
    diver = Diver(LockStep(), depth=3.0, zero=zero, placed=placed)
    with afloat(diver) as link:
        drive = in_water(link, diver.depth)
        steered(drive, diver, to, 6.0)
        before = len(diver.history)
        steered(drive, diver, to, 10.0)
        assert {abs(depth - to) < ASTRAY_DEPTH for _, depth, _, _ in diver.history[before:]} == {True}
        # At rest nothing is asked for any more.
        assert {m.z for m in diver.heard("MANUAL_CONTROL", since=diver.clock() - 5.0)} == {500}


@pytest.mark.parametrize("stopped", [True, False], ids=["neutral", "a loop that died"])
def test_a_climb_ends_with_neutral_at_once_and_with_a_dead_loop_within_the_lease(stopped: bool) -> None:
    diver = Diver(LockStep(), depth=3.0)
    with afloat(diver) as link:
        drive = in_water(link, diver.depth)
        steered(drive, diver, 1.0, 3.0)
        ended, depth = diver.clock(), diver.depth
        assert depth < 2.8
        if stopped:
            drive.neutral()
        for _ in range(30):
            link.operator_alive()
            diver.clock.sleep(0.1)
        late = {m.z for m in diver.heard("MANUAL_CONTROL", ended + (0.0 if stopped else LEASE + PERIOD))}
        assert late == {500}
        assert depth - diver.depth <= GENTLE.speed * 1.1 * (BEAT if stopped else LEASE + 2.0 * PERIOD) + 0.02
