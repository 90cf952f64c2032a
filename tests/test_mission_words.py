"""From an operator's words to a mission that is flown: a server on this machine plays the model."""

from __future__ import annotations

import io
import json
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from dream.cli import run_command
from dream.commands.mission import draw_orders
from dream.geometry import Bounds
from dream.mapping import OccupancyMap
from dream.mapping.drawing import OUTLINE
from dream.orders import Leg, Orders, Side, SideOf, Task, written
from dream.planning.vlm import Dream
from dream.planning.vlm.orders import (
    read_mission,
    read_orders,
)
from dream.protocol import DREAM_V1, SurveyProtocol
from dream.recording import read_config, read_steps
from dream.report import repeating_command
from dream.types import Mission, Target
from tests.model_server import NAME, Server, serving
from tests.planning.flights import observed_at
from tests.planning.vlm.worded import BOX, NORTH, NORTHERN, ORDERS, WEST, WESTERN, leg, reply, will_say

PLANE = ("--protocol", "dream-v1")


@pytest.fixture
def model() -> Iterator[Server]:
    with serving() as server:
        yield server


def test_the_picture_says_of_an_area_that_has_no_place_yet_that_it_is_not_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[Any] = []

    def drawing(bounds: Bounds, protocol: SurveyProtocol, areas: Any, lines: Any) -> Image.Image:
        told.extend((areas, lines))
        return Image.new("RGB", (1, 1))

    monkeypatch.setattr("dream.mapping.drawing.draw_areas", drawing)
    draw_orders(ORDERS, BOX, DREAM_V1, tmp_path / "mission.png")
    areas, lines = told
    assert areas == [BOX, None, Bounds(-3.5, 0.0, 4.0, 8.0), Bounds(-20.0, -20.0, 20.0, 0.0)]
    assert lines[1].endswith("up to 10 m from it. Where that is, is not known yet.")
    assert [line.endswith("known yet.") for line in lines] == [False, True, False, False, False]


def said(capsys: pytest.CaptureFixture[str]) -> str:
    printed = capsys.readouterr()
    return printed.out + printed.err


def mission(model: Server, text: str, *options: str) -> int:
    return run_command(["mission", text, "--model", model.address, "--model-name", NAME, *options])


@pytest.mark.rare
def test_half_the_world_in_eighty_steps_from_words_to_the_end(
    model: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    will_say(model, {**WEST, "left_out": "nothing\x1b[2J"})
    file = tmp_path / "mission.json"
    assert mission(model, WESTERN, "--world", "reef/string", *PLANE, "--out", str(file), "--yes") == 0
    told = said(capsys)
    assert "1. Map all targets in the western half of the survey area." in told
    assert "At most 80 steps in all." in told
    assert "Not in the orders, says the model: nothing\\x1b[2J" in told
    assert f"Asked scripted at {model.address}: calls 1, tokens 110, at an unknown price." in told
    with Image.open(tmp_path / "mission.png") as picture:
        assert (np.asarray(picture) == OUTLINE).all(axis=-1).any()

    runs = tmp_path / "runs"
    assert (
        run_command(["run", "lawnmower", *PLANE, "--mission", str(file), "--out", str(runs), "--json"]) == 0
    )
    summary = json.loads(capsys.readouterr().out)
    assert summary["steps"] <= 80
    (leg_flown,) = summary["legs"]
    assert leg_flown["area"] == [-20.0, -20.0, 0.0, 20.0]
    steps = read_steps(runs / "latest")
    assert {step.leg for step in steps} == {1}

    # The run's own command flies it again, to the same end.
    config = read_config(runs / "latest")
    assert config.orders == written(read_mission(file)[1])
    assert config.words == WESTERN
    assert config.understood == (
        "1. Map all targets in the western half of the survey area.",
        "At most 80 steps in all.",
    )
    # The run's folder holds them by itself.
    assert read_mission(runs / "latest" / "mission.json") == read_mission(file)
    assert (runs / "latest" / "mission.png").read_bytes() == (tmp_path / "mission.png").read_bytes()
    page = (runs / "latest" / "report.html").read_text()
    assert f'"words":"{WESTERN}"' in page
    program, *arguments = shlex.split(repeating_command(config))
    again = tmp_path / "again"
    assert run_command([*arguments, "--out", str(again), "--json"]) == 0
    assert [step.pose for step in read_steps(again / "latest")] == [step.pose for step in steps]
    assert program == "dream"


@pytest.mark.rare
def test_a_wreck_is_found_and_its_north_side_mapped_from_words_to_the_end(
    model: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, world = tmp_path / "mission.json", ["--world", "wreck/1", *PLANE]
    will_say(model, NORTH)
    assert mission(model, NORTHERN, *world, "--out", str(file), "--yes") == 2
    assert "The labels of this world know one kind of target" in said(capsys)
    assert not file.exists()

    will_say(model, reply(leg("find", "wreck"), leg("map", "any", "side", side="north", of_leg=1)))
    text = "find the wreck, then map whatever is on its north side"
    assert mission(model, text, *world, "--out", str(file), "--yes", "--json") == 0
    printed = capsys.readouterr()
    assert read_orders(printed.out) == read_mission(file)[1]
    assert "2. Map all targets on the north side of what leg 1 found" in printed.err
    runs = tmp_path / "runs"
    command = ["run", "sixsteps", *world, "--mission", str(file), "--out", str(runs), "--json"]
    assert run_command(command) == 0
    summary = json.loads(capsys.readouterr().out)
    assert [one["outcome"] for one in summary["legs"]] == ["found", "mapped"]
    flown = [step.leg for step in read_steps(runs / "latest")]
    first, second = (one["steps"] for one in summary["legs"])
    assert flown == [1] * (first + 1) + [2] * second


class Terminal(io.StringIO):
    """Standard input where an operator sits."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("typed", "status"), [("y\n", 0), ("n\n", 1), ("\n", 1), ("", 1)])
def test_at_a_terminal_the_operator_is_asked(
    model: Server,
    typed: str,
    status: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    will_say(model, WEST)
    monkeypatch.setattr("sys.stdin", Terminal(typed))
    file = tmp_path / "mission.json"
    assert mission(model, WESTERN, "--world", "flat/empty", "--out", str(file)) == status
    told = said(capsys)
    assert "Keep these orders? [y/N]" in told
    assert "Fly this?" not in told
    assert f"drawn in {tmp_path / 'mission.draft.png'}, until you answer" in told
    kept = {"mission.json", "mission.png"} if status == 0 else set()
    assert {path.name for path in tmp_path.iterdir()} == kept


class Watched(Terminal):
    """An operator who looks at the picture before answering."""

    picture = Path()
    seen = False

    def readline(self, size: int = -1, /) -> str:  # type: ignore[override]
        with Image.open(self.picture) as picture:
            self.seen = bool((np.asarray(picture) == OUTLINE).all(axis=-1).any())
        return super().readline(size)


def test_the_areas_can_be_looked_at_while_the_operator_is_asked(
    model: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    will_say(model, WEST)
    operator = Watched("no\n")
    operator.picture = tmp_path / "mission.draft.png"
    monkeypatch.setattr("sys.stdin", operator)
    assert mission(model, WESTERN, "--out", str(tmp_path / "mission.json")) == 1
    assert operator.seen
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("mission.json", '{"mine": 1}', "got {out}, which holds something else. Choose another name"),
        ("mission.png", "mine", "expected a name without a picture beside it, got {out}"),
    ],
)
def test_a_file_of_somebodys_own_is_not_written_over_and_no_model_is_asked(
    name: str, content: str, words: str, model: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, own = tmp_path / "mission.json", tmp_path / name
    own.write_text(content)
    assert mission(model, WESTERN, "--yes", "--out", str(out)) == 2
    assert words.format(out=out) in said(capsys)
    assert own.read_text() == content
    assert model.asked == []


def test_the_same_mission_may_be_written_again_but_other_orders_are_kept(
    model: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mission.json"
    will_say(model, WEST, WEST, WEST)
    for _ in range(2):
        assert mission(model, WESTERN, "--yes", "--out", str(out)) == 0
    edited = out.read_text().replace("80", "70")
    out.write_text(edited)
    assert mission(model, WESTERN, "--yes", "--out", str(out)) == 2
    assert f"got {out}, which holds something else" in said(capsys)
    assert out.read_text() == edited


def test_a_mission_that_cannot_be_written_is_not_asked_for(
    model: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    will_say(model, WEST)
    (tmp_path / "file").write_text("in the way")
    for out, complaint in (
        (tmp_path / "file" / "mission.json", "--out: expected a place that can be written, got"),
        (Path("/proc/nowhere/mission.json"), "got /proc/nowhere (No such file or directory)"),
        (tmp_path, "--out: expected a file, got the folder"),
        (tmp_path / "mission", "--out: expected a name that ends in .json, got"),
    ):
        assert mission(model, WESTERN, "--yes", "--out", str(out)) == 2
        told = said(capsys)
        assert complaint in told
        assert "Errno" not in told
    assert model.asked == []


def test_a_run_from_words_asks_whether_to_fly(
    model: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    will_say(model, WEST)
    monkeypatch.setattr("sys.stdin", Terminal("n\n"))
    words = ["--mission", WESTERN, "--out", str(tmp_path), "--world", "flat/empty"]
    options = ["--model", model.address, "--model-name", NAME]
    assert run_command(["run", "dream", *options, *words]) == 1
    assert "Fly this? [y/N]" in said(capsys)
    assert list(tmp_path.iterdir()) == []


def test_without_a_terminal_and_without_yes_nothing_is_asked(
    model: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    will_say(model, WEST)
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    assert mission(model, WESTERN, "--out", str(tmp_path / "mission.json")) == 2
    assert "Nobody can confirm without a terminal" in said(capsys)
    assert model.asked == []


def test_a_model_that_is_missing_is_told_before_a_terminal_that_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert run_command(["mission", WESTERN, "--out", str(tmp_path / "mission.json")]) == 2
    assert said(capsys).startswith("dream: model: expected which model to ask, got none. Say --model ")


def test_plain_words_need_a_planner_that_asks_a_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["run", "lawnmower", "--mission", WESTERN, "--out", str(tmp_path / "runs")]) == 2
    assert "this planner asks no model" in said(capsys)
    assert not (tmp_path / "runs").exists()


def test_a_planner_that_asks_a_model_takes_plain_words(
    model: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from dream.commands import run
    from dream.commands.console import open_world

    will_say(model, WEST)
    planner = Dream(**model.options)
    world = open_world("reef/string", 1)
    words, orders = run._orders(WESTERN, planner, world, DREAM_V1, None)
    assert words == WESTERN
    assert orders == Orders((Leg(Target.ANY, Task.MAP, SideOf(Side.WEST)),), 80)
    assert "western half" in said(capsys)


def test_a_model_that_flies_is_told_of_the_area_and_of_what_was_flown_before(model: Server) -> None:
    planner, occupancy = Dream(**model.options), OccupancyMap(BOX, DREAM_V1)
    here = observed_at(0.0, 0.0, 0.0)
    plain = planner.begin(Mission(DREAM_V1, BOX, 200))._situation(here, occupancy)
    assert "3 steps are done; 197 are left" in plain
    assert "Only the area" not in plain
    west = Bounds(-20.0, -20.0, 0.0, 20.0)
    occupancy.restrict(west)
    told = planner.begin(Mission(DREAM_V1, BOX, 80, area=west, flown=11))._situation(here, occupancy)
    assert "11 steps are done; 69 are left" in told
    assert "Only the area from x = -20 to 0 m and from y = -20 to 20 m" in told


@pytest.mark.parametrize("name", ["mission.json", "folder"])
def test_a_mission_that_is_not_there_or_foreign_is_one_clear_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = str(tmp_path / "mission.json") if name == "mission.json" else '{"legs": 3}'
    assert run_command(["run", "lawnmower", "--mission", given]) == 2
    told = said(capsys)
    assert len(told.strip().splitlines()) == 1
    assert "Errno" not in told
    assert ("--mission: expected a file that dream mission wrote, got" in told) == (name == "mission.json")
