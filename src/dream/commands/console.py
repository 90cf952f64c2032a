"""What commands share: how they print, show progress and find a world."""

from __future__ import annotations

import contextlib
import json as json_format
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from dream.commands.progress import Stage, stage, telling
from dream.ending import TERMINATED
from dream.errors import MissionAborted
from dream.files import write_whole

if TYPE_CHECKING:
    from PIL import Image
    from rich.console import RenderableType

    from dream.evaluation.runner import Ended, Plan
    from dream.protocol import SurveyProtocol
    from dream.sim.world import World

PICTURES = (".png", ".jpg", ".jpeg", ".webp")
COMPUTES = ("dream.evaluation.", "dream.mapping.", "dream.perception.", "dream.planning.", "dream.sim.")
"""Modules of the package that call kernels; see `kept_interrupts`."""
WITH_WORLD = ("run", "fly", "dive", "mission", "bench", "oracle", "draw")
"""Commands with the option `--world`."""


def open_world(name: str, seed: int) -> World:
    """See `dream.sim.worlds.open_world`, which is imported only when it is needed."""
    from dream.sim import worlds

    return worlds.open_world(name, seed)


def check_no_world(command: str, word: str) -> None:
    """Raise a ValueError where a world stands without the `--world` that should stand before it."""
    if command not in (*WITH_WORLD, "worlds") or word.startswith("-"):
        return
    from dream.sim.worlds import is_saved, origin

    if origin(word) is not None or (word and is_saved(Path(word))):
        if command == "worlds":
            raise ValueError(
                f"{word}: expected an option before a world, got none. Say: dream draw --world {word}, to "
                f"look at it; or dream worlds --save {word}, to have its folder"
            )
        said = f"dream {command} {'--stand-in ' if command == 'dive' else ''}--world {word}"
        raise ValueError(f"{word}: expected --world before a world, got none. Say: {said}")


def check_writable(folder: Path, option: str = "--out") -> None:
    """Make the folder of an option and see that it can be written, before anything is worked or paid for.

    Raises:
        OSError: It cannot.
    """
    import tempfile

    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise OSError(
            f"{option}: expected a place that can be written, got {folder} ({error.strerror}). Choose another"
        ) from error


def check_picture(path: Path, option: str) -> None:
    """See that a picture can be written there, before anything is drawn.

    Raises:
        ValueError: It is no name of a picture.
        OSError: Its folder cannot be written.
    """
    if path.suffix.lower() not in PICTURES:
        raise ValueError(f"{option}: expected a name that ends in .png, .jpg or .webp, got {path}")
    if path.is_dir():
        raise ValueError(f"{option}: expected a file, got the folder {path}")
    check_writable(path.parent, option)


def save_picture(picture: Image.Image, path: Path, option: str) -> None:
    """Write a picture whole, or leave what was there.

    Raises:
        OSError: There is no room for it, or it cannot be written.
    """
    import io

    from PIL import Image

    Image.init()
    content = io.BytesIO()
    picture.save(content, Image.EXTENSION[path.suffix.lower()])
    try:
        write_whole(path, content.getvalue())
    except OSError as error:
        raise OSError(
            f"{option}: expected room for a picture of {content.tell() / 1e6:.1f} MB, {error}. "
            "Make room, or choose another place"
        ) from error


def check_max_steps(max_steps: int | None, protocol: SurveyProtocol) -> None:
    """Raise a ValueError where `--max-steps` leaves none; tell where it asks for more than the cap.

    A larger arena may need them.
    """
    if max_steps is None:
        return
    if max_steps < 1:
        raise ValueError(f"--max-steps: expected at least 1, got {max_steps}")
    if max_steps > protocol.cap:
        sys.stderr.write(
            f"dream: {max_steps} steps are more than the cap of {protocol.name}, {protocol.cap}: "
            "not to be compared with missions of a benchmark\n"
        )


def with_scores(missions: Iterable[Ended], plan: Plan) -> Iterator[Ended]:
    """Pass the missions of a benchmark on, and show on standard error how the planners fare so far."""
    scores = _Scores(plan)
    with stage(plan.suite, len(plan), "missions") as work:
        work.drawing = scores.table
        for mission in missions:
            scores.add(mission)
            scores.shown_in(work)
            yield mission


@dataclass(slots=True)
class _Score:
    flown: int = 0
    failed: int = 0
    successes: int = 0
    t98: int = 0
    """Summed; one never reached counts as all the steps that a mission has."""
    collisions: int = 0


class _Scores:
    """How far a benchmark is."""

    def __init__(self, plan: Plan) -> None:
        from dream.evaluation.results import MAX_STEPS

        self._plan = plan
        # In space the cap goes by the world, and a row tells it.
        cap = plan.protocol.cap if plan.protocol.space is None else MAX_STEPS
        self._horizon = cap if plan.max_steps is None else min(cap, plan.max_steps)
        self._of = {name: _Score() for name in plan.planners}
        self._kept = 0
        self.ended = 0

    def add(self, mission: Ended) -> None:
        from dream.evaluation.results import Flown

        score = self._of[mission.key[-1]]
        self.ended += 1
        self._kept += mission.kept
        if isinstance(mission.outcome, Flown):
            row = mission.outcome.row
            score.flown += 1
            score.successes += row.success
            score.t98 += row.horizon(self._horizon) if row.t98 is None else row.t98
            score.collisions += row.collisions
        else:
            score.failed += 1

    def shown_in(self, work: Stage) -> None:
        """Bring a stage up to date."""
        failed = sum(score.failed for score in self._of.values())
        kept = f"{self._kept} of them kept" if self._kept else ""
        work.done, work.spared = self.ended, self._kept
        work.said = ", ".join(filter(None, (kept, f"{failed} failed" if failed else "")))

    def table(self, words: str) -> RenderableType:
        """The planners' scores, and a bar with words of how far all of it is."""
        from rich.console import Group
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        table = Table()
        for heading in ("planner", "missions", "success", "to 98.26 %", "contacts", "failed"):
            table.add_column(heading, justify="left" if heading == "planner" else "right")
        for name, score in self._of.items():
            table.add_row(
                name,
                f"{score.flown}/{len(self._plan.cases)}",
                f"{score.successes / score.flown:.0%}" if score.flown else "",
                f"{score.t98 / score.flown:.1f}" if score.flown else "",
                str(score.collisions),
                str(score.failed) if score.failed else "",
            )
        progress = Table.grid()
        progress.add_row(ProgressBar(len(self._plan), self.ended, width=60))
        progress.add_row(Text(f"{self._plan.suite}: {words}"))
        return Group(table, progress)


@contextlib.contextmanager
def kept_interrupts(
    again: Callable[[float], bool] = lambda since: True, *, between_steps: bool = False
) -> Iterator[Callable[[], None]]:
    """A check to call between steps: it raises the KeyboardInterrupt that compiled code swallowed.

    A SIGTERM that nobody else handles counts as an interrupt, too.

    An interrupt that comes while a kernel is compiled, or in a callback from C, is printed and forgotten; one
    that comes within a kernel may end as another error. Whatever fails after an interrupt was interrupted.

    Args:
        again: Whether an interrupt counts that comes so many seconds after the one before.
        between_steps: Let the first that comes while the package computes wait for the check: raised while
            the tuple is made that a kernel returns, it ends the process.
    """
    came: KeyboardInterrupt | None = None
    last = -math.inf

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal came, last
        now = time.monotonic()
        since, last = now - last, now
        if came is not None and not again(since):
            return
        first = came is None
        came = came or KeyboardInterrupt(*([TERMINATED] if number == signal.SIGTERM else []))
        if first and between_steps and frame is not None and _computes(frame):
            return
        raise KeyboardInterrupt(*came.args)

    def check() -> None:
        if came is not None:
            raise KeyboardInterrupt(*came.args)

    if threading.current_thread() is not threading.main_thread():
        yield check  # Only the main thread is ever interrupted, and only it may say what happens then.
        return
    before = {signal.SIGINT: signal.signal(signal.SIGINT, note)}
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        before[signal.SIGTERM] = signal.signal(signal.SIGTERM, note)
    try:
        yield check
    except MissionAborted:
        raise  # It says already what came of it.
    except Exception:
        check()
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _computes(frame: FrameType) -> bool:
    """Is it code that calls kernels, or that makes what one returns, and waits for nothing and nobody?"""
    at: FrameType | None = frame
    name = ""
    while at is not None and (not name or name.startswith(("namedtuple_", "numba."))):
        name, at = str(at.f_globals.get("__name__", "")), at.f_back
    return name.startswith(COMPUTES) and not name.startswith("dream.planning.vlm")


@contextlib.contextmanager
def compiling_told() -> Iterator[None]:
    """Say on standard error, once, where code is compiled within the block: that takes a while."""
    from dream.compiling import noted, when_compiling

    told = "dream: compiling what was not used here before; the first time takes about a minute"
    with telling() as teller:

        def note(compiling: bool) -> None:
            teller.compiling = compiling

        with when_compiling(lambda: print(told, file=sys.stderr)), noted(note):
            yield


def tell_lost(record: str | None) -> None:
    """Say on standard error how many exchanges could not be kept in the folder of `--record`, if any."""
    from dream.planning.vlm.asking.cassette import lost

    if record is not None and (count := lost[Path(record)]):
        print(f"dream: {record}: {count} exchanges in all were not kept", file=sys.stderr)


def told_without_answer(told: str) -> int:
    """Say on standard error that no answer of a model counted, where it is so.

    Args:
        told: What `dream.evaluation.metrics.without_answer` says; empty where an answer counted.

    Returns:
        Exit status, 1 where none did.
    """
    if told:
        print(f"dream: {told}", file=sys.stderr)
    return 1 if told else 0


def print_json(record: Mapping[str, Any]) -> None:
    """Print exactly one JSON object, at once: whoever reads it may be waiting for it."""
    print(json_format.dumps(record, allow_nan=False), flush=True)


def price(cost_usd: float | None) -> str:
    """What asking a model cost, in words."""
    return "at an unknown price" if cost_usd is None else f"{cost_usd:.4f} US$"
