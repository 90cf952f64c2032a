"""The way round all that is foretold: over the real actions, and to its end."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream.mapping.lattice import offsets_of
from dream.planning.lookahead import Plan, Prospect
from dream.planning.outlook import Outlook
from dream.planning.travel import UNREACHED, IntArray, Pose, Travel
from dream.planning.walk import rest_of
from dream.types import BoolArray, Float32Array

if TYPE_CHECKING:
    from dream.planning._kernels.lookahead import Views

SLIGHT = 0.25
"""Share of what may be left that one part may hold and is not worth a way of its own."""
WIDTH = 48
"""Sequences of actions that each search keeps."""
HORIZON = 60
"""Steps at most."""
SEARCHES = tuple(
    (part, beside, pace)
    for pace in (0.001, 0.003, 0.01, 0.03)
    for part, beside in ((0.3, 0.6), (0.4, 0.75), (0.6, 0.9), (0.9, 0.9))
)
"""Searches: the side of a part and how near it is seen from, in reaches, and the share of what is left that a
step counts as much as. None is best everywhere."""
EACH_STEP = 5
"""Of the searches, while the rest of a way is there to go on with."""


@dataclass(slots=True, eq=False)
class Rounds:
    """The shortest way found that shows nearly all that is worth looking at, kept from step to step.

    What it does: where it is known what there is to see, the way with the soonest yield is not the shortest
    one to the end. Beam searches over the real actions judge sequences by what they leave: its weight, the
    way to the nearest part of it and the shortest tree over all of its parts. The rest of the last way is
    gone on with while none is found that is shorter or leaves less.

    Reference: beam search; the tree bounds a tour over what is left from below, as for a travelling salesman.

    Assumes: what is foretold is there. Fails when: it lies farther apart than `HORIZON` steps; then only the
    way to the first part is good.
    """

    path: list[Pose] = field(default_factory=list)
    """The rest of the last way, the pose where the vehicle should be first."""
    turn: int = 0
    """Searches made so far."""

    def plan(
        self, prospect: Prospect, travel: Travel, moves: npt.NDArray[np.uint8], leave: float
    ) -> Plan | None:
        """The way, and None where hardly anything is left.

        Args:
            prospect: What is worth looking at; what is listed does not count.
            travel: Ways over known free ground.
            moves: See `Outlook.moves`.
            leave: Weight that may be left.
        """
        from dream.planning._kernels import rounds as kernels
        from dream.planning._kernels.search import search as steps_to

        outlook = prospect.outlook
        weights = np.zeros_like(prospect.weights)
        weights[: 2 * outlook.tiles] = np.concatenate([prospect.ground, prospect.hiding])
        total = float(weights.sum())
        index = np.flatnonzero(weights > 1e-4 * leave)
        if total <= leave or not len(index):
            return None
        rest, self.path = rest_of(self.path, travel, moves), []
        views, shape = _listed(index, outlook.views()), travel.steps.shape
        found = [np.array([np.ravel_multi_index(pose, shape) for pose in rest])] if len(rest) > 1 else []
        offsets, turns = offsets_of(travel.protocol), np.array(travel.protocol.turns, np.int64)
        reached = steps_to(moves, offsets, turns, *travel.start)[2] < UNREACHED
        count = EACH_STEP if found else len(SEARCHES)
        for k in range(count):
            search = SEARCHES[(self.turn + k) % len(SEARCHES)]
            found.append(self._search(search, weights, index, leave, outlook, views, travel, moves, reached))
        self.turn += count
        best, value, shows = found[0][:1], (np.inf, np.inf, np.inf), np.zeros(0, np.uint64)
        for path in found:
            length, seen, left = kernels.follow(weights, views, path, shape, index, leave)
            judged = (round(max(left - leave, 0.0) / total, 6), length, round(left / total, 6))
            if length and judged < value:
                best, value, shows = path[: length + 1], judged, seen
        if len(best) < 2:
            return None
        self.path = [travel.pose(int(flat)) for flat in best]
        return prospect.plan(self.path, 0.0, 0.0, shows)

    def _search(
        self,
        search: tuple[float, float, float],
        weights: Float32Array,
        index: IntArray,
        leave: float,
        outlook: Outlook,
        views: Views,
        travel: Travel,
        moves: npt.NDArray[np.uint8],
        reached: BoolArray,
    ) -> npt.NDArray[np.int32]:
        """(steps + 1,) flat poses of the way that one of the searches finds."""
        from dream.planning._kernels import rounds as kernels
        from dream.planning._kernels.walk import ways_to

        protocol, (part, beside, pace) = travel.protocol, search
        cells = np.stack(outlook.tile_places(index % outlook.tiles), axis=1)
        side = round(part * protocol.reach / protocol.lattice)
        _, part_of = np.unique(cells[:, 0] // side * 10_000 + cells[:, 1] // side, return_inverse=True)
        offsets, turns = offsets_of(protocol), np.array(protocol.turns, np.int64)
        near, parts = beside * protocol.reach / protocol.lattice, int(part_of.max()) + 1
        ways = ways_to(part_of, parts, cells, moves, offsets, reached, near, (0, 0, 1))
        step = pace * float(weights[index].sum())
        path: npt.NDArray[np.int32] = kernels.rounds(
            weights, views, moves, offsets, turns, travel.start, index, part_of, ways,
            leave, SLIGHT * leave, WIDTH, HORIZON, step,
        )  # fmt: skip
        return path


def _listed(index: IntArray, views: Views) -> Views:
    """The same views, of these elements alone and as a list pose by pose."""
    from dream.planning._kernels import rounds as kernels

    starts, elements = kernels.shown(index, views)
    nodes = np.arange(len(views.depth))
    return views._replace(
        first=np.zeros_like(views.first), listed=nodes, listed_first=starts, listed_element=elements
    )
