"""What blocks sight and motion: line of sight, contact and the free lattice, exact on a world's triangles.

Terrain and boulders block, and so do the individuals that are hull (`World.hull`); clumps of shells do not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds
from dream.protocol import SurveyProtocol
from dream.sim import _kernels
from dream.sim.world import Instances, Mesh, Terrain, World

Float64Array = npt.NDArray[np.float64]
IntpArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]

CELL = 0.5
"""Metres a side of the index: a boulder covers a few cells, a ray of the usual reach crosses about twenty."""
PACE = 0.02
"""Metres between the looks of a sweep: between two of them, a body of 0.35 m radius enters what it grazes by
0.15 mm at most."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """How a straight move of the body went."""

    free: float
    """Share of the way before the first contact, 0 to 1; 1 where there was none."""
    clearance: float
    """Least metres between body and solids on the way, at most the limit asked for; ≤ 0 at a contact."""

    @property
    def contact(self) -> bool:
        """Did the body touch anything?"""
        return self.clearance <= 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FreeLattice:
    """A protocol's positions inside the bounds; node (row, col) lies at `(first + (col, row)) · spacing`."""

    first: tuple[int, int]
    """(col, row) of the lower-left node, counted from the origin of the world."""
    spacing: float
    free: BoolArray
    """(rows, cols) the body is not in contact there."""
    reachable: BoolArray
    """(rows, cols) the protocol's moves lead there from a start of the world without contact. A free node
    that is not, such as one inside a closed hull, is no place to look from."""

    @property
    def positions(self) -> Float64Array:
        """(rows, cols, 2) x and y of the nodes, metres in the world."""
        rows, cols = self.free.shape
        col, row = np.meshgrid(np.arange(cols), np.arange(rows))
        return np.stack([self.first[0] + col, self.first[1] + row], axis=-1).astype(np.float64) * self.spacing


@dataclass(frozen=True, slots=True, eq=False)
class FreeSpace:
    """A protocol's positions in space: node (level, row, col) at `(first + (col, row, level)) · spacing`."""

    first: tuple[int, int, int]
    """(col, row, level) of the first node, counted from the origin of the world."""
    spacing: float
    free: BoolArray
    """(levels, rows, cols) the protocol lets the body be there, and it is not in contact."""
    reachable: BoolArray
    """(levels, rows, cols) the protocol's moves lead there from a start of the world without contact."""


def _nodes_in(bounds: Bounds, spacing: float) -> tuple[tuple[int, int], tuple[int, int]]:
    """(col, row) of the first node of a lattice inside the bounds, and how many (cols, rows) there are."""
    # Nudged, so that bounds that are multiples of the spacing up to rounding keep their outermost nodes.
    col0, row0 = math.ceil(bounds.x_min / spacing - 1e-6), math.ceil(bounds.y_min / spacing - 1e-6)
    cols = math.floor(bounds.x_max / spacing + 1e-6) - col0 + 1
    rows = math.floor(bounds.y_max / spacing + 1e-6) - row0 + 1
    return (col0, row0), (cols, rows)


def corners(mesh: Mesh, instances: Instances, which: IntpArray) -> Float64Array:
    """(K, F, 3, 3) corners in the world of the faces of the instances `which`, all of that mesh."""
    w, x, y, z = instances.wxyz[which].astype(np.float64).T
    rotation = np.empty((len(which), 3, 3))
    rotation[:, 0] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=-1)
    rotation[:, 1] = np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=-1)
    rotation[:, 2] = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1)
    placed = instances.scale[which, None, :].astype(np.float64) * mesh.vertices.astype(np.float64)
    placed = placed @ rotation.transpose(0, 2, 1) + instances.position[which, None, :].astype(np.float64)
    return placed[:, mesh.faces]


def _soup(world: World) -> Float64Array:
    """(T, 3, 3) every triangle that blocks, terrain excepted."""
    parts = [np.empty((0, 3, 3))]
    for instances in (world.obstacles, world.targets.chosen(world.hull)):
        parts += [
            corners(world.meshes[mesh], instances, np.flatnonzero(instances.mesh == mesh)).reshape(-1, 3, 3)
            for mesh in np.unique(instances.mesh)
        ]
    return np.concatenate(parts)


def _index(world: World) -> _kernels.Index:
    """All that blocks, under one grid over the terrain and whatever lies beyond it."""
    terrain, triangles = world.terrain, _soup(world)
    rows, cols = terrain.heights.shape
    far = [terrain.x0 + (cols - 1) * terrain.spacing, terrain.y0 + (rows - 1) * terrain.spacing]
    low = np.min([[terrain.x0, terrain.y0], *triangles[..., :2].min(axis=1)], axis=0)
    high = np.max([far, *triangles[..., :2].max(axis=1)], axis=0)
    return index_of(terrain, triangles, low, high, CELL)


def index_of(
    terrain: Terrain, triangles: Float64Array, low: Float64Array, high: Float64Array, cell: float
) -> _kernels.Index:
    """Terrain and triangles (T, 3, 3) under a grid of cells from low (2,) to high (2,) on the ground."""
    heights = terrain.heights.astype(np.float64)
    x0, y0, spacing = terrain.x0, terrain.y0, terrain.spacing
    cols, rows = (math.floor(extent / cell) + 1 for extent in high - low)
    left, near = float(low[0]), float(low[1])

    pad = _kernels.PAD
    least, most = triangles.min(axis=1), triangles.max(axis=1)
    boxes = np.ascontiguousarray(np.concatenate([least[:, :2] - pad, most[:, :2] + pad], axis=1))
    first, members = _kernels.bin_boxes(boxes, left, near, cell, rows, cols)
    cells = np.repeat(np.arange(rows * cols), np.diff(first))
    bottom, top = np.full(rows * cols, np.inf), np.full(rows * cols, -np.inf)
    np.minimum.at(bottom, cells, least[members, 2])
    np.maximum.at(top, cells, most[members, 2])
    return _kernels.Index(
        heights=heights,
        terrain_x0=float(x0),
        terrain_y0=float(y0),
        spacing=float(spacing),
        triangles=triangles,
        first=first,
        members=members,
        spans=np.column_stack([least[members, 2], most[members, 2]]),
        bottom=bottom.reshape(rows, cols),
        top=top.reshape(rows, cols),
        ground_top=_kernels.cell_ground_tops(heights, x0, y0, spacing, left, near, cell, rows, cols),
        x0=left,
        y0=near,
        cell=cell,
    )


def checked(array: npt.ArrayLike, name: str, columns: int) -> Float64Array:
    """The array as (N, columns) float64; a ValueError where it has another shape or is not finite."""
    values = np.ascontiguousarray(array, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] != columns:
        raise ValueError(f"{name}: expected (N, {columns}), got {values.shape}")
    if not np.isfinite(values).all():
        row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
        raise ValueError(f"{name}: expected finite numbers, got {values[row].tolist()} in row {row + 1}")
    return values


def _at_height(positions: Float64Array, z: float) -> Float64Array:
    """(P, 3) of (P, 2)."""
    return np.column_stack([positions, np.full(len(positions), z)])


def _paired(starts: npt.ArrayLike, ends: npt.ArrayLike, columns: int) -> tuple[Float64Array, Float64Array]:
    begin, end = checked(starts, "starts", columns), checked(ends, "ends", columns)
    if begin.shape != end.shape:
        raise ValueError(f"ends: expected {begin.shape} like starts, got {end.shape}")
    return begin, end


class Solids:
    """An index over everything in a world that blocks sight and motion.

    What it does: answers exactly, on the triangles themselves; either side of a triangle blocks.
    Assumes: the body is a level cylinder. Its centre keeps the protocol's altitude above the terrain, except
    where a function takes points or ways in three dimensions. Beyond the terrain nothing blocks.
    Fails when: a body starts inside a closed shell without touching it: free here, although not reachable.
    """

    __slots__ = ("index", "world")

    def __init__(self, world: World) -> None:
        self.world = world
        self.index = _index(world)

    def line_of_sight(self, eye: npt.ArrayLike, points: npt.ArrayLike) -> BoolArray:
        """Which points does the eye see past all that blocks? The last millimetre of a ray is not looked at.

        Args:
            eye: (3,) metres in the world.
            points: (N, 3) metres in the world.

        Returns:
            (N,) bool. A point under the terrain is not seen.

        Raises:
            ValueError: A shape is wrong or a coordinate is not finite.
        """
        start = np.asarray(eye, dtype=np.float64)
        if start.shape != (3,):
            raise ValueError(f"eye: expected (3,), got {start.shape}")
        return _kernels.lines_of_sight(
            self.index, checked(start[None], "eye", 3)[0], checked(points, "points", 3)
        )

    def ranges(
        self, eye: npt.ArrayLike, directions: npt.ArrayLike, *, limit: float
    ) -> tuple[Float64Array, Float64Array]:
        """How far it is to what is first met along each direction, and how squarely it is met.

        Args:
            eye: (3,) metres in the world.
            directions: (N, 3) of any length but 0, in the world.
            limit: Metres.

        Returns:
            (N,) metres, inf where nothing is within the limit, and (N,) the cosine of the angle between ray
            and normal, NaN there.

        Raises:
            ValueError: A shape is wrong, a number is not finite, or a direction has no length.
        """
        start = np.asarray(eye, dtype=np.float64)
        if start.shape != (3,):
            raise ValueError(f"eye: expected (3,), got {start.shape}")
        ways = checked(directions, "directions", 3)
        lengths = np.linalg.norm(ways, axis=1, keepdims=True)
        if not (lengths > 0.0).all():
            raise ValueError("directions: expected lengths above 0, got 0")
        return _kernels.casts(self.index, checked(start[None], "eye", 3)[0], ways / lengths, limit)

    def clearance(self, x: float, y: float, protocol: SurveyProtocol, *, limit: float = 5.0) -> float:
        """Horizontal metres between the body at (x, y) and anything solid at its height.

        At most `limit`, which is also the answer where nothing is that near. Zero or less is contact, down to
        minus the body's radius where its axis itself is pierced.
        """
        where = _at_height(checked([[x, y]], "position", 2), protocol.altitude)
        return float(self._clearances(where, True, protocol, limit)[0])

    def clearance_at(self, point: npt.ArrayLike, protocol: SurveyProtocol, *, limit: float = 5.0) -> float:
        """As `clearance`, with the body's centre at a point (3,) of the world.

        The metres are horizontal: what lies a hand's breadth above or below the body does not count until it
        touches it. Zero or less exactly where it does, from any side; the terrain is solid all the way down.
        """
        where = checked(np.asarray(point, np.float64).reshape(1, -1), "point", 3)
        return float(self._clearances(where, False, protocol, limit)[0])

    def free(self, positions: npt.ArrayLike, protocol: SurveyProtocol) -> BoolArray:
        """(P,) bool: at which positions (P, 2) does the body touch nothing?"""
        where = _at_height(checked(positions, "positions", 2), protocol.altitude)
        return self._clearances(where, True, protocol, PACE) > 0.0

    def free_at(self, points: npt.ArrayLike, protocol: SurveyProtocol) -> BoolArray:
        """(N,) bool: with its centre at which points (N, 3) of the world does the body touch nothing?"""
        return self._clearances(checked(points, "points", 3), False, protocol, PACE) > 0.0

    def _clearances(
        self, points: Float64Array, over_ground: bool, protocol: SurveyProtocol, limit: float
    ) -> Float64Array:
        radius, height = protocol.body_radius, protocol.body_height
        # A whole number would have the kernel compiled once more.
        return _kernels.clearances(self.index, points, over_ground, radius, height, float(limit))

    def sweep(self, start: SE2, end: SE2, protocol: SurveyProtocol, *, limit: float = 5.0) -> Sweep:
        """Move the body straight from start to end, following the terrain, until it touches a solid.

        It is looked at every 2 cm; a contact is then found to a hundredth of a millimetre. There and back
        agree about whether there is one. Headings play no part.
        """
        z = float(protocol.altitude)
        way = _kernels.BodyWay(float(start.x), float(start.y), z, float(end.x), float(end.y), z, True)
        return self._sweep(way, protocol, limit)

    def sweep_through(
        self, start: npt.ArrayLike, end: npt.ArrayLike, protocol: SurveyProtocol, *, limit: float = 5.0
    ) -> Sweep:
        """Move the body's centre straight through the water from start (3,) to end (3,), as `sweep` does.

        Between two looks a body that climbs and advances at once may enter what it grazes with its rim by a
        centimetre at most.
        """
        x0, y0, z0 = checked(np.reshape(start, (1, -1)), "start", 3)[0].tolist()
        x1, y1, z1 = checked(np.reshape(end, (1, -1)), "end", 3)[0].tolist()
        return self._sweep(_kernels.BodyWay(x0, y0, z0, x1, y1, z1, False), protocol, limit)

    def _sweep(self, way: _kernels.BodyWay, protocol: SurveyProtocol, limit: float) -> Sweep:
        radius, height = protocol.body_radius, protocol.body_height
        return Sweep(*_kernels.sweep(self.index, way, radius, height, float(limit), PACE))

    def passes(self, starts: npt.ArrayLike, ends: npt.ArrayLike, protocol: SurveyProtocol) -> BoolArray:
        """(M,) bool: which straight moves, from starts (M, 2) to ends (M, 2), touch nothing; as `sweep`."""
        begin, end = _paired(starts, ends, 2)
        begin, end = _at_height(begin, protocol.altitude), _at_height(end, protocol.altitude)
        return self._passes(begin, end, True, protocol)

    def passes_through(
        self, starts: npt.ArrayLike, ends: npt.ArrayLike, protocol: SurveyProtocol
    ) -> BoolArray:
        """(M,) bool: which straight moves, from (M, 3) to (M, 3), touch nothing; as `sweep_through`."""
        return self._passes(*_paired(starts, ends, 3), False, protocol)

    def _passes(
        self, starts: Float64Array, ends: Float64Array, over_ground: bool, protocol: SurveyProtocol
    ) -> BoolArray:
        radius, height = protocol.body_radius, protocol.body_height
        return _kernels.passes(self.index, starts, ends, over_ground, radius, height, PACE)

    def lattice(self, protocol: SurveyProtocol) -> FreeLattice:
        """The protocol's positions inside the bounds: where the body is free, and where it can get."""
        (col0, row0), (cols, rows) = _nodes_in(self.world.bounds, protocol.lattice)
        nothing = np.zeros((rows, cols), np.bool_)
        nodes = FreeLattice((col0, row0), protocol.lattice, nothing, nothing).positions
        free = self.free(nodes.reshape(-1, 2), protocol).reshape(rows, cols)
        seeds = [(0, *self._start_node(s, (col0, row0), protocol)) for s in self.world.starts]
        moves = sorted(
            {(*protocol.offset(h, a), 0) for h in range(protocol.headings) for a in protocol.advances}
        )
        reached = self._reachable(free[None], (col0, row0), protocol.altitude, seeds, moves, True, protocol)
        return FreeLattice((col0, row0), protocol.lattice, free, reached[0])

    def free_space(self, protocol: SurveyProtocol) -> FreeSpace:
        """The positions of a protocol that moves in space: where the body is free, and where it can get.

        A position is one where its `space` lets the centre be, from the lowest height over ground to the
        highest over what stands there, and so far under the surface. A start has its height rounded to the
        lattice, both ways.

        Raises:
            ValueError: The protocol is a planar one.
        """
        space, spacing, terrain = protocol.space, protocol.lattice, self.world.terrain
        if space is None:
            raise ValueError(f"protocol: expected one that moves in space, got {protocol.name}")
        (col0, row0), (cols, rows) = _nodes_in(self.world.bounds, spacing)
        x, y = np.meshgrid((col0 + np.arange(cols)) * spacing, (row0 + np.arange(rows)) * spacing)
        ground = terrain.height(x, y)
        flat = np.column_stack([x.ravel(), y.ravel()])
        tops = _kernels.tops(self.index, flat, protocol.body_radius).reshape(rows, cols)
        highest = np.minimum(np.maximum(ground, tops) + space.highest, -space.surface)
        level0 = math.ceil((ground.min() + space.lowest) / spacing)
        levels = max(math.floor(highest.max() / spacing) - level0 + 1, 1)
        z = ((level0 + np.arange(levels)) * spacing)[:, None, None]
        free = (z >= ground + space.lowest) & (z <= highest)
        level, row, col = np.nonzero(free)
        free[free] = self.free_at(np.column_stack([x[row, col], y[row, col], z[level, 0, 0]]), protocol)

        seeds = []
        for start in self.world.starts:
            at = self._start_node(start, (col0, row0), protocol)
            height = (float(terrain.height(start.x, start.y)) + protocol.altitude) / spacing - level0
            seeds += [(math.floor(height), *at), (math.ceil(height), *at)]
        ahead = {protocol.offset(h, a) for h in range(protocol.headings) for a in (0.0, *protocol.advances)}
        climbs = [round(climb / spacing) for climb in protocol.climbs]
        moves = sorted({(*offset, climb) for offset in ahead for climb in climbs} - {(0, 0, 0)})
        reached = self._reachable(free, (col0, row0), level0 * spacing, seeds, moves, False, protocol)
        return FreeSpace((col0, row0, level0), spacing, free, reached)

    def _start_node(self, start: SE2, first: tuple[int, int], protocol: SurveyProtocol) -> tuple[int, int]:
        """(row, col)."""
        return round(start.y / protocol.lattice) - first[1], round(start.x / protocol.lattice) - first[0]

    def _reachable(
        self,
        free: BoolArray,
        first: tuple[int, int],
        z0: float,
        seeds: list[tuple[int, int, int]],
        moves: list[tuple[int, int, int]],
        over_ground: bool,
        protocol: SurveyProtocol,
    ) -> BoolArray:
        return _kernels.reachable(
            self.index,
            free,
            float(first[0]),
            float(first[1]),
            float(z0),
            protocol.lattice,
            np.array(seeds, np.intp).reshape(-1, 3),
            np.array(moves, np.intp).reshape(-1, 3),
            over_ground,
            protocol.body_radius,
            protocol.body_height,
            PACE,
        )
