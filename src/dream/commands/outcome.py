"""A mission in the simulator, flown to its end; and what is kept and told of it then."""

from __future__ import annotations

import contextlib
import logging
import traceback
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dream.commands.console import kept_interrupts, price, print_json, tell_lost, told_without_answer
from dream.commands.progress import stage, with_progress
from dream.ending import ENDED, also, reason
from dream.errors import MissionAborted
from dream.planning import AnyPlanner
from dream.planning.vlm import WIRE_TEST, Asking, Ranked, stands_in

if TYPE_CHECKING:
    from dream.evaluation.metrics import Scorer
    from dream.mapping.volume import Volume
    from dream.recording import RecordedStep
    from dream.sim.world import World
    from dream.types import Step

logger = logging.getLogger(__name__)

TRACEBACK = "traceback.txt"
"""File in the folder of a run that a planner or the program broke off by an error in its code."""


def fly_to_end(recorded: Generator[Step, None, None], title: str, total: int) -> BaseException | None:
    """Fly a mission to its end; returns what stopped it before, since what was flown is kept then too."""
    try:
        with contextlib.closing(recorded), kept_interrupts(between_steps=True) as check:
            warned = False
            for step in with_progress(recorded, title, total, "steps", at_most=True):
                check()
                warned = warned or _warned(step)
    except (KeyboardInterrupt, Exception) as stopped:  # noqa: BLE001 - whatever it was.
        return stopped
    return None


def tell_outcome(
    folder: Path,
    world: World,
    scorer: Scorer,
    planner: AnyPlanner,
    summary: Mapping[str, Any],
    stopped: BaseException | None,
    *,
    json: bool,
) -> int:
    """Keep what a mission came to in its folder, with the report, and print it.

    Args:
        folder: With its recording.
        world: Where it was flown.
        scorer: That was given all of its steps.
        planner: Who decided.
        summary: Of `runner.summarize`.
        stopped: What stopped it; None where it ended by itself.
        json: Print the summary as one JSON object, instead of in words.

    Returns:
        Exit status: 0, or 1 where no answer of its model counted.

    Raises:
        MissionAborted: It did not end by itself, or could not be kept whole.
    """
    from dream import recording
    from dream.evaluation.metrics import without_answer
    from dream.mapping.volume import Volume
    from dream.report import write_report

    tell_lost(getattr(planner, "record", None))
    page = None
    try:
        recording.write_summary(folder, summary)
        with stage("writing report.html"):
            if (folder / recording.VOLUME).exists():
                write_scene_of(folder, world, scorer, Volume.load(folder / recording.VOLUME))
            page = write_report(folder)
    except KeyboardInterrupt as interrupt:
        raise _aborted(interrupt, folder) from interrupt
    except OSError as full:
        stopped = also(stopped, full)
    if json:
        print_json(summary)
    else:
        record = getattr(planner, "record", None)
        replayed = getattr(planner, "replay_replies", None) is not None and record is None
        flown = recording.read_steps(folder)
        _print_outcome(summary, planner, flown, page, replayed=replayed)
    if stopped is not None:
        raise _aborted(stopped, folder, getattr(planner, "record", None)) from stopped
    return told_without_answer(without_answer(summary["vlm"]))


def write_scene_of(folder: Path, world: World, scorer: Scorer, volume: Volume) -> None:
    """What report and live page show in three dimensions."""
    from dream import recording
    from dream.evaluation.flown_scene import write_scene

    try:
        write_scene(folder, volume, recording.read_steps(folder), world, scorer)
    except ValueError as error:  # The rest of the report is worth as much without it.
        logger.warning("the view in three dimensions is left out: %s", error)


def _warned(step: Step) -> bool:
    """Say where a model gave no answer that counts: another decides there than the one that was chosen."""
    silent = next((exchange for exchange in step.decision.exchanges if exchange.fallback), None)
    if silent is None:
        return False
    logger.warning(
        "step %d: %s gave no answer that counts (%s); geometry decides there and wherever none comes",
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
    ended = ENDED[summary["ended"]]
    times = ", ".join(
        f"{100 * share:g} % at {summary[mark]}"
        for mark, share in MILESTONES.items()
        if summary[mark] is not None
    )
    print(f"{summary['world']} {summary['seed']} · {summary['planner']} · {summary['protocol']}")
    print(f"  {ended} after {summary['steps']} steps" + (", a success" if summary["success"] else ""))
    if summary["ended"] == "cap":
        print("  the mission was cut off there; --max-steps says where")
    if summary["home"] is not None:
        print(f"  {home_told(summary['home'])}")
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


def home_told(home: Mapping[str, Any]) -> str:
    """How it stood with the way home at the end, in a line."""
    where = "home" if home["reached"] else "not home, as it should be"
    why = f", where it went since {home['why']}" if home["why"] else ""
    units = {"steps": "steps", "time": "s", "battery": "Wh"}
    of = [(home["left"][name], unit) for name, unit in units.items() if name in home["left"]]
    left = ", ".join(f"{amount:.4g} {unit}" for amount, unit in of if amount >= 0.0)
    over = " and ".join(f"{-amount:.4g} {unit}" for amount, unit in of if amount < 0.0)
    said = [f"it is {where}{why}", f"over its budget by {over}" * bool(over)]
    return "; ".join(filter(None, [*said, f"left of what it had: {left}" * bool(left)]))


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
    said = [
        f"{vlm['fallbacks']} of {vlm['questions']} questions were decided by geometry ({reasons})"
    ] * bool(reasons)
    return "; ".join([*said, *([f"its answers: {outcomes}"] if outcomes else [])])
