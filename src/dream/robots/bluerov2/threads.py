"""How threads begin, wait and lock: by real time, or by a clock that goes on only while all of them wait."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Protocol


class Lock(Protocol):
    """Held by one thread at a time, which may take it again."""

    def __enter__(self) -> object: ...
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None: ...


class Event(Protocol):
    """As `threading.Event`."""

    def set(self) -> None: ...  # noqa: D102
    def clear(self) -> None: ...  # noqa: D102
    def is_set(self) -> bool: ...  # noqa: D102
    def wait(self, timeout: float | None = None) -> bool: ...  # noqa: D102


class Condition(Protocol):
    """As `threading.Condition`, on a reentrant lock of its own."""

    def __enter__(self) -> object: ...
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None: ...
    def wait(self, timeout: float | None = None) -> bool: ...  # noqa: D102
    def wait_for(self, predicate: Callable[[], bool], timeout: float | None = None) -> bool: ...  # noqa: D102
    def notify_all(self) -> None: ...  # noqa: D102


class Thread(Protocol):
    """As `threading.Thread`, running."""

    def join(self, timeout: float | None = None) -> None: ...  # noqa: D102
    def is_alive(self) -> bool: ...  # noqa: D102


class Threads(Protocol):
    """What all threads of a dive begin and wait by.

    A part of a dive that waits does so by these alone, so that a rig can put the whole dive on a clock of its
    own (`standin.lockstep`).
    """

    def monotonic(self) -> float:
        """Seconds, for time-outs."""

    def sleep(self, seconds: float) -> None:
        """Wait so long."""

    def lock(self) -> Lock:
        """A new one."""

    def event(self) -> Event:
        """A new one."""

    def condition(self) -> Condition:
        """A new one."""

    def start(self, work: Callable[[], object], name: str) -> Thread:
        """Begin to work on a thread of its own, which ends with the program at the latest."""


class _RealTime:
    """Python's own."""

    def monotonic(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)

    def lock(self) -> Lock:
        return threading.RLock()

    def event(self) -> Event:
        return threading.Event()

    def condition(self) -> Condition:
        return threading.Condition()

    def start(self, work: Callable[[], object], name: str) -> Thread:
        thread = threading.Thread(target=work, name=name, daemon=True)
        thread.start()
        return thread


REAL_TIME: Threads = _RealTime()
