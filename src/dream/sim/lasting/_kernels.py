"""Compiled loops over the pixels whose labels are wrong again and again."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

Float64Array = npt.NDArray[np.float64]

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
"""Between the states of SplitMix64 (Steele, Lea and Flood, 2014)."""
TWO, THREE, FOUR, FIVE = np.uint64(2), np.uint64(3), np.uint64(4), np.uint64(5)
"""Signed numbers beside unsigned ones would make floats of both."""


class Blobs(NamedTuple):
    """A Boolean model of balls in the world: where they are, how wide, and from which share on they are."""

    key: np.uint64
    """Which of all such models."""
    side: float
    """Metres along a cubic cell; no ball is wider."""
    counts: Float64Array
    """(n,) cumulative probabilities that a cell holds 0, 1, 2, ... middles of balls."""
    least: float
    greatest: float
    """Metres, widths of the balls."""
    densest: float
    """The share of space that all of them cover."""
    sway: float
    """Metres by which space is displaced at most, along each axis."""
    wave: float
    """Metres along the waves by which it is, about."""


@njit(cache=True, nogil=True, error_model="numpy")
def mixed(x):
    """A number of 64 bits of which each depends on all of the argument's (SplitMix64)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@njit(cache=True, nogil=True, error_model="numpy")
def drawn(state):
    """A number in [0, 1) of a state."""
    return np.float64(mixed(state) >> np.uint64(11)) * 2.0**-53


@njit(cache=True, nogil=True, error_model="numpy")
def smooth_wave(t):
    """Two parabolas a period, within ±1: as a sine, but rounded alike by all processors."""
    u = t - math.floor(t) - 0.5
    return 16.0 * u * (0.5 - abs(u))


@njit(cache=True, nogil=True, error_model="numpy")
def many_of(blobs, kind, x, y, z):
    """How many balls have their middle in a cell, and the state that they are drawn from."""
    state = blobs.key + np.uint64(kind)
    state = mixed(state + np.uint64(x) + GOLDEN)
    state = mixed(state + np.uint64(y) + GOLDEN)
    state = mixed(state + np.uint64(z) + GOLDEN) + GOLDEN
    u, count = drawn(state), 0
    while count < len(blobs.counts) and u >= blobs.counts[count]:
        count += 1
    return count, state


@njit(cache=True, nogil=True, error_model="numpy")
def balls_of(blobs, kind, x, y, z, out, at):
    """Middle, squared radius and share of each ball of a cell, into rows of `out` from `at` on; how many."""
    count, state = many_of(blobs, kind, x, y, z)
    for k in range(at, at + count):
        out[k, 0] = (x + drawn(state + GOLDEN)) * blobs.side
        out[k, 1] = (y + drawn(state + TWO * GOLDEN)) * blobs.side
        out[k, 2] = (z + drawn(state + THREE * GOLDEN)) * blobs.side
        radius = 0.5 * (blobs.least + (blobs.greatest - blobs.least) * drawn(state + FOUR * GOLDEN))
        out[k, 3] = radius * radius
        state += FIVE * GOLDEN
        # Libraries differ in the last digits of a power.
        out[k, 4] = round((1.0 - (1.0 - blobs.densest) ** drawn(state)) * 1e9) * 1e-9
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def gather(blobs, kinds, low, shape):
    """The balls that touch each cell of a box, for each kind of surface.

    Args:
        blobs: `Blobs`.
        kinds: How many models there are.
        low: (3,) the box's first cell.
        shape: (3,) its cells.

    Returns:
        first: (kinds * cells + 1,) and members: (m,), which index balls: (n, 5), see `balls_of`. Cells are
        counted kind by kind, x by x, y by y.
    """
    nx, ny, nz = shape
    cells = nx * ny * nz
    room = 0
    for kind in range(kinds):
        for i in range(-1, nx + 1):
            for j in range(-1, ny + 1):
                for k in range(-1, nz + 1):
                    room += many_of(blobs, kind, low[0] + i, low[1] + j, low[2] + k)[0]
    balls = np.empty((room, 5))
    kind_of = np.empty(room, np.int64)
    n = 0
    for kind in range(kinds):
        for i in range(-1, nx + 1):
            for j in range(-1, ny + 1):
                for k in range(-1, nz + 1):
                    count = balls_of(blobs, kind, low[0] + i, low[1] + j, low[2] + k, balls, n)
                    for b in range(n, n + count):
                        kind_of[b] = kind
                    n += count
    # How many each cell has, then where they begin, then which they are.
    first = np.zeros(kinds * cells + 1, np.int64)
    for b in range(n):
        box = touched(balls[b], blobs.side, low, shape)
        for i in range(box[0], box[1]):
            for j in range(box[2], box[3]):
                for k in range(box[4], box[5]):
                    first[((kind_of[b] * nx + i) * ny + j) * nz + k] += 1
    total = 0
    for c in range(kinds * cells + 1):
        total += first[c]
        first[c] = total
    members = np.empty(total, np.int64)
    # From behind: each cell's end moves to its beginning.
    for b in range(n):
        box = touched(balls[b], blobs.side, low, shape)
        for i in range(box[0], box[1]):
            for j in range(box[2], box[3]):
                for k in range(box[4], box[5]):
                    c = ((kind_of[b] * nx + i) * ny + j) * nz + k
                    first[c] -= 1
                    members[first[c]] = b
    return first, members, balls


@njit(cache=True, nogil=True, error_model="numpy")
def touched(ball, side, low, shape):
    """First and past last cell of a box that a ball touches, along x, y and z."""
    radius = math.sqrt(ball[3])
    return (
        max(math.floor((ball[0] - radius) / side) - low[0], 0),
        min(math.floor((ball[0] + radius) / side) - low[0] + 1, shape[0]),
        max(math.floor((ball[1] - radius) / side) - low[1], 0),
        min(math.floor((ball[1] + radius) / side) - low[1] + 1, shape[1]),
        max(math.floor((ball[2] - radius) / side) - low[2], 0),
        min(math.floor((ball[2] + radius) / side) - low[2] + 1, shape[2]),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def displaced(x, y, z, blobs):
    """A point of the world where blobs are balls: each axis is displaced by a wave along the two others."""
    per_metre = 1.0 / blobs.wave
    x += blobs.sway * smooth_wave((0.93 * y + 0.67 * z) * per_metre)
    y += blobs.sway * smooth_wave((1.12 * x - 0.81 * z) * per_metre)
    z += blobs.sway * smooth_wave((0.74 * x + 0.98 * y) * per_metre)
    return x, y, z


@njit(cache=True, nogil=True, error_model="numpy")
def share_at(metres, distances, shares):
    """Straight between two of the distances; as at the first one before it, as at the last one beyond."""
    if metres <= distances[0]:
        return shares[0]
    for k in range(1, len(distances)):
        if metres <= distances[k]:
            along = (metres - distances[k - 1]) / (distances[k] - distances[k - 1])
            return shares[k - 1] + along * (shares[k] - shares[k - 1])
    return shares[-1]


@njit(cache=True, nogil=True, error_model="numpy")
def mislabel(labels, ids, depth, rotation, camera, focal, distances, shares, blobs, water, target, missed_as):
    """Write what a sensor that errs in blobs takes each pixel for.

    Args:
        labels: (H, W) uint8, changed.
        ids: (H, W) which individual a pixel shows, −1 for none.
        depth: (H, W) float32 metres along the optical axis; NaN where there is no return.
        rotation: (3, 3) of `T_world_camera`.
        camera: (3,) its translation.
        focal: fx, fy, cx, cy.
        distances: (n,) rising metres straight from the camera.
        shares: (n,) of the surface there whose label is wrong.
        blobs: `Blobs`.
        water: Label of pixels without a return.
        target: Label of individuals.
        missed_as: (N,) label of each individual that is taken for what it is not.
    """
    height, width = depth.shape
    fx, fy, cx, cy = focal
    points = np.empty((height * width, 4), np.float64)
    x_low, y_low, z_low, x_high, y_high, z_high = np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf
    for v in range(height):
        b = (v + 0.5 - cy) / fy
        for u in range(width):
            z = depth[v, u]
            p = v * width + u
            points[p, 3] = 0.0
            if labels[v, u] == water or not z > 0.0:
                continue
            a = (u + 0.5 - cx) / fx
            x = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2]
            y = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2]
            h = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2]
            points[p, 3] = share_at(z * math.sqrt(a * a + b * b + 1.0), distances, shares)
            x, y, h = displaced(camera[0] + x * z, camera[1] + y * z, camera[2] + h * z, blobs)
            points[p, 0], points[p, 1], points[p, 2] = x, y, h
            x_low, y_low, z_low = min(x_low, x), min(y_low, y), min(z_low, h)
            x_high, y_high, z_high = max(x_high, x), max(y_high, y), max(z_high, h)
    if x_low > x_high:
        return
    per_metre = 1.0 / blobs.side
    i_low, j_low, k_low = (
        math.floor(x_low * per_metre),
        math.floor(y_low * per_metre),
        math.floor(z_low * per_metre),
    )
    nx = math.floor(x_high * per_metre) - i_low + 1
    ny = math.floor(y_high * per_metre) - j_low + 1
    nz = math.floor(z_high * per_metre) - k_low + 1
    first, members, balls = gather(blobs, 2, (i_low, j_low, k_low), (nx, ny, nz))
    for v in range(height):
        for u in range(width):
            p = v * width + u
            share = points[p, 3]
            if share == 0.0:
                continue
            x, y, z = points[p, 0], points[p, 1], points[p, 2]
            is_target = labels[v, u] == target
            i = math.floor(x * per_metre) - i_low
            j = math.floor(y * per_metre) - j_low
            k = math.floor(z * per_metre) - k_low
            c = ((np.int64(is_target) * nx + i) * ny + j) * nz + k
            for m in range(first[c], first[c + 1]):
                ball = members[m]
                if balls[ball, 4] >= share:
                    continue
                dx, dy, dz = x - balls[ball, 0], y - balls[ball, 1], z - balls[ball, 2]
                if dx * dx + dy * dy + dz * dz < balls[ball, 3]:
                    labels[v, u] = missed_as[ids[v, u]] if is_target else target
                    break
