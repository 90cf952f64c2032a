"""A live camera gives the newest picture or a reason, whatever its source does."""

import itertools
import queue
import re
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from dream.extras import missing
from dream.geometry import camera_mount
from dream.robots.bluerov2.camera import (
    LATE,
    Frames,
    LiveCamera,
    Picture,
    RtpVideo,
    RtspVideo,
    Source,
    State,
    VideoDevice,
    VideoFile,
    mounted,
)
from dream.robots.bluerov2.rtp import AccessUnit
from dream.robots.bluerov2.standin import h264
from dream.robots.bluerov2.standin.lockstep import LockStep
from dream.robots.bluerov2.standin.video import Faults, UInt8Array, VideoSource, packets

WAIT = 8.0
"""Seconds that a picture is waited for; it comes within a tenth of one."""


def level(k: int) -> UInt8Array:
    """A picture that says its number, 0 to 31, in its brightness."""
    return np.full((48, 64, 3), 4 + 8 * (k % 32), np.uint8)


def number(rgb: UInt8Array) -> int:
    return round((float(rgb.mean()) - 4.0) / 8.0)


def counting() -> Callable[[], UInt8Array]:
    count = itertools.count()
    return lambda: level(next(count))


class Hand:
    """Sends single pictures, and tells the camera the time it should see."""

    def __init__(self, **more: object) -> None:
        self.time = 0.0
        self.told: list[tuple[object, ...]] = []
        self._heard = threading.Condition()
        self.camera = LiveCamera(
            RtpVideo(port=0, **more),  # type: ignore[arg-type]
            lambda: self.time,
            self._tap,
        )
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sequence = self._sent = 0

    def __enter__(self) -> "Hand":
        return self

    def __exit__(self, *_: object) -> None:
        self.camera.close()
        self._socket.close()

    def send(self, rgb: UInt8Array, at: float, *, stamp: float | None = None) -> Picture:
        """The picture that the camera makes of it."""
        self.send_units(h264.encode(h264.yuv420(rgb), self._sent), at, stamp=stamp)
        return self.camera.after(at - self.camera.source.latency, WAIT)

    def send_units(self, units: list[bytes], at: float, *, stamp: float | None = None) -> None:
        self.time = at
        ticks = round(90_000 * (at if stamp is None else stamp))
        for packet in packets(units, sequence=self._sequence, stamp=ticks, ssrc=1):
            self._socket.sendto(packet, ("127.0.0.1", self.camera.port))
            self._sequence += 1
        self._sent += 1

    def wait_until_told(self, count: int) -> None:
        """Until that many pictures were received, decoded or not."""
        with self._heard:
            assert self._heard.wait_for(lambda: len(self.told) >= count, WAIT)

    def _tap(self, *record: object) -> None:
        with self._heard:
            self.told.append(record)
            self._heard.notify_all()


def test_each_picture_comes_without_waiting_for_the_next() -> None:
    with Hand() as hand:
        for k in range(12):
            picture = hand.send(level(k), 0.1 * (k + 1))
            assert number(picture.rgb) == k
            assert picture.time == pytest.approx(0.1 * (k + 1))
        assert hand.camera.counts.received == 12
        assert hand.camera.counts.corrupt == 0


def test_a_picture_is_as_large_as_it_was_sent_and_in_the_right_colours() -> None:
    red = np.zeros((50, 70, 3), np.uint8)
    red[...] = (200, 40, 90)
    with Hand() as hand:
        picture = hand.send(red, 1.0)
    assert picture.rgb.shape == red.shape
    assert np.abs(picture.rgb.astype(int) - red).max() <= 4
    with pytest.raises(ValueError):
        picture.rgb[0, 0] = 0


def test_what_it_was_seen_before_it_came_is_taken_off() -> None:
    with Hand(latency=0.25) as hand:
        picture = hand.send(level(1), 3.0)
        assert picture.time == pytest.approx(2.75)
        assert picture.age == pytest.approx(0.25)
        hand.time = 3.5
        assert hand.camera.newest(1.0).age == pytest.approx(0.75)


def test_an_old_picture_is_not_given_and_the_reason_is() -> None:
    with Hand() as hand:
        with pytest.raises(TimeoutError, match=r"no picture yet \(limit 0.5 s\).*RTP at 127.0.0.1:\d+"):
            hand.camera.newest(0.5)
        assert hand.camera.state(0.5, moving=True) is State.WAITING
        hand.send(level(0), 2.0)
        assert (hand.camera.connected, hand.camera.problem) == (True, "")
        assert hand.camera.state(0.5, moving=True) is State.LIVE
        hand.time = 3.25
        with pytest.raises(TimeoutError, match=r"no picture for 1.2 s \(limit 0.5 s\)"):
            hand.camera.newest(0.5)
        assert hand.camera.state(0.5, moving=True) is State.STALE
        assert hand.camera.connected is False
        assert "1.2 s" in hand.camera.problem
        assert hand.camera.newest(2.0).age == pytest.approx(1.25)


def test_the_same_picture_while_the_vehicle_moves_is_frozen() -> None:
    with Hand() as hand:
        for at in (1.0, 2.0, 2.9):
            hand.send(level(5), at)
        assert hand.camera.state(0.5, moving=True) is State.LIVE
        hand.send(level(5), 3.1)
        assert hand.camera.unchanged == pytest.approx(2.1)
        assert hand.camera.state(0.5, moving=True) is State.FROZEN
        assert hand.camera.state(0.5, moving=False) is State.LIVE
        hand.send(level(6), 3.2)
        assert hand.camera.unchanged == 0.0
        assert hand.camera.state(0.5, moving=True) is State.LIVE


def test_a_picture_that_was_held_up_counts_as_late() -> None:
    with Hand() as hand:
        for k in range(5):
            hand.send(level(k), 1.0 + 0.1 * k)
        assert hand.camera.counts.late == 0
        hand.send(level(6), 1.5 + 1.1 * LATE, stamp=1.5)
        assert hand.camera.counts.late == 1
        hand.send(level(7), 1.8, stamp=1.8)
        assert hand.camera.counts.late == 1
        # What was quickest is remembered for longer than until the next look at the clocks' drift.
        hand.send(level(8), 11.0 + 1.1 * LATE, stamp=11.0)
        assert hand.camera.counts.late == 2


def test_another_size_needs_no_new_camera() -> None:
    with Hand() as hand:
        hand.send(level(0), 1.0)
        for k, shape in enumerate([(96, 128, 3), (32, 32, 3), (48, 64, 3)]):
            picture = hand.send(np.full(shape, 100, np.uint8), 2.0 + k)
            assert picture.rgb.shape == shape
            assert abs(picture.rgb.mean() - 100) < 4


def as_before(frame: int) -> list[bytes]:
    """A P picture of 48 × 64 pixels that skips all 12 macroblocks (H.264, 7.3.3 and 7.3.4)."""
    # first_mb 0, slice_type P, PPS 0, frame_num, no overrides, QP as it is, filter off, skip 12, stop bit.
    bits = "1" + "00110" + "1" + format(frame, "04b") + "0" + "0" + "1" + "010" + "0001101" + "1"
    bits += "0" * (-len(bits) % 8)
    return [b"\x01" + int(bits, 2).to_bytes(len(bits) // 8, "big")]


def test_a_picture_that_builds_on_the_one_before_is_decoded() -> None:
    with Hand() as hand:
        first = hand.send(level(9), 1.0)
        for k in range(5):
            hand.send_units(as_before(1), 2.0 + k)
            again = hand.camera.after(2.0 + k, WAIT)
            assert np.array_equal(again.rgb, first.rgb)
        assert number(hand.send(level(3), 9.0).rgb) == 3
        assert hand.camera.counts.received == 7


def test_a_decoder_that_is_behind_goes_on_with_the_newest_picture() -> None:
    with Hand() as hand:
        hand.send(level(0), 1.0)
        with hand.camera._changed:  # The decoder waits here with the next picture.
            for k in range(1, 9):
                hand.send_units(h264.encode(h264.yuv420(level(k)), k), 1.0 + k)
                hand.wait_until_told(1 + k)
        picture = hand.camera.after(9.0, WAIT)
        assert number(picture.rgb) == 8
        assert picture.time == pytest.approx(9.0)
        counts = hand.camera.counts
        assert counts.dropped >= 5
        assert counts.received + counts.dropped == 9


def test_a_stream_without_parameters_says_what_is_missing() -> None:
    with Hand() as hand:
        hand.send_units(h264.encode(h264.yuv420(level(0)), 0)[2:], 1.0)
        hand.send_units(h264.encode(h264.yuv420(level(0)), 1)[2:], 2.0)
        hand.wait_until_told(1)
        with pytest.raises(TimeoutError, match="no whole picture with its parameters"):
            hand.camera.newest(1.0)


def test_what_came_is_told_as_it_came() -> None:
    with Hand() as hand:
        hand.send(level(3), 1.0)
        hand.send(level(4), 2.0)
    units = [record[3] for record in hand.told if isinstance(record[3], AccessUnit)]
    assert [record[:3] for record in hand.told] == [(1.0, "camera", False), (2.0, "camera", False)]
    start = b"\x00\x00\x00\x01"
    assert units[1].data == b"".join(start + unit for unit in h264.encode(h264.yuv420(level(4)), 1))


def test_a_steady_source_is_seen_in_order() -> None:
    with LiveCamera(RtpVideo(port=0), time.monotonic) as camera:
        with VideoSource(counting(), ("127.0.0.1", camera.port), fps=40.0):
            seen, since = [], 0.0
            for _ in range(10):
                picture = camera.after(since, WAIT)
                since = np.nextafter(picture.time, np.inf)
                seen.append(number(picture.rgb))
        assert all(0 < (b - a) % 32 < 16 for a, b in itertools.pairwise(seen))
        assert camera.counts.corrupt == 0


@pytest.mark.parametrize("faults", [Faults(loss=0.05), Faults(corrupt=0.05)])
def test_lost_and_broken_packets_are_counted_and_lived_with(faults: Faults) -> None:
    with LiveCamera(RtpVideo(port=0), time.monotonic) as camera:
        with VideoSource(counting(), ("127.0.0.1", camera.port), fps=100.0) as source:
            camera.after(0.0, WAIT)
            source.faults = faults
            while camera.counts.corrupt < 3:
                camera.after(time.monotonic(), WAIT)
            source.faults = Faults()
            camera.after(time.monotonic(), WAIT)
            counts = camera.counts
        assert counts.lost > 0
        assert counts.received > 0
        assert sum(counts.refused.values()) > 0 or not faults.corrupt


def test_a_source_that_ends_and_begins_again_is_seen_again() -> None:
    with LiveCamera(RtpVideo(port=0), time.monotonic) as camera:
        for seed in range(2):
            with VideoSource(counting(), ("127.0.0.1", camera.port), fps=50.0, seed=seed):
                camera.after(time.monotonic(), WAIT)
        with VideoSource(counting(), ("127.0.0.1", camera.port), fps=50.0, seed=3) as source:
            camera.after(time.monotonic(), WAIT)
            source.faults = Faults(silent=True)
            sent = source.sent
            source.faults = Faults()
            camera.after(time.monotonic(), WAIT)
            assert source.sent >= sent


def test_closing_ends_the_thread_and_whoever_waits() -> None:
    camera = LiveCamera(RtpVideo(port=0), time.monotonic)
    ended: queue.Queue[str] = queue.Queue()

    def wait() -> None:
        try:
            camera.after(0.0, 100.0)
        except TimeoutError as error:
            ended.put(str(error))

    waiting = threading.Thread(target=wait)
    waiting.start()
    camera.close()
    assert "no picture" in ended.get(timeout=WAIT)
    waiting.join(WAIT)
    assert not [thread for thread in threading.enumerate() if thread.name == "camera"]


def test_closing_while_pictures_come_ends_the_thread() -> None:
    with LiveCamera(RtpVideo(port=0), time.monotonic) as camera:
        with VideoSource(counting(), ("127.0.0.1", camera.port), fps=50.0):
            camera.after(0.0, WAIT)
            camera.close()
        assert not [thread for thread in threading.enumerate() if thread.name == "camera"]
        camera.newest(WAIT)


def test_a_port_that_is_taken_is_a_problem_until_it_is_free() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        camera = LiveCamera(RtpVideo(port=port), time.monotonic)
        with pytest.raises(TimeoutError, match="got one that another program has"):
            camera.newest(1.0)
    with camera, VideoSource(counting(), ("127.0.0.1", port), fps=50.0):
        camera.after(0.0, WAIT)
        assert camera.problem == ""


def test_a_film_is_shown_once(tmp_path: Path) -> None:
    path = tmp_path / "film.h264"
    path.write_bytes(
        b"".join(
            b"\x00\x00\x00\x01" + unit
            for k in range(4)
            for unit in h264.encode(h264.yuv420(level(k)), k, fps=60.0)
        )
    )
    told: list[object] = []
    ticks = itertools.count()
    camera = LiveCamera(VideoFile(path), lambda: float(next(ticks)), lambda *record: told.append(record[3]))
    with camera, pytest.raises(TimeoutError, match=r"film\.h264 ended"):
        camera.after(float("inf"), 0.5)
    assert [number(picture.rgb) for picture in told if isinstance(picture, Picture)] == [0, 1, 2, 3]


class Drawn:
    """Pictures of a simulated camera, ten a second by its clock, but for some of them."""

    def __init__(self, silent: range = range(0), *, breaks: int = -1) -> None:
        self.clock = LockStep(100.0)
        self.drawn = 0
        self.silent, self.breaks = silent, breaks

    def frames(self, closed: Callable[[], bool]) -> Iterator[tuple[float, UInt8Array]]:
        while not closed():
            self.clock.sleep(0.1)
            k, self.drawn = self.drawn, self.drawn + 1
            if k == self.breaks:
                raise OSError("the light is out")
            if k not in self.silent:
                yield self.clock(), level(k)

    def camera(self, latency: float = 0.0, told: list[Picture] | None = None) -> LiveCamera:
        def tap(time: float, channel: str, sent: bool, picture: object) -> None:
            if told is not None and isinstance(picture, Picture):
                told.append(picture)

        return LiveCamera(Frames(self.frames, latency), self.clock, tap, threads=self.clock)


def test_a_camera_on_a_simulated_clock_waits_by_that_clock_alone() -> None:
    drawn, told = Drawn(), list[Picture]()
    with drawn.camera(0.05, told) as camera:
        first = camera.after(100.0, 1.0)
        assert (number(first.rgb), first.time, first.age) == pytest.approx((0, 100.05, 0.05))
        late = camera.after(160.0, 100.0)
        assert late.time == pytest.approx(160.05)
        assert drawn.clock() == pytest.approx(160.1)
        assert camera.counts.received == len(told) == 601
    assert drawn.drawn == 602


def test_the_same_pictures_come_at_the_same_times_every_time() -> None:
    def course() -> list[tuple[float, float, float]]:
        drawn, seen = Drawn(range(5, 30)), []
        with drawn.camera() as camera:
            for _ in range(8):
                drawn.clock.sleep(0.47)
                seen.append((drawn.clock(), camera.age, float(camera.connected)))
        return seen

    first = course()
    assert first == course()
    assert [bool(connected) for _, _, connected in first] == [True] * 3 + [False] * 3 + [True] * 2


def test_a_picture_is_waited_for_as_long_as_the_simulated_clock_says() -> None:
    drawn = Drawn(range(20))
    with drawn.camera() as camera:
        with pytest.raises(TimeoutError, match=r"no picture from 100\.00 s on within 1\.5 s"):
            camera.after(100.0, 1.5)
        assert drawn.clock() == pytest.approx(101.5)
        assert "from a source of frames" in camera.problem
        assert camera.after(100.0, 1.5).time == pytest.approx(102.1)


def test_whoever_waits_is_let_go_when_a_camera_on_a_simulated_clock_is_closed() -> None:
    drawn, ended = Drawn(range(10**6)), []
    camera = drawn.camera()

    def wait() -> None:
        try:
            camera.after(0.0, 1000.0)
        except TimeoutError:
            ended.append(drawn.clock())

    waiting = drawn.clock.start(wait, "waits")
    drawn.clock.sleep(5.0)
    camera.close()
    waiting.join()
    assert ended == [pytest.approx(105.0)]
    assert drawn.clock() < 105.2


def test_a_simulated_source_that_breaks_is_asked_again() -> None:
    drawn, told = Drawn(breaks=3), list[Picture]()
    with drawn.camera(told=told) as camera:
        drawn.clock.sleep(0.85)
        assert camera.problem == ""
    # It broke at 100.4 s, and is begun anew a tenth of a second later.
    assert [picture.time for picture in told[:6]] == pytest.approx([100.1, 100.2, 100.3, 100.6, 100.7, 100.8])


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (VideoFile(Path("no/such/film.mp4")), "film.mp4: there is no such file"),
        (
            RtspVideo("rtsp://someone:secret@127.0.0.1:1/video"),
            "rtsp://127.0.0.1:1/video: it cannot be opened",
        ),
        (VideoDevice(201), "video device 201: it cannot be opened"),
    ],
)
def test_a_source_that_is_not_there_is_a_problem(source: Source, message: str) -> None:
    with LiveCamera(source, time.monotonic) as camera:
        with pytest.raises(TimeoutError):
            camera.after(0.0, 0.3)
        assert message in camera.problem
        assert "secret" not in camera.problem


def test_without_opencv_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(ValueError, match=re.escape(missing("rov", "cv2", "camera"))):
        LiveCamera(RtpVideo(port=0), time.monotonic)


def test_a_mounted_camera_looks_down_by_its_tilt() -> None:
    mount = mounted(0.3, (0.2, 0.0, -0.05))
    assert np.array_equal(mount.rotation, camera_mount(0.3).rotation)
    ahead = mount @ np.array([0.0, 0.0, 1.0])
    assert ahead == pytest.approx([0.2 + np.cos(0.3), 0.0, -0.05 - np.sin(0.3)])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RtpVideo(port=70000), "port"),
        (lambda: RtpVideo(payload_type=26), "payload_type"),
        (lambda: RtpVideo(latency=-1.0), "latency"),
        (lambda: RtspVideo("http://camera"), "url"),
        (lambda: VideoDevice(-1), "number"),
        (lambda: VideoFile(Path("x"), float("nan")), "latency"),
        (lambda: Frames(lambda closed: iter(()), 11.0), "latency"),
    ],
)
def test_a_source_that_cannot_be_is_refused(make: Callable[[], Source], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
