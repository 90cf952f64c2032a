"""What each ingredient of the planner `belief` is worth: the suite `dev` without it, paired.

    python perf/ablation.py --out ablation          goes on where it was broken off; 50 minutes on two cores
    python perf/ablation.py --out ablation --only "greedy" "no-tour"
    python perf/ablation.py --out ablation --starts 0 1 2    from more places in the same worlds
    python perf/ablation.py --out fresh --fresh 25 --only no-discount    on 225 reefs that no suite has
    python perf/ablation.py --out near --without-hints --only short    looking within reach alone
    python perf/ablation.py --out wrecks --wrecks   the wrecks, by what is seen of them; half an hour

What is not in it is flown as well: its certificate, twice the look-ahead, lanes while no target was seen, and
keeping to the last way unless a new one is worth a step more.

Differences are over the same worlds from the same starts; intervals at 95 % resample worlds within families,
of each world the mean over its starts.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from dream.evaluation import statistics
from dream.evaluation.engines import Failure, Processes, processors
from dream.evaluation.results import Row, read_results
from dream.evaluation.runner import Plan, fly_plan
from dream.evaluation.suites import family_of, suite_named
from dream.lattice import Pose
from dream.mapping import OccupancyMap
from dream.planning import AnyPlanner, Belief, Lawnmower
from dream.planning.baselines.sweeping import Sweeping
from dream.planning.belief import BeliefPilot, Thought
from dream.planning.sources import BeliefSource, HintedTargets, HullSurface
from dream.planning.tours import rest_of
from dream.protocol import DREAM_V1
from dream.types import Decision, Mission, Observation
from stop import fresh_reefs, from_starts


@dataclass(frozen=True, slots=True)
class Without(Belief):
    """All sources but one kind."""

    left_out: type[BeliefSource] = BeliefSource

    def sources(self, mission: Mission) -> list[BeliefSource]:
        """Without it."""
        return [one for one in Belief.sources(self, mission) if not isinstance(one, self.left_out)]


@dataclass(frozen=True, slots=True)
class Insistent(Belief):
    """Whatever is left of a hull holds up the search for others."""

    def sources(self, mission: Mission) -> list[BeliefSource]:
        """The same, but for that."""
        sources = Belief.sources(self, mission)
        for source in sources:
            if isinstance(source, HullSurface):
                source.least = 0.0
        return sources


@dataclass(frozen=True, slots=True)
class InLanes(Belief):
    """Sweeps in lanes until it sees a target."""

    lanes: Lawnmower = field(default_factory=lambda: Lawnmower(swath=1.0, inset=0.5, least=0.25))
    """As `sweep-and-graze` lays them."""

    def begin(self, mission: Mission) -> BeliefPilot:
        """A pilot of its own."""
        return _InLanes(self, mission, self.look_ahead, sweeping=self.lanes.in_plane(mission))


@dataclass(slots=True)
class _InLanes(BeliefPilot):
    sweeping: Sweeping = field(kw_only=True)

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        thought = self.consider(observation, occupancy)
        if thought.plan is not None and not occupancy.target.any():
            decision = self.sweeping.decide(observation, occupancy)
            if not decision.done:
                return decision
        return self.act(thought, thought.plan)


@dataclass(frozen=True, slots=True)
class Hesitant(Belief):
    """Keeps to the rest of its last way unless a new one is worth more."""

    more: float = 1.0
    """Steps."""

    def begin(self, mission: Mission) -> BeliefPilot:
        """A pilot of its own."""
        return _Hesitant(self, mission, self.look_ahead, more=self.more)


@dataclass(slots=True)
class _Hesitant(BeliefPilot):
    more: float = field(kw_only=True)
    way: list[Pose] = field(default_factory=list)

    def consider(self, observation: Observation, occupancy: OccupancyMap) -> Thought:
        thought = BeliefPilot.consider(self, observation, occupancy)
        plan, travel = thought.plan, thought.travel
        if plan is not None and plan.choice is not None:
            rest = rest_of(self.way, travel, thought.situation.moves)
            if len(rest) > 1 and rest[1] != plan.path[1]:
                prospect = self.prospect(thought.expected, thought.situation)
                new, old = self.planner.look_ahead.judge(prospect, travel, [plan.path, rest])
                if new.value - old.value < self.more:
                    plan = old.plan
        self.way = [] if plan is None else plan.path
        return replace(thought, plan=plan)


WHOLE = Belief()
VARIANTS: dict[str, tuple[str, Belief]] = {
    "belief": ("all of it", WHOLE),
    "no-expectation": (
        "targets are expected in the cells next to known ones, not up to 4 m away",
        replace(WHOLE, kernel=0.1),
    ),
    "not-eager": (
        "what is expected beside known targets counts once, not three times",
        replace(WHOLE, eager=1.0),
    ),
    "greedy": ("one action ahead", replace(WHOLE, horizon=1)),
    "short": ("three actions ahead", replace(WHOLE, horizon=3)),
    "long": ("twelve actions ahead", replace(WHOLE, horizon=12)),
    "narrow": ("eight sequences kept, not 48", replace(WHOLE, width=8)),
    "no-tour": ("sequences are judged by their own gain alone", replace(WHOLE, tour=0.0)),
    "no-discount": ("what is seen later is worth as much", replace(WHOLE, discount=1.0)),
    "no-jump": ("never straight to one far view while the sequence shows anything", replace(WHOLE, jump=0.0)),
    "small-groups": ("groups of 1.5 m radius hide, as the protocol promises", replace(WHOLE, size=1.0)),
    "no-glimpses": ("what lies beyond the reach is not looked at", Without(left_out=HintedTargets)),
    "glimpse-10": ("no farther than 10 m", replace(WHOLE, glimpse=1.25)),
    "glimpse-12": ("no farther than 12 m", replace(WHOLE, glimpse=1.5)),
    "glimpse-16": ("no farther than 16 m", replace(WHOLE, glimpse=2.0)),
    "certify": ("ends only when all that can be seen was", replace(WHOLE, certify=True)),
    "lanes": ("sweeps in lanes until it sees a target", InLanes()),
    "hysteresis": ("keeps to its last way unless a new one is worth a step more", Hesitant()),
}
"""Name → what is different, and the planner."""
ON_WRECKS: dict[str, tuple[str, Belief]] = {
    "belief": VARIANTS["belief"],
    "insistent": ("what is left of a hull always holds up the search for others", Insistent()),
    "no-hull": ("no belief about the hull", Without(left_out=HullSurface)),
    **{
        name: VARIANTS[name]
        for name in ("greedy", "short", "long", "narrow", "no-tour", "no-discount", "no-jump")
    },
}


World = tuple[str, int]


def values(rows: Sequence[Row], cap: int) -> dict[str, dict[World, float]]:
    """Per world, the mean over its starts: steps to 98.26 %, to the own stop, percent seen at the end."""
    of_world: dict[World, list[Row]] = {}
    for row in rows:
        of_world.setdefault((row.world, row.seed), []).append(row)

    def means(of: Callable[[Row], float]) -> dict[World, float]:
        return {world: float(np.mean([of(row) for row in these])) for world, these in of_world.items()}

    return {
        "t98": means(lambda row: cap if row.t98 is None else row.t98),
        "stop": means(lambda row: cap if row.t_stop is None else row.t_stop),
        "seen": means(lambda row: 100.0 * row.instances),
    }


def main() -> int:
    """Fly what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("ablation"), help="folder to keep the missions in")
    parser.add_argument("--jobs", type=int, default=processors(), help="missions at a time")
    parser.add_argument("--wrecks", action="store_true", help="those of the suite, instead of its reefs")
    parser.add_argument(
        "--fresh", type=int, metavar="N", help="N reefs of each family that no suite has, not those of `dev`"
    )
    parser.add_argument(
        "--without-hints", action="store_true", help="none looks beyond the reach, the whole neither"
    )
    parser.add_argument("--only", nargs="*", help="variants to fly; the whole always is")
    parser.add_argument("--starts", nargs="+", type=int, default=[0], help="of each world's four")
    options = parser.parse_args()
    variants = ON_WRECKS if options.wrecks else VARIANTS
    chosen = list(variants) if options.only is None else options.only
    names = ["belief", *(name for name in chosen if name != "belief")]
    if unknown := set(names) - set(variants):
        parser.error(f"--only: expected some of {', '.join(variants)}, got {', '.join(sorted(unknown))}")
    if options.wrecks and options.fresh is not None:
        parser.error("--fresh: expected reefs, got --wrecks")
    worlds = [case for case in suite_named("dev") if (family_of(case.world) == "wreck") == options.wrecks]
    if options.fresh is not None:
        worlds = fresh_reefs(options.fresh)
    suite = "dev" if options.fresh is None else "fresh"
    cases = tuple(from_starts(worlds, options.starts))
    planners: dict[str, AnyPlanner] = {}
    for name in names:
        planner = variants[name][1]
        planners[name] = replace(planner, glimpse=1.0) if options.without_hints else planner
    plan = Plan(suite, cases, planners, DREAM_V1)
    for done, ended in enumerate(fly_plan(plan, options.out, Processes(options.jobs)), start=1):
        if isinstance(ended.outcome, Failure):
            print(f"failed: {ended.key}: {ended.outcome}", file=sys.stderr)
        print(f"\r{done}/{len(plan)} missions", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)

    found: dict[str, list[Row]] = {}
    wanted = {(case.world, case.seed, case.start) for case in cases}
    for row in read_results(options.out).rows:
        # The folder may hold more than was asked for now.
        if (row.world, row.seed, row.start) in wanted:
            found.setdefault(row.planner, []).append(row)
    whole = values(found["belief"], DREAM_V1.cap)
    shown = {"seen": "seen, %", "stop": "own stop"}
    if not options.wrecks:
        shown = {"t98": "steps to 98.26 %", "stop": "own stop"}
    print(f"| | {' | '.join(f'{name} | difference' for name in shown.values())} | success |")
    print(f"|---|{'--:|' * (2 * len(shown) + 1)}")
    for name in names:
        these = values(found[name], DREAM_V1.cap)
        cells = [name]
        for measure in shown:
            shared = sorted(these[measure].keys() & whole[measure].keys())
            ours = np.array([these[measure][key] for key in shared])
            change = ours - np.array([whole[measure][key] for key in shared])
            strata = [world if options.wrecks else family_of(world) for world, _ in shared]
            difference = statistics.interval(change, strata, statistics.mean)
            apart = f"{difference.value:+.1f} [{difference.low:+.1f}, {difference.high:+.1f}]"
            cells += [f"{ours.mean():.1f}", "" if name == "belief" else apart]
        success = f"{sum(row.success for row in found[name])}/{len(found[name])}"
        print(f"| {' | '.join([*cells, success])} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
