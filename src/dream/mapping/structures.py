"""What stands up: structures as the volume knows them, and the lines that lead around them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.types import BoolArray, IntArray

if TYPE_CHECKING:
    from dream.mapping.volume import Surface, Volume

FloatArray = npt.NDArray[np.floating[Any]]

COLUMN = 0.5
"""Metres a side of the columns that structures are told apart by."""
JOINED = 2.0
"""Metres between parts that are taken for one structure."""
STANDS = 1.0
"""Metres that something must rise above what lies lowest around it to be a structure."""
LEAST = 1.0
"""Square metres of target surface that one has at least."""
AROUND = 6.0
"""Metres within which the lowest surface is taken for the ground of what stands there."""


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """One that stands up, as far as it is known."""

    west: float
    south: float
    """World position of the corner of `mask[0, 0]`."""
    mask: BoolArray
    """(rows, cols) columns that hold some of it, with room around them."""
    ground: float
    """World z of the lowest surface around it."""
    top: float
    """World z of its highest surface."""
    area: float
    """Square metres of it that are known."""

    @property
    def columns(self) -> FloatArray:
        """(n, 2) world x and y of the middles of its columns."""
        rows, cols = np.nonzero(self.mask)
        return np.column_stack([self.west + (cols + 0.5) * COLUMN, self.south + (rows + 0.5) * COLUMN])

    @property
    def middle(self) -> FloatArray:
        """(2,) the mean of its columns."""
        return np.asarray(self.columns.mean(axis=0))

    def column_of(self, middles: FloatArray) -> tuple[IntArray, IntArray, BoolArray]:
        """(n,) row and column of `mask` that places (n, 2 or 3) lie in, and whether they are any of it."""
        cols = np.floor((middles[:, 0] - self.west) / COLUMN).astype(np.int64)
        rows = np.floor((middles[:, 1] - self.south) / COLUMN).astype(np.int64)
        inside = (rows >= 0) & (rows < self.mask.shape[0]) & (cols >= 0) & (cols < self.mask.shape[1])
        return rows, cols, inside

    @property
    def away(self) -> FloatArray:
        """(rows, cols) metres from the middle of each column to the nearest one of it."""
        from scipy.ndimage import distance_transform_edt

        return np.asarray(distance_transform_edt(~self.mask)) * COLUMN

    def ring(self, standoff: float) -> FloatArray:
        """(n, 3) x, y and bearing towards it, along the longest line that keeps so far from it.

        The line is closed, counter-clockwise, its points half a metre apart or so.
        """
        from contourpy import contour_generator

        away = self.away
        lines: list[FloatArray] = [np.asarray(one) for one in contour_generator(z=away).lines(standoff)]
        if not lines:
            return np.zeros((0, 3))
        line = max(lines, key=_length)
        if _turns_right(line):
            line = line[::-1]
        north, east = (np.asarray(slope) for slope in np.gradient(away))
        cols, rows = np.clip(np.rint(line).astype(int), 0, np.array(away.shape[::-1]) - 1).T
        bearing = np.arctan2(-north[rows, cols], -east[rows, cols])
        x, y = self.west + (line[:, 0] + 0.5) * COLUMN, self.south + (line[:, 1] + 0.5) * COLUMN
        return np.column_stack([x, y, bearing])


def lowest_in(at: IntArray, z: FloatArray, shape: npt.ArrayLike) -> FloatArray:
    """World z of the lowest surface in each column of a grid; inf where there is none.

    Args:
        at: (n, 2) the columns that surface is in.
        z: (n,) its world z.
        shape: Of the grid.
    """
    lowest = np.full(np.asarray(shape), np.inf)
    np.minimum.at(lowest, tuple(at.T), z)
    return lowest


def lowest_around(lowest: FloatArray) -> FloatArray:
    """World z of the lowest surface within `AROUND` of each column: the ground of what stands there."""
    from scipy.ndimage import minimum_filter

    return np.asarray(minimum_filter(lowest, 2 * math.ceil(AROUND / COLUMN) + 1, mode="nearest"))


def structures(volume: Volume, surface: Surface | None = None, *, room: float = 8.0) -> list[Structure]:
    """The structures of target in a volume, the largest first.

    Args:
        volume: What is known.
        surface: Of it, where it was read already.
        room: Metres of columns around each.
    """
    from scipy.ndimage import find_objects, label

    surface = volume.surface() if surface is None else surface
    is_target = surface.target > 0.5
    if not is_target.any():
        return []
    margin = math.ceil(room / COLUMN)
    low: IntArray = np.floor(surface.middles[:, :2].min(axis=0) / COLUMN).astype(np.int64) - margin
    at: IntArray = np.floor(surface.middles[:, :2] / COLUMN).astype(np.int64) - low
    shape = tuple(at.max(axis=0)[::-1] + 1 + margin)
    highest, area = np.full(shape, -np.inf), np.zeros(shape)
    mine = at[is_target]
    np.maximum.at(highest, (mine[:, 1], mine[:, 0]), surface.middles[is_target, 2])
    np.add.at(area, (mine[:, 1], mine[:, 0]), surface.area[is_target])
    ground = lowest_around(lowest_in(at[:, ::-1], surface.middles[:, 2], shape))
    stands = highest - ground >= STANDS
    near = _grown(stands, 0.5 * JOINED)
    labels, _ = label(near)
    found = []
    for number, box in enumerate(find_objects(labels), start=1):
        part = labels[box] == number
        columns = stands[box] & part
        known = float(area[box][part].sum())
        if known < LEAST:
            continue
        rows, cols = box
        mask = np.pad(columns, margin)
        found.append(
            Structure(
                west=float(low[0] + cols.start - margin) * COLUMN,
                south=float(low[1] + rows.start - margin) * COLUMN,
                mask=mask,
                ground=float(ground[box][columns].min()),
                top=float(highest[box][columns].max()),
                area=known,
            )
        )
    return sorted(found, key=lambda one: -one.area)


def clearance(surface: Surface, position: tuple[float, float, float], radius: float) -> tuple[float, float]:
    """Metres from a position to the highest surface below it and the lowest above; inf where none is known.

    Args:
        surface: All that is known.
        position: x, y and z, metres in the world.
        radius: Metres around it within which surface lies below or above.
    """
    x, y, z = position
    near = surface.middles[np.hypot(surface.middles[:, 0] - x, surface.middles[:, 1] - y) <= radius, 2]
    below, above = near[near <= z], near[near > z]
    return (
        float(z - below.max()) if len(below) else math.inf,
        float(above.min() - z) if len(above) else math.inf,
    )


def _grown(mask: BoolArray, radius: float) -> BoolArray:
    """The mask with all columns whose middles lie within a radius of one of its own."""
    from scipy.ndimage import distance_transform_edt

    if not mask.any():
        return mask
    return np.asarray(distance_transform_edt(~mask) * COLUMN <= radius)


def _length(line: FloatArray) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def _turns_right(line: FloatArray) -> bool:
    x, y = line.T
    return float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum()) < 0.0
