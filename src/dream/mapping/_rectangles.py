"""Rectangles of cells or nodes, and the square blocks that they touch."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from dream.types import BoolArray, IntArray

Key = tuple[int, int]
"""Row and column of a block."""
Rectangle = tuple[int, int, int, int]
"""First row and column, past row and column."""


def widened(rectangle: Rectangle, margin: int) -> Rectangle:
    """With a margin on all sides."""
    row, col, past_row, past_col = rectangle
    return row - margin, col - margin, past_row + margin, past_col + margin


def box_of(key: Key, side: int) -> Rectangle:
    """What lies in a block."""
    return key[0] * side, key[1] * side, (key[0] + 1) * side, (key[1] + 1) * side


def blocks_of(rectangle: Rectangle, side: int) -> tuple[Key, tuple[int, int]]:
    """The first block that a rectangle touches, and how many rows and columns of them there are."""
    row, col, past_row, past_col = rectangle
    first = (row // side, col // side)
    return first, ((past_row - 1) // side + 1 - first[0], (past_col - 1) // side + 1 - first[1])


def blocks_in(rectangle: Rectangle, side: int) -> Iterator[Key]:
    """All blocks that a rectangle touches."""
    (row, col), (rows, cols) = blocks_of(rectangle, side)
    return itertools.product(range(row, row + rows), range(col, col + cols))


def blocks_among(rectangle: Rectangle, side: int, known: Collection[Key]) -> Iterable[Key]:
    """Those of the known blocks that a rectangle touches, however large it is."""
    _, (rows, cols) = blocks_of(rectangle, side)
    if rows * cols > len(known):
        return [key for key in known if meets(box_of(key, side), rectangle)]
    return [key for key in blocks_in(rectangle, side) if key in known]


def holds(outer: Rectangle, inner: Rectangle) -> bool:
    """Whether all of one lies in the other."""
    return outer[0] <= inner[0] and outer[1] <= inner[1] and outer[2] >= inner[2] and outer[3] >= inner[3]


def meets(one: Rectangle, other: Rectangle) -> bool:
    """Whether they share anything."""
    return one[0] < other[2] and one[1] < other[3] and one[2] > other[0] and one[3] > other[1]


def shared(one: Rectangle, other: Rectangle) -> Rectangle:
    """What lies in both; its end comes before its beginning where nothing does."""
    return max(one[0], other[0]), max(one[1], other[1]), min(one[2], other[2]), min(one[3], other[3])


def without(outer: Rectangle, inner: Rectangle) -> list[Rectangle]:
    """What is left of a rectangle, in strips."""
    row, col, past_row, past_col = outer
    low, left, high, right = inner
    if low >= high or left >= right:
        return [outer]
    strips = [
        (row, col, low, past_col),
        (high, col, past_row, past_col),
        (low, col, high, left),
        (low, right, high, past_col),
    ]
    return [strip for strip in strips if strip[0] < strip[2] and strip[1] < strip[3]]


@dataclass(frozen=True, slots=True)
class Window:
    """What counts as inside, and where it lies in the world. Answers count cells from its corner."""

    cells: Rectangle
    """Of the store."""
    origin: tuple[float, float]
    """World x and y of the corner of the store's cell (0, 0)."""
    cell: float
    """Metres."""
    area: Rectangle | None = None
    """What has to be seen, cells of the store; everything where None."""

    @property
    def low(self) -> Key:
        """First row and column."""
        return self.cells[:2]

    def center_of(self, row: float, col: float) -> tuple[float, float]:
        """World x and y of the middle of a cell of the window."""
        x = self.origin[0] + (col + self.cells[1] + 0.5) * self.cell
        y = self.origin[1] + (row + self.cells[0] + 0.5) * self.cell
        return float(x), float(y)

    def middle(self, cells: IntArray) -> tuple[float, float]:
        """World x and y of the mean of cells (n, 2) of the window."""
        return self.center_of(cells[:, 0].mean(), cells[:, 1].mean())


def inside(cells: IntArray, rectangle: Rectangle) -> BoolArray:
    """(n,) whether cells (n, 2) lie in a rectangle."""
    return np.asarray(((cells >= rectangle[:2]) & (cells < rectangle[2:])).all(axis=1))


def by_block(cells: IntArray, side: int) -> Iterator[tuple[Key, IntArray]]:
    """Cells (n, 2), sorted into their blocks."""
    keys = cells // side
    order = np.lexsort((keys[:, 1], keys[:, 0]))
    ends = np.flatnonzero(np.any(np.diff(keys[order], axis=0), axis=1)) + 1
    for mine in np.split(order, ends):
        if len(mine):
            yield (int(keys[mine[0], 0]), int(keys[mine[0], 1])), cells[mine]


def in_raster_order(parts: Iterable[IntArray]) -> IntArray:
    """Cells (n, 2) of all parts by row, then column, each once; as one number each they sort much faster."""
    some = [cells for cells in parts if len(cells)]
    if not some:
        return np.zeros((0, 2), np.int64)
    cells = np.concatenate(some)
    flat = np.sort((cells[:, 0] << 32) + cells[:, 1])
    flat = flat[np.append(True, flat[1:] != flat[:-1])]
    row = (flat + (1 << 31)) >> 32
    return np.stack((row, flat - (row << 32)), axis=1)


def frozen(cells: IntArray) -> IntArray:
    """The same, read-only."""
    cells.flags.writeable = False
    return cells
