"""Where to fly so that a box is seen: lanes and spirals, and the choice between their mirror images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds
from dream.protocol import SurveyProtocol

Points = npt.NDArray[np.floating[Any]]


def seen_to_both_sides(protocol: SurveyProtocol) -> float:
    """Metres across the strip that the camera sees along a straight line, if it looked all the time."""
    return 2.0 * protocol.reach * math.sin(protocol.camera.horizontal_fov / 2.0)


def spread(low: float, high: float, spacing: float) -> Points:
    """(n,) middles of the fewest equal strips between `low` and `high` that are at most `spacing` wide."""
    count = max(1, math.ceil((high - low) / spacing - 1e-9))
    return np.asarray(low + (np.arange(count) + 0.5) * (high - low) / count)


def lanes(box: Bounds, spacing: float, inset: float) -> Points:
    """(2 n, 2) corners of a boustrophedon: lanes run south-north, the westernmost first, upwards first.

    Args:
        box: The area.
        spacing: Metres between lanes at most.
        inset: Metres between the lanes' ends and the edge of the area.
    """
    inset = min(inset, 0.4 * box.depth)
    ends = (box.y_min + inset, box.y_max - inset)
    xs = spread(box.x_min, box.x_max, spacing)
    return np.array([(x, y) for k, x in enumerate(xs) for y in (ends if k % 2 == 0 else ends[::-1])])


def spiral(box: Bounds, spacing: float) -> Points:
    """(n, 2) corners of a square spiral from the south-west corner inwards, northwards first.

    Args:
        box: The area.
        spacing: Metres between turns, and twice that to the edge, at most.
    """
    xs, ys = spread(box.x_min, box.x_max, spacing), spread(box.y_min, box.y_max, spacing)
    west, east, south, north = 0, len(xs) - 1, 0, len(ys) - 1
    corners = [(west, south)]
    while True:
        for side in range(4):
            if side == 0:
                corner, west = (west, north), west + 1
            elif side == 1:
                corner, north = (east, north), north - 1
            elif side == 2:
                corner, east = (east, south), east - 1
            else:
                corner, south = (west, south), south + 1
            if corner != corners[-1]:
                corners.append(corner)
            if west > east or south > north:
                return np.array([(xs[col], ys[row]) for col, row in corners])


def mirrored(corners: Points, box: Bounds) -> list[Points]:
    """The route and its mirror images: west-east, south-north, both."""
    center = np.array([box.x_min + box.x_max, box.y_min + box.y_max]) / 2.0
    return [center + (corners - center) * flip for flip in product((1.0, -1.0), repeat=2)]


def across(box: Bounds) -> Bounds:
    """The box with x and y exchanged."""
    return Bounds(box.y_min, box.x_min, box.y_max, box.x_max)


def shortest(routes: Sequence[Points], start: SE2) -> Points:
    """The route that is soonest flown to its end from a start; of several the first."""

    def length(route: Points) -> float:
        way = np.concatenate([[[start.x, start.y]], route])
        return round(float(np.hypot(*np.diff(way, axis=0).T).sum()), 6)

    return min(routes, key=length)


def densified(corners: Points, step: float) -> Points:
    """(N, 2) the same way with points at most `step` apart."""
    pieces = [corners[:1]]
    for a, b in pairwise(corners):
        count = max(1, math.ceil(float(np.hypot(*(b - a))) / step - 1e-9))
        pieces.append(a + (np.arange(1, count + 1) / count)[:, None] * (b - a))
    return np.concatenate(pieces)
