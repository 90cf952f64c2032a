"""Targets beside those that are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dream.planning.distribution import expectation
from dream.planning.sources.source import BeliefSource, Expected, Situation, Worth


@dataclass(frozen=True, slots=True)
class TargetsBeside(BeliefSource):
    """Expects targets around those that were seen or hinted at, and whatever keeps a region open."""

    blur: float
    """Metres from a target within which others are expected, one standard deviation."""
    prior: float
    """Probability of a target in a cell about which nothing is known."""
    prior_weight: float
    """Weight of that probability beside what was seen around a cell."""
    open_edge: float
    """A region stays open while an unseen cell at its edge holds a target with at least this probability."""
    eager: float
    """Weight of these targets beside others. A region that is left open costs a way back later."""
    search: float
    """Square metres of targets to be expected for each square metre of ground that is searched."""

    def expect(self, expected: Expected, situation: Situation) -> None:
        """The probability of a target in each cell not observed, and how much of that is hinted at."""
        from dream.mapping import within

        occupancy, completion, evidence = situation.occupancy, situation.completion, expected.evidence
        if not completion.regions and not evidence.hints.any():
            return
        cell = occupancy.protocol.cell
        near = within(occupancy.target | evidence.hints, 2.0 * self.blur, cell)
        beside = evidence.weighed(
            expectation(occupancy, self.blur, self.prior, self.prior_weight, near, evidence)
        )
        if completion.regions:
            row, col = completion.open_cells.T
            # A hole far from all targets must be closed, but holds none more likely than other ground does.
            least = np.where(near[row, col], self.open_edge, self.search)
            beside[row, col] = np.maximum(beside[row, col], least)
        expected.beside = expected.likely = beside
        if evidence.hints.any():
            hoped_for = evidence.hints & ~situation.failed.given_up & situation.near_places
            hoped_for = situation.hopeful(hoped_for, 0.5 * cell)
            expected.hinted = float(beside[hoped_for].sum()) * cell**2

    def weigh(self, worth: Worth, expected: Expected, situation: Situation) -> None:
        """What is likely to be seen; where no target was seen, all ground must be."""
        square = situation.occupancy.protocol.cell**2
        worth.ground = self.eager * expected.likely * square
        if not situation.completion.regions and not expected.hiding.any():
            row, col = situation.completion.open_cells.T
            worth.ground[row, col] = np.maximum(worth.ground[row, col], self.search * square)
