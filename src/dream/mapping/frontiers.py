"""The edge of the known: free cells beside unknown ones, in clusters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dream.types import IntArray

if TYPE_CHECKING:
    from dream.mapping.occupancy import OccupancyMap


@dataclass(frozen=True, slots=True, eq=False)
class Frontier:
    """One cluster of frontier cells."""

    cells: IntArray
    """(n, 2) row and column, in raster order."""
    centroid: tuple[float, float]
    """Mean of the cells' centres, world x and y."""

    @property
    def size(self) -> int:
        """Number of cells."""
        return len(self.cells)


def frontiers(occupancy: OccupancyMap) -> list[Frontier]:
    """All clusters, in the raster order of their first cells.

    A frontier cell is known, not solid, and has an unknown 4-neighbour inside the bounds; cells that touch,
    diagonally too, are one cluster. Where the map has an area, the cell or a neighbour of it lies there and
    was not observed, be it known or not: nothing else will lead past what the launch alone made known.
    """
    return occupancy.answer("frontiers", lambda: _frontiers(occupancy))


def _frontiers(occupancy: OccupancyMap) -> list[Frontier]:
    from scipy import ndimage

    beyond = ~(occupancy.known if occupancy.area is None else occupancy.observed)
    # All around a map without an end is unknown.
    beside = ndimage.binary_dilation(beyond, border_value=0 if occupancy.bounded else 1)
    labels, count = ndimage.label(occupancy.known & ~occupancy.solid & beside, np.ones((3, 3)))
    cells = np.argwhere(labels)
    members = labels[tuple(cells.T)]
    order = np.argsort(members, kind="stable")
    found = []
    for mine in np.split(cells[order], np.searchsorted(members[order], np.arange(2, count + 1))):
        if len(mine):
            mine.flags.writeable = False
            x, y = occupancy.center_of(*mine.mean(axis=0))
            found.append(Frontier(mine, (float(x), float(y))))
    return found
