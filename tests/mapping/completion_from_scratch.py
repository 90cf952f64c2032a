"""The completion check from scratch, over the whole map: what the kept one must agree with."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy import ndimage, sparse
from scipy.spatial import cKDTree

from dream.geometry import SE2, Bounds
from dream.mapping import Completion, OccupancyMap, Region
from dream.mapping._kernels import sightlines
from dream.mapping._kernels.flags import EDGE, RAYS
from dream.mapping._kernels.room import segment_is_free
from dream.mapping.visibility import FRACTIONS, ray_table
from dream.types import BoolArray, IntArray

Float64Array = npt.NDArray[np.float64]

MARGIN = 2
FOUR = ndimage.generate_binary_structure(2, 1)


@njit(cache=True)
def _flood(room, low, needed, lattice, origin, cell, limits, start, moves):  # type: ignore[no-untyped-def]
    """Nodes of the lattice within limits that moves, each a free segment, lead to from one of them."""
    first_row, first_col, past_row, past_col = limits
    reached = np.zeros((past_row - first_row, past_col - first_col), dtype=np.bool_)
    reached[start[0] - first_row, start[1] - first_col] = True
    todo = [start]
    while len(todo) > 0:
        i, j = todo.pop()
        x, y = (j * lattice - origin[0]) / cell + EDGE, (i * lattice - origin[1]) / cell + EDGE
        for k in range(len(moves)):
            a, b = i + moves[k, 1], j + moves[k, 0]
            if a < first_row or b < first_col or a >= past_row or b >= past_col:
                continue
            to_x, to_y = (b * lattice - origin[0]) / cell + EDGE, (a * lattice - origin[1]) / cell + EDGE
            if not reached[a - first_row, b - first_col] and segment_is_free(
                room, needed, x, y, to_x, to_y, low[0], low[1]
            ):
                reached[a - first_row, b - first_col] = True
                todo.append((a, b))
    return reached


def cells_of(
    occupancy: OccupancyMap, positions: Float64Array
) -> tuple[IntArray, IntArray, Float64Array, Float64Array]:
    """Row and column in the map, and how far north and east in that cell; in cells."""
    east, north = ((positions - occupancy._origin) / occupancy.protocol.cell + EDGE).T
    row, col = np.floor(north).astype(int), np.floor(east).astype(int)
    # A node on the edge of cells lies exactly there.
    north, east = (np.where(part < 2.0 * EDGE, 0.0, part - EDGE) for part in (north - row, east - col))
    return row - occupancy.low[0], col - occupancy.low[1], north, east


def reachable(occupancy: OccupancyMap, pose: SE2) -> Float64Array:
    """A flood over the whole lattice."""
    protocol, bounds = occupancy.protocol, occupancy.bounds
    lattice = protocol.lattice
    first_col, last_col = math.ceil(bounds.x_min / lattice - 1e-9), math.floor(bounds.x_max / lattice + 1e-9)
    first_row, last_row = math.ceil(bounds.y_min / lattice - 1e-9), math.floor(bounds.y_max / lattice + 1e-9)
    row, col = round(pose.y / lattice), round(pose.x / lattice)
    if not (first_row <= row <= last_row and first_col <= col <= last_col):
        return np.zeros((0, 2))
    headings = range(protocol.headings)
    moves = {protocol.offset(heading, advance) for heading in headings for advance in protocol.advances}
    reached = _flood(
        occupancy.room,
        occupancy.low,
        occupancy.needed_room,
        lattice,
        occupancy._origin,
        protocol.cell,
        (first_row, first_col, last_row + 1, last_col + 1),
        (row, col),
        np.array(sorted(moves)),
    )
    positions: Float64Array = np.multiply(np.argwhere(reached)[:, ::-1] + (first_col, first_row), lattice)
    return positions


@dataclass(frozen=True)
class Surroundings:
    """Cells around a place from near to far, and the rays that cross each of them; lengths in cells."""

    rows: IntArray
    """(n,) from the place's own cell."""
    cols: IntArray
    x: Float64Array
    """(n,) from the place to the cell's centre."""
    y: Float64Array
    rays: IntArray
    """Those of all cells, one cell's after the other's."""
    starts: IntArray
    """(n,) where a cell's begin."""
    rank: IntArray
    """For each of `rays`, which cell it is."""

    def entered(self, solid: BoolArray) -> BoolArray:
        """(n,) cells that some ray enters, given which of them end it."""
        depth = np.full(RAYS, len(self.rows))
        ends = solid[self.rank]
        np.minimum.at(depth, self.rays[ends], self.rank[ends])
        deepest: IntArray = np.maximum.reduceat(depth[self.rays], self.starts)
        return deepest >= np.arange(len(self.rows))


@lru_cache(maxsize=128)
def surroundings(radius: float, fraction_x: float, fraction_y: float) -> Surroundings:
    """Of a place inside its cell. Ray k points along (k + 1/2) / RAYS of a turn."""
    span = math.ceil(radius) + 1
    rows, cols = (offset.ravel() for offset in np.mgrid[-span : span + 1, -span : span + 1])
    x, y = cols + 0.5 - fraction_x, rows + 0.5 - fraction_y
    distance = np.hypot(x, y)
    order = np.argsort(np.round(distance, 9), kind="stable")
    order = order[distance[order] <= radius + 1e-9]
    rows, cols, x, y = rows[order], cols[order], x[order], y[order]
    corners = np.array([(-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)])
    to_x, to_y = x[:, None] + corners[:, 0], y[:, None] + corners[:, 1]
    side = np.arctan2(x[:, None] * to_y - y[:, None] * to_x, x[:, None] * to_x + y[:, None] * to_y)
    bearing = np.arctan2(y, x)
    first, last = (
        (bearing + edge) * RAYS / (2.0 * math.pi) - 0.5 for edge in (side.min(axis=1), side.max(axis=1))
    )
    first, last = np.ceil(first).astype(int), np.floor(last).astype(int)
    around = np.maximum(np.abs(x), np.abs(y)) < 0.5
    first[around], last[around] = 0, RAYS - 1
    count = last - first + 1
    starts = np.cumsum(count) - count
    rank = np.repeat(np.arange(len(rows)), count)
    rays = (first[rank] + np.arange(len(rank)) - starts[rank]) % RAYS
    return Surroundings(rows, cols, x, y, rays, starts, rank)


def seeable(occupancy: OccupancyMap, nodes: Float64Array, candidates: IntArray) -> IntArray:
    """The candidates (n, 2) that an observation from one of the nodes would explore.

    Asked are the nearest node, and all to whose cells rays lead from the candidate's middle.
    """
    if not len(nodes) or not len(candidates):
        return candidates[:0]
    protocol = occupancy.protocol
    reach, blind = protocol.reach / protocol.cell, protocol.blind / protocol.cell
    margin = math.ceil(reach) + 3
    solid = np.pad(occupancy.solid, margin)
    row, col, north, east = cells_of(occupancy, nodes)
    last_row, last_col = occupancy.shape[0] - 1, occupancy.shape[1] - 1
    node_at = np.full(solid.shape, -1)
    # A node on the edge counts to the last cell.
    node_at[np.clip(row, 0, last_row) + margin, np.clip(col, 0, last_col) + margin] = np.arange(len(nodes))
    views: dict[int, BoolArray] = {}

    def view(node: int) -> BoolArray:
        """What a camera there explores around its cell, each cell with the heading that suits it best."""
        if node in views:
            return views[node]
        around = surroundings(reach + 1.0, float(east[node]), float(north[node]))
        seen = around.entered(solid[around.rows + row[node] + margin, around.cols + col[node] + margin])
        bearing = np.arctan2(around.y, around.x)
        step = protocol.heading_step
        off_axis = np.abs(bearing - step * np.floor(bearing / step + 0.5))
        distance = np.hypot(around.x, around.y)
        seen &= (distance <= reach) & (off_axis <= 0.5 * protocol.camera.horizontal_fov)
        seen &= distance * np.cos(off_axis) >= blind
        views[node] = np.zeros((2 * margin + 1, 2 * margin + 1), np.bool_)
        views[node][around.rows[seen] + margin, around.cols[seen] + margin] = True
        return views[node]

    def is_seen(cell: IntArray) -> bool:
        at = middle.rows + cell[0] + margin, middle.cols + cell[1] + margin
        here = node_at[at]
        if not (here >= 0).any():
            return False
        ends = solid[at]
        ends[0] = False
        asked = (here >= 0) & middle.entered(ends)
        asked[np.argmax(here >= 0)] = True
        # The nearest ones are blind.
        return any(
            view(node)[cell[0] - row[node] + margin, cell[1] - col[node] + margin]
            for node in here[asked & (np.hypot(middle.x, middle.y) > blind - 1.0)]
        )

    middle = surroundings(reach + 1.0, 0.5, 0.5)
    # Whatever has no node within reach is quickly left out.
    distance = ndimage.distance_transform_edt(node_at < 0)
    candidates = candidates[distance[tuple((candidates + margin).T)] <= reach + 1.1]
    seen: IntArray = candidates[[is_seen(cell) for cell in candidates]]
    return seen


def seeable_at_once(occupancy: OccupancyMap, nodes: Float64Array, candidates: IntArray) -> IntArray:
    """`completion_from_seeable`, over the whole map at once."""
    if not len(nodes) or not len(candidates):
        return candidates[:0]
    protocol = occupancy.protocol
    row, col, north, east = cells_of(occupancy, nodes)
    last_row, last_col = occupancy.shape[0] - 1, occupancy.shape[1] - 1
    node_at = np.full(occupancy.shape, -1, np.int32)
    node_at[np.clip(row, 0, last_row), np.clip(col, 0, last_col)] = np.arange(len(nodes))
    reach = protocol.reach / protocol.cell
    distance = ndimage.distance_transform_edt(node_at < 0)
    candidates = candidates[distance[tuple(candidates.T)] <= reach + 1.1]
    rays = ray_table(reach + 1.0, FRACTIONS // 2, FRACTIONS // 2)
    found = sightlines.seeable(
        occupancy.solid,
        candidates,
        sightlines.Nodes(node_at, col + east, row + north),
        sightlines.Sensor(
            reach,
            protocol.blind / protocol.cell,
            0.5 * protocol.camera.horizontal_fov,
            protocol.heading_step,
        ),
        rays,
    )
    seen: IntArray = candidates[found]
    return seen


Seeable = Callable[[OccupancyMap, Float64Array, IntArray], IntArray]


def linked(target: BoolArray, radius: float) -> tuple[IntArray, IntArray]:
    """(n, 2) target cells and (n,) numbers, from 0, of what belongs together; both in raster order."""
    cells = np.argwhere(target)
    if not len(cells):
        return cells, np.zeros(0, np.int64)
    pairs = cKDTree(cells).query_pairs(radius + 1e-9, output_type="ndarray")
    graph = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(cells), len(cells)))
    _, names = sparse.csgraph.connected_components(graph, directed=False)
    _, first, number = np.unique(names, return_index=True, return_inverse=True)
    return cells, np.argsort(np.argsort(first))[number]


def outline(cells: IntArray, shape: tuple[int, int]) -> IntArray:
    """(m, 2) cells near some and the holes in them."""
    low = np.maximum(cells.min(axis=0) - MARGIN - 1, 0)
    high = np.minimum(cells.max(axis=0) + MARGIN + 2, shape)
    mask = np.zeros(tuple(high - low), np.bool_)
    mask[tuple((cells - low).T)] = True
    away = np.arange(-MARGIN, MARGIN + 1)
    near = ndimage.binary_dilation(mask, away[:, None] ** 2 + away[None, :] ** 2 <= MARGIN**2)
    # Holes are also what the mask cuts off at the border of the map: there is nothing beyond.
    inside: IntArray = np.argwhere(ndimage.binary_fill_holes(near, FOUR)) + low
    return inside


def check_completion(occupancy: OccupancyMap, pose: SE2, seeable: Seeable = seeable) -> Completion:
    """Everything anew; with another function for `seeable` where this one takes too long."""
    nodes = reachable(occupancy, pose)
    protocol, unexplored = occupancy.protocol, ~occupancy.observed
    cells, numbers = linked(occupancy.target, protocol.group_radius / protocol.cell)
    if not len(cells):
        open_cells = seeable(occupancy, nodes, np.argwhere(unexplored))
        text = ""
        if len(open_cells):
            x, y = _middle(occupancy, open_cells)
            text = f"no target was seen, and {_unknown(open_cells)} near ({x:.1f}, {y:.1f})"
            text += " could still be seen"
        return Completion((), open_cells, text)
    regions = []
    order = np.argsort(numbers, kind="stable")
    for mine in np.split(cells[order], np.searchsorted(numbers[order], np.arange(1, numbers.max() + 1))):
        candidates = outline(mine, occupancy.shape)
        candidates = candidates[unexplored[tuple(candidates.T)]]
        west, south = occupancy.center_of(*mine.min(axis=0))
        east, north = occupancy.center_of(*mine.max(axis=0))
        half = 0.5 * protocol.cell
        regions.append(
            Region(
                cells=mine,
                centroid=_middle(occupancy, mine),
                extent=Bounds(
                    float(west) - half, float(south) - half, float(east) + half, float(north) + half
                ),
                open_cells=seeable(occupancy, nodes, candidates),
            )
        )
    open_cells = np.unique(np.concatenate([region.open_cells for region in regions]), axis=0)
    return Completion(tuple(regions), open_cells, _text(occupancy, regions))


def _text(occupancy: OccupancyMap, regions: Sequence[Region]) -> str:
    sizes = [len(region.open_cells) for region in regions]
    if not any(sizes):
        return ""
    worst = int(np.argmax(sizes))
    x, y = _middle(occupancy, regions[worst].open_cells)
    unknown = _unknown(regions[worst].open_cells)
    text = f"region {worst + 1} near ({x:.1f}, {y:.1f}) has {unknown} at its edge"
    others = sum(size > 0 for size in sizes) - 1
    return text + (f"; {others} more region{'s are' if others > 1 else ' is'} open" if others else "")


def _middle(occupancy: OccupancyMap, cells: IntArray) -> tuple[float, float]:
    x, y = occupancy.center_of(cells[:, 0].mean(), cells[:, 1].mean())
    return float(x), float(y)


def _unknown(cells: IntArray) -> str:
    return f"{len(cells)} unknown cell{'s' if len(cells) != 1 else ''}"


def assert_same(ours: Completion, theirs: Completion) -> None:
    """Equal to the cell, the number and the letter."""
    assert ours.open_region == theirs.open_region
    np.testing.assert_array_equal(ours.open_cells, theirs.open_cells)
    assert len(ours.regions) == len(theirs.regions)
    for mine, other in zip(ours.regions, theirs.regions, strict=True):
        np.testing.assert_array_equal(mine.cells, other.cells)
        np.testing.assert_array_equal(mine.open_cells, other.open_cells)
        assert mine.centroid == other.centroid
        assert mine.extent == other.extent
