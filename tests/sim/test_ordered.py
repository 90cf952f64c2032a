"""What a protocol comes to at a site: reach, least group and cap."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.geometry import Bounds
from dream.protocol import DREAM_V1, DREAM_V2, DREAM_V2_NAV, DREAM_V2_TRUE, ORDERED, POOL_V1, protocol_for
from dream.recording import OrderedRules, RunConfig
from dream.sim.ordered import ordered_in, protocol_in
from dream.sim.visual_range import visual_range
from dream.sim.water import water_of
from dream.sim.worlds import make_world

FLAT = make_world("flat/empty", 1)
IN_SPACE = [DREAM_V2, DREAM_V2_TRUE, DREAM_V2_NAV]


def test_a_planar_protocol_is_the_same_everywhere() -> None:
    murky = replace(FLAT, water=water_of(3.0), group_radius=0.4)
    assert ordered_in(murky, DREAM_V1) is DREAM_V1


@pytest.mark.parametrize("protocol", IN_SPACE, ids=lambda one: one.name)
@given(
    visibility=st.floats(2.0, 20.0),
    east=st.integers(10, 100),
    north=st.integers(10, 100),
    group=st.floats(0.3, 3.0),
)
def test_reach_cap_and_least_group_go_by_the_site(
    protocol: object, visibility: float, east: int, north: int, group: float
) -> None:
    assert isinstance(protocol, type(DREAM_V1))
    assert protocol.space is not None
    world = replace(
        FLAT,
        water=water_of(visibility),
        group_radius=group,
        bounds=Bounds(-0.5 * east, -0.5 * north, 0.5 * east, 0.5 * north),
    )
    there = ordered_in(world, protocol)
    labels = visual_range(world.water, protocol.space, protocol.max_depth).labels
    assert there.reach == min(protocol.reach, labels)
    assert there.trusted <= there.reach
    assert there.group_radius == group
    assert there.cap == max(protocol.cap, math.ceil(east * north / there.trusted - 1e-6))
    # Once ordered, it stays what it is, and nothing else of it changes.
    assert ordered_in(world, there) == there
    assert replace(there, **{name: getattr(protocol, name) for name in ORDERED}) == protocol


def test_murky_water_takes_more_steps_and_clear_water_none() -> None:
    caps = [
        ordered_in(replace(FLAT, bounds=Bounds(-40, -40, 40, 40), water=water_of(v)), DREAM_V2).cap
        for v in (15.0, 8.0, 5.0, 3.0)
    ]
    assert caps == sorted(caps)
    assert caps[0] == caps[1] < caps[2] < caps[3]


def test_a_run_tells_by_which_rules_it_was_flown() -> None:
    world = replace(FLAT, water=water_of(3.0))
    there = ordered_in(world, DREAM_V2)
    told = {name: getattr(there, name) for name in ORDERED}
    config = RunConfig(
        version="0",
        protocol=there.name,
        ordered=OrderedRules(**told),
        world="flat/empty",
        seed=1,
        planner="belief",
    )
    assert config.rules == there
    assert config.model_copy(update={"ordered": None}).rules == DREAM_V2


def test_worlds_made_for_the_plane_are_explored_in_space_unless_told() -> None:
    assert protocol_in(FLAT) == ordered_in(FLAT, DREAM_V2)
    assert protocol_in(FLAT, DREAM_V1.name) == DREAM_V1
    assert protocol_for(POOL_V1.name) == POOL_V1
