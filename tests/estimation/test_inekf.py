"""The invariant filter: its equations one by one, what it promises, and what it does on whole flights."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from dream.estimation import InEkf, InEkfState, InertialErrors, Mounting, Source, Start, Verdict
from dream.estimation._kernels import inekf as kernels
from dream.estimation._kernels import kalman
from dream.geometry import SE3
from dream.measurements import Depth, Dvl, Heading, Imu, Measurement
from tests.estimation import textbook
from tests.estimation.flights import DVL, PRESSURE, Flight, Log, Sensors, sense, survey

Array = npt.NDArray[np.float64]

FILTER = InEkf(mounting=Mounting(DVL, PRESSURE))
NOISELESS = replace(FILTER, imu=InertialErrors(0.0, 0.0, 0.0, 0.0))


def some_state(seed: int, chosen: InEkf = FILTER) -> InEkfState:
    """Any attitude but a steep one, any motion, and a covariance with all its correlations."""
    rng = np.random.default_rng(seed)
    yaw, pitch, roll = rng.uniform([-3, -1, -1], [3, 1, 1])
    rotation = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    pose = SE3(rotation, rng.uniform(-20.0, 20.0, 3))
    root = 0.05 * rng.standard_normal((15, 15))
    return replace(
        chosen.begin(0.0, pose, rng.uniform(-1.0, 1.0, 3)),
        gyro_bias=rng.uniform(-0.01, 0.01, 3),
        accelerometer_bias=rng.uniform(-0.1, 0.1, 3),
        covariance=root @ root.T + 1e-4 * np.eye(15),
        gyro=rng.uniform(-0.5, 0.5, 3),
        gyro_variance=1e-4,
        begun=-math.inf,
    )


def some_sample(seed: int) -> Imu:
    rng = np.random.default_rng(1000 + seed)
    return Imu(0.02, rng.uniform(-1.0, 1.0, 3), rng.uniform(-2.0, 2.0, 3) + np.array([0.0, 0.0, 9.8]))


def moved_by(state: InEkfState, xi: Array) -> InEkfState:
    """The state that differs by an error: X = Exp(ξ) X̂, b = b̂ + δb."""
    X = textbook.group(xi[:9]) @ textbook.extended(state.rotation, state.velocity, state.position)
    return replace(
        state,
        rotation=X[:3, :3].copy(),
        velocity=X[:3, 3].copy(),
        position=X[:3, 4].copy(),
        gyro_bias=state.gyro_bias + xi[9:12],
        accelerometer_bias=state.accelerometer_bias + xi[12:],
    )


def difference(truth: InEkfState, state: InEkfState) -> Array:
    return state.error(truth.pose, truth.velocity, truth.gyro_bias, truth.accelerometer_bias)


def fly(chosen: InEkf, state: InEkfState, flight: Flight, log: Log, every: int = 10) -> list[InEkfState]:
    """The states after every so many samples, measurements included, the first one first."""
    states = [state]
    for k, imu in enumerate(log.imu, start=1):
        state = chosen.predict(state, imu, flight.dt)
        for measurement in log.after.get(k, ()):
            state = chosen.correct(state, measurement)
        if k % every == 0:
            states.append(state)
    return states


def unsure(chosen: InEkf, flight: Flight, rng: np.random.Generator) -> InEkfState:
    """A start with errors that are drawn from its own covariance."""
    sigmas = np.sqrt(np.diagonal(chosen.begin(0.0, SE3.level(0.0, 0.0, 0.0, 0.0)).covariance))
    eta = sigmas * rng.standard_normal(15)
    X = textbook.extended(flight.rotations[0], flight.velocities[0], flight.positions[0])
    X = X @ textbook.group(-eta[:9])
    start = chosen.begin(0.0, SE3(X[:3, :3], X[:3, 4]), X[:3, 3])
    return replace(start, gyro_bias=-eta[9:12], accelerometer_bias=-eta[12:])


def squared(state: InEkfState, flight: Flight, log: Log, step: int) -> float:
    """The normalised error squared."""
    truth = (log.gyro_biases[step], log.accelerometer_biases[step])
    error = state.error(flight.pose(step), flight.velocities[step], *truth)
    return float(error @ np.linalg.solve(state.covariance, error))


# --- the equations
# -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_a_prediction_is_that_of_the_textbook(seed: int) -> None:
    state, imu, dt = some_state(seed), some_sample(seed), 0.02
    after = FILTER.predict(state, imu, dt)
    X = textbook.extended(state.rotation, state.velocity, state.position)
    b = np.concatenate([state.gyro_bias, state.accelerometer_bias])
    unit = FILTER.imu
    densities = np.array([unit.gyro_noise, unit.accelerometer_noise, unit.gyro_walk, unit.accelerometer_walk])
    # Densities are taken as large as to count beside the covariance.
    loud = replace(FILTER, imu=InertialErrors(*(300.0 * densities)))
    for chosen, noise in ((FILTER, densities), (loud, 300.0 * densities)):
        after = chosen.predict(state, imu, dt)
        moved, P = textbook.predict(
            X, b, state.covariance, imu.angular_velocity, imu.specific_force, dt, noise
        )
        np.testing.assert_allclose(
            textbook.extended(after.rotation, after.velocity, after.position), moved, atol=1e-12
        )
        np.testing.assert_allclose(after.covariance, P, atol=1e-12)
    assert after.time == pytest.approx(dt)


@pytest.mark.parametrize("seed", range(5))
def test_a_correction_is_that_of_the_textbook(seed: int) -> None:
    state = some_state(seed)
    rng = np.random.default_rng(seed)
    X = textbook.extended(state.rotation, state.velocity, state.position)
    b = np.concatenate([state.gyro_bias, state.accelerometer_bias])
    root = 0.05 * rng.standard_normal((3, 3))
    covariance = root @ root.T + 1e-4 * np.eye(3)
    body = state.rotation.T @ state.velocity + np.cross(state.gyro - state.gyro_bias, DVL.translation)
    z = DVL.rotation.T @ body + 0.05 * rng.standard_normal(3)
    dvl = np.asarray(DVL.rotation, np.float64), np.asarray(DVL.translation, np.float64)
    t, height = np.array(PRESSURE), float(state.position[2]) + 0.1
    yaw = state.pose.yaw + 0.2
    terms = [
        textbook.dvl(X, b, state.gyro, state.gyro_variance, z, covariance, *dvl),
        textbook.depth(X, height, 0.05, t),
        textbook.heading(X, yaw, 0.1),
    ]
    measurements: list[Measurement] = [
        Dvl(0.0, z, covariance, 2.0, True),
        Depth(0.0, height, 0.05),
        Heading(0.0, yaw, 0.1),
    ]
    for measurement, (V, H, N) in zip(measurements, terms, strict=True):
        after = FILTER.correct(state, measurement)
        moved, biases, P, nis = textbook.correct(X, b, state.covariance, V, H, N)
        assert after.outcome is not None
        assert after.outcome.verdict is Verdict.TAKEN
        assert after.outcome.nis == pytest.approx(nis, rel=1e-9)
        pose = textbook.extended(after.rotation, after.velocity, after.position)
        np.testing.assert_allclose(pose, moved, atol=1e-10)
        np.testing.assert_allclose(
            np.concatenate([after.gyro_bias, after.accelerometer_bias]), biases, atol=1e-11
        )
        np.testing.assert_allclose(after.covariance, P, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_errors_move_as_the_covariance_says(seed: int) -> None:
    """Φ by columns: a covariance of e eᵀ becomes (Φ e)(Φ e)ᵀ, and Φ e is where a small error along e ends."""
    state, imu, small = some_state(seed), some_sample(seed), 1e-6

    def off(axis: Array, dt: float) -> float:
        nominal = NOISELESS.predict(replace(state, covariance=np.outer(axis, axis)), imu, dt)
        ahead = NOISELESS.predict(moved_by(state, small * axis), imu, dt)
        behind = NOISELESS.predict(moved_by(state, -small * axis), imu, dt)
        slope = (difference(ahead, nominal) - difference(behind, nominal)) / (2.0 * small)
        return float(np.abs(nominal.covariance - np.outer(slope, slope)).max())

    for axis in np.eye(15)[:9]:
        assert off(axis, 0.02) < 1e-7
    # A bias turns with the vehicle during the sample, which the frozen A leaves out: O(dt²).
    for axis in np.eye(15)[9:]:
        assert off(axis, 0.02) < 0.01
        assert off(axis, 0.005) < off(axis, 0.02) / 12.0 + 1e-7


@pytest.mark.parametrize("seed", range(5))
def test_rows_are_slopes_of_the_innovations(seed: int) -> None:
    """Measured from a truth at Exp(ε e) X̂, without noise, the innovation is ε H e."""
    state, small = some_state(seed), 1e-6
    q = FILTER.compiled
    none, covariance = np.zeros(3), 1e-4 * np.eye(3)

    def seen(truth: InEkfState) -> list[Any]:
        body = truth.rotation.T @ truth.velocity
        body = body + np.cross(truth.gyro - truth.gyro_bias, DVL.translation)
        z = float(truth.position[2] + truth.rotation[2] @ np.array(PRESSURE))
        return [
            kernels.dvl_innovation(q, state.packed, DVL.rotation.T @ body, covariance),
            kernels.depth_innovation(q, state.packed, z, 0.01),
            kernels.heading_innovation(state.packed, truth.pose.yaw, 0.01),
            kernels.rest_innovation(q, replace(state, velocity=state.velocity - truth.velocity).packed),
        ]

    for V, _, _ in seen(state):
        np.testing.assert_allclose(V, none[: len(V)], atol=1e-12)
    for axis in np.eye(15):
        ahead, behind = seen(moved_by(state, small * axis)), seen(moved_by(state, -small * axis))
        for (V, H, _), (V_behind, _, _) in zip(ahead[:3], behind[:3], strict=True):
            np.testing.assert_allclose((V - V_behind) / (2.0 * small), H @ axis, atol=1e-7)
        # At rest: V = −v̂ is the truth's zero less the estimate, where turning about v = 0 does nothing.
        _, H, _ = ahead[3]
        np.testing.assert_allclose(H @ axis, axis[3:6])


def test_the_depth_row_is_the_pseudo_measurement_with_infinite_variance() -> None:
    """Potokar's rows: z = (x̂, ŷ, z), S⁻¹ = Σ − Σ (M + Σ)⁻¹ Σ, Σ = (H P Hᵀ)⁻¹, M = diag(0, 0, 1/σ²)."""
    for seed in range(5):
        state, sigma = some_state(seed), 0.05
        P, at = state.covariance, state.position + state.rotation @ np.array(PRESSURE)
        z = float(at[2]) + 0.2
        H = np.zeros((3, 15))
        H[:, :3], H[:, 6:9] = -textbook.hat(at), np.eye(3)
        inverse = np.linalg.inv(H @ P @ H.T)
        M = np.diag([0.0, 0.0, sigma**-2])
        S = inverse - inverse @ np.linalg.inv(M + inverse) @ inverse
        gain = P @ H.T @ S
        after = FILTER.correct(state, Depth(0.0, z, sigma))
        expected = moved_by(state, gain @ np.array([0.0, 0.0, z - at[2]]))
        np.testing.assert_allclose(difference(expected, after), 0.0, atol=1e-10)
        np.testing.assert_allclose(after.covariance, P - gain @ H @ P, atol=1e-11)


def test_the_covariance_stays_positive_under_a_sensor_that_is_far_too_good() -> None:
    root = np.random.default_rng(5).standard_normal((15, 15))
    state = replace(some_state(0), covariance=1e2 * root @ root.T)
    for _ in range(20):
        state = FILTER.correct(state, Heading(0.0, state.pose.yaw, 1e-5))
        state = FILTER.correct(state, Depth(0.0, float((state.pose @ np.array(PRESSURE))[2]), 1e-5))
        assert state.outcome is not None
        assert state.outcome.verdict is Verdict.TAKEN
    np.testing.assert_array_equal(state.covariance, state.covariance.T)
    values = np.linalg.eigvalsh(state.covariance)
    assert values.min() > -1e-14 * values.max()


# --- what it promises
# ----------------------------------------------------------------------------------------


def test_without_biases_an_error_moves_alike_on_every_trajectory() -> None:
    """Log-linear: whatever the motion, and however large the error, ξ moves by the same constant matrix."""
    xi = np.array([0.9, -0.5, 0.7, 0.4, -0.3, 0.2, 2.0, -1.0, 0.5, 0, 0, 0, 0, 0, 0])
    ends = []
    for seed, aggressive in ((0, False), (1, True)):
        state = some_state(seed, NOISELESS)
        state = replace(state, gyro_bias=np.zeros(3), accelerometer_bias=np.zeros(3))
        truth = moved_by(state, xi)
        flight = survey(8.0, aggressive=aggressive)
        for k in range(flight.steps):
            imu = Imu((k + 1) * flight.dt, flight.rates[k], flight.forces[k])
            state = NOISELESS.predict(state, imu, flight.dt)
            truth = NOISELESS.predict(truth, imu, flight.dt)
        ends.append(difference(truth, state))
    t, gravity = 8.0, textbook.hat(textbook.GRAVITY)
    expected = xi.copy()
    expected[3:6] += t * gravity @ xi[:3]
    expected[6:9] += t * xi[3:6] + 0.5 * t * t * gravity @ xi[:3]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-8)
    # The logarithm of the end is the linear motion of the logarithm of the start.
    np.testing.assert_allclose(ends[0], expected, atol=1e-8)


def test_without_a_heading_yaw_and_place_never_grow_more_certain() -> None:
    """Along a direction d with H d = 0 and Φ d = d, what is known, dᵀ P⁻¹ d, can only be lost."""
    flight = survey(40.0, aggressive=True)
    log = sense(flight, Sensors(has_heading=False), np.random.default_rng(3))
    chosen = replace(FILTER, start=Start(position=0.1))
    states = fly(chosen, unsure(chosen, flight, np.random.default_rng(4)), flight, log, every=10)
    for direction in (2, 6, 7):
        known = np.array([np.linalg.inv(s.covariance)[direction, direction] for s in states])
        assert (np.diff(known) <= 1e-6 * known[:-1]).all()
    # While what can be observed is learnt: roll, pitch, velocity and depth.
    for direction in (0, 1, 3, 4, 5, 8):
        first, last = states[0].covariance, states[-1].covariance
        assert last[direction, direction] < 0.5 * first[direction, direction]
    assert states[-1].yaw_sigma > 0.95 * states[0].yaw_sigma


def test_covariances_are_those_of_position_and_velocity() -> None:
    """Sampled: positions and velocities of Exp(ξ) X̂ with small ξ scatter by them."""
    state = some_state(2)
    state = replace(state, covariance=1e-6 * state.covariance)
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(15), state.covariance, 4000)
    positions = np.array([moved_by(state, xi).position for xi in draws])
    headings = np.array([moved_by(state, xi).pose.yaw for xi in draws])
    expected = state.position_covariance
    np.testing.assert_allclose(np.cov(positions.T), expected, atol=0.1 * expected.max())
    velocities = np.array([moved_by(state, xi).velocity for xi in draws])
    expected = state.velocity_covariance
    np.testing.assert_allclose(np.cov(velocities.T), expected, atol=0.1 * expected.max())
    assert np.std(headings) == pytest.approx(state.yaw_sigma, rel=0.06)


def test_a_start_is_as_certain_as_its_fields_say_wherever_it_is() -> None:
    state = FILTER.begin(0.0, SE3.level(100.0, -50.0, -5.0, 1.0), (0.5, 0.2, 0.0))
    np.testing.assert_allclose(state.position_covariance, FILTER.start.position**2 * np.eye(3), atol=1e-9)
    assert state.yaw_sigma == pytest.approx(FILTER.start.yaw)
    assert state.outcome is None


# --- whole flights
# -------------------------------------------------------------------------------------------


@pytest.mark.rare
def test_errors_are_as_large_as_the_covariance_says() -> None:
    """The mean over seeds of the normalised error squared lies in its 95 % band at nine instants in ten."""
    flight, seeds, every = survey(40.0), 20, 50
    sums = np.zeros(flight.steps // every + 1)
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        start = unsure(FILTER, flight, rng)
        log = sense(flight, Sensors(), rng)
        states = fly(FILTER, start, flight, log, every)
        sums += np.array([squared(state, flight, log, k * every) for k, state in enumerate(states)])
    low, high = chi2.interval(0.95, 15 * seeds)
    assert np.mean((sums > low) & (sums < high)) >= 0.9


def test_a_filter_told_half_the_noise_is_found_out() -> None:
    """The test above can fail: with half the sensors' sigma the errors leave the band."""
    flight, seeds, total = survey(20.0), 6, 0.0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        log = sense(flight, Sensors(dvl_sigma=0.03, heading_told=math.radians(0.5)), rng)
        log.after.update(
            {
                k: [replace(m, covariance=0.25 * m.covariance) if isinstance(m, Dvl) else m for m in said]
                for k, said in log.after.items()
            }
        )
        state = fly(FILTER, unsure(FILTER, flight, rng), flight, log, flight.steps)[-1]
        total += squared(state, flight, log, flight.steps)
    assert total > float(chi2.ppf(0.999, 15 * seeds))


def drift(sensors: Sensors, seed: int) -> float:
    """Horizontal error after five minutes, as a share of the way."""
    flight = survey(300.0)
    rng = np.random.default_rng(seed)
    start = unsure(FILTER, flight, rng)
    last = fly(FILTER, start, flight, sense(flight, sensors, rng), flight.steps)[-1]
    return float(np.linalg.norm((last.position - flight.positions[-1])[:2])) / flight.distance


@pytest.mark.rare
def test_drift_stays_within_half_a_percent_with_the_better_dvl() -> None:
    for seed in range(3):
        sensors = Sensors(gyro_bias=(0.004, -0.003, 0.005), dvl_scale=1.001 if seed % 2 else 0.999)
        assert drift(sensors, seed) <= 0.005


@pytest.mark.rare
def test_a_scale_error_of_the_dvl_is_drift_since_nothing_observes_it() -> None:
    """Straight on, so that it does not cancel; one percent too long is one percent too far, not more."""
    flight = survey(19.0)
    for scale in (0.99, 1.01):
        log = sense(flight, Sensors(dvl_scale=scale), np.random.default_rng(0))
        start = FILTER.begin(0.0, flight.pose(0), flight.velocities[0])
        start = replace(start, rotation=flight.rotations[0])
        last = fly(replace(FILTER, start=Start(yaw=0.01)), start, flight, log, flight.steps)[-1]
        way, gone = flight.positions[-1] - flight.positions[0], last.position - flight.positions[0]
        ratio = float(gone[:2] @ way[:2] / (way[:2] @ way[:2]))
        assert ratio == pytest.approx(scale, abs=0.004)
    for seed, scale in enumerate((0.99, 1.01)):
        assert drift(Sensors(dvl_scale=scale), seed) <= 0.012


def test_it_recovers_from_an_attitude_that_is_30_degrees_off() -> None:
    flight = survey(40.0)
    log = sense(flight, Sensors(), np.random.default_rng(1))
    wide = math.radians(30.0)
    chosen = replace(FILTER, start=Start(tilt=wide, yaw=wide))
    for axis in np.vstack([np.eye(3), -np.eye(3), [[0.6, -0.6, 0.52]]]):
        wrong = Rotation.from_rotvec(wide * axis / np.linalg.norm(axis)).as_matrix() @ flight.rotations[0]
        start = chosen.begin(0.0, SE3(wrong, flight.positions[0]), flight.velocities[0])
        last = fly(chosen, start, flight, log, flight.steps)[-1]
        off = Rotation.from_matrix(last.rotation.T @ flight.rotations[-1]).magnitude()
        assert math.degrees(off) < 0.5
        assert np.linalg.norm(last.velocity - flight.velocities[-1]) < 0.02
        assert np.linalg.norm(last.position - flight.positions[-1]) < 0.3


def test_it_recovers_from_far_worse_as_it_settles_anew_when_it_is_lost() -> None:
    flight = survey(20.0)
    log = sense(flight, Sensors(), np.random.default_rng(1))
    wide = math.radians(30.0)
    chosen = replace(FILTER, start=Start(tilt=wide, yaw=wide))
    for axis in ([1.0, 1.0, 0.0], [-0.3, 0.8, 0.5]):
        wrong = Rotation.from_rotvec(math.radians(75.0) * np.array(axis) / np.linalg.norm(axis)).as_matrix()
        start = chosen.begin(0.0, SE3(wrong @ flight.rotations[0], flight.positions[0]), flight.velocities[0])
        last = fly(chosen, start, flight, log, flight.steps)[-1]
        off = Rotation.from_matrix(last.rotation.T @ flight.rotations[-1]).magnitude()
        assert math.degrees(off) < 2.0


def test_while_it_settles_it_takes_what_it_would_refuse_later_but_not_everything() -> None:
    begun = FILTER.begin(0.0, SE3.level(0.0, 0.0, -3.0, 0.0))
    later = replace(begun, time=FILTER.trust.settling)
    yaw = 2.0 * math.sqrt(chi2.ppf(FILTER.trust.gate, 1)) * begun.yaw_sigma
    assert told(FILTER.correct(begun, Heading(0.0, yaw, 1e-3))) is Verdict.TAKEN
    assert told(FILTER.correct(later, Heading(0.0, yaw, 1e-3))) is Verdict.UNLIKELY
    assert told(FILTER.correct(begun, Heading(0.0, 2.0 * yaw, 1e-3))) is Verdict.UNLIKELY


def test_it_recovers_from_ten_seconds_without_bottom_lock() -> None:
    flight = survey(60.0)
    log = sense(flight, Sensors(dvl_lost=(35.0, 45.0)), np.random.default_rng(2))
    states = fly(FILTER, unsure(FILTER, flight, np.random.default_rng(3)), flight, log, every=10)
    sigma = [math.sqrt(np.trace(s.position_covariance)) for s in states]
    assert sigma[449] > sigma[349]
    before, lost, after = (
        float(np.linalg.norm(states[k].velocity - flight.velocities[10 * k])) for k in (349, 449, 455)
    )
    assert after < max(2.0 * before, 0.02)
    assert lost < 0.5
    assert squared(states[-1], flight, log, flight.steps) < chi2.ppf(0.999, 15)


# --- what is wrong with the sensors
# --------------------------------------------------------------------------


def told(state: InEkfState) -> Verdict:
    assert state.outcome is not None
    return state.outcome.verdict


BAD = [
    (Dvl(0.0, np.zeros(3), np.eye(3) * 1e-4, 2.0, False), Verdict.NO_LOCK),
    (Dvl(0.0, np.array([np.nan, 0.0, 0.0]), np.eye(3) * 1e-4, 2.0, True), Verdict.NOT_FINITE),
    (Dvl(0.0, np.zeros(3), np.full((3, 3), np.inf), 2.0, True), Verdict.NOT_FINITE),
    (Dvl(0.0, np.zeros(2), np.eye(3) * 1e-4, 2.0, True), Verdict.NOT_FINITE),
    (Dvl(0.0, np.zeros(3), np.eye(3) * 1e-4, 0.03, True), Verdict.TOO_CLOSE),
    (Dvl(0.0, np.zeros(3), np.eye(3), 2.0, True), Verdict.TOO_NOISY),
    (Dvl(0.0, np.zeros(3), -np.eye(3), 2.0, True), Verdict.TOO_NOISY),
    (Dvl(0.0, np.full(3, 9.0), np.eye(3) * 1e-4, 2.0, True), Verdict.UNLIKELY),
    (Depth(0.0, math.nan, 0.01), Verdict.NOT_FINITE),
    (Depth(0.0, -3.0, 0.0), Verdict.NOT_FINITE),
    (Depth(0.0, -30.0, 0.01), Verdict.UNLIKELY),
    (Heading(math.inf, 0.0, 0.01), Verdict.NOT_FINITE),
    (Heading(0.0, 2.0, 0.01), Verdict.UNLIKELY),
]


@pytest.mark.parametrize("measurement, verdict", BAD)
def test_what_cannot_be_used_is_refused_by_name_and_changes_nothing(
    measurement: Any, verdict: Verdict
) -> None:
    state = replace(FILTER.begin(0.0, SE3.level(0.0, 0.0, -3.0, 0.0)), begun=-10.0)
    after = FILTER.correct(state, measurement)
    assert told(after) is verdict
    assert not verdict.taken
    for name in set(kernels.State._fields) - {"refused_since"}:
        np.testing.assert_array_equal(getattr(after, name), getattr(state, name))


def test_a_heading_is_refused_where_the_vehicle_stands_on_its_nose() -> None:
    nose_down = Rotation.from_euler("ZYX", [0.3, math.radians(88.0), 0.1]).as_matrix()
    state = FILTER.begin(0.0, SE3(nose_down, np.zeros(3)))
    assert told(FILTER.correct(state, Heading(0.0, 0.3, 0.1))) is Verdict.TOO_STEEP
    assert math.isnan(state.yaw_sigma)
    _, code, _ = kernels.correct_heading(FILTER.compiled, state.packed, 0.3, 0.1)
    assert code == kalman.UNSOUND


@pytest.mark.parametrize("dt", [0.0, -0.01, math.nan, math.inf])
def test_a_sample_needs_a_length(dt: float) -> None:
    state = FILTER.begin(0.0, SE3.level(0.0, 0.0, -3.0, 0.0))
    with pytest.raises(ValueError, match="dt: expected seconds above 0"):
        FILTER.predict(state, Imu(0.01, np.zeros(3), np.zeros(3)), dt)
    with pytest.raises(ValueError, match="imu: expected finite"):
        FILTER.predict(state, Imu(0.01, np.array([0.0, np.nan, 0.0]), np.zeros(3)), 0.01)


def test_a_clipped_gyro_is_trusted_less_and_the_heading_brings_the_yaw_back() -> None:
    flight = survey(30.0, aggressive=True)
    log = sense(flight, Sensors(), np.random.default_rng(0))
    limit = 1.2
    clipped = [replace(imu, angular_velocity=np.clip(imu.angular_velocity, -limit, limit)) for imu in log.imu]
    log = replace(log, imu=clipped)
    start = FILTER.begin(0.0, flight.pose(0), flight.velocities[0])
    knows, ignores = replace(FILTER, imu=InertialErrors(gyro_range=limit)), FILTER
    errors = {}
    for chosen in (knows, ignores):
        states = fly(chosen, start, flight, log, every=10)
        errors[chosen] = max(
            abs(math.remainder(s.pose.yaw - flight.pose(10 * k).yaw, 2.0 * math.pi))
            for k, s in enumerate(states)
        )
    assert math.degrees(errors[knows]) < 10.0
    assert errors[knows] < 0.5 * errors[ignores]


def test_a_dvl_that_stays_refused_is_believed_in_the_end_and_the_covariance_owns_up() -> None:
    state = FILTER.begin(0.0, SE3.level(0.0, 0.0, -3.0, 0.0))
    state = replace(state, covariance=1e-4 * state.covariance, begun=-10.0)
    still, alone = Imu(0.0, np.zeros(3), np.array([0.0, 0.0, 9.81])), replace(FILTER, mounting=Mounting())
    moves = Dvl(0.0, np.array([0.6, 0.0, 0.0]), 1e-4 * np.eye(3), 2.0, True)
    verdicts, times = [], []
    for _ in range(40):
        state = alone.predict(state, still, 0.1)
        before = state
        state = alone.correct(state, moves)
        verdicts.append(told(state))
        times.append(state.time)
        if verdicts[-1] is Verdict.INSISTED:
            break
    assert set(verdicts[:-1]) == {Verdict.UNLIKELY}
    assert FILTER.trust.patience < times[-1] - times[0] < FILTER.trust.patience + 0.25
    assert state.velocity[0] > 0.5
    assert state.yaw_sigma > 2.0 * before.yaw_sigma
    assert state.begun == state.time
    assert told(alone.correct(state, moves)) is Verdict.TAKEN


def test_iron_near_the_compass_is_shut_out() -> None:
    flight = survey(40.0)
    sensors = Sensors(heading_off=(20.0, 30.0, math.radians(25.0)))
    log = sense(flight, sensors, np.random.default_rng(0))
    state = FILTER.begin(0.0, flight.pose(0), flight.velocities[0])
    verdicts: Counter[Verdict] = Counter()
    for k, imu in enumerate(log.imu, start=1):
        state = FILTER.predict(state, imu, flight.dt)
        for measurement in log.after.get(k, ()):
            state = FILTER.correct(state, measurement)
            if isinstance(measurement, Heading) and 20.0 <= measurement.time < 30.0:
                verdicts[told(state)] += 1
    assert verdicts[Verdict.UNLIKELY] > 95
    assert abs(state.pose.yaw - flight.pose(flight.steps).yaw) < math.radians(1.0)


def test_rest_is_believed_only_where_nothing_speaks_against_it() -> None:
    state = FILTER.begin(0.0, SE3.level(0.0, 0.0, -3.0, 0.0))
    state = replace(state, velocity=np.array([0.02, 0.0, 0.0]))
    drifting = Dvl(0.0, np.array([0.2, 0.0, 0.0]), 1e-4 * np.eye(3), 2.0, True)
    still = replace(drifting, velocity=np.zeros(3))
    blind = replace(drifting, valid=False)
    for dvl in (still, blind, None):
        after = FILTER.rest(state, 1.0, dvl)
        assert after.outcome is not None
        assert (after.outcome.source, after.outcome.verdict) == (Source.REST, Verdict.TAKEN)
        assert np.linalg.norm(after.velocity) < np.linalg.norm(state.velocity)
    assert told(FILTER.rest(state, 0.3, still)) is Verdict.MOVING
    assert told(FILTER.rest(state, 1.0, drifting)) is Verdict.MOVING
    assert told(FILTER.rest(replace(state, velocity=np.array([0.2, 0.0, 0.0])), 1.0, None)) is Verdict.MOVING
    assert told(FILTER.rest(replace(state, gyro=np.array([0.0, 0.0, 0.3])), 1.0, None)) is Verdict.MOVING
