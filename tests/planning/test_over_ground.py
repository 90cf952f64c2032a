"""Pilots of the plane that search the ground in three dimensions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from dream.control import setpoint
from dream.mapping import OccupancyMap
from dream.planning import (
    Belief,
    Lawnmower,
    MutualInformation,
    NearestFrontier,
    NextBestView,
    Spiral,
    SweepAndGraze,
)
from dream.planning.space.ground import GroundSearch
from dream.planning.space.in_water import ENOUGH, InWater
from dream.planning.space.over_ground import OverGround
from dream.protocol import DREAM_V1
from dream.protocol import DREAM_V2_TRUE as PROTOCOL
from dream.types import Decision, Mission, Observation, Target
from tests.planning.standing import BOUNDS, SEABED, forget, mission, observed, solid, water

SEARCHERS: dict[str, Any] = {
    "lawnmower": Lawnmower(),
    "spiral": Spiral(),
    "frontier": NearestFrontier(),
    "nbv": NextBestView(),
    "sweep-and-graze": SweepAndGraze(),
    "sweep-and-graze with hints": SweepAndGraze(glimpse=2.0),
    "mutual-information": MutualInformation(),
}
searchers = pytest.mark.parametrize("planner", SEARCHERS.values(), ids=SEARCHERS)
HEIGHT = SEABED + 3.5


def map_of(volume: Any) -> OccupancyMap:
    """The view from above of a volume, as far as a frame from the middle would have changed it."""
    occupancy = OccupancyMap(BOUNDS, PROTOCOL)
    occupancy.volume, occupancy._datum = volume, SEABED
    occupancy._look_from_above(0.0, 0.0, HEIGHT)
    occupancy._changed()
    return occupancy


@searchers
def test_it_flies_in_space_and_in_the_plane(planner: Any) -> None:
    assert type(planner).spatial
    assert isinstance(planner.begin(mission()), OverGround)
    assert not isinstance(planner.begin(Mission(DREAM_V1, BOUNDS, 10)), OverGround)


@searchers
def test_it_refuses_a_mission_for_a_wreck(planner: Any) -> None:
    with pytest.raises(ValueError, match=r"target: expected oysters, or anything, .*; got a wreck"):
        planner.begin(mission(Target.WRECK))


@searchers
def test_it_plans_with_the_reach_over_ground_that_the_search_of_belief_has(planner: Any) -> None:
    pilot = planner.begin(mission())
    ground = GroundSearch(mission(), Belief().in_plane)
    assert pilot.water.protocol == ground.water.protocol
    assert pilot.water.protocol.reach < PROTOCOL.reach


@pytest.mark.few(3)
@searchers
def test_it_moves_through_known_water_only(planner: Any) -> None:
    occupancy = map_of(water())
    assert occupancy.volume is not None
    pilot, here = planner.begin(mission()), observed(0.0, 0.0, HEIGHT, 0.0)
    went = 0.0
    for _ in range(8):
        move = pilot.decide(here, occupancy)
        if move.done:
            break
        end = setpoint(here.pose, move, PROTOCOL, here.z)
        start, goal = (here.pose.x, here.pose.y, here.z), (end.x, end.y, here.z if end.z is None else end.z)
        if start != goal:
            assert occupancy.volume.room([start], [goal]).clear.all()
        tilt = here.tilt if move.tilt is None else move.tilt
        went += move.advance
        here = observed(*goal, end.yaw, tilt)
    assert went > 0.0


@searchers
def test_where_no_water_around_is_known_it_turns_or_looks_and_never_moves(planner: Any) -> None:
    volume = water()
    for low, high in (
        ((-9.0, -9.0, SEABED + 0.5), (-0.5, 9.0, SEABED + 12.0)),
        ((0.5, -9.0, SEABED + 0.5), (9.0, 9.0, SEABED + 12.0)),
        ((-9.0, -9.0, SEABED + 0.5), (9.0, -0.5, SEABED + 12.0)),
        ((-9.0, 0.5, SEABED + 0.5), (9.0, 9.0, SEABED + 12.0)),
        ((-9.0, -9.0, HEIGHT + 0.5), (9.0, 9.0, SEABED + 12.0)),
        ((-9.0, -9.0, SEABED + 0.5), (9.0, 9.0, HEIGHT - 0.5)),
    ):
        forget(volume, low, high)
    occupancy = map_of(volume)
    pilot = planner.begin(mission())
    for k in range(4):
        move = pilot.decide(observed(0.0, 0.0, HEIGHT, k * PROTOCOL.heading_step), occupancy)
        assert (move.advance, move.climb) == (0.0, 0.0)


def test_it_passes_over_what_stands_up_no_higher_than_the_search_leaves_room_for() -> None:
    volume = water()
    solid(volume, (2.0, 2.0, SEABED), (3.0, 3.0, SEABED + 1.0))
    solid(volume, (-3.0, 2.0, SEABED), (-2.0, 3.0, SEABED + 3.5))
    occupancy, search = map_of(volume), InWater(mission())
    top = np.full(occupancy.shape, -np.inf)
    for x, y, z in volume.surface().middles:
        if occupancy.contains(x, y):
            top[occupancy.cell_of(x, y)] = max(top[occupancy.cell_of(x, y)], z + 0.5 * PROTOCOL.cell)
    assert PROTOCOL.space is not None
    room = occupancy.ground + search.height - PROTOCOL.space.lowest
    found = search.passed_over(occupancy)
    np.testing.assert_array_equal(found, occupancy.solid & (top <= room))
    assert found[occupancy.cell_of(2.5, 2.5)]
    assert (occupancy.solid & ~found)[occupancy.cell_of(-2.5, 2.5)]


@dataclass
class Scripted:
    """Says what it is told to, and counts how often it was asked."""

    says: list[Decision]
    asked: int = 0

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        self.asked += 1
        return self.says[min(self.asked, len(self.says)) - 1]


DONE, ON = Decision(done=True), Decision(advance=1.0)


@pytest.mark.parametrize(
    ("says", "asked", "done"), [([ON], 1, False), ([DONE, ON], 2, False), ([DONE, DONE, ON], 2, True)]
)
def test_a_done_before_the_ground_is_searched_is_asked_about_once_more(
    says: list[Decision], asked: int, done: bool
) -> None:
    scripted = Scripted(says)
    pilot = OverGround(mission(), lambda _: scripted)
    move = pilot.decide(observed(0.0, 0.0, HEIGHT, 0.0), map_of(water(4.0)))
    assert (scripted.asked, move.done) == (asked, done)


def test_it_ends_where_the_search_of_belief_does_whatever_the_pilot_says() -> None:
    """All of a small area was seen."""
    occupancy = map_of(water())
    small = replace(BOUNDS, x_min=-2.0, y_min=-2.0, x_max=2.0, y_max=2.0)
    occupancy.restrict(small)
    brief = replace(mission(), area=small)
    here, scripted = observed(0.0, 0.0, HEIGHT, 0.0), Scripted([ON])
    search = GroundSearch(brief, replace(Belief(), certify=True).in_plane)
    ended = search.decide(here, occupancy)
    assert ended.done
    move = OverGround(brief, lambda _: scripted).decide(here, occupancy)
    assert move.done
    assert move.reasoning.action == ENOUGH
    assert scripted.asked == 0
    assert np.count_nonzero(occupancy.to_see) == 256
