"""Compiled loops of the map. Plain arrays and numbers in, arrays out; lengths in cells unless named."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

RAY_MASK = 1023
"""Rays in a full turn, less one: a power of two, so that wrapping is one `and`."""
SECTOR_SLACK = 1e-6
"""Cells whose centre lies on the edge of the sector belong to it, whatever the rounding."""


# ---------------------------------------------------------------------------------------------------
# Pixels to counts
# ---------------------------------------------------------------------------------------------------


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


# ---------------------------------------------------------------------------------------------------
# Evidence and visibility
# ---------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def any_open(blocked, first, last):
    """Does some ray of the interval still run?"""
    for ray in range(first, last + 1):  # noqa: SIM110
        if not blocked[ray & RAY_MASK]:
            return True
    return False


@njit(cache=True, nogil=True)
def all_open(blocked, first, last):
    """Do all rays of the interval still run?"""
    for ray in range(first, last + 1):  # noqa: SIM110
        if blocked[ray & RAY_MASK]:
            return False
    return True


@njit(cache=True, nogil=True)
def block(blocked, first, last):
    """End the rays of the interval; how many of them still ran?"""
    ended = 0
    for ray in range(first, last + 1):
        if not blocked[ray & RAY_MASK]:
            blocked[ray & RAY_MASK] = True
            ended += 1
    return ended


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


@njit(cache=True, nogil=True)
def cast_sector(
    solid,
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
):
    """Cells with their centre in the sector that some ray reaches; a solid cell ends its rays."""
    rows, cols = solid.shape
    visible = np.zeros((rows, cols), dtype=np.bool_)
    blocked = np.zeros(RAY_MASK + 1, dtype=np.bool_)
    for k in range(len(t_rows)):
        i, j = row + t_rows[k], col + t_cols[k]
        if i < 0 or i >= rows or j < 0 or j >= cols:
            continue
        first, last = t_first[k], t_last[k]
        forward = t_x[k] * forward_x + t_y[k] * forward_y
        if (
            forward >= t_distance[k] * cos_half - SECTOR_SLACK
            and forward >= blind - SECTOR_SLACK
            and any_open(blocked, first, last)
        ):
            visible[i, j] = True
        if solid[i, j]:
            block(blocked, first, last)
    return visible


@njit(cache=True, nogil=True)
def sweep_gain(
    solid, weights, position_rows, position_cols, t_rows, t_cols, t_first, t_last, h_first, h_count, headings
):
    """Sum of the weights of the visible cells, for every position and heading, one sweep a position.

    Cell k of the table lies in the sectors of the `h_count[k]` headings from `h_first[k]` on.
    """
    rows, cols = solid.shape
    gains = np.zeros((len(position_rows), headings), dtype=np.float32)
    blocked = np.empty(RAY_MASK + 1, dtype=np.bool_)
    change = np.empty(2 * headings + 1)
    for p in range(len(position_rows)):
        blocked[:] = False
        change[:] = 0.0
        row, col = position_rows[p], position_cols[p]
        for k in range(len(t_rows)):
            i, j = row + t_rows[k], col + t_cols[k]
            if i < 0 or i >= rows or j < 0 or j >= cols:
                continue
            weight = weights[i, j]
            if weight != 0.0 and h_count[k] > 0 and any_open(blocked, t_first[k], t_last[k]):
                change[h_first[k]] += weight
                change[h_first[k] + h_count[k]] -= weight
            if solid[i, j]:
                block(blocked, t_first[k], t_last[k])
        running = 0.0
        for h in range(2 * headings):
            running += change[h]
            gains[p, h % headings] += running
    return gains


# ---------------------------------------------------------------------------------------------------
# Where the vehicle may be
# ---------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def clearance(barrier, radius):
    """Squared distance, in half cells, from each cell's centre to the nearest barrier cell.

    Measured to the barrier's square, not to its centre. More than `radius` cells away: a large number.
    """
    rows, cols = barrier.shape
    squared = np.full((rows, cols), 4 * (radius + 1) * (radius + 1), dtype=np.int32)
    for i in range(rows):
        for j in range(cols):
            if not barrier[i, j]:
                continue
            squared[i, j] = 0
            # What is not on the edge is nobody's nearest.
            edge = (
                (i > 0 and not barrier[i - 1, j])
                or (j > 0 and not barrier[i, j - 1])
                or (i < rows - 1 and not barrier[i + 1, j])
                or (j < cols - 1 and not barrier[i, j + 1])
            )
            if not edge:
                continue
            for y in range(max(i - radius, 0), min(i + radius + 1, rows)):
                high = max(2 * abs(y - i) - 1, 0)
                for x in range(max(j - radius, 0), min(j + radius + 1, cols)):
                    wide = max(2 * abs(x - j) - 1, 0)
                    squared[y, x] = min(squared[y, x], high * high + wide * wide)
    return squared


@njit(cache=True, nogil=True)
def segment_is_free(squared, needed, x0, y0, x1, y1):
    """Is every sample of a segment (in cells) far enough from the barrier?

    From a start that is too near itself, the room must never shrink on the way, and the end must have more of
    it: a way out, never one along.
    """
    rows, cols = squared.shape
    i, j = math.floor(y0), math.floor(x0)
    if i < 0 or j < 0 or i >= rows or j >= cols or squared[i, j] == 0:
        return False
    start = squared[i, j]
    least = min(start, needed + 1)
    samples = max(1, math.ceil(2.0 * math.hypot(x1 - x0, y1 - y0) - 1e-9))
    for k in range(1, samples + 1):
        along = k / samples
        i = math.floor(y0 + along * (y1 - y0))
        j = math.floor(x0 + along * (x1 - x0))
        if i < 0 or j < 0 or i >= rows or j >= cols or squared[i, j] < least:
            return False
        least = max(least, min(squared[i, j], needed + 1))
    return least > needed or squared[i, j] > start


@njit(cache=True, nogil=True)
def segments_are_free(squared, needed, starts, ends):
    """`segment_is_free` for (n, 2) starts and ends, in cells."""
    free = np.empty(len(starts), dtype=np.bool_)
    for k in range(len(starts)):
        free[k] = segment_is_free(squared, needed, starts[k, 0], starts[k, 1], ends[k, 0], ends[k, 1])
    return free


@njit(cache=True, nogil=True)
def frontier_labels(known, free):
    """Clusters of the frontier, 1 and up in raster order, 8-connected; 0 elsewhere.

    A frontier cell is free and has an unknown 4-neighbour inside the grid.
    """
    rows, cols = known.shape
    frontier = np.zeros((rows, cols), dtype=np.bool_)
    for i in range(rows):
        for j in range(cols):
            if free[i, j]:
                frontier[i, j] = (
                    (i > 0 and not known[i - 1, j])
                    or (j > 0 and not known[i, j - 1])
                    or (i < rows - 1 and not known[i + 1, j])
                    or (j < cols - 1 and not known[i, j + 1])
                )
    return label_within(frontier, 2.0)


@njit(cache=True, nogil=True)
def label_within(mask, squared_link):
    """Components of the cells whose centres lie within a distance (squared, in cells), in raster order."""
    rows, cols = mask.shape
    labels = np.zeros((rows, cols), dtype=np.int32)
    stack = np.empty(rows * cols, dtype=np.int32)
    reach = math.floor(math.sqrt(squared_link) + 1e-9)
    count = 0
    for i in range(rows):
        for j in range(cols):
            if not mask[i, j] or labels[i, j] != 0:
                continue
            count += 1
            labels[i, j] = count
            stack[0] = i * cols + j
            depth = 1
            while depth > 0:
                depth -= 1
                y, x = stack[depth] // cols, stack[depth] % cols
                for di in range(-reach, reach + 1):
                    for dj in range(-reach, reach + 1):
                        if di * di + dj * dj > squared_link + 1e-9:
                            continue
                        a, b = y + di, x + dj
                        if 0 <= a < rows and 0 <= b < cols and mask[a, b] and labels[a, b] == 0:
                            labels[a, b] = count
                            stack[depth] = a * cols + b
                            depth += 1
    return labels, count


# ---------------------------------------------------------------------------------------------------
# Completion
# ---------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def reachable_nodes(squared, needed, offset_x, offset_y, spacing, shape, row, col, moves):
    """Lattice nodes that can be reached from (row, col) by the moves, each a free segment.

    Node (i, j) lies at `offset + spacing * (j, i)`, in cells; `moves` is (n, 2) lattice steps east and north.
    """
    rows, cols = shape
    reached = np.zeros((rows, cols), dtype=np.bool_)
    stack = np.empty(rows * cols, dtype=np.int32)
    reached[row, col] = True
    stack[0] = row * cols + col
    depth = 1
    while depth > 0:
        depth -= 1
        i, j = stack[depth] // cols, stack[depth] % cols
        x, y = offset_x + spacing * j, offset_y + spacing * i
        for k in range(len(moves)):
            a, b = i + moves[k, 1], j + moves[k, 0]
            if a < 0 or b < 0 or a >= rows or b >= cols or reached[a, b]:
                continue
            if segment_is_free(squared, needed, x, y, offset_x + spacing * b, offset_y + spacing * a):
                reached[a, b] = True
                stack[depth] = a * cols + b
                depth += 1
    return reached


@njit(cache=True, nogil=True)
def sees(solid, x, y, row, col, reach, blind, half_angle, heading_step):
    """Would a camera at (x, y), in cells, explore the cell with the lattice heading that suits it best?

    The same rays as in the ray table, followed one by one from the position to the cell.
    """
    to_x, to_y = col + 0.5 - x, row + 0.5 - y
    distance = math.hypot(to_x, to_y)
    bearing = math.atan2(to_y, to_x)
    off_axis = abs(bearing - heading_step * math.floor(bearing / heading_step + 0.5))
    if distance > reach or off_axis > half_angle or distance * math.cos(off_axis) < blind:
        return False
    low, high = 0.0, 0.0
    for corner in range(4):
        corner_x = to_x + (0.5 if corner & 1 else -0.5)
        corner_y = to_y + (0.5 if corner & 2 else -0.5)
        # The angle from the centre's bearing to the corner's.
        side = math.atan2(to_x * corner_y - to_y * corner_x, to_x * corner_x + to_y * corner_y)
        low, high = min(low, side), max(high, side)
    per_radian = (RAY_MASK + 1) / (2.0 * math.pi)
    first = math.ceil((bearing + low) * per_radian - 0.5)
    last = math.floor((bearing + high) * per_radian - 0.5)
    for ray in range(first, last + 1):  # noqa: SIM110
        if ray_is_open(solid, x, y, (ray + 0.5) / per_radian, row, col):
            return True
    return False


@njit(cache=True, nogil=True)
def ray_is_open(solid, x, y, bearing, row, col):
    """Does the ray from (x, y) cross the cell, with no solid one before it?"""
    rows, cols = solid.shape
    dx, dy = math.cos(bearing), math.sin(bearing)
    j, i = math.floor(x), math.floor(y)
    # On the side of a cell, a ray to the left or down begins in the neighbour.
    if x == j and dx < 0.0:
        j -= 1
    if y == i and dy < 0.0:
        i -= 1
    step_x, step_y = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    next_x = ((j + 1 if dx > 0.0 else j) - x) / dx
    next_y = ((i + 1 if dy > 0.0 else i) - y) / dy
    for _ in range(abs(row - i) + abs(col - j)):
        if i < 0 or j < 0 or i >= rows or j >= cols or solid[i, j]:
            return False
        if next_x < next_y:
            j += step_x
            next_x += step_x / dx
        else:
            i += step_y
            next_y += step_y / dy
    return i == row and j == col


@njit(cache=True, nogil=True)
def seeable(
    solid,
    candidates,
    nearest,
    node_at,
    node_x,
    node_y,
    reach,
    blind,
    half_angle,
    heading_step,
    t_rows,
    t_cols,
    t_first,
    t_last,
):
    """Which candidate cells some node sees.

    Args:
        solid: (rows, cols).
        candidates: (n, 2) row and column.
        nearest: (n,) index of the node to be tried first.
        node_at: (rows, cols) index of the node in the cell, −1 without.
        node_x, node_y: Positions of the nodes, in cells.
        reach, blind, half_angle, heading_step: The sensor, in cells and radians.
        t_rows, t_cols, t_first, t_last: Ray table for an observer in the middle of its cell.

    Returns:
        (n,) bool.
    """
    rows, cols = solid.shape
    found = np.zeros(len(candidates), dtype=np.bool_)
    blocked = np.empty(RAY_MASK + 1, dtype=np.bool_)
    for c in range(len(candidates)):
        row, col = candidates[c, 0], candidates[c, 1]
        node = nearest[c]
        if sees(solid, node_x[node], node_y[node], row, col, reach, blind, half_angle, heading_step):
            found[c] = True
            continue
        # Seen from the cell itself, which nodes are in sight? Inside a hull all rays end at once.
        blocked[:] = False
        running = RAY_MASK + 1
        for k in range(len(t_rows)):
            i, j = row + t_rows[k], col + t_cols[k]
            if i < 0 or i >= rows or j < 0 or j >= cols:
                continue
            node = node_at[i, j]
            if (
                node >= 0
                and any_open(blocked, t_first[k], t_last[k])
                and sees(solid, node_x[node], node_y[node], row, col, reach, blind, half_angle, heading_step)
            ):
                found[c] = True
                break
            if solid[i, j] and k > 0:
                running -= block(blocked, t_first[k], t_last[k])
                if running == 0:
                    break
    return found


@njit(cache=True, nogil=True)
def within(mask, squared_radius):
    """Cells whose centre lies within a distance (squared, in cells) of that of a cell of the mask."""
    rows, cols = mask.shape
    near = np.zeros((rows, cols), dtype=np.bool_)
    reach = math.floor(math.sqrt(squared_radius) + 1e-9)
    for i in range(rows):
        for j in range(cols):
            if not mask[i, j]:
                continue
            for y in range(max(i - reach, 0), min(i + reach + 1, rows)):
                for x in range(max(j - reach, 0), min(j + reach + 1, cols)):
                    if (y - i) * (y - i) + (x - j) * (x - j) <= squared_radius + 1e-9:
                        near[y, x] = True
    return near


@njit(cache=True, nogil=True)
def filled(mask):
    """The mask with its holes: what cannot be reached from the grid's border by 4-neighbours."""
    rows, cols = mask.shape
    inside = np.ones((rows, cols), dtype=np.bool_)
    stack = np.empty(rows * cols, dtype=np.int32)
    depth = 0
    for i in range(rows):
        for j in range(cols):
            if (i == 0 or j == 0 or i == rows - 1 or j == cols - 1) and not mask[i, j]:
                inside[i, j] = False
                stack[depth] = i * cols + j
                depth += 1
    while depth > 0:
        depth -= 1
        i, j = stack[depth] // cols, stack[depth] % cols
        for a, b in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
            if 0 <= a < rows and 0 <= b < cols and inside[a, b] and not mask[a, b]:
                inside[a, b] = False
                stack[depth] = a * cols + b
                depth += 1
    return inside
