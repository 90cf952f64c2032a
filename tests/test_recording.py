from __future__ import annotations

import contextlib
import errno
import itertools
import json
import logging
import math
import os
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from datetime import UTC, datetime
from io import FileIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np
import pytest
from PIL import Image

from dream import recording
from dream.ending import WORDS, reason
from dream.errors import MissionAborted
from dream.mapping import OccupancyMap
from dream.recording import (
    MAX_EXCHANGE_BYTES,
    MAX_LINE_BYTES,
    MAX_SHOWN_BYTES,
    ROOM_KEPT,
    new_run_folder,
    read_config,
    read_exchanges,
    read_steps,
    read_summary,
    record,
    room_kept,
    write_config,
    write_summary,
)
from dream.types import Decision, Exchange, Step
from tests.recorded_runs import (
    CONFIG,
    SUMMARY,
    Disk,
    asking_mission,
    exchange,
    painted_coverage,
    painted_mission,
)

NOW = datetime(2026, 11, 21, 6, 1, 9, tzinfo=UTC)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Step]]:
    folder = tmp_path_factory.mktemp("run")
    return folder, list(record(painted_mission(7), folder, annotate=painted_coverage))


def test_what_was_recorded_is_read_back(run: tuple[Path, list[Step]]) -> None:
    folder, steps = run
    recorded = read_steps(folder)
    assert [step.index for step in steps] == [line.step for line in recorded] == list(range(7))
    for step, line in zip(steps, recorded, strict=True):
        assert (line.pose.x, line.pose.y, line.pose.yaw) == (
            step.arrival.pose.x,
            step.arrival.pose.y,
            step.arrival.pose.yaw,
        )
        assert (line.decision.turn, line.decision.done) == (step.decision.turn, step.decision.done)
        assert line.guarded.advance == step.guarded.decision.advance
        assert line.guarded.note == step.guarded.note
        assert line.reasoning.safety == step.decision.reasoning.safety
        assert line.time == step.observation.time
        assert line.coverage is not None
        assert line.coverage.instances == painted_coverage(step)["coverage"]["instances"]
    assert recorded[-1].ended == "done"
    assert recorded[-1].map == steps[-1].occupancy.areas()


def test_an_unknown_clearance_is_null_and_no_line_holds_a_number_that_json_lacks(
    run: tuple[Path, list[Step]],
) -> None:
    folder, steps = run
    assert math.isinf(steps[0].arrival.clearance)
    lines = (folder / "steps.jsonl").read_text(encoding="utf-8").splitlines()
    assert json.loads(lines[0])["clearance_m"] is None
    assert not any(word in line for line in lines for word in ("NaN", "Infinity"))


def pixels_of(path: Path, mode: str) -> np.ndarray[Any, Any]:
    with Image.open(path) as picture:
        assert picture.mode == mode
        return np.array(picture)


def test_pictures_hold_colours_millimetres_and_labels(run: tuple[Path, list[Step]]) -> None:
    folder, steps = run
    seen = steps[3].observation
    assert (pixels_of(folder / "frames/0003_rgb.png", "RGB") == seen.rgb).all()
    assert (pixels_of(folder / "frames/0003_labels.png", "P") == seen.labels).all()
    depth = pixels_of(folder / "frames/0003_depth.png", "I;16") / 1000.0
    assert ((depth == 0.0) == np.isnan(seen.depth)).all()
    assert np.nanmax(np.abs(np.where(depth == 0.0, np.nan, depth) - seen.depth)) <= 0.0005 + 1e-6
    assert (folder / "maps/0003.png").stat().st_size > 0


def test_the_final_map_is_saved(run: tuple[Path, list[Step]]) -> None:
    folder, steps = run
    assert OccupancyMap.load(folder / "map.npz").areas() == steps[-1].occupancy.areas()


def test_every_line_is_on_disk_with_its_pictures_before_the_next_step(tmp_path: Path) -> None:
    for done, step in enumerate(record(painted_mission(3), tmp_path), start=1):
        assert len(read_steps(tmp_path)) == done
        assert len(list((tmp_path / "frames").iterdir())) == 3 * done
        assert (tmp_path / f"maps/{step.index:04d}.png").stat().st_size > 0


def test_a_run_that_is_left_early_keeps_its_steps_and_its_map(tmp_path: Path) -> None:
    steps = record(painted_mission(9), tmp_path)
    kept = list(itertools.islice(steps, 4))
    steps.close()
    assert len(read_steps(tmp_path)) == 4
    assert OccupancyMap.load(tmp_path / "map.npz").areas() == kept[-1].occupancy.areas()


@pytest.mark.parametrize("failure", [RuntimeError("thruster lost"), KeyboardInterrupt()])
def test_a_failure_passes_through_and_nothing_before_it_is_lost(
    tmp_path: Path, failure: BaseException
) -> None:
    def failing() -> Iterator[Step]:
        yield from painted_mission(3)
        raise failure

    with pytest.raises(type(failure)):
        list(record(failing(), tmp_path))
    assert len(read_steps(tmp_path)) == 3
    assert (tmp_path / "map.npz").exists()


ABORTED = {**SUMMARY, "ended": "aborted", "why": "dive: water in the hull", "success": False, "t_stop": None}


@pytest.mark.parametrize(
    "why", ["interrupted", 'camera: "the same picture"; \u2028 0 \\ {}', "no bottom track for long; " * 20]
)
def test_the_last_line_is_told_why_no_other_follows_and_is_the_same_else(why: str, tmp_path: Path) -> None:
    steps = record(painted_mission(5), tmp_path)
    list(itertools.islice(steps, 3))
    steps.close()
    before = (tmp_path / "steps.jsonl").read_bytes()
    for _ in range(2):  # Nor is it told twice.
        write_summary(tmp_path, {**ABORTED, "why": why})
    assert (tmp_path / "steps.jsonl").read_bytes()[: len(before) - 2] == before[:-2]
    recorded, lines = read_steps(tmp_path), (tmp_path / "steps.jsonl").read_text().splitlines()
    assert [step.why for step in recorded] == ["", "", why]
    # Nothing that an older reader knows has changed: it keeps fields that it does not know.
    assert [step.ended for step in recorded] == ["", "", ""]
    assert ['"why"' in line for line in lines] == [False, False, True]
    summary = read_summary(tmp_path)
    assert summary is not None
    assert summary.why == why


@pytest.mark.parametrize("tail", [b'{"step":4,"decision"', b"\n", b"nothing}\n", b"}\n", b"\x00" * 40])
def test_what_is_torn_behind_the_last_line_stays_as_it_is(tail: bytes, tmp_path: Path) -> None:
    steps = record(painted_mission(5), tmp_path)
    list(itertools.islice(steps, 3))
    steps.close()
    path = tmp_path / "steps.jsonl"
    torn = path.read_bytes() + tail
    path.write_bytes(torn)
    write_summary(tmp_path, ABORTED)
    assert path.read_bytes() == torn
    assert read_summary(tmp_path) is not None


@pytest.mark.parametrize("name", ["map.npz", "observations/0005.npz", "log.mcap"])
def test_why_it_ended_does_not_tell_where_the_folder_lay(name: str, tmp_path: Path) -> None:
    write_summary(tmp_path, {**ABORTED, "why": f"the disk is full: could not write {tmp_path / name} (none)"})
    summary = read_summary(tmp_path)
    assert summary is not None
    assert summary.why == f"the disk is full: could not write {name} (none)"


def test_a_mission_that_ends_by_itself_says_why_in_its_last_line_at_once(
    run: tuple[Path, list[Step]],
) -> None:
    folder, steps = run
    assert [step.why for step in read_steps(folder)] == [*[""] * (len(steps) - 1), WORDS["done"]]


def test_a_summary_of_before_there_were_reasons_is_read(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text(json.dumps(SUMMARY))
    summary = read_summary(tmp_path)
    assert summary is not None
    assert summary.why == ""


def test_without_room_for_the_reason_the_last_line_stays_and_the_summary_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = record(painted_mission(5), tmp_path)
    list(itertools.islice(steps, 3))
    steps.close()
    before = (tmp_path / "steps.jsonl").read_bytes()
    opened = Path.open

    class Full(FileIO):
        def write(self, data: Any) -> int:
            if len(data) > 2:
                if len(data) > 8:
                    return super().write(data[:8])
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return super().write(data)

    def full(path: Path, mode: str = "r", *arguments: Any, **options: Any) -> Any:
        return Full(path, mode) if mode == "r+b" else opened(path, mode, *arguments, **options)

    monkeypatch.setattr(Path, "open", full)
    write_summary(tmp_path, {**ABORTED, "why": "interrupted by an eel"})
    assert (tmp_path / "steps.jsonl").read_bytes() == before
    summary = read_summary(tmp_path)
    assert summary is not None
    assert summary.why == "interrupted by an eel"


@pytest.mark.parametrize("stop", [MissionAborted("water in the hull"), RuntimeError("thruster lost")])
def test_a_map_that_cannot_be_saved_takes_nothing_from_why_the_mission_stopped(
    stop: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(monkeypatch)

    def stopping() -> Iterator[Step]:
        yield from painted_mission(2)
        disk.full = True
        raise stop

    with pytest.raises(type(stop)) as caught:
        list(record(stopping(), tmp_path))
    said = reason(caught.value)
    assert said.startswith(f"{stop}; could not write")
    assert said.endswith("map.npz (the disk is full)")


def test_an_interrupt_stays_one_though_the_map_cannot_be_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    disk, steps = Disk(monkeypatch), record(painted_mission(5), tmp_path)

    def interrupted() -> None:
        with contextlib.closing(steps):
            for _ in steps:
                disk.full = True
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert "map.npz (No space left on device)" in caplog.text


@pytest.mark.parametrize("full", [False, True])
def test_room_for_a_summary_is_kept_without_a_trace_until_it_is_given_free(
    full: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Any] = []

    class Full(FileIO):
        def write(self, data: Any) -> int:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def making(**options: Any) -> Any:
        made.append(Full(os.devnull, "r+") if full else TemporaryFile(**options))  # noqa: SIM115 - see there.
        return made[0]

    monkeypatch.setattr(tempfile, "TemporaryFile", making)
    with room_kept(tmp_path) as give_free:
        assert list(tmp_path.iterdir()) == []
        assert full or os.fstat(made[0].fileno()).st_size == ROOM_KEPT
        give_free()
        assert made[0].closed
    assert list(tmp_path.iterdir()) == []


def interrupt_at(step: int, monkeypatch: pytest.MonkeyPatch, number: signal.Signals = signal.SIGINT) -> None:
    """Ctrl-C while the pictures of that step are about to be written."""
    write = recording._write_pictures

    def interrupted(now: Step, trail: list[tuple[float, float]], folder: Path) -> None:
        if now.index == step:
            signal.raise_signal(number)
        write(now, trail, folder)

    monkeypatch.setattr(recording, "_write_pictures", interrupted)


def test_a_step_that_was_annotated_is_written_whole_before_an_interrupt(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupt_at(2, monkeypatch)
    handler = signal.getsignal(signal.SIGINT)
    annotated: list[int] = []

    def annotate(step: Step) -> dict[str, Any]:
        annotated.append(step.index)
        return painted_coverage(step)

    with pytest.raises(KeyboardInterrupt):
        list(record(painted_mission(5), tmp_path, annotate=annotate))
    assert annotated == [line.step for line in read_steps(tmp_path)] == [0, 1, 2]
    for kind in ("rgb", "depth", "labels"):
        with Image.open(tmp_path / f"frames/0002_{kind}.png") as picture:
            picture.load()
    assert (tmp_path / "maps/0002.png").stat().st_size > 0
    assert (tmp_path / "map.npz").exists()
    assert signal.getsignal(signal.SIGINT) is handler


def test_an_interrupt_while_annotating_keeps_the_step_too(tmp_path: Path) -> None:
    def annotate(step: Step) -> dict[str, Any]:
        if step.index == 1:
            signal.raise_signal(signal.SIGINT)
        return painted_coverage(step)

    with pytest.raises(KeyboardInterrupt):
        list(record(painted_mission(5), tmp_path, annotate=annotate))
    assert [line.step for line in read_steps(tmp_path)] == [0, 1]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_handler_of_the_callers_own_hears_of_the_interrupt_when_the_step_is_written(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupt_at(1, monkeypatch, number)
    heard: list[int] = []
    before = signal.signal(number, lambda *_: heard.append(len(read_steps(tmp_path))))
    try:
        steps = list(record(painted_mission(3), tmp_path))
    finally:
        signal.signal(number, before)
    assert heard == [2]
    assert len(steps) == 3


def test_a_thread_records_as_well(tmp_path: Path) -> None:
    kept: list[Step] = []
    thread = threading.Thread(target=lambda: kept.extend(record(painted_mission(2), tmp_path)))
    thread.start()
    thread.join()
    assert len(kept) == len(read_steps(tmp_path)) == 2


def test_a_picture_that_cannot_be_written_leaves_no_line(tmp_path: Path) -> None:
    steps = record(painted_mission(3), tmp_path)
    next(steps)
    (tmp_path / "maps/0001.png").mkdir()
    with pytest.raises(OSError, match="could not write step 1"):
        next(steps)
    assert len(read_steps(tmp_path)) == 1


def test_a_disk_that_is_full_keeps_the_steps_before_and_nothing_that_is_not_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk, steps = Disk(monkeypatch), record(asking_mission(6), tmp_path)
    for _ in range(5):
        next(steps)
    disk.full = True
    with pytest.raises(OSError, match=r"^could not write step 5 \(No space left on device\)$"):
        next(steps)
    assert [step.step for step in read_steps(tmp_path)] == [0, 1, 2, 3, 4]
    files = {path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()}
    assert {path.name[:4] for path in files if path.parent != Path()} == {f"{n:04d}" for n in range(5)}
    assert {path for path in files if path.parent == Path()} == {Path("steps.jsonl")}


@pytest.mark.parametrize("name", ["map.npz", "summary.json", "config.json"])
def test_a_file_for_which_there_is_no_room_is_named_and_the_old_one_stays(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk, steps = Disk(monkeypatch), record(painted_mission(1), tmp_path)
    (tmp_path / name).write_text("old")
    next(steps)
    disk.full = True
    write: dict[str, Callable[[], object]] = {
        "map.npz": lambda: next(steps),
        "summary.json": lambda: write_summary(tmp_path, SUMMARY),
        "config.json": lambda: write_config(tmp_path, CONFIG),
    }
    with pytest.raises(OSError, match=rf"could not write .*{name} \(No space left on device\)"):
        write[name]()
    assert (tmp_path / name).read_text() == "old"
    assert not list(tmp_path.glob("*partial*"))
    assert not list(tmp_path.glob(".*"))
    disk.full = False
    steps.close()


def test_a_line_for_which_there_is_half_the_room_is_not_begun(tmp_path: Path) -> None:
    class Small(FileIO):
        def write(self, line: Any) -> int:
            room = 20 - self.tell()
            if not room:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return super().write(line[:room])

    path = tmp_path / "steps.jsonl"
    with Small(path, "w") as lines:
        recording._append(lines, b"a line of twelve\n")
        with pytest.raises(OSError, match="No space left"):
            recording._append(lines, b"a second\n")
    assert path.read_bytes() == b"a line of twelve\n"


def test_annotations_may_hold_numpy_numbers_but_not_the_name_of_a_field(tmp_path: Path) -> None:
    annotated: dict[str, Any] = {"found": np.int64(4), "share": np.float32(0.5), "ids": np.arange(3)}
    list(record(painted_mission(1), tmp_path, annotate=lambda step: annotated))
    line = read_steps(tmp_path)[0].model_dump()
    assert (line["found"], line["share"], line["ids"]) == (4, 0.5, [0, 1, 2])
    (tmp_path / "again").mkdir()
    with pytest.raises(ValueError, match="names of their own, got pose"):
        list(record(painted_mission(1), tmp_path / "again", annotate=lambda step: {"pose": 1}))


def test_a_folder_with_a_recording_is_not_written_over(run: tuple[Path, list[Step]]) -> None:
    with pytest.raises(ValueError, match=r"without steps\.jsonl"):
        record(painted_mission(1), run[0])


def lines_of(folder: Path, lines: list[str]) -> Path:
    (folder / "steps.jsonl").write_text("".join(lines), encoding="utf-8")
    return folder


def recorded_lines(run: tuple[Path, list[Step]]) -> list[str]:
    return (run[0] / "steps.jsonl").read_text(encoding="utf-8").splitlines(keepends=True)


@pytest.mark.parametrize("kept", [1, 60, -2])
def test_a_torn_last_line_is_dropped_with_a_warning(
    run: tuple[Path, list[Step]], tmp_path: Path, caplog: pytest.LogCaptureFixture, kept: int
) -> None:
    lines = recorded_lines(run)[:4]
    lines[-1] = lines[-1][:kept]
    with caplog.at_level(logging.WARNING):
        assert len(read_steps(lines_of(tmp_path, lines))) == 3
    assert "line 4 is torn" in caplog.text


@pytest.mark.parametrize(
    ("damaged", "told"),
    [
        ('{"step": 1, "ti\n', "line 2: expected one JSON object"),
        ("[]\n", "line 2: the whole"),
        ('{"step": 1}\n', "line 2: time: Field required"),
        ("x" * (MAX_LINE_BYTES + 1), "line 2: expected at most"),
        ("[" * 5000 + "\n", "line 2: expected one JSON object"),
    ],
)
def test_a_damaged_middle_line_is_an_error_that_names_it(
    run: tuple[Path, list[Step]], tmp_path: Path, damaged: str, told: str
) -> None:
    lines = recorded_lines(run)[:4]
    lines[1] = damaged
    with pytest.raises(ValueError, match=told):
        read_steps(lines_of(tmp_path, lines))


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("pose", {"x": "east", "y": 0, "yaw": 0}, "pose.x"),
        ("step", 1, "expected a step after 1, got 1"),
        ("ended", "exploded", "ended"),
        ("time", math.nan, "expected one JSON object"),
    ],
)
def test_a_line_with_a_wrong_field_is_an_error_that_names_both(
    run: tuple[Path, list[Step]], tmp_path: Path, field: str, value: Any, told: str
) -> None:
    lines = recorded_lines(run)[:4]
    lines[2] = json.dumps({**json.loads(lines[2]), field: value}) + "\n"
    with pytest.raises(ValueError, match=f"line 3: .*{told}"):
        read_steps(lines_of(tmp_path, lines))


def test_a_folder_that_is_no_run_says_so(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"expected a run folder, got no steps\.jsonl"):
        read_steps(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"config\.json"):
        read_config(tmp_path)
    assert read_summary(tmp_path) is None


def test_run_folders_are_named_by_time_world_and_planner_and_never_shared(tmp_path: Path) -> None:
    root = tmp_path / "runs"
    names = [new_run_folder(root, "reef/string", 3, "sixsteps", NOW).name for _ in range(3)]
    stem = "2026-11-21T06-01-09_reef-string-3_sixsteps"
    assert names == [stem, f"{stem}-2", f"{stem}-3"]
    assert (root / "latest").resolve().name == names[-1]


def test_no_name_of_a_world_leads_out_of_the_root(tmp_path: Path) -> None:
    folder = new_run_folder(tmp_path, "../../etc/passwd", 1, "a/../..", NOW)
    assert folder.parent == tmp_path
    assert folder.is_dir()


def test_a_file_of_the_user_called_latest_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "latest").write_text("mine")
    new_run_folder(tmp_path, "flat/empty", 1, "random", NOW)
    assert (tmp_path / "latest").read_text() == "mine"


def test_a_root_that_cannot_be_written_is_an_error_with_the_way_out(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OSError, match=r"expected a place that can be written.*--out"):
        new_run_folder(tmp_path / "file", "reef/string", 1, "random", NOW)
    with pytest.raises(OSError, match=r"expected a folder that can be written.*--out"):
        record(painted_mission(1), tmp_path / "nowhere")


def test_config_and_summary_are_read_back_with_whatever_else_they_hold(tmp_path: Path) -> None:
    write_config(tmp_path, {**CONFIG, "planner_parameters": {"standoff": 1.5}})
    write_summary(tmp_path, {**SUMMARY, "note": "x"})
    assert read_config(tmp_path).model_dump()["planner_parameters"] == {"standoff": 1.5}
    summary = read_summary(tmp_path)
    assert summary is not None
    assert summary.coverage.instances == 1.0
    assert json.loads((tmp_path / "summary.json").read_text())["note"] == "x"
    assert {path.name for path in tmp_path.iterdir()} == {"config.json", "summary.json"}


def test_a_wrong_summary_is_refused_and_the_old_one_stays(tmp_path: Path) -> None:
    write_summary(tmp_path, SUMMARY)
    with pytest.raises(ValueError, match=r"summary: ended: .*'sunk'"):
        write_summary(tmp_path, {**SUMMARY, "ended": "sunk"})
    with pytest.raises(ValueError, match="summary: distance_m"):
        write_summary(tmp_path, {**SUMMARY, "distance_m": math.inf})
    summary = read_summary(tmp_path)
    assert summary is not None
    assert summary.ended == "done"


def test_a_damaged_config_is_named(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text('{"version": ')
    with pytest.raises(ValueError, match=r"config\.json: expected one JSON object"):
        read_config(tmp_path)


def asking(*exchanges: Exchange, waited: float = 0.0) -> Iterator[Step]:
    """Two steps; the second asked all that."""
    first, second = painted_mission(2)
    yield first
    yield replace(second, decision=replace(second.decision, exchanges=exchanges, waited=waited))


def same(one: Exchange, other: Exchange) -> bool:
    return all(getattr(one, field.name) == getattr(other, field.name) for field in fields(Exchange))


def test_what_a_model_was_shown_and_answered_is_read_back_to_the_byte(tmp_path: Path) -> None:
    steps = list(record(asking_mission(7), tmp_path))
    for step in steps:
        kept = read_exchanges(tmp_path, step.index)
        assert len(kept) == len(step.decision.exchanges) == (step.index > 3)
        assert all(map(same, kept, step.decision.exchanges))
    shown = steps[4].decision.exchanges[0].pictures
    assert (tmp_path / "replies/0004_map.png").read_bytes() == shown["map"]
    with Image.open(tmp_path / "replies/0004_camera.png") as picture:
        assert picture.size == (640, 480)


def test_a_line_says_in_short_what_was_asked(tmp_path: Path) -> None:
    list(record(asking_mission(7), tmp_path))
    lines = read_steps(tmp_path)
    assert [line.asked is not None for line in lines] == [False] * 4 + [True] * 3
    assert [line.waited_s for line in lines[3:]] == [0.0, 12.0, 24.0, 12.0]
    assert lines[5].asked is not None
    assert lines[5].asked.model_dump() == {
        "prompt": "dream 1, legend 1, oysters 1",
        "fallback": "invalid: step_m: Field required; up, asked twice",
        "requests": 2,
    }


def test_two_questions_of_a_step_are_kept_apart(tmp_path: Path) -> None:
    one = exchange(pictures={"map": b"first"}, fallback="timeout: no answer within 60 s", replies=())
    two = exchange(pictures={"map": b"second"}, requests=2)
    list(record(asking(one, two), tmp_path))
    assert all(map(same, read_exchanges(tmp_path, 1), (one, two)))
    assert (tmp_path / "replies/0001-2_map.png").read_bytes() == b"second"
    line = read_steps(tmp_path)[1]
    assert line.asked is not None
    assert (line.asked.fallback, line.asked.requests) == ("", 3)


def test_a_run_that_asked_nothing_has_no_replies(run: tuple[Path, list[Step]]) -> None:
    assert not (run[0] / "replies").exists()
    assert read_exchanges(run[0], 3) == []


def test_a_recording_from_before_anything_was_asked_is_read(
    run: tuple[Path, list[Step]], tmp_path: Path
) -> None:
    older = [json.loads(line) for line in recorded_lines(run)]
    for line in older:
        del line["waited_s"], line["asked"]
    steps = read_steps(lines_of(tmp_path, [json.dumps(line) + "\n" for line in older]))
    assert [(step.waited_s, step.asked) for step in steps] == [(0.0, None)] * 7
    write_summary(tmp_path, SUMMARY)
    summary = read_summary(tmp_path)
    assert summary is not None
    assert summary.mission_s is None


@pytest.mark.parametrize("name", ["../map", "a b", "", "x" * 41])
def test_a_picture_whose_name_is_no_file_name_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="pictures"):
        list(record(asking(exchange(pictures={name: b"png"})), tmp_path))
    assert len(read_steps(tmp_path)) == 1


@pytest.mark.parametrize(
    ("damage", "complaint"),
    [
        ({"requests": -1}, "requests"),
        ({"pictures": ["../../frames/0000_rgb"]}, "pictures.0"),
        ({"cost_usd": "much"}, "cost_usd"),
        ({"replies": 3}, "replies"),
        (None, "damaged text"),
        ("x" * (MAX_EXCHANGE_BYTES + 1), f"expected at most {MAX_EXCHANGE_BYTES} bytes"),
    ],
)
def test_a_damaged_exchange_is_named(damage: Any, complaint: str, tmp_path: Path) -> None:
    list(record(asking(exchange()), tmp_path))
    path = tmp_path / "replies/0001.json"
    changed = json.dumps(json.loads(path.read_text()) | damage) if isinstance(damage, dict) else damage
    path.write_text("{" if changed is None else changed)
    with pytest.raises(ValueError, match=complaint) as caught:
        read_exchanges(tmp_path, 1)
    assert str(path) in str(caught.value)


def test_a_picture_that_is_gone_or_too_large_is_left_out_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    list(record(asking(exchange(pictures={"map": b"1", "camera": b"2", "depth": b"3"})), tmp_path))
    (tmp_path / "replies/0001_map.png").unlink()
    (tmp_path / "replies/0001_depth.png").write_bytes(b"0" * (MAX_SHOWN_BYTES + 1))
    with caplog.at_level(logging.WARNING):
        (kept,) = read_exchanges(tmp_path, 1)
    assert kept.pictures == {"camera": b"2"}
    assert "0001_map.png is left out" in caplog.text
    assert "0001_depth.png is left out" in caplog.text


def test_equal_decisions_may_have_been_asked_for_differently() -> None:
    assert Decision(1.0, exchanges=(exchange(),)) == Decision(1.0)
    assert Decision(1.0, waited=12.0) != Decision(1.0)
