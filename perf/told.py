"""What not knowing costs: `belief`, and the same planner told what there is to see.

    python perf/told.py wrecks            those of the suite `dev`; twenty minutes on two cores
    python perf/told.py reefs             those of the suite `dev`, to 98.26 % only; five minutes
    python perf/told.py wrecks --seeds 1  the first of each only
    python perf/told.py parts             strings and fringes of seeds of their own; five minutes

Told of a wreck, it plans by the patches that are really unseen and by what the simulator says a pose shows of
them, from when it has found the hull; all else is the same. Told of a reef, it plans by the individuals in
ground that it has not observed, and once more so with the search for the shortest way round that a survey is
flown with (`dream.planning.coverage_tour`). What it then lacks to the best known tour is the search's fault,
what `belief` lacks to it is the belief's. Told of a part, it knows what lies within 4 m of the targets that
it has seen, or only what lies farther away, and believes what it always does of the rest.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from dream.evaluation.engines import processors
from dream.evaluation.metrics import COMPLETE, Scorer
from dream.evaluation.oracle.bounds import known_bounds
from dream.evaluation.statistics import interval, mean
from dream.evaluation.suites import Case, family_of, suite_named
from dream.mapping import OccupancyMap, within
from dream.mapping.hull import PATCH
from dream.mission import explore
from dream.planning import AnyPlanner, Belief
from dream.planning.coverage_tour import CoverageTour
from dream.planning.lookahead import Prospect
from dream.planning.pose_views import Listed
from dream.planning.sources import BeliefSource, Expected, HullSurface, Situation, TargetsBeside, Way, Worth
from dream.protocol import DREAM_V1
from dream.robots import Teleport
from dream.sim.files import world_hash
from dream.sim.render import Renderer
from dream.sim.visibility import Visibility
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import BoolArray, IntArray, Mission

NEAR = 10
"""Steps within which the view from every lattice node is listed; from every second one beyond."""
ONE = 0.05
"""Square metres of targets that an individual is told as."""
BESIDE = 4.0
"""Metres from seen targets up to which `belief` expects more of them by what it saw."""
PARTS = range(260_001, 260_017)
"""Seeds of the reefs of which parts are told; no suite has them."""
UNTOLD = Belief(glimpse=1.0)
"""Without hints from beyond the reach, which tell the usual planner much of the same."""
NEAR_TOLD, FAR_TOLD = "told of what is near", "told of what is far"


@dataclass(slots=True, eq=False)
class _ToldHull(HullSurface):
    """Knows the patches that are really unseen, from when it has found the hull."""

    visibility: Visibility = field(kw_only=True)
    shows: dict[int, list[IntArray]] = field(default_factory=dict)
    """By node, the patches that each heading shows."""
    seen: BoolArray = field(init=False)

    def __post_init__(self) -> None:
        self.seen = np.zeros(len(self.visibility), np.bool_)

    def take(self, situation: Situation) -> None:
        pose = situation.observation.pose
        self.seen |= self.visibility.seen([[pose.x, pose.y, pose.yaw]])[0]
        HullSurface.take(self, situation)

    def listed(self, expected: Expected, situation: Situation) -> Listed | None:
        travel, left = situation.travel, np.flatnonzero(self.visibility.countable & ~self.seen)
        if not expected.hull.any() or not len(left):
            return None
        lattice, points = travel.lattice, self.visibility.points[left]
        nodes = np.flatnonzero(travel.reached & (lattice.checkered | (travel.nearest <= NEAR)))
        away, _ = cKDTree(points[:, :2]).query(lattice.positions[nodes])
        nodes = nodes[away <= travel.protocol.reach]
        self._ask(nodes, lattice.positions[nodes])
        number = np.full(len(self.seen), -1)
        number[left] = np.arange(len(left))
        lists = [number[patches] for node in nodes for patches in self.shows[int(node)]]
        lists = [patches[patches >= 0] for patches in lists]
        starts = np.concatenate([[0], np.cumsum([len(patches) for patches in lists], dtype=np.int64)])
        worth = np.full(len(left), self.eager * PATCH**2)
        elements = np.concatenate([np.zeros(0, np.int64), *lists])
        return Listed(worth, np.ones(len(left)), points[:, :2], nodes, starts, elements)

    def _ask(self, nodes: IntArray, positions: npt.NDArray[np.float64]) -> None:
        """Have the simulator say what those nodes show that it was not asked about yet."""
        headings, step = DREAM_V1.headings, DREAM_V1.heading_step
        new = np.array([int(node) not in self.shows for node in nodes], np.bool_)
        yaws = np.tile(np.arange(headings) * step, int(new.sum()))
        shown = self.visibility.seen(np.column_stack([np.repeat(positions[new], headings, axis=0), yaws]))
        for k, node in enumerate(nodes[new]):
            self.shows[int(node)] = [np.flatnonzero(shown[k * headings + j]) for j in range(headings)]


@dataclass(slots=True, eq=False)
class _ToldOfReef(BeliefSource):
    """Knows the individuals in ground that was not observed, and nothing else counts."""

    visibility: Visibility
    coverage_tour: CoverageTour | None
    """Searches for the shortest way round them; None for the usual look-ahead."""

    def weigh(self, worth: Worth, expected: Expected, situation: Situation) -> None:
        worth.ground = ONE * _held(self.visibility, situation.occupancy)
        worth.search, worth.listed = 0.0, None

    def tour(self, expected: Expected, situation: Situation, prospect: Prospect) -> Way | None:
        if self.coverage_tour is None:
            return None
        leave = (1.0 - COMPLETE) * ONE * int(self.visibility.countable.sum())
        plan = self.coverage_tour.plan(prospect, situation.travel, situation.moves, leave)
        return None if plan is None else Way(situation.travel, plan, "")


@dataclass(frozen=True, slots=True)
class _ToldOfPart(BeliefSource):
    """Knows what lies beside the targets that it has seen, or only what lies farther away."""

    visibility: Visibility
    beside: bool
    eager: float

    def weigh(self, worth: Worth, expected: Expected, situation: Situation) -> None:
        cell = situation.occupancy.protocol.cell
        held = (_held(self.visibility, situation.occupancy) > 0.0).astype(float)
        near = within(situation.occupancy.target, BESIDE, cell)
        told = np.where(near, held, 0.0) if self.beside else np.where(near, expected.beside, held)
        worth.ground = self.eager * cell**2 * told
        worth.search *= self.beside


def _held(visibility: Visibility, occupancy: OccupancyMap) -> npt.NDArray[np.float64]:
    """(rows, cols) individuals in each cell."""
    held = np.zeros(occupancy.shape)
    np.add.at(held, occupancy.cell_of(*visibility.points[visibility.countable][:, :2].T), 1.0)
    return held


@dataclass(frozen=True, slots=True)
class _Told(Belief):
    """The planner that is told."""

    tell: Callable[[list[BeliefSource]], list[BeliefSource]] = field(kw_only=True)
    """What its usual sources become."""
    glimpse: float = UNTOLD.glimpse

    def sources(self, mission: Mission) -> list[BeliefSource]:
        return self.tell(Belief.sources(self, mission))


def _told_of_hull(visibility: Visibility, sources: list[BeliefSource]) -> list[BeliefSource]:
    return [
        _ToldHull(one.hull, one.lattice, one.eager, one.accepted, one.alone, visibility=visibility)
        if isinstance(one, HullSurface)
        else one
        for one in sources
    ]


def _told_of_reef(visibility: Visibility, way_round: bool, sources: list[BeliefSource]) -> list[BeliefSource]:
    return [*sources, _ToldOfReef(visibility, CoverageTour() if way_round else None)]


def _told_of_part(visibility: Visibility, beside: bool, sources: list[BeliefSource]) -> list[BeliefSource]:
    eager = next(one.eager for one in sources if isinstance(one, TargetsBeside))
    return [*sources, _ToldOfPart(visibility, beside, eager)]


def fly(case: Case) -> tuple[Case, dict[str, tuple[int | None, float]]]:
    """The missions in a world, and the best known tour: steps to 98.26 % and the share seen in the end.

    On a reef to 98.26 % only; what is told says nothing of the stop.
    """
    world = make_world(case.world, case.seed)
    visibility, renderer = Visibility(world, DREAM_V1), Renderer(world)
    found: dict[str, tuple[int | None, float]] = {}
    reef = not world.hull.any()
    told = {"told": _Told(tell=partial(_told_of_hull, visibility))}
    if reef:
        told = {
            name: _Told(tell=partial(_told_of_reef, visibility, way_round))
            for name, way_round in (("told", False), ("told, way round", True))
        }
    for name, planner in {"belief": UNTOLD, **told}.items():
        found[name] = _steps(world, planner, visibility, renderer, case.start)
    limits = known_bounds(DREAM_V1.name, case.world, case.seed, case.start, world_hash(world))
    if limits is None:
        raise RuntimeError(f"{case.world}, seed {case.seed}: no bounds are kept of it")
    for name, steps in (("best known tour", limits.t98.best_tour), ("bound", limits.t98.lower_bound)):
        found[name] = steps, 1.0
    return case, found


def fly_told_of_parts(case: Case) -> dict[str, int]:
    """Steps to 98.26 % of the missions in a world, by what is told."""
    world = make_world(case.world, case.seed)
    visibility, renderer = Visibility(world, DREAM_V1), Renderer(world)
    planners = {
        "belief": UNTOLD,
        NEAR_TOLD: _Told(tell=partial(_told_of_part, visibility, True)),
        FAR_TOLD: _Told(tell=partial(_told_of_part, visibility, False)),
    }
    flown = {
        name: _steps(world, planner, visibility, renderer, case.start)[0]
        for name, planner in planners.items()
    }
    return {name: DREAM_V1.cap if steps is None else steps for name, steps in flown.items()}


def _steps(
    world: World, planner: AnyPlanner, visibility: Visibility, renderer: Renderer, start: int
) -> tuple[int | None, float]:
    """A mission's steps to 98.26 %, and what it saw; on a reef it ends there."""
    scorer = Scorer(world, DREAM_V1, visibility=visibility, renderer=renderer)
    robot = Teleport(world, DREAM_V1, world.starts[start], renderer=renderer, solids=visibility.solids)
    for step in explore(robot, planner, OccupancyMap(world.bounds, DREAM_V1)):
        scorer.add(step)
        if not world.hull.any() and scorer.summary()["t98"] is not None:
            break
    summary = scorer.summary()
    return summary["t98"], summary["coverage"]["instances"]


def say_parts(count: int | None, jobs: int) -> None:
    """Fly what is told of parts, and print what knowing them saves."""
    for kind in ("reef/string", "reef/fringing"):
        cases = [Case(kind, seed) for seed in PARTS[:count]]
        with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
            flown = list(pool.map(fly_told_of_parts, cases))
        usual = np.array([found["belief"] for found in flown], float)
        print(f"{kind}, {len(flown)} worlds, belief: 98.26 % after {usual.mean():.1f} steps in the mean")
        for name in (NEAR_TOLD, FAR_TOLD):
            fewer = usual - [found[name] for found in flown]
            saved = interval(fewer, [kind] * len(fewer), mean)
            steps = f"{saved.value:.1f} steps [{saved.low:.1f}, {saved.high:.1f}]"
            print(f"{kind}, {name}: saves {steps}", flush=True)


def main() -> int:
    """Fly all in every world, and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("worlds", choices=("wrecks", "reefs", "parts"))
    parser.add_argument("--seeds", type=int, help="worlds of each kind; all unless given")
    parser.add_argument("--jobs", type=int, default=processors(), help="worlds at a time")
    options = parser.parse_args()
    if options.worlds == "parts":
        say_parts(options.seeds, options.jobs)
        return 0
    wrecks = options.worlds == "wrecks"
    cases = [case for case in suite_named("dev") if (family_of(case.world) == "wreck") == wrecks]
    first = min(case.seed for case in cases)
    if options.seeds is not None:
        cases = [case for case in cases if case.seed - first < options.seeds]
    flown: list[dict[str, tuple[int | None, float]]] = []
    with ProcessPoolExecutor(options.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        for case, found in pool.map(fly, cases):
            if not flown:
                heads = [f"{name}: 98.26 % at" + (" | seen" if wrecks else "") for name in found]
                print(f"| world | seed | {' | '.join(heads)} |")
                print(f"|---|{'--:|' * (1 + len(found) * (1 + wrecks))}")
            flown.append(found)
            cells = [
                f"{steps or '–'}" + (f" | {100.0 * seen:.1f} %" if wrecks else "")
                for steps, seen in found.values()
            ]
            print(f"| {case.world} | {case.seed} | {' | '.join(cells)} |", flush=True)
    for kind in sorted({case.world for case in cases}):
        for name in flown[0]:
            these = [found for case, found in zip(cases, flown, strict=True) if case.world == kind]
            times = [found[name][0] or DREAM_V1.cap for found in these]
            ratios = [t / (found["bound"][0] or np.nan) for t, found in zip(times, these, strict=True)]
            reached = sum(found[name][0] is not None for found in these)
            print(
                f"{kind}, {name}: 98.26 % in {reached}/{len(these)}, mean {np.mean(times):.1f} steps, "
                f"median {np.nanmedian(ratios):.2f} of the certified bound"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
