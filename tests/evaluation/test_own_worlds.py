"""A world of the user's own is benchmarked like any other, and never taken for another one."""

from __future__ import annotations

import csv
import json
import shlex
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dream.cli import run_command
from dream.commands.bench import Bench
from dream.commands.oracle import _search_case
from dream.evaluation import figures
from dream.evaluation.comparison import compare, family, groups
from dream.evaluation.engines import Processes
from dream.evaluation.report import repeating_command
from dream.evaluation.results import TIMES, Results, mission_path, read_manifest, read_results
from dream.evaluation.runner import Plan, fly_plan
from dream.evaluation.suites import MOST_BYTES, Case, family_of, read_suite, saved_case, suite_named
from dream.planning import RandomWalk
from dream.protocol import DREAM_V1
from dream.sim.files import load_world, save_world, world_hash
from tests.engines import InProcess
from tests.sim.made import made

FLY = ["--planners", "random", "lawnmower", "--max-steps", "4", "--jobs", "1", "--protocol", "dream-v1"]


def edit(folder: Path, **changes: Any) -> None:
    """Change fields of a world as one would by hand."""
    path = folder / "world.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def saved(folder: Path, world: str = "flat/empty", seed: int = 1, **changes: Any) -> Path:
    save_world(made(world, seed), folder)
    edit(folder, **changes)
    return folder


def moved(folder: Path) -> None:
    """Another world: its first start lies where its second one was."""
    starts = json.loads((folder / "world.json").read_text())["starts"]
    edit(folder, starts=starts[1:])


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "results.csv").open(newline="") as file:
        return [{k: v for k, v in row.items() if k not in TIMES} for row in csv.DictReader(file)]


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, undrawn: None) -> None:
    """In an empty folder, all missions in this process; the curves are drawn in that of `changed` alone."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("dream.evaluation.engines.Processes", InProcess)


@pytest.mark.rare
def test_a_saved_world_that_nobody_changed_is_the_one_of_its_name() -> None:
    saved(Path("mine"), "reef/L")
    assert run_command(["bench", "--world", "mine", *FLY]) == 0
    assert run_command(["bench", "--world", "reef/L", *FLY, "--out", "theirs"]) == 0
    assert rows(Path("bench/mine")) == rows(Path("theirs"))
    comparison = compare(read_results(Path("bench/mine")))
    assert comparison.bounds.keys() == {Case("reef/L", 1)}, "its bounds are known"
    assert family(comparison.cases[0]) == "letter"


@pytest.fixture(scope="module")
def changed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a reef that was changed, `worlds/mine`, and a benchmark of it with its recordings."""
    home = tmp_path_factory.mktemp("home")
    moved(saved(home / "worlds/mine", "reef/L"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        patch.setattr("dream.evaluation.engines.Processes", InProcess)
        assert run_command(["bench", "--world", "worlds/mine", *FLY, "--keep-runs"]) == 0
    return home


@pytest.mark.rare
def test_a_changed_world_is_called_so_in_rows_tables_and_files(changed: Path) -> None:
    bench, world = changed / "bench/mine", load_world(changed / "worlds/mine")
    assert world.name == "reef/L"
    results = read_results(bench)
    assert {(row.world, row.seed, row.world_hash) for row in results.rows} == {
        ("reef/L (changed)", 1, world_hash(world))
    }
    comparison = compare(results)
    assert comparison.bounds == {}
    assert [*groups(comparison)] == ["All worlds"]
    assert family(comparison.cases[0]) == "other"
    with pytest.raises(ValueError, match=r'no family for the world "reef/L \(changed\)"'):
        family_of("reef/L (changed)")
    assert "reef/L (changed) 1" in (bench / "report.html").read_text()
    assert "reef/L (changed) 1" in (bench / "tables.md").read_text()
    assert len(list((bench / "missions").glob("*.json"))) == 2
    assert all(set(path.name) <= {*"abcdefghijklmnopqrstuvwxyzL0123456789_-."} for path in bench.rglob("*"))


def scene(results: Results) -> figures.Scene:
    comparison = compare(results)
    return figures.scene(results, comparison, comparison.cases[0])


@pytest.mark.rare
def test_its_chart_is_drawn_where_it_is_still_what_it_was(
    changed: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    results = read_results(changed / "bench/mine")
    assert scene(results).chart is None, "its folder is not here"
    monkeypatch.chdir(changed)
    assert scene(results).chart is not None
    saved(tmp_path / "worlds/mine", "reef/L")
    monkeypatch.chdir(tmp_path)
    assert scene(results).chart is None, "another one is"


def test_its_recordings_play_from_anywhere(changed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for run in (changed / "bench/mine/runs").iterdir():
        assert run_command(["replay", str(run)]) == 0
        assert "4 of 4 decisions agree" in capsys.readouterr().out


@pytest.mark.rare
@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--world", "worlds/mine"], "bench/mine"),
        (["my worlds.txt"], "bench/my-worlds"),
        (["--world", "."], "bench/"),
    ],
)
def test_the_command_that_repeats_it_names_the_same_worlds(
    words: list[str], named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved(saved(Path("worlds/mine")))
    moved(saved(Path()))
    Path("my worlds.txt").write_text("worlds/mine start 1\nflat/empty 4..5")
    assert run_command(["bench", *words, *FLY]) == 0
    (manifest,) = Path().glob("bench/*/manifest.json")
    assert str(manifest.parent).startswith(named)
    asked: list[tuple[str, tuple[Case, ...]]] = []

    def kept(bench: Bench) -> int:
        asked.append(bench._cases())
        return 0

    monkeypatch.setattr(Bench, "__call__", kept)
    program, *arguments = shlex.split(repeating_command(read_manifest(manifest.parent)))
    assert program == "dream"
    assert run_command(["bench", *words]) == run_command(arguments) == 0
    assert asked[0] == asked[1]


@pytest.mark.rare
@pytest.mark.parametrize("change", [moved, lambda folder: edit(folder, name="Riff vor Föhr")])
def test_no_benchmark_goes_on_with_a_world_that_has_changed(
    change: Callable[[Path], object], capsys: pytest.CaptureFixture[str]
) -> None:
    saved(Path("mine"))
    assert run_command(["bench", "--world", "mine", *FLY]) == 0
    before = {path: path.read_bytes() for path in Path("bench/mine").rglob("*.*")}
    change(Path("mine"))
    assert run_command(["bench", "--world", "mine", *FLY]) == 2
    told = capsys.readouterr().err.splitlines()[-1]
    was, now = before[Path("bench/mine/manifest.json")].decode(), world_hash(load_world("mine"))
    assert f" 1 in mine: expected {json.loads(was)['worlds']['flat/empty 1']['world_hash']} as for" in told
    assert told.endswith(f"got {now}. Choose another --out")
    assert {path: path.read_bytes() for path in Path("bench/mine").rglob("*.*")} == before
    assert run_command(["bench", "--world", "mine", *FLY, "--out", "new"]) == 0
    assert {row["world_hash"] for row in rows(Path("new"))} == {now}


def test_it_goes_on_where_it_was_and_others_join() -> None:
    moved(saved(Path("mine")))
    fly = ["bench", "--max-steps", "4", "--jobs", "1", "--protocol", "dream-v1", "--out", "all"]
    assert run_command([*fly, "--world", "mine", "--planners", "random"]) == 0
    kept = {path: path.stat().st_mtime_ns for path in Path("all/missions").iterdir()}
    saved(Path("other"), seed=2, name="Riff vor Föhr")
    Path("both.txt").write_text("mine\nother\nflat/empty 1")
    assert run_command([*fly, "both.txt", "--planners", "lawnmower", "random"]) == 0
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    manifest = read_manifest(Path("all"))
    assert manifest["suite"] == "mine/, both.txt"
    assert manifest["finished"]
    assert [*manifest["worlds"]] == ["flat/empty (changed) 1", "Riff vor Föhr 2"]
    assert [(row["world"], row["planner"]) for row in rows(Path("all"))] == [
        (world, planner)
        for world in ("flat/empty", "Riff vor Föhr", "flat/empty (changed)")
        for planner in ("lawnmower", "random")
    ]
    assert repeating_command(manifest).count(" && ") == 1
    assert run_command([*fly, "--world", "flat/empty", "--planners", "random"]) == 0
    assert read_manifest(Path("all"))["worlds"] == manifest["worlds"], "all stay known"


class Elsewhere(InProcess):
    """Flies in another folder, where `before` was done between planning and flying."""

    def __init__(self, folder: Path, before: Callable[[], object]) -> None:
        self._folder, self._before = folder, before

    def run(
        self, task: Callable[[Any], Any], groups: Sequence[Sequence[Any]]
    ) -> Generator[tuple[Any, Any], None, None]:
        self._before()
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(self._folder)
            yield from super().run(task, groups)


def plan(*cases: Case) -> Plan:
    return Plan("mine", cases, {"random": RandomWalk()}, DREAM_V1, max_steps=2)


@pytest.mark.rare
def test_workers_find_it_wherever_they_stand(tmp_path: Path) -> None:
    moved(saved(Path("mine")))
    (away := tmp_path / "away").mkdir()
    (ended,) = fly_plan(plan(saved_case(Path("mine"))), tmp_path / "one", Elsewhere(away, lambda: None))
    assert not ended.kept
    assert read_manifest(tmp_path / "one")["worlds"]["flat/empty (changed) 1"]["folder"] == "mine"
    assert len(list(fly_plan(plan(saved_case(Path("mine"))), tmp_path / "two", Processes(1)))) == 1
    assert rows(tmp_path / "one") == rows(tmp_path / "two")


def test_a_world_that_changes_while_it_is_flown_is_no_result(tmp_path: Path) -> None:
    saved(Path("mine"), name="mine")
    engine = Elsewhere(tmp_path, lambda: moved(tmp_path / "mine"))
    (ended,) = fly_plan(plan(saved_case(Path("mine"))), tmp_path / "out", engine)
    assert "mine: expected the world " in getattr(ended.outcome, "message", "")
    assert not list(tmp_path.glob("out/missions/*"))
    (failed,) = read_manifest(tmp_path / "out")["failed"]
    assert (failed["world"], failed["seed"]) == ("mine", 1)


def test_the_world_before_last_is_not_taken_from_memory_for_this_one(tmp_path: Path) -> None:
    digests = []
    for number in (1, 2):
        moved(saved(tmp_path / str(number), name="mine") if number == 1 else tmp_path / "1")
        list(fly_plan(plan(saved_case(tmp_path / "1")), tmp_path / f"out{number}", InProcess()))
        digests.append(rows(tmp_path / f"out{number}")[0]["world_hash"])
    assert digests[0] != digests[1] == world_hash(load_world(tmp_path / "1"))


def test_two_worlds_of_one_name_and_seed_are_not_flown_side_by_side(tmp_path: Path) -> None:
    moved(saved(tmp_path / "a"))
    moved(saved(tmp_path / "b"))
    moved(tmp_path / "b")
    for start in (0, 1):
        a, b = saved_case(tmp_path / "a"), saved_case(tmp_path / "b", start)
        with pytest.raises(
            ValueError, match=r"expected worlds that differ .* both in .*a and in .*b\. Change"
        ):
            plan(a, b)
    edit(tmp_path / "b", seed=2)
    assert len(plan(a, saved_case(tmp_path / "b", 1))) == 2


def test_a_file_lists_worlds_by_name_and_by_folder_as_seen_from_it(tmp_path: Path) -> None:
    saved(Path("bay/reefs/north side"), name="north")
    saved(Path("bay/flat"), seed=7)
    Path("bay/list.txt").write_text(
        "# The bay\n\n'reefs/north side' start 2  # its third\nflat\n"
        "reef/K 2..3 start 1\nreef/O\nreef/string+1y1 4"
    )
    assert (found := suite_named("bay/list.txt")) == (
        Case("north", 1, 2),
        Case("flat/empty", 7),
        Case("reef/K", 2, 1),
        Case("reef/K", 3, 1),
        Case("reef/O", 1),
        Case("reef/string+1y1", 4),
    )
    assert [case.folder for case in found] == ["bay/reefs/north side", "bay/flat", "", "", "", ""]
    assert found[0].open().name == "north"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("reef/O\nreef/mixd 3", r'list\.txt, line 2: no world "reef/mixd". Did you mean "reef/mixed"\?'),
        ("mein", r'list\.txt, line 1: no such folder or world: "mein"'),
        ("mine 3", r"line 1: expected no seed behind a folder, .*got 3\. .*: mine start 3$"),
        ("mine start 4", r"line 1: mine: start: expected 0 to 3, got 4"),
        (
            "\n\nmine\nmine start 0",
            r"line 4: expected each world once, got flat/empty 1, start 0, of line 3 again\. If",
        ),
        (
            "reef/O 1..3\nreef/O 2",
            r"line 2: expected each world once, got reef/O 2, start 0, of line 1 again$",
        ),
        ("reef/O 3..1", r"line 1: seed: expected the lower seed first, got 3\.\.1"),
        ("reef/O x", "line 1: seed: expected a number or A..B"),
        ("reef/O ²", "line 1: seed: expected a number or A..B"),
        ("reef/O 1 2", r"line 1: expected WORLD \[SEED or A\.\.B\] \[start N\], got reef/O 1 2"),
        ("reef/O start", "line 1: seed: expected a number"),
        ("the 'bay", r"line 1: expected WORLD .*, got the 'bay \(No closing quotation\)"),
        ("odd", r'line 1: odd: expected a world named by letters.* got "a, b"\. Change "name"'),
        ("torn", r"line 1: world\.json: "),
        ("reef/O 1..6000\nreef/K 1..6000", "line 2: expected at most 10000 worlds, got more"),
        ("# nothing\n", r"list\.txt: expected at least one world, a line WORLD"),
        ("#" * (MOST_BYTES + 1), f"expected at most {MOST_BYTES} bytes, got {MOST_BYTES + 1}"),
        (b"reef/\xff", r"list\.txt: expected UTF-8 text, got invalid start byte at byte 5"),
    ],
)
def test_what_is_wrong_in_such_a_file_is_told_by_line(text: str | bytes, complaint: str) -> None:
    saved(Path("mine"))
    saved(Path("odd"), name="a, b")
    Path("torn").mkdir()
    Path("torn/world.json").write_text("{")
    Path("list.txt").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=complaint) as caught:
        read_suite(Path("list.txt"))
    assert str(caught.value).startswith("list.txt")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["nowhere.txt"], "nowhere.txt: expected a file that lists worlds"),
        (
            ["mein"],
            'no suite "mein". There are: paper, dev, test, dev-v2, test-v2, test-seen; a list of your own is',
        ),
        (["mine"], "mine: expected --world before a world, got none. Say: dream bench --world mine"),
        (
            ["--world", "mine", "--seeds", "2"],
            "--seeds: expected none beside a folder, whose world has its own, 1",
        ),
        (["--world", "mein"], 'no such folder or world: "mein". dream worlds lists the worlds'),
        (["a, b.txt"], "suite: expected a name without a comma, got a, b.txt. Rename it"),
    ],
)
def test_what_names_no_world_is_refused_before_there_is_a_folder(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    saved(Path("mine"))
    Path("a, b.txt").write_text("mine")
    assert run_command(["bench", *words, *FLY]) == 2
    assert complaint in capsys.readouterr().err
    assert not Path("bench").exists()


def test_missions_of_worlds_that_are_called_almost_alike_are_kept_apart() -> None:
    names = ("reef/L", "reef/l", "reef-L", "reef L", "reef/L (changed)", "reef/L changed", "reef/ü", "reef/ä")
    paths = {mission_path(Path(), ("dream-v1", name, 1, 0, "random")).name.lower() for name in names}
    assert len(paths) == len(names)
    assert "dream-v1_reef-l_1_0_random.json" in paths, "as it always was"


def test_the_other_commands_take_the_same_file(tmp_path: Path) -> None:
    moved(saved(Path("bay/mine")))
    Path("bay/list.txt").write_text("mine")
    reaches = ["--reach", "8", "--planners", "random", "--max-steps", "2", "--jobs", "1"]
    assert run_command(["sweep", str(tmp_path / "bay/list.txt"), *reaches]) == 0
    assert rows(Path("sweep/list/reach-8"))[0]["world"] == "flat/empty (changed)"
    (case,) = suite_named("bay/list.txt")
    found = _search_case(case, "dream-v1", 0.0, None, None, again=False)
    assert (found.world, found.world_hash) == ("flat/empty (changed)", case.world_hash)
    with pytest.raises(ValueError, match=r"bay/mine: expected the world .* Was it edited"):
        _search_case(replace(case, world_hash="0" * 64), "dream-v1", 0.0, None, None, again=False)
