"""Lines of sight from positions to cells."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.mapping._kernels.flags import EDGE, RAY_MASK, RAYS
from dream.mapping._kernels.lattice import place
from dream.mapping._kernels.sight import any_open

Float64Array = npt.NDArray[np.float64]


class Nodes(NamedTuple):
    """Positions, by cell."""

    at: npt.NDArray[np.int32]
    """(rows, cols) index of the last one in each cell, -1 without."""
    x: Float64Array
    """(n,) in cells."""
    y: Float64Array


class Sensor(NamedTuple):
    """What a camera explores; lengths in cells, angles in radians."""

    reach: float
    blind: float
    half_angle: float
    heading_step: float


@njit(cache=True, nogil=True)
def nodes_by_cell(reached, first, grid, low, shape):
    """The nodes that are reached, by cell of the map; one on the edge of the map counts to the last cell.

    Args:
        reached: (rows, cols) bool of nodes, from the node `first` on.
        first: See `reached`.
        grid: See `lattice.py`.
        low, shape: The map's first cell, and its rows and columns.
    """
    node_at = np.full(shape, -1, np.int32)
    node_x, node_y = np.empty(reached.size), np.empty(reached.size)
    count = 0
    for i in range(reached.shape[0]):
        for j in range(reached.shape[1]):
            if not reached[i, j]:
                continue
            y, x = place(i + first[0], j + first[1], grid)
            row = min(max(math.floor(y) - low[0], 0), shape[0] - 1)
            col = min(max(math.floor(x) - low[1], 0), shape[1] - 1)
            node_at[row, col] = count
            node_x[count], node_y[count] = _snapped(x) - low[1], _snapped(y) - low[0]
            count += 1
    return Nodes(node_at, node_x[:count], node_y[:count])


@njit(cache=True, nogil=True)
def _snapped(at):
    """A node on the edge of cells lies exactly there: rays to both sides begin in these."""
    return float(math.floor(at)) if at - math.floor(at) < 2.0 * EDGE else at - EDGE


@njit(cache=True, nogil=True)
def sees(solid, x, y, row, col, sensor):
    """Would a camera at (x, y), in cells, explore the cell with the lattice heading that suits it best?

    The same rays as in the ray table, followed one by one from the position to the cell.
    """
    reach, blind, half_angle, heading_step = sensor
    to_x, to_y = col + 0.5 - x, row + 0.5 - y
    distance = math.hypot(to_x, to_y)
    if distance > reach or distance < blind:
        return False
    bearing = math.atan2(to_y, to_x)
    off_axis = abs(bearing - heading_step * math.floor(bearing / heading_step + 0.5))
    if off_axis > half_angle or distance * math.cos(off_axis) < blind:
        return False
    low, high = 0.0, 0.0
    for corner in range(4):
        corner_x = to_x + (0.5 if corner & 1 else -0.5)
        corner_y = to_y + (0.5 if corner & 2 else -0.5)
        # The angle from the centre's bearing to the corner's.
        side = math.atan2(to_x * corner_y - to_y * corner_x, to_x * corner_x + to_y * corner_y)
        low, high = min(low, side), max(high, side)
    per_radian = RAYS / (2.0 * math.pi)
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
def seeable(solid, candidates, nodes, sensor, rays):
    """Which candidates are seen by the nearest node, or by one to whose cell rays lead from their middle.

    Args:
        solid: (rows, cols).
        candidates: (n, 2) row and column.
        nodes, sensor: From where, and by what.
        rays: The `visibility.RayTable` of an observer in the middle of its cell.

    Returns:
        (n,) bool.
    """
    rows, cols = solid.shape
    found = np.zeros(len(candidates), dtype=np.bool_)
    blocked = np.empty(RAYS, dtype=np.bool_)
    for c in range(len(candidates)):
        row, col = candidates[c, 0], candidates[c, 1]
        blocked[:] = False
        running = RAYS
        nearest = True
        for k in range(len(rays.rows)):
            i, j = row + rays.rows[k], col + rays.cols[k]
            if i < 0 or i >= rows or j < 0 or j >= cols:
                continue
            node = nodes.at[i, j]
            if node >= 0 and (nearest or any_open(blocked, rays.first[k], rays.last[k])):
                nearest = False
                if sees(solid, nodes.x[node], nodes.y[node], row, col, sensor):
                    found[c] = True
                    break
            # Inside a hull all rays end at once.
            if solid[i, j] and k > 0 and running > 0:
                running -= _end(blocked, rays.first[k], rays.last[k])
            if running == 0 and not nearest:
                break
    return found


@njit(cache=True, nogil=True)
def _end(blocked, first, last):
    """End the rays of the interval; how many of them still ran?"""
    ended = 0
    for ray in range(first, last + 1):
        if not blocked[ray & RAY_MASK]:
            blocked[ray & RAY_MASK] = True
            ended += 1
    return ended
