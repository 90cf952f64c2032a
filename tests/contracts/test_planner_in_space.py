"""What every planner must do that flies under a protocol that moves in space."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import FrozenInstanceError, fields, replace
from itertools import islice
from typing import Any

import pytest

from dream.geometry import Bounds
from dream.mapping import OccupancyMap
from dream.mission import explore
from dream.planning import IN_SPACE, PLANAR, PLANNERS, AnyPlanner, Asking
from dream.protocol import DREAM_V1, DREAM_V2_TRUE
from dream.robots.teleport import Teleport
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import LOOK_AROUND, Step

STEPS = 9
AGAIN = LOOK_AROUND + 3
"""Steps that are flown twice: two decisions, and what leads to each of them."""


@pytest.fixture(scope="module", params=IN_SPACE)
def planner(request: pytest.FixtureRequest) -> AnyPlanner:
    """Those that ask a model ask the stand-in."""
    return Asking(model="wire").given_to(PLANNERS[request.param])


@pytest.fixture(scope="module")
def wreck() -> World:
    return make_world("wreck/5", 101)


def fly(world: World, planner: AnyPlanner, steps: int) -> Iterator[Step]:
    occupancy = OccupancyMap(world.bounds, DREAM_V2_TRUE)
    return explore(Teleport(world, DREAM_V2_TRUE), planner, occupancy, max_steps=steps)


@pytest.fixture(scope="module")
def flown(planner: AnyPlanner, wreck: World) -> list[Step]:
    return list(fly(wreck, planner, STEPS))


def test_its_moves_are_moves_of_the_protocol_and_known_to_be_free(flown: list[Step]) -> None:
    protocol = DREAM_V2_TRUE
    for step in flown[1:]:
        decision = step.decision
        assert min(abs(decision.turn - turn) for turn in protocol.turn_angles) < 1e-9
        assert decision.advance in (0.0, *protocol.advances)
        assert decision.climb in protocol.climbs
        assert decision.tilt is None or decision.tilt in protocol.tilts
        assert step.guarded.note == ""
        assert not decision.stops or decision.done


def test_it_says_why_and_gets_somewhere_without_contact(flown: list[Step]) -> None:
    assert all(step.decision.reasoning.action for step in flown[1:])
    assert sum(step.arrival.distance for step in flown) > 3.0
    assert not any(step.arrival.collided for step in flown)


def test_the_same_mission_gets_the_same_decisions(
    planner: AnyPlanner, flown: list[Step], wreck: World
) -> None:
    again = [step.decision for step in islice(fly(wreck, planner, STEPS), AGAIN)]
    assert again == [step.decision for step in flown[:AGAIN]]


def test_it_stops_by_itself(planner: AnyPlanner, wreck: World) -> None:
    start = wreck.starts[0]
    small = Bounds(start.x - 2.0, start.y - 2.0, start.x + 2.0, start.y + 2.0)
    occupancy = OccupancyMap(small, DREAM_V2_TRUE)
    *_, last = explore(Teleport(wreck, DREAM_V2_TRUE), planner, occupancy, max_steps=60)
    assert last.ended == "done"


def test_a_parameter_out_of_range_is_refused_by_name(planner: AnyPlanner) -> None:
    for parameter in fields(planner):
        wrong: dict[str, Any] = {parameter.name: math.nan}
        with pytest.raises(ValueError, match=f"{parameter.name}: expected"):
            replace(planner, **wrong)


def test_its_parameters_are_frozen_and_documented(planner: AnyPlanner) -> None:
    for parameter in fields(planner):
        with pytest.raises(FrozenInstanceError):
            setattr(planner, parameter.name, 0)
    for heading in ("What it does:", "Reference:", "Assumes:", "Fails when:"):
        assert heading in (planner.__doc__ or "")


@pytest.mark.parametrize("name", PLANNERS)
def test_a_planner_that_cannot_fly_there_is_refused_before_anything_moves(name: str, wreck: World) -> None:
    for protocol, can in ((DREAM_V1, PLANAR), (DREAM_V2_TRUE, IN_SPACE)):
        if name in can:
            continue
        kind = type(PLANNERS[name]).__name__
        with pytest.raises(ValueError, match=f"planner: expected one that flies .*; got {kind}") as refused:
            explore(Teleport(wreck, protocol), PLANNERS[name], OccupancyMap(wreck.bounds, protocol))
        named = str(refused.value).partition("such as ")[2].partition(";")[0].split(", ")
        assert set(named) <= set(can)
        assert protocol.space is None or set(named) == set(IN_SPACE)
