"""Distances between poses, the part of a graph that a walk of given length can use, and a beam over walks.

Distances are uint8: `FAR` stands for 255 steps or more, and for no way at all.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dream.evaluation.oracle._kernels.search import ones_of

FAR = 255
CACHE = 1 << 15
"""Entries of the beam's memory of spanning trees."""


@njit(cache=True, nogil=True)
def lowest(word):  # type: ignore[no-untyped-def]
    """Index of the lowest bit set; the word is not zero."""
    return ones_of((word & (~word + np.uint64(1))) - np.uint64(1))


@njit(cache=True, nogil=True)
def reverse(arcs):  # type: ignore[no-untyped-def]
    """The moves that end in each pose.

    Args:
        arcs: (n, A) int32 end of each move, negative where there is none.

    Returns:
        first: (n + 1,) int64, pose p is the end of the moves from `source[first[p]:first[p + 1]]`.
        source: int32 poses.
    """
    n, actions = arcs.shape
    first = np.zeros(n + 1, np.int64)
    for p in range(n):
        for a in range(actions):
            if arcs[p, a] >= 0:
                first[arcs[p, a] + 1] += 1
    for p in range(n):
        first[p + 1] += first[p]
    fill = first[:-1].copy()
    source = np.empty(first[n], np.int32)
    for p in range(n):
        for a in range(actions):
            q = arcs[p, a]
            if q >= 0:
                source[fill[q]] = p
                fill[q] += 1
    return first, source


@njit(cache=True, nogil=True)
def steps_to(first, source, goals, costs, limit):  # type: ignore[no-untyped-def]
    """Fewest steps from every pose to a goal, plus what that goal still costs.

    Args:
        first: As `reverse` gives it.
        source: Likewise.
        goals: (G,) poses, by rising cost.
        costs: (G,) int64 steps, 0 or more.
        limit: Sums above this are not searched.

    Returns:
        (n,) uint8 steps, `FAR` beyond the limit.
    """
    n = len(first) - 1
    limit = min(limit, FAR - 1)
    steps = np.full(n, np.uint8(FAR), np.uint8)
    queue = np.empty(n, np.int32)
    head, tail, goal = 0, 0, 0
    while True:
        if goal < len(goals) and (head == tail or costs[goal] <= steps[queue[head]]):
            if costs[goal] > limit:
                break
            if steps[goals[goal]] > costs[goal]:
                # Goals come by rising cost, so that one found already was found no dearer.
                steps[goals[goal]] = costs[goal]
                queue[tail] = goals[goal]
                tail += 1
            goal += 1
            continue
        if head == tail:
            break
        here = queue[head]
        head += 1
        after = np.int64(steps[here]) + 1
        if after > limit:
            continue
        for k in range(first[here], first[here + 1]):
            p = source[k]
            if steps[p] == FAR:
                steps[p] = after
                queue[tail] = p
                tail += 1
    return steps


@njit(cache=True, nogil=True)
def steps_from(arcs, begins, floor, limit):  # type: ignore[no-untyped-def]
    """Fewest steps to every pose from the nearest of some.

    Args:
        arcs: (n, A) int32 end of each move, negative where there is none.
        begins: (B,) poses.
        floor: (n,) uint8 steps that the walk takes from each pose on at the very least.
        limit: Poses on no walk this short are not searched.

    Returns:
        steps: (n,) uint8, `FAR` beyond the limit.
        order: The poses reached, nearest first.
    """
    n, actions = arcs.shape
    limit = min(limit, FAR - 1)
    steps = np.full(n, np.uint8(FAR), np.uint8)
    queue = np.empty(n, np.int32)
    tail = 0
    for p in begins:
        if steps[p] == FAR:
            steps[p] = 0
            queue[tail] = p
            tail += 1
    head = 0
    while head < tail:
        here = queue[head]
        head += 1
        after = np.int64(steps[here]) + 1
        for a in range(actions):
            q = arcs[here, a]
            if q >= 0 and steps[q] == FAR and after + floor[q] <= limit:
                steps[q] = after
                queue[tail] = q
                tail += 1
    return steps, queue[:tail].copy()


@njit(cache=True, nogil=True)
def inner_arcs(arcs, nodes, index):  # type: ignore[no-untyped-def]
    """The moves among some poses, renumbered.

    Args:
        arcs: (n, A).
        nodes: (m,) poses to keep.
        index: (n,) int32 number of each kept pose, −1 for the others.

    Returns:
        (m, A) int32.
    """
    kept = np.full((len(nodes), arcs.shape[1]), -1, np.int32)
    for k in range(len(nodes)):
        for a in range(arcs.shape[1]):
            q = arcs[nodes[k], a]
            if q >= 0:
                kept[k, a] = index[q]
    return kept


@njit(cache=True, nogil=True)
def columns(views, nodes, wanted):  # type: ignore[no-untyped-def]
    """What some poses see of some individuals.

    Args:
        views: (n, W) uint64.
        nodes: (m,) poses.
        wanted: (R,) individuals.

    Returns:
        (m, ⌈R / 64⌉) uint64, bit r for individual wanted[r].
    """
    out = np.zeros((len(nodes), (len(wanted) + 63) // 64), np.uint64)
    for k in range(len(nodes)):
        row = views[nodes[k]]
        for r in range(len(wanted)):
            i = wanted[r]
            bit = (row[i >> 6] >> np.uint64(i & 63)) & np.uint64(1)
            out[k, r >> 6] |= bit << np.uint64(r & 63)
    return out


@njit(cache=True, nogil=True)
def transposed(views, count):  # type: ignore[no-untyped-def]
    """(count, ⌈n / 64⌉) uint64: bit p of row i says whether pose p sees individual i."""
    n, words = views.shape
    out = np.zeros((count, (n + 63) // 64), np.uint64)
    for p in range(n):
        for w in range(words):
            word = views[p, w]
            while word:
                i = w * 64 + lowest(word)
                word &= word - np.uint64(1)
                out[i, p >> 6] |= np.uint64(1) << np.uint64(p & 63)
    return out


@njit(cache=True, nogil=True)
def implied(watch):  # type: ignore[no-untyped-def]
    """Individuals that are seen whenever a certain other one is.

    Args:
        watch: (R, words) uint64 the poses that see each individual.

    Returns:
        (R,) bool; of individuals with equal watch sets the first is not implied.
    """
    count, words = watch.shape
    size = np.zeros(count, np.int64)
    begin = np.full(count, words, np.int64)
    for i in range(count):
        for w in range(words):
            if watch[i, w]:
                size[i] += ones_of(watch[i, w])
                begin[i] = min(begin[i], w)
    drop = np.zeros(count, np.bool_)
    for j in np.argsort(size, kind="mergesort"):
        if drop[j] or size[j] == 0:
            continue
        for i in range(count):
            if i == j or drop[i] or size[i] < size[j] or begin[i] > begin[j]:
                continue
            if size[i] == size[j] and i < j:
                continue
            inside = True
            for w in range(begin[j], words):
                if watch[j, w] & ~watch[i, w]:
                    inside = False
                    break
            if inside:
                drop[i] = True
    return drop


@njit(cache=True, nogil=True)
def nearest(watch, steps):  # type: ignore[no-untyped-def]
    """(R,) uint8: the least of `steps` over the poses that see each individual."""
    count, words = watch.shape
    out = np.full(count, np.uint8(FAR), np.uint8)
    for i in range(count):
        best = np.uint8(FAR)
        for w in range(words):
            word = watch[i, w]
            while word:
                p = w * 64 + lowest(word)
                word &= word - np.uint64(1)
                best = min(best, steps[p])
        out[i] = best
    return out


@njit(cache=True, nogil=True)
def members(row):  # type: ignore[no-untyped-def]
    """Indices of the bits set in a row of words, rising."""
    count = 0
    for word in row:
        count += ones_of(word)
    out = np.empty(count, np.int64)
    k = 0
    for w in range(len(row)):
        word = row[w]
        while word:
            out[k] = w * 64 + lowest(word)
            word &= word - np.uint64(1)
            k += 1
    return out


@njit(cache=True, nogil=True)
def through(begin, between, first, member, order, choice):  # type: ignore[no-untyped-def]
    """Fewest steps from the beginning through one pose of each group, the groups in a given order.

    Args:
        begin: (M,) uint8 steps from the beginning to each pose.
        between: (M, M) uint8 steps from pose to pose.
        first: (K + 1,) int64, group k holds `member[first[k]:first[k + 1]]`.
        member: int64 poses.
        order: (L,) int64 groups to pass.
        choice: (L,) int64 is filled with the pose chosen of each.

    Returns:
        Steps.
    """
    most = 0
    for k in range(len(first) - 1):
        most = max(most, first[k + 1] - first[k])
    cost = np.zeros((len(order), most), np.int64)
    via = np.zeros((len(order), most), np.int64)
    for t in range(len(order)):
        low, high = first[order[t]], first[order[t] + 1]
        for c in range(high - low):
            q = member[low + c]
            if t == 0:
                cost[t, c] = begin[q]
                continue
            before = first[order[t - 1]]
            best, at = np.int64(1 << 40), 0
            for b in range(first[order[t - 1] + 1] - before):
                steps = cost[t - 1, b] + between[member[before + b], q]
                if steps < best:
                    best, at = steps, b
            cost[t, c] = best
            via[t, c] = at
    last = len(order) - 1
    if last < 0:
        return np.int64(0)
    at = 0
    for c in range(first[order[last] + 1] - first[order[last]]):
        if cost[last, c] < cost[last, at]:
            at = c
    total = cost[last, at]
    for t in range(last, -1, -1):
        choice[t] = member[first[order[t]] + at]
        at = via[t, at]
    return total


@njit(cache=True, nogil=True)
def anneal(begin, between, first, member, order, active, rounds, hot, cold, rng):  # type: ignore[no-untyped-def]
    """A good order to pass groups of poses in, by simulated annealing with moved and reversed stretches.

    Args:
        begin: As in `through`.
        between: Likewise.
        first: Likewise.
        member: Likewise.
        order: (K,) int64 groups to begin with; changed.
        active: How many of the groups, the first ones of the order, are passed.
        rounds: Changes to try.
        hot: First temperature in steps.
        cold: Last.
        rng: Chance.

    Returns:
        The poses chosen, in order; `order` is the order that they are in.
    """
    skipped = len(order) - active
    choice = np.empty(active, np.int64)
    length = through(begin, between, first, member, order[:active], choice)
    best_length, best_choice, best_order = length, choice.copy(), order.copy()
    trial = order.copy()
    for turn in range(rounds):
        heat = hot * (cold / hot) ** (turn / rounds)
        trial[:] = order
        kind = rng.random()
        i = int(rng.random() * active)
        if skipped > 0 and kind < 0.2:
            j = active + int(rng.random() * skipped)
            trial[i : active - 1] = order[i + 1 : active]
            trial[j] = order[i]
            k = int(rng.random() * active)
            trial[k + 1 : active] = trial[k : active - 1].copy()
            trial[k] = order[j]
        elif kind < 0.6:
            size = 1 + int(rng.random() * min(4, active - i))
            rest = np.concatenate((order[:i], order[i + size : active]))
            k = int(rng.random() * (len(rest) + 1))
            moved = order[i : i + size].copy()
            if rng.random() < 0.5:
                moved = moved[::-1].copy()
            trial[:k] = rest[:k]
            trial[k : k + size] = moved
            trial[k + size : active] = rest[k:]
        else:
            j = int(rng.random() * active)
            low, high = min(i, j), max(i, j) + 1
            trial[low:high] = order[low:high][::-1].copy()
        new = through(begin, between, first, member, trial[:active], choice)
        if new <= length or rng.random() < np.exp((length - new) / heat):
            length = new
            order[:] = trial
            if length < best_length:
                best_length = length
                best_choice[:] = choice
                best_order[:] = order
    order[:] = best_order
    return best_choice


@njit(cache=True, nogil=True)
def bits(individuals, words):  # type: ignore[no-untyped-def]
    """(words,) uint64 with the bits of some individuals set."""
    out = np.zeros(words, np.uint64)
    for i in individuals:
        out[i >> 6] |= np.uint64(1) << np.uint64(i & 63)
    return out


@njit(cache=True, nogil=True)
def is_covered(mask, others, first, link):  # type: ignore[no-untyped-def]
    """Has one of a chain of walks seen all that a walk has seen?

    Args:
        mask: (words,) bits of what it has seen.
        others: (n, words) likewise.
        first: The first of the chain; −1 where there is none.
        link: (n,) the next one.
    """
    while first >= 0:
        covered = True
        for w in range(len(mask)):
            if mask[w] & ~others[first, w]:
                covered = False
                break
        if covered:
            return True
        first = link[first]
    return False


@njit(cache=True, nogil=True)
def _tree(unseen, between, anchored):  # type: ignore[no-untyped-def]
    """Length of a least spanning tree over some landmarks, and over the end of the walk where it has one."""
    count = len(between) - 1
    node = np.empty(count + 1, np.int64)
    size = 0
    if anchored:
        node[0] = count
        size = 1
    while unseen:
        node[size] = lowest(unseen)
        unseen &= unseen - np.uint64(1)
        size += 1
    reach = np.full(count + 1, 1e9)
    done = np.zeros(count + 1, np.bool_)
    total, here = 0.0, 0
    for _ in range(size - 1):
        done[here] = True
        best, at = 1e9, -1
        for k in range(size):
            if not done[k]:
                reach[k] = min(reach[k], between[node[here], node[k]])
                if at < 0 or reach[k] < best:
                    best, at = reach[k], k
        total += best
        here = at
    return total


@njit(cache=True, nogil=True)
def beam(  # type: ignore[no-untyped-def]
    arcs, views, weights, togo, landmarks, approach, detour, between, anchored, begin, seen, limit, may_miss,
    width, crowd, urge, noise, rng,
):  # fmt: skip
    """A short walk that sees what is wanted: layer by layer, keeping the most promising of each layer.

    A walk's promise is its expected length: a spanning tree over the landmarks it has not seen, plus `urge`
    times the weight of all that it has not seen.

    Args:
        arcs: (n, A) int32 moves, negative where there is none.
        views: (n, W) uint64 what each pose sees of the R wanted.
        weights: (R,) float64, positive.
        togo: (n,) uint8 steps from each pose to the end of the walk; zeros where it may end anywhere.
        landmarks: (K,) at most 64 of the wanted that lie far apart.
        approach: (n, K) uint8 steps from each pose to where it sees a landmark.
        detour: (n, K) uint8 steps from each pose past a landmark to the end.
        between: (K + 1, K + 1) float64 steps between landmarks, and in the last row to the end.
        anchored: Whether the walk has a given end.
        begin: Pose of the beginning.
        seen: (W,) uint64 what is already seen.
        limit: Longest walk.
        may_miss: How many of the wanted may stay unseen.
        width: Walks kept of a layer.
        crowd: Walks kept of a layer that end in the same pose.
        urge: See above.
        noise: Standard deviation, in steps, of what is added to a promise.
        rng: Chance.

    Returns:
        length: Of the walk up to where only the way to the end is left; −1 where none was found.
        actions: The walk that far.
        end: The pose it has reached.
        missed: (R,) int64 how often each of the wanted was among the last unseen of the best walks.
    """
    n, actions = arcs.shape
    words = views.shape[1]
    count = len(landmarks)
    wanted = len(weights)
    parent = np.zeros((limit + 1, width), np.int32)
    action = np.zeros((limit + 1, width), np.int16)
    pose = np.empty(width, np.int32)
    mask = np.zeros((width, words), np.uint64)
    left = np.zeros(width)
    lack = np.zeros(width, np.int64)
    pose_next = np.empty(width, np.int32)
    mask_next = np.zeros((width, words), np.uint64)
    left_next = np.zeros(width)
    lack_next = np.zeros(width, np.int64)

    room = width * actions
    c_from = np.empty(room, np.int32)
    c_action = np.empty(room, np.int16)
    c_left = np.empty(room)
    c_lack = np.empty(room, np.int64)
    c_promise = np.empty(room)

    head = np.full(n, -1, np.int32)
    link = np.empty(width, np.int32)
    held = np.zeros(n, np.int16)
    tree_key = np.zeros(CACHE, np.uint64)
    tree_value = np.full(CACHE, -1.0)
    trial = np.empty(words, np.uint64)
    missed = np.zeros(wanted, np.int64)

    pose[0] = begin
    mask[0] = seen | views[begin]
    for i in range(wanted):
        if not (mask[0, i >> 6] >> np.uint64(i & 63)) & np.uint64(1):
            left[0] += weights[i]
            lack[0] += 1
    size = 1
    best, best_layer, best_at = limit + 1, -1, -1
    if lack[0] <= may_miss:
        best, best_layer, best_at = np.int64(togo[begin]), 0, 0
    layer = 0
    while size > 0 and layer + 1 < best:
        found = 0
        for s in range(size):
            for a in range(actions):
                q = arcs[pose[s], a]
                if q < 0 or layer + 1 + togo[q] >= best:
                    continue
                weight, lacking = left[s], lack[s]
                for w in range(words):
                    new = views[q, w] & ~mask[s, w]
                    while new:
                        weight -= weights[w * 64 + lowest(new)]
                        lacking -= 1
                        new &= new - np.uint64(1)
                unseen = np.uint64(0)
                near, far, lost = np.int64(FAR), np.int64(togo[q]), 0
                for k in range(count):
                    i = landmarks[k]
                    if not ((mask[s, i >> 6] | views[q, i >> 6]) >> np.uint64(i & 63)) & np.uint64(1):
                        unseen |= np.uint64(1) << np.uint64(k)
                        way = np.int64(detour[q, k])
                        if layer + 1 + way >= best:
                            lost += 1
                        far = max(far, way)
                        near = min(near, np.int64(approach[q, k]))
                if lost > may_miss:
                    continue
                promise = urge * weight
                if unseen:
                    slot = (unseen * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(49)
                    if tree_value[slot] < 0.0 or tree_key[slot] != unseen:
                        tree_key[slot] = unseen
                        tree_value[slot] = _tree(unseen, between, anchored)
                    promise += max(tree_value[slot] + near, far)
                else:
                    promise += togo[q]
                if noise > 0.0:
                    promise += noise * rng.standard_normal()
                c_from[found] = s
                c_action[found] = a
                c_left[found] = weight
                c_lack[found] = lacking
                c_promise[found] = promise
                found += 1
        layer += 1
        kept = 0
        for c in np.argsort(c_promise[:found], kind="quicksort"):
            s = c_from[c]
            q = arcs[pose[s], c_action[c]]
            for w in range(words):
                trial[w] = mask[s, w] | views[q, w]
            if held[q] >= crowd or is_covered(trial, mask_next, head[q], link):
                continue
            pose_next[kept] = q
            mask_next[kept] = trial
            left_next[kept] = c_left[c]
            lack_next[kept] = c_lack[c]
            parent[layer, kept] = s
            action[layer, kept] = c_action[c]
            link[kept] = head[q]
            head[q] = kept
            held[q] += 1
            if c_lack[c] <= may_miss and layer + togo[q] < best:
                best, best_layer, best_at = layer + np.int64(togo[q]), layer, kept
            kept += 1
            if kept == width:
                break
        for s in range(kept):
            head[pose_next[s]] = -1
            held[pose_next[s]] = 0
        if kept == 0:
            break
        size = kept
        pose, pose_next = pose_next, pose
        mask, mask_next = mask_next, mask
        left, left_next = left_next, left
        lack, lack_next = lack_next, lack

    if best_layer < 0:
        # What the walks lack that were nearest to success when the search ended.
        for s in np.argsort(left[:size])[: max(1, size // 20)]:
            for i in range(wanted):
                if not (mask[s, i >> 6] >> np.uint64(i & 63)) & np.uint64(1):
                    missed[i] += 1
        return -1, np.empty(0, np.int16), np.int64(begin), missed
    walk = np.empty(best_layer, np.int16)
    at = np.int64(best_at)
    for t in range(best_layer, 0, -1):
        walk[t - 1] = action[t, at]
        at = np.int64(parent[t, at])
    end = np.int64(begin)
    for t in range(best_layer):
        end = np.int64(arcs[end, walk[t]])
    return best_layer, walk, end, missed
