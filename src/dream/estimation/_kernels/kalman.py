"""The correction that the Kalman filters share: a gate, its patience, and Joseph's form.

A filter says what a measurement has to do with its error (`Innovation`), and moves its state by the step that
comes back (`Correction`); which error that is, is its own affair.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.estimation._kernels.groups import mul
from dream.estimation._kernels.sensors import Parameters, gate

Float64Array = npt.NDArray[np.float64]

REFUSED, TAKEN, INSISTED, UNSOUND = 0, 1, 2, 3
"""What became of a measurement: beyond the gate; taken; taken since it had been refused for too long; not
possible, as the covariance of the innovation is not positive or something is NaN."""
DVL, DEPTH, OTHER = np.int64(0), np.int64(1), np.int64(-1)
"""Places of sensors in `refused_since`. Of plain numbers each would have a filter compiled for itself."""


class Innovation(NamedTuple):
    """What a measurement says beyond what was expected: V = H error + noise, to first order."""

    V: Float64Array
    """(m,)"""
    H: Float64Array
    """(m, n) of an error (n,)."""
    N: Float64Array
    """(m, m) covariance of the noise."""


class Correction(NamedTuple):
    """What a filter makes of an innovation."""

    code: int
    """What became of it."""
    nis: float
    """Normalised innovation squared Vᵀ S⁻¹ V; NaN where S is not sound."""
    step: Float64Array
    """(n,) by which the error is known to differ from zero; zero where the measurement is not taken."""
    covariance: Float64Array
    """(n, n) after it; the one before it where the measurement is not taken."""
    begun: float
    """The new `begun` of the state."""
    refused_since: Float64Array
    """The new `refused_since` of the state."""


@njit(cache=True, nogil=True)
def correction(q: Parameters, s: Any, innovation: Innovation, sensor: np.int64) -> Correction:
    """How the state of a filter is to be corrected.

    A sensor that has been refused for longer than `patience` is believed: the filter has been too sure of
    itself, and would shut it out for good. The covariance grows by the factor by which the innovation is
    beyond the gate; as all of it grows, nothing is learnt that is not observed.

    Args:
        q: Parameters.
        s: The state, of any filter.
        innovation: Of a measurement of the state's own time.
        sensor: Its place in `refused_since`, or negative for one that is refused as long as it disagrees.
    """
    limit = gate(q, len(innovation.V), s.time - s.begun)
    since = s.refused_since.copy()
    code, nis, step, P = joseph(s.covariance, innovation, limit)
    if sensor >= 0:
        if code == REFUSED and s.time - since[sensor] > q.patience:
            code, _, step, P = joseph(nis / limit * s.covariance, innovation, math.inf)
            code = INSISTED if code == TAKEN else code
        if code != REFUSED:
            since[sensor] = math.nan
        elif math.isnan(since[sensor]):
            since[sensor] = s.time
    return Correction(code, nis, step, P, s.time if code == INSISTED else s.begun, since)


@njit(cache=True, nogil=True)
def joseph(
    P: Float64Array, innovation: Innovation, limit: float
) -> tuple[int, float, Float64Array, Float64Array]:
    """One gated Kalman correction in Joseph's form.

    Args:
        P: (n, n) covariance of the error.
        innovation: What is measured.
        limit: Greatest normalised innovation squared that is believed.

    Returns:
        The first four of `Correction`.
    """
    V, H, N = innovation
    n, m = P.shape[0], len(V)
    B = np.zeros((n, m))
    for i in range(n):
        for k in range(n):
            for j in range(m):
                B[i, j] += P[i, k] * H[j, k]
    S = N.copy()
    for i in range(m):
        for k in range(n):
            for j in range(m):
                S[i, j] += H[i, k] * B[k, j]
    inverse, sound = _inverse(S)
    nis = 0.0
    for i in range(m):
        for j in range(m):
            nis += V[i] * inverse[i, j] * V[j]
    if not (sound and math.isfinite(nis)):
        return UNSOUND, math.nan, np.zeros(n), P
    if nis > limit:
        return REFUSED, nis, np.zeros(n), P
    K = np.zeros((n, m))
    for i in range(n):
        for k in range(m):
            for j in range(m):
                K[i, j] += B[i, k] * inverse[k, j]
    step = np.zeros(n)
    for i in range(n):
        for j in range(m):
            step[i] += K[i, j] * V[j]

    # (I − K H) P, then its product with (I − K H)ᵀ, and K N Kᵀ.
    left = P.copy()
    for i in range(n):
        for j in range(m):
            for k in range(n):
                left[i, k] -= K[i, j] * B[k, j]
    seen = np.zeros((n, m))
    for i in range(n):
        for k in range(n):
            for j in range(m):
                seen[i, j] += left[i, k] * H[j, k]
    for i in range(n):
        for j in range(m):
            for k in range(m):
                seen[i, j] -= K[i, k] * N[k, j]
    for i in range(n):
        for k in range(n):
            for j in range(m):
                left[i, k] -= seen[i, j] * K[k, j]
    for i in range(n):
        for k in range(i):
            left[i, k] = left[k, i] = 0.5 * (left[i, k] + left[k, i])
    return TAKEN, nis, step, left


@njit(cache=True, nogil=True)
def _inverse(S: Float64Array) -> tuple[Float64Array, bool]:
    """The inverse of a symmetric matrix by Cholesky, and whether it is positive definite."""
    m = len(S)
    L = np.zeros((m, m))
    for i in range(m):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total / L[j, j]
            elif total > 0.0 and total < math.inf:
                L[i, i] = math.sqrt(total)
            else:  # NaN comes here too.
                return np.full((m, m), math.nan), False
    below = np.zeros((m, m))
    for j in range(m):
        below[j, j] = 1.0 / L[j, j]
        for i in range(j + 1, m):
            total = 0.0
            for k in range(j, i):
                total -= L[i, k] * below[k, j]
            below[i, j] = total / L[i, i]
    out = np.zeros((m, m))
    for i in range(m):
        for j in range(m):
            for k in range(max(i, j), m):
                out[i, j] += below[k, i] * below[k, j]
    return out, True


@njit(cache=True, nogil=True)
def spread(P: Float64Array, J: Float64Array) -> Float64Array:
    """(m, m) J P Jᵀ: the covariance of what depends on an error by J (m, n)."""
    return mul(J, mul(P, J.T))


@njit(cache=True, nogil=True)
def floored(covariance: Float64Array, floor: float) -> Float64Array:
    """(3, 3) with no variance under floor²; more on the diagonal keeps it positive."""
    out = covariance.copy()
    for i in range(len(out)):
        out[i, i] = max(out[i, i], floor * floor)
    return out
