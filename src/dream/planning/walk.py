"""The way to traverse what was found, where the protocol asks for that."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.mapping.lattice import nodes_in, offsets_of
from dream.planning.travel import UNREACHED, IntArray, Pose, Travel
from dream.traversal import traversed
from dream.types import BoolArray, Mission

FloatArray = npt.NDArray[np.floating[Any]]

WIDTH = 48
"""Sequences of actions that the search keeps."""
HORIZON = 80
"""Steps of a walk at most."""
CROWD = 0.5
"""A cell weighs one over this power of the cells around it: what stands alone costs a way of its own."""
AROUND = 0.5
"""How far around, in traversals; and the side of a part."""
MOVE = 0.2
"""Weight that a move counts as much as."""


@dataclass(slots=True, eq=False)
class Walk:
    """The way to traverse all that is left, kept from step to step.

    What it does: a beam search over the real actions, until a sequence has traversed all cells that some way
    leads to. What a sequence leaves is judged by its weight and by the moves along the shortest tree over it.
    The rest of the last walk is gone on with while none is found that leaves less or is shorter, so that it
    never turns back and forth between two that are equal.

    Reference: beam search; the tree bounds a tour over what is left from below, as for a travelling salesman.

    Assumes: nothing hides what is traversed, and what is in reach of two nodes is in reach between them.
    Fails when: the cells lie farther apart than `HORIZON` steps; then only the walk to the first is good.
    """

    mission: Mission
    path: list[Pose] = field(default_factory=list)
    """The rest of the last walk, the pose where the vehicle should be first."""
    _pad: int = field(init=False)
    _stride: int = field(init=False)
    _shape: tuple[int, int] = field(init=False)
    _grid: tuple[int, int, int] = field(init=False)
    """Row and column of lattice node (0, 0), in cells of the padded map, and cells between nodes."""
    _lists: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]] = field(init=False)
    """For each heading where its list begins, and the cells that it traverses, from that of the node."""

    def __post_init__(self) -> None:
        protocol, bounds = self.mission.protocol, self.mission.bounds
        cell, scale = protocol.cell, round(protocol.lattice / protocol.cell)
        assert protocol.traversal is not None
        self._pad = math.ceil(protocol.traversal / cell) + 1
        rows, cols = round(bounds.depth / cell), round(bounds.width / cell)
        self._stride = cols + 2 * self._pad
        self._shape = rows + 2 * self._pad, self._stride
        (south, west), _ = nodes_in(bounds, protocol)
        # All nodes lie at the same place in their cells.
        x, y = (
            (west * protocol.lattice - bounds.x_min) / cell,
            (south * protocol.lattice - bounds.y_min) / cell,
        )
        col, row = math.floor(x + 1e-9), math.floor(y + 1e-9)
        self._grid = row + self._pad, col + self._pad, scale
        self._lists = self._footprints(x - col, y - row)

    def _footprints(self, x: float, y: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        from dream.mapping import traversal_margin

        protocol, span = self.mission.protocol, self._pad
        rows, cols = (k.ravel() for k in np.mgrid[-span : span + 1, -span : span + 1])
        east, north = (cols + 0.5 - x) * protocol.cell, (rows + 0.5 - y) * protocol.cell
        lists = []
        for heading in range(protocol.headings):
            yaw = heading * protocol.heading_step
            passed = traversed(east, north, yaw, protocol, margin=traversal_margin(protocol))
            lists.append((rows * self._stride + cols)[passed])
        return np.cumsum([0, *map(len, lists)]), np.concatenate(lists)

    def plan(self, left: IntArray, travel: Travel, moves: npt.NDArray[np.uint8]) -> list[Pose]:
        """The poses of the walk, the present one first; that alone where nothing is left that a way leads to.

        Args:
            left: (n, 2) rows and columns of the cells to traverse.
            travel: Known ways.
            moves: See `Outlook.moves`. Only the first one is known to be free.
        """
        from scipy.spatial import cKDTree

        from dream.planning._kernels import walk as kernels
        from dream.planning._kernels.search import search

        protocol = self.mission.protocol
        assert protocol.traversal is not None
        rest = rest_of(self.path, travel, moves)
        self.path = [travel.start]
        offsets, turns = offsets_of(protocol), np.array(protocol.turns, np.int64)
        reached = search(moves, offsets, turns, *travel.start)[2] < UNREACHED
        left = self._near(left, travel.position(*np.nonzero(reached)))
        if not len(left):
            return self.path
        radius = AROUND * protocol.traversal / protocol.cell
        crowd = cKDTree(left).query_ball_point(left, radius, return_length=True)
        weights = np.zeros(self._shape[0] * self._shape[1])
        index = (left[:, 0] + self._pad) * self._stride + left[:, 1] + self._pad
        weights[index] = 1.0 / crowd**CROWD
        side = round(radius)
        _, part_of = np.unique(left[:, 0] // side * self._stride + left[:, 1] // side, return_inverse=True)
        near, parts = self._reach / protocol.cell, int(part_of.max()) + 1
        ways = kernels.ways_to(part_of, parts, left + self._pad, moves, offsets, reached, near, self._grid)
        first, offset = self._lists
        footprint = (weights, first, offset, self._stride, self._grid)
        found, leaves = kernels.walk(
            *footprint,
            moves,
            offsets,
            turns,
            travel.start,
            index,
            part_of,
            ways,
            WIDTH,
            HORIZON,
            MOVE,
        )
        if len(rest) > 1:
            flat = np.array([np.ravel_multi_index(pose, travel.steps.shape) for pose in rest])
            rest_leaves = kernels.leaves(*footprint, flat, travel.steps.shape, index)
            if (round(rest_leaves, 6), len(rest)) <= (round(leaves, 6), len(found)):
                self.path = rest
                return rest
        self.path = [travel.pose(int(flat)) for flat in found]
        return self.path

    def traverses(self, path: list[Pose]) -> BoolArray:
        """(map rows, map cols) cells that the poses of a walk traverse, its start left out."""
        first, offset = self._lists
        cells = np.zeros(self._shape[0] * self._shape[1], np.bool_)
        row, col, scale = self._grid
        for r, c, heading in path[1:]:
            base = (row + r * scale) * self._stride + col + c * scale
            cells[base + offset[first[heading] : first[heading + 1]]] = True
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


def rest_of(path: list[Pose], travel: Travel, moves: npt.NDArray[np.uint8]) -> list[Pose]:
    """What of a way is still to go, one step on; empty where the vehicle is not on it, or it is blocked."""
    from dream.planning._kernels.lookahead import FREE

    if len(path) < 2 or path[1] != travel.start:
        return []
    rest, advances = path[1:], travel.protocol.advances
    for step, (before, after) in enumerate(pairwise(rest)):
        _, advance = travel.move(before, after)
        kind = moves[(*before[:2], after[2], advances.index(advance))] if advance else FREE
        if kind == 0 or (kind != FREE and step == 0):
            return []
    return rest
