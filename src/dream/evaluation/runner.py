"""Missions in the simulator: one, or a whole benchmark that can be interrupted and goes on where it was."""

from __future__ import annotations

import contextlib
import datetime
import json
import logging
import math
import shutil
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from dream import __version__, recording
from dream.course import Planner
from dream.ending import why
from dream.errors import MissionAborted
from dream.evaluation import machine
from dream.evaluation.engines import Engine, Failure
from dream.evaluation.locks import alone_at
from dream.evaluation.metrics import Coverage, Scorer, curve, sight_in
from dream.evaluation.results import (
    MAX_STEPS,
    Flown,
    MissionKey,
    Row,
    Trace,
    mission_path,
    read_manifest,
    read_mission,
    write_manifest,
    write_mission,
    write_tables,
)
from dream.evaluation.sealed import Sealed, blocks_told
from dream.evaluation.suites import Case
from dream.homeward import Budget
from dream.mapping import OccupancyMap
from dream.mapping.prior import Prior
from dream.mission import Robot, explore
from dream.orders import Orders, sentences, written
from dream.perception import Perception
from dream.planning import LABELLED, PLANNERS, AnyPlanner, planner_name
from dream.planning.identity import files_given, identity
from dream.planning.vlm.asking import Asking
from dream.planning.vlm.asking.failures import GONE
from dream.planning.vlm.asking.options import WHERE_KEPT
from dream.protocol import ORDERED, SHOWN, SurveyProtocol, protocol_named
from dream.robots import Swimming, Teleport
from dream.sim.files import world_hash
from dream.sim.inspection import Inspection
from dream.sim.ordered import ordered_in, protocol_in
from dream.sim.render import Renderer
from dream.sim.solids import Solids
from dream.sim.visibility import Visibility
from dream.sim.world import World
from dream.sim.worlds import WORLDS
from dream.sim.years import years_on
from dream.types import Step, Target
from dream.versions import commit

logger = logging.getLogger(__name__)


def check_fits(world: World, protocol: SurveyProtocol) -> None:
    """Raise a ValueError unless the world is made for a protocol of this lattice and altitude."""
    home = protocol_named(world.protocol)
    if (protocol.lattice, protocol.altitude) != (home.lattice, home.altitude):
        raise ValueError(
            f"protocol: {world.name} is made for {home.name}, got {protocol.name}, whose lattice of "
            f"{protocol.lattice} m and altitude of {protocol.altitude} m do not fit it"
        )


def simulate(
    world: World,
    planner: Planner,
    protocol: SurveyProtocol | None = None,
    *,
    start: int = 0,
    max_steps: int | None = None,
    orders: Orders | None = None,
    swimming: Swimming | None = None,
    renderer: Renderer | None = None,
    solids: Solids | None = None,
    prior: Prior | None = None,
    budget: Budget | None = None,
    fineness: int | None = None,
    perception: Perception | None = None,
) -> Iterator[Step]:
    """One mission of a planner in a world; see `mission.explore`.

    Args:
        world: Where.
        planner: Who decides; it never sees the world.
        protocol: By which rules; those that the world is made for unless given.
        start: Which of the world's start poses.
        max_steps: Decisions at most; the protocol's cap unless given.
        orders: What the operator orders; to map everything where None.
        swimming: What swims, where the protocol is of a vehicle that does.
        renderer: Of this world, where one is made already.
        solids: Of this world, where they are made already.
        prior: What an earlier survey holds of the same ground.
        budget: What it may spend until it is home; None where it need not go home.
        fineness: Pixels of colour along each side of a pixel of depth and labels; what the planner looks at
            unless given.
        perception: Tells labels and depth under a protocol of sight by which nothing swims; the network that
            comes with DREAM unless given.
    """
    if not 0 <= start < len(world.starts):
        raise ValueError(f"start: expected 0 to {len(world.starts) - 1} for {world.name}, got {start}")
    protocol = ordered_in(world, protocol or protocol_named(world.protocol))
    check_fits(world, protocol)
    if budget is not None:
        check_home(budget, world, protocol, solids, start=start)
    # A model is shown finer pictures than the map is made from; nobody else pays for them.
    if fineness is None:
        fineness = SHOWN if isinstance(planner, Asking) else 1
    chosen = swimming_under(protocol, swimming)
    launch = partial(Teleport, perception=perception) if chosen is None else chosen.launch
    robot: Robot = launch(
        world, protocol, world.starts[start], renderer=renderer, solids=solids, fineness=fineness
    )
    occupancy = OccupancyMap(world.bounds, protocol)
    target = labelled_in(world)
    return explore(
        robot,
        planner,
        occupancy,
        max_steps=max_steps,
        target=target,
        orders=orders,
        prior=prior,
        budget=budget,
    )


def check_home(
    budget: Budget,
    world: World,
    protocol: SurveyProtocol,
    solids: Solids | None = None,
    *,
    start: int = 0,
) -> None:
    """Raise a ValueError where a vehicle cannot come up from where it should go home to, or keep to the
    budget.

    Args:
        budget: With the place.
        world: Where.
        protocol: Whose vehicle.
        solids: Of this world, where they are made already.
        start: Which of the world's start poses.
    """
    budget.check(world.bounds, protocol)
    begins = world.starts[start]
    budget.check_from(begins.x, begins.y)
    if budget.home is None:
        return
    x, y = budget.home
    z = protocol.launch_height(float(world.terrain.height(x, y)))
    # Inside a boulder it touches nothing; on the way up it does.
    up = (solids or Solids(world)).sweep_through((x, y, -protocol.body_height), (x, y, z), protocol)
    if up.contact:
        raise ValueError(
            f"home: expected a place from which the vehicle can come straight up, got ({x:g}, {y:g}), where "
            f"something solid is. The mission starts at ({begins.x:g}, {begins.y:g})"
        )


def swimming_under(protocol: SurveyProtocol, swimming: Swimming | None) -> Swimming | None:
    """What swims by these rules; None where nothing has to, and a ValueError where something would."""
    if not protocol.swims:
        if swimming is not None:
            raise ValueError(
                "swimming: expected a protocol by which a vehicle swims, as dream-v1-nav, "
                f"got {protocol.name}"
            )
        return None
    return Swimming() if swimming is None else swimming


def labelled_in(world: World) -> Target:
    """The kind of target that the labels show there: any where there is hull and oysters."""
    if not world.hull.any():
        return Target.OYSTERS
    return Target.WRECK if world.hull.all() else Target.ANY


def summarize(
    world: World,
    planner_name: str,
    protocol: SurveyProtocol,
    scorer: Scorer,
    wall_s: float,
    stopped: BaseException | None = None,
) -> dict[str, Any]:
    """The object that `--json` prints and `summary.json` holds.

    Args:
        world: Where it was flown.
        planner_name: By whom.
        protocol: By which rules.
        scorer: That was given all of its steps.
        wall_s: Seconds that it took.
        stopped: What stopped it, or went wrong after its end; None where it ended by itself.
    """
    scored = scorer.summary()
    return {
        "protocol": protocol.name,
        "world": world.name,
        "seed": world.seed,
        "world_hash": world_hash(world),
        "planner": planner_name,
        **scored,
        "why": why("" if scored["ended"] == "aborted" else scored["ended"], stopped),
        "wall_s": round(wall_s, 3),
    }


def run_config(
    world: World,
    planner_name: str,
    planner: AnyPlanner,
    protocol: SurveyProtocol,
    *,
    world_from: str,
    start: int,
    max_steps: int | None,
    orders: Orders | None = None,
    words: str = "",
    swimming: Swimming | None = None,
    budget: Budget | None = None,
) -> dict[str, Any]:
    """`config.json` of a mission: enough to fly it again."""
    swims = swimming_under(protocol, swimming)
    return {
        "version": __version__,
        "commit": commit(),
        "protocol": protocol.name,
        "ordered": None if protocol.space is None else {name: getattr(protocol, name) for name in ORDERED},
        "bounds": asdict(world.bounds),
        "world": world.name,
        "seed": world.seed,
        "world_from": world_from,
        "world_hash": world_hash(world),
        "years_on": years_on(world.name),
        "start": start,
        **identity(planner_name, planner),
        "max_steps": max_steps,
        "swimming": None if swims is None else asdict(swims),
        "orders": None if orders is None else written(orders),
        "budget": None if budget is None else budget.as_dict(),
        "words": words,
        "understood": () if orders is None else tuple(sentences(orders, max_steps or protocol.cap)),
    }


@dataclass(frozen=True, slots=True)
class Flight:
    """One mission of a benchmark: enough to fly it in another process."""

    case: Case
    planner_name: str
    planner: AnyPlanner
    protocol: str
    max_steps: int | None = None
    swimming: Swimming | None = None
    """What swims, where the protocol is of a vehicle that does."""
    budget: Budget | None = None
    """What it may spend until it is home; None where it need not go home."""
    source: str = ""
    """Of the code that it must be flown by (`machine.source`); any where empty."""
    record_to: Path | None = None
    """Folder to leave a full recording in."""

    @property
    def key(self) -> MissionKey:
        """See `results.Row.key`."""
        return (self.protocol, self.case.world, self.case.seed, self.case.start, self.planner_name)


@dataclass(frozen=True, slots=True, eq=False)
class _Stage:
    """A world and what is prepared once for all missions in it. Flying changes nothing here."""

    world: World
    visibility: Visibility | Inspection
    renderer: Renderer


# One at a time: missions come world by world, and a wreck takes some hundred megabytes. Cases of one name
# may be of different folders.
@lru_cache(maxsize=1)
def _stage(world: str, seed: int, folder: str, world_hash: str, protocol: str) -> _Stage:
    made = Case(world, seed, folder=folder, world_hash=world_hash).open()
    return _Stage(made, sight_in(made, protocol_in(made, protocol)), Renderer(made))


def fly(flight: Flight) -> Flown:
    """Fly one mission and score it. Its outcome depends on nothing that was flown before.

    A mission that was aborted since the vehicle lost its way is scored by what it had done until then.

    Raises:
        ValueError: The flight is for other code than this, or its model could not be asked any more: what
            `belief` flew from then on would stand in its name.
    """
    if flight.source and flight.source != machine.source():
        raise ValueError(
            f"source: expected the code {flight.source[:12]} that the benchmark began with, "
            f"got {machine.source()[:12]}. Was it edited, or is another version installed here?"
        )
    began = time.perf_counter()
    case = flight.case
    stage = _stage(case.world, case.seed, case.folder, case.world_hash, flight.protocol)
    if flight.record_to is not None:  # What a broken-off try may have left.
        shutil.rmtree(flight.record_to, ignore_errors=True)
    return _fly_on(stage, flight, began)


def fly_mission(
    world: World,
    planner: Planner,
    protocol: SurveyProtocol | None = None,
    *,
    start: int = 0,
    max_steps: int | None = None,
    record_to: str | Path | None = None,
) -> Flown:
    """One mission of a planner in a world, flown to its end and scored: what a benchmark keeps of it.

    Args:
        world: Where.
        planner: Who decides: a dataclass of its parameters, as each of `PLANNERS` is.
        protocol: By which rules; those that the world is made for unless given.
        start: Which of the world's start poses.
        max_steps: Decisions at most; the protocol's cap unless given.
        record_to: A folder that is not there yet, for the run: its steps, pictures and report, as `dream run`
            leaves them. None keeps nothing.

    Returns:
        Its scores (`row`) and its way, step by step (`trace`).

    Raises:
        FileExistsError: `record_to` is there already.
        ValueError: The protocol is changed or does not fit the world, the start is none of the world's, there
            is no step to fly, or the planner is no dataclass.
    """
    if not hasattr(planner, "__dataclass_fields__"):
        raise ValueError(
            f"planner: expected a dataclass, whose fields are its parameters, got {type(planner).__name__}, "
            "which is none. Put @dataclass(frozen=True, slots=True) above it"
        )
    began = time.perf_counter()
    folder = None if record_to is None else Path(record_to)
    if folder is not None and folder.exists():
        raise FileExistsError(f"record_to: expected a folder that is not there yet, got {folder}")
    if max_steps is not None and max_steps < 1:
        raise ValueError(f"max_steps: expected at least 1, got {max_steps}")
    rules = protocol or protocol_named(world.protocol)
    if rules != protocol_named(rules.name):
        raise ValueError(
            f"protocol: expected {rules.name} as it is, got another, whose scores compare with nothing. "
            "Fly it with dream.simulate"
        )
    chosen: Any = planner
    flight = Flight(
        Case(world.name, world.seed, start),
        planner_name(chosen),
        chosen,
        rules.name,
        max_steps=max_steps,
        record_to=folder,
    )
    return _fly_on(_Stage(world, sight_in(world, ordered_in(world, rules)), Renderer(world)), flight, began)


def _fly_on(stage: _Stage, flight: Flight, began: float) -> Flown:
    """Fly and score a flight in a world that is prepared; see `fly`.

    Args:
        stage: The world.
        flight: Of that world.
        began: `time.perf_counter` when it was begun to be prepared.
    """
    protocol = protocol_in(stage.world, flight.protocol)
    scorer = Scorer(stage.world, protocol, visibility=stage.visibility, renderer=stage.renderer)
    steps = simulate(
        stage.world,
        flight.planner,
        protocol,
        start=flight.case.start,
        max_steps=None if flight.max_steps is None else min(flight.max_steps, protocol.cap),
        swimming=flight.swimming,
        budget=flight.budget,
        renderer=stage.renderer,
        solids=stage.visibility.solids,
    )
    poses: list[TracedPose] = []

    def score(step: Step) -> dict[str, Any]:
        for exchange in step.decision.exchanges:
            if isinstance(flight.planner, Asking) and exchange.fallback.startswith(GONE):
                raise flight.planner.gone(exchange.fallback)
        coverage = scorer.add(step)
        poses.append(traced(step, coverage, scorer.mission_s))
        return {"coverage": coverage.as_dict()}

    def outcome(stopped: MissionAborted | None) -> dict[str, Any]:
        wall_s = time.perf_counter() - began
        return summarize(stage.world, flight.planner_name, protocol, scorer, wall_s, stopped)

    stopped: MissionAborted | None = None
    if flight.record_to is None:
        try:
            for step in steps:
                score(step)
        except MissionAborted as aborted:
            stopped = aborted
    else:
        stopped = _record(flight, stage.world, protocol, steps, score, outcome)
    return flown_mission(outcome(stopped), poses, flight.case.start, protocol.cap)


def _record(
    flight: Flight,
    world: World,
    protocol: SurveyProtocol,
    steps: Iterator[Step],
    score: Callable[[Step], Mapping[str, Any]],
    outcome: Callable[[MissionAborted | None], Mapping[str, Any]],
) -> MissionAborted | None:
    """Fly a mission and leave its run folder. Returns what aborted it, if anything did."""
    from dream.report import write_report

    folder = flight.record_to
    assert folder is not None
    folder.mkdir(parents=True)
    config = run_config(
        world,
        flight.planner_name.partition(LABELLED)[0],
        flight.planner,
        protocol,
        world_from=flight.case.folder or world.name,
        start=flight.case.start,
        max_steps=flight.max_steps,
        swimming=flight.swimming,
        budget=flight.budget,
    )
    recording.write_config(folder, {**config, "began": datetime.datetime.now(datetime.UTC)})
    recorded = recording.record(steps, folder, annotate=score)
    stopped: MissionAborted | None = None
    try:
        with contextlib.closing(recorded):
            for _ in recorded:
                pass
    except MissionAborted as aborted:
        stopped = aborted
    recording.write_summary(folder, outcome(stopped))
    write_report(folder)
    return stopped


TracedPose = tuple[float, float, float, float, bool, float, float | None]
"""A step in a `Trace`, whose columns these are, rounded as they are written."""


def traced(step: Step, coverage: Coverage, seconds: float) -> TracedPose:
    """What a trace keeps of a step, given what its scorer said of it, and the mission's clock then."""
    pose = step.observation.pose
    # Adding 0.0 turns -0.0, which would be written differently, into 0.0.
    x, y, yaw = (round(v, 3) + 0.0 for v in (pose.x, pose.y, math.degrees(pose.yaw)))
    drawn = step.observation.drawn_wh
    drawn = None if drawn is None else round(drawn, 6)
    return x, y, yaw, round(coverage.instances, 6), step.arrival.collided, seconds, drawn


def flown_mission(summary: Mapping[str, Any], poses: Sequence[TracedPose], start: int, cap: int) -> Flown:
    """The row and the trace of a mission: the one place where they are put together.

    Args:
        summary: Of `summarize`.
        poses: Of all its steps, from the first look on.
        start: Which of the world's start poses.
        cap: Of the protocol.
    """
    x, y, yaw_deg, instances, collided, seconds, drawn = map(np.array, zip(*poses, strict=True))
    drawn_wh = None if None in drawn else drawn
    vlm = summary["vlm"] or {}
    same = (
        *("protocol", "world", "seed", "world_hash", "planner", "ended", "steps", "t_stop", "t_claimed"),
        *("t90", "t95", "t98", "t100", "countable", "collisions", "distance_m", "turns", "guarded"),
        *("min_clearance_m", "mission_s", "success", "wall_s", "why"),
    )
    values: dict[str, Any] = {
        "start": start,
        "cap": cap,
        **{name: summary[name] for name in same},
        **{name: summary["coverage"][name] for name in ("instances", "clusters", "area", "visible")},
        **{f"planner_ms_{name}": summary["planner_ms"][name] for name in ("p50", "p99")},
        **curve([pose[3] for pose in poses], cap),
        **{f"vlm_{name}": vlm.get(name) for name in ("calls", "tokens", "cost_usd", "fallbacks", "waited_s")},
        "vlm_questions": vlm.get("questions"),
    }
    return Flown(Row(**values), Trace(x, y, yaw_deg, instances, collided, seconds, drawn_wh))


@dataclass(frozen=True, slots=True)
class Plan:
    """A benchmark: every planner in every case, from the same starts and by the same rules."""

    suite: str
    """What the cases are called: a suite, or a world and its seeds."""
    cases: tuple[Case, ...]
    planners: Mapping[str, AnyPlanner]
    protocol: SurveyProtocol
    max_steps: int | None = None
    keep_runs: bool = False
    """Leave a full recording of each mission that is flown, below `runs/`."""
    swimming: Swimming | None = None
    """What swims, where the protocol is of a vehicle that does."""
    budget: Budget | None = None
    """What each mission may spend until it is home; None where none need go home."""
    sealed: Sealed | None = None
    """What may be told of the cases, where they are a sealed test's."""

    def __post_init__(self) -> None:
        swimming_under(self.protocol, self.swimming)
        if not self.cases:
            raise ValueError(f"cases: expected at least one world, got none in {self.suite}")
        _check_apart(self.cases)
        if len(set(self.cases)) < len(self.cases):
            raise ValueError(f"cases: expected each once, got one twice in {self.suite}")
        if ", " in self.suite:  # Which stands between the suites of a folder.
            raise ValueError(f"suite: expected a name without a comma, got {self.suite}. Rename it")
        if not self.planners:
            raise ValueError(f"planners: expected one or more of {', '.join(PLANNERS)}, got none")
        # In space each world has a cap of its own, which no mission goes beyond.
        most = self.protocol.cap if self.protocol.space is None else MAX_STEPS
        if self.max_steps is not None and not 1 <= self.max_steps <= most:
            cap = f", the cap of {self.protocol.name}" if self.protocol.space is None else ""
            raise ValueError(f"--max-steps: expected 1 to {most}{cap}, got {self.max_steps}")

    def __len__(self) -> int:
        return len(self.cases) * len(self.planners)


def _check_apart(cases: Sequence[Case]) -> None:
    """Raise a ValueError where two worlds have one name and seed."""
    known: dict[tuple[str, int], Case] = {}
    for case in cases:
        other = known.setdefault((case.world, case.seed), case)
        if case.world_hash and other.world_hash not in ("", case.world_hash):
            raise ValueError(
                f"cases: expected worlds that differ in name or seed, got {case.world} {case.seed} both in "
                f'{other.folder} and in {case.folder}. Change "name" or "seed" in a world.json'
            )


@dataclass(frozen=True, slots=True, eq=False)
class Ended:
    """A mission of a benchmark that is over."""

    key: MissionKey
    outcome: Flown | Failure
    kept: bool
    """It was flown before and is not flown again."""


def fly_plan(plan: Plan, folder: Path, engine: Engine) -> Generator[Ended, None, None]:
    """Fly what is missing of a benchmark, and yield each mission as it ends; those kept from before first.

    Whatever interrupts it, finished missions are on disk and the same call goes on with the others. More
    planners and worlds may join a folder later. When the iterator ends, fails or is closed, the tables of
    the folder hold all missions that are in it. Its missions do not depend on the engine, the number of
    workers or the order.

    Args:
        plan: What to fly.
        folder: Of the benchmark; see `dream.evaluation.results`.
        engine: Where to fly it.

    Raises:
        ValueError: The folder holds missions that do not belong beside these: other code, another protocol,
            other parameters. Or another process writes to it.
        OSError: The folder cannot be written.
    """
    began = time.perf_counter()
    check_fits(plan.cases[0].open(), plan.protocol)
    if plan.budget is not None:
        for case in plan.cases:
            check_home(plan.budget, case.open(), plan.protocol, start=case.start)
    with alone_at(folder, folder / ".lock"):
        manifest = _manifest(plan, folder, engine)
        write_manifest(folder, manifest)
        missing = []
        for flight in _flights(plan, folder, manifest):
            flown = _kept(folder, flight.key)
            if flown is None:
                missing.append(flight)
            else:
                yield Ended(flight.key, flown, kept=True)
        failed = []
        try:
            groups = [list(flights) for _, flights in groupby(missing, key=lambda flight: flight.case)]
            with contextlib.closing(engine.run(fly, groups)) as ended:
                for flight, outcome in ended:
                    if isinstance(outcome, Flown):
                        write_mission(folder, outcome)
                    else:
                        named = {**flight.case.as_dict(), "planner": flight.planner_name}
                        failed.append({**named, "error": outcome.message})
                    yield Ended(flight.key, outcome, kept=False)
        finally:
            missions = _all_kept(folder, manifest)
            write_tables(folder, missions)
            manifest["failed"] = failed
            every = len(missions) == len(manifest["cases"]) * len(manifest["planners"])
            manifest["finished"] = _now() if every else None
            manifest["wall_s"] = round(manifest["wall_s"] + time.perf_counter() - began, 3)
            write_manifest(folder, manifest)


def _flights(plan: Plan, folder: Path, manifest: Mapping[str, Any]) -> Iterator[Flight]:
    """Case after case, so that those of one world stand together."""
    for given in plan.cases:
        # A worker may stand elsewhere.
        case = replace(given, folder=given.folder and str(Path(given.folder).resolve()))
        for name, planner in plan.planners.items():
            flight = Flight(
                case,
                name,
                planner,
                plan.protocol.name,
                max_steps=plan.max_steps,
                swimming=plan.swimming,
                budget=plan.budget,
                source=manifest["source"],
            )
            record_to = folder.resolve() / "runs" / mission_path(folder, flight.key).stem
            yield replace(flight, record_to=record_to) if plan.keep_runs else flight


def _kept(folder: Path, key: MissionKey) -> Flown | None:
    """A mission that was flown before; None where there is none, or only a damaged file."""
    try:
        return read_mission(mission_path(folder, key))
    except FileNotFoundError:
        return None
    except ValueError as damage:
        logger.warning("%s; that mission counts as not flown", damage)
        return None


def _all_kept(folder: Path, manifest: Mapping[str, Any]) -> list[Flown]:
    """All missions of a folder in canonical order."""
    keys = [
        (manifest["protocol"]["name"], case["world"], case["seed"], case["start"], planner)
        for case in manifest["cases"]
        for planner in manifest["planners"]
    ]
    return [flown for key in keys if (flown := _kept(folder, key)) is not None]


def _manifest(plan: Plan, folder: Path, engine: Engine) -> dict[str, Any]:
    """What the folder holds once the plan is flown; a ValueError where the two do not belong together."""
    swims = swimming_under(plan.protocol, plan.swimming)
    now: dict[str, Any] = {
        "suite": plan.suite,
        "cases": [case.as_dict() for case in plan.cases],
        "worlds": {
            f"{case.world} {case.seed}": {"folder": case.folder, "world_hash": case.world_hash}
            for case in plan.cases
            if case.folder
        },
        "planners": {name: _as_json(planner) for name, planner in plan.planners.items()},
        "protocol": _as_json(plan.protocol),
        "max_steps": plan.max_steps,
        **({} if swims is None else {"swimming": _as_json(swims)}),
        **({} if plan.budget is None else {"budget": plan.budget.as_dict()}),
        "sealed": None if plan.sealed is None else plan.sealed.as_dict(),
        "files": {name: given for name, planner in plan.planners.items() if (given := files_given(planner))},
        **machine.code(),
        **machine.libraries(),
        "engine": repr(engine),
        "machine": machine.machine(),
        "later": [],
        "started": _now(),
        "finished": None,
        "failed": [],
        "wall_s": 0.0,
    }
    if (folder / "manifest.json").exists():
        before = read_manifest(folder)
        # Not the commit: one that changes a page must not end a benchmark, and the source says what counts.
        for name in ("version", "source", *machine.libraries(), "protocol", "max_steps"):
            _check_same(folder, name, before[name], now[name])
        for name in ("swimming", "budget"):
            _check_same(folder, name, before.get(name), now.get(name))
        if plan.sealed is not None or before.get("sealed") is not None:
            now["sealed"] = _sealed_together(folder, before.get("sealed"), plan.sealed)
        given_before = before.get("files", {})
        for name in before["planners"].keys() & now["planners"].keys():
            then, new = (_deciding(planners[name]) for planners in (before["planners"], now["planners"]))
            _check_same(folder, name, then, new)
            _check_same(folder, f"files of {name}", given_before.get(name, {}), now["files"].get(name, {}))
        _check_same_worlds(folder, before["worlds"], now["worlds"])
        now["worlds"] = before["worlds"] | now["worlds"]
        suites = dict.fromkeys([*before["suite"].split(", "), plan.suite])
        now["suite"] = ", ".join(suites)
        now["cases"] = before["cases"] + [case for case in now["cases"] if case not in before["cases"]]
        now["planners"] |= before["planners"]
        now["files"] |= given_before
        now["started"], now["wall_s"] = before["started"], before["wall_s"]
        # Results are the same elsewhere, times are not: every other engine and machine is told.
        here = {name: now[name] for name in ("engine", "machine")}
        now |= {name: before[name] for name in ("engine", "machine")}
        others = [entry for entry in before["later"] if entry != here]
        now["later"] = others + [here] * (here != {name: now[name] for name in here})
    elif (folder / "missions").exists():
        raise ValueError(
            f"{folder}: expected a manifest.json that tells how its missions were flown, got none. "
            "Choose another --out"
        )
    if plan.sealed is None:  # Else they stay in the order in which they were drawn.
        now["cases"].sort(key=lambda case: _rank_of_case(Case(**case)))
    now["planners"] = {name: now["planners"][name] for name in sorted(now["planners"], key=_rank_of_planner)}
    return now


def _sealed_together(folder: Path, before: Mapping[str, Any] | None, now: Sealed | None) -> dict[str, Any]:
    """What a folder tells of its sealed worlds once those blocks have joined it.

    Raises:
        ValueError: They are of another key, are other worlds, are not the next ones, or some of the worlds
            are no sealed test's.
    """
    if before is None or now is None:
        one, other = ("a sealed test", "others") if now is None else ("others", "a sealed test")
        raise ValueError(f"{folder}: expected worlds of {one}, as in it, got {other}. Choose another --out")
    _check_same(folder, "key of the sealed test", before["key"], now.key)
    known = {int(number): commitment for number, commitment in before["blocks"].items()}
    for number, commitment in now.commitments.items():
        _check_same(folder, f"block {number}", known.setdefault(number, commitment), commitment)
    numbers = list(known)
    if any(later != one + 1 for one, later in pairwise(numbers)):
        flown = list(map(int, before["blocks"]))
        raise ValueError(
            f"{folder}: expected block {flown[-1] + 1} after {blocks_told(flown)}, which are in it, "
            f"got {blocks_told(list(now.commitments))}. Intervals leave out no worlds"
        )
    return Sealed(now.key, known).as_dict()


def _deciding(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters on which a mission depends: not where the exchanges with a model are kept."""
    return {name: value for name, value in parameters.items() if name not in WHERE_KEPT}


def _check_same(folder: Path, name: str, before: Any, now: Any) -> None:
    if isinstance(before, dict) and isinstance(now, dict):
        for key in sorted(before.keys() | now.keys()):
            _check_same(folder, f"{name}.{key}", before.get(key), now.get(key))
    elif before != now:
        raise ValueError(
            f"{folder}: {name}: expected {before} as for the missions in it, got {now}. Choose another --out"
        )


def _check_same_worlds(folder: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Raise a ValueError where a world of the user's own has changed, be it that its name has too."""
    for name, world in now.items():
        for other, then in before.items():
            if name == other or world["folder"] == then["folder"]:
                what = f"{name} in {world['folder']}"
                _check_same(folder, what, then["world_hash"], world["world_hash"])


def _as_json(parameters: AnyPlanner | SurveyProtocol | Swimming) -> Any:
    """Parameters as they are read back from a file."""
    return json.loads(json.dumps(asdict(parameters)))


def _rank_of_case(case: Case) -> tuple[int, str, int, int]:
    """Worlds in the order of `dream worlds`, which is that of the suites; then by seed and start."""
    rank = WORLDS.index(case.world) if case.world in WORLDS else len(WORLDS)
    return (rank, case.world, case.seed, case.start)


def _rank_of_planner(name: str) -> tuple[int, str]:
    order, kind = list(PLANNERS), name.partition(LABELLED)[0]
    return (order.index(kind) if kind in order else len(order), name)


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
