"""What a camera would show of points on surfaces, by what is known to stand in between."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.mapping._kernels.volume import FREE, SOLID, UNKNOWN


class LookScene(NamedTuple):
    """The voxels of a box."""

    states: npt.NDArray[np.uint8]
    """(levels, rows, cols)."""
    first: npt.NDArray[np.int64]
    """(3,) level, row and column of the first, from the world's origin."""
    side: float
    """Metres along a voxel."""


class LookOptics(NamedTuple):
    """What is in the image, and what is a useful look."""

    across: float
    """Half the image's width over the focal length."""
    upright: float
    """Half its height, likewise."""
    reach: float
    """Metres."""
    cosine: float
    """Of the greatest angle between a surface's normal and the line of sight."""


@njit(cache=True, nogil=True)
def is_clear(scene, camera, point):
    """Is nothing solid on the straight line between? What lies outside the box is not."""
    levels, rows, cols = scene.states.shape
    dx, dy, dz = point[0] - camera[0], point[1] - camera[1], point[2] - camera[2]
    steps = math.ceil(math.sqrt(dx * dx + dy * dy + dz * dz) / (0.6 * scene.side))
    for k in range(steps + 1):
        t = k / max(steps, 1)
        col = math.floor((camera[0] + t * dx) / scene.side) - scene.first[2]
        row = math.floor((camera[1] + t * dy) / scene.side) - scene.first[1]
        level = math.floor((camera[2] + t * dz) / scene.side) - scene.first[0]
        inside = 0 <= level < levels and 0 <= row < rows and 0 <= col < cols
        if inside and scene.states[level, row, col] == SOLID:
            return False
    return True


@njit(cache=True, nogil=True)
def is_facing(optics, camera, point, normal, cosine):
    """Is a point within reach, and its surface looked at by at most the angle of that cosine?"""
    dx, dy, dz = point[0] - camera[0], point[1] - camera[1], point[2] - camera[2]
    square = dx * dx + dy * dy + dz * dz
    if square > optics.reach * optics.reach:
        return False
    return -(dx * normal[0] + dy * normal[1] + dz * normal[2]) >= cosine * math.sqrt(square)


@njit(cache=True, nogil=True)
def is_open(scene, camera, point, normal):
    """Is nothing solid between? A voxel before the surface is looked at: its own neighbours would hide it."""
    return is_clear(scene, camera, point + scene.side * normal)


@njit(cache=True, nogil=True)
def is_in_image(optics, camera, yaw, tilt, point):
    """Does a point project into the image?"""
    dx, dy, dz = point[0] - camera[0], point[1] - camera[1], point[2] - camera[2]
    ahead, left = dx * math.cos(yaw) + dy * math.sin(yaw), dy * math.cos(yaw) - dx * math.sin(yaw)
    depth = ahead * math.cos(tilt) - dz * math.sin(tilt)
    above = ahead * math.sin(tilt) + dz * math.cos(tilt)
    return depth > 0.0 and abs(left) <= optics.across * depth and abs(above) <= optics.upright * depth


@njit(cache=True, nogil=True)
def shown(scene, optics, camera, yaw, tilt, points, normals, cosines):
    """(P,) bool which points (P, 3) with normals (P, 3) one look shows.

    Args:
        scene: The voxels around.
        optics: Camera and reach.
        camera: (3,) metres.
        yaw: Radians.
        tilt: Radians, downwards.
        points: (P, 3) metres in the world.
        normals: (P, 3) of length 1.
        cosines: (P,) of the greatest angle between each normal and the line of sight.
    """
    result = np.zeros(len(points), np.bool_)
    for p in range(len(points)):
        if is_in_image(optics, camera, yaw, tilt, points[p]):
            result[p] = is_facing(optics, camera, points[p], normals[p], cosines[p]) and is_open(
                scene, camera, points[p], normals[p]
            )
    return result


@njit(cache=True, nogil=True)
def gains(scene, optics, cameras, yaws, tilts, points, normals, weights):
    """(C, Y, T) weight (P,) of the points that each camera (C, 3) shows at each yaw (Y,) and tilt (T,)."""
    result = np.zeros((len(cameras), len(yaws), len(tilts)))
    for c in range(len(cameras)):
        for p in range(len(points)):
            if not is_facing(optics, cameras[c], points[p], normals[p], optics.cosine):
                continue
            if not is_open(scene, cameras[c], points[p], normals[p]):
                continue
            for y in range(len(yaws)):
                for t in range(len(tilts)):
                    if is_in_image(optics, cameras[c], yaws[y], tilts[t], points[p]):
                        result[c, y, t] += weights[p]
    return result


@njit(cache=True, nogil=True)
def edges(scene, voxels):
    """Free voxels with an unknown face, among the 26 around each of some (m, 3); some more than once.

    Both count levels, rows and columns from the box's first voxel.

    Returns:
        found: (n, 3) int64.
        away: (n, 3) float64, level, row and column: the sum of the directions from its unknown faces.
    """
    levels, rows, cols = scene.states.shape
    found, count = np.empty((26 * len(voxels), 3), np.int64), 0
    away = np.zeros((26 * len(voxels), 3))
    for n in range(len(voxels)):
        for a in range(-1, 2):
            for b in range(-1, 2):
                for c in range(-1, 2):
                    i, j, k = voxels[n, 0] + a, voxels[n, 1] + b, voxels[n, 2] + c
                    if not (1 <= i < levels - 1 and 1 <= j < rows - 1 and 1 <= k < cols - 1):
                        continue
                    if scene.states[i, j, k] != FREE:
                        continue
                    up = (scene.states[i - 1, j, k] == UNKNOWN) - (scene.states[i + 1, j, k] == UNKNOWN)
                    north = (scene.states[i, j - 1, k] == UNKNOWN) - (scene.states[i, j + 1, k] == UNKNOWN)
                    east = (scene.states[i, j, k - 1] == UNKNOWN) - (scene.states[i, j, k + 1] == UNKNOWN)
                    # Where they cancel out it is unknown on both sides, or on none.
                    is_between = (
                        scene.states[i - 1, j, k] == UNKNOWN
                        or scene.states[i, j - 1, k] == UNKNOWN
                        or scene.states[i, j, k - 1] == UNKNOWN
                    )
                    if up == 0 and north == 0 and east == 0 and not is_between:
                        continue
                    found[count, 0], found[count, 1], found[count, 2] = i, j, k
                    away[count, 0], away[count, 1], away[count, 2] = up, north, east
                    count += 1
    return found[:count], away[:count]
