"""The way to an area that cannot be seen yet."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dream.approach import PATIENCE, Approach
from dream.evaluation.runner import simulate
from dream.geometry import Bounds
from dream.mapping import OccupancyMap
from dream.orders import Leg, Orders
from dream.planning import OFFLINE, PLANNERS
from dream.protocol import DREAM_V1
from dream.sim.world import World
from dream.types import Mission
from tests.mapping.analytic import AREA, empty_map, look_around, map_with
from tests.planning.flights import all_but, observed_at

EAST = Bounds(9.5, -2.0, 12.0, 2.0)


def approach(occupancy: OccupancyMap, area: Bounds = EAST) -> Approach:
    occupancy.restrict(area)
    return Approach(Mission(DREAM_V1, AREA, 200, area=area))


def seen_from_the_middle() -> OccupancyMap:
    occupancy = empty_map()
    occupancy.clear_launch(-4.0, 0.0)
    look_around(occupancy, -4.0, 0.0)
    return occupancy


def test_it_goes_towards_an_area_of_which_nothing_was_seen() -> None:
    occupancy = seen_from_the_middle()
    decision = approach(occupancy).decide(observed_at(-4.0, 0.0, 0.0), occupancy)
    assert decision is not None
    assert decision.turn == pytest.approx(0.0, abs=math.radians(31.0))
    assert decision.advance > 0.0
    assert "On the way to the area, which is 14 m away." in decision.reasoning.action


def test_it_leaves_an_area_to_the_planner_as_soon_as_some_of_it_is_seen() -> None:
    occupancy = seen_from_the_middle()
    wide = Bounds(2.0, -12.0, 12.0, 12.0)
    assert approach(occupancy, wide).decide(observed_at(-4.0, 0.0, 0.0), occupancy) is None


def test_within_the_area_there_is_no_way_to_go() -> None:
    occupancy = seen_from_the_middle()
    around = Bounds(-6.0, -3.0, 12.0, 3.0)
    assert approach(occupancy, around).decide(observed_at(-4.0, 0.0, 0.0), occupancy) is None


def test_it_turns_to_where_the_way_leads_on_before_it_goes_there() -> None:
    occupancy = empty_map()
    occupancy.clear_launch(-4.0, 0.0)
    decision = approach(occupancy).decide(observed_at(-4.0, 0.0, math.pi), occupancy)
    assert decision is not None
    # Nothing but the launch is known; from its edge, or from here, it looks to the east.
    assert abs(decision.turn) > math.radians(89.0)


def test_behind_a_wall_without_a_door_it_gives_up() -> None:
    wall = np.zeros((96, 96), np.bool_)
    wall[:, 60:63] = True
    known = all_but(np.s_[:, 60:])
    occupancy = map_with(solid=wall, explored=known)
    assert approach(occupancy).decide(observed_at(-4.0, 0.0, 0.0), occupancy) is None
    wall[40:56, 60:63] = False
    occupancy = map_with(solid=wall, explored=known)
    assert approach(occupancy).decide(observed_at(-4.0, 0.0, 0.0), occupancy) is not None


def test_ground_that_stays_unknown_is_not_waited_for_for_ever() -> None:
    # Nothing is ever integrated, as if no look showed anything.
    occupancy = empty_map()
    occupancy.clear_launch(-4.0, 0.0)
    way = approach(occupancy)
    yaw, answers = 0.0, []
    for _ in range(12 * PATIENCE):
        decision = way.decide(observed_at(-4.0, 0.0, yaw), occupancy)
        answers.append(decision)
        if decision is None:
            break
        yaw += decision.turn
    assert answers[-1] is None


def test_an_area_in_the_far_corner_is_come_to_and_mapped(empty_world: World) -> None:
    start, bounds = empty_world.starts[0], empty_world.bounds
    x = bounds.x_min if start.x > 0.0 else bounds.x_max - 8.0
    y = bounds.y_min if start.y > 0.0 else bounds.y_max - 8.0
    orders = Orders((Leg(area=Bounds(x, y, x + 8.0, y + 8.0)),))
    steps = list(simulate(empty_world, PLANNERS["frontier"], DREAM_V1, orders=orders))
    way = [step for step in steps if "On the way to the area" in step.decision.reasoning.action]
    assert len(way) >= 3
    assert steps[-1].ended == "done"
    occupancy = steps[-1].occupancy
    assert occupancy.seen[occupancy.to_see].mean() > 0.95
    straight = math.hypot(x + 4.0 - start.x, y + 4.0 - start.y)
    assert sum(step.arrival.distance for step in way) < straight


@pytest.mark.parametrize("name", [name for name in OFFLINE if name != "random"])
def test_an_area_around_the_start_is_mapped_though_the_launch_is_known(name: str, empty_world: World) -> None:
    start = empty_world.starts[0]
    area = Bounds(start.x - 4.0, start.y - 4.0, start.x + 4.0, start.y + 4.0)
    *_, last = simulate(empty_world, PLANNERS[name], DREAM_V1, orders=Orders((Leg(area=area),)))
    assert last.ended == "done"
    assert last.index < 40


def test_a_way_that_takes_far_longer_than_it_seemed_is_given_up() -> None:
    occupancy = seen_from_the_middle()
    way, here = approach(occupancy), observed_at(-4.0, 0.0, 0.0)
    assert way.decide(here, occupancy) is not None
    # As if it had gone to and fro all the time.
    way.steps = 46
    assert way.decide(here, occupancy) is not None
    assert way.decide(here, occupancy) is None
