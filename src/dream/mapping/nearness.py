"""What lies near some cells."""

from __future__ import annotations

import math

import numpy as np

from dream.types import BoolArray, IntArray


def within(cells: BoolArray, distance: float, cell: float) -> BoolArray:
    """(rows, cols) cells whose middle is no farther than `distance` metres from that of one of the cells.

    Args:
        cells: (rows, cols).
        distance: Metres.
        cell: Side of a cell, metres.
    """
    from dream.mapping._kernels import nearness

    near = np.zeros(cells.shape, np.bool_)
    rows, cols = (np.flatnonzero(cells.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return near
    # Of a large map only what could be near is looked at.
    margin = math.ceil(distance / cell)
    window = tuple(slice(max(k[0] - margin, 0), k[-1] + margin + 1) for k in (rows, cols))
    wide = columns_near(distance, cell, most=max(cells.shape))
    near[window] = nearness.within(np.ascontiguousarray(cells[window]), wide)
    return near


def columns_near(distance: float, cell: float, *, most: int | None = None) -> IntArray:
    """(n,) columns that are no farther away, in rows that are none, one, two and so on away.

    Args:
        distance: Metres.
        cell: Side of a cell, metres.
        most: Rows and columns past which none is asked about.
    """
    reach = math.ceil(distance / cell)
    steps = np.square(np.arange((reach if most is None else min(reach, most)) + 1) * cell)
    wide: IntArray = (np.sqrt(steps[:, None] + steps) <= distance).sum(axis=1) - 1
    return wide[wide >= 0]
