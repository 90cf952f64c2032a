"""A benchmark folder says the same when it is read as when it was written, and damage is named."""

from __future__ import annotations

import gzip
import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.evaluation.results import (
    COLUMNS,
    LATER,
    LATER_IN_TRACES,
    Flown,
    Row,
    Trace,
    mission_path,
    read_manifest,
    read_mission,
    read_results,
    write_manifest,
    write_mission,
    write_tables,
)

ROW = Row(
    protocol="dream-v1",
    world="reef/L",
    seed=3,
    start=1,
    world_hash="ab12",
    planner="sweep-and-graze",
    ended="done",
    steps=2,
    t_stop=2,
    t_claimed=None,
    t90=0,
    t95=1,
    t98=None,
    t100=None,
    instances=0.97,
    clusters=0.0,
    area=1.0,
    visible=1 / 3,
    countable=7,
    collisions=1,
    distance_m=3.123,
    turns=2,
    guarded=0,
    min_clearance_m=-0.01,
    planner_ms_p50=1e-05,
    planner_ms_p99=2.0,
    c50=0.97,
    c100=0.97,
    c137=0.97,
    c200=0.97,
    auc=0.96995,
    vlm_calls=4,
    vlm_tokens=100,
    vlm_cost_usd=0.5,
    vlm_fallbacks=0,
    vlm_waited_s=48.0,
    mission_s=52.5,
    vlm_questions=4,
    why="the planner held the mission to be complete and its map agreed",
    cap=200,
    success=False,
    wall_s=9.5,
)
BARE = replace(
    ROW,
    planner="random",
    steps=0,
    t_stop=0,
    t95=0,
    t98=0,
    t100=0,
    instances=1.0,
    collisions=0,
    min_clearance_m=None,
    c50=1.0,
    c100=1.0,
    c137=1.0,
    c200=1.0,
    auc=1.0,
    vlm_calls=None,
    vlm_tokens=None,
    vlm_cost_usd=None,
    vlm_fallbacks=None,
    vlm_waited_s=None,
    mission_s=None,
    vlm_questions=None,
    why=None,
    success=True,
)
MANIFEST: dict[str, Any] = {
    "suite": "reef/L 3",
    "cases": [{"world": "reef/L", "seed": 3, "start": 1}],
    "worlds": {},
    "sealed": None,
    "planners": {"sweep-and-graze": {"spacing": 2.5}, "random": {}},
    "protocol": {"name": "dream-v1"},
    "max_steps": None,
    "later": [],
    "failed": [],
    "version": "0.1.0",
    "commit": None,
    "source": "00",
    "engine": "Processes(jobs=2)",
    "machine": {},
    "started": "2026-01-01T00:00:00+00:00",
    "finished": None,
    "wall_s": 1.5,
}


def trace(*instances: float) -> Trace:
    ramp = np.arange(len(instances), dtype=np.float64)
    clock = {"seconds": 4.5 * ramp, "drawn_wh": 0.125 * ramp}
    return Trace(0.1 + ramp, -ramp + 0.0, 30.0 * ramp - 180.0, np.array(instances), ramp == 1, **clock)


def clockless(flown: Flown) -> Flown:
    """As missions were written down before traces had a clock and a battery."""
    return replace(flown, trace=replace(flown.trace, seconds=None, drawn_wh=None))


MISSIONS = (Flown(ROW, trace(0.91, 0.96, 0.97)), Flown(BARE, trace(1.0)))


def same(one: Flown, other: Flown) -> bool:
    columns = [(getattr(one.trace, name), getattr(other.trace, name)) for name in Trace.__slots__]
    return one.row == other.row and all(
        (a is None and b is None) or (a.dtype == b.dtype and (a == b).all()) for a, b in columns
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_manifest(tmp_path, MANIFEST)
    write_tables(tmp_path, MISSIONS)
    return tmp_path


def test_a_folder_is_read_as_it_was_written(folder: Path) -> None:
    results = read_results(folder)
    assert results.manifest == MANIFEST
    assert results.rows == (ROW, BARE)
    assert list(results.traces) == [ROW.key, BARE.key]
    for flown in MISSIONS:
        assert same(Flown(flown.row, results.traces[flown.row.key]), flown)


def test_the_table_has_the_published_columns_and_words(folder: Path) -> None:
    lines = (folder / "results.csv").read_text().splitlines()
    assert lines[0] == (
        "protocol,world,seed,start,world_hash,planner,ended,steps,t_stop,t_claimed,t90,t95,t98,t100,instances,"
        "clusters,area,visible,countable,collisions,distance_m,turns,guarded,min_clearance_m,planner_ms_p50,"
        "planner_ms_p99,c50,c100,c137,c200,auc,vlm_calls,vlm_tokens,vlm_cost_usd,vlm_fallbacks,vlm_waited_s,"
        "mission_s,vlm_questions,why,cap,success,wall_s"
    )
    assert lines[1].startswith(
        "dream-v1,reef/L,3,1,ab12,sweep-and-graze,done,2,2,,0,1,,,0.97,0.0,1.0,0.333333"
    )
    assert lines[2].endswith(",,,,,,,,200,true,9.5")
    steps = gzip.decompress((folder / "traces.csv.gz").read_bytes()).decode().splitlines()
    assert steps[0] == (
        "protocol,world,seed,start,planner,step,x,y,yaw_deg,instances,collided,seconds,drawn_wh"
    )
    assert steps[2] == "dream-v1,reef/L,3,1,sweep-and-graze,1,1.1,-1.0,-150.0,0.96,true,4.5,0.125"


def without(text: str, names: Sequence[str]) -> str:
    """A table as it was written before these columns were."""
    lines = [line.split(",") for line in text.splitlines()]
    kept = [k for k, name in enumerate(lines[0]) if name not in names]
    return "".join(",".join(line[k] for k in kept) + "\n" for line in lines)


AGES = [tuple(chain(*LATER[age:])) for age in range(len(LATER))]
"""What was not written yet at one time or another."""


@pytest.mark.parametrize("lacking", AGES)
def test_a_folder_that_was_written_before_the_later_columns_is_read(
    lacking: tuple[str, ...], folder: Path
) -> None:
    path = folder / "results.csv"
    path.write_text(without(path.read_text(), lacking))
    assert not set(lacking) & set(path.read_text().splitlines()[0].split(","))
    unknown: dict[str, Any] = dict.fromkeys(lacking)
    expected = tuple(replace(row, **unknown) for row in (ROW, BARE))
    assert read_results(folder).rows == expected


@pytest.mark.parametrize("lacking", AGES)
def test_a_mission_that_was_written_before_the_later_columns_is_read(
    lacking: tuple[str, ...], tmp_path: Path
) -> None:
    path = write_mission(tmp_path, MISSIONS[0])
    old = json.loads(path.read_text())
    for name in lacking:
        del old["row"][name]
    path.write_text(json.dumps(old))
    unknown: dict[str, Any] = dict.fromkeys(lacking)
    assert read_mission(path).row == replace(ROW, **unknown)


def test_traces_that_were_written_without_a_clock_are_read(folder: Path) -> None:
    path = folder / "traces.csv.gz"
    old = without(gzip.decompress(path.read_bytes()).decode(), LATER_IN_TRACES)
    path.write_bytes(gzip.compress(old.encode()))
    for flown in MISSIONS:
        assert same(Flown(flown.row, read_results(folder).traces[flown.row.key]), clockless(flown))


def test_missions_with_and_without_a_clock_stand_in_one_folder(folder: Path) -> None:
    mixed = (clockless(MISSIONS[0]), MISSIONS[1])
    write_tables(folder, mixed)
    traces = read_results(folder).traces
    assert all(same(Flown(flown.row, traces[flown.row.key]), flown) for flown in mixed)
    assert same(read_mission(write_mission(folder, mixed[0])), mixed[0])


def test_a_table_that_lacks_only_one_of_the_later_columns_is_refused(folder: Path) -> None:
    path = folder / "results.csv"
    path.write_text(without(path.read_text(), ["vlm_waited_s"]))
    with pytest.raises(ValueError, match="line 1: expected the columns"):
        read_results(folder)


def test_equal_missions_give_equal_bytes(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path_factory.mktemp("other")
    monkeypatch.setattr(time, "time", lambda: 1e9)
    write_tables(other, MISSIONS)
    for name in ("results.csv", "traces.csv.gz"):
        assert (other / name).read_bytes() == (folder / name).read_bytes()


@pytest.mark.parametrize("flown", MISSIONS, ids=["full", "bare"])
def test_a_mission_is_kept_under_its_own_name(flown: Flown, tmp_path: Path) -> None:
    path = write_mission(tmp_path, flown)
    assert path == mission_path(tmp_path, flown.row.key)
    assert path.parent.name == "missions"
    assert same(read_mission(path), flown)
    assert [entry.name for entry in path.parent.iterdir()] == [path.name], "nothing temporary is left"


def test_a_write_that_breaks_off_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_mission(tmp_path, MISSIONS[0])

    def no_space(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_space)
    changed = Flown(replace(ROW, turns=99), MISSIONS[0].trace)
    with pytest.raises(OSError, match="No space"):
        write_mission(tmp_path, changed)
    assert same(read_mission(path), MISSIONS[0])


def edited(change: Callable[[dict[str, Any]], object]) -> Callable[[bytes], bytes]:
    def edit(content: bytes) -> bytes:
        mission = json.loads(content)
        change(mission)
        return json.dumps(mission).encode()

    return edit


@pytest.mark.parametrize(
    ("damage", "complaint"),
    [
        (lambda content: content[: len(content) // 2], "damaged text"),
        (lambda content: b"", "damaged text"),
        (lambda content: content.replace(b"0.97", b"NaN", 1), "damaged text"),
        (edited(lambda m: m["row"].pop("t98")), "t98: Field required"),
        (edited(lambda m: m["row"].update(extra=1)), "extra: Unexpected"),
        (edited(lambda m: m["row"].update(instances=1.5)), "instances: .*less than or equal to 1"),
        (edited(lambda m: m["row"].update(steps=-1)), "steps"),
        (edited(lambda m: m["row"].update(ended="lost")), "ended"),
        (edited(lambda m: m["row"].update(ended="aborted", success=True)), "ended: expected no success"),
        (edited(lambda m: m["row"].update(ended="aborted", success=False, t_stop=3)), "ended: expected no"),
        (edited(lambda m: m["row"].update(seed=4)), "expected the mission that the file is named after"),
        (edited(lambda m: m["trace"]["x"].pop()), "trace: x: expected 3 values"),
        (edited(lambda m: m["trace"]["y"].__setitem__(1, "2")), "trace: y: expected only numbers"),
        (edited(lambda m: m["trace"]["collided"].__setitem__(1, 1)), "collided: expected only booleans"),
        (edited(lambda m: m["trace"]["instances"].__setitem__(1, 2.0)), "shares from 0 to 1"),
        (edited(lambda m: m["trace"]["seconds"].__setitem__(1, 9e9)), "seconds: expected .* never fall"),
        (edited(lambda m: m["trace"].pop("yaw_deg")), "trace: expected the columns"),
        (edited(lambda m: m.pop("trace")), "expected an object with row and trace"),
        (lambda content: b"[" * 100_000, "damaged text"),
    ],
)
def test_a_damaged_mission_is_named(damage: Callable[[bytes], bytes], complaint: str, tmp_path: Path) -> None:
    path = write_mission(tmp_path, MISSIONS[0])
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(ValueError, match=complaint) as caught:
        read_mission(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"instances": 0.999}, r"instances: expected 0\.97, as its trace says, got 0\.999"),
        ({"c100": 0.98}, r"c100: expected 0\.97"),
        ({"auc": 0.98}, r"auc: expected 0\.96995"),
        ({"collisions": 0}, "collisions: expected 1"),
        ({"t_stop": None}, "t_stop: expected 2"),
        ({"ended": "cap"}, "t_stop: expected None"),
        ({"t90": 1}, "t90: expected 0"),
        ({"t95": None}, "t95: expected 1"),
        ({"t98": 2}, "t98: expected None"),
        ({"success": True}, "success: expected False"),
    ],
)
def test_a_row_that_contradicts_its_trace_is_damage(
    changes: dict[str, Any], complaint: str, tmp_path: Path
) -> None:
    path = write_mission(tmp_path, MISSIONS[0])
    path.write_bytes(edited(lambda m: m["row"].update(changes))(path.read_bytes()))
    with pytest.raises(ValueError, match=complaint) as caught:
        read_mission(path)
    assert str(caught.value).startswith(str(path))


def test_a_mission_that_saw_all_is_no_failure_but_of_a_model_that_never_answered(tmp_path: Path) -> None:
    failed = replace(BARE, success=False)
    with pytest.raises(ValueError, match="success: expected True"):
        read_mission(write_mission(tmp_path, Flown(failed, MISSIONS[1].trace)))
    silent = replace(failed, vlm_calls=2)
    assert read_mission(write_mission(tmp_path, Flown(silent, MISSIONS[1].trace))).row == silent


@pytest.mark.parametrize("t98", [1, 2])
def test_a_share_that_was_rounded_to_a_mark_may_have_been_either_side_of_it(t98: int, tmp_path: Path) -> None:
    known: dict[str, Any] = {"t95": 0, "t98": t98, "auc": 0.989963}
    known |= dict.fromkeys(("instances", "c50", "c100", "c137", "c200"), 0.99)
    row = replace(ROW, **known)
    mission = Flown(row, trace(0.96, 0.9826, 0.99))
    assert same(read_mission(write_mission(tmp_path, mission)), mission)


@pytest.mark.parametrize(
    ("before", "after", "complaint"),
    [
        ("world_hash", "hash", "line 1: expected the columns"),
        (",done,2,", ",done,two,", "line 2: row: steps"),
        (",done,2,", ",done,2,7,", "line 2: expected 42 cells, got 43"),
        (",random,", ",sweep-and-graze,", "line 3: expected each mission once"),
        (",true,", ",perhaps,", "line 3: row: success"),
        ("0.5,0,48.0", "inf,0,48.0", "line 2: row: vlm_cost_usd"),
        ("ab12,random", '"ab12,random', "line 3"),
    ],
)
def test_a_damaged_table_is_named_with_its_line(
    before: str, after: str, complaint: str, folder: Path
) -> None:
    path = folder / "results.csv"
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after, 1))
    with pytest.raises(ValueError, match=complaint) as caught:
        read_results(folder)
    assert str(caught.value).startswith(f"{path}, line ")


@pytest.mark.parametrize(
    ("before", "after", "complaint"),
    [
        ("yaw_deg", "yaw", "line 1: expected the columns"),
        ("graze,1,1.1", "graze,2,1.1", "line 3: expected a line that begins with"),
        (",true,4", ",1,4", "line 3: expected true or false"),
        (",true,4", ",true,,4", "line 3: expected 13 cells"),
        ("graze,1,1.1", "graze,1,nan", "expected finite poses"),
        ("graze,1,1.1", "graze,1,east", "line 3: could not convert"),
        ("random,0,", "random,0,0,0,0,0,false,0,0\nrandom,1,", "line 6: expected the end"),
    ],
)
def test_a_damaged_trace_is_named_with_its_line(
    before: str, after: str, complaint: str, folder: Path
) -> None:
    path = folder / "traces.csv.gz"
    text = gzip.decompress(path.read_bytes()).decode()
    assert before in text
    path.write_bytes(gzip.compress(text.replace(before, after, 1).encode()))
    with pytest.raises(ValueError, match=complaint) as caught:
        read_results(folder)
    assert str(caught.value).startswith(f"{path}, line ")


@pytest.mark.parametrize("end", [-9, -1])
def test_a_torn_trace_is_named(end: int, folder: Path) -> None:
    path = folder / "traces.csv.gz"
    path.write_bytes(path.read_bytes()[:end])
    with pytest.raises(ValueError, match=str(path)):
        read_results(folder)


def test_more_steps_than_the_table_tells_of_are_not_read(folder: Path) -> None:
    path = folder / "traces.csv.gz"
    path.write_bytes(gzip.compress(gzip.decompress(path.read_bytes()) + b"0" * 100_000_000))
    with pytest.raises(ValueError, match="line 6: expected the end"):
        read_results(folder)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"cases": [{"world": "../x", "seed": 1, "start": 0}]}, "cases.0.world"),
        ({"cases": 3}, "cases"),
        ({"planners": {"a": 1}}, "planners.a"),
        ({"wall_s": "long"}, "wall_s"),
    ],
)
def test_a_damaged_manifest_is_named(change: dict[str, Any], complaint: str, folder: Path) -> None:
    (folder / "manifest.json").write_text(json.dumps(MANIFEST | change))
    with pytest.raises(ValueError, match=complaint) as caught:
        read_manifest(folder)
    assert str(folder / "manifest.json") in str(caught.value)


def test_another_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"expected a benchmark folder, got no manifest\.json"):
        read_results(tmp_path)


@pytest.mark.parametrize("name", ["results.csv", "traces.csv.gz"])
def test_a_folder_that_was_broken_off_before_its_tables_is_called_unfinished(name: str, folder: Path) -> None:
    (folder / name).unlink()
    with pytest.raises(FileNotFoundError, match="got an unfinished one without") as it:
        read_results(folder)
    assert f"{folder}: expected a benchmark with its {name}" in str(it.value)
    assert "The same dream bench or dream sweep goes on with it" in str(it.value)


def test_a_row_and_a_trace_of_different_length_are_no_mission() -> None:
    with pytest.raises(ValueError, match="expected 3 poses of 2 steps"):
        Flown(ROW, trace(0.91, 0.96, 0.97, 0.97))


def test_columns_are_the_fields_of_a_row() -> None:
    assert tuple(Row.__slots__) == COLUMNS
