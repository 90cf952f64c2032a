"""What is still open, whether it could be seen, and from where."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dream.mapping._kernels import flags as bits_of
from dream.mapping._kernels.room import segment_is_free
from dream.mapping._kernels.sight import RAY_MASK, any_open
from dream.mapping.lattice import NODES
from dream.mapping.layers import BLOCK, EDGE

CROSSED = bits_of.CROSSED
SHOWN = bits_of.EXPLORED | bits_of.BARE
"""Both of them also make a cell crossable."""
COARSE = 8
"""Cells along a square for which it is known whether there is any node in it."""

_ZERO, _ONE = np.uint64(0), np.uint64(1)


# ------------------------------------------------------------------------------------------- what changed


@njit(cache=True, nogil=True)
def renew_cells(log_odds, flags, votes, is_target, slots, firsts, solid, crossable, targets, rectangles):
    """Read blocks anew, a row of 64 cells a word.

    Args:
        log_odds, flags, votes: (slots, 64, 64).
        is_target: (256,) bool by votes.
        slots: (n,) the blocks.
        firsts: (n, 2) row and column of their first cells.
        solid, crossable: (slots, 64) uint64, renewed.
        targets: (n, 64) uint64, filled.
        rectangles: (2, n, 4) filled: where solid, where crossable changed; first, past row and column.
    """
    for n in range(len(slots)):
        slot = slots[n]
        rows = np.array([[BLOCK, -1], [BLOCK, -1]])
        cols = np.zeros(2, np.uint64)
        for i in range(BLOCK):
            s, c, t = _ZERO, _ZERO, _ZERO
            for j in range(BLOCK):
                bit = _ONE << np.uint64(j)
                if log_odds[slot, i, j] > 0:
                    s |= bit
                elif flags[slot, i, j] & CROSSED or flags[slot, i, j] & SHOWN == SHOWN:
                    c |= bit
                if is_target[votes[slot, i, j]]:
                    t |= bit
            targets[n, i] = t
            for k in range(2):
                different = (s ^ solid[slot, i]) if k == 0 else (c ^ crossable[slot, i])
                if different:
                    cols[k] |= different
                    rows[k, 0] = min(rows[k, 0], i)
                    rows[k, 1] = i
            solid[slot, i], crossable[slot, i] = s, c
        for k in range(2):
            first, past = BLOCK, 0
            for j in range(BLOCK):
                if cols[k] >> np.uint64(j) & _ONE:
                    first, past = min(first, j), j + 1
            rectangles[k, n, 0] = firsts[n, 0] + rows[k, 0]
            rectangles[k, n, 1] = firsts[n, 1] + first
            rectangles[k, n, 2] = firsts[n, 0] + rows[k, 1] + 1
            rectangles[k, n, 3] = firsts[n, 1] + past


@njit(cache=True, nogil=True)
def unpack(words, table, first, low, shape):
    """(rows, cols) bool: the bits of a box of cells from `low` on.

    Args:
        words: (slots, 64) uint64.
        table: (n, m) slots of the blocks from the block `first` on.
        first: See `table`.
        low: First row and column.
        shape: Rows and columns.
    """
    cells = np.empty(shape, np.bool_)
    for i in range(shape[0]):
        row = low[0] + i
        for j in range(shape[1]):
            col = low[1] + j
            word = words[table[row // BLOCK - first[0], col // BLOCK - first[1]], row & (BLOCK - 1)]
            cells[i, j] = (word >> np.uint64(col & (BLOCK - 1))) & _ONE
    return cells


# ------------------------------------------------------------------------------------------- the lattice
# A grid is metres between nodes, metres of a cell, and world y and x of the corner of cell (0, 0).


@njit(cache=True, nogil=True)
def place(i, j, grid):
    """How far north and east a node lies, in cells: as `Layers` measures where a position lies."""
    lattice, cell, south, west = grid
    return (i * lattice - south) / cell + EDGE, (j * lattice - west) / cell + EDGE


@njit(cache=True, nogil=True)
def _snapped(at):
    """A node on the edge of cells lies exactly there: rays to both sides begin in these."""
    return float(math.floor(at)) if at - math.floor(at) < 2.0 * EDGE else at - EDGE


@njit(cache=True, nogil=True)
def renew_moves(room, low, needed, grid, nodes, moves, free, table, first, changed):
    """Which moves are free from each node of a rectangle; bit `len(moves)`: the vehicle can stand there.

    Args:
        room: Around them, as far as moves lead; from the cell `low` on.
        low: See `room`.
        needed: Room that a standable cell exceeds.
        grid: See above.
        nodes: First and past, rows and columns.
        moves: (n, 2) lattice steps east and north.
        free: (slots, 32, 32, bytes) uint8, renewed.
        table: (n, m) slots of the blocks of nodes, from the block `first` on; all made.
        first: See `table`.
        changed: (n, m) bool, set where a node's bits became others.
    """
    bits = np.empty(free.shape[3], np.uint8)
    for i in range(nodes[0], nodes[2]):
        for j in range(nodes[1], nodes[3]):
            y, x = place(i, j, grid)
            bits[:] = 0
            if room[math.floor(y) - low[0], math.floor(x) - low[1]] > needed:
                for k in range(len(moves)):
                    to_y, to_x = place(i + moves[k, 1], j + moves[k, 0], grid)
                    if segment_is_free(room, needed, x, y, to_x, to_y, low[0], low[1]):
                        bits[k >> 3] |= 1 << (k & 7)
                bits[len(moves) >> 3] |= 1 << (len(moves) & 7)
            block_row, block_col = i // NODES - first[0], j // NODES - first[1]
            slot = table[block_row, block_col]
            for k in range(len(bits)):
                if free[slot, i & (NODES - 1), j & (NODES - 1), k] != bits[k]:
                    free[slot, i & (NODES - 1), j & (NODES - 1), k] = bits[k]
                    changed[block_row, block_col] = True


@njit(cache=True, nogil=True)
def _has(free, slot, i, j, k):
    return (free[slot, i, j, k >> 3] >> (k & 7)) & 1 != 0


@njit(cache=True, nogil=True)
def free_moves(free, table, first, nodes, bit_of):
    """(rows, cols, headings, advances) uint8 1 where a move is free from the nodes of a rectangle.

    Args:
        free: See `renew_moves`.
        table: (n, m) slots of the blocks of nodes, from the block `first` on.
        first: See `table`.
        nodes: First and past, rows and columns.
        bit_of: (headings, advances) the bit of each move.
    """
    headings, advances = bit_of.shape
    moves = np.empty((nodes[2] - nodes[0], nodes[3] - nodes[1], headings, advances), np.uint8)
    for i in range(nodes[0], nodes[2]):
        for j in range(nodes[1], nodes[3]):
            slot = table[i // NODES - first[0], j // NODES - first[1]]
            for h in range(headings):
                for a in range(advances):
                    moves[i - nodes[0], j - nodes[1], h, a] = _has(
                        free, slot, i & (NODES - 1), j & (NODES - 1), bit_of[h, a]
                    )
    return moves


@njit(cache=True, nogil=True)
def label_nodes(free, slot, moves, opposite, labels):
    """Parts of a block: nodes that moves lead between in both directions. Numbers from 1; how many?"""
    parent = np.arange(NODES * NODES)
    for i in range(NODES):
        for j in range(NODES):
            if not _has(free, slot, i, j, len(moves)):
                continue
            for k in range(len(moves)):
                a, b = i + moves[k, 1], j + moves[k, 0]
                # Each pair from its first node.
                if a < i or (a == i and b < j) or a >= NODES or b < 0 or b >= NODES or opposite[k] < 0:
                    continue
                if _has(free, slot, i, j, k) and _has(free, slot, a, b, opposite[k]):
                    one, other = _root(parent, i * NODES + j), _root(parent, a * NODES + b)
                    parent[max(one, other)] = min(one, other)
    count = 0
    for i in range(NODES):
        for j in range(NODES):
            if not _has(free, slot, i, j, len(moves)):
                labels[slot, i, j] = 0
                continue
            root = _root(parent, i * NODES + j)
            if root == i * NODES + j:
                count += 1
                labels[slot, i, j] = count
            else:
                labels[slot, i, j] = labels[slot, root // NODES, root % NODES]
    return count


@njit(cache=True, nogil=True)
def _root(parent, n):
    while parent[n] != n:
        parent[n] = parent[parent[n]]
        n = parent[n]
    return n


@njit(cache=True, nogil=True)
def link_nodes(free, labels, slot, neighbours, moves, links):
    """Free moves from a part of a block to another part, there or in one of the eight blocks around.

    Args:
        free: (slots, 32, 32, bytes) uint8.
        labels: (slots, 32, 32) parts.
        slot: The block.
        neighbours: (9,) slots of the three by three blocks around it.
        moves: (n, 2), none longer than a block.
        links: (most, 3) filled: part, which of the nine, its part.

    Returns:
        How many there are; more than `most` where there was no room for them.
    """
    count = 0
    last = np.zeros(9, np.int64)
    for i in range(NODES):
        for j in range(NODES):
            mine = labels[slot, i, j]
            if mine == 0:
                continue
            for k in range(len(moves)):
                a, b = i + moves[k, 1], j + moves[k, 0]
                side = 3 * (1 + a // NODES) + 1 + b // NODES
                if (side == 4 and labels[slot, a, b] == mine) or not _has(free, slot, i, j, k):
                    continue
                other = labels[neighbours[side], a & (NODES - 1), b & (NODES - 1)]
                pair = np.int64(mine) << 16 | other
                if other == 0 or last[side] == pair:
                    continue
                last[side] = pair
                known = False
                for n in range(min(count, len(links))):
                    if links[n, 0] == mine and links[n, 1] == side and links[n, 2] == other:
                        known = True
                        break
                if not known:
                    if count < len(links):
                        links[count, 0], links[count, 1], links[count, 2] = mine, side, other
                    count += 1
    return count


@njit(cache=True, nogil=True)
def walk(offsets, neighbours, links, link_counts, firsts, starts):
    """Parts that links lead to from some of them.

    Args:
        offsets: (slots + 1,) number of each block's first part; the last is how many there are.
        neighbours: (slots, 9).
        links: (slots, most, 3).
        link_counts: (slots,).
        firsts: (parts,) their blocks.
        starts: (n,) numbers of parts.

    Returns:
        (parts,) bool.
    """
    reached = np.zeros(offsets[-1], np.bool_)
    stack = np.empty(offsets[-1] + 1, np.int64)
    depth = 0
    for start in starts:
        if not reached[start]:
            reached[start] = True
            stack[depth] = start
            depth += 1
    while depth > 0:
        depth -= 1
        part = stack[depth]
        slot = firsts[part]
        label = part - offsets[slot] + 1
        for n in range(link_counts[slot]):
            if links[slot, n, 0] != label:
                continue
            other = offsets[neighbours[slot, links[slot, n, 1]]] + links[slot, n, 2] - 1
            if not reached[other]:
                reached[other] = True
                stack[depth] = other
                depth += 1
    return reached


@njit(cache=True, nogil=True)
def ways_out(room, low, needed, grid, nodes, row, col, moves):
    """From a node where the vehicle cannot stand, the nodes to which ways out lead.

    Args:
        room: Around them; from the cell `low` on.
        low, needed, grid: See `renew_moves`.
        nodes: The rectangle that may be looked at; first and past, rows and columns.
        row, col: The node.
        moves: (n, 2).

    Returns:
        (rows, cols) 1 where reached, 2 where reached and standable; whether the rectangle was too small.
    """
    found = np.zeros((nodes[2] - nodes[0], nodes[3] - nodes[1]), np.uint8)
    found[row - nodes[0], col - nodes[1]] = 1
    stack = np.empty((found.size, 2), np.int64)
    stack[0] = row, col
    depth = 1
    small = False
    while depth > 0:
        depth -= 1
        i, j = stack[depth]
        y, x = place(i, j, grid)
        if room[math.floor(y) - low[0], math.floor(x) - low[1]] == 0:
            continue
        for k in range(len(moves)):
            a, b = i + moves[k, 1], j + moves[k, 0]
            if a < nodes[0] or b < nodes[1] or a >= nodes[2] or b >= nodes[3]:
                small = True
                continue
            if found[a - nodes[0], b - nodes[1]] != 0:
                continue
            to_y, to_x = place(a, b, grid)
            if not segment_is_free(room, needed, x, y, to_x, to_y, low[0], low[1]):
                continue
            if room[math.floor(to_y) - low[0], math.floor(to_x) - low[1]] > needed:
                found[a - nodes[0], b - nodes[1]] = 2
            else:
                found[a - nodes[0], b - nodes[1]] = 1
                stack[depth] = a, b
                depth += 1
    return found, small


@njit(cache=True, nogil=True)
def renew_reached(labels, offsets, marks, old_offsets, old_marks, stale, extras, keys, reached, rectangles):
    """Which nodes of each block are reached.

    Args:
        labels: (slots, 32, 32).
        offsets: (slots + 1,) see `walk`.
        marks: (parts,) bool, the parts reached.
        old_offsets, old_marks: The same before, of blocks that are not stale.
        stale: (slots,) bool: blocks whose labels are new.
        extras: (n, 2) other nodes that are reached; their blocks are stale.
        keys: (slots, 2) the blocks' places.
        reached: (slots, 32, 32) bool, renewed.
        rectangles: (slots, 4) filled: nodes that became reached or unreached, by first, past row and column.

    Returns:
        How many blocks have any; these are the first of `rectangles`.
    """
    count = 0
    for slot in range(1, len(offsets) - 1):
        same = not stale[slot]
        if same:
            for n in range(offsets[slot + 1] - offsets[slot]):
                if marks[offsets[slot] + n] != old_marks[old_offsets[slot] + n]:
                    same = False
                    break
        if same:
            continue
        low, high, left, right = NODES, -1, NODES, -1
        for i in range(NODES):
            for j in range(NODES):
                label = labels[slot, i, j]
                now = label > 0 and marks[offsets[slot] + label - 1]
                if len(extras) > 0 and not now:
                    row, col = keys[slot, 0] * NODES + i, keys[slot, 1] * NODES + j
                    for n in range(len(extras)):
                        now = now or (extras[n, 0] == row and extras[n, 1] == col)
                if now != reached[slot, i, j]:
                    reached[slot, i, j] = now
                    low, high = min(low, i), max(high, i)
                    left, right = min(left, j), max(right, j)
        if high >= 0:
            rectangles[count, 0] = keys[slot, 0] * NODES + low
            rectangles[count, 1] = keys[slot, 1] * NODES + left
            rectangles[count, 2] = keys[slot, 0] * NODES + high + 1
            rectangles[count, 3] = keys[slot, 1] * NODES + right + 1
            count += 1
    return count


# ------------------------------------------------------------------------------------------- lines of sight


@njit(cache=True, nogil=True)
def nodes_in(reached, table, first, nodes, grid, limits, low, shape):
    """Nodes that were reached, by cell.

    Args:
        reached: (slots, 32, 32) bool.
        table: (n, m) slots of the blocks of nodes, from the block `first` on.
        first: See `table`.
        nodes: The rectangle to look at; first and past, rows and columns.
        grid: See `renew_moves`.
        limits: First and past, rows and columns, of all cells; a node on the edge counts to the last one.
        low, shape: The box of cells.

    Returns:
        (rows, cols) int32 index of the last node in each cell, -1 without; (n,) their x and y in cells.
    """
    node_at = np.full(shape, -1, np.int32)
    most = max(nodes[2] - nodes[0], 0) * max(nodes[3] - nodes[1], 0)
    node_x, node_y = np.empty(most), np.empty(most)
    count = 0
    for i in range(nodes[0], nodes[2]):
        for j in range(nodes[1], nodes[3]):
            slot = table[i // NODES - first[0], j // NODES - first[1]]
            if not reached[slot, i & (NODES - 1), j & (NODES - 1)]:
                continue
            y, x = place(i, j, grid)
            row = min(max(math.floor(y), limits[0]), limits[2] - 1) - low[0]
            col = min(max(math.floor(x), limits[1]), limits[3] - 1) - low[1]
            if 0 <= row < shape[0] and 0 <= col < shape[1]:
                node_at[row, col] = count
                node_x[count], node_y[count] = _snapped(x), _snapped(y)
                count += 1
    return node_at, node_x[:count], node_y[:count]


@njit(cache=True, nogil=True)
def sees(solid, base, x, y, row, col, reach, blind, half_angle, heading_step):
    """Would a camera at (x, y), in cells, explore the cell with the lattice heading that suits it best?

    The same rays as in the ray table, followed one by one from the position to the cell. The first cell of
    `solid` is `base`.
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
    for ray in range(first, last + 1):
        if ray_is_open(solid, base, x, y, (ray + 0.5) / per_radian, row, col):
            return True
    return False


@njit(cache=True, nogil=True)
def ray_is_open(solid, base, x, y, bearing, row, col):
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
        a, b = i - base[0], j - base[1]
        if a < 0 or b < 0 or a >= rows or b >= cols or solid[a, b]:
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
    low,
    candidates,
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
        solid: (rows, cols) the box around them as far as the table goes.
        low: Its first cell.
        candidates: (n, 2) row and column.
        node_at: (rows, cols) index of the node in the cell, -1 without.
        node_x, node_y: Positions of the nodes, in cells.
        reach, blind, half_angle, heading_step: The sensor, in cells and radians.
        t_rows, t_cols, t_first, t_last: Ray table for an observer in the middle of its cell.

    Returns:
        (n,) bool.
    """
    rows, cols = solid.shape
    found = np.zeros(len(candidates), dtype=np.bool_)
    if len(node_x) == 0:
        return found
    some = np.zeros((rows // COARSE + 1, cols // COARSE + 1), dtype=np.bool_)
    for i in range(rows):
        for j in range(cols):
            if node_at[i, j] >= 0:
                some[i // COARSE, j // COARSE] = True
    blocked = np.empty(RAY_MASK + 1, dtype=np.bool_)
    for c in range(len(candidates)):
        row, col = candidates[c, 0], candidates[c, 1]
        if not _any_near(some, row - low[0], col - low[1], reach + 1.0):
            continue
        # The nearest one: most often it does.
        for k in range(len(t_rows)):
            i, j = row + t_rows[k] - low[0], col + t_cols[k] - low[1]
            if 0 <= i < rows and 0 <= j < cols and node_at[i, j] >= 0:
                x, y = node_x[node_at[i, j]], node_y[node_at[i, j]]
                found[c] = sees(solid, low, x, y, row, col, reach, blind, half_angle, heading_step)
                break
        if found[c]:
            continue
        # Seen from the cell itself, which nodes are in sight? Inside a hull all rays end at once.
        blocked[:] = False
        running = RAY_MASK + 1
        for k in range(len(t_rows)):
            i, j = row + t_rows[k] - low[0], col + t_cols[k] - low[1]
            if i < 0 or i >= rows or j < 0 or j >= cols:
                continue
            node = node_at[i, j]
            if node >= 0 and any_open(blocked, t_first[k], t_last[k]):
                x, y = node_x[node], node_y[node]
                if sees(solid, low, x, y, row, col, reach, blind, half_angle, heading_step):
                    found[c] = True
                    break
            if solid[i, j] and k > 0:
                running -= _end(blocked, t_first[k], t_last[k])
                if running == 0:
                    break
    return found


@njit(cache=True, nogil=True)
def _end(blocked, first, last):
    """End the rays of the interval; how many of them still ran?"""
    ended = 0
    for ray in range(first, last + 1):
        if not blocked[ray & RAY_MASK]:
            blocked[ray & RAY_MASK] = True
            ended += 1
    return ended


@njit(cache=True, nogil=True)
def _any_near(some, row, col, reach):
    """Is there a node in a square that comes so near to a cell?"""
    span = math.ceil(reach)
    for i in range(max((row - span) // COARSE, 0), min((row + span) // COARSE + 1, some.shape[0])):
        high = max(i * COARSE - row, 0, row - (i + 1) * COARSE + 1)
        for j in range(max((col - span) // COARSE, 0), min((col + span) // COARSE + 1, some.shape[1])):
            wide = max(j * COARSE - col, 0, col - (j + 1) * COARSE + 1)
            if some[i, j] and high * high + wide * wide <= reach * reach:
                return True
    return False


# ------------------------------------------------------------------------------------------- regions


@njit(cache=True, nogil=True)
def link_parts(labels, reach, squared_link):
    """Pairs of labels, one in the middle and one around, with cells within a distance (squared, in cells).

    Args:
        labels: (9, 64, 64) three by three blocks.
        reach: The distance in whole cells.
        squared_link: The distance.

    Returns:
        (n, 3) label, which of the nine, its label; some more than once.
    """
    pairs = []
    last = np.zeros(9, np.int64)
    for i in range(BLOCK):
        for j in range(BLOCK):
            mine = labels[4, i, j]
            if mine == 0:
                continue
            if reach <= i < BLOCK - reach and reach <= j < BLOCK - reach:
                continue
            for y in range(i - reach, i + reach + 1):
                for x in range(j - reach, j + reach + 1):
                    side = 3 * (1 + y // BLOCK) + 1 + x // BLOCK
                    if side == 4 or (y - i) * (y - i) + (x - j) * (x - j) > squared_link + 1e-9:
                        continue
                    other = labels[side, y & (BLOCK - 1), x & (BLOCK - 1)]
                    if other == 0:
                        continue
                    pair = np.int64(mine) << 16 | other
                    if last[side] != pair:
                        last[side] = pair
                        pairs.append((np.int64(mine), np.int64(side), np.int64(other)))
    result = np.empty((len(pairs), 3), np.int64)
    for n in range(len(pairs)):
        result[n, 0], result[n, 1], result[n, 2] = pairs[n]
    return result


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
