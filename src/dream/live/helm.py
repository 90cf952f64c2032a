"""A person at the helm: what a planner is told goes to a page, and what the person says becomes a decision.

The thread of the mission waits in `Helmsman.decide`; that of a server reads `Helmsman.view` and calls
`Helmsman.say`. A page is made from the two arguments of `decide` alone, and from what the guard made of the
last decision: of the truth there is nothing to show.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from dream.mapping import OccupancyMap
from dream.protocol import SurveyProtocol
from dream.types import Decision, Mission, Observation, Reasoning, Step

ROUNDING = 1e-6
"""Degrees and metres by which what is said may miss what the protocol allows."""
WAKE_S = 0.5
"""Seconds after which a mission that waits for a person sees whether it was interrupted."""
AWAY_S = 30.0
"""Seconds without a word of the page at the helm after which another page may take it."""

_Number = Annotated[float, Field(ge=-1e6, le=1e6)]


class SaidStep(BaseModel):
    """What a person says: one step, or that it is complete. Degrees and metres; left and up are positive."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    step: Annotated[int, Field(ge=1, le=1_000_000)]
    """Which step is decided, so that nothing is done twice."""
    turn_deg: _Number = 0.0
    advance_m: _Number = 0.0
    climb_m: _Number = 0.0
    tilt_deg: _Number | None = None
    """Pitch of the camera, downwards; None leaves it as it is."""
    done: bool = False

    @classmethod
    def read(cls, content: bytes) -> SaidStep:
        """From JSON; a ValueError that names the field where it is something else."""
        try:
            return cls.model_validate_json(content)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            name = ".".join(map(str, first["loc"])) or "decision"
            raise ValueError(f"{name}: {first['msg']}, got {repr(first['input'])[:80]}") from None

    def decision(self, protocol: SurveyProtocol) -> Decision:
        """The protocol's own decision that this is, to the last bit; a ValueError where it has none such."""
        turn = _allowed("turn_deg", self.turn_deg, protocol.turn_angles, math.degrees)
        advance = _allowed("advance_m", self.advance_m, (0.0, *protocol.advances))
        climb = _allowed("climb_m", self.climb_m, protocol.climbs)
        tilt = None
        if self.tilt_deg is not None:
            if protocol.space is None:
                raise ValueError(
                    f"tilt_deg: expected none, since the camera of {protocol.name} keeps its tilt, "
                    f"got {self.tilt_deg:g}"
                )
            tilt = _allowed("tilt_deg", self.tilt_deg, protocol.tilts, math.degrees)
        moves = turn != 0.0 or advance != 0.0 or climb != 0.0 or tilt is not None
        if self.done and moves:
            raise ValueError("done: expected no move with it, got one. Say either")
        if self.done:
            said = "The person at the helm holds the mission to be complete."
        else:
            said = "Steered by hand." if moves else "Steered by hand: look again from here."
        return Decision(turn, advance, self.done, Reasoning(action=said), climb=climb, tilt=tilt)


def _allowed(
    name: str, said: float, values: tuple[float, ...], shown: Callable[[float], float] = float
) -> float:
    """The value that what was said stands for; a ValueError that lists them where it is none."""
    for value in values:
        if abs(shown(value) - said) <= ROUNDING:
            return value
    listed = ", ".join(f"{shown(value):g}" for value in sorted(values))
    raise ValueError(f"{name}: expected one of {listed}, got {said:g}")


def moves_of(protocol: SurveyProtocol) -> dict[str, Any]:
    """What a page needs to compose a step: everything that is allowed, in degrees and metres, rising."""
    return {
        "protocol": protocol.name,
        "space": protocol.space is not None,
        "turns": sorted(round(math.degrees(turn), 6) for turn in protocol.turn_angles),
        "advances": sorted({0.0, *protocol.advances}),
        "climbs": list(protocol.climbs),
        "tilts": sorted(round(math.degrees(tilt), 6) for tilt in protocol.tilts),
        "lattice": None if protocol.swims else protocol.lattice,
    }


@dataclass(frozen=True, slots=True, eq=False)
class HelmView:
    """What the page shows."""

    number: int
    """Rises with every change."""
    told: Mapping[str, Any]
    """Plain values. `state` is `starting`, `waiting` for a decision, `flying` one, or `over`."""
    pictures: Mapping[str, bytes] = field(default_factory=lambda: MappingProxyType({}))
    """PNG files by name: what a model that sees is shown (`planning.vlm.pictures`)."""


class Helmsman:
    """Planner and pilot of one mission, whose decisions a person makes.

    The person's time is the planner's (`Step.planner_s`). On the mission's clock nobody waits: as with every
    planner that asks no model, the vehicle is taken to stand still for no time between two steps.
    """

    spatial: ClassVar[bool] = True

    def __init__(self, protocol: SurveyProtocol) -> None:
        """Of a mission by these rules that is still to begin."""
        self.protocol = protocol
        self._changed = threading.Condition()
        self._view = HelmView(0, {"state": "starting"})
        self._awaited: int | None = None
        self._decision: Decision | None = None
        self._most = protocol.cap
        self._flown = 0
        self._last: dict[str, Any] | None = None
        self._was: npt.NDArray[np.float64] | None = None
        self._trail: list[tuple[float, float]] = []

    # ---- the mission's side

    def begin(self, mission: Mission) -> Helmsman:
        """A mission begins: nothing is shown before its first decision."""
        self._most, self._flown = mission.max_steps, mission.flown
        return self

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """What the person says, however long that takes."""
        step = self._flown + 1
        told = {**self._told(observation, occupancy), "state": "waiting", "step": step}
        shown = _pictures(observation, occupancy, self._trail)
        with self._changed:
            self._publish(told, shown)
            self._awaited = step
            while self._decision is None:
                self._changed.wait(WAKE_S)
            decision, self._decision = self._decision, None
        return decision

    def note(self, step: Step) -> None:
        """A step was flown: what the page says of it, and its pictures where it was the last."""
        asked, carried_out = step.decision, step.guarded.decision
        pose, seen, space = step.arrival.pose, step.observation, self.protocol.space is not None
        here = np.array([pose.x, pose.y, seen.z])
        was = here if self._was is None else self._was
        self._flown, self._was = step.index, here
        self._trail.append((pose.x, pose.y))
        self._last = {
            "step": step.index,
            "decision": _move(asked),
            "guarded": {**_move(carried_out), "note": step.guarded.note},
            "open_region": step.open_region,
            "pose": _pose(seen, space=space),
            "distance_m": float(np.linalg.norm((here - was)[: 3 if space else 2])),
            "ended": step.ended,
        }
        if step.ended:
            told = {**self._told(seen, step.occupancy), "state": "over"}
            with self._changed:
                self._publish(told, _pictures(seen, step.occupancy, self._trail))

    def end(self, lines: tuple[str, ...]) -> None:
        """The mission is over, and what it came to may be told."""
        with self._changed:
            self._awaited = None
            self._publish({**self._view.told, "state": "over", "outcome": lines}, self._view.pictures)

    def _told(self, observation: Observation, occupancy: OccupancyMap) -> dict[str, Any]:
        heights: list[str] = []
        if occupancy.volume is not None:
            from dream.planning.vlm.heights import heights as told

            heights = told(occupancy.volume, observation, self.protocol.body_radius)
        return {
            "flown": self._flown,
            "most": self._most,
            "pose": _pose(observation, space=self.protocol.space is not None),
            "areas": occupancy.areas(),
            "heights": heights,
            "last": self._last,
            "inset": _inset(occupancy),
        }

    def _publish(self, told: Mapping[str, Any], pictures: Mapping[str, bytes]) -> None:
        self._view = HelmView(self._view.number + 1, told, pictures)

    # ---- the server's side

    @property
    def view(self) -> HelmView:
        """What there is to show now."""
        return self._view

    def say(self, said: SaidStep) -> None:
        """Decide the step that is waited for.

        Raises:
            ValueError: The protocol does not allow it.
            LookupError: It is not the step that is waited for.
        """
        decision = said.decision(self.protocol)
        with self._changed:
            if self._awaited is None:
                raise LookupError("no step waits for a decision now")
            if said.step != self._awaited:
                raise LookupError(f"step {said.step} waits for no decision: step {self._awaited} does")
            self._decision, self._awaited = decision, None
            told = {**self._view.told, "state": "flying", "decision": _move(decision)}
            self._publish(told, self._view.pictures)
            self._changed.notify_all()


class Seat:
    """Who is at the helm: the first page that comes, until it is away and another takes its place."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """An empty one."""
        self._clock = clock
        self._holder = ""
        self._heard = -math.inf

    def hear(self, who: str) -> str:
        """A page is there. Who is at the helm: `yours`, `theirs`, or `free` where nobody is any more."""
        if not self._holder:
            self._holder = who
        if self._holder == who:
            self._heard = self._clock()
            return "yours"
        return "free" if self._clock() - self._heard > AWAY_S else "theirs"

    def take(self, who: str) -> bool:
        """Whether a page is at the helm now; it is where nobody else was."""
        if self.hear(who) == "free":
            self._holder, self._heard = who, self._clock()
        return self._holder == who


def _pose(observation: Observation, *, space: bool) -> dict[str, float | None]:
    """Where the vehicle believes to be, as a recorded step says it."""
    pose = observation.pose
    z, tilt = (observation.z, observation.tilt) if space else (None, None)
    return {"x": pose.x, "y": pose.y, "yaw": pose.yaw, "z": z, "tilt": tilt}


def _move(decision: Decision) -> dict[str, Any]:
    """As a recorded step says it: radians and metres."""
    return {name: getattr(decision, name) for name in ("turn", "advance", "climb", "tilt", "done")}


def _pictures(
    observation: Observation, occupancy: OccupancyMap, trail: list[tuple[float, float]]
) -> Mapping[str, bytes]:
    from dream.planning.vlm.pictures import camera_pictures, cuts, map_picture, png

    drawn = png(map_picture(occupancy, observation.pose, trail))
    more = {} if occupancy.volume is None else cuts(occupancy, observation, trail)
    return MappingProxyType({**camera_pictures(observation), "map": drawn, **more})


def _inset(occupancy: OccupancyMap) -> dict[str, Any]:
    """Where the ground lies on the map's picture: pixels, and its west, south, east and north in metres."""
    from dream.mapping.drawing import inset
    from dream.planning.vlm.pictures import scale_of

    bounds = occupancy.bounds
    on = inset(bounds, occupancy.protocol, scale=scale_of(occupancy))
    return {
        **{name: getattr(on, name) for name in ("left", "top", "width", "height", "picture")},
        "bounds": (bounds.x_min, bounds.y_min, bounds.x_max, bounds.y_max),
    }
