"""Sensors of motion: what they read of a known motion, how they err, and where they fall silent."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from dream.geometry import SE3
from dream.sim.sensors import (
    AHRS,
    BAR30,
    DVL_A50,
    DVL_A50_PERFORMANCE,
    ICM_20602,
    Compass,
    Dipole,
    DopplerLog,
    InertialUnit,
    PressureGauge,
)
from dream.sim.solids import Solids
from dream.sim.vehicle import BLUEROV2_HEAVY, Current, State
from dream.sim.world import Terrain
from dream.vehicle import GRAVITY
from tests.sim.arenas import EYE, FLOOR, HALF, arena, flat, placed
from tests.sim.test_solids import all_triangles, slow_range, soup

Array = npt.NDArray[np.float64]

PERFECT_IMU = InertialUnit(gyro_noise=0, accel_noise=0, gyro_bias=0, accel_bias=0, gyro_walk=0, accel_walk=0)
PERFECT_DVL = DopplerLog(scale_error=0, dropout=0, beam_noise=0, max_incidence=1.57, latency_spread=0)
PERFECT_GAUGE = PressureGauge(noise=0, zero=0, walk=0, density_error=0, resolution=1e-6)
PERFECT_COMPASS = Compass(offset=0, iron=0, wander=0, noise=0)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def state(
    position: npt.ArrayLike = (0.0, 0.0, EYE),
    attitude: Rotation | None = None,
    velocity: npt.ArrayLike = (0.0, 0.0, 0.0),
    turning: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> State:
    wxyz = (attitude or Rotation.identity()).as_quat()[[3, 0, 1, 2]]
    return State.of(np.concatenate([position, wxyz, velocity, turning, np.zeros(8)]))


@pytest.fixture(scope="module")
def floor() -> Solids:
    return Solids(arena())


def swim(seconds: float, dt: float) -> list[State]:
    """A lively run of a vehicle."""
    here = BLUEROV2_HEAVY.at_rest(SE3.level(0.0, 0.0, -8.0, 0.4))
    states = [here]
    for i in range(round(seconds / dt)):
        commands = 0.6 * np.sin(0.01 * i * np.arange(1, 9) + np.arange(8))
        here = BLUEROV2_HEAVY.step(here, commands, dt, Current((0.1, 0.05, 0.0)))
        states.append(here)
    return states


# Inertial unit


def test_at_rest_the_unit_reads_minus_gravity_in_its_own_axes() -> None:
    for attitude in (Rotation.identity(), Rotation.from_euler("ZYX", [0.7, -0.3, 0.5])):
        here = state(attitude=attitude)
        imu, _ = PERFECT_IMU.read(1.5, here, here, np.zeros(6), rng())
        assert imu.time == 1.5
        assert np.allclose(imu.angular_velocity, 0.0, atol=1e-12)
        assert np.allclose(imu.specific_force, attitude.inv().apply([0.0, 0.0, GRAVITY]), atol=1e-12)


def test_what_the_unit_reads_carries_the_motion_on() -> None:
    # Strapdown: R⁺ = R Exp(ω dt), v⁺ = v + g dt + R Γ(ω dt) f dt, with Γ by quadrature.
    states = swim(3.0, 0.01)
    R, v = Rotation.from_matrix(states[0].T_world_base.rotation), states[0].velocity_world
    part = (np.arange(200) + 0.5) / 200
    for before, after in pairwise(states):
        imu, _ = PERFECT_IMU.read(0.0, before, after, np.zeros(6), rng())
        turn = imu.angular_velocity * 0.01
        mean = Rotation.from_rotvec(part[:, None] * turn).as_matrix().mean(axis=0)
        v = v + 0.01 * (np.array([0.0, 0.0, -GRAVITY]) + R.as_matrix() @ mean @ imu.specific_force)
        R = R * Rotation.from_rotvec(turn)
    assert np.allclose(v, states[-1].velocity_world, atol=1e-6)
    assert np.allclose(R.as_matrix(), states[-1].T_world_base.rotation, atol=1e-9)


def test_a_spin_is_read_whichever_sign_the_quaternion_has() -> None:
    before = state(attitude=Rotation.from_euler("z", 3.1))
    after = state(attitude=Rotation.from_euler("z", 3.16))
    flipped = replace(after, wxyz=-after.wxyz)
    for end in (after, flipped):
        imu, _ = PERFECT_IMU.read(0.0, before, end, np.zeros(6), rng())
        assert np.allclose(imu.angular_velocity, [0.0, 0.0, 6.0], atol=1e-9)


@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_noise_of_the_unit_has_its_density_at_any_rate(rate: float) -> None:
    unit = replace(ICM_20602, rate=rate, gyro_walk=0.0, accel_walk=0.0)
    here, generator = state(), rng(1)
    reads = [unit.read(0.0, here, here, np.zeros(6), generator)[0] for _ in range(4000)]
    gyro = np.array([imu.angular_velocity for imu in reads])
    accel = np.array([imu.specific_force for imu in reads]) - [0.0, 0.0, GRAVITY]
    for noise, density in ((gyro, math.radians(0.004)), (accel, 100e-6 * GRAVITY)):
        assert np.allclose(noise.std(axis=0), density * math.sqrt(rate), rtol=0.05)
        # White: the mean of n falls with the root of n, as in an Allan plot.
        means = noise.reshape(-1, 16, 3).mean(axis=1)
        assert np.allclose(means.std(axis=0), density * math.sqrt(rate / 16), rtol=0.2)


def test_the_bias_walks_with_the_root_of_time() -> None:
    unit = replace(PERFECT_IMU, gyro_walk=1e-4, accel_walk=1e-3, rate=10.0)
    here, generator = state(), rng(2)
    ends = np.empty((400, 6))
    for i in range(len(ends)):
        bias = np.zeros(6)
        for _ in range(40):
            imu, bias = unit.read(0.0, here, here, bias, generator)
        ends[i] = bias
        assert np.allclose(imu.angular_velocity, bias[:3])
    assert np.allclose(ends[:, :3].std(axis=0), 1e-4 * 2.0, rtol=0.12)
    assert np.allclose(ends[:, 3:].std(axis=0), 1e-3 * 2.0, rtol=0.12)
    first = np.array([ICM_20602.begin(generator) for _ in range(4000)])
    assert np.allclose(first[:, :3].std(axis=0), math.radians(1.0 / 3.0), rtol=0.05)
    assert np.allclose(first[:, 3:].std(axis=0), 0.025 / 3.0 * GRAVITY, rtol=0.05)


def test_beyond_its_range_the_unit_reads_the_end_of_it() -> None:
    before, after = state(), state(attitude=Rotation.from_euler("z", 0.5), velocity=[30.0, -30.0, 0.0])
    imu, _ = ICM_20602.read(0.0, before, after, np.zeros(6), rng())
    assert imu.angular_velocity[2] == math.radians(2000.0)
    assert np.abs(imu.specific_force[:2]).tolist() == [16.0 * GRAVITY] * 2


# Doppler log


def test_over_a_flat_floor_four_beams_give_the_velocity(floor: Solids) -> None:
    here = state(velocity=[0.3, -0.2, 0.1])
    log = replace(PERFECT_DVL, position=(0.0, 0.0, 0.0))
    ping = log.ping(2.0, here, floor, 0.0, rng())
    assert ping.dvl.valid
    assert ping.dvl.time == 2.0
    assert np.allclose(ping.dvl.velocity, [0.3, -0.2, 0.1], atol=1e-12)
    assert ping.dvl.altitude == pytest.approx(EYE - FLOOR)
    distance = (EYE - FLOOR) / math.cos(math.radians(22.5))
    assert np.allclose(ping.ranges, distance)
    # The sound there and back, and 4 ms to reckon.
    assert ping.arrives - 2.0 == pytest.approx(0.004 + 2.0 * distance / 1500.0)


def test_the_log_reads_its_own_velocity_in_its_own_frame(floor: Solids) -> None:
    attitude = Rotation.from_euler("ZYX", [1.0, 0.1, -0.2])
    turning, lever = np.array([0.1, -0.2, 0.5]), np.array([-0.2, 0.1, -0.15])
    log = replace(PERFECT_DVL, position=tuple(lever), yaw=math.radians(90.0))
    here = state(attitude=attitude, velocity=[0.3, -0.2, 0.1], turning=turning)
    at = np.array([0.3, -0.2, 0.1]) + np.cross(turning, lever)
    # Mounted facing left: its forward is our left, its left our backward.
    expected = [at[1], -at[0], at[2]]
    ping = log.ping(0.0, here, floor, 0.0, rng())
    assert np.allclose(ping.dvl.velocity, expected, atol=1e-12)
    assert np.allclose(log.T_base_dvl.rotation.T @ at, expected)
    # Each beam as a ray of the world.
    origin = here.T_world_base @ lever
    ways = log.beams @ (here.T_world_base.rotation @ log.T_base_dvl.rotation).T
    assert np.allclose(ping.ranges, (FLOOR - origin[2]) / ways[:, 2], atol=1e-9)


def slow_ping(
    log: DopplerLog, here: State, triangles: Array, scale: float, generator: np.random.Generator
) -> Array:
    """Velocity by least squares over the beams that the slow ray caster brings back; NaN without lock."""
    T = here.T_world_base @ log.T_base_dvl
    velocity = log.T_base_dvl.rotation.T @ (
        here.velocity + np.cross(here.angular_velocity, log.T_base_dvl.translation)
    )
    rows, along = [], []
    for beam in log.beams:
        luck, error = generator.random(), generator.standard_normal()
        distance, cosine = slow_range(triangles, np.array(T.translation), np.array(T.rotation @ beam))
        height = -beam[2] * distance
        if not log.min_altitude <= height <= log.max_altitude:
            continue
        kept = (1 - log.dropout) * (1 - (height / log.max_altitude) ** 4)
        kept *= max(1 - (math.acos(min(cosine, 1.0)) / log.max_incidence) ** 4, 0.0)
        if luck < kept:
            rows.append(beam)
            along.append(beam @ velocity * (1.0 + scale) + log.beam_noise * error)
    if len(rows) < 3:
        return np.full(3, np.nan)
    return np.asarray(np.linalg.lstsq(np.array(rows), np.array(along), rcond=None)[0])


def test_a_ping_is_that_of_the_slow_twin_in_a_rough_world() -> None:
    world = soup(rng(21), 120)
    solids, triangles = Solids(world), all_triangles(world)
    log = replace(DVL_A50, dropout=0.1, yaw=0.3, max_altitude=6.0, max_incidence=1.2)
    generator, locked, lost = rng(22), 0, 0
    for seed in range(25):
        here = state(
            [*generator.uniform(-HALF, HALF, 2), generator.uniform(FLOOR + 1.5, FLOOR + 5.0)],
            Rotation.from_rotvec(generator.normal(0.0, 0.2, 3)),
            generator.normal(0.0, 0.5, 3),
            generator.normal(0.0, 0.3, 3),
        )
        ping = log.ping(0.0, here, solids, 0.005, rng(seed))
        slow = slow_ping(log, here, triangles, 0.005, rng(seed))
        assert np.allclose(ping.dvl.velocity, slow, atol=1e-6, equal_nan=True)
        assert ping.dvl.valid == bool(np.isfinite(slow).all())
        locked, lost = locked + ping.dvl.valid, lost + (not ping.dvl.valid)
    assert min(locked, lost) > 2


def test_noise_of_the_log_is_what_its_covariance_says(floor: Solids) -> None:
    here, generator = state(velocity=[0.4, 0.1, 0.0]), rng(3)
    log = replace(DVL_A50, dropout=0.0, max_incidence=1.57)
    pings = [log.ping(0.0, here, floor, 0.0, generator) for _ in range(4000)]
    four = [ping.dvl for ping in pings if np.isfinite(ping.ranges).all()]
    errors = np.array([dvl.velocity for dvl in four]) - [0.4, 0.1, 0.0]
    covariance = four[0].covariance
    sine, cosine = math.sin(math.radians(22.5)), math.cos(math.radians(22.5))
    closed = np.array([1 / (2 * sine**2), 1 / (2 * sine**2), 1 / (4 * cosine**2)])
    assert np.allclose(covariance, 0.003**2 * np.diag(closed), atol=1e-12)
    assert np.allclose(np.cov(errors.T), covariance, atol=0.08 * covariance.max())
    assert np.abs(errors.mean(axis=0)).max() < 4 * math.sqrt(covariance.max() / len(errors))


def test_three_beams_keep_the_lock_and_two_lose_it(floor: Solids) -> None:
    log = replace(DVL_A50, dropout=0.3)
    here, generator, counts = state(velocity=[0.3, 0.0, 0.0]), rng(4), np.zeros(5, int)
    for _ in range(600):
        ping = log.ping(0.0, here, floor, 0.0, generator)
        back = int(np.isfinite(ping.ranges).sum())
        counts[back] += 1
        assert ping.dvl.valid == (back >= 3)
        assert np.isfinite(ping.dvl.velocity).all() == ping.dvl.valid
        assert np.isfinite(ping.dvl.covariance).all() == ping.dvl.valid
        assert math.isnan(ping.dvl.altitude) == (back == 0)
        if back == 3:
            # One beam less: the covariance grows, and still fits.
            eigenvalues = np.linalg.eigvalsh(ping.dvl.covariance)
            assert eigenvalues.min() > 0.0
            assert eigenvalues.max() > 0.003**2 / (2 * math.sin(math.radians(22.5)) ** 2)
            assert np.linalg.norm(ping.dvl.velocity - [0.3, 0.0, 0.0]) < 6 * math.sqrt(eigenvalues.max())
    # 0.7⁴, 4 · 0.7³ · 0.3, ... but for the few that the incidence takes.
    assert np.allclose(counts[[4, 3, 2]] / 600, [0.24, 0.41, 0.265], atol=0.08)


def test_beams_are_lost_over_a_hole_and_beyond_the_range() -> None:
    ground = flat()
    heights = ground.heights.copy()
    x = ground.x0 + ground.spacing * np.arange(heights.shape[1])
    heights[:, x > 0.0] = FLOOR - 60.0
    solids = Solids(arena(terrain=replace(ground, heights=heights)))
    generator = rng(5)
    log = replace(PERFECT_DVL, position=(0.0, 0.0, 0.0))
    before = log.ping(0.0, state([-3.0, 0.0, EYE]), solids, 0.0, generator)
    edge = log.ping(0.0, state([0.25, 0.0, EYE]), solids, 0.0, generator)
    over = log.ping(0.0, state([6.0, 0.0, EYE]), solids, 0.0, generator)
    assert before.dvl.valid
    # At the edge the two front beams fall into the hole.
    assert np.isfinite(edge.ranges).tolist() == [False, True, True, False]
    assert not edge.dvl.valid
    assert edge.dvl.altitude == pytest.approx(EYE - FLOOR)
    assert not np.isfinite(over.ranges).any()
    assert math.isnan(over.dvl.altitude)
    assert over.arrives == pytest.approx(0.004)


def test_too_near_and_too_far_there_is_no_lock() -> None:
    heights = np.full((400, 400), -60.0, np.float32)
    solids = Solids(arena(terrain=Terrain(heights, -100.0, -100.0, 0.5)))
    log = replace(PERFECT_DVL, position=(0.0, 0.0, 0.0))
    locked = {}
    for altitude in (0.04, 0.06, 30.0, 49.0, 50.5):
        pings = [log.ping(0.0, state([0, 0, altitude - 60.0]), solids, 0.0, rng(s)).dvl for s in range(100)]
        locked[altitude] = np.mean([dvl.valid for dvl in pings])
    assert locked[0.04] == locked[50.5] == 0.0
    assert locked[0.06] > 0.95
    assert locked[30.0] > 0.85
    # Echoes get faint before they end.
    assert locked[49.0] < 0.3


def test_slanting_ground_loses_more_beams(floor: Solids) -> None:
    def lost(pitch: float) -> float:
        here = state(attitude=Rotation.from_euler("y", pitch))
        pings = [DVL_A50.ping(0.0, here, floor, 0.0, rng(s)) for s in range(200)]
        return float(np.mean([np.isnan(ping.ranges).mean() for ping in pings]))

    shares = [lost(pitch) for pitch in (0.0, 0.5, 0.9)]
    assert shares[0] < 0.05
    assert shares[0] < shares[1] < shares[2]


def test_a_wreck_below_is_ground_to_the_log() -> None:
    solids = Solids(arena(placed(0, [[0.0, 0.0, FLOOR]], [4.0, 4.0, 1.0])))
    log = replace(PERFECT_DVL, position=(0.0, 0.0, 0.0))
    ping = log.ping(0.0, state(), solids, 0.0, rng())
    assert ping.dvl.altitude == pytest.approx(EYE - FLOOR - 1.0)


def test_faster_than_its_limit_the_log_is_not_valid(floor: Solids) -> None:
    for speed, valid in ((3.7, True), (3.8, False)):
        ping = PERFECT_DVL.ping(0.0, state(velocity=[speed, 0.0, 0.0]), floor, 0.0, rng())
        assert ping.dvl.valid == valid
        assert np.isfinite(ping.dvl.velocity).all() == valid
        assert np.isfinite(ping.ranges).all()


def test_the_scale_error_is_one_number_a_mission(floor: Solids) -> None:
    here = state(velocity=[0.5, 0.0, 0.0])
    ping = replace(PERFECT_DVL, dropout=0.0).ping(0.0, here, floor, 0.008, rng())
    assert np.allclose(ping.dvl.velocity, [0.504, 0.0, 0.0])
    for log, most in ((DVL_A50, 0.01), (DVL_A50_PERFORMANCE, 0.001)):
        drawn = np.array([log.begin(rng(seed)) for seed in range(400)])
        assert np.abs(drawn).max() <= most
        assert drawn.std() == pytest.approx(most / math.sqrt(3.0), rel=0.1)


def test_the_log_pings_slower_the_higher_it_is() -> None:
    found = [DVL_A50.rate(altitude) for altitude in (0.3, 2.0, 10.0, 30.0, 45.0, 80.0, math.nan)]
    assert found == [15.0, 10.0, 5.0, 7.0, 2.0, 2.0, 2.0]


# Pressure


def test_the_gauge_reads_its_own_height() -> None:
    here = state([1.0, 2.0, -5.0], Rotation.from_euler("y", 0.3))
    gauge = replace(PERFECT_GAUGE, position=(-0.2, 0.0, 0.1))
    depth, _ = gauge.read(3.0, here, np.zeros(2), rng())
    assert depth.time == 3.0
    assert depth.z == pytest.approx(-5.0 + 0.2 * math.sin(0.3) + 0.1 * math.cos(0.3), abs=1e-6)


def test_the_gauge_reads_in_steps_with_its_noise() -> None:
    generator = rng(6)
    reads = np.array([BAR30.read(0.0, state(), np.zeros(2), generator)[0].z for _ in range(4000)])
    assert np.allclose(reads / 0.002, np.round(reads / 0.002), atol=1e-6)
    assert reads.std() == pytest.approx(BAR30.sigma, rel=0.05)
    assert reads.mean() == pytest.approx(EYE, abs=4 * BAR30.sigma / math.sqrt(4000))


def test_the_zero_of_the_gauge_walks_and_its_scale_stays() -> None:
    gauge = replace(PERFECT_GAUGE, walk=0.001, rate=10.0)
    generator, ends = rng(7), []
    for _ in range(400):
        error = np.array([0.0, 0.01])
        for _ in range(40):
            depth, error = gauge.read(0.0, state(), error, generator)
        assert error[1] == 0.01
        assert depth.z == pytest.approx(1.01 * EYE + error[0], abs=1e-6)
        ends.append(error[0])
    assert np.std(ends) == pytest.approx(0.002, rel=0.12)
    first = np.array([BAR30.begin(generator) for _ in range(4000)])
    assert np.allclose(first.std(axis=0), [0.01, 0.002], rtol=0.06)


def test_in_air_and_beyond_its_range_the_gauge_reads_the_end_of_it() -> None:
    assert PERFECT_GAUGE.read(0.0, state([0, 0, 0.4]), np.zeros(2), rng())[0].z == 0.0
    assert PERFECT_GAUGE.read(0.0, state([0, 0, -400.0]), np.zeros(2), rng())[0].z == pytest.approx(-300.0)


# Compass


@pytest.mark.parametrize("yaw", [0.0, 1.0, math.pi / 2, 3.0, math.pi, -1.5, -3.1])
def test_without_errors_the_compass_reads_the_yaw(yaw: float) -> None:
    here = state(attitude=Rotation.from_euler("ZYX", [yaw, 0.2, -0.3]))
    heading, _ = PERFECT_COMPASS.read(4.0, here, np.zeros(4), rng())
    assert heading.time == 4.0
    assert heading.yaw == pytest.approx(yaw, abs=1e-9)
    assert -math.pi < heading.yaw <= math.pi


def test_own_iron_errs_once_around_the_compass() -> None:
    errors = []
    for yaw in np.linspace(-3.0, 3.0, 25):
        here = state(attitude=Rotation.from_euler("z", yaw))
        heading, _ = PERFECT_COMPASS.read(0.0, here, np.array([0.0, 0.0, 0.05, 0.0]), rng())
        # Iron ahead pulls north towards the bow: by 0.05 facing east or west, by nothing facing north.
        assert heading.yaw - yaw == pytest.approx(0.05 * math.cos(yaw), abs=2e-3)
        errors.append(heading.yaw - yaw)
    assert max(errors) > 0.04
    assert min(errors) < -0.04


def test_errors_of_the_compass_have_their_sizes_and_their_memory() -> None:
    compass = replace(AHRS, rate=1.0, wander_time=4.0)
    generator = rng(8)
    first = np.array([compass.begin(generator) for _ in range(4000)])
    expected = [compass.offset, compass.wander, compass.iron, compass.iron]
    assert np.allclose(first.std(axis=0), expected, rtol=0.06)
    error, found, read = np.zeros(4), [], []
    for _ in range(8000):
        heading, error = compass.read(0.0, state(), error, generator)
        found.append(error[1])
        read.append(heading.yaw - error[1])
    wander = np.array(found)
    assert wander.std() == pytest.approx(compass.wander, rel=0.12)
    assert np.mean(wander[:-4] * wander[4:]) / compass.wander**2 == pytest.approx(math.exp(-1.0), abs=0.1)
    assert np.std(read) == pytest.approx(compass.noise, rel=0.06)
    assert heading.sigma == pytest.approx(math.sqrt(sum(v**2 for v in expected[:3]) + compass.noise**2))


def test_steel_nearby_turns_the_needle_and_far_away_does_not() -> None:
    # A magnet along east, north of the vehicle by r: its field there is −m / r³, westwards.
    compass = replace(PERFECT_COMPASS, steel=(Dipole((0.0, 3.0, EYE), (2.7, 0.0, 0.0)),))
    near, _ = compass.read(0.0, state(), np.zeros(4), rng())
    # North appears to lie west of north, so that the bow seems farther from it: to the right.
    assert near.yaw == pytest.approx(-math.atan(0.1), abs=1e-9)
    far, _ = compass.read(0.0, state([0.0, -60.0, EYE]), np.zeros(4), rng())
    assert abs(far.yaw) < 1e-4
    inside, _ = compass.read(0.0, state([0.0, 3.0, EYE]), np.zeros(4), rng())
    assert math.isfinite(inside.yaw)
    # On the axis it is twice as strong: a magnet along north, north of the vehicle, only strengthens north.
    ahead = replace(PERFECT_COMPASS, steel=(Dipole((3.0, 0.0, EYE), (2.7, 0.0, 0.0)),))
    axial, _ = ahead.read(0.0, state(), np.zeros(4), rng())
    assert axial.yaw == pytest.approx(math.atan(0.2), abs=1e-9)


# All


def test_the_same_seed_reads_the_same_and_another_does_not(floor: Solids) -> None:
    here = state(velocity=[0.3, 0.1, 0.0])

    def reads(seed: int) -> Array:
        generator = rng(seed)
        imu, _ = ICM_20602.read(0.0, here, here, ICM_20602.begin(generator), generator)
        ping = DVL_A50.ping(0.0, here, floor, DVL_A50.begin(generator), generator)
        depth, _ = BAR30.read(0.0, here, BAR30.begin(generator), generator)
        heading, _ = AHRS.read(0.0, here, AHRS.begin(generator), generator)
        return np.array(
            [*imu.angular_velocity, *imu.specific_force, *ping.ranges, depth.z, heading.yaw, ping.arrives]
        )

    assert np.array_equal(reads(1), reads(1), equal_nan=True)
    assert not np.isclose(reads(1), reads(2), rtol=0.0, atol=1e-12)[[0, 5, -1, -2]].any()


def test_a_state_that_is_not_finite_is_refused(floor: Solids) -> None:
    good = state()
    bad = replace(good, position=np.array([0.0, np.nan, 0.0]))
    with pytest.raises(ValueError, match="state: expected"):
        ICM_20602.read(0.0, good, bad, np.zeros(6), rng())
    with pytest.raises(ValueError, match="state: expected"):
        DVL_A50.ping(0.0, bad, floor, 0.0, rng())
    with pytest.raises(ValueError, match="state: expected"):
        BAR30.read(0.0, bad, np.zeros(2), rng())
    with pytest.raises(ValueError, match="state: expected"):
        AHRS.read(0.0, bad, np.zeros(4), rng())


def test_parameters_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match=r"imu\.rate: expected a number above 0, got 0"):
        replace(ICM_20602, rate=0.0)
    with pytest.raises(ValueError, match=r"dvl\.dropout: expected a probability, got 1\.5"):
        replace(DVL_A50, dropout=1.5)
    with pytest.raises(ValueError, match=r"dvl\.max_altitude: expected more than"):
        replace(DVL_A50, max_altitude=0.01)
    with pytest.raises(ValueError, match=r"pressure\.noise: expected 0 or more"):
        replace(BAR30, noise=-1.0)
    with pytest.raises(ValueError, match=r"compass\.wander_time"):
        replace(AHRS, wander_time=math.nan)
