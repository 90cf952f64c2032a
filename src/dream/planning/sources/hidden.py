"""Groups of targets that may hide in ground that was not searched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dream.planning import sentences
from dream.planning.distribution import Groups
from dream.planning.sources.source import BeliefSource, Expected, Situation, Worth


@dataclass(frozen=True, slots=True)
class HiddenGroups(BeliefSource):
    """Expects as many groups in ground where one could hide as the ground searched so far lets expect."""

    size: float
    """Radius of the groups that are searched for, metres."""
    prior: Groups
    """How many there are before anything is seen."""
    search: float
    """Square metres of targets that are expected for each square metre where the middle of a group could
    lie."""

    def expect(self, expected: Expected, situation: Situation) -> None:
        """Where a group could hide, and the probability that one does."""
        from dream.mapping import could_hide

        occupancy, square = situation.occupancy, situation.occupancy.protocol.cell**2
        hopeless = ~situation.near_places | situation.failed.given_up
        expected.hiding = situation.hopeful(could_hide(occupancy, self.size, hopeless), self.size)
        expected.unnoticed = expected.evidence.unnoticed(self.size, occupancy.protocol.cell)
        expected.hidden = float(expected.unnoticed[expected.hiding].sum()) * square
        searched = np.count_nonzero(occupancy.to_see) * square - expected.hidden
        expected.groups = self.prior.after(len(situation.completion.regions), searched)
        expected.probability = expected.groups.risk(expected.hidden)

    def certainty(self, expected: Expected, situation: Situation) -> tuple[str, str]:
        """The risk of stopping now."""
        told = situation.completion, expected.risk, expected.accepted
        return sentences.certainty(*told), sentences.certainty_for_models(*told)

    def weigh(self, worth: Worth, expected: Expected, situation: Situation) -> None:
        """A group that is not noticed is worth what is expected of it."""
        worth.search, worth.share = self.search, expected.unnoticed.astype(np.float64)


@dataclass(frozen=True, slots=True)
class AllGround(BeliefSource):
    """Has all ground seen that can be, whatever is expected there."""

    def expect(self, expected: Expected, situation: Situation) -> None:
        """Any ground that may yet come into view could hide something."""
        expected.probability = float(expected.hiding.any())

    def certainty(self, expected: Expected, situation: Situation) -> tuple[str, str]:
        """How much that is."""
        unseen = float(expected.hiding.sum()) * situation.occupancy.protocol.cell**2
        said = sentences.certificate(situation.completion, unseen)
        return said, said
