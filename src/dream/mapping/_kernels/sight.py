"""Rays over the map."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np
from numba import njit

RAY_MASK = 1023
"""Rays in a full turn, less one: a power of two, so that wrapping is one `and`."""
SECTOR_SLACK = 1e-6
"""Cells whose centre lies on the edge of the sector belong to it, whatever the rounding."""


@njit(cache=True, nogil=True)
def any_open(blocked, first, last):
    """Does some ray of the interval still run?"""
    for ray in range(first, last + 1):  # noqa: SIM110
        if not blocked[ray & RAY_MASK]:
            return True
    return False


@njit(cache=True, nogil=True)
def all_open(blocked, first, last):
    """Do all rays of the interval still run?"""
    for ray in range(first, last + 1):  # noqa: SIM110
        if blocked[ray & RAY_MASK]:
            return False
    return True


@njit(cache=True, nogil=True)
def block(blocked, first, last):
    """End the rays of the interval; how many of them still ran?"""
    ended = 0
    for ray in range(first, last + 1):
        if not blocked[ray & RAY_MASK]:
            blocked[ray & RAY_MASK] = True
            ended += 1
    return ended


@njit(cache=True, nogil=True)
def cast_sector(
    solid,
    row,
    col,
    t_rows,
    t_cols,
    t_x,
    t_y,
    t_distance,
    t_first,
    t_last,
    forward_x,
    forward_y,
    cos_half,
    blind,
):
    """Cells with their centre in the sector that some ray reaches; a solid cell ends its rays."""
    rows, cols = solid.shape
    visible = np.zeros((rows, cols), dtype=np.bool_)
    blocked = np.zeros(RAY_MASK + 1, dtype=np.bool_)
    for k in range(len(t_rows)):
        i, j = row + t_rows[k], col + t_cols[k]
        if i < 0 or i >= rows or j < 0 or j >= cols:
            continue
        first, last = t_first[k], t_last[k]
        forward = t_x[k] * forward_x + t_y[k] * forward_y
        if (
            forward >= t_distance[k] * cos_half - SECTOR_SLACK
            and forward >= blind - SECTOR_SLACK
            and any_open(blocked, first, last)
        ):
            visible[i, j] = True
        if solid[i, j]:
            block(blocked, first, last)
    return visible


@njit(cache=True, nogil=True)
def sweep_gain(
    solid, weights, position_rows, position_cols, t_rows, t_cols, t_first, t_last, h_first, h_count, headings
):
    """Sum of the weights of the visible cells, for every position and heading, one sweep a position.

    Cell k of the table lies in the sectors of the `h_count[k]` headings from `h_first[k]` on.
    """
    rows, cols = solid.shape
    gains = np.zeros((len(position_rows), headings), dtype=np.float32)
    blocked = np.empty(RAY_MASK + 1, dtype=np.bool_)
    change = np.empty(2 * headings + 1)
    for p in range(len(position_rows)):
        blocked[:] = False
        change[:] = 0.0
        row, col = position_rows[p], position_cols[p]
        for k in range(len(t_rows)):
            i, j = row + t_rows[k], col + t_cols[k]
            if i < 0 or i >= rows or j < 0 or j >= cols:
                continue
            weight = weights[i, j]
            if weight != 0.0 and h_count[k] > 0 and any_open(blocked, t_first[k], t_last[k]):
                change[h_first[k]] += weight
                change[h_first[k] + h_count[k]] -= weight
            if solid[i, j]:
                block(blocked, t_first[k], t_last[k])
        running = 0.0
        for h in range(2 * headings):
            running += change[h]
            gains[p, h % headings] += running
    return gains
