"""What each pose shows, and what is gained by looking from it.

Elements are what can be looked at, once each: tiles of ground, tiles as places where a group may hide, and
whatever else a caller lists pose by pose. A tile is a square between four nodes of the lattice.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

BEARINGS = 256
"""Rays in a full turn: at 32 cells they are closer than a cell."""
ROUNDING = 1e-4
"""Weight a step by which rounding may make a view better than another."""
HALF_DIAGONAL = 0.708
"""Of a cell, in cells; rounded up."""
FEW = 256
"""Cells up to which it is worth finding which bearings lead over them; of more, all are followed."""


class Views(NamedTuple):
    """Which elements each pose shows; poses are numbered as those of `Graph`."""

    first: npt.NDArray[np.int64]
    """(headings + 1,) where the list of each heading begins in the next three."""
    offset: npt.NDArray[np.int32]
    """(n,) elements from the tile of the node."""
    bearing: npt.NDArray[np.uint8]
    """(n,) the ray that must get there."""
    far: npt.NDArray[np.uint8]
    """(n,) how far, in cells."""
    depth: npt.NDArray[np.uint8]
    """(nodes, bearings) how far rays get, in cells."""
    tile: npt.NDArray[np.int64]
    """(nodes,) the tile of each node; there are so many around them that no view leaves the grid of tiles."""
    tiles: int
    """In the grid of tiles."""
    stride: int
    """In a row of it."""
    listed: npt.NDArray[np.int64]
    """(nodes,) row in the list of further elements; −1 without."""
    listed_first: npt.NDArray[np.int64]
    """(rows · headings + 1,) where each pose's begin."""
    listed_element: npt.NDArray[np.int32]
    """(m,) the elements."""


@njit(cache=True, nogil=True)
def sight_lines(solid, changed, x0, y0, scale, limit, place, depth, which):
    """Write how far some bearings are open from lattice nodes, in cells: those that led over some cells.

    Args:
        solid: (R, C) bool, cells.
        changed: (n, 2) rows and columns of the cells that are solid now and were not, or were and are not.
        x0: Column of node 0, in cells.
        y0: Row of it.
        scale: Cells between nodes.
        limit: Cells beyond which nothing is looked at.
        place: See `Graph`.
        depth: (nodes, BEARINGS) uint8 to write.
        which: (m,) the nodes to write.
    """
    height, width = solid.shape
    ahead = np.empty((2, BEARINGS))
    for b in range(BEARINGS):
        angle = 2.0 * math.pi * (b + 0.5) / BEARINGS
        ahead[0, b], ahead[1, b] = 0.5 * math.cos(angle), 0.5 * math.sin(angle)
    over = np.empty(BEARINGS, np.bool_)
    for node in which:
        x, y = x0 + place[node, 0] * scale, y0 + place[node, 1] * scale
        over[:] = len(changed) > FEW
        for k in range(0 if len(changed) > FEW else len(changed)):
            # A cell is crossed by rays that come within half its diagonal of its middle.
            dx, dy = changed[k, 1] + 0.5 - x, changed[k, 0] + 0.5 - y
            squared = dx * dx + dy * dy
            if squared > (limit + 1.0) ** 2:
                continue
            if squared <= 1.0:
                over[:] = True
                break
            middle = math.atan2(dy, dx) / (2.0 * math.pi) * BEARINGS - 0.5
            half = math.asin(HALF_DIAGONAL / math.sqrt(squared)) / (2.0 * math.pi) * BEARINGS
            for b in range(math.ceil(middle - half), math.floor(middle + half) + 1):
                over[b % BEARINGS] = True
        for b in range(BEARINGS):
            if not over[b]:
                continue
            reached = 2 * limit
            for s in range(1, 2 * limit + 1):
                i, j = math.floor(y + s * ahead[1, b]), math.floor(x + s * ahead[0, b])
                if i < 0 or i >= height or j < 0 or j >= width:
                    continue
                if solid[i, j]:
                    reached = s
                    break
            depth[node, b] = (reached + 1) // 2


@njit(cache=True, nogil=True)
def is_in(seen, element):
    """Is the element's bit set?"""
    return (seen[element >> 6] >> np.uint64(element & 63)) & np.uint64(1) != 0


@njit(cache=True, nogil=True)
def gain(weights, seen, views, pose):
    """Weight of what a pose shows, without what was seen."""
    total = 0.0
    node, heading = divmod(pose, len(views.first) - 1)
    base = views.tile[node]
    for k in range(views.first[heading], views.first[heading + 1]):
        element = base + views.offset[k]
        weight = weights[element]
        if weight > 0.0 and views.far[k] <= views.depth[node, views.bearing[k]] and not is_in(seen, element):
            total += weight
    return _with_listed(total, weights, seen, views, node, heading)


@njit(cache=True, nogil=True)
def _with_listed(total, weights, seen, views, node, heading):
    """A weight, and that of the listed elements which a pose shows, without what was seen."""
    if views.listed[node] >= 0:
        row = views.listed[node] * (len(views.first) - 1) + heading
        for k in range(views.listed_first[row], views.listed_first[row + 1]):
            element = views.listed_element[k]
            if not is_in(seen, element):
                total += weights[element]
    return total


@njit(cache=True, nogil=True)
def clear_tiles(weights, views, pose, into):
    """Write which tiles of any weight a pose shows, by their places in its heading's list; how many."""
    n = 0
    node, heading = divmod(pose, len(views.first) - 1)
    base, start = views.tile[node], views.first[heading]
    for k in range(views.first[heading + 1] - start):
        # Whether it counts is as good as random: to write it and go on is quicker than to ask first.
        into[n] = k
        is_clear = views.far[start + k] <= views.depth[node, views.bearing[start + k]]
        n += (weights[base + views.offset[start + k]] > 0.0) & is_clear
    return n


@njit(cache=True, nogil=True)
def gain_of(tiles, weights, seen, views, pose):
    """What `gain` gives, to the last bit, of a pose whose `clear_tiles` are known."""
    total = 0.0
    node, heading = divmod(pose, len(views.first) - 1)
    base, start = views.tile[node], views.first[heading]
    for k in tiles:
        element = base + views.offset[start + k]
        unseen = (~(seen[element >> 6] >> np.uint64(element & 63))) & np.uint64(1)
        total += weights[element] * np.float64(unseen)
    return _with_listed(total, weights, seen, views, node, heading)


@njit(cache=True, nogil=True)
def look(weights, seen, views, pose):
    """Set the bits of what a pose shows that has any weight."""
    node, heading = divmod(pose, len(views.first) - 1)
    base = views.tile[node]
    for k in range(views.first[heading], views.first[heading + 1]):
        element = base + views.offset[k]
        if weights[element] > 0.0 and views.far[k] <= views.depth[node, views.bearing[k]]:
            seen[element >> 6] |= np.uint64(1) << np.uint64(element & 63)
    if views.listed[node] >= 0:
        row = views.listed[node] * (len(views.first) - 1) + heading
        for k in range(views.listed_first[row], views.listed_first[row + 1]):
            element = views.listed_element[k]
            seen[element >> 6] |= np.uint64(1) << np.uint64(element & 63)


@njit(cache=True, nogil=True)
def follow(weights, views, path, leave):
    """What a way shows, as far as it takes to leave no more than a little.

    Args:
        weights: (elements,).
        views: Which of them a pose shows.
        path: (steps + 1,) poses, the start first; that shows nothing any more.
        leave: Weight that may be left.

    Returns:
        steps: How many of its steps that are; all of them where it never does.
        seen: (words,) bits of what they show.
        left: Weight that they leave.
    """
    seen = np.zeros((len(weights) + 63) // 64, np.uint64)
    left = 0.0
    for weight in weights:
        left += weight
    for k in range(1, len(path)):
        left -= gain(weights, seen, views, path[k])
        look(weights, seen, views, path[k])
        if left <= leave:
            return k, seen, left
    return len(path) - 1, seen, left


@njit(cache=True, nogil=True)
def listed_only(index, views):
    """Which of a few elements each pose shows, as a list pose by pose: a search need not ask for others.

    Args:
        index: (n,) the elements; none of them is itself listed.
        views: Which elements a pose shows.

    Returns:
        starts: (poses + 1,) where the elements of each pose begin.
        elements: (m,) int32 places in `index`, rising for each pose.
    """
    headings, nodes = len(views.first) - 1, len(views.depth)
    node_at = np.full(views.tiles, -1, np.int64)
    for node in range(nodes):
        node_at[views.tile[node]] = node
    starts = np.zeros(nodes * headings + 2, np.int64)
    elements = np.empty(0, np.int32)
    # First they are counted, and then they are written.
    for counted in (False, True):
        if counted:
            starts = np.cumsum(starts)
            elements = np.empty(starts[-1], np.int32)
        for n in range(len(index)):
            for h in range(headings):
                for k in range(views.first[h], views.first[h + 1]):
                    tile = index[n] - views.offset[k]
                    if tile < 0 or tile >= views.tiles or node_at[tile] < 0:
                        continue
                    node = node_at[tile]
                    if views.far[k] <= views.depth[node, views.bearing[k]]:
                        pose = node * headings + h
                        if counted:
                            elements[starts[pose + 1]] = n
                            starts[pose + 1] += 1
                        else:
                            starts[pose + 2] += 1
    return starts[:-1], elements


@njit(cache=True, nogil=True)
def sums(weights, views):
    """(2, rows + 1, cols + 1) sums of the tiles below and left of each corner of the grid of tiles."""
    rows, cols = views.tiles // views.stride, views.stride
    total = np.zeros((2, rows + 1, cols + 1))
    for layer in range(2):
        for r in range(rows):
            row = 0.0
            for c in range(cols):
                row += weights[(layer * rows + r) * cols + c]
                total[layer, r + 1, c + 1] = total[layer, r, c + 1] + row
    return total


@njit(cache=True, nogil=True)
def boxes(views):
    """(headings, 2, 4) rows and columns, first and past, of the tiles of each view, from that of the node."""
    headings = len(views.first) - 1
    first_row, first_col = divmod(views.tile[0], views.stride)
    box = np.zeros((headings, 2, 4), np.int64)
    for h in range(headings):
        for k in range(views.first[h], views.first[h + 1]):
            # From the first node, so that no row or column is below 0.
            layer, tile = divmod(views.offset[k] + views.tile[0], views.tiles)
            row, col = tile // views.stride - first_row, tile % views.stride - first_col
            around = box[h, layer]
            around[0], around[1] = min(around[0], row), max(around[1], row + 1)
            around[2], around[3] = min(around[2], col), max(around[3], col + 1)
    return box


@njit(cache=True, nogil=True)
def gains(weights, views, nodes):
    """(n, headings) weight that a view from each of some nodes shows."""
    headings = len(views.first) - 1
    nothing = np.zeros((len(weights) + 63) // 64, np.uint64)
    shown = np.zeros((len(nodes), headings), np.float32)
    for n in range(len(nodes)):
        for h in range(headings):
            shown[n, h] = gain(weights, nothing, views, nodes[n] * headings + h)
    return shown


@njit(cache=True, nogil=True)
def best_gains(weights, views, nodes, steps):
    """(n, headings) weight that views from some nodes show.

    No view shows more than there is in the box around it. So only those are worked out that could have the
    best rate, their weight over the steps there, (n, headings); others have 0.
    """
    headings = len(views.first) - 1
    nothing = np.zeros((len(weights) + 63) // 64, np.uint64)
    total, box = sums(weights, views), boxes(views)
    most = np.zeros((len(nodes), headings))
    for n in range(len(nodes)):
        r, c = divmod(views.tile[nodes[n]], views.stride)
        for h in range(headings):
            if steps[n, h] <= 0:
                continue
            for layer in range(2):
                low, high, left, right = box[h, layer]
                most[n, h] += total[layer, r + high, c + right] - total[layer, r + high, c + left]
                most[n, h] -= total[layer, r + low, c + right] - total[layer, r + low, c + left]
            row = views.listed[nodes[n]] * headings + h
            if row >= 0:
                for k in range(views.listed_first[row], views.listed_first[row + 1]):
                    most[n, h] += weights[views.listed_element[k]]
            most[n, h] /= steps[n, h]
    shown, best = np.zeros((len(nodes), headings), np.float32), 0.0
    foremost = int(most.argmax())
    for k in range(-1, most.size):
        n, h = divmod(foremost if k < 0 else k, headings)
        if steps[n, h] > 0 and most[n, h] >= best - ROUNDING:
            shown[n, h] = gain(weights, nothing, views, nodes[n] * headings + h)
            best = max(best, shown[n, h] / steps[n, h])
    return shown
