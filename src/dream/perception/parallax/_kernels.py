"""Compiled loops: corners of a picture, and where an earlier one shows them."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

MOST_TRIED = 120
"""Inverse depths that are tried for one corner."""
SEARCHED, REFINED = 3, 4
"""Pixels of a patch to each side of its middle: of a picture `halved` while it is looked for, then of it as
it is."""
SURE = 0.92
"""Correlation of a match from which on other planes are not tried."""
GLANCED = 0.35
"""Correlation of nine pixels below which the others are not looked at."""
STRIDE = 1.5
"""Pixels of the picture that is looked at between two places that are tried."""
STEPS = 8
"""At most, to the best place of a patch."""
COARSELY = 0.15
"""By how much less a correlation may be where a patch is only nearly in its place."""
BETWEEN = 0.1
"""By how much less it may be halfway between two places that are tried."""
CLOSEST = 0.05
"""Share of its depth that a point may have in the earlier camera's frame."""


@njit(cache=True, nogil=True)
def grey(rgb):
    """(H, W) float32 in 0 to 255: green for the most part, as water leaves little red."""
    high, wide = rgb.shape[:2]
    found = np.empty((high, wide), np.float32)
    for v in range(high):
        for u in range(wide):
            found[v, u] = 0.3 * rgb[v, u, 0] + 0.6 * rgb[v, u, 1] + 0.1 * rgb[v, u, 2]
    return found


@njit(cache=True, nogil=True)
def halved(image):
    """(H // 2, W // 2) float32: means over 2 × 2 pixels."""
    high, wide = image.shape[0] // 2, image.shape[1] // 2
    found = np.empty((high, wide), np.float32)
    for v in range(high):
        for u in range(wide):
            upper = image[2 * v, 2 * u] + image[2 * v, 2 * u + 1]
            found[v, u] = 0.25 * (upper + image[2 * v + 1, 2 * u] + image[2 * v + 1, 2 * u + 1])
    return found


@njit(cache=True, nogil=True)
def corners(image, usable, side, half, least):
    """The best corner of each cell of a grid, by the lesser eigenvalue of its gradients' second moments.

    Args:
        image: (H, W) float32.
        usable: (H, W) bool; others are no corners.
        side: Pixels of a cell.
        half: The moments are means over (2 half + 1)² pixels.
        least: Eigenvalue below which there is none.

    Returns:
        (n, 2) float64 columns and rows of pixel centres.
    """
    high, wide = image.shape
    moments, rows = np.zeros((3, high, wide), np.float32), np.zeros((3, high, wide), np.float32)
    xx, xy, yy = moments
    for v in range(1, high - 1):
        for u in range(1, wide - 1):
            across = 0.5 * (image[v, u + 1] - image[v, u - 1])
            along = 0.5 * (image[v + 1, u] - image[v - 1, u])
            xx[v, u], xy[v, u], yy[v, u] = across * across, across * along, along * along
    for v in range(high):
        for u in range(half, wide - half):
            a, b, c = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for k in range(u - half, u + half + 1):
                a, b, c = a + xx[v, k], b + xy[v, k], c + yy[v, k]
            rows[0, v, u], rows[1, v, u], rows[2, v, u] = a, b, c
    count = (2 * half + 1) ** 2
    found = np.empty(((high // side + 1) * (wide // side + 1), 2))
    n, margin = 0, half + 1
    for top in range(0, high, side):
        for left in range(0, wide, side):
            best, where_u, where_v = least, -1, -1
            for v in range(max(top, margin), min(top + side, high - margin)):
                for u in range(max(left, margin), min(left + side, wide - margin)):
                    if not usable[v, u]:
                        continue
                    x, y, z = 0.0, 0.0, 0.0
                    for k in range(v - half, v + half + 1):
                        x, y, z = x + rows[0, k, u], y + rows[1, k, u], z + rows[2, k, u]
                    lesser = (0.5 * (x + z) - math.sqrt(0.25 * (x - z) ** 2 + y * y)) / count
                    if lesser > best:
                        best, where_u, where_v = lesser, u, v
            if where_u >= 0:
                found[n, 0], found[n, 1] = where_u + 0.5, where_v + 0.5
                n += 1
    return found[:n]


@njit(cache=True, nogil=True, error_model="numpy")
def _read(image, zoom, placed, half, values):
    """Read a patch between the pixels of an image, whose centres lie at half-integers.

    Args:
        image: (h, w) float32, `zoom` times as coarse as its camera.
        zoom: Camera pixels along a side of one of the image.
        placed: Column and row of its middle, and how both change to the right and downwards; camera pixels.
        half: The patch has (2 half + 1)² values.
        values: ((2 half + 1)²,) written.

    Returns:
        Whether all of it is inside.
    """
    x, y = placed[0] / zoom - 0.5, placed[1] / zoom - 0.5
    across_x, across_y = placed[2] / zoom, placed[3] / zoom
    along_x, along_y = placed[4] / zoom, placed[5] / zoom
    wide, high = half * (abs(across_x) + abs(along_x)), half * (abs(across_y) + abs(along_y))
    if not (x - wide >= 0.0 and x + wide < image.shape[1] - 1.001):
        return False
    if not (y - high >= 0.0 and y + high < image.shape[0] - 1.001):
        return False
    n = 0
    for i in range(-half, half + 1):
        for j in range(-half, half + 1):
            at_x, at_y = x + j * across_x + i * along_x, y + j * across_y + i * along_y
            u, v = int(at_x), int(at_y)
            right, down = at_x - u, at_y - v
            above = image[v, u] + right * (image[v, u + 1] - image[v, u])
            below = image[v + 1, u] + right * (image[v + 1, u + 1] - image[v + 1, u])
            values[n] = above + down * (below - above)
            n += 1
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _normalised(values):
    """Take off the mean and divide by the length, in place; that length, 0 where there is none."""
    mean, square = 0.0, 0.0
    for k in range(values.size):
        mean += values[k]
    mean /= values.size
    for k in range(values.size):
        values[k] -= mean
        square += values[k] * values[k]
    length = math.sqrt(square)
    if length > 0.0:
        for k in range(values.size):
            values[k] /= length
    return length


@njit(cache=True, nogil=True, error_model="numpy")
def _product(one, other):
    total = 0.0
    for k in range(one.size):
        total += one[k] * other[k]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _patch(image, zoom, lens, R, normal, corner, half, values, ways):
    """A patch of the present picture, and its rays in the earlier camera's frame for an inverse depth of 0.

    Args:
        image: (h, w) float32 of the present picture, `zoom` times as coarse as its camera.
        zoom: Camera pixels along a side of one of the image.
        lens: (4,) fx, fy, cx, cy.
        R: (3, 3) from the present camera to the earlier one.
        normal: (3,) of the plane, in the present camera's frame.
        corner: (2,) column and row of the middle, in pixels of the camera.
        half: The patch has (2 half + 1)² pixels.
        values: ((2 half + 1)²,) written: the patch, normalised.
        ways: (5, 3) written: R times the ray on the plane, of the middle, which is 1 deep, and of the ends to
            the left, the right, above and below.

    Returns:
        Length of the patch before that, by which it is told whether it has contrast; 0 where there is none.
    """
    toward = normal[2]
    for axis in range(2):
        toward += normal[axis] * (corner[axis] - lens[2 + axis]) / lens[axis]
    for k in range(5):
        x, y = (corner[0] - lens[2]) / lens[0], (corner[1] - lens[3]) / lens[1]
        if k == 1 or k == 2:
            x += (2 * k - 3) * half * zoom / lens[0]
        elif k > 2:
            y += (2 * k - 7) * half * zoom / lens[1]
        meets = normal[0] * x + normal[1] * y + normal[2]
        # A plane that is seen edgewise is none.
        if meets * toward <= 0.0 or not 0.4 * abs(toward) < abs(meets) < 2.5 * abs(toward):
            return 0.0
        for row in range(3):
            ways[k, row] = toward / meets * (R[row, 0] * x + R[row, 1] * y + R[row, 2])
    if not _read(image, zoom, (corner[0], corner[1], zoom, 0.0, 0.0, zoom), half, values):
        return 0.0
    return _normalised(values)


@njit(cache=True, nogil=True, error_model="numpy")
def _placed(ways, t, lens, inverse, half):
    """Where the patch would be in an earlier picture: see `_read`; and how its middle moves.

    Returns:
        What `_read` takes, with a middle of NaN where it is behind; pixels of column and row that the middle
        moves for each 1/m; and its depth there, of its present one.
    """
    z = ways[0, 2] + inverse * t[2]
    x, y = (ways[0, 0] + inverse * t[0]) / z, (ways[0, 1] + inverse * t[1]) / z
    ends = np.empty((4, 2))
    least = z
    for k in range(4):
        depth = ways[k + 1, 2] + inverse * t[2]
        least = min(least, depth)
        ends[k, 0] = lens[0] * (ways[k + 1, 0] + inverse * t[0]) / depth
        ends[k, 1] = lens[1] * (ways[k + 1, 1] + inverse * t[1]) / depth
    u = lens[0] * x + lens[2] if least > CLOSEST else np.nan
    each = 0.5 / half
    placed = (
        u,
        lens[1] * y + lens[3],
        each * (ends[1, 0] - ends[0, 0]),
        each * (ends[1, 1] - ends[0, 1]),
        each * (ends[3, 0] - ends[2, 0]),
        each * (ends[3, 1] - ends[2, 1]),
    )
    return placed, lens[0] * (t[0] - x * t[2]) / z, lens[1] * (t[1] - y * t[2]) / z, z


@njit(cache=True, nogil=True)
def _level(size):
    """How often a picture is to be halved until its pixels are about so large, of those of the camera."""
    if size < 1.42:
        return 0
    return 1 if size < 2.83 else 2


@njit(cache=True, nogil=True, error_model="numpy")
def _searched(now, then, lens, there, R, t, normals, corner, limits, least, patch, tried):
    """Try inverse depths from far to near on each plane; see `matched`.

    Returns:
        Score of the best, its inverse depth and plane, and the score of the next best elsewhere on the line.
    """
    values, ways, other, few, glance = patch
    best, best_at, best_where, best_normal, next_best = -1.0, 0.0, -9.0, 0, -1.0
    for m in range(len(normals)):
        if best >= SURE:
            break
        length = _patch(now[1], 2.0, lens, R, normals[m], corner, SEARCHED, values, ways)
        if length < least * (2 * SEARCHED + 1):
            continue
        for k in range(9):
            few[k] = values[(SEARCHED - 2 + 2 * (k // 3)) * (2 * SEARCHED + 1) + SEARCHED - 2 + 2 * (k % 3)]
        _normalised(few)
        n, inverse = 0, 1.0 / limits[1]
        for where in range(MOST_TRIED):
            placed, du, dv, z = _placed(ways, t, there, inverse, SEARCHED)
            slope = math.hypot(du, dv)
            if inverse > 1.0 / limits[0] or math.isnan(placed[0]) or slope < 1e-9:
                break
            level = _level(2.0 / z)
            pixel = float(1 << level)
            if _read(then[level], pixel, _coarse(placed), 1, glance) and _normalised(glance) > 0.0:
                score = _product(few, glance)
                if score > GLANCED:
                    inside = _read(then[level], pixel, placed, SEARCHED, other) and _normalised(other) > 0.0
                    score = _product(values, other) if inside else 0.0
                tried[n, 0], tried[n, 1], tried[n, 2] = inverse, where, min(score, 1.0)
                n += 1
            inverse += STRIDE * pixel / slope
        for i in range(n):
            score = tried[i, 2]
            if (i > 0 and score < tried[i - 1, 2]) or (i < n - 1 and score < tried[i + 1, 2]):
                continue
            apart = abs(tried[i, 1] - best_where) > 3.0 / STRIDE
            if score > best:
                if apart:
                    next_best = max(next_best, best)
                best, best_at, best_where, best_normal = score, tried[i, 0], tried[i, 1], m
            elif apart:
                next_best = max(next_best, score)
    return best, best_at, best_normal, next_best


@njit(cache=True, nogil=True, error_model="numpy")
def _coarse(placed):
    return placed[0], placed[1], 2.0 * placed[2], 2.0 * placed[3], 2.0 * placed[4], 2.0 * placed[5]


@njit(cache=True, nogil=True, error_model="numpy")
def _shifted(placed, u, v):
    return placed[0] + u, placed[1] + v, placed[2], placed[3], placed[4], placed[5]


@njit(cache=True, nogil=True, error_model="numpy")
def _refined(image, zoom, placed, values, other, slopes):
    """Shift a patch over an earlier picture until it fits best: steps of Lucas and Kanade, with equal slopes.

    Returns:
        Columns and rows that it is shifted by, in pixels of the camera, and how well it then fits; −1 where
        it does not come to rest.
    """
    for axis in range(2):
        du, dv = (zoom, 0.0) if axis == 0 else (0.0, zoom)
        if not _read(image, zoom, _shifted(placed, du, dv), REFINED, slopes[axis]):
            return 0.0, 0.0, -1.0
        if not _read(image, zoom, _shifted(placed, -du, -dv), REFINED, other):
            return 0.0, 0.0, -1.0
        mean = 0.0
        for k in range(values.size):
            slopes[axis, k] = 0.5 * (slopes[axis, k] - other[k]) / zoom
            mean += slopes[axis, k] / values.size
        for k in range(values.size):
            slopes[axis, k] -= mean
    a, b, c = _product(slopes[0], slopes[0]), _product(slopes[0], slopes[1]), _product(slopes[1], slopes[1])
    determinant = a * c - b * b
    if determinant <= 1e-3:
        return 0.0, 0.0, -1.0
    shift_u, shift_v, score = 0.0, 0.0, -1.0
    for _ in range(STEPS):
        if not _read(image, zoom, _shifted(placed, shift_u, shift_v), REFINED, other):
            return 0.0, 0.0, -1.0
        length = _normalised(other)
        score = _product(values, other)
        if length <= 0.0 or score <= 0.0:
            return 0.0, 0.0, -1.0
        # By how much brighter the earlier picture shows it: its values are so much greater in it.
        gain = length / score
        p = gain * _product(slopes[0], values) - length * _product(slopes[0], other)
        q = gain * _product(slopes[1], values) - length * _product(slopes[1], other)
        du, dv = (c * p - b * q) / determinant, (a * q - b * p) / determinant
        size = math.hypot(du, dv)
        if size < 0.02 * zoom:
            return shift_u, shift_v, score
        less = min(1.0, zoom / size)
        shift_u, shift_v = shift_u + less * du, shift_v + less * dv
        if math.hypot(shift_u, shift_v) > 4.0 * zoom:
            return 0.0, 0.0, -1.0
    return shift_u, shift_v, score


@njit(cache=True, nogil=True, error_model="numpy")
def matched(now, then, lens, there, R, t, normals, points, limits, least, alike, unique):
    """Where an earlier picture shows what is at some points of the present one, and how deep that is.

    Args:
        now: The present picture (H, W) float32, and the same `halved` once and twice.
        then: Likewise the earlier one.
        lens: (4,) fx, fy, cx, cy of the present camera.
        there: Likewise of the earlier one.
        R: (3, 3) from the present camera to the earlier one.
        t: (3,) metres, likewise.
        normals: (m, 3) in the present camera's frame: planes that what is seen may lie on.
        points: (n, 2) columns and rows in pixels of the present camera.
        limits: (2,) nearest and farthest depth, metres.
        least: Contrast of a patch, a standard deviation.
        alike: Least correlation of two patches that show the same.
        unique: How many times as far from 1 another correlation on the line has to be.

    Returns:
        (n, 4): metres along the present optical axis, NaN where nothing is found; pixels that the match moves
        for each 1/m; pixels that it is off the line; and its correlation.
    """
    found = np.full((len(points), 4), np.nan)
    wide, fine = (2 * SEARCHED + 1) ** 2, (2 * REFINED + 1) ** 2
    ways, tried = np.empty((5, 3)), np.empty((MOST_TRIED, 3))
    patch = np.empty(wide), ways, np.empty(wide), np.empty(9), np.empty(9)
    values, other, slopes = np.empty(fine), np.empty(fine), np.empty((2, fine))
    for i in range(len(points)):
        best, inverse, m, next_best = _searched(
            now, then, lens, there, R, t, normals, points[i], limits, least, patch, tried
        )
        if best < alike - COARSELY or 1.0 - next_best < unique * max(1.0 - best, BETWEEN):
            continue
        for level in (1, 0):
            zoom = float(1 << level)
            if _patch(now[level], zoom, lens, R, normals[m], points[i], REFINED, values, ways) <= 0.0:
                break
            placed, du, dv, z = _placed(ways, t, there, inverse, REFINED)
            # Where the earlier picture is coarser than the present one there is no more to be seen.
            if level == 0 and z > 1.6:
                break
            k = _level(zoom / z)
            u, v, score = _refined(then[k], float(1 << k), placed, values, other, slopes)
            slope = math.hypot(du, dv)
            inverse += (u * du + v * dv) / slope**2
            last = level == 0 or z > 1.6
            inside = 1.0 / limits[1] < inverse < 1.0 / limits[0]
            if score < (alike if last else alike - COARSELY) or not inside:
                found[i, 0] = np.nan
                break
            off = (v * du - u * dv) / slope
            found[i, 0], found[i, 1], found[i, 2], found[i, 3] = 1.0 / inverse, slope, off, score
    return found
