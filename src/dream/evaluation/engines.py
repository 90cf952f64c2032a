"""Where missions are flown: on the processors of this machine, or on a Ray cluster.

An engine knows nothing of missions. It runs one function on many items and survives workers that die.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Hashable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Generic, Protocol, TypeVar

from dream import extras

T = TypeVar("T")
R = TypeVar("R")
W = TypeVar("W", bound=Hashable)

RETRIES = 2
"""How often an item is tried again after its worker died."""


@dataclass(frozen=True, slots=True)
class Failure:
    """Why an item has no result."""

    message: str


@dataclass(frozen=True, slots=True)
class _Died:
    """Why a worker gave no answer."""

    message: str


class Engine(Protocol):
    """Runs one function on many items."""

    def run(
        self, task: Callable[[T], R], groups: Sequence[Sequence[T]]
    ) -> Generator[tuple[T, R | Failure], None, None]:
        """Yield every item with its result, as each ends.

        An exception of the task is that item's `Failure`. A worker that dies costs its item another try,
        `RETRIES` times at most. When the iterator is closed, all work stops.

        Args:
            task: A function of a module, since workers import it. It may keep what it made for one item
                as long as results do not depend on it.
            groups: The items of a group go to one worker, one after the other, as long as that leaves no
                other worker idle.
        """
        ...


@dataclass(frozen=True, slots=True)
class Processes:
    """Worker processes on this machine."""

    jobs: int | None = None
    """As many as there are processors where None."""

    def __post_init__(self) -> None:
        _check_jobs(self.jobs)

    def run(
        self, task: Callable[[T], R], groups: Sequence[Sequence[T]]
    ) -> Generator[tuple[T, R | Failure], None, None]:
        """See `Engine.run`. Workers stop by themselves when this process is killed."""
        return _drive(_LocalCrew(task), groups, self.jobs or processors())


@dataclass(frozen=True, slots=True)
class Ray:
    """Workers on a Ray cluster, whose nodes have this version of Dream.

    Where missions are recorded, they have the folder of the benchmark; where worlds are saved ones, theirs.
    """

    jobs: int | None = None
    """Workers at most; as many as the cluster has processors where None."""
    address: str | None = None
    """Of the cluster's head, such as `auto` or `10.0.0.1:6379`; Ray's own choice where None: a cluster
    that runs on this machine, else a fresh one. Ray itself presents a token where a cluster wants one."""

    def __post_init__(self) -> None:
        _check_jobs(self.jobs)

    def run(
        self, task: Callable[[T], R], groups: Sequence[Sequence[T]]
    ) -> Generator[tuple[T, R | Failure], None, None]:
        """See `Engine.run`. A Ray session that is running already is used, and left running.

        Raises:
            ValueError: Ray is not installed.
            ConnectionError: There is no cluster at the address.
        """
        check_ray()
        import ray

        joined = ray.is_initialized()
        if not joined:
            ray.init(
                address=self.address, include_dashboard=False, log_to_driver=False, logging_level="error"
            )
        try:
            processors = max(1, int(ray.cluster_resources().get("CPU", 1)))
            yield from _drive(_RayCrew(ray, task), groups, min(self.jobs or processors, processors))
        finally:
            if not joined:
                ray.shutdown()


def processors() -> int:
    """How many processors this process may use."""
    # A container or a job queue may grant fewer than the machine has; not every system tells.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _check_jobs(jobs: int | None) -> None:
    if jobs is not None and jobs < 1:
        raise ValueError(f"--jobs: expected at least 1, got {jobs}")


def check_ray() -> None:
    """Raise a ValueError where Ray is not installed."""
    extras.check_installed("ray", "--engine ray", "ray")


class _Crew(Protocol[W]):
    """Workers that can be hired and can die."""

    def hire(self) -> W: ...
    def give(self, worker: W, item: Any) -> None: ...

    def await_answer(self) -> tuple[W, Any]:
        """The first worker that has an answer or died, and its result, `Failure` or `_Died`."""
        ...

    def dismiss(self, worker: W) -> None: ...
    def close(self) -> None: ...


@dataclass(slots=True)
class _Job(Generic[T]):
    item: T
    group: int
    deaths: int = 0


class _Schedule(Generic[T]):
    """Who does what next: a worker stays with a group while it lasts, begins another, and helps out last."""

    def __init__(self, groups: Sequence[Sequence[T]]) -> None:
        self._waiting = [deque(_Job(item, k) for item in group) for k, group in enumerate(groups)]
        self._begun: set[int] = set()

    def __len__(self) -> int:
        return sum(map(len, self._waiting))

    def take(self, group: int | None) -> _Job[T]:
        """The next item for a worker that did the given group last. Some must be waiting."""
        if group is None or not self._waiting[group]:
            left = [k for k, waiting in enumerate(self._waiting) if waiting]
            fresh = [k for k in left if k not in self._begun]
            group = fresh[0] if fresh else max(left, key=lambda k: len(self._waiting[k]))
        self._begun.add(group)
        return self._waiting[group].popleft()

    def give_back(self, job: _Job[T]) -> None:
        self._waiting[job.group].appendleft(job)


def _drive(crew: _Crew[W], groups: Sequence[Sequence[T]], jobs: int) -> Generator[tuple[T, Any], None, None]:
    """Let a crew of that many workers do all items."""
    schedule = _Schedule(groups)
    at_work: dict[W, _Job[T]] = {}

    def set_to_work(worker: W, last_group: int | None) -> None:
        at_work[worker] = schedule.take(last_group)
        crew.give(worker, at_work[worker].item)

    try:
        for _ in range(min(jobs, len(schedule))):
            set_to_work(crew.hire(), None)
        while at_work:
            worker, answer = crew.await_answer()
            job = at_work.pop(worker)
            if isinstance(answer, _Died):
                crew.dismiss(worker)
                job.deaths += 1
                if job.deaths <= RETRIES:
                    schedule.give_back(job)
                if len(schedule):
                    set_to_work(crew.hire(), None)
                if job.deaths > RETRIES:
                    yield job.item, Failure(f"its worker died {job.deaths} times: {answer.message}")
            else:
                if len(schedule):
                    set_to_work(worker, job.group)
                else:
                    crew.dismiss(worker)
                yield job.item, answer
    finally:
        crew.close()


def _attempt(task: Callable[[Any], Any], item: Any) -> Any:
    try:
        return task(item)
    except Exception as error:  # noqa: BLE001 - whatever an item raises must not cost the others.
        return Failure(f"{type(error).__name__}: {error}")


class _LocalCrew:
    """Spawned processes, each at the other end of a pipe. A pipe that closes is a worker that died."""

    def __init__(self, task: Callable[[Any], Any]) -> None:
        self._task = task
        # Spawned, not forked: forking a process that holds numba's threads is not safe.
        self._context = multiprocessing.get_context("spawn")
        self._processes: dict[Connection, SpawnProcess] = {}
        self._busy: set[Connection] = set()
        self._ready: deque[Connection] = deque()

    def hire(self) -> Connection:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_serve, args=(theirs, self._task), daemon=True)
        process.start()
        theirs.close()
        self._processes[ours] = process
        return ours

    def give(self, worker: Connection, item: Any) -> None:
        self._busy.add(worker)
        # Where it is dead already, its pipe says so when it is waited for.
        with contextlib.suppress(OSError):
            worker.send(item)

    def await_answer(self) -> tuple[Connection, Any]:
        if not self._ready:
            self._ready.extend(c for c in wait(self._busy) if isinstance(c, Connection))
        worker = self._ready.popleft()
        self._busy.remove(worker)
        try:
            return worker, worker.recv()
        except (EOFError, OSError):
            process = self._processes[worker]
            process.join()
            return worker, _Died(_ending(process.exitcode))

    def dismiss(self, worker: Connection) -> None:
        worker.close()

    def close(self) -> None:
        for worker, process in self._processes.items():
            worker.close()
            process.terminate()
        for process in self._processes.values():
            process.join(5.0)
            if process.is_alive():
                process.kill()
                process.join()


def _ending(exitcode: int | None) -> str:
    if exitcode is not None and exitcode < 0:
        return f"killed by {signal.Signals(-exitcode).name}"
    return f"exit status {exitcode}"


def _serve(connection: Connection, task: Callable[[Any], Any]) -> None:
    """The life of a worker process: answer what is asked until nobody is there to ask."""
    # Ctrl-C reaches every process of a terminal; the one that was started decides what becomes of it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Standard output belongs to the answer of the command.
    os.dup2(2, 1)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    while True:
        try:
            item = connection.recv()
        except (EOFError, OSError):
            return
        connection.send(_attempt(task, item))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


class _RayWorker:
    def __init__(self, task: Callable[[Any], Any]) -> None:
        self._task = task

    def attempt(self, item: Any) -> Any:
        return _attempt(self._task, item)


class _RayCrew:
    """Ray actors. Ray tells of one that died instead of its answer."""

    def __init__(self, ray: Any, task: Callable[[Any], Any]) -> None:
        self._ray = ray
        self._task = task
        self._actor = ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(_RayWorker)
        self._hired: list[Any] = []
        self._asked: dict[Any, Any] = {}

    def hire(self) -> Any:
        self._hired.append(self._actor.remote(self._task))
        return self._hired[-1]

    def give(self, worker: Any, item: Any) -> None:
        self._asked[worker.attempt.remote(item)] = worker

    def await_answer(self) -> tuple[Any, Any]:
        (answer,), _ = self._ray.wait(list(self._asked), num_returns=1)
        worker = self._asked.pop(answer)
        try:
            return worker, self._ray.get(answer)
        except self._ray.exceptions.RayError as error:
            return worker, _Died(str(error).strip().splitlines()[0])

    def dismiss(self, worker: Any) -> None:
        self._hired.remove(worker)
        self._ray.kill(worker)

    def close(self) -> None:
        for worker in list(self._hired):
            self.dismiss(worker)
