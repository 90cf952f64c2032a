"""The paper's six reasoning steps, carried out literally on the map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.lattice import Pose
from dream.options import First
from dream.planning import sentences
from dream.planning.distribution import TargetEvidence, blurred, expectation
from dream.planning.far_hints import FarHints, hints_up_to
from dream.planning.parameters import check_range
from dream.planning.travel import Travel, nearest_open, travel_from
from dream.planning.viewpoints import Viewpoint, Viewpoints, spread
from dream.types import Decision, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.mapping.completion import Completion, Region
    from dream.planning.space.sixsteps import SpacePilot

FloatArray = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class SixSteps:
    """Takes the paper's six reasoning steps by rules, without a model.

    What it does: spreads the evidence of what was seen over the ground beside it; works on the open
    target region that is fewest steps away; goes where most is expected to be discovered per step, over
    known free ground only, and up to `glimpse` to what seems to be targets beyond the reach, if it takes
    hints; looks at a hull from afar too, since its top is above the image from near by;
    is done when every region is enclosed and no place is left in which a whole group could hide.

    Reference: the six reasoning steps of DREAM (arXiv 2509.13666), without the model.

    Assumes: the protocol's prior on the size of a group. Fails when: targets are so scattered that
    their neighbourhood says nothing about them, or one end of a hull is only seen from close by.
    """

    spatial: ClassVar[bool] = True

    kernel: float = 4.0 / 3.0
    """How far targets are expected around a target: standard deviation, as a multiple of the radius of the
    smallest patch (1.5 m under dream-v1)."""
    prior: float = 0.02
    """Probability of a target in a map cell about which nothing is known."""
    prior_weight: float = 0.15
    """Weight of that probability beside what was seen around a cell."""
    focus: First[float] = 2.0
    """Weight of cells that keep the current region open."""
    standoff_cells: float = 1.5
    """Map cells between the vehicle's body and the middle of anything solid."""
    closing: First[float] = 3.0
    """Weight of unknown ground that explored ground surrounds. Left behind, it costs a way back later."""
    hull: float = 1.0
    """Worth of a look from afar at a cell of a hull."""
    afar: float = 0.6
    """Distance from which a hull is seen up to its top, as a share of the reach."""
    patience: First[float] = 1.15
    """The chosen viewpoint is given up for one that is this many times better."""
    glimpse: float = 1.0
    """Distance up to which pictures are searched for hints of targets, as a multiple of the reach. 1 takes no
    hints."""

    def __post_init__(self) -> None:
        check_range("kernel", self.kernel, 0.1, 10.0)
        check_range("prior", self.prior, 1e-6, 1.0)
        check_range("prior_weight", self.prior_weight, 1e-6, 100.0)
        check_range("focus", self.focus, 1.0, 1000.0)
        check_range("standoff_cells", self.standoff_cells, 0.0, 100.0)
        check_range("closing", self.closing, 0.0, 1000.0)
        check_range("hull", self.hull, 0.0, 1000.0)
        check_range("afar", self.afar, 0.0, 1.0)
        check_range("patience", self.patience, 1.0, 1000.0)
        check_range("glimpse", self.glimpse, 1.0, 100.0)

    def begin(self, mission: Mission) -> _SixStepsPilot | SpacePilot:
        """A fresh pilot; it remembers the viewpoint it is heading for and the hull it looked at from afar.

        Under a protocol that moves in space it takes the steps on the volume instead.
        """
        if mission.protocol.space is not None:
            from dream.planning.space.sixsteps import SpacePilot

            return SpacePilot(self, mission)
        cell, bounds = mission.protocol.cell, mission.bounds
        surveyed = np.zeros((round(bounds.depth / cell), round(bounds.width / cell)), dtype=np.bool_)
        return _SixStepsPilot(self, mission, surveyed, self.hints(mission))

    def hints(self, mission: Mission) -> FarHints | None:
        """What is to learn from pictures beyond the reach; None where no hints are taken."""
        return hints_up_to(mission, self.glimpse)

    def expectation(self, occupancy: OccupancyMap, evidence: TargetEvidence | None = None) -> FloatArray:
        """See `distribution.expectation`; of what was observed unless evidence is given."""
        radius = self.kernel * occupancy.protocol.group_radius
        beside = expectation(occupancy, radius, self.prior, self.prior_weight, ~occupancy.observed, evidence)
        return beside if evidence is None else np.where(occupancy.observed, 0.0, evidence.weighed(beside))


@dataclass(slots=True)
class _SixStepsPilot:
    planner: SixSteps
    mission: Mission
    surveyed: npt.NDArray[np.bool_]
    """(rows, cols) cells that were looked at from afar."""
    hints: FarHints | None = None
    """Of targets beyond the reach; None where none are taken."""
    heading_for: Pose | None = None

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        from dream.mapping import check_completion, hiding_places

        pose, protocol = observation.pose, self.mission.protocol
        self._survey(pose, occupancy)
        standoff = protocol.body_radius + self.planner.standoff_cells * protocol.cell
        travel = travel_from(pose, occupancy, standoff=standoff)

        # 1 Distribution: where targets are, and where more are to be expected.
        evidence = None
        if self.hints is not None:
            self.hints.add(observation, occupancy)
            evidence = self.hints.evidence(occupancy)
        expected = self.planner.expectation(occupancy, evidence)
        # 2 Current target area and 3 completion: what is still open, and the nearest of it.
        completion = check_completion(occupancy, pose)
        hidden = hiding_places(occupancy, pose, protocol.group_radius)
        area = nearest_open(completion, travel, occupancy)
        reasoning = Reasoning(
            distribution=sentences.distribution(occupancy, completion),
            target_area=sentences.target_area(area, completion),
            completion=sentences.completeness(completion, hidden, protocol.group_radius),
        )
        # 4 Next target: the pose from which most is expected to be discovered per step.
        worth = self._worth(expected, occupancy, completion, area, hidden, evidence)
        if completion.complete and not hidden.any():
            worth[:] = 0.0  # Only hull may be left to look at.
        viewpoint = self._best_viewpoint(worth, travel, occupancy)
        if viewpoint is None:
            # Perhaps what is left can only be seen from nearer to something solid.
            travel = travel_from(pose, occupancy)
            viewpoint = self._best_viewpoint(worth, travel, occupancy)
        if viewpoint is None:
            return Decision(done=True, reasoning=replace(reasoning, action="The mission is complete."))
        # 5 Safety is in the search: its moves are those that the guard lets pass.
        # 6 Action: the first of them.
        path = travel.path(viewpoint.pose)
        turn, advance = travel.move(path[0], path[1])
        return Decision(
            turn,
            advance,
            reasoning=replace(
                reasoning,
                next_target=sentences.next_target(travel, viewpoint.pose, expected, occupancy),
                safety=sentences.safety(occupancy, travel, path),
                action=sentences.action(turn, advance),
            ),
        )

    def _is_afar(self, x: npt.ArrayLike, y: npt.ArrayLike, occupancy: OccupancyMap) -> npt.NDArray[np.bool_]:
        """Is nothing solid so near that its upper parts are above the image?"""
        distance = occupancy.distance_to_solid[occupancy.cell_of(x, y)]
        return np.asarray(distance >= self.planner.afar * self.mission.protocol.reach)

    def _survey(self, pose: SE2, occupancy: OccupancyMap) -> None:
        from dream.mapping import view

        if self._is_afar(pose.x, pose.y, occupancy):
            self.surveyed |= view(occupancy, pose.x, pose.y, pose.yaw)

    def _hull_left(self, occupancy: OccupancyMap) -> npt.NDArray[np.bool_]:
        """(rows, cols) cells of the area that are target and solid and were not yet looked at from afar."""
        return occupancy.target & occupancy.solid & ~self.surveyed & occupancy.to_see

    def _worth(
        self,
        expected: FloatArray,
        occupancy: OccupancyMap,
        completion: Completion,
        area: Region | None,
        hidden: npt.NDArray[np.bool_],
        evidence: TargetEvidence | None,
    ) -> FloatArray:
        """(rows, cols) what discovering a cell is worth: its expectation, more where it closes a region."""
        from dream.mapping import within

        protocol = self.mission.protocol
        could_hide = within(hidden, protocol.group_radius, protocol.cell)
        radius = self.planner.kernel * protocol.group_radius
        target = occupancy.target if evidence is None else occupancy.target | evidence.hints
        near_target = within(target, 2.0 * radius, protocol.cell)
        # Where no target has been seen, only ground explored to the last cell is complete.
        search = could_hide if completion.regions else ~occupancy.observed
        surrounded = blurred(occupancy.observed, 2.0 * radius, occupancy, search)
        worth = np.where(search, self.planner.prior * (1.0 + self.planner.closing * surrounded), 0.0)
        worth = np.where(near_target, np.maximum(expected, worth), worth).astype(np.float32)
        for region in completion.regions:
            rows, cols = region.open_cells.T
            factor = self.planner.focus if region is area else 1.0
            worth[rows, cols] = np.maximum(worth[rows, cols], self.planner.prior_weight) * factor
        worth[occupancy.observed] = 0.0
        return worth

    def _best_viewpoint(self, worth: FloatArray, travel: Travel, occupancy: OccupancyMap) -> Viewpoint | None:
        from dream.mapping import gain, visible_weight

        nodes = spread(travel, self.heading_for)
        positions = travel.lattice.positions[nodes]
        gains = gain(occupancy, positions, worth)
        afar = self._is_afar(positions[:, 0], positions[:, 1], occupancy)
        hull = self._hull_left(occupancy)
        if hull.any() and afar.any():
            gains[afar] += self.planner.hull * visible_weight(occupancy, positions[afar], hull)
        views = Viewpoints(travel.lattice, nodes, travel.steps_to(nodes), gains)
        chosen = views.best(views.rates)
        if chosen is None or np.round(chosen.rate, 6) <= 0.0:
            self.heading_for = None
            return None
        before = None if self.heading_for is None else views.at(self.heading_for)
        # Rounded, so that a tie is a tie on every machine.
        if before is not None and np.round(before.rate, 6) * self.planner.patience >= chosen.rate:
            chosen = before
        self.heading_for = chosen.pose if chosen.steps > 1 else None
        return chosen
