"""What pilots in space share: to take one look after another, by water that is known to be free."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.geometry import wrap_angle
from dream.planning.space.ways import KnownWays, ways_in
from dream.types import BoolArray, Decision, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.mapping.volume import Volume

FloatArray = npt.NDArray[np.floating[Any]]

ADVANCES = 1.0
"""Metres by which a way into known water must come nearer to a look for it to be flown."""
NEARLY = 0.5
"""Metres: of places that are nearly as near the soonest reached is taken."""


@dataclass(frozen=True, slots=True)
class Look:
    """Where to look from, how, and why."""

    position: tuple[float, float, float]
    """x, y and z, metres in the world."""
    bearing: float | None
    """Radians, a heading step to either side will do; None where any will."""
    tilt: float
    """Pitch of the camera, downwards."""
    why: str
    """A sentence."""
    within: float = 1.0
    """Metres from the position that will do."""
    is_moot: Callable[[], bool] | None = None
    """Whether it need no longer be taken, asked at every step; it always must where None."""


@dataclass(slots=True)
class Patrol:
    """A pilot that takes looks in turn, and is done after the last.

    Where no known way leads to a look, it goes as near to it as one leads, and sees from there. A look is
    left out where that brings it no nearer, or when it took more than twice the steps that it had at first.
    """

    mission: Mission
    looks: Callable[[Patrol], Iterator[Look]]
    """Given the patrol, of which it reads what is known; the next one is asked for when one was taken."""
    observation: Observation = field(init=False)
    """The latest."""
    volume: Volume = field(init=False)
    """What is known."""
    ways: KnownWays = field(init=False)
    """Through it."""
    _ahead: Iterator[Look] | None = None
    _look: Look | None = None
    _budget: int = 0
    """Steps that the look may still take; 0 until it is headed for."""

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """The next step to a look, or done."""
        assert occupancy.volume is not None
        self.observation, self.volume = observation, occupancy.volume
        self.ways = ways_in(occupancy.volume, self.mission.bounds, self.mission.protocol)
        if self._ahead is None:
            self._ahead = self.looks(self)
        while True:
            if self._look is not None and not (self._look.is_moot and self._look.is_moot()):
                step = self._step(self._look)
                if step is not None:
                    return replace(step, reasoning=Reasoning(action=self._look.why))
            self._look, self._budget = next(self._ahead, None), 0
            if self._look is None:
                return Decision(done=True, reasoning=Reasoning(action="The pattern is flown to its end."))

    def _step(self, look: Look) -> Decision | None:
        """The next step to a look; None where it was taken, or is left out."""
        protocol, pose, ways = self.mission.protocol, self.observation.pose, self.ways
        away = np.linalg.norm(ways.positions - np.array(look.position), axis=-1)
        path = ways.to(pose, self.observation.z, away <= look.within, facing(look.bearing, ways))
        if path is None:
            path = self._nearer(look, away)
            if not path:
                return None
        tilt = look.tilt if len(path) <= 1 else protocol.camera_pitch
        tilt = min(protocol.tilts, key=lambda allowed: abs(allowed - tilt))
        tilted = tilt if abs(tilt - self.observation.tilt) >= 0.5 * _least_step(protocol.tilts) else None
        if not path and tilted is None:
            return None
        if self._budget == 0:
            self._budget = 2 * len(path) + 4
        self._budget -= 1
        if self._budget == 0:
            return None
        return replace(path[0] if path else Decision(), tilt=tilted)

    def _nearer(self, look: Look, away: FloatArray) -> list[Decision] | None:
        """The way to where known water comes nearest to a look, if that is nearer than here; facing it."""
        pose, z, ways = self.observation.pose, self.observation.z, self.ways
        reached = (ways.steps(pose, z) >= 0).any(axis=-1)
        nearest = float(away[reached].min())
        if nearest > float(away[ways.node(pose.x, pose.y, z)]) - ADVANCES:
            return None
        bearing = np.arctan2(look.position[1] - pose.y, look.position[0] - pose.x)
        return ways.to(pose, z, reached & (away <= nearest + NEARLY), facing(float(bearing), ways))


def facing(bearing: float | None, ways: KnownWays) -> BoolArray:
    """(headings,) those within a heading step of a bearing; all where it is None."""
    step, count = ways.protocol.heading_step, ways.protocol.headings
    if bearing is None:
        return np.ones(count, np.bool_)
    return np.array([abs(wrap_angle(k * step - bearing)) <= step + 1e-9 for k in range(count)])


def _least_step(tilts: tuple[float, ...]) -> float:
    """Between neighbouring tilts."""
    return min((b - a for a, b in zip(sorted(tilts), sorted(tilts)[1:], strict=False)), default=np.pi)
