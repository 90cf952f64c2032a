"""Many threads on one simulated clock, one at a time: the same dive every time, and no waiting."""

from __future__ import annotations

import heapq
import itertools
import math
import threading
from collections import deque
from collections.abc import Callable

from dream.robots.bluerov2.threads import Condition, Event, Lock, Thread


class Stuck(RuntimeError):  # noqa: N818 - it names what is.
    """All threads wait for each other, and none for a time: the clock can never go on."""


class LockStep:
    """Takes the place of real time for all that waits by `threads.Threads`.

    What it does: of all threads that were begun here, with the one that made it, one runs at a time.
    It runs until it waits: for a time, an event, a lock or another thread. Then the one that was woken first
    goes on; where none was woken, the clock jumps to the next time that somebody waits for, and that one goes
    on. Computing takes no time. So a dive takes the same course whatever the computer does, and hours of
    waiting take none.

    Assumes: what is waited for comes from one of these threads. One that waits by other means stops them all.
    """

    def __init__(self, now: float = 0.0) -> None:
        """The thread that calls this is the first."""
        self._now = now
        self._count = itertools.count()
        self._ready: deque[_Task] = deque()
        self._asleep: list[tuple[float, int, _Task, int]] = []
        self._first = self._running = _Task(self, "first")
        self._tasks = {threading.get_ident(): self._first}

    def __call__(self) -> float:
        """Seconds on the clock."""
        return self._now

    # As `threads.Threads` says.

    def monotonic(self) -> float:
        """Seconds on the clock."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """Wait until the clock is so much further."""
        self.block(self._now + max(seconds, 0.0))

    def lock(self) -> Lock:
        """A new one."""
        return _Lock(self)

    def event(self) -> Event:
        """A new one."""
        return _Event(self)

    def condition(self) -> Condition:
        """A new one."""
        return _Condition(self)

    def start(self, work: Callable[[], object], name: str) -> Thread:
        """Begin a thread; it runs once whoever calls this waits."""
        task = _Task(self, name)

        def run() -> None:
            self._tasks[threading.get_ident()] = task
            task.gate.acquire()
            try:
                work()
            finally:
                task.over = True
                del self._tasks[threading.get_ident()]
                self.wake(task.joining)
                self._hand_on()

        threading.Thread(target=run, name=name, daemon=True).start()
        self._ready.append(task)
        return task

    # What the above is made of

    def interrupt(self, error: type[BaseException] = KeyboardInterrupt) -> None:
        """Have the first thread meet an exception where it waits, as Ctrl-C does."""
        self._first.error = error
        if self._first is not self._running:
            self.wake([self._first])

    @property
    def running(self) -> _Task:
        """Whoever calls."""
        return self._tasks[threading.get_ident()]

    def block(self, until: float = math.inf, queue: list[_Task] | None = None) -> bool:
        """Wait until a time, or to be woken out of a queue; was it woken?

        Raises:
            Stuck: Nobody is left who could go on.
        """
        task = self.running
        task.ticket += 1
        task.woken = False
        if until < math.inf:
            heapq.heappush(self._asleep, (until, next(self._count), task, task.ticket))
        if queue is not None:
            queue.append(task)
        if self._hand_on() is not task:
            task.gate.acquire()
        self._running = task
        if queue is not None and task in queue:
            queue.remove(task)
        if task.error is not None:
            error, task.error = task.error, None
            raise error()
        return task.woken

    def wake(self, queue: list[_Task]) -> None:
        """Let all of a queue go on, in turn."""
        for task in queue:
            task.woken = True
            task.ticket += 1
            self._ready.append(task)
        queue.clear()

    def _hand_on(self) -> _Task:
        """Let the next one run, and return it."""
        task = self._next()
        if threading.get_ident() not in self._tasks or task is not self.running:
            task.gate.release()
        return task

    def _next(self) -> _Task:
        if self._ready:
            return self._ready.popleft()
        while self._asleep:
            due, _, task, ticket = heapq.heappop(self._asleep)
            if ticket == task.ticket:
                task.ticket += 1
                self._now = max(self._now, due)
                return task
        self._first.error = Stuck
        return self._first


class _Task:
    """One thread."""

    def __init__(self, clock: LockStep, name: str) -> None:
        self.name = name
        self.gate = threading.Semaphore(0)
        self.ticket = 0
        """Changes whenever what it waited for is no more: what the clock holds of it then means nothing."""
        self.woken = self.over = False
        self.error: type[BaseException] | None = None
        self.joining: list[_Task] = []
        self._clock = clock

    def join(self, timeout: float | None = None) -> None:
        """Wait for its end."""
        if not self.over:
            self._clock.block(_until(self._clock, timeout), self.joining)

    def is_alive(self) -> bool:
        """Does it still run?"""
        return not self.over


class _Lock:
    def __init__(self, clock: LockStep) -> None:
        self._clock = clock
        self._owner: _Task | None = None
        self._depth = 0
        self._waiting: list[_Task] = []

    def __enter__(self) -> _Lock:
        self.take(1)
        return self

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.let_go()

    def take(self, depth: int) -> None:
        """Be the owner, so many times more."""
        me = self._clock.running
        while self._owner is not None and self._owner is not me:
            self._clock.block(queue=self._waiting)
        self._owner = me
        self._depth += depth

    def let_go(self) -> int:
        """Be no more; how many times was it?"""
        depth, self._depth, self._owner = self._depth, 0, None
        self._clock.wake(self._waiting)
        return depth


class _Event:
    def __init__(self, clock: LockStep) -> None:
        self._clock, self._set = clock, False
        self._waiting: list[_Task] = []

    def set(self) -> None:
        self._set = True
        self._clock.wake(self._waiting)

    def clear(self) -> None:
        self._set = False

    def is_set(self) -> bool:
        return self._set

    def wait(self, timeout: float | None = None) -> bool:
        if not self._set:
            self._clock.block(_until(self._clock, timeout), self._waiting)
        return self._set


class _Condition:
    def __init__(self, clock: LockStep) -> None:
        self._clock, self._lock = clock, _Lock(clock)
        self._waiting: list[_Task] = []

    def __enter__(self) -> _Condition:
        self._lock.take(1)
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.__exit__(None, None, None)

    def wait(self, timeout: float | None = None) -> bool:
        depth = self._lock.let_go()
        try:
            return self._clock.block(_until(self._clock, timeout), self._waiting)
        finally:
            self._lock.take(depth)

    def wait_for(self, predicate: Callable[[], bool], timeout: float | None = None) -> bool:
        end = _until(self._clock, timeout)
        while not predicate() and self._clock() < end:
            self.wait(end - self._clock())
        return predicate()

    def notify_all(self) -> None:
        self._clock.wake(self._waiting)


def _until(clock: LockStep, timeout: float | None) -> float:
    return math.inf if timeout is None else clock() + max(timeout, 0.0)
