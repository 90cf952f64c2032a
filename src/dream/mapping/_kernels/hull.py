"""Voxels of a hull: what returns mark, what rays carve, what is left to see, and from where.

Grids are (levels, rows, cols); level grows with z, row with y, col with x.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.geometry import FloatArray

FREE, HULL, SEEN, OTHER, VAGUE = 1, 2, 4, 8, 16
"""Bits of a voxel: a ray passed through; the target returned from it, and did so within reach; something else
returned from it; the target did from beyond reach, by a depth that scatters."""
BLOCK = 2
"""Voxels along a block: what is left in a block is one element of each kind."""
SURFACE, EDGE = 0, 1
"""Kinds of elements: hull that was only seen from beyond reach; unknown voxels into which hull may go on."""
POST = 16
"""Voxels along a post of the seabed."""
PARTS = 4
"""Along a voxel: of each part of it, of 64, is known whether something solid is there."""
BEARINGS, RANGES = 16, 4
"""Sides from which an element is looked at, 64 in all: 22.5° of bearings by a quarter of the reach."""


class HullVoxels(NamedTuple):
    """What returns and rays have shown, voxel by voxel. The arrays are written in place."""

    voxels: npt.NDArray[np.uint8]
    """(levels, rows, cols) bits."""
    solid: npt.NDArray[np.uint64]
    """(levels, rows, cols) a bit for each part that something returned from."""
    near: npt.NDArray[np.uint8]
    """Grid of blocks: does hull lie in or beside the block?"""
    posts: FloatArray
    """(2, n, m) sum of the heights of the seabed's returns, metres in the world, and their number."""
    box: npt.NDArray[np.int64]
    """(6,) first level, row and column of the hull, and past the last."""
    corner: FloatArray
    """(3,) x, y and z of the grid's low corner, metres in the world."""
    side: float
    """Metres along a voxel."""


class CameraPlace(NamedTuple):
    """Where a frame was taken, and by what camera."""

    rotation: FloatArray
    """(3, 3) of `T_world_camera`."""
    place: FloatArray
    """(3,) metres in the world."""
    lens: tuple[float, float, float, float]
    """fx, fy, cx and cy in pixels."""
    limits: tuple[float, float]
    """Least and greatest valid depth, metres."""


class LevelCamera(NamedTuple):
    """The camera of a level vehicle, wherever it is and heads."""

    pitch: tuple[float, float]
    """Cosine and sine of the angle that it looks down by."""
    lens: tuple[float, float, float, float]
    """fx, fy, cx and cy in pixels."""
    size: tuple[int, int]
    """Width and height of the image in pixels."""
    limits: tuple[float, float]
    """Least and greatest valid depth, metres."""
    reach: float
    """Metres over ground."""


def empty_volume(shape: tuple[int, int, int], corner: FloatArray, side: float) -> HullVoxels:
    """Nothing is known yet.

    Args:
        shape: At least so many levels, rows and columns; made up to whole blocks.
        corner: (3,) x, y and z of the grid's low corner, metres in the world; kept, not copied.
        side: Metres along a voxel.
    """
    levels, rows, cols = (-(-n // BLOCK) * BLOCK for n in shape)
    return HullVoxels(
        np.zeros((levels, rows, cols), np.uint8),
        np.zeros((levels, rows, cols), np.uint64),
        np.zeros((levels // BLOCK, rows // BLOCK, cols // BLOCK), np.uint8),
        np.zeros((2, -(-rows // POST), -(-cols // POST))),
        np.array([levels, rows, cols, 0, 0, 0], np.int64),
        corner,
        side,
    )


@njit(cache=True, nogil=True)
def _part(x, y, z):
    """The bit, of a voxel's 64, of the part that a point lies in; in voxels."""
    up, north = int(PARTS * (z - math.floor(z))), int(PARTS * (y - math.floor(y)))
    east = int(PARTS * (x - math.floor(x)))
    return np.uint64(1) << np.uint64((up * PARTS + north) * PARTS + east)


@njit(cache=True, nogil=True)
def _turned(rotation, a, b, z):
    """From the camera to the point of a ray (a, b, 1) at depth z, metres along the axes of the world."""
    return (
        (rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2]) * z,
        (rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2]) * z,
        (rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2]) * z,
    )


@njit(cache=True, nogil=True)
def mark(volume, depth, labels, target, seabed, viewpoint, reach, far):
    """Mark the voxels that the returns of a frame fall into.

    Args:
        volume: Changed.
        depth: (H, W) float32 metres along the optical axis; NaN where there is no return.
        labels: (H, W) uint8.
        target: Label of the hull.
        seabed: Label of the seabed.
        viewpoint: Of the frame.
        reach: Metres over ground within which a return counts as seen.
        far: Bits of a voxel from which the target returned from beyond reach.

    Returns:
        How many voxels were seen for the first time.
    """
    voxels, solid, near, posts, box, corner, side = volume
    rotation, camera, (fx, fy, cx, cy), limits = viewpoint
    levels, rows, cols = voxels.shape
    new = 0
    for i in range(depth.shape[0]):
        b = (i + 0.5 - cy) / fy
        for j in range(depth.shape[1]):
            z = depth[i, j]
            if not (limits[0] <= z <= limits[1]):
                continue
            a = (j + 0.5 - cx) / fx
            dx, dy, dz = _turned(rotation, a, b, z)
            x = (camera[0] + dx - corner[0]) / side
            y = (camera[1] + dy - corner[1]) / side
            h = (camera[2] + dz - corner[2]) / side
            col, row, level = math.floor(x), math.floor(y), math.floor(h)
            # Elements have neighbours on all sides.
            if not (0 < level < levels - 1 and 0 < row < rows - 1 and 0 < col < cols - 1):
                continue
            solid[level, row, col] |= _part(x, y, h)
            if labels[i, j] == target:
                bits = HULL | SEEN if dx * dx + dy * dy <= reach * reach else far
                new += (bits & ~voxels[level, row, col] & SEEN) != 0
                if not voxels[level, row, col] & HULL:
                    for v in range((level - 1) // BLOCK, (level + 1) // BLOCK + 1):
                        for r in range((row - 1) // BLOCK, (row + 1) // BLOCK + 1):
                            for c in range((col - 1) // BLOCK, (col + 1) // BLOCK + 1):
                                near[v, r, c] = 1
                voxels[level, row, col] |= bits
                box[0], box[3] = min(box[0], level), max(box[3], level + 1)
                box[1], box[4] = min(box[1], row), max(box[4], row + 1)
                box[2], box[5] = min(box[2], col), max(box[5], col + 1)
            else:
                voxels[level, row, col] |= OTHER
                if labels[i, j] == seabed:
                    posts[0, row // POST, col // POST] += camera[2] + dz
                    posts[1, row // POST, col // POST] += 1.0
    return new


@njit(cache=True, nogil=True)
def fill(volume, depth, labels, seabed, viewpoint, steepest):
    """Mark what is solid between the returns of neighbouring pixels, so that no ray slips through a surface.

    Args:
        steepest: How many pixels' widths the four depths around may differ by and still be of one surface.

    The other arguments are those of `mark`.
    """
    solid, corner, side = volume.solid, volume.corner, volume.side
    rotation, camera, (fx, fy, cx, cy), limits = viewpoint
    levels, rows, cols = solid.shape
    for i in range(depth.shape[0] - 1):
        for j in range(depth.shape[1] - 1):
            if labels[i, j] == seabed:
                continue
            corners = depth[i, j], depth[i, j + 1], depth[i + 1, j], depth[i + 1, j + 1]
            nearest, farthest = np.inf, 0.0
            for z in corners:
                nearest, farthest = min(nearest, z), max(farthest, z)
                if not (limits[0] <= z <= limits[1]):
                    farthest = np.inf
            width = farthest / fx
            if not (farthest - nearest <= steepest * width) or width == np.inf:
                continue
            count = math.ceil(width / side * PARTS)
            for m in range(count):
                s = m / count
                b = (i + 0.5 + s - cy) / fy
                for n in range(count):
                    t = n / count
                    z = (1 - s) * ((1 - t) * corners[0] + t * corners[1])
                    z += s * ((1 - t) * corners[2] + t * corners[3])
                    a = (j + 0.5 + t - cx) / fx
                    dx, dy, dz = _turned(rotation, a, b, z)
                    x = (camera[0] + dx - corner[0]) / side
                    y = (camera[1] + dy - corner[1]) / side
                    h = (camera[2] + dz - corner[2]) / side
                    if 0.0 <= h < levels and 0.0 <= y < rows and 0.0 <= x < cols:
                        solid[int(h), int(y), int(x)] |= _part(x, y, h)


@njit(cache=True, nogil=True)
def carve(volume, depth, viewpoint, farthest, slack):
    """Mark as free every voxel whose middle is in the image and nearer than what returns there.

    Args:
        farthest: Metres along the optical axis up to which it is done, and up to which all is free where
            nothing returns.
        slack: Metres that a middle must be nearer than the return: a voxel that a surface cuts is not free.

    The other arguments are those of `mark`.
    """
    voxels, corner, side = volume.voxels, volume.corner, volume.side
    rotation, camera, (fx, fy, cx, cy), _ = viewpoint
    levels, rows, cols = voxels.shape
    height, width = depth.shape
    # The box around the view: the camera and the corners of the image at the farthest depth.
    low, high = camera.copy(), camera.copy()
    for u in (0.0, float(width)):
        for v in (0.0, float(height)):
            a, b = (u - cx) / fx, (v - cy) / fy
            for k in range(3):
                at = camera[k] + (rotation[k, 0] * a + rotation[k, 1] * b + rotation[k, 2]) * farthest
                low[k], high[k] = min(low[k], at), max(high[k], at)
    first, past = np.empty(3, np.int64), np.empty(3, np.int64)
    for k, size in enumerate((cols, rows, levels)):
        first[k] = max(math.floor((low[k] - corner[k]) / side), 0)
        past[k] = min(math.floor((high[k] - corner[k]) / side) + 1, size)
    for level in range(first[2], past[2]):
        dz = corner[2] + (level + 0.5) * side - camera[2]
        for row in range(first[1], past[1]):
            dy = corner[1] + (row + 0.5) * side - camera[1]
            for col in range(first[0], past[0]):
                if voxels[level, row, col] & FREE:
                    continue
                dx = corner[0] + (col + 0.5) * side - camera[0]
                z = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
                if not (0.0 < z <= farthest):
                    continue
                u = fx * (rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz) / z + cx
                v = fy * (rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz) / z + cy
                if not (0.0 <= u < width and 0.0 <= v < height):
                    continue
                # Not `>=`: where nothing returns, the depth is NaN.
                if not depth[int(v), int(u)] < z + slack:
                    voxels[level, row, col] |= FREE


@njit(cache=True, nogil=True)
def _is_hull(bits):
    """Did the target return from a voxel? Not where it only seemed so from afar and a ray passed through."""
    return bits & HULL and (bits & SEEN or not (bits & VAGUE and bits & FREE))


@njit(cache=True, nogil=True)
def _kind(voxels, level, row, col):
    """Of what kind of element a voxel is, -1 if of none."""
    bits = voxels[level, row, col]
    if _is_hull(bits):
        return -1 if bits & SEEN else SURFACE
    if bits:
        return -1
    # Free alone: looks along a surface carve voxels that it cuts.
    if not (
        voxels[level + 1, row, col] == FREE
        or voxels[level - 1, row, col] == FREE
        or voxels[level, row + 1, col] == FREE
        or voxels[level, row - 1, col] == FREE
        or voxels[level, row, col + 1] == FREE
        or voxels[level, row, col - 1] == FREE
    ):
        return -1
    for i in range(-1, 2):
        for j in range(-1, 2):
            for k in range(-1, 2):
                if _is_hull(voxels[level + i, row + j, col + k]):
                    return EDGE
    return -1


@njit(cache=True, nogil=True)
def _towards_free(voxels, level, row, col):
    """From a voxel's middle to its faces with free water, in voxels: their mean."""
    up = 1.0 * (voxels[level + 1, row, col] == FREE) - (voxels[level - 1, row, col] == FREE)
    north = 1.0 * (voxels[level, row + 1, col] == FREE) - (voxels[level, row - 1, col] == FREE)
    east = 1.0 * (voxels[level, row, col + 1] == FREE) - (voxels[level, row, col - 1] == FREE)
    return 0.5 * up, 0.5 * north, 0.5 * east


# One walk over the blocks: what it gathers of a block would be six arguments of any part of it.
@njit(cache=True, nogil=True)
def list_elements(voxels, near, looks, worth, box, lowest, highest):
    """What is left to see, block by block.

    Args:
        voxels: Grid of uint8 bits.
        near: Grid of blocks, uint8: does hull lie in or beside the block?
        looks: Grid of uint8: how often a voxel failed to show.
        worth: (2, n) of a voxel, by its kind and how often it failed to show; nothing after that.
        box: (6,) first level, row and column of blocks, and past the last.
        lowest: (box's rows, box's cols) level of the lowest voxels that count.
        highest: Likewise, past the highest.

    Returns:
        elements: (n, 4) int32 level, row and column of the block, and kind.
        middles: (n, 3) float64 level, row and column of the point that stands for it, in voxels: where the
            voxel nearest to the mean meets free water. What must be seen is where the unknown begins.
        weights: (n,) float64.
    """
    elements = np.empty((1024, 4), np.int32)
    middles = np.empty((1024, 3))
    weights = np.empty(1024)
    members = np.empty((2, BLOCK**3, 3), np.int64)
    number, total, sums = np.zeros(2, np.int64), np.zeros(2), np.zeros(3, np.int64)
    most = worth.shape[1]
    count = 0
    levels, rows, cols = voxels.shape
    for level in range(box[0], box[3]):
        for row in range(box[1], box[4]):
            for col in range(box[2], box[5]):
                if not near[level, row, col]:
                    continue
                number[:] = 0
                total[:] = 0.0
                low, high = lowest[row - box[1], col - box[2]], highest[row - box[1], col - box[2]]
                for h in range(max(level * BLOCK, low, 1), min((level + 1) * BLOCK, high, levels - 1)):
                    for r in range(max(row * BLOCK, 1), min((row + 1) * BLOCK, rows - 1)):
                        for c in range(max(col * BLOCK, 1), min((col + 1) * BLOCK, cols - 1)):
                            kind = _kind(voxels, h, r, c)
                            if kind < 0 or looks[h, r, c] >= most or worth[kind, looks[h, r, c]] <= 0.0:
                                continue
                            members[kind, number[kind]] = h, r, c
                            number[kind] += 1
                            total[kind] += worth[kind, looks[h, r, c]]
                for kind in range(2):
                    n = number[kind]
                    if n == 0:
                        continue
                    if count == len(elements):
                        elements = np.concatenate((elements, np.empty_like(elements)))
                        middles = np.concatenate((middles, np.empty_like(middles)))
                        weights = np.concatenate((weights, np.empty_like(weights)))
                    elements[count] = level, row, col, kind
                    weights[count] = total[kind]
                    sums[:] = 0
                    for m in range(n):
                        for axis in range(3):
                            sums[axis] += members[kind, m, axis]
                    nearest = np.iinfo(np.int64).max
                    for m in range(n):
                        away = 0
                        for axis in range(3):
                            away += (n * members[kind, m, axis] - sums[axis]) ** 2
                        if away < nearest:
                            nearest = away
                            h, r, c = members[kind, m]
                            up, north, east = _towards_free(voxels, h, r, c)
                            middles[count] = h + 0.5 + up, r + 0.5 + north, c + 0.5 + east
                    count += 1
    return elements[:count].copy(), middles[:count].copy(), weights[:count].copy()


@njit(cache=True, nogil=True)
def _side(dx, dy, reach):
    """The bit of the side that an element is looked at from; dx, dy from the camera to it, metres."""
    bearing = int((math.atan2(dy, dx) / (2.0 * math.pi) + 1.0) * BEARINGS) % BEARINGS
    away = min(int(math.sqrt(dx * dx + dy * dy) / reach * RANGES), RANGES - 1)
    return np.uint64(1) << np.uint64(bearing * RANGES + away)


@njit(cache=True, nogil=True)
def sides(middles, camera, reach):
    """(n,) uint64, the bit of the side that each element is looked at from by a camera (3,)."""
    bits = np.empty(len(middles), np.uint64)
    for e in range(len(middles)):
        bits[e] = _side(middles[e, 0] - camera[0], middles[e, 1] - camera[1], reach)
    return bits


@njit(cache=True, nogil=True)
def doubt(voxels, looks, elements):
    """Count a failed look at each voxel, of elements (n, 4) that were looked at, that stayed what it was."""
    for e in range(len(elements)):
        level, row, col, kind = elements[e]
        for h in range(level * BLOCK, (level + 1) * BLOCK):
            for r in range(row * BLOCK, (row + 1) * BLOCK):
                for c in range(col * BLOCK, (col + 1) * BLOCK):
                    bits = voxels[h, r, c]
                    same = (bits & (HULL | SEEN)) == HULL if kind == SURFACE else bits == 0
                    if same and looks[h, r, c] < 255:
                        looks[h, r, c] += 1


@njit(cache=True, nogil=True)
def _is_clear(solid, x, y, z, to_x, to_y, to_z, last):
    """Does nothing solid lie on a segment, up to `last` before its end? All in voxels.

    From voxel to voxel; only in one that holds something is the segment followed from part to part. It is
    gone back from its end: most of what hides a hull is the hull's own, beside what it hides.
    """
    levels, rows, cols = solid.shape
    dx, dy, dz = to_x - x, to_y - y, to_z - z
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    if length <= last:
        return True
    past = 1.0 - last / length
    col, row, level = math.floor(to_x), math.floor(to_y), math.floor(to_z)
    step_x, step_y, step_z = (-1 if dx > 0 else 1), (-1 if dy > 0 else 1), (-1 if dz > 0 else 1)
    slope_x = abs(1.0 / dx) if dx != 0.0 else math.inf
    slope_y = abs(1.0 / dy) if dy != 0.0 else math.inf
    slope_z = abs(1.0 / dz) if dz != 0.0 else math.inf
    next_x = slope_x * ((to_x - col) if dx > 0 else (col + 1 - to_x)) if dx != 0.0 else math.inf
    next_y = slope_y * ((to_y - row) if dy > 0 else (row + 1 - to_y)) if dy != 0.0 else math.inf
    next_z = slope_z * ((to_z - level) if dz > 0 else (level + 1 - to_z)) if dz != 0.0 else math.inf
    stride = 0.5 / (PARTS * length)
    left = past
    while left > 0.0:
        entered = max(1.0 - min(next_x, next_y, next_z), 0.0)
        inside = 0 <= row < rows and 0 <= col < cols and 0 <= level < levels
        if entered < left and inside and solid[level, row, col]:
            parts = solid[level, row, col]
            along = entered + 0.5 * stride
            while along < left:
                if parts & _part(x + along * dx, y + along * dy, z + along * dz):
                    return False
                along += stride
        left = min(left, entered)
        if next_x <= next_y and next_x <= next_z:
            col += step_x
            next_x += slope_x
        elif next_y <= next_z:
            row += step_y
            next_y += slope_y
        else:
            level += step_z
            next_z += slope_z
    return True


@njit(cache=True, nogil=True)
def _in_image(dx, dy, dz, cos, sin, camera):
    """Is a point, metres from the camera in the world, in the image of a level vehicle heading there?"""
    pitch, lens, size, limits, _ = camera
    ahead, right = cos * dx + sin * dy, sin * dx - cos * dy
    z = pitch[0] * ahead - pitch[1] * dz
    if not (limits[0] <= z <= limits[1]):
        return False
    down = -pitch[1] * ahead - pitch[0] * dz
    u = lens[0] * right + lens[2] * z
    v = lens[1] * down + lens[3] * z
    return 0.0 <= u < size[0] * z and 0.0 <= v < size[1] * z


@njit(cache=True, nogil=True)
def visible(volume, middles, failed, places, headings, camera, last):
    """Which elements each camera sees under each heading; what is not known to be solid hides nothing.

    Args:
        volume: With what is known to be solid.
        middles: (n, 3) metres in the world.
        failed: (n,) uint64, the sides from which each failed to show; from there it is not seen.
        places: (P, 3) of cameras, metres in the world.
        headings: (K, 2) cosine and sine.
        camera: Theirs.
        last: Voxels before an element's middle in which nothing hides it.

    Returns:
        starts: (P * K + 1,) int64.
        elements: (m,) int32; those of place p and heading k from starts[p * K + k] on.
    """
    solid, corner, side, reach = volume.solid, volume.corner, volume.side, camera.reach
    count = len(headings)
    starts = np.zeros(len(places) * count + 1, np.int64)
    elements = np.empty(4096, np.int32)
    clear = np.empty(len(middles), np.int32)
    total = 0
    for p in range(len(places)):
        x, y, z = places[p]
        found = 0
        for e in range(len(middles)):
            dx, dy, dz = middles[e, 0] - x, middles[e, 1] - y, middles[e, 2] - z
            squared = dx * dx + dy * dy
            if squared > reach * reach or squared == 0.0:
                continue
            if failed[e] and failed[e] & _side(dx, dy, reach):
                continue
            # Looked at straight, a point is in the image if it ever is.
            over = 1.0 / math.sqrt(squared)
            if not _in_image(dx, dy, dz, dx * over, dy * over, camera):
                continue
            if _is_clear(
                solid,
                (x - corner[0]) / side,
                (y - corner[1]) / side,
                (z - corner[2]) / side,
                (middles[e, 0] - corner[0]) / side,
                (middles[e, 1] - corner[1]) / side,
                (middles[e, 2] - corner[2]) / side,
                last,
            ):
                clear[found] = e
                found += 1
        if total + found * count > len(elements):
            larger = np.empty(2 * (total + found * count), np.int32)
            larger[:total] = elements[:total]
            elements = larger
        for k in range(count):
            for e in clear[:found]:
                dx, dy, dz = middles[e, 0] - x, middles[e, 1] - y, middles[e, 2] - z
                if _in_image(dx, dy, dz, headings[k, 0], headings[k, 1], camera):
                    elements[total] = e
                    total += 1
            starts[p * count + k + 1] = total
    return starts, elements[:total].copy()
