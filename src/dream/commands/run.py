"""`dream run`: one mission in a simulated world."""

from __future__ import annotations

import contextlib
import datetime
import logging
import sys
import traceback
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from dream.commands.console import (
    check_max_steps,
    check_writable,
    compiling_told,
    kept_interrupts,
    open_world,
    price,
    print_json,
    tell_lost,
    told_without_answer,
)
from dream.commands.ground import Ground
from dream.commands.mission import check_terminal, confirmed, draw_orders, given
from dream.commands.progress import stage, with_progress
from dream.commands.swim import Swim
from dream.ending import also, reason
from dream.errors import MissionAborted
from dream.options import First
from dream.own_code import own_planner
from dream.planning import PLANNERS, AnyPlanner, check_installed, planner_name
from dream.planning.vlm import WIRE_TEST, Asking, Ranked, stands_in

if TYPE_CHECKING:
    from dream.evaluation.metrics import Scorer
    from dream.mapping.volume import Volume
    from dream.orders import Orders
    from dream.protocol import SurveyProtocol
    from dream.recording import RecordedStep
    from dream.sim.world import World
    from dream.types import Step

    ChosenPlanner = AnyPlanner
else:
    ChosenPlanner = tyro.extras.subcommand_type_from_defaults(PLANNERS, sort_subcommands=False)

logger = logging.getLogger(__name__)

SCENE_EVERY = 10
"""Steps after which the live page gets a new view in three dimensions."""
TRACEBACK = "traceback.txt"
"""File in the folder of a run that a planner or the program broke off by an error in its code."""


@dataclass(frozen=True, slots=True)
class Run:
    """Fly one mission in a simulated world. Its folder keeps the recording, the report and the summary.

    A planner of your own is named by its file: dream run ./mine.py.

    Examples:
        dream run --world reef/string
        dream run sixsteps --world reef/mixed --seed 3
    """

    planner: ChosenPlanner = PLANNERS["belief"]
    """Who decides."""
    world: First[Annotated[str, tyro.conf.arg(metavar="WORLD")]] = "reef/string"
    """A name from `dream worlds`, or the folder of a saved world."""
    seed: First[int] = 1
    """Which world of that name: any number makes another."""
    start: int = 0
    """Which of the world's start poses, counted from 0."""
    out: First[Path] = Path("runs")
    """Folder in which the run's own folder is made."""
    max_steps: First[int | None] = None
    """Steps at most, that is decisions carried out. Unless given, the cap of the protocol: 200."""
    protocol: First[str | None] = None
    """Rules of the survey: sensors, reach and cap. Unless given, those that the world is made for."""
    mission: First[str | None] = None
    """Orders: a file that `dream mission` wrote. A planner that asks a model also takes plain words."""
    yes: bool = False
    """Take the orders as the model understood them, and ask nobody to confirm them."""
    keep_observations: bool = False
    """Keep all that is seen, to the last bit, as a dive does: about 0.2 MB a step. `dream replay` then plays
    it back, and `dream export` makes a data set of it."""
    live: First[bool] = False
    """Show the run in a browser, at an address that is printed."""
    json: bool = False
    """Print the summary as one JSON object and nothing else."""
    ground: Ground = field(default_factory=Ground)
    swim: Swim = field(default_factory=Swim)

    def __call__(self) -> int:
        """Exit status 0, or 1 where no answer of its model counted.

        A MissionAborted where the mission did not end by itself.
        """
        if self.live:
            from dream.live import beside

            beside.check_installed()
        check_installed(self.planner)
        words = self.mission is not None and given(self.mission) is None
        if words and not self.yes and isinstance(self.planner, Asking):
            check_terminal(self.planner)
        with contextlib.ExitStack() as shown:
            return self._fly_and_tell(shown)

    def _fly_and_tell(self, shown: contextlib.ExitStack) -> int:
        """The same; what has to stay until the outcome is told is left to `shown`."""
        from dream import recording
        from dream.compiling import working_time
        from dream.evaluation.metrics import Scorer, sight_in, without_answer
        from dream.evaluation.runner import run_config, simulate, summarize
        from dream.mapping.volume import Volume
        from dream.planning.vlm.orders import write_mission
        from dream.report import write_report
        from dream.robots.replay import keep
        from dream.sim.ordered import protocol_in
        from dream.sim.render import Renderer

        site = self.ground.where()
        if isinstance(self.planner, Asking):
            self.planner.line()  # What is missing to ask a model is told before anything compiles.
        began = working_time()
        with compiling_told():
            with kept_interrupts() as check:
                with stage(f"opening {self.world} {self.seed}"):
                    world = open_world(self.world, self.seed)
                protocol = protocol_in(world, self.protocol)
                check_max_steps(self.max_steps, protocol)
                swimming = self.swim.chosen(protocol)
                name = planner_name(self.planner)
                words, orders = "", None
                if self.mission is not None:
                    draft = None if self.yes else self.out / "mission.draft.png"
                    words, orders = _orders(self.mission, self.planner, world, protocol, draft)
                known = self.ground.known(site, self.planner, world.bounds, protocol, world)
                with stage(f"preparing {world.name} {world.seed}"):
                    visibility, renderer = sight_in(world, protocol), Renderer(world)
                steps = simulate(
                    world,
                    self.planner,
                    protocol,
                    start=self.start,
                    max_steps=self.max_steps,
                    orders=orders,
                    swimming=swimming,
                    renderer=renderer,
                    solids=visibility.solids,
                    prior=known.prior,
                )
                config = run_config(
                    world,
                    name,
                    self.planner,
                    protocol,
                    world_from=self.world,
                    start=self.start,
                    max_steps=self.max_steps,
                    orders=orders,
                    words=words,
                    swimming=swimming,
                )
                with stage(f"working out what counts in {world.name} {world.seed}"):
                    scorer = Scorer(world, protocol, visibility=visibility, renderer=renderer, orders=orders)
                check()
            # Only now: what is interrupted before it can fly leaves no folder.
            now = datetime.datetime.now(datetime.UTC)
            folder = recording.new_run_folder(self.out, world.name, world.seed, name, now)
            recording.write_config(folder, {**config, **known.config(), "began": now})
            if self.live:
                from dream.live.beside import shown_live

                shown.enter_context(shown_live(folder))
            if orders is not None:
                write_mission(folder / "mission.json", words, orders)
                draw_orders(orders, world.bounds, protocol, folder / "mission.png")
            known.keep(folder)
            if self.keep_observations or site is not None:
                steps = keep(steps, folder, protocol)

            def annotated(step: Step) -> Mapping[str, Any]:
                coverage = scorer.add(step)
                volume = step.occupancy.volume
                if self.live and volume is not None and step.index > 0 and step.index % SCENE_EVERY == 0:
                    _write_scene(folder, world, scorer, volume)
                return {"coverage": coverage.as_dict()}

            recorded = recording.record(steps, folder, annotate=annotated)
            total = self.max_steps or protocol.cap
            if orders is not None and orders.max_steps is not None:
                total = min(total, orders.max_steps)
            with recording.compiling_noted(folder):
                stopped = _fly(recorded, f"{name} · {world.name} {world.seed}", total)
        tell_lost(getattr(self.planner, "record", None))
        summary = summarize(world, name, protocol, scorer, working_time() - began, stopped)
        page = None
        try:
            recording.write_summary(folder, summary)
            with stage("writing report.html"):
                if (folder / recording.VOLUME).exists():
                    _write_scene(folder, world, scorer, Volume.load(folder / recording.VOLUME))
                page = write_report(folder)
        except KeyboardInterrupt as interrupt:
            raise _aborted(interrupt, folder) from interrupt
        except OSError as full:
            stopped = also(stopped, full)
        if self.json:
            print_json(summary)
        else:
            record = getattr(self.planner, "record", None)
            replayed = getattr(self.planner, "replay_replies", None) is not None and record is None
            flown = recording.read_steps(folder)
            _print_outcome(summary, self.planner, flown, page, replayed=replayed)
        if stopped is not None:
            raise _aborted(stopped, folder, getattr(self.planner, "record", None)) from stopped
        return told_without_answer(without_answer(summary["vlm"]))


def _write_scene(folder: Path, world: World, scorer: Scorer, volume: Volume) -> None:
    """What report and live page show in three dimensions."""
    from dream import recording
    from dream.evaluation.flown_scene import write_scene

    try:
        write_scene(folder, volume, recording.read_steps(folder), world, scorer)
    except ValueError as error:  # The rest of the report is worth as much without it.
        logger.warning("the view in three dimensions is left out: %s", error)


def run_with(path: str) -> type[Run]:
    """The command where the file of a planner stands in the place of a planner's name.

    Raises:
        PlannerFailed: See `own_planner`.
    """
    planner = own_planner(Path(path))
    chosen = tyro.extras.subcommand_type_from_defaults({Path(path).name: planner})
    options = [("planner", chosen, field(default=planner))]
    return make_dataclass("Run", options, bases=(Run,), frozen=True, slots=True)


def _orders(
    mission: str, planner: object, world: World, protocol: SurveyProtocol, draft: Path | None
) -> tuple[str, Orders]:
    """What the operator orders, in a file or in words for the planner's own model: the words, and the orders.

    Args:
        mission: The file or the words.
        planner: Who flies it.
        world: Where.
        protocol: By which rules.
        draft: File to draw the areas in while the operator is asked; None where nobody is asked.
    """
    from dream.evaluation.runner import labelled_in
    from dream.planning.vlm.orders import check_flyable

    if (known := given(mission)) is not None:
        check_flyable(known[1], world.bounds, protocol, labelled_in(world))
        return known
    if not isinstance(planner, Asking):
        raise ValueError(
            "--mission: expected a file .json, since this planner asks no model, got plain words. "
            "Let dream mission turn them into one"
        )
    if draft is not None:
        check_writable(draft.parent)
    wanted = None if draft is None else ("Fly this?", draft)
    return mission, confirmed(mission, planner, world, protocol, wanted, sys.stderr)


def _fly(recorded: Generator[Step, None, None], title: str, total: int) -> BaseException | None:
    """Fly a mission to its end; returns what stopped it before, since what was flown is kept then too."""
    try:
        with contextlib.closing(recorded), kept_interrupts() as check:
            warned = False
            for step in with_progress(recorded, title, total, "steps", at_most=True):
                check()
                warned = warned or _warned(step)
    except (KeyboardInterrupt, Exception) as stopped:  # noqa: BLE001 - whatever it was.
        return stopped
    return None


def _warned(step: Step) -> bool:
    """Say where a model gave no answer that counts: another decides there than the one that was chosen."""
    silent = next((exchange for exchange in step.decision.exchanges if exchange.fallback), None)
    if silent is None:
        return False
    logger.warning(
        "step %d: %s gave no answer that counts (%s); belief decides there and wherever none comes",
        step.index,
        silent.model,
        silent.fallback,
    )
    return True


def _aborted(why: BaseException, folder: Path, record: str | None = None) -> MissionAborted:
    from dream.recording import read_steps

    kept = read_steps(folder)
    said = f"aborted: {reason(why)}; {kept[-1].step if kept else 0} steps are kept in {folder}"
    # Of these the words say all; of a planner's code, or the program's, the place is wanted.
    if not isinstance(why, KeyboardInterrupt | MissionAborted | OSError | RuntimeError | ValueError):
        path = folder / TRACEBACK
        with contextlib.suppress(OSError):
            path.write_text("".join(traceback.format_exception(why)), encoding="utf-8")
            said += f". All of the error is in {path}"
    if isinstance(why, OSError) and not (folder / "report.html").exists():
        said += f". Once there is room: dream report {folder}"
    if isinstance(why, KeyboardInterrupt) and record is not None:
        said += f". To go on without asking again, say the same with --replay-replies {record}"
    return MissionAborted(said)


def _print_outcome(
    summary: Mapping[str, Any],
    planner: AnyPlanner,
    steps: Sequence[RecordedStep],
    page: Path | None,
    *,
    replayed: bool,
) -> None:
    from dream.evaluation.metrics import MILESTONES

    coverage = summary["coverage"]
    ended = {"done": "done", "cap": "out of steps", "aborted": "aborted"}[summary["ended"]]
    times = ", ".join(
        f"{100 * share:g} % at {summary[mark]}"
        for mark, share in MILESTONES.items()
        if summary[mark] is not None
    )
    print(f"{summary['world']} {summary['seed']} · {summary['planner']} · {summary['protocol']}")
    print(f"  {ended} after {summary['steps']} steps" + (", a success" if summary["success"] else ""))
    if summary["ended"] == "cap":
        print("  the mission was cut off there; --max-steps says where")
    if summary["ended"] == "aborted":
        print(f"  why: {summary['why']}")
    if steps:
        # What it holds to be complete, and with which risk; some planners only say what they do.
        reasoning = steps[-1].reasoning
        asked = steps[-1].asked
        whose = "belief's" if asked is not None and asked.fallback else "its"
        print(f"  {whose} last word: {reasoning.completion or reasoning.action}")
    for number, leg in enumerate(summary.get("legs", ()), start=1):
        print(f"  leg {number}, {leg['task']} {leg['target']}: {leg['outcome']}, {leg['steps']} steps")
    named = {"instances": "individuals", "clusters": "patches (half seen)", "area": "target area"}
    told, how = "seen", summary.get("inspection")
    if how is not None:
        told, named["clusters"] = "inspected", "patches (half of them)"
    print(f"  {told}: " + ", ".join(f"{coverage[key]:.1%} of the {name}" for key, name in named.items()))
    if how is not None:
        print(
            f"  that is {how['whole']:.1%} of all surface; {how['dropped']:.1%} of it cannot be inspected, "
            f"{how['seen']:.1%} of the individuals were seen at some angle"
        )
    if times:
        print(f"  steps until a share of the individuals was {told}: {times}")
    print(
        f"  {summary['collisions']} contacts, {summary['distance_m']:.0f} m "
        f"in {summary['mission_s']:.0f} s of the mission; computed in {summary['wall_s']:.1f} s"
    )
    if summary["position_error_m"]["rmse"] > 0.0:
        error = summary["position_error_m"]
        print(
            f"  it was {error['rmse']:.2f} m (rms) from where it believed to be, "
            f"{error['end']:.2f} m at the end: {summary['drift']:.2%} of the way"
        )
    if summary["vlm"] is not None:
        print(f"  {_asked(summary, 'replayed' if replayed else 'asked')}")
        print(f"  {_decided(summary['vlm'])}")
    elif isinstance(planner, Asking) and summary["ended"] != "aborted":
        why = ", no choice was close enough" if isinstance(planner, Ranked) else ""
        print(f"  asked {planner.label}: nothing{why}")
    if page is not None:
        print(f"  report: {page}")


def _asked(summary: Mapping[str, Any], done: str) -> str:
    """What asking a model came to, in a line."""
    vlm = summary["vlm"]
    return (
        f"{done} {vlm['model']}: {vlm['calls']} calls, {vlm['tokens']} tokens, {price(vlm['cost_usd'])}, "
        f"{vlm['latency_s']['p50']:.1f} s an answer, "
        f"waited {vlm['waited_s']:.0f} s of {summary['mission_s']:.0f} s"
        + (f"; a wire test, {WIRE_TEST}" if stands_in(vlm["model"]) else "")
    )


def _decided(vlm: Mapping[str, Any]) -> str:
    """Whose word counted, in a line."""
    reasons = ", ".join(f"{reason} {times}" for reason, times in vlm["reasons"].items())
    outcomes = ", ".join(f"{times} {outcome}" for outcome, times in vlm["outcomes"].items())
    said = [f"{vlm['fallbacks']} of {vlm['questions']} questions were decided by belief ({reasons})"] * bool(
        reasons
    )
    return "; ".join([*said, *([f"its answers: {outcomes}"] if outcomes else [])])
