"""Points, lines and polygons as well-known binary (OGC 06-103r4), little-endian."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dream.survey.patches import grouped

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


def multipolygon(rings: Sequence[Float64Array]) -> bytes:
    """Of closed rings: outlines run counter-clockwise, each with the clockwise holes that lie in it."""
    parts = [polygon(part) for part in grouped(rings)]
    return struct.pack("<BII", 1, 6, len(parts)) + b"".join(parts)


def envelope(geometry: bytes) -> tuple[float, float, float, float]:
    """West, east, south and north of a line, or of the outlines of polygons."""
    if kind(geometry) == 6:
        boxes, start = [], 9
        for _ in range(struct.unpack_from("<I", geometry, 5)[0]):
            boxes.append(envelope(geometry[start:]))
            rings = struct.unpack_from("<I", geometry, start + 5)[0]
            start += 9
            for _ in range(rings):
                start += 4 + 16 * struct.unpack_from("<I", geometry, start)[0]
        west, east, south, north = zip(*boxes, strict=True)
        return min(west), max(east), min(south), max(north)
    start = 5 if kind(geometry) == 2 else 9
    (count,) = struct.unpack_from("<I", geometry, start)
    places = np.frombuffer(geometry, "<f8", 2 * count, start + 4).reshape(-1, 2)
    (left, low), (right, high) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    return left, right, low, high


def kind(geometry: bytes) -> int:
    """1 of a point, 2 of a line, 3 of a polygon, 6 of several."""
    return int(struct.unpack_from("<I", geometry, 1)[0])


def _places(places: Float64Array) -> bytes:
    return struct.pack("<I", len(places)) + np.ascontiguousarray(places, "<f8").tobytes()
