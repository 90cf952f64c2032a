"""What lies near some cells."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def within(cells, wide):
    """Cells near some cell, in time that does not grow with the distance.

    Args:
        cells: (rows, cols) bool.
        wide: (n,) columns that are near, so many rows away; n rows away none is.
    """
    rows, cols = cells.shape
    far = len(wide)
    # Rows to the nearest cell of the same column: from above, then from below.
    away = np.empty((rows, cols), np.int32)
    for i in range(rows):
        for j in range(cols):
            above = away[i - 1, j] if i > 0 else far
            away[i, j] = 0 if cells[i, j] else min(above + 1, far)
    for i in range(rows - 2, -1, -1):
        for j in range(cols):
            away[i, j] = min(away[i, j], away[i + 1, j] + 1)
    near = np.zeros((rows, cols), np.bool_)
    for i in range(rows):
        # As far right, then as far left, as what was passed is near.
        reached = -1
        for j in range(cols):
            if away[i, j] < far:
                reached = max(reached, j + wide[away[i, j]])
            near[i, j] = j <= reached
        reached = cols
        for j in range(cols - 1, -1, -1):
            if away[i, j] < far:
                reached = min(reached, j - wide[away[i, j]])
            if j >= reached:
                near[i, j] = True
    return near


@njit(cache=True, nogil=True)
def linked(mask, squared_link):
    """Components of the cells whose centres lie within a distance (squared, in cells), in raster order.

    Returns:
        (rows, cols) int32 numbers from 1, 0 where the mask is not; how many.
    """
    rows, cols = mask.shape
    labels = np.zeros((rows, cols), dtype=np.int32)
    stack = np.empty(rows * cols, dtype=np.int32)
    reach = math.floor(math.sqrt(squared_link) + 1e-9)
    count = 0
    for i in range(rows):
        for j in range(cols):
            if not mask[i, j] or labels[i, j] != 0:
                continue
            count += 1
            labels[i, j] = count
            stack[0] = i * cols + j
            depth = 1
            while depth > 0:
                depth -= 1
                y, x = stack[depth] // cols, stack[depth] % cols
                for di in range(-reach, reach + 1):
                    for dj in range(-reach, reach + 1):
                        if di * di + dj * dj > squared_link + 1e-9:
                            continue
                        a, b = y + di, x + dj
                        if 0 <= a < rows and 0 <= b < cols and mask[a, b] and labels[a, b] == 0:
                            labels[a, b] = count
                            stack[depth] = a * cols + b
                            depth += 1
    return labels, count
