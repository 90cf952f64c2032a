from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dream.evaluation.oracle.graph import PoseGraph, actions_of, pose_graph
from dream.geometry import SE2, Bounds
from dream.protocol import DREAM_V1, DREAM_V1_NAV
from dream.sim.solids import Solids
from dream.sim.visibility import Visibility
from dream.sim.world import World
from dream.types import LOOK_AROUND


@pytest.fixture(scope="module")
def world(string_reef: World) -> World:
    """The part of the reef with most of the boulders: the graph of all of it takes seconds."""
    return replace(string_reef, bounds=Bounds(-2.0, -8.0, 14.0, 12.0), starts=string_reef.starts[2:3])


@pytest.fixture(scope="module")
def visibility(world: World) -> Visibility:
    return Visibility(world, DREAM_V1)


@pytest.fixture(scope="module")
def graph(world: World, visibility: Visibility) -> PoseGraph:
    return pose_graph(world, DREAM_V1, visibility=visibility)


def key(x: float, y: float, yaw: float) -> tuple[int, int, int]:
    return round(x / DREAM_V1.lattice), round(y / DREAM_V1.lattice), DREAM_V1.heading_index(yaw)


def moved(pose: tuple[float, float, float], action: tuple[int, float]) -> SE2:
    heading = DREAM_V1.heading_index(pose[2]) + action[0]
    east, north = DREAM_V1.offset(heading, action[1]) if action[1] else (0, 0)
    step = DREAM_V1.lattice
    return SE2(pose[0] + east * step, pose[1] + north * step, heading * DREAM_V1.heading_step)


@pytest.mark.rare
def test_arcs_are_the_moves_that_a_sweep_finds_free(graph: PoseGraph, visibility: Visibility) -> None:
    rng = np.random.default_rng(0)
    pose_of = {key(*pose): k for k, pose in enumerate(graph.poses.tolist())}
    # Those that lead nowhere are rare, and most of them leave the lattice.
    free, blocked = np.nonzero(graph.arcs >= 0), np.nonzero(graph.arcs < 0)
    checked = {True: 0, False: 0}
    for (poses, actions), count in ((free, 400), (blocked, 4000)):
        for n in rng.choice(len(poses), count, replace=False):
            pose, action = int(poses[n]), int(actions[n])
            x, y, yaw = graph.poses[pose].tolist()
            end = moved((x, y, yaw), graph.actions[action])
            target = pose_of.get(key(end.x, end.y, end.yaw), -1)
            if target >= 0 and visibility.solids.sweep(SE2(x, y, end.yaw), end, DREAM_V1, limit=0.1).contact:
                checked[False] += 1
                target = -1
            assert graph.arcs[pose, action] == target
            checked[True] += target >= 0
    assert checked[True] >= 400
    assert checked[False] > 50


def test_views_are_what_visibility_says(graph: PoseGraph, visibility: Visibility) -> None:
    which = np.random.default_rng(1).choice(len(graph.poses), 300, replace=False)
    seen = visibility.seen(graph.poses[which])[:, graph.individuals]
    flags = np.unpackbits(graph.views[which].astype("<u8").view(np.uint8), axis=1, bitorder="little")
    assert (flags[:, : len(graph.individuals)] == seen).all()
    assert not flags[:, len(graph.individuals) :].any()
    assert seen.any()


def test_every_individual_is_seen_from_some_pose(graph: PoseGraph, visibility: Visibility) -> None:
    flags = np.unpackbits(
        np.bitwise_or.reduce(graph.views, axis=0).astype("<u8").view(np.uint8), bitorder="little"
    )
    assert flags[: len(graph.individuals)].all()
    assert len(graph.individuals) == visibility.countable.sum()


def test_it_starts_after_the_look_around(graph: PoseGraph, visibility: Visibility, world: World) -> None:
    home = world.starts[0]
    x, y, yaw = graph.poses[graph.start].tolist()
    quarters = DREAM_V1.headings // 4
    assert key(x, y, yaw) == key(home.x, home.y, home.yaw + LOOK_AROUND * quarters * DREAM_V1.heading_step)
    around = [[x, y, home.yaw + k * np.pi / 2] for k in range(LOOK_AROUND + 1)]
    seen = np.flatnonzero(visibility.seen(around)[:, graph.individuals].any(axis=0))
    assert set(seen) == {
        i for i in range(len(graph.individuals)) if int(graph.shown[i // 64]) >> (i % 64) & 1
    }


def test_a_walk_goes_where_its_actions_lead_and_refuses_contact(graph: PoseGraph) -> None:
    turn = graph.actions.index((1, 0.0))
    assert graph.walk([]) == [graph.start]
    assert len(set(graph.walk([turn] * 12)[:-1])) == 12
    assert graph.walk([turn] * 12)[-1] == graph.start
    ahead = graph.actions.index((0, 2.0))
    with pytest.raises(ValueError, match=r"action \d+: \(0, 2.0\) from .* touches something"):
        graph.walk([ahead] * 100)
    with pytest.raises(ValueError, match="action 1: expected 0 to 22, got 23"):
        graph.walk([turn, 23])


def test_actions_change_the_pose() -> None:
    actions = actions_of(DREAM_V1)
    assert len(actions) == len(set(actions)) == 23
    assert (0, 0.0) not in actions


def test_moves_pass_where_a_sweep_has_no_contact(string_reef: World) -> None:
    solids = Solids(string_reef)
    rng = np.random.default_rng(2)
    bounds = string_reef.bounds
    starts = rng.uniform([bounds.x_min, bounds.y_min], [bounds.x_max, bounds.y_max], (400, 2))
    ends = starts + rng.uniform(-3.0, 3.0, (400, 2))
    passes = solids.passes(starts, ends, DREAM_V1)
    sweeps = [
        not solids.sweep(SE2(ax, ay, 0.0), SE2(bx, by, 0.0), DREAM_V1, limit=0.1).contact
        for (ax, ay), (bx, by) in zip(starts.tolist(), ends.tolist(), strict=True)
    ]
    assert passes.tolist() == sweeps
    assert 0 < sum(sweeps) < 400
    with pytest.raises(ValueError, match=r"ends: expected \(400, 2\) like starts"):
        solids.passes(starts, ends[1:], DREAM_V1)


def test_a_vehicle_that_swims_moves_on_no_graph(empty_world: World) -> None:
    with pytest.raises(ValueError, match="expected one whose moves are exact, got dream-v1-nav"):
        pose_graph(empty_world, DREAM_V1_NAV)
