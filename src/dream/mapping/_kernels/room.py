"""Where the vehicle may be."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def clearance(barrier, radius):
    """Squared distance, in half cells, from each cell's centre to the nearest barrier cell.

    Measured to the barrier's square, not to its centre. More than `radius` cells away: a large number.
    """
    rows, cols = barrier.shape
    squared = np.full((rows, cols), 4 * (radius + 1) * (radius + 1), dtype=np.int32)
    for i in range(rows):
        for j in range(cols):
            if not barrier[i, j]:
                continue
            squared[i, j] = 0
            # What is not on the edge is nobody's nearest.
            edge = (
                (i > 0 and not barrier[i - 1, j])
                or (j > 0 and not barrier[i, j - 1])
                or (i < rows - 1 and not barrier[i + 1, j])
                or (j < cols - 1 and not barrier[i, j + 1])
            )
            if not edge:
                continue
            for y in range(max(i - radius, 0), min(i + radius + 1, rows)):
                high = max(2 * abs(y - i) - 1, 0)
                for x in range(max(j - radius, 0), min(j + radius + 1, cols)):
                    wide = max(2 * abs(x - j) - 1, 0)
                    squared[y, x] = min(squared[y, x], high * high + wide * wide)
    return squared


@njit(cache=True, nogil=True)
def segment_is_free(squared, needed, x0, y0, x1, y1, row=0, col=0):
    """Is every sample of a segment (in cells) far enough from the barrier?

    From a start that is too near itself, the room must never shrink on the way, and the end must have more of
    it: a way out, never one along. The first cell of `squared` is (row, col).
    """
    rows, cols = squared.shape
    i, j = math.floor(y0) - row, math.floor(x0) - col
    if i < 0 or j < 0 or i >= rows or j >= cols or squared[i, j] == 0:
        return False
    start = squared[i, j]
    least = min(start, needed + 1)
    samples = max(1, math.ceil(2.0 * math.hypot(x1 - x0, y1 - y0) - 1e-9))
    for k in range(1, samples + 1):
        along = k / samples
        i = math.floor(y0 + along * (y1 - y0)) - row
        j = math.floor(x0 + along * (x1 - x0)) - col
        if i < 0 or j < 0 or i >= rows or j >= cols or squared[i, j] < least:
            return False
        least = max(least, min(squared[i, j], needed + 1))
    return least > needed or squared[i, j] > start


@njit(cache=True, nogil=True)
def segments_are_free(squared, needed, starts, ends, row, col):
    """`segment_is_free` for (n, 2) starts and ends, in cells."""
    free = np.empty(len(starts), dtype=np.bool_)
    for k in range(len(starts)):
        free[k] = segment_is_free(
            squared, needed, starts[k, 0], starts[k, 1], ends[k, 0], ends[k, 1], row, col
        )
    return free
