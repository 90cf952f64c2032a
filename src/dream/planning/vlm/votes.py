"""Votes on places: the same question under other numbers each time, and what the answers say together."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from dream.planning.vlm.asking import Answer, Pending
from dream.planning.vlm.reply import Ranking
from dream.types import Exchange

AGREED = 2.0 / 3.0
"""Share of the votes that must have the same place first."""


@dataclass(frozen=True, slots=True, eq=False)
class Vote:
    """One of the questions that are asked side by side."""

    numbers: dict[int, int]
    """Index of the place for each number."""
    pending: Pending[Ranking]
    """The answer to come."""


@dataclass(frozen=True, slots=True, eq=False)
class Poll:
    """A question on its way: the same places once for each vote, under other numbers each time."""

    at: float
    """Seconds on the mission's clock."""
    places: Sequence[Any]
    votes: list[Vote]
    to_end: bool
    """Whether the offline planner would have ended the mission."""

    def opinion(self, answers: list[Answer[Ranking]]) -> Opinion | None:
        """What the answers that count say together; None where there is none.

        Args:
            answers: One of each vote.
        """
        heard = [
            (vote.numbers, answer.reply)
            for vote, answer in zip(self.votes, answers, strict=True)
            if answer.reply is not None
        ]
        return Opinion(heard, len(self.votes)) if heard else None

    def told(self, outcome: str, answers: list[Answer[Ranking]]) -> list[Exchange]:
        """The exchanges, with what came of them in the numbers of each.

        Args:
            outcome: As in `types.Exchange`; `{k}` stands for the number of the place of index k.
            answers: One of each vote.
        """
        told = []
        for vote, answer in zip(self.votes, answers, strict=True):
            names = sorted(vote.numbers, key=vote.numbers.__getitem__)
            counted = answer.reply is not None
            told.append(replace(answer.exchange, outcome=outcome.format(*names) if counted else ""))
        return told


@dataclass(frozen=True, slots=True, eq=False)
class Opinion:
    """What votes say together, of places by their index."""

    heard: list[tuple[dict[int, int], Ranking]]
    """Index of the place for each number, and the ranking of the numbers; one at least."""
    asked: int
    """Votes, those without an answer included."""

    @property
    def _firsts(self) -> list[int]:
        return [numbers[reply.ranking[0]] for numbers, reply in self.heard]

    @property
    def first(self) -> int:
        """The place that most have first."""
        return max(self._firsts, key=self._firsts.count)

    @property
    def agrees(self) -> bool:
        """Whether enough of the votes have the same place first."""
        return self._firsts.count(self.first) >= AGREED * self.asked

    @property
    def complete(self) -> bool:
        """Whether more than half of them say that the mission is complete."""
        return sum(reply.mission_complete for _, reply in self.heard) > 0.5 * len(self.heard)

    def bonus(self, weight: float) -> dict[int, float]:
        """Steps that the ranks of each place are worth; 0 for places without one.

        Args:
            weight: Steps that the first rank is worth, where all votes are sure. It fades with the rank.
        """
        bonus: dict[int, float] = defaultdict(float)
        for numbers, reply in self.heard:
            for rank, number in enumerate(reply.ranking, start=1):
                bonus[numbers[number]] += weight * reply.confidence / rank / self.asked
        return bonus

    def rank(self, place: int) -> tuple[int, int]:
        """The number of a place in the first vote that counts, and its rank there, from 1."""
        numbers, reply = self.heard[0]
        number = next(number for number, index in numbers.items() if index == place)
        return number, 1 + reply.ranking.index(number)
