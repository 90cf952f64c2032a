"""Vehicle, contact and sensors from inside compiled code: the same as one call at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from dream.geometry import SE3
from dream.protocol import DREAM_V1
from dream.sim.sensors import AHRS, BAR30, DVL_A50, ICM_20602
from dream.sim.sensors._kernels import heading, inertial, ping, pressure
from dream.sim.solids import Solids
from dream.sim.vehicle import BLUEROV2_HEAVY, Contact, Current, held
from dream.sim.vehicle._kernels import advance, hold, stir
from tests.sim.arenas import FLOOR, arena, placed

WORLD = Solids(arena(placed(0, [[1.5, 0.0, FLOOR]], [1.0, 8.0, 4.0])))
WATER = Current((0.1, 0.0, 0.0), gust=0.05)
STEPS = 300


def _flight(  # type: ignore[no-untyped-def]
    body, flow, unit, log, gauge, compass, index, radius, height, x, commands, bias, zero, error, rng
):
    gust, pull, contact = np.zeros(2), np.zeros(3), np.zeros(3)
    sample, velocity, covariance, ranges = np.empty(6), np.empty(3), np.empty((3, 3)), np.empty(4)
    found = np.empty((STEPS, 12))
    before = x.copy()
    for i in range(STEPS):
        before[:] = x
        stir(flow, 0.01, rng, gust)
        advance(body, flow, gust, pull, commands, 0.01, x)
        hold(body, index, radius, height, before, x, contact)
        inertial(unit, before, x, 0.01, bias, rng, sample)
        found[i, :6] = sample
        if i % 10 == 0:
            found[i, 6] = pressure(gauge, x, 0.1, zero, rng)
            found[i, 7] = heading(compass, x, 0.1, error, rng)
            found[i, 11] = ping(log, index, x, 0.004, rng, velocity, covariance, ranges)[0]
            found[i, 8:11] = velocity
    return found, contact


flight: Any = njit(cache=False)(_flight)


def test_a_compiled_flight_is_the_flight_of_the_objects() -> None:
    vehicle, start = BLUEROV2_HEAVY, BLUEROV2_HEAVY.at_rest(SE3.level(0.0, 0.0, FLOOR + 2.0, 0.2))
    commands = np.array([0.3, 0.3, -0.3, -0.3, 0.1, 0.1, 0.1, 0.1])
    x, rng = start.vector, np.random.default_rng(12)
    errors: list[Any] = [ICM_20602.begin(rng), BAR30.begin(rng), AHRS.begin(rng)]
    constants = (ICM_20602.constants, DVL_A50.constants, BAR30.constants, AHRS.constants, WORLD.index)
    body: tuple[float, float] = (DREAM_V1.body_radius, DREAM_V1.body_height)
    arguments: list[Any] = [vehicle.body, WATER.flow, *constants, *body, x, commands]
    found, memory = flight(*arguments, *[error.copy() for error in errors], rng)

    rng = np.random.default_rng(12)
    bias, zero, error = ICM_20602.begin(rng), BAR30.begin(rng), AHRS.begin(rng)
    state, contact, gust = start, Contact(), np.zeros(2)
    for i in range(STEPS):
        gust = WATER.stirred(gust, 0.01, rng)
        after = vehicle.step(state, commands, 0.01, WATER, gust=gust)
        after, contact = held(vehicle, WORLD, DREAM_V1, state, after, contact)
        imu, bias = ICM_20602.read(0.01 * i, state, after, bias, rng)
        state = after
        assert np.allclose(found[i, :6], [*imu.angular_velocity, *imu.specific_force], atol=1e-9)
        if i % 10 == 0:
            depth, zero = BAR30.read(0.0, state, zero, rng)
            yaw, error = AHRS.read(0.0, state, error, rng)
            dvl = DVL_A50.ping(0.0, state, WORLD, 0.004, rng).dvl
            expected = [depth.z, yaw.yaw, *dvl.velocity, dvl.altitude]
            assert np.allclose(found[i, 6:], expected, atol=1e-9, equal_nan=True)
    assert np.allclose(x, state.vector, atol=1e-9)
    assert memory.tolist() == [contact.collisions, contact.touching, contact.stuck]
    assert contact.collisions == 1
