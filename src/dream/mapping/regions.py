"""Target regions and what is open about them, kept up to date where the map changes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from dream.geometry import Bounds
from dream.mapping._bits import UInt64Array
from dream.mapping._rectangles import (
    Key,
    Rectangle,
    Window,
    by_block,
    frozen,
    holds,
    in_raster_order,
    inside,
    shared,
    widened,
)
from dream.mapping.completion import MARGIN_CELLS, Completion, Region, describe
from dream.mapping.layers import BLOCK
from dream.mapping.nearness import within
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, IntArray

IsOpen = Callable[[IntArray, Key], BoolArray]
"""(n,) which cells (n, 2) of a block nothing observed that could be seen."""


@dataclass(slots=True, eq=False)
class _Part:
    """Target cells of one block that belong together within it."""

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
    """Around the cells."""
    outline: dict[Key, IntArray] | None = None
    """The cells near its own or in its holes, by block; None when they must be found anew."""
    open_cells: dict[Key, IntArray] = field(default_factory=dict)
    """Those of them that are open."""
    stale: set[Key] = field(default_factory=set)
    """Blocks of the outline whose open cells must be found anew."""
    region: Region | None = None
    """As of when nothing was stale; None when it must be made anew."""


class Regions:
    """Target regions, and which cells at their edge or in their holes are open.

    What it does: `regroup` forms the regions anew that gained or lost target cells, `mark` notes in which
    blocks open cells may be others; `completion` then finds these and outlines new regions. The cost
    depends on the regions concerned, not on the map.

    Reference: see `check_completion`. A part is what belongs together within one block; regions are
    parts united.

    Assumes: a `group_radius` of less than 64 cells.
    """

    def __init__(self, protocol: SurveyProtocol, is_open: IsOpen) -> None:
        """No target yet.

        Args:
            protocol: Cell and group.
            is_open: Asked about the cells of an outline.
        """
        self._is_open = is_open
        self._link = (protocol.group_radius / protocol.cell) ** 2
        self._link_reach = math.floor(math.sqrt(self._link) + 1e-9)
        if self._link_reach >= BLOCK:
            raise ValueError(f"group_radius: expected less than {BLOCK} cells, got {self._link_reach}")
        self._labels: dict[Key, npt.NDArray[np.int16]] = {}
        """(64, 64) parts of a block from 1, 0 where there is no target."""
        self._numbers: dict[Key, list[int]] = {}
        """The parts of a block, by label less one."""
        self._parts: dict[int, _Part] = {}
        self._next = 0
        self._groups: set[_Group] = set()
        self._group_of: dict[int, _Group] = {}
        """By part."""
        self._over: dict[Key, set[_Group]] = {}
        """Those whose outline reaches into a block."""
        self._window: Window | None = None
        self._completion: Completion | None = None

    def __len__(self) -> int:
        return len(self._groups)

    # -------------------------------------------------------------------------------------- what changed

    def enter(self, window: Window) -> None:
        """Another window: what it cuts otherwise is found anew."""
        old, self._window = self._window, window
        self._completion = None
        for group in self._groups:
            if old is not None and old.area != window.area:
                group.stale.update(group.outline or ())
            if old is None or old.low != window.low:
                group.region = None
            if old is None or not holds(shared(old.cells, window.cells), _around(group.box)):
                self._forget_outline(group)

    def mark(self, blocks: Iterable[Key]) -> None:
        """Whether cells of these blocks are open may have changed."""
        for key in self._over.keys() & blocks:
            self._completion = None
            for group in self._over[key]:
                group.stale.add(key)

    def regroup(self, targets: dict[Key, UInt64Array]) -> None:
        """Take in the target cells of blocks where they are others."""
        if not targets:
            return
        self._completion = None
        loose: set[int] = set()
        """Parts whose region must be found anew."""
        for key, words in targets.items():
            for number in self._numbers.pop(key, []):
                loose |= self._disband(number)
                loose.discard(number)
                for other in self._parts.pop(number).linked:
                    self._parts[other].linked.discard(number)
            self._labels.pop(key, None)
            if words.any():
                loose |= self._label(key, words)
        for key in targets.keys() & self._numbers.keys():
            loose |= self._tie(key)
        loose &= self._parts.keys()
        while loose:
            members = {loose.pop()}
            todo = list(members)
            while todo:
                new = self._parts[todo.pop()].linked - members
                members |= new
                todo.extend(new)
            loose -= members
            self._form(sorted(members))

    def _disband(self, number: int) -> set[int]:
        """The parts of the region that a part was in, which is no more."""
        group = self._group_of.get(number)
        if group is None:
            return set()
        self._groups.remove(group)
        self._forget_outline(group)
        for part in group.parts:
            del self._group_of[part]
        return set(group.parts)

    def _label(self, key: Key, words: UInt64Array) -> set[int]:
        """New parts of a block."""
        from dream.mapping._kernels import edges

        mask = np.unpackbits(words.view(np.uint8).reshape(BLOCK, 8), axis=1, bitorder="little")
        labels, count = edges.label_within(mask.astype(np.bool_), self._link)
        cells = np.argwhere(labels)
        members = labels[cells[:, 0], cells[:, 1]]
        order = np.argsort(members, kind="stable")
        cells = cells[order] + (key[0] * BLOCK, key[1] * BLOCK)
        ends = np.searchsorted(members[order], np.arange(2, count + 1))
        numbers = range(self._next, self._next + count)
        self._next += count
        self._labels[key] = labels.astype(np.int16)
        self._numbers[key] = list(numbers)
        self._parts.update(zip(numbers, map(_Part, np.split(cells, ends)), strict=True))
        return set(numbers)

    def _tie(self, key: Key) -> set[int]:
        """Link the parts of a block with those around; the parts of regions that this brings in."""
        from dream.mapping._kernels import progress

        around = [(key[0] + i, key[1] + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        if not any(other in self._labels for other in around if other != key):
            return set()
        nothing = np.zeros((BLOCK, BLOCK), np.int16)
        labels = np.stack([self._labels.get(other, nothing) for other in around])
        loose: set[int] = set()
        for mine, side, theirs in progress.link_parts(labels, self._link_reach, self._link).tolist():
            one, other = self._numbers[key][mine - 1], self._numbers[around[side]][theirs - 1]
            self._parts[one].linked.add(other)
            self._parts[other].linked.add(one)
            loose |= self._disband(other)
        return loose

    def _form(self, numbers: list[int]) -> None:
        """A new region."""
        cells = in_raster_order(self._parts[number].cells for number in numbers)
        (row, col), (last_row, last_col) = cells.min(axis=0), cells.max(axis=0)
        group = _Group(numbers, cells, (int(row), int(col), int(last_row) + 1, int(last_col) + 1))
        self._groups.add(group)
        self._group_of.update(dict.fromkeys(numbers, group))

    def _forget_outline(self, group: _Group) -> None:
        for key in group.outline or ():
            self._over[key].remove(group)
        group.outline = None

    # ----------------------------------------------------------------------------------------- what is open

    def completion(self, window: Window) -> Completion:
        """Regions in the raster order of their first cells; the same object until something changes.

        Of those nothing of whose outline lies in the area, none is named.
        """
        if self._completion is None:
            groups = sorted(self._groups, key=lambda group: tuple(group.cells[0].tolist()))
            renewed = [(group, self._renewed(group, window)) for group in groups]
            regions = tuple(region for group, region in renewed if _concerns(group, window))
            open_cells = in_raster_order(region.open_cells for region in regions)
            self._completion = Completion(regions, frozen(open_cells), describe(regions, window.middle))
        return self._completion

    def _renewed(self, group: _Group, window: Window) -> Region:
        """What a region is now."""
        outline = group.outline
        if outline is None:
            outline = group.outline = _outlined(group, window)
            group.stale, group.open_cells = set(outline), {}
            for key in outline:
                self._over.setdefault(key, set()).add(group)
        elif group.region is not None and not group.stale:
            return group.region
        for key in group.stale:
            group.open_cells[key] = outline[key][self._is_open(outline[key], key)]
        group.stale = set()
        open_cells = frozen(in_raster_order(group.open_cells.values()) - window.low)
        if group.region is None:
            row, col, past_row, past_col = group.box
            west, south = window.center_of(row - window.low[0], col - window.low[1])
            east, north = window.center_of(past_row - 1 - window.low[0], past_col - 1 - window.low[1])
            half = 0.5 * window.cell
            extent = Bounds(west - half, south - half, east + half, north + half)
            cells = frozen(group.cells - window.low)
            group.region = Region(cells, window.middle(cells), extent, open_cells)
        else:
            group.region = replace(group.region, open_cells=open_cells)
        return group.region


def _concerns(group: _Group, window: Window) -> bool:
    """Does anything of a region's outline lie in the area that has to be seen?"""
    area, outline = window.area, group.outline or {}
    return area is None or any(bool(inside(cells, area).any()) for cells in outline.values())


def _around(box: Rectangle) -> Rectangle:
    """As far as an outline may go, and one more cell that is not in it."""
    return widened(box, MARGIN_CELLS + 1)


def _outlined(group: _Group, window: Window) -> dict[Key, IntArray]:
    """The cells near a region's own or in its holes, by block."""
    from dream.mapping._kernels import progress

    row, col, past_row, past_col = shared(_around(group.box), window.cells)
    mask = np.zeros((past_row - row, past_col - col), np.bool_)
    mask[tuple((group.cells - (row, col)).T)] = True
    outlined = progress.filled(within(mask, MARGIN_CELLS, 1.0))
    cells: IntArray = np.argwhere(outlined)
    cells += (row, col)
    return dict(by_block(cells, BLOCK))
