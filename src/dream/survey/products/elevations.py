"""A structure as its sides look from outside: what was inspected, what was seen, where it may go on."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.survey.survey import OPEN, SEEN, SurveyedStructure

Float64Array = npt.NDArray[np.float64]
Color = tuple[int, int, int]

PAPER: Color = (255, 255, 255)
BEHIND: Color = (226, 231, 233)
"""What of the structure belongs to another side, for its shape."""
INSPECTED: Color = (0, 120, 110)
SEEN_ALONE: Color = (240, 160, 50)
MAY_GO_ON: Color = (122, 28, 92)
LEGEND: Mapping[str, Color] = {
    "inspected": INSPECTED,
    "seen, not inspected": SEEN_ALONE,
    "may go on, never seen": MAY_GO_ON,
    "other sides": BEHIND,
}
ORDER = (1, 2, 0, 3, 4, 5)
"""Sides as they are drawn: each long one, and the end that lies to its right."""
ENLARGED = 6
"""Pixels a side of a cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Elevation:
    """One side from outside, without perspective. All views of a structure have one scale."""

    index: int
    """Of the side, in `SurveyedStructure.sides`."""
    colors: npt.NDArray[np.uint8]
    """(rows, cols, 3) sRGB, one cell a pixel; the first row is the highest."""
    right: float
    """World bearing of what is on the right, radians."""

    def png(self) -> bytes:
        """As a file, each cell a square of pixels."""
        from PIL import Image

        large = self.colors.repeat(ENLARGED, axis=0).repeat(ENLARGED, axis=1)
        content = io.BytesIO()
        Image.fromarray(large).save(content, "PNG", optimize=True)
        return content.getvalue()


def views(structure: SurveyedStructure) -> list[Elevation]:
    """The sides that have any surface, or where some may go on, in the order that they are drawn in."""
    present = set(structure.cells.side.tolist())
    return [_view(structure, index) for index in ORDER if index in present]


def extents(structure: SurveyedStructure) -> tuple[float, float, float]:
    """Metres along its axis, across it and up, that the views show."""
    along = _directions(structure.axis, structure.sides[4].bearing, below=False)
    ahead, across = (structure.cells.position @ way for way in along[:2])
    up = structure.cells.position[:, 2]
    longest, widest, highest = (float(np.ptp(part)) + structure.cell for part in (ahead, across, up))
    return longest, widest, highest


def _directions(
    axis: float, bearing: float | None, *, below: bool
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Unit vectors of a view: to the right, up, and towards who looks.

    Args:
        axis: Of the structure, radians.
        bearing: That the side looks in; None of what is looked at from above, or from below.
        below: Whether it is.
    """
    if bearing is None:
        turn = -1.0 if below else 1.0
        right = np.array([math.cos(axis), math.sin(axis), 0.0])
        up = turn * np.array([-math.sin(axis), math.cos(axis), 0.0])
        return right, up, np.array([0.0, 0.0, turn])
    towards = np.array([math.cos(bearing), math.sin(bearing), 0.0])
    return np.array([-towards[1], towards[0], 0.0]), np.array([0.0, 0.0, 1.0]), towards


def _view(structure: SurveyedStructure, index: int) -> Elevation:
    cells, side = structure.cells, structure.sides[index]
    right, up, towards = _directions(structure.axis, side.bearing, below=side.kind == "underside")
    flat = np.stack([cells.position @ right, cells.position @ up], axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    cols, rows = np.rint((flat - low) / structure.cell).astype(np.int64).T
    width, height = np.rint((high - low) / structure.cell).astype(np.int64) + 1
    colors = np.full((height, width, 3), PAPER, np.uint8)
    colors[height - 1 - rows, cols] = BEHIND
    own = np.flatnonzero(cells.side == index)
    # Of several at one place the last one stays, which is the nearest.
    own = own[np.argsort(cells.position[own] @ towards, kind="stable")]
    state = cells.state[own]
    paint = np.where(
        (state == OPEN)[:, None],
        np.array(MAY_GO_ON),
        np.where((state == SEEN)[:, None], np.array(SEEN_ALONE), np.array(INSPECTED)),
    )
    colors[height - 1 - rows[own], cols[own]] = paint
    return Elevation(index, colors, math.atan2(right[1], right[0]))
