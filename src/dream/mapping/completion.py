"""When the map is complete: the paper's rule, in code."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from dream.geometry import SE2, Bounds
from dream.mapping.lattice import node_of, reachable
from dream.mapping.nearness import columns_near, within
from dream.mapping.sightlines import seeable
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, IntArray

if TYPE_CHECKING:
    from dream.mapping.occupancy import OccupancyMap

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
    question = "completion", node_of(pose, occupancy.protocol)
    return occupancy.answer(question, lambda: _completion(occupancy, pose))


def _completion(occupancy: OccupancyMap, pose: SE2) -> Completion:
    outlines = tuple(_outlines(occupancy))
    if outlines:
        # Outlines overlap, and each question has its price.
        asked = np.zeros(occupancy.shape, np.bool_)
        for _, _, candidates in outlines:
            asked[tuple(candidates.T)] = True
    else:
        asked = ~occupancy.observed
    cells = np.argwhere(asked)
    open_cells = cells[seeable(occupancy, pose, cells)]
    is_open = np.zeros(occupancy.shape, np.bool_)
    is_open[tuple(open_cells.T)] = True
    regions = tuple(
        Region(
            _frozen(mine),
            _middle(occupancy, mine),
            extent,
            _frozen(candidates[is_open[tuple(candidates.T)]]),
        )
        for mine, extent, candidates in outlines
    )
    sentence = _open_regions(occupancy, regions) if regions else _open_ground(occupancy, open_cells)
    left = _untraversed(occupancy, pose)
    return Completion(
        regions, _frozen(open_cells), sentence or _left_to_traverse(occupancy, left), _frozen(left)
    )


def _outlines(occupancy: OccupancyMap) -> Iterator[tuple[IntArray, Bounds, IntArray]]:
    """Target cells within the smallest group's radius of each other, in the raster order of their first.

    With the box around them, and the cells of their outline that are not observed. Of those nothing of whose
    outline lies in the area, none is named.
    """
    from scipy import ndimage

    from dream.mapping._kernels import nearness
    from dream.mapping._kernels.outline import outline

    protocol, half = occupancy.protocol, 0.5 * occupancy.protocol.cell
    wide = columns_near(MARGIN_CELLS, 1.0)
    labels, _ = nearness.linked(occupancy.target, (protocol.group_radius / protocol.cell) ** 2)
    for number, box in enumerate(ndimage.find_objects(labels), start=1):
        margin = MARGIN_CELLS + 1  # As far as an outline goes, and one more cell that is not in it.
        low = [max(side.start - margin, 0) for side in box]
        window = tuple(slice(a, side.stop + margin) for a, side in zip(low, box, strict=True))
        mine = labels[window] == number
        inside = outline(mine, wide)
        if not (inside & occupancy.to_see[window]).any():
            continue
        (west, east), (south, north) = occupancy.center_of(
            [box[0].start, box[0].stop - 1], [box[1].start, box[1].stop - 1]
        )
        yield (
            np.argwhere(mine) + low,
            Bounds(float(west) - half, float(south) - half, float(east) + half, float(north) + half),
            np.argwhere(inside & ~occupancy.observed[window]) + low,
        )


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
    return np.asarray(left[away <= near])


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
    could_be_seen = np.zeros(occupancy.shape, np.bool_)
    could_be_seen[tuple(unobserved.T)] = seeable(occupancy, pose, unobserved)
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


def _middle(occupancy: OccupancyMap, cells: IntArray) -> tuple[float, float]:
    """World x and y of the mean of cells (n, 2)."""
    x, y = occupancy.center_of(*cells.mean(axis=0))
    return float(x), float(y)


def _open_regions(occupancy: OccupancyMap, regions: Sequence[Region]) -> str:
    """The sentence about what is open; empty where nothing is."""
    waiting = [number for number, region in enumerate(regions, start=1) if not region.enclosed]
    if not waiting:
        return ""
    worst = max(waiting, key=lambda number: len(regions[number - 1].open_cells))
    cells = regions[worst - 1].open_cells
    x, y = _middle(occupancy, cells)
    text = f"region {worst} near ({x:.1f}, {y:.1f}) has {_unknown(cells)} at its edge"
    others = len(waiting) - 1
    return text + (f"; {others} more region{'s are' if others > 1 else ' is'} open" if others else "")


def _open_ground(occupancy: OccupancyMap, open_cells: IntArray) -> str:
    """Likewise, where no target was seen."""
    if not len(open_cells):
        return ""
    x, y = _middle(occupancy, open_cells)
    return f"no target was seen, and {_unknown(open_cells)} near ({x:.1f}, {y:.1f}) could still be seen"


def _left_to_traverse(occupancy: OccupancyMap, left: IntArray) -> str:
    """Likewise, where all was seen."""
    if not len(left):
        return ""
    x, y = _middle(occupancy, left)
    several = len(left) != 1
    return (
        f"{len(left)} target cell{'s' if several else ''} around ({x:.1f}, {y:.1f}) "
        f"{'were' if several else 'was'} not traversed"
    )


def _unknown(cells: IntArray) -> str:
    return f"{len(cells)} unknown cell{'s' if len(cells) != 1 else ''}"


def _frozen(cells: IntArray) -> IntArray:
    """The same, read-only."""
    cells.flags.writeable = False
    return cells
