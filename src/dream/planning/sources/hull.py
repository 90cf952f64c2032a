"""What is left to see of a hull."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dream.lattice import Lattice, Pose
from dream.mapping.hull import PATCH, Hull
from dream.mapping.targets import is_found, target_cells
from dream.planning import sentences
from dream.planning.pose_views import Listed
from dream.planning.sources.source import BeliefSource, Expected, FloatArray, Situation, Words, Worth
from dream.planning.travel import Travel
from dream.types import Target

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

ADJOINING = 1.5
"""Metres from hull within reach up to which more hull is believed in."""
BENEATH = 0.02
"""What ground beside and beneath a hull counts: what is to be seen there is the hull itself."""
LEAST = 0.25
"""Patches, of 0.25 m² each, that a step has to bring for what is left of a hull to hold up the search."""
NEAR = 5
"""Steps within which the hull's views are worked out for every second node; within twice as many for every
fourth, for every sixteenth beyond."""


@dataclass(slots=True, eq=False)
class HullSurface(BeliefSource):
    """Expects more hull where the surface that was seen goes on."""

    hull: Hull
    lattice: Lattice
    eager: float
    """Weight of its patches beside other targets."""
    accepted: float
    """Share of the hull that may be unseen when the mission ends."""
    alone: float
    """Factor on the worth of searching for groups while a step brings enough of a hull."""
    least: float = LEAST
    """Patches a step that are enough."""

    def take(self, situation: Situation) -> None:
        """Add what was seen of it; hope no more for what should be in view from here and is not."""
        self.hull.integrate(situation.observation)
        self.give_up(situation.here)
        situation.away_from_hull = away_from_hull(situation.occupancy)

    def expect(self, expected: Expected, situation: Situation) -> None:
        """Patches that are still unseen, where there is hull."""
        expected.hull = self._adjoining(situation)
        left = float(expected.hull.sum())
        expected.hull_left = left / (self.hull.found + left) if left else 0.0
        expected.looked_over = expected.hull_left <= self.accepted

    def words(self, expected: Expected, situation: Situation) -> Words:
        """How much of it is unseen."""
        if situation.away_from_hull is None:
            return Words()
        area = PATCH**2 * float(expected.hull.sum())
        return Words(completion=sentences.hull(area, expected.hull_left, self.accepted))

    def weigh(self, worth: Worth, expected: Expected, situation: Situation) -> None:
        """Its patches, and little of the ground beneath them.

        As long as a step brings enough of them hardly anything else is searched for; then the search goes on,
        until its risk is accepted.
        """
        worth.listed = self.listed(expected, situation)
        if situation.away_from_hull is None:
            return
        worth.ground[situation.away_from_hull <= ADJOINING] *= BENEATH
        if expected.searched:
            worth.search = 0.0
        elif not expected.looked_over and best_rate(worth.listed, situation.travel) >= self.least:
            worth.search *= self.alone

    def found(self) -> int:
        """Patches of hull."""
        return int(self.hull.found)

    def give_up(self, pose: Pose) -> None:
        """Hope no more for what should be in view from that side."""
        here = self.lattice.world(pose)
        self.hull.give_up((here.x, here.y), here.yaw)

    def listed(self, expected: Expected, situation: Situation) -> Listed | None:
        """What of the hull is seen from the nodes around it; None where nothing more is expected of it."""
        weights = self.eager * PATCH**2 * expected.hull
        if not weights.any():
            return None
        from scipy.spatial import cKDTree

        travel, left = situation.travel, self.hull.middles[weights > 0.0, :2]
        lattice, steps = travel.lattice, travel.nearest
        chosen = lattice.every(4) | lattice.every(2) & (steps <= 2 * NEAR)
        chosen |= lattice.checkered & (steps <= NEAR)
        nodes = np.flatnonzero(travel.reached & chosen)
        near = cKDTree(left).query(lattice.positions[nodes])[0] <= lattice.protocol.reach
        nodes, positions = nodes[near], lattice.positions[nodes[near]]
        starts, elements = self.hull.visible(positions, weights > 0.0)
        return Listed(weights, expected.hull, self.hull.middles[:, :2], nodes, starts, elements)

    def _adjoining(self, situation: Situation) -> FloatArray:
        """(n,) the belief about the hull, as far as it adjoins hull that was within reach.

        Farther away labels are not trusted, and where no target stands up there is no hull.
        """
        away, occupancy, weights = situation.away_from_hull, situation.occupancy, self.hull.weights
        if away is None or not len(weights):
            return np.zeros(len(weights))
        x, y = self.hull.middles[:, :2].T
        inside = occupancy.contains(x, y)
        inside[inside] = occupancy.to_see[occupancy.cell_of(x[inside], y[inside])]
        metres = np.full(len(x), np.inf)
        metres[inside] = away[occupancy.cell_of(x[inside], y[inside])]
        return np.where(metres <= ADJOINING, weights, 0.0)


def best_rate(listed: Listed | None, travel: Travel) -> float:
    """Patches that the best view of a hull is expected to show for each step there."""
    if listed is None or not len(listed.elements):
        return 0.0
    shown = np.concatenate([[0.0], np.cumsum(listed.expected[listed.elements])])
    gains = np.diff(shown[listed.starts])
    steps = travel.steps_to(listed.nodes).ravel()
    return float((gains / np.maximum(steps, 1))[steps > 0].max(initial=0.0))


def away_from_hull(occupancy: OccupancyMap) -> FloatArray | None:
    """(rows, cols) metres to the nearest target that stands up from the seabed.

    None where that is too little for a wreck.
    """
    from scipy.ndimage import distance_transform_edt

    cell, stands = occupancy.protocol.cell, target_cells(occupancy, Target.WRECK)
    if not is_found(stands, cell):
        return None
    return np.asarray(distance_transform_edt(~stands, cell))
