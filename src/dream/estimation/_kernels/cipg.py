"""Steps of the cascaded observer; `dream.estimation.cipg` says what they mean.

A window holds samples, made where a DVL or a heading says something. Between two of them the inertial samples
are integrated once: Δq, Δv and Δt, in the frame of the vehicle at the earlier one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.estimation._kernels.dead_reckoning import levelled, turned
from dream.estimation._kernels.groups import (
    apply,
    cross,
    moved,
    mul,
    normalised,
    quaternion_conjugate,
    quaternion_exp,
    quaternion_from,
    quaternion_product,
    rotation_from,
    so3_integrals,
    wrap,
    yaw_of,
)
from dream.estimation._kernels.sensors import STEEP

Float64Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


class Parameters(NamedTuple):
    """Fields of `dream.estimation.Cipg`, ready for the loops."""

    samples: int
    iterations: int
    step: float
    relaxation: float
    regularisation: float
    tilt_time: float
    depth_share: float
    gravity: float
    dvl_rotation: Float64Array
    dvl_position: Float64Array
    pressure_position: Float64Array


class Window(NamedTuple):
    """The last samples, the oldest first; entries from `size` on mean nothing."""

    size: int
    turns: Float64Array
    """(N, 4) Δq from each sample to the next; that of the last means nothing."""
    pushes: Float64Array
    """(N, 3) Δv, m/s."""
    spans: Float64Array
    """(N,) Δt, seconds."""
    attitudes: Float64Array
    """(N, 4) measured, base to world."""
    has_attitude: BoolArray
    flows: Float64Array
    """(N, 3) measured velocity of the inertial unit over ground, in `base`."""
    has_flow: BoolArray


class Estimate(NamedTuple):
    """What the two stages hold: a start value of the window each, and a preconditioner.

    Both stages have JᵀJ = n I for n rows, so that a preconditioner is a multiple of I, kept as that number.
    """

    wxyz: Float64Array
    velocity: Float64Array
    attitude_gain: float
    velocity_gain: float
    attitude_rows: int
    velocity_rows: int


class State(NamedTuple):
    """What the observer knows."""

    time: float
    rotation: Float64Array
    velocity: Float64Array
    position: Float64Array
    gyro: Float64Array
    """The last sample."""
    reference: Float64Array
    """(3, 3) an attitude of which only roll and pitch are used: the gyro's, levelled by the accelerometer."""
    turn: Float64Array
    """Δq, Δv and Δt since the last sample of the window."""
    push: Float64Array
    span: float
    window: Window
    estimate: Estimate


@njit(cache=True, nogil=True)
def predict(q: Parameters, s: State, gyro: Float64Array, force: Float64Array, dt: float) -> State:
    """Carry the outputs over one inertial sample, and add it to what the window still lacks."""
    whole, once, twice = so3_integrals(dt * gyro)
    velocity, position = moved(s.rotation, s.velocity, s.position, once, twice, force, q.gravity, dt)
    level, _, _ = so3_integrals(dt * (gyro + levelled(s.reference, force, q.tilt_time)))
    return State(
        s.time + dt,
        mul(s.rotation, whole),
        velocity,
        position,
        gyro.copy(),
        mul(s.reference, level),
        normalised(quaternion_product(s.turn, quaternion_exp(dt * gyro))),
        s.push + dt * apply(rotation_from(s.turn), apply(once, force)),
        s.span + dt,
        s.window,
        s.estimate,
    )


@njit(cache=True, nogil=True)
def begun(samples: int) -> Window:
    """A window without samples."""
    return Window(
        0,
        np.zeros((samples, 4)),
        np.zeros((samples, 3)),
        np.zeros(samples),
        np.zeros((samples, 4)),
        np.zeros(samples, np.bool_),
        np.zeros((samples, 3)),
        np.zeros(samples, np.bool_),
    )


@njit(cache=True, nogil=True)
def _opened(q: Parameters, s: State) -> tuple[Window, Estimate]:
    """The window with a sample for this time as its last, and the start values that belong to it."""
    w, e = s.window, s.estimate
    if w.size > 0 and s.span == 0.0:
        return (
            Window(
                w.size,
                w.turns,
                w.pushes,
                w.spans,
                w.attitudes.copy(),
                w.has_attitude.copy(),
                w.flows.copy(),
                w.has_flow.copy(),
            ),
            e,
        )
    new = begun(q.samples)
    if w.size == 0:
        first = Estimate(
            quaternion_from(s.rotation),
            s.velocity.copy(),
            e.attitude_gain,
            e.velocity_gain,
            e.attitude_rows,
            e.velocity_rows,
        )
        return Window(1, *new[1:]), first
    n = w.size
    leaves = 1 if n == q.samples else 0
    for i in range(leaves, n):
        k = i - leaves
        new.turns[k], new.pushes[k], new.spans[k] = w.turns[i], w.pushes[i], w.spans[i]
        new.attitudes[k], new.has_attitude[k] = w.attitudes[i], w.has_attitude[i]
        new.flows[k], new.has_flow[k] = w.flows[i], w.has_flow[i]
    if n > leaves:
        last = n - leaves - 1
        new.turns[last], new.pushes[last], new.spans[last] = s.turn, s.push, s.span
    wxyz, velocity = e.wxyz, e.velocity
    if leaves == 1:  # The start moves on to the next sample.
        alone = n == 1
        turn, push, span = (s.turn, s.push, s.span) if alone else (w.turns[0], w.pushes[0], w.spans[0])
        velocity = velocity + apply(rotation_from(wxyz), push)
        velocity[2] -= q.gravity * span
        wxyz = quaternion_product(wxyz, turn)
    moved = Estimate(wxyz, velocity, e.attitude_gain, e.velocity_gain, e.attitude_rows, e.velocity_rows)
    return Window(n - leaves + 1, *new[1:]), moved


@njit(cache=True, nogil=True)
def rows_of(has: BoolArray, size: int) -> int:
    """How many of the samples in the window have a measurement."""
    rows = 0
    for j in range(size):
        rows += 1 if has[j] else 0
    return rows


@njit(cache=True, nogil=True)
def prefixes(window: Window) -> Float64Array:
    """(n, 4) D_j = Δq_0 ⊗ … ⊗ Δq_{j−1}, so that sample j has the attitude w ⊗ D_j."""
    out = np.empty((window.size, 4))
    out[0] = np.array([1.0, 0.0, 0.0, 0.0])
    for j in range(1, window.size):
        out[j] = normalised(quaternion_product(out[j - 1], window.turns[j - 1]))
    return out


@njit(cache=True, nogil=True)
def solve_attitude(
    window: Window, wxyz: Float64Array, gain: float, iterations: int, step: float, pull: float, beta: float
) -> tuple[Float64Array, float]:
    """Iterations w ← w − δ K Jᵀ(H(w) − Y), with H_j(w) = w ⊗ D_j, and K ← K − α((n + β)K − 1)."""
    D = prefixes(window)
    rows = rows_of(window.has_attitude, window.size)
    alpha = pull / (rows + beta)
    for _ in range(iterations):
        gradient = rows * wxyz
        for j in range(window.size):
            if window.has_attitude[j]:
                back = quaternion_product(window.attitudes[j], quaternion_conjugate(D[j]))
                # q and −q are the same attitude: the nearer one is meant.
                gradient -= back if np.sum(back * wxyz) >= 0.0 else -back
        gain -= alpha * ((rows + beta) * gain - 1.0)
        wxyz = wxyz - step * gain * gradient
    return normalised(wxyz), gain


@njit(cache=True, nogil=True)
def coasted(window: Window, wxyz: Float64Array, gravity: float) -> tuple[Float64Array, Float64Array]:
    """Attitudes (n, 3, 3), and c_j (n, 3): what gravity and force add to the velocity up to sample j."""
    D = prefixes(window)
    rotations, added = np.empty((window.size, 3, 3)), np.zeros((window.size, 3))
    for j in range(window.size):
        rotations[j] = rotation_from(quaternion_product(wxyz, D[j]))
        if j > 0:
            added[j] = added[j - 1] + apply(rotations[j - 1], window.pushes[j - 1])
            added[j, 2] -= gravity * window.spans[j - 1]
    return rotations, added


@njit(cache=True, nogil=True)
def solve_velocity(
    window: Window,
    rotations: Float64Array,
    added: Float64Array,
    velocity: Float64Array,
    gain: float,
    iterations: int,
    step: float,
    pull: float,
    beta: float,
) -> tuple[Float64Array, float]:
    """The same for the velocity v at the start, with H_j(v) = R_jᵀ(v + c_j)."""
    rows = rows_of(window.has_flow, window.size)
    alpha = pull / (rows + beta)
    for _ in range(iterations):
        gradient = rows * velocity
        for j in range(window.size):
            if window.has_flow[j]:
                gradient += added[j] - apply(rotations[j], window.flows[j])
        gain -= alpha * ((rows + beta) * gain - 1.0)
        velocity = velocity - step * gain * gradient
    return velocity, gain


@njit(cache=True, nogil=True)
def _solved(q: Parameters, s: State, window: Window, e: Estimate) -> State:
    """Both stages, and the outputs at the last sample."""
    wxyz, velocity = e.wxyz, e.velocity
    attitude_gain, attitude_rows = e.attitude_gain, rows_of(window.has_attitude, window.size)
    if attitude_rows > 0:
        attitude_gain = _rescaled(attitude_gain, e.attitude_rows, attitude_rows)
        wxyz, attitude_gain = solve_attitude(
            window, wxyz, attitude_gain, q.iterations, q.step, q.relaxation, q.regularisation
        )
    rotations, added = coasted(window, wxyz, q.gravity)
    velocity_gain, velocity_rows = e.velocity_gain, rows_of(window.has_flow, window.size)
    if velocity_rows > 0:
        velocity_gain = _rescaled(velocity_gain, e.velocity_rows, velocity_rows)
        velocity, velocity_gain = solve_velocity(
            window,
            rotations,
            added,
            velocity,
            velocity_gain,
            q.iterations,
            q.step,
            q.relaxation,
            q.regularisation,
        )
    estimate = Estimate(wxyz, velocity, attitude_gain, velocity_gain, attitude_rows, velocity_rows)
    return State(
        s.time,
        rotations[window.size - 1].copy(),
        velocity + added[window.size - 1],
        s.position,
        s.gyro,
        s.reference,
        np.array([1.0, 0.0, 0.0, 0.0]),
        np.zeros(3),
        0.0,
        window,
        estimate,
    )


@njit(cache=True, nogil=True)
def _rescaled(gain: float, rows_before: int, rows: int) -> float:
    """A preconditioner for another number of rows; 1/n where there was none."""
    return 1.0 / rows if rows_before == 0 else gain * rows_before / rows


@njit(cache=True, nogil=True)
def correct_dvl(
    q: Parameters, s: State, velocity: Float64Array, covariance: Float64Array
) -> tuple[State, int, float]:
    """A row of the second stage; the covariance is not looked at."""
    window, estimate = _opened(q, s)
    window.flows[window.size - 1] = apply(q.dvl_rotation, velocity) + cross(q.dvl_position, s.gyro)
    window.has_flow[window.size - 1] = True
    return _solved(q, s, window, estimate), 1, math.nan


@njit(cache=True, nogil=True)
def correct_depth(q: Parameters, s: State, z: float, sigma: float) -> tuple[State, int, float]:
    """Draw the height by a share towards what the pressure says."""
    position = s.position.copy()
    position[2] += q.depth_share * (z - position[2] - apply(s.rotation, q.pressure_position)[2])
    after = State(
        s.time,
        s.rotation,
        s.velocity,
        position,
        s.gyro,
        s.reference,
        s.turn,
        s.push,
        s.span,
        s.window,
        s.estimate,
    )
    return after, 1, math.nan


@njit(cache=True, nogil=True)
def correct_heading(q: Parameters, s: State, yaw: float, sigma: float) -> tuple[State, int, float]:
    """A row of the first stage: this yaw, with roll and pitch of the reference."""
    if s.reference[0, 0] ** 2 + s.reference[1, 0] ** 2 < STEEP:
        return s, 3, math.nan
    window, estimate = _opened(q, s)
    attitude = turned(s.reference, wrap(yaw - yaw_of(s.reference)))
    window.attitudes[window.size - 1] = quaternion_from(attitude)
    window.has_attitude[window.size - 1] = True
    return _solved(q, s, window, estimate), 1, math.nan
