"""Edges and clusters.

A row of a block has 64 cells, one bit each of a word: frontier and inflation are a few shifts a row. The
parts of the frontier in each block (components) form a graph over the blocks' borders; a cluster is what
hangs together in it. See `update`.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dream.mapping._kernels.flags import FRONTIER, INFLATED, KNOWN

SIDE = 64
"""Cells along a block, as many as a word has bits."""

# Fields of a component, (n, 12) int32; number 0 is none. An update numbers those it meets, `C_LOCAL`.
C_SLOT, C_NEXT = 0, 1  # its block, the block's next
C_SIZE, C_FIRST, C_SUM_ROW, C_SUM_COL = 2, 3, 4, 5  # cells; the first one, 64 row + col; within the block
C_NODE, C_LINK = 6, 7
C_EPOCH, C_LOCAL = 8, 9  # what the update of that number calls it
C_QUEUED, C_REACHED = 10, 11  # the next in a search's two lists
COMPONENT = 12

# Fields of a node of the forest of clusters, (n, 8) int64; number 0 is none. A cluster is a root, or a
# component without links and without a node: most are, as every cell that stays unknown has one around it.
N_PARENT, N_REFS = 0, 1  # refs: components and nodes that point here; without any it is free
N_SIZE, N_SUM_ROW, N_SUM_COL = 2, 3, 4  # of roots; over the whole map
N_EPOCH, N_CHAIN = 5, 6  # the update that took a part away; its components beside the changed blocks
N_INDEX = 7
NODE = 8

# Fields of a link, (n, 2) int32: two for every pair, one from each side.
L_TO, L_NEXT = 0, 1
LINK = 2

# Fields of a block, (slots, 4) int32.
B_HEAD, B_RUNS, B_ROW, B_COL = 0, 1, 2, 3

# Sides of a block: which of their cells are frontier, in `faces` (slots, 4) uint64. A run of such cells is of
# one component. Those of all its runs, side after side, are in a chain of (n, 8) int32: the next, and seven.
LOW_ROW, HIGH_ROW, LOW_COL, HIGH_COL = 0, 1, 2, 3
R_NEXT, R_FIRST = 0, 1
RUNS = 8

# Fields of the state, (10,) int64.
S_EPOCH = 0
S_COMPONENTS, S_NODES, S_LINKS, S_RUNS = 1, 3, 5, 7  # how many were ever in use; behind it, the first free
S_CHANGES = 9  # updates that changed the frontier
STATE = 10

# Rows of the scratch of an update, (9, locals) int32. `T_PARENT` unites what touches.
T_COMPONENT, T_PARENT, T_NODE, T_CHAIN = 0, 1, 2, 3
T_QUEUE, T_QUEUE_END, T_REACHED, T_REACHED_END, T_ACTIVE = 4, 5, 6, 7, 8  # of searches, by local number
SCRATCH = 9

_ZERO, _ONE, _ALL = np.uint64(0), np.uint64(1), np.uint64(0xFFFFFFFFFFFFFFFF)
_TOP = np.uint64(63)
_SEVEN = np.uint64(7)
_EACH = np.uint64(0x0101010101010101)
_LOW_SEVEN = np.uint64(0x7F7F7F7F7F7F7F7F)
_HIGH = np.uint64(0x8080808080808080)
_GATHER = np.uint64(0x0102040810204080)
_GATHERED = np.uint64(56)
_BYTE = np.uint64(0xFF)
_TWO, _FOUR = np.uint64(2), np.uint64(4)
_PAIRS = np.uint64(0x5555555555555555)
_FOURS = np.uint64(0x3333333333333333)
_EIGHTS = np.uint64(0x0F0F0F0F0F0F0F0F)
_KNOWN = np.uint64(KNOWN * 0x0101010101010101)
_FRONTIER_SHIFT = np.uint64(FRONTIER.bit_length() - 1)
_INFLATED_SHIFT = np.uint64(INFLATED.bit_length() - 1)
_OTHERS = np.uint64((255 - FRONTIER - INFLATED) * 0x0101010101010101)
_SPREAD = np.array([sum(1 << 8 * k for k in range(8) if byte >> k & 1) for byte in range(256)], np.uint64)
"""Eight bits as eight bytes of 0 or 1."""
_DE_BRUIJN = np.uint64(0x03F79D71B4CB0A89)
_DE_BRUIJN_SHIFT = np.uint64(58)
_LOWEST = np.zeros(64, np.int64)
for _k in range(64):
    _LOWEST[(0x03F79D71B4CB0A89 << _k & 0xFFFFFFFFFFFFFFFF) >> 58] = _k


@njit(cache=True, nogil=True)
def _lowest(word):
    """Number of the lowest bit that is set."""
    return _LOWEST[((word & (~word + _ONE)) * _DE_BRUIJN) >> _DE_BRUIJN_SHIFT]


@njit(cache=True, nogil=True)
def _first_run(word):
    """First and past last of the lowest bits that are set in a row, and the word without them."""
    first = _lowest(word)
    rest = ~(word >> np.uint64(first))
    past = SIDE if rest == _ZERO else first + _lowest(rest)
    return first, past, word & (_ALL << np.uint64(past)) if past < SIDE else _ZERO


@njit(cache=True, nogil=True)
def _count_runs(word):
    """How many runs of bits are set."""
    starts = word & ~(word << _ONE)
    pairs = starts - ((starts >> _ONE) & _PAIRS)
    fours = (pairs & _FOURS) + ((pairs >> _TWO) & _FOURS)
    return np.int64((((fours + (fours >> _FOUR)) & _EIGHTS) * _EACH) >> _GATHERED)


@njit(cache=True, nogil=True)
def _columns(first, past, block):
    """The bits of a block's row whose columns lie from `first` up to `past`."""
    low = max(first - block * SIDE, 0)
    high = min(past - block * SIDE, SIDE)
    if low >= high:
        return _ZERO
    return (_ALL >> np.uint64(SIDE - (high - low))) << np.uint64(low)


# ------------------------------------------------------------------------------------------- bits of the map


@njit(cache=True, nogil=True)
def _gather(log_odds, flags, table, low, first, past, left, words, solid, known, frontier, inflated):
    """Rows `first` up to `past` of the map as words, from block column `left` on, between two empty words."""
    for block_row in range(first // SIDE, (past - 1) // SIDE + 1):
        begin, end = max(first, block_row * SIDE), min(past, (block_row + 1) * SIDE)
        for word in range(words):
            slot = table[block_row - low[0], left + word - low[1]]
            to = word + 1
            if slot == 0:
                for row in range(begin - first, end - first):
                    solid[row, to] = _ZERO
                    known[row, to] = _ZERO
                    frontier[row, to] = _ZERO
                    inflated[row, to] = _ZERO
                continue
            for row in range(begin, end):
                s, k, f, n = _ZERO, _ZERO, _ZERO, _ZERO
                for eight in range(8):
                    odds, bits = log_odds[slot, row & 63, eight], flags[slot, row & 63, eight]
                    shift = np.uint64(8 * eight)
                    # Each byte's highest bit: log-odds are positive; some bit of KNOWN is set.
                    above = ((odds & _LOW_SEVEN) + _LOW_SEVEN) & ~odds & _HIGH
                    seen = ((bits & _KNOWN) + _LOW_SEVEN) & _HIGH
                    s |= (((above >> _SEVEN) * _GATHER) >> _GATHERED) << shift
                    k |= (((seen >> _SEVEN) * _GATHER) >> _GATHERED) << shift
                    f |= ((((bits >> _FRONTIER_SHIFT) & _EACH) * _GATHER) >> _GATHERED) << shift
                    n |= ((((bits >> _INFLATED_SHIFT) & _EACH) * _GATHER) >> _GATHERED) << shift
                solid[row - first, to] = s
                known[row - first, to] = s | k
                frontier[row - first, to] = f
                inflated[row - first, to] = n


@njit(cache=True, nogil=True)
def _inflate(solid, spans, grown):
    """Each solid cell with `spans[d]` cells to either side in the rows d from it.

    As one long row: the empty words at the ends of the rows keep them apart. Plain loops over slices, which
    the compiler turns into vectors.
    """
    stride = solid.shape[1]
    wide, into = solid.ravel().copy(), grown.ravel()
    wider = np.zeros_like(wide)
    size = len(wide)
    into[:] = _ZERO
    span = 0
    for away in range(len(spans) - 1, -1, -1):
        while span < spans[away]:
            here, before, after, out = wide[1:-1], wide[:-2], wide[2:], wider[1:-1]
            for k in range(size - 2):
                out[k] = here[k] | here[k] << _ONE | before[k] >> _TOP | here[k] >> _ONE | after[k] << _TOP
            wide, wider = wider, wide
            span += 1
        shift = min(away * stride, size)
        low, high = into[: size - shift], into[shift:]
        up, down = wide[shift:], wide[: size - shift]
        for k in range(size - shift):
            low[k] |= up[k]
        for k in range(size - shift):
            high[k] |= down[k]


@njit(cache=True, nogil=True)
def _mark(log_odds, flags, table, low, rectangle, spans, bounds, touched):
    """Renew frontier and inflation around a rectangle; which blocks' frontier changed, in `touched`.

    Returns how many blocks are missing that inflation falls into; if any, they are −1 in `table`, and
    nothing was written.
    """
    row, col, past_row, past_col = rectangle
    radius = len(spans) - 1
    margin = max(2 * radius, 2)
    first, past = row - margin, past_row + margin
    left = (col - margin) // SIDE
    words = (past_col + margin - 1) // SIDE - left + 1
    rows = past - first
    solid = np.empty((rows, words + 2), np.uint64)
    known = np.empty((rows, words + 2), np.uint64)
    frontier = np.empty((rows, words + 2), np.uint64)
    inflated = np.empty((rows, words + 2), np.uint64)
    grown = np.empty((rows, words + 2), np.uint64)
    edges = np.empty((rows, words + 2), np.uint64)
    for padding in (0, words + 1):
        solid[:, padding] = _ZERO
        known[:, padding] = _ZERO
    _gather(log_odds, flags, table, low, first, past, left, words, solid, known, frontier, inflated)
    _inflate(solid, spans, grown)

    inside = np.empty(words + 2, np.uint64)
    for word in range(words + 2):
        inside[word] = _columns(bounds[1], bounds[3], left + word - 1)
    missing = 0
    reach = max(radius, 1)
    for i in range(margin - reach, rows - margin + reach):
        in_bounds = bounds[0] <= first + i < bounds[2]
        near = margin - 1 <= i < rows - margin + 1
        above = bounds[0] <= first + i - 1 < bounds[2]
        below = bounds[0] <= first + i + 1 < bounds[2]
        in_reach = margin - radius <= i < rows - margin + radius
        for word in range(1, words + 1):
            if in_reach:
                write = _columns(col - radius, past_col + radius, left + word - 1)
                if in_bounds:
                    grown[i, word] = inflated[i, word] & ~write | grown[i, word] & inside[word] & write
                else:
                    grown[i, word] = inflated[i, word] & ~write
            else:
                grown[i, word] = inflated[i, word]
            if grown[i, word] != _ZERO:
                at = (first + i) // SIDE - low[0], left + word - 1 - low[1]
                if table[at] <= 0:
                    missing += table[at] == 0
                    table[at] = -1
        if not near:
            edges[i] = frontier[i]
            continue
        for word in range(1, words + 1):
            beside = _ZERO
            if in_bounds:
                here = ~known[i, word] & inside[word]
                beside = (
                    here << _ONE
                    | (~known[i, word - 1] & inside[word - 1]) >> _TOP
                    | here >> _ONE
                    | (~known[i, word + 1] & inside[word + 1]) << _TOP
                )
            if above:
                beside |= ~known[i - 1, word] & inside[word]
            if below:
                beside |= ~known[i + 1, word] & inside[word]
            write = _columns(col - 1, past_col + 1, left + word - 1)
            edges[i, word] = frontier[i, word] & ~write | known[i, word] & ~solid[i, word] & beside & write
    if missing > 0:
        return missing

    for i in range(margin - reach, rows - margin + reach):
        for word in range(1, words + 1):
            edge = edges[i, word]
            if edge == frontier[i, word] and grown[i, word] == inflated[i, word]:
                continue
            at = (first + i) // SIDE - low[0], left + word - 1 - low[1]
            touched[at] |= edge != frontier[i, word]
            line = flags[table[at], (first + i) & 63]
            for eight in range(8):
                shift = np.uint64(8 * eight)
                line[eight] = (
                    line[eight] & _OTHERS
                    | _SPREAD[(edge >> shift) & _BYTE] << _FRONTIER_SHIFT
                    | _SPREAD[(grown[i, word] >> shift) & _BYTE] << _INFLATED_SHIFT
                )
    return 0


# ---------------------------------------------------------------------------------- components of one block


@njit(cache=True, nogil=True)
def _root(parent, number):
    while parent[number] != number:
        parent[number] = parent[parent[number]]
        number = parent[number]
    return number


@njit(cache=True, nogil=True)
def _label(flags, slot, runs, parent):
    """The frontier's components in one block, in raster order of their first cells.

    Returns how many runs and components there are; `runs` (n, 4) are row, first and last column, and the
    component, 0 and up; `parent` is scratch.
    """
    count = 0
    before, here = 0, 0  # runs of the previous row start at `before`, this one's at `here`
    for row in range(SIDE):
        bits = _ZERO
        for eight in range(8):
            marks = (flags[slot, row, eight] >> _FRONTIER_SHIFT) & _EACH
            bits |= ((marks * _GATHER) >> _GATHERED) << np.uint64(8 * eight)
        before, here = here, count
        above = before
        while bits != _ZERO:
            first, past, bits = _first_run(bits)
            runs[count, 0], runs[count, 1], runs[count, 2] = row, first, past - 1
            parent[count] = count
            while above < here and runs[above, 2] < first - 1:
                above += 1
            touching = above
            while touching < here and runs[touching, 1] <= past:
                a, b = _root(parent, touching), _root(parent, count)
                if a < b:
                    parent[b] = a
                else:
                    parent[a] = b
                touching += 1
            count += 1
    components = 0
    for run in range(count):
        root = _root(parent, run)
        if root == run:
            runs[run, 3] = components
            components += 1
        else:
            runs[run, 3] = runs[root, 3]
    return count, components


# ------------------------------------------------------------------------------------------------- the pools


@njit(cache=True, nogil=True)
def _take(state, kind, pool, link):
    """A number from a pool: one that was given back, or a new one. `link` is where it chains free ones."""
    number = state[kind + 1]
    if number != 0:
        state[kind + 1] = pool[number, link]
    else:
        state[kind] += 1
        number = state[kind]
    return number


@njit(cache=True, nogil=True)
def _give(state, kind, pool, link, number):
    pool[number, link] = state[kind + 1]
    state[kind + 1] = number


@njit(cache=True, nogil=True)
def _new_node(state, nodes):
    node = _take(state, S_NODES, nodes, N_PARENT)
    nodes[node] = 0
    nodes[node, N_PARENT] = node
    return node


@njit(cache=True, nogil=True)
def _release(state, nodes, node):
    """One reference less; what has none left is free."""
    while True:
        nodes[node, N_REFS] -= 1
        if nodes[node, N_REFS] > 0:
            return
        parent = nodes[node, N_PARENT]
        _give(state, S_NODES, nodes, N_PARENT, node)
        if parent == node:
            return
        node = parent


@njit(cache=True, nogil=True)
def _cluster(state, components, nodes, component):
    """The root of a component, which from now on it points to."""
    node = components[component, C_NODE]
    root = node
    while nodes[root, N_PARENT] != root:
        root = nodes[root, N_PARENT]
    if root != node:
        nodes[root, N_REFS] += 1
        components[component, C_NODE] = root
        _release(state, nodes, node)
    return root


@njit(cache=True, nogil=True)
def _merge_clusters(nodes, a, b):
    """Make two clusters one; its root."""
    while nodes[a, N_PARENT] != a:
        a = nodes[a, N_PARENT]
    while nodes[b, N_PARENT] != b:
        b = nodes[b, N_PARENT]
    if a == b:
        return a
    if nodes[a, N_REFS] < nodes[b, N_REFS]:
        a, b = b, a
    nodes[b, N_PARENT] = a
    nodes[a, N_REFS] += 1
    for field in (N_SIZE, N_SUM_ROW, N_SUM_COL):
        nodes[a, field] += nodes[b, field]
    return a


@njit(cache=True, nogil=True)
def _sums(components, blocks, component):
    """A component's cells, and the sums of their rows and columns, over the whole map."""
    size, slot = np.int64(components[component, C_SIZE]), components[component, C_SLOT]
    rows = components[component, C_SUM_ROW] + size * SIDE * blocks[slot, B_ROW]
    cols = components[component, C_SUM_COL] + size * SIDE * blocks[slot, B_COL]
    return size, rows, cols


@njit(cache=True, nogil=True)
def _count(components, nodes, blocks, node, component, sign):
    """Add a component to a cluster's sums, or take it away."""
    size, rows, cols = _sums(components, blocks, component)
    nodes[node, N_SIZE] += sign * size
    nodes[node, N_SUM_ROW] += sign * rows
    nodes[node, N_SUM_COL] += sign * cols


# ----------------------------------------------------------------------------------------- the graph, locally


@njit(cache=True, nogil=True)
def _name(components, component, state, scratch, count):
    """Give a component a local number in this update, if it has none yet; how many there are now."""
    if components[component, C_EPOCH] == state[S_EPOCH]:
        return count
    components[component, C_EPOCH] = state[S_EPOCH]
    components[component, C_LOCAL] = count
    scratch[T_COMPONENT, count] = component
    scratch[T_PARENT, count] = count
    scratch[T_NODE, count] = 0
    return count + 1


@njit(cache=True, nogil=True)
def _forget(components, nodes, links, faces, runs, blocks, state, slot, scratch, count):
    """Take a block's components out of the graph; those they hung on get local numbers."""
    component = blocks[slot, B_HEAD]
    while component != 0:
        if components[component, C_NODE] != 0:
            node = _cluster(state, components, nodes, component)
            nodes[node, N_EPOCH] = state[S_EPOCH]
            nodes[node, N_CHAIN] = -1
            _count(components, nodes, blocks, node, component, -1)
            _release(state, nodes, node)
        link = components[component, C_LINK]
        while link != 0:
            other = links[link, L_TO]
            if components[other, C_LOCAL] >= 0 or components[other, C_EPOCH] != state[S_EPOCH]:
                count = _name(components, other, state, scratch, count)
                # Its way back.
                behind, back = 0, components[other, C_LINK]
                while links[back, L_TO] != component:
                    behind, back = back, links[back, L_NEXT]
                if behind == 0:
                    components[other, C_LINK] = links[back, L_NEXT]
                else:
                    links[behind, L_NEXT] = links[back, L_NEXT]
                _give(state, S_LINKS, links, L_NEXT, back)
            following = links[link, L_NEXT]
            _give(state, S_LINKS, links, L_NEXT, link)
            link = following
        following = components[component, C_NEXT]
        components[component, C_SIZE] = 0
        _give(state, S_COMPONENTS, components, C_NEXT, component)
        component = following
    blocks[slot, B_HEAD] = 0
    chain = blocks[slot, B_RUNS]
    while chain != 0:
        following = runs[chain, R_NEXT]
        _give(state, S_RUNS, runs, R_NEXT, chain)
        chain = following
    blocks[slot, B_RUNS] = 0
    faces[slot] = _ZERO
    return count


@njit(cache=True, nogil=True)
def _tie(components, links, state, a, b, scratch, count):
    """Two components touch across a border."""
    count = _name(components, a, state, scratch, count)
    count = _name(components, b, state, scratch, count)
    latest = components[a, C_LINK]
    if latest != 0 and links[latest, L_TO] == b:
        return count
    for one, other in ((a, b), (b, a)):
        link = _take(state, S_LINKS, links, L_NEXT)
        links[link, L_TO] = other
        links[link, L_NEXT] = components[one, C_LINK]
        components[one, C_LINK] = link
    p = _root(scratch[T_PARENT], components[a, C_LOCAL])
    q = _root(scratch[T_PARENT], components[b, C_LOCAL])
    scratch[T_PARENT, q] = p
    return count


@njit(cache=True, nogil=True)
def _create(
    flags, faces, runs, components, blocks, state, slot, row, col, found_runs, parent, numbers, sides
):
    """Components of a block, not yet in a cluster, and what of them lies on its sides."""
    blocks[slot, B_ROW], blocks[slot, B_COL] = row, col
    count, found = _label(flags, slot, found_runs, parent)
    for k in range(found - 1, -1, -1):
        component = _take(state, S_COMPONENTS, components, C_NEXT)
        numbers[k] = component
        components[component] = 0
        components[component, C_SLOT] = slot
        components[component, C_NEXT] = blocks[slot, B_HEAD]
        blocks[slot, B_HEAD] = component
    bits = faces[slot]
    for run in range(count):
        y, first, last = found_runs[run, 0], found_runs[run, 1], found_runs[run, 2]
        component = numbers[found_runs[run, 3]]
        size = last - first + 1
        if components[component, C_SIZE] == 0:
            components[component, C_FIRST] = y * SIDE + first
        components[component, C_SIZE] += size
        components[component, C_SUM_ROW] += size * y
        components[component, C_SUM_COL] += size * (first + last) // 2
        if 0 < y < SIDE - 1 and first > 0 and last < SIDE - 1:
            continue
        for side, end in ((LOW_ROW, 0), (HIGH_ROW, SIDE - 1)):
            if y == end:
                bits[side] |= _columns(first, last + 1, 0)
                sides[side, first] = component
        if first == 0:
            bits[LOW_COL] |= _ONE << np.uint64(y)
            sides[LOW_COL, y] = component
        if last == SIDE - 1:
            bits[HIGH_COL] |= _ONE << np.uint64(y)
            sides[HIGH_COL, y] = component
    chain, place = 0, RUNS
    for side in range(4):
        rest = bits[side]
        while rest != _ZERO:
            first, _, rest = _first_run(rest)
            if place == RUNS:
                following = _take(state, S_RUNS, runs, R_NEXT)
                runs[following, R_NEXT] = 0
                if chain == 0:
                    blocks[slot, B_RUNS] = following
                else:
                    runs[chain, R_NEXT] = following
                chain, place = following, R_FIRST
            runs[chain, place] = sides[side, first]
            place += 1


@njit(cache=True, nogil=True)
def _runs_before(faces, slot, side):
    """Runs of a block on the sides before one."""
    count = 0
    for before in range(side):
        count += _count_runs(faces[slot, before])
    return count


@njit(cache=True, nogil=True)
def _component_of(runs, blocks, slot, number):
    """The component of a block's run."""
    chain = blocks[slot, B_RUNS]
    while number >= RUNS - R_FIRST:
        chain = runs[chain, R_NEXT]
        number -= RUNS - R_FIRST
    return runs[chain, R_FIRST + number]


@njit(cache=True, nogil=True)
def _tie_sides(components, links, faces, runs, blocks, state, slot, side, other, other_side, scratch, count):
    """Tie what touches across the border between two blocks."""
    here, there = faces[slot, side], faces[other, other_side]
    if here & (there | there << _ONE | there >> _ONE) == _ZERO:
        return count
    number, facing = _runs_before(faces, slot, side), _runs_before(faces, other, other_side)
    while here != _ZERO:
        first, past, here = _first_run(here)
        beside, across = there, facing
        while beside != _ZERO:
            begin, end, rest = _first_run(beside)
            if begin > past:
                break
            if end < first:  # Nor does it touch what comes.
                there, facing = rest, across + 1
            else:
                a, b = _component_of(runs, blocks, slot, number), _component_of(runs, blocks, other, across)
                count = _tie(components, links, state, a, b, scratch, count)
            beside = rest
            across += 1
        number += 1
    return count


@njit(cache=True, nogil=True)
def _tie_block(components, links, faces, runs, blocks, state, table, touched, i, j, scratch, count):
    """Tie a block's components to those of the eight around it; of two that changed, the first ties."""
    slot = table[i, j]
    if blocks[slot, B_RUNS] == 0:
        return count
    for di in range(-1, 2):
        for dj in range(-1, 2):
            at = i + di, j + dj
            if (di == 0 and dj == 0) or (touched[at] and (di < 0 or (di == 0 and dj < 0))):
                continue
            other = table[at]
            if blocks[other, B_RUNS] == 0:
                continue
            if dj == 0:
                side, other_side = (LOW_ROW, HIGH_ROW) if di < 0 else (HIGH_ROW, LOW_ROW)
            elif di == 0:
                side, other_side = (LOW_COL, HIGH_COL) if dj < 0 else (HIGH_COL, LOW_COL)
            else:
                side, other_side = (LOW_ROW, HIGH_ROW) if di < 0 else (HIGH_ROW, LOW_ROW)
                corner, other_corner = (_ZERO, _TOP) if dj < 0 else (_TOP, _ZERO)
                if (faces[slot, side] >> corner) & (faces[other, other_side] >> other_corner) & _ONE:
                    # A side's first run, or its last.
                    number = _runs_before(faces, slot, side if dj < 0 else side + 1) - (dj > 0)
                    facing = _runs_before(faces, other, other_side + 1 if dj < 0 else other_side) - (dj < 0)
                    a, b = (
                        _component_of(runs, blocks, slot, number),
                        _component_of(runs, blocks, other, facing),
                    )
                    count = _tie(components, links, state, a, b, scratch, count)
                continue
            count = _tie_sides(
                components, links, faces, runs, blocks, state, slot, side, other, other_side, scratch, count
            )
    return count


@njit(cache=True, nogil=True)
def _split(components, nodes, links, blocks, state, chain, scratch):
    """Search what is left of a cluster for its pieces; all but one get a cluster of their own.

    From each group of components that still touch, outward in turn, until all groups have met but one:
    as many steps as the pieces that are split off have, or as the way round to where two meet.
    """
    parent = scratch[T_PARENT]
    queue, queue_end = scratch[T_QUEUE], scratch[T_QUEUE_END]
    reached, reached_end = scratch[T_REACHED], scratch[T_REACHED_END]
    active = scratch[T_ACTIVE]
    number = chain
    while number >= 0:
        queue[_root(parent, number)] = -1
        number = scratch[T_CHAIN, number]
    searches = 0
    number = chain
    while number >= 0:
        component, group = scratch[T_COMPONENT, number], _root(parent, number)
        components[component, C_QUEUED] = 0
        components[component, C_REACHED] = 0
        if queue[group] < 0:
            active[searches] = group
            searches += 1
            queue[group] = component
            reached[group] = component
        else:
            components[queue_end[group], C_QUEUED] = component
            components[reached_end[group], C_REACHED] = component
        queue_end[group] = component
        reached_end[group] = component
        number = scratch[T_CHAIN, number]
    turn = 0
    while searches > 1:
        if turn >= searches:
            turn = 0
        group = active[turn]
        component = queue[group]
        if component == 0:
            node = _new_node(state, nodes)
            component = reached[group]
            while component != 0:
                whole = _cluster(state, components, nodes, component)
                _count(components, nodes, blocks, whole, component, -1)
                _release(state, nodes, whole)
                components[component, C_NODE] = node
                nodes[node, N_REFS] += 1
                _count(components, nodes, blocks, node, component, 1)
                component = components[component, C_REACHED]
            searches -= 1
            active[turn] = active[searches]
            continue
        queue[group] = components[component, C_QUEUED]
        link = components[component, C_LINK]
        while link != 0:
            other = links[link, L_TO]
            link = links[link, L_NEXT]
            if components[other, C_NODE] == 0:  # New, or newly linked: what it unites is united already.
                continue
            if components[other, C_EPOCH] != state[S_EPOCH]:
                components[other, C_EPOCH] = state[S_EPOCH]
                components[other, C_LOCAL] = group
                components[other, C_QUEUED] = 0
                components[other, C_REACHED] = 0
                if queue[group] == 0:
                    queue[group] = other
                else:
                    components[queue_end[group], C_QUEUED] = other
                queue_end[group] = other
                components[reached_end[group], C_REACHED] = other
                reached_end[group] = other
                continue
            met = _root(parent, components[other, C_LOCAL])
            if met == group:
                continue
            parent[met] = group
            if queue[met] != 0:
                if queue[group] == 0:
                    queue[group] = queue[met]
                else:
                    components[queue_end[group], C_QUEUED] = queue[met]
                queue_end[group] = queue_end[met]
            components[reached_end[group], C_REACHED] = reached[met]
            reached_end[group] = reached_end[met]
            searches -= 1
            for k in range(searches):
                if active[k] == met:
                    active[k] = active[searches]
                    break
            if turn < searches and active[turn] != group:
                for k in range(searches):
                    if active[k] == group:
                        turn = k
                        break
        turn += 1


@njit(cache=True, nogil=True)
def _join(components, nodes, links, blocks, state, scratch, count):
    """Clusters of all components with local numbers; one that stands alone needs no node."""
    epoch = state[S_EPOCH]
    for number in range(count):
        component = scratch[T_COMPONENT, number]
        if components[component, C_NODE] != 0:
            node = _cluster(state, components, nodes, component)
            if nodes[node, N_EPOCH] == epoch:
                scratch[T_CHAIN, number] = nodes[node, N_CHAIN]
                nodes[node, N_CHAIN] = number
    for number in range(count):
        component = scratch[T_COMPONENT, number]
        if components[component, C_NODE] != 0:
            node = components[component, C_NODE]
            if nodes[node, N_EPOCH] == epoch and nodes[node, N_CHAIN] >= 0:
                chain = nodes[node, N_CHAIN]
                nodes[node, N_CHAIN] = -1
                _split(components, nodes, links, blocks, state, chain, scratch)
    parent = scratch[T_PARENT]
    for number in range(count):
        node = components[scratch[T_COMPONENT, number], C_NODE]
        if node != 0:
            group = _root(parent, number)
            other = scratch[T_NODE, group]
            scratch[T_NODE, group] = node if other == 0 else _merge_clusters(nodes, node, other)
    for number in range(count):
        component = scratch[T_COMPONENT, number]
        if components[component, C_NODE] == 0 and components[component, C_LINK] != 0:
            group = _root(parent, number)
            node = scratch[T_NODE, group]
            if node == 0:
                node = _new_node(state, nodes)
            while nodes[node, N_PARENT] != node:
                node = nodes[node, N_PARENT]
            scratch[T_NODE, group] = node
            components[component, C_NODE] = node
            nodes[node, N_REFS] += 1
            _count(components, nodes, blocks, node, component, 1)


# ------------------------------------------------------------------------------------------- what is called


@njit(cache=True, nogil=True)
def update(
    log_odds,
    flags,
    table,
    low,
    rectangle,
    spans,
    bounds,
    everything,
    components,
    nodes,
    links,
    faces,
    runs,
    blocks,
    state,
    scratch,
):
    """Renew frontier, inflation and clusters after a change inside a rectangle.

    The blocks whose frontier changed lose their components and get new ones, tied to those of the blocks
    around. A cluster that lost some may have fallen apart, which `_split` finds out.

    Args:
        log_odds: (slots, 64, 8) uint64, eight cells of int8 each.
        flags: (slots, 64, 8) uint64, eight cells of uint8 each; changed.
        table: (n, m) slots of the blocks around, two more to each side than the rectangle has.
        low: Row and column of the table's first block.
        rectangle: Row, column, past row, past column, in cells.
        spans: (radius + 1,) how far inflation reaches along a row, by rows away.
        bounds: Likewise a rectangle: what lies outside is nobody's frontier and is not inflated.
        everything: Renew the components of all blocks in the rectangle.
        components: (n, 12) int32.
        nodes: (n, 8) int64.
        links: (n, 2) int32.
        faces: (slots, 4) uint64.
        runs: (n, 8) int32.
        blocks: (slots, 4) int32.
        state: (10,) int64.
        scratch: (9, n) int32.

    Returns:
        How many blocks must be made first; they are −1 in the table.
    """
    touched = np.zeros(table.shape, np.bool_)
    missing = _mark(log_odds, flags, table, low, rectangle, spans, bounds, touched)
    if missing > 0:
        return missing
    if everything:
        for i in range(rectangle[0] // SIDE - low[0], (rectangle[2] - 1) // SIDE - low[0] + 1):
            for j in range(rectangle[1] // SIDE - low[1], (rectangle[3] - 1) // SIDE - low[1] + 1):
                touched[i, j] = table[i, j] != 0
    changed = 0
    state[S_EPOCH] += 1
    for i in range(table.shape[0]):
        for j in range(table.shape[1]):
            if touched[i, j]:
                changed += 1
                component = blocks[table[i, j], B_HEAD]
                while component != 0:
                    components[component, C_EPOCH] = state[S_EPOCH]
                    components[component, C_LOCAL] = -1
                    component = components[component, C_NEXT]
    if changed == 0:
        return 0
    state[S_CHANGES] += 1
    at = np.empty((changed, 2), np.int64)
    changed = 0
    for i in range(table.shape[0]):
        for j in range(table.shape[1]):
            if touched[i, j]:
                at[changed] = i, j
                changed += 1
    # A plain 0 would have all that takes the number compiled a second time.
    count = np.int64(0)
    for i, j in at:
        count = _forget(components, nodes, links, faces, runs, blocks, state, table[i, j], scratch, count)
    found = np.empty((SIDE * SIDE // 2, 4), np.int32)
    parent = np.empty(SIDE * SIDE // 2, np.int32)
    numbers = np.empty(SIDE * SIDE // 4, np.int32)
    sides = np.empty((4, SIDE), np.int32)
    for i, j in at:
        slot = table[i, j]
        row, col = low[0] + i, low[1] + j
        _create(flags, faces, runs, components, blocks, state, slot, row, col, found, parent, numbers, sides)
        component = blocks[slot, B_HEAD]
        while component != 0:
            count = _name(components, component, state, scratch, count)
            component = components[component, C_NEXT]
    for i, j in at:
        count = _tie_block(
            components, links, faces, runs, blocks, state, table, touched, i, j, scratch, count
        )
    _join(components, nodes, links, blocks, state, scratch, count)
    return 0


@njit(cache=True, nogil=True)
def read_clusters(components, nodes, blocks, state):
    """All clusters.

    Returns:
        (n, 3) size, sums of rows and of columns; (n, 3) first cell's row, column and component.
    """
    count = 0
    for node in range(1, state[S_NODES] + 1):
        if nodes[node, N_PARENT] == node and nodes[node, N_REFS] > 0:
            nodes[node, N_INDEX] = count
            count += 1
    alone = count
    for component in range(1, state[S_COMPONENTS] + 1):
        count += components[component, C_SIZE] > 0 and components[component, C_NODE] == 0
    sums = np.empty((count, 3), np.int64)
    firsts = np.zeros((count, 3), np.int64)
    for node in range(1, state[S_NODES] + 1):
        if nodes[node, N_PARENT] == node and nodes[node, N_REFS] > 0:
            sums[nodes[node, N_INDEX]] = nodes[node, N_SIZE], nodes[node, N_SUM_ROW], nodes[node, N_SUM_COL]
    for component in range(1, state[S_COMPONENTS] + 1):
        if components[component, C_SIZE] == 0:
            continue
        if components[component, C_NODE] == 0:
            sums[alone] = _sums(components, blocks, component)
            best = firsts[alone]
            alone += 1
        else:
            best = firsts[nodes[_cluster(state, components, nodes, component), N_INDEX]]
        slot, first = components[component, C_SLOT], components[component, C_FIRST]
        row = np.int64(blocks[slot, B_ROW]) * SIDE + first // SIDE
        col = np.int64(blocks[slot, B_COL]) * SIDE + first % SIDE
        if best[2] == 0 or row < best[0] or (row == best[0] and col < best[1]):
            best[:] = row, col, component
    return sums, firsts


@njit(cache=True, nogil=True)
def read_cells(flags, components, links, blocks, state, start, size):
    """(size, 2) cells of the cluster of a component, in no order."""
    cells = np.empty((size, 2), np.int64)
    runs = np.empty((SIDE * SIDE // 2, 4), np.int32)
    parent = np.empty(SIDE * SIDE // 2, np.int32)
    state[S_EPOCH] += 1
    epoch = state[S_EPOCH]
    components[start, C_EPOCH] = epoch
    components[start, C_QUEUED] = 0
    end = start
    count = 0
    component = start
    while component != 0:
        slot = components[component, C_SLOT]
        place, other = 0, blocks[slot, B_HEAD]
        while other != component:
            other = components[other, C_NEXT]
            place += 1
        found, _ = _label(flags, slot, runs, parent)
        for run in range(found):
            if runs[run, 3] == place:
                for col in range(runs[run, 1], runs[run, 2] + 1):
                    cells[count, 0] = np.int64(blocks[slot, B_ROW]) * SIDE + runs[run, 0]
                    cells[count, 1] = np.int64(blocks[slot, B_COL]) * SIDE + col
                    count += 1
        link = components[component, C_LINK]
        while link != 0:
            other = links[link, L_TO]
            if components[other, C_EPOCH] != epoch:
                components[other, C_EPOCH] = epoch
                components[other, C_QUEUED] = 0
                components[end, C_QUEUED] = other
                end = other
            link = links[link, L_NEXT]
        component = components[component, C_QUEUED]
    return cells


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
