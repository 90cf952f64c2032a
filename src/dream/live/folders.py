"""Run folders that are being written → what is known of them by now.

Nothing here writes, locks or waits: a mission does not notice that it is watched. A line counts once its
newline is there, since the recording writes a step's pictures before its line. Whatever is damaged is told
of one run and leaves the others alone.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import math
import os
import stat
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from dream.recording import (
    COMPILING,
    MAX_LINE_BYTES,
    RecordedStep,
    RunConfig,
    RunSummary,
    read_config,
    read_replies,
    read_step,
    read_summary,
)
from dream.report import of_protocol
from dream.scene import SPACE

logger = logging.getLogger(__name__)

MAX_RUNS = 24
"""Side by side; of a folder that holds more, the newest."""
MAX_FILE_BYTES = 16 << 20
"""A larger file of a run is not opened."""
MAX_LINES_BYTES = 64 << 20
"""Nor are more lines of one run read."""
READ_BYTES = 4 << 20
"""Of one run's lines at a time, so that a long one does not hold up the others."""
LIST_S = 1.0
"""Seconds between two looks for new runs."""

_LONG = {"decision", "guarded", "reasoning", "open_region", "truth"}
"""Fields of a step that are only shown of the run that is open."""


@dataclass(frozen=True, slots=True)
class ShownStep:
    """A step as a page gets it."""

    number: int
    whole: dict[str, Any]
    """Its line, and `spent`: the tokens and the US$ that its questions cost; None where not known."""

    @property
    def brief(self) -> dict[str, Any]:
        """What stands beside other runs: all but the long fields."""
        return {name: value for name, value in self.whole.items() if name not in _LONG}


@dataclass(slots=True)
class WatchedRun:
    """One run folder, as far as it was read."""

    folder: Path
    config: RunConfig | None = None
    summary: RunSummary | None = None
    steps: list[ShownStep] = field(default_factory=list)
    problem: str = ""
    """What is damaged, and nothing of the run is read after that; or why it cannot be read just now."""
    behind: bool = False
    """Whether there is more to read than was read so far."""
    version: int = 0
    """Counts the changes of what is said of the run as a whole."""
    space: str = ""
    """Tells one version of its scene from another; empty where it has none."""
    compiling: float | None = None
    """When its program began to compile, on the clock of `time.time`; None where it does not."""
    _numbers: dict[int, int] = field(default_factory=dict)
    _last: RecordedStep | None = None
    _offset: int = 0
    _before: int = 0
    """Where the last line that was read begins."""
    _written: float = 0.0
    _damaged: bool = False

    @property
    def key(self) -> str:
        """What the run is called in addresses: the same whenever this folder is watched."""
        return hashlib.sha256(os.fsencode(self.folder)).hexdigest()[:8]

    def has(self, step: int) -> bool:
        """Whether it recorded a step of this number."""
        return step in self._numbers

    def look(self) -> None:
        """Read what came since the last look. Never raises: what is wrong stands in `problem`."""
        if self._damaged:
            return
        before = self._told()
        try:
            self.compiling = self._since(COMPILING)
            self.space = self._version_of(SPACE)
            if self.config is None:
                if not (self.folder / "config.json").exists():
                    return
                self._check("config.json")
                self.config = read_config(self.folder)
            # First: once the summary is there, no further line comes.
            summary = None
            if self.summary is None and (self.folder / "summary.json").exists():
                self._check("summary.json")
                summary = read_summary(self.folder)
            self.behind = not self._read_lines()
            if not self.behind:
                self.summary = summary or self.summary
            self.problem = ""
        except (OSError, ValueError) as error:
            # A disk or a network may be back at the next look; damage stays.
            self._damaged = isinstance(error, ValueError)
            self.problem = str(error).replace(f"{self.folder}{os.sep}", "")
            self.behind = False
            if self.problem != before[2]:
                logger.warning("%s is not read on: %s", self.folder.name, self.problem)
        if before != self._told():
            self.version += 1

    def _told(self) -> tuple[Any, ...]:
        return self.config is None, self.summary, self.problem, self.compiling

    def _since(self, name: str) -> float | None:
        path = self.file(name)
        with contextlib.suppress(OSError):
            return None if path is None else path.stat().st_mtime
        return None

    def _version_of(self, name: str) -> str:
        path = self.file(name)
        with contextlib.suppress(OSError):
            return "" if path is None else str(path.stat().st_mtime_ns)
        return ""

    def _read_lines(self) -> bool:
        """Take whole lines; True where none is left."""
        path = self.folder / "steps.jsonl"
        if not path.exists():
            return True
        size, self._written = self._check("steps.jsonl", MAX_LINES_BYTES)
        if size < self._offset:
            raise ValueError(f"steps.jsonl: expected {self._offset} bytes or more, got {size}. Another run?")
        with path.open("rb") as lines:
            lines.seek(max(0, self._offset - 1))
            if self._offset and lines.read(1) != b"\n":
                # The last line was told why no other follows (`recording.write_summary`): it is read again.
                self._offset = self._before
                del self._numbers[self.steps.pop().number]
                self._last = None
                lines.seek(self._offset)
            read = lines.read(READ_BYTES)
        *whole, torn = read.split(b"\n")
        for line in whole:
            where = f"steps.jsonl, line {len(self.steps) + 1}"
            self._check_length(line, where)
            step = read_step(line, where, self._last)
            self._last, self._before = step, self._offset
            self._offset += len(line) + 1
            self._numbers[step.step] = len(self.steps)
            self.steps.append(ShownStep(step.step, {**step.model_dump(), "spent": self._spent(step)}))
        self._check_length(torn, "steps.jsonl, its end")
        return len(read) < READ_BYTES

    @staticmethod
    def _check_length(line: bytes, where: str) -> None:
        if len(line) > MAX_LINE_BYTES:
            raise ValueError(f"{where}: expected at most {MAX_LINE_BYTES} bytes, got more")

    def _spent(self, step: RecordedStep) -> dict[str, Any] | None:
        """What was kept of the questions of a step says what they cost."""
        if step.asked is None or not self.keeps_replies(step.step):
            return None
        try:
            exchanges = read_replies(self.folder, step.step)
        except (OSError, ValueError) as error:
            logger.warning("the cost of step %d is not known: %s", step.step, error)
            return None
        if not exchanges:
            return None
        costs = [exchange.cost_usd for exchange in exchanges]
        return {
            "tokens": sum(exchange.tokens_in + exchange.tokens_out for exchange in exchanges),
            "cost_usd": None if None in costs else math.fsum(cost for cost in costs if cost is not None),
        }

    def _check(self, name: str, most: int = MAX_FILE_BYTES) -> tuple[int, float]:
        """Size and time of a file that lies in this folder and not only seems to.

        Raises:
            ValueError: It is no file, lies elsewhere or is too large.
            OSError: It is gone.
        """
        path = self.folder / name
        if not path.resolve().is_relative_to(self.folder.resolve()):
            raise ValueError(f"{name}: expected a file of the run, got a link out of it")
        info = path.stat()
        if not stat.S_ISREG(info.st_mode) or info.st_size > most:
            raise ValueError(f"{name}: expected a file of at most {most} bytes, got {info.st_size}")
        return info.st_size, info.st_mtime

    def file(self, name: str) -> Path | None:
        """A file of the run; None where there is none, or only a link out of the folder."""
        try:
            self._check(name)
        except (OSError, ValueError):
            return None
        return self.folder / name

    def keeps_replies(self, step: int) -> bool:
        """Whether what a model was asked at a step lies in the folder, all of it."""
        kept = [f"replies/{path.name}" for path in (self.folder / "replies").glob(f"{step:04d}[._-]*")]
        return bool(kept) and all(map(self.file, kept))

    def age(self) -> float | None:
        """Seconds since the last step was written; None before the first."""
        return max(0.0, time.time() - self._written) if self.steps else None

    def head(self) -> dict[str, Any]:
        """What is said of the run as a whole."""
        return {
            "run": self.key,
            "name": self.folder.name,
            "config": _plain(self.config),
            "summary": _plain(self.summary),
            "problem": self.problem,
            "compiling_s": None if self.compiling is None else max(0.0, time.time() - self.compiling),
            "cap": None if self.config is None else _cap(self.config),
            **({} if self.config is None else of_protocol(self.config)),
        }


class Watched:
    """The runs that are watched: those that were named, and those that appear in the folders that were."""

    def __init__(self, places: Sequence[Path]) -> None:
        """Watch run folders, or folders of them; either may not be there yet."""
        self._places = tuple(place.absolute() for place in places)
        self._runs: dict[str, WatchedRun] = {}
        self._listed = -math.inf
        self.left_out = 0
        """Runs that are there and not shown, since they are too many."""

    def __iter__(self) -> Iterator[WatchedRun]:
        """In the order of the page: places as they were named, in a folder the newest first."""
        return iter(tuple(self._runs.values()))

    def get(self, key: str) -> WatchedRun | None:
        """The run of a key; None where it is not watched."""
        return self._runs.get(key)

    def waiting(self) -> list[str]:
        """Names of the places where there is nothing yet."""
        shown = {run.folder for run in self}
        return [
            place.name
            for place in self._places
            if not any(place.resolve() in (folder, folder.parent) for folder in shown)
        ]

    def look(self) -> None:
        """See what came: new runs once in a while, and what is new of each."""
        if time.monotonic() - self._listed >= LIST_S:
            self._list()
            self._listed = time.monotonic()
        for run in self:
            run.look()

    def _list(self) -> None:
        folders: list[Path] = []
        for place in self._places:
            folders += [place.resolve()] if _is_run(place) else _runs_in(place)
        found = dict.fromkeys(folders)
        self.left_out = max(0, len(found) - MAX_RUNS)
        runs = (WatchedRun(folder) for folder in list(found)[:MAX_RUNS])
        self._runs = {run.key: self._runs.get(run.key, run) for run in runs}


def _is_run(folder: Path) -> bool:
    return any((folder / name).is_file() for name in ("config.json", "steps.jsonl"))


def _runs_in(place: Path) -> list[Path]:
    """Run folders directly in a folder, the newest first; no links, as `latest` is one."""
    made: list[tuple[float, Path]] = []
    # What is not there yet, or is being removed, is looked for again.
    with contextlib.suppress(OSError):
        for entry in os.scandir(place):
            folder = Path(entry.path)
            with contextlib.suppress(OSError):
                if entry.is_dir(follow_symlinks=False) and _is_run(folder):
                    # Written once; the folder's own time changes as its files come.
                    made.append(((folder / "config.json").stat().st_mtime, folder.resolve()))
    return [folder for _, folder in sorted(made, reverse=True)]


def _plain(record: BaseModel | None) -> dict[str, Any] | None:
    return None if record is None else record.model_dump(mode="json")


def _cap(config: RunConfig) -> int | None:
    """Steps after which the mission ends; None where its protocol is not known here."""
    most = config.max_steps
    if most is None:
        with contextlib.suppress(ValueError):
            most = config.rules.cap
    ordered = (config.orders or {}).get("max_steps")
    return min((steps for steps in (most, ordered) if isinstance(steps, int)), default=None)
