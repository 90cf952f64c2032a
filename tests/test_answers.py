"""What the commands answer where the smallest thing is amiss, before anything is made, flown or compiled."""

from __future__ import annotations

import importlib.util
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import pytest
from numba.core.event import trigger_event

from dream.cli import run_command
from dream.compiling import COMPILES, thread_time
from dream.evaluation import runner
from dream.evaluation.oracle import bounds
from dream.evaluation.results import read_kept, read_results
from dream.evaluation.suites import Case
from dream.extras import how_to_add
from dream.planning import PLANNERS
from dream.protocol import DREAM_V1
from dream.sim.files import save_world
from dream.sim.world import World
from tests.engines import InProcess

Answer = Callable[..., tuple[int, str]]


@pytest.fixture
def answer(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Answer:
    """The status of a command and its line on standard error, in an empty folder where no world is made."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DREAM_ARCHIVE", str(tmp_path / "none.gpkg"))
    monkeypatch.setattr("dream.sim.worlds.open_world", too_late)
    monkeypatch.setattr("dream.sim.visibility.Visibility", too_late)

    def command(*words: str) -> tuple[int, str]:
        status = run_command(list(words))
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err.count("\n") == 1
        return status, printed.err

    return command


def too_late(*given: object, **named: object) -> NoReturn:
    raise AssertionError("told only once a world was made")


@pytest.mark.parametrize("world", ["reef/string", "wreck/1", "pool/arc", "reef/K+1y2", "saved"])
@pytest.mark.parametrize("command", ["run", "run belief", "dive", "bench", "oracle", "draw", "mission all"])
def test_a_world_alone_is_told_to_stand_behind_its_option(
    command: str, world: str, answer: Answer, tmp_path: Path, empty_world: World
) -> None:
    if world == "saved":
        save_world(empty_world, tmp_path / world)
    status, said = answer(*command.split(), world)
    assert status == 2
    assert said.startswith(f"dream: {world}: expected --world before a world, got none. Say: dream ")
    assert said.endswith(f"--world {world}\n")


@pytest.mark.parametrize("word", ["reef/strng", "nowhere", "README.md"])
def test_what_is_no_world_is_taken_for_a_planners_name(word: str, answer: Answer) -> None:
    assert answer("run", word) == (2, answer("run", word)[1])
    assert answer("run", word)[1].startswith(f'dream: no planner "{word}".')


@pytest.mark.parametrize(
    ("words", "option"),
    [(["draw", "--out"], "--out"), (["oracle", "--budget", "0", "--picture"], "--picture")],
)
@pytest.mark.parametrize("place", ["/proc/reef.png", "/dev/null/reef.png", "file/reef.png"])
def test_a_picture_for_a_place_that_cannot_be_written_is_refused_before_it_is_drawn(
    words: list[str], option: str, place: str, answer: Answer, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    status, said = answer(*words, place)
    assert status == 2
    assert f"{option}: expected a place that can be written, got {Path(place).parent} (" in said


def test_a_picture_is_not_written_over_a_folder(answer: Answer, tmp_path: Path) -> None:
    (tmp_path / "reef.png").mkdir()
    assert (
        answer("draw", "--out", "reef.png")[1] == "dream: --out: expected a file, got the folder reef.png\n"
    )


@pytest.mark.parametrize("run", ["nosuch", "elsewhere/latest", "file"])
def test_a_folder_to_watch_that_is_not_there_is_told(run: str, answer: Answer, tmp_path: Path) -> None:
    pytest.importorskip("uvicorn")
    (tmp_path / "file").touch()
    status, said = answer("watch", run, "--port", "0")
    assert status == 2
    assert said.startswith(f"dream: {run}: expected a folder that exists, or one below runs")


@pytest.mark.parametrize(
    "words",
    [
        ["mission", "look at all of it", "--model", "wire"],
        ["run", "dream", "--model", "wire", "--mission", "look at all of it"],
        ["run", "ranked", "--model", "wire", "--mission", "the west side"],
    ],
)
def test_orders_in_words_without_a_terminal_are_told_to_need_yes_at_once(
    words: list[str], answer: Answer, tmp_path: Path
) -> None:
    status, said = answer(*words)
    assert status == 2
    assert said.startswith("dream: Nobody can confirm without a terminal. Add --yes")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("module", "words", "extra"),
    [
        ("onnxruntime", ["run", "uivnav"], "learned"),
        ("onnxruntime", ["bench", "--protocol", "dream-v1", "--planners", "belief", "uivnav"], "learned"),
        ("onnxruntime", ["dive", "uivnav", "--stand-in", "--unattended"], "learned"),
        ("pydantic_ai", ["dive", "ranked", "--model", "wire", "--stand-in", "--unattended"], "vlm"),
        ("pydantic_ai", ["bench", "--planners", "ranked", "--model", "wire"], "vlm"),
        ("onnxruntime", ["sweep", "--planners", "uivnav"], "learned"),
        ("psycopg", ["run", "--from-survey", "1", "--archive", "postgresql://a/b"], "postgis"),
        ("psycopg", ["survey", "add", "run", "--archive", "postgresql://a/b"], "postgis"),
        ("psycopg", ["survey", "compare", "run", "1", "--archive", "postgresql://a/b"], "postgis"),
        ("psycopg", ["survey", "export", "run", "--to", "x", "--archive", "postgresql://a/b"], "postgis"),
        ("rasterio", ["survey", "export", "run", "--to", "x"], "survey"),
        ("pyproj", ["survey", "export", "run", "--to", "x", "--only", "mosaic"], "survey"),
        ("ray", ["bench", "--engine", "ray"], "ray"),
        ("rerun", ["replay", "run", "--rerun"], "rerun"),
        ("pyarrow", ["train", "uivnav", "--lerobot", "x"], "train"),
        ("fastapi", ["run", "--live"], "live"),
        ("ruamel.yaml", ["dive", "--stand-in", "--unattended"], "rov"),
    ],
)
def test_a_missing_extra_is_told_before_anything_is_measured_or_made(
    module: str,
    words: list[str],
    extra: str,
    answer: Answer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    there = importlib.util.find_spec
    monkeypatch.setattr(
        "importlib.util.find_spec", lambda name, *more: None if name == module else there(name, *more)
    )
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr("dream.survey.reef.measured", too_late, raising=False)
    (tmp_path / "run").mkdir()
    (tmp_path / "run/config.json").write_text("{}")
    status, said = answer(*words)
    assert status == 2
    assert f"{module}, got none. To add it: {how_to_add(extra)}\n" in said


def busy(seconds: float) -> None:
    until = time.thread_time() + seconds
    while time.thread_time() < until:
        pass


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_a_clock_of_the_processor_stands_still_while_code_is_compiled(depth: int) -> None:
    before = thread_time()

    def compile_within(left: int) -> None:
        with trigger_event(COMPILES):
            busy(0.01)
            if left > 1:
                compile_within(left - 1)

    compile_within(depth)
    assert thread_time() - before < 0.005
    busy(0.01)
    assert thread_time() - before >= 0.01


def test_a_budget_is_not_spent_on_compiling(monkeypatch: pytest.MonkeyPatch, empty_world: World) -> None:
    searched = []
    monkeypatch.setattr(bounds, "pose_graph", lambda *_, **__: SimpleNamespace(individuals=range(3)))
    monkeypatch.setattr(bounds, "_shown_by_looking", lambda *_: [])
    monkeypatch.setattr(bounds, "_with_tour", lambda graph, may_miss, limit, walk: limit)

    def search(graph: Any, may_miss: int, limit: bounds.Limit, *given: Any) -> bounds.Limit:
        searched.append(may_miss)
        with trigger_event(COMPILES):
            busy(0.06)
        busy(0.011)
        return limit

    monkeypatch.setattr(bounds, "_better_tour", search)
    monkeypatch.setattr(bounds, "_better_bound", search)
    found = bounds.bound(empty_world, DREAM_V1, budget_s=0.05)
    assert len(searched) in (4, 5, 6)
    assert found.cpu_s < 0.2


@pytest.fixture(scope="module")
def benched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("benched")
    planners = {name: PLANNERS[name] for name in ("random", "lawnmower")}
    plan = runner.Plan("empty", (Case("flat/empty", 1),), planners, DREAM_V1, max_steps=4)
    assert len(list(runner.fly_plan(plan, folder, InProcess()))) == 2
    return folder


@pytest.mark.parametrize("lost", [("results.csv",), ("traces.csv.gz",), ("results.csv", "traces.csv.gz")])
def test_missions_of_a_benchmark_that_was_broken_off_are_where_a_search_begins(
    lost: tuple[str, ...], benched: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "broken"
    folder.mkdir()
    (folder / "missions").mkdir()
    for path in benched.rglob("*"):
        if path.is_file() and path.name not in lost:
            (folder / path.relative_to(benched)).write_bytes(path.read_bytes())
    with pytest.raises(FileNotFoundError):
        read_results(folder)
    assert set(read_kept(folder).rows) == set(read_results(benched).rows)
    if len(lost) == 2:
        options = ["--world", "flat/empty", "--budget", "0", "--traces", str(folder), "--json"]
        assert run_command(["oracle", *options]) == 0
        assert json.loads(capsys.readouterr().out)["status"] == "optimal"
    # One that was not written to its end is left out.
    torn = next((folder / "missions").iterdir())
    torn.write_bytes(torn.read_bytes()[:-40])
    assert len(read_kept(folder).rows) == 1
