"""A frame goes into a volume: what its returns mark, what its rays clear, and what it inspects.

Free space is found by looking voxels up in the depth image, node by node of an octree over the view: whole
nodes are settled by the least and greatest depth of the tiles that they cover.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.geometry import FloatArray
from dream.mapping._kernels.volume import BITS, FELT, SIDE, VOXELS, find, make, surface, within

TILE = 4
"""Pixels along a tile, the least piece of an image that has a normal."""
LEVELS = 5
"""Of tiles: each covers four of the one before."""
BEARINGS, ELEVATIONS = 8, 4
"""Sides from which a voxel is inspected: 45° of bearing by a quarter of a sphere's area in height."""
WEIGHT = 16
"""Of a pixel that is sure."""
CAST, MOST_VOTES = 256, 65535
"""Votes that a voxel casts in a frame from `CLOSE` or nearer, and that are kept; more are halved."""
CLOSE = 2.0
"""Metres. From farther away votes weigh less, by the fourth power; one at least. A label that is wrong from
afar all the time is so put right by a look from near by, however many looks there were from afar."""
SHORT = 3.0
"""Mean errors by which a ray ends before the depth that is told: of a Laplace distribution a 40th
is nearer."""
UNSURE = 0.15
"""Mean error of a depth's logarithm above which what returned may be anywhere on its ray: what it covers is
not cleared by other rays. What the network that comes with DREAM says of ground is hardly ever above it."""
INNER = 0.2
"""Of a voxel's side: at least so far from its middle, towards each corner, it is looked up too; farther where
half a pixel is less than what is left to the corner, so that a ray that is told to pass does."""
NEAREST = 0.05
"""Metres along the optical axis, nearer than which nothing is settled by whole nodes."""
TARGET, NEAR, INSPECTED = 1, 2, 4
"""Bits of a return: its label; within reach; at a useful angle, and within reach."""
_NOTHING = -1
_HIDDEN, _MIXED, _CLEAR = 0, 1, 2
_SUPER = 4  # Bricks along the largest node.
_ALL = np.uint8(255)  # Of a brick's eighths.


class FrameLens(NamedTuple):
    """Where a frame was taken, and by what camera."""

    rotation: FloatArray
    """(3, 3) of `T_world_camera`."""
    place: FloatArray
    """(3,) metres in the world."""
    pinhole: tuple[float, float, float, float]
    """fx, fy, cx and cy in pixels."""
    limits: tuple[float, float]
    """Least and greatest valid depth, metres."""


class Weighing(NamedTuple):
    """How a frame is weighed."""

    side: float
    """Metres along a voxel."""
    reach: float
    """Metres straight within which something may be seen or inspected."""
    trusted: float
    """Metres straight within which a label is trusted, and a voxel counts as seen."""
    farthest: float
    """Metres straight beyond which nothing is kept."""
    scatter: float
    """Per metre: a depth z errs by σ = `scatter` z²."""
    bias: float
    """Share of its range by which a depth may be off."""
    held: float
    """Of the pixels that a voxel covers: where more of them return from it, no ray of the frame clears it."""
    believed: float
    """Likewise: where more do, something solid is there."""
    cosine: float
    """Of the greatest angle at which a surface is inspected."""
    hit: int
    """Step of log-odds of a voxel that something returned from."""
    miss: int
    """Step, downwards, of one that a ray passed."""
    least: int
    most: int
    """Log-odds are kept between them."""


class FrameScratch(NamedTuple):
    """Working memory, kept from frame to frame; all that is not said to be overwritten is zero between."""

    clear_to: npt.NDArray[np.float32]
    """(H, W) depth up to which a pixel's ray is clear, negated where its depth is `UNSURE`; overwritten."""
    inverse: npt.NDArray[np.float32]
    """(H, W) 1 / depth, NaN where there is none; overwritten."""
    tiles: npt.NDArray[np.float32]
    """(2, n) least and greatest `clear_to` of the tiles of all levels; overwritten."""
    facing: npt.NDArray[np.uint8]
    """(tile rows, tile cols) whether a tile is seen at a useful angle; overwritten."""
    codes: npt.NDArray[np.int32]
    """(W,) overwritten."""
    hit_of: npt.NDArray[np.int32]
    """(window's bricks,) its number among the bricks that are hit, from 1."""
    slot_of: npt.NDArray[np.int32]
    """(window's bricks,) its slot, 0 where it is not known or not made."""
    counts: npt.NDArray[np.int32]
    """(hit bricks, 512, 2) weights of pixels: all, and those of target."""
    kinds: npt.NDArray[np.uint8]
    """(hit bricks, 512) bits of returns."""
    touched: npt.NDArray[np.int32]
    """(n,) codes of voxels that are hit; overwritten."""


@njit(cache=True, nogil=True)
def _tile_levels(height, width):
    """(LEVELS, 3) rows and columns of tiles, and where they begin."""
    levels = np.empty((LEVELS, 3), np.int64)
    start = 0
    for level in range(LEVELS):
        side = TILE << level
        levels[level, 0] = (height + side - 1) // side
        levels[level, 1] = (width + side - 1) // side
        levels[level, 2] = start
        start += levels[level, 0] * levels[level, 1]
    return levels


@njit(cache=True, nogil=True)
def window_of(lens, width, height, farthest, side):
    """(2, 3) int64 level, row and column of the first brick around a view, and how many there are."""
    fx, fy, cx, cy = lens.pinhole
    window = np.empty((2, 3), np.int64)
    for k in range(3):
        low, high = 0.0, 0.0
        for u in (0.0, float(width)):
            for v in (0.0, float(height)):
                a, b = (u - cx) / fx, (v - cy) / fy
                end = (lens.rotation[k, 0] * a + lens.rotation[k, 1] * b + lens.rotation[k, 2]) * farthest
                low, high = min(low, end), max(high, end)
        low, high = lens.place[k] + max(low, -farthest), lens.place[k] + min(high, farthest)
        first = math.floor(low / (SIDE * side))
        window[0, 2 - k], window[1, 2 - k] = first, math.floor(high / (SIDE * side)) + 1 - first
    return window


@njit(cache=True, nogil=True)
def read(depth, labels, weights, errors, water, lens, rule, scratch):
    """How far each ray is clear, by pixel and tile, and which tiles are seen at a useful angle.

    Args:
        depth: (H, W) float32 metres along the optical axis; NaN where there is no return.
        labels: (H, W) uint8.
        weights: (H, W) uint8 of `WEIGHT`, or (0, 0) where all are sure.
        errors: (H, W) float32 mean error of the depth's logarithm, or (0, 0) where the rule's hold for all.
        water: Label of no return.
        lens: Of the frame.
        rule: How it is weighed.
        scratch: Its images are written.

    Returns:
        Metres straight to the farthest tile that returned.
    """
    height, width = depth.shape
    nearest, greatest = np.float32(lens.limits[0]), np.float32(lens.limits[1])
    scatter, bias = np.float32(rule.scatter), np.float32(rule.bias)
    clear_to, inverse = scratch.clear_to, scratch.inverse
    nothing, least, endless = np.float32(0.0), np.float32(1e-6), np.float32(np.inf)
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            returned = (z >= nearest) & (z <= greatest)
            # Not `>=`: where nothing returns, the depth is NaN.
            through = (not z < nearest) & (labels[v, u] == water)
            off = np.float32(1.0 - math.exp(-SHORT * errors[v, u])) if errors.size else bias
            clear = z - z * (scatter * z + off)
            # Not `<=`: where the error is NaN, nothing is clear.
            if not clear > nothing:
                clear = nothing
            if errors.size and errors[v, u] > UNSURE:
                clear = -max(clear, least)
            clear_to[v, u] = clear if returned else (endless if through else nothing)
            inverse[v, u] = np.float32(1.0) / z if returned else np.float32(np.nan)
    if weights.size:
        for v in range(height):
            for u in range(width):
                # A depth whose error is told clears by that, whatever it is that returned.
                if 2 * weights[v, u] < WEIGHT and not (errors.size and inverse[v, u] > 0.0):
                    clear_to[v, u] = nothing
                    inverse[v, u] = np.float32(np.nan)
    return _tiles(lens, rule, scratch, height, width)


@njit(cache=True, nogil=True)
def _tiles(lens, rule, scratch, height, width):
    """Fill the tiles of all levels, and which of them face the camera; see `read`."""
    fx, fy, cx, cy = lens.pinhole
    clear_to, inverse, facing = scratch.clear_to, scratch.inverse, scratch.facing
    low, high = scratch.tiles[0], scratch.tiles[1]
    levels = _tile_levels(height, width)
    rows, cols = levels[0, 0], levels[0, 1]
    spread = TILE * TILE * (TILE * TILE - 1) / 12.0
    farthest = 0.0
    # The sums and bounds of four rows of pixels, column by column.
    sums = np.empty((2, width))
    bounds = np.empty((2, width), np.float32)
    for i in range(rows):
        sums[:] = 0.0
        bounds[0, :], bounds[1, :] = np.float32(np.inf), np.float32(0.0)
        for v in range(TILE * i, min(TILE * i + TILE, height)):
            below = v - TILE * i - 0.5 * (TILE - 1)
            for u in range(width):
                w, clear = np.float64(inverse[v, u]), abs(clear_to[v, u])
                sums[0, u] += w
                sums[1, u] += below * w
                bounds[0, u] = min(bounds[0, u], clear)
                bounds[1, u] = max(bounds[1, u], clear)
        for j in range(cols):
            least, greatest = np.float32(np.inf), np.float32(0.0)
            total, right, down = 0.0, 0.0, 0.0
            for u in range(TILE * j, min(TILE * j + TILE, width)):
                least, greatest = min(least, bounds[0, u]), max(greatest, bounds[1, u])
                total += sums[0, u]
                down += sums[1, u]
                right += (u - TILE * j - 0.5 * (TILE - 1)) * sums[0, u]
            low[i * cols + j], high[i * cols + j] = least, greatest
            facing[i, j] = 0
            if TILE * (i + 1) > height or TILE * (j + 1) > width:
                continue
            # Over a plane, 1 / depth is linear in the image: its slopes are the plane's normal.
            mean = total / (TILE * TILE)
            a, b = (TILE * (j + 0.5) - cx) / fx, (TILE * (i + 0.5) - cy) / fy
            along, below = fx * right / spread, fy * down / spread
            ahead = mean - a * along - b * below
            normal, ray = along * along + below * below + ahead * ahead, 1.0 + a * a + b * b
            # False where any depth is NaN.
            facing[i, j] = mean * mean >= rule.cosine * rule.cosine * normal * ray
            if greatest < np.inf:
                farthest = max(farthest, float(least) * math.sqrt(ray))
    for level in range(1, LEVELS):
        rows, cols, start = levels[level]
        finer_rows, finer_cols, finer = levels[level - 1]
        for i in range(rows):
            for j in range(cols):
                least, greatest = np.float32(np.inf), np.float32(0.0)
                for v in range(2 * i, min(2 * i + 2, finer_rows)):
                    for u in range(2 * j, min(2 * j + 2, finer_cols)):
                        least = min(least, low[finer + v * finer_cols + u])
                        greatest = max(greatest, high[finer + v * finer_cols + u])
                low[start + i * cols + j], high[start + i * cols + j] = least, greatest
    return farthest


@njit(cache=True, nogil=True)
def mark(depth, labels, weights, target, lens, rule, window, scratch):
    """Count the returns of a frame by voxel.

    Args:
        depth, labels, weights, lens, rule: See `read`.
        target: Label of the target.
        window: (2, 3) level, row and column of the first brick, and their numbers.
        scratch: Voxels that are hit are counted in it.

    Returns:
        How many voxels are hit, and how many bricks.
    """
    fx, fy, cx, cy = lens.pinhole
    rotation, place = lens.rotation, lens.place
    codes, facing, kinds, counts = scratch.codes, scratch.facing, scratch.kinds, scratch.counts
    hit_of, touched = scratch.hit_of, scratch.touched
    height, width = depth.shape
    nearest, greatest = lens.limits
    per, farthest, reach = 1.0 / rule.side, rule.farthest**2, rule.reach**2
    start_x = place[0] * per - window[0, 2] * SIDE
    start_y = place[1] * per - window[0, 1] * SIDE
    start_z = place[2] * per - window[0, 0] * SIDE
    rows, cols = np.int32(window[1, 1]), np.int32(window[1, 2])
    past_x, past_y, past_z = window[1, 2] * SIDE, window[1, 1] * SIDE, window[1, 0] * SIDE
    low = np.int32(SIDE - 1)
    found, bricks = 0, 0
    for v in range(height):
        b = (v + 0.5 - cy) / fy
        base_x = (rotation[0, 1] * b + rotation[0, 2]) * per
        base_y = (rotation[1, 1] * b + rotation[1, 2]) * per
        base_z = (rotation[2, 1] * b + rotation[2, 2]) * per
        side_x, side_y, side_z = rotation[0, 0] * per, rotation[1, 0] * per, rotation[2, 0] * per
        for u in range(width):
            z = np.float64(depth[v, u])
            a = (u + 0.5 - cx) / fx
            away = z * z * (1.0 + a * a + b * b)
            x, y, h = start_x + z * (base_x + side_x * a), start_y + z * (base_y + side_y * a), 0.0
            h = start_z + z * (base_z + side_z * a)
            valid = (z >= nearest) & (z <= greatest) & (away <= farthest)
            valid &= (x >= 0.0) & (y >= 0.0) & (h >= 0.0) & (x < past_x) & (y < past_y) & (h < past_z)
            col, row = np.int32(x if valid else 0.0), np.int32(y if valid else 0.0)
            level = np.int32(h if valid else 0.0)
            brick = ((level >> BITS) * rows + (row >> BITS)) * cols + (col >> BITS)
            number = ((level & low) << 2 * BITS) | ((row & low) << BITS) | (col & low)
            kind = np.int32(TARGET if labels[v, u] == target else 0) | np.int32(NEAR if away <= reach else 0)
            codes[u] = (((brick << 3 * BITS) | number) << 2) | kind if valid else _NOTHING
        u = 0
        while u < width:
            # Neighbours mostly return from one voxel: they are counted together.
            code = codes[u]
            past = u + 1
            tile = facing[v // TILE, u // TILE]
            while past < width and codes[past] == code and facing[v // TILE, past // TILE] == tile:
                past += 1
            if code != _NOTHING:
                weight = WEIGHT * (past - u)
                if weights.size:
                    weight = 0
                    for n in range(u, past):
                        weight += weights[v, n]
                if weight:
                    voxel, kind = code >> 2, code & 3
                    brick, number = voxel >> 3 * BITS, voxel & (VOXELS - 1)
                    if hit_of[brick] == 0:
                        bricks += 1
                        hit_of[brick] = bricks
                    n = hit_of[brick]
                    if counts[n, number, 0] == 0:
                        touched[found] = voxel
                        found += 1
                    counts[n, number, 0] += weight
                    counts[n, number, 1] += weight if kind & TARGET else 0
                    kinds[n, number] |= kind | (INSPECTED if tile and kind & NEAR else 0)
            u = past
    return found, bricks


@njit(cache=True, nogil=True)
def settle(bricks, lens, rule, window, scratch, found, limit, stamp):
    """Write what a frame shows into the bricks, and empty the scratch.

    Args:
        bricks: Changed; with room for all of the window.
        lens, rule, window, scratch: See `mark`.
        found: Voxels that are hit.
        limit: Metres straight up to which a ray may clear.
        stamp: Of what is changed.
    """
    # First what is clear: what returned from a voxel in the same frame holds there.
    _clear(bricks, lens, rule, window, scratch, limit, stamp)
    # Taken out here: each access to an array of a tuple counts its references.
    touched, hit_of, slot_of = scratch.touched, scratch.hit_of, scratch.slot_of
    counts, kinds, log_odds, votes = scratch.counts, scratch.kinds, bricks.log_odds, bricks.votes
    surface_of, seen, sides = bricks.surface_of, bricks.seen, bricks.sides
    rotation, place, side, pixels = lens.rotation, lens.place, rule.side, lens.pinhole[0] * lens.pinhole[1]
    for n in range(found):
        voxel = touched[n]
        brick, number = voxel >> 3 * BITS, voxel & (VOXELS - 1)
        hit = hit_of[brick]
        dx, dy, dz = _middle(voxel, window, side, place)
        z = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
        count, of_target, kind = counts[hit, number, 0], counts[hit, number, 1], kinds[hit, number]
        counts[hit, number, 0] = counts[hit, number, 1] = 0
        kinds[hit, number] = 0
        if count <= rule.believed * _covered(z, pixels, side):
            continue
        slot = slot_of[brick]
        if slot == 0 or surface_of[slot] == 0:
            slot = _slot(bricks, brick, window, scratch)
            surface(bricks, slot)
        # A depth that scatters over several voxels tells each of them less.
        sure = side / max(2.0 * rule.scatter * z * z, side)
        step = max(int(rule.hit * sure), 1)
        odds = np.int64(log_odds[slot, number])
        log_odds[slot, number] = max(min(odds + step, rule.most), odds)
        at = surface_of[slot]
        _vote(votes, at, number, of_target / count, _cast(dx * dx + dy * dy + dz * dz))
        if kind & NEAR and dx * dx + dy * dy + dz * dz <= rule.trusted * rule.trusted:
            seen[at, number] = 1
        if kind & INSPECTED:
            sides[at, number] |= side_bit(-dx, -dy, -dz)
        bricks.saturated[slot] &= ~_octant(number)
        bricks.stamps[slot] = stamp
    scratch.hit_of[:] = 0
    scratch.slot_of[:] = 0


@njit(cache=True, nogil=True)
def _octant(number):
    """The bit of the eighth of a brick that a voxel is in."""
    return np.uint8(1) << np.uint8((number >> 8 & 1) << 2 | (number >> 5 & 1) << 1 | (number >> 2 & 1))


@njit(cache=True, nogil=True)
def _covered(z, pixels, side):
    """The weight of the pixels that a voxel at depth z covers, where they are sure; `pixels` is fx fy."""
    return WEIGHT * pixels * (side / max(z, side)) ** 2


@njit(cache=True, nogil=True)
def _cast(square):
    """The votes of a frame from so far away, the square of metres."""
    return max(1, min(CAST, int(CAST * (CLOSE * CLOSE / max(square, CLOSE * CLOSE)) ** 2 + 0.5)))


@njit(cache=True, nogil=True)
def _vote(votes, at, number, share, cast):
    """Cast the votes of a frame."""
    if votes[at, number, 1] > MOST_VOTES - CAST:
        votes[at, number, 0] >>= 1
        votes[at, number, 1] >>= 1
    votes[at, number, 0] += int(share * cast + 0.5)
    votes[at, number, 1] += cast


@njit(cache=True, nogil=True)
def side_bit(dx, dy, dz):
    """The bit of the side that a voxel is looked at from; from it to the camera."""
    if dy >= 0.0:
        bearing = (0 if dy < dx else 1) if dx > 0.0 else (2 if dy > -dx else 3)
    else:
        bearing = (4 if dy > dx else 5) if dx < 0.0 else (6 if -dy > dx else 7)
    height = dz / max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-12)
    band = min(int((height + 1.0) * 0.5 * ELEVATIONS), ELEVATIONS - 1)
    return np.uint32(1) << np.uint32(band * BEARINGS + bearing)


@njit(cache=True, nogil=True)
def _middle(voxel, window, side, place):
    """From the camera to a voxel's middle, metres; the voxel by its code in the window."""
    brick, number = voxel >> 3 * BITS, voxel & (VOXELS - 1)
    rows, cols = window[1, 1], window[1, 2]
    level = (window[0, 0] + brick // (rows * cols)) * SIDE + (number >> 2 * BITS)
    row = (window[0, 1] + brick // cols % rows) * SIDE + ((number >> BITS) & (SIDE - 1))
    col = (window[0, 2] + brick % cols) * SIDE + (number & (SIDE - 1))
    return (col + 0.5) * side - place[0], (row + 0.5) * side - place[1], (level + 0.5) * side - place[2]


@njit(cache=True, nogil=True)
def _slot(bricks, brick, window, scratch):
    """The slot of a brick of the window, made where there is none."""
    if scratch.slot_of[brick] == 0:
        rows, cols = window[1, 1], window[1, 2]
        level, row = window[0, 0] + brick // (rows * cols), window[0, 1] + brick // cols % rows
        scratch.slot_of[brick] = make(bricks, level, row, window[0, 2] + brick % cols)
    return scratch.slot_of[brick]


@njit(cache=True, nogil=True)
def _edges(pinhole, height, width):
    """The planes through the camera and the image's edges: each as a normal's two components, inwards."""
    fx, fy, cx, cy = pinhole
    left, right = math.hypot(fx, cx), math.hypot(fx, width - cx)
    top, bottom = math.hypot(fy, cy), math.hypot(fy, height - cy)
    across = (fx / left, cx / left, -fx / right, (width - cx) / right)
    return across, (fy / top, cy / top, -fy / bottom, (height - cy) / bottom)


@njit(cache=True, nogil=True)
def _is_outside(edges, x, y, z, radius):
    """Is a ball about (x, y, z), in the camera's axes, wholly beyond an edge of the image?"""
    across, along = edges
    return (
        across[0] * x + across[1] * z < -radius
        or across[2] * x + across[3] * z < -radius
        or along[0] * y + along[1] * z < -radius
        or along[2] * y + along[3] * z < -radius
    )


@njit(cache=True, nogil=True)
def _classify(tiles, levels, pinhole, edges, size, limit, x, y, z, extent):
    """Whether a cube about (x, y, z), in the camera's axes, is hidden, clear, or neither.

    Args:
        tiles: Least and greatest depths, see `FrameScratch`.
        levels: Of the tiles.
        pinhole: fx, fy, cx and cy in pixels.
        edges: Of the image.
        size: Height and width of the image.
        limit: Metres straight up to which a ray may clear.
        x, y, z: Metres.
        extent: (4,) half of its extent along the three axes of the camera, and of its diagonal.
    """
    away = math.sqrt(x * x + y * y + z * z)
    nearest, farthest = z - extent[2], z + extent[2]
    if farthest <= 0.0 or away - extent[3] > limit or _is_outside(edges, x, y, z, extent[3]):
        return _HIDDEN
    if nearest < NEAREST:
        return _MIXED
    fx, fy, cx, cy = pinhole
    height, width = size
    close, far = 1.0 / nearest, 1.0 / farthest
    left, right = x - extent[0], x + extent[0]
    above, below = y - extent[1], y + extent[1]
    u_low = cx + fx * left * (close if left < 0.0 else far)
    u_high = cx + fx * right * (close if right > 0.0 else far)
    v_low = cy + fy * above * (close if above < 0.0 else far)
    v_high = cy + fy * below * (close if below > 0.0 else far)
    if u_high < 0.0 or v_high < 0.0 or u_low >= width or v_low >= height:
        return _HIDDEN
    inside = u_low >= 0.0 and v_low >= 0.0 and u_high < width and v_high < height
    inside &= away + extent[3] <= limit
    u_first, u_last = max(int(u_low), 0), min(int(u_high), width - 1)
    v_first, v_last = max(int(v_low), 0), min(int(v_high), height - 1)
    level, span = 0, max(u_last - u_first, v_last - v_first)
    while level < LEVELS - 1 and span > 2 * (TILE << level):
        level += 1
    side = TILE << level
    cols, start = levels[level, 1], levels[level, 2]
    least, greatest = np.float32(np.inf), np.float32(0.0)
    for i in range(v_first // side, v_last // side + 1):
        for j in range(u_first // side, u_last // side + 1):
            least = min(least, tiles[0, start + i * cols + j])
            greatest = max(greatest, tiles[1, start + i * cols + j])
    if greatest < nearest:
        return _HIDDEN
    return _CLEAR if inside and least >= farthest else _MIXED


@njit(cache=True, nogil=True)
def _is_passed(clear_to, pinhole, limit, x, y, z, side, corners):
    """Does a ray pass a voxel about (x, y, z), in the camera's axes, by any of some points of it?

    And does by none of them something return that may be there?
    """
    fx, fy, cx, cy = pinhole
    height, width = clear_to.shape
    off = max(0.5 * side - 0.5 * z / min(fx, fy), INNER * side)
    passed = False
    for s in range(len(corners)):
        right, down, ahead = x + off * corners[s, 0], y + off * corners[s, 1], z + off * corners[s, 2]
        if ahead <= 0.0 or right * right + down * down + ahead * ahead > limit * limit:
            continue
        over = 1.0 / ahead
        u, v = fx * right * over + cx, fy * down * over + cy
        if 0.0 <= u < width and 0.0 <= v < height:
            clear = clear_to[int(v), int(u)]
            if abs(clear) >= ahead:
                passed = True
            elif clear < 0.0:
                return False
    return passed


@njit(cache=True, nogil=True)
def _is_seen_through(clear_to, pinhole, limit, x, y, z, corners):
    """Do the four rays around every corner of a voxel about (x, y, z), and around its middle, pass it?

    So much is asked where it is solid: else a few rays along a plate would clear it.
    """
    fx, fy, cx, cy = pinhole
    height, width = clear_to.shape
    for s in range(len(corners)):
        right, down, ahead = x + corners[s, 0], y + corners[s, 1], z + corners[s, 2]
        if ahead <= 0.0 or right * right + down * down + ahead * ahead > limit * limit:
            return False
        over = 1.0 / ahead
        u, v = fx * right * over + cx - 0.5, fy * down * over + cy - 0.5
        if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
            return False
        i, j = int(v), int(u)
        nearest = min(
            min(abs(clear_to[i, j]), abs(clear_to[i, j + 1])),
            min(abs(clear_to[i + 1, j]), abs(clear_to[i + 1, j + 1])),
        )
        if nearest < ahead:
            return False
    return True


@njit(cache=True, nogil=True)
def _clear(bricks, lens, rule, window, scratch, limit, stamp):
    """Lower the log-odds of every voxel that a ray passes and nothing returned from."""
    height, width = scratch.clear_to.shape
    tiles, tile_levels = scratch.tiles, _tile_levels(height, width)
    edges = _edges(lens.pinhole, height, width)
    rotation, side = lens.rotation, rule.side
    # Half extents of nodes of 4 bricks, a brick, half and a quarter of one, along the camera's axes.
    extents = np.empty((4, 4))
    for n, voxels in enumerate((SIDE * _SUPER, SIDE, SIDE // 2, SIDE // 4)):
        half = 0.5 * voxels * side
        for k in range(3):
            extents[n, k] = half * (abs(rotation[0, k]) + abs(rotation[1, k]) + abs(rotation[2, k]))
        extents[n, 3] = half * math.sqrt(3.0)
    inner, outer = _samples(rotation, 1.0), _samples(rotation, 0.5 * side)
    levels, rows, cols = window[1]
    at = np.empty(3)
    for up in range(0, levels, _SUPER):
        for north in range(0, rows, _SUPER):
            for east in range(0, cols, _SUPER):
                half = 0.5 * SIDE * _SUPER
                _turn(lens, window, side, up * SIDE + half, north * SIDE + half, east * SIDE + half, at)
                whole = _classify(
                    tiles,
                    tile_levels,
                    lens.pinhole,
                    edges,
                    (height, width),
                    limit,
                    at[0],
                    at[1],
                    at[2],
                    extents[0],
                )
                if whole == _HIDDEN:
                    continue
                for level in range(up, min(up + _SUPER, levels)):
                    for row in range(north, min(north + _SUPER, rows)):
                        for col in range(east, min(east + _SUPER, cols)):
                            _clear_brick(
                                bricks,
                                lens,
                                tile_levels,
                                edges,
                                limit,
                                rule,
                                window,
                                scratch,
                                (level, row, col),
                                whole == _CLEAR,
                                extents,
                                inner,
                                outer,
                                stamp,
                                at,
                            )


@njit(cache=True, nogil=True)
def _samples(rotation, off):
    """(9, 3) a voxel's middle, and points so far off it towards each corner, in the camera's axes."""
    samples = np.zeros((9, 3))
    for s in range(8):
        dx, dy, dz = (off if s & 1 else -off), (off if s & 2 else -off), (off if s & 4 else -off)
        for k in range(3):
            samples[s + 1, k] = rotation[0, k] * dx + rotation[1, k] * dy + rotation[2, k] * dz
    return samples


@njit(cache=True, nogil=True)
def _turn(lens, window, side, level, row, col, at):
    """Write into `at` (3,) a point of the window, in voxels, in the camera's axes and metres."""
    dx = (window[0, 2] * SIDE + col) * side - lens.place[0]
    dy = (window[0, 1] * SIDE + row) * side - lens.place[1]
    dz = (window[0, 0] * SIDE + level) * side - lens.place[2]
    for k in range(3):
        at[k] = lens.rotation[0, k] * dx + lens.rotation[1, k] * dy + lens.rotation[2, k] * dz


@njit(cache=True, nogil=True)
def _clear_brick(
    bricks,
    lens,
    tile_levels,
    edges,
    limit,
    rule,
    window,
    scratch,
    name,
    clear,
    extents,
    inner,
    outer,
    stamp,
    at,
):
    """Clear what is passed of a brick of the window; all of it where it is known to be clear."""
    level, row, col = name
    side, pinhole, tiles, size = rule.side, lens.pinhole, scratch.tiles, scratch.clear_to.shape
    brick = (level * window[1, 1] + row) * window[1, 2] + col
    half = 0.5 * SIDE
    if not clear:
        _turn(lens, window, side, level * SIDE + half, row * SIDE + half, col * SIDE + half, at)
        kind = _classify(tiles, tile_levels, pinhole, edges, size, limit, at[0], at[1], at[2], extents[1])
        if kind == _HIDDEN:
            return
        clear = kind == _CLEAR
    if clear:
        slot = _slot(bricks, brick, window, scratch)
        if bricks.saturated[slot] == _ALL:
            return
        odds = bricks.log_odds[slot]
        greatest = np.int8(-128)
        least, miss = np.int8(rule.least), np.int8(rule.miss)
        for n in range(VOXELS):
            value = max(np.int8(max(odds[n], np.int8(least + miss)) - miss), least)
            value = odds[n] if odds[n] == FELT else value
            odds[n] = value
            greatest = max(greatest, value)
        bricks.saturated[slot], bricks.stamps[slot] = (_ALL if greatest <= least else 0), stamp
        return
    slot = scratch.slot_of[brick]
    if slot == 0:
        slot = find(bricks, window[0, 0] + level, window[0, 1] + row, window[0, 2] + col)
        scratch.slot_of[brick] = slot
    if bricks.saturated[slot] == _ALL:
        return
    quarter = SIDE // 2
    for part in range(8):
        up, north, east = (part >> 2) * quarter, (part >> 1 & 1) * quarter, (part & 1) * quarter
        first = within(up, north, east)
        if bricks.saturated[slot] & _octant(first):
            continue
        middle = 0.5 * quarter
        h, r, c = level * SIDE + up + middle, row * SIDE + north + middle, col * SIDE + east + middle
        _turn(lens, window, side, h, r, c, at)
        kind = _classify(tiles, tile_levels, pinhole, edges, size, limit, at[0], at[1], at[2], extents[2])
        if kind == _HIDDEN:
            continue
        if kind == _CLEAR:
            # Nothing returned from within it: what did would lie before its far side.
            slot = _slot(bricks, brick, window, scratch)
            bricks.stamps[slot] = stamp
            greatest, log_odds = rule.least, bricks.log_odds
            for line in range(quarter * quarter):
                start = first + (line // quarter << 2 * BITS) + (line % quarter << BITS)
                for number in range(start, start + quarter):
                    odds_now = max(np.int64(log_odds[slot, number]) - rule.miss, rule.least)
                    if log_odds[slot, number] == FELT:
                        odds_now = FELT
                    log_odds[slot, number] = odds_now
                    greatest = max(greatest, odds_now)
            if greatest <= rule.least:
                bricks.saturated[slot] |= _octant(first)
            continue
        slot = _clear_octant(
            bricks,
            lens,
            tile_levels,
            edges,
            limit,
            rule,
            window,
            scratch,
            brick,
            slot,
            first,
            at,
            extents[3],
            inner,
            outer,
            stamp,
        )


@njit(cache=True, nogil=True)
def _clear_octant(
    bricks,
    lens,
    tile_levels,
    edges,
    limit,
    rule,
    window,
    scratch,
    brick,
    slot,
    first,
    at,
    extent,
    inner,
    outer,
    stamp,
):
    """Clear what is passed of the eighth of a brick that begins with voxel `first`, about `at` (3,).

    Returns:
        The slot of the brick, which may have been made.
    """
    # Taken out here: each access to an array of a tuple counts its references.
    side, rotation, pinhole = rule.side, lens.rotation, lens.pinhole
    log_odds, counts, tiles, clear_to = bricks.log_odds, scratch.counts, scratch.tiles, scratch.clear_to
    pixels, size = pinhole[0] * pinhole[1], clear_to.shape
    hit, greatest, changed = scratch.hit_of[brick], rule.least, False
    for node in range(8):
        up, north, east = node >> 2 & 1, node >> 1 & 1, node & 1
        dx, dy, dz = (2 * east - 1) * side, (2 * north - 1) * side, (2 * up - 1) * side
        node_x = at[0] + rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz
        node_y = at[1] + rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz
        node_z = at[2] + rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
        kind = _classify(tiles, tile_levels, pinhole, edges, size, limit, node_x, node_y, node_z, extent)
        for voxel in range(8):
            i, j, k = voxel >> 2 & 1, voxel >> 1 & 1, voxel & 1
            number = first + (2 * up + i << 2 * BITS | 2 * north + j << BITS | 2 * east + k)
            odds = np.int64(log_odds[slot, number])
            if rule.least < odds < FELT:
                passed = kind == _CLEAR
                if kind == _MIXED:
                    dx, dy, dz = (k - 0.5) * side, (j - 0.5) * side, (i - 0.5) * side
                    x = node_x + rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz
                    y = node_y + rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz
                    z = node_z + rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
                    if _is_outside(edges, x, y, z, side):
                        greatest = max(greatest, odds)
                        continue
                    count = counts[hit, number, 0] if hit else 0
                    if count == 0 or count <= rule.held * _covered(z, pixels, side):
                        if odds > 0:
                            passed = _is_seen_through(clear_to, pinhole, limit, x, y, z, outer)
                        else:
                            passed = _is_passed(clear_to, pinhole, limit, x, y, z, side, inner)
                if passed:
                    if slot == 0:
                        slot = _slot(bricks, brick, window, scratch)
                    odds = max(odds - rule.miss, rule.least)
                    log_odds[slot, number] = odds
                    changed = True
            greatest = max(greatest, odds)
    if changed:
        bricks.stamps[slot] = stamp
    if greatest <= rule.least:
        bricks.saturated[slot] |= _octant(first)
    return slot
