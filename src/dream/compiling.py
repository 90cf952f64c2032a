"""When numba compiles: in the first run on a machine, and after a change; then it loads what it kept."""

from __future__ import annotations

import contextlib
import gc
import threading
import time
from collections.abc import Callable, Iterator

from numba.core.event import Event, Listener, TimingListener, install_listener, register

COMPILES = "numba:compile"
"""The event that numba sends around each compilation; loading what was compiled before is none."""

_compiled = TimingListener()  # type: ignore[no-untyped-call]
register(COMPILES, _compiled)  # type: ignore[no-untyped-call]


def working_time() -> float:
    """Seconds on a clock that stands still while numba compiles."""
    return time.perf_counter() - (_compiled.duration if _compiled.done else 0.0)


def thread_time() -> float:
    """Processor seconds of this thread, on a clock that stands still while numba compiles in it."""
    return time.thread_time() - _spent.in_this_thread()


@contextlib.contextmanager
def when_compiling(tell: Callable[[], None]) -> Iterator[None]:
    """Call `tell` before the first compilation within the block, if there is one."""
    with install_listener(COMPILES, _Once(tell)):
        yield


class _Uncollected(Listener):
    """Keeps the garbage collector out of what a compilation makes, which took a tenth of its time."""

    def __init__(self) -> None:
        # Functions are compiled within others, in one thread at a time.
        self._depth = 0
        self._was_enabled = False

    def on_start(self, event: Event) -> None:
        if self._depth == 0:
            self._was_enabled = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: Event) -> None:
        self._depth -= 1
        if self._depth == 0 and self._was_enabled:
            gc.enable()


register(COMPILES, _Uncollected())  # type: ignore[no-untyped-call]


class _Spent(Listener):
    """Processor time that each thread has spent on compiling."""

    def __init__(self) -> None:
        self._of = threading.local()

    def in_this_thread(self) -> float:
        return getattr(self._of, "spent", 0.0)

    def on_start(self, event: Event) -> None:
        self._of.depth = getattr(self._of, "depth", 0) + 1
        if self._of.depth == 1:
            self._of.began = time.thread_time()

    def on_end(self, event: Event) -> None:
        self._of.depth -= 1
        if self._of.depth == 0:
            self._of.spent = self.in_this_thread() + time.thread_time() - self._of.began


_spent = _Spent()
register(COMPILES, _spent)  # type: ignore[no-untyped-call]


class _Once(Listener):
    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell: Callable[[], None] | None = tell

    def on_start(self, event: Event) -> None:
        if self._tell is not None:
            tell, self._tell = self._tell, None
            tell()

    def on_end(self, event: Event) -> None:
        pass


@contextlib.contextmanager
def noted(note: Callable[[bool], None]) -> Iterator[None]:
    """Call `note` with whether something is compiled, whenever that changes within the block."""
    with install_listener(COMPILES, _Noted(note)):
        yield


class _Noted(Listener):
    def __init__(self, note: Callable[[bool], None]) -> None:
        self._note = note
        self._depth = 0

    def on_start(self, event: Event) -> None:
        self._depth += 1
        if self._depth == 1:
            self._note(True)

    def on_end(self, event: Event) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._note(False)
