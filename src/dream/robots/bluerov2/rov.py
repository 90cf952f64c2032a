"""The robot that is a BlueROV2: what observes and goes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dream.errors import MissionAborted
from dream.geometry import SE2, SE3, Camera, wrap_angle
from dream.perception import Account, Perception
from dream.protocol import SurveyProtocol
from dream.robots.bluerov2.bridge import Bridge, Stance
from dream.robots.bluerov2.navigation import Navigator
from dream.robots.bluerov2.threads import REAL_TIME, Threads
from dream.types import Arrival, BoolArray, Observation, Setpoint, UInt8Array

POLL = 0.02
"""Seconds between two looks at how a move goes."""
SOON = 3.0
"""Seconds that looking, and what the mission does with a step, may take each."""
ASIDE = 0.15
"""Metres that the vehicle may be carried while it may not move itself, and yet go on to its goal."""


class Picture(Protocol):
    """A frame of the camera."""

    @property
    def time(self) -> float: ...  # noqa: D102
    @property
    def rgb(self) -> UInt8Array: ...  # noqa: D102


class Eye(Protocol):
    """A camera that keeps the newest frame, as the pinhole that the protocol wants."""

    def newest(self, after: float, timeout: float) -> Picture | None:
        """The first frame taken after a time, or None where none comes within the time-out."""

    def view(self, picture: Picture, camera: Camera) -> tuple[UInt8Array, BoolArray]:
        """The picture as that camera would have taken it, and which of its pixels the lens really saw."""


@dataclass(frozen=True, slots=True)
class Manners:
    """When a move counts as done, and how long things may take."""

    near: float = 0.03
    """Metres from the setpoint, by the estimate, that count as there."""
    aligned: float = math.radians(2.5)
    """Radians, likewise."""
    level: float = 0.1
    """Metres of height, likewise."""
    slow: float = 0.03
    """m/s, likewise."""
    stay: float = 0.2
    """Seconds for which all of it holds."""
    room: float = 20.0
    """Seconds that a move may take beyond what its length and turn take at a tenth of a metre and of a
    radian a second."""
    fresh: float = 1.0
    """Seconds that a frame may be late."""
    thinking: float = 10.0
    """Seconds that the planner may take while the vehicle holds its place."""

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected a number above 0, got {getattr(self, name)}")


class BlueRov2:
    """Goes where it is sent, as far as it knows where it is, and looks.

    What it does: hands the goal to the bridge, which steers on its own thread, and waits until the vehicle
    rests there. A frame is taken after that. While it waits, and while the planner thinks, it tells the
    bridge that the mission lives.

    Assumes: a navigator that is aligned, a bridge that beats, a vehicle that is armed.
    Fails when: the bridge says that the dive is over, or the camera is silent: the mission is aborted by
    name.
    """

    def __init__(
        self,
        bridge: Bridge,
        navigator: Navigator,
        eye: Eye,
        perception: Perception,
        protocol: SurveyProtocol,
        now: Callable[[], float],
        *,
        frozen: Callable[[], bool],
        T_base_camera: SE3 | None = None,
        fineness: int = 1,
        manners: Manners | None = None,
        waits: Callable[[], bool] = lambda: False,
        holds: Callable[[], bool] = lambda: False,
        truth: Callable[[], tuple[SE3, int]] | None = None,
        threads: Threads = REAL_TIME,
    ) -> None:
        """On its bridge.

        Args:
            bridge: Steers.
            navigator: Says where it was when a frame was taken.
            eye: The camera.
            perception: Makes depth and labels of its frames.
            protocol: By which rules it looks and moves.
            now: The dive's clock.
            frozen: Does the camera show the same while the vehicle moves?
            T_base_camera: Where the camera looks; as the protocol says, unless given.
            fineness: Pixels of colour along each side of a pixel of depth and labels.
            manners: When a move counts as done.
            waits: Does the operator want no further move?
            holds: Does the operator want it to stay where it is, now?
            truth: Where the vehicle really is, and how often it has run into something, of a stand-in.
            threads: What it waits by.
        """
        self._bridge, self._navigator, self._eye = bridge, navigator, eye
        self._perception, self._protocol, self._now, self._threads = perception, protocol, now, threads
        self._frozen = frozen
        self._T_base_camera = T_base_camera or protocol.T_base_camera
        self._fineness = fineness
        self._manners = manners or Manners()
        self._waits, self._holds = waits, holds
        self._truth = truth
        self._contacts = truth()[1] if truth is not None else 0
        self._arrived = now()
        self.picture_ages: list[float] = []
        """Seconds from each frame that was used to its use."""
        self.accounts: list[Account] = []
        """How far each of them can be believed."""

    def observe(self) -> Observation:
        """One frame that was taken after the last move, with the pose that the vehicle had then.

        Raises:
            MissionAborted: No frame comes, or the camera is frozen.
        """
        self._bridge.renew(self._manners.fresh + SOON)
        picture = self._eye.newest(self._arrived, self._manners.fresh)
        if picture is None:
            raise MissionAborted(
                f"camera: expected a frame within {self._manners.fresh:g} s, got none. Is the stream up?"
            )
        if self._frozen():
            raise MissionAborted(
                "camera: expected pictures that change while the vehicle moves, got the same. "
                "Is the stream frozen?"
            )
        self.picture_ages.append(self._now() - picture.time)
        T_world_base = self._navigator.at(picture.time)
        camera = self._protocol.camera
        fine = camera.scaled(self._fineness) if self._fineness > 1 else camera
        rgb, seen = self._eye.view(picture, camera)
        altitude = float(T_world_base.translation[2]) - self._bridge.fix.seabed
        if not math.isfinite(altitude):
            altitude = self._protocol.altitude
        shows = self._perception.perceive(rgb, camera, T_world_base, self._T_base_camera, altitude, seen)
        self.accounts.append(shows.account)
        shown = rgb if fine is camera else self._eye.view(picture, fine)[0]
        self._bridge.renew(self._manners.thinking)
        return Observation(
            time=picture.time,
            rgb=shown,
            depth=shows.depth,
            labels=shows.labels,
            camera=camera,
            T_world_base=T_world_base,
            T_base_camera=self._T_base_camera,
            confidence=shows.confidence,
        )

    def go_to(self, setpoint: Setpoint) -> Arrival:
        """Swim there, and come to rest.

        Raises:
            MissionAborted: The dive is over.
        """
        manners, bridge = self._manners, self._bridge
        while self._waits():
            self._check()
            bridge.renew()
            self._threads.sleep(POLL)
        goal = SE2(setpoint.x, setpoint.y, setpoint.yaw)
        here = bridge.fix.T_world_base.se2
        deadline = self._now() + self._allowed(here, goal)
        bridge.renew()
        bridge.go(goal, setpoint.altitude)
        notes: list[str] = []
        way, still_since, last = 0.0, math.nan, here
        holding, stood = False, None
        while True:
            self._threads.sleep(POLL)
            self._check()
            bridge.renew()
            if self._holds() != holding:
                holding = not holding
                if holding:
                    fix = bridge.fix
                    height = float(fix.T_world_base.translation[2]) - fix.seabed
                    bridge.go(fix.T_world_base.se2, height if math.isfinite(height) else setpoint.altitude)
                else:
                    bridge.go(goal, setpoint.altitude)
            if holding:
                deadline += POLL
                continue
            standing, fix = bridge.standing, bridge.fix
            if standing.reason and standing.reason not in notes:
                notes.append(standing.reason)
            pose, now = fix.T_world_base.se2, self._now()
            # Not a number, and so no reason to wait, where the floor was never heard.
            height = float(fix.T_world_base.translation[2]) - fix.seabed
            way, last = way + last.distance(pose), pose
            there = (
                standing.stance is not Stance.YIELD
                and pose.distance(goal) <= manners.near
                and abs(wrap_angle(goal.yaw - pose.yaw)) <= manners.aligned
                and not abs(height - setpoint.altitude) > manners.level
                and float(np.hypot(fix.velocity[0], fix.velocity[1])) <= manners.slow
            )
            still_since = (still_since if not math.isnan(still_since) else now) if there else math.nan
            if there and now - still_since >= manners.stay:
                break
            if standing.stance not in (Stance.GO, Stance.SLOW):
                # Time in which it may not move does not count.
                deadline += POLL
                stood = stood or pose
                continue
            if stood is not None and stood.distance(pose) > ASIDE:
                # The way from here to the goal is none that the guard has looked at.
                notes.append("it was moved aside, and the move ends where it is")
                bridge.go(pose, setpoint.altitude)
                break
            stood = None
            if now > deadline:
                notes.append("the move took too long and was broken off")
                break
        self._arrived = self._now()
        bridge.renew(SOON)
        truth, collided = None, False
        if self._truth is not None:
            truth, contacts = self._truth()
            collided, self._contacts = contacts > self._contacts, contacts
        return Arrival(
            bridge.fix.T_world_base.se2,
            collided=collided,
            distance=way,
            clearance=math.inf,
            note="; ".join(notes),
            sigma=bridge.fix.position_sigma,
            truth=truth,
        )

    def _allowed(self, here: SE2, goal: SE2) -> float:
        """Seconds that a move may take."""
        return 10.0 * (here.distance(goal) + abs(wrap_angle(goal.yaw - here.yaw))) + self._manners.room

    def _check(self) -> None:
        standing = self._bridge.standing
        if standing.stance is Stance.OVER or self._bridge.over:
            raise MissionAborted(f"dive: {self._bridge.over or standing.reason}")
