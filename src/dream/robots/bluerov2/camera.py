"""The camera of a BlueROV2: the newest picture, and how old it is.

Published wheels of OpenCV hold FFmpeg, which decodes H.264, but no GStreamer. Its own way to receive RTP, a
session description file, was measured on loopback at 10 Hz: a picture came one picture late (105 ms), lost
packets gave broken pictures as if they were good ones, and after one silence nothing came any more. So the
packets are put together here (`rtp`), and OpenCV is handed whole pictures through its stream reader, each
followed by a delimiter so that the decoder need not wait for the next: it takes below 2 ms.

The stream reader of OpenCV 5.0 asks for 4 KiB at a time and loses some 60 bytes with each: 40 MB in an hour
of a 5 Mbit/s stream.
"""

from __future__ import annotations

import contextlib
import enum
import io
import os
import queue
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import numpy.typing as npt

from dream import extras
from dream.geometry import SE3, camera_mount
from dream.robots.bluerov2.rtp import CLOCK, PAYLOAD_TYPE, AccessUnit, Depacketizer
from dream.robots.bluerov2.threads import REAL_TIME, Event, Threads
from dream.robots.bluerov2.wire import taken

UInt8Array = npt.NDArray[np.uint8]
Tap = Callable[[float, str, bool, object], None]

CHANNEL = "camera"
LATE = 0.15
"""Seconds behind the quickest picture of the last `_WINDOW` after which a picture counts as late."""
LOST = 1.0
"""Seconds without a picture after which the link counts as broken."""

_WINDOW = 10.0
_BUFFER = 4 << 20
"""Bytes that the system is asked to hold for us; it may grant less."""
_LOOK = 0.1
"""Seconds between looks whether to close."""
_PAUSES = (0.1, 2.0)
"""Seconds before the first and between later attempts to open a source."""
_MOST_PRIMES = 400
_MOST_WAITING = 60
"""Pictures that wait for the decoder; more are left out up to the next whole one."""
_DELIMITER = b"\x00\x00\x00\x01\x09\xf0"


@dataclass(frozen=True, slots=True)
class RtpVideo:
    """H.264 in RTP over UDP, as a BlueROV2 sends it to the surface computer, 192.168.2.1:5600."""

    host: str = "127.0.0.1"
    """Address of this computer that packets come to; 0.0.0.0 is any."""
    port: int = 5600
    """0 is any free one; `LiveCamera.port` says which."""
    payload_type: int = PAYLOAD_TYPE
    latency: float = 0.0
    """Seconds from what was seen to the picture's arrival: film a running clock to know it."""

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise ValueError(f"port: expected 0 to 65535, got {self.port}")
        if not 96 <= self.payload_type <= 127:
            raise ValueError(f"payload_type: expected a dynamic one, 96 to 127, got {self.payload_type}")
        _check_latency(self.latency)


@dataclass(frozen=True, slots=True)
class RtspVideo:
    """A stream that is asked for, such as BlueOS offers too."""

    url: str
    latency: float = 0.0
    """Seconds from what was seen to the picture's arrival."""

    def __post_init__(self) -> None:
        if not self.url.startswith(("rtsp://", "rtsps://")):
            raise ValueError(f'url: expected "rtsp://host:port/path", got "{self.url}"')
        _check_latency(self.latency)


@dataclass(frozen=True, slots=True)
class VideoFile:
    """A film, played once at its own rate."""

    path: Path
    latency: float = 0.0
    """Seconds that its pictures count as old when they are shown."""

    def __post_init__(self) -> None:
        _check_latency(self.latency)


@dataclass(frozen=True, slots=True)
class VideoDevice:
    """A camera at this computer."""

    number: int = 0
    latency: float = 0.0
    """Seconds from what was seen to the picture's arrival."""

    def __post_init__(self) -> None:
        if not 0 <= self.number < 256:
            raise ValueError(f"number: expected 0 to 255, got {self.number}")
        _check_latency(self.latency)


@dataclass(frozen=True, slots=True)
class Frames:
    """Pictures of whoever makes them, as a simulated camera does. The only source on a simulated clock."""

    frames: Callable[[Callable[[], bool]], Iterator[tuple[float, UInt8Array]]]
    """Was the camera closed? → arrival, seconds on the dive's clock, and picture, (H, W, 3) uint8 blue first,
    one after the other. It waits by the camera's own `Threads`, for each picture and for whether to end."""
    latency: float = 0.0
    """Seconds from what was seen to the picture's arrival."""

    def __post_init__(self) -> None:
        _check_latency(self.latency)


Source = RtpVideo | RtspVideo | VideoFile | VideoDevice | Frames


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """What a camera saw."""

    time: float
    """When it was seen: the arrival less the source's latency; seconds on the dive's clock."""
    rgb: UInt8Array
    """(H, W, 3) uint8, not to be written to."""
    age: float
    """Seconds since then, when it was asked for."""


class State(enum.StrEnum):
    """How a camera does."""

    WAITING = "waiting"
    """No picture came yet."""
    LIVE = "live"
    STALE = "stale"
    """The newest picture is too old."""
    FROZEN = "frozen"
    """Pictures come and show the same to the last bit, though the vehicle moves."""


@dataclass(frozen=True, slots=True)
class Counts:
    """Pictures since the camera was opened; packets in `refused`."""

    received: int = 0
    """Pictures that could be asked for."""
    dropped: int = 0
    """Pictures that came whole and were not decoded: one they build on was lost, or they came too fast."""
    late: int = 0
    """Pictures that were under way for `LATE` longer than others; they are shown."""
    corrupt: int = 0
    """Pictures that a packet is missing from, or that could not be decoded."""
    lost: int = 0
    """Packets that never came."""
    refused: dict[str, int] = field(default_factory=dict)
    """Packets, by reason."""


def mounted(tilt: float, position: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> SE3:
    """`T_base_camera` of a camera that looks ahead and `tilt` radians down.

    Args:
        tilt: Radians, positive down.
        position: Of its optical centre in `base`, metres: forward, left, up.
    """
    return SE3(camera_mount(tilt).rotation, np.array(position))


class LiveCamera:
    """Keeps the newest picture of a source, which it opens again whenever it breaks.

    What it does: a thread of its own decodes all pictures and keeps one; over RTP a second one receives.
    Assumes: the stream has no B-pictures, which an encoder for live video leaves out. Each would make the
    times of pictures one picture too late.
    Fails when: bytes of a picture change on the way although UDP's checksum holds; it shows noise then.
    """

    def __init__(
        self,
        source: Source,
        now: Callable[[], float],
        tap: Tap | None = None,
        *,
        frozen_after: float = 2.0,
        threads: Threads = REAL_TIME,
    ) -> None:
        """Starts to read at once.

        Args:
            source: Where pictures come from.
            now: Seconds on the dive's clock.
            tap: Told of each picture as it came: an `AccessUnit` over RTP, else a `Picture`.
            frozen_after: Seconds of the same picture after which a moving vehicle's camera is frozen.
            threads: What it waits by; a clock of one's own goes with `Frames` alone.

        Raises:
            ValueError: OpenCV is missing.
        """
        opencv()
        self.source = source
        self.port = 0
        """UDP port that is listened to; 0 while there is none."""
        self._now, self._tap, self._frozen_after, self._threads = now, tap, frozen_after, threads
        self._changed = threads.condition()
        self._closed = threads.event()
        self._newest: tuple[float, UInt8Array] | None = None
        self._same_since = 0.0
        self._received = self._late = self._undecoded = 0
        self._trouble = ""
        self._depacketizer: Depacketizer | None = None
        self._started = now()
        self._bound = threads.event()
        self._thread = threads.start(self._run, "camera")
        self._bound.wait(1.0)

    def __enter__(self) -> LiveCamera:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Ends the thread. The newest picture can still be asked for."""
        self._closed.set()
        with self._changed:
            self._changed.notify_all()
        self._thread.join(timeout=3.0)

    def newest(self, max_age: float) -> Picture:
        """The newest picture.

        Args:
            max_age: Seconds since it was seen, at most.

        Raises:
            TimeoutError: There is none so new; the message says since when and what may be wrong.
        """
        with self._changed:
            return self._picture(max_age)

    def after(self, time: float, patience: float) -> Picture:
        """The newest picture, once one is there that was seen at `time` or later.

        Args:
            time: Seconds on the dive's clock.
            patience: Seconds that it is waited for.

        Raises:
            TimeoutError: None came.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._closed.is_set() or self._seen_since(time), patience)
            if not self._seen_since(time):
                raise TimeoutError(f"no picture from {time:.2f} s on within {patience:g} s. {self.problem}")
            return self._picture(float("inf"))

    @property
    def age(self) -> float:
        """Seconds since the newest picture was seen; since the start where none came."""
        newest = self._newest
        return self._now() - (self._started if newest is None else newest[0])

    @property
    def connected(self) -> bool:
        """Did a picture come within the last second?"""
        return self._newest is not None and self.age - self.source.latency < LOST

    @property
    def problem(self) -> str:
        """What is wrong; empty while pictures come."""
        if self.connected:
            return ""
        if self._trouble:
            return self._trouble
        where, packets = _described(self.source, self.port), self._depacketizer
        if packets is not None and packets.heard > self._now() - LOST:
            return f"Packets come to {where}, but no whole picture with its parameters."
        return f"No picture for {self.age:.1f} s from {where}."

    @property
    def unchanged(self) -> float:
        """Seconds of pictures that all show the same, to the last bit, up to the newest."""
        newest = self._newest
        return 0.0 if newest is None else newest[0] - self._same_since

    @property
    def counts(self) -> Counts:
        """What was received, and what was not."""
        packets = self._depacketizer
        if packets is None:
            return Counts(received=self._received, corrupt=self._undecoded)
        return Counts(
            received=self._received,
            dropped=packets.skipped,
            late=self._late,
            corrupt=packets.damaged + self._undecoded,
            lost=packets.lost,
            refused=dict(packets.refused),
        )

    def state(self, max_age: float, *, moving: bool) -> State:
        """How it does.

        Args:
            max_age: Seconds since the newest picture was seen, at most.
            moving: The vehicle has moved all the while, so that the picture must change. Noise changes it at
                rest too, except in a simulation.
        """
        if self._newest is None:
            return State.WAITING
        if self.age > max_age:
            return State.STALE
        return State.FROZEN if moving and self.unchanged >= self._frozen_after else State.LIVE

    def _picture(self, max_age: float) -> Picture:
        if self._newest is None or self.age > max_age:
            came = "no picture yet" if self._newest is None else f"no picture for {self.age:.1f} s"
            reason = self.problem or "It comes late"
            raise TimeoutError(f"{came} (limit {max_age:g} s). {reason}. Is the camera powered?")
        time, rgb = self._newest
        return Picture(time, rgb, self._now() - time)

    def _seen_since(self, time: float) -> bool:
        return self._newest is not None and self._newest[0] >= time

    def _run(self) -> None:
        pause = _PAUSES[0]
        while not self._closed.is_set():
            try:
                for arrival, bgr in self._frames():
                    self._keep(arrival - self.source.latency, bgr)
                    pause = _PAUSES[0]
                if not isinstance(self.source, RtpVideo):
                    self._trouble = f"{_described(self.source, self.port)} ended."
            except Exception as error:  # noqa: BLE001 - whatever breaks is a state; the thread goes on.
                self._trouble = f"{_described(self.source, self.port)}: {error}"
            self._bound.set()
            if isinstance(self.source, VideoFile) and self._received:
                return
            self._closed.wait(pause)
            pause = min(2.0 * pause, _PAUSES[1])

    def _frames(self) -> Iterator[tuple[float, UInt8Array]]:
        """Arrival and picture, blue first, until the source ends or the camera is closed."""
        match self.source:
            case RtpVideo():
                return self._from_packets(self.source)
            case Frames(frames):
                self._bound.set()
                return frames(self._closed.is_set)
            case _:
                return self._from_capture(self.source)

    def _keep(self, time: float, bgr: UInt8Array) -> None:
        cv2 = opencv()
        rgb = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)
        rgb.flags.writeable = False
        with self._changed:
            if self._newest is None or not np.array_equal(self._newest[1], rgb):
                self._same_since = time
            self._newest = time, rgb
            self._received += 1
            self._trouble = ""
            self._changed.notify_all()
        if self._tap is not None and not isinstance(self.source, RtpVideo):
            self._tap(time, CHANNEL, False, Picture(time, rgb, 0.0))

    def _from_packets(self, source: RtpVideo) -> Iterator[tuple[float, UInt8Array]]:
        with _listening(source, self.port) as receiver:
            self.port = receiver.getsockname()[1]
            self._bound.set()
            packets = self._depacketizer = self._depacketizer or Depacketizer(source.payload_type)
            waiting: queue.SimpleQueue[AccessUnit | None] = queue.SimpleQueue()
            stopped = self._threads.event()
            # Received apart from decoding, so that the time of arrival is right even while that is behind.
            reader = self._threads.start(lambda: self._receive(receiver, packets, waiting, stopped), "video")
            try:
                yield from self._decoded(iter(waiting.get, None))
            finally:
                stopped.set()
                reader.join()

    def _receive(
        self,
        receiver: socket.socket,
        packets: Depacketizer,
        waiting: queue.SimpleQueue[AccessUnit | None],
        stopped: Event,
    ) -> None:
        lateness = _Lateness()
        try:
            while not (stopped.is_set() or self._closed.is_set()):
                try:
                    packet = receiver.recv(65536)
                except TimeoutError:
                    continue
                unit = packets.push(packet, self._now())
                if unit is None:
                    continue
                self._late += lateness.of(unit) > LATE
                if self._tap is not None:
                    self._tap(unit.time, CHANNEL, False, unit)
                behind = waiting.qsize()
                if unit.whole and behind:
                    # The decoder can begin with this one; what waits is older.
                    packets.skipped += _emptied(waiting)
                if behind < _MOST_WAITING or unit.whole:
                    waiting.put(unit)
                else:
                    packets.skip(unit.time)
        except Exception as error:  # noqa: BLE001 - whatever breaks is a state; it is opened anew.
            self._trouble = f"{_described(self.source, self.port)}: {error}"
        finally:
            waiting.put(None)

    def _decoded(self, units: Iterator[AccessUnit]) -> Iterator[tuple[float, UInt8Array]]:
        cv2 = opencv()
        unit = next((unit for unit in units if unit.parameters), None)
        while unit is not None:
            feed = _Feed(unit, units)
            capture = cv2.VideoCapture(feed, cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
            feed.opened()
            fed, shown = -1, False
            while capture.isOpened() and not feed.ended:
                good = capture.grab()
                if good and (feed.fed or not shown):
                    good, bgr = capture.retrieve()
                    if good:
                        yield feed.unit.time, bgr
                        shown = True
                if not good and not feed.ended:
                    self._undecoded += 1
                    if fed == feed.fed:
                        break  # It fails without asking for more: it has to be opened anew.
                fed = feed.fed
            capture.release()
            unit = feed.other or next((unit for unit in units if unit.parameters), None)

    def _from_capture(
        self, source: RtspVideo | VideoFile | VideoDevice
    ) -> Iterator[tuple[float, UInt8Array]]:
        cv2 = opencv()
        self._bound.set()
        timeouts = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 3000, cv2.CAP_PROP_READ_TIMEOUT_MSEC, 1000]
        period = 0.0
        if isinstance(source, VideoFile):
            if not source.path.is_file():
                raise FileNotFoundError("there is no such file")
            capture = cv2.VideoCapture(os.fspath(source.path), cv2.CAP_FFMPEG)
            period = 1.0 / min(max(float(capture.get(cv2.CAP_PROP_FPS)), 1.0), 240.0)
        elif isinstance(source, RtspVideo):
            capture = cv2.VideoCapture(source.url, cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1, *timeouts])
        else:
            capture = cv2.VideoCapture(source.number)
        try:
            if not capture.isOpened():
                raise OSError("it cannot be opened")
            while not self._closed.wait(period):
                good, bgr = capture.read()
                if not good:
                    return
                yield self._now(), bgr
        finally:
            capture.release()


class _Feed(io.BufferedIOBase):
    """What the decoder reads: pictures as they come, each given only when it asks for more.

    So the picture that comes out belongs to the one that went in last. While it opens a stream the decoder
    wants some seconds of it, to guess its rate; it is given the first picture over and over instead. It is at
    the end too: what it keeps back would not decode without.
    """

    def __init__(self, first: AccessUnit, following: Iterator[AccessUnit]) -> None:
        super().__init__()
        self.unit = first
        self.fed = 0
        """Pictures it was given since it opened."""
        self.ended = False
        self.other: AccessUnit | None = None
        """The picture that needs a new decoder, since its parameters differ: another size, for one."""
        self._following = following
        self._first = first
        self._data, self._at = b"", 0
        self._primes: int | None = 0
        self._load(first)

    def opened(self) -> None:
        """No more of the first picture, but those that follow."""
        self._primes = None

    def read(self, size: int | None = -1, /) -> bytes:
        """The next bytes, at most `size`; none at the end."""
        if self._at >= len(self._data) and not self._next():
            return b""
        begin, self._at = self._at, len(self._data) if size is None or size < 0 else self._at + size
        return self._data[begin : self._at]

    def seek(self, offset: int, whence: int = 0, /) -> int:
        """Live pictures do not come again."""
        return -1

    def _next(self) -> bool:
        if self._primes is not None:
            self._primes += 1
            self._at = 0
            return self._primes < _MOST_PRIMES
        unit = None if self.ended else next(self._following, None)
        if unit is None or unit.parameters != self._first.parameters:
            self.other = unit if unit is not None and unit.whole else self.other
            again = not self.ended
            self.ended = True
            self._load(self._first)
            return again
        self.unit = unit
        self.fed += 1
        self._load(unit)
        return True

    def _load(self, unit: AccessUnit) -> None:
        # The parameters may have come long before.
        self._data = (unit.parameters if unit.whole or unit is self._first else b"") + unit.data + _DELIMITER
        self._at = 0


class _Lateness:
    """How much longer than the quickest of late a picture was under way, by the sender's stamps."""

    def __init__(self) -> None:
        self._last: AccessUnit | None = None
        self._sent = 0.0
        self._quickest = self._quickest_before = float("inf")
        self._since = 0.0

    def of(self, unit: AccessUnit) -> float:
        """Seconds."""
        if self._last is not None:
            ticks = (unit.stamp - self._last.stamp + (1 << 31)) % (1 << 32) - (1 << 31)
            self._sent += ticks / CLOCK
            if abs(ticks / CLOCK - (unit.time - self._last.time)) > _WINDOW:
                # Another sender, or the same one begun anew.
                self._quickest = self._quickest_before = float("inf")
        self._last = unit
        way = unit.time - self._sent
        if unit.time - self._since > _WINDOW:
            # Both clocks run at slightly different rates: what was long ago says nothing.
            self._quickest_before, self._quickest, self._since = self._quickest, way, unit.time
        self._quickest = min(self._quickest, way)
        return way - min(self._quickest, self._quickest_before)


def _emptied(waiting: queue.SimpleQueue[AccessUnit | None]) -> int:
    """How many pictures waited; none does any more."""
    count = 0
    with contextlib.suppress(queue.Empty):
        while True:
            waiting.get_nowait()
            count += 1
    return count


def _listening(source: RtpVideo, port: int) -> socket.socket:
    """A bound socket; at the port it had before, where it had one."""
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        receiver.bind((source.host, source.port or port))
    except OSError as error:
        receiver.close()
        raise taken(error, source.port or port) from error
    receiver.settimeout(_LOOK)
    return receiver


def _described(source: Source, port: int) -> str:
    match source:
        case RtpVideo():
            return f"RTP at {source.host}:{port or source.port}"
        case RtspVideo():
            # Without the password that an address may hold.
            parts = urlsplit(source.url)
            return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}"
        case VideoFile():
            return str(source.path)
        case VideoDevice():
            return f"video device {source.number}"
        case Frames():
            return "a source of frames"


def _check_latency(latency: float) -> None:
    if not 0.0 <= latency <= 10.0:
        raise ValueError(f"latency: expected 0 to 10 s, got {latency}")


def opencv() -> Any:
    """The module cv2.

    Raises:
        ValueError: It is missing; the message says what to install.
    """
    try:
        import cv2
    except ImportError as error:
        raise ValueError(extras.missing("rov", "cv2", "camera")) from error
    return cv2
