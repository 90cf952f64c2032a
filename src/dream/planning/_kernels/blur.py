"""A blur that is worked out only where it is asked for."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def blur(cells, weights, where):
    """(rows, cols) float32 weighted share of the cells around; 0 where nobody asks.

    First along the columns, where the second pass reads it, then along the rows. Beyond the edge the cells
    are as on it.

    Args:
        cells: (rows, cols) float32.
        weights: (n + 1,) of what is so many cells away, to either side.
        where: (rows, cols) bool.
    """
    rows, cols = cells.shape
    far = len(weights) - 1
    along, blurred = np.zeros((2, rows, cols), np.float32)
    for i in range(rows):
        done = -1
        for j in range(cols):
            if not where[i, j]:
                continue
            for k in range(max(j - far, done + 1), min(j + far + 1, cols)):
                total = cells[i, k] * weights[0]
                for n in range(far, 0, -1):
                    total += (1.0 * cells[max(i - n, 0), k] + cells[min(i + n, rows - 1), k]) * weights[n]
                along[i, k] = total
                done = k
    for i in range(rows):
        for j in range(cols):
            if where[i, j]:
                total = along[i, j] * weights[0]
                for n in range(far, 0, -1):
                    total += (np.float64(along[i, max(j - n, 0)]) + along[i, min(j + n, cols - 1)]) * weights[
                        n
                    ]
                blurred[i, j] = total
    return blurred
