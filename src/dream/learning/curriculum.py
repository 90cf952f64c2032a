"""All of it in order: the teacher's missions, the student's own, what is learned from them, the choice."""

from __future__ import annotations

import contextlib
import hashlib
import json
import platform
from collections.abc import Generator, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from dream import __version__
from dream.course import Planner
from dream.evaluation.engines import Engine
from dream.evaluation.locks import alone_at
from dream.evaluation.machine import libraries, source
from dream.files import write_whole
from dream.learning.claims import claim
from dream.learning.expert import TURNS, Expert
from dream.learning.export import INPUT, OUTPUT, answers_in, as_onnx, check_installed
from dream.learning.network import PLANES, Network, import_torch
from dream.learning.rollouts import TRAINING, VALIDATION, Frames, Lesson, Taught, gather, read, reef_cases
from dream.learning.training import Training, device_named, fit
from dream.learning.trials import Outcome, Trial, try_out
from dream.perception.representation import CLOSEST, HEIGHT, WIDTH
from dream.planning.baselines import Lawnmower, RandomWalk, UivNav
from dream.planning.baselines.uivnav import TURNS_DEG

MODEL, CARD = "uivnav.onnx", "uivnav.json"
ADDS = ("rounds", "trials", "horizon", "temperatures")
"""Of a curriculum, what changes nothing that is done already."""
APART = 1000
"""Seeds between the worlds of one round and those of the next."""


@dataclass(frozen=True, slots=True)
class Curriculum:
    """What is learned from, how, and by what the best of it is chosen.

    What it does: the teacher flies missions and says to every frame what it would do (behaviour cloning);
    a student learns that. Then, in each further round, the student of the round before flies other worlds,
    the teacher says what it would have done there, and a new student learns from all frames so far
    (DAgger: Ross, Gordon and Bagnell, AISTATS 2011), since its own mistakes lead a student to places where a
    teacher never is. Every student flies trials on reefs that none has learned from, at each temperature;
    the pair that sees the largest share of the individuals is kept.
    """

    missions: int = 126
    """That the teacher flies."""
    more: int = 45
    """That the student flies, in each further round."""
    rounds: int = 1
    """Further ones."""
    steps: int = 150
    """Of a mission to learn from."""
    helped: float = 0.3
    """Share of a student's steps that the teacher flies for it."""
    held_out: int = 9
    """Missions of the teacher that nothing is learned from: how often does a student agree?"""
    trials: int = 18
    """Worlds in which every student is tried."""
    horizon: int = 60
    """Steps of a trial."""
    temperatures: tuple[float, ...] = (0.5, 1.0)
    """At which every student is tried; see `UivNav.temperature`."""
    seed: int = 0
    expert: Expert = field(default_factory=Expert)
    network: Network = field(default_factory=Network)
    training: Training = field(default_factory=Training)

    def __post_init__(self) -> None:
        for name in ("missions", "more", "held_out", "trials", "steps", "horizon"):
            if not 1 <= getattr(self, name) <= 9 * APART:
                raise ValueError(f"{name}: expected 1 to {9 * APART}, got {getattr(self, name)}")
        if not 0 <= self.rounds < (VALIDATION - TRAINING) // APART:
            raise ValueError(f"rounds: expected 0 to 9, got {self.rounds}")
        if not self.temperatures:
            raise ValueError("temperatures: expected one or more, got none")
        if self.seed < 0:
            raise ValueError(f"seed: expected 0 or more, got {self.seed}")

    def lessons(self, number: int, student: str = "") -> list[Lesson]:
        """The missions of a round: 0 is the teacher's."""
        cases = reef_cases(self.more if number else self.missions, TRAINING + number * APART)
        helped = self.helped if number else 0.0
        return [
            Lesson(case, self.seed, self.steps, expert=self.expert, student=student, helped=helped)
            for case in cases
        ]

    @property
    def quiz(self) -> list[Lesson]:
        """The missions that nothing is learned from."""
        cases = reef_cases(self.held_out, VALIDATION + APART)
        return [Lesson(case, self.seed, self.steps, expert=self.expert) for case in cases]


@dataclass(frozen=True, slots=True)
class Progress:
    """How far one part of the work is."""

    part: str
    done: int
    total: int
    said: str = ""
    """What came of it so far."""


def learn(
    curriculum: Curriculum, folder: Path, engine: Engine, device: str
) -> Generator[Progress, None, None]:
    """Do all of it, and leave the network and its card in a folder.

    Whatever interrupts it, the same call goes on where it was, and ends with the same network.

    Args:
        curriculum: What to do.
        folder: Of the frames, the students and the network.
        engine: Where missions are flown.
        device: Where a student learns; see `training.device_named`.

    Raises:
        ValueError: The folder belongs to another curriculum or other code, or something that is needed is
            not installed.
        OSError: The folder cannot be written.
    """
    import_torch()
    check_installed()
    device = device_named(device)
    with alone_at(folder, folder / ".lock"):
        _claim(folder, curriculum)
        quiz: list[Frames] = []
        yield from _gathered(curriculum.quiz, folder, engine, "frames for the quiz", quiz)
        frames: list[Frames] = []
        rounds: list[dict[str, Any]] = []
        model = folder / "none"
        for number in range(curriculum.rounds + 1):
            lessons = curriculum.lessons(number, str(model) if number else "")
            who = "the teacher" if number == 0 else f"student {number - 1}"
            yield from _gathered(lessons, folder, engine, f"frames flown by {who}", frames)
            model = folder / f"student-{number}.onnx"
            joined = Frames.joined(frames)
            if not model.is_file():
                yield from _taught(curriculum, joined, number, model, device)
            rounds.append({"frames": len(joined), **_marks(model, Frames.joined(quiz))})
        table: dict[str, dict[str, float]] = {}
        yield from _tried(curriculum, folder, engine, table)
        best = max((name for name in table if name.startswith("student")), key=lambda n: table[n]["share"])
        number, temperature = _of_name(best)
        chosen = (folder / f"student-{number}.onnx").read_bytes()
        card = _card(curriculum, chosen, number, temperature, rounds, table)
        write_whole(folder / MODEL, chosen)
        write_whole(folder / CARD, (json.dumps(card, indent=2) + "\n").encode())
        yield Progress("network and card", 1, 1, best)


def missions(curriculum: Curriculum, folder: Path) -> Iterator[Frames]:
    """The frames of every mission that was learned from, in order, from where `learn` left them.

    Raises:
        ValueError: One is missing.
    """
    for number in range(curriculum.rounds + 1):
        student = str(folder / f"student-{number - 1}.onnx") if number else ""
        for lesson in curriculum.lessons(number, student):
            frames = read(lesson.file(folder / "frames"))
            if frames is None:
                raise ValueError(f"{folder}: expected the frames of {lesson.case}, got none. Train once more")
            yield frames


def _claim(folder: Path, curriculum: Curriculum) -> None:
    """The folder is of this curriculum and this code, or becomes it. What only adds to it may be another.

    Frames of one simulator and teacher beside those of another would make a network that nobody can make
    again.
    """
    made_by = {"version": __version__, "source": source("learning"), **libraries(), "torch": version("torch")}
    plan = json.loads(json.dumps({**made_by, **asdict(curriculum)}))
    plan = {name: value for name, value in plan.items() if name not in ADDS}
    claim(folder, plan)


def _gathered(
    lessons: list[Lesson], folder: Path, engine: Engine, part: str, into: list[Frames]
) -> Iterator[Progress]:
    with contextlib.closing(gather(lessons, folder / "frames", engine)) as found:
        for done, frames in enumerate(found, start=1):
            into.append(frames)
            yield Progress(part, done, len(lessons))


def _taught(
    curriculum: Curriculum, frames: Frames, number: int, model: Path, device: str
) -> Iterator[Progress]:
    """Teach the student of a round from scratch, and write its network."""
    training, kept = curriculum.training, model.with_suffix(".pt")
    student = curriculum.network.build(training.seed)
    for epoch in fit(student, frames.images, frames.odds, training, device=device, kept=kept):
        yield Progress(f"student {number} learns", epoch.number, training.epochs, f"loss {epoch.loss:.3f}")
    write_whole(model, as_onnx(student))
    kept.unlink(missing_ok=True)


def _marks(model: Path, quiz: Frames) -> dict[str, float]:
    """How near a student's odds are to the teacher's on frames that it never saw."""
    logits = answers_in(model.read_bytes(), quiz.images.astype(np.float32) / np.float32(255.0))
    logits = logits.astype(np.float64) - logits.max(axis=1, keepdims=True)
    said = logits - np.log(np.exp(logits).sum(axis=1, keepdims=True))
    odds = quiz.odds.astype(np.float64)
    entropy = -(odds * np.log(np.maximum(odds, 1e-12))).sum(axis=1)
    divergence = (-(odds * said).sum(axis=1) - entropy).mean()
    agreed = (said.argmax(axis=1) == odds.argmax(axis=1)).mean()
    return {"agrees": round(float(agreed), 4), "divergence": round(float(divergence), 4)}


def _tried(
    curriculum: Curriculum, folder: Path, engine: Engine, table: dict[str, dict[str, float]]
) -> Iterator[Progress]:
    """Fly the trials of all students, their teacher and two that have learned nothing."""
    planners: dict[str, Planner] = {
        "random": RandomWalk(),
        "lawnmower": Lawnmower(),
        "teacher": Taught(curriculum.expert),
    }
    planners |= {
        f"student {number} at {temperature:g}": UivNav(
            temperature=temperature, weights=str(folder / f"student-{number}.onnx")
        )
        for number in range(curriculum.rounds + 1)
        for temperature in curriculum.temperatures
    }
    cases = reef_cases(curriculum.trials, VALIDATION)
    trials = [
        Trial(name, planner, case, curriculum.horizon) for case in cases for name, planner in planners.items()
    ]
    outcomes: dict[str, list[Outcome]] = {name: [] for name in planners}
    for done, (trial, outcome) in enumerate(try_out(trials, engine), start=1):
        outcomes[trial.name].append(outcome)
        yield Progress("trials", done, len(trials))
    table.update({name: summary(found) for name, found in outcomes.items()})


def summary(outcomes: list[Outcome]) -> dict[str, float]:
    """Of a planner's trials: mean share of the individuals, targets a metre over all of them, mean metres."""
    metres = sum(outcome.distance for outcome in outcomes)
    return {
        "share": round(float(np.mean([outcome.share for outcome in outcomes])), 4),
        "targets_per_metre": round(sum(outcome.seen for outcome in outcomes) / max(metres, 1e-9), 2),
        "metres": round(metres / len(outcomes), 1),
    }


def _options(curriculum: Curriculum) -> list[str]:
    """What `dream train uivnav` is to be told, where that is not as it would do anyway."""
    usual = Curriculum()
    told = {
        name: getattr(curriculum, name) for name in ("missions", "more", "rounds", "steps", "trials", "seed")
    }
    options = [f"--{name} {value}" for name, value in told.items() if value != getattr(usual, name)]
    epochs = curriculum.training.epochs
    return options + [f"--epochs {epochs}"] * (epochs != usual.training.epochs)


def _of_name(name: str) -> tuple[int, float]:
    """Round and temperature of a student's row."""
    _, number, _, temperature = name.split()
    return int(number), float(temperature)


def _card(
    curriculum: Curriculum,
    model: bytes,
    number: int,
    temperature: float,
    rounds: list[dict[str, Any]],
    table: Mapping[str, Mapping[str, float]],
) -> dict[str, Any]:
    """What a user of the network has to know."""
    return {
        "name": "UIVNav, re-implemented",
        "what": "Which way to turn, from one frame of nearness and share of target; no map, no pose, no "
        "memory. After UIVNav (arXiv 2309.08806), whose representation, network and data are not published.",
        "sha256": hashlib.sha256(model).hexdigest(),
        "bytes": len(model),
        "parameters": curriculum.network.parameters,
        "input": {
            "name": INPUT,
            "shape": ["n", PLANES, HEIGHT, WIDTH],
            "type": "float32",
            "range": [0.0, 1.0],
            "channels": ["nearness", "share of target"],
            "closest": CLOSEST,
            "scale": "depth in altitudes of the protocol",
        },
        "output": {"name": OUTPUT, "shape": ["n", len(TURNS)], "type": "float32", "means": "logits"},
        "turns_deg": list(TURNS_DEG),
        "advance": "the protocol's longest, always",
        "temperature": temperature,
        "chosen": f"round {number} at temperature {temperature:g}: the largest share in the trials",
        "data": {
            "worlds": "nine kinds of reef, no wreck, no pool",
            "seeds": f"from {TRAINING}, each round {APART} further; trials from {VALIDATION}, quiz from "
            f"{VALIDATION + APART}; no suite has any of them",
            "protocol": "dream-v1",
            "labels": "odds of the turns by dream.learning.expert.Expert",
        },
        "rounds": rounds,
        "trials": {
            "worlds": curriculum.trials,
            "steps": curriculum.horizon,
            "rows": table,
        },
        "curriculum": json.loads(json.dumps(asdict(curriculum))),
        "made_with": {
            "dream": __version__,
            "python": platform.python_version(),
            **{name: version(name) for name in ("torch", "onnx", "numpy")},
        },
        "command": " ".join(["dream train uivnav", *_options(curriculum)]),
        "licence": "Apache-2.0",
    }
