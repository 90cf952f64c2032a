"""The way round all that is foretold: what it shows, where it leads, and its slow twins."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest

from dream.geometry import SE2, Bounds
from dream.mapping import OccupancyMap
from dream.mapping._kernels import flags
from dream.planning._kernels import lookahead
from dream.planning._kernels import rounds as kernels
from dream.planning.lookahead import Plan, Prospect
from dream.planning.outlook import Outlook
from dream.planning.rounds import Rounds, _listed
from dream.planning.travel import Travel, careful_standoff, careful_travel
from dream.protocol import DREAM_V1
from dream.types import Mission
from tests.planning.views import shown_by

ARENA = Bounds(-12.0, -12.0, 12.0, 12.0)
BLOCK = slice(20, 26), slice(60, 66)
"""Solid cells between some of the ground and the vehicle."""
PATCHES = ((slice(8, 16), slice(70, 78)), (slice(70, 80), slice(80, 90)), (slice(60, 64), slice(8, 12)))


@dataclass(frozen=True)
class Scene:
    """Known ground with a block on it, and a vehicle that looks east at (-9, 0)."""

    travel: Travel
    prospect: Prospect
    moves: npt.NDArray[np.uint8]

    @property
    def weights(self) -> npt.NDArray[np.float32]:
        return self.prospect.weights

    def plan(self, rounds: Rounds, leave: float) -> Plan | None:
        return rounds.plan(self.prospect, self.travel, self.moves, leave)

    def left(self, plan: Plan) -> float:
        """Weight that a way leaves, pose by pose."""
        views, seen = self.prospect.outlook.views(), set()
        for pose in plan.path[1:]:
            seen |= shown_by(views, *pose)
        return float(sum(w for k, w in enumerate(self.weights) if k not in seen))


@pytest.fixture(scope="module")
def scene() -> Scene:
    occupancy = OccupancyMap(ARENA, DREAM_V1)
    solid = np.zeros(occupancy.shape, np.bool_)
    solid[BLOCK] = True
    occupancy._write("flags", (0, 0), np.where(solid, 0, flags.EXPLORED | flags.BARE).astype(np.uint8))
    occupancy._write("log_odds", (0, 0), 20 * solid)
    outlook = Outlook(Mission(DREAM_V1, ARENA, 200), 1.5)
    outlook.update(occupancy)
    travel = careful_travel(SE2(-9.0, 0.0, 0.0), occupancy)
    ground, hiding = np.zeros((2, *occupancy.shape))
    for k, patch in enumerate(PATCHES):
        ground[patch] = 0.1 * (k + 1)
    hiding[40:60, 40:60] = 0.01
    nothing = np.zeros(outlook.tiles, np.float32)
    prospect = Prospect(outlook, outlook.on_tiles(ground), outlook.on_tiles(hiding), nothing, nothing)
    return Scene(travel, prospect, outlook.moves(travel.free, occupancy, careful_standoff(DREAM_V1)))


def test_a_list_pose_by_pose_holds_what_the_views_show_of_the_elements(scene: Scene) -> None:
    views, index = scene.prospect.outlook.views(), np.flatnonzero(scene.weights)
    listed = _listed(index, views)
    for node in np.random.default_rng(1).choice(len(views.depth), 60, replace=False):
        row, col = divmod(int(node), views.cols)
        for heading in range(DREAM_V1.headings):
            shown = shown_by(views, row, col, heading) & set(index.tolist())
            assert shown_by(listed, row, col, heading) == shown
    assert len(listed.listed_element) == listed.listed_first[-1] > 0


def test_a_way_leaves_no_more_than_it_may_and_begins_with_a_free_move(scene: Scene) -> None:
    total = float(scene.weights.sum())
    for share in (0.3, 0.05, 0.01):
        plan = scene.plan(Rounds(), share * total)
        assert plan is not None
        assert plan.path[0] == scene.travel.start
        assert scene.left(plan) <= share * total + 1e-3
        turn, advance = scene.travel.move(*plan.path[:2])
        assert turn or advance
        for before, after in pairwise(plan.path):
            advance = scene.travel.move(before, after)[1]
            if before[:2] != after[:2]:
                assert scene.moves[(*before[:2], after[2], DREAM_V1.advances.index(advance))] != 0


def test_a_way_is_no_longer_than_it_needs_to_be_to_leave_so_little(scene: Scene) -> None:
    leave = 0.05 * float(scene.weights.sum())
    plan = scene.plan(Rounds(), leave)
    assert plan is not None
    shorter = Plan(plan.path[:-1], 0.0, 0.0)
    assert scene.left(shorter) > leave


def test_what_may_be_left_needs_no_way(scene: Scene) -> None:
    assert scene.plan(Rounds(), float(scene.weights.sum())) is None


def test_what_is_nowhere_of_any_weight_needs_no_way_however_much_there_is_of_it(scene: Scene) -> None:
    tiles = scene.prospect.outlook.tiles
    many = np.full(tiles, 0.9e-4, np.float32)
    of = Prospect(scene.prospect.outlook, many, many, scene.prospect.targets, scene.prospect.hidden)
    assert 2.0 * many.sum() > 1.0
    assert Scene(scene.travel, of, scene.moves).plan(Rounds(), 1.0) is None


def test_hiding_places_count_as_ground_does(scene: Scene) -> None:
    tiles = scene.prospect.outlook.tiles
    leave = 0.02 * float(scene.prospect.hiding.sum())
    alone = Scene(
        scene.travel,
        Prospect(
            scene.prospect.outlook,
            np.zeros(tiles, np.float32),
            scene.prospect.hiding,
            scene.prospect.targets,
            scene.prospect.hidden,
        ),
        scene.moves,
    )
    plan = alone.plan(Rounds(), leave)
    assert plan is not None
    assert alone.left(plan) <= leave + 1e-3


def test_the_rest_of_a_way_is_gone_on_with_unless_a_shorter_one_is_found(scene: Scene) -> None:
    rounds, leave = Rounds(), 0.01 * float(scene.weights.sum())
    first = scene.plan(rounds, leave)
    assert first is not None
    again = scene.plan(rounds, leave)
    assert again is not None
    assert len(again.path) <= len(first.path) + 1


def test_what_a_way_shows_equals_its_slow_twin(scene: Scene) -> None:
    plan, index = scene.plan(Rounds(), 0.02 * float(scene.weights.sum())), np.flatnonzero(scene.weights)
    assert plan is not None
    views, shape = scene.prospect.outlook.views(), scene.travel.steps.shape
    path = np.array([np.ravel_multi_index(pose, shape) for pose in plan.path])
    steps, bits, left = kernels.follow(scene.weights, views, path, shape, index, 0.0)
    assert steps == len(plan.path) - 1
    assert left == pytest.approx(scene.left(plan), abs=1e-3)
    seen = np.zeros_like(bits)
    for pose in plan.path[1:]:
        lookahead.look(scene.weights, seen, views, *pose)
    np.testing.assert_array_equal(bits, seen)
