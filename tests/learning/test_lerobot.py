"""Data sets for LeRobot, read as its documentation says, not as they were written."""

from __future__ import annotations

import io
import json
import math
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from dream.extras import missing
from dream.learning import lerobot
from dream.learning.lerobot import Episode, export
from dream.planning.baselines.uivnav import TURNS_DEG

TASKS = ("Find the oysters.", "Find the wreck.", "Find the oysters.")
LENGTHS = (7, 4, 1)


def episodes() -> list[Episode]:
    rng = np.random.default_rng(0)
    made = []
    for task, count in zip(TASKS, LENGTHS, strict=True):
        odds = rng.random((count, len(TURNS_DEG))).astype(np.float32)
        images = rng.integers(0, 256, (count, 2, 72, 96), dtype=np.uint8)
        made.append(Episode(task, images, odds / odds.sum(axis=1, keepdims=True)))
    return made


def rows(path: Path) -> list[dict[str, Any]]:
    pq = pytest.importorskip("pyarrow.parquet")
    found: list[dict[str, Any]] = pq.read_table(path).to_pylist()
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    pytest.importorskip("pyarrow")
    made = export(episodes(), tmp_path / "set", advance=2.0, robot="dream-v1")
    assert (made.episodes, made.frames) == (3, sum(LENGTHS))
    return made.folder


def test_every_frame_is_there_as_it_was(folder: Path) -> None:
    info = json.loads((folder / "meta/info.json").read_text())
    tasks = {row["task_index"]: row["__index_level_0__"] for row in rows(folder / "meta/tasks.parquet")}
    listed = rows(folder / "meta/episodes/chunk-000/file-000.parquet")
    assert [row["episode_index"] for row in listed] == [0, 1, 2]
    for episode, row in zip(episodes(), listed, strict=True):
        where = info["data_path"].format(
            chunk_index=row["data/chunk_index"], file_index=row["data/file_index"]
        )
        of_it = [frame for frame in rows(folder / where) if frame["episode_index"] == row["episode_index"]]
        assert row["tasks"] == [episode.task]
        assert row["length"] == len(of_it) == len(episode.images)
        assert [frame["index"] for frame in of_it] == list(
            range(row["dataset_from_index"], row["dataset_to_index"])
        )
        for k, frame in enumerate(of_it):
            png = Image.open(io.BytesIO(frame["observation.images.representation"]["bytes"]))
            colours = np.asarray(png)
            np.testing.assert_array_equal(colours[..., 0], episode.images[k, 0])
            np.testing.assert_array_equal(colours[..., 1], episode.images[k, 1])
            assert not colours[..., 2].any()
            assert (frame["frame_index"], frame["timestamp"]) == (k, k / info["fps"])
            assert tasks[frame["task_index"]] == episode.task
            turn, advance = frame["action"]
            assert turn == pytest.approx(math.radians(TURNS_DEG[int(episode.odds[k].argmax())]))
            assert advance == 2.0
            np.testing.assert_array_equal(np.float32(frame["expert.odds"]), episode.odds[k])


def test_what_the_set_says_of_itself_is_true_of_it(folder: Path) -> None:
    info = json.loads((folder / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (3, sum(LENGTHS), 2)
    assert info["splits"] == {"train": "0:3"}
    frames = rows(folder / "data/chunk-000/file-000.parquet")
    assert set(info["features"]) == set(frames[0])
    for name, feature in info["features"].items():
        if feature["dtype"] != "image":
            assert np.shape(frames[0][name]) == (tuple(feature["shape"]) if feature["shape"] != [1] else ())
    assert info["features"]["observation.images.representation"]["shape"] == [72, 96, 3]


def test_its_statistics_are_those_of_all_frames_and_of_each_episode(folder: Path) -> None:
    stats = json.loads((folder / "meta/stats.json").read_text())
    images = np.concatenate([episode.images for episode in episodes()]) / 255.0
    odds = np.concatenate([episode.odds for episode in episodes()]).astype(np.float64)
    shown = stats["observation.images.representation"]
    assert np.shape(shown["mean"]) == (3, 1, 1)
    np.testing.assert_allclose(np.ravel(shown["mean"])[:2], images.mean(axis=(0, 2, 3)), rtol=1e-6)
    np.testing.assert_allclose(np.ravel(shown["std"])[:2], images.std(axis=(0, 2, 3)), rtol=1e-6)
    for name in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(stats["expert.odds"][name], getattr(odds, name)(axis=0), rtol=1e-6)
    assert stats["index"]["max"] == [sum(LENGTHS) - 1]
    assert all(each["count"] == [sum(LENGTHS)] for each in stats.values())
    second = rows(folder / "meta/episodes/chunk-000/file-000.parquet")[1]
    assert second["stats/frame_index/max"] == [LENGTHS[1] - 1]
    np.testing.assert_allclose(second["stats/expert.odds/mean"], episodes()[1].odds.mean(axis=0), rtol=1e-6)


def test_a_file_that_is_full_is_followed_by_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyarrow")
    monkeypatch.setattr(lerobot, "MOST_BYTES", 1)
    monkeypatch.setattr(lerobot, "CHUNK", 2)
    folder = export(episodes(), tmp_path / "set", advance=2.0).folder
    data = sorted(path.relative_to(folder).as_posix() for path in folder.glob("data/*/*.parquet"))
    names = ("chunk-000/file-000", "chunk-000/file-001", "chunk-001/file-000")
    assert data == [f"data/{name}.parquet" for name in names]
    listed = rows(folder / "meta/episodes/chunk-000/file-000.parquet")
    assert [(row["data/chunk_index"], row["data/file_index"]) for row in listed] == [(0, 0), (0, 1), (1, 0)]
    assert [len(rows(folder / name)) for name in data] == list(LENGTHS)


def test_a_set_is_whole_or_not_there(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")

    def broken() -> Any:
        yield episodes()[0]
        raise RuntimeError("the disk is gone")

    with pytest.raises(RuntimeError, match="disk"):
        export(broken(), tmp_path / "set", advance=2.0)
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="episodes: expected one or more, got none"):
        export([], tmp_path / "set", advance=2.0)
    assert not list(tmp_path.iterdir())
    export(episodes(), tmp_path / "set", advance=2.0)
    with pytest.raises(ValueError, match="data set: expected a folder that does not exist"):
        export(episodes(), tmp_path / "set", advance=2.0)


def test_episodes_of_another_shape_are_refused() -> None:
    good = episodes()[0]
    with pytest.raises(ValueError, match=r"images: expected one or more of \(2, 72, 96\) uint8"):
        Episode("", good.images[:0], good.odds[:0])
    with pytest.raises(ValueError, match="images: expected one or more"):
        Episode("", good.images.astype(np.int16), good.odds)
    with pytest.raises(ValueError, match=r"odds: expected \(7, 7\) finite numbers, got \(6, 7\)"):
        Episode("", good.images, good.odds[1:])


def test_without_pyarrow_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ValueError, match=re.escape(missing("train", "pyarrow", "a data set for LeRobot"))):
        export(episodes(), tmp_path / "set", advance=2.0)
