"""What votes say together: of places, whatever numbers they had, and only where enough of them agree."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.planning.vlm.asking import Answer, Pending
from dream.planning.vlm.reply import STEPS, Ranking, ranked_reply
from dream.planning.vlm.votes import Opinion, Poll, Vote
from dream.types import Exchange

WEIGHT = 3.0


def ranks(order: list[int], *, confidence: float = 1.0, complete: bool = False) -> Ranking:
    """A reply that puts numbers in that order."""
    fields: dict[str, Any] = dict.fromkeys(STEPS, "Because.")
    fields |= {"ranking": order, "confidence": confidence, "mission_complete": complete}
    return ranked_reply(order)(**fields)


def opinion(*orders: list[int], asked: int | None = None, complete: int = 0) -> Opinion:
    """Of votes for these orders of places, numbered from 1; so many of them say that it is complete."""
    heard = [
        ({place + 1: place for place in order}, ranks([place + 1 for place in order], complete=k < complete))
        for k, order in enumerate(orders)
    ]
    return Opinion(heard, asked or len(orders))


@given(st.permutations(range(5)), st.permutations(range(5)), st.floats(0.0, 1.0))
def test_numbers_decide_nothing(order: list[int], other: list[int], confidence: float) -> None:
    """Two votes for the same order of places weigh the same, under whatever numbers they were asked."""
    plain, mixed = (
        Opinion(
            [
                (
                    {numbers[place] + 1: place for place in range(5)},
                    ranks([numbers[place] + 1 for place in order], confidence=confidence),
                )
            ],
            1,
        )
        for numbers in (list(range(5)), other)
    )
    assert plain.bonus(WEIGHT) == mixed.bonus(WEIGHT)
    assert plain.first == mixed.first == order[0]
    assert [mixed.rank(place)[1] for place in order] == [1, 2, 3, 4, 5]
    assert [mixed.rank(place)[0] for place in order] == [other[place] + 1 for place in order]


def test_the_first_rank_is_worth_the_weight_and_the_next_half_of_it_and_so_on() -> None:
    bonus = opinion([2, 0, 1]).bonus(WEIGHT)
    assert [bonus[place] for place in (2, 0, 1)] == [3.0, 1.5, 1.0]
    assert bonus[7] == 0.0
    halves = opinion([0, 1], [1, 0]).bonus(WEIGHT)
    assert halves[0] == halves[1] == pytest.approx(0.5 * (3.0 + 1.5))
    assert opinion([0, 1], asked=2).bonus(WEIGHT)[0] == 1.5


@pytest.mark.parametrize(
    ("firsts", "asked", "agrees"),
    [
        ([0], 1, True),
        ([0, 0, 1], 3, True),
        ([0, 1], 2, False),
        ([0, 0, 1, 1], 4, False),
        ([0, 0, 0, 1, 1], 5, False),
        ([0, 0], 3, True),
        ([0, 0], 4, False),
    ],
)
def test_two_thirds_of_the_votes_must_agree_and_those_without_an_answer_do_not(
    firsts: list[int], asked: int, *, agrees: bool
) -> None:
    said = opinion(*([first, 1 - first] for first in firsts), asked=asked)
    assert said.agrees == agrees
    assert said.first == 0


@pytest.mark.parametrize(
    ("complete", "votes", "is_complete"), [(0, 1, False), (1, 1, True), (1, 2, False), (2, 3, True)]
)
def test_more_than_half_must_say_that_it_is_complete(complete: int, votes: int, *, is_complete: bool) -> None:
    assert opinion(*votes * [[0, 1]], complete=complete).complete == is_complete


def test_what_came_of_it_is_told_in_the_numbers_of_each_vote_that_counts() -> None:
    exchange = Exchange("p", "m", "q", {}, (), "", 1, 0, 0, 0.0, 0.0)
    waiting: Any = Pending(None, None, Future())  # type: ignore[arg-type]
    votes = [Vote({1: 0, 2: 1}, waiting), Vote({2: 0, 1: 1}, waiting), Vote({1: 0, 2: 1}, waiting)]
    poll = Poll(0.0, [], votes, to_end=False)
    answers = [Answer(reply, exchange) for reply in (ranks([2, 1]), ranks([1, 2]), None)]
    told = poll.told("followed: place {1} instead of place {0}", answers)
    assert [one.outcome for one in told] == [
        "followed: place 2 instead of place 1",
        "followed: place 1 instead of place 2",
        "",
    ]
    said = poll.opinion(answers)
    assert said is not None
    assert (said.first, said.asked, len(said.heard)) == (1, 3, 2)
    assert poll.opinion([Answer(None, exchange)] * 3) is None
