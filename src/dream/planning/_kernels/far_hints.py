"""What the pixels of a frame show beyond the reach."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

from numba import njit


@njit(cache=True, nogil=True)
def add(pixels, depth, labels, target, seabed, rotation, place, lens, limits, ring, corner, cell):
    """Count, in the cell that each lies in, the pixels that show a target and those that show the seabed.

    Args:
        pixels: (2, rows, cols) counts of targets and of both, changed.
        depth: (H, W) metres along the optical axis; NaN where there is no return.
        labels: (H, W).
        target: Label of a target.
        seabed: Label of the seabed.
        rotation: (3, 3) from the camera's frame to the world.
        place: (3,) the camera in the world, metres.
        lens: fx, fy, cx, cy.
        limits: Depths to be trusted, metres.
        ring: Metres over ground that a pixel lies away: more than the first, at most the second.
        corner: x and y of the first cell's outer corner.
        cell: Metres.
    """
    fx, fy, cx, cy = lens
    rows, cols = pixels.shape[1:]
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            label, z = labels[v, u], depth[v, u]
            if (label != target and label != seabed) or not limits[0] <= z <= limits[1]:
                continue
            right, down = (u + 0.5 - cx) / fx * z, (v + 0.5 - cy) / fy * z
            east = rotation[0, 0] * right + rotation[0, 1] * down + rotation[0, 2] * z
            north = rotation[1, 0] * right + rotation[1, 1] * down + rotation[1, 2] * z
            if not ring[0] ** 2 < east * east + north * north <= ring[1] ** 2:
                continue
            row = math.floor((place[1] + north - corner[1]) / cell)
            col = math.floor((place[0] + east - corner[0]) / cell)
            if 0 <= row < rows and 0 <= col < cols:
                pixels[1, row, col] += 1
                if label == target:
                    pixels[0, row, col] += 1
