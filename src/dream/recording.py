"""`Iterator[Step]` → run folder, and back.

A run is written as it goes: whatever interrupts it, the steps so far are on disk. Pictures lie beside
`steps.jsonl` and are named by step; a line is written only once its pictures are complete. Ctrl-C waits
until the step that is being written is whole; of one for which there is no room, nothing stays.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import logging
import math
import os
import re
import signal
import tempfile
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from io import FileIO
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from PIL import Image
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import from_json

from dream.ending import WORDS
from dream.files import whole_or_nothing
from dream.geometry import SE2, Bounds
from dream.protocol import ORDERED, SurveyProtocol, protocol_named
from dream.types import Exchange, Float32Array, Home, Label, Step, UInt8Array

logger = logging.getLogger(__name__)

M = TypeVar("M", bound=BaseModel)

LABEL_COLORS: Mapping[Label, tuple[int, int, int]] = {
    Label.WATER: (16, 54, 84),
    Label.SEABED: (150, 146, 136),
    Label.TARGET: (32, 190, 96),
    Label.OBSTACLE: (20, 20, 24),
}
"""sRGB of the palette in `frames/NNNN_labels.png`."""

MAX_LINE_BYTES = 1 << 20
"""A longer line of `steps.jsonl` is refused: an honest one takes a few kilobytes."""
MAX_EXCHANGE_BYTES = 16 << 20
"""A larger file of what a model answered is refused: one reply is at most 1 MiB."""
MAX_SHOWN_BYTES = 8 << 20
"""A larger picture of what a model was shown is left out."""

ROOM_KEPT = 64 << 10
"""Bytes that are kept free for `summary.json` while others fill the disk."""

# Pictures are written while the robot waits: little compression, done quickly.
_PNG_LEVEL = 1

COMPILING = "compiling"
"""In the folder of a run while its program compiles for the first time: empty, as old as that takes."""
VOLUME = "volume.npz"
"""In the folder of a run in space: the final map in three dimensions."""
PRIOR = "prior.npz"
"""In the folder of a run: what it was told of an earlier survey."""


class _Recorded(BaseModel):
    """What a file of a run holds. Fields that we do not know are kept, numbers are finite."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)


class RecordedPose(_Recorded):
    """Where the step ended, in the world: metres and radians."""

    x: float
    y: float
    yaw: float
    z: float | None = None
    """Height in the world; None under a planar protocol."""
    tilt: float | None = None
    """Pitch of the camera, positive downwards; None under a planar protocol."""


class RecordedDecision(_Recorded):
    """What the planner said: radians and metres."""

    turn: float
    advance: float
    done: bool
    climb: float = 0.0
    tilt: float | None = None
    """None leaves the camera as it is."""


class RecordedGuard(_Recorded):
    """What was carried out, and why it differs where it does."""

    turn: float
    advance: float
    note: str
    climb: float = 0.0
    tilt: float | None = None


class RecordedReasoning(_Recorded):
    """The six reasoning steps."""

    distribution: str = ""
    target_area: str = ""
    completion: str = ""
    next_target: str = ""
    safety: str = ""
    action: str = ""


class Coverage(_Recorded):
    """Shares in [0, 1] of target individuals, groups and area seen; None where it was not measured."""

    instances: float | None = None
    clusters: float | None = None
    area: float | None = None


class RecordedAsked(_Recorded):
    """That a model was asked; all that was said lies in `replies/`."""

    prompt: str
    """Of the last question."""
    fallback: str
    """Why no reply to it counted; empty where one did."""
    requests: int = Field(ge=0)
    """In all questions of the step."""


class RecordedExchange(_Recorded):
    """`replies/NNNN.json`: one question to a model, and what came of it. See `types.Exchange`."""

    prompt: str
    model: str
    question: str
    pictures: tuple[Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9-]{0,39}$")], ...] = Field(
        max_length=16
    )
    """Names; the files beside this one are called by them."""
    replies: tuple[str, ...] = Field(max_length=16)
    fallback: str
    requests: int = Field(ge=0)
    tokens_in: int = Field(ge=0)
    tokens_out: int = Field(ge=0)
    cost_usd: float | None
    seconds: float = Field(ge=0.0)
    answered_by: str = ""
    outcome: str = ""
    lacks: tuple[str, ...] = Field(default=(), max_length=16)
    expected: dict[str, Any] = Field(default_factory=dict)


class RecordedBalance(_Recorded):
    """What is left of something, and what of it the way home takes; see `types.Balance`."""

    name: str
    unit: str
    left: float
    way: float
    margin: float


class RecordedHome(_Recorded):
    """How it stands with the way home; see `types.Home`."""

    path: list[tuple[float, float, float]] | None
    balances: list[RecordedBalance]
    why: str


class RecordedStep(_Recorded):
    """One line of `steps.jsonl`. SI units and radians; annotations stand beside the fields."""

    step: int = Field(ge=0)
    time: float
    pose: RecordedPose
    decision: RecordedDecision
    guarded: RecordedGuard
    reasoning: RecordedReasoning
    collided: bool
    distance_m: float
    clearance_m: float | None
    """None where unknown."""
    arrival_note: str = ""
    """What was wrong on the way."""
    position_sigma_m: float = 0.0
    """See `types.Arrival`."""
    map: dict[str, float]
    """Square metres of each layer."""
    open_region: str
    ended: str = Field(pattern="^(done|returned|cap)?$")
    why: str = ""
    """Why the mission ended with this step, in words (`dream.ending`); only in the last line, and empty where
    the program was killed."""
    planner_ms: float
    waited_s: float = 0.0
    """That the vehicle stood still for an answer, on the mission's clock."""
    asked: RecordedAsked | None = None
    """None where no model was asked."""
    coverage: Coverage | None = None
    leg: int = 1
    """Of the orders that it belongs to, by number."""
    truth: RecordedPose | None = None
    """Where the vehicle really was, as only a simulator knows; None where that is `pose`."""
    home: RecordedHome | None = None
    """None of a mission that need not go home."""


class OrderedRules(_Recorded):
    """What of a protocol that moves in space goes by the site (`SurveyProtocol.ordered`)."""

    reach: Annotated[float, Field(gt=0.0, le=1000.0)]
    group_radius: Annotated[float, Field(gt=0.0, le=1000.0)]
    cap: Annotated[int, Field(ge=1, le=1_000_000)]


class RunConfig(_Recorded):
    """`config.json`: enough to run it again."""

    version: str
    commit: str | None = None
    protocol: str
    ordered: OrderedRules | None = None
    """What of it goes by the site; None of a planar protocol, and in older files."""
    bounds: Bounds | None = None
    """Of the map, metres; None in older files."""
    world: str
    seed: int
    planner: str
    planner_parameters: dict[str, Any] = Field(default_factory=dict)
    """By name."""
    weights_sha256: str | None = None
    """Of the file of a network that was not the one that comes with DREAM."""
    prompts_sha256: dict[str, str] = Field(default_factory=dict)
    """Of every prompt that was given in the place of the package's, by name."""
    planner_file: str = ""
    """Of a planner of somebody's own; empty of the package's."""
    planner_sha256: str | None = None
    """Of that file."""
    world_from: str | None = None
    """What was given for the world where it is not a name: a folder."""
    years_on: float = 0.0
    """Simulated years that the world is on; 0 of one that no time went over, and in older files."""
    start: int = 0
    """Which of the world's start poses."""
    max_steps: int | None = None
    """Decisions at most; the protocol's cap where None."""
    swimming: dict[str, Any] | None = None
    """All parameters of a vehicle that swims (`robots.swimming.read_swimming`); None where none does."""
    orders: dict[str, Any] | None = None
    """What the operator ordered; to map everything where None."""
    budget: dict[str, Any] | None = None
    """What it may spend until it is home (`homeward.read_budget`); None where it need not go home."""
    words: str = ""
    """In which the operator said so; empty where they are not known."""
    understood: tuple[str, ...] = ()
    """The orders as sentences."""
    command: str = ""
    """The line that does it again, where that is not `dream run`."""
    began: AwareDatetime | None = None
    """By the clock of the machine; None in older files."""

    @property
    def rules(self) -> SurveyProtocol:
        """The protocol as it was ordered; a ValueError where none here has its name."""
        known = protocol_named(self.protocol)
        if self.ordered is None:
            return known
        return dataclasses.replace(known, **{name: getattr(self.ordered, name) for name in ORDERED})

    @property
    def dive(self) -> dict[str, Any] | None:
        """What a dive was begun with; None of a run in the simulator."""
        told = (self.model_extra or {}).get("dive")
        return told if isinstance(told, dict) else None

    @property
    def real(self) -> bool:
        """Was it in real water? Its `world` and `seed` then name nothing."""
        return self.dive is not None and not self.dive.get("stand_in")


class PlannerTimes(_Recorded):
    """Milliseconds that a decision took."""

    p50: float | None
    p99: float | None


class RunSummary(_Recorded):
    """`summary.json`, the object that `--json` prints. Steps to a mark are None where it was not reached."""

    protocol: str
    world: str
    seed: int
    world_hash: str
    """Empty where there was no simulator."""
    planner: str
    ended: Literal["done", "returned", "cap", "aborted"]
    why: str = ""
    """Why it ended, in words (`dream.ending`); empty in older files."""
    steps: int
    t_stop: int | None
    t_claimed: int | None
    t90: int | None
    t95: int | None
    t98: int | None
    t100: int | None
    coverage: Coverage
    collisions: int | None
    """None where nobody knows."""
    distance_m: float
    turns: int
    min_clearance_m: float | None
    planner_ms: PlannerTimes
    wall_s: float
    """`dream run` leaves out what compiling took."""
    mission_s: float | None = None
    """On the mission's clock, waiting for answers included; None in older files."""
    vlm: dict[str, Any] | None
    home: dict[str, Any] | None = None
    """How it stood with the way home at the end; None of a mission that need not go home."""
    success: bool | None
    """None where no truth says what there was to see."""


def new_run_folder(root: Path, world: str, seed: int, planner: str, now: datetime) -> Path:
    """Make an empty folder for one run, and let `latest` in `root` point to it where links can be made.

    Raises:
        OSError: `root` cannot be written.
    """
    stem = f"{now:%Y-%m-%dT%H-%M-%S}_{_file_word(world)}-{seed}_{_file_word(planner)}"
    number = 1
    while True:
        folder = root / (stem if number == 1 else f"{stem}-{number}")
        try:
            root.mkdir(parents=True, exist_ok=True)
            folder.mkdir()
            break
        except OSError as error:
            if isinstance(error, FileExistsError) and root.is_dir():
                number += 1
                continue
            raise OSError(
                f"run folder: expected a place that can be written, got {root} ({error.strerror}). "
                "Choose another with --out"
            ) from error
    _point_latest(root / "latest", folder)
    return folder


def record(
    steps: Iterable[Step],
    folder: Path,
    *,
    annotate: Callable[[Step], Mapping[str, Any]] | None = None,
) -> Generator[Step, None, None]:
    """Pass every step through, and write it to `folder` on the way.

    The final map is saved when the steps end, fail or are no longer wanted. Wrap it in
    `contextlib.closing` where the loop over it may be left early.

    Args:
        steps: A mission.
        folder: Exists, and holds no other recording.
        annotate: Further fields of a step's line, such as its coverage. A step that it was asked for is
            written, also where Ctrl-C comes in between.

    Raises:
        ValueError: The folder holds a recording already, or an annotation has the name of a field.
        OSError: The folder cannot be written.
    """
    lines = folder / "steps.jsonl"
    if lines.exists():
        raise ValueError(
            f"recording: expected a folder without steps.jsonl, got {folder}. Record into a new one"
        )
    try:
        for name in ("frames", "maps"):
            (folder / name).mkdir(exist_ok=True)
        lines.touch()
    except OSError as error:
        raise OSError(
            f"recording: expected a folder that can be written, got {folder} ({error.strerror}). "
            "Choose another with --out"
        ) from error
    return _recording(steps, folder, annotate)


def _recording(
    steps: Iterable[Step], folder: Path, annotate: Callable[[Step], Mapping[str, Any]] | None
) -> Generator[Step, None, None]:
    trail: list[tuple[float, float]] = []
    step = None
    stopped: BaseException | None = None
    try:
        with (folder / "steps.jsonl").open("ab", buffering=0) as lines:
            for step in steps:
                trail.append((step.arrival.pose.x, step.arrival.pose.y))
                with _interrupt_held():
                    line = _line(step, annotate(step) if annotate else {})
                    try:
                        _write_pictures(step, trail, folder)
                        _write_exchanges(step, folder)
                        _append(lines, f"{line}\n".encode())
                    except OSError as error:
                        _remove_files(step.index, folder)
                        raise OSError(
                            f"could not write step {step.index} ({error.strerror or error})"
                        ) from error
                yield step
    except BaseException as error:
        stopped = error
        raise
    finally:
        if step is not None:
            try:
                with whole_or_nothing(folder / "map.npz") as partial:
                    step.occupancy.save(partial)
                if step.occupancy.volume is not None:
                    with whole_or_nothing(folder / VOLUME) as partial:
                        step.occupancy.volume.save(partial)
            except OSError as full:
                if stopped is None:
                    raise
                # What stopped the mission is told, not what came of it.
                if isinstance(stopped, GeneratorExit):
                    logger.warning("%s", full)
                elif not isinstance(stopped, OSError):
                    stopped.add_note(str(full))


def _append(lines: FileIO, line: bytes) -> None:
    """Write a line whole or not at all."""
    before, left = lines.tell(), line
    try:
        while left:
            left = left[lines.write(left) :]
    except OSError:
        lines.truncate(before)
        raise


def _remove_files(step: int, folder: Path) -> None:
    """Of a step that could not be written whole; what is left of the run may need the room."""
    for path in folder.glob(f"*/{step:04d}[._-]*"):
        with contextlib.suppress(OSError):
            path.unlink()


@contextlib.contextmanager
def _interrupt_held() -> Iterator[None]:
    """Let Ctrl-C, and a SIGTERM that somebody handles, wait until the block is done.

    Other threads than the main one never hear them.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    handled = {number: handler for number, handler in handlers.items() if callable(handler)}
    held: list[tuple[int, FrameType | None]] = []
    for number in handled:
        signal.signal(number, lambda came, frame: held.append((came, frame)))
    try:
        yield
    finally:
        for number, handler in handled.items():
            signal.signal(number, handler)
    if held:
        came, frame = held[0]
        handled[signal.Signals(came)](came, frame)


def _line(step: Step, annotations: Mapping[str, Any]) -> str:
    taken = sorted(annotations.keys() & (RecordedStep.model_fields.keys() - {"coverage"}))
    if taken:
        raise ValueError(
            f"annotations of step {step.index}: expected names of their own, got {', '.join(taken)}"
        )
    decision, carried_out, reasoning = step.decision, step.guarded.decision, step.decision.reasoning
    seen, truth, planar = step.observation, step.arrival.truth, step.occupancy.protocol.space is None
    recorded = RecordedStep(
        step=step.index,
        time=step.observation.time,
        pose=_pose(step.arrival.pose, *(() if planar else (seen.z, seen.tilt))),
        decision=RecordedDecision(
            turn=decision.turn,
            advance=decision.advance,
            done=decision.done,
            climb=decision.climb,
            tilt=decision.tilt,
        ),
        guarded=RecordedGuard(
            turn=carried_out.turn,
            advance=carried_out.advance,
            note=step.guarded.note,
            climb=carried_out.climb,
            tilt=carried_out.tilt,
        ),
        reasoning=RecordedReasoning(
            distribution=reasoning.distribution,
            target_area=reasoning.target_area,
            completion=reasoning.completion,
            next_target=reasoning.next_target,
            safety=reasoning.safety,
            action=reasoning.action,
        ),
        collided=step.arrival.collided,
        distance_m=step.arrival.distance,
        clearance_m=step.arrival.clearance if np.isfinite(step.arrival.clearance) else None,
        arrival_note=step.arrival.note,
        position_sigma_m=step.arrival.sigma,
        map=step.occupancy.areas(),
        open_region=step.open_region,
        ended=step.ended,
        why=WORDS.get(step.ended, ""),
        planner_ms=1000.0 * step.planner_s,
        waited_s=step.decision.waited,
        asked=_asked(step.decision.exchanges),
        leg=1 if step.leg is None else step.leg.number,
        truth=None if truth is None else _pose(truth.se2, None if planar else float(truth.translation[2])),
        home=None if step.home is None else _home(step.home),
        **annotations,
    )
    left_out: dict[str, Any] = {} if recorded.why else {"why": True}
    if recorded.home is None:
        left_out["home"] = True
    if planar:
        for name in ("pose", "truth", "decision", "guarded"):
            left_out[name] = {"z", "climb", "tilt"}
    return recorded.model_dump_json(fallback=_plain, exclude=left_out)


def _pose(pose: SE2, z: float | None = None, tilt: float | None = None) -> RecordedPose:
    return RecordedPose(x=pose.x, y=pose.y, yaw=pose.yaw, z=z, tilt=tilt)


def _home(home: Home) -> RecordedHome:
    balances = [RecordedBalance(**dataclasses.asdict(balance)) for balance in home.balances]
    return RecordedHome(path=None if home.path is None else list(home.path), balances=balances, why=home.why)


def _asked(exchanges: Sequence[Exchange]) -> RecordedAsked | None:
    if not exchanges:
        return None
    last = exchanges[-1]
    requests = sum(exchange.requests for exchange in exchanges)
    return RecordedAsked(prompt=last.prompt, fallback=last.fallback, requests=requests)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"annotation: expected JSON values or arrays, got {type(value).__name__}")


def _write_pictures(step: Step, trail: list[tuple[float, float]], folder: Path) -> None:
    from dream.mapping.drawing import FOR_PEOPLE, draw_map

    pose, path = step.arrival.pose, None if step.home is None else step.home.path
    home = None if path is None else [(pose.x, pose.y), *(place[:2] for place in path)]
    drawn = draw_map(step.occupancy, pose, trail, home=home, palette=FOR_PEOPLE)
    seen = step.observation
    pictures = {
        f"frames/{step.index:04d}_rgb.png": Image.fromarray(seen.rgb),
        f"frames/{step.index:04d}_depth.png": _depth_image(seen.depth),
        f"frames/{step.index:04d}_labels.png": _label_image(seen.labels),
        f"maps/{step.index:04d}.png": drawn,
    }
    for name, picture in pictures.items():
        picture.save(folder / name, compress_level=_PNG_LEVEL)


def _write_exchanges(step: Step, folder: Path) -> None:
    """The exact bytes that a model saw, then what was said."""
    for number, exchange in enumerate(step.decision.exchanges, start=1):
        recorded = RecordedExchange(
            prompt=exchange.prompt,
            model=exchange.model,
            question=exchange.question,
            pictures=tuple(exchange.pictures),
            replies=exchange.replies,
            fallback=exchange.fallback,
            requests=exchange.requests,
            tokens_in=exchange.tokens_in,
            tokens_out=exchange.tokens_out,
            cost_usd=exchange.cost_usd,
            seconds=exchange.seconds,
            answered_by=exchange.answered_by,
            outcome=exchange.outcome,
            lacks=exchange.lacks,
            expected=dict(exchange.expected),
        )
        path = _exchange_path(folder, step.index, number)
        path.parent.mkdir(exist_ok=True)
        for name, png in exchange.pictures.items():
            _shown_path(path, name).write_bytes(png)
        path.write_text(recorded.model_dump_json(indent=1) + "\n", encoding="utf-8")


def _exchange_path(folder: Path, step: int, number: int) -> Path:
    """Of the first, second … exchange of a step."""
    return folder / "replies" / (f"{step:04d}.json" if number == 1 else f"{step:04d}-{number}.json")


def _shown_path(exchange: Path, name: str) -> Path:
    return exchange.with_name(f"{exchange.stem}_{name}.png")


def _depth_image(depth: Float32Array) -> Image.Image:
    """16-bit millimetres; 0 where there is no return."""
    millimetres = np.nan_to_num(1000.0 * depth.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    return Image.fromarray(np.clip(np.rint(millimetres), 0, 65535).astype(np.uint16))


def _label_image(labels: UInt8Array) -> Image.Image:
    picture = Image.frombytes("P", labels.shape[::-1], labels.tobytes())
    picture.putpalette(bytes(channel for label in Label for channel in LABEL_COLORS[label]))
    return picture


def read_steps(folder: str | Path) -> list[RecordedStep]:
    """The steps of a run. A torn last line, as an interruption leaves it, is dropped with a warning.

    Raises:
        FileNotFoundError: `folder` holds no recording.
        ValueError: A line is damaged; the message names it.
    """
    path = _file_of_run(folder, "steps.jsonl")
    steps: list[RecordedStep] = []
    with path.open("rb") as lines:
        number = 0
        while raw := lines.readline(MAX_LINE_BYTES + 1):
            number += 1
            where = f"{path}, line {number}"
            if len(raw) > MAX_LINE_BYTES:
                raise ValueError(
                    f"{where}: expected at most {MAX_LINE_BYTES} bytes, got more. Is it a recording?"
                )
            try:
                fields = _parsed(raw, where)
            except ValueError:
                if lines.read(1):
                    raise
                logger.warning("%s is torn and left out: the run was interrupted while writing it", where)
                break
            steps.append(_step(fields, where, steps[-1] if steps else None))
    return steps


def read_step(line: bytes, where: str, before: RecordedStep | None) -> RecordedStep:
    """A step from its line of `steps.jsonl`.

    Args:
        line: The whole of it.
        where: File and number of the line, for what is said of it.
        before: The step of the line before it; None for the first.

    Raises:
        ValueError: The line is damaged or out of order; the message says where.
    """
    return _step(_parsed(line, where), where, before)


def _step(fields: Any, where: str, before: RecordedStep | None) -> RecordedStep:
    step = _checked(RecordedStep, fields, where)
    if before is not None and step.step <= before.step:
        raise ValueError(f"{where}: expected a step after {before.step}, got {step.step}")
    return step


def read_exchanges(folder: Path, step: int) -> list[Exchange]:
    """What a model was asked and answered for a step, in order; empty where nothing is kept of it.

    A picture that is missing or too large is left out with a warning.

    Raises:
        ValueError: A file is damaged; the message names it.
    """
    exchanges: list[Exchange] = []
    for number, recorded in enumerate(read_replies(folder, step), start=1):
        path = _exchange_path(folder, step, number)
        shown = {name: _shown(_shown_path(path, name)) for name in recorded.pictures}
        exchanges.append(
            Exchange(
                prompt=recorded.prompt,
                model=recorded.model,
                question=recorded.question,
                pictures={name: png for name, png in shown.items() if png is not None},
                replies=recorded.replies,
                fallback=recorded.fallback,
                requests=recorded.requests,
                tokens_in=recorded.tokens_in,
                tokens_out=recorded.tokens_out,
                cost_usd=recorded.cost_usd,
                seconds=recorded.seconds,
                answered_by=recorded.answered_by,
                outcome=recorded.outcome,
                lacks=recorded.lacks,
                expected=recorded.expected,
            )
        )
    return exchanges


def read_replies(folder: Path, step: int) -> list[RecordedExchange]:
    """The same without the pictures, whose names they hold. Raises as `read_exchanges` does."""
    replies: list[RecordedExchange] = []
    while (path := _exchange_path(folder, step, len(replies) + 1)).is_file():
        if path.stat().st_size > MAX_EXCHANGE_BYTES:
            raise ValueError(f"{path}: expected at most {MAX_EXCHANGE_BYTES} bytes, got more")
        replies.append(_checked(RecordedExchange, _json(path), str(path)))
    return replies


def _shown(path: Path) -> bytes | None:
    try:
        if path.stat().st_size > MAX_SHOWN_BYTES:
            raise ValueError(f"expected at most {MAX_SHOWN_BYTES} bytes, got more")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        logger.warning("%s is left out: %s", path, error)
        return None


def digest_of_steps(folder: Path) -> str:
    """SHA-256 of a run's `steps.jsonl`: that of every copy of the run, and of no other.

    Another mission differs by the milliseconds of its decisions, where by nothing else.

    Raises:
        FileNotFoundError: `folder` holds no recording.
    """
    with _file_of_run(folder, "steps.jsonl").open("rb") as lines:
        return hashlib.file_digest(lines, "sha256").hexdigest()


def read_config(folder: str | Path) -> RunConfig:
    """How the run was made. Raises as `read_steps` does."""
    path = _file_of_run(folder, "config.json")
    return _checked(RunConfig, _json(path), str(path))


def read_summary(folder: str | Path) -> RunSummary | None:
    """How the run ended; None where it was aborted before it could say."""
    path = Path(folder) / "summary.json"
    return _checked(RunSummary, _json(path), str(path)) if path.exists() else None


def write_config(folder: Path, config: Mapping[str, Any]) -> None:
    """Check and write `config.json`: whole or not at all."""
    _replace(folder / "config.json", _checked(RunConfig, config, "config"))


@contextlib.contextmanager
def compiling_noted(folder: Path) -> Iterator[None]:
    """Keep a file `COMPILING` in a run folder from the first compilation within the block to its end."""
    from dream.compiling import when_compiling

    note = folder / COMPILING

    def begin() -> None:
        with contextlib.suppress(OSError):  # A full disk is told of where something that counts is written.
            note.touch()

    with when_compiling(begin):
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                note.unlink(missing_ok=True)


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Check and write `summary.json`: whole or not at all.

    Where the mission was aborted, the last line of `steps.jsonl` is told why before, if there is room.
    """
    # The folder may be given to others, who need not know where it lay.
    told = str(summary.get("why", "")).replace(f"{folder}{os.sep}", "")
    checked = _checked(RunSummary, {**summary, "why": told}, "summary")
    if checked.ended == "aborted" and checked.why:
        try:
            _tell_last_step(folder / "steps.jsonl", checked.why)
        except (OSError, ValidationError) as error:
            logger.debug("steps.jsonl does not say why the mission ended: %s", error)
    _replace(folder / "summary.json", checked)


def _tell_last_step(path: Path, why: str) -> None:
    """Add to the last line why no other follows; the line stays as it was where that cannot be written.

    In place: the line is in the file since its step was made, and is there whatever happens now.
    """
    if not path.is_file():
        return
    with path.open("r+b", buffering=0) as lines:
        size = lines.seek(0, os.SEEK_END)
        lines.seek(max(0, size - MAX_LINE_BYTES))
        whole, end, torn = lines.read(MAX_LINE_BYTES).rpartition(b"}\n")
        last = whole.rpartition(b"\n")[2] + end
        if torn or not end or RecordedStep.model_validate_json(last).why:
            return
        told = f',"why":{json.dumps(why)}}}\n'.encode()
        at = lines.seek(size - len(end))
        try:
            while told:
                told = told[lines.write(told) :]
        except OSError:
            lines.seek(at)
            lines.write(b"}\n")
            lines.truncate(size)
            raise


@contextlib.contextmanager
def room_kept(folder: Path) -> Iterator[Callable[[], None]]:
    """Keep room on the disk for `summary.json`, until it is asked for: others fill it meanwhile.

    It is taken by a file without a name, which no end of the program leaves behind. Where there is no room
    to keep, none is kept.

    Yields:
        What gives it free, at once before the summary is written.
    """
    with tempfile.TemporaryFile(dir=folder, buffering=0) as kept:
        with contextlib.suppress(OSError):
            # Not zeros, which some disks do not keep.
            kept.write(os.urandom(ROOM_KEPT))
        yield kept.close


def _replace(path: Path, content: BaseModel) -> None:
    with whole_or_nothing(path) as partial:
        partial.write_text(content.model_dump_json(indent=2, fallback=_plain) + "\n", encoding="utf-8")


def _json(path: Path) -> Any:
    return _parsed(path.read_bytes(), str(path))


def _parsed(text: bytes, where: str) -> Any:
    try:
        parsed = from_json(text, allow_inf_nan=False)
    except ValueError as error:
        raise ValueError(f"{where}: expected one JSON object, got damaged text ({error})") from error
    if not _is_finite(parsed):
        raise ValueError(f"{where}: expected finite numbers, got one that is too large")
    return parsed


def _is_finite(value: Any) -> bool:
    """Whether no number in it is infinite, as 1e999 is once it was read; no page could be told of it."""
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, dict):
        return all(map(_is_finite, value.values()))
    return not isinstance(value, list) or all(map(_is_finite, value))


def _checked(model: type[M], fields: Any, where: str) -> M:
    try:
        return model.model_validate(fields)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"])) or "the whole"
        got = repr(first["input"])
        raise ValueError(f"{where}: {field}: {first['msg']}, got {got[:80]}") from error


def _file_of_run(folder: str | Path, name: str) -> Path:
    path = Path(folder) / name
    if not path.is_file():
        raise FileNotFoundError(
            f"{folder}: expected a run folder, got no {name} in it. Runs are made by dream run"
        )
    return path


def _file_word(text: str) -> str:
    """`text` with whatever does not belong into a file's name replaced."""
    return re.sub(r"[^A-Za-z0-9]+", "-", text).strip("-") or "unnamed"


def _point_latest(link: Path, folder: Path) -> None:
    if link.exists() and not link.is_symlink():
        return
    partial = link.with_name(f".latest-{folder.name}")
    # A convenience: some systems allow no links, and another run may be doing the same.
    with contextlib.suppress(OSError):
        partial.symlink_to(folder.name, target_is_directory=True)
        os.replace(partial, link)
