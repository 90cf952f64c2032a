"""Search for a short walk that traverses everything that is left."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dream.planning._kernels.lookahead import FREE, is_in

NO_WAY = 255
"""Moves to where no way leads."""


@njit(cache=True, nogil=True)
def gain(weights, done, first, offset, base, heading):
    """Weight of the cells that a pose traverses, without those done before."""
    total = 0.0
    for k in range(first[heading], first[heading + 1]):
        cell = base + offset[k]
        if weights[cell] > 0.0 and not is_in(done, cell):
            total += weights[cell]
    return total


@njit(cache=True, nogil=True)
def cross(weights, done, first, offset, base, heading):
    """Set the bits of the cells of any weight that a pose traverses."""
    for k in range(first[heading], first[heading + 1]):
        cell = base + offset[k]
        if weights[cell] > 0.0:
            done[cell >> 6] |= np.uint64(1) << np.uint64(cell & 63)


@njit(cache=True, nogil=True)
def ways_to(part_of, parts, cells, moves, offsets, reached, near, grid):
    """Fewest moves from each node to where most of each part is near.

    Args:
        part_of: (n,) the part of each cell.
        parts: How many there are.
        cells: (n, 2) rows and columns.
        moves: (rows, cols, headings, advances) uint8, FREE, UNKNOWN or 0; see `lookahead.possible_moves`.
        offsets: (headings, advances, 2) lattice steps (east, north).
        reached: (rows, cols) bool, the nodes that can be reached.
        near: Cells.
        grid: Row and column of node (0, 0), and cells between nodes.

    Returns:
        (parts, rows, cols) uint8; NO_WAY where none leads there.
    """
    rows, cols, headings, advances = moves.shape
    y0, x0, scale = grid
    ways = np.full((parts, rows, cols), NO_WAY, np.uint8)
    queue = np.empty(rows * cols, np.int32)
    count = np.zeros((rows, cols), np.int64)
    for part in range(parts):
        count[:] = 0
        for k in range(len(cells)):
            if part_of[k] != part:
                continue
            y, x = (cells[k, 0] + 0.5 - y0) / scale, (cells[k, 1] + 0.5 - x0) / scale
            span = near / scale
            for r in range(max(math.ceil(y - span), 0), min(math.floor(y + span) + 1, rows)):
                for c in range(max(math.ceil(x - span), 0), min(math.floor(x + span) + 1, cols)):
                    if reached[r, c] and math.hypot(x - c, y - r) <= span:
                        count[r, c] += 1
        most, head, tail = count.max(), 0, 0
        for r in range(rows):
            for c in range(cols):
                if most > 0 and count[r, c] == most:
                    ways[part, r, c] = 0
                    queue[tail] = r * cols + c
                    tail += 1
        while head < tail:
            r, c = divmod(queue[head], cols)
            head += 1
            next_one = min(ways[part, r, c] + 1, NO_WAY - 1)
            # As if a way could be gone in both directions.
            for h in range(headings):
                for a in range(advances):
                    if moves[r, c, h, a]:
                        r_to, c_to = r + offsets[h, a, 1], c + offsets[h, a, 0]
                        if ways[part, r_to, c_to] == NO_WAY:
                            ways[part, r_to, c_to] = next_one
                            queue[tail] = r_to * cols + c_to
                            tail += 1
    return ways


@njit(cache=True, nogil=True)
def ways_between(ways):
    """(parts, parts) fewest moves from where one part is near to where another is; see `ways_to`."""
    parts, rows, cols = ways.shape
    between = np.full((parts, parts), NO_WAY, np.int64)
    for i in range(parts):
        for r in range(rows):
            for c in range(cols):
                if ways[i, r, c] == 0:
                    for k in range(parts):
                        between[i, k] = min(between[i, k], ways[k, r, c])
    return between


@njit(cache=True, nogil=True)
def tree(between, which, n):
    """Moves along the shortest tree over some parts, the first n of `which` (Prim)."""
    total = 0
    away = np.empty(n, np.int64)
    for i in range(1, n):
        away[i] = between[which[0], which[i]]
    for _ in range(1, n):
        best = -1
        for i in range(1, n):
            if away[i] >= 0 and (best < 0 or away[i] < away[best]):
                best = i
        total += away[best]
        away[best] = -1
        for i in range(1, n):
            away[i] = min(away[i], between[which[best], which[i]])
    return total


@njit(cache=True, nogil=True)
def walk(
    weights,
    first,
    offset,
    stride,
    grid,
    moves,
    offsets,
    turns,
    start,
    index,
    part_of,
    ways,
    width,
    horizon,
    far,
):
    """A short walk that traverses all cells of any weight, or most of them.

    Level by level those sequences of actions are kept that leave least: in weight, and in moves to the
    nearest part that is left and along the shortest tree over these parts.

    Args:
        weights: (all,) float64 by cell; what is around the map has none.
        first: (headings + 1,) where the list of each heading begins.
        offset: (m,) cells that a pose traverses, from that of its node.
        stride: Cells in a row.
        grid: See `ways_to`; of the cells that `weights` is of.
        moves: See `ways_to`. The first one is free for sure.
        offsets: See `ways_to`.
        turns: (turns,) in heading steps.
        start: Row, column and heading.
        index: (n,) the cells of any weight.
        part_of: See `ways_to`.
        ways: See `ways_to`.
        width: Sequences kept at each level; they differ in their pose, positions taken to pairs of nodes.
        horizon: Levels at most.
        far: Weight that a move counts as much as.

    Returns:
        (steps + 1,) flat (row, col, heading) of the walk's poses, the start first; and the weight it leaves.
    """
    rows, cols, headings, advances = moves.shape
    parts = len(ways)
    between = ways_between(ways)
    most, branches = 1 + width * horizon, len(turns) * (advances + 1)
    pose, parent = np.zeros(most, np.int32), np.full(most, -1, np.int32)
    left = np.zeros(most)
    done = np.zeros((most, (len(weights) + 63) // 64), np.uint64)
    pose[0] = (start[0] * cols + start[1]) * headings + start[2]
    for cell in index:
        left[0] += weights[cell]
    next_left, value = np.empty((2, width * branches))
    next_parent, next_pose = np.empty((2, width * branches), np.int32)
    taken = np.zeros(rows * cols * headings, np.int32)
    open_parts, is_open = np.zeros(parts, np.int64), np.zeros(parts, np.bool_)
    begin, past, best = 0, 1, 0
    for level in range(1, horizon + 1):
        n = 0
        for node in range(begin, past):
            h = pose[node] % headings
            c = pose[node] // headings % cols
            r = pose[node] // (headings * cols)
            is_open[:] = False
            for k in range(len(index)):
                if not is_in(done[node], index[k]):
                    is_open[part_of[k]] = True
            count = 0
            for part in range(parts):
                if is_open[part]:
                    open_parts[count] = part
                    count += 1
            along = tree(between, open_parts, count)
            for turn in turns:
                to = (h + turn) % headings
                for a in range(-1, advances):
                    r_to, c_to = r, c
                    if a >= 0:
                        kind = moves[r, c, to, a]
                        if kind == 0 or (kind != FREE and level == 1):
                            continue
                        r_to, c_to = r + offsets[to, a, 1], c + offsets[to, a, 0]
                    elif turn == 0:
                        continue
                    away = NO_WAY
                    for i in range(count):
                        away = min(away, ways[open_parts[i], r_to, c_to])
                    base = (grid[0] + r_to * grid[2]) * stride + grid[1] + c_to * grid[2]
                    next_left[n] = left[node] - gain(weights, done[node], first, offset, base, to)
                    value[n] = next_left[n] + far * (away + along)
                    next_parent[n] = node
                    next_pose[n] = (r_to * cols + c_to) * headings + to
                    n += 1
        begin = past
        # Rounded, so that a tie is a tie on every machine.
        for k in np.argsort(np.round(value[:n], 6), kind="mergesort"):
            h = next_pose[k] % headings
            c = next_pose[k] // headings % cols
            r = next_pose[k] // (headings * cols)
            place = (r // 2 * cols + c // 2) * headings + h
            if taken[place] == level:
                continue
            taken[place] = level
            pose[past], parent[past], left[past] = next_pose[k], next_parent[k], next_left[k]
            done[past] = done[next_parent[k]]
            base = (grid[0] + r * grid[2]) * stride + grid[1] + c * grid[2]
            cross(weights, done[past], first, offset, base, h)
            if left[past] < left[best] - 1e-6:
                best = past
            past += 1
            if past - begin == width:
                break
        if left[best] < 1e-6 or past == begin:
            break
    return traced(pose, parent, best), left[best]


@njit(cache=True, nogil=True)
def traced(pose, parent, end):
    """(steps + 1,) int32 flat poses that lead to a node of a search, the start first."""
    steps, at = 0, end
    while parent[at] >= 0:
        at = parent[at]
        steps += 1
    path, at = np.zeros(steps + 1, np.int32), end
    for k in range(steps, -1, -1):
        path[k] = pose[at]
        at = parent[at]
    return path


@njit(cache=True, nogil=True)
def leaves(weights, first, offset, stride, grid, path, shape, index):
    """Weight that a walk (steps + 1,) of flat poses leaves, its start not counted."""
    _, cols, headings = shape
    done = np.zeros((len(weights) + 63) // 64, np.uint64)
    for flat in path[1:]:
        r, c, h = flat // (headings * cols), flat // headings % cols, flat % headings
        base = (grid[0] + r * grid[2]) * stride + grid[1] + c * grid[2]
        cross(weights, done, first, offset, base, h)
    rest = 0.0
    for cell in index:
        if not is_in(done, cell):
            rest += weights[cell]
    return rest
