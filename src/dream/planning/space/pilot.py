"""What pilots in space share: to go where they want by known water, and to find something to go to."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.geometry import wrap_angle
from dream.planning.space.ways import Ways, ways_in
from dream.types import Decision, Mission, Observation

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

FloatArray = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class Look:
    """Where to look from, and how."""

    position: tuple[float, float, float]
    """x, y and z, metres in the world."""
    bearing: float | None
    """Radians; None where any will do."""
    tilt: float
    """Pitch of the camera, downwards."""
    within: float = 1.0
    """Metres from the position that will do."""


@dataclass(slots=True)
class Going:
    """Leads a vehicle to where it wants to look from, step by step over what is known."""

    mission: Mission
    look: Look | None = None
    budget: int = 0
    """Steps that the look may still take."""
    travel_tilt: float = field(init=False)
    """Of the camera on the way: what shows the water ahead of the body."""

    def __post_init__(self) -> None:
        self.travel_tilt = self.mission.protocol.camera_pitch

    def towards(self, look: Look, observation: Observation, ways: Ways) -> Decision | None:
        """The next step to a look; None where it was taken, no known way leads there, or it took too long.

        The last step turns to the bearing and tilts the camera: the frame after it is the look.
        """
        pose, z, protocol = observation.pose, observation.z, self.mission.protocol
        if look != self.look:
            self.look, self.budget = look, 0
        away = np.linalg.norm(ways.positions - np.array(look.position), axis=-1)
        here = float(away[ways.node(pose.x, pose.y, z)])
        if here <= look.within:
            return self._turned(look, observation)
        goal = (away <= look.within) & (ways.stands > 0)
        path = ways.to(pose, z, goal) if goal.any() else []
        if not path:
            return None
        if self.budget == 0:
            self.budget = 2 * len(path) + 4
        self.budget -= 1
        if self.budget == 0:
            return None
        step = path[0]
        tilt = self.travel_tilt
        if len(path) == 1 and (look.bearing is None or self._faces(look.bearing, pose.yaw + step.turn)):
            tilt = look.tilt
        return replace(
            step, tilt=None if abs(tilt - observation.tilt) < 0.1 else _nearest(tilt, protocol.tilts)
        )

    def _faces(self, bearing: float, yaw: float) -> bool:
        return abs(wrap_angle(bearing - yaw)) <= 0.5 * self.mission.protocol.heading_step + 1e-6

    def _turned(self, look: Look, observation: Observation) -> Decision | None:
        protocol, pose = self.mission.protocol, observation.pose
        turn = 0.0
        if look.bearing is not None and not self._faces(look.bearing, pose.yaw):
            wanted = wrap_angle(look.bearing - pose.yaw)
            turn = min(protocol.turn_angles, key=lambda allowed: abs(wrap_angle(wanted - allowed)))
        tilt = _nearest(look.tilt, protocol.tilts)
        tilted = abs(tilt - observation.tilt) >= 0.1
        if turn == 0.0 and not tilted:
            return None
        return Decision(turn, tilt=tilt if tilted else None)


def _nearest(value: float, allowed: tuple[float, ...]) -> float:
    return min(allowed, key=lambda one: abs(one - value))


def ways_now(mission: Mission, occupancy: OccupancyMap) -> Ways:
    """The ways through what is known now."""
    assert occupancy.volume is not None
    volume = occupancy.volume
    return occupancy.answer("ways", lambda: ways_in(volume, mission.bounds, mission.protocol))
