"""What a frame shows without its colours: how near things are, and where the target is.

A policy that sees nothing else cannot learn what water, sand or shells look like, so that it may be tried on
wrecks and in a tank after it was taught on reefs. The idea is that of UIVNav (arXiv 2309.08806), which
publishes no formula; this one is ours.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dream.types import Float32Array, Label, UInt8Array

HEIGHT, WIDTH = 72, 96
"""Of the representation, in pixels."""
CLOSEST = 0.25
"""Altitudes, along the optical axis, up to which nearness is greatest: 0.5 m at the 2 m of `dream-v1`."""
ALTITUDE = 2.0
"""Metres above the bare seabed, as `dream-v1` has it."""


def represent(depth: Float32Array, labels: UInt8Array, *, altitude: float = ALTITUDE) -> UInt8Array:
    """Nearness and share of target in every block of a frame.

    Depths count in altitudes, so that a flat floor looks the same from any height with the same camera.
    Nearness is a mean, not the greatest of a block: a block is 3.3 pixels of 320, 4 cm at 2 m, and nothing
    in the way is so thin, whereas the greatest of ten noisy depths is always too near. It is a mean over the
    pixels with a return only, so that the rim of a boulder before open water is as near as the boulder.

    Args:
        depth: (H, W) float32, metres along the optical axis; NaN where there is no return.
        labels: (H, W) uint8, values of `Label`.
        altitude: Metres of the camera above the bare seabed.

    Returns:
        (2, 72, 96) uint8. First 255 · min(1, 0.25 altitude / depth), 0 where nothing but water is seen; then
        255 times the share of pixels that are target.

    Raises:
        ValueError: The images are not two of one size, or the altitude is not above 0.
    """
    if depth.ndim != 2 or depth.shape != labels.shape or 0 in depth.shape:
        raise ValueError(
            f"labels: expected the shape of depth, (H, W), got {labels.shape} beside {depth.shape}. "
            "Are both of one observation?"
        )
    if not 0.0 < altitude < np.inf:
        raise ValueError(f"altitude: expected metres above 0, got {altitude}")
    returned = np.isfinite(depth) & (depth > 0.0) & (labels != Label.WATER)
    least = np.float32(CLOSEST * altitude)
    nearness = np.where(returned, least / np.maximum(np.where(returned, depth, least), least), 0.0)
    stack = np.stack([nearness, returned, labels == Label.TARGET]).astype(np.float32)
    near, seen, target = _overlaps(HEIGHT, depth.shape[0]) @ stack @ _overlaps(WIDTH, depth.shape[1]).T
    blocks = np.stack([near / np.maximum(seen, 1.0), target / np.float32(depth.size)])
    levels: UInt8Array = np.rint(255.0 * np.clip(blocks, 0.0, 1.0)).astype(np.uint8)
    return levels


@lru_cache(maxsize=8)
def _overlaps(blocks: int, pixels: int) -> Float32Array:
    """(blocks, pixels): how much of each pixel lies in each of the equal blocks of a line of pixels.

    In units of which a pixel has `blocks` and a block has `pixels`: whole numbers, whose sums are exact.
    """
    block, pixel = np.arange(blocks)[:, None] * pixels, np.arange(pixels)[None, :] * blocks
    overlap = np.minimum(block + pixels, pixel + blocks) - np.maximum(block, pixel)
    inside: Float32Array = np.maximum(overlap, 0).astype(np.float32)
    return inside
