"""When the map is complete: the paper's rule, in code."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds
from dream.mapping.visibility import FRACTIONS, ray_table
from dream.types import BoolArray, IntArray

if TYPE_CHECKING:
    from dream.mapping.occupancy import OccupancyMap

Float64Array = npt.NDArray[np.float64]

MARGIN_CELLS = 2
"""Cells around a region's target cells that must be explored for it to be enclosed."""


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """Target cells that belong together, and what is still open about them."""

    cells: IntArray
    """(n, 2) row and column of the target cells."""
    centroid: tuple[float, float]
    """Mean of the cells' centres, world x and y."""
    extent: Bounds
    """The box around the cells."""
    open_cells: IntArray
    """(m, 2) cells at its edge or inside its outline that are unexplored and could be seen."""

    @property
    def enclosed(self) -> bool:
        """Nothing about it is open."""
        return len(self.open_cells) == 0


@dataclass(frozen=True, slots=True, eq=False)
class Completion:
    """What the map says about being done."""

    regions: tuple[Region, ...]
    """In the raster order of their first cells; region 1 is the first."""
    open_cells: IntArray
    """(m, 2) all cells that keep the map from being complete."""
    open_region: str
    """A sentence that names the most open region and where it is; empty when complete."""

    @property
    def complete(self) -> bool:
        """Nothing is open."""
        return len(self.open_cells) == 0


def check_completion(occupancy: OccupancyMap, pose: SE2) -> Completion:
    """Is every target region enclosed by explored cells, with no unknown cell inside?

    Unknown cells that no reachable pose could see do not count, and the bounds count as enclosure.
    Where no target was seen, everything that a reachable pose could see must be explored.

    Args:
        occupancy: What is known.
        pose: Where the vehicle is; what is reachable is so from here.
    """
    from dream.mapping._kernels import completion, edges

    unexplored = ~occupancy.observed
    labels, count = edges.label_within(
        occupancy.target, (occupancy.protocol.group_radius / occupancy.protocol.cell) ** 2
    )
    nodes = reachable(occupancy, pose)
    if count == 0:
        open_cells = _seeable(occupancy, nodes, np.argwhere(unexplored))
        text = ""
        if len(open_cells):
            x, y = _middle(occupancy, open_cells)
            text = (
                f"no target was seen, and {_unknown(open_cells)} near ({x:.1f}, {y:.1f}) could still be seen"
            )
        return Completion((), open_cells, text)

    margin = MARGIN_CELLS + 1
    regions = []
    cells = np.argwhere(labels)
    members = labels[cells[:, 0], cells[:, 1]]
    order = np.argsort(members, kind="stable")
    for mine in np.split(cells[order], np.searchsorted(members[order], np.arange(2, count + 1))):
        low = np.maximum(mine.min(axis=0) - margin, 0)
        high = np.minimum(mine.max(axis=0) + margin + 1, occupancy.shape)
        window = np.s_[low[0] : high[0], low[1] : high[1]]
        mask = np.zeros(tuple(high - low), np.bool_)
        mask[tuple((mine - low).T)] = True
        outline = completion.filled(completion.within(mask, MARGIN_CELLS**2))
        candidates = np.argwhere(outline & unexplored[window]) + low
        west, south = occupancy.center_of(*mine.min(axis=0))
        east, north = occupancy.center_of(*mine.max(axis=0))
        half = 0.5 * occupancy.protocol.cell
        regions.append(
            Region(
                cells=mine,
                centroid=_middle(occupancy, mine),
                extent=Bounds(
                    float(west) - half, float(south) - half, float(east) + half, float(north) + half
                ),
                open_cells=_seeable(occupancy, nodes, candidates),
            )
        )
    open_cells = np.unique(np.concatenate([region.open_cells for region in regions]), axis=0)
    return Completion(tuple(regions), open_cells, _describe(occupancy, regions))


def hiding_places(occupancy: OccupancyMap, pose: SE2, radius: float) -> BoolArray:
    """Where a whole group of targets could still hide.

    Args:
        occupancy: What is known.
        pose: Where the vehicle is.
        radius: Of the group; metres.

    Returns:
        (rows, cols), true at the centres of discs in bounds that hold no explored cell's centre and at least
        one cell that a reachable pose could see.
    """
    from scipy import ndimage

    if not radius > 0.0:
        raise ValueError(f"radius: expected a positive length in metres, got {radius}")
    cell = occupancy.protocol.cell
    rows, cols = np.indices(occupancy.shape, sparse=True)
    x, y = occupancy.center_of(rows, cols)
    bounds = occupancy.bounds
    inside = np.minimum(
        np.minimum(x - bounds.x_min, bounds.x_max - x), np.minimum(y - bounds.y_min, bounds.y_max - y)
    )
    places: BoolArray = inside >= radius
    if occupancy.observed.any():
        places &= ndimage.distance_transform_edt(~occupancy.observed, cell) > radius
    if not places.any():
        return places
    in_a_disc = ndimage.distance_transform_edt(~places, cell) <= radius
    seen = _seeable(occupancy, reachable(occupancy, pose), np.argwhere(in_a_disc & ~occupancy.observed))
    if not len(seen):
        return np.zeros(occupancy.shape, np.bool_)
    could_be_seen = np.zeros(occupancy.shape, np.bool_)
    could_be_seen[tuple(seen.T)] = True
    near: BoolArray = ndimage.distance_transform_edt(~could_be_seen, cell) <= radius
    return places & near


def reachable(occupancy: OccupancyMap, pose: SE2) -> Float64Array:
    """The lattice positions to which the protocol's moves lead from a pose over standable ground.

    Args:
        occupancy: What is known; `passable` decides about each move.
        pose: Where the vehicle is, snapped to the lattice.

    Returns:
        (P, 2) metres in the world, the snapped position among them; empty where that is out of bounds.
    """
    from dream.mapping._kernels import completion

    protocol, bounds = occupancy.protocol, occupancy.bounds
    first_col, last_col = (
        math.ceil(bounds.x_min / protocol.lattice - 1e-9),
        math.floor(bounds.x_max / protocol.lattice + 1e-9),
    )
    first_row, last_row = (
        math.ceil(bounds.y_min / protocol.lattice - 1e-9),
        math.floor(bounds.y_max / protocol.lattice + 1e-9),
    )
    shape = (last_row - first_row + 1, last_col - first_col + 1)
    row, col = round(pose.y / protocol.lattice) - first_row, round(pose.x / protocol.lattice) - first_col
    if not (0 <= row < shape[0] and 0 <= col < shape[1]):
        return np.zeros((0, 2))
    moves = {
        protocol.offset(heading, advance)
        for heading in range(protocol.headings)
        for advance in protocol.advances
    }
    reached = completion.reachable_nodes(
        occupancy.room,
        occupancy.needed_room,
        (first_col * protocol.lattice - bounds.x_min) / protocol.cell,
        (first_row * protocol.lattice - bounds.y_min) / protocol.cell,
        protocol.lattice / protocol.cell,
        shape,
        row,
        col,
        np.array(sorted(moves)),
    )
    nodes = np.argwhere(reached)
    positions: Float64Array = np.multiply(nodes[:, ::-1] + (first_col, first_row), protocol.lattice)
    return positions


def _seeable(occupancy: OccupancyMap, nodes: Float64Array, candidates: IntArray) -> IntArray:
    """The candidates (n, 2) that an observation from one of the nodes would explore."""
    from scipy import ndimage

    from dream.mapping._kernels import completion

    if not len(nodes) or not len(candidates):
        return candidates[:0]
    protocol = occupancy.protocol
    x, y = ((nodes - (occupancy.bounds.x_min, occupancy.bounds.y_min)) / protocol.cell).T
    row = np.clip(np.floor(y).astype(np.intp), 0, occupancy.shape[0] - 1)
    col = np.clip(np.floor(x).astype(np.intp), 0, occupancy.shape[1] - 1)
    node_at = np.full(occupancy.shape, -1, np.int32)
    node_at[row, col] = np.arange(len(nodes))
    distance, nearest = ndimage.distance_transform_edt(node_at < 0, return_indices=True)
    reach = protocol.reach / protocol.cell
    # A node lies anywhere in its cell, up to half a diagonal from the centre that was measured to.
    candidates = candidates[distance[tuple(candidates.T)] <= reach + 0.71]
    nearest = node_at[tuple(nearest[:, candidates[:, 0], candidates[:, 1]])]
    middle = ray_table(reach + 1.0, FRACTIONS // 2, FRACTIONS // 2)
    found = completion.seeable(
        occupancy.solid,
        candidates,
        nearest,
        node_at,
        np.ascontiguousarray(x),
        np.ascontiguousarray(y),
        reach,
        protocol.blind / protocol.cell,
        0.5 * protocol.camera.horizontal_fov,
        protocol.heading_step,
        middle.rows,
        middle.cols,
        middle.first,
        middle.last,
    )
    seen: IntArray = candidates[found]
    return seen


def _describe(occupancy: OccupancyMap, regions: list[Region]) -> str:
    waiting = [number for number, region in enumerate(regions, start=1) if not region.enclosed]
    if not waiting:
        return ""
    worst = max(waiting, key=lambda number: len(regions[number - 1].open_cells))
    x, y = _middle(occupancy, regions[worst - 1].open_cells)
    text = f"region {worst} near ({x:.1f}, {y:.1f}) has {_unknown(regions[worst - 1].open_cells)} at its edge"
    others = len(waiting) - 1
    return text + (f"; {others} more region{'s are' if others > 1 else ' is'} open" if others else "")


def _middle(occupancy: OccupancyMap, cells: IntArray) -> tuple[float, float]:
    x, y = occupancy.center_of(cells[:, 0].mean(), cells[:, 1].mean())
    return float(x), float(y)


def _unknown(cells: IntArray) -> str:
    return f"{len(cells)} unknown cell{'s' if len(cells) != 1 else ''}"
