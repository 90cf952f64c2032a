"""From a mask of cells to polygons along their edges."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dream.geometry import Bounds
from dream.survey.patches import grouped

Float64Array = npt.NDArray[np.float64]


def outlines(mask: npt.NDArray[np.bool_]) -> list[list[Float64Array]]:
    """Polygons around the cells of a mask, in columns and rows; cells that touch at a corner are apart.

    Each is its outline, counter-clockwise, and its holes, clockwise. The walk keeps the cell on its left, and
    where two cells meet at a corner it turns left, around its own.
    """
    padded = np.pad(mask, 1)
    # Unit edges by direction, the cell on their left: east under a cell, north on its right side, and so on.
    starts = {
        (1, 0): np.argwhere(mask & ~padded[:-2, 1:-1]),
        (0, 1): np.argwhere(mask & ~padded[1:-1, 2:]) + np.array((0, 1)),
        (-1, 0): np.argwhere(mask & ~padded[2:, 1:-1]) + np.array((1, 1)),
        (0, -1): np.argwhere(mask & ~padded[1:-1, :-2]) + np.array((1, 0)),
    }
    leaving: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for step, corners in starts.items():
        for row, col in corners.tolist():
            leaving.setdefault((col, row), []).append(step)
    rings: list[Float64Array] = []
    # The lowest corner that is left is one where the ring turns, so that no corner is told that is none.
    for start in sorted(leaving, key=lambda corner: corner[::-1]):
        if start not in leaving:
            continue
        ring, at, step = [start], start, leaving[start][0]
        index = {start: 0}
        while True:
            steps = leaving[at]
            steps.remove(step)
            if not steps:
                del leaving[at]
            at = (at[0] + step[0], at[1] + step[1])
            if at == start:
                break
            left = (-step[1], step[0])
            onward = leaving[at]
            turn = left if left in onward else (step if step in onward else (step[1], -step[0]))
            if turn != step:
                if at in index:
                    # A hole that touches its outline, or another hole, in a corner is a ring of its own.
                    first = index[at]
                    rings.append(np.array([*ring[first:], at], np.float64))
                    for corner in ring[first:]:
                        del index[corner]
                    del ring[first:]
                index[at] = len(ring)
                ring.append(at)
            step = turn
        rings.append(np.array([*ring, ring[0]], np.float64))
    return grouped(rings)


def ring_around(box: Bounds) -> Float64Array:
    """(5, 2) the corners of a box, counter-clockwise and closed."""
    east, north = box.x_max, box.y_max
    west, south = box.x_min, box.y_min
    return np.array([(west, south), (east, south), (east, north), (west, north), (west, south)])
