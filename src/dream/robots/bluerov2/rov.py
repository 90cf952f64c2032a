"""The robot that is a BlueROV2: what observes and goes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from dream.errors import MissionAborted
from dream.geometry import SE2, SE3, Camera, FloatArray, camera_mount, wrap_angle
from dream.perception import Account, Perception, View
from dream.perception.lighting import Lighting
from dream.protocol import SurveyProtocol
from dream.robots.bluerov2.bridge import Bridge, Stance
from dream.robots.bluerov2.limits import LOW_SHARE
from dream.robots.bluerov2.navigation import Fix, Navigator
from dream.robots.bluerov2.telemetry import Telemetry
from dream.robots.bluerov2.threads import REAL_TIME, Threads
from dream.types import Arrival, BoolArray, Observation, Setpoint, UInt8Array

POLL = 0.02
"""Seconds between two looks at how a move goes."""
SOON = 3.0
"""Seconds that looking, and what the mission does with a step, may take each."""
TILTING = 12.0
"""Seconds that tilting the camera may take, with all that is asked for again."""
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


class Mount(Protocol):
    """The servo that tilts the camera, such as `mavlink.Link`."""

    @property
    def telemetry(self) -> Telemetry:
        """`camera_tilt` says how far the camera looks up, radians; NaN where that is not known."""

    def tilt_camera(self, up: float) -> float:
        """Point it there, and see it point there; raises where it does not, see `Link`."""


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
        mount: Mount | None = None,
        fineness: int = 1,
        manners: Manners | None = None,
        waits: Callable[[], bool] = lambda: False,
        holds: Callable[[], bool] = lambda: False,
        truth: Callable[[], tuple[SE3, int]] | None = None,
        beams: Callable[[], FloatArray | None] = lambda: None,
        vehicle: Callable[[], Telemetry] | None = None,
        homing_voltage: float = 0.0,
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
            T_base_camera: Where the camera looks at the launch; as the protocol says, unless given.
            mount: Tilts it; None where it stays.
            fineness: Pixels of colour along each side of a pixel of depth and labels.
            manners: When a move counts as done.
            waits: Does the operator want no further move?
            holds: Does the operator want it to stay where it is, now?
            truth: Where the vehicle really is, and how often it has run into something, of a stand-in.
            beams: (n, 3) metres in `base`, where the DVL's beams end now; None where that is not known.
            vehicle: What it says of its battery; None where nobody asks.
            homing_voltage: Volts below which, for `SAG` seconds on end, the mission has to go home.
            threads: What it waits by.
        """
        self._bridge, self._navigator, self._eye = bridge, navigator, eye
        self._perception, self._protocol, self._now, self._threads = perception, protocol, now, threads
        self._frozen = frozen
        self._T_base_camera = T_base_camera or protocol.T_base_camera
        self._mount = mount
        self._fineness = fineness
        self._manners = manners or Manners()
        self._waits, self._holds = waits, holds
        self._truth, self._beams, self._vehicle = truth, beams, vehicle
        self._homing_voltage = homing_voltage
        self._contacts = truth()[1] if truth is not None else 0
        self._arrived = now()
        self._lighting = Lighting()
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
        view = View(camera, T_world_base, self._T_base_camera, altitude, self._beams())
        shows = self._perception.perceive(rgb, view, seen)
        self.accounts.append(shows.account)
        shown = rgb if fine is camera else self._eye.view(picture, fine)[0]
        self._bridge.renew(self._manners.thinking)
        told = Observation(
            time=picture.time,
            rgb=shown,
            depth=shows.depth,
            labels=shows.labels,
            camera=camera,
            T_world_base=T_world_base,
            T_base_camera=self._T_base_camera,
            confidence=shows.confidence,
            error=shows.error,
            **self._battery(),
        )
        told = self._lighting.seen(told)
        return replace(told, trouble="; ".join(filter(None, (told.trouble, self._lighting.trouble))))

    def _battery(self) -> dict[str, Any]:
        """What an observation says of it."""
        if self._vehicle is None:
            return {}
        said, trouble = self._vehicle(), ""
        if said.battery <= LOW_SHARE:
            trouble = f"the battery has {said.battery:.0%} left"
        elif said.sagged < self._homing_voltage:
            trouble = f"the battery is at {said.sagged:.1f} V"
        return {
            "drawn_wh": said.drawn_wh if math.isfinite(said.drawn_wh) else None,
            "trouble": trouble,
        }

    def go_to(self, setpoint: Setpoint) -> Arrival:
        """Tilt the camera, swim there, and come to rest.

        To a height the way is straight, and depth is held by the pressure there. A camera that does not tilt
        is noted, and looked through as it is.

        Raises:
            MissionAborted: The dive is over, or the mount does not say where the camera looks.
        """
        manners, bridge = self._manners, self._bridge
        while self._waits():
            self._check()
            bridge.renew()
            self._threads.sleep(POLL)
        goal = SE2(setpoint.x, setpoint.y, setpoint.yaw)
        notes = self._tilt(setpoint.tilt)
        start = bridge.fix
        deadline = self._now() + self._allowed(start, setpoint)
        bridge.renew()
        bridge.go(goal, setpoint.altitude, setpoint.z)
        way, still_since, last = 0.0, math.nan, start
        holding, stood = False, None
        while True:
            self._threads.sleep(POLL)
            self._check()
            bridge.renew()
            if self._holds() != holding:
                holding = not holding
                if holding:
                    self._stay(setpoint)
                else:
                    bridge.go(goal, setpoint.altitude, setpoint.z)
            if holding:
                deadline += POLL
                continue
            standing, fix = bridge.standing, bridge.fix
            if standing.reason and standing.reason not in notes:
                notes.append(standing.reason)
            pose, now = fix.T_world_base.se2, self._now()
            way, last = way + _between(last, fix, setpoint), fix
            there = (
                standing.stance is not Stance.YIELD
                and pose.distance(goal) <= manners.near
                and abs(wrap_angle(goal.yaw - pose.yaw)) <= manners.aligned
                and not abs(_lacking(fix, setpoint)) > manners.level
                and float(np.linalg.norm(fix.velocity[: 2 if setpoint.z is None else 3])) <= manners.slow
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
                bridge.go(pose, setpoint.altitude, None if setpoint.z is None else _height(fix))
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
        x, y, z = bridge.fix.T_world_base.translation.tolist()
        return Arrival(
            bridge.fix.T_world_base.se2,
            collided=collided,
            distance=way,
            clearance=math.inf,
            note="; ".join(notes),
            sigma=bridge.fix.position_sigma,
            truth=truth,
            contact=(x, y, z) if collided else None,
        )

    def _allowed(self, start: Fix, goal: Setpoint) -> float:
        """Seconds that a move may take."""
        here = start.T_world_base.se2
        length = here.distance(SE2(goal.x, goal.y, goal.yaw))
        if goal.z is not None:
            length = math.hypot(length, _lacking(start, goal))
        return 10.0 * (length + abs(wrap_angle(goal.yaw - here.yaw))) + self._manners.room

    def _stay(self, setpoint: Setpoint) -> None:
        """Hold it where it is: at its altitude, or at its height."""
        fix = self._bridge.fix
        pose, altitude = fix.T_world_base.se2, _height(fix) - fix.seabed
        if setpoint.z is not None:
            self._bridge.go(pose, None, _height(fix))
        else:
            self._bridge.go(pose, altitude if math.isfinite(altitude) else setpoint.altitude)

    def _tilt(self, down: float | None) -> list[str]:
        """Tilt the camera, and take over where it says that it looks; what there is to note of that."""
        if down is None:
            return []
        if self._mount is None:
            raise MissionAborted("camera: expected a mount that tilts it, got none")
        note: list[str] = []
        self._bridge.renew(TILTING)
        try:
            up = self._mount.tilt_camera(-down)
        except (OSError, RuntimeError, ValueError) as error:
            # What it was told it may have done in part.
            up, note = self._mount.telemetry.camera_tilt, [str(error)]
        if not math.isfinite(up):
            raise MissionAborted(f"camera: expected a mount that says where it looks, got: {'; '.join(note)}")
        self._T_base_camera = SE3(camera_mount(-up).rotation, self._T_base_camera.translation)
        return note

    def _check(self) -> None:
        standing = self._bridge.standing
        if standing.stance is Stance.OVER or self._bridge.over:
            raise MissionAborted(f"dive: {self._bridge.over or standing.reason}")


def _height(fix: Fix) -> float:
    """Metres in the world."""
    return float(fix.T_world_base.translation[2])


def _lacking(fix: Fix, goal: Setpoint) -> float:
    """Metres of height that it lacks, upwards. NaN, and so no reason to wait, without a floor to go by."""
    if goal.z is not None:
        return goal.z - _height(fix)
    assert goal.altitude is not None
    return goal.altitude - (_height(fix) - fix.seabed)


def _between(one: Fix, other: Fix, goal: Setpoint) -> float:
    """Metres of way: over ground, or where it goes to a height, through the water."""
    over_ground = one.T_world_base.se2.distance(other.T_world_base.se2)
    return over_ground if goal.z is None else math.hypot(over_ground, _height(other) - _height(one))
