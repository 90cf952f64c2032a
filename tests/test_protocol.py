"""The published numbers of the survey protocols."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.geometry import SE2
from dream.protocol import DREAM_V1, POOL_V1, PROTOCOLS, SurveyProtocol, protocol_named


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
    with pytest.raises(ValueError, match=r'no protocol "dream-v2". Did you mean "dream-v1"\?'):
        protocol_named("dream-v2")
