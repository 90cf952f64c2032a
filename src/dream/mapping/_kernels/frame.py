"""One frame into the map, in two passes: what it says of a window of cells, then the window into the blocks.

The window is a square of cells around the camera with the reach inside; flat indices are `row * side + col`.
Its low corner is a multiple of a post of the ground.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dream.mapping._kernels.flags import BARE, CROSSED, EXPLORED, GROUNDED, KNOWN, RETURNED, SEABED
from dream.mapping._kernels.sight import RAY_MASK, SECTOR_SLACK, all_open, any_open, block

BLOCK_BITS = 6
BLOCK = 1 << BLOCK_BITS
"""Cells along a block."""
CHUNK = 512
"""Pixels of a row that are looked at together, at most."""
FIELD_BITS = 16
"""A cell's counts are four fields of so many bits: pixels below the height band, in its lower part, in its upper part,
and above it."""
FIELD_MASK = (1 << FIELD_BITS) - 1
WEIGHT = 16
"""What a pixel that surely shows target adds to its cell's target count."""
LABEL_BITS = 8
"""A sample is its flat cell, shifted by so many bits, and its label."""
LABEL_MASK = (1 << LABEL_BITS) - 1
GROUND_STEP = 8
"""Every so manieth sample is enough for the mean height of the seabed."""
GROUND, THING, UNSURE = 0, 1, 2
"""What a pixel is by its label: seabed, anything else, or seabed if its height agrees."""


# ---------------------------------------------------------------------------------------------------
# Pixels to samples
# ---------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def project(
    depth,
    unit,
    labels,
    label_scale,
    water,
    kind_of,
    intrinsics,
    R,
    t,
    low,
    size,
    limits,
    cuts,
    raw_cuts,
    side,
    clip,
    post_of,
    prior,
    prior_room,
    samples,
    heights,
    post_sum,
    post_count,
    farthest,
):
    """Window cell and world height of the pixels that count; seabed sums by post; farthest return by ray.

    Of what lies between `cuts[k]` and `cuts[k - 1]` every 2ᵏ-th row and column is taken: enough to fill a cell.

    Args:
        depth: (H, W) of `unit` metres.
        unit: Metres.
        labels: (H, W), times `label_scale` an index into `kind_of`.
        label_scale: See `labels`.
        water: What `labels` holds where there is no return.
        kind_of: (256,) uint8.
        intrinsics: (fx, fy, cx, cy).
        R: (3, 3), camera to world.
        t: (3,), likewise.
        low: World x and y of the window's low corner.
        size: Metres a cell.
        limits: (min_depth, max_depth, reach), metres.
        cuts: (levels,) float32 metres, falling.
        raw_cuts: (levels + 1,) of depth's type: the cuts and `min_depth` in its unit, rounded down.
        side: Cells along the window.
        clip: (first row, past row, first col, past col) of the window that lie in bounds.
        post_of: (side²) int32, the post of every cell.
        prior: (post_side²) float64, height of the seabed before this frame.
        prior_room: Metres from there within which an unsure pixel is seabed.
        samples: (H W + 1) int32, out: flat cell and label, see `LABEL_BITS`.
        heights: (H W + 1) float32, out: world z.
        post_sum, post_count: (post_side²) float64, added to.
        farthest: (rays,) float32, out: metres over ground to the farthest return in that direction.

    Returns:
        Number of samples.
    """
    fx, fy, cx, cy = intrinsics
    min_depth, max_depth, reach = limits
    height, width = depth.shape
    f32, i32 = np.float32, np.int32
    metres, scale = f32(unit), f32(label_scale)
    frame = (f32((t[0] - low[0]) / size), f32((t[1] - low[1]) / size), f32(t[2]), f32(1.0 / size))
    square_reach = f32(reach * reach)
    inside = (i32(clip[0]), i32(clip[1]), i32(clip[2]), i32(clip[3]))
    stride = i32(side)
    chunks = (width + CHUNK - 1) // CHUNK
    columns = np.zeros((chunks, 3 * CHUNK), f32)
    farther = np.empty((chunks, 3 * CHUNK), f32)
    metric = np.zeros(4 * CHUNK, f32)
    names = np.zeros(CHUNK, i32)
    per_radian = (RAY_MASK + 1) / (2.0 * math.pi)
    farthest[:] = f32(0.0)
    count = 0
    for level in range(len(cuts) + 1):
        step = 1 << level
        across = 2 * step
        nearest = f32(min_depth) if level == len(cuts) else max(cuts[level], f32(min_depth))
        most = f32(max_depth) if level == 0 else min(cuts[level - 1], f32(max_depth))
        n = (width + across - 1) // across
        for k in range(n):
            a = (k * across + 0.5 - cx) / fx
            for axis in range(3):
                columns[k // CHUNK, axis * CHUNK + k % CHUNK] = R[axis, 0] * a
        farther[:] = f32(0.0)
        for v in range(0, height, step):
            if not any_beyond(depth[v], raw_cuts[level]):
                continue
            b = (v + 0.5 - cy) / fy
            ray = (f32(R[0, 1] * b + R[0, 2]), f32(R[1, 1] * b + R[1, 2]), f32(R[2, 1] * b + R[2, 2]))
            first = count
            for begin in range(0, n, CHUNK):
                size_of = min(CHUNK, n - begin)
                skip = begin * across
                valid = read_row(
                    depth[v, skip:], labels[v, skip:], across, metres, scale, water, nearest, most, size_of, metric, names
                )
                if valid == 0:
                    continue
                of_chunk = begin // CHUNK
                lay_out(metric, columns[of_chunk], size_of, ray)
                reach_out(metric, farther[of_chunk], size_of)
                past = count + size_of
                if place(
                    metric, names, samples[count:past], heights[count:past], size_of, frame, square_reach, inside, stride
                ):
                    count = past
            sum_ground(first, count, samples, heights, kind_of, post_of, prior, prior_room, post_sum, post_count)
        for k in range(n):
            chunk, k_of = k // CHUNK, k % CHUNK
            square = farther[chunk, 2 * CHUNK + k_of]
            if square > 0.0:
                bearing = math.atan2(farther[chunk, CHUNK + k_of], farther[chunk, k_of])
                spread_far(math.floor(bearing * per_radian), math.sqrt(square), farthest)
    return count


@njit(cache=True, nogil=True)
def spread_far(ray, distance, farthest):
    """A ray may run between two columns, or off to a side of where its column looked farthest."""
    for near in range(ray - 5, ray + 6):
        farthest[near & RAY_MASK] = max(farthest[near & RAY_MASK], distance)


# The following loops have no branches and few arrays, so that they are vectorised: `metric` holds `CHUNK` each of
# x and y over ground from the camera, world z and depth.


@njit(cache=True, nogil=True)
def any_beyond(row, least):
    """Does some pixel of a row lie farther away, in the image's own unit?"""
    found = np.int32(0)
    for k in range(len(row)):
        found += np.int32(row[k] > least)
    return found > 0


@njit(cache=True, nogil=True)
def pick(z, label, water, nearest, most):
    """The depth where it counts, else 0."""
    return z if (z > nearest) & (z <= most) & (label != water) else np.float32(0.0)


@njit(cache=True, nogil=True)
def read_row(row, label_row, across, metres, scale, water, nearest, most, n, metric, names):
    """Depths, 0 where they do not count, and labels of every second, fourth or eighth pixel of a row; how many count."""
    # A step that is known when compiling is several times faster.
    if across == 2:
        for k in range(n):
            z = np.float32(row[2 * k]) * metres
            metric[3 * CHUNK + k] = pick(z, label_row[2 * k], water, nearest, most)
            names[k] = np.int32(np.float32(label_row[2 * k]) * scale)
    elif across == 4:
        for k in range(n):
            z = np.float32(row[4 * k]) * metres
            metric[3 * CHUNK + k] = pick(z, label_row[4 * k], water, nearest, most)
            names[k] = np.int32(np.float32(label_row[4 * k]) * scale)
    else:
        for k in range(n):
            z = np.float32(row[8 * k]) * metres
            metric[3 * CHUNK + k] = pick(z, label_row[8 * k], water, nearest, most)
            names[k] = np.int32(np.float32(label_row[8 * k]) * scale)
    found = np.int32(0)
    for k in range(n):
        found += np.int32(metric[3 * CHUNK + k] > np.float32(0.0))
    return found


@njit(cache=True, nogil=True)
def lay_out(metric, columns, n, ray):
    """Offsets from the camera in the world."""
    ray_x, ray_y, ray_z = ray
    for k in range(n):
        z = metric[3 * CHUNK + k]
        metric[k] = z * (columns[k] + ray_x)
        metric[CHUNK + k] = z * (columns[CHUNK + k] + ray_y)
        metric[2 * CHUNK + k] = z * (columns[2 * CHUNK + k] + ray_z)


@njit(cache=True, nogil=True)
def reach_out(metric, farther, n):
    """Keep x, y and the squared distance of the farthest return of every column."""
    for k in range(n):
        x, y = metric[k], metric[CHUNK + k]
        square = x * x + y * y
        more = square > farther[2 * CHUNK + k]
        farther[k] = x if more else farther[k]
        farther[CHUNK + k] = y if more else farther[CHUNK + k]
        farther[2 * CHUNK + k] = square if more else farther[2 * CHUNK + k]


@njit(cache=True, nogil=True)
def place(metric, names, samples, heights, n, frame, square_reach, inside, stride):
    """Cells with their labels, −1 for none, and heights of a row; how many have a cell."""
    left, bottom, up, per_cell = frame
    first_row, past_row, first_col, past_col = inside
    found = np.int32(0)
    for k in range(n):
        x, y = metric[k], metric[CHUNK + k]
        near = (x * x + y * y <= square_reach) & (metric[3 * CHUNK + k] > np.float32(0.0))
        j = np.int32(left + x * per_cell)
        i = np.int32(bottom + y * per_cell)
        near = near & (i >= first_row) & (i < past_row) & (j >= first_col) & (j < past_col)
        packed = ((i * stride + j) << np.int32(LABEL_BITS)) | names[k]
        samples[k] = packed if near else np.int32(-1)
        found += np.int32(near)
    for k in range(n):
        heights[k] = up + metric[2 * CHUNK + k]
    return found


@njit(cache=True, nogil=True)
def sum_ground(
    first, past, samples, heights, kind_of, post_of, prior, prior_room, post_sum, post_count
):
    """Add some of the seabed's samples to their posts."""
    for k in range(first, past, GROUND_STEP):
        if samples[k] < 0:
            continue
        kind = kind_of[samples[k] & LABEL_MASK]
        post = post_of[samples[k] >> LABEL_BITS]
        if kind == GROUND or (kind == UNSURE and abs(heights[k] - prior[post]) <= prior_room):
            post_sum[post] += heights[k]
            post_count[post] += 1.0


# ---------------------------------------------------------------------------------------------------
# The seabed
# ---------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def smooth_ground(total, count, levels, share, trust, datum, region):
    """Height of every post in a region, from means on grids that are 2, 4, ... 2^levels times coarser.

    A mean is drawn to the bilinear value of the next coarser grid as by `trust` points; in it, a post weighs at
    most as much as `share` points. Where a coarsest post has no point, it lies at the datum. What lies two of
    the coarsest posts away from the region has no influence.

    Args:
        total: (rows, cols) float64 sums of heights; both sides are whole numbers of coarsest posts.
        count: (rows, cols) float64 points in them.
        levels: See above.
        share: Points.
        trust: Points.
        datum: World z.
        region: (first row, past row, first col, past col).

    Returns:
        (rows, cols) float64, metres in the world, only in the region.
    """
    sums, counts, below = total, count, [(total, count)]
    for _ in range(levels):
        sums, counts = pull(sums, counts, share)
        below.append((sums, counts))
    means = np.empty(sums.shape)
    for i in range(means.shape[0]):
        for j in range(means.shape[1]):
            means[i, j] = sums[i, j] / counts[i, j] if counts[i, j] > 0.0 else datum
    for level in range(levels - 1, -1, -1):
        sums, counts = below[level]
        # A finer grid looks one post beyond what is asked of it.
        margin = 0 if level == 0 else 2
        means = push(
            sums,
            counts,
            means,
            trust,
            max((region[0] >> level) - margin, 0),
            min((region[1] >> level) + margin + 1 if level else region[1], sums.shape[0]),
            max((region[2] >> level) - margin, 0),
            min((region[3] >> level) + margin + 1 if level else region[3], sums.shape[1]),
        )
    return means


@njit(cache=True, nogil=True)
def pull(total, count, share):
    """Sums and counts of 2 × 2 posts; no post weighs more than `share`."""
    rows, cols = total.shape[0] // 2, total.shape[1] // 2
    sums, counts = np.zeros((rows, cols)), np.zeros((rows, cols))
    for i in range(2 * rows):
        for j in range(2 * cols):
            points = count[i, j]
            if points > 0.0:
                weight = min(points, share)
                sums[i >> 1, j >> 1] += total[i, j] / points * weight
                counts[i >> 1, j >> 1] += weight
    return sums, counts


@njit(cache=True, nogil=True)
def push(total, count, coarse, trust, first_row, past_row, first_col, past_col):
    """Means in a region, each drawn to the bilinear value of the coarser grid as by `trust` points."""
    means = np.empty(total.shape)
    rows, cols = coarse.shape
    for i in range(first_row, past_row):
        y = max(0.5 * i - 0.25, 0.0)
        i0 = int(y)
        i1 = min(i0 + 1, rows - 1)
        fy = y - i0
        for j in range(first_col, past_col):
            x = max(0.5 * j - 0.25, 0.0)
            j0 = int(x)
            j1 = min(j0 + 1, cols - 1)
            fx = x - j0
            lower = coarse[i0, j0] * (1.0 - fx) + coarse[i0, j1] * fx
            upper = coarse[i1, j0] * (1.0 - fx) + coarse[i1, j1] * fx
            prior = lower * (1.0 - fy) + upper * fy
            means[i, j] = (total[i, j] + trust * prior) / (count[i, j] + trust)
    return means


@njit(cache=True, nogil=True)
def spread_ground(posts, low_row, low_col, post_bits, side, ground):
    """Height at every cell's centre of the window, bilinear between the posts' centres.

    Args:
        posts: Heights; the window's first is [low_row, low_col], and there is one more around.
        low_row, low_col: See `posts`.
        post_bits: A post is 2 to this many cells wide.
        side: Cells along the window.
        ground: (side²) float32, out.
    """
    width = 1 << post_bits
    count = (side >> post_bits) + 2
    line = np.empty(count, np.float32)
    share = ((np.arange(width) + 0.5) / width).astype(np.float32)
    half = width >> 1
    row = np.empty((count - 1) * width, np.float32)
    for i in range(side):
        y = (i + 0.5) / width - 0.5 + low_row
        i0 = int(y)
        fy = y - i0
        for p in range(count):
            line[p] = posts[i0, low_col - 1 + p] * (1.0 - fy) + posts[i0 + 1, low_col - 1 + p] * fy
        for p in range(count - 1):
            a, step = line[p], line[p + 1] - line[p]
            for k in range(width):
                row[p * width + k] = a + step * share[k]
        # The first post's centre lies half a post before the window.
        ground[i * side : (i + 1) * side] = row[width - half : width - half + side]


# ---------------------------------------------------------------------------------------------------
# Evidence and visibility
# ---------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def count_returns(count, samples, heights, ground, band, weight_of, counts, targets):
    """Sort the samples of every cell by their height above the seabed; see `FIELD_BITS`."""
    lower, middle, upper = np.float32(band[0]), np.float32(band[1]), np.float32(band[2])
    for k in range(count):
        sample = samples[k]
        if sample < 0:
            continue
        cell = sample >> LABEL_BITS
        above = heights[k] - ground[cell]
        field = np.uint64(above >= lower) + np.uint64(above > middle) + np.uint64(above > upper)
        counts[cell] += np.uint64(1) << (field * np.uint64(FIELD_BITS))
        weight = weight_of[sample & LABEL_MASK]
        if weight:
            targets[cell] += weight


@njit(cache=True, nogil=True)
def field_of(packed, field):
    """One of the four counts of a cell."""
    return np.int64((packed >> np.uint64(FIELD_BITS * field)) & np.uint64(FIELD_MASK))


@njit(cache=True, nogil=True)
def weigh(
    counts,
    targets,
    side,
    camera_row,
    camera_col,
    steps,
    clamp,
    least,
    noise,
    size,
    log_odds,
    flags,
    bits,
    votes,
    offset_row,
    offset_col,
    touched,
):
    """One step of log-odds and one vote per cell that has returns.

    Args:
        counts: (side²) uint64, see `FIELD_BITS`.
        targets: (side²) int32, in parts of `WEIGHT`.
        side: Cells along the window.
        camera_row, camera_col: The camera, in cells.
        steps: (hit or miss, miss where what is solid was not seen to reach down), log-odds units.
        clamp: (lowest, highest) log-odds.
        least: (pixels of a hit, their share of the cell's, their share of what lies just behind, pixels of a
            miss, pixels of a vote, target share of a yes).
        noise: Standard deviation of the depth, as a multiple of its square.
        size: Metres a cell.
        log_odds: (side²) int8, changed.
        flags: (side²) uint8 as they were.
        bits: (side²) uint8, out: flags to set.
        votes: (side²) uint8, out: 1 target, 2 another thing.
        offset_row, offset_col: The window's low corner inside the first block.
        touched: (block rows, block cols) bool, out: blocks of which the frame says something.
    """
    step, doubt = steps
    low, high = clamp
    hit_pixels, hit_share, peak_share, miss_pixels, vote_pixels, vote_share = least
    for i in range(side):
        for j in range(side):
            c = i * side + j
            if counts[c] == 0:
                continue
            touched[(offset_row + i) >> BLOCK_BITS, (offset_col + j) >> BLOCK_BITS] = True
            below, low_band = field_of(counts[c], 0), field_of(counts[c], 1)
            band = low_band + field_of(counts[c], 2)
            total = below + band + field_of(counts[c], 3)
            bits[c] = RETURNED | (BARE | SEABED if below > 0 else 0) | (SEABED if targets[c] > 0 else 0)
            if total >= vote_pixels:
                votes[c] = 1 if targets[c] >= vote_share * WEIGHT * total else 2
            if band >= hit_pixels and band >= hit_share * total:
                up, right = i + 0.5 - camera_row, j + 0.5 - camera_col
                away = math.hypot(up, right)
                scatter = noise * size * away * away
                peak = band
                for k in range(1, math.ceil(2.0 * scatter - 0.3) + 1):
                    a = math.floor(i + 0.5 + k * up / away)
                    b = math.floor(j + 0.5 + k * right / away)
                    if 0 <= a < side and 0 <= b < side:
                        beyond = a * side + b
                        peak = max(peak, field_of(counts[beyond], 1) + field_of(counts[beyond], 2))
                if band < peak_share * peak:
                    # What scatters to this side of a surface passed through here more often than it ended.
                    log_odds[c] = max(log_odds[c] - step // 2, low)
                    continue
                sure = min(1.0, 0.5 / max(scatter, 1e-9))
                log_odds[c] = min(log_odds[c] + max(round(step * sure), 1), high)
                if low_band > 0:
                    bits[c] |= GROUNDED
            elif band < hit_pixels and below >= miss_pixels:
                down = log_odds[c] <= 0 or flags[c] & GROUNDED
                log_odds[c] = max(log_odds[c] - (step if down else doubt), low)


@njit(cache=True, nogil=True)
def cast_frame(
    row,
    col,
    t_rows,
    t_cols,
    t_x,
    t_y,
    t_distance,
    t_first,
    t_last,
    forward_x,
    forward_y,
    cos_half,
    blind,
    level,
    per_metre,
    farthest,
    side,
    clip,
    counts,
    miss,
    lowest,
    log_odds,
    bits,
    offset_row,
    offset_col,
    touched,
):
    """Cast one frame's rays: explore and cross what they reach, wear down what they pass without a return.

    `farthest` holds, for each ray, the metres that it is known to have run; `level` tells whether rays at the
    vehicle's own height are in the image.
    """
    first_row, past_row, first_col, past_col = clip
    blocked = np.zeros(RAY_MASK + 1, dtype=np.bool_)
    for k in range(len(t_rows)):
        forward = t_x[k] * forward_x + t_y[k] * forward_y
        inward = forward - t_distance[k] * cos_half
        # The rays of the sector pass cells with their centre outside of it, but not by more than a diagonal.
        if inward < -1.5:
            continue
        i, j = row + t_rows[k], col + t_cols[k]
        if i < first_row or i >= past_row or j < first_col or j >= past_col:
            continue
        c = i * side + j
        if inward >= -SECTOR_SLACK:
            first, last = t_first[k], t_last[k]
            ran = farthest[((first + last) >> 1) & RAY_MASK]
            # One more cell, since the farthest return lies anywhere in its own.
            if ran > 0.0 and t_distance[k] <= ran * per_metre + 1.0 and any_open(blocked, first, last):
                if forward >= blind - SECTOR_SLACK:
                    bits[c] |= EXPLORED
                    touched[(offset_row + i) >> BLOCK_BITS, (offset_col + j) >> BLOCK_BITS] = True
                    if counts[c] == 0 and all_open(blocked, first, last):
                        log_odds[c] = max(log_odds[c] - miss, lowest)
                if level and log_odds[c] <= 0:
                    bits[c] |= CROSSED
                    touched[(offset_row + i) >> BLOCK_BITS, (offset_col + j) >> BLOCK_BITS] = True
        if log_odds[c] > 0:
            block(blocked, t_first[k], t_last[k])


# ---------------------------------------------------------------------------------------------------
# Blocks to the window, and back
# ---------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def gather(log_odds_pool, flags_pool, table, offset_row, offset_col, side, log_odds, flags):
    """Copy two layers of the window out of their blocks.

    Args:
        log_odds_pool, flags_pool: (slots, BLOCK, BLOCK).
        table: (block rows, block cols) slots.
        offset_row, offset_col: The window's low corner inside the first block.
        side: Cells along the window.
        log_odds, flags: (side²), out.
    """
    for i in range(side):
        block_row, y = (offset_row + i) >> BLOCK_BITS, (offset_row + i) & (BLOCK - 1)
        j = 0
        while j < side:
            block_col, x = (offset_col + j) >> BLOCK_BITS, (offset_col + j) & (BLOCK - 1)
            width = min(BLOCK - x, side - j)
            slot, c = table[block_row, block_col], i * side + j
            if slot:
                log_odds[c : c + width] = log_odds_pool[slot, y, x : x + width]
                flags[c : c + width] = flags_pool[slot, y, x : x + width]
            else:
                log_odds[c : c + width] = 0
                flags[c : c + width] = 0
            j += width


@njit(cache=True, nogil=True)
def gather_posts(sum_pool, count_pool, table, offset_row, offset_col, total, count):
    """Copy a window of (rows, cols) posts out of their blocks, as float64."""
    n = sum_pool.shape[1]
    for i in range(total.shape[0]):
        block_row, y = (offset_row + i) // n, (offset_row + i) % n
        j = 0
        while j < total.shape[1]:
            block_col, x = (offset_col + j) // n, (offset_col + j) % n
            width = min(n - x, total.shape[1] - j)
            slot = table[block_row, block_col]
            for k in range(width):
                total[i, j + k] = sum_pool[slot, y, x + k]
                count[i, j + k] = count_pool[slot, y, x + k]
            j += width


@njit(cache=True, nogil=True)
def commit(
    log_odds_pool,
    flags_pool,
    votes_pool,
    stamps,
    table,
    touched,
    offset_row,
    offset_col,
    side,
    log_odds,
    bits,
    votes,
    stamp,
):
    """Write the window into its blocks.

    Returns:
        (first row, past row, first col, past col) of the window in which something became solid or known, or
        ceased to be; empty where nothing did.
    """
    first_row, past_row, first_col, past_col = side, 0, side, 0
    for i in range(side):
        block_row, y = (offset_row + i) >> BLOCK_BITS, (offset_row + i) & (BLOCK - 1)
        j = 0
        while j < side:
            block_col, x = (offset_col + j) >> BLOCK_BITS, (offset_col + j) & (BLOCK - 1)
            width = min(BLOCK - x, side - j)
            if touched[block_row, block_col]:
                slot, c = table[block_row, block_col], i * side + j
                stamps[slot] = stamp
                if renew(
                    log_odds_pool[slot, y, x : x + width],
                    flags_pool[slot, y, x : x + width],
                    log_odds[c : c + width],
                    bits[c : c + width],
                ):
                    first_row, past_row = min(first_row, i), max(past_row, i + 1)
                    first_col, past_col = min(first_col, j), max(past_col, j + width)
                cast_votes(votes[c : c + width], votes_pool[slot, y, x : x + width])
            j += width
    return first_row, past_row, first_col, past_col


@njit(cache=True, nogil=True)
def renew(odds, flags, log_odds, bits):
    """Write a row of cells; did one become solid or known, or cease to be?"""
    change = np.uint8(0)
    for k in range(len(odds)):
        old = flags[k]
        solid, was = log_odds[k] > 0, odds[k] > 0
        new = (old | bits[k]) & (np.uint8(0xFF) if solid else np.uint8(0xFF ^ GROUNDED))
        known, knew = solid | ((new & np.uint8(KNOWN)) != 0), was | ((old & np.uint8(KNOWN)) != 0)
        change |= np.uint8(known ^ knew) | np.uint8(solid ^ was)
        flags[k] = new
        odds[k] = log_odds[k]
    return change != 0


@njit(cache=True, nogil=True)
def cast_votes(votes, row):
    """Count votes: for the target in the high half of a byte, against it in the low one; both halved when full."""
    some = np.uint8(0)
    for k in range(len(votes)):
        some |= votes[k]
    if some == 0:
        return
    for k in range(len(votes)):
        vote = votes[k]
        if vote:
            yes, no = row[k] >> 4, row[k] & 15
            if (vote == 1 and yes == 15) or (vote == 2 and no == 15):
                yes, no = yes >> 1, no >> 1
            row[k] = ((yes + (vote == 1)) << 4) | (no + (vote == 2))


@njit(cache=True, nogil=True)
def commit_ground(sum_pool, count_pool, table, offset_row, offset_col, total, count, memory):
    """Add a window of (rows, cols) posts to their blocks where there is one; a post remembers `memory` points."""
    n = sum_pool.shape[1]
    for i in range(total.shape[0]):
        for j in range(total.shape[1]):
            if count[i, j] == 0.0:
                continue
            slot = table[(offset_row + i) // n, (offset_col + j) // n]
            if slot == 0:
                continue
            y, x = (offset_row + i) % n, (offset_col + j) % n
            points = count_pool[slot, y, x] + count[i, j]
            mean = (sum_pool[slot, y, x] + total[i, j]) / points
            points = min(points, memory)
            sum_pool[slot, y, x] = mean * points
            count_pool[slot, y, x] = points
