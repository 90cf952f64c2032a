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


def multipolygon(rings: Sequence[Float64Array]) -> bytes:
    """Of closed rings: outlines run counter-clockwise, each with the clockwise holes that lie in it.

    Parts of one patch that touch at a corner are outlines of their own.
    """
    outlines = [ring for ring in rings if _turn(ring) > 0.0]
    holes: list[list[Float64Array]] = [[] for _ in outlines]
    for ring in rings:
        if _turn(ring) <= 0.0:
            # Between two corners of a hole, so that a corner that it shares with an outline is no doubt.
            middle = 0.5 * (ring[0] + ring[1])
            inside = [k for k, outline in enumerate(outlines) if _within(middle, outline)]
            smallest = min(inside, key=lambda k: _turn(outlines[k]), default=0)
            holes[smallest].append(ring)
    parts = [polygon([outline, *within]) for outline, within in zip(outlines, holes, strict=True)]
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


def _turn(ring: Float64Array) -> float:
    """Area, positive counter-clockwise."""
    x, y = (ring - ring[0]).T
    return float(0.5 * (x[:-1] * y[1:] - x[1:] * y[:-1]).sum())


def _within(place: Float64Array, ring: Float64Array) -> bool:
    """By the parity of crossings to the west."""
    (x0, y0), (x1, y1) = ring[:-1].T, ring[1:].T
    crosses = (y0 <= place[1]) != (y1 <= place[1])
    at = x0[crosses] + (place[1] - y0[crosses]) * (x1 - x0)[crosses] / (y1 - y0)[crosses]
    return bool((at < place[0]).sum() % 2)


def _places(places: Float64Array) -> bytes:
    return struct.pack("<I", len(places)) + np.ascontiguousarray(places, "<f8").tobytes()
