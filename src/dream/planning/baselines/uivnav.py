"""Steering by sight, as a network learnt it from a teacher: no map, no position, no memory."""

from __future__ import annotations

import hashlib
import math
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream import extras
from dream.geometry import SE2, wrap_angle
from dream.options import First
from dream.planning.parameters import check_count, check_range
from dream.protocol import SurveyProtocol
from dream.types import Decision, Float32Array, Mission, Observation, Reasoning, UInt8Array

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.perception.onnx import Network

SHIPPED = Path(__file__).parent.parent / "weights" / "uivnav.onnx"
"""The network that comes with DREAM; `uivnav.json` beside it is its card."""
TURNS_DEG = (-90, -60, -30, 0, 30, 60, 90)
"""What the network chooses between, in the order of its outputs: from right to left."""
MOST_BYTES = 16 << 20
"""Of a network's file; the one that comes with DREAM has less than 3 MB."""


@dataclass(frozen=True, slots=True)
class UivNav:
    """See where the target is and what is near, and steer as the teacher would have.

    What it does: makes of each frame a small image of two channels, nearness and share of target
    (`perception.representation`); asks a network for the turn; then advances by the protocol's longest step.
    It reads neither map nor colours, and of the position only whether it changed. Of the steps before it
    keeps their number, for its dice, and one bit: where straight on got it nowhere, it does not try
    straight on again at once. For the guard shortens its moves as everybody's, and the edge of the area
    is nothing that a camera shows.

    Reference: UIVNav (arXiv 2309.08806), re-implemented: its representation, network and data are not
    published; these are ours. See docs/planner.md.

    Assumes: a camera like the protocol's, and targets that a frame shows. Fails when: there is nothing in
    view to steer for, or what is in view was seen long ago: it has no memory, and goes round. It never says
    that it is done.
    """

    temperature: First[float] = 1.0
    """How freely it draws its turn: 1 draws as often as the network says, 0 takes the likeliest."""
    walk_seed: First[int] = 0
    """Seed of the draws: any number makes another flight."""
    weights: First[str | None] = None
    """ONNX file of another network, such as one of `dream train uivnav`. Unless given, the shipped one."""

    def __post_init__(self) -> None:
        check_range("temperature", self.temperature, 0.0, 10.0)
        check_count("walk_seed", self.walk_seed, 0, 2**63 - 1)
        if self.weights is not None and not isinstance(self.weights, str):
            raise ValueError(f"weights: expected the path of an ONNX file, got {self.weights!r}")

    def check_installed(self) -> None:
        """Raise a ValueError where what runs the network is not installed."""
        extras.check_installed("learned", "uivnav", "onnxruntime")

    def begin(self, mission: Mission) -> _Sighted:
        """A fresh pilot, the same for the same seed.

        Raises:
            ValueError: The network is refused, with the reason, or ONNX Runtime is not installed.
        """
        return _Sighted(self, mission.protocol, opened(self.weights))


def weights_sha256(planner: object) -> str | None:
    """SHA-256 of the file whose network a planner asks; None where there is none but what comes with DREAM.

    Raises:
        ValueError: It cannot be read.
    """
    if not isinstance(planner, UivNav) or planner.weights is None:
        return None
    try:
        with Path(planner.weights).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ValueError(
            f"weights: expected the path of an ONNX file, got {planner.weights} ({error.strerror or error})"
        ) from error


def opened(weights: str | None = None) -> Policy:
    """The network in a file, checked; the one that comes with DREAM where None.

    Raises:
        ValueError: It is too large, damaged, not as its card says, or has other inputs or outputs.
    """
    from dream.perception.onnx import Network, sha256_of

    if weights is None:
        digest = sha256_of(SHIPPED.with_suffix(".json"))
        network = Network(SHIPPED, most=MOST_BYTES, sha256=digest, extra="learned")
    else:
        network = Network(weights, most=MOST_BYTES, extra="learned")
    return Policy(network)


class Policy:
    """A network that was found to be one that steers."""

    def __init__(self, network: Network) -> None:
        """Check its inputs and outputs, and ask it twice.

        Raises:
            ValueError: They are not as they should be.
        """
        from dream.perception.representation import HEIGHT, WIDTH

        expected = (2, HEIGHT, WIDTH)
        if any(got not in (want, None) for got, want in zip(network.input_shape[1:], expected, strict=True)):
            raise ValueError(
                f"weights: expected an input of (n, 2, {HEIGHT}, {WIDTH}), got {network.input_shape} in "
                f"{network.path}. Was it trained on `perception.represent`?"
            )
        if len(network.outputs) != 1:
            raise ValueError(f"weights: expected one output, got {', '.join(network.outputs) or 'none'}")
        self._network = network
        self._name = next(iter(network.outputs))
        for level in (0, 255):
            self.logits(np.full(expected, level, np.uint8))

    def logits(self, picture: UInt8Array) -> Float32Array:
        """(7,) a score for each of `TURNS_DEG`.

        Args:
            picture: (2, 72, 96) uint8; see `perception.represent`.

        Raises:
            ValueError: They are not seven finite numbers.
        """
        fed = picture[None].astype(np.float32) / np.float32(255.0)
        (scores,) = self._network.run(fed, [self._name])
        if scores.shape != (1, len(TURNS_DEG)):
            raise ValueError(
                f"weights: expected (n, {len(TURNS_DEG)}) logits, one for each turn, got {scores.shape} from "
                f"{self._network.path}"
            )
        logits: Float32Array = scores[0].astype(np.float32)
        if not np.isfinite(logits).all():
            raise ValueError(
                f"weights: expected finite numbers in logits of {self._network.path}, got others"
            )
        return logits


@dataclass(slots=True)
class _Sighted:
    planner: UivNav
    protocol: SurveyProtocol
    policy: Policy
    steps: int = 0
    from_here: SE2 | None = None
    """Where it last went straight on from; None where it turned. Only whether it got away is asked of it."""

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        from dream.perception.representation import represent

        protocol = self.protocol
        depth = np.where(observation.depth <= protocol.returns[1], observation.depth, np.float32(np.nan))
        picture = represent(depth, observation.labels, altitude=protocol.altitude)
        logits = self.policy.logits(picture)
        if self.from_here is not None and self.from_here.distance(observation.pose) < 0.5 * protocol.lattice:
            logits = np.where(np.array(TURNS_DEG) == 0, np.float32(-np.inf), logits)
        shares = _shares(logits, self.planner.temperature)
        # Two frames that are alike, as where a move was refused, must not be answered alike for ever.
        words = [self.planner.walk_seed, self.steps, zlib.crc32(picture.tobytes())]
        chosen = int(np.random.default_rng(words).choice(len(TURNS_DEG), p=shares))
        self.steps += 1
        turn = _allowed(math.radians(TURNS_DEG[chosen]), protocol)
        self.from_here = None if turn else observation.pose
        advance = max(protocol.advances)
        target = 100.0 * float(picture[1].mean()) / 255.0
        how = f"a turn of {math.degrees(turn):.0f}°, then on" if turn else "straight on"
        action = (
            f"The target takes {target:.1f} % of the view: {how} for {advance:g} m, "
            f"which the network chooses {100.0 * shares[chosen]:.0f} times in 100."
        )
        return Decision(turn, advance, reasoning=Reasoning(action=action))


def _shares(logits: Float32Array, temperature: float) -> npt.NDArray[np.float64]:
    """(7,) probabilities that sum to 1; all for the first of the greatest at a temperature of 0."""
    scores = logits.astype(np.float64) - float(logits.max())
    if temperature == 0.0:
        return np.where(np.arange(len(scores)) == scores.argmax(), 1.0, 0.0)
    shares = np.exp(scores / temperature)
    return np.asarray(shares / shares.sum())


def _allowed(turn: float, protocol: SurveyProtocol) -> float:
    """The nearest turn of the protocol."""
    return min(protocol.turn_angles, key=lambda allowed: (abs(wrap_angle(turn - allowed)), abs(allowed)))
