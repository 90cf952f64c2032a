"""The tour round all that is foretold: what it shows, where it leads, and its slow twins."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest

from dream.geometry import SE2, Bounds
from dream.mapping import OccupancyMap
from dream.mapping._kernels import flags
from dream.planning._kernels.views import follow, look
from dream.planning.coverage_tour import CoverageTour
from dream.planning.lookahead import Plan, Prospect
from dream.planning.pose_views import PoseViews
from dream.planning.tours import Left, rest_of
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
    def weights(self) -> npt.NDArray[np.float64]:
        return self.prospect.weights.astype(np.float64)

    def plan(self, tour: CoverageTour, leave: float) -> Plan | None:
        return tour.plan(self.prospect, self.travel, self.moves, leave)

    def left(self, plan: Plan) -> float:
        """Weight that a way leaves, pose by pose."""
        views, seen = self.prospect.pose_views.views(), set()
        for pose in plan.path[1:]:
            seen |= shown_by(views, pose)
        return float(sum(w for k, w in enumerate(self.weights) if k not in seen))


@pytest.fixture(scope="module")
def scene() -> Scene:
    occupancy = OccupancyMap(ARENA, DREAM_V1)
    solid = np.zeros(occupancy.shape, np.bool_)
    solid[BLOCK] = True
    occupancy._write("flags", (0, 0), np.where(solid, 0, flags.EXPLORED | flags.BARE).astype(np.uint8))
    occupancy._write("log_odds", (0, 0), 20 * solid)
    pose_views = PoseViews(Mission(DREAM_V1, ARENA, 200), 1.5)
    pose_views.update(occupancy)
    travel = careful_travel(SE2(-9.0, 0.0, 0.0), occupancy)
    ground, hiding = np.zeros((2, *occupancy.shape))
    for k, patch in enumerate(PATCHES):
        ground[patch] = 0.1 * (k + 1)
    hiding[40:60, 40:60] = 0.01
    nothing = np.zeros(pose_views.tiles, np.float32)
    prospect = Prospect(
        pose_views, pose_views.on_tiles(ground), pose_views.on_tiles(hiding), nothing, nothing
    )
    return Scene(travel, prospect, pose_views.moves(travel.free, occupancy, careful_standoff(DREAM_V1)))


def test_a_list_pose_by_pose_holds_what_the_views_show_of_the_elements(scene: Scene) -> None:
    views, index = scene.prospect.pose_views.views(), np.flatnonzero(scene.weights)
    spots = np.zeros((len(index), 2))
    reached, cells = scene.travel.reached, spots.astype(np.int64)
    left = Left.of(scene.weights, index, cells, spots, views, scene.travel, scene.moves, reached)
    np.testing.assert_array_equal(left.weights, scene.weights[index])
    for pose in np.random.default_rng(1).choice(scene.travel.lattice.poses, 700, replace=False).tolist():
        shown = shown_by(views, pose) & set(index.tolist())
        assert set(index[list(shown_by(left.views, pose))].tolist()) == shown
    assert len(left.views.listed_element) == left.views.listed_first[-1] > 0


def test_a_way_leaves_no_more_than_it_may_and_begins_with_a_free_move(scene: Scene) -> None:
    total = float(scene.weights.sum())
    for share in (0.3, 0.05, 0.01):
        plan = scene.plan(CoverageTour(), share * total)
        assert plan is not None
        assert plan.path[0] == scene.travel.start
        assert scene.left(plan) <= share * total + 1e-3
        turn, advance = scene.travel.move(*plan.path[:2])
        assert turn or advance
        for before, after in pairwise(plan.path):
            lattice = scene.travel.lattice
            if lattice.node_of(before) != lattice.node_of(after):
                assert scene.moves[lattice.turned_to(before, after), lattice.advance_to(before, after)] != 0


def test_a_way_is_no_longer_than_it_needs_to_be_to_leave_so_little(scene: Scene) -> None:
    leave = 0.05 * float(scene.weights.sum())
    plan = scene.plan(CoverageTour(), leave)
    assert plan is not None
    shorter = Plan(plan.path[:-1], 0.0, 0.0)
    assert scene.left(shorter) > leave


def test_what_may_be_left_needs_no_way(scene: Scene) -> None:
    assert scene.plan(CoverageTour(), float(scene.weights.sum())) is None


def test_what_is_nowhere_of_any_weight_needs_no_way_however_much_there_is_of_it(scene: Scene) -> None:
    tiles = scene.prospect.pose_views.tiles
    many = np.full(tiles, 0.9e-4, np.float32)
    of = Prospect(scene.prospect.pose_views, many, many, scene.prospect.targets, scene.prospect.hidden)
    assert 2.0 * many.sum() > 1.0
    assert Scene(scene.travel, of, scene.moves).plan(CoverageTour(), 1.0) is None


def test_hiding_places_count_as_ground_does(scene: Scene) -> None:
    tiles = scene.prospect.pose_views.tiles
    leave = 0.02 * float(scene.prospect.hiding.sum())
    alone = Scene(
        scene.travel,
        Prospect(
            scene.prospect.pose_views,
            np.zeros(tiles, np.float32),
            scene.prospect.hiding,
            scene.prospect.targets,
            scene.prospect.hidden,
        ),
        scene.moves,
    )
    plan = alone.plan(CoverageTour(), leave)
    assert plan is not None
    assert alone.left(plan) <= leave + 1e-3


def test_the_rest_of_a_way_is_gone_on_with_unless_a_shorter_one_is_found(scene: Scene) -> None:
    tour, leave = CoverageTour(), 0.01 * float(scene.weights.sum())
    first = scene.plan(tour, leave)
    assert first is not None
    again = scene.plan(tour, leave)
    assert again is not None
    assert len(again.path) <= len(first.path) + 1


def test_what_a_way_shows_equals_its_slow_twin(scene: Scene) -> None:
    plan = scene.plan(CoverageTour(), 0.02 * float(scene.weights.sum()))
    assert plan is not None
    views = scene.prospect.pose_views.views()
    steps, bits, left = follow(scene.weights, views, np.array(plan.path), -np.inf)
    assert steps == len(plan.path) - 1
    assert left == pytest.approx(scene.left(plan), abs=1e-3)
    seen = np.zeros_like(bits)
    for pose in plan.path[1:]:
        look(scene.weights, seen, views, pose)
    np.testing.assert_array_equal(bits, seen)
    half = 0.5 * float(scene.weights.sum())
    enough, _, rest = follow(scene.weights, views, np.array(plan.path), half)
    assert 0 < enough < steps
    assert rest == pytest.approx(scene.left(Plan(plan.path[: enough + 1], 0.0, 0.0)), abs=1e-3)
    assert rest <= half < scene.left(Plan(plan.path[:enough], 0.0, 0.0))


def test_the_rest_of_a_way_is_what_follows_its_first_step_where_that_was_taken(scene: Scene) -> None:
    travel, moves = scene.travel, scene.moves
    path = travel.path(int(travel.steps.argmax()))
    assert len(path) > 3
    assert rest_of(path, travel, moves) == [], "it still stands where the way begins"
    taken = replace(travel, start=path[1])
    assert rest_of(path, taken, moves) == path[1:]
    assert rest_of(path[:1], taken, moves) == []
    before, after = next((a, b) for a, b in pairwise(path[1:]) if travel.lattice.advance_to(a, b) is not None)
    blocked = moves.copy()
    blocked[travel.lattice.turned_to(before, after), travel.lattice.advance_to(before, after)] = 0
    assert rest_of(path, taken, blocked) == []
