"""The lattice of poses that a protocol's moves lead between: the one place that knows how it is laid out.

A pose is a number, and so is a node, the position that poses of all headings share. What else there is to a
pose (a level, a tilt of the camera) is more numbers that `Lattice` makes. Kernels know two things of them:
that `pose // headings` is the node, and where `Graph` leads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds, wrap_angle
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, IntArray

Pose = int
"""Number of a pose of a `Lattice`."""

BEYOND = 1e-9
"""Lattice steps that a node may lie beyond the bounds, for rounding."""


class Graph(NamedTuple):
    """The lattice as kernels take it: pose `node · headings + heading`.

    An action is a turn in place and then an advance along the new heading, or none.
    """

    headings: int
    """Of each node."""
    turned: npt.NDArray[np.int32]
    """(poses, turns) the pose after each of the protocol's turns in place."""
    ahead: npt.NDArray[np.int32]
    """(poses, advances) the pose after each of its advances; −1 where that leads out of the lattice."""
    pair: npt.NDArray[np.int32]
    """(poses,) equal for poses of one heading on two nodes by two: a search holds them for one."""
    place: npt.NDArray[np.int32]
    """(nodes, 2) lattice steps east and north of node 0."""
    grid: npt.NDArray[np.int32]
    """(rows, cols) the node so many steps north and east of node 0."""


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """All poses of a protocol in some bounds; `lattice_of` makes it.

    Moves over it are (poses, advances), of each pose whether the advance along its heading may be made.
    """

    bounds: Bounds
    protocol: SurveyProtocol
    west: int = field(init=False)
    """Node 0 lies at x = west · spacing."""
    south: int = field(init=False)
    """Node 0 lies at y = south · spacing."""
    graph: Graph = field(init=False)
    positions: npt.NDArray[np.float64] = field(init=False)
    """(nodes, 2) metres in the world."""

    def __post_init__(self) -> None:
        spacing = self.protocol.lattice
        (south, west), (rows, cols) = nodes_in(self.bounds, self.protocol)
        graph = _graph(self.protocol, rows, cols)
        for name, value in (("west", west), ("south", south), ("graph", graph)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "positions", (graph.place + np.array([west, south])) * spacing)

    @property
    def spacing(self) -> float:
        """Metres between neighbouring nodes."""
        return self.protocol.lattice

    @property
    def nodes(self) -> int:
        """How many there are."""
        return len(self.graph.place)

    @property
    def poses(self) -> int:
        """How many there are."""
        return len(self.graph.ahead)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the nodes: node 0 is the first of the first row, in the south-west."""
        rows, cols = self.graph.grid.shape
        return rows, cols

    @property
    def longest(self) -> float:
        """Metres of the longest advance."""
        return self.spacing * float(np.hypot(*offsets_of(self.protocol).reshape(-1, 2).T).max())

    def node(self, x: float, y: float) -> int:
        """The node nearest to a position; a ValueError where that is out of bounds."""
        row, col = round(y / self.spacing) - self.south, round(x / self.spacing) - self.west
        rows, cols = self.shape
        if not (0 <= row < rows and 0 <= col < cols):
            raise ValueError(f"pose: expected a position inside {self.bounds}, got ({x}, {y})")
        return int(self.graph.grid[row, col])

    def pose(self, pose: SE2) -> Pose:
        """The pose nearest to one in the world; a ValueError where that is out of bounds."""
        return self.pose_at(self.node(pose.x, pose.y), self.protocol.heading_index(pose.yaw))

    def pose_at(self, node: int, heading: int) -> Pose:
        """The pose of a node and one of the protocol's headings."""
        return int(node) * self.graph.headings + int(heading)

    def node_of(self, poses: npt.ArrayLike) -> IntArray:
        """The nodes of poses, of the same shape."""
        return np.asarray(poses) // self.graph.headings

    def heading_of(self, pose: Pose) -> int:
        """Which of the protocol's headings a pose has."""
        return int(pose) % self.graph.headings

    def position(self, poses: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """(..., 2) metres in the world, of one pose or several."""
        return np.asarray(self.positions[self.node_of(poses)])

    def world(self, pose: Pose) -> SE2:
        """A pose in the world, its yaw in [0, 2π)."""
        x, y = self.position(pose).tolist()
        return SE2(x, y, self.heading_of(pose) * self.protocol.heading_step)

    def by_heading(self, of_poses: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
        """(nodes, headings) what is given for each pose, (poses,)."""
        return of_poses.reshape(self.nodes, self.graph.headings)

    def every(self, n: int) -> BoolArray:
        """(nodes,) every n-th in each direction."""
        east, north = self.graph.place.T % n == 0
        return np.asarray(east & north)

    @property
    def checkered(self) -> BoolArray:
        """(nodes,) every second, as the squares of one colour on a chessboard."""
        east, north = self.graph.place.T
        return np.asarray((east + north) % 2 == 0)

    def turned_to(self, before: Pose, after: Pose) -> Pose:
        """The first pose with the heading of the second: what an action's advance begins with."""
        return self.pose_at(int(self.node_of(before)), self.heading_of(after))

    def advance_to(self, before: Pose, after: Pose) -> int | None:
        """Which of the protocol's advances leads from one pose to another after a turn; None if none does."""
        found = np.flatnonzero(self.graph.ahead[self.turned_to(before, after)] == after)
        return int(found[0]) if len(found) else None

    def move(self, before: Pose, after: Pose) -> tuple[float, float]:
        """Turn (radians) and nominal advance (metres) that lead from one pose of a path to the next."""
        turn = (self.heading_of(after) - self.heading_of(before)) % self.graph.headings
        advance = self.advance_to(before, after)
        length = 0.0 if advance is None else self.protocol.advances[advance]
        return wrap_angle(turn * self.protocol.heading_step), length


@lru_cache(maxsize=4)
def lattice_of(bounds: Bounds, protocol: SurveyProtocol) -> Lattice:
    """The lattice of a protocol in some bounds; made once, since its tables are large."""
    return Lattice(bounds, protocol)


def nodes_in(bounds: Bounds, protocol: SurveyProtocol) -> tuple[tuple[int, int], tuple[int, int]]:
    """Row and column of the first node in bounds; how many rows and columns of them there are.

    The node (row, col) lies at y = row · lattice, x = col · lattice.
    """
    lattice = protocol.lattice
    row, col = (math.ceil(edge / lattice - BEYOND) for edge in (bounds.y_min, bounds.x_min))
    last_row, last_col = (math.floor(edge / lattice + BEYOND) for edge in (bounds.y_max, bounds.x_max))
    return (row, col), (last_row + 1 - row, last_col + 1 - col)


def offsets_of(protocol: SurveyProtocol) -> npt.NDArray[np.int64]:
    """(headings, advances, 2) lattice steps east and north of each advance."""
    offsets = [[protocol.offset(h, a) for a in protocol.advances] for h in range(protocol.headings)]
    return np.array(offsets, np.int64)


def _graph(protocol: SurveyProtocol, rows: int, cols: int) -> Graph:
    headings = protocol.headings
    row, col = (k.ravel() for k in np.indices((rows, cols), np.int32))
    node, heading = np.arange(rows * cols, dtype=np.int32), np.arange(headings, dtype=np.int32)
    to = (heading[:, None] + np.array(protocol.turns, np.int32)) % headings
    turned = (node[:, None, None] * headings + to).reshape(-1, len(protocol.turns))
    ahead = np.full((rows * cols, headings, len(protocol.advances)), -1, np.int32)
    offsets = offsets_of(protocol)
    for h, a in np.ndindex(*offsets.shape[:2]):
        east, north = offsets[h, a]
        inside = (row + north >= 0) & (row + north < rows) & (col + east >= 0) & (col + east < cols)
        ahead[inside, h, a] = (node[inside] + north * cols + east) * headings + h
    pair = (row // 2 * cols + col // 2)[:, None] * headings + heading
    return Graph(
        headings,
        turned.astype(np.int32),
        ahead.reshape(-1, len(protocol.advances)),
        pair.ravel().astype(np.int32),
        np.stack([col, row], axis=1),
        node.reshape(rows, cols),
    )
