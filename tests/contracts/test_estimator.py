"""What every estimator must do, whatever it is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from dream.estimation import Cipg, DeadReckoning, Ekf, InEkf, Mounting, Verdict
from dream.geometry import SE3
from dream.measurements import Depth, Dvl, Heading, Imu
from tests.estimation.flights import DVL, PRESSURE, Flight, Log, Sensors, sense, survey

MOUNTING = Mounting(DVL, PRESSURE)
ESTIMATORS: list[Any] = [kind(mounting=MOUNTING) for kind in (InEkf, Ekf, Cipg, DeadReckoning)]

every_estimator = pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)


@pytest.fixture(scope="module")
def flight() -> Flight:
    return survey(30.0)


@pytest.fixture(scope="module")
def log(flight: Flight) -> Log:
    return sense(flight, Sensors(), np.random.default_rng(7))


def fly(estimator: Any, flight: Flight, log: Log, *, shift: SE3 | None = None) -> list[Any]:
    start = flight.pose(0) if shift is None else shift @ flight.pose(0)
    velocity = flight.velocities[0] if shift is None else shift.rotation @ flight.velocities[0]
    state = estimator.begin(0.0, start, velocity)
    states = [state]
    for k, imu in enumerate(log.imu, start=1):
        state = estimator.predict(state, imu, flight.dt)
        for measurement in log.after.get(k, ()):
            state = estimator.correct(state, measurement)
        states.append(state)
    return states


@pytest.fixture(scope="module")
def flown(flight: Flight, log: Log) -> Callable[[Any], list[Any]]:
    """The states of an estimator in the flight, which each makes once."""
    known: dict[type, list[Any]] = {}

    def states(estimator: Any) -> list[Any]:
        if type(estimator) not in known:
            known[type(estimator)] = fly(estimator, flight, log)
        return known[type(estimator)]

    return states


def arrays(state: Any) -> dict[str, Any]:
    """All that a state holds but the outcome, down to arrays and numbers."""
    found: dict[str, Any] = {}
    for name, value in ((f.name, getattr(state, f.name)) for f in fields(state) if f.name != "outcome"):
        if isinstance(value, tuple):
            found |= {f"{name}.{part}": np.asarray(inner) for part, inner in value._asdict().items()}  # type: ignore[attr-defined]
        else:
            found[name] = np.asarray(value)
    return found


def assert_same(a: Any, b: Any) -> None:
    for name, value in arrays(a).items():
        np.testing.assert_array_equal(value, arrays(b)[name], err_msg=name)


@every_estimator
def test_it_begins_where_it_is_told(estimator: Any) -> None:
    pose = SE3.level(3.0, -2.0, -5.0, 0.7)
    state = estimator.begin(12.5, pose, (0.3, 0.1, -0.2))
    assert state.time == 12.5
    assert state.outcome is None
    np.testing.assert_allclose(state.pose.rotation, pose.rotation, atol=1e-12)
    np.testing.assert_allclose(state.pose.translation, pose.translation, atol=1e-12)
    np.testing.assert_allclose(state.velocity, (0.3, 0.1, -0.2), atol=1e-12)
    np.testing.assert_array_equal(state.angular_velocity, np.zeros(3))


@every_estimator
def test_it_stays_near_the_truth(estimator: Any, flight: Flight, flown: Callable[[Any], list[Any]]) -> None:
    states = flown(estimator)
    for step in range(0, flight.steps + 1, 50):
        state = states[step]
        assert state.time == pytest.approx(step * flight.dt)
        assert np.linalg.norm(state.pose.translation - flight.positions[step]) < 0.3
        assert np.linalg.norm(state.velocity - flight.velocities[step]) < 0.1
        turn = state.pose.rotation.T @ flight.rotations[step]
        assert math.acos(min(1.0, 0.5 * (np.trace(turn) - 1.0))) < math.radians(6.0)
        np.testing.assert_allclose(state.pose.rotation @ state.pose.rotation.T, np.eye(3), atol=1e-9)


@every_estimator
def test_no_step_changes_what_it_is_given(estimator: Any, flight: Flight, log: Log) -> None:
    states = fly(estimator, flight, replace(log, imu=log.imu[:30]))
    state = states[-1]
    before = {name: value.copy() for name, value in arrays(state).items()}
    imu, after = log.imu[30], log.after[30]
    kept = imu.angular_velocity.copy(), imu.specific_force.copy()
    moved = estimator.predict(state, imu, 0.01)
    corrected = [estimator.correct(moved, measurement) for measurement in after]
    for name, value in arrays(state).items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)
    np.testing.assert_array_equal(imu.angular_velocity, kept[0])
    np.testing.assert_array_equal(imu.specific_force, kept[1])
    assert all(state.time == moved.time for state in corrected)
    # What it keeps of a sample is its own.
    for value in arrays(moved).values():
        assert not np.shares_memory(value, imu.angular_velocity)
        assert not np.shares_memory(value, imu.specific_force)


@every_estimator
def test_the_same_log_gives_the_same_states(
    estimator: Any, flight: Flight, log: Log, flown: Callable[[Any], list[Any]]
) -> None:
    again = fly(estimator, flight, replace(log, imu=log.imu[:1000]))
    for a, b in zip(flown(estimator)[:1001:100], again[::100], strict=True):
        assert_same(a, b)


@every_estimator
def test_a_world_that_is_turned_and_moved_gives_the_same_flight_turned_and_moved(
    estimator: Any, flight: Flight, log: Log, flown: Callable[[Any], list[Any]]
) -> None:
    shift = SE3.level(5.0, -8.0, 0.0, 1.2)
    turned = {
        k: [replace(m, yaw=m.yaw + 1.2) if isinstance(m, Heading) else m for m in said]
        for k, said in log.after.items()
    }
    here = flown(estimator)[-1]
    there = fly(estimator, flight, replace(log, after=turned), shift=shift)[-1]
    expected = shift @ here.pose
    np.testing.assert_allclose(there.pose.rotation, expected.rotation, atol=1e-7)
    np.testing.assert_allclose(there.pose.translation, expected.translation, atol=1e-6)


BAD: list[Any] = [
    (Dvl(0.0, np.zeros(3), 1e-4 * np.eye(3), 2.0, False), Verdict.NO_LOCK),
    (Dvl(0.0, np.array([0.0, np.inf, 0.0]), 1e-4 * np.eye(3), 2.0, True), Verdict.NOT_FINITE),
    (Dvl(0.0, np.zeros(3), np.eye(3), 2.0, True), Verdict.TOO_NOISY),
    (Dvl(0.0, np.zeros(3), 1e-4 * np.eye(3), 0.01, True), Verdict.TOO_CLOSE),
    (Depth(0.0, math.nan, 0.01), Verdict.NOT_FINITE),
    (Heading(0.0, math.inf, 0.01), Verdict.NOT_FINITE),
    (Heading(math.nan, 0.0, 0.01), Verdict.NOT_FINITE),
]


@every_estimator
@pytest.mark.parametrize("measurement, verdict", BAD)
def test_what_cannot_be_used_is_refused_by_name(estimator: Any, measurement: Any, verdict: Verdict) -> None:
    state = estimator.begin(0.0, SE3.level(0.0, 0.0, -3.0, 0.0))
    after = estimator.correct(state, measurement)
    assert after.outcome.verdict is verdict
    assert not after.outcome.verdict.taken
    assert_same(state, after)


@every_estimator
def test_a_sample_that_is_no_number_or_has_no_length_is_a_mistake(estimator: Any) -> None:
    state = estimator.begin(0.0, SE3.level(0.0, 0.0, -3.0, 0.0))
    good = Imu(0.01, np.zeros(3), np.array([0.0, 0.0, 9.81]))
    for dt in (0.0, -0.01, math.nan):
        with pytest.raises(ValueError, match="dt: expected seconds above 0"):
            estimator.predict(state, good, dt)
        with pytest.raises(ValueError, match="dt: expected seconds above 0"):
            estimator.bridge(state, good, dt)
    none = np.array([0.0, math.nan, 0.0])
    for bad in (replace(good, angular_velocity=none), replace(good, specific_force=none)):
        with pytest.raises(ValueError, match="imu: expected finite"):
            estimator.predict(state, bad, 0.01)
        with pytest.raises(ValueError, match="imu: expected finite"):
            estimator.bridge(state, bad, 0.01)


@every_estimator
def test_where_samples_are_missing_it_moves_alike_and_knows_no_more(
    estimator: Any, flight: Flight, log: Log
) -> None:
    state = fly(estimator, flight, replace(log, imu=log.imu[:30]))[-1]
    moved, bridged = estimator.predict(state, log.imu[30], 0.02), estimator.bridge(state, log.imu[30], 0.02)
    assert bridged.time == moved.time
    np.testing.assert_array_equal(bridged.pose.rotation, moved.pose.rotation)
    np.testing.assert_array_equal(bridged.pose.translation, moved.pose.translation)
    np.testing.assert_array_equal(bridged.velocity, moved.velocity)
    if hasattr(state, "covariance"):
        values = np.linalg.eigvalsh(bridged.covariance - moved.covariance)
        assert values.min() > -1e-12
        assert values.max() > 1e-5


@every_estimator
def test_arrays_of_any_layout_are_taken(estimator: Any) -> None:
    state = estimator.begin(0.0, SE3.level(0.0, 0.0, -3.0, 0.0))
    wide = np.arange(12.0).reshape(3, 4) / 100.0
    good = Imu(0.01, np.ascontiguousarray(wide[:, 1]), np.ascontiguousarray(wide[:, 2]))
    strided = Imu(0.01, wide[:, 1], wide[:, 2])
    assert_same(estimator.predict(state, good, 0.01), estimator.predict(state, strided, 0.01))


@every_estimator
def test_the_parameters_cannot_be_changed(estimator: Any) -> None:
    with pytest.raises((AttributeError, TypeError)):
        estimator.mounting = Mounting()
