"""The guard keeps the swept vehicle on known free ground, whatever is asked."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.control import guard, setpoint
from dream.geometry import SE2, Bounds
from dream.mapping import OccupancyMap
from dream.protocol import DREAM_V1
from dream.types import Decision


@pytest.fixture(scope="module")
def launch() -> OccupancyMap:
    """Only the ground around (0, 0) is known: free within 2.5 m."""
    occupancy = OccupancyMap(Bounds(-20.0, -20.0, 20.0, 20.0), DREAM_V1)
    occupancy.clear_launch(0.0, 0.0)
    return occupancy


def test_a_safe_move_passes_unchanged(launch: OccupancyMap) -> None:
    asked = Decision(math.pi / 2, 1.0)
    assert guard(asked, SE2(0, 0, 0), launch, DREAM_V1).decision == asked
    assert guard(asked, SE2(0, 0, 0), launch, DREAM_V1).note == ""


def test_a_long_move_into_the_unknown_is_shortened_to_the_other_length(launch: OccupancyMap) -> None:
    guarded = guard(Decision(0.0, 2.0), SE2(0.5, 0, 0), launch, DREAM_V1)
    assert guarded.decision.advance == 1.0
    assert "leaves known free ground: advance 1 m" in guarded.note


def test_a_blocked_move_turns_only(launch: OccupancyMap) -> None:
    guarded = guard(Decision(math.pi / 6, 2.0), SE2(1.5, 0, 0), launch, DREAM_V1)
    assert guarded.decision == Decision(math.pi / 6, 0.0)
    assert guarded.note.endswith("turn only")


@pytest.mark.parametrize(("asked_deg", "given_deg"), [(40, 30), (-100, -90), (170, 180), (14, 0)])
def test_a_turn_that_is_not_in_the_protocol_becomes_the_nearest(
    launch: OccupancyMap, asked_deg: float, given_deg: float
) -> None:
    guarded = guard(Decision(math.radians(asked_deg)), SE2(0, 0, 0), launch, DREAM_V1)
    assert math.isclose(math.degrees(guarded.decision.turn), given_deg, abs_tol=1e-9)
    assert "not in the protocol" in guarded.note


def test_an_advance_that_is_not_in_the_protocol_is_shortened(launch: OccupancyMap) -> None:
    guarded = guard(Decision(0.0, 1.7), SE2(0, 0, 0), launch, DREAM_V1)
    assert guarded.decision.advance == 1.0
    assert "not in the protocol" in guarded.note


def test_done_is_not_the_guards_business(launch: OccupancyMap) -> None:
    assert guard(Decision(done=True), SE2(0, 0, 0), launch, DREAM_V1).decision.done


@given(
    st.floats(-math.pi, math.pi),
    st.floats(0.0, 5.0),
    st.integers(-3, 3),
    st.integers(-3, 3),
    st.integers(0, 11),
)
def test_whatever_is_asked_the_body_stays_on_known_ground(
    launch: OccupancyMap, turn: float, advance: float, i: int, j: int, heading: int
) -> None:
    pose = DREAM_V1.snap(SE2(i * 0.5, j * 0.5, heading * DREAM_V1.heading_step))
    guarded = guard(Decision(turn, advance), pose, launch, DREAM_V1).decision
    end = setpoint(pose, guarded, DREAM_V1)
    assert guarded.advance in (0.0, *DREAM_V1.advances)
    assert guarded.turn in DREAM_V1.turn_angles
    if guarded.advance:
        rim = np.linspace(0.0, 2.0 * math.pi, 64)
        for t in np.linspace(0.0, 1.0, 21):
            x = pose.x + t * (end.x - pose.x) + DREAM_V1.body_radius * np.cos(rim)
            y = pose.y + t * (end.y - pose.y) + DREAM_V1.body_radius * np.sin(rim)
            assert launch.traversable[launch.cell_of(x, y)].all()
