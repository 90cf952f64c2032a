"""Which moves over the lattice may be made."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

FREE, UNKNOWN = 1, 2
"""A move over ground known to be free, and one against which nothing is known."""


@njit(cache=True, nogil=True)
def possible_moves(room, needed, plenty, x0, y0, scale, graph, known, moves):
    """Write FREE for moves that are known to be, UNKNOWN for those that nothing solid is known to block.

    Args:
        room: (R, C) float32 metres between a cell and the nearest solid one or the bounds.
        needed: Metres of it.
        plenty: Metres of it at the start of any move that leave as many as needed all along.
        x0: See `views.sight_lines`.
        y0: See `views.sight_lines`.
        scale: See `views.sight_lines`.
        graph: The lattice.
        known: (poses, advances) uint8, 1 where free.
        moves: Of the same shape, to write.
    """
    height, width = room.shape
    nodes, headings, ahead = len(graph.place), graph.headings, graph.ahead
    good, at_ease = np.zeros(nodes, np.bool_), np.zeros(nodes, np.bool_)
    for node in range(nodes):
        c, r = graph.place[node]
        i, j = math.floor(y0 + r * scale), math.floor(x0 + c * scale)
        if 0 <= i < height and 0 <= j < width:
            good[node] = room[i, j] >= needed
            at_ease[node] = room[i, j] >= plenty
    for node in range(nodes):
        c, r = graph.place[node]
        for pose in range(node * headings, (node + 1) * headings):
            for a in range(known.shape[1]):
                moves[pose, a] = FREE if known[pose, a] else 0
                end = ahead[pose, a]
                if known[pose, a] or end < 0 or not good[node]:
                    continue
                if at_ease[node]:
                    moves[pose, a] = UNKNOWN
                    continue
                if not good[end // headings]:
                    continue
                c_to, r_to = graph.place[end // headings]
                clear = True
                for s in range(1, 4):
                    i = math.floor(y0 + (r + 0.25 * s * (r_to - r)) * scale)
                    j = math.floor(x0 + (c + 0.25 * s * (c_to - c)) * scale)
                    clear = clear and room[i, j] >= needed
                if clear:
                    moves[pose, a] = UNKNOWN


@njit(cache=True, nogil=True)
def keep_to(moves, graph, good, start):
    """Close the advances that begin or end where it is not good; from the start any may begin.

    Args:
        moves: (poses, advances) uint8; written.
        graph: The lattice.
        good: (nodes,) bool.
        start: The node where the vehicle is.
    """
    headings = graph.headings
    for node in range(len(good)):
        leaves = good[node] or node == start
        for pose in range(node * headings, (node + 1) * headings):
            for a in range(moves.shape[1]):
                end = graph.ahead[pose, a]
                if not (leaves and end >= 0 and good[end // headings]):
                    moves[pose, a] = 0
