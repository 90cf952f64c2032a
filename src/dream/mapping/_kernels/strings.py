"""Taut strings through water that is known to be free.

Points are (x, y, z), metres in the world. Kernels pass them to each other as tuples: an array for each would
take most of the time, and of what there is to compile.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

GAIN = 1e-3
"""Metres that a change has to make a string shorter by: less is not worth another look."""
PASSES = 100
"""Along the string at most."""

NEAR = 12
"""Boxes around both ends among which a way round what turned out not to be free is sought."""
LONGEST = 4096
"""Vertices that such ways take at most."""

FIRST: Any = np.int64(0)
SECOND: Any = np.int64(1)
"""To count from: what takes a literal is compiled for that alone, and once more for all other numbers."""
TOUCH = 1e-6
"""Of a box: what lies nearer to its side is on it."""
SETTLED, CLOSED = 1, 2
"""States of a point of a grid: its length is known; it lies in what is not free."""
ANCHOR, NONE = -1, -2
"""Corners that are no points of the grid."""


class FreeWater(NamedTuple):
    """Boxes of water, side by side."""

    free: npt.NDArray[np.uint8]
    """(levels, rows, cols) 1 where a box is known to be free. What lies outside is not."""
    low: npt.NDArray[np.float64]
    """(3,) x, y and z of the lower corner of the first box."""
    sides: npt.NDArray[np.float64]
    """(3,) metres of a box along x, y and z."""


@njit(cache=True, nogil=True)
def _at(points, i):
    return points[i, 0], points[i, 1], points[i, 2]


@njit(cache=True, nogil=True)
def _put(points, i, point):
    points[i, 0], points[i, 1], points[i, 2] = point


@njit(cache=True, nogil=True)
def _on(a, b, share):
    """The point at a share of the way from one to another."""
    return a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share


@njit(cache=True, nogil=True)
def _apart(a, b):
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@njit(cache=True, nogil=True)
def _along(a, b, low, side):
    """A way along one axis: the box where it begins, the step to the next, the share of the way until that
    is entered, and from there to the one after."""
    at, along = (a - low) / side, (b - a) / side
    box = math.floor(at)
    if along == 0.0:
        return box, 0, math.inf, math.inf
    each = abs(1.0 / along)
    if along > 0.0:
        return box, 1, (box + 1 - at) * each, each
    return box, -1, (at - box) * each, each


@njit(cache=True, nogil=True)
def _way_to_first(water, a, b):
    """Share of the way from one point straight to another before it enters what is not free; 1 where all is.

    Every box on the way counts (Amanatides and Woo, A Fast Voxel Traversal Algorithm, 1987).
    """
    low, sides = water.low, water.sides
    levels, rows, cols = water.free.shape
    col, east, to_col, each_col = _along(a[0], b[0], low[0], sides[0])
    row, north, to_row, each_row = _along(a[1], b[1], low[1], sides[1])
    level, up, to_level, each_level = _along(a[2], b[2], low[2], sides[2])
    entered = 0.0
    while 0 <= col < cols and 0 <= row < rows and 0 <= level < levels and water.free[level, row, col]:
        if to_level < min(to_col, to_row):
            entered = to_level
            level += up
            to_level += each_level
        elif to_col <= to_row:
            entered = to_col
            col += east
            to_col += each_col
        else:
            entered = to_row
            row += north
            to_row += each_row
        if entered >= 1.0:
            return 1.0
    return entered


@njit(cache=True, nogil=True)
def _both_free(water, a, b, c):
    """Is the way from one point by another to a third?"""
    return _way_to_first(water, a, b) >= 1.0 and _way_to_first(water, b, c) >= 1.0


@njit(cache=True, nogil=True)
def is_free(water, points):
    """Does a string lie in free water all along?

    Args:
        water: Where it may lie.
        points: (n, 3) its vertices.
    """
    free = True
    for i in range(1, len(points)):
        free = free and _way_to_first(water, _at(points, i - 1), _at(points, i)) >= 1.0
    return free


@njit(cache=True, nogil=True)
def _length(chain, count):
    total = 0.0
    for i in range(1, count):
        total += _apart(_at(chain, i - 1), _at(chain, i))
    return total


@njit(cache=True, nogil=True)
def _without(chain, count, i):
    """Take a vertex out; how many are left."""
    for k in range(i + 1, count):
        _put(chain, k - 1, _at(chain, k))
    return count - 1


@njit(cache=True, nogil=True)
def _with(chain, count, i, point):
    """Put a vertex in; how many there are then."""
    for k in range(count, i, -1):
        _put(chain, k, _at(chain, k - 1))
    _put(chain, i, point)
    return count + 1


@njit(cache=True, nogil=True)
def _swept(water, a, b, c):
    """How far a string from `a` to a point on its way from `b` to `c` moves freely.

    Returns:
        Share of the way, by samples half a box apart; and where on the string it is held up, as a share of it
        from `a`, 1 where it is not.
    """
    samples = max(math.ceil(2.0 * _apart(b, c) / min(water.sides[0], water.sides[1])), 1)
    for j in range(1, samples + 1):
        held = _way_to_first(water, a, _on(b, c, j / samples))
        if held < 1.0:
            return (j - 1) / samples, held
    return 1.0, 1.0


@njit(cache=True, nogil=True)
def _cut(water, chain, count, i):
    """Pull the string tight over a vertex, in the plane of its neighbours; the vertices that it then has.

    The vertex goes along the string as far as what lies between lets it, first to one side, then to the
    other; there the string gets another one.
    """
    a, b, c = _at(chain, i - 1), _at(chain, i), _at(chain, i + 1)
    for side in range(2):
        share, held = _swept(water, a, b, c)
        if share >= 1.0 and side == 0:
            return _without(chain, count, i)
        to = _on(b, c, share)
        if _apart(a, b) + _apart(b, to) - _apart(a, to) > GAIN:
            touch = _on(a, to, held)
            _put(chain, i, to)
            if min(_apart(a, touch), _apart(touch, to)) > GAIN and count < len(chain):
                return _with(chain, count, i + side, touch)
            return count
        a, c = c, a
    return count


@njit(cache=True, nogil=True)
def _pull(a, here, c):
    """The pull of a string on a vertex between two others, as a share of its tension."""
    first, last = _apart(a, here), _apart(here, c)
    if first == 0.0 or last == 0.0:
        return 0.0
    return _apart(_on(here, a, 1.0 / first), _on(c, here, 1.0 + 1.0 / last))


@njit(cache=True, nogil=True)
def _slide(water, chain, i, friction):
    """Move a vertex to where the string is shorter beside it, also out of the plane of its neighbours.

    It slides where its pull that way, the metres by which the string gets shorter for each that the vertex
    moves, is more than its friction under the whole of its pull (Coulomb's law).
    """
    a, here, c = _at(chain, i - 1), _at(chain, i), _at(chain, i + 1)
    if not _both_free(water, a, here, c):
        return
    least = _apart(a, here) + _apart(here, c)
    reach = min(water.sides[0], water.sides[1])
    for _ in range(3):
        moved = True
        while moved:
            moved, middle, longest = False, here, least
            held = friction * _pull(a, here, c)
            for n in range(27):
                to = (
                    middle[0] + (n % 3 - 1) * reach,
                    middle[1] + (n // 3 % 3 - 1) * reach,
                    middle[2] + (n // 9 - 1) * reach,
                )
                length = _apart(a, to) + _apart(to, c)
                if length > least - GAIN or length > longest - held * _apart(middle, to):
                    continue
                if _both_free(water, a, to, c) and _both_free(water, a, _on(middle, to, 0.5), c):
                    here, least, moved = to, length, True
        reach *= 0.5
    _put(chain, i, here)


@njit(cache=True, nogil=True)
def _box_of(water, point):
    """Level, row and column of the box that a point lies in; the level −1 where that is not free."""
    level = math.floor((point[2] - water.low[2]) / water.sides[2])
    row = math.floor((point[1] - water.low[1]) / water.sides[1])
    col = math.floor((point[0] - water.low[0]) / water.sides[0])
    levels, rows, cols = water.free.shape
    inside = 0 <= level < levels and 0 <= row < rows and 0 <= col < cols
    if not (inside and water.free[level, row, col]):
        level = -1
    return level, row, col


@njit(cache=True, nogil=True)
def _window(a, b, count):
    """The first of the boxes along an axis that are near two of them, and how many those are."""
    low = max(min(a, b) - NEAR, 0)
    return low, min(max(a, b) + NEAR + 1, count) - low


@njit(cache=True, nogil=True)
def _round(water, first, last):
    """The fewest free boxes that lead from one to another, face to face, near both.

    Returns:
        (n, 3) their middles, ends included; none where none lead there.
    """
    level, levels = _window(first[0], last[0], water.free.shape[0])
    row, rows = _window(first[1], last[1], water.free.shape[1])
    col, cols = _window(first[2], last[2], water.free.shape[2])
    before = np.full(levels * rows * cols, -1, np.int64)
    start = ((first[0] - level) * rows + first[1] - row) * cols + first[2] - col
    goal = ((last[0] - level) * rows + last[1] - row) * cols + last[2] - col
    queue = np.empty(len(before), np.int64)
    queue[0], before[start] = start, start
    head, tail = 0, 1
    while head < tail and before[goal] < 0:
        here = queue[head]
        head += 1
        for n in range(6):
            step = 2 * (n % 2) - 1
            h = here // (rows * cols) + (step if n // 2 == 0 else 0)
            i = here // cols % rows + (step if n // 2 == 1 else 0)
            j = here % cols + (step if n // 2 == 2 else 0)
            if not (0 <= h < levels and 0 <= i < rows and 0 <= j < cols):
                continue
            other = (h * rows + i) * cols + j
            if before[other] < 0 and water.free[h + level, i + row, j + col]:
                before[other] = here
                queue[tail] = other
                tail += 1
    if before[goal] < 0:
        return np.empty((0, 3))
    count, here = 1, goal
    while here != start:
        here = before[here]
        count += 1
    middles, here = np.empty((count, 3)), goal
    for n in range(count - 1, -1, -1):
        middles[n, 0] = water.low[0] + (here % cols + col + 0.5) * water.sides[0]
        middles[n, 1] = water.low[1] + (here // cols % rows + row + 0.5) * water.sides[1]
        middles[n, 2] = water.low[2] + (here // (rows * cols) + level + 0.5) * water.sides[2]
        here = before[here]
    return middles


@njit(cache=True, nogil=True)
def _released(water, points):
    """A string led the shortest way round what turned out not to be free where it lay.

    Args:
        water: Where it may lie.
        points: (n, 3) its vertices; the ends stay.

    Returns:
        (m, 3) its vertices; as they were where no way round is near.
    """
    spacing = 0.25 * min(water.sides[0], water.sides[1])
    total = len(points)
    for i in range(1, len(points)):
        total += math.ceil(_apart(_at(points, i - 1), _at(points, i)) / spacing)
    fine, count = np.empty((total, 3)), SECOND
    _put(fine, FIRST, _at(points, FIRST))
    for i in range(1, len(points)):
        a, b = _at(points, i - 1), _at(points, i)
        samples = max(math.ceil(_apart(a, b) / spacing), 1)
        for k in range(1, samples + 1):
            _put(fine, count, _on(a, b, k / samples))
            count += 1
    found = np.empty((count + LONGEST, 3))
    _put(found, FIRST, _at(points, FIRST))
    length, k = SECOND, SECOND
    level, led_round = len(water.free) == 1, False
    while k < count:
        after = k
        while after < count and _box_of(water, _at(fine, after))[0] < 0:
            after += 1
        first = _box_of(water, _at(found, length - 1))
        if k < after < count and first[0] >= 0:
            way = _round(water, first, _box_of(water, _at(fine, after)))
            if len(way) and length + len(way) + count - after < len(found):
                for n in range(len(way)):
                    _put(found, length, _at(way, n))
                    if level:
                        found[length, 2] = fine[k, 2]
                    length += 1
                k, led_round = after, True
                continue
        for i in range(k, max(after, k + 1)):
            _put(found, length, _at(fine, i))
            length += 1
        k = max(after, k + 1)
    return found[:length].copy() if led_round else points


@njit(cache=True, nogil=True)
def _cut_all(water, chain, count):
    """Cut each corner of a string once; the vertices that it then has."""
    i = SECOND
    while i < count - 1:
        after = _cut(water, chain, count, i)
        # Where a vertex fell out, the one before has other neighbours.
        i = max(i - 1, SECOND) if after < count else i + 1
        count = after
    return count


@njit(cache=True, nogil=True)
def tighten(water, points):
    """A string pulled tight without taking it across what is not free.

    It stays where it lies over something: a vertex moves in the plane of its neighbours alone. What lies in
    what is not free, since the map changed its mind, is led round it first, or stays where no way round is
    near.

    Args:
        water: Where it may lie.
        points: (n, 3) its vertices; the ends stay.

    Returns:
        (m, 3) its vertices.
    """
    if not is_free(water, points):
        points = _released(water, points)
    return _pulled(water, points, math.inf)


@njit(cache=True, nogil=True)
def slide(water, points, friction):
    """A string pulled tight that slides off what it lies over, to where it is shorter nearby.

    Args:
        water: Where it may lie.
        points: (n, 3) its vertices, pulled tight; the ends stay.
        friction: Its coefficient on what it lies over.

    Returns:
        (m, 3) its vertices.
    """
    return _pulled(water, points, friction)


@njit(cache=True, nogil=True)
def _pulled(water, points, friction):
    """A string pulled tight until it gets no shorter; nothing slides where the friction is infinite."""
    count = len(points)
    chain = np.empty((4 * count + 256, 3))
    for i in range(count):
        _put(chain, i, _at(points, i))
    length = _length(chain, count)
    for _ in range(PASSES):
        count = _cut_all(water, chain, count)
        if friction < math.inf:
            for i in range(1, count - 1):
                _slide(water, chain, i, friction)
        shorter = _length(chain, count)
        if shorter > length - GAIN:
            break
        length = shorter
    return chain[:count].copy()


@njit(cache=True, nogil=True)
def beside(water, string, points, reach):
    """Which points a free straight way of so many metres at most links with the nearest of a string.

    Args:
        water: Where the ways may lead.
        string: (n, 3) its vertices.
        points: (m, 3).
        reach: Metres.

    Returns:
        (m,) bool.
    """
    linked = np.zeros(len(points), np.bool_)
    for m in range(len(points)):
        point, least = _at(points, m), reach
        nearest, found = point, False
        for i in range(max(len(string) - 1, 1)):
            a, b = _at(string, i), _at(string, min(i + 1, len(string) - 1))
            x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            square, share = x * x + y * y + z * z, 0.0
            if square > 0.0:
                dot = (point[0] - a[0]) * x + (point[1] - a[1]) * y + (point[2] - a[2]) * z
                share = min(max(dot / square, 0.0), 1.0)
            foot = _on(a, b, share)
            if _apart(foot, point) <= least:
                least, nearest, found = _apart(foot, point), foot, True
        linked[m] = found and _way_to_first(water, nearest, point) >= 1.0
    return linked


@njit(cache=True, nogil=True)
def _rise(heap, place, keys, node):
    """Move a node up a binary heap to where its key belongs.

    The least key comes first, and of two alike the lower node.
    """
    k = place[node]
    while k > 0:
        above = heap[(k - 1) // 2]
        if keys[above] < keys[node] or (keys[above] == keys[node] and above < node):
            break
        heap[k], place[above] = above, k
        k = (k - 1) // 2
    heap[k], place[node] = node, k


@njit(cache=True, nogil=True)
def _pop(heap, place, keys, count):
    """Take the first node out of a heap of so many."""
    first, node, k = heap[0], heap[count - 1], 0
    while 2 * k + 1 < count - 1:
        child = 2 * k + 1
        if child + 1 < count - 1:
            a, b = heap[child], heap[child + 1]
            if keys[b] < keys[a] or (keys[b] == keys[a] and b < a):
                child += 1
        below = heap[child]
        if keys[node] < keys[below] or (keys[node] == keys[below] and node < below):
            break
        heap[k], place[below] = below, k
        k = child
    heap[k], place[node] = node, k
    return first


@njit(cache=True, nogil=True)
def _touches_free(water, point):
    """Does a point lie in a free box, or on a side of one?"""
    levels, rows, cols = water.free.shape
    x = (point[0] - water.low[0]) / water.sides[0]
    y = (point[1] - water.low[1]) / water.sides[1]
    z = (point[2] - water.low[2]) / water.sides[2]
    for level in range(max(math.floor(z - TOUCH), 0), min(math.floor(z + TOUCH) + 1, levels)):
        for row in range(max(math.floor(y - TOUCH), 0), min(math.floor(y + TOUCH) + 1, rows)):
            for col in range(max(math.floor(x - TOUCH), 0), min(math.floor(x + TOUCH) + 1, cols)):
                if water.free[level, row, col]:
                    return True
    return False


@njit(cache=True, nogil=True)
def _grid_point(first, spacing, shape, node):
    """Where a node of a grid is, counted along its columns, rows and levels."""
    _, rows, cols = shape
    return (
        first[0] + node % cols * spacing,
        first[1] + node // cols % rows * spacing,
        first[2] + node // (rows * cols) * spacing,
    )


@njit(cache=True, nogil=True)
def _node_beside(shape, level, row, col, n):
    """One of the 27 nodes of a grid around a place in it; −1 where that lies outside."""
    levels, rows, cols = shape
    level, row, col = level + n // 9 - 1, row + n // 3 % 3 - 1, col + n % 3 - 1
    if 0 <= level < levels and 0 <= row < rows and 0 <= col < cols:
        return (level * rows + row) * cols + col
    return -1


@njit(cache=True, nogil=True)
def lengths(water, anchor, first, spacing, shape, most):
    """How long a string from an anchor has to be at least to reach the points of a grid.

    Theta* over the grid (Nash et al., 2007): a way to a point leads straight from the last corner that sees
    it, so that the lengths exceed the least by little.

    Args:
        water: Where it may lie.
        anchor: (3,).
        first: (3,) x, y and z of the first point.
        spacing: Metres between the points.
        shape: Levels, rows and columns.
        most: Metres up to which lengths are found.

    Returns:
        (levels, rows, cols) metres; infinite where they are more, or where no way leads.
    """
    levels, rows, cols = shape
    count = levels * rows * cols
    found = np.full(count, np.inf)
    state = np.zeros(count, np.uint8)
    # The last corner of the way to each node, and the last that turned out not to see it.
    corner, unseen = np.full(count, ANCHOR, np.int64), np.full(count, NONE, np.int64)
    heap, place, queued = np.empty(count, np.int64), np.full(count, NONE, np.int64), FIRST
    start = (anchor[0], anchor[1], anchor[2])
    level = round((start[2] - first[2]) / spacing)
    row, col = round((start[1] - first[1]) / spacing), round((start[0] - first[0]) / spacing)
    # The anchor is linked to the points around it.
    for n in range(27):
        other = _node_beside(shape, level, row, col, n)
        if other < 0:
            continue
        at = _grid_point(first, spacing, shape, other)
        if _way_to_first(water, start, at) >= 1.0:
            found[other] = _apart(start, at)
            heap[queued], place[other] = other, queued
            queued += 1
            _rise(heap, place, found, other)
    while queued:
        node = _pop(heap, place, found, queued)
        queued -= 1
        if found[node] > most:
            break
        state[node] = SETTLED
        here, last = _grid_point(first, spacing, shape, node), corner[node]
        bend, to_bend = start, 0.0
        if last != ANCHOR:
            bend, to_bend = _grid_point(first, spacing, shape, last), found[last]
        for n in range(27):
            other = _node_beside(shape, node // (rows * cols), node // cols % rows, node % cols, n)
            if other < 0 or state[other]:
                continue
            at = _grid_point(first, spacing, shape, other)
            length, via = to_bend + _apart(bend, at), last
            if length >= found[other] - 1e-9 or length > most:
                continue
            if not _touches_free(water, at):
                state[other] = CLOSED
                continue
            if unseen[other] == last or _way_to_first(water, bend, at) < 1.0:
                unseen[other] = last
                length, via = found[node] + _apart(here, at), node
                if length >= found[other] or _way_to_first(water, here, at) < 1.0:
                    continue
            found[other], corner[other] = length, via
            if place[other] == NONE:
                heap[queued], place[other] = other, queued
                queued += 1
            _rise(heap, place, found, other)
    for node in range(count):
        if state[node] != SETTLED:
            found[node] = np.inf
    return found.reshape(levels, rows, cols)
