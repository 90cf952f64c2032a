"""A box of a volume, as an array."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dream.types import IntArray, UInt8Array

if TYPE_CHECKING:
    from dream.mapping.volume import Volume


def states_in(volume: Volume, first: IntArray, shape: tuple[int, int, int]) -> UInt8Array:
    """(levels, rows, cols) `State` of the voxels of a box.

    Args:
        volume: What is known.
        first: (3,) level, row and column of the box's first voxel, from the world's origin.
        shape: Of the box, in voxels.
    """
    from dream.mapping._kernels import volume_box as kernels

    states = np.empty(shape, np.uint8)
    kernels.states_in(volume._bricks, np.asarray(first, np.int64), states)
    return states
