"""The paper's six reasoning steps, each as well as a calculation can do it: the default planner."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.options import First
from dream.planning import sentences
from dream.planning.distribution import GLIMPSED, OBSERVED, Calibration, Groups, expectation
from dream.planning.glimpses import Glimpses
from dream.planning.hull import PATCH, Hull
from dream.planning.lookahead import NOTHING, LookAhead, Plan, Prospect
from dream.planning.outlook import Listed, Outlook
from dream.planning.parameters import check_count, check_range
from dream.planning.recall import LIKELY, Recall
from dream.planning.rounds import Rounds
from dream.planning.travel import Pose, Travel, careful_standoff, careful_travel, nearest_open, travel_from
from dream.planning.vain import VainLooks
from dream.planning.views import all_views_from
from dream.planning.walk import Walk
from dream.types import BoolArray, Decision, Float32Array, Mission, Observation, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.mapping.completion import Completion, Region

FloatArray = npt.NDArray[np.floating[Any]]

NEGLIGIBLE = 1e-9
"""Square metres of targets in ground from which none are expected: what has a weight becomes known when a
sequence of actions shows it, and can then be crossed."""
STANDS = 0.5
"""Square metres of targets that stand up from which on they are a hull. On the reefs of `dev` boulders among
the targets make up to 0.2 m² seem so; a wreck shows more in the first frame that has it in reach."""
ADJOINING = 1.5
"""Metres from hull within reach up to which more hull is believed in."""
KEEP = 0.01
"""Share of all that is worth looking at that a tour may leave."""
BENEATH = 0.02
"""What ground beside and beneath a hull counts: what is to be seen there is the hull itself."""
NEAR = 5
"""Steps within which the hull's views are worked out for every second node; within twice as many for every
fourth, for every sixteenth beyond."""
LEAVE = 0.015
"""Share of the targets, seen and foretold or hinted at, that may be left."""
MOST_VISITS = 3
"""Of a pose without anything new: then what it headed for is given up; after twice as many, leftovers too."""
GIVEN_UP = np.iinfo(np.uint16).max // 2
"""Looks in vain at a cell of which nothing is hoped for."""


@dataclass(frozen=True, slots=True)
class Belief:
    """Expects targets beside those seen and wherever a patch could hide, and looks some actions ahead.

    What it does: gives every unseen cell an expected area of targets, from what was seen around it and from
    the number of groups that the ground searched so far lets expect; searches over the real actions, a
    dozen deep, for the sequence that shows most of it soonest, and judges where it ends by a tour over what
    is left; is done when every region is enclosed and the probability that a group was missed is small.

    Reference: the six reasoning steps of DREAM (arXiv 2509.13666); pathwise gain as in MapEx (2409.15590);
    front-loaded orienteering as in FIG-OP (2203.06316); a statistical stop for Poisson intensities after
    Reverdy and Koditschek (IROS 2016).

    Assumes: patches of about `size`. The protocol promises only 1; on the suite `dev` 2 predicts
    far better what was still missed. Fails when: patches are much smaller than that and stand alone; then it
    stops too early, which `--certify` never does.
    """

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
    """Factor on the number of expected patches once a hull was found: a wreck lies alone."""
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

    def begin(self, mission: Mission) -> BeliefPilot:
        """A fresh pilot; it remembers what it looked at in vain and where it has been."""
        return BeliefPilot(self, mission)


@dataclass(frozen=True, slots=True, eq=False)
class _Expected:
    """What a pilot believes, over the cells of the map."""

    beside: FloatArray
    """(rows, cols) probability of a target beside known ones."""
    hiding: BoolArray
    """(rows, cols) middles of groups that would not have been noticed."""
    risk: float
    """Probability that there is such a group, by how often that came true."""
    groups: float
    """How many are to be expected."""
    hull: FloatArray
    """(n,) patches to be expected in each element of the hull."""
    hull_left: float
    """Share of the hull that is still unseen."""
    away_from_hull: FloatArray | None
    """(rows, cols) metres to the nearest target that stands up; None where there is no hull."""
    rarity: float
    """How many times as many groups are to be expected where an earlier survey saw none."""
    hinted: float
    """Square metres of targets, where some were hinted at beyond the reach and nothing was observed yet."""


@dataclass(frozen=True, slots=True, eq=False)
class Thought:
    """What the planner holds of the situation, and what it would do."""

    pose: SE2
    """Snapped to the lattice: a vehicle that swims is never twice at quite the same place."""
    travel: Travel
    moves: npt.NDArray[np.uint8]
    """See `Outlook.moves`."""
    completion: Completion
    expected: _Expected
    reasoning: Reasoning
    """The first three steps."""
    told: tuple[str, str]
    """The first and the third of them in the words that a model is told."""
    plan: Plan | None = None
    """Where to go; None where the mission should end."""
    why: str = ""
    """Why this plan; without one, why the mission should end."""


@dataclass(slots=True)
class BeliefPilot:
    """`Belief` during one mission."""

    planner: Belief
    mission: Mission
    outlook: Outlook = field(init=False)
    hull: Hull = field(init=False)
    vain: VainLooks = field(init=False)
    patience: int = field(init=False)
    """Grows with every `done` that was refused."""
    claimed: SE2 | None = None
    """Where the last decision was `done`."""
    walk: Walk | None = field(init=False)
    """None where the protocol asks for no traversal."""
    passed_in_vain: BoolArray = field(init=False)
    """(rows, cols) cells that are not worth another try to traverse them."""
    recall: Recall | None = field(init=False)
    """None where there is no earlier survey."""
    glimpses: Glimpses | None = field(init=False)
    """None where no frame is looked at beyond the reach: nor is one in a tank, where a look around shows most
    of what there is, nor with a survey, which tells more."""
    rounds: Rounds = field(default_factory=Rounds)
    visits: Counter[Pose] = field(default_factory=Counter)
    """How often a pose was returned to since anything was new."""
    news: int = 0
    """What was `achieved` and patches of hull found when anything was last new."""

    def __post_init__(self) -> None:
        self.outlook = Outlook(self.mission, self.size)
        self.hull = Hull(self.mission.bounds, self.mission.protocol)
        self.vain = VainLooks(self.mission)
        self.walk = None if self.mission.protocol.traversal is None else Walk(self.mission)
        self.passed_in_vain = np.zeros_like(self.vain.observed)
        self.patience = self.planner.patience
        self.recall = None if self.mission.prior is None else Recall(self.mission.prior, self.size)
        farthest = self.planner.glimpse * self.mission.protocol.reach
        hints = self.planner.glimpse > 1.0 and self.walk is None and self.recall is None
        self.glimpses = Glimpses(self.mission, farthest) if hints else None

    @property
    def size(self) -> float:
        """Radius of the groups that are searched for, metres; a cell's where everything must be seen."""
        protocol = self.mission.protocol
        return 0.5 * protocol.cell if self.planner.certify else self.planner.size * protocol.group_radius

    @property
    def calibration(self) -> Calibration:
        """How often what the model says of hidden groups comes true."""
        return OBSERVED if self.glimpses is None else GLIMPSED

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """All six steps."""
        thought = self.consider(observation, occupancy)
        return self.act(thought, thought.plan, occupancy)

    def consider(self, observation: Observation, occupancy: OccupancyMap) -> Thought:
        """Take in what is new, and think the first four steps."""
        from dream.mapping import check_completion

        pose, protocol = observation.pose, self.mission.protocol
        here = (*self.outlook.node(pose.x, pose.y), protocol.heading_index(pose.yaw))
        # Still there: it was refused. Whoever flies it may also have gone on without it.
        refused, self.claimed = self.claimed == protocol.snap(pose), None
        if refused:
            # It stood still, so that there was no new look; what was given up is worth one more.
            self.patience += 1
            np.minimum(self.vain.count, self.patience + 1, out=self.vain.count)
            if self.passed_in_vain.any():
                self.passed_in_vain[:] = False
                self.visits.clear()
        else:
            # What it had foretold, with the solids that it knew of then, counts as looked at too.
            self.vain.note(pose, occupancy, self.outlook.shown(here)[0] if self.news else None)
        foretold = None
        if self.recall is not None:
            self.recall.look(self.outlook.shown(here)[0], occupancy)
            self.recall.compare(occupancy)
            foretold = self.recall.solid(occupancy)
        self.outlook.update(occupancy, foretold)
        self.hull.integrate(observation)
        self._try_hull(here)
        if self.glimpses is not None:
            self.glimpses.add(observation, occupancy)
        # Beside a hull every place counts that the guard allows.
        away_from_hull = _away_from_hull(occupancy)
        travel = careful_travel(pose, occupancy) if away_from_hull is None else travel_from(pose, occupancy)
        moves = self.outlook.moves(travel.free, occupancy, careful_standoff(protocol), foretold)

        # 1 Distribution: where targets are to be expected.
        completion = check_completion(occupancy, pose)
        expected = self._expected(occupancy, completion, pose, away_from_hull)
        # 2 Current target area and 3 completion: what is still open.
        area = nearest_open(completion, travel, occupancy)
        where, beyond = sentences.distribution(occupancy, completion), ""
        if self.glimpses is not None:
            beyond += sentences.hinted(expected.hinted, self.glimpses.precision)
        if self.recall is not None:
            beyond += sentences.recalled(self.recall, occupancy)
        left = self._left(expected, occupancy)
        target_area = sentences.target_area(area, completion)
        if self.walk is not None:
            left += sentences.traversal(occupancy, completion)
            if len(completion.untraversed):
                target_area = sentences.left_to_traverse(occupancy, completion)
        counted = (expected.beside, expected.groups, occupancy)
        certain, certain_for_models = self._certainty(completion, expected)
        reasoning = Reasoning(
            distribution=where + sentences.expectations(*counted) + beyond,
            target_area=target_area,
            completion=certain + left,
        )
        told = where + sentences.expectations_for_models(*counted) + beyond, certain_for_models + left
        thought = Thought(protocol.snap(pose), travel, moves, completion, expected, reasoning, told)
        square = protocol.cell**2
        leave = LEAVE * (square * np.count_nonzero(occupancy.target) + expected.hinted)
        enclosed = completion.complete and bool(completion.regions) and expected.hinted <= leave
        looked_over = expected.hull_left <= self.planner.hull_left
        if enclosed and looked_over and expected.risk <= self.planner.risk:
            return replace(thought, why=sentences.enough(self._given_up(occupancy)))
        # 4 Next target: what was found is traversed first, where the protocol asks for that ...
        visits = self._visits(travel.start, occupancy)
        walk = self._walk(thought, travel, moves, visits, occupancy)
        if walk is not None:
            return walk
        # ... and then what shows most soonest, with the tour over what is left.
        prospect = self.prospect(thought, occupancy)
        # With a survey the risk may be little long before all ground was searched: then that is done with.
        sure = self.recall is not None and bool(completion.regions) and looked_over
        sure = sure and expected.risk <= self.planner.risk
        plan, why = None, ""
        if self.recall is not None and self.recall.believed > 0.5:
            plan, why = self._round(thought, prospect, moves, occupancy), sentences.ROUND
        if plan is None and not sure:
            plan = self.look_ahead.plan(prospect, travel, moves, self.outlook.known_tiles(occupancy))
            why = "" if plan is None or plan.choice is None else sentences.choice(plan.choice)
        if plan is not None and visits >= MOST_VISITS:
            self._give_up(plan, occupancy)
            plan = None
        if plan is not None:
            return replace(thought, plan=plan, why=why)
        near_solids = travel_from(pose, occupancy)
        walk = self._walk(thought, near_solids, near_solids.free, visits, occupancy)
        if walk is not None:
            return walk
        hiding = np.zeros_like(expected.hiding) if sure else expected.hiding
        travel, plan = self._leftover(completion, hiding, pose, occupancy)
        if plan is not None and visits >= 2 * MOST_VISITS:
            self._give_up(plan, occupancy)
        why = sentences.LEFTOVER if plan else sentences.nothing_left(self._given_up(occupancy))
        return replace(thought, travel=travel, plan=plan, why=why)

    def _round(
        self, thought: Thought, prospect: Prospect, moves: npt.NDArray[np.uint8], occupancy: OccupancyMap
    ) -> Plan | None:
        """The way round what is foretold and was not seen yet; None where hardly any of it is left."""
        assert self.recall is not None
        square = self.mission.protocol.cell**2
        unseen = ~occupancy.observed & (self.vain.count < self.patience)
        known = square * np.count_nonzero(occupancy.target)
        needed = np.zeros_like(unseen)
        if thought.completion.regions:
            needed[tuple(thought.completion.open_cells.T)] = True
        expected, either = thought.expected, unseen | self.recall.unheard(occupancy)
        unknown = expected.hiding & ~self.recall.empty
        intensity = expected.groups / max(square * np.count_nonzero(expected.hiding), square)
        # What is in plain view comes first; then also what a low rock may hide and what keeps a region open,
        # which cost more than they bring; then also ground of which the survey knows nothing.
        for part in range(3):
            left = either if part else unseen
            worth = self.recall.weighed(expected.beside, left)
            worth = np.where(left & (worth >= LIKELY), square * worth, 0.0)
            leave = LEAVE * (known + float(worth.sum()))
            hiding = np.zeros_like(worth)
            if part > 0:
                # No cell that is needed may be left, and of groups as many as make half the risk accepted.
                worth[needed & unseen] = 1.1 * leave
            if part > 1:
                # Nor any that could hold one, where hardly any risk is accepted.
                each = (
                    leave
                    * square
                    * intensity
                    / max(0.5 * self.calibration.uncalibrated(self.planner.risk), 1e-9)
                )
                hiding[unknown] = min(each, 1.1 * leave)
            ahead = replace(
                prospect, ground=self.outlook.on_tiles(worth), hiding=self.outlook.on_tiles(hiding)
            )
            plan = self.rounds.plan(ahead, thought.travel, moves, leave)
            if plan is not None:
                return plan
        return None

    def _walk(
        self,
        thought: Thought,
        travel: Travel,
        moves: npt.NDArray[np.uint8],
        visits: int,
        occupancy: OccupancyMap,
    ) -> Thought | None:
        """With the way to traverse what is left; None where no way leads to any of it."""
        if self.walk is None:
            return None
        from dream.mapping import to_traverse

        # Beyond what completion asks for: what no known way leads to may come in reach on the way.
        left = np.argwhere(to_traverse(occupancy) & ~self.passed_in_vain)
        if visits > 1:
            moves = travel.free  # What is unknown stays so from here.
        while True:
            path = self.walk.plan(left, travel, moves)
            passes = self.walk.traverses(path)[tuple(left.T)]
            if len(path) == 1:
                return None
            if visits < MOST_VISITS:
                plan = Plan(path, rate=0.0, later=0.0, passed=int(passes.sum()))
                return replace(thought, travel=travel, plan=plan, why=sentences.WALK)
            self.passed_in_vain[tuple(left[passes].T)] = True
            left = left[~passes]

    def act(self, thought: Thought, plan: Plan | None, occupancy: OccupancyMap) -> Decision:
        """The first move of a plan; done without one."""
        if plan is None:
            self.claimed = thought.pose
            return Decision(done=True, reasoning=replace(thought.reasoning, action=thought.why))
        # Whoever takes another plan has reasons of their own.
        why = f" {thought.why}" if plan is thought.plan and thought.why else ""
        # 5 Safety is in the search: its first move is one that the guard lets pass.
        # 6 Action: the first of the sequence.
        turn, advance = thought.travel.move(plan.path[0], plan.path[1])
        return Decision(
            turn,
            advance,
            reasoning=replace(
                thought.reasoning,
                next_target=sentences.plan(plan, thought.travel) + why,
                safety=sentences.safety(occupancy, thought.travel, plan.path[:2]),
                action=sentences.action(turn, advance),
            ),
        )

    def _left(self, expected: _Expected, occupancy: OccupancyMap) -> str:
        """What there is to say of step 3 beside certainty."""
        more = sentences.not_counted(self._given_up(occupancy))
        if expected.away_from_hull is not None:
            area = PATCH**2 * float(expected.hull.sum())
            more += sentences.hull(area, expected.hull_left, self.planner.hull_left)
        return more + sentences.hints_left(expected.hinted)

    def _certainty(self, completion: Completion, expected: _Expected) -> tuple[str, str]:
        """How certain it is that all was seen; and the same as models are told it."""
        if self.planner.certify:
            unseen = float(expected.hiding.sum()) * self.mission.protocol.cell**2
            said = sentences.certificate(completion, unseen)
            return said, said
        risks = (completion, expected.risk, self.planner.risk)
        return sentences.certainty(*risks), sentences.certainty_for_models(*risks)

    # ------------------------------------------------------------------------------------- distribution

    def _expected(
        self,
        occupancy: OccupancyMap,
        completion: Completion,
        pose: SE2,
        away_from_hull: FloatArray | None,
    ) -> _Expected:
        from dream.mapping import could_hide, that_would_show, within

        planner, protocol = self.planner, self.mission.protocol
        cell = protocol.cell
        # Of a hull more is believed than hints tell; see `Hull`.
        glimpses = self.glimpses if away_from_hull is None else None
        beside, hinted = self._beside(occupancy, completion, glimpses), 0.0
        places = self._places(occupancy, pose)
        if glimpses is not None:
            hoped_for = glimpses.hints(occupancy) & (self.vain.count < self.patience)
            hoped_for &= within(places, protocol.reach, cell)
            if completion.seen:
                # Likewise to what is done with middles of groups below.
                hopeful = within(places & ~occupancy.observed, protocol.reach, cell)
                hoped_for &= hopeful | that_would_show(occupancy, pose, 0.5 * cell, hoped_for & ~hopeful)
            hinted = float(beside[hoped_for].sum()) * cell**2
        hopeless = ~within(places, protocol.reach, cell) | (self.vain.count >= self.patience)
        hiding = could_hide(occupancy, self.size, hopeless)
        if completion.seen:
            # Here the mission may end, so that what no known place can see is left out: behind a wall, say.
            # But places that the vehicle might yet get to may see more than that; only elsewhere it is asked.
            hopeful = within(places & ~occupancy.observed, protocol.reach, cell)
            hiding &= hopeful | that_would_show(occupancy, pose, self.size, hiding & ~hopeful)
        unnoticed = None if glimpses is None else glimpses.unnoticed(self.size, occupancy)
        hidden = float((hiding if unnoticed is None else unnoticed[hiding]).sum()) * cell**2
        searched = np.count_nonzero(occupancy.to_see) * cell**2 - hidden
        groups = Groups(planner.groups, planner.searched).after(len(completion.regions), searched)
        hull = self._expected_hull(occupancy, away_from_hull)
        if away_from_hull is not None:
            hidden *= planner.alone
        risk, rarity = groups.risk(hidden), 1.0
        if self.recall is not None:
            searched_cells = occupancy.to_see & ~hiding
            risk, rarity = self._with_survey(
                self.recall, groups, completion.regions, searched_cells, hiding, hidden
            )
        if planner.certify:
            risk = float(hiding.any())
        left = float(hull.sum())
        return _Expected(
            beside,
            hiding,
            self.calibration.calibrated(risk),
            groups.intensity * hidden,
            hull,
            left / (self.hull.found + left) if left else 0.0,
            away_from_hull,
            rarity,
            hinted,
        )

    def _beside(
        self, occupancy: OccupancyMap, completion: Completion, glimpses: Glimpses | None
    ) -> Float32Array:
        """(rows, cols) probability of a target beside those that were seen or hinted at."""
        from dream.mapping import within

        planner, cell = self.planner, self.mission.protocol.cell
        hints, evidence = np.zeros_like(occupancy.target), None
        if glimpses is not None:
            hints, evidence = glimpses.hints(occupancy), glimpses.evidence(occupancy)
        if not completion.regions and not hints.any():
            return np.zeros(occupancy.shape, np.float32)
        blur = planner.kernel * self.mission.protocol.group_radius
        near = within(occupancy.target | hints, 2.0 * blur, cell)
        beside = expectation(occupancy, blur, planner.prior, planner.prior_weight, near, evidence)
        if glimpses is not None:
            beside = glimpses.weighed(beside, occupancy)
        if completion.regions:
            row, col = completion.open_cells.T
            # A hole far from all targets must be closed, but holds none more likely than other ground does.
            least = np.where(near[row, col], planner.open_edge, planner.search)
            beside[row, col] = np.maximum(beside[row, col], least)
        return beside

    def _with_survey(
        self,
        recall: Recall,
        groups: Groups,
        regions: Sequence[Region],
        searched: BoolArray,
        hiding: BoolArray,
        hidden: float,
    ) -> tuple[float, float]:
        """The risk, not calibrated, with a survey as far as it is believed, and `_Expected.rarity`.

        Where it saw no group one must have come since. How many do is learnt as the number of groups is, from
        those that came to such ground, and the ground of which it was searched again.
        """
        came, empty = recall.came(regions), recall.empty
        share = float(np.count_nonzero(hiding & empty)) / max(int(np.count_nonzero(hiding)), 1)
        again = self.mission.protocol.cell**2 * np.count_nonzero(empty & searched)
        arriving = self.planner.arriving * max(recall.prior.years, 1.0)
        coming = Groups(arriving, self.planner.searched).after(came, again)
        told = 1.0 - (1.0 - groups.risk((1.0 - share) * hidden)) * (1.0 - coming.risk(share * hidden))
        rarity = min(coming.intensity / groups.intensity, 1.0)
        believed = recall.believed
        return (
            believed * told + (1.0 - believed) * groups.risk(hidden),
            believed * rarity + 1.0 - believed,
        )

    def _expected_hull(self, occupancy: OccupancyMap, away_from_hull: FloatArray | None) -> FloatArray:
        """The belief about the hull, as far as it adjoins hull that was within reach.

        Farther away labels are not trusted, and where no target stands up there is no hull.
        """
        if away_from_hull is None or not len(self.hull.weights):
            return np.zeros(len(self.hull.weights))
        x, y = self.hull.middles[:, :2].T
        inside = occupancy.contains(x, y)
        inside[inside] = occupancy.to_see[occupancy.cell_of(x[inside], y[inside])]
        away = np.full(len(x), np.inf)
        away[inside] = away_from_hull[occupancy.cell_of(x[inside], y[inside])]
        return np.where(away <= ADJOINING, self.hull.weights, 0.0)

    def _places(self, occupancy: OccupancyMap, pose: SE2) -> BoolArray:
        """(rows, cols) cells that the vehicle might get to, for all that is known."""
        from scipy.ndimage import label

        protocol = self.mission.protocol
        room = occupancy.distance_to_solid >= protocol.body_radius + 0.5 * protocol.cell
        row, col = occupancy.cell_of(pose.x, pose.y)
        room[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2] = True
        parts, _ = label(room, np.ones((3, 3)))
        return np.asarray(parts == parts[row, col])

    # -------------------------------------------------------------------------------------- next target

    def prospect(self, thought: Thought, occupancy: OccupancyMap) -> Prospect:
        """What is worth looking at, by which plans are chosen."""
        expected, completion, travel = thought.expected, thought.completion, thought.travel
        planner, square = self.planner, self.mission.protocol.cell**2
        todo = ~occupancy.observed & (self.vain.count < self.patience)
        beside = expected.beside
        if self.recall is not None:
            beside = self.recall.weighed(beside, todo)
            # What keeps a region open must be seen, whatever was foretold there.
            row, col = completion.open_cells.T
            beside[row, col] = np.maximum(beside[row, col], expected.beside[row, col])
        ground = planner.eager * beside * square
        if not completion.regions and not expected.hiding.any():
            # Where no target was seen, all ground must be.
            row, col = completion.open_cells.T
            ground[row, col] = np.maximum(ground[row, col], planner.search * square)
        search = planner.search
        if expected.away_from_hull is not None:
            ground[expected.away_from_hull <= ADJOINING] *= BENEATH
            search *= planner.alone
        if self.walk is not None:
            # What lies beside targets comes into view where they are traversed; what keeps it open counts.
            is_open = np.zeros_like(todo)
            is_open[tuple(completion.open_cells.T)] = True
            ground[~is_open] = 0.0
            search *= expected.risk > planner.risk
        ground = np.where(todo, ground + NEGLIGIBLE, 0.0)
        hiding = np.where(expected.hiding, search * square, 0.0)
        if self.recall is not None:
            hiding[self.recall.empty] *= expected.rarity
        if self.glimpses is not None and expected.away_from_hull is None:
            hiding *= self.glimpses.unnoticed(self.size, occupancy)
        return Prospect(
            self.outlook,
            ground=self.outlook.on_tiles(ground),
            hiding=self.outlook.on_tiles(hiding),
            targets=self.outlook.on_tiles(np.where(todo, expected.beside * square, 0.0)),
            hidden=self.outlook.on_tiles(expected.hiding * square),
            listed=self._hull_views(expected, travel, occupancy),
        )

    @property
    def look_ahead(self) -> LookAhead:
        """How plans are chosen."""
        planner = self.planner
        return LookAhead(
            planner.width,
            planner.horizon,
            planner.discount,
            planner.tour,
            keep=KEEP,
            jump=planner.jump,
        )

    def _hull_views(self, expected: _Expected, travel: Travel, occupancy: OccupancyMap) -> Listed | None:
        """What of the hull is seen from the nodes around it."""
        weights = self.planner.eager * PATCH**2 * expected.hull
        if not weights.any():
            return None
        from scipy.spatial import cKDTree

        left = self.hull.middles[weights > 0.0, :2]
        rows, cols = np.nonzero(travel.reached)
        positions = travel.position(rows, cols)
        steps = travel.nearest[rows, cols]
        chosen = (rows % 4 == 0) & (cols % 4 == 0)
        chosen |= (rows % 2 == 0) & (cols % 2 == 0) & (steps <= 2 * NEAR)
        chosen |= ((rows + cols) % 2 == 0) & (steps <= NEAR)
        chosen &= cKDTree(left).query(positions)[0] <= self.mission.protocol.reach
        rows, cols, positions = rows[chosen], cols[chosen], positions[chosen]
        nodes = rows * self.outlook.cols + cols
        starts, elements = self.hull.visible(positions, weights > 0.0)
        return Listed(weights, expected.hull, self.hull.middles[:, :2], nodes, starts, elements)

    def _try_hull(self, pose: Pose) -> None:
        """From there, hope no more for what of the hull should be in view and is still to be seen."""
        row, col, heading = pose
        yaw = heading * self.mission.protocol.heading_step
        self.hull.give_up(self.outlook.position(row, col), yaw)

    def _leftover(
        self, completion: Completion, hiding: BoolArray, pose: SE2, occupancy: OccupancyMap
    ) -> tuple[Travel, Plan | None]:
        """The way to what only the map's own view of some pose still shows, near solid ground if need be."""
        from dream.mapping import within

        weights = np.zeros(occupancy.shape, np.float32)
        row, col = completion.open_cells.T
        weights[row, col] = 1.0
        could_hold = within(hiding, self.size, self.mission.protocol.cell)
        weights[could_hold & ~occupancy.observed] = 1.0
        weights[self.vain.count >= self.patience + 2] = 0.0
        for search in (careful_travel, travel_from):
            travel = search(pose, occupancy)
            views = all_views_from(travel, occupancy, weights)
            best = views.best(views.rates)
            if best is not None and best.rate > NOTHING:
                return travel, Plan(travel.path(best.pose), rate=0.0, later=0.0, cells=best.gain)
        return travel, None

    # ----------------------------------------------------------------------------------------- watchdog

    def _visits(self, pose: Pose, occupancy: OccupancyMap) -> int:
        """How often it has come to this pose since anything was new."""
        seen = achieved(occupancy) + int(self.hull.found)
        if seen != self.news:
            self.news = seen
            self.visits.clear()
        self.visits[pose] += 1
        return self.visits[pose]

    def _given_up(self, occupancy: OccupancyMap) -> float:
        """Square metres to be seen that never were and are hoped for no more: they count as searched."""
        given_up = ~occupancy.observed & (self.vain.count >= self.patience)
        return float(np.count_nonzero(given_up)) * self.mission.protocol.cell**2

    def _give_up(self, plan: Plan, occupancy: OccupancyMap) -> None:
        """Hope for nothing more from the views of a plan."""
        from dream.mapping import view

        for pose in plan.path:
            ground, middles = self.outlook.shown(pose)
            yaw = pose[2] * self.mission.protocol.heading_step
            shown = view(occupancy, *self.outlook.position(*pose[:2]), yaw) | ground | middles
            self.vain.count[shown & ~occupancy.observed] = GIVEN_UP
            self._try_hull(pose)


def achieved(occupancy: OccupancyMap) -> int:
    """Cells observed, and targets among them that the protocol wants traversed and that were."""
    return int(
        np.count_nonzero(occupancy.observed) + np.count_nonzero(occupancy.traversed & occupancy.target)
    )


def _away_from_hull(occupancy: OccupancyMap) -> FloatArray | None:
    """(rows, cols) metres to the nearest target that stands up from the seabed.

    None where no more of them do than a boulder among targets would make it seem.
    """
    from scipy.ndimage import distance_transform_edt

    cell, stands = occupancy.protocol.cell, occupancy.target & occupancy.solid
    if np.count_nonzero(stands) * cell**2 < STANDS:
        return None
    return np.asarray(distance_transform_edt(~stands, cell))
