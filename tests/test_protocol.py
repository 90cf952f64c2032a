"""The published numbers of the survey protocols."""

import itertools
import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.geometry import SE2
from dream.protocol import (
    DREAM_V1,
    DREAM_V1_NOISY,
    DREAM_V2,
    POOL_V1,
    PROTOCOLS,
    Grain,
    LastingErrors,
    SensorNoise,
    SurveyProtocol,
    noisy_variants,
    protocol_named,
)


def test_dream_v1_moves_are_the_published_table() -> None:
    one = [DREAM_V1.offset(h, 1.0) for h in range(12)]
    two = [DREAM_V1.offset(h, 2.0) for h in range(12)]
    assert one[:4] == [(2, 0), (2, 1), (1, 2), (0, 2)]
    assert two[:4] == [(4, 0), (3, 2), (2, 3), (0, 4)]


@pytest.mark.parametrize("protocol", PROTOCOLS.values(), ids=lambda p: p.name)
def test_moves_turn_with_the_vehicle_by_quarters(protocol: SurveyProtocol) -> None:
    quarter = protocol.headings // 4
    for heading, advance in itertools.product(range(protocol.headings), protocol.advances):
        east, north = protocol.offset(heading, advance)
        assert protocol.offset(heading + quarter, advance) == (-north, east)


@pytest.mark.parametrize("protocol", PROTOCOLS.values(), ids=lambda p: p.name)
def test_moves_are_as_long_as_they_say_within_the_lattice(protocol: SurveyProtocol) -> None:
    for heading, advance in itertools.product(range(protocol.headings), protocol.advances):
        east, north = protocol.offset(heading, advance)
        length = math.hypot(east, north) * protocol.lattice
        assert abs(length - advance) <= protocol.lattice / math.sqrt(2.0)


def test_dream_v1_camera_sees_nothing_nearer_than_the_design_says() -> None:
    assert math.isclose(DREAM_V1.blind, 1.305, abs_tol=0.001)
    assert math.isclose(math.degrees(DREAM_V1.camera.horizontal_fov), 90.0)


def test_turns_are_allowed_both_ways_and_distinct() -> None:
    for protocol in (DREAM_V1, POOL_V1):
        angles = protocol.turn_angles
        assert len(set(angles)) == len(angles)
        assert {-a for a in angles if abs(a) < math.pi} == {a for a in angles if abs(a) < math.pi}


@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(-10, 10))
def test_snapping_is_idempotent_and_near(x: float, y: float, yaw: float) -> None:
    snapped = DREAM_V1.snap(SE2(x, y, yaw))
    assert snapped == DREAM_V1.snap(snapped)
    assert snapped.distance(SE2(x, y, yaw)) <= DREAM_V1.lattice / math.sqrt(2.0) + 1e-9


def test_an_unknown_protocol_is_answered_with_the_nearest() -> None:
    with pytest.raises(ValueError, match=r'no protocol "dream-v2x". Did you mean "dream-v2"\?'):
        protocol_named("dream-v2x")


def test_dream_v1_noisy_is_dream_v1_with_the_noise_of_the_design() -> None:
    assert protocol_named("dream-v1-noisy") is DREAM_V1_NOISY
    assert replace(DREAM_V1_NOISY, name="dream-v1", noise=None) == DREAM_V1
    noise = DREAM_V1_NOISY.noise
    assert noise is not None
    assert (noise.depth, noise.missed) == (0.002, 0.1)
    assert noise.false_targets > 0.0


def test_only_noisy_protocols_declare_noise() -> None:
    noisy = ["dream-v1-noisy", "dream-v1-nav", "dream-v2", "dream-v2-nav", "dream-v2-seen"]
    assert [p.name for p in PROTOCOLS.values() if p.noise is not None] == noisy
    assert [p.name for p in PROTOCOLS.values() if p.lasting is not None] == noisy[2:]
    assert [p.name for p in PROTOCOLS.values() if p.swims] == ["dream-v1-nav", "dream-v2-nav"]


def test_dream_v1_nav_is_the_noisy_one_with_a_vehicle_that_swims() -> None:
    assert replace(protocol_named("dream-v1-nav"), name="dream-v1-noisy", swims=False) == DREAM_V1_NOISY


def test_a_planar_protocol_has_one_tilt_and_no_climb() -> None:
    planar = [p for p in PROTOCOLS.values() if p.space is None]
    assert {p.name for p in PROTOCOLS.values()} - {p.name for p in planar} == {
        "dream-v2",
        "dream-v2-true",
        "dream-v2-nav",
        "dream-v2-seen",
    }
    for protocol in planar:
        assert (protocol.tilts, protocol.climbs) == ((protocol.camera_pitch,), (0.0,))


def test_dream_v2_is_the_noisy_one_in_space_with_errors_that_last() -> None:
    assert replace(DREAM_V2, name="dream-v1-noisy", cap=200, space=None, lasting=None) == DREAM_V1_NOISY
    assert DREAM_V2.climbs == (-1.0, -0.5, 0.0, 0.5, 1.0)
    assert DREAM_V2.camera_pitch in DREAM_V2.tilts
    assert replace(DREAM_V2, name="dream-v2-true", noise=None, lasting=None) == protocol_named(
        "dream-v2-true"
    )


def test_by_sight_is_dream_v2_but_for_who_tells_labels_and_depth() -> None:
    assert replace(protocol_named("dream-v2-seen"), name="dream-v2", seen=None) == DREAM_V2
    assert [p.name for p in PROTOCOLS.values() if p.seen is not None] == ["dream-v2-seen"]


@pytest.mark.parametrize(
    "change, message",
    [
        ({"photons": 0.5}, "grain.photons"),
        ({"photons": math.inf}, "grain.photons"),
        ({"reading": -0.1}, "grain.reading"),
        ({"quality": 0}, "grain.quality"),
    ],
)
def test_no_grain_is_taken_that_no_camera_has(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Grain(**{"photons": 4000.0, "reading": 0.003, "quality": 90, **change})


@pytest.mark.parametrize(
    "change, message",
    [
        ({"climbs": ()}, "space.climbs"),
        ({"climbs": (0.3,)}, "multiples of the lattice"),
        ({"tilts": (0.0,)}, "space.tilts: expected the camera's pitch"),
        ({"tilts": (2.0,)}, "less than a quarter turn"),
        ({"lowest": 6.0}, "space.highest"),
        ({"incidence": 1.6}, "space.incidence"),
        ({"label_lengths": 0.0}, "space.label_lengths"),
    ],
)
def test_space_that_cannot_be_is_refused(change: dict[str, Any], message: str) -> None:
    assert DREAM_V2.space is not None
    with pytest.raises(ValueError, match=message):
        replace(DREAM_V2, space=replace(DREAM_V2.space, **change))


@pytest.mark.parametrize(
    "wrong",
    [
        {"labels": ((5.0, 0.1), (2.0, 0.2))},
        {"labels": ((2.0, 0.95),)},
        {"labels": ((2.0, -0.1),)},
        {"blob": (2.0, 0.5)},
        {"blob": (0.1, 0.5)},
        {"depth": 0.6},
        {"height": -1.0},
        {"tilt": math.nan},
    ],
)
def test_lasting_errors_that_cannot_be_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="lasting"):
        LastingErrors(**wrong)


def test_noisy_variants_differ_in_nothing_but_noise() -> None:
    assert noisy_variants(DREAM_V1) == [DREAM_V1_NOISY]
    assert noisy_variants(protocol_named("dream-v2-true")) == [DREAM_V2]
    assert noisy_variants(replace(DREAM_V1, reach=7.0)) == []
    assert noisy_variants(POOL_V1) == []


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        ({"depth": -0.1}, "noise.depth: expected 0 or more per metre, got -0.1"),
        ({"depth": math.nan}, "noise.depth: .* got nan"),
        ({"missed": 1.1}, "noise.missed: expected a probability, got 1.1"),
        ({"false_targets": -1.0}, "noise.false_targets: expected 0 to 100 in a frame, got -1"),
        ({"false_targets": math.inf}, "noise.false_targets: .* got inf"),
        ({"false_size": (0.0, 0.5)}, "noise.false_size: expected two widths above 0 m"),
        ({"false_size": (0.5, 0.2)}, "the lesser first"),
    ],
)
def test_noise_that_makes_no_sense_is_refused(wrong: dict[str, float], complaint: str) -> None:
    right = {"depth": 0.002, "missed": 0.1, "false_targets": 0.3, "false_size": (0.15, 0.5)}
    with pytest.raises(ValueError, match=complaint):
        SensorNoise(**(right | wrong))  # type: ignore[arg-type]


def lasting(*labels: tuple[float, float]) -> SurveyProtocol:
    assert DREAM_V2.lasting is not None
    return replace(DREAM_V2, lasting=replace(DREAM_V2.lasting, labels=labels))


def test_a_label_is_trusted_as_far_as_enough_of_them_are_right() -> None:
    reach = DREAM_V2.reach
    assert replace(DREAM_V2, lasting=None).trusted == reach
    assert lasting().trusted == reach
    # A fifth may be wrong: between two distances in proportion.
    assert lasting((2.0, 0.1), (6.0, 0.3)).trusted == pytest.approx(4.0)
    assert lasting((2.0, 0.2), (6.0, 0.3)).trusted == pytest.approx(2.0)
    # Already at the first, and nowhere; never more than the reach.
    assert lasting((3.0, 0.5), (6.0, 0.6)).trusted == pytest.approx(3.0)
    assert lasting((2.0, 0.0), (6.0, 0.1)).trusted == reach
    assert lasting((2.0, 0.0), (4.0 * reach, 0.3)).trusted == reach
