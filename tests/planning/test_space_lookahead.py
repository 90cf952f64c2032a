"""The look-ahead in three dimensions: pieces that can be seen in one way, in known water."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dream.control.setpoints import setpoint
from dream.geometry import SE2
from dream.mapping.volume import Volume
from dream.planning.space.lookahead import HORIZON, SpaceLookAhead, SpacePlan
from dream.planning.space.looks import shown
from dream.planning.space.remains import SURFACE, LeftToInspect, elements_of
from dream.planning.space.ways import KnownWays, ways_in
from dream.protocol import DREAM_V2_TRUE as PROTOCOL
from dream.types import Observation
from tests.planning.standing import BOUNDS, observed

Z = -8.0
CHOOSER = SpaceLookAhead(0.95)


@pytest.fixture(scope="module")
def ways() -> KnownWays:
    volume = Volume(PROTOCOL)
    for x in np.arange(-8.0, 8.1, 1.0):
        volume.clear([x, 0.0, Z], 3.0)
    return ways_in(volume, BOUNDS, PROTOCOL)


def piece(
    x: float, y: float, z: float, normal: tuple[float, float, float], area: float = 4.0
) -> LeftToInspect:
    return LeftToInspect(
        np.array([[x, y, z]]), np.array([normal]), np.array([area]), np.array([SURFACE]), 0.0, 0.0
    )


def planned(ways: KnownWays, left: LeftToInspect, observation: Observation) -> SpacePlan:
    plan = CHOOSER.plan(ways, left, observation)
    assert plan is not None
    move = plan.move
    assert any(move.turn == pytest.approx(angle) for angle in PROTOCOL.turn_angles)
    assert move.advance in (0.0, *PROTOCOL.advances)
    assert move.climb in PROTOCOL.climbs
    assert move.tilt is None or move.tilt in PROTOCOL.tilts
    return plan


def shows(ways: KnownWays, left: LeftToInspect, observation: Observation) -> bool:
    pose, elements = observation.pose, elements_of(left, PROTOCOL)
    at = pose.x, pose.y, observation.z
    return bool(shown(ways, at, pose.yaw, observation.tilt, *elements[:3]).any())


def steps_to_see(ways: KnownWays, left: LeftToInspect, observation: Observation) -> int:
    """Steps by which plan after plan is followed until the piece shows."""
    for count in range(20):
        if shows(ways, left, observation):
            return count
        move, z = planned(ways, left, observation).move, observation.z
        end = setpoint(observation.pose, move, PROTOCOL, z)
        tilt = observation.tilt if move.tilt is None else move.tilt
        observation = observed(end.x, end.y, z if end.z is None else end.z, end.yaw, tilt)
    raise AssertionError("never seen")


def test_where_nothing_is_left_there_is_no_plan(ways: KnownWays) -> None:
    left = piece(4.0, 0.0, Z, (-1.0, 0.0, 0.0))
    assert CHOOSER.plan(ways, left.only(np.zeros(1, np.bool_)), observed(0.0, 0.0, Z, 0.0)) is None
    # Nor where it can be seen from nowhere.
    beyond = piece(60.0, 0.0, Z, (-1.0, 0.0, 0.0))
    assert CHOOSER.plan(ways, beyond, observed(0.0, 0.0, Z, 0.0)) is None


@pytest.mark.parametrize(
    ("place", "normal"),
    [
        ((-4.0, 0.0, Z), (1.0, 0.0, 0.0)),
        ((0.5, 4.0, Z), (0.0, -1.0, 0.0)),
        ((4.0, 0.0, Z + 3.5), (-0.8, 0.0, -0.6)),
        ((1.5, 0.0, Z - 3.5), (-0.6, 0.0, 0.8)),
    ],
    ids=["behind", "beside", "above", "below"],
)
def test_it_turns_or_tilts_to_what_is_out_of_view(
    ways: KnownWays, place: tuple[float, float, float], normal: tuple[float, float, float]
) -> None:
    left, here = piece(*place, normal), observed(0.0, 0.0, Z, 0.0)
    assert not shows(ways, left, here)
    assert steps_to_see(ways, left, here) <= 2


def test_its_plan_ends_where_it_says_that_it_sees(ways: KnownWays) -> None:
    left = piece(-4.0, 1.0, Z + 1.0, (1.0, 0.0, 0.0))
    plan = planned(ways, left, observed(2.0, 0.0, Z, 0.0))
    x, y, z = ((np.array(plan.node) + np.array(ways.first))[::-1] * PROTOCOL.lattice).tolist()
    assert shows(
        ways, left, observed(x, y, z, plan.heading * PROTOCOL.heading_step, PROTOCOL.tilts[plan.tilt])
    )
    assert plan.rate > 0.0


def test_it_goes_far_where_sequences_near_by_show_little(ways: KnownWays) -> None:
    # To be seen from the east end alone, where the vehicle is at the west end.
    left, here = piece(6.0, 0.0, Z, (1.0, 0.0, 0.0), area=20.0), observed(-7.5, 0.0, Z, 0.0)
    plan = planned(ways, left, here)
    assert plan.steps > HORIZON
    steps = ways.steps(SE2(-7.5, 0.0, 0.0), Z)
    assert plan.steps == steps[(*plan.node, plan.heading)]
    assert steps_to_see(ways, left, here) <= plan.steps + 1


def test_it_plans_the_same_twice(ways: KnownWays) -> None:
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(40, 3))
    left = LeftToInspect(
        np.array([0.0, 0.0, Z]) + rng.uniform(-3.0, 3.0, (40, 3)),
        normals / np.linalg.norm(normals, axis=1, keepdims=True),
        rng.random(40),
        np.full(40, SURFACE),
        0.0,
        0.0,
    )
    here = observed(0.0, 0.0, Z, math.pi / 2.0)
    assert planned(ways, left, here) == planned(ways, left, here)
