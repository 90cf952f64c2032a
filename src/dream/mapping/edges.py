"""Frontier, its clusters, and inflation, kept up to date where the map changes."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from dream.mapping.blocks import BlockStore, grown
from dream.mapping.layers import room_radius
from dream.types import IntArray

Int64Array = npt.NDArray[np.int64]

EVERYWHERE = 1 << 60
MOST_COMPONENTS = 32 * 32
"""In one block."""
CHART_MARGIN = 8
"""Blocks around what is known for which the chart of slots has room."""
MOST_CHARTED = 1 << 20
"""Blocks that the chart may cover, made or not: 8 MB."""
MOST_LINKS = 2 * (4 * 3 * 64 + 4)
"""From one block."""
MOST_RUNS = 4 * 32
"""On the sides of one block."""


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """Frontier cells that touch, diagonally too."""

    size: int
    """Number of cells."""
    centroid: tuple[float, float]
    """Mean row and column."""
    first: tuple[int, int]
    """Row and column of the first cell in raster order."""
    _component: int = field(repr=False)
    _change: int = field(repr=False)
    _edges: Edges = field(repr=False)

    @property
    def cells(self) -> IntArray:
        """(n, 2) row and column, in raster order; a new array each time.

        Raises:
            RuntimeError: The frontier has changed since; read the clusters again.
        """
        return self._edges.read_cells(self)


class Edges:
    """Frontier, its clusters, and inflation, kept up to date where the map changes.

    What it does: `update` renews the bits FRONTIER and INFLATED of a block store's `flags`, and from them
    the clusters, at a cost that depends on the rectangle that changed, not on the map. A frontier cell is
    known and not solid, with an unknown 4-neighbour in bounds; clusters are 8-connected.

    Reference: a component is a part of the frontier within one block; components that touch across a border
    are tied, and a cluster is what is tied together. Of clusters, sums are kept in a forest. Where a cluster
    lost components, searches from its loose ends run in turn until they meet, or until all pieces but
    one are known (Even and Shiloach, An On-Line Edge-Deletion Problem, 1981): a ring cut open costs
    a step for each block that it passes, everything else a few.

    Assumes: `log_odds` and `flags` of blocks of 64 × 64 cells; nobody else writes these two bits.
    """

    def __init__(
        self, store: BlockStore, needed_room: int, bounds: tuple[int, int, int, int] | None = None
    ) -> None:
        """Edges of all that is in the store.

        Args:
            store: Blocks with the layers `log_odds` and `flags`; more are made where inflation needs them.
            needed_room: Squared half cells between a cell's centre and a solid cell's square up to which
                it is inflated.
            bounds: First row and column, rows and columns of the survey area, in cells; None has no end.
        """
        from dream.mapping._kernels import edges

        self._store = store
        self._needed_room = needed_room
        self.limits = bounds
        if bounds is None:
            self._bounds = (-EVERYWHERE, -EVERYWHERE, EVERYWHERE, EVERYWHERE)
        else:
            row, col, rows, cols = bounds
            self._bounds = (row, col, row + rows, col + cols)
        self._spans = _spans(needed_room)
        self._components = np.zeros((2, edges.COMPONENT), np.int32)
        self._nodes = np.zeros((2, edges.NODE), np.int64)
        self._links = np.zeros((2, edges.LINK), np.int32)
        self._runs = np.zeros((2, edges.RUNS), np.int32)
        self._faces = np.zeros((2, 4), np.uint64)
        self._blocks = np.zeros((2, 4), np.int32)
        self._state = np.zeros(edges.STATE, np.int64)
        self._charted = 0
        self._chart_low = (0, 0)
        self._chart: IntArray = np.zeros((0, 0), np.int64)
        self._scratch = np.zeros((edges.SCRATCH, 0), np.int32)
        # Four by four blocks at a time.
        for row, col in sorted({(row // 4, col // 4) for row, col in store.slot_of}):
            side = 4 * edges.SIDE
            self._update(row * side, col * side, (row + 1) * side, (col + 1) * side, everything=True)

    @property
    def nbytes(self) -> int:
        """Bytes in use for the clusters, without what is in reserve."""
        from dream.mapping._kernels import edges

        pools = (
            (self._components, edges.S_COMPONENTS),
            (self._nodes, edges.S_NODES),
            (self._links, edges.S_LINKS),
            (self._runs, edges.S_RUNS),
        )
        used: int = sum(pool[0].nbytes * int(self._state[count]) for pool, count in pools)
        used += len(self._store) * (self._blocks[0].nbytes + self._faces[0].nbytes)
        return used + self._chart.nbytes

    def update(self, row: int, col: int, past_row: int, past_col: int) -> None:
        """Take in that cells became known or unknown, solid or not, all of them in a rectangle of cells."""
        if row < past_row and col < past_col:
            self._update(row, col, past_row, past_col, everything=False)

    def _update(self, row: int, col: int, past_row: int, past_col: int, *, everything: bool) -> None:
        from dream.mapping._kernels import edges

        store = self._store
        margin = max(2 * (len(self._spans) - 1), edges.SIDE + 1)
        low = ((row - margin) // edges.SIDE, (col - margin) // edges.SIDE)
        past = ((past_row + margin - 1) // edges.SIDE + 1, (past_col + margin - 1) // edges.SIDE + 1)
        shape = (past[0] - low[0], past[1] - low[1])
        self._reserve(shape[0] * shape[1])
        while True:
            table = self._table(low, shape)
            if len(self._blocks) < len(store.stamps):
                self._blocks = grown(self._blocks, len(store.stamps), len(self._blocks))
                self._faces = grown(self._faces, len(store.stamps), len(self._faces))
            missing = edges.update(
                store.pools["log_odds"].view(np.uint64),
                store.pools["flags"].view(np.uint64),
                table,
                low,
                (row, col, past_row, past_col),
                self._spans,
                self._bounds,
                everything,
                self._components,
                self._nodes,
                self._links,
                self._faces,
                self._runs,
                self._blocks,
                self._state,
                self._scratch,
            )
            if missing == 0:
                return
            store.make((low[0] + int(i), low[1] + int(j)) for i, j in np.argwhere(table < 0))

    def _table(self, low: tuple[int, int], shape: tuple[int, int]) -> IntArray:
        """`BlockStore.table`, cut from a chart of all slots: a dictionary is slower than all the rest."""
        new = len(self._store) - self._charted
        if new:
            self._charted += new
            keys = np.array(list(itertools.islice(reversed(self._store.slot_of), new)), np.int64)
            slots = np.arange(self._charted, self._charted - new, -1)
            self._chart_low, self._chart = _charted(self._chart_low, self._chart, keys)
            at = keys - self._chart_low
            inside = ((at >= 0) & (at < self._chart.shape)).all(axis=1)
            self._chart[at[inside, 0], at[inside, 1]] = slots[inside]
        i, j = low[0] - self._chart_low[0], low[1] - self._chart_low[1]
        rows, cols = self._chart.shape
        if 0 <= i <= rows - shape[0] and 0 <= j <= cols - shape[1]:
            return self._chart[i : i + shape[0], j : j + shape[1]].copy()
        return self._store.table(low, shape)

    def _reserve(self, blocks: int) -> None:
        """Room for whatever an update of so many blocks may add."""
        from dream.mapping._kernels import edges

        most = MOST_COMPONENTS * blocks
        components, nodes, links, runs = (
            int(self._state[used])
            for used in (edges.S_COMPONENTS, edges.S_NODES, edges.S_LINKS, edges.S_RUNS)
        )
        # Zeros cost no memory until they are written.
        if components + most >= len(self._components):
            self._components = grown(self._components, 2 * (components + most), components + 1)
        if nodes + 2 * most >= len(self._nodes):
            self._nodes = grown(self._nodes, 2 * (nodes + 2 * most), nodes + 1)
        if links + MOST_LINKS * blocks >= len(self._links):
            self._links = grown(self._links, 2 * (links + MOST_LINKS * blocks), links + 1)
        if runs + MOST_RUNS * blocks >= len(self._runs):
            self._runs = grown(self._runs, 2 * (runs + MOST_RUNS * blocks), runs + 1)
        if most > self._scratch.shape[1]:
            self._scratch = np.zeros((edges.SCRATCH, most), np.int32)

    def clusters(self) -> list[Cluster]:
        """All clusters, in the raster order of their first cells."""
        from dream.mapping._kernels import edges

        sums, firsts = edges.read_clusters(self._components, self._nodes, self._blocks, self._state)
        change = int(self._state[edges.S_CHANGES])
        order = np.lexsort((firsts[:, 1], firsts[:, 0]))
        centroids = sums[order, 1:] / sums[order, :1]
        return [
            Cluster(size, (row, col), (first_row, first_col), component, change, self)
            for (size, _, _), (row, col), (first_row, first_col, component) in zip(
                sums[order].tolist(), centroids.tolist(), firsts[order].tolist(), strict=True
            )
        ]

    def read_cells(self, cluster: Cluster) -> IntArray:
        """(n, 2) row and column of a cluster's cells, in raster order.

        Raises:
            RuntimeError: The frontier has changed since the cluster was read.
        """
        from dream.mapping._kernels import edges

        if cluster._change != int(self._state[edges.S_CHANGES]):
            raise RuntimeError(
                "cells: expected a cluster of the frontier as it is, got one from before it changed. "
                "Read the clusters again"
            )
        cells = edges.read_cells(
            self._store.pools["flags"].view(np.uint64),
            self._components,
            self._links,
            self._blocks,
            self._state,
            cluster._component,
            cluster.size,
        )
        ordered: IntArray = cells[np.lexsort((cells[:, 1], cells[:, 0]))]
        return ordered

    def copy(self, store: BlockStore) -> Edges:
        """Edges of their own for a copy of the store."""
        other = Edges(BlockStore(store.layers), self._needed_room, self.limits)
        other._store = store
        other._components = self._components.copy()
        other._nodes = self._nodes.copy()
        other._links = self._links.copy()
        other._runs = self._runs.copy()
        other._faces = self._faces.copy()
        other._blocks = self._blocks.copy()
        other._state = self._state.copy()
        return other


def _spans(needed_room: int) -> Int64Array:
    """How many cells to each side of a solid one are inflated, in its own row and in each row away."""
    radius = room_radius(needed_room)
    left = [needed_room - max(2 * away - 1, 0) ** 2 for away in range(radius + 1)]
    return np.array([(math.isqrt(room) + 1) // 2 for room in left], np.int64)


def _charted(low: tuple[int, int], chart: IntArray, keys: Int64Array) -> tuple[tuple[int, int], IntArray]:
    """A chart with room around these keys, unless blocks so far apart would make it too large."""
    first, past = keys.min(axis=0) - CHART_MARGIN, keys.max(axis=0) + 1 + CHART_MARGIN
    if chart.size:
        first, past = np.minimum(first, low), np.maximum(past, np.add(low, chart.shape))
        if (first == low).all() and (past == np.add(low, chart.shape)).all():
            return low, chart
        # More than needed, so that a map that grows on and on copies it rarely.
        spare = np.array(chart.shape) // 2
        first, past = first - spare * (first < low), past + spare * (past > np.add(low, chart.shape))
    rows, cols = (int(n) for n in past - first)
    if rows * cols > MOST_CHARTED:
        return low, chart
    larger = np.zeros((rows, cols), np.int64)
    i, j = (int(n) for n in np.subtract(low, first))
    if chart.size:
        larger[i : i + chart.shape[0], j : j + chart.shape[1]] = chart
    return (int(first[0]), int(first[1])), larger
