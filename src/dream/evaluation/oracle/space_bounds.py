"""Both ends of what a mission in space could have achieved: a certified lower bound and the best tour.

Of 98.26 % of the individuals that count. All step counts here include the look-around. Errors of the sensors
play no part: a tour is flown under the protocol without them, where heights and tilts are what they are told
to be.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from dream.compiling import thread_time
from dream.control import setpoint
from dream.evaluation.metrics import COMPLETE
from dream.evaluation.oracle.bounds import check_limit, checked, may_miss_t98
from dream.evaluation.oracle.space_graph import SpaceGraph, actions_of, space_graph
from dream.evaluation.oracle.space_limits import PriceLimit
from dream.evaluation.oracle.space_tours import best_tour
from dream.geometry import SE2, SE3
from dream.protocol import SurveyProtocol
from dream.robots import Teleport
from dream.sim.files import world_hash
from dream.sim.inspection import Inspection
from dream.sim.ordered import protocol_in
from dream.sim.world import World
from dream.types import LOOK_AROUND, Decision

BOUND_SHARE = 0.2
"""Share of the budget that the search for a lower bound gets at most."""


@dataclass(frozen=True, slots=True)
class SpaceBounds:
    """What is known of one mission in space: a world, one of its starts, a protocol."""

    world: str
    seed: int
    start: int
    protocol: str
    world_hash: str
    countable: int
    lower_bound: int | None
    """No mission without a collision that keeps to the free space inspects 98.26 % in fewer steps; None where
    none is proved."""
    best_tour: int | None
    """Steps of the best tour; None where none is known."""
    prices: tuple[int, ...]
    """What certifies the lower bound: see `space_limits`; one for each individual that counts."""
    tour: tuple[int, ...]
    """Actions after the look-around, as indices into `space_graph.actions_of(protocol)`."""
    cpu_s: float
    """Seconds of processor time spent on it, over all searches that went into it."""

    @property
    def key(self) -> tuple[str, str, int, int]:
        """What tells this mission from every other."""
        return self.protocol, self.world, self.seed, self.start

    @property
    def status(self) -> str:
        """`optimal` where both ends meet, else `gap`."""
        return "optimal" if self.best_tour is not None and self.best_tour == self.lower_bound else "gap"

    def summary(self) -> dict[str, Any]:
        """What `dream oracle --json` prints."""
        return {
            "protocol": self.protocol,
            "world": self.world,
            "seed": self.seed,
            "start": self.start,
            "world_hash": self.world_hash,
            "countable": self.countable,
            "lower_bound_t98": self.lower_bound,
            "best_tour_t98": self.best_tour,
            "status_t98": self.status,
            "cpu_s": self.cpu_s,
        }

    def as_dict(self) -> dict[str, Any]:
        """One line of a file of bounds: the summary, the tour and the prices."""
        return {**self.summary(), "tour_t98": list(self.tour), "prices_t98": list(self.prices)}

    @classmethod
    def from_dict(cls, record: Any) -> SpaceBounds:
        """The bounds that `as_dict` gave.

        Raises:
            ValueError: A field is missing, is none of ours, or does not fit the others.
        """
        return checked(_SpaceLine, record).bounds()


_Index = Annotated[int, Field(ge=0, le=10_000_000)]
_Steps = Annotated[int, Field(ge=0, le=2000)]


class _SpaceLine(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    protocol: Annotated[str, Field(max_length=100)]
    world: Annotated[str, Field(max_length=100)]
    seed: _Index
    start: _Index
    world_hash: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    countable: _Index
    lower_bound_t98: _Steps | None
    best_tour_t98: _Steps | None
    status_t98: str
    cpu_s: Annotated[float, Field(ge=0.0)]
    tour_t98: Annotated[list[Annotated[int, Field(ge=0, le=10_000)]], Field(max_length=1000)]
    prices_t98: Annotated[list[_Index], Field(max_length=1_000_000)]

    def bounds(self) -> SpaceBounds:
        bounds = SpaceBounds(
            self.world, self.seed, self.start, self.protocol, self.world_hash, self.countable,
            self.lower_bound_t98, self.best_tour_t98, tuple(self.prices_t98), tuple(self.tour_t98),
            self.cpu_s,
        )  # fmt: skip
        check_limit("_t98", bounds.lower_bound, bounds.best_tour, bounds.tour, bounds.status, self.status_t98)
        return bounds


def without_errors(protocol: SurveyProtocol) -> SurveyProtocol:
    """The protocol with sensors that do not err."""
    return replace(protocol, noise=None, lasting=None)


def tighten(
    world: World,
    protocol: SurveyProtocol,
    *,
    start: int = 0,
    budget_s: float,
    known: SpaceBounds | None = None,
    seed: int = 0,
    inspection: Inspection | None = None,
) -> Iterator[SpaceBounds]:
    """Close in on the fewest steps from both sides, yielding what is known whenever that is more.

    Args:
        world: Where.
        protocol: By which rules; its sensors' errors play no part.
        start: Which of the world's start poses.
        budget_s: Seconds of processor time; what the frames inspect and what is compiled are not counted.
        known: Bounds to begin with, of the same mission.
        seed: Of the search for tours.
        inspection: Of this world, where it is made already.

    Raises:
        ValueError: There is no such start, or `known` is of another mission.
    """
    if not 0.0 <= budget_s < math.inf:
        raise ValueError(f"budget: expected 0 seconds or more, got {budget_s}")
    digest = world_hash(world)
    mission = (protocol.name, world.name, world.seed, start, digest)
    if known is not None and (*known.key, known.world_hash) != mission:
        raise ValueError(f"known bounds: expected those of {mission}, got {(*known.key, known.world_hash)}")
    began = thread_time()
    graph = space_graph(inspection or Inspection(world, protocol), start=start)
    count = len(graph.individuals)
    may_miss = may_miss_t98(count)
    bounds = known or SpaceBounds(
        world.name, world.seed, start, protocol.name, digest, count, None, None, (), (), 0.0
    )
    spent = bounds.cpu_s
    looked = _looked(graph, may_miss)
    if looked is not None:
        bounds = replace(bounds, lower_bound=looked, best_tour=looked, prices=(), tour=())

    def timed() -> SpaceBounds:
        return replace(bounds, cpu_s=round(spent + thread_time() - began, 1))

    yield timed()
    until = thread_time() + budget_s
    if bounds.status == "optimal" or budget_s == 0.0:
        return
    limit = PriceLimit(graph, may_miss)
    prices = limit.search(BOUND_SHARE * budget_s)
    lower = limit.certified(prices) + LOOK_AROUND
    if bounds.lower_bound is None or lower > bounds.lower_bound:
        bounds = replace(bounds, lower_bound=lower, prices=prices)
        yield timed()
    hints = [] if bounds.best_tour is None else [graph.walk(bounds.tour)]
    enough = (bounds.lower_bound or 0) - LOOK_AROUND
    for tour in best_tour(
        graph, may_miss, hints=hints, budget_s=until - thread_time(), seed=seed, enough=enough
    ):
        if bounds.best_tour is None or len(tour) + LOOK_AROUND < bounds.best_tour:
            bounds = replace(bounds, best_tour=len(tour) + LOOK_AROUND, tour=tour)
            yield timed()
    yield timed()


def _looked(graph: SpaceGraph, may_miss: int) -> int | None:
    """The step of the look-around that inspects enough; None where none does."""
    unseen = len(graph.individuals) - graph.looked.sum(axis=1)
    return next((k for k, left in enumerate(unseen.tolist()) if left <= may_miss), None)


def drive(bounds: SpaceBounds, world: World, *, inspection: Inspection | None = None) -> None:
    """Fly the tour in the simulator: the look-around and every action, and score what they inspect.

    What counts is what `metrics.Scorer` calls the instances, from the poses where the simulator arrives.

    Args:
        bounds: What claims to hold.
        world: Where.
        inspection: Of this world, where it is made already.

    Raises:
        ValueError: The tour touches something, leaves the arena, or reaches its share at another step.
    """
    protocol = without_errors(protocol_in(world, bounds.protocol))
    inspection = inspection or Inspection(world, protocol)
    _check_mission(bounds, world, int(inspection.countable.sum()))
    if bounds.best_tour is None:
        return
    robot = Teleport(world, protocol, world.starts[bounds.start], solids=inspection.solids)
    pose, z, tilt = _launch(bounds, world, protocol)
    countable = inspection.countable
    total = int(countable.sum())
    done = np.zeros(len(countable), np.bool_)
    reached = None
    for step, decision in enumerate([None, *decisions_of(bounds.tour, protocol)]):
        if decision is not None:
            goal = setpoint(pose, decision, protocol, z)
            arrival = robot.go_to(goal)
            pose, z = arrival.pose, z if goal.z is None else goal.z
            tilt = tilt if goal.tilt is None else goal.tilt
            where = f"({pose.x:g}, {pose.y:g}, {z:g})"
            if arrival.collided:
                raise ValueError(f"tour: step {step} touches something near {where}")
            if not world.bounds.contains(pose.x, pose.y):
                raise ValueError(f"tour: step {step} leaves the arena at {where}")
        done |= inspection.inspected(SE3.level(pose.x, pose.y, z, pose.yaw), tilt)
        if total == 0 or int(done[countable].sum()) / total >= COMPLETE - 1e-12:
            reached = step
            break
    if reached != bounds.best_tour:
        got = "never" if reached is None else reached
        raise ValueError(f"tour: expected 98.26 % at step {bounds.best_tour}, got {got}")


def check(bounds: SpaceBounds, world: World) -> None:
    """Fly the tour and see that the prices certify the lower bound.

    Raises:
        ValueError: Something that the bounds claim does not hold.
    """
    inspection = Inspection(world, protocol_in(world, bounds.protocol))
    drive(bounds, world, inspection=inspection)
    if bounds.lower_bound is None or bounds.lower_bound == 0:
        return
    graph = space_graph(inspection, start=bounds.start)
    may_miss = may_miss_t98(bounds.countable)
    proved = _looked(graph, may_miss)
    if proved is None:
        proved = PriceLimit(graph, may_miss).certified(bounds.prices) + LOOK_AROUND
    if bounds.lower_bound > proved:
        raise ValueError(f"lower bound: expected at most the {proved} proved, got {bounds.lower_bound}")


def _check_mission(bounds: SpaceBounds, world: World, countable: int) -> None:
    digest = world_hash(world)
    if bounds.world_hash != digest:
        raise ValueError(f"world_hash: expected {digest[:12]}…, got {bounds.world_hash[:12]}…")
    last = len(world.starts) - 1
    if bounds.start > last:
        raise ValueError(f"start: expected 0 to {last} for {world.name}, got {bounds.start}")
    if bounds.countable != countable:
        raise ValueError(f"countable: expected {countable}, got {bounds.countable}")


def _launch(bounds: SpaceBounds, world: World, protocol: SurveyProtocol) -> tuple[SE2, float, float]:
    """Pose, height and tilt at the start."""
    pose = protocol.snap(world.starts[bounds.start])
    return pose, protocol.launch_height(float(world.terrain.height(pose.x, pose.y))), protocol.camera_pitch


def decisions_of(tour: tuple[int, ...], protocol: SurveyProtocol) -> list[Decision]:
    """What a mission that flies a tour decides, step by step, the look-around included.

    Raises:
        ValueError: An action is none of the protocol's.
    """
    actions = actions_of(protocol).tolist()
    wrong = next((action for action in tour if not 0 <= action < len(actions)), None)
    if wrong is not None:
        raise ValueError(f"tour: expected actions 0 to {len(actions) - 1}, got {wrong}")
    advances = (0.0, *protocol.advances)
    return [
        *[Decision(turn=0.5 * math.pi)] * LOOK_AROUND,
        *(
            Decision(
                turn=turn * protocol.heading_step,
                advance=advances[advance],
                climb=protocol.climbs[climb],
                tilt=protocol.tilts[tilt],
            )
            for turn, advance, climb, tilt in (actions[action] for action in tour)
        ),
    ]


def tour_poses(bounds: SpaceBounds, world: World, protocol: SurveyProtocol) -> npt.NDArray[np.float64]:
    """(n + 1, 5) x, y, z, yaw and tilt after the look-around and after every action of the tour."""
    pose, z, tilt = _launch(bounds, world, protocol)
    poses = []
    for step, decision in enumerate(decisions_of(bounds.tour, protocol), start=1):
        goal = setpoint(pose, decision, protocol, z)
        pose, z = SE2(goal.x, goal.y, goal.yaw), z if goal.z is None else goal.z
        tilt = tilt if goal.tilt is None else goal.tilt
        if step >= LOOK_AROUND:
            poses.append([pose.x, pose.y, z, pose.yaw, tilt])
    return np.array(poses)
