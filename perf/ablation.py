"""What each ingredient of the planner `belief` is worth: the reefs of the suite `dev` without it, paired.

    python perf/ablation.py --out ablation          goes on where it was broken off; 40 minutes on two cores
    python perf/ablation.py --out ablation --only "greedy" "no-tour"
    python perf/ablation.py --out ablation --starts 0 1 2    from more places in the same worlds

Differences are over the same worlds from the same starts; intervals at 95 % resample worlds within families,
of each world the mean over its starts.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dream.evaluation import statistics
from dream.evaluation.engines import Failure, Processes, processors
from dream.evaluation.results import Row, read_results
from dream.evaluation.runner import Plan, fly_plan
from dream.evaluation.suites import family_of, suite_named
from dream.planning import AnyPlanner, Belief
from dream.protocol import DREAM_V1

WHOLE = Belief()
VARIANTS: dict[str, tuple[str, AnyPlanner]] = {
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
    "short": ("six actions ahead", replace(WHOLE, horizon=6)),
    "narrow": ("eight sequences kept, not 48", replace(WHOLE, width=8)),
    "no-tour": ("sequences are judged by their own gain alone", replace(WHOLE, tour=0.0)),
    "no-discount": ("what is seen later is worth as much", replace(WHOLE, discount=1.0)),
    "no-cost": ("a step costs nothing", replace(WHOLE, step_cost=0.0)),
    "no-jump": ("never straight to one far view while the sequence shows anything", replace(WHOLE, jump=0.0)),
    "small-groups": ("groups of 1.5 m radius hide, as the protocol promises", replace(WHOLE, size=1.0)),
}
"""Name → what is different, and the planner."""


World = tuple[str, int]


def values(rows: Sequence[Row], cap: int) -> dict[str, dict[World, float]]:
    """Per world, the mean over its starts: steps to 98.26 %, steps to the own stop, success."""
    of_world: dict[World, list[Row]] = {}
    for row in rows:
        of_world.setdefault((row.world, row.seed), []).append(row)

    def means(of: Callable[[Row], float]) -> dict[World, float]:
        return {world: float(np.mean([of(row) for row in these])) for world, these in of_world.items()}

    return {
        "t98": means(lambda row: cap if row.t98 is None else row.t98),
        "stop": means(lambda row: cap if row.t_stop is None else row.t_stop),
        "success": means(lambda row: row.success),
    }


def main() -> int:
    """Fly what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("ablation"), help="folder to keep the missions in")
    parser.add_argument("--jobs", type=int, default=processors(), help="missions at a time")
    parser.add_argument(
        "--only", nargs="*", default=list(VARIANTS), help="variants to fly; the whole always is"
    )
    parser.add_argument("--starts", nargs="+", type=int, default=[0], help="of each world's four")
    options = parser.parse_args()
    names = ["belief", *(name for name in options.only if name != "belief")]
    if unknown := set(names) - set(VARIANTS):
        parser.error(f"--only: expected some of {', '.join(VARIANTS)}, got {', '.join(sorted(unknown))}")
    reefs = [case for case in suite_named("dev") if family_of(case.world) != "wreck"]
    cases = tuple(replace(case, start=start) for start in sorted(set(options.starts)) for case in reefs)
    plan = Plan("dev reefs", cases, {name: VARIANTS[name][1] for name in names}, DREAM_V1)
    for done, ended in enumerate(fly_plan(plan, options.out, Processes(options.jobs)), start=1):
        if isinstance(ended.outcome, Failure):
            print(f"failed: {ended.key}: {ended.outcome}", file=sys.stderr)
        print(f"\r{done}/{len(plan)} missions", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)

    found: dict[str, list[Row]] = {}
    for row in read_results(options.out).rows:
        found.setdefault(row.planner, []).append(row)
    whole = values(found["belief"], DREAM_V1.cap)
    print("| without | steps to 98.26 % | difference | own stop | difference | success |")
    print("|---|--:|--:|--:|--:|--:|")
    for name in names:
        these = values(found[name], DREAM_V1.cap)
        cells = [name]
        for measure in ("t98", "stop"):
            shared = sorted(these[measure].keys() & whole[measure].keys())
            ours = np.array([these[measure][key] for key in shared])
            change = ours - np.array([whole[measure][key] for key in shared])
            strata = [family_of(world) for world, _ in shared]
            difference = statistics.interval(change, strata, statistics.mean)
            apart = f"{difference.value:+.1f} [{difference.low:+.1f}, {difference.high:+.1f}]"
            cells += [f"{ours.mean():.1f}", "" if name == "belief" else apart]
        success = f"{sum(row.success for row in found[name])}/{len(found[name])}"
        print(f"| {' | '.join([*cells, success])} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
