"""A benchmark goes on where it was, whatever interrupted it, and its numbers depend on nothing else."""

from __future__ import annotations

import csv
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.cli import run_command
from dream.control.health import Watch
from dream.course import Pilot
from dream.evaluation import machine, runner
from dream.evaluation.engines import Engine, Failure, Processes
from dream.evaluation.metrics import curve
from dream.evaluation.results import TIMES, Flown, MissionKey, mission_path, read_manifest, read_results
from dream.evaluation.runner import Ended, Flight, Plan, fly, fly_mission, fly_plan
from dream.evaluation.suites import SUITES, Case
from dream.planning import Lawnmower, RandomWalk
from dream.protocol import DREAM_V1, DREAM_V1_NAV, POOL_V1, protocol_named, reach_variant
from dream.recording import read_config, read_steps, read_summary
from dream.robots import Motion, Swimming
from dream.robots.swimming import read_swimming
from dream.sim.render import Renderer
from dream.sim.sensors import DVL_A50
from dream.sim.worlds import make_world
from dream.types import Mission

STEPS = 4
FLAT = tuple(Case("flat/empty", seed) for seed in (1, 2, 3))
PLANNERS: dict[str, Any] = {"random": RandomWalk(), "lawnmower": Lawnmower()}


@dataclass(slots=True)
class Here:
    """Flies in this process, the last group first where told to, and remembers what it flew."""

    backwards: bool = False
    flown: list[MissionKey] | None = None
    stop_after: int = 1000
    """Missions before Ctrl-C."""

    def run(
        self, task: Callable[[Any], Any], groups: Sequence[Sequence[Any]]
    ) -> Generator[tuple[Any, Any], None, None]:
        flights = [flight for group in groups for flight in group]
        for number, flight in enumerate(reversed(flights) if self.backwards else flights):
            if number == self.stop_after:
                raise KeyboardInterrupt
            if self.flown is not None:
                self.flown.append(flight.key)
            yield flight, task(flight)


@dataclass(frozen=True, slots=True)
class Deadly:
    """A planner that takes its worker with it."""

    def begin(self, mission: Mission) -> Pilot:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError


@dataclass(frozen=True, slots=True)
class Broken:
    """A planner that raises."""

    def begin(self, mission: Mission) -> Pilot:
        raise RuntimeError("the planner burnt")


def plan(cases: Sequence[Case] = FLAT, **changes: Any) -> Plan:
    values: dict[str, Any] = {"suite": "flat", "planners": PLANNERS, "protocol": DREAM_V1, "max_steps": STEPS}
    return Plan(**({"cases": tuple(cases)} | values | changes))


def bench(plan: Plan, folder: Path, engine: Engine | None = None) -> list[Ended]:
    return list(fly_plan(plan, folder, engine or Here()))


def without_times(folder: Path) -> list[dict[str, str]]:
    with (folder / "results.csv").open(newline="") as file:
        return [{k: v for k, v in row.items() if k not in TIMES} for row in csv.DictReader(file)]


def files_of(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in (folder / "missions").glob("*.json")}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A benchmark of one world with a reef and one without, flown in this process."""
    folder = tmp_path_factory.mktemp("flown")
    bench(plan((Case("reef/L", 1), FLAT[0])), folder)
    return folder


def test_results_do_not_depend_on_workers_or_order(flown: Path, tmp_path: Path) -> None:
    cases = (FLAT[0], Case("reef/L", 1))
    flipped = dict(reversed(PLANNERS.items()))
    engines: dict[str, Engine] = {"two": Processes(2), "back": Here(backwards=True)}
    for name, engine in engines.items():
        ended = bench(plan(cases, planners=flipped), tmp_path / name, engine)
        assert len(ended) == 4
        assert without_times(tmp_path / name) == without_times(flown)
        assert (tmp_path / name / "traces.csv.gz").read_bytes() == (flown / "traces.csv.gz").read_bytes()


def test_all_planners_start_alike_in_the_same_worlds(flown: Path) -> None:
    results = read_results(flown)
    assert [(row.world, row.planner) for row in results.rows] == [
        *(("reef/L", "lawnmower"), ("reef/L", "random")),
        *(("flat/empty", "lawnmower"), ("flat/empty", "random")),
    ]
    for one, other in (results.rows[:2], results.rows[2:]):
        a, b = results.traces[one.key], results.traces[other.key]
        assert (a.x[0], a.y[0], a.yaw_deg[0]) == (b.x[0], b.y[0], b.yaw_deg[0])
        assert (one.world_hash, one.countable) == (other.world_hash, other.countable)


def test_a_row_says_what_its_trace_says(flown: Path) -> None:
    results = read_results(flown)
    for row in results.rows:
        trace = results.traces[row.key]
        assert row.steps == STEPS == len(trace) - 1
        assert row.instances == trace.instances[-1] == row.c50 == row.c200
        assert row.collisions == trace.collided.sum()
        assert math.isclose(row.distance_m, np.hypot(np.diff(trace.x), np.diff(trace.y)).sum(), abs_tol=0.01)
        assert (np.diff(trace.instances) >= 0).all()
        held = [*trace.instances[1:], *[trace.instances[-1]] * (200 - STEPS)]
        assert math.isclose(row.auc, np.mean(held), abs_tol=2e-6)


def test_the_curve_holds_what_a_mission_ended_with() -> None:
    ramp = [step / 160 for step in range(121)]
    found = curve(ramp, 200)
    assert found == {
        "c50": 0.3125,
        "c100": 0.625,
        "c137": 0.75,
        "c200": 0.75,
        "auc": round((sum(ramp) + 80 * 0.75) / 200, 6),
    }
    assert curve([0.25], 200) == {**dict.fromkeys(("c50", "c100", "c137", "c200"), 0.25), "auc": 0.25}
    assert curve([0.0] * 201 + [1.0] * 50, 200)["auc"] == 0.0, "the cap ends the mean"


@pytest.mark.rare
@pytest.mark.parametrize("protocol", ["dream-v1", "dream-v1-noisy"])
def test_a_world_that_is_used_again_gives_the_same_mission(
    protocol: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []
    renderer = Renderer

    def counting(world: Any) -> Any:
        made.append(world.name)
        return renderer(world)

    monkeypatch.setattr(runner, "Renderer", counting)
    flights = [Flight(Case("reef/L", 2, start), "random", RandomWalk(), protocol, 3) for start in (0, 1, 0)]
    runner._stage.cache_clear()
    shared = [fly(flight) for flight in flights]
    assert made == ["reef/L"], "one renderer for three missions"
    runner._stage.cache_clear()
    fresh = fly(flights[2])
    rows = [replace(f.row, planner_ms_p50=0, planner_ms_p99=0, wall_s=0) for f in (*shared, fresh)]
    assert rows[0] == rows[2] == rows[3]
    assert rows[0] != replace(rows[1], start=0)


def test_ctrl_c_keeps_what_was_flown_and_the_rest_follows(tmp_path: Path) -> None:
    first: list[MissionKey] = []
    with pytest.raises(KeyboardInterrupt):
        bench(plan(), tmp_path, Here(flown=first, stop_after=2))
    assert len(read_results(tmp_path).rows) == 2
    assert read_manifest(tmp_path)["finished"] is None
    before = files_of(tmp_path)
    second: list[MissionKey] = []
    ended = bench(plan(), tmp_path, Here(flown=second))
    assert sorted(first + second) == sorted({e.key for e in ended})
    assert [e.kept for e in ended] == [True] * 2 + [False] * 4
    assert {name: files_of(tmp_path)[name] for name in before} == before, "kept files are not touched"
    assert read_manifest(tmp_path)["finished"]
    third: list[MissionKey] = []
    assert all(e.kept for e in bench(plan(), tmp_path, Here(flown=third)))
    assert third == []


def test_kill_9_loses_and_repeats_nothing(tmp_path: Path) -> None:
    command = ["bench", "--world", "flat/empty", "--seeds", "1..6", "--planners", "random", "lawnmower"]
    command += ["--protocol", "dream-v1", "--max-steps", "9", "--jobs", "1", "--out", str(tmp_path)]
    running = subprocess.Popen([sys.executable, "-m", "dream.cli", *command], stderr=subprocess.PIPE)
    deadline = time.monotonic() + 60
    while len(files_of(tmp_path)) < 3:
        assert running.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    running.kill()
    running.communicate()
    before = files_of(tmp_path)
    assert 3 <= len(before) < 12
    again: list[MissionKey] = []
    cases = [Case("flat/empty", seed) for seed in range(1, 7)]
    ended = bench(plan(cases, suite="flat/empty 1..6", max_steps=9), tmp_path, Here(flown=again))
    assert len(again) == len(set(again)) == 12 - len(before)
    assert sum(e.kept for e in ended) == len(before)
    after = files_of(tmp_path)
    assert {name: after[name] for name in before} == before, "no mission was written again"
    assert len(after) == len(read_results(tmp_path).rows) == 12


@pytest.mark.rare
def test_planners_and_worlds_may_join_later(tmp_path: Path) -> None:
    once, twice = tmp_path / "once", tmp_path / "twice"
    bench(plan(), once)
    bench(plan(FLAT[:2], planners={"lawnmower": Lawnmower()}, suite="first"), twice)
    bench(plan(FLAT[2:], planners={"random": RandomWalk()}), twice)
    assert [(row.seed, row.planner) for row in read_results(twice).rows] == [
        *((1, "lawnmower"), (2, "lawnmower"), (3, "random"))
    ]
    again: list[MissionKey] = []
    bench(plan(), twice, Here(flown=again))
    assert len(again) == 3
    assert without_times(twice) == without_times(once)
    assert (twice / "traces.csv.gz").read_bytes() == (once / "traces.csv.gz").read_bytes()
    assert read_manifest(twice)["suite"] == "first, flat"
    assert read_manifest(twice)["cases"] == read_manifest(once)["cases"]


def better(content: bytes) -> bytes:
    """A mission whose row was made to look better than its trace."""
    mission = json.loads(content)
    mission["row"]["instances"] = 0.999
    return json.dumps(mission).encode()


@pytest.mark.parametrize("damage", [lambda content: content[:-40], better], ids=["torn", "better"])
def test_a_damaged_mission_is_named_and_flown_again(
    damage: Callable[[bytes], bytes], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    keys = [ended.key for ended in bench(plan(FLAT[:1]), tmp_path)]
    good = without_times(tmp_path)
    path = mission_path(tmp_path, keys[1])
    path.write_bytes(damage(path.read_bytes()))
    again: list[MissionKey] = []
    bench(plan(FLAT[:1]), tmp_path, Here(flown=again))
    assert again == [keys[1]]
    assert str(path) in caplog.text
    assert without_times(tmp_path) == good


@pytest.mark.parametrize(
    ("path", "other", "complaint"),
    [
        (("version",), "0.0.9", r"version: expected 0\.0\.9 as for the missions in it, got "),
        (("source",), "0" * 64, "source: expected 0{64} "),
        (("numpy",), "1.0", r"numpy: expected 1\.0 as for the missions in it, got "),
        (("protocol", "reach"), 4.0, r"protocol\.reach: expected 4\.0 as for the missions in it, got 8\.0"),
        (("protocol", "camera", "width"), 99, r"protocol\.camera\.width: expected 99 .* got 320"),
        (("max_steps",), None, f"max_steps: expected None .* got {STEPS}"),
        (("planners", "random", "walk_seed"), 9, r"random\.walk_seed: expected 9 .* got 0"),
    ],
)
def test_missions_of_another_make_are_refused(
    path: tuple[str, ...], other: Any, complaint: str, flown: Path, tmp_path: Path
) -> None:
    manifest = json.loads((flown / "manifest.json").read_text())
    place = manifest
    for name in path[:-1]:
        place = place[name]
    place[path[-1]] = other
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    untouched = (tmp_path / "manifest.json").read_bytes()
    with pytest.raises(ValueError, match=complaint) as caught:
        bench(plan(), tmp_path)
    assert str(caught.value).startswith(f"{tmp_path}: ")
    assert str(caught.value).endswith("Choose another --out")
    assert (tmp_path / "manifest.json").read_bytes() == untouched
    assert not (tmp_path / "missions").exists(), "nothing was flown"


def test_another_commit_with_the_same_code_goes_on(flown: Path, tmp_path: Path) -> None:
    folder = tmp_path / "bench"
    shutil.copytree(flown, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "commit": "abc"}))
    again: list[MissionKey] = []
    bench(plan((Case("reef/L", 1), FLAT[0])), folder, Here(flown=again))
    assert again == []


def test_missions_of_unknown_make_are_refused(tmp_path: Path) -> None:
    (tmp_path / "missions").mkdir()
    with pytest.raises(ValueError, match=r"expected a manifest\.json"):
        bench(plan(), tmp_path)


def test_two_benchmarks_do_not_share_a_folder(tmp_path: Path) -> None:
    first = fly_plan(plan(FLAT[:1]), tmp_path, Here())
    next(first)
    with pytest.raises(ValueError, match="expected that no other process writes here"):
        bench(plan(FLAT[:1]), tmp_path)
    first.close()
    assert len(bench(plan(FLAT[:1]), tmp_path)) == 2


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"cases": ()}, "cases: expected at least one world"),
        ({"cases": (FLAT[0], FLAT[0])}, "cases: expected each once"),
        ({"planners": {}}, "planners: expected one or more of"),
        ({"max_steps": 0}, "--max-steps: expected 1 to 200, the cap of dream-v1, got 0"),
        ({"max_steps": 201}, "--max-steps: expected 1 to 200, the cap of dream-v1, got 201"),
    ],
)
def test_a_plan_that_flies_nothing_is_refused(changes: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        plan(**changes)


LINE = Broken.begin.__code__.co_firstlineno + 1
BURNT = f"test_runner.py, line {LINE}: begin: RuntimeError: the planner burnt"


@pytest.fixture(scope="module")
def failing(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Ended]]:
    """A benchmark of which only one mission in three ends, and how each of them did."""
    folder = tmp_path_factory.mktemp("failing")
    planners = {"deadly": Deadly(), "broken": Broken(), "random": RandomWalk()}
    return folder, bench(plan(FLAT[:1], planners=planners), folder, Processes(2))


@pytest.mark.rare
def test_a_mission_that_fails_costs_only_itself(failing: tuple[Path, list[Ended]]) -> None:
    folder, ended = failing
    outcomes = {e.key[-1]: e.outcome for e in ended}
    assert outcomes["deadly"] == Failure("its worker died 3 times: killed by SIGKILL")
    broken = outcomes["broken"]
    assert isinstance(broken, Failure)
    assert broken.message.endswith(BURNT)
    assert isinstance(outcomes["random"], Flown)
    assert [row.planner for row in read_results(folder).rows] == ["random"]
    assert read_manifest(folder)["finished"] is None


@pytest.mark.rare
@pytest.mark.parametrize("keep_runs", [False, True])
def test_a_mission_whose_vehicle_is_lost_is_scored_by_what_it_had_seen(
    keep_runs: bool, tmp_path: Path
) -> None:
    # No velocity ever, and some patience: a few moves are flown before it has to surface.
    watch = Watch(velocity_sigma=5.0, position_sigma=20.0)
    lost = Swimming(Motion(dvl=replace(DVL_A50, dropout=1.0), watch=watch))
    case, planners = Case("reef/L", 1), {"random": RandomWalk()}
    changes: dict[str, Any] = {"max_steps": None, "keep_runs": keep_runs, "swimming": lost}
    chosen = plan((case,), protocol=DREAM_V1_NAV, planners=planners, **changes)
    (ended,) = bench(chosen, tmp_path)
    assert isinstance(ended.outcome, Flown)
    row = ended.outcome.row
    assert (row.ended, row.success, row.t_stop) == ("aborted", False, None)
    assert 0 < row.steps < 50
    assert row.instances == ended.outcome.trace.instances[-1] > 0.0
    assert read_results(tmp_path).rows == (row,)
    assert read_manifest(tmp_path)["failed"] == []
    assert read_manifest(tmp_path)["finished"] is not None
    # All of what swam is told, and another vehicle does not join it.
    assert read_swimming(read_manifest(tmp_path)["swimming"]) == lost
    with pytest.raises(ValueError, match=r"swimming\.motion\.current: expected 0\.1"):
        bench(replace(chosen, swimming=Swimming(replace(lost.motion, current=0.3))), tmp_path)
    # Nothing is flown twice.
    (again,) = bench(chosen, tmp_path)
    assert again.kept
    if keep_runs:
        (run,) = (tmp_path / "runs").iterdir()
        summary = read_summary(run)
        assert summary is not None
        assert (summary.ended, summary.steps) == ("aborted", row.steps)
        assert (run / "report.html").exists()


@pytest.mark.rare
def test_a_folder_is_finished_when_nothing_of_it_is_missing(
    failing: tuple[Path, list[Ended]], tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(failing[0], tmp_path / "bench"))
    told = read_manifest(folder)
    assert told["finished"] is None
    failed = sorted(told["failed"], key=lambda one: str(one["planner"]))
    assert [one.pop("planner") for one in failed] == ["broken", "deadly"]
    errors = [one.pop("error") for one in failed]
    assert errors[0].endswith(BURNT)
    assert errors[1] == "its worker died 3 times: killed by SIGKILL"
    assert failed == 2 * [FLAT[0].as_dict()]
    bench(plan(FLAT[:1], planners={"random": PLANNERS["random"]}), folder)
    assert read_manifest(folder)["finished"] is None, "the other planners' missions are still missing"


def test_every_machine_that_flew_is_told(
    flown: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "bench"
    shutil.copytree(flown, folder)
    first = read_manifest(folder)
    assert first["later"] == []
    monkeypatch.setattr(machine, "machine", lambda: {"cpu": "another"})
    for _ in range(2):
        bench(plan((Case("reef/L", 1), FLAT[0])), folder)
        told = read_manifest(folder)
        assert told["machine"] == first["machine"]
        assert [entry["machine"] for entry in told["later"]] == [{"cpu": "another"}]


def test_a_worker_with_other_code_flies_nothing() -> None:
    flight = Flight(FLAT[0], "random", RandomWalk(), "dream-v1", 1, source="0" * 64)
    with pytest.raises(ValueError, match=r"source: expected the code 000000000000 .* another version"):
        fly(flight)


def test_a_mission_can_be_kept_as_a_run(tmp_path: Path) -> None:
    only = {"random": RandomWalk()}
    bench(plan(FLAT[:1], planners=only, keep_runs=True), tmp_path)
    (folder,) = (tmp_path / "runs").iterdir()
    results = read_results(tmp_path)
    (trace,) = results.traces.values()
    assert [step.pose.x for step in read_steps(folder)] == pytest.approx(trace.x.tolist(), abs=1e-3)
    config = read_config(folder)
    assert config.max_steps == STEPS
    assert config.began is not None
    assert abs(datetime.now(UTC) - config.began) < timedelta(hours=1)
    summary = read_summary(folder)
    assert summary is not None
    assert (summary.steps, summary.world_hash) == (STEPS, results.rows[0].world_hash)
    assert (folder / "report.html").stat().st_size > 10_000
    (mission,) = (tmp_path / "missions").glob("*.json")
    mission.unlink()
    bench(plan(FLAT[:1], planners=only, keep_runs=True), tmp_path)
    assert len(read_steps(folder)) == STEPS + 1, "a second try takes the place of the first"


def test_a_world_in_hand_is_flown_and_scored_as_in_a_benchmark(tmp_path: Path) -> None:
    in_benchmark = fly(Flight(Case("reef/string", 1), "lawnmower", Lawnmower(), "dream-v1", max_steps=5))
    world = make_world("reef/string", 1)
    in_hand = fly_mission(world, Lawnmower(), max_steps=5, record_to=tmp_path / "run")
    alike = [{k: v for k, v in asdict(one.row).items() if k not in TIMES} for one in (in_benchmark, in_hand)]
    assert alike[0] == alike[1]
    assert np.array_equal(in_benchmark.trace.instances, in_hand.trace.instances)
    assert (read_config(tmp_path / "run").planner, len(read_steps(tmp_path / "run"))) == ("lawnmower", 6)
    assert (tmp_path / "run/report.html").is_file()


def test_a_protocol_that_does_not_fit_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="flat/empty is made for dream-v1, got pool-v1"):
        bench(plan(protocol=POOL_V1), tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_reaches_are_protocols_of_their_own() -> None:
    assert protocol_named(reach_variant(8.0)) is DREAM_V1
    far = protocol_named("dream-v1-reach10")
    assert replace(far, name=DREAM_V1.name, reach=8.0) == DREAM_V1
    assert far.reach == 10.0


@pytest.mark.rare
@pytest.mark.usefixtures("undrawn")
def test_a_sweep_flies_the_same_missions_with_every_reach(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(SUITES, "tiny", (Case("reef/L", 1),))
    monkeypatch.setattr("dream.evaluation.engines.Processes", lambda jobs: Here())
    options = ["sweep", "tiny", "--reach", "4", "8", "--planners", "random", "--max-steps", "4", "--json"]
    assert run_command([*options, "--out", str(tmp_path)]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert [bench["protocol"] for bench in printed["reaches"]] == ["dream-v1-reach4", "dream-v1"]
    (near,), (far,) = (read_results(tmp_path / f"reach-{reach}").rows for reach in (4, 8))
    assert near.protocol == "dream-v1-reach4"
    assert near.world_hash == far.world_hash
    assert near.instances < far.instances


@pytest.mark.usefixtures("undrawn")
def test_a_failed_mission_makes_status_1_and_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:

    class Unlucky(Here):
        def run(self, task: Any, groups: Any) -> Generator[tuple[Any, Any], None, None]:
            for flight, outcome in Here.run(self, task, groups):
                yield flight, Failure("the sea was rough") if flight.planner_name == "random" else outcome

    monkeypatch.setattr("dream.evaluation.engines.Processes", lambda jobs: Unlucky())
    options = ["bench", "--world", "flat/empty", "--planners", "random", "lawnmower", "--max-steps", "3"]
    options += ["--protocol", "dream-v1"]
    assert run_command([*options, "--json", "--out", str(tmp_path)]) == 1
    printed = capsys.readouterr()
    outcome = json.loads(printed.out)
    assert [row["planner"] for row in outcome["missions"]] == ["lawnmower"]
    assert outcome["failed"] == [
        {"world": "flat/empty", "seed": 1, "start": 0, "planner": "random", "error": "the sea was rough"}
    ]
    assert "1 of 2 missions failed, first random in flat/empty 1: the sea was rough" in printed.err
