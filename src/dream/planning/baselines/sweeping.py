"""How a route is flown to its end: detours, ground that was seen already, and ground that was missed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from dream.geometry import SE2
from dream.lattice import Pose
from dream.planning.baselines.lanes import Points, densified
from dream.planning.baselines.remains import Remains
from dream.planning.travel import Travel, careful_travel
from dream.planning.viewpoints import Viewpoint, viewpoints_from
from dream.types import Decision, IntArray, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

Layout = Callable[[Mission, SE2, int], Points]
"""Mission, start and number of the sweep → (n, 2) corners of the way. For the same start, odd sweeps go over
the area in another way than even ones."""


@dataclass(slots=True)
class Sweeping:
    """One mission along a route.

    Waypoints from which nothing new would be seen are left out, and so are those in solid ground. When the
    route is flown, what it missed is looked at, nearest first, where a whole group could hide. Where a `done`
    is refused, all ground that was missed is looked at until the map is complete; and when nothing of it is
    left, another sweep follows.
    """

    lay: Layout
    remains: Remains
    waypoints: Points = field(default_factory=lambda: np.empty((0, 2)))
    """(n, 2) those ahead."""
    headings: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    """(n,) the lattice heading in which the route comes to each."""
    start: SE2 | None = None
    """Where the first route was laid from."""
    sweeps: int = 0
    """How many times a route was laid."""
    budget: int = 0
    """Steps that the next waypoint may still take; 0 until it is headed for."""

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """The next move along the route."""
        self.remains.look(observation.pose, occupancy)
        return self.proceed(observation.pose, careful_travel(observation.pose, occupancy), occupancy)

    def proceed(self, pose: SE2, travel: Travel, occupancy: OccupancyMap) -> Decision:
        """Likewise, for a caller that knows the ways and looked already."""
        if self.sweeps == 0:
            self._lay(pose)
        path = self._along(pose, travel, occupancy)
        if not path:
            going = self.remains.go(pose, travel, occupancy, lambda way: self._missed(pose, way, occupancy))
            if going is not None:
                view, decision = going
                action = f"Back for {view.gain:.0f} cells that the route missed, {view.steps} steps away."
                return replace(decision, reasoning=Reasoning(action=action))
            if not self.remains.refused:
                return self.remains.done("The route is flown and nothing was missed.")
            self._lay(pose)
            path = self._along(pose, travel, occupancy)
            if not path:
                return self.remains.done("Nothing is left to look at.")
        x, y = self.waypoints[0]
        self.remains.refused = False
        action = f"Along the route to ({x:.1f}, {y:.1f}), {len(path) - 1} steps away."
        return Decision(*travel.move(path[0], path[1]), reasoning=Reasoning(action=action))

    def _lay(self, pose: SE2) -> None:
        mission = self.remains.mission
        self.start = self.start or pose
        self.waypoints = densified(self.lay(mission, self.start, self.sweeps), max(mission.protocol.advances))
        course = np.diff(self.waypoints, axis=0, prepend=[[pose.x, pose.y]])
        angles = np.arctan2(course[:, 1], course[:, 0]) / mission.protocol.heading_step
        self.headings = np.rint(angles).astype(np.int64) % mission.protocol.headings
        self.sweeps += 1

    def _drop_first(self) -> None:
        self.waypoints, self.headings, self.budget = self.waypoints[1:], self.headings[1:], 0

    # ---------------------------------------------------------------------------------- along the route

    def _along(self, pose: SE2, travel: Travel, occupancy: OccupancyMap) -> list[Pose]:
        """The way to the first waypoint that is worth it; empty when the route is flown."""
        from dream.mapping import gain

        if not len(self.waypoints):
            return []
        # A second sweep is for what the first could not see: it is flown whatever its views promise.
        shows = np.full(len(self.waypoints), np.inf)
        if self.sweeps == 1:
            worth = self.remains.worth_looking(occupancy).astype(np.float32)
            shows = gain(occupancy, self.waypoints, worth)[np.arange(len(self.waypoints)), self.headings]
        for show in shows:
            path = self._path_to(self.waypoints[0], pose, travel, occupancy)
            if show >= self.remains.least and len(path) > 1:
                if self.budget == 0:
                    self.budget = 2 * len(path) + 4
                self.budget -= 1
                if self.budget > 0:
                    return path
            self._drop_first()
        return []

    def _path_to(self, waypoint: Points, pose: SE2, travel: Travel, occupancy: OccupancyMap) -> list[Pose]:
        """Shortest way to within a lattice step of the waypoint, or as near as known ground allows.

        A path of one pose means that the waypoint is reached, or is not to be had.
        """
        row, col = occupancy.cell_of(*waypoint)
        if occupancy.explored[row, col] and not occupancy.standable[row, col]:
            return []
        near_enough = 2.0 * self.remains.mission.protocol.lattice
        nodes = np.flatnonzero(travel.reached)
        distance = np.maximum(np.hypot(*(travel.lattice.positions[nodes] - waypoint).T), near_enough)
        best = np.lexsort((travel.nearest[nodes], distance.round(6)))[0]
        here = math.hypot(pose.x - waypoint[0], pose.y - waypoint[1])
        if distance[best] >= max(near_enough, here) - 1e-6:
            return []
        return travel.path_to_node(int(nodes[best]))

    # ------------------------------------------------------------------------------- what the route missed

    def _missed(self, pose: SE2, travel: Travel, occupancy: OccupancyMap) -> Viewpoint | None:
        """The nearest view of ground that was missed; None where none is left."""
        from dream.mapping import hiding_places, within

        remains = self.remains
        worth = remains.worth_looking(occupancy)
        if remains.claims == 0:
            radius = remains.mission.protocol.group_radius
            worth &= within(hiding_places(occupancy, pose, radius), radius, occupancy.protocol.cell)
        views = viewpoints_from(travel, occupancy, worth.astype(np.float32), keep=remains.goal)
        kept = None if remains.goal is None else views.at(remains.goal)
        return kept if kept is not None and kept.gain >= remains.least else views.nearest(remains.least)
