"""Targets that the protocol wants traversed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from dream.planning import sentences
from dream.planning.lookahead import Plan
from dream.planning.sources.source import MOST_VISITS, BeliefSource, Expected, Situation, Way, Words, Worth
from dream.planning.travel import Travel
from dream.planning.traversal_tour import TraversalTour
from dream.types import BoolArray


@dataclass(slots=True, eq=False)
class TargetsToTraverse(BeliefSource):
    """Traverses what was found before anything else is looked for."""

    traversal_tour: TraversalTour
    given_up: BoolArray = field(init=False)
    """(rows, cols) cells that are not worth another try."""

    def __post_init__(self) -> None:
        cell, bounds = self.traversal_tour.mission.protocol.cell, self.traversal_tour.mission.bounds
        self.given_up = np.zeros((round(bounds.depth / cell), round(bounds.width / cell)), np.bool_)

    def words(self, expected: Expected, situation: Situation) -> Words:
        """What was traversed, and what is left."""
        occupancy, completion = situation.occupancy, situation.completion
        area = sentences.left_to_traverse(occupancy, completion) if len(completion.untraversed) else ""
        return Words(target_area=area, completion=sentences.traversal(occupancy, completion))

    def weigh(self, worth: Worth, expected: Expected, situation: Situation) -> None:
        """What lies beside targets comes into view where they are traversed; what keeps it open counts."""
        is_open = np.zeros(situation.occupancy.shape, np.bool_)
        is_open[tuple(situation.completion.open_cells.T)] = True
        worth.ground[~is_open] = 0.0
        worth.search *= not expected.searched

    def errand(
        self, situation: Situation, travel: Travel, moves: npt.NDArray[np.uint8], visits: int
    ) -> Way | None:
        """The way to traverse what is left; None where no way leads to any of it."""
        from dream.mapping import to_traverse

        # Beyond what completion asks for: what no known way leads to may come in reach on the way.
        left = np.argwhere(to_traverse(situation.occupancy) & ~self.given_up)
        if visits > 1:
            moves = travel.free  # What is unknown stays so from here.
        while True:
            path = self.traversal_tour.plan(left, travel, moves)
            passes = self.traversal_tour.traverses(path)[tuple(left.T)]
            if len(path) == 1:
                return None
            if visits < MOST_VISITS:
                plan = Plan(path, rate=0.0, later=0.0, passed=int(passes.sum()))
                return Way(travel, plan, sentences.WALK)
            self.given_up[tuple(left[passes].T)] = True
            left = left[~passes]

    def try_again(self) -> bool:
        """Whatever was given up is worth one more try."""
        any_was = bool(self.given_up.any())
        self.given_up[:] = False
        return any_was
