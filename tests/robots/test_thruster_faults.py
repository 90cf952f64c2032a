"""A thruster that fails on a mission: it is named, the others go on, and the mission comes home."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import pytest

from dream.commands.swim import Swim
from dream.control.diagnosis import Diagnosis
from dream.errors import MissionAborted
from dream.evaluation.runner import simulate
from dream.geometry import SE2, wrap_angle
from dream.planning import Lawnmower
from dream.protocol import DREAM_V1, DREAM_V1_NAV
from dream.robots import Motion, Simulated, Swimming, _kernels
from dream.robots.swimming import read_swimming
from dream.sim.vehicle import BLUEROV2, BLUEROV2_HEAVY, Vehicle
from dream.sim.world import World
from dream.types import Setpoint
from dream.vehicle import FaultKind, ThrusterFault, read_fault

START = SE2(0.0, 0.0, 0.0)


def swum(world: World, motion: Motion, start: SE2 = START, moves: int = 10) -> Simulated:
    """After moves and turns, or until a fault is named."""
    robot = Simulated(world, DREAM_V1_NAV, start, motion=motion)
    x, y, yaw = start.x, start.y, start.yaw
    for k in range(moves):
        yaw = wrap_angle(yaw + (0.0, 0.5, -0.25)[k % 3] * math.pi)
        x, y = x + math.cos(yaw), y + math.sin(yaw)
        robot.go_to(Setpoint(x, y, yaw, DREAM_V1.altitude))
        if robot.finding is not None:
            break
    return robot


def delay(robot: Simulated) -> float:
    """Seconds from when the fault showed until it was named."""
    assert robot.finding is not None
    return float(robot.finding.time - robot._voyage.clock[_kernels.FAILED])


# ---------------------------------------------------------------------------------------------- named


@pytest.mark.parametrize("kind", list(FaultKind))
@pytest.mark.parametrize("thruster", range(1, 9))
def test_every_thruster_that_fails_is_named_within_three_seconds(
    thruster: int, kind: FaultKind, empty_world: World
) -> None:
    fault = ThrusterFault(thruster, kind, 6.0)
    robot = swum(empty_world, Motion(fault=fault))
    assert robot.finding is not None
    assert (robot.finding.thruster, robot.finding.kind) == (thruster, kind)
    assert 0.0 < delay(robot) <= 3.0
    assert robot.observe().trouble == str(robot.finding)
    if kind is FaultKind.JAMMED:
        assert robot.finding.force == pytest.approx(17.8, abs=3.0)


@pytest.mark.parametrize(
    ("vehicle", "start"),
    [(BLUEROV2_HEAVY, SE2(-3.0, 1.0, 1.0)), (BLUEROV2, SE2(2.0, 1.0, -1.0))],
)
def test_a_healthy_vehicle_is_accused_of_nothing(vehicle: Vehicle, start: SE2, empty_world: World) -> None:
    """In a current with gusts, with a hull that is not the model's."""
    robot = swum(empty_world, Motion(vehicle=vehicle, current=0.2, gust=0.06), start, moves=30)
    assert robot.finding is None
    assert robot.observe().trouble == ""


def test_looking_for_faults_changes_nothing_until_one_is_named(empty_world: World) -> None:
    looking = swum(empty_world, Motion())
    blind = swum(empty_world, Motion(diagnosis=Diagnosis(certain=1e12)))
    later = swum(empty_world, Motion(fault=ThrusterFault(3, FaultKind.DEAD, 1e6)))
    assert looking._voyage.x.tolist() == blind._voyage.x.tolist() == later._voyage.x.tolist()


# --------------------------------------------------------------------------------------------- missions


@pytest.mark.parametrize("told", ["dead:3@14", "weak:6@14", "jammed:1@14"])
def test_a_mission_with_a_fault_comes_home_and_says_why(told: str, empty_world: World) -> None:
    swimming = Swim(fault=told).chosen(DREAM_V1_NAV)
    steps = list(simulate(empty_world, Lawnmower(), DREAM_V1_NAV, max_steps=40, swimming=swimming))
    last, first = steps[-1], steps[0]
    assert last.ended == "returned"
    assert last.home is not None
    fault = read_fault(told)
    assert isinstance(fault, ThrusterFault)
    assert last.home.why == f"thruster {fault.thruster} {fault.kind.told}"
    assert any(last.home.why in step.arrival.note for step in steps)
    assert last.observation.pose.distance(first.observation.pose) < 0.2
    assert not any(step.arrival.collided for step in steps)


@pytest.mark.parametrize(("told", "said"), [("dead:5@14", "is dead"), ("jammed:6@14", "is jammed on")])
def test_six_thrusters_without_a_vertical_one_surface_and_say_so(
    told: str, said: str, empty_world: World
) -> None:
    swimming = Swim(vehicle="bluerov2", fault=told).chosen(DREAM_V1_NAV)
    with pytest.raises(
        MissionAborted, match=f"{said}, and the others cannot steer without it; the vehicle surfaced"
    ):
        list(simulate(empty_world, Lawnmower(), DREAM_V1_NAV, max_steps=40, swimming=swimming))


def test_with_a_fault_it_swims_at_half_its_speeds(empty_world: World) -> None:
    robot = swum(empty_world, Motion(fault=ThrusterFault(2, FaultKind.DEAD, 6.0)))
    assert robot.finding is not None
    for name in ("speed", "acceleration", "turn_rate", "turn_acceleration", "ascent"):
        assert getattr(robot._ship.gains, name) == 0.5 * getattr(robot._motion.helmsman, name)


# ------------------------------------------------------------------------------------------------ given


def test_a_fault_is_read_as_it_is_told_and_written_down() -> None:
    swimming = Swim(fault="weak:8@40.5").chosen(DREAM_V1_NAV)
    assert swimming is not None
    assert swimming.motion.fault == ThrusterFault(8, FaultKind.WEAK, 40.5)
    assert read_swimming(asdict(swimming)) == swimming


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ("dead", "expected dead|weak|jammed and the thruster's number, or sag|lamp|gauge|camera, and when"),
        ("broken:3@40", "expected dead|weak|jammed"),
        ("dead:x@40", "expected dead|weak|jammed"),
        ("dead:3@soon", "expected dead|weak|jammed"),
        ("dead:0@40", "expected a number from 1 on, got 0"),
        ("dead:3@-1", "expected 0 s or more, got -1"),
        ("dead:3@nan", "expected 0 s or more, got nan"),
        ("dead:9@40", "expected one of the vehicle's thrusters, 1 to 8, got 9"),
    ],
)
def test_a_fault_that_is_none_is_refused(told: str, said: str) -> None:
    with pytest.raises(ValueError, match=said.replace("|", r"\|")):
        Swim(fault=told).chosen(DREAM_V1_NAV)


def test_a_fault_needs_a_vehicle_that_swims_and_has_that_thruster() -> None:
    with pytest.raises(ValueError, match="--fault: expected a protocol"):
        Swim(fault="dead:3@40").chosen(DREAM_V1)
    with pytest.raises(ValueError, match="1 to 6, got 7"):
        replace(Swimming().motion, vehicle=BLUEROV2, fault=ThrusterFault(7, FaultKind.DEAD, 0.0))
