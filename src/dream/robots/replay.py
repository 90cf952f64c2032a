"""What a robot saw and where it came, kept on disk; and a robot that plays it back.

All that passes between a mission and its robot is kept, one file a move: `observations/NNNN.npz` holds the
move that led there, where it ended, and what was seen, to the last bit (`frames/` of a run folder rounds
depth to millimetres, and has no camera). 0000 is the first look. A file is there whole or not at all.
"""

from __future__ import annotations

import io
import math
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from dream import arrays as reading
from dream.control import setpoint
from dream.files import whole_or_nothing
from dream.geometry import SE2, SE3, Camera, wrap_angle
from dream.protocol import SurveyProtocol
from dream.types import Arrival, Observation, Setpoint, Step, UInt8Array

if TYPE_CHECKING:
    from dream.mission import Robot

FOLDER = "observations"
SAME = 1e-6
"""Metres and radians between setpoints that are the same: another machine may round otherwise."""
MOST_BYTES = 64 << 20
"""Of a file; a larger one is refused."""
MOST_UNPACKED = 512 << 20
"""Bytes of all arrays of a file."""

Arrays = Mapping[str, npt.NDArray[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """Where a robot was sent, and where it came."""

    setpoint: Setpoint
    arrival: Arrival


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """One file: the move that led there, None for the first look, and what was seen there."""

    move: Move | None
    observation: Observation


class Keeping:
    """Keeps what another robot sees and where it comes, and is that robot in all else.

    What it does: after every move the first observation is written before it is handed on, and is the same
    until the next move, so that a replay sees what the mission saw.
    Fails when: the disk is full; it then raises, and all before is kept.
    """

    def __init__(self, robot: Robot, folder: Path) -> None:
        """Around a robot that was not used yet.

        Args:
            robot: What observes and goes.
            folder: Of the run; `observations` is made in it.

        Raises:
            ValueError: There are observations in it already.
            OSError: It cannot be written.
        """
        self._robot = robot
        self._folder = _fresh(folder)
        self._moves = 0
        self._move: Move | None = None
        self._seen: Observation | None = None

    def observe(self) -> Observation:
        """One frame; the same again until it moves."""
        if self._seen is None:
            seen = self._robot.observe()
            write(self._folder / f"{self._moves:04d}.npz", Kept(self._move, seen))
            self._seen = seen
        return _copied(self._seen)

    def go_to(self, setpoint: Setpoint) -> Arrival:
        """Send the other robot there."""
        self.observe()  # So that no move is without what was seen before it.
        arrival = self._robot.go_to(setpoint)
        self._moves += 1
        self._move, self._seen = Move(setpoint, arrival), None
        return arrival


def keep(steps: Iterable[Step], folder: Path, protocol: SurveyProtocol) -> Iterator[Step]:
    """Pass every step of a mission through, and keep what was seen and where it came, as `Keeping` does.

    For a robot whose mission is begun before there is a folder.

    Args:
        steps: All of a mission, from its first look on.
        folder: Of the run; `observations` is made in it.
        protocol: That it is flown by: from the decision follows where it was sent.

    Raises:
        ValueError: There are observations in it already.
        OSError: It cannot be written; what was kept before stays.
    """
    observations = _fresh(folder)
    here: Observation | None = None
    for step in steps:
        move = None
        if here is not None:
            to = setpoint(here.pose, step.guarded.decision, protocol, here.z)
            move = Move(to, step.arrival)
        here = step.observation
        write(observations / f"{step.index:04d}.npz", Kept(move, step.observation))
        yield step


def _fresh(folder: Path) -> Path:
    """A folder for observations, in that of a run."""
    observations = folder / FOLDER
    if any(observations.glob("*.npz")):
        raise ValueError(
            f"observations: expected a folder without any, got {observations}. Keep them in a new one"
        )
    observations.mkdir(exist_ok=True)
    return observations


class Replayed:
    """Plays back what was kept of a run; wherever it is sent, it goes where the run went.

    What it does: observations come in the order of the record, so that a map and a planner make of them what
    they made then. A move to another place than then is counted, and noted in its arrival: what follows is
    how the planner would have decided *there*, not a mission that it flew.
    Assumes: at most `moves` moves.
    """

    def __init__(self, folder: Path) -> None:
        """Open a run.

        Args:
            folder: Of the run, with `observations` in it.

        Raises:
            FileNotFoundError: Nothing was kept.
            ValueError: Some of it is missing.
        """
        self._files = sorted((folder / FOLDER).glob("*.npz"))
        if not self._files:
            raise FileNotFoundError(
                f"{folder}: expected a run with its observations, got no {FOLDER}/*.npz in it. "
                "They are kept where one asks for them"
            )
        for number, file in enumerate(self._files):
            if file.name != f"{number:04d}.npz":
                raise ValueError(f"{file}: expected {number:04d}.npz before it, which is missing")
        self._index = 0
        self._now = read(self._files[0])
        self._diverged: list[int] = []

    @property
    def moves(self) -> int:
        """How many were kept: that many may be made."""
        return len(self._files) - 1

    @property
    def divergences(self) -> tuple[int, ...]:
        """Moves that led elsewhere than in the record, by number; the first move is 1."""
        return tuple(self._diverged)

    def observe(self) -> Observation:
        """What was seen there."""
        return _copied(self._now.observation)

    def go_to(self, setpoint: Setpoint) -> Arrival:
        """Go where the record went.

        Raises:
            ValueError: The record is over, or damaged.
        """
        if self._index == self.moves:
            raise ValueError(
                f"replay: expected at most {self.moves} moves, got another. The record is over: "
                "let the mission have that many steps"
            )
        kept = read(self._files[self._index + 1])
        if kept.move is None:
            raise ValueError(f"{self._files[self._index + 1]}: expected the move that led there, got none")
        self._index, self._now = self._index + 1, kept
        arrival, then = kept.move.arrival, kept.move.setpoint
        if _same(setpoint, then):
            return arrival
        self._diverged.append(self._index)
        other = f"replay: sent to {_place(setpoint)}, and follows the record to {_place(then)}"
        return replace(arrival, note="; ".join(filter(None, (arrival.note, other))))


def write(path: Path, kept: Kept) -> None:
    """Write a file whole or not at all.

    Raises:
        OSError: It could not be written.
    """
    seen = kept.observation
    camera = seen.camera
    arrays: dict[str, npt.ArrayLike] = {
        "time": seen.time,
        "rgb_png": np.frombuffer(_png(seen.rgb), np.uint8),
        "depth": seen.depth,
        "labels": seen.labels,
        "camera": [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy],
        "T_world_base": _matrix(seen.T_world_base),
        "T_base_camera": _matrix(seen.T_base_camera),
    }
    if seen.confidence is not None:
        arrays["confidence"] = seen.confidence
    if seen.error is not None:
        arrays["error"] = seen.error
    if seen.drawn_wh is not None:
        arrays["drawn_wh"] = seen.drawn_wh
    if seen.trouble:
        arrays["trouble"] = np.frombuffer(seen.trouble.encode(), np.uint8)
    if kept.move is not None:
        to, arrival = kept.move.setpoint, kept.move.arrival
        arrays |= {
            "setpoint": [to.x, to.y, to.yaw, *(() if to.altitude is None else (to.altitude,))],
            "arrival": [arrival.pose.x, arrival.pose.y, arrival.pose.yaw],
            "travelled": [arrival.distance, arrival.clearance, arrival.sigma],
            "collided": arrival.collided,
            "note": np.frombuffer(arrival.note.encode(), np.uint8),
        }
        if to.z is not None:
            arrays["height"] = [to.z, math.nan if to.tilt is None else to.tilt]
        if arrival.contact is not None:
            arrays["contact"] = list(arrival.contact)
        if arrival.truth is not None:
            arrays["truth"] = _matrix(arrival.truth)
    with whole_or_nothing(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def read(path: Path) -> Kept:
    """What a file holds.

    Raises:
        FileNotFoundError: There is none.
        ValueError: It is damaged.
    """
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path}: expected at most {MOST_BYTES} bytes, got more")
    with reading.opened(path, "what was seen and done", MOST_UNPACKED) as arrays:
        return _kept(arrays)


def _kept(arrays: Arrays) -> Kept:
    width, height, *lens = _numbers(arrays, "camera", (6,)).tolist()
    rgb = _picture(arrays["rgb_png"].tobytes())
    seen = Observation(
        time=float(_numbers(arrays, "time", ())),
        rgb=rgb,
        depth=_typed(arrays, "depth", np.float32),
        labels=_typed(arrays, "labels", np.uint8),
        camera=Camera(int(width), int(height), *lens),
        T_world_base=_transform(arrays, "T_world_base"),
        T_base_camera=_transform(arrays, "T_base_camera"),
        confidence=_typed(arrays, "confidence", np.float32) if "confidence" in arrays else None,
        error=_typed(arrays, "error", np.float32) if "error" in arrays else None,
        drawn_wh=float(_numbers(arrays, "drawn_wh", ())) if "drawn_wh" in arrays else None,
        trouble=arrays["trouble"].tobytes().decode() if "trouble" in arrays else "",
    )
    if "setpoint" not in arrays:
        return Kept(None, seen)
    contact = _numbers(arrays, "contact", (3,)).tolist() if "contact" in arrays else None
    distance, clearance, sigma = _numbers(arrays, "travelled", (3,), inf=True).tolist()
    arrival = Arrival(
        pose=SE2(*_numbers(arrays, "arrival", (3,)).tolist()),
        collided=bool(_numbers(arrays, "collided", ())),
        distance=distance,
        clearance=clearance,
        note=arrays["note"].tobytes().decode(),
        sigma=sigma,
        truth=_transform(arrays, "truth") if "truth" in arrays else None,
        contact=(contact[0], contact[1], contact[2]) if contact else None,
    )
    return Kept(Move(_setpoint(arrays), arrival), seen)


def _setpoint(arrays: Arrays) -> Setpoint:
    if "height" not in arrays:
        return Setpoint(*_numbers(arrays, "setpoint", (4,)).tolist())
    z, tilt = arrays["height"].tolist() if arrays["height"].shape == (2,) else (math.nan, math.nan)
    if not math.isfinite(z) or math.isinf(tilt):
        raise ValueError(f"height: expected metres and a tilt or NaN, got {arrays['height'].tolist()!r:.80}")
    x, y, yaw = _numbers(arrays, "setpoint", (3,)).tolist()
    return Setpoint(x, y, yaw, None, z, None if math.isnan(tilt) else tilt)


def _picture(content: bytes) -> UInt8Array:
    """(H, W, 3) of a PNG file."""
    try:
        with Image.open(io.BytesIO(content), formats=["PNG"]) as image:
            if 3 * image.width * image.height > MOST_UNPACKED:
                raise ValueError(f"rgb_png: expected at most {MOST_UNPACKED} bytes, got {image.size} pixels")
            return np.array(image.convert("RGB"))
    except (OSError, SyntaxError, Image.DecompressionBombError, zlib.error, struct.error) as error:
        raise ValueError(f"rgb_png: expected a picture, got {error}") from error


def _numbers(arrays: Arrays, name: str, shape: tuple[int, ...], *, inf: bool = False) -> npt.NDArray[Any]:
    array = arrays[name]
    good: Callable[[Any], Any] = (lambda values: ~np.isnan(values)) if inf else np.isfinite
    if array.shape != shape or array.dtype.kind not in "biuf" or not good(array).all():
        raise ValueError(f"{name}: expected finite numbers {shape}, got {array.shape}")
    return array


def _typed(arrays: Arrays, name: str, kind: type[np.generic]) -> npt.NDArray[Any]:
    array = arrays[name]
    if array.dtype != kind or array.ndim != 2:
        raise ValueError(f"{name}: expected (H, W) {kind.__name__}, got {array.shape} {array.dtype}")
    return array


def _matrix(T: SE3) -> npt.NDArray[np.float64]:
    """(3, 4): rotation and translation."""
    return np.column_stack([T.rotation, T.translation])


def _transform(arrays: Arrays, name: str) -> SE3:
    matrix = _numbers(arrays, name, (3, 4))
    try:
        return SE3(np.ascontiguousarray(matrix[:, :3]), np.ascontiguousarray(matrix[:, 3]))
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


def _png(rgb: UInt8Array) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(rgb).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def _copied(seen: Observation) -> Observation:
    confidence, error = (None if x is None else x.copy() for x in (seen.confidence, seen.error))
    return replace(
        seen,
        rgb=seen.rgb.copy(),
        depth=seen.depth.copy(),
        labels=seen.labels.copy(),
        confidence=confidence,
        error=error,
    )


def _same(one: Setpoint, other: Setpoint) -> bool:
    if (one.z is None, one.tilt is None) != (other.z is None, other.tilt is None):
        return False
    apart = [one.x - other.x, one.y - other.y, wrap_angle(one.yaw - other.yaw)]
    for mine, others in ((one.altitude, other.altitude), (one.z, other.z), (one.tilt, other.tilt)):
        apart += [] if mine is None or others is None else [mine - others]
    return all(abs(by) <= SAME for by in apart)


def _place(to: Setpoint) -> str:
    high = "" if to.z is None else f", {to.z:.2f}"
    return f"({to.x:.2f}, {to.y:.2f}{high}) heading {math.degrees(to.yaw):.0f}°"
