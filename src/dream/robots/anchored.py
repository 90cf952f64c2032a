"""A robot that holds on to the ground it has seen."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from dream.geometry import SE2, SE3
from dream.mapping.alignment import Alignment, Float64Array, Matching, ground_points, moved
from dream.protocol import SurveyProtocol
from dream.types import Arrival, Observation, Setpoint

if TYPE_CHECKING:
    from dream.mission import Robot


@dataclass(frozen=True, slots=True)
class Anchoring:
    """How a robot's own pose may err, and which matches are allowed to correct it."""

    matching: Matching = field(default_factory=Matching)
    drift: float = 0.02
    """Standard deviation of what the position gains in error, over the square root of the metres moved."""
    heading: float = math.radians(1.0)
    """Standard deviation of the heading, as that of a compass on a vehicle of iron: it does not grow."""
    launch: float = 0.01
    """Metres, standard deviation of the position at the launch, where the map's frame is the robot's own."""
    launch_heading: float = math.radians(1.0)
    """And of the heading: what turns all of the map about the launch. Matches never show it. A compass of a
    vehicle of iron that is set at the launch errs elsewhere, on average, by what it erred there."""
    scale: float = 0.006
    """Standard deviation of the share by which all ways are long: a DVL's ± 1 %, evenly. Likewise."""
    age: float = 15.0
    """Metres of way after which a frame may correct others. Later ones err as the present one does: to match
    them only adds the errors of the match."""
    settle: float = 0.06
    """Metres that a correction may leave it away from where it was sent, or it goes there."""
    gate: float = 11.34
    """Squared sigmas beyond which a match is not believed: 99 of 100 good ones are nearer, in three
    dimensions."""

    def __post_init__(self) -> None:
        for name in ("drift", "heading", "launch", "launch_heading", "scale", "gate"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected a number above 0, got {getattr(self, name)}")
        for name in ("age", "settle"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected 0 m or more, got {getattr(self, name)}")


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    points: Float64Array
    place: SE2
    way: float
    account: Float64Array
    """(3, 3) how the pose may err, when it was taken; see `Anchored.sigma`."""


class Anchored:
    """Corrects where another robot believes to be by the ground that it sees again.

    What it does: the other robot's poses are in a frame that drifts, `odom`; those told here are in that of
    the map (REP-105). Between them is one level transform, `T_map_odom`. What a frame shows of the ground is
    matched to what frames of long ago showed of it, where they were put into the map; a Kalman filter weighs
    that by its curvature against what the robot may have drifted, and drops what is beyond its gate. A
    heading is corrected for its own frame and the way to the next: a compass errs by the heading, not by the
    way. Setpoints go back the other way.

    Why not the map itself: its cells mix old frames with new ones, which err as the present one does, and so
    let the errors of the matches add up. On `reef/patch` 1, poses that were true came to be wrong by 0.08 m
    (rms over 200 m) with frames of any age, and by 0.04 m with those of 15 m ago and before. What true poses
    lose, 0.03 to 0.08 m in six missions, is the price of bounding those that drift.

    Reference: REP-105; Olson, Real-Time Correlative Scan Matching, ICRA 2009.

    Assumes: the launch is where the robot believes; ground that does not change.
    Fails when: it drifts farther than the matching's window between two looks at the same ground. And what
    was mapped on the way out keeps its error: later frames are put where the first ones were.
    """

    def __init__(self, robot: Robot, protocol: SurveyProtocol, anchoring: Anchoring | None = None) -> None:
        """Around a robot that has not moved yet.

        Args:
            robot: What observes and goes.
            protocol: Depth limits and reach of its camera.
            anchoring: How its pose errs.
        """
        self._robot = robot
        self._protocol = protocol
        self._anchoring = Anchoring() if anchoring is None else anchoring
        place, heading = self._anchoring.launch**2, self._anchoring.heading**2
        self._covariance: Float64Array = np.diag([place, place, heading])
        self._account = np.diag([place, place, 0.0])
        self._T_map_odom = SE3.level(0.0, 0.0, 0.0, 0.0)
        self._seen: Observation | None = None
        self._looks: list[_Look] = []
        self._way = 0.0
        self.alignment: Alignment | None = None
        """By which the last observation was corrected; None where it was not."""

    def observe(self) -> Observation:
        """One frame with its pose in the map; the same again until it moves."""
        seen = self._look() if self._seen is None else self._seen
        return replace(seen, T_world_base=self._T_map_odom @ seen.T_world_base)

    def go_to(self, setpoint: Setpoint) -> Arrival:
        """Send the robot to where a place in the map is by its own reckoning, and look around there."""
        goal = SE2(setpoint.x, setpoint.y, setpoint.yaw)
        arrival = self._leg(setpoint)
        off = arrival.pose.distance(goal)
        if self.alignment is not None and off > self._anchoring.settle and not arrival.collided:
            # What it saw there moved it in the map: the rest of the way.
            rest = self._leg(setpoint)
            arrival = replace(
                rest,
                distance=arrival.distance + rest.distance,
                clearance=min(arrival.clearance, rest.clearance),
                note="; ".join(filter(None, (arrival.note, rest.note))),
            )
        return arrival

    def _leg(self, goal: Setpoint) -> Arrival:
        if self._seen is None:
            self._look()
        # Heights are the same in both frames: what is matched is seen from above.
        odom = _through(self._T_map_odom.inverse, SE2(goal.x, goal.y, goal.yaw))
        arrival = self._robot.go_to(replace(goal, x=odom.x, y=odom.y, yaw=odom.yaw))
        self._look()
        return replace(arrival, pose=_through(self._T_map_odom, arrival.pose), sigma=self.sigma)

    @property
    def T_map_odom(self) -> SE3:
        """From the robot's own frame to that of the map; level."""
        return self._T_map_odom

    @property
    def covariance(self) -> Float64Array:
        """(3, 3) m and rad of x, y and yaw, by which matches are weighed: as if the map were exact."""
        return self._covariance.copy()

    @property
    def sigma(self) -> float:
        """Metres by which the position may err in the world, along its less certain axis.

        Unlike the filter it takes the frames that were matched for as wrong as they were when they were
        taken, in the same direction each time: so the error goes towards theirs as far as the pose does, and
        not below. A wrong heading or scale from the launch on, which no match shows, comes on top.
        """
        spread = self._account[:2, :2].copy()
        if self._looks:
            launch, here = self._looks[0].place, self._looks[-1].place
            off = np.array([here.x - launch.x, here.y - launch.y])
            across = np.array([-off[1], off[0]])
            spread += self._anchoring.scale**2 * np.outer(off, off)
            spread += self._anchoring.launch_heading**2 * np.outer(across, across)
        return math.sqrt(float(np.linalg.eigvalsh(spread)[-1]))

    def _look(self) -> Observation:
        seen = self._robot.observe()
        here = self._carried(_through(self._T_map_odom, seen.pose), seen.pose)
        T_map_camera = self._T_map_odom @ seen.T_world_camera
        points = ground_points(seen.depth, seen.labels, seen.camera, T_map_camera, self._protocol)
        step = self._correction(points, here)
        self._turn_and_shift(here, step)
        there = SE2(here.x + step.x, here.y + step.y, here.yaw + step.yaw)
        shown = moved(points, (here.x, here.y), step)
        self._looks.append(_Look(shown, there, self._way, self._account))
        self._seen = seen
        return seen

    def _carried(self, here: SE2, odom: SE2) -> SE2:
        """The pose after a move, whose heading is the robot's own again, and its covariance."""
        anchoring = self._anchoring
        if not self._looks:
            return here
        last = self._looks[-1]
        east, north = here.x - last.place.x, here.y - last.place.y
        length = math.hypot(east, north)
        self._way = last.way + length
        by = np.array([[1.0, 0.0, -north], [0.0, 1.0, east], [0.0, 0.0, 0.0]])
        drift = anchoring.drift**2 * length
        gained = np.diag([drift, drift, anchoring.heading**2])
        self._covariance = by @ self._covariance @ by.T + gained
        self._account = by @ self._account @ by.T + gained
        self._turn_and_shift(here, SE2(0.0, 0.0, -self._T_map_odom.yaw))
        return SE2(here.x, here.y, odom.yaw)

    def _turn_and_shift(self, here: SE2, step: SE2) -> None:
        """Turn the map's view of the robot's frame about the vehicle, then shift it."""
        about = SE3.level(here.x + step.x, here.y + step.y, 0.0, step.yaw)
        self._T_map_odom = about @ SE3.level(-here.x, -here.y, 0.0, 0.0) @ self._T_map_odom

    def _correction(self, points: Float64Array, here: SE2) -> SE2:
        """What to add to the pose; zeros where nothing is believed."""
        self.alignment = None
        old = self._of_long_ago(here)
        ground = np.concatenate([look.points for look in old]) if old else np.empty((0, 4))
        found = self._anchoring.matching.align(points, (here.x, here.y), ground)
        if found is None:
            return SE2(0.0, 0.0, 0.0)
        offset, information = np.array([found.offset.x, found.offset.y, found.offset.yaw]), found.information
        before = np.linalg.inv(self._covariance)
        after = np.linalg.inv(before + information)
        # (P + R)⁻¹ = R⁻¹ (P⁻¹ + R⁻¹)⁻¹ P⁻¹, also where R⁻¹ is singular.
        if offset @ information @ after @ before @ offset > self._anchoring.gate:
            return SE2(0.0, 0.0, 0.0)
        self.alignment = found
        self._covariance = 0.5 * (after + after.T)
        gain = after @ information
        theirs = np.mean([look.account for look in old], axis=0)
        # Errors of one direction add by their size; that of the match itself, K R Kᵀ, by its square.
        both = (np.eye(3) - gain) @ _root(self._account) + gain @ _root(theirs)
        self._account = both @ both.T + gain @ after
        return SE2(*(gain @ offset).tolist())

    def _of_long_ago(self, here: SE2) -> list[_Look]:
        """Frames that may correct one that is taken here."""
        near = 2.0 * self._protocol.reach + self._anchoring.matching.window
        return [
            look
            for look in self._looks
            if self._way - look.way >= self._anchoring.age and look.place.distance(here) <= near
        ]


def _root(covariance: Float64Array) -> Float64Array:
    """The symmetric root."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _through(T: SE3, pose: SE2) -> SE2:
    """A level pose through a level transform."""
    return (T @ SE3.level(pose.x, pose.y, 0.0, pose.yaw)).se2
