"""`dream bench`: planners over the worlds of a suite."""

from __future__ import annotations

import contextlib
import re
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from dream.commands.console import check_no_world, print_json, with_scores
from dream.commands.homing import Homing
from dream.commands.progress import stage
from dream.commands.see import See, protocol_seen
from dream.commands.swim import Swim
from dream.errors import MissionAborted
from dream.flies import check_flies
from dream.names import look_up
from dream.options import First
from dream.own_code import SUFFIX
from dream.planning import (
    LABEL,
    LABELLED,
    OFFLINE,
    OFFLINE_IN_SPACE,
    PLANNERS,
    AnyPlanner,
    Asking,
    check_installed,
)
from dream.protocol import SurveyProtocol, protocol_for
from dream.telling import rich_console

if TYPE_CHECKING:
    from dream.evaluation.engines import Engine
    from dream.evaluation.results import Flown, Row
    from dream.evaluation.runner import Plan
    from dream.evaluation.sealed import Block
    from dream.evaluation.suites import Case

SEALED = "sealed"
"""The suite whose worlds a key makes."""


@dataclass(frozen=True, slots=True)
class Flying:
    """Options of every command that flies many missions."""

    planners: First[Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="PLANNER ...")]] = None
    """Names of planners. NAME+LABEL is one that asks a model, so that a folder holds several models. Unless
    given, belief, greedy and sixsteps; in the plane all that need no model and no network."""
    asking: Asking = field(default_factory=Asking)
    """For those of the planners that ask a model."""
    max_steps: int | None = None
    """Steps at most in a mission. Unless given, the cap of the protocol; more is not flown."""
    jobs: First[int | None] = None
    """Missions at a time. Unless given, one for each processor."""
    engine: Literal["process", "ray"] = "process"
    """Where to fly: in processes of this machine, or in a Ray cluster."""
    address: str | None = None
    """Address of the Ray cluster. Unless given, one that runs on this machine, else a fresh one."""
    keep_runs: bool = False
    """Keep the whole recording of each mission that is flown, in `runs` in the folder."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def chosen_planners(self, protocol: SurveyProtocol) -> dict[str, AnyPlanner]:
        """By name; a ValueError where there is none of that name, none, or one that does not fly by it."""
        names = self.planners
        if names is None:
            names = OFFLINE if protocol.space is None else OFFLINE_IN_SPACE
        if not names:
            raise ValueError(f"--planners: expected one or more of {', '.join(PLANNERS)}, got none")
        chosen = {name: _planner(name) for name in names}
        if len(chosen) < len(names):
            raise ValueError(f"--planners: expected each once, got {' '.join(names)}")
        chosen = self._with_their_model(chosen)
        for planner in chosen.values():
            check_flies(planner, protocol)
            check_installed(planner)
        return chosen

    def _with_their_model(self, chosen: dict[str, AnyPlanner]) -> dict[str, AnyPlanner]:
        """With the options for those that ask; a ValueError where these can reach no model."""
        askers = [name for name, planner in chosen.items() if isinstance(planner, Asking)]
        if not askers:
            if self.asking != Asking():
                every = [name for name, planner in PLANNERS.items() if isinstance(planner, Asking)]
                raise ValueError(
                    f"--planners: expected one that asks a model, such as {every[0]}, beside options for "
                    f"asking, got {' '.join(chosen)}"
                )
            return chosen
        kept = self.asking.replay_replies
        if kept is not None and kept != self.asking.record and not Path(kept).is_dir():
            raise ValueError(f"--replay-replies: expected a folder of kept replies, got {kept}")
        if not self.asking.model:
            raise ValueError(
                f"--model: expected which model {' and '.join(askers)} should ask, got none. Say --model "
                "openai:NAME, anthropic:NAME, google:NAME or the address of a server; the same to replay it"
            )
        # A model that cannot be asked at all is found out now, not once in every mission.
        self.asking.line()
        return {name: self.asking.given_to(planner) for name, planner in chosen.items()}

    def chosen_engine(self) -> Engine:
        """A ValueError where its options contradict each other, or it is not installed."""
        from dream.evaluation.engines import Processes, Ray, check_ray, processors

        if self.engine == "ray":
            # Before there is a folder, whose manifest would tell of an engine that flew nothing.
            check_ray()
            return Ray(self.jobs, self.address)
        if self.address is not None:
            raise ValueError(f"--address: expected --engine ray with it, got --engine {self.engine}")
        return Processes(processors() if self.jobs is None else self.jobs)


def _planner(name: str) -> AnyPlanner:
    """The planner of a name, which may have a label where it asks a model."""
    if name.endswith(SUFFIX):
        raise ValueError(
            f"--planners: expected names of planners that come with DREAM, got the file {name}. A planner of "
            f"your own is flown by dream run {name}, one mission at a time"
        )
    kind, plus, label = name.partition(LABELLED)
    planner = look_up(PLANNERS, kind, "planner")
    if plus and not (isinstance(planner, Asking) and LABEL.fullmatch(label)):
        raise ValueError(
            f"--planners: expected NAME{LABELLED}LABEL of one that asks a model, the label of at most 40 "
            f"letters, digits, dots and dashes, got {name}"
        )
    return planner


@dataclass(frozen=True, slots=True)
class Bench(Flying):
    """Fly planners over the worlds of a suite, side by side. Leaves a table of results and a report.

    Each mission is kept as soon as it ends. After an interruption the same command goes on with the others.
    More planners, worlds or seeds can be added to the same folder later.

    A sealed test flies worlds that nobody knows, drawn from the key that its keeper made with dream seal new.

    Examples:
        dream bench --world reef/string --seeds 1..5 --planners belief lawnmower
        dream bench paper
        dream bench sealed --key sealing.key --commitment 5c0f...
    """

    suite: tyro.conf.Positional[str | None] = None
    """`paper` (15 worlds; the default), `dev` (60, to tune on), `test` (200, to report), `sealed` (of a key),
    or a file .txt with worlds of your own, one a line."""
    world: First[Annotated[str | None, tyro.conf.arg(metavar="WORLD")]] = None
    """One world instead of a suite: a name from `dream worlds`, or the folder of a saved world."""
    seeds: First[Annotated[str | None, tyro.conf.arg(metavar="A..B")]] = None
    """Which worlds of that name: one seed, or the first and the last as A..B. Unless given, 1."""
    key: First[Annotated[Path | None, tyro.conf.arg(metavar="FILE")]] = None
    """Of `sealed`: file with its key, or opened blocks."""
    blocks: Annotated[str | None, tyro.conf.arg(metavar="A..B")] = None
    """Of `sealed`: numbers of its blocks, of 60 worlds each. Unless given, 0, or all in the file."""
    commitment: Annotated[tuple[str, ...], tyro.conf.arg(metavar="HEX ...")] = ()
    """Of `sealed`: what was published of each of these blocks. Other worlds are refused."""
    protocol: First[str | None] = None
    """Rules of the survey: sensors, reach and cap. Unless given, dream-v2; those of the pool for a tank."""
    see: See = "told"
    """Labels and depth as the simulator tells them, or as a network learned to see them in colours."""
    out: First[Path | None] = None
    """Folder of the benchmark. Unless given, one in `bench`."""
    swim: Swim = field(default_factory=Swim)
    homing: Homing = field(default_factory=Homing)

    def __call__(self) -> int:
        """Exit status 0; a MissionAborted where a mission failed or no answer of a model counted."""
        from dream.evaluation.runner import Plan
        from dream.evaluation.sealed import sealed
        from dream.evaluation.suites import SEALED_PROTOCOL

        engine, blocks = self.chosen_engine(), self._blocks()
        name, cases = self._cases() if not blocks else (SEALED, sum((each.cases() for each in blocks), ()))
        made_for = SEALED_PROTOCOL if blocks else cases[0].open().protocol
        protocol = protocol_for(made_for, protocol_seen(self.protocol, self.see))
        planners = self.chosen_planners(protocol)
        swimming = self.swim.chosen(protocol)
        sealing = sealed(blocks) if blocks else None
        plan = Plan(
            name,
            cases,
            planners,
            protocol,
            max_steps=self.max_steps,
            keep_runs=self.keep_runs,
            swimming=swimming,
            budget=self.homing.budget(),
            sealed=sealing,
        )
        default = self._folder(name) if sealing is None else f"{SEALED}-{sealing.key[:8]}"
        folder = self.out or Path("bench") / default
        outcome = fly(plan, folder, engine)
        if self.json:
            print_json(outcome.as_dict())
        else:
            outcome.print()
        outcome.check()
        return 0

    def _blocks(self) -> tuple[Block, ...]:
        """Of a sealed test; none where it is another suite. A ValueError where they are not as published."""
        from dream.evaluation.sealed import block_numbers, check_commitments, read_blocks

        if self.suite != SEALED:
            for option in ("key", "blocks", "commitment"):
                if getattr(self, option):
                    other = self.suite or self.world or "paper"
                    raise ValueError(f"--{option}: expected the suite {SEALED} with it, got {other}")
            return ()
        if self.world is not None or self.seeds is not None:
            raise ValueError(f"--world, --seeds: expected none beside {SEALED}, whose worlds its key makes")
        if self.key is None:
            raise ValueError(
                "--key: expected the file with the key of the sealed test, got none. dream seal new makes one"
            )
        blocks = read_blocks(self.key, None if self.blocks is None else block_numbers(self.blocks))
        if self.commitment:
            check_commitments(blocks, self.commitment)
        return blocks

    def _cases(self) -> tuple[str, tuple[Case, ...]]:
        from dream.evaluation.suites import named_case, saved_case, seeds_of, suite_named
        from dream.sim.worlds import is_saved

        if self.world is None:
            check_no_world("bench", self.suite or "")
            if self.seeds is not None:
                raise ValueError(f"--seeds: expected --world with it, got --seeds {self.seeds} alone")
            return self.suite or "paper", suite_named(self.suite or "paper")
        if self.suite is not None:
            raise ValueError(f"expected a suite or --world, got both: {self.suite} and --world {self.world}")
        if is_saved(Path(self.world)):
            case = saved_case(Path(self.world))
            if self.seeds is not None:
                raise ValueError(
                    f"--seeds: expected none beside a folder, whose world has its own, {case.seed}, "
                    f"got {self.seeds}"
                )
            return f"{case.folder}/", (case,)
        seeds = seeds_of(self.seeds or "1", "--seeds")
        named = f"{seeds[0]}..{seeds[-1]}" if len(seeds) > 1 else str(seeds[0])
        return f"{self.world} {named}", tuple(named_case(self.world, seed) for seed in seeds)

    def _folder(self, name: str) -> str:
        """Where a benchmark of that name is kept, below `bench`."""
        if self.world is None:
            name = Path(name).stem
        elif name.endswith("/"):
            name = Path(name).resolve().name
        return re.sub(r"[^A-Za-z0-9.]+", "-", name)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a benchmark came to."""

    plan: Plan
    folder: Path
    rows: tuple[Row, ...]
    """Of the missions asked for, in canonical order."""
    failures: tuple[tuple[Case, str, str], ...]
    """Case, planner and reason of each mission that failed."""
    report: Path | None

    def as_dict(self) -> dict[str, Any]:
        """For `--json`."""
        sealing = self.plan.sealed
        return {
            "out": str(self.folder),
            "suite": self.plan.suite,
            **({} if sealing is None else {"sealed": sealing.as_dict()}),
            "protocol": self.plan.protocol.name,
            "missions": [asdict(row) for row in self.rows],
            "failed": [
                {**case.as_dict(), "planner": planner, "error": error}
                for case, planner, error in self.failures
            ],
            "without_answer": self.without_answer,
            "report": str(self.report) if self.report else None,
        }

    @property
    def without_answer(self) -> list[str]:
        """Planners that asked a model in these missions, and of whose model no answer counted."""
        from dream.evaluation.comparison import share_unanswered

        return [planner for planner, share in share_unanswered(self.rows).items() if share == 1.0]

    def print(self) -> None:
        """A table, what failed, and where all of it lies."""
        from dream.evaluation.results import read_results
        from dream.evaluation.summary import print_summary

        console = rich_console(width=None if sys.stdout.isatty() else 120)
        if self.rows:
            print_summary(read_results(self.folder), console)
        for case, planner, error in self.failures:
            where = f"{planner} in {case.world} {case.seed}"
            console.print(f"failed: {where}: {error}", markup=False, highlight=False, soft_wrap=True)
        if self.plan.sealed is not None:
            last = max(self.plan.sealed.commitments)
            told = (
                f"these worlds are spent: results.csv names them. More of the same key: --blocks {last + 1}"
            )
            console.print(told, markup=False, highlight=False, soft_wrap=True)
        console.print(str(self.report or self.folder), markup=False, highlight=False, soft_wrap=True)

    def check(self) -> None:
        """Raise a MissionAborted where a mission failed, or all of a planner's are `belief`'s."""
        if self.failures:
            case, planner, error = self.failures[0]
            raise MissionAborted(
                f"{len(self.failures)} of {len(self.plan)} missions failed, first {planner} in {case.world} "
                f"{case.seed}: {error}. The others are kept in {self.folder}; the same command flies the rest"
            )
        if self.without_answer:
            raise MissionAborted(
                f"no answer of its model counted in any mission of {' and '.join(self.without_answer)}: "
                f"belief flew them all, and their rows in {self.folder} do not show what the model can do. "
                "--keep-runs keeps in replies what each reply lacked"
            )


def fly(plan: Plan, folder: Path, engine: Engine) -> Outcome:
    """Fly a benchmark while showing how it goes, and write its report."""
    from dream.evaluation.report import write_report

    flown, failures = fly_missions(plan, folder, engine)
    rows = [flown[c, p].row for c in plan.cases for p in plan.planners if (c, p) in flown]
    with stage("writing the report"):
        page = write_report(folder) if rows else None
    return Outcome(plan, folder, tuple(rows), tuple(failures), page)


def fly_missions(
    plan: Plan, folder: Path, engine: Engine
) -> tuple[dict[tuple[Case, str], Flown], list[tuple[Case, str, str]]]:
    """Fly the missions of a benchmark while showing how it goes.

    Returns:
        Those that were flown by case and planner, and of each that failed case, planner and reason.
    """
    from dream.evaluation.results import Flown
    from dream.evaluation.runner import fly_plan
    from dream.evaluation.suites import Case

    flown: dict[tuple[Case, str], Flown] = {}
    failures = []
    try:
        with contextlib.closing(fly_plan(plan, folder, engine)) as missions:
            for mission in with_scores(missions, plan):
                _, world, seed, start, planner = mission.key
                if isinstance(mission.outcome, Flown):
                    flown[Case(world, seed, start), planner] = mission.outcome
                else:
                    failures.append((Case(world, seed, start), planner, mission.outcome.message))
    except KeyboardInterrupt:
        raise MissionAborted(
            f"aborted: interrupted; {len(flown)} of {len(plan)} missions are kept in {folder}, "
            "and the same command goes on from there"
        ) from None
    return flown, failures
