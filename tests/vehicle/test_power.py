"""What a vehicle draws: the maker's table, the model of it, and a vehicle that swims."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dream.evaluation.runner import simulate
from dream.planning import Belief
from dream.protocol import DREAM_V1, DREAM_V1_NAV
from dream.sim.vehicle import BLUEROV2, BLUEROV2_HEAVY
from dream.sim.worlds import make_world
from dream.vehicle import HOTEL_W, VECTORED_6DOF, PowerModel, watts
from dream.vehicle.power import T200_AMPERES
from dream.vehicle.thrusters import T200

AT_12_V = ((-1.0, 17.03), (-0.75, 8.90), (-0.5, 3.30), (0.5, 3.30), (0.75, 8.90), (1.0, 16.91))
"""Command and amperes of the maker's table at 12 V: only the power of the voltage was fitted to it."""
NEWTONS_AT_12_V = (
    (-28.8, 204.4),
    (-24.1, 155.3),
    (-19.0, 106.8),
    (-14.2, 67.6),
    (-10.0, 39.6),
    (-6.4, 18.6),
    (-3.2, 6.0),
    (4.0, 6.0),
    (7.9, 18.6),
    (12.4, 39.6),
    (17.8, 68.9),
    (24.0, 106.8),
    (30.6, 153.9),
    (36.8, 202.9),
)
"""Force and watts of the same, every 50 µs. The fit of `PowerModel` saw none of it."""


def test_a_thruster_draws_what_the_table_says() -> None:
    command, amperes = np.array(T200_AMPERES).T
    np.testing.assert_allclose(watts(command), 16.0 * amperes, atol=1e-9)
    assert (np.diff(watts(np.linspace(0.0, 1.0, 200))) >= 0.0).all()
    assert watts(1.7) == watts(1.0)


@pytest.mark.parametrize(("command", "amperes"), AT_12_V)
def test_at_another_voltage_it_draws_about_what_the_table_says(command: float, amperes: float) -> None:
    assert float(watts(command, 12.0)) == pytest.approx(12.0 * amperes, rel=0.05)


def test_the_model_meets_the_table_that_it_is_fitted_to() -> None:
    command, newtons = np.array(T200).T
    strong = np.abs(newtons) > 4.0
    np.testing.assert_allclose(
        PowerModel().thruster(newtons[strong]), watts(command[strong]), rtol=0.05, atol=0.0
    )


def test_the_model_meets_a_table_that_it_never_saw() -> None:
    newtons, drawn = np.array(NEWTONS_AT_12_V).T
    off = np.abs(PowerModel().thruster(newtons) / drawn - 1.0)
    assert off.mean() <= 0.08
    assert off.max() <= 0.17


@pytest.mark.parametrize("vehicle", [BLUEROV2, BLUEROV2_HEAVY])
def test_it_draws_more_the_faster_it_swims(vehicle: object) -> None:
    assert isinstance(vehicle, type(BLUEROV2))
    drawn = [
        PowerModel().under_way(vehicle.typical, vehicle.thrusters, speed) for speed in (0.0, 0.3, 0.6, 1.0)
    ]
    assert drawn == sorted(drawn)
    assert drawn[0] == pytest.approx(HOTEL_W, rel=0.05)


def test_the_drag_of_a_typical_hull_is_between_the_least_and_the_most() -> None:
    least, most = (factor * BLUEROV2_HEAVY.hull.quadratic[0] for factor in BLUEROV2_HEAVY.damping)
    assert BLUEROV2_HEAVY.typical.quadratic[0] == pytest.approx(math.sqrt(least * most))


def test_the_sum_over_thrusters_is_that_of_each() -> None:
    forces = np.linspace(-30.0, 40.0, VECTORED_6DOF.count)
    each = [float(PowerModel().thruster(force)) for force in forces]
    assert float(PowerModel().thruster(forces).sum()) == pytest.approx(sum(each))


@pytest.mark.parametrize("protocol", [DREAM_V1, DREAM_V1_NAV])
def test_a_mission_draws_at_least_its_hotel_load_all_the_time(protocol: object) -> None:
    assert isinstance(protocol, type(DREAM_V1))
    seen = [
        step.observation for step in simulate(make_world("flat/empty", 1), Belief(), protocol, max_steps=8)
    ]
    drawn = [one.drawn_wh or 0.0 for one in seen]
    assert drawn[0] == pytest.approx(0.0, abs=0.1)
    for before, after in zip(range(len(seen) - 1), range(1, len(seen)), strict=True):
        hours = (seen[after].time - seen[before].time) / 3600.0
        assert drawn[after] - drawn[before] >= (HOTEL_W * hours) * (1.0 - 1e-6)
    assert drawn[-1] < 400.0 * seen[-1].time / 3600.0 + 0.1
