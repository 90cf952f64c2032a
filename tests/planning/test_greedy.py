"""The best next view: it is the best of all that there are, and believes what `belief` does."""

from __future__ import annotations

import numpy as np
import pytest

from dream.mapping.volume import Volume
from dream.planning import Belief, Greedy
from dream.planning.belief import BeliefPilot
from dream.planning.greedy import NextLook, NextView
from dream.planning.lookahead import Plan
from dream.planning.space.looks import shown
from dream.planning.space.remains import SURFACE, LeftToInspect, elements_of
from dream.planning.space.ways import KnownWays, ways_in
from dream.planning.viewpoints import Viewpoints
from dream.protocol import DREAM_V1
from dream.protocol import DREAM_V2_TRUE as PROTOCOL
from dream.types import Mission
from tests.planning.standing import BOUNDS, observed
from tests.planning.test_lookahead import WIDE, Scene, _scene

Z = -8.0


def chosen(scene: Scene) -> Plan | None:
    return NextView().plan(scene.prospect, scene.travel, scene.moves, scene.known)


def views(scene: Scene) -> Viewpoints:
    """Every single view, by the kernels that `ranked` asks."""
    return Belief().look_ahead.viewpoints(scene.prospect, scene.travel)


@pytest.mark.parametrize("worth", [(slice(40, 56), slice(70, 90), 1.0), (slice(2, 30), slice(2, 90), 0.3)])
def test_no_view_in_the_plane_shows_more_for_its_distance(worth: tuple[slice, slice, float]) -> None:
    scene = _scene(worth, (slice(80, 90), slice(80, 90), 2.0))
    plan = chosen(scene)
    assert plan is not None
    every = views(scene)
    rates = np.where(every.steps > 0, every.gains / np.maximum(every.steps, 1), 0.0)
    assert plan.rate == pytest.approx(float(rates.max()), rel=1e-5)
    assert len(plan.path) - 1 == scene.travel.steps[plan.path[-1]]


def test_where_nothing_is_worth_looking_at_there_is_no_way() -> None:
    assert chosen(_scene((slice(0, 5), slice(0, 5), 0.0))) is None


def test_what_comes_after_a_view_plays_no_part() -> None:
    # A little close by, and much behind it: who looks ahead passes by the one on the way to the other.
    near = (slice(46, 50), slice(22, 26), 1.0)
    alone, both = chosen(_scene(near)), chosen(_scene(near, (slice(60, 61), slice(90, 91), 1.0)))
    assert alone is not None
    assert both is not None
    assert alone.path == both.path


@pytest.fixture(scope="module")
def ways() -> KnownWays:
    volume = Volume(PROTOCOL)
    for x in np.arange(-8.0, 8.1, 1.0):
        volume.clear([x, 0.0, Z], 3.0)
    return ways_in(volume, BOUNDS, PROTOCOL)


def test_no_look_in_space_shows_more_for_its_distance(ways: KnownWays) -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-6, 6, 40), rng.uniform(-3, 3, 40), np.full(40, Z - 2.0)])
    up = np.tile([0.0, 0.0, 1.0], (40, 1))
    left = LeftToInspect(points, up, rng.uniform(0.5, 2.0, 40), np.full(40, SURFACE), 0.0, 0.0)
    here = observed(0.0, 0.0, Z, 0.0)
    plan = NextLook().plan(ways, left, here)
    assert plan is not None
    steps, best = ways.steps(here.pose, here.z), 0.0
    # The slow twin asks every second look near by, one after the other.
    for node in np.argwhere((steps >= 0).any(axis=-1) & (steps.max(axis=-1) <= 3)):
        if ((node + np.array(ways.first)) % 2).any():
            continue
        x, y, z = ((node + np.array(ways.first))[::-1] * PROTOCOL.lattice).tolist()
        for heading in range(PROTOCOL.headings):
            there = steps[(*node, heading)]
            for tilt in PROTOCOL.tilts:
                yaw = heading * PROTOCOL.heading_step
                sees = shown(ways, (x, y, z), yaw, tilt, *elements_of(left, PROTOCOL)[:3])
                best = max(best, float(left.area[sees].sum()) / max(int(there), 1) if there >= 0 else 0.0)
    assert plan.rate >= best - 1e-6
    assert NextLook().plan(ways, left.only(np.zeros(40, np.bool_)), here) is None


def test_it_believes_what_belief_does() -> None:
    pilot = Greedy().begin(Mission(DREAM_V1, WIDE, 200))
    assert isinstance(pilot, BeliefPilot)
    assert pilot.planner == Belief(eager=Greedy().eager, search=Greedy().search)
    assert isinstance(pilot.chooser, NextView)
