"""`dream replay`: a recorded run again through the loop, and a dive's estimate again from its log."""

from __future__ import annotations

import contextlib
import datetime
import logging
import math
import shlex
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from dream import __version__, extras
from dream.commands.console import (
    check_writable,
    compiling_told,
    kept_interrupts,
    open_world,
    print_json,
)
from dream.commands.progress import stage, with_progress
from dream.names import look_up
from dream.options import First
from dream.own_code import SUFFIX, own_planner
from dream.planning import PLANNERS, AnyPlanner, Asking, check_installed, planner_name
from dream.planning.identity import identity
from dream.versions import commit

if TYPE_CHECKING:
    from dream.evaluation.again import Record
    from dream.evaluation.metrics import Logbook
    from dream.sim.world import World
    from dream.types import Step

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Replay:
    """Let a planner decide a recorded run again, and compare its decisions with the recorded ones.

    A dive, and a run that was flown with --keep-observations, are played back: map and planner get what was
    seen then. Any other run is flown again in the simulator. The same code decides the same. Where it does
    not, the first difference is told, and the exit status is 1. Another planner can be asked how it would
    decide in each place. Of a dive with its log, all filters estimate the track again.

    Examples:
        dream replay runs/latest
        dream replay runs/latest --planner lawnmower
    """

    run: tyro.conf.Positional[Path]
    """Folder of the run; runs/latest is the newest."""
    planner: First[Annotated[str | None, tyro.conf.arg(metavar="PLANNER")]] = None
    """Planner to ask: its name, or its file .py, with its default parameters. Unless given, the planner of
    the run, with its own parameters."""
    replay_replies: First[Path | None] = None
    """Folder of kept answers, for a planner that asks a model. Unless given, the one in which the run kept
    them."""
    estimator: Literal["all", "none", "inekf", "ekf", "cipg", "dead-reckoning"] = "all"
    """Filter that estimates the track of a dive again from log.mcap."""
    out: First[Path | None] = None
    """Folder in which a run folder of the replay is made, with its report. Unless given, none is made."""
    rerun: First[bool] = False
    """Write run.rrd for the Rerun viewer into the run's folder, and do nothing else."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0; 1 where the planner of then decides otherwise."""
        if self.rerun:
            return self._write_rerun()
        from dream.evaluation.again import answering, check_world, read_record

        record = read_record(self.run)
        planner = record.planner if self.planner is None else self._asked(record, self.planner)
        same_planner = record.was_flown_by(planner)
        if not (record.observed or record.config.dive is not None or same_planner):
            raise ValueError(
                f"--planner: expected a run with its observations, got one without: by {self.planner} it "
                f"would be another mission. Say: dream run {self.planner} --world {record.world_name} "
                f"--seed {record.config.seed} --protocol {record.config.protocol}"
            )
        planner = answering(planner, self.replay_replies)
        check_installed(planner)
        log = self._log(record)
        if self.out is not None:
            check_writable(self.out)
        with compiling_told(), kept_interrupts() as check:
            name = record.world_name
            with stage(f"opening {name} {record.config.seed}"):
                world = None if name is None else open_world(name, record.config.seed)
                if world is not None:
                    check_world(record, world)
            check()
            told, page = self._fly(record, planner, world)
            check()
            told["estimates"] = None if log is None else self._reckoned(record, log)
        told = {
            "run": str(self.run),
            "planner": planner_name(planner),
            "same_planner": same_planner,
            **told,
            "report": None if page is None else str(page),
        }
        if self.json:
            print_json(told)
        else:
            _print(record, told)
        return 1 if same_planner and told["first_difference"] is not None else 0

    def _write_rerun(self) -> int:
        from dream.live.rerun import write_rerun

        with stage("writing run.rrd"):
            path = write_rerun(self.run)
        if self.json:
            print_json({"run": str(self.run), "rerun": str(path)})
        else:
            print(f"{path}\nto look at it: rerun {shlex.quote(str(path))}")
            print("(the viewer tells its makers of its use; not after: rerun analytics disable)")
        return 0

    def _asked(self, record: Record, name: str) -> AnyPlanner:
        """The planner of a name; where it asks a model, that of then."""
        if name.endswith(SUFFIX):
            given: AnyPlanner = own_planner(Path(name))
            return given
        planner = look_up(PLANNERS, name, "planner")
        own = record.config.planner_file
        if isinstance(planner, Asking) and not own and isinstance(then := record.planner, Asking):
            return then.given_to(planner)
        return planner

    def _log(self, record: Record) -> Path | None:
        """The log to make estimates from; None where there is none, or none are wanted."""
        from dream.robots.bluerov2.log import NAME
        from dream.robots.bluerov2.mcap import McapFile

        log = record.folder / NAME
        if self.estimator == "none" or (self.estimator == "all" and not log.is_file()):
            return None
        if not log.is_file():
            raise ValueError(f"--estimator: expected a dive with its {NAME}, got {record.folder} without")
        extras.check_installed("rov", "the log (--estimator none leaves it alone)", "rosbags")
        McapFile(log)  # Something else is refused; one that is torn is read as far as it goes.
        return log

    def _fly(
        self, record: Record, planner: AnyPlanner, world: World | None
    ) -> tuple[dict[str, Any], Path | None]:
        """The mission again: how its decisions compare, and the page of its new run folder."""
        from dream import recording
        from dream.evaluation.again import Comparison, fly_again
        from dream.evaluation.metrics import Logbook, Scorer
        from dream.report import write_report

        began = time.perf_counter()
        name, config, protocol = planner_name(planner), record.config, record.protocol
        steps, comparison = fly_again(record, planner, world), Comparison(record)
        folder: Path | None = None
        with contextlib.ExitStack() as stack:
            if self.out is not None:
                now = datetime.datetime.now(datetime.UTC)
                folder = recording.new_run_folder(self.out, config.world, config.seed, name, now)
                recording.write_config(folder, {**_config(record, planner), "began": now})
                if (kept := record.folder / recording.PRIOR).is_file():
                    shutil.copyfile(kept, folder / recording.PRIOR)
                known = None if world is None else Scorer(world, protocol, orders=record.orders)
                logbook: Logbook = known or Logbook(protocol, orders=record.orders)
                recorded = recording.record(steps, folder, annotate=lambda step: _scored(step, logbook))
                steps = stack.enter_context(contextlib.closing(recorded))
            for step in with_progress(steps, f"{name} again", len(record.steps) - 1, "steps"):
                comparison.add(step)
        told = {"from": "observations" if record.observed else "simulator", **comparison.as_dict()}
        if folder is None:
            return told, None
        recording.write_summary(folder, _summary(record, planner, logbook, time.perf_counter() - began))
        with stage("writing report.html"):
            return told, write_report(folder)

    def _reckoned(self, record: Record, log: Path) -> dict[str, Any] | None:
        """The same; None where all were wanted and the log is torn so far that it tells of none."""
        try:
            return self._reckon(record, log)
        except ValueError as error:
            if self.estimator != "all":
                raise
            logger.warning("no estimate is made again: %s", error)
            return None

    def _reckon(self, record: Record, log: Path) -> dict[str, Any]:
        """How far the estimators are from the estimate of the dive, and from the truth where it is known."""
        from dream.geometry import SE2
        from dream.robots.bluerov2.estimates import Estimated, Tracks, estimates
        from dream.robots.bluerov2.navigation import ESTIMATORS

        tracks = Tracks()
        names = ESTIMATORS if self.estimator == "all" else (self.estimator,)

        def by_second(made: Iterator[Estimated]) -> Iterator[None]:
            second = 0
            for estimated in made:
                tracks.add(estimated)
                if int(estimated.time) > second:
                    second = int(estimated.time)
                    yield

        last = max(1, math.ceil(record.steps[-1].time))
        for _ in with_progress(by_second(estimates(log, names)), "making estimates", last, "s of the dive"):
            pass
        if not len(tracks):
            raise ValueError(f"{log}: expected estimates of the dive, got none in it")
        truth = [
            (step.time, SE2(step.truth.x, step.truth.y, step.truth.yaw))
            for step in record.steps
            if step.truth is not None
        ]
        dive = record.config.dive or {}
        told: dict[str, Any] = {"flown_with": dive.get("estimator"), "compared": len(tracks)}
        for name in names:
            far = tracks.from_truth(name, truth)
            told[name] = {
                "from_dive": asdict(tracks.from_logged(name)),
                "from_truth": None if far is None else asdict(far),
            }
        return told


def _scored(step: Step, logbook: Logbook) -> Mapping[str, Any]:
    from dream.evaluation.metrics import Scorer

    if isinstance(logbook, Scorer):
        return {"coverage": logbook.add(step).as_dict()}
    logbook.note(step)
    return {}


def _config(record: Record, planner: AnyPlanner) -> dict[str, Any]:
    """`config.json` of a replay: that of then, and by whom it was decided now."""
    return {
        **record.config.model_dump(),
        "version": __version__,
        "commit": commit(),
        **identity(planner_name(planner), planner),
        "command": shlex.join(["dream", "replay", str(record.folder), "--planner", planner_name(planner)]),
        "replay_of": str(record.folder),
    }


def _summary(record: Record, planner: AnyPlanner, logbook: Logbook, wall_s: float) -> dict[str, Any]:
    return {
        "protocol": record.protocol.name,
        "world": record.config.world,
        "seed": record.config.seed,
        "world_hash": (record.config.model_extra or {}).get("world_hash", ""),
        "planner": planner_name(planner),
        **logbook.summary(),
        "wall_s": round(wall_s, 3),
    }


def _print(record: Record, told: Mapping[str, Any]) -> None:
    from dream.evaluation.again import SAME

    config, first = record.config, told["first_difference"]
    how = "played back" if told["from"] == "observations" else "flown again in the simulator"
    print(f"{config.world} {config.seed} · {told['planner']} · {config.protocol} · {how}")
    asked = "" if told["same_planner"] else f", by {told['planner']} in the place of {config.planner}"
    print(f"  {told['agree']} of {told['steps']} decisions agree{asked}")
    if first is not None:
        print(f"  the first that differs is step {first['step']}: {first['how']}")
        if told["same_planner"]:
            print(f"  flown by {_code(config.version, config.commit)}, now by {_code(__version__, commit())}")
    far, turned = told["farthest_m"], told["farthest_deg"]
    if max(far, math.radians(turned)) > SAME:
        print(f"  it came up to {far:.2g} m and {turned:.2g}° from where it came then")
    if told["estimates"] is not None:
        _print_estimates(told["estimates"])
    if told["report"] is not None:
        print(f"  report: {told['report']}")


def _code(version: str, made_of: str | None) -> str:
    return version if made_of is None else f"{version} ({made_of[:10]})"


def _print_estimates(told: Mapping[str, Any]) -> None:
    """A table: how far each estimator is from the dive's own estimate, and from the truth."""
    from dream.evaluation.again import SAME

    rows: list[Sequence[str]] = [
        ("estimator", "from the dive's: rms", "end", "heading", "from truth: rms", "end")
    ]
    for name, far in told.items():
        if not isinstance(far, dict):
            continue
        own, truth = far["from_dive"], far["from_truth"]
        same = own["most"] <= SAME
        rows.append(
            (
                f"{name} (flown)" if name == told["flown_with"] else name,
                "the same" if same else f"{own['rmse']:.3f} m",
                "" if same else f"{own['end']:.3f} m",
                "" if same else f"{math.degrees(own['heading']):.2f}°",
                "not known" if truth is None else f"{truth['rmse']:.3f} m",
                "" if truth is None else f"{truth['end']:.3f} m",
            )
        )
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows:
        cells = [
            f"{cell:<{w}}" if k == 0 else f"{cell:>{w}}"
            for k, (cell, w) in enumerate(zip(row, widths, strict=True))
        ]
        print("  " + "  ".join(cells))
