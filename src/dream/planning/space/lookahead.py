"""The way to go in three dimensions: a search over the real actions, and the way round what is left after."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dream.geometry import wrap_angle
from dream.planning.space.looks import nearest_tilt, optics_of
from dream.planning.space.remains import LeftToInspect, elements_of
from dream.planning.space.ways import KnownWays, lattice_of
from dream.types import Decision, IntArray, Observation

if TYPE_CHECKING:
    from dream.planning._kernels.space_beam import SpaceElements, SpaceSequences

WIDTH, HORIZON = 16, 5
"""Sequences of actions kept at each depth, and actions that they are long."""
STEP = 3.0
"""Square metres that a step of the way round what is left counts as much as."""
JUMP = 1.5
"""Square metres a step: where sequences show less, single looks farther away are asked for as well."""
NOTHING = 0.05
"""Square metres a step below which nothing is in sight."""
NEAR = 4.0
"""Metres from the middle of a part of what is left at which the way to it is done."""
STRIDE, CLIMB = 1.8, 1.0
"""Metres of a step over ground, and in height."""
SLIGHT = 0.3
"""Square metres of a part that are worth no way of their own."""
FAR = np.iinfo(np.int32).max


@dataclass(frozen=True, slots=True)
class SpacePlan:
    """The next move, and what the plan that it begins is for."""

    move: Decision
    rate: float
    """Square metres of what is left that it shows a step."""
    steps: int
    """To where it shows most a step."""
    node: tuple[int, int, int]
    """Level, row and column of that place."""
    heading: int
    tilt: int
    """With which it looks there."""
    why: str = ""
    """A sentence on how it was chosen."""


@dataclass(frozen=True, slots=True)
class SpaceLookAhead:
    """Chooses the real actions that show most soonest and leave the shortest way round the rest.

    What it does: a beam over turn, advance, climb and tilt, through water that is known to be free. A
    sequence is worth what it shows, each square metre once and the later the less, less the steps along the
    shortest tree over the parts of which something is left then. Where sequences show little, the best single
    look of all that can be got to is gone for, if its rate is better.

    Reference: the same as in the plane, see `planning.lookahead`; pathwise gain as in MapEx (2409.15590).
    """

    discount: float
    """What a square metre is worth a step later."""

    def plan(self, ways: KnownWays, left: LeftToInspect, observation: Observation) -> SpacePlan | None:
        """The best way; None where nothing is in sight.

        Args:
            ways: Through known water.
            left: What is left to look at.
            observation: Where the vehicle is.
        """
        if not len(left):
            return None
        elements = elements_of(left, ways.protocol)
        near = self._sequence(ways, elements, observation)
        if near is not None and near.rate >= JUMP:
            return near
        far = best_look(ways, elements, observation)
        return max((one for one in (near, far) if one is not None), key=lambda one: one.rate, default=None)

    def _sequence(
        self, ways: KnownWays, elements: SpaceElements, observation: Observation
    ) -> SpacePlan | None:
        from dream.planning._kernels.space_beam import SpaceScore, beam

        protocol = ways.protocol
        here = np.array(ways.node(observation.pose.x, observation.pose.y, observation.z))
        heading = protocol.heading_index(observation.pose.yaw)
        tilt = nearest_tilt(protocol, observation)
        found = beam(
            ways.scene,
            optics_of(protocol),
            lattice_of(ways),
            ways.moves,
            elements,
            SpaceScore(self.discount, STEP, SLIGHT, NEAR, STRIDE, CLIMB),
            here,
            heading,
            tilt,
            WIDTH,
            HORIZON,
        )
        last = np.flatnonzero(found.level == found.level.max())
        path = _traced(found, int(last[found.value[last].round(6).argmax()]))
        if len(path) < 2:
            return None
        rates = found.score[path[1:]] / np.cumsum(self.discount ** np.arange(1, len(path)))
        most = int(rates.round(9).argmax())
        if rates[most] <= NOTHING:
            return None
        first, goal = path[1], path[1 + most]
        up, north, east = (found.node[first] - here).tolist()
        to = int(found.heading[first])
        lengths = {protocol.offset(to, length): length for length in (0.0, *protocol.advances)}
        move = Decision(
            wrap_angle((to - heading) * protocol.heading_step),
            lengths[(east, north)],
            climb=up * protocol.lattice,
            tilt=None if found.tilt[first] == tilt else protocol.tilts[found.tilt[first]],
        )
        level, row, col = found.node[goal].tolist()
        return SpacePlan(
            move,
            float(rates[most]),
            most + 1,
            (level, row, col),
            int(found.heading[goal]),
            int(found.tilt[goal]),
        )


def best_look(ways: KnownWays, elements: SpaceElements, observation: Observation) -> SpacePlan | None:
    """The way to the look with the best rate of all that can be got to; None where none shows anything.

    Args:
        ways: Through known water.
        elements: What is left to look at.
        observation: Where the vehicle is.
    """
    from dream.planning._kernels.space_beam import best_views

    steps = ways.steps(observation.pose, observation.z)
    nodes = nodes_near(ways, steps, elements)
    if not len(nodes):
        return None
    weight, heading, tilt = best_views(
        ways.scene, optics_of(ways.protocol), lattice_of(ways), elements, nodes
    )
    there = steps[(*nodes.T, heading)].astype(np.float64)
    there[there < 0] = np.inf
    rates = np.round(weight / np.maximum(there, 1.0), 6)
    best = int(rates.argmax())
    if rates[best] <= NOTHING:
        return None
    level, row, col = nodes[best].tolist()
    node, to, pitch = (level, row, col), int(heading[best]), int(tilt[best])
    path = way_to(ways, node, to, pitch, observation)
    assert path, "a way leads to what was reached"
    return SpacePlan(path[0], float(rates[best]), max(int(there[best]), 1), node, to, pitch)


def nodes_near(ways: KnownWays, steps: IntArray, elements: SpaceElements) -> IntArray:
    """(n, 3) nodes that can be got to and have something left within reach: all near by, else every second.

    Args:
        ways: The lattice.
        steps: (levels, rows, cols, headings) see `KnownWays.steps`.
        elements: What is left.
    """
    from scipy.spatial import cKDTree

    soonest = np.where(steps >= 0, steps, FAR).min(axis=-1)
    nodes = np.argwhere(soonest < FAR)
    even = ((nodes + np.array(ways.first)) % 2 == 0).all(axis=1)
    nodes = nodes[even | (soonest[tuple(nodes.T)] <= 2)]
    at = (nodes + np.array(ways.first))[:, ::-1] * ways.protocol.lattice
    away, _ = cKDTree(elements.points).query(at, distance_upper_bound=ways.protocol.reach)
    return np.ascontiguousarray(nodes[np.isfinite(away)])


def way_to(
    ways: KnownWays, node: tuple[int, int, int], heading: int, tilt: int, observation: Observation
) -> list[Decision] | None:
    """The moves of the shortest way to a look, at least one; None where no way is known.

    The first tilts the camera as the look has it where it is the last as well, else ahead.
    """
    protocol = ways.protocol
    goal = np.zeros(ways.shape, np.bool_)
    goal[node] = True
    path = ways.to(observation.pose, observation.z, goal, np.arange(protocol.headings) == heading)
    if path is None:
        return None
    path = path or [Decision()]
    wanted = tilt if len(path) == 1 else protocol.tilts.index(protocol.camera_pitch)
    is_so = wanted == nearest_tilt(protocol, observation)
    path[0] = replace(path[0], tilt=None if is_so else protocol.tilts[wanted])
    return path


def _traced(found: SpaceSequences, end: int) -> list[int]:
    """Of a sequence, the numbers from the start to its end."""
    path = [end]
    while (before := int(found.parent[path[-1]])) >= 0:
        path.append(before)
    return path[::-1]
