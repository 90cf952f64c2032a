"""What a pose sees of the map: ray casting in the camera's sector, with occlusion (Eq. 7-8).

Rays leave the camera at fixed bearings. A cell is visible when at least one of the rays that cross
it gets there; a ray ends in the first solid cell, which is itself visible. The unknown does not
block. All rays of a position are cast in one sweep over its surroundings from near to far, which is
exact: along a ray, cells follow each other in the order of their centres' distance.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from dream.mapping._kernels.flags import RAYS
from dream.types import BoolArray

if TYPE_CHECKING:
    from dream.mapping.occupancy import OccupancyMap

FRACTIONS = 8
"""Positions are resolved to this part of a cell; those of a protocol's lattice fall on it exactly."""

Int32Array = npt.NDArray[np.int32]
Float64Array = npt.NDArray[np.float64]


class RayTable(NamedTuple):
    """The surroundings of a position from near to far, and the rays that cross them. Lengths in cells."""

    rows: Int32Array
    """(n,) from the observer's cell."""
    cols: Int32Array
    x: Float64Array
    """(n,) from the observer to the cell's centre."""
    y: Float64Array
    distance: Float64Array
    """(n,) rising."""
    first: Int32Array
    """(n,) first ray that crosses the cell, in [0, RAYS)."""
    last: Int32Array
    """(n,) last one, from `first` on; beyond RAYS where the interval wraps."""


@lru_cache(maxsize=FRACTIONS * FRACTIONS)
def ray_table(radius: float, fraction_x: int, fraction_y: int) -> RayTable:
    """The table for an observer at (fraction_x, fraction_y) / FRACTIONS inside its cell.

    Args:
        radius: Distance in cells up to which a cell's centre may lie.
        fraction_x: In [0, FRACTIONS).
        fraction_y: In [0, FRACTIONS).
    """
    span = math.ceil(radius) + 1
    rows, cols = (offset.ravel() for offset in np.mgrid[-span : span + 1, -span : span + 1])
    x = cols + 0.5 - fraction_x / FRACTIONS
    y = rows + 0.5 - fraction_y / FRACTIONS
    distance = np.hypot(x, y)
    order = np.argsort(np.round(distance, 9), kind="stable")
    order = order[distance[order] <= radius + 1e-9]
    rows, cols, x, y, distance = rows[order], cols[order], x[order], y[order], distance[order]

    bearing = np.arctan2(y, x)
    lowest, highest = np.zeros_like(x), np.zeros_like(x)
    for corner_x, corner_y in ((-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)):
        to_x, to_y = x + corner_x, y + corner_y
        relative = np.arctan2(to_y, to_x) - bearing
        relative = (relative + math.pi) % (2.0 * math.pi) - math.pi
        at_observer = np.hypot(to_x, to_y) < 1e-9
        relative[at_observer] = 0.0
        lowest, highest = np.minimum(lowest, relative), np.maximum(highest, relative)
    # Ray k points along (k + ½) / RAYS of a turn. Rounding keeps quarter turns of the table alike.
    to_rays = RAYS / (2.0 * math.pi)
    first = np.ceil(np.round((bearing + lowest) * to_rays, 6) - 0.5).astype(np.int64)
    last = np.floor(np.round((bearing + highest) * to_rays, 6) - 0.5).astype(np.int64)
    last = np.maximum(first, last)
    inside = np.maximum(np.abs(x), np.abs(y)) < 0.5 - 1e-9
    first[inside], last[inside] = 0, RAYS - 1
    turn = first // RAYS * RAYS
    return RayTable(
        rows.astype(np.int32),
        cols.astype(np.int32),
        x,
        y,
        distance,
        (first - turn).astype(np.int32),
        (last - turn).astype(np.int32),
    )


def locate(occupancy: OccupancyMap, x: float, y: float) -> tuple[int, int, RayTable]:
    """The cell of a position, rounded to FRACTIONS of a cell, and the ray table of that fraction."""
    cell = occupancy.protocol.cell
    col, fraction_x = divmod(round((x - occupancy.bounds.x_min) / cell * FRACTIONS), FRACTIONS)
    row, fraction_y = divmod(round((y - occupancy.bounds.y_min) / cell * FRACTIONS), FRACTIONS)
    return row, col, ray_table(occupancy.protocol.reach / cell, fraction_x, fraction_y)


def visible_sector(
    solid: BoolArray,
    row: int,
    col: int,
    table: RayTable,
    *,
    yaw: float,
    half_angle: float,
    blind: float,
) -> BoolArray:
    """V_t: the cells in the camera's sector that a ray reaches (Eq. 7).

    Args:
        solid: (rows, cols) what stops rays.
        row: The observer's cell; it may lie outside the grid.
        col: See `row`.
        table: The surroundings, up to the reach, of the observer's place inside that cell.
        yaw: Direction of the sector's middle.
        half_angle: From there to either side.
        blind: Cells nearer than this along `yaw` are below the camera's view; in cells.

    Returns:
        (rows, cols), true for cells whose centre is in the sector and that are visible.
    """
    from dream.mapping._kernels import sight

    visible: BoolArray = sight.cast_sector(
        solid, row, col, table, math.cos(yaw), math.sin(yaw), math.cos(half_angle), blind
    )
    return visible


def view(occupancy: OccupancyMap, x: float, y: float, yaw: float) -> BoolArray:
    """The cells that an observation from there would explore, given the present map.

    Args:
        occupancy: What is known; the unknown does not block.
        x: Position in the world.
        y: Position in the world.
        yaw: Heading.

    Returns:
        (rows, cols) bool, explored already or not.
    """
    if not all(map(math.isfinite, (x, y, yaw))):
        raise ValueError(f"view: expected finite x, y and yaw, got ({x}, {y}, {yaw})")
    protocol = occupancy.protocol
    row, col, table = locate(occupancy, x, y)
    return visible_sector(
        occupancy.solid,
        row,
        col,
        table,
        yaw=yaw,
        half_angle=0.5 * protocol.camera.horizontal_fov,
        blind=protocol.blind / protocol.cell,
    )
