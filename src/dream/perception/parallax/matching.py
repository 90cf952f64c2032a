"""Two pictures from known places → how deep some points of one are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dream.geometry import SE3, Camera, FloatArray
from dream.types import BoolArray, Float32Array, UInt8Array

CELL = 15
"""Pixels of a picture `halved` along each side of a cell of which the best corner is taken."""
MOMENTS = 2
"""Pixels to each side of a corner whose gradients make it one."""
LEAST_GRADIENT = 0.3
"""Mean square of the gradient, in greys of 255, in the direction in which a corner has least."""
CONTRAST = 1.5
"""Greys of 255 that a patch scatters by at least."""
ALIKE = 0.8
"""Correlation of two patches that show the same."""
UNIQUE = 1.5
"""How many times as far from 1 the correlation is of whatever else may be meant."""
NEAREST, FARTHEST = 0.25, 30.0
"""Metres between which points are looked for."""
NOISE = 0.5
"""Pixels that a match errs by."""
OFF_LINE = 1.5
"""Pixels beside the line that a match must lie on, once the pose is adjusted, beyond which it is none."""
LEAST_KNOWN = 0.1
"""Standard deviation of the logarithm of a depth beyond which it tells nothing: too little parallax."""
ROBUST = 0.5
"""Pixels from which on an offset counts only as its sign."""


@dataclass(frozen=True, slots=True)
class PoseNoise:
    """By how much the pose from one picture to the other errs, one standard deviation."""

    move: float = 0.02
    """Metres along each axis."""
    turn: float = math.radians(0.3)
    """Radians about each axis."""


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A picture and where it was taken."""

    levels: tuple[Float32Array, Float32Array, Float32Array]
    """(H, W) greys, and the same at half and at a quarter of the size."""
    camera: Camera
    T_world_camera: SE3

    @staticmethod
    def of(rgb: UInt8Array, camera: Camera, T_world_camera: SE3) -> Shot:
        """From its colours, (H, W, 3)."""
        from dream.perception.parallax import _kernels

        fine = _kernels.grey(rgb)
        half = _kernels.halved(fine)
        return Shot((fine, half, _kernels.halved(half)), camera, T_world_camera)


@dataclass(frozen=True, slots=True, eq=False)
class MotionPoints:
    """Depths of some points of a picture."""

    places: FloatArray
    """(n, 2) columns and rows, pixels; centres lie at half-integers."""
    depth: FloatArray
    """(n,) metres along the optical axis."""
    sigma: FloatArray
    """(n,) standard deviation of the logarithm of each, by itself."""
    shared: float
    """Standard deviation of the mean of all logarithms, by the pose."""


def corners(shot: Shot, usable: BoolArray) -> FloatArray:
    """(n, 2) columns and rows of points that can be found again, spread over `usable` pixels, (H, W)."""
    from dream.perception.parallax import _kernels

    half = shot.levels[1]
    fits = np.ascontiguousarray(usable[: 2 * len(half) : 2, : 2 * half.shape[1] : 2])
    return np.asarray(2.0 * _kernels.corners(half, fits, CELL, MOMENTS, LEAST_GRADIENT))


def best_shot(now: Shot, earlier: Sequence[Shot], away: FloatArray) -> list[Shot]:
    """The earlier pictures that show the same from elsewhere, the best first.

    Args:
        now: The present picture.
        earlier: All others.
        away: (m, 3) points that it may show, in its camera's frame.
    """
    rated = []
    for shot in earlier:
        T_then_now = shot.T_world_camera.inverse @ now.T_world_camera
        pixels, depth = shot.camera.project(T_then_now @ away)
        turned = away @ T_then_now.rotation.T
        alone, _ = shot.camera.project(turned)
        with np.errstate(invalid="ignore"):
            size = shot.camera.width, shot.camera.height
            inside = (pixels >= 0.0).all(axis=1) & (pixels < size).all(axis=1)
            moved = np.hypot(*(pixels - alone).T) * turned[:, 2] / depth
            useful = inside & (moved * LEAST_KNOWN > NOISE) & (depth > 0.4 * away[:, 2])
        if useful.mean() >= 0.15:
            rated.append((float(useful.mean()), shot))
    return [shot for _, shot in sorted(rated, key=lambda one: -one[0])]


def depths(now: Shot, then: Shot, places: FloatArray, up: FloatArray, noise: PoseNoise) -> MotionPoints:
    """How deep points of a picture are, by an earlier one.

    What it does: each is looked for along the line on which it has to be in the earlier picture, as a patch
    that lies on level ground, or faces the camera. What the matches are off their lines by corrects the pose
    between the two, within what it may err by. What then still is off its line is no match.

    Args:
        now: The present picture.
        then: An earlier one.
        places: (n, 2) columns and rows.
        up: (3,) the world's vertical in the present camera's frame.
        noise: Of the pose between the two.
    """
    from dream.perception.parallax import _kernels

    T_then_now = then.T_world_camera.inverse @ now.T_world_camera
    facing = np.array([0.0, 0.0, 1.0]) - up[2] * up
    length = float(np.linalg.norm(facing))
    upright = facing / length if length > 0.1 else np.array([0.0, 0.0, 1.0])
    found = _kernels.matched(
        now.levels,
        then.levels,
        _lens(now.camera),
        _lens(then.camera),
        np.ascontiguousarray(T_then_now.rotation),
        np.ascontiguousarray(T_then_now.translation),
        np.stack([up, upright]),
        np.ascontiguousarray(places),
        np.array([NEAREST, FARTHEST]),
        CONTRAST,
        ALIKE,
        UNIQUE,
    )
    depth, slope, off = found[:, :3].T
    with np.errstate(invalid="ignore"):
        kept = NOISE * depth < LEAST_KNOWN * slope
    places, depth, slope, off = places[kept], depth[kept], slope[kept], off[kept]
    if not len(depth):
        return MotionPoints(places, depth, np.zeros(0), math.inf)
    along, across, relative = _by_pose(now.camera, then.camera, T_then_now, places, depth, slope)
    weights = np.ones(len(off))
    prior = np.diag(NOISE**2 / np.array([noise.turn] * 3 + [noise.move] * 3) ** 2)
    turned = np.zeros(6)
    for _ in range(4):
        normal = across.T @ (weights[:, None] * across) + prior
        turned = np.linalg.solve(normal, across.T @ (weights * off))
        weights = ROBUST / np.maximum(np.abs(off - across @ turned), ROBUST)
    kept = np.abs(off - across @ turned) <= OFF_LINE
    inverse = 1.0 / depth - along @ turned / slope
    kept &= (inverse > 1.0 / FARTHEST) & (inverse < 1.0 / NEAREST)
    covariance = NOISE**2 * np.linalg.inv(normal)
    mean = relative[kept].mean(axis=0) if kept.any() else np.full(6, math.inf)
    return MotionPoints(
        places[kept],
        1.0 / inverse[kept],
        (NOISE * depth / slope)[kept],
        math.sqrt(float(mean @ covariance @ mean)) if kept.any() else math.inf,
    )


def _lens(camera: Camera) -> FloatArray:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy])


def _by_pose(
    now: Camera, then: Camera, T_then_now: SE3, places: FloatArray, depth: FloatArray, slope: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How a turn and a shift of the earlier camera's frame, (6,) radians and metres, change what is found.

    Returns:
        (n, 6) each: pixels along the line, to more inverse depth; pixels across it, to its right; and the
        logarithm of the depth.
    """
    across, along = (places[:, 0] - now.cx) / now.fx, (places[:, 1] - now.cy) / now.fy
    x, y, z = (T_then_now @ (np.stack([across, along, np.ones_like(across)], 1) * depth[:, None])).T
    zero, one = np.zeros_like(z), np.ones_like(z)
    # Of a point in the earlier camera's frame, by turn (ω × p) and shift.
    moves = np.array(
        [[zero, z, -y, one, zero, zero], [-z, zero, x, zero, one, zero], [y, -x, zero, zero, zero, one]]
    ).transpose(2, 0, 1)
    columns = then.fx * (moves[:, 0] - (x / z)[:, None] * moves[:, 2]) / z[:, None]
    rows = then.fy * (moves[:, 1] - (y / z)[:, None] * moves[:, 2]) / z[:, None]
    t = T_then_now.translation
    du, dv = then.fx * (t[0] - x / z * t[2]) * depth / z, then.fy * (t[1] - y / z * t[2]) * depth / z
    du, dv = du / np.hypot(du, dv), dv / np.hypot(du, dv)
    along = du[:, None] * columns + dv[:, None] * rows
    across = du[:, None] * rows - dv[:, None] * columns
    return along, across, along * (depth / slope)[:, None]
