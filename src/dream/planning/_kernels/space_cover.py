"""What looks from many places show, a greedy cover by them, a short tour over some, and a tree of moves."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.mapping._kernels.volume_surface import grown
from dream.planning._kernels.space_beam import FAR, put_at, seen_from
from dream.planning._kernels.views import is_in
from dream.planning._kernels.ways import FINE, passes


class ShownFrom(NamedTuple):
    """What is shown from some nodes."""

    first: npt.NDArray[np.int64]
    """(n + 1,) where the entries of each node begin."""
    which: npt.NDArray[np.int32]
    """(entries,) the element."""
    bits: npt.NDArray[np.uint64]
    """(entries,) the looks that show it: bit heading · tilts + tilt."""


class SpaceTree(NamedTuple):
    """Poses that moves lead to from where the vehicle is, which is the first."""

    node: npt.NDArray[np.int64]
    """(n, 3) level, row and column."""
    heading: npt.NDArray[np.int64]
    """(n,)."""
    tilt: npt.NDArray[np.int64]
    """(n,) that shows most there."""
    parent: npt.NDArray[np.int64]
    """(n,) the pose before; −1 for the first."""
    depth: npt.NDArray[np.int64]
    """(n,) moves."""
    gain: npt.NDArray[np.float64]
    """(n,) weight that is shown there and nowhere before on the branch."""
    score: npt.NDArray[np.float64]
    """(n,) gain · exp(−decay · moves), summed along the branch."""


@njit(cache=True, nogil=True)
def shown_from(scene, optics, lattice, elements, nodes):
    """`ShownFrom` of nodes (n, 3)."""
    count = len(elements.weights)
    first = np.zeros(len(nodes) + 1, np.int64)
    which, bits = np.empty(1 << 14, np.int32), np.empty(1 << 14, np.uint64)
    camera, written = np.empty(3), 0
    for n in range(len(nodes)):
        if written + count > len(which):
            more = max(2 * len(which), written + count)
            which, bits = grown(which, more), grown(bits, more)
        put_at(lattice, nodes[n, 0], nodes[n, 1], nodes[n, 2], camera)
        written += seen_from(scene, optics, lattice, elements, camera, which[written:], bits[written:])
        first[n + 1] = written
    return ShownFrom(first, which[:written], bits[:written])


@njit(cache=True, nogil=True)
def look_gains(shown, weights, covered, allowed, n, sums):
    """Write the weight (looks,) that each look from node n shows and is not covered; 0 where not allowed."""
    sums[:] = 0.0
    for i in range(shown.first[n], shown.first[n + 1]):
        if covered[shown.which[i]]:
            continue
        weight = weights[shown.which[i]]
        for b in range(len(sums)):
            if (shown.bits[i] >> np.uint64(b)) & np.uint64(1):
                sums[b] += weight
    for b in range(len(sums)):
        if not allowed[n, b]:
            sums[b] = 0.0


@njit(cache=True, nogil=True)
def greedy_cover(shown, weights, allowed, least):
    """Looks that show what there is, always the one that adds most, until none adds enough.

    Args:
        shown: From n nodes.
        weights: (E,) of the elements.
        allowed: (n, looks) bool.
        least: Weight that a look has to add.

    Returns:
        looks: (k, 2) node and look.
        added: (k,) weight that each adds to those before.
    """
    count = len(shown.first) - 1
    sums = np.empty(allowed.shape[1])
    covered = np.zeros(len(weights), np.bool_)
    # What a node adds never grows, so that the best one whose sum is new is the best of all.
    bound, look, is_new = np.zeros(count), np.zeros(count, np.int64), np.ones(count, np.bool_)
    for n in range(count):
        look_gains(shown, weights, covered, allowed, n, sums)
        look[n] = sums.argmax()
        bound[n] = sums[look[n]]
    looks, added = np.empty((count, 2), np.int64), np.empty(count)
    k = 0
    while k < count:
        best = bound.argmax()
        if bound[best] < least:
            break
        if not is_new[best]:
            look_gains(shown, weights, covered, allowed, best, sums)
            look[best] = sums.argmax()
            bound[best], is_new[best] = sums[look[best]], True
            continue
        looks[k, 0], looks[k, 1], added[k] = best, look[best], bound[best]
        k += 1
        for i in range(shown.first[best], shown.first[best + 1]):
            if (shown.bits[i] >> np.uint64(look[best])) & np.uint64(1):
                covered[shown.which[i]] = True
        is_new[:] = False
    return looks[:k], added[:k]


@njit(cache=True, nogil=True)
def best_of_parts(shown, weights, part_of, parts, allowed):
    """What the best look from each node shows of each part: (n, parts) weight, and the look.

    Args:
        shown: From n nodes.
        weights: (E,) of the elements.
        part_of: (E,) the part of each.
        parts: How many there are.
        allowed: (n, looks) bool.
    """
    count, looks = allowed.shape
    gain, look = np.zeros((count, parts)), np.zeros((count, parts), np.int64)
    sums = np.zeros((parts, looks))
    for n in range(count):
        sums[:] = 0.0
        for i in range(shown.first[n], shown.first[n + 1]):
            of, weight = part_of[shown.which[i]], weights[shown.which[i]]
            for b in range(looks):
                if (shown.bits[i] >> np.uint64(b)) & np.uint64(1):
                    sums[of, b] += weight
        for of in range(parts):
            for b in range(looks):
                if allowed[n, b] and sums[of, b] > gain[n, of]:
                    gain[n, of], look[n, of] = sums[of, b], b
    return gain, look


@njit(cache=True, nogil=True)
def _length(costs, order):
    total, at = 0.0, 0
    for k in order:
        total += costs[at, k]
        at = k
    return total


@njit(cache=True, nogil=True)
def open_tour(costs):
    """A short way from place 0 to all others: nearest neighbours, then pieces moved or reversed.

    Args:
        costs: (n + 1, n + 1) from the one to the other.

    Returns:
        (n,) the others in order.
    """
    n = len(costs) - 1
    order, todo = np.empty(n, np.int64), np.ones(n + 1, np.bool_)
    at = 0
    for k in range(n):
        todo[at] = False
        best = -1
        for q in range(1, n + 1):
            if todo[q] and (best < 0 or costs[at, q] < costs[at, best]):
                best = q
        order[k] = at = best
    length = _length(costs, order)
    trial, rest = np.empty(n, np.int64), np.empty(n, np.int64)
    improved = True
    while improved:
        improved = False
        for i in range(n):
            for j in range(i + 1, n + 1):
                # The piece from i to j goes to every place among the others, either way round.
                size = j - i
                rest[:i], rest[i : n - size] = order[:i], order[j:]
                for k in range(n - size + 1):
                    if size > 3 and k != i:
                        continue
                    for way in range(2):
                        trial[:k], trial[k + size :] = rest[:k], rest[k : n - size]
                        for m in range(size):
                            trial[k + m] = order[i + m] if way == 0 else order[j - 1 - m]
                        found = _length(costs, trial)
                        if found < length - 1e-9:
                            order[:], length, improved = trial, found, True
                            rest[:i], rest[i : n - size] = order[:i], order[j:]
    return order


@njit(cache=True, nogil=True)
def _nearest(node, heading, depth, count, sample, headings, turning, deepest):
    """The pose of a tree that is nearest to a sample (4,), a heading step counting as `turning` nodes."""
    best, least = -1, FAR
    for k in range(count):
        if depth[k] >= deepest:
            continue
        apart = 0.0
        for i in range(3):
            apart += (node[k, i] - sample[i]) ** 2
        turn = abs(heading[k] - sample[3])
        apart = math.sqrt(apart) + turning * min(turn, headings - turn)
        if apart < least:
            best, least = k, apart
    return best


@njit(cache=True, nogil=True)
def _towards(lattice, moves, node, heading, sample, turning, to):
    """Write the pose (4,) nearest to a sample that one move leads to; is there one?"""
    levels, rows, cols = lattice.stands.shape
    headings = len(moves.offsets)
    least = FAR
    for turn in moves.turns:
        h = (heading + turn + headings) % headings
        away = abs(h - sample[3])
        away = turning * min(away, headings - away)
        for a in range(moves.offsets.shape[1]):
            east, north = moves.offsets[h, a]
            for up in moves.climbs:
                l1, r1, c1 = node[0] + up, node[1] + north, node[2] + east
                if not (0 <= l1 < levels and 0 <= r1 < rows and 0 <= c1 < cols):
                    continue
                apart = away + math.sqrt(
                    (l1 - sample[0]) ** 2 + (r1 - sample[1]) ** 2 + (c1 - sample[2]) ** 2
                )
                if apart >= least:
                    continue
                if up == 0 and east == 0 and north == 0:
                    if turn == 0:
                        continue
                else:
                    if not lattice.stands[l1, r1, c1]:
                        continue
                    if not passes(
                        lattice.fits,
                        FINE * node[0],
                        FINE * node[1],
                        FINE * node[2],
                        FINE * up,
                        FINE * north,
                        FINE * east,
                    ):
                        continue
                least = apart
                to[0], to[1], to[2], to[3] = l1, r1, c1, h
    return least < FAR


@njit(cache=True, nogil=True)
def grow_tree(
    scene, optics, lattice, moves, elements, start, heading, tilt, kept, samples, decay, turning, deepest
):
    """A tree of poses that grows towards samples by one move at a time (LaValle 1998), with what each shows.

    Args:
        scene: The voxels around.
        optics: Camera and reach.
        lattice: Where the body may be.
        moves: See `ways.SpaceMoves`.
        elements: What is left to look at.
        start: (3,) int64 level, row and column of where the vehicle is.
        heading: Where it looks.
        tilt: Of its camera.
        kept: (k, 4) int64 level, row, column and heading of poses that are tried first, one after the other.
        samples: (s, 4) float64 likewise; as many poses at most are added.
        decay: Of a gain with each move.
        turning: Nodes that a heading step counts as.
        deepest: Moves at most.

    Returns:
        `SpaceTree`.
    """
    _, rows, cols = lattice.stands.shape
    headings, tilts = len(moves.offsets), len(lattice.tilts)
    count, most = len(elements.weights), 1 + len(kept) + len(samples)
    words = (count + 63) // 64
    node, yaw, pitch = np.zeros((most, 3), np.int64), np.zeros(most, np.int64), np.zeros(most, np.int64)
    parent, depth = np.full(most, -1, np.int64), np.zeros(most, np.int64)
    gain, score, seen = np.zeros(most), np.zeros(most), np.zeros((most, words), np.uint64)
    node[0], yaw[0], pitch[0] = start, heading, tilt
    taken = {((start[0] * rows + start[1]) * cols + start[2]) * headings + heading}
    which, bits = np.empty(count, np.int32), np.empty(count, np.uint64)
    sample, to, camera, gains = np.empty(4), np.empty(4, np.int64), np.empty(3), np.empty(tilts)
    n, before = 1, 0
    for s in range(len(kept) + len(samples)):
        if s < len(kept):
            k = before
            for i in range(4):
                sample[i] = kept[s, i]
        else:
            sample[:] = samples[s - len(kept)]
            k = _nearest(node, yaw, depth, n, sample, headings, turning, deepest)
        if not _towards(lattice, moves, node[k], yaw[k], sample, turning, to):
            continue
        pose = ((to[0] * rows + to[1]) * cols + to[2]) * headings + to[3]
        if pose in taken:
            continue
        taken.add(pose)
        put_at(lattice, to[0], to[1], to[2], camera)
        shown = seen_from(scene, optics, lattice, elements, camera, which, bits)
        gains[:] = 0.0
        for i in range(shown):
            if not is_in(seen[k], which[i]):
                for t in range(tilts):
                    if (bits[i] >> np.uint64(to[3] * tilts + t)) & np.uint64(1):
                        gains[t] += elements.weights[which[i]]
        best = gains.argmax()
        node[n], yaw[n], pitch[n] = to[:3], to[3], best
        parent[n], depth[n], gain[n] = k, depth[k] + 1, gains[best]
        score[n] = score[k] + gains[best] * math.exp(-decay * depth[n])
        seen[n] = seen[k]
        for i in range(shown):
            if (bits[i] >> np.uint64(to[3] * tilts + best)) & np.uint64(1):
                seen[n, which[i] >> 6] |= np.uint64(1) << np.uint64(which[i] & 63)
        if s < len(kept):
            before = n
        n += 1
    return SpaceTree(node[:n], yaw[:n], pitch[:n], parent[:n], depth[:n], gain[:n], score[:n])
