"""Search for a short way from which all that is foretold comes into view."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np
from numba import njit

from dream.planning._kernels.lookahead import FREE, gain, is_in, look
from dream.planning._kernels.walk import NO_WAY, traced, tree, ways_between


@njit(cache=True, nogil=True)
def shown(index, views):
    """Which of a few elements each pose shows, pose by pose: a search need not ask for the others.

    Args:
        index: (n,) the elements, tiles as ground or as hiding places.
        views: Which elements a pose shows.

    Returns:
        starts: (nodes · headings + 1,) where the elements of each node and heading begin.
        elements: (m,) int32.
    """
    headings, nodes = len(views.first) - 1, len(views.depth)
    starts = np.zeros(nodes * headings + 2, np.int64)
    elements = np.empty(0, np.int32)
    # First they are counted, and then they are written.
    for counted in (False, True):
        if counted:
            starts = np.cumsum(starts)
            elements = np.empty(starts[-1], np.int32)
        for element in index:
            for h in range(headings):
                for k in range(views.first[h], views.first[h + 1]):
                    row, col = divmod(element - views.offset[k], views.stride)
                    row, col = row - views.pad, col - views.pad
                    node = row * views.cols + col
                    if col < 0 or col >= views.cols or node < 0 or node >= nodes:
                        continue
                    if views.far[k] <= views.depth[node, views.bearing[k]]:
                        pose = node * headings + h
                        if counted:
                            elements[starts[pose + 1]] = element
                            starts[pose + 1] += 1
                        else:
                            starts[pose + 2] += 1
    return starts[:-1], elements


@njit(cache=True, nogil=True)
def rounds(
    weights, views, moves, offsets, turns, start, index, part_of, ways, leave, slight, width, horizon, step
):
    """A short sequence of actions that shows all but a little, or as much as the horizon lets it.

    Level by level those sequences are kept that leave least: in weight, and in steps to the nearest part that
    is left and along the shortest tree over these parts.

    Args:
        weights: (elements,) float32.
        views: Which of them a pose shows.
        moves: (rows, cols, headings, advances) 0, FREE or UNKNOWN. The first one is free for sure.
        offsets: (headings, advances, 2) lattice steps (east, north).
        turns: (turns,) in heading steps.
        start: Row, column and heading.
        index: (n,) the elements of any weight.
        part_of: (n,) the part of each.
        ways: (parts, rows, cols) uint8 fewest moves to where most of a part is near; NO_WAY for none.
        leave: Weight that may be left.
        slight: Weight of a part that is not worth a way of its own.
        width: Sequences kept at each level; they differ in their pose, positions taken to pairs of nodes.
        horizon: Levels at most.
        step: Weight that a step counts as much as.

    Returns:
        (steps + 1,) flat (row, col, heading) of the poses, the start first.
    """
    rows, cols, headings, advances = moves.shape
    parts = len(ways)
    between = ways_between(ways)
    most, branches = 1 + width * horizon, len(turns) * (advances + 1)
    pose, parent = np.zeros(most, np.int32), np.full(most, -1, np.int32)
    left = np.zeros(most)
    seen = np.zeros((most, (len(weights) + 63) // 64), np.uint64)
    pose[0] = (start[0] * cols + start[1]) * headings + start[2]
    for element in index:
        left[0] += weights[element]
    next_left, value = np.empty((2, width * branches))
    next_parent, next_pose = np.empty((2, width * branches), np.int32)
    taken = np.zeros(rows * cols * headings, np.int32)
    mass, open_parts = np.zeros(parts), np.zeros(parts, np.int64)
    begin, past, best = 0, 1, 0
    for level in range(1, horizon + 1):
        n = 0
        for node in range(begin, past):
            h = pose[node] % headings
            c = pose[node] // headings % cols
            r = pose[node] // (headings * cols)
            mass[:] = 0.0
            for k in range(len(index)):
                if not is_in(seen[node], index[k]):
                    mass[part_of[k]] += weights[index[k]]
            count = 0
            for part in range(parts):
                if mass[part] > slight:
                    open_parts[count] = part
                    count += 1
            along = tree(between, open_parts, count)
            for turn in turns:
                to = (h + turn) % headings
                for a in range(-1, advances):
                    r_to, c_to = r, c
                    if a >= 0:
                        kind = moves[r, c, to, a]
                        if kind == 0 or (kind != FREE and level == 1):
                            continue
                        r_to, c_to = r + offsets[to, a, 1], c + offsets[to, a, 0]
                    elif turn == 0:
                        continue
                    away = NO_WAY if count else 0
                    for i in range(count):
                        away = min(away, ways[open_parts[i], r_to, c_to])
                    next_left[n] = left[node] - gain(weights, seen[node], views, r_to, c_to, to)
                    value[n] = next_left[n] + step * (away + along)
                    next_parent[n] = node
                    next_pose[n] = (r_to * cols + c_to) * headings + to
                    n += 1
        begin = past
        # Rounded, so that a tie is a tie on every machine.
        for k in np.argsort(np.round(value[:n], 6), kind="mergesort"):
            h = next_pose[k] % headings
            c = next_pose[k] // headings % cols
            r = next_pose[k] // (headings * cols)
            place = (r // 2 * cols + c // 2) * headings + h
            if taken[place] == level:
                continue
            taken[place] = level
            pose[past], parent[past], left[past] = next_pose[k], next_parent[k], next_left[k]
            seen[past] = seen[next_parent[k]]
            look(weights, seen[past], views, r, c, h)
            if left[past] < left[best] - 1e-6:
                best = past
            past += 1
            if past - begin == width:
                break
        if left[best] <= leave or past == begin:
            break
    return traced(pose, parent, best)


@njit(cache=True, nogil=True)
def follow(weights, views, path, shape, index, leave):
    """What a way shows, as far as it takes to leave no more than a little.

    Args:
        weights: See `rounds`.
        views: See `rounds`.
        path: (steps + 1,) flat (row, col, heading), the start first.
        shape: (rows, cols, headings).
        index: See `rounds`.
        leave: See `rounds`.

    Returns:
        steps: How many of its steps that are; all of them where it never does.
        seen: (words,) bits of what they show.
        left: Weight that they leave.
    """
    _, cols, headings = shape
    seen = np.zeros((len(weights) + 63) // 64, np.uint64)
    left = 0.0
    for element in index:
        left += weights[element]
    for k in range(1, len(path)):
        h, c, r = path[k] % headings, path[k] // headings % cols, path[k] // (headings * cols)
        left -= gain(weights, seen, views, r, c, h)
        look(weights, seen, views, r, c, h)
        if left <= leave:
            return k, seen, left
    return len(path) - 1, seen, left
