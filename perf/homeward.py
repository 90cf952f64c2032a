"""Is a mission home within its budget, and what has it seen by then?

    python perf/homeward.py                                      hours on two cores; goes on where it was
    python perf/homeward.py --reefs 4 --wrecks 1                 some ten minutes
    python perf/homeward.py --protocol dream-v2-nav              swimming

Each world of `dev` is flown once without a budget. Then it may take a share of the seconds that this took,
and has to be home by then. What it saw stands beside 1, since who knows the world and has the same budget
sees no more than all of it: the ratio to that is at least what is told. Nothing is tuned on `test`.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from dream.evaluation.engines import Failure, Processes, processors
from dream.evaluation.metrics import Scorer, sight_in
from dream.evaluation.runner import simulate
from dream.evaluation.suites import Case, family_of, suite_named
from dream.homeward import Budget
from dream.planning import Belief
from dream.sim.ordered import protocol_in
from dream.sim.render import Renderer
from dream.types import Step

T = TypeVar("T")
F = TypeVar("F", bound=Any)
"""What is kept of a mission: a dataclass."""
SHARES = (0.3, 0.5, 0.7, 1.0)
"""Of what the free mission took."""


@dataclass(frozen=True, slots=True)
class Flown:
    """One mission."""

    world: str
    seed: int
    protocol: str
    share: float | None
    """Of the free mission's seconds; None of that mission itself."""
    ended: str
    steps: int
    seconds: float
    """On the mission's clock."""
    budget: float | None
    seen: float
    """Share of the individuals."""
    contacts: int
    watt_hours: float | None


Task = tuple[Case, str, tuple[float, ...], float | None]
"""A world, a protocol, shares to fly, and the seconds of the free mission; None where that is missing."""


def fly(task: Task) -> list[Flown]:
    """The missions in a world: the free one where it is missing, then those with a budget."""
    case, name, shares, seconds = task
    world = case.open()
    protocol = protocol_in(world, name)
    sight, renderer = sight_in(world, protocol), Renderer(world)

    def flown(share: float | None, budget: float | None) -> Flown:
        scorer = Scorer(world, protocol, visibility=sight, renderer=renderer)
        steps: Iterator[Step] = simulate(
            world,
            Belief(),
            protocol,
            start=case.start,
            renderer=renderer,
            solids=sight.solids,
            budget=None if budget is None else Budget(seconds=budget),
        )
        for step in steps:
            scorer.add(step)
        told, seconds = scorer.summary(), step.observation.time
        return Flown(
            world=case.world,
            seed=case.seed,
            protocol=name,
            share=share,
            ended=told["ended"],
            steps=told["steps"],
            seconds=seconds,
            budget=budget,
            seen=told["coverage"]["instances"],
            contacts=told["collisions"],
            watt_hours=step.observation.drawn_wh,
        )

    free = [flown(None, None)] if seconds is None else []
    whole = free[0].seconds if seconds is None else seconds
    return [*free, *(flown(share, share * whole) for share in shares)]


def missing(cases: list[Case], protocol: str, shares: list[float], kept: list[Flown]) -> list[Task]:
    """What is still to be flown."""
    tasks: list[Task] = []
    for case in cases:
        there = {
            one.share: one.seconds
            for one in kept
            if (one.world, one.seed, one.protocol) == (case.world, case.seed, protocol)
        }
        lacking = tuple(share for share in shares if share not in there)
        if lacking or None not in there:
            tasks.append((case, protocol, lacking, there.get(None)))
    return tasks


def chosen(reefs: int, wrecks: int) -> list[Case]:
    """The first reefs and wrecks of `dev`, kinds in turn."""
    cases = suite_named("dev")
    hulls = [case for case in cases if family_of(case.world).startswith("wreck")]
    others = [case for case in cases if case not in hulls]
    some = [others[k] for k in np.linspace(0, len(others) - 1, min(reefs, len(others))).round().astype(int)]
    return [*some, *hulls[:wrecks]]


def options(about: str, out: str, jobs: int) -> argparse.ArgumentParser:
    """Of a command that flies what is missing: how many workers fly, and where missions are kept."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=jobs)
    parser.add_argument("--out", type=Path, default=Path(out), help="where missions are kept")
    return parser


def kept_in(path: Path, kind: Callable[..., F]) -> list[F]:
    """The missions that a file holds, one a line; none where it is not there."""
    lines = path.read_text().splitlines() if path.exists() else []
    return [kind(**json.loads(line)) for line in lines]


def fly_and_keep(
    fly: Callable[[T], list[F]], tasks: list[T], jobs: int, path: Path
) -> Iterator[tuple[T, list[F]]]:
    """The missions of each task, once they are in the file; what fails is told, and left out."""
    with path.open("a") as file:
        for task, outcome in Processes(jobs).run(fly, [[task] for task in tasks]):
            if isinstance(outcome, Failure):
                print(f"{task}: {outcome.message}", file=sys.stderr)
                continue
            file.writelines(f"{json.dumps(asdict(one))}\n" for one in outcome)
            file.flush()
            yield task, outcome


def told(flown: list[Flown]) -> str:
    """A table: how many were home in time, and what they had seen."""
    heads = ("budget", "missions", "home", "late", "most used", "seen", "least", "contacts")
    lines = ["{:>8} {:>8} {:>5} {:>5} {:>9} {:>6} {:>6} {:>8}".format(*heads)]
    for share in dict.fromkeys(one.share for one in flown):
        some = [one for one in flown if one.share == share]
        home = [one for one in some if one.ended in ("done", "returned")]
        used = [one.seconds / one.budget for one in some if one.budget]
        late = sum(one > 1.0 for one in used)
        lines.append(
            f"{'none' if share is None else f'{share:.0%}':>8} {len(some):8} {len(home):5} {late:5} "
            f"{max(used, default=float('nan')):9.2f} {np.mean([one.seen for one in some]):6.3f} "
            f"{min(one.seen for one in some):6.3f} {sum(one.contacts for one in some):8}"
        )
    return "\n".join(lines)


def main() -> int:
    """Fly what is missing, and print the table of all."""
    parser = options(__doc__, "homeward.jsonl", processors())
    parser.add_argument("--reefs", type=int, default=40)
    parser.add_argument("--wrecks", type=int, default=10)
    parser.add_argument("--protocol", default="dream-v2")
    parser.add_argument("--shares", type=float, nargs="+", default=list(SHARES))
    given = parser.parse_args()
    kept = kept_in(given.out, Flown)
    tasks = missing(chosen(given.reefs, given.wrecks), given.protocol, given.shares, kept)
    for (case, *_), flown in fly_and_keep(fly, tasks, given.jobs, given.out):
        kept += flown
        print(f"{case.world} {case.seed}: {', '.join(f'{one.seen:.2f}' for one in flown)}", flush=True)
    print(told([one for one in kept if one.protocol == given.protocol]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
