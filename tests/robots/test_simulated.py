"""A robot that has to swim: what it knows, and what happens when it does not."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dream.control import _kernels as control
from dream.control.autopilot import Autopilot, nominal
from dream.control.health import Watch
from dream.errors import MissionAborted
from dream.estimation import InEkf
from dream.geometry import SE2, wrap_angle
from dream.protocol import DREAM_V1, DREAM_V1_NAV, DREAM_V2_NAV, DREAM_V2_TRUE, SurveyProtocol
from dream.robots import Motion, Simulated, _kernels
from dream.robots.simulated import BEAT
from dream.robots.teleport import launch_height
from dream.sim.render import Renderer
from dream.sim.sensors import AHRS, BAR30, DVL_A50, ICM_20602, Bursts, Outage
from dream.sim.solids import Solids
from dream.sim.vehicle import BLUEROV2, BLUEROV2_HEAVY, Spread, Vehicle
from dream.sim.world import World
from dream.types import Arrival, Setpoint
from tests.robots.slowly import Slow

CALM = Motion(current=0.0, gust=0.0)
IN_SPACE = replace(DREAM_V2_TRUE, name="swims-in-space", swims=True)
"""With a sensor and a gauge that have no lasting errors."""
SQUARE = [(2.0, 0.0), (0.0, 2.0), (-2.0, 0.0), (0.0, -2.0)]


def swum(robot: Simulated, *moves: tuple[float, float], turn: float = 0.0) -> list[Arrival]:
    """What came of moves by so many metres east and north, each turned by so much from the last."""
    here, arrivals = DREAM_V1.snap(robot.observe().pose), []
    x, y, yaw = here.x, here.y, here.yaw
    for east, north in moves:
        x, y, yaw = x + east, y + north, wrap_angle(yaw + turn)
        arrivals.append(robot.go_to(Setpoint(x, y, yaw, DREAM_V1.altitude)))
    return arrivals


def truly(arrival: Arrival) -> SE2:
    assert arrival.truth is not None
    return arrival.truth.se2


@pytest.mark.parametrize("start", [SE2(0.0, 0.0, 0.0), SE2(1.0, -2.0, 2.0)])
def test_it_stays_near_its_way_in_a_current_and_knows_how_well(empty_world: World, start: SE2) -> None:
    robot = Simulated(empty_world, DREAM_V1_NAV, start, motion=Motion(current=0.2))
    for _ in range(3):
        arrivals = swum(robot, *SQUARE, turn=math.pi / 2)
        assert arrivals[-1].sigma == pytest.approx(_kernels.position_sigma(robot._state))
        for arrival in arrivals:
            # One percent of scale that no filter here can see comes on top.
            assert truly(arrival).distance(arrival.pose) < 4.0 * arrival.sigma + 0.01 * 24.0
            assert not arrival.collided
    assert robot.observe().time > 12 * 4.0


def test_what_it_sees_is_drawn_from_where_it_is(string_reef: World) -> None:
    robot = Simulated(string_reef, replace(DREAM_V1, name="swims", swims=True))
    swum(robot, (1.0, 0.0), (0.0, -1.0))
    seen = robot.observe()
    frame = Renderer(string_reef).render(DREAM_V1.camera, robot.truth @ DREAM_V1.T_base_camera)
    np.testing.assert_array_equal(seen.labels, frame.labels)
    assert seen.T_world_base.translation.tolist() == robot.estimate.position.tolist()
    assert seen.pose.distance(robot.truth.se2) > 1e-4


def test_the_same_mission_swims_alike_and_another_start_otherwise(empty_world: World) -> None:
    def track(start: SE2) -> list[float]:
        robot = Simulated(empty_world, DREAM_V1_NAV, start)
        ends = [truly(arrival) for arrival in swum(robot, *SQUARE)]
        return [value for end in ends for value in (end.x - start.x, end.y - start.y)]

    here = SE2(0.0, 0.0, 0.0)
    assert track(here) == track(here)
    assert track(here) != track(SE2(1.0, 0.0, 0.0))


def test_the_seabed_is_followed(string_reef: World) -> None:
    robot = Simulated(string_reef, DREAM_V1_NAV, motion=CALM)
    heights = []
    for arrival in swum(robot, *[(1.0, 0.0)] * 6):
        assert arrival.truth is not None
        x, y, z = arrival.truth.translation.tolist()
        heights.append(z - float(string_reef.terrain.height(x, y)))
    assert max(abs(height - DREAM_V1.altitude) for height in heights) < 0.2


def height(robot: Simulated) -> float:
    return float(robot.truth.translation[2])


def test_in_space_it_leads_straight_to_a_height_and_says_how_far_that_was(string_reef: World) -> None:
    """Over ground that is not flat; depth is held by the pressure, which is good to a few centimetres."""
    robot = Simulated(string_reef, DREAM_V2_NAV, motion=Motion(current=0.2))
    here = robot.observe()
    assert here.z / DREAM_V2_NAV.lattice == pytest.approx(round(2.0 * here.z), abs=0.05)
    x, y, z, yaw = here.pose.x, here.pose.y, round(2.0 * here.z) / 2.0, here.pose.yaw
    for ahead, climb in ((0.0, 1.0), (2.0, 1.0), (2.0, -0.5), (0.0, -1.0)):
        begun = robot.truth.translation.copy()
        x, y, z = x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), z + climb
        arrival = robot.go_to(Setpoint(x, y, yaw, None, z))
        assert not arrival.collided
        assert abs(robot.observe().z - z) < robot._motion.near
        assert height(robot) == pytest.approx(z, abs=0.1)
        length = float(np.linalg.norm(robot.truth.translation - begun))
        assert length > 0.9 * math.hypot(ahead, climb)
        assert length <= arrival.distance < 1.15 * length + 0.05


def test_in_space_the_way_is_straight(empty_world: World) -> None:
    robot = Simulated(empty_world, DREAM_V2_NAV, SE2(0.0, 0.0, 0.0), motion=CALM)
    start, rows = robot.truth.translation.copy(), np.full((1000, 9), np.nan)
    goal, motion = start + np.array([2.0, 0.0, 1.0]), robot._motion
    how = _kernels.fly(
        robot._ship,
        robot._voyage,
        robot._state,
        robot._at_ping,
        np.array([goal[0], goal[1], 0.0]),
        math.nan,
        float(goal[2]),
        10.0,
        motion.near,
        motion.aligned,
        motion.slow,
        0.3,
        robot._rng,
        rows,
    )[2]
    assert how == _kernels.ARRIVED
    flown = rows[~np.isnan(rows[:, 0])][:, 1:4] - start
    way = (goal - start) / np.linalg.norm(goal - start)
    aside = flown - np.outer(flown @ way, way)
    assert np.linalg.norm(aside, axis=1).max() < 0.1
    assert np.linalg.norm(np.diff(flown, axis=0), axis=1).max() / BEAT < 1.2 * motion.helmsman.speed


def test_the_camera_is_tilted_when_it_arrives_and_stays_so(string_reef: World) -> None:
    robot = Simulated(string_reef, IN_SPACE)
    here, z = robot.observe().pose, round(2.0 * robot.observe().z) / 2.0
    tilts = []
    for tilt in (None, math.radians(45.0), None, math.radians(-25.0)):
        robot.go_to(Setpoint(here.x, here.y, here.yaw, None, z, tilt))
        seen = robot.observe()
        tilts.append(round(math.degrees(seen.tilt)))
        frame = Renderer(string_reef).render(seen.camera, robot.truth @ seen.T_base_camera)
        np.testing.assert_array_equal(seen.rgb, frame.rgb)
    assert tilts == [20, 45, 45, -25]


def test_in_space_it_touches_what_is_below_and_stops(string_reef: World) -> None:
    """A boulder that it passes over at a height, and comes down upon."""
    tall = np.argmax(string_reef.obstacles.scale[:, 2])
    x, y = map(float, string_reef.obstacles.position[tall, :2])
    robot = Simulated(string_reef, DREAM_V2_NAV, SE2(x - 4.0, y, 0.0), motion=CALM)
    low, high = robot.observe().z, robot.observe().z + 3.0
    assert robot.go_to(Setpoint(x, y, 0.0, None, low)).collided
    assert not robot.go_to(Setpoint(x - 4.0, y, 0.0, None, low)).collided
    for east in (-4.0, 0.0):
        assert not robot.go_to(Setpoint(x + east, y, 0.0, None, high)).collided
    down = robot.go_to(Setpoint(x, y, 0.0, None, low))
    assert down.collided
    assert down.clearance == 0.0
    assert low + 0.1 < height(robot) < high
    assert math.hypot(*(robot.truth.translation[:2] - [x, y])) < 0.3


def test_in_space_one_that_is_lost_holds_its_height_too(empty_world: World) -> None:
    """The way up was looked at as a whole: a climb on the spot is another."""
    deaf = replace(DVL_A50, dropout=1.0)
    motion = replace(CALM, dvl=deaf, watch=Watch(blind=1.0, lost=4.0, position_sigma=1.0))
    robot = Simulated(empty_world, DREAM_V2_NAV, motion=motion)
    here = robot.observe()
    with pytest.raises(MissionAborted, match="diverged"):
        robot.go_to(Setpoint(here.pose.x + 10.0, here.pose.y, 0.0, None, here.z + 5.0))
    # By its belief, before it surfaced without one.
    assert abs(robot.estimate.position[2] - here.z) < 0.5


def test_without_bottom_track_it_slows_then_holds_and_at_last_surfaces(empty_world: World) -> None:
    """By name: nothing of it is silent."""
    deaf = replace(DVL_A50, dropout=1.0)
    watch = Watch(blind=1.0, lost=4.0, position_sigma=1.0)
    robot = Simulated(empty_world, DREAM_V1_NAV, motion=replace(CALM, dvl=deaf, watch=watch))
    with pytest.raises(MissionAborted, match=r"navigation: diverged; the vehicle surfaced: it is 0\.3 m"):
        swum(robot, *[(10.0, 0.0)] * 5)
    # It held, by its belief, from the fourth second on: ten metres take twenty.
    assert robot.estimate.pose.se2.distance(SE2(0.0, 0.0, 0.0)) < 5.0


@pytest.mark.parametrize("vehicle", [BLUEROV2, BLUEROV2_HEAVY])
@pytest.mark.parametrize("end", [0, 1])
def test_it_rises_without_an_estimate_level_and_at_its_speed(
    vehicle: Vehicle, end: int, empty_world: World
) -> None:
    factor = vehicle.damping[end]
    motion = Motion(vehicle=vehicle, spread=Spread(damping=(factor, factor)), gust=0.0)
    robot = Simulated(empty_world, DREAM_V1_NAV, motion=motion)
    robot._state = nonsense(robot._state)
    deep, at = -robot.truth.translation[2], robot.truth.translation.copy()
    with pytest.raises(MissionAborted, match="navigation: diverged; the vehicle surfaced"):
        robot.go_to(Setpoint(at[0] + 5.0, at[1], 0.0, DREAM_V1.altitude))
    seconds = robot._voyage.clock[_kernels.TIME]
    assert -robot.truth.translation[2] < 0.5
    assert deep / seconds == pytest.approx(motion.autopilot.ascent, rel=0.15)
    # What carried it aside is the current, not its thrusters.
    assert np.hypot(*(robot.truth.translation - at)[:2]) < 1.1 * motion.current * seconds
    # Six thrusters right only the roll.
    assert robot.truth.rotation[2, 2] > math.cos(math.radians(2.0 if vehicle is BLUEROV2_HEAVY else 10.0))


def test_on_the_way_up_only_the_vertical_thrusters_work(empty_world: World) -> None:
    """Whatever the accelerometers say: no thrust along the hull, and no turn."""
    rng, commands, pilot = np.random.default_rng(0), np.zeros(8), Autopilot()
    chosen = nominal(BLUEROV2_HEAVY.hull, BLUEROV2_HEAVY.thrusters)
    for force in (np.full(3, math.nan), *(np.array([0.0, 0.0, 9.8]) + rng.normal(0.0, 1.0, (20, 3)))):
        for climb in (math.nan, -0.1, 0.3):
            control.rise(rng.normal(0.0, 0.1, 3), force, climb, 0.4, pilot.gains, chosen, commands)
            wrench = BLUEROV2_HEAVY.thrusters.allocation @ BLUEROV2_HEAVY.thrusters.forces(commands)
            np.testing.assert_allclose(wrench[[0, 1, 5]], 0.0, atol=1e-9)
            heave = 32.18 * (control.CLIMBING * (pilot.ascent - climb) + control.CATCHING_UP * 0.4)
            if math.isnan(climb):
                heave = pilot.drag_share * (33.0 + 190.0 * pilot.ascent) * pilot.ascent
            assert wrench[2] == pytest.approx(heave - 1.0)
            if math.isnan(force[0]):
                np.testing.assert_allclose(wrench[3:5], 0.0, atol=1e-9)


def nonsense(state: Any) -> Any:
    """An estimate that is nowhere, upside down and fast, and does not know how well it knows that."""
    wrong, upside_down = np.full(3, 99.0), np.diag([1.0, -1.0, -1.0])
    unknown = np.full((15, 15), math.nan)
    return state._replace(position=wrong, velocity=wrong, rotation=upside_down, covariance=unknown)


def test_what_cannot_surface_says_how_deep_it_is(empty_world: World) -> None:
    """Ballast that outweighs its thrusters."""
    heavy = Spread(damping=(1.0, 1.0), trim=0.0, net_buoyancy=(-300.0, -300.0))
    watch = Watch(position_sigma=0.001)
    robot = Simulated(empty_world, DREAM_V1_NAV, motion=replace(CALM, spread=heavy, watch=watch))
    with pytest.raises(MissionAborted, match=r"the vehicle could not surface: it is \d+\.\d m deep after"):
        robot.go_to(Setpoint(5.0, 0.0, 0.0, DREAM_V1.altitude))


def test_a_short_loss_of_bottom_track_is_told_and_survived(empty_world: World) -> None:
    robot = Simulated(empty_world, DREAM_V1_NAV, motion=CALM)
    swum(robot, (1.0, 0.0))
    ship = robot._ship
    robot._ship = ship._replace(acoustic=replace(DVL_A50, dropout=1.0).constants)
    (blind,) = swum(robot, (1.0, 0.0))
    assert blind.note == "no bottom track for a while: it went slowly"
    robot._ship = ship
    (_, well) = swum(robot, (1.0, 0.0), (1.0, 0.0))
    assert well.note == ""
    assert truly(well).distance(well.pose) < 0.3


def flight(world: World, *outages: Outage, moves: int = 3, **changes: Any) -> list[Arrival]:
    """Moves of two metres while sensors are silent."""
    motion = replace(CALM, outages=outages, **changes)
    return swum(Simulated(world, DREAM_V1_NAV, motion=motion), *[(2.0, 0.0)] * moves)


def test_a_vehicle_that_is_blind_and_lost_goes_on_where_the_dvl_comes_back(empty_world: World) -> None:
    first, second, third = flight(empty_world, Outage("dvl", 8.0, 6.0), watch=Watch(lost=4.0))
    assert (first.note, third.note) == ("", "")
    assert second.note == "no bottom track for long: it held"
    for before, after in ((first, second), (second, third)):
        assert after.pose.distance(before.pose) == pytest.approx(2.0, abs=0.11)
    _, blind, _ = flight(empty_world, Outage("dvl", 8.0, 2.0))
    assert blind.note == "no bottom track for a while: it went slowly"


@pytest.mark.parametrize(
    ("silent", "name"),
    [
        (Outage("imu", 3.0), "stale"),
        (Outage("imu", 3.0, 0.5), "stale"),
        (Outage("dvl", 3.0), "diverged"),
    ],
)
def test_a_sensor_that_stays_silent_ends_the_mission_by_its_name_at_the_surface(
    silent: Outage, name: str, empty_world: World
) -> None:
    watch = Watch(position_sigma=1.0)
    with pytest.raises(
        MissionAborted, match=rf"navigation: {name}; the vehicle surfaced: it is 0\.\d m deep"
    ):
        flight(empty_world, silent, watch=watch, moves=20)


@pytest.mark.parametrize("sensor", ["imu", "dvl", "depth", "compass"])
def test_a_short_silence_is_borne(sensor: Any, empty_world: World) -> None:
    for arrival in flight(empty_world, Outage(sensor, 3.0, 0.1), Outage(sensor, 9.0, 0.1)):
        assert arrival.note == ""
        assert truly(arrival).distance(arrival.pose) < 0.1


def test_a_dvl_that_loses_the_bottom_in_bursts_is_borne_and_told(empty_world: World) -> None:
    notes = set()
    for arrival in flight(empty_world, dvl_bursts=Bursts(share=0.3, lasts=2.0), moves=10):
        notes.add(arrival.note)
        assert truly(arrival).distance(arrival.pose) < 4.0 * arrival.sigma + 0.01 * 20.0
    assert notes == {"", "no bottom track for a while: it went slowly"}


def test_a_contact_is_felt_so_that_the_estimate_outlasts_it(string_reef: World) -> None:
    tall = np.argmax(string_reef.obstacles.scale[:, 2])
    x, y = map(float, string_reef.obstacles.position[tall, :2])
    robot = Simulated(string_reef, DREAM_V1_NAV, SE2(x - 4.0, y, 0.0), motion=CALM)
    for _ in range(2):
        arrival = robot.go_to(Setpoint(x, y, 0.0, DREAM_V1.altitude))
        assert arrival.collided
        truth = robot._voyage.x
        speed = robot.truth.rotation @ truth[7:10]
        assert robot.estimate.time == pytest.approx(robot._voyage.clock[_kernels.TIME])
        assert np.linalg.norm(robot.estimate.velocity - speed) < 0.05
        assert truly(arrival).distance(arrival.pose) < 0.1
    back = robot.go_to(Setpoint(x - 4.0, y, 0.0, DREAM_V1.altitude))
    assert not back.collided
    assert truly(back).distance(back.pose) < 0.15


def test_what_it_hands_out_is_no_part_of_it(empty_world: World) -> None:
    robot = Simulated(empty_world, DREAM_V1_NAV)
    before = robot.estimate.position.copy()
    robot.observe().T_world_base.translation[:] += 5.0
    robot.truth.translation[:] += 5.0
    np.testing.assert_array_equal(robot.estimate.position, before)
    assert robot.truth.se2.distance(robot.observe().pose) < 1.0


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        ({"current": -1.0}, "current: expected"),
        ({"near": math.nan}, "near: expected"),
        ({"slow": 0.0}, "slow: expected"),
        ({"compass": replace(AHRS, rate=500.0)}, r"compass.rate: expected a part of 100 Hz, got 500"),
        ({"gauge": replace(BAR30, rate=30.0)}, r"gauge.rate: expected a part of 100 Hz, got 30"),
        ({"imu": replace(ICM_20602, rate=200.0)}, r"imu.rate: expected 100 Hz"),
    ],
)
def test_what_cannot_swim_is_refused_by_name(wrong: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Motion(**wrong)


def test_a_beat_of_the_loop_is_the_filter_of_the_package(empty_world: World) -> None:
    """`carried` is `InEkf.predict` and `correct`."""
    from dream.estimation import InEkfState
    from dream.measurements import Depth, Heading, Imu

    robot = Simulated(empty_world, DREAM_V1_NAV)
    swum(robot, (1.0, 0.0))
    filtering: InEkf = robot._motion.estimator
    before, rng = robot.estimate, np.random.default_rng(0)
    gyro, force = rng.normal(0.0, 0.1, 3), np.array([0.1, 0.0, 9.8])
    z, yaw = float(before.position[2]) + 0.02, before.pose.yaw + 0.01
    sample = np.array([*gyro, *force, z, yaw])
    after = InEkfState(*_kernels.carried(robot._ship, before.packed, sample))
    slow = filtering.predict(before, Imu(before.time + BEAT, gyro, force), BEAT)
    slow = filtering.correct(slow, Depth(slow.time, z, robot._ship.depth_sigma))
    slow = filtering.correct(slow, Heading(slow.time, yaw, robot._ship.heading_sigma))
    for name in ("rotation", "velocity", "position", "gyro_bias", "covariance"):
        np.testing.assert_allclose(getattr(after, name), getattr(slow, name), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(
    ("protocol", "latency", "climb"),
    [(DREAM_V1_NAV, 0.004, None), (DREAM_V1_NAV, 0.2, None), (IN_SPACE, 0.004, 0.5)],
)
def test_the_compiled_loop_is_the_objects_one_after_another(
    empty_world: World, protocol: SurveyProtocol, latency: float, climb: float | None
) -> None:
    start, goal = SE2(1.0, -2.0, 0.5 * math.pi), SE2(1.6, -2.3, 2.0)
    motion, solids = Motion(dvl=replace(DVL_A50, latency=latency)), Solids(empty_world)
    robot = Simulated(empty_world, protocol, start, motion=motion, solids=solids)
    slow = Slow(empty_world, protocol, start, motion, solids)
    altitude = DREAM_V1.altitude if climb is None else None
    z = None if climb is None else launch_height(empty_world, protocol, start) + climb
    robot.go_to(Setpoint(goal.x, goal.y, goal.yaw, altitude, z))
    for _ in range(round(robot._voyage.clock[_kernels.TIME] / BEAT)):
        slow.beat(goal, z)
    assert slow.beats > 200
    np.testing.assert_allclose(robot._voyage.x, slow.state.vector, rtol=0.0, atol=1e-10)
    for name in ("rotation", "velocity", "position", "gyro_bias", "accelerometer_bias", "covariance"):
        np.testing.assert_allclose(
            getattr(robot.estimate, name), getattr(slow.estimate, name), rtol=0.0, atol=1e-10
        )


def test_a_start_outside_or_in_the_wall_is_refused(string_reef: World) -> None:
    with pytest.raises(ValueError, match="start: expected a pose inside"):
        Simulated(string_reef, DREAM_V1_NAV, SE2(100.0, 0.0, 0.0))
    tall = np.argmax(string_reef.obstacles.scale[:, 2])
    x, y = map(float, string_reef.obstacles.position[tall, :2])
    with pytest.raises(ValueError, match="touches the world"):
        Simulated(string_reef, DREAM_V1_NAV, SE2(x, y, 0.0))
