"""The correction that all filters with a covariance share."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.estimation._kernels.groups import mul

Float64Array = npt.NDArray[np.float64]

REFUSED, TAKEN, INSISTED, UNSOUND = 0, 1, 2, 3
"""What became of a measurement: beyond the gate; taken; taken since it had been refused for too long; not
possible, as the covariance of the innovation is not positive or something is NaN."""
DVL, DEPTH, OTHER = np.int64(0), np.int64(1), np.int64(-1)
"""Places of sensors in `refused_since`. Of plain numbers each would have a filter compiled for itself."""


@njit(cache=True, nogil=True)
def correct(
    P: Float64Array, H: Float64Array, V: Float64Array, N: Float64Array, limit: float
) -> tuple[int, float, Float64Array, Float64Array]:
    """One gated Kalman correction in Joseph form.

    Args:
        P: (n, n) covariance of the error.
        H: (m, n) how the innovation depends on the error.
        V: (m,) the innovation.
        N: (m, m) its noise.
        limit: Greatest normalised innovation squared Vᵀ S⁻¹ V that is believed.

    Returns:
        What became of it, the normalised innovation squared, the correction (n,) of the state and the new
        covariance. Where it was not taken, the correction is zero and the covariance P itself.
    """
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
def correct_in_time(
    P: Float64Array,
    H: Float64Array,
    V: Float64Array,
    N: Float64Array,
    limit: float,
    time: float,
    refused_since: Float64Array,
    sensor: np.int64,
    patience: float,
) -> tuple[int, float, Float64Array, Float64Array, Float64Array]:
    """As `correct`, but a sensor that has been refused for longer than `patience` seconds is believed.

    Then the filter has been too sure of itself, and would shut the sensor out for good. Its covariance grows
    by the factor by which the innovation is beyond the gate; as all of it grows, nothing is learnt that is
    not observed.

    Args:
        P: As for `correct`, and so are the next four.
        H: As said.
        V: As said.
        N: As said.
        limit: As said.
        time: Now.
        refused_since: Per sensor, the time of the first refusal in a row; NaN where the last was taken.
        sensor: Its place there, or negative for one that is refused as long as it disagrees.
        patience: Seconds.

    Returns:
        What `correct` does, and the new `refused_since`.
    """
    since = refused_since.copy()
    code, nis, step, after = correct(P, H, V, N, limit)
    if sensor < 0:
        return code, nis, step, after, since
    if code == REFUSED and time - since[sensor] > patience:
        code, _, step, after = correct(nis / limit * P, H, V, N, math.inf)
        code = INSISTED if code == TAKEN else code
    if code != REFUSED:
        since[sensor] = math.nan
    elif math.isnan(since[sensor]):
        since[sensor] = time
    return code, nis, step, after, since


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
