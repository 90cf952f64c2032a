"""What every engine must do, and how the local one hands out work."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from dream.evaluation.engines import RETRIES, Engine, Failure, Processes, Ray, _Schedule
from dream.extras import missing


@dataclass(frozen=True)
class Errand:
    """Something to do that leaves a mark each time it is tried."""

    name: str
    marks: Path
    deaths: int = 0
    """How often its worker dies first."""
    raises: bool = False
    seconds: float = 0.0
    """How long it takes."""


def run_errand(errand: Errand) -> str:
    number = len(list(errand.marks.glob(f"{errand.name}-*")))
    (errand.marks / f"{errand.name}-{number}").touch()
    if number < errand.deaths:
        os.kill(os.getpid(), signal.SIGKILL)
    if errand.raises:
        raise RuntimeError(f"{errand.name} burnt")
    time.sleep(errand.seconds)
    return errand.name.upper()


@pytest.fixture(
    scope="module", params=["process", pytest.param("ray", marks=pytest.mark.slow)], name="engine"
)
def each_engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    if request.param == "process":
        yield Processes(2)
        return
    ray = pytest.importorskip("ray")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="error")
    yield Ray(2)
    assert ray.is_initialized(), "a session that was running already is left running"
    ray.shutdown()


def test_every_item_ends_once_whatever_befalls_the_others(engine: Engine, tmp_path: Path) -> None:
    groups = [
        [Errand("a", tmp_path), Errand("dies-once", tmp_path, deaths=1), Errand("b", tmp_path)],
        [Errand("dies-always", tmp_path, deaths=99), Errand("c", tmp_path)],
        [Errand("burns", tmp_path, raises=True), Errand("dies-twice", tmp_path, deaths=2)],
        [],
    ]
    ended = list(engine.run(run_errand, groups))
    results = {errand.name: result for errand, result in ended}
    assert sorted(errand.name for errand, _ in ended) == sorted(e.name for g in groups for e in g)
    good = ("a", "b", "c", "dies-once", "dies-twice")
    assert {name: results[name] for name in good} == {name: name.upper() for name in good}
    assert results["burns"] == Failure("RuntimeError: burns burnt")
    lost = results["dies-always"]
    assert isinstance(lost, Failure)
    assert lost.message.startswith(f"its worker died {RETRIES + 1} times: ")

    def tries(name: str) -> int:
        return len(list(tmp_path.glob(f"{name}-*")))

    assert tries("dies-always") == RETRIES + 1
    assert (tries("dies-once"), tries("dies-twice")) == (2, 3)
    assert [tries(name) for name in ("a", "b", "c", "burns")] == [1, 1, 1, 1], "done once, not again"


def test_no_items_need_no_workers(engine: Engine) -> None:
    assert list(engine.run(run_errand, [])) == []


def test_a_dead_local_worker_is_explained(tmp_path: Path) -> None:
    ((_, result),) = Processes(1).run(run_errand, [[Errand("x", tmp_path, deaths=99)]])
    assert result == Failure(f"its worker died {RETRIES + 1} times: killed by SIGKILL")


def test_closing_stops_the_workers(tmp_path: Path) -> None:
    short, long = Errand("short", tmp_path), Errand("long", tmp_path, seconds=600.0)
    with contextlib.closing(Processes(2).run(run_errand, [[short], [long]])) as ended:
        assert next(ended) == (short, "SHORT")
        began = time.monotonic()
    assert time.monotonic() - began < 5.0
    assert multiprocessing.active_children() == []


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs /proc to see the workers")
def test_workers_end_with_the_process_that_hired_them(tmp_path: Path) -> None:
    script = (
        "import sys, pathlib; from dream.evaluation.engines import Processes; "
        "from tests.evaluation.test_engines import Errand, run_errand; "
        "list(Processes(1).run(run_errand, [[Errand('long', pathlib.Path(sys.argv[1]), seconds=600.0)]]))"
    )
    boss = subprocess.Popen([sys.executable, "-c", script, str(tmp_path)], cwd=Path(__file__).parents[2])
    deadline = time.monotonic() + 60
    while not list(tmp_path.iterdir()):
        assert boss.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    workers = [int(pid) for pid in Path(f"/proc/{boss.pid}/task/{boss.pid}/children").read_text().split()]
    assert any(map(is_running, workers))
    boss.kill()
    boss.wait()
    deadline = time.monotonic() + 10
    while any(map(is_running, workers)):
        assert time.monotonic() < deadline, "a worker goes on, for nobody"
        time.sleep(0.01)


def test_a_worker_stays_with_its_group_then_begins_another_then_helps() -> None:
    schedule = _Schedule([["a1", "a2", "a3", "a4"], ["b1"], ["c1"]])
    first, second = schedule.take(None), schedule.take(None)
    assert (first.item, second.item) == ("a1", "b1")
    assert schedule.take(first.group).item == "a2", "the world is made already"
    assert schedule.take(second.group).item == "c1", "a fresh group before somebody else's"
    assert schedule.take(second.group).item == "a3", "nobody idles while items wait"
    schedule.give_back(first)
    assert [schedule.take(0).item, schedule.take(0).item] == ["a1", "a4"]
    assert len(schedule) == 0


@pytest.mark.parametrize("kind", [Processes, Ray])
def test_less_than_one_job_is_refused(kind: type[Processes] | type[Ray]) -> None:
    with pytest.raises(ValueError, match="--jobs: expected at least 1, got 0"):
        kind(0)


def test_ray_that_is_not_installed_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ValueError, match=re.escape(missing("ray", "ray", "--engine ray"))):
        list(Ray().run(str, [[1]]))
