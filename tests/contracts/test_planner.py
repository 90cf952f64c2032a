"""What every planner must do."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError, fields
from typing import Any

import numpy as np
import pytest

from dream.evaluation.runner import simulate
from dream.mapping import OccupancyMap
from dream.planning import PLANNERS, AnyPlanner
from dream.protocol import DREAM_V1
from dream.sim.world import World
from dream.types import Decision, Mission, Observation, Step

STEPS = 14

planners = pytest.mark.parametrize("planner", PLANNERS.values(), ids=PLANNERS)


@pytest.fixture(scope="module", params=PLANNERS)
def flown(request: pytest.FixtureRequest, string_reef: World) -> list[Step]:
    return list(simulate(string_reef, PLANNERS[request.param], DREAM_V1, max_steps=STEPS))


def _looked_around(world: World) -> tuple[Observation, OccupancyMap]:
    """An observation and a map after the look-around."""
    *_, last = simulate(world, PLANNERS["random"], DREAM_V1, max_steps=3)
    return last.observation, last.occupancy


def test_its_moves_are_moves_of_the_protocol(flown: list[Step]) -> None:
    for step in flown[1:]:
        assert min(abs(step.decision.turn - turn) for turn in DREAM_V1.turn_angles) < 1e-9
        assert step.decision.advance in (0.0, *DREAM_V1.advances)
        assert not step.decision.stops or step.decision.done


def test_it_says_why(flown: list[Step]) -> None:
    for step in flown[1:]:
        assert step.decision.reasoning.action


def test_it_gets_somewhere_without_contact(flown: list[Step]) -> None:
    assert sum(step.arrival.distance for step in flown) > 3.0
    assert not any(step.arrival.collided for step in flown)


@planners
def test_the_same_mission_gets_the_same_decisions(planner: AnyPlanner, string_reef: World) -> None:
    def decisions() -> list[Decision]:
        return [step.decision for step in simulate(string_reef, planner, DREAM_V1, max_steps=8)]

    assert decisions() == decisions()


@planners
def test_deciding_changes_neither_the_observation_nor_the_map(
    planner: AnyPlanner, string_reef: World
) -> None:
    observation, occupancy = _looked_around(string_reef)
    before = occupancy.copy()
    images = observation.rgb.copy(), observation.depth.copy(), observation.labels.copy()
    planner.begin(Mission(DREAM_V1, occupancy.bounds, 200)).decide(observation, occupancy)
    for layer in (
        "solid",
        "target",
        "explored",
        "seabed_seen",
        "crossed",
        "traversable",
        "inflated",
        "standable",
    ):
        np.testing.assert_array_equal(getattr(occupancy, layer), getattr(before, layer))
    for image, kept in zip((observation.rgb, observation.depth, observation.labels), images, strict=True):
        np.testing.assert_array_equal(image, kept)


@planners
def test_two_missions_of_one_planner_do_not_disturb_each_other(
    planner: AnyPlanner, string_reef: World
) -> None:
    observation, occupancy = _looked_around(string_reef)
    mission = Mission(DREAM_V1, occupancy.bounds, 200)
    alone = planner.begin(mission).decide(observation, occupancy)
    first, second = planner.begin(mission), planner.begin(mission)
    for _ in range(3):
        first.decide(observation, occupancy)
    assert second.decide(observation, occupancy) == alone


@planners
def test_a_parameter_out_of_range_is_refused_by_name(planner: AnyPlanner) -> None:
    for parameter in fields(planner):
        wrong: dict[str, Any] = {parameter.name: math.nan}
        with pytest.raises(ValueError, match=f"{parameter.name}: expected"):
            type(planner)(**wrong)


@planners
def test_its_parameters_are_frozen_and_documented(planner: AnyPlanner) -> None:
    parameter = fields(planner)[0].name
    with pytest.raises(FrozenInstanceError):
        setattr(planner, parameter, 0)
    for heading in ("What it does:", "Reference:", "Assumes:", "Fails when:"):
        assert heading in (planner.__doc__ or "")
