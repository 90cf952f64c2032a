"""Missions from which a student learns: what was seen, and what the teacher would have done there.

Each mission is one file, written whole or not at all, so that what is broken off goes on where it was.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
from collections.abc import Generator, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dream import arrays
from dream.evaluation.engines import Engine, Failure
from dream.evaluation.runner import simulate
from dream.evaluation.suites import LETTERS, REEF_FAMILIES, Case
from dream.files import write_whole
from dream.geometry import SE3, Camera
from dream.learning.expert import TURNS, Expert
from dream.perception.representation import HEIGHT, WIDTH, represent
from dream.planning.baselines import UivNav
from dream.protocol import SurveyProtocol, protocol_named
from dream.sim.render import Frame, Renderer
from dream.sim.solids import Solids
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import Decision, Float32Array, Mission, Observation, UInt8Array

if TYPE_CHECKING:
    from dream.course import Pilot
    from dream.mapping import OccupancyMap

REEFS = (*(f"reef/{family}" for family in REEF_FAMILIES), *(f"reef/{letter}" for letter in LETTERS))
"""The worlds that are learned from; wrecks and the tank are for trying what was learned."""
TRAINING, VALIDATION = 50_000, 60_000
"""The first seeds of the worlds that are learned from, and of those that choices are made on. No suite has
any of them."""


def reef_cases(count: int, first_seed: int) -> tuple[Case, ...]:
    """That many reefs, each kind in turn, of seeds and starts that follow each other."""
    kinds = len(REEFS)
    return tuple(Case(REEFS[k % kinds], first_seed + k // kinds, k // kinds % 4) for k in range(count))


@dataclass(frozen=True, slots=True)
class Lesson:
    """One mission to learn from: enough to fly it in another process."""

    case: Case
    seed: int
    """Of all that is drawn on the way."""
    steps: int = 150
    protocol: str = "dream-v1"
    expert: Expert = field(default_factory=Expert)
    student: str = ""
    """File of the network that flies; the expert does where empty."""
    helped: float = 0.0
    """Share of the steps in which the expert flies instead of the student."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.helped <= 1.0:
            raise ValueError(f"helped: expected a share of 0 to 1, got {self.helped}")

    def file(self, folder: Path) -> Path:
        """Where it is kept; another name for every other mission, expert and student."""
        told = {**asdict(self), "picture": [HEIGHT, WIDTH]}
        if self.student:
            told["student"] = hashlib.sha256(Path(self.student).read_bytes()).hexdigest()
        digest = hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()
        world = self.case.world.replace("/", "-")
        return folder / f"{world}_{self.case.seed}_{self.case.start}_{digest[:16]}.npz"


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """What was seen before each decision, and what the expert says to it."""

    images: UInt8Array
    """(n, 2, 72, 96); see `perception.represent`."""
    odds: Float32Array
    """(n, 7) the expert's, of `TURNS`."""

    def __len__(self) -> int:
        return len(self.images)

    @staticmethod
    def joined(parts: Sequence[Frames]) -> Frames:
        """One after the other."""
        return Frames(np.concatenate([p.images for p in parts]), np.concatenate([p.odds for p in parts]))


@dataclass(frozen=True, slots=True)
class Taught:
    """The teacher flies: a planner like others, to be compared with those who learned from it."""

    expert: Expert = field(default_factory=Expert)
    seed: int = 0
    """Of what it draws."""

    def begin(self, mission: Mission) -> _Teaching:
        """A fresh pilot, the same for the same seed."""
        return _Teaching(self.expert, mission.protocol, np.random.default_rng(self.seed))


@dataclass(slots=True)
class _Teaching:
    expert: Expert
    protocol: SurveyProtocol
    rng: np.random.Generator

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        odds = self.expert.weigh(observation.depth, observation.labels, self.protocol)
        turn = TURNS[int(self.rng.choice(len(TURNS), p=odds))]
        return Decision(turn, max(self.protocol.advances))


def fly(lesson: Lesson) -> Frames:
    """Fly one mission and keep what the expert says to every frame. The same again for the same lesson."""
    stage, protocol = _stage(lesson.case.world, lesson.case.seed), protocol_named(lesson.protocol)
    desk = _Desk(lesson)
    steps = simulate(
        stage.world,
        desk,
        protocol,
        start=lesson.case.start,
        max_steps=lesson.steps,
        renderer=stage.renderer,
        solids=stage.solids,
    )
    for _ in steps:
        pass
    return Frames(
        np.array(desk.images, np.uint8).reshape(-1, 2, HEIGHT, WIDTH),
        np.array(desk.odds, np.float32).reshape(-1, len(TURNS)),
    )


@dataclass(slots=True)
class _Desk:
    """Flies one lesson, and writes down what the expert says."""

    lesson: Lesson
    images: list[UInt8Array] = field(default_factory=list)
    odds: list[Any] = field(default_factory=list)

    def begin(self, mission: Mission) -> _Seat:
        lesson = self.lesson
        words = [lesson.seed, lesson.case.seed, lesson.case.start, REEFS.index(lesson.case.world)]
        rng = np.random.default_rng(words)
        student = None
        if lesson.student:
            flown = UivNav(weights=lesson.student, walk_seed=int(rng.integers(2**31)))
            student = flown.begin(mission)
        return _Seat(self, mission.protocol, rng, student)


@dataclass(slots=True)
class _Seat:
    desk: _Desk
    protocol: SurveyProtocol
    rng: np.random.Generator
    student: Pilot | None

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        depth, labels, lesson = observation.depth, observation.labels, self.desk.lesson
        odds = lesson.expert.weigh(depth, labels, self.protocol)
        self.desk.images.append(represent(depth, labels, altitude=self.protocol.altitude))
        self.desk.odds.append(odds)
        helped, turn = self.rng.random() < lesson.helped, TURNS[int(self.rng.choice(len(TURNS), p=odds))]
        if self.student is not None and not helped:
            return self.student.decide(observation, occupancy)
        return Decision(turn, max(self.protocol.advances))


class Colourless(Renderer):
    """Draws depth and labels as ever, and leaves the colours black: nobody here looks at them."""

    def render(self, camera: Camera, T_world_camera: SE3) -> Frame:
        """One view without the cost of colour."""
        rgb = np.zeros((camera.height, camera.width, 3), np.uint8)
        return Frame(rgb, *self.measure(camera, T_world_camera))


@dataclass(frozen=True, slots=True, eq=False)
class _Stage:
    world: World
    renderer: Renderer
    solids: Solids


@lru_cache(maxsize=1)
def _stage(world: str, seed: int) -> _Stage:
    made = make_world(world, seed)
    return _Stage(made, Colourless(made), Solids(made))


def gather(lessons: Sequence[Lesson], folder: Path, engine: Engine) -> Generator[Frames, None, None]:
    """Fly what is missing in a folder, and yield the frames of every lesson, in order.

    Raises:
        ValueError: A mission failed; those that did not are kept.
        OSError: The folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = {lesson: lesson.file(folder) for lesson in lessons}
    missing = [lesson for lesson in lessons if read(files[lesson]) is None]
    with contextlib.closing(engine.run(fly, [[lesson] for lesson in missing])) as flown:
        for lesson in lessons:
            while (frames := read(files[lesson])) is None:
                ended, outcome = next(flown)
                if isinstance(outcome, Failure):
                    raise ValueError(f"{ended.case.world} {ended.case.seed}: {outcome.message}")
                write(files[ended], outcome)
            yield frames


def write(path: Path, frames: Frames) -> None:
    """Write the frames of a lesson, whole or not at all."""
    content = io.BytesIO()
    np.savez_compressed(content, images=frames.images, odds=frames.odds)
    write_whole(path, content.getvalue())


def read(path: Path) -> Frames | None:
    """The frames in a file; None where there is none, or a damaged one."""
    try:
        with arrays.opened(path, "the frames of a lesson") as content:
            shape = content.headers["images"].shape
            if shape != (*shape[:1], 2, HEIGHT, WIDTH):
                return None
            images, odds = content["images"], content["odds"]
    except (KeyError, OSError, ValueError):
        return None
    count = len(images) if images.ndim else -1
    right = images.shape == (count, 2, HEIGHT, WIDTH) and images.dtype == np.uint8
    right &= odds.shape == (count, len(TURNS)) and odds.dtype == np.float32
    return Frames(images, odds) if right and math.isfinite(float(odds.sum())) else None
