"""The next best view: where most new ground is seen for the way there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from dream.options import First
from dream.planning.baselines.remains import Remains, group_cells
from dream.planning.parameters import check_range
from dream.planning.space.over_ground import OverGround, in_plane_or_over_ground
from dream.planning.travel import Travel, careful_travel
from dream.planning.viewpoints import Viewpoint, viewpoints_from
from dream.types import Decision, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap


@dataclass(frozen=True, slots=True)
class NextBestView:
    """Go where a view of the unknown is largest for its cost, blind to what is seen.

    What it does: scores every view near by with gain · exp(−cost · steps), the gain being the unknown ground
    that it would show, all of it worth the same; makes the first move to the best and scores again. Where
    nothing near by gains, it goes to the nearest view that does. It is done when no view gains; where that
    is refused, smaller gains count too.

    Reference: receding-horizon next-best-view planning (Bircher et al. 2016), on a lattice instead of a
    random tree, with the global fallback of AEP (Selin et al. 2019).

    Assumes: nothing. Fails when: targets fill a small part of the area; scraps of unknown ground are left
    behind and must be come back for.
    """

    spatial: ClassVar[bool] = True

    cost: First[float] = 0.25
    """Loss of worth for each step to a view: a view n steps away is worth its gain · exp(−cost · n)."""
    near: int = 12
    """Views at most this many steps away are compared."""
    least: float = 1.0
    """A view counts if it shows this much unknown ground: share of the area of the smallest patch."""

    def __post_init__(self) -> None:
        check_range("cost", self.cost, 0.0, 10.0)
        check_range("near", self.near, 1, 1000)
        check_range("least", self.least, 0.0, 100.0)

    def begin(self, mission: Mission) -> _NextBestViewPilot | OverGround:
        """A fresh pilot; it remembers the view it is heading for and which views failed.

        Under a protocol that moves in space it searches the ground: see `OverGround`.
        """
        return in_plane_or_over_ground(mission, self.in_plane)

    def in_plane(self, mission: Mission) -> _NextBestViewPilot:
        """A pilot that keeps its altitude, under whatever protocol."""
        return _NextBestViewPilot(
            self, Remains(mission, max(1.0, self.least * group_cells(mission.protocol)))
        )


@dataclass(slots=True)
class _NextBestViewPilot:
    planner: NextBestView
    remains: Remains

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        pose = observation.pose
        self.remains.look(pose, occupancy)
        travel = careful_travel(pose, occupancy)
        going = self.remains.go(pose, travel, occupancy, lambda way: self._best(way, occupancy))
        if going is None:
            return self.remains.done("No view gains anything that is worth the way.")
        view, decision = going
        x, y = travel.lattice.position(view.pose)
        action = (
            f"To the next best view, of {view.gain:.0f} unknown cells from ({x:.1f}, {y:.1f}), "
            f"{view.steps} steps away."
        )
        return replace(decision, reasoning=Reasoning(action=action))

    def _best(self, travel: Travel, occupancy: OccupancyMap) -> Viewpoint | None:
        """The view that is gone for; None where no view gains."""
        remains = self.remains
        worth = remains.worth_looking(occupancy).astype(np.float32)
        views = viewpoints_from(travel, occupancy, worth, keep=remains.goal)
        near = (views.steps <= self.planner.near) & (views.gains >= remains.least)
        scores = np.log(np.maximum(views.gains, 1.0)) - self.planner.cost * views.steps
        return views.best(np.where(near, scores, -np.inf)) or views.nearest(remains.least)
