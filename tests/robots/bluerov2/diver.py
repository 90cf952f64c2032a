"""A scripted ArduSub in water that goes up and down, on the simulated clock of `LockStep`."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from dream.robots.bluerov2.mavlink import Link
from dream.robots.bluerov2.reports import FRESH, GRAVITY, MODES, NUMBERS
from dream.robots.bluerov2.standin.lockstep import LockStep
from dream.robots.bluerov2.sticks import Joystick, Sticks
from dream.vehicle import VECTORED_6DOF

SURFACE_PRESSURE = 1000.0
BEAT = 0.05
ASCENT = 0.3
"""m/s at which it comes up in SURFACE, and at most goes back to a depth that it holds."""
STICK = 0.5
"""m/s of a stick at its end in MANUAL."""
JOYSTICK = Joystick(thrusters=VECTORED_6DOF, climb=1.0, sink=1.0)
"""What it makes of sticks in ALT_HOLD."""
SEA = 49.0
"""Metres above the sea of what `relative_alt` counts from, where it has a position."""
FLOATS = 0.1
"""m/s at which it comes up when it is disarmed."""
SURFACED = 0.1
"""Metres of depth at which it ends SURFACE by itself."""
TOP = 0.05
"""Metres of depth at which it floats."""
ANSWERED = (dialect.MAV_CMD_COMPONENT_ARM_DISARM, dialect.MAV_CMD_DO_SET_MODE)

Message = Any
"""Of pymavlink, which has no types."""


@dataclass
class Diver:
    """What it does: swims, tells, answers, and fails where a test says so.

    Depth is the truth; what its autopilot reckons and what its gauge reads may have zeros of their own.
    """

    clock: LockStep
    depth: float = 3.0
    mode: str = "MANUAL"
    armed: bool = False
    # What fails
    lifts: frozenset[str] = frozenset({"SURFACE", "ALT_HOLD", "MANUAL"})
    """By which it can come up: the mode, and sticks in two modes."""
    refuses: Counter[str] = field(default_factory=Counter)
    """How often yet it says no to a mode, or to `disarm`."""
    why: str = ""
    """What it says a moment after a no."""
    why_after: float = 0.1
    deaf: Callable[[Message], bool] = lambda message: False
    """Does this message not reach it?"""
    mute: bool = False
    """Is nothing of what it says heard?"""
    heartbeats: bool = True
    tells_depth: bool = True
    tells_own: bool = True
    placed: bool = False
    """Has its autopilot a position, and tells its height by that, too?"""
    zero: float = 0.0
    """Metres in the world where its own altitude is 0."""
    gauge_zero: float = 0.0
    """Metres of depth at which the gauge was zeroed."""
    gauge_stuck: float = math.nan
    """Metres of depth at which the gauge stands still; NaN where it does not."""
    own_stuck: float = math.nan
    """Metres up, where its own reckoning does."""
    failsafe: float = math.inf
    """Seconds without a pilot's sticks after which it disarms itself."""
    volts: float = 16.0
    leak: bool = False
    critical: bool = False
    happens: list[tuple[float, Callable[[], object]]] = field(default_factory=list)
    """What is done when."""
    sent: list[tuple[float, Message]] = field(default_factory=list)
    """What reached it, and when."""
    history: list[tuple[float, float, str, bool]] = field(default_factory=list)
    """Time, depth, mode and arming."""

    def __post_init__(self) -> None:
        self._held = self.depth
        self._sticks = (0, 0, 500, 0)
        self._writer = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self._reader = dialect.MAVLink(None)
        self._inbox: deque[bytes] = deque()
        self._came = self.clock.event()
        self._ended = False
        self._beats = 0
        self._piloted = self.clock()

    # As `wire.Pipe` says.

    def send(self, data: bytes) -> bool:
        for message in self._reader.parse_buffer(data) or ():
            if not self.deaf(message):
                self.sent.append((self.clock(), message))
                self._answer(message)
        return True

    def receive(self) -> bytes:
        if not self._inbox:
            self._came.clear()
            self._came.wait(0.25)
        return self._inbox.popleft() if self._inbox else b""

    def answered(self, lost: float) -> None: ...

    def close(self) -> None:
        self._ended = True

    # What a test asks of it

    def heard(self, kind: str, since: float = -math.inf) -> list[Message]:
        return [message for t, message in self.sent if t >= since and message.get_type() == kind]

    def asked(self, *, mode: str = "", disarm: bool = False) -> list[float]:
        """When it was asked for a mode, or to disarm."""
        return [
            t
            for t, m in self.sent
            if m.get_type() == "COMMAND_LONG"
            and (
                (mode and m.command == dialect.MAV_CMD_DO_SET_MODE and m.param2 == NUMBERS[mode])
                or (disarm and m.command == dialect.MAV_CMD_COMPONENT_ARM_DISARM and m.param1 == 0.0)
            )
        ]

    def say(self, message: Message, system: int = 1, component: int = 1) -> None:
        if not self.mute:
            self._writer.srcSystem, self._writer.srcComponent = system, component
            self._inbox.append(bytes(message.pack(self._writer)))
            self._came.set()
        self._writer.seq = (self._writer.seq + 1) % 256

    # What it does

    @property
    def own(self) -> float:
        """Metres up by its own reckoning."""
        return -self.depth - self.zero if math.isnan(self.own_stuck) else self.own_stuck

    def live(self) -> None:
        while not self._ended:
            for event in [event for event in self.happens if self.clock() >= event[0]]:
                self.happens.remove(event)
                event[1]()
            self._swim()
            self._tell()
            self.history.append((self.clock(), self.depth, self.mode, self.armed))
            self._beats += 1
            self.clock.sleep(BEAT)

    def _swim(self) -> None:
        _, _, z, _ = self._sticks
        stick = STICK * (z - 500) / 500.0
        if self.clock() - self._piloted > self.failsafe:
            self.armed = False
        if not self.armed:
            climb = FLOATS
        elif self.mode == "SURFACE":
            climb = ASCENT if "SURFACE" in self.lifts else 0.0
            if self.depth <= SURFACED:
                self.mode, self._held = "ALT_HOLD", self.depth
        elif self.mode == "ALT_HOLD":
            climb = JOYSTICK.climb_rate(Sticks(z=z))
            if climb == 0.0:
                climb = min(max(2.0 * (self.depth - self._held), -ASCENT), ASCENT)
            else:
                climb = climb if climb < 0.0 or "ALT_HOLD" in self.lifts else 0.0
                self._held = self.depth
        else:
            climb = stick if self.mode in self.lifts else 0.0
        self.depth = max(self.depth - BEAT * climb, TOP)

    def _tell(self) -> None:
        boot_ms = round(1000 * (self.clock() + 100.0))
        if self._beats % 4 == 0 and self.heartbeats:
            self._heartbeat()
        if self._beats % 10 == 0:
            self.say(
                dialect.MAVLink_sys_status_message(
                    0, 0, 0, 0, round(1000 * self.volts), -1, 62, 0, 0, 0, 0, 0, 0
                )
            )
        if self.leak and self._beats % 20 == 0:
            self.say(dialect.MAVLink_statustext_message(1, b"Leak Detected"))
        if self.tells_depth:
            gauge = self.depth - self.gauge_zero if math.isnan(self.gauge_stuck) else self.gauge_stuck
            hpa = SURFACE_PRESSURE + FRESH * GRAVITY * gauge / 100.0
            self.say(dialect.MAVLink_scaled_pressure2_message(boot_ms, hpa, 0.0, 2000))
        if self.tells_own and self._beats % 2 == 0:
            if self.placed:
                self.say(dialect.MAVLink_local_position_ned_message(boot_ms, 0, 0, -self.own, 0, 0, 0))
            mm = round(1000 * (self.own + SEA if self.placed else self.own))
            self.say(dialect.MAVLink_global_position_int_message(boot_ms, 0, 0, 437_000, mm, 0, 0, 0, 0))

    def _heartbeat(self) -> None:
        flags = 1 | (dialect.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        state = dialect.MAV_STATE_CRITICAL if self.critical else dialect.MAV_STATE_ACTIVE
        self.say(dialect.MAVLink_heartbeat_message(12, 3, flags, NUMBERS[self.mode], state, 3))

    def _answer(self, message: Message) -> None:
        kind = message.get_type()
        if kind == "MANUAL_CONTROL":
            self._sticks, self._piloted = (message.x, message.y, message.z, message.r), self.clock()
        elif kind == "COMMAND_LONG" and message.command in ANSWERED:
            arming = message.command == dialect.MAV_CMD_COMPONENT_ARM_DISARM
            wanted = "disarm" if arming else MODES[int(message.param2)]
            if arming and message.param1 == 1.0:
                wanted = "arm"
            if self.refuses[wanted] > 0:
                self.refuses[wanted] -= 1
                self.say(dialect.MAVLink_command_ack_message(message.command, dialect.MAV_RESULT_FAILED))
                if self.why:
                    self.happens.append((self.clock() + self.why_after, self._explain))
                return
            self.say(dialect.MAVLink_command_ack_message(message.command, 0))
            if arming:
                self.armed = wanted == "arm"
            else:
                self.mode, self._held = wanted, self.depth

    def _explain(self) -> None:
        self.say(dialect.MAVLink_statustext_message(2, self.why.encode()))


@contextmanager
def afloat(diver: Diver, mode: str = "ALT_HOLD") -> Iterator[Link]:
    """A link that armed it in a mode, and lets go of it in the end."""
    clock = diver.clock
    link = Link(
        diver,
        now=clock,
        rates={},
        surface_pressure=SURFACE_PRESSURE,
        threads=clock,
    )
    clock.start(diver.live, "diver")
    with link:
        link.connect(5.0)
        link.set_mode(mode)
        link.arm()
        diver.sent.clear()
        diver.history.clear()
        yield link
