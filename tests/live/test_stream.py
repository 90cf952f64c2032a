from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dream.live import folders, stream
from dream.live.folders import Watched
from dream.live.stream import Cursor
from tests.live.runs import STEPS, Growing

Make = Callable[..., Growing]


def told(chunks: list[bytes]) -> list[tuple[str, str, Any]]:
    """Name, position and data of each event."""
    events = []
    for event in b"".join(chunks).decode().split("\n\n")[:-1]:
        fields = dict(line.split(": ", 1) for line in event.split("\n"))
        events.append((fields["event"], fields["id"], json.loads(fields["data"])))
    return events


def steps_in(events: list[tuple[str, str, Any]]) -> list[tuple[str, int, int]]:
    return [(data["run"], data["index"], data["step"]["step"]) for name, _, data in events if name == "step"]


@pytest.fixture
def two(growing: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Watched:
    monkeypatch.setattr(folders, "LIST_S", 0.0)
    for name in ("one", "two"):
        growing(name).write(STEPS)
    watched = Watched([tmp_path / "runs" / name for name in ("one", "two")])
    watched.look()
    return watched


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(broken_after=st.lists(st.integers(0, 2 * STEPS + 3), max_size=5))
def test_a_page_that_comes_back_misses_nothing_and_gets_nothing_twice(
    two: Watched, broken_after: list[int]
) -> None:
    got, position = [], ""
    for count in [*broken_after, 10_000]:
        events = told(list(Cursor.at(position, "").news(two)))[:count]
        got += steps_in(events)
        position = events[-1][1] if events else position
    assert got == [(run.key, index, index) for run in two for index in range(STEPS)]


def test_steps_in_many_rounds_are_those_in_one(two: Watched, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "AT_ONCE", 2)
    cursor = Cursor()
    rounds: list[list[tuple[str, int, int]]] = []
    while cursor.is_behind(two) and len(rounds) < 100:
        rounds.append(steps_in(told(list(cursor.news(two)))))
    assert len(rounds) > 3
    assert max(map(len, rounds)) == 2
    assert [step for steps in rounds for step in steps] == [
        (run.key, index, index) for run in two for index in range(STEPS)
    ]
    assert list(cursor.news(two)) == []


def test_the_open_run_comes_whole_and_the_others_in_brief(two: Watched) -> None:
    _, second = two
    events = told(list(Cursor.at("", second.key).news(two)))
    for name, _, data in events:
        if name == "step":
            assert ("reasoning" in data["step"]) == (data["run"] == second.key)
    assert events[0][0] == "runs"
    assert [data["name"] for name, _, data in events if name == "run"] == ["one", "two"]


def test_news_comes_once(growing: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    made = growing().write(2)
    watched = Watched([made.folder])
    watched.look()
    cursor = Cursor()
    assert len(told(list(cursor.news(watched)))) == 4
    assert list(cursor.news(watched)) == []
    made.write()
    made.end(ended="cap")
    watched.look()
    events = told(list(cursor.news(watched)))
    assert sorted(name for name, _, _ in events) == ["run", "step"]
    assert next(data for name, _, data in events if name == "run")["summary"]["ended"] == "cap"


def test_a_run_made_anew_under_its_name_begins_again(two: Watched) -> None:
    first, _ = two
    events = told(list(Cursor.at(f"{first.key}.99", "").news(two)))
    assert ("again", "", {"run": first.key}) in events
    assert len(steps_in(events)) == 2 * STEPS


@pytest.mark.parametrize(
    "position", ["", "x", "../etc", "a" * 10_000, "12345678.1-", "12345678.-1", "1234567é.1"]
)
def test_what_is_no_position_begins_at_the_beginning(two: Watched, position: str) -> None:
    assert len(steps_in(told(list(Cursor.at(position, "").news(two))))) == 2 * STEPS


def test_a_run_that_is_no_longer_watched_leaves_the_position(two: Watched) -> None:
    cursor = Cursor.at("00000000.7", "")
    list(cursor.news(two))
    assert "00000000" not in cursor.position


def test_text_of_a_run_cannot_leave_its_event(growing: Make) -> None:
    made = growing(words="x\n\nevent: beat\ndata: {}\n\n \u2028 \r", planner="é")
    watched = Watched([made.folder])
    watched.look()
    events = told(list(Cursor().news(watched)))
    assert [name for name, _, _ in events] == ["runs", "run"]
    assert events[1][2]["config"]["words"].startswith("x\n\nevent: beat")


def test_a_beat_says_how_old_the_last_steps_are(two: Watched, growing: Make) -> None:
    name, _, data = told([Cursor().beat(two)])[0]
    assert name == "beat"
    assert all(0.0 <= age < 60.0 for age in data["ages"].values())
    empty = Watched([growing("empty").folder])
    empty.look()
    assert list(told([Cursor().beat(empty)])[0][2]["ages"].values()) == [None]
