"""Where the work of a command is: a bar on a terminal, else a line on standard error every so often.

Work that may take a while is a `stage`. Stages may lie in each other; the innermost is told. All stages of a
command share one clock, so that many short ones are told of too.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

from dream.telling import one_line, rich_console

if TYPE_CHECKING:
    from rich.console import RenderableType

T = TypeVar("T")

EVERY = 10.0
"""Seconds from the beginning of a command to its first line, and from each line to the next."""
KNOWN_AFTER = 5.0
"""Seconds of work from which on it is told how long the rest takes."""


@dataclass(slots=True)
class Stage:
    """A part of a command's work, and how far it is. What does the work keeps it up to date."""

    title: str
    total: int | None = None
    """How much there is to do; None where nobody knows."""
    unit: str = ""
    """What is counted, such as `steps`."""
    at_most: bool = False
    """The work may end before `total`, so that nobody knows how long it still takes."""
    began: float = 0.0
    """When, on the clock of whoever tells."""
    done: int = 0
    spared: int = 0
    """Of those that are done: what was done before, and took no time."""
    said: str = ""
    """What came of it so far."""
    drawing: Callable[[str], RenderableType] | None = None
    """Draws it on a terminal in the place of a bar, given the words."""

    def words(self, now: float) -> str:
        """How far it is, how long it has taken and how long it still takes, such as
        `3 of 12 steps after 20 s, about 60 s left`."""
        passed = max(now - self.began, 0.0)
        said = f"{passed:.0f} s"
        if self.total is not None:
            most = "at most " if self.at_most else ""
            said = f"{self.done} of {most}{self.total} {self.unit}".rstrip() + f" after {said}"
        if self.said:
            said += f", {self.said}"
        worked = self.done - self.spared
        if self.total is None or self.at_most or worked <= 0 or passed < KNOWN_AFTER:
            return said
        left = passed / worked * (self.total - self.done)
        if left <= 0.0:
            return said
        return said + (f", about {left / 60:.0f} min left" if left >= 90 else f", about {left:.0f} s left")


@dataclass(slots=True)
class Telling:
    """Tells of the stages of one command."""

    write: Callable[[str], None]
    """Takes a line."""
    clock: Callable[[], float] = time.monotonic
    stages: list[Stage] = field(default_factory=list)
    """The innermost is the last."""
    compiling: bool = False
    """Code is compiled, and the work waits."""
    last: float = field(init=False)
    """When the last line was told; at first, when the command began."""

    def __post_init__(self) -> None:
        """Begin to wait."""
        self.last = self.clock()

    def until_due(self) -> float:
        """Seconds until the next line is due."""
        return max(self.last + EVERY - self.clock(), 0.0)

    def drawn(self) -> RenderableType:
        """All stages, for a terminal."""
        from rich.console import Group
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        rows: list[RenderableType] = []
        for work in self.stages[:]:
            words = one_line(work.words(self.clock()))
            if work.drawing is not None:
                rows.append(work.drawing(words))
                continue
            row = Table.grid(padding=(0, 1))
            bar = ProgressBar(work.total, min(work.done, work.total or 0), width=30, pulse=work.total is None)
            row.add_row(Text(one_line(work.title)), bar, Text(words))
            rows.append(row)
        return Group(*rows)

    def tell_if_due(self) -> None:
        """Write a line where one is due, and there is a stage to tell of."""
        stages = self.stages[-1:]
        if not stages or self.until_due() > 0.0:
            return
        self.last = self.clock()
        compiling = ", compiling" * self.compiling
        self.write(f"dream: {stages[0].title}: {stages[0].words(self.last)}{compiling}")


_current: Telling | None = None


@contextlib.contextmanager
def telling() -> Iterator[Telling]:
    """Tell of all stages within the block by one clock; within another such block it is that one's."""
    global _current
    if _current is not None:
        yield _current
        return
    _current = Telling(lambda line: print(one_line(line), file=sys.stderr, flush=True))
    try:
        with contextlib.nullcontext() if rich_console(stderr=True).is_terminal else _lines(_current):
            yield _current
    finally:
        _current = None


@contextlib.contextmanager
def stage(title: str, total: int | None = None, unit: str = "", *, at_most: bool = False) -> Iterator[Stage]:
    """Tell of the work within the block.

    Args:
        title: What is done.
        total: How much there is to do, where it is known.
        unit: What is counted.
        at_most: It may end before all of that is done.
    """
    with contextlib.ExitStack() as stack:
        teller = stack.enter_context(telling())
        work = Stage(title, total, unit, at_most, teller.clock())
        outermost = not teller.stages
        teller.stages.append(work)
        stack.callback(teller.stages.remove, work)
        if outermost:
            stack.enter_context(_drawn(teller))
        yield work


def with_progress(
    items: Iterable[T], title: str, total: int, unit: str = "", *, at_most: bool = False
) -> Iterator[T]:
    """Pass items on, and tell how many are done; see `stage`."""
    with stage(title, total, unit, at_most=at_most) as work:
        for done, item in enumerate(items):
            work.done = done
            yield item


@contextlib.contextmanager
def _lines(teller: Telling) -> Iterator[None]:
    """Write lines as they become due, also while the work is at one thing for long."""
    over = threading.Event()

    def keep_telling() -> None:
        # Where a line is due and no stage has begun, the next one is told of soon.
        while not over.wait(teller.until_due() or 0.5):
            teller.tell_if_due()

    thread = threading.Thread(target=keep_telling, name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextlib.contextmanager
def _drawn(teller: Telling) -> Iterator[None]:
    """Draw the stages on standard error where that is a terminal; nothing of it stays."""
    console = rich_console(stderr=True)
    if not console.is_terminal:
        yield
        return
    from rich.live import Live

    with Live(get_renderable=teller.drawn, console=console, transient=True):
        yield
