"""Search over the real actions, several steps deep, and what is left to do after them.

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
NEGLIGIBLE = 1e-6
"""Weight of an element for which a tour goes nowhere."""
DETOUR = 0.3
"""Steps that an area costs a tour beside the way there and the looking."""
ROUNDING = 1e-4
"""Weight a step by which rounding may make a view better than another."""
HALF_DIAGONAL = 0.708
"""Of a cell, in cells; rounded up."""
FEW = 256
"""Cells up to which it is worth finding which bearings lead over them; of more, all are followed."""
FREE, UNKNOWN = 1, 2
"""A move over ground known to be free, and one against which nothing is known."""


class Views(NamedTuple):
    """Which elements each pose shows."""

    first: npt.NDArray[np.int64]
    """(headings + 1,) where the list of each heading begins in the next three."""
    offset: npt.NDArray[np.int32]
    """(n,) elements from that of the node."""
    bearing: npt.NDArray[np.uint8]
    """(n,) the ray that must get there."""
    far: npt.NDArray[np.uint8]
    """(n,) how far, in cells."""
    depth: npt.NDArray[np.uint8]
    """(nodes, BEARINGS) how far rays get, in cells."""
    cols: int
    """Of the lattice."""
    pad: int
    """Tiles around the lattice, so that no view leaves the grid of tiles."""
    stride: int
    """Tiles in a row of that grid."""
    listed: npt.NDArray[np.int64]
    """(nodes,) row in the list of further elements; −1 without."""
    listed_first: npt.NDArray[np.int64]
    """(rows · headings + 1,) where each pose's begin."""
    listed_element: npt.NDArray[np.int32]
    """(m,) the elements."""


@njit(cache=True, nogil=True)
def sight_lines(solid, changed, x0, y0, scale, limit, depth, which):
    """Write how far some bearings are open from lattice nodes, in cells: those that led over some cells.

    Args:
        solid: (R, C) bool, cells.
        changed: (n, 2) rows and columns of the cells that are solid now and were not, or were and are not.
        x0: Column of lattice node (0, 0), in cells.
        y0: Row of it.
        scale: Cells between nodes.
        limit: Cells beyond which nothing is looked at.
        depth: (lattice rows, lattice columns, BEARINGS) uint8 to write.
        which: (m,) flat indices of the nodes to write.
    """
    height, width = solid.shape
    ahead = np.empty((2, BEARINGS))
    for b in range(BEARINGS):
        angle = 2.0 * math.pi * (b + 0.5) / BEARINGS
        ahead[0, b], ahead[1, b] = 0.5 * math.cos(angle), 0.5 * math.sin(angle)
    over = np.empty(BEARINGS, np.bool_)
    for node in which:
        row, col = node // depth.shape[1], node % depth.shape[1]
        x, y = x0 + col * scale, y0 + row * scale
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
            depth[row, col, b] = (reached + 1) // 2


@njit(cache=True, nogil=True)
def possible_moves(room, needed, plenty, x0, y0, scale, offsets, known, moves):
    """Write FREE for moves that are known to be, UNKNOWN for those that nothing solid is known to block.

    Args:
        room: (R, C) float32 metres between a cell and the nearest solid one or the bounds.
        needed: Metres of it.
        plenty: Metres of it at the start of any move that leave as many as needed all along.
        x0: See `sight_lines`.
        y0: See `sight_lines`.
        scale: See `sight_lines`.
        offsets: (headings, advances, 2) lattice steps (east, north).
        known: (rows, cols, headings, advances) uint8, 1 where free.
        moves: Of the same shape, to write.
    """
    height, width = room.shape
    rows, cols, headings, advances = known.shape
    good = np.zeros((rows, cols), np.bool_)
    at_ease = np.zeros((rows, cols), np.bool_)
    for r in range(rows):
        for c in range(cols):
            i, j = math.floor(y0 + r * scale), math.floor(x0 + c * scale)
            if 0 <= i < height and 0 <= j < width:
                good[r, c] = room[i, j] >= needed
                at_ease[r, c] = room[i, j] >= plenty
    for r in range(rows):
        for c in range(cols):
            for h in range(headings):
                for a in range(advances):
                    moves[r, c, h, a] = FREE if known[r, c, h, a] else 0
                    if known[r, c, h, a] or not good[r, c]:
                        continue
                    if at_ease[r, c]:
                        moves[r, c, h, a] = UNKNOWN
                        continue
                    r_to, c_to = r + offsets[h, a, 1], c + offsets[h, a, 0]
                    outside = r_to < 0 or r_to >= rows or c_to < 0 or c_to >= cols
                    if outside or not good[r_to, c_to]:
                        continue
                    clear = True
                    for s in range(1, 4):
                        i = math.floor(y0 + (r + 0.25 * s * (r_to - r)) * scale)
                        j = math.floor(x0 + (c + 0.25 * s * (c_to - c)) * scale)
                        clear = clear and room[i, j] >= needed
                    if clear:
                        moves[r, c, h, a] = UNKNOWN


@njit(cache=True, nogil=True)
def is_in(seen, element):
    """Is the element's bit set?"""
    return (seen[element >> 6] >> np.uint64(element & 63)) & np.uint64(1) != 0


@njit(cache=True, nogil=True)
def gain(weights, seen, views, row, col, heading):
    """Weight of what a pose shows, without what was seen."""
    total = 0.0
    node = row * views.cols + col
    base = (row + views.pad) * views.stride + col + views.pad
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
        pose = views.listed[node] * (len(views.first) - 1) + heading
        for k in range(views.listed_first[pose], views.listed_first[pose + 1]):
            element = views.listed_element[k]
            if not is_in(seen, element):
                total += weights[element]
    return total


@njit(cache=True, nogil=True)
def clear_tiles(weights, views, row, col, heading, into):
    """Write which tiles of any weight a pose shows, by their places in its heading's list; how many."""
    n = 0
    node = row * views.cols + col
    base = (row + views.pad) * views.stride + col + views.pad
    start = views.first[heading]
    for k in range(views.first[heading + 1] - start):
        # Whether it counts is as good as random: to write it and go on is quicker than to ask first.
        into[n] = k
        is_clear = views.far[start + k] <= views.depth[node, views.bearing[start + k]]
        n += (weights[base + views.offset[start + k]] > 0.0) & is_clear
    return n


@njit(cache=True, nogil=True)
def gain_of(tiles, weights, seen, views, row, col, heading):
    """What `gain` gives, to the last bit, of a pose whose `clear_tiles` are known."""
    total = 0.0
    base = (row + views.pad) * views.stride + col + views.pad
    start = views.first[heading]
    for k in tiles:
        element = base + views.offset[start + k]
        unseen = (~(seen[element >> 6] >> np.uint64(element & 63))) & np.uint64(1)
        total += weights[element] * np.float64(unseen)
    return _with_listed(total, weights, seen, views, row * views.cols + col, heading)


@njit(cache=True, nogil=True)
def look(weights, seen, views, row, col, heading):
    """Set the bits of what a pose shows that has any weight."""
    node = row * views.cols + col
    base = (row + views.pad) * views.stride + col + views.pad
    for k in range(views.first[heading], views.first[heading + 1]):
        element = base + views.offset[k]
        if weights[element] > 0.0 and views.far[k] <= views.depth[node, views.bearing[k]]:
            seen[element >> 6] |= np.uint64(1) << np.uint64(element & 63)
    if views.listed[node] >= 0:
        pose = views.listed[node] * (len(views.first) - 1) + heading
        for k in range(views.listed_first[pose], views.listed_first[pose + 1]):
            element = views.listed_element[k]
            seen[element >> 6] |= np.uint64(1) << np.uint64(element & 63)


@njit(cache=True, nogil=True)
def sums(weights, views):
    """(2, rows + 1, cols + 1) sums of the tiles below and left of each corner of the grid of tiles."""
    rows, cols = len(views.depth) // views.cols + 2 * views.pad, views.stride
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
    headings, stride = len(views.first) - 1, views.stride
    tiles = (len(views.depth) // views.cols + 2 * views.pad) * stride
    box = np.zeros((headings, 2, 4), np.int64)
    for h in range(headings):
        for k in range(views.first[h], views.first[h + 1]):
            # From the first node, so that no row or column is below 0.
            layer, tile = divmod(views.offset[k] + views.pad * (stride + 1), tiles)
            row, col = tile // stride - views.pad, tile % stride - views.pad
            around = box[h, layer]
            around[0], around[1] = min(around[0], row), max(around[1], row + 1)
            around[2], around[3] = min(around[2], col), max(around[3], col + 1)
    return box


@njit(cache=True, nogil=True)
def gains(weights, views, rows, cols):
    """(n, headings) weight that a view from each node shows."""
    headings = len(views.first) - 1
    nothing = np.zeros((len(weights) + 63) // 64, np.uint64)
    shown = np.zeros((len(rows), headings), np.float32)
    for n in range(len(rows)):
        for h in range(headings):
            shown[n, h] = gain(weights, nothing, views, rows[n], cols[n], h)
    return shown


@njit(cache=True, nogil=True)
def best_gains(weights, views, rows, cols, steps):
    """(n, headings) weight that views from some nodes show.

    No view shows more than there is in the box around it. So only those are worked out that could have the
    best rate, their weight over the steps there, (n, headings); others have 0.
    """
    headings = len(views.first) - 1
    nothing = np.zeros((len(weights) + 63) // 64, np.uint64)
    total, box = sums(weights, views), boxes(views)
    most = np.zeros((len(rows), headings))
    for n in range(len(rows)):
        r, c = rows[n] + views.pad, cols[n] + views.pad
        for h in range(headings):
            if steps[n, h] <= 0:
                continue
            for layer in range(2):
                low, high, left, right = box[h, layer]
                most[n, h] += total[layer, r + high, c + right] - total[layer, r + high, c + left]
                most[n, h] -= total[layer, r + low, c + right] - total[layer, r + low, c + left]
            pose = views.listed[rows[n] * views.cols + cols[n]] * headings + h
            if pose >= 0:
                for k in range(views.listed_first[pose], views.listed_first[pose + 1]):
                    most[n, h] += weights[views.listed_element[k]]
            most[n, h] /= steps[n, h]
    shown, best = np.zeros((len(rows), headings), np.float32), 0.0
    foremost = int(most.argmax())
    for k in range(-1, most.size):
        n, h = divmod(foremost if k < 0 else k, headings)
        if steps[n, h] > 0 and most[n, h] >= best - ROUNDING:
            shown[n, h] = gain(weights, nothing, views, rows[n], cols[n], h)
            best = max(best, shown[n, h] / steps[n, h])
    return shown


@njit(cache=True, nogil=True)
def _time(x, y, x_to, y_to, service, pace, standoff):
    """Steps to an area and to look at all of it."""
    return max(math.hypot(x_to - x, y_to - y) - standoff, 0.0) / pace + service


@njit(cache=True, nogil=True)
def rates_between(mass, x, y, service, which, pace, standoff):
    """(n, n) mass of the second area for its time from the first, of some areas; see `tour`.

    Args:
        mass: See `tour`.
        x: See `tour`.
        y: See `tour`.
        service: See `tour`.
        which: (n,) bool, the areas to work it out for; of others, and where nothing is, it is not written.
        pace: See `tour`.
        standoff: See `tour`.
    """
    rates = np.empty((len(mass), len(mass)))
    some = np.flatnonzero(which & (mass > 0.0))
    for k in some:
        for m in some:
            rates[k, m] = mass[m] / _time(x[k], y[k], x[m], y[m], service[m], pace, standoff)
    return rates


@njit(cache=True, nogil=True)
def tour(mass, x_of, y_of, service, x, y, pace, standoff, discount, keep, rates, rated, left):
    """The yield of a tour over areas, and its steps: always on to the one of most mass for its time.

    Args:
        mass: (n,) what is left in each area.
        x_of: (n,) metres.
        y_of: (n,) metres.
        service: (n,) steps to look at all of it.
        x: Where the tour begins.
        y: Likewise.
        pace: Metres a step.
        standoff: Metres from which an area is looked at.
        discount: What a step later is worth.
        keep: Mass that may be left.
        rates: What `rates_between` gives for some areas.
        rated: (n,) bool, those areas.
        left: (n,) int64 scratch.

    Returns:
        The yield with its discount, and the steps.
    """
    n, remains = 0, 0.0
    for k in range(len(mass)):
        if mass[k] > 0.0:
            left[n] = k
            n += 1
            remains += mass[k]
    worth, steps, here = 0.0, 0.0, -1
    while remains > keep and n > 0:
        best, best_rate = 0, -1.0
        known = here >= 0 and rated[here]
        for i in range(n):
            k = left[i]
            if known and rated[k]:
                rate = rates[here, k]
            elif mass[k] / service[k] <= best_rate:  # Not even if it were here.
                continue
            else:
                rate = mass[k] / _time(x, y, x_of[k], y_of[k], service[k], pace, standoff)
            if rate > best_rate:
                best, best_rate = i, rate
        here = k = left[best]
        steps += _time(x, y, x_of[k], y_of[k], service[k], pace, standoff)
        worth += mass[k] * discount**steps
        remains -= mass[k]
        x, y = x_of[k], y_of[k]
        n -= 1
        left[best] = left[n]
    return worth, steps


@njit(cache=True, nogil=True)
def beam(weights, views, moves, offsets, turns, start, known, width, horizon, discount):
    """The best sequences of actions, level by level, by the discounted weight of all that they show.

    Sequences of a level differ in their pose, positions taken to pairs of nodes. The first move leads over
    ground that is known to be free; later ones also over ground that the sequence has seen by then.

    Args:
        weights: (elements,) float32.
        views: Which of them a pose shows.
        moves: (rows, cols, headings, advances) 0, FREE or UNKNOWN.
        offsets: (headings, advances, 2) lattice steps (east, north).
        turns: (turns,) in heading steps.
        start: Row, column and heading.
        known: (tiles,) bool, ground that is known.
        width: Sequences to keep at each level.
        horizon: Levels.
        discount: What a step later is worth.

    Returns:
        pose: (n,) flat (row, col, heading) of each sequence's end.
        parent: (n,) the sequence that it goes on from; −1 for the start.
        score: (n,) discounted weight.
        level: (n,) its steps.
        seen: (n, words) bits of what it has seen.
        first: The first of the last level.
    """
    rows, cols, headings, advances = moves.shape
    words = (len(weights) + 63) // 64
    branches = len(turns) * (advances + 1)
    most = 1 + width * horizon
    pose, parent = np.zeros(most, np.int32), np.full(most, -1, np.int32)
    score, level = np.zeros(most), np.zeros(most, np.int32)
    seen = np.zeros((most, words), np.uint64)
    pose[0] = (start[0] * cols + start[1]) * headings + start[2]
    first, past = 0, 1
    next_score = np.empty(width * branches)
    next_parent, next_pose = np.empty((2, width * branches), np.int32)
    # Several sequences come to most poses: what shows from there is found once. Places in a list fit 16 bits,
    # as distances in it fit eight. Memory that is not written costs nothing.
    poses = rows * cols * headings
    taken = np.zeros(poses, np.int32)
    tiles_from, tiles_to = np.full(poses, -1, np.int64), np.empty(poses, np.int64)
    longest = 0
    for k in range(len(views.first) - 1):
        longest = max(longest, views.first[k + 1] - views.first[k])
    tiles = np.empty(longest * min(poses, width * branches * horizon), np.uint16)
    written = 0
    for d in range(1, horizon + 1):
        n, factor = 0, discount**d
        for node in range(first, past):
            h = pose[node] % headings
            c = pose[node] // headings % cols
            r = pose[node] // (headings * cols)
            for turn in turns:
                to = (h + turn) % headings
                for a in range(-1, advances):
                    r_to, c_to = r, c
                    if a >= 0:
                        kind = moves[r, c, to, a]
                        r_to, c_to = r + offsets[to, a, 1], c + offsets[to, a, 0]
                        tile = (r_to + views.pad) * views.stride + c_to + views.pad
                        if kind == 0 or (
                            kind == UNKNOWN and (d == 1 or not (known[tile] or is_in(seen[node], tile)))
                        ):
                            continue
                    elif turn == 0:
                        continue
                    end = (r_to * cols + c_to) * headings + to
                    if tiles_from[end] < 0:
                        tiles_from[end] = written
                        written += clear_tiles(weights, views, r_to, c_to, to, tiles[written:])
                        tiles_to[end] = written
                    shown = tiles[tiles_from[end] : tiles_to[end]]
                    more = gain_of(shown, weights, seen[node], views, r_to, c_to, to)
                    next_score[n] = score[node] + factor * more
                    next_parent[n], next_pose[n] = node, end
                    n += 1
        if n == 0:
            break
        first = past
        for k in np.argsort(-next_score[:n], kind="mergesort"):
            h = next_pose[k] % headings
            c = next_pose[k] // headings % cols
            r = next_pose[k] // (headings * cols)
            place = (r // 2 * cols + c // 2) * headings + h
            if taken[place] == d:
                continue
            taken[place] = d
            pose[past], parent[past], score[past] = next_pose[k], next_parent[k], next_score[k]
            level[past] = d
            seen[past] = seen[next_parent[k]]
            look(weights, seen[past], views, r, c, h)
            past += 1
            if past - first == width:
                break
    return pose[:past], parent[:past], score[:past], level[:past], seen[:past], first


@njit(cache=True, nogil=True)
def add_up(weights, elements, seen, x_of, y_of, area_of, service, which, mass, x, y, rest):
    """Write what is left in some areas: its weight, its middle, and the steps to look at all of it.

    Args:
        weights: See `tours`.
        elements: (n,) all those of these areas that count.
        seen: (words,) those that are not left.
        x_of: See `tours`.
        y_of: See `tours`.
        area_of: See `tours`.
        service: See `tours`.
        which: (areas,) bool.
        mass: (areas,) to write.
        x: Likewise.
        y: Likewise.
        rest: Likewise.
    """
    for k in np.flatnonzero(which):
        mass[k], x[k], y[k], rest[k] = 0.0, 0.0, 0.0, DETOUR
    for element in elements:
        if not is_in(seen, element):
            k, weight = area_of[element], weights[element]
            mass[k] += weight
            rest[k] += 1.0 / service
            x[k] += weight * x_of[element]
            y[k] += weight * y_of[element]
    for k in np.flatnonzero(which & (mass > 0.0)):
        x[k] /= mass[k]
        y[k] /= mass[k]


@njit(cache=True, nogil=True)
def tours(
    weights, views, seen, pose, x_of, y_of, area_of, areas, spacing, service, pace, standoff, discount, keep
):
    """The tour over what is left after each of some sequences; see `tour`.

    Args:
        weights: (elements,) float32.
        views: Their headings and columns.
        seen: (n, words) what each sequence has seen.
        pose: (n,) where it ends.
        x_of: (elements,) float32 metres east of node (0, 0).
        y_of: (elements,) float32 metres north of it.
        area_of: (elements,) int32 the area of each element.
        areas: How many there are.
        spacing: Metres between nodes.
        service: Elements that a step shows.
        pace: See `tour`.
        standoff: See `tour`.
        discount: See `tour`.
        keep: See `tour`.

    Returns:
        worth: (n,) with its discount from where the tour begins.
        steps: (n,)
    """
    n, headings = len(pose), len(views.first) - 1
    worth, steps = np.zeros(n), np.zeros(n)
    left = np.empty(areas, np.int64)
    counted = np.flatnonzero(weights > NEGLIGIBLE)
    # Most areas are left alike by all sequences.
    by_any = np.zeros_like(seen[0])
    for s in range(n):
        by_any |= seen[s]
    differs = np.zeros(areas, np.bool_)
    for element in counted:
        differs[area_of[element]] |= is_in(by_any, element)
    mass, x, y, rest = np.zeros(areas), np.zeros(areas), np.zeros(areas), np.zeros(areas)
    add_up(weights, counted, by_any, x_of, y_of, area_of, service, np.ones_like(differs), mass, x, y, rest)
    alike = ~differs
    rates = rates_between(mass, x, y, rest, alike, pace, standoff)
    counted = counted[differs[area_of[counted]]]
    for s in range(n):
        add_up(weights, counted, seen[s], x_of, y_of, area_of, service, differs, mass, x, y, rest)
        c, r = pose[s] // headings % views.cols, pose[s] // (headings * views.cols)
        worth[s], steps[s] = tour(
            mass, x, y, rest, c * spacing, r * spacing, pace, standoff, discount, keep, rates, alike, left
        )
    return worth, steps
