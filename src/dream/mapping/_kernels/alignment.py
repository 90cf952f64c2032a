"""How well a frame's points fit a map, for many offsets."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def mismatch(points, said, known, weighted, center, offsets):
    """Mean squared difference between what points say and what a map says where they fall, for each offset.

    A map's value between the centres of cells is bilinear among those that are known, and counts by the share
    of them. What falls outside the map, or where nothing is known, does not count.

    Args:
        points: (n, 2) float64, x and y from the vehicle; lengths in cells.
        said: (n, channels) float64.
        known: (channels, rows, cols) float64, 1 where the map knows a cell, 0 elsewhere.
        weighted: (channels, rows, cols) float64, what it says of it times `known`.
        center: (x, y) of the vehicle in the map: cell (row, col) covers x from col to col + 1.
        offsets: (m, 3) float64 in cells and radians: the points are turned about the vehicle, then shifted.

    Returns:
        (m,) the mean, and (m,) the weight that counted, in points of one channel; 0 and 0 where none did.
    """
    channels, rows, cols = known.shape
    means, weights = np.zeros(len(offsets)), np.zeros(len(offsets))
    for k in range(len(offsets)):
        c, s = math.cos(offsets[k, 2]), math.sin(offsets[k, 2])
        left, low = center[0] + offsets[k, 0] - 0.5, center[1] + offsets[k, 1] - 0.5
        total, weight = 0.0, 0.0
        for i in range(len(points)):
            x = left + c * points[i, 0] - s * points[i, 1]
            y = low + s * points[i, 0] + c * points[i, 1]
            col, row = math.floor(x), math.floor(y)
            if col < 0 or row < 0 or col + 1 >= cols or row + 1 >= rows:
                continue
            fx, fy = x - col, y - row
            a, b = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy)
            d, e = (1.0 - fx) * fy, fx * fy
            for channel in range(channels):
                w, v = known[channel], weighted[channel]
                share = a * w[row, col] + b * w[row, col + 1] + d * w[row + 1, col] + e * w[row + 1, col + 1]
                if share <= 0.0:
                    continue
                value = a * v[row, col] + b * v[row, col + 1] + d * v[row + 1, col] + e * v[row + 1, col + 1]
                off = said[i, channel] - value / share
                total += share * off * off
                weight += share
        if weight > 0.0:
            means[k], weights[k] = total / weight, weight
    return means, weights
