"""What an observation from a position would add, for all headings at once."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dream.mapping._kernels.flags import RAYS
from dream.mapping.visibility import FRACTIONS, Int32Array, RayTable, ray_table
from dream.types import BoolArray, Float32Array

if TYPE_CHECKING:
    from dream.mapping.occupancy import OccupancyMap
    from dream.protocol import SurveyProtocol

Int64Array = npt.NDArray[np.int64]


def gain(
    occupancy: OccupancyMap,
    positions: npt.ArrayLike,
    weights: npt.NDArray[Any] | None = None,
    headings: int | None = None,
) -> Float32Array:
    """Weight of the cells, not yet observed, that an observation would explore; see `visible_weight`."""
    return _sweep(occupancy, positions, weights, headings, occupancy.observed)


def visible_weight(
    occupancy: OccupancyMap,
    positions: npt.ArrayLike,
    weights: npt.NDArray[Any] | None = None,
    headings: int | None = None,
) -> Float32Array:
    """Weight of the cells that an observation would show, explored or not.

    The same cells as `view` gives for that pose; the unknown does not block. One sweep a position
    serves all headings: a cell is visible or not whatever the heading, and lies in the sectors of a
    run of neighbouring headings. What it costs depends on the positions, not on the map's size.

    Args:
        occupancy: What is known.
        positions: (P, 2) metres in the world.
        weights: (rows, cols) worth of each cell; None counts cells.
        headings: How many, equally spaced over the full turn; the protocol's if None.

    Returns:
        (P, headings) float32; heading k is k / headings of a turn. Sums are made in float64, so that a
        count is exact.
    """
    return _sweep(occupancy, positions, weights, headings, None)


class Sweep(NamedTuple):
    """A ray table made ready for one sweep; `_kernels.sight.sweep_gain` says how it is read."""

    ranks: Int32Array
    """(side, side) index into the table by row and column; its length where there is none."""
    head: npt.NDArray[np.uint16]
    """(n + 1,) the two runs of 2^n rays, overlapping, that make up a cell's rays."""
    tail: npt.NDArray[np.uint16]
    group: npt.NDArray[np.uint32]
    """(n,) cells that lie in the sectors of the same headings have the same number."""
    skip: int
    """Number of cells before the first that lies in any sector."""
    first_heading: Int64Array
    """(groups,)"""
    headings: Int64Array
    """(groups,) how many headings there are from there on."""


@lru_cache(maxsize=2 * FRACTIONS * FRACTIONS)
def sweep_table(
    protocol: SurveyProtocol, fraction_x: int, fraction_y: int, headings: int
) -> tuple[RayTable, Sweep]:
    """What lies around a place inside its cell, see `ray_table`, and the sweep over it."""
    table = ray_table(protocol.reach / protocol.cell, fraction_x, fraction_y)
    cells = len(table.rows)
    span = int(max(np.abs(table.rows).max(), np.abs(table.cols).max()))
    ranks = np.full((2 * span + 1, 2 * span + 1), cells, np.int32)
    ranks[table.rows + span, table.cols + span] = np.arange(cells)
    level = np.frexp(table.last - table.first + 1)[1] - 1
    levels = int(math.log2(RAYS)) + 1
    head, tail = np.full((2, cells + 1), levels * RAYS, np.uint16)
    head[:-1] = level * RAYS + table.first
    tail[:-1] = level * RAYS + (table.last - 2**level + 1) % RAYS
    pairs, group = np.unique(
        np.stack(sector_headings(table, protocol, headings), axis=1), axis=0, return_inverse=True
    )
    first, count = pairs.T.copy()
    skip = int(np.argmax(count[group.ravel()] > 0))
    return table, Sweep(ranks, head, tail, group.ravel().astype(np.uint32), skip, first, count)


def sector_headings(
    table: RayTable, protocol: SurveyProtocol, headings: int
) -> tuple[Int64Array, Int64Array]:
    """For each cell of the table, the first heading whose sector holds it, and how many do from there on."""
    half_angle = 0.5 * protocol.camera.horizontal_fov
    step = 2.0 * math.pi / headings
    nearness = np.minimum(protocol.blind / protocol.cell / np.maximum(table.distance, 1e-9), 1.0)
    wide = np.minimum(half_angle, np.arccos(nearness)) + 1e-6
    bearing = np.arctan2(table.y, table.x)
    first = np.ceil((bearing - wide) / step).astype(np.int64)
    last = np.floor((bearing + wide) / step).astype(np.int64)
    count = np.minimum(np.maximum(last - first + 1, 0), headings)
    count[table.distance < protocol.blind / protocol.cell - 1e-6] = 0
    return np.where(count > 0, first % headings, 0), count


def _sweep(
    occupancy: OccupancyMap,
    positions: npt.ArrayLike,
    weights: npt.NDArray[Any] | None,
    headings: int | None,
    hidden: BoolArray | None,
) -> Float32Array:
    """Weight of the visible cells, less those `hidden`."""
    from dream.mapping._kernels import sight

    protocol = occupancy.protocol
    headings = protocol.headings if headings is None else headings
    points = np.asarray(positions, np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"positions: expected (P, 2) metres, got {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError("positions: expected finite numbers, got NaN or infinity")
    if weights is not None and weights.shape != occupancy.shape:
        raise ValueError(f"weights: expected {occupancy.shape} like the map, got {weights.shape}")
    if headings < 1:
        raise ValueError(f"headings: expected at least 1, got {headings}")
    gains = np.zeros((len(points), headings), np.float32)
    span = math.ceil(protocol.reach / protocol.cell) + 1
    origin = np.array([occupancy.bounds.x_min, occupancy.bounds.y_min])
    in_cells = (points - origin) / protocol.cell
    near = np.flatnonzero(((in_cells > -span) & (in_cells < np.add(occupancy.shape[::-1], span))).all(axis=1))
    place, fraction = np.divmod(np.rint(in_cells[near] * FRACTIONS).astype(np.int64), FRACTIONS)
    for members in _neighbours(place, 2 * span):
        low, high = place[members].min(axis=0) - span, place[members].max(axis=0) + span + 1
        first, past = np.maximum(low, 0), np.minimum(high, occupancy.shape[::-1])
        window = np.s_[first[1] : past[1], first[0] : past[0]]
        left, top = first - low
        width, height = high - low
        solid = occupancy.solid[window]
        columns, starts = sight.list_blocks(np.flatnonzero(solid), solid.shape[1], (top, left, height, width))
        values = np.zeros((height, width), np.float32)
        inside = values[top : top + solid.shape[0], left : left + solid.shape[1]]
        inside[:] = 1.0 if weights is None else weights[window]
        if hidden is not None:  # Multiplied as whole numbers, which clears NaN too; no mask is as fast.
            bits = inside.view(np.int32)
            np.multiply(bits, ~hidden[window], out=bits)
        kinds, kind_of = np.unique(fraction[members] @ (FRACTIONS, 1), return_inverse=True)
        for kind, fractions in enumerate(kinds):
            mine = members[kind_of == kind]
            table, sweep = sweep_table(protocol, *divmod(int(fractions), FRACTIONS), headings)
            rows, cols = place[mine, 1] - low[1], place[mine, 0] - low[0]
            gains[near[mine]] = sight.sweep_gain(values, columns, starts, rows, cols, table, sweep, headings)
    return gains


def _neighbours(place: Int64Array, side: int) -> Iterator[Int64Array]:
    """Indices of the places in each square of that side that has any."""
    if len(place) == 0:
        return
    tile = place // side
    number = (tile[:, 1] - tile[:, 1].min()) * (np.ptp(tile[:, 0]) + 1) + tile[:, 0]
    order = np.argsort(number, kind="stable")
    yield from np.split(order, np.flatnonzero(np.diff(number[order])) + 1)
