"""One frame into the map."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dream.mapping._kernels.sight import RAY_MASK, SECTOR_SLACK, all_open, any_open, block


@njit(cache=True, nogil=True)
def project_pixels(
    depth,
    labels,
    intrinsics,
    R,
    t,
    origin,
    size,
    limits,
    names,
    cells,
    heights,
    ground_sum,
    ground_count,
    seabed_seen,
    farthest,
):
    """Cell and world height of every pixel; sums of the seabed's heights; farthest return by direction.

    Args:
        depth: (H, W) float32 metres, NaN without return.
        labels: (H, W) uint8.
        intrinsics: (fx, fy, cx, cy).
        R: (3, 3), camera to world.
        t: (3,), likewise.
        origin: World x and y of the grid's lower-left corner.
        size: Metres a cell.
        limits: (min_depth, max_depth, reach), metres.
        names: The labels (water, seabed, target).
        cells: (H W) int32, out: flat cell, −1 for a pixel that counts for nothing.
        heights: (H W) float32, out: world z.
        ground_sum: (rows, cols), added to: z of seabed points.
        ground_count: (rows, cols), added to: number of them.
        seabed_seen: (rows, cols), added to: a seabed or target point fell in.
        farthest: (rays,), out: metres over ground to the farthest return of the image columns in that
            direction.
    """
    fx, fy, cx, cy = intrinsics
    water, seabed, target = names
    rows, cols = ground_sum.shape
    min_depth, max_depth, reach = limits
    height, width = depth.shape
    per_radian = (RAY_MASK + 1) / (2.0 * math.pi)
    per_metre = 1.0 / size
    from_left, from_bottom = t[0] - origin[0], t[1] - origin[1]
    square_reach = reach * reach
    column_x = np.zeros(width)
    column_y = np.zeros(width)
    column_square = np.zeros(width)
    for v in range(height):
        b = (v + 0.5 - cy) / fy
        ray_x = R[0, 1] * b + R[0, 2]
        ray_y = R[1, 1] * b + R[1, 2]
        ray_z = R[2, 1] * b + R[2, 2]
        for u in range(width):
            k = v * width + u
            cells[k] = -1
            z = depth[v, u]
            label = labels[v, u]
            if not (min_depth <= z <= max_depth) or label == water:
                continue
            a = (u + 0.5 - cx) / fx
            dx = z * (R[0, 0] * a + ray_x)
            dy = z * (R[1, 0] * a + ray_y)
            square = dx * dx + dy * dy
            if square > column_square[u]:
                column_x[u], column_y[u], column_square[u] = dx, dy, square
            if square > square_reach:
                continue
            col = math.floor((from_left + dx) * per_metre)
            row = math.floor((from_bottom + dy) * per_metre)
            if row < 0 or row >= rows or col < 0 or col >= cols:
                continue
            up = t[2] + z * (R[2, 0] * a + ray_z)
            cells[k] = row * cols + col
            heights[k] = up
            if label == seabed:
                ground_sum[row, col] += up
                ground_count[row, col] += 1.0
                seabed_seen[row, col] = True
            elif label == target:
                seabed_seen[row, col] = True
    for u in range(width):
        if column_square[u] > 0.0:
            ray = math.floor(math.atan2(column_y[u], column_x[u]) * per_radian)
            # A ray may run between two columns, or off to a side of where its column looked farthest.
            for near in range(ray - 5, ray + 6):
                farthest[near & RAY_MASK] = max(farthest[near & RAY_MASK], math.sqrt(column_square[u]))


@njit(cache=True, nogil=True)
def count_returns(cells, heights, labels, ground, band, target, counts):
    """Pixels per cell, added to counts (cells, 4): all, those below the height band, in it, target."""
    flat_ground = ground.ravel()
    flat_labels = labels.ravel()
    for k in range(len(cells)):
        cell = cells[k]
        if cell < 0:
            continue
        counts[cell, 0] += 1
        above = heights[k] - flat_ground[cell]
        if above < band[0]:
            counts[cell, 1] += 1
        elif above <= band[1]:
            counts[cell, 2] += 1
        if flat_labels[k] == target:
            counts[cell, 3] += 1


@njit(cache=True, nogil=True)
def pull(total, count, limit):
    """Sums and counts of 2 × 2 blocks; no cell weighs more than `limit`."""
    rows, cols = (total.shape[0] + 1) // 2, (total.shape[1] + 1) // 2
    sums = np.zeros((rows, cols))
    counts = np.zeros((rows, cols))
    for i in range(total.shape[0]):
        for j in range(total.shape[1]):
            n = count[i, j]
            if n > 0.0:
                weight = min(n, limit)
                sums[i // 2, j // 2] += total[i, j] / n * weight
                counts[i // 2, j // 2] += weight
    return sums, counts


@njit(cache=True, nogil=True)
def push(total, count, coarse, trust, window):
    """Means inside a window, each drawn to the bilinear value of the coarser level as by `trust` points.

    Args:
        total: (rows, cols) sums.
        count: (rows, cols) points in them.
        coarse: (⌈rows / 2⌉, ⌈cols / 2⌉) means.
        trust: Number of points.
        window: (first row, past row, first col, past col).

    Returns:
        (rows, cols), NaN outside the window.
    """
    filled = np.full(total.shape, np.nan)
    rows, cols = coarse.shape
    for i in range(window[0], window[1]):
        y = min(max(0.5 * i - 0.25, 0.0), rows - 1.0)
        i0 = int(y)
        i1 = min(i0 + 1, rows - 1)
        fy = y - i0
        for j in range(window[2], window[3]):
            x = min(max(0.5 * j - 0.25, 0.0), cols - 1.0)
            j0 = int(x)
            j1 = min(j0 + 1, cols - 1)
            fx = x - j0
            low = coarse[i0, j0] * (1.0 - fx) + coarse[i0, j1] * fx
            high = coarse[i1, j0] * (1.0 - fx) + coarse[i1, j1] * fx
            prior = low * (1.0 - fy) + high * fy
            filled[i, j] = (total[i, j] + trust * prior) / (count[i, j] + trust)
    return filled


@njit(cache=True, nogil=True)
def update_evidence(
    counts,
    log_odds,
    hits,
    returns,
    explored,
    bare,
    hit,
    miss,
    clamp,
    min_pixels,
    min_share,
    min_ground,
    frame_pixels,
):
    """One step of log-odds per cell and frame, counts for the semantics, bits for what was really seen.

    `counts` is what `count_returns` gives; the parameters after `bare` are those of `Evidence`. A return
    from above the band explores its cell, but says nothing of what stands below it.
    """
    flat_odds, flat_explored, flat_bare = log_odds.ravel(), explored.ravel(), bare.ravel()
    flat_hits, flat_returns = hits.ravel(), returns.ravel()
    for cell in range(len(counts)):
        total = counts[cell, 0]
        if total == 0:
            continue
        below, band = counts[cell, 1], counts[cell, 2]
        flat_explored[cell] = True
        if below > 0:
            flat_bare[cell] = True
        weight = min(1.0, frame_pixels / total)
        flat_hits[cell] += weight * counts[cell, 3]
        flat_returns[cell] += weight * total
        if band >= min_pixels and band >= min_share * total:
            flat_odds[cell] = min(flat_odds[cell] + hit, clamp[1])
        elif band < min_pixels and below >= min_ground:
            flat_odds[cell] = max(flat_odds[cell] - miss, clamp[0])


@njit(cache=True, nogil=True)
def integrate_sector(
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
    farthest,
    counts,
    log_odds,
    miss,
    low,
    explored,
    crossed,
):
    """Cast one frame's rays: explore and cross what they reach, wear down what they pass without a return.

    `farthest` holds, for each ray, how far it is known to have run; `level` tells whether rays at the
    vehicle's own height are in the image.
    """
    rows, cols = log_odds.shape
    blocked = np.zeros(RAY_MASK + 1, dtype=np.bool_)
    for k in range(len(t_rows)):
        i, j = row + t_rows[k], col + t_cols[k]
        if i < 0 or i >= rows or j < 0 or j >= cols:
            continue
        first, last = t_first[k], t_last[k]
        if any_open(blocked, first, last):
            forward = t_x[k] * forward_x + t_y[k] * forward_y
            in_sector = forward >= t_distance[k] * cos_half - SECTOR_SLACK
            middle = ((first + last) // 2) & RAY_MASK
            if in_sector and t_distance[k] <= farthest[middle]:
                if forward >= blind - SECTOR_SLACK:
                    explored[i, j] = True
                    if counts[i * cols + j, 0] == 0 and all_open(blocked, first, last):
                        log_odds[i, j] = max(log_odds[i, j] - miss, low)
                if level and log_odds[i, j] <= 0.0:
                    crossed[i, j] = True
        if log_odds[i, j] > 0.0:
            block(blocked, first, last)
