"""Compiled loops over the pixels of a frame."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def steadied(depth, labels, half, apart):
    """Depths of which the inverse is a mean over the pixels around that show the same surface.

    Args:
        depth: (H, W) float32 metres along the optical axis.
        labels: (H, W) uint8. A pixel of another label is of another surface.
        half: The mean is over (2 half + 1)² pixels.
        apart: Per metre: by how much inverse depths of one surface may differ.

    Returns:
        (H, W) float32, NaN where nothing returns; and (H, W) int32, how many pixels each is the mean of.
    """
    high, wide = depth.shape
    found = np.full((high, wide), np.nan, np.float32)
    counts = np.zeros((high, wide), np.int32)
    for v in range(high):
        for u in range(wide):
            if not 0.0 < depth[v, u] < np.inf:
                continue
            inverse, total, count = 1.0 / depth[v, u], 0.0, 0
            for i in range(max(0, v - half), min(high, v + half + 1)):
                for j in range(max(0, u - half), min(wide, u + half + 1)):
                    if labels[i, j] != labels[v, u] or not 0.0 < depth[i, j] < np.inf:
                        continue
                    if abs(1.0 / depth[i, j] - inverse) <= apart:
                        total += 1.0 / depth[i, j]
                        count += 1
            found[v, u], counts[v, u] = count / total, count
    return found, counts
