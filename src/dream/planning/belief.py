"""The paper's six reasoning steps, each as well as a calculation can do it: the default planner."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.lattice import Pose, lattice_of
from dream.mapping.hull import Hull
from dream.options import First
from dream.planning import sentences
from dream.planning.distribution import Groups, TargetEvidence
from dream.planning.failed_views import FailedViews
from dream.planning.far_hints import hints_up_to
from dream.planning.lookahead import NOTHING, LookAhead, Plan, Prospect
from dream.planning.parameters import check_count, check_range
from dream.planning.pose_views import PoseViews
from dream.planning.prior_survey import PriorSurvey
from dream.planning.sources import (
    AllGround,
    BeliefSource,
    Expected,
    ForetoldTargets,
    HiddenGroups,
    HintedTargets,
    HullSurface,
    Situation,
    TargetsBeside,
    TargetsToTraverse,
    Way,
    Worth,
)
from dream.planning.sources.source import LEAVE, MOST_VISITS
from dream.planning.space.in_water import HOLE
from dream.planning.travel import Travel, careful_travel, nearest_open, travel_from
from dream.planning.traversal_tour import TraversalTour
from dream.planning.viewpoints import all_viewpoints_from
from dream.types import BoolArray, Decision, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.mapping.completion import Completion
    from dream.planning.space.belief import Chooser, SpaceBelief

NEGLIGIBLE = 1e-9
"""Square metres of targets in ground from which none are expected: what has a weight becomes known when a
sequence of actions shows it, and can then be crossed."""
KEEP = 0.01
"""Share of all that is worth looking at that a tour may leave."""

MORE = 4.0
"""Times as much as in the plane is the search of ground worth in three dimensions, beside known targets: most
of what is told to be target beside them may be none."""


class ChooserInPlane(Protocol):
    """Chooses the way to what is worth looking at."""

    def plan(
        self, prospect: Prospect, travel: Travel, moves: npt.NDArray[np.uint8], known: BoolArray
    ) -> Plan | None:
        """The best way, see `LookAhead.plan`; None where nothing is in sight."""
        ...


@dataclass(frozen=True, slots=True)
class Belief:
    """Expects targets beside those seen and wherever a patch could hide, and looks some actions ahead.

    What it does: gives every unseen cell an expected area of targets, from what was seen around it and from
    the number of groups that the ground searched so far lets expect; searches over the real actions,
    six deep, for the sequence that shows most of it soonest, and judges where it ends by a tour over what
    is left; is done when every region is enclosed and the probability that a group was missed is small.

    Reference: the six reasoning steps of DREAM (arXiv 2509.13666); pathwise gain as in MapEx (2409.15590);
    front-loaded orienteering as in FIG-OP (2203.06316); a statistical stop for Poisson intensities after
    Reverdy and Koditschek (IROS 2016).

    Assumes: patches of about `size`. The protocol promises only 1; on the suite `dev` 2 predicts
    far better what was still missed. Fails when: patches are much smaller than that and stand alone; then it
    stops too early, which `--certify` never does.
    """

    spatial: ClassVar[bool] = True

    risk: First[float] = 0.002
    """The mission ends when the probability that a patch was missed is this small: 0 to 1. A smaller risk
    takes more steps."""
    certify: First[bool] = False
    """End only when all ground that can be seen was seen, whatever the risk."""
    size: First[float] = 2.0
    """Radius of the patches that are searched for, as a multiple of the smallest that the protocol promises
    (1.5 m under dream-v1)."""
    groups: float = 0.5
    """Patches that are expected on `searched` square metres before anything is seen."""
    searched: float = 500.0
    """Ground to which the number in `groups` applies, square metres. A large area makes the first guess count
    longer."""
    arriving: float = 0.5
    """Patches that are expected to come in a year to `searched` square metres where an earlier survey saw
    none. With more of them, more of that ground is searched again."""
    kernel: float = 4.0 / 3.0
    """How far targets are expected around a target: standard deviation, as a multiple of the radius of the
    smallest patch (1.5 m under dream-v1)."""
    prior: float = 0.02
    """Probability of a target in a map cell about which nothing is known."""
    prior_weight: float = 0.15
    """Weight of that probability beside what was seen around a cell."""
    open_edge: float = 0.5
    """A region stays open while an unseen cell at its edge holds a target with at least this probability."""
    # Well below what is aimed at: the estimate does not foresee what can be seen from a few places only.
    hull_left: float = 0.005
    """Share of a wreck's hull that may be unseen when the mission ends, as the planner estimates it."""
    glimpse: float = 2.5
    """Distance up to which pictures are searched for hints of targets, as a multiple of the reach (8 m under
    dream-v1). 1 takes no hints."""
    search: float = 0.05
    """Square metres of targets that are expected for each square metre where the middle of a patch could
    lie."""
    alone: float = 0.05
    """Factor on the worth of searching for patches while each step still shows much of a wreck."""
    eager: float = 3.0
    """Weight of targets beside known ones. A region that is left open costs a way back later."""
    patience: int = 3
    """A cell is given up after this many looks that did not show it."""
    width: int = 48
    """Sequences of actions that the search keeps at each depth."""
    horizon: First[int] = 6
    """Actions that the search looks ahead."""
    discount: float = 0.98
    """Worth of a target that is seen one step later, 0.5 to 1."""
    tour: float = 1.0
    """Weight of the way to what is left after a sequence, beside what the sequence shows."""
    jump: float = 0.6
    """Share of the best single view's worth, for its distance, that a sequence has to reach."""

    def __post_init__(self) -> None:
        check_range("risk", self.risk, 0.0, 1.0)
        check_range("certify", self.certify, False, True)
        check_range("size", self.size, 0.1, 100.0)
        check_range("groups", self.groups, 1e-3, 1e3)
        check_range("searched", self.searched, 1e-3, 1e6)
        check_range("arriving", self.arriving, 1e-3, 1e3)
        check_range("kernel", self.kernel, 0.1, 10.0)
        check_range("prior", self.prior, 1e-6, 1.0)
        check_range("prior_weight", self.prior_weight, 1e-6, 100.0)
        check_range("open_edge", self.open_edge, 0.0, 1.0)
        check_range("hull_left", self.hull_left, 0.0, 1.0)
        check_range("glimpse", self.glimpse, 1.0, 100.0)
        check_range("search", self.search, 1e-6, 1.0)
        check_range("alone", self.alone, 0.0, 1.0)
        check_range("eager", self.eager, 0.0, 1000.0)
        check_count("patience", self.patience, 1, 100)
        check_count("width", self.width, 1, 10_000)
        check_count("horizon", self.horizon, 1, 100)
        check_range("discount", self.discount, 0.5, 1.0)
        check_range("tour", self.tour, 0.0, 10.0)
        check_range("jump", self.jump, 0.0, 1000.0)

    def begin(self, mission: Mission) -> BeliefPilot | SpaceBelief:
        """A fresh pilot; it remembers which views failed and where it has been."""
        if mission.protocol.space is None:
            return self.in_plane(mission)
        from dream.planning.space.lookahead import SpaceLookAhead

        return self.in_space(mission, SpaceLookAhead(self.discount))

    def in_space(self, mission: Mission, chooser: Chooser) -> SpaceBelief:
        """A fresh pilot that moves in three dimensions.

        Args:
            mission: Under a protocol that does.
            chooser: Of the way to what is left of structures; all else is the same for all of them.
        """
        from dream.planning.space.belief import SpaceBelief
        from dream.planning.space.ground import GroundSearch

        return SpaceBelief(mission, GroundSearch(mission, self.over_ground.in_plane), chooser)

    @property
    def over_ground(self) -> Belief:
        """With what it searches ground in three dimensions, where many labels are wrong from everywhere.

        What is known of ground tells little of that beside it there, and hints from afar are wrong as often
        as right: all ground is looked at, and that counts more beside what is told to be target.
        """
        return replace(self, certify=True, glimpse=1.0, search=min(MORE * self.search, 1.0))

    def in_plane(self, mission: Mission) -> BeliefPilot:
        """A fresh pilot that keeps its altitude, under whatever protocol."""
        return BeliefPilot(self, mission, self.look_ahead)

    @property
    def look_ahead(self) -> LookAhead:
        """How plans are chosen in the plane."""
        return LookAhead(self.width, self.horizon, self.discount, self.tour, keep=KEEP, jump=self.jump)

    def size_of_groups(self, mission: Mission) -> float:
        """Radius of the groups that are searched for, metres, or of holes where all ground must be seen."""
        protocol = mission.protocol
        if not self.certify:
            return self.size * protocol.group_radius
        return 0.5 * protocol.cell if protocol.space is None else HOLE

    def sources(self, mission: Mission) -> list[BeliefSource]:
        """What it expects targets by, in the order in which they are asked; each may be left out."""
        protocol, size, prior = mission.protocol, self.size_of_groups(mission), mission.prior
        traverses, surveyed = protocol.traversal is not None, prior is not None
        sources: list[BeliefSource] = []
        # In a tank a look around shows most of what there is, and a survey tells more than hints do.
        hints = None if traverses or surveyed else hints_up_to(mission, self.glimpse)
        if hints is not None:
            sources.append(HintedTargets(hints))
        blur = self.kernel * protocol.group_radius
        beside = blur, self.prior, self.prior_weight, self.open_edge, self.eager, self.search
        sources.append(TargetsBeside(*beside))
        sources.append(HiddenGroups(size, Groups(self.groups, self.searched), self.search))
        # In space what stands up is no matter of the view from above.
        if protocol.space is None:
            hull, lattice = Hull(mission.bounds, protocol), lattice_of(mission.bounds, protocol)
            sources.append(HullSurface(hull, lattice, self.eager, self.hull_left, self.alone))
        if traverses:
            sources.append(TargetsToTraverse(TraversalTour(mission)))
        if prior is not None:
            sources.append(ForetoldTargets(PriorSurvey(prior, size), Groups(self.arriving, self.searched)))
        if self.certify:
            sources.append(AllGround())
        return sources


@dataclass(frozen=True, slots=True, eq=False)
class Thought:
    """What the planner holds of the situation, and what it would do."""

    pose: SE2
    """Snapped to the lattice: a vehicle that swims is never twice at quite the same place."""
    situation: Situation
    expected: Expected
    reasoning: Reasoning
    """The first three steps."""
    told: tuple[str, str]
    """The first and the third of them in the words that a model is told."""
    travel: Travel
    """The ways that the plan is one of."""
    plan: Plan | None
    """Where to go; None where the mission should end."""
    why: str
    """Why this plan; without one, why the mission should end."""

    @property
    def completion(self) -> Completion:
        """What is open and what is enclosed."""
        return self.situation.completion


@dataclass(slots=True)
class BeliefPilot:
    """`Belief` during one mission."""

    planner: Belief
    mission: Mission
    chooser: ChooserInPlane
    """Of the way to what is worth looking at."""
    pose_views: PoseViews = field(init=False)
    """What each pose shows."""
    sources: list[BeliefSource] = field(init=False)
    """What it expects targets by."""
    failed: FailedViews = field(init=False)
    """Its patience grows with every `done` that was refused."""
    claimed: SE2 | None = None
    """Where the last decision was `done`."""
    visits: Counter[Pose] = field(default_factory=Counter)
    """How often a pose was returned to since anything was new."""
    news: int = 0
    """What was `achieved` and found by the sources when anything was last new."""

    def __post_init__(self) -> None:
        self.pose_views = PoseViews(self.mission, self.planner.size_of_groups(self.mission))
        self.sources = self.planner.sources(self.mission)
        self.failed = FailedViews(self.mission, self.planner.patience)

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """All six steps."""
        thought = self.consider(observation, occupancy)
        return self.act(thought, thought.plan)

    def consider(self, observation: Observation, occupancy: OccupancyMap) -> Thought:
        """Take in what is new, and think the first four steps."""
        situation = self.take(observation, occupancy)
        # 1 Distribution: where targets are to be expected.
        expected = self.expect(situation)
        # 2 Current target area and 3 completion: what is still open.
        reasoning, told = self._explain(expected, situation)
        # 4 Next target: what shows most soonest, with the tour over what is left; none where it is complete.
        way = self._next_target(expected, situation)
        pose = self.mission.protocol.snap(observation.pose)
        return Thought(pose, situation, expected, reasoning, told, way.travel, way.plan, way.why)

    def act(self, thought: Thought, plan: Plan | None) -> Decision:
        """The first move of a plan; done without one."""
        if plan is None:
            self.claimed = thought.pose
            return Decision(done=True, reasoning=replace(thought.reasoning, action=thought.why))
        # Whoever takes another plan has reasons of their own.
        why = f" {thought.why}" if plan is thought.plan and thought.why else ""
        # 5 Safety is in the search: its first move is one that the guard lets pass.
        safety = sentences.safety(thought.situation.occupancy, thought.travel, plan.path[:2])
        # 6 Action: the first of the sequence.
        turn, advance = thought.travel.move(plan.path[0], plan.path[1])
        reasoning = replace(
            thought.reasoning,
            next_target=sentences.plan(plan, thought.travel) + why,
            safety=safety,
            action=sentences.action(turn, advance),
        )
        return Decision(turn, advance, reasoning=reasoning)

    # ------------------------------------------------------------------------------------- what is believed

    def take(self, observation: Observation, occupancy: OccupancyMap) -> Situation:
        """Hand what is new to all sources."""
        pose, protocol, pose_views = observation.pose, self.mission.protocol, self.pose_views
        here = pose_views.lattice.pose(pose)
        # Still there: it was refused. Whoever flies it may also have gone on without it.
        refused, self.claimed = self.claimed == protocol.snap(pose), None
        if refused:
            # It stood still, so that there was no new look; what was given up is worth one more.
            self.failed.try_again()
            there_is_more = [source.try_again() for source in self.sources]
            if any(there_is_more):
                self.visits.clear()
        else:
            # What it had foretold, with the solids that it knew of then, counts as looked at too.
            self.failed.note(pose, occupancy, pose_views.shown(here)[0] if self.news else None)
        situation = Situation(observation, occupancy, here, pose_views, self.failed)
        for source in self.sources:
            source.take(situation)
        pose_views.update(occupancy, situation.foretold)
        return situation

    def expect(self, situation: Situation) -> Expected:
        """Ask all sources, one after the other, what they expect."""
        occupancy, planner = situation.occupancy, self.planner
        nothing = np.zeros(occupancy.shape, np.float32)
        expected = Expected(
            TargetEvidence.of_map(occupancy),
            beside=nothing,
            likely=nothing,
            hiding=np.zeros(occupancy.shape, np.bool_),
            unnoticed=np.ones(occupancy.shape, np.float32),
            groups=Groups(planner.groups, planner.searched),
            accepted=planner.risk,
        )
        for source in self.sources:
            source.expect(expected, situation)
        return expected

    def _explain(self, expected: Expected, situation: Situation) -> tuple[Reasoning, tuple[str, str]]:
        """The first three steps in words; the first and the third in the words that a model is told."""
        occupancy, completion = situation.occupancy, situation.completion
        words = [source.words(expected, situation) for source in self.sources]
        certain, certain_for_models = "", ""
        for source in self.sources:
            said = source.certainty(expected, situation)
            certain, certain_for_models = said or (certain, certain_for_models)
        where = sentences.distribution(occupancy, completion)
        counted = expected.beside, expected.to_come, occupancy
        beyond = "".join(one.distribution for one in words)
        left = sentences.not_counted(self.failed.area_given_up(occupancy))
        left += "".join(one.completion for one in words)
        area = sentences.target_area(nearest_open(completion, situation.travel, occupancy), completion)
        reasoning = Reasoning(
            distribution=where + sentences.expectations(*counted) + beyond,
            target_area=next((one.target_area for one in words if one.target_area), area),
            completion=certain + left,
        )
        told = where + sentences.expectations_for_models(*counted) + beyond
        return reasoning, (told, certain_for_models + left)

    def _complete(self, expected: Expected, situation: Situation) -> bool:
        """Is every region enclosed, and is all else that was expected seen, or unlikely enough?"""
        completion, square = situation.completion, self.mission.protocol.cell**2
        leave = LEAVE * (square * np.count_nonzero(situation.occupancy.target) + expected.hinted)
        enclosed = completion.complete and bool(completion.regions) and expected.hinted <= leave
        return bool(enclosed and expected.looked_over and expected.searched)

    # -------------------------------------------------------------------------------------- next target

    def _next_target(self, expected: Expected, situation: Situation) -> Way:
        """Where to go."""
        if self._complete(expected, situation):
            return Way(
                situation.travel, None, sentences.enough(self.failed.area_given_up(situation.occupancy))
            )
        visits = self._visits(situation)
        way = self._errand(situation, situation.travel, situation.moves, visits)
        if way is not None:
            return way
        enough = any(source.enough(expected, situation) for source in self.sources)
        way = self._look_ahead(expected, situation, enough=enough)
        if way is not None and visits < MOST_VISITS:
            return way
        if way is not None and way.plan is not None:
            self._give_up(way.plan, situation.occupancy)
        near_solids = travel_from(situation.observation.pose, situation.occupancy)
        return self._errand(situation, near_solids, near_solids.free, visits) or self._leftover(
            expected, situation, visits, enough=enough
        )

    def _errand(
        self, situation: Situation, travel: Travel, moves: npt.NDArray[np.uint8], visits: int
    ) -> Way | None:
        """What some source has to have done first."""
        errands = (source.errand(situation, travel, moves, visits) for source in self.sources)
        return next((way for way in errands if way is not None), None)

    def _look_ahead(self, expected: Expected, situation: Situation, *, enough: bool) -> Way | None:
        """The tour of some source, or what shows most soonest unless enough was searched."""
        prospect = self.prospect(expected, situation)
        tours = (source.tour(expected, situation, prospect) for source in self.sources)
        tour = next((way for way in tours if way is not None), None)
        if tour is not None or enough:
            return tour
        known = self.pose_views.known_tiles(situation.occupancy)
        plan = self.chooser.plan(prospect, situation.travel, situation.moves, known)
        if plan is None:
            return None
        return Way(situation.travel, plan, "" if plan.choice is None else sentences.choice(plan.choice))

    def prospect(self, expected: Expected, situation: Situation) -> Prospect:
        """What is worth looking at, by which plans are chosen."""
        square, pose_views = self.mission.protocol.cell**2, self.pose_views
        nothing = np.zeros(situation.occupancy.shape)
        worth = Worth(nothing, 0.0, np.ones_like(nothing))
        for source in self.sources:
            source.weigh(worth, expected, situation)
        left, unseen = self.failed.left(situation.occupancy), situation.occupancy.unseen
        ground = np.where(left, worth.ground + NEGLIGIBLE, 0.0) * unseen
        hiding = np.where(expected.hiding, worth.search * square, 0.0) * worth.share * unseen
        return Prospect(
            pose_views,
            ground=pose_views.on_tiles(ground),
            hiding=pose_views.on_tiles(hiding),
            targets=pose_views.on_tiles(np.where(left, expected.beside * square, 0.0)),
            hidden=pose_views.on_tiles(expected.hiding * square),
            listed=worth.listed,
        )

    def _leftover(self, expected: Expected, situation: Situation, visits: int, *, enough: bool) -> Way:
        """The way to what only the map's own view of some pose still shows, near solid ground if need be."""
        from dream.mapping import within

        occupancy, protocol = situation.occupancy, self.mission.protocol
        weights = np.zeros(occupancy.shape, np.float32)
        row, col = situation.completion.open_cells.T
        weights[row, col] = 1.0
        if not enough:
            could_hold = within(expected.hiding, self.planner.size_of_groups(self.mission), protocol.cell)
            weights[could_hold & ~occupancy.observed] = 1.0
        weights[self.failed.count >= self.failed.patience + 2] = 0.0
        travel = situation.travel
        for search in (careful_travel, travel_from):
            travel = search(situation.observation.pose, occupancy)
            views = all_viewpoints_from(travel, occupancy, weights)
            best = views.best(views.rates)
            if best is not None and best.rate > NOTHING:
                plan = Plan(travel.path(best.pose), rate=0.0, later=0.0, cells=best.gain)
                if visits >= 2 * MOST_VISITS:
                    self._give_up(plan, occupancy)
                return Way(travel, plan, sentences.LEFTOVER)
        return Way(travel, None, sentences.nothing_left(self.failed.area_given_up(occupancy)))

    # ----------------------------------------------------------------------------------------- watchdog

    def _visits(self, situation: Situation) -> int:
        """How often it has come to this pose since anything was new."""
        seen = achieved(situation.occupancy) + sum(source.found() for source in self.sources)
        if seen != self.news:
            self.news = seen
            self.visits.clear()
        self.visits[situation.travel.start] += 1
        return self.visits[situation.travel.start]

    def _give_up(self, plan: Plan, occupancy: OccupancyMap) -> None:
        """Hope for nothing more from the views of a plan."""
        from dream.mapping import view

        for pose in plan.path:
            ground, middles = self.pose_views.shown(pose)
            there = self.pose_views.lattice.world(pose)
            shown = view(occupancy, there.x, there.y, there.yaw) | ground | middles
            self.failed.give_up(shown & ~occupancy.observed)
            for source in self.sources:
                source.give_up(pose)


def achieved(occupancy: OccupancyMap) -> int:
    """Cells observed, and targets among them that the protocol wants traversed and that were."""
    return int(
        np.count_nonzero(occupancy.observed) + np.count_nonzero(occupancy.traversed & occupancy.target)
    )
