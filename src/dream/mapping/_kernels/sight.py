"""Rays over the map."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np
from numba import njit

from dream.mapping._kernels.flags import RAY_MASK, RAYS

SECTOR_SLACK = 1e-6
"""Cells whose centre lies on the edge of the sector belong to it, whatever the rounding."""
STRETCH = 16
"""Columns after which a window's list of solid cells has an entry of its own."""
ENDLESS = 2**31 - 1
"""Depth of a ray that no solid cell ends."""


@njit(cache=True, nogil=True)
def any_open(blocked, first, last):
    """Does some ray of the interval still run?"""
    for ray in range(first, last + 1):  # noqa: SIM110
        if not blocked[ray & RAY_MASK]:
            return True
    return False


@njit(cache=True, nogil=True)
def block(blocked, first, last):
    """End the rays of the interval."""
    for ray in range(first, last + 1):
        blocked[ray & RAY_MASK] = True


@njit(cache=True, nogil=True)
def cast_sector(solid, row, col, table, forward_x, forward_y, cos_half, blind):
    """Cells with their centre in the sector that some ray reaches; a solid cell ends its rays.

    Args:
        solid: (rows, cols).
        row, col: The observer's cell.
        table: A `visibility.RayTable`.
        forward_x, forward_y: Direction of the sector's middle.
        cos_half: Cosine of half its angle.
        blind: Cells; what is less far ahead is not seen.
    """
    t_rows, t_cols, t_x, t_y, t_distance, t_first, t_last = table
    rows, cols = solid.shape
    visible = np.zeros((rows, cols), dtype=np.bool_)
    blocked = np.zeros(RAYS, dtype=np.bool_)
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
def list_blocks(places, cols, shape):
    """Solid cells by blocks of a window: their columns, and where each block's begin in that list.

    Args:
        places: (n,) of the solid cells, flat over some grid inside the window, rising.
        cols: Of that grid.
        shape: Top and left of the grid in the window; rows and columns of the window.

    Returns:
        columns: (n,) int32 in the window.
        starts: (rows, blocks + 1) int32; the last is where the row ends.
    """
    top, left, rows, width = shape
    blocks = (width + STRETCH - 1) // STRETCH
    starts = np.zeros((rows, blocks + 1), dtype=np.int32)
    columns = np.empty(len(places), dtype=np.int32)
    for s in range(len(places)):
        row, col = divmod(places[s], cols)
        columns[s] = left + col
        starts[top + row, columns[s] // STRETCH + 1] += 1
    count = 0
    for i in range(rows):
        for k in range(blocks + 1):
            count += starts[i, k]
            starts[i, k] = count
    return columns, starts


@njit(cache=True, nogil=True)
def measure_rays(columns, starts, row, col, ranks, t_head, t_tail, depth):
    """How far every ray gets, and the farthest among any run of 2^n neighbouring rays.

    `depth[n * RAYS + ray]` becomes the greatest rank among the cells in which the rays from `ray` to
    `ray + 2^n - 1` end. Two such runs, overlapping, make up any interval: `t_head` and `t_tail` are their
    places for each cell. A solid cell is entered likewise, in its two runs; these are then handed down to
    the single rays.
    """
    side = len(ranks)
    rays = RAYS
    levels = len(depth) // rays
    depth[:] = ENDLESS
    low, high = col - side // 2, col + side // 2
    first_block, past_block = low // STRETCH, high // STRETCH + 1
    for i in range(side):
        line = row - side // 2 + i
        for s in range(np.uint32(starts[line, first_block]), np.uint32(starts[line, past_block])):
            j = np.uint32(columns[s] - low)
            if j >= side:  # Less than 0 becomes large.
                continue
            rank = np.uint32(ranks[np.uint32(i), j])
            # The lesser of the two, without a branch: which one it is cannot be foreseen.
            closer = np.int64(rank) - depth[t_head[rank]]
            depth[t_head[rank]] += closer & (closer >> 63)
            closer = np.int64(rank) - depth[t_tail[rank]]
            depth[t_tail[rank]] += closer & (closer >> 63)
    for level in range(levels - 1, 0, -1):
        half = 1 << (level - 1)
        above, below = np.uint32(level * rays), np.uint32((level - 1) * rays)
        for ray in range(np.uint32(rays)):
            depth[below + ray] = min(depth[below + ray], depth[above + ray])
        after = np.uint32(below + half)
        for ray in range(np.uint32(rays - half)):
            depth[after + ray] = min(depth[after + ray], depth[above + ray])
        wrapped = np.uint32(above + rays - half)
        for ray in range(np.uint32(half)):
            depth[below + ray] = min(depth[below + ray], depth[wrapped + ray])
    for level in range(1, levels):
        half = 1 << (level - 1)
        above, below = np.uint32(level * rays), np.uint32((level - 1) * rays)
        after = np.uint32(below + half)
        for ray in range(np.uint32(rays - half)):
            depth[above + ray] = max(depth[below + ray], depth[after + ray])
        last, wrapped = np.uint32(below + rays - half), np.uint32(above + rays - half)
        for ray in range(np.uint32(half)):
            depth[wrapped + ray] = max(depth[last + ray], depth[below + ray])


@njit(cache=True, nogil=True)
def sweep_gain(values, columns, starts, position_rows, position_cols, table, sweep, headings):
    """Sum of the weights of the visible cells, for every position and heading, one sweep a position.

    A cell is visible when the longest of its rays gets to its rank. Which ones are follows no pattern that a
    processor could foresee, so that nothing in the inner loop branches: what is hidden is summed too, apart.

    Args:
        values: (rows, cols) float32, the window's weights.
        columns, starts: Its solid cells, from `list_blocks`.
        position_rows, position_cols: Cells of the positions in the window; the whole table fits in around
            them.
        table: A `visibility.RayTable`.
        sweep: A `gain.Sweep` over it.
        headings: In a full turn.
    """
    t_rows, t_cols = table.rows, table.cols
    ranks, t_head, t_tail, t_group, skip, g_first, g_count = sweep
    rays = RAYS
    levels = int(t_head[-1]) // rays
    cells, groups = len(t_rows), len(g_first)
    gains = np.zeros((len(position_rows), headings), dtype=np.float32)
    depth = np.empty(levels * rays + 1, dtype=np.int32)
    sums = np.empty(2 * groups)
    change = np.empty(2 * headings + 1)
    flat = values.ravel()
    offset = np.empty(cells, dtype=np.int32)
    for k in range(cells):
        offset[k] = t_rows[k] * values.shape[1] + t_cols[k]
    for p in range(len(position_rows)):
        measure_rays(columns, starts, position_rows[p], position_cols[p], ranks, t_head, t_tail, depth)
        sums[:] = 0.0
        here = position_rows[p] * values.shape[1] + position_cols[p]
        # No ray gets beyond the deepest of all.
        past = min(cells, int(depth[(levels - 1) * rays]) + 1)
        for k in range(np.uint32(skip), np.uint32(past)):
            before = np.int64(k) - 1  # Unsigned, `k` is known not to count from the end.
            seen = ((before - depth[t_head[k]]) | (before - depth[t_tail[k]])) >> 63
            sums[np.uint32(t_group[k]) + np.uint32(groups & ~seen)] += flat[np.uint32(here + offset[k])]
        change[:] = 0.0
        for g in range(groups):
            if g_count[g] > 0:
                change[g_first[g]] += sums[g]
                change[g_first[g] + g_count[g]] -= sums[g]
        running = 0.0
        for h in range(2 * headings):
            running += change[h]
            gains[p, h % headings] += running
    return gains
