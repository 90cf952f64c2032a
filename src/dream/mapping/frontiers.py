"""The edge of the known: free cells beside unknown ones, in clusters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from dream.types import IntArray

if TYPE_CHECKING:
    from dream.mapping.edges import Cluster
    from dream.mapping.occupancy import OccupancyMap


@dataclass(frozen=True, slots=True, eq=False)
class Frontier:
    """One cluster of frontier cells."""

    size: int
    """Number of cells."""
    centroid: tuple[float, float]
    """Mean of the cells' centres, world x and y."""
    _find: Callable[[], IntArray] = field(repr=False)
    _map: OccupancyMap = field(repr=False)
    _stamp: int = field(repr=False)

    @property
    def cells(self) -> IntArray:
        """(n, 2) row and column, in raster order; found anew each time.

        Raises:
            RuntimeError: The map has changed since; ask for the frontiers again.
        """
        if self._map.stamp != self._stamp:
            raise RuntimeError(
                f"cells: expected a frontier of the map as it is, at change {self._map.stamp}, got one "
                f"from change {self._stamp}. Ask for the frontiers again"
            )
        return self._find()


def frontiers(occupancy: OccupancyMap) -> list[Frontier]:
    """All clusters, in the raster order of their first cells.

    A frontier cell is known, not solid, and has an unknown 4-neighbour inside the bounds; cells that touch,
    diagonally too, are one cluster. Where the map has an area, the cell or a neighbour of it lies there and
    was not observed, be it known or not: nothing else will lead past what the launch alone made known.
    """
    if occupancy.area is not None:
        return _frontiers_of_area(occupancy)
    clusters, low = occupancy.edges.clusters(), occupancy.low
    middles = np.array([cluster.centroid for cluster in clusters]).reshape(-1, 2) - low
    x, y = occupancy.center_of(middles[:, 0], middles[:, 1])
    return [
        Frontier(cluster.size, place, _reader(cluster, low), occupancy, occupancy.stamp)
        for cluster, place in zip(clusters, zip(x.tolist(), y.tolist(), strict=True), strict=True)
    ]


def _reader(cluster: Cluster, low: tuple[int, int]) -> Callable[[], IntArray]:
    return lambda: cluster.cells - np.array(low)


def _frontiers_of_area(occupancy: OccupancyMap) -> list[Frontier]:
    """Likewise, found from scratch."""
    from scipy.ndimage import binary_dilation, label

    edge = occupancy.known & ~occupancy.solid & binary_dilation(~occupancy.observed)
    labels, count = label(edge, np.ones((3, 3)))
    cells = np.argwhere(labels)
    members = labels[tuple(cells.T)]
    found = []
    for number in range(1, count + 1):
        mine: IntArray = cells[members == number]
        x, y = occupancy.center_of(*mine.mean(axis=0))
        place = float(x), float(y)
        found.append(Frontier(len(mine), place, mine.copy, occupancy, occupancy.stamp))
    return found
