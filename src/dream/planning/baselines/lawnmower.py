"""Parallel lanes over the whole survey area."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds
from dream.planning.parameters import check_range
from dream.planning.travel import Travel, travel_from
from dream.types import Decision, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

Points = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class Lawnmower:
    """Sweep the area in parallel lanes, blind to what is seen, with detours round obstacles.

    What it does: lanes as far apart as the camera sees to both sides, evenly spread over the area,
    begun at the corner nearest to the start. A waypoint that turns out to be solid ground is left
    out. At the end of the lanes it says that it is done; where the map disagrees, it goes over the area
    again with the lanes across.

    Reference: boustrophedon coverage (Choset & Pignon 1998).

    Assumes: the area is a box. Fails when: the ground is cluttered; what hides behind an obstacle
    stays unseen.
    """

    swath: float = 0.95
    """Lane spacing as a share of the ground seen to both sides, 2 · reach · sin(fov / 2)."""
    inset: float = 0.5
    """Distance of the lanes' ends from the area's edge, as a share of the reach."""

    def __post_init__(self) -> None:
        check_range("swath", self.swath, 0.1, 4.0)
        check_range("inset", self.inset, 0.0, 4.0)

    def begin(self, mission: Mission) -> _Mowing:
        """A fresh survey; the lanes are laid when the start is known."""
        return _Mowing(self, mission)

    def lanes(self, mission: Mission, start: SE2, along_y: bool) -> Points:
        """(N, 2) waypoints of the lanes, one per longest advance, nearest corner first.

        Args:
            mission: Area and camera.
            start: Where the vehicle is.
            along_y: Lanes run south-north rather than west-east.
        """
        protocol, box = mission.protocol, mission.bounds
        if not along_y:
            box = Bounds(box.y_min, box.x_min, box.y_max, box.x_max)
            start = SE2(start.y, start.x, 0.0)
        spacing = self.swath * 2.0 * protocol.reach * math.sin(protocol.camera.horizontal_fov / 2.0)
        count = max(1, math.ceil(box.width / spacing))
        xs = box.x_min + (np.arange(count) + 0.5) * box.width / count
        inset = min(self.inset * protocol.reach, 0.4 * box.depth)
        ends = np.array([box.y_min + inset, box.y_max - inset])
        if abs(xs[-1] - start.x) < abs(xs[0] - start.x):
            xs = xs[::-1]
        if abs(ends[1] - start.y) < abs(ends[0] - start.y):
            ends = ends[::-1]
        corners = [(x, y) for k, x in enumerate(xs) for y in (ends if k % 2 == 0 else ends[::-1])]
        waypoints = _densify(np.array(corners), max(protocol.advances))
        return waypoints if along_y else waypoints[:, ::-1]


def _densify(corners: Points, step: float) -> Points:
    pieces = [corners[:1]]
    for a, b in pairwise(corners):
        count = max(1, math.ceil(float(np.hypot(*(b - a))) / step))
        pieces.append(a + (np.arange(1, count + 1) / count)[:, None] * (b - a))
    return np.concatenate(pieces)


@dataclass(slots=True)
class _Mowing:
    planner: Lawnmower
    mission: Mission
    waypoints: Points = field(default_factory=lambda: np.empty((0, 2)))
    sweeps: int = 0
    """How many times lanes were laid."""
    claimed: bool = False

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        pose = observation.pose
        if len(self.waypoints) == 0 and (self.sweeps == 0 or self.claimed):
            self.waypoints = self.planner.lanes(self.mission, pose, along_y=self.sweeps % 2 == 0)
            self.sweeps += 1
            self.claimed = False
        travel = travel_from(pose, occupancy)
        while len(self.waypoints):
            path = self._path_to(self.waypoints[0], pose, travel, occupancy)
            if len(path) > 1:
                turn, advance = travel.move(path[0], path[1])
                x, y = self.waypoints[0]
                action = f"Along the lanes to ({x:.1f}, {y:.1f}), {len(path) - 1} steps away."
                return Decision(turn, advance, reasoning=Reasoning(action=action))
            self.waypoints = self.waypoints[1:]
        self.claimed = True
        return Decision(done=True, reasoning=Reasoning(action="All lanes are done."))

    def _path_to(
        self, waypoint: Points, pose: SE2, travel: Travel, occupancy: OccupancyMap
    ) -> list[tuple[int, int, int]]:
        """Shortest way to within a lattice step of the waypoint, or as near as known ground allows.

        A path of one pose means that the waypoint is reached, or is not to be had.
        """
        row, col = occupancy.cell_of(*waypoint)
        if occupancy.explored[row, col] and not occupancy.standable[row, col]:
            return []
        rows, cols = np.nonzero(travel.reached)
        steps = travel.nearest[rows, cols]
        distance = np.hypot(*(travel.position(rows, cols) - waypoint).T)
        near = np.maximum(distance, 2.0 * travel.protocol.lattice)
        best = np.lexsort((steps, near))[0]
        if near[best] >= max(
            2.0 * travel.protocol.lattice, float(np.hypot(pose.x - waypoint[0], pose.y - waypoint[1]))
        ):
            return []
        return travel.path_to_position(int(rows[best]), int(cols[best]))
