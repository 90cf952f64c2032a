"""The numbered yellow discs in a picture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from dream.standin.sight import INK, MARK, Bool, UInt8, UnreadableError, is_color

RADIUS = 9
"""Of a disc, pixels."""
OUTER = 11
"""Radius of all that belongs to a disc, its dark edge too; pixels."""
DIGIT = 14
"""Height of its number, pixels."""
HIGHEST = 99
LEAST_SEEN = 0.4
"""Of a disc's rim: where other discs cover more of it, it is not looked for."""
LEAST_RIM = 0.7
"""Of what is seen of the rim, yellow; a number of two digits takes some of it."""
LEAST_YELLOW = 80
"""Pixels around the centre of a disc, at least."""
LEAST_FIT = 0.97
"""Of the pixels of a disc that nothing covers, equal to those of its number."""
LEAST_LEAD = 3
"""Pixels by which a number must fit better than any other."""


@dataclass(frozen=True, slots=True)
class Disc:
    """A numbered disc."""

    number: int
    column: int
    """Of its centre, pixels from the left."""
    row: int
    """Pixels from the top."""


def read_marks(picture: UInt8, name: str) -> tuple[Disc, ...]:
    """All numbered discs, by number.

    Args:
        picture: (H, W, 3) uint8.
        name: Of the picture, for the error.

    Raises:
        UnreadableError: A disc is there whose number cannot be read, or two have the same.
    """
    yellow = is_color(picture, MARK)
    if np.count_nonzero(yellow) < 30:
        return ()
    ink = is_color(picture, INK)
    covered = np.zeros(yellow.shape, np.bool_)
    candidates = _candidates(yellow)
    rim = np.argwhere(_within(RADIUS - 0.6) & ~_within(RADIUS - 2.4)) - RADIUS
    found: list[Disc] = []
    while len(candidates):
        rows = candidates[:, :1] + rim[:, 0]
        columns = candidates[:, 1:] + rim[:, 1]
        free = ~covered[rows, columns]
        share = (yellow[rows, columns] & free).sum(axis=1) / np.maximum(free.sum(axis=1), 1)
        good = (free.mean(axis=1) >= LEAST_SEEN) & (share >= LEAST_RIM)
        candidates, share, free = candidates[good], share[good], free[good]
        if not len(candidates):
            break
        # The uppermost are whole; of the one below, only what is not covered counts.
        best = candidates[np.lexsort((-share, -free.sum(axis=1)))[0]]
        near = candidates[((candidates - best) ** 2).sum(axis=1) <= 8]
        disc, row, column = max(
            (_number(yellow, ink, covered, int(row), int(column)), int(row), int(column))
            for row, column in near
        )
        if disc.fit < LEAST_FIT or disc.lead < LEAST_LEAD:
            raise UnreadableError(
                f"[{name}]: expected a number on the yellow disc at pixel ({column}, {row}), got "
                f"{100.0 * disc.fit:.0f} % of {disc.number}, {disc.lead} pixels more than of any other"
            )
        found.append(Disc(disc.number, column, row))
        rows, columns = np.ogrid[: yellow.shape[0], : yellow.shape[1]]
        covered |= (rows - row) ** 2 + (columns - column) ** 2 <= OUTER**2
        candidates = candidates[((candidates - (row, column)) ** 2).sum(axis=1) > 8]
    numbers = [disc.number for disc in found]
    if len(set(numbers)) != len(numbers):
        raise UnreadableError(f"[{name}]: expected each number once, got the marks {sorted(numbers)}")
    return tuple(sorted(found, key=lambda disc: disc.number))


def _candidates(yellow: Bool) -> npt.NDArray[np.int64]:
    """(N, 2) rows and columns where there is so much yellow around that a disc may have its centre there."""
    side = 2 * RADIUS + 1
    around = ndimage.uniform_filter(yellow.astype(np.float32), side, mode="constant") * side * side
    core = ndimage.binary_opening(yellow, np.ones((3, 3), np.bool_))
    dense = (around > LEAST_YELLOW) & ndimage.maximum_filter(core, side, mode="constant")
    # Discs stand wholly on the picture.
    dense[:RADIUS] = dense[-RADIUS:] = dense[:, :RADIUS] = dense[:, -RADIUS:] = False
    return np.argwhere(dense)


@dataclass(frozen=True, slots=True, order=True)
class _Guess:
    """The number that fits a disc best."""

    fit: float
    """Part of what is seen that fits, 0 to 1."""
    lead: int
    """Pixels more than of any other number."""
    number: int


def _number(yellow: Bool, ink: Bool, covered: Bool, row: int, column: int) -> _Guess:
    """Of the disc with its centre there."""
    inner = np.argwhere(_within(RADIUS - 1.2))
    rows, columns = row + inner[:, 0] - RADIUS, column + inner[:, 1] - RADIUS
    seen = ~covered[rows, columns]
    rows, columns, inner = rows[seen], columns[seen], inner[seen]
    dark = _numbers()[:, inner[:, 0], inner[:, 1]]
    fits = np.where(dark, ink[rows, columns], yellow[rows, columns]).sum(axis=1)
    order = np.argsort(-fits, kind="stable")
    best, second = int(fits[order[0]]), int(fits[order[1]])
    return _Guess(best / max(len(rows), 1), best - second, int(order[0]) + 1)


def _within(radius: float) -> Bool:
    """(19, 19), true in a disc around the middle."""
    rows, columns = np.ogrid[-RADIUS : RADIUS + 1, -RADIUS : RADIUS + 1]
    disc: Bool = rows**2 + columns**2 <= radius**2
    return disc


@lru_cache(maxsize=1)
def _numbers() -> Bool:
    """(99, 19, 19), true where the ink of each number is."""
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.load_default(DIGIT)
    side = 2 * RADIUS + 1
    drawn = []
    for number in range(1, HIGHEST + 1):
        picture = Image.new("L", (side, side), 0)
        pen = ImageDraw.Draw(picture)
        pen.fontmode = "1"
        pen.text((RADIUS, RADIUS), str(number), fill=255, font=font, anchor="mm")
        drawn.append(np.asarray(picture) > 0)
    return np.array(drawn)
