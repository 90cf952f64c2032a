"""Worlds with a formula: flat seabed at z = −10, upright pillars, target discs on the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, Bounds, Camera
from dream.mapping import OccupancyMap
from dream.mapping._kernels import flags
from dream.protocol import DREAM_V1
from dream.types import Label

SEABED = -10.0
CAMERA = DREAM_V1.camera
AREA = Bounds(-12.0, -12.0, 12.0, 12.0)

Images = tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8]]


@dataclass(frozen=True)
class Pillar:
    """An upright cylinder on the seabed; one of 50 m radius is a wall."""

    x: float
    y: float
    radius: float
    height: float
    label: Label = Label.OBSTACLE


@dataclass(frozen=True)
class Disc:
    """Targets, flat on the seabed."""

    x: float
    y: float
    radius: float


def wall(distance: float, height: float = 4.0, label: Label = Label.OBSTACLE) -> Pillar:
    """A wall across the x axis, almost plane."""
    return Pillar(distance + 500.0, 0.0, 500.0, height, label)


def camera_at(x: float, y: float, yaw: float) -> SE3:
    """`T_world_camera` of the vehicle at its altitude."""
    return SE3.level(x, y, SEABED + DREAM_V1.altitude, yaw) @ DREAM_V1.T_base_camera


def render(
    T_world_camera: SE3, *things: Pillar | Disc, slope: float = 0.0, camera: Camera = CAMERA
) -> Images:
    """Depth and labels, one ray through the middle of each pixel. The seabed rises by `slope` along x."""
    u = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    v = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    rays_camera = np.stack(np.broadcast_arrays(u[None, :], v[:, None], 1.0), axis=-1)
    rays: npt.NDArray[Any] = rays_camera @ T_world_camera.rotation.T
    eye = T_world_camera.translation
    falling = slope * rays[..., 0] - rays[..., 2]
    ahead = falling > 1e-9
    depth = np.where(ahead, (eye[2] - SEABED - slope * eye[0]) / np.where(ahead, falling, 1.0), np.inf)
    labels = np.where(ahead, Label.SEABED, Label.WATER)
    reach_x, reach_y = depth * rays[..., 0], depth * rays[..., 1]
    for thing in things:
        away = eye[:2] - (thing.x, thing.y)
        if isinstance(thing, Disc):
            at_x, at_y = away[0] + reach_x, away[1] + reach_y
            near = np.nonzero((np.abs(at_x) <= thing.radius) & (np.abs(at_y) <= thing.radius) & ahead)
            beneath = np.hypot(at_x[near], at_y[near]) <= thing.radius
            labels[near[0][beneath], near[1][beneath]] = Label.TARGET
            continue
        a = rays[..., 0] ** 2 + rays[..., 1] ** 2
        b = rays[..., :2] @ away
        root = b**2 - a * (away @ away - thing.radius**2)
        side = (-b - np.sqrt(np.maximum(root, 0.0))) / a
        top = (SEABED + thing.height - eye[2]) / rays[..., 2]
        over_top = away + top[..., None] * rays[..., :2]
        on_top = (top > 0.0) & (np.hypot(over_top[..., 0], over_top[..., 1]) <= thing.radius)
        on_side = (root > 0.0) & (side > 0.0) & (eye[2] + side * rays[..., 2] <= SEABED + thing.height)
        nearest = np.minimum(np.where(on_side, side, np.inf), np.where(on_top, top, np.inf))
        labels[nearest < depth] = thing.label
        depth = np.minimum(depth, nearest)
        reach_x, reach_y = depth * rays[..., 0], depth * rays[..., 1]
    seen = depth < 60.0
    return (
        np.where(seen, depth, np.nan).astype(np.float32),
        np.where(seen, labels, Label.WATER).astype(np.uint8),
    )


def look(occupancy: OccupancyMap, x: float, y: float, yaw: float, *things: Pillar | Disc) -> None:
    """Integrate one frame of the scene."""
    T_world_camera = camera_at(x, y, yaw)
    occupancy.integrate(*render(T_world_camera, *things), CAMERA, T_world_camera)


def look_around(occupancy: OccupancyMap, x: float, y: float, *things: Pillar | Disc) -> None:
    """Four frames, a quarter turn apart."""
    for quarter in range(4):
        look(occupancy, x, y, quarter * math.pi / 2.0, *things)


def empty_map() -> OccupancyMap:
    """24 m by 24 m, nothing known."""
    return OccupancyMap(AREA, DREAM_V1)


def map_with(
    *,
    solid: npt.NDArray[np.bool_] | None = None,
    explored: npt.NDArray[np.bool_] | None = None,
    target: npt.NDArray[np.bool_] | None = None,
) -> OccupancyMap:
    """A map that holds just these layers."""
    occupancy = empty_map()
    if solid is not None:
        occupancy._write("log_odds", (0, 0), 20 * solid)
    if explored is not None:
        occupancy._write("flags", (0, 0), (flags.EXPLORED | flags.BARE) * explored)
    if target is not None:
        occupancy._write("votes", (0, 0), 0x30 * target)
    return occupancy
