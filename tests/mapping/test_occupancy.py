"""The map in worlds with a formula."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from dream.geometry import SE3, Bounds, Camera
from dream.mapping import OccupancyMap
from dream.perception import partition, valid_points
from dream.protocol import DREAM_V1, DREAM_V1_NOISY, POOL_V1
from dream.types import BoolArray, Label
from tests.mapping.analytic import (
    AREA,
    CAMERA,
    SEABED,
    Disc,
    Pillar,
    camera_at,
    empty_map,
    look,
    look_around,
    map_with,
    render,
    wall,
)

LAYERS = ("solid", "target", "explored", "seabed_seen", "crossed", "traversable", "standable")


def distance_from(occupancy: OccupancyMap, x: float, y: float) -> npt.NDArray[np.float64]:
    center_x, center_y = occupancy.center_of(*np.indices(occupancy.shape))
    return np.hypot(center_x - x, center_y - y)


def ahead(occupancy: OccupancyMap, x: float, y: float) -> BoolArray:
    """Cells inside the sector of a camera at (x, y) that looks east, whatever their distance."""
    center_x, center_y = occupancy.center_of(*np.indices(occupancy.shape))
    return np.abs(center_y - y) <= (center_x - x) * (1.0 + 1e-9)


# ---------------------------------------------------------------------------------------- explored


def test_bare_ground_is_explored_from_the_blind_distance_to_the_reach() -> None:
    occupancy = empty_map()
    look(occupancy, 0.0, 0.0, 0.0)
    x, _ = occupancy.center_of(*np.indices(occupancy.shape))
    distance = distance_from(occupancy, 0.0, 0.0)
    expected = ahead(occupancy, 0.0, 0.0) & (x >= DREAM_V1.blind) & (distance <= DREAM_V1.reach)
    assert occupancy.explored[expected].all()
    # The image widens on the ground beside the sector: that is seen, and not explored.
    np.testing.assert_array_equal(occupancy.explored, expected)
    assert (occupancy.seabed_seen & ~expected).any()
    np.testing.assert_array_equal(occupancy.observed, occupancy.explored | occupancy.seabed_seen)
    assert not occupancy.observed[(distance > DREAM_V1.reach + 0.2) | (x < DREAM_V1.blind - 0.2)].any()
    assert occupancy.solid.sum() == occupancy.target.sum() == 0


def test_the_near_blind_zone_is_crossed_but_not_explored() -> None:
    occupancy = empty_map()
    look_around(occupancy, 0.0, 0.0)
    near = distance_from(occupancy, 0.0, 0.0) < DREAM_V1.blind - 0.2
    assert not occupancy.explored[near].any()
    assert not occupancy.seabed_seen[near].any()
    assert occupancy.crossed[near].all()
    assert occupancy.traversable[near].all()


def test_cells_behind_a_wall_stay_unknown() -> None:
    occupancy = empty_map()
    look_around(occupancy, 0.0, 0.0, wall(4.1))
    x, _ = occupancy.center_of(*np.indices(occupancy.shape))
    assert not (occupancy.explored | occupancy.crossed)[x > 4.6].any()
    wall_cells = (np.abs(x - 4.125) < 0.01) & (distance_from(occupancy, 0.0, 0.0) < 5.5)
    assert occupancy.solid[wall_cells].all()
    assert occupancy.explored[wall_cells].all()
    assert not occupancy.solid[x < 3.9].any()


def test_ground_seen_behind_a_low_boulder_is_observed_and_not_explored_and_its_shadow_is_neither() -> None:
    # From eye height 2 m, the shadow of a far edge at 5 m ends at 10 m for 1 m of height, at 7.1 m for 0.6 m.
    high, low = empty_map(), empty_map()
    look(high, 0.0, 0.0, 0.0, Pillar(4.5, 0.0, 0.5, 1.0))
    look(low, 0.0, 0.0, 0.0, Pillar(4.5, 0.0, 0.5, 0.6))
    cols = high.cell_of(np.array([5.6, 6.6, 7.5]), 0.1)[1]
    assert high.solid[high.cell_of(4.1, 0.1)]
    assert low.solid[low.cell_of(4.1, 0.1)]
    row = high.cell_of(0.0, 0.1)[0]
    assert high.observed[row, cols].tolist() == [False, False, False]
    for seen in (low.observed, low.seabed_seen, low.known):
        assert seen[row, cols].tolist() == [False, False, True]
    # Nor may the vehicle go there: beside a hull, ground is seen below what overhangs it.
    assert not (low.explored | low.crossed | low.traversable)[row, cols].any()


@given(seed=st.integers(0, 2**31))
@settings(max_examples=25)
def test_explored_only_grows(seed: int) -> None:
    rng = np.random.default_rng(seed)
    occupancy = empty_map()
    before = {name: getattr(occupancy, name) for name in ("explored", "seabed_seen", "crossed")}
    for _ in range(4):
        x, y = rng.uniform(-9.0, 9.0, 2)
        pose = camera_at(x, y, rng.uniform(-4.0, 4.0))
        depth = rng.uniform(0.0, 25.0, (CAMERA.height, CAMERA.width)).astype(np.float32)
        labels = rng.integers(0, 4, depth.shape).astype(np.uint8)
        occupancy.integrate(depth, labels, CAMERA, pose)
        for name, was in before.items():
            assert not (was & ~getattr(occupancy, name)).any()
            before[name] = getattr(occupancy, name)
        assert not (occupancy.traversable & occupancy.solid).any()
        assert not (occupancy.standable & occupancy.solid).any()


def test_a_frame_without_returns_claims_nothing() -> None:
    occupancy = empty_map()
    depth = np.full((CAMERA.height, CAMERA.width), np.nan, np.float32)
    occupancy.integrate(depth, np.zeros(depth.shape, np.uint8), CAMERA, camera_at(0.0, 0.0, 0.0))
    assert not any(getattr(occupancy, name).any() for name in LAYERS)


def test_a_direction_without_returns_claims_nothing() -> None:
    occupancy = empty_map()
    pose = camera_at(0.0, 0.0, 0.0)
    depth, labels = render(pose)
    depth[:, : CAMERA.width // 2] = np.nan
    occupancy.integrate(depth, labels, CAMERA, pose)
    assert occupancy.explored[occupancy.cell_of(5.0, -2.0)]
    assert not occupancy.explored[occupancy.cell_of(5.0, 2.0)]
    assert not occupancy.crossed[occupancy.cell_of(5.0, 2.0)]


def test_in_murky_water_a_ray_claims_no_more_than_its_farthest_return() -> None:
    occupancy = empty_map()
    pose = camera_at(0.0, 0.0, 0.0)
    depth, labels = render(pose)
    depth[depth > 4.0] = np.nan
    occupancy.integrate(depth, labels, CAMERA, pose)
    distance = distance_from(occupancy, 0.0, 0.0)
    assert occupancy.explored[ahead(occupancy, 0.0, 0.0) & (distance > 2.0) & (distance < 3.5)].all()
    assert not (occupancy.explored | occupancy.crossed)[distance > 6.0].any()


def test_depths_outside_the_limits_of_the_protocol_are_ignored() -> None:
    pose = camera_at(0.0, 0.0, 0.0)
    depth, labels = render(pose)
    expected, occupancy = empty_map(), empty_map()
    spoilt = depth.copy()
    spoilt[:60] = np.nan
    expected.integrate(spoilt, labels, CAMERA, pose)
    spoilt[:20], spoilt[20:40], spoilt[40:60] = 0.05, 20.5, np.inf
    occupancy.integrate(spoilt, np.where(labels == Label.WATER, Label.OBSTACLE, labels), CAMERA, pose)
    for name in LAYERS:
        np.testing.assert_array_equal(getattr(occupancy, name), getattr(expected, name))


@pytest.mark.parametrize("greatest", [20.0, 9.7, 4.1, 7.3])
@pytest.mark.parametrize("kind", ["metres", "doubles", "millimetres", "probabilities"])
def test_a_depth_of_exactly_the_greatest_is_no_return(kind: str, greatest: float) -> None:
    """Where a wall is filled up with the sensor's limit, nothing is learnt behind it, and it stays."""
    pose, protocol = camera_at(0.0, 0.0, 0.0), replace(DREAM_V1, max_depth=greatest)
    depth, labels = render(pose, wall(3.1))
    said: npt.NDArray[Any] = labels
    if kind == "probabilities":
        said = np.where(labels == Label.WATER, -1.0, 0.5).astype(np.float32)
    hole = labels == Label.OBSTACLE
    maps = []
    for filler in (0.0 if kind == "millimetres" else np.nan, greatest):
        occupancy = OccupancyMap(Bounds(-12.0, -12.0, 12.0, 12.0), protocol)
        for _ in range(3):
            occupancy.integrate(depth, said, CAMERA, pose)
        filled = np.where(hole, np.float32(filler), depth)
        if kind == "millimetres":
            filled = np.rint(np.nan_to_num(1000.0 * filled.astype(np.float64))).astype(np.uint16)
        elif kind == "doubles":
            filled = np.where(hole, filler, depth.astype(np.float64))
        for _ in range(8):
            occupancy.integrate(filled, np.where(hole, said.dtype.type(1), said), CAMERA, pose)
        maps.append(occupancy)
    assert maps[0].solid.any()
    for name in LAYERS:
        np.testing.assert_array_equal(getattr(maps[1], name), getattr(maps[0], name))


def test_a_depth_just_below_the_greatest_is_a_return() -> None:
    pose, protocol = camera_at(0.0, 0.0, 0.0), replace(DREAM_V1, max_depth=4.1)
    depth = np.full((CAMERA.height, CAMERA.width), 4.099, np.float32)
    occupancy = OccupancyMap(Bounds(-12.0, -12.0, 12.0, 12.0), protocol)
    occupancy.integrate(depth, np.full(depth.shape, Label.OBSTACLE, np.uint8), CAMERA, pose)
    assert occupancy.solid.any()


# --------------------------------------------------------------------------------- solid and target


def test_a_target_disc_is_mapped_where_it_lies_and_is_not_solid() -> None:
    occupancy = empty_map()
    look(occupancy, 0.0, 0.0, 0.0, Disc(4.0, 0.0, 1.0))
    distance = distance_from(occupancy, 4.0, 0.0)
    assert occupancy.target[distance < 0.8].all()
    assert not occupancy.target[distance > 1.2].any()
    assert not occupancy.solid.any()
    assert (occupancy.target_probability[distance < 0.7] > 0.7).all(), "one vote"
    assert (occupancy.target_probability[(distance > 1.4) & (distance < 2.0)] < 0.01).all()
    prior = occupancy.evidence.target_prior
    np.testing.assert_allclose(occupancy.target_probability[distance > 9.0], prior, rtol=1e-6)
    look(occupancy, 0.0, 0.0, 0.0, Disc(4.0, 0.0, 1.0))
    assert (occupancy.target_probability[distance < 0.7] > 0.99).all(), "two"


def test_a_wreck_is_both_target_and_solid() -> None:
    occupancy = empty_map()
    look(occupancy, 0.0, 0.0, 0.0, wall(4.1, label=Label.TARGET))
    row, col = occupancy.cell_of(4.12, 0.1)
    assert occupancy.target[row, col]
    assert occupancy.solid[row, col]
    assert not occupancy.traversable[row, col]


def test_what_lies_below_or_above_the_band_is_not_solid() -> None:
    occupancy = empty_map()
    look(occupancy, 0.0, 0.0, 0.0, Pillar(4.0, 0.0, 0.6, 0.45))
    assert not occupancy.solid.any()
    pose = camera_at(0.0, 0.0, 0.0)
    depth, labels = render(pose)
    points = CAMERA.back_project(np.full(depth.shape, 6.0), pose)
    ceiling = points[..., 2] > SEABED + 2.6
    depth[ceiling], labels[ceiling] = 6.0, Label.OBSTACLE
    occupancy.integrate(depth, labels, CAMERA, pose)
    assert not occupancy.solid.any()


@given(
    v=st.integers(0, CAMERA.height - 1),
    u=st.integers(0, CAMERA.width - 1),
    depth_there=st.floats(0.1, 20.0),
    label=st.sampled_from(list(Label)),
)
def test_one_wrong_pixel_makes_neither_target_nor_wall(
    v: int, u: int, depth_there: float, label: Label
) -> None:
    """But for a target in the cell that it falls in, where it is 5 % of all pixels that do."""
    occupancy = empty_map()
    pose = camera_at(0.0, 0.0, 0.3)
    depth, labels = render(pose)
    depth[v, u], labels[v, u] = depth_there, label
    occupancy.integrate(depth, labels, CAMERA, pose)
    x, y = CAMERA.back_project(depth, pose)[np.isfinite(depth), :2].T
    inside = occupancy.contains(x, y)
    pixels = np.zeros(occupancy.shape, int)
    np.add.at(pixels, occupancy.cell_of(x[inside], y[inside]), 1)
    assert not occupancy.target[pixels > 20].any()
    assert np.count_nonzero(occupancy.target) <= 1
    assert not occupancy.solid.any()


def test_a_cell_in_which_one_pixel_alone_falls_takes_its_word_until_others_say_otherwise() -> None:
    occupancy = empty_map()
    pose = camera_at(0.0, 0.0, 0.3)
    depth, labels = render(pose)
    # At the edge of the image, and beyond the seabed there: no other pixel shows that cell.
    depth[170, 0], labels[170, 0] = 4.0, Label.TARGET
    occupancy.integrate(depth, labels, CAMERA, pose)
    assert np.count_nonzero(occupancy.target) == 1
    for yaw in (0.5, 0.7):
        look(occupancy, 0.0, 0.0, yaw)
    assert not occupancy.target.any()


def test_one_wrong_pixel_takes_no_wall_away() -> None:
    occupancy = empty_map()
    pose = camera_at(0.0, 0.0, 0.0)
    depth, labels = render(pose, wall(4.1))
    occupancy.integrate(depth, labels, CAMERA, pose)
    solid = occupancy.solid
    for v in range(0, CAMERA.height, 40):
        labels[v, 160] = Label.SEABED
        depth[v, 160] *= 1.3
        occupancy.integrate(depth, labels, CAMERA, pose)
    assert (occupancy.solid & solid).sum() == solid.sum()


def test_what_is_seen_above_the_band_takes_no_wall_away() -> None:
    occupancy = empty_map()
    pose = camera_at(0.0, 0.0, 0.0)
    depth, labels = render(pose, wall(4.1))
    occupancy.integrate(depth, labels, CAMERA, pose)
    solid = occupancy.solid
    assert solid.any()
    depth[CAMERA.back_project(depth, pose)[..., 2] <= SEABED + DREAM_V1.band[1]] = np.nan
    for _ in range(12):
        occupancy.integrate(depth, labels, CAMERA, pose)
    np.testing.assert_array_equal(occupancy.solid, solid)


def test_an_obstacle_that_moved_away_is_cleared() -> None:
    occupancy = empty_map()
    for _ in range(20):
        look(occupancy, 0.0, 0.0, 0.0, Pillar(4.0, 0.0, 0.5, 3.0))
    assert occupancy.solid[occupancy.cell_of(3.6, 0.1)]
    for _ in range(12):
        look(occupancy, 0.0, 0.0, 0.0)
    assert not occupancy.solid.any()
    assert occupancy.explored[occupancy.cell_of(7.0, 0.1)]


def test_a_sloping_seabed_is_ground_and_no_wall() -> None:
    occupancy = empty_map()
    slope = 0.15
    for yaw in np.arange(12) * math.pi / 6.0:
        pose = SE3.level(0.0, 0.0, SEABED + DREAM_V1.altitude, yaw) @ DREAM_V1.T_base_camera
        occupancy.integrate(*render(pose, slope=slope), CAMERA, pose)
    x, _ = occupancy.center_of(*np.indices(occupancy.shape))
    error = np.abs(occupancy.ground - (SEABED + slope * x))[occupancy.seabed_seen]
    assert not occupancy.solid.any()
    assert error.max() < 0.5 * DREAM_V1.band[0]
    assert np.percentile(error, 99) < 0.2
    assert np.median(error) < 0.01


def test_heights_are_above_the_local_seabed() -> None:
    # Its top is 0.9 m above the slope where it stands, which is below the band above the start's seabed.
    occupancy = empty_map()
    slope = -0.15
    pose = camera_at(0.0, 0.0, 0.0)
    pillar = Pillar(5.0, 0.0, 0.6, 0.15)
    occupancy.integrate(*render(pose, pillar, slope=slope), CAMERA, pose)
    assert occupancy.solid[occupancy.cell_of(4.6, 0.1)]


def test_the_ground_is_filled_in_under_an_obstacle_and_unknown_before_the_first_frame() -> None:
    occupancy = empty_map()
    assert np.isnan(occupancy.ground).all()
    look_around(occupancy, 0.0, 0.0, Pillar(4.0, 0.0, 1.5, 3.0))
    assert np.abs(occupancy.ground - SEABED).max() < 1e-4


def test_without_any_seabed_the_ground_lies_the_altitude_below_the_camera() -> None:
    occupancy = empty_map()
    pose = camera_at(0.0, 0.0, 0.0)
    depth, labels = render(pose, wall(4.1))
    occupancy.integrate(depth, np.where(labels == Label.SEABED, Label.OBSTACLE, labels), CAMERA, pose)
    np.testing.assert_allclose(occupancy.ground, SEABED, atol=1e-5)
    assert occupancy.solid[occupancy.cell_of(4.12, 0.1)]


def test_rotating_world_and_robot_by_a_quarter_turn_rotates_the_map() -> None:
    things = [(4.0, 1.3, 0.7, 3.0), (-2.2, 5.1, 1.1, 1.0), (3.3, -4.4, 0.4, 2.0)]
    discs = [(2.0, 5.2, 1.3), (-5.0, -2.0, 0.9)]
    maps = []
    for quarter in range(4):
        c, s = round(math.cos(quarter * math.pi / 2)), round(math.sin(quarter * math.pi / 2))
        world: list[Pillar | Disc] = [Pillar(c * x - s * y, s * x + c * y, r, h) for x, y, r, h in things]
        world += [Disc(c * x - s * y, s * x + c * y, r) for x, y, r in discs]
        occupancy = empty_map()
        for x, y, yaw in ((0.0, 0.5, 0.2), (1.5, -1.0, 1.4), (-2.0, 2.5, -2.3)):
            look(occupancy, c * x - s * y, s * x + c * y, yaw + quarter * math.pi / 2, *world)
        maps.append(occupancy)
    for quarter, occupancy in enumerate(maps):
        for name in LAYERS:
            # Rows grow upwards, so that a turn to the left of the world turns the array to the right.
            turned = np.rot90(getattr(maps[0], name), -quarter)
            differing = (turned != getattr(occupancy, name)).sum()
            # A point on the line between two cells may fall to either.
            assert differing <= 2, (name, quarter, differing)
    assert maps[0].solid.sum() > 20
    assert maps[0].target.sum() > 50


def test_solid_target_and_seabed_are_where_the_paper_s_point_sets_are() -> None:
    """Back-projection and partition, point by point; test_frame.py has the twin of the thinned pixels."""
    occupancy = empty_map()
    pose = camera_at(0.5, -1.0, 0.4)
    depth, labels = render(pose, Pillar(5.0, 1.0, 0.8, 2.2), Disc(4.0, -1.0, 1.5))
    occupancy.integrate(depth, labels, CAMERA, pose)

    points, valid = valid_points(
        depth, CAMERA, pose, min_depth=DREAM_V1.min_depth, max_depth=DREAM_V1.max_depth
    )
    kinds = labels[valid]
    near = (np.hypot(*(points[:, :2] - pose.translation[:2]).T) <= DREAM_V1.reach) & (kinds != Label.WATER)
    points, kinds = points[near], kinds[near]
    row, col = occupancy.cell_of(points[:, 0], points[:, 1])
    sets = partition(points, kinds, occupancy.ground[row, col], band=DREAM_V1.band)

    def pixels(of: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
        count = np.zeros(occupancy.shape, np.int64)
        np.add.at(count, occupancy.cell_of(of[:, 0], of[:, 1]), 1)
        return count

    total, band, target = pixels(points), pixels(sets.obstacle), pixels(sets.target)
    # Near the camera one pixel in 32 is looked at, and few of many may all be left out.
    enough = total >= 64
    assert enough.sum() > 100
    # Fewer than in a cell beside it may be taken for scatter.
    most = ndimage.maximum_filter(band, 3)
    solid = (band >= 64) & (band >= 0.3 * total) & (band >= 0.6 * most)
    assert solid.sum() >= 4
    assert occupancy.solid[solid].all()
    assert not occupancy.solid[band < 2].any()
    assert occupancy.target[enough & (target > 0.6 * total)].all()
    assert not occupancy.target[target < 0.25 * total].any()
    assert not occupancy.target[total == 0].any()
    ground = points[(kinds == Label.SEABED) | (kinds == Label.TARGET)]
    assert occupancy.seabed_seen[pixels(ground) >= 64].all()
    assert not occupancy.seabed_seen[pixels(ground) == 0].any()


# ------------------------------------------------------------------------------- where to move


def test_launch_ground_is_traversable_and_not_explored() -> None:
    occupancy = empty_map()
    occupancy.clear_launch(1.0, 2.0)
    np.testing.assert_array_equal(occupancy.traversable, distance_from(occupancy, 1.0, 2.0) <= 2.5)
    assert not occupancy.explored.any()
    assert occupancy.standable[occupancy.cell_of(1.0, 2.0)]


@given(seed=st.integers(0, 2**31))
def test_wherever_in_a_standable_cell_the_whole_body_is_on_traversable_ground(seed: int) -> None:
    rng = np.random.default_rng(seed)
    occupancy = map_with(explored=np.ones((96, 96), np.bool_), solid=rng.random((96, 96)) < 0.01)
    row, col = np.nonzero(occupancy.standable)
    assert len(row)
    x, y = occupancy.center_of(row, col)
    angle = rng.uniform(-math.pi, math.pi, len(x))
    # The worst places inside the cell are its corners; the body's rim counts as body.
    for corner_x, corner_y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        rim_x = x + corner_x * 0.125 + (DREAM_V1.body_radius - 1e-9) * np.cos(angle)
        rim_y = y + corner_y * 0.125 + (DREAM_V1.body_radius - 1e-9) * np.sin(angle)
        assert occupancy.contains(rim_x, rim_y).all()
        assert occupancy.traversable[occupancy.cell_of(rim_x, rim_y)].all()


def test_the_safety_margin_is_the_body_around_a_solid_cell_and_along_the_bounds() -> None:
    solid = np.zeros((96, 96), np.bool_)
    solid[50, 40] = True
    occupancy = map_with(explored=np.ones((96, 96), np.bool_), solid=solid)
    x, y = occupancy.center_of(*np.indices((96, 96)))
    cx, cy = occupancy.center_of(50, 40)
    beyond_square = np.hypot(np.maximum(abs(x - cx) - 0.125, 0.0), np.maximum(abs(y - cy) - 0.125, 0.0))
    margin = 0.25 * math.sqrt(0.5)
    beyond = np.minimum(beyond_square, occupancy.distance_to_bounds)
    np.testing.assert_array_equal(occupancy.standable, beyond > DREAM_V1.body_radius + margin)


@given(seed=st.integers(0, 2**31))
@settings(max_examples=15)
def test_a_segment_is_passable_when_all_its_samples_are_standable(seed: int) -> None:
    rng = np.random.default_rng(seed)
    occupancy = map_with(explored=np.ones((96, 96), np.bool_), solid=rng.random((96, 96)) < 0.01)
    starts = rng.uniform(-13.0, 13.0, (200, 2))
    ends = starts + rng.uniform(-2.0, 2.0, (200, 2))
    for start, end, free in zip(starts, ends, occupancy.passable(starts, ends), strict=True):
        count = max(1, math.ceil(np.hypot(*(end - start)) / 0.125))
        samples = start + np.linspace(0.0, 1.0, count + 1)[:, None] * (end - start)
        inside = occupancy.contains(*samples.T)
        standable = inside.all() and occupancy.standable[occupancy.cell_of(*samples.T)]
        if inside[0] and occupancy.standable[occupancy.cell_of(*start)]:
            assert free == np.all(standable)
        elif free:  # It began too near to something and got no nearer.
            room = occupancy.room[occupancy.cell_of(*samples.T)]
            assert (room >= np.minimum(room[0], occupancy.needed_room + 1)).all()


def test_from_beside_a_late_wall_the_vehicle_may_leave_but_not_go_nearer() -> None:
    solid = np.zeros((96, 96), np.bool_)
    solid[:, 50] = True  # x from 0.5 to 0.75.
    occupancy = map_with(explored=np.ones((96, 96), np.bool_), solid=solid)
    here = np.array([[0.1, 0.1]])
    assert not occupancy.standable[occupancy.cell_of(0.1, 0.1)]
    assert occupancy.passable(here, np.array([[-1.9, 0.1]])).all()
    assert not occupancy.passable(here, np.array([[0.3, 0.1]])).any()
    assert not occupancy.passable(here, np.array([[2.0, 0.1]])).any()
    along_the_wall = np.array([[0.1, 2.1], [0.1, -1.9], [0.1, 0.1]])
    assert not occupancy.passable(np.repeat(here, 3, axis=0), along_the_wall).any()
    assert occupancy.passable(here, np.array([[-0.2, 1.1]])).all(), "slantwise away"
    assert not occupancy.passable(np.array([[0.6, 0.1]]), np.array([[-1.0, 0.1]])).any()


def test_the_distance_to_what_is_solid_is_between_centres() -> None:
    solid = np.zeros((96, 96), np.bool_)
    solid[10, 20] = True
    distance = map_with(solid=solid).distance_to_solid
    assert distance.dtype == np.float32
    np.testing.assert_allclose(distance[13, 24], 1.25)
    assert np.isinf(empty_map().distance_to_solid).all()


# -------------------------------------------------------------------------------- arrays and files


@given(x=st.floats(-12.0, 11.999), y=st.floats(-12.0, 11.999))
def test_a_position_lies_within_half_a_cell_of_the_centre_of_its_cell(x: float, y: float) -> None:
    occupancy = empty_map()
    row, col = occupancy.cell_of(x, y)
    center_x, center_y = occupancy.center_of(row, col)
    assert abs(center_x - x) <= 0.125 + 1e-9
    assert abs(center_y - y) <= 0.125 + 1e-9
    assert occupancy.contains(x, y)


def test_rows_grow_with_y_and_columns_with_x() -> None:
    occupancy = OccupancyMap(Bounds(-1.0, -2.0, 4.0, 6.0), DREAM_V1)
    assert occupancy.shape == (32, 20)
    assert tuple(map(int, occupancy.cell_of(3.9, -1.9))) == (0, 19)
    assert occupancy.contains([-1.0, 4.0, 0.0], [-2.0, 0.0, 6.0]).tolist() == [True, False, False]


def test_bounds_that_are_no_whole_number_of_cells_are_refused() -> None:
    with pytest.raises(ValueError, match=r"bounds: expected a width of whole 0.25 m cells, got 10.1 m"):
        OccupancyMap(Bounds(0.0, 0.0, 10.1, 10.0), DREAM_V1)


def test_the_pool_s_bounds_fit_its_cells() -> None:
    assert OccupancyMap(Bounds(-1.85, -1.85, 1.85, 1.85), POOL_V1).shape == (74, 74)


def test_layers_are_read_only_and_keep_their_values_when_the_map_goes_on() -> None:
    occupancy = empty_map()
    layers = {name: getattr(occupancy, name) for name in LAYERS}
    for layer in layers.values():
        assert layer.shape == occupancy.shape
        assert layer.dtype == np.bool_
        with pytest.raises(ValueError, match="read-only"):
            layer[0, 0] = True
    look_around(occupancy, 0.0, 0.0)
    assert not any(layer.any() for layer in layers.values())


def test_integrating_leaves_its_inputs_alone() -> None:
    pose = camera_at(0.0, 0.0, 0.0)
    depth, labels = render(pose, Disc(4.0, 0.0, 1.0))
    before = depth.copy(), labels.copy(), pose.rotation.copy(), pose.translation.copy()
    depth.flags.writeable = labels.flags.writeable = False
    empty_map().integrate(depth, labels, CAMERA, pose)
    for was, now in zip(before, (depth, labels, pose.rotation, pose.translation), strict=True):
        np.testing.assert_array_equal(was, now)


def test_areas_are_in_square_metres() -> None:
    solid = np.zeros((96, 96), np.bool_)
    solid[:4, :4] = True
    assert map_with(solid=solid, explored=~solid).areas() == {
        "explored": 575.0,
        "target": 0.0,
        "solid": 1.0,
        "seabed_seen": 0.0,
    }


GOOD_DEPTH = np.full((240, 320), 5.0, np.float32)
GOOD_LABELS = np.ones((240, 320), np.uint8)


@pytest.mark.parametrize(
    "depth, labels, message",
    [
        (
            GOOD_DEPTH.T,
            GOOD_LABELS,
            r"depth: expected \(240, 320\).*got \(320, 240\). Are rows and columns swapped",
        ),
        (GOOD_DEPTH, GOOD_LABELS[:10], r"labels: expected \(240, 320\).*got \(10, 320\)"),
        (GOOD_DEPTH[..., None], GOOD_LABELS, r"depth: expected \(height, width\), got \(240, 320, 1\)"),
        (GOOD_DEPTH.astype(np.int16), GOOD_LABELS, "depth: expected floating-point .* uint16 .*, got int16"),
        (GOOD_DEPTH, GOOD_LABELS > 0, "labels: expected integers, .*, or probabilities, got bool"),
        (GOOD_DEPTH, GOOD_LABELS * 1.5, r"labels: expected probabilities in \[0, 1\], got others"),
        (GOOD_DEPTH, GOOD_LABELS * -0.1, r"labels: expected probabilities in \[0, 1\], got others"),
        (GOOD_DEPTH, GOOD_LABELS * np.nan, r"labels: expected probabilities in \[0, 1\], got others"),
        (GOOD_DEPTH, GOOD_LABELS + 6, "labels: expected values of Label, 0 to 3, got 7"),
    ],
)
def test_images_that_do_not_fit_are_refused(depth: Any, labels: Any, message: str) -> None:
    occupancy = empty_map()
    with pytest.raises(ValueError, match=message):
        occupancy.integrate(depth, labels, CAMERA, camera_at(0.0, 0.0, 0.0))
    assert not occupancy.known.any()


def test_a_pose_that_is_not_a_number_is_refused() -> None:
    with pytest.raises(ValueError, match="transform: expected finite numbers"):
        look(empty_map(), math.nan, 0.0, 0.0)
    with pytest.raises(ValueError, match="launch: expected a finite position"):
        empty_map().clear_launch(math.nan, 0.0)


def test_segments_of_the_wrong_shape_are_refused() -> None:
    occupancy = empty_map()
    with pytest.raises(ValueError, match=r"starts: expected \(N, 2\) metres, got \(2,\)"):
        occupancy.passable([0.0, 0.0], [[1.0, 1.0]])
    with pytest.raises(ValueError, match="ends: expected 1, one for every start, got 2"):
        occupancy.passable([[0.0, 0.0]], [[1.0, 1.0], [2.0, 2.0]])
    with pytest.raises(ValueError, match="ends: expected finite positions"):
        occupancy.passable([[0.0, 0.0]], [[1.0, math.inf]])


def test_any_image_size_and_a_camera_that_looks_straight_down_will_do() -> None:
    occupancy = empty_map()
    camera = Camera.from_fov(1, 1, math.radians(60.0))
    down = SE3(np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.array([0.1, 0.1, -8.0]))
    occupancy.integrate(np.full((1, 1), 2.0), np.ones((1, 1), np.uint8), camera, down)
    for layer in (occupancy.seabed_seen, occupancy.known):
        assert np.argwhere(layer).tolist() == [[48, 48]]
    assert not (occupancy.explored | occupancy.traversable).any(), "there is no sector"


def test_a_camera_far_from_the_map_changes_nothing() -> None:
    occupancy = empty_map()
    look_around(occupancy, 500.0, -300.0)
    assert not any(getattr(occupancy, name).any() for name in LAYERS)


def test_a_copy_is_equal_and_goes_its_own_way() -> None:
    occupancy = empty_map()
    look(occupancy, 0.0, 0.0, 0.0, wall(4.1))
    other = occupancy.copy()
    for name in LAYERS:
        np.testing.assert_array_equal(getattr(other, name), getattr(occupancy, name))
    explored = occupancy.explored.sum()
    look_around(other, 0.0, 0.0)
    assert occupancy.explored.sum() == explored < other.explored.sum()


def test_a_map_comes_back_from_its_file_as_it_was_and_goes_on_alike(tmp_path: Any) -> None:
    occupancy = empty_map()
    occupancy.clear_launch(0.0, 0.0)
    look(occupancy, 0.0, 0.0, 0.0, Pillar(4.0, 0.5, 0.5, 3.0), Disc(3.0, -1.0, 1.0))
    occupancy.save(tmp_path / "map.npz")
    back = OccupancyMap.load(tmp_path / "map.npz")
    assert (back.bounds, back.protocol, back.evidence) == (
        occupancy.bounds,
        occupancy.protocol,
        occupancy.evidence,
    )
    for later in (False, True):
        if later:
            look(back, 1.0, 1.0, 2.0)
            look(occupancy, 1.0, 1.0, 2.0)
        for name in (*LAYERS, "target_probability", "ground", "distance_to_solid"):
            np.testing.assert_array_equal(getattr(back, name), getattr(occupancy, name))


def test_a_map_remembers_the_noise_of_its_protocol(tmp_path: Any) -> None:
    OccupancyMap(None, DREAM_V1_NOISY).save(tmp_path / "map.npz")
    assert OccupancyMap.load(tmp_path / "map.npz").protocol == DREAM_V1_NOISY


def test_a_file_from_before_protocols_could_declare_noise_is_read(tmp_path: Any) -> None:
    empty_map().save(tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz") as file:
        content = dict(file)
    about = json.loads(str(content["about"]))
    del about["protocol"]["noise"]
    content["about"] = np.array(json.dumps(about))
    np.savez_compressed(tmp_path / "old.npz", **content)
    assert OccupancyMap.load(tmp_path / "old.npz").protocol == DREAM_V1


def test_a_file_that_is_not_there_is_said_to_be_missing(tmp_path: Any) -> None:
    with pytest.raises(FileNotFoundError):
        OccupancyMap.load(tmp_path / "nothing.npz")


@pytest.mark.parametrize("at", [(AREA.x_min, AREA.y_min), (AREA.x_max, AREA.y_max)], ids=["low", "high"])
def test_launch_ground_goes_to_the_bounds(at: tuple[float, float]) -> None:
    occupancy = empty_map()
    occupancy.clear_launch(*at)
    np.testing.assert_array_equal(occupancy.traversable, distance_from(occupancy, *at) <= 2.5)
