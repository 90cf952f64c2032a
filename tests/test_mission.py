"""The loop, with scripted planners on an empty sea floor."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest

from dream.errors import PlannerFailed
from dream.evaluation.runner import simulate
from dream.geometry import SE2
from dream.mapping import OccupancyMap
from dream.mission import explore
from dream.protocol import DREAM_V1, DREAM_V2
from dream.robots import Teleport
from dream.sim.world import World
from dream.types import LOOK_AROUND, Arrival, Decision, Label, Mission, Observation, Setpoint


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


class ScriptedInSpace(Scripted):
    """Flies in space."""

    spatial = True


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


def test_what_was_touched_is_not_run_into_again(string_reef: World) -> None:
    """By a robot that takes a boulder for open water."""
    tall = np.argmax(string_reef.obstacles.scale[:, 2])
    x, y = map(float, string_reef.obstacles.position[tall, :2])
    protocol = DREAM_V2
    height = protocol.launch_height(float(string_reef.terrain.height(x - 4.0, y)))
    robot = Teleport(string_reef, protocol, SE2(x - 4.0, y, 0.0))
    occupancy = OccupancyMap(string_reef.bounds, protocol)

    class Blind:
        def observe(self) -> Observation:
            seen = robot.observe()
            return replace(
                seen,
                depth=np.full_like(seen.depth, 12.0),
                labels=np.full_like(seen.labels, Label.SEABED),
                confidence=None,
            )

        def go_to(self, setpoint: Setpoint) -> Arrival:
            return robot.go_to(setpoint)

    ahead = Decision(advance=max(protocol.advances))
    east = ScriptedInSpace((Decision(turn=0.5 * math.pi), *[ahead] * 8))
    moves = list(explore(Blind(), east, occupancy, max_steps=12))[LOOK_AROUND + 2 :]
    touched = [step.index for step in moves if step.arrival.collided]
    assert len(touched) == 1
    # The guard holds it up from then on.
    assert all(step.guarded.note for step in moves if step.index > touched[0])
    contact = next(step.arrival.contact for step in moves if step.arrival.collided)
    assert contact is not None
    assert math.isclose(contact[2], height, abs_tol=0.5)
    assert math.hypot(contact[0] - x, contact[1] - y) < 3.0
