"""Datagrams, and the whole stand-in over real sockets."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from dream.robots.bluerov2.standin import LinkFaults, StandIn, Tank, Wire
from dream.robots.bluerov2.standin.ardusub import Send
from dream.robots.bluerov2.standin.wire import Address
from dream.sim.world import World
from dream.sim.worlds import make_world


@pytest.fixture(scope="module")
def pool() -> World:
    return make_world("pool/arc", 1)


@pytest.fixture
def station() -> Iterator[socket.socket]:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    made.settimeout(20.0)
    yield made
    made.close()


def arrivals(faults: LinkFaults, station: socket.socket) -> list[tuple[int, float]]:
    """Which of a hundred datagrams, one each hundredth of a second, arrive and when."""
    wire = Wire(station.getsockname(), seed=3)
    wire.faults = faults
    station.setblocking(False)
    got = []
    for beat in range(300):
        now = 0.01 * beat
        if beat < 100:
            wire.send(bytes([beat]), None, now)
        wire.flush(now)
        while True:
            try:
                got.append((station.recv(10)[0], now))
            except BlockingIOError:
                break
    wire.close()
    return got


def test_datagrams_arrive_at_once_and_in_order(station: socket.socket) -> None:
    assert arrivals(LinkFaults(), station) == [(k, 0.01 * k) for k in range(100)]


def test_a_share_is_lost(station: socket.socket) -> None:
    assert 55 <= len(arrivals(LinkFaults(loss=0.3), station)) <= 85
    assert arrivals(LinkFaults(loss=1.0), station) == []


def test_a_delay_is_the_same_for_all_and_jitter_swaps_them(station: socket.socket) -> None:
    late = arrivals(LinkFaults(delay=0.5), station)
    assert [k for k, _ in late] == list(range(100))
    # It is looked once a beat.
    assert all(0.5 - 1e-9 < now - 0.01 * k < 0.5 + 0.0101 for k, now in late)
    swapped = [k for k, _ in arrivals(LinkFaults(jitter=0.1), station)]
    assert sorted(swapped) == list(range(100)) != swapped


@pytest.mark.parametrize("bad", [{"loss": 1.5}, {"delay": -1.0}, {"jitter": float("nan")}])
def test_faults_that_cannot_be_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="expected"):
        LinkFaults(**bad)


def test_answers_go_to_who_asked_and_streams_to_the_station(pool: World, station: socket.socket) -> None:
    with (
        StandIn(pool, ground=station.getsockname()) as standin,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        other.bind(("127.0.0.1", 0))
        other.settimeout(5.0)
        speaker = mav.MAVLink(None, srcSystem=200)
        asked = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
        standin.step(0.05)
        other.sendto(asked.pack(speaker), standin.ardusub_address)
        standin.step(1.0)
        station.setblocking(False)
        heard: dict[str, set[str]] = {"station": set(), "other": set()}
        reader = mav.MAVLink(None)
        while True:
            try:
                data, sender = station.recvfrom(1000)
            except BlockingIOError:
                break
            assert sender == standin.ardusub_address
            heard["station"] |= {m.get_type() for m in reader.parse_buffer(data) or []}
        for _ in range(2):
            heard["other"] |= {m.get_type() for m in reader.parse_buffer(other.recv(1000)) or []}
    assert heard["other"] == {"AUTOPILOT_VERSION", "COMMAND_ACK"}
    assert {"HEARTBEAT", "ATTITUDE", "RAW_IMU", "SCALED_PRESSURE2", "VFR_HUD", "SYS_STATUS"} <= heard[
        "station"
    ]
    assert "COMMAND_ACK" not in heard["station"]


def test_the_same_steps_are_the_same_dive(pool: World) -> None:
    def dive() -> np.ndarray:
        with StandIn(pool, seed=4) as standin:
            standin.ardusub.arm()
            standin.step(1.0)
            return standin.tank.state.vector

    np.testing.assert_array_equal(dive(), dive())


class Echo:
    """An autopilot that says what it hears."""

    def __init__(self, tank: Tank, send: Send) -> None:
        self._send, self.closed = send, False
        self.commands, self.tilt = np.full(tank.vehicle.thrusters.count, 0.1), 0.2

    def hear(self, data: bytes, sender: Address | None = None) -> None:
        self._send(data, sender)

    def beat(self) -> None:
        self._send(b"beat", None)

    def close(self) -> None:
        self.closed = True


def test_another_autopilot_can_be_put_in(pool: World, station: socket.socket) -> None:
    station.settimeout(5.0)
    with StandIn(pool, ground=station.getsockname(), depth=0.25, autopilot=Echo) as standin:
        echo = standin.autopilot
        assert isinstance(echo, Echo)
        station.sendto(b"heard", standin.ardusub_address)
        standin.beat()
        assert {station.recv(100), station.recv(100)} == {b"heard", b"beat"}
        assert standin.tank.state.position[2] == pytest.approx(-0.25)
        assert standin.T_base_camera.rotation[2, 2] == pytest.approx(np.sin(0.2))
        with pytest.raises(TypeError, match="expected our own ArduSub"):
            _ = standin.ardusub
    assert echo.closed


def test_watchers_see_each_beat_and_the_camera_is_where_it_is_tilted(pool: World) -> None:
    with StandIn(pool) as standin:
        seen: list[float] = []
        standin.watchers.append(lambda it: seen.append(it.tank.time))
        standin.step(0.5)
        assert len(seen) == 50
        ahead = standin.T_base_camera.rotation[:, 2]
        np.testing.assert_allclose(ahead, [1.0, 0.0, 0.0], atol=1e-12)
        standin.ardusub._tilted(-30.0)
        np.testing.assert_allclose(standin.T_base_camera.rotation[:, 2], [3**0.5 / 2, 0.0, -0.5], atol=1e-12)


def test_a_thread_beats_with_real_time_until_it_is_closed(pool: World) -> None:
    reached = threading.Event()
    with StandIn(pool) as standin:
        standin.watchers.append(lambda it: reached.set() if it.tank.time >= 0.3 else None)
        standin.start()
        assert reached.wait(20.0)
        assert standin.problem == ""
        with pytest.raises(RuntimeError, match="started once"):
            standin.start()
    assert standin._thread is not None
    assert not standin._thread.is_alive()


def test_what_breaks_in_the_thread_is_said(pool: World) -> None:
    broken = threading.Event()

    def breaks(standin: StandIn) -> None:
        if standin.tank.time > 0.1:
            broken.set()
            raise ZeroDivisionError("by a test")

    with StandIn(pool) as standin:
        standin.watchers.append(breaks)
        standin.start()
        assert broken.wait(20.0)
    assert standin.problem == "ZeroDivisionError: by a test"


def test_as_a_process_it_says_where_it_listens_and_ends_with_its_stdin(station: socket.socket) -> None:
    host, port = station.getsockname()
    process = subprocess.Popen(
        [sys.executable, "-m", "dream.robots.bluerov2.standin", "--gcs", f"{host}:{port}", "--seed", "2"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    where = json.loads(process.stdout.readline())
    data, sender = station.recvfrom(1000)
    assert list(sender) == where["ardusub"]
    assert data[0] == 0xFD
    with socket.create_connection(tuple(where["a50"])) as client:
        assert json.loads(client.makefile().readline())["format"] == "json_v3.3"
    process.stdin.close()
    assert process.wait(20.0) == 0
    process.stdout.close()
