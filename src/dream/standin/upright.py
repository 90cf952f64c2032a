"""What an upright cut shows: its scales, what lies ahead of the vehicle at which depth, and the vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dream.standin import sight
from dream.standin.lettering import darkness, first_number
from dream.standin.sight import Bool, Floats, UInt8, UnreadableError

LETTER = 13
"""Height of its figures, pixels."""
KINDS = (sight.UNKNOWN, sight.FREE, sight.SOLID, sight.TARGET, sight.INSPECTED)
"""What may be seen of the water in it."""
FIRM = (sight.SOLID, sight.TARGET, sight.INSPECTED)
"""Those that a body cannot pass."""
OFF = 4
"""Pixels by which the vehicle may be drawn beside the zero of the figures."""


@dataclass(frozen=True, slots=True, eq=False)
class Upright:
    """An upright cut as it was read."""

    cells: UInt8
    """(rows, cols) what lies at each pixel, one of `KINDS`; rows from above, the bow to the right."""
    per_metre: float
    """Pixels."""
    top: float
    """Metres under water of the upper edge."""
    left: float
    """Metres ahead of the vehicle of the left edge."""
    depth: float
    """Metres under water of the vehicle."""

    def look(self, ahead: Floats, depth: Floats) -> UInt8:
        """What lies so far ahead of the vehicle and so deep, metres; unknown beyond the edge."""
        cols = np.floor((ahead - self.left) * self.per_metre).astype(np.int64)
        rows = np.floor((depth - self.top) * self.per_metre).astype(np.int64)
        inside = (rows >= 0) & (rows < self.cells.shape[0]) & (cols >= 0) & (cols < self.cells.shape[1])
        found = self.cells[np.where(inside, rows, 0), np.where(inside, cols, 0)]
        return np.where(inside, found, np.uint8(sight.UNKNOWN)).astype(np.uint8)

    def is_free(self, advance: float, climb: float, radius: float, half_height: float) -> bool:
        """Is all that a body would sweep on a straight move free?"""
        along, across, up = np.meshgrid(
            np.linspace(0.0, 1.0, 9),
            np.linspace(-radius, radius, 5),
            np.linspace(-half_height, half_height, 5),
        )
        swept = self.look(along * advance + across, self.depth - along * climb - up)
        return bool((swept == sight.FREE).all())

    def below(self, ahead: float = 0.0) -> float:
        """Metres from the vehicle's depth down to the first that is firm, so far ahead; inf where none is."""
        down = np.arange(0.0, 30.0, 0.5 / self.per_metre)
        firm = np.isin(self.look(np.full(down.shape, ahead), self.depth + down), FIRM)
        return float(down[firm.argmax()]) if firm.any() else np.inf


def read_upright(picture: UInt8) -> Upright:
    """All that the picture of an upright cut shows.

    Args:
        picture: (H, W, 3) uint8.

    Raises:
        UnreadableError: Something that belongs there is missing, or of a colour that means nothing.
    """
    if picture.ndim != 3:
        raise UnreadableError("[slice]: expected colours, got gray")
    top, left, bottom, right = _frame(picture)
    ink = sight.is_color(picture, sight.INK)
    across = left + np.flatnonzero(ink[bottom + 1 : bottom + 3, left : right + 1].all(axis=0))
    down = top + np.flatnonzero(ink[top : bottom + 1, left - 4 : left - 2].all(axis=1))
    if len(across) < 3 or len(down) < 3:
        raise UnreadableError(
            f"[slice]: expected marks along its edges, got {len(across)} below and {len(down)} on the left"
        )
    per_metre = float(np.median(np.diff(across)))
    if abs(per_metre - float(np.median(np.diff(down)))) > 0.5:
        raise UnreadableError("[slice]: expected metres of one length below and on the left")
    dark = darkness(picture)
    half = int(0.45 * per_metre)
    below = [dark[bottom + 5 : bottom + 7 + LETTER, max(c - half, 0) : c + half] for c in across]
    beside = [dark[r - LETTER // 2 - 2 : r + LETTER // 2 + 3, : left - 5] for r in down]
    first_ahead, first_deep = (_first(strips, "slice") for strips in (below, beside))
    plot = picture[top:bottom, left:right]
    seen, _ = sight.classes(plot, sight.COLORS_IN_SPACE)
    known = np.isin(seen, KINDS)
    strange = ~known & ~ndimage.binary_dilation(seen == sight.OVERLAY, iterations=2)
    if strange.any():
        row, col = np.argwhere(strange)[0]
        raise UnreadableError(
            f"[slice]: expected the colours of its legend, got {tuple(int(v) for v in plot[row, col])} at "
            f"{int(strange.sum())} pixels"
        )
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    row, column = _vehicle(sight.is_color(plot, sight.VEHICLE))
    start, deep = first_ahead - (across[0] - left) / per_metre, first_deep - (down[0] - top) / per_metre
    if abs(column / per_metre + start) * per_metre > OFF:
        raise UnreadableError(
            f"[slice]: expected the vehicle at 0 m ahead of itself, got {column / per_metre + start:.1f} m"
        )
    return Upright(seen[tuple(nearest)], per_metre, deep, start, deep + row / per_metre)


def _frame(picture: UInt8) -> tuple[int, int, int, int]:
    """First row and column inside the thin border, and the ones past the last."""
    ink = sight.is_color(picture, sight.INK)
    rows, cols = (np.flatnonzero(n > 0.9 * n.max()) for n in (ink.sum(axis=1), ink.sum(axis=0)))
    if len(rows) != 2 or len(cols) != 2 or ink.sum() < 400:
        raise UnreadableError(
            f"[slice]: expected a thin border, got {len(rows)} lines across and {len(cols)} down"
        )
    return int(rows[0]) + 1, int(cols[0]) + 1, int(rows[1]), int(cols[1])


def _first(strips: list[Floats], name: str) -> float:
    """The first of figures that rise by one."""
    return first_number(
        tuple((s.shape, s.tobytes()) for s in strips), tuple(range(len(strips))), 1.0, LETTER, name
    )


def _vehicle(blue: Bool) -> tuple[float, float]:
    """Row and column of the middle of its box, pixels of the plot."""
    body = ndimage.binary_opening(blue, np.ones((4, 4), np.bool_))
    if not body.any():
        raise UnreadableError("[slice]: expected the vehicle, a blue box, got none")
    rows, cols = np.nonzero(body)
    return float(rows.min() + rows.max() + 1) / 2.0, float(cols.min() + cols.max() + 1) / 2.0
