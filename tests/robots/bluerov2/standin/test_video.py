"""The stand-in's packets are those of RFC 3550 and 6184, and its faults are what they say."""

import itertools
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from dream.geometry import SE3, Camera, camera_mount
from dream.robots.bluerov2.standin.h264 import yuv420
from dream.robots.bluerov2.standin.video import MTU, Faults, UInt8Array, VideoSource, eye, packets
from dream.sim.render import Renderer
from tests.sim.made import made

SMALL = np.full((48, 64, 3), 90, np.uint8)
WAIT = 5.0
"""Seconds that a packet is waited for; it comes within milliseconds."""


@contextmanager
def listening() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(WAIT)
        yield receiver


def picture(receiver: socket.socket) -> list[bytes]:
    """The packets up to and with the next marker."""
    got: list[bytes] = []
    while not got or not got[-1][1] & 0x80:
        got.append(receiver.recv(65536))
    return got


def grey() -> Iterator[UInt8Array]:
    """Pictures that each differ from the one before."""
    for level in itertools.cycle(range(20, 230, 3)):
        yield np.full((48, 64, 3), level, np.uint8)


def test_the_header_is_that_of_rfc_3550() -> None:
    units = [b"\x67ab", b"\x68c", b"\x65" + bytes(3000)]
    sent = list(packets(units, sequence=65534, stamp=(1 << 32) + 7, ssrc=0xDEADBEEF))
    heads = [struct.unpack(">BBHII", packet[:12]) for packet in sent]
    assert {head[0] for head in heads} == {0x80}
    assert [head[1] for head in heads] == [96, 96, 96, 96, 96 | 0x80]
    assert [head[2] for head in heads] == [65534, 65535, 0, 1, 2]
    assert {head[3:] for head in heads} == {(7, 0xDEADBEEF)}
    assert max(map(len, sent)) == MTU


def test_a_long_unit_goes_in_fragments() -> None:
    """RFC 6184, section 5.8: indicator with type 28, header with start and end bits and the unit's type."""
    unit = b"\x65" + np.random.default_rng(0).bytes(4000)
    bodies = [packet[12:] for packet in packets([unit], sequence=0, stamp=0, ssrc=0)]
    assert {body[0] for body in bodies} == {0x60 | 28}
    assert [body[1] for body in bodies] == [0x85, 0x05, 0x45]
    assert unit[:1] + b"".join(body[2:] for body in bodies) == unit


@pytest.mark.parametrize("size", [MTU - 12, MTU - 11])
def test_a_unit_that_fits_goes_whole(size: int) -> None:
    sent = list(packets([b"\x65" + bytes(size - 1)], sequence=0, stamp=0, ssrc=0))
    assert len(sent) == (1 if size == MTU - 12 else 2)


def test_pictures_come_with_numbers_and_stamps_that_count_on() -> None:
    with listening() as receiver:
        drawn = grey()
        with VideoSource(lambda: next(drawn), receiver.getsockname(), fps=50.0) as source:
            pictures = [picture(receiver) for _ in range(4)]
    heads = [struct.unpack(">BBHII", packet[:12]) for one in pictures for packet in one]
    numbers = np.array([head[2] for head in heads])
    assert np.all(np.diff(numbers) % 65536 == 1)
    assert len({head[4] for head in heads}) == 1
    stamps = np.array([struct.unpack(">I", one[0][4:8])[0] for one in pictures])
    taken = (stamps - source._first_stamp) % (1 << 32)
    # Each is stamped when it was taken: after the one before, and never before its turn.
    assert np.all(np.diff(taken) > 0)
    assert np.all(taken + 1 >= np.arange(4) * 90_000 / 50.0)


def test_a_frozen_source_sends_the_same_again() -> None:
    with listening() as receiver:
        drawn = grey()
        with VideoSource(lambda: next(drawn), receiver.getsockname(), fps=50.0) as source:
            first, second = picture(receiver), picture(receiver)
            assert first[-1][12:] != second[-1][12:]
            source.faults = Faults(frozen=True)
            bodies = [[packet[12:] for packet in picture(receiver)] for _ in range(5)]
    assert bodies[3] == bodies[4]


def test_a_silent_source_sends_nothing_and_goes_on() -> None:
    drawn = threading.Semaphore(0)

    def draw() -> UInt8Array:
        drawn.release()
        return SMALL

    with listening() as receiver, VideoSource(draw, receiver.getsockname(), fps=50.0) as source:
        picture(receiver)
        source.faults = Faults(silent=True)
        for _ in range(4):
            assert drawn.acquire(timeout=WAIT)
        sent = source.sent
        for _ in range(4):
            assert drawn.acquire(timeout=WAIT)
        assert source.sent == sent
        source.faults = Faults()
        picture(receiver)
        assert source.problem == ""


def test_lost_packets_leave_gaps_in_the_numbers() -> None:
    with listening() as receiver, VideoSource(lambda: SMALL, receiver.getsockname(), fps=100.0) as source:
        source.faults = Faults(loss=0.3)
        got = [receiver.recv(65536) for _ in range(100)]
    numbers = np.array([struct.unpack(">H", packet[2:4])[0] for packet in got])
    steps = np.diff(numbers) % 65536
    assert steps.min() >= 1
    assert 1.2 < steps.mean() < 1.8


def test_corrupt_packets_keep_their_length() -> None:
    with listening() as receiver, VideoSource(lambda: SMALL, receiver.getsockname(), fps=100.0) as source:
        good = picture(receiver)
        source.faults = Faults(corrupt=1.0)
        picture(receiver)
        got = [receiver.recv(65536) for _ in range(20)]
    assert {len(packet) for packet in got} <= {len(packet) for packet in good}
    assert sum(packet[12:] not in [one[12:] for one in good] for packet in got) > 5


def test_a_late_source_sends_what_it_drew_before() -> None:
    drawn: list[int] = []

    def draw() -> UInt8Array:
        drawn.append(len(drawn))
        return np.full((48, 64, 3), min(3 * drawn[-1], 255), np.uint8)

    with listening() as receiver, VideoSource(draw, receiver.getsockname(), fps=50.0) as source:
        picture(receiver)
        source.faults = Faults(delay=0.2)
        for _ in range(4):
            late = picture(receiver)
        newest = drawn[-1]
    brightness = late[2][100]
    assert yuv420(np.full((2, 2, 3), 3 * (newest - 4), np.uint8))[0, 0] >= brightness


def test_a_picture_that_cannot_be_drawn_is_a_problem_and_not_the_end() -> None:
    broken = threading.Event()

    def draw() -> UInt8Array:
        if broken.is_set():
            broken.clear()
            raise RuntimeError("no pose")
        return SMALL

    with listening() as receiver, VideoSource(draw, receiver.getsockname(), fps=50.0) as source:
        picture(receiver)
        broken.set()
        before = source.sent
        while source.sent < before + 5:
            picture(receiver)
        assert not broken.is_set()
        assert source.problem == ""


def test_it_can_send_what_a_camera_on_the_vehicle_sees() -> None:
    world = made("pool/arc")
    renderer, camera = Renderer(world), Camera.from_fov(64, 48, 1.4)
    start = world.starts[0]
    pose = SE3.level(start.x, start.y, -0.9, start.yaw)
    mount = camera_mount(0.3)
    draw = eye(renderer, camera, lambda: pose @ mount)
    assert np.array_equal(draw(), renderer.render(camera, pose @ mount).rgb)


@pytest.mark.parametrize(
    ("name", "value"), [("loss", 1.1), ("corrupt", -0.1), ("delay", -1.0), ("loss", float("nan"))]
)
def test_faults_that_cannot_be_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        Faults(**{name: value})  # type: ignore[arg-type]


def test_a_rate_that_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="fps"):
        VideoSource(lambda: SMALL, ("127.0.0.1", 9), fps=0.0)
