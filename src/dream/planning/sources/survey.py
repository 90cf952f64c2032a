"""Targets that an earlier survey foretells."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from dream.planning import sentences
from dream.planning.coverage_tour import CoverageTour
from dream.planning.distribution import Groups
from dream.planning.lookahead import Prospect
from dream.planning.prior_survey import LIKELY, PriorSurvey
from dream.planning.sources.source import LEAVE, BeliefSource, Expected, Situation, Way, Words, Worth


@dataclass(slots=True, eq=False)
class ForetoldTargets(BeliefSource):
    """Expects targets where they were, as far as the survey turns out to be right, and flies round them."""

    survey: PriorSurvey
    arriving: Groups
    """Groups that come in a year where it saw none."""
    coverage_tour: CoverageTour = field(default_factory=CoverageTour)
    """The way round what is foretold."""

    def take(self, situation: Situation) -> None:
        """Compare it with what was seen; what stood is taken for solid."""
        self.survey.look(situation.pose_views.shown(situation.here)[0], situation.occupancy)
        self.survey.compare(situation.occupancy)
        situation.foretold = self.survey.solid(situation.occupancy)

    def expect(self, expected: Expected, situation: Situation) -> None:
        """Targets where they were; where it saw no group one must have come since.

        How many come is learnt as the number of groups is, from those that came to such ground, and the
        ground of which it was searched again.
        """
        survey, occupancy, groups = self.survey, situation.occupancy, expected.groups
        regions, hidden = situation.completion.regions, expected.hidden
        came, empty = survey.came(regions), survey.empty
        share = float(np.count_nonzero(expected.hiding & empty)) / max(
            int(np.count_nonzero(expected.hiding)), 1
        )
        searched = occupancy.to_see & ~expected.hiding
        again = occupancy.protocol.cell**2 * np.count_nonzero(empty & searched)
        arriving = replace(self.arriving, shape=self.arriving.shape * max(survey.prior.years, 1.0))
        coming = arriving.after(came, again)
        told = 1.0 - (1.0 - groups.risk((1.0 - share) * hidden)) * (1.0 - coming.risk(share * hidden))
        rarity = min(coming.intensity / groups.intensity, 1.0)
        believed = survey.believed
        expected.probability = believed * told + (1.0 - believed) * groups.risk(hidden)
        expected.rarity = believed * rarity + 1.0 - believed
        expected.likely = survey.weighed(expected.beside, situation.failed.left(occupancy))
        # What keeps a region open must be seen, whatever was foretold there.
        row, col = situation.completion.open_cells.T
        expected.likely[row, col] = np.maximum(expected.likely[row, col], expected.beside[row, col])

    def words(self, expected: Expected, situation: Situation) -> Words:
        """What it foretells, how far it is believed, and what is other than it was."""
        return Words(distribution=sentences.foretold(self.survey, situation.occupancy))

    def weigh(self, worth: Worth, expected: Expected, situation: Situation) -> None:
        """Where it saw no group few are expected."""
        worth.share[self.survey.empty] *= expected.rarity

    def enough(self, expected: Expected, situation: Situation) -> bool:
        """The risk may be little long before all ground was searched: then that is done with."""
        return bool(situation.completion.regions) and expected.looked_over and expected.searched

    def tour(self, expected: Expected, situation: Situation, prospect: Prospect) -> Way | None:
        """The way round what is foretold and was not seen yet; None where hardly any of it is left."""
        survey, occupancy, pose_views = self.survey, situation.occupancy, situation.pose_views
        if survey.believed <= 0.5:
            return None
        square = occupancy.protocol.cell**2
        unseen = situation.failed.left(occupancy)
        known = square * np.count_nonzero(occupancy.target)
        needed = np.zeros_like(unseen)
        if situation.completion.regions:
            needed[tuple(situation.completion.open_cells.T)] = True
        either = unseen | survey.unheard(occupancy)
        unknown = expected.hiding & ~survey.empty
        intensity = expected.to_come / max(square * np.count_nonzero(expected.hiding), square)
        risk = 0.5 * expected.calibration.uncalibrated(expected.accepted)
        # What is in plain view comes first; then also what a low rock may hide and what keeps a region open,
        # which cost more than they bring; then also ground of which the survey knows nothing.
        for part in range(3):
            left = either if part else unseen
            worth = survey.weighed(expected.beside, left)
            worth = np.where(left & (worth >= LIKELY), square * worth, 0.0)
            leave = LEAVE * (known + float(worth.sum()))
            hiding = np.zeros_like(worth)
            if part > 0:
                # No cell that is needed may be left, and of groups as many as make half the risk accepted.
                worth[needed & unseen] = 1.1 * leave
            if part > 1:
                # Nor any that could hold one, where hardly any risk is accepted.
                hiding[unknown] = min(leave * square * intensity / max(risk, 1e-9), 1.1 * leave)
            ahead = replace(prospect, ground=pose_views.on_tiles(worth), hiding=pose_views.on_tiles(hiding))
            plan = self.coverage_tour.plan(ahead, situation.travel, situation.moves, leave)
            if plan is not None:
                return Way(situation.travel, plan, sentences.ROUND)
        return None
