"""The words that all parts share: what is seen, what is decided, where to go, where it ended.

Images are (H, W[, 3]): `uint8` for rgb and labels, `float32` metres for depth, along the optical
axis, NaN where there is no return. See `dream.geometry` for frames.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, SE3, Bounds, Camera
from dream.protocol import SurveyProtocol

if TYPE_CHECKING:
    from dream.mapping.occupancy import OccupancyMap
    from dream.mapping.prior import Prior
    from dream.orders import Flown

UInt8Array = npt.NDArray[np.uint8]
Float32Array = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.signedinteger[Any]]


LOOK_AROUND = 3
"""Quarter turns of the in-place rotation that every mission begins with; they count as steps."""


class Label(enum.IntEnum):
    """The class of one pixel."""

    WATER = 0
    SEABED = 1
    TARGET = 2
    OBSTACLE = 3


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """One camera frame with the pose it was taken from."""

    time: float
    """Seconds since the mission started."""
    rgb: UInt8Array
    """(k H, k W, 3): colour may be finer than depth and labels, by a whole factor k."""
    depth: Float32Array
    """(H, W) metres along the optical axis; NaN where there is no return."""
    labels: UInt8Array
    """(H, W) values of `Label`."""
    camera: Camera
    T_world_base: SE3
    T_base_camera: SE3
    confidence: Float32Array | None = None
    """(H, W) probability that depth and label are right, where nothing returns that the label is; None where
    all are taken for right."""
    error: Float32Array | None = None
    """(H, W) mean of the logarithm, without its sign, of depth over truth, NaN where there is no depth; None
    where depths err as the protocol says."""

    drawn_wh: float | None = None
    """Watt-hours that the vehicle has drawn from its battery so far; None where nobody measures that."""
    trouble: str = ""
    """What is wrong with the vehicle, so that it has to go home; empty where nothing is."""

    def __post_init__(self) -> None:
        self.camera.scaled(max(1, len(self.rgb) // self.camera.height)).check(self.rgb, "rgb")
        self.camera.check(self.depth, "depth")
        self.camera.check(self.labels, "labels")
        if self.confidence is not None:
            self.camera.check(self.confidence, "confidence")
            if not (self.confidence.min() >= 0.0 and self.confidence.max() <= 1.0):
                raise ValueError("confidence: expected probabilities in [0, 1], got others")
        if self.error is not None:
            self.camera.check(self.error, "error")
            if (self.error < 0.0).any():
                raise ValueError("error: expected 0 or more, or NaN, got less")

    @property
    def T_world_camera(self) -> SE3:
        """Where the optical frame was."""
        return self.T_world_base @ self.T_base_camera

    @property
    def pose(self) -> SE2:
        """The vehicle's position and heading on the ground plane."""
        return self.T_world_base.se2

    @property
    def z(self) -> float:
        """The vehicle's height in the world, metres."""
        return float(self.T_world_base.translation[2])

    @property
    def tilt(self) -> float:
        """Pitch of the camera in the vehicle, radians, positive downwards."""
        ahead, _, up = self.T_base_camera.rotation[:, 2].tolist()
        return math.atan2(-up, ahead)


class Target(enum.StrEnum):
    """What a mission looks for."""

    ANY = "any"
    OYSTERS = "oysters"
    WRECK = "wreck"


@dataclass(frozen=True, slots=True)
class Asked:
    """What was spent on asking models."""

    calls: int = 0
    """Messages that were sent."""
    cost_usd: float | None = 0.0
    """None where the price of one of them is not known."""

    def __add__(self, exchange: Exchange) -> Asked:
        costs = (self.cost_usd, exchange.cost_usd)
        total = None if None in costs else math.fsum(cost for cost in costs if cost is not None)
        return Asked(self.calls + exchange.requests, total)


UNASKED = Asked()


@dataclass(frozen=True, slots=True)
class Mission:
    """What a planner is told before it starts: the rules and the operator's orders, nothing of the world."""

    protocol: SurveyProtocol
    bounds: Bounds
    """The operator's box."""
    max_steps: int
    target: Target = Target.ANY
    """What the operator looks for: the labels of the camera know one kind of target."""
    area: Bounds | None = None
    """What has to be seen, a part of the box; all of it where None."""
    flown: int = LOOK_AROUND
    """Steps that are spent before the planner decides for the first time."""
    asked: Asked = UNASKED
    """What was spent on models before that, by earlier legs of the same orders."""
    prior: Prior | None = None
    """What an earlier survey holds of the same ground; how things were, not how they are."""

    @property
    def to_see(self) -> Bounds:
        """The box of what has to be seen."""
        return self.bounds if self.area is None else self.area


@dataclass(frozen=True, slots=True)
class Reasoning:
    """The paper's six reasoning steps, one plain sentence or two each."""

    distribution: str = ""
    target_area: str = ""
    completion: str = ""
    next_target: str = ""
    safety: str = ""
    action: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Exchange:
    """One question to a model, and what came of it."""

    prompt: str
    """Name and version of the prompt."""
    model: str
    question: str
    """The text as it was sent; a picture's name in brackets where it stood."""
    pictures: Mapping[str, bytes]
    """PNG files by name."""
    replies: tuple[str, ...]
    """The text of each reply as it came. The last is the one that counted; those before were asked again."""
    fallback: str
    """Why no reply counted, and the offline planner decided; empty where one did."""
    requests: int
    """Messages that were sent to the model."""
    tokens_in: int
    tokens_out: int
    cost_usd: float | None
    """None where the price of the model is not known."""
    seconds: float
    """Wall time."""
    answered_by: str = ""
    """The model that answered last, as the server calls it: often with its date. Empty where none did."""
    outcome: str = ""
    """What came of a reply that fits: `followed`, `as the offline planner would`, `overruled` or `not heard`;
    then a colon and why, where there is more to say. Empty where none fits, and where no mission is flown."""
    lacks: tuple[str, ...] = ()
    """What each reply lacked to be an answer, in a line; empty for one that is."""
    expected: Mapping[str, Any] = field(default_factory=dict)
    """JSON schema of an answer, with the turns and lengths that are allowed; empty where it was not kept."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What a planner says: turn, advance, climb and tilt; or done.

    Under a planar protocol turn, then advance. Nothing of all means stop: hold and look again.
    """

    turn: float = 0.0
    """Radians, positive to the left."""
    advance: float = 0.0
    """Metres along the new heading, never negative."""
    done: bool = False
    """The planner holds the mission to be complete."""
    reasoning: Reasoning = field(default_factory=Reasoning)
    exchanges: tuple[Exchange, ...] = field(default=(), compare=False)
    """What was asked of a model for it, and came back since the last decision. Equal decisions may differ in
    it: it tells how long an answer took."""
    waited: float = 0.0
    """Seconds of the mission that the vehicle stood still for it."""
    climb: float = 0.0
    """Metres upwards, made together with turn and advance; 0 under a planar protocol."""
    tilt: float | None = None
    """Pitch of the camera after the move, radians, positive downwards; None leaves it as it is."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.turn) and math.isfinite(self.advance)) or self.advance < 0.0:
            raise ValueError(
                f"decision: expected a finite turn and a finite advance of at least 0, "
                f"got turn={self.turn}, advance={self.advance}"
            )
        if not (math.isfinite(self.climb) and (self.tilt is None or math.isfinite(self.tilt))):
            raise ValueError(
                f"decision: expected a finite climb, and a finite tilt or none, "
                f"got climb={self.climb}, tilt={self.tilt}"
            )
        if self.done and not self.stops:
            raise ValueError("decision: done stays where it is; expected turn, advance and climb 0, no tilt")

    @property
    def stops(self) -> bool:
        """Neither turns, advances nor climbs, and leaves the camera as it is."""
        return self.turn == self.advance == self.climb == 0.0 and self.tilt is None


@dataclass(frozen=True, slots=True)
class Guarded:
    """What the guard made of a decision."""

    decision: Decision
    """What is carried out."""
    note: str = ""
    """Why it differs from what was asked; empty where it does not."""


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Where the controller is sent."""

    x: float
    y: float
    yaw: float
    altitude: float | None
    """Metres above the bare seabed, held on the way; None where a height in the world is held."""
    z: float | None = None
    """Height in the world at the end, which the way leads straight to; None where an altitude is held."""
    tilt: float | None = None
    """Pitch of the camera, radians, positive downwards; None leaves it as it is."""

    def __post_init__(self) -> None:
        if (self.altitude is None) == (self.z is None):
            raise ValueError(
                f"setpoint: expected either an altitude or a height, got {self.altitude} and {self.z}"
            )


@dataclass(frozen=True, slots=True)
class BodyVelocity:
    """What the vehicle is told to do over ground, in `base`; or what it does."""

    surge: float
    """m/s, ahead."""
    sway: float
    """m/s, to the left."""
    heave: float
    """m/s, up."""
    yaw_rate: float
    """rad/s, to the left."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """Where a move really ended, and how it went."""

    pose: SE2
    collided: bool
    """The simulator, or the vehicle itself, felt a contact and stopped."""
    distance: float
    """Metres travelled over ground."""
    clearance: float
    """Least metres between body and terrain, boulders or hull on the way; inf where unknown."""
    note: str = ""
    """What was wrong on the way; empty where nothing was."""
    sigma: float = 0.0
    """Metres by which the position may err along its less certain axis, by the vehicle's own account."""
    truth: SE3 | None = None
    """`T_world_base` as it really is, which only a simulator knows, for scoring; None where the pose that is
    believed is the true one."""
    contact: tuple[float, float, float] | None = None
    """Where the body's centre was when it touched something: x, y and z, metres in the world, as it believes;
    None where it touched nothing."""


@dataclass(frozen=True, slots=True)
class Balance:
    """How a mission stands with one thing that it spends, or may not run out of."""

    name: str
    """`time`, `battery`, `steps`, `tether` or `winding`."""
    unit: str
    left: float
    """Of what it may spend; of tether and winding the whole."""
    way: float
    """That the way home takes, as expected; of tether and winding what is out."""
    margin: float
    """That it may take beyond."""

    @property
    def short(self) -> bool:
        """May the way home take more than is left?"""
        return self.way + self.margin > self.left


@dataclass(frozen=True, slots=True)
class Home:
    """How a mission stands with its way home, after a step."""

    path: tuple[tuple[float, float, float], ...] | None
    """Where it leads over what is known to be free: x, y and z in metres, from here on; empty where it is
    home, None where no way is known."""
    balances: tuple[Balance, ...]
    """What is left beside what the way takes; empty where no way is known."""
    why: str = ""
    """Why the mission goes home; empty while it does not."""

    @property
    def reached(self) -> bool:
        """Is it there?"""
        return self.path == ()


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One decision carried out. The paper's unit of time."""

    index: int
    """0 is the first look, before anything was decided; it costs nothing."""
    decision: Decision
    guarded: Guarded
    arrival: Arrival
    observation: Observation
    """Made where the step ended."""
    occupancy: OccupancyMap
    """The live map, this step's observation included. Whoever keeps it past the step copies it."""
    open_region: str = ""
    """Why a `done` was refused; empty where none was, or where it was accepted."""
    ended: str = ""
    """`done`, `returned` or `cap` on the last step, else empty."""
    planner_s: float = 0.0
    """Wall seconds that the planner took to decide, without those in which its code was compiled."""
    leg: Flown | None = None
    """The leg of the orders that it belongs to; None where it was made outside `mission.explore`."""
    home: Home | None = None
    """How it stands with the way home; None of a mission that need not go home."""
