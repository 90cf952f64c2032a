"""How many steps it takes to get anywhere, and the first of them: search over the protocol's own moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.lattice import Lattice, Pose, lattice_of
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, IntArray

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.mapping.completion import Completion, Region

STANDOFF_CELLS = 1.5
"""Map cells that the body keeps from the middle of any solid one, where there is another way: the map is no
finer than that."""


@dataclass(frozen=True, slots=True, eq=False)
class Travel:
    """Steps from one pose to every pose of the lattice, over ground that the guard would let pass."""

    lattice: Lattice
    start: Pose
    """Where the search began."""
    steps: npt.NDArray[np.int32]
    """(poses,) −1 where it cannot be reached."""
    nearest: npt.NDArray[np.int32]
    """(nodes,) fewest steps to each position with any heading; −1 where no way leads."""
    parent: npt.NDArray[np.int32]
    """(poses,) the pose before; −1 at the start."""
    free: npt.NDArray[np.uint8]
    """(poses, advances) 1 where an advance along the heading is free."""

    @property
    def protocol(self) -> SurveyProtocol:
        """Whose moves they are."""
        return self.lattice.protocol

    @property
    def reached(self) -> BoolArray:
        """(nodes,) which positions can be reached, with whatever heading."""
        return np.asarray(self.nearest >= 0)

    def kept_to(self, good: BoolArray) -> Travel:
        """The search over moves alone that end on nodes (nodes,) that are good."""
        from dream.planning._kernels.moves import keep_to
        from dream.planning._kernels.search import search

        free = self.free.copy()
        keep_to(free, self.lattice.graph, good, int(self.lattice.node_of(self.start)))
        steps, parent, nearest = search(self.lattice.graph, free, self.start)
        return Travel(self.lattice, self.start, steps, nearest, parent, free)

    def steps_to(self, nodes: IntArray) -> npt.NDArray[np.int32]:
        """(n, headings) to the poses of some nodes; −1 where it cannot be reached."""
        return self.lattice.by_heading(self.steps)[nodes]

    def path(self, pose: Pose) -> list[Pose]:
        """The poses on a shortest way to a pose, the present one first."""
        return traced(self.parent, pose)

    def path_to_node(self, node: int) -> list[Pose]:
        """A shortest way to a reachable position, arriving with whatever heading."""
        steps = self.lattice.by_heading(self.steps)[node]
        return self.path(self.lattice.pose_at(node, int(np.argmax(steps == self.nearest[node]))))

    def move(self, before: Pose, after: Pose) -> tuple[float, float]:
        """See `Lattice.move`."""
        return self.lattice.move(before, after)


def traced(parent: npt.NDArray[np.int32], end: int) -> list[int]:
    """What led to an entry of a search, its start first; `parent` is the one before, −1 at the start."""
    found = [int(end)]
    while (before := int(parent[found[-1]])) >= 0:
        found.append(before)
    return found[::-1]


def travel_from(pose: SE2, occupancy: OccupancyMap, *, standoff: float = 0.0) -> Travel:
    """Search from `pose` over all moves of the protocol that stay on standable ground.

    Args:
        pose: Where the vehicle is.
        occupancy: What is known.
        standoff: Least distance of a position from the middle of a solid cell, metres.

    Returns:
        The same to all who ask until the map changes; whoever changes the arrays copies them.
    """
    return occupancy.answer(("travel", pose, standoff), lambda: _search(pose, occupancy, standoff))


def _search(pose: SE2, occupancy: OccupancyMap, standoff: float) -> Travel:
    from dream.planning._kernels.search import search

    lattice = lattice_of(occupancy.bounds, occupancy.protocol)
    start = lattice.pose(pose)
    free = _free_moves(
        pose, occupancy, occupancy.standable & (occupancy.distance_to_solid >= standoff), lattice
    )
    steps, parent, nearest = search(lattice.graph, free, start)
    return Travel(lattice, start, steps, nearest, parent, free)


def careful_standoff(protocol: SurveyProtocol) -> float:
    """Metres of a position from the middle of a solid cell, a little more than the guard asks."""
    return protocol.body_radius + STANDOFF_CELLS * protocol.cell


def careful_travel(pose: SE2, occupancy: OccupancyMap) -> Travel:
    """The search from `pose` that keeps that distance."""
    return travel_from(pose, occupancy, standoff=careful_standoff(occupancy.protocol))


def _free_moves(
    pose: SE2, occupancy: OccupancyMap, allowed: BoolArray, lattice: Lattice
) -> npt.NDArray[np.uint8]:
    """(poses, advances): is the whole move free, and its end allowed?"""
    from dream.mapping.lattice import free_moves
    from dream.planning._kernels.moves import keep_to

    free = free_moves(occupancy).reshape(lattice.poses, -1)
    # The vehicle may leave where it is, even where it could not go to now. And from exactly there the guard
    # looks at its first move.
    node = lattice.node(pose.x, pose.y)
    first, past = lattice.pose_at(node, 0), lattice.pose_at(node + 1, 0)
    heading, advance = np.nonzero(lattice.graph.ahead[first:past] >= 0)
    ends = lattice.position(lattice.graph.ahead[first:past][heading, advance])
    free[first:past] = 0
    free[first + heading, advance] = occupancy.passable(np.broadcast_to((pose.x, pose.y), ends.shape), ends)

    row, col = occupancy.cell_of(*lattice.positions.T)
    inside = (row >= 0) & (row < allowed.shape[0]) & (col >= 0) & (col < allowed.shape[1])
    good = np.zeros(lattice.nodes, np.bool_)
    good[inside] = allowed[row[inside], col[inside]]
    keep_to(free, lattice.graph, good, node)
    return free


def nearest_open(completion: Completion, travel: Travel, occupancy: OccupancyMap) -> Region | None:
    """The open region whose edge is fewest steps away; None where all are enclosed."""
    from scipy.spatial import cKDTree

    open_regions = [region for region in completion.regions if not region.enclosed]
    reached = np.flatnonzero(travel.reached)
    if not open_regions or not len(reached):
        return None
    nodes, steps = cKDTree(travel.lattice.positions[reached]), travel.nearest[reached]

    edges = [region.open_cells for region in open_regions]
    cells = np.stack(occupancy.center_of(*np.concatenate(edges).T), axis=-1)
    first = np.cumsum([0, *map(len, edges[:-1])])
    fewest = np.minimum.reduceat(steps[nodes.query(cells)[1]], first)
    return open_regions[int(np.argmin(fewest))]
