"""A tour that traverses what was found, where the protocol asks for that."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.lattice import Pose, lattice_of
from dream.planning.tours import Left, Search, reached_by, rest_of
from dream.planning.travel import Travel
from dream.traversal import traversed
from dream.types import BoolArray, IntArray, Mission

if TYPE_CHECKING:
    from dream.planning._kernels.views import Views

FloatArray = npt.NDArray[np.floating[Any]]

HORIZON = 80
"""Steps at most."""
CROWD = 0.5
"""A cell weighs one over this power of the cells around it: what stands alone costs a way of its own."""
AROUND = 0.5
"""How far around, in traversals; and the side of a part."""
MOVE = 0.2
"""Weight that a move counts as much as."""
LEAVE = 1e-6
"""Weight that rounding may make of nothing."""


@dataclass(slots=True, eq=False)
class TraversalTour:
    """The way to traverse all that is left, kept from step to step.

    What it does: a beam search over the real actions, until a sequence has traversed all cells that some way
    leads to. What a sequence leaves is judged by its weight and by the moves along the shortest tree over it.
    The rest of the last tour is gone on with while none is found that leaves less or is shorter, so that it
    never turns back and forth between two that are equal.

    Reference: beam search; the tree bounds a tour over what is left from below, as for a travelling salesman.

    Assumes: nothing hides what is traversed, and what is in reach of two nodes is in reach between them.
    Fails when: the cells lie farther apart than `HORIZON` steps; then only the way to the first is good.
    """

    mission: Mission
    path: list[Pose] = field(default_factory=list)
    """The rest of the last tour, the pose where the vehicle should be first."""
    _pad: int = field(init=False)
    """Cells around the map, so that no footprint leaves the padded one."""
    _shape: tuple[int, int] = field(init=False)
    """Of the padded map."""
    _corner: tuple[int, int] = field(init=False)
    """Column and row of node 0, in cells of the padded map."""
    _views: Views = field(init=False)
    """Which cells of the padded map each pose traverses, with nothing to hide them."""

    def __post_init__(self) -> None:
        protocol, bounds = self.mission.protocol, self.mission.bounds
        cell, lattice = protocol.cell, lattice_of(bounds, protocol)
        assert protocol.traversal is not None
        self._pad = math.ceil(protocol.traversal / cell) + 1
        rows, cols = round(bounds.depth / cell), round(bounds.width / cell)
        self._shape = rows + 2 * self._pad, cols + 2 * self._pad
        # All nodes lie at the same place in their cells.
        x, y = (
            (lattice.west * protocol.lattice - bounds.x_min) / cell,
            (lattice.south * protocol.lattice - bounds.y_min) / cell,
        )
        col, row = math.floor(x + 1e-9), math.floor(y + 1e-9)
        self._corner = col + self._pad, row + self._pad
        self._views = self._footprints(x - col, y - row)

    @property
    def _scale(self) -> int:
        """Cells between nodes."""
        return round(self.mission.protocol.lattice / self.mission.protocol.cell)

    def _footprints(self, x: float, y: float) -> Views:
        """Views of cells, for nodes that lie at x and y in theirs."""
        from dream.mapping import traversal_margin
        from dream.planning._kernels.views import Views

        protocol, span = self.mission.protocol, self._pad
        rows, cols = (k.ravel() for k in np.mgrid[-span : span + 1, -span : span + 1])
        east, north = (cols + 0.5 - x) * protocol.cell, (rows + 0.5 - y) * protocol.cell
        lists = []
        for heading in range(protocol.headings):
            yaw = heading * protocol.heading_step
            passed = traversed(east, north, yaw, protocol, margin=traversal_margin(protocol))
            lists.append((rows * self._shape[1] + cols)[passed])
        offset = np.concatenate(lists).astype(np.int32)
        col, row = (
            np.array(self._corner) + lattice_of(self.mission.bounds, protocol).graph.place * self._scale
        ).T
        anywhere = np.zeros(len(offset), np.uint8)
        return Views(
            first=np.cumsum([0, *map(len, lists)]),
            offset=offset,
            bearing=anywhere,
            far=anywhere,
            depth=np.zeros((len(row), 1), np.uint8),
            tile=row * self._shape[1] + col,
            tiles=self._shape[0] * self._shape[1],
            stride=self._shape[1],
            listed=np.full(len(row), -1),
            listed_first=np.zeros(1, np.int64),
            listed_element=np.zeros(0, np.int32),
        )

    def plan(self, left: IntArray, travel: Travel, moves: npt.NDArray[np.uint8]) -> list[Pose]:
        """The poses of the tour, the present one first; that alone where nothing is left that a way leads to.

        Args:
            left: (n, 2) rows and columns of the cells to traverse.
            travel: Known ways.
            moves: See `PoseViews.moves`. Only the first one is known to be free.
        """
        from scipy.spatial import cKDTree

        protocol = self.mission.protocol
        assert protocol.traversal is not None
        rest = rest_of(self.path, travel, moves)
        self.path = [travel.start]
        reached = reached_by(travel, moves)
        left = self._near(left, travel.lattice.positions[reached])
        if not len(left):
            return self.path
        radius = AROUND * protocol.traversal / protocol.cell
        crowd = cKDTree(left).query_ball_point(left, radius, return_length=True)
        cells = left + self._pad
        weights, index = np.zeros(self._views.tiles), cells[:, 0] * self._shape[1] + cells[:, 1]
        weights[index] = 1.0 / crowd**CROWD
        spots = (cells[:, ::-1] + 0.5 - self._corner) / self._scale
        ahead = Left.of(weights, index, left, spots, self._views, travel, moves, reached)
        near = self._reach / protocol.cell / self._scale
        found, leaves = ahead.search(Search(round(radius), near, MOVE, HORIZON, LEAVE))
        if len(rest) > 1:
            _, _, rest_leaves = ahead.follow(rest, -np.inf)
            if (round(rest_leaves, 6), len(rest)) <= (round(leaves, 6), len(found)):
                self.path = rest
                return rest
        self.path = found
        return found

    def traverses(self, path: list[Pose]) -> BoolArray:
        """(map rows, map cols) cells that the poses of a tour traverse, its start left out."""
        views, lattice = self._views, lattice_of(self.mission.bounds, self.mission.protocol)
        cells = np.zeros(self._shape[0] * self._shape[1], np.bool_)
        for pose in path[1:]:
            heading = lattice.heading_of(pose)
            here = views.offset[views.first[heading] : views.first[heading + 1]]
            cells[views.tile[lattice.node_of(pose)] + here] = True
        return cells.reshape(self._shape)[self._pad : -self._pad, self._pad : -self._pad]

    @property
    def _reach(self) -> float:
        """Metres from a node at which a cell's middle is still surely traversed."""
        from dream.mapping import traversal_margin

        protocol = self.mission.protocol
        return (protocol.traversal or 0.0) - traversal_margin(protocol)

    def _near(self, left: IntArray, places: FloatArray) -> IntArray:
        """Those that are near some place."""
        from scipy.spatial import cKDTree

        protocol, bounds = self.mission.protocol, self.mission.bounds
        middles = (left[:, ::-1] + 0.5) * protocol.cell + (bounds.x_min, bounds.y_min)
        away, _ = cKDTree(places).query(middles)
        return left[away <= self._reach]
