"""What the points of a frame are: target, obstacle or free (Eq. 2-6), as an executable specification.

What runs is `mapping/_kernels/pixels.py` (Eq. 1-3) and `mapping/_kernels/evidence.py` (Eq. 4-6), in one pass
over the pixels; `test_solid_target_and_seabed_are_where_the_paper_s_point_sets_are` holds them to this.

Eq. 1, pixels to world points, is `dream.geometry.Camera.back_project`. Heights are above the local
seabed, which undulates; the paper's height above a flat one is the special case `ground = 0`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, Camera, FloatArray
from dream.protocol import farthest_return
from dream.types import BoolArray, Label

LabelArray = npt.NDArray[np.integer[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class PointSets:
    """The valid points of a frame in three disjoint sets, each (n, 3) metres in the world."""

    target: FloatArray
    obstacle: FloatArray
    free: FloatArray


def valid_depth(depth: FloatArray, *, min_depth: float, max_depth: float) -> BoolArray:
    """Which pixels have a depth to be trusted, z_min ≤ z < z_max (Eq. 2).

    z_max itself is what many sensors say where nothing returns.

    Args:
        depth: (...) metres along the optical axis; NaN where there is no return.
        min_depth: z_min.
        max_depth: z_max.

    Returns:
        The same shape; false at NaN.
    """
    if not 0.0 <= min_depth < max_depth:
        raise ValueError(
            f"depth limits: expected 0 <= min_depth < max_depth, got {min_depth} and {max_depth}"
        )
    z = np.asarray(depth)
    return (z >= min_depth) & (z <= farthest_return(max_depth))


def valid_points(
    depth: FloatArray, camera: Camera, T_world_camera: SE3, *, min_depth: float, max_depth: float
) -> tuple[FloatArray, BoolArray]:
    """The world points of all pixels with a valid depth (Eq. 3).

    Args:
        depth: (H, W) metres along the optical axis; NaN where there is no return.
        camera: Intrinsics of that image.
        T_world_camera: Where the optical frame was.
        min_depth: z_min.
        max_depth: z_max.

    Returns:
        (n, 3) metres in the world, in the order of the pixels, and the (H, W) mask of those pixels.
    """
    points = camera.back_project(depth, T_world_camera)
    valid = valid_depth(depth, min_depth=min_depth, max_depth=max_depth)
    return points[valid], valid


def target_points(labels: LabelArray) -> BoolArray:
    """Which points are target: those whose mask is 1, at any height (Eq. 4).

    Args:
        labels: (n,) values of `Label`.
    """
    target: BoolArray = np.asarray(labels) == Label.TARGET
    return target


def obstacle_points(
    points_world: FloatArray, labels: LabelArray, ground: npt.ArrayLike, *, band: tuple[float, float]
) -> BoolArray:
    """Which points are obstacle: h_min ≤ height ≤ h_max, and not target (Eq. 5).

    Args:
        points_world: (n, 3) metres.
        labels: (n,) values of `Label`.
        ground: (n,) or a number: world z of the seabed below each point.
        band: h_min and h_max, metres above that seabed.
    """
    height = np.asarray(points_world)[:, 2] - np.asarray(ground)
    solid: BoolArray = (height >= band[0]) & (height <= band[1]) & ~target_points(labels)
    return solid


def free_points(
    points_world: FloatArray, labels: LabelArray, ground: npt.ArrayLike, *, band: tuple[float, float]
) -> BoolArray:
    """Which points are free: the rest (Eq. 6).

    Args:
        points_world: (n, 3) metres.
        labels: (n,) values of `Label`.
        ground: (n,) or a number: world z of the seabed below each point.
        band: h_min and h_max, metres above that seabed.
    """
    return ~target_points(labels) & ~obstacle_points(points_world, labels, ground, band=band)


def partition(
    points_world: FloatArray, labels: LabelArray, ground: npt.ArrayLike, *, band: tuple[float, float]
) -> PointSets:
    """The valid points of a frame in three disjoint sets that cover them (Eq. 4-6).

    Args:
        points_world: (n, 3) metres.
        labels: (n,) values of `Label`, of the same pixels.
        ground: (n,) or a number: world z of the seabed below each point.
        band: h_min and h_max, metres above that seabed.

    Raises:
        ValueError: The shapes do not fit, or the band is empty.
    """
    points, kinds, seabed = np.asarray(points_world), np.asarray(labels), np.asarray(ground)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points: expected (n, 3), got {points.shape}")
    if kinds.shape != (len(points),):
        raise ValueError(f"labels: expected ({len(points)},), one for every point, got {kinds.shape}")
    if seabed.shape not in ((), (len(points),)):
        raise ValueError(f"ground: expected a number or ({len(points)},), got {seabed.shape}")
    if not band[0] < band[1]:
        raise ValueError(f"band: expected h_min < h_max, got {band}")
    return PointSets(
        target=points[target_points(kinds)],
        obstacle=points[obstacle_points(points, kinds, seabed, band=band)],
        free=points[free_points(points, kinds, seabed, band=band)],
    )
