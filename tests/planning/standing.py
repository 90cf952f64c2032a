"""Volumes built voxel by voxel: known water over a level seabed, with boxes that stand on it."""

from __future__ import annotations

from typing import Any

import numpy as np

from dream.geometry import SE3, Bounds, camera_mount
from dream.mapping._kernels import volume as kernels
from dream.mapping._kernels.volume_frame import side_bit
from dream.mapping.volume import MISS, MOST, Volume
from dream.planning.space.ways import KnownWays, ways_in
from dream.protocol import DREAM_V2_TRUE as PROTOCOL
from dream.types import Mission, Observation, Target

SEABED = -10.0
BOUNDS = Bounds(-10.0, -10.0, 10.0, 10.0)
Array = np.ndarray[Any, Any]
Corner = tuple[float, float, float]


def middles_in(low: Corner, high: Corner) -> Array:
    """(n, 3) middles of the voxels of a box."""
    cell = PROTOCOL.cell
    axes = [np.arange(round(a / cell), round(b / cell)) for a, b in zip(low, high, strict=True)]
    return (np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5) * cell


def water(radius: float = 7.0) -> Volume:
    """A volume that knows the water over a seabed that was seen, and nothing below that."""
    volume = Volume(PROTOCOL)
    volume.clear([0.0, 0.0, SEABED + 2.0], radius)
    forget(volume, (-radius, -radius, SEABED - radius), (radius, radius, SEABED))
    solid(volume, (-radius, -radius, SEABED - PROTOCOL.cell), (radius, radius, SEABED), target=0.0)
    return volume


def solid(volume: Volume, low: Corner, high: Corner, target: float = 1.0) -> None:
    """Have something returned from all of a box, with such a share of votes for target."""
    points = middles_in(low, high)
    volume.clear(np.add(low, high) / 2.0, float(np.linalg.norm(np.subtract(high, low))) / 2.0 + 0.5)
    volume._reserve(0, len(points))
    bricks = volume._bricks
    slots, numbers = volume._look_up(points)
    kept = np.array([kernels.surface(bricks, slot) for slot in slots])
    bricks.log_odds[slots, numbers] = MOST
    bricks.seen[kept, numbers] = True
    vote(volume, points, target)
    volume.revision += 1


def forget(volume: Volume, low: Corner, high: Corner) -> None:
    """Have nothing known of a box."""
    slots, numbers = volume._look_up(middles_in(low, high))
    volume._bricks.log_odds[slots[slots > 0], numbers[slots > 0]] = 0
    volume.revision += 1


def free(volume: Volume, low: Corner, high: Corner) -> None:
    """Have a box known to be water."""
    slots, numbers = volume._look_up(middles_in(low, high))
    volume._bricks.log_odds[slots, numbers] = -MISS
    volume.revision += 1


def vote(volume: Volume, points: Array, target: float) -> None:
    """Have such a share of the votes of voxels (n, 3) be for target."""
    bricks = volume._bricks
    slots, numbers = volume._look_up(points)
    bricks.votes[bricks.surface_of[slots], numbers] = round(100 * target), 100
    volume.revision += 1


def inspect(volume: Volume, points: Array, side: Corner) -> None:
    """Have voxels (n, 3) been inspected from a side, given by the way from them to the camera."""
    bricks = volume._bricks
    slots, numbers = volume._look_up(points)
    bricks.sides[bricks.surface_of[slots], numbers] |= side_bit(*side)
    volume.revision += 1


def ways_of(volume: Volume) -> KnownWays:
    return ways_in(volume, BOUNDS, PROTOCOL)


def mission(target: Target = Target.ANY) -> Mission:
    return Mission(PROTOCOL, BOUNDS, max_steps=100, target=target)


def observed(
    x: float,
    y: float,
    z: float,
    yaw: float,
    tilt: float = PROTOCOL.camera_pitch,
    depth: Array | None = None,
    labels: Array | None = None,
) -> Observation:
    """An observation from there; of nothing, where no images are given."""
    camera = PROTOCOL.camera
    image = (camera.height, camera.width)
    return Observation(
        time=0.0,
        rgb=np.zeros((*image, 3), np.uint8),
        depth=np.full(image, np.nan, np.float32) if depth is None else depth.astype(np.float32),
        labels=np.zeros(image, np.uint8) if labels is None else labels,
        camera=camera,
        T_world_base=SE3.level(x, y, z, yaw),
        T_base_camera=camera_mount(tilt),
    )
