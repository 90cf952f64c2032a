"""Kernels of the line of sight, the contact test and the visibility of individuals.

All take plain numbers, float64 arrays and tuples of those, in world coordinates (metres, z up).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

Float64Array = npt.NDArray[np.float64]
IntpArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]

END = 1e-3
"""Metres at the end of a ray that nothing blocks: coordinates are quantised to a millimetre."""
NOTHING, GROUND = -1, -2
"""What is between two points where that is no triangle."""
PAD = 1e-6
"""Metres by which cells reach beyond what they hold, so that rounding loses nothing at their borders."""


class Index(NamedTuple):
    """All that blocks sight and motion: a height grid and a soup of triangles, under one grid of cells."""

    heights: Float64Array
    """(rows, cols) of the terrain."""
    terrain_x0: float
    terrain_y0: float
    spacing: float
    triangles: Float64Array
    """(T, 3, 3): corners, then coordinates."""
    first: IntpArray
    """(cells + 1,) where the triangles of a cell begin in `members`; cells are counted row by row."""
    members: IntpArray
    """Triangle indices, cell after cell."""
    spans: Float64Array
    """(members, 2) least and greatest z of each of them, so that a ray skips most of what it passes."""
    bottom: Float64Array
    """(cell rows, cell cols) least z of the triangles of a cell; inf where it has none."""
    top: Float64Array
    """Their greatest z; −inf where it has none."""
    ground_top: Float64Array
    """No terrain in this cell is higher."""
    x0: float
    y0: float
    cell: float


class Sensor(NamedTuple):
    """Camera and reach of a survey protocol."""

    rotation: Float64Array
    """(3, 3) of `T_base_camera`; the camera sits at the vehicle's centre."""
    fx: float
    fy: float
    cx: float
    cy: float
    width: float
    height: float
    min_depth: float
    max_depth: float
    reach: float
    altitude: float


@njit(cache=True, nogil=True)
def bin_boxes(
    boxes: Float64Array, x0: float, y0: float, cell: float, rows: int, cols: int
) -> tuple[IntpArray, IntpArray]:
    """`first` and `members` of boxes (N, 4: x_min, y_min, x_max, y_max) in every cell that they touch."""
    first = np.zeros(rows * cols + 1, np.intp)
    spans = np.empty((len(boxes), 4), np.intp)
    for i in range(len(boxes)):
        spans[i, 0] = min(max(math.floor((boxes[i, 0] - x0) / cell), 0), cols - 1)
        spans[i, 1] = min(max(math.floor((boxes[i, 1] - y0) / cell), 0), rows - 1)
        spans[i, 2] = min(max(math.floor((boxes[i, 2] - x0) / cell), 0), cols - 1)
        spans[i, 3] = min(max(math.floor((boxes[i, 3] - y0) / cell), 0), rows - 1)
        for row in range(spans[i, 1], spans[i, 3] + 1):
            for col in range(spans[i, 0], spans[i, 2] + 1):
                first[row * cols + col + 1] += 1
    for k in range(rows * cols):
        first[k + 1] += first[k]
    fill = first[:-1].copy()
    members = np.empty(first[-1], np.intp)
    for i in range(len(boxes)):
        for row in range(spans[i, 1], spans[i, 3] + 1):
            for col in range(spans[i, 0], spans[i, 2] + 1):
                members[fill[row * cols + col]] = i
                fill[row * cols + col] += 1
    return first, members


@njit(cache=True, nogil=True)
def cell_ground_tops(
    heights: Float64Array,
    terrain_x0: float,
    terrain_y0: float,
    spacing: float,
    x0: float,
    y0: float,
    cell: float,
    rows: int,
    cols: int,
) -> Float64Array:
    """Greatest terrain height at the corners of all squares that touch a cell; −inf beyond the terrain."""
    tops = np.full((rows, cols), -np.inf)
    for row in range(rows):
        r0 = math.floor((y0 + row * cell - PAD - terrain_y0) / spacing)
        r1 = math.ceil((y0 + (row + 1) * cell + PAD - terrain_y0) / spacing)
        for col in range(cols):
            c0 = math.floor((x0 + col * cell - PAD - terrain_x0) / spacing)
            c1 = math.ceil((x0 + (col + 1) * cell + PAD - terrain_x0) / spacing)
            for r in range(max(r0, 0), min(r1, heights.shape[0] - 1) + 1):
                for c in range(max(c0, 0), min(c1, heights.shape[1] - 1) + 1):
                    tops[row, col] = max(tops[row, col], heights[r, c])
    return tops


@njit(cache=True, nogil=True)
def ground(index: Index, x: float, y: float) -> float:
    """Terrain height, as `Terrain.height` gives it."""
    heights = index.heights
    gx = min(max((x - index.terrain_x0) / index.spacing, 0.0), heights.shape[1] - 1 - 1e-9)
    gy = min(max((y - index.terrain_y0) / index.spacing, 0.0), heights.shape[0] - 1 - 1e-9)
    col, row = int(gx), int(gy)
    fx, fy = gx - col, gy - row
    z00, z11 = heights[row, col], heights[row + 1, col + 1]
    if fx >= fy:
        z01 = heights[row, col + 1]
        return float(z00 + fx * (z01 - z00) + fy * (z11 - z01))
    z10 = heights[row + 1, col]
    return float(z00 + fy * (z10 - z00) + fx * (z11 - z10))


@njit(cache=True, nogil=True)
def _crossing(
    triangle: Float64Array, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> float:
    """The t at which o + t·d crosses the triangle, from any side, or NaN (Möller and Trumbore, 1997)."""
    ax, ay, az = triangle[0, 0], triangle[0, 1], triangle[0, 2]
    e1x, e1y, e1z = triangle[1, 0] - ax, triangle[1, 1] - ay, triangle[1, 2] - az
    e2x, e2y, e2z = triangle[2, 0] - ax, triangle[2, 1] - ay, triangle[2, 2] - az
    px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
    det = e1x * px + e1y * py + e1z * pz
    if det == 0.0:
        return math.nan
    sx, sy, sz = ox - ax, oy - ay, oz - az
    u = (sx * px + sy * py + sz * pz) / det
    # A hair of overlap, so that no ray slips between two triangles that share an edge.
    if u < -1e-9 or u > 1.0 + 1e-9:
        return math.nan
    qx, qy, qz = sy * e1z - sz * e1y, sz * e1x - sx * e1z, sx * e1y - sy * e1x
    v = (dx * qx + dy * qy + dz * qz) / det
    if v < -1e-9 or u + v > 1.0 + 1e-9:
        return math.nan
    return float((e2x * qx + e2y * qy + e2z * qz) / det)


@njit(cache=True, nogil=True)
def _buried(
    index: Index, gx: float, gy: float, z: float, dgx: float, dgy: float, dz: float, t0: float, t1: float
) -> bool:
    """Is the ray under the terrain at a fold of it between t0 and t1?

    The ray starts at (gx, gy) in units of the spacing. Between folds (grid lines and diagonals) its height
    above the terrain is linear in t, so looking at the folds is exact.
    """
    heights = index.heights
    rows, cols = heights.shape
    for family in range(3):
        start = gx if family == 0 else gy if family == 1 else gx - gy
        slope = dgx if family == 0 else dgy if family == 1 else dgx - dgy
        if slope == 0.0:
            continue
        a, b = start + slope * t0, start + slope * t1
        for k in range(math.ceil(min(a, b) - 1e-9), math.floor(max(a, b) + 1e-9) + 1):
            t = (k - start) / slope
            x = min(max(gx + dgx * t, 0.0), cols - 1.0)
            y = min(max(gy + dgy * t, 0.0), rows - 1.0)
            if family == 0:
                col, row = min(max(k, 0), cols - 1), min(int(y), rows - 2)
                low, high, part = heights[row, col], heights[row + 1, col], y - row
            elif family == 1:
                col, row = min(int(x), cols - 2), min(max(k, 0), rows - 1)
                low, high, part = heights[row, col], heights[row, col + 1], x - col
            else:
                col, row = min(int(x), cols - 2), min(int(y), rows - 2)
                low, high, part = heights[row, col], heights[row + 1, col + 1], x - col
            if z + dz * t < low + part * (high - low) - END:
                return True
    return False


@njit(cache=True, nogil=True)
def blocker(index: Index, ex: float, ey: float, ez: float, px: float, py: float, pz: float) -> int:
    """A triangle that lies between e and p, GROUND or NOTHING. Beyond the cells nothing does."""
    dx, dy, dz = px - ex, py - ey, pz - ez
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    if length <= END:
        return NOTHING
    end = 1.0 - END / length
    if pz < ground(index, px, py) - END:
        return GROUND

    cell = index.cell
    rows, cols = index.top.shape
    t, last = 0.0, 1.0
    if dx != 0.0:
        a, b = (index.x0 - ex) / dx, (index.x0 + cols * cell - ex) / dx
        t, last = max(t, min(a, b)), min(last, max(a, b))
    elif not index.x0 <= ex <= index.x0 + cols * cell:
        return NOTHING
    if dy != 0.0:
        a, b = (index.y0 - ey) / dy, (index.y0 + rows * cell - ey) / dy
        t, last = max(t, min(a, b)), min(last, max(a, b))
    elif not index.y0 <= ey <= index.y0 + rows * cell:
        return NOTHING
    if t >= last:
        return NOTHING

    # Walk the cells that the ray crosses (Amanatides and Woo, 1987).
    col = min(max(math.floor((ex + t * dx - index.x0) / cell), 0), cols - 1)
    row = min(max(math.floor((ey + t * dy - index.y0) / cell), 0), rows - 1)
    step_x, step_y = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    next_x = (index.x0 + (col + (dx > 0.0)) * cell - ex) / dx if dx != 0.0 else math.inf
    next_y = (index.y0 + (row + (dy > 0.0)) * cell - ey) / dy if dy != 0.0 else math.inf
    delta_x = cell / abs(dx) if dx != 0.0 else math.inf
    delta_y = cell / abs(dy) if dy != 0.0 else math.inf
    gx, gy = (ex - index.terrain_x0) / index.spacing, (ey - index.terrain_y0) / index.spacing
    dgx, dgy = dx / index.spacing, dy / index.spacing
    while True:
        leave = min(next_x, next_y, last)
        z_in, z_out = ez + t * dz, ez + leave * dz
        low, high = min(z_in, z_out) - PAD, max(z_in, z_out) + PAD
        if low <= index.top[row, col] and high >= index.bottom[row, col]:
            cell_id = row * cols + col
            for k in range(index.first[cell_id], index.first[cell_id + 1]):
                if low > index.spans[k, 1] or high < index.spans[k, 0]:
                    continue
                if 0.0 < _crossing(index.triangles[index.members[k]], ex, ey, ez, dx, dy, dz) < end:
                    return int(index.members[k])
        if low <= index.ground_top[row, col] and _buried(index, gx, gy, ez, dgx, dgy, dz, t, leave):
            return GROUND
        if leave >= last:
            return NOTHING
        t = leave
        if next_x < next_y:
            col += step_x
            next_x += delta_x
        else:
            row += step_y
            next_y += delta_y
        if not (0 <= col < cols and 0 <= row < rows):
            return NOTHING


@njit(cache=True, nogil=True)
def blocked(index: Index, ex: float, ey: float, ez: float, px: float, py: float, pz: float) -> bool:
    """Does terrain or a triangle lie between e and p?"""
    return blocker(index, ex, ey, ez, px, py, pz) != NOTHING


@njit(cache=True, nogil=True)
def between(triangle: Float64Array, ex: float, ey: float, ez: float, px: float, py: float, pz: float) -> bool:
    """Does this triangle lie between e and p, as `blocker` means it?"""
    dx, dy, dz = px - ex, py - ey, pz - ez
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    return length > END and 0.0 < _crossing(triangle, ex, ey, ez, dx, dy, dz) < 1.0 - END / length


@njit(cache=True, nogil=True)
def lines_of_sight(index: Index, eye: Float64Array, points: Float64Array) -> BoolArray:
    """Which points (N, 3) have nothing between them and the eye (3,)?"""
    clear = np.empty(len(points), np.bool_)
    for i in range(len(points)):
        clear[i] = not blocked(index, eye[0], eye[1], eye[2], points[i, 0], points[i, 1], points[i, 2])
    return clear


@njit(cache=True, nogil=True)
def _half_square(index: Index, row: int, col: int, side: int, half: Float64Array) -> None:
    """Write one of the two triangles (3, 3) of a square of the terrain into `half`."""
    for corner in range(3):
        # Lower triangle: (0, 0), (0, 1), (1, 1); upper: (0, 0), (1, 1), (1, 0), as (row, col).
        dr = corner // 2 if side == 0 else min(corner, 1)
        dc = min(corner, 1) if side == 0 else corner % 2
        half[corner, 0] = index.terrain_x0 + (col + dc) * index.spacing
        half[corner, 1] = index.terrain_y0 + (row + dr) * index.spacing
        half[corner, 2] = index.heights[row + dr, col + dc]


@njit(cache=True, nogil=True)
def _slant(triangle: Float64Array, dx: float, dy: float, dz: float) -> float:
    """Cosine between a ray of length 1 and the normal of a triangle, from either side."""
    ax, ay, az = triangle[0, 0], triangle[0, 1], triangle[0, 2]
    e1x, e1y, e1z = triangle[1, 0] - ax, triangle[1, 1] - ay, triangle[1, 2] - az
    e2x, e2y, e2z = triangle[2, 0] - ax, triangle[2, 1] - ay, triangle[2, 2] - az
    nx, ny, nz = e1y * e2z - e1z * e2y, e1z * e2x - e1x * e2z, e1x * e2y - e1y * e2x
    return float(abs(nx * dx + ny * dy + nz * dz) / math.sqrt(nx * nx + ny * ny + nz * nz))


@njit(cache=True, nogil=True)
def cast(
    index: Index, ex: float, ey: float, ez: float, dx: float, dy: float, dz: float, limit: float
) -> tuple[float, float]:
    """How far from e along d, of length 1, terrain or a triangle is first met, and the cosine of incidence.

    (inf, NaN) where there is nothing within `limit`.
    """
    cell = index.cell
    rows, cols = index.top.shape
    heights, spacing = index.heights, index.spacing
    t, last = 0.0, limit
    if dx != 0.0:
        a, b = (index.x0 - ex) / dx, (index.x0 + cols * cell - ex) / dx
        t, last = max(t, min(a, b)), min(last, max(a, b))
    elif not index.x0 <= ex <= index.x0 + cols * cell:
        return math.inf, math.nan
    if dy != 0.0:
        a, b = (index.y0 - ey) / dy, (index.y0 + rows * cell - ey) / dy
        t, last = max(t, min(a, b)), min(last, max(a, b))
    elif not index.y0 <= ey <= index.y0 + rows * cell:
        return math.inf, math.nan
    if t >= last:
        return math.inf, math.nan

    # The walk of `blocked`.
    col = min(max(math.floor((ex + t * dx - index.x0) / cell), 0), cols - 1)
    row = min(max(math.floor((ey + t * dy - index.y0) / cell), 0), rows - 1)
    step_x, step_y = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    next_x = (index.x0 + (col + (dx > 0.0)) * cell - ex) / dx if dx != 0.0 else math.inf
    next_y = (index.y0 + (row + (dy > 0.0)) * cell - ey) / dy if dy != 0.0 else math.inf
    delta_x = cell / abs(dx) if dx != 0.0 else math.inf
    delta_y = cell / abs(dy) if dy != 0.0 else math.inf
    half = np.empty((3, 3))
    best, cosine = math.inf, math.nan
    while True:
        leave = min(next_x, next_y, last)
        z_in, z_out = ez + t * dz, ez + leave * dz
        low, high = min(z_in, z_out) - PAD, max(z_in, z_out) + PAD
        if low <= index.top[row, col] and high >= index.bottom[row, col]:
            cell_id = row * cols + col
            for k in range(index.first[cell_id], index.first[cell_id + 1]):
                triangle = index.triangles[index.members[k]]
                met = _crossing(triangle, ex, ey, ez, dx, dy, dz)
                if 0.0 < met < best:
                    best, cosine = met, _slant(triangle, dx, dy, dz)
        if low <= index.ground_top[row, col]:
            gx, hx = (
                (ex + t * dx - index.terrain_x0) / spacing,
                (ex + leave * dx - index.terrain_x0) / spacing,
            )
            gy, hy = (
                (ey + t * dy - index.terrain_y0) / spacing,
                (ey + leave * dy - index.terrain_y0) / spacing,
            )
            for r in range(
                max(math.floor(min(gy, hy) - PAD), 0),
                min(math.floor(max(gy, hy) + PAD), heights.shape[0] - 2) + 1,
            ):
                for c in range(
                    max(math.floor(min(gx, hx) - PAD), 0),
                    min(math.floor(max(gx, hx) + PAD), heights.shape[1] - 2) + 1,
                ):
                    for side in range(2):
                        _half_square(index, r, c, side, half)
                        met = _crossing(half, ex, ey, ez, dx, dy, dz)
                        if 0.0 < met < best:
                            best, cosine = met, _slant(half, dx, dy, dz)
        # What was met beyond this cell may yet lie behind something else.
        if best <= leave + PAD:
            break
        if leave >= last:
            break
        t = leave
        if next_x < next_y:
            col += step_x
            next_x += delta_x
        else:
            row += step_y
            next_y += delta_y
        if not (0 <= col < cols and 0 <= row < rows):
            break
    return (best, cosine) if best <= limit else (math.inf, math.nan)


@njit(cache=True, nogil=True)
def casts(
    index: Index, eye: Float64Array, directions: Float64Array, limit: float
) -> tuple[Float64Array, Float64Array]:
    """`cast` from one eye (3,) along every direction (N, 3)."""
    distances, cosines = np.empty(len(directions)), np.empty(len(directions))
    for i in range(len(directions)):
        distances[i], cosines[i] = cast(
            index, eye[0], eye[1], eye[2], directions[i, 0], directions[i, 1], directions[i, 2], limit
        )
    return distances, cosines


@njit(cache=True, nogil=True)
def _to_segment(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Distance on the plane from a point to a segment."""
    dx, dy = bx - ax, by - ay
    square = dx * dx + dy * dy
    part = 0.0 if square == 0.0 else min(max(((x - ax) * dx + (y - ay) * dy) / square, 0.0), 1.0)
    return math.hypot(ax + part * dx - x, ay + part * dy - y)


@njit(cache=True, nogil=True)
def _to_edge(x: float, y: float, low: float, high: float, a: Float64Array, b: Float64Array) -> float:
    """Horizontal distance from the vertical line at (x, y) to the part of edge ab between two heights."""
    az, bz = a[2], b[2]
    if max(az, bz) < low or min(az, bz) > high:
        return math.inf
    s0, s1 = 0.0, 1.0
    if az != bz:
        u, v = (low - az) / (bz - az), (high - az) / (bz - az)
        s0, s1 = max(s0, min(u, v)), min(s1, max(u, v))
    dx, dy = b[0] - a[0], b[1] - a[1]
    return _to_segment(x, y, a[0] + s0 * dx, a[1] + s0 * dy, a[0] + s1 * dx, a[1] + s1 * dy)


@njit(cache=True, nogil=True)
def _to_cut(x: float, y: float, level: float, triangle: Float64Array) -> float:
    """Horizontal distance from (x, y) to where a level plane cuts a triangle."""
    found = False
    ax = ay = bx = by = 0.0
    for i in range(3):
        p, q = triangle[i], triangle[(i + 1) % 3]
        if (p[2] < level) != (q[2] < level):
            s = (level - p[2]) / (q[2] - p[2])
            bx, by = p[0] + s * (q[0] - p[0]), p[1] + s * (q[1] - p[1])
            if not found:
                ax, ay, found = bx, by, True
    return _to_segment(x, y, ax, ay, bx, by) if found else math.inf


@njit(cache=True, nogil=True)
def _to_triangle(x: float, y: float, low: float, high: float, triangle: Float64Array) -> float:
    """Horizontal distance from the vertical line at (x, y) to the part of a triangle between two heights."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    if max(a[2], b[2], c[2]) < low or min(a[2], b[2], c[2]) > high:
        return math.inf
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if area != 0.0:
        u = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
        v = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
        if (
            u >= 0.0
            and v >= 0.0
            and u + v <= 1.0
            and low <= a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2]) <= high
        ):
            return 0.0
    least = min(
        _to_edge(x, y, low, high, a, b), _to_edge(x, y, low, high, b, c), _to_edge(x, y, low, high, c, a)
    )
    # Where the slab cuts through the triangle, the cuts are sides of the remaining polygon, too.
    return min(least, _to_cut(x, y, low, triangle), _to_cut(x, y, high, triangle))


@njit(cache=True, nogil=True)
def _near(x: float, y: float, distance: float, triangle: Float64Array) -> bool:
    """Does the triangle's box on the ground reach into the square of that half side about (x, y)?"""
    ax, bx, cx = triangle[0, 0] - x, triangle[1, 0] - x, triangle[2, 0] - x
    if min(ax, bx, cx) > distance or max(ax, bx, cx) < -distance:
        return False
    ay, by, cy = triangle[0, 1] - y, triangle[1, 1] - y, triangle[2, 1] - y
    return bool(min(ay, by, cy) <= distance and max(ay, by, cy) >= -distance)


@njit(cache=True, nogil=True)
def _to_terrain(
    index: Index, x: float, y: float, low: float, high: float, row: int, col: int, best: float
) -> float:
    """The lesser of `best` and the horizontal distance to the terrain of a cell between two heights."""
    heights, spacing = index.heights, index.spacing
    left, near = index.x0 + col * index.cell, index.y0 + row * index.cell
    # What is farther than `best` does not matter.
    r0 = max(math.floor((max(near, y - best - PAD) - index.terrain_y0) / spacing), 0)
    r1 = min(
        math.floor((min(near + index.cell, y + best + PAD) - index.terrain_y0) / spacing),
        heights.shape[0] - 2,
    )
    c0 = max(math.floor((max(left, x - best - PAD) - index.terrain_x0) / spacing), 0)
    c1 = min(
        math.floor((min(left + index.cell, x + best + PAD) - index.terrain_x0) / spacing),
        heights.shape[1] - 2,
    )
    half = np.empty((3, 3))
    for r in range(r0, r1 + 1):
        for c in range(c0, c1 + 1):
            if max(heights[r, c], heights[r, c + 1], heights[r + 1, c], heights[r + 1, c + 1]) < low:
                continue
            for side in range(2):
                _half_square(index, r, c, side, half)
                best = min(best, _to_triangle(x, y, low, high, half))
    return best


@njit(cache=True, nogil=True)
def room(index: Index, x: float, y: float, low: float, high: float, limit: float) -> float:
    """Least horizontal distance from the axis at (x, y) to solids between two heights, at most `limit`."""
    rows, cols = index.top.shape
    cell = index.cell
    fx, fy = (x - index.x0) / cell, (y - index.y0) / cell
    col0, row0 = math.floor(fx), math.floor(fy)
    fx, fy = fx - col0, fy - row0
    inner = min(fx, 1.0 - fx, fy, 1.0 - fy)
    best = limit
    ring = 0
    # Rings of cells outwards, until the next ring is farther away than what was found.
    while ring == 0 or (ring - 1 + inner) * cell < best:
        for row in range(max(row0 - ring, 0), min(row0 + ring, rows - 1) + 1):
            edge = abs(row - row0) == ring
            for col in range(col0 - ring, col0 + ring + 1, 1 if edge else max(2 * ring, 1)):
                if not 0 <= col < cols:
                    continue
                if high >= index.bottom[row, col] and low <= index.top[row, col]:
                    cell_id = row * cols + col
                    for k in range(index.first[cell_id], index.first[cell_id + 1]):
                        triangle = index.triangles[index.members[k]]
                        if _near(x, y, best, triangle):
                            best = min(best, _to_triangle(x, y, low, high, triangle))
                if low <= index.ground_top[row, col]:
                    best = _to_terrain(index, x, y, low, high, row, col, best)
        ring += 1
    return best


@njit(cache=True, nogil=True)
def _solid_room(index: Index, x: float, y: float, low: float, high: float, limit: float) -> float:
    """As `room`, but 0 where the axis is in the ground, be it a part of it: there is no room in there."""
    rows, cols = index.top.shape
    row, col = math.floor((y - index.y0) / index.cell), math.floor((x - index.x0) / index.cell)
    # Most bodies are above all terrain of their cell; where there is none, its top is −inf.
    near_ground = 0 <= row < rows and 0 <= col < cols and low <= index.ground_top[row, col]
    if near_ground and low <= ground(index, x, y):
        return 0.0
    return room(index, x, y, low, high, limit)


@njit(cache=True, nogil=True)
def _clearance(
    index: Index, x: float, y: float, z: float, radius: float, height: float, limit: float
) -> float:
    """Horizontal clearance of a level cylinder whose centre is (x, y, z); at most `limit`.

    Zero or less exactly where it touches something, be that beside, above or below it.
    """
    low, high = z - 0.5 * height, z + 0.5 * height
    return min(limit, _solid_room(index, x, y, low, high, limit + radius + PAD) - radius)


@njit(cache=True, nogil=True)
def clearances(
    index: Index, points: Float64Array, over_ground: bool, radius: float, height: float, limit: float
) -> Float64Array:
    """`_clearance` at every point (P, 3), whose heights count from the terrain or absolutely."""
    result = np.empty(len(points))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if over_ground:
            z = ground(index, x, y) + z
        result[i] = _clearance(index, x, y, z, radius, height, limit)
    return result


class BodyWay(NamedTuple):
    """A straight move over ground, and how high it leads."""

    x0: float
    y0: float
    z0: float
    x1: float
    y1: float
    z1: float
    """Heights change evenly from z0 to z1 ..."""
    over_ground: bool
    """... above the terrain, or else absolutely."""


@njit(cache=True, nogil=True, inline="always")
def _along(index: Index, way: BodyWay, s: float) -> tuple[float, float, float]:
    """Where a share s of the way has been made. Inlined: a call costs a third of a pass."""
    x, y = way.x0 * (1.0 - s) + way.x1 * s, way.y0 * (1.0 - s) + way.y1 * s
    # In this order a way that keeps its height keeps it to the last bit.
    z = way.z0 + s * (way.z1 - way.z0)
    return x, y, (ground(index, x, y) + z if way.over_ground else z)


@njit(cache=True, nogil=True)
def _looks(way: BodyWay, pace: float) -> int:
    """How many stretches of at most `pace` metres the way is cut into."""
    length = math.hypot(math.hypot(way.x1 - way.x0, way.y1 - way.y0), way.z1 - way.z0)
    return max(1, math.ceil(length / pace))


@njit(cache=True, nogil=True)
def sweep(
    index: Index, way: BodyWay, radius: float, height: float, limit: float, pace: float
) -> tuple[float, float]:
    """Share of a way before contact, and its least clearance, looked at every `pace` metres."""
    count = _looks(way, pace)
    least = limit
    for i in range(count + 1):
        s = i / count
        x, y, z = _along(index, way, s)
        # Only what is nearer than all before matters.
        least = _clearance(index, x, y, z, radius, height, least)
        if least > 0.0:
            continue
        if i == 0:
            return 0.0, least
        free, touching = (i - 1) / count, s
        for _ in range(12):
            s = 0.5 * (free + touching)
            x, y, z = _along(index, way, s)
            if _clearance(index, x, y, z, radius, height, pace) > 0.0:
                free = s
            else:
                touching = s
        return free, least
    return 1.0, least


@njit(cache=True, nogil=True)
def _passes(index: Index, way: BodyWay, radius: float, height: float, pace: float) -> bool:
    """Does `sweep` find no contact?

    The room in a slab that holds the body at all heights of the move tells how many looks can be skipped.
    """
    count = _looks(way, pace)
    low, high = math.inf, -math.inf
    for i in range(count + 1):
        z = _along(index, way, i / count)[2]
        low, high = min(low, z - 0.5 * height), max(high, z + 0.5 * height)
    i = 0
    while i <= count:
        x, y, z = _along(index, way, i / count)
        spare = _solid_room(index, x, y, low, high, radius + (count + 1 - i) * pace) - radius - PAD
        if spare <= 0.0 and _clearance(index, x, y, z, radius, height, pace) <= 0.0:
            return False
        i += max(1, math.floor(max(spare, 0.0) / pace))
    return True


@njit(cache=True, nogil=True)
def passes(
    index: Index,
    starts: Float64Array,
    ends: Float64Array,
    over_ground: bool,
    radius: float,
    height: float,
    pace: float,
) -> BoolArray:
    """`_passes` for every move from starts (M, 3) to ends (M, 3)."""
    result = np.empty(len(starts), np.bool_)
    for i in range(len(starts)):
        way = BodyWay(
            starts[i, 0], starts[i, 1], starts[i, 2], ends[i, 0], ends[i, 1], ends[i, 2], over_ground
        )
        result[i] = _passes(index, way, radius, height, pace)
    return result


@njit(cache=True, nogil=True)
def tops(index: Index, positions: Float64Array, radius: float) -> Float64Array:
    """Greatest z of the triangles in the cells within `radius` of positions (P, 2), or −inf."""
    result = np.full(len(positions), -np.inf)
    rows, cols = index.top.shape
    for i in range(len(positions)):
        x, y = positions[i, 0] - index.x0, positions[i, 1] - index.y0
        for row in range(
            max(math.floor((y - radius) / index.cell), 0),
            min(math.floor((y + radius) / index.cell), rows - 1) + 1,
        ):
            for col in range(
                max(math.floor((x - radius) / index.cell), 0),
                min(math.floor((x + radius) / index.cell), cols - 1) + 1,
            ):
                result[i] = max(result[i], index.top[row, col])
    return result


@njit(cache=True, nogil=True)
def reachable(
    index: Index,
    free: BoolArray,
    x0: float,
    y0: float,
    z0: float,
    spacing: float,
    seeds: IntpArray,
    offsets: IntpArray,
    over_ground: bool,
    radius: float,
    height: float,
    pace: float,
) -> BoolArray:
    """Nodes that moves by the offsets (M, 3: east, north, up) reach untouched from the seeds (S, 3).

    Nodes and seeds are (level, row, col); node 0 lies at (x0, y0) lattice steps and at z0 metres.
    """
    levels, rows, cols = free.shape
    done = np.zeros((levels, rows, cols), np.bool_)
    queue = np.empty((levels * rows * cols, 3), np.intp)
    head = tail = 0
    for i in range(len(seeds)):
        level, row, col = seeds[i, 0], seeds[i, 1], seeds[i, 2]
        inside = 0 <= level < levels and 0 <= row < rows and 0 <= col < cols
        if inside and free[level, row, col] and not done[level, row, col]:
            done[level, row, col] = True
            queue[tail] = seeds[i]
            tail += 1
    while head < tail:
        level, row, col = queue[head, 0], queue[head, 1], queue[head, 2]
        head += 1
        for m in range(len(offsets)):
            k, r, c = level + offsets[m, 2], row + offsets[m, 1], col + offsets[m, 0]
            if not (0 <= k < levels and 0 <= r < rows and 0 <= c < cols):
                continue
            if done[k, r, c] or not free[k, r, c]:
                continue
            ax, ay, az = (x0 + col) * spacing, (y0 + row) * spacing, z0 + level * spacing
            bx, by, bz = (x0 + c) * spacing, (y0 + r) * spacing, z0 + k * spacing
            way = BodyWay(ax, ay, az, bx, by, bz, over_ground)
            if _passes(index, way, radius, height, pace):
                done[k, r, c] = True
                queue[tail, 0], queue[tail, 1], queue[tail, 2] = k, r, c
                tail += 1
    return done


@njit(cache=True, nogil=True)
def unburied(index: Index, triangles: Float64Array, first: IntpArray) -> tuple[Float64Array, IntpArray]:
    """The parts of the patches that lie above the terrain, as triangles; a patch wholly below stays as it is.

    Patch i holds the triangles first[i] to first[i + 1]. Heights above the terrain are taken at the corners
    and count as linear between them.
    """
    kept = np.empty((2 * len(triangles), 3, 3))
    begins = np.zeros_like(first)
    polygon = np.empty((4, 3))
    above = np.empty(3)
    count = 0
    for patch in range(len(first) - 1):
        for i in range(first[patch], first[patch + 1]):
            for k in range(3):
                above[k] = triangles[i, k, 2] - ground(index, triangles[i, k, 0], triangles[i, k, 1])
            sides = 0
            for k in range(3):
                following = (k + 1) % 3
                if above[k] > 0.0:
                    polygon[sides] = triangles[i, k]
                    sides += 1
                if (above[k] > 0.0) != (above[following] > 0.0):
                    part = above[k] / (above[k] - above[following])
                    polygon[sides] = triangles[i, k] + part * (triangles[i, following] - triangles[i, k])
                    sides += 1
            for k in range(2, sides):
                kept[count, 0], kept[count, 1], kept[count, 2] = polygon[0], polygon[k - 1], polygon[k]
                count += 1
        if count == begins[patch]:
            for i in range(first[patch], first[patch + 1]):
                kept[count] = triangles[i]
                count += 1
        begins[patch + 1] = count
    return kept[:count].copy(), begins


@njit(cache=True, nogil=True)
def _last_crossing(triangles: Float64Array, origin: Float64Array, direction: Float64Array) -> float:
    """How far along a line, either way, it last crosses the triangles; 0 where it does not."""
    last = -math.inf
    for triangle in triangles:
        t = _crossing(triangle, origin[0], origin[1], origin[2], direction[0], direction[1], direction[2])
        if t > last:
            last = t
    return last if last > -math.inf else 0.0


@njit(cache=True, nogil=True)
def open_points(
    index: Index,
    triangles: Float64Array,
    first: IntpArray,
    patch: IntpArray,
    centroids: Float64Array,
    directions: Float64Array,
    standoff: float,
    gap: float,
) -> Float64Array:
    """(K, 3) points `standoff` outside the patches (K,), each on the side of its direction (K, 3).

    On the line through the centroid (K, 3), or where something else is within `gap` in front of that, on the
    line through the middle of the nearest triangle where nothing is. Patch i holds the triangles first[i] to
    first[i + 1].
    """
    result = np.empty((len(patch), 3))
    for k in range(len(patch)):
        part = triangles[first[patch[k]] : first[patch[k] + 1]]
        way = directions[k]
        nearest = math.inf
        for i in range(-1, len(part)):
            origin = centroids[k] if i < 0 else (part[i, 0] + part[i, 1] + part[i, 2]) / 3.0
            distance = np.sqrt(((origin - centroids[k]) ** 2).sum())
            if distance >= nearest:
                continue
            p = origin + (_last_crossing(part, origin, way) + standoff) * way
            if i < 0:
                result[k] = p
            q = p + gap * way
            # From outside inwards, so that a point under the terrain counts as covered.
            if not blocked(index, q[0], q[1], q[2], p[0], p[1], p[2]):
                result[k] = p
                nearest = distance
    return result


@njit(cache=True, nogil=True)
def _in_view(sensor: Sensor, dx: float, dy: float, dz: float, c: float, s: float) -> bool:
    """Is a point, relative to the camera in world axes, within reach and in the image? (c, s): heading."""
    if dx * dx + dy * dy > sensor.reach * sensor.reach:
        return False
    ahead, left = c * dx + s * dy, c * dy - s * dx
    R = sensor.rotation
    depth = R[0, 2] * ahead + R[1, 2] * left + R[2, 2] * dz
    if not sensor.min_depth <= depth <= sensor.max_depth:
        return False
    u = sensor.fx * (R[0, 0] * ahead + R[1, 0] * left + R[2, 0] * dz) / depth + sensor.cx
    v = sensor.fy * (R[0, 1] * ahead + R[1, 1] * left + R[2, 1] * dz) / depth + sensor.cy
    return bool(0.0 <= u < sensor.width and 0.0 <= v < sensor.height)


@njit(cache=True, nogil=True)
def seen(
    index: Index,
    sensor: Sensor,
    points: Float64Array,
    owner: IntpArray,
    individuals: int,
    first: IntpArray,
    grid: tuple[float, float, float, int, int],
    poses: Float64Array,
) -> BoolArray:
    """(P, individuals): which have a point in view of a pose (P, 3) with a clear line of sight.

    The points lie in the order of the cells of `grid` (x0, y0, cell, rows, cols), which begin at `first`.
    """
    x0, y0, cell, rows, cols = grid
    result = np.zeros((len(poses), individuals), np.bool_)
    for p in range(len(poses)):
        x, y = poses[p, 0], poses[p, 1]
        z = ground(index, x, y) + sensor.altitude
        c, s = math.cos(poses[p, 2]), math.sin(poses[p, 2])
        row_a = max(math.floor((y - sensor.reach - y0) / cell), 0)
        row_b = min(math.floor((y + sensor.reach - y0) / cell), rows - 1)
        col_a = max(math.floor((x - sensor.reach - x0) / cell), 0)
        col_b = min(math.floor((x + sensor.reach - x0) / cell), cols - 1)
        for row in range(row_a, row_b + 1):
            if col_a > col_b:
                break
            for i in range(first[row * cols + col_a], first[row * cols + col_b + 1]):
                if result[p, owner[i]]:
                    continue
                px, py, pz = points[i, 0], points[i, 1], points[i, 2]
                if _in_view(sensor, px - x, py - y, pz - z, c, s) and not blocked(index, x, y, z, px, py, pz):
                    result[p, owner[i]] = True
    return result


@njit(cache=True, nogil=True)
def seen_from_lattice(
    index: Index,
    sensor: Sensor,
    points: Float64Array,
    owner: IntpArray,
    individuals: int,
    nodes: BoolArray,
    x0: float,
    y0: float,
    spacing: float,
    offsets: IntpArray,
    directions: Float64Array,
) -> BoolArray:
    """Which individuals a lattice pose sees: nodes (rows, cols), headings as directions (H, 2: cos, sin).

    Nodes are tried in the order of the offsets (K, 2: east, north) from the node nearest to the point.
    """
    rows, cols = nodes.shape
    result = np.zeros(individuals, np.bool_)
    for i in range(len(points)):
        if result[owner[i]]:
            continue
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        col0, row0 = round(px / spacing - x0), round(py / spacing - y0)
        for k in range(len(offsets)):
            col, row = col0 + offsets[k, 0], row0 + offsets[k, 1]
            if not (0 <= row < rows and 0 <= col < cols) or not nodes[row, col]:
                continue
            x, y = (x0 + col) * spacing, (y0 + row) * spacing
            z = ground(index, x, y) + sensor.altitude
            in_view = False
            for h in range(len(directions)):
                if _in_view(sensor, px - x, py - y, pz - z, directions[h, 0], directions[h, 1]):
                    in_view = True
                    break
            # The camera turns about its own centre: one line of sight serves all headings.
            if in_view and not blocked(index, x, y, z, px, py, pz):
                result[owner[i]] = True
                break
    return result
