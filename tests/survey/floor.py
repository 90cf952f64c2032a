"""Frames of a flat floor whose colours are known, and a run that kept some."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, Camera, camera_mount
from dream.robots import replay
from dream.types import Label, Observation


def looking_down(x: float, y: float, height: float, yaw: float = 0.0, scale: int = 2) -> Observation:
    """A frame of a flat floor whose colours grow evenly with x (red) and y (green)."""
    camera = Camera.from_fov(48, 36, math.radians(70.0))
    base, mount = SE3.level(x, y, height, yaw), camera_mount(math.radians(90.0))
    depth = np.full((36, 48), height, np.float32)
    fine = camera.scaled(scale)
    points = fine.back_project(np.full((36 * scale, 48 * scale), height), base @ mount)
    return Observation(
        time=0.0,
        rgb=colour(np.asarray(points[..., 0], np.float64), np.asarray(points[..., 1], np.float64)),
        depth=depth,
        labels=np.full(depth.shape, Label.SEABED, np.uint8),
        camera=camera,
        T_world_base=base,
        T_base_camera=mount,
    )


def colour(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
    """Of the floor at x and y."""
    return np.stack([10.0 * x, 10.0 * y, np.full(x.shape, 77.0)], -1).round().clip(0, 255).astype(np.uint8)


def keep_frames(run: Path) -> None:
    """Three frames on the track of `scenes.reef`, as its run keeps them."""
    (run / replay.FOLDER).mkdir(parents=True)
    for number in range(3):
        kept = replay.Kept(None, looking_down(7.0 + 1.5 * number, 8.0, 2.0))
        replay.write(run / replay.FOLDER / f"{number:04d}.npz", kept)
