"""To the nearest edge of the known, again and again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from dream.options import First
from dream.planning.baselines.remains import Remains
from dream.planning.parameters import check_range
from dream.planning.space.over_ground import OverGround, in_plane_or_over_ground
from dream.planning.travel import Travel, careful_travel
from dream.planning.viewpoints import FloatArray, Viewpoint, viewpoints_from
from dream.types import BoolArray, Decision, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap


@dataclass(frozen=True, slots=True)
class NearestFrontier:
    """Go to the nearest frontier and look beyond it, until none is left.

    What it does: clusters the free cells beside unknown ones; of all poses near a cluster that face its
    unknown side it goes to the one of fewest steps, and keeps to it until nothing is left to see there.
    Clusters that no reachable pose faces are left out, and so is unknown ground that stayed unknown after
    it was looked at, until the map beside it changes. It is done when no frontier is left; where that is
    refused, small ones count too.

    Reference: frontier-based exploration (Yamauchi 1997).

    Assumes: nothing. Fails when: time matters; near frontiers are small, and large ones are left for later.
    """

    spatial: ClassVar[bool] = True

    approach: First[float] = 0.5
    """Distance at most from the edge of the known ground to the pose that looks beyond it, as a share of the
    reach."""
    smallest: float = 0.3
    """Length of the shortest edge that is looked beyond, as a share of the reach."""

    def __post_init__(self) -> None:
        check_range("approach", self.approach, 0.05, 1.0)
        check_range("smallest", self.smallest, 0.0, 10.0)

    def begin(self, mission: Mission) -> _FrontierPilot | OverGround:
        """A fresh pilot; it remembers where it is going and which views failed.

        Under a protocol that moves in space it searches the ground: see `OverGround`.
        """
        return in_plane_or_over_ground(mission, self.in_plane)

    def in_plane(self, mission: Mission) -> _FrontierPilot:
        """A pilot that keeps its altitude, under whatever protocol."""
        protocol = mission.protocol
        return _FrontierPilot(
            self, Remains(mission, max(1.0, self.smallest * protocol.reach / protocol.cell))
        )


@dataclass(slots=True)
class _FrontierPilot:
    planner: NearestFrontier
    remains: Remains

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        pose = observation.pose
        self.remains.look(pose, occupancy)
        travel = careful_travel(pose, occupancy)
        going = self.remains.go(pose, travel, occupancy, lambda way: self._nearest(way, occupancy))
        if going is None:
            return self.remains.done("No frontier is left that can be seen.")
        view, decision = going
        x, y = travel.lattice.position(view.pose)
        action = (
            f"To the nearest frontier, to look beyond {view.gain:.0f} cells of it from ({x:.1f}, {y:.1f}), "
            f"{view.steps} steps away."
        )
        return replace(decision, reasoning=Reasoning(action=action))

    def _nearest(self, travel: Travel, occupancy: OccupancyMap) -> Viewpoint | None:
        """The view that is gone for; None where no frontier can be seen."""
        remains = self.remains
        near, beyond = self._frontiers(occupancy)
        views = viewpoints_from(travel, occupancy, beyond, keep=remains.goal)
        views = views.only(near[occupancy.cell_of(*views.positions.T)])
        kept = None if remains.goal is None else views.at(remains.goal)
        return kept if kept is not None and kept.gain >= remains.least else views.nearest(remains.least)

    def _frontiers(self, occupancy: OccupancyMap) -> tuple[BoolArray, FloatArray]:
        """(rows, cols) what is near a cluster, and 1 in the unknown cells beside one that are worth it."""
        from scipy.ndimage import binary_dilation

        from dream.mapping import frontiers, within

        edge = np.zeros(occupancy.shape, np.bool_)
        for frontier in frontiers(occupancy):
            if frontier.size >= self.remains.least:
                edge[tuple(frontier.cells.T)] = True
        beyond = binary_dilation(edge) & self.remains.worth_looking(occupancy)
        protocol = self.remains.mission.protocol
        near = within(edge, self.planner.approach * protocol.reach, protocol.cell)
        return near, beyond.astype(np.float32)
