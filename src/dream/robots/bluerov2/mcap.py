"""MCAP files that survive the end of the process that writes them.

Format: the MCAP specification, version 0 (mcap.dev/spec): magic, records of `opcode u8, length u64`, a data
section of schemas, channels and chunks of messages, and a summary at the end. The writers of `rosbags` and of
`mcap` keep a chunk in memory until it is full; here it goes to the file whenever one asks. Without its end a
file is still read, up to the last message that is whole.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

MAGIC = b"\x89MCAP0\r\n"
MOST_BYTES = 1 << 30
"""A longer chunk is taken for a damaged length."""
MOST_DECLARED = 64 << 20
"""Any other record that is longer, likewise."""
MOST_TOLD = 4
"""Damages of a file that are told one by one."""
REPEATED = 20
"""Chunks after which types, topics and metadata are told again: the chunk that told them may be damaged."""
_CHUNK_HEAD, _SECTOR, _BLOCK = 49, 512, 1 << 20
"""Bytes: of a chunk before its records; of what a disk writes at once; that are searched at once."""

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = range(1, 9)
_STATISTICS, _METADATA, _METADATA_INDEX, _SUMMARY_OFFSET, _DATA_END = 0x0B, 0x0C, 0x0D, 0x0E, 0x0F


class Message(NamedTuple):
    """One message of a file."""

    topic: str
    schema: str
    """Name of its type."""
    time: int
    """Nanoseconds, of the log."""
    data: bytes


@dataclass(slots=True)
class _Chunk:
    records: bytearray = field(default_factory=bytearray)
    first: int = (1 << 63) - 1
    last: int = 0
    index: defaultdict[int, list[tuple[int, int]]] = field(default_factory=lambda: defaultdict(list))


class McapWriter:
    """Writes a file; what `flush` has returned from is there whatever becomes of the process.

    Messages that are pending when the file cannot be written are dropped; the file is cut back to what was
    whole, so that it goes on where there is room again.
    """

    def __init__(self, path: Path, *, library: str, metadata: dict[str, dict[str, str]]) -> None:
        """Make the file.

        Args:
            path: Of a file that does not exist.
            library: Who writes it.
            metadata: Names and texts, by the name of the group.

        Raises:
            OSError: It exists, or cannot be written.
        """
        self._file = FileIO(path, "xb")
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._chunks: list[bytes] = []
        self._counts: dict[int, int] = {}
        self._about = metadata
        self._metadata: list[bytes] = []
        self._chunk = _Chunk()
        self._first, self._last = (1 << 63) - 1, 0
        try:
            self._append(MAGIC + _record(_HEADER, _text("ros2") + _text(library)))
            self._tell_metadata()
        except OSError:
            self._file.close()
            raise

    @property
    def pending(self) -> int:
        """Bytes that are not in the file yet."""
        return len(self._chunk.records)

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self._file.tell()

    def add_schema(self, name: str, encoding: str, text: str) -> int:
        """Declare a type, and get its number."""
        number = len(self._schemas) + 1
        body = struct.pack("<H", number) + _text(name) + _text(encoding) + _text(text)
        self._schemas.append(_record(_SCHEMA, body))
        self._chunk.records += self._schemas[-1]
        return number

    def add_channel(self, topic: str, schema: int) -> int:
        """Declare where messages of a type are put, and get its number."""
        number = len(self._channels) + 1
        body = struct.pack("<HH", number, schema) + _text(topic) + _text("cdr") + _map({})
        self._channels.append(_record(_CHANNEL, body))
        self._chunk.records += self._channels[-1]
        self._counts[number] = 0
        return number

    def write(self, channel: int, time: int, data: bytes | memoryview) -> None:
        """Put a message into the present chunk."""
        chunk = self._chunk
        chunk.index[channel].append((time, len(chunk.records)))
        chunk.records += struct.pack("<BQHIQQ", _MESSAGE, 22 + len(data), channel, 0, time, time)
        chunk.records += data
        chunk.first, chunk.last = min(chunk.first, time), max(chunk.last, time)

    def flush(self) -> int:
        """Put all that is pending into the file, and say how many messages that were.

        Raises:
            OSError: It could not be written; those messages are lost, and the file is as it was.
        """
        chunk, self._chunk = self._chunk, _Chunk()
        messages = sum(map(len, chunk.index.values()))
        if not messages:
            self._chunk.records = chunk.records
            return 0
        at, raw = self._file.tell(), bytes(chunk.records)
        span = struct.pack("<QQ", chunk.first, chunk.last)
        body = span + struct.pack("<QI", len(raw), zlib.crc32(raw)) + _text("") + struct.pack("<Q", len(raw))
        record = _record(_CHUNK, body + raw)
        indices, offsets = bytearray(), bytearray()
        for channel, entries in chunk.index.items():
            offsets += struct.pack("<HQ", channel, at + len(record) + len(indices))
            pairs = b"".join(struct.pack("<QQ", *entry) for entry in entries)
            indices += _record(_MESSAGE_INDEX, struct.pack("<HI", channel, len(pairs)) + pairs)
        try:
            self._append(record + indices)
        except OSError:
            # Types and topics that were declared in it are still to be told.
            self._declare_again()
            raise
        self._chunks.append(
            span
            + struct.pack("<QQI", at, len(record), len(offsets))
            + offsets
            + struct.pack("<Q", len(indices))
            + _text("")
            + struct.pack("<QQ", len(raw), len(raw))
        )
        for channel, entries in chunk.index.items():
            self._counts[channel] += len(entries)
        self._first, self._last = min(self._first, chunk.first), max(self._last, chunk.last)
        if len(self._chunks) % REPEATED == 0:
            self._declare_again()
            with contextlib.suppress(OSError):  # The messages are there; the rest is said again later.
                self._tell_metadata()
        return messages

    def close(self) -> None:
        """Put what is pending, the summary and the end into the file, onto the disk, and close it.

        Raises:
            OSError: It could not be written whole; it is closed, and readable as far as it goes.
        """
        try:
            try:
                self.flush()
                self._tell_metadata()
            finally:
                self._append(_record(_DATA_END, struct.pack("<I", 0)) + self._summary())
            os.fsync(self._file.fileno())
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file as it is, without an end."""
        self._file.close()

    def _declare_again(self) -> None:
        self._chunk.records += b"".join(self._schemas + self._channels)

    def _tell_metadata(self) -> None:
        for name, texts in self._about.items():
            at = self._file.tell()
            record = _record(_METADATA, _text(name) + _map(texts))
            self._append(record)
            self._metadata.append(struct.pack("<QQ", at, len(record)) + _text(name))

    def _summary(self) -> bytes:
        start = self._file.tell() + len(_record(_DATA_END, struct.pack("<I", 0)))
        count, written = sum(self._counts.values()), [c for c in self._counts.items() if c[1]]
        statistics = struct.pack(
            "<QHIIIIQQI",
            count,
            len(self._schemas),
            len(self._channels),
            0,
            len(self._metadata),
            len(self._chunks),
            self._first if count else 0,
            self._last,
            10 * len(written),
        ) + b"".join(struct.pack("<HQ", *entry) for entry in written)
        groups = [
            (_SCHEMA, b"".join(self._schemas)),
            (_CHANNEL, b"".join(self._channels)),
            (_CHUNK_INDEX, b"".join(_record(_CHUNK_INDEX, index) for index in self._chunks)),
            (_METADATA_INDEX, b"".join(_record(_METADATA_INDEX, index) for index in self._metadata)),
            (_STATISTICS, _record(_STATISTICS, statistics)),
        ]
        summary, offsets = bytearray(), bytearray()
        for kind, records in groups:
            if records:
                place = struct.pack("<BQQ", kind, start + len(summary), len(records))
                offsets += _record(_SUMMARY_OFFSET, place)
            summary += records
        offset_start = start + len(summary)
        summary += offsets
        # The checksum covers the summary and the footer up to itself.
        footer = struct.pack("<BQQQ", _FOOTER, 20, start, offset_start)
        return bytes(summary) + footer + struct.pack("<I", zlib.crc32(summary + footer)) + MAGIC

    def _append(self, data: bytes) -> None:
        """Write whole or not at all."""
        before, left = self._file.tell(), memoryview(data)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError:
            self._file.truncate(before)
            self._file.seek(before)
            raise


class McapFile:
    """A file of this kind, whole, torn or damaged anywhere, whoever wrote it without compression.

    Messages are read in the order in which they were written, and those of a torn last chunk as far as they
    are whole. A chunk that is damaged is left out; after it the next one that may be one is looked for.
    """

    def __init__(self, path: Path) -> None:
        """Look at its beginning.

        Raises:
            FileNotFoundError: There is none.
            ValueError: It is something else.
        """
        if not path.is_file():
            raise FileNotFoundError(f"{path}: expected a log, got nothing there")
        with path.open("rb") as file:
            begins = file.read(len(MAGIC))
        # One that was begun and never reached the disk has a beginning of zeros, or none.
        if begins.strip(b"\0") and begins != MAGIC:
            raise ValueError(f"{path}: expected an MCAP file, got another beginning")
        self.path = path
        self.metadata: dict[str, dict[str, str]] = {}
        """By the name of the group, as far as it was read."""
        self.damage: list[str] = []
        """The first things that the last reading had to leave out (`MOST_TOLD`), and why it ended where there
        is no end."""
        self.left_out = 0
        """Bytes that it left out."""
        self.checked = False
        """Whether the message that was read last lay in a chunk whose checksum is right."""
        self._begins = begins

    @property
    def whole(self) -> bool:
        """Has it an end?"""
        with self.path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            if size < 2 * len(MAGIC):
                return False
            file.seek(-len(MAGIC), os.SEEK_END)
            return file.read() == MAGIC

    def messages(self) -> Iterator[Message]:
        """All messages. Afterwards `damage` and `left_out` say what is missing.

        Raises:
            ValueError: All of it is compressed.
        """
        self.damage, self.left_out = [], 0
        schemas: dict[int, str] = {0: ""}
        channels: dict[int, tuple[str, str]] = {}
        # What declares a channel may lie in a chunk that is damaged; the end says it again.
        for kind, record in self._summary():
            _declare(kind, record, schemas, channels)
        for at, kind, body, whole in self._records():
            try:
                if kind == _METADATA and whole:
                    self._take_metadata(body)
                elif kind == _CHUNK:
                    yield from self._in_chunk(at, body, whole, schemas, channels)
                elif kind == _MESSAGE and whole:
                    self.checked = False
                    yield _read_message(body, channels)
                elif whole:
                    _declare(kind, body, schemas, channels)
            except (_Damaged, struct.error) as error:
                self._leave_out(len(body), f"at byte {at}: {error}")

    def read_metadata(self) -> None:
        """Look for `metadata` in the whole file, wherever it stands first."""
        for _, kind, body, whole in self._records():
            if kind == _METADATA and whole:
                self._take_metadata(body)
            if self.metadata:
                break
        self.damage, self.left_out = [], 0

    def _take_metadata(self, body: bytes) -> None:
        name, start = _read_text(body, 0)
        self.metadata.setdefault(name, _read_map(body, start))

    def _leave_out(self, count: int, why: str) -> None:
        self.left_out += count
        if len(self.damage) < MOST_TOLD:
            self.damage.append(why)

    def _summary(self) -> Iterator[tuple[int, bytes]]:
        """Kind and content of what the end says, where there is one and its checksum is right."""
        tail = 29 + len(MAGIC)
        with self.path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            if size < tail or not self.whole:
                return
            file.seek(size - tail)
            kind, length, start, _, checksum = struct.unpack_from("<BQQQI", file.read(29))
            if kind != _FOOTER or length != 20 or not 0 < size - tail - start <= MOST_DECLARED:
                return
            file.seek(start)
            raw = file.read(size - tail - start + 25)
        if checksum and zlib.crc32(raw) != checksum:
            return
        yield from ((kind, body) for _, kind, body in _split(raw[:-25]))

    def _records(self) -> Iterator[tuple[int, int, bytes, bool]]:
        """Place, kind and content of what lies in the data section; the last one may not be whole.

        Of chunks only those whose checksum is right. What cannot be one leads to the next chunk.
        """
        at, spent = len(MAGIC) if self._begins == MAGIC else 0, 0
        with self.path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            while True:
                file.seek(at)
                head = file.read(9)
                if len(head) < 9:
                    self._leave_out(len(head), "it has no end")
                    return
                kind, length = struct.unpack("<BQ", head)
                if kind == _DATA_END and length == 4:
                    return
                why, body = "no record", b""
                if 0 < kind < 0x80 and length <= (MOST_BYTES if kind == _CHUNK else MOST_DECLARED):
                    body = file.read(length)
                    why = "" if len(body) == length else "a record that is torn"
                    if not why and kind == _CHUNK:
                        why = _wrong_with(body)
                if not why:
                    yield at, kind, body, True
                    at += 9 + length
                    continue
                spent += len(body)
                # A file that was made to be looked through again and again is not.
                following = _next_chunk(file, at + 1, size) if spent <= 4 * size + MOST_BYTES else None
                if following is None:
                    if why == "a record that is torn":
                        yield at, kind, body, False
                        self._leave_out(0, "it has no end")
                    else:
                        self._leave_out(size - at, f"at byte {at}: {why}, and no chunk after it")
                    return
                self._leave_out(following - at, f"at byte {at}: {why}")
                at = following

    def _in_chunk(
        self, at: int, body: bytes, whole: bool, schemas: dict[int, str], channels: dict[int, tuple[str, str]]
    ) -> Iterator[Message]:
        if len(body) < 40:
            self.left_out += len(body)
            return
        (checksum,) = struct.unpack_from("<I", body, 24)
        compression, start = _read_text(body, 28)
        if compression:
            if compression in ("lz4", "zstd"):
                raise ValueError(f"{self.path}: expected chunks without compression, got {compression}")
            raise _Damaged("a chunk without a name of its compression")
        raw = body[start + 8 :]
        checked = whole and checksum != 0
        if not whole:
            raw = _before_zeros(raw, at + 9 + start + 8)
        done = 0
        for end, kind, record in _split(raw):
            done = end
            try:
                if kind != _MESSAGE:
                    _declare(kind, record, schemas, channels)
                    continue
                message = _read_message(record, channels)
            except (_Damaged, struct.error) as error:
                self._leave_out(len(record), f"at byte {at}: {error}")
                continue
            self.checked = checked
            yield message
        self.left_out += len(body) - (start + 8) - done


class _Damaged(Exception):  # noqa: N818 - it names what was found.
    """Something that cannot be read, and has an end after which the reading can go on."""


def _split(raw: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Where each record of some bytes ends, its kind and its content; as far as they are whole."""
    at = 0
    while at + 9 <= len(raw):
        kind, length = struct.unpack_from("<BQ", raw, at)
        end = at + 9 + length
        if end > len(raw) or not kind:
            return
        yield end, kind, raw[at + 9 : end]
        at = end


def _wrong_with(body: bytes) -> str:
    """What is wrong with a chunk; empty where nothing is, or its checksum was left out."""
    if len(body) < 40:
        return "a chunk that is too short"
    size, checksum = struct.unpack_from("<QI", body, 16)
    compression, at = _read_text(body, 28)
    raw = memoryview(body)[at + 8 :]
    if not compression and (len(raw) != size or (checksum and zlib.crc32(raw) != checksum)):
        return "a chunk whose checksum is wrong"
    return ""


def _next_chunk(file: BinaryIO, start: int, size: int) -> int | None:
    """Where the next chunk seems to begin that is not compressed; None where none does."""
    while start < size:
        file.seek(start)
        block = file.read(_BLOCK + _CHUNK_HEAD)
        at = block.find(_CHUNK)
        while 0 <= at < _BLOCK and at + _CHUNK_HEAD <= len(block):
            length, first, last, raw, _, compression, records = struct.unpack_from("<QQQQIIQ", block, at + 1)
            if compression == 0 and raw == records == length - 40 <= MOST_BYTES and first <= last:
                return start + at
            at = block.find(_CHUNK, at + 1)
        start += _BLOCK
    return None


def _before_zeros(raw: bytes, at: int) -> bytes:
    """What of some bytes lies before the first sector of the file that was never written.

    Args:
        raw: Without a checksum.
        at: Where they lie in the file.
    """
    for start in range(-at % _SECTOR, len(raw) - _SECTOR + 1, _SECTOR):
        if not any(raw[start : start + _SECTOR]):
            return raw[:start]
    return raw


def _declare(kind: int, body: bytes, schemas: dict[int, str], channels: dict[int, tuple[str, str]]) -> None:
    if kind == _SCHEMA:
        schemas[struct.unpack_from("<H", body)[0]] = _read_text(body, 2)[0]
    elif kind == _CHANNEL:
        number, schema = struct.unpack_from("<HH", body)
        channels[number] = (_read_text(body, 4)[0], schemas.get(schema, ""))


def _read_message(body: bytes, channels: dict[int, tuple[str, str]]) -> Message:
    channel, _, time, _ = struct.unpack_from("<HIQQ", body)
    if channel not in channels:
        raise _Damaged(f"a message of channel {channel}, which was not declared")
    return Message(*channels[channel], time, body[22:])


def _record(kind: int, body: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(body)) + body


def _text(text: str) -> bytes:
    raw = text.encode()
    return struct.pack("<I", len(raw)) + raw


def _map(texts: dict[str, str]) -> bytes:
    body = b"".join(_text(key) + _text(value) for key, value in texts.items())
    return struct.pack("<I", len(body)) + body


def _read_text(body: bytes, at: int) -> tuple[str, int]:
    """The text, and where it ends."""
    if at + 4 > len(body):
        return "", len(body)
    (length,) = struct.unpack_from("<I", body, at)
    return body[at + 4 : at + 4 + length].decode("utf-8", "replace"), at + 4 + length


def _read_map(body: bytes, at: int) -> dict[str, str]:
    texts: dict[str, str] = {}
    at += 4
    while at < len(body):
        key, at = _read_text(body, at)
        texts[key], at = _read_text(body, at)
    return texts
