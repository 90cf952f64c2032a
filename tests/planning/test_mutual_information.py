"""What the planner by mutual information promises, on maps drawn by hand."""

from __future__ import annotations

import numpy as np
import pytest

from dream.mapping import view
from dream.planning import MutualInformation
from dream.planning.travel import careful_travel
from dream.planning.viewpoints import viewpoints_from
from dream.protocol import DREAM_V1
from dream.types import Mission
from tests.mapping.analytic import AREA, map_with
from tests.planning.flights import all_but, observed_at

MISSION = Mission(DREAM_V1, AREA, 200)
ALL = 10_000


@pytest.mark.rare
def test_it_goes_for_the_best_of_all_ways_by_what_they_tell_and_show_together() -> None:
    explored = all_but(np.s_[:30, :40], np.s_[50:80, 66:90])
    target = np.zeros_like(explored)
    target[40:50, 60:75] = True
    occupancy = map_with(explored=explored, target=target)
    observation = observed_at(1.0, 0.5, np.pi / 3)
    pilot = MutualInformation(paths=ALL).in_plane(MISSION)
    pilot.decide(observation, occupancy)
    goal = pilot.remains.goal
    assert goal is not None
    # The same, way by way: cells of target and squares of what the looks on the way show together.
    planner, ground = pilot.planner, pilot.ground
    travel = careful_travel(observation.pose, occupancy)
    bound = np.clip(ground.expected + planner.beta * np.sqrt(ground.variances), 0.0, 1.0)
    cells = ground.on_cells(np.where(bound >= planner.level, bound, 0.0)) * ~occupancy.observed
    left = ground.on_squares((cells > 0.0).astype(float)) * ~ground.known
    views = viewpoints_from(travel, occupancy, np.ones(occupancy.shape, np.float32))
    rates = {}
    for k, heading in np.argwhere((views.steps > 0) & (views.gains > 0.0)):
        pose = views.lattice.pose_at(int(views.nodes[k]), int(heading))
        shown = np.zeros(occupancy.shape, np.bool_)
        for one in travel.path(pose)[1:]:
            there = travel.lattice.world(one)
            shown |= view(occupancy, there.x, there.y, there.yaw)
        covered = ground.on_squares((shown & ~occupancy.observed).astype(float))
        squares = np.flatnonzero((left > 0.0) & (covered >= 0.5 * left))
        gain = cells[shown].sum() + planner.tell * ground.information(squares)
        if gain >= pilot.remains.least:
            rates[pose] = gain / views.steps[k, heading]
    assert len(rates) > 100
    assert rates[goal] == pytest.approx(max(rates.values()), rel=1e-4)
    assert min(rates.values()) < 0.5 * max(rates.values())


def test_of_two_gaps_alike_it_goes_to_the_one_beside_targets() -> None:
    explored = all_but(np.s_[40:56, :10], np.s_[40:56, 86:])
    goals = []
    for cols in (np.s_[10:14], np.s_[82:86]):
        target = np.zeros_like(explored)
        target[40:56, cols] = True
        pilot = MutualInformation().in_plane(MISSION)
        pilot.decide(observed_at(0.0, 0.0, np.pi / 2), map_with(explored=explored, target=target))
        assert pilot.remains.goal is not None
        travel = careful_travel(observed_at(0.0, 0.0, 0.0).pose, map_with(explored=explored))
        goals.append(travel.lattice.position(pilot.remains.goal)[0])
    west, east = goals
    assert west < 0.0 < east


def test_ground_that_is_bare_by_all_that_is_known_is_not_looked_for_until_done_is_refused() -> None:
    """A gap of a metre in bare ground, and the same between targets."""
    gap = np.s_[48:52, 48:52]
    observation = observed_at(-5.0, 0.0, 0.0)
    pilot = MutualInformation(least=0.01).in_plane(MISSION)
    bare = map_with(explored=all_but(gap))
    assert pilot.decide(observation, bare).done
    assert not pilot.decide(observation, bare).done
    target = np.zeros((96, 96), np.bool_)
    target[44:56, 44:56] = True
    target[gap] = False
    between = map_with(explored=all_but(gap), target=target)
    assert not MutualInformation(least=0.01).in_plane(MISSION).decide(observation, between).done


def test_without_worth_of_information_it_goes_by_the_targets_to_be_expected_alone() -> None:
    occupancy = map_with(explored=all_but(np.s_[:, 60:]))
    pilot = MutualInformation(tell=0.0, paths=ALL).in_plane(MISSION)
    pilot.decide(observed_at(-5.0, 0.0, np.pi), occupancy)
    worth = pilot._worth(occupancy)
    shown = np.zeros(occupancy.shape, np.bool_)
    shown[:40, 60:70] = True
    assert worth.of_cells(shown) == pytest.approx(worth.target[shown].sum())
    assert worth.target[:, 60:].all()
    assert not worth.target[:, :60].any()
