"""What the cells of a map say of solid, crossable and target ground, a bit each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.mapping._rectangles import Key, Rectangle, blocks_of
from dream.mapping.blocks import BlockStore, grown
from dream.mapping.layers import BLOCK, Evidence, probability_of_votes
from dream.types import BoolArray

UInt64Array = npt.NDArray[np.uint64]


@dataclass(frozen=True, slots=True)
class Change:
    """What became other since blocks were last read."""

    solid: list[Rectangle]
    """Around the cells that became solid or ceased to be, by block."""
    crossable: list[Rectangle]
    """See `solid`."""
    targets: dict[Key, UInt64Array]
    """The target cells of the blocks where they are others, a row of 64 a word."""


class CellBits:
    """Three layers of a store in bits, as they were when each block was last read, and so what changed.

    Assumes: blocks of 64 × 64 cells, a row being one word.
    """

    def __init__(self, store: BlockStore, evidence: Evidence) -> None:
        """Nothing is read yet.

        Args:
            store: Blocks with the layers `log_odds`, `flags` and `votes`; only read.
            evidence: What votes mean.
        """
        self._store = store
        self._is_target: BoolArray = probability_of_votes(evidence) > 0.5
        self._solid = self._crossable = self._target = np.zeros((0, BLOCK), np.uint64)

    def read(self, blocks: Iterable[Key]) -> Change:
        """Read blocks anew."""
        from dream.mapping._kernels import progress

        store = self._store
        keys = [key for key in blocks if key in store.slot_of]
        if len(self._solid) < len(store.stamps):
            self._solid, self._crossable, self._target = (
                grown(words, len(store.stamps), len(words))
                for words in (self._solid, self._crossable, self._target)
            )
        if not keys:
            return Change([], [], {})
        slots = np.array([store.slot_of[key] for key in keys])
        targets = np.zeros((len(keys), BLOCK), np.uint64)
        rectangles = np.zeros((2, len(keys), 4), np.int64)
        progress.renew_cells(
            store.pools["log_odds"],
            store.pools["flags"],
            store.pools["votes"],
            self._is_target,
            slots,
            np.array(keys) * BLOCK,
            self._solid,
            self._crossable,
            targets,
            rectangles,
        )
        solid, crossable = (
            [(row, col, past_row, past_col) for row, col, past_row, past_col in boxes if past_row > row]
            for boxes in rectangles.tolist()
        )
        others = np.flatnonzero((self._target[slots] != targets).any(axis=1))
        self._target[slots] = targets
        return Change(solid, crossable, {keys[n]: targets[n] for n in others})

    def solid(self, rectangle: Rectangle) -> BoolArray:
        """Whether cells are solid."""
        return self._unpacked(self._solid, rectangle)

    def crossable(self, rectangle: Rectangle) -> BoolArray:
        """Whether cells are traversable; see `Layers.traversable`."""
        return self._unpacked(self._crossable, rectangle)

    def _unpacked(self, words: UInt64Array, rectangle: Rectangle) -> BoolArray:
        from dream.mapping._kernels import progress

        row, col, past_row, past_col = rectangle
        first, shape = blocks_of(rectangle, BLOCK)
        table = self._store.table(first, shape)
        cells: BoolArray = progress.unpack(words, table, first, (row, col), (past_row - row, past_col - col))
        return cells
