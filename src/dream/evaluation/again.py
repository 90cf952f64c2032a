"""A recorded run again through the loop, and how its decisions differ from those of then."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar

from dream.course import Planner
from dream.evaluation.runner import labelled_in, simulate
from dream.geometry import Bounds, wrap_angle
from dream.homeward import read_budget
from dream.mapping import OccupancyMap
from dream.mapping.prior import Prior
from dream.mission import explore
from dream.names import look_up
from dream.orders import Orders
from dream.planning import HUMAN, LABELLED, PLANNERS, AnyPlanner, Asking, Human, planner_name
from dream.planning.baselines.uivnav import weights_sha256
from dream.planning.identity import code_sha256, prompts_sha256
from dream.planning.vlm import stands_in
from dream.planning.vlm.orders import read_orders
from dream.protocol import SurveyProtocol
from dream.recording import (
    PRIOR,
    RecordedDecision,
    RecordedGuard,
    RecordedStep,
    RunConfig,
    read_config,
    read_steps,
)
from dream.robots.replay import FOLDER, Replayed
from dream.sim.files import world_hash
from dream.sim.world import World
from dream.types import Decision, Mission, Observation, Step, Target

SAME = 1e-6
"""Metres and radians between what is the same: another machine may round otherwise."""


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """What a run left behind."""

    folder: Path
    config: RunConfig
    steps: tuple[RecordedStep, ...]
    """From the first look on, without a gap."""

    @property
    def protocol(self) -> SurveyProtocol:
        """By which it was flown."""
        return self.config.rules

    @property
    def world_name(self) -> str | None:
        """Where it was; None of a dive in real water, whose world nobody knows."""
        if self.config.real:
            return None
        return self.config.world_from or self.config.world

    @property
    def observed(self) -> bool:
        """Were its observations kept?"""
        return any((self.folder / FOLDER).glob("*.npz"))

    @property
    def planner(self) -> AnyPlanner:
        """Who decided, with the parameters of then.

        Raises:
            ValueError: There is no such planner here, it has other parameters, or asks another network.
        """
        name = self.config.planner
        if self.config.planner_file:
            # What a folder names is not run: it may be a stranger's.
            raise ValueError(
                f"planner: expected one of DREAM, got the file {self.config.planner_file}. To have "
                "that decide again, name it: dream replay RUN --planner FILE.py"
            )
        if name.partition(LABELLED)[0] == HUMAN:
            return Human()
        default = look_up(PLANNERS, name, "planner")
        try:
            planner = replace(default, **self.config.planner_parameters)
        except TypeError as error:
            raise ValueError(
                f"{self.folder / 'config.json'}: expected the parameters of {name}, got others ({error}). "
                f"It was made by version {self.config.version}"
            ) from error
        then, now = self.config.weights_sha256, weights_sha256(planner)
        if then is not None and now != then:
            raise ValueError(
                f"weights: expected the network of then, whose SHA-256 is {then[:12]}..., got "
                f"{(now or 'none')[:12]}... in {self.config.planner_parameters.get('weights')}. "
                "Put that of then back"
            )
        prompts = prompts_sha256(planner)
        for prompt, sha256 in sorted(self.config.prompts_sha256.items()):
            found = prompts.get(prompt, "none")
            if found != sha256:
                raise ValueError(
                    f"prompts: expected the {prompt}.md of then, whose SHA-256 is {sha256[:12]}..., got "
                    f"{found[:12]} in {self.config.planner_parameters.get('prompts')}. Put that of then back"
                )
        return planner

    def was_flown_by(self, planner: AnyPlanner) -> bool:
        """Is it who decided, with the parameters of then?"""
        parameters = json.loads(json.dumps(asdict(planner)))
        name = self.config.planner.partition(LABELLED)[0]
        then = (name, self.config.planner_sha256, self.config.planner_parameters)
        return (planner_name(planner), code_sha256(planner), parameters) == then

    @property
    def orders(self) -> Orders | None:
        """What the operator ordered."""
        return None if self.config.orders is None else read_orders(json.dumps(self.config.orders))

    def prior(self, bounds: Bounds) -> Prior | None:
        """What it was told of an earlier survey; None where there was none.

        Raises:
            FileNotFoundError: That was not kept.
            ValueError: It is damaged, or of another map.
        """
        told, kept = (self.config.model_extra or {}).get("from_survey"), self.folder / PRIOR
        if told is None:
            return None
        if not kept.is_file():
            raise FileNotFoundError(
                f"{kept}: expected what the mission was told of an earlier survey, got no file. Without it "
                "another mission would be flown"
            )
        return Prior.load(kept, told, bounds, self.protocol.cell)

    def bounds(self, world: World | None) -> Bounds:
        """The survey area."""
        if world is not None:
            return world.bounds
        area = (self.config.dive or {}).get("area")
        try:
            return Bounds(*map(float, area or ()))
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"{self.folder / 'config.json'}: dive.area: expected four numbers, got {area}"
            ) from error


def read_record(folder: Path) -> Record:
    """Read what a run left behind.

    Raises:
        FileNotFoundError: It is no run folder.
        ValueError: A file is damaged, or a step is missing.
    """
    config, steps = read_config(folder), tuple(read_steps(folder))
    if not steps:
        raise ValueError(f"{folder / 'steps.jsonl'}: expected at least the first look, got no step")
    for number, step in enumerate(steps):
        if step.step != number:
            raise ValueError(
                f"{folder / 'steps.jsonl'}: expected step {number}, got {step.step} in its place"
            )
    return Record(folder, config, steps)


def check_world(record: Record, world: World) -> None:
    """Raise a ValueError unless it is the world of then, as far as that is known."""
    then, now = (record.config.model_extra or {}).get("world_hash"), world_hash(world)
    if then not in (None, "", now):
        raise ValueError(
            f"{record.folder}: expected the world {record.config.world} of then, got another under its name "
            f"({now[:12]}, not {str(then)[:12]}). The run was made by version {record.config.version}"
        )


def answering(planner: AnyPlanner, replies: Path | None) -> AnyPlanner:
    """The planner, answered by the replies that were kept where it asks a model: none is asked again.

    Args:
        planner: Who decides.
        replies: Folder of kept replies (`--record`); the one that it recorded to itself unless given.

    Raises:
        ValueError: There are none.
    """
    if not isinstance(planner, Asking):
        return planner
    if replies is None and stands_in(planner.model):
        return replace(planner, record=None, replay_replies=None)
    folder = replies or planner.record or planner.replay_replies
    if folder is None or not Path(folder).is_dir():
        raise ValueError(
            f"--replay-replies: expected the folder of what {planner.label or 'a model'} answered, got "
            f"{folder or 'none'}. Such are kept with --record; or let another planner decide with --planner"
        )
    return replace(planner, record=None, replay_replies=str(folder))


def fly_again(record: Record, planner: AnyPlanner, world: World | None) -> Iterator[Step]:
    """The mission again, no longer than then: by what was seen, where that was kept, else in the simulator.

    Args:
        record: Of the mission.
        planner: Who decides. In the place of a person, who is not asked again, `Repeated` does.
        world: Of then; None where it is not known, of a dive in real water.

    Raises:
        FileNotFoundError: It was a dive whose observations were not kept.
        ValueError: An observation is missing, or something does not fit together.
    """
    config, protocol, steps = record.config, record.protocol, len(record.steps)
    budget = None if config.budget is None else read_budget(config.budget)
    decides: Planner = Repeated(record.steps) if isinstance(planner, Human) else planner
    if record.observed or record.config.dive is not None:
        robot = Replayed(record.folder)
        if robot.moves < steps - 1:
            raise ValueError(
                f"{record.folder / FOLDER}: expected what was seen after {steps - 1} moves, "
                f"got {robot.moves}. Are the last files missing?"
            )
        occupancy = OccupancyMap(record.bounds(world), protocol)
        # A dive takes whatever its labels call a target; so did this one.
        target = Target.ANY if record.config.dive is not None or world is None else labelled_in(world)
        again = explore(
            robot,
            decides,
            occupancy,
            max_steps=config.max_steps,
            target=target,
            orders=record.orders,
            prior=record.prior(occupancy.bounds),
            budget=budget,
            ticking=record.config.dive is not None,
        )
    else:
        assert world is not None
        again = simulate(
            world,
            decides,
            protocol,
            start=config.start,
            max_steps=config.max_steps,
            orders=record.orders,
            prior=record.prior(world.bounds),
            budget=budget,
        )
    return islice(again, steps)


@dataclass(frozen=True, slots=True)
class Repeated:
    """Decides what was decided then, step by step, whatever it is told."""

    spatial: ClassVar[bool] = True

    steps: tuple[RecordedStep, ...]
    """Of the mission, from the first look on."""

    def begin(self, mission: Mission) -> _Repeating:
        """A pilot that has not decided yet."""
        return _Repeating(iter(self.steps[mission.flown + 1 :]))


@dataclass(frozen=True, slots=True)
class _Repeating:
    steps: Iterator[RecordedStep]

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        then = next(self.steps).decision
        return Decision(then.turn, then.advance, then.done, climb=then.climb, tilt=then.tilt)


class Comparison:
    """What was decided and where it came, beside that of then, step by step."""

    def __init__(self, record: Record) -> None:
        self._then = record.steps
        self._differences: dict[int, str] = {}
        self._last = 0
        self._farthest = (0.0, 0.0)

    def add(self, now: Step) -> None:
        """Take in one more step."""
        then, self._last = self._then[now.index], now.index
        if how := difference(then, now):
            self._differences[now.index] = how
        (far, turned), (farthest, most) = apart(then, now), self._farthest
        self._farthest = (max(far, farthest), max(turned, most))

    def as_dict(self) -> dict[str, Any]:
        """How many decisions agree, which is the first that does not, and how far it came from then."""
        steps = len(self._then) - 1
        differences = self._differences
        if not differences and self._last < steps:
            differences = {self._last: "the mission ended, then it went on"}
        first = min(differences, default=None)
        return {
            "steps": steps,
            "agree": self._last - len(self._differences.keys() - {0}),
            "first_difference": None if first is None else {"step": first, "how": differences[first]},
            "farthest_m": self._farthest[0],
            "farthest_deg": math.degrees(self._farthest[1]),
        }


def difference(then: RecordedStep, now: Step) -> str:
    """How what was decided differs from what was then, in a line; empty where it does not."""
    decided, carried_out = now.decision, now.guarded.decision
    said, kept = then.decision, then.guarded
    if said.done is not decided.done or not _same(said, decided):
        return f"decided to {_move(decided)}, then to {_move(said)}"
    if not _same(kept, carried_out):
        return f"the guard let it {_move(carried_out)}, then {_move(kept)}"
    if now.ended != then.ended:
        return f"the mission {_ENDS[now.ended]}, then it {_ENDS[then.ended]}"
    return ""


def apart(then: RecordedStep, now: Step) -> tuple[float, float]:
    """Metres and radians between where a step ended and where it ended then."""
    pose = now.arrival.pose
    rise = 0.0 if then.pose.z is None else now.observation.z - then.pose.z
    distance = math.hypot(pose.x - then.pose.x, pose.y - then.pose.y, rise)
    return distance, abs(wrap_angle(pose.yaw - then.pose.yaw))


def _same(then: RecordedDecision | RecordedGuard, now: Decision) -> bool:
    apart = [wrap_angle(then.turn - now.turn), then.advance - now.advance, then.climb - now.climb]
    if then.tilt is not None and now.tilt is not None:
        apart.append(then.tilt - now.tilt)
    elif then.tilt is not now.tilt:
        return False
    return all(abs(by) <= SAME for by in apart)


def _move(decided: Decision | RecordedDecision | RecordedGuard) -> str:
    if getattr(decided, "done", False):
        return "be done"
    turn, advance = math.degrees(decided.turn), decided.advance
    parts = [f"turn {turn:+.0f}°"] * (turn != 0.0) + [f"advance {advance:g} m"] * (advance != 0.0)
    parts += [f"climb {decided.climb:+g} m"] * (decided.climb != 0.0)
    if decided.tilt is not None:
        parts.append(f"tilt to {math.degrees(decided.tilt):.0f}°")
    return " and ".join(parts) or "stay"


_ENDS = {
    "": "went on",
    "done": "ended as done",
    "returned": "ended at home",
    "cap": "ended for want of steps",
}
