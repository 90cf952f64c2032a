"""The fault of a thruster: what it adds to the motion, how likely it is by that, and what is done then."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dream.control import _kernels as control
from dream.control.autopilot import nominal
from dream.control.diagnosis import Diagnosis, NamedFault, controllable, failing
from dream.control.diagnosis import _kernels as diagnosis
from dream.sim.vehicle import BLUEROV2, BLUEROV2_HEAVY, Current, Vehicle
from dream.sim.vehicle import _kernels as water
from dream.vehicle import FaultKind
from dream.vehicle._kernels import WEAK_SHARE
from tests.control.test_autopilot import dragging

Array = npt.NDArray[np.float64]
EVERY = [
    (vehicle, thruster, kind)
    for vehicle in (BLUEROV2_HEAVY, BLUEROV2)
    for thruster in range(1, vehicle.thrusters.count + 1)
    for kind in FaultKind
]
JAM = 17.8


def done(vehicle: Vehicle, fault: NamedFault, commands: Array) -> Array:
    """(6,) the wrench of commands, where that thruster fails."""
    forces = vehicle.thrusters.forces(commands)
    at = fault.thruster - 1
    forces[at] = {
        FaultKind.DEAD: 0.0,
        FaultKind.WEAK: WEAK_SHARE * forces[at],
        FaultKind.JAMMED: fault.force,
    }[fault.kind]
    return np.asarray(vehicle.thrusters.allocation @ forces)


# ------------------------------------------------------------------------------------------- the residual


@pytest.mark.parametrize("vehicle", [BLUEROV2_HEAVY, BLUEROV2])
@pytest.mark.parametrize("share", [0.3, 1.0])
def test_what_a_dead_thruster_adds_is_its_column_times_its_force(vehicle: Vehicle, share: float) -> None:
    rng, count = np.random.default_rng(3), vehicle.thrusters.count
    body = dragging(vehicle, share * vehicle.damping[1]).body
    plant = Diagnosis().plant(vehicle.slowest, vehicle.thrusters)
    inertia = np.concatenate([np.full(3, body.mass), body.moments]) + body.added
    for dead in range(count):
        turn = rng.normal(0.0, 1.0, 4)
        x = np.concatenate([[1.0, 2.0, -5.0], turn / np.linalg.norm(turn), rng.normal(0.0, 0.3, 6 + count)])
        commanded = x[13:].copy()
        x[13 + dead] = 0.0
        east, north = rng.normal(0.0, 0.2, 2)
        change, expected = np.empty(len(x)), np.empty(6)
        flow = Current((east, north, 0.0)).flow
        water.rates(body, flow, np.zeros(2), np.zeros(3), np.zeros(count), x, change)
        lift, (ahead, left, _) = body.buoyancy - body.weight, body.buoyancy_centre
        unknown = np.array([share, share, east, north, lift, ahead, left, 0.0, 0.0])
        rotation = np.array(water.rotation(x)).reshape(3, 3)
        diagnosis.motion(plant, unknown, rotation, x[7:10], x[10:13], expected)
        residual = inertia * change[7:13] - expected - vehicle.thrusters.allocation @ commanded
        column = vehicle.thrusters.allocation[:, dead]
        np.testing.assert_allclose(residual, -column * commanded[dead], atol=1e-10)


# ------------------------------------------------------------------------------------------- likelihoods


def filled(vehicle: Vehicle, rng: np.random.Generator, bins: int) -> diagnosis.Memory:
    """A memory of bins that hold anything."""
    memory = Diagnosis().begin(vehicle.slowest, vehicle.thrusters)
    unknown = diagnosis.UNKNOWN
    for at in range(bins):
        row = memory.bins[at]
        row[:6] = rng.normal(0.0, 0.5, 6)
        row[6:12] = rng.uniform(0.3, 0.9, 6)
        row[diagnosis.THRUST : diagnosis.THRUST + vehicle.thrusters.count] = rng.normal(
            0.0, 3.0, vehicle.thrusters.count
        )
        row[diagnosis.SLOPES :] = rng.normal(0.0, 0.3, 6 * unknown)
        memory.means[at] = rng.normal(0.0, 0.2, unknown)
        root = rng.normal(0.0, 0.2, (unknown, unknown))
        memory.covariances[at] = root @ root.T + 0.01 * np.eye(unknown)
    memory.clock[diagnosis.COUNT] = bins
    return memory


def slowly(plant: Any, memory: diagnosis.Memory, bins: int) -> Array:
    """(n, 3) logarithms of likelihood ratios over one window, by Gaussians written out."""
    count = int(memory.clock[diagnosis.COUNT])
    rows = memory.bins[count - bins : count]
    n, unknown = len(memory.force), diagnosis.UNKNOWN
    y = rows[:, :6].ravel()
    H = rows[:, diagnosis.SLOPES :].reshape(6 * bins, unknown)
    P = memory.covariances[count - bins] + np.diag(plant.walk**2) * bins * 0.1
    sure = np.linalg.inv(np.diag(rows[:, 6:12].ravel() ** 2) + H @ P @ H.T)
    off = y - H @ memory.means[count - bins]

    def ratio(signal: Array) -> float:
        return float(0.5 * off @ sure @ off - 0.5 * (off - signal) @ sure @ (off - signal))

    found = np.empty((n, 3))
    for t in range(n):
        one = np.tile(plant.allocation[:, t], bins)
        moved = (rows[:, diagnosis.THRUST + t][:, None] * plant.allocation[:, t][None, :]).ravel()
        found[t, :2] = ratio(-moved), ratio(-(1.0 - WEAK_SHARE) * moved)
        likeliest = one @ sure @ (off + moved) / (one @ sure @ one)
        jams = [max(likeliest, plant.jam), min(likeliest, -plant.jam)]
        found[t, 2] = max(ratio(jam * one - moved) for jam in jams)
    return found


@pytest.mark.parametrize("vehicle", [BLUEROV2_HEAVY, BLUEROV2])
@pytest.mark.parametrize("bins", [3, 4, 9])
def test_likelihoods_are_those_of_gaussians(
    vehicle: Vehicle, bins: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = Diagnosis().plant(vehicle.slowest, vehicle.thrusters)
    memory = filled(vehicle, np.random.default_rng(bins), bins)
    found, forces = np.empty((vehicle.thrusters.count, 3)), np.empty(vehicle.thrusters.count)
    diagnosis.compare(plant, memory, found, forces)
    windows = [window for window in diagnosis.WINDOWS if window <= bins]
    by_window = np.array([slowly(plant, memory, window) for window in windows])
    explained = np.isfinite(found)
    assert explained.any()
    best = np.isclose(by_window, found, rtol=1e-6, atol=1e-8).any(axis=0)
    assert best[explained].all()


def test_equations_are_solved() -> None:
    rng = np.random.default_rng(0)
    A, B = rng.normal(size=(9, 9)), rng.normal(size=(9, 9))
    A[0, 0] = 0.0
    found = B.copy()
    diagnosis.solve(A.copy(), found)
    np.testing.assert_allclose(A @ found, B, atol=1e-10)


# --------------------------------------------------------------------------------------- what is done then


@pytest.mark.parametrize(("vehicle", "thruster", "kind"), EVERY)
def test_the_others_make_the_wrench_that_is_asked_for(
    vehicle: Vehicle, thruster: int, kind: FaultKind
) -> None:
    fault = NamedFault(thruster, kind, JAM, 0.0)
    vertical = vehicle.thrusters.directions[thruster - 1][2] != 0.0
    lost = vehicle is BLUEROV2 and vertical and kind is not FaultKind.WEAK
    assert controllable(vehicle.thrusters, fault) is not lost
    healthy = nominal(vehicle.slowest, vehicle.thrusters)
    chosen = failing(healthy, vehicle.slowest, vehicle.thrusters, fault)
    rng, commands = np.random.default_rng(thruster), np.empty(vehicle.thrusters.count)
    reached = vehicle.thrusters.allocation @ np.linalg.pinv(vehicle.thrusters.allocation)
    for _ in range(20):
        demand = reached @ rng.normal(0.0, [4.0, 4.0, 4.0, 0.3, 0.3, 1.0])
        share = control.allocate(demand, chosen, commands)
        assert np.abs(commands).max() <= 1.0
        if not lost:
            assert share == 1.0
            np.testing.assert_allclose(done(vehicle, fault, commands), demand, atol=1e-6)


@pytest.mark.parametrize("kind", [FaultKind.DEAD, FaultKind.JAMMED])
@pytest.mark.parametrize("thruster", [5, 6])
def test_what_cannot_be_kept_level_leans_no_farther_than_rights_itself(
    thruster: int, kind: FaultKind
) -> None:
    """Six thrusters without one of the two vertical ones, asked for all heave that there may be."""
    fault = NamedFault(thruster, kind, JAM, 0.0)
    hull = BLUEROV2.slowest
    chosen = failing(nominal(hull, BLUEROV2.thrusters), hull, BLUEROV2.thrusters, fault)
    commands = np.empty(6)
    for heave in (-60.0, -3.0, 0.0, 3.0, 60.0):
        control.allocate(np.array([0.0, 0.0, heave, 0.0, 0.0, 0.0]), chosen, commands)
        rolls = done(BLUEROV2, fault, commands)[3]
        assert abs(rolls) <= hull.weight * hull.centre_of_buoyancy[2] * math.sin(math.radians(15.1))


def test_what_holds_against_a_jam_is_not_given_up_for_what_is_asked() -> None:
    """Under more than they can give, the moments of the jammed one still cancel."""
    fault = NamedFault(1, FaultKind.JAMMED, JAM, 0.0)
    hull, thrusters = BLUEROV2_HEAVY.slowest, BLUEROV2_HEAVY.thrusters
    chosen = failing(nominal(hull, thrusters), hull, thrusters, fault)
    commands, demand = np.empty(8), np.array([500.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    share = control.allocate(demand, chosen, commands)
    assert 0.0 < share < 0.5
    np.testing.assert_allclose(done(BLUEROV2_HEAVY, fault, commands), share * demand, atol=1e-6)


@pytest.mark.parametrize("name", ["force_noise", "certain", "pace"])
def test_a_limit_that_is_none_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"diagnosis.{name}: expected a number above 0"):
        Diagnosis(**{name: 0.0})
