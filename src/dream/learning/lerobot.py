"""Missions to learn from → a data set as LeRobot reads it (version 3.0 of its layout).

meta/info.json                            counts, rate, what each column is
meta/stats.json                           least, greatest, mean and spread of each column
meta/tasks.parquet                        the tasks in words
meta/episodes/chunk-000/file-000.parquet  one row a mission: its task, its rows, the file that they are in
data/chunk-000/file-000.parquet           one row a frame; a picture is a PNG in its row

Reference: the documentation and the reader of LeRobot 0.4 (Hugging Face, Apache-2.0).
"""

from __future__ import annotations

import io
import json
import math
import shutil
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream import extras
from dream.perception.representation import HEIGHT, WIDTH
from dream.planning.baselines.uivnav import TURNS_DEG
from dream.types import Float32Array, UInt8Array

VERSION = "v3.0"
RATE = 1
"""Frames a second: a step of a mission has no other clock."""
MOST_BYTES = 100 << 20
"""Of pictures in one file of frames; LeRobot's own default."""
CHUNK = 1000
"""Files in one folder."""
IMAGE, ACTION, ODDS = "observation.images.representation", "action", "expert.odds"
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

Columns = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """One mission."""

    task: str
    """What was to be done, in words."""
    images: UInt8Array
    """(n, 2, 72, 96); see `perception.represent`."""
    odds: Float32Array
    """(n, 7) how likely the teacher takes each of `TURNS_DEG` there."""

    def __post_init__(self) -> None:
        count = len(self.images)
        if count == 0 or self.images.shape != (count, 2, HEIGHT, WIDTH) or self.images.dtype != np.uint8:
            raise ValueError(
                f"images: expected one or more of (2, {HEIGHT}, {WIDTH}) uint8, got {self.images.shape} "
                f"{self.images.dtype}"
            )
        if self.odds.shape != (count, len(TURNS_DEG)) or not np.isfinite(self.odds).all():
            raise ValueError(
                f"odds: expected ({count}, {len(TURNS_DEG)}) finite numbers, got {self.odds.shape}"
            )


@dataclass(frozen=True, slots=True)
class Exported:
    """What a data set holds."""

    folder: Path
    episodes: int
    frames: int


def export(episodes: Iterable[Episode], folder: Path, *, advance: float, robot: str = "dream") -> Exported:
    """Write a data set: whole, or not at all.

    A picture is a PNG with red for nearness and green for the share of target, 255 for 1, and no blue. The
    action is the teacher's likeliest turn (radians, positive to the left) and the advance (metres). Frames
    are a second apart, as if a step took one.

    Args:
        episodes: At least one.
        folder: To make; it must not exist.
        advance: Metres of every step.
        robot: What it was flown by, for `meta/info.json`.

    Raises:
        ValueError: The folder exists, there is no episode, or pyarrow is not installed.
        OSError: It cannot be written.
    """
    check_possible(folder)
    import pyarrow as pa

    if not 0.0 < advance < math.inf:
        raise ValueError(f"advance: expected metres above 0, got {advance}")
    partial = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    writing = _Writing(partial, pa)
    try:
        for episode in episodes:
            writing.add(episode, advance)
        writing.close(robot)
        partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return Exported(folder, len(writing.rows), writing.frames)


def check_possible(folder: Path) -> None:
    """Raise a ValueError where the folder exists already, or pyarrow is not installed."""
    extras.check_installed("train", "a data set for LeRobot", "pyarrow")
    if folder.exists():
        raise ValueError(f"data set: expected a folder that does not exist, got {folder}. Choose another")


@dataclass(slots=True)
class _Writing:
    """A data set that grows."""

    folder: Path
    pa: Any
    tasks: dict[str, int] = field(default_factory=dict)
    rows: list[dict[str, Any]] = field(default_factory=list)
    """Of `meta/episodes`."""
    stats: list[dict[str, dict[str, npt.NDArray[Any]]]] = field(default_factory=list)
    """Of each episode, by column."""
    frames: int = 0
    files: int = 0
    waiting: list[Any] = field(default_factory=list)
    """Tables of the file that is not yet written."""
    size: int = 0
    """Bytes of the pictures in them."""

    def add(self, episode: Episode, advance: float) -> None:
        """Take in one mission."""
        number, count = len(self.rows), len(episode.images)
        task = self.tasks.setdefault(episode.task, len(self.tasks))
        turns = np.radians(TURNS_DEG)[episode.odds.argmax(axis=1)]
        columns: Columns = {
            ACTION: np.stack([turns, np.full(count, advance)], axis=1).astype(np.float32),
            ODDS: episode.odds.astype(np.float32),
            "timestamp": (np.arange(count) / RATE).astype(np.float32),
            "frame_index": np.arange(count),
            "episode_index": np.full(count, number),
            "index": self.frames + np.arange(count),
            "task_index": np.full(count, task),
        }
        pictures = [_png(image) for image in episode.images]
        self.waiting.append(self._table(pictures, columns))
        self.size += sum(map(len, pictures))
        stats = {name: _stats(values, axis=(0,)) for name, values in columns.items()}
        colours = np.zeros((count, 3, HEIGHT, WIDTH), np.float32)
        colours[:, :2] = episode.images / np.float32(255.0)
        stats[IMAGE] = _stats(colours, axis=(0, 2, 3))
        self.stats.append(stats)
        self.rows.append(
            {
                "episode_index": number,
                "tasks": [episode.task],
                "length": count,
                "data/chunk_index": self.files // CHUNK,
                "data/file_index": self.files % CHUNK,
                "dataset_from_index": self.frames,
                "dataset_to_index": self.frames + count,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                **{
                    f"stats/{column}/{name}": values.tolist()
                    for column, of_it in stats.items()
                    for name, values in of_it.items()
                },
            }
        )
        self.frames += count
        if self.size >= MOST_BYTES:
            self._flush()

    def close(self, robot: str) -> None:
        """Write what is left, and what it all is."""
        if not self.rows:
            raise ValueError("episodes: expected one or more, got none")
        self._flush()
        pa = self.pa
        self._write("meta/episodes/chunk-000/file-000.parquet", pa.Table.from_pylist(self.rows))
        self._write("meta/tasks.parquet", self._task_table())
        info = {
            "codebase_version": VERSION,
            "robot_type": robot,
            "total_episodes": len(self.rows),
            "total_frames": self.frames,
            "total_tasks": len(self.tasks),
            "chunks_size": CHUNK,
            "data_files_size_in_mb": MOST_BYTES >> 20,
            "video_files_size_in_mb": MOST_BYTES >> 20,
            "fps": RATE,
            "splits": {"train": f"0:{len(self.rows)}"},
            "data_path": f"data/{FILE}",
            "video_path": None,
            "features": FEATURES,
        }
        together = {
            column: {name: values.tolist() for name, values in _joined([s[column] for s in self.stats])}
            for column in FEATURES
        }
        for name, content in (("info", info), ("stats", together)):
            (self.folder / f"meta/{name}.json").write_text(json.dumps(content, indent=4), encoding="utf-8")

    def _flush(self) -> None:
        if self.waiting:
            path = FILE.format(chunk_index=self.files // CHUNK, file_index=self.files % CHUNK)
            self._write(f"data/{path}", self.pa.concat_tables(self.waiting))
            self.files += 1
            self.waiting, self.size = [], 0

    def _write(self, name: str, table: Any) -> None:
        import pyarrow.parquet as pq

        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table, path, compression="snappy")

    def _table(self, pictures: list[bytes], columns: Columns) -> Any:
        """Rows of frames, with a note by which Hugging Face's `datasets` knows the pictures."""
        pa = self.pa
        picture = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
        arrays = {IMAGE: pa.array([{"bytes": png, "path": None} for png in pictures], picture)}
        kinds: dict[str, Any] = {IMAGE: {"_type": "Image"}}
        for name, values in columns.items():
            arrays[name] = pa.array(values.reshape(-1))
            kinds[name] = {"dtype": str(values.dtype), "_type": "Value"}
            if values.ndim > 1:
                length = values.shape[1]
                arrays[name] = pa.FixedSizeListArray.from_arrays(arrays[name], length)
                kinds[name] = {"feature": kinds[name], "length": length, "_type": "Sequence"}
        note = json.dumps({"info": {"features": kinds}})
        return pa.table(arrays).replace_schema_metadata({"huggingface": note})

    def _task_table(self) -> Any:
        """Numbers of the tasks, with a note by which pandas takes the words for the index."""
        pa = self.pa
        index = "__index_level_0__"
        columns = [
            {"name": name, "field_name": file, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
            for name, file, kind, numpy in (
                ("task_index", "task_index", "int64", "int64"),
                (None, index, "unicode", "object"),
            )
        ]
        names = {"name": None, "field_name": None, "pandas_type": "unicode", "numpy_type": "object"}
        note = {
            "index_columns": [index],
            "column_indexes": [{**names, "metadata": {"encoding": "UTF-8"}}],
            "columns": columns,
            "pandas_version": "2.0.0",
        }
        table = pa.table(
            {"task_index": pa.array(list(self.tasks.values()), pa.int64()), index: [*self.tasks]}
        )
        return table.replace_schema_metadata({"pandas": json.dumps(note)})


def _feature(kind: str, shape: tuple[int, ...], names: list[str] | None) -> dict[str, Any]:
    return {"dtype": kind, "shape": list(shape), "names": names}


FEATURES: Mapping[str, dict[str, Any]] = {
    IMAGE: _feature("image", (HEIGHT, WIDTH, 3), ["height", "width", "channels"]),
    ACTION: _feature("float32", (2,), ["turn", "advance"]),
    ODDS: _feature("float32", (len(TURNS_DEG),), [f"turn {turn}" for turn in TURNS_DEG]),
    "timestamp": _feature("float32", (1,), None),
    **{
        name: _feature("int64", (1,), None)
        for name in ("frame_index", "episode_index", "index", "task_index")
    },
}
"""The columns, as `meta/info.json` has them."""


def _png(image: UInt8Array) -> bytes:
    from PIL import Image

    colours = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    colours[..., :2] = image.transpose(1, 2, 0)
    file = io.BytesIO()
    Image.fromarray(colours).save(file, "PNG")
    return file.getvalue()


def _stats(values: npt.NDArray[Any], axis: tuple[int, ...]) -> dict[str, npt.NDArray[Any]]:
    """Of a column; of pictures (3, 1, 1), a number for each colour."""
    wide = values.astype(np.float64)
    if wide.ndim == 1:
        wide = wide[:, None]
    inner = wide.ndim == 4
    found = {
        name: function(wide, axis=axis)[:, None, None] if inner else function(wide, axis=axis)
        for name, function in (("min", np.min), ("max", np.max), ("mean", np.mean), ("std", np.std))
    }
    return {**found, "count": np.array([len(values)])}


def _joined(parts: list[dict[str, npt.NDArray[Any]]]) -> Iterator[tuple[str, npt.NDArray[Any]]]:
    """Of several episodes together."""
    counts = np.array([part["count"][0] for part in parts], np.float64)
    means, spreads = (np.stack([part[name] for part in parts]) for name in ("mean", "std"))
    mean = np.average(means, axis=0, weights=counts)
    yield "min", np.min([part["min"] for part in parts], axis=0)
    yield "max", np.max([part["max"] for part in parts], axis=0)
    yield "mean", mean
    yield "std", np.sqrt(np.average(spreads**2 + (means - mean) ** 2, axis=0, weights=counts))
    yield "count", np.array([int(counts.sum())])
