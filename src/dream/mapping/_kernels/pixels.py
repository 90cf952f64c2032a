"""Pixels of a frame to samples: a cell of the window, a label and a height each."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dream.mapping._kernels.flags import GROUND, RAY_MASK, RAYS, UNSURE

SPAN = 128
"""Pixels of a row of which it is asked whether any is far enough, before they are looked at."""
RUN = 512
"""Pixels of a row that are looked at together, at most."""
Y, UP, DEPTH = np.uint64(RUN), np.uint64(2 * RUN), np.uint64(3 * RUN)
"""Where `metric` holds what, behind x."""
TWO, FOUR, EIGHT = np.uint64(2), np.uint64(4), np.uint64(8)
LABEL_BITS = 8
"""A sample is its flat cell, shifted by so many bits, and its label."""
LABEL_MASK = (1 << LABEL_BITS) - 1
EDGE_ON = 0.1
"""Rise of a row's ray below which the row is never left out: a deck at the camera's height, seen edge on, is
a few rows high however near it is."""
GROUND_STEP = 8
"""One sample in so many is enough for the mean height of the seabed."""


# One pass over the rows; what can be is in functions that are vectorised on their own.
@njit(cache=True, nogil=True)
def project(image, view, window, seabed, samples, runs):
    """Window cell and world height of the pixels that count; seabed sums by post; farthest return by ray.

    Of what lies between `cuts[k]` and `cuts[k - 1]` every 2ᵏ-th row and 2ᵏ⁺¹-th column is taken:
    enough to fill a cell. Near the horizon every row is, see `EDGE_ON`.

    Args:
        image: An `Image`.
        view: A `FrameView`.
        window: A `CellWindow`.
        seabed: A `SeabedSamples`, whose sums are added to.
        samples: `Samples`, out.
        runs: `Runs`.

    Returns:
        Number of samples.
    """
    R, t, cuts, farthest = view.rotation, view.translation, view.cuts, samples.farthest
    depth, labels, water = image.depth, image.labels, image.water
    height, width = depth.shape
    f32 = np.float32
    metres, scale = f32(image.unit), f32(image.label_scale)
    size = window.cell
    frame = (f32((t[0] - window.west) / size), f32((t[1] - window.south) / size), f32(t[2]), f32(1.0 / size))
    square_reach = f32(view.reach * view.reach)
    inside = (f32(window.first_row), f32(window.past_row), f32(window.first_col), f32(window.past_col))
    stride = f32(window.side)
    lines, extremes, metric, marks = runs
    columns, farther = lines[: 3 * width].reshape(3, width), lines[3 * width : 6 * width].reshape(3, width)
    pixels, names = depth.ravel(), labels.ravel()
    per_radian = RAYS / (2.0 * math.pi)
    farthest[:] = f32(0.0)
    count = np.uint64(0)
    spans = (width + SPAN - 1) // SPAN
    find_extremes(image.bits, spans, extremes)
    for level in range(len(cuts) + 1):
        step = 1 << level
        across = 2 * step
        spread = max(math.ceil(across * per_radian / view.fx), 5)
        nearest = f32(view.min_depth) if level == len(cuts) else max(cuts[level], f32(view.min_depth))
        most = f32(view.max_depth) if level == 0 else min(cuts[level - 1], f32(view.max_depth))
        n = (width + across - 1) // across
        for k in range(n):
            a = (k * across + 0.5 - view.cx) / view.fx
            for axis in range(3):
                columns[axis, k] = R[axis, 0] * a
        farther[:] = f32(0.0)
        for v in range(height):
            b = (v + 0.5 - view.cy) / view.fy
            if v % step > 0 and abs(R[2, 1] * b + R[2, 2]) > EDGE_ON:
                continue
            ray = (f32(R[0, 1] * b + R[0, 2]), f32(R[1, 1] * b + R[1, 2]), f32(R[2, 1] * b + R[2, 2]))
            span = 0
            while True:
                begin, span = next_run(
                    extremes,
                    v * spans,
                    spans,
                    view.raw[level],
                    view.raw[level + 1],
                    span,
                    RUN * across // SPAN,
                )
                if begin == span:
                    break
                first, run = begin * SPAN // across, min(span * SPAN // across, n) - begin * SPAN // across
                n_run, column, at = np.uint64(run), np.uint64(first), np.uint64(v * width + first * across)
                read_run(pixels, names, at, across, metres, scale, water, nearest, most, n_run, metric, marks)
                lay_out(metric, columns, column, n_run, ray)
                reach_out(metric, farther, column, n_run)
                if place(metric, marks, n_run, frame, square_reach, inside, stride):
                    sum_ground(marks, metric, n_run, image.kind_of, seabed)
                    count = keep(marks, metric, n_run, count, samples)
        for k in range(n):
            square = farther[2, k]
            if square > 0.0:
                bearing = math.atan2(farther[1, k], farther[0, k])
                spread_far(math.floor(bearing * per_radian), spread, math.sqrt(square), farthest)
    return count


@njit(cache=True, nogil=True)
def spread_far(ray, spread, distance, farthest):
    """A ray may run between two columns, or off to a side of where its column looked farthest."""
    for near in range(ray - spread, ray + spread + 1):
        farthest[near & RAY_MASK] = max(farthest[near & RAY_MASK], distance)


# The following loops have no branches and few arrays, so that they are vectorised: `metric` holds `RUN`
# each of x and y over ground from the camera, world z and depth.


@njit(cache=True, nogil=True)
def find_extremes(bits, spans, extremes):
    """The largest of every `SPAN` pixels of a row, and the least but 0, less 1."""
    height, width = bits.shape
    one = bits.dtype.type(1)
    for v in range(height):
        for span in range(width // SPAN):
            most, least = bits[v, span * SPAN], bits.dtype.type(bits[v, span * SPAN] - one)
            for k in range(SPAN):
                pixel = bits[v, span * SPAN + k]
                most, least = max(most, pixel), min(least, bits.dtype.type(pixel - one))
            extremes[0, v * spans + span], extremes[1, v * spans + span] = most, least
        if width % SPAN > 0:
            most = bits[v, width - 1]
            for u in range(width // SPAN * SPAN, width):
                most = max(most, bits[v, u])
            extremes[0, v * spans + spans - 1], extremes[1, v * spans + spans - 1] = most, 0


@njit(cache=True, nogil=True)
def next_run(extremes, row, spans, farthest, nearest, span, most):
    """First and past last of a row's next spans, at most so many, that may have pixels between two depths."""
    while span < spans and (extremes[0, row + span] < nearest or extremes[1, row + span] > farthest):
        span += 1
    begin = span
    past = min(spans, begin + most)
    while span < past and extremes[0, row + span] >= nearest and extremes[1, row + span] <= farthest:
        span += 1
    return begin, span


@njit(cache=True, nogil=True)
def pick(z, label, water, nearest, most):
    """The depth where it counts, else 0: z_min ≤ z < z_max (Eq. 2), and something returned."""
    return z if (z > nearest) & (z <= most) & (label != water) else np.float32(0.0)


@njit(cache=True, nogil=True)
def read_run(pixels, names, at, across, metres, scale, water, nearest, most, n, metric, marks):
    """Depths, 0 where they do not count, and labels of every 2nd, 4th or 8th pixel of a part of a row."""
    # A step that is known when compiling is several times faster.
    if across == 2:
        for k in range(n):
            z = np.float32(pixels[at + TWO * k]) * metres
            metric[DEPTH + k] = pick(z, names[at + TWO * k], water, nearest, most)
            marks[k] = np.int32(np.float32(names[at + TWO * k]) * scale)
    elif across == 4:
        for k in range(n):
            z = np.float32(pixels[at + FOUR * k]) * metres
            metric[DEPTH + k] = pick(z, names[at + FOUR * k], water, nearest, most)
            marks[k] = np.int32(np.float32(names[at + FOUR * k]) * scale)
    else:
        for k in range(n):
            z = np.float32(pixels[at + EIGHT * k]) * metres
            metric[DEPTH + k] = pick(z, names[at + EIGHT * k], water, nearest, most)
            marks[k] = np.int32(np.float32(names[at + EIGHT * k]) * scale)


@njit(cache=True, nogil=True)
def lay_out(metric, columns, first, n, ray):
    """Offsets from the camera in the world, z R K⁻¹ (u, v, 1)ᵀ (Eq. 1): u is in the columns, v in the ray."""
    ray_x, ray_y, ray_z = ray
    for k in range(n):
        z = metric[DEPTH + k]
        metric[k] = z * (columns[0, first + k] + ray_x)
        metric[Y + k] = z * (columns[1, first + k] + ray_y)
        metric[UP + k] = z * (columns[2, first + k] + ray_z)


@njit(cache=True, nogil=True)
def reach_out(metric, farther, first, n):
    """Keep x, y and the squared distance of the farthest return of every column."""
    for k in range(n):
        x, y = metric[k], metric[Y + k]
        square = x * x + y * y
        more = square > farther[2, first + k]
        farther[0, first + k] = x if more else farther[0, first + k]
        farther[1, first + k] = y if more else farther[1, first + k]
        farther[2, first + k] = square if more else farther[2, first + k]


@njit(cache=True, nogil=True)
def place(metric, marks, n, frame, square_reach, inside, stride):
    """Labels to samples, negative where there is none, and offsets to heights; has any a cell?

    A sample is a valid point (Eq. 3) within the reach and in bounds.
    """
    left, bottom, up, per_cell = frame
    first_row, past_row, first_col, past_col = inside
    found = np.int32(-1)
    for k in range(n):
        x, y = metric[k], metric[Y + k]
        near = (x * x + y * y <= square_reach) & (metric[DEPTH + k] > np.float32(0.0))
        col, row = left + x * per_cell, bottom + y * per_cell
        near = near & (row >= first_row) & (row < past_row) & (col >= first_col) & (col < past_col)
        # In float32, which is exact for so few cells: products of whole numbers would be widened to 64 bits.
        cell = np.float32(np.int32(row)) * stride + np.float32(np.int32(col))
        sample = np.int32(cell) if near else np.int32(-1)
        found &= sample
        marks[k] = np.int32((sample << LABEL_BITS) | marks[k])
        metric[UP + k] = up + metric[UP + k]
    return found >= 0


@njit(cache=True, nogil=True)
def keep(marks, metric, n, count, samples):
    """Append those that have a cell; how many there are now."""
    cells, heights = samples.cells, samples.heights
    for k in range(n):
        # Written in any case, since a branch could not be foreseen.
        cells[count], heights[count] = marks[k], metric[UP + k]
        count += np.uint64(marks[k] >= 0)
    return count


@njit(cache=True, nogil=True)
def sum_ground(marks, metric, n, kind_of, seabed):
    """Add some of the seabed's samples to their posts."""
    for k in range(np.uint64(0), n, np.uint64(GROUND_STEP)):
        if marks[k] < 0:
            continue
        kind, height = kind_of[marks[k] & LABEL_MASK], metric[UP + k]
        post = seabed.post_of[marks[k] >> LABEL_BITS]
        if kind == GROUND or (kind == UNSURE and abs(height - seabed.prior[post]) <= seabed.prior_room):
            seabed.total[post] += height
            seabed.points[post] += 1.0
