"""Depth by the flat floor: closed forms, and scenes whose depth a ray tells exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dream.geometry import SE3, Camera, camera_mount
from dream.perception import FlatFloor, View
from dream.perception.flat_floor import floor_depth, rays
from dream.types import BoolArray, Float32Array, Label, UInt8Array

CAMERA = Camera.from_fov(160, 120, math.radians(90.0))
MOUNT = camera_mount(math.radians(20.0))
RGB = np.zeros((120, 160, 3), np.uint8)
ATTITUDES = [(0.0, 0.0), (0.1, 0.0), (0.0, 0.12), (-0.08, 0.1)]
"""Roll and pitch."""


def turned(roll: float, pitch: float, yaw: float = 0.7) -> SE3:
    about_x = np.array([[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]])
    about_y = np.array(
        [[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]]
    )
    level = SE3.level(3.0, -2.0, -5.0, yaw)
    return SE3(level.rotation @ about_y @ about_x, level.translation)


def meets(T_world_base: SE3, T_base_camera: SE3, surface: np.ndarray, offset: float) -> np.ndarray:
    """(H, W) depth at which each ray meets the plane `surface · p = offset`; a loop on purpose."""
    T_world_camera = T_world_base @ T_base_camera
    depth = np.full((CAMERA.height, CAMERA.width), np.nan)
    for v in range(CAMERA.height):
        for u in range(CAMERA.width):
            ray = T_world_camera.rotation @ np.array(
                [(u + 0.5 - CAMERA.cx) / CAMERA.fx, (v + 0.5 - CAMERA.cy) / CAMERA.fy, 1.0]
            )
            along = float(surface @ ray)
            if along != 0.0:
                z = (offset - float(surface @ T_world_camera.translation)) / along
                depth[v, u] = z if z > 0.0 else np.nan
    return depth


def estimate(labels: UInt8Array, T_world_base: SE3, altitude: float) -> tuple[Float32Array, Float32Array]:
    return FlatFloor().estimate(RGB, labels, View(CAMERA, T_world_base, MOUNT, altitude))


@pytest.mark.parametrize(("roll", "pitch"), ATTITUDES)
def test_the_floor_is_where_each_ray_meets_the_plane(roll: float, pitch: float) -> None:
    T_world_base, altitude = turned(roll, pitch), 0.6
    mount = SE3(MOUNT.rotation, np.array([0.2, -0.05, 0.1]))
    exact = meets(T_world_base, mount, np.array([0.0, 0.0, 1.0]), -5.0 - altitude)
    exact[exact > 20.0] = np.nan
    found = floor_depth(rays(View(CAMERA, T_world_base, mount, altitude)), 20.0)
    near = exact < 15.0
    np.testing.assert_allclose(found[near], exact[near], rtol=2e-4)
    assert (np.isnan(found) == np.isnan(exact)).mean() > 0.995
    assert np.isnan(found).any()


def test_the_optical_axis_meets_the_floor_at_the_altitude_over_the_sine_of_the_pitch() -> None:
    one = Camera(1, 1, 100.0, 100.0, 0.5, 0.5)
    found = floor_depth(rays(View(one, turned(0.0, 0.0), MOUNT, 0.6)), 20.0)
    assert found[0, 0] == pytest.approx(0.6 / math.sin(math.radians(20.0)), rel=1e-6)


def test_heading_and_place_do_not_matter() -> None:
    labels = np.full((120, 160), Label.SEABED, np.uint8)
    labels[:60] = Label.OBSTACLE
    one, _ = estimate(labels, turned(0.05, 0.03, yaw=0.0), 0.6)
    other, _ = estimate(labels, turned(0.05, 0.03, yaw=2.9), 0.6)
    np.testing.assert_allclose(one, other, rtol=1e-3)


def wall(T_world_base: SE3, away: float, altitude: float) -> tuple[BoolArray, np.ndarray, np.ndarray]:
    """Pixels of a wall across the vehicle's way, `away` metres ahead, its depth and that of the floor."""
    yaw = T_world_base.yaw
    normal = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    depth = meets(T_world_base, MOUNT, normal, float(normal @ T_world_base.translation) + away)
    floor = meets(T_world_base, MOUNT, np.array([0.0, 0.0, 1.0]), T_world_base.translation[2] - altitude)
    return ~(floor < depth), depth, floor


@pytest.mark.parametrize(("roll", "pitch"), ATTITUDES)
@pytest.mark.parametrize("away", [0.6, 1.2])
def test_a_wall_stands_where_its_foot_is(roll: float, pitch: float, away: float) -> None:
    T_world_base, altitude = turned(roll, pitch), 0.6
    stands, exact, _ = wall(T_world_base, away, altitude)
    labels = np.where(stands, Label.OBSTACLE, Label.SEABED).astype(np.uint8)
    depth, confidence = estimate(labels, T_world_base, altitude)
    # Half a pixel at the foot is this much of its distance over ground.
    pixel = 0.5 / CAMERA.fx * (away**2 + altitude**2) / (away * altitude)
    error = np.abs(depth / exact - 1.0)[stands]
    assert np.isfinite(depth[stands]).mean() > 0.995
    assert np.nanquantile(error, 0.95) < 2.0 * pixel
    assert abs(np.nanmedian((depth / exact - 1.0)[stands])) < pixel
    assert (confidence[stands] > 0.3).mean() > 0.9


def test_a_pole_before_a_wall_has_a_foot_of_its_own_along_an_upright_line() -> None:
    """The lines of upright things run together towards the nadir, and do not stay in a column."""
    T_world_base, altitude = turned(0.1, 0.05), 0.6
    behind, wall_depth, _ = wall(T_world_base, 1.4, altitude)
    looks = rays(View(CAMERA, T_world_base, MOUNT, altitude))
    bearing, away = 0.35, 0.8
    # All that is within 3° of one bearing, and not below its foot.
    pole = (np.abs(looks.azimuth - bearing) < math.radians(3.0)) & (
        looks.down / looks.ahead <= altitude / away
    )
    labels = np.where(behind | pole, Label.OBSTACLE, Label.SEABED).astype(np.uint8)
    depth, _ = estimate(labels, T_world_base, altitude)
    reach = depth * looks.ahead
    inside = pole & (np.abs(looks.azimuth - bearing) < math.radians(2.0))
    assert inside.sum() > 300
    np.testing.assert_allclose(reach[inside], away, rtol=0.04)
    beside = behind & ~pole & (np.abs(looks.azimuth - bearing) > math.radians(5.0))
    assert np.nanquantile(np.abs(depth / wall_depth - 1.0)[beside], 0.95) < 0.08


def test_floor_between_two_things_parts_their_feet() -> None:
    """A low block with floor seen above it, then a wall: the wall is not as near as the block."""
    labels = np.full((120, 160), Label.SEABED, np.uint8)
    stands, exact, _ = wall(turned(0.0, 0.0), 1.2, 0.6)
    labels[stands] = Label.OBSTACLE
    labels[95:105, 60:100] = Label.OBSTACLE
    depth, _ = estimate(labels, turned(0.0, 0.0), 0.6)
    np.testing.assert_allclose(depth[10:30, 60:100], exact[10:30, 60:100], rtol=0.04)
    looks = rays(View(CAMERA, turned(0.0, 0.0), MOUNT, 0.6))
    foot = (floor_depth(looks, 20.0) * looks.ahead)[104, 80]
    assert depth[96, 80] * looks.ahead[96, 80] == pytest.approx(foot, rel=0.03)


def test_without_a_foot_in_view_a_thing_is_as_far_as_it_can_be_and_doubtful() -> None:
    labels = np.full((120, 160), Label.OBSTACLE, np.uint8)
    depth, confidence = estimate(labels, turned(0.0, 0.0), 0.6)
    looks = rays(View(CAMERA, turned(0.0, 0.0), MOUNT, 0.6))
    lowest = 0.6 / math.tan(math.radians(20.0) + math.atan(60.0 / 80.0))
    middle = (depth * looks.ahead)[:, 80]
    np.testing.assert_allclose(middle, lowest, rtol=0.03)
    assert confidence.max() < 0.35


def test_what_hangs_above_the_horizon_and_water_have_no_depth() -> None:
    labels = np.full((120, 160), Label.WATER, np.uint8)
    labels[5:15] = Label.OBSTACLE
    labels[100:] = Label.SEABED
    depth, confidence = estimate(labels, turned(0.0, 0.0), 0.6)
    assert np.isnan(depth[:100]).all()
    assert (confidence[:100] == 0.0).all()
    assert np.isfinite(depth[100:]).all()
    assert (confidence[100:] > 0.5).all()


def test_confidence_in_the_floor_falls_with_its_distance() -> None:
    labels = np.full((120, 160), Label.SEABED, np.uint8)
    depth, confidence = estimate(labels, turned(0.0, 0.0), 0.6)
    column = confidence[:, 80][np.isfinite(depth[:, 80])]
    assert (np.diff(column[:60]) >= 0.0).all()
    assert column[0] < 0.3 < 0.8 < column[-1]


@pytest.mark.parametrize("altitude", [0.0, -1.0, math.nan, math.inf])
def test_an_altitude_that_is_none_is_refused(altitude: float) -> None:
    with pytest.raises(ValueError, match="altitude: expected metres above 0"):
        estimate(np.zeros((120, 160), np.uint8), turned(0.0, 0.0), altitude)


def test_labels_of_another_size_are_refused() -> None:
    with pytest.raises(ValueError, match="Are rows and columns swapped"):
        estimate(np.zeros((160, 120), np.uint8), turned(0.0, 0.0), 0.6)
