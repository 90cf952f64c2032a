"""The protocol's lattice as a graph: what the simulator lets a mission do, and what each pose shows.

Bounds that are certified on this graph hold for every mission without a collision, since the simulator
moves on exactly these arcs and scores by exactly these views.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.protocol import SurveyProtocol
from dream.sim.visibility import Visibility, lattice_yaws
from dream.sim.world import World
from dream.types import LOOK_AROUND

Int32Array = npt.NDArray[np.int32]
UInt64Array = npt.NDArray[np.uint64]
BoolArray = npt.NDArray[np.bool_]

CHUNK = 4096
"""Poses whose views are worked out at a time."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraph:
    """P poses of the vehicle, the moves between them, and the individuals that each of them sees."""

    poses: npt.NDArray[np.float64]
    """(P, 3) x, y, yaw: every reachable node of the lattice with every heading."""
    arcs: Int32Array
    """(P, A) pose that each action leads to; −1 where the move touches something or leaves the lattice."""
    actions: tuple[tuple[int, float], ...]
    """(A) turn in heading steps and nominal advance in metres; never both zero."""
    views: UInt64Array
    """(P, W) bit i % 64 of word i // 64 says whether the pose sees individual i."""
    individuals: npt.NDArray[np.intp]
    """(N,) those of the world that count, as indices into `World.targets`."""
    start: int
    """The pose after the look-around."""
    shown: UInt64Array
    """(W,) what the look-around showed, in the bits of `views`."""

    def walk(self, actions: Sequence[int]) -> list[int]:
        """The poses of a walk from the start, the start included.

        Raises:
            ValueError: An action is none, or touches something.
        """
        poses = [self.start]
        for k, action in enumerate(actions):
            if not 0 <= action < len(self.actions):
                raise ValueError(f"action {k}: expected 0 to {len(self.actions) - 1}, got {action}")
            after = int(self.arcs[poses[-1], action])
            if after < 0:
                x, y, _ = self.poses[poses[-1]]
                raise ValueError(f"action {k}: {self.actions[action]} from ({x:g}, {y:g}) touches something")
            poses.append(after)
        return poses

    def seen(self, poses: Sequence[int]) -> UInt64Array:
        """(W,) what the look-around and these poses show together."""
        bits: UInt64Array = np.bitwise_or.reduce(self.views[np.asarray(poses, np.intp)], axis=0)
        return bits | self.shown


def pose_graph(
    world: World, protocol: SurveyProtocol, *, start: int = 0, visibility: Visibility | None = None
) -> PoseGraph:
    """The graph of a world under a protocol, from one of its starts.

    Takes a few seconds of CPU and, for `dream-v1`, some 60 MB.

    Raises:
        ValueError: The protocol's vehicle swims: it does not move on a graph.
    """
    if protocol.swims:
        raise ValueError(
            f"protocol: expected one whose moves are exact, got {protocol.name}, whose vehicle swims. "
            "Bounds of dream-v1 are the nearest thing"
        )
    visibility = visibility or Visibility(world, protocol)
    lattice = visibility.lattice
    rows, cols = np.nonzero(lattice.reachable)
    node_of = np.full(lattice.reachable.shape, -1, np.int64)
    node_of[rows, cols] = np.arange(len(rows))
    headings = protocol.headings
    positions = lattice.positions[rows, cols]
    yaws = np.tile(lattice_yaws(protocol), len(rows))
    poses = np.column_stack([np.repeat(positions, headings, axis=0), yaws])

    individuals = np.flatnonzero(visibility.countable)
    home = world.starts[start]
    row = round(home.y / protocol.lattice) - lattice.first[1]
    col = round(home.x / protocol.lattice) - lattice.first[0]
    at_start = int(node_of[row, col]) * headings
    quarter = headings // 4
    first = protocol.heading_index(home.yaw)
    looked = [at_start + (first + k * quarter) % headings for k in range(LOOK_AROUND + 1)]
    views = _views(visibility, poses, individuals)
    return PoseGraph(
        poses=poses,
        arcs=_arcs(visibility, protocol, node_of),
        actions=actions_of(protocol),
        views=views,
        individuals=individuals,
        start=looked[-1],
        shown=np.bitwise_or.reduce(views[looked], axis=0),
    )


def actions_of(protocol: SurveyProtocol) -> tuple[tuple[int, float], ...]:
    """All (turn, advance) of a protocol that change the pose."""
    every = [(turn, advance) for turn in protocol.turns for advance in (0.0, *protocol.advances)]
    return tuple(action for action in every if action != (0, 0.0))


def _views(
    visibility: Visibility, poses: npt.NDArray[np.float64], individuals: npt.NDArray[np.intp]
) -> UInt64Array:
    words = math.ceil(len(individuals) / 64)
    bits = np.zeros((len(poses), 8 * words), np.uint8)
    for low in range(0, len(poses), CHUNK):
        seen = visibility.seen(poses[low : low + CHUNK])[:, individuals]
        packed = np.packbits(seen, axis=1, bitorder="little")
        bits[low : low + CHUNK, : packed.shape[1]] = packed
    return bits.view("<u8").astype(np.uint64, copy=False)


def _arcs(visibility: Visibility, protocol: SurveyProtocol, node_of: npt.NDArray[np.int64]) -> Int32Array:
    headings = protocol.headings
    offsets = np.array([[protocol.offset(h, a) for a in protocol.advances] for h in range(headings)])
    nodes = int((node_of >= 0).sum())
    ends = _ends(visibility, protocol, node_of, offsets.reshape(-1, 2)).reshape(nodes, headings, -1)
    node, heading = np.divmod(np.arange(nodes * headings), headings)
    arcs = np.empty((len(node), len(actions_of(protocol))), np.int32)
    for k, (turn, advance) in enumerate(actions_of(protocol)):
        to = (heading + turn) % headings
        end = node if advance == 0.0 else ends[node, to, protocol.advances.index(advance)]
        arcs[:, k] = np.where(end >= 0, end * headings + to, -1)
    return arcs


def _ends(
    visibility: Visibility,
    protocol: SurveyProtocol,
    node_of: npt.NDArray[np.int64],
    offsets: npt.NDArray[np.int64],
) -> npt.NDArray[np.int64]:
    """(nodes, offsets) node at the end of each move by an offset (east, north); −1 where there is none."""
    lattice = visibility.lattice
    rows, cols = np.nonzero(node_of >= 0)
    to_row, to_col = rows[:, None] + offsets[:, 1], cols[:, None] + offsets[:, 0]
    inside = (to_row >= 0) & (to_row < node_of.shape[0]) & (to_col >= 0) & (to_col < node_of.shape[1])
    ends = np.full(inside.shape, -1, np.int64)
    ends[inside] = node_of[to_row[inside], to_col[inside]]
    node, move = np.nonzero(ends >= 0)
    begin = lattice.positions[rows[node], cols[node]]
    end = lattice.positions[to_row[node, move], to_col[node, move]]
    free = visibility.solids.passes(begin, end, protocol)
    ends[node[~free], move[~free]] = -1
    return ends
