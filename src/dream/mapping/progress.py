"""What is still open, kept up to date where the map changes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds
from dream.mapping._bits import CellBits
from dream.mapping._kernels import flags
from dream.mapping._open_ground import OpenGround
from dream.mapping._rectangles import Key, Rectangle, Window, blocks_in, by_block, in_raster_order, inside
from dream.mapping.blocks import BlockStore
from dream.mapping.completion import Completion
from dream.mapping.lattice import Lattice
from dream.mapping.layers import BLOCK, Evidence, cells_within
from dream.mapping.regions import Regions
from dream.mapping.sightlines import Sightlines
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, IntArray

OBSERVED = flags.EXPLORED | flags.RETURNED
"""Bits of which any makes a cell observed; see `Layers.seen`."""


class Progress:
    """Target regions, what is open about them and what could be seen, kept up to date where the map changes.

    What it does: `update` notes which blocks changed. A question reads these anew and renews what follows
    from a difference: moves over the lattice, lines of sight, target regions; nothing else.
    What remains for the whole map is the walk over the connected parts of the lattice, some parts a block of
    32 × 32 nodes, and without any target a sort of all open cells whenever these are others.

    Reference: see `check_completion` for the rule, `Lattice`, `Sightlines` and `Regions` for each part of it.

    Assumes: moves no longer than 32 nodes and a `group_radius` of less than 64 cells.
    """

    def __init__(
        self,
        store: BlockStore,
        protocol: SurveyProtocol,
        evidence: Evidence,
        needed_room: int,
        origin: tuple[float, float],
    ) -> None:
        """Everything in the store is read at the first question.

        Args:
            store: Blocks of 64 × 64 cells with the layers `log_odds`, `flags` and `votes`; only read.
            protocol: Cell, lattice, moves, body, sensor and group.
            evidence: What votes mean.
            needed_room: See `Layers.needed_room`.
            origin: World x and y of the corner of cell (0, 0).
        """
        self._store = store
        self._protocol = protocol
        self._evidence = evidence
        self._needed_room = needed_room
        self._window = Window((0, 0, 0, 0), origin, protocol.cell)
        self._area: Rectangle | None = None
        self._touched: set[Key] = {(row, col) for row, col in store.slot_of}
        self._bits = CellBits(store, evidence)
        self._lattice = Lattice(self._bits, protocol, needed_room, origin)
        self._sightlines = Sightlines(self._bits, self._lattice, protocol)
        self._regions = Regions(protocol, self._is_open)
        self._ground = OpenGround(self._is_open)

    def update(self, row: int, col: int, past_row: int, past_col: int) -> None:
        """Take in that cells in a rectangle became other."""
        if row < past_row and col < past_col:
            self._touched.update(blocks_in((row, col, past_row, past_col), BLOCK))

    def restrict(self, area: Bounds | None) -> None:
        """Take what lies outside an area for observed; nothing where it is None."""
        self._area = None if area is None else cells_within(area, self._window.origin, self._window.cell)

    def copy(self, store: BlockStore) -> Progress:
        """One of its own for a copy of the store; it reads everything at its first question."""
        other = Progress(store, self._protocol, self._evidence, self._needed_room, self._window.origin)
        other._area = self._area
        return other

    # ---------------------------------------------------------------------------------- what is asked

    def check(self, pose: SE2, window: Rectangle) -> Completion:
        """See `check_completion`.

        Args:
            pose: Where the vehicle is.
            window: What counts as inside, in cells of the store. Results are relative to it.
        """
        self._renew(pose, window)
        completion = self._regions.completion(self._window)
        return completion if completion.regions else self._ground.completion(self._window)

    def reachable(self, pose: SE2, window: Rectangle) -> npt.NDArray[np.float64]:
        """See `dream.mapping.reachable`."""
        self._renew(pose, window)
        return self._lattice.positions()

    def free_moves(self, pose: SE2, window: Rectangle, nodes: Rectangle) -> npt.NDArray[np.uint8]:
        """See `dream.mapping.free_moves`; `nodes` are first and past, rows and columns."""
        self._renew(pose, window)
        return self._lattice.free(nodes)

    def seeable(self, pose: SE2, window: Rectangle, cells: IntArray) -> IntArray:
        """Those of the window's cells (n, 2) that an observation from a reachable pose would explore."""
        self._renew(pose, window)
        seen = [
            mine[self._sightlines.can_be_seen(mine, key, self._window)]
            for key, mine in by_block(cells + window[:2], BLOCK)
        ]
        return in_raster_order(seen) - window[:2]

    # ---------------------------------------------------------------------------------- what follows

    def _renew(self, pose: SE2, window: Rectangle) -> None:
        """Take in all that changed."""
        touched, self._touched = self._touched, set()
        old = self._window
        self._window = Window(window, old.origin, old.cell, self._area)
        change = self._bits.read(touched)
        self._lattice.renew(change.crossable)
        reached = self._lattice.walk(pose, self._window)
        others = touched | self._sightlines.forget(change.solid, reached)
        self._regions.regroup(change.targets)
        self._regions.mark(others)
        self._ground.mark(self._sightlines.blocks & others)
        if old != self._window:
            self._regions.enter(self._window)
        if old.cells != window:
            self._ground.enter(old.cells, window, self._sightlines.blocks)
        if old.area != self._area:
            self._ground.mark(self._sightlines.blocks)

    def _is_open(self, cells: IntArray, key: Key) -> BoolArray:
        """(n,) which cells (n, 2) of a block nothing observed that could be seen."""
        bits = self._store.pools["flags"][self._store.slot_of.get(key, 0)]
        open_ones: BoolArray = bits[cells[:, 0] % BLOCK, cells[:, 1] % BLOCK] & OBSERVED == 0
        if self._area is not None:
            open_ones &= inside(cells, self._area)
        open_ones[open_ones] = self._sightlines.can_be_seen(cells[open_ones], key, self._window)
        return open_ones
