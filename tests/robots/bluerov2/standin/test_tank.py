"""The true vehicle of a stand-in dive."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.geometry import SE2
from dream.robots.bluerov2.standin.tank import BEAT, Battery, Conditions, Tank
from dream.sim.sensors import BAR30, DVL_A50, ICM_20602
from dream.sim.world import World
from dream.sim.worlds import make_world

AHEAD = np.array([0.3, 0.3, -0.3, -0.3, 0.0, 0.0, 0.0, 0.0])
NONE = np.zeros(8)


@pytest.fixture(scope="module")
def pool() -> World:
    return make_world("pool/arc", 1)


def swum(tank: Tank, commands: np.ndarray, seconds: float) -> None:
    for _ in range(round(seconds / BEAT)):
        tank.advance(commands)


def test_it_is_held_at_the_launch_until_it_is_released(pool: World) -> None:
    tank = Tank(pool)
    start = tank.T_world_base
    assert (start.translation[0], start.translation[1]) == (pool.starts[0].x, pool.starts[0].y)
    seabed = float(pool.terrain.height(pool.starts[0].x, pool.starts[0].y))
    assert start.translation[2] == pytest.approx(seabed + tank.protocol.altitude)
    swum(tank, AHEAD, 1.0)
    np.testing.assert_array_equal(tank.T_world_base.translation, start.translation)
    assert tank.time == pytest.approx(1.0)
    assert tank.imu.specific_force[2] == pytest.approx(9.81, abs=0.5)
    tank.release()
    swum(tank, NONE, 2.0)
    assert tank.T_world_base.translation[2] > start.translation[2] + 1e-3


def test_the_same_seed_is_the_same_dive_whoever_pings(pool: World) -> None:
    def dive(seed: int, *, pings: bool) -> np.ndarray:
        tank = Tank(pool, seed=seed)
        tank.release()
        for _ in range(50):
            tank.advance(AHEAD)
            if pings:
                tank.ping()
        return np.concatenate([tank.state.vector, tank.imu.specific_force, [tank.depth.z, tank.heading.yaw]])

    np.testing.assert_array_equal(dive(1, pings=False), dive(1, pings=True))
    assert not np.array_equal(dive(1, pings=False), dive(2, pings=False))


def test_a_pull_at_the_tether_moves_it_while_it_lasts(pool: World) -> None:
    tank = Tank(pool, start=SE2(0.0, 0.0, 1.0))
    tank.release()
    tank.pull((0.0, 5.0, 0.0), 0.5, after=0.2)
    swum(tank, NONE, 0.2)
    assert abs(tank.state.velocity_world[1]) < 1e-6
    swum(tank, NONE, 0.5)
    assert tank.state.velocity_world[1] > 0.05
    fast = tank.state.velocity_world[1]
    swum(tank, NONE, 1.0)
    assert tank.state.velocity_world[1] < fast


def test_thrust_goes_with_the_voltage_and_the_voltage_with_thrust(pool: World) -> None:
    def thrust(volts: float) -> float:
        tank = Tank(pool, start=SE2(0.0, 0.0, 0.0))
        tank.release()
        tank.drain(volts)
        assert tank.voltage == pytest.approx(volts - 0.03 * 1.5)
        swum(tank, AHEAD, 1.0)
        assert tank.voltage < volts - 0.03 * 1.5
        return float(tank.state.thrust[0])

    # Force goes with V^1.15.
    assert thrust(16.0) / thrust(14.0) == pytest.approx((16.0 / 14.0) ** 1.15, rel=0.01)


def test_a_battery_rests_where_its_cells_do() -> None:
    battery = Battery()
    assert (battery.full, battery.empty) == pytest.approx((16.68, 10.0))
    # By the table of the cell: 3.4193 V at 13.57 % and 3.5826 V at 29.15 %.
    assert battery.at_rest(0.2) == pytest.approx(4 * 3.4867, abs=1e-3)
    assert battery.at_rest(0.5) == pytest.approx(4 * 3.740, abs=0.01)
    # The knee: the last tenth takes more than the next three.
    rest = [battery.at_rest(left) for left in (0.0, 0.1, 0.4)]
    assert rest[1] - rest[0] > rest[2] - rest[1] > 0.0


@given(st.floats(0.0, 1.0))
def test_the_voltage_at_rest_says_what_is_left(left: float) -> None:
    battery = Battery()
    assert battery.left_at(battery.at_rest(left)) == pytest.approx(left, abs=1e-9)


def test_what_is_left_of_a_battery_is_taken_from_it(pool: World) -> None:
    tank, battery = Tank(pool), Battery()
    tank.leave(0.3)
    assert tank.used == pytest.approx(0.7 * 18.0)
    assert tank.voltage == pytest.approx(battery.at_rest(0.3) - 0.03 * 1.5)
    tank.drain(battery.at_rest(0.25))
    assert tank.used == pytest.approx(0.75 * 18.0)
    with pytest.raises(ValueError, match=r"share: expected 0 to 1, got 1\.2"):
        tank.leave(1.2)
    with pytest.raises(ValueError, match=r"volts: expected 10 to 16\.68, got 17"):
        tank.drain(17.0)


def test_a_bad_connection_makes_the_voltage_sag_under_load_alone(pool: World) -> None:
    def sagged(resistance: float, commands: np.ndarray) -> float:
        tank = Tank(pool)
        tank.release()
        tank.resistance = resistance
        swum(tank, commands, 1.0)
        return Battery().full - tank.voltage

    assert sagged(0.2, NONE) == pytest.approx(0.2 * 1.5, abs=1e-3)
    assert sagged(0.2, AHEAD) / sagged(0.03, AHEAD) == pytest.approx(0.2 / 0.03, rel=0.01)
    assert sagged(0.2, AHEAD) > 0.4


def test_what_it_draws_empties_the_battery(pool: World) -> None:
    tank = Tank(pool)
    tank.release()
    # Eight at full throttle draw 192 A, and 1.5 A go on.
    swum(tank, np.array([1.0, 1, -1, -1, 1, -1, 1, -1]), 1.0)
    assert tank.used * 3600.0 == pytest.approx(193.5, rel=0.1)


def test_pings_and_readings_are_those_of_the_truth(pool: World) -> None:
    exact = Conditions(
        imu=replace(ICM_20602, gyro_bias=0.0, accel_bias=0.0, gyro_noise=0.0, accel_noise=0.0),
        dvl=replace(DVL_A50, beam_noise=0.0, scale_error=0.0, dropout=0.0),
        gauge=replace(BAR30, zero=0.0, noise=0.0, density_error=0.0, walk=0.0),
    )
    tank = Tank(pool, conditions=exact, start=SE2(0.0, 0.0, 0.3))
    tank.release()
    swum(tank, AHEAD, 1.0)
    state, ping = tank.state, tank.ping()
    lever = np.array(DVL_A50.position)
    np.testing.assert_allclose(
        ping.dvl.velocity, state.velocity + np.cross(state.angular_velocity, lever), atol=1e-9
    )
    assert state.velocity[0] > 0.1
    assert ping.dvl.time == tank.time < ping.arrives
    gauge = tank.T_world_base @ np.array(BAR30.position)
    tank.advance(AHEAD)
    assert tank.depth.time == 1.0
    assert tank.depth.z == pytest.approx(gauge[2], abs=0.0011)


def test_walls_of_the_pool_hold_it(pool: World) -> None:
    tank = Tank(pool, start=SE2(0.0, 0.0, 0.0))
    tank.release()
    tank.pull((60.0, 0.0, 0.0), 30.0)
    swum(tank, NONE, 30.0)
    assert tank.collisions > 0
    assert tank.T_world_base.translation[0] < 2.3


@pytest.mark.parametrize("bad", [np.zeros(6), np.full(8, math.nan)])
def test_commands_that_do_not_fit_are_refused(pool: World, bad: np.ndarray) -> None:
    with pytest.raises(ValueError, match="expected 8 finite numbers"):
        Tank(pool).advance(bad)


def test_it_starts_at_a_depth_that_is_in_the_water(pool: World) -> None:
    assert Tank(pool, depth=0.25).state.position[2] == pytest.approx(-0.25)
    for depth in (-0.1, 30.0):
        with pytest.raises(ValueError, match="depth: expected 0 to"):
            Tank(pool, depth=depth)
