"""Ways through water that is known to be free: where the body fits, and how many steps it takes there."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds, wrap_angle
from dream.lattice import nodes_in, offsets_of
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, Decision

if TYPE_CHECKING:
    from dream.mapping.volume import Volume
    from dream.planning._kernels.looks import LookScene
    from dream.planning._kernels.space_beam import SpaceLattice
    from dream.planning._kernels.ways import SpaceMoves

FloatArray = npt.NDArray[np.floating[Any]]
WORD = 64
"""Bits of the words that say under which heading and tilt something shows."""
Node = tuple[int, int, int]
"""Level, row and column of a node of the lattice, counted from the first in the box."""


@dataclass(frozen=True, eq=False)
class KnownWays:
    """The lattice in three dimensions over a box, and where in it the body fits by what is known.

    What it does: the body fits where every voxel that it touches is free, as the guard has it, and stays no
    lower over what is solid than the protocol says. Between the nodes it is looked at twice a lattice step.
    Assumes: voxels that are half a lattice step wide and begin at the world's origin.
    """

    protocol: SurveyProtocol
    first: Node
    """Level, row and column of the box's first node, from the world's origin."""
    fits: npt.NDArray[np.uint8]
    """(levels, rows, cols) at fine points."""
    stands: npt.NDArray[np.uint8]
    """(levels, rows, cols) at nodes."""
    scene: LookScene
    """The voxels around."""
    moves: SpaceMoves = field(repr=False)
    """Of a step."""
    _from: dict[tuple[Node, int], tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]] = field(
        default_factory=dict, repr=False
    )
    """Steps to all poses and the pose before each, by the node and heading from which they were asked for."""

    @property
    def shape(self) -> Node:
        """Levels, rows and columns of nodes."""
        levels, rows, cols = self.stands.shape
        return levels, rows, cols

    @cached_property
    def positions(self) -> FloatArray:
        """(levels, rows, cols, 3) metres in the world."""
        at = np.moveaxis(np.indices(self.shape), 0, -1) + np.array(self.first)
        return np.asarray(at[..., ::-1] * self.protocol.lattice, np.float64)

    def node(self, x: float, y: float, z: float) -> Node:
        """The node nearest to a position; of one beyond the box, as drift may bring it, the nearest in it."""
        spacing = self.protocol.lattice
        at = (round(v / spacing) - low for v, low in zip((z, y, x), self.first, strict=True))
        level, row, col = (min(max(k, 0), size - 1) for k, size in zip(at, self.shape, strict=True))
        return level, row, col

    def steps(self, pose: SE2, z: float) -> npt.NDArray[np.int32]:
        """(levels, rows, cols, headings) fewest steps from a pose to all; −1 where no known way leads."""
        here = self.node(pose.x, pose.y, z), self.protocol.heading_index(pose.yaw)
        if here not in self._from:
            nowhere = np.zeros(self.shape, np.bool_)
            every = np.ones(self.protocol.headings, np.bool_)
            self._from[here] = self._search(*here, nowhere, every)[:2]
        return self._from[here][0]

    def to(self, pose: SE2, z: float, goal: BoolArray, facing: BoolArray) -> list[Decision] | None:
        """The moves of a shortest way from a pose to the nearest of a goal; None where none is known.

        Args:
            pose: Where the vehicle is.
            z: Its height.
            goal: (levels, rows, cols) nodes.
            facing: (headings,) that it may have at the end.
        """
        here, heading = self.node(pose.x, pose.y, z), self.protocol.heading_index(pose.yaw)
        possible = goal & (self.stands > 0)
        possible[here] = goal[here]
        count = np.count_nonzero(possible)
        if not count:
            return None
        if count == 1 and np.count_nonzero(facing) == 1 and (here, heading) in self._from:
            steps, parent = self._from[here, heading]
            found = int(possible.argmax()) * self.protocol.headings + int(facing.argmax())
            if steps.flat[found] < 0:
                return None
        else:
            _, parent, found = self._search(here, heading, possible, facing)
        if found < 0:
            return None
        path = [found]
        while (before := int(parent[path[-1]])) >= 0:
            path.append(before)
        return [self._move(a, b) for a, b in zip(path[::-1], path[-2::-1], strict=False)]

    def _search(
        self, here: Node, heading: int, goal: BoolArray, facing: BoolArray
    ) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32], int]:
        from dream.planning._kernels import ways as kernels

        steps, parent, found = kernels.search(
            self.fits, self.stands, self.moves, np.array(here), heading, goal, facing
        )
        return steps, parent, int(found)

    def _move(self, before: int, after: int) -> Decision:
        """The decision that leads from one pose of a way to the next."""
        protocol, headings = self.protocol, self.protocol.headings
        turn = wrap_angle((after % headings - before % headings) * protocol.heading_step)
        _, rows, cols = self.shape
        a, b = (
            np.array(np.unravel_index(p // headings, (self.shape[0], rows, cols))) for p in (before, after)
        )
        up, north, east = (b - a).tolist()
        lengths = {protocol.offset(after % headings, length): length for length in (0.0, *protocol.advances)}
        return Decision(turn, lengths[(east, north)], climb=up * protocol.lattice)


def ways_in(volume: Volume, bounds: Bounds, protocol: SurveyProtocol) -> KnownWays:
    """The ways through a volume within bounds and below the surface of the water, as known now.

    Args:
        volume: What is known; its voxels are half a lattice step wide.
        bounds: The survey area.
        protocol: That moves in space.
    """
    from dream.mapping.volume import FREE, MARGIN, SOLID
    from dream.planning._kernels import ways as kernels
    from dream.planning._kernels.looks import LookScene

    assert protocol.space is not None
    spacing, side = protocol.lattice, volume.cell
    if abs(side * kernels.FINE - spacing) > 1e-9:
        raise ValueError(f"volume: expected voxels of {spacing / kernels.FINE} m, got {side} m")
    (row, col), (rows, cols) = nodes_in(bounds, protocol)
    box = volume.box
    low, high = (-1.0, -protocol.space.surface) if box is None else (float(box[0, 2]), float(box[1, 2]))
    level = math.floor(low / spacing)
    levels = max(math.floor(min(high, -protocol.space.surface) / spacing) - level + 1, 1)
    # How many voxels the body reaches from a corner of voxels, its margin included; touching one counts.
    across = math.floor((protocol.body_radius + MARGIN) / side + 1e-9) + 1
    upright = math.floor((0.5 * protocol.body_height + MARGIN) / side + 1e-9) + 1
    fine = tuple(kernels.FINE * (n - 1) + 1 for n in (levels, rows, cols))
    # The voxel (k, j, i) begins at fine point (k, j, i) of the padded grid.
    pad = (upright, across, across)
    corner = np.array([level, row, col], np.int64) * kernels.FINE - np.array(pad, np.int64)
    size = fine[0] + 2 * pad[0], fine[1] + 2 * pad[1], fine[2] + 2 * pad[2]
    states = volume.states_in(corner, size)
    fits = states == FREE
    for axis, (reached, count) in enumerate(zip(pad, fine, strict=True)):
        # The body at a fine point touches as many voxels before it as after it.
        fits = _all_in_a_row(fits, 2 * reached, axis)[(slice(None),) * axis + (slice(count),)]
    nodes = (slice(None, None, kernels.FINE),) * 3
    stands = fits[nodes].astype(np.uint8)
    # Is nothing solid in the voxels right below the centre, as far as it stays above the ground?
    clear = math.ceil(protocol.space.lowest / side - 1e-9)
    column = tuple(slice(across, across + count, kernels.FINE) for count in fine[1:])
    bare = np.pad(
        states[(slice(upright + fine[0] - 1), *column)] != SOLID,
        ((clear, 0), (0, 0), (0, 0)),
        constant_values=True,
    )
    stands[~_all_in_a_row(bare, clear, 0)[upright : upright + fine[0] : kernels.FINE]] = 0
    stands &= volume.held((level, row, col), spacing, (levels, rows, cols))
    steps = np.array(protocol.turns, np.int64)
    none = np.zeros((protocol.headings, 1, 2), np.int64)
    # What lies beyond the area's cells has none: its edge in the north and the east is theirs no more.
    at = np.arange(rows) + row, np.arange(cols) + col
    stands[:, at[0] * spacing >= bounds.y_max - 1e-9] = 0
    stands[:, :, at[1] * spacing >= bounds.x_max - 1e-9] = 0
    moves = kernels.SpaceMoves(
        steps,
        np.concatenate([none, offsets_of(protocol)], axis=1),
        # Of two ways of as many steps, the one that climbs less.
        np.array(sorted((round(climb / spacing) for climb in protocol.climbs), key=abs), np.int64),
    )
    scene = LookScene(states, corner, side)
    return KnownWays(
        protocol, (level, row, col), np.ascontiguousarray(fits).view(np.uint8), stands, scene, moves
    )


def _all_in_a_row(values: BoolArray, count: int, axis: int) -> BoolArray:
    """Whether so many values in a row along an axis are all set, by the first of each row of them."""
    length, before = 1, (slice(None),) * axis
    while length < count:
        step = min(length, count - length)
        values = values[(*before, slice(None, -step))] & values[(*before, slice(step, None))]
        length += step
    return values


def lattice_of(ways: KnownWays) -> SpaceLattice:
    """Ways as the kernels take them.

    Raises:
        ValueError: There are more headings and tilts than bits in a word: each has one.
    """
    from dream.planning._kernels.space_beam import SpaceLattice

    protocol = ways.protocol
    if protocol.headings * len(protocol.tilts) > WORD:
        raise ValueError(
            f"protocol: expected at most {WORD} headings times tilts to plan in space, "
            f"got {protocol.headings} times {len(protocol.tilts)}"
        )
    return SpaceLattice(
        ways.fits,
        ways.stands,
        np.array(ways.first[::-1], np.float64) * protocol.lattice,
        protocol.lattice,
        _directions(np.arange(protocol.headings) * protocol.heading_step),
        _directions(np.array(protocol.tilts, np.float64)),
    )


def _directions(angles: FloatArray) -> npt.NDArray[np.float64]:
    """(n, 2) cosine and sine."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)
