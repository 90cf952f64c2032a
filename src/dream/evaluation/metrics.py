"""What a mission achieved: coverage three ways, time in steps, contacts, distance."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.ending import why
from dream.geometry import SE3, Bounds, Camera, camera_mount
from dream.orders import Flown, Leg, Orders, Outcome, Task, place
from dream.protocol import SurveyProtocol
from dream.sim.inspection import Inspection
from dream.sim.render import Renderer
from dream.sim.visibility import Visibility
from dream.sim.world import Mesh, World
from dream.types import Exchange, Home, Step

MILESTONES = {"t90": 0.90, "t95": 0.95, "t98": 0.9826, "t100": 1.0}
"""Shares of the instances whose step is reported; 98.26 % is the paper's own coverage."""
COMPLETE = MILESTONES["t98"]
VISIBLE_PIXELS = 3
"""An individual counts as visible in a rendered image from this many pixels on."""

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Coverage:
    """Shares in [0, 1] of what can be seen at all."""

    instances: float
    """Individuals seen; the headline."""
    clusters: float
    """Groups of which half the individuals were seen."""
    area: float
    """Target cells seen; for a wreck, outer surface seen."""
    visible: float
    """Individuals that showed at least `VISIBLE_PIXELS` pixels within reach in some frame."""

    def as_dict(self) -> dict[str, float]:
        """For a file."""
        return {name: round(getattr(self, name), 6) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class _Asked:
    """What of a question to a model a summary needs: neither its words nor its pictures."""

    model: str
    answered_by: str
    prompt: str
    requests: int
    tokens_in: int
    tokens_out: int
    cost_usd: float | None
    seconds: float
    fallback: str
    """Why no reply counted; empty where one did."""
    outcome: str
    """In a word, what came of one that did."""


@dataclass(frozen=True, slots=True)
class _Entry:
    """What of a step a summary needs: neither its images nor its map."""

    index: int
    collided: bool
    distance: float
    clearance: float
    turned: bool
    guarded: bool
    claimed: bool
    planner_s: float
    time: float
    error: float
    waited: float
    asked: tuple[_Asked, ...]
    ended: str
    home: Home | None


class Logbook:
    """Keeps what a summary needs of every step: hand it each, in order. It knows nothing of a truth."""

    def __init__(self, protocol: SurveyProtocol, orders: Orders | None = None) -> None:
        self._protocol, self._orders = protocol, orders
        self._legs: dict[int, Flown] = {}
        self._steps_of: Counter[int] = Counter()
        self._log: list[_Entry] = []

    def note(self, step: Step) -> None:
        """Take in one more step."""
        if step.leg is not None and self._orders is not None:
            self._legs[step.leg.number] = step.leg
            self._steps_of[step.leg.number] += step.index > 0
        truth = step.observation.T_world_base if step.arrival.truth is None else step.arrival.truth
        self._log.append(
            _Entry(
                index=step.index,
                collided=step.arrival.collided,
                distance=step.arrival.distance,
                clearance=step.arrival.clearance,
                turned=step.guarded.decision.turn != 0.0,
                guarded=bool(step.guarded.note),
                claimed=step.decision.done,
                planner_s=step.planner_s,
                time=step.observation.time,
                error=truth.se2.distance(step.observation.pose),
                waited=step.decision.waited,
                asked=tuple(map(_digest, step.decision.exchanges)),
                ended=step.ended,
                home=step.home,
            )
        )

    def summary(self) -> dict[str, Any]:
        """What `summary.json` says of a finished mission. What only a truth could tell is None."""
        moves = self._log[1:]
        steps, ended = (self._log[-1].index, self._log[-1].ended) if self._log else (0, "")
        claims = [entry.index for entry in moves if entry.claimed]
        clearance = min((entry.clearance for entry in moves), default=math.inf)
        planner_ms = [1e3 * entry.planner_s for entry in moves] or [0.0]
        distance = sum(entry.distance for entry in moves)
        return {
            "ended": ended or "aborted",
            "why": why(ended, None),
            "steps": steps,
            "t_stop": steps if ended == "done" else None,
            "t_claimed": claims[0] if claims else None,
            **dict.fromkeys(MILESTONES),
            "coverage": dict.fromkeys(Coverage.__slots__),
            "countable": None,
            "collisions": sum(entry.collided for entry in moves),
            "distance_m": round(distance, 3),
            "position_error_m": None,
            "drift": None,
            "turns": sum(entry.turned for entry in moves),
            "guarded": sum(entry.guarded for entry in moves),
            "min_clearance_m": round(clearance, 3) if math.isfinite(clearance) else None,
            "planner_ms": {
                "p50": round(float(np.percentile(planner_ms, 50)), 2),
                "p99": round(float(np.percentile(planner_ms, 99)), 2),
            },
            "mission_s": self.mission_s,
            "vlm": self._vlm(),
            "success": None,
            **({} if self._orders is None else {"legs": self._flown(self._orders)}),
            "home": self._home(),
        }

    @property
    def mission_s(self) -> float:
        """Seconds so far on the mission's clock, waiting included."""
        return round((self._log[-1].time if self._log else 0.0) + self._waited(), 3)

    def _home(self) -> dict[str, Any] | None:
        """How it stood with the way home at the end; None of a mission that need not go home."""
        home = self._log[-1].home if self._log else None
        if home is None:
            return None
        left = {balance.name: round(balance.left, 3) for balance in home.balances}
        return {"reached": home.reached, "why": home.why, "left": left}

    def _waited(self) -> float:
        return math.fsum(entry.waited for entry in self._log)

    def _vlm(self) -> dict[str, Any] | None:
        """What was asked of a model, all mission long; None where nothing was."""
        asked = [question for entry in self._log for question in entry.asked]
        if not asked:
            return None
        costs = [question.cost_usd for question in asked]
        known = [cost for cost in costs if cost is not None]
        seconds = [question.seconds for question in asked]
        tokens_in = sum(question.tokens_in for question in asked)
        tokens_out = sum(question.tokens_out for question in asked)
        silent = [question.fallback for question in asked if question.fallback]
        reasons = Counter(fallback.partition(":")[0] for fallback in silent)
        return {
            "model": ", ".join(dict.fromkeys(question.model for question in asked)),
            "answered_by": list(dict.fromkeys(filter(None, (question.answered_by for question in asked)))),
            "prompts": list(dict.fromkeys(question.prompt for question in asked)),
            "calls": sum(question.requests for question in asked),
            "questions": len(asked),
            "tokens": tokens_in + tokens_out,
            "tokens_in": tokens_in,
            "tokens_out": tokens_out,
            "cost_usd": round(math.fsum(known), 6) if len(known) == len(costs) else None,
            "outcomes": dict(
                Counter(question.outcome for question in asked if question.outcome).most_common()
            ),
            "fallbacks": len(silent),
            "reasons": dict(sorted(reasons.items())),
            "last_fallback": silent[-1] if silent else "",
            "waited_s": round(self._waited(), 3),
            "latency_s": {f"p{p}": round(float(np.percentile(seconds, p)), 3) for p in (50, 99)},
        }

    def _flown(self, orders: Orders) -> list[dict[str, Any]]:
        """What came of each leg of the orders, as in `summary.json`."""
        legs = []
        for number, leg in enumerate(orders.legs, start=1):
            flown = self._legs.get(number)
            outcome = "not flown" if flown is None else flown.outcome or "not ended"
            legs.append(
                {
                    "task": leg.task.value,
                    "target": leg.target.value,
                    "area": None if flown is None else _as_list(flown.area),
                    "outcome": str(outcome),
                    "steps": self._steps_of[number],
                }
            )
        return legs


def sight_in(world: World, protocol: SurveyProtocol) -> Visibility | Inspection:
    """What counts as found in a world: what is seen, or in space what is inspected."""
    return Visibility(world, protocol) if protocol.space is None else Inspection(world, protocol)


class Scorer(Logbook):
    """Scores a mission while it runs: hand it every step, in order.

    Seeing is geometry (`sim.visibility`), and so is inspecting (`sim.inspection`), so that scoring, simulator
    and oracle agree exactly. Where there are orders, only individuals in the area of a leg that maps count;
    where that is a side of something, they do so from when it was found on.
    """

    def __init__(
        self,
        world: World,
        protocol: SurveyProtocol,
        *,
        visibility: Visibility | Inspection | None = None,
        renderer: Renderer | None = None,
        orders: Orders | None = None,
    ) -> None:
        """Score by the visibility and the renderer of this world where they are made already."""
        self._bounds, self._positions = world.bounds, np.asarray(world.targets.position[:, :2], np.float64)
        super().__init__(protocol, orders)
        self._sight = sight_in(world, protocol) if visibility is None else visibility
        self._renderer = renderer or Renderer(world)
        self._countable = self._counted()
        self._group = np.asarray(world.targets.group)
        self._piece, self._piece_area = _area_pieces(world, protocol)
        self._first_seen = np.full(len(world.targets), -1)
        """The step at which it first counted as seen, in space as inspected; −1 where not yet."""
        self._first_at_any_angle = np.full(len(world.targets), -1)
        """In space: the step at which it was first seen at all."""
        self._tilt = protocol.camera_pitch
        """Of the camera, as it was told to be."""
        self._shown = np.zeros(len(world.targets), dtype=bool)

    def add(self, step: Step) -> Coverage:
        """Score one more step and say how much has been covered since the start."""
        T_world_base = step.observation.T_world_base if step.arrival.truth is None else step.arrival.truth
        if step.guarded.decision.tilt is not None:
            self._tilt = step.guarded.decision.tilt
        T_base_camera, pose = step.observation.T_base_camera, T_world_base.se2
        if isinstance(self._sight, Inspection):
            look = self._sight.look(T_world_base, self._tilt)
            self._first_at_any_angle[look.seen & (self._first_at_any_angle < 0)] = step.index
            counts = look.inspected
            T_base_camera = camera_mount(self._tilt)  # What the observation says may be off.
        else:
            counts = self._sight.seen(np.array([[pose.x, pose.y, pose.yaw]]))[0]
        self._first_seen[counts & ~self._seen] = step.index
        self._shown |= self._shows(step.observation.camera, T_world_base @ T_base_camera)
        self.note(step)
        self._countable = self._counted()
        return self._coverage()

    @property
    def _seen(self) -> BoolArray:
        return self._first_seen >= 0

    def _counted(self) -> BoolArray:
        """(N,) individuals that count, by what is known of where the legs are."""
        countable = self._sight.countable
        if self._orders is None:
            return countable
        counted = np.zeros(len(countable), np.bool_)
        for number, leg in enumerate(self._orders.legs, start=1):
            if leg.task is Task.MAP:
                counted |= self._lies_in(number, leg)
        return countable & counted

    def _lies_in(self, number: int, leg: Leg) -> BoolArray:
        """(N,) individuals in the area of a leg; none as long as nobody knows where it is."""
        try:
            area = self._legs[number].area if number in self._legs else place(leg.area, self._bounds, {})
        except LookupError:
            return np.zeros(len(self._positions), np.bool_)
        if area is None:
            return np.ones(len(self._positions), np.bool_)
        x, y = self._positions.T
        return area.covers(x, y)

    def _shows(self, camera: Camera, T_world_camera: SE3) -> BoolArray:
        frame = self._renderer.measure(camera, T_world_camera)
        points = camera.back_project(frame.depth, T_world_camera)
        origin = T_world_camera.translation
        away = np.hypot(points[..., 0] - origin[0], points[..., 1] - origin[1])
        if self._protocol.space is not None:
            away = np.hypot(away, points[..., 2] - origin[2])
        near = away <= self._protocol.reach
        pixels = np.bincount(frame.ids[near & (frame.ids >= 0)], minlength=len(self._shown))
        return pixels >= VISIBLE_PIXELS

    def _coverage(self) -> Coverage:
        countable = self._countable
        return Coverage(
            instances=_share(self._seen[countable]),
            clusters=self._cluster_share(),
            area=self._area_share(),
            visible=_share(self._shown[countable]),
        )

    def _cluster_share(self) -> float:
        group = self._group[self._countable]
        if len(group) == 0:
            return 1.0
        _, member = np.unique(group, return_inverse=True)
        total = np.bincount(member)
        seen = np.bincount(member, weights=self._seen[self._countable])
        return _share(seen >= 0.5 * total)

    def _area_share(self) -> float:
        countable = self._countable
        if not countable.any():
            return 1.0
        piece = self._piece[countable]
        total = np.zeros(len(self._piece_area))
        seen = np.zeros(len(self._piece_area))
        total[piece] = self._piece_area[piece]
        hit = piece[self._seen[countable]]
        seen[hit] = self._piece_area[hit]
        return float(seen.sum() / total.sum())

    def summary(self) -> dict[str, Any]:
        """The scores of the finished mission, as in `summary.json`."""
        coverage, told = self._coverage(), super().summary()
        vlm, distance = told["vlm"], sum(entry.distance for entry in self._log[1:])
        missed = any(leg.outcome is Outcome.NOT_FOUND for leg in self._legs.values())
        success = (
            told["ended"] == "done"
            and told["steps"] <= self._protocol.cap
            and coverage.instances >= COMPLETE
            and told["collisions"] == 0
            and not missed
            and not without_answer(vlm)
        )
        return {
            **told,
            **{name: self._time_to(share) for name, share in MILESTONES.items()},
            "coverage": coverage.as_dict(),
            "countable": int(self._countable.sum()),
            **self._inspected_shares(),
            **self._navigation(distance),
            "success": success,
        }

    def _inspected_shares(self) -> dict[str, Any]:
        """In space: shares of all surface and of what the pose space can show; empty of a planar mission.

        `whole` is of the area of all individuals, `dropped` the share of that area which no pose space can
        show well enough to count; `seen` counts what was seen at any angle, of what counts.
        """
        if not isinstance(self._sight, Inspection):
            return {}
        area, countable = self._sight.surface.area, self._countable
        whole = float(area.sum())
        inspected = float(area[self._seen].sum())
        return {
            "inspection": {
                "inspected": round(_share(self._seen[countable]), 6),
                "seen": round(_share(self._first_at_any_angle[countable] >= 0), 6),
                "whole": round(inspected / whole if whole > 0.0 else 1.0, 6),
                "dropped": round(self._sight.dropped, 6),
            }
        }

    @property
    def first_found(self) -> npt.NDArray[np.intp]:
        """(N,) the step at which each individual first counted; −1 where it does not yet."""
        return self._first_seen.copy()

    @property
    def first_at_any_angle(self) -> npt.NDArray[np.intp]:
        """(N,) in space: the step at which each was first seen, at whatever angle; −1 where not yet."""
        return self._first_at_any_angle.copy()

    def _navigation(self, distance: float) -> dict[str, Any]:
        """How far the vehicle was from where it believed to be, over so many metres."""
        errors = np.array([entry.error for entry in self._log] or [0.0])
        error = {"rmse": round(float(np.sqrt((errors**2).mean())), 4), "end": round(float(errors[-1]), 4)}
        return {"position_error_m": error, "drift": round(error["end"] / distance, 6) if distance else 0.0}

    def _time_to(self, share: float) -> int | None:
        first = self._first_seen[self._countable]
        shares = ((entry.index, _share((first >= 0) & (first <= entry.index))) for entry in self._log)
        return next((index for index, reached in shares if reached >= share - 1e-12), None)


def without_answer(vlm: Mapping[str, Any] | None) -> str:
    """What must be said of a mission in whose summary no answer of its model counts; empty of any other.

    A model that never gave an answer has flown nothing.
    """
    if vlm is None or vlm["fallbacks"] < vlm["questions"]:
        return ""
    last = vlm["last_fallback"].rstrip(".… ")
    return (
        f"no answer of {vlm['model']} counted: geometry decided all {vlm['questions']} questions, so that "
        f"nothing here shows what the model can do. The last had none because of {last}"
    )


def _digest(exchange: Exchange) -> _Asked:
    return _Asked(
        model=exchange.model,
        answered_by=exchange.answered_by,
        prompt=exchange.prompt,
        requests=exchange.requests,
        tokens_in=exchange.tokens_in,
        tokens_out=exchange.tokens_out,
        cost_usd=exchange.cost_usd,
        seconds=exchange.seconds,
        fallback=exchange.fallback,
        outcome=exchange.outcome.partition(":")[0],
    )


CURVE = (50, 100, 137, 200)
"""Steps after which the share of the instances is reported; the paper's own mission took 137.3."""


def curve(instances: Sequence[float], cap: int) -> dict[str, float]:
    """Coverage on the way: `c50` to `c200`, and `auc`, its mean over steps 1 to `cap`.

    Args:
        instances: Share of the instances after each step, the first look first. What a mission ended
            with stays, so that one which stopped early can be compared.
        cap: Of the protocol.
    """
    last = len(instances) - 1
    held = [instances[min(step, last)] for step in range(1, cap + 1)]
    return {
        **{f"c{step}": round(instances[min(step, last)], 6) for step in CURVE},
        "auc": round(math.fsum(held) / cap, 6),
    }


def _as_list(area: Bounds | None) -> list[float] | None:
    """x_min, y_min, x_max, y_max; None for everything."""
    return None if area is None else [round(side, 3) for side in asdict(area).values()]


def _share(flags: BoolArray) -> float:
    return float(flags.mean()) if flags.size else 1.0


def _area_pieces(
    world: World, protocol: SurveyProtocol
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
    """The piece of area that each individual stands for, and the size of every piece.

    On a reef a piece is a map cell, shared by the clumps in it; on a wreck, a patch's own surface.
    """
    hull, clumps = world.targets.chosen(world.hull), world.targets.chosen(~world.hull)
    each = zip(hull.mesh, hull.scale, strict=True)
    surface = np.array([_surface(world.meshes[mesh], scale) for mesh, scale in each], np.float64)
    cells = np.floor(np.asarray(clumps.position[:, :2], np.float64) / protocol.cell).astype(np.int64)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    piece = np.empty(len(world.targets), np.intp)
    piece[world.hull] = np.arange(len(hull))
    piece[~world.hull] = len(hull) + cell
    return piece, np.concatenate([surface, np.full(cell.max(initial=-1) + 1, protocol.cell**2)])


def _surface(mesh: Mesh, scale: npt.NDArray[Any]) -> float:
    corners = (mesh.vertices * scale)[mesh.faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(0.5 * np.linalg.norm(normals, axis=1).sum())
