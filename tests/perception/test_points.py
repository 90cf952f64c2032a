"""Eq. 1-6: from pixels to three disjoint sets of points."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.geometry import SE3, Camera, camera_mount
from dream.perception import (
    free_points,
    obstacle_points,
    partition,
    target_points,
    valid_depth,
    valid_points,
)
from dream.types import Label

CAMERA = Camera(4, 3, 2.0, 2.0, 2.0, 1.5)
BAND = (0.5, 2.5)


def test_eq_01_a_pixel_lies_at_its_depth_along_its_ray() -> None:
    depth = np.full((3, 4), 5.0)
    points = CAMERA.back_project(depth, SE3(np.eye(3), np.array([1.0, 2.0, 3.0])))
    # Pixel (3, 0) is seen through (3.5, 0.5): 0.75 to the right and 0.5 up per metre of depth.
    np.testing.assert_allclose(points[0, 3], [1.0 + 0.75 * 5.0, 2.0 - 0.5 * 5.0, 3.0 + 5.0])


def test_eq_01_the_optical_axis_of_a_level_vehicle_meets_the_seabed_where_trigonometry_says() -> None:
    camera = Camera(1, 1, 1.0, 1.0, 0.5, 0.5)
    pitch, height, yaw = math.radians(20.0), 2.0, math.radians(30.0)
    T_world_camera = SE3.level(4.0, 5.0, -8.0, yaw) @ camera_mount(pitch)
    point = camera.back_project(np.array([[height / math.sin(pitch)]]), T_world_camera)[0, 0]
    over_ground = height / math.tan(pitch)
    np.testing.assert_allclose(
        point, [4.0 + over_ground * math.cos(yaw), 5.0 + over_ground * math.sin(yaw), -10.0]
    )


def test_eq_02_depths_are_valid_within_the_limits_and_the_greatest_is_no_return() -> None:
    depth = np.array([np.nan, -1.0, 0.09, 0.1, 5.0, 19.999, 20.0, 20.1, np.inf])
    valid = valid_depth(depth, min_depth=0.1, max_depth=20.0)
    assert valid.tolist() == [False, False, False, True, True, True, False, False, False]


def test_eq_02_limits_out_of_order_are_refused() -> None:
    with pytest.raises(ValueError, match="min_depth < max_depth, got 5"):
        valid_depth(np.zeros(1), min_depth=5.0, max_depth=1.0)


def test_eq_03_the_valid_points_are_the_back_projection_of_the_valid_pixels_in_order() -> None:
    depth = np.array([[1.0, np.nan, 30.0, 4.0], [0.0, 2.0, 3.0, 0.1], [9.0, 20.0, 20.5, np.nan]])
    pose = SE3.level(1.0, -2.0, -8.0, 0.7) @ camera_mount(0.3)
    points, valid = valid_points(depth, CAMERA, pose, min_depth=0.1, max_depth=20.0)
    expected = [CAMERA.back_project(depth, pose)[v, u] for v in range(3) for u in range(4) if valid[v, u]]
    assert valid.sum() == 6
    np.testing.assert_array_equal(points, expected)


def test_eq_04_the_mask_alone_makes_a_target_whatever_its_height() -> None:
    labels = np.array([Label.TARGET, Label.OBSTACLE, Label.SEABED, Label.WATER, Label.TARGET])
    assert target_points(labels).tolist() == [True, False, False, False, True]


def test_eq_05_an_obstacle_stands_in_the_band_above_the_local_seabed() -> None:
    points = np.array([[0.0, 0.0, z] for z in (-10.0, -9.51, -9.5, -7.5, -7.49, -9.0)])
    labels = np.array([Label.OBSTACLE] * 5 + [Label.TARGET])
    assert obstacle_points(points, labels, -10.0, band=BAND).tolist() == [
        False,
        False,
        True,
        True,
        False,
        False,
    ]
    # The same points half a metre of seabed higher.
    ground = np.full(6, -9.5)
    assert obstacle_points(points, labels, ground, band=BAND).tolist() == [
        False,
        False,
        False,
        True,
        True,
        False,
    ]


def test_eq_06_what_is_neither_target_nor_obstacle_is_free() -> None:
    points = np.array([[0.0, 0.0, z] for z in (-10.0, -9.0, -9.0, -6.0)])
    labels = np.array([Label.SEABED, Label.TARGET, Label.OBSTACLE, Label.OBSTACLE])
    assert free_points(points, labels, -10.0, band=BAND).tolist() == [True, False, False, True]


@given(
    rows=st.lists(
        st.tuples(st.floats(-12.0, -5.0), st.sampled_from(list(Label)), st.floats(-11.0, -9.0)), max_size=40
    )
)
def test_eq_04_to_06_the_three_sets_are_disjoint_and_cover(rows: list[tuple[float, Label, float]]) -> None:
    z, labels, ground = (np.array([row[k] for row in rows]) for k in range(3))
    points = np.column_stack([np.arange(len(rows)), np.zeros(len(rows)), z])
    sets = partition(points, labels, ground, band=BAND)
    together = np.concatenate([sets.target, sets.obstacle, sets.free])
    assert sorted(together[:, 0]) == list(range(len(rows)))


@pytest.mark.parametrize(
    "change, message",
    [
        ({"points_world": np.zeros((4, 2))}, r"points: expected \(n, 3\), got \(4, 2\)"),
        ({"labels": np.zeros(3, int)}, r"labels: expected \(4,\).*got \(3,\)"),
        ({"ground": np.zeros(5)}, r"ground: expected a number or \(4,\), got \(5,\)"),
        ({"band": (2.0, 1.0)}, r"band: expected h_min < h_max, got \(2.0, 1.0\)"),
    ],
)
def test_shapes_that_do_not_fit_are_refused_with_what_was_expected(
    change: dict[str, Any], message: str
) -> None:
    arguments: dict[str, Any] = {
        "points_world": np.zeros((4, 3)),
        "labels": np.zeros(4, int),
        "ground": -10.0,
        "band": BAND,
    }
    with pytest.raises(ValueError, match=message):
        partition(**(arguments | change))


def test_inputs_are_not_changed() -> None:
    depth: npt.NDArray[np.float64] = np.array([[1.0, np.nan, 30.0, 4.0]] * 3)
    before = depth.copy()
    valid_points(depth, CAMERA, SE3.level(0.0, 0.0, -8.0, 0.0), min_depth=0.1, max_depth=20.0)
    np.testing.assert_array_equal(depth, before)
