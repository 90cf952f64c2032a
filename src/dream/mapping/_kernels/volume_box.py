"""The states of all voxels of a box of a volume."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from numba import njit

from dream.mapping._kernels.volume import BITS, SIDE, find, state_of, within


@njit(cache=True, nogil=True)
def states_in(bricks, first, states):
    """Write the state of every voxel of a box.

    Args:
        bricks: What is known.
        first: (3,) int64 level, row and column of the box's first voxel.
        states: (levels, rows, cols) uint8, out; 0 where nothing is known.
    """
    levels, rows, cols = states.shape
    states[:] = 0
    for level in range(first[0] >> BITS, ((first[0] + levels - 1) >> BITS) + 1):
        for row in range(first[1] >> BITS, ((first[1] + rows - 1) >> BITS) + 1):
            for col in range(first[2] >> BITS, ((first[2] + cols - 1) >> BITS) + 1):
                slot = find(bricks, level, row, col)
                if slot == 0:
                    continue
                for h in range(max(level * SIDE, first[0]), min((level + 1) * SIDE, first[0] + levels)):
                    for r in range(max(row * SIDE, first[1]), min((row + 1) * SIDE, first[1] + rows)):
                        for c in range(max(col * SIDE, first[2]), min((col + 1) * SIDE, first[2] + cols)):
                            odds = bricks.log_odds[slot, within(h, r, c)]
                            states[h - first[0], r - first[1], c - first[2]] = state_of(odds)
