"""Which way the faces of meshes look, and which have to be turned to look outwards.

Neighbours that run along their edge the same way contradict each other: one of them is turned. What is closed
has its faces outwards where its signed volume is positive; see Zhang and Chen, Efficient feature extraction
for 2D/3D objects in mesh representation, ICIP 2001. A cavity, inside something else, looks into itself, and a
room around the vehicle looks at the vehicle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.sim.sampling import MILLIMETRE
from dream.sim.validity import is_near
from dream.sim.world import Mesh

Float64Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
Standing = Callable[[int, npt.NDArray[np.float32], npt.NDArray[np.float32]], Float64Array]
"""Of a mesh by its number: (N, 3) starts in its frame, within a box from low (3,) to high (3,)."""

FLAT = 0.5
"""Length of the sum of all faces' areas as vectors, as a share of their sum as numbers: 0 of what is closed,
1 of a plate, a half of a hemisphere. Below it an open mesh is a body with a hole."""
ASKED = 24
"""About so many corners of a part, or starts in its box, are asked whether they lie inside."""


@dataclass(frozen=True, slots=True)
class Turned:
    """What is known of some meshes."""

    flips: list[BoolArray]
    """Of each mesh, (F,) the faces that have to be turned."""
    endless: list[int]
    """Meshes that have but one side, as a Möbius strip has."""
    open_ones: list[int]
    """One-sided meshes with a part that is open and does not show where outside is."""
    rooms: list[int]
    """Meshes with a part that looks inwards and is left so: a start lies in it."""
    loose: list[BoolArray]
    """Of each mesh, (F,) the faces of parts that are open: an edge has nothing on its other side."""


def turned(meshes: Sequence[Mesh], standing: Standing | None = None) -> Turned:
    """Find the faces that have to be turned: none of a two-sided mesh, and of others each part for itself.

    A part that is open is made consistent. Which way it looks is decided only where it is a body whose hole
    is at its foot, such as a rock without its bottom; a plate, or a basin that is open above, may be meant
    either way. What looks inwards around a start is left as it is.
    """
    flips = [np.zeros(len(mesh.faces), np.bool_) for mesh in meshes]
    loose = [np.zeros(len(mesh.faces), np.bool_) for mesh in meshes]
    which = [k for k, mesh in enumerate(meshes) if not mesh.two_sided and is_near(mesh)]
    if not which:
        return Turned(flips, [], [], [], loose)
    points, corners, owner, place = _joined([meshes[k] for k in which])
    parts = _parts(corners)
    decided, undecided, meant = _outwards(points, corners, owner, parts)
    inner = np.zeros(len(decided), np.bool_)
    if standing is not None:
        order = np.argsort(parts.of, kind="stable")
        begins = np.searchsorted(parts.of[order], np.arange(len(decided) + 1))
        places: dict[int, Float64Array] = {}
        for part in map(int, np.flatnonzero(decided != meant)):
            mine = order[begins[part] : begins[part + 1]]
            number = which[owner[mine[0]]]
            if number not in places:
                vertices = meshes[number].vertices
                places[number] = standing(number, vertices.min(axis=0), vertices.max(axis=0))
            inner[part] = _around(points[corners[mine]], parts.turn[mine], places[number])
        decided = np.where(inner, meant, decided)
    turn = parts.turn ^ decided[parts.of]
    of_open = (np.bincount(parts.of, parts.loose.any(axis=1), len(decided)) > 0)[parts.of]
    for k, mesh_number in enumerate(which):
        mine = owner == k
        flips[mesh_number][place[mine]] = turn[mine]
        loose[mesh_number][place[mine]] = of_open[mine]
    endless = {which[k] for k in np.unique(owner[parts.endless[parts.of]])}
    unknown = {which[k] for k in np.unique(owner[undecided[parts.of]])}
    rooms = {which[k] for k in np.unique(owner[inner[parts.of]])}
    return Turned(flips, sorted(endless), sorted(unknown - endless), sorted(rooms), loose)


def _joined(meshes: Sequence[Mesh]) -> tuple[Float64Array, IntArray, IntArray, IntArray]:
    """All meshes as one, whose vertices at the same millimetre are the same.

    Returns:
        (V, 3) metres; (K, 3) corners, without faces that have two the same; (K,) the mesh of each face; (K,)
        its number there.
    """
    vertices = np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float64)
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    of_vertex = np.repeat(np.arange(len(meshes)), np.diff(first))
    rounded = np.column_stack([of_vertex, np.rint(vertices * MILLIMETRE).astype(np.int64)])
    _, kept, same = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    corners = np.concatenate(
        [mesh.faces.astype(np.int64) + at for mesh, at in zip(meshes, first, strict=False)]
    )
    corners = same.reshape(-1)[corners]
    owner = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])
    place = np.concatenate([np.arange(len(mesh.faces)) for mesh in meshes])
    a, b, c = corners.T
    whole = (a != b) & (b != c) & (c != a)
    return vertices[kept], corners[whole], owner[whole], place[whole]


@dataclass(frozen=True, slots=True)
class _Parts:
    """Faces that hang together by edges which two of them share."""

    of: IntArray
    """(K,) the part of each face."""
    turn: BoolArray
    """(K,) faces that have to be turned so that all of a part look the same way, whichever that is."""
    endless: BoolArray
    """(P,) parts in which no turning does it."""
    loose: BoolArray
    """(K, 3) edges that no other face of the part has, from corner to next corner."""


def _parts(corners: IntArray) -> _Parts:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = len(corners)
    begin, end = corners.ravel(), corners[:, [1, 2, 0]].ravel()
    ahead = begin < end
    name = np.where(ahead, begin, end) * (corners.max(initial=0) + 1) + np.where(ahead, end, begin)
    order = np.argsort(name, kind="stable")
    _, at, shared = np.unique(name[order], return_index=True, return_counts=True)
    pairs = at[shared == 2]
    one, other = order[pairs], order[pairs + 1]
    against = ahead[one] == ahead[other]
    i, j = one // 3, other // 3
    # Each face stands there twice, as it is and turned; what contradicts is joined crosswise.
    links = (np.concatenate([i, i + count]), np.concatenate([j + count * against, j + count * ~against]))
    _, label = connected_components(
        coo_matrix((np.ones(2 * len(i), np.int8), links), (2 * count,) * 2), directed=False
    )
    as_is, over = label[:count], label[count:]
    least = np.minimum(as_is, over)
    _, of = np.unique(least, return_inverse=True)
    of = of.reshape(-1).astype(np.int64)
    parts = int(of.max(initial=-1)) + 1
    endless = np.zeros(parts, np.bool_)
    endless[of[as_is == over]] = True
    # An edge that more than two share: it is loose in a part that has it once.
    own = np.column_stack([of.repeat(3), name])
    _, index, times = np.unique(own, axis=0, return_inverse=True, return_counts=True)
    loose = times[index.reshape(-1)] % 2 == 1
    return _Parts(of, (as_is != least) & ~endless[of], endless, loose.reshape(-1, 3))


def _outwards(
    points: Float64Array, corners: IntArray, owner: IntArray, parts: _Parts
) -> tuple[BoolArray, BoolArray, BoolArray]:
    """(P,) parts that have to be turned whole, once consistent; those of which nobody knows; and those
    that would have to be, if as they are for the most part was as they were meant."""
    of, number = parts.of, len(parts.endless)
    sign = np.where(parts.turn, -1.0, 1.0)
    a, b, c = (points[corners[:, side]] for side in range(3))
    # About the middle of its loose edges, or else of its corners: then a hole counts as closed by a fan.
    weight = np.where(
        parts.loose, np.sqrt(np.square(np.roll((a, b, c), -1, axis=0) - (a, b, c)).sum(-1)).T, 0.0
    )
    weight[~(np.bincount(of, weight.sum(axis=1), number) > 0.0)[of]] = 1.0
    total = np.bincount(of, weight.sum(axis=1), number)
    edges = 0.5 * (np.stack([a, b, c], 1) + np.stack([b, c, a], 1))
    middle = np.stack(
        [np.bincount(of, (weight * edges[..., axis]).sum(axis=1), number) / total for axis in range(3)],
        axis=1,
    )
    a, b, c = a - middle[of], b - middle[of], c - middle[of]
    across = 0.5 * np.cross(b - a, c - a)
    area = np.sqrt(np.square(across).sum(axis=1))
    volume = np.bincount(of, sign * (a * np.cross(b, c)).sum(axis=1) / 6.0, number)
    whole_area = np.bincount(of, area, number)
    net = np.stack([np.bincount(of, sign * across[:, axis], number) for axis in range(3)], axis=1)
    is_open = np.bincount(of, parts.loose.any(axis=1), number) > 0
    body = np.sqrt(np.square(net).sum(axis=1)) < FLAT * whole_area
    low = np.full(number, np.inf)
    high = np.full(number, -np.inf)
    np.minimum.at(low, of, points[corners, 2].min(axis=1))
    np.maximum.at(high, of, points[corners, 2].max(axis=1))
    hole_below = middle[:, 2] < low + 0.25 * (high - low)
    decided = ~parts.endless & (~is_open | (body & hole_below)) & (np.abs(volume) > 1e-6 * whole_area**1.5)
    # Most of a part, by area, is as it was meant; so is a cavity.
    most_over = np.bincount(of, np.where(parts.turn, area, -area), number) > 0.0
    turn = np.where(decided, volume < 0.0, most_over & ~parts.endless)
    for part in map(int, np.flatnonzero(decided & ~is_open & ((volume < 0.0) != most_over))):
        if _inside_another(part, points, corners, owner, parts, ~is_open):
            turn[part] = most_over[part]
    return turn, is_open & ~decided & ~parts.endless, most_over & ~parts.endless


def _around(faces: Float64Array, over: BoolArray, places: Float64Array) -> bool:
    """Do faces, (F, 3, 3) with (F,) which run the other way, go round any of the places, (N, 3)?"""
    low, high = faces.min(axis=(0, 1)), faces.max(axis=(0, 1))
    places = places[((low <= places) & (places <= high)).all(axis=1)]
    sign = np.where(over, -1.0, 1.0)
    return any(
        abs(float((sign * _solid_angles(faces - place)).sum())) > 2.0 * math.pi
        for place in places[:: 1 + len(places) // ASKED]
    )


def _solid_angles(faces: Float64Array) -> Float64Array:
    """(F,) steradians of (F, 3, 3) triangles seen from the origin, with the sign of how they run.

    Van Oosterom and Strackee, The solid angle of a plane triangle, IEEE TBME 30(2), 1983.
    """
    a, b, c = faces[:, 0], faces[:, 1], faces[:, 2]
    la, lb, lc = (np.sqrt(np.square(side).sum(axis=1)) for side in (a, b, c))
    above = (a * np.cross(b, c)).sum(axis=1)
    below = la * lb * lc
    below += (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    return np.asarray(2.0 * np.arctan2(above, below))


def _inside_another(
    part: int, points: Float64Array, corners: IntArray, owner: IntArray, parts: _Parts, closed: BoolArray
) -> bool:
    """Does a part lie inside an odd number of others of its mesh that are closed, with all its corners?

    By the solid angles of their faces. Of many corners a few are asked.
    """
    mine = np.flatnonzero(parts.of == part)
    others = (parts.of != part) & closed[parts.of] & (owner == owner[mine[0]])
    sign = np.where(parts.turn[others], -1.0, 1.0)
    for place in points[np.unique(corners[mine])[:: 1 + len(mine) // ASKED]]:
        angles = sign * _solid_angles(points[corners[others]] - place)
        around = np.bincount(parts.of[others], angles, len(closed)) / (4.0 * math.pi)
        if int(np.rint(np.abs(around)).sum()) % 2 == 0:
            return False
    return True
