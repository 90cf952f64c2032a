"""The rules that a stand-in ArduSub keeps, and how its vehicle then moves."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from dream.geometry import SE2, wrap_angle
from dream.robots.bluerov2.standin.helm import ALT_HOLD, GUIDED, MANUAL, POSHOLD, STABILIZE, SURFACE
from dream.robots.bluerov2.standin.parameters import NEXT, STABLE, Firmware
from dream.robots.bluerov2.standin.tank import Conditions
from dream.sim.vehicle import BLUEROV2
from dream.sim.world import World
from dream.sim.worlds import make_world
from tests.robots.bluerov2.standin.ground import NORTH, Ground

VELOCITY_AND_RATE, VELOCITY_AND_YAW, POSITION_AND_YAW, BOTH_AND_YAW = 0x5C7, 0x9C7, 0x9F8, 0x9C0
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4


@pytest.fixture(scope="module")
def pool() -> World:
    return make_world("pool/arc", 1)


@pytest.fixture
def ground(pool: World) -> Ground:
    return Ground(pool)


def heading(ground: Ground) -> float:
    """Degrees clockwise from north, truly."""
    return math.degrees(wrap_angle(0.5 * math.pi - ground.tank.T_world_base.yaw))


def where(ground: Ground) -> np.ndarray:
    return ground.tank.T_world_base.translation.copy()


def armed(ground: Ground) -> bool:
    return ground.sub.armed


def fixed(ground: Ground) -> bool:
    return ground.sub.position_ok


# ---------------------------------------------------------------------------------------- who and what it is
def test_it_beats_once_a_second_and_says_what_it_is(ground: Ground) -> None:
    ground.run(5.0)
    beats = ground.all("HEARTBEAT")
    assert len(beats) in (5, 6)
    for beat in beats:
        assert (beat.type, beat.autopilot, beat.custom_mode) == (12, 3, MANUAL)
        assert not beat.base_mode & 128
        assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 1)
    assert ground.mode(ALT_HOLD) == ACCEPTED
    ground.run(0.01)
    assert ground.last("HEARTBEAT").custom_mode == ALT_HOLD
    assert ground.arm() == ACCEPTED
    ground.run(1.0)
    assert ground.last("HEARTBEAT").base_mode & 128
    assert "Arming motors" in ground.texts


def test_sequence_numbers_go_round_without_a_gap(ground: Ground) -> None:
    ground.run(30.0)
    numbers = [message.get_seq() for message in ground.heard]
    assert len(numbers) > 300
    assert all((b - a) % 256 == 1 for a, b in pairwise(numbers))


def test_a_wrong_system_id_is_in_all_it_says_and_all_it_takes(pool: World) -> None:
    ground = Ground(pool, system=7)
    assert ground.arm() == -1
    assert not armed(ground)
    assert ground.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, target=7) == ACCEPTED
    assert {message.get_srcSystem() for message in ground.heard} == {7}


# ---------------------------------------------------------------------------------------- modes and arming
@pytest.mark.parametrize("mode", [STABILIZE, ALT_HOLD, SURFACE, MANUAL])
def test_modes_without_a_position_are_taken(ground: Ground, mode: int) -> None:
    assert ground.mode(mode) == ACCEPTED
    assert ground.sub.mode == mode


@pytest.mark.parametrize(("mode", "name"), [(GUIDED, "GUIDED"), (POSHOLD, "POSHOLD")])
def test_modes_that_need_a_position_wait_for_one(ground: Ground, mode: int, name: str) -> None:
    assert ground.mode(mode) == FAILED
    assert ground.sub.mode == MANUAL
    ground.run(0.01)
    assert f"Mode change failed: {name} requires position" in ground.texts
    ground.sub.fix = True
    assert ground.mode(mode) == ACCEPTED
    assert ground.sub.mode == mode


def test_external_navigation_with_an_origin_is_a_position(ground: Ground) -> None:
    def aid() -> None:
        ground.say(mav.MAVLink_vision_position_delta_message(0, 100, (0, 0, 0), (0, 0, 0), 90.0))

    ground.run(0.5)
    aid()
    assert not fixed(ground)
    for name, value in (("VISO_TYPE", 1), ("EK3_SRC1_POSXY", 6)):
        ground.say(mav.MAVLink_param_set_message(1, 1, name.encode(), value, 2))
    assert not fixed(ground)
    ground.say(mav.MAVLink_set_gps_global_origin_message(1, 0, 0, 0))
    assert fixed(ground)
    ground.run(0.6)
    assert ground.all("LOCAL_POSITION_NED")
    ground.run(1.0)
    assert not fixed(ground)
    ground.heard.clear()
    ground.run(1.0)
    assert not ground.all("LOCAL_POSITION_NED")


def test_the_message_set_mode_works_too_and_unknown_modes_do_not(ground: Ground) -> None:
    ground.say(mav.MAVLink_set_mode_message(1, 1, ALT_HOLD))
    assert ground.sub.mode == ALT_HOLD
    assert ground.mode(77) == FAILED
    ground.run(0.01)
    assert "No such mode 77" in ground.texts
    assert ground.command(mav.MAV_CMD_DO_SET_MODE, 0, MANUAL) == DENIED
    assert ground.sub.mode == ALT_HOLD


def test_it_does_not_arm_on_an_empty_battery_unless_forced(ground: Ground) -> None:
    ground.say(mav.MAVLink_param_set_message(1, 1, b"BATT_ARM_VOLT", 14.0, 9))
    ground.tank.drain(13.5)
    assert ground.arm() == FAILED
    assert not armed(ground)
    ground.run(0.01)
    assert any("below minimum arming voltage" in text for text in ground.texts)
    assert ground.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, 2989) == ACCEPTED
    assert ground.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0) == ACCEPTED
    assert not armed(ground)
    ground.run(0.01)
    assert "Disarming motors" in ground.texts


def test_commands_for_others_are_not_answered_and_unknown_ones_are(ground: Ground) -> None:
    assert ground.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, target=2) == -1
    assert not armed(ground)
    assert ground.command(31999) == UNSUPPORTED
    ack = ground.last("COMMAND_ACK")
    assert (ack.target_system, ack.target_component) == (255, 190)


# ---------------------------------------------------------------------------------------- sticks and motors
def test_full_ahead_makes_these_pulses_and_no_others(ground: Ground) -> None:
    ground.under_way(MANUAL)
    ground.stick(x=1000)
    ground.sub.beat()
    # 0.4 · 0.5 · 1000 = 200 µs; forward has −1 on the front motors and +1 on the rear ones.
    assert ground.sub.pulses == [1300, 1300, 1700, 1700, 1500, 1500, 1500, 1500]
    ground.stick(r=500)
    ground.sub.beat()
    assert ground.sub.pulses == [1600, 1400, 1400, 1600, 1500, 1500, 1500, 1500]
    ground.stick(z=750)
    ground.sub.beat()
    # 0.8 · 0.5 · 250 = 100 µs.
    assert ground.sub.pulses == [1500, 1500, 1500, 1500, 1400, 1400, 1400, 1400]
    ground.say(mav.MAVLink_param_set_message(1, 1, b"JS_GAIN_DEFAULT", 1.0, 9))
    ground.stick(y=1000)
    ground.sub.beat()
    assert ground.sub.pulses == [1900, 1100, 1900, 1100, 1500, 1500, 1500, 1500]


@pytest.mark.parametrize("stray", [{"target": 2}, {"system": 254}])
def test_sticks_of_others_are_no_sticks(ground: Ground, stray: dict[str, int]) -> None:
    ground.under_way(MANUAL)
    ground.stick(x=1000, **stray)
    ground.sub.beat()
    assert ground.sub.pulses == [1500] * 8


def test_the_extensions_tilt_it(ground: Ground) -> None:
    ground.under_way(MANUAL)
    ground.say(mav.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0, 0, 3, 100, 200))
    ground.sub.beat()
    # Pitch 0.25 and roll 0.5, whatever the gain: motor 5 has +1 roll and −1 pitch.
    assert ground.sub.pulses == [1500, 1500, 1500, 1500, 1600, 1200, 1800, 1400]


@pytest.mark.parametrize(
    ("sticks", "along", "sign"),
    [
        ({"x": 400}, 1, 1.0),
        ({"x": -400}, 1, -1.0),
        ({"y": 400}, 0, 1.0),
        ({"z": 300}, 2, -1.0),
        ({"z": 700}, 2, 1.0),
    ],
)
def test_sticks_move_the_vehicle_where_they_point(
    ground: Ground, sticks: dict[str, int], along: int, sign: float
) -> None:
    """Heading north: ahead is +y of the world, right is +x."""
    ground.under_way(ALT_HOLD)
    ground.run(1.0)
    before = where(ground)
    ground.sticks = sticks
    ground.run(2.0)
    moved = where(ground) - before
    assert sign * moved[along] > 0.08
    assert abs(moved[along]) > 4.0 * abs(np.delete(moved, along)).max()


def test_a_yaw_stick_to_the_right_turns_clockwise(ground: Ground) -> None:
    ground.under_way(ALT_HOLD)
    ground.sticks = {"r": 300}
    ground.run(3.0)
    # The same stick turned an ArduSub in its own simulator by 42°.
    assert 30.0 < heading(ground) < 55.0


def test_full_ahead_is_about_as_fast_as_such_vehicles_are(ground: Ground) -> None:
    ground.under_way(ALT_HOLD)
    ground.sticks = {"x": 1000}
    ground.run(2.5)
    assert 0.4 < ground.tank.state.velocity[0] < 0.7


def test_the_frame_with_six_swims_too(pool: World) -> None:
    ground = Ground(pool, conditions=Conditions(vehicle=BLUEROV2))
    ground.under_way(ALT_HOLD)
    before = where(ground)
    ground.sticks = {"x": 200}
    ground.run(2.0)
    assert len(ground.sub.pulses) == 6
    assert where(ground)[1] - before[1] > 0.05
    assert any("Frame: VECTORED" in text for text in ground.texts)


def test_a_motor_that_is_set_the_wrong_way_turns_the_wrong_way(ground: Ground) -> None:
    ground.under_way(MANUAL)
    ground.say(mav.MAVLink_param_set_message(1, 1, b"MOT_1_DIRECTION", -1, 2))
    ground.stick(x=1000)
    ground.sub.beat()
    assert ground.sub.pulses[:4] == [1700, 1300, 1700, 1700]


# ---------------------------------------------------------------------------------------- ALT_HOLD
def test_alt_hold_holds_depth_attitude_and_heading(ground: Ground) -> None:
    ground.under_way(ALT_HOLD)
    ground.run(5.0)
    z, began = where(ground)[2], heading(ground)
    off = []
    for _ in range(20):
        ground.run(0.5)
        off.append(abs(where(ground)[2] - z))
    assert max(off) < 0.02
    assert abs(heading(ground) - began) < 2.0
    up = ground.tank.T_world_base.rotation[2, 2]
    assert math.acos(up) < math.radians(2.0)


def test_alt_hold_comes_back_to_the_heading_that_a_yaw_stick_left(ground: Ground) -> None:
    ground.under_way(ALT_HOLD)
    ground.sticks = {"r": 300}
    ground.run(1.0)
    ground.sticks = {}
    ground.run(3.0)
    left = heading(ground)
    assert left > 5.0
    # Somebody turns it by 20°.
    x, turned = ground.tank._x, math.radians(20.0) / 2.0
    w, i, j, k = x[3:7].tolist()
    c, s = math.cos(turned), math.sin(turned)
    x[3:7] = c * w - s * k, c * i - s * j, c * j + s * i, c * k + s * w
    ground.run(0.1)
    assert heading(ground) == pytest.approx(left - 20.0, abs=3.0)
    ground.run(12.0)
    # It hunts about that.
    assert heading(ground) == pytest.approx(left, abs=6.0)


def test_a_pull_in_alt_hold_is_answered(ground: Ground) -> None:
    ground.under_way(ALT_HOLD)
    ground.run(3.0)
    z = where(ground)[2]
    ground.tank.pull((0.0, 0.0, -15.0), 20.0)
    ground.run(10.0)
    assert where(ground)[2] == pytest.approx(z, abs=0.06)


def test_a_depth_target_moves_it_there_and_only_in_alt_hold(ground: Ground) -> None:
    def deeper(alt: float, mask: int) -> None:
        message = mav.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 5, mask, 0, 0, alt, 0, 0, 0, 0, 0, 0, 0, 0
        )
        ground.say(message)

    ground.under_way(STABILIZE)
    deeper(-1.2, 0xDF8)
    assert any("outside GUIDED and ALT_HOLD" in why for why in ground.sub.refused)
    assert ground.mode(ALT_HOLD) == ACCEPTED
    ground.run(3.0)
    z = where(ground)[2]
    deeper(z - 0.2, 0xDFC)
    ground.run(4.0)
    assert where(ground)[2] == pytest.approx(z, abs=0.04)
    deeper(z - 0.2, 0xDF8)
    ground.run(8.0)
    assert where(ground)[2] == pytest.approx(z - 0.2, abs=0.04)


def test_little_throttle_is_none_in_alt_hold(ground: Ground) -> None:
    ground.under_way(ALT_HOLD)
    ground.run(4.0)
    z = where(ground)[2]
    # The dead zone is 100 of 1000 units at full gain: 100 of the stick, at any gain.
    ground.sticks = {"z": 405}
    ground.run(3.0)
    assert where(ground)[2] == pytest.approx(z, abs=0.03)
    ground.sticks = {"z": 350}
    ground.run(1.0)
    assert where(ground)[2] < z - 0.05


def test_surface_comes_up_and_then_holds(ground: Ground) -> None:
    ground.under_way(SURFACE)
    ground.run(6.0)
    assert where(ground)[2] > -0.25
    assert ground.sub.mode == ALT_HOLD


# ---------------------------------------------------------------------------------------- GUIDED
def guided(ground: Ground) -> None:
    ground.sub.fix = True
    ground.under_way(GUIDED)
    ground.run(1.0)


def test_setpoints_before_guided_are_ignored_without_a_word(ground: Ground) -> None:
    ground.under_way(ALT_HOLD)
    count = len(ground.all("STATUSTEXT"))
    before = where(ground)
    for _ in range(20):
        ground.velocity(VELOCITY_AND_YAW, vx=0.3, yaw=1.0)
        ground.run(0.1)
    assert np.linalg.norm((where(ground) - before)[:2]) < 0.03
    assert abs(heading(ground)) < 5.0
    assert len(ground.all("STATUSTEXT")) == count


@pytest.mark.parametrize(("frame", "expected"), [(8, (0.0, 1.0)), (12, (0.0, 1.0)), (1, (0.0, 1.0))])
def test_a_velocity_ahead_goes_north_when_heading_north(
    ground: Ground, frame: int, expected: tuple[float, float]
) -> None:
    guided(ground)
    before = where(ground)
    for _ in range(30):
        ground.velocity(VELOCITY_AND_RATE, frame, vx=0.3)
        ground.run(0.1)
    moved = where(ground) - before
    assert moved[:2] @ np.array(expected) > 0.25
    assert abs(moved[0]) < 0.06


def test_body_and_world_velocities_differ_when_heading_east(pool: World) -> None:
    moved = {}
    for frame in (1, 8):
        ground = Ground(pool, start=SE2(-0.8, 0.0, 0.0))
        guided(ground)
        before = where(ground)
        for _ in range(30):
            ground.velocity(VELOCITY_AND_RATE, frame, vx=0.3)
            ground.run(0.1)
        moved[frame] = where(ground) - before
    assert moved[1][1] > 0.25 > abs(moved[1][0]) * 3.0
    assert moved[8][0] > 0.25 > abs(moved[8][1]) * 3.0


def test_a_velocity_that_is_not_repeated_ends_after_three_seconds_but_a_turn_does_not(ground: Ground) -> None:
    guided(ground)
    ground.velocity(VELOCITY_AND_RATE, vx=0.1, yaw_rate=0.3)
    ground.run(2.9)
    assert np.linalg.norm(ground.tank.state.velocity_world[:2]) > 0.05
    ground.run(4.0)
    assert np.linalg.norm(ground.tank.state.velocity_world[:2]) < 0.04
    ground.run(3.0)
    # Seven seconds after the last setpoint it still turns, although neutral sticks are being sent.
    assert ground.tank.state.angular_velocity[2] == pytest.approx(-0.3, abs=0.05)
    ground.velocity(VELOCITY_AND_RATE)
    ground.run(3.0)
    assert abs(ground.tank.state.angular_velocity[2]) < 0.15


def test_a_yaw_stick_outdoes_the_setpoint_while_it_is_held(ground: Ground) -> None:
    guided(ground)
    ground.velocity(VELOCITY_AND_RATE, yaw_rate=-0.2)
    ground.run(2.0)
    assert ground.tank.state.angular_velocity[2] > 0.1
    ground.sticks = {"r": 400}
    ground.run(2.0)
    assert ground.tank.state.angular_velocity[2] < -0.1
    ground.sticks = {}
    ground.run(2.0)
    assert ground.tank.state.angular_velocity[2] > 0.1


def test_a_change_of_mode_ends_the_turn(ground: Ground) -> None:
    guided(ground)
    ground.velocity(VELOCITY_AND_RATE, yaw_rate=0.3)
    ground.run(3.0)
    assert ground.mode(ALT_HOLD) == ACCEPTED
    ground.run(3.0)
    assert abs(ground.tank.state.angular_velocity[2]) < 0.15


@pytest.mark.parametrize("mask", [0x407, 0x400, 0xFFF])
def test_masks_with_acceleration_or_nothing_are_refused_without_a_word(ground: Ground, mask: int) -> None:
    guided(ground)
    count = len(ground.heard)
    ground.velocity(mask, vx=0.5)
    assert len(ground.heard) == count
    ground.run(2.0)
    assert np.linalg.norm(ground.tank.state.velocity_world[:2]) < 0.03


def test_positions_of_body_frames_are_offsets_and_yaw_is_relative_in_one_of_them(ground: Ground) -> None:
    guided(ground)
    before = where(ground)
    # 0.4 m to the right and 0.1 m down: +x of the world when heading north.
    ground.velocity(POSITION_AND_YAW, 9, y=0.4, z=0.1, yaw=math.radians(30.0))
    ground.run(15.0)
    moved = where(ground) - before
    np.testing.assert_allclose(moved, [0.4, 0.0, -0.1], atol=0.06)
    assert heading(ground) == pytest.approx(30.0, abs=4.0)
    ground.velocity(VELOCITY_AND_YAW, 8, yaw=0.0)
    ground.run(5.0)
    assert heading(ground) == pytest.approx(0.0, abs=4.0)


def test_numbers_that_are_none_move_nothing(ground: Ground) -> None:
    guided(ground)
    ground.velocity(VELOCITY_AND_RATE, vx=math.nan)
    ground.velocity(VELOCITY_AND_RATE, yaw_rate=math.inf)
    ground.run(1.0)
    assert any("not finite" in why for why in ground.sub.refused)


def test_poshold_stays_where_it_is_in_a_pull(ground: Ground) -> None:
    ground.sub.fix = True
    ground.under_way(POSHOLD)
    before = where(ground)
    ground.tank.pull((4.0, 0.0, 0.0), 60.0)
    ground.run(25.0)
    assert np.linalg.norm((where(ground) - before)[:2]) < 0.06


# ---------------------------------------------------------------------------------------- failsafes
def test_three_seconds_without_sticks_disarm_in_any_mode(ground: Ground) -> None:
    ground.sub.fix = True
    ground.under_way(GUIDED)
    ground.run(1.0)
    ground.sticks = None
    for _ in range(25):
        ground.velocity(VELOCITY_AND_RATE, vx=0.1)
        ground.run(0.1)
    assert armed(ground)
    ground.run(0.6)
    assert not armed(ground)
    assert {"Lost manual control", "Disarming motors"} <= set(ground.texts)
    assert ground.sub.pulses == [1500] * 8


def test_sticks_that_only_warn_are_neutralised_but_it_stays_armed(ground: Ground) -> None:
    ground.say(mav.MAVLink_param_set_message(1, 1, b"FS_PILOT_INPUT", 1, 2))
    ground.under_way(MANUAL)
    ground.stick(x=1000)
    ground.sticks = None
    ground.run(2.9)
    assert ground.sub.pulses[0] == 1300
    ground.run(0.2)
    assert ground.sub.pulses == [1500] * 8
    assert armed(ground)


def test_sticks_stay_where_they_are_without_the_failsafe(ground: Ground) -> None:
    ground.say(mav.MAVLink_param_set_message(1, 1, b"FS_PILOT_INPUT", 0, 2))
    ground.under_way(MANUAL)
    ground.stick(r=100)
    ground.sticks = None
    ground.run(6.0)
    assert ground.sub.pulses[0] == 1520
    assert armed(ground)


def test_pilot_input_that_never_was_warns_once_and_does_not_disarm(ground: Ground) -> None:
    ground.sticks = None
    ground.run(4.0)
    assert ground.texts.count("Lost manual control") == 1
    assert ground.arm() == ACCEPTED
    ground.run(4.0)
    assert armed(ground)
    assert ground.texts.count("Lost manual control") == 1


def test_five_seconds_without_heartbeats_disarm(ground: Ground) -> None:
    ground.under_way(MANUAL)
    ground.say(mav.MAVLink_param_set_message(1, 1, b"FS_PILOT_INPUT", 0, 2))
    ground.beats, ground.sticks = False, None
    ground.run(4.4)
    assert armed(ground)
    ground.run(0.7)
    assert not armed(ground)
    assert {"MYGCS: 255, heartbeat lost", "Disarming motors"} <= set(ground.texts)


def test_sticks_count_as_heartbeats_and_a_second_station_of_the_same_id_hides_the_loss(
    ground: Ground,
) -> None:
    ground.under_way(MANUAL)
    ground.beats = False
    ground.run(7.0)
    assert armed(ground)
    ground.say(mav.MAVLink_param_set_message(1, 1, b"FS_PILOT_INPUT", 0, 2))
    ground.sticks = None
    for _ in range(7):
        ground.beat()
        ground.run(1.0)
    assert armed(ground)
    for _ in range(7):
        ground.beat(system=254)
        ground.run(1.0)
    assert not armed(ground)


@pytest.mark.parametrize(
    ("action", "mode", "armed"), [(1, MANUAL, True), (3, ALT_HOLD, True), (4, SURFACE, True)]
)
def test_what_a_lost_station_leads_to_is_a_parameter(
    ground: Ground, action: int, mode: int, armed: bool
) -> None:
    ground.say(mav.MAVLink_param_set_message(1, 1, b"FS_GCS_ENABLE", action, 2))
    ground.say(mav.MAVLink_param_set_message(1, 1, b"FS_PILOT_INPUT", 0, 2))
    ground.under_way(MANUAL)
    ground.beats, ground.sticks = False, None
    ground.run(5.2)
    assert (ground.sub.mode, ground.sub.armed) == (mode, armed)


def test_no_station_ever_is_no_loss(ground: Ground) -> None:
    ground.beats, ground.sticks = False, None
    ground.run(0.1)
    ground.arm()
    ground.run(7.0)
    assert armed(ground)
    assert not any("heartbeat lost" in text for text in ground.texts)


def test_a_leak_is_told_and_surfaces_where_it_is_to(ground: Ground) -> None:
    ground.under_way(ALT_HOLD)
    ground.tank.leak = True
    ground.run(1.0)
    assert ground.texts.count("Leak Detected") == 1
    assert ground.last("HEARTBEAT").system_status == mav.MAV_STATE_CRITICAL
    assert ground.sub.mode == ALT_HOLD
    ground.tank.leak = False
    ground.run(0.1)
    ground.say(mav.MAVLink_param_set_message(1, 1, b"FS_LEAK_ENABLE", 2, 2))
    ground.tank.leak = True
    ground.run(0.1)
    assert ground.sub.mode == SURFACE


def test_a_low_battery_is_told_after_its_time(ground: Ground) -> None:
    for name, value in ((b"BATT_LOW_VOLT", 14.5), (b"BATT_FS_LOW_ACT", 3), (b"BATT_CAPACITY", 18_000)):
        ground.say(mav.MAVLink_param_set_message(1, 1, name, value, 9))
    ground.under_way(ALT_HOLD)
    ground.tank.drain(14.0)
    ground.run(9.0)
    assert ground.sub.mode == ALT_HOLD
    z = where(ground)[2]
    ground.run(3.0)
    assert any(re.match(r"Battery 1 is low 1(3\.9|4\.0)V used ", text) for text in ground.texts)
    # It is on its way up, or there already.
    assert where(ground)[2] > z + 0.05
    status = ground.last("SYS_STATUS")
    assert 12_500 < status.voltage_battery < 13_960
    assert status.battery_remaining == pytest.approx(21, abs=1)


def test_what_is_left_of_the_battery_it_reckons_from_a_capacity_and_from_its_boot(ground: Ground) -> None:
    def left() -> int:
        ground.run(1.0)
        return int(ground.last("SYS_STATUS").battery_remaining)

    # As BlueOS delivers it: nobody told it a capacity.
    assert left() == -1
    ground.say(mav.MAVLink_param_set_message(1, 1, b"BATT_CAPACITY", 18_000, 9))
    ground.tank.leave(0.305)
    assert left() == 30
    # It takes whatever it boots on for a full one.
    ground.sub.reboot(1.0)
    ground.run(1.0)
    assert left() == 99


def test_a_reboot_is_silent_then_disarmed_with_its_parameters_and_a_clock_at_zero(ground: Ground) -> None:
    ground.say(mav.MAVLink_param_set_message(1, 1, b"JS_GAIN_DEFAULT", 0.8, 9))
    ground.under_way(ALT_HOLD)
    assert ground.last("ATTITUDE").time_boot_ms > 137_000
    ground.sub.reboot(2.0)
    count = len(ground.heard)
    ground.run(1.9)
    assert len(ground.heard) == count
    assert ground.command(mav.MAV_CMD_REQUEST_MESSAGE, 148) == -1
    ground.run(1.0)
    assert not armed(ground)
    assert ground.sub.mode == MANUAL
    assert ground.last("ATTITUDE").time_boot_ms < 1_100
    assert ground.sub.parameters["JS_GAIN_DEFAULT"] == pytest.approx(0.8)
    assert ground.texts[-2:] == ["ArduSub V4.5.3 (stand-in)", "Frame: VECTORED_6DOF"]


# ---------------------------------------------------------------------------------------- parameters
def test_parameters_are_read_set_listed_and_kept_in_their_type(ground: Ground) -> None:
    ground.say(mav.MAVLink_param_request_read_message(1, 1, b"SYSID_MYGCS", -1))
    value = ground.last("PARAM_VALUE")
    assert (value.param_id, value.param_value, value.param_type) == ("SYSID_MYGCS", 255.0, 4)
    ground.say(mav.MAVLink_param_set_message(1, 1, b"FRAME_CONFIG", 1.4, 9))
    assert ground.last("PARAM_VALUE").param_value == 1.0
    count = len(ground.heard)
    ground.say(mav.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, 9))
    ground.say(mav.MAVLink_param_set_message(1, 1, b"FRAME_CONFIG", math.nan, 9))
    ground.say(mav.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
    assert len(ground.heard) == count
    ground.say(mav.MAVLink_param_request_list_message(1, 1))
    ground.run(2.0)
    listed = ground.all("PARAM_VALUE")[2:]
    assert {m.param_id for m in listed} == set(ground.sub.parameters.names)
    assert {m.param_index for m in listed} == set(range(listed[0].param_count))
    ground.say(mav.MAVLink_param_request_read_message(1, 1, b"", 3))
    assert ground.last("PARAM_VALUE").param_id == ground.sub.parameters.names[3]


def test_the_station_it_listens_to_is_a_parameter_with_two_names(pool: World) -> None:
    ground = Ground(pool, firmware=NEXT)
    assert "SYSID_MYGCS" not in ground.sub.parameters
    ground.say(mav.MAVLink_param_set_message(1, 1, b"MAV_GCS_SYSID", 250, 9))
    ground.sticks = None
    ground.run(2.0)
    ground.arm()
    ground.run(0.51)
    ground.stick(x=1000)
    ground.sub.beat()
    assert ground.sub.pulses == [1500] * 8
    ground.stick(x=1000, system=250)
    ground.sub.beat()
    assert ground.sub.pulses[0] == 1300


# ---------------------------------------------------------------------------------------- streams
def rate(ground: Ground, kind: str, seconds: float) -> float:
    mark = len(ground.all(kind))
    ground.run(seconds)
    return (len(ground.all(kind)) - mark) / seconds


@pytest.mark.parametrize(("asked", "given"), [(10.0, 10.0), (30.0, 30.0), (50.0, 50.0), (200.0, 50.0)])
def test_streams_come_as_asked_up_to_fifty_a_second(ground: Ground, asked: float, given: float) -> None:
    assert ground.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 27, 1e6 / asked) == ACCEPTED
    assert rate(ground, "RAW_IMU", 4.0) == pytest.approx(given, abs=0.5)


def test_streams_can_be_stopped_asked_for_once_and_not_all_are_known(ground: Ground) -> None:
    assert ground.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 30, -1) == ACCEPTED
    assert rate(ground, "ATTITUDE", 2.0) == 0.0
    assert ground.command(mav.MAV_CMD_REQUEST_MESSAGE, 30) == ACCEPTED
    assert len(ground.all("ATTITUDE")) >= 1
    assert ground.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 9999, 20000) == DENIED
    assert ground.command(mav.MAV_CMD_REQUEST_MESSAGE, 9999) == FAILED
    assert ground.command(mav.MAV_CMD_REQUEST_MESSAGE, 148) == ACCEPTED
    assert ground.last("AUTOPILOT_VERSION").flight_sw_version >> 8 == 0x040503


def test_a_clock_that_jumps_shows_in_the_stamps(ground: Ground) -> None:
    ground.run(1.0)
    before = ground.last("ATTITUDE").time_boot_ms
    ground.sub.jump_clock(1000.0)
    ground.run(1.0)
    assert ground.last("ATTITUDE").time_boot_ms == pytest.approx(before + 1_001_000, abs=260)
    ground.say(mav.MAVLink_timesync_message(0, 42))
    answer = ground.last("TIMESYNC")
    assert answer.ts1 == 42
    assert answer.tc1 == pytest.approx(1e9 * (137.0 + 1000.0 + ground.tank.time), rel=1e-9)


def test_what_it_measures_is_forward_right_down_in_its_units(pool: World) -> None:
    """Heading 060, at rest: force is up, that is −1000 mG along down; depth is in hectopascals."""
    ground = Ground(pool, start=SE2(0.0, 0.0, math.radians(30.0)))
    ground.run(3.0)
    imu = ground.last("RAW_IMU")
    assert imu.zacc == pytest.approx(-1000, abs=30)
    assert imu.xgyro == pytest.approx(0, abs=3)
    attitude = ground.last("ATTITUDE")
    assert math.degrees(attitude.yaw) == pytest.approx(60.0, abs=6.0)
    assert ground.command(mav.MAV_CMD_REQUEST_MESSAGE, 31) == ACCEPTED
    q = ground.last("ATTITUDE_QUATERNION")
    assert 2.0 * math.atan2(q.q4, q.q1) == pytest.approx(attitude.yaw, abs=0.01)
    depth = -float(where(ground)[2])
    pressure = ground.last("SCALED_PRESSURE2")
    assert (pressure.press_abs - 1013.25) / 98.0665 == pytest.approx(depth, abs=0.04)
    assert ground.last("GLOBAL_POSITION_INT").relative_alt == pytest.approx(-1000.0 * depth, abs=40.0)
    hud = ground.last("VFR_HUD")
    assert hud.alt == 0.0
    assert hud.heading == pytest.approx(60, abs=6)


def test_its_turn_rates_have_the_sign_of_its_heading(ground: Ground) -> None:
    ground.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 27, 20000)
    ground.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 30, 20000)
    ground.under_way(ALT_HOLD)
    ground.sticks = {"r": 400}
    ground.run(2.0)
    assert ground.last("RAW_IMU").zgyro > 150
    assert ground.last("ATTITUDE").yawspeed > 0.15
    assert heading(ground) > 10.0
    assert math.degrees(ground.last("ATTITUDE").yaw) == pytest.approx(heading(ground), abs=6.0)


def test_a_surge_is_felt_ahead_and_a_lean_is_seen_as_such(ground: Ground) -> None:
    ground.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 27, 20000)
    ground.under_way(ALT_HOLD)
    ground.run(2.0)
    level = ground.last("RAW_IMU").xacc
    ground.sticks = {"x": 1000}
    ground.run(0.6)
    assert max(m.xacc for m in ground.all("RAW_IMU")[-20:]) > level + 40
    ground.sticks = None
    # Nose up and right side down.
    for _ in range(20):
        ground.say(mav.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0, 0, 3, 400, 400))
        ground.run(0.1)
    # Both full are 45° together; what rights the vehicle takes some of it. A real one came to 28 and 29°.
    seen = ground.last("ATTITUDE")
    assert math.degrees(seen.roll) == pytest.approx(29.0, abs=9.0)
    assert math.degrees(seen.pitch) == pytest.approx(29.0, abs=9.0)
    rotation = ground.tank.T_world_base.rotation
    assert rotation[2, 0] > 0.1  # The bow is up,
    assert rotation[2, 1] > 0.1  # and so is the left side.


# ---------------------------------------------------------------------------------------- camera and lights
def test_the_camera_tilts_and_says_so(ground: Ground) -> None:
    assert ground.command(mav.MAV_CMD_DO_MOUNT_CONTROL, -20, 0, 0, 0, 0, 0, 2) == ACCEPTED
    assert math.degrees(ground.sub.tilt) == pytest.approx(-20.0)
    ground.run(1.0)
    q = ground.last("GIMBAL_DEVICE_ATTITUDE_STATUS").q
    assert math.degrees(2.0 * math.asin(q[2])) == pytest.approx(-20.0, abs=1e-3)
    assert ground.last("NAMED_VALUE_FLOAT").value == pytest.approx(0.5 - 20.0 / 90.0)
    assert ground.command(mav.MAV_CMD_DO_MOUNT_CONTROL, -80, 0, 0, 0, 0, 0, 2) == ACCEPTED
    assert math.degrees(ground.sub.tilt) == pytest.approx(-45.0)
    assert ground.command(mav.MAV_CMD_DO_MOUNT_CONTROL, math.nan, 0, 0, 0, 0, 0, 2) == FAILED


def test_lights_are_a_servo_and_motors_are_not(ground: Ground) -> None:
    assert ground.command(mav.MAV_CMD_DO_SET_SERVO, 13, 1500) == ACCEPTED
    assert ground.sub.lights == pytest.approx(0.5)
    assert ground.command(mav.MAV_CMD_DO_SET_SERVO, 1, 1900) == FAILED
    assert ground.command(mav.MAV_CMD_DO_SET_SERVO, math.nan, 1900) == FAILED
    assert ground.sub.pulses == [1500] * 8


def test_a_clock_does_not_go_below_zero(ground: Ground) -> None:
    ground.sub.jump_clock(-1000.0)
    ground.run(1.0)
    assert ground.last("RAW_IMU").time_usec == 0


def test_no_message_of_the_dialect_breaks_it(ground: Ground) -> None:
    rng = np.random.default_rng(1)
    speaker = mav.MAVLink(None, srcSystem=255, srcComponent=190)
    for kind in mav.mavlink_map.values():
        for _ in range(3):
            payload = rng.integers(0, 256, kind.unpacker.size, np.uint8).tobytes()
            packed = mav.MAVLink_message(kind.id, kind.msgname)._pack(speaker, kind.crc_extra, payload)
            (message,) = mav.MAVLink(None).parse_buffer(packed)
            if hasattr(message, "target_system"):
                message.target_system, message.target_component = 1, 1
            ground.sub.fix = bool(rng.integers(2))
            ground.sub._handle(message)
    for command in range(3000):
        values = rng.choice([0.0, 1.0, -1.0, 19.0, math.nan, math.inf, 1e30], 7)
        if command != mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN:
            ground.command(command, *values.tolist())
    ground.run(1.0)
    ground.sub.parameters.change("SYSID_THISMAV", 1.0)
    assert ground.mode(MANUAL) == ACCEPTED


def test_bytes_that_are_no_mavlink_do_no_harm(ground: Ground) -> None:
    ground.sub.hear(bytes(range(256)) * 4)
    ground.sub.hear(b"\xfd" * 40)
    ground.beat()
    ground.run(1.0)
    assert ground.mode(ALT_HOLD) == ACCEPTED


def test_seven_thrusters_are_none_of_its_frames(pool: World) -> None:
    thrusters = replace(
        BLUEROV2.thrusters,
        positions=(*BLUEROV2.thrusters.positions, (0.0, 0.0, 0.0)),
        directions=(*BLUEROV2.thrusters.directions, (0.0, 0.0, 1.0)),
    )
    with pytest.raises(ValueError, match="expected 6 or 8 thrusters"):
        Ground(pool, conditions=Conditions(vehicle=replace(BLUEROV2, thrusters=thrusters)), start=NORTH)


# ---------------------------------------------------------------------------------------- origins and north
def located(ground: Ground, lat: float, lon: float, alt: float) -> None:
    for name, value in (("LAT", lat), ("LON", lon), ("ALT", alt)):
        ground.say(mav.MAVLink_param_set_message(1, 1, f"ORIGIN_{name}".encode(), value, 9))


def test_heights_above_the_sea_begin_with_an_origin_that_comes_with_arming(ground: Ground) -> None:
    located(ground, 22.3, 114.2, 50.0)
    ground.run(1.0)
    assert ground.last("VFR_HUD").alt == 0.0
    assert ground.last("GLOBAL_POSITION_INT").lat == 0
    ground.under_way(ALT_HOLD)
    ground.run(2.0)
    z = where(ground)[2]
    assert ground.last("VFR_HUD").alt == pytest.approx(50.0 + z, abs=0.04)
    place = ground.last("GLOBAL_POSITION_INT")
    assert place.alt == pytest.approx(1000.0 * (50.0 + z), abs=40.0)
    assert place.relative_alt == pytest.approx(1000.0 * z, abs=40.0)
    assert place.lat == pytest.approx(223_000_000, abs=20)
    assert "Using backup location" in ground.texts
    # Targets of depth have nothing to do with that.
    target = z - 0.2
    ground.say(
        mav.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 5, 0xDFB, 0, 0, target, 0, 0, 0, 0, 0, 0, 0, 0
        )
    )
    ground.run(6.0)
    assert where(ground)[2] == pytest.approx(target, abs=0.05)


def test_an_origin_is_taken_once_and_not_where_a_receiver_is_to_tell_it(ground: Ground) -> None:
    def sent(altitude: float) -> None:
        ground.say(
            mav.MAVLink_set_gps_global_origin_message(1, 223_000_000, 1_142_000_000, round(1e3 * altitude))
        )

    ground.say(mav.MAVLink_param_set_message(1, 1, b"EK3_SRC1_POSXY", 3, 2))
    sent(7.0)
    assert ground.sub.altitude == 0.0
    located(ground, 22.3, 114.2, 50.0)
    ground.arm()
    ground.run(0.1)
    assert "Failed to set origin, check EK3_SRC parameters" in ground.texts
    assert armed(ground)
    ground.say(mav.MAVLink_param_set_message(1, 1, b"EK3_SRC1_POSXY", 0, 2))
    sent(7.0)
    sent(9.0)
    assert ground.sub.altitude == pytest.approx(7.0 + where(ground)[2], abs=0.04)


def test_a_position_makes_a_home_and_that_a_relative_height_above_the_sea(pool: World) -> None:
    ground = Ground(pool, conditions=Conditions(altitude=300.0))
    ground.sub.fix = True
    ground.run(2.0)
    z = where(ground)[2]
    assert ground.last("GLOBAL_POSITION_INT").relative_alt == pytest.approx(1000.0 * (300.0 + z), abs=40.0)
    assert ground.last("AHRS2").altitude == pytest.approx(300.0 + z, abs=0.04)
    assert ground.last("LOCAL_POSITION_NED").z == pytest.approx(-z, abs=0.04)


def test_its_heading_is_magnetic_until_it_knows_where_it_is(pool: World) -> None:
    ground = Ground(pool, depth=0.3, conditions=Conditions(declination=math.radians(-15.0)))
    located(ground, 45.0, -60.0, 0.0)
    ground.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 30, 50_000)

    def off() -> float:
        seen = math.degrees(ground.last("ATTITUDE").yaw)
        return math.degrees(wrap_angle(math.radians(seen - heading(ground))))

    ground.run(5.0)
    assert off() == pytest.approx(15.0, abs=3.0)
    ground.under_way(ALT_HOLD)
    ground.run(5.0)
    # It turns with it: what it takes for its heading is where it was.
    assert 4.0 < off() < 10.0
    assert heading(ground) > 3.0
    ground.run(25.0)
    assert -7.0 < off() < 0.0
    ground.sticks = {"z": 100}
    ground.run(2.5)
    assert "EKF3 IMU0 MAG0 in-flight yaw alignment complete" in ground.texts
    assert off() == pytest.approx(0.0, abs=3.0)


def test_its_zero_rises_with_it(pool: World) -> None:
    """It was switched on at a depth of 0.3 m, and comes up."""
    ground = Ground(pool, conditions=Conditions(depth_zero=-0.3))
    ground.under_way(SURFACE)
    ground.run(6.0)
    assert ground.last("GLOBAL_POSITION_INT").relative_alt < 20
    assert where(ground)[2] > -0.2


def test_pushed_at_the_bottom_it_stays_there_with_all_its_might_until_it_is_let_go_of(ground: Ground) -> None:
    ground.under_way(ALT_HOLD)
    ground.sticks = {"z": 0}
    ground.run(12.0)
    low = where(ground)[2]
    assert min(ground.sub.pulses[4:]) > 1890
    # While the throttle is at its end, what it is led to does not run away.
    assert ground.last("NAV_CONTROLLER_OUTPUT").alt_error > -0.45
    ground.sticks = {}
    ground.run(0.6)
    assert max(ground.sub.pulses[4:]) < 1750
    assert where(ground)[2] == pytest.approx(low, abs=0.02)


@pytest.mark.parametrize("firmware", [STABLE, NEXT])
def test_its_parameters_are_those_of_a_vehicle(pool: World, firmware: Firmware) -> None:
    parameters = Ground(pool, firmware=firmware).sub.parameters
    expected = {
        "ARMING_CHECK": 448,
        "PILOT_SPEED_UP": 100,
        "PILOT_ACCEL_Z": 100,
        "WPNAV_SPEED_UP": 250,
        "THR_DZ": 100,
        "RC1_DZ": 30,
        "RC4_DZ": 40,
        "RC3_TRIM": 1500,
        "ORIGIN_LAT": 0,
        "ORIGIN_ALT": 0,
        "SURFACE_DEPTH": -10,
        "JS_GAIN_DEFAULT": 0.5,
    }
    assert {name: parameters[name] for name in expected} == expected


def test_why_it_refuses_is_told_after_that_it_does(ground: Ground) -> None:
    ground.run(0.5)
    mark = len(ground.heard)
    assert ground.mode(GUIDED) == FAILED
    assert ground.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 251, 500_000) == DENIED
    ground.run(0.02)
    order = [m.get_type() for m in ground.heard[mark:] if m.get_type() in ("COMMAND_ACK", "STATUSTEXT")]
    assert order == ["COMMAND_ACK", "COMMAND_ACK", "STATUSTEXT", "STATUSTEXT"]
    assert ground.texts[-1] == "No ap_message for mavlink id (251)"
    ground.run(1.0)
    assert ground.all("NAMED_VALUE_FLOAT")
