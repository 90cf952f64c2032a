"""A beam search over the real actions, by a score of what sequences show and of what they leave."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.planning._kernels.moves import FREE
from dream.planning._kernels.search import NO_WAY, tree, ways_between
from dream.planning._kernels.views import clear_tiles, gain_of, is_in, look

LESS = 1e-6
"""Weight by which a sequence must leave less than another to be better."""


class BeamScore(NamedTuple):
    """How sequences are compared: by their gains, less what is still to be done.

    The value of a sequence is the sum of its gains, each times `discount` to the power of its step; less the
    weight of all that is in a part; less `step` for each move to the nearest part of which something is left
    and along the shortest tree over these parts.
    """

    discount: float
    """What a gain is worth a step later."""
    decimals: int
    """To which values are rounded, so that a tie is a tie on every machine; below 0 they are not."""
    leave: float
    """The search ends when no more than this weight is left of the parts; −inf where there are none."""
    slight: float
    """Weight up to which what is left of a part is not worth a way of its own."""
    step: float
    """Weight that a move counts as much as."""
    elements: npt.NDArray[np.int64]
    """(n,) the elements that are in a part."""
    part_of: npt.NDArray[np.int64]
    """(n,) the part of each."""
    ways: npt.NDArray[np.uint8]
    """(parts, nodes) fewest moves to where most of a part is near; see `search.ways_to`."""


class Sequences(NamedTuple):
    """Of a beam, level by level."""

    pose: npt.NDArray[np.int32]
    """(n,) where each sequence ends."""
    parent: npt.NDArray[np.int32]
    """(n,) the sequence that it goes on from; −1 for the start."""
    score: npt.NDArray[np.float64]
    """(n,) its gains with their discount, less the weight of all parts."""
    level: npt.NDArray[np.int32]
    """(n,) its steps."""
    seen: npt.NDArray[np.uint64]
    """(n, words) bits of what it has seen."""
    first: int
    """The first of the last level."""
    best: int
    """The shortest of those with the highest score."""


# One loop: what it keeps from level to level would be a dozen arguments of any part of it.
@njit(cache=True, nogil=True)
def beam(weights, views, graph, moves, start, known, score, width, horizon):
    """The best sequences of actions, level by level.

    Sequences of a level differ in their pose, positions taken to pairs of nodes. The first move leads over
    ground that is known to be free; later ones also over ground that is known, or that the sequence has seen
    by then.

    Args:
        weights: (elements,) float64.
        views: Which of them a pose shows.
        graph: The lattice.
        moves: (poses, advances) 0, FREE or UNKNOWN.
        start: The pose where the vehicle is.
        known: (tiles,) bool, ground that is known.
        score: By which sequences are compared.
        width: Sequences to keep at each level.
        horizon: Levels at most.

    Returns:
        `Sequences`.
    """
    (poses, advances), turns, headings = moves.shape, graph.turned.shape[1], graph.headings
    branches, most = turns * (advances + 1), 1 + width * horizon
    turned, ahead, tile_of, ways = graph.turned, graph.ahead, views.tile, score.ways
    pose, parent = np.zeros(most, np.int32), np.full(most, -1, np.int32)
    total, level = np.zeros(most), np.zeros(most, np.int32)
    seen = np.zeros((most, (len(weights) + 63) // 64), np.uint64)
    pose[0] = start
    for element in score.elements:
        total[0] -= weights[element]
    next_total, value = np.empty((2, width * branches))
    next_parent, next_pose = np.empty((2, width * branches), np.int32)
    parts, between = len(ways), ways_between(ways)
    mass, left, n_left = np.zeros(parts), np.zeros(parts, np.int64), 0
    # Several sequences come to most poses: what shows from there is found once. Places in a list fit 16 bits,
    # as distances in it fit eight. Memory that is not written costs nothing.
    taken = np.zeros(poses, np.int32)
    tiles_from, tiles_to = np.full(poses, -1, np.int64), np.empty(poses, np.int64)
    longest = 0
    for k in range(len(views.first) - 1):
        longest = max(longest, views.first[k + 1] - views.first[k])
    tiles = np.empty(longest * min(poses, width * branches * horizon), np.uint16)
    written, first, past, best = 0, 0, 1, 0
    for d in range(1, horizon + 1):
        n, factor = 0, score.discount**d
        for node in range(first, past):
            mass[:] = 0.0
            for k in range(len(score.elements)):
                if not is_in(seen[node], score.elements[k]):
                    mass[score.part_of[k]] += weights[score.elements[k]]
            n_left = 0
            for part in range(parts):
                if mass[part] > score.slight:
                    left[n_left] = part
                    n_left += 1
            along = tree(between, left, n_left)
            for t in range(turns):
                to = turned[pose[node], t]
                for a in range(-1, advances):
                    end = to
                    if a >= 0:
                        kind = moves[to, a]
                        if kind == 0:
                            continue
                        end = ahead[to, a]
                        tile = tile_of[end // headings]
                        if kind != FREE and (d == 1 or not (known[tile] or is_in(seen[node], tile))):
                            continue
                    elif to == pose[node]:
                        continue
                    if tiles_from[end] < 0:
                        tiles_from[end] = written
                        written += clear_tiles(weights, views, end, tiles[written:])
                        tiles_to[end] = written
                    shown = tiles[tiles_from[end] : tiles_to[end]]
                    more = gain_of(shown, weights, seen[node], views, end)
                    away = NO_WAY if n_left else 0
                    for i in range(n_left):
                        away = min(away, ways[left[i], end // headings])
                    next_total[n] = total[node] + factor * more
                    value[n] = -next_total[n] + score.step * (away + along)
                    next_parent[n], next_pose[n] = node, end
                    n += 1
        if n == 0:
            break
        first = past
        ranked = value[:n] if score.decimals < 0 else np.round(value[:n], score.decimals)
        for k in np.argsort(ranked, kind="mergesort"):
            pair = graph.pair[next_pose[k]]
            if taken[pair] == d:
                continue
            taken[pair] = d
            pose[past], parent[past], total[past] = next_pose[k], next_parent[k], next_total[k]
            level[past] = d
            seen[past] = seen[next_parent[k]]
            look(weights, seen[past], views, next_pose[k])
            if total[past] > total[best] + LESS:
                best = past
            past += 1
            if past - first == width:
                break
        if -total[best] <= score.leave:
            break
    return Sequences(pose[:past], parent[:past], total[:past], level[:past], seen[:past], first, best)
