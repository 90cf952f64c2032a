"""The link to a Water Linked A50: lines of JSON over TCP → velocity over ground.

Protocol: json_v3.x of waterlinked/docs, dvl/dvl-json-protocol.md there (firmware 2.7.2). What else comes from
its ports: dvl-pd-formats.md (PD6 on TCP 1037, PD4 on 1038) and dvl-serial-protocol.md there. Reports are in
the DVL's frame, forward-right-down; here everything is forward-left-up. Devices and clocks of it are in
microseconds and degrees, which do not leave this module.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import re
import socket
import threading
from collections import Counter
from collections.abc import Callable, Mapping
from datetime import datetime
from types import TracebackType
from typing import Annotated, Any, Literal, Protocol, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import from_json

from dream.measurements import Dvl, Float64Array
from dream.robots.bluerov2.clocks import DeviceClock
from dream.robots.bluerov2.threads import REAL_TIME, Threads

logger = logging.getLogger(__name__)

PORT = 16171
CHANNEL = "a50"
MAX_LINE = 1 << 16
"""Bytes. A velocity report has about a thousand."""
VELOCITY_FLOOR = 0.005
"""m/s, one sigma: no axis is believed to be better."""
NOISIEST = 0.4
"""m/s of the figure of merit, where bluerobotics/BlueOS-Water-Linked-DVL has no confidence left."""
NEAREST = 0.05
"""Metres of altitude below which the beams cannot be told apart (data sheet of the A50)."""
CONNECTING = 3.0
"""Seconds to wait for a connection."""
QUIET = 5.0
"""Seconds without a byte after which the connection is made anew: `position_local` comes five times a second
also where there is no bottom lock."""
PAUSES = (0.25, 5.0)
"""Seconds between attempts to connect: the first, and the longest."""
FIRMWARE = "2.2.1"
"""Oldest that will do (changelog of waterlinked/docs, docs/dvl). Up to 2.0.8 it speaks json_v2 or what was
before; 2.1.0 speaks json_v3, but does not end its answers with a new line."""
ECHO_LASTS = 0.5
"""Seconds for which the echo of a beam is that of what lies there."""
SLOWEST = 2.0
"""Seconds from validity to transmission that are believed; about 0.2 in the documentation's example."""

SOUND_FRESH, SOUND_SEA = (1481.0, 1481.0), (1500.0, 1530.0)
"""m/s, from and to: fresh water at 20 °C (Del Grosso and Mader 1972: 1482), and the sea of 13 to 23 °C at a
salinity of 35 (Mackenzie 1981)."""
SALTY = 1010.0
"""kg/m³ from which on water is taken for the sea's."""

PROTOCOL = r"^json_v3(\.\d{1,4})?$"
"""What `format` has to be."""

NAMELESS = "a protocol without a name"
"""Of the first firmwares, up to 1.6.0."""

OTHERS: Mapping[str, bytes] = {
    "PD4": rb"\}\x00[\x2d-\x2f]\x00",
    "PD5": rb"\}\x01[\x00-\xff]\x00",
    "PD0": rb"\x7f\x7f",
    "PD6": rb"\A\s*:(?:SA|TS|[WB][ISED]),",
    "its serial protocol": rb"\A\s*wr[a-z],",
    "NMEA 0183": rb"\A\s*\$[A-Z]{4,6},",
    "HTTP": rb"\A\s*HTTP/",
}
"""What other protocols of a DVL are known by: binary records anywhere, for they have no lines, the others at
the beginning of one."""
_LOOKED_AT = 512
"""Bytes of what is no line of JSON in which another protocol is looked for."""

_FLU_FRD = np.diag([1.0, -1.0, -1.0])

_Speed = Annotated[float, Field(ge=-20.0, le=20.0)]
_Variance = Annotated[float, Field(ge=-1e4, le=1e4)]
_Microseconds = Annotated[int, Field(ge=0, le=1 << 62)]


class Clock(Protocol):
    """Maps stamps of a device onto the dive's clock."""

    def time(self, stamp: float, arrival: float) -> float:
        """When the stamp was taken, in seconds of the dive; it came in at `arrival`."""
        ...


class Stream(Protocol):
    """A connection, as bytes. What is wrong with it is an OSError."""

    def receive(self, timeout: float) -> bytes:
        """What has come since, as soon as there is something; empty where the other side hung up.

        Raises:
            TimeoutError: Nothing came for so many seconds.
        """

    def send(self, data: bytes) -> None:
        """All of it."""

    def close(self) -> None:
        """Hang up, from whatever thread: whoever receives is told that there is nothing more."""


class TcpStream:
    """A connection over TCP."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), timeout=CONNECTING)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def receive(self, timeout: float) -> bytes:
        """See `Stream`."""
        self._socket.settimeout(timeout)
        return self._socket.recv(1 << 14)

    def send(self, data: bytes) -> None:
        """See `Stream`."""
        self._socket.sendall(data)

    def close(self) -> None:
        """See `Stream`."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


class _Heard(BaseModel):
    """Something that the A50 says. Fields that we do not know are ignored, numbers are finite."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False, strict=True)

    format: str = Field(pattern=PROTOCOL)
    """A minor version may add fields; another major one may mean something else by the same name."""


class VelocityReport(_Heard):
    """`velocity`: over ground, in the DVL's frame; forward, right, down."""

    type: Literal["velocity"]
    vx: _Speed
    vy: _Speed
    vz: _Speed
    fom: float = Field(ge=0.0)
    """m/s, figure of merit."""
    covariance: list[Annotated[list[_Variance], Field(min_length=3, max_length=3)]] = Field(
        min_length=3, max_length=3
    )
    altitude: float = Field(ge=-1e4, le=1e4)
    """Metres; means nothing where the velocity is not valid."""
    velocity_valid: bool
    tracking_mode: str = "bottom"
    """Since json_v3.2; in `water` there is nothing about the ground."""
    transducers: Any = None
    """Each with `id`, `distance` in metres and `beam_valid`: see `ranges`."""
    status: int = Field(ge=0)
    """Bit 0: so hot that it is about to shut down."""
    time_of_validity: _Microseconds
    time_of_transmission: _Microseconds


class WaterReport(_Heard):
    """`velocity_water`: through the water. It tells nothing of the ground, but how the device is set."""

    type: Literal["velocity_water"]


class Response(_Heard):
    """`response` to a command."""

    type: Literal["response"]
    response_to: str = Field(max_length=64)
    success: bool
    error_message: str = ""
    result: Any = None


class Config(BaseModel):
    """What of `get_config` matters for how a velocity is read."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False, strict=True)

    speed_of_sound: float | None = None
    """m/s, by which velocities scale: see `sound_in`."""
    mounting_rotation_offset: float | None = None
    """Degrees by which the device turns what it reports."""
    acoustic_enabled: bool | None = None
    range_mode: str | None = None


class BadLine(ValueError):  # noqa: N818 - it names what was found.
    """A line that is not used; the message is the reason, short enough to be counted by."""

    def __init__(self, reason: str, *, spoken: str = "") -> None:
        super().__init__(reason)
        self.spoken = spoken
        """The other protocol that it is of; empty where that is not the reason."""


def read_line(line: bytes) -> VelocityReport | WaterReport | Response | None:
    """What a line says; None where it is of no concern here, as `position_local` is.

    Raises:
        BadLine: It is not JSON, or not what the protocol says.
    """
    try:
        said = from_json(line, allow_inf_nan=False)
    except ValueError as error:
        raise BadLine("not JSON", spoken=other_protocol(line)) from error
    if not isinstance(said, dict):
        raise BadLine("not a JSON object")
    kinds: Mapping[Any, type[VelocityReport] | type[WaterReport] | type[Response]] = {
        "velocity": VelocityReport,
        "velocity_water": WaterReport,
        "response": Response,
    }
    kind = said.get("type")
    if not isinstance(kind, str):
        # The first firmwares gave their velocities no type.
        raise BadLine("no type", spoken=_named(said.get("format", NAMELESS)) if "vx" in said else "")
    if kind not in kinds:
        return None
    try:
        return kinds[kind].model_validate(said)
    except ValidationError as error:
        field = str(error.errors(include_url=False)[0]["loc"][0])
        spoken = _named(said.get("format")) if field == "format" else ""
        raise BadLine(f"{kind}: {field}", spoken=spoken) from error


def apart(line: bytes) -> list[bytes]:
    """The objects of a line, of which one is meant to hold one.

    Firmware 2.1.0 ends its answers without a new line, so that each is glued to the next report.
    """
    pieces = re.split(rb"(?<=\})\s*(?=\{)", line)
    if len(pieces) > 1:
        with contextlib.suppress(ValueError):  # One whose text holds such a seam is whole.
            from_json(line)
            return [line]
    return pieces


def other_protocol(data: bytes) -> str:
    """Which of a DVL's other protocols it is that some bytes begin with; empty where none is known."""
    data = data[:_LOOKED_AT]
    if data.lstrip().startswith(b"{"):
        return ""
    return next((name for name, pattern in OTHERS.items() if re.search(pattern, data)), "")


def _named(version: object) -> str:
    """A protocol, as a line tells it, for a message."""
    known = version == NAMELESS or re.fullmatch(r"json_v[\d.]{1,8}", str(version))
    return str(version) if known else "another protocol"


def measurement(report: VelocityReport, time: float) -> Dvl:
    """The measurement that a report is, true at `time` on the dive's clock."""
    altitude = report.altitude if report.velocity_valid and report.altitude > 0.0 else math.nan
    return Dvl(
        time=time,
        velocity=_FLU_FRD @ np.array([report.vx, report.vy, report.vz]),
        covariance=_floored(_FLU_FRD @ np.array(report.covariance) @ _FLU_FRD),
        altitude=altitude,
        valid=report.velocity_valid and report.fom < NOISIEST and altitude > NEAREST,
    )


def ranges(report: VelocityReport) -> Float64Array:
    """(4,) metres along the beams of transducers 0 to 3; NaN where one has no echo, or says nothing of it."""
    found = np.full(4, math.nan)
    for one in report.transducers if isinstance(report.transducers, list) else []:
        if not (isinstance(one, dict) and one.get("beam_valid") is True):
            continue
        number, distance = one.get("id"), one.get("distance")
        if number in range(4) and isinstance(distance, int | float) and 0.0 < distance < math.inf:
            found[number] = distance
    return found


def _floored(covariance: Float64Array) -> Float64Array:
    """Symmetric, and in no direction below the floor: a sick matrix gives a usable one."""
    variances, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    floored: Float64Array = (axes * np.maximum(variances, VELOCITY_FLOOR**2)) @ axes.T
    return 0.5 * (floored + floored.T)


def sound_in(density: float) -> tuple[float, float]:
    """From and to what m/s sound goes, by the kg/m³ of the water."""
    return SOUND_FRESH if density < SALTY else SOUND_SEA


def _remedy(spoken: str, port: int) -> str:
    """What to do about a device that speaks another protocol on a port."""
    if spoken in OTHERS:
        if port != PORT:
            return f"its JSON comes on port {PORT}. Say --dvl HOST:{PORT}"
        return f"its JSON comes on port {PORT}. Free that port on the page of the DVL; or is it no A50?"
    if spoken == NAMELESS or re.match(r"json_v[0-2]\b", spoken):
        return f"its firmware is too old. Update it to {FIRMWARE} or newer"
    return f"as an A50 or A125 does, of firmware {FIRMWARE} or newer. Is it one of those?"


class DvlA50:
    """A Water Linked A50 on the network.

    What it does: a thread of its own connects, reads line by line and delivers a `Dvl` for every good
    velocity report, also for those without bottom lock. A broken link is a state (`connected`, `problem`),
    and is made anew after a growing pause. What cannot be used is counted in `refused`, by reason. The time
    of a velocity is when it was true: the device says how long it took to make and send it, and only the
    sending is compared with the dive's clock.

    Reference: json_v3.x, see the module.

    Assumes: stamps of one report share a clock, which may be set at any time. Lines that come in all at once
    before the clock is known seem to be of one time, and but one of them is used.
    Fails when: the device turns its velocities by a `mounting_rotation_offset` other than `rotation_deg`;
    `problem` then says so.
    """

    def __init__(
        self,
        host: str,
        port: int = PORT,
        *,
        now: Callable[[], float],
        deliver: Callable[[Dvl], None],
        rotation_deg: float = 0.0,
        clock: Clock | None = None,
        quiet: float = QUIET,
        pauses: tuple[float, float] = PAUSES,
        tap: Callable[[float, str, bool, object], None] | None = None,
        threads: Threads = REAL_TIME,
        dial: Callable[[], Stream] | None = None,
    ) -> None:
        """Begin to connect.

        Args:
            host: Name or address.
            port: Of the JSON protocol.
            now: The dive's clock.
            deliver: Takes each measurement, in the thread of the link; quick.
            rotation_deg: `mounting_rotation_offset` that the device is expected to have. Where the DVL sits
                and looks is for the estimator to know (`estimation.Mounting`).
            clock: Of the device.
            quiet: Seconds without a byte after which to connect anew.
            pauses: Seconds before another attempt: first and longest.
            tap: Is told of every line, as it came or went.
            threads: What it begins its thread and waits by.
            dial: Makes a connection, or raises an OSError; over TCP to host and port unless given.
        """
        self._host, self._port = host, port
        self._now, self._deliver, self._tap = now, deliver, tap
        self._rotation_deg = rotation_deg
        self._clock: Clock = DeviceClock() if clock is None else clock
        self._quiet, self._pauses = quiet, pauses
        self._dial: Callable[[], Stream] = (lambda: TcpStream(host, port)) if dial is None else dial
        self._lock = threads.lock()
        self._asking = threads.lock()
        self._closing = threads.event()
        self._link: Stream | None = None
        self._answering = threads.condition()
        self._answers: dict[str, Response | None] = {}
        """To the commands whose answers are waited for; None where none came yet."""
        self._lost = "not tried yet"
        self._version = ""
        """Which other protocol it speaks; empty where it speaks ours."""
        self._glued = False
        """Was its last answer glued to a report?"""
        self._watered = -math.inf
        """When it last told a velocity through the water."""
        self._config: Config | None = None
        self._heard = math.nan
        self._delivered = math.nan
        self._status = 0
        self._last_stamp = -1
        self._last_time = -math.inf
        self._refused: Counter[str] = Counter()
        self._echoes: tuple[float, Float64Array] | None = None
        """When a velocity came last, and its `ranges`."""
        self._own = 0
        """Which thread is that of the link."""
        self._thread = threads.start(self._run, f"a50 {host}:{port}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the link; nothing is delivered afterwards."""
        self._closing.set()
        self._hang_up()
        if threading.get_ident() != self._own:
            self._thread.join(CONNECTING + 1.0)

    @property
    def connected(self) -> bool:
        """Is there a connection?"""
        return self._link is not None

    @property
    def age(self) -> float:
        """Seconds since a measurement was delivered, with bottom lock or without; inf where none was."""
        return math.inf if math.isnan(self._delivered) else self._now() - self._delivered

    @property
    def ranges(self) -> Float64Array | None:
        """(4,) metres along the beams of transducers 0 to 3, NaN without echo; None where none is new.

        Its documents number them in a drawing only: which is which is not known here.
        """
        echoes = self._echoes
        return None if echoes is None or self._now() - echoes[0] > ECHO_LASTS else echoes[1]

    @property
    def hot(self) -> bool:
        """The last report said that it is about to shut down, as it is too hot."""
        return bool(self._status & 1)

    @property
    def config(self) -> Config | None:
        """As the device told when the connection was made; None until then."""
        return self._config

    @property
    def misread(self) -> str:
        """Why its velocities, by its settings, are not what they are taken for; empty where they are."""
        where = f"the DVL at {self._host}:{self._port}"
        config = self._config
        if config is None:
            return ""
        if config.acoustic_enabled is False:
            return f"{where} is told not to ping. Set acoustic_enabled"
        if config.range_mode == "wt":
            return f"{where} is told to track the water. Set range_mode to auto"
        turned = config.mounting_rotation_offset
        if turned is not None and abs(math.remainder(turned - self._rotation_deg, 360.0)) > 0.01:
            return (
                f"{where}: expected mounting_rotation_offset {self._rotation_deg:g}°, got {turned:g}°. "
                "One of both is to be changed"
            )
        return ""

    @property
    def refused(self) -> dict[str, int]:
        """Lines that were not used, by reason."""
        with self._lock:
            return dict(self._refused)

    @property
    def problem(self) -> str:
        """What is wrong, in a line; empty where nothing is."""
        where = f"the DVL at {self._host}:{self._port}"
        if self._version:
            # Said also where it hung up, as one does that takes our words for nonsense.
            speaks = f"{where} speaks {self._version}, expected json_v3"
            return f"{speaks}: {_remedy(self._version, self._port)}"
        if not self.connected:
            hot = (
                " It was too hot: is it out of the water?" if self.hot else " Is it powered, and on this net?"
            )
            return f"no connection to {where} ({self._lost}).{hot}"
        if self.hot:
            return f"{where} is too hot and about to shut down. Is it out of the water?"
        if self.misread:
            return self.misread
        if self._glued:
            return (
                f"{where} does not end its answers with a new line, as firmware 2.1.0 does: it is too old. "
                f"Update it to {FIRMWARE} or newer"
            )
        silent = self._now() - self._heard
        if not self.age <= self._quiet:
            since = f" for {self.age:.1f} s" if self.age < math.inf else ""
            if self._now() - self._watered <= self._quiet:
                return (
                    f"{where} tells its velocity through the water only, and none over ground{since}. "
                    "Set its range_mode to auto"
                )
            return f"no velocity from {where}{since}{self._refusals}"
        return f"nothing heard of {where} for {silent:.1f} s" if silent > self._quiet else ""

    @property
    def _refusals(self) -> str:
        """Why most of the lines are refused, to go on a sentence; empty where none is."""
        with self._lock:
            most = self._refused.most_common(1)
        return "".join(f"; {count} lines were refused: {reason}" for reason, count in most)

    # Commands. Each waits for the answer; none may be called from `deliver`, which would wait for itself.

    def ask(
        self, command: str, parameters: Mapping[str, Any] | None = None, *, timeout: float = 2.0
    ) -> object:
        """Send a command and wait for the `result` of its response.

        Raises:
            ConnectionError: There is no connection, or it broke.
            TimeoutError: No response came.
            ValueError: The device refused; the message says why.
        """
        said: dict[str, Any] = {"command": command}
        if parameters is not None:
            said["parameters"] = dict(parameters)
        line = json.dumps(said, allow_nan=False)
        with self._asking:
            with self._answering:
                self._answers[command] = None
            try:
                self._send(line)
                with self._answering:
                    self._answering.wait_for(lambda: self._answers[command] is not None, timeout)
            finally:
                with self._answering:
                    answer = self._answers.pop(command)
        if answer is None:
            raise TimeoutError(
                f"{command}: expected a response of the DVL within {timeout:g} s, got none. {self.problem}"
            )
        if not answer.success:
            raise ValueError(f"{command}: the DVL refuses: {answer.error_message or 'without a reason'}")
        return answer.result

    def get_config(self) -> Config:
        """How the device is set. Raises as `ask` does."""
        self._take_config(self.ask("get_config"))
        if self._config is None:
            raise ValueError("get_config: expected settings of the DVL, got something else")
        return self._config

    def set_config(
        self,
        *,
        speed_of_sound: float | None = None,
        mounting_rotation_offset_deg: float | None = None,
        acoustic_enabled: bool | None = None,
        dark_mode_enabled: bool | None = None,
        range_mode: str | None = None,
        periodic_cycling_enabled: bool | None = None,
    ) -> None:
        """Change what is given, and leave the rest. Raises as `ask` does.

        Args:
            speed_of_sound: m/s, 1000 to 2000.
            mounting_rotation_offset_deg: Degrees, 0 to 360.
            acoustic_enabled: Ping at all.
            dark_mode_enabled: Lights of the device off.
            range_mode: `auto`, or as the protocol says.
            periodic_cycling_enabled: Look for the bottom at all ranges from time to time.
        """
        if speed_of_sound is not None and not 1000.0 <= speed_of_sound <= 2000.0:
            raise ValueError(f"speed_of_sound: expected 1000 to 2000 m/s, got {speed_of_sound}")
        if mounting_rotation_offset_deg is not None and not 0.0 <= mounting_rotation_offset_deg <= 360.0:
            raise ValueError(
                f"mounting_rotation_offset_deg: expected 0 to 360, got {mounting_rotation_offset_deg}"
            )
        wanted = {
            "speed_of_sound": speed_of_sound,
            "mounting_rotation_offset": mounting_rotation_offset_deg,
            "acoustic_enabled": acoustic_enabled,
            "dark_mode_enabled": dark_mode_enabled,
            "range_mode": range_mode,
            "periodic_cycling_enabled": periodic_cycling_enabled,
        }
        self.ask("set_config", {name: value for name, value in wanted.items() if value is not None})
        self.get_config()

    def calibrate_gyro(self) -> None:
        """Let it learn what its gyroscope reads at rest, in up to 15 s: hold still. Raises as `ask` does."""
        self.ask("calibrate_gyro", timeout=16.0)

    def reset_dead_reckoning(self) -> None:
        """Let its own `position_local` begin here. Raises as `ask` does."""
        self.ask("reset_dead_reckoning")

    def trigger_ping(self) -> None:
        """One ping, where `acoustic_enabled` is off. Raises as `ask` does."""
        self.ask("trigger_ping")

    def set_time_manual(self, time: datetime) -> None:
        """Set its clock; refused where it is synchronised by NTP. Raises as `ask` does.

        Args:
            time: With a time zone.
        """
        if time.tzinfo is None:
            raise ValueError(f"time: expected one with a time zone, got {time}")
        self.ask("set_time_manual", {"now": time.isoformat(timespec="milliseconds")})

    # The thread.

    def _run(self) -> None:
        self._own = threading.get_ident()
        pause = self._pauses[0]
        while not self._closing.is_set():
            heard = self._heard
            try:
                link = self._dial()
                with contextlib.closing(link):
                    self._converse(link)
                self._lost = "it hung up"
            except OSError as error:
                self._lost = error.strerror or str(error) or type(error).__name__
            finally:
                self._link = None
            if self._heard != heard and not math.isnan(self._heard):
                pause = self._pauses[0]
            if self._closing.wait(pause):
                return
            pause = min(2.0 * pause, self._pauses[1])

    def _converse(self, link: Stream) -> None:
        self._link = link
        if self._closing.is_set():
            return
        self._send(json.dumps({"command": "get_config"}))
        rest, skipping = bytearray(), False
        while not self._closing.is_set():
            try:
                got = link.receive(self._quiet)
            except TimeoutError:
                if self._answers:  # Whoever waits for an answer has a time-out of his own.
                    continue
                raise TimeoutError(f"nothing heard for {self._quiet:g} s") from None
            if not got:
                return
            arrived = self._now()
            rest += got
            *lines, last = rest.split(b"\n")
            rest = bytearray(last)
            for line in lines:
                if not skipping:
                    self._take_line(bytes(line), arrived)
                skipping = False
            if spoken := other_protocol(bytes(rest[:_LOOKED_AT])):
                self._version = spoken  # It may have no lines at all.
            if len(rest) > MAX_LINE:
                if not skipping:
                    self._take_line(bytes(rest), arrived)
                rest, skipping = bytearray(), True

    def _take_line(self, line: bytes, arrived: float) -> None:
        line = line.strip()
        if not line:
            return
        self._heard = arrived
        self._tell(arrived, False, line[:MAX_LINE].decode("utf-8", "backslashreplace"))
        if len(line) > MAX_LINE:
            self._refuse(BadLine("longer than a report"), line)
            return
        pieces = apart(line)
        for number, piece in enumerate(pieces, start=1):
            try:
                said = read_line(piece)
                if isinstance(said, VelocityReport):
                    self._take_velocity(said, arrived)
                elif isinstance(said, Response):
                    self._glued = number < len(pieces)
                    self._take_response(said)
                elif isinstance(said, WaterReport):
                    self._version, self._watered = "", arrived
            except BadLine as reason:
                self._refuse(reason, piece)

    def _refuse(self, reason: BadLine, line: bytes) -> None:
        if reason.spoken:
            self._version = reason.spoken
        with self._lock:
            self._refused[str(reason)] += 1
        logger.debug("a line of the A50 is refused (%s): %.200r", reason, line)

    def _take_velocity(self, report: VelocityReport, arrived: float) -> None:
        self._version, self._status = "", report.status
        if report.tracking_mode != "bottom":
            self._watered = arrived
            raise BadLine("does not track the ground")
        if report.time_of_validity == self._last_stamp:
            raise BadLine("said before")
        self._last_stamp = report.time_of_validity
        took = 1e-6 * (report.time_of_transmission - report.time_of_validity)
        if not 0.0 <= took <= SLOWEST:
            raise BadLine("sent before it was true, or long after")
        sent = self._clock.time(1e-6 * report.time_of_transmission, arrived)
        time = min(sent, arrived) - took
        if time <= self._last_time:
            raise BadLine("older than the one before")
        self._last_time = time
        try:
            self._deliver(measurement(report, time))
        except Exception as error:
            logger.exception("a velocity of the DVL could not be delivered")
            raise BadLine("could not be delivered") from error
        self._delivered, self._echoes = arrived, (arrived, ranges(report))

    def _take_response(self, response: Response) -> None:
        with self._answering:
            awaited = response.response_to in self._answers
            if awaited:
                self._answers[response.response_to] = response
                self._answering.notify_all()
        if not awaited and response.response_to == "get_config" and response.success:
            self._take_config(response.result)

    def _take_config(self, result: object) -> None:
        try:
            self._config = Config.model_validate(result)
        except ValidationError as error:
            self._config = None
            logger.warning("settings of the DVL are not understood: %s", error.errors(include_url=False)[0])

    def _send(self, line: str) -> None:
        link = self._link
        if link is None:
            raise ConnectionError(self.problem)
        self._tell(self._now(), True, line)
        link.send(line.encode() + b"\n")

    def _tell(self, time: float, sent: bool, line: str) -> None:
        if self._tap is not None:
            try:
                self._tap(time, CHANNEL, sent, line)
            except Exception:
                logger.exception("a line of the A50 could not be logged")

    def _hang_up(self) -> None:
        link = self._link
        if link is not None:
            link.close()
