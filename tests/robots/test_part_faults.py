"""A battery, lamp, depth sensor or camera that fails on a mission: it is named, and it comes home."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, replace

import numpy as np
import pytest

from dream.commands.swim import Swim
from dream.evaluation.runner import simulate
from dream.planning import Lawnmower
from dream.protocol import DREAM_V1, DREAM_V1_NAV, DREAM_V2_TRUE
from dream.robots import Motion, Simulated, _kernels
from dream.robots.swimming import read_swimming
from dream.sim.sensors import Outage, PressureGauge
from dream.sim.world import World
from dream.types import Setpoint
from dream.vehicle import PartFault, VehiclePart, light

CALM = Motion(current=0.0, gust=0.0)
IN_SPACE = replace(DREAM_V2_TRUE, name="sinks-in-space", swims=True)


def climbed(world: World, motion: Motion, moves: int = 6) -> Simulated:
    """After moves ahead, each half a metre higher or lower than the last."""
    robot = Simulated(world, IN_SPACE, motion=motion)
    here, z = robot.observe().pose, robot.observe().z
    for k in range(moves):
        up = 0.5 * (k % 2)
        robot.go_to(Setpoint(here.x + k + 1.0, here.y, here.yaw, None, z=z + up))
    return robot


# --------------------------------------------------------------------------------------------- missions


@pytest.mark.parametrize(
    ("told", "why", "within"),
    [
        # By the load, which is low on its way.
        ("sag@14", r"the battery sags to 14\.\d V", 45.0),
        # Three pictures.
        ("lamp@14", r"the lamp is out: 1\d% of the usual light", 20.0),
        ("camera@14", "the camera is dark: 0% of the usual light", 20.0),
        # The move that it is on.
        ("gauge@14", "the depth sensor is stuck", 10.0),
    ],
)
def test_a_mission_whose_part_fails_comes_home_and_says_why(
    told: str, why: str, within: float, empty_world: World
) -> None:
    swimming = Swim(fault=told).chosen(DREAM_V1_NAV)
    steps = list(simulate(empty_world, Lawnmower(), DREAM_V1_NAV, max_steps=60, swimming=swimming))
    last, first = steps[-1], steps[0]
    assert last.ended == "returned"
    assert last.home is not None
    assert last.observation.pose.distance(first.observation.pose) < 0.2
    assert not any(step.arrival.collided for step in steps)
    named = next(step for step in steps if step.observation.trouble)
    assert last.home.why == named.observation.trouble
    assert re.fullmatch(why, last.home.why)
    assert 14.0 < named.observation.time < 14.0 + within


def test_with_a_dark_camera_nothing_is_learnt(empty_world: World) -> None:
    swimming = Swim(fault="camera@20").chosen(DREAM_V1_NAV)
    known = [
        step.occupancy.areas()["explored"]
        for step in simulate(empty_world, Lawnmower(), DREAM_V1_NAV, max_steps=60, swimming=swimming)
        if step.observation.time > 20.0
    ]
    assert len(known) > 3
    assert len(set(known)) == 1


# ------------------------------------------------------------------------------------- the depth sensor


def test_a_stuck_depth_sensor_is_found_before_it_misleads(empty_world: World) -> None:
    """On its way up or down, within some centimetres."""
    robot = climbed(empty_world, replace(CALM, fault=PartFault(VehiclePart.GAUGE, 8.0)))
    assert robot.ailing == {VehiclePart.GAUGE: "the depth sensor is stuck"}
    assert robot._voyage.clock[_kernels.STUCK] - 8.0 < 3.0
    assert robot.estimate.position[2] == pytest.approx(robot.truth.translation[2], abs=0.12)


@pytest.mark.parametrize("begins", [3.0 + 0.7 * k for k in range(12)])
def test_a_moments_silence_before_it_rises_is_no_trouble(begins: float, empty_world: World) -> None:
    """The readings before it may be the same by chance."""
    robot = climbed(empty_world, replace(CALM, outages=(Outage("depth", begins, 1.8),)), moves=4)
    assert robot.ailing == {}


@pytest.mark.parametrize(("noise", "resolution"), [(0.0, 0.002), (0.0005, 0.002), (0.003, 0.02)])
def test_a_gauge_that_may_repeat_itself_is_not_stuck(
    noise: float, resolution: float, empty_world: World
) -> None:
    gauge = PressureGauge(noise=noise, resolution=resolution)
    robot = Simulated(empty_world, DREAM_V1_NAV, motion=replace(CALM, gauge=gauge))
    here = robot.observe().pose
    for _ in range(40):
        robot.go_to(Setpoint(here.x, here.y, here.yaw, DREAM_V1.altitude))
    assert robot.ailing == {}


def test_a_silent_depth_sensor_is_told_and_heights_go_on(empty_world: World) -> None:
    robot = climbed(empty_world, replace(CALM, outages=(Outage("depth", 8.0),)))
    assert robot.ailing == {VehiclePart.GAUGE: "the depth sensor is silent"}
    assert robot.estimate.position[2] == pytest.approx(robot.truth.translation[2], abs=0.05)


def test_a_depth_sensor_of_a_vehicle_at_rest_is_not_stuck(empty_world: World) -> None:
    robot = Simulated(empty_world, DREAM_V1_NAV, motion=CALM)
    here = robot.observe().pose
    for _ in range(60):
        robot.go_to(Setpoint(here.x, here.y, here.yaw, DREAM_V1.altitude))
    assert robot._voyage.clock[_kernels.TIME] > 15.0
    assert robot.ailing == {}


# ----------------------------------------------------------------------------------------- the battery


def test_thrust_falls_with_the_voltage_and_the_autopilot_knows(empty_world: World) -> None:
    robot = climbed(empty_world, replace(CALM, fault=PartFault(VehiclePart.SAG, 4.0)), moves=3)
    volts = float(robot._voyage.clock[_kernels.VOLTS])
    assert 10.0 < volts < 15.5
    _, roots = replace(robot._motion.vehicle.thrusters, voltage=volts).points
    for curve in (robot._ship.body.roots, robot._ship.nominal.roots, robot._ship.plant.roots):
        np.testing.assert_allclose(curve, roots, rtol=1e-9)
    assert robot.finding is None


def test_a_battery_that_is_low_from_the_start_does_not_sag(empty_world: World) -> None:
    thrusters = replace(CALM.vehicle.thrusters, voltage=14.0)
    robot = climbed(empty_world, replace(CALM, vehicle=replace(CALM.vehicle, thrusters=thrusters)), moves=1)
    assert robot.ailing == {}


# ------------------------------------------------------------------------------------------------ given


@pytest.mark.parametrize("part", list(VehiclePart))
def test_a_part_fault_is_read_as_it_is_told_and_written_down(part: VehiclePart) -> None:
    swimming = Swim(fault=f"{part}@40.5").chosen(DREAM_V1_NAV)
    assert swimming is not None
    assert swimming.motion.fault == PartFault(part, 40.5)
    assert read_swimming(asdict(swimming)) == swimming


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ("lamp", r"or sag\|lamp\|gauge\|camera, and when"),
        ("lamp:1@40", r"or sag\|lamp\|gauge\|camera, and when"),
        ("sag@-1", "expected 0 s or more, got -1"),
        ("gauge@inf", "expected 0 s or more, got inf"),
    ],
)
def test_a_part_fault_that_is_none_is_refused(told: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Swim(fault=told).chosen(DREAM_V1_NAV)


def test_the_light_goes_with_lamp_and_camera_alone() -> None:
    for part, left in {
        VehiclePart.LAMP: 0.15,
        VehiclePart.CAMERA: 0.0,
        VehiclePart.SAG: 1.0,
        VehiclePart.GAUGE: 1.0,
    }.items():
        assert light(PartFault(part, 3.0), 2.9) == 1.0
        assert light(PartFault(part, 3.0), 3.0) == left
    assert light(None, 3.0) == 1.0
    assert math.isinf(Motion().fails_at(VehiclePart.SAG))
