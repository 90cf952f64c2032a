"""What a region encloses."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np
from numba import njit

from dream.mapping._kernels.nearness import within


@njit(cache=True, nogil=True)
def outline(mine, wide):
    """Cells near some cell, and the holes in them.

    Args:
        mine: (rows, cols) bool.
        wide: See `nearness.within`.
    """
    return filled(within(mine, wide))


@njit(cache=True, nogil=True)
def filled(mask):
    """The mask (rows, cols) with its holes: what cannot be reached from the border by 4-neighbours."""
    rows, cols = mask.shape
    inside = np.ones((rows, cols), np.bool_)
    stack = np.empty(rows * cols, np.int64)
    depth = 0
    for i in range(rows):
        for j in range(cols):
            at_border = i == 0 or j == 0 or i == rows - 1 or j == cols - 1
            if at_border and not mask[i, j]:
                inside[i, j] = False
                stack[depth] = i * cols + j
                depth += 1
    while depth > 0:
        depth -= 1
        i, j = stack[depth] // cols, stack[depth] % cols
        for a, b in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
            if 0 <= a < rows and 0 <= b < cols and inside[a, b] and not mask[a, b]:
                inside[a, b] = False
                stack[depth] = a * cols + b
                depth += 1
    return inside
