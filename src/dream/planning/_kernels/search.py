"""Breadth-first search over the poses of the lattice."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np
from numba import njit

from dream.planning.travel import UNREACHED


@njit(cache=True, nogil=True)
def keep_to(edges, offsets, good, row, col):
    """Close the advances that begin or end where it is not good; from (row, col) any may begin.

    Args:
        edges: See `search`; written.
        offsets: See `search`.
        good: (rows, cols) bool.
        row: Where the vehicle is.
        col: Likewise.
    """
    rows, cols, headings, advances = edges.shape
    for r in range(rows):
        for c in range(cols):
            leaves = good[r, c] or (r == row and c == col)
            for h in range(headings):
                for a in range(advances):
                    r_to, c_to = r + offsets[h, a, 1], c + offsets[h, a, 0]
                    inside = 0 <= r_to < rows and 0 <= c_to < cols
                    if not (leaves and inside and good[r_to, c_to]):
                        edges[r, c, h, a] = 0


@njit(cache=True, nogil=True)
def search(edges, offsets, turns, row, col, heading):
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
        nearest: (rows, cols) int32 fewest steps with any heading, `UNREACHED` where no way leads.
    """
    rows, cols, headings, advances = edges.shape
    steps = np.full((rows, cols, headings), -1, np.int32)
    parent = np.full((rows, cols, headings), -1, np.int32)
    nearest = np.full((rows, cols), UNREACHED, np.int32)
    queue = np.empty(rows * cols * headings, np.int32)
    queue[0] = (row * cols + col) * headings + heading
    steps[row, col, heading] = nearest[row, col] = 0
    head, tail = 0, 1
    # Of each position the headings in which an advance was not tried yet: a second try finds nothing.
    untried = np.ones((rows, cols, headings), np.bool_)
    left = np.full((rows, cols), headings, np.int64)
    while head < tail:
        here = queue[head]
        head += 1
        h = here % headings
        c = (here // headings) % cols
        r = here // (headings * cols)
        if left[r, c] == 0:
            continue
        next_steps = steps[r, c, h] + 1
        for turn in turns:
            to = (h + turn) % headings
            if not untried[r, c, to]:
                continue
            untried[r, c, to] = False
            left[r, c] -= 1
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
                        nearest[r_to, c_to] = min(nearest[r_to, c_to], next_steps)
    return steps, parent, nearest
