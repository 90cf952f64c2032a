"""Where on the lattice the vehicle can get to, kept up to date where the map changes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.mapping._bits import CellBits
from dream.mapping._rectangles import Key, Rectangle, Window, blocks_in, blocks_of, widened
from dream.mapping.blocks import BlockStore
from dream.mapping.layers import room_radius
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, IntArray

Float64Array = npt.NDArray[np.float64]

NODES = 32
"""Nodes along a block of theirs."""
LINKS = 32
"""From one block to parts of others; more where a block has more."""
BEYOND = 1e-9
"""Lattice steps that a node may lie beyond the edge of the window, for rounding."""


class Lattice:
    """Nodes of the lattice to which moves over standable ground lead from a pose.

    What it does: `renew` finds which moves are free where crossable cells changed, `walk` which nodes they
    lead to from a pose. The cost of the first depends on what changed; the second walks over the connected
    parts of all blocks of 32 × 32 nodes, some parts a block.

    Reference: a part is what moves lead between in both directions within one block. Moves that are free in
    one direction only are links from part to part; so are all that cross the border of a block.

    Assumes: moves no longer than 32 nodes.
    """

    def __init__(
        self, bits: CellBits, protocol: SurveyProtocol, needed_room: int, origin: tuple[float, float]
    ) -> None:
        """Nothing is crossable yet.

        Args:
            bits: What is crossable.
            protocol: Cell, lattice and moves.
            needed_room: See `Layers.needed_room`.
            origin: World x and y of the corner of cell (0, 0).
        """
        moves = sorted(
            {
                protocol.offset(heading, advance)
                for heading in range(protocol.headings)
                for advance in protocol.advances
            }
            - {(0, 0)}
        )
        self._bits = bits
        self._spacing = protocol.lattice
        self._needed_room = needed_room
        self._room_radius = room_radius(needed_room)
        self._moves: IntArray = np.array(moves, np.int64).reshape(-1, 2)
        self._opposite: IntArray = np.array(
            [moves.index((-a, -b)) if (-a, -b) in moves else -1 for a, b in moves], np.int64
        )
        self._bit_of: IntArray = np.array(
            [
                [
                    moves.index(move) if (move := protocol.offset(heading, advance)) in moves else len(moves)
                    for advance in protocol.advances
                ]
                for heading in range(protocol.headings)
            ],
            np.int64,
        )
        """(headings, advances) the bit of each advance; to stay is free wherever the vehicle can stand."""
        self._stride = int(np.abs(self._moves).max(initial=1))
        if self._stride > NODES:
            raise ValueError(f"advances: expected at most {NODES} steps of the lattice, got {self._stride}")
        self._grid = (protocol.lattice, protocol.cell, origin[1], origin[0])
        """See `_kernels/progress.py`."""
        self._blocks = BlockStore(
            {
                "free": (np.uint8, (NODES, NODES, len(moves) // 8 + 1)),
                "labels": (np.int16, (NODES, NODES)),
                "reached": (np.bool_, (NODES, NODES)),
                "count": (np.int64, ()),
                "links": (np.int16, (LINKS, 3)),
                "link_count": (np.int64, ()),
                "around": (np.int64, (9,)),
                "key": (np.int64, (2,)),
            }
        )
        self._stale: set[Key] = set()
        """Blocks whose parts are new since the last walk."""
        self._window: Window | None = None
        # Of the last walk: the number of each block's first part, the parts reached, and nodes in no part.
        self._offsets: IntArray = np.zeros(2, np.int64)
        self._marks: BoolArray = np.zeros(0, np.bool_)
        self._extras: IntArray = np.zeros((0, 2), np.int64)

    def renew(self, crossable: list[Rectangle]) -> None:
        """Find anew which moves are free, and the parts that they connect, where crossable cells changed."""
        from dream.mapping._kernels import progress

        blocks = self._blocks
        changed: set[Key] = set()
        for rectangle in crossable:
            nodes = widened(self._nodes_in(widened(rectangle, self._room_radius)), self._stride)
            self._make_blocks(blocks_in(nodes, NODES))
            first, shape = blocks_of(nodes, NODES)
            cells = self._cells_of(widened(nodes, self._stride))
            other = np.zeros(shape, np.bool_)
            progress.renew_moves(
                self._room(cells),
                cells[:2],
                self._needed_room,
                self._grid,
                nodes,
                self._moves,
                blocks.pools["free"],
                blocks.table(first, shape),
                first,
                other,
            )
            changed.update((first[0] + int(i), first[1] + int(j)) for i, j in np.argwhere(other))
        self._stale |= changed
        pools = blocks.pools
        for key in changed:
            slot = blocks.slot_of[key]
            pools["count"][slot] = progress.label_nodes(
                pools["free"], slot, self._moves, self._opposite, pools["labels"]
            )
        around = {(row + i, col + j) for row, col in changed for i in (-1, 0, 1) for j in (-1, 0, 1)}
        for key in around & blocks.slot_of.keys():
            self._link(blocks.slot_of[key])

    def walk(self, pose: SE2, window: Window) -> list[Rectangle]:
        """Which nodes are reached from a pose; the cells around those that became reached or unreached."""
        from dream.mapping._kernels import progress

        starts, extras = self._start(pose, window)
        blocks = self._blocks
        used = 1 + len(blocks)
        pools = {name: pool[:used] for name, pool in blocks.pools.items()}
        offsets = np.zeros(used + 1, np.int64)
        np.cumsum(pools["count"], out=offsets[1:])
        slots = [blocks.slot_of[i // NODES, j // NODES] for i, j in starts]
        parts = [
            offsets[slot] + pools["labels"][slot, i % NODES, j % NODES] - 1
            for slot, (i, j) in zip(slots, starts, strict=True)
        ]
        marks = progress.walk(
            offsets,
            pools["around"],
            pools["links"],
            pools["link_count"],
            np.repeat(np.arange(used), pools["count"]),
            np.array(parts, np.int64),
        )
        stale = np.zeros(used, np.bool_)
        stale[[blocks.slot_of[key] for key in self._stale]] = True
        for i, j in (*self._extras.tolist(), *extras.tolist()):
            stale[blocks.slot_of[i // NODES, j // NODES]] = True
        rectangles = np.zeros((used, 4), np.int64)
        count = progress.renew_reached(
            pools["labels"],
            offsets,
            marks,
            self._offsets,
            self._marks,
            stale,
            extras,
            pools["key"],
            pools["reached"],
            rectangles,
        )
        changed = [self._cells_of((a, b, c, d)) for a, b, c, d in rectangles[:count].tolist()]
        if window != self._window:  # A node on the edge counts to the last cell.
            changed += [self._cells_of((i, j, i + 1, j + 1)) for i, j in extras.tolist()]
        self._stale, self._window = set(), window
        self._offsets, self._marks, self._extras = offsets, marks, extras
        return changed

    def free(self, nodes: Rectangle) -> npt.NDArray[np.uint8]:
        """(rows, cols, headings, advances) 1 where an advance from a node of a rectangle is free, else 0."""
        from dream.mapping._kernels import progress

        first, shape = blocks_of(nodes, NODES)
        table = self._blocks.table(first, shape)
        free: npt.NDArray[np.uint8] = progress.free_moves(
            self._blocks.pools["free"], table, first, nodes, self._bit_of
        )
        return free

    def positions(self) -> Float64Array:
        """(n, 2) world x and y of the nodes that were reached, by row, then column."""
        slot, i, j = np.nonzero(self._blocks.pools["reached"][: 1 + len(self._blocks)])
        nodes = self._blocks.pools["key"][slot] * NODES + np.stack((i, j), axis=1)
        nodes = nodes[np.lexsort((nodes[:, 1], nodes[:, 0]))]
        positions: Float64Array = np.multiply(nodes[:, ::-1], self._spacing)
        return positions

    def reached_in(
        self, box: Rectangle, window: Window
    ) -> tuple[npt.NDArray[np.int32], Float64Array, Float64Array]:
        """The nodes that were reached in a box of cells.

        Returns:
            (rows, cols) index of a node in each cell, -1 without; (n,) their x and y in cells of the store.
        """
        from dream.mapping._kernels import progress

        # One more to each side: a node on the edge of the window counts to the last cell.
        nodes = self._nodes_in(widened(box, 1))
        first, shape = blocks_of(nodes, NODES)
        node_at, x, y = progress.nodes_in(
            self._blocks.pools["reached"],
            self._blocks.table(first, shape),
            first,
            nodes,
            self._grid,
            window.cells,
            box[:2],
            (box[2] - box[0], box[3] - box[1]),
        )
        return node_at, x, y

    # ------------------------------------------------------------------------------------ where to begin

    def _start(self, pose: SE2, window: Window) -> tuple[list[Key], IntArray]:
        """Standable nodes to begin from, and those that are reached besides: the ways out."""
        from dream.mapping._kernels import progress

        none = np.zeros((0, 2), np.int64)
        row, col = round(pose.y / self._spacing), round(pose.x / self._spacing)
        first_row, first_col, past_row, past_col = window.cells
        west, south = window.origin
        for at, low, first, past in ((row, south, first_row, past_row), (col, west, first_col, past_col)):
            edge, far_edge = low + first * window.cell, low + past * window.cell
            if not edge / self._spacing - BEYOND <= at <= far_edge / self._spacing + BEYOND:
                return [], none
        if self._is_standable(row, col):
            return [(row, col)], none
        half = 2 * self._stride
        while True:
            nodes = (row - half, col - half, row + half + 1, col + half + 1)
            cells = self._cells_of(widened(nodes, self._stride))
            found, small = progress.ways_out(
                self._room(cells), cells[:2], self._needed_room, self._grid, nodes, row, col, self._moves
            )
            if not small:
                break
            half *= 2
        places = np.argwhere(found == 1) + nodes[:2]
        self._make_blocks((int(i) // NODES, int(j) // NODES) for i, j in places)
        return [(int(i) + nodes[0], int(j) + nodes[1]) for i, j in np.argwhere(found == 2)], places

    def _is_standable(self, row: int, col: int) -> bool:
        slot = self._blocks.slot_of.get((row // NODES, col // NODES), 0)
        return bool(self._blocks.pools["labels"][slot, row % NODES, col % NODES])

    # ---------------------------------------------------------------------------------------- where it lies

    def _room(self, rectangle: Rectangle) -> npt.NDArray[np.int32]:
        """See `Layers.room`; over a rectangle of cells of the store."""
        from dream.mapping._kernels import room

        radius = self._room_radius
        crossable = self._bits.crossable(widened(rectangle, radius))
        squared: npt.NDArray[np.int32] = room.clearance(~crossable, radius)
        return squared[radius:-radius, radius:-radius]

    def _cells_of(self, nodes: Rectangle) -> Rectangle:
        """A rectangle of cells that holds these nodes."""
        lattice, cell, south, west = self._grid
        return (
            math.floor((nodes[0] * lattice - south) / cell) - 1,
            math.floor((nodes[1] * lattice - west) / cell) - 1,
            math.floor(((nodes[2] - 1) * lattice - south) / cell) + 2,
            math.floor(((nodes[3] - 1) * lattice - west) / cell) + 2,
        )

    def _nodes_in(self, cells: Rectangle) -> Rectangle:
        """A rectangle of nodes that holds all that lie in these cells."""
        lattice, cell, south, west = self._grid
        return (
            math.floor((cells[0] * cell + south) / lattice) - 1,
            math.floor((cells[1] * cell + west) / lattice) - 1,
            math.ceil((cells[2] * cell + south) / lattice) + 2,
            math.ceil((cells[3] * cell + west) / lattice) + 2,
        )

    def _make_blocks(self, keys: Iterable[Key]) -> None:
        blocks = self._blocks
        new = [key for key in keys if key not in blocks.slot_of]
        blocks.make(new)
        pools = blocks.pools
        for row, col in new:
            slot = blocks.slot_of[row, col]
            pools["key"][slot] = row, col
            for n, (i, j) in enumerate(itertools.product((-1, 0, 1), repeat=2)):
                other = blocks.slot_of.get((row + i, col + j), 0)
                pools["around"][slot, n] = other
                if other:
                    pools["around"][other, 8 - n] = slot
            self._stale.add((row, col))

    def _link(self, slot: int) -> None:
        """Find anew the links from a block."""
        from dream.mapping._kernels import progress

        pools = self._blocks.pools
        while True:
            links = pools["links"]
            count = progress.link_nodes(
                pools["free"], pools["labels"], slot, pools["around"][slot], self._moves, links[slot]
            )
            if count <= links.shape[1]:
                break
            # Room for twice as many, in all blocks.
            self._blocks.layers["links"] = (np.dtype(np.int16), (2 * links.shape[1], 3))
            pools["links"] = np.concatenate((links, np.zeros_like(links)), axis=1)
        pools["link_count"][slot] = count
