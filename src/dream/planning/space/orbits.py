"""Round what stands up, higher and higher: what pilots of remote vehicles do."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from dream.mapping.structures import Structure, structures
from dream.options import First
from dream.planning.parameters import check_range
from dream.planning.space.looks import shown
from dream.planning.space.pilot import FloatArray, Look, Patrol
from dream.planning.space.routes import crossing, highest, searched
from dream.types import Mission

SAME = 2.0
"""Metres: a structure was flown around where half of its columns lie this near to those of one that was."""
WORTH = 0.05
"""Share of the target surface in view that must be left to inspect for a look to be taken."""


@dataclass(frozen=True, slots=True)
class Orbits:
    """Fly around whatever stands up, at rising altitudes, looking at it; then look for more.

    What it does: lanes over the area, high enough to see far, until target surface that stands up is known.
    Then once around it at each altitude, on the line that keeps a standoff from all of it that is known so
    far, with a look at it every few metres; at last along its middle from above. A look that would show
    nothing that is left to inspect is left out. When nothing is left to go around the lanes go on, over
    ground that nothing returned from yet; when they end it is done.

    Reference: the orbits at rising altitudes that pilots of inspection vehicles fly around structures.

    Assumes: something stands up. Fails when: a structure has arms closer than twice the standoff, or hides
    its own sides from its outline.
    """

    spatial: ClassVar[bool] = True
    planar: ClassVar[bool] = False

    standoff: First[float] = 3.5
    """Metres from the outline."""
    spacing: First[float] = 5.0
    """Metres along the line between looks."""
    lowest: First[float] = 1.5
    """Metres above the ground of the first orbit."""
    rise: First[float] = 2.0
    """Metres between one orbit and the next."""
    search: float = 3.0
    """Metres above the ground of the lanes."""
    swath: float = 16.0
    """Metres between the lanes."""

    def __post_init__(self) -> None:
        check_range("standoff", self.standoff, 1.0, 20.0)
        check_range("spacing", self.spacing, 1.0, 50.0)
        check_range("lowest", self.lowest, 0.5, 20.0)
        check_range("rise", self.rise, 0.5, 20.0)
        check_range("search", self.search, 1.0, 20.0)
        check_range("swath", self.swath, 1.0, 100.0)

    def begin(self, mission: Mission) -> Patrol:
        """A fresh pilot."""
        return Patrol(mission, lambda patrol: _Round(self, patrol).looks())


@dataclass(slots=True)
class _Round:
    """One mission's looks, each chosen by what is known when the one before was taken."""

    planner: Orbits
    patrol: Patrol
    flown: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    """(n, 2) columns of structures that were flown around."""

    def looks(self) -> Iterator[Look]:
        """The lanes, and the way around each structure as soon as it is known."""
        planner, patrol = self.planner, self.patrol
        start = patrol.observation
        z = highest(patrol.mission, start.z - patrol.mission.protocol.altitude + planner.search)
        lanes = crossing(patrol.mission, start.pose, planner.swath)
        at = 0
        while True:
            one = self._unknown_before()
            if one is not None:
                yield from self._around(one)
            elif at == len(lanes):
                return
            elif searched(patrol.volume, lanes[at]):
                at += 1
            else:
                x, y = lanes[at].tolist()
                tilt = patrol.mission.protocol.camera_pitch
                why = f"Along the lanes to ({x:.1f}, {y:.1f}), for something that stands up."
                yield Look((x, y, z), None, tilt, why, 2.0, lambda: self._unknown_before() is not None)
                at += self._unknown_before() is None

    def _unknown_before(self) -> Structure | None:
        """The largest structure that was not flown around."""
        from scipy.spatial import cKDTree

        flown = cKDTree(self.flown) if len(self.flown) else None
        for one in structures(self.patrol.volume):
            columns = one.columns
            apart = np.full(len(columns), np.inf) if flown is None else np.asarray(flown.query(columns)[0])
            if (apart > SAME).mean() > 0.5:
                return one
        return None

    def _as_known(self, one: Structure) -> Structure:
        """The same structure, as it is known by now."""
        known = structures(self.patrol.volume)
        return min(known, key=lambda other: float(np.hypot(*(other.middle - one.middle))), default=one)

    def _around(self, one: Structure) -> Iterator[Look]:
        planner, level = self.planner, 0
        while level == 0 or one.ground + planner.lowest + (level - 1) * planner.rise < one.top:
            one = yield from self._orbit(one, level)
            level += 1
        yield from self._above(one)
        self.flown = np.concatenate([self.flown, self._as_known(one).columns])

    def _orbit(self, one: Structure, level: int) -> Generator[Look, None, Structure]:
        """Once around; returns the structure as it is known then."""
        planner, patrol = self.planner, self.patrol
        flown, before = 0.0, None
        while True:
            one = self._as_known(one)
            ring = one.ring(planner.standoff)
            if not len(ring):
                return one
            along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ring[:, :2], axis=0).T))])
            if flown >= along[-1]:
                return one
            pose = patrol.observation.pose
            here = (pose.x, pose.y) if before is None else before
            start = along[int(np.argmin(np.hypot(*(ring[:, :2] - here).T)))]
            wanted = start if before is None else (start + planner.spacing) % along[-1]
            flown += 0.0 if before is None else planner.spacing
            x, y, bearing = ring[int(np.searchsorted(along, wanted))].tolist()
            before = x, y
            z = highest(patrol.mission, one.ground + planner.lowest + level * planner.rise)
            tilt = math.atan2(z - 0.5 * (one.ground + min(one.top, z)), planner.standoff)
            if not self._is_worth((x, y, z), bearing, tilt):
                continue
            east, north = one.middle
            yield Look(
                (x, y, z),
                bearing,
                tilt,
                f"Orbit {level + 1} around the structure at ({east:.0f}, {north:.0f}), "
                f"{z - one.ground:.1f} m above its ground: a look from ({x:.1f}, {y:.1f}), "
                f"{flown:.0f} of {along[-1]:.0f} m flown.",
            )

    def _above(self, one: Structure) -> Iterator[Look]:
        """Along its longest axis, looking ahead and down, from the end that is nearer."""
        pose, columns = self.patrol.observation.pose, one.columns
        _, _, axes = np.linalg.svd(columns - one.middle, full_matrices=False)
        axis = axes[0] if axes[0] @ (one.middle - (pose.x, pose.y)) >= 0.0 else -axes[0]
        along = (columns - one.middle) @ axis
        z = highest(self.patrol.mission, one.top + self.planner.rise)
        # What the camera shows lies ahead of it, about as far as it is high.
        ends = along.min() - self.planner.rise, along.max() - self.planner.rise
        places = np.linspace(*ends, max(2, math.ceil((ends[1] - ends[0]) / self.planner.spacing) + 1))
        bearing, tilt = math.atan2(axis[1], axis[0]), max(self.patrol.mission.protocol.tilts)
        for n, place in enumerate(places):
            x, y = (one.middle + place * axis).tolist()
            if self._is_worth((x, y, z), bearing, tilt):
                over = f"{z - one.top:.1f} m over its top"
                why = f"Along the structure from above, {over}: look {n + 1} of {len(places)}."
                yield Look((x, y, z), bearing, tilt, why, within=1.5)

    def _is_worth(self, position: tuple[float, float, float], bearing: float, tilt: float) -> bool:
        """Is any target surface in view still to be inspected, or none known?"""
        surface = self.patrol.volume.surface()
        view = shown(self.patrol.ways, position, bearing, tilt, surface.middles, surface.normals)
        view &= surface.target > 0.5
        left = float(surface.area[view & (surface.sides == 0)].sum())
        return left >= WORTH * float(surface.area[view].sum())
