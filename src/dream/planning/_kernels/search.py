"""Breadth-first searches over the lattice: over poses, and from parts of what is left over nodes."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

NO_WAY = 255
"""Moves to where no way leads."""


@njit(cache=True, nogil=True)
def search(graph, moves, start):
    """Fewest steps to every pose of the lattice, and the pose that each is reached from.

    Args:
        graph: The lattice.
        moves: (poses, advances) uint8; may the advance along the heading be made?
        start: The pose where the vehicle is.

    Returns:
        steps: (poses,) int32, −1 where unreachable.
        parent: (poses,) int32 the pose before, −1 at the start.
        nearest: (nodes,) int32 fewest steps with any heading, −1 where no way leads.
    """
    (poses, advances), (nodes, headings) = moves.shape, (len(graph.place), graph.headings)
    turned, ahead = graph.turned, graph.ahead
    steps, parent = np.full(poses, -1, np.int32), np.full(poses, -1, np.int32)
    nearest = np.full(nodes, -1, np.int32)
    queue = np.empty(poses, np.int32)
    queue[0] = start
    steps[start] = 0
    head, tail = 0, 1
    # From which poses no advance was tried yet: a second try finds nothing. How many there are on each node.
    untried, left = np.ones(poses, np.bool_), np.full(nodes, headings, np.int64)
    while head < tail:
        here = queue[head]
        head += 1
        node = here // headings
        if left[node] == 0:
            continue
        next_steps = steps[here] + 1
        for t in range(turned.shape[1]):
            to = turned[here, t]
            if not untried[to]:
                continue
            untried[to] = False
            left[node] -= 1
            if steps[to] < 0:
                steps[to] = next_steps
                parent[to] = here
                queue[tail] = to
                tail += 1
            for a in range(advances):
                if moves[to, a]:
                    end = ahead[to, a]
                    if steps[end] < 0:
                        steps[end] = next_steps
                        parent[end] = here
                        queue[tail] = end
                        tail += 1
    for node in range(nodes):
        for pose in range(node * headings, (node + 1) * headings):
            if steps[pose] >= 0 and (nearest[node] < 0 or steps[pose] < nearest[node]):
                nearest[node] = steps[pose]
    return steps, parent, nearest


@njit(cache=True, nogil=True)
def neighbours(graph, moves):
    """Which nodes single moves lead to from each.

    Returns:
        (nodes, n) int32 nodes, and (nodes,) how many of them count.
    """
    nodes, headings, advances = len(graph.place), graph.headings, moves.shape[1]
    to, count = np.empty((nodes, headings * advances), np.int32), np.zeros(nodes, np.int64)
    for node in range(nodes):
        for pose in range(node * headings, (node + 1) * headings):
            for a in range(advances):
                if moves[pose, a]:
                    to[node, count[node]] = graph.ahead[pose, a] // headings
                    count[node] += 1
    return to, count


@njit(cache=True, nogil=True)
def ways_to(part_of, parts, spots, graph, moves, reached, near):
    """Fewest moves from each node to where most of each part is near.

    Args:
        part_of: (n,) the part of each spot.
        parts: How many there are.
        spots: (n, 2) lattice steps east and north of node 0.
        graph: The lattice.
        moves: (poses, advances) uint8, 0 where none may be made.
        reached: (nodes,) bool, those that can be reached.
        near: Lattice steps.

    Returns:
        (parts, nodes) uint8; NO_WAY where none leads there.
    """
    rows, cols = graph.grid.shape
    to, to_count = neighbours(graph, moves)
    ways = np.full((parts, rows * cols), NO_WAY, np.uint8)
    queue, count = np.empty(rows * cols, np.int32), np.zeros(rows * cols, np.int64)
    for part in range(parts):
        count[:] = 0
        for k in range(len(spots)):
            if part_of[k] != part:
                continue
            x, y = spots[k]
            for r in range(max(math.ceil(y - near), 0), min(math.floor(y + near) + 1, rows)):
                for c in range(max(math.ceil(x - near), 0), min(math.floor(x + near) + 1, cols)):
                    node = graph.grid[r, c]
                    if reached[node] and math.hypot(x - c, y - r) <= near:
                        count[node] += 1
        most, head, tail = count.max(), 0, 0
        for node in range(rows * cols):
            if most > 0 and count[node] == most:
                ways[part, node] = 0
                queue[tail] = node
                tail += 1
        while head < tail:
            node = queue[head]
            head += 1
            next_one = min(ways[part, node] + 1, NO_WAY - 1)
            # As if a way could be gone in both directions.
            for k in range(to_count[node]):
                other = to[node, k]
                if ways[part, other] == NO_WAY:
                    ways[part, other] = next_one
                    queue[tail] = other
                    tail += 1
    return ways


@njit(cache=True, nogil=True)
def ways_between(ways):
    """(parts, parts) fewest moves from where one part is near to where another is; see `ways_to`."""
    parts = len(ways)
    between = np.full((parts, parts), NO_WAY, np.int64)
    for i in range(parts):
        for node in np.flatnonzero(ways[i] == 0):
            for k in range(parts):
                between[i, k] = min(between[i, k], ways[k, node])
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
