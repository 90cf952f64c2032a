"""Under which angles a frame looks at the ground."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

from numba import njit


@njit(cache=True, nogil=True)
def look(steepest, depth, rotation, place, lens, limits, reach, corner, cell):
    """Keep, for each cell and each part of the compass it is looked at from, the steepest look.

    Args:
        steepest: (parts, rows, cols) greatest cosine of the angle between the vertical and the line of sight,
            0 where there was no look; changed.
        depth: (H, W) metres along the optical axis; NaN where there is no return.
        rotation: (3, 3) from the camera's frame to the world.
        place: (3,) the camera in the world, metres.
        lens: fx, fy, cx, cy.
        limits: Depths to be trusted, metres.
        reach: Metres, straight.
        corner: x and y of the first cell's outer corner.
        cell: Metres.
    """
    fx, fy, cx, cy = lens
    parts, rows, cols = steepest.shape
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            if not limits[0] <= z <= limits[1]:
                continue
            right, down = (u + 0.5 - cx) / fx * z, (v + 0.5 - cy) / fy * z
            away = math.sqrt(right * right + down * down + z * z)
            if away > reach:
                continue
            east = rotation[0, 0] * right + rotation[0, 1] * down + rotation[0, 2] * z
            north = rotation[1, 0] * right + rotation[1, 1] * down + rotation[1, 2] * z
            up = rotation[2, 0] * right + rotation[2, 1] * down + rotation[2, 2] * z
            row = math.floor((place[1] + north - corner[1]) / cell)
            col = math.floor((place[0] + east - corner[0]) / cell)
            if not (0 <= row < rows and 0 <= col < cols):
                continue
            part = int((math.atan2(-north, -east) / (2.0 * math.pi) + 1.0) * parts) % parts
            steepest[part, row, col] = max(steepest[part, row, col], -up / away)
