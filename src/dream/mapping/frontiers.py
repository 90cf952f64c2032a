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

    A frontier cell is explored or traversable, not solid, and has an unknown 4-neighbour inside the
    bounds; cells that touch, diagonally too, are one cluster.
    """
    from dream.mapping._kernels import edges

    known = occupancy.explored | occupancy.traversable | occupancy.solid
    labels, count = edges.frontier_labels(known, known & ~occupancy.solid)
    cells = np.argwhere(labels)
    members = labels[cells[:, 0], cells[:, 1]]
    order = np.argsort(members, kind="stable")
    groups = np.split(cells[order], np.searchsorted(members[order], np.arange(2, count + 1)))
    found = []
    for group in groups[: count if count else 0]:
        x, y = occupancy.center_of(group[:, 0].mean(), group[:, 1].mean())
        found.append(Frontier(group, (float(x), float(y))))
    return found
