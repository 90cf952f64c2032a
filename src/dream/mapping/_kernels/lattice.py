"""Free moves over the lattice, and where they lead.

A grid is metres between nodes, metres of a cell, and world y and x of the corner of the store's cell (0, 0).
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dream.mapping._kernels.flags import EDGE
from dream.mapping._kernels.room import segment_is_free


@njit(cache=True, nogil=True)
def place(i, j, grid):
    """How far north and east a node lies, in cells: as `Layers` measures where a position lies."""
    lattice, cell, south, west = grid
    return (i * lattice - south) / cell + EDGE, (j * lattice - west) / cell + EDGE


@njit(cache=True, nogil=True)
def free_moves(room, low, needed, grid, nodes, moves):
    """Which moves are free from each node of a rectangle at which the vehicle can stand.

    Args:
        room: (rows, cols) of cells; from the cell `low` on.
        low: See `room`.
        needed: Room that a standable cell exceeds.
        grid: See above.
        nodes: First and past, rows and columns.
        moves: (n, 2) lattice steps east and north.

    Returns:
        (rows, cols, n) uint8.
    """
    rows, cols = room.shape
    free = np.zeros((nodes[2] - nodes[0], nodes[3] - nodes[1], len(moves)), np.uint8)
    # Cells below and to the left of each corner at which the vehicle cannot stand.
    closed = np.zeros((rows + 1, cols + 1), np.int32)
    for i in range(rows):
        for j in range(cols):
            closed[i + 1, j + 1] = closed[i, j + 1] + closed[i + 1, j] - closed[i, j] + (room[i, j] <= needed)
    for i in range(nodes[0], nodes[2]):
        for j in range(nodes[1], nodes[3]):
            y, x = place(i, j, grid)
            row, col = math.floor(y) - low[0], math.floor(x) - low[1]
            if not (0 <= row < rows and 0 <= col < cols) or room[row, col] <= needed:
                continue
            for k in range(len(moves)):
                to_y, to_x = place(i + moves[k, 1], j + moves[k, 0], grid)
                to_row, to_col = math.floor(to_y) - low[0], math.floor(to_x) - low[1]
                if not (0 <= to_row < rows and 0 <= to_col < cols) or room[to_row, to_col] <= needed:
                    continue
                south, north = min(row, to_row), max(row, to_row) + 1
                west, east = min(col, to_col), max(col, to_col) + 1
                shut = closed[north, east] - closed[south, east] - closed[north, west] + closed[south, west]
                # Where all of the box around it is open, the move is free.
                free[i - nodes[0], j - nodes[1], k] = shut == 0 or segment_is_free(
                    room, needed, x, y, to_x, to_y, low[0], low[1]
                )
    return free


@njit(cache=True, nogil=True)
def reach(free, room, low, needed, grid, first, start, moves):
    """The nodes to which moves lead from one of them; from where the vehicle cannot stand, only ways out.

    Args:
        free: See `free_moves`.
        room, low, needed, grid, moves: Likewise.
        first: The first node of `free`.
        start: The node.

    Returns:
        (rows, cols) bool, `start` among them.
    """
    rows, cols = free.shape[:2]
    reached = np.zeros((rows, cols), np.bool_)
    reached[start[0] - first[0], start[1] - first[1]] = True
    stack = np.empty((rows * cols, 2), np.int64)
    stack[0, 0], stack[0, 1] = start[0] - first[0], start[1] - first[1]
    depth = 1
    while depth > 0:
        depth -= 1
        i, j = stack[depth, 0], stack[depth, 1]
        y, x = place(i + first[0], j + first[1], grid)
        row, col = math.floor(y) - low[0], math.floor(x) - low[1]
        inside = 0 <= row < room.shape[0] and 0 <= col < room.shape[1]
        stands = inside and room[row, col] > needed
        for k in range(len(moves)):
            a, b = i + moves[k, 1], j + moves[k, 0]
            if a < 0 or b < 0 or a >= rows or b >= cols or reached[a, b]:
                continue
            if stands:
                leads = free[i, j, k] != 0
            else:
                to_y, to_x = place(a + first[0], b + first[1], grid)
                leads = segment_is_free(room, needed, x, y, to_x, to_y, low[0], low[1])
            if leads:
                reached[a, b] = True
                stack[depth, 0], stack[depth, 1] = a, b
                depth += 1
    return reached
