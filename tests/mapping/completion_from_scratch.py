"""The completion check from scratch, over the whole map: what the kept one must agree with."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy import ndimage, sparse
from scipy.spatial import cKDTree

from dream.geometry import SE2, Bounds
from dream.mapping import Completion, OccupancyMap, Region
from dream.mapping._kernels import progress
from dream.mapping._kernels.room import segment_is_free
from dream.mapping.visibility import FRACTIONS, ray_table
from dream.types import BoolArray, IntArray

Float64Array = npt.NDArray[np.float64]

MARGIN = 2
FOUR = ndimage.generate_binary_structure(2, 1)


@njit(cache=True)
def _flood(squared, needed, offset_x, offset_y, spacing, shape, row, col, moves):  # type: ignore[no-untyped-def]
    """Lattice nodes that can be reached from (row, col) by the moves, each a free segment."""
    rows, cols = shape
    reached = np.zeros((rows, cols), dtype=np.bool_)
    stack = np.empty(rows * cols, dtype=np.int32)
    reached[row, col] = True
    stack[0] = row * cols + col
    depth = 1
    while depth > 0:
        depth -= 1
        i, j = stack[depth] // cols, stack[depth] % cols
        x, y = offset_x + spacing * j, offset_y + spacing * i
        for k in range(len(moves)):
            a, b = i + moves[k, 1], j + moves[k, 0]
            if a < 0 or b < 0 or a >= rows or b >= cols or reached[a, b]:
                continue
            if segment_is_free(squared, needed, x, y, offset_x + spacing * b, offset_y + spacing * a):
                reached[a, b] = True
                stack[depth] = a * cols + b
                depth += 1
    return reached


def reachable(occupancy: OccupancyMap, pose: SE2) -> Float64Array:
    """A flood over the whole lattice."""
    protocol, bounds = occupancy.protocol, occupancy.bounds
    lattice = protocol.lattice
    first_col, last_col = math.ceil(bounds.x_min / lattice - 1e-9), math.floor(bounds.x_max / lattice + 1e-9)
    first_row, last_row = math.ceil(bounds.y_min / lattice - 1e-9), math.floor(bounds.y_max / lattice + 1e-9)
    shape = (last_row - first_row + 1, last_col - first_col + 1)
    row, col = round(pose.y / lattice) - first_row, round(pose.x / lattice) - first_col
    if not (0 <= row < shape[0] and 0 <= col < shape[1]):
        return np.zeros((0, 2))
    headings = range(protocol.headings)
    moves = {protocol.offset(heading, advance) for heading in headings for advance in protocol.advances}
    reached = _flood(
        occupancy.room,
        occupancy.needed_room,
        (first_col * lattice - bounds.x_min) / protocol.cell,
        (first_row * lattice - bounds.y_min) / protocol.cell,
        lattice / protocol.cell,
        shape,
        row,
        col,
        np.array(sorted(moves)),
    )
    nodes = np.argwhere(reached)
    positions: Float64Array = np.multiply(nodes[:, ::-1] + (first_col, first_row), lattice)
    return positions


def seeable(occupancy: OccupancyMap, nodes: Float64Array, candidates: IntArray) -> IntArray:
    """The candidates (n, 2) that an observation from one of the nodes would explore."""
    if not len(nodes) or not len(candidates):
        return candidates[:0]
    protocol = occupancy.protocol
    x, y = ((nodes - (occupancy.bounds.x_min, occupancy.bounds.y_min)) / protocol.cell).T
    row = np.clip(np.floor(y).astype(np.intp), 0, occupancy.shape[0] - 1)
    col = np.clip(np.floor(x).astype(np.intp), 0, occupancy.shape[1] - 1)
    node_at = np.full(occupancy.shape, -1, np.int32)
    node_at[row, col] = np.arange(len(nodes))
    reach = protocol.reach / protocol.cell
    # A node lies anywhere in its cell, up to half a diagonal from the centre that was measured to.
    distance = ndimage.distance_transform_edt(node_at < 0)
    candidates = candidates[distance[tuple(candidates.T)] <= reach + 0.71]
    rays = ray_table(reach + 1.0, FRACTIONS // 2, FRACTIONS // 2)
    found = progress.seeable(
        occupancy.solid,
        (0, 0),
        candidates,
        node_at,
        np.ascontiguousarray(x),
        np.ascontiguousarray(y),
        reach,
        protocol.blind / protocol.cell,
        0.5 * protocol.camera.horizontal_fov,
        protocol.heading_step,
        rays.rows,
        rays.cols,
        rays.first,
        rays.last,
    )
    seen: IntArray = candidates[found]
    return seen


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


def check_completion(occupancy: OccupancyMap, pose: SE2) -> Completion:
    """Everything anew."""
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
