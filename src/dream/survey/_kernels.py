"""Loops over the pixels of a frame, for `ground`, `individuals` and `footprint`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

Array = npt.NDArray[Any]
SEABED, TARGET, OBSTACLE = 1, 2, 3
"""Values of `types.Label`."""


@njit(cache=True, nogil=True)
def _away(a: float, b: float, z: float, rotation: Array) -> tuple[float, float, float]:
    """From the camera to the point of a ray (a, b, 1) at depth z: metres along the axes of the world."""
    return (
        z * (rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2]),
        z * (rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2]),
        z * (rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2]),
    )


@njit(cache=True, nogil=True)
def _under(
    dx: float, dy: float, origin: Array, corner: Array, cell: float, rows: int, cols: int
) -> tuple[int, int]:
    """Row and column of the cell under a point so far from the camera; −1 each beyond the grid."""
    row = math.floor((origin[1] + dy - corner[1]) / cell)
    col = math.floor((origin[0] + dx - corner[0]) / cell)
    if row < 0 or col < 0 or row >= rows or col >= cols:
        return -1, -1
    return row, col


@njit(cache=True, nogil=True)
def splat(
    depth: Array,
    labels: Array,
    lens: Array,
    rotation: Array,
    origin: Array,
    limits: Array,
    corner: Array,
    cell: float,
    weight: Array,
    height: Array,
    share: Array,
    nearest: Array,
    top: Array,
) -> None:
    """Add the points of one frame to the sums of the fine cells that they fall in.

    A point at depth z weighs z⁻⁴, as it should where depths scatter by z²: the nearest views decide.

    Args:
        depth: (H, W) float32 metres along the optical axis.
        labels: (H, W) uint8.
        lens: fx, fy, cx, cy.
        rotation: (3, 3) camera to world.
        origin: (3,) of the camera.
        limits: Least and greatest depth, reach over ground.
        corner: x and y of the lower left corner of the grid.
        cell: Metres.
        weight: (rows, cols) sum of weights; added to. Obstacles and water have none.
        height: (rows, cols) sum of weight times z; added to.
        share: (rows, cols) sum of the weights of target; added to.
        nearest: (rows, cols) least depth; lowered.
        top: (rows, cols) greatest z of target, also beyond the reach; raised.
    """
    rows, cols = weight.shape
    high, wide = depth.shape
    for v in range(high):
        b = (v + 0.5 - lens[3]) / lens[1]
        for u in range(wide):
            z = depth[v, u]
            label = labels[v, u]
            if not (limits[0] <= z <= limits[1]) or (label != SEABED and label != TARGET):
                continue
            dx, dy, dz = _away((u + 0.5 - lens[2]) / lens[0], b, z, rotation)
            row, col = _under(dx, dy, origin, corner, cell, rows, cols)
            if row < 0:
                continue
            if label == TARGET:
                # The top of a hull is only in the image from further off than labels are trusted.
                top[row, col] = max(top[row, col], origin[2] + dz)
            if dx * dx + dy * dy > limits[2] * limits[2]:
                continue
            w = 1.0 / (z * z * z * z)
            weight[row, col] += w
            height[row, col] += w * (origin[2] + dz)
            if label == TARGET:
                share[row, col] += w
            if z < nearest[row, col]:
                nearest[row, col] = z


@njit(cache=True, nogil=True)
def count_looks(
    depth: Array,
    lens: Array,
    rotation: Array,
    origin: Array,
    limits: Array,
    corner: Array,
    cell: float,
    frame: int,
    last: Array,
    times: Array,
) -> None:
    """Count a frame once for every map cell that a return within reach fell in.

    Args:
        depth: (H, W) float32 metres along the optical axis.
        lens: fx, fy, cx, cy.
        rotation: (3, 3) camera to world.
        origin: (3,) of the camera.
        limits: Least and greatest depth, reach over ground.
        corner: x and y of the lower left corner of the grid.
        cell: Metres.
        frame: A number of its own, above −1.
        last: (rows, cols) int32, the last frame that was counted; changed.
        times: (rows, cols) uint16; added to.
    """
    rows, cols = times.shape
    high, wide = depth.shape
    for v in range(high):
        b = (v + 0.5 - lens[3]) / lens[1]
        for u in range(wide):
            z = depth[v, u]
            if not (limits[0] <= z <= limits[1]):
                continue
            dx, dy, _ = _away((u + 0.5 - lens[2]) / lens[0], b, z, rotation)
            if dx * dx + dy * dy > limits[2] * limits[2]:
                continue
            row, col = _under(dx, dy, origin, corner, cell, rows, cols)
            if row < 0 or last[row, col] == frame:
                continue
            last[row, col] = frame
            times[row, col] = min(times[row, col] + 1, np.uint16(65535))


@njit(cache=True, nogil=True)
def recognise(
    points: Array,
    depth: Array,
    labels: Array,
    lens: Array,
    rotation: Array,
    origin: Array,
    limits: Array,
    hidden: float,
    hits: Array,
    looks: Array,
) -> None:
    """For every point that a frame shows within reach, count a look, and a hit where it is labelled target.

    Args:
        points: (N, 3) metres in the world.
        depth: (H, W) float32 metres along the optical axis.
        labels: (H, W) uint8.
        lens: fx, fy, cx, cy.
        rotation: (3, 3) camera to world.
        origin: (3,) of the camera.
        limits: Least and greatest depth, reach over ground.
        hidden: Metres before a point at which a return hides it.
        hits: (N,) int32; added to.
        looks: (N,) int32; added to.
    """
    high, wide = depth.shape
    for n in range(len(points)):
        dx = points[n, 0] - origin[0]
        dy = points[n, 1] - origin[1]
        dz = points[n, 2] - origin[2]
        if dx * dx + dy * dy > limits[2] * limits[2]:
            continue
        z = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
        if not (limits[0] <= z <= limits[1]):
            continue
        right = rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz
        down = rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz
        u = math.floor(lens[0] * right / z + lens[2])
        v = math.floor(lens[1] * down / z + lens[3])
        if u < 1 or v < 1 or u >= wide - 1 or v >= high - 1 or depth[v, u] < z - hidden:
            continue
        looks[n] += 1
        count = 0
        for i in range(v - 1, v + 2):
            for j in range(u - 1, u + 2):
                if labels[i, j] == TARGET:
                    count += 1
        if count >= 3:
            hits[n] += 1


@njit(cache=True, nogil=True)
def vote(
    depth: Array,
    labels: Array,
    lens: Array,
    rotation: Array,
    origin: Array,
    limits: Array,
    corner: Array,
    cell: float,
    frame: int,
    last: Array,
    weight: Array,
    times: Array,
) -> None:
    """Let one frame say of every fine cell once that it shows target there, and once that it shows seabed.

    A wall has many pixels over one cell. Counted each, those few that scatter out of it would outweigh the
    seabed at its foot. A vote from depth z weighs z⁻⁴.

    Args:
        depth: (H, W) float32 metres along the optical axis.
        labels: (H, W) uint8.
        lens: fx, fy, cx, cy.
        rotation: (3, 3) camera to world.
        origin: (3,) of the camera.
        limits: Least and greatest depth, reach over ground.
        corner: x and y of the lower left corner of the grid.
        cell: Metres.
        frame: A number of its own, above −1.
        last: (2, rows, cols) int32, the last frame that voted for seabed and for target; changed.
        weight: (2, rows, cols) float32, sums of the votes for each; added to.
        times: (rows, cols) uint16, frames that voted for target; added to.
    """
    _, rows, cols = weight.shape
    high, wide = depth.shape
    for v in range(high):
        b = (v + 0.5 - lens[3]) / lens[1]
        for u in range(wide):
            z = depth[v, u]
            label = labels[v, u]
            if not (limits[0] <= z <= limits[1]) or (label != SEABED and label != TARGET):
                continue
            dx, dy, _ = _away((u + 0.5 - lens[2]) / lens[0], b, z, rotation)
            if dx * dx + dy * dy > limits[2] * limits[2]:
                continue
            row, col = _under(dx, dy, origin, corner, cell, rows, cols)
            if row < 0:
                continue
            kind = label - SEABED
            if last[kind, row, col] == frame:
                continue
            last[kind, row, col] = frame
            weight[kind, row, col] += 1.0 / (z * z * z * z)
            if label == TARGET:
                times[row, col] = min(times[row, col] + 1, np.uint16(65535))
