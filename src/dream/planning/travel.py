"""How many steps it takes to get anywhere, and the first of them: search over the protocol's own moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, wrap_angle
from dream.mapping.lattice import free_moves, nodes_in, offsets_of
from dream.protocol import SurveyProtocol

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.mapping.completion import Completion, Region

IntArray = npt.NDArray[np.signedinteger[Any]]

Pose = tuple[int, int, int]
"""(row, col, heading) on the lattice of a `Travel`."""

UNREACHED = int(np.iinfo(np.int32).max)
"""Steps to where no way leads."""

STANDOFF_CELLS = 1.5
"""Map cells that the body keeps from the middle of any solid one, where there is another way: the map is no
finer than that."""


@dataclass(frozen=True, slots=True, eq=False)
class Travel:
    """Steps from one pose to every pose of the lattice, over ground that the guard would let pass."""

    protocol: SurveyProtocol
    west: int
    """Lattice column 0 lies at x = west · lattice."""
    south: int
    """Lattice row 0 lies at y = south · lattice."""
    steps: IntArray
    """(rows, cols, headings); −1 where it cannot be reached."""
    nearest: IntArray
    """(rows, cols) fewest steps to each position with any heading; `UNREACHED` where no way leads."""
    parent: IntArray
    """(rows, cols, headings) flat index of the pose before; −1 at the start."""
    free: npt.NDArray[np.uint8]
    """(rows, cols, headings, advances) 1 where an advance from a position along a heading is free."""

    @property
    def start(self) -> Pose:
        """Where the search began."""
        return self.pose(int(np.argmax(self.steps == 0)))

    def pose(self, flat: int) -> Pose:
        """The pose of a flat index."""
        row, col, heading = np.unravel_index(flat, self.steps.shape)
        return int(row), int(col), int(heading)

    @property
    def reached(self) -> npt.NDArray[np.bool_]:
        """(rows, cols) which positions can be reached, with whatever heading."""
        return np.asarray(self.nearest < UNREACHED)

    def position(self, rows: npt.ArrayLike, cols: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """(N, 2) metres in the world of lattice nodes."""
        x = (np.asarray(cols) + self.west) * self.protocol.lattice
        y = (np.asarray(rows) + self.south) * self.protocol.lattice
        return np.stack([x, y], axis=-1).astype(np.float64)

    def path(self, pose: Pose) -> list[Pose]:
        """The poses (row, col, heading) on a shortest way to `pose`, the present one first."""
        flat = int(np.ravel_multi_index(pose, self.steps.shape))
        found = [flat]
        while (flat := int(self.parent.flat[flat])) >= 0:
            found.append(flat)
        return [self.pose(flat) for flat in reversed(found)]

    def path_to_position(self, row: int, col: int) -> list[Pose]:
        """A shortest way to a reachable position, arriving with whatever heading."""
        return self.path((row, col, int(np.argmax(self.steps[row, col] == self.nearest[row, col]))))

    def move(self, before: Pose, after: Pose) -> tuple[float, float]:
        """Turn (radians) and nominal advance (metres) that lead from one pose of a path to the next."""
        headings = self.protocol.headings
        turn = wrap_angle((after[2] - before[2]) % headings * self.protocol.heading_step)
        offset = (after[1] - before[1], after[0] - before[0])
        advance = next(
            (a for a in self.protocol.advances if self.protocol.offset(after[2], a) == offset), 0.0
        )
        return turn, advance


def travel_from(pose: SE2, occupancy: OccupancyMap, *, standoff: float = 0.0) -> Travel:
    """Search from `pose` over all moves of the protocol that stay on standable ground.

    Args:
        pose: Where the vehicle is.
        occupancy: What is known.
        standoff: Least distance of a position from the middle of a solid cell, metres.
    """
    from dream.planning._kernels.search import search

    protocol = occupancy.protocol
    bounds, spacing = occupancy.bounds, protocol.lattice
    (south, west), (rows, cols) = nodes_in(bounds, protocol)
    offsets = offsets_of(protocol)
    row, col = round(pose.y / spacing) - south, round(pose.x / spacing) - west
    if not (0 <= row < rows and 0 <= col < cols):
        raise ValueError(f"pose: expected a position inside {bounds}, got ({pose.x}, {pose.y})")
    turns = np.array(protocol.turns, dtype=np.int64)
    allowed = occupancy.standable & (occupancy.distance_to_solid >= standoff)
    edges = _free_moves(pose, occupancy, allowed, offsets, (south, west), (row, col))
    steps, parent, nearest = search(edges, offsets, turns, row, col, protocol.heading_index(pose.yaw))
    return Travel(protocol, west, south, steps, nearest, parent, edges)


def careful_standoff(protocol: SurveyProtocol) -> float:
    """Metres of a position from the middle of a solid cell, a little more than the guard asks."""
    return protocol.body_radius + STANDOFF_CELLS * protocol.cell


def careful_travel(pose: SE2, occupancy: OccupancyMap) -> Travel:
    """The search from `pose` that keeps that distance."""
    return travel_from(pose, occupancy, standoff=careful_standoff(occupancy.protocol))


def _free_moves(
    pose: SE2,
    occupancy: OccupancyMap,
    allowed: npt.NDArray[np.bool_],
    offsets: IntArray,
    corner: tuple[int, int],
    start: tuple[int, int],
) -> npt.NDArray[np.uint8]:
    """(rows, cols, headings, advances): is the whole move free, and its end allowed?"""
    from dream.planning._kernels.search import keep_to

    spacing = occupancy.protocol.lattice
    free = free_moves(occupancy)
    shape = free.shape[:2]
    # The vehicle may leave where it is, even where it could not go to now.
    ends = np.add(start[::-1], corner[::-1]) + offsets.reshape(-1, 2)
    # And from exactly there the guard looks at its first move.
    begin = np.broadcast_to((pose.x, pose.y), ends.shape)
    free[start] = occupancy.passable(begin, ends * spacing).reshape(offsets.shape[:2])

    y, x = ((np.arange(n) + first) * spacing for n, first in zip(shape, corner, strict=True))
    row, col = occupancy.cell_of(x, y)
    rows, cols = ((k >= 0) & (k < n) for k, n in zip((row, col), allowed.shape, strict=True))
    good = np.zeros(shape, dtype=np.bool_)
    good[np.ix_(rows, cols)] = allowed[np.ix_(row[rows], col[cols])]
    keep_to(free, offsets, good, *start)
    return free


def nearest_open(completion: Completion, travel: Travel, occupancy: OccupancyMap) -> Region | None:
    """The open region whose edge is fewest steps away; None where all are enclosed."""
    from scipy.spatial import cKDTree

    open_regions = [region for region in completion.regions if not region.enclosed]
    rows, cols = np.nonzero(travel.reached)
    if not open_regions or not len(rows):
        return None
    nodes, steps = cKDTree(travel.position(rows, cols)), travel.nearest[rows, cols]

    def steps_to(region: Region) -> int:
        cells = np.stack(occupancy.center_of(*region.open_cells.T), axis=-1)
        return int(steps[nodes.query(cells)[1]].min())

    return min(open_regions, key=steps_to)
