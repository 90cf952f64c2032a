"""What of the map is a target of which kind, from how much on it is found, and where that lies.

A wreck is what stands up from the seabed, oysters are what does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dream.geometry import Bounds
from dream.mapping.nearness import within
from dream.types import BoolArray, Target

if TYPE_CHECKING:
    from dream.mapping.occupancy import OccupancyMap

LEAST_AREA = 0.5
"""Square metres from which on targets of a kind are found. On the reefs of `dev` boulders among the targets
make up to 0.2 m² of them seem to stand up; a wreck shows more in the first frame that has it in reach."""


def target_cells(occupancy: OccupancyMap, target: Target) -> BoolArray:
    """(rows, cols) cells with targets of a kind, within the map's area and beyond it."""
    if target is Target.WRECK:
        return occupancy.target & occupancy.solid
    return occupancy.target & ~occupancy.solid if target is Target.OYSTERS else occupancy.target


def is_found(cells: BoolArray, cell: float) -> bool:
    """Are cells of that many metres a side at least `LEAST_AREA`?"""
    return bool(np.count_nonzero(cells) * cell**2 >= LEAST_AREA)


def target_extent(occupancy: OccupancyMap, target: Target) -> Bounds | None:
    """The box around the targets of a kind in the map's area; None where too few are known."""
    cells = target_cells(occupancy, target) & occupancy.to_see
    return _box(cells, occupancy) if is_found(cells, occupancy.protocol.cell) else None


def connected_extent(occupancy: OccupancyMap, target: Target, found: Bounds) -> Bounds:
    """The box around all targets of a kind that hang together with those in the box that was found before."""
    from scipy.ndimage import label

    protocol = occupancy.protocol
    cells = target_cells(occupancy, target)
    lumps, _ = label(within(cells, 0.5 * protocol.group_radius, protocol.cell), np.ones((3, 3)))
    south, west = occupancy.cell_of(found.x_min, found.y_min)
    north, east = occupancy.cell_of(found.x_max, found.y_max)
    inside = np.s_[south:north, west:east]
    connected = cells & np.isin(lumps, np.unique(lumps[inside][cells[inside]]))
    return _box(connected, occupancy) if connected.any() else found


def _box(cells: BoolArray, occupancy: OccupancyMap) -> Bounds:
    """Around some cells, of which there are any."""
    rows, cols = np.nonzero(cells)
    west, south = occupancy.center_of(rows.min(), cols.min())
    east, north = occupancy.center_of(rows.max(), cols.max())
    half = 0.5 * occupancy.protocol.cell
    return Bounds(float(west) - half, float(south) - half, float(east) + half, float(north) + half)
