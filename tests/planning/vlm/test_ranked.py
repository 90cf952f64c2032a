"""A model ranks safe places: what it is asked, when, and how far its word goes."""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Iterator
from concurrent.futures import wait
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from dream.errors import PlannerFailed
from dream.evaluation.runner import simulate
from dream.geometry import Bounds
from dream.mapping import OccupancyMap
from dream.planning import Belief
from dream.planning.vlm import Ranked, offline, ranking_question
from dream.planning.vlm.places import Place, places
from dream.planning.vlm.ranked import RankedPilot
from dream.protocol import DREAM_V1
from dream.robots.teleport import SPEED, TURN_RATE
from dream.sim.world import World
from dream.types import LOOK_AROUND, Decision, Exchange, Mission, Observation, Step
from tests.model_server import Answer, Request, Response, error, ranking, serving
from tests.sim.arenas import arena

LATENCY = 12.0
OWN: dict[str, int] = {}
"""The number of the offline planner's own place by a question's table, which does not say which it is."""


@pytest.fixture(scope="module", autouse=True)
def tables() -> Iterator[None]:
    """Which place of each table loses nothing is remembered."""
    write = ranking_question.table

    def remember(numbered: dict[int, Place]) -> list[str]:
        lines = write(numbered)
        OWN["\n".join(lines)] = min(numbered, key=lambda number: numbered[number].loss)
        return lines

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ranking_question, "table", remember)
        yield


@dataclass
class Watched:
    """`Ranked`, and what its pilot held after each decision."""

    planner: Ranked
    pilot: RankedPilot | None = None
    spent: list[float] = field(default_factory=list)
    flown: list[int] = field(default_factory=list)

    def begin(self, mission: Mission) -> Watched:
        self.pilot = self.planner.begin(mission)
        return self

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        assert self.pilot is not None
        decision = self.pilot.decide(observation, occupancy)
        self.spent.append(self.pilot.spent)
        return decision


@dataclass(frozen=True)
class Flight:
    """The steps after the look-around, and what was asked."""

    steps: list[Step]
    asked: list[Request]
    spent: list[float]

    @property
    def exchanges(self) -> list[Exchange]:
        return [exchange for step in self.steps for exchange in step.decision.exchanges]


def fly(answer: Response | Answer, world: World, steps: int, **options: Any) -> Flight:
    """A flight on which the model is asked often and followed far, unless told otherwise."""
    told = {"margin": 20.0, "weight": 50.0, "allowance": 10.0, "latency": 0.0, **options}
    with serving(answer) as server:
        watched = Watched(Ranked(**server.options, timeout=5.0, **told))
        flown = list(simulate(world, watched, DREAM_V1, max_steps=LOOK_AROUND + steps))
    return Flight(flown[1 + LOOK_AROUND :], server.asked, watched.spent)


def alone(world: World, steps: int) -> list[Step]:
    """The same steps of the offline planner."""
    return list(simulate(world, Belief(), DREAM_V1, max_steps=LOOK_AROUND + steps))[1 + LOOK_AROUND :]


def moves(steps: list[Step]) -> list[tuple[float, float]]:
    return [(step.decision.turn, step.decision.advance) for step in steps]


# ----------------------------------------------------------------------------------------------- question


def last_first(numbers: list[int]) -> list[int]:
    return sorted(numbers, reverse=True)


@pytest.fixture(scope="module")
def led(string_reef: World) -> Flight:
    return fly(ranking(last_first), string_reef, 30)


@pytest.mark.rare
def test_schema_table_and_picture_have_the_same_places(led: Flight) -> None:
    assert len(led.exchanges) >= 3
    for request, exchange in zip(led.asked, led.exchanges, strict=False):
        numbers = request.schema["properties"]["ranking"]["items"]["enum"]
        assert sorted(numbers) == list(range(1, len(numbers) + 1))
        table = re.findall(r"^\| (\d+) \|", exchange.question, re.MULTILINE)
        assert [int(number) for number in table] == sorted(numbers)
        assert f"worked out {len(numbers)} places" in exchange.question


def test_numbers_change_from_question_to_question(led: Flight) -> None:
    assert len({own_place(exchange.question) for exchange in led.exchanges}) > 1


def own_place(question: str) -> int:
    """The number of the offline planner's own place."""
    return OWN["\n".join(line for line in question.splitlines() if line.startswith("|"))]


@pytest.mark.parametrize(("count", "asked"), [(1, False), (2, True)])
def test_one_place_is_no_choice_and_two_are_one(
    count: int, string_reef: World, monkeypatch: pytest.MonkeyPatch, *, asked: bool
) -> None:
    monkeypatch.setattr(offline, "places", lambda *known: places(*known)[:count])
    assert bool(fly(ranking(), string_reef, 1).asked) == asked


# -------------------------------------------------------------------------------------------------- choice


def test_a_choice_is_followed_and_said(led: Flight, string_reef: World) -> None:
    followed = [step for step in led.steps if "The model ranked place" in step.decision.reasoning.next_target]
    assert followed
    assert led.spent[-1] > 0.0
    assert moves(led.steps) != moves(alone(string_reef, 30))
    assert not any(step.guarded.note or step.arrival.collided for step in led.steps)


def test_what_the_choices_cost_stays_within_the_allowance(string_reef: World) -> None:
    allowance = 0.2
    flight = fly(ranking(last_first), string_reef, 30, allowance=allowance)
    assert flight.spent[-1] > 0.0
    for k, spent in enumerate(flight.spent):
        assert spent <= allowance * (LOOK_AROUND + k) + 1.0 + 1e-9


def test_the_exchange_says_which_place_was_followed_instead_of_which(led: Flight) -> None:
    followed = [exchange for exchange in led.exchanges if exchange.outcome.startswith("followed: ")]
    assert followed
    for exchange in followed:
        chosen, own = re.findall(r"place (\d+)", exchange.outcome.partition(";")[0])
        assert (int(own), chosen != own) == (own_place(exchange.question), True)
    for step in led.steps:
        if any(exchange in followed for exchange in step.decision.exchanges):
            (exchange,) = step.decision.exchanges
            (place,) = re.findall(r"The model ranked (place \d+)", step.decision.reasoning.next_target)
            assert exchange.outcome.startswith(f"followed: {place} instead of place ")


def own_first(request: Request) -> Response:
    own = own_place(request.question)
    return ranking(lambda numbers: sorted(numbers, key=lambda number: number != own))(request)


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("answer", "options", "outcome"),
    [
        (error(418), {}, r"^$"),
        (own_first, {}, r"^as the offline planner would$"),
        (
            ranking(last_first, confidence=0.0),
            {},
            r"^overruled: place \d+, which costs .* worth 0\.0$|^as the",
        ),
        (ranking(last_first), {"margin": 0.0}, r"never asked"),
        # Always the lowest number, under other numbers each time, is another place each time.
        (ranking(), {"votes": 5}, r"^not heard: the votes disagree$"),
    ],
    ids=["no answer", "no other answer", "no confidence", "no margin", "no agreement"],
)
def test_otherwise_it_flies_as_the_offline_planner_does_and_says_why(
    answer: Response | Answer, options: dict[str, Any], outcome: str, string_reef: World
) -> None:
    flight = fly(answer, string_reef, 8, **options)
    assert all(re.match(outcome, exchange.outcome) for exchange in flight.exchanges)
    assert moves(flight.steps) == moves(alone(string_reef, 8))
    assert flight.spent[-1] == 0.0
    assert bool(flight.exchanges) == (options.get("margin") != 0.0)


def test_a_model_that_cannot_be_asked_ends_the_mission_at_its_first_answer(string_reef: World) -> None:
    # The planner here is the test's own, and so what fails in it is told by its line.
    with pytest.raises(PlannerFailed, match=r"ValueError: .* got denied: HTTP 404: .* Does the server"):
        fly(error(404), string_reef, 8)


def test_the_vehicle_does_not_wait_and_the_answer_counts_when_it_is_due(string_reef: World) -> None:
    steps = fly(ranking(last_first), string_reef, 12, latency=LATENCY).steps
    # But for the last one, after which nobody would hear the answer.
    assert all(step.decision.waited == 0.0 for step in steps[:-1])
    heard = next(k for k, step in enumerate(steps) if step.decision.exchanges)
    assert heard > 1
    # It was asked before the first of these moves; the answer counts from the first decision after it is due.
    clock = [step.observation.time for step in steps]
    first = 2.0 / SPEED + math.pi / TURN_RATE
    assert clock[heard - 1] - clock[0] + first >= LATENCY
    assert clock[heard - 2] - clock[0] < LATENCY
    assert moves(steps[:heard]) == moves(alone(string_reef, heard))


def test_by_a_real_clock_an_answer_that_is_not_there_yet_is_not_waited_for(string_reef: World) -> None:
    thought_about = threading.Event()

    def slow(request: Request) -> Response:
        assert thought_about.wait(10.0)
        return ranking(last_first)(request)

    with serving(slow) as server:
        eager = Ranked(margin=20.0, allowance=10.0, latency=None)
        watched = Watched(replace(eager, **server.options, timeout=20.0))
        steps = []
        for step in simulate(string_reef, watched, DREAM_V1, max_steps=LOOK_AROUND + 8):
            steps.append(step)
            pilot = watched.pilot
            assert pilot is not None
            if step.index == LOOK_AROUND + 5:
                assert pilot.asked is not None
                thought_about.set()
                wait([vote.pending.outcome for vote in pilot.asked.votes], timeout=10.0)
    first = next(step for step in steps if step.decision.exchanges)
    assert first.index == LOOK_AROUND + 6
    assert first.decision.waited == 0.0
    assert 0.0 < first.decision.exchanges[0].seconds < first.observation.time


def test_it_can_be_told_to_wait_as_the_papers_vehicle_does(string_reef: World) -> None:
    steps = fly(ranking(), string_reef, 4, latency=LATENCY, wait=True).steps
    waited = [step.decision.waited for step in steps if step.decision.exchanges]
    assert steps[0].decision.exchanges
    assert all(seconds == pytest.approx(LATENCY) for seconds in waited)


@pytest.mark.rare
def test_the_end_needs_the_model_too_but_it_cannot_put_it_off_for_long() -> None:
    small = replace(arena(), bounds=Bounds(-8.0, -8.0, 8.0, 8.0))
    usual = {"margin": 2.0, "weight": 3.0, "allowance": 0.1}
    agreeing = fly(ranking(complete=True), small, 60, **usual)
    doubting = fly(ranking(complete=False), small, 60, **usual)
    belief = alone(small, 60)
    assert [flight.steps[-1].ended for flight in (agreeing, doubting)] == ["done", "done"]
    assert len(belief) <= len(agreeing.steps) <= len(doubting.steps) <= 1.5 * len(belief) + 5


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("margin", -1.0),
        ("weight", float("nan")),
        ("allowance", -0.1),
        ("votes", 0),
        ("votes", 1.5),
        ("wait", 2),
    ],
)
def test_parameters_are_refused_by_name(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected"):
        Ranked(**{name: value})


@pytest.mark.parametrize(
    ("name", "most"), [("margin", 1000.0), ("weight", 1000.0), ("allowance", 10.0), ("votes", 15)]
)
def test_parameters_go_up_to_their_greatest_and_no_farther(name: str, most: Any) -> None:
    Ranked(**{name: most})
    with pytest.raises(ValueError, match=rf"{name}: expected \d+ to {most:g}, got"):
        Ranked(**{name: most + 1})
