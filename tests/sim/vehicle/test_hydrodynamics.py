from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dream.geometry import SE3
from dream.sim.vehicle import (
    BLUEROV2,
    BLUEROV2_HEAVY,
    STILL,
    Current,
    Diverged,
    Spread,
    State,
    Tether,
    Vehicle,
)
from dream.vehicle import GRAVITY
from tests.sim.vehicle import fossen

Array = npt.NDArray[np.float64]
BOTH = pytest.mark.parametrize("vehicle", [BLUEROV2, BLUEROV2_HEAVY], ids=["standard", "heavy"])
DEEP = SE3.level(3.0, -2.0, -10.0, 0.7)


def neutral(vehicle: Vehicle) -> Vehicle:
    """Without weight in water, and with the buoyancy where the weight is."""
    hull = replace(vehicle.hull, net_buoyancy=0.0, centre_of_buoyancy=(0.0, 0.0, 0.0))
    return replace(vehicle, hull=hull)


def frictionless(vehicle: Vehicle) -> Vehicle:
    return replace(vehicle, hull=replace(vehicle.hull, linear=(0.0,) * 6, quadratic=(0.0,) * 6))


def moving(vehicle: Vehicle, rng: np.random.Generator, speed: float = 0.5) -> State:
    """Somewhere, somehow turned, moving and pushing."""
    return State.of(
        np.concatenate(
            [
                rng.uniform(-5.0, 5.0, 2),
                [rng.uniform(-20.0, -5.0)],
                Rotation.random(rng=rng).as_quat()[[3, 0, 1, 2]],
                rng.normal(0.0, speed, 6),
                rng.uniform(-20.0, 20.0, vehicle.thrusters.count),
            ]
        )
    )


def run(vehicle: Vehicle, state: State, commands: npt.ArrayLike, seconds: float, **keys: object) -> State:
    dt = float(keys.pop("dt", 0.01))  # type: ignore[arg-type]
    for _ in range(round(seconds / dt)):
        state = vehicle.step(state, commands, dt, **keys)  # type: ignore[arg-type]
    return state


def idle(vehicle: Vehicle) -> Array:
    return np.zeros(vehicle.thrusters.count)


def energy(vehicle: Vehicle, state: State) -> float:
    """Kinetic energy of body and water about it, and the height of weight and buoyancy."""
    hull = vehicle.hull
    nu = state.vector[7:13]
    M = fossen.rigid(vehicle) + fossen.added(vehicle)
    buoyant = state.position + state.T_world_base.rotation @ np.array(hull.centre_of_buoyancy)
    lifted = hull.weight * state.position[2] - (hull.weight + hull.net_buoyancy) * buoyant[2]
    return float(0.5 * nu @ M @ nu + lifted)


@BOTH
def test_a_step_is_that_of_the_book(vehicle: Vehicle) -> None:
    current = Current((0.2, -0.1, 0.05), (0.02, 0.01, 0.0), level=-8.0)
    hull = replace(vehicle.hull, centre_of_buoyancy=(0.01, -0.02, 0.03))
    vehicle = replace(vehicle, hull=hull)
    rng = np.random.default_rng(5)
    for seed in range(20):
        state = moving(vehicle, rng)
        if seed == 0:  # half out of the water
            state = replace(state, position=np.array([0.0, 0.0, 0.02]))
        commands, gust = rng.uniform(-1.0, 1.0, vehicle.thrusters.count), rng.normal(0.0, 0.1, 2)
        pull = rng.normal(0.0, 5.0, 3)
        fast = vehicle.step(state, commands, 0.01, current, gust=gust, pull=pull)
        slow = fossen.step(vehicle, state.vector, commands, 0.01, current, gust, pull)
        assert np.allclose(fast.vector, slow, rtol=1e-9, atol=1e-10)


@BOTH
def test_the_tether_drags_like_a_line_in_many_slices(vehicle: Vehicle) -> None:
    vehicle = replace(vehicle, tether=Tether(attachment=(-0.2, 0.05, 0.1)))
    rng = np.random.default_rng(6)
    for current in (STILL, Current((0.3, 0.1, 0.0), (0.005, 0.0, 0.0))):
        for _ in range(5):
            state = replace(moving(vehicle, rng), angular_velocity=np.zeros(3))
            loose = replace(vehicle, tether=None)
            free = fossen.rates(loose, state.vector, idle(vehicle), current)
            slow = (fossen.rates(vehicle, state.vector, idle(vehicle), current) - free)[7:13]
            dt = 1e-6
            fast = vehicle.step(state, idle(vehicle), dt, current).vector
            fast = ((fast - loose.step(state, idle(vehicle), dt, current).vector) / dt)[7:13]
            # Exact in still water; where the flow turns about along the line, good to a part of its whole.
            speed = float(np.linalg.norm(state.velocity)) + (0.0 if current is STILL else 0.35)
            whole = 1000.0 * 1.2 * 0.0076 * -state.position[2] * speed**2 / 8.0
            near = 1e-3 if current is STILL else 0.1
            masses = np.array([vehicle.hull.mass] * 3 + list(vehicle.hull.moments)) + vehicle.hull.added
            arms = np.array([1.0, 1.0, 1.0, 0.23, 0.23, 0.23])
            assert (np.abs(fast - slow) <= near * whole * arms / masses + 1e-6).all()


def test_a_tether_that_is_towed_drags_by_the_closed_form() -> None:
    vehicle = replace(neutral(BLUEROV2), tether=Tether(attachment=(0.0, 0.0, 0.0)))
    state = replace(vehicle.at_rest(SE3.level(0, 0, -10.0, 0.0)), velocity=np.array([0.4, 0.0, 0.0]))
    loose = replace(vehicle, tether=None)
    dt = 1e-5
    slower = (
        loose.step(state, idle(vehicle), dt).velocity[0] - vehicle.step(state, idle(vehicle), dt).velocity[0]
    )
    # ρ C_d d L v² / 8
    force = 1000.0 * 1.2 * 0.0076 * 10.0 * 0.4**2 / 8.0
    assert slower / dt * (11.5 + 5.5) == pytest.approx(force, rel=1e-3)


@pytest.mark.parametrize(
    ("vehicle", "speed"), [(BLUEROV2, 2.55), (BLUEROV2_HEAVY, 0.91)], ids=["standard", "heavy"]
)
def test_full_throttle_ahead_ends_at_the_published_speed(vehicle: Vehicle, speed: float) -> None:
    vehicle = neutral(vehicle)
    forces = idle(vehicle)
    forces[:4] = 51.5, 51.5, -39.9, -39.9
    if vehicle.thrusters.count == 8:  # the horizontal ones sit low: the vertical ones hold the nose
        arm = (vehicle.thrusters.allocation[4, :4] @ forces[:4]) / vehicle.thrusters.allocation[4, 4]
        forces[4:] = np.array([-1.0, -1.0, 1.0, 1.0]) * arm / 4.0
    commands = vehicle.thrusters.commands(forces)
    start = replace(vehicle.at_rest(SE3.level(0, 0, -10.0, 0.0)), thrust=forces)
    end = run(vehicle, start, commands, 1.5)
    assert end.velocity[0] == pytest.approx(speed, abs=0.01)
    assert np.abs(end.velocity[1:]).max() < 1e-6
    # Drag balances thrust: d u + q u² = F.
    d, q = vehicle.hull.linear[0], vehicle.hull.quadratic[0]
    F = float(vehicle.thrusters.allocation[0] @ forces)
    assert end.velocity[0] == pytest.approx((-d + math.sqrt(d * d + 4.0 * q * F)) / (2.0 * q), rel=1e-3)


@BOTH
def test_a_vehicle_left_alone_comes_up_at_the_speed_of_its_buoyancy(vehicle: Vehicle) -> None:
    end = run(vehicle, vehicle.at_rest(DEEP), idle(vehicle), 15.0)
    d, q = vehicle.hull.linear[2], vehicle.hull.quadratic[2]
    B = vehicle.hull.net_buoyancy
    assert end.velocity[2] == pytest.approx((-d + math.sqrt(d * d + 4.0 * q * B)) / (2.0 * q), rel=1e-3)
    assert np.allclose(end.position[:2], DEEP.translation[:2], atol=1e-9)


@BOTH
def test_at_the_surface_it_floats_where_buoyancy_is_weight(vehicle: Vehicle) -> None:
    end = run(vehicle, vehicle.at_rest(SE3.level(0, 0, -0.3, 0.2)), idle(vehicle), 60.0, dt=0.03)
    hull = vehicle.hull
    under = hull.weight / (hull.weight + hull.net_buoyancy)
    z = hull.height * (0.5 - under) - hull.centre_of_buoyancy[2]
    assert end.position[2] == pytest.approx(z, abs=1e-3)
    assert np.abs(end.vector[7:13]).max() < 0.01


@BOTH
def test_neutral_and_at_rest_it_stays(vehicle: Vehicle) -> None:
    vehicle = neutral(vehicle)
    start = vehicle.at_rest(DEEP)
    assert np.allclose(run(vehicle, start, idle(vehicle), 20.0).vector, start.vector, atol=1e-9)


@BOTH
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_without_thrust_and_current_energy_never_grows(vehicle: Vehicle, seed: int) -> None:
    state = replace(moving(vehicle, np.random.default_rng(seed)), thrust=idle(vehicle))
    state = replace(state, position=np.array([0.0, 0.0, -200.0]))
    before = energy(vehicle, state)
    for _ in range(200):
        state = vehicle.step(state, idle(vehicle), 0.01)
        now = energy(vehicle, state)
        assert now <= before + 1e-7
        before = now


@BOTH
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_without_drag_energy_is_kept(vehicle: Vehicle, seed: int) -> None:
    # Coriolis forces do no work, and weight and buoyancy give back what they took.
    vehicle = frictionless(vehicle)
    state = replace(moving(vehicle, np.random.default_rng(seed)), thrust=idle(vehicle))
    state = replace(state, position=np.array([0.0, 0.0, -200.0]))
    before = energy(vehicle, state)
    state = run(vehicle, state, idle(vehicle), 2.0, dt=0.005)
    assert energy(vehicle, state) == pytest.approx(before, abs=2e-4)


@BOTH
def test_drag_of_a_tether_takes_energy_in_still_water(vehicle: Vehicle) -> None:
    vehicle = replace(frictionless(vehicle), tether=Tether())
    state = replace(vehicle.at_rest(DEEP), velocity=np.array([0.5, 0.2, 0.0]))
    before = energy(vehicle, state)
    for _ in range(500):
        state = vehicle.step(state, idle(vehicle), 0.01)
        now = energy(vehicle, state)
        assert now < before + 1e-9
        before = now


@BOTH
def test_the_water_about_it_makes_it_slower_to_start(vehicle: Vehicle) -> None:
    # From rest, a force F gives F / (m + added) along each axis, a moment M / (I + added).
    vehicle = neutral(vehicle)
    A = vehicle.thrusters.allocation
    masses = [vehicle.hull.mass] * 3 + list(vehicle.hull.moments)
    for axis in range(6):
        if not A[axis].any():
            continue
        wrench = np.zeros(6)
        wrench[axis] = 1.0
        forces = np.linalg.pinv(A) @ wrench
        start = replace(vehicle.at_rest(DEEP), thrust=forces)
        dt = 1e-4
        after = vehicle.step(start, vehicle.thrusters.commands(forces), dt).vector[7:13]
        expected = np.zeros(6)
        expected[axis] = dt / (masses[axis] + vehicle.hull.added[axis])
        assert np.allclose(after, expected, atol=1e-3 * expected[axis] + 1e-9)


def test_broadside_water_turns_it_by_munks_moment() -> None:
    # Moving ahead and sideways at once, a body turns broadside: N = (X_u̇ − Y_v̇) u v.
    vehicle = frictionless(neutral(BLUEROV2))
    state = replace(vehicle.at_rest(DEEP), velocity=np.array([0.3, 0.2, 0.0]))
    dt = 1e-4
    turning = vehicle.step(state, idle(vehicle), dt).angular_velocity[2] / dt
    added = vehicle.hull.added
    moment = (added[0] - added[1]) * 0.3 * 0.2
    assert turning == pytest.approx(moment / (vehicle.hull.moments[2] + added[5]), rel=1e-3)


@pytest.mark.parametrize(("share", "level"), [(0.8, True), (1.3, False)])
def test_six_thrusters_hold_level_up_to_the_speed_where_munks_moment_wins(share: float, level: bool) -> None:
    # A small pitch θ at speed u: the water turns it on by (Z_ẇ − X_u̇) u² θ, buoyancy back by B z_b θ.
    hull = replace(BLUEROV2.hull, net_buoyancy=0.0, linear=(0.0,) * 6, quadratic=(0.0,) * 6)
    vehicle = replace(BLUEROV2, hull=hull)
    limit = math.sqrt(hull.weight * hull.centre_of_buoyancy[2] / (hull.added[2] - hull.added[0]))
    assert limit == pytest.approx(0.35, abs=0.01)
    start = vehicle.at_rest(SE3(Rotation.from_euler("y", 0.01).as_matrix(), np.array([0.0, 0.0, -50.0])))
    velocity = start.T_world_base.rotation.T @ np.array([share * limit, 0.0, 0.0])
    state = replace(start, velocity=velocity)
    greatest = 0.0
    for _ in range(800):
        state = vehicle.step(state, idle(vehicle), 0.01)
        greatest = max(greatest, abs(math.asin(-state.T_world_base.rotation[2, 0])))
    assert (greatest < 0.05) == level


@BOTH
def test_adrift_it_takes_on_the_velocity_of_the_water(vehicle: Vehicle) -> None:
    vehicle = neutral(vehicle)
    water = Current((0.15, -0.1, 0.02))
    start = replace(vehicle.at_rest(DEEP), angular_velocity=np.array([0.0, 0.0, 0.5]))
    end = run(vehicle, start, idle(vehicle), 300.0, dt=0.05, current=water)
    # Quadratic drag alone lets the last of it linger as 1 / t.
    assert np.allclose(end.velocity_world, water.mean, atol=0.002)


@BOTH
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_an_even_current_only_carries_the_motion_along(vehicle: Vehicle, seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = moving(vehicle, rng)
    commands = rng.uniform(-1.0, 1.0, vehicle.thrusters.count)
    water = np.array([0.3, -0.2, 0.0])
    carried = replace(start, velocity=start.velocity + start.T_world_base.rotation.T @ water)
    still = run(vehicle, start, commands, 1.0)
    moved = run(vehicle, carried, commands, 1.0, current=Current((0.3, -0.2, 0.0)))
    assert np.allclose(moved.position, still.position + water, atol=1e-6)
    assert np.allclose(moved.wxyz, still.wxyz, atol=1e-6)
    assert np.allclose(moved.velocity_world, still.velocity_world + water, atol=1e-6)


@BOTH
def test_a_turn_of_the_world_turns_the_motion(vehicle: Vehicle) -> None:
    start = moving(vehicle, np.random.default_rng(3))
    turn = Rotation.from_euler("z", 1.2)
    commands = np.linspace(-0.5, 0.7, vehicle.thrusters.count)
    turned = replace(
        start,
        position=turn.apply(start.position),
        wxyz=(turn * Rotation.from_quat(start.wxyz[[1, 2, 3, 0]])).as_quat()[[3, 0, 1, 2]],
    )
    water = turn.apply([0.2, 0.1, 0.0])
    plain = run(vehicle, start, commands, 1.0, current=Current((0.2, 0.1, 0.0)))
    other = run(vehicle, turned, commands, 1.0, current=Current((float(water[0]), float(water[1]), 0.0)))
    assert np.allclose(other.position, turn.apply(plain.position), atol=1e-6)
    assert np.allclose(other.vector[7:], plain.vector[7:], atol=1e-6)


@BOTH
def test_halving_the_step_makes_the_error_a_sixteenth(vehicle: Vehicle) -> None:
    # With linear drag alone: quadratic drag has a kink in its slope where a velocity passes zero.
    hull = replace(vehicle.hull, quadratic=(0.0,) * 6)
    fast = replace(vehicle, hull=hull, thrusters=replace(vehicle.thrusters, lag=0.4))
    start = replace(
        fast.at_rest(DEEP),
        velocity=np.array([0.5, 0.4, 0.3]),
        angular_velocity=np.array([0.3, 0.2, 0.4]),
    )
    commands = np.full(fast.thrusters.count, 0.4)
    true = run(fast, start, commands, 0.32, dt=0.00125).vector
    error = [np.abs(run(fast, start, commands, 0.32, dt=dt).vector - true).max() for dt in (0.04, 0.02, 0.01)]
    for coarse, fine in pairwise(error):
        assert 12.0 < coarse / fine < 22.0


@BOTH
def test_the_quaternion_keeps_its_length(vehicle: Vehicle) -> None:
    start = replace(moving(vehicle, np.random.default_rng(1)), angular_velocity=np.array([3.0, -4.0, 5.0]))
    end = run(vehicle, start, idle(vehicle), 10.0)
    assert abs(np.linalg.norm(end.wxyz) - 1.0) < 1e-12
    assert np.allclose(end.T_world_base.rotation @ end.T_world_base.rotation.T, np.eye(3), atol=1e-12)


@BOTH
def test_thrust_follows_a_command_with_the_lag(vehicle: Vehicle) -> None:
    commands = np.full(vehicle.thrusters.count, 0.5)
    after = run(vehicle, vehicle.at_rest(DEEP), commands, vehicle.thrusters.lag, dt=0.001)
    target = float(vehicle.thrusters.forces(0.5))
    assert np.allclose(after.thrust, target * (1.0 - math.exp(-1.0)), rtol=1e-4)


@BOTH
def test_a_pose_becomes_a_state_and_back(vehicle: Vehicle) -> None:
    for rotation in Rotation.random(50, rng=np.random.default_rng(2)):
        pose = SE3(rotation.as_matrix(), np.array([1.0, 2.0, -3.0]))
        back = vehicle.at_rest(pose).T_world_base
        assert np.allclose(back.rotation, pose.rotation, atol=1e-12)
        assert np.allclose(back.translation, pose.translation)


@pytest.mark.rare
@BOTH
def test_a_simple_hold_keeps_both_level_and_in_place(vehicle: Vehicle) -> None:
    # The drawn vehicles of both sets, in a current: what a controller has to live with.
    A = np.linalg.pinv(vehicle.thrusters.allocation)
    goal = np.array([0.0, 0.0, -5.0])
    for seed in range(2):
        drawn = Spread().draw(vehicle, np.random.default_rng(seed))
        state = drawn.at_rest(SE3.level(0.3, -0.2, -5.1, 0.3))
        for _ in range(1500):
            R = state.T_world_base.rotation
            force = R.T @ (60.0 * (goal - state.position)) - 40.0 * state.velocity
            angles = Rotation.from_matrix(R).as_rotvec()
            moment = -8.0 * angles - 3.0 * state.angular_velocity
            commands = drawn.thrusters.commands(A @ np.concatenate([force, moment]))
            state = drawn.step(state, commands, 0.01, Current((0.1, 0.0, 0.0)))
        assert np.linalg.norm(state.position - goal) < 0.2
        assert abs(state.T_world_base.yaw) < 0.1


def test_drawn_damping_is_even_on_the_logarithm_and_within_bounds() -> None:
    rng = np.random.default_rng(0)
    drawn = [Spread().draw(BLUEROV2_HEAVY, rng) for _ in range(2000)]
    factor = np.array([vehicle.hull.quadratic[0] / 141.0 for vehicle in drawn])
    assert np.allclose([vehicle.hull.linear[2] / 33.0 for vehicle in drawn], factor)
    assert factor.min() >= 0.15
    assert factor.max() <= 1.0
    low, high = math.log(0.15), 0.0
    share = np.sort((np.log(factor) - low) / (high - low))
    # Kolmogorov and Smirnov's distance, at 0.1 %.
    assert np.abs(share - (np.arange(2000) + 0.5) / 2000).max() < 1.95 / math.sqrt(2000)
    lift = np.array([vehicle.hull.net_buoyancy for vehicle in drawn])
    assert lift.min() >= 0.2
    assert lift.max() <= 5.0


@pytest.mark.parametrize(("vehicle", "span"), [(BLUEROV2, (1.0, 6.7)), (BLUEROV2_HEAVY, (0.15, 1.0))])
def test_each_vehicle_has_its_own_span_of_damping(vehicle: Vehicle, span: tuple[float, float]) -> None:
    rng, own = np.random.default_rng(0), vehicle.hull.quadratic[5]
    factors = [Spread().draw(vehicle, rng).hull.quadratic[5] / own for _ in range(500)]
    assert span[0] <= min(factors) < 1.1 * span[0]
    assert 0.9 * span[1] < max(factors) <= span[1]
    assert vehicle.slowest.quadratic[5] == pytest.approx(span[1] * own)
    given = Spread(damping=(2.0, 2.0)).draw(vehicle, rng).hull
    assert given.quadratic[5] == pytest.approx(2.0 * own)


def test_a_drawn_trim_is_how_the_vehicle_hangs() -> None:
    drawn = Spread(net_buoyancy=(0.0, 0.0)).draw(BLUEROV2_HEAVY, np.random.default_rng(4))
    end = run(drawn, drawn.at_rest(SE3.level(0, 0, -10.0, 0.0)), idle(drawn), 120.0, dt=0.05)
    up = end.T_world_base.rotation.T @ np.array([0.0, 0.0, 1.0])
    at = np.array(drawn.hull.centre_of_buoyancy)
    assert np.allclose(up, at / np.linalg.norm(at), atol=5e-3)
    rng = np.random.default_rng(9)
    hangs = []
    for _ in range(2000):
        x, y, z = Spread().draw(BLUEROV2, rng).hull.centre_of_buoyancy
        hangs.append([math.atan2(y, math.hypot(x, z)), math.atan2(-x, z)])
    assert np.allclose(np.std(hangs, axis=0), 0.05, rtol=0.06)


def test_the_same_seed_is_the_same_vehicle_and_run_and_another_is_not() -> None:
    def flown(seed: int) -> Array:
        rng = np.random.default_rng(seed)
        vehicle = Spread().draw(BLUEROV2, rng)
        water = Current((0.1, 0.0, 0.0), gust=0.1)
        state, gust = vehicle.at_rest(DEEP), water.begin(rng)
        for _ in range(100):
            state = vehicle.step(state, np.full(6, 0.2), 0.01, water, gust=gust)
            gust = water.stirred(gust, 0.01, rng)
        return state.vector

    assert np.array_equal(flown(1), flown(1))
    assert not np.allclose(flown(1), flown(2), atol=1e-3)


def test_gusts_have_their_deviation_and_their_memory() -> None:
    water = Current(gust=0.1, gust_time=2.0)
    rng = np.random.default_rng(7)
    gust = water.begin(rng)
    found = np.empty((40000, 2))
    for i in range(len(found)):
        found[i] = gust
        gust = water.stirred(gust, 0.5, rng)
    # Some 5000 independent samples of each axis.
    assert np.allclose(found.std(axis=0), 0.1, rtol=0.06)
    assert np.abs(found.mean(axis=0)).max() < 0.01
    for lag in (1, 4, 8):
        kept = np.mean(found[:-lag] * found[lag:], axis=0) / 0.1**2
        assert np.allclose(kept, math.exp(-0.5 * lag / 2.0), atol=0.08)
    assert abs(np.mean(found[:, 0] * found[:, 1])) < 0.06 * 0.1**2


def test_gusts_do_not_depend_on_how_often_one_looks() -> None:
    water = Current(gust=0.1, gust_time=2.0)
    rng = np.random.default_rng(8)
    ends = np.empty((4000, 2))
    for i in range(len(ends)):
        ends[i] = np.array([0.3, -0.3])
        for _ in range(4):
            ends[i] = water.stirred(ends[i], 0.25, rng)
    kept = math.exp(-0.5)
    assert np.allclose(ends.mean(axis=0), [0.3 * kept, -0.3 * kept], atol=0.006)
    assert np.allclose(ends.std(axis=0), 0.1 * math.sqrt(1.0 - kept * kept), rtol=0.06)


def test_a_shear_is_felt_by_height() -> None:
    water = Current((0.1, 0.0, 0.0), (0.02, 0.0, 0.0), level=-10.0)
    assert water.velocity(-5.0).tolist() == pytest.approx([0.2, 0.0, 0.0])
    vehicle = neutral(BLUEROV2)
    for z, speed in ((-10.0, 0.1), (-5.0, 0.2)):
        end = run(
            vehicle, vehicle.at_rest(SE3.level(0, 0, z, 0.5)), idle(vehicle), 60.0, dt=0.05, current=water
        )
        assert end.velocity_world[0] == pytest.approx(speed, abs=1e-3)


def test_a_snatch_at_the_tether_is_its_impulse() -> None:
    vehicle = neutral(BLUEROV2)
    state = run(
        vehicle, vehicle.at_rest(SE3.level(0, 0, -10.0, 0.0)), idle(vehicle), 0.01, pull=(100.0, 0.0, 0.0)
    )
    assert state.velocity[0] == pytest.approx(1.0 / (11.5 + 5.5), rel=0.01)


def test_what_is_not_finite_goes_neither_in_nor_out() -> None:
    start = BLUEROV2.at_rest(DEEP)
    with pytest.raises(ValueError, match="commands: expected finite"):
        BLUEROV2.step(start, [np.nan] * 6, 0.01)
    with pytest.raises(ValueError, match=r"commands: expected \(6,\), got \(8,\)"):
        BLUEROV2.step(start, [0.0] * 8, 0.01)
    with pytest.raises(ValueError, match="state: expected"):
        BLUEROV2.step(replace(start, velocity=np.array([np.nan, 0, 0])), [0.0] * 6, 0.01)
    with pytest.raises(ValueError, match="expected 6 thrusters, got 8"):
        BLUEROV2.step(BLUEROV2_HEAVY.at_rest(DEEP), [0.0] * 6, 0.01)
    with pytest.raises(ValueError, match="gust: expected finite"):
        BLUEROV2.step(start, [0.0] * 6, 0.01, gust=(np.inf, 0.0))
    with pytest.raises(ValueError, match="dt: expected seconds above 0"):
        BLUEROV2.step(start, [0.0] * 6, 0.0)
    wild = replace(start, velocity=np.array([1e160, 1e160, 0.0]))
    with pytest.raises(Diverged, match="Is the step long"):
        BLUEROV2.step(wild, [0.0] * 6, 1.0)


def test_parameters_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match=r"hull.mass: expected a number above 0, got -1"):
        replace(BLUEROV2.hull, mass=-1.0)
    with pytest.raises(ValueError, match=r"hull.added: expected six magnitudes"):
        replace(BLUEROV2.hull, added=(-5.5, 12.7, 14.57, 0.12, 0.12, 0.12))
    with pytest.raises(ValueError, match=r"spread.damping"):
        Spread(damping=(0.0, 1.0))
    with pytest.raises(ValueError, match=r"current.gust_time"):
        Current(gust_time=0.0)
    with pytest.raises(ValueError, match=r"tether.diameter"):
        Tether(diameter=0.0)
    assert BLUEROV2.hull.weight == pytest.approx(11.5 * GRAVITY)
