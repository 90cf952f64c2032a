"""The reconstruction of C-IPG against its closed forms: both stages are least squares over the window."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from dream.estimation import Cipg, CipgState, Mounting, Verdict
from dream.estimation._kernels import cipg as kernels
from dream.geometry import SE3
from dream.measurements import Dvl, Heading, Imu
from tests.estimation.flights import DVL, PRESSURE, Flight, Log, Sensors, sense, survey
from tests.estimation.test_dead_reckoning import PERFECT

Array = npt.NDArray[np.float64]

OBSERVER = Cipg(mounting=Mounting(DVL, PRESSURE), samples=12)
GRAVITY = np.array([0.0, 0.0, -9.81])


def wxyz(rotation: Rotation) -> Array:
    x, y, z, w = rotation.as_quat()
    return np.array([w, x, y, z])


def rotation(quaternion: Array) -> Array:
    w, x, y, z = quaternion
    matrix: Array = Rotation.from_quat([x, y, z, w]).as_matrix()
    return matrix


def omega(q: Array) -> Array:
    """(4, 4) with a ⊗ q = Ω(q) a."""
    w, x, y, z = q
    return np.array([[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]])


def some_window(seed: int) -> tuple[kernels.Window, Array]:
    """Twelve samples, some of them without a measurement, and the attitude at the start."""
    rng = np.random.default_rng(seed)
    n = 12
    start = Rotation.from_rotvec(rng.uniform(-1.0, 1.0, 3))
    turns = np.array([wxyz(Rotation.from_rotvec(rng.uniform(-0.2, 0.2, 3))) for _ in range(n)])
    attitudes, at = np.empty((n, 4)), wxyz(start)
    for j in range(n):
        off = wxyz(Rotation.from_rotvec(0.05 * rng.standard_normal(3)))
        attitudes[j] = rng.choice([-1.0, 1.0]) * (omega(off) @ at)
        at = omega(turns[j]) @ at
    window = kernels.Window(
        n,
        turns,
        rng.uniform(-1.0, 1.0, (n, 3)),
        rng.uniform(0.05, 0.2, n),
        attitudes,
        np.arange(n) % 4 != 2,
        rng.uniform(-1.0, 1.0, (n, 3)),
        np.arange(n) % 3 != 1,
    )
    return window, wxyz(start)


def least_squares(window: Any, near: Array) -> tuple[Array, Array]:
    """Start attitude and start velocity by matrices: stacked Φ_j, and stacked R_jᵀ(v + c_j) = y_j."""
    Phi, J, Y, sums = np.eye(4), [], [], np.zeros(4)
    for j in range(window.size):
        if window.has_attitude[j]:
            measured = window.attitudes[j]
            measured = measured if measured @ Phi @ near >= 0.0 else -measured
            J.append(Phi)
            Y.append(measured)
            sums = sums + Phi.T @ measured
        Phi = omega(window.turns[j]) @ Phi
    rows = np.concatenate(J)
    np.testing.assert_allclose(rows.T @ rows, len(J) * np.eye(4), atol=1e-9)
    w = np.linalg.lstsq(rows, np.concatenate(Y), rcond=None)[0]
    np.testing.assert_allclose(w, sums / len(J), atol=1e-12)
    return w / np.linalg.norm(w), least_squares_velocity(window, w / np.linalg.norm(w))


def least_squares_velocity(window: Any, w: Array) -> Array:
    at, added, A, b = w, np.zeros(3), [], []
    for j in range(window.size):
        R = rotation(at)
        if window.has_flow[j]:
            A.append(R.T)
            b.append(window.flows[j] - R.T @ added)
        added = added + GRAVITY * window.spans[j] + R @ window.pushes[j]
        at = omega(window.turns[j]) @ at
    velocity: Array = np.linalg.lstsq(np.concatenate(A), np.concatenate(b), rcond=None)[0]
    return velocity


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("stale", [1 / 12, 1 / 20, 1 / 6])
def test_many_iterations_end_in_the_closed_form_whatever_the_preconditioner(seed: int, stale: float) -> None:
    window, start = some_window(seed)
    near = start + 0.05
    w, v = least_squares(window, start)
    solved, gain = kernels.solve_attitude(window, near, stale, 400, 1.0, 0.5, 0.0)
    np.testing.assert_allclose(solved, w * np.sign(w @ solved), atol=1e-10)
    assert gain == pytest.approx(1.0 / 9.0)
    rotations, added = kernels.coasted(window, w, 9.81)
    solved, gain = kernels.solve_velocity(window, rotations, added, np.ones(3), stale, 400, 1.0, 0.5, 0.0)
    np.testing.assert_allclose(solved, v, atol=1e-10)
    assert gain == pytest.approx(1.0 / 8.0)


def test_one_iteration_is_enough_with_the_right_preconditioner_and_two_are_not_with_a_stale_one() -> None:
    window, _ = some_window(0)
    w, v = least_squares(window, some_window(0)[1])
    rotations, added = kernels.coasted(window, w, 9.81)
    far = v + 1.0
    once, _ = kernels.solve_velocity(window, rotations, added, far, 1 / 8, 1, 1.0, 0.5, 0.0)
    np.testing.assert_allclose(once, v, atol=1e-12)
    stale, _ = kernels.solve_velocity(window, rotations, added, far, 1 / 20, 2, 1.0, 0.5, 0.0)
    assert np.abs(stale - v).max() > 0.03


def test_regularised_it_still_ends_in_the_closed_form() -> None:
    window, _ = some_window(1)
    w, v = least_squares(window, some_window(1)[1])
    rotations, added = kernels.coasted(window, w, 9.81)
    solved, gain = kernels.solve_velocity(window, rotations, added, np.ones(3), 0.1, 400, 1.0, 0.5, 2.0)
    np.testing.assert_allclose(solved, v, atol=1e-10)
    assert gain == pytest.approx(1.0 / 10.0)


def fly(chosen: Cipg, flight: Flight, log: Log) -> list[CipgState]:
    states = [chosen.begin(0.0, flight.pose(0), flight.velocities[0])]
    for k, imu in enumerate(log.imu, start=1):
        state = chosen.predict(states[-1], imu, flight.dt)
        for measurement in log.after.get(k, ()):
            state = chosen.correct(state, measurement)
        states.append(state)
    return states


def test_on_a_flight_every_estimate_is_the_closed_form_of_its_window() -> None:
    flight = survey(12.0)
    log = sense(flight, Sensors(dvl_lost=(4.0, 4.7)), np.random.default_rng(0))
    for state in fly(OBSERVER, flight, log)[10::30]:
        w, v = least_squares(state.window, state.estimate.wxyz)
        np.testing.assert_allclose(state.estimate.wxyz, w, atol=1e-10)
        np.testing.assert_allclose(state.estimate.velocity, v, atol=1e-10)
        assert state.window.size <= OBSERVER.samples


def test_drop_outs_only_remove_rows() -> None:
    """With the same headings, the samples of the window are the same but for what the DVL did not see."""
    flight = survey(3.0)
    everything = sense(flight, Sensors(), np.random.default_rng(1))
    lost = {
        k: [replace(m, valid=not 1.8 <= m.time < 2.5) if isinstance(m, Dvl) else m for m in said]
        for k, said in everything.after.items()
    }
    seen = fly(OBSERVER, flight, everything)[-1]
    blind = fly(OBSERVER, flight, replace(everything, after=lost))[-1]
    np.testing.assert_array_equal(seen.rotation, blind.rotation)
    np.testing.assert_array_equal(seen.window.attitudes, blind.window.attitudes)
    np.testing.assert_allclose(seen.window.pushes, blind.window.pushes, atol=1e-12)
    assert (seen.window.has_flow.sum(), blind.window.has_flow.sum()) == (12, 6)
    kept = blind.window.has_flow
    np.testing.assert_array_equal(seen.window.flows[kept], blind.window.flows[kept])
    without = seen.window._replace(has_flow=kept)
    expected = least_squares_velocity(without, seen.estimate.wxyz)
    np.testing.assert_allclose(blind.estimate.velocity, expected, atol=1e-10)


def test_with_no_row_at_all_it_coasts_on_the_inertial_unit() -> None:
    flight = survey(8.0)
    log = sense(flight, replace(PERFECT, dvl_every=10, dvl_lost=(2.0, 9.0)), np.random.default_rng(0))
    last = fly(replace(OBSERVER, tilt_time=1e9), flight, log)[-1]
    assert last.window.has_flow.sum() == 0
    np.testing.assert_allclose(last.velocity, flight.velocities[-1], atol=1e-4)
    np.testing.assert_allclose(last.position, flight.positions[-1], atol=1e-3)


@pytest.mark.parametrize("samples", [1, 2, 12])
def test_with_perfect_sensors_it_is_exact_however_long_the_window(samples: int) -> None:
    flight = survey(8.0, aggressive=True)
    log = sense(flight, replace(PERFECT, dvl_every=10), np.random.default_rng(0))
    last = fly(replace(OBSERVER, samples=samples, tilt_time=1e9), flight, log)[-1]
    np.testing.assert_allclose(last.rotation, flight.rotations[-1], atol=1e-6)
    np.testing.assert_allclose(last.velocity, flight.velocities[-1], atol=1e-6)
    np.testing.assert_allclose(last.position, flight.positions[-1], atol=1e-5)


def test_a_window_of_one_is_dead_reckoning() -> None:
    """Then the attitude is the measured one, and the velocity what the DVL saw."""
    chosen = replace(OBSERVER, samples=1)
    state = chosen.begin(0.0, SE3.level(0.0, 0.0, -3.0, 0.1), (0.5, 0.0, 0.0))
    imu = Imu(0.01, np.array([0.1, -0.05, 0.2]), np.array([0.3, 0.1, 9.8]))
    for _ in range(20):
        state = chosen.predict(state, imu, 0.01)
    z = np.array([0.4, 0.1, 0.02])
    state = chosen.correct(state, Dvl(0.2, z, 1e-4 * np.eye(3), 2.0, True))
    state = chosen.correct(state, Heading(0.2, 0.5, 0.01))
    assert state.pose.yaw == pytest.approx(0.5)
    own = DVL.rotation @ z + np.cross(DVL.translation, state.gyro)
    np.testing.assert_allclose(state.velocity, state.rotation @ own, atol=1e-12)


def test_the_parameters_must_let_it_converge() -> None:
    with pytest.raises(ValueError, match="samples, iterations: expected at least 1"):
        Cipg(samples=0)
    for bad in ({"step": 1.5}, {"relaxation": 2.0}, {"regularisation": -1.0}):
        with pytest.raises(ValueError, match=r"expected \(0, 1\], \(0, 2\)"):
            Cipg(**bad)  # type: ignore[arg-type]


def test_it_believes_what_a_filter_would_refuse() -> None:
    """No covariance, no gate: to know when comparing."""
    state = OBSERVER.begin(0.0, SE3.level(0.0, 0.0, -3.0, 0.0))
    after = OBSERVER.correct(state, Dvl(0.0, np.full(3, 9.0), 1e-4 * np.eye(3), 2.0, True))
    assert after.outcome is not None
    assert after.outcome.verdict is Verdict.TAKEN
    assert np.linalg.norm(after.velocity) > 10.0
