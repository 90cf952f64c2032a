"""Laws of the groups, and the groups against scipy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from dream.estimation._kernels import groups

Array = npt.NDArray[np.float64]


def vectors(size: int, most: float) -> st.SearchStrategy[Array]:
    """Vectors of any length from 1e-9 to `most`: the small ones run through the series."""
    directions = st.lists(st.floats(-1.0, 1.0), min_size=size, max_size=size).map(np.array)
    scales = st.floats(-9.0, math.log10(most)).map(lambda power: 10.0**power)
    return st.builds(lambda d, s: s * d / max(float(np.linalg.norm(d)), 1e-3), directions, scales)


turns = vectors(3, 3.1)
twists = st.builds(lambda a, b: np.concatenate([a, b]), turns, vectors(6, 30.0))


def matrix(twist: Array) -> Array:
    """(5, 5) of a twist in the Lie algebra of SE_2(3)."""
    out = np.zeros((5, 5))
    out[:3, :3] = hat(twist[:3])
    out[:3, 3], out[:3, 4] = twist[3:6], twist[6:9]
    return out


def hat(a: Array) -> Array:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def pose(parts: Any) -> Array:
    """(5, 5) of rotation, velocity and position."""
    out = np.eye(5)
    out[:3, :3], out[:3, 3], out[:3, 4] = parts
    return out


def parts_of(pose: Array) -> tuple[Array, Array, Array]:
    return (pose[:3, :3].copy(), pose[:3, 3].copy(), pose[:3, 4].copy())


@given(turns)
def test_rotations_are_those_of_scipy(turn: Array) -> None:
    rotation = groups.so3_exp(turn)
    np.testing.assert_allclose(rotation, Rotation.from_rotvec(turn).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(groups.so3_log(rotation), turn, atol=1e-13)


@given(twists)
def test_extended_poses_are_matrix_exponentials(twist: Array) -> None:
    np.testing.assert_allclose(pose(groups.se23_exp(twist)), expm(matrix(twist)), atol=1e-12)


@given(twists)
def test_the_logarithm_undoes_the_exponential(twist: Array) -> None:
    np.testing.assert_allclose(groups.se23_log(*groups.se23_exp(twist)), twist, atol=1e-11)


@given(st.floats(0.0, math.pi), st.floats(-math.pi, math.pi))
def test_the_logarithm_is_exact_near_a_half_turn(polar: float, bearing: float) -> None:
    across = math.sin(polar)
    axis = np.array([across * math.cos(bearing), across * math.sin(bearing), math.cos(polar)])
    for short in (0.0, 1e-12, 1e-7, 1e-3):
        rotation = Rotation.from_rotvec((math.pi - short) * axis).as_matrix()
        turn = groups.so3_log(rotation)
        assert np.linalg.norm(turn) <= math.pi + 1e-12
        np.testing.assert_allclose(groups.so3_exp(turn), rotation, atol=1e-13)


@given(turns, vectors(3, 20.0), st.floats(1e-3, 0.5))
def test_the_integrals_carry_a_constant_force_exactly(turn: Array, force: Array, dt: float) -> None:
    """d/dt (R, v, p) = (R ω^×, R a, v): the last two columns of an exponential give Γ1 and Γ2."""
    flow = np.zeros((5, 5))
    flow[:3, :3], flow[:3, 3], flow[3, 4] = hat(turn / dt), force, 1.0
    moved = expm(flow * dt)
    whole, once, twice = groups.so3_integrals(turn)
    np.testing.assert_allclose(whole, moved[:3, :3], atol=1e-13)
    np.testing.assert_allclose(once @ force * dt, moved[:3, 3], atol=1e-12)
    np.testing.assert_allclose(twice @ force * dt**2, moved[:3, 4], atol=1e-12)


@given(turns)
def test_the_left_jacobian_and_its_inverse(turn: Array) -> None:
    jacobian = groups.so3_left_jacobian(turn)
    np.testing.assert_allclose(jacobian, groups.so3_integrals(turn)[1], atol=1e-15)
    np.testing.assert_allclose(groups.so3_left_jacobian_inverse(turn) @ jacobian, np.eye(3), atol=1e-12)
    for axis in np.eye(3):
        step = 1e-5
        ahead, behind = groups.so3_exp(turn + step * axis), groups.so3_exp(turn - step * axis)
        slope = groups.so3_log(np.ascontiguousarray(ahead @ behind.T)) / (2.0 * step)
        np.testing.assert_allclose(jacobian @ axis, slope, atol=1e-8)


@given(twists, twists)
def test_the_adjoint_carries_a_twist_to_the_other_side(where: Array, twist: Array) -> None:
    X = groups.se23_exp(where)
    moved = groups.se23_adjoint(*X) @ twist
    scale = 1.0 + float(np.abs(moved).max())
    np.testing.assert_allclose(
        pose(X) @ expm(matrix(twist)) / scale, expm(matrix(moved)) @ pose(X) / scale, atol=1e-11
    )


@given(turns, turns)
def test_quaternions_compose_as_rotations_do(a: Array, b: Array) -> None:
    product = groups.quaternion_product(groups.quaternion_exp(a), groups.quaternion_exp(b))
    both = groups.so3_exp(a) @ groups.so3_exp(b)
    np.testing.assert_allclose(groups.rotation_from(product), both, atol=1e-13)
    again = groups.quaternion_from(np.ascontiguousarray(both))
    np.testing.assert_allclose(abs(again @ product), 1.0, atol=1e-13)
    np.testing.assert_allclose(
        groups.quaternion_product(product, groups.quaternion_conjugate(product)), [1, 0, 0, 0], atol=1e-13
    )


@given(turns)
def test_the_logarithm_of_a_quaternion_knows_no_sign(turn: Array) -> None:
    quaternion = groups.quaternion_exp(turn)
    np.testing.assert_allclose(groups.quaternion_log(quaternion), turn, atol=1e-13)
    np.testing.assert_allclose(groups.quaternion_log(-quaternion), turn, atol=1e-13)


@pytest.mark.parametrize("side", [1.0 - 1e-6, 1.0 + 1e-6])
def test_series_and_closed_form_meet(side: float) -> None:
    """Both sides of the switch agree with a series of twelve terms to the last digits."""
    t = groups.SMALL * side
    turn = np.array([math.sqrt(t), 0.0, 0.0])
    terms = range(12)
    first = sum((-t) ** k / math.factorial(2 * k + 2) for k in terms)
    second = sum((-t) ** k / math.factorial(2 * k + 3) for k in terms)
    third = sum((-t) ** k / math.factorial(2 * k + 4) for k in terms)
    _, once, twice = groups.so3_integrals(turn)
    np.testing.assert_allclose(once[2, 1] / turn[0], first, rtol=1e-14)
    np.testing.assert_allclose((1.0 - once[1, 1]) / t, second, rtol=1e-10)
    np.testing.assert_allclose((0.5 - twice[1, 1]) / t, third, rtol=1e-10)
    angle = turn[0]
    half = (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / t
    np.testing.assert_allclose((1.0 - groups.so3_left_jacobian_inverse(turn)[1, 1]) / t, half, rtol=1e-9)


@given(st.floats(-50.0, 50.0))
def test_wrapping_keeps_the_direction(angle: float) -> None:
    wrapped = groups.wrap(angle)
    assert -math.pi - 1e-12 <= wrapped <= math.pi + 1e-12
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)
