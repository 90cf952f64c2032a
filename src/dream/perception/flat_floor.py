"""Depth without a model: the floor is flat, and what stands on it rises straight up from its foot.

A vehicle that knows its altitude, its roll and pitch and its camera's mount knows where every ray meets a
flat floor. What is labelled obstacle hides that floor; the lowest thing seen of it is where it stands, and
all that is seen straight above is as far away over ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dream.geometry import Camera, FloatArray
from dream.perception.view import View
from dream.types import BoolArray, Float32Array, Label, UInt8Array

BEHIND_FOOT = 0.9
"""Confidence in the depth of what stands up, of that in the floor at its foot."""
FOOT_UNSEEN = 0.3
"""The same where the foot lies below the image: the depth is then the greatest possible."""
SAMPLE = 0.7
"""Pixels between samples of the mask along azimuth and elevation."""
PIXELS_ROUGH = 1.5
"""Pixels by which a foot or an attitude errs, by which the confidence in a depth falls with range."""


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """The rays of all pixels over a level floor below the camera."""

    down: FloatArray
    """(H, W) metres that a ray sinks on each metre along the optical axis; negative above the horizon."""
    ahead: FloatArray
    """(H, W) metres that it goes over ground on each metre along the optical axis."""
    azimuth: FloatArray
    """(H, W) radians over ground, 0 where the vehicle's nose points, positive to the left."""
    height: float
    """Metres of the camera above the floor."""
    rotation: FloatArray
    """(3, 3) from the camera to that level frame."""


def rays(view: View) -> Rays:
    """Where all pixels look, in a frame that is level and turned with the vehicle.

    Raises:
        ValueError: The altitude is not a number of metres above 0.
    """
    camera, altitude = view.camera, view.altitude
    T_world_base, T_base_camera = view.T_world_base, view.T_base_camera
    if not 0.0 < altitude < math.inf:
        raise ValueError(f"altitude: expected metres above 0, got {altitude}. Does the DVL see the floor?")
    yaw = T_world_base.yaw
    c, s = math.cos(yaw), math.sin(yaw)
    level = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ T_world_base.rotation
    rotation = level @ T_base_camera.rotation
    u = ((np.arange(camera.width) + 0.5 - camera.cx) / camera.fx).astype(np.float32)[None, :]
    v = ((np.arange(camera.height) + 0.5 - camera.cy) / camera.fy).astype(np.float32)[:, None]
    x, y, z = (np.float32(row[0]) * u + (np.float32(row[1]) * v + np.float32(row[2])) for row in rotation)
    height = altitude + float((level @ T_base_camera.translation)[2])
    return Rays(-z, np.hypot(x, y), np.arctan2(y, x), height, rotation)


def floor_depth(rays: Rays, max_depth: float) -> Float32Array:
    """(H, W) metres along the optical axis to the flat floor, z = h / (−d_z) on a ray d with d·axis = 1.

    NaN above the horizon, beyond `max_depth`, and everywhere where the camera is not above the floor.
    """
    with np.errstate(divide="ignore"):
        depth = np.float32(rays.height) / rays.down
    return np.where((depth > 0.0) & (depth <= max_depth) & (rays.down > 0.0), depth, np.float32(np.nan))


@dataclass(frozen=True, slots=True)
class FlatFloor:
    """Depth from altitude, attitude and labels alone.

    What it does: seabed and target lie on the flat floor, z = h / (−d_z). An obstacle stands on it: all its
    pixels at one azimuth above the foot have the foot's distance over ground ρ, so z = ρ / |d_xy|. Obstacles
    one behind the other at one azimuth have a foot each, where floor is seen between them.

    Reference: the ground plane constraint of monocular obstacle avoidance (Ulrich and Nourbakhsh, *AAAI*,
    2000), with the full attitude.

    Assumes: a floor that is level and flat as far as the protocol's reach; labels whose obstacles are whole;
    vertical walls and pipes.

    Fails when: the floor slopes (a slope of 5° puts the floor 1.5 m ahead of a camera at 0.6 m off by 20 %),
    something hangs in the water or leans, or labels miss the foot.
    """

    max_depth: float = 20.0
    """Metres along the optical axis; nothing farther is claimed."""

    def __post_init__(self) -> None:
        if not 0.0 < self.max_depth < math.inf:
            raise ValueError(f"max_depth: expected metres above 0, got {self.max_depth}")

    def estimate(self, rgb: UInt8Array, labels: UInt8Array, view: View) -> tuple[Float32Array, Float32Array]:
        """See `DepthModel.estimate`; the colours are not looked at."""
        camera = view.camera
        camera.check(labels, "labels")
        looks = rays(view)
        floor = floor_depth(looks, self.max_depth)
        pixel = PIXELS_ROUGH / min(camera.fx, camera.fy)
        # A ray that is δ off in elevation meets the floor δ·(ρ² + h²) / (h ρ) of its distance off.
        ground = floor * looks.ahead
        with np.errstate(divide="ignore", invalid="ignore"):
            error = pixel * (ground**2 + looks.height**2) / (abs(looks.height) * ground)
        confidence = np.nan_to_num(1.0 / (1.0 + 4.0 * error), nan=0.0)
        depth = np.where(labels == Label.WATER, np.float32(np.nan), floor)
        obstacle = labels == Label.OBSTACLE
        if obstacle.any():
            away, seen = _feet(obstacle, looks, camera)
            with np.errstate(divide="ignore", invalid="ignore"):
                stands = away / looks.ahead[obstacle]
                blurred = pixel * (away**2 + looks.height**2) / (abs(looks.height) * away)
            stands[~(stands <= self.max_depth)] = np.nan
            depth[obstacle] = stands
            confidence[obstacle] = np.where(seen, BEHIND_FOOT, FOOT_UNSEEN) / (1.0 + 4.0 * blurred)
        confidence[np.isnan(depth)] = 0.0
        return depth.astype(np.float32), confidence.astype(np.float32)


def _feet(obstacle: BoolArray, looks: Rays, camera: Camera) -> tuple[Float32Array, BoolArray]:
    """Distance over ground of the foot of every obstacle pixel, and whether the foot is in the image.

    The mask is resampled over azimuth and elevation, in which upright lines are columns.

    Returns:
        (n,) metres, infinite where there is no foot below the horizon; (n,) bool; for the n obstacle pixels.
    """
    from scipy import ndimage

    pitch = SAMPLE / min(camera.fx, camera.fy)
    elevation = np.arctan2(-looks.down, looks.ahead)
    low, first = float(elevation.min()), float(looks.azimuth.min())
    rows = int((float(elevation.max()) - low) / pitch) + 1
    cols = int((float(looks.azimuth.max()) - first) / pitch) + 1
    e = (low + (np.arange(rows, dtype=np.float32) + 0.5) * pitch)[:, None]
    a = (first + (np.arange(cols, dtype=np.float32) + 0.5) * pitch)[None, :]
    # The pixel of every sample; the direction is scaled so that it goes one metre over ground.
    x, y, z = (
        np.float32(column[0]) * np.cos(a)
        + np.float32(column[1]) * np.sin(a)
        + np.float32(column[2]) * np.tan(e)
        for column in looks.rotation.T
    )
    ahead = z > 1e-3
    z = np.where(ahead, z, np.float32(1.0))
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    inside = ahead & (u >= 0.0) & (u < camera.width) & (v >= 0.0) & (v < camera.height)
    pixel = np.where(inside, v, 0.0).astype(np.intp) * camera.width + np.where(inside, u, 0.0).astype(np.intp)
    solid = inside & obstacle.ravel()[pixel]

    below = np.zeros((2, *solid.shape), np.bool_)
    below[:, 1:] = solid[:-1], inside[:-1]
    begins = solid & ~below[0]
    foot = np.maximum.accumulate(np.where(begins, np.arange(rows)[:, None], -1), axis=0)
    at = np.clip(low + np.arange(rows) * pitch, -0.5 * math.pi, -1e-6)
    away_of_row = np.where(low + np.arange(rows) * pitch < -1e-6, looks.height / -np.tan(at), np.inf)
    away = np.where(solid, away_of_row[foot], np.inf).astype(np.float32)
    hidden = begins & ~below[1]
    seen = ~(solid & np.take_along_axis(hidden, np.maximum(foot, 0), axis=0))
    # A pixel at the rim may fall on a sample that is not solid; it belongs to what is next to it.
    away = np.where(solid, away, ndimage.minimum_filter(away, 3, mode="nearest"))
    seen = np.where(solid, seen, ndimage.minimum_filter(seen, 3, mode="nearest"))

    r = np.minimum(((elevation[obstacle] - low) / pitch).astype(np.intp), rows - 1)
    c = np.minimum(((looks.azimuth[obstacle] - first) / pitch).astype(np.intp), cols - 1)
    return away[r, c], seen[r, c]
