"""Points, lines and polygons as well-known binary (OGC 06-103r4), little-endian."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]


def point(x: float, y: float) -> bytes:
    """One place."""
    return struct.pack("<BIdd", 1, 1, x, y)


def line(places: Float64Array) -> bytes:
    """Through (n, 2) places."""
    return struct.pack("<BI", 1, 2) + _places(places)


def polygon(rings: Sequence[Float64Array]) -> bytes:
    """Of closed rings, (n, 2) each: the outline, then its holes."""
    return struct.pack("<BII", 1, 3, len(rings)) + b"".join(map(_places, rings))


def envelope(geometry: bytes) -> tuple[float, float, float, float]:
    """West, east, south and north of a line, or of a polygon's outline."""
    start = 5 if kind(geometry) == 2 else 9
    (count,) = struct.unpack_from("<I", geometry, start)
    places = np.frombuffer(geometry, "<f8", 2 * count, start + 4).reshape(-1, 2)
    (west, south), (east, north) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    return west, east, south, north


def kind(geometry: bytes) -> int:
    """1 of a point, 2 of a line, 3 of a polygon."""
    return int(struct.unpack_from("<I", geometry, 1)[0])


def _places(places: Float64Array) -> bytes:
    return struct.pack("<I", len(places)) + np.ascontiguousarray(places, "<f8").tobytes()
