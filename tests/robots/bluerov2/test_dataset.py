"""What is released of a dive is what was kept of it."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from ruamel.yaml import YAML

from dream.geometry import SE3, Camera, camera_mount
from dream.recording import read_steps, record
from dream.robots import replay
from dream.robots.bluerov2 import dataset
from dream.robots.bluerov2.dataset import Card, export
from dream.robots.replay import Kept
from dream.types import Observation, Step

CARD = Card("A dive in a tank", licence="CC-BY-4.0", began=datetime(2026, 11, 22, 9, 30, tzinfo=UTC))
CAMERA = Camera.from_fov(32, 24, np.radians(90.0))


def look(number: int) -> Observation:
    rng = np.random.default_rng(number)
    depth = rng.uniform(0.3, 20.0, (24, 32)).astype(np.float32)
    depth[0, :5] = [np.nan, 0.0004, 65.535, 65.536, 1e6]
    return Observation(
        time=2.5 * number,
        rgb=rng.integers(0, 255, (48, 64, 3), dtype=np.uint8),
        depth=depth,
        labels=rng.integers(0, 4, (24, 32), dtype=np.uint8),
        camera=CAMERA,
        T_world_base=SE3.level(1.0 + number, 2.0, -3.0, 0.1 * number),
        T_base_camera=camera_mount(np.radians(20.0)),
    )


def decided(step: int, **changes: Any) -> dict[str, Any]:
    return {
        "step": step,
        "time": 2.5 * step,
        "decision": {"turn": 0.5, "advance": 0.1, "done": False},
        "guarded": {"turn": 0.5, "advance": 0.1, "note": ""},
        "reasoning": {"safety": "free"},
        "coverage": {"instances": 0.5},
        **changes,
    }


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "run" / "observations"
    folder.mkdir(parents=True)
    for number in range(4):
        replay.write(folder / f"{number:04d}.npz", Kept(None, look(number)))
    return folder.parent


@pytest.fixture
def released(run: Path, tmp_path: Path) -> Path:
    return export(run, tmp_path / "tank", CARD, [decided(step) for step in range(1, 4)]).folder


def test_pictures_are_what_was_seen(released: Path) -> None:
    for number in range(4):
        seen = look(number)
        name = f"{number:04d}.png"
        assert np.array_equal(np.array(Image.open(released / "images" / name)), seen.rgb)
        assert np.array_equal(np.array(Image.open(released / "labels" / name)), seen.labels)
        depth = np.array(Image.open(released / "depth" / name))
        assert depth.dtype == np.uint16
        assert depth[0, :5].tolist() == [0, 0, 65535, 0, 0]
        np.testing.assert_allclose(depth[1:] / 1000.0, seen.depth[1:], atol=0.0005 + 1e-6)


def test_poses_and_calibration_put_a_point_back_where_it_was(released: Path) -> None:
    """As someone else would, with nothing of ours: files, numpy, and OpenCV's convention."""
    rows = list(csv.DictReader((released / "poses.csv").read_text().splitlines()))
    assert [row["frame"] for row in rows] == ["0000", "0001", "0002", "0003"]
    calibration = YAML(typ="safe").load((released / "calibration.yaml").read_text())
    matrix = np.array(calibration["depth_and_labels"]["camera_matrix"])
    for number, row in enumerate(rows):
        seen = look(number)
        x, y, z, w = (float(row[name]) for name in ("qx", "qy", "qz", "qw"))
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        depth = np.array(Image.open(released / "depth" / f"{row['frame']}.png"))[10, 20] / 1000.0
        ray = np.linalg.inv(matrix) @ [20, 10, 1]
        point = rotation @ (depth * ray) + [float(row[axis]) for axis in "xyz"]
        true = CAMERA.back_project(seen.depth, seen.T_world_camera)[10, 20]
        np.testing.assert_allclose(point, true, atol=0.001)
        assert float(row["time"]) == seen.time
    np.testing.assert_allclose(
        np.array(calibration["T_base_camera"])[:3, :3], look(0).T_base_camera.rotation, atol=1e-12
    )
    assert (calibration["images"]["width"], calibration["images"]["height"]) == (64, 48)


def test_decisions_keep_their_reasons_and_nothing_that_only_a_simulator_knows(released: Path) -> None:
    lines = [json.loads(line) for line in (released / "decisions.jsonl").read_text().splitlines()]
    assert [line["frame"] for line in lines] == ["0001", "0002", "0003"]
    assert lines[0]["reasoning"] == {"safety": "free"}
    assert lines[0]["decision"]["turn"] == 0.5
    assert "coverage" not in lines[0]


def test_checksums_are_those_of_all_files(released: Path) -> None:
    listed = {line.split("  ")[1] for line in (released / "checksums.sha256").read_text().splitlines()}
    there = {path.relative_to(released).as_posix() for path in released.rglob("*") if path.is_file()}
    assert listed == there - {"checksums.sha256"}
    assert not any(name.startswith(".") for name in there)
    check = ["sha256sum", "--check", "--quiet", "--strict", "checksums.sha256"]
    if shutil.which("sha256sum"):
        assert subprocess.run(check, cwd=released, check=False).returncode == 0
        (released / "labels" / "0002.png").write_bytes(b"other")
        assert subprocess.run(check, cwd=released, check=False, capture_output=True).returncode == 1


def test_the_card_says_what_was_given(released: Path) -> None:
    text = (released / "README.md").read_text()
    front = YAML(typ="safe").load(text.split("---")[1])
    assert front == {"title": "A dive in a tank", "license": "CC-BY-4.0"}
    assert "x and y are those of\n`--at` and `--area`" in text
    assert "nor to north" in text
    assert "| frames | 4 |" in text
    assert "| decisions | 3 |" in text
    assert "2026-11-22T09:30:00+00:00" in text
    assert "| seconds from the first frame to the last | 7.5 |" in text


def test_nothing_is_made_up(run: Path, tmp_path: Path) -> None:
    text = (export(run, tmp_path / "bare", Card("Bare"), []).folder / "README.md").read_text()
    assert "- Licence: not given" in text
    assert YAML(typ="safe").load(text.split("---")[1]) == {"title": "Bare"}
    assert text.count("not given") == 7


def test_an_interrupted_export_goes_on(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Stop(KeyboardInterrupt):
        pass

    read, to = replay.read, tmp_path / "tank"
    asked: list[str] = []

    def until_the_third(path: Path) -> Kept:
        asked.append(path.stem)
        if path.stem == "0002" and len(asked) == 3:
            raise Stop
        return read(path)

    monkeypatch.setattr(replay, "read", until_the_third)
    with pytest.raises(Stop):
        export(run, to, CARD, [])
    assert not to.exists()
    written = tmp_path / ".partial.tank" / "images" / "0000.png"
    before = written.stat().st_mtime_ns
    export(run, to, CARD, [])
    assert (to / "images" / "0000.png").stat().st_mtime_ns == before
    assert not (tmp_path / ".partial.tank").exists()
    assert (to / "poses.csv").read_text().count("\n") == 5


def test_what_is_left_of_another_dive_is_not_used(run: Path, tmp_path: Path) -> None:
    left = tmp_path / ".partial.tank"
    (left / "images").mkdir(parents=True)
    (left / "images" / "0000.png").write_bytes(b"of another dive")
    (left / ".source.json").write_text("{}")
    released = export(run, tmp_path / "tank", CARD, []).folder
    assert np.array_equal(np.array(Image.open(released / "images" / "0000.png")), look(0).rgb)


def test_a_folder_of_someone_else_is_left_alone(run: Path, tmp_path: Path) -> None:
    left = tmp_path / ".partial.tank"
    left.mkdir()
    (left / "precious.txt").write_text("mine")
    with pytest.raises(ValueError, match="expected what is left of an attempt"):
        export(run, tmp_path / "tank", CARD, [])
    assert (left / "precious.txt").read_text() == "mine"
    (tmp_path / "there").mkdir()
    with pytest.raises(ValueError, match="expected a folder that does not exist"):
        export(run, tmp_path / "there", CARD, [])


def test_a_full_disk_leaves_no_data_set(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(dataset, "_sha256", full)
    with pytest.raises(OSError, match="No space left"):
        export(run, tmp_path / "tank", CARD, [])
    assert not (tmp_path / "tank").exists()
    monkeypatch.undo()
    export(run, tmp_path / "tank", CARD, [])


def test_bad_input_is_named(run: Path, tmp_path: Path) -> None:
    to = tmp_path / "tank"
    with pytest.raises(FileNotFoundError, match="expected a dive with its observations"):
        export(tmp_path, to, CARD, [])
    with pytest.raises(ValueError, match=r"decision 1: expected a line of steps.jsonl, got no reasoning"):
        export(run, to, CARD, [{k: v for k, v in decided(1).items() if k != "reasoning"}])
    with pytest.raises(ValueError, match=r"decision 2: expected a frame that was kept in .*, got step 9"):
        export(run, to, CARD, [decided(1), decided(9)])
    with pytest.raises(ValueError, match="JSON compliant"):
        export(run, to, CARD, [decided(1, time=float("nan"))])
    assert not to.exists()
    torn = run / "observations" / "0003.npz"
    torn.write_bytes(torn.read_bytes()[:500])
    with pytest.raises(ValueError, match=r"0003.npz: expected what was seen and done"):
        export(run, to, CARD, [])
    other = replace(look(3), camera=Camera.from_fov(32, 24, 1.0))
    replay.write(torn, Kept(None, other))
    with pytest.raises(ValueError, match=r"0003.npz: expected the camera of the first frame"):
        export(run, to, CARD, [])
    replay.write(torn, Kept(None, replace(look(3), time=-1.0)))
    with pytest.raises(ValueError, match=r"0003.npz: expected a time after 5.0, got -1.0"):
        export(run, to, CARD, [])


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({"title": " "}, "title: expected the name"),
        ({"title": "a\nb"}, "title: expected one line"),
        ({"licence": "MIT\nfree"}, "licence: expected one line"),
        ({"began": datetime(2026, 1, 1)}, "began: expected a time with its zone"),  # noqa: DTZ001
    ],
)
def test_a_card_is_checked(given: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        Card(**{"title": "A dive", **given})


def test_a_recorded_mission_is_exported(short_mission: list[Step], tmp_path: Path) -> None:
    run = tmp_path / "mission"
    (run / "observations").mkdir(parents=True)
    for step in record(short_mission[:3], run):
        replay.write(run / "observations" / f"{step.index:04d}.npz", Kept(None, step.observation))
    lines = [step.model_dump(mode="json") for step in read_steps(run)]
    made = export(run, tmp_path / "reef", Card("Reef"), lines)
    assert (made.frames, made.decisions) == (3, 3)
    assert made.nbytes == sum(path.stat().st_size for path in made.folder.rglob("*") if path.is_file())
    assert "quarter turn" in (made.folder / "decisions.jsonl").read_text()
