"""Ground that could still be seen, where no target was."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable

import numpy as np

from dream.mapping._rectangles import (
    Key,
    Rectangle,
    Window,
    blocks_among,
    box_of,
    frozen,
    in_raster_order,
    meets,
    shared,
    without,
)
from dream.mapping.completion import Completion, describe_ground
from dream.mapping.layers import BLOCK
from dream.types import BoolArray, IntArray


class OpenGround:
    """All open cells of the window, by block.

    What it does: `completion` looks again at the blocks that were marked since. Where that made a
    difference it sorts all open cells: a cost that grows with how many are open.
    """

    def __init__(self, is_open: Callable[[IntArray, Key], BoolArray]) -> None:
        """Nothing is open yet.

        Args:
            is_open: (n,) which cells (n, 2) of a block nothing observed that could be seen.
        """
        self._is_open = is_open
        self._cells: dict[Key, IntArray] = {}
        self._stale: set[Key] = set()
        self._completion: Completion | None = None

    def enter(self, old: Rectangle, window: Rectangle, blocks: Collection[Key]) -> None:
        """Another window; of these blocks some cells may be open."""
        self._completion = None
        both = shared(old, window)
        for strip in (*without(window, both), *without(old, both)):
            self._stale.update(blocks_among(strip, BLOCK, blocks))
        self._cells = {key: cells for key, cells in self._cells.items() if meets(box_of(key, BLOCK), window)}

    def mark(self, blocks: Iterable[Key]) -> None:
        """Whether cells of these blocks are open may have changed."""
        self._stale.update(blocks)

    def completion(self, window: Window) -> Completion:
        """What keeps a map without targets from being complete; the same object until that changes."""
        for key in self._stale:
            row, col, past_row, past_col = shared(box_of(key, BLOCK), window.cells)
            if row >= past_row or col >= past_col:
                continue
            cells = np.mgrid[row:past_row, col:past_col].reshape(2, -1).T
            cells = cells[self._is_open(cells, key)]
            old = self._cells.pop(key, cells[:0])
            if len(cells):
                self._cells[key] = cells
            if not np.array_equal(old, cells):
                self._completion = None
        self._stale = set()
        if self._completion is None:
            open_cells = frozen(in_raster_order(self._cells.values()) - window.low)
            self._completion = Completion((), open_cells, describe_ground(open_cells, window.middle))
        return self._completion
