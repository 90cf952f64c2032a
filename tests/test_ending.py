"""Why a mission ended, in words."""

from __future__ import annotations

import errno
import itertools
import os
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from dream.cli import run_command
from dream.ending import MOST, TERMINATED, WORDS, also, asked_to_end, reason, why
from dream.errors import MissionAborted
from dream.evaluation.runner import Flight, fly
from dream.evaluation.suites import named_case
from dream.planning import PLANNERS
from dream.recording import read_steps, read_summary
from dream.robots import Teleport
from dream.types import Arrival, Setpoint

NO_SPACE = os.strerror(errno.ENOSPC)
FULL = OSError("could not write step 3 (No space left on device)")


@pytest.mark.parametrize(
    ("stopped", "said"),
    [
        (MissionAborted("dive: water in the hull"), "dive: water in the hull"),
        (KeyboardInterrupt(), "interrupted"),
        (KeyboardInterrupt(TERMINATED), f"interrupted: {TERMINATED}"),
        (RuntimeError("the thruster burns"), "the thruster burns"),
        (TimeoutError(), "TimeoutError"),
        (KeyError("yaw"), "a fault of the program (KeyError: 'yaw')"),
        (
            ZeroDivisionError("division by zero"),
            "a fault of the program (ZeroDivisionError: division by zero)",
        ),
        (FULL, f"the disk is full: {FULL}"),
        (
            OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)),
            "the disk is full: [Errno 28] No space left on device",
        ),
        (OSError(errno.EIO, "Input/output error"), "[Errno 5] Input/output error"),
        (MissionAborted("two\n  lines"), "two lines"),
    ],
)
def test_whatever_stops_a_mission_is_said_in_a_line(stopped: BaseException, said: str) -> None:
    assert reason(stopped) == said


def test_what_went_wrong_because_of_it_follows_and_once() -> None:
    stopped = also(MissionAborted("dive: Lost manual control"), FULL)
    stopped = also(also(stopped, OSError("no link")), FULL)
    assert reason(stopped) == (
        "dive: Lost manual control; could not write step 3 (the disk is full); no link"
    )
    assert also(None, FULL) is FULL
    assert reason(also(OSError("could not write step 2 (No space left on device)"), FULL)).count("full") == 1


def test_a_reason_is_of_bounded_length_and_keeps_both_ends() -> None:
    said = reason(ValueError("begins " + 5000 * "x" + " ends"))
    assert len(said) <= MOST
    assert said.startswith("begins")
    assert said.endswith("ends")


@pytest.mark.parametrize(
    ("ended", "stopped", "said"),
    [
        ("done", None, "the planner held the mission to be complete and its map agreed"),
        ("cap", None, "all steps that it was given are spent"),
        ("", MissionAborted("no bottom track for long"), "no bottom track for long"),
        (
            "cap",
            OSError("could not write map.npz"),
            "all steps that it was given are spent; then could not write map.npz",
        ),
        ("", None, ""),
    ],
)
def test_why_a_mission_ended(ended: str, stopped: BaseException | None, said: str) -> None:
    assert why(ended, stopped) == said


def test_whoever_asks_the_program_to_end_is_told_apart_from_ctrl_c() -> None:
    before = signal.signal(signal.SIGTERM, asked_to_end)
    try:
        with pytest.raises(KeyboardInterrupt, match="SIGTERM"):
            signal.raise_signal(signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("stop", "said"),
    [
        (lambda: signal.raise_signal(signal.SIGINT), "interrupted"),
        (lambda: signal.raise_signal(signal.SIGTERM), f"interrupted: {TERMINATED}"),
        (lambda: raising(MissionAborted("navigation: lost; it surfaced")), "navigation: lost; it surfaced"),
        (lambda: raising(IndexError("list")), "a fault of the program (IndexError: list)"),
    ],
)
def test_a_run_that_is_stopped_says_why_in_its_folder(
    stop: Callable[[], object],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    go_to, moves = Teleport.go_to, itertools.count()

    def stopping(self: Teleport, setpoint: Setpoint) -> Arrival:
        if next(moves) == 2:
            stop()
        return go_to(self, setpoint)

    monkeypatch.setattr(Teleport, "go_to", stopping)
    assert run_command(["run", "--world", "flat/empty", "--out", str(tmp_path)]) == 1
    folder = tmp_path / (tmp_path / "latest").readlink()
    summary, page = read_summary(folder), (folder / "report.html").read_text()
    assert summary is not None
    assert (summary.ended, summary.why, read_steps(folder)[-1].why) == ("aborted", said, said)
    assert page.count(f'"why":"{said}"') == 2
    printed = capsys.readouterr()
    assert f"aborted after 2 steps\n  why: {said}\n" in printed.out
    assert printed.err.splitlines()[-1].startswith(f"dream: aborted: {said}; 2 steps are kept in {folder}")
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def raising(error: Exception) -> None:
    raise error


@pytest.mark.parametrize("recorded", [False, True])
def test_a_mission_of_a_benchmark_that_is_aborted_says_why_in_its_row(
    recorded: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_to, moves = Teleport.go_to, itertools.count()

    def stopping(self: Teleport, setpoint: Setpoint) -> Arrival:
        if next(moves) == 1:
            raise MissionAborted("navigation: diverged; it surfaced")
        return go_to(self, setpoint)

    monkeypatch.setattr(Teleport, "go_to", stopping)
    flight = Flight(named_case("flat/empty", 1), "random", PLANNERS["random"], "dream-v1")
    flown = fly(replace(flight, record_to=tmp_path / "run") if recorded else flight)
    assert (flown.row.ended, flown.row.why) == ("aborted", "navigation: diverged; it surfaced")
    if recorded:
        assert read_steps(tmp_path / "run")[-1].why == flown.row.why


def test_a_mission_that_runs_out_of_steps_says_so(tmp_path: Path) -> None:
    assert run_command(["run", "--world", "flat/empty", "--max-steps", "2", "--out", str(tmp_path)]) == 0
    folder = tmp_path / (tmp_path / "latest").readlink()
    summary = read_summary(folder)
    assert summary is not None
    assert (summary.why, read_steps(folder)[-1].why) == (WORDS["cap"], WORDS["cap"])
