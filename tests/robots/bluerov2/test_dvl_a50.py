"""The link to the A50, against a server that says what a test wants."""

from __future__ import annotations

import itertools
import json
import math
import queue
import socket
import threading
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from dream.geometry import SE2
from dream.measurements import Dvl
from dream.robots.bluerov2.dvl_a50 import (
    FIRMWARE,
    MAX_LINE,
    BadLine,
    DvlA50,
    Stream,
    VelocityReport,
    WaterReport,
    apart,
    measurement,
    ranges,
    read_line,
)
from dream.robots.bluerov2.standin.a50 import A50, DvlFaults
from dream.robots.bluerov2.standin.lockstep import LockStep
from dream.robots.bluerov2.standin.memory import MemoryStream
from dream.robots.bluerov2.standin.tank import BEAT, Tank
from dream.sim.world import World
from dream.sim.worlds import make_world
from tests.robots.bluerov2.waiting import until

SOON = 5.0
"""Seconds within which whatever a test waits for has come, also on a busy machine."""


def said(**changes: Any) -> dict[str, Any]:
    """A velocity report as in Water Linked's documentation, but moving."""
    return {
        "time": 106.39,
        "vx": 0.3,
        "vy": 0.1,
        "vz": -0.05,
        "fom": 0.002,
        "covariance": [[4e-4, 1e-4, 2e-4], [1e-4, 5e-4, 3e-4], [2e-4, 3e-4, 6e-4]],
        "altitude": 1.25,
        "transducers": [{"id": 0, "velocity": 0.1, "distance": 1.3, "rssi": -30.5, "nsd": -88.7}],
        "velocity_valid": True,
        "status": 0,
        "format": "json_v3.3",
        "type": "velocity",
        "time_of_validity": 1638191471563017,
        "time_of_transmission": 1638191471752336,
        **changes,
    }


def line(**changes: Any) -> bytes:
    return json.dumps(said(**changes)).encode() + b"\n"


def stamped(seconds: float, *, took: float = 0.1, **changes: Any) -> bytes:
    """A report that was true at a second of the device's clock."""
    validity = round(1e6 * seconds)
    return line(time_of_validity=validity, time_of_transmission=validity + round(1e6 * took), **changes)


def report(**changes: Any) -> VelocityReport:
    read = read_line(line(**changes))
    assert isinstance(read, VelocityReport)
    return read


class TestReading:
    def test_a_velocity_is_turned_from_front_right_down_to_front_left_up(self) -> None:
        dvl = measurement(report(), 12.5)
        np.testing.assert_allclose(dvl.velocity, [0.3, -0.1, 0.05])
        np.testing.assert_allclose(
            dvl.covariance, [[4e-4, -1e-4, -2e-4], [-1e-4, 5e-4, 3e-4], [-2e-4, 3e-4, 6e-4]], atol=1e-12
        )
        assert (dvl.time, dvl.altitude, dvl.valid) == (12.5, 1.25, True)

    @pytest.mark.parametrize(
        "covariance",
        [
            [[0.0, 0.0, 0.0]] * 3,
            [[-1.0, 0.0, 0.0], [0.0, 1e-9, 0.0], [0.0, 0.0, 1e-2]],
            [[1e-6, 5.0, 0.0], [-5.0, 1e-6, 0.0], [0.0, 0.0, 1e-6]],
        ],
        ids=["zero", "negative", "not symmetric"],
    )
    def test_no_covariance_is_below_the_floor(self, covariance: list[list[float]]) -> None:
        made = measurement(report(covariance=covariance), 0.0).covariance
        np.testing.assert_array_equal(made, made.T)
        assert np.linalg.eigvalsh(made)[0] >= 0.005**2 * (1.0 - 1e-9)

    @pytest.mark.parametrize(
        ("changes", "valid", "altitude"),
        [
            ({}, True, 1.25),
            ({"velocity_valid": False}, False, math.nan),
            ({"fom": 0.4}, False, 1.25),
            ({"altitude": 0.05}, False, 0.05),
            ({"altitude": -1.0}, False, math.nan),
            ({"altitude": 0.0}, False, math.nan),
        ],
    )
    def test_what_is_valid(self, changes: dict[str, Any], valid: bool, altitude: float) -> None:
        dvl = measurement(report(**changes), 0.0)
        assert dvl.valid is valid
        assert dvl.altitude == pytest.approx(altitude, nan_ok=True)

    def test_beams_are_as_long_as_their_transducers_say_where_they_hear_an_echo(self) -> None:
        beams = [{"id": k, "distance": 1.0 + 0.1 * k, "beam_valid": k != 2} for k in (3, 1, 2, 0)]
        np.testing.assert_allclose(ranges(report(transducers=beams)), [1.0, 1.1, np.nan, 1.3])

    @pytest.mark.parametrize(
        "beams", [None, [], {"id": 0}, [None, 3], [{"id": 7, "distance": 1.0, "beam_valid": True}]]
    )
    def test_beams_that_are_none_are_not_known_and_the_velocity_stays(self, beams: object) -> None:
        read = report(transducers=beams)
        assert np.isnan(ranges(read)).all()
        assert measurement(read, 0.0).valid

    @pytest.mark.parametrize("wrong", [0.0, -1.0, "1.0", None, [1.0]])
    def test_a_distance_that_is_none_is_not_known(self, wrong: object) -> None:
        beams = [{"id": 0, "distance": wrong, "beam_valid": True}]
        assert np.isnan(ranges(report(transducers=beams))).all()

    @pytest.mark.parametrize("version", ["json_v3", "json_v3.1", "json_v3.12"])
    def test_a_minor_version_and_more_fields_are_fine(self, version: str) -> None:
        assert report(format=version, salinity=[1, {"new": None}]).vx == 0.3

    @pytest.mark.parametrize(
        ("raw", "reason"),
        [
            (b"not JSON", "not JSON"),
            (b"\xff\xfe\x00", "not JSON"),
            (b"[" * 50_000, "not JSON"),
            (b"[1, 2]", "not a JSON object"),
            (b'"velocity"', "not a JSON object"),
            (b"{}", "no type"),
            (b'{"type": 7}', "no type"),
            (line().replace(b"0.3", b"NaN"), "not JSON"),
            (line().replace(b"0.3", b"Infinity"), "not JSON"),
            (line().replace(b"0.3", b"1e999"), "velocity: vx"),
            (line(vx="0.3"), "velocity: vx"),
            (line(vx=None), "velocity: vx"),
            (line(vx=True), "velocity: vx"),
            (line(vx=21.0), "velocity: vx"),
            (line(vy=[0.1]), "velocity: vy"),
            (line(fom=-1.0), "velocity: fom"),
            (line(covariance=[[1.0, 0.0], [0.0, 1.0]]), "velocity: covariance"),
            (line(covariance=[1.0] * 9), "velocity: covariance"),
            (line(altitude="1.25"), "velocity: altitude"),
            (line(velocity_valid=1), "velocity: velocity_valid"),
            (line(time_of_validity=1.5), "velocity: time_of_validity"),
            (line(time_of_validity=-1), "velocity: time_of_validity"),
            (line(time_of_validity=10**30), "velocity: time_of_validity"),
            (line(format="json_v4"), "velocity: format"),
            (line(format="json_v3.1 "), "velocity: format"),
            (b'{"type": "response", "format": "json_v3"}', "response: response_to"),
        ],
    )
    def test_what_is_wrong_is_refused_by_name(self, raw: bytes, reason: str) -> None:
        with pytest.raises(BadLine, match=f"^{reason}$"):
            read_line(raw)

    @pytest.mark.parametrize("kind", ["position_local", "something_new"])
    def test_other_reports_are_of_no_concern(self, kind: str) -> None:
        assert read_line(line(type=kind)) is None

    def test_a_velocity_through_the_water_is_none_over_ground(self) -> None:
        assert isinstance(read_line(line(type="velocity_water", vx="unheard")), WaterReport)


class Server:
    """Plays one script for each connection, one after the other; the last stays open until the end."""

    def __init__(self, *scripts: Callable[[socket.socket], None]) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.heard: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self.failures: list[BaseException] = []
        self.over = threading.Event()
        self._scripts = scripts
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        try:
            for number, script in enumerate(self._scripts, start=1):
                link, _ = self._listener.accept()
                with link:
                    script(link)
                    if number == len(self._scripts):
                        self.over.wait()
        except OSError as error:
            self.failures.append(error)

    def close(self) -> None:
        self.over.set()
        self._thread.join(SOON)
        self._listener.close()
        assert not self.failures


def says(*pieces: bytes) -> Callable[[socket.socket], None]:
    def script(link: socket.socket) -> None:
        for piece in pieces:
            link.sendall(piece)

    return script


class Clock:
    """Moves on a little at each look."""

    def __init__(self, step: float = 1e-4) -> None:
        self.time, self.step = 100.0, step

    def __call__(self) -> float:
        self.time += self.step
        return self.time


class Known:
    """The device's clock is 90 s behind the dive's, and that is known."""

    def time(self, stamp: float, arrival: float) -> float:
        return stamp + 90.0


Opened = Callable[..., tuple[DvlA50, "queue.SimpleQueue[Dvl]", Server]]


@pytest.fixture
def opened() -> Iterator[Opened]:
    """Opens a link to a server with scripts."""
    links: list[DvlA50] = []
    servers: list[Server] = []

    def begin(
        *scripts: Callable[[socket.socket], None], **options: Any
    ) -> tuple[DvlA50, queue.SimpleQueue[Dvl], Server]:
        server = Server(*scripts)
        servers.append(server)
        got: queue.SimpleQueue[Dvl] = queue.SimpleQueue()
        options = {"now": Clock(), "deliver": got.put, "pauses": (0.01, 0.05), **options}
        links.append(DvlA50("127.0.0.1", server.port, **options))
        return links[-1], got, server

    yield begin
    for link in links:
        link.close()
    for server in servers:
        server.close()


def test_half_lines_and_many_at_once_are_put_together(opened: Opened) -> None:
    three = stamped(10.0) + stamped(10.2, vx=0.4) + b"\r\n" + stamped(10.4, vx=0.5)
    pieces = [three[:7], three[7:900], three[900:]]
    _, got, _ = opened(says(*pieces), clock=Known(), now=Clock(step=1.0))
    assert [got.get(timeout=SOON).velocity[0] for _ in range(3)] == [0.3, 0.4, 0.5]


def test_it_is_true_when_it_was_measured_not_when_it_came(opened: Opened) -> None:
    _, got, _ = opened(says(stamped(10.0, took=0.19) + stamped(10.2, took=0.05)))
    first, second = got.get(timeout=SOON), got.get(timeout=SOON)
    # 10.0 was sent at 10.19 and 10.2 at 10.25: both came in at the same time, so the second tells the offset.
    assert first.time == pytest.approx(100.0 - 0.19, abs=0.01)
    assert second.time > first.time
    assert second.time == pytest.approx(100.0 - 0.05, abs=0.01)


def test_bad_lines_are_counted_and_the_good_ones_go_on(opened: Opened) -> None:
    stream = (
        b"garbage\n"
        + line(vx="fast")
        + line().replace(b"0.3", b"NaN")
        + line(type="velocity_water", vx=9.0)
        + line(type="brand_new")
        + b"x" * (3 * MAX_LINE)
        + b"\n"
        + stamped(10.0, vx=0.7)
    )
    link, got, _ = opened(says(stream))
    assert got.get(timeout=SOON).velocity[0] == 0.7
    assert got.empty()
    assert link.refused == {"not JSON": 2, "velocity: vx": 1, "longer than a report": 1}


def test_a_velocity_through_the_water_is_never_delivered(opened: Opened) -> None:
    stream = stamped(10.0, tracking_mode="water", vx=0.9) + stamped(10.2, type="velocity_water", vx=0.9)
    link, got, _ = opened(says(stream + stamped(10.4, tracking_mode="bottom")))
    assert got.get(timeout=SOON).velocity[0] == 0.3
    assert link.refused == {"does not track the ground": 1}


def test_an_endless_line_takes_no_room(opened: Opened) -> None:
    refused = threading.Event()

    def tap(_time: float, _channel: str, sent: bool, payload: object) -> None:
        if not sent and str(payload).startswith("yyy"):
            refused.set()

    def script(link: socket.socket) -> None:
        link.sendall(b"y" * (2 * MAX_LINE))
        assert refused.wait(SOON)  # Before it ends, which it need not.
        link.sendall(b"y" * MAX_LINE + b"\n" + stamped(10.0))

    link, got, _ = opened(script, tap=tap)
    got.get(timeout=SOON)
    assert link.refused == {"longer than a report": 1}


def test_repeated_and_older_velocities_are_left_out(opened: Opened) -> None:
    stream = stamped(10.0) + stamped(10.0, vx=0.9) + stamped(9.8, vx=0.9) + stamped(10.2, vx=0.5)
    link, got, _ = opened(says(stream), clock=Known(), now=Clock(step=1.0))
    assert [got.get(timeout=SOON).velocity[0] for _ in range(2)] == [0.3, 0.5]
    assert link.refused == {"said before": 1, "older than the one before": 1}


@pytest.mark.parametrize("took", [-0.5, 30.0])
def test_a_report_that_took_no_possible_time_is_left_out(opened: Opened, took: float) -> None:
    link, got, _ = opened(says(stamped(100.0, took=took, vx=0.9) + stamped(101.0)))
    assert got.get(timeout=SOON).velocity[0] == 0.3
    assert link.refused == {"sent before it was true, or long after": 1}


def test_a_clock_that_is_set_does_not_stop_it(opened: Opened) -> None:
    got: queue.SimpleQueue[Dvl] = queue.SimpleQueue()
    taken = threading.Semaphore()

    def script(link: socket.socket) -> None:
        for stamp in (10.0, 10.2, 1.7e9, 1.7e9 + 0.2, 50.0):
            taken.acquire(timeout=SOON)
            link.sendall(stamped(stamp))

    def deliver(dvl: Dvl) -> None:
        got.put(dvl)
        taken.release()

    opened(script, deliver=deliver, now=Clock(step=0.2))
    times = [got.get(timeout=SOON).time for _ in range(5)]
    assert np.all(np.diff(times) > 0.0)
    assert times[-1] < 103.0


def test_it_connects_anew_when_the_other_side_hangs_up(opened: Opened) -> None:
    link, got, _ = opened(says(stamped(10.0) + b'{"type": "velo'), says(), says(stamped(20.0, vx=0.8)))
    assert [got.get(timeout=SOON).velocity[0] for _ in range(2)] == [0.3, 0.8]
    assert link.connected
    assert link.refused == {}


def test_it_connects_anew_when_nothing_is_said(opened: Opened) -> None:
    def silent(link: socket.socket) -> None:
        while link.recv(100):
            pass

    _, got, _ = opened(silent, says(stamped(20.0)), quiet=0.1)
    got.get(timeout=SOON)


def test_where_nobody_listens_it_says_so_and_closes_quickly() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with DvlA50("127.0.0.1", port, now=Clock(), deliver=lambda _: None) as link:
        assert not link.connected
        assert link.age == math.inf
        assert f"no connection to the DVL at 127.0.0.1:{port}" in link.problem
        with pytest.raises(ConnectionError, match="no connection"):
            link.ask("get_config")


def test_a_hot_device_says_so(opened: Opened) -> None:
    link, got, _ = opened(says(stamped(10.0, status=1)))
    got.get(timeout=SOON)
    assert link.hot
    assert "too hot" in link.problem


def old(*missing: str, **changes: Any) -> bytes:
    """A report of the protocols before: without what came later."""
    before = {name: value for name, value in said(**changes).items() if name not in missing}
    return json.dumps(before).encode() + b"\n"


@pytest.mark.parametrize(
    ("raw", "reason", "spoken", "remedy"),
    [
        (old("type", "covariance", format="json_v1"), "no type", "json_v1", "too old"),
        (old("type", "covariance", "format", "status"), "no type", "a protocol without a name", "too old"),
        (old("covariance", format="json_v2"), "velocity: format", "json_v2", "too old"),
        (line(format="json_v4"), "velocity: format", "json_v4", "Is it one of those?"),
        (line(format="json_v30"), "velocity: format", "json_v30", "Is it one of those?"),
        (line(format="x" * 5000), "velocity: format", "another protocol", "Is it one of those?"),
    ],
)
def test_another_protocol_is_named_and_what_firmware_is_needed(
    opened: Opened, raw: bytes, reason: str, spoken: str, remedy: str
) -> None:
    refused = threading.Event()

    def script(link: socket.socket) -> None:
        while not refused.wait(0.01):
            link.sendall(raw)

    link, _, _ = opened(script)
    assert until(lambda: link.refused)
    problem = link.problem
    refused.set()
    assert set(link.refused) == {reason}
    assert f"speaks {spoken}, expected json_v3" in problem
    assert remedy in problem
    assert FIRMWARE in problem
    assert len(problem) < 250


def test_what_has_no_type_and_is_no_velocity_is_no_old_protocol() -> None:
    with pytest.raises(BadLine) as refused:
        read_line(b'{"format": "json_v1", "x": 1.0}')
    assert refused.value.spoken == ""


def config_answer(**changes: Any) -> bytes:
    """The answer to `get_config`, without a new line."""
    result = {"speed_of_sound": 1480, "mounting_rotation_offset": 0, "acoustic_enabled": True, **changes}
    told = {"response_to": "get_config", "success": True, "error_message": "", "result": result}
    return json.dumps({**told, "format": "json_v3", "type": "response"}).encode()


PD6 = b":SA, +0.00, +0.00,  0.00\r\n:TS,22020812061800, 0.0, +0.0, 0.0,1475.0, 0\r\n:BI,+123,-420,+0,+0,A\r\n"
PD4 = b"\x7d\x00\x2d\x00\xa3" + bytes(range(11, 53))
"""47 bytes without a new line."""


class Saying:
    """A DVL that says a thing again and again, to a link on a clock of its own."""

    def __init__(self, *pieces: bytes, hangs_up: bool = False, port: int = 16171) -> None:
        self.clock = LockStep()
        self.got: list[Dvl] = []
        self._pieces, self._hangs_up = pieces, hangs_up
        self._ending = self.clock.event()
        self._threads: list[Any] = []
        self.link = DvlA50(
            "rig", port, now=self.clock, deliver=self.got.append, threads=self.clock, dial=self._dial
        )

    def _dial(self) -> Stream:
        pipe = MemoryStream(self.clock)

        def say() -> None:
            for number in itertools.count():
                for piece in self._pieces:
                    if self._ending.is_set() or not pipe.open:
                        return
                    report = stamped(1.0 + 0.1 * number).strip()
                    pipe.far.send(bytearray(piece.replace(b"REPORT", report)))
                    self.clock.sleep(0.05)
                if self._hangs_up:
                    pipe.far.close()
                    return

        self._threads.append(self.clock.start(say, "says"))
        return pipe

    def __enter__(self) -> Saying:
        self.clock.sleep(4.0)  # As long as the list listens.
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self.link.close()
        for thread in self._threads:
            thread.join()


@pytest.mark.parametrize(
    ("pieces", "spoken"),
    [
        ((PD6,), "PD6"),
        ((b":WI,    +0,    +0,    +0,    +0,V\r\n",), "PD6"),
        ((PD4,), "PD4"),
        ((PD4[:3], PD4[3:] + PD4), "PD4"),
        ((b"\n".join([PD4, PD4]),), "PD4"),
        ((b"\x7f\x7f\x0a\x01\x00\x06" + bytes(200),), "PD0"),
        ((b"wrz,0.1,-0.2,0.0,y,1.3,0.003,1e-7;0;0,7,14,123,0*2f\r\n",), "its serial protocol"),
        ((b"$DVPDL,1574,0,0.1,0.2*00\r\n",), "NMEA 0183"),
        ((old("type", "covariance", "format", "status"),), "a protocol without a name"),
    ],
)
@pytest.mark.parametrize("port", [16171, 1037])
def test_an_output_that_is_no_json_is_named_with_what_to_do(
    pieces: tuple[bytes, ...], spoken: str, port: int
) -> None:
    with Saying(*pieces, port=port) as dvl:
        problem = dvl.link.problem
        assert f"the DVL at rig:{port} speaks {spoken}, expected json_v3" in problem
        if spoken != "a protocol without a name":
            assert "its JSON comes on port 16171" in problem
            assert ("Say --dvl HOST:16171" in problem) == (port != 16171)
        with pytest.raises(TimeoutError, match=f"speaks {spoken}"):
            dvl.link.ask("get_config", timeout=0.2)
        assert dvl.got == []


def test_one_that_answers_nonsense_and_hangs_up_is_named_as_well() -> None:
    with Saying(b"HTTP/1.1 400 Bad Request\r\n", hangs_up=True, port=80) as dvl:
        assert not dvl.link.connected
        assert "the DVL at rig:80 speaks HTTP, expected json_v3" in dvl.link.problem
        assert "Say --dvl HOST:16171" in dvl.link.problem


def test_another_protocol_is_forgotten_once_a_velocity_comes() -> None:
    with Saying(PD6, b"REPORT\n") as dvl:
        assert dvl.got
        dvl.clock.sleep(0.05)
        problems = set()
        for _ in range(4):
            dvl.clock.sleep(0.05)
            problems.add(dvl.link.problem)
        assert "" in problems


@pytest.mark.parametrize(
    "pieces",
    [
        (line(type="velocity_water", tracking_mode="water"),),
        (stamped(10.0, tracking_mode="water"),),
        (line(type="velocity_water", velocity_valid=False), line(type="position_local")),
        (config_answer() + b"\n", line(type="velocity_water")),
    ],
)
def test_a_dvl_that_tracks_the_water_only_is_told(pieces: tuple[bytes, ...]) -> None:
    with Saying(*pieces) as dvl:
        assert "through the water only" in dvl.link.problem
        assert "Set its range_mode to auto" in dvl.link.problem
        assert dvl.got == []


@pytest.mark.parametrize(
    "pieces",
    [
        (config_answer() + b"REPORT\r\n",),
        (config_answer()[:40], config_answer()[40:] + b"REPORT\r", b"\n"),
        (config_answer(), b"REPORT\n"),
        (config_answer() + b"  " + config_answer() + b"REPORT\n", b"REPORT\n"),
    ],
)
def test_an_answer_glued_to_the_next_report_is_read_and_told(pieces: tuple[bytes, ...]) -> None:
    with Saying(*pieces) as dvl:
        assert dvl.got
        assert dvl.link.config is not None
        assert dvl.link.config.speed_of_sound == 1480.0
        assert "does not end its answers with a new line" in dvl.link.problem
        assert f"Update it to {FIRMWARE}" in dvl.link.problem
        assert not dvl.link.misread  # Under way it ends nothing: all of it is read.


def test_reports_in_one_line_are_read_and_a_new_line_after_an_answer_is_no_problem() -> None:
    with Saying(config_answer() + b"\r\n", b"REPORT" + line(type="position_local")) as dvl:
        assert dvl.link.problem == ""
        assert len(dvl.got) > 10


@pytest.mark.parametrize(
    ("raw", "pieces"),
    [
        (b'{"a": 1}{"b": {"c": 2}}', [b'{"a": 1}', b'{"b": {"c": 2}}']),
        (b'{"a": "}{"}', [b'{"a": "}{"}']),
        (b'{"a": [{"b": 1}, {"b": 2}]}', [b'{"a": [{"b": 1}, {"b": 2}]}']),
        (b'{"a": 1}\t {"torn": ', [b'{"a": 1}', b'{"torn": ']),
        (b"no JSON", [b"no JSON"]),
    ],
)
def test_a_line_is_taken_apart_only_between_objects(raw: bytes, pieces: list[bytes]) -> None:
    assert apart(raw) == pieces


def test_a_failing_receiver_does_not_end_the_link(opened: Opened) -> None:
    got: queue.SimpleQueue[Dvl] = queue.SimpleQueue()

    def deliver(dvl: Dvl) -> None:
        if dvl.velocity[0] < 0.35:
            raise RuntimeError("not ready")
        got.put(dvl)

    link, _, _ = opened(
        says(stamped(10.0) + stamped(10.2, vx=0.4)), deliver=deliver, clock=Known(), now=Clock(step=1.0)
    )
    assert got.get(timeout=SOON).velocity[0] == 0.4
    assert link.refused == {"could not be delivered": 1}


def test_everything_that_came_and_went_is_tapped(opened: Opened) -> None:
    tapped: list[tuple[str, bool, object]] = []
    first = stamped(10.0)
    _, got, _ = opened(
        says(b"garbage\xff\n", first),
        tap=lambda _, channel, sent, payload: tapped.append((channel, sent, payload)),
    )
    got.get(timeout=SOON)
    assert tapped[:3] == [
        ("a50", True, '{"command": "get_config"}'),
        ("a50", False, "garbage\\xff"),
        ("a50", False, first.decode().strip()),
    ]


def test_nothing_is_delivered_after_close(opened: Opened) -> None:
    link, got, _ = opened(says(stamped(10.0)))
    got.get(timeout=SOON)
    link.close()
    assert not link.connected
    assert got.empty()


def answers(*replies: tuple[str, dict[str, Any]]) -> Callable[[socket.socket], None]:
    """Answers commands by name, each with what is given for it in turn; silent on others."""
    left = {name: [reply for other, reply in replies if other == name] for name, _ in replies}

    def script(link: socket.socket) -> None:
        link.sendall(stamped(10.0))
        with link.makefile("rb") as lines:
            for raw in lines:
                name = json.loads(raw)["command"]
                if left.get(name):
                    body = {
                        "type": "response",
                        "format": "json_v3.1",
                        "response_to": name,
                        "success": True,
                        "error_message": "",
                        **left[name].pop(0),
                    }
                    link.sendall(json.dumps(body).encode() + b"\n")
                if not any(left.values()):
                    return

    return script


def config(**changes: Any) -> tuple[str, dict[str, Any]]:
    result = {
        "speed_of_sound": 1480,
        "mounting_rotation_offset": 0.0,
        "acoustic_enabled": True,
        "range_mode": "auto",
        **changes,
    }
    return "get_config", {"result": result}


def test_commands_are_answered(opened: Opened) -> None:
    link, got, _ = opened(
        answers(config(), ("set_config", {}), config(speed_of_sound=1500), ("set_time_manual", {}))
    )
    got.get(timeout=SOON)
    link.set_config(speed_of_sound=1500.0)
    assert link.config is not None
    assert link.config.speed_of_sound == 1500.0
    link.set_time_manual(datetime(2026, 11, 22, 12, 0, tzinfo=UTC))


def test_a_refusal_is_told(opened: Opened) -> None:
    link, got, _ = opened(answers(("calibrate_gyro", {"success": False, "error_message": "moving"})))
    got.get(timeout=SOON)
    with pytest.raises(ValueError, match="calibrate_gyro: the DVL refuses: moving"):
        link.calibrate_gyro()


def test_no_answer_is_a_time_out(opened: Opened) -> None:
    link, got, _ = opened(says(stamped(10.0)))
    got.get(timeout=SOON)
    with pytest.raises(TimeoutError, match="reset_dead_reckoning: expected a response"):
        link.ask("reset_dead_reckoning", timeout=0.05)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({}, "^$"),
        ({"mounting_rotation_offset": 360.0}, "^$"),
        ({"mounting_rotation_offset": 90.0}, "expected mounting_rotation_offset 0°, got 90°"),
        ({"acoustic_enabled": False}, "told not to ping"),
        ({"range_mode": "wt"}, "told to track the water"),
    ],
)
def test_settings_that_would_mislead_are_a_problem(
    opened: Opened, changes: dict[str, Any], problem: str
) -> None:
    link, got, _ = opened(answers(config(**changes), ("trigger_ping", {})))
    got.get(timeout=SOON)
    link.trigger_ping()  # Answered after the question that the link itself asks.
    with pytest.raises(AssertionError, match=problem):
        raise AssertionError(link.problem)
    assert link.misread == link.problem


@pytest.mark.parametrize("speed", [999.0, math.nan])
def test_a_wrong_argument_is_never_sent(opened: Opened, speed: float) -> None:
    link, _, _ = opened(says())
    with pytest.raises(ValueError, match="speed_of_sound: expected 1000 to 2000"):
        link.set_config(speed_of_sound=speed)
    with pytest.raises(ValueError, match="time zone"):
        link.set_time_manual(datetime(2026, 11, 22, 12, 0))  # noqa: DTZ001


# On a clock of its own, without a network.


class Rig:
    """The link and a stand-in A50 whose time goes on only while both wait."""

    def __init__(self, pool: World, **options: Any) -> None:
        self.clock = LockStep()
        self.tank = Tank(pool, start=SE2(0.0, 0.0, 0.3))
        self.a50 = A50(self.tank, host=None)
        self.got: list[tuple[float, Dvl]] = []
        self.dialled: list[float] = []
        self.lines = 0
        self.unreachable = False
        self._ending = self.clock.event()
        self._beats = self.clock.start(self._beat, "a50")
        self.link = DvlA50(
            "rig",
            now=self.clock,
            deliver=lambda dvl: self.got.append((self.clock(), dvl)),
            threads=self.clock,
            dial=self._dial,
            **options,
        )

    def _dial(self) -> Stream:
        self.dialled.append(self.clock())
        if self.unreachable:
            raise ConnectionRefusedError(111, "Connection refused")
        return self.a50.attach(self.clock)

    def _beat(self) -> None:
        while not self._ending.is_set():
            self.tank.advance(np.zeros(8))
            self.a50.beat()
            self.clock.sleep(BEAT)

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, *_: object) -> None:
        self.link.close()
        self._ending.set()
        self._beats.join()
        self.a50.close()


@pytest.fixture(scope="module")
def pool() -> World:
    return make_world("pool/arc", 1)


def test_on_a_clock_of_its_own_it_connects_learns_the_settings_and_delivers(pool: World) -> None:
    with Rig(pool) as rig:
        assert rig.dialled == []
        rig.clock.sleep(2.0)
        assert rig.dialled == [0.0]
        assert (rig.link.connected, rig.link.problem) == (True, "")
        assert rig.link.config is not None
        assert rig.link.config.speed_of_sound == 1500.0
        # Fifteen times a second, half a metre above the ground.
        assert len(rig.got) == pytest.approx(30, abs=2)
        assert all(0.0 <= came - dvl.time < 0.03 for came, dvl in rig.got)
        altitudes = [dvl.altitude for _, dvl in rig.got if dvl.valid]
        assert len(altitudes) > 25
        assert altitudes == pytest.approx([0.5] * len(altitudes), abs=0.02)
        assert rig.link.age < 0.1
        began = rig.clock()
        rig.link.set_config(speed_of_sound=1480.0)
        assert rig.clock() - began < 0.1
        assert rig.a50.config["speed_of_sound"] == 1480.0
    assert (rig.link.connected, rig.a50.clients) == (False, 0)


def test_it_takes_the_same_course_every_time(pool: World) -> None:
    def course() -> list[tuple[float, float, float]]:
        with Rig(pool) as rig:
            rig.clock.sleep(1.0)
            return [(came, dvl.time, float(dvl.velocity[0])) for came, dvl in rig.got]

    assert course() == course()


def test_silence_is_told_and_after_it_the_connection_is_made_anew(pool: World) -> None:
    with Rig(pool, quiet=1.0, pauses=(0.5, 4.0)) as rig:
        rig.clock.sleep(2.0)
        rig.a50.faults = DvlFaults(silent=True)
        last = rig.clock()
        rig.clock.sleep(0.5)
        assert rig.link.problem == ""
        assert rig.link.age == pytest.approx(0.5, abs=0.1)
        rig.clock.sleep(7.5)
        # A second of silence, then a pause that doubles: 0.5 s, and 1 s after a silence of another second.
        assert np.diff(rig.dialled) == pytest.approx([last + 1.5, 2.0, 3.0], abs=0.1)
        assert "no connection to the DVL at rig:16171 (nothing heard for 1 s)" in rig.link.problem
        with pytest.raises(ConnectionError):
            rig.link.ask("get_config")
        rig.got.clear()
        rig.a50.faults = DvlFaults()
        rig.clock.sleep(4.0)
        assert rig.link.problem == ""
        assert rig.got
        assert rig.link.age < 0.1


def test_a_question_has_a_time_out_of_its_own_and_keeps_the_connection(pool: World) -> None:
    with Rig(pool, quiet=1.0) as rig:
        rig.clock.sleep(1.0)
        rig.a50.faults = DvlFaults(silent=True)
        began = rig.clock()
        with pytest.raises(TimeoutError, match="get_config: expected a response of the DVL within 2 s"):
            rig.link.ask("get_config", timeout=2.0)
        assert rig.clock() - began == pytest.approx(2.0)
        assert rig.dialled == [0.0]


def test_where_nobody_answers_it_tries_again_after_pauses_that_grow(pool: World) -> None:
    with Rig(pool, pauses=(0.25, 1.0)) as rig:
        rig.unreachable = True
        rig.clock.sleep(4.0)
        assert rig.dialled == pytest.approx([0.0, 0.25, 0.75, 1.75, 2.75, 3.75])
        assert "no connection to the DVL at rig:16171 (Connection refused)" in rig.link.problem
        rig.unreachable = False
        rig.clock.sleep(1.0)
        assert rig.link.connected


def test_cut_off_it_connects_anew_and_closed_it_waits_for_nothing(pool: World) -> None:
    with Rig(pool, pauses=(0.25, 1.0)) as rig:
        rig.clock.sleep(1.0)
        rig.a50.disconnect()
        rig.clock.sleep(1.0)
        assert rig.dialled == pytest.approx([0.0, 1.25], abs=0.02)
        assert rig.link.connected
        began = rig.clock()
        rig.link.close()
        assert rig.clock() == began


def test_both_ends_of_a_pipe_say_when_the_other_is_gone() -> None:
    clock = LockStep()
    pipe = MemoryStream(clock)
    with pytest.raises(BlockingIOError):
        pipe.far.recv(100)
    with pytest.raises(TimeoutError):
        pipe.receive(3.0)
    assert clock() == 3.0
    pipe.send(b"hello")
    assert pipe.far.recv(2) == b"he"
    assert pipe.far.send(b"you") == 3
    pipe.far.close()
    # What was sent before is still read.
    assert pipe.far.recv(100) == b"llo"
    assert pipe.receive(1.0) == b"you"
    assert pipe.far.recv(100) == pipe.receive(1.0) == b""
    with pytest.raises(ConnectionError):
        pipe.send(b"?")
    with pytest.raises(ConnectionError):
        pipe.far.send(b"!")
