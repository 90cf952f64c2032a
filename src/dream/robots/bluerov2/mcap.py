"""MCAP files that survive the end of the process that writes them.

Format: the MCAP specification, version 0 (mcap.dev/spec): magic, records of `opcode u8, length u64`, a data
section of schemas, channels and chunks of messages, and a summary at the end. The writers of `rosbags` and of
`mcap` keep a chunk in memory until it is full; here it goes to the file whenever one asks. Without its end a
file is still read, up to the last message that is whole.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from typing import NamedTuple

MAGIC = b"\x89MCAP0\r\n"
MOST_BYTES = 1 << 30
"""A longer record is taken for a damaged length."""

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
        self._metadata: list[bytes] = []
        self._chunk = _Chunk()
        self._first, self._last = (1 << 63) - 1, 0
        try:
            self._append(MAGIC + _record(_HEADER, _text("ros2") + _text(library)))
            for name, texts in metadata.items():
                at = self._file.tell()
                record = _record(_METADATA, _text(name) + _map(texts))
                self._append(record)
                self._metadata.append(struct.pack("<QQ", at, len(record)) + _text(name))
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
            self._chunk.records += b"".join(self._schemas + self._channels)
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
        return messages

    def close(self) -> None:
        """Put what is pending, the summary and the end into the file, onto the disk, and close it.

        Raises:
            OSError: It could not be written whole; it is closed, and readable as far as it goes.
        """
        try:
            try:
                self.flush()
            finally:
                self._append(_record(_DATA_END, struct.pack("<I", 0)) + self._summary())
            os.fsync(self._file.fileno())
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file as it is, without an end."""
        self._file.close()

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
    """A file of this kind, whole or torn, whoever wrote it without compression.

    Messages are read in the order in which they were written, and those of a torn last chunk as far as they
    are whole. A chunk that is damaged is left out.
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
            if file.read(len(MAGIC)) != MAGIC:
                raise ValueError(f"{path}: expected an MCAP file, got another beginning")
        self.path = path
        self.metadata: dict[str, dict[str, str]] = {}
        """By the name of the group, as far as it was read."""
        self.damage: list[str] = []
        """What the last reading had to leave out, and why it ended where there is no end."""

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
        """All messages. Afterwards `damage` says what is missing.

        Raises:
            ValueError: A chunk is compressed.
        """
        self.damage = []
        schemas: dict[int, str] = {0: ""}
        channels: dict[int, tuple[str, str]] = {}
        for at, kind, body, whole in self._records():
            try:
                if kind == _METADATA and whole:
                    name, start = _read_text(body, 0)
                    self.metadata[name] = _read_map(body, start)
                elif kind == _CHUNK:
                    yield from self._in_chunk(body, whole, schemas, channels)
                elif kind == _MESSAGE and whole:
                    yield _read_message(body, channels)
                elif whole:
                    _declare(kind, body, schemas, channels)
            except (_Damaged, struct.error) as error:
                self.damage.append(f"at byte {at}: {error}")

    def _records(self) -> Iterator[tuple[int, int, bytes, bool]]:
        """Place, kind and content of what lies in the data section; the last one may not be whole."""
        with self.path.open("rb") as file:
            file.seek(len(MAGIC))
            while True:
                at = file.tell()
                head = file.read(9)
                if len(head) < 9:
                    self.damage.append("it has no end")
                    return
                kind, length = struct.unpack("<BQ", head)
                if kind == _DATA_END:
                    return
                if not 0 < kind < 0x80 or length > MOST_BYTES:
                    self.damage.append(f"at byte {at}: no record, so that nothing can be found after it")
                    return
                body = file.read(length)
                yield at, kind, body, len(body) == length

    def _in_chunk(
        self, body: bytes, whole: bool, schemas: dict[int, str], channels: dict[int, tuple[str, str]]
    ) -> Iterator[Message]:
        if len(body) < 32:
            return
        size, checksum = struct.unpack_from("<QI", body, 16)
        compression, at = _read_text(body, 28)
        if compression:
            raise ValueError(f"{self.path}: expected chunks without compression, got {compression}")
        raw = body[at + 8 :]
        if whole and (len(raw) != size or (checksum and zlib.crc32(raw) != checksum)):
            raise _Damaged("a chunk whose checksum is wrong")
        at = 0
        while at + 9 <= len(raw):
            kind, length = struct.unpack_from("<BQ", raw, at)
            record = raw[at + 9 : at + 9 + length]
            if len(record) < length:
                return
            at += 9 + length
            if kind == _MESSAGE:
                yield _read_message(record, channels)
            else:
                _declare(kind, record, schemas, channels)


class _Damaged(Exception):  # noqa: N818 - it names what was found.
    """Something that cannot be read, and has an end after which the reading can go on."""


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
