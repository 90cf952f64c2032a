"""The autopilot at the helm of the simulated vehicle, told the truth about its motion."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dream.control import _kernels
from dream.control.autopilot import Autopilot, nominal
from dream.geometry import SE3, wrap_angle
from dream.sim.vehicle import BLUEROV2, BLUEROV2_HEAVY, Current, Spread, Vehicle

Array = npt.NDArray[np.float64]
DEEP = -3.0
BEAT = 0.02
"""Seconds: 50 Hz, the limit of a MAVLink link."""
STEP = 0.01
"""Seconds of the simulated water."""


def dragging(vehicle: Vehicle, factor: float) -> Vehicle:
    """The same with so much of its drag."""
    spread = Spread(damping=(factor, factor), trim=0.0, net_buoyancy=(1.0, 1.0))
    return spread.draw(vehicle, np.random.default_rng(0))


def flown(
    goal: tuple[float, float, float, float],
    seconds: float,
    *,
    autopilot: Autopilot | None = None,
    believed: Vehicle = BLUEROV2_HEAVY,
    truth: Vehicle | None = None,
    current: tuple[float, float] = (0.0, 0.0),
) -> Array:
    """(N, 6) x, y, z, roll, pitch and yaw at every beat, from rest at the origin."""
    vehicle = believed if truth is None else truth
    state = vehicle.at_rest(SE3.level(0.0, 0.0, DEEP, 0.0))
    helm = (autopilot or Autopilot()).begin(believed.slowest, believed.thrusters, state.T_world_base)
    water, rows = Current((*current, 0.0)), []
    for _ in range(round(seconds / BEAT)):
        pose, velocity = state.T_world_base, state.velocity_world
        commands = helm.steer(pose, velocity, state.angular_velocity, goal, BEAT)
        for _ in range(round(BEAT / STEP)):
            state = vehicle.step(state, commands, STEP, water)
        R = state.T_world_base.rotation
        roll, pitch = math.atan2(R[2, 1], R[2, 2]), -math.asin(R[2, 0])
        rows.append([*state.position, roll, pitch, state.T_world_base.yaw])
    return np.array(rows)


def settled(error: Array, tolerance: float) -> float:
    """Seconds after which the error stays within the tolerance."""
    outside = np.flatnonzero(np.abs(error) > tolerance)
    return 0.0 if len(outside) == 0 else BEAT * (1 + int(outside[-1]))


def off(track: Array, goal: tuple[float, float, float]) -> Array:
    return np.asarray(np.linalg.norm(track[:, :3] - goal, axis=1))


# ---------------------------------------------------------------------------------------------- how good


@pytest.mark.few(3)
@pytest.mark.parametrize("bearing", [math.radians(45.0 * k) for k in range(8)])
def test_it_holds_its_station_in_a_current_to_three_centimetres(bearing: float) -> None:
    east, north = 0.2 * math.cos(bearing), 0.2 * math.sin(bearing)
    track = flown((0.0, 0.0, DEEP, 0.0), 15.0, current=(east, north))
    assert math.sqrt((off(track, (0.0, 0.0, DEEP)) ** 2).mean()) < 0.03
    assert off(track, (0.0, 0.0, DEEP))[-100:].max() < 0.005


def test_without_learning_what_pushes_it_a_current_holds_it_off_its_station() -> None:
    """By drag over stiffness: `inertia` · (`velocity` · `position`) newtons for a metre."""
    deaf = Autopilot(disturbance=0.0)
    end = flown((0.0, 0.0, DEEP, 0.0), 15.0, autopilot=deaf, current=(0.2, 0.0))[-1]
    hull = BLUEROV2_HEAVY.hull
    drag = hull.linear[0] * 0.2 + hull.quadratic[0] * 0.2**2
    stiffness = (hull.mass + hull.added[0]) * deaf.velocity * deaf.position
    assert end[0] == pytest.approx(drag / stiffness, rel=0.02)
    assert end[0] > 0.02


@pytest.mark.parametrize("factor", [0.15, 0.4, 1.0])
def test_a_step_of_ten_centimetres_is_done_in_three_seconds_whatever_the_drag(factor: float) -> None:
    track = flown((0.1, 0.0, DEEP, 0.0), 6.0, truth=dragging(BLUEROV2_HEAVY, factor))
    assert track[:, 0].max() < 0.11
    assert settled(off(track, (0.1, 0.0, DEEP)), 0.02) <= 3.0


@pytest.mark.parametrize("degrees", [30, 90, -90])
@pytest.mark.parametrize("vehicle", [BLUEROV2_HEAVY, dragging(BLUEROV2_HEAVY, 0.15), BLUEROV2])
def test_turns_are_done_in_three_seconds(vehicle: Vehicle, degrees: int) -> None:
    believed = BLUEROV2 if vehicle is BLUEROV2 else BLUEROV2_HEAVY
    track = flown((0.0, 0.0, DEEP, math.radians(degrees)), 6.0, believed=believed, truth=vehicle)
    error = np.degrees([wrap_angle(yaw - math.radians(degrees)) for yaw in track[:, 5]])
    assert (math.copysign(1.0, degrees) * error).max() < 2.0
    assert settled(error, 2.0) <= 3.0


@pytest.mark.parametrize("factor", [0.15, 0.4, 1.0])
def test_a_long_move_hardly_passes_its_goal_whatever_the_drag(factor: float) -> None:
    """What it learns of drag on the way it does not take for a push when it brakes."""
    goal = (2.0, 0.0, DEEP, 0.0)
    track = flown(goal, 9.0, truth=dragging(BLUEROV2_HEAVY, factor))
    assert track[:, 0].max() < 2.01
    assert settled(off(track, goal[:3]), 0.02) < 6.7
    if factor == 1.0:
        deaf = flown(goal, 9.0, autopilot=Autopilot(drag_learning=0.0))
        assert deaf[:, 0].max() > 2.01


@pytest.mark.parametrize(("factor", "least", "most"), [(0.15, 0.1, 0.3), (1.0, 0.6, 1.1)])
def test_going_to_and_fro_it_learns_how_much_of_the_drag_there_is(
    factor: float, least: float, most: float
) -> None:
    """From half of it; what is left of the difference is in the push already, and drives nothing."""
    vehicle = dragging(BLUEROV2_HEAVY, factor)
    state = vehicle.at_rest(SE3.level(0.0, 0.0, DEEP, 0.0))
    helm = Autopilot().begin(BLUEROV2_HEAVY.hull, BLUEROV2_HEAVY.thrusters, state.T_world_base)
    for k in range(1200):
        goal = (2.0 if k < 350 or k >= 700 else 0.0, 0.0, DEEP, 0.0)
        commands = helm.steer(
            state.T_world_base, state.velocity_world, state.angular_velocity, goal, BEAT
        )  # fmt: skip
        state = vehicle.step(state, commands, BEAT)
    assert least < helm.drag_share[0] < most


@pytest.mark.few(3)
@pytest.mark.parametrize("bearing", [0.0, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("factor", [0.15, 0.4, 1.0])
def test_in_a_current_it_ends_a_long_move_at_its_goal_as_well(factor: float, bearing: float) -> None:
    """Drag is of the way through the water: of the way over ground, it would end 2 cm too far."""
    vehicle = dragging(BLUEROV2_HEAVY, factor)
    state = vehicle.at_rest(SE3.level(0.0, 0.0, DEEP, 0.0))
    helm = Autopilot().begin(BLUEROV2_HEAVY.hull, BLUEROV2_HEAVY.thrusters, state.T_world_base)
    water = Current((0.2 * math.cos(bearing), 0.2 * math.sin(bearing), 0.0))
    farthest = 0.0
    for k in range(1000):
        goal = (0.0 if k < 400 else 2.0, 0.0, DEEP, 0.0)
        commands = helm.steer(
            state.T_world_base, state.velocity_world, state.angular_velocity, goal, BEAT
        )  # fmt: skip
        state = vehicle.step(state, commands, BEAT, water)
        farthest = max(farthest, float(state.position[0]))
    assert farthest < 2.01


def test_the_speed_of_water_that_makes_a_push_is_that_which_drags_as_much() -> None:
    for linear, quadratic in ((13.7, 141.0), (0.0, 217.0), (5.0, 0.0)):
        for speed in (-0.4, -0.01, 0.0, 0.02, 0.3):
            force = (linear + quadratic * abs(speed)) * speed
            assert _kernels.drag_of(linear, quadratic, speed) == pytest.approx(force)
            assert _kernels.speed_of(linear, quadratic, force, 1.0) == pytest.approx(speed)
    assert _kernels.speed_of(0.0, 0.0, 3.0, 1.0) == 0.0
    assert _kernels.speed_of(1.0, 1.0, -100.0, 0.5) == -0.5


def test_a_frame_that_cannot_pitch_goes_at_half_the_speed_at_which_it_turns_over() -> None:
    pilot = Autopilot()
    assert pilot.upright(BLUEROV2_HEAVY.hull, BLUEROV2_HEAVY.thrusters) is pilot
    slow = pilot.upright(BLUEROV2.hull, BLUEROV2.thrusters)
    assert slow == replace(pilot, speed=0.5 * BLUEROV2.hull.overturning)
    # The moment of the water there, u w (Z − X), against that of buoyancy, at a small angle of the nose.
    u, hull, angle = BLUEROV2.hull.overturning, BLUEROV2.hull, 1e-3
    munk = (hull.added[2] - hull.added[0]) * u * math.cos(angle) * u * math.sin(angle)
    assert munk == pytest.approx((hull.weight + hull.net_buoyancy) * 0.01 * math.sin(angle), rel=1e-5)
    assert u == pytest.approx(0.35, abs=0.01)
    helm = pilot.begin(BLUEROV2.hull, BLUEROV2.thrusters, SE3.level(0.0, 0.0, DEEP, 0.0))
    assert helm.gains.speed == slow.speed
    crawling = Autopilot(speed=0.1)
    assert crawling.upright(BLUEROV2.hull, BLUEROV2.thrusters).speed == 0.1


@pytest.mark.parametrize("factor", [1.0, 6.7])
@pytest.mark.parametrize("bearing", [0.0, 2.0])
def test_six_thrusters_end_a_long_move_at_its_goal(factor: float, bearing: float) -> None:
    goal = (2.0, 0.0, DEEP, 0.0)
    flow = (0.2 * math.cos(bearing), 0.2 * math.sin(bearing))
    track = flown(goal, 20.0, believed=BLUEROV2, truth=dragging(BLUEROV2, factor), current=flow)
    assert track[:, 0].max() < 2.03
    assert off(track, goal[:3])[-1] < 0.02


@pytest.mark.parametrize("yaw", [0.0, 2.0, -2.5])
def test_it_goes_straight_and_stays_level_at_every_heading(yaw: float) -> None:
    goal = (2.0 * math.cos(1.0), 2.0 * math.sin(1.0), DEEP, yaw)
    track = flown(goal, 12.0)
    across = -math.sin(1.0) * track[:, 0] + math.cos(1.0) * track[:, 1]
    assert np.abs(across).max() < 0.06
    assert np.abs(track[:, 2] - DEEP).max() < 0.03
    assert np.degrees(np.abs(track[:, 3:5])).max() < 6.0
    assert off(track, goal[:3])[-1] < 0.02


def test_it_does_what_the_loop_in_the_water_does() -> None:
    """`Helm.steer` is the kernel: the same beats give the same commands."""
    rng = np.random.default_rng(3)
    helm = Autopilot().begin(BLUEROV2_HEAVY.hull, BLUEROV2_HEAVY.thrusters, SE3.level(0.0, 0.0, DEEP, 0.3))
    memory, commands = helm.memory.copy(), np.zeros(8)
    chosen = nominal(BLUEROV2_HEAVY.hull, BLUEROV2_HEAVY.thrusters)
    goal = (1.0, -0.5, DEEP, 1.0)
    for _ in range(20):
        x, y = rng.normal(0.0, 0.1, 2)
        pose = SE3.level(x, y, DEEP, 0.3)
        velocity, rates = rng.normal(0.0, 0.05, 3), rng.normal(0.0, 0.05, 3)
        said = helm.steer(pose, velocity, rates, goal, BEAT)
        estimate: tuple[Any, ...] = (pose.rotation, pose.translation, velocity, rates)
        steer: Any = _kernels.steer
        steer(memory, np.array(goal), 1.0, *estimate, Autopilot().gains, chosen, BEAT, commands)
        np.testing.assert_array_equal(said, commands)


# ---------------------------------------------------------------------------------------------- its parts


@pytest.mark.parametrize("gap", [0.003, 0.1, 2.0, 7.3])
def test_the_reference_reaches_its_goal_without_passing_it_within_its_limits(gap: float) -> None:
    pilot = Autopilot()
    memory, goal = _kernels.begin(np.array([0.0, 0.0, DEEP]), 0.0, 0.5), np.array([0.0, gap, DEEP, 0.0])
    rows = []
    for _ in range(2000):
        _kernels.guide(memory, goal, pilot.gains, 1.0, STEP)
        rows.append(memory[:8].copy())
    y, speed = np.array(rows)[:, 1], np.array(rows)[:, 5]
    # The last of it is braked away within a beat.
    assert y.max() <= gap + 1e-5
    assert y[-1] == pytest.approx(gap, abs=1e-6)
    assert speed.max() <= pilot.speed + 1e-9
    assert np.abs(np.diff(speed)).max() / STEP <= 1.5 * pilot.acceleration + 1e-6
    # A trapezoid in time, or a triangle.
    v, a = pilot.speed, pilot.acceleration
    best = gap / v + v / a if gap > v * v / a else 2.0 * math.sqrt(gap / a)
    assert settled(y - gap, 1e-4) * STEP / BEAT < best + 0.3


def test_a_goal_that_moves_aside_is_followed_smoothly() -> None:
    pilot = Autopilot()
    memory, speeds = _kernels.begin(np.zeros(3), 0.0, 0.5), []
    for beat in range(1500):
        goal = np.array([3.0, 0.0, 0.0, 0.0]) if beat < 200 else np.array([0.0, 2.0, 0.0, 0.0])
        _kernels.guide(memory, goal, pilot.gains, 1.0, STEP)
        speeds.append(memory[4:7].copy())
    changes = np.linalg.norm(np.diff(speeds, axis=0), axis=1) / STEP
    assert changes.max() <= 1.5 * pilot.acceleration + 1e-6
    np.testing.assert_allclose(memory[:3], [0.0, 2.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("vehicle", [BLUEROV2, BLUEROV2_HEAVY])
def test_what_is_allocated_is_what_was_asked_for_on_all_axes_that_it_can_move(vehicle: Vehicle) -> None:
    chosen = nominal(vehicle.hull, vehicle.thrusters)
    rng, commands = np.random.default_rng(0), np.zeros(vehicle.thrusters.count)
    for _ in range(50):
        demand = rng.normal(0.0, [10.0, 10.0, 10.0, 1.0, 1.0, 3.0])
        if vehicle is BLUEROV2:
            demand[4] = 0.0
        assert _kernels.allocate(demand, chosen, commands) == 1.0
        np.testing.assert_allclose(
            vehicle.thrusters.allocation @ vehicle.thrusters.forces(commands), demand, atol=1e-6
        )


def test_beyond_saturation_less_is_given_in_the_same_direction() -> None:
    thrusters = BLUEROV2_HEAVY.thrusters
    chosen, commands = nominal(BLUEROV2_HEAVY.hull, thrusters), np.zeros(8)
    demand = np.array([400.0, 150.0, 0.0, 0.0, 0.0, 10.0])
    share = _kernels.allocate(demand, chosen, commands)
    assert 0.0 < share < 0.5
    assert np.abs(commands).max() == pytest.approx(1.0)
    np.testing.assert_allclose(thrusters.allocation @ thrusters.forces(commands), share * demand, atol=1e-6)


def test_while_it_saturates_it_does_not_learn_that_the_water_pushes() -> None:
    """A current that no thruster can fight: when it stops, there is nothing to unlearn."""
    helm = Autopilot().begin(BLUEROV2_HEAVY.hull, BLUEROV2_HEAVY.thrusters, SE3.level(0.0, 0.0, DEEP, 0.0))
    for k in range(200):
        helm.steer(SE3.level(-0.3 * k, 0.0, DEEP, 0.0), np.zeros(3), np.zeros(3), (0.0, 0.0, DEEP, 0.0), BEAT)
    assert helm.share < 1.0
    learnt = helm.push
    helm.steer(SE3.level(-80.0, 0.0, DEEP, 0.0), np.zeros(3), np.zeros(3), (0.0, 0.0, DEEP, 0.0), BEAT)
    np.testing.assert_array_equal(helm.push, learnt)


# ---------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize("name", [field.name for field in fields(Autopilot)])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_a_gain_that_is_none_is_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected"):
        Autopilot(**{name: value})


@pytest.mark.parametrize("what", ["goal", "velocity", "angular_velocity"])
def test_an_estimate_that_is_not_finite_moves_no_thruster(what: str) -> None:
    helm = Autopilot().begin(BLUEROV2_HEAVY.hull, BLUEROV2_HEAVY.thrusters, SE3.level(0.0, 0.0, DEEP, 0.0))
    pose, lost = SE3.level(0.0, 0.0, DEEP, 0.0), np.array([math.nan, 0.0, 0.0])
    velocity = lost if what == "velocity" else np.zeros(3)
    rates = lost if what == "angular_velocity" else np.zeros(3)
    goal = (math.nan if what == "goal" else 1.0, 0.0, DEEP, 0.0)
    memory = helm.memory.copy()
    with pytest.raises(ValueError, match=f"{what}: expected finite"):
        helm.steer(pose, velocity, rates, goal, BEAT)
    np.testing.assert_array_equal(helm.memory, memory)


@pytest.mark.parametrize("dt", [0.0, -0.01, 1.5, math.nan])
def test_time_that_stands_still_goes_back_or_leaps_is_refused(dt: float) -> None:
    helm = Autopilot().begin(BLUEROV2_HEAVY.hull, BLUEROV2_HEAVY.thrusters, SE3.level(0.0, 0.0, DEEP, 0.0))
    with pytest.raises(ValueError, match="dt: expected"):
        helm.steer(SE3.level(0.0, 0.0, DEEP, 0.0), np.zeros(3), np.zeros(3), (0.0, 0.0, DEEP, 0.0), dt)
