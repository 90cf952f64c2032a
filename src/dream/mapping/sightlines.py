"""Which cells could be seen from where the vehicle can get to, kept until something changes in between."""

from __future__ import annotations

import math
from collections.abc import KeysView

import numpy as np
import numpy.typing as npt

from dream.mapping._bits import CellBits
from dream.mapping._rectangles import Key, Rectangle, Window, blocks_among, blocks_in, widened
from dream.mapping.lattice import Lattice
from dream.mapping.layers import BLOCK
from dream.mapping.visibility import FRACTIONS, ray_table
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, IntArray

UNASKED, HIDDEN, SEEN = 0, 1, 2
"""What is known of whether a cell could be seen."""
SLACK = 2
"""Cells beyond the reach where something may matter to a line of sight."""


class Sightlines:
    """Whether an observation from a reached node would explore a cell.

    What it does: follows lines of sight for cells that are asked about, and keeps each answer until
    something within reach became solid, clear, reached or unreached. Of blocks that no reached node was ever
    near, nothing is kept.

    Reference: Eq. 7, with the lattice heading that suits the cell best. Asked are the nearest node, and all
    to whose cells rays lead from the middle of this one: what shows only in a sliver may be missed, but
    nothing is found that no view explores.
    """

    def __init__(self, bits: CellBits, lattice: Lattice, protocol: SurveyProtocol) -> None:
        """No answer yet.

        Args:
            bits: What is solid.
            lattice: Which nodes are reached.
            protocol: Cell, headings and sensor.
        """
        self._bits = bits
        self._lattice = lattice
        self._reach = protocol.reach / protocol.cell
        self._blind = protocol.blind / protocol.cell
        self._half_angle = 0.5 * protocol.camera.horizontal_fov
        self._heading_step = protocol.heading_step
        self._margin = math.ceil(self._reach) + SLACK
        self._rays = ray_table(self._reach + 1.0, FRACTIONS // 2, FRACTIONS // 2)
        self._answers: dict[Key, npt.NDArray[np.uint8]] = {}

    @property
    def blocks(self) -> KeysView[Key]:
        """Those within sight of a node that is reached, or was. Nothing else could be seen."""
        return self._answers.keys()

    def forget(self, solid: list[Rectangle], reached: list[Rectangle]) -> set[Key]:
        """Take in where cells and nodes became other; the blocks in which answers are forgotten."""
        for rectangle in reached:
            for key in blocks_in(widened(rectangle, self._margin), BLOCK):
                if key not in self._answers:
                    self._answers[key] = np.zeros((BLOCK, BLOCK), np.uint8)
        forgotten: set[Key] = set()
        for rectangle in (*solid, *reached):
            wide = widened(rectangle, self._margin)
            for key in blocks_among(wide, BLOCK, self._answers):
                forgotten.add(key)
                rows, cols = (
                    slice(max(low - n * BLOCK, 0), past - n * BLOCK)
                    for low, past, n in zip(wide[:2], wide[2:], key, strict=True)
                )
                self._answers[key][rows, cols] = UNASKED
        return forgotten

    def can_be_seen(self, cells: IntArray, key: Key, window: Window) -> BoolArray:
        """(n,) whether some reached node sees the cells (n, 2) of a block."""
        answers = self._answers.get(key)
        if answers is None:
            return np.zeros(len(cells), np.bool_)
        i, j = cells[:, 0] % BLOCK, cells[:, 1] % BLOCK
        asked = answers[i, j] == UNASKED
        if asked.any():
            answers[i[asked], j[asked]] = np.where(self._look(cells[asked], window), SEEN, HIDDEN)
        seen: BoolArray = answers[i, j] == SEEN
        return seen

    def _look(self, cells: IntArray, window: Window) -> BoolArray:
        """Follow the lines of sight to cells of one block."""
        from dream.mapping._kernels import progress

        low = np.maximum(cells.min(axis=0) - self._margin, window.cells[:2])
        past = np.minimum(cells.max(axis=0) + self._margin + 1, window.cells[2:])
        box = (int(low[0]), int(low[1]), int(past[0]), int(past[1]))
        node_at, x, y = self._lattice.reached_in(box, window)
        if not len(x):
            return np.zeros(len(cells), np.bool_)
        rays = self._rays
        found: BoolArray = progress.seeable(
            self._bits.solid(box),
            box[:2],
            cells,
            node_at,
            x,
            y,
            self._reach,
            self._blind,
            self._half_angle,
            self._heading_step,
            rays.rows,
            rays.cols,
            rays.first,
            rays.last,
        )
        return found
