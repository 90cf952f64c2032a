"""The dive's log: all that was received, sent and decided, in one file that Foxglove, Rerun and ROS 2 read.

`log.mcap` holds ROS 2 messages (CDR), whose bytes `rosbags` makes; nothing of ROS is needed. Topics:

    /imu  /dvl/velocity  /dvl/altitude  /depth  /heading   measurements, on the dive's clock
    /measurements                                          the same, as text whose numbers are exact
    /estimate  /tf                                         where the vehicle believes to be
    /camera/video  /camera/image                           H.264 as it came; else JPEG or PNG
    /mavlink/received  /mavlink/sent                       packets, byte by byte
    /a50/received  /a50/sent                               lines
    /<channel>/received  /<channel>/sent                   text and bytes of any other channel
    /<channel>                                             whatever else is told, as JSON
    /log                                                   the log about itself: what is missing, and why
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import re
import threading
from collections import Counter, deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np

from dream import __version__
from dream.measurements import Depth, Dvl, Heading, Imu, Measurement
from dream.robots.bluerov2 import messages
from dream.robots.bluerov2.mcap import McapFile, McapWriter
from dream.robots.bluerov2.messages import Typed

logger = logging.getLogger(__name__)

NAME = "log.mcap"
LOOK = 0.1
"""Seconds between two looks of the writing thread into the queue."""
FLUSH = 0.5
"""Seconds after which what was told is in the file: what a killed process loses, with `LOOK`."""
ROOM = 64 << 20
"""Bytes of what waits to be written: some 20 s of pictures."""
CHUNK = 1 << 20
"""Bytes of a chunk at most, but for what was told in one go."""
PATIENCE = 10.0
"""Seconds that closing waits for the disk."""
_ALONE = 200
"""Bytes that anything in the queue takes at least."""


class _Told(NamedTuple):
    time: float
    channel: str
    sent: bool
    payload: object
    size: int


class DiveLog:
    """Writes what it is told to `log.mcap`; the file is readable at any time.

    What it does: `tap` puts whatever it is told into a queue and returns; a thread makes messages of it and
    writes them, so that nobody waits for a disk. What was told more than `FLUSH` + `LOOK` ago is in the file
    even if the process is killed; a power cut may cost what the system has not yet put onto the disk. Where
    the disk is full or too slow, messages are lost: they are counted in `lost`, by channel, `problem` says
    so, and so does the file once there is room again.

    Assumes: payloads do not change after they were told.
    """

    def __init__(self, folder: Path, *, epoch_ns: int, room: int = ROOM) -> None:
        """Make the file.

        Args:
            folder: Of the run; holds no log yet.
            epoch_ns: UTC, nanoseconds since 1970, when the dive's clock was 0.
            room: Bytes that may wait to be written.

        Raises:
            ValueError: There is a log already.
            OSError: The folder cannot be written.
            ValueError: `rosbags` is missing.
        """
        self.path = folder / NAME
        self.epoch_ns = epoch_ns
        self._room = room
        messages.typestore()
        try:
            self._file = McapWriter(
                self.path,
                library=f"dream {__version__}",
                metadata={"dream": {"epoch_ns": str(epoch_ns), "version": __version__}},
            )
        except FileExistsError as error:
            raise ValueError(
                f"log: expected a folder without {NAME}, got {folder}. Log into a new one"
            ) from error
        except OSError as error:
            raise OSError(
                f"log: expected a folder that can be written, got {folder} ({error.strerror})"
            ) from error
        self._types: dict[str, int] = {}
        self._topics: dict[str, int] = {}
        self._queue: deque[_Told] = deque()
        self._waiting = 0
        self._lock = threading.Lock()
        self._lost: Counter[str] = Counter()
        self._pending: Counter[str] = Counter()
        self._told_lost = 0
        self._problem = ""
        self._written = 0
        self._last_time = 0.0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="dive log", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def tap(self, time: float, channel: str, sent: bool, payload: object) -> None:
        """Log something. Never waits, never raises.

        Args:
            time: On the dive's clock.
            channel: From where or to where; see the module for what becomes of it.
            sent: Went out, else came in.
            payload: A measurement, an estimate of the pose, a MAVLink message, a line of text, bytes, an
                access unit of a video, a picture (or what has one as `rgb`), or anything that JSON can tell.
        """
        size = _ALONE + _size(payload)
        with self._lock:
            if self._closing.is_set() or self._waiting + size > self._room:
                self._lost[channel] += 1
                if not self._closing.is_set():
                    self._problem = "the log is behind: the disk is too slow"
                return
            self._waiting += size
            self._queue.append(_Told(time, channel, sent, payload, size))

    @property
    def lost(self) -> dict[str, int]:
        """What was told and is not in the file, by channel."""
        with self._lock:
            return dict(self._lost)

    @property
    def problem(self) -> str:
        """What is wrong now, in a line; empty where nothing is."""
        return self._problem

    @property
    def written(self) -> int:
        """Messages that are in the file."""
        return self._written

    def close(self) -> None:
        """Write what was told, and the end of the file. Does not raise: `problem` tells."""
        with self._lock:
            self._closing.set()
        self._thread.join(PATIENCE)
        if self._thread.is_alive():
            self._problem = f"the log could not be ended within {PATIENCE:g} s: the disk does not answer"

    def _run(self) -> None:
        flushed = monotonic()
        while True:
            over = self._closing.wait(LOOK)
            self._drain()
            if over or monotonic() - flushed >= FLUSH:
                flushed = monotonic()
                self._flush()
            if over:
                break
        try:
            self._file.close()
        except OSError as error:
            self._problem = f"the log has no end ({error.strerror or error})"
            logger.warning("%s: %s", self.path, self._problem)

    def _drain(self) -> None:
        while True:
            with self._lock:
                if not self._queue:
                    return
                told = self._queue.popleft()
            try:
                for typed, stamp_ns in self._messages(told):
                    self._put(typed, stamp_ns)
                self._pending[told.channel] += 1
            except Exception:
                logger.exception("%s: something on %s could not be logged", self.path, told.channel)
                with self._lock:
                    self._lost[told.channel] += 1
                self._problem = f"something on {told.channel} could not be logged"
            with self._lock:
                self._waiting -= told.size
            if self._file.pending > CHUNK:
                self._flush()

    def _flush(self) -> None:
        try:
            with self._lock:
                lost = sum(self._lost.values())
            if lost != self._told_lost and self._file.pending:
                # Said once the file takes something again; where it does not, it is said the next time.
                text = json.dumps({"lost": self.lost, "why": self._problem})
                self._put(messages.of_text(text, "/log"), self._stamp(self._last_time))
            self._written += self._file.flush()
            if lost == self._told_lost and not self._closing.is_set():
                self._problem = ""
            self._told_lost = lost
        except OSError as error:
            self._problem = f"the log cannot be written ({error.strerror or error})"
            with self._lock:
                self._lost += self._pending
        self._pending.clear()

    def _put(self, typed: Typed, stamp_ns: int) -> None:
        if typed.topic not in self._topics:
            if typed.type not in self._types:
                text, _ = messages.typestore().generate_msgdef(typed.type, ros_version=2)
                self._types[typed.type] = self._file.add_schema(typed.type, "ros2msg", text)
            self._topics[typed.topic] = self._file.add_channel(typed.topic, self._types[typed.type])
        data = messages.typestore().serialize_cdr(typed.message, typed.type)
        self._file.write(self._topics[typed.topic], stamp_ns, data)

    def _stamp(self, time: float) -> int:
        return max(0, self.epoch_ns + round(1e9 * time))

    def _messages(self, told: _Told) -> Iterator[tuple[Typed, int]]:
        """What becomes of something, and when it is logged."""
        if math.isfinite(told.time):
            self._last_time = told.time
        logged = self._stamp(self._last_time)
        said: Any = told.payload
        topic = f"/{_word(told.channel)}"
        way = f"{topic}/{'sent' if told.sent else 'received'}"
        if isinstance(said, Imu | Dvl | Depth | Heading):
            # Text first: it has no time that must fit into nanoseconds.
            yield messages.of_text(messages.measurement_text(said), "/measurements"), logged
            if math.isfinite(said.time):
                for typed in messages.of_measurement(said, self._stamp(said.time)):
                    yield typed, logged
        elif hasattr(said, "get_msgbuf"):
            yield messages.of_bytes(bytes(said.get_msgbuf() or b""), way, said.get_type()), logged
        elif isinstance(said, str):
            yield messages.of_text(said, way), logged
        elif isinstance(said, bytes) and not (messages.is_png(said) or messages.is_jpeg(said)):
            yield messages.of_bytes(said, way, "bytes"), logged
        elif hasattr(said, "data") and hasattr(said, "parameters"):
            yield messages.of_video(said, f"{topic}/video", self._stamp(said.time)), logged
        elif (picture := _picture(said)) is not None:
            taken = getattr(said, "time", math.nan)
            stamp_ns = self._stamp(taken) if math.isfinite(taken) else logged
            yield messages.of_picture(picture, f"{topic}/image", stamp_ns), logged
        elif hasattr(said, "angular_velocity") and (hasattr(said, "pose") or hasattr(said, "T_world_base")):
            for typed in messages.of_state(said, logged):
                yield typed, logged
        else:
            text = json.dumps({"time": told.time, "said": messages.plain(said)})
            yield messages.of_text(text, topic), logged


def _picture(said: Any) -> Any:
    """(H, W, 3) uint8 rgb, or an encoded picture; None where it is none."""
    if isinstance(said, bytes):
        return said
    array = said if isinstance(said, np.ndarray) else getattr(said, "rgb", None)
    if isinstance(array, np.ndarray) and array.dtype == np.uint8 and array.ndim == 3 and array.shape[2] == 3:
        return array
    return None


def _size(payload: Any) -> int:
    raw = getattr(payload, "data", payload)
    if isinstance(raw, str | bytes):
        return len(raw)
    array = payload if isinstance(payload, np.ndarray) else getattr(payload, "rgb", None)
    return array.nbytes if isinstance(array, np.ndarray) else 0


def _word(channel: str) -> str:
    """As names of ROS allow it."""
    return re.sub(r"[^A-Za-z0-9_/]+", "_", channel).strip("/") or "unnamed"


@dataclass(frozen=True, slots=True, eq=False)
class Logged:
    """One message of a log."""

    time: float
    """Seconds on the dive's clock, to the nanosecond."""
    topic: str
    type: str
    message: Any
    """As `rosbags` makes it of the bytes."""
    checked: bool = True
    """Whether it lay in a chunk whose checksum is right; elsewhere, as in a torn end, it may be anything."""


def dive_began(run: Path) -> datetime | None:
    """When the clock of a dive was 0, as the log in its run folder says; None where there is none."""
    if not (run / NAME).is_file():
        return None
    try:
        file = McapFile(run / NAME)
        file.read_metadata()
        return datetime.fromtimestamp(int(file.metadata["dream"]["epoch_ns"]) / 1e9, UTC)
    except (KeyError, ValueError, OverflowError, OSError):
        return None


def read_log(path: Path, topics: Collection[str] = ()) -> Iterator[Logged]:
    """What a log holds, in the order in which it was told; of a damaged one, what is whole, with a warning.

    Args:
        path: Of the file.
        topics: Those that are wanted; all where empty.

    Raises:
        FileNotFoundError: There is none.
        ValueError: It is no log of a dive.
    """
    file = McapFile(path)
    file.read_metadata()
    store = messages.typestore()
    epoch_ns: int | None = None
    strange = 0
    for message in file.messages():
        if epoch_ns is None:
            try:
                epoch_ns = int(file.metadata["dream"]["epoch_ns"])
            except (KeyError, ValueError) as error:
                raise ValueError(f"{path}: expected the log of a dive, got one without its epoch") from error
        if topics and message.topic not in topics:
            continue
        try:
            read = store.deserialize_cdr(message.data, message.schema)
        except Exception:  # noqa: BLE001 - it fails on bytes that it did not write in many ways.
            strange += 1
            continue
        yield Logged(
            1e-9 * (message.time - epoch_ns), message.topic, message.schema, read, checked=file.checked
        )
    _warn(file, strange)


@contextlib.contextmanager
def doubting(logged: Logged) -> Iterator[None]:
    """Pass over what is not what its topic holds, where nothing says that it is as it was written."""
    try:
        yield
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        if logged.checked:
            raise
        logger.debug("a message on %s is left out: %s", logged.topic, error)


def _warn(file: McapFile, strange: int = 0) -> None:
    """Say what is missing of a file that was read to its end, and of how many messages the bytes are none."""
    if not (file.damage or strange):
        return
    size = max(file.path.stat().st_size, 1)
    left = f"{file.left_out} of its {size} bytes are left out" if file.left_out else "nothing is left out"
    words = [left, *file.damage, *([f"{strange} messages are none"] if strange else [])]
    logger.warning(
        "%s is read as far as it goes (%s); `recover` writes that into a whole one",
        file.path,
        "; ".join(words),
    )


def read_measurements(path: Path) -> Iterator[Imu | Measurement]:
    """The very measurements that were logged, in the order in which they were told.

    Given to a new `estimation.Timeline` from the same start they lead to the same states, bit for bit.
    Raises as `read_log` does.
    """
    for logged in read_log(path, ("/measurements",)):
        with doubting(logged):
            yield messages.read_measurement(logged.message.data)


def read_wire(path: Path, channel: str) -> Iterator[tuple[float, bool, bytes]]:
    """What came and went on a link: when, whether it was sent, and its bytes. Raises as `read_log` does."""
    received, sent = (f"/{_word(channel)}/{way}" for way in ("received", "sent"))
    for logged in read_log(path, (received, sent)):
        with doubting(logged):
            data = logged.message.data
            raw = data.encode() if isinstance(data, str) else data.tobytes()
            yield logged.time, logged.topic == sent, raw


def recover(path: Path, to: Path) -> int:
    """Write a torn or damaged log anew, with index and end, and say how many messages it holds.

    Args:
        path: Of the file, which stays as it is.
        to: Of the new one, which must not exist.

    Raises:
        FileNotFoundError: There is nothing to mend.
        ValueError: It is something else.
        OSError: The new one exists, or cannot be written.
    """
    file = McapFile(path)
    file.read_metadata()
    found = file.messages()
    message = next(found, None)
    store = messages.typestore()
    writer = McapWriter(to, library=f"dream {__version__}", metadata=file.metadata)
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    count = strange = 0
    try:
        while message is not None:
            if message.schema not in store.types:
                strange += 1
                message = next(found, None)
                continue
            if message.topic not in channels:
                if message.schema not in schemas:
                    text, _ = store.generate_msgdef(message.schema, ros_version=2)
                    schemas[message.schema] = writer.add_schema(message.schema, "ros2msg", text)
                channels[message.topic] = writer.add_channel(message.topic, schemas[message.schema])
            writer.write(channels[message.topic], message.time, message.data)
            count += 1
            if writer.pending > CHUNK:
                writer.flush()
            message = next(found, None)
    except BaseException:
        writer.abandon()
        to.unlink(missing_ok=True)
        raise
    writer.close()
    _warn(file, strange)
    return count
