"""The handful of surface points that stand for an individual."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.sim import _kernels as sight
from dream.sim.inspection import _kernels
from dream.sim.solids import index_of
from dream.sim.visibility import triangles_of
from dream.sim.world import World

Float64Array = npt.NDArray[np.float64]
IntpArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]

POINTS = 10
"""Points of an individual, or fewer where less of it is open."""
PLACES = 20
"""Places on an individual that its points are chosen from, evenly over its area."""
UP = 0.3
"""A clump's points lie on faces whose normal has at least this upward part."""
OPEN = 0.5
"""Metres around a place that are looked at to tell whether something covers it."""
WAYS = 7
"""Ways out of a place: along its normal, and six around that at 45°."""
FREE_WAYS = 2
"""So many of them must be free, or the place is covered."""
CLUMP_CELL = 0.1
"""Metres a side of the index of clumps: a cell is as wide as a shell."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """Points on the surface of N individuals, one individual after the other."""

    points: Float64Array
    """(M, 3) metres in the world."""
    normals: Float64Array
    """(M, 3) of length 1, outwards."""
    owner: IntpArray
    """(M,) the individual that a point is of."""
    first: IntpArray
    """(N + 1,) individual i has the points first[i] to first[i + 1]: one at least."""
    two_sided: BoolArray
    """(N,) whether either side of it counts."""
    area: Float64Array
    """(N,) m² of the surface above ground, one side of it."""


def sight_index(world: World) -> sight.Index:
    """The clumps of a world: they hide what is behind them, and stop nobody. The terrain is not in it."""
    triangles, first = triangles_of(world.meshes, world.targets)
    triangles = triangles[np.repeat(~world.hull, np.diff(first))]
    places = triangles.reshape(-1, 3)[:, :2] if len(triangles) else np.zeros((1, 2))
    index = index_of(world.terrain, triangles, places.min(axis=0), places.max(axis=0), CLUMP_CELL)
    return index._replace(ground_top=np.full_like(index.ground_top, -np.inf))


def surface_of(world: World, solids: sight.Index, clumps: sight.Index) -> SurfacePoints:
    """Points of all individuals, the same ones each time.

    They lie on the triangles themselves, above ground, and on a clump on faces that look up: of places that
    are even over the area, each the farthest from those before. A place that
    something covers, be it the individual itself, bears none: to be open, two of seven ways out of it (along
    the normal and at 45° to it) must be free for half a metre. A two-sided surface is open on either side.
    An individual that is covered or buried all over keeps its points where they are. Since a point counts by
    its own normal, one that bends around itself, as a mast does, counts by the side that shows.
    """
    triangles, first = triangles_of(world.meshes, world.targets)
    triangles, first = sight.unburied(solids, triangles, first)
    two_sided = np.array([mesh.two_sided for mesh in world.meshes], np.bool_)[world.targets.mesh]
    count = len(two_sided)
    normals = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    # A triangle without area may be all that an individual has.
    areas = np.maximum(np.linalg.norm(normals, axis=1), 1e-12)
    normals /= areas[:, None]
    owner = np.repeat(np.arange(count), np.diff(first))
    bears = world.hull[owner] | (normals[:, 2] >= UP)
    bears |= ~np.bincount(owner, bears, count).astype(np.bool_)[owner]
    places, facing = _places(triangles, first, np.where(bears, areas, 0.0), normals)

    at, out = places.reshape(-1, 3), facing.reshape(-1, 3)
    free = _kernels.are_open(solids, clumps, at, _ways(out), OPEN, FREE_WAYS)
    back = np.flatnonzero(~free & np.repeat(two_sided, PLACES))
    free[back] = _kernels.are_open(solids, clumps, at[back], _ways(-out[back]), OPEN, FREE_WAYS)
    open_places = free.reshape(count, PLACES)
    covered = ~open_places.any(axis=1)
    open_places[covered] = True

    chosen = _spread(places, open_places)
    begins = np.concatenate([[0], np.cumsum(chosen.sum(axis=1))])
    return SurfacePoints(
        points=places[chosen],
        normals=facing[chosen],
        owner=np.nonzero(chosen)[0],
        first=begins.astype(np.intp),
        two_sided=two_sided,
        area=np.bincount(owner, areas, count).astype(np.float64),
    )


def _places(
    triangles: Float64Array, first: IntpArray, weights: Float64Array, normals: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """(N, PLACES, 3) places on each individual, evenly by the weights of its triangles, and their normals."""
    total = np.concatenate([[0.0], np.cumsum(weights)])
    begin, end = total[first[:-1], None], total[first[1:], None]
    along = (np.arange(PLACES) + 0.5) / PLACES
    which = np.searchsorted(total, begin + along * (end - begin), side="right") - 1
    which = np.clip(which, first[:-1, None], first[1:, None] - 1)
    # Two coordinates that fill a square evenly (the sequence R2 of Roberts, 2018), folded into a triangle.
    k = np.arange(1, PLACES + 1)
    r, s = np.sqrt((0.5 + 0.7548776662466927 * k) % 1.0), (0.5 + 0.5698402909980532 * k) % 1.0
    corner = triangles[which]
    parts = np.stack([1.0 - r, r * (1.0 - s), r * s], axis=-1)
    return (parts[..., None] * corner).sum(axis=-2), normals[which]


def _ways(normals: Float64Array) -> Float64Array:
    """(C, WAYS, 3) the normals (C, 3), and six directions around each at 45°."""
    east = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    east /= np.maximum(np.linalg.norm(east, axis=1, keepdims=True), 1e-12)
    north = np.cross(normals, east)
    turn = 2.0 * math.pi * np.arange(WAYS - 1) / (WAYS - 1)
    around = np.cos(turn)[:, None] * east[:, None] + np.sin(turn)[:, None] * north[:, None]
    return np.concatenate([normals[:, None], math.sqrt(0.5) * (normals[:, None] + around)], axis=1)


def _spread(places: Float64Array, free: BoolArray) -> BoolArray:
    """(N, PLACES) at most POINTS of the free places of each row, each the farthest from those before it."""
    each = np.arange(len(places))
    chosen = np.zeros_like(free)
    gap = np.where(free, np.inf, -1.0)
    for _ in range(POINTS):
        following = gap.argmax(axis=1)
        chosen[each, following] |= gap[each, following] > 0.0
        away = np.linalg.norm(places - places[each, following, None], axis=2)
        gap = np.minimum(gap, away)
    return chosen
