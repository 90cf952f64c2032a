"""The loop, with scripted planners on an empty sea floor."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from dream.errors import PlannerFailed
from dream.evaluation.runner import simulate
from dream.mapping import OccupancyMap
from dream.mission import explore
from dream.protocol import DREAM_V1
from dream.robots import Teleport
from dream.sim.world import World
from dream.types import LOOK_AROUND, Decision, Mission, Observation


@dataclass(frozen=True, slots=True)
class Scripted:
    """Says the same things in the same order, then holds."""

    script: tuple[Decision, ...]

    def begin(self, mission: Mission) -> Reader:
        return Reader(iter(self.script))


@dataclass(frozen=True, slots=True)
class Reader:
    lines: Iterator[Decision]

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        return next(self.lines, Decision())


def script(*decisions: Decision) -> Scripted:
    return Scripted(decisions)


def test_a_mission_begins_with_one_free_look_and_three_quarter_turns(empty_world: World) -> None:
    steps = list(simulate(empty_world, script(), DREAM_V1, max_steps=5))
    assert [s.index for s in steps] == [0, 1, 2, 3, 4, 5]
    start = empty_world.starts[0]
    for step in steps[: LOOK_AROUND + 1]:
        assert (step.observation.pose.x, step.observation.pose.y) == (start.x, start.y)
    turned = steps[LOOK_AROUND].observation.pose.yaw - start.yaw
    assert math.isclose(math.cos(turned), math.cos(1.5 * math.pi), abs_tol=1e-9)
    assert math.isclose(math.sin(turned), math.sin(1.5 * math.pi), abs_tol=1e-9)


def test_the_look_around_explores_the_disc_around_the_start_but_not_the_blind_zone(
    empty_world: World,
) -> None:
    *_, last = simulate(empty_world, script(), DREAM_V1, max_steps=LOOK_AROUND)
    occupancy, pose = last.occupancy, last.observation.pose
    rows, cols = np.indices(occupancy.explored.shape)
    x, y = occupancy.center_of(rows, cols)
    distance = np.hypot(x - pose.x, y - pose.y)
    inside = (distance > DREAM_V1.blind + 0.5) & (distance < DREAM_V1.reach - 0.5)
    assert occupancy.explored[inside].mean() > 0.995
    assert not occupancy.explored[distance < DREAM_V1.blind - 0.5].any()
    assert not occupancy.explored[distance > DREAM_V1.reach + 0.5].any()


def test_the_cap_ends_a_mission(empty_world: World) -> None:
    steps = list(simulate(empty_world, script(), DREAM_V1, max_steps=4))
    assert [s.ended for s in steps] == ["", "", "", "", "cap"]


def test_a_done_that_the_map_does_not_support_is_refused_and_costs_a_step(empty_world: World) -> None:
    steps = list(simulate(empty_world, script(Decision(done=True)), DREAM_V1, max_steps=5))
    refused = steps[LOOK_AROUND + 1]
    assert refused.decision.done
    assert refused.open_region
    assert refused.ended == ""
    assert steps[-1].index == 5
    assert refused.arrival.distance == 0.0


def test_a_move_onto_ground_never_seen_is_guarded(empty_world: World) -> None:
    ahead = script(*[Decision(advance=2.0)] * 60)
    steps = list(simulate(empty_world, ahead, DREAM_V1, max_steps=60))
    assert any(s.guarded.note for s in steps), "the edge of the area must stop it"
    bounds = empty_world.bounds
    for step in steps:
        pose = step.observation.pose
        assert bounds.contains(pose.x, pose.y, margin=DREAM_V1.body_radius)
        assert not step.arrival.collided


def test_a_fresh_map_is_filled_by_the_mission(empty_world: World) -> None:
    occupancy = OccupancyMap(empty_world.bounds, DREAM_V1)
    robot = Teleport(empty_world, DREAM_V1)
    first = next(explore(robot, script(), occupancy))
    assert first.occupancy is occupancy
    assert occupancy.explored.any()


@pytest.mark.parametrize("steps", [1, LOOK_AROUND])
def test_the_planner_is_not_asked_during_the_look_around(empty_world: World, steps: int) -> None:
    class Silent:
        def begin(self, mission: Mission) -> Silent:
            return self

        def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
            raise AssertionError("asked during the look-around")

    assert len(list(simulate(empty_world, Silent(), DREAM_V1, max_steps=steps))) == steps + 1


class Cannot:
    """A planner that lacks what it needs."""

    def begin(self, mission: Mission) -> Reader:
        raise ValueError("model: expected one, got none")


def test_a_planner_that_cannot_begin_fails_before_the_first_step_is_asked_for(empty_world: World) -> None:
    with pytest.raises(PlannerFailed, match="begin: ValueError: model: expected one, got none"):
        simulate(empty_world, Cannot(), DREAM_V1)
