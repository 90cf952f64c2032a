"""Taut strings through water that is known to be free.

Points are (x, y, z), metres in the world.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import heapq
import math
from typing import NamedTuple

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


class FreeWater(NamedTuple):
    """Boxes of water, side by side."""

    free: npt.NDArray[np.uint8]
    """(levels, rows, cols) 1 where a box is known to be free. What lies outside is not."""
    low: npt.NDArray[np.float64]
    """(3,) x, y and z of the lower corner of the first box."""
    sides: npt.NDArray[np.float64]
    """(3,) metres of a box along x, y and z."""


@njit(cache=True, nogil=True)
def way_to_first(water, a, b):
    """Share of the way from one point straight to another before it enters what is not free; 1 where all is.

    Every box on the way counts (Amanatides and Woo, A Fast Voxel Traversal Algorithm, 1987).
    """
    cell, step = np.empty(3, np.int64), np.empty(3, np.int64)
    following, each = np.empty(3), np.empty(3)
    for k in range(3):
        at, along = (a[k] - water.low[k]) / water.sides[k], (b[k] - a[k]) / water.sides[k]
        cell[k] = math.floor(at)
        step[k] = 1 if along > 0.0 else -1
        if along == 0.0:
            following[k] = each[k] = math.inf
        else:
            each[k] = abs(1.0 / along)
            edge = cell[k] + 1 - at if along > 0.0 else at - cell[k]
            following[k] = edge * each[k]
    cols, rows, levels = water.free.shape[2], water.free.shape[1], water.free.shape[0]
    entered = 0.0
    while True:
        if not (0 <= cell[0] < cols and 0 <= cell[1] < rows and 0 <= cell[2] < levels):
            return entered
        if not water.free[cell[2], cell[1], cell[0]]:
            return entered
        k = 0 if following[0] <= following[1] else 1
        if following[2] < following[k]:
            k = 2
        entered = following[k]
        if entered >= 1.0:
            return 1.0
        cell[k] += step[k]
        following[k] += each[k]


@njit(cache=True, nogil=True)
def _apart(a, b):
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@njit(cache=True, nogil=True)
def _length(chain, count):
    total = 0.0
    for i in range(1, count):
        total += _apart(chain[i - 1], chain[i])
    return total


@njit(cache=True, nogil=True)
def _swept(water, a, b, c):
    """How far a string from `a` to a point on its way from `b` to `c` moves freely.

    Returns:
        Share of the way, by samples half a box apart; and where on the string it is held up, as a share of it
        from `a`, 1 where it is not.
    """
    samples = max(math.ceil(2.0 * _apart(b, c) / min(water.sides[0], water.sides[1])), 1)
    for j in range(1, samples + 1):
        held = way_to_first(water, a, b + (c - b) * (j / samples))
        if held < 1.0:
            return (j - 1) / samples, held
    return 1.0, 1.0


@njit(cache=True, nogil=True)
def _cut(water, chain, count, i):
    """Pull the string tight over a vertex, in the plane of its neighbours; the vertices that it then has.

    The vertex goes along the string as far as what lies between lets it; there the string gets another one.
    """
    a, b, c = chain[i - 1].copy(), chain[i].copy(), chain[i + 1].copy()
    share, held = _swept(water, a, b, c)
    if share >= 1.0:
        chain[i : count - 1] = chain[i + 1 : count].copy()
        return count - 1
    to = b + (c - b) * share
    if _apart(a, b) + _apart(b, to) - _apart(a, to) > GAIN:
        touch = a + (to - a) * held
        chain[i] = to
        if min(_apart(a, touch), _apart(touch, to)) > GAIN and count < len(chain):
            chain[i + 1 : count + 1] = chain[i:count].copy()
            chain[i] = touch
            return count + 1
        return count
    share, held = _swept(water, c, b, a)
    to = b + (a - b) * share
    if _apart(c, b) + _apart(b, to) - _apart(c, to) > GAIN:
        touch = c + (to - c) * held
        chain[i] = to
        if min(_apart(c, touch), _apart(touch, to)) > GAIN and count < len(chain):
            chain[i + 2 : count + 1] = chain[i + 1 : count].copy()
            chain[i + 1] = touch
            return count + 1
    return count


@njit(cache=True, nogil=True)
def _slide(water, chain, i):
    """Move a vertex to where the string is shorter beside it, also out of the plane of its neighbours."""
    a, c = chain[i - 1], chain[i + 1]
    least = _apart(a, chain[i]) + _apart(chain[i], c)
    held = way_to_first(water, a, chain[i]) < 1.0 or way_to_first(water, chain[i], c) < 1.0
    to = np.empty(3)
    reach = min(water.sides[0], water.sides[1])
    for _ in range(3):
        moved = True
        while moved:
            moved = False
            here = chain[i].copy()
            for n in range(27):
                to[0] = here[0] + (n % 3 - 1) * reach
                to[1] = here[1] + (n // 3 % 3 - 1) * reach
                to[2] = here[2] + (n // 9 - 1) * reach
                length = _apart(a, to) + _apart(to, c)
                if length > least - GAIN or held:
                    continue
                if way_to_first(water, a, to) < 1.0 or way_to_first(water, to, c) < 1.0:
                    continue
                middle = 0.5 * (here + to)
                if way_to_first(water, a, middle) < 1.0 or way_to_first(water, middle, c) < 1.0:
                    continue
                chain[i] = to
                least, moved = length, True
        reach *= 0.5


@njit(cache=True, nogil=True)
def _box_of(water, point):
    """(3,) level, row and column of the box that a point lies in; its level −1 where that is not free."""
    box = np.empty(3, np.int64)
    for k in range(3):
        box[2 - k] = math.floor((point[k] - water.low[k]) / water.sides[k])
    for k in range(3):
        if not 0 <= box[k] < water.free.shape[k]:
            box[0] = -1
            return box
    if not water.free[box[0], box[1], box[2]]:
        box[0] = -1
    return box


@njit(cache=True, nogil=True)
def _round(water, first, last):
    """The fewest free boxes that lead from one to another, face to face, near both.

    Returns:
        (n, 3) their middles, ends included; none where none lead there.
    """
    low, past = np.empty(3, np.int64), np.empty(3, np.int64)
    for k in range(3):
        low[k] = max(min(first[k], last[k]) - NEAR, 0)
        past[k] = min(max(first[k], last[k]) + NEAR + 1, water.free.shape[k])
    shape = past - low
    before = np.full(shape[0] * shape[1] * shape[2], -1, np.int64)
    start = ((first[0] - low[0]) * shape[1] + first[1] - low[1]) * shape[2] + first[2] - low[2]
    goal = ((last[0] - low[0]) * shape[1] + last[1] - low[1]) * shape[2] + last[2] - low[2]
    queue = np.empty(len(before), np.int64)
    queue[0], before[start] = start, start
    head, tail = 0, 1
    while head < tail and before[goal] < 0:
        here = queue[head]
        head += 1
        at = here // (shape[1] * shape[2]), here // shape[2] % shape[1], here % shape[2]
        for n in range(6):
            axis, step = n // 2, 2 * (n % 2) - 1
            h = at[0] + (step if axis == 0 else 0)
            i = at[1] + (step if axis == 1 else 0)
            j = at[2] + (step if axis == 2 else 0)
            if not (0 <= h < shape[0] and 0 <= i < shape[1] and 0 <= j < shape[2]):
                continue
            other = (h * shape[1] + i) * shape[2] + j
            if before[other] >= 0 or not water.free[h + low[0], i + low[1], j + low[2]]:
                continue
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
        middles[n, 0] = water.low[0] + (here % shape[2] + low[2] + 0.5) * water.sides[0]
        middles[n, 1] = water.low[1] + (here // shape[2] % shape[1] + low[1] + 0.5) * water.sides[1]
        middles[n, 2] = water.low[2] + (here // (shape[1] * shape[2]) + low[0] + 0.5) * water.sides[2]
        here = before[here]
    return middles


@njit(cache=True, nogil=True)
def released(water, points):
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
        total += math.ceil(_apart(points[i - 1], points[i]) / spacing)
    fine, count = np.empty((total, 3)), 1
    fine[0] = points[0]
    for i in range(1, len(points)):
        samples = max(math.ceil(_apart(points[i - 1], points[i]) / spacing), 1)
        for k in range(1, samples + 1):
            fine[count] = points[i - 1] + (points[i] - points[i - 1]) * (k / samples)
            count += 1
    found = np.empty((count + LONGEST, 3))
    found[0] = points[0]
    length, k = 1, 1
    level, led_round = len(water.free) == 1, False
    while k < count:
        if _box_of(water, fine[k])[0] >= 0 or length + count - k > len(found) - 1:
            found[length] = fine[k]
            length, k = length + 1, k + 1
            continue
        after = k
        while after < count and _box_of(water, fine[after])[0] < 0:
            after += 1
        first = _box_of(water, found[length - 1])
        if after < count and first[0] >= 0:
            way = _round(water, first, _box_of(water, fine[after]))
            if len(way) and length + len(way) + count - after < len(found):
                for n in range(len(way)):
                    found[length] = way[n]
                    if level:
                        found[length, 2] = fine[k, 2]
                    length += 1
                k, led_round = after, True
                continue
        while k < after:
            found[length] = fine[k]
            length, k = length + 1, k + 1
    return found[:length].copy() if led_round else points


@njit(cache=True, nogil=True)
def tighten(water, points):
    """A string pulled tight without taking it across what is not free.

    What lies in what is not free, since the map changed its mind, is led round it first, or stays where no
    way round is near.

    Args:
        water: Where it may lie.
        points: (n, 3) its vertices; the ends stay.

    Returns:
        (m, 3) its vertices.
    """
    for i in range(1, len(points)):
        if way_to_first(water, points[i - 1], points[i]) < 1.0:
            points = released(water, points)
            break
    count = len(points)
    chain = np.empty((4 * count + 256, 3))
    chain[:count] = points
    length = _length(chain, count)
    for _ in range(PASSES):
        i = 1
        while i < count - 1:
            after = _cut(water, chain, count, i)
            # Where a vertex fell out, the one before has other neighbours.
            i = max(i - 1, 1) if after < count else i + 1
            count = after
        for i in range(1, count - 1):
            _slide(water, chain, i)
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
        point, least = points[m], reach
        nearest = point
        found = False
        for i in range(max(len(string) - 1, 1)):
            a, b = string[i], string[min(i + 1, len(string) - 1)]
            along = b - a
            square = along[0] * along[0] + along[1] * along[1] + along[2] * along[2]
            share = 0.0
            if square > 0.0:
                away = point - a
                dot = away[0] * along[0] + away[1] * along[1] + away[2] * along[2]
                share = min(max(dot / square, 0.0), 1.0)
            foot = a + along * share
            if _apart(foot, point) <= least:
                least, nearest, found = _apart(foot, point), foot, True
        linked[m] = found and way_to_first(water, nearest, point) >= 1.0
    return linked


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
    found = np.full(levels * rows * cols, np.inf)
    corner = np.empty((levels * rows * cols, 3))
    to_corner = np.empty(levels * rows * cols)
    settled = np.zeros(levels * rows * cols, np.bool_)
    queue = [(0.0, 0)]
    queue.pop()
    at, near = np.empty(3), np.empty(3, np.int64)
    for k in range(3):
        near[k] = round((anchor[k] - first[k]) / spacing)
    # The anchor is linked to the points around it.
    for n in range(27):
        col, row, level = near[0] + n % 3 - 1, near[1] + n // 3 % 3 - 1, near[2] + n // 9 - 1
        if not (0 <= level < levels and 0 <= row < rows and 0 <= col < cols):
            continue
        at[0], at[1], at[2] = first[0] + col * spacing, first[1] + row * spacing, first[2] + level * spacing
        if way_to_first(water, anchor, at) >= 1.0:
            node = (level * rows + row) * cols + col
            found[node] = _apart(anchor, at)
            corner[node], to_corner[node] = anchor, 0.0
            heapq.heappush(queue, (found[node], node))
    here = np.empty(3)
    while len(queue):
        length, node = heapq.heappop(queue)
        if settled[node] or length > most:
            continue
        settled[node] = True
        level, row, col = node // (rows * cols), node // cols % rows, node % cols
        here[0], here[1] = first[0] + col * spacing, first[1] + row * spacing
        here[2] = first[2] + level * spacing
        for n in range(27):
            j, i, h = col + n % 3 - 1, row + n // 3 % 3 - 1, level + n // 9 - 1
            if not (0 <= h < levels and 0 <= i < rows and 0 <= j < cols):
                continue
            other = (h * rows + i) * cols + j
            if settled[other]:
                continue
            at[0], at[1], at[2] = first[0] + j * spacing, first[1] + i * spacing, first[2] + h * spacing
            straight = to_corner[node] + _apart(corner[node], at)
            if straight >= found[other] - 1e-9:
                continue
            if way_to_first(water, corner[node], at) >= 1.0:
                found[other] = straight
                corner[other], to_corner[other] = corner[node], to_corner[node]
                heapq.heappush(queue, (straight, other))
            elif length + _apart(here, at) < found[other] and way_to_first(water, here, at) >= 1.0:
                found[other] = length + _apart(here, at)
                corner[other], to_corner[other] = here, length
                heapq.heappush(queue, (found[other], other))
    for node in range(len(found)):
        if not settled[node] or found[node] > most:
            found[node] = np.inf
    return found.reshape(levels, rows, cols)
