"""When the map is complete."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dream.geometry import SE2
from dream.mapping import OccupancyMap, check_completion, hiding_places, reachable, view
from dream.protocol import DREAM_V1
from dream.types import BoolArray
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


@given(seed=st.integers(0, 2**31))
@settings(max_examples=8)
def test_the_reachable_positions_are_those_to_which_passable_moves_lead(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = rng.random((96, 96)) < 0.02
    solid &= ~disc(0.0, 0.0, 1.0)
    occupancy = map_with(explored=ALL, solid=solid)
    known = {(0, 0)}
    todo = [(0, 0)]
    offsets = [DREAM_V1.offset(heading, advance) for heading in range(12) for advance in DREAM_V1.advances]
    while todo:
        east, north = todo.pop()
        ends = [(east + a, north + b) for a, b in offsets]
        starts = np.tile((east * 0.5, north * 0.5), (len(ends), 1))
        for end, free in zip(ends, occupancy.passable(starts, np.array(ends) * 0.5), strict=True):
            if free and end not in known:
                known.add(end)
                todo.append(end)
    expected = sorted((east * 0.5, north * 0.5) for east, north in known)
    assert sorted(map(tuple, reachable(occupancy, HERE).tolist())) == expected


def test_from_outside_the_bounds_nothing_is_reachable() -> None:
    assert reachable(empty_map(), SE2(50.0, 0.0, 0.0)).shape == (0, 2)


def test_a_group_can_hide_only_in_a_disc_without_an_explored_cell() -> None:
    unknown = disc(5.0, 5.0, 2.0) | disc(-5.0, 5.0, 1.2)
    places = hiding_places(map_with(explored=~unknown), HERE, 1.5)
    assert places[disc(5.0, 5.0, 0.3)].all()
    assert not places[~disc(5.0, 5.0, 0.8)].any()


def test_where_nothing_is_explored_every_disc_in_bounds_that_shows_is_a_hiding_place() -> None:
    occupancy = empty_map()
    occupancy.clear_launch(0.0, 0.0)
    places = hiding_places(occupancy, HERE, 1.5)
    x, y = occupancy.center_of(*np.indices(occupancy.shape))
    assert places[disc(0.0, 0.0, 8.0)].all()
    assert not places[np.maximum(abs(x), abs(y)) > 10.5].any()
    with pytest.raises(ValueError, match="radius: expected a positive length in metres, got nan"):
        hiding_places(occupancy, HERE, math.nan)
