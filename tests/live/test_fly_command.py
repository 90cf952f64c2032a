"""`dream fly`: what it leaves, whatever ends it, and how it becomes a row."""

from __future__ import annotations

import json
import re
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("fastapi")
pytest.importorskip("uvicorn")

from dream.cli import run_command
from dream.evaluation.engines import Processes
from dream.evaluation.results import read_results
from dream.evaluation.runner import Plan, fly_plan
from dream.evaluation.suites import Case
from dream.extras import missing
from dream.planning import PLANNERS
from dream.protocol import DREAM_V1
from dream.recording import read_config, read_steps, read_summary
from tests.live.flying import WAIT_S, Browser
from tests.live.test_commands import started

FLAT = ("fly", "--world", "flat/empty", "--port", "0", "--json")


def opened(mission: subprocess.Popen[str]) -> Browser:
    """The page of a mission, as soon as its address is told."""
    assert mission.stderr is not None
    for line in mission.stderr:
        if found := re.search(r"fly at http://127\.0\.0\.1:(\d+)/\?token=([\w-]{32,})$", line.strip()):
            browser = Browser(int(found[1]))
            assert browser.open(found[2]) == 200
            return browser
    raise AssertionError(f"no address, exit status {mission.wait(WAIT_S)}")


def flown(*words: str, steps: int) -> tuple[dict[str, Any], str]:
    """Fly that many steps to the end of the mission: its summary, and what it said."""
    mission = started(*words)
    browser = opened(mission)
    for step in range(4, 4 + steps):
        browser.awaited(step)
        assert browser.post("/decide", {"step": step, "turn_deg": 30, "advance_m": 1})[0] == 204
    told, said = mission.communicate(timeout=WAIT_S)
    assert mission.returncode == 0, said
    summary: dict[str, Any] = json.loads(told)
    return summary, said


@pytest.mark.rare
@pytest.mark.slow
def test_it_leaves_a_run_that_can_be_flown_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = (*FLAT, "--out", str(tmp_path), "--max-steps", "5", "--name", "ann")
    summary, _ = flown(*words, steps=2)
    assert (summary["planner"], summary["ended"], summary["steps"]) == ("human+ann", "cap", 5)
    folder = tmp_path / "latest"
    config, steps = read_config(folder), read_steps(folder)
    assert config.planner == "human+ann"
    assert config.command.startswith("dream fly --world flat/empty --seed 1")
    assert all(step.planner_ms > 0.0 for step in steps[4:])  # The person's time,
    assert all(step.waited_s == 0.0 for step in steps)  # and none of the mission's.
    assert "human+ann" in (folder / "report.html").read_text(encoding="utf-8")
    assert run_command(["replay", str(folder), "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert (again["planner"], again["agree"], again["steps"]) == ("human", 5, 5)
    assert again["farthest_m"] == 0.0


@pytest.mark.rare
@pytest.mark.slow
def test_ctrl_c_keeps_all(tmp_path: Path) -> None:
    mission = started(*FLAT, "--out", str(tmp_path))
    browser = opened(mission)
    browser.awaited(4)
    assert browser.post("/decide", {"step": 4, "turn_deg": 30})[0] == 204
    browser.awaited(5)
    mission.send_signal(signal.SIGINT)
    over = browser.until(lambda told: "outcome" in told)
    assert over["outcome"][0].startswith("It was stopped after 4 steps.")
    _, said = mission.communicate(timeout=WAIT_S)
    assert mission.returncode == 1
    assert "aborted: interrupted; 4 steps are kept in" in said
    summary = read_summary(tmp_path / "latest")
    assert summary is not None
    assert (summary.ended, summary.steps) == ("aborted", 4)
    assert (tmp_path / "latest/report.html").exists()


@pytest.mark.rare
@pytest.mark.slow
def test_a_mission_becomes_a_row_beside_those_of_planners_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bench, cases = tmp_path / "bench", (Case("flat/empty", 1), Case("flat/empty", 2))
    plan = Plan("two", cases, {"random": PLANNERS["random"]}, DREAM_V1, 5)
    assert len(list(fly_plan(plan, bench, Processes(1)))) == 2
    words = (*FLAT, "--protocol", "dream-v1", "--out", str(tmp_path / "runs"), "--bench", str(bench))
    same = (*words, "--max-steps", "5", "--name", "ann")
    summary, _ = flown(*same, steps=2)
    results = read_results(bench)
    assert [(row.planner, row.seed) for row in results.rows] == [
        *(("random", 1), ("human+ann", 1), ("random", 2)),
    ]
    row = results.rows[1]
    assert (row.ended, row.steps, row.distance_m) == ("cap", 5, summary["distance_m"])
    assert len(results.traces[row.key]) == 6
    assert results.manifest["suite"] == "two"
    assert "human+ann is a person (dream fly)" in (bench / "report.html").read_text(encoding="utf-8")
    # Whoever knows a world flies it no more; and by other rules it is no row beside these.
    assert run_command(list(same)) == 2
    assert "expected a world that human+ann has not flown in" in capsys.readouterr().err
    assert run_command([*words, "--max-steps", "6"]) == 2
    assert "max_steps: expected 5 as for the missions in it, got 6" in capsys.readouterr().err
    assert len(list((tmp_path / "runs").glob("2*"))) == 1


def test_without_what_it_needs_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.chdir(tmp_path)
    assert run_command(["fly"]) == 2
    assert missing("live", "fastapi", "a live page") in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--name", "a name"], "--name: expected at most 40 letters, digits, dots and dashes, got 'a name'"),
        (["--name", ""], "--name: expected"),
        (["--port", "70000"], "--port: expected 0 to 65535"),
        (["--host", "no-such-host.invalid"], "--host, --port: expected a place to listen at"),
        (["--protocol", "dream-v9"], "dream-v9"),
        (["--max-steps", "0"], "--max-steps: expected at least 1"),
        (["--start", "99"], "start: expected 0 to"),
    ],
)
def test_what_cannot_be_flown_is_told_in_a_line_and_leaves_nothing(
    options: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "runs"
    assert run_command(["fly", "--world", "flat/empty", "--out", str(out), *options]) == 2
    assert told in capsys.readouterr().err
    assert not out.exists()


def test_its_help_says_what_the_person_sees(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["fly", "--help-all"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "nothing of the truth" in text
    assert "human+NAME" in text
    assert "--bench" in text
