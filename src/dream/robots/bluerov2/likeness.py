"""Do two pictures of a camera show the same, whatever flickers in them?"""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np

from dream.robots.bluerov2.camera import opencv
from dream.types import Float32Array, UInt8Array

COLUMNS, ROWS, SIDE = 8, 6, 10
"""Blocks of a picture, and pixels of a block's side: pictures are compared at 80 × 60."""
GREY = np.array([0.299, 0.587, 0.114], np.float32)
"""Of red, green and blue (ITU-R BT.601)."""
FAINT = 1.0
"""Grey levels of 255: what varies less is no texture."""
ROUGH = 0.8
"""Grey levels that two pictures of the same may differ by, as they are rounded and encoded."""
ALIKE = 0.15
"""The same, as a share of the texture."""
NOISES = 2.0
"""Times the noise by which a block has to differ, to count as changed."""
RESTLESS = 0.5
"""Share of the texture from which on noise hides whether a block stayed the same."""
FOREIGN = 0.4
"""Correlation below which two blocks show different things, whatever the noise."""
ENOUGH = 0.25
"""Share of all blocks that must be able to tell; and that must stay the same where the picture does."""
MOST = 0.5
"""Share of those that are able to tell that stay the same in a picture that does: a clock or dirt that drifts
may change the others. While a vehicle moves, at least four in five change."""


class Likeness(enum.Enum):
    """Of two pictures."""

    SAME = enum.auto()
    CHANGED = enum.auto()
    UNTOLD = enum.auto()
    """Too little of them has a texture that rises above the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Glance:
    """A picture in small."""

    blocks: Float32Array
    """(48, 100) grey levels, without each block's own brightness and slope."""
    texture: Float32Array
    """(48,) grey levels: what neighbouring pixels have in common, root mean square, at least `FAINT`. Noise
    of single pixels is no part of it."""
    textured: float
    """Share of the blocks that have any."""


def glance(rgb: UInt8Array) -> Glance:
    """A picture, (H, W, 3) uint8, in small."""
    cv2 = opencv()
    small = cv2.resize(rgb, (COLUMNS * SIDE, ROWS * SIDE), interpolation=cv2.INTER_AREA) @ GREY
    blocks = small.reshape(ROWS, SIDE, COLUMNS, SIDE).swapaxes(1, 2).reshape(-1, SIDE * SIDE)
    blocks = blocks - (blocks @ _PLANES) @ _PLANES.T
    square = blocks.reshape(-1, SIDE, SIDE)
    beside = (square[:, :, 1:] * square[:, :, :-1]).mean(axis=(1, 2))
    below = (square[:, 1:] * square[:, :-1]).mean(axis=(1, 2))
    texture = np.sqrt(np.maximum(0.5 * (beside + below), FAINT**2))
    return Glance(blocks, texture, float((texture > FAINT).mean()))


def difference(one: Glance, other: Glance) -> Float32Array:
    """(48,): by how much blocks differ, root mean square, as a share of their texture.

    Each picture is measured by its own texture, so that a longer exposure changes nothing.
    """
    apart = one.blocks / one.texture[:, None] - other.blocks / other.texture[:, None]
    rms: Float32Array = np.sqrt((apart * apart).mean(axis=1))
    return rms


def likeness(one: Glance, other: Glance, noise: Float32Array) -> Likeness:
    """Do two pictures show the same?

    What it does: a block has changed where it differs by more than noise does, or where what it shows is not
    correlated with what it showed. It stayed the same where it did not change, although noise would not hide
    that. Most blocks decide. Blocks without texture have no say.

    Args:
        one: A picture.
        other: Another.
        noise: (48,) `difference` of pictures of the same view.
    """
    texture = np.maximum(one.texture, other.texture)
    apart = difference(one, other)
    common = (one.blocks * other.blocks).mean(axis=1) / (one.texture * other.texture)
    limit = np.maximum(np.maximum(NOISES * noise, ALIKE), ROUGH / texture)
    textured = texture > FAINT
    changed = textured & ((apart > limit) | (common < FOREIGN))
    same = textured & ~changed & (noise <= RESTLESS)
    changes, stays, enough = changed.sum(), same.sum(), ENOUGH * len(texture)
    if changes + stays < enough:
        return Likeness.UNTOLD
    if stays < MOST * (changes + stays):
        return Likeness.CHANGED
    return Likeness.SAME if stays >= enough else Likeness.UNTOLD


def _planes() -> Float32Array:
    """(100, 3): orthonormal columns of a block that is level, or slopes along either side."""
    along = np.arange(SIDE, dtype=np.float32) - 0.5 * (SIDE - 1)
    ones = np.ones(SIDE, np.float32)
    planes = np.stack([np.outer(ones, ones), np.outer(ones, along), np.outer(along, ones)])
    flat = planes.reshape(3, -1).T
    columns: Float32Array = flat / np.linalg.norm(flat, axis=0)
    return columns


_PLANES = _planes()
