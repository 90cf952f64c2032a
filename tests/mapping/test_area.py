"""A map of which only an area has to be seen."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dream.geometry import SE2, Bounds
from dream.mapping import OccupancyMap, check_completion, draw_map, frontiers, gain, hiding_places
from dream.mapping.drawing import OUTLINE
from dream.orders import Side, side_of
from dream.types import IntArray, Step
from tests.mapping.analytic import AREA, Disc, Pillar, empty_map, look_around, map_with

HERE = SE2(0.0, 0.0, 0.0)


def looked_at(*things: Pillar | Disc) -> OccupancyMap:
    """A map after the first look around."""
    occupancy = empty_map()
    occupancy.clear_launch(0.0, 0.0)
    look_around(occupancy, 0.0, 0.0, *things)
    return occupancy


def cells(found: IntArray) -> set[tuple[int, int]]:
    return {(int(row), int(col)) for row, col in found}


MAPS = {
    "bare": (),
    "a disc in the west": (Disc(-7.0, 0.0, 2.0),),
    "a disc on each side": (Disc(-7.0, 0.0, 2.0), Disc(7.0, 1.0, 2.0)),
    "a disc across": (Disc(0.0, 6.5, 2.5),),
    "a pillar before a disc": (Pillar(3.0, 0.0, 0.6, 3.0), Disc(7.0, 0.0, 2.0)),
}


@pytest.mark.few(3)
@pytest.mark.parametrize("things", MAPS.values(), ids=MAPS)
@settings(max_examples=12)
@given(at=st.floats(-11.0, 11.0), upright=st.booleans())
def test_what_is_open_of_two_parts_is_open_of_the_whole(
    things: tuple[Pillar | Disc, ...], at: float, upright: bool
) -> None:
    occupancy = looked_at(*things)
    whole = check_completion(occupancy, HERE)
    one, other = (
        (Bounds(AREA.x_min, AREA.y_min, at, AREA.y_max), Bounds(at, AREA.y_min, AREA.x_max, AREA.y_max))
        if upright
        else (Bounds(AREA.x_min, AREA.y_min, AREA.x_max, at), Bounds(AREA.x_min, at, AREA.x_max, AREA.y_max))
    )
    parts, covered = set(), np.zeros(occupancy.shape, np.int64)
    for part in (one, other):
        occupancy.restrict(part)
        covered += occupancy.to_see
        found = cells(check_completion(occupancy, HERE).open_cells)
        assert all(occupancy.to_see[cell] for cell in found)
        parts |= found
    assert (covered == 1).all(), "each cell lies in one part"
    assert cells(whole.open_cells) <= parts
    if not whole.regions:
        assert cells(whole.open_cells) == parts


@pytest.mark.parametrize("things", MAPS.values(), ids=MAPS)
def test_an_area_that_is_everything_changes_nothing(things: tuple[Pillar | Disc, ...]) -> None:
    occupancy, restricted = looked_at(*things), looked_at(*things)
    restricted.restrict(AREA)
    np.testing.assert_array_equal(restricted.observed, occupancy.observed)
    mine, theirs = check_completion(restricted, HERE), check_completion(occupancy, HERE)
    np.testing.assert_array_equal(mine.open_cells, theirs.open_cells)
    assert mine.open_region == theirs.open_region
    np.testing.assert_array_equal(hiding_places(restricted, HERE, 1.5), hiding_places(occupancy, HERE, 1.5))
    places = [(0.0, 0.0), (3.0, -4.0)]
    np.testing.assert_array_equal(gain(restricted, places), gain(occupancy, places))
    beside = cells(np.concatenate([frontier.cells for frontier in frontiers(restricted)]))
    assert beside >= cells(np.concatenate([frontier.cells for frontier in frontiers(occupancy)]))


def test_after_another_area_the_answer_is_the_one_from_scratch(short_mission: list[Step]) -> None:
    occupancy, pose = short_mission[-1].occupancy.copy(), short_mission[-1].observation.pose
    answers = []
    for area in (None, *(side_of(occupancy.bounds, side) for side in Side), None):
        occupancy.restrict(area)
        now, scratch = check_completion(occupancy, pose), check_completion(occupancy.copy(), pose)
        np.testing.assert_array_equal(now.open_cells, scratch.open_cells)
        assert len(now.regions) == len(scratch.regions)
        assert now.open_region == scratch.open_region
        answers.append(len(now.open_cells))
    assert answers[0] == answers[-1]
    assert len(set(answers)) > 3, "areas should differ"


def test_outside_nothing_is_left_to_see_and_what_was_seen_there_stays() -> None:
    occupancy = looked_at(Disc(5.0, 0.0, 1.0))
    explored, traversable = occupancy.explored, occupancy.traversable
    occupancy.restrict(Bounds(-12.0, -12.0, 0.0, 12.0))
    east = np.s_[:, 48:]
    assert occupancy.observed[east].all()
    assert not occupancy.seen[east].all()
    np.testing.assert_array_equal(occupancy.explored, explored)
    np.testing.assert_array_equal(occupancy.traversable, traversable)
    assert occupancy.target[east].any()
    assert not hiding_places(occupancy, HERE, 1.5)[east].any()
    assert hiding_places(occupancy, HERE, 1.5)[:, :48].any()
    assert gain(occupancy, [(6.0, 0.0)])[0, 0] == 0.0
    assert gain(occupancy, [(-6.0, 0.0)])[0, 6] > 0.0


def test_a_region_outside_leaves_the_ground_of_the_area_to_be_searched() -> None:
    occupancy = looked_at(Disc(4.0, 0.0, 1.0))
    assert check_completion(occupancy, HERE).complete, "the one region is enclosed"
    occupancy.restrict(Bounds(-12.0, -12.0, -1.0, 12.0))
    completion = check_completion(occupancy, HERE)
    assert not completion.regions
    assert "no target was seen" in completion.open_region


def test_a_frontier_of_an_area_lies_beside_unknown_ground_in_it() -> None:
    occupancy = looked_at()
    everywhere = sum(frontier.size for frontier in frontiers(occupancy))
    occupancy.restrict(Bounds(-12.0, -12.0, 0.0, 12.0))
    found = frontiers(occupancy)
    edge = np.concatenate([frontier.cells for frontier in found])
    assert 0 < len(edge) < everywhere
    assert edge[:, 1].max() <= 48
    assert all(frontier.centroid[0] < 0.5 for frontier in found)


def test_a_group_that_would_have_been_noticed_from_outside_hides_nowhere_near() -> None:
    explored = np.ones((96, 96), np.bool_)
    explored[:, 40:] = False
    occupancy = map_with(explored=explored)
    occupancy.restrict(Bounds(-12.0, -12.0, 0.0, 12.0))
    # A strip of 2 m is left of it; a disc may reach past the edge of the area, where nothing was seen.
    assert hiding_places(occupancy, SE2(-6.0, 0.0, 0.0), 1.5).any()
    explored[:, 48:] = True
    occupancy = map_with(explored=explored)
    occupancy.restrict(Bounds(-12.0, -12.0, 0.0, 12.0))
    assert not hiding_places(occupancy, SE2(-6.0, 0.0, 0.0), 1.5).any()


def test_a_copy_a_window_and_a_file_keep_the_area(tmp_path: Path) -> None:
    occupancy, area = looked_at(), Bounds(-3.0, -4.0, 5.0, 6.0)
    occupancy.restrict(area)
    occupancy.save(tmp_path / "map.npz")
    for other in (occupancy.copy(), OccupancyMap.load(tmp_path / "map.npz"), occupancy.over(AREA)):
        assert other.area == area
        np.testing.assert_array_equal(other.observed, occupancy.observed)
    window = occupancy.over(Bounds(0.0, 0.0, 12.0, 12.0))
    np.testing.assert_array_equal(window.to_see, occupancy.to_see[48:, 48:])


@pytest.mark.parametrize("area", [Bounds(20.0, 0.0, 30.0, 5.0), Bounds(0.01, 0.01, 0.02, 0.02)])
def test_an_area_without_a_cell_is_refused(area: Bounds) -> None:
    with pytest.raises(ValueError, match=re.escape(f"area: expected a part of {AREA}")):
        empty_map().restrict(area)


LEGEND_ROWS = 40
"""Pixels at the foot of a picture."""


def test_the_area_is_outlined_and_cells_keep_their_colours() -> None:
    occupancy = looked_at(Disc(4.0, 0.0, 1.0), Pillar(-4.0, 3.0, 0.6, 3.0))
    plain = np.asarray(draw_map(occupancy))
    assert not (plain == OUTLINE).all(axis=-1).any()
    occupancy.restrict(Bounds(-8.0, -6.0, 0.0, 6.0))
    drawn = np.asarray(draw_map(occupancy))
    differs = (drawn != plain).any(axis=-1)
    # Below the map the legend explains the line, too.
    assert differs[-LEGEND_ROWS:].any()
    differs[-LEGEND_ROWS:] = False
    rows, cols = np.nonzero(differs)
    assert (drawn == OUTLINE).all(axis=-1).any()
    # Around 8 x 12 m at 16 pixels a metre, three pixels wide and smooth.
    assert (np.ptp(cols), np.ptp(rows)) == pytest.approx((128, 192), abs=6)
    assert np.count_nonzero(differs) < 5 * 2 * (128 + 192)
