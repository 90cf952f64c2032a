"""Round what stands up, higher and higher: what pilots of remote vehicles do."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from dream.geometry import SE2
from dream.options import First
from dream.planning.baselines.lanes import Points, across, densified, lanes, mirrored, shortest
from dream.planning.parameters import check_range
from dream.planning.space.pilot import Going, Look, ways_now
from dream.planning.space.structures import Structure, structures
from dream.types import Decision, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

MATCHED = 4.0
"""Metres between the middles of a structure then and now."""


@dataclass(frozen=True, slots=True)
class Orbits:
    """Fly around whatever stands up, at rising altitudes, looking at it; then look for more.

    What it does: lanes over the area, high enough to see far, until target surface that stands up is known.
    Then once around it at each altitude, on the line that keeps a standoff from all of it that is known so
    far, with a look at it every few metres; at last along its middle from above. When nothing is left to go
    around the lanes go on, and when they end it is done.

    Reference: the orbits at rising altitudes that pilots of inspection vehicles fly around structures.

    Assumes: something stands up. Fails when: a structure has arms closer than twice the standoff, or hides
    its own sides from its outline.
    """

    standoff: First[float] = 3.5
    """Metres from the outline."""
    spacing: First[float] = 5.0
    """Metres along the line between looks."""
    lowest: First[float] = 1.5
    """Metres above the ground of the first orbit."""
    rise: First[float] = 2.5
    """Metres between one orbit and the next."""
    search: float = 3.0
    """Metres above the ground of the lanes."""
    swath: float = 14.0
    """Metres between the lanes."""

    def __post_init__(self) -> None:
        check_range("standoff", self.standoff, 1.0, 20.0)
        check_range("spacing", self.spacing, 1.0, 50.0)
        check_range("lowest", self.lowest, 0.5, 20.0)
        check_range("rise", self.rise, 0.5, 20.0)
        check_range("search", self.search, 1.0, 20.0)
        check_range("swath", self.swath, 1.0, 100.0)

    def begin(self, mission: Mission) -> OrbitsPilot:
        """A fresh pilot; a ValueError under a planar protocol."""
        if mission.protocol.space is None:
            raise ValueError(
                f"orbits: expected a protocol that moves in space, such as dream-v2-draft, "
                f"got {mission.protocol.name}"
            )
        return OrbitsPilot(self, mission)


@dataclass(slots=True)
class Round:
    """One structure that is flown around."""

    middle: tuple[float, float]
    level: int = 0
    """Which orbit, from the lowest; past the last, its middle is flown along."""
    flown: float = 0.0
    """Metres along the line since the orbit began."""
    at: tuple[float, float] | None = None
    """Where the last look was meant to be from."""


@dataclass(slots=True)
class OrbitsPilot:
    """One mission."""

    planner: Orbits
    mission: Mission
    going: Going = field(init=False)
    waypoints: Points | None = None
    """(n, 2) of the lanes, those ahead."""
    current: Round | None = None
    finished: list[tuple[float, float]] = field(default_factory=list)
    """Middles of structures that were flown around."""
    over: list[Look] = field(default_factory=list)
    """Looks from above that are left."""
    cruise: float = math.nan
    """World z of the lanes."""

    def __post_init__(self) -> None:
        self.going = Going(self.mission)

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """The next step of an orbit, or of the lanes."""
        ways = ways_now(self.mission, occupancy)
        assert occupancy.volume is not None
        known = structures(occupancy.volume)
        for _ in range(200):
            if self.current is None:
                self._choose(known)
            found = self._round(known, observation) if self.current else self._lanes(observation, occupancy)
            if found is None:
                if self.current is None:
                    return Decision(
                        done=True,
                        reasoning=Reasoning(action="Nothing is left to fly around, nor to look for."),
                    )
                continue
            look, why = found
            step = self.going.towards(look, observation, ways)
            if step is not None:
                return replace(step, reasoning=Reasoning(action=why))
            self._passed(look)
        return Decision(done=True, reasoning=Reasoning(action="No known way leads on."))

    # ------------------------------------------------------------------------------------------------------

    def _choose(self, known: list[Structure]) -> None:
        for one in known:
            if all(math.dist(one.middle, middle) > MATCHED for middle in self.finished):
                self.current = Round(one.middle)
                return

    def _round(self, known: list[Structure], observation: Observation) -> tuple[Look, str] | None:
        """The next look at the structure; None, and no current one, where all were taken."""
        assert self.current is not None
        now, planner = self.current, self.planner
        one = min(known, key=lambda other: math.dist(other.middle, now.middle), default=None)
        if one is None:
            self.current = None
            return None
        now.middle = one.middle
        height = one.ground + planner.lowest + now.level * planner.rise
        if height > one.top + planner.rise and now.level > 0:
            return self._from_above(one, now)
        ring = one.ring(planner.standoff)
        if not len(ring):
            self.current = None
            self.finished.append(one.middle)
            return None
        here = (observation.pose.x, observation.pose.y) if now.at is None else now.at
        lengths = np.hypot(*np.diff(ring[:, :2], axis=0).T)
        total = float(lengths.sum())
        if now.flown >= total:
            now.level, now.flown = now.level + 1, 0.0
            return self._round(known, observation)
        start = int(np.argmin(np.hypot(*(ring[:, :2] - here).T)))
        along = np.concatenate([[0.0], np.cumsum(lengths)])
        wanted = (along[start] + (planner.spacing if now.at is not None else 0.0)) % total
        x, y, bearing = ring[int(np.searchsorted(along, wanted)) % len(ring)].tolist()
        surface = self.mission.protocol.space
        assert surface is not None
        z = min(height, -surface.surface)
        aim = 0.5 * (one.ground + min(one.top, height))
        tilt = math.atan2(z - aim, planner.standoff)
        words = (
            f"Orbit {now.level + 1} around the structure at ({one.middle[0]:.0f}, {one.middle[1]:.0f}), "
            f"{z - one.ground:.1f} m above its ground: a look from ({x:.1f}, {y:.1f}), {now.flown:.0f} of "
            f"{total:.0f} m flown."
        )
        return Look((x, y, z), bearing, tilt), words

    def _from_above(self, one: Structure, now: Round) -> tuple[Look, str] | None:
        """Along its middle, above its top."""
        if now.flown >= 0.0:
            now.flown = -1.0
            self.over = self._line_above(one)
        if not self.over:
            self.current = None
            self.finished.append(one.middle)
            return None
        return self.over[0], f"Along the structure from above: {len(self.over)} looks are left."

    def _line_above(self, one: Structure) -> list[Look]:
        rows, cols = np.nonzero(one.mask)
        points = np.column_stack([one.west + (cols + 0.5) * 0.5, one.south + (rows + 0.5) * 0.5])
        middle = points.mean(axis=0)
        _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
        along = (points - middle) @ axes[0]
        space = self.mission.protocol.space
        assert space is not None
        z = min(one.top + self.planner.rise, -space.surface)
        count = max(1, math.ceil(float(np.ptp(along)) / self.planner.spacing))
        places = along.min() + (np.arange(count) + 0.5) * np.ptp(along) / count
        bearing = math.atan2(axes[0][1], axes[0][0])
        down = max(self.mission.protocol.tilts)
        return [
            Look((*(middle + place * axes[0]).tolist(), z), bearing, down, within=1.5) for place in places
        ]

    def _lanes(self, observation: Observation, occupancy: OccupancyMap) -> tuple[Look, str] | None:
        if self.waypoints is None:
            self.waypoints = self._laid(observation.pose)
            space = self.mission.protocol.space
            assert space is not None
            rise = self.planner.search - self.mission.protocol.altitude
            self.cruise = min(observation.z + rise, -space.surface)
        if not len(self.waypoints):
            return None
        x, y = self.waypoints[0].tolist()
        z = self.cruise
        return Look(
            (x, y, z), None, self.going.travel_tilt, within=2.0
        ), f"Along the lanes to ({x:.1f}, {y:.1f})."

    def _laid(self, pose: SE2) -> Points:
        box, planner = self.mission.to_see, self.planner
        inset = 0.5 * self.mission.protocol.reach
        upright = mirrored(lanes(box, planner.swath, inset), box)
        level = [r[:, ::-1] for r in mirrored(lanes(across(box), planner.swath, inset), across(box))]
        return densified(shortest([*upright, *level], pose), 4.0)

    def _passed(self, look: Look) -> None:
        """A look was taken, or cannot be."""
        if self.current is None:
            assert self.waypoints is not None
            self.waypoints = self.waypoints[1:]
        elif self.over:
            self.over.pop(0)
        else:
            if self.current.at is not None:
                self.current.flown += self.planner.spacing
            self.current.at = look.position[:2]
