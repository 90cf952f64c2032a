"""Lanes over the whole area at two altitudes: what pilots do who survey an area with things that stand up."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from dream.options import First
from dream.planning.parameters import check_range
from dream.planning.space.pilot import Look, Patrol
from dream.planning.space.routes import along, highest, top
from dream.types import Mission


@dataclass(frozen=True, slots=True)
class Tiers:
    """Fly lanes over the area low over ground, then lanes across them high, looking down.

    What it does: the lower lanes with the camera as it is at the start, the upper ones with the steepest
    tilt. Both keep their altitude over what is known to lie below, ground or structure, and so lead over what
    stands up where it is low enough, else around it. It is done when both are flown.

    Reference: boustrophedon coverage (Choset & Pignon 1998), flown twice as pilots of inspection vehicles do.

    Assumes: the area is a box. Fails when: sides lean over, or face away from all lanes; targets fill a small
    part of the area, since it sees them no sooner than the rest.
    """

    spatial: ClassVar[bool] = True
    planar: ClassVar[bool] = False

    low: First[float] = 2.0
    """Metres above what lies below of the first lanes."""
    high: First[float] = 4.5
    """Metres above what lies below of the second lanes."""
    swath: First[float] = 9.0
    """Metres between the lanes at most."""

    def __post_init__(self) -> None:
        check_range("low", self.low, 0.8, 20.0)
        check_range("high", self.high, 0.8, 20.0)
        check_range("swath", self.swath, 1.0, 100.0)

    def begin(self, mission: Mission) -> Patrol:
        """A fresh pilot."""
        return Patrol(mission, self.looks)

    def looks(self, patrol: Patrol) -> Iterator[Look]:
        """Along the lower lanes, then along the upper ones."""
        mission = patrol.mission
        ground = patrol.observation.z - mission.protocol.altitude
        start = patrol.observation.pose
        tiers = ((self.low, mission.protocol.camera_pitch), (self.high, max(mission.protocol.tilts)))
        for number, (altitude, tilt) in enumerate(tiers):
            places = along(mission, start, self.swath, turned=number == 1)
            for n, place in enumerate(places):
                # Where nothing is known yet it lies as high as at the place before.
                ground = top(patrol.volume, place, ground)
                x, y = place.tolist()
                why = (
                    f"Along the {'upper' if number else 'lower'} lanes, {altitude:g} m above what lies "
                    f"below, to ({x:.1f}, {y:.1f}): place {n + 1} of {len(places)}."
                )
                yield Look((x, y, highest(mission, ground + altitude)), None, tilt, why, within=1.5)
            start = patrol.observation.pose
