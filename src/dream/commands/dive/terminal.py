"""Standard output and standard error of a dive, which keep nobody waiting.

A terminal that is stopped (Ctrl-S), an ssh connection that stalls or a pipe that nobody reads takes nothing,
and whoever writes to it waits until it does. During a dive those who write also bring the vehicle home.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import sys
import threading
import time
from collections.abc import Sequence
from typing import Self

ROOM = 256 << 10
"""Bytes that may wait to be shown."""
PATIENCE = 2.0
"""Seconds that the end waits for what was written to be taken; the rest is dropped."""
LAST_WORD = 0.3
"""Seconds more for the line that says what was dropped."""
LOOK = 0.05
"""Seconds between two looks whether a terminal takes something."""
PIECE = 512
"""Bytes that are written at once to a terminal: one that takes any takes these, if it is not nearly full."""

_OUT, _ERR = 1, 2


class Terminal:
    """Standard output and standard error within a with-block: all that is written to them is taken at once.

    What it does: both descriptors lead into this program, to a pseudo-terminal where a terminal stood and to
    a pipe elsewhere, so that Python, its log handlers, C libraries and child processes write as before and
    `isatty` and the width are right. One thread takes what comes, another writes it to where it was to go.
    More than `ROOM` is dropped, and a line tells how much once something is taken again. At the end what
    waits is written for `PATIENCE` seconds at most; then, where nothing is taken, both lead nowhere, and the
    program can end. A pipe that is read by then gets all of it, one that is read later what it holds.

    Assumes: a system with pseudo-terminals; on another it does nothing.
    Fails when: a C library writes more than a pipe holds (64 KiB) while it keeps all of Python's threads
    waiting.
    """

    def __init__(self) -> None:
        """Not yet in between."""
        self._ways: list[_Way] = []

    def __enter__(self) -> Self:
        if hasattr(os, "openpty"):
            _flush()
            self._ways = [_Way(place, tells=_ERR in place) for place in _places()]
        return self

    def __exit__(self, *_: object) -> None:
        _flush()
        until = time.monotonic() + PATIENCE
        for way in self._ways:
            lost = way.close(max(until, time.monotonic() + LAST_WORD))
            if lost and _ERR not in way.descriptors:
                with contextlib.suppress(OSError):
                    os.write(_ERR, f"dream: {lost} lines of standard output were not taken\n".encode())

    @property
    def idle(self) -> float:
        """Seconds since standard error took something, or would have; inf where it is gone."""
        return max((way.idle for way in self._ways if _ERR in way.descriptors), default=0.0)


class _Way:
    """From descriptors of this program, which take anything at once, to where they led before."""

    def __init__(self, descriptors: Sequence[int], *, tells: bool) -> None:
        """Put it in between.

        Args:
            descriptors: Lead all to the same place.
            tells: Whether a line of its own may say there how many were dropped.

        Raises:
            OSError: The system has no descriptors left.
        """
        self.descriptors, self._tells = descriptors, tells
        self._place = os.dup(descriptors[0])
        self._source, into = _pair(self._place)
        # A pipe that takes any takes so many.
        self._piece = PIECE if os.isatty(self._place) else select.PIPE_BUF
        for descriptor in descriptors:
            os.dup2(into, descriptor)
        os.close(into)
        self._size: tuple[int, int] | None = None
        self._waiting = bytearray()
        self._lost = 0
        """Lines that were dropped and not told yet."""
        self._line_open = False
        self._changed = threading.Condition()
        self._over = self._given_up = self._gone = False
        self._taken = time.monotonic()
        self._resize()
        names = "+".join(map(str, descriptors))
        self._taking = threading.Thread(target=self._take, name=f"takes {names}", daemon=True)
        self._giving = threading.Thread(target=self._give, name=f"gives {names}", daemon=True)
        self._taking.start()
        self._giving.start()

    @property
    def idle(self) -> float:
        """Seconds since something was taken at its end, or would have been; inf where the end is gone."""
        return math.inf if self._gone else time.monotonic() - self._taken

    def close(self, until: float) -> int:
        """Give what waits until a time of the monotonic clock; returns how many lines are lost.

        The descriptors lead to the old place again where that takes something by then, else nowhere.
        """
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for descriptor in self.descriptors:
            os.dup2(nowhere, descriptor)
        os.close(nowhere)
        # Nobody writes any more, so it ends once all has come; but not where a child process still lives.
        self._taking.join(max(0.0, until - time.monotonic()))
        with self._changed:
            self._over = True
            self._changed.notify()
        self._giving.join(max(0.0, until - time.monotonic()))
        with self._changed:
            self._given_up = True
            lost = self._lost + self._waiting.count(b"\n")
        if self._giving.is_alive():
            return lost  # It may be in the midst of writing; what it holds is left to it.
        # A pipe takes nothing more until the last of what it was given is read.
        if not self._gone and self._takes(max(0.0, until - time.monotonic())):
            for descriptor in self.descriptors:
                os.dup2(self._place, descriptor)
        os.close(self._place)
        return lost

    def _take(self) -> None:
        while data := _read(self._source):
            with self._changed:
                # Once something is left out, all is until a line says so: the gap is where that line stands.
                if self._gone or (self._lost and self._tells) or len(self._waiting) + len(data) > ROOM:
                    self._lost += max(1, data.count(b"\n"))
                else:
                    self._waiting += data
                    self._changed.notify()
        os.close(self._source)

    def _give(self) -> None:
        while True:
            with self._changed:
                if not self._waiting and not self._over:
                    self._changed.wait(LOOK)
                self._tell_lost()
                if self._given_up or (self._over and not self._waiting):
                    return
                piece = bytes(self._waiting[: self._piece])
            # Asked also where nothing waits: that it would take something is the sign that it is there.
            if not self._takes(LOOK):
                continue
            self._taken = time.monotonic()
            self._resize()
            try:
                given = os.write(self._place, piece) if piece else 0
            except BlockingIOError:
                time.sleep(LOOK)
                continue
            except OSError:
                given, self._gone = len(self._waiting), True
            self._taken = time.monotonic()
            with self._changed:
                self._line_open = not piece[:given].endswith(b"\n") if given else self._line_open
                del self._waiting[:given]

    def _takes(self, seconds: float) -> bool:
        """Whether the place takes something within that time."""
        return bool(select.select([], [self._place], [], seconds)[1])

    def _tell_lost(self) -> None:
        """Once all that waited is shown."""
        if self._lost and not self._waiting and not self._gone and self._tells:
            told = "1 line was" if self._lost == 1 else f"{self._lost} lines were"
            self._waiting += ("\n" * self._line_open + f"dream: {told} not shown\n").encode()
            self._lost = 0

    def _resize(self) -> None:
        """Give the pseudo-terminal the size that the terminal has."""
        if not os.isatty(self._place):
            return
        import termios

        with contextlib.suppress(OSError, termios.error):
            size = termios.tcgetwinsize(self._place)
            if size != self._size:
                termios.tcsetwinsize(self._source, size)
                self._size = size


def _pair(place: int) -> tuple[int, int]:
    """Two ends, to read from and to write to: of a pseudo-terminal in a terminal's place, else of a pipe."""
    if os.isatty(place):
        import termios
        import tty

        with contextlib.suppress(OSError):
            source, into = os.openpty()
            # The terminal itself says what becomes of the end of a line.
            tty.setraw(into, termios.TCSANOW)
            return source, into
    return os.pipe()


def _read(source: int) -> bytes:
    """What came; empty where nobody can write any more, which a pseudo-terminal tells by an error."""
    try:
        return os.read(source, 1 << 16)
    except OSError:
        return b""


def _places() -> list[list[int]]:
    """Descriptors of standard output and standard error, those together that lead to the same place."""
    places: dict[tuple[int, int], list[int]] = {}
    for descriptor in (_OUT, _ERR):
        with contextlib.suppress(OSError):  # One may be closed.
            place = os.fstat(descriptor)
            places.setdefault((place.st_dev, place.st_ino), []).append(descriptor)
    return list(places.values())


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
