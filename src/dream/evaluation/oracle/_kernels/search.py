"""Exact searches over (pose, witnesses heard): distance tables, layers without the dominated, steps to go.

Arcs come as two arrays: those of pose p are `to[first[p] : first[p + 1]]`. A mask has two words: witness i is
bit i % 64 of word i // 64.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np
from numba import njit

FAR = 255
"""In a table: this many actions or more, or never."""


@njit(cache=True, nogil=True, inline="always")
def within(a, b, c, d):
    """Does a mask of the words (a, b) hold nothing that one of (c, d) does not?"""
    return (a & ~c) | (b & ~d) == np.uint64(0)


@njit(cache=True, nogil=True)
def extend_table(first_back, back, seen, table, old, new):
    """Fewest actions from every pose to see all of a set of witnesses, for sets `old` to `new` − 1.

    Args:
        first_back: (P + 1,) int64, of the arcs turned round.
        back: (E,) int32, likewise.
        seen: (P,) uint64 witnesses that each pose sees, in one word.
        table: (≥ new, P) uint8, row `set` for that set as a mask; the rows below `old` are filled, row 0 with
            zeros. At most `FAR`.
        old: First set to fill, above 0.
        new: One above the last.
    """
    poses = table.shape[1]
    now, later = np.empty(poses, np.int32), np.empty(poses, np.int32)
    seeds = np.empty(poses, np.int32)
    for wanted in range(old, new):
        row = table[wanted]
        row[:] = FAR
        count = 0
        top = np.int64(0)
        for s in range(poses):
            got = int(seen[s]) & wanted
            if got:
                row[s] = table[wanted & ~got, s]
                if row[s] < FAR:
                    seeds[count] = s
                    count += 1
                    if row[s] > top:
                        top = np.int64(row[s])
        # Seeds in the order of their steps.
        starts = np.zeros(top + 2, np.int64)
        for k in range(count):
            starts[row[seeds[k]] + 1] += 1
        for v in range(top + 1):
            starts[v + 1] += starts[v]
        ends = starts.copy()
        ordered = np.empty(count, np.int32)
        for k in range(count):
            v = row[seeds[k]]
            ordered[ends[v]] = seeds[k]
            ends[v] += 1
        n_now = 0
        v = 0
        while v < FAR - 1 and (v <= top or n_now > 0):
            if v <= top:
                for k in range(starts[v], starts[v + 1]):
                    if row[ordered[k]] == v:
                        now[n_now] = ordered[k]
                        n_now += 1
            n_later = 0
            for k in range(n_now):
                s = now[k]
                for e in range(first_back[s], first_back[s + 1]):
                    p = back[e]
                    if row[p] > v + 1:
                        row[p] = v + 1
                        later[n_later] = p
                        n_later += 1
            now, later = later, now
            n_now = n_later
            v += 1


@njit(cache=True, nogil=True)
def least_steps(known_first, known_mask, known_since, known_steps, known_bits, s, low, high, layer):
    """At least so many actions a state lacks by an earlier search, `FAR` for more than the limit left it.

    Had the earlier search let it pass, then it kept the state itself, or one that had seen as much no later.
    """
    low, high = low & known_bits[0], high & known_bits[1]
    if low == known_bits[0] and high == known_bits[1]:
        return 0
    least = np.int64(0)
    passed = False
    for j in range(known_first[s], known_first[s + 1]):
        if within(low, high, known_mask[j, 0], known_mask[j, 1]):
            if known_steps[j] > least:
                least = np.int64(known_steps[j])
            passed = passed or known_since[j] <= layer
            if low == known_mask[j, 0] and high == known_mask[j, 1]:
                break
    return least if passed else FAR


@njit(cache=True, nogil=True)
def expand(
    first,
    to,
    seen,
    limit,
    table,
    table_bits,
    known_bits,
    known_first,
    known_mask,
    known_since,
    known_steps,
    layer,
    low,
    high,
    count,
    pose,
    mask,
    parent,
    front_at,
    front_size,
    front_room,
    front,
    used,
):
    """Carry the states `low` to `high` − 1, all in `layer`, one action on.

    A state is a pose and the witnesses heard on a way there. It is dropped where the way on is known to be
    too long for `limit`, and where a state at the same pose has heard as much after no more actions. A state
    that has heard enough is carried on too: it may stand for others that have not.

    Args:
        first: (P + 1,) int64, of the arcs.
        to: (E,) int32, likewise.
        seen: (P, 2) uint64 witnesses that each pose sees.
        limit: Actions that a whole walk may have.
        table: (2**table_bits, P) uint8 at least so many actions to go where these of the lowest witnesses
            were not heard.
        table_bits: How many these are.
        known_bits: (2,) uint64, the witnesses of an earlier search with the same limit.
        known_first: (P + 1,) int64 its states at each pose that some walk within the limit passes; (0,) where
            there is none.
        known_mask: (…, 2) uint64, what these had heard.
        known_since: uint8, after how many actions.
        known_steps: uint8, at least so many actions they lack.
        layer: Actions so far.
        low: First state to expand.
        high: One after the last.
        count: Number of states.
        pose: (room,) int32 of each state.
        mask: (room, 2) uint64 witnesses it has heard.
        parent: (room,) int32 the state before.
        front_at: (P,) int64 where in `front` the list of a pose begins.
        front_size: (P,) int32 its length.
        front_room: (P,) int32 its capacity.
        front: (room, 2) uint64 masks at a pose, none of them a part of another.
        used: Entries of `front` in use.

    Returns:
        count: Number of states, −1 where there was no room for them.
        used: Entries of `front` in use.
    """
    rest = limit - layer - 1
    ones = np.uint64((1 << table_bits) - 1)
    remembers = len(known_first) > 0
    for k in range(low, high):
        for e in range(first[pose[k]], first[pose[k] + 1]):
            s = to[e]
            m, n = mask[k, 0] | seen[s, 0], mask[k, 1] | seen[s, 1]
            if table[np.int64(ones & ~m), s] > rest:
                continue
            if remembers and (
                least_steps(known_first, known_mask, known_since, known_steps, known_bits, s, m, n, layer + 1)
                > rest
            ):
                continue
            at, size = front_at[s], front_size[s]
            dominated = False
            for j in range(at, at + size):
                if within(m, n, front[j, 0], front[j, 1]):
                    dominated = True
                    break
            if dominated:
                continue
            kept = at
            for j in range(at, at + size):
                if not within(front[j, 0], front[j, 1], m, n):
                    front[kept, 0], front[kept, 1] = front[j, 0], front[j, 1]
                    kept += 1
            size = kept - at
            if size == front_room[s]:
                room = max(4, 2 * size)
                if used + room > len(front):
                    return -1, used
                for j in range(size):
                    front[used + j, 0], front[used + j, 1] = front[at + j, 0], front[at + j, 1]
                front_at[s] = used
                front_room[s] = room
                at = used
                used += room
            front[at + size, 0], front[at + size, 1] = m, n
            front_size[s] = size + 1
            if count == len(pose):
                return -1, used
            pose[count] = s
            mask[count, 0], mask[count, 1] = m, n
            parent[count] = k
            count += 1
    return count, used


@njit(cache=True, nogil=True)
def drop_dominated(low, count, pose, mask, parent, front_at, front_size, front):
    """Keep, of the states from `low` on, those that `front` still holds; their number with those before."""
    kept = low
    for k in range(low, count):
        s = pose[k]
        for j in range(front_at[s], front_at[s] + front_size[s]):
            if front[j, 0] == mask[k, 0] and front[j, 1] == mask[k, 1]:
                pose[kept] = s
                mask[kept, 0], mask[kept, 1] = mask[k, 0], mask[k, 1]
                parent[kept] = parent[k]
                kept += 1
                break
    return kept


@njit(cache=True, nogil=True)
def ones_of(word):
    """Number of bits set in a uint64."""
    x = word
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((x * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit(cache=True, nogil=True)
def hears_enough(members, mask, may_miss, together):
    """Do the witnesses that are not in `mask` hold no more individuals than may be missed?

    Args:
        members: (K, W) uint64 individuals of each witness.
        mask: (2,) uint64 witnesses that were heard.
        may_miss: Individuals that may stay unseen.
        together: (W,) uint64, overwritten.
    """
    together[:] = np.uint64(0)
    for k in range(len(members)):
        if mask[k // 64] >> np.uint64(k % 64) & np.uint64(1) == np.uint64(0):
            missed = np.int64(0)
            for w in range(len(together)):
                together[w] |= members[k, w]
                missed += ones_of(together[w])
            if missed > may_miss:
                return False
    return True


@njit(cache=True, nogil=True)
def steps_to_go(first_back, back, seen, members, may_miss, limit, count, pose, mask, layer_first):
    """The states of a finished search that a walk within the limit passes, with the actions they lack.

    Args:
        first_back: (P + 1,) int64, of the arcs turned round.
        back: (E,) int32, likewise.
        seen: (P, 2) uint64 witnesses that each pose sees.
        members: (K, W) uint64 individuals of each witness.
        may_miss: Individuals that may stay unseen.
        limit: Actions that a whole walk may have.
        count: Number of states.
        pose: (≥ count,) int32 of each state.
        mask: (≥ count, 2) uint64 witnesses it has heard.
        layer_first: (layers + 1,) int64 first state of each layer.

    Returns:
        at: (P + 1,) int64 the first of the states below at each pose.
        masks: (K, 2) uint64 witnesses that each has heard.
        since: (K,) uint8 after how many actions.
        steps: (K,) uint8 at least so many actions it lacks.
        state: (K,) int32 which one it is.
    """
    poses = len(first_back) - 1
    at = np.zeros(poses + 1, np.int64)
    for k in range(count):
        at[pose[k] + 1] += 1
    for s in range(poses):
        at[s + 1] += at[s]
    end = at[:-1].copy()
    masks = np.empty((count, 2), np.uint64)
    layer_of = np.empty(count, np.int16)
    place, state = np.empty(count, np.int32), np.empty(count, np.int32)
    now, later = np.empty(count, np.int32), np.empty(count, np.int32)
    n_now = 0
    steps = np.full(count, -1, np.int16)
    together = np.empty(members.shape[1], np.uint64)
    for layer in range(len(layer_first) - 1):
        for k in range(layer_first[layer], layer_first[layer + 1]):
            j = end[pose[k]]
            end[pose[k]] += 1
            masks[j, 0], masks[j, 1] = mask[k, 0], mask[k, 1]
            layer_of[j] = layer
            place[j] = pose[k]
            state[j] = k
            if hears_enough(members, mask[k], may_miss, together):
                steps[j] = 0
                now[n_now] = j
                n_now += 1
    # Of each pose, the states without steps yet.
    waiting = np.arange(count).astype(np.int32)
    lack = 0
    while n_now > 0:
        lack += 1
        n_later = 0
        for n in range(n_now):
            j = now[n]
            s = place[j]
            for e in range(first_back[s], first_back[s + 1]):
                p = back[e]
                keep = at[p]
                for n_i in range(at[p], end[p]):
                    i = waiting[n_i]
                    if steps[i] >= 0 or layer_of[i] + lack > limit:
                        continue
                    # The state after i is j, or was dropped for j's sake.
                    if layer_of[j] <= layer_of[i] + 1 and within(
                        masks[i, 0] | seen[s, 0], masks[i, 1] | seen[s, 1], masks[j, 0], masks[j, 1]
                    ):
                        steps[i] = lack
                        later[n_later] = i
                        n_later += 1
                    else:
                        waiting[keep] = i
                        keep += 1
                end[p] = keep
        now, later = later, now
        n_now = n_later
    kept = 0
    begin = 0
    for s in range(poses):
        stop = at[s + 1]
        at[s] = kept
        for j in range(begin, stop):
            if steps[j] >= 0:
                masks[kept, 0], masks[kept, 1] = masks[j, 0], masks[j, 1]
                layer_of[kept] = layer_of[j]
                state[kept] = state[j]
                steps[kept] = steps[j]
                kept += 1
        begin = stop
    at[poses] = kept
    return (
        at,
        masks[:kept].copy(),
        layer_of[:kept].astype(np.uint8),
        steps[:kept].astype(np.uint8),
        state[:kept].copy(),
    )


@njit(cache=True, nogil=True)
def before(
    first_back,
    back,
    seen,
    views,
    layer,
    known_first,
    known_mask,
    known_since,
    known_state,
    pose,
    parent,
    ends,
    masks,
    sight,
):
    """The states one action before the ends of some walks, with what each whole walk sees that passes them.

    Args:
        first_back: (P + 1,) int64, of the arcs turned round.
        back: (E,) int32, likewise.
        seen: (P, 2) uint64 witnesses that each pose sees.
        views: (P, W) uint64 individuals that each pose sees.
        layer: Actions up to the states looked for.
        known_first: (P + 1,) int64 the first of the states at each pose.
        known_mask: (…, 2) uint64, witnesses that these had heard.
        known_since: uint8, after how many actions.
        known_state: int32, their places in `pose` and `parent`.
        pose: int32 of each state.
        parent: int32 the state before.
        ends: (K,) int32 poses from which the walks are known.
        masks: (K, 2) uint64 witnesses heard up to there.
        sight: (K, W) uint64 individuals seen from there on.

    Returns:
        walk: (C,) int32 which walk.
        place: (C,) int32 which of the states.
        count: (C,) int32 individuals seen.
    """
    words = views.shape[1]
    all_seen = np.empty(words, np.uint64)
    room = 0
    for s in ends:
        for e in range(first_back[s], first_back[s + 1]):
            room += known_first[back[e] + 1] - known_first[back[e]]
    walk, place, count = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int32)
    n = 0
    for k in range(len(ends)):
        s = ends[k]
        for e in range(first_back[s], first_back[s + 1]):
            p = back[e]
            for j in range(known_first[p], known_first[p + 1]):
                if (
                    known_since[j] != layer
                    or known_mask[j, 0] | seen[s, 0] != masks[k, 0]
                    or known_mask[j, 1] | seen[s, 1] != masks[k, 1]
                ):
                    continue
                all_seen[:] = sight[k]
                at = known_state[j]
                while at >= 0:
                    for w in range(words):
                        all_seen[w] |= views[pose[at], w]
                    at = parent[at]
                total = 0
                for w in range(words):
                    total += ones_of(all_seen[w])
                walk[n], place[n], count[n] = k, j, total
                n += 1
    return walk[:n].copy(), place[:n].copy(), count[:n].copy()


@njit(cache=True, nogil=True)
def least_watched(views, weights, candidates, individuals, size):
    """A set of candidates whose watching poses weigh little together: greedily, the least addition first.

    Args:
        views: (K, W) uint64 individuals that each pose sees.
        weights: (K,) int64 of the poses.
        candidates: (≤ N,) int64 individuals to choose from, the preferred one first where two are equal.
        individuals: N.
        size: How many to choose, at most as many as there are candidates.

    Returns:
        (size,) int64 individuals, and the weight of all that see one of them.
    """
    load = np.zeros(individuals, np.int64)
    one = np.uint64(1)
    zero = np.uint64(0)
    for k in range(len(views)):
        for w in range(views.shape[1]):
            word = views[k, w]
            i = 64 * w
            while word != zero:
                if word & one != zero:
                    load[i] += weights[k]
                word >>= one
                i += 1
    taken = np.zeros(individuals, np.bool_)
    watching = np.zeros(len(views), np.bool_)
    chosen = np.empty(size, np.int64)
    total = 0
    for n in range(size):
        best = -1
        for i in candidates:
            if not taken[i] and (best < 0 or load[i] < load[best]):
                best = i
        taken[best] = True
        chosen[n] = best
        total += load[best]
        word_of, bit = best // 64, one << np.uint64(best % 64)
        for k in range(len(views)):
            if not watching[k] and views[k, word_of] & bit != zero:
                watching[k] = True
                for w in range(views.shape[1]):
                    word = views[k, w]
                    i = 64 * w
                    while word != zero:
                        if word & one != zero:
                            load[i] -= weights[k]
                        word >>= one
                        i += 1
    return chosen, total
