"""Paints what a frame saw onto a plan of the ground."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]
UInt8Array = npt.NDArray[np.uint8]


@nb.njit(cache=True, nogil=True)
def paint(
    points: Float64Array,
    good: npt.NDArray[np.bool_],
    rgb: UInt8Array,
    sharpness: float,
    longest: float,
    margin: float,
    color: Float32Array,
    weight: Float32Array,
) -> None:
    """Add one frame to a plan.

    The pixels of the depth image and their neighbours to the right and below make squares of two triangles;
    each is drawn from above with the colour picture on it. What a triangle adds weighs (pixels per m² of
    ground) ** `sharpness`: the nearest and steepest view dominates, and where two are alike they blend.
    Towards the border of the picture, within `margin` of its width, the weight fades to 0, so that no seam is
    left.

    Args:
        points: (H, W, 2) column and row of the plan, fractional, under each pixel.
        good: (H, W) pixels with a depth that counts.
        rgb: (k H, k W, 3).
        sharpness: See above.
        longest: Cells; a square with a longer side spans a step in depth, and is left out.
        margin: Share of the picture's width.
        color: (rows, cols, 3) sums of colour by weight, added to in place.
        weight: (rows, cols) sums of weights, added to in place.
    """
    height, width = good.shape
    k = rgb.shape[0] // height
    rows, cols = weight.shape
    fade = max(margin * width, 1.0)
    for v in range(height - 1):
        for u in range(width - 1):
            if not (good[v, u] and good[v, u + 1] and good[v + 1, u] and good[v + 1, u + 1]):
                continue
            for half in range(2):
                # Upper left, upper right, lower left; then lower right, lower left, upper right.
                u0, v0, du, dv = (u, v, 1, 1) if half == 0 else (u + 1, v + 1, -1, -1)
                ax, ay = points[v0, u0, 0], points[v0, u0, 1]
                bx, by = points[v0, u0 + du, 0], points[v0, u0 + du, 1]
                cx, cy = points[v0 + dv, u0, 0], points[v0 + dv, u0, 1]
                if (
                    max(abs(ax - bx), abs(ay - by), abs(ax - cx), abs(ay - cy), abs(bx - cx), abs(by - cy))
                    > longest
                ):
                    continue
                twice = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
                if abs(twice) < 1e-9:
                    continue
                edge = min(u0, width - 1 - u0, v0, height - 1 - v0) + 1.0
                gain = (1.0 / abs(twice)) ** sharpness * min(1.0, edge / fade) ** 2
                first_row = max(0, math.ceil(min(ay, by, cy) - 0.5))
                last_row = min(rows - 1, math.floor(max(ay, by, cy) - 0.5))
                first_col = max(0, math.ceil(min(ax, bx, cx) - 0.5))
                last_col = min(cols - 1, math.floor(max(ax, bx, cx) - 0.5))
                for row in range(first_row, last_row + 1):
                    for col in range(first_col, last_col + 1):
                        px, py = col + 0.5 - ax, row + 0.5 - ay
                        s = (px * (cy - ay) - py * (cx - ax)) / twice
                        t = (py * (bx - ax) - px * (by - ay)) / twice
                        if s < 0.0 or t < 0.0 or s + t > 1.0:
                            continue
                        # The middle of a depth pixel is the middle of k × k colour pixels.
                        fu = (u0 + s * du + 0.5) * k - 0.5
                        fv = (v0 + t * dv + 0.5) * k - 0.5
                        iu = min(max(math.floor(fu), 0), rgb.shape[1] - 2)
                        iv = min(max(math.floor(fv), 0), rgb.shape[0] - 2)
                        wu, wv = min(max(fu - iu, 0.0), 1.0), min(max(fv - iv, 0.0), 1.0)
                        for channel in range(3):
                            upper = (1.0 - wu) * rgb[iv, iu, channel] + wu * rgb[iv, iu + 1, channel]
                            lower = (1.0 - wu) * rgb[iv + 1, iu, channel] + wu * rgb[iv + 1, iu + 1, channel]
                            color[row, col, channel] += gain * ((1.0 - wv) * upper + wv * lower)
                        weight[row, col] += gain
