"""The operator's console of a dive: what goes on, and the keys that rule it."""

from __future__ import annotations

import contextlib
import enum
import os
import select
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from dream.telling import rich_console

if TYPE_CHECKING:
    from rich.console import RenderableType

    from dream.commands.dive.terminal import Terminal

SHOWN = 5.0
"""Times a second that the console is drawn."""
KEYS = {
    "p": "pause after this step",
    "h": "hold here now",
    "r": "resume",
    "e": "end the dive",
    "s": "surface",
}


class Will(enum.StrEnum):
    """What the operator wants."""

    GO = "go"
    PAUSE = "pause"
    """Wait once the present step is done."""
    HOLD = "hold"
    """Stay where it is, now."""
    END = "end"
    SURFACE = "surface"


_OF = {"p": Will.PAUSE, "h": Will.HOLD, "r": Will.GO, "e": Will.END, "s": Will.SURFACE}


@dataclass(frozen=True, slots=True)
class Reading:
    """One line of the console."""

    name: str
    value: str
    well: bool = True


@dataclass(slots=True)
class Operator:
    """What the operator wants, and whether there is one."""

    willed: Callable[[Will], None]
    """Told at once of every wish, on the console's thread."""
    alive: Callable[[float], None]
    """Told several times a second how many seconds ago the terminal last took something."""
    will: Will = Will.GO
    _over: bool = field(default=False)

    def press(self, key: str) -> None:
        """A key; others than those of `KEYS` mean nothing. An end is for good."""
        will = _OF.get(key.lower())
        if will is None or self._over:
            return
        self.will = will
        self._over = will in (Will.END, Will.SURFACE)
        self.willed(will)


@contextlib.contextmanager
def console(
    title: str, read: Callable[[], list[Reading]], operator: Operator, terminal: Terminal
) -> Iterator[bool]:
    """Show the dive on standard error, and read keys, while the block lasts.

    Without a terminal nothing is shown, and there is no operator: nobody calls `alive`. One that takes
    nothing is waited for by nobody, and its keys rule all the same. Yields whether there is one.

    Args:
        title: Above all.
        read: What to show, asked for again and again on another thread.
        operator: Who is told of keys.
        terminal: Says whether what is shown arrives.
    """
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        yield False
        return
    over = threading.Event()
    # The terminal is given back as it was, whatever happens.
    import termios
    import tty

    from rich.live import Live  # noqa: F401 - the operator is not kept waiting for it.

    keyboard = sys.stdin.fileno()
    before = termios.tcgetattr(keyboard)
    watching = threading.Thread(
        target=_watch, args=(title, read, operator, keyboard, terminal, over), name="console", daemon=True
    )
    try:
        # At once both times: to wait for what was written to be shown may last for ever.
        tty.setcbreak(keyboard, termios.TCSANOW)
        # From now on there has to be an operator, also if the thread shows none.
        operator.alive(terminal.idle)
        watching.start()
        yield True
    finally:
        over.set()
        watching.join(timeout=1.0)
        with contextlib.suppress(termios.error):  # The terminal may be gone.
            termios.tcsetattr(keyboard, termios.TCSANOW, before)


def _watch(
    title: str,
    read: Callable[[], list[Reading]],
    operator: Operator,
    keyboard: int,
    terminal: Terminal,
    over: threading.Event,
) -> None:
    from rich.live import Live

    with Live(console=rich_console(stderr=True), auto_refresh=False, transient=True) as live:
        drawn = 0.0
        while not over.is_set():
            ready, _, _ = select.select([keyboard], [], [], 0.05)
            if ready:
                try:
                    pressed = os.read(keyboard, 64).decode("ascii", "ignore")
                except OSError:
                    return  # The terminal is gone, and the operator with it.
                if not pressed:
                    return
                for key in pressed:
                    operator.press(key)
            idle = terminal.idle
            operator.alive(idle)
            # What is not taken now would only be shown late.
            if idle < 1.0 / SHOWN < time.monotonic() - drawn:
                drawn = time.monotonic()
                live.update(page(title, read(), operator.will), refresh=True)


def page(title: str, readings: list[Reading], will: Will) -> RenderableType:
    """What the console shows."""
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for reading in readings:
        style = "" if reading.well else "bold red"
        table.add_row(Text(reading.name, style="dim"), Text(reading.value, style=style))
    keys = "   ".join(f"{key} {what}" for key, what in KEYS.items())
    wants = "" if will is Will.GO else f" · the operator wants: {will}"
    return Panel(table, title=f"{title}{wants}", subtitle=keys, title_align="left", subtitle_align="left")


def tell(line: str, *, quiet: bool) -> None:
    """A line on standard error, unless `quiet`."""
    if not quiet:
        with contextlib.suppress(OSError):  # The terminal may be gone.
            print(f"dream: {line}", file=sys.stderr)
