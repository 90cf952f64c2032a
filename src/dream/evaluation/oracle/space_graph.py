"""The lattice of a protocol that moves in space as a graph: where moves lead, and what each frame inspects.

A pose is a node, one of the reachable places of `Inspection.free_space`, with a heading and a tilt; what can
be done next does not depend on the tilt. There are some two million of them in the world of a wreck, so that
what they inspect is kept by node: for each individual that shows there, the set of frames that inspect it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.evaluation.oracle._kernels import space as _kernels
from dream.protocol import SurveyProtocol
from dream.sim.inspection import Inspection, kept
from dream.sim.solids import FreeSpace
from dream.types import LOOK_AROUND

BoolArray = npt.NDArray[np.bool_]
Int32Array = npt.NDArray[np.int32]
IntpArray = npt.NDArray[np.intp]

CHUNK = 2048
"""Nodes whose frames are worked out at a time."""
TABLE = 40
"""Lattice steps east and north up to which distances in open water are looked up."""

Pose = tuple[int, int, int]
"""Node, heading and tilt, as numbers of a `SpaceGraph`."""


@dataclass(frozen=True, slots=True, eq=False)
class SpaceGraph:
    """P nodes, the moves between them, and the individuals that the frames at each of them inspect."""

    kernel: _kernels.SpaceArcs
    """As the kernels take it."""
    spacing: float
    """Metres between nodes."""
    actions: npt.NDArray[np.int64]
    """(A, 4) turn in heading steps, and which of the protocol's advances (0 among them), climbs and tilts."""
    individuals: IntpArray
    """(N,) those of the world that count, as indices into `World.targets`."""
    start: Pose
    """After the look-around."""
    looked: BoolArray
    """(4, N) what the look-around has inspected after the first look and after each quarter turn."""

    def after(self, pose: Pose, action: int) -> Pose | None:
        """Where an action leads; None where that touches something or leaves the free space."""
        turn, advance, climb, tilt = self.actions[action].tolist()
        heading = (pose[1] + turn) % self.headings
        move = self.kernel.moves[heading, advance * self.climbs + climb]
        node = int(self.kernel.ends[pose[0], move])
        return None if node < 0 else (node, heading, tilt)

    def walk(self, actions: Sequence[int]) -> list[Pose]:
        """The poses of a walk from the start, the start included.

        Raises:
            ValueError: An action is none, or leads nowhere.
        """
        poses = [self.start]
        for k, action in enumerate(actions):
            if not 0 <= action < len(self.actions):
                raise ValueError(f"action {k}: expected 0 to {len(self.actions) - 1}, got {action}")
            following = self.after(poses[-1], action)
            if following is None:
                raise ValueError(f"action {k}: {self.actions[action].tolist()} touches something")
            poses.append(following)
        return poses

    def actions_between(self, poses: Sequence[Pose]) -> tuple[int, ...]:
        """The actions of a walk through poses each one move apart.

        Raises:
            ValueError: Two of them are not.
        """
        walk = []
        for before, pose in pairwise(poses):
            turn = (pose[1] - before[1]) % self.headings
            found = [
                a
                for a in np.flatnonzero(
                    (self.actions[:, 0] % self.headings == turn) & (self.actions[:, 3] == pose[2])
                )
                if self.after(before, int(a)) == pose
            ]
            if not found:
                raise ValueError(f"walk: expected poses one move apart, got {before} and {pose}")
            walk.append(int(found[0]))
        return tuple(walk)

    def shows(self, pose: Pose) -> Int32Array:
        """The individuals that the frame of a pose inspects, as indices into `individuals`."""
        low, high = self.kernel.first[pose[0]], self.kernel.first[pose[0] + 1]
        frame = np.uint64(pose[1] * self.kernel.tilts + pose[2])
        shown: Int32Array = self.kernel.who[low:high][
            (self.kernel.frames[low:high] >> frame) & np.uint64(1) == 1
        ]
        return shown

    def inspected(self, poses: Sequence[Pose]) -> BoolArray:
        """(N,) what the look-around and these poses inspect."""
        result: BoolArray = self.looked[-1].copy()
        for pose in poses:
            result[self.shows(pose)] = True
        return result

    @property
    def headings(self) -> int:
        """Of each node."""
        return len(self.kernel.moves)

    @property
    def climbs(self) -> int:
        """How many there are."""
        return int(self.actions[:, 2].max()) + 1

    @property
    def positions(self) -> npt.NDArray[np.float64]:
        """(P, 3) metres in the world."""
        return self.kernel.places.astype(np.float64) * self.spacing


def space_graph(inspection: Inspection, *, start: int = 0) -> SpaceGraph:
    """The graph of a world, from one of its starts.

    Takes one or two minutes of CPU for a wreck; what its frames inspect is kept in the user's cache.

    Raises:
        ValueError: There is no such start, or the protocol's vehicle swims: it does not move on a graph.
    """
    world, protocol, space = inspection.world, inspection.protocol, inspection.free_space
    if protocol.swims:
        raise ValueError(
            f"protocol: expected one whose moves are exact, got {protocol.name}, whose vehicle swims"
        )
    if not 0 <= start < len(world.starts):
        raise ValueError(f"start: expected 0 to {len(world.starts) - 1} for {world.name}, got {start}")
    level, row, col = np.nonzero(space.reachable)
    places = (np.column_stack([col, row, level]) + np.array(space.first)).astype(np.int32)
    offsets, moves = _moves_of(protocol)
    node_of = np.full(space.reachable.shape, -1, np.int32)
    node_of[level, row, col] = np.arange(len(places), dtype=np.int32)

    def work_out() -> dict[str, npt.NDArray[Any]]:
        first, who, frames = _shown(inspection, places * protocol.lattice)
        ends = _ends(inspection, places, node_of, space, offsets)
        return {"first": first, "who": who, "frames": frames, "ends": ends}

    tables = kept.tables("frames", world, protocol, work_out)
    kernel = _kernels.SpaceArcs(
        places=places,
        ends=tables["ends"],
        moves=moves,
        back=_back(offsets),
        turns=np.array(protocol.turns, np.int64),
        tilts=len(protocol.tilts),
        first=tables["first"],
        who=tables["who"],
        frames=tables["frames"],
        apart=_apart(protocol),
        rises=_rises(protocol, int(np.ptp(places[:, 2])) if len(places) else 0),
        stride=max(math.hypot(east, north) for east, north, _ in offsets.tolist()),
    )
    individuals = np.flatnonzero(inspection.countable)

    home = protocol.snap(world.starts[start])
    z = protocol.launch_height(float(world.terrain.height(home.x, home.y)))
    at = [round(metres / protocol.lattice) for metres in (home.x, home.y, z)]
    found = np.flatnonzero((places == at).all(axis=1))
    if not len(found):
        raise ValueError(f"start: ({home.x:g}, {home.y:g}) is no free place")
    node = int(found[0])
    facing, tilt = protocol.heading_index(home.yaw), protocol.tilts.index(protocol.camera_pitch)
    looks = [
        (node, (facing + k * protocol.headings // 4) % protocol.headings, tilt)
        for k in range(LOOK_AROUND + 1)
    ]
    graph = SpaceGraph(
        kernel, protocol.lattice, actions_of(protocol), individuals, looks[-1],
        np.zeros((len(looks), len(individuals)), np.bool_),
    )  # fmt: skip
    for k, pose in enumerate(looks):
        graph.looked[k:, graph.shows(pose)] = True
    return graph


def actions_of(protocol: SurveyProtocol) -> npt.NDArray[np.int64]:
    """(A, 4) as `SpaceGraph.actions`: all that a vehicle can do in one step. One of them is to hold."""
    sizes = len(protocol.turns), 1 + len(protocol.advances), len(protocol.climbs), len(protocol.tilts)
    actions = np.stack(np.unravel_index(np.arange(math.prod(sizes)), sizes), axis=1).astype(np.int64)
    actions[:, 0] = np.array(protocol.turns)[actions[:, 0]]
    return actions


def _moves_of(protocol: SurveyProtocol) -> tuple[IntpArray, Int32Array]:
    """(K, 3) all moves, lattice steps east, north and up; (headings, advances · climbs) those of each."""
    climbs = [round(climb / protocol.lattice) for climb in protocol.climbs]
    of_heading = [
        [(*protocol.offset(h, a), c) for a in (0.0, *protocol.advances) for c in climbs]
        for h in range(protocol.headings)
    ]
    every = sorted({move for moves in of_heading for move in moves})
    number = {move: k for k, move in enumerate(every)}
    moves = [[number[move] for move in moves] for moves in of_heading]
    return np.array(every, np.intp), np.array(moves, np.int32)


def _back(offsets: IntpArray) -> Int32Array:
    """(K,) the move that leads back, for each of the moves (K, 3).

    Raises:
        ValueError: There is none: the headings do not come in opposite pairs, or climbs do not.
    """
    number = {move: k for k, move in enumerate(map(tuple, offsets.tolist()))}
    try:
        return np.array([number[tuple(-step for step in move)] for move in number], np.int32)
    except KeyError as error:
        raise ValueError(f"protocol: expected moves both ways, got none by {error} lattice steps") from error


def _shown(
    inspection: Inspection, eyes: npt.NDArray[np.float64]
) -> tuple[IntpArray, Int32Array, npt.NDArray[np.uint64]]:
    parts = [inspection.shown_from(eyes[low : low + CHUNK]) for low in range(0, len(eyes), CHUNK)]
    counts = np.concatenate([np.diff(first) for first, _, _ in parts] or [np.empty(0, np.intp)])
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
    who = np.concatenate([who for _, who, _ in parts] or [np.empty(0, np.int32)])
    frames = np.concatenate([frames for _, _, frames in parts] or [np.empty(0, np.uint64)])
    return first, who, frames


def _ends(
    inspection: Inspection, places: Int32Array, node_of: Int32Array, space: FreeSpace, offsets: IntpArray
) -> Int32Array:
    """(P, K) node at the end of each move; −1 where there is none, or something is in the way."""
    from scipy.ndimage import maximum_filter

    solids, protocol = inspection.solids, inspection.protocol
    # No move is tried whose body stays above all that its surroundings hold.
    index = solids.index
    reach = protocol.body_radius + float(np.abs(offsets[:, :2]).max(initial=0)) * space.spacing
    size = 2 * math.ceil(reach / index.cell) + 1
    roofs = maximum_filter(np.maximum(index.top, index.ground_top), size, mode="constant", cval=-np.inf)
    at = places * space.spacing
    rows = np.clip(np.floor((at[:, 1] - index.y0) / index.cell).astype(np.intp), 0, roofs.shape[0] - 1)
    cols = np.clip(np.floor((at[:, 0] - index.x0) / index.cell).astype(np.intp), 0, roofs.shape[1] - 1)
    # A hand's breadth covers the folds of the ground between a cell and the next.
    high = at[:, 2] - 0.5 * protocol.body_height - roofs[rows, cols]

    ends = np.full((len(places), len(offsets)), -1, np.int32)
    grid = (places - np.array(space.first))[:, ::-1]
    shape = np.array(node_of.shape)
    for k, (move, back) in enumerate(zip(offsets.tolist(), _back(offsets).tolist(), strict=True)):
        if back < k:
            # There and back agree.
            there = np.flatnonzero(ends[:, back] >= 0)
            ends[ends[there, back], k] = there
            continue
        to = grid + np.array(move[::-1])
        inside = np.flatnonzero(((to >= 0) & (to < shape)).all(axis=1))
        end = node_of[tuple(to[inside].T)]
        begin, end = inside[end >= 0], end[end >= 0]
        tried = high[begin] + min(move[2], 0) * space.spacing <= 0.1
        free = ~tried
        free[tried] = solids.passes_through(at[begin[tried]], at[end[tried]], protocol)
        ends[begin[free], k] = end[free]
    return ends


def _apart(protocol: SurveyProtocol) -> npt.NDArray[np.uint8]:
    """(headings, headings, side, side) fewest steps over the plane, with nothing in the way.

    From one heading at the middle to another one so many lattice steps north and east of there.
    """
    side = 2 * TABLE + 1
    offsets = np.array(
        [[protocol.offset(h, a) for a in (0.0, *protocol.advances)] for h in range(protocol.headings)]
    )
    apart: npt.NDArray[np.uint8] = _kernels.steps_in_open_water(offsets, np.array(protocol.turns), side)
    return apart


def _rises(protocol: SurveyProtocol, most: int) -> npt.NDArray[np.uint8]:
    """(2 · most + 1,) fewest steps to so many lattice steps below to above."""
    climbs = [round(climb / protocol.lattice) for climb in protocol.climbs]
    steps = np.full(2 * most + 1, 255, np.uint8)
    steps[most] = 0
    layer, count = {0}, 0
    while layer and count < 254:
        count += 1
        layer = {z + climb for z in layer for climb in climbs if abs(z + climb) <= most}
        layer = {z for z in layer if steps[z + most] == 255}
        for z in layer:
            steps[z + most] = count
    return steps
