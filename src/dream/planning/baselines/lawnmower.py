"""Parallel lanes over the whole survey area."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dream.geometry import SE2
from dream.options import First
from dream.planning.baselines.lanes import Points, across, lanes, mirrored, seen_to_both_sides, shortest
from dream.planning.baselines.remains import Remains, group_cells
from dream.planning.baselines.sweeping import Sweeping
from dream.planning.parameters import check_range
from dream.planning.space.over_ground import OverGround, in_plane_or_over_ground
from dream.types import Mission


@dataclass(frozen=True, slots=True)
class Lawnmower:
    """Sweep the area in parallel lanes, blind to what is seen, until no ground is left.

    What it does: lanes no farther apart than the camera sees to both sides, evenly spread over the area; of
    the two directions and four corners to begin at, those of the shortest way. It goes round obstacles and
    leaves out waypoints that would show nothing new. After the lanes it looks at what they missed, nearest
    first: ground where a group could hide, and, where its `done` is refused, all ground until the map is
    complete. If that is not enough, it goes over the area again with the lanes across.

    Reference: boustrophedon coverage (Choset & Pignon 1998).

    Assumes: the area is a box. Fails when: targets fill a small part of the area; it sees them no sooner than
    the rest.
    """

    spatial: ClassVar[bool] = True

    # With this, views 2 m apart leave no gap.
    swath: First[float] = 0.81
    """Distance between lanes at most, as a share of the width of ground in the picture."""
    inset: First[float] = 0.5
    """Distance from the ends of the lanes to the edge of the area, as a share of the reach."""
    least: float = 0.25
    """A waypoint is flown to if it shows this much new ground: share of the area of the smallest patch."""

    def __post_init__(self) -> None:
        check_range("swath", self.swath, 0.1, 4.0)
        check_range("inset", self.inset, 0.1, 4.0)
        check_range("least", self.least, 0.0, 100.0)

    def begin(self, mission: Mission) -> Sweeping | OverGround:
        """A fresh survey; the lanes are laid when the start is known.

        Under a protocol that moves in space it searches the ground: see `OverGround`.
        """
        return in_plane_or_over_ground(mission, self.in_plane)

    def in_plane(self, mission: Mission) -> Sweeping:
        """A pilot that keeps its altitude, under whatever protocol."""
        return Sweeping(self.route, Remains(mission, max(1.0, self.least * group_cells(mission.protocol))))

    def route(self, mission: Mission, start: SE2, sweep: int) -> Points:
        """(n, 2) corners of the shortest way over the lanes; see `Layout`. Odd sweeps go across even ones."""
        protocol, box = mission.protocol, mission.to_see
        spacing, inset = self.swath * seen_to_both_sides(protocol), self.inset * protocol.reach
        upright = shortest(mirrored(lanes(box, spacing, inset), box), start)
        level = shortest(
            [route[:, ::-1] for route in mirrored(lanes(across(box), spacing, inset), across(box))], start
        )
        first = shortest([upright, level], start)
        return first if sweep % 2 == 0 else (level if first is upright else upright)
