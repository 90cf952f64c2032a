"""Progress: told by a clock of the test's own, which only goes on when it is told to."""

from __future__ import annotations

import io
from dataclasses import dataclass, field

import pytest
from numba.core.event import end_event, start_event
from rich.console import Console

from dream.commands import console, progress
from dream.commands.progress import Stage, Telling, stage, with_progress
from dream.compiling import COMPILES


@dataclass
class Clock:
    """A clock that stands still until it is moved."""

    now: float = 100.0
    lines: list[str] = field(default_factory=list)

    def __call__(self) -> float:
        """The time."""
        return self.now


@pytest.fixture
def clock() -> Clock:
    """One for a test."""
    return Clock()


@pytest.fixture
def told(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> Telling:
    """A command that has just begun, and tells nobody but the clock."""
    monkeypatch.setattr(progress, "EVERY", 10.0)
    made = Telling(clock.lines.append, clock)
    monkeypatch.setattr(progress, "_current", made)
    return made


def _wait(told: Telling, clock: Clock, seconds: float) -> None:
    """Let time pass, second by second."""
    for _ in range(round(seconds)):
        clock.now += 1.0
        told.tell_if_due()


def test_a_line_comes_after_ten_seconds_and_then_every_ten(told: Telling, clock: Clock) -> None:
    with stage("measuring", 60, "frames") as work:
        _wait(told, clock, 9)
        assert clock.lines == []
        work.done = 5
        _wait(told, clock, 1)
        assert clock.lines == ["dream: measuring: 5 of 60 frames after 10 s, about 2 min left"]
        work.done = 20
        _wait(told, clock, 10)
        assert clock.lines[1:] == ["dream: measuring: 20 of 60 frames after 20 s, about 40 s left"]
        _wait(told, clock, 35)
        assert len(clock.lines) == 5, "also while nothing is done"


def test_many_short_stages_are_told_of_as_one_long_one(told: Telling, clock: Clock) -> None:
    for name in "abcdefgh":
        with stage(name):
            _wait(told, clock, 3)
    assert clock.lines == ["dream: d: 1 s", "dream: g: 2 s"]


def test_the_innermost_stage_is_told(told: Telling, clock: Clock) -> None:
    with stage("outer", 3, "products"):
        with stage("inner"):
            _wait(told, clock, 10)
        _wait(told, clock, 10)
    _wait(told, clock, 30)
    assert clock.lines == ["dream: inner: 10 s", "dream: outer: 0 of 3 products after 20 s"]


def test_nothing_is_said_where_nothing_is_done(told: Telling, clock: Clock) -> None:
    _wait(told, clock, 60)
    assert clock.lines == []
    with stage("begins late"):
        _wait(told, clock, 1)
    assert clock.lines == ["dream: begins late: 1 s"]


def test_no_time_is_foretold_where_the_end_is_not_known(told: Telling, clock: Clock) -> None:
    for step in with_progress(range(3), "belief", 200, "steps", at_most=True):
        if step == 2:
            _wait(told, clock, 10)
    assert clock.lines == ["dream: belief: 2 of at most 200 steps after 10 s"]


def test_what_was_kept_takes_no_time() -> None:
    work = Stage("paper", 10, "missions", began=0.0, done=6, spared=4, said="4 of them kept")
    assert work.words(20.0) == "6 of 10 missions after 20 s, 4 of them kept, about 40 s left"


def test_a_long_time_is_told_in_minutes() -> None:
    assert Stage("", 12, "x", done=2).words(60.0) == "2 of 12 x after 60 s, about 5 min left"


def test_what_is_compiled_is_said(told: Telling, clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    with console.compiling_told(), stage("flying"):
        start_event(COMPILES)  # type: ignore[no-untyped-call]
        _wait(told, clock, 10)
        end_event(COMPILES)  # type: ignore[no-untyped-call]
        _wait(told, clock, 10)
    assert clock.lines == ["dream: flying: 10 s, compiling", "dream: flying: 20 s"]
    assert capsys.readouterr().err.count("compiling what was not used") == 1


def test_a_terminal_is_shown_all_stages(told: Telling, clock: Clock) -> None:
    drawn = Console(width=100, file=io.StringIO())
    with stage("writing products", 9, "products"), stage("mosaic", 40, "frames") as work:
        work.done = 10
        clock.now += 20.0
        drawn.print(told.drawn())
    lines = drawn.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert [line.split()[0] for line in lines] == ["writing", "mosaic"]
    assert lines[1].endswith("10 of 40 frames after 20 s, about 60 s left")
