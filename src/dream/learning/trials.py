"""Trial missions: how many targets a planner sees, and over how many metres."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dream.course import Planner
from dream.evaluation.engines import Engine, Failure
from dream.evaluation.runner import simulate
from dream.evaluation.suites import Case
from dream.learning.rollouts import Colourless
from dream.protocol import protocol_named
from dream.sim.visibility import Visibility
from dream.sim.world import World
from dream.sim.worlds import make_world


@dataclass(frozen=True, slots=True)
class Trial:
    """One mission to judge a planner by: enough to fly it in another process."""

    name: str
    """Of what is tried."""
    planner: Planner
    case: Case
    steps: int = 60


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a trial."""

    seen: int
    """Individuals."""
    share: float
    """Of those that count."""
    distance: float
    """Metres travelled."""


def fly(trial: Trial) -> Outcome:
    """Fly one trial and score it, as `evaluation.metrics` would."""
    stage = _stage(trial.case.world, trial.case.seed)
    visibility = stage.visibility
    steps = simulate(
        stage.world,
        trial.planner,
        visibility.protocol,
        start=trial.case.start,
        max_steps=trial.steps,
        renderer=stage.renderer,
        solids=visibility.solids,
    )
    seen, distance = np.zeros(len(visibility), np.bool_), 0.0
    for step in steps:
        pose = step.observation.pose
        seen |= visibility.seen([[pose.x, pose.y, pose.yaw]])[0]
        distance += step.arrival.distance
    counted = int(np.count_nonzero(seen & visibility.countable))
    return Outcome(counted, counted / max(1, int(visibility.countable.sum())), distance)


def try_out(trials: Sequence[Trial], engine: Engine) -> Iterator[tuple[Trial, Outcome]]:
    """Fly all trials, those of one world together.

    Raises:
        ValueError: A mission failed.
    """
    groups: dict[Case, list[Trial]] = {}
    for trial in trials:
        groups.setdefault(trial.case, []).append(trial)
    with contextlib.closing(engine.run(fly, list(groups.values()))) as flown:
        for trial, outcome in flown:
            if isinstance(outcome, Failure):
                raise ValueError(f"{trial.name} in {trial.case.world} {trial.case.seed}: {outcome.message}")
            yield trial, outcome


@dataclass(frozen=True, slots=True, eq=False)
class _Stage:
    world: World
    visibility: Visibility
    renderer: Colourless


@lru_cache(maxsize=1)
def _stage(world: str, seed: int) -> _Stage:
    made = make_world(world, seed)
    return _Stage(made, Visibility(made, protocol_named(made.protocol)), Colourless(made))
