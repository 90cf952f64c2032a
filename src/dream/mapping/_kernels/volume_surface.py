"""The surface of what is solid in a volume, and the view of it from above."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dream.mapping._kernels.volume import (
    BITS,
    FREE,
    SIDE,
    SOLID,
    UNKNOWN,
    VOXELS,
    find,
    state_of,
    within,
)

HALO = SIDE + 2
"""Voxels along a brick with one more on each side."""
NEARNESS = (math.inf, 1.0, 1.0 / math.sqrt(2.0), 1.0 / math.sqrt(3.0))
"""One over the distance of two voxels, by its square."""


@njit(cache=True, nogil=True)
def around(bricks, level, row, col, states):
    """Write into (10, 10, 10) the states of a brick and of one voxel around it."""
    slots = np.empty((3, 3, 3), np.int64)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                slots[i, j, k] = find(bricks, level + i - 1, row + j - 1, col + k - 1)
    for i in range(HALO):
        h, up = (i - 1) & (SIDE - 1), (i + SIDE - 1) >> BITS
        for j in range(HALO):
            r, north = (j - 1) & (SIDE - 1), (j + SIDE - 1) >> BITS
            line = (h << 2 * BITS) | (r << BITS)
            for k in range(HALO):
                slot = slots[up, north, (k + SIDE - 1) >> BITS]
                states[i, j, k] = state_of(bricks.log_odds[slot, line | ((k - 1) & (SIDE - 1))])


@njit(cache=True, nogil=True)
def touches(states, i, j, k, state):
    """Is a face neighbour of such a state?"""
    return (
        states[i - 1, j, k] == state
        or states[i + 1, j, k] == state
        or states[i, j - 1, k] == state
        or states[i, j + 1, k] == state
        or states[i, j, k - 1] == state
        or states[i, j, k + 1] == state
    )


@njit(cache=True, nogil=True)
def _write_normal(states, i, j, k, normal):
    """Write into (3,) east, north, up: towards the free voxels among the 26 around, of length 1."""
    normal[:] = 0.0
    for a in range(-1, 2):
        for b in range(-1, 2):
            for c in range(-1, 2):
                state = states[i + a, j + b, k + c]
                if state == UNKNOWN or (a == 0 and b == 0 and c == 0):
                    continue
                weight = NEARNESS[a * a + b * b + c * c]
                if state != FREE:
                    weight = -weight
                normal[0] += c * weight
                normal[1] += b * weight
                normal[2] += a * weight
    length = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    if length < 1e-6:
        # A plate that is free on both sides alike: the first of its free faces.
        for axis in range(3):
            for sign in (1, -1):
                a, b, c = (sign if axis == 2 else 0), (sign if axis == 1 else 0), (sign if axis == 0 else 0)
                if states[i + a, j + b, k + c] == FREE:
                    normal[:] = 0.0
                    normal[axis] = sign
                    return
    for axis in range(3):
        normal[axis] /= length


@njit(cache=True, nogil=True)
def surface(bricks):
    """All solid voxels with a free face neighbour, brick by brick.

    Args:
        bricks: What is known.

    Returns:
        voxels: (n, 3) int64 level, row and column.
        normals: (n, 3) east, north, up, of length 1.
        share: (n,) of votes for target.
        seen: (n,) bool.
        sides: (n,) uint32.
    """
    size, count = 1024, 0
    voxels, normals, share = np.empty((size, 3), np.int64), np.empty((size, 3)), np.empty(size)
    seen, sides = np.empty(size, np.bool_), np.empty(size, np.uint32)
    states = np.empty((HALO, HALO, HALO), np.uint8)
    for slot in range(1, bricks.used[0]):
        kept = bricks.surface_of[slot]
        if kept == 0:
            continue
        level, row, col = (
            np.int64(bricks.names[slot, 0]),
            np.int64(bricks.names[slot, 1]),
            np.int64(bricks.names[slot, 2]),
        )
        around(bricks, level, row, col, states)
        if count + VOXELS > size:
            size *= 2
            voxels, normals = grown(voxels, size), grown(normals, size)
            share, seen, sides = grown(share, size), grown(seen, size), grown(sides, size)
        for number in range(VOXELS):
            i, j, k = (number >> 2 * BITS) + 1, ((number >> BITS) & (SIDE - 1)) + 1, (number & (SIDE - 1)) + 1
            if states[i, j, k] != SOLID or not touches(states, i, j, k, FREE):
                continue
            voxels[count, 0] = level * SIDE + i - 1
            voxels[count, 1] = row * SIDE + j - 1
            voxels[count, 2] = col * SIDE + k - 1
            _write_normal(states, i, j, k, normals[count])
            share[count] = bricks.votes[kept, number, 0] / max(bricks.votes[kept, number, 1], 1)
            seen[count] = bricks.seen[kept, number] != 0
            sides[count] = bricks.sides[kept, number]
            count += 1
    return voxels[:count], normals[:count], share[:count], seen[:count], sides[:count]


@njit(cache=True, nogil=True)
def grown(array, size):
    """A longer array that begins with this one."""
    larger = np.empty((size, *array.shape[1:]), array.dtype)
    larger[: len(array)] = array
    return larger


@njit(cache=True, nogil=True)
def _indices(at, side):
    """(n,) rows or columns of voxels that places lie in, metres."""
    found = np.empty(len(at), np.int64)
    for n in range(len(at)):
        found[n] = math.floor(at[n] / side)
    return found


@njit(cache=True, nogil=True)
def _by_brick(indices):
    """Where each row or column of bricks begins among those of voxels, in order, and past the last."""
    first = np.empty(len(indices) + 1, np.int64)
    count = 0
    for n in range(len(indices)):
        if n == 0 or indices[n] >> BITS != indices[n - 1] >> BITS:
            first[count] = n
            count += 1
    first[count] = len(indices)
    return first[: count + 1]


@njit(cache=True, nogil=True)
def _stack(bricks, levels, row, col, slots):
    """Write the bricks that stand over each other there, from the first level on; does any keep a return?"""
    some = False
    for n in range(len(slots)):
        slots[n] = find(bricks, levels[0] + n, row >> BITS, col >> BITS)
        some |= bricks.surface_of[slots[n]] != 0
    return some


@njit(cache=True, nogil=True)
def columns(bricks, x, y, side, levels):
    """What stands in each column of voxels, from below.

    Args:
        bricks: What is known.
        x, y: (cols,) and (rows,) where the columns are, metres.
        side: Metres along a voxel.
        levels: First level of bricks, and past the last.

    Returns:
        lowest: (rows, cols) level of the lowest solid voxel that is not target; −1 below `levels` if none.
        highest: (rows, cols) level of the highest solid voxel, likewise.
        votes: (rows, cols, 2) for target, and all.
        explored: (rows, cols) whether something solid looks up into free water, and all that does was seen,
            or lies on a voxel that was: heights from afar err by one.
    """
    shape = (len(y), len(x))
    none = levels[0] * SIDE - 1
    lowest, highest = np.full(shape, none), np.full(shape, none)
    votes, explored = np.zeros((*shape, 2), np.int64), np.zeros(shape, np.bool_)
    rows, cols = _indices(y, side), _indices(x, side)
    # One more, which lies over the last and is nothing.
    slots = np.empty(levels[1] - levels[0] + 1, np.int64)
    south, west = _by_brick(rows), _by_brick(cols)
    for a in range(len(south) - 1):
        for b in range(len(west) - 1):
            if not _stack(bricks, levels, rows[south[a]], cols[west[b]], slots):
                continue
            for i in range(south[a], south[a + 1]):
                for j in range(west[b], west[b + 1]):
                    lowest[i, j], highest[i, j], explored[i, j] = _column(
                        bricks, slots, rows[i], cols[j], none, votes[i, j]
                    )
    return lowest, highest, votes, explored


@njit(cache=True, nogil=True)
def _column(bricks, slots, row, col, none, votes):
    """Lowest, highest and explored of one column of voxels, and into (2,) its votes; see `columns`."""
    lowest, highest = none, none
    bare, open_above, was_seen = False, False, none - 1
    for n in range(len(slots) - 1):
        slot = slots[n]
        kept = bricks.surface_of[slot]
        if kept == 0:
            continue
        for h in range(SIDE):
            number = within(h, row, col)
            if bricks.log_odds[slot, number] <= 0:
                continue
            target, cast = np.int64(bricks.votes[kept, number, 0]), bricks.votes[kept, number, 1]
            level = none + 1 + n * SIDE + h
            if lowest == none and 2 * target <= cast:
                lowest = level
            highest = level
            votes[0] += target
            votes[1] += cast
            above = slot if h + 1 < SIDE else slots[n + 1]
            if bricks.log_odds[above, within(h + 1, row, col)] < 0:
                open_above = True
                bare |= bricks.seen[kept, number] == 0 and was_seen < level - 1
            if bricks.seen[kept, number] != 0:
                was_seen = level
    return lowest, highest, open_above and not bare


@njit(cache=True, nogil=True)
def solid_between(bricks, x, y, side, levels, low, high):
    """(rows, cols) whether a solid voxel's middle lies between two heights (rows, cols); see `columns`."""
    solid = np.zeros(low.shape, np.bool_)
    rows, cols = _indices(y, side), _indices(x, side)
    slots = np.empty(levels[1] - levels[0], np.int64)
    south, west = _by_brick(rows), _by_brick(cols)
    for a in range(len(south) - 1):
        for b in range(len(west) - 1):
            # Where nothing returned nothing is solid.
            if not _stack(bricks, levels, rows[south[a]], cols[west[b]], slots):
                continue
            for i in range(south[a], south[a + 1]):
                for j in range(west[b], west[b + 1]):
                    if low[i, j] <= high[i, j]:
                        first = max(math.ceil(low[i, j] / side - 0.5), levels[0] * SIDE)
                        past = min(math.floor(high[i, j] / side - 0.5) + 1, levels[1] * SIDE)
                        solid[i, j] = _some_solid(bricks, slots, levels, rows[i], cols[j], first, past)
    return solid


@njit(cache=True, nogil=True)
def _some_solid(bricks, slots, levels, row, col, first, past):
    """Is a voxel of a column solid between two levels of voxels?"""
    for level in range(first, past):
        if bricks.log_odds[slots[(level >> BITS) - levels[0]], within(level, row, col)] > 0:
            return True
    return False
