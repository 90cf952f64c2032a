"""How high a reef stands above the seabed around it, and how rough it is.

The seabed under a reef is nowhere seen. Here it is the membrane that the seabed around holds: the harmonic
surface over the reef through the bare ground at its rim. Heights are above that; so simulated and real reefs
are measured alike, with nothing said of what lies beneath.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.types import BoolArray

Float64Array = npt.NDArray[np.float64]

RIM = 0.25
"""Metres around the reef that the membrane spans as well: there its foot is."""
CHAIN = 0.10
"""Metres: the link of the chain that rugosity is measured with."""


@dataclass(frozen=True, slots=True, eq=False)
class Relief:
    """Heights above the seabed, on the grid of a map."""

    base: Float64Array
    """(rows, cols) world z of the seabed, spanned where reef covers it; NaN where nothing is."""
    above: Float64Array
    """(rows, cols) mean height of the top above it; NaN where it was not seen."""
    cell: float
    """Metres."""


def averaged(values: Float64Array, valid: BoolArray, times: int) -> tuple[Float64Array, Float64Array]:
    """Means over squares of `times` cells a side, and how many of each were valid.

    Args:
        values: (rows, cols); what is not valid may be NaN.
        valid: (rows, cols).
        times: Cells along a square.
    """
    pad = [(0, -side % times) for side in values.shape]
    kept = np.pad(np.where(valid, values, 0.0), pad)
    counted = np.pad(valid, pad)
    shape = (kept.shape[0] // times, times, kept.shape[1] // times, times)
    total = kept.reshape(shape).sum(axis=(1, 3))
    count = counted.reshape(shape).sum(axis=(1, 3)).astype(np.float64)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0), count


def spanned(height: Float64Array, under: BoolArray) -> Float64Array:
    """A surface that keeps what is known and is harmonic elsewhere under a mask.

    Args:
        height: (rows, cols) world z of the ground; NaN where nothing was seen.
        under: (rows, cols) where the seabed is hidden. What was not seen beside it is spanned as well.

    Returns:
        (rows, cols): `height` where it is bare and seen; NaN where nothing bare can be reached.
    """
    from scipy import ndimage, sparse
    from scipy.sparse.linalg import spsolve

    open_ = under | ~np.isfinite(height)
    # Unseen ground far from any reef needs no value.
    wanted = open_ & ndimage.binary_dilation(under, np.ones((3, 3), np.bool_), iterations=4)
    marks, count = ndimage.label(wanted)
    surface = np.where(open_, np.nan, height)
    known = np.isfinite(surface)
    # A part that touches nothing known has no height.
    touching = np.unique(marks[ndimage.binary_dilation(known) & wanted])
    wanted &= np.isin(marks, touching[touching > 0]) if count else False
    if not wanted.any():
        return surface
    number = np.full(wanted.shape, -1)
    number[wanted] = np.arange(np.count_nonzero(wanted))
    rows, cols = np.nonzero(wanted)
    diagonal, right = np.zeros(len(rows)), np.zeros(len(rows))
    pairs: list[tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]] = []
    for dr, dc in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        r, c = rows + dr, cols + dc
        valid = (r >= 0) & (c >= 0) & (r < wanted.shape[0]) & (c < wanted.shape[1])
        r, c = np.where(valid, r, 0), np.where(valid, c, 0)
        free, fixed = valid & wanted[r, c], valid & known[r, c]
        diagonal += free | fixed
        right[fixed] += surface[r[fixed], c[fixed]]
        pairs.append((np.flatnonzero(free), number[r[free], c[free]]))
    at = np.concatenate([pair[0] for pair in pairs])
    to = np.concatenate([pair[1] for pair in pairs])
    laplace = sparse.diags(diagonal) - sparse.coo_matrix(
        (np.ones(len(at)), (at, to)), shape=(len(rows), len(rows))
    )
    surface[wanted] = spsolve(laplace.tocsc(), right)
    return surface


def chain_ratio(height: Float64Array, inside: BoolArray) -> float | None:
    """Length of a chain laid over the ground, over its length from straight above, along rows and columns.

    Args:
        height: (rows, cols) mean heights over squares of `CHAIN` metres; NaN where nothing was seen.
        inside: (rows, cols) what counts.

    Returns:
        1 on level ground; None where fewer than ten links were seen.
    """
    links = []
    for axis in (0, 1):
        rise = np.diff(height, axis=axis)
        pair = inside & np.roll(inside, -1, axis=axis)
        seen = np.isfinite(rise) & (pair[:-1] if axis == 0 else pair[:, :-1])
        links.append(np.sqrt(1.0 + np.square(rise[seen] / CHAIN)))
    every = np.concatenate(links)
    return float(every.mean()) if len(every) >= 10 else None
