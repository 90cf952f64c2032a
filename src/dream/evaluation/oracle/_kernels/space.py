"""Kernels of the search for tours in space.

A pose is a node with a heading and a tilt; a walk can go on from it in the same way whatever its tilt is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.evaluation.oracle._kernels.tours import is_covered, lowest

FAR = 255
"""Steps of a way that is longer than any looked for."""


class SpaceArcs(NamedTuple):
    """P nodes, their moves, and what the frames at them inspect."""

    places: npt.NDArray[np.int32]
    """(P, 3) lattice steps east, north and up."""
    ends: npt.NDArray[np.int32]
    """(P, K) node at the end of each of K moves; −1 where there is none."""
    moves: npt.NDArray[np.int32]
    """(H, M) which of the moves can be made after a turn to each heading."""
    back: npt.NDArray[np.int32]
    """(K,) the move that leads back: it is free where the other is."""
    turns: npt.NDArray[np.int64]
    """(T,) heading steps."""
    tilts: int
    """How many there are."""
    first: npt.NDArray[np.intp]
    """(P + 1,) node p has the entries first[p] to first[p + 1]."""
    who: npt.NDArray[np.int32]
    """Individual of an entry."""
    frames: npt.NDArray[np.uint64]
    """Bit `heading · tilts + tilt` is set where that frame inspects it."""
    apart: npt.NDArray[np.uint8]
    """(H, H, Y, X) fewest steps over the plane with nothing in the way, the middle being no step away."""
    rises: npt.NDArray[np.uint8]
    """(Z,) fewest steps up or down, likewise."""
    stride: float
    """Lattice steps over the plane of the longest move."""


@njit(cache=True, nogil=True)
def steps_in_open_water(offsets, turns, side):  # type: ignore[no-untyped-def]
    """(H, H, side, side) uint8 for `SpaceArcs.apart`: offsets (H, A, 2: east, north) of each heading.

    FAR where there is no way within the square. One square is searched for each heading to begin with.
    """
    headings = len(offsets)
    steps = np.full((headings, headings, side, side), np.uint8(FAR), np.uint8)
    middle = side // 2
    queue = np.empty((headings * side * side, 3), np.int32)
    for begin in range(headings):
        near = steps[begin]
        near[begin, middle, middle] = 0
        queue[0, 0], queue[0, 1], queue[0, 2] = begin, middle, middle
        head, tail = 0, 1
        while head < tail:
            h, y, x = queue[head, 0], queue[head, 1], queue[head, 2]
            head += 1
            so_far = near[h, y, x]
            if so_far >= FAR - 1:
                continue
            for turn in turns:
                to = (h + turn) % headings
                for a in range(offsets.shape[1]):
                    u, v = x + offsets[to, a, 0], y + offsets[to, a, 1]
                    if 0 <= u < side and 0 <= v < side and near[to, v, u] == FAR:
                        near[to, v, u] = so_far + 1
                        queue[tail, 0], queue[tail, 1], queue[tail, 2] = to, v, u
                        tail += 1
    return steps


@njit(cache=True, nogil=True)
def floor(graph, p, h, q, g):  # type: ignore[no-untyped-def]
    """No way from node p with heading h to node q with heading g takes fewer steps.

    In open water so many do: a step climbs whichever way it leads, and holding its place is one.
    """
    dx = graph.places[q, 0] - graph.places[p, 0]
    dy = graph.places[q, 1] - graph.places[p, 1]
    dz = graph.places[q, 2] - graph.places[p, 2]
    rise = np.int64(graph.rises[dz + len(graph.rises) // 2])
    middle = graph.apart.shape[2] // 2
    # Ways that leave the square are the longer ones, but not at its border.
    if abs(dx) <= middle // 2 and abs(dy) <= middle // 2:
        return max(rise, np.int64(graph.apart[h, g, dy + middle, dx + middle]))
    away = np.int64(math.ceil(math.sqrt(dx * dx + dy * dy) / graph.stride - 1e-6))
    return max(rise, away)


@njit(cache=True, nogil=True)
def steps_to(graph, end, begin, limit):  # type: ignore[no-untyped-def]
    """(P, H) uint8 fewest steps from every node and heading to an end.

    FAR where no way of at most `limit` steps leads from the beginning through there to the end; both are a
    node with a heading.
    """
    headings = len(graph.moves)
    steps = np.full((len(graph.places), headings), np.uint8(FAR), np.uint8)
    if floor(graph, begin[0], begin[1], end[0], end[1]) > limit:
        return steps
    steps[end[0], end[1]] = 0
    layer = np.empty((256, 2), np.int32)
    layer[0, 0], layer[0, 1] = end
    size = 1
    following = np.empty_like(layer)
    for count in range(1, limit + 1):
        found = 0
        for s in range(size):
            q, h = layer[s, 0], layer[s, 1]
            for m in range(graph.moves.shape[1]):
                p = graph.ends[q, graph.back[graph.moves[h, m]]]
                if p < 0:
                    continue
                for turn in graph.turns:
                    was = (h - turn) % headings
                    if steps[p, was] <= count or floor(graph, begin[0], begin[1], p, was) + count > limit:
                        continue
                    steps[p, was] = count
                    if found == len(following):
                        following = np.concatenate((following, np.empty_like(following)))
                    following[found, 0], following[found, 1] = p, was
                    found += 1
        layer, following, size = following, layer, found
        if size == 0:
            break
    return steps


@njit(cache=True, nogil=True)
def by_individual(graph, count):  # type: ignore[no-untyped-def]
    """The entries of `count` individuals: first (count + 1,), node (K,) int32 and frames (K,) uint64."""
    first = np.zeros(count + 1, np.intp)
    for k in range(len(graph.who)):
        first[graph.who[k] + 1] += 1
    for i in range(count):
        first[i + 1] += first[i]
    fill = first[:-1].copy()
    node = np.empty(len(graph.who), np.int32)
    frames = np.empty(len(graph.who), np.uint64)
    for p in range(len(graph.places)):
        for k in range(graph.first[p], graph.first[p + 1]):
            at = fill[graph.who[k]]
            node[at], frames[at] = p, graph.frames[k]
            fill[graph.who[k]] += 1
    return first, node, frames


@njit(cache=True, nogil=True)
def values(graph, prices):  # type: ignore[no-untyped-def]
    """(P, frames) float64: of each frame the sum of the prices (N,) of what it inspects."""
    result = np.zeros((len(graph.places), len(graph.moves) * graph.tilts))
    for p in range(len(graph.places)):
        for k in range(graph.first[p], graph.first[p + 1]):
            price = prices[graph.who[k]]
            if price == 0.0:
                continue
            word = graph.frames[k]
            while word:
                result[p, lowest(word)] += price
                word &= word - np.uint64(1)
    return result


@njit(cache=True, nogil=True)
def insert_stops(graph, entries, gains, weights, wanted, spare, walk, bias, power, share, rng):  # type: ignore[no-untyped-def]
    """Frames to take beside those of a walk, each put where it lengthens the walk the least.

    The next is always one that inspects much for the steps that it costs, as the crow flies.

    Args:
        graph: The world.
        entries: What `by_individual` gives.
        gains: (P, frames) what `values` gives for the weights of those wanted; used up.
        weights: (N,) of each individual.
        wanted: (N,) bool who is to be inspected; used up.
        spare: How many of them need not be.
        walk: (L, 3) node, heading and tilt of its poses, the first of which stays the first.
        bias: Steps that every frame costs beside its detour.
        power: Of those costs.
        share: Only frames that gain this share of the greatest gain are looked at.
        rng: Chance.

    Returns:
        (L', 3) the poses of the walk, with the others between them.
    """
    stops = walk.copy()
    first, node, frames = entries
    tilts = graph.tilts
    left = 0
    for i in range(len(wanted)):
        left += wanted[i]
    flat = gains.reshape(-1)
    width = gains.shape[1]
    while left > spare:
        most = flat.max()
        if most <= 1e-9:
            break
        close = np.flatnonzero(flat >= share * most)
        every = max(1, len(close) // 1500)
        best_score, best, best_at = -1.0, -1, -1
        for c in range(int(rng.random() * every), len(close), every):
            p, f = close[c] // width, close[c] % width
            h = f // tilts
            cheapest, at = np.int64(1 << 30), -1
            to_next = floor(graph, stops[0, 0], stops[0, 1], p, h)
            for k in range(len(stops)):
                detour = to_next
                if k + 1 < len(stops):
                    on = floor(graph, p, h, stops[k + 1, 0], stops[k + 1, 1])
                    detour += on - floor(graph, stops[k, 0], stops[k, 1], stops[k + 1, 0], stops[k + 1, 1])
                    to_next = floor(graph, stops[k + 1, 0], stops[k + 1, 1], p, h)
                if detour < cheapest:
                    cheapest, at = detour, k + 1
            score = flat[close[c]] / (max(cheapest, 0) + bias) ** power
            if score > best_score:
                best_score, best, best_at = score, close[c], at
        p, f = best // width, best % width
        longer = np.empty((len(stops) + 1, 3), np.int32)
        longer[:best_at] = stops[:best_at]
        longer[best_at, 0], longer[best_at, 1], longer[best_at, 2] = p, f // tilts, f % tilts
        longer[best_at + 1 :] = stops[best_at:]
        stops = longer
        for k in range(graph.first[p], graph.first[p + 1]):
            i = graph.who[k]
            if not wanted[i] or not (graph.frames[k] >> np.uint64(f)) & np.uint64(1):
                continue
            wanted[i] = False
            left -= 1
            for e in range(first[i], first[i + 1]):
                word = frames[e]
                while word:
                    gains[node[e], lowest(word)] -= weights[i]
                    word &= word - np.uint64(1)
    return stops


@njit(cache=True, nogil=True)
def beam(  # type: ignore[no-untyped-def]
    graph, begin, end, anchored, togo, column, weights, limit, may_miss, width, crowd, urge, noise, rng
):
    """The shortest walk found between two poses that inspects what is wanted, layer by layer.

    The most promising of each layer are kept: those that lack little, by weight, and are near the end. Of
    walks of the same length the one that lacks the least is taken.

    Args:
        graph: The world.
        begin: Node and heading.
        end: Node and heading; the frame there does not count.
        anchored: Whether the walk has to end there; else it ends where little enough is lacking.
        togo: (P, H) what `steps_to` gives for that end; where it is empty, steps are told as the crow flies.
        column: (N,) int16 number of each individual among the R wanted; −1 where it is not.
        weights: (R,) float64 that add up to 1.
        limit: Longest walk.
        may_miss: How many of the wanted it need not inspect.
        width: Walks kept of a layer.
        crowd: Walks kept of a layer that end at the same node with the same heading.
        urge: Steps that the weight of all wanted is worth.
        noise: Standard deviation, in steps, of what is added to a promise.
        rng: Chance.

    Returns:
        (L, 3) node, heading and tilt after each step, the tilt at a given end being −1; and whether a walk
        was found.
    """
    headings, tilts = len(graph.moves), graph.tilts
    wanted = len(weights)
    words = max((wanted + 63) // 64, 1)
    nodes = len(graph.places)
    row_of = np.full(nodes, -1, np.int32)
    rows = np.zeros((256, headings * tilts, words), np.uint64)
    used = 1  # The first is that of the nodes where nothing wanted shows.

    parent = np.zeros((limit + 1, width), np.int32)
    path = np.zeros((limit + 1, width, 3), np.int32)
    mask = np.zeros((width, words), np.uint64)
    mask_next = np.zeros((width, words), np.uint64)
    left, left_next = np.zeros(width), np.zeros(width)
    lack, lack_next = np.zeros(width, np.int64), np.zeros(width, np.int64)
    room = width * len(graph.turns) * graph.moves.shape[1] * tilts
    c_from, c_node = np.empty(room, np.int32), np.empty(room, np.int32)
    c_frame, c_lack = np.empty(room, np.int32), np.empty(room, np.int64)
    c_left, c_promise = np.empty(room), np.empty(room)
    head = np.full(nodes * headings, -1, np.int32)
    held = np.zeros(nodes * headings, np.int16)
    link = np.empty(width, np.int32)
    trial = np.empty(words, np.uint64)
    total = 0.0
    for r in range(wanted):
        total += weights[r]
    path[0, 0, 0], path[0, 0, 1] = begin
    left[0], lack[0], size = total, wanted, 1

    for layer in range(limit):
        found = 0
        arrived, arrived_left = -1, 1e18
        for s in range(size):
            for t in range(len(graph.turns)):
                h = (path[layer, s, 1] + graph.turns[t]) % headings
                for m in range(graph.moves.shape[1]):
                    q = graph.ends[path[layer, s, 0], graph.moves[h, m]]
                    if q < 0:
                        continue
                    rest = np.int64(0)
                    if anchored:
                        rest = np.int64(togo[q, h]) if len(togo) else floor(graph, q, h, end[0], end[1])
                        if layer + 1 + rest > limit:
                            continue
                        if rest == 0:
                            if lack[s] <= may_miss and left[s] < arrived_left:
                                arrived, arrived_left = s, left[s]
                            if layer + 2 > limit:
                                continue
                    row = row_of[q]
                    if row < 0:
                        row = 0
                        for k in range(graph.first[q], graph.first[q + 1]):
                            r = column[graph.who[k]]
                            if r < 0:
                                continue
                            if row == 0:
                                row = used
                                used += 1
                                if row == len(rows):
                                    rows = np.concatenate((rows, np.zeros_like(rows)))
                            word = graph.frames[k]
                            while word:
                                rows[row, lowest(word), r >> 6] |= np.uint64(1) << np.uint64(r & 63)
                                word &= word - np.uint64(1)
                        row_of[q] = row
                    any_gain = False
                    for tilt in range(tilts):
                        weight, lacking = left[s], lack[s]
                        if row > 0:
                            for w in range(words):
                                new = rows[row, h * tilts + tilt, w] & ~mask[s, w]
                                while new:
                                    weight -= weights[w * 64 + lowest(new)]
                                    lacking -= 1
                                    new &= new - np.uint64(1)
                        gain = lacking < lack[s]
                        # Where nothing is gained, one tilt is as good as another.
                        if not gain and (any_gain or tilt < tilts - 1):
                            continue
                        any_gain |= gain
                        c_from[found], c_node[found], c_frame[found] = s, q, h * tilts + tilt
                        c_left[found], c_lack[found] = weight, lacking
                        c_promise[found] = urge * weight + rest
                        if noise > 0.0:
                            c_promise[found] += noise * rng.standard_normal()
                        found += 1
        if arrived >= 0:
            walk = np.empty((layer + 1, 3), np.int32)
            walk[layer, 0], walk[layer, 1], walk[layer, 2] = end[0], end[1], -1
            at = np.int64(arrived)
            for t in range(layer, 0, -1):
                walk[t - 1] = path[t, at]
                at = np.int64(parent[t, at])
            return walk, True
        if found == 0:
            break
        enough = 8 * width
        if found > enough:
            most = np.partition(c_promise[:found], enough)[enough]
            promising = np.flatnonzero(c_promise[:found] <= most)
        else:
            promising = np.arange(found)
        kept, done = 0, -1
        for c in promising[np.argsort(c_promise[promising])]:
            s, q, f = c_from[c], c_node[c], c_frame[c]
            row = row_of[q]
            key = q * headings + f // tilts
            for w in range(words):
                trial[w] = mask[s, w] | rows[row, f, w]
            if held[key] >= crowd or is_covered(trial, mask_next, head[key], link):
                continue
            path[layer + 1, kept, 0], path[layer + 1, kept, 1] = q, f // tilts
            path[layer + 1, kept, 2] = f % tilts
            mask_next[kept] = trial
            left_next[kept], lack_next[kept] = c_left[c], c_lack[c]
            parent[layer + 1, kept] = s
            link[kept], head[key] = head[key], kept
            held[key] += 1
            if not anchored and c_lack[c] <= may_miss and (done < 0 or c_left[c] < left_next[done]):
                done = kept
            kept += 1
            if kept == width:
                break
        if done >= 0:
            walk = np.empty((layer + 1, 3), np.int32)
            at = np.int64(done)
            for t in range(layer + 1, 0, -1):
                walk[t - 1] = path[t, at]
                at = np.int64(parent[t, at])
            return walk, True
        for k in range(kept):
            key = path[layer + 1, k, 0] * headings + path[layer + 1, k, 1]
            head[key], held[key] = -1, 0
        size = kept
        mask, mask_next = mask_next, mask
        left, left_next = left_next, left
        lack, lack_next = lack_next, lack
    return np.empty((0, 3), np.int32), False


@njit(cache=True, nogil=True)
def steps_from(graph, begin, facing):  # type: ignore[no-untyped-def]
    """(P, H) uint8 fewest steps from a node with a heading to every other; FAR where there is no way."""
    headings = len(graph.moves)
    steps = np.full((len(graph.places), headings), np.uint8(FAR), np.uint8)
    steps[begin, facing] = 0
    queue = np.empty((steps.size, 2), np.int32)
    queue[0, 0], queue[0, 1] = begin, facing
    head, tail = 0, 1
    while head < tail:
        p, h = queue[head, 0], queue[head, 1]
        head += 1
        if steps[p, h] >= FAR - 1:
            continue
        for turn in graph.turns:
            to = (h + turn) % headings
            for m in range(graph.moves.shape[1]):
                q = graph.ends[p, graph.moves[to, m]]
                if q >= 0 and steps[q, to] == FAR:
                    steps[q, to] = steps[p, h] + 1
                    queue[tail, 0], queue[tail, 1] = q, to
                    tail += 1
    return steps
