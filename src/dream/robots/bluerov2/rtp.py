"""RTP packets → whole H.264 pictures.

References: RFC 3550 (RTP: section 5.1 the header, appendix A.1 sequence numbers), RFC 6184 (H.264: single
units, STAP-A and FU-A, which are the kinds of packetization modes 0 and 1), Rec. ITU-T H.264, annex B (start
codes) and table 7-1 (types of units).
"""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import dataclass

PAYLOAD_TYPE = 96
CLOCK = 90_000
"""Ticks of a stamp a second (RFC 6184, section 8.2.1)."""
MOST_BYTES = 8_000_000
"""Of a picture; a longer one is refused."""
TAKEOVER = 0.5
"""Seconds of silence after which another sender on the same port is listened to."""
PATIENCE = 3.0
"""Seconds that a whole picture is waited for after a loss; then those that build on lost ones are taken too,
because some encoders refresh piece by piece and never send a whole one."""

_HEADER = struct.Struct(">BBHII")
_START = b"\x00\x00\x00\x01"
_IDR, _SEI, _SPS, _PPS, _DELIMITER, _STAP_A, _FU_A = 5, 6, 7, 8, 9, 24, 28


@dataclass(frozen=True, slots=True)
class AccessUnit:
    """What one picture is decoded from."""

    time: float
    """When its last packet came; seconds on the dive's clock."""
    stamp: int
    """The sender's: ticks of 1/90000 s, modulo 2³², from an unknown start."""
    data: bytes
    """Annex B: start codes and NAL units."""
    whole: bool
    """It builds on no other picture."""
    parameters: bytes
    """Annex B: the sequence and picture parameters that hold for it; empty until they came."""


class Depacketizer:
    """Puts pictures together from packets, and gives only those that nothing is missing from.

    What it does: after a loss it waits for a picture that builds on no other one (IDR), at most `PATIENCE`.
    It listens to one sender; another is heard once the first was silent for `TAKEOVER`.
    Fails when: bytes are changed behind the headers. UDP's checksum catches that on a real network.
    """

    def __init__(self, payload_type: int = PAYLOAD_TYPE) -> None:
        self.refused: Counter[str] = Counter()
        """Packets, by reason."""
        self.lost = 0
        """Packets that never came."""
        self.damaged = 0
        """Pictures that a packet is missing from."""
        self.skipped = 0
        """Pictures that came whole and were not decoded: they build on one that did not, or came too fast."""
        self._type = payload_type
        self._ssrc = -1
        self.heard = -1e9
        """When the last good packet came."""
        self._expected = -1
        self._restart = -1
        self._sets: dict[int, bytes] = {}
        self._broken_since: float | None = None
        self._begin(-1, clean=False)

    def push(self, packet: bytes, time: float) -> AccessUnit | None:
        """The picture that this packet completes, if it completes one.

        Args:
            packet: A UDP datagram.
            time: When it came; seconds on the dive's clock.
        """
        if len(packet) < _HEADER.size:
            self._refuse("too short")
            return None
        first, second, sequence, stamp, ssrc = _HEADER.unpack_from(packet)
        if first >> 6 != 2:
            self._refuse("not RTP version 2")
            return None
        if second & 0x7F != self._type:
            self._refuse(f"not payload type {self._type}")
            return None
        if ssrc != self._ssrc and not self._adopt(ssrc, time):
            self._refuse("another sender")
            return None
        self.heard = time
        if not self._in_order(sequence, time):
            self._refuse("out of order")
            return None
        begin, end = _payload(packet, first)
        if begin >= end:
            self._clean = self._clean_start = False
            self._refuse("no payload")
            return None
        if stamp != self._stamp:
            if self._size:
                # The last one never said that it ended.
                self._abandon(time)
            self._begin(stamp, clean=self._clean_start or _opens(packet, begin, end))
        self._size += end - begin
        if self._clean and not self._take(packet, begin, end):
            self._clean = False
        if not second & 0x80:
            return None
        return self._finish(time)

    def skip(self, time: float) -> None:
        """The last picture was not decoded: what builds on it is of no use."""
        self.skipped += 1
        self._broken_since = time

    def _refuse(self, reason: str) -> None:
        self.refused[reason] += 1

    def _adopt(self, ssrc: int, time: float) -> bool:
        """Listens to this sender from now on, unless the one before still speaks."""
        if time - self.heard < TAKEOVER:
            return False
        self._ssrc, self._expected, self._restart = ssrc, -1, -1
        self._begin(-1, clean=False)
        self._clean_start = False
        self._broken_since = time
        self._sets.clear()
        return True

    def _in_order(self, sequence: int, time: float) -> bool:
        """Is it the next packet, or one after a gap? Notes the gap."""
        gap = (sequence - self._expected) & 0xFFFF if self._expected >= 0 else 0
        if gap >= 0x8000 and sequence != self._restart:
            # An old one; or the sender began anew, which a second in a row shows (RFC 3550, A.1).
            self._restart = (sequence + 1) & 0xFFFF
            return False
        if gap:
            self.lost += 0 if gap >= 0x8000 else gap
            # It may have held the end of this picture and the start of the next.
            self._clean = self._clean_start = False
            self._broken_since = time if self._broken_since is None else self._broken_since
        self._expected, self._restart = (sequence + 1) & 0xFFFF, -1
        return True

    def _begin(self, stamp: int, *, clean: bool) -> None:
        self._stamp, self._clean, self._clean_start = stamp, clean, True
        self._parts: list[bytes] = []
        self._size = 0
        """Bytes of its payloads."""
        self._whole = self._in_fragment = False

    def _take(self, packet: bytes, begin: int, end: int) -> bool:
        """Is the payload well formed? Keeps what it holds."""
        kind = packet[begin] & 0x1F
        if packet[begin] & 0x80:
            self._refuse("forbidden bit set")
            return False
        if self._size > MOST_BYTES:
            self._refuse("picture too large")
            return False
        if kind == _FU_A:
            return self._take_fragment(packet, begin, end)
        if self._in_fragment:
            self._refuse("fragment without end")
            return False
        if 1 <= kind <= 23:
            self._keep(packet[begin:end])
            return True
        if kind != _STAP_A:
            self._refuse(f"kind {kind} of packet, which mode 1 has not")
            return False
        at = begin + 1
        while at + 2 < end:
            size = packet[at] << 8 | packet[at + 1]
            unit = packet[at + 2 : min(at + 2 + size, end)]
            if not unit or len(unit) < size:
                break
            self._keep(unit)
            at += 2 + size
        if at != end:
            self._refuse("aggregate of wrong length")
        return at == end

    def _take_fragment(self, packet: bytes, begin: int, end: int) -> bool:
        if end - begin < 3:
            self._refuse("empty fragment")
            return False
        header = packet[begin + 1]
        starts, ends = header & 0x80, header & 0x40
        if bool(starts) == self._in_fragment or (starts and ends):
            self._refuse("fragment out of place")
            return False
        if starts:
            self._keep(bytes(((packet[begin] & 0xE0) | header & 0x1F,)))
        self._parts.append(packet[begin + 2 : end])
        self._in_fragment = not ends
        return True

    def _keep(self, unit: bytes) -> None:
        """A unit, or the first byte of one that comes in fragments."""
        kind = unit[0] & 0x1F
        if kind in (_SPS, _PPS):
            self._sets[kind] = _START + unit
        self._whole |= kind == _IDR
        self._parts += (_START, unit)

    def _abandon(self, time: float) -> None:
        self.damaged += 1
        self._broken_since = time if self._broken_since is None else self._broken_since

    def _finish(self, time: float) -> AccessUnit | None:
        clean, whole, stamp = self._clean and not self._in_fragment, self._whole, self._stamp
        data = b"".join(self._parts)
        # The next packet begins another picture even if its stamp is the same.
        self._begin(stamp, clean=True)
        if not clean:
            self._abandon(time)
            return None
        if self._broken_since is not None and not whole and time - self._broken_since < PATIENCE:
            self.skipped += 1
            return None
        self._broken_since = None
        parameters = b"".join(self._sets.values()) if len(self._sets) == 2 else b""
        return AccessUnit(time, stamp, data, whole, parameters)


def _payload(packet: bytes, first: int) -> tuple[int, int]:
    """Where it begins and ends, behind header, sources and extension and before the padding."""
    begin, end = _HEADER.size + 4 * (first & 0x0F), len(packet)
    if first & 0x10 and begin + 4 <= end:
        begin += 4 + 4 * (packet[begin + 2] << 8 | packet[begin + 3])
    if first & 0x20:
        end -= packet[-1]
    return begin, end


def _opens(packet: bytes, begin: int, end: int) -> bool:
    """Does a picture surely begin with this packet: with what comes before slices (H.264, 7.4.1.2.3)?"""
    aggregate = packet[begin] & 0x1F == _STAP_A and begin + 3 < end
    return packet[begin + 3 if aggregate else begin] & 0x1F in (_SEI, _SPS, _DELIMITER)
