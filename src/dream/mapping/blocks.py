"""Where a map keeps its cells: square blocks in growing pools, memory only where something was written."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.types import IntArray

Key = tuple[int, ...]
Int64Array = npt.NDArray[np.int64]


class BlockStore:
    """Blocks of cells, found by integer coordinates of any sign.

    What it does: a block has a slot, and each layer has a pool, an array of (slots, *block shape). Kernels
    take pools and a table of slots and work in place. Slot 0 is the block of nothing: all zeros, read
    wherever no block was made, and never written.

    Any number of dimensions: 64 × 64 cells make a block of a flat map, 8 × 8 × 8 would one of a solid.

    Reference: Niessner et al., Real-time 3D Reconstruction at Scale using Voxel Hashing, 2013.
    """

    def __init__(self, layers: Mapping[str, tuple[npt.DTypeLike, tuple[int, ...]]]) -> None:
        """An empty store.

        Args:
            layers: For each layer its type and the shape of one block of it. All begin as zeros.
        """
        self.layers = {name: (np.dtype(dtype), shape) for name, (dtype, shape) in layers.items()}
        self.slot_of: dict[Key, int] = {}
        """Slot of every block made."""
        self.first: Key = ()
        """Least coordinates of any block, empty where there is none, and one past the greatest."""
        self.past: Key = ()
        self.pools = {name: np.zeros((2, *shape), dtype) for name, (dtype, shape) in self.layers.items()}
        """Replaced when they grow: take them anew after `make`."""
        self.stamps: Int64Array = np.zeros(2, np.int64)
        """(slots,) when each block was last written; kept by the map."""

    def __len__(self) -> int:
        return len(self.slot_of)

    @property
    def nbytes(self) -> int:
        """Bytes of all blocks made, without what is in reserve for the next ones."""
        each = sum(dtype.itemsize * int(np.prod(shape)) for dtype, shape in self.layers.values())
        return (len(self) + 1) * each

    def make(self, keys: Iterable[Key]) -> None:
        """Make blocks where there are none."""
        new = [key for key in dict.fromkeys(keys) if key not in self.slot_of]
        needed = 1 + len(self) + len(new)
        if needed > len(self.stamps):
            capacity = 2 * len(self.stamps)
            while capacity < needed:
                capacity *= 2
            self.pools = {name: grown(pool, capacity, 1 + len(self)) for name, pool in self.pools.items()}
            self.stamps = grown(self.stamps, capacity, 1 + len(self))
        for key in new:
            self.slot_of[key] = len(self.slot_of) + 1
            self.first = tuple(map(min, self.first or key, key))
            self.past = tuple(max(a, i + 1) for a, i in zip(self.past or key, key, strict=True))

    def table(self, low: Sequence[int], shape: Sequence[int]) -> IntArray:
        """Slots of a box of blocks, of the given shape; 0 where there is none."""
        get = self.slot_of.get
        axes = [range(first, first + count) for first, count in zip(low, shape, strict=True)]
        slots = np.fromiter(
            (get(key, 0) for key in itertools.product(*axes)), np.int64, count=int(np.prod(shape))
        )
        return slots.reshape(shape)

    def read(self, layer: str, low: Sequence[int], shape: Sequence[int]) -> npt.NDArray[Any]:
        """A copy of one layer over a box of its cells; zeros where there is no block.

        Args:
            layer: Its name.
            low: First cell along each axis, of any sign.
            shape: Cells along each axis.
        """
        dtype, side = self.layers[layer]
        cells = np.zeros(tuple(shape), dtype)
        if 0 in cells.shape:
            return cells
        first = [a // n for a, n in zip(low, side, strict=True)]
        past = [-(-(a + count) // n) for a, count, n in zip(low, shape, side, strict=True)]
        wanted = int(np.prod([b - a for a, b in zip(first, past, strict=True)]))
        keys: Iterable[Key] = itertools.product(*(range(a, b) for a, b in zip(first, past, strict=True)))
        if wanted > len(self):
            keys = (
                k for k in self.slot_of if all(a <= i < b for a, i, b in zip(first, k, past, strict=True))
            )
        pool = self.pools[layer]
        for key in keys:
            slot = self.slot_of.get(key, 0)
            if slot == 0:
                continue
            in_block, in_box = _common(key, side, low, shape)
            cells[in_box] = pool[slot][in_block]
        return cells

    def write(self, layer: str, low: Sequence[int], cells: npt.NDArray[Any]) -> list[Key]:
        """Set one layer over a box of its cells, and make the blocks that any other value than 0 needs.

        Returns:
            The blocks that were written.
        """
        dtype, side = self.layers[layer]
        ranges = [
            range(a // n, -(-(a + count) // n)) for a, count, n in zip(low, cells.shape, side, strict=True)
        ]
        written = []
        for key in itertools.product(*ranges):
            in_block, in_box = _common(key, side, low, cells.shape)
            part = cells[in_box].astype(dtype)
            if key not in self.slot_of and not part.any():
                continue
            self.make([key])
            self.pools[layer][self.slot_of[key]][in_block] = part
            written.append(key)
        return written

    def copy(self) -> BlockStore:
        """A store of its own with the same content."""
        other = BlockStore(self.layers)
        other.slot_of, other.first, other.past = dict(self.slot_of), self.first, self.past
        used = 1 + len(self)
        other.pools = {name: grown(pool, max(used, 2), used) for name, pool in self.pools.items()}
        other.stamps = grown(self.stamps, max(used, 2), used)
        return other


def _common(
    key: Key, side: Sequence[int], low: Sequence[int], shape: Sequence[int]
) -> tuple[tuple[slice[int, int], ...], tuple[slice[int, int], ...]]:
    """What a block and a box of cells share, as part of the block and as part of the box."""
    in_block, in_box = [], []
    for i, n, a, count in zip(key, side, low, shape, strict=True):
        begin, end = max(i * n, a), min((i + 1) * n, a + count)
        in_block.append(slice(begin - i * n, end - i * n))
        in_box.append(slice(begin - a, end - a))
    return tuple(in_block), tuple(in_box)


def grown(pool: npt.NDArray[Any], capacity: int, used: int) -> npt.NDArray[Any]:
    """A larger pool with the first so many entries of this one; fresh zeros cost no memory until written."""
    larger = np.zeros((capacity, *pool.shape[1:]), pool.dtype)
    larger[:used] = pool[:used]
    return larger
