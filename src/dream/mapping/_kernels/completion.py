"""What is still open, and whether it could be seen."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dream.mapping._kernels.room import segment_is_free
from dream.mapping._kernels.sight import RAY_MASK, any_open, block


@njit(cache=True, nogil=True)
def reachable_nodes(squared, needed, offset_x, offset_y, spacing, shape, row, col, moves):
    """Lattice nodes that can be reached from (row, col) by the moves, each a free segment.

    Node (i, j) lies at `offset + spacing * (j, i)`, in cells; `moves` is (n, 2) lattice steps east and north.
    """
    rows, cols = shape
    reached = np.zeros((rows, cols), dtype=np.bool_)
    stack = np.empty(rows * cols, dtype=np.int32)
    reached[row, col] = True
    stack[0] = row * cols + col
    depth = 1
    while depth > 0:
        depth -= 1
        i, j = stack[depth] // cols, stack[depth] % cols
        x, y = offset_x + spacing * j, offset_y + spacing * i
        for k in range(len(moves)):
            a, b = i + moves[k, 1], j + moves[k, 0]
            if a < 0 or b < 0 or a >= rows or b >= cols or reached[a, b]:
                continue
            if segment_is_free(squared, needed, x, y, offset_x + spacing * b, offset_y + spacing * a):
                reached[a, b] = True
                stack[depth] = a * cols + b
                depth += 1
    return reached


@njit(cache=True, nogil=True)
def sees(solid, x, y, row, col, reach, blind, half_angle, heading_step):
    """Would a camera at (x, y), in cells, explore the cell with the lattice heading that suits it best?

    The same rays as in the ray table, followed one by one from the position to the cell.
    """
    to_x, to_y = col + 0.5 - x, row + 0.5 - y
    distance = math.hypot(to_x, to_y)
    bearing = math.atan2(to_y, to_x)
    off_axis = abs(bearing - heading_step * math.floor(bearing / heading_step + 0.5))
    if distance > reach or off_axis > half_angle or distance * math.cos(off_axis) < blind:
        return False
    low, high = 0.0, 0.0
    for corner in range(4):
        corner_x = to_x + (0.5 if corner & 1 else -0.5)
        corner_y = to_y + (0.5 if corner & 2 else -0.5)
        # The angle from the centre's bearing to the corner's.
        side = math.atan2(to_x * corner_y - to_y * corner_x, to_x * corner_x + to_y * corner_y)
        low, high = min(low, side), max(high, side)
    per_radian = (RAY_MASK + 1) / (2.0 * math.pi)
    first = math.ceil((bearing + low) * per_radian - 0.5)
    last = math.floor((bearing + high) * per_radian - 0.5)
    for ray in range(first, last + 1):  # noqa: SIM110
        if ray_is_open(solid, x, y, (ray + 0.5) / per_radian, row, col):
            return True
    return False


@njit(cache=True, nogil=True)
def ray_is_open(solid, x, y, bearing, row, col):
    """Does the ray from (x, y) cross the cell, with no solid one before it?"""
    rows, cols = solid.shape
    dx, dy = math.cos(bearing), math.sin(bearing)
    j, i = math.floor(x), math.floor(y)
    # On the side of a cell, a ray to the left or down begins in the neighbour.
    if x == j and dx < 0.0:
        j -= 1
    if y == i and dy < 0.0:
        i -= 1
    step_x, step_y = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    next_x = ((j + 1 if dx > 0.0 else j) - x) / dx
    next_y = ((i + 1 if dy > 0.0 else i) - y) / dy
    for _ in range(abs(row - i) + abs(col - j)):
        if i < 0 or j < 0 or i >= rows or j >= cols or solid[i, j]:
            return False
        if next_x < next_y:
            j += step_x
            next_x += step_x / dx
        else:
            i += step_y
            next_y += step_y / dy
    return i == row and j == col


@njit(cache=True, nogil=True)
def seeable(
    solid,
    candidates,
    nearest,
    node_at,
    node_x,
    node_y,
    reach,
    blind,
    half_angle,
    heading_step,
    t_rows,
    t_cols,
    t_first,
    t_last,
):
    """Which candidate cells some node sees.

    Args:
        solid: (rows, cols).
        candidates: (n, 2) row and column.
        nearest: (n,) index of the node to be tried first.
        node_at: (rows, cols) index of the node in the cell, −1 without.
        node_x, node_y: Positions of the nodes, in cells.
        reach, blind, half_angle, heading_step: The sensor, in cells and radians.
        t_rows, t_cols, t_first, t_last: Ray table for an observer in the middle of its cell.

    Returns:
        (n,) bool.
    """
    rows, cols = solid.shape
    found = np.zeros(len(candidates), dtype=np.bool_)
    blocked = np.empty(RAY_MASK + 1, dtype=np.bool_)
    for c in range(len(candidates)):
        row, col = candidates[c, 0], candidates[c, 1]
        node = nearest[c]
        if sees(solid, node_x[node], node_y[node], row, col, reach, blind, half_angle, heading_step):
            found[c] = True
            continue
        # Seen from the cell itself, which nodes are in sight? Inside a hull all rays end at once.
        blocked[:] = False
        running = RAY_MASK + 1
        for k in range(len(t_rows)):
            i, j = row + t_rows[k], col + t_cols[k]
            if i < 0 or i >= rows or j < 0 or j >= cols:
                continue
            node = node_at[i, j]
            if (
                node >= 0
                and any_open(blocked, t_first[k], t_last[k])
                and sees(solid, node_x[node], node_y[node], row, col, reach, blind, half_angle, heading_step)
            ):
                found[c] = True
                break
            if solid[i, j] and k > 0:
                running -= block(blocked, t_first[k], t_last[k])
                if running == 0:
                    break
    return found


@njit(cache=True, nogil=True)
def within(mask, squared_radius):
    """Cells whose centre lies within a distance (squared, in cells) of that of a cell of the mask."""
    rows, cols = mask.shape
    near = np.zeros((rows, cols), dtype=np.bool_)
    reach = math.floor(math.sqrt(squared_radius) + 1e-9)
    for i in range(rows):
        for j in range(cols):
            if not mask[i, j]:
                continue
            for y in range(max(i - reach, 0), min(i + reach + 1, rows)):
                for x in range(max(j - reach, 0), min(j + reach + 1, cols)):
                    if (y - i) * (y - i) + (x - j) * (x - j) <= squared_radius + 1e-9:
                        near[y, x] = True
    return near


@njit(cache=True, nogil=True)
def filled(mask):
    """The mask with its holes: what cannot be reached from the grid's border by 4-neighbours."""
    rows, cols = mask.shape
    inside = np.ones((rows, cols), dtype=np.bool_)
    stack = np.empty(rows * cols, dtype=np.int32)
    depth = 0
    for i in range(rows):
        for j in range(cols):
            if (i == 0 or j == 0 or i == rows - 1 or j == cols - 1) and not mask[i, j]:
                inside[i, j] = False
                stack[depth] = i * cols + j
                depth += 1
    while depth > 0:
        depth -= 1
        i, j = stack[depth] // cols, stack[depth] % cols
        for a, b in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
            if 0 <= a < rows and 0 <= b < cols and inside[a, b] and not mask[a, b]:
                inside[a, b] = False
                stack[depth] = a * cols + b
                depth += 1
    return inside
