"""The room that a level cylinder has on its way through a volume."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from dream.mapping._kernels.volume import BITS, FELT, FREE, SOLID, find, free, make, state_of, surface, within

_TINY = 1e-9


class SweptBody(NamedTuple):
    """A level cylinder about the vehicle's centre, metres."""

    radius: float
    half_height: float


@njit(cache=True, nogil=True)
def _between(start, step, low, high):
    """The part, of 0 to 1, of a way along one axis that lies between two bounds; first > last where none."""
    if step == 0.0:
        return (0.0, 1.0) if low <= start <= high else (1.0, 0.0)
    first, last = (low - start) / step, (high - start) / step
    if first > last:
        first, last = last, first
    return max(first, 0.0), min(last, 1.0)


@njit(cache=True, nogil=True)
def _over_column(start, step, x, y, side, radius):
    """The part of a way over ground on which a disc touches the square of a column of voxels.

    Args:
        start: (2,) or longer, where the disc's middle begins, metres.
        step: Likewise, what it goes.
        x, y: Low corner of the square.
        side: Of the square.
        radius: Of the disc.

    Returns:
        First and last, of 0 to 1; first > last where it never does.
    """
    first, last = 1.0, 0.0
    # A square grown by a disc: two rectangles and a disc at each corner. It is convex.
    for wide in range(2):
        grow_x, grow_y = (radius, 0.0) if wide == 0 else (0.0, radius)
        a, b = _between(start[0], step[0], x - grow_x, x + side + grow_x)
        c, d = _between(start[1], step[1], y - grow_y, y + side + grow_y)
        a, b = max(a, c), min(b, d)
        if a <= b:
            first, last = min(first, a), max(last, b)
    length = step[0] * step[0] + step[1] * step[1]
    for corner in range(4):
        dx = start[0] - (x + (side if corner & 1 else 0.0))
        dy = start[1] - (y + (side if corner & 2 else 0.0))
        inside = dx * dx + dy * dy - radius * radius
        if length == 0.0:
            if inside <= 0.0:
                first, last = 0.0, 1.0
            continue
        along = dx * step[0] + dy * step[1]
        root = along * along - length * inside
        if root >= 0.0:
            root = math.sqrt(root)
            a, b = max((-along - root) / length, 0.0), min((-along + root) / length, 1.0)
            if a <= b:
                first, last = min(first, a), max(last, b)
    return first, last


@njit(cache=True, nogil=True)
def _box(start, end, body, side):
    """(2, 3) first level, row and column of the voxels that a swept body may touch, and past the last."""
    box = np.empty((2, 3), np.int64)
    for k in range(3):
        grow = body.half_height if k == 2 else body.radius
        box[0, 2 - k] = math.floor((min(start[k], end[k]) - grow) / side - _TINY)
        box[1, 2 - k] = math.floor((max(start[k], end[k]) + grow) / side + _TINY) + 1
    return box


@njit(cache=True, nogil=True)
def swept(bricks, start, end, body, side, odds, stamp):
    """Take every voxel that a swept body touches for at most so likely solid, where it is not solid.

    Args:
        bricks: Changed; with room for the bricks of the box around the way.
        start, end: (3,) of the body's centre, metres in the world.
        body: What is swept.
        side: Metres along a voxel.
        odds: Log-odds of what it touches.
        stamp: Of what is changed.
    """
    box, step = _box(start, end, body, side), end - start
    for row in range(box[0, 1], box[1, 1]):
        for col in range(box[0, 2], box[1, 2]):
            first, last = _over_column(start, step, col * side, row * side, side, body.radius)
            if first > last:
                continue
            for level in range(box[0, 0], box[1, 0]):
                low, high = level * side - body.half_height, (level + 1) * side + body.half_height
                a, b = _between(start[2], step[2], low, high)
                if max(a, first) <= min(b, last):
                    free(bricks, level, row, col, odds, stamp)


@njit(cache=True, nogil=True)
def _touches(start, step, body, side, level, row, col):
    """Does a body touch a voxel on its way?"""
    first, last = _over_column(start, step, col * side, row * side, side, body.radius)
    low, high = level * side - body.half_height, (level + 1) * side + body.half_height
    a, b = _between(start[2], step[2], low, high)
    return max(a, first) <= min(b, last)


@njit(cache=True, nogil=True)
def feel(bricks, here, before, place, end, body, side, stamp):
    """Take for solid, for good, what a body touches from one place to an end and not from here until before.

    Args:
        bricks: Changed; with room for the bricks and surfaces of the box around the way.
        here, before, place, end: (3,) of the body's centre, metres in the world.
        body: What is swept.
        side: Metres along a voxel.
        stamp: Of what is changed.
    """
    box, onward, behind = _box(place, end, body, side), end - place, before - here
    for level in range(box[0, 0], box[1, 0]):
        for row in range(box[0, 1], box[1, 1]):
            for col in range(box[0, 2], box[1, 2]):
                if _touches(place, onward, body, side, level, row, col) and not _touches(
                    here, behind, body, side, level, row, col
                ):
                    slot, number = (
                        make(bricks, level >> BITS, row >> BITS, col >> BITS),
                        within(level, row, col),
                    )
                    at = surface(bricks, slot)
                    bricks.log_odds[slot, number] = FELT
                    bricks.saturated[slot] = 0
                    bricks.stamps[slot] = stamp
                    bricks.seen[at, number] = 1
                    bricks.votes[at, number, 1] = max(bricks.votes[at, number, 1], np.uint16(1))


@njit(cache=True, nogil=True)
def _leaves(step, dx, dy, dz):
    """Does a way lead away, over ground and in height, from what lies at (dx, dy, dz) from its start?"""
    return step[0] * dx + step[1] * dy <= 0.0 and step[2] * dz <= 0.0


@njit(cache=True, nogil=True)
def room(bricks, starts, ends, body, side):
    """What a body touches that is not known to be free, way by way.

    Args:
        bricks: What is known.
        starts, ends: (M, 3) of the body's centre, metres in the world.
        body: What is swept.
        side: Metres along a voxel.

    Returns:
        reason: (M,) uint8 state of the worst that it touches, solid before unknown before free.
        share: (M,) of the way before the first of it.
        where: (M, 3) middle of that voxel; NaN where there is none.
    """
    count = len(starts)
    reason, share, where = np.full(count, FREE, np.uint8), np.ones(count), np.full((count, 3), np.nan)
    for m in range(count):
        start, step = starts[m], ends[m] - starts[m]
        box = _box(start, ends[m], body, side)
        last_level, last_row, last_col, slot = 1 << 40, 0, 0, 0
        nearest = 2.0
        for row in range(box[0, 1], box[1, 1]):
            for col in range(box[0, 2], box[1, 2]):
                first, last = _over_column(start, step, col * side, row * side, side, body.radius)
                if first > last:
                    continue
                for level in range(box[0, 0], box[1, 0]):
                    brick = level >> BITS, row >> BITS, col >> BITS
                    if brick[0] != last_level or brick[1] != last_row or brick[2] != last_col:
                        last_level, last_row, last_col = brick
                        slot = find(bricks, last_level, last_row, last_col)
                    state = state_of(bricks.log_odds[slot, within(level, row, col)])
                    if state == FREE:
                        continue
                    low, high = level * side - body.half_height, (level + 1) * side + body.half_height
                    a, b = _between(start[2], step[2], low, high)
                    a, b = max(a, first), min(b, last)
                    if a > b:
                        continue
                    x, y, z = (col + 0.5) * side, (row + 0.5) * side, (level + 0.5) * side
                    if a <= 0.0 and _leaves(step, x - start[0], y - start[1], z - start[2]):
                        continue
                    if state == SOLID or reason[m] == FREE:
                        reason[m] = state
                    if a < nearest:
                        nearest, share[m] = a, a
                        where[m, 0], where[m, 1], where[m, 2] = x, y, z
    return reason, share, where
