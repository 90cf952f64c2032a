"""When the map is complete."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dream.geometry import SE2, Bounds
from dream.lattice import nodes_in
from dream.mapping import (
    Completion,
    OccupancyMap,
    check_completion,
    could_hide,
    free_moves,
    hiding_places,
    reachable,
    that_would_show,
    view,
)
from dream.mapping._kernels.flags import BARE, CROSSED, EXPLORED, RETURNED
from dream.mapping.sightlines import seeable
from dream.protocol import DREAM_V1, POOL_V1, SurveyProtocol
from dream.types import BoolArray
from tests.mapping import completion_from_scratch as scratch
from tests.mapping.analytic import Disc, empty_map, look_around, map_with

HERE = SE2(0.0, 0.0, 0.0)
ALL = np.ones((96, 96), np.bool_)


def disc(x: float, y: float, radius: float) -> BoolArray:
    center_x, center_y = empty_map().center_of(*np.indices((96, 96)))
    return np.hypot(center_x - x, center_y - y) <= radius


def seen_from_anywhere(occupancy: OccupancyMap, nodes: npt.NDArray[np.float64]) -> BoolArray:
    """Slow twin: the union of all views from the nodes."""
    seen = np.zeros(occupancy.shape, np.bool_)
    for x, y in nodes:
        for heading in range(DREAM_V1.headings):
            seen |= view(occupancy, x, y, heading * DREAM_V1.heading_step)
    return seen


def test_a_target_in_the_middle_of_explored_ground_is_complete() -> None:
    completion = check_completion(map_with(explored=ALL, target=disc(3.0, 2.0, 1.5)), HERE)
    assert completion.complete
    assert completion.open_region == ""
    (region,) = completion.regions
    assert region.enclosed
    np.testing.assert_allclose(region.centroid, (3.0, 2.0), atol=0.02)
    np.testing.assert_allclose(
        (region.extent.x_min, region.extent.y_min, region.extent.x_max, region.extent.y_max),
        (1.5, 0.5, 4.5, 3.5),
    )


def test_a_target_at_the_edge_of_the_known_is_open_and_named() -> None:
    occupancy = empty_map()
    look_around(occupancy, 0.0, 0.0, Disc(8.0, 0.0, 1.5), Disc(-4.0, 3.0, 1.0))
    completion = check_completion(occupancy, HERE)
    assert not completion.complete
    assert [region.enclosed for region in completion.regions] == [False, True]
    count = len(completion.regions[0].open_cells)
    assert completion.open_region.startswith("region 1 near (8.")
    assert completion.open_region.endswith(f"has {count} unknown cells at its edge")


def test_an_unknown_cell_inside_a_ring_of_targets_keeps_it_open() -> None:
    ring = disc(4.0, 0.0, 3.0) & ~disc(4.0, 0.0, 2.0)
    explored = ALL.copy()
    explored[48, 64] = False  # Its very middle, far from every target cell.
    completion = check_completion(map_with(explored=explored, target=ring), HERE)
    assert completion.open_cells.tolist() == [[48, 64]]
    assert "has 1 unknown cell at its edge" in completion.open_region


def test_unknown_cells_that_no_pose_can_see_do_not_count() -> None:
    """The inside of a hull."""
    hull = disc(4.0, 0.0, 2.0)
    inside = disc(4.0, 0.0, 1.5)
    occupancy = map_with(explored=~inside, solid=hull & ~inside, target=hull & ~inside)
    assert check_completion(occupancy, HERE).complete
    # With a hole in the wall, one can look in.
    hole = hull & ~inside & disc(2.2, 0.0, 0.4)
    open_hull = map_with(explored=~inside, solid=hull & ~inside & ~hole, target=hull & ~inside & ~hole)
    assert not check_completion(open_hull, HERE).complete


def test_unknown_ground_that_cannot_be_reached_and_not_be_seen_does_not_count() -> None:
    walls = disc(0.0, 0.0, 6.0) & ~disc(0.0, 0.0, 5.4)
    occupancy = map_with(explored=disc(0.0, 0.0, 6.0), solid=walls)
    assert check_completion(occupancy, HERE).complete
    assert not hiding_places(occupancy, HERE, 1.5).any()
    nodes = reachable(occupancy, HERE)
    assert np.hypot(*nodes.T).max() < 5.4
    assert len(nodes) > 200


def test_the_bounds_count_as_enclosure() -> None:
    completion = check_completion(map_with(explored=ALL, target=disc(11.5, 0.0, 1.5)), HERE)
    assert completion.complete


def test_without_targets_all_ground_that_could_be_seen_must_be_explored() -> None:
    explored = ALL.copy()
    explored[90:, 90:] = False
    completion = check_completion(map_with(explored=explored), HERE)
    assert not completion.complete
    assert completion.regions == ()
    assert (
        completion.open_region
        == "no target was seen, and 36 unknown cells near (11.2, 11.2) could still be seen"
    )
    assert check_completion(map_with(explored=ALL), HERE).complete


def test_target_cells_belong_together_across_the_radius_of_the_smallest_group() -> None:
    target = np.zeros((96, 96), np.bool_)
    target[40, [40, 46, 53]] = True
    regions = check_completion(map_with(explored=ALL, target=target), HERE).regions
    assert [region.cells.tolist() for region in regions] == [[[40, 40], [40, 46]], [[40, 53]]]


@given(seed=st.integers(0, 2**31))
@settings(max_examples=3)
def test_the_open_cells_are_those_that_some_view_from_a_reachable_position_shows(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = np.zeros((96, 96), np.bool_)
    for _ in range(12):
        x, y = rng.uniform(-11.0, 11.0, 2)
        solid |= disc(x, y, rng.uniform(0.3, 1.5))
    solid &= ~disc(0.0, 0.0, 1.5)
    explored = disc(0.0, 0.0, rng.uniform(2.0, 6.0)) | solid
    occupancy = map_with(explored=explored, solid=solid)
    nodes = reachable(occupancy, HERE)
    expected = seen_from_anywhere(occupancy, nodes) & ~occupancy.explored
    found = np.zeros_like(expected)
    found[tuple(check_completion(occupancy, HERE).open_cells.T)] = True
    # Never more than can be seen, or no mission could end. Less where only a sliver of a cell shows.
    assert not (found & ~expected).any()
    assert (expected & ~found).sum() <= 0.03 * expected.sum()


@given(
    seed=st.integers(0, 2**31),
    protocol=st.sampled_from((DREAM_V1, POOL_V1)),
    corner=st.sampled_from((None, (-1.55, -2.35), (0.3, -1.15))),
)
@settings(max_examples=8)
def test_the_reachable_positions_are_those_to_which_passable_moves_lead(
    seed: int, protocol: SurveyProtocol, corner: tuple[float, float] | None
) -> None:
    rng = np.random.default_rng(seed)
    side, cell = 64, protocol.cell
    west, south = corner or (-50 * cell, -40 * cell)
    kept = Kept(Bounds(west, south, west + side * cell, south + side * cell) if corner else None, protocol)
    low = (0, 0) if corner else (-40, -50)
    kept.fill("flags", *low, (side, side), BARE_GROUND)
    kept.write("log_odds", *low, np.where(rng.random((side, side)) < 0.004, SOLID, FREE))
    occupancy, lattice = kept.map, protocol.lattice
    start = (round((west + 0.5 * side * cell) / lattice), round((south + 0.5 * side * cell) / lattice))
    known = {start}
    todo = [start]
    headings = range(protocol.headings)
    offsets = [protocol.offset(heading, advance) for heading in headings for advance in protocol.advances]
    while todo:
        east, north = todo.pop()
        ends = [(east + a, north + b) for a, b in offsets]
        starts = np.tile((east * lattice, north * lattice), (len(ends), 1))
        for end, free in zip(ends, occupancy.passable(starts, np.array(ends) * lattice), strict=True):
            if free and end not in known:
                known.add(end)
                todo.append(end)
    expected = sorted((north * lattice, east * lattice) for east, north in known)
    found = reachable(occupancy, SE2(start[0] * lattice, start[1] * lattice, 0.0))
    assert found[:, ::-1].tolist() == [list(position) for position in expected]


@given(
    seed=st.integers(0, 2**31),
    protocol=st.sampled_from((DREAM_V1, POOL_V1)),
    corner=st.sampled_from((None, (-1.55, -2.35), (0.3, -1.15))),
)
@settings(max_examples=8)
def test_the_free_moves_are_those_that_are_passable_after_any_change(
    seed: int, protocol: SurveyProtocol, corner: tuple[float, float] | None
) -> None:
    rng = np.random.default_rng(seed)
    side, cell, lattice = 64, protocol.cell, protocol.lattice
    west, south = corner or (-50 * cell, -40 * cell)
    kept = Kept(Bounds(west, south, west + side * cell, south + side * cell) if corner else None, protocol)
    low = (0, 0) if corner else (-40, -50)
    kept.fill("flags", *low, (side, side), BARE_GROUND)
    first, shape = nodes_in(kept.map.bounds, protocol)
    offsets = np.array([[protocol.offset(h, a) for a in protocol.advances] for h in range(protocol.headings)])
    row, col = np.indices(shape)
    begin = np.broadcast_to(
        np.stack((col + first[1], row + first[0]), axis=-1)[:, :, None, None], (*shape, *offsets.shape)
    )
    seen = set()
    for _ in range(3):
        kept.write("log_odds", *low, np.where(rng.random((side, side)) < 0.004, SOLID, FREE))
        starts, ends = ((k * lattice).reshape(-1, 2) for k in (begin, begin + offsets))
        inside = kept.map.contains(*starts.T)
        stands = np.zeros(len(starts), np.bool_)
        stands[inside] = kept.map.standable[kept.map.cell_of(*starts[inside].T)]
        expected = (kept.map.passable(starts, ends) & stands).reshape(begin.shape[:-1])
        np.testing.assert_array_equal(free_moves(kept.map), expected)
        seen |= set(np.unique(expected))
    assert seen == {False, True}


def test_from_outside_the_bounds_nothing_is_reachable() -> None:
    assert reachable(empty_map(), SE2(50.0, 0.0, 0.0)).shape == (0, 2)


def test_a_group_can_hide_only_in_a_disc_without_an_explored_cell() -> None:
    unknown = disc(5.0, 5.0, 2.0) | disc(-5.0, 5.0, 1.2)
    places = hiding_places(map_with(explored=~unknown), HERE, 1.5)
    assert places[disc(5.0, 5.0, 0.3)].all()
    assert not places[~disc(5.0, 5.0, 0.8)].any()


@given(seed=st.integers(0, 1000))
@settings(max_examples=8)
def test_each_place_would_show_whatever_other_places_are_asked_about(seed: int) -> None:
    rng = np.random.default_rng(seed)
    behind = disc(6.0, 6.0, 3.0) & ~disc(6.0, 6.0, 2.0)
    explored = (rng.random(behind.shape) < 0.01) | disc(0.0, 0.0, 5.0)
    occupancy = map_with(explored=explored | behind, solid=behind)
    all_of_them, some = hiding_places(occupancy, HERE, 1.0), rng.random(explored.shape) < 0.1
    some &= could_hide(occupancy, 1.0, occupancy.observed)
    np.testing.assert_array_equal(that_would_show(occupancy, HERE, 1.0, some), all_of_them & some)
    assert (some & all_of_them).any()
    assert (some & ~all_of_them).any()
    assert not that_would_show(occupancy, HERE, 1.0, np.zeros_like(some)).any()


def test_where_nothing_is_explored_every_disc_in_bounds_that_shows_is_a_hiding_place() -> None:
    occupancy = empty_map()
    occupancy.clear_launch(0.0, 0.0)
    places = hiding_places(occupancy, HERE, 1.5)
    x, y = occupancy.center_of(*np.indices(occupancy.shape))
    assert places[disc(0.0, 0.0, 8.0)].all()
    assert not places[np.maximum(abs(x), abs(y)) > 10.5].any()
    with pytest.raises(ValueError, match="radius: expected a positive length in metres, got nan"):
        hiding_places(occupancy, HERE, math.nan)


# ------------------------------------------------------------------------------------- kept up to date


class Kept:
    """A map whose cells are written at will."""

    def __init__(
        self,
        bounds: Bounds | None,
        protocol: SurveyProtocol = DREAM_V1,
        seeable: scratch.Seeable = scratch.seeable,
    ) -> None:
        self.map = OccupancyMap(bounds, protocol)
        self.seeable = seeable
        self.rng = np.random.default_rng(0)

    def write(self, name: str, row: int, col: int, cells: npt.NDArray[np.integer[Any]]) -> None:
        self.map._write(name, (row, col), cells)

    def fill(self, name: str, row: int, col: int, shape: tuple[int, int], value: int) -> None:
        self.write(name, row, col, np.full(shape, value))

    def check(self, x: float, y: float) -> Completion:
        """What is kept, which must be what comes out from scratch; other questions may come before."""
        pose = SE2(x, y, 0.0)
        self._ask(pose, self.check_reachable, self.check_seeable)
        return self.check_completion(pose)

    def ask(self, x: float, y: float) -> None:
        """Some of the questions, in any order."""
        self._ask(SE2(x, y, 0.0), self.check_reachable, self.check_seeable, self.check_completion)

    def _ask(self, pose: SE2, *questions: Callable[[SE2], object]) -> None:
        for n in self.rng.permutation(len(questions))[: self.rng.integers(1, 1 + len(questions))]:
            questions[n](pose)

    def check_completion(self, pose: SE2) -> Completion:
        completion = check_completion(self.map, pose)
        scratch.assert_same(completion, scratch.check_completion(self.map, pose, self.seeable))
        return completion

    def check_reachable(self, pose: SE2) -> None:
        np.testing.assert_array_equal(reachable(self.map, pose), scratch.reachable(self.map, pose))

    def check_seeable(self, pose: SE2) -> None:
        """Of some cells; `hiding_places` asks so."""
        unobserved = np.argwhere(~self.map.observed)
        cells = np.sort(self.rng.permutation(len(unobserved))[: self.rng.integers(1, 200)])
        seen = unobserved[cells][seeable(self.map, pose, unobserved[cells])]
        expected = scratch.seeable(self.map, scratch.reachable(self.map, pose), unobserved[cells])
        np.testing.assert_array_equal(seen, expected)


BARE_GROUND = EXPLORED | BARE
TARGET, SOLID, FREE = 0x50, 5, -3


@pytest.mark.rare
@given(
    seed=st.integers(0, 2**31),
    bounds=st.sampled_from((None, Bounds(-12.0, -12.0, 12.0, 12.0), Bounds(-3.0, 5.0, 17.0, 9.0))),
    # What is left to traverse has tests of its own.
    protocol=st.sampled_from((DREAM_V1, replace(POOL_V1, traversal=None))),
    targets=st.booleans(),
)
@settings(max_examples=3)
def test_after_any_changes_the_answer_is_the_one_from_scratch(
    seed: int, bounds: Bounds | None, protocol: SurveyProtocol, targets: bool
) -> None:
    rng = np.random.default_rng(seed)
    cell = protocol.cell
    if bounds:  # The same cells, however large one is.
        scale = cell / DREAM_V1.cell
        bounds = Bounds(*(scale * edge for edge in (bounds.x_min, bounds.y_min, bounds.x_max, bounds.y_max)))
    kept = Kept(bounds, protocol, scratch.seeable if bounds else scratch.seeable_at_once)
    low, (rows, cols) = ((0, 0), kept.map.shape) if bounds else ((-40, -30), (70, 60))
    kept.fill("flags", *low, (rows, cols), BARE_GROUND if rng.random() < 0.7 else CROSSED)
    middle_x, middle_y = (
        origin + (first + 0.5 * count) * cell
        for origin, first, count in zip(kept.map._origin, low[::-1], (cols, rows), strict=True)
    )
    for _ in range(12):
        height, width = (int(rng.integers(1, 1 + min(rng.choice([6, 60]), n))) for n in (rows, cols))
        row = low[0] + int(rng.integers(0, rows - height + 1))
        col = low[1] + int(rng.integers(0, cols - width + 1))
        shape = (height, width)
        match int(rng.integers(6)):
            case 0:
                kept.fill("log_odds", row, col, shape, int(rng.choice([SOLID, FREE])))
            case 1:
                kept.write("log_odds", row, col, np.where(rng.random(shape) < 0.03, SOLID, FREE))
            case 2:
                kept.fill("flags", row, col, shape, int(rng.choice([0, BARE_GROUND, CROSSED, RETURNED])))
            case 3 if targets:
                share = rng.choice([0.02, 0.3, 1.0])
                kept.write("votes", row, col, np.where(rng.random(shape) < share, TARGET, 0))
            case 4 if targets:
                kept.fill("votes", row, col, shape, 0)
        x, y = middle_x, middle_y
        if rng.random() < 0.5:  # Wherever, on a boulder or in the unknown too.
            x += float(rng.uniform(-0.5, 0.5)) * cols * cell
            y += float(rng.uniform(-0.5, 0.5)) * rows * cell
        elif rng.random() < 0.1:
            x, y = kept.map.bounds.x_min, kept.map.bounds.y_max
        kept.ask(x, y)
    again = Kept(bounds, protocol)
    again.map = kept.map.copy()
    again.check(middle_x, middle_y)
    kept.check(middle_x, middle_y)


def test_a_region_that_vanished_is_gone_whatever_was_asked_first() -> None:
    kept = Kept(Bounds(-12.0, -12.0, 12.0, 12.0))
    kept.fill("flags", 0, 0, (96, 96), BARE_GROUND)
    kept.fill("votes", 10, 10, (3, 3), TARGET)
    kept.fill("votes", 80, 80, (3, 3), TARGET)
    kept.fill("flags", 79, 79, (2, 2), 0)
    assert len(check_completion(kept.map, HERE).regions) == 2
    kept.fill("votes", 80, 80, (3, 3), 0)
    reachable(kept.map, HERE)
    completion = check_completion(kept.map, HERE)
    assert len(completion.regions) == 1
    assert completion.complete


def test_an_answer_is_found_once_until_the_map_changes() -> None:
    kept = Kept(None, seeable=scratch.seeable_at_once)
    kept.fill("flags", 0, 0, (30, 30), BARE_GROUND)
    pose = SE2(15 * DREAM_V1.cell, 15 * DREAM_V1.cell, 0.0)
    completion = check_completion(kept.map, pose)
    assert check_completion(kept.map, replace(pose, yaw=1.0)) is completion
    assert not completion.open_cells.flags.writeable
    kept.fill("votes", 0, 0, (2, 2), TARGET)
    assert len(check_completion(kept.map, pose).regions) == 1
    kept.map.restrict(Bounds(2.0, 2.0, 4.0, 4.0))
    assert check_completion(kept.map, pose).regions == ()


def test_a_map_without_an_end_that_is_too_wide_to_be_asked_as_a_whole_says_so() -> None:
    kept = Kept(None)
    kept.fill("flags", 0, 0, (30, 30), BARE_GROUND)
    kept.fill("flags", 200_000, 200_000, (30, 30), BARE_GROUND)  # 50 km away: a box of 10 million blocks.
    with pytest.raises(ValueError, match="window: expected at most 67108864 cells"):
        check_completion(kept.map, HERE)


def test_a_door_that_closes_and_opens_takes_away_and_gives_back_all_behind_it() -> None:
    kept = Kept(Bounds(-20.0, -20.0, 20.0, 20.0))
    kept.fill("flags", 0, 0, (160, 160), BARE_GROUND)
    kept.fill("log_odds", 0, 80, (160, 1), SOLID)
    kept.fill("flags", 60, 120, (20, 20), 0)

    def nodes() -> int:
        kept.check(-10.0, 0.0)
        return len(reachable(kept.map, SE2(-10.0, 0.0, 0.0)))

    one_side = nodes()
    kept.fill("log_odds", 70, 80, (8, 1), FREE)
    both_sides = nodes()
    assert both_sides > 1.9 * one_side
    assert len(kept.check(-10.0, 0.0).open_cells) > 300
    # A second door makes a loop: closing either one takes nothing away.
    kept.fill("log_odds", 20, 80, (8, 1), FREE)
    kept.fill("log_odds", 70, 80, (8, 1), SOLID)
    assert nodes() > 1.9 * one_side
    kept.fill("log_odds", 20, 80, (8, 1), SOLID)
    assert nodes() == one_side
    assert kept.check(-10.0, 0.0).complete


def test_two_regions_merge_over_a_bridge_and_part_again() -> None:
    kept = Kept(None, seeable=scratch.seeable_at_once)
    kept.fill("flags", -80, -90, (160, 180), BARE_GROUND)
    kept.fill("votes", -30, 1, (10, 80), TARGET)
    kept.fill("votes", -30, -70, (10, 4), TARGET)
    assert [len(region.cells) for region in kept.check(0.0, 0.0).regions] == [40, 800]
    bridge = np.zeros((1, 63), np.int64)
    bridge[0, ::4] = TARGET
    kept.write("votes", -25, -63, bridge)  # All in the block between them.
    (region,) = kept.check(0.0, 0.0).regions
    assert len(region.cells) == 40 + 16 + 800
    kept.fill("votes", -25, -31, (1, 1), 0)
    assert [len(region.cells) for region in kept.check(0.0, 0.0).regions] == [48, 807]
    kept.fill("votes", -30, -80, (10, 81), 0)
    assert [len(region.cells) for region in kept.check(0.0, 0.0).regions] == [800]
    kept.fill("votes", -30, 1, (10, 80), 0)
    assert kept.check(0.0, 0.0).regions == ()


@pytest.mark.rare
@given(seed=st.integers(0, 2**31))
@settings(max_examples=4)
def test_in_a_maze_whose_doors_open_and_close_the_reachable_ground_is_as_from_scratch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kept = Kept(None, seeable=scratch.seeable_at_once)
    side, room = 240, 24
    low = -128
    kept.fill("flags", low, low, (side, side), BARE_GROUND)
    kept.write("flags", low, low, np.where(rng.random((side, side)) < 0.01, 0, BARE_GROUND))
    kept.write("votes", low, low, np.where(rng.random((side, side)) < 0.001, TARGET, 0))
    walls = np.full((side, side), FREE)
    walls[::room] = walls[:, ::room] = walls[-1] = walls[:, -1] = SOLID
    kept.write("log_odds", low, low, walls)
    for _ in range(25):
        # Doors are just wide enough, or not.
        row, col = (low + room * int(n) for n in rng.integers(1, side // room, 2))
        along, width = int(rng.integers(3, room - 10)), int(rng.integers(4, 8))
        shape = (1, width) if rng.random() < 0.5 else (width, 1)
        where = (row, col + along) if shape[0] == 1 else (row + along, col)
        kept.fill("log_odds", *where, shape, int(rng.choice([FREE, FREE, FREE, SOLID])))
        kept.check(*rng.choice([-29.0, -26.0, -2.0, 2.0, 10.0], 2))


def test_a_hole_in_a_region_over_many_blocks_is_open_until_it_is_seen() -> None:
    kept = Kept(Bounds(-25.0, -25.0, 25.0, 25.0))
    kept.fill("flags", 0, 0, (200, 200), BARE_GROUND)
    kept.fill("votes", 30, 30, (140, 140), TARGET)
    kept.fill("votes", 40, 40, (120, 120), 0)
    kept.fill("flags", 100, 100, (2, 3), 0)
    assert len(kept.check(-20.0, -20.0).open_cells) == 6
    kept.fill("flags", 100, 100, (1, 3), RETURNED)
    assert len(kept.check(-20.0, -20.0).open_cells) == 3
    kept.fill("votes", 30, 90, (10, 20), 0)  # Now the hole is none.
    assert kept.check(-20.0, -20.0).complete


@pytest.mark.parametrize("target", [False, True])
def test_a_map_that_grows_to_all_sides_is_as_from_scratch(target: bool) -> None:
    rng = np.random.default_rng(0)
    kept = Kept(None, seeable=scratch.seeable_at_once)
    for row, col in ((0, 0), (-90, 30), (-150, -120), (100, -200), (150, 210), (20, -50)):
        shape = (50, 60)
        kept.write("flags", row, col, np.where(rng.random(shape) < 0.98, BARE_GROUND, 0))
        kept.write("log_odds", row, col, np.where(rng.random(shape) < 0.002, SOLID, FREE))
        if target:
            kept.fill("votes", row + 20, col, (20, 20), TARGET)
        kept.check(30 * DREAM_V1.cell, 25 * DREAM_V1.cell)
        if target:
            kept.check((col + 30) * DREAM_V1.cell, (row + 25) * DREAM_V1.cell)


def test_a_pool_with_nodes_on_the_corners_of_cells_is_as_from_scratch() -> None:
    rng = np.random.default_rng(0)
    kept = Kept(Bounds(-3.0, -2.0, 3.0, 2.0), POOL_V1)
    kept.fill("flags", 0, 0, (80, 120), BARE_GROUND)
    for _ in range(8):
        row, col = int(rng.integers(0, 60)), int(rng.integers(0, 100))
        kept.write("log_odds", row, col, np.where(rng.random((20, 20)) < 0.01, SOLID, FREE))
        kept.write("votes", row, col, np.where(rng.random((20, 20)) < 0.1, TARGET, 0))
        kept.fill("flags", row, col, (5, 9), 0)
        kept.check(*rng.uniform(-1.5, 1.5, 2))


def test_through_gaps_between_many_solids_a_cell_is_seen_by_the_nodes_that_its_own_rays_lead_to() -> None:
    rng = np.random.default_rng(7)
    clear = disc(0.0, 0.0, 2.5)
    solid = (rng.random(ALL.shape) < 0.1) & ~clear
    occupancy = map_with(explored=clear, solid=solid)
    cells = np.argwhere(disc(0.0, 0.0, 7.0) & ~solid & ~clear)[::4]
    seen = cells[seeable(occupancy, HERE, cells)]
    np.testing.assert_array_equal(seen, scratch.seeable(occupancy, reachable(occupancy, HERE), cells))
    assert 0.1 * len(cells) < len(seen) < 0.9 * len(cells)
