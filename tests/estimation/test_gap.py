"""Where inertial samples are missing, a filter is as uncertain as the vehicle is free, and no less."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from dream.estimation import Cipg, DeadReckoning, Ekf, Gap, InEkf, Mounting, Start, Timeline, Verdict
from dream.geometry import SE3
from dream.measurements import Depth, Dvl, Imu, Measurement
from tests.estimation import textbook
from tests.estimation.flights import DVL, PRESSURE, Flight, Log, Sensors, carried, from_motion, sense, survey

Array = npt.NDArray[np.float64]

MOUNTING, START = Mounting(DVL, PRESSURE), Start(tilt=0.01, yaw=0.02, velocity=0.02, accelerometer_bias=0.02)
FILTERS: list[Any] = [InEkf(mounting=MOUNTING, start=START), Ekf(mounting=MOUNTING, start=START)]
STILL = Imu(0.0, np.zeros(3), np.array([0.0, 0.0, 9.81]))


@dataclass(frozen=True)
class Unaware:
    """A filter that takes a bridge for samples like others."""

    of: Any

    def predict(self, state: Any, imu: Imu, dt: float) -> Any:
        return self.of.predict(state, imu, dt)

    def bridge(self, state: Any, imu: Imu, dt: float) -> Any:
        return self.of.predict(state, imu, dt)

    def correct(self, state: Any, measurement: Measurement) -> Any:
        return self.of.correct(state, measurement)


@dataclass(frozen=True)
class Unasked(Unaware):
    """One that must not be asked to bridge anything."""

    def bridge(self, state: Any, imu: Imu, dt: float) -> Any:
        raise AssertionError("there is nothing to bridge")


def swaying(seed: int, duration: float = 8.1, dt: float = 0.01) -> Flight:
    """To and fro with turns, leaning into each, as a BlueROV2 in the simulated tank does."""
    t = dt * np.arange(round(duration / dt) + 1)
    rng = np.random.default_rng(seed)
    swing = rng.uniform(0.0, 2.0 * math.pi, 6)
    roll, pitch = 0.06 * np.sin(9.0 * t + swing[0]), 0.04 * np.sin(8.0 * t + swing[1])
    yaw = 1.0 * np.sin(0.6 * t + swing[2])
    attitude = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=-1))
    speeds = np.stack([np.sin(f * t + s) for f, s in zip((1.1, 1.4, 0.8), swing[3:], strict=True)], axis=-1)
    return from_motion(dt, attitude, speeds * [0.3, 0.3, 0.1], np.array([2.0, -1.0, -3.0]))


def loosened(flight: Flight, since: float, until: float, gap: Gap, rng: np.random.Generator) -> Flight:
    """The flight with rates and forces in a gap that are as `Gap` says, about the mean of its ends."""
    first, last = round(since / flight.dt), round(until / flight.dt) - 1
    rates, forces = flight.rates.copy(), flight.forces.copy()
    stays = math.exp(-flight.dt / gap.alike)
    for samples, size in ((rates, gap.turn_rate), (forces, gap.force)):
        mean = 0.5 * (samples[first - 1] + samples[last])
        own = size * rng.standard_normal(3)
        for k in range(first, last):
            samples[k] = mean + own
            own = stays * own + math.sqrt(1.0 - stays**2) * size * rng.standard_normal(3)
    return carried(flight.dt, flight.pose(0), flight.velocities[0], rates, forces)


def off(chosen: Any, flight: Flight, rng: np.random.Generator) -> Any:
    """A start with an error that either filter foresees: it is drawn in the frame of the vehicle."""
    start = chosen.start
    sigmas = np.repeat(
        [start.tilt, start.velocity, start.position, start.gyro_bias, start.accelerometer_bias], 3
    )
    sigmas[2] = start.yaw
    eta = sigmas * rng.standard_normal(15)
    X = textbook.extended(flight.rotations[0], flight.velocities[0], flight.positions[0])
    X = X @ textbook.group(-eta[:9])
    begun = chosen.begin(0.0, SE3(X[:3, :3], X[:3, 4]), X[:3, 3])
    # Settled, so that its gates are no wider than later.
    return replace(begun, gyro_bias=-eta[9:12], accelerometer_bias=-eta[12:], begun=-10.0)


def heard(log: Log, since: float, until: float, dvl: bool) -> Iterator[Imu | Measurement]:
    """All but what a dead link keeps; the DVL has a line of its own."""
    for message in log.messages():
        lost = since + 1e-6 < message.time < until - 1e-6
        if not (lost and not (dvl and isinstance(message, Dvl))):
            yield message


def squared(
    chosen: Any,
    estimator: Any,
    flight: Flight,
    seed: int,
    gap: tuple[float, float],
    at: list[float],
    dvl: bool,
) -> Array:
    """The normalised error squared at some times, of a flight whose samples are missing for a while."""
    rng = np.random.default_rng(seed)
    start = off(chosen, flight, rng)
    log = sense(flight, Sensors(), rng)
    timeline: Timeline[Any] = Timeline(estimator, start)
    out: list[float] = []
    for message in heard(log, *gap, dvl):
        timeline.take(message)
        if len(out) < len(at) and isinstance(message, Imu) and message.time > at[len(out)] - 1e-6:
            step = round(message.time / flight.dt)
            truth = (log.gyro_biases[step], log.accelerometer_biases[step])
            error = timeline.state.error(flight.pose(step), flight.velocities[step], *truth)
            out.append(float(error @ np.linalg.solve(timeline.state.covariance, error)))
    return np.array(out)


@pytest.mark.few(3)
@pytest.mark.parametrize("chosen", FILTERS, ids=["inekf", "ekf"])
@pytest.mark.parametrize("dvl", [False, True])
def test_after_a_gap_errors_are_as_large_as_the_covariance_says(chosen: Any, dvl: bool) -> None:
    """Where the vehicle moves as `Gap` has it; and a filter that is not told of the gap is found out.

    The textbook's filter is judged before the DVL comes back: so unsure of its attitude, it then believes to
    learn what nothing told it, as after a start that errs by so much.
    """
    gap, seeds = (4.0, 4.7), 16
    at = [4.7, 5.0, 6.0] if isinstance(chosen, InEkf) else [4.7]
    sums, unaware = np.zeros(len(at)), np.zeros(len(at))
    for seed in range(seeds):
        flight = loosened(survey(6.1), *gap, chosen.gap, np.random.default_rng(100 + seed))
        sums += squared(chosen, chosen, flight, seed, gap, at, dvl)
        if seed < 4:
            unaware += squared(chosen, Unaware(chosen), flight, seed, gap, at, dvl)
    # White noise adds up to more than that does which lasts for a while, but not to far more.
    assert (sums < chi2.ppf(0.999, 15 * seeds)).all(), sums / (15 * seeds)
    assert (sums > 0.5 * 15 * seeds).all(), sums / (15 * seeds)
    assert (unaware > 10.0 * chi2.ppf(0.999, 15 * 4)).all(), unaware / (15 * 4)


@pytest.mark.rare
@pytest.mark.parametrize("chosen", FILTERS, ids=["inekf", "ekf"])
def test_a_vehicle_that_sways_errs_no_more_than_it_is_told(chosen: Any) -> None:
    gap, at, seeds = (4.0, 4.7), [4.7, 5.2, 6.0, 8.0], 12
    sums, unaware = np.zeros(len(at)), np.zeros(len(at))
    for seed in range(seeds):
        flight = swaying(seed)
        sums += squared(chosen, chosen, flight, seed, gap, at, True)
        if seed < 4:
            unaware += squared(chosen, Unaware(chosen), flight, seed, gap, at, True)
    limit = chi2.ppf(0.999, 15 * seeds)
    # The textbook's filter is a little too sure where its attitude is off.
    assert (sums < (1.0 if isinstance(chosen, InEkf) else 1.5) * limit).all(), sums / (15 * seeds)
    assert (unaware > 10.0 * chi2.ppf(0.999, 15 * 4)).all(), unaware / (15 * 4)


@pytest.mark.parametrize("chosen", FILTERS, ids=["inekf", "ekf"])
def test_a_bridge_adds_up_as_white_noise_does(chosen: Any) -> None:
    """At rest: a variance of qτ of yaw and of climb, qτ³/3 of height, qτ²/2 between both, and tilts."""
    certain = replace(chosen, start=Start(1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9))
    gap, tau = chosen.gap, 0.7
    turn, push = (2.0 * gap.alike * size**2 for size in (gap.turn_rate, gap.force))
    timeline = Timeline(certain, certain.begin(0.0, SE3.level(0.0, 0.0, 0.0, 0.0)))
    timeline.take(replace(STILL, time=0.01))
    assert timeline.take(replace(STILL, time=0.01 + tau)).verdict is Verdict.BRIDGED
    P = timeline.state.covariance
    assert timeline.state.yaw_sigma**2 == pytest.approx(turn * tau, rel=1e-3)
    # Pieces of a fiftieth of a second make sums of the integrals.
    assert P[5, 5] == pytest.approx(push * tau, rel=1e-3)
    assert P[8, 5] == pytest.approx(push * tau**2 / 2.0, rel=0.05)
    assert P[8, 8] == pytest.approx(push * tau**3 / 3.0, rel=0.07)
    assert P[3, 3] == pytest.approx(push * tau + 9.81**2 * turn * tau**3 / 3.0, rel=0.07)
    assert P[6, 6] == pytest.approx(push * tau**3 / 3.0 + 9.81**2 * turn * tau**5 / 20.0, rel=0.15)
    assert timeline.state.gyro_variance == pytest.approx(gap.turn_rate**2)


def test_a_bridge_is_the_prediction_of_the_textbook_with_other_noise() -> None:
    chosen, rng = FILTERS[0], np.random.default_rng(3)
    pose = SE3(Rotation.from_euler("ZYX", [0.5, 0.2, -0.3]).as_matrix(), rng.uniform(-5.0, 5.0, 3))
    state = chosen.begin(0.0, pose, rng.uniform(-1.0, 1.0, 3))
    imu = Imu(0.02, rng.uniform(-1.0, 1.0, 3), rng.uniform(-2.0, 2.0, 3) + STILL.specific_force)
    root, unit = math.sqrt(2.0 * chosen.gap.alike), chosen.imu
    densities = [
        root * chosen.gap.turn_rate,
        root * chosen.gap.force,
        unit.gyro_walk,
        unit.accelerometer_walk,
    ]
    after = chosen.bridge(state, imu, 0.02)
    X, P = textbook.predict(
        textbook.extended(state.rotation, state.velocity, state.position),
        np.zeros(6),
        state.covariance,
        imu.angular_velocity,
        imu.specific_force,
        0.02,
        np.array(densities),
    )
    np.testing.assert_allclose(
        textbook.extended(after.rotation, after.velocity, after.position), X, atol=1e-12
    )
    np.testing.assert_allclose(after.covariance, P, atol=1e-12)


def bridged(chosen: Any, gap: float) -> Any:
    """The state after some seconds without samples."""
    flight = survey(3.0)
    log = sense(flight, Sensors(), np.random.default_rng(1))
    timeline: Timeline[Any] = Timeline(chosen, chosen.begin(0.0, flight.pose(0), flight.velocities[0]))
    for message in heard(log, 1.5, 1.5 + gap, dvl=False):
        timeline.take(message)
        if isinstance(message, Imu) and message.time > 1.5 + gap - 1e-6:
            break
    return timeline.state


@pytest.mark.parametrize("chosen", FILTERS, ids=["inekf", "ekf"])
def test_a_longer_gap_widens_more_and_none_nothing(chosen: Any) -> None:
    states = [bridged(chosen, gap) for gap in (0.11, 0.2, 0.4, 0.7, 0.99)]
    for shorter, longer in pairwise(states):
        assert longer.yaw_sigma > 1.15 * shorter.yaw_sigma
        assert (np.diag(longer.covariance)[:9] > np.diag(shorter.covariance)[:9]).all()
        values = np.linalg.eigvalsh(longer.position_covariance - shorter.position_covariance)
        assert values.min() > 0.0
    # And a bridge over nothing adds nothing.
    start = bridged(chosen, 0.2)
    for dt in (1e-6, 1e-9):
        plain, wide = chosen.predict(start, STILL, dt), chosen.bridge(start, STILL, dt)
        np.testing.assert_allclose(wide.covariance, plain.covariance, atol=20.0 * dt)
        np.testing.assert_array_equal(wide.position, plain.position)


@pytest.mark.parametrize("kind", [InEkf, Ekf, Cipg, DeadReckoning])
def test_without_a_gap_nothing_is_bridged(kind: Any) -> None:
    """Bit for bit what it was: late reports, single samples that are lost, and all."""
    estimator = kind(mounting=MOUNTING)
    flight = survey(3.0)
    log = sense(flight, Sensors(), np.random.default_rng(1))
    timeline: Timeline[Any] = Timeline(
        Unasked(estimator), estimator.begin(0.0, flight.pose(0), flight.velocities[0])
    )
    messages = sorted(log.messages(), key=lambda m: m.time + (0.173 if isinstance(m, Dvl) else 0.0))
    for k, message in enumerate(messages):
        if not (isinstance(message, Imu) and k % 7 < 3):
            assert timeline.take(message).verdict is not Verdict.BRIDGED
    assert timeline.state.time > 2.9


@pytest.mark.parametrize("kind", [Cipg, DeadReckoning])
def test_estimators_that_tell_no_covariance_bridge_as_they_move(kind: Any) -> None:
    estimator = kind(mounting=MOUNTING)
    state = estimator.begin(0.0, SE3.level(0.0, 0.0, -1.0, 0.3), (0.3, 0.0, 0.0))
    assert not hasattr(state, "covariance")
    moved, bridge = estimator.predict(state, STILL, 0.02), estimator.bridge(state, STILL, 0.02)
    np.testing.assert_array_equal(bridge.position, moved.position)
    np.testing.assert_array_equal(bridge.rotation, moved.rotation)


def test_what_the_dvl_says_within_a_gap_is_taken_in_where_it_was_true() -> None:
    """Whenever within it, and whether it waits for the next sample or comes after that."""
    chosen, flight = FILTERS[0], swaying(0)
    log = sense(flight, Sensors(), np.random.default_rng(2))
    ends = {}
    for name, dvl in (("without", False), ("with", True), ("late", True)):
        timeline: Timeline[Any] = Timeline(chosen, chosen.begin(0.0, flight.pose(0), flight.velocities[0]))
        messages = list(heard(log, 6.0, 6.9, dvl))
        if name == "late":
            messages.sort(key=lambda m: m.time + (0.2 if isinstance(m, Dvl) else 0.0))
        for message in messages:
            if message.time < 6.9 + 1e-6:
                verdict = timeline.take(message).verdict
                assert verdict.taken, (message, verdict)
        ends[name] = timeline.state
    np.testing.assert_allclose(ends["late"].position, ends["with"].position, atol=1e-9)
    truth = flight.positions[690]
    assert np.linalg.norm(ends["with"].position - truth) < 0.05
    sigma = {name: math.sqrt(np.trace(state.position_covariance[:2, :2])) for name, state in ends.items()}
    assert sigma["with"] < 0.3 * sigma["without"]


def test_a_depth_after_a_gap_is_not_found_unlikely() -> None:
    """Half a metre deeper than it would be had it gone on: nothing had said that it would."""
    for chosen in FILTERS:
        settled = replace(chosen.begin(0.0, SE3.level(0.0, 0.0, -2.0, 0.0)), begun=-10.0)
        for estimator, verdict in ((chosen, Verdict.TAKEN), (Unaware(chosen), Verdict.UNLIKELY)):
            timeline: Timeline[Any] = Timeline(estimator, settled)
            timeline.take(replace(STILL, time=0.01))
            timeline.take(replace(STILL, time=0.96))
            deeper = -2.0 + PRESSURE[2] - 0.4
            assert timeline.take(Depth(0.96, deeper, 0.02)).verdict is verdict


@pytest.mark.parametrize("name", ["turn_rate", "force", "alike"])
def test_its_sizes_are_checked(name: str) -> None:
    with pytest.raises(ValueError, match=f"gap.{name}: expected a number above 0"):
        Gap(**{name: 0.0})
