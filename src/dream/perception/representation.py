"""What a frame shows without its colours: how near things are, and where the target is.

A policy that sees nothing else cannot learn what water, sand or shells look like, so that it may be tried on
wrecks and in a tank after it was taught on reefs. The idea is that of UIVNav (arXiv 2309.08806), which
publishes no formula; this one is ours.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

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
    least = CLOSEST * altitude
    nearness = least / np.maximum(np.where(returned, depth, np.inf), least, dtype=np.float64)
    parts = np.stack([nearness, returned, labels == Label.TARGET])
    near, seen, target = _sums(_sums(parts, HEIGHT).swapaxes(1, 2), WIDTH).swapaxes(1, 2)
    blocks = np.stack([near / np.maximum(seen, 1.0), target / depth.size])
    levels: UInt8Array = np.rint(255.0 * np.clip(blocks, 0.0, 1.0)).astype(np.uint8)
    return levels


def _sums(images: npt.NDArray[np.float64], blocks: int) -> npt.NDArray[np.float64]:
    """(n, blocks, k): sums over equal blocks of the rows of images (n, m, k), in parts of which a row has
    `blocks` and a block m, so that whole numbers have exact sums.

    Not by a product of matrices, which would wake the threads of a linear algebra library for a millisecond.
    """
    count = images.shape[1]
    row, part = np.divmod(np.arange(blocks + 1) * count, blocks)
    above = np.zeros((len(images), count + 1, images.shape[2]))
    np.cumsum(images, axis=1, out=above[:, 1:])
    up_to = blocks * above[:, row] + part[:, None] * images[:, np.minimum(row, count - 1)]
    return np.diff(up_to, axis=1)
