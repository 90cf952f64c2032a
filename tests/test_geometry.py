"""Laws of the transforms and of the camera."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.geometry import SE2, SE3, Bounds, Camera, camera_mount, wrap_angle

angles = st.floats(-50.0, 50.0)
metres = st.floats(-100.0, 100.0)


@st.composite
def transforms(draw: st.DrawFn) -> SE3:
    level = SE3.level(draw(metres), draw(metres), draw(metres), draw(angles))
    return level @ camera_mount(draw(angles))


@given(angles)
def test_wrapping_keeps_the_direction_and_lands_in_the_half_open_turn(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)


def test_a_half_turn_wraps_to_plus_pi_from_both_sides() -> None:
    assert wrap_angle(-math.pi) == math.pi
    assert wrap_angle(math.pi) == math.pi


@given(transforms(), transforms(), transforms())
def test_transforms_are_a_group(a: SE3, b: SE3, c: SE3) -> None:
    left, right = (a @ b) @ c, a @ (b @ c)
    np.testing.assert_allclose(left.translation, right.translation, atol=1e-7)
    np.testing.assert_allclose(left.rotation, right.rotation, atol=1e-9)
    unit = a @ a.inverse
    np.testing.assert_allclose(unit.rotation, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(unit.translation, 0.0, atol=1e-9)


@given(transforms(), transforms())
def test_applying_a_product_is_applying_both(a: SE3, b: SE3) -> None:
    points = np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, 0.0]])
    np.testing.assert_allclose((a @ b) @ points, a @ (b @ points), atol=1e-7)


def test_the_camera_mount_looks_forward_and_down() -> None:
    mount = camera_mount(math.radians(20.0))
    forward = mount.rotation @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(
        forward, [math.cos(math.radians(20)), 0.0, -math.sin(math.radians(20))], atol=1e-12
    )
    right = mount.rotation @ np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(right, [0.0, -1.0, 0.0], atol=1e-12)
    assert math.isclose(np.linalg.det(mount.rotation), 1.0)


@given(transforms(), st.integers(1, 6), st.integers(1, 6))
def test_projecting_a_back_projected_image_gives_the_pixel_centres(T: SE3, width: int, height: int) -> None:
    camera = Camera.from_fov(width, height, math.radians(90.0))
    depth = np.linspace(0.5, 9.0, width * height).reshape(height, width)
    points_world = camera.back_project(depth, T)
    pixels, z = camera.project(T.inverse @ points_world)
    np.testing.assert_allclose(z, depth, atol=1e-6)
    v, u = np.mgrid[0:height, 0:width] + 0.5
    np.testing.assert_allclose(pixels[..., 0], u, atol=1e-5)
    np.testing.assert_allclose(pixels[..., 1], v, atol=1e-5)


def test_eq_01_the_principal_ray_goes_straight_ahead() -> None:
    camera = Camera(3, 3, 10.0, 10.0, 1.5, 1.5)
    point = camera.back_project(np.full((3, 3), 4.0), SE3.level(1.0, 2.0, 3.0, 0.0) @ camera_mount(0.0))[1, 1]
    np.testing.assert_allclose(point, [5.0, 2.0, 3.0], atol=1e-12)


def test_a_point_behind_the_camera_has_no_pixel() -> None:
    pixels, _ = Camera.from_fov(4, 4, 1.0).project(np.array([0.1, 0.1, -1.0]))
    assert np.isnan(pixels).all()


def test_scaling_a_camera_keeps_its_field_of_view() -> None:
    camera = Camera.from_fov(320, 240, math.radians(90.0))
    assert math.isclose(camera.scaled(2.0).horizontal_fov, camera.horizontal_fov)
    assert camera.scaled(2.0).width == 640


def test_swapped_axes_are_named() -> None:
    camera = Camera.from_fov(320, 240, 1.5)
    with pytest.raises(ValueError, match=r"depth: expected \(240, 320\).*rows and columns swapped"):
        camera.back_project(np.zeros((320, 240)), SE3.level(0, 0, 0, 0))


def test_poses_refuse_nan() -> None:
    with pytest.raises(ValueError, match="finite"):
        SE2(math.nan, 0.0, 0.0)
    with pytest.raises(ValueError, match="finite"):
        SE3.level(0.0, math.inf, 0.0, 0.0)
    with pytest.raises(ValueError, match=r"expected rotation \(3, 3\)"):
        SE3(np.eye(2), np.zeros(3))


TURNED = (SE3.level(0.0, 0.0, 0.0, 0.7) @ camera_mount(0.3)).rotation


@pytest.mark.parametrize(
    ("matrix", "told"),
    [
        (TURNED @ np.diag([1.0, 1.0, -1.0]), "mirrors.*NED"),
        (np.diag([1.0, -1.0, 1.0]), "mirrors"),
        (-np.eye(3), "mirrors"),
        (np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), "mirrors"),
        (1.01 * TURNED, "axes of length 1.01, 1.01, 1.01.*quaternion"),
        (1000.0 * TURNED, "axes of length 1000"),
        (np.diag([1.0, 1.0, 1.002]), "axes of length 1, 1, 1.002"),
        (np.zeros((3, 3)), "zeros"),
        (np.diag([1.0, 1.0, 0.0]), "flattens"),
        (np.ones((3, 3)), "flattens"),
        (np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), "square to each other"),
        (np.arange(9.0).reshape(3, 3) + np.eye(3), "square to each other"),
    ],
)
def test_a_matrix_that_is_no_rotation_is_no_pose(matrix: np.ndarray, told: str) -> None:
    with pytest.raises(ValueError, match=f"^transform: expected a rotation, got .*{told}") as caught:
        SE3(matrix, np.zeros(3))
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("digits", [4, 6, 12])
def test_a_rotation_as_it_was_rounded_is_a_pose(digits: int) -> None:
    assert SE3(np.round(TURNED, digits), np.zeros(3)).yaw == pytest.approx(
        math.atan2(TURNED[1, 0], TURNED[0, 0]), abs=1e-3
    )
    SE3(TURNED.astype(np.float32), np.zeros(3))


def test_bounds_must_be_a_box() -> None:
    with pytest.raises(ValueError, match="x_min < x_max"):
        Bounds(1.0, 0.0, 0.0, 1.0)
    box = Bounds(-1.0, -2.0, 1.0, 2.0)
    assert (box.width, box.depth) == (2.0, 4.0)
    assert box.contains(1.0, 2.0)
    assert not box.contains(1.0, 2.0, margin=0.1)
