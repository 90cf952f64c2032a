"""How often the stop of the planner `belief` is right, and how soon it comes: the reefs of the suite `dev`.

    python perf/stop.py                          some three minutes on two cores
    python perf/stop.py --bench bench/dev        with the planners of a benchmark beside it
    python perf/stop.py --starts 0 1 2 3         160 missions, from four places in each; some ten minutes
    python perf/stop.py --fresh 25               225 reefs that no suite has, 25 of each family

Until it ends a mission does not depend on the risk that is accepted. So each world is flown once, to the end
of all doubt, and what the planner believed step by step tells where it would have ended for another risk.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize, minimize_scalar
from scipy.special import expit, logit

from dream.evaluation.engines import Failure, Processes, processors
from dream.evaluation.metrics import COMPLETE, Scorer
from dream.evaluation.results import read_results
from dream.evaluation.statistics import share_interval
from dream.evaluation.suites import Case, family_of, suite_named
from dream.mapping import OccupancyMap, could_hide
from dream.mission import explore
from dream.planning import Belief
from dream.planning.belief import BeliefPilot
from dream.planning.distribution import GLIMPSED
from dream.planning.sources import Expected, HintedTargets, Situation
from dream.planning.sources.source import LEAVE
from dream.protocol import protocol_named
from dream.robots import Teleport
from dream.sim.render import Renderer
from dream.sim.visibility import Visibility
from dream.sim.worlds import make_world
from dream.types import LOOK_AROUND
from dream.types import Mission as MissionBrief

RISKS = (0.5, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01, 0.002, 0.0001)
FRESH = 310_001
"""Seed of the first reef of each family that no suite has."""
BY_MODEL = (0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0)
"""Between these, how often a risk that is not calibrated comes true."""
RADII = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0)
"""Metres."""


@dataclass(frozen=True)
class Mission:
    """One mission to the end of all doubt; one entry a step."""

    coverage: tuple[float, ...]
    closed: tuple[bool, ...]
    """Were there regions, all of them enclosed, and hardly any hints of targets left to look at?"""
    risk: tuple[float, ...]
    """As the planner believed it."""
    ended: bool
    """Whether it ended by itself in the end, whatever risk was left."""
    hidden: tuple[tuple[float, ...], ...]
    """Square metres where the middle of a group of each of `RADII` would not have been noticed."""
    hints: tuple[float, float, float, float]
    """Square metres: `came_true`, `hinted`, `foreseen` and `found` of the planner's `FarHints` in the end."""


@dataclass(slots=True)
class _WatchedPilot(BeliefPilot):
    said: list[tuple[bool, float]] = field(kw_only=True)

    def expect(self, situation: Situation) -> Expected:
        expected = BeliefPilot.expect(self, situation)
        completion, targets = situation.completion, np.count_nonzero(situation.occupancy.target)
        looked = expected.hinted <= LEAVE * (targets * self.mission.protocol.cell**2 + expected.hinted)
        self.said.append((completion.complete and bool(completion.regions) and bool(looked), expected.risk))
        return expected


@dataclass(frozen=True, slots=True)
class _Watched:
    """The planner, and what it believed at each decision: is all enclosed, and the risk."""

    said: list[tuple[bool, float]] = field(default_factory=list)
    pilots: list[BeliefPilot] = field(default_factory=list)

    def begin(self, mission: MissionBrief) -> _WatchedPilot:
        pilot = _WatchedPilot(Belief(risk=0.0), mission, Belief().look_ahead, said=self.said)
        self.pilots.append(pilot)
        return pilot


def fresh_reefs(of_each: int) -> list[Case]:
    """Reefs that no suite has: so many of each kind that is in `dev`."""
    kinds = dict.fromkeys(case.world for case in suite_named("dev") if family_of(case.world) != "wreck")
    return [Case(kind, FRESH + k) for kind in kinds for k in range(of_each)]


def from_starts(cases: Iterable[Case], starts: Iterable[int]) -> list[Case]:
    """Each of them from each of these starts."""
    return [replace(case, start=start) for start in sorted(set(starts)) for case in cases]


def flown(task: tuple[Case, str]) -> Mission:
    """Fly it."""
    case, name = task
    protocol, world = protocol_named(name), make_world(case.world, case.seed)
    visibility, renderer = Visibility(world, protocol), Renderer(world)
    scorer = Scorer(world, protocol, visibility=visibility, renderer=renderer)
    coverage: list[float] = []
    closed: list[bool] = []
    risk: list[float] = []
    hidden: list[tuple[float, ...]] = []
    planner = _Watched()
    robot = Teleport(world, protocol, world.starts[case.start], renderer=renderer, solids=visibility.solids)
    before, area = 0.0, (0.0,) * len(RADII)
    for step in explore(robot, planner, OccupancyMap(world.bounds, protocol)):
        if len(planner.said) > len(risk):  # Decided before this step's move, by what was seen until then.
            coverage.append(before)
            closed.append(planner.said[-1][0])
            risk.append(planner.said[-1][1])
            hidden.append(area)
        before = scorer.add(step).instances
        nothing = np.zeros(step.occupancy.shape, np.bool_)
        area = tuple(
            float(could_hide(step.occupancy, radius, nothing).sum()) * protocol.cell**2 for radius in RADII
        )
    source = next(source for source in planner.pilots[-1].sources if isinstance(source, HintedTargets))
    of = source.hints
    hints = (of.came_true, of.hinted, of.foreseen, of.found)
    return Mission(tuple(coverage), tuple(closed), tuple(risk), step.ended == "done", tuple(hidden), hints)


def intensity(area: npt.NDArray[np.float64], missed: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Groups per square metre of hidden ground that are likeliest, and the log-likelihood.

    Args:
        area: (n,) hidden ground at a step at which all regions were enclosed.
        missed: (n,) was anything missed that the mission needed?
    """

    def unlikely(log_intensity: float) -> float:
        none = np.exp(-np.exp(log_intensity) * area)
        return float(-np.log(np.clip(np.where(missed, 1.0 - none, none), 1e-12, 1.0)).sum())

    best = minimize_scalar(unlikely, bounds=(-14.0, -1.0), method="bounded")
    return float(np.exp(best.x)), -float(best.fun)


def told_and_came(
    missions: list[Mission],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
    """At steps at which all regions were enclosed: the model's risk, was anything missed, which mission."""
    told, came, which = [], [], []
    for k, mission in enumerate(missions):
        closed = np.array(mission.closed)
        told.append([GLIMPSED.uncalibrated(float(risk)) for risk in np.array(mission.risk)[closed]])
        came.append(np.array(mission.coverage)[closed] < COMPLETE)
        which.append(np.full(np.count_nonzero(closed), k))
    return np.concatenate(told), np.concatenate(came), np.concatenate(which)


def odds_that_came(
    told: npt.NDArray[np.float64], came: npt.NDArray[np.bool_], which: npt.NDArray[np.int64]
) -> tuple[float, float]:
    """`Calibration` of `dream.planning.distribution` that is likeliest, every mission alike."""
    odds = logit(np.clip(told, 1e-6, 1.0 - 1e-6))
    weight = 1.0 / np.bincount(which)[which]

    def unlikely(line: npt.NDArray[np.float64]) -> float:
        p = np.clip(expit(line[0] + line[1] * odds), 1e-9, 1.0 - 1e-9)
        return -float((weight * np.log(np.where(came, p, 1.0 - p))).sum())

    scale, power = minimize(unlikely, [0.0, 1.0], method="Nelder-Mead").x
    return float(np.exp(scale)), float(power)


def main() -> int:
    """Fly all and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bench", type=Path, help="folder of a benchmark of the same worlds")
    parser.add_argument("--protocol", default="dream-v1")
    parser.add_argument("--jobs", type=int, default=processors(), help="missions at a time")
    parser.add_argument(
        "--fresh", type=int, metavar="N", help="N reefs of each family that no suite has, not those of `dev`"
    )
    parser.add_argument("--starts", nargs="+", type=int, default=[0], help="of each world's four")
    options = parser.parse_args()
    protocol = protocol_named(options.protocol)
    cases = [case for case in suite_named("dev") if family_of(case.world) != "wreck"]
    if options.fresh is not None:
        cases = fresh_reefs(options.fresh)
    cases = from_starts(cases, options.starts)
    missions: list[Mission] = []
    groups = [[(case, protocol.name)] for case in cases]
    for task, outcome in Processes(options.jobs).run(flown, groups):
        if isinstance(outcome, Failure):
            print(f"failed: {task}: {outcome}", file=sys.stderr)
            continue
        missions.append(outcome)
        print(f"\r{len(missions)}/{len(cases)} missions", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)

    print("| stop | promised risk | missed 98.26 % | mean step | mean coverage |")
    print("|---|--:|--:|--:|--:|")
    for accepted in RISKS:
        steps, promised, coverage = [], [], []
        for mission in missions:
            ends = np.flatnonzero(np.array(mission.closed) & (np.array(mission.risk) <= accepted))
            end = int(ends[0]) if len(ends) else len(mission.risk) - 1
            # Where nothing is left that it knows a way to see, it ends with the risk that there is.
            done = len(ends) > 0 or mission.ended
            steps.append(end + LOOK_AROUND + 1 if done else protocol.cap)
            promised.append(mission.risk[end])
            coverage.append(mission.coverage[end])
        missed = [share < COMPLETE for share in coverage]
        interval = share_interval(sum(missed), len(missed))
        print(
            f"| belief, risk {accepted:g} | {np.mean(promised):.1%} | {np.mean(missed):.1%} "
            f"[{interval.low:.1%}, {interval.high:.1%}] | {np.mean(steps):.1f} | {np.mean(coverage):.2%} |"
        )
    told, came, which = told_and_came(missions)
    scale, power = odds_that_came(told, came, which)
    print(f"\nThe odds of the model come true {scale:.2f} times, to the power {power:.2f}")
    print("\n| by the model | steps | missions | told, mean | came true |")
    print("|---|--:|--:|--:|--:|")
    for low, high in itertools.pairwise(BY_MODEL):
        of_these = (low < told) & (told <= high)
        if of_these.any():
            print(
                f"| {low:.0%} to {high:.0%} | {of_these.sum()} | {len(np.unique(which[of_these]))} | "
                f"{told[of_these].mean():.1%} | {came[of_these].mean():.1%} |"
            )
    areas = np.concatenate([np.array(mission.hidden)[np.array(mission.closed)] for mission in missions])
    print(f"\n{len(areas)} steps at which all regions were enclosed, {came.mean():.1%} too early")
    print("\n| radius of a group | groups per 1000 m² hidden | log-likelihood |\n|--:|--:|--:|")
    for k, radius in enumerate(RADII):
        found, likelihood = intensity(areas[:, k], came)
        print(f"| {radius:g} m | {1000.0 * found:.2f} | {likelihood:.0f} |")
    true, hinted, foreseen, found = np.array([mission.hints for mission in missions]).T
    for what, part, whole in (
        ("came true", true, hinted),
        ("of targets were hinted at first", foreseen, found),
    ):
        shares, all_of_them = part[whole > 0.0] / whole[whole > 0.0], part.sum() / whole.sum()
        print(f"Hints: {all_of_them:.1%} {what}; {shares.min():.1%} to {shares.max():.1%} by mission")
    if options.bench is not None:
        print("\n| stop | missed 98.26 % | mean step | mean coverage | 98.26 % seen after |")
        print("|---|--:|--:|--:|--:|")
        rows = [row for row in read_results(options.bench).rows if family_of(row.world) != "wreck"]
        for name in dict.fromkeys(row.planner for row in rows):
            these = [row for row in rows if row.planner == name]
            ended = [protocol.cap if row.t_stop is None else row.t_stop for row in these]
            missed_share = np.mean([row.instances < COMPLETE for row in these])
            covered = np.mean([row.instances for row in these])
            seen = np.mean([protocol.cap if row.t98 is None else row.t98 for row in these])
            print(f"| {name} | {missed_share:.1%} | {np.mean(ended):.1f} | {covered:.2%} | {seen:.1f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
