"""The page of a benchmark, its tables as Markdown, and the documentation's page of results."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from dream.cli import run_command
from dream.commands import Bench
from dream.commands.console import _Scores
from dream.evaluation.comparison import compare, family
from dream.evaluation.figures import shown_cases
from dream.evaluation.oracle.bounds import OracleBounds
from dream.evaluation.report import repeating_command, sections, write_report, write_results
from dream.evaluation.results import Results, read_results
from dream.evaluation.runner import Ended, Plan
from dream.evaluation.suites import SUITES, Case
from dream.evaluation.summary import print_summary
from dream.planning import PLANNERS, Asking
from dream.protocol import protocol_named
from dream.sim.files import world_hash
from dream.sim.worlds import make_world
from tests.evaluation.benches import (
    ASKED,
    GPT,
    PACES,
    PAPER,
    Made,
    bounds,
    flown,
    manifest,
    paper_missions,
    write_bench,
)

pytestmark = pytest.mark.usefixtures("worlds_are_made_once")

FEW = (Case("reef/L", 1), Case("reef/L", 2), Case("reef/string", 1), Case("wreck/3", 1))
HOSTILE = "</style><script>document.title='owned'</script><img src=x onerror=alert(1)> & {{style}} [a](b)|`c`"


class Page(HTMLParser):
    """What a page would load and run, its tables and its text."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.loads: list[str] = []
        self.styles: list[str] = []
        self.attributes: set[str] = set()
        self.ids: list[str] = []
        self.policy = ""
        self.text = ""
        self._inside = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self.tags.append(tag)
        self._inside = tag
        self.attributes |= set(named)
        self.ids += [str(named["id"])] if "id" in named else []
        self.loads += [v for name in ("src", "href", "srcset", "action", "data") if (v := named.get(name))]
        if named.get("http-equiv") == "Content-Security-Policy":
            self.policy = named.get("content") or ""

    def handle_data(self, data: str) -> None:
        if self._inside == "style":
            self.styles.append(data)
        else:
            self.text += data

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""


@pytest.fixture(scope="module")
def paper(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A benchmark of four planners over the suite `paper`, with bounds for one case, and its report."""
    folder = tmp_path_factory.mktemp("paper")
    write_bench(folder, paper_missions(), PAPER, list(PACES))
    with pytest.MonkeyPatch.context() as patch:

        def known(protocol: str, world: str, seed: int, start: int, world_hash: str) -> OracleBounds | None:
            case = Case(world, seed, start)
            return bounds(case, (20, 24), (22, None)) if world == "reef/L" else None

        patch.setattr("dream.evaluation.oracle.bounds.known_bounds", known)
        write_report(folder)
        yield folder


def few(folder: Path, missing: int = 0, **changes: Any) -> Path:
    paces = {"sixsteps": 60.0, "lawnmower": 120.0}
    missions = paper_missions(paces, FEW)
    return write_bench(folder, missions[: len(missions) - missing], FEW, list(paces), **changes)


@pytest.mark.rare
@pytest.mark.slow
def test_the_page_loads_and_runs_nothing(paper: Path) -> None:
    page = Page(paper / "report.html")
    assert "script" not in page.tags
    assert "link" not in page.tags
    assert not {name for name in page.attributes if name.startswith("on")}
    assert "style" not in page.attributes
    assert all(load.startswith(("data:image/", "#")) for load in page.loads)
    digest = base64.b64encode(hashlib.sha256(page.styles[0].encode()).digest()).decode()
    assert page.policy == (
        f"default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'; style-src 'sha256-{digest}'"
    )
    assert (paper / "report.html").stat().st_size < 6_000_000


@pytest.mark.slow
@pytest.mark.rare
def test_the_page_says_all_that_there_is_to_say(paper: Path) -> None:
    page = Page(paper / "report.html")
    parts = [
        *(
            "results",
            "families",
            "baselines",
            "papers-planner",
            "bounds",
            "paper",
            "ways",
            "worlds",
            "details",
        ),
        "run",
    ]
    assert [name for name in page.ids if name in parts] == parts
    assert len(page.ids) == len(set(page.ids))
    links = {load for load in page.loads if load.startswith("#")}
    assert links == {"#" + part for part in parts}
    for text in (
        "sixsteps is the fastest here: it reached 98.26 % of the individuals in 15 of 15 missions",
        "The best baseline, lawnmower, takes",
        "Steps to 98.26 % on the 10 reefs sixsteps 49.9 and lawnmower 100.6, on the 5 wrecks",
        "As published, other simulator: reefs",
        "not yet measured here",
        "No certified bound is known for 14 of 15 cases",
        "dream bench paper --planners sixsteps lawnmower frontier random --protocol dream-v1",
        "commit 0123abc",
    ):
        assert text in page.text
    # Five curves in light and dark, and fifteen worlds.
    assert page.tags.count("picture") == 5
    assert page.tags.count("figure") == 5 + 15


@pytest.mark.slow
@pytest.mark.rare
def test_markdown_has_the_same_tables(paper: Path) -> None:
    text = (paper / "tables.md").read_text()
    page = Page(paper / "report.html")
    titles = re.findall(r"^\*\*(.*)\*\*$", text, re.M)
    assert len(titles) > 40
    for title in titles:
        assert title.replace("\\", "") in page.text


@pytest.mark.rare
@pytest.mark.slow
def test_equal_folders_give_equal_bytes(tmp_path: Path) -> None:
    one, two = (write_report(few(tmp_path / name)) for name in "ab")
    assert one.read_bytes() == two.read_bytes()
    assert (one.parent / "tables.md").read_bytes() == (two.parent / "tables.md").read_bytes()


@pytest.mark.usefixtures("undrawn")
def test_an_unfinished_benchmark_says_what_is_missing_and_has_no_verdict(tmp_path: Path) -> None:
    failed = [{"world": "wreck/3", "seed": 1, "start": 0, "planner": "lawnmower", "error": f"E: {HOSTILE}"}]
    page = Page(write_report(few(tmp_path, missing=3, finished=None, failed=failed)))
    missing = "3 of 8 missions are missing (1 failed, 2 not yet flown)"
    assert f"Unfinished: {missing}" in page.text
    assert f"No verdict: {missing}" in page.text
    assert "the 2 cases that all of them have flown" in page.text
    assert "fastest here" not in page.text
    assert "Every planner flew the same worlds" not in page.text
    assert "Missions that failed" in page.text
    assert f"E: {HOSTILE}" in page.text


def verdict(tmp_path: Path, planners: dict[str, Made], cases: tuple[Case, ...] = FEW[:3]) -> str:
    missions = [flown(case, name, made) for case in cases for name, made in planners.items()]
    results = read_results(write_bench(tmp_path, missions, cases, list(planners)))
    return sections(results, compare(results))[0].lead


def test_where_nobody_got_there_the_verdict_is_by_coverage(tmp_path: Path) -> None:
    text = verdict(tmp_path, {"random": Made(500), "lawnmower": Made(400), "sixsteps": Made(250)})
    assert "fastest here" not in text
    assert text.startswith("None reached 98.26 % of the individuals in any mission")
    assert "Judged by coverage at the end instead, sixsteps is the best here: it saw 80.00 %" in text
    assert "The best baseline, lawnmower, saw 50.00 %" in text
    assert "the difference is 30.00 points over 3 worlds" in text


def test_equal_planners_share_the_first_place(tmp_path: Path) -> None:
    text = verdict(tmp_path / "1", {"lawnmower": Made(60, 59), "sixsteps": Made(60, 70), "random": Made(90)})
    assert "lawnmower and sixsteps are equally fast here" not in text  # 98.26 % of 60 is 58.96: 59.
    assert "sixsteps and lawnmower are equally fast here: 59.0 steps" in text
    assert (
        "Of these, sixsteps saw the most by the end, 100.00 % of the individuals, and so stands first" in text
    )
    assert "best baseline" not in text
    text = verdict(tmp_path / "2", {"lawnmower": Made(60, 70), "sixsteps": Made(60, 70), "random": Made(90)})
    assert "lawnmower and sixsteps are equally fast here" in text
    assert "stand in the order of the benchmark" in text
    text = verdict(tmp_path / "3", {"random": Made(400), "lawnmower": Made(400)})
    assert "random and lawnmower are equal: each saw 50.00 %" in text


def test_one_planner_alone_is_not_called_the_fastest(tmp_path: Path) -> None:
    text = verdict(tmp_path, {"sixsteps": Made(60, 70)})
    assert text.startswith("sixsteps, the only planner here, reached 98.26 % of the individuals in 3 of 3")


@pytest.mark.usefixtures("undrawn")
def test_worlds_without_a_tour_and_later_machines_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "dream.evaluation.oracle.bounds.known_bounds",
        lambda protocol, world, seed, start, digest: bounds(
            Case(world, seed, start), (20, None if world == "wreck/3" else 24), (22, 26)
        ),
    )
    later = [{"engine": "Ray(jobs=4)", "machine": {"cpu": "Another", "cores": None}}]
    page = Page(write_report(few(tmp_path, later=later)))
    assert "No tour to 98.26 % is known for 1 of 4 cases" in page.text
    assert "No certified bound" not in page.text
    assert "Ray(jobs=4) on cpu Another" in page.text


@pytest.mark.usefixtures("undrawn")
def test_a_world_that_the_first_look_shows_is_not_called_never(tmp_path: Path) -> None:
    missions = [
        flown(FEW[0], name, Made(60, 70), t90=0, t95=0, t98=0, t100=0) for name in ("sixsteps", "random")
    ]
    text = write_report(write_bench(tmp_path, missions, FEW[:1], ["sixsteps", "random"])).read_text()
    assert "98.26 % never" not in text
    assert "<span>sixsteps, random 0</span>" in text


def test_the_live_table_counts_what_was_never_reached_as_the_tables_do(tmp_path: Path) -> None:
    planners = {name: PLANNERS[name] for name in ("sixsteps", "random")}
    plan = Plan("paper", FEW[:2], planners, protocol_named("dream-v1"), max_steps=80)
    missions = [
        flown(case, name, made, cap=80)
        for case in FEW[:2]
        for name, made in (("sixsteps", Made(60, 70)), ("random", Made(400)))
    ]
    scores = _Scores(plan)
    for mission in missions:
        scores.add(Ended(mission.row.key, mission, kept=False))
    console = Console(file=io.StringIO(), width=100)
    console.print(scores.table("2 of 2"))
    printed = console.file.getvalue()  # type: ignore[attr-defined]
    line = next(line for line in printed.splitlines() if "random" in line)
    assert "80.0" in line
    assert "200" not in line
    results = read_results(write_bench(tmp_path, missions, FEW[:2], list(planners), max_steps=80))
    print_summary(results, console)
    assert "80.0" in console.file.getvalue().split("random")[-1]  # type: ignore[attr-defined]


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("cases", "planners"),
    [
        pytest.param(FEW[:1], {"sixsteps": Made(60, 70)}, id="one planner, one world"),
        pytest.param(FEW[:2], {"random": Made(900)}, id="no success"),
        pytest.param(FEW[:1], {"random": Made(900), "unheard-of": Made(30, 40, 7)}, id="no planner of ours"),
        pytest.param((Case("my-world", 5),), {"sixsteps": Made(60, 70)}, id="a world of the user's own"),
        pytest.param(FEW[:1], {"sixsteps": Made(60, 0)}, id="a mission of no step"),
        pytest.param(FEW[2:3], {f"planner-{k}": Made(60 + k, 90) for k in range(18)}, id="many planners"),
    ],
)
def test_small_and_odd_benchmarks_have_a_page(
    tmp_path: Path, cases: tuple[Case, ...], planners: dict[str, Made]
) -> None:
    missions = [flown(case, name, made) for case in cases for name, made in planners.items()]
    page = Page(write_report(write_bench(tmp_path, missions, cases, list(planners))))
    assert all(name in page.text for name in planners)
    assert "nan" not in page.text


def test_a_benchmark_without_a_finished_mission_has_a_page(tmp_path: Path) -> None:
    page = Page(write_report(write_bench(tmp_path, [], FEW, ["sixsteps", "lawnmower"], finished=None)))
    assert "8 of 8 missions are missing" in page.text
    assert "nan" not in page.text


@pytest.mark.usefixtures("undrawn")
def test_what_a_stranger_wrote_is_shown_as_text(tmp_path: Path) -> None:
    folder = few(
        tmp_path,
        suite=HOSTILE,
        commit=HOSTILE,
        engine=HOSTILE,
        version=HOSTILE,
        finished=HOSTILE,
        machine={HOSTILE: HOSTILE},
    )
    page = Page(write_report(folder))
    assert "script" not in page.tags
    assert page.tags.count("img") == page.tags.count("picture")
    assert HOSTILE in page.text
    markdown = (folder / "tables.md").read_text()
    assert "<script" not in markdown
    assert "[a](b)" not in markdown


@pytest.mark.parametrize("cap", [True, 0, -1, 10**9, "200", None, 1.5])
def test_a_cap_that_is_none_is_refused(tmp_path: Path, cap: Any) -> None:
    folder = few(tmp_path, protocol={"name": "dream-v1", "cap": cap})
    with pytest.raises(ValueError, match="cap"):
        write_report(folder)


@pytest.mark.usefixtures("undrawn")
def test_world_and_best_tour_are_drawn_only_where_the_world_is_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "dream.evaluation.oracle.bounds.known_bounds",
        lambda protocol, world, seed, start, digest: bounds(Case(world, seed, start), (20, 24), (22, 26)),
    )
    cases = (Case("reef/L", 1), Case("reef/string", 1))
    true = world_hash(make_world("reef/L", 1))
    missions = [
        flown(case, "sixsteps", Made(60, 70, 20), world_hash=true if case.world == "reef/L" else "other")
        for case in cases
    ]
    text = write_report(write_bench(tmp_path, missions, cases, ["sixsteps"])).read_text()
    assert text.count('href="data:image/jpeg') == 1
    assert text.count('<path class="tour"') == 1


def test_only_so_many_worlds_are_drawn_from_every_family() -> None:
    cases = SUITES["dev"]
    missions = [flown(case, "sixsteps", Made(60, 70)) for case in cases]
    results = Results(manifest(cases, ["sixsteps"]), tuple(mission.row for mission in missions), {})
    shown = shown_cases(compare(results), 16)
    assert len(shown) == len(set(shown)) == 16
    assert {
        kind: [family(case) for case in shown].count(kind) for kind in ("fringing", "patch", "wreck")
    } == {
        "fringing": 3,
        "patch": 3,
        "wreck": 2,
    }
    assert shown == [case for case in cases if case in shown]
    assert shown_cases(compare(results), 60) == list(cases)


def test_no_benchmark_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="dream bench"):
        write_report(tmp_path)


@pytest.mark.parametrize(
    ("suite", "commands"),
    [
        ("paper", ["dream bench paper"]),
        ("reef/L 1..2", ["dream bench --world reef/L --seeds 1..2"]),
        ("paper, reef/L 3", ["dream bench paper", "dream bench --world reef/L --seeds 3"]),
        ("a; rm -rf *", ["dream bench --world 'a;' --seeds 'rm -rf *'"]),
        ("bay/my list.txt, the reef/", ["dream bench 'bay/my list.txt'", "dream bench --world 'the reef/'"]),
    ],
)
def test_the_command_that_repeats_it(suite: str, commands: list[str]) -> None:
    rest = " --planners sixsteps random --protocol dream-v1 --max-steps 50"
    made = manifest(FEW, ["sixsteps", "random"], suite=suite, max_steps=50)
    assert repeating_command(made) == " && ".join(command + rest for command in commands)


@pytest.mark.usefixtures("undrawn")
def test_planners_that_no_command_knows_are_left_out_of_the_command_and_named(tmp_path: Path) -> None:
    planners = ["random", "nearby", "sixsteps"]
    missions = [flown(case, name, Made(60, 70)) for case in FEW[:2] for name in planners]
    folder = write_bench(tmp_path, missions, FEW[:2], planners, suite="reef/L 1..2")
    command = "dream bench --world reef/L --seeds 1..2 --planners random sixsteps --protocol dream-v1"
    page = Page(write_report(folder))
    assert f"Repeat it with {command}; nearby is flown by a script of its own" in page.text
    write_results([folder], tmp_path / "page.md", tmp_path / "pictures")
    lines = (tmp_path / "page.md").read_text().splitlines()
    assert f"| repeat with | {command} |" in lines
    assert "| other planners | nearby is flown by a script of its own |" in lines


@pytest.mark.usefixtures("undrawn")
def test_a_benchmark_of_such_planners_alone_has_no_command(tmp_path: Path) -> None:
    planners = {"nearby": {"model": "mine"}, "far-off": {}}
    assert repeating_command(manifest(FEW, planners)) == ""
    missions = [flown(FEW[0], name, Made(60, 70)) for name in planners]
    page = Page(write_report(write_bench(tmp_path, missions, FEW[:1], planners)))
    assert "nearby and far-off are flown by scripts of their own" in page.text
    assert "dream bench" not in page.text


def test_the_command_that_repeats_it_asks_the_model_alike() -> None:
    gpt = asdict(Asking(model="openai:gpt", max_calls=90, record="kept replies"))
    small = asdict(Asking(model="http://localhost:8000/v1", model_name="small", latency=3.0))
    planners = {"random": {"turn_rate": 0.1}, "dream": gpt, "vanilla": small, "ranked": {**gpt, "places": 4}}
    made = manifest(FEW, planners)
    first, second = repeating_command(made).split(" && ")
    assert first == (
        "dream bench paper --planners random dream ranked --protocol dream-v1 "
        "--model openai:gpt --max-calls 90 --record 'kept replies'"
    )
    assert second == (
        "dream bench paper --planners vanilla --protocol dream-v1 "
        "--model http://localhost:8000/v1 --model-name small --latency 3.0"
    )


def test_the_command_that_repeats_it_parses_to_the_same_planners(monkeypatch: pytest.MonkeyPatch) -> None:
    asking = Asking(model="openai:gpt", max_usd=0.25, timeout=9.0, replay_replies="kept; here")
    planners = {name: asking.given_to(PLANNERS[name]) for name in ("belief", "dream", "vanilla")}
    parsed: list[Bench] = []

    def kept(bench: Bench) -> int:
        parsed.append(bench)
        return 0

    monkeypatch.setattr(Bench, "__call__", kept)
    made = manifest(FEW, {name: asdict(planner) for name, planner in planners.items()})
    program, *arguments = shlex.split(repeating_command(made))
    assert program == "dream"
    assert run_command(arguments) == 0
    (bench,) = parsed
    assert (bench.planners, bench.asking) == (("belief", "dream", "vanilla"), asking)


def asked_by(folder: Path, model: str, *others: str) -> Path:
    """`dream` asked that model; the others none. It is the fastest of them."""
    missions = [flown(case, "dream", Made(40, 50), **ASKED) for case in FEW]
    missions += [flown(case, name, Made(60, 70)) for case in FEW for name in others]
    planners = {"dream": {**GPT, "model": model}, **{name: {} for name in others}}
    order = sorted(missions, key=lambda mission: FEW.index(Case(mission.row.world, mission.row.seed)))
    return write_bench(folder, order, FEW, planners)


@pytest.mark.usefixtures("undrawn")
def test_a_wire_test_is_never_called_the_fastest(tmp_path: Path) -> None:
    page = Page(write_report(asked_by(tmp_path / "wire", "wire", "sixsteps", "random")))
    assert "sixsteps, random are" not in page.text
    assert "dream (wire test) is the fastest" not in page.text
    assert "dream (wire test): flown with the stand-in for a model, which shows that the wire" in page.text
    page = Page(write_report(asked_by(tmp_path / "gpt", "openai:gpt", "sixsteps", "random")))
    assert "dream (openai:gpt) is the fastest here" in page.text
    assert "wire" not in page.text
    alone = Page(write_report(asked_by(tmp_path / "alone", "wire:slow")))
    assert "No verdict. dream (wire test): flown with the stand-in" in alone.text


@pytest.mark.usefixtures("undrawn")
def test_few_worlds_leave_out_what_only_many_can_tell(tmp_path: Path) -> None:
    page = Page(write_report(asked_by(tmp_path / "few", "openai:gpt", "sixsteps")))
    assert "are shown from 10 worlds on: fewer say little of a share" in page.text
    for named in ("CORAL", "Table I", "Kaplan"):
        assert named not in page.text
    # Each measure of the first table is explained beside it.
    for explained in ("An individual is", "Success:", "t98:", "Own stop:", "Certified bound:", "SPL says"):
        assert explained in page.text


@pytest.mark.usefixtures("undrawn")
def test_the_documentation_leaves_wire_tests_out_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dream.evaluation.report.MANY", 1)
    folder = asked_by(tmp_path / "mixed", "wire:slow", "sixsteps")
    write_results([folder], tmp_path / "results.md", tmp_path / "pictures")
    text = (tmp_path / "results.md").read_text()
    said = "Left out: what dream flew with the stand-in for a model, which shows that the wire works"
    assert said in text
    assert text.count("dream ") == text.count("dream bench") + text.count("dream results") + 1
    assert "(wire test)" not in text
    assert "planners that ask a vision-language model | – | not yet measured here" in text
    assert "--model" not in text


@pytest.mark.usefixtures("undrawn")
def test_a_page_of_results_lies_in_its_first_folder_unless_it_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    released = tmp_path / "docs" / "results.md"
    released.parent.mkdir()
    released.write_text("released")
    for name in ("mine", "other"):
        write_bench(tmp_path / name, [flown(FEW[0], "sixsteps", Made(60, 70))], FEW[:1], ["sixsteps"])
    assert run_command(["results", "mine", "other"]) == 0
    assert capsys.readouterr().out == "mine/results.md\n"
    assert (tmp_path / "mine/results.md").read_text().count("\n## ") == 3
    assert {path.suffix for path in (tmp_path / "mine/results").iterdir()} <= {".svg", ".png"}
    assert released.read_text() == "released"
    assert [path.name for path in released.parent.iterdir()] == ["results.md"]
    assert run_command(["results", "mine", "--out", "docs/results.md"]) == 0
    assert released.read_text() != "released"


def test_a_benchmark_of_wire_tests_alone_is_not_published(tmp_path: Path) -> None:
    folder = asked_by(tmp_path / "wire", "wire")
    with pytest.raises(ValueError, match="got only what dream flew with the stand-in"):
        write_results([folder], tmp_path / "results.md", tmp_path / "pictures")
    assert not (tmp_path / "results.md").exists()


@pytest.mark.usefixtures("undrawn")
def test_a_sweep_leaves_wire_tests_out_and_says_so_once(tmp_path: Path) -> None:
    for reach in (4.0, 8.0):
        folder = asked_by(tmp_path / "sweep" / f"reach-{reach:g}", "wire", "sixsteps")
        told = json.loads((folder / "manifest.json").read_text())
        told["protocol"]["reach"] = reach
        (folder / "manifest.json").write_text(json.dumps(told))
    write_results([tmp_path / "sweep"], tmp_path / "results.md", tmp_path / "pictures")
    text = (tmp_path / "results.md").read_text()
    assert text.count("Left out: what dream flew") == 1
    assert "(wire test)" not in text


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_the_documentation_is_made_from_folders_and_is_the_same_each_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bench = few(tmp_path / "results" / "few")
    written = []
    for name in ("one", "two"):
        page = tmp_path / name / "results.md"
        assert run_command(["results", str(bench), "--out", str(page), "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert told["page"] == str(page)
        assert all(Path(picture).is_file() for picture in told["figures"])
        written.append(contents(tmp_path / name))
    assert written[0] == written[1]
    text = written[0]["results.md"].decode()
    linked = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text)
    assert sorted(linked) == sorted(name for name in written[0] if name != "results.md")
    assert "results/few-trajectories.png" in linked
    assert "<picture" not in text
    for said in ("0123abc", "A processor", "2026-01-02T03:04:05", "dream bench paper", "As published"):
        assert said in text


@pytest.mark.usefixtures("undrawn")
def test_folders_of_one_name_do_not_overwrite_each_other(tmp_path: Path) -> None:
    missions = [flown(FEW[0], "sixsteps", Made(60, 70))]
    folders = [write_bench(tmp_path / name / "paper", missions, FEW[:1], ["sixsteps"]) for name in "ab"]
    files = write_results(folders, tmp_path / "results.md", tmp_path / "pictures")
    assert len(files) == len(set(files))
    assert {path.name for path in files} >= {"paper-trajectories.png", "paper-2-trajectories.png"}


def test_a_sweep_is_one_picture_and_one_table(tmp_path: Path) -> None:
    sweep = tmp_path / "sweep"
    for reach in (10.0, 4.0):
        protocol = {"name": f"dream-v1-reach{reach:g}", "cap": 200, "reach": reach}
        missions = [
            flown(case, "sixsteps", Made(600 / reach, 190), protocol=str(protocol["name"])) for case in FEW
        ]
        write_bench(sweep / f"reach-{reach:g}", missions, FEW, ["sixsteps"], protocol=protocol)
    (picture,) = write_results([sweep], tmp_path / "results.md", tmp_path / "results")
    assert picture.name == "sweep-sweep.svg"
    text = (tmp_path / "results.md").read_text()
    four, ten = (
        next(line for line in text.splitlines() if f"| sixsteps | {r} |" in line) for r in ("4", "10")
    )
    assert "| 148.0 · 4/4 |" in four
    assert "| 59.0 · 4/4 |" in ten
    assert text.index(four) < text.index(ten)


def test_two_benchmarks_of_one_reach_are_no_sweep(tmp_path: Path) -> None:
    for name in "ab":
        few(tmp_path / name)
    with pytest.raises(ValueError, match="a reach of its own, got 8"):
        write_results([tmp_path], tmp_path / "results.md", tmp_path / "results")


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["nowhere"], "nowhere: expected a folder of dream bench or dream sweep"),
        (["nowhere", "--out", "page.html"], "--out: expected a name that ends in .md"),
        ([], "folders"),
    ],
)
def test_bad_arguments_are_one_line(
    arguments: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["results", *arguments]) == 2
    printed = capsys.readouterr()
    assert complaint in printed.err
    assert len(printed.err.strip().splitlines()) == 1


@pytest.mark.rare
def test_tables_are_made_without_matplotlib() -> None:
    code = "import sys, dream.evaluation.report, dream.cli; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
