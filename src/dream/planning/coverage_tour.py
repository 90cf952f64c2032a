"""A tour from which all that is foretold comes into view: over the real actions, and to its end."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from dream.lattice import Pose
from dream.planning.lookahead import Plan, Prospect
from dream.planning.tours import Left, Search, reached_by, rest_of
from dream.planning.travel import Travel

SLIGHT = 0.25
"""Share of what may be left that one part may hold and is not worth a way of its own."""
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
class CoverageTour:
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
            moves: See `PoseViews.moves`.
            leave: Weight that may be left.
        """
        weights, views = np.concatenate([prospect.ground, prospect.hiding]), prospect.pose_views
        total = float(weights.sum())
        index = np.flatnonzero(weights > 1e-4 * leave)
        if total <= leave or not len(index):
            return None
        rest, self.path = rest_of(self.path, travel, moves), []
        cells = views.tile_places(index % views.tiles)
        reached = reached_by(travel, moves)
        worth = float(weights[index].sum())
        weights = weights.astype(np.float64)
        left = Left.of(weights, index, cells, cells + 0.5, views.views(), travel, moves, reached)
        found = [rest] if len(rest) > 1 else []
        count = EACH_STEP if found else len(SEARCHES)
        for k in range(count):
            part, beside, pace = SEARCHES[(self.turn + k) % len(SEARCHES)]
            reach = travel.protocol.reach / travel.lattice.spacing
            step = pace * worth
            search = Search(round(part * reach), beside * reach, step, HORIZON, leave, SLIGHT * leave)
            found.append(left.search(search)[0])
        self.turn += count
        best, value, shown = [], (np.inf, np.inf, np.inf), np.zeros(len(index), np.bool_)
        for path in found:
            length, shows, rests = left.follow(path, leave)
            judged = (round(max(rests - leave, 0.0) / total, 6), length, round(rests / total, 6))
            if length and judged < value:
                best, value, shown = path[: length + 1], judged, shows
        if not best:
            return None
        self.path = best
        elements = np.zeros(len(prospect.weights), np.bool_)
        elements[index[shown]] = True
        return prospect.plan(best, 0.0, 0.0, elements)
