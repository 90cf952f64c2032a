"""A robot that holds on to what it has mapped."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, SE3, wrap_angle
from dream.mapping import OccupancyMap
from dream.mapping.alignment import Alignment, Matching
from dream.mission import Robot
from dream.types import Arrival, Observation, Setpoint

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Anchoring:
    """How fast a robot's own pose may drift, and what a match to the map must be like to correct it."""

    matching: Matching = field(default_factory=Matching)
    drift: float = 0.02
    """Standard deviation of what the position gains in error, over the square root of metres: m/√m."""
    turning: float = math.radians(0.15)
    """Likewise of the heading, rad/√m."""
    start: tuple[float, float] = (0.02, math.radians(0.5))
    """Metres and radians at the launch, which is where the map's frame is."""
    gate: float = 11.34
    """Squared distance in sigmas beyond which a match is not believed: 99 of 100 good ones are nearer."""


class Anchored:
    """Corrects where another robot believes to be by what it sees again of the map.

    What it does: the other robot's poses are in a frame that drifts, `odom`; those that are told here are in
    that of the map (REP-105). Between them is one level transform, `T_map_odom`. Each observation is matched to
    the map before that takes it in; a Kalman filter on the pose's error weighs the match by its curvature
    against what the robot may have drifted since, and drops those beyond its gate. Setpoints go back the
    other way.

    Reference: REP-105; Olson, Real-Time Correlative Scan Matching, ICRA 2009.

    Assumes: the map is the one that the mission takes the observations into, after each.
    Fails when: the drift between two looks at the same ground exceeds the window of the matching.
    """

    def __init__(self, robot: Robot, occupancy: OccupancyMap, anchoring: Anchoring | None = None) -> None:
        """Around a robot that has not moved yet.

        Args:
            robot: What observes and goes.
            occupancy: The map of its mission; not changed.
            anchoring: How fast the robot's pose drifts.
        """
        self._robot = robot
        self._occupancy = occupancy
        self._anchoring = Anchoring() if anchoring is None else anchoring
        place, heading = self._anchoring.start
        self._covariance: Float64Array = np.diag([place**2, place**2, heading**2])
        self._T_map_odom = SE3.level(0.0, 0.0, 0.0, 0.0)
        self._last: SE2 | None = None
        self._seen: Observation | None = None
        self.alignment: Alignment | None = None
        """What the last observation said; None where it said nothing that was believed."""

    def observe(self) -> Observation:
        """One frame with the pose in the map; the same again until it moves."""
        if self._seen is None:
            seen = self._robot.observe()
            self._drift(self._in_map(seen.pose))
            self.alignment = self._match(replace(seen, T_world_base=self._T_map_odom @ seen.T_world_base))
            self._seen = seen
        return replace(self._seen, T_world_base=self._T_map_odom @ self._seen.T_world_base)

    def go_to(self, setpoint: Setpoint) -> Arrival:
        """Send the robot to where a place in the map is by its own reckoning."""
        goal = (
            self._T_map_odom.inverse @ SE3.level(setpoint.x, setpoint.y, setpoint.altitude, setpoint.yaw)
        ).se2
        arrival = self._robot.go_to(Setpoint(goal.x, goal.y, goal.yaw, setpoint.altitude))
        self._seen = None
        return replace(arrival, pose=self._in_map(arrival.pose))

    @property
    def T_map_odom(self) -> SE3:
        """Level."""
        return self._T_map_odom

    @property
    def covariance(self) -> Float64Array:
        """(3, 3) of x, y and yaw in the map: square metres and radians."""
        return self._covariance.copy()

    def _in_map(self, pose: SE2) -> SE2:
        return (self._T_map_odom @ SE3.level(pose.x, pose.y, 0.0, pose.yaw)).se2

    def _drift(self, here: SE2) -> None:
        """Carry the pose's covariance on, from the last observation to here."""
        if self._last is not None:
            east, north = here.x - self._last.x, here.y - self._last.y
            by = np.array([[1.0, 0.0, -north], [0.0, 1.0, east], [0.0, 0.0, 1.0]])
            moved = math.hypot(east, north) + abs(wrap_angle(here.yaw - self._last.yaw))
            place, heading = self._anchoring.drift**2 * moved, self._anchoring.turning**2 * moved
            self._covariance = by @ self._covariance @ by.T + np.diag([place, place, heading])
        self._last = here

    def _match(self, seen: Observation) -> Alignment | None:
        """Correct the transform by what fits; None where nothing does."""
        found = self._anchoring.matching.align(
            self._occupancy, seen.depth, seen.labels, seen.camera, seen.T_world_camera
        )
        if found is None:
            return None
        offset = np.array([found.offset.x, found.offset.y, found.offset.yaw])
        information, before = found.information, self._covariance
        after = np.linalg.inv(np.linalg.inv(before) + information)
        # Of (P + R)⁻¹ with R⁻¹ the information, which may be singular.
        surprise = float(offset @ information @ after @ np.linalg.inv(before) @ offset)
        if surprise > self._anchoring.gate:
            return None
        step = after @ information @ offset
        self._covariance = 0.5 * (after + after.T)
        here = seen.pose
        corrected = SE2(here.x + float(step[0]), here.y + float(step[1]), here.yaw + float(step[2]))
        T_odom_base = self._T_map_odom.inverse @ SE3.level(here.x, here.y, 0.0, here.yaw)
        self._T_map_odom = SE3.level(corrected.x, corrected.y, 0.0, corrected.yaw) @ T_odom_base.inverse
        self._last = corrected
        return found
