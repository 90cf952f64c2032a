"""Figures and words as they are written on pictures, read by their likeness to the same letters."""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np

from dream.standin.sight import Floats, UInt8, UnreadableError

FARTHEST = 400
"""Figures between 0 and the first of a row, at most."""


@lru_cache(maxsize=64)
def first_number(
    strips: tuple[tuple[tuple[int, ...], bytes], ...],
    phases: tuple[int, ...],
    spacing: float,
    letter: int,
    name: str,
) -> float:
    """What the first of some numbers says, judged by all of them.

    Args:
        strips: Shape and bytes of the darkness around each.
        phases: How many spacings each lies after the first.
        spacing: By which they rise.
        letter: Height of the letters, pixels.
        name: Of the picture, for the error.
    """
    pictures = [np.frombuffer(data, np.float64).reshape(shape) for shape, data in strips]

    @cache
    def fit(place: int, multiple: int) -> float:
        return likeness(pictures[place], written(f"{multiple * spacing:g}", letter))

    def joint(first: int) -> float:
        return float(np.mean([fit(place, first + k) for place, k in enumerate(phases)]))

    lone = sorted(range(-FARTHEST, FARTHEST + 1), key=lambda multiple: -fit(0, multiple))[:12]
    order = sorted(lone, key=lambda first: -joint(first))
    if joint(order[0]) < 0.8 or joint(order[0]) - joint(order[1]) < 0.03:
        raise UnreadableError(
            f"[{name}]: expected numbers along the border, got {joint(order[0]):.2f} of "
            f"{order[0] * spacing:g} and {joint(order[1]):.2f} of {order[1] * spacing:g} at the first"
        )
    return order[0] * spacing


def darkness(picture: UInt8) -> Floats:
    """(H, W), 0 on paper to 1 in ink."""
    dark: Floats = np.clip((244.0 - picture[..., 0]) / 204.0, 0.0, 1.0)
    return np.where(dark > 0.05, dark, 0.0)


@lru_cache(maxsize=4096)
def written(text: str, letter: int) -> Floats:
    """A text in the letters of the map, cut to its ink."""
    from PIL import Image, ImageDraw, ImageFont

    picture = Image.new("L", ((len(text) + 2) * letter, 3 * letter), 0)
    ImageDraw.Draw(picture).text((letter, letter), text, fill=255, font=ImageFont.load_default(letter))
    return _trimmed(np.asarray(picture) / 255.0)


def _trimmed(dark: Floats) -> Floats:
    rows, columns = (np.flatnonzero((dark > 0.25).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return np.zeros((1, 1))
    return dark[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def likeness(strip: Floats, text: Floats) -> float:
    """From 0 to 1: how much the ink of two pictures has in common, at the best of some shifts."""
    strip = _trimmed(strip)
    if abs(strip.shape[0] - text.shape[0]) > 2 or abs(strip.shape[1] - text.shape[1]) > 2:
        return 0.0
    shape = max(strip.shape[0], text.shape[0]) + 2, max(strip.shape[1], text.shape[1]) + 2
    still = np.zeros(shape)
    still[1 : 1 + strip.shape[0], 1 : 1 + strip.shape[1]] = strip
    best = 0.0
    for down in range(shape[0] - text.shape[0] + 1):
        for across in range(shape[1] - text.shape[1] + 1):
            part = still[down : down + text.shape[0], across : across + text.shape[1]]
            best = max(best, 2.0 * float((part * text).sum()) / float((still**2).sum() + (text**2).sum()))
    return best
