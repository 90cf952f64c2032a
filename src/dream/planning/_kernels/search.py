"""Breadth-first search over the poses of the lattice."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def search(edges, offsets, turns, row, col, heading):  # type: ignore[no-untyped-def]
    """Fewest steps to every pose of the lattice, and the pose that each is reached from.

    Args:
        edges: (rows, cols, headings, advances) uint8; is the advance along the heading free?
        offsets: (headings, advances, 2) int64 lattice steps (east, north).
        turns: (turns,) int64 in heading steps, 0 among them.
        row: Where the vehicle is.
        col: Likewise.
        heading: Likewise.

    Returns:
        steps: (rows, cols, headings) int32, −1 where unreachable.
        parent: (rows, cols, headings) int32 flat index of the pose before, −1 at the start.
    """
    rows, cols, headings, advances = edges.shape
    steps = np.full((rows, cols, headings), -1, np.int32)
    parent = np.full((rows, cols, headings), -1, np.int32)
    queue = np.empty(rows * cols * headings, np.int32)
    queue[0] = (row * cols + col) * headings + heading
    steps[row, col, heading] = 0
    head, tail = 0, 1
    while head < tail:
        here = queue[head]
        head += 1
        h = here % headings
        c = (here // headings) % cols
        r = here // (headings * cols)
        next_steps = steps[r, c, h] + 1
        for turn in turns:
            to = (h + turn) % headings
            if steps[r, c, to] < 0:
                steps[r, c, to] = next_steps
                parent[r, c, to] = here
                queue[tail] = (r * cols + c) * headings + to
                tail += 1
            for a in range(advances):
                if edges[r, c, to, a]:
                    r_to = r + offsets[to, a, 1]
                    c_to = c + offsets[to, a, 0]
                    if steps[r_to, c_to, to] < 0:
                        steps[r_to, c_to, to] = next_steps
                        parent[r_to, c_to, to] = here
                        queue[tail] = (r_to * cols + c_to) * headings + to
                        tail += 1
    return steps, parent
