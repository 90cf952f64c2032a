"""How far a tether lets the vehicle go, by what the map knows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream.geometry import FloatArray

if TYPE_CHECKING:
    from dream.mapping._kernels.strings import FreeWater

ENDLESS = 1e6
"""Metres above and below within which a planar map's cell is the same."""


@dataclass(frozen=True, slots=True)
class Leash:
    """The longest string from a place that the vehicle may go on.

    What it does: a place is within it where some way through water that is known to be free, straight or
    round corners, is no longer. Which way the tether really lies counts for nothing here.
    Reference: Nash et al., Theta*: Any-Angle Path Planning on Grids, 2007.
    """

    anchor: tuple[float, float, float]
    """x, y and z, metres in the world."""
    metres: float
    closed: tuple[tuple[tuple[float, float, float], float], ...] = ()
    """Places to which no way leads on it, and how far around each it reaches no point."""

    def lengths(
        self, water: FreeWater, first: FloatArray, spacing: float, shape: tuple[int, int, int]
    ) -> FloatArray:
        """Metres of string that the points of a grid take; infinite where they take more than there is.

        Args:
            water: What is known to be free.
            first: (3,) x, y and z of the first point.
            spacing: Metres between points.
            shape: Levels, rows and columns.
        """
        from dream.mapping._kernels import strings as kernels

        lengths = np.asarray(
            kernels.lengths(water, np.array(self.anchor), first, spacing, shape, self.metres)
        )
        x, y, z = (first[k] + spacing * np.arange(shape[2 - k]) for k in range(3))
        for place, radius in self.closed:
            away = np.hypot((z - place[2])[:, None], y - place[1])[:, :, None]
            lengths[np.hypot(away, x - place[0]) <= radius] = np.inf
        return lengths


def flat_water(free: npt.NDArray[np.bool_], corner: tuple[float, float], cell: float) -> FreeWater:
    """Water of the same kind at all heights.

    Args:
        free: (rows, cols).
        corner: x and y of the lower left one.
        cell: Metres of a side.
    """
    from dream.mapping._kernels.strings import FreeWater

    low, sides = np.array([*corner, -ENDLESS]), np.array([cell, cell, 2.0 * ENDLESS])
    # A copy: for arrays that may not be written to, all kernels would be compiled once more.
    return FreeWater(np.array(free[None], np.uint8), low, sides)
