"""Pictures as arrays, the colours they may have, and the error where one cannot be read."""

from __future__ import annotations

import io
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

Color = tuple[int, int, int]
UInt8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]

UNKNOWN, EXPLORED, TARGET, SOLID, SOLID_TARGET = range(5)
"""What a cell of the map may be."""
COLORS: tuple[Color, ...] = ((255, 255, 255), (127, 127, 127), (0, 200, 0), (0, 0, 0), (0, 95, 0))
"""Of what a cell may be, in that order."""
INSPECTED, SOLID_INSPECTED, FREE = 5, 6, 7
"""What a cell may be besides, in a picture of three dimensions."""
COLORS_IN_SPACE: tuple[Color, ...] = (*COLORS, (150, 90, 230), (80, 30, 140), (190, 215, 240))
"""Of all of those."""
TRAVERSED: Color = (0, 165, 110)
"""Of a target that was traversed, where that is asked for: a target like any other."""
VEHICLE: Color = (0, 70, 255)
TRAIL: Color = (0, 150, 255)
MARK: Color = (255, 201, 14)
INK: Color = (40, 40, 40)
WATER: Color = (60, 110, 190)
GRID_LINE: Color = (90, 90, 120)

LINE_OPACITY = 70
"""Of the thin lines of the grid, of 255."""
VIEW_OPACITY = 34
"""Of the sector in view, of 255."""
TOLERANCE = 3
"""Levels by which a colour may be off: blending rounds."""
OVERLAY = 100
"""A pixel of something that is drawn over the cells."""
STRANGE = 255
"""A pixel of no colour that means something."""
_TINTED = 10
MOST_PIXELS = 1 << 24
"""A larger picture is refused."""


class UnreadableError(ValueError):
    """A picture, or what is said about it, cannot be what it is said to be."""


def decode(png: bytes, name: str) -> UInt8:
    """A picture as (H, W, 3) uint8, or as (H, W) where it is gray.

    Raises:
        UnreadableError: It is no picture, or too large.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(png)) as picture:
            if picture.width * picture.height > MOST_PIXELS:
                raise UnreadableError(f"[{name}]: expected at most {MOST_PIXELS} pixels, got {picture.size}")
            return np.asarray(picture if picture.mode == "L" else picture.convert("RGB"))
    except (UnidentifiedImageError, OSError, SyntaxError) as error:
        raise UnreadableError(f"[{name}]: expected a PNG file, got something else") from error


def is_color(picture: UInt8, color: Color) -> Bool:
    """(H, W), true where a picture has exactly that colour."""
    red, green, blue = (picture[..., k] == color[k] for k in range(3))
    same: Bool = red & green & blue
    return same


def classes(picture: UInt8, colors: tuple[Color, ...] = COLORS) -> tuple[UInt8, Bool]:
    """What the cell under each pixel is, under thin lines too, and whether it is tinted as what is in view.

    Args:
        picture: (H, W, 3) uint8.
        colors: That cells may have.

    Returns:
        (H, W) what it is, `OVERLAY` or `STRANGE`; and (H, W), true in view.
    """
    codes: npt.NDArray[Any] = picture.astype(np.uint32)
    found = _table(colors)[codes[..., 0] << 16 | codes[..., 1] << 8 | codes[..., 2]]
    tinted = (found >= _TINTED) & (found < _TINTED + len(colors))
    return np.where(tinted, found - _TINTED, found), tinted


def _blend(below: Color, above: Color, opacity: int) -> Color:
    mixed = [round((b * (255 - opacity) + a * opacity) / 255) for b, a in zip(below, above, strict=True)]
    return mixed[0], mixed[1], mixed[2]


@lru_cache(maxsize=2)
def _table(colors: tuple[Color, ...]) -> UInt8:
    """(2^24,): the class of every colour."""
    table = np.full((256, 256, 256), STRANGE, np.uint8)

    def enter(color: Color, meaning: int) -> None:
        table[tuple(slice(max(c - TOLERANCE, 0), c + TOLERANCE + 1) for c in color)] = meaning

    for color in (VEHICLE, TRAIL, MARK, INK):
        enter(color, OVERLAY)
        enter(_blend(color, VEHICLE, VIEW_OPACITY), OVERLAY)
    for meaning, color in (*enumerate(colors), (TARGET, TRAVERSED)):
        lined = _blend(color, GRID_LINE, LINE_OPACITY)
        for plain in (color, lined):
            enter(plain, meaning)
            enter(_blend(plain, VEHICLE, VIEW_OPACITY), meaning + _TINTED)
    return table.reshape(-1)
