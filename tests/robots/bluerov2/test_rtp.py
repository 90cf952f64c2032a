"""Pictures are put together from packets, and only whole ones."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.robots.bluerov2 import rtp
from dream.robots.bluerov2.rtp import PATIENCE, TAKEOVER, AccessUnit, Depacketizer
from dream.robots.bluerov2.standin.video import packets

START = b"\x00\x00\x00\x01"
SPS, PPS = b"\x67sps", b"\x68pps"


def whole(size: int = 3000, fill: int = 7) -> list[bytes]:
    return [SPS, PPS, b"\x65" + bytes([fill]) * size]


def partial(size: int = 3000) -> list[bytes]:
    """It builds on the one before."""
    return [b"\x41" + b"\x09" * size]


def stream(pictures: list[list[bytes]], ssrc: int = 1, sequence: int = 65534) -> list[list[bytes]]:
    """The packets of each, numbered on."""
    sent = []
    for index, units in enumerate(pictures):
        sent.append(list(packets(units, sequence=sequence, stamp=9000 * index, ssrc=ssrc)))
        sequence += len(sent[-1])
    return sent


def received(receiver: Depacketizer, sent: list[bytes], time: float = 0.0) -> list[AccessUnit]:
    units = (receiver.push(packet, time) for packet in sent)
    return [unit for unit in units if unit is not None]


def flat(sent: list[list[bytes]]) -> list[bytes]:
    return [packet for picture in sent for packet in picture]


@given(st.lists(st.integers(1, 5000), min_size=1, max_size=5), st.integers(40, 1500))
def test_what_was_put_into_packets_comes_out(sizes: list[int], mtu: int) -> None:
    units = [SPS, PPS, *(b"\x65" + bytes([k + 1]) * size for k, size in enumerate(sizes))]
    sent = list(packets(units, sequence=65530, stamp=5, ssrc=9, mtu=mtu))
    assert max(map(len, sent)) <= mtu
    (unit,) = received(Depacketizer(), sent, 3.5)
    assert unit.data == b"".join(START + part for part in units)
    assert (unit.time, unit.stamp, unit.whole) == (3.5, 5, True)
    assert unit.parameters == START + SPS + START + PPS


@pytest.mark.parametrize("missing", range(5))
def test_a_picture_that_a_packet_is_missing_from_is_not_given(missing: int) -> None:
    sent = stream([whole(fill=1), whole(fill=2), whole(fill=3)])
    assert len(sent[1]) == 5
    receiver = Depacketizer()
    units = received(receiver, sent[0] + sent[1][:missing] + sent[1][missing + 1 :] + sent[2])
    assert [unit.data[-1] for unit in units] == [1, 3]
    assert (receiver.lost, receiver.damaged) == (1, 1)


def test_a_picture_that_builds_on_a_lost_one_waits_for_a_whole_one() -> None:
    sent = stream([whole(fill=1), partial(), partial(), partial(), whole(fill=2), partial()])
    receiver = Depacketizer()
    units = received(receiver, flat(sent[:2]) + sent[2][1:] + flat(sent[3:]))
    assert [unit.whole for unit in units] == [True, False, True, False]
    assert (receiver.damaged, receiver.skipped) == (1, 1)


def test_a_stream_without_whole_pictures_is_shown_after_a_while() -> None:
    sent = stream([whole(), partial(), partial(), partial()])
    receiver = Depacketizer()
    assert len(received(receiver, sent[0])) == 1
    assert not received(receiver, sent[1][1:], 10.0)
    assert not received(receiver, sent[2], 10.0 + 0.9 * PATIENCE)
    assert len(received(receiver, sent[3], 10.0 + 1.1 * PATIENCE)) == 1


def test_a_stream_is_joined_at_the_next_whole_picture() -> None:
    sent = stream([whole(fill=1), partial(), whole(fill=2)])
    receiver = Depacketizer()
    units = received(receiver, sent[0][3:] + flat(sent[1:]))
    assert [unit.data[-1] for unit in units] == [2]


@pytest.mark.parametrize("first", [b"\x06note", b"\x09\xf0"])
def test_a_picture_may_begin_with_a_note_or_a_delimiter(first: bytes) -> None:
    (unit,) = received(Depacketizer(), flat(stream([[first, *whole()]])))
    assert unit.data.startswith(START + first + START + SPS)


def test_what_builds_on_a_picture_that_was_left_out_is_of_no_use() -> None:
    sent = stream([whole(), partial(), partial(), whole(fill=2)])
    receiver = Depacketizer()
    assert len(received(receiver, flat(sent[:2]))) == 2
    receiver.skip(0.0)
    (unit,) = received(receiver, flat(sent[2:]))
    assert unit.whole
    assert receiver.skipped == 2


def test_a_picture_that_is_joined_between_its_slices_is_not_given() -> None:
    slices = [SPS, PPS, b"\x65first", b"\x65second"]
    sent = stream([slices, whole(fill=2)])
    receiver = Depacketizer()
    units = received(receiver, sent[0][3:] + sent[1])
    assert [unit.data[-1] for unit in units] == [2]


def test_a_duplicate_and_a_late_packet_are_refused() -> None:
    sent = flat(stream([whole(fill=1), whole(fill=2)]))
    receiver = Depacketizer()
    units = received(receiver, [*sent[:3], sent[2], *sent[3:6], sent[4], *sent[6:]])
    assert [unit.data[-1] for unit in units] == [1, 2]
    assert receiver.refused == {"out of order": 2}


def test_a_sender_that_begins_anew_under_its_old_name_is_heard_again() -> None:
    receiver = Depacketizer()
    received(receiver, flat(stream([whole()] * 3, sequence=5000)))
    units = received(receiver, flat(stream([whole(fill=3), whole(fill=4)], sequence=100)), 1.0)
    assert [unit.data[-1] for unit in units] == [4]
    assert receiver.lost == 0


def test_another_sender_is_heard_once_the_first_is_silent() -> None:
    receiver = Depacketizer()
    first, second = stream([whole(fill=1)] * 2, ssrc=1), stream([whole(fill=2)] * 2, ssrc=2)
    assert len(received(receiver, first[0], 0.0)) == 1
    assert not received(receiver, second[0], 0.9 * TAKEOVER)
    assert receiver.refused == {"another sender": 5}
    assert len(received(receiver, first[1], 0.95 * TAKEOVER)) == 1
    (unit,) = received(receiver, second[1], 2.0 * TAKEOVER)
    assert unit.data[-1] == 2


def test_an_aggregate_of_units_is_taken_apart() -> None:
    units = [SPS, PPS, b"\x65picture"]
    body = b"\x78" + b"".join(struct.pack(">H", len(unit)) + unit for unit in units)
    head = struct.pack(">BBHII", 0x80, 0xE0, 1, 2, 3)
    (unit,) = received(Depacketizer(), [head + body])
    assert unit.data == b"".join(START + part for part in units)
    receiver = Depacketizer()
    assert not received(receiver, [head + body[:-1]])
    assert receiver.refused == {"aggregate of wrong length": 1}


def test_sources_extension_and_padding_are_left_out() -> None:
    """RFC 3550, section 5.1: one contributing source, an extension of two words, three bytes of padding."""
    sps, pps, idr = (
        packet[12:] for packet in packets([SPS, PPS, b"\x65picture"], sequence=0, stamp=0, ssrc=0)
    )
    extra = b"\x00\x00\x00\x05" + b"\xbe\xde\x00\x02" + b"extended"
    sent = [
        struct.pack(">BBHII", 0xB1, 0x60 | (index == 2) << 7, index, 2, 3) + extra + body + b"\x00\x00\x03"
        for index, body in enumerate((sps, pps, idr))
    ]
    (unit,) = received(Depacketizer(), sent)
    assert unit.data == START + SPS + START + PPS + START + b"\x65picture"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda p: p[:11], "too short"),
        (lambda p: b"\x00" + p[1:], "not RTP version 2"),
        (lambda p: p[:1] + b"\x61" + p[2:], "not payload type 96"),
        (lambda p: p[:12], "no payload"),
        (lambda p: p[:12] + b"\xff" + p[13:], "forbidden bit set"),
        (lambda p: p[:12] + b"\x1d" + p[13:], "kind 29 of packet, which mode 1 has not"),
        (lambda p: p[:12] + b"\x7c\x05" + p[14:], "fragment out of place"),
        (lambda p: p[:12] + b"\x7c\xc5" + p[14:], "fragment out of place"),
        (lambda p: p[:12] + b"\x7c\x85", "empty fragment"),
    ],
)
def test_a_packet_that_cannot_be_is_refused_by_reason(change, reason: str) -> None:  # type: ignore[no-untyped-def]
    receiver = Depacketizer()
    sent = flat(stream([whole(), whole(), whole(fill=4)]))
    received(receiver, sent[:5])
    units = received(receiver, [change(sent[5]), *sent[6:]])
    assert [unit.data[-1] for unit in units] == [4]
    assert receiver.refused[reason] == 1


def test_a_picture_without_end_takes_no_more_than_its_share(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rtp, "MOST_BYTES", 10_000)
    receiver = Depacketizer()
    units = received(receiver, flat(stream([whole(), whole(20_000), whole(fill=6)])))
    assert [unit.data[-1] for unit in units] == [7, 6]
    assert receiver.refused == {"picture too large": 1}


def test_noise_never_breaks_it() -> None:
    rng = np.random.default_rng(0)
    receiver = Depacketizer()
    good = flat(stream([whole(), partial(), whole()] * 30, sequence=0))
    for index, packet in enumerate(good):
        noise = bytearray(packet[: rng.integers(1, len(packet) + 1)])
        for at in rng.integers(0, min(len(noise), 16), size=3):
            noise[at] = rng.integers(256)
        receiver.push(bytes(noise), index / 1000.0)
        receiver.push(rng.bytes(int(rng.integers(0, 60))), index / 1000.0)
    (*_, unit) = received(receiver, flat(stream([whole(), whole(fill=3)], ssrc=77)), 100.0)
    assert unit.data[-1] == 3
