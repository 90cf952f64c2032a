"""The dive's log: everything is in it, whatever happens."""

from __future__ import annotations

import io
import json
import logging
import math
import os
import signal
import struct
import subprocess
import sys
import textwrap
import threading
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import dream
from dream.estimation import Ekf, InEkf, Timeline
from dream.evaluation.dive_figure import read_dive
from dream.geometry import SE3
from dream.measurements import Depth, Dvl, Heading, Imu, Measurement
from dream.robots.bluerov2 import devices, mcap
from dream.robots.bluerov2 import log as log_module
from dream.robots.bluerov2.estimates import estimates
from dream.robots.bluerov2.log import (
    DiveLog,
    dive_began,
    read_log,
    read_measurements,
    read_wire,
    recover,
)
from dream.robots.bluerov2.mcap import McapFile
from dream.robots.bluerov2.messages import measurement_text, quaternion, read_measurement
from tests.robots.bluerov2.waiting import until

EPOCH = 1_795_000_000_123_456_789


def motion(seconds: float = 2.0) -> list[Imu | Measurement]:
    """What sensors might say: late, without lock, and with numbers that no decimal holds."""
    rng = np.random.default_rng(3)
    said: list[Imu | Measurement] = []
    for k in range(1, round(50 * seconds) + 1):
        now = k / 50.0 + 1e-4 * rng.random()
        said.append(Imu(now, 0.05 * rng.standard_normal(3), np.array([0.0, 0.0, 9.81]) + 0.1 * rng.random(3)))
        if k % 10 == 0:
            locked = k % 50 != 0
            altitude = 1.0 + rng.random() if locked else math.nan
            covariance = np.eye(3) * 1e-4 * (1.0 + rng.random())
            said.append(Dvl(now - 0.11, 0.1 * rng.standard_normal(3), covariance, altitude, locked))
        if k % 7 == 0:
            said.append(Depth(now - 0.01, -2.0 + 0.01 * rng.random(), 0.01 + 1e-3 * rng.random()))
        if k % 5 == 0:
            said.append(Heading(now, 0.02 * rng.standard_normal(), 0.1 * rng.random() + 0.01))
    return said


def same(one: Imu | Measurement, other: Imu | Measurement) -> bool:
    return measurement_text(one) == measurement_text(other) and type(one) is type(other)


class Packet:
    """As pymavlink's messages are."""

    def __init__(self, data: bytes, name: str = "HEARTBEAT") -> None:
        self._data, self._name = data, name

    def get_msgbuf(self) -> bytearray:
        return bytearray(self._data)

    def get_type(self) -> str:
        return self._name


@dataclass(frozen=True, slots=True)
class Changed:
    state: str
    why: str


@dataclass(frozen=True, slots=True)
class AccessUnit:
    time: float
    data: bytes
    whole: bool
    parameters: bytes


@dataclass(frozen=True, slots=True, eq=False)
class Fix:
    time: float
    T_world_base: SE3
    velocity: Any
    angular_velocity: Any
    position_sigma: float


def png() -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(np.zeros((4, 5, 3), np.uint8)).save(buffer, "PNG")
    return buffer.getvalue()


def tell_all(log: DiveLog) -> None:
    """A bit of everything."""
    for said in motion():
        log.tap(said.time, "navigation", False, said)
    log.tap(1.0, "mavlink", False, Packet(b"\xfe\x01\x00"))
    log.tap(1.1, "mavlink", True, Packet(b"\xfd\x02", "MANUAL_CONTROL"))
    log.tap(1.2, "a50", False, '{"type":"velocity"}')
    log.tap(1.3, "a50", True, '{"command":"get_config"}')
    log.tap(1.4, "camera", False, np.full((48, 64, 3), 90, np.uint8))
    log.tap(1.5, "camera", False, png())
    log.tap(1.5, "camera", False, AccessUnit(1.45, b"\x00\x00\x01\x65key", True, b"\x00\x00\x01\x67par"))
    log.tap(1.5, "camera", False, AccessUnit(1.48, b"\x00\x00\x01\x41next", False, b"\x00\x00\x01\x67par"))
    log.tap(1.6, "state", False, Changed("HOLD", "no velocity"))
    log.tap(1.7, "estimate", False, Ekf().begin(1.7, SE3.level(1.0, 2.0, -3.0, math.pi / 2), (0.0, 0.3, 0.0)))


@pytest.fixture
def told(tmp_path: Path) -> Path:
    with DiveLog(tmp_path, epoch_ns=EPOCH) as log:
        tell_all(log)
    assert (log.problem, log.lost) == ("", {})
    return log.path


def by_topic(path: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    for logged in read_log(path):
        found.setdefault(logged.topic, []).append(logged)
    return found


class TestWhatIsInIt:
    def test_an_independent_reader_finds_the_same(self, told: Path) -> None:
        ours = [(m.topic, m.schema, m.time, m.data) for m in McapFile(told).messages()]
        with Reader(told) as reader:
            store = get_typestore(Stores.ROS2_JAZZY)
            for connection in reader.connections:
                if connection.msgtype not in store.types:
                    store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
            theirs = []
            for connection, stamp, data in reader.messages():
                store.deserialize_cdr(data, connection.msgtype)
                theirs.append((connection.topic, connection.msgtype, stamp, data))
            assert reader.message_count == len(ours)
            assert {c.topic: c.msgcount for c in reader.connections} == {
                topic: sum(1 for m in ours if m[0] == topic) for topic in {m[0] for m in ours}
            }
            for connection in reader.connections:
                assert connection.msgdef.data == store.generate_msgdef(connection.msgtype, ros_version=2)[0]
        # They sort by time, and ours are as they were told.
        assert sorted(theirs) == sorted(ours)

    def test_the_index_leads_to_each_channel(self, told: Path) -> None:
        raw = told.read_bytes()
        with Reader(told) as reader:
            storage: Any = reader.storage
            for chunk in storage.chunks:
                assert raw[chunk.chunk_start_offset] == 6
                for channel, offset in chunk.message_index_offsets.items():
                    assert raw[offset] == 7
                    assert int.from_bytes(raw[offset + 9 : offset + 11], "little") == channel

    def test_frames_and_units_are_those_of_rep_103(self, told: Path) -> None:
        found = by_topic(told)
        estimate = found["/estimate"][0].message
        assert (estimate.header.frame_id, estimate.child_frame_id) == ("map", "base_link")
        assert (estimate.pose.pose.position.x, estimate.pose.pose.position.z) == (1.0, -3.0)
        assert estimate.pose.pose.orientation.z == pytest.approx(math.sqrt(0.5))
        # It heads north and moves north: ahead.
        assert estimate.twist.twist.linear.x == pytest.approx(0.3)
        transform = found["/tf"][0].message.transforms[0]
        assert transform.transform.translation.y == 2.0
        imu = next(m for m in motion() if isinstance(m, Imu))
        first = found["/imu"][0].message
        assert first.linear_acceleration.z == imu.specific_force[2]
        assert first.orientation_covariance[0] == -1.0
        stamp = first.header.stamp.sec * 1_000_000_000 + first.header.stamp.nanosec
        assert stamp == EPOCH + round(1e9 * imu.time)
        assert found["/depth"][0].message.pose.pose.position.z < -1.9

    def test_any_estimate_of_the_pose_is_one(self, tmp_path: Path) -> None:
        fix = Fix(2.0, SE3.level(1.0, 2.0, -3.0, 0.0), np.array([0.1, 0.0, 0.0]), np.zeros(3), 0.2)
        with DiveLog(tmp_path, epoch_ns=EPOCH) as log:
            log.tap(2.0, "estimate", False, fix)
        estimate = by_topic(log.path)["/estimate"][0].message
        assert estimate.pose.pose.position.y == 2.0
        assert estimate.pose.covariance[7] == pytest.approx(0.04)
        assert estimate.twist.twist.linear.x == 0.1

    def test_a_velocity_without_lock_cannot_be_taken_for_one(self, told: Path) -> None:
        dvls = [m for m in motion() if isinstance(m, Dvl)]
        logged = by_topic(told)["/dvl/velocity"]
        assert len(logged) == len(dvls)
        for dvl, one in zip(dvls, logged, strict=True):
            assert math.isnan(one.message.twist.twist.linear.x) is not dvl.valid

    def test_wires_are_kept_byte_by_byte(self, told: Path) -> None:
        assert [(sent, data) for _, sent, data in read_wire(told, "mavlink")] == [
            (False, b"\xfe\x01\x00"),
            (True, b"\xfd\x02"),
        ]
        assert [(round(time, 6), sent, data) for time, sent, data in read_wire(told, "a50")] == [
            (1.2, False, b'{"type":"velocity"}'),
            (1.3, True, b'{"command":"get_config"}'),
        ]
        assert by_topic(told)["/mavlink/sent"][0].message.layout.dim[0].label == "MANUAL_CONTROL"

    def test_pictures_can_be_opened(self, told: Path) -> None:
        jpeg, other = (logged.message for logged in by_topic(told)["/camera/image"])
        assert (jpeg.format, other.format) == ("jpeg", "png")
        assert Image.open(io.BytesIO(jpeg.data.tobytes())).size == (64, 48)
        assert other.data.tobytes() == png()

    def test_video_can_be_decoded_from_each_whole_picture_on(self, told: Path) -> None:
        first, second = (logged.message for logged in by_topic(told)["/camera/video"])
        assert first.data.tobytes() == b"\x00\x00\x01\x67par\x00\x00\x01\x65key"
        assert second.data.tobytes() == b"\x00\x00\x01\x41next"
        assert first.timestamp.sec * 1_000_000_000 + first.timestamp.nanosec == EPOCH + 1_450_000_000

    def test_states_are_json(self, told: Path) -> None:
        text = by_topic(told)["/state"][0].message.data
        assert json.loads(text) == {"time": 1.6, "said": {"state": "HOLD", "why": "no velocity"}}

    def test_what_nobody_foresaw_is_told_as_text(self, tmp_path: Path) -> None:
        odd: list[Any] = [object(), {1: {2}}, None, math.nan, b"\x00", np.zeros((2, 2)), ["x", (1,)]]
        with DiveLog(tmp_path, epoch_ns=EPOCH) as log:
            for thing in odd:
                log.tap(math.nan, "odd/channel name!", False, thing)
        assert log.lost == {}
        assert len(list(read_log(log.path))) == len(odd)

    def test_what_cannot_be_logged_is_counted(self, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
        class Broken:
            def get_msgbuf(self) -> bytes:
                raise RuntimeError("gone")

        with DiveLog(tmp_path, epoch_ns=EPOCH) as log:
            log.tap(0.0, "mavlink", False, Broken())
            log.tap(0.0, "a50", False, "fine")
        assert log.lost == {"mavlink": 1}
        assert "mavlink" in log.problem
        assert "mavlink" in caplog.text
        assert by_topic(log.path)["/a50/received"][0].message.data == "fine"
        assert json.loads(by_topic(log.path)["/log"][0].message.data)["lost"] == {"mavlink": 1}


class TestExactness:
    @pytest.mark.parametrize(
        "said", [*motion()[:60:7], Dvl(0.1, np.full(3, 1 / 3), np.eye(3), math.nan, False)]
    )
    def test_a_measurement_comes_back_to_the_last_bit(self, said: Imu | Measurement) -> None:
        again = read_measurement(measurement_text(said))
        assert same(said, again)
        for name in ("time", "velocity", "specific_force", "sigma", "valid"):
            if hasattr(said, name):
                assert np.array_equal(getattr(said, name), getattr(again, name))

    @pytest.mark.parametrize(
        "text", ["", "[]", "{}", '{"kind":"gps"}', '{"kind":"depth","time":1}', '{"kind":"imu","time":"x"}']
    )
    def test_another_text_is_refused(self, text: str) -> None:
        with pytest.raises(ValueError, match="measurement: expected one as it is logged"):
            read_measurement(text)

    @pytest.mark.parametrize("estimator", [InEkf(), Ekf()], ids=["inekf", "ekf"])
    def test_an_estimate_is_made_again_bit_for_bit(self, told: Path, estimator: Any) -> None:
        begin = estimator.begin(0.0, SE3.level(0.0, 0.0, -2.0, 0.0))
        flown, again = Timeline(estimator, begin), Timeline(estimator, begin)
        for said, read in zip(motion(), read_measurements(told), strict=True):
            assert repr(flown.take(said)) == repr(again.take(read))
        assert flown.state.time > 1.9
        for name in ("position", "velocity", "covariance", "gyro_bias"):
            assert getattr(flown.state, name).tobytes() == getattr(again.state, name).tobytes()

    def test_a_rotation_becomes_its_quaternion(self) -> None:
        rng = np.random.default_rng(1)
        turns = [np.eye(3), *(np.diag(signs) for signs in ([1, -1, -1], [-1, 1, -1], [-1, -1, 1]))]
        for _ in range(50):
            q, _r = np.linalg.qr(rng.standard_normal((3, 3)))
            turns.append(q * np.sign(np.linalg.det(q)))
        for rotation in turns:
            w, x, y, z = quaternion(rotation.astype(np.float64))
            assert w >= 0.0
            made = [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
            np.testing.assert_allclose(made, rotation, atol=1e-12)


PAGE = 4096


@pytest.fixture
def chunked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A log of many chunks, whose types are told again after every fourth."""
    monkeypatch.setattr(log_module, "CHUNK", 4000)
    monkeypatch.setattr(mcap, "REPEATED", 4)
    with DiveLog(tmp_path, epoch_ns=EPOCH) as log:
        for said in motion(4.0):
            log.tap(said.time, "navigation", False, said)
    return log.path


def without_first_imus(said: list[Imu | Measurement], count: int) -> list[str]:
    """As text, but for the first of them."""
    dropped = [one for one in said if isinstance(one, Imu)][:count]
    return [measurement_text(one) for one in said if not any(one is other for other in dropped)]


def short_dive(folder: Path) -> Path:
    """Half a second of all that is read of a log again."""
    begun = Ekf().begin(0.0, SE3.level(0.0, 0.0, -2.0, 0.0), (0.0, 0.0, 0.0))
    with DiveLog(folder, epoch_ns=EPOCH) as log:
        log.tap(0.0, "mounting", False, {"dvl": [-0.15, 0.0, -0.1], "gauge": [-0.2, 0.0, 0.0]})
        log.tap(0.0, "begun", False, devices._plain(begun))
        for said in motion(0.5):
            log.tap(said.time, "measurement", False, said)
            log.tap(said.time, "estimate", False, replace(begun, time=said.time))
        log.tap(0.4, "standing", True, {"stance": "go", "reason": ""})
        log.tap(0.4, "goal", True, {"x": 1.0, "y": 0.0, "yaw": 0.1, "altitude": 0.6})
        log.tap(0.4, "a50", False, '{"type":"velocity"}')
        log.tap(0.4, "mavlink", True, Packet(b"\xfe\x01\x00"))
    return log.path


def spoilt(raw: bytes, rng: np.random.Generator) -> bytes:
    """As disks, power cuts and copies leave files: up to three damages of some kinds."""
    bad = bytearray(raw)
    for kind in rng.integers(0, 7, rng.integers(1, 4)):
        at = int(rng.integers(0, max(len(bad), 1)))
        if kind == 0:
            del bad[at:]
        elif kind == 1:
            page = slice(at // PAGE * PAGE, at // PAGE * PAGE + PAGE)
            bad[page] = bytes(len(bad[page]))
        elif kind == 2:
            sector = at // 512 * 512
            bad[sector:] = bytes(len(bad) - sector)
        elif kind == 3:
            some = slice(at, at + int(rng.integers(1, 600)))
            bad[some] = rng.bytes(len(bad[some]))
        elif kind == 4:
            del bad[at : at + int(rng.integers(1, 5000))]
        elif kind == 5 and bad:
            bad[at] ^= int(rng.integers(1, 256))
        else:
            bad[at:at] = rng.bytes(int(rng.integers(1, 100)))
    return bytes(bad)


class TestTornFiles:
    def test_every_truncation_reads_a_beginning_of_it(self, told: Path, tmp_path: Path) -> None:
        raw, whole = told.read_bytes(), [tuple(m) for m in McapFile(told).messages()]
        torn = tmp_path / "torn.mcap"
        counts = []
        for size in [8, 9, 20, *range(100, len(raw), 997), len(raw) - 1]:
            torn.write_bytes(raw[:size])
            file = McapFile(torn)
            read = [tuple(m) for m in file.messages()]
            assert read == whole[: len(read)]
            assert not file.whole
            counts.append(len(read))
        assert counts == sorted(counts)
        assert counts[-1] == len(whole)

    def test_a_torn_log_is_mended(self, told: Path, tmp_path: Path) -> None:
        torn, mended = tmp_path / "torn.mcap", tmp_path / "mended.mcap"
        torn.write_bytes(told.read_bytes()[: told.stat().st_size // 2])
        count = recover(torn, mended)
        assert count > 10
        assert McapFile(mended).whole
        assert list(McapFile(mended).messages()) == list(McapFile(torn).messages())
        with Reader(mended) as reader:
            assert reader.message_count == count
        with pytest.raises(FileExistsError):
            recover(torn, mended)

    def test_a_damaged_chunk_is_left_out_and_told(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ) -> None:
        monkeypatch.setattr(log_module, "CHUNK", 5000)
        with DiveLog(tmp_path, epoch_ns=EPOCH) as log:
            tell_all(log)
        whole = list(McapFile(log.path).messages())
        raw = bytearray(log.path.read_bytes())
        raw[len(raw) // 3] ^= 0xFF
        log.path.write_bytes(raw)
        file = McapFile(log.path)
        left = list(file.messages())
        assert len(file.damage) == 1
        assert "checksum is wrong" in file.damage[0]
        assert 0 < len(whole) - len(left) < len(whole) // 3
        assert whole[0] == left[0]
        assert whole[-1] == left[-1]
        assert recover(log.path, tmp_path / "mended.mcap") == len(left)
        assert "checksum is wrong" in caplog.text

    def test_no_damage_does_more_than_lose_messages(self, told: Path, tmp_path: Path) -> None:
        raw, whole = told.read_bytes(), set(McapFile(told).messages())
        rng = np.random.default_rng(5)
        bad = tmp_path / "bad.mcap"
        # The records outside of chunks have no checksum: all their bytes are tried, and others by chance.
        for at in [*range(8, 250), *rng.integers(250, len(raw), 150)]:
            changed = bytearray(raw)
            changed[at] ^= int(rng.integers(1, 256))
            bad.write_bytes(changed)
            with suppress(ValueError):  # It may seem to be compressed.
                assert set(McapFile(bad).messages()) <= whole

    @pytest.mark.parametrize("place", [0.0, 0.2, 0.45, 0.7, 0.97])
    def test_a_page_of_zeros_costs_what_lay_there(
        self, place: float, chunked: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        whole = [(one.time, one.topic) for one in read_log(chunked)]
        raw = bytearray(chunked.read_bytes())
        page = int(place * len(raw)) // PAGE * PAGE
        raw[page : page + PAGE] = bytes(len(raw[page : page + PAGE]))
        chunked.write_bytes(raw)
        left = [(one.time, one.topic) for one in read_log(chunked)]
        assert set(left) <= set(whole)
        assert len(left) > 0.6 * len(whole)
        assert f"of its {len(raw)} bytes are left out" in caplog.text
        assert recover(chunked, chunked.with_name("mended.mcap")) == len(left)

    @pytest.mark.parametrize("place", [0.3, 0.6, 0.9])
    def test_zeros_to_the_end_as_a_power_cut_leaves_them_end_it(self, place: float, chunked: Path) -> None:
        whole = [(one.time, one.topic) for one in read_log(chunked)]
        raw = chunked.read_bytes()
        kept = int(place * len(raw)) // PAGE * PAGE
        chunked.write_bytes(raw[:kept].ljust(len(raw), b"\0"))
        left = [(one.time, one.topic) for one in read_log(chunked)]
        assert left == whole[: len(left)]
        assert len(left) > (place - 0.2) * len(whole)

    @pytest.mark.parametrize("place", [0.1, 0.3, 0.5])
    def test_of_a_torn_end_nothing_counts_from_a_sector_on_that_was_never_written(
        self, place: float, told: Path
    ) -> None:
        whole, raw = list(McapFile(told).messages()), bytearray(told.read_bytes())
        sector = int(place * len(raw)) // 512 * 512
        raw[sector : sector + 512] = bytes(512)
        told.write_bytes(raw[: int(0.7 * len(raw))])
        left = list(McapFile(told).messages())
        assert left == whole[: len(left)]

    def test_what_a_torn_end_says_may_be_anything_and_is_passed_over(self, told: Path) -> None:
        raw = told.read_bytes()
        told.write_bytes(raw[: int(0.7 * len(raw))])
        whole = list(read_measurements(told))
        told.write_bytes(raw[: int(0.7 * len(raw))].replace(b'"kind":"imu"', b'"kind":"eel"', 3))
        assert [measurement_text(one) for one in read_measurements(told)] == without_first_imus(whole, 3)

    def test_where_the_chunk_that_told_the_types_is_lost_the_end_tells_them(
        self, chunked: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setattr(mcap, "REPEATED", 1 << 30)
        (folder := tmp_path / "told once").mkdir()
        with DiveLog(folder, epoch_ns=EPOCH) as log:
            for said in motion(1.0):
                log.tap(said.time, "navigation", False, said)
        whole, raw = list(McapFile(log.path).messages()), bytearray(log.path.read_bytes())
        first = next(at for at, kind, *_ in McapFile(log.path)._records() if kind == 6)
        raw[first + 60] ^= 0xFF
        log.path.write_bytes(raw)
        left = list(McapFile(log.path).messages())
        assert left == whole[len(whole) - len(left) :]
        assert len(left) > 0.3 * len(whole)

    @pytest.mark.parametrize("garbage", [b"\x06" * 3000, b"\xff" * 5000, b"GET / HTTP/1.1\r\n" * 99, b"\x00"])
    def test_after_garbage_in_the_middle_it_goes_on(self, garbage: bytes, chunked: Path) -> None:
        whole = list(McapFile(chunked).messages())
        raw = chunked.read_bytes()
        middle = len(raw) // 2
        chunked.write_bytes(raw[:middle] + garbage + raw[middle:])
        file = McapFile(chunked)
        left = list(file.messages())
        assert set(left) <= set(whole)
        assert (left[0], left[-1]) == (whole[0], whole[-1])
        assert len(left) > 0.8 * len(whole)
        assert len(garbage) <= file.left_out < len(garbage) + 20_000

    def test_a_wrong_length_hides_nothing_that_comes_after(self, chunked: Path) -> None:
        whole = list(McapFile(chunked).messages())
        raw = bytearray(chunked.read_bytes())
        chunks = [at for at, kind, *_ in McapFile(chunked)._records() if kind == 6]
        raw[chunks[3] + 4] = 0x20  # Half a gigabyte.
        chunked.write_bytes(raw)
        left = list(McapFile(chunked).messages())
        assert left[-1] == whole[-1]
        assert len(whole) - len(left) < 0.3 * len(whole)

    @pytest.mark.parametrize("ended", [True, False])
    def test_where_the_beginning_is_lost_types_and_the_time_are_told_again(
        self, ended: bool, chunked: Path
    ) -> None:
        whole = {(one.time, one.topic) for one in read_log(chunked)}
        raw = bytearray(chunked.read_bytes())
        raw[: 3 * PAGE] = bytes(3 * PAGE)
        chunked.write_bytes(raw if ended else raw[: int(0.9 * len(raw))])
        left = {(one.time, one.topic) for one in read_log(chunked)}
        assert left <= whole
        assert len(left) > 0.5 * len(whole)
        assert dive_began(chunked.parent) == datetime.fromtimestamp(EPOCH / 1e9, UTC)

    @pytest.mark.parametrize("content", [b"", bytes(8), bytes(3 * 4096)])
    def test_a_log_that_never_reached_the_disk_is_empty(
        self, content: bytes, tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        log = tmp_path / "log.mcap"
        log.write_bytes(content)
        assert [*read_log(log), *read_measurements(log)] == []
        assert dive_began(tmp_path) is None
        assert "is read as far as it goes" in caplog.text

    def test_a_file_made_to_be_looked_through_again_and_again_is_not(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(mcap, "MOST_BYTES", 1 << 20)
        size, count = 60_000, 1000
        begin = b"".join(struct.pack("<BQQQQIIQ", 6, size + 40, 0, 1, size, 1, 0, size) for _ in range(count))
        log = tmp_path / "log.mcap"
        log.write_bytes(mcap.MAGIC + begin + bytes(size))
        looked: list[int] = []

        def judged(body: bytes) -> str:
            looked.append(len(body))
            return judge(body)

        judge = mcap._wrong_with
        monkeypatch.setattr(mcap, "_wrong_with", judged)
        file = McapFile(log)
        assert list(file.messages()) == []
        assert len(file.damage) <= mcap.MOST_TOLD
        assert 1 < len(looked) < 50

    def test_no_damage_is_more_than_a_warning_to_whoever_reads(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(log_module, "CHUNK", 6000)
        monkeypatch.setattr(mcap, "REPEATED", 4)
        logging.disable(logging.WARNING)
        raw = short_dive(tmp_path).read_bytes()
        bad, mended = tmp_path / "log.mcap", tmp_path / "mended.mcap"
        readers: dict[str, Callable[[], object]] = {
            "log": lambda: list(read_log(bad)),
            "measurements": lambda: list(read_measurements(bad)),
            "wire": lambda: list(read_wire(bad, "a50")),
            "began": lambda: dive_began(tmp_path),
            "estimates": lambda: list(estimates(bad, ("dead-reckoning",))),
            "figure": lambda: read_dive(tmp_path),
            "recover": lambda: recover(bad, mended),
        }
        came: Counter[str] = Counter()
        refused: set[str] = set()
        for seed in range(45):
            bad.write_bytes(spoilt(raw, np.random.default_rng(seed)))
            for name, read in readers.items():
                try:
                    read()
                    came[name] += 1
                except ValueError as error:
                    refused.add(str(error).removeprefix(f"{bad}: "))
            mended.unlink(missing_ok=True)
        logging.disable(logging.NOTSET)
        assert min(came.values()) > 20
        # Of one that tells nothing of what is asked for.
        assert refused <= {
            "expected estimates of the pose, got none. Did the dive begin?",
            "expected where the estimate of the dive began, got no /begun in it",
            "expected the log of a dive, got one without its epoch",
            "expected an MCAP file, got another beginning",
        }

    def test_something_else_is_refused(self, tmp_path: Path) -> None:
        other = tmp_path / "other.mcap"
        with pytest.raises(FileNotFoundError, match="expected a log"):
            list(read_log(other))
        other.write_bytes(b"SQLite format 3")
        with pytest.raises(ValueError, match="another beginning"):
            list(read_log(other))

    def test_a_killed_process_loses_less_than_a_second(self, tmp_path: Path) -> None:
        code = """
            import sys, time
            from pathlib import Path
            from dream.robots.bluerov2.log import DiveLog

            began = time.monotonic()
            log = DiveLog(Path(sys.argv[1]), epoch_ns=0)
            while True:
                now = time.monotonic() - began
                log.tap(now, "a50", False, repr(now))
                print(now, flush=True)
                time.sleep(0.01)
        """
        child = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(code), str(tmp_path)],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": str(Path(dream.__file__).parents[1])},
        )
        assert child.stdout is not None
        with child.stdout:
            for line in child.stdout:
                last = float(line)
                if last > 1.5:
                    break
            os.kill(child.pid, signal.SIGKILL)
            rest = child.stdout.read().split("\n")[:-1]
        child.wait()
        told = float(rest[-1]) if rest else last
        times = [float(logged.message.data) for logged in read_log(tmp_path / "log.mcap")]
        assert times == sorted(times)
        assert times[-1] > told - 1.0
        assert not McapFile(tmp_path / "log.mcap").whole


class TestTrouble:
    def test_telling_never_waits_for_the_disk(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        stuck, writing = threading.Event(), threading.Event()
        write = FileIO.write

        class Slow(FileIO):
            def write(self, data: Any) -> int:
                if len(data) > 5000:
                    writing.set()
                    stuck.wait(10.0)
                return write(self, data)

        monkeypatch.setattr("dream.robots.bluerov2.mcap.FileIO", Slow)
        log = DiveLog(tmp_path, epoch_ns=EPOCH, room=100_000)
        log.tap(0.0, "a50", False, "x" * 6000)
        assert writing.wait(5.0)
        for k in range(200):
            log.tap(0.1 * k, "a50", False, "y" * 1000)
        lost = log.lost["a50"]
        assert 50 < lost < 200
        assert "behind" in log.problem
        stuck.set()
        log.close()
        assert len(list(read_wire(log.path, "a50"))) == 201 - lost
        assert json.loads(by_topic(log.path)["/log"][-1].message.data)["lost"] == {"a50": lost}

    def test_a_full_disk_is_told_and_gone_over(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        full = threading.Event()
        write = FileIO.write

        class Full(FileIO):
            def write(self, data: Any) -> int:
                if full.is_set():
                    write(self, bytes(data[:10]))
                    raise OSError(28, "No space left on device")
                return write(self, data)

        monkeypatch.setattr("dream.robots.bluerov2.mcap.FileIO", Full)
        monkeypatch.setattr(log_module, "FLUSH", 0.0)
        monkeypatch.setattr(log_module, "LOOK", 0.01)
        with DiveLog(tmp_path, epoch_ns=EPOCH) as log:
            log.tap(0.0, "a50", False, "before")
            assert until(lambda: log.written >= 1)
            size = log.path.stat().st_size
            full.set()
            log.tap(1.0, "a50", False, "lost")
            log.tap(1.0, "state", False, "lost")
            assert until(lambda: sum(log.lost.values()) == 2)
            assert "No space left on device" in log.problem
            assert log.path.stat().st_size == size
            full.clear()
            log.tap(2.0, "state", False, "after")
            assert until(lambda: log.written >= 2)
        assert log.lost == {"a50": 1, "state": 1}
        assert McapFile(log.path).whole
        assert [
            logged.message.data for logged in read_log(log.path, ("/a50/received", "/state/received"))
        ] == [
            "before",
            "after",
        ]
        assert json.loads(by_topic(log.path)["/log"][-1].message.data)["lost"] == {"a50": 1, "state": 1}

    def test_two_logs_do_not_share_a_folder(self, tmp_path: Path) -> None:
        with DiveLog(tmp_path, epoch_ns=EPOCH), pytest.raises(ValueError, match="expected a folder without"):
            DiveLog(tmp_path, epoch_ns=EPOCH)
        with pytest.raises(OSError, match="expected a folder that can be written"):
            DiveLog(tmp_path / "nowhere", epoch_ns=EPOCH)

    def test_after_close_nothing_is_taken_silently(self, tmp_path: Path) -> None:
        with DiveLog(tmp_path, epoch_ns=EPOCH) as log:
            pass
        log.tap(0.0, "a50", False, "late")
        assert log.lost == {"a50": 1}
        assert list(read_log(log.path)) == []

    def test_threads_may_tell_at_once(self, tmp_path: Path) -> None:
        with DiveLog(tmp_path, epoch_ns=EPOCH) as log:

            def tell(name: str) -> None:
                for k in range(300):
                    log.tap(float(k), name, False, str(k))

            threads = [threading.Thread(target=tell, args=(name,)) for name in "abc"]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
        for name in "abc":
            assert [data for _, _, data in read_wire(log.path, name)] == [b"%d" % k for k in range(300)]
