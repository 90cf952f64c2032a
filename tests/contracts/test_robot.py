"""What every robot must do."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from dream.control import setpoint
from dream.geometry import SE2
from dream.mission import Robot
from dream.protocol import DREAM_V1, DREAM_V1_NAV, DREAM_V1_NOISY
from dream.robots import Anchored, Simulated, Teleport
from dream.sim.world import World
from dream.types import Decision, Label

ROBOTS: dict[str, Callable[[World], Robot]] = {
    "teleport": lambda world: Teleport(world, DREAM_V1),
    "teleport with noise": lambda world: Teleport(world, DREAM_V1_NOISY),
    "swimming": lambda world: Simulated(world, DREAM_V1_NAV),
    "anchored": lambda world: Anchored(Simulated(world, DREAM_V1_NAV), DREAM_V1_NAV),
}

NEAR, ALIGNED = 0.06, math.radians(2.1)
"""Metres and radians from a setpoint that still are there."""

robots = pytest.mark.parametrize("make", ROBOTS.values(), ids=ROBOTS)


@robots
def test_an_observation_is_complete(make: Callable[[World], Robot], string_reef: World) -> None:
    seen = make(string_reef).observe()
    assert seen.rgb.dtype == np.uint8
    assert seen.depth.dtype == np.float32
    assert set(np.unique(seen.labels)) <= set(Label)
    assert np.nanmin(seen.depth) > 0.0
    assert (seen.labels[np.isnan(seen.depth)] == Label.WATER).all()
    assert seen.rgb.std() > 1.0


@robots
def test_observations_share_no_memory(make: Callable[[World], Robot], string_reef: World) -> None:
    robot = make(string_reef)
    first, second = robot.observe(), robot.observe()
    np.testing.assert_array_equal(first.rgb, second.rgb)
    first.rgb[:] = 0
    first.depth[:] = 0.0
    third = robot.observe()
    np.testing.assert_array_equal(second.rgb, third.rgb)
    np.testing.assert_array_equal(second.depth, third.depth)


@robots
def test_the_same_moves_show_the_same(make: Callable[[World], Robot], string_reef: World) -> None:
    seen = []
    for robot in (make(string_reef), make(string_reef)):
        robot.go_to(setpoint(robot.observe().pose, Decision(math.pi / 2), DREAM_V1))
        seen.append(robot.observe())
    for name in ("rgb", "depth", "labels"):
        assert getattr(seen[0], name).tobytes() == getattr(seen[1], name).tobytes()


@robots
def test_it_goes_where_it_is_sent(make: Callable[[World], Robot], empty_world: World) -> None:
    robot = make(empty_world)
    goal = setpoint(robot.observe().pose, Decision(math.pi / 6, 2.0), DREAM_V1)
    arrival = robot.go_to(goal)
    assert arrival.pose.distance(SE2(goal.x, goal.y, goal.yaw)) < NEAR
    assert not arrival.collided
    assert robot.observe().pose.distance(arrival.pose) < 1e-9
    assert math.isclose(robot.observe().pose.yaw, goal.yaw, abs_tol=ALIGNED)


@robots
def test_where_it_believes_to_be_is_near_where_it_is(
    make: Callable[[World], Robot], empty_world: World
) -> None:
    robot = make(empty_world)
    arrival = robot.go_to(setpoint(robot.observe().pose, Decision(math.pi / 6, 2.0), DREAM_V1))
    truth = robot.observe().T_world_base if arrival.truth is None else arrival.truth
    assert truth.se2.distance(arrival.pose) < 0.1
    height = float(empty_world.terrain.height(truth.translation[0], truth.translation[1]))
    assert truth.translation[2] - height == pytest.approx(DREAM_V1.altitude, abs=0.1)


@robots
def test_time_passes_only_when_it_moves(make: Callable[[World], Robot], empty_world: World) -> None:
    robot = make(empty_world)
    before = robot.observe().time
    assert robot.observe().time == before
    robot.go_to(setpoint(robot.observe().pose, Decision(0.0, 2.0), DREAM_V1))
    assert robot.observe().time > before


@robots
def test_contact_stops_it(make: Callable[[World], Robot], string_reef: World) -> None:
    tall = np.argmax(string_reef.obstacles.scale[:, 2])
    x, y = string_reef.obstacles.position[tall, :2]
    robot = make(string_reef)
    robot.go_to(setpoint(SE2(float(x) - 6.0, float(y), 0.0), Decision(), DREAM_V1))
    before = robot.observe().pose
    arrival = robot.go_to(setpoint(SE2(float(x), float(y), 0.0), Decision(), DREAM_V1))
    assert arrival.collided
    assert arrival.clearance <= 0.0
    assert before.distance(arrival.pose) < before.distance(SE2(float(x), float(y), 0.0))
