"""`dream fly`: one mission flown by hand, in a browser."""

from __future__ import annotations

import contextlib
import datetime
import shlex
import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import tyro

from dream.commands.console import check_max_steps, compiling_told, kept_interrupts, open_world
from dream.commands.outcome import fly_to_end, tell_outcome
from dream.commands.progress import stage
from dream.options import First
from dream.planning import HUMAN, LABEL, LABELLED, Human
from dream.protocol import protocol_for

if TYPE_CHECKING:
    from dream.evaluation.engines import Failure
    from dream.evaluation.results import Flown
    from dream.evaluation.runner import Plan
    from dream.protocol import SurveyProtocol
    from dream.types import Step

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Fly:
    """Fly one mission yourself, in a browser: what a person makes of what a planner is told.

    You see what a vision-language model is shown, and nothing of the truth. Each step is one of the
    protocol's; the guard, the cap and the scores are those of every planner. The folder that is left is like
    that of any run. With --bench the mission also becomes a row of a benchmark.

    Examples:
        dream fly --world reef/string
        dream fly --world reef/K --name ann --bench bench/paper
    """

    world: First[Annotated[str, tyro.conf.arg(metavar="WORLD")]] = "reef/string"
    """A name from `dream worlds`, or the folder of a saved world."""
    seed: First[int] = 1
    """Which world of that name: any number makes another."""
    start: int = 0
    """Which of the world's start poses, counted from 0."""
    out: First[Path] = Path("runs")
    """Folder in which the run's own folder is made."""
    max_steps: First[int | None] = None
    """Steps at most, that is decisions carried out. Unless given, the cap of the protocol: 300 or
    more, by the area; 200 in the plane."""
    protocol: First[str | None] = None
    """Rules of the survey: sensors, reach and cap. Unless given, dream-v2; those of the pool for a tank."""
    name: First[str | None] = None
    """Who flies: the planner is called human+NAME. Unless given, human."""
    bench: First[Path | None] = None
    """Folder of a benchmark, there already or not, in which the mission becomes a row. Each person flies a
    world of it once."""
    host: str = "127.0.0.1"
    """Address at which to listen. 0.0.0.0 lets other machines connect; all need the token of the address."""
    port: int | None = None
    """Port at which to listen. Unless given, 8412, or a free one where that is taken."""
    json: bool = False
    """Print the summary as one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0. A MissionAborted where the mission did not end by itself."""
        from dream.live.beside import check_installed

        check_installed()
        if self.port is not None and not 0 <= self.port <= 65535:
            raise ValueError(f"--port: expected 0 to 65535, got {self.port}")
        called = self._called()
        if self.bench is None:
            return self._fly(called)[0]
        return self._fly_as_row(called, self.bench)

    def _called(self) -> str:
        if self.name is None:
            return HUMAN
        if not LABEL.fullmatch(self.name):
            raise ValueError(
                f"--name: expected at most 40 letters, digits, dots and dashes, got {self.name[:80]!r}"
            )
        return f"{HUMAN}{LABELLED}{self.name}"

    def _fly(self, called: str) -> tuple[int, Flown]:
        """Fly it; the exit status, and what a benchmark keeps of it."""
        from dream import recording
        from dream.compiling import working_time
        from dream.evaluation.metrics import Scorer, sight_in
        from dream.evaluation.runner import (
            TracedPose,
            flown_mission,
            run_config,
            simulate,
            summarize,
            traced,
        )
        from dream.live.cockpit import served
        from dream.live.doors import Doors, made_token
        from dream.live.helm import Helmsman
        from dream.live.server import address, listen
        from dream.protocol import SHOWN
        from dream.sim.ordered import protocol_in
        from dream.sim.render import Renderer

        began, planner = working_time(), Human()
        poses: list[TracedPose] = []
        with compiling_told(), contextlib.ExitStack() as shown:
            with kept_interrupts() as check:
                with stage(f"opening {self.world} {self.seed}"):
                    world = open_world(self.world, self.seed)
                protocol = protocol_in(world, self.protocol)
                check_max_steps(self.max_steps, protocol)
                helm = Helmsman(protocol)
                with stage(f"preparing {world.name} {world.seed}"):
                    visibility, renderer = sight_in(world, protocol), Renderer(world)
                steps = simulate(
                    world,
                    helm,
                    protocol,
                    start=self.start,
                    max_steps=self.max_steps,
                    renderer=renderer,
                    solids=visibility.solids,
                    fineness=SHOWN,
                )
                config = run_config(
                    world,
                    called,
                    planner,
                    protocol,
                    world_from=self.world,
                    start=self.start,
                    max_steps=self.max_steps,
                )
                with stage(f"working out what counts in {world.name} {world.seed}"):
                    scorer = Scorer(world, protocol, visibility=visibility, renderer=renderer)
                doors = Doors(self.host, made_token())
                listening = listen(self.host, self.port)
                check()
            now = datetime.datetime.now(datetime.UTC)
            folder = recording.new_run_folder(self.out, world.name, world.seed, called, now)
            recording.write_config(folder, {**config, "command": self._line(protocol), "began": now})

            def annotated(step: Step) -> Mapping[str, Any]:
                coverage = scorer.add(step)
                poses.append(traced(step, coverage, scorer.mission_s))
                helm.note(step)
                return {"coverage": coverage.as_dict()}

            shown.enter_context(served(helm, doors, listening))
            sys.stderr.write(f"dream: fly at {address(doors, listening)}\n")
            recorded = recording.record(steps, folder, annotate=annotated)
            with recording.compiling_noted(folder):
                title = f"{called} · {world.name} {world.seed}"
                stopped = fly_to_end(recorded, title, self.max_steps or protocol.cap)
            summary = summarize(world, called, protocol, scorer, working_time() - began, stopped)
            helm.end(_outcome(summary, folder))
            status = tell_outcome(folder, world, scorer, planner, summary, stopped, json=self.json)
        return status, flown_mission(summary, poses, self.start, protocol.cap)

    def _line(self, protocol: SurveyProtocol) -> str:
        """The command line that flies it again."""
        words = ["dream", "fly", "--world", self.world, "--seed", str(self.seed), "--protocol", protocol.name]
        given = {"--start": self.start or None, "--max-steps": self.max_steps, "--name": self.name}
        for option, value in given.items():
            words += [] if value is None else [option, str(value)]
        return shlex.join(words)

    def _fly_as_row(self, called: str, folder: Path) -> int:
        """The same as a mission of a benchmark, whose folder is this one's until it is flown."""
        from dream.evaluation.report import write_report
        from dream.evaluation.runner import fly_plan

        engine = _AtTheHelm(lambda: self._fly(called))
        with contextlib.closing(fly_plan(self._plan(called, folder), folder, engine)) as missions:
            for mission in missions:
                if mission.kept:
                    raise ValueError(
                        f"--bench: expected a world that {called} has not flown in {folder}, got "
                        f"{self.world} {self.seed}. Somebody else says --name"
                    )
        with stage("writing the report"):
            page = write_report(folder)
        if not self.json:
            print(f"  a row of {page}")
        return engine.status[0]

    def _plan(self, called: str, folder: Path) -> Plan:
        """Its one mission."""
        from dream.evaluation.results import read_manifest
        from dream.evaluation.runner import Plan
        from dream.evaluation.suites import named_case, saved_case
        from dream.sim.worlds import is_saved

        if is_saved(Path(self.world)):
            case = saved_case(Path(self.world), self.start)
        else:
            case = named_case(self.world, self.seed, self.start)
        suite = f"{case.folder}/" if case.folder else f"{case.world} {case.seed}"
        if (folder / "manifest.json").exists():
            manifest = read_manifest(folder)
            if case.as_dict() in manifest["cases"]:
                suite = manifest["suite"].split(", ")[0]
        protocol = protocol_for(case.open().protocol, self.protocol)
        return Plan(suite, (case,), {called: Human()}, protocol, self.max_steps)


@dataclass(frozen=True, slots=True)
class _AtTheHelm:
    """An engine whose missions are flown by who sits here: one after the other, in this process."""

    fly: Callable[[], tuple[int, Flown]] = field(repr=False)
    status: list[int] = field(default_factory=list, repr=False)
    """Exit status of each."""

    def run(
        self, task: Callable[[T], Any], groups: Sequence[Sequence[T]]
    ) -> Generator[tuple[T, Any | Failure], None, None]:
        """See `Engine.run`. The task is not called: no function of a module can ask the person."""
        for group in groups:
            for flight in group:
                status, flown = self.fly()
                self.status.append(status)
                yield flight, flown


def _outcome(summary: Mapping[str, Any], folder: Path) -> tuple[str, ...]:
    """What the page says at the end, when the truth may be told."""
    seen = f"{summary['coverage']['instances']:.1%} of the individuals"
    how = "inspected" if summary.get("inspection") else "seen"
    ended = f"It was stopped after {summary['steps']} steps. " if summary["ended"] == "aborted" else ""
    return (f"{ended}{seen} were {how}.", f"The report lies in {folder}.")
