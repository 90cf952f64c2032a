"""Targets that were glimpsed beyond the reach."""

from __future__ import annotations

from dataclasses import dataclass

from dream.planning import sentences
from dream.planning.distribution import GLIMPSED
from dream.planning.far_hints import FarHints
from dream.planning.sources.source import BeliefSource, Expected, Situation, Words


@dataclass(frozen=True, slots=True)
class HintedTargets(BeliefSource):
    """Lets what was glimpsed count as evidence, as far as hints came true so far."""

    hints: FarHints

    def take(self, situation: Situation) -> None:
        """Weigh earlier hints, and add those of this observation."""
        self.hints.add(situation.observation, situation.occupancy)

    def expect(self, expected: Expected, situation: Situation) -> None:
        """Evidence, unless there is a hull, of which more is believed than hints tell."""
        expected.calibration = GLIMPSED
        if situation.away_from_hull is None:
            expected.evidence = self.hints.evidence(situation.occupancy)

    def words(self, expected: Expected, situation: Situation) -> Words:
        """How much is hinted at, and how far that is believed."""
        return Words(
            distribution=sentences.hinted(expected.hinted, self.hints.precision),
            completion=sentences.hints_left(expected.hinted),
        )
