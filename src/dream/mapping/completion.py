"""When the map is complete: the paper's rule, in code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds
from dream.mapping.nearness import within
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, IntArray

if TYPE_CHECKING:
    from dream.mapping.occupancy import OccupancyMap

Float64Array = npt.NDArray[np.float64]

NO_CELLS: IntArray = np.empty((0, 2), np.intp)
NO_CELLS.flags.writeable = False
MARGIN_CELLS = 2
"""Cells around a region's target cells that must be observed for it to be enclosed."""


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
    """(m, 2) cells at its edge or inside its outline that are not observed and could be seen."""

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
    untraversed: IntArray = field(default_factory=lambda: NO_CELLS)
    """(n, 2) target cells that the protocol wants traversed, that were not and could be."""

    @property
    def seen(self) -> bool:
        """Nothing is open."""
        return len(self.open_cells) == 0

    @property
    def complete(self) -> bool:
        """Nothing is open, and nothing is left to traverse."""
        return self.seen and len(self.untraversed) == 0


def check_completion(occupancy: OccupancyMap, pose: SE2) -> Completion:
    """Is every target region enclosed by observed cells, with none inside that is not?

    Observed is what was explored or seen by a return of its own, and what lies outside the map's area; see
    `Layers.observed`. Cells that no reachable pose could see do not count, and the bounds count as
    enclosure. Where no target was seen beside or in the area, everything in it that a reachable pose could
    see must be observed. Under a protocol with a `traversal`, the target cells in the area must be traversed,
    too, but for those that no reachable pose traverses. Arrays are read-only.

    Args:
        occupancy: What is known.
        pose: Where the vehicle is; what is reachable is so from here.
    """
    completion = occupancy.progress.check(pose, _window(occupancy))
    left = _untraversed(occupancy, pose)
    if not len(left):
        return completion
    sentence = completion.open_region
    if not sentence:
        x, y = (float(k.mean()) for k in occupancy.center_of(*left.T))
        sentence = f"{len(left)} target cell{'s' if len(left) != 1 else ''} around ({x:.1f}, {y:.1f}) "
        sentence += f"{'were' if len(left) != 1 else 'was'} not traversed"
    return replace(completion, open_region=sentence, untraversed=left)


def to_traverse(occupancy: OccupancyMap) -> BoolArray:
    """(rows, cols) target cells in the area that were not traversed, whether or not they can be.

    None under a protocol that asks for no traversal.
    """
    if occupancy.protocol.traversal is None:
        return np.zeros(occupancy.shape, np.bool_)
    left: BoolArray = occupancy.target & ~occupancy.traversed & occupancy.to_see
    return left


def traversal_margin(protocol: SurveyProtocol) -> float:
    """Metres from the edges of what a pose traverses that a cell's middle must keep to be counted on.

    So all that lies in it is traversed in about every case, also by a vehicle that is a little beside.
    """
    return 0.5 * protocol.cell


def _untraversed(occupancy: OccupancyMap, pose: SE2) -> IntArray:
    """Target cells that were not traversed; those that no reachable pose could, with its margin, left out.

    A camera is wider than a heading step, so that a place has some heading for every cell around it.
    """
    from scipy.spatial import cKDTree

    protocol = occupancy.protocol
    if protocol.traversal is None:
        return NO_CELLS
    left = np.argwhere(to_traverse(occupancy))
    places = reachable(occupancy, pose) if len(left) else np.empty((0, 2))
    if not len(places):
        return NO_CELLS
    near = protocol.traversal - traversal_margin(protocol)
    away, _ = cKDTree(places).query(np.stack(occupancy.center_of(*left.T), axis=-1))
    left = left[away <= near]
    left.flags.writeable = False
    return left


def hiding_places(occupancy: OccupancyMap, pose: SE2, radius: float) -> BoolArray:
    """Where a whole group of targets could still hide.

    Args:
        occupancy: What is known.
        pose: Where the vehicle is.
        radius: Of the group; metres.

    Returns:
        (rows, cols), true where `could_hide` is and the disc holds a cell that a reachable pose could see.
    """
    if not radius > 0.0:
        raise ValueError(f"radius: expected a positive length in metres, got {radius}")
    return that_would_show(occupancy, pose, radius, could_hide(occupancy, radius, occupancy.seen))


def that_would_show(occupancy: OccupancyMap, pose: SE2, radius: float, places: BoolArray) -> BoolArray:
    """Those of the places around which a reachable pose could see a cell that is not observed.

    Args:
        occupancy: What is known.
        pose: Where the vehicle is.
        radius: Of what is around; metres.
        places: (rows, cols). What it costs depends on how many there are.
    """
    cell = occupancy.protocol.cell
    unobserved = np.argwhere(within(places, radius, cell) & ~occupancy.observed)
    seen = occupancy.progress.seeable(pose, _window(occupancy), unobserved)
    could_be_seen = np.zeros(occupancy.shape, np.bool_)
    could_be_seen[tuple(seen.T)] = True
    return places & within(could_be_seen, radius, cell)


def could_hide(occupancy: OccupancyMap, radius: float, hopeless: BoolArray) -> BoolArray:
    """Where a whole group would not have been noticed, whether or not it can ever be seen.

    Args:
        occupancy: What is known.
        radius: Of the group; metres.
        hopeless: (rows, cols) cells that count as observed.

    Returns:
        (rows, cols), true at the centres in the map's area of discs that hold no such cell's centre, nor that
        of one that was seen. The smallest group that the protocol promises must fit into the bounds there; a
        larger one may reach past them.
    """
    # Half a cell from the bounds is half a cell whatever the last digits say.
    inside = min(radius, occupancy.protocol.group_radius) - 1e-6
    places: BoolArray = occupancy.distance_to_bounds >= inside
    if occupancy.area is not None:
        places &= occupancy.to_see
    return places & ~within(occupancy.seen | hopeless, radius, occupancy.protocol.cell)


def reachable(occupancy: OccupancyMap, pose: SE2) -> Float64Array:
    """The lattice positions to which the protocol's moves lead from a pose over standable ground.

    Args:
        occupancy: What is known; `passable` decides about each move.
        pose: Where the vehicle is, snapped to the lattice.

    Returns:
        (P, 2) metres in the world, the snapped position among them; empty where that is out of bounds.
    """
    return occupancy.progress.reachable(pose, _window(occupancy))


def free_moves(
    occupancy: OccupancyMap, pose: SE2, corner: tuple[int, int], shape: tuple[int, int]
) -> npt.NDArray[np.uint8]:
    """Which of the protocol's advances are `passable` from the nodes of a part of the lattice.

    Args:
        occupancy: What is known.
        pose: Where the vehicle is.
        corner: Row and column of the first node, which lies at y = row · lattice, x = column · lattice.
        shape: Rows and columns of nodes.

    Returns:
        (rows, cols, headings, advances) 1 or 0; 0 from nodes where the vehicle cannot stand.
    """
    nodes = (*corner, corner[0] + shape[0], corner[1] + shape[1])
    return occupancy.progress.free_moves(pose, _window(occupancy), nodes)


def _window(occupancy: OccupancyMap) -> tuple[int, int, int, int]:
    """First row and column, past row and column, in the map's own cells."""
    (row, col), (rows, cols) = occupancy.low, occupancy.shape
    return row, col, row + rows, col + cols


def describe(regions: Sequence[Region], middle: Callable[[IntArray], tuple[float, float]]) -> str:
    """The sentence about what is open; `middle` gives the world position in the middle of cells."""
    waiting = [number for number, region in enumerate(regions, start=1) if not region.enclosed]
    if not waiting:
        return ""
    worst = max(waiting, key=lambda number: len(regions[number - 1].open_cells))
    x, y = middle(regions[worst - 1].open_cells)
    text = f"region {worst} near ({x:.1f}, {y:.1f}) has {unknown(regions[worst - 1].open_cells)} at its edge"
    others = len(waiting) - 1
    return text + (f"; {others} more region{'s are' if others > 1 else ' is'} open" if others else "")


def describe_ground(open_cells: IntArray, middle: Callable[[IntArray], tuple[float, float]]) -> str:
    """The sentence where no target was seen; see `describe`."""
    if not len(open_cells):
        return ""
    x, y = middle(open_cells)
    return f"no target was seen, and {unknown(open_cells)} near ({x:.1f}, {y:.1f}) could still be seen"


def unknown(cells: IntArray) -> str:
    """How many unknown cells."""
    return f"{len(cells)} unknown cell{'s' if len(cells) != 1 else ''}"
