"""What the baselines' names promise, on maps drawn by hand and in an empty arena."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from dream.control import guard
from dream.evaluation.runner import simulate
from dream.geometry import SE2
from dream.mapping import OccupancyMap, check_completion, frontiers, hiding_places, view
from dream.planning import (
    AnyPlanner,
    Lawnmower,
    MutualInformation,
    NearestFrontier,
    NextBestView,
    Spiral,
    SweepAndGraze,
)
from dream.planning.baselines.remains import Remains, group_cells
from dream.planning.travel import careful_travel, travel_from
from dream.planning.viewpoints import viewpoints_from
from dream.protocol import DREAM_V1
from dream.sim.world import World
from dream.types import Mission, Step
from tests.mapping.analytic import AREA, map_with
from tests.planning.flights import all_but, observed_at

MISSION = Mission(DREAM_V1, AREA, 200)
SEARCHERS: dict[str, AnyPlanner] = {
    "lawnmower": Lawnmower(),
    "spiral": Spiral(),
    "frontier": NearestFrontier(),
    "nbv": NextBestView(),
    "sweep-and-graze": SweepAndGraze(),
    "mutual-information": MutualInformation(),
}
searchers = pytest.mark.parametrize("planner", SEARCHERS.values(), ids=SEARCHERS)


@pytest.fixture(scope="module")
def sandbox(empty_world: World) -> World:
    """A small piece of the flat sand: no target, so that only ground seen to the last cell is complete."""
    return replace(empty_world, bounds=AREA, starts=(SE2(-4.0, 6.5, 0.0),))


SLIT = np.s_[70:72, 20:22]
"""Four cells: no group hides there."""


# ------------------------------------------------------------------------------------------ all of them


@searchers
def test_a_refused_done_leads_to_the_ground_that_is_left(planner: AnyPlanner) -> None:
    occupancy = map_with(explored=all_but(SLIT))
    observation = observed_at(3.0, -4.0, 0.0)
    assert not hiding_places(occupancy, observation.pose, DREAM_V1.group_radius).any()
    assert not check_completion(occupancy, observation.pose).complete, "so that done would be refused"
    pilot = planner.begin(MISSION)
    decisions = [pilot.decide(observation, occupancy) for _ in range(6)]
    claims = [decision.done for decision in decisions]
    assert claims[0], "four cells are not worth the way before done was refused"
    assert not any(claims[1:]), "from then on it is"
    assert not any(decision.stops for decision in decisions[1:])


@searchers
def test_nothing_left_is_done(planner: AnyPlanner) -> None:
    assert planner.begin(MISSION).decide(observed_at(3.0, -4.0, 0.0), map_with(explored=all_but())).done


@pytest.mark.few(3)
@searchers
def test_ground_that_never_shows_is_given_up_and_then_it_says_done_without_end(planner: AnyPlanner) -> None:
    """The map promises a view of the slit that never comes true, as behind a low boulder."""
    occupancy = map_with(explored=all_but(SLIT))
    pilot, pose = planner.begin(MISSION), SE2(-3.0, 2.0, 0.0)
    decisions = []
    for _ in range(45):
        decision = guard(
            pilot.decide(observed_at(pose.x, pose.y, pose.yaw), occupancy), pose, occupancy, DREAM_V1
        )
        assert not decision.note, "what it asks for is allowed"
        decisions.append(decision.decision)
        yaw = pose.yaw + decision.decision.turn
        east, north = (
            DREAM_V1.offset(DREAM_V1.heading_index(yaw), decision.decision.advance)
            if decision.decision.advance
            else (0, 0)
        )
        pose = DREAM_V1.snap(SE2(pose.x + east * DREAM_V1.lattice, pose.y + north * DREAM_V1.lattice, yaw))
    claimed = [k for k, decision in enumerate(decisions) if decision.done]
    assert len(claimed) >= 2, "done again once the slit is given up"


@pytest.mark.few(3)
@searchers
def test_it_sees_an_empty_arena_and_stops(planner: AnyPlanner, sandbox: World) -> None:
    *_, last = simulate(sandbox, planner, DREAM_V1)
    assert last.ended == "done"
    assert last.occupancy.observed.mean() >= 0.99
    assert check_completion(last.occupancy, last.observation.pose).complete


# ------------------------------------------------------------------------------------------ remains


def test_a_cell_is_given_up_after_looks_in_vain_until_something_beside_it_is_seen() -> None:
    occupancy = map_with(explored=all_but(SLIT))
    pose = SE2(-4.0, 2.0, math.pi / 2)
    assert view(occupancy, pose.x, pose.y, pose.yaw)[SLIT].all()
    remains = Remains(MISSION, least=1.0)
    for _ in range(remains.failed.patience):
        assert remains.worth_looking(occupancy)[SLIT].all()
        remains.look(pose, occupancy)
    assert not remains.worth_looking(occupancy).any()
    nearer = map_with(explored=all_but(np.s_[71:72, 20:22]))
    remains.look(SE2(8.0, -8.0, 0.0), nearer)
    assert remains.worth_looking(nearer)[71, 20:22].all(), "the row above was seen"


def test_of_the_views_that_show_enough_the_nearest_is_taken() -> None:
    occupancy = map_with(explored=all_but(SLIT))
    travel = travel_from(SE2(3.0, -4.0, 0.0), occupancy)
    views = viewpoints_from(travel, occupancy, np.ones(occupancy.shape, np.float32))
    enough = views.gains >= 3.0
    nearest = views.nearest(3.0)
    assert nearest is not None
    assert nearest.gain >= 3.0
    assert nearest.steps == views.steps[enough & (views.steps > 0)].min()
    assert nearest.gain == views.gains[views.steps == nearest.steps].max()
    assert views.at(nearest.pose) == nearest
    assert views.nearest(5.0) is None, "the slit has four cells"


# ------------------------------------------------------------------------------------------ frontier

WALL = np.s_[:, 40:44]


def test_frontier_leaves_out_a_cluster_that_it_cannot_get_to() -> None:
    solid = np.zeros((96, 96), np.bool_)
    solid[WALL] = True
    # West of the wall all but a strip far in the south; east of it a frontier close by.
    explored = all_but(np.s_[:8, :40], np.s_[:, 50:])
    occupancy = map_with(solid=solid, explored=explored)
    observation = observed_at(-4.0, 8.0, 0.0)
    clusters = frontiers(occupancy)
    assert {bool(cluster.centroid[0] > 0.0) for cluster in clusters} == {True, False}
    pilot = NearestFrontier().in_plane(MISSION)
    assert not pilot.decide(observation, occupancy).done
    travel = careful_travel(observation.pose, occupancy)
    assert pilot.remains.goal is not None
    goal = travel.lattice.world(pilot.remains.goal)
    assert travel.steps[pilot.remains.goal] > 0
    assert goal.y < -2.0, "it goes for the strip in the south"
    assert view(occupancy, goal.x, goal.y, goal.yaw)[:8, :40].any()
    closed = map_with(solid=solid, explored=explored | all_but(np.s_[8:, :], np.s_[:, 40:]))
    assert len(frontiers(closed)) == 1
    assert NearestFrontier().in_plane(MISSION).decide(observation, closed).done


def test_frontier_keeps_to_its_goal_on_the_way() -> None:
    occupancy = map_with(explored=all_but(np.s_[:8, :], np.s_[88:, :]))
    pilot = NearestFrontier().in_plane(MISSION)
    pilot.decide(observed_at(0.0, -1.0, -math.pi / 2), occupancy)
    goal = pilot.remains.goal
    pilot.decide(observed_at(0.0, 1.0, math.pi / 2), occupancy)
    assert goal is not None
    assert pilot.remains.goal == goal, "though the other frontier is as near now"


# ------------------------------------------------------------------------------------------ nbv


def test_nbv_goes_for_the_view_of_the_best_score() -> None:
    occupancy = map_with(explored=all_but(np.s_[:26, :40], np.s_[50:72, 60:80]))
    observation = observed_at(1.0, 0.5, math.pi / 3)
    planner = NextBestView(near=7)
    pilot = planner.in_plane(MISSION)
    decision = pilot.decide(observation, occupancy)
    travel = careful_travel(observation.pose, occupancy)
    views = viewpoints_from(travel, occupancy, np.ones(occupancy.shape, np.float32))
    gains, scores = {}, {}
    for node, heading in product(views.nodes.tolist(), range(DREAM_V1.headings)):
        pose = travel.lattice.pose_at(node, heading)
        there, steps = travel.lattice.world(pose), int(travel.steps[pose])
        if not 1 <= steps <= planner.near:
            continue
        gain = int((view(occupancy, there.x, there.y, there.yaw) & ~occupancy.observed).sum())
        if gain >= planner.least * group_cells(DREAM_V1):
            gains[pose] = gain
            scores[pose] = gain * math.exp(-planner.cost * steps)
    assert len(scores) > 20
    goal = pilot.remains.goal
    assert goal is not None
    assert scores[goal] == pytest.approx(max(scores.values()))
    assert gains[goal] < max(gains.values()), "the cost of the way matters here"
    path = travel.path(goal)
    assert (decision.turn, decision.advance) == travel.move(path[0], path[1])


def test_nbv_goes_far_where_nothing_near_gains() -> None:
    occupancy = map_with(explored=all_but(np.s_[78:, 78:]))
    pilot = NextBestView(near=2).in_plane(MISSION)
    observation = observed_at(-9.0, -9.0, 0.0)
    assert not pilot.decide(observation, occupancy).done
    travel = careful_travel(observation.pose, occupancy)
    assert pilot.remains.goal is not None
    assert travel.steps[pilot.remains.goal] > 2


# ------------------------------------------------------------------------------------------ graze


def test_graze_closes_a_region_before_it_resumes_the_lanes() -> None:
    explored = all_but(np.s_[:, 56:])
    target = np.zeros_like(explored)
    target[40:50, 48:56] = True
    observation = observed_at(-2.0, -2.0, math.pi)
    pilot = SweepAndGraze().in_plane(MISSION)
    bare = pilot.decide(observation, map_with(explored=explored))
    assert "route" in bare.reasoning.action
    ahead = pilot.sweeping.waypoints.copy()
    met = map_with(explored=explored, target=target)
    assert not check_completion(met, observation.pose).complete
    for _ in range(3):
        assert "edge of the region" in pilot.decide(observation, met).reasoning.action
    assert pilot.goal is not None
    travel = careful_travel(observation.pose, met)
    goal = travel.lattice.world(pilot.goal)
    shown = view(met, goal.x, goal.y, goal.yaw)
    (region,) = check_completion(met, observation.pose).regions
    assert shown[tuple(region.open_cells.T)].any(), "from its goal it sees some of the open edge"
    np.testing.assert_array_equal(pilot.sweeping.waypoints, ahead)
    closed = map_with(explored=explored | all_but(np.s_[:, 62:]), target=target)
    assert check_completion(closed, observation.pose).complete
    assert "route" in pilot.decide(observation, closed).reasoning.action
    assert len(pilot.sweeping.waypoints) >= len(ahead) - 4, "the lanes go on where they were left"


@pytest.mark.parametrize("planner", [Lawnmower(), Spiral(), NearestFrontier(), NextBestView()], ids=repr)
def test_the_blind_ones_do_not_care_where_targets_are(planner: AnyPlanner) -> None:
    explored = all_but(np.s_[:, 56:], np.s_[:20, :])
    target = np.zeros_like(explored)
    target[40:50, 48:56] = True
    observation = observed_at(-2.0, -1.0, 0.0)
    with_targets, without = (
        planner.begin(MISSION).decide(observation, occupancy)
        for occupancy in (map_with(explored=explored, target=target), map_with(explored=explored))
    )
    assert with_targets == without


# ------------------------------------------------------------------------------------------ lanes


@pytest.fixture(scope="module")
def mown(empty_world: World) -> list[Step]:
    return list(simulate(empty_world, Lawnmower(), DREAM_V1, max_steps=50))


def test_the_lanes_are_flown_straight(mown: list[Step]) -> None:
    """Once on the lanes, most steps go on in the same direction by the longest advance."""
    on_lanes = mown[20:]
    straight = [
        step.decision.turn == 0.0 and step.decision.advance == max(DREAM_V1.advances) for step in on_lanes
    ]
    assert np.mean(straight) >= 0.75


def test_a_waypoint_in_solid_ground_is_left_out() -> None:
    occupancy = map_with(explored=all_but(np.s_[:, 60:]))
    pilot = Lawnmower().in_plane(MISSION)
    observation = observed_at(-6.0, 0.0, 0.0)
    pilot.decide(observation, occupancy)
    x, y = pilot.waypoints[0]
    solid = np.zeros((96, 96), np.bool_)
    row, col = occupancy.cell_of(x, y)
    assert not occupancy.explored[row, col] or occupancy.standable[row, col]
    solid[row - 2 : row + 3, col - 2 : col + 3] = True
    blocked: OccupancyMap = map_with(solid=solid, explored=all_but(np.s_[:, 60:]) | solid)
    pilot.decide(observation, blocked)
    assert not (pilot.waypoints[0] == (x, y)).all()
