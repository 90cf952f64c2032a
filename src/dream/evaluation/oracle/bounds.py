"""Both ends of what a mission could have achieved: a certified lower bound and the best tour, per world.

All step counts here include the look-around, as everywhere outside `limits` and `tours`.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.resources
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol, Self, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from dream.compiling import thread_time
from dream.control import setpoint
from dream.evaluation.metrics import COMPLETE
from dream.evaluation.oracle.graph import PoseGraph, actions_of, pose_graph
from dream.evaluation.oracle.limits import MOST, certify, verify
from dream.evaluation.oracle.tours import best_tour, follow, trimmed
from dream.files import write_whole
from dream.geometry import SE2, wrap_angle
from dream.protocol import SurveyProtocol, noisy_variants, protocol_named
from dream.robots import Teleport
from dream.sim.files import world_hash
from dream.sim.visibility import Visibility
from dream.sim.world import World
from dream.types import LOOK_AROUND, Decision

if TYPE_CHECKING:
    from dream.evaluation.results import Results

Walk = tuple[int, ...]


class KeptBounds(Protocol):
    """What a line of a file of bounds holds: `OracleBounds`, or in space `space_bounds.SpaceBounds`."""

    @property
    def key(self) -> tuple[str, str, int, int]:
        """What tells its mission from every other."""

    def as_dict(self) -> dict[str, Any]:
        """The line."""

    @classmethod
    def from_dict(cls, record: Any) -> Self:
        """What `as_dict` gave; a ValueError where that is damaged."""


K = TypeVar("K", bound=KeptBounds)
M = TypeVar("M", bound=BaseModel)

LONGEST_LINE = 4_000_000
"""Characters; a longer line of a file of bounds is refused. An honest one takes some ten thousand."""
TOUR_SLICE, BOUND_SLICE = 0.15, 0.25
"""Shares of the budget left that one search for a tour, and one for a bound, get."""
LEAST_SLICE = 0.5
"""Seconds that a search gets at least, while they last."""
KNOWN = ("paper", "dev", "test")
"""Suites whose bounds come with the package."""


@dataclass(frozen=True, slots=True)
class Limit:
    """The fewest steps that see a given share: between which two numbers they lie, and why."""

    lower_bound: int
    """No mission without a collision reaches the share in fewer steps."""
    best_tour: int | None
    """Steps of the best tour; None where none is known."""
    witnesses: tuple[tuple[int, ...], ...]
    """What certifies the lower bound: see `limits.Certificate`; here as indices into `World.targets`."""
    tour: Walk
    """Actions after the look-around, as indices into `graph.actions_of(protocol)`."""

    @property
    def status(self) -> str:
        """`optimal` where both ends meet, else `gap`."""
        return "optimal" if self.best_tour == self.lower_bound else "gap"


@dataclass(frozen=True, slots=True)
class OracleBounds:
    """What is known of one mission: a world, one of its starts, a protocol."""

    world: str
    seed: int
    start: int
    protocol: str
    world_hash: str
    countable: int
    full: Limit
    """Of 100 % of the instances."""
    t98: Limit
    """Of 98.26 %."""
    cpu_s: float
    """Seconds of processor time spent on it, over all searches that went into it."""

    @property
    def key(self) -> tuple[str, str, int, int]:
        """What tells this mission from every other."""
        return self.protocol, self.world, self.seed, self.start

    def summary(self) -> dict[str, Any]:
        """What `dream oracle --json` prints."""
        return {
            "protocol": self.protocol,
            "world": self.world,
            "seed": self.seed,
            "start": self.start,
            "world_hash": self.world_hash,
            "countable": self.countable,
            "lower_bound": self.full.lower_bound,
            "lower_bound_t98": self.t98.lower_bound,
            "best_tour": self.full.best_tour,
            "best_tour_t98": self.t98.best_tour,
            "status": self.full.status,
            "status_t98": self.t98.status,
            "cpu_s": self.cpu_s,
        }

    def as_dict(self) -> dict[str, Any]:
        """One line of a file of bounds: the summary, the tours and the witnesses."""
        return {
            **self.summary(),
            "tour": list(self.full.tour),
            "tour_t98": list(self.t98.tour),
            "witnesses": [list(witness) for witness in self.full.witnesses],
            "witnesses_t98": [list(witness) for witness in self.t98.witnesses],
        }

    @classmethod
    def from_dict(cls, record: Any) -> OracleBounds:
        """The bounds that `as_dict` gave.

        Raises:
            ValueError: A field is missing, is none of ours, or does not fit the others.
        """
        return checked(_Line, record).bounds()


_Index = Annotated[int, Field(ge=0, le=10_000_000)]
_Steps = Annotated[int, Field(ge=0, le=1000)]
_Tour = Annotated[list[Annotated[int, Field(ge=0, le=255)]], Field(max_length=1000)]
_Witnesses = Annotated[
    list[Annotated[list[_Index], Field(min_length=1, max_length=10_000)]], Field(max_length=MOST)
]


class _Line(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    protocol: Annotated[str, Field(max_length=100)]
    world: Annotated[str, Field(max_length=100)]
    seed: _Index
    start: _Index
    world_hash: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    countable: _Index
    lower_bound: _Steps
    lower_bound_t98: _Steps
    best_tour: _Steps | None
    best_tour_t98: _Steps | None
    status: str
    status_t98: str
    cpu_s: Annotated[float, Field(ge=0.0)]
    tour: _Tour
    tour_t98: _Tour
    witnesses: _Witnesses
    witnesses_t98: _Witnesses

    def bounds(self) -> OracleBounds:
        full = _limit("", self.lower_bound, self.best_tour, self.status, self.tour, self.witnesses)
        t98 = _limit(
            "_t98",
            self.lower_bound_t98,
            self.best_tour_t98,
            self.status_t98,
            self.tour_t98,
            self.witnesses_t98,
        )
        return OracleBounds(
            self.world, self.seed, self.start, self.protocol, self.world_hash, self.countable, full, t98,
            self.cpu_s,
        )  # fmt: skip


def _limit(
    share: str, lower: int, best: int | None, status: str, tour: list[int], witnesses: list[list[int]]
) -> Limit:
    limit = Limit(lower, best, tuple(map(tuple, witnesses)), tuple(tour))
    check_limit(share, lower, best, tour, limit.status, status)
    return limit


def checked(kind: type[M], record: Any) -> M:
    """A line of a file of bounds by its model; a ValueError that names the first field that is wrong."""
    try:
        return kind.model_validate(record)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "record"
        raise ValueError(f"{where}: {first['msg']}") from error


def check_limit(
    share: str, lower: int | None, best: int | None, tour: Sequence[int], status: str, told: str
) -> None:
    """Raise a ValueError where the parts of a limit do not fit each other.

    Args:
        share: How the names of its fields end.
        lower: The lower bound, None where none is known.
        best: Steps of the best tour, likewise.
        tour: Its actions after the look-around.
        status: What follows from the bounds.
        told: What is said to.
    """
    if best is not None and lower is not None and best < lower:
        raise ValueError(f"best_tour{share}: expected at least the lower bound of {lower}, got {best}")
    expected = 0 if best is None else max(best - LOOK_AROUND, 0)
    if len(tour) != expected:
        raise ValueError(
            f"tour{share}: expected {expected} actions for best_tour{share} = {best}, got {len(tour)}"
        )
    if told != status:
        raise ValueError(f'status{share}: expected "{status}", got "{told}"')


def may_miss_t98(countable: int) -> int:
    """How many individuals a mission that has seen 98.26 % may still not have seen."""
    allowed = math.floor(countable * (1.0 - COMPLETE)) + 1
    while allowed and countable - allowed < (COMPLETE - 1e-12) * countable:
        allowed -= 1
    return allowed


def tighten(
    world: World,
    protocol: SurveyProtocol,
    *,
    start: int = 0,
    budget_s: float,
    known: OracleBounds | None = None,
    hints: Callable[[PoseGraph], Iterable[Walk]] | None = None,
    seed: int = 0,
    visibility: Visibility | None = None,
) -> Iterator[OracleBounds]:
    """Close in on the fewest steps from both sides, yielding what is known after every search.

    A tour prunes the search for the lower bound; the walks which that search met are where the next search
    for a tour begins. Ends early where both shares are solved.

    Args:
        world: Where.
        protocol: By which rules.
        start: Which of the world's start poses.
        budget_s: Seconds of processor time; the views of the poses and what is compiled are not counted.
        known: Bounds to begin with, of the same mission.
        hints: Gives walks to begin with, complete or not; see `walks_of`.
        seed: Of the search for tours.
        visibility: Of this world, where it is made already.

    Raises:
        ValueError: There is no such start, or `known` is of another mission.
    """
    began = thread_time()
    if not 0 <= start < len(world.starts):
        raise ValueError(f"start: expected 0 to {len(world.starts) - 1} for {world.name}, got {start}")
    if not 0.0 <= budget_s < math.inf:
        raise ValueError(f"budget: expected 0 seconds or more, got {budget_s}")
    digest = world_hash(world)
    mission = (protocol.name, world.name, world.seed, start, digest)
    if known is not None and (*known.key, known.world_hash) != mission:
        raise ValueError(f"known bounds: expected those of {mission}, got {(*known.key, known.world_hash)}")

    graph = pose_graph(world, protocol, start=start, visibility=visibility)
    count = len(graph.individuals)
    allowed = {"full": 0, "t98": may_miss_t98(count)}
    looks = _shown_by_looking(graph, protocol)
    limits = {}
    walks: dict[str, list[Walk]] = {}
    for share, may_miss in allowed.items():
        looked = next((k for k, unseen in enumerate(looks) if unseen <= may_miss), None)
        if looked is not None:
            limits[share] = Limit(looked, looked, (), ())
        elif known is not None:
            limits[share] = getattr(known, share)
        else:
            limits[share] = Limit(LOOK_AROUND + 1, None, (), ())
        walks[share] = list(hints(graph)) if hints else []
    spent = known.cpu_s if known else 0.0

    def bounds() -> OracleBounds:
        return OracleBounds(
            world.name, world.seed, start, protocol.name, digest, count, limits["full"], limits["t98"],
            round(spent + thread_time() - began, 1),
        )  # fmt: skip

    yield bounds()
    until = thread_time() + budget_s
    rounds = 0
    while any(limit.status == "gap" for limit in limits.values()) and thread_time() < until:
        for improve, slice_ in ((_better_tour, TOUR_SLICE), (_better_bound, BOUND_SLICE)):
            for share, may_miss in allowed.items():
                left = until - thread_time()
                if limits[share].status == "gap" and left > 0.0:
                    part = min(left, max(slice_ * left, LEAST_SLICE))
                    limits[share] = improve(graph, may_miss, limits[share], walks[share], part, seed + rounds)
                    # A tour that sees all sees 98.26 % on its way.
                    limits["t98"] = _with_tour(graph, allowed["t98"], limits["t98"], limits["full"].tour)
                    if limits["t98"].lower_bound > limits["full"].lower_bound:
                        # What holds for all walks that see 98.26 % holds for those that see all.
                        weaker = limits["t98"]
                        limits["full"] = replace(
                            limits["full"], lower_bound=weaker.lower_bound, witnesses=weaker.witnesses
                        )
                    yield bounds()
        walks["full"].append(limits["t98"].tour)
        rounds += 1


def bound(
    world: World,
    protocol: SurveyProtocol,
    *,
    start: int = 0,
    budget_s: float,
    known: OracleBounds | None = None,
    hints: Callable[[PoseGraph], Iterable[Walk]] | None = None,
    seed: int = 0,
    visibility: Visibility | None = None,
) -> OracleBounds:
    """The last of `tighten`."""
    steps = tighten(
        world, protocol, start=start, budget_s=budget_s, known=known, hints=hints, seed=seed,
        visibility=visibility,
    )  # fmt: skip
    *_, last = steps
    return last


def _shown_by_looking(graph: PoseGraph, protocol: SurveyProtocol) -> list[int]:
    """Individuals unseen after the first look and after each quarter turn."""
    node, heading = divmod(graph.start, protocol.headings)
    quarter = protocol.headings // 4
    looks = [
        node * protocol.headings + (heading - (LOOK_AROUND - k) * quarter) % protocol.headings
        for k in range(LOOK_AROUND + 1)
    ]
    seen = np.bitwise_or.accumulate(graph.views[looks], axis=0)
    return [len(graph.individuals) - int(row.sum()) for row in np.bitwise_count(seen)]


def _better_tour(
    graph: PoseGraph, may_miss: int, limit: Limit, walks: list[Walk], budget_s: float, seed: int
) -> Limit:
    hints = [walk for walk in (limit.tour, *walks) if walk]
    walks.clear()
    tour = best_tour(
        graph, may_miss, hints=hints, budget_s=budget_s, seed=seed, enough=limit.lower_bound - LOOK_AROUND
    )
    return limit if tour is None else _with_tour(graph, may_miss, limit, tour)


def _with_tour(graph: PoseGraph, may_miss: int, limit: Limit, walk: Walk) -> Limit:
    """The limit with as much of a walk as it takes for its tour, where that is shorter."""
    tour = trimmed(graph, may_miss, walk)
    if tour is None or (limit.best_tour is not None and len(tour) + LOOK_AROUND >= limit.best_tour):
        return limit
    return replace(limit, best_tour=len(tour) + LOOK_AROUND, tour=tour)


def _better_bound(
    graph: PoseGraph, may_miss: int, limit: Limit, walks: list[Walk], budget_s: float, seed: int
) -> Limit:
    del seed  # Nothing is left to chance.
    number = {int(target): i for i, target in enumerate(graph.individuals)}
    # Larger ones were taken over from the other share: true, but weaker than those to be found.
    own = [witness for witness in limit.witnesses if len(witness) <= may_miss + 1]
    witnesses = [tuple(number[target] for target in witness) for witness in own]
    tour = limit.tour if limit.best_tour is not None else None
    certificate = certify(
        graph, may_miss, tour=tour, budget_s=budget_s, witnesses=witnesses,
        length=max(limit.lower_bound - LOOK_AROUND, 0) if len(own) == len(limit.witnesses) else 0,
    )  # fmt: skip
    walks.extend(certificate.walks)
    for walk in certificate.walks:
        limit = _with_tour(graph, may_miss, limit, walk)

    def named(some: Iterable[Sequence[int]]) -> tuple[tuple[int, ...], ...]:
        return tuple(tuple(int(graph.individuals[i]) for i in witness) for witness in some)

    lower = certificate.length + LOOK_AROUND
    if lower > limit.lower_bound:
        certified = named(certificate.witnesses)
    elif len(own) == len(limit.witnesses):
        lower, certified = limit.lower_bound, limit.witnesses
    else:
        return limit
    # Those that certify it stand first: with more behind them, they still do.
    every = (*certified, *named(certificate.unsettled))[:MOST]
    return replace(limit, lower_bound=lower, witnesses=every)


def drive(bounds: OracleBounds, world: World, *, visibility: Visibility | None = None) -> None:
    """Fly both tours in the simulator: the look-around and every action, and score what they see.

    What counts is what `metrics.Scorer` calls the instances, from the poses where the simulator arrives.

    Args:
        bounds: What claims to hold.
        world: Where.
        visibility: Of this world, where it is made already.

    Raises:
        ValueError: A tour touches something, leaves the arena, or reaches its share at another step.
    """
    protocol = protocol_named(bounds.protocol)
    visibility = visibility or Visibility(world, protocol)
    _check_mission(bounds, world, int(visibility.countable.sum()))
    for name, limit, goal in (("100 %", bounds.full, 1.0), ("98.26 %", bounds.t98, COMPLETE)):
        if limit.best_tour is not None:
            reached = _drive(limit.tour, world, protocol, bounds.start, visibility, goal, name)
            if reached != limit.best_tour:
                got = "never" if reached is None else reached
                raise ValueError(f"tour to {name}: expected it at step {limit.best_tour}, got {got}")


def _check_mission(bounds: OracleBounds, world: World, countable: int) -> None:
    digest = world_hash(world)
    if bounds.world_hash != digest:
        raise ValueError(f"world_hash: expected {digest[:12]}…, got {bounds.world_hash[:12]}…")
    last = len(world.starts) - 1
    if bounds.start > last:
        raise ValueError(f"start: expected 0 to {last} for {world.name}, got {bounds.start}")
    if bounds.countable != countable:
        raise ValueError(f"countable: expected {countable}, got {bounds.countable}")


def _drive(
    tour: Walk,
    world: World,
    protocol: SurveyProtocol,
    start: int,
    visibility: Visibility,
    goal: float,
    name: str,
) -> int | None:
    """The step at which the share is reached."""
    robot = Teleport(world, protocol, world.starts[start], solids=visibility.solids)
    moves = [*[Decision(turn=0.5 * math.pi)] * LOOK_AROUND, *_decisions(tour, protocol)]
    pose = protocol.snap(world.starts[start])
    countable = visibility.countable
    total = int(countable.sum())
    seen = visibility.seen(np.array([[pose.x, pose.y, pose.yaw]]))[0]
    for step, decision in enumerate([None, *moves]):
        if decision is not None:
            arrival = robot.go_to(setpoint(pose, decision, protocol))
            pose = arrival.pose
            where = f"({pose.x:g}, {pose.y:g})"
            if arrival.collided:
                raise ValueError(f"tour to {name}: step {step} touches something near {where}")
            if not world.bounds.contains(pose.x, pose.y):
                raise ValueError(f"tour to {name}: step {step} leaves the arena at {where}")
            seen |= visibility.seen(np.array([[pose.x, pose.y, pose.yaw]]))[0]
        if total == 0 or int(seen[countable].sum()) / total >= goal - 1e-12:
            return step
    return None


def tour_poses(bounds: OracleBounds, world: World, protocol: SurveyProtocol) -> npt.NDArray[np.float64]:
    """(n + 1, 3) x, y and yaw after the look-around and after every action of the tour to 100 %."""
    poses = [protocol.snap(world.starts[bounds.start])]
    poses[0] = replace(poses[0], yaw=wrap_angle(poses[0].yaw + LOOK_AROUND * 0.5 * math.pi))
    for decision in _decisions(bounds.full.tour, protocol):
        goal = setpoint(poses[-1], decision, protocol)
        poses.append(SE2(goal.x, goal.y, goal.yaw))
    return np.array([[pose.x, pose.y, pose.yaw] for pose in poses])


def _decisions(tour: Walk, protocol: SurveyProtocol) -> list[Decision]:
    actions = actions_of(protocol)
    wrong = next((action for action in tour if not 0 <= action < len(actions)), None)
    if wrong is not None:
        raise ValueError(f"tour: expected actions 0 to {len(actions) - 1}, got {wrong}")
    return [
        Decision(turn=actions[action][0] * protocol.heading_step, advance=actions[action][1])
        for action in tour
    ]


def check(bounds: OracleBounds, world: World) -> None:
    """Fly both tours and search again that no shorter walk passes the witnesses.

    Raises:
        ValueError: Something that the bounds claim does not hold.
    """
    protocol = protocol_named(bounds.protocol)
    visibility = Visibility(world, protocol)
    drive(bounds, world, visibility=visibility)
    graph = pose_graph(world, protocol, start=bounds.start, visibility=visibility)
    number = {int(target): i for i, target in enumerate(graph.individuals)}
    looks = _shown_by_looking(graph, protocol)
    for name, limit, may_miss in (
        ("100 %", bounds.full, 0),
        ("98.26 %", bounds.t98, may_miss_t98(bounds.countable)),
    ):
        looked = next((k for k, unseen in enumerate(looks) if unseen <= may_miss), None)
        if looked is not None:
            if limit.lower_bound > looked:
                raise ValueError(f"lower bound of {name}: the look-around reaches it at step {looked}")
            continue
        if limit.lower_bound <= LOOK_AROUND + 1:
            continue
        if any(target not in number for witness in limit.witnesses for target in witness):
            raise ValueError(f"witnesses of {name}: expected individuals that count")
        witnesses = [tuple(number[target] for target in witness) for witness in limit.witnesses]
        if not verify(graph, may_miss, witnesses, limit.lower_bound - LOOK_AROUND):
            raise ValueError(f"lower bound of {name}: the witnesses do not certify {limit.lower_bound} steps")


def walks_of(
    results: Results, bounds: OracleBounds | tuple[str, str, int, int]
) -> Callable[[PoseGraph], list[Walk]]:
    """What the missions of a benchmark folder did after the look-around, as walks to begin with."""
    key = bounds.key if isinstance(bounds, OracleBounds) else bounds
    traces = [trace for mission, trace in results.traces.items() if mission[:4] == key]

    def walks(graph: PoseGraph) -> list[Walk]:
        flown = [np.column_stack([trace.x, trace.y, np.radians(trace.yaw_deg)]) for trace in traces]
        return [follow(graph, poses[LOOK_AROUND:]) for poses in flown if len(poses) > LOOK_AROUND + 1]

    return walks


def read_bounds(path: Path) -> list[OracleBounds]:
    """As `read_lines`, of planar protocols."""
    return read_lines(path, OracleBounds)


def read_lines(path: Path, kind: type[K]) -> list[K]:
    """All lines of a file of bounds.

    Args:
        path: Where it lies.
        kind: What a line holds.

    Raises:
        OSError: There is no such file.
        ValueError: A line is damaged or stands twice; names file and line.
    """
    with path.open(encoding="utf-8") as file:
        return _read(file, str(path), kind)


def _read(lines: Iterable[str], name: str, kind: type[K]) -> list[K]:
    found: dict[tuple[str, str, int, int], K] = {}
    for number, line in enumerate(lines, 1):
        try:
            if len(line) > LONGEST_LINE:
                raise ValueError(f"expected at most {LONGEST_LINE} characters, got {len(line)}")
            bounds = kind.from_dict(json.loads(line))
            if bounds.key in found:
                raise ValueError(f"{bounds.key} stands there twice")
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{name}, line {number}: {error}") from error
        found[bounds.key] = bounds
    return list(found.values())


def write_bounds(path: Path, every: Sequence[KeptBounds]) -> None:
    """Write a file of bounds, whole or not at all."""
    lines = (json.dumps(bounds.as_dict(), allow_nan=False, separators=(",", ":")) for bounds in every)
    write_whole(path, "".join(line + "\n" for line in lines).encode())


def known_bounds(protocol: str, world: str, seed: int, start: int, world_hash: str) -> OracleBounds | None:
    """The bounds of a mission that come with the package; None where there are none, or of another world.

    Raises:
        ValueError: A file of the package is damaged; names file and line.
    """
    bounds = every_known().get((protocol, world, seed, start))
    return bounds if bounds is not None and bounds.world_hash == world_hash else None


@functools.cache
def every_known() -> dict[tuple[str, str, int, int], OracleBounds]:
    """All bounds that come with the package, by `OracleBounds.key`, be their worlds today's or not.

    Those of a protocol hold under its noisy variants too.

    Raises:
        ValueError: A file of the package is damaged; names file and line.
    """
    folder = importlib.resources.files("dream.evaluation.oracle") / "known"
    found: dict[tuple[str, str, int, int], OracleBounds] = {}
    for suite in KNOWN:
        with contextlib.suppress(FileNotFoundError):
            lines = (folder / f"{suite}.jsonl").read_text(encoding="utf-8").splitlines()
            found.update(
                {bounds.key: bounds for bounds in _read(lines, f"known/{suite}.jsonl", OracleBounds)}
            )
    for bounds in list(found.values()):
        for noisy in noisy_variants(protocol_named(bounds.protocol)):
            alike = replace(bounds, protocol=noisy.name)
            found.setdefault(alike.key, alike)
    return found
