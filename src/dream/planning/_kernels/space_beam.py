"""A beam search over the real actions in three dimensions, by what sequences show and what they leave."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.mapping._kernels.volume import SOLID
from dream.mapping._kernels.volume_surface import grown
from dream.planning._kernels.looks import is_facing, is_open
from dream.planning._kernels.views import is_in
from dream.planning._kernels.ways import FINE, passes

FAR = 1e9
"""Steps to nowhere."""


class SpaceElements(NamedTuple):
    """What is left to look at, piece by piece."""

    points: npt.NDArray[np.float64]
    """(E, 3) metres in the world."""
    normals: npt.NDArray[np.float64]
    """(E, 3) of length 1, towards the water."""
    cosines: npt.NDArray[np.float64]
    """(E,) of the greatest angle between normal and line of sight."""
    weights: npt.NDArray[np.float64]
    """(E,) square metres, some of which count more than once."""
    part_of: npt.NDArray[np.int64]
    """(E,) the part that each belongs to."""
    parts: npt.NDArray[np.float64]
    """(parts, 3) their middles, metres in the world."""


class SpaceLattice(NamedTuple):
    """Where the body may be, and how it looks from there."""

    fits: npt.NDArray[np.uint8]
    """(levels, rows, cols) at fine points."""
    stands: npt.NDArray[np.uint8]
    """(levels, rows, cols) at nodes."""
    first: npt.NDArray[np.float64]
    """(3,) x, y and z of the first node, metres."""
    spacing: float
    """Metres between nodes."""
    headings: npt.NDArray[np.float64]
    """(headings, 2) cosine and sine of each."""
    tilts: npt.NDArray[np.float64]
    """(tilts, 2) cosine and sine of each, downwards."""


class SpaceScore(NamedTuple):
    """How sequences are compared: by their gains, less what is still to be done."""

    discount: float
    """What a gain is worth a step later."""
    step: float
    """Weight that a step of the way to what is left counts as much as."""
    slight: float
    """Weight up to which what is left of a part is not worth a way of its own."""
    near: float
    """Metres from the middle of a part at which its way is done."""
    stride: float
    """Metres of a step over ground."""
    climb: float
    """Metres of a step in height."""


class SpaceSequences(NamedTuple):
    """Of a beam, level by level; the first is where the vehicle is."""

    node: npt.NDArray[np.int64]
    """(n, 3) level, row and column."""
    heading: npt.NDArray[np.int64]
    """(n,)."""
    tilt: npt.NDArray[np.int64]
    """(n,)."""
    parent: npt.NDArray[np.int64]
    """(n,) the sequence that it goes on from; −1 for the start."""
    level: npt.NDArray[np.int64]
    """(n,) its steps."""
    score: npt.NDArray[np.float64]
    """(n,) its gains with their discount."""
    value: npt.NDArray[np.float64]
    """(n,) the same less the way to what is left."""


@njit(cache=True, nogil=True)
def seen_from(scene, optics, lattice, elements, camera, which, bits):
    """Which elements show from a place at any heading and tilt, and as bits under which; how many.

    Bit `heading · tilts + tilt` is set where the element is in the image.
    """
    count = 0
    tilts = len(lattice.tilts)
    for e in range(len(elements.points)):
        point, normal = elements.points[e], elements.normals[e]
        if not is_facing(optics, camera, point, normal, elements.cosines[e]):
            continue
        dx, dy, dz = point[0] - camera[0], point[1] - camera[1], point[2] - camera[2]
        shown = np.uint64(0)
        for h in range(len(lattice.headings)):
            east, north = lattice.headings[h, 0], lattice.headings[h, 1]
            ahead, left = dx * east + dy * north, dy * east - dx * north
            for t in range(tilts):
                level, down = lattice.tilts[t, 0], lattice.tilts[t, 1]
                depth, above = ahead * level - dz * down, ahead * down + dz * level
                if (
                    depth > 0.0
                    and abs(left) <= optics.across * depth
                    and abs(above) <= optics.upright * depth
                ):
                    shown |= np.uint64(1) << np.uint64(h * tilts + t)
        if shown == np.uint64(0) or not is_open(scene, camera, point, normal):
            continue
        which[count], bits[count] = e, shown
        count += 1
    return count


@njit(cache=True, nogil=True)
def _way(score, dx, dy, dz):
    """Steps to come near a point so far away, were the water free."""
    over = math.sqrt(dx * dx + dy * dy)
    return max(over - score.near, 0.0) / score.stride + max(abs(dz) - score.near, 0.0) / score.climb


@njit(cache=True, nogil=True)
def _left(elements, seen, mass):
    """Write the weight that is left of each part."""
    mass[:] = 0.0
    for e in range(len(elements.weights)):
        if not is_in(seen, e):
            mass[elements.part_of[e]] += elements.weights[e]


@njit(cache=True, nogil=True)
def _tree(between, mass, slight):
    """Steps along the shortest tree over the parts of which more than a slight weight is left."""
    parts = len(mass)
    nearest = np.full(parts, FAR)
    todo = np.zeros(parts, np.bool_)
    count = 0
    for p in range(parts):
        if mass[p] > slight:
            todo[p] = True
            count += 1
    if count < 2:
        return 0.0
    at, total = -1, 0.0
    for p in range(parts):
        if todo[p]:
            at = p
            break
    for _ in range(count - 1):
        todo[at] = False
        best, least = -1, FAR
        for p in range(parts):
            if todo[p]:
                nearest[p] = min(nearest[p], between[at, p])
                if nearest[p] < least:
                    best, least = p, nearest[p]
        total += least
        at = best
    return total


@njit(cache=True, nogil=True)
def _away(elements, score, mass, camera):
    """Steps to the nearest part of which something is left; 0 where none is."""
    least = FAR
    for p in range(len(mass)):
        if mass[p] > score.slight:
            part = elements.parts[p]
            least = min(least, _way(score, part[0] - camera[0], part[1] - camera[1], part[2] - camera[2]))
    return 0.0 if least == FAR else least


@njit(cache=True, nogil=True)
def put_at(lattice, level, row, col, camera):
    """Write the position (3,) of a node, metres in the world."""
    camera[0] = lattice.first[0] + col * lattice.spacing
    camera[1] = lattice.first[1] + row * lattice.spacing
    camera[2] = lattice.first[2] + level * lattice.spacing


# One loop: what it keeps from level to level would be a dozen arguments of any part of it.
@njit(cache=True, nogil=True)
def beam(scene, optics, lattice, moves, elements, score, start, heading, tilt, width, horizon):
    """The best sequences of actions, level by level.

    Sequences of a level differ in heading or in their place, taken to cubes of two nodes. All moves lead
    through water that is known to be free.

    Args:
        scene: The voxels around.
        optics: Camera and reach.
        lattice: Where the body may be.
        moves: See `ways.SpaceMoves`.
        elements: What is left to look at.
        score: By which sequences are compared.
        start: (3,) int64 level, row and column of where the vehicle is.
        heading: Where it looks.
        tilt: Of its camera.
        width: Sequences to keep at each level.
        horizon: Levels at most.

    Returns:
        `SpaceSequences`.
    """
    levels, rows, cols = lattice.stands.shape
    headings, tilts, count = len(lattice.headings), len(lattice.tilts), len(elements.weights)
    words = (count + 63) // 64
    advances = moves.offsets.shape[1]
    branches = len(moves.turns) * advances * len(moves.climbs) * tilts
    most = 1 + width * horizon
    node, parent = np.zeros((most, 3), np.int64), np.full(most, -1, np.int64)
    yaw, pitch, level = np.zeros(most, np.int64), np.zeros(most, np.int64), np.zeros(most, np.int64)
    total, value = np.zeros(most), np.zeros(most)
    seen = np.zeros((most, words), np.uint64)
    node[0], yaw[0], pitch[0] = start, heading, tilt
    parts = len(elements.parts)
    between = np.zeros((parts, parts))
    for p in range(parts):
        for q in range(parts):
            d = elements.parts[p] - elements.parts[q]
            # From where one is seen well a part of the other is seen already.
            between[p, q] = _way(score, d[0], d[1], d[2])
    mass, camera, gains = np.zeros(parts), np.empty(3), np.empty(tilts)
    _left(elements, seen[0], mass)
    put_at(lattice, start[0], start[1], start[2], camera)
    value[0] = -score.step * (_tree(between, mass, score.slight) + _away(elements, score, mass, camera))
    # What shows from a node is found once.
    list_from = np.full(levels * rows * cols, -1, np.int64)
    list_to = np.zeros(levels * rows * cols, np.int64)
    which, bits = np.empty(1 << 14, np.int32), np.empty(1 << 14, np.uint64)
    written = 0
    next_total, next_value = np.empty(width * branches), np.empty(width * branches)
    next_at = np.empty((width * branches, 6), np.int64)
    taken = np.zeros(((levels // 2 + 1) * (rows // 2 + 1) * (cols // 2 + 1)) * headings, np.int32)
    first, past = 0, 1
    for d in range(1, horizon + 1):
        n, factor = 0, score.discount**d
        for k in range(first, past):
            _left(elements, seen[k], mass)
            along = _tree(between, mass, score.slight)
            l0, r0, c0 = node[k]
            for turn in moves.turns:
                to = (yaw[k] + turn + headings) % headings
                for a in range(advances):
                    east, north = moves.offsets[to, a]
                    for up in moves.climbs:
                        l1, r1, c1 = l0 + up, r0 + north, c0 + east
                        if not (0 <= l1 < levels and 0 <= r1 < rows and 0 <= c1 < cols):
                            continue
                        stays = up == 0 and east == 0 and north == 0
                        if not stays:
                            if not lattice.stands[l1, r1, c1]:
                                continue
                            if not passes(
                                lattice.fits,
                                FINE * l0,
                                FINE * r0,
                                FINE * c0,
                                FINE * up,
                                FINE * north,
                                FINE * east,
                            ):
                                continue
                        place = (l1 * rows + r1) * cols + c1
                        put_at(lattice, l1, r1, c1, camera)
                        if list_from[place] < 0:
                            if written + count > len(which):
                                more = max(2 * len(which), written + count)
                                which, bits = grown(which, more), grown(bits, more)
                            list_from[place] = written
                            written += seen_from(
                                scene, optics, lattice, elements, camera, which[written:], bits[written:]
                            )
                            list_to[place] = written
                        gains[:] = 0.0
                        for i in range(list_from[place], list_to[place]):
                            shown = (bits[i] >> np.uint64(to * tilts)) & np.uint64((1 << tilts) - 1)
                            if shown == np.uint64(0) or is_in(seen[k], which[i]):
                                continue
                            for t in range(tilts):
                                if (shown >> np.uint64(t)) & np.uint64(1):
                                    gains[t] += elements.weights[which[i]]
                        away = _away(elements, score, mass, camera)
                        for t in range(tilts):
                            if stays and turn == 0 and t == pitch[k]:
                                continue
                            next_total[n] = total[k] + factor * gains[t]
                            next_value[n] = next_total[n] - score.step * (away + along)
                            next_at[n] = k, l1, r1, c1, to, t
                            n += 1
        if n == 0:
            break
        first = past
        for i in np.argsort(-np.round(next_value[:n], 6), kind="mergesort"):
            k, l1, r1, c1, to, t = next_at[i]
            cube = ((l1 // 2 * (rows // 2 + 1) + r1 // 2) * (cols // 2 + 1) + c1 // 2) * headings + to
            if taken[cube] == d:
                continue
            taken[cube] = d
            node[past] = l1, r1, c1
            yaw[past], pitch[past], parent[past], level[past] = to, t, k, d
            total[past], seen[past] = next_total[i], seen[k]
            place = (l1 * rows + r1) * cols + c1
            for j in range(list_from[place], list_to[place]):
                if (bits[j] >> np.uint64(to * tilts + t)) & np.uint64(1):
                    seen[past, which[j] >> 6] |= np.uint64(1) << np.uint64(which[j] & 63)
            _left(elements, seen[past], mass)
            put_at(lattice, l1, r1, c1, camera)
            value[past] = total[past] - score.step * (
                _tree(between, mass, score.slight) + _away(elements, score, mass, camera)
            )
            past += 1
            if past - first == width:
                break
    return SpaceSequences(
        node[:past], yaw[:past], pitch[:past], parent[:past], level[:past], total[:past], value[:past]
    )


@njit(cache=True, nogil=True)
def openness(scene, lattice, elements, reach, directions):
    """(E,) from which share of the water within reach each element can be seen at a useful angle.

    Water is where the body fits for all that is known; the share is of half a ball.

    Args:
        scene: The voxels around.
        lattice: Where the body may be.
        elements: Seen a voxel before the surface, as everywhere.
        reach: Metres.
        directions: (D, 3) of length 1, evenly over the sphere.
    """
    result = np.zeros(len(elements.weights))
    levels, rows, cols = lattice.fits.shape
    fine = lattice.spacing / FINE
    step = 2.0 * scene.side
    count = int(reach / step)
    whole = 0.0
    for k in range(1, count + 1):
        whole += (k * step) ** 2
    whole *= 0.5 * len(directions)
    for e in range(len(result)):
        at = elements.points[e] + scene.side * elements.normals[e]
        total = 0.0
        for d in range(len(directions)):
            way = directions[d]
            normal = elements.normals[e]
            if way[0] * normal[0] + way[1] * normal[1] + way[2] * normal[2] < elements.cosines[e]:
                continue
            for k in range(1, 2 * count + 1):
                x, y, z = (
                    at[0] + 0.5 * k * step * way[0],
                    at[1] + 0.5 * k * step * way[1],
                    at[2] + 0.5 * k * step * way[2],
                )
                i = math.floor(z / scene.side) - scene.first[0]
                j = math.floor(y / scene.side) - scene.first[1]
                m = math.floor(x / scene.side) - scene.first[2]
                if not (
                    0 <= i < scene.states.shape[0]
                    and 0 <= j < scene.states.shape[1]
                    and 0 <= m < scene.states.shape[2]
                ):
                    break
                if scene.states[i, j, m] == SOLID:
                    break
                if k % 2:
                    continue
                i = round((z - lattice.first[2]) / fine)
                j = round((y - lattice.first[1]) / fine)
                m = round((x - lattice.first[0]) / fine)
                if 0 <= i < levels and 0 <= j < rows and 0 <= m < cols and lattice.fits[i, j, m]:
                    total += (0.5 * k * step) ** 2
        result[e] = total / whole
    return result


@njit(cache=True, nogil=True)
def best_views(scene, optics, lattice, elements, nodes):
    """What the best look from each node (n, 3) shows: (n,) weight, heading and tilt."""
    count, tilts = len(elements.weights), len(lattice.tilts)
    which, bits = np.empty(count, np.int32), np.empty(count, np.uint64)
    weight = np.zeros(len(nodes))
    heading, tilt = np.zeros(len(nodes), np.int64), np.zeros(len(nodes), np.int64)
    camera, sums = np.empty(3), np.empty(len(lattice.headings) * tilts)
    for n in range(len(nodes)):
        put_at(lattice, nodes[n, 0], nodes[n, 1], nodes[n, 2], camera)
        sums[:] = 0.0
        for k in range(seen_from(scene, optics, lattice, elements, camera, which, bits)):
            for b in range(len(sums)):
                if (bits[k] >> np.uint64(b)) & np.uint64(1):
                    sums[b] += elements.weights[which[k]]
        best = sums.argmax()
        weight[n], heading[n], tilt[n] = sums[best], best // tilts, best % tilts
    return weight, heading, tilt
