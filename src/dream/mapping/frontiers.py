"""The edge of the known: free cells beside unknown ones, in clusters."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from dream.mapping.edges import Cluster
from dream.types import IntArray

if TYPE_CHECKING:
    from dream.mapping.occupancy import OccupancyMap


@dataclass(frozen=True, slots=True, eq=False)
class Frontier:
    """One cluster of frontier cells."""

    size: int
    """Number of cells."""
    centroid: tuple[float, float]
    """Mean of the cells' centres, world x and y."""
    _cluster: Cluster = field(repr=False)
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
        cells: IntArray = self._cluster.cells - np.array(self._map.low)
        return cells


def frontiers(occupancy: OccupancyMap) -> list[Frontier]:
    """All clusters, in the raster order of their first cells.

    A frontier cell is known, not solid, and has an unknown 4-neighbour inside the bounds; cells that touch,
    diagonally too, are one cluster.
    """
    clusters, low = occupancy.edges.clusters(), occupancy.low
    middles = np.array([cluster.centroid for cluster in clusters]).reshape(-1, 2) - low
    x, y = occupancy.center_of(middles[:, 0], middles[:, 1])
    return [
        Frontier(cluster.size, place, cluster, occupancy, occupancy.stamp)
        for cluster, place in zip(clusters, zip(x.tolist(), y.tolist(), strict=True), strict=True)
    ]
