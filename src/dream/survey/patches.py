"""Where shell covers the ground → patches of reef, their outlines and dimensions.

The reef is the morphological closing, by a disc of `CLOSING` metres, of the ground that target covers seen
from straight above: bare ground less than twice that across, between shells, is reef. A patch is a connected
part of it of at least `SMALLEST` square metres. So neither depends on the cell they are drawn in.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dream.types import BoolArray

Float64Array = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]

CLOSING = 0.5
"""Metres: the radius of the disc. Crusts of oysters have bare spots of up to a metre."""
SMALLEST = 1.0
"""Square metres: a lone clump, or a false target, is no patch."""


def closed(cover: BoolArray, cell: float, radius: float = CLOSING) -> BoolArray:
    """The closing of a mask by a disc: what no disc that touches no covered cell reaches.

    Args:
        cover: (rows, cols).
        cell: Metres.
        radius: Of the disc, metres.
    """
    from scipy import ndimage

    if not cover.any():
        return cover.copy()
    margin = math.ceil(radius / cell) + 2
    rows, cols = (np.flatnonzero(cover.any(axis=axis)) for axis in (1, 0))
    box = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    wide = np.pad(cover[box], margin)
    grown = ndimage.distance_transform_edt(~wide, cell) <= radius
    shrunk = ndimage.distance_transform_edt(grown, cell) > radius
    inner = (shrunk | wide)[margin:-margin, margin:-margin]
    full = np.zeros_like(cover)
    full[box] = inner
    return full


def parts(mask: BoolArray, cell: float, smallest: float = SMALLEST) -> tuple[Int32Array, int]:
    """(rows, cols) the patch of each cell, −1 for none, the largest first; and how many there are."""
    from scipy import ndimage

    marks, count = ndimage.label(mask, np.ones((3, 3)))
    sizes = np.bincount(marks.ravel(), minlength=count + 1)
    sizes[0] = 0
    order = np.argsort(-sizes, kind="stable")
    order = order[sizes[order] * cell * cell >= smallest]
    number = np.full(count + 1, -1, np.int32)
    number[order] = np.arange(len(order), dtype=np.int32)
    return number[marks], len(order)


def rings(mask: BoolArray, corner: tuple[float, float], cell: float) -> tuple[Float64Array, ...]:
    """The outline of a connected mask, and its holes.

    Lines join the middles of the sides between a cell of the mask and one that is not (marching squares).

    Args:
        mask: (rows, cols); parts that touch at a corner only are apart, but come as rings all the same.
        corner: x and y of the lower left corner of the grid.
        cell: Metres.

    Returns:
        Closed rings (K, 2), metres: the outline first, counter-clockwise, then holes, clockwise.
    """
    wide = np.pad(mask, 1)
    sides: dict[tuple[int, int, int], tuple[int, int, int]] = {}
    # A side runs with the mask on its left: (row, col, direction) of the node it starts at; 0 east, 1 north,
    # 2 west, 3 south. Node (r, c) is the lower left corner of cell (r, c).
    inside, below = wide[1:, 1:], wide[:-1, 1:]
    left = wide[1:, :-1]
    for direction, found in (
        (0, inside & ~below),
        (2, ~inside & below),
        (1, left & ~inside),
        (3, ~left & inside),
    ):
        for r, c in np.argwhere(found):
            # An eastward side starts at its own node, a westward one a node further east; and so upwards.
            start = {0: (r, c), 2: (r, c + 1), 1: (r, c), 3: (r + 1, c)}[direction]
            sides[int(start[0]), int(start[1]), direction] = (int(r), int(c), direction)
    step = ((0, 1), (1, 0), (0, -1), (-1, 0))
    outlines = []
    while sides:
        first = next(iter(sides))
        at, line = first, []
        while at in sides:
            del sides[at]
            r, c, direction = at
            dr, dc = step[direction]
            line.append((c + 0.5 * dc, r + 0.5 * dr))
            r, c = r + dr, c + dc
            # Left first: parts that touch at a corner stay apart, also where the ring began at one.
            onward = ((r, c, (direction + turn) % 4) for turn in (1, 0, 3))
            at = next(side for side in onward if side in sides or side == first)
        line.append(line[0])
        outlines.append(_straightened(np.array(line)) * cell + corner)
    outlines.sort(key=lambda ring: -signed_area(ring))
    return tuple(outlines)


def signed_area(ring: Float64Array) -> float:
    """Square metres in a closed ring; negative where it runs clockwise."""
    x, y = (ring - ring[0]).T
    return float(0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def grouped(rings: Sequence[Float64Array]) -> list[list[Float64Array]]:
    """Polygons of closed rings: each counter-clockwise one, then the clockwise ones that are its holes.

    Parts of one patch that touch at a corner are polygons of their own.
    """
    areas = [signed_area(ring) for ring in rings]
    outlines = [n for n, area in enumerate(areas) if area > 0.0]
    polygons = {n: [rings[n]] for n in outlines}
    # Of many outlines only few lie around a hole: whose boxes do is soon found.
    low = np.array([rings[n].min(axis=0) for n in outlines]).reshape(-1, 2)
    high = np.array([rings[n].max(axis=0) for n in outlines]).reshape(-1, 2)
    for n, ring in enumerate(rings):
        if areas[n] > 0.0:
            continue
        # Rings may share corners, but no side: its middle is clearly inside an outline, or clearly not.
        middle = 0.5 * (ring[0] + ring[1])
        near = np.flatnonzero(((low <= middle) & (middle <= high)).all(axis=1))
        around = [outlines[k] for k in near if _contains(rings[outlines[k]], middle)]
        if around:
            polygons[min(around, key=areas.__getitem__)].append(ring)
    return list(polygons.values())


def _contains(ring: Float64Array, point: Float64Array) -> bool:
    """Is the point inside? By the crossings of a ray to the east."""
    (x0, y0), (x1, y1) = ring[:-1].T, ring[1:].T
    crosses = (y0 > point[1]) != (y1 > point[1])
    at = x0[crosses] + (point[1] - y0[crosses]) * (x1 - x0)[crosses] / (y1 - y0)[crosses]
    return bool(np.count_nonzero(at > point[0]) % 2)


def perimeter(outline: tuple[Float64Array, ...]) -> float:
    """Metres along the rings."""
    return float(sum(np.hypot(*np.diff(ring, axis=0).T).sum() for ring in outline))


def calipers(points: Float64Array) -> tuple[float, float]:
    """Greatest and least distance between two parallel lines that hold all the points between them.

    Args:
        points: (N, 2) metres, N ≥ 1.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        reach = points - points.mean(axis=0)
        return 2.0 * float(np.hypot(*reach.T).max()), 0.0
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.column_stack([-edges[:, 1], edges[:, 0]]) / np.hypot(*edges.T)[:, None]
    along = normals @ corners.T
    apart = corners[:, None] - corners[None]
    return float(np.hypot(apart[..., 0], apart[..., 1]).max()), float(np.ptp(along, axis=1).min())


def _straightened(line: Float64Array) -> Float64Array:
    """A closed line without the points that lie on the way between their neighbours."""
    body = line[:-1]
    before, after = body - np.roll(body, 1, axis=0), np.roll(body, -1, axis=0) - body
    bends = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]) > 1e-9
    kept = body[bends] if np.count_nonzero(bends) >= 3 else body
    return np.concatenate([kept, kept[:1]])
