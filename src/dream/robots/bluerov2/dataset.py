"""A dive → a folder that others can use: pictures, depth, labels, poses, decisions, and what they are.

README.md          what, when, by which sensors, frames and units, counts, licence
calibration.yaml   of the camera, and where it sits
images/NNNN.png    colour as it came
depth/NNNN.png     16-bit millimetres along the optical axis, 0 = no return
labels/NNNN.png    8-bit classes
poses.csv          of the camera's optical frame, one line a picture
decisions.jsonl    what was decided to get there, and why
checksums.sha256   as `sha256sum --check` reads it
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from dream import __version__
from dream.geometry import SE3, Camera
from dream.robots import replay
from dream.robots.bluerov2.messages import quaternion
from dream.types import Float32Array, Label, Observation

FARTHEST_MM = 65_535
"""A depth beyond is written as no return."""
POSES = ("time", "x", "y", "z", "qx", "qy", "qz", "qw", "frame")
DECISIONS = (
    "step",
    "time",
    "decision",
    "guarded",
    "reasoning",
    "collided",
    "distance_m",
    "arrival_note",
    "position_sigma_m",
    "open_region",
    "ended",
    "waited_s",
)
"""What of a line of `steps.jsonl` is released, where it is there."""
NOT_GIVEN = "not given"
FILES = {
    "images/NNNN.png": "colour, 8-bit sRGB, as the mission saw it",
    "depth/NNNN.png": "16-bit millimetres along the optical axis; 0 = no return",
    "labels/NNNN.png": "8-bit classes: " + ", ".join(f"{int(label)} {label.name.lower()}" for label in Label),
    "poses.csv": "time, position and quaternion of the camera's optical frame in `world`, as the vehicle "
    "believed; `frame` is the NNNN of the pictures",
    "decisions.jsonl": "the decision that led to `frame`, what the guard made of it, and why it was made; "
    "angles in radians, positive to the left",
    "calibration.yaml": "camera matrices, and `T_base_camera`",
    "checksums.sha256": "for `sha256sum --check checksums.sha256`",
}
_SOURCE = ".source.json"
"""In a folder that is being made: of what."""


@dataclass(frozen=True, slots=True)
class Card:
    """What only people know of a dive. Nothing is made up for what is left empty."""

    title: str
    what: str = ""
    """In a sentence or two."""
    where: str = ""
    sensors: str = ""
    """Vehicle, camera, lights, DVL."""
    labels_by: str = ""
    """How labels and depth were made, by which model."""
    began: datetime | None = None
    """With a time zone; the dive's clock was 0 then."""
    authors: tuple[str, ...] = ()
    licence: str = ""
    """Its SPDX name, as the owner of the data chose it."""

    def __post_init__(self) -> None:
        if not self.title.strip():
            raise ValueError("title: expected the name of the data set, got none")
        if self.began is not None and self.began.tzinfo is None:
            raise ValueError(f"began: expected a time with its zone, got {self.began}")
        for name in ("title", "licence"):
            if "\n" in getattr(self, name):
                raise ValueError(f"{name}: expected one line, got several")


@dataclass(frozen=True, slots=True)
class Exported:
    """What a data set holds."""

    folder: Path
    frames: int
    decisions: int
    nbytes: int


def export(
    run: Path,
    to: Path,
    card: Card,
    decisions: Iterable[Mapping[str, Any]],
    *,
    watched: Callable[[Sequence[Path]], Iterable[Path]] = iter,
) -> Exported:
    """Write a dive as a data set: whole, or not at all.

    It grows in `.partial.NAME` beside `to`. What an interruption leaves there is gone on with the next time,
    as long as the dive is the same.

    Args:
        run: Folder of the dive, whose observations were kept (`replay.Keeping`).
        to: The folder to make.
        card: What it is.
        decisions: Lines of `steps.jsonl` as mappings; `recording.read_steps` reads and checks them.
        watched: Passes the files of the frames on, and may show how far it is.

    Raises:
        FileNotFoundError: Nothing was kept of the dive.
        ValueError: Something of it is damaged, or `to` exists.
        OSError: It cannot be written.
    """
    if to.exists():
        raise ValueError(f"data set: expected a folder that does not exist, got {to}. Choose another")
    files = sorted((run / replay.FOLDER).glob("*.npz"))
    if not files:
        raise FileNotFoundError(
            f"{run}: expected a dive with its observations, got no {replay.FOLDER}/*.npz in it. "
            "A simulated run keeps them with --keep-observations"
        )
    lines = _decision_lines(decisions, {file.stem for file in files}, run)
    folder = _begun(to, files)
    frames = _Frames(folder)
    for file in watched(files):
        frames.add(file)
    _replace(folder / "poses.csv", frames.poses())
    _replace(folder / "decisions.jsonl", "".join(f"{line}\n" for line in lines).encode())
    _replace(folder / "calibration.yaml", frames.calibration().encode())
    _replace(folder / "README.md", _readme(card, frames, len(lines)).encode())
    sums = "".join(f"{_sha256(folder / name)}  {name}\n" for name in _names(folder))
    _replace(folder / "checksums.sha256", sums.encode())
    nbytes = sum((folder / name).stat().st_size for name in _names(folder))
    (folder / _SOURCE).unlink()
    folder.rename(to)
    return Exported(to, len(files), len(lines), nbytes)


def _begun(to: Path, files: list[Path]) -> Path:
    """The folder that grows: a new one, or what is left of the last attempt on the same dive."""
    folder = to.with_name(f".partial.{to.name}")
    source = json.dumps(
        {
            "version": __version__,
            "files": [[file.name, (stat := file.stat()).st_size, stat.st_mtime_ns] for file in files],
        }
    )
    if folder.exists():
        left = folder / _SOURCE
        if any(folder.iterdir()) and not left.exists():
            raise ValueError(f"{folder}: expected what is left of an attempt, got something else. Remove it")
        if not left.exists() or left.read_text() != source:
            shutil.rmtree(folder)
    try:
        for name in ("images", "depth", "labels"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        _replace(folder / _SOURCE, source.encode())
    except OSError as error:
        raise OSError(
            f"data set: expected a place that can be written, got {to} ({error.strerror or error})"
        ) from error
    return folder


class _Frames:
    """Writes frame by frame, and remembers what the other files say of them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._rows: list[list[str]] = []
        self._first: Observation | None = None
        self._labels: Counter[int] = Counter()
        self._times: list[float] = []
        self._measured = 0

    def add(self, file: Path) -> None:
        """Write one, but for what an earlier attempt has written of it."""
        seen = replay.read(file).observation
        if self._times and seen.time < self._times[-1]:
            raise ValueError(f"{file}: expected a time after {self._times[-1]}, got {seen.time}")
        self._check_same(seen, file)
        pictures: dict[str, Callable[[], Image.Image]] = {
            "images": lambda: Image.fromarray(seen.rgb),
            "depth": lambda: Image.fromarray(_millimetres(seen.depth)),
            "labels": lambda: Image.fromarray(seen.labels),
        }
        for kind, make in pictures.items():
            path = self._folder / kind / f"{file.stem}.png"
            if not path.exists():
                buffer = io.BytesIO()
                make().save(buffer, "PNG")
                _replace(path, buffer.getvalue())
        T = seen.T_world_camera
        w, x, y, z = quaternion(T.rotation)
        numbers = [seen.time, *T.translation.tolist(), x, y, z, w]
        self._rows.append([f"{number:.9f}" for number in numbers] + [file.stem])
        self._times.append(seen.time)
        classes, counts = np.unique(seen.labels, return_counts=True)
        self._labels.update(dict(zip(classes.tolist(), counts.tolist(), strict=True)))
        self._measured += int(np.isfinite(seen.depth).sum())

    def _check_same(self, seen: Observation, file: Path) -> None:
        first = self._first
        if first is None:
            self._first = seen
            return
        one, other = ((o.camera, o.rgb.shape, _matrix(o.T_base_camera).tolist()) for o in (first, seen))
        if one != other:
            raise ValueError(f"{file}: expected the camera of the first frame, got another one or mounting")

    @property
    def first(self) -> Observation:
        """The first frame."""
        assert self._first is not None
        return self._first

    @property
    def count(self) -> int:
        """Frames."""
        return len(self._rows)

    @property
    def span(self) -> tuple[float, float]:
        """Seconds of the first and the last frame."""
        return self._times[0], self._times[-1]

    def shares(self) -> Iterator[tuple[str, float]]:
        """Share of the pixels, by class; and of those with a depth."""
        pixels = sum(self._labels.values())
        for label in Label:
            yield f"label {int(label)}, {label.name.lower()}", self._labels[label] / pixels
        yield "with a depth", self._measured / pixels

    def poses(self) -> bytes:
        """`poses.csv`."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(POSES)
        writer.writerows(self._rows)
        return text.getvalue().encode()

    def calibration(self) -> str:
        """`calibration.yaml`; the matrices are those of OpenCV, where pixel centres are whole numbers."""
        first = self.first
        factor = len(first.rgb) // first.camera.height
        T = _matrix(first.T_base_camera).tolist()
        lines = [
            "# Pinhole, without distortion. Pixel centres at whole numbers, as OpenCV has them.",
            *_yaml_camera("images", first.camera.scaled(factor)),
            *_yaml_camera("depth_and_labels", first.camera),
            "# Takes points of the optical frame (right, down, forward) to base (forward, left, up); metres.",
            "T_base_camera:",
            *(f"  - {json.dumps(row)}" for row in [*T, [0.0, 0.0, 0.0, 1.0]]),
        ]
        return "\n".join(lines) + "\n"


def _yaml_camera(name: str, camera: Camera) -> list[str]:
    matrix = [[camera.fx, 0.0, camera.cx - 0.5], [0.0, camera.fy, camera.cy - 0.5], [0.0, 0.0, 1.0]]
    return [
        f"{name}:",
        f"  width: {camera.width}",
        f"  height: {camera.height}",
        "  model: pinhole",
        "  distortion: [0.0, 0.0, 0.0, 0.0, 0.0]",
        "  camera_matrix:",
        *(f"    - {json.dumps(row)}" for row in matrix),
    ]


def _decision_lines(decisions: Iterable[Mapping[str, Any]], frames: set[str], run: Path) -> list[str]:
    lines: list[str] = []
    for number, decided in enumerate(decisions, start=1):
        step = decided.get("step")
        missing = [name for name in DECISIONS[:5] if name not in decided]
        if missing or not isinstance(step, int):
            raise ValueError(
                f"decision {number}: expected a line of steps.jsonl, got no {', '.join(missing)}"
            )
        frame = f"{step:04d}"
        if frame not in frames:
            raise ValueError(f"decision {number}: expected a frame that was kept in {run}, got step {step}")
        released = {name: decided[name] for name in DECISIONS if name in decided}
        # The step's picture was taken where it ended.
        lines.append(json.dumps({"frame": frame, **released}, allow_nan=False))
    return lines


def _readme(card: Card, frames: _Frames, decisions: int) -> str:
    front = ["---", f"title: {json.dumps(card.title)}"]
    if card.licence:
        front.append(f"license: {json.dumps(card.licence)}")
    began, ended = frames.span
    when = card.began.isoformat(timespec="seconds") if card.began else NOT_GIVEN
    first = frames.first
    camera = first.camera
    height, width = first.rgb.shape[:2]
    shares = "\n".join(f"| pixels {name} | {100.0 * share:.2f} % |" for name, share in frames.shares())
    return "\n".join(
        [
            *front,
            "---",
            "",
            f"# {card.title}",
            "",
            card.what or f"What it shows: {NOT_GIVEN}.",
            "",
            f"- Authors: {', '.join(card.authors) or NOT_GIVEN}",
            f"- Licence: {card.licence or NOT_GIVEN}",
            f"- When the clock of the dive was 0: {when}",
            f"- Where: {card.where or NOT_GIVEN}",
            f"- Sensors: {card.sensors or NOT_GIVEN}",
            f"- Labels and depth by: {card.labels_by or NOT_GIVEN}",
            f"- Written by: dream {__version__}",
            "",
            "## Counts",
            "",
            "| what | how many |",
            "|---|---|",
            f"| frames | {frames.count} |",
            f"| decisions | {decisions} |",
            f"| seconds from the first frame to the last | {ended - began:.1f} |",
            f"| pixels of a picture | {width} × {height} |",
            f"| pixels of depth and labels | {camera.width} × {camera.height} |",
            shares,
            "",
            "## Frames and units",
            "",
            "Metres, radians, seconds of the dive's clock. `world` is the dive's map: x and y are those of",
            "`--at` and `--area`, which say where the dive began and what is surveyed; z is up and 0 at the",
            "surface. It is not tied to a place on earth, nor to north. `base` is the vehicle:",
            "forward, left, up. The camera's optical frame is right, down, forward.",
            "",
            "## Files",
            "",
            "| file | holds |",
            "|---|---|",
            *(f"| `{name}` | {holds} |" for name, holds in FILES.items()),
            "",
        ]
    )


def _millimetres(depth: Float32Array) -> np.ndarray[Any, np.dtype[np.uint16]]:
    millimetres = np.nan_to_num(1000.0 * depth.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    inside = (millimetres > 0.0) & (np.rint(millimetres) <= FARTHEST_MM)
    return np.where(inside, np.rint(millimetres), 0.0).astype(np.uint16)


def _matrix(T: SE3) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.column_stack([T.rotation, T.translation])


def _names(folder: Path) -> list[str]:
    """Of all files of the data set."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != _SOURCE)
    return sorted(path.relative_to(folder).as_posix() for path in files)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _replace(path: Path, content: bytes) -> None:
    partial = path.with_name(f".{path.name}")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise OSError(f"could not write {path} ({error.strerror or error})") from error
