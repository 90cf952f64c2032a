"""Where a volume keeps its voxels: bricks of 8³ in growing pools, found by hashing; and what one holds.

A brick is named by its level, row and column; level grows with z, row with y, col with x, from the world's
origin. Within a brick, voxels are numbered level by level, row by row.

Reference: Niessner et al., Real-time 3D Reconstruction at Scale using Voxel Hashing, 2013.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

BITS = 3
SIDE = 1 << BITS
"""Voxels along a brick."""
VOXELS = SIDE**3
"""Voxels of a brick."""
FARTHEST = 1 << 20
"""Bricks from the origin beyond which there is none."""
UNKNOWN, FREE, SOLID = 0, 1, 2
"""States of a voxel."""
FELT = 127
"""Log-odds of a voxel that the body touched: it stays solid, whatever is seen."""
_EMPTY = -1
_BRICKS, _SURFACES = 0, 1


class Bricks(NamedTuple):
    """The voxels. All arrays are written in place; brick 0 and surface 0 are nothing, and stay zero."""

    keys: npt.NDArray[np.int64]
    """(2^n,) hash table: packed name of a brick, or −1."""
    slots: npt.NDArray[np.int32]
    """(2^n,) the brick of that name."""
    used: npt.NDArray[np.int64]
    """(2,) bricks and surfaces made, those of nothing among them."""
    names: npt.NDArray[np.int32]
    """(bricks, 3) level, row and column."""
    log_odds: npt.NDArray[np.int8]
    """(bricks, 512) of solid; 0 is unknown."""
    saturated: npt.NDArray[np.uint8]
    """(bricks,) a bit for each eighth of it, whether all of that is as free as can be."""
    stamps: npt.NDArray[np.int64]
    """(bricks,) the revision at which it was last changed."""
    surface_of: npt.NDArray[np.int32]
    """(bricks,) where what returned from it is kept, 0 where nothing ever did."""
    votes: npt.NDArray[np.uint16]
    """(surfaces, 512, 2) for target, and all that were cast."""
    seen: npt.NDArray[np.uint8]
    """(surfaces, 512) whether it returned from within reach."""
    sides: npt.NDArray[np.uint32]
    """(surfaces, 512) bits of the sides from which it was inspected."""


@njit(cache=True, nogil=True)
def _key(level, row, col):
    """The packed name of a brick."""
    return ((level + FARTHEST) << 42) | ((row + FARTHEST) << 21) | (col + FARTHEST)


@njit(cache=True, nogil=True)
def _place(keys, key):
    """Where in the table a key is, or would be put."""
    mask = len(keys) - 1
    at = ((key * 0x1E3779B97F4A7C15) >> 24) & mask
    while keys[at] != key and keys[at] != _EMPTY:
        at = (at + 1) & mask
    return at


@njit(cache=True, nogil=True)
def find(bricks, level, row, col):
    """The brick of that name, 0 where there is none."""
    at = _place(bricks.keys, _key(level, row, col))
    return bricks.slots[at] if bricks.keys[at] != _EMPTY else 0


@njit(cache=True, nogil=True)
def make(bricks, level, row, col):
    """The brick of that name, made where there is none. There must be room for it."""
    key = _key(level, row, col)
    at = _place(bricks.keys, key)
    if bricks.keys[at] == _EMPTY:
        slot = bricks.used[_BRICKS]
        bricks.used[_BRICKS] += 1
        bricks.keys[at], bricks.slots[at] = key, slot
        bricks.names[slot, 0], bricks.names[slot, 1], bricks.names[slot, 2] = level, row, col
    return bricks.slots[at]


@njit(cache=True, nogil=True)
def surface(bricks, slot):
    """Where what returns from a brick is kept, made where it was not. There must be room for it."""
    if bricks.surface_of[slot] == 0:
        bricks.surface_of[slot] = bricks.used[_SURFACES]
        bricks.used[_SURFACES] += 1
    return bricks.surface_of[slot]


@njit(cache=True, nogil=True)
def enter(keys, slots, names, used):
    """Fill an empty table with the names of the first so many bricks."""
    for slot in range(1, used):
        key = _key(np.int64(names[slot, 0]), np.int64(names[slot, 1]), np.int64(names[slot, 2]))
        at = _place(keys, key)
        keys[at], slots[at] = key, slot


@njit(cache=True, nogil=True)
def within(level, row, col):
    """The number of a voxel in its brick."""
    low = SIDE - 1
    return ((level & low) << 2 * BITS) | ((row & low) << BITS) | (col & low)


@njit(cache=True, nogil=True)
def look_up(bricks, points, side):
    """(n,) brick and (n,) number within it of the voxel that each point (n, 3) lies in; metres.

    Brick 0 where there is none.
    """
    slots, numbers = np.empty(len(points), np.int32), np.empty(len(points), np.int32)
    for n in range(len(points)):
        col = math.floor(points[n, 0] / side)
        row = math.floor(points[n, 1] / side)
        level = math.floor(points[n, 2] / side)
        slots[n] = find(bricks, level >> BITS, row >> BITS, col >> BITS)
        numbers[n] = within(level, row, col)
    return slots, numbers


@njit(cache=True, nogil=True)
def state_of(odds):
    """What a voxel of such log-odds is."""
    return SOLID if odds > 0 else (FREE if odds < 0 else UNKNOWN)


@njit(cache=True, nogil=True)
def clear_ball(bricks, centre, radius, side, odds, stamp):
    """Take voxels whose middle lies in a ball for at most so likely solid, where they are not solid."""
    first, past = np.empty(3, np.int64), np.empty(3, np.int64)
    for k in range(3):
        first[k] = math.floor((centre[k] - radius) / side)
        past[k] = math.floor((centre[k] + radius) / side) + 1
    for level in range(first[2], past[2]):
        for row in range(first[1], past[1]):
            for col in range(first[0], past[0]):
                dx, dy = (col + 0.5) * side - centre[0], (row + 0.5) * side - centre[1]
                dz = (level + 0.5) * side - centre[2]
                if dx * dx + dy * dy + dz * dz <= radius * radius:
                    free(bricks, level, row, col, odds, stamp)


@njit(cache=True, nogil=True)
def free(bricks, level, row, col, odds, stamp):
    """Take a voxel for at most so likely solid, unless it is solid."""
    slot = make(bricks, level >> BITS, row >> BITS, col >> BITS)
    number = within(level, row, col)
    if odds < bricks.log_odds[slot, number] <= 0:
        bricks.log_odds[slot, number] = odds
        bricks.stamps[slot] = stamp


@njit(cache=True, nogil=True)
def states_in(bricks, first, states):
    """Write the state of every voxel of a box.

    Args:
        bricks: What is known.
        first: (3,) int64 level, row and column of the box's first voxel.
        states: (levels, rows, cols) uint8, out; 0 where nothing is known.
    """
    levels, rows, cols = states.shape
    states[:] = 0
    for level in range(first[0] >> BITS, ((first[0] + levels - 1) >> BITS) + 1):
        for row in range(first[1] >> BITS, ((first[1] + rows - 1) >> BITS) + 1):
            for col in range(first[2] >> BITS, ((first[2] + cols - 1) >> BITS) + 1):
                slot = find(bricks, level, row, col)
                if slot == 0:
                    continue
                for h in range(max(level * SIDE, first[0]), min((level + 1) * SIDE, first[0] + levels)):
                    for r in range(max(row * SIDE, first[1]), min((row + 1) * SIDE, first[1] + rows)):
                        for c in range(max(col * SIDE, first[2]), min((col + 1) * SIDE, first[2] + cols)):
                            odds = bricks.log_odds[slot, within(h, r, c)]
                            states[h - first[0], r - first[1], c - first[2]] = state_of(odds)
