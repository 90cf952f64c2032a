"""Places that a model may choose among: apart, safe to get to, and with what they cost."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from dream.control import guard
from dream.evaluation.runner import simulate
from dream.mapping import OccupancyMap
from dream.planning import Belief
from dream.planning.vlm.places import APART, MOST, Place, again, places
from dream.protocol import DREAM_V1
from dream.sim.world import World
from dream.types import Decision, Mission, Observation
from tests.mapping.analytic import map_with
from tests.planning.flights import all_but, observed_at


@pytest.fixture(scope="module")
def looked_around(string_reef: World) -> tuple[Observation, OccupancyMap]:
    *_, last = simulate(string_reef, Belief(), DREAM_V1, max_steps=16)
    return last.observation, last.occupancy


@pytest.fixture(scope="module")
def listed(looked_around: tuple[Observation, OccupancyMap]) -> tuple[list[Place], Any, Any]:
    observation, occupancy = looked_around
    pilot = Belief().in_plane(Mission(DREAM_V1, occupancy.bounds, 200))
    thought = pilot.consider(observation, occupancy)
    return places(pilot, thought), pilot, thought


def test_the_first_place_is_where_the_offline_planner_would_go(listed: tuple[list[Place], Any, Any]) -> None:
    found, _, thought = listed
    assert 2 <= len(found) <= MOST
    assert found[0].plan.path == thought.plan.path
    assert found[0].loss == 0.0
    assert all(place.loss >= 0.0 for place in found)


def test_every_move_to_every_place_is_one_that_the_guard_lets_pass(
    listed: tuple[list[Place], Any, Any], looked_around: tuple[Observation, OccupancyMap]
) -> None:
    found, _, thought = listed
    _, occupancy = looked_around
    for place in found[1:]:
        for before, after in pairwise(place.plan.path):
            turn, advance = thought.travel.move(before, after)
            pose = DREAM_V1.snap(thought.travel.lattice.world(before))
            assert not guard(Decision(turn, advance), pose, occupancy, DREAM_V1).note


def test_places_stand_apart(listed: tuple[list[Place], Any, Any]) -> None:
    found, _, _ = listed
    ends = np.array([place.path[-1] for place in found])
    gaps = np.hypot(*(ends[:, None] - ends[None, :]).transpose(2, 0, 1)) + 99.0 * np.eye(len(ends))
    assert gaps.min() >= APART * DREAM_V1.reach
    for place in found[1:]:
        assert np.hypot(*(found[0].path - place.path[-1]).T).min() >= APART * DREAM_V1.reach


def test_a_place_is_worth_the_same_when_it_is_asked_for_again(listed: tuple[list[Place], Any, Any]) -> None:
    found, pilot, thought = listed
    for place in found[1:]:
        now = again(pilot, thought, place.pose)
        assert now is not None
        assert now[0].path == place.plan.path
        assert now[1] == pytest.approx(place.loss)
    assert again(pilot, thought, thought.travel.start) is None


def test_a_place_closes_the_regions_whose_open_cells_all_come_into_view_on_the_way() -> None:
    hole, whole = np.s_[46:50, 40:44], np.s_[60:64, 20:24]
    far = np.s_[20:24, 92:96]
    target = ~all_but(np.s_[44:46, 40:44], whole, np.s_[18:20, 92:96])
    occupancy = map_with(explored=all_but(hole, far), target=target)
    pilot = Belief(width=4, horizon=2).in_plane(Mission(DREAM_V1, occupancy.bounds, 200))
    thought = pilot.consider(observed_at(-6.0, 0.0, 0.0), occupancy)
    regions = thought.completion.regions
    assert sorted(region.enclosed for region in regions) == [False, False, True]
    found = places(pilot, thought)
    for place in found:
        shown = np.zeros(occupancy.shape, np.bool_)
        for pose in place.plan.path[1:]:
            shown |= pilot.pose_views.shown(pose)[0]
        closed = [n for n, region in enumerate(regions) if shown[tuple(region.open_cells.T)].all()]
        assert place.closes == tuple(n + 1 for n in closed if not regions[n].enclosed)
    assert any(place.closes for place in found)
