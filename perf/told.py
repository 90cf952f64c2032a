"""What not knowing a wreck costs: `belief`, and the same search told what every pose shows.

    python perf/told.py                     the wrecks of the suite `dev`; twenty minutes on two cores
    python perf/told.py --seeds 1 --jobs 1  the first of each only

Told, it plans by the patches that are really unseen and by what the simulator says a pose shows of them, from
when it has found the hull; all else is the same. What it then lacks to the best known tour is the search's
fault, what `belief` lacks to it is the belief's.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from dream.evaluation.engines import processors
from dream.evaluation.metrics import Scorer
from dream.evaluation.oracle.bounds import known_bounds
from dream.evaluation.suites import Case, family_of, suite_named
from dream.mapping import OccupancyMap
from dream.mission import explore
from dream.planning import Belief
from dream.planning.belief import BeliefPilot, _Expected
from dream.planning.hull import PATCH
from dream.planning.outlook import Listed
from dream.planning.travel import Travel
from dream.protocol import DREAM_V1
from dream.robots import Teleport
from dream.sim.files import world_hash
from dream.sim.render import Renderer
from dream.sim.visibility import Visibility
from dream.sim.worlds import make_world
from dream.types import BoolArray, Decision, IntArray, Mission, Observation

NEAR = 10
"""Steps within which the view from every lattice node is listed; from every second one beyond."""


@dataclass(slots=True)
class _ToldPilot(BeliefPilot):
    visibility: Visibility = field(kw_only=True)
    shows: dict[int, list[IntArray]] = field(default_factory=dict)
    """By node, the patches that each heading shows."""
    seen: BoolArray = field(init=False)

    def __post_init__(self) -> None:
        BeliefPilot.__post_init__(self)
        self.seen = np.zeros(len(self.visibility), np.bool_)

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        pose = observation.pose
        self.seen |= self.visibility.seen([[pose.x, pose.y, pose.yaw]])[0]
        return BeliefPilot.decide(self, observation, occupancy)

    def _hull_views(self, expected: _Expected, travel: Travel, occupancy: OccupancyMap) -> Listed | None:
        left = np.flatnonzero(self.visibility.countable & ~self.seen)
        if not expected.hull.any() or not len(left):
            return None
        rows, cols = np.nonzero(travel.reached)
        positions = travel.position(rows, cols)
        chosen = ((rows + cols) % 2 == 0) | (travel.nearest[rows, cols] <= NEAR)
        points = self.visibility.points[left]
        chosen &= cKDTree(points[:, :2]).query(positions)[0] <= travel.protocol.reach
        nodes = (rows * self.outlook.cols + cols)[chosen]
        self._ask(nodes, positions[chosen])
        number = np.full(len(self.seen), -1)
        number[left] = np.arange(len(left))
        lists = [number[patches] for node in nodes for patches in self.shows[int(node)]]
        lists = [patches[patches >= 0] for patches in lists]
        starts = np.concatenate([[0], np.cumsum([len(patches) for patches in lists], dtype=np.int64)])
        worth = np.full(len(left), self.planner.eager * PATCH**2)
        elements = np.concatenate([np.zeros(0, np.int64), *lists])
        return Listed(worth, np.ones(len(left)), points[:, :2], nodes, starts, elements)

    def _ask(self, nodes: IntArray, positions: npt.NDArray[np.float64]) -> None:
        """Have the simulator say what those nodes show that it was not asked about yet."""
        headings, step = self.mission.protocol.headings, self.mission.protocol.heading_step
        new = np.array([int(node) not in self.shows for node in nodes], np.bool_)
        yaws = np.tile(np.arange(headings) * step, int(new.sum()))
        shown = self.visibility.seen(np.column_stack([np.repeat(positions[new], headings, axis=0), yaws]))
        for k, node in enumerate(nodes[new]):
            self.shows[int(node)] = [np.flatnonzero(shown[k * headings + j]) for j in range(headings)]


@dataclass(frozen=True, slots=True)
class _Told:
    """The planner that is told."""

    visibility: Visibility

    def begin(self, mission: Mission) -> _ToldPilot:
        return _ToldPilot(Belief(), mission, visibility=self.visibility)


def fly(case: Case) -> tuple[Case, dict[str, tuple[int | None, float]]]:
    """Both missions in a world, and the best known tour: steps to 98.26 % and the share seen in the end."""
    world = make_world(case.world, case.seed)
    visibility, renderer = Visibility(world, DREAM_V1), Renderer(world)
    found: dict[str, tuple[int | None, float]] = {}
    for name, planner in (("belief", Belief()), ("told", _Told(visibility))):
        scorer = Scorer(world, DREAM_V1, visibility=visibility, renderer=renderer)
        start, solids = world.starts[case.start], visibility.solids
        robot = Teleport(world, DREAM_V1, start, renderer=renderer, solids=solids)
        for step in explore(robot, planner, OccupancyMap(world.bounds, DREAM_V1)):
            scorer.add(step)
        summary = scorer.summary()
        found[name] = summary["t98"], summary["coverage"]["instances"]
    limits = known_bounds(DREAM_V1.name, case.world, case.seed, case.start, world_hash(world))
    found["best known tour"] = (None if limits is None else limits.t98.best_tour), 1.0
    return case, found


def main() -> int:
    """Fly both in every wreck and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4, help="worlds of each wreck")
    parser.add_argument("--jobs", type=int, default=processors(), help="worlds at a time")
    options = parser.parse_args()
    cases = [case for case in suite_named("dev") if family_of(case.world) == "wreck"]
    first = [case for case in cases if case.seed - min(c.seed for c in cases) < options.seeds]
    print("| world | seed | belief: 98.26 % at | seen | told: 98.26 % at | seen | best known tour |")
    print("|---|--:|--:|--:|--:|--:|--:|")
    rows = []
    with ProcessPoolExecutor(options.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        for case, found in pool.map(fly, first):
            rows.append(found)
            cells = [case.world, str(case.seed)]
            for name in ("belief", "told"):
                steps, seen = found[name]
                cells += [f"{steps or '–'}", f"{100.0 * seen:.1f} %"]
            print(f"| {' | '.join([*cells, str(found['best known tour'][0] or '–')])} |", flush=True)
    for name in ("belief", "told", "best known tour"):
        times = [row[name][0] for row in rows]
        reached = sum(t is not None for t in times)
        mean = np.mean([DREAM_V1.cap if t is None else t for t in times])
        print(f"{name}: 98.26 % in {reached}/{len(rows)}, mean {mean:.1f} steps")
    return 0


if __name__ == "__main__":
    sys.exit(main())
