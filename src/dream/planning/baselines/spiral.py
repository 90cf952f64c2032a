"""A square spiral over the whole survey area."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dream.geometry import SE2
from dream.options import First
from dream.planning.baselines.lanes import Points, across, mirrored, seen_to_both_sides, shortest, spiral
from dream.planning.baselines.remains import Remains, group_cells
from dream.planning.baselines.sweeping import Sweeping
from dream.planning.parameters import check_range
from dream.planning.space.over_ground import OverGround, in_plane_or_over_ground
from dream.types import Mission


@dataclass(frozen=True, slots=True)
class Spiral:
    """Sweep the area in a square spiral, blind to what is seen, until no ground is left.

    What it does: a spiral whose turns are as far apart as the camera sees to both sides, evenly spread over
    the area, flown outwards or inwards and either way round, whichever is the shortest from the start. It
    goes round obstacles and comes back for missed ground as the lawnmower does. If that is not enough, it
    goes over the area again the other way, inwards after outwards.

    Reference: the square spiral of search and coverage (survey: Choset 2001); its spacing is the lawnmower's.

    Assumes: the area is a box. Fails when: targets fill a small part of the area, far from where it begins.
    """

    spatial: ClassVar[bool] = True

    swath: First[float] = 0.81
    """Distance between turns of the spiral at most, as a share of the width of ground in the picture."""
    least: float = 0.25
    """A waypoint is flown to if it shows this much new ground: share of the area of the smallest patch."""

    def __post_init__(self) -> None:
        check_range("swath", self.swath, 0.1, 4.0)
        check_range("least", self.least, 0.0, 100.0)

    def begin(self, mission: Mission) -> Sweeping | OverGround:
        """A fresh survey; the spiral is laid when the start is known.

        Under a protocol that moves in space it searches the ground: see `OverGround`.
        """
        return in_plane_or_over_ground(mission, self.in_plane)

    def in_plane(self, mission: Mission) -> Sweeping:
        """A pilot that keeps its altitude, under whatever protocol."""
        return Sweeping(self.route, Remains(mission, max(1.0, self.least * group_cells(mission.protocol))))

    def route(self, mission: Mission, start: SE2, sweep: int) -> Points:
        """(n, 2) corners of the shortest spiral; see `Layout`. Odd sweeps go the other way."""
        box, spacing = mission.to_see, self.swath * seen_to_both_sides(mission.protocol)
        upright = mirrored(spiral(box, spacing), box)
        level = [route[:, ::-1] for route in mirrored(spiral(across(box), spacing), across(box))]
        inwards = [*upright, *level]
        inward = shortest(inwards, start)
        outward = shortest([route[::-1] for route in inwards], start)
        first = shortest([outward, inward], start)
        return first if sweep % 2 == 0 else (inward if first is outward else outward)
