from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from numba.core.event import trigger_event

from dream import recording
from dream.compiling import COMPILES
from dream.live import folders
from dream.live.folders import Watched, WatchedRun
from dream.protocol import DREAM_V1
from dream.recording import MAX_LINE_BYTES, write_summary
from tests.live.runs import STEPS, Growing
from tests.recorded_runs import SUMMARY

Make = Callable[..., Growing]


def numbers(run: WatchedRun) -> list[int]:
    return [step.number for step in run.steps]


def only(watched: Watched) -> WatchedRun:
    watched.look()
    (run,) = watched
    return run


@pytest.fixture(autouse=True)
def _look_for_runs_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folders, "LIST_S", 0.0)


def test_steps_come_as_they_are_written_and_none_twice(growing: Make) -> None:
    made = growing()
    watched = Watched([made.folder])
    for count in range(STEPS + 1):
        assert numbers(only(watched)) == list(range(count))
        made.write()
    assert numbers(only(watched)) == list(range(STEPS))


@pytest.mark.parametrize("count", [1, 2, STEPS - 1])
def test_the_last_line_is_read_again_once_it_says_why_no_other_follows(count: int, growing: Make) -> None:
    made = growing().write(count)
    run = only(Watched([made.folder]))
    write_summary(made.folder, {**SUMMARY, "ended": "aborted", "why": "water in the hull"})
    run.look()
    assert numbers(run) == list(range(count))
    assert (run.problem, run.steps[-1].whole["why"]) == ("", "water in the hull")
    assert run.summary is not None
    assert run.summary.why == "water in the hull"
    run.look()
    assert numbers(run) == list(range(count))


def test_a_line_counts_once_it_is_whole(growing: Make) -> None:
    made = growing().write(2)
    watched = Watched([made.folder])
    for cut in (1, 200, len(made.lines[2]) - 1):
        torn = growing(f"torn-{cut}").write(2)
        torn.append(torn.lines[2][:cut])
        run = only(Watched([torn.folder]))
        assert numbers(run) == [0, 1]
        assert run.problem == ""
        torn.append(torn.lines[2][cut:])
        run.look()
        assert numbers(run) == [0, 1, 2]
    assert numbers(only(watched)) == [0, 1]


def test_what_cannot_be_read_just_now_is_read_later(growing: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    made = growing().write(2)
    watched = Watched([made.folder])
    run = only(watched)
    made.write()
    opened = Path.open

    def fails(self: Path, *arguments: Any, **options: Any) -> Any:
        if self.name == "steps.jsonl":
            raise OSError(errno.EIO, "Input/output error", str(self))
        return opened(self, *arguments, **options)

    with monkeypatch.context() as broken:
        broken.setattr(Path, "open", fails)
        for _ in range(2):
            run.look()
            assert "Input/output error" in run.problem
    version = run.version
    run.look()
    assert (numbers(run), run.problem) == ([0, 1, 2], "")
    assert run.version > version, "that it is well again is told"


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (b"{nonsense}\n", "steps.jsonl, line 3: expected one JSON object"),
        (b'{"step": 2}\n', "steps.jsonl, line 3: time"),
        (b"x" * (MAX_LINE_BYTES + 1), "expected at most"),
        (b"\xff\xfe\n", "line 3"),
        (b'{"step": 2, "more": [{"of it": 1e999}]}\n', "steps.jsonl, line 3: expected finite numbers"),
    ],
)
def test_damage_is_told_and_what_came_before_stays(growing: Make, damage: bytes, told: str) -> None:
    made, other = growing("damaged").write(2), growing("other").write(3)
    made.append(damage)
    made.append(made.lines[2])
    watched = Watched([made.folder, other.folder])
    watched.look()
    damaged, sound = watched
    assert numbers(damaged) == [0, 1]
    assert told in damaged.problem
    assert str(made.folder) not in damaged.problem
    assert numbers(sound) == [0, 1, 2]
    assert sound.problem == ""


def test_a_step_that_goes_back_is_damage(growing: Make) -> None:
    made = growing().write(3)
    made.append(made.lines[1])
    assert "expected a step after 2, got 1" in only(Watched([made.folder])).problem


def test_a_folder_that_got_shorter_is_another_run(growing: Make) -> None:
    made = growing().write(4)
    watched = Watched([made.folder])
    assert len(only(watched).steps) == 4
    os.truncate(made.folder / "steps.jsonl", 10)
    assert "Another run?" in only(watched).problem


def test_how_it_ended_is_known_once_all_steps_are(growing: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    made = growing().write(STEPS)
    made.end()
    monkeypatch.setattr(folders, "READ_BYTES", max(map(len, made.lines)) + 1)
    run = only(Watched([made.folder]))
    seen = []
    while run.summary is None:
        seen.append(len(run.steps))
        assert run.behind
        run.look()
    assert seen == sorted(set(seen))
    assert not run.behind
    assert numbers(run) == list(range(STEPS))


def test_a_long_run_is_not_behind_for_ever_once_it_is_found_damaged(
    growing: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = growing().write(3)
    made.append(b"{nonsense}\n")
    monkeypatch.setattr(folders, "READ_BYTES", max(map(len, made.lines)) + 1)
    run = only(Watched([made.folder]))
    assert run.behind
    for _ in range(5):
        run.look()
    assert "line 4" in run.problem
    assert not run.behind


def test_runs_that_are_not_there_yet_appear(growing: Make, tmp_path: Path) -> None:
    place = tmp_path / "runs"
    watched = Watched([place])
    watched.look()
    assert list(watched) == []
    assert watched.waiting() == ["runs"]
    growing("one").write(1)
    assert only(watched).folder.name == "one"
    assert watched.waiting() == []
    (place / "latest").symlink_to("one")
    (place / "no run").mkdir()
    growing("two")
    os.utime(place / "one" / "config.json", (1, 1))
    watched.look()
    assert [run.folder.name for run in watched] == ["two", "one"]


def test_what_was_read_of_a_run_stays_while_others_come_and_go(growing: Make, tmp_path: Path) -> None:
    made = growing("one").write(2)
    watched = Watched([tmp_path / "runs"])
    first = only(watched)
    gone = growing("two")
    watched.look()
    assert first in list(watched)
    for path in sorted(gone.folder.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    gone.folder.rmdir()
    assert only(watched) is first
    made.write()
    assert numbers(only(watched)) == [0, 1, 2]


def test_the_newest_of_too_many_are_shown(
    growing: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folders, "MAX_RUNS", 2)
    for age, name in enumerate(("new", "older", "oldest")):
        made = growing(name)
        os.utime(made.folder / "config.json", (1000 - age, 1000 - age))
    watched = Watched([tmp_path / "runs"])
    watched.look()
    assert [run.folder.name for run in watched] == ["new", "older"]
    assert watched.left_out == 1


def test_the_latest_is_the_run_that_it_points_to(growing: Make, tmp_path: Path) -> None:
    made = growing("one").write(1)
    (tmp_path / "runs" / "latest").symlink_to("one")
    run = only(Watched([tmp_path / "runs" / "latest"]))
    assert run.folder == made.folder.resolve()
    assert Watched([tmp_path / "runs" / "latest"]).waiting() == ["latest"]


@pytest.mark.parametrize("name", ["config.json", "steps.jsonl", "summary.json"])
def test_a_link_out_of_the_folder_is_not_followed(growing: Make, tmp_path: Path, name: str) -> None:
    made = growing().write(2)
    made.end()
    elsewhere = tmp_path / "elsewhere"
    (made.folder / name).rename(elsewhere)
    (made.folder / name).symlink_to(elsewhere)
    run = only(Watched([made.folder]))
    assert f"{name}: expected a file of the run" in run.problem
    assert run.head()["summary"] is None


def test_only_files_of_the_folder_are_given(growing: Make, tmp_path: Path) -> None:
    made = growing().write(2)
    run = only(Watched([made.folder]))
    assert run.file("frames/0000_rgb.png") is not None
    assert run.file("frames/0099_rgb.png") is None
    assert run.file("frames") is None
    (tmp_path / "secret.png").write_bytes(b"secret")
    (made.folder / "frames/0001_rgb.png").unlink()
    (made.folder / "frames/0001_rgb.png").symlink_to(tmp_path / "secret.png")
    assert run.file("frames/0001_rgb.png") is None
    (made.folder / "frames").rename(tmp_path / "moved")
    (made.folder / "frames").symlink_to(tmp_path / "moved")
    assert run.file("frames/0000_rgb.png") is None


def test_a_pipe_in_the_place_of_a_file_does_not_hold_it_up(growing: Make) -> None:
    made = growing()
    (made.folder / "steps.jsonl").unlink()
    os.mkfifo(made.folder / "steps.jsonl")
    assert "steps.jsonl: expected a file" in only(Watched([made.folder])).problem


@pytest.mark.parametrize(
    ("config", "cap"),
    [
        ({}, DREAM_V1.cap),
        ({"max_steps": 9}, 9),
        ({"max_steps": 900}, 900),
        ({"orders": {"max_steps": 7}}, 7),
        ({"protocol": "another"}, None),
    ],
)
def test_the_budget_of_steps_is_that_of_the_mission(
    growing: Make, config: dict[str, object], cap: int
) -> None:
    assert only(Watched([growing(**config).folder])).head()["cap"] == cap


def test_what_questions_cost_is_read_from_what_was_kept(growing: Make) -> None:
    made = growing()
    asked = {"prompt": "p", "fallback": "", "requests": 2}
    for step, line in enumerate(made.lines[:3]):
        made.append(json.dumps({**json.loads(line), "asked": None if step == 0 else asked}).encode() + b"\n")
    (made.folder / "replies").mkdir()
    kept = {
        **dict.fromkeys(("prompt", "model", "question", "fallback"), ""),
        **dict.fromkeys(("pictures", "replies"), ()),
        "requests": 2,
        "tokens_in": 5,
        "tokens_out": 2,
        "cost_usd": 0.25,
        "seconds": 1.0,
    }
    (made.folder / "replies/0001.json").write_text(json.dumps(kept))
    run = only(Watched([made.folder]))
    assert [step.whole["spent"] for step in run.steps] == [None, {"tokens": 7, "cost_usd": 0.25}, None]
    assert not run.keeps_replies(2)


def test_what_stands_beside_others_is_brief(growing: Make) -> None:
    run = only(Watched([growing().write(STEPS).folder]))
    assert all("reasoning" in step.whole and "reasoning" not in step.brief for step in run.steps)
    assert run.steps[-1].brief["coverage"] == run.steps[-1].whole["coverage"]


def test_looking_changes_nothing(growing: Make) -> None:
    made = growing().write(3)
    made.append(b'{"torn')

    def state() -> dict[Path, tuple[int, int]]:
        return {p: (p.stat().st_mtime_ns, p.stat().st_size) for p in made.folder.rglob("*")}

    before = state()
    only(Watched([made.folder.parent]))
    assert state() == before


def test_a_run_says_since_when_its_program_compiles(growing: Make) -> None:
    run = growing()
    watched = Watched([run.folder])
    watched.look()
    (shown,) = watched
    assert shown.head()["compiling_s"] is None
    version = shown.version
    with recording.compiling_noted(run.folder):
        with trigger_event(COMPILES):  # As numba does around a compilation.
            pass
        watched.look()
        assert shown.version > version
        assert 0.0 <= shown.head()["compiling_s"] < 60.0
    watched.look()
    assert shown.head()["compiling_s"] is None
    assert not (run.folder / recording.COMPILING).exists()
