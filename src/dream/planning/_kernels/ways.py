"""Breadth-first search over the poses of a lattice in three dimensions."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

FINE = 2
"""Points at which the body is known to fit or not, along a step of the lattice."""


class SpaceMoves(NamedTuple):
    """What a step may be, in steps of the lattice."""

    turns: npt.NDArray[np.int64]
    """(T,) headings to the left."""
    offsets: npt.NDArray[np.int64]
    """(headings, A, 2) east and north of each advance, the first of which is none."""
    climbs: npt.NDArray[np.int64]
    """(C,) upwards, 0 among them."""


@njit(cache=True, nogil=True)
def passes(fits, level, row, col, up, north, east):
    """Does the body fit all along a straight move? All in fine points; between two, both count."""
    steps = max(abs(up), abs(north), abs(east))
    for k in range(1, steps + 1):
        h, r, c = level + up * k / steps, row + north * k / steps, col + east * k / steps
        for i in range(math.floor(h + 1e-9), math.ceil(h - 1e-9) + 1):
            for j in range(math.floor(r + 1e-9), math.ceil(r - 1e-9) + 1):
                for m in range(math.floor(c + 1e-9), math.ceil(c - 1e-9) + 1):
                    if not fits[i, j, m]:
                        return False
    return True


@njit(cache=True, nogil=True)
def search(fits, stands, moves, start, heading, goal, facing):
    """Fewest steps to every pose, until one stands on a goal.

    Args:
        fits: (levels, rows, cols) uint8 at fine points: does the body fit?
        stands: (levels, rows, cols) uint8 at nodes, of which each `FINE`-th fine point is one: may it stay?
        moves: Of a step.
        start: (3,) int64 level, row and column of the node where the vehicle is.
        heading: Where it looks.
        goal: (levels, rows, cols) bool at nodes; where none is set all is searched.
        facing: (headings,) bool of those with which a goal counts as reached.

    Returns:
        steps: (levels, rows, cols, headings) int32; −1 where no way was found.
        parent: (poses,) int32 the pose before, −1 at the start and where none leads; a pose is
            node · headings + heading, nodes in the order of the grid.
        found: The first pose on a goal, −1 where none is reached.
    """
    levels, rows, cols = stands.shape
    headings = len(moves.offsets)
    poses = levels * rows * cols * headings
    parent = np.full(poses, -1, np.int32)
    untried = np.ones(poses, np.bool_)
    steps = np.full(poses, -1, np.int32)
    queue = np.empty(poses, np.int32)
    first = ((start[0] * rows + start[1]) * cols + start[2]) * headings + heading
    queue[0], steps[first] = first, 0
    head, tail = 0, 1
    wanted = goal.ravel()
    while head < tail:
        here = queue[head]
        deep = steps[here] + 1
        head += 1
        node = here // headings
        if wanted[node] and facing[here % headings]:
            return steps.reshape(levels, rows, cols, headings), parent, here
        level, row, col = node // (rows * cols), node // cols % rows, node % cols
        for turn in moves.turns:
            to = (here % headings + turn + headings) % headings
            turned = node * headings + to
            if not untried[turned]:
                continue
            untried[turned] = False
            if steps[turned] < 0:
                steps[turned], parent[turned] = deep, here
                queue[tail] = turned
                tail += 1
            for a in range(moves.offsets.shape[1]):
                east, north = moves.offsets[to, a]
                for up in moves.climbs:
                    if up == 0 and east == 0 and north == 0:
                        continue
                    h, r, c = level + up, row + north, col + east
                    if not (0 <= h < levels and 0 <= r < rows and 0 <= c < cols):
                        continue
                    end = ((h * rows + r) * cols + c) * headings + to
                    if steps[end] >= 0 or not stands[h, r, c]:
                        continue
                    if not passes(
                        fits, FINE * level, FINE * row, FINE * col, FINE * up, FINE * north, FINE * east
                    ):
                        continue
                    steps[end], parent[end] = deep, here
                    queue[tail] = end
                    tail += 1
    return steps.reshape(levels, rows, cols, headings), parent, -1
