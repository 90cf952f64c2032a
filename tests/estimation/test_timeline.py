"""A timeline gives the states of messages in order, in whatever order and shape they come."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dream.estimation import Cipg, DeadReckoning, Ekf, InEkf, Mounting, Timeline, Verdict
from dream.measurements import Depth, Dvl, Heading, Imu, Measurement
from tests.estimation.flights import DVL, PRESSURE, Sensors, sense, survey

MOUNTING = Mounting(DVL, PRESSURE)
FILTER = InEkf(mounting=MOUNTING)
FLIGHT = survey(4.0)
LOG = sense(FLIGHT, Sensors(), np.random.default_rng(0))


def begun(estimator: Any = FILTER, **options: float) -> Timeline[Any]:
    return Timeline(estimator, estimator.begin(0.0, FLIGHT.pose(0), FLIGHT.velocities[0]), **options)


def assert_same(a: Any, b: Any, *, atol: float = 1e-12) -> None:
    for field in fields(a):
        if field.name not in ("outcome", "window", "estimate"):
            left, right = np.asarray(getattr(a, field.name)), np.asarray(getattr(b, field.name))
            np.testing.assert_allclose(left, right, atol=atol, err_msg=field.name)


def with_delays(delays: dict[type, float]) -> list[Imu | Measurement]:
    """All messages in the order in which they come in."""
    messages = list(LOG.messages())
    return sorted(messages, key=lambda m: m.time + delays.get(type(m), 0.0))


@pytest.mark.few(3)
@pytest.mark.parametrize("kind", [InEkf, Ekf, Cipg, DeadReckoning])
def test_in_order_it_is_the_estimator_itself(kind: Any) -> None:
    estimator = kind(mounting=MOUNTING)
    timeline = begun(estimator)
    state = timeline.state
    for message in LOG.messages():
        assert timeline.take(message).verdict.taken
        if isinstance(message, Imu):
            state = estimator.predict(state, message, message.time - state.time)
        else:
            state = estimator.correct(state, message)
        assert_same(timeline.state, state)


@pytest.mark.parametrize("kind", [InEkf, Ekf, Cipg, DeadReckoning])
def test_late_measurements_end_in_the_state_of_those_in_order(kind: Any) -> None:
    estimator = kind(mounting=MOUNTING)
    here, late = begun(estimator), begun(estimator)
    for message in LOG.messages():
        here.take(message)
    for message in with_delays({Dvl: 0.173, Depth: 0.009, Heading: 0.4}):
        assert late.take(message).verdict.taken
    assert_same(here.state, late.state)


@settings(max_examples=15)
@given(st.lists(st.floats(0.0, 0.6), min_size=30, max_size=30), st.booleans())
def test_any_order_of_the_measurements_gives_the_same_state(delays: list[float], early: bool) -> None:
    samples = [m for m in LOG.messages() if isinstance(m, Imu) and m.time <= 1.005]
    said = [m for m in LOG.messages() if not isinstance(m, Imu) and m.time <= 1.005]
    inorder, shuffled = begun(), begun()
    for message in sorted([*samples, *said], key=lambda m: m.time):
        inorder.take(message)
    come: list[tuple[float, int, int, Imu | Measurement]]
    come = [(m.time, 0, k, m) for k, m in enumerate(samples)]
    # Some of them even come in before the inertial samples of their time.
    come += [(m.time + d - 0.3 * early, 1, k, m) for k, (m, d) in enumerate(zip(said, delays, strict=True))]
    for _, _, _, message in sorted(come, key=lambda c: c[:3]):
        assert shuffled.take(message).verdict.taken
    assert_same(inorder.state, shuffled.state)


def test_a_measurement_between_two_samples_is_applied_at_its_own_time() -> None:
    """The sample is cut in two there; exactly so, since rate and force are constant during it."""
    timeline, imu = begun(), LOG.imu[0]
    between = Depth(0.004, -3.0, 0.02)
    assert timeline.take(between).verdict is Verdict.WAITING
    assert timeline.take(imu).verdict is Verdict.TAKEN
    state = FILTER.begin(0.0, FLIGHT.pose(0), FLIGHT.velocities[0])
    state = FILTER.correct(FILTER.predict(state, imu, 0.004), between)
    assert_same(timeline.state, FILTER.predict(state, imu, imu.time - state.time))
    assert timeline.state.time == pytest.approx(imu.time)


def test_a_report_right_after_a_sample_is_trusted_as_one_at_it() -> None:
    """The sample that is cut there has the noise of a whole one, however thin the slice."""
    at, after = begun(), begun()
    for imu in LOG.imu[:50]:
        at.take(imu)
        after.take(imu)
    report = next(m for m in LOG.after[50] if isinstance(m, Dvl))
    at.take(report)
    after.take(replace(report, time=report.time + 1e-7))
    for timeline in (at, after):
        timeline.take(LOG.imu[50])
    # The lever arm reads the next sample, with its own noise.
    np.testing.assert_allclose(after.state.velocity, at.state.velocity, atol=1e-3)
    np.testing.assert_allclose(np.diag(after.state.covariance), np.diag(at.state.covariance), rtol=1e-3)


def test_what_is_refused_is_named_and_changes_nothing() -> None:
    timeline = begun(memory=0.5)
    for message in LOG.messages():
        if message.time <= 2.0:
            timeline.take(message)
    state, now = timeline.state, timeline.state.time
    good = LOG.imu[200]
    nan = np.array([0.0, math.nan, 0.0])
    cases: list[tuple[Imu | Measurement, Verdict]] = [
        (replace(good, angular_velocity=nan), Verdict.NOT_FINITE),
        (replace(good, time=math.nan), Verdict.NOT_FINITE),
        (replace(good, time=now), Verdict.AGAIN),
        (replace(good, time=now - 0.005), Verdict.BACKWARDS),
        (replace(good, time=now + 1000.0), Verdict.AHEAD),
        (Depth(math.nan, -3.0, 0.02), Verdict.NOT_FINITE),
        (Depth(now + 1.1, -3.0, 0.02), Verdict.AHEAD),
        (Depth(now - 0.7, -3.0, 0.02), Verdict.LATE),
        (Depth(now, -3.0, 0.02), Verdict.AGAIN),
        (Depth(now - 0.1, -3.0, 0.02), Verdict.AGAIN),
        (Depth(now - 0.05, math.nan, 0.02), Verdict.NOT_FINITE),
        (Depth(now - 0.03, -30.0, 0.02), Verdict.UNLIKELY),
        (Dvl(now - 0.03, np.zeros(3), 1e-4 * np.eye(3), 2.0, False), Verdict.NO_LOCK),
    ]
    for message, verdict in cases:
        outcome = timeline.take(message)
        assert outcome.verdict is verdict
        assert not outcome.verdict.taken
        for name in ("rotation", "velocity", "position", "covariance"):
            np.testing.assert_allclose(getattr(timeline.state, name), getattr(state, name), atol=1e-12)
    # And it goes on.
    assert timeline.take(good).verdict is Verdict.TAKEN
    waits = Depth(timeline.state.time + 0.1, -3.0, 0.02)
    assert timeline.take(waits).verdict is Verdict.WAITING
    assert timeline.take(waits).verdict is Verdict.AGAIN


def test_missing_samples_are_bridged_and_the_estimate_comes_back() -> None:
    flight = survey(30.0)
    log = sense(flight, Sensors(), np.random.default_rng(4))
    timeline = Timeline(FILTER, FILTER.begin(0.0, flight.pose(0), flight.velocities[0]))
    verdicts: Counter[Verdict] = Counter()
    for message in log.messages():
        if isinstance(message, Imu) and 22.0 < message.time < 22.8:
            continue
        outcome = timeline.take(message)
        verdicts[outcome.verdict] += 1
    assert verdicts[Verdict.BRIDGED] == 1
    assert timeline.state.time == pytest.approx(30.0)
    assert np.linalg.norm(timeline.state.velocity - flight.velocities[-1]) < 0.05
    assert np.linalg.norm(timeline.state.position - flight.positions[-1]) < 0.5


def test_a_leap_of_the_clock_is_believed_when_the_next_sample_agrees() -> None:
    timeline, imu = begun(), LOG.imu[0]
    assert timeline.take(imu).verdict is Verdict.TAKEN
    assert timeline.take(replace(imu, time=500.0)).verdict is Verdict.AHEAD
    assert timeline.take(LOG.imu[1]).verdict is Verdict.TAKEN
    # The unit was away for ten seconds.
    assert timeline.take(replace(imu, time=10.0)).verdict is Verdict.AHEAD
    assert timeline.take(replace(imu, time=10.01)).verdict is Verdict.BRIDGED
    assert timeline.take(replace(imu, time=10.02)).verdict is Verdict.TAKEN
    assert timeline.state.time == pytest.approx(10.02)
    assert np.isfinite(timeline.state.covariance).all()


def test_an_amendment_is_made_again_when_an_older_measurement_comes_in() -> None:
    early, late = begun(), begun()
    depth = Depth(0.1, float(FLIGHT.positions[10, 2]), 0.02)
    for timeline in (early, late):
        for imu in LOG.imu[:20]:
            timeline.take(imu)
            if timeline is early and imu.time == pytest.approx(0.1):
                timeline.take(depth)
        timeline.amend(lambda state: FILTER.rest(replace(state, velocity=np.zeros(3)), 1.0, None))
        for imu in LOG.imu[20:30]:
            timeline.take(imu)
    late.take(depth)
    assert_same(early.state, late.state)


def test_it_remembers_no_longer_than_it_is_told() -> None:
    timeline = begun(memory=0.2)
    for message in LOG.messages():
        timeline.take(message)
    assert len(timeline._events) < 0.3 * 100 * 1.5
    assert timeline.take(Depth(timeline.state.time - 0.15, -3.0, 0.02)).verdict is not Verdict.LATE


def test_its_options_are_checked() -> None:
    with pytest.raises(ValueError, match="memory: expected seconds of at least 0"):
        begun(memory=-1.0)
