from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rerun")

from rerun.chunk import RrdReader

from dream.cli import run_command
from dream.live.rerun import write_rerun
from dream.recording import read_steps
from tests.live.runs import STEPS, Growing

Make = Callable[..., Growing]


def columns(path: Path) -> dict[tuple[str, str], dict[int, Any]]:
    """What is logged, by entity and component: a value for each step; under -1 what holds for all."""
    found: dict[tuple[str, str], dict[int, Any]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        names = batch.schema.names
        steps = batch.column("step").to_pylist() if "step" in names else [-1] * batch.num_rows
        for name in names:
            if name in ("step", "mission", "log_time", "log_tick") or name.startswith("rerun.controls"):
                continue
            values = found.setdefault((chunk.entity_path.strip("/"), name.split(":")[-1]), {})
            for step, value in zip(steps, batch.column(name).to_pylist(), strict=True):
                if value is not None:
                    values[step] = value
    return found


def test_every_step_is_there_with_all_that_was_recorded(growing: Make) -> None:
    run = growing().write(STEPS)
    logged = columns(write_rerun(run.folder))
    steps = read_steps(run.folder)
    for entity, component, name in (
        ("camera/rgb", "blob", "frames/{:04d}_rgb.png"),
        ("camera/depth", "blob", "frames/{:04d}_depth.png"),
        ("map", "blob", "maps/{:04d}.png"),
    ):
        blobs = logged[entity, component]
        assert sorted(blobs) == list(range(STEPS))
        for number in (0, STEPS - 1):
            assert (
                bytes(np.ravel(blobs[number]).astype(np.uint8))
                == (run.folder / name.format(number)).read_bytes()
            )
    assert sorted(logged["camera/labels", "buffer"]) == list(range(STEPS))
    for step in steps:
        assert step.coverage is not None
        assert logged["measures/coverage/instances", "scalars"][step.step] == [step.coverage.instances]
        assert logged["measures/area/explored", "scalars"][step.step] == [step.map["explored"]]
        (way,) = logged["world/way", "strips"][step.step]
        assert len(way) == step.step + 1
        assert np.allclose(way[-1], (step.pose.x, step.pose.y, 0.0), atol=1e-5)
    assert "Turn 30° left" in logged["reasoning", "text"][3][0]


def test_a_damaged_picture_does_not_stay_that_of_the_step_before(growing: Make) -> None:
    run = growing().write(3)
    picture = run.folder / "frames/0001_rgb.png"
    picture.write_bytes(picture.read_bytes()[:500])
    logged = columns(write_rerun(run.folder))
    assert sorted(logged["camera/rgb", "blob"]) == [0, 2]
    assert sorted(logged["camera/rgb", "is_recursive"]) == [1]


def test_names_from_a_file_become_no_paths(growing: Make) -> None:
    run = growing()
    hostile = {"explored": 1.0, "../../camera/rgb": 2.0, "a/b": 3.0, "x y": 4.0}
    run.append(json.dumps({**json.loads(run.lines[0]), "map": hostile}).encode() + b"\n")
    entities = {entity for entity, _ in columns(write_rerun(run.folder))}
    assert {entity for entity in entities if entity.startswith("measures/area")} == {"measures/area/explored"}


def test_the_command_writes_the_file_and_nothing_else(
    growing: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    run = growing().write(2)
    before = set(run.folder.rglob("*"))
    assert run_command(["replay", str(run.folder), "--rerun", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rerun"] == str(run.folder / "run.rrd")
    assert set(run.folder.rglob("*")) - before == {run.folder / "run.rrd"}
