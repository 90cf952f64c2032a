"""What every pose of the lattice would show, kept up to date where the map changes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.lattice import Lattice, Pose, lattice_of
from dream.types import BoolArray, Float32Array, IntArray, Mission

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.planning._kernels.views import Views

FloatArray = npt.NDArray[np.floating[Any]]

AREA = 0.5
"""Side of the areas that a tour visits, in reaches; longer where there would be too many."""
MOST_AREAS = 13
"""Along a side of the survey area; there are more in the padding around it, where nothing is to be seen."""


_Lists = tuple[npt.NDArray[np.int64], npt.NDArray[np.int32], npt.NDArray[np.uint8], npt.NDArray[np.uint8]]


@dataclass(frozen=True, slots=True, eq=False)
class Listed:
    """Elements that are listed pose by pose, beside those of the ground."""

    weights: FloatArray
    """(m,) of the elements."""
    expected: FloatArray
    """(m,) what is to be expected in each."""
    positions: FloatArray
    """(m, 2) metres in the world."""
    nodes: IntArray
    """(n,) of the lattice."""
    starts: IntArray
    """(n · headings + 1,) where the elements of each node and heading begin."""
    elements: IntArray
    """(k,) indices into `weights`."""


@dataclass(slots=True, eq=False)
class PoseViews:
    """What each pose of the lattice would show of the ground.

    Ground is taken in tiles, squares between four nodes of the lattice. Each tile is there twice: as ground
    to see, and as the middle of a group of targets that would be noticed when some of it is seen. What a
    pose shows is a fixed list for each heading, less what lies behind something solid. How far each bearing
    is open from a node is kept, and found anew only where something solid near it came or went.
    """

    mission: Mission
    notice: float
    """Metres from the middle of a group within which ground is seen when the group is noticed."""
    lattice: Lattice = field(init=False)
    tiles: int = field(init=False)
    """In the grid of tiles, the padding around the lattice included."""
    _pad: int = field(init=False)
    _stride: int = field(init=False)
    _node_tile: npt.NDArray[np.int64] = field(init=False)
    """(nodes,) the tile to the north-east of each node."""
    _tile_of: IntArray = field(init=False)
    """(map rows, map cols) tile of each map cell."""
    _corner: tuple[float, float] = field(init=False)
    """Column and row of node 0, in map cells."""
    _lists: _Lists = field(init=False)
    _depth: npt.NDArray[np.uint8] = field(init=False)
    _solid: BoolArray = field(init=False)
    _place: FloatArray = field(init=False)
    """(2, tiles) metres east and north of node 0 of each tile's middle."""
    _area_of: npt.NDArray[np.int32] = field(init=False)
    areas: int = field(init=False)
    """Number of areas that a tour may visit."""

    def __post_init__(self) -> None:
        from dream.planning._kernels.views import BEARINGS

        protocol, bounds = self.mission.protocol, self.mission.bounds
        self.lattice = lattice_of(bounds, protocol)
        spacing, cell, (rows, cols) = protocol.lattice, protocol.cell, self.lattice.shape
        self._pad = math.ceil((protocol.reach + self.notice) / spacing) + 2
        self._stride = cols + 2 * self._pad
        self.tiles = self._stride * (rows + 2 * self._pad)
        self._node_tile = self._tile(*self.lattice.graph.place.T)

        shape = round(bounds.depth / cell), round(bounds.width / cell)
        y = bounds.y_min + (np.arange(shape[0]) + 0.5) * cell
        x = bounds.x_min + (np.arange(shape[1]) + 0.5) * cell
        tile_row = np.floor(y / spacing + 1e-9).astype(np.int64) - self.lattice.south
        tile_col = np.floor(x / spacing + 1e-9).astype(np.int64) - self.lattice.west
        self._tile_of = self._tile(tile_col, tile_row[:, None])
        self._corner = (
            (self.lattice.west * spacing - bounds.x_min) / cell,
            (self.lattice.south * spacing - bounds.y_min) / cell,
        )
        self._lists = self._footprints()
        self._depth = np.full((self.lattice.nodes, BEARINGS), self._limit, np.uint8)
        self._solid = np.zeros(shape, np.bool_)

        row, col = np.divmod(np.arange(self.tiles), self._stride)
        self._place = np.stack([(k - self._pad + 0.5) * spacing for k in (col, row)]).astype(np.float32)
        side = max(AREA * protocol.reach, max(bounds.width, bounds.depth) / MOST_AREAS)
        east, north = np.floor((self._place + self._pad * spacing) / side).astype(np.int32)
        self._area_of = north * (east.max() + 1) + east
        self.areas = int(self._area_of.max()) + 1

    def _tile(self, east: IntArray, north: IntArray) -> IntArray:
        """The tile to the north-east of so many lattice steps from node 0."""
        return np.asarray((north.astype(np.int64) + self._pad) * self._stride + east + self._pad)

    @property
    def _limit(self) -> int:
        return math.ceil(self.mission.protocol.reach / self.mission.protocol.cell) + 2

    def _footprints(self) -> _Lists:
        """`Views.first`, `offset`, `bearing` and `far`: near tiles first."""
        from scipy.spatial import cKDTree

        from dream.planning._kernels.views import BEARINGS

        protocol = self.mission.protocol
        lattice, half_angle = protocol.lattice, 0.5 * protocol.camera.horizontal_fov
        span = self._pad - 1
        row, col = (k.ravel() for k in np.mgrid[-span:span, -span:span])
        x, y = (col + 0.5) * lattice, (row + 0.5) * lattice
        away = np.hypot(x, y)
        bearing = np.floor(np.arctan2(y, x) % (2.0 * math.pi) / (2.0 * math.pi) * BEARINGS) % BEARINGS
        in_row_of_tiles = row * self._stride + col
        first, offsets, bearings, fars = [0], [], [], []
        for heading in range(protocol.headings):
            angle = heading * protocol.heading_step
            ahead = x * math.cos(angle) + y * math.sin(angle)
            seen = (away <= protocol.reach) & (ahead >= away * math.cos(half_angle) - 1e-6)
            seen &= ahead >= protocol.blind
            # A group is noticed when some tile of it is seen; half a tile is lost to rounding.
            noticed = cKDTree(np.stack([x[seen], y[seen]], axis=1)).query(np.stack([x, y], axis=1))[0]
            for layer, shown, slack in (
                (0, seen, 0.0),
                (1, noticed <= max(self.notice - 0.5 * lattice, 0.0), max(self.notice - lattice, 0.0)),
            ):
                k = np.flatnonzero(shown)
                k = k[np.argsort(away[k], kind="stable")]
                offsets.append(layer * self.tiles + in_row_of_tiles[k])
                bearings.append(bearing[k])
                fars.append(np.maximum(np.ceil((away[k] - slack) / protocol.cell - 1.0), 0.0))
            first.append(sum(map(len, offsets)))
        return (
            np.array(first, np.int64),
            np.concatenate(offsets).astype(np.int32),
            np.concatenate(bearings).astype(np.uint8),
            np.minimum(np.concatenate(fars), 255).astype(np.uint8),
        )

    def update(self, occupancy: OccupancyMap, foretold: BoolArray | None = None) -> None:
        """Take in what is solid now.

        Args:
            occupancy: What is known.
            foretold: (rows, cols) what is held to be solid beside that.
        """
        from dream.mapping import within
        from dream.planning._kernels.views import sight_lines

        solid = occupancy.solid.copy() if foretold is None else occupancy.solid | foretold
        protocol, changed = self.mission.protocol, solid != self._solid
        if not changed.any():
            return
        self._solid = solid
        near = within(changed, protocol.reach + 2.0 * protocol.cell, protocol.cell)
        which = np.flatnonzero(near[self.cells_of_nodes()])
        scale = protocol.lattice / protocol.cell
        cells = np.ascontiguousarray(np.argwhere(changed))
        place = self.lattice.graph.place
        sight_lines(self._solid, cells, *self._corner, scale, self._limit, place, self._depth, which)

    def cells_of_nodes(self) -> tuple[IntArray, IntArray]:
        """(nodes,) map row and column of each node; the last one for nodes on the far edge."""
        scale = self.mission.protocol.lattice / self.mission.protocol.cell
        col, row = self.lattice.graph.place.T
        i = np.clip(np.floor(self._corner[1] + row * scale).astype(np.int64), 0, self._solid.shape[0] - 1)
        j = np.clip(np.floor(self._corner[0] + col * scale).astype(np.int64), 0, self._solid.shape[1] - 1)
        return i, j

    def moves(
        self,
        known: npt.NDArray[np.uint8],
        occupancy: OccupancyMap,
        standoff: float,
        foretold: BoolArray | None = None,
    ) -> npt.NDArray[np.uint8]:
        """(poses, advances) FREE: known to be so; UNKNOWN: nothing is known against it; or 0.

        Args:
            known: Likewise, 1 where the guard would let it pass.
            occupancy: What is known.
            standoff: Metres to keep from the middle of solid cells.
            foretold: (rows, cols) what is held to be solid beside those that are known.
        """
        from scipy.ndimage import distance_transform_edt

        from dream.planning._kernels.moves import possible_moves

        protocol = self.mission.protocol
        edge = np.minimum(occupancy.distance_to_bounds, occupancy.left_of_leash)
        # From the bounds the body keeps off, no more.
        room = np.minimum(occupancy.distance_to_solid, edge + standoff - protocol.body_radius - protocol.cell)
        if foretold is not None and foretold.any():
            room = np.minimum(room, distance_transform_edt(~foretold, protocol.cell))
        scale = protocol.lattice / protocol.cell
        # Room changes by no more than the way, a place by its cell's diagonal; rounding is less than that.
        plenty = standoff + self.lattice.longest + 1.5 * protocol.cell
        moves = np.empty_like(known)
        graph = self.lattice.graph
        possible_moves(room.astype(np.float32), standoff, plenty, *self._corner, scale, graph, known, moves)
        return moves

    def shown(self, pose: Pose) -> tuple[BoolArray, BoolArray]:
        """(map rows, map cols) ground that a pose should show, and middles of groups it should notice."""
        node, heading = self.lattice.node_of(pose), self.lattice.heading_of(pose)
        first, offset, bearing, far = self._lists
        here = slice(first[heading], first[heading + 1])
        clear = far[here] <= self._depth[node][bearing[here]]
        shown = np.zeros(2 * self.tiles, np.bool_)
        shown[self._node_tile[node] + offset[here][clear]] = True
        return shown[: self.tiles][self._tile_of], shown[self.tiles :][self._tile_of]

    def tile_places(self, tiles: IntArray) -> IntArray:
        """(n, 2) lattice steps east and north of node 0 to the south-west corners of tiles."""
        row, col = np.divmod(tiles, self._stride)
        return np.stack([col, row], axis=1) - self._pad

    def on_tiles(self, cells: FloatArray) -> Float32Array:
        """(tiles,) the sums of (map rows, map cols)."""
        sums: Float32Array = np.bincount(self._tile_of.ravel(), cells.ravel(), self.tiles).astype(np.float32)
        return sums

    def known_tiles(self, occupancy: OccupancyMap) -> BoolArray:
        """(tiles,) those with traversable ground."""
        known = np.zeros(self.tiles, np.bool_)
        known[self._tile_of[occupancy.traversable]] = True
        return known

    def views(self, listed: Listed | None = None) -> Views:
        """Which elements each pose shows: tiles as ground, tiles as hiding places, then what is listed."""
        from dream.planning._kernels.views import Views

        row_of = np.full(self.lattice.nodes, -1, np.int64)
        starts, elements = np.zeros(1, np.int64), np.zeros(0, np.int32)
        if listed is not None:
            row_of[listed.nodes] = np.arange(len(listed.nodes))
            starts = np.asarray(listed.starts, np.int64)
            elements = np.asarray(listed.elements + 2 * self.tiles, np.int32)
        tiles = self._node_tile, self.tiles, self._stride
        return Views(*self._lists, self._depth, *tiles, row_of, starts, elements)

    def places(
        self, listed: Listed | None = None
    ) -> tuple[Float32Array, Float32Array, npt.NDArray[np.int32]]:
        """(elements,) metres east and north of node 0, and the area, of each element."""
        x, y = (np.concatenate([k, k]) for k in self._place)
        area = np.concatenate([self._area_of, self._area_of])
        if listed is not None:
            spacing = self.lattice.spacing
            east = listed.positions[:, 0] - self.lattice.west * spacing
            north = listed.positions[:, 1] - self.lattice.south * spacing
            tile = self._tile(*(np.floor(k / spacing).astype(np.int64) for k in (east, north)))
            x, y = np.concatenate([x, east]), np.concatenate([y, north])
            area = np.concatenate([area, self._area_of[tile]])
        return x.astype(np.float32), y.astype(np.float32), area.astype(np.int32)
