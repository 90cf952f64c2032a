"""Edges and clusters."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def frontier_labels(known, free):
    """Clusters of the frontier, 1 and up in raster order, 8-connected; 0 elsewhere.

    A frontier cell is free and has an unknown 4-neighbour inside the grid.
    """
    rows, cols = known.shape
    frontier = np.zeros((rows, cols), dtype=np.bool_)
    for i in range(rows):
        for j in range(cols):
            if free[i, j]:
                frontier[i, j] = (
                    (i > 0 and not known[i - 1, j])
                    or (j > 0 and not known[i, j - 1])
                    or (i < rows - 1 and not known[i + 1, j])
                    or (j < cols - 1 and not known[i, j + 1])
                )
    return label_within(frontier, 2.0)


@njit(cache=True, nogil=True)
def label_within(mask, squared_link):
    """Components of the cells whose centres lie within a distance (squared, in cells), in raster order."""
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
