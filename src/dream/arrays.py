"""Arrays from files of NumPy, `.npz` and `.npy`, that anyone may have written: the one reader of them.

Nothing in a file is evaluated, and nothing is allocated on its word: headers are matched with a pattern, an
array is as large as the bytes that are there, and packed bytes unpack to no more than packing can hold. What
is damaged or foreign is one kind of error, a ValueError.

Reference: NumPy's format (NEP 1), version 1.0; ZIP (APPNOTE 6.3), stored or deflated.
"""

from __future__ import annotations

import contextlib
import io
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

MOST_BYTES = 2 << 30
"""Of all arrays of a file, unpacked."""
MOST_ENTRIES = 1000
"""Of an archive."""
MOST_HEADER = 4096
"""Bytes of the header of an array."""
MOST_RATIO = 1100
"""By which bytes grow when they are unpacked: deflate has 1032 at most (RFC 1951)."""

_MAGIC = b"\x93NUMPY\x01\x00"
_FIELD = rb"'(?:descr'\s*:\s*'[^']*'|fortran_order'\s*:\s*(?:True|False)|shape'\s*:\s*\([0-9,\s]*\))"
_HEADER = re.compile(rb"\{\s*" + _FIELD + rb"(?:\s*,\s*" + _FIELD + rb"){2}\s*,?\s*\}\s*")
_DESCR = re.compile(rb"'descr'\s*:\s*'([<>|=]?(?:b1|[iu][1248]|f[248]|U[0-9]{1,7}))'")
_ORDER = re.compile(rb"'fortran_order'\s*:\s*(True|False)")
_SHAPE = re.compile(rb"'shape'\s*:\s*\(((?:\s*[0-9]{1,15}\s*,)*\s*(?:[0-9]{1,15})?\s*)\)")
_LAST_CHARACTER = 0x10FFFF
_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    MemoryError,
    NotImplementedError,  # Packed in another way.
    RuntimeError,  # Encrypted.
    OSError,  # Sought to before its beginning.
    OverflowError,
)
"""What reading a damaged archive may raise beside a ValueError."""


class Header(NamedTuple):
    """What a file says of an array."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    fortran: bool
    """Columns first."""
    start: int
    """Bytes before the values."""

    @property
    def nbytes(self) -> int:
        """Bytes of its values."""
        return math.prod(self.shape) * self.dtype.itemsize


class Npz(Mapping[str, Array]):
    """The arrays of an open archive by name, each unpacked when it is asked for.

    All raises a ValueError where the archive is damaged, or has no array of that name.
    """

    def __init__(self, file: zipfile.ZipFile, size: int, most: int) -> None:
        """Look at what is there, and unpack nothing.

        Args:
            file: The archive.
            size: Its bytes.
            most: Bytes that all of it may hold unpacked.
        """
        entries = file.infolist()
        if len(entries) > MOST_ENTRIES:
            raise ValueError(f"expected at most {MOST_ENTRIES} entries, got {len(entries)}")
        self._file = file
        self._entries = {entry.filename: entry for entry in entries}
        if len(self._entries) < len(entries):
            raise ValueError("expected every entry once, got one twice")
        total = sum(entry.file_size for entry in entries)
        if total > most:
            raise ValueError(f"expected at most {most} bytes unpacked, got {total}")
        for entry in entries:
            if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ValueError(f"{entry.filename[:80]}: expected it stored or deflated")
            if entry.file_size > MOST_RATIO * (min(entry.compress_size, size) + 1):
                raise ValueError(
                    f"{entry.filename[:80]}: claims {entry.file_size} bytes in {entry.compress_size}"
                )
        self.headers = {
            name.removesuffix(".npy"): self._header(name) for name in self._entries if name.endswith(".npy")
        }
        """Shape and type of every array."""

    @property
    def entries(self) -> set[str]:
        """Names of all that is in the archive; those of arrays end in `.npy`."""
        return set(self._entries)

    def __iter__(self) -> Iterator[str]:
        return iter(self.headers)

    def __len__(self) -> int:
        return len(self.headers)

    def __contains__(self, name: object) -> bool:
        return name in self.headers

    def __getitem__(self, name: str) -> Array:
        if name not in self.headers:
            raise ValueError(f"{name}: expected an array of that name, got none")
        return parsed(self.content(f"{name}.npy"), name)

    def content(self, entry: str, most: int = MOST_BYTES) -> bytes:
        """The bytes of an entry, which must be so many at most."""
        if (size := self._entries[entry].file_size) > most:
            raise ValueError(f"{entry}: {size} bytes, which is too much")
        with _told(entry):
            return self._file.read(self._entries[entry])

    def _header(self, entry: str) -> Header:
        found = self._entries[entry]
        with _told(entry), self._file.open(found) as stream:
            header = _header_of(stream.read(len(_MAGIC) + 2 + MOST_HEADER))
            if header.start + header.nbytes != found.file_size:
                raise ValueError(f"claims {header.shape} {header.dtype} in {found.file_size} bytes")
        return header


@contextlib.contextmanager
def opened(source: Path | bytes, expected: str, most: int = MOST_BYTES) -> Iterator[Npz]:
    """The arrays of an `.npz` file, or of the bytes of one.

    Args:
        source: Where it lies; or what it holds.
        expected: What it should be, for the error: "a map written by save".
        most: Bytes that all of it may hold unpacked.

    Raises:
        OSError: It cannot be opened, such as where there is none.
        ValueError: It is damaged or foreign, or what is done within the block finds so; the message names the
            file.
    """
    where = f"{source}: " if isinstance(source, Path) else ""
    with contextlib.ExitStack() as stack:
        stream: IO[bytes] = source.open("rb") if isinstance(source, Path) else io.BytesIO(source)
        stack.enter_context(stream)
        try:
            with _told():
                size = stream.seek(0, io.SEEK_END)
                file = stack.enter_context(zipfile.ZipFile(stream))
            yield Npz(file, size, most)
        except ValueError as error:
            raise ValueError(
                f"{where}expected {expected}, got a damaged or foreign file ({error})"
            ) from error


def read(path: Path, expected: str, shape: tuple[int, ...], dtype: npt.DTypeLike) -> Array:
    """The array of an `.npy` file, which must be of that shape and type.

    Args:
        path: Where it lies.
        expected: What it should be, for the error.
        shape: As it must be.
        dtype: As it must be, in this or the other order of bytes.

    Raises:
        OSError: It cannot be read.
        ValueError: It is damaged or another array; the message names the file.
    """
    kind = np.dtype(dtype)
    try:
        with path.open("rb") as stream:
            header = _header_of(stream.read(len(_MAGIC) + 2 + MOST_HEADER))
            stream.seek(0)
            fits = header.shape == shape and header.dtype.newbyteorder("=") == kind
            # One byte more than there may be tells of those that are too many.
            array = parsed(stream.read(header.start + header.nbytes + 1)).astype(kind) if fits else None
    except ValueError as error:
        raise ValueError(f"{path.name}: expected {expected}, got a damaged file ({error})") from error
    if array is None:
        raise ValueError(f"{path.name}: expected {expected}, got {header.dtype} {header.shape}")
    return array


def parsed(content: bytes, name: str = "") -> Array:
    """The array that the bytes of an `.npy` file hold, as one that may be written to.

    Args:
        content: All of the file.
        name: What errors call it.

    Raises:
        ValueError: They are damaged or foreign.
    """
    with _told(name):
        header = _header_of(content[: len(_MAGIC) + 2 + MOST_HEADER])
        left = len(content) - header.start
        if left != header.nbytes:
            raise ValueError(f"claims {header.shape} {header.dtype} in {left} bytes")
        flat = np.frombuffer(content, header.dtype, math.prod(header.shape), header.start)
        # Of bytes that are neither yes nor no, or no character, NumPy makes what it likes.
        if header.dtype.kind == "b" and flat.size and flat.view(np.uint8).max() > 1:
            raise ValueError("expected yes or no, got other bytes")
        if header.dtype.kind == "U" and flat.size and header.dtype.itemsize:
            letters = np.frombuffer(content, header.dtype.str[0] + "u4", offset=header.start)
            if letters.max() > _LAST_CHARACTER:
                raise ValueError("expected text, got bytes that are no characters")
        return flat.reshape(header.shape, order="F" if header.fortran else "C").copy(order="K")


def _header_of(content: bytes) -> Header:
    """What the first bytes of an array say of it. Raises a ValueError where they are none."""
    if content[: len(_MAGIC)] != _MAGIC or len(content) < len(_MAGIC) + 2:
        raise ValueError("expected version 1.0 of .npy, got another or none")
    start = len(_MAGIC) + 2
    length = int.from_bytes(content[start - 2 : start], "little")
    text = content[start : start + length]
    if length > MOST_HEADER or len(text) < length or not _HEADER.fullmatch(text):
        raise ValueError("expected a header with descr, fortran_order and shape, got another or none")
    fields = [pattern.search(text) for pattern in (_DESCR, _ORDER, _SHAPE)]
    if None in fields:
        raise ValueError(f"expected plain numbers or text, got {text[:80]!r}")
    descr, order, shape = (found[1] for found in fields if found is not None)
    sides = tuple(int(side) for side in shape.split(b",") if side.strip())
    if len(sides) > 8:
        raise ValueError(f"expected at most 8 dimensions, got {len(sides)}")
    return Header(sides, np.dtype(descr.decode()), order == b"True", start + length)


@contextlib.contextmanager
def _told(name: str = "") -> Iterator[None]:
    """Whatever is wrong in the block is a ValueError that names the array."""
    try:
        yield
    except (ValueError, *_DAMAGED) as error:
        words = str(error) or type(error).__name__
        raise ValueError(f"{name[:80]}: {words}" if name else words) from error
