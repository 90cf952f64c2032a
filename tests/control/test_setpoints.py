"""Decisions become lattice poses."""

import math

import pytest

from dream.control import setpoint
from dream.geometry import SE2
from dream.protocol import DREAM_V1
from dream.types import Decision


@pytest.mark.parametrize(
    ("turn_deg", "advance", "expected"),
    [
        (0, 1.0, (1.0, 0.0)),
        (30, 1.0, (1.0, 0.5)),
        (30, 2.0, (1.5, 1.0)),
        (90, 2.0, (0.0, 2.0)),
        (-90, 1.0, (0.0, -1.0)),
        (180, 2.0, (-2.0, 0.0)),
    ],
)
def test_a_move_ends_at_the_published_offset(
    turn_deg: float, advance: float, expected: tuple[float, float]
) -> None:
    goal = setpoint(SE2(0.0, 0.0, 0.0), Decision(math.radians(turn_deg), advance), DREAM_V1)
    assert (goal.x, goal.y) == expected
    assert math.isclose(math.cos(goal.yaw), math.cos(math.radians(turn_deg)), abs_tol=1e-9)
    assert goal.altitude == 2.0


def test_errors_of_position_do_not_add_up() -> None:
    goal = setpoint(SE2(0.1, -0.2, 0.05), Decision(0.0, 2.0), DREAM_V1)
    assert (goal.x, goal.y, goal.yaw) == (2.0, 0.0, 0.0)


def test_a_turn_moves_nobody() -> None:
    for decision in (Decision(math.pi / 2), Decision(), Decision(done=True)):
        goal = setpoint(SE2(0.1, -0.2, 0.05), decision, DREAM_V1)
        assert (goal.x, goal.y) == (0.1, -0.2)
