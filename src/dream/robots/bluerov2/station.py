"""A person at a joystick, whose ground station drives through DREAM and outranks the mission."""

from __future__ import annotations

import contextlib
import logging
import math
import socket
import struct
from collections import Counter
from collections.abc import Callable
from types import MappingProxyType
from typing import Any, Protocol, Self

from dream.robots.bluerov2.mavlink import Link, Refused, Tap, dialect
from dream.robots.bluerov2.sticks import NEUTRAL, Sticks
from dream.robots.bluerov2.threads import REAL_TIME, Thread, Threads
from dream.robots.bluerov2.wire import taken

logger = logging.getLogger(__name__)

Address = tuple[str, int]

DEAD_ZONE = 50
"""Of the 1000 of a stick: what ArduSub itself calls near neutral (`joystick.cpp`, input hold)."""
HANDS_OFF = 1.0
"""Seconds of neutral sticks after which the mission has the vehicle again."""
EXPIRY = 0.5
"""Seconds that sticks hold. QGroundControl repeats them 5 times a second at least."""
LOST = 3.0
"""Seconds of silence after which a station counts as gone, and another may have its place."""
MOST = 100.0
"""Datagrams a second that are read; QGroundControl sends some 30."""
BURST = 50.0
"""Datagrams that may come at once."""
LARGEST = 1500
"""Bytes of a datagram; a packet of MAVLink has 293 at most."""
PACKETS = 8
"""Packets that are read of one datagram."""
BUFFER = 8192
"""Bytes that the system keeps for us: what it cannot hold is lost, and old sticks do not queue."""
WAIT = 0.05
"""Seconds that a receiver waits before it looks whether sticks have expired."""
TOLD_EVERY = 5.0
"""Seconds between two notices of the same kind."""
SHOWN = 15.0
"""Seconds that the operator's console shows one."""
FORWARDED = MappingProxyType(
    {
        "HEARTBEAT": 0.0,
        "STATUSTEXT": 0.0,
        "ATTITUDE": 0.08,
        "VFR_HUD": 0.08,
        "SCALED_PRESSURE2": 0.08,
        "SYS_STATUS": 0.3,
        "NAMED_VALUE_FLOAT": 0.0,
    }
)
"""What the station is shown of the vehicle, telemetry and no answers; and seconds between two of a kind."""
QUESTIONS = (
    *("PARAM_REQUEST_", "MISSION_REQUEST_", "REQUEST_", "SET_MESSAGE_INTERVAL", "GET_MESSAGE_INTERVAL"),
    *("PING", "TIMESYNC", "SYSTEM_TIME", "FILE_", "LOG_"),
)
"""Beginnings of the names of what stations ask by themselves: not answered, and nothing to tell a person."""
ARM_TOGGLE, DISARM = 2, 4
"""BTNn_FUNCTION of the buttons that disarm."""


class Door(Protocol):
    """Where stations come to."""

    def send(self, data: bytes, to: Address) -> None:
        """Send one datagram. Raises OSError."""

    def receive(self) -> tuple[bytes, Address] | None:
        """What came and from where, or None after a moment. Raises OSError."""

    def close(self) -> None:
        """Give the port back."""


class UdpDoor:
    """A UDP port that is listened at."""

    def __init__(self, address: str) -> None:
        """udpin:HOST:PORT; port 0 takes any free one.

        Raises:
            ValueError: Not such an address.
            OSError: The port is taken.
        """
        kind, _, rest = address.partition(":")
        host, _, port = rest.rpartition(":")
        if kind != "udpin" or not host or not port.isdecimal() or int(port) > 65535:
            raise ValueError(f"pilot: expected udpin:HOST:PORT, got {address!r}")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
            self._socket.settimeout(WAIT)
            self._socket.bind((host, int(port)))
        except OSError as error:
            self._socket.close()
            raise taken(error, int(port)) from error

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._socket.getsockname()[1])

    def send(self, data: bytes, to: Address) -> None:
        """As `Door` says."""
        self._socket.sendto(data, to)

    def receive(self) -> tuple[bytes, Address] | None:
        """As `Door` says."""
        try:
            return self._socket.recvfrom(LARGEST + 1)
        except TimeoutError:
            return None

    def close(self) -> None:
        """As `Door` says."""
        self._socket.close()


class Hands:
    """Whether a person has the vehicle, judged by the sticks that come. Not thread-safe.

    What it does: sticks beyond the dead zone take the vehicle, and sticks that rest in it for `hands_off`
    seconds give it back. Whose sticks were never at neutral has nothing yet: a throttle that rests at its end
    must not dive the vehicle. Sticks that stop coming are neutral after `EXPIRY`, and the person is `gone`.

    Gone is not hands off: somebody took the vehicle away from the mission, for a reason that nobody here
    knows (a wall, a diver), and it was the cable that let go, not the hand. So the mission waits, in neutral,
    until neutral sticks say that the person is back and content, or until the operator says so.
    """

    def __init__(self, dead_zone: int = DEAD_ZONE, hands_off: float = HANDS_OFF) -> None:
        """Hands off."""
        self._dead_zone, self._hands_off = dead_zone, hands_off
        self.has = False
        """Do they steer now?"""
        self.gone = False
        """Did their sticks stop coming while they steered?"""
        self.trusted = False
        """Were the sticks at neutral since somebody new may sit there?"""
        self._heard = -math.inf
        self._resting_since = math.nan

    def begin(self) -> None:
        """Somebody else may sit there from now on."""
        self.trusted = False

    def take(self, sticks: Sticks, now: float) -> Sticks | None:
        """Sticks came. Returns those to send on; None where they are not to."""
        self.look(now)
        if now - self._heard > EXPIRY:
            self._resting_since = math.nan
        self._heard = now
        resting = self._rests(sticks)
        self.trusted |= resting
        if not self.trusted:
            return None
        if not resting:
            self.has, self.gone = True, False
            self._resting_since = math.nan
            return sticks
        if math.isnan(self._resting_since):
            self._resting_since = now
        if self.gone:
            self.has, self.gone = True, False
        if self.has and now - self._resting_since >= self._hands_off:
            self.has = False
        return NEUTRAL if self.has else None

    def look(self, now: float) -> None:
        """Time passed."""
        if self.has and now - self._heard > EXPIRY:
            self.has, self.gone = False, True

    def release(self) -> None:
        """Whoever was gone is not waited for any more."""
        self.gone = False

    def dismiss(self) -> None:
        """They have it no more."""
        self.has = self.gone = False

    def _rests(self, sticks: Sticks) -> bool:
        return max(abs(sticks.x), abs(sticks.y), abs(sticks.z - 500), abs(sticks.r)) <= self._dead_zone


class Station:
    """An endpoint that looks like the vehicle to one ground station, and lets its joystick through.

    What it does: the station's MANUAL_CONTROL becomes the link's `pilot` order while `Hands` says that the
    person has the vehicle; the vehicle's telemetry goes to the station, and nothing else does. Of all else
    that a station sends only a disarm is obeyed, being a wish for safety, whether as a command or as a button
    whose BTNn_FUNCTION is that: it ends the dive. Modes, arming and parameters are DREAM's during a dive:
    such a message is counted and denied, and the operator is told. Buttons do not reach the vehicle either.

    Reference: MAVLink's common.xml; ArduSub 4.7, `joystick.cpp`.

    Assumes: who reaches the port may drive; there is no password, so it listens on loopback unless told
    otherwise. One station at a time: the first that says a heartbeat, until it is silent for `LOST` seconds.
    A mode in which sticks move the vehicle, as ALT_HOLD: GUIDED ignores them.
    Fails when: a station waits for all parameters before it lets its joystick drive: they are not served.
    """

    def __init__(
        self,
        address: str | Door,
        link: Link,
        *,
        now: Callable[[], float],
        tap: Tap | None = None,
        hands: Hands | None = None,
        threads: Threads = REAL_TIME,
    ) -> None:
        """Open the port; the thread begins in the with-block.

        Args:
            address: udpin:HOST:PORT, port 0 takes any free one; or anything that carries datagrams.
            link: To the vehicle.
            now: The dive's clock.
            tap: Takes (time, "pilot", sent, message) for each message, and what becomes of the hands.
            hands: When a person has the vehicle.
            threads: What it waits by.

        Raises:
            ValueError: Not an address.
            OSError: The port is taken.
        """
        self._link, self._now, self._tap, self._threads = link, now, tap, threads
        self._door = UdpDoor(address) if isinstance(address, str) else address
        self._dialect = dialect()
        self._hands = hands or Hands()
        self.refused: Counter[str] = Counter()
        """What came and was not obeyed, by reason."""
        self.ended = ""
        """Why the person ended the dive; empty where they did not."""
        self._lock = threads.lock()
        self._dismissed = False
        self._seat: Address | None = None
        self._heard = -math.inf
        self._budget, self._counted = BURST, now()
        self._shown: dict[str, float] = {}
        self._told: dict[str, float] = {}
        self._said: tuple[str, float] = ("", -math.inf)
        self._buttons = 0
        self._disarming_buttons: dict[int, int] = {}
        self._writer = self._dialect.MAVLink(None)
        self._closed = threads.event()
        self._thread: Thread | None = None
        self._disarming: Thread | None = None

    # Opening and closing

    def __enter__(self) -> Self:
        self._thread = self._threads.start(self._run, "pilot")
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the sticks and of the port; a disarm under way is waited for."""
        if self._closed.is_set():
            return
        self._closed.set()
        self.dismiss()
        for thread in (self._thread, self._disarming):
            if thread is not None:
                thread.join(5.0)
        self._door.close()

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._door.port if isinstance(self._door, UdpDoor) else 0

    # What the bridge and the operator ask

    @property
    def connected(self) -> bool:
        """Whether a station is there."""
        return self._seat is not None and self._now() - self._heard <= LOST

    @property
    def has(self) -> bool:
        """Does a person steer now?"""
        return self._hands.has

    @property
    def gone(self) -> bool:
        """Did the sticks stop coming while a person steered?"""
        return self._hands.gone

    @property
    def said(self) -> str:
        """What became of a message that the operator should know of; empty where nothing did lately."""
        return self._said[0] if self._now() < self._said[1] else ""

    @property
    def words(self) -> str:
        """All of it in a line."""
        state = "has the sticks" if self.has else "hands off" if self.connected else "nobody there"
        if self.gone:
            state = "gone while steering: waiting for neutral sticks, or r"
        return f"{state}; {self.said}" if self.said else state

    def release(self) -> None:
        """The operator takes the vehicle back from a person who is gone; from one who steers, it does not."""
        with self._lock:
            if self._hands.gone:
                self._hands.release()
                self._link.pilot(NEUTRAL, self._now())
                self._note("the operator resumes for a pilot who is gone")

    def dismiss(self) -> None:
        """The dive is over: sticks do nothing from now on. A disarm is still obeyed."""
        with self._lock:
            self._dismissed = True
            self._hands.dismiss()
            self._link.pilot(NEUTRAL, self._now())

    def learn_buttons(self) -> None:
        """Ask the vehicle which buttons disarm it; without an answer, none does."""
        with contextlib.suppress(TimeoutError):
            for button in range(16):
                function = int(self._link.param(f"BTN{button}_FUNCTION"))
                if function in (ARM_TOGGLE, DISARM):
                    self._disarming_buttons[button] = function

    # What the threads do; tests call these with a clock of their own

    def forward(self, message: Any) -> None:
        """Show the station a message that came from the vehicle, if it is one to be shown."""
        kind, now = message.get_type(), self._now()
        if kind not in FORWARDED or not self.connected:
            return
        if message.get_srcSystem() != self._link.vehicle or message.get_srcComponent() != 1:
            return
        if now - self._shown.get(kind, -math.inf) < FORWARDED[kind]:
            return
        self._shown[kind] = now
        self._out(bytes(message.get_msgbuf()))

    def receive(self, data: bytes, sender: Address) -> bool:
        """Take a datagram. Returns False where too many come: who calls this should wait a little then."""
        now = self._now()
        with self._lock:
            self._budget = min(BURST, self._budget + MOST * max(0.0, now - self._counted)) - 1.0
            self._counted = now
            if self._budget < 0.0:
                self._budget = 0.0
                self.refused["too fast"] += 1
                return False
            if len(data) > LARGEST:
                self.refused["too long"] += 1
            elif self.connected and sender != self._seat:
                self.refused["from another address"] += 1
            else:
                for message in self._parsed(data)[:PACKETS]:
                    self._take(message, sender, now)
        return True

    def beat(self) -> None:
        """Look whether sticks have expired, and hold neutral for who is gone."""
        with self._lock:
            now, had = self._now(), self._hands.has
            self._hands.look(now)
            if self._hands.gone:
                # Whatever the mission's last order was, it must not come through.
                self._link.pilot(NEUTRAL, now + EXPIRY)
                if had:
                    self._note("the pilot's sticks are gone: neutral")

    # Receiving

    def _run(self) -> None:
        while not self._closed.is_set():
            try:
                came = self._door.receive()
                if came is not None and not self.receive(*came):
                    self._closed.wait(2.0 / MOST)
            except OSError as error:
                logger.warning("pilot: cannot receive: %s", error)
                self._closed.wait(0.5)
            except Exception:
                logger.exception("a message of the pilot's station was lost")
            try:
                self.beat()
            except Exception:
                logger.exception("the pilot's sticks were not looked at")

    def _parsed(self, data: bytes) -> list[Any]:
        parser = self._dialect.MAVLink(None)
        parser.robust_parsing = True
        try:
            return parser.parse_buffer(data) or []
        except (self._dialect.MAVError, struct.error, ValueError, IndexError, TypeError) as error:
            self.refused[f"broken packet: {type(error).__name__}"] += 1
            return []

    def _take(self, message: Any, sender: Address, now: float) -> None:
        kind = message.get_type()
        if kind == "BAD_DATA":
            self.refused["no packet"] += 1
            return
        if message.get_srcSystem() == self._link.vehicle:
            self.refused["from the vehicle's own system id"] += 1
            return
        self._record(now, False, message)
        if kind == "HEARTBEAT":
            if message.type != self._dialect.MAV_TYPE_GCS:
                self.refused["HEARTBEAT: not of a ground station"] += 1
                return
            if sender != self._seat or not self.connected:
                self._seat = sender
                self._hands.begin()
                self._buttons = 0
            self._heard = now
        elif sender != self._seat or not self.connected:
            self.refused["before a heartbeat"] += 1
        elif kind == "MANUAL_CONTROL":
            self._heard = now
            self._steer(message, now)
        else:
            self._heard = now
            self._deny(message, kind, now)

    def _steer(self, message: Any, now: float) -> None:
        if message.target != self._link.vehicle:
            self.refused["MANUAL_CONTROL: for another vehicle"] += 1
            return
        try:
            sticks = Sticks(message.x, message.y, message.z, message.r)
        except ValueError:
            self.refused["MANUAL_CONTROL: out of range"] += 1
            return
        self._press(message.buttons, now)
        if self._dismissed:
            self.refused["MANUAL_CONTROL: the dive is over"] += 1
            return
        hands = self._hands
        hands.look(now)
        had, was_gone = hands.has, hands.gone
        sent = hands.take(sticks, now)
        if sent is not None:
            self._link.pilot(sent, now + EXPIRY)
        elif had:
            # What is left of the last neutral would keep the mission waiting.
            self._link.pilot(NEUTRAL, now)
        elif sticks != NEUTRAL and not hands.trusted:
            self.refused["MANUAL_CONTROL: not at neutral yet"] += 1
            self._tell("unseen", "its sticks count once they were at neutral", now)
        if hands.has and not had:
            self._note("the pilot is back" if was_gone else "the pilot has the sticks")
        elif had and not hands.has:
            self._note("the pilot's hands are off: the mission goes on")

    def _press(self, buttons: int, now: float) -> None:
        pressed, self._buttons = buttons & ~self._buttons, buttons
        for button in range(16):
            if not pressed >> button & 1:
                continue
            function = self._disarming_buttons.get(button)
            if function == DISARM or (function == ARM_TOGGLE and self._link.telemetry.armed):
                self._disarm(None)
            else:
                self.refused["a button"] += 1
                self._tell("button", f"button {button}: ask for it in DREAM's console", now)

    def _deny(self, message: Any, kind: str, now: float) -> None:
        command = kind in ("COMMAND_LONG", "COMMAND_INT")
        d = self._dialect
        if (
            command
            and message.command == d.MAV_CMD_COMPONENT_ARM_DISARM
            and message.param1 == 0.0
            and message.target_system in (0, self._link.vehicle)
        ):
            self._disarm(message)
            return
        name = kind
        if command:
            known = d.enums["MAV_CMD"].get(message.command)
            name = known.name.removeprefix("MAV_CMD_") if known else "an unknown command"
            self._acknowledge(message, d.MAV_RESULT_DENIED)
        self.refused[name] += 1
        if not name.startswith(QUESTIONS):
            self._tell(name, f"{name}: ask for it in DREAM's console", now)

    # Disarming

    def _disarm(self, command: Any) -> None:
        """Neutral and disarm; the dive is over where the vehicle was armed."""
        if self._disarming is not None and self._disarming.is_alive():
            return
        if self._link.telemetry.armed:
            self.ended = "the pilot disarmed the vehicle"
            self.dismiss()
        self._note("the pilot disarms the vehicle")
        self._disarming = self._threads.start(lambda: self._disarmed(command), "pilot disarms")

    def _disarmed(self, command: Any) -> None:
        result = self._dialect.MAV_RESULT_ACCEPTED
        try:
            self._link.disarm()
        except (Refused, OSError) as error:
            result = self._dialect.MAV_RESULT_FAILED
            self._note(f"the vehicle is not disarmed: {error}", shown=True)
        if command is not None:
            self._acknowledge(command, result)

    # Telling

    def _tell(self, what: str, text: str, now: float) -> None:
        """Tell operator and pilot, but not again and again."""
        if now - self._told.get(what, -math.inf) >= TOLD_EVERY:
            self._told[what] = now
            self._note(text, shown=True)

    def _note(self, text: str, *, shown: bool = False) -> None:
        if shown:
            self._said = text, self._now() + SHOWN
        logger.warning("pilot: %s", text)
        with self._lock:
            self._record(self._now(), True, {"has": self.has, "gone": self.gone, "said": text})
            self._say(self._dialect.MAVLink_statustext_message(6, text[:50].encode()), 191)

    def _acknowledge(self, command: Any, result: int) -> None:
        answer = self._dialect.MAVLink_command_ack_message(
            command.command,
            result,
            target_system=command.get_srcSystem(),
            target_component=command.get_srcComponent(),
        )
        self._say(answer, 1)

    def _say(self, message: Any, component: int) -> None:
        """As the vehicle, to the station."""
        if not self.connected:
            return
        with self._lock:
            self._writer.srcSystem, self._writer.srcComponent = self._link.vehicle, component
            data = bytes(message.pack(self._writer))
            self._writer.seq = (self._writer.seq + 1) % 256
        self._record(self._now(), True, message)
        self._out(data)

    def _out(self, data: bytes) -> None:
        seat = self._seat
        if seat is None:
            return
        try:
            self._door.send(data, seat)
        except OSError:
            self.refused["cannot be sent"] += 1

    def _record(self, now: float, sent: bool, message: Any) -> None:
        if self._tap is None:
            return
        try:
            self._tap(now, "pilot", sent, message)
        except Exception:  # a full disk must not stop a person's sticks
            logger.exception("a message was not logged")
