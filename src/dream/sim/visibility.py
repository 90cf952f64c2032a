"""Which individuals a pose sees: the geometry that scoring, simulator and oracle share."""

from __future__ import annotations

import math
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from dream import traversal
from dream.geometry import wrap_angle
from dream.protocol import SurveyProtocol
from dream.sim import _kernels
from dream.sim.solids import FreeLattice, Solids, checked, corners
from dream.sim.world import Instances, Mesh, World

Float64Array = npt.NDArray[np.float64]
IntpArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]

STANDOFF = 0.03
"""Metres between a patch of hull and the point that stands for it, so that the patch does not hide it."""
FACING = 0.5
"""A patch whose mean normal is shorter than this (1 for a plane) bends around itself, as a mast does."""
OPEN = 0.5
"""Metres in front of a patch that a frame, a pipe or another plate covers when it is nearer."""
CELL = 1.0
"""Metres a side of the ground cells that the points are sorted into."""


def triangles_of(meshes: tuple[Mesh, ...], instances: Instances) -> tuple[Float64Array, IntpArray]:
    """Corners (T, 3, 3) of all instances, one after the other, and where each begins (N + 1,)."""
    parts: list[Float64Array] = [np.empty((0, 3, 3))] * len(instances)
    for mesh in np.unique(instances.mesh):
        which = np.flatnonzero(instances.mesh == mesh)
        for i, placed in zip(which, corners(meshes[mesh], instances, which), strict=True):
            parts[i] = placed
    first = np.cumsum([0, *map(len, parts)], dtype=np.intp)
    return np.concatenate([np.empty((0, 3, 3)), *parts]), first


def top_points(triangles: Float64Array, first: IntpArray) -> Float64Array:
    """(N, 3) the highest vertex of each clump, of the triangles first[i] to first[i + 1]."""
    vertices = triangles.reshape(-1, 3)
    tops = [3 * a + vertices[3 * a : 3 * b, 2].argmax() for a, b in pairwise(first)]
    return vertices[np.array(tops, np.intp)]


def hull_points(
    triangles: Float64Array, first: IntpArray, two_sided: BoolArray, solids: Solids
) -> tuple[Float64Array, IntpArray]:
    """The points (M, 3) that stand for patches of hull, and whose they are (M,): seen when one of them is.

    A point lies 3 cm beyond where a line through the patch's area-weighted centroid along its mean normal
    leaves the patch. (3 cm from the centroid itself would be inside the hull where the patch is bent over an
    edge.) Where a frame or a pipe covers that, the nearest triangle of the patch that is open for half a
    metre lends its own middle. A two-sided patch has a point on either side; one that bends around itself has
    six, along the axes of the world. Of a patch that is partly in the ground only the rest is looked at.

    Args:
        triangles: (T, 3, 3) corners in the world.
        first: (N + 1,) patch i holds the triangles first[i] to first[i + 1].
        two_sided: (N,).
        solids: What may cover a patch.
    """
    triangles, first = _kernels.unburied(solids.index, triangles, first)
    normals = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    begin = first[:-1]
    # A patch without area keeps a point somewhere: its triangles are all the same place.
    areas = np.maximum(areas, 1e-12)
    total = np.add.reduceat(areas, begin)[:, None]
    centroids = np.add.reduceat(areas[:, None] * triangles.mean(axis=1), begin) / total
    mean = np.add.reduceat(normals, begin) / total
    length = np.linalg.norm(mean, axis=1)

    bent = length < FACING
    unit = mean / np.where(bent, 1.0, length)[:, None]
    each = np.arange(len(begin))
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    owner = np.concatenate([each[~bent], each[~bent & two_sided], np.repeat(each[bent], 6)])
    directions = np.concatenate([unit[~bent], -unit[~bent & two_sided], np.tile(axes, (int(bent.sum()), 1))])
    order = np.argsort(owner, kind="stable")
    owner, directions = owner[order], directions[order]
    points = _kernels.open_points(
        solids.index, triangles, first, owner, centroids[owner], directions, STANDOFF, OPEN
    )
    return points, owner


def _points(world: World, solids: Solids) -> tuple[Float64Array, IntpArray]:
    """The points (M, 3) of all individuals and whose they are (M,), individual after individual."""
    clumps, patches = np.flatnonzero(~world.hull), np.flatnonzero(world.hull)
    points, owner = top_points(*triangles_of(world.meshes, world.targets.chosen(~world.hull))), clumps
    if len(patches):
        hull = world.targets.chosen(world.hull)
        two_sided = np.array([mesh.two_sided for mesh in world.meshes])[hull.mesh]
        of_hull, patch = hull_points(*triangles_of(world.meshes, hull), two_sided, solids)
        points, owner = np.concatenate([points, of_hull]), np.concatenate([clumps, patches[patch]])
    order = np.argsort(owner, kind="stable")
    return points[order], owner[order]


class Visibility:
    """Which individuals of a world are seen from where, under a protocol.

    What it does: an individual is seen when a point of it lies within `reach` over ground, projects into the
    image at a valid depth, and has a clear line of sight past terrain, boulders and hull; other clumps do
    not hide it. The point of a clump of shells is its highest vertex; for a patch of hull see `hull_points`.
    Where the protocol has a `traversal`, an individual is seen instead when its point lies that near over
    ground, and under the body or in the sector between the left and the right edge of the image; nothing
    hides it.
    Assumes: the vehicle is level and keeps its altitude above the terrain. The camera sits at its centre.
    Fails when: a pose lies inside something solid. It then sees what that hides; ask `Solids.free` first.
    """

    def __init__(self, world: World, protocol: SurveyProtocol, solids: Solids | None = None) -> None:
        self.protocol = protocol
        self.solids = solids or Solids(world)
        points, owner = _points(world, self.solids)
        self.points: Float64Array = points[np.searchsorted(owner, np.arange(len(world.targets)))]
        """(N, 3) metres in the world: the point of each individual, the first one where it has several."""

        # All points, sorted into cells of the ground.
        low = points[:, :2].min(axis=0, initial=np.inf) if len(points) else np.zeros(2)
        cols, rows = (
            (np.floor(np.ptp(points[:, :2], axis=0) / CELL).astype(int) + 1) if len(points) else (1, 1)
        )
        self._cells = (float(low[0]), float(low[1]), CELL, int(rows), int(cols))
        self._cell_first, order = _kernels.bin_boxes(
            np.ascontiguousarray(points[:, [0, 1, 0, 1]]), *self._cells[:3], *self._cells[3:]
        )
        self._points = np.ascontiguousarray(points[order])
        self._owner = owner[order]

    def __len__(self) -> int:
        return len(self.points)

    def seen(self, poses: npt.ArrayLike) -> BoolArray:
        """Which individuals does each pose see?

        Args:
            poses: (P, 3) x, y and yaw of the vehicle, metres and radians in the world.

        Returns:
            (P, N) bool.

        Raises:
            ValueError: The shape is wrong or a pose is not finite.
        """
        where = checked(poses, "poses", 3)
        if self.protocol.traversal is not None:
            columns = [traversed(point, where, self.protocol) for point in self.points]
            return np.stack([np.zeros(len(where), np.bool_), *columns], axis=1)[:, 1:]
        return _kernels.seen(
            self.solids.index,
            self._sensor,
            self._points,
            self._owner,
            len(self),
            self._cell_first,
            self._cells,
            where,
        )

    @cached_property
    def lattice(self) -> FreeLattice:
        """Where the vehicle can be."""
        return self.solids.lattice(self.protocol)

    @cached_property
    def countable(self) -> BoolArray:
        """(N,) bool: the individuals that some reachable pose of the lattice sees. Only they count.

        Reachable, not merely free: the hold of a wreck may hold a vehicle, but none gets there.
        """
        yaws = lattice_yaws(self.protocol)
        lattice = self.lattice
        if self.protocol.traversal is not None:
            nodes = lattice.positions[lattice.reachable]
            counts = np.zeros(len(self), np.bool_)
            for i, point in enumerate(self.points):
                near = nodes[np.hypot(*(nodes - point[:2]).T) <= self.protocol.traversal]
                poses = np.column_stack([np.repeat(near, len(yaws), axis=0), np.tile(yaws, len(near))])
                counts[i] = traversed(point, poses, self.protocol).any()
            return counts
        span = math.ceil(self.protocol.reach / lattice.spacing) + 1
        offsets = np.stack(np.meshgrid(*[np.arange(-span, span + 1)] * 2), axis=-1).reshape(-1, 2)
        nearest_first = offsets[np.argsort((offsets**2).sum(axis=1), kind="stable")]
        return _kernels.seen_from_lattice(
            self.solids.index,
            self._sensor,
            self._points,
            self._owner,
            len(self),
            lattice.reachable,
            float(lattice.first[0]),
            float(lattice.first[1]),
            lattice.spacing,
            nearest_first.astype(np.intp),
            # As `seen` takes them: another library's cosine may differ in the last bit.
            np.array([(math.cos(yaw), math.sin(yaw)) for yaw in yaws]),
        )

    @property
    def _sensor(self) -> _kernels.Sensor:
        protocol, camera = self.protocol, self.protocol.camera
        return _kernels.Sensor(
            rotation=np.ascontiguousarray(protocol.T_base_camera.rotation, dtype=np.float64),
            fx=float(camera.fx),
            fy=float(camera.fy),
            cx=float(camera.cx),
            cy=float(camera.cy),
            width=float(camera.width),
            height=float(camera.height),
            min_depth=float(protocol.min_depth),
            max_depth=float(protocol.max_depth),
            reach=float(protocol.reach),
            altitude=float(protocol.altitude),
        )


def lattice_yaws(protocol: SurveyProtocol) -> Float64Array:
    """(headings,) radians in (−π, π]: the very numbers that a vehicle on the lattice has for its yaw."""
    return np.array([wrap_angle(k * protocol.heading_step) for k in range(protocol.headings)])


def traversed(point: Float64Array, poses: Float64Array, protocol: SurveyProtocol) -> BoolArray:
    """(P,) bool: did the point (3,) pass under the body, or ahead of it within `traversal` over ground?"""
    return traversal.traversed(point[0] - poses[:, 0], point[1] - poses[:, 1], poses[:, 2], protocol)
