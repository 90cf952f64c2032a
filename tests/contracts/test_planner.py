"""What every planner must do. Those that ask a model ask one that is served on this machine."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import FrozenInstanceError, fields, replace
from itertools import islice
from typing import Any

import numpy as np
import pytest

from dream.evaluation.runner import simulate
from dream.mapping import OccupancyMap
from dream.planning import OFFLINE, PLANAR, PLANNERS, AnyPlanner, Asking, UivNav
from dream.protocol import DREAM_V1
from dream.sim.world import World
from dream.types import LOOK_AROUND, Mission, Observation, Step
from tests.model_server import Server, serving

STEPS = 10
AGAIN = LOOK_AROUND + 3
"""Steps that are flown twice: two decisions, and what leads to each of them."""


@pytest.fixture(scope="module")
def model() -> Iterator[Server]:
    with serving() as server:
        yield server


@pytest.fixture(scope="module", params=PLANAR)
def planner(request: pytest.FixtureRequest, model: Server) -> AnyPlanner:
    return Asking(**model.options).given_to(PLANNERS[request.param])


@pytest.fixture(scope="module")
def flown(planner: AnyPlanner, string_reef: World) -> list[Step]:
    return list(simulate(string_reef, planner, DREAM_V1, max_steps=STEPS))


@pytest.fixture(scope="module")
def looked_around(string_reef: World) -> Step:
    """The last step of the look-around, in which nobody decides."""
    *_, last = simulate(string_reef, PLANNERS["random"], DREAM_V1, max_steps=LOOK_AROUND)
    return last


@pytest.fixture
def seen(looked_around: Step) -> tuple[Observation, OccupancyMap]:
    """An observation and a map after the look-around, the test's own."""
    observation = looked_around.observation
    images = {name: getattr(observation, name).copy() for name in ("rgb", "depth", "labels")}
    return replace(observation, **images), looked_around.occupancy.copy()


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


def test_the_same_mission_gets_the_same_decisions(
    planner: AnyPlanner, flown: list[Step], string_reef: World
) -> None:
    again = simulate(string_reef, planner, DREAM_V1, max_steps=STEPS)
    assert [step.decision for step in islice(again, AGAIN)] == [step.decision for step in flown[:AGAIN]]


def test_deciding_changes_neither_the_observation_nor_the_map(
    planner: AnyPlanner, seen: tuple[Observation, OccupancyMap]
) -> None:
    observation, occupancy = seen
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
        "standable",
    ):
        np.testing.assert_array_equal(getattr(occupancy, layer), getattr(before, layer))
    for image, kept in zip((observation.rgb, observation.depth, observation.labels), images, strict=True):
        np.testing.assert_array_equal(image, kept)


@pytest.mark.few(3)
def test_two_missions_of_one_planner_do_not_disturb_each_other(
    planner: AnyPlanner, seen: tuple[Observation, OccupancyMap]
) -> None:
    observation, occupancy = seen
    mission = Mission(DREAM_V1, occupancy.bounds, 200)
    alone = planner.begin(mission).decide(observation, occupancy)
    first, second = planner.begin(mission), planner.begin(mission)
    for _ in range(3):
        first.decide(observation, occupancy)
    assert second.decide(observation, occupancy) == alone


def test_a_parameter_out_of_range_is_refused_by_name(planner: AnyPlanner) -> None:
    for parameter in fields(planner):
        wrong: dict[str, Any] = {parameter.name: math.nan}
        with pytest.raises(ValueError, match=f"{parameter.name}: expected"):
            type(planner)(**wrong)


def test_its_parameters_are_frozen_and_documented(planner: AnyPlanner) -> None:
    for parameter in fields(planner):
        with pytest.raises(FrozenInstanceError):
            setattr(planner, parameter.name, 0)
    for heading in ("What it does:", "Reference:", "Assumes:", "Fails when:"):
        assert heading in (planner.__doc__ or "")


def test_only_those_that_need_no_model_and_no_network_are_called_offline(planner: AnyPlanner) -> None:
    name = next(name for name, default in PLANNERS.items() if type(default) is type(planner))
    assert (name in OFFLINE) == (not isinstance(planner, Asking | UivNav))


def test_every_answer_of_a_model_is_told(planner: AnyPlanner, flown: list[Step]) -> None:
    asked = [exchange for step in flown for exchange in step.decision.exchanges]
    waited = sum(step.decision.waited for step in flown)
    if not isinstance(planner, Asking):
        assert (asked, waited) == ([], 0.0)
        return
    assert planner.latency is not None
    assert 0.0 <= waited <= planner.latency * sum(exchange.requests for exchange in asked)
    for exchange in asked:
        assert (exchange.model, exchange.fallback) == (planner.label, "")
        assert all(png.startswith(b"\x89PNG") for png in exchange.pictures.values())
