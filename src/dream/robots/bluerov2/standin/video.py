"""A stand-in for the BlueROV2's camera: H.264 in RTP over UDP, with faults.

References: RFC 3550 (RTP), RFC 6184 (H.264 in RTP, packetization mode 1: single units and FU-A). A BlueROV2
sends the same to port 5600 of the surface computer, payload type 96 (Blue Robotics, BlueOS documentation).
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, Camera
from dream.robots.bluerov2.rtp import CLOCK, PAYLOAD_TYPE
from dream.robots.bluerov2.standin import h264
from dream.sim.render import Renderer

UInt8Array = npt.NDArray[np.uint8]

MTU = 1400
"""Bytes of a packet at most, RTP header included."""
_HEADER = 12
_FU_A = 28
_BURST = 16
"""Packets that are sent at once."""
_BETWEEN_BURSTS = 0.0008
"""Seconds. A socket's usual buffer holds some 90 packets of this size, and a picture has 330."""


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong with the picture or on its way."""

    silent: bool = False
    """Nothing is sent."""
    frozen: bool = False
    """The last picture is sent over and over."""
    loss: float = 0.0
    """Share of the packets that are lost."""
    corrupt: float = 0.0
    """Share of the packets in which bytes are changed, in the header or behind it."""
    delay: float = 0.0
    """Seconds that a picture waits before it is sent."""

    def __post_init__(self) -> None:
        for name in ("loss", "corrupt"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name}: expected a share, 0 to 1, got {getattr(self, name)}")
        if not 0.0 <= self.delay <= 60.0:
            raise ValueError(f"delay: expected 0 to 60 s, got {self.delay}")


def eye(renderer: Renderer, camera: Camera, T_world_camera: Callable[[], SE3]) -> Callable[[], UInt8Array]:
    """What a camera sees from where it is each time it is asked: (H, W, 3) uint8."""
    return lambda: renderer.render(camera, T_world_camera()).rgb


def packets(
    units: Sequence[bytes], *, sequence: int, stamp: int, ssrc: int, mtu: int = MTU
) -> Iterator[bytes]:
    """The RTP packets of one picture.

    Args:
        units: Its NAL units, without start codes.
        sequence: Number of the first packet; the others count on, modulo 2¹⁶.
        stamp: When the picture was taken, ticks of 1/90000 s.
        ssrc: Who sends.
        mtu: Bytes of a packet at most.
    """
    room = mtu - _HEADER - 2
    for index, unit in enumerate(units):
        last_unit = index == len(units) - 1
        if len(unit) <= mtu - _HEADER:
            yield _header(sequence, stamp, ssrc, marker=last_unit) + unit
            sequence += 1
            continue
        indicator, kind = (unit[0] & 0xE0) | _FU_A, unit[0] & 0x1F
        for begin in range(1, len(unit), room):
            end = begin + room >= len(unit)
            fu = bytes((indicator, (begin == 1) << 7 | end << 6 | kind))
            yield _header(sequence, stamp, ssrc, marker=last_unit and end) + fu + unit[begin : begin + room]
            sequence += 1


def _header(sequence: int, stamp: int, ssrc: int, *, marker: bool) -> bytes:
    return struct.pack(
        ">BBHII", 0x80, marker << 7 | PAYLOAD_TYPE, sequence & 0xFFFF, stamp & 0xFFFFFFFF, ssrc
    )


class VideoSource:
    """Draws, encodes and sends pictures at a steady rate until it is closed.

    Sends in bursts with pauses between them, so that a picture takes about 20 ms to be sent.
    """

    def __init__(
        self,
        draw: Callable[[], UInt8Array],
        address: tuple[str, int],
        *,
        fps: float = 10.0,
        seed: int = 0,
    ) -> None:
        """Starts at once.

        Args:
            draw: The picture of now, (H, W, 3) uint8; called in the source's own thread. See `eye`.
            address: Host and UDP port to send to.
            fps: Pictures a second.
            seed: Of the faults, and of the numbers that RTP begins with.
        """
        if not 0.0 < fps <= 120.0:
            raise ValueError(f"fps: expected above 0 and at most 120, got {fps}")
        self.faults = Faults()
        """Replace it at any time."""
        self.sent = 0
        """Pictures."""
        self.problem = ""
        """Why pictures are not sent."""
        self._draw, self._address, self._fps = draw, address, fps
        self._rng = np.random.default_rng(seed)
        self._ssrc, self._sequence = int(self._rng.integers(1 << 32)), int(self._rng.integers(1 << 16))
        self._first_stamp = int(self._rng.integers(1 << 32))
        self._closed = threading.Event()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._thread = threading.Thread(target=self._run, name="video source", daemon=True)
        self._thread.start()

    def __enter__(self) -> VideoSource:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stops sending."""
        self._closed.set()
        self._thread.join(timeout=5.0)
        self._socket.close()

    def _run(self) -> None:
        start = time.monotonic()
        waiting: deque[tuple[float, int, list[bytes]]] = deque()
        units: list[bytes] = []
        frame = 0
        while not self._closed.is_set():
            taken = time.monotonic()
            try:
                if not (self.faults.frozen and units):
                    units = h264.encode(h264.yuv420(self._draw()), frame, self._fps)
                self.problem = ""
            except Exception as error:  # noqa: BLE001 - a picture that fails is a state, not the end of the thread.
                self.problem = f"no picture was drawn: {error}"
                units = []
            if units:
                waiting.append((taken + self.faults.delay, round((taken - start) * CLOCK), units))
            frame += 1
            tick = max(start + frame / self._fps, time.monotonic())
            while waiting and waiting[0][0] <= max(tick, time.monotonic()):
                due, stamp, ready = waiting[0]
                if self._closed.wait(max(0.0, due - time.monotonic())):
                    return
                waiting.popleft()
                self._send(stamp, ready)
            self._closed.wait(max(0.0, start + frame / self._fps - time.monotonic()))

    def _send(self, stamp: int, units: list[bytes]) -> None:
        faults = self.faults
        if faults.silent:
            return
        sent = 0
        for packet in packets(
            units, sequence=self._sequence, stamp=self._first_stamp + stamp, ssrc=self._ssrc
        ):
            self._sequence = (self._sequence + 1) & 0xFFFF
            if faults.loss and self._rng.random() < faults.loss:
                continue
            if faults.corrupt and self._rng.random() < faults.corrupt:
                packet = self._garbled(packet)
            try:
                self._socket.sendto(packet, self._address)
            except OSError as error:
                # Nobody listens, or the network is gone: UDP goes on regardless.
                self.problem = f"not sent to {self._address}: {error}"
            sent += 1
            if sent % _BURST == 0 and self._closed.wait(_BETWEEN_BURSTS):
                return
        self.sent += 1

    def _garbled(self, packet: bytes) -> bytes:
        """With 1 to 8 bytes changed, half of the time within the first 16."""
        changed = bytearray(packet)
        within = min(16, len(packet)) if self._rng.random() < 0.5 else len(packet)
        for index in self._rng.integers(within, size=int(self._rng.integers(1, 9))):
            changed[index] = int(self._rng.integers(256))
        return bytes(changed)
