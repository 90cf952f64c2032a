"""What DREAM relies on of an ArduSub, whether it is a vehicle, its simulator (SITL) or our stand-in."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from dream.geometry import wrap_angle
from dream.measurements import Depth, Heading, Imu
from dream.robots.bluerov2.mavlink import Link, Refused
from dream.robots.bluerov2.motion import Order
from dream.robots.bluerov2.sticks import Joystick
from dream.robots.bluerov2.telemetry import Measurement
from dream.robots.bluerov2.threads import REAL_TIME, Threads
from dream.types import BodyVelocity

TURN = 0.4
"""rad/s that are asked for."""
CLIMB = 0.2
"""m/s, likewise."""
SILENT = 12.0
"""Seconds within which it is to act on a silent station: the link speaks on for 3 of them."""


@dataclass(slots=True)
class Subject:
    """An ArduSub, and what may be done with it."""

    link: Link
    heard: list[Measurement]
    """Filled by the link."""
    moves: bool
    """May it be armed and moved?"""
    fails: bool
    """May it be left to its failsafes?"""
    has_position: bool
    threads: Threads = REAL_TIME
    """What it lives by: a simulated one may have a clock of its own."""

    def wait(self, seconds: float, order: Order | None = None) -> None:
        """Let time pass, alive, with an order renewed all the while."""
        now = self.threads.monotonic
        until = now() + seconds
        while (left := until - now()) > 0.0:
            self.link.operator_alive()
            if order is not None:
                self.link.command(order, self.link._now() + min(0.2, left))
            self.threads.sleep(min(0.05, left))

    def until(self, true: Callable[[], bool], seconds: float) -> bool:
        """Let time pass, alive, until something is true; is it?"""
        end = self.threads.monotonic() + seconds
        while not true() and self.threads.monotonic() < end:
            self.wait(0.1)
        return true()

    def climbs_to(self, depth: float, joystick: Joystick, seconds: float) -> bool:
        """Go to a depth by rates of climb, and order nothing any more once it is there; is it?"""
        end = self.threads.monotonic() + seconds
        while abs(lacking := self.depth - depth) > 0.05 and self.threads.monotonic() < end:
            rate = min(max(0.5 * lacking, -CLIMB), CLIMB)
            self.wait(0.1, joystick.sticks(0.0, 0.0, climb_rate=rate))
        return abs(lacking) <= 0.05

    @property
    def depth(self) -> float:
        return self.link.telemetry.depth

    @property
    def yaw(self) -> float:
        """Radians, counter-clockwise from east."""
        return next(m.yaw for m in reversed(self.heard) if isinstance(m, Heading))

    @property
    def turn_rate(self) -> float:
        """rad/s to the left, over the last ten samples."""
        samples = [m.angular_velocity[2] for m in self.heard[-200:] if isinstance(m, Imu)]
        return float(np.mean(samples[-10:]))


class Answers:
    """What it says, disarmed. A subclass gives `subject`."""

    def test_it_connects_and_says_which_version_it_is(self, subject: Subject) -> None:
        assert subject.link.connected
        major, minor, _ = map(int, subject.link.telemetry.version.split("."))
        assert (major, minor) >= (4, 1)
        assert not subject.link.telemetry.armed

    def test_it_sends_what_it_was_asked_for(self, subject: Subject) -> None:
        subject.heard.clear()
        subject.wait(2.0)
        for kind, least in ((Imu, 40), (Heading, 40), (Depth, 10)):
            assert sum(isinstance(message, kind) for message in subject.heard) >= least, kind
        force = np.mean([m.specific_force for m in subject.heard if isinstance(m, Imu)], axis=0)
        # At rest and about level the accelerometers feel what holds it up: +z of `base`.
        assert 9.0 < force[2] < 10.5
        times = [m.time for m in subject.heard if isinstance(m, Imu)]
        assert all(a < b for a, b in itertools.pairwise(times))

    def test_a_parameter_is_read_set_and_put_back(self, subject: Subject) -> None:
        link = subject.link
        before = link.param("PILOT_SPEED_UP")
        link.set_param("PILOT_SPEED_UP", before + 7.0)
        assert link.param("PILOT_SPEED_UP") == before + 7.0
        assert link.restore().done == {"PILOT_SPEED_UP": before}
        assert link.param("PILOT_SPEED_UP") == before

    def test_a_parameter_that_it_does_not_have_is_told(self, subject: Subject) -> None:
        with pytest.raises(TimeoutError, match="NO_SUCH_THING"):
            subject.link.param("NO_SUCH_THING")

    def test_what_safety_hangs_on_can_be_read(self, subject: Subject) -> None:
        values = {check.name: check.value for check in subject.link.check_parameters()}
        for name in (
            "FS_PILOT_INPUT",
            "FS_PILOT_TIMEOUT",
            "FS_GCS_ENABLE",
            "FRAME_CONFIG",
            "JS_GAIN_DEFAULT",
        ):
            assert math.isfinite(values[name]), name
        assert subject.link.joystick().thrusters.count in (6, 8)

    def test_modes_change_where_no_position_is_needed(self, subject: Subject) -> None:
        for name in ("STABILIZE", "ALT_HOLD", "MANUAL"):
            subject.link.set_mode(name)
            assert subject.link.telemetry.mode == name
        assert subject.link.yielding == ""

    def test_guided_is_refused_without_a_position(self, subject: Subject) -> None:
        if subject.has_position:
            pytest.skip("it has a position")
        with pytest.raises(Refused, match=r"(?i)position"):
            subject.link.set_mode("GUIDED")
        assert subject.link.telemetry.mode != "GUIDED"
        assert subject.link.yielding == ""


class Moves:
    """What it does, armed. A subclass gives `subject`."""

    @pytest.fixture
    def swimming(self, subject: Subject) -> Iterator[Subject]:
        """Armed in ALT_HOLD, at rest; disarmed afterwards."""
        if not subject.moves:
            pytest.skip("it may not be moved: DREAM_ARDUSUB_MOVE=1 allows that")
        link = subject.link
        link.set_mode("ALT_HOLD")
        link.arm()
        try:
            yield subject
        finally:
            if link.telemetry.armed:
                link.disarm()
            link.resume()

    def test_it_arms_holds_its_depth_and_disarms(self, swimming: Subject) -> None:
        link = swimming.link
        assert link.engaged
        swimming.wait(1.0)
        before = swimming.depth
        swimming.wait(3.0)
        assert abs(swimming.depth - before) < 0.15
        link.disarm()
        assert not link.telemetry.armed
        assert link.yielding == ""

    @pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
    def test_a_stick_turns_it_that_way_and_it_stops_when_the_order_expires(
        self, swimming: Subject, side: float
    ) -> None:
        sticks = swimming.link.joystick().sticks(0.0, 0.0, turn_rate=side * TURN)
        swimming.wait(0.5)
        before = swimming.yaw
        swimming.wait(2.0, sticks)
        turned = wrap_angle(swimming.yaw - before)
        assert 0.2 < side * turned < 2.0
        assert side * swimming.turn_rate > 0.1
        assert swimming.until(lambda: abs(swimming.turn_rate) < 0.08, 3.0)

    def test_rates_of_climb_take_it_to_a_depth_where_it_stays_when_they_expire(
        self, swimming: Subject
    ) -> None:
        joystick = swimming.link.joystick()
        swimming.wait(0.5)
        start = swimming.depth
        for depth in (start + (0.3 if start < 0.6 else -0.3), start):
            assert swimming.climbs_to(depth, joystick, 15.0)
            swimming.wait(3.0)
            assert abs(swimming.depth - depth) < 0.15
            before = swimming.depth
            swimming.wait(2.0)
            assert abs(swimming.depth - before) < 0.05

    def test_its_own_depth_moves_as_the_pressure_does_whatever_its_zero(self, swimming: Subject) -> None:
        link, joystick = swimming.link, swimming.link.joystick()
        swimming.wait(1.0)
        told = link.telemetry
        # By its position where it has one, which counts from elsewhere.
        assert told.own_altitude_from == (
            "LOCAL_POSITION_NED" if swimming.has_position else "GLOBAL_POSITION_INT"
        )
        assert told.own_altitude_age < 1.0
        lay = told.own_altitude + told.depth
        down = told.depth < 0.6
        assert swimming.climbs_to(told.depth + (0.3 if down else -0.3), joystick, 15.0)
        swimming.wait(1.0)
        told = link.telemetry
        assert abs(told.own_altitude + told.depth - lay) < 0.1
        assert swimming.climbs_to(told.depth - (0.3 if down else -0.3), joystick, 15.0)

    def test_in_guided_a_turn_outlives_its_setpoints_but_not_our_stop(
        self, swimming: Subject, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        if not swimming.has_position:
            pytest.skip("it has no position")
        link = swimming.link
        link.set_mode("GUIDED")
        swimming.wait(2.0, BodyVelocity(0.0, 0.0, 0.0, TURN))
        assert swimming.turn_rate > 0.15

        def only_sticks(now: float) -> None:
            link._send(dialect.MAVLink_manual_control_message(link.vehicle, 0, 0, 500, 0, 0))

        # Ordered once more, and good for longer than it takes to say nothing more of it: as the last order
        # ran out, the link may have told the vehicle to stop.
        link.command(BodyVelocity(0.0, 0.0, 0.0, TURN), link._now() + 0.5)
        swimming.threads.sleep(0.2)
        with monkeypatch.context() as patched:
            patched.setattr(link, "_drive", only_sticks)
            # Longer than the 3 s after which a velocity is forgotten: a rate of turn never is.
            swimming.wait(4.0)
            assert swimming.turn_rate > 0.15
        # With nothing ordered the link says so in so many words, and the vehicle stops.
        assert swimming.until(lambda: abs(swimming.turn_rate) < 0.08, 3.0)

    def test_it_disarms_when_the_station_falls_silent(self, swimming: Subject) -> None:
        if not swimming.fails:
            pytest.skip("it may not be left to its failsafes: DREAM_ARDUSUB_FAILSAFE=1 allows that")
        link = swimming.link
        swimming.wait(0.5)
        threads = swimming.threads
        end = threads.monotonic() + SILENT
        while link.telemetry.armed and threads.monotonic() < end:
            threads.sleep(0.1)
        assert not link.telemetry.armed
        assert "disarmed" in link.armed_by_other
