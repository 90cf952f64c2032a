"""Which points of a volume a camera sees, for all its headings and tilts at once."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from dream.mapping._kernels.volume import BITS, find, within


class TiltedCamera(NamedTuple):
    """The camera of a level vehicle, wherever it is, heads and tilts it."""

    lens: tuple[float, float, float, float]
    """fx, fy, cx and cy in pixels."""
    size: tuple[int, int]
    """Width and height of the image in pixels."""
    limits: tuple[float, float]
    """Least and greatest valid depth, metres."""
    reach: float
    """Metres straight."""
    cosine: float
    """Of the greatest angle between a normal and the line of sight."""


@njit(cache=True, nogil=True)
def is_clear(bricks, start, end, last):
    """Does nothing solid lie on a segment, up to `last` before its end? All in voxels."""
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    if length <= last:
        return True
    past = 1.0 - last / length
    col, row, level = math.floor(start[0]), math.floor(start[1]), math.floor(start[2])
    step_x, step_y, step_z = (1 if dx > 0 else -1), (1 if dy > 0 else -1), (1 if dz > 0 else -1)
    slope_x = abs(1.0 / dx) if dx != 0.0 else math.inf
    slope_y = abs(1.0 / dy) if dy != 0.0 else math.inf
    slope_z = abs(1.0 / dz) if dz != 0.0 else math.inf
    next_x = slope_x * ((col + 1 - start[0]) if dx > 0 else (start[0] - col)) if dx != 0.0 else math.inf
    next_y = slope_y * ((row + 1 - start[1]) if dy > 0 else (start[1] - row)) if dy != 0.0 else math.inf
    next_z = slope_z * ((level + 1 - start[2]) if dz > 0 else (start[2] - level)) if dz != 0.0 else math.inf
    brick, slot, entered = (1 << 40, 0, 0), 0, 0.0
    while entered < past:
        here = (level >> BITS, row >> BITS, col >> BITS)
        if here != brick:
            brick, slot = here, find(bricks, here[0], here[1], here[2])
        # Where nothing ever returned from a brick, nothing in it is solid.
        if bricks.surface_of[slot] and bricks.log_odds[slot, within(level, row, col)] > 0:
            return False
        if next_x <= next_y and next_x <= next_z:
            entered = next_x
            col += step_x
            next_x += slope_x
        elif next_y <= next_z:
            entered = next_y
            row += step_y
            next_y += slope_y
        else:
            entered = next_z
            level += step_z
            next_z += slope_z
    return True


@njit(cache=True, nogil=True)
def _in_image(ahead, right, up, cos, sin, camera):
    """Is a point, by metres ahead, to the right and up, in the image of a camera that looks down so far?"""
    z = cos * ahead - sin * up
    if not camera.limits[0] <= z <= camera.limits[1]:
        return False
    u = camera.lens[0] * right + camera.lens[2] * z
    v = camera.lens[1] * (-sin * ahead - cos * up) + camera.lens[3] * z
    return 0.0 <= u < camera.size[0] * z and 0.0 <= v < camera.size[1] * z


@njit(cache=True, nogil=True)
def visible(bricks, side, places, headings, tilts, points, normals, lift, last, camera):
    """Which points each camera sees under each heading and tilt; the unknown hides nothing.

    Args:
        bricks: What is known.
        side: Metres along a voxel.
        places: (P, 3) of cameras, metres in the world.
        headings: (K, 2) cosine and sine of yaw.
        tilts: (T, 2) cosine and sine of the angle downwards.
        points: (n, 3) metres in the world.
        normals: (n, 3) of length 1, or (0, 3) where no angle is asked for.
        lift: Metres along its normal by which a point is lifted before it is looked at.
        last: Metres before a point in which nothing hides it.
        camera: Theirs.

    Returns:
        starts: (P * K * T + 1,) int64.
        members: (m,) int32; those of place p, heading k and tilt t from starts[(p * K + k) * T + t] on.
    """
    count = len(headings) * len(tilts)
    starts = np.zeros(len(places) * count + 1, np.int64)
    members = np.empty(4096, np.int32)
    clear, offsets = np.empty(len(points), np.int32), np.empty((len(points), 3))
    start, end = np.empty(3), np.empty(3)
    total = 0
    for p in range(len(places)):
        found = 0
        start[:] = places[p] / side
        for n in range(len(points)):
            for axis in range(3):
                offsets[found, axis] = points[n, axis] - places[p, axis]
            dx, dy, dz = offsets[found]
            away = math.sqrt(dx * dx + dy * dy + dz * dz)
            if away > camera.reach or away == 0.0:
                continue
            if len(normals):
                facing = -(dx * normals[n, 0] + dy * normals[n, 1] + dz * normals[n, 2])
                if facing < camera.cosine * away:
                    continue
            # Looked at straight, a point is in the image if it ever is.
            over_ground, straight = math.sqrt(dx * dx + dy * dy), False
            for t in range(len(tilts)):
                straight |= _in_image(over_ground, 0.0, dz, tilts[t, 0], tilts[t, 1], camera)
            if not straight:
                continue
            for axis in range(3):
                end[axis] = points[n, axis] / side
                if len(normals):
                    end[axis] += lift / side * normals[n, axis]
            if is_clear(bricks, start, end, last / side):
                clear[found] = n
                found += 1
        if total + found * count > len(members):
            larger = np.empty(2 * (total + found * count), np.int32)
            larger[:total] = members[:total]
            members = larger
        for k in range(len(headings)):
            cos, sin = headings[k]
            for t in range(len(tilts)):
                for n in range(found):
                    dx, dy, dz = offsets[n]
                    ahead, right = cos * dx + sin * dy, sin * dx - cos * dy
                    if _in_image(ahead, right, dz, tilts[t, 0], tilts[t, 1], camera):
                        members[total] = clear[n]
                        total += 1
                starts[(p * len(headings) + k) * len(tilts) + t + 1] = total
    return starts, members[:total].copy()
