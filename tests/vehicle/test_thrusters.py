from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dream.vehicle import VECTORED, VECTORED_6DOF, Thrusters
from dream.vehicle.thrusters import T200

BOTH = pytest.mark.parametrize("thrusters", [VECTORED, VECTORED_6DOF], ids=["vectored", "6dof"])
commands = st.floats(-1.0, 1.0)


def test_the_curve_goes_through_the_makers_table() -> None:
    command, force = np.array(T200).T
    assert np.allclose(VECTORED.forces(command), force, atol=1e-12)


def test_between_the_points_the_curve_keeps_to_the_published_fit() -> None:
    # Polynomials through the same table (0.25 N RMS), away from full throttle, where they are too strong.
    u = np.linspace(0.1, 0.75, 50)
    ahead = -12.43 * u**3 + 49.67 * u**2 + 16.86 * u - 1.36
    astern = -14.11 * (-u) ** 3 - 44.74 * u**2 + 11.06 * -u + 0.78
    assert np.abs(VECTORED.forces(u) - ahead).max() < 0.6
    assert np.abs(VECTORED.forces(-u) - astern).max() < 0.6


@given(st.floats(-0.07, 0.07))
def test_in_the_dead_band_there_is_no_force(u: float) -> None:
    assert VECTORED.forces(u) == 0.0


@given(commands, commands)
def test_more_command_is_never_less_force(a: float, b: float) -> None:
    low, high = VECTORED.forces([min(a, b), max(a, b)])
    assert low <= high


@given(commands.filter(lambda u: abs(u) > 0.0701), st.floats(10.0, 20.0))
def test_the_inverse_of_the_curve_gives_the_command_back(u: float, voltage: float) -> None:
    thrusters = replace(VECTORED, voltage=voltage)
    assert float(thrusters.commands(thrusters.forces(u))) == pytest.approx(u, abs=1e-9)


@given(st.floats(-39.9, 51.5))
def test_the_curve_of_the_inverse_gives_the_force_back(force: float) -> None:
    assert float(VECTORED.forces(VECTORED.commands(force))) == pytest.approx(force, abs=1e-9)


def test_forces_out_of_reach_ask_for_full_throttle_and_no_force_for_none() -> None:
    assert VECTORED.commands([-500.0, -39.9, 0.0, 51.5, 500.0]).tolist() == [-1.0, -1.0, 0.0, 1.0, 1.0]
    assert VECTORED.forces([-3.0, 3.0]).tolist() == pytest.approx([-39.9, 51.5])


@pytest.mark.parametrize(
    ("voltage", "kilograms"),
    [
        (12.0, [-2.90, -1.95, -1.02, -0.32, 0.39, 1.28, 2.46, 3.71]),
        (14.0, [-3.52, -2.35, -1.24, -0.40, 0.50, 1.55, 2.99, 4.52]),
    ],
)
def test_an_empty_battery_is_weaker_as_in_the_makers_table(voltage: float, kilograms: list[float]) -> None:
    command = np.array([-1.0, -0.75, -0.5, -0.25, 0.25, 0.5, 0.75, 1.0])
    found = replace(VECTORED, voltage=voltage).forces(command)
    share = found / (9.80665 * np.array(kilograms)) - 1.0
    assert np.abs(share[np.abs(command) >= 0.5]).max() < 0.03
    assert np.abs(share).max() < 0.11


def test_the_six_push_as_the_published_allocation_matrix_says() -> None:
    # HKPolyU-UAV/bluerov2, but for the moments of horizontal thrusters that sit below the centre of gravity.
    published = np.array(
        [
            [0.707, 0.707, -0.707, -0.707, 0.0, 0.0],
            [0.707, -0.707, 0.707, -0.707, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 1.0, 1.0],
            [0.0, 0.0, 0.0, 0.0, -0.1105, 0.1105],
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.1665, -0.1665, -0.175, 0.175, 0.0, 0.0],
        ]
    )
    assert np.allclose(VECTORED.allocation, published, atol=2e-4)


@BOTH
def test_forces_allocated_to_the_thrusters_give_the_wrench_back(thrusters: Thrusters) -> None:
    A = thrusters.allocation
    actuated = np.eye(6)
    if thrusters is VECTORED:
        actuated[4, 4] = 0.0  # six thrusters cannot pitch
    assert np.allclose(A @ np.linalg.pinv(A), actuated, atol=1e-12)


@BOTH
def test_each_thruster_pushes_where_it_points(thrusters: Thrusters) -> None:
    for k, (at, way) in enumerate(zip(thrusters.positions, thrusters.directions, strict=True)):
        assert np.allclose(thrusters.allocation[:3, k], way)
        assert np.allclose(thrusters.allocation[3:, k], np.cross(at, way))


def test_full_throttle_gives_the_wrenches_of_the_maker() -> None:
    surge = VECTORED.allocation @ VECTORED.forces([1, 1, -1, -1, 0, 0])
    assert np.allclose(surge, [129.3, 0, 0, 0, 0, 0], atol=0.1)
    yaw = VECTORED.allocation @ VECTORED.forces([1, -1, -1, 1, 0, 0])
    assert np.allclose(yaw[5], 31.2, atol=0.1)


def test_nonsense_is_refused() -> None:
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match=r"commands: expected finite"):
            VECTORED.forces(bad)
        with pytest.raises(ValueError, match=r"forces: expected finite"):
            VECTORED.commands(bad)
    with pytest.raises(ValueError, match=r"thrusters.voltage: expected a number above 0, got 0"):
        replace(VECTORED, voltage=0.0)
    with pytest.raises(ValueError, match="as many directions as positions"):
        replace(VECTORED, positions=VECTORED.positions[:3])
    with pytest.raises(ValueError, match="length 1"):
        Thrusters(((0.0, 0.0, 0.0),), ((1.0, 1.0, 0.0),))
    with pytest.raises(ValueError, match="rising"):
        replace(VECTORED, curve=((-1.0, 0.0), (1.0, -1.0)))
