"""What an observation from a position would add, for all headings at once."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.mapping.visibility import FRACTIONS, RayTable, ray_table
from dream.types import Float32Array

if TYPE_CHECKING:
    from dream.mapping.occupancy import OccupancyMap
    from dream.protocol import SurveyProtocol


def gain(occupancy: OccupancyMap, positions: npt.ArrayLike, weights: npt.NDArray[Any]) -> Float32Array:
    """Weight of the cells, not yet explored, that an observation would explore; see `visible_weight`."""
    if weights.shape != occupancy.shape:
        raise ValueError(f"weights: expected {occupancy.shape} like the map, got {weights.shape}")
    return visible_weight(occupancy, positions, np.where(occupancy.explored, 0.0, weights))


def visible_weight(
    occupancy: OccupancyMap, positions: npt.ArrayLike, weights: npt.NDArray[Any]
) -> Float32Array:
    """Weight of the cells that an observation would show, explored or not.

    The same cells as `view` gives for that pose; the unknown does not block. One sweep a position
    serves all headings: a cell is visible or not whatever the heading, and lies in the sectors of a
    run of neighbouring headings.

    Args:
        occupancy: What is known.
        positions: (P, 2) metres in the world.
        weights: (rows, cols) worth of each cell; ones count cells.

    Returns:
        (P, headings) float32; heading k is k times the protocol's heading step.
    """
    from dream.mapping._kernels import sight

    protocol = occupancy.protocol
    points = np.asarray(positions, np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"positions: expected (P, 2) metres, got {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError("positions: expected finite numbers, got NaN or infinity")
    if weights.shape != occupancy.shape:
        raise ValueError(f"weights: expected {occupancy.shape} like the map, got {weights.shape}")
    origin = np.array([occupancy.bounds.x_min, occupancy.bounds.y_min])
    place, fraction = np.divmod(
        np.rint((points - origin) / protocol.cell * FRACTIONS).astype(np.int64), FRACTIONS
    )
    gains = np.zeros((len(points), protocol.headings), np.float32)
    kinds, kind_of = np.unique(fraction, axis=0, return_inverse=True)
    for kind, (fraction_x, fraction_y) in enumerate(kinds):
        mine = np.flatnonzero(kind_of.ravel() == kind)
        table = ray_table(protocol.reach / protocol.cell, int(fraction_x), int(fraction_y))
        gains[mine] = sight.sweep_gain(
            occupancy.solid,
            np.asarray(weights, np.float32),
            place[mine, 1],
            place[mine, 0],
            table.rows,
            table.cols,
            table.first,
            table.last,
            *sector_headings(table, protocol),
            protocol.headings,
        )
    return gains


@lru_cache(maxsize=FRACTIONS * FRACTIONS)
def sector_headings(
    table: RayTable, protocol: SurveyProtocol
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """For each cell of the table, the first heading whose sector holds it, and how many do from there on."""
    half_angle = 0.5 * protocol.camera.horizontal_fov
    nearness = np.minimum(protocol.blind / protocol.cell / np.maximum(table.distance, 1e-9), 1.0)
    wide = np.minimum(half_angle, np.arccos(nearness)) + 1e-6
    bearing = np.arctan2(table.y, table.x)
    first = np.ceil((bearing - wide) / protocol.heading_step).astype(np.int64)
    last = np.floor((bearing + wide) / protocol.heading_step).astype(np.int64)
    count = np.minimum(np.maximum(last - first + 1, 0), protocol.headings)
    count[table.distance < protocol.blind / protocol.cell - 1e-6] = 0
    return first % protocol.headings, count
