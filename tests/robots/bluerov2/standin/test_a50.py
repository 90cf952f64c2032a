"""The stand-in A50: what it reports, what it answers, and how it errs."""

from __future__ import annotations

import json
import math
import socket
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dream.geometry import SE2
from dream.robots.bluerov2.standin.a50 import A50, GARBAGE, HUGE, DvlFaults
from dream.robots.bluerov2.standin.lockstep import LockStep
from dream.robots.bluerov2.standin.tank import Conditions, Tank
from dream.sim.sensors import DVL_A50
from dream.sim.vehicle import Current
from dream.sim.world import World
from dream.sim.worlds import make_world

Json = dict[str, Any]

EXACT = replace(DVL_A50, beam_noise=1e-6, scale_error=0.0, dropout=0.0)
AHEAD = np.array([0.3, 0.3, -0.3, -0.3, 0.0, 0.0, 0.0, 0.0])
RIGHT = np.array([-0.3, 0.3, -0.3, 0.3, 0.0, 0.0, 0.0, 0.0])
DOWN = np.array([0.0, 0.0, 0.0, 0.0, -0.3, -0.3, -0.3, -0.3])


class Dive:
    """A tank with an A50 and a client."""

    def __init__(
        self, world: World, *, start: SE2 | None = None, conditions: Conditions | None = None
    ) -> None:
        conditions = conditions or Conditions(dvl=EXACT)
        self.tank = Tank(world, start=start or SE2(0.0, 0.0, 0.3), conditions=conditions)
        self.dvl = A50(self.tank)
        self.clients: list[socket.socket] = []
        self.client = self.connect()
        self.commands = np.zeros(8)

    def connect(self) -> socket.socket:
        client = socket.create_connection(self.dvl.address)
        client.setblocking(False)
        self.clients.append(client)
        return client

    def run(self, seconds: float) -> bytes:
        """Let time pass, and what the first client was sent."""
        heard = bytearray()
        for _ in range(round(seconds * 100)):
            self.tank.advance(self.commands)
            self.dvl.beat()
            heard += read(self.client)
        return bytes(heard)

    def reports(self, seconds: float, kind: str = "velocity") -> list[Json]:
        return [line for line in lines(self.run(seconds)) if line["type"] == kind]

    def ask(self, command: str, **parameters: object) -> Json:
        """A command, and its response."""
        self.client.sendall(json.dumps({"command": command, "parameters": parameters}).encode() + b"\n")
        answers = [line for line in lines(self.run(0.1)) if line["type"] == "response"]
        assert len(answers) == 1
        assert answers[0]["response_to"] == command
        assert bool(answers[0]["error_message"]) != answers[0]["success"]
        return answers[0]

    def close(self) -> None:
        for client in self.clients:
            client.close()
        self.dvl.close()


def read(client: socket.socket) -> bytes:
    try:
        return client.recv(1 << 20)
    except BlockingIOError:
        return b""


def lines(data: bytes) -> list[Json]:
    return [json.loads(line) for line in data.split(b"\n") if line.strip()]


@pytest.fixture(scope="module")
def pool() -> World:
    return make_world("pool/arc", 1)


@pytest.fixture
def dive(pool: World) -> Iterator[Dive]:
    dive = Dive(pool)
    yield dive
    dive.close()


@pytest.mark.parametrize(
    ("commands", "axis"), [(AHEAD, "vx"), (RIGHT, "vy"), (DOWN, "vz")], ids=["ahead", "right", "down"]
)
def test_velocities_are_forward_right_down_and_those_of_the_truth(
    dive: Dive, commands: np.ndarray, axis: str
) -> None:
    dive.tank.release()
    dive.commands = commands
    dive.run(0.6)
    for _ in range(40):
        before = dive.tank.state
        report = next((r for r in dive.reports(0.01) if r["velocity_valid"]), None)
        if report is not None:
            break
    assert report is not None
    velocity = before.velocity + np.cross(before.angular_velocity, DVL_A50.position)
    np.testing.assert_allclose(
        [report["vx"], report["vy"], report["vz"]], velocity * [1.0, -1.0, -1.0], atol=0.02
    )
    assert report[axis] > 0.05
    assert report[axis] == max(report["vx"], report["vy"], report["vz"])


def test_a_report_has_all_its_fields(dive: Dive) -> None:
    report = dive.reports(0.5)[-1]
    assert set(report) == {
        *("time", "vx", "vy", "vz", "fom", "covariance", "altitude", "transducers", "velocity_valid"),
        *("status", "tracking_mode", "format", "type", "time_of_validity", "time_of_transmission"),
    }
    assert [t["id"] for t in report["transducers"]] == [0, 1, 2, 3]
    assert set(report["transducers"][0]) == {"id", "velocity", "distance", "rssi", "nsd", "beam_valid"}
    assert report["altitude"] == pytest.approx(0.5, abs=0.02)
    assert report["transducers"][0]["distance"] == pytest.approx(0.5 / math.cos(math.radians(22.5)), abs=0.03)
    assert report["fom"] == pytest.approx(math.sqrt(np.trace(report["covariance"])))
    assert np.shape(report["covariance"]) == (3, 3)
    assert report["format"] == "json_v3.3"


def test_it_pings_as_often_as_its_range_mode_says(dive: Dive) -> None:
    # Half a metre above the ground: mode 0.
    assert len(dive.reports(4.0)) == pytest.approx(60, abs=1)
    assert dive.ask("set_config", range_mode="=1")["success"]
    assert len(dive.reports(4.0)) == pytest.approx(40, abs=1)
    assert dive.ask("set_config", range_mode="2<=4")["success"]
    assert len(dive.reports(4.0)) == pytest.approx(20, abs=1)


def test_a_range_mode_that_does_not_reach_the_ground_has_no_lock(dive: Dive) -> None:
    dive.ask("set_config", range_mode="=0")
    assert dive.reports(0.5)[-1]["velocity_valid"]
    dive.tank.release()
    dive.commands = -DOWN
    dive.run(2.0)
    dive.commands = np.zeros(8)
    report = dive.reports(0.5)[-1]
    assert report["altitude"] > 0.6
    assert not report["velocity_valid"]


def test_stamps_are_microseconds_of_its_own_clock(dive: Dive) -> None:
    report = dive.reports(1.0)[-1]
    late = report["time_of_transmission"] - report["time_of_validity"]
    assert 0 < late <= 20_000
    assert report["time_of_transmission"] == pytest.approx(1e6 * (49.0 + dive.tank.time), abs=1e5)
    dive.dvl.jump_clock(-20.0)
    later = dive.reports(0.2)[-1]
    assert later["time_of_validity"] == pytest.approx(report["time_of_validity"] - 19.8e6, abs=1e5)
    assert dive.ask("set_time_manual", now="2026-01-02T03:04:05Z")["success"]
    assert dive.reports(0.2)[-1]["time_of_validity"] == pytest.approx(1767323045e6, abs=1e6)
    assert not dive.ask("set_time_manual", now="yesterday")["success"]
    assert dive.ask("set_time_ntp", ntp_address="192.168.2.1")["success"]
    assert not dive.ask("set_time_manual", now="2026-01-02T03:04:05Z")["success"]
    assert dive.ask("get_time_ntp")["result"] == {"ntp_address": "192.168.2.1"}
    assert dive.ask("get_time_status")["result"]["ntp_synchronized"] is True
    assert dive.ask("force_sync_ntp", timeout_seconds=1)["result"] == {"success": True}


def test_the_gap_to_the_last_report_is_told_in_milliseconds(dive: Dive) -> None:
    reports = dive.reports(3.0)
    gaps = np.diff([r["time_of_transmission"] for r in reports]) / 1000.0
    np.testing.assert_allclose([r["time"] for r in reports[1:]], gaps, atol=0.1)


def test_dead_reckoning_follows_the_way_from_its_reset(pool: World) -> None:
    """Heading east and going right, it goes south: to the right of where it was reset."""
    dive = Dive(pool, start=SE2(0.0, 0.6, 0.0))
    dive.tank.release()
    dive.tank.pull((0.0, -6.0, 0.0), 9.0)
    dive.run(1.0)
    assert dive.ask("reset_dead_reckoning")["success"]
    before = dive.tank.T_world_base
    moved = dive.reports(1.5, "position_local")
    assert len(moved) in (7, 8)
    way = before.inverse @ dive.tank.T_world_base.translation
    last = moved[-1]
    assert way[1] < -0.1
    assert last["y"] == pytest.approx(-way[1], rel=0.15)
    assert abs(last["yaw"] - math.degrees(before.yaw - dive.tank.T_world_base.yaw)) < 3.0
    dive.close()


@pytest.mark.parametrize(
    ("parameters", "fits"),
    [
        ({"speed_of_sound": 1480}, True),
        ({"speed_of_sound": 999}, False),
        ({"speed_of_sound": "1480"}, False),
        ({"speed_of_sound": True}, False),
        ({"mounting_rotation_offset": 360.0}, True),
        ({"mounting_rotation_offset": -1}, False),
        ({"acoustic_enabled": False}, True),
        ({"acoustic_enabled": 0}, False),
        ({"range_mode": "0<=3"}, True),
        ({"range_mode": "=7"}, False),
        ({"range_mode": 3}, False),
        ({"colour": "red"}, False),
    ],
)
def test_a_configuration_is_taken_whole_or_not_at_all(dive: Dive, parameters: Json, fits: bool) -> None:
    before = dive.ask("get_config")["result"]
    answer = dive.ask("set_config", dark_mode_enabled=True, **parameters)
    assert answer["success"] is fits
    after = dive.ask("get_config")["result"]
    assert after == (before | {"dark_mode_enabled": True} | parameters if fits else before)


def test_velocities_scale_with_the_speed_of_sound_and_turn_with_the_mounting(pool: World) -> None:
    def going(**parameters: object) -> np.ndarray:
        dive = Dive(pool)
        dive.tank.release()
        dive.ask("set_config", **parameters)
        dive.commands = AHEAD
        report = dive.reports(1.0)[-1]
        dive.close()
        return np.array([report["vx"], report["vy"], report["vz"]])

    plain = going(dark_mode_enabled=True)
    assert plain[0] > 0.1
    np.testing.assert_allclose(going(speed_of_sound=1400), plain * 1400 / 1500, atol=1e-5)
    turned = going(mounting_rotation_offset=90)
    np.testing.assert_allclose(turned, [-plain[1], plain[0], plain[2]], atol=1e-5)


def test_pings_are_triggered_where_it_does_not_ping_by_itself(dive: Dive) -> None:
    assert not dive.ask("trigger_ping")["success"]
    dive.ask("set_config", acoustic_enabled=False)
    assert dive.reports(1.0) == []
    dive.client.sendall(b'{"command": "trigger_ping"}\n' * 17)
    got = lines(dive.run(2.0))
    answers = [line["success"] for line in got if line["type"] == "response"]
    assert answers == [True] * 15 + [False] * 2
    assert len([line for line in got if line["type"] == "velocity"]) == 15


def test_a_calibration_takes_its_time(dive: Dive) -> None:
    dive.client.sendall(b'{"command": "calibrate_gyro"}\n')
    assert not [line for line in lines(dive.run(4.0)) if line["type"] == "response"]
    assert [line["success"] for line in lines(dive.run(2.0)) if line["type"] == "response"] == [True]


def test_what_is_no_command_is_answered_as_such(dive: Dive) -> None:
    dive.client.sendall(
        b'rubbish\n[1]\n{"command": 3}\n{"command": "dance"}\n{"command":"set_config","parameters":[1]}\n'
    )
    answers = [line for line in lines(dive.run(0.2)) if line["type"] == "response"]
    assert [a["success"] for a in answers] == [False] * 5
    assert dive.ask("get_version_info")["result"]["version_short"] == "2.7.2"


def test_a_command_in_two_halves_is_one(dive: Dive) -> None:
    dive.client.sendall(b'{"command": "get_')
    dive.run(0.1)
    dive.client.sendall(b'config"}\r\n')
    answers = [line for line in lines(dive.run(0.1)) if line["type"] == "response"]
    assert [a["response_to"] for a in answers] == ["get_config"]


def test_water_track_is_not_to_be_had_in_a_pool(dive: Dive) -> None:
    assert dive.ask("set_config", range_mode="wt")["success"]
    got = lines(dive.run(3.0))
    assert not [line for line in got if line["type"] == "velocity"]
    water = [line for line in got if line["type"] == "velocity_water"]
    assert len(water) in (6, 7)
    assert not any(line["velocity_valid"] for line in water)
    assert water[0]["tracking_mode"] == "water"


def test_water_track_high_above_the_ground_is_against_the_water() -> None:
    world = make_world("flat/empty", 1)
    conditions = Conditions(dvl=EXACT, current=Current(mean=(0.2, 0.0, 0.0)))
    dive = Dive(world, start=SE2(0.0, 0.0, 0.0), conditions=conditions)
    dive.tank.release()
    dive.tank.pull((0.0, 0.0, 40.0), 9.0)
    dive.run(10.0)
    dive.ask("set_config", range_mode="wt")
    report = dive.reports(2.0, "velocity_water")[-1]
    assert report["altitude"] > 4.5
    assert report["velocity_valid"]
    state = dive.tank.state
    water = dive.tank.T_world_base.rotation.T @ np.array([0.2, 0.0, 0.0])
    assert report["vx"] == pytest.approx(state.velocity[0] - water[0], abs=0.03)
    dive.close()


# ---------------------------------------------------------------------------------------- faults
def test_a_lost_lock_is_zeros_that_are_not_valid(dive: Dive) -> None:
    dive.reports(0.5)
    dive.dvl.faults = DvlFaults(lost=True)
    report = dive.reports(0.5)[-1]
    assert not report["velocity_valid"]
    assert (report["vx"], report["vy"], report["vz"], report["fom"]) == (0.0, 0.0, 0.0, 0.0)
    assert report["altitude"] == pytest.approx(0.5, abs=0.02)
    assert not any(t["beam_valid"] for t in report["transducers"])


def test_a_hot_one_says_so_and_a_silent_one_nothing(dive: Dive) -> None:
    assert dive.reports(0.5)[-1]["status"] == 0
    dive.dvl.faults = DvlFaults(hot=True)
    assert dive.reports(0.5)[-1]["status"] == 1
    dive.dvl.faults = DvlFaults(silent=True)
    dive.client.sendall(b'{"command": "get_config"}\n')
    assert dive.run(1.0) == b""
    dive.dvl.faults = DvlFaults()
    assert dive.reports(0.5)


@pytest.mark.parametrize("kind", GARBAGE)
def test_garbage_comes_between_good_reports(dive: Dive, kind: str) -> None:
    dive.dvl.faults = DvlFaults(garbage=kind)
    good, bad = 0, []
    for line in dive.run(1.0).split(b"\n"):
        try:
            report = json.loads(line, parse_constant=lambda name: 1 / 0)
            assert not (report["type"] == "velocity" and not isinstance(report.get("vx"), float))
            good += 1
        except Exception:  # noqa: BLE001 - whatever a reader would stumble over.
            bad += [line] if line.strip() else []
    assert good > 5
    assert len(bad) > 5
    assert kind != "huge" or max(map(len, bad)) > HUGE


@pytest.mark.parametrize(
    ("fault", "wrong"),
    [
        ({"garbage": "junk"}, "garbage: expected one of"),
        ({"outliers": 1.1}, "outliers: expected a share"),
        ({"false_share": -0.1}, "false_share: expected a share"),
        ({"altitude_factor": 0.0}, "altitude_factor: expected a number above 0"),
        ({"altitude_stuck": -1.0}, "altitude_stuck: expected a number above 0"),
        ({"outlier_factor": math.inf}, "outlier_factor: expected a number above 0"),
        ({"false_bottom": math.nan}, "false_bottom: expected a number above 0"),
        ({"latency": -0.1}, "latency: expected 0 or more"),
        ({"merit": math.nan}, "merit: expected 0 or more"),
        ({"bottom_moves": (0.1, 0.0)}, "bottom_moves: expected three finite"),
        ({"bottom_moves": (0.1, 0.0, math.nan)}, "bottom_moves: expected three finite"),
    ],
)
def test_a_fault_that_cannot_be_is_refused(fault: Json, wrong: str) -> None:
    with pytest.raises(ValueError, match=wrong):
        DvlFaults(**fault)


def test_altitudes_can_be_stuck_scaled_and_far_off_at_times(dive: Dive) -> None:
    dive.dvl.faults = DvlFaults(altitude_stuck=5.0)
    assert {r["altitude"] for r in dive.reports(0.5)} == {5.0}
    dive.dvl.faults = DvlFaults(altitude_factor=2.0)
    assert {round(r["altitude"], 1) for r in dive.reports(0.5)} == {1.0}
    dive.dvl.faults = DvlFaults(outliers=0.3)
    said = np.array([r["altitude"] for r in dive.reports(20.0)])
    off = said > 2.0
    np.testing.assert_allclose(said[off], 5.0, atol=0.2)
    np.testing.assert_allclose(said[~off], 0.5, atol=0.02)
    # Three hundred of them: within three sigma.
    assert off.mean() == pytest.approx(0.3, abs=0.08)
    dive.dvl.faults = DvlFaults()
    assert {round(r["altitude"], 1) for r in dive.reports(0.5)} == {0.5}


def test_a_false_bottom_lies_above_the_ground_and_comes_and_goes(dive: Dive) -> None:
    dive.dvl.faults = DvlFaults(false_bottom=0.3, false_share=0.6)
    said = np.array([r["altitude"] for r in dive.reports(20.0)])
    near = said < 0.35
    np.testing.assert_allclose(said[near], 0.2, atol=0.02)
    np.testing.assert_allclose(said[~near], 0.5, atol=0.02)
    assert near.mean() == pytest.approx(0.6, abs=0.08)
    # Below it there is nothing.
    dive.dvl.faults = DvlFaults(false_bottom=0.8, false_share=1.0)
    assert {round(r["altitude"], 1) for r in dive.reports(0.5)} == {0.5}


def test_a_frozen_velocity_keeps_its_value_with_new_stamps(dive: Dive) -> None:
    dive.tank.release()
    dive.commands = AHEAD
    last = dive.reports(1.0)[-1]
    dive.dvl.faults = DvlFaults(velocity_frozen=True)
    dive.commands = -AHEAD
    frozen = dive.reports(1.0)
    assert {(r["vx"], r["vy"], r["vz"]) for r in frozen} == {(last["vx"], last["vy"], last["vz"])}
    assert all(r["velocity_valid"] for r in frozen)
    assert len({r["time_of_validity"] for r in frozen}) == len(frozen)
    dive.dvl.faults = DvlFaults()
    assert dive.reports(0.2)[-1]["vx"] < last["vx"] - 0.05


def test_a_bottom_that_moves_is_told_as_the_opposite_of_the_vehicles_motion(pool: World) -> None:
    # Heading north: a bottom that goes east goes to the right.
    dive = Dive(pool, start=SE2(0.0, 0.0, 0.5 * math.pi))
    plain = dive.reports(0.5)[-1]
    dive.dvl.faults = DvlFaults(bottom_moves=(0.1, 0.0, 0.02))
    report = dive.reports(0.5)[-1]
    moved = [report[axis] - plain[axis] for axis in ("vx", "vy", "vz")]
    np.testing.assert_allclose(moved, [0.0, -0.1, 0.02], atol=1e-3)
    dive.close()


def test_latency_is_not_in_the_stamps_and_a_figure_of_merit_is_said(dive: Dive) -> None:
    before = dive.reports(0.5)[-1]
    dive.dvl.faults = DvlFaults(latency=0.4, merit=0.7)
    assert dive.reports(0.39) == []
    report = dive.reports(0.1)[0]
    assert report["fom"] == 0.7
    late = 1e-6 * (report["time_of_transmission"] - before["time_of_transmission"])
    assert late == pytest.approx(0.07, abs=0.03)
    assert dive.dvl.clock - 1e-6 * report["time_of_transmission"] == pytest.approx(0.45, abs=0.06)


def test_without_a_host_it_is_reached_in_memory_alone(pool: World) -> None:
    clock = LockStep()
    dvl = A50(Tank(pool), host=None)
    assert dvl.address == ("", 0)
    one, other = dvl.attach(clock), dvl.attach(clock)
    one.send(b'{"command": "get_config"}\n')
    for _ in range(20):
        dvl.tank.advance(np.zeros(8))
        dvl.beat()
    mine, theirs = lines(one.receive(0.0)), lines(other.receive(0.0))
    assert [r["type"] for r in mine if r["type"] == "response"] == ["response"]
    assert [r for r in mine if r["type"] != "response"] == theirs
    assert any(r["type"] == "velocity" for r in theirs)
    other.close()
    dvl.beat()
    assert dvl.clients == 1
    dvl.close()
    assert one.receive(0.0) == b""


def test_all_clients_hear_the_same_and_can_be_cut_off(dive: Dive) -> None:
    other = dive.connect()
    dive.run(0.1)
    read(other)
    mine, theirs = dive.run(1.0), bytearray()
    while data := read(other):
        theirs += data
    assert lines(bytes(theirs)) == lines(mine)
    assert dive.dvl.clients == 2
    dive.dvl.disconnect()
    assert other.recv(1) == b""
    dive.client = dive.connect()
    assert dive.reports(0.5)


def test_a_client_that_went_away_or_never_reads_does_no_harm(dive: Dive) -> None:
    dive.connect().close()
    deaf = dive.connect()
    dive.dvl.faults = DvlFaults(garbage="huge")
    dive.run(3.0)
    dive.dvl.faults = DvlFaults()
    assert dive.dvl.clients == 1
    assert dive.reports(0.5)
    deaf.close()


def test_a_command_without_an_end_cuts_its_client_off(dive: Dive) -> None:
    other = dive.connect()
    dive.run(0.1)
    for _ in range(4):
        with suppress(OSError):
            other.send(b"x" * 40_000)
        dive.run(0.1)
    assert dive.dvl.clients == 1
