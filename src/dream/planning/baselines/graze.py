"""Lanes until a target is met, then along the edge of what was met until it is closed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from dream.geometry import SE2
from dream.lattice import Pose
from dream.options import First
from dream.planning.baselines.lawnmower import Lawnmower
from dream.planning.baselines.remains import group_cells
from dream.planning.baselines.sweeping import Sweeping
from dream.planning.far_hints import FarHints, hints_up_to
from dream.planning.parameters import check_range
from dream.planning.space.over_ground import OverGround, in_plane_or_over_ground
from dream.planning.travel import Travel, careful_travel
from dream.planning.viewpoints import Viewpoint, viewpoints_from
from dream.types import Decision, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.mapping.completion import Region


@dataclass(frozen=True, slots=True)
class SweepAndGraze:
    """Sweep in lanes; where a target is met, follow the open edge of its region until it is closed.

    What it does: flies the lawnmower's lanes. As soon as the map holds a region that is not enclosed, it
    leaves the lane and goes from one open stretch of that region's edge to the nearest next, until the
    region is closed or the rest of its edge cannot be seen; then it does the same with other open regions,
    goes to what seems to be targets up to `glimpse`, if it takes hints, and resumes the lanes where it left
    them. It ends as the lawnmower does. In space whole patches stay open until they were seen from two sides;
    there a view of them has to show as much as one of new ground.

    Reference: the alternation of sweeping and close inspection of Bounomodes (arXiv 2507.06960).

    Assumes: targets come in regions. Fails when: they are scattered one by one, so that there is no edge to
    follow.
    """

    spatial: ClassVar[bool] = True

    # Wider than the lawnmower's: gaps at targets are closed on the way.
    swath: First[float] = 1.0
    """Distance between lanes at most, as a share of the width of ground in the picture."""
    inset: First[float] = 0.5
    """Distance from the ends of the lanes to the edge of the area, as a share of the reach."""
    least: float = 0.25
    """A waypoint is flown to if it shows this much new ground: share of the area of the smallest patch. So is
    a hint that shows this much of targets, by how often hints came true."""
    edge: float = 0.0
    """A view of an open edge is gone to if it shows this much of it: share of the area of the smallest patch,
    one map cell at least."""
    glimpse: float = 1.0
    """Distance up to which pictures are searched for hints of targets, as a multiple of the reach. 1 takes no
    hints."""

    def __post_init__(self) -> None:
        check_range("swath", self.swath, 0.1, 4.0)
        check_range("inset", self.inset, 0.1, 4.0)
        check_range("least", self.least, 0.0, 100.0)
        check_range("edge", self.edge, 0.0, 100.0)
        check_range("glimpse", self.glimpse, 1.0, 100.0)

    def begin(self, mission: Mission) -> _Grazing | OverGround:
        """A fresh survey; the lanes are laid when the start is known.

        Under a protocol that moves in space it searches the ground: see `OverGround`.
        """
        in_space = mission.protocol.space is not None
        grazer = replace(self, edge=max(self.edge, self.least)) if in_space else self
        return in_plane_or_over_ground(mission, grazer.in_plane)

    def in_plane(self, mission: Mission) -> _Grazing:
        """A pilot that keeps its altitude, under whatever protocol."""
        lanes = Lawnmower(swath=self.swath, inset=self.inset, least=self.least)
        hints = hints_up_to(mission, self.glimpse)
        return _Grazing(lanes.in_plane(mission), self.edge * group_cells(mission.protocol), hints)


@dataclass(slots=True)
class _Grazing:
    sweeping: Sweeping
    edge: float
    """Cells of an open edge that a view must show, until a `done` was refused for less."""
    hints: FarHints | None = None
    """Of targets beyond the reach; None where none are taken."""
    region: tuple[float, float] | None = None
    """Middle of a target cell of the region that is being followed; None on the lanes."""
    goal: Pose | None = None

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        from dream.mapping import check_completion

        pose, remains = observation.pose, self.sweeping.remains
        remains.look(pose, occupancy)
        if self.hints is not None:
            self.hints.add(observation, occupancy)
        travel = careful_travel(pose, occupancy)
        worth = remains.worth_looking(occupancy)
        regions = [region for region in check_completion(occupancy, pose).regions if not region.enclosed]
        while regions:
            region = self._followed(regions, occupancy) or _nearest(regions, pose, occupancy)
            weights = np.zeros(occupancy.shape, np.float32)
            weights[tuple(region.open_cells.T)] = 1.0
            weights *= worth
            views = viewpoints_from(travel, occupancy, weights, keep=self.goal)
            view = views.nearest(max(1.0, min(self.edge, remains.least)))
            if view is not None:
                cell_x, cell_y = occupancy.center_of(*region.cells[0])
                self.region = float(cell_x), float(cell_y)
                x, y = region.centroid
                return self._to(
                    view,
                    travel,
                    f"Along the edge of the region at ({x:.1f}, {y:.1f}), of which {len(region.open_cells)} "
                    f"cells are open: to a view of {view.gain:.0f} of them, {view.steps} steps away.",
                )
            regions.remove(region)
            self.region = self.goal = None
        if self.hints is not None:
            hinted = self.hints.precision * (self.hints.hints(occupancy) & worth).astype(np.float32)
            view = viewpoints_from(travel, occupancy, hinted, keep=self.goal).nearest(remains.least)
            if view is not None:
                return self._to(
                    view,
                    travel,
                    f"To what seems to be {view.gain:.0f} cells of target beyond the reach, {view.steps} "
                    "steps away.",
                )
            self.goal = None
        return self.sweeping.proceed(pose, travel, occupancy)

    def _to(self, view: Viewpoint, travel: Travel, why: str) -> Decision:
        """The first move to a view beside the lanes."""
        self.goal = view.pose
        self.sweeping.budget = 0  # The way back to the lane is a new one.
        self.sweeping.remains.refused = False
        path = travel.path(view.pose)
        return Decision(*travel.move(path[0], path[1]), reasoning=Reasoning(action=why))

    def _followed(self, regions: list[Region], occupancy: OccupancyMap) -> Region | None:
        """The region that is being followed, which may have grown since; None where it is closed."""
        if self.region is None:
            return None
        row, col = occupancy.cell_of(*self.region)
        return next((region for region in regions if (region.cells == (row, col)).all(axis=1).any()), None)


def _nearest(regions: list[Region], pose: SE2, occupancy: OccupancyMap) -> Region:
    """The region whose open edge is nearest to the vehicle."""

    def distance(region: Region) -> float:
        x, y = occupancy.center_of(*region.open_cells.T)
        return float(np.hypot(x - pose.x, y - pose.y).min())

    return min(regions, key=distance)
