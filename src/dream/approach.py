"""The way to an area of which nothing can be seen yet, over ground that is not known."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.planning.travel import Travel, careful_standoff, careful_travel, travel_from
from dream.types import Decision, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

PATIENCE = 3
"""Looks at ground that stays unknown after which no way is believed to lead over it."""
AHEAD = 3.0
"""Metres along the way to the point that the vehicle turns to."""
SPARE = 20
"""Steps that the way may take beside two for each metre of it."""


@dataclass(slots=True, eq=False)
class Approach:
    """Flies to the area of a mission, before its planner begins there.

    What it does: what lies outside the area is nothing to look for, so that no planner would explore its way
    there. This one takes ground that was never seen for free and follows the shortest way over it; what it
    sees on the way is in the map. It is there as soon as some of the area was seen and more of it could be
    seen from where known ways lead, or the vehicle is in the area.

    Fails when: no way leads there, or a long one only; then the planner begins where it is.
    """

    mission: Mission
    looks: npt.NDArray[np.uint16] = field(init=False)
    """(rows, cols) looks at each cell after which it was still not traversable."""
    steps: int = 0
    """Steps on the way so far."""
    most: float = math.inf
    """Steps that it may take, by the way that there was at first."""
    held: int = 0
    """Times in a row that it could only hold and look again."""

    def __post_init__(self) -> None:
        cell, bounds = self.mission.protocol.cell, self.mission.bounds
        self.looks = np.zeros((round(bounds.depth / cell), round(bounds.width / cell)), np.uint16)

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision | None:
        """The next move; None where it is there, or gives up."""
        from dream.mapping import check_completion, view

        pose = observation.pose
        if self.mission.to_see.contains(pose.x, pose.y) or occupancy.observed.all():
            return None
        if (occupancy.seen & occupancy.to_see).any() and not check_completion(occupancy, pose).complete:
            return None
        self.looks[view(occupancy, pose.x, pose.y, pose.yaw) & ~occupancy.traversable] += 1
        away = self._away(occupancy)
        here = float(away[occupancy.cell_of(pose.x, pose.y)])
        if self.steps == 0:
            self.most = SPARE + 2.0 * here
        if not math.isfinite(here) or self.steps >= self.most:
            return None
        self.steps += 1
        action = f"On the way to the area, which is {here:.0f} m away."
        for travel in (careful_travel(pose, occupancy), travel_from(pose, occupancy)):
            move = self._nearer(travel, away, occupancy)
            if move is not None:
                self.held = 0
                return Decision(*move, reasoning=Reasoning(action=action))
        self.held += 1
        if self.held > PATIENCE:
            return None
        return Decision(self._turn(pose, away, occupancy), reasoning=Reasoning(action=action))

    def _away(self, occupancy: OccupancyMap) -> npt.NDArray[np.floating[Any]]:
        """(rows, cols) metres to the area over all that may be free; inf where no way leads."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import dijkstra

        protocol, shape = self.mission.protocol, occupancy.shape
        free = occupancy.distance_to_solid >= careful_standoff(protocol)
        free &= occupancy.distance_to_bounds >= protocol.body_radius + protocol.cell
        free &= occupancy.traversable | (self.looks < PATIENCE)
        # From where it is a way out is always believed in.
        free |= occupancy.standable
        number = np.arange(free.size).reshape(shape)
        starts, ends, lengths = [], [], []
        for row, col in ((0, 1), (1, 0), (1, 1), (1, -1)):
            one = np.s_[: shape[0] - row, max(-col, 0) : shape[1] - max(col, 0)]
            other = np.s_[row:, max(col, 0) : shape[1] + min(col, 0)]
            both = free[one] & free[other]
            starts.append(number[one][both])
            ends.append(number[other][both])
            lengths.append(np.full(np.count_nonzero(both), math.hypot(row, col) * protocol.cell))
        edges = np.concatenate(lengths), (np.concatenate(starts), np.concatenate(ends))
        graph = coo_array(edges, shape=(free.size, free.size)).tocsr()
        goals = number[free & occupancy.to_see]
        if not len(goals):
            return np.full(shape, np.inf)
        away = dijkstra(graph, directed=False, indices=goals, min_only=True)
        return np.asarray(away, np.float64).reshape(shape)

    def _nearer(
        self, travel: Travel, away: npt.NDArray[np.floating[Any]], occupancy: OccupancyMap
    ) -> tuple[float, float] | None:
        """Turn and advance towards the known place that is best to go on from; None where that is here."""
        nodes = np.flatnonzero(travel.reached)
        places = travel.lattice.positions[nodes]
        left = away[occupancy.cell_of(places[:, 0], places[:, 1])]
        # As if a step led a metre on: to go is better than to stay.
        cost = travel.nearest[nodes] + left / min(self.mission.protocol.advances)
        best = int(np.argmin(cost.round(6)))
        path = travel.path_to_node(int(nodes[best]))
        return travel.move(path[0], path[1]) if len(path) > 1 else None

    def _turn(self, pose: SE2, away: npt.NDArray[np.floating[Any]], occupancy: OccupancyMap) -> float:
        """The allowed turn that comes nearest to facing the way."""
        row, col = (int(k) for k in occupancy.cell_of(pose.x, pose.y))
        for _ in range(math.ceil(AHEAD / self.mission.protocol.cell)):
            first, left = max(row - 1, 0), max(col - 1, 0)
            around = away[first : row + 2, left : col + 2]
            i, j = np.unravel_index(int(np.argmin(around)), around.shape)
            row, col = first + int(i), left + int(j)
        x, y = occupancy.center_of(row, col)
        bearing = math.atan2(float(y) - pose.y, float(x) - pose.x)
        angles = (0.0, *self.mission.protocol.turn_angles)
        return min(angles, key=lambda turn: abs(math.remainder(pose.yaw + turn - bearing, 2.0 * math.pi)))
