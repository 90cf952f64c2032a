"""What a frame says of a window of cells, and the window into the blocks."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dream.mapping._kernels.flags import (
    BARE,
    BLOCK,
    BLOCK_BITS,
    CROSSED,
    DOUBT_BITS,
    EXPLORED,
    GROUNDED,
    RAY_MASK,
    RETURNED,
    SEABED,
    WEIGHT,
)
from dream.mapping._kernels.pixels import LABEL_BITS, LABEL_MASK
from dream.mapping._kernels.sight import SECTOR_SLACK

FIELD_BITS = 16
"""A cell's counts are four fields of so many bits: pixels below the height band, in its lower part, in its
upper part, and above it."""
FIELD_MASK = (1 << FIELD_BITS) - 1
TARGET_MASK = (1 << DOUBT_BITS) - 1
SUM, COUNT, MEAN = 0, 1, 2
"""What is known of the seabed at a post."""
ONE = 2.0**52
"""A cell's length in the whole numbers of `cast_rays`; no ray is nearer to an axis than 1 in 326."""
RAN, ENDED = 1, 2
"""A ray came to a cell, or would have if it had not ended before."""


# ---------------------------------------------------------------------------------------------------
# The seabed
# ---------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def smooth_ground(posts, rows, cols, levels, share, trust, datum, region):
    """Height of every post in a region, from means on grids that are 2, 4, ... 2^levels times coarser.

    A mean is drawn to the bilinear value of the next coarser grid as by `trust` points; in it, a post
    weighs at most as much as `share` points. Where a coarsest post has no point, it lies at the datum.
    What lies two of the coarsest posts away from the region has no influence.

    Args:
        posts: (levels + 1, 3, rows or more, cols or more) float64: for each grid, the finest first, sums of
            heights, the points in them, and means. Sums and points of the finest are given, its means in the
            region are what is wanted: metres in the world.
        rows, cols: Whole numbers of coarsest posts.
        levels: See above.
        share: Points.
        trust: Points.
        datum: World z.
        region: (first row, past row, first col, past col).
    """
    for level in range(levels):
        pull(posts, level, rows >> level, cols >> level, share)
    for i in range(rows >> levels):
        for j in range(cols >> levels):
            count = posts[levels, COUNT, i, j]
            posts[levels, MEAN, i, j] = posts[levels, SUM, i, j] / count if count > 0.0 else datum
    for level in range(levels - 1, -1, -1):
        # A finer grid looks one post beyond what is asked of it.
        margin = 0 if level == 0 else 2
        push(
            posts,
            level,
            rows >> level + 1,
            cols >> level + 1,
            trust,
            max((region[0] >> level) - margin, 0),
            min((region[1] >> level) + margin + 1 if level else region[1], rows >> level),
            max((region[2] >> level) - margin, 0),
            min((region[3] >> level) + margin + 1 if level else region[3], cols >> level),
        )


@njit(cache=True, nogil=True)
def pull(posts, level, rows, cols, share):
    """Sums and counts of 2 × 2 posts; no post weighs more than `share`."""
    coarse = level + 1
    for i in range(rows // 2):
        for j in range(cols // 2):
            posts[coarse, SUM, i, j], posts[coarse, COUNT, i, j] = 0.0, 0.0
    for i in range(rows):
        for j in range(cols):
            points = posts[level, COUNT, i, j]
            if points > 0.0:
                weight = min(points, share)
                posts[coarse, SUM, i >> 1, j >> 1] += posts[level, SUM, i, j] / points * weight
                posts[coarse, COUNT, i >> 1, j >> 1] += weight


@njit(cache=True, nogil=True)
def push(posts, level, rows, cols, trust, first_row, past_row, first_col, past_col):
    """Means in a region, each drawn to the bilinear value of the coarser grid as by `trust` points."""
    coarse = level + 1
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
            lower = posts[coarse, MEAN, i0, j0] * (1.0 - fx) + posts[coarse, MEAN, i0, j1] * fx
            upper = posts[coarse, MEAN, i1, j0] * (1.0 - fx) + posts[coarse, MEAN, i1, j1] * fx
            prior = lower * (1.0 - fy) + upper * fy
            posts[level, MEAN, i, j] = (posts[level, SUM, i, j] + trust * prior) / (
                posts[level, COUNT, i, j] + trust
            )


@njit(cache=True, nogil=True)
def spread_ground(posts, window, wide, ground):
    """Height at every cell's centre of the window, bilinear between the posts' centres.

    Args:
        posts: `Posts` with heights of the window's and of one more around.
        window: A `CellWindow`.
        wide: See `Scratch`.
        ground: (side²) float32, out.
    """
    side, post_bits = window.side, window.post_bits
    low_row, low_col = posts.first_row, posts.first_col
    width, count = 1 << post_bits, (side >> post_bits) + 2
    half = width >> 1
    # First along the rows of posts, then between them.
    for p in range(count):
        for q in range(count - 1):
            a = np.float32(posts.grids[0, MEAN, low_row - 1 + p, low_col - 1 + q])
            rise = np.float32(posts.grids[0, MEAN, low_row - 1 + p, low_col + q]) - a
            for k in range(width):
                wide[p, q * width + k] = a + rise * np.float32((k + 0.5) / width)
    # The first post's centre lies half a post before the window. Unsigned, see `clear`.
    skip = np.uint64(width - half)
    for i in range(side):
        p, fy = (i + half) >> post_bits, np.float32((((i + half) & (width - 1)) + 0.5) / width)
        for j in range(np.uint64(side)):
            south, north = wide[p, skip + j], wide[p + 1, skip + j]
            ground[np.uint64(i * side) + j] = south + (north - south) * fy


# ---------------------------------------------------------------------------------------------------
# Evidence and visibility
# ---------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def count_returns(count, samples, rule, scratch):
    """Sort the samples of every cell by their height above the seabed; see `FIELD_BITS`.

    Args:
        count: How many samples there are.
        samples: `Samples`.
        rule: A `WeighingRule`.
        scratch: `Scratch` with the ground; counts and targets are added to.
    """
    cells, heights, weight_of = samples.cells, samples.heights, rule.weight_of
    ground, counts, targets = scratch.ground, scratch.counts, scratch.targets
    above, shifts = scratch.above, scratch.shifts
    lower, middle, upper = np.float32(rule.lower), np.float32(rule.middle), np.float32(rule.upper)
    for first in range(np.uint64(0), np.uint64(count), np.uint64(len(shifts))):
        n = min(np.uint64(count) - first, np.uint64(len(shifts)))
        for k in range(n):
            above[k] = ground[np.uint32(cells[first + k] >> LABEL_BITS)]
        # By itself, this is vectorised. Fields are below the band, its lower and its upper part, above it.
        # The band is h_min ≤ h ≤ h_max of Eq. 5, with h above the local seabed.
        for k in range(n):
            height = heights[first + k] - above[k]
            field = np.int32(height >= lower) + np.int32(height > middle) + np.int32(height > upper)
            shifts[k] = np.int32(field * np.int32(FIELD_BITS))
        for k in range(n):
            label, cell = cells[first + k] & LABEL_MASK, np.uint32(cells[first + k] >> LABEL_BITS)
            counts[cell] += np.uint64(1) << np.uint64(shifts[k])
            weight = weight_of[label]
            if weight:
                targets[cell] += weight


@njit(cache=True, nogil=True)
def clear(window, scratch, said):
    """Zeros over the part of the window that is written."""
    side, first_col, past_col = window.side, window.first_col, window.past_col
    counts, targets, paths, bits, votes = (
        scratch.counts,
        scratch.targets,
        scratch.paths,
        said.bits,
        said.votes,
    )
    for i in range(window.first_row, window.past_row):
        # Unsigned, no index is taken for one from the end, and the loop is vectorised.
        for c in range(np.uint64(i * side + first_col), np.uint64(i * side + past_col)):
            counts[c] = 0
            targets[c] = 0
            bits[c] = 0
            votes[c] = 0
            paths[c] = 0


@njit(cache=True, nogil=True)
def field_of(packed, field):
    """One of the four counts of a cell."""
    return np.int64((packed >> np.uint64(FIELD_BITS * field)) & np.uint64(FIELD_MASK))


@njit(cache=True, nogil=True)
def reaches_down(flags, side, row, col):
    """Was what was solid in a cell before, or in one that it touches, seen down to the band's lower edge?"""
    for i in range(max(row - 1, 0), min(row + 2, side)):
        for j in range(max(col - 1, 0), min(col + 2, side)):
            if flags[i * side + j] & GROUNDED:
                return True
    return False


# One loop: Eq. 4 to 6 decide about a cell together.
@njit(cache=True, nogil=True)
def weigh(window, sector, rule, scratch, said):
    """One step of log-odds and one vote per cell that has returns."""
    side, size, camera_row, camera_col = window.side, window.cell, window.y, window.x
    first_row, past_row, first_col, past_col = (
        window.first_row,
        window.past_row,
        window.first_col,
        window.past_col,
    )
    counts, targets, flags = scratch.counts, scratch.targets, scratch.flags
    log_odds, bits, votes, touched = said
    step, low, high = rule.step, rule.lowest, rule.highest
    for i in range(first_row, past_row):
        for j in range(first_col, past_col):
            c = i * side + j
            if counts[c] == 0:
                continue
            touched[(window.row + i) >> BLOCK_BITS, (window.col + j) >> BLOCK_BITS] = True
            below, low_band = field_of(counts[c], 0), field_of(counts[c], 1)
            band = low_band + field_of(counts[c], 2)
            total = below + band + field_of(counts[c], 3)
            target, sum_sure = targets[c] & TARGET_MASK, WEIGHT * total - (targets[c] >> DOUBT_BITS)
            # Its pixels' mean confidence, which all that they say counts by.
            trust = sum_sure / (WEIGHT * total)
            bits[c] = RETURNED | (BARE | SEABED if below > 0 else 0) | (SEABED if target > 0 else 0)
            # Eq. 4: a point is target by its mask, at any height. Its cell has a vote, a whole one or none.
            # Too few for a hit are errors.
            if total - (band if band < rule.hit_pixels else 0) >= rule.vote_pixels and trust >= 0.5:
                if target >= rule.vote_share * sum_sure:
                    votes[c] = 1
                elif target <= rule.against_share * sum_sure:
                    votes[c] = 2
            # Eq. 5: what is in the band is an obstacle, here whatever its mask: a wreck stops the vehicle.
            if band >= rule.hit_pixels and band >= rule.hit_share * total:
                up, right = i + 0.5 - camera_row, j + 0.5 - camera_col
                square = up * up + right * right
                away, scatter = math.sqrt(square), rule.noise * size * square
                peak = band
                for k in range(1, math.ceil(2.0 * scatter - 0.3) + 1):
                    a = math.floor(i + 0.5 + k * up / away)
                    b = math.floor(j + 0.5 + k * right / away)
                    if first_row <= a < past_row and first_col <= b < past_col:
                        beyond = a * side + b
                        peak = max(peak, field_of(counts[beyond], 1) + field_of(counts[beyond], 2))
                if band < rule.peak_share * peak:
                    # What scatters to this side of a surface passed through here more often than it ended.
                    log_odds[c] = max(log_odds[c] - part(step // 2, trust), low)
                    continue
                sure = trust * min(1.0, 0.5 / max(scatter, 1e-9))
                log_odds[c] = min(log_odds[c] + part(step, sure), high)
                if low_band > 0:
                    bits[c] |= GROUNDED
            # Eq. 6: the rest is free.
            elif band < rule.hit_share * total and below >= rule.miss_pixels:
                up, right = i + 0.5 - camera_row, j + 0.5 - camera_col
                # Beside the sector the image shows the foot of a cell at most.
                distance = math.sqrt(up * up + right * right)
                if (
                    right * sector.forward_x + up * sector.forward_y
                    < distance * sector.cos_half - SECTOR_SLACK
                ):
                    continue
                down = log_odds[c] <= 0 or reaches_down(flags, side, i, j)
                log_odds[c] = max(log_odds[c] - part(step if down else rule.doubt, trust), low)


@njit(cache=True, nogil=True)
def part(step, trust):
    """A step of log-odds, as far as it is trusted; some of it always."""
    return min(max(round(step * trust), 1), step)


@njit(cache=True, nogil=True)
def cast_rays(window, sector, directions, farthest, log_odds, paths):
    """Walk one frame's rays over the window (Amanatides and Woo, 1987); a solid cell ends a ray.

    The second condition of Eq. 7: nothing solid lies between the vehicle and the cell.

    Args:
        window: A `CellWindow`.
        sector: A `Sector`.
        directions: (RAYS, 2) cosine and sine.
        farthest: See `Samples`.
        log_odds: (side²).
        paths: (side²), added to: `RAN`, `ENDED`.
    """
    x, y, side, reach, per_metre = window.x, window.y, window.side, sector.reach, 1.0 / window.cell
    for number in range(sector.first, sector.last + 1):
        ray = number & RAY_MASK
        if farthest[ray] <= 0.0:
            continue
        runs = min(farthest[ray] * per_metre, reach)
        dx, dy = directions[ray, 0], directions[ray, 1]
        i, j = math.floor(y), math.floor(x)
        c = i * side + j
        step_i, step_j = (side if dy > 0.0 else -side), (1 if dx > 0.0 else -1)
        along_i, along_j = abs(1.0 / dy), abs(1.0 / dx)
        next_i = (i + 1 - y if dy > 0.0 else y - i) * along_i
        next_j = (j + 1 - x if dx > 0.0 else x - j) * along_j
        may_run = 1 + lines_within(runs, next_i, along_i) + lines_within(runs, next_j, along_j)
        cells = 1 + lines_within(reach, next_i, along_i) + lines_within(reach, next_j, along_j)
        # By how much the next column is farther than the next row. In whole numbers, and without a branch:
        # which of them comes first follows no pattern that a processor could foresee.
        ahead = np.int64((next_j - next_i) * ONE)
        back, turn = np.int64(along_i * ONE), np.int64(along_i * ONE) + np.int64(along_j * ONE)
        aside = step_j - step_i
        entered = 0
        while entered < may_run:
            entered += 1
            paths[np.uint64(c)] |= RAN
            ended = log_odds[np.uint64(c)] > 0
            column = ahead >> 63
            c += step_i + (aside & column)
            ahead += (turn & column) - back
            if ended:
                break
        for _ in range(entered, cells):
            paths[np.uint64(c)] |= ENDED
            column = ahead >> 63
            c += step_i + (aside & column)
            ahead += (turn & column) - back


@njit(cache=True, nogil=True)
def lines_within(distance, first, between):
    """How many lines a ray crosses up to a distance, given how far the first is and those after it."""
    return math.floor((distance - first) / between) + 1 if first <= distance else 0


@njit(cache=True, nogil=True)
def explore(window, sector, rule, scratch, said):
    """Explore and cross what the rays reach of the sector; wear down what all pass without a return."""
    x, y, side, reach, cos_half = window.x, window.y, window.side, sector.reach, sector.cos_half
    forward_x, forward_y, blind = sector.forward_x, sector.forward_y, sector.blind
    counts, paths = scratch.counts, scratch.paths
    log_odds, bits, _, touched = said
    farthest = (reach + SECTOR_SLACK) ** 2
    for i in range(window.first_row, window.past_row):
        up = i + 0.5 - y
        for j in range(window.first_col, window.past_col):
            c = i * side + j
            if not paths[c] & RAN:
                continue
            right = j + 0.5 - x
            forward, square = right * forward_x + up * forward_y, right * right + up * up
            # Eq. 7: within d_max, and within half the field of view of where the camera looks.
            if square > farthest or forward < math.sqrt(square) * cos_half - SECTOR_SLACK:
                continue
            said = np.uint8(0)
            if forward >= blind - SECTOR_SLACK:
                said |= np.uint8(EXPLORED)
                if counts[c] == 0 and not paths[c] & ENDED:
                    log_odds[c] = max(log_odds[c] - rule.step, rule.lowest)
            if sector.level and log_odds[c] <= 0:
                said |= np.uint8(CROSSED)
            if said:
                bits[c] |= said  # Eq. 8: what was explored stays so, see `renew`.
                touched[(window.row + i) >> BLOCK_BITS, (window.col + j) >> BLOCK_BITS] = True


# ---------------------------------------------------------------------------------------------------
# Blocks to the window, and back
# ---------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def gather(pools, table, window, log_odds, flags):
    """Copy two layers of the part of the window that is written out of their blocks.

    Args:
        pools: `Pools`.
        table: (block rows, block cols) slots of the blocks around the window.
        window: A `CellWindow`.
        log_odds, flags: (side²), out.
    """
    log_odds_pool, flags_pool, side = pools.log_odds, pools.flags, window.side
    first_col, past_col = window.first_col, window.past_col
    for i in range(window.first_row, window.past_row):
        block_row, y = (window.row + i) >> BLOCK_BITS, (window.row + i) & (BLOCK - 1)
        j = first_col
        while j < past_col:
            block_col, x = (window.col + j) >> BLOCK_BITS, (window.col + j) & (BLOCK - 1)
            width = min(BLOCK - x, past_col - j)
            # Slot 0 holds zeros. Unsigned, see `clear`.
            slot, row, col = np.uint64(table[block_row, block_col]), np.uint64(y), np.uint64(x)
            c = np.uint64(i * side + j)
            for k in range(np.uint64(width)):
                log_odds[c + k] = log_odds_pool[slot, row, col + k]
                flags[c + k] = flags_pool[slot, row, col + k]
            j += width


@njit(cache=True, nogil=True)
def gather_posts(pools, table, posts):
    """Copy the posts that the window's ground depends on out of their blocks."""
    sum_pool, count_pool, grids = pools.ground_sum, pools.ground_count, posts.grids
    n, rows, cols = sum_pool.shape[1], posts.rows, posts.cols
    for i in range(rows):
        block_row, y = (posts.row + i) // n, (posts.row + i) % n
        j = 0
        while j < cols:
            block_col, x = (posts.col + j) // n, (posts.col + j) % n
            width = min(n - x, cols - j)
            slot = table[block_row, block_col]
            for k in range(width):
                grids[0, SUM, i, j + k] = sum_pool[slot, y, x + k]
                grids[0, COUNT, i, j + k] = count_pool[slot, y, x + k]
            j += width


@njit(cache=True, nogil=True)
def commit(pools, stamps, table, window, said, seabed, stamp, memory):
    """Write the window, as far as a frame says something of it, into its blocks.

    Args:
        pools: `Pools`.
        stamps: (slots,) int64, out: `stamp` in those that are written.
        table: (block rows, block cols) slots of the blocks around the window, made where `said.touched`.
        window: A `CellWindow`.
        said: What `read_frame` found.
        seabed: A `SeabedSamples`.
        stamp: Number of the change.
        memory: Points of the seabed that a post remembers.
    """
    commit_ground(pools, table, window, said.touched, seabed, memory)
    for i in range(window.first_row, window.past_row):
        block_row, y = (window.row + i) >> BLOCK_BITS, (window.row + i) & (BLOCK - 1)
        j = window.first_col
        while j < window.past_col:
            block_col, x = (window.col + j) >> BLOCK_BITS, (window.col + j) & (BLOCK - 1)
            width = min(BLOCK - x, window.past_col - j)
            if said.touched[block_row, block_col]:
                slot = table[block_row, block_col]
                stamps[slot] = stamp
                # Unsigned, see `clear`.
                at, c, n = (
                    (np.uint64(slot), np.uint64(y), np.uint64(x)),
                    np.uint64(i * window.side + j),
                    np.uint64(width),
                )
                renew(pools, at, said, c, n)
                cast_votes(said.votes, c, n, pools.votes, at)
            j += width


@njit(cache=True, nogil=True)
def renew(pools, at, said, c, n):
    """Write n cells of a row. What was explored stays so: E_t = E_t−1 ∪ V_t (Eq. 8)."""
    odds_pool, flags_pool, log_odds, bits = pools.log_odds, pools.flags, said.log_odds, said.bits
    slot, row, col = at
    for k in range(n):
        old, odds = flags_pool[slot, row, col + k], log_odds[c + k]
        kept = np.uint8(0xFF) if odds > 0 else np.uint8(0xFF ^ GROUNDED)
        flags_pool[slot, row, col + k] = (old | bits[c + k]) & kept
        odds_pool[slot, row, col + k] = odds


@njit(cache=True, nogil=True)
def cast_votes(votes, c, n, pool, at):
    """Count votes: for the target in a byte's high half, against it in the low one; both halved when full."""
    some = np.uint8(0)
    for k in range(n):
        some |= votes[c + k]
    if some == 0:
        return
    slot, row, col = at
    for k in range(n):
        vote = votes[c + k]
        if vote:
            yes, no = pool[slot, row, col + k] >> 4, pool[slot, row, col + k] & 15
            if (vote == 1 and yes == 15) or (vote == 2 and no == 15):
                yes, no = yes >> 1, no >> 1
            pool[slot, row, col + k] = ((yes + (vote == 1)) << 4) | (no + (vote == 2))


@njit(cache=True, nogil=True)
def commit_ground(pools, table, window, touched, seabed, memory):
    """Add the window's posts to the blocks touched; a post remembers `memory` points."""
    sum_pool, count_pool = pools.ground_sum, pools.ground_count
    n, side = sum_pool.shape[1], window.side >> window.post_bits
    first_row, first_col = window.row >> window.post_bits, window.col >> window.post_bits
    total, count = seabed.total.reshape(side, side), seabed.points.reshape(side, side)
    for i in range(side):
        for j in range(side):
            if count[i, j] == 0.0:
                continue
            at = (first_row + i) // n, (first_col + j) // n
            if not touched[at]:
                continue
            slot = table[at]
            y, x = (first_row + i) % n, (first_col + j) % n
            points = count_pool[slot, y, x] + count[i, j]
            mean = (sum_pool[slot, y, x] + total[i, j]) / points
            points = min(points, memory)
            sum_pool[slot, y, x] = mean * points
            count_pool[slot, y, x] = points


# ---------------------------------------------------------------------------------------------------
# The whole
# ---------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def smooth_around(posts, side, margin):
    """Heights of the window's (side, side) posts, and of so many around, from the sums and counts there."""
    region = (
        posts.first_row - margin,
        posts.first_row + side + margin,
        posts.first_col - margin,
        posts.first_col + side + margin,
    )
    smooth_ground(
        posts.grids, posts.rows, posts.cols, posts.levels, posts.share, posts.trust, posts.datum, region
    )


@njit(cache=True, nogil=True)
def ground_before(pools, table, posts, side, prior):
    """(side²) heights of the seabed at the window's posts, before a frame, into `prior`."""
    gather_posts(pools, table, posts)
    smooth_around(posts, side, 0)
    for i in range(side):
        for j in range(side):
            prior[i * side + j] = posts.grids[0, MEAN, posts.first_row + i, posts.first_col + j]


@njit(cache=True, nogil=True)
def read_frame(pools, table, posts, window, samples, count, seabed, sector, directions, rule, scratch, said):
    """What a frame's samples say of every cell of the window.

    Args:
        pools: The map's `Pools`.
        table: (block rows, block cols) slots of the blocks around the window.
        posts: `Posts`.
        window: A `CellWindow`.
        samples, count, seabed: What `project` found.
        sector: A `Sector`.
        directions: See `cast_rays`.
        rule: A `WeighingRule`.
        scratch: `Scratch`.
        said: `FrameFindings`, out.
    """
    gather_posts(pools, table, posts)
    n = window.side >> window.post_bits
    for i in range(n):
        for j in range(n):
            posts.grids[0, SUM, posts.first_row + i, posts.first_col + j] += seabed.total[i * n + j]
            posts.grids[0, COUNT, posts.first_row + i, posts.first_col + j] += seabed.points[i * n + j]
    smooth_around(posts, n, 1)
    spread_ground(posts, window, scratch.wide, scratch.ground)

    clear(window, scratch, said)
    count_returns(count, samples, rule, scratch)
    gather(pools, table, window, said.log_odds, scratch.flags)
    said.touched[:] = False
    weigh(window, sector, rule, scratch, said)
    if sector.first <= sector.last:
        cast_rays(window, sector, directions, samples.farthest, said.log_odds, scratch.paths)
        explore(window, sector, rule, scratch, said)
