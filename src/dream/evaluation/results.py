"""A benchmark folder: one row and one trace a mission, written so that nothing finished is ever lost.

A mission is written to `missions/` as soon as it ends, whole or not at all; `results.csv` and
`traces.csv.gz` are made from those files and say the same in canonical order. Whatever is read is checked.
"""

from __future__ import annotations

import csv
import gzip
import hashlib
import io
import json
import logging
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Literal

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic_core import from_json

from dream.ending import MOST
from dream.evaluation.metrics import MILESTONES, curve
from dream.evaluation.suites import WORLD_NAME
from dream.files import write_whole
from dream.protocol import protocol_named
from dream.sim.worlds import origin

logger = logging.getLogger(__name__)

Float64Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

MissionKey = tuple[str, str, int, int, str]
"""Protocol, world, seed, start, planner."""

MAX_STEPS = 10_000
"""A longer mission is refused when it is read."""
MAX_FILE_BYTES = 64 << 20
"""A larger file of one mission, or manifest, is refused."""
MAX_TABLE_BYTES = 1 << 30
"""A larger `results.csv` is refused."""
MAX_LINE_BYTES = 1 << 16
ROUNDING = 1e-6
"""Shares are written with six digits."""


def _world_name(text: str) -> str:
    if not WORLD_NAME.fullmatch(text):
        raise ValueError("expected the name of a world")
    return text


_Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]{0,99}$")]
_WorldName = Annotated[str, AfterValidator(_world_name)]
_Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
_Line = Annotated[str, Field(min_length=1, max_length=2 * MOST, pattern=r"^[^\x00-\x1f\x7f]*$")]
_Count = Annotated[int, Field(ge=0)]
_Step = Annotated[int, Field(ge=0, le=MAX_STEPS)]
_Share = Annotated[float, Field(ge=0.0, le=1.0)]
_Amount = Annotated[float, Field(ge=0.0)]


@dataclass(frozen=True, slots=True)
class Row:
    """One mission: a line of `results.csv`, whose columns are these fields in this order.

    Times are steps, counted from 1 with the look-around; None where the mark was not reached.
    """

    __pydantic_config__ = ConfigDict(allow_inf_nan=False, extra="forbid")

    protocol: _Name
    world: _WorldName
    seed: _Count
    start: _Count
    world_hash: _Name
    planner: _Name
    ended: Literal["done", "returned", "cap", "aborted"]
    """Aborted: the vehicle lost its way. What it had seen until then counts; a success it is not."""
    steps: _Step
    t_stop: _Step | None
    """Where the planner itself stopped."""
    t_claimed: _Step | None
    """Where the planner first said done, whether or not the map agreed."""
    t90: _Step | None
    t95: _Step | None
    t98: _Step | None
    t100: _Step | None
    instances: _Share
    clusters: _Share
    area: _Share
    visible: _Share
    countable: _Count
    """Individuals that some reachable pose sees."""
    collisions: _Count
    distance_m: _Amount
    turns: _Count
    guarded: _Count
    """Decisions that the guard changed."""
    min_clearance_m: float | None
    planner_ms_p50: _Amount
    planner_ms_p99: _Amount
    c50: _Share
    """Share of the instances seen after 50 steps; what a shorter mission ended with stays."""
    c100: _Share
    c137: _Share
    c200: _Share
    auc: _Share
    """Mean of that share over steps 1 to the protocol's cap, held likewise."""
    vlm_calls: _Count | None
    vlm_tokens: _Count | None
    vlm_cost_usd: _Amount | None
    vlm_fallbacks: _Count | None
    """Questions to which no reply counted, so that `belief` decided."""
    vlm_waited_s: _Amount | None
    """On the mission's clock."""
    mission_s: _Amount | None
    """On the mission's clock, waiting included; None where it was flown before that was written down."""
    vlm_questions: _Count | None
    """What a model was asked, likewise."""
    why: _Line | None
    """Why it ended, in words (`dream.ending`); None where that was not written down yet."""
    cap: _Step | None
    """Steps that the rules allow in that world; None where that was not written down yet."""
    success: bool
    wall_s: _Amount

    @property
    def key(self) -> MissionKey:
        """What tells this mission from every other."""
        return (self.protocol, self.world, self.seed, self.start, self.planner)

    def horizon(self, most: int) -> int:
        """Steps that it had, where no mission had more than so many: in space they go by the world."""
        return most if self.cap is None else min(self.cap, most)

    @property
    def too_early(self) -> bool:
        """Did it stop by itself with less than 98.26 % of the instances seen?"""
        return self.ended == "done" and self.t98 is None


COLUMNS: tuple[str, ...] = tuple(field.name for field in fields(Row))
TIMES: tuple[str, ...] = ("planner_ms_p50", "planner_ms_p99", "wall_s")
"""Columns that depend on the machine; all others are the same each time a mission is flown."""
LATER: tuple[tuple[str, ...], ...] = (
    ("vlm_waited_s", "mission_s"),
    ("vlm_questions",),
    ("why",),
    ("cap",),
)
"""Columns that files may lack which were written before there were any: each time some came, these."""
TRACE_COLUMNS: tuple[str, ...] = (
    *("protocol", "world", "seed", "start", "planner", "step"),
    *("x", "y", "yaw_deg", "instances", "collided", "seconds", "drawn_wh"),
)
LATER_IN_TRACES = ("seconds", "drawn_wh")
"""Of these, those that files may lack which were written before there were any."""


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """A mission step by step; index 0 is the first look."""

    x: Float64Array
    """(n + 1,) metres east in the world, where the step ended."""
    y: Float64Array
    """(n + 1,) metres north."""
    yaw_deg: Float64Array
    """(n + 1,) heading in degrees, 0 = east, positive to the left."""
    instances: Float64Array
    """(n + 1,) share of the instances seen so far."""
    collided: BoolArray
    """(n + 1,)."""
    seconds: Float64Array | None = None
    """(n + 1,) on the mission's clock, waiting included; None where that was not written down yet."""
    drawn_wh: Float64Array | None = None
    """(n + 1,) watt-hours that the vehicle has drawn; None likewise, or where nobody measures it."""

    def __len__(self) -> int:
        return len(self.x)


def _columns(trace: Trace) -> dict[str, npt.NDArray[Any]]:
    """Those that it has, by name."""
    columns = {name: getattr(trace, name) for name in Trace.__slots__}
    return {name: column for name, column in columns.items() if column is not None}


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """A finished mission."""

    row: Row
    trace: Trace

    def __post_init__(self) -> None:
        lengths = {name: len(column) for name, column in _columns(self.trace).items()}
        if set(lengths.values()) != {self.row.steps + 1}:
            raise ValueError(
                f"trace: expected {self.row.steps + 1} poses of {self.row.steps} steps, got {lengths}"
            )


class CaseEntry(BaseModel):
    """A case in a manifest."""

    world: _WorldName
    seed: _Count
    start: _Count


class SavedEntry(BaseModel):
    """A world that was read from a folder, in a manifest."""

    folder: str
    """As it was given: seen from where the benchmark was flown."""
    world_hash: _Name


class SealedEntry(BaseModel):
    """What a manifest tells of the worlds of a sealed test."""

    key: _Hash
    """Name of the key that made them."""
    blocks: dict[Annotated[str, Field(pattern=r"^[0-9]{1,6}$")], _Hash]
    """Commitment of each block, by its number."""


class FailedEntry(CaseEntry):
    """A mission that has no result, in a manifest."""

    planner: _Name
    error: str


class Manifest(BaseModel):
    """`manifest.json`: what was flown, by which code, on which machine.

    Where the protocol is of a vehicle that swims, `swimming` holds all parameters of it.
    """

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    suite: str
    cases: list[CaseEntry]
    worlds: dict[str, SavedEntry] = {}
    """Those of the user's own, by name and seed."""
    sealed: SealedEntry | None = None
    """Of a sealed test; None of worlds that are known."""
    planners: dict[_Name, dict[str, Any]]
    """Parameters of each, by its name on the command line."""
    protocol: dict[str, Any]
    max_steps: int | None
    version: str
    commit: str | None
    source: str
    """SHA-256 of the code; see `dream.evaluation.machine`."""
    engine: str
    machine: dict[str, Any]
    later: list[dict[str, Any]] = []
    """Other engines and machines that went on with it, where there were any."""
    started: str
    finished: str | None
    """None while missions are missing."""
    failed: list[FailedEntry] = []
    """Missions that failed when it was last flown, and why."""
    wall_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """All that a benchmark folder says."""

    manifest: dict[str, Any]
    rows: tuple[Row, ...]
    """In canonical order: case after case, planner after planner."""
    traces: dict[MissionKey, Trace]


_ROW = TypeAdapter(Row)


def mission_path(folder: Path, key: MissionKey) -> Path:
    """Where a mission of a benchmark folder is kept."""
    protocol, world, seed, start, planner = key
    return folder / "missions" / f"{protocol}_{_file_word(world)}_{seed}_{start}_{planner}.json"


def _file_word(world: str) -> str:
    """A world's name as a part of a file's. A digest tells apart what would else be the same to a system."""
    if origin(world) is not None:
        return world.replace("/", "-")
    word = re.sub(r"[^A-Za-z0-9.+]+", "-", world).strip("-")
    return f"{word}-{hashlib.sha256(world.encode()).hexdigest()[:8]}"


def write_mission(folder: Path, flown: Flown) -> Path:
    """Keep one finished mission: whole or not at all, and on the disk when this returns."""
    trace = {name: column.tolist() for name, column in _columns(flown.trace).items()}
    path = mission_path(folder, flown.row.key)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(
        path, (json.dumps({"row": asdict(flown.row), "trace": trace}, allow_nan=False) + "\n").encode()
    )
    return path


def read_mission(path: Path) -> Flown:
    """A mission that `write_mission` kept.

    Raises:
        FileNotFoundError: There is none.
        ValueError: The file is damaged, its row says something else than its trace, or it is another
            mission's; the message names it.
    """
    content = _json(path)
    if not isinstance(content, dict) or set(content) != {"row", "trace"}:
        raise ValueError(f"{path}: expected an object with row and trace, got something else")
    row = _row(content["row"], str(path))
    try:
        flown = Flown(row, _trace(content["trace"], row.steps + 1))
        _check_agrees(flown)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
    if mission_path(path.parents[1], row.key) != path:
        raise ValueError(f"{path}: expected the mission that the file is named after, got {row.key}")
    return flown


def write_tables(folder: Path, missions: Sequence[Flown]) -> None:
    """Write `results.csv` and `traces.csv.gz` of these missions, in this order.

    Equal missions give equal bytes, except in the columns `TIMES`.
    """
    table = io.StringIO()
    lines = csv.writer(table, lineterminator="\n")
    lines.writerow(COLUMNS)
    lines.writerows([_cell(getattr(flown.row, name)) for name in COLUMNS] for flown in missions)
    write_whole(folder / "results.csv", table.getvalue().encode())
    packed = io.BytesIO()
    with gzip.GzipFile(filename="", mode="wb", fileobj=packed, compresslevel=6, mtime=0) as file:
        file.write((",".join(TRACE_COLUMNS) + "\n").encode())
        for flown in missions:
            file.writelines(_trace_lines(flown))
    write_whole(folder / "traces.csv.gz", packed.getvalue())


def write_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Check and write `manifest.json`: whole or not at all."""
    checked = _checked_manifest(manifest, "manifest")
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / "manifest.json", (json.dumps(checked, indent=2, allow_nan=False) + "\n").encode())


def read_manifest(folder: Path) -> dict[str, Any]:
    """What was run.

    Raises:
        FileNotFoundError: `folder` is no benchmark folder.
        ValueError: The file is damaged.
    """
    path = _file_of(folder, "manifest.json")
    return _checked_manifest(_json(path), str(path))


def read_results(folder: str | Path) -> Results:
    """A benchmark folder.

    Raises:
        FileNotFoundError: `folder` is no benchmark folder, or one that was broken off before its tables.
        ValueError: A file is damaged; the message names it and the line.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    rows = tuple(_read_rows(_file_of(folder, "results.csv")))
    traces = _read_traces(_file_of(folder, "traces.csv.gz"), rows)
    return Results(manifest, rows, traces)


def read_kept(folder: Path) -> Results:
    """A benchmark folder, be it one that was broken off: all of its missions that are whole.

    Raises:
        FileNotFoundError: `folder` is no benchmark folder.
        ValueError: Its manifest is damaged, or a table of a folder that holds no missions of its own.
    """
    if not (folder / "missions").is_dir():
        return read_results(folder)
    manifest, kept = read_manifest(folder), []
    for path in sorted((folder / "missions").glob("*.json")):
        try:
            kept.append(read_mission(path))
        except ValueError as damage:
            logger.warning("%s; that mission is left out", damage)
    return Results(manifest, tuple(f.row for f in kept), {f.row.key: f.trace for f in kept})


def _cell(value: object) -> str:
    if value is None:
        return ""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _trace_lines(flown: Flown) -> Iterator[bytes]:
    head, trace = ",".join(map(str, flown.row.key)), flown.trace
    there = _columns(trace)
    columns = (there[name].tolist() if name in there else [None] * len(trace) for name in Trace.__slots__)
    for step, values in enumerate(zip(*columns, strict=True)):
        yield f"{head},{step},{','.join(map(_cell, values))}\n".encode()


def _row(values: Any, where: str) -> Row:
    if isinstance(values, dict):
        values = {**dict.fromkeys(chain(*LATER)), **values}
    try:
        row = _ROW.validate_python(values)
    except ValidationError as error:
        raise ValueError(f"{where}: {_first(error)}") from error
    if row.ended == "aborted" and (row.success or row.t_stop is not None):
        raise ValueError(f"{where}: ended: expected no success and no stop of its own where it was aborted")
    return row


def _trace(values: Any, length: int) -> Trace:
    """A trace of that many poses; a ValueError where it is none."""
    names = set(Trace.__slots__)
    if not isinstance(values, dict) or not names - set(LATER_IN_TRACES) <= set(values) <= names:
        raise ValueError(f"trace: expected the columns {', '.join(Trace.__slots__)}")
    columns: dict[str, npt.NDArray[Any]] = {}
    for name, given in values.items():
        if not isinstance(given, list) or len(given) != length:
            raise ValueError(f"trace: {name}: expected {length} values")
        kind = bool if name == "collided" else int | float
        if not all(isinstance(value, kind) for value in given):
            raise ValueError(
                f"trace: {name}: expected only {'booleans' if name == 'collided' else 'numbers'}"
            )
        columns[name] = np.array(given, np.bool_ if name == "collided" else np.float64)
    trace = Trace(**columns)
    if not all(np.isfinite(columns[name]).all() for name in ("x", "y", "yaw_deg")):
        raise ValueError("trace: expected finite poses")
    if not ((trace.instances >= 0.0) & (trace.instances <= 1.0)).all():
        raise ValueError("trace: instances: expected shares from 0 to 1")
    for name in columns.keys() & set(LATER_IN_TRACES):
        if not (np.isfinite(columns[name]).all() and (np.diff(columns[name]) >= 0.0).all()):
            raise ValueError(f"trace: {name}: expected finite amounts that never fall")
    return trace


def _check_agrees(flown: Flown) -> None:
    """Raise a ValueError where a row says something else than its trace, as far as that tells."""
    row, trace = flown.row, flown.trace
    told: dict[str, Any] = {
        "instances": float(trace.instances[-1]),
        **curve(trace.instances.tolist(), row.cap or protocol_named(row.protocol).cap),
        "collisions": int(trace.collided[1:].sum()),
        "t_stop": row.steps if row.ended == "done" else None,
    }
    for name, share in MILESTONES.items():
        # Which of the two it was, the digits that were left out say.
        either = [_first_step(trace, least) for least in (share - ROUNDING, min(share + ROUNDING, 1.0))]
        told[name] = getattr(row, name) if getattr(row, name) in either else either[0]
    succeeds = row.ended == "done" and told["t98"] is not None and not told["collisions"]
    # One that asked a model and never had an answer is no success whatever it saw.
    told["success"] = succeeds and (row.success or row.vlm_calls is None)
    for name, value in told.items():
        if getattr(row, name) != value:
            raise ValueError(f"{name}: expected {value}, as its trace says, got {getattr(row, name)}")


def _first_step(trace: Trace, share: float) -> int | None:
    reached = np.flatnonzero(trace.instances >= share)
    return int(reached[0]) if len(reached) else None


def _headers() -> Iterator[tuple[str, ...]]:
    """The columns of today, and those of every time before some came."""
    for age in range(len(LATER) + 1):
        since = set(chain(*LATER[len(LATER) - age :]))
        yield tuple(name for name in COLUMNS if name not in since)


def _read_rows(path: Path) -> Iterator[Row]:
    if path.stat().st_size > MAX_TABLE_BYTES:
        raise ValueError(f"{path}: expected at most {MAX_TABLE_BYTES} bytes, got more")
    known: set[MissionKey] = set()
    with path.open(encoding="utf-8", newline="") as file:
        lines = csv.reader(file, strict=True)
        try:
            header = tuple(next(lines, []))
            if header not in _headers():
                raise ValueError(f"expected the columns {','.join(COLUMNS)}, got {','.join(header)[:200]}")
            for cells in lines:
                if len(cells) != len(header):
                    raise ValueError(f"expected {len(header)} cells, got {len(cells)}")
                row = _row({name: cell or None for name, cell in zip(header, cells, strict=True)}, "row")
                if row.key in known:
                    raise ValueError(f"expected each mission once, got {row.key} again")
                known.add(row.key)
                yield row
        except (csv.Error, ValueError) as error:
            raise ValueError(f"{path}, line {lines.line_num}: {error}") from error


def _read_traces(path: Path, rows: Sequence[Row]) -> dict[MissionKey, Trace]:
    traces: dict[MissionKey, Trace] = {}
    number = 1
    try:
        with gzip.open(path, "rb") as file:
            header = file.readline(MAX_LINE_BYTES).decode().rstrip("\n")
            found = tuple(header.split(","))
            if found not in (TRACE_COLUMNS, TRACE_COLUMNS[: -len(LATER_IN_TRACES)]):
                raise ValueError(f"expected the columns {','.join(TRACE_COLUMNS)}, got {header[:200]}")
            for row in rows:
                head = ",".join(map(str, row.key))
                columns: dict[str, list[Any]] = {name: [] for name in Trace.__slots__ if name in found}
                for step in range(row.steps + 1):
                    number += 1
                    cells = _after(file, f"{head},{step},").split(",")
                    if len(cells) != len(columns):
                        raise ValueError(f"expected {len(found)} cells, got another number")
                    for name, cell in zip(columns, cells, strict=True):
                        columns[name].append(_traced(name, cell))
                there = {name: cells for name, cells in columns.items() if set(cells) != {None}}
                traces[row.key] = _trace(there, row.steps + 1)
            number += 1
            if file.read(1):
                raise ValueError("expected the end, got more than results.csv tells of")
    except (ValueError, EOFError, OSError, zlib.error) as error:
        raise ValueError(f"{path}, line {number}: {error}") from error
    return traces


def _traced(name: str, cell: str) -> bool | float | None:
    """A cell of a trace; None where its mission has no such column."""
    if name == "collided":
        return _flag(cell)
    return None if not cell and name in LATER_IN_TRACES else float(cell)


def _after(file: BinaryIO | gzip.GzipFile, head: str) -> str:
    """The rest of the next line, which must begin with `head`."""
    line = file.readline(MAX_LINE_BYTES).decode()
    if not line.startswith(head) or not line.endswith("\n"):
        raise ValueError(f"expected a line that begins with {head}, got {line[:100]!r}")
    return line[len(head) : -1]


def _flag(cell: str) -> bool:
    if cell not in ("true", "false"):
        raise ValueError(f"expected true or false, got {cell[:20]!r}")
    return cell == "true"


def _checked_manifest(content: Any, where: str) -> dict[str, Any]:
    try:
        return Manifest.model_validate(content).model_dump(mode="json")
    except ValidationError as error:
        raise ValueError(f"{where}: {_first(error)}") from error


def _first(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    field = ".".join(map(str, first["loc"])) or "the whole"
    return f"{field}: {first['msg']}, got {repr(first['input'])[:80]}"


def _json(path: Path) -> Any:
    if path.stat().st_size > MAX_FILE_BYTES:
        raise ValueError(f"{path}: expected at most {MAX_FILE_BYTES} bytes, got more")
    try:
        return from_json(path.read_bytes(), allow_inf_nan=False)
    except ValueError as error:
        raise ValueError(f"{path}: expected one JSON object, got damaged text ({error})") from error


def _file_of(folder: Path, name: str) -> Path:
    path = folder / name
    if not path.is_file() and (folder / "manifest.json").is_file():
        raise FileNotFoundError(
            f"{folder}: expected a benchmark with its {name}, got an unfinished one without. The same "
            "dream bench or dream sweep goes on with it, and writes that"
        )
    if not path.is_file():
        raise FileNotFoundError(
            f"{folder}: expected a benchmark folder, got no {name} in it. They are made by dream bench"
        )
    return path
