"""Floors and walls with a texture, whose depth is known on paper."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dream.geometry import SE3, Camera, FloatArray, camera_mount
from dream.perception import View
from dream.types import Float32Array, Label, UInt8Array

CAMERA = Camera.from_fov(320, 240, math.radians(90.0))
MOUNT = camera_mount(math.radians(30.0))
ALTITUDE = 1.5
FINER = 2
"""Rays along each side of a pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A picture, what is true of it, and where it was taken."""

    rgb: UInt8Array
    depth: Float32Array
    labels: UInt8Array
    view: View


def pose(x: float, y: float, yaw: float) -> SE3:
    """At `ALTITUDE` above the floor."""
    return SE3.level(x, y, 0.0, yaw)


@dataclass(frozen=True, slots=True)
class Scene:
    """A floor `ALTITUDE` below, that falls away, and a wall across the way."""

    wall: float = 4.0
    """Metres ahead of the origin; infinity without."""
    fall: float = 0.0
    """Metres that the floor sinks on each metre ahead."""
    contrast: float = 25.0
    """Greys by which the texture scatters."""
    tiles: float = 0.0
    """Metres after which the texture repeats itself, where it does."""
    seed: int = 5

    def seen(self, T_world_base: SE3, T_base_camera: SE3 = MOUNT) -> Seen:
        """Taken from there, with a little noise that is another each time."""
        fine, T_world_camera = CAMERA.scaled(FINER), T_world_base @ T_base_camera
        eye = T_world_camera.translation
        ways = fine.back_project(np.ones((fine.height, fine.width)), T_world_camera) - eye
        with np.errstate(divide="ignore", invalid="ignore"):
            floor = (-ALTITUDE - self.fall * eye[0] - eye[2]) / (ways[..., 2] + self.fall * ways[..., 0])
            wall = (self.wall - eye[0]) / ways[..., 0]
        floor, wall = np.where(floor > 0.0, floor, np.inf), np.where(wall > 0.0, wall, np.inf)
        depth = np.minimum(floor, wall)
        there = eye + np.where(np.isfinite(depth), depth, 0.0)[..., None] * ways
        across = np.where(wall < floor, there[..., 2], there[..., 0])
        grey = self._texture(across + np.where(wall < floor, 40.0, 0.0), there[..., 1])
        grey = np.where(np.isfinite(depth), grey, 128.0)
        rng = np.random.default_rng([self.seed, *(int(1e3 * abs(value)) for value in eye)])
        grey = _coarser(grey) + rng.normal(0.0, 1.0, (CAMERA.height, CAMERA.width))
        rgb = np.repeat(np.clip(np.rint(grey), 0, 255).astype(np.uint8)[..., None], 3, axis=2)
        metres = np.where(np.isfinite(depth), depth, np.nan)[FINER // 2 :: FINER, FINER // 2 :: FINER]
        upright = (wall < floor)[::FINER, ::FINER]
        labels = np.where(upright, Label.OBSTACLE, Label.SEABED).astype(np.uint8)
        labels[np.isnan(metres)] = Label.WATER
        altitude = float(eye[2] + ALTITUDE + self.fall * eye[0])
        view = View(CAMERA, T_world_base, T_base_camera, altitude)
        return Seen(rgb, metres.astype(np.float32), labels, view)

    def _texture(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Greys at places of a plane, metres: waves of many lengths in all directions."""
        if self.tiles > 0.0:
            x, y = (2.0 * math.pi / self.tiles * value for value in (x, y))
            return np.asarray(128.0 + self.contrast * (np.sin(x) + np.sin(y) + np.sin(2.0 * x + y)))
        rng, total = np.random.default_rng(self.seed), np.zeros(x.shape)
        for length in np.geomspace(0.06, 1.0, 24):
            way, phase = rng.uniform(0.0, 2.0 * math.pi, 2)
            total += np.sin(2.0 * math.pi / length * (x * math.cos(way) + y * math.sin(way)) + phase)
        return 128.0 + self.contrast * total / math.sqrt(12.0)


def _coarser(image: FloatArray) -> FloatArray:
    high, wide = image.shape[0] // FINER, image.shape[1] // FINER
    means: FloatArray = image.reshape(high, FINER, wide, FINER).mean(axis=(1, 3))
    return means
