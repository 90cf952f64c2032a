"""Places in space: what is offered, what is asked about them, and how far a model's word goes."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from dream.control import guard
from dream.evaluation.runner import simulate
from dream.geometry import SE2, wrap_angle
from dream.mapping import OccupancyMap
from dream.planning import SixSteps
from dream.planning.vlm import Ranked
from dream.planning.vlm.offline import offline_planner
from dream.planning.vlm.places import APART, MOST
from dream.planning.vlm.places_in_space import Considered, InSpace, SixStepsPlace, SixStepsPlaces
from dream.standin import eyes, sight
from dream.standin.rules import answer
from dream.types import LOOK_AROUND, Decision, Exchange, Mission, Observation
from tests.model_server import error, ranking, serving
from tests.planning.vlm.in_space import PROTOCOL, flown, mission, reef
from tests.standin.sheets import request


@cache
def offered() -> tuple[InSpace, Considered]:
    observation, occupancy = flown()
    offline = offline_planner(mission())
    assert isinstance(offline, InSpace)
    return offline, offline.consider(observation, occupancy)


def test_the_first_place_is_where_the_offline_planner_would_go_and_loses_nothing() -> None:
    offline, thought = offered()
    observation, occupancy = flown()
    found = offline.places(thought)
    assert 2 <= len(found) <= MOST
    assert found[0].loss == 0.0
    assert all(place.loss >= 0.0 for place in found)
    alone = SixSteps().begin(mission()).decide(observation, occupancy)
    assert offline.act(thought, offline.own(thought)) == alone


def test_places_stand_apart_in_space_and_show_something() -> None:
    offline, thought = offered()
    found = offline.places(thought)
    for one, other in itertools.combinations(found, 2):
        assert offline.spot(one).distance(offline.spot(other)) > APART * PROTOCOL.reach
    for place in found:
        assert sum(place.shows.values()) > 0.0
        assert place.tilt in PROTOCOL.tilts
        np.testing.assert_allclose(place.path[-1], place.position)
        assert len(place.path) - 1 in (place.steps, place.steps - 1)


def test_every_step_to_a_place_is_one_that_the_guard_lets_pass() -> None:
    offline, thought = offered()
    _, occupancy = flown()
    for place in offline.places(thought):
        for before, after in itertools.pairwise(place.path):
            east, north, up = (after - before).tolist()
            move = _move(east, north, up)
            pose = SE2(float(before[0]), float(before[1]), move[1])
            decision = Decision(advance=move[0], climb=up)
            assert not guard(decision, pose, occupancy, PROTOCOL, float(before[2])).note


def _move(east: float, north: float, up: float) -> tuple[float, float]:
    """An advance and a heading that lead so far."""
    for heading in range(PROTOCOL.headings):
        for advance in (0.0, *PROTOCOL.advances):
            offset = PROTOCOL.offset(heading, advance)
            if np.allclose(np.array(offset) * PROTOCOL.lattice, (east, north)):
                return advance, wrap_angle(heading * PROTOCOL.heading_step)
    raise AssertionError((east, north, up))


def test_a_place_is_found_again_until_the_vehicle_is_there() -> None:
    offline, thought = offered()
    place = offline.places(thought)[1]
    now = offline.again(thought, place)
    assert now is not None
    assert now == (place, place.loss)
    assert isinstance(place, SixStepsPlace)
    gone = replace(place, position=(place.position[0] + 60.0, *place.position[1:]))
    assert offline.again(thought, gone) is None
    at = offline.here(thought)
    assert offline.again(thought, replace(place, position=(at.x, at.y, at.z))) is None


def test_table_and_map_have_the_same_places_with_the_same_depths() -> None:
    offline, thought = offered()
    observation, occupancy = flown()
    found = offline.places(thought)[:4]
    numbered = dict(zip((3, 1, 4, 2), found, strict=False))
    question = offline.question(observation, occupancy, thought, [], numbered, {})
    rows = re.findall(r"^\| (\d+) \| \((\S+), (\S+)\) \| (\S+) \| (\d+) \|", question.text, re.MULTILINE)
    table = {int(n): (float(x), float(y), -float(depth), int(steps)) for n, x, y, depth, steps in rows}
    assert table == {n: (*place.position, place.steps) for n, place in numbered.items()}
    chart = eyes.read_map(sight.decode(question.pictures["map"], "map"), eyes.INSPECTING)
    assert [number for number, _, _ in chart.marks] == sorted(numbered)
    # A depth stands beside each disc: another one is another picture, and of two places one above the
    # other both discs are seen.
    first = found[0]
    assert isinstance(first, SixStepsPlace)
    above = replace(first, position=(*first.position[:2], first.position[2] + 4.0))
    stacked = offline.question(observation, occupancy, thought, [], {1: first, 2: above}, {})
    chart = eyes.read_map(sight.decode(stacked.pictures["map"], "map"), eyes.INSPECTING)
    assert [number for number, _, _ in chart.marks] == [1, 2]
    assert answer(request(stacked.reply, stacked.pictures, stacked.text))["ranking"]


# ---------------------------------------------------------------------------------------------- on its way


@dataclass
class Watched:
    """`Ranked`, and what its pilot had spent after each decision."""

    planner: Ranked
    pilot: Any = None
    spent: list[float] = field(default_factory=list)
    spatial: bool = True

    def begin(self, given: Mission) -> Watched:
        self.pilot = self.planner.begin(given)
        return self

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        decision: Decision = self.pilot.decide(observation, occupancy)
        self.spent.append(self.pilot.spent)
        return decision


def fly(answer: Any, steps: int, **options: Any) -> tuple[list[Decision], list[Exchange], list[float]]:
    told = {"margin": 20.0, "weight": 50.0, "allowance": 10.0, "latency": 0.0, **options}
    with serving(answer) as server:
        watched = Watched(Ranked(**server.options, timeout=5.0, **told))
        flight = list(simulate(reef(), watched, PROTOCOL, max_steps=LOOK_AROUND + steps))
    later = flight[1 + LOOK_AROUND :]
    assert not any(step.guarded.note or step.arrival.collided for step in later)
    exchanges = [one for step in later for one in step.decision.exchanges]
    return [step.decision for step in later], exchanges, watched.spent


def test_a_choice_is_followed_within_what_choices_may_cost() -> None:
    decisions, exchanges, spent = fly(ranking(lambda numbers: sorted(numbers, reverse=True)), 6)
    assert any(exchange.outcome.startswith("followed: place ") for exchange in exchanges)
    assert any("The model ranked place" in decision.reasoning.next_target for decision in decisions)
    assert 0.0 < spent[-1] <= 10.0 * (LOOK_AROUND + 6) + 1.0


@pytest.mark.rare
@pytest.mark.parametrize(("answer", "options"), [(error(418), {}), (ranking(confidence=0.0), {})])
def test_otherwise_it_flies_as_the_offline_planner_does(answer: Any, options: dict[str, Any]) -> None:
    decisions, exchanges, spent = fly(answer, 3, **options)
    alone = list(simulate(reef(), SixSteps(), PROTOCOL, max_steps=LOOK_AROUND + 3))[1 + LOOK_AROUND :]
    moves = [(d.turn, d.advance, d.climb, d.tilt) for d in decisions]
    assert moves == [(d.turn, d.advance, d.climb, d.tilt) for d in (step.decision for step in alone)]
    assert exchanges
    assert spent[-1] == 0.0


def test_a_pilot_that_would_end_says_so_and_its_places_are_offered_once() -> None:
    observation, occupancy = flown()

    class Ending(SixStepsPlaces):
        """Whose own choice is to end, though there are places left."""

        def candidates(self, thought: Any, most: int) -> list[SixStepsPlace]:
            return [replace(place, loss=0.5 + place.loss) for place in super().candidates(thought, most)]

        def act(self, thought: Any, place: SixStepsPlace | None) -> Decision:
            return Decision(done=True) if place is None else super().act(thought, place)

    with serving(ranking(complete=True)) as server:
        pilot = Ranked(**server.options, timeout=5.0, latency=0.0).begin(mission())
        pilot.offline = InSpace(mission(), Ending(mission()))
        decision = pilot.decide(observation, occupancy)
    assert decision.done
    (exchange,) = decision.exchanges
    assert exchange.outcome == "as the offline planner would: the mission is complete"
    assert "These places would be left unseen." in exchange.question
