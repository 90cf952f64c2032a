"""Kernels of what a frame inspects.

As everywhere in the simulator, an eye sees past terrain and triangles: `solids` holds what blocks motion and
sight, `clumps` what blocks sight alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.sim._kernels import NOTHING, Index, between, blocked, blocker

Float64Array = npt.NDArray[np.float64]
IntpArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]
UInt8Array = npt.NDArray[np.uint8]
Int32Array = npt.NDArray[np.int32]
UInt64Array = npt.NDArray[np.uint64]

SEEN, INSPECTED = 1, 2
"""What comes of a point; 0 where it does not show."""


class Points(NamedTuple):
    """Points on the surface of individuals, one individual after the other."""

    at: Float64Array
    """(M, 3) metres in the world."""
    normal: Float64Array
    """(M, 3) of length 1."""
    both: BoolArray
    """(M,) on a surface that has two sides."""
    first: IntpArray
    """(N + 1,) individual i has the points first[i] to first[i + 1]."""
    needed: IntpArray
    """(N,) an individual is inspected when so many of its points are, in one frame."""


class Optics(NamedTuple):
    """Camera and rule of a protocol."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: float
    height: float
    min_depth: float
    max_depth: float
    reach: float
    """Straight through the water."""
    cosine: float
    """Of the greatest incidence."""


@njit(cache=True, nogil=True)
def are_open(
    solids: Index, clumps: Index, at: Float64Array, ways: Float64Array, gap: float, enough: int
) -> BoolArray:
    """Which of the places (C, 3) have nothing within `gap` along enough of their ways (C, W, 3)?"""
    result = np.zeros(len(at), np.bool_)
    for i in range(len(at)):
        x, y, z = at[i, 0], at[i, 1], at[i, 2]
        count = 0
        for k in range(ways.shape[1]):
            if count + ways.shape[1] - k < enough:
                break
            # From outside inwards, so that the surface that the place is on does not count.
            ex, ey, ez = x + gap * ways[i, k, 0], y + gap * ways[i, k, 1], z + gap * ways[i, k, 2]
            if blocked(solids, ex, ey, ez, x, y, z) or blocked(clumps, ex, ey, ez, x, y, z):
                continue
            count += 1
            if count == enough:
                result[i] = True
                break
    return result


@njit(cache=True, nogil=True)
def _in_frame(optics: Optics, rotation: Float64Array, eye: Float64Array, point: Float64Array) -> bool:
    """Is the point within reach and in the image? The rotation is that of `T_world_camera`."""
    dx, dy, dz = point[0] - eye[0], point[1] - eye[1], point[2] - eye[2]
    if dx * dx + dy * dy + dz * dz > optics.reach * optics.reach:
        return False
    depth = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
    if not optics.min_depth <= depth <= optics.max_depth:
        return False
    right = rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz
    down = rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz
    u, v = optics.fx * right / depth + optics.cx, optics.fy * down / depth + optics.cy
    return bool(0.0 <= u < optics.width and 0.0 <= v < optics.height)


@njit(cache=True, nogil=True)
def _facing(points: Points, i: int, eye: Float64Array) -> float:
    """Cosine of the incidence at point i; below 0 from behind a surface that has one side."""
    dx, dy, dz = eye[0] - points.at[i, 0], eye[1] - points.at[i, 1], eye[2] - points.at[i, 2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    if length == 0.0:
        return -1.0
    cosine = (points.normal[i, 0] * dx + points.normal[i, 1] * dy + points.normal[i, 2] * dz) / length
    return float(abs(cosine) if points.both[i] else cosine)


@njit(cache=True, nogil=True)
def _hidden(solids: Index, clumps: Index, eye: Float64Array, point: Float64Array, last: IntpArray) -> bool:
    """Does anything lie between them?

    What hid the point before, `last` (2: a triangle of the solids and one of the clumps), is tried first: it
    often hides the next one, too.
    """
    ex, ey, ez, px, py, pz = eye[0], eye[1], eye[2], point[0], point[1], point[2]
    if last[0] >= 0 and between(solids.triangles[last[0]], ex, ey, ez, px, py, pz):
        return True
    if last[1] >= 0 and between(clumps.triangles[last[1]], ex, ey, ez, px, py, pz):
        return True
    found = blocker(solids, ex, ey, ez, px, py, pz)
    if found != NOTHING:
        last[0] = found
        return True
    found = blocker(clumps, ex, ey, ez, px, py, pz)
    if found != NOTHING:
        last[1] = found
        return True
    return False


@njit(cache=True, nogil=True)
def look(
    solids: Index, clumps: Index, points: Points, optics: Optics, rotation: Float64Array, eye: Float64Array
) -> UInt8Array:
    """What a frame makes of each point (M,): 0, SEEN or, at a good angle, INSPECTED."""
    result = np.zeros(len(points.at), np.uint8)
    last = np.full(2, -1)
    for i in range(len(points.at)):
        if not _in_frame(optics, rotation, eye, points.at[i]):
            continue
        cosine = _facing(points, i, eye)
        if cosine > 0.0 and not _hidden(solids, clumps, eye, points.at[i], last):
            result[i] = INSPECTED if cosine >= optics.cosine else SEEN
    return result


@njit(cache=True, nogil=True)
def _inspects(
    solids: Index,
    clumps: Index,
    points: Points,
    individual: int,
    optics: Optics,
    rotation: Float64Array,
    eye: Float64Array,
    last: IntpArray,
) -> bool:
    """Does a frame inspect the individual? As `look`, but it ends at what decides."""
    first, end, needed = points.first[individual], points.first[individual + 1], points.needed[individual]
    might = 0
    for i in range(first, end):
        if _facing(points, i, eye) >= optics.cosine and _in_frame(optics, rotation, eye, points.at[i]):
            might += 1
    done = 0
    for i in range(first, end):
        if done >= needed or done + might < needed:
            break
        if _facing(points, i, eye) >= optics.cosine and _in_frame(optics, rotation, eye, points.at[i]):
            might -= 1
            if not _hidden(solids, clumps, eye, points.at[i], last):
                done += 1
    return bool(done >= needed)


@njit(cache=True, nogil=True)
def inspectable(
    solids: Index,
    clumps: Index,
    points: Points,
    optics: Optics,
    nodes: BoolArray,
    origin: tuple[int, int, int],
    spacing: float,
    offsets: IntpArray,
    rotations: Float64Array,
    tilts: Float64Array,
    share: float,
    least: int,
) -> BoolArray:
    """(N,) individuals that enough of the nodes (levels, rows, cols) within reach of their middle inspect.

    Enough is `share` of them and at least `least`. At a node the camera looks along the heading nearest to
    the middle, with the tilt nearest to it, of the rotations (headings, tilts, 3, 3). Nodes are tried in the
    order of the offsets (K, 3: east, north, up) from the node nearest to the middle.
    """
    levels, rows, cols = nodes.shape
    individuals = len(points.needed)
    headings = len(rotations)
    result = np.zeros(individuals, np.bool_)
    last = np.full(2, -1)
    eye = np.empty(3)
    near = np.empty(len(offsets), np.intp)
    for n in range(individuals):
        first, end = points.first[n], points.first[n + 1]
        mx = points.at[first:end, 0].mean()
        my = points.at[first:end, 1].mean()
        mz = points.at[first:end, 2].mean()
        col0, row0 = round(mx / spacing) - origin[0], round(my / spacing) - origin[1]
        level0 = round(mz / spacing) - origin[2]
        count = 0
        for k in range(len(offsets)):
            col, row, level = col0 + offsets[k, 0], row0 + offsets[k, 1], level0 + offsets[k, 2]
            if not (0 <= level < levels and 0 <= row < rows and 0 <= col < cols):
                continue
            if not nodes[level, row, col]:
                continue
            dx, dy = mx - (origin[0] + col) * spacing, my - (origin[1] + row) * spacing
            dz = mz - (origin[2] + level) * spacing
            if dx * dx + dy * dy + dz * dz <= optics.reach * optics.reach:
                near[count] = k
                count += 1
        enough = max(math.ceil(share * count), least)
        found, left = 0, count
        for i in range(count):
            if found >= enough or found + left < enough:
                break
            left -= 1
            k = near[i]
            eye[0] = (origin[0] + col0 + offsets[k, 0]) * spacing
            eye[1] = (origin[1] + row0 + offsets[k, 1]) * spacing
            eye[2] = (origin[2] + level0 + offsets[k, 2]) * spacing
            dx, dy, dz = mx - eye[0], my - eye[1], mz - eye[2]
            heading = round(math.atan2(dy, dx) / (2.0 * math.pi) * headings) % headings
            down = math.atan2(-dz, math.hypot(dx, dy))
            tilt = np.abs(tilts - down).argmin()
            if _inspects(solids, clumps, points, n, optics, rotations[heading, tilt], eye, last):
                found += 1
        result[n] = found >= enough
    return result


@njit(cache=True, nogil=True)
def shown_from(
    solids: Index,
    clumps: Index,
    points: Points,
    optics: Optics,
    wanted: IntpArray,
    middles: Float64Array,
    radii: Float64Array,
    eyes: Float64Array,
    rotations: Float64Array,
) -> tuple[IntpArray, Int32Array, UInt64Array]:
    """Which frames from each of the eyes (E, 3) inspect which of the individuals `wanted` (R,)?

    What has range, angle and a clear line is found once for an eye, whichever way the camera looks. All
    points of individual `wanted[r]` lie within `radii[r]` of `middles[r]`.

    Returns:
        first: (E + 1,) the entries of eye e are first[e] to first[e + 1].
        who: (K,) index into `wanted`.
        frames: (K,) bit f is set where the frame with rotations[f], of at most 64, inspects it.
    """
    first = np.zeros(len(eyes) + 1, np.intp)
    who = np.empty(1024, np.int32)
    frames = np.empty(1024, np.uint64)
    last = np.full(2, -1)
    count = 0
    tally = np.empty(len(rotations), np.intp)
    clear = np.empty(np.diff(points.first).max() if len(wanted) else 0, np.intp)
    for e in range(len(eyes)):
        eye = eyes[e]
        for r in range(len(wanted)):
            dx, dy, dz = middles[r, 0] - eye[0], middles[r, 1] - eye[1], middles[r, 2] - eye[2]
            far = optics.reach + radii[r]
            if dx * dx + dy * dy + dz * dz > far * far:
                continue
            n = wanted[r]
            might = 0
            for i in range(points.first[n], points.first[n + 1]):
                might += _facing(points, i, eye) >= optics.cosine
            open_points = 0
            for i in range(points.first[n], points.first[n + 1]):
                if open_points + might < points.needed[n]:
                    break
                if _facing(points, i, eye) >= optics.cosine:
                    might -= 1
                    if not _hidden(solids, clumps, eye, points.at[i], last):
                        clear[open_points] = i
                        open_points += 1
            if open_points < points.needed[n]:
                continue
            tally[:] = 0
            for k in range(open_points):
                for f in range(len(rotations)):
                    tally[f] += _in_frame(optics, rotations[f], eye, points.at[clear[k]])
            bits = np.uint64(0)
            for f in range(len(rotations)):
                if tally[f] >= points.needed[n]:
                    bits |= np.uint64(1) << np.uint64(f)
            if bits == 0:
                continue
            if count == len(who):
                who = np.concatenate((who, np.empty_like(who)))
                frames = np.concatenate((frames, np.empty_like(frames)))
            who[count], frames[count] = r, bits
            count += 1
        first[e + 1] = count
    return first, who[:count].copy(), frames[:count].copy()
