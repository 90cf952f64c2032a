"""What is still open, kept up to date where the map changes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds
from dream.mapping._kernels import flags
from dream.mapping.blocks import BlockStore
from dream.mapping.completion import MARGIN_CELLS, Completion, Region, describe, unknown
from dream.mapping.layers import Evidence, probability_of_votes
from dream.mapping.visibility import FRACTIONS, ray_table
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, IntArray

Key = tuple[int, int]
Rectangle = tuple[int, int, int, int]
"""First row and column, past row and column."""
Float64Array = npt.NDArray[np.float64]
UInt64Array = npt.NDArray[np.uint64]

SIDE = 64
"""Cells along a block."""
NODES = 32
"""Nodes of the lattice along a block of theirs."""
LINKS = 32
"""From one block of nodes to parts of others; more where a block has more."""
OBSERVED = flags.EXPLORED | flags.RETURNED
"""Bits of which any makes a cell observed; see `Layers.observed`."""
UNASKED, HIDDEN, SEEN = 0, 1, 2
"""What is known of whether a cell could be seen."""
SLACK = 2
"""Cells beyond the reach where something may matter to a line of sight."""


@dataclass(slots=True, eq=False)
class _Part:
    """Target cells of one block that belong together within it."""

    key: Key
    cells: IntArray
    linked: set[int] = field(default_factory=set)
    """Parts in the blocks around that are near enough."""


@dataclass(slots=True, eq=False)
class _Group:
    """Parts that belong together: a region."""

    parts: list[int]
    cells: IntArray
    """(n, 2) in raster order, of the store."""
    box: Rectangle
    """Around its outline, before the window cut it."""
    outline: dict[Key, IntArray] | None = None
    """Cells near its own or in its holes, by block; None when they must be found anew."""
    open_cells: dict[Key, IntArray] = field(default_factory=dict)
    """Those of them that are open."""
    stale: set[Key] = field(default_factory=set)
    """Blocks whose open cells must be found anew."""
    before: list[_Group] = field(default_factory=list)
    """Of which it was made: where the outline is as it was, so are the open cells."""
    about: tuple[IntArray, tuple[float, float], Bounds] | None = None
    """What a region says of its cells; None when it must be said anew."""
    region: Region | None = None
    """None when it must be made anew."""


class Progress:
    """Target regions, what is open about them and what could be seen, kept up to date where the map changes.

    What it does: `update` notes which blocks changed. A question reads these anew and renews what
    follows from a difference: target regions; moves over the lattice; lines of sight to cells that are
    asked about. Nothing else is looked at again, so that the cost depends on what changed, not on the
    map; only the walk over the connected parts of the lattice covers all of it, some parts a block of
    32 × 32 nodes.

    Reference: see `check_completion` for the rule. A part is what belongs together within one block; regions
    are parts united, and so is reachable ground. Moves that are free in one direction only lead from part to
    part; so do all that cross the border of a block.

    Assumes: moves no longer than 32 nodes and a `group_radius` of less than 64 cells.
    """

    def __init__(
        self,
        store: BlockStore,
        protocol: SurveyProtocol,
        evidence: Evidence,
        needed_room: int,
        origin: tuple[float, float],
        bounds: Bounds | None = None,
    ) -> None:
        """Everything in the store is read at the first question.

        Args:
            store: Blocks of 64 × 64 cells with the layers `log_odds`, `flags` and `votes`; only read.
            protocol: Cell, lattice, moves, body, sensor and group.
            evidence: What votes mean.
            needed_room: See `Layers.needed_room`.
            origin: World x and y of the corner of cell (0, 0).
            bounds: The survey area; None has no end.
        """
        self._store = store
        self._protocol = protocol
        self._evidence = evidence
        self._needed_room = needed_room
        self._origin = origin
        self._bounds = bounds
        self._is_target: BoolArray = probability_of_votes(evidence) > 0.5
        self._touched: set[Key] = set(store.slot_of)  # type: ignore[arg-type]
        self._solid: UInt64Array = np.zeros((2, SIDE), np.uint64)
        self._crossable: UInt64Array = np.zeros((2, SIDE), np.uint64)
        self._window: Rectangle = (0, 0, 0, 0)

        # ---- the lattice
        moves = sorted(
            {
                protocol.offset(heading, advance)
                for heading in range(protocol.headings)
                for advance in protocol.advances
            }
            - {(0, 0)}
        )
        self._moves: IntArray = np.array(moves, np.int64).reshape(-1, 2)
        self._opposite: IntArray = np.array(
            [moves.index((-a, -b)) if (-a, -b) in moves else -1 for a, b in moves], np.int64
        )
        self._stride = int(np.abs(self._moves).max(initial=1))
        if self._stride > NODES:
            raise ValueError(f"advances: expected at most {NODES} steps of the lattice, got {self._stride}")
        self._spacing = protocol.lattice / protocol.cell
        if bounds is None:
            self._anchor = (0, 0)
            self._offset = (-origin[1] / protocol.cell, -origin[0] / protocol.cell)
        else:
            # So are the nodes counted from the first one in bounds: rounding must not move one.
            self._anchor = (_first(bounds.y_min, protocol.lattice), _first(bounds.x_min, protocol.lattice))
            self._offset = (
                (self._anchor[0] * protocol.lattice - bounds.y_min) / protocol.cell,
                (self._anchor[1] * protocol.lattice - bounds.x_min) / protocol.cell,
            )
        self._lattice = BlockStore(
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
        self._stale_blocks: set[Key] = set()
        """Of nodes, whose parts are new since the last walk."""
        self._parts: IntArray = np.zeros(2, np.int64)
        self._marks: BoolArray = np.zeros(0, np.bool_)
        self._extras: IntArray = np.zeros((0, 2), np.int64)

        # ---- lines of sight
        reach = protocol.reach / protocol.cell
        self._sight = math.ceil(reach) + SLACK
        self._rays = ray_table(reach + 1.0, FRACTIONS // 2, FRACTIONS // 2)
        self._answers: dict[Key, npt.NDArray[np.uint8]] = {}
        self._open: dict[Key, IntArray] = {}
        self._stale_open: set[Key] = set()

        # ---- regions
        self._link = (protocol.group_radius / protocol.cell) ** 2
        self._link_reach = math.floor(math.sqrt(self._link) + 1e-9)
        if self._link_reach >= SIDE:
            raise ValueError(f"group_radius: expected less than {SIDE} cells, got {self._link_reach}")
        self._targets: dict[Key, UInt64Array] = {}
        self._target_labels: dict[Key, npt.NDArray[np.int16]] = {}
        self._numbers: dict[Key, list[int]] = {}
        """Parts of a block by label, less one."""
        self._target_parts: dict[int, _Part] = {}
        self._next = 0
        self._groups: dict[int, _Group] = {}
        """By the number of their first part."""
        self._group_of: dict[int, int] = {}
        self._past: dict[int, _Group] = {}
        """Regions that parts were in until now."""
        self._completion: Completion | None = None

    def update(self, row: int, col: int, past_row: int, past_col: int) -> None:
        """Take in that cells in a rectangle became other."""
        if row < past_row and col < past_col:
            self._touched.update(_blocks((row, col, past_row, past_col), SIDE))

    def copy(self, store: BlockStore) -> Progress:
        """One of its own for a copy of the store; it reads everything at its first question."""
        return Progress(store, self._protocol, self._evidence, self._needed_room, self._origin, self._bounds)

    # ---------------------------------------------------------------------------------- what is asked

    def check(self, pose: SE2, window: Rectangle) -> Completion:
        """See `check_completion`.

        Args:
            pose: Where the vehicle is.
            window: What counts as inside, in cells of the store. Results are relative to it.
        """
        changed = self._renew(pose, window)
        if not self._groups:
            self._completion = None
            return self._without_targets()
        if self._completion is None or self._completion.regions == ():
            changed = True
        fresh = [group for group in self._groups.values() if group.region is None]
        if fresh:
            for group in fresh:
                self._make_region(group)
            changed = True
        if changed or self._completion is None:
            groups = sorted(self._groups.values(), key=lambda group: tuple(group.cells[0].tolist()))
            regions = tuple(group.region for group in groups if group.region is not None)
            open_cells = np.concatenate([region.open_cells for region in regions])
            if len(regions) > 1:
                open_cells = _in_raster_order(open_cells)
                row, col = open_cells.T
                first = np.append(True, (row[1:] != row[:-1]) | (col[1:] != col[:-1]))
                open_cells = open_cells[first[: len(open_cells)]]
            self._completion = Completion(regions, _frozen(open_cells), describe(regions, self._middle))
        return self._completion

    def reachable(self, pose: SE2, window: Rectangle) -> Float64Array:
        """See `dream.mapping.reachable`."""
        self._renew(pose, window)
        used = 1 + len(self._lattice)
        slot, i, j = np.nonzero(self._lattice.pools["reached"][:used])
        nodes = self._lattice.pools["key"][slot] * NODES + np.stack((i, j), axis=1)
        nodes = nodes[np.lexsort((nodes[:, 1], nodes[:, 0]))]
        positions: Float64Array = np.multiply(nodes[:, ::-1], self._protocol.lattice)
        return positions

    def seeable(self, pose: SE2, window: Rectangle, cells: IntArray) -> IntArray:
        """Those of the window's cells (n, 2) that an observation from a reachable pose would explore."""
        self._renew(pose, window)
        seen = [mine[self._can_be_seen(mine, key)] for key, mine in _by_block(cells + window[:2])]
        return _in_raster_order(np.concatenate(seen)) - window[:2] if seen else cells[:0]

    # ---------------------------------------------------------------------------------- what follows

    def _renew(self, pose: SE2, window: Rectangle) -> bool:
        """Take in all that changed; whether regions came or went."""
        moved = window != self._window
        if moved:
            self._enter(window)
        solid, crossable, targets, touched = self._read_cells()
        self._renew_lattice(crossable)
        nodes = self._walk(pose, moved)
        self._forget_answers([*solid, *nodes])
        regrouped = self._regroup(targets)
        grown = [_grown(rectangle, self._sight) for rectangle in (*solid, *nodes)]
        self._stale_open.update(touched)
        dirty = [*grown, *(_box(key, SIDE) for key in touched)]
        if dirty and self._groups:
            groups = list(self._groups.values())
            boxes = np.array([group.box for group in groups])
            meets = np.zeros(len(groups), np.bool_)
            for row, col, past_row, past_col in dirty:
                meets |= (
                    (boxes[:, 0] < past_row)
                    & (boxes[:, 1] < past_col)
                    & (boxes[:, 2] > row)
                    & (boxes[:, 3] > col)
                )
            blocks = {key for rectangle in dirty for key in _blocks(rectangle, SIDE)}
            for n in np.flatnonzero(meets):
                outline = groups[n].outline
                if outline is None:
                    groups[n].stale |= blocks
                elif not blocks.isdisjoint(outline):
                    groups[n].stale |= blocks & outline.keys()
                    groups[n].region = None
        return regrouped or moved

    def _enter(self, window: Rectangle) -> None:
        """Another window: what it cuts otherwise is found anew."""
        old, self._window = self._window, window
        both = (*np.maximum(old[:2], window[:2]).tolist(), *np.minimum(old[2:], window[2:]).tolist())
        for group in self._groups.values():
            if not _holds(both, group.box):
                group.outline = group.region = None
                group.before = []
            if old[:2] != window[:2]:
                group.about = group.region = None
        for strip in (*_without(window, both), *_without(old, both)):
            self._stale_open.update(_blocks(strip, SIDE))
        for key in [key for key in self._open if not _meets(_box(key, SIDE), window)]:
            del self._open[key]

    def _read_cells(self) -> tuple[list[Rectangle], list[Rectangle], dict[Key, UInt64Array], set[Key]]:
        """Where solid and where crossable cells changed; blocks with other targets; all that were touched."""
        from dream.mapping._kernels import progress

        touched, self._touched = self._touched, set()
        store = self._store
        keys = [key for key in touched if key in store.slot_of]
        if len(self._solid) < len(store.stamps):
            self._solid, self._crossable = (
                _enlarged(pool, len(store.stamps)) for pool in (self._solid, self._crossable)
            )
        if not keys:
            return [], [], {}, touched
        slots = np.array([store.slot_of[key] for key in keys])
        words = np.zeros((len(keys), SIDE), np.uint64)
        rectangles = np.zeros((2, len(keys), 4), np.int64)
        progress.renew_cells(
            store.pools["log_odds"],
            store.pools["flags"],
            store.pools["votes"],
            self._is_target,
            slots,
            np.array(keys) * SIDE,
            self._solid,
            self._crossable,
            words,
            rectangles,
        )
        solid, crossable = (
            [(row, col, past_row, past_col) for row, col, past_row, past_col in boxes if past_row > row]
            for boxes in rectangles.tolist()
        )
        targets = {}
        for key, mine in zip(keys, words, strict=True):
            old = self._targets.get(key)
            if (old is not None or mine.any()) and not (old is not None and np.array_equal(old, mine)):
                targets[key] = mine
        return solid, crossable, targets, touched

    def _unpacked(self, words: UInt64Array, low: tuple[int, int], shape: tuple[int, int]) -> BoolArray:
        """Cells of the store from a layer of words."""
        from dream.mapping._kernels import progress

        first = (low[0] // SIDE, low[1] // SIDE)
        past = ((low[0] + shape[0] - 1) // SIDE + 1, (low[1] + shape[1] - 1) // SIDE + 1)
        table = self._store.table(first, (past[0] - first[0], past[1] - first[1]))
        cells: BoolArray = progress.unpack(words, table, first, low, shape)
        return cells

    # ---- the lattice

    def _room(self, rectangle: Rectangle) -> npt.NDArray[np.int32]:
        """See `Layers.room`; over a rectangle of cells of the store."""
        from dream.mapping._kernels import room

        radius = (math.isqrt(self._needed_room) + 1) // 2
        row, col, past_row, past_col = _grown(rectangle, radius)
        crossable = self._unpacked(self._crossable, (row, col), (past_row - row, past_col - col))
        squared: npt.NDArray[np.int32] = room.clearance(~crossable, radius)
        return squared[radius:-radius, radius:-radius]

    def _cells_of(self, nodes: Rectangle) -> Rectangle:
        """A rectangle of cells that holds these nodes."""
        (row, past_row), (col, past_col) = (
            [offset + self._spacing * (node - anchor) for node in (first, past - 1)]
            for first, past, offset, anchor in zip(
                nodes[:2], nodes[2:], self._offset, self._anchor, strict=True
            )
        )
        return math.floor(row) - 1, math.floor(col) - 1, math.floor(past_row) + 2, math.floor(past_col) + 2

    def _nodes_in(self, cells: Rectangle) -> Rectangle:
        """A rectangle of nodes that holds all that lie in these cells."""
        (row, past_row), (col, past_col) = (
            [(cell - offset) / self._spacing + anchor for cell in (first, past)]
            for first, past, offset, anchor in zip(
                cells[:2], cells[2:], self._offset, self._anchor, strict=True
            )
        )
        return math.floor(row) - 1, math.floor(col) - 1, math.ceil(past_row) + 2, math.ceil(past_col) + 2

    def _renew_lattice(self, crossable: list[Rectangle]) -> None:
        """The moves that what is crossable now lets pass or stops, and the parts that they connect."""
        from dream.mapping._kernels import progress

        if not crossable:
            return
        radius = (math.isqrt(self._needed_room) + 1) // 2
        lattice = self._lattice
        changed: set[Key] = set()
        for rectangle in crossable:
            nodes = _grown(self._nodes_in(_grown(rectangle, radius)), self._stride)
            self._make_blocks(_blocks(nodes, NODES))
            first = (nodes[0] // NODES, nodes[1] // NODES)
            shape = ((nodes[2] - 1) // NODES + 1 - first[0], (nodes[3] - 1) // NODES + 1 - first[1])
            cells = self._cells_of(_grown(nodes, self._stride))
            other = np.zeros(shape, np.bool_)
            progress.renew_moves(
                self._room(cells),
                cells[:2],
                self._needed_room,
                self._offset,
                self._anchor,
                self._spacing,
                nodes,
                self._moves,
                lattice.pools["free"],
                lattice.table(first, shape),
                first,
                other,
            )
            changed.update((first[0] + int(i), first[1] + int(j)) for i, j in np.argwhere(other))
        self._stale_blocks |= changed
        pools = lattice.pools
        for key in changed:
            slot = lattice.slot_of[key]
            pools["count"][slot] = progress.label_nodes(
                pools["free"], slot, self._moves, self._opposite, pools["labels"]
            )
        around = {
            (row + i, col + j) for row, col in changed for i in (-1, 0, 1) for j in (-1, 0, 1)
        } & lattice.slot_of.keys()
        for key in around:
            slot = lattice.slot_of[key]
            while True:
                links = pools["links"]
                count = progress.link_nodes(
                    pools["free"], pools["labels"], slot, pools["around"][slot], self._moves, links[slot]
                )
                if count <= links.shape[1]:
                    break
                # Room for twice as many, in all blocks.
                lattice.layers["links"] = (np.dtype(np.int16), (2 * links.shape[1], 3))
                pools["links"] = np.concatenate((links, np.zeros_like(links)), axis=1)
            pools["link_count"][slot] = count

    def _make_blocks(self, keys: Iterable[Key]) -> None:
        lattice = self._lattice
        new = [key for key in keys if key not in lattice.slot_of]
        lattice.make(new)
        pools = lattice.pools
        for row, col in new:
            slot = lattice.slot_of[row, col]
            pools["key"][slot] = row, col
            for n, (i, j) in enumerate(itertools.product((-1, 0, 1), repeat=2)):
                other = lattice.slot_of.get((row + i, col + j), 0)
                pools["around"][slot, n] = other
                if other:
                    pools["around"][other, 8 - n] = slot
            self._stale_blocks.add((row, col))

    def _walk(self, pose: SE2, moved: bool) -> list[Rectangle]:
        """Which nodes are reached from a pose; the cells around those that became reached or unreached."""
        from dream.mapping._kernels import progress

        starts, extras = self._start(pose)
        lattice = self._lattice
        used = 1 + len(lattice)
        offsets = np.zeros(used + 1, np.int64)
        pools = {name: pool[:used] for name, pool in lattice.pools.items()}
        np.cumsum(pools["count"], out=offsets[1:])
        homes = np.repeat(np.arange(used), pools["count"])
        marks = progress.walk(
            offsets,
            pools["around"],
            pools["links"],
            pools["link_count"],
            homes,
            np.array(
                [
                    offsets[lattice.slot_of[i // NODES, j // NODES]]
                    + pools["labels"][lattice.slot_of[i // NODES, j // NODES], i % NODES, j % NODES]
                    - 1
                    for i, j in starts
                ],
                np.int64,
            ),
        )
        stale = np.zeros(used, np.bool_)
        stale[[lattice.slot_of[key] for key in self._stale_blocks]] = True
        self._stale_blocks = set()
        for i, j in (*self._extras.tolist(), *extras.tolist()):
            stale[lattice.slot_of[i // NODES, j // NODES]] = True
        rectangles = np.zeros((used, 4), np.int64)
        count = progress.renew_reached(
            pools["labels"],
            offsets,
            marks,
            self._parts,
            self._marks,
            stale,
            extras,
            pools["key"],
            pools["reached"],
            rectangles,
        )
        changed = [self._cells_of(tuple(nodes)) for nodes in rectangles[:count].tolist()]
        if moved:  # A node on the edge counts to the last cell.
            changed += [self._cells_of((i, j, i + 1, j + 1)) for i, j in extras.tolist()]
        self._parts, self._marks, self._extras = offsets, marks, extras
        return changed

    def _start(self, pose: SE2) -> tuple[list[Key], IntArray]:
        """Standable nodes to begin from, and those that are reached besides: the ways out."""
        from dream.mapping._kernels import progress

        lattice, (x, y) = self._protocol.lattice, self._origin
        none = np.zeros((0, 2), np.int64)
        row, col = round(pose.y / lattice), round(pose.x / lattice)
        for at, low, first, past in (
            (row, y, self._window[0], self._window[2]),
            (col, x, self._window[1], self._window[3]),
        ):
            low_edge, high_edge = low + first * self._protocol.cell, low + past * self._protocol.cell
            if not _first(low_edge, lattice) <= at <= math.floor(high_edge / lattice + 1e-9):
                return [], none
        if self._is_standable(row, col):
            return [(row, col)], none
        half = 2 * self._stride
        while True:
            nodes = (row - half, col - half, row + half + 1, col + half + 1)
            cells = self._cells_of(_grown(nodes, self._stride))
            found, small = progress.ways_out(
                self._room(cells),
                cells[:2],
                self._needed_room,
                self._offset,
                self._anchor,
                self._spacing,
                nodes,
                row,
                col,
                self._moves,
            )
            if not small:
                break
            half *= 2
        places = np.argwhere(found == 1) + nodes[:2]
        self._make_blocks((int(i) // NODES, int(j) // NODES) for i, j in places)
        return [(int(i) + nodes[0], int(j) + nodes[1]) for i, j in np.argwhere(found == 2)], places

    def _is_standable(self, row: int, col: int) -> bool:
        slot = self._lattice.slot_of.get((row // NODES, col // NODES), 0)
        return bool(self._lattice.pools["labels"][slot, row % NODES, col % NODES])

    # ---- lines of sight

    def _forget_answers(self, rectangles: list[Rectangle]) -> None:
        """What is solid or reached changed there."""
        for rectangle in rectangles:
            wide = _grown(rectangle, self._sight)
            for key in _blocks(wide, SIDE):
                self._stale_open.add(key)
                answers = self._answers.get(key)
                if answers is not None:
                    answers[
                        max(wide[0] - key[0] * SIDE, 0) : max(wide[2] - key[0] * SIDE, 0),
                        max(wide[1] - key[1] * SIDE, 0) : max(wide[3] - key[1] * SIDE, 0),
                    ] = UNASKED

    def _can_be_seen(self, cells: IntArray, key: Key) -> BoolArray:
        """(n,) whether some reached node sees the cells (n, 2) of a block."""
        answers = self._answers.setdefault(key, np.zeros((SIDE, SIDE), np.uint8))
        i, j = cells[:, 0] % SIDE, cells[:, 1] % SIDE
        asked = answers[i, j] == UNASKED
        if asked.any():
            answers[i[asked], j[asked]] = np.where(self._look(cells[asked]), SEEN, HIDDEN)
        seen: BoolArray = answers[i, j] == SEEN
        return seen

    def _look(self, cells: IntArray) -> BoolArray:
        """Follow the lines of sight to cells of one block."""
        from dream.mapping._kernels import progress

        protocol, window = self._protocol, self._window
        low = np.maximum(cells.min(axis=0) - self._sight, window[:2])
        past = np.minimum(cells.max(axis=0) + self._sight + 1, window[2:])
        box = (int(low[0]), int(low[1]), int(past[0]), int(past[1]))
        shape = (box[2] - box[0], box[3] - box[1])
        # One more to each side: a node on the edge of the window.
        nodes = self._nodes_in(_grown(box, 1))
        first = (nodes[0] // NODES, nodes[1] // NODES)
        past_block = ((nodes[2] - 1) // NODES + 1, (nodes[3] - 1) // NODES + 1)
        node_at, node_x, node_y = progress.nodes_in(
            self._lattice.pools["reached"],
            self._lattice.table(first, (past_block[0] - first[0], past_block[1] - first[1])),
            first,
            nodes,
            protocol.lattice,
            (self._origin[1], self._origin[0]),
            protocol.cell,
            window,
            box[:2],
            shape,
        )
        if not len(node_x):
            return np.zeros(len(cells), np.bool_)
        rays = self._rays
        found: BoolArray = progress.seeable(
            self._unpacked(self._solid, box[:2], shape),
            box[:2],
            cells,
            node_at,
            node_x,
            node_y,
            protocol.reach / protocol.cell,
            protocol.blind / protocol.cell,
            0.5 * protocol.camera.horizontal_fov,
            protocol.heading_step,
            rays.rows,
            rays.cols,
            rays.first,
            rays.last,
        )
        return found

    # ---- regions

    def _regroup(self, targets: dict[Key, UInt64Array]) -> bool:
        """Other target cells in some blocks; whether regions came or went."""
        from dream.mapping._kernels import edges, progress

        if not targets:
            return False
        loose: set[int] = set()
        """Parts whose region must be found anew."""
        for key, words in targets.items():
            for number in self._numbers.pop(key, []):
                part = self._target_parts.pop(number)
                for other in part.linked:
                    if other in self._target_parts:
                        self._target_parts[other].linked.discard(number)
                loose.update(self._disband(number))
                loose.discard(number)
            self._targets.pop(key, None)
            self._target_labels.pop(key, None)
            if not words.any():
                continue
            self._targets[key] = words
            mask = np.unpackbits(words.view(np.uint8).reshape(SIDE, 8), axis=1, bitorder="little")
            labels, count = edges.label_within(mask.astype(np.bool_), self._link)
            self._target_labels[key] = labels.astype(np.int16)
            cells = np.argwhere(labels)
            members = labels[cells[:, 0], cells[:, 1]]
            order = np.argsort(members, kind="stable")
            cells = cells[order] + (key[0] * SIDE, key[1] * SIDE)
            numbers = list(range(self._next, self._next + count))
            self._next += count
            self._numbers[key] = numbers
            ends = np.searchsorted(members[order], np.arange(2, count + 1))
            for number, mine in zip(numbers, np.split(cells, ends), strict=True):
                self._target_parts[number] = _Part(key, mine)
                loose.add(number)
        nothing = np.zeros((SIDE, SIDE), np.int16)
        for key in targets:
            if key not in self._numbers:
                continue
            around = [(key[0] + i, key[1] + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
            if not any(other in self._numbers for other in around if other != key):
                continue
            stack = np.stack([self._target_labels.get(other, nothing) for other in around])
            for mine, side, theirs in progress.link_parts(stack, self._link_reach, self._link).tolist():
                one, other = self._numbers[key][mine - 1], self._numbers[around[side]][theirs - 1]
                self._target_parts[one].linked.add(other)
                self._target_parts[other].linked.add(one)
                loose.update(self._disband(other))
        loose &= self._target_parts.keys()
        while loose:
            members = {loose.pop()}
            todo = list(members)
            while todo:
                new = self._target_parts[todo.pop()].linked - members
                members |= new
                todo.extend(new)
            loose -= members
            self._form(sorted(members))
        self._past = {}
        return True

    def _disband(self, number: int) -> list[int]:
        """The parts of the region that a part was in, which is no more."""
        first = self._group_of.get(number)
        if first is None:
            return []
        group = self._groups.pop(first)
        for part in group.parts:
            del self._group_of[part]
            self._past[part] = group
        return group.parts

    def _form(self, parts: list[int]) -> None:
        cells = np.concatenate([self._target_parts[number].cells for number in parts])
        if len(parts) > 1:
            cells = _in_raster_order(cells)
        margin = MARGIN_CELLS + 1
        row, col = cells[:, 0], cells[:, 1]
        box = _grown((int(row[0]), int(col.min()), int(row[-1]) + 1, int(col.max()) + 1), margin)
        old = {id(group): group for group in map(self._past.get, parts) if group is not None}
        self._groups[parts[0]] = _Group(parts, cells, box, before=list(old.values()))
        for number in parts:
            self._group_of[number] = parts[0]

    def _make_region(self, group: _Group) -> None:
        from dream.mapping._kernels import progress

        window = self._window
        if group.outline is None:
            low = np.maximum(group.box[:2], window[:2])
            past = np.minimum(group.box[2:], window[2:])
            mask = np.zeros(tuple(past - low), np.bool_)
            mask[tuple((group.cells - low).T)] = True
            self._outline(group, low, progress.filled(progress.within(mask, MARGIN_CELLS**2)))
        assert group.outline is not None
        for key in group.stale:
            cells = group.outline[key]
            cells = cells[self._unobserved(cells, key)]
            group.open_cells[key] = cells[self._can_be_seen(cells, key)]
        group.stale = set()
        some = [cells for cells in group.open_cells.values() if len(cells)]
        open_cells = _in_raster_order(np.concatenate(some)) if some else np.zeros((0, 2), np.int64)
        if group.about is None:
            cells = group.cells - window[:2]
            margin = MARGIN_CELLS + 1
            west, south = self._center_of(
                group.box[0] + margin - window[0], group.box[1] + margin - window[1]
            )
            east, north = self._center_of(
                group.box[2] - margin - 1 - window[0], group.box[3] - margin - 1 - window[1]
            )
            half = 0.5 * self._protocol.cell
            extent = Bounds(west - half, south - half, east + half, north + half)
            group.about = (_frozen(cells), self._middle(cells), extent)
        group.region = Region(*group.about, open_cells=_frozen(open_cells - window[:2]))

    def _outline(self, group: _Group, low: IntArray, mask: BoolArray) -> None:
        """Take in another outline, from the cell `low` on; what is open is kept where nothing changed."""
        row, col = int(low[0]), int(low[1])
        box = (row, col, row + mask.shape[0], col + mask.shape[1])
        changed, group.stale = group.stale, set()
        group.outline, group.open_cells = {}, {}
        for key in _blocks(box, SIDE):
            top, left = max(key[0] * SIDE - row, 0), max(key[1] * SIDE - col, 0)
            cells = np.argwhere(mask[top : (key[0] + 1) * SIDE - row, left : (key[1] + 1) * SIDE - col])
            if not len(cells):
                continue
            cells += (row + top, col + left)
            group.outline[key] = cells
            for old in group.before if key not in changed else ():
                if (
                    old.outline is not None
                    and key in old.outline
                    and key not in old.stale
                    and np.array_equal(old.outline[key], cells)
                ):
                    group.open_cells[key] = old.open_cells[key]
                    break
            else:
                group.stale.add(key)
        group.before = []

    def _unobserved(self, cells: IntArray, key: Key) -> BoolArray:
        """(n,) which cells of a block are neither explored nor seen by a return."""
        flags = self._store.pools["flags"][self._store.slot_of.get(key, 0)]
        unobserved: BoolArray = flags[cells[:, 0] % SIDE, cells[:, 1] % SIDE] & OBSERVED == 0
        return unobserved

    def _without_targets(self) -> Completion:
        """All unknown ground counts."""
        window = self._window
        for key in self._stale_open:
            box = _box(key, SIDE)
            if not _meets(box, window):
                continue
            row, col = max(box[0], window[0]), max(box[1], window[1])
            past_row, past_col = min(box[2], window[2]), min(box[3], window[3])
            cells = np.mgrid[row:past_row, col:past_col].reshape(2, -1).T
            cells = cells[self._unobserved(cells, key)]
            cells = cells[self._can_be_seen(cells, key)]
            if len(cells):
                self._open[key] = cells
            else:
                self._open.pop(key, None)
        self._stale_open = set()
        if not self._open:
            return Completion((), np.zeros((0, 2), np.int64), "")
        open_cells = _in_raster_order(np.concatenate(list(self._open.values()))) - window[:2]
        x, y = self._middle(open_cells)
        text = f"no target was seen, and {unknown(open_cells)} near ({x:.1f}, {y:.1f}) could still be seen"
        return Completion((), open_cells, text)

    def _center_of(self, row: float, col: float) -> tuple[float, float]:
        """World x and y of the middle of a cell of the window."""
        cell, (x, y) = self._protocol.cell, self._origin
        west, south = x + self._window[1] * cell, y + self._window[0] * cell
        return float(west + (col + 0.5) * cell), float(south + (row + 0.5) * cell)

    def _middle(self, cells: IntArray) -> tuple[float, float]:
        return self._center_of(cells[:, 0].mean(), cells[:, 1].mean())


def _first(edge: float, lattice: float) -> int:
    """The first node from an edge on."""
    return math.ceil(edge / lattice - 1e-9)


def _grown(rectangle: Rectangle, margin: int) -> Rectangle:
    row, col, past_row, past_col = rectangle
    return row - margin, col - margin, past_row + margin, past_col + margin


def _box(key: Key, side: int) -> Rectangle:
    return key[0] * side, key[1] * side, (key[0] + 1) * side, (key[1] + 1) * side


def _blocks(rectangle: Rectangle, side: int) -> Iterator[Key]:
    row, col, past_row, past_col = rectangle
    return itertools.product(
        range(row // side, (past_row - 1) // side + 1), range(col // side, (past_col - 1) // side + 1)
    )


def _holds(outer: Rectangle, inner: Rectangle) -> bool:
    return outer[0] <= inner[0] and outer[1] <= inner[1] and outer[2] >= inner[2] and outer[3] >= inner[3]


def _meets(one: Rectangle, other: Rectangle) -> bool:
    return one[0] < other[2] and one[1] < other[3] and one[2] > other[0] and one[3] > other[1]


def _by_block(cells: IntArray) -> Iterator[tuple[Key, IntArray]]:
    """Cells (n, 2), sorted into their blocks."""
    keys = cells // SIDE
    order = np.lexsort((keys[:, 1], keys[:, 0]))
    ends = np.flatnonzero(np.any(np.diff(keys[order], axis=0), axis=1)) + 1
    for mine in np.split(order, ends):
        if len(mine):
            yield (int(keys[mine[0], 0]), int(keys[mine[0], 1])), cells[mine]


def _in_raster_order(cells: IntArray) -> IntArray:
    """(n, 2) by row, then column; as one number each they are sorted much faster."""
    flat = np.sort((cells[:, 0] << 32) + cells[:, 1])
    row = (flat + (1 << 31)) >> 32
    return np.stack((row, flat - (row << 32)), axis=1)


def _without(outer: Rectangle, inner: Rectangle) -> list[Rectangle]:
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


def _enlarged(pool: UInt64Array, capacity: int) -> UInt64Array:
    larger = np.zeros((capacity, *pool.shape[1:]), pool.dtype)
    larger[: len(pool)] = pool
    return larger


def _frozen(cells: IntArray) -> IntArray:
    cells.flags.writeable = False
    return cells
