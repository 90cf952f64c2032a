"""Kernels that find the fault of a thruster: commands and motion in, which thruster fails and how out.

All take plain numbers, float64 arrays and tuples of those. What is not known of a healthy vehicle is one
vector of `UNKNOWN` numbers: the share of the model's drag along the axes and about them, the current (2) in
the world, the net buoyancy, where the centre of buoyancy lies ahead and to the left, and a force (2) ahead
and to the left that stands for what accelerometers and level read wrong.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.vehicle._kernels import DEAD, JAMMED, WEAK, WEAK_SHARE, thrust

Float64Array = npt.NDArray[np.float64]

UNKNOWN = 9
DRAG, SPIN, EAST, NORTH, LIFT, AHEAD, LEFT, SURGE, SWAY = range(UNKNOWN)
BEATS = 10
"""Of a bin, over which motion and thrust are averaged."""
BINS = 30
"""That are kept, and looked back over at most."""
WINDOWS = np.array([3, 4, 5, 6, 7, 8, 10, 12, 15, 20, 25, 30])
"""Bins that one looks back over: how long ago the fault may have begun."""
LEAST_DRAG, MOST_DRAG = 0.05, 2.0
"""Of the model's."""
UNBELIEVED = 4.0
"""Standard deviations by which the motion may differ before a bin says nothing about what is not known."""
CAUTION = 2.0
"""How much more a bin is taken to err when what is not known is learnt from it: neighbours err alike."""
AGREE = 3
"""Bins running by which the same fault has to be the likeliest: the first one has it only in part."""
FIT = 3.0
"""Mean square, in standard deviations, that a fault may leave unexplained."""

# What a bin holds: `Memory.bins`.
MEASURED, NOISE, THRUST, SLOPES = 0, 6, 12, 20
MOST_THRUSTERS = SLOPES - THRUST
"""What is measured (6), its standard deviations (6), the forces (up to 8), and the slopes (6, UNKNOWN)."""
WIDTH = SLOPES + 6 * UNKNOWN

# What `Memory.clock` holds.
CLOCK = 7
FILLED, COUNT, NAMED, KIND, FORCE, LIKELIEST, AGREED = range(CLOCK)
"""Beats in the open bin, bins that are kept, thruster (−1: none), kind and force of the named one, which
fault was the likeliest one bin ago, and for how many bins running it has been."""

# What `Memory.sums` holds of the open bin, before the forces (n).
SUMS = 12
TURN, PULL, SPEED, DOWN = 0, 3, 6, 9


class Plant(NamedTuple):
    """What is known of a vehicle, and by how much it may be wrong."""

    mass: float
    moments: Float64Array
    """(3,) kg m²."""
    added: Float64Array
    """(6,) kg and kg m²."""
    linear: Float64Array
    """(6,) N s/m and N m s."""
    quadratic: Float64Array
    """(6,) N s²/m² and N m s²."""
    weight: float
    righting: float
    """Metres of the centre of buoyancy above that of gravity."""
    gravity: float
    allocation: Float64Array
    """(6, n) wrench in `base` for one newton of each thruster."""
    commands: Float64Array
    """(K,) the thrust curve: commands, never falling,"""
    roots: Float64Array
    """(K,) and the root of the force with its sign, √N."""
    lag: float
    """Seconds."""
    walk: Float64Array
    """(UNKNOWN,) by how much what is not known changes, standard deviation for a root of a second."""
    floor: Float64Array
    """(6,) N and N m, standard deviation of the noise of a bin."""
    inertia_error: float
    """Share of the added inertia that is wrong."""
    thrust_error: float
    """Share of a thruster's force that is wrong,"""
    lag_error: float
    """and of what it changes by in a bin."""
    gust: float
    """m/s by which the current may change within a window."""
    jam: float
    """N, the least that a jammed thruster does."""
    certain: float
    """Logarithm of the likelihood ratio from which on a fault is believed,"""
    margin: float
    """and by which it must be likelier than the next."""


class Memory(NamedTuple):
    """All that changes: vectors that the loop writes into."""

    clock: Float64Array
    """(CLOCK,) see the names above."""
    force: Float64Array
    """(n,) N of each thruster by its commands."""
    before: Float64Array
    """(n,) mean forces of the bin before, N."""
    gyro: Float64Array
    """(3,) rad/s at the end of the bin before; NaN where it is not known."""
    sums: Float64Array
    """(SUMS + n,) of the open bin: turn rates, specific force, velocity in `base`, the world's up in `base`,
    and forces."""
    mean: Float64Array
    """(UNKNOWN,) what is not known, by its estimate,"""
    covariance: Float64Array
    """(UNKNOWN, UNKNOWN) and how well."""
    bins: Float64Array
    """(BINS, WIDTH) the last ones, as a ring."""
    means: Float64Array
    """(BINS, UNKNOWN) the estimate at the beginning of each,"""
    covariances: Float64Array
    """(BINS, UNKNOWN, UNKNOWN) and how well that was known."""
    pushes: Float64Array
    """(BINS, 6) what the autopilot had learnt by then, see its kernels."""


@njit(cache=True, nogil=True)
def motion(
    plant: Plant,
    unknown: Float64Array,
    rotation: Float64Array,
    velocity: Float64Array,
    rates: Float64Array,
    out: Float64Array,
) -> None:
    """Write the wrench (6) of all but the thrusters on a moving vehicle (Fossen 2011, eq. 8.1 to 8.18).

    Args:
        plant: The vehicle.
        unknown: (UNKNOWN,).
        rotation: (3, 3) `R_world_base`.
        velocity: (3,) m/s over ground in `base`.
        rates: (3,) rad/s in `base`.
        out: (6,) N and N m in `base`, which thrust and inertia have to balance.
    """
    share, spin, east, north, lift = (
        unknown[DRAG],
        unknown[SPIN],
        unknown[EAST],
        unknown[NORTH],
        unknown[LIFT],
    )
    u, v, w = velocity[0], velocity[1], velocity[2]
    p, q, r = rates[0], rates[1], rates[2]
    cu = rotation[0, 0] * east + rotation[1, 0] * north
    cv = rotation[0, 1] * east + rotation[1, 1] * north
    cw = rotation[0, 2] * east + rotation[1, 2] * north
    ur, vr, wr = u - cu, v - cv, w - cw
    added, mass = plant.added, plant.mass
    px, py, pz = added[0] * ur, added[1] * vr, added[2] * wr
    hx = (plant.moments[0] + added[3]) * p
    hy = (plant.moments[1] + added[4]) * q
    hz = (plant.moments[2] + added[5]) * r
    x, y, z = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    buoyancy = plant.weight + lift
    bx, by, bz = unknown[AHEAD], unknown[LEFT], plant.righting
    out[0] = x * lift + unknown[SURGE] - q * (mass * w + pz) + r * (mass * v + py)
    out[1] = y * lift + unknown[SWAY] - r * (mass * u + px) + p * (mass * w + pz)
    out[2] = z * lift - p * (mass * v + py) + q * (mass * u + px)
    out[3] = buoyancy * (by * z - bz * y) - q * hz + r * hy - vr * pz + wr * py
    out[4] = buoyancy * (bz * x - bx * z) - r * hx + p * hz - wr * px + ur * pz
    out[5] = buoyancy * (bx * y - by * x) - p * hy + q * hx - ur * py + vr * px
    out[0] -= added[0] * (q * cw - r * cv)
    out[1] -= added[1] * (r * cu - p * cw)
    out[2] -= added[2] * (p * cv - q * cu)
    out[0] -= share * (plant.linear[0] + plant.quadratic[0] * abs(ur)) * ur
    out[1] -= share * (plant.linear[1] + plant.quadratic[1] * abs(vr)) * vr
    out[2] -= share * (plant.linear[2] + plant.quadratic[2] * abs(wr)) * wr
    out[3] -= spin * (plant.linear[3] + plant.quadratic[3] * abs(p)) * p
    out[4] -= spin * (plant.linear[4] + plant.quadratic[4] * abs(q)) * q
    out[5] -= spin * (plant.linear[5] + plant.quadratic[5] * abs(r)) * r


@njit(cache=True, nogil=True)
def slopes(
    plant: Plant,
    unknown: Float64Array,
    rotation: Float64Array,
    velocity: Float64Array,
    rates: Float64Array,
    spread: Float64Array,
    here: Float64Array,
    out: Float64Array,
) -> None:
    """Write `motion` (6) to `here`, and what it changes by (6, UNKNOWN) with what is not known to `out`.

    That is the slope of a chord over its spread (UNKNOWN): at rest in a current, the tangent to a drag that
    goes with the square of the speed would be none.
    """
    motion(plant, unknown, rotation, velocity, rates, here)
    moved, low, high = unknown.copy(), np.empty(6), np.empty(6)
    for k in range(UNKNOWN):
        moved[k] = unknown[k] + spread[k]
        motion(plant, moved, rotation, velocity, rates, high)
        moved[k] = unknown[k] - spread[k]
        motion(plant, moved, rotation, velocity, rates, low)
        moved[k] = unknown[k]
        for i in range(6):
            out[i, k] = (high[i] - low[i]) / (2.0 * spread[k])


@njit(cache=True, nogil=True)
def absorb(
    mean: Float64Array,
    covariance: Float64Array,
    residual: Float64Array,
    noise: Float64Array,
    slope: Float64Array,
) -> None:
    """Correct what is not known by a bin: a Kalman filter, axis by axis; what is far off is not believed."""
    moved, gain, along = np.zeros(UNKNOWN), np.empty(UNKNOWN), np.empty(UNKNOWN)
    for i in range(6):
        variance, error = (CAUTION * noise[i]) ** 2, residual[i]
        for k in range(UNKNOWN):
            along[k] = 0.0
            for j in range(UNKNOWN):
                along[k] += covariance[k, j] * slope[i, j]
            error -= slope[i, k] * moved[k]
        for k in range(UNKNOWN):
            variance += slope[i, k] * along[k]
        if error * error > UNBELIEVED * UNBELIEVED * variance:
            continue
        for k in range(UNKNOWN):
            gain[k] = along[k] / variance
            moved[k] += gain[k] * error
        for k in range(UNKNOWN):
            for j in range(UNKNOWN):
                covariance[k, j] -= gain[k] * along[j]
    for k in range(UNKNOWN):
        mean[k] += moved[k]
        for j in range(k):
            both = 0.5 * (covariance[k, j] + covariance[j, k])
            covariance[k, j] = covariance[j, k] = both
    for k in (DRAG, SPIN):
        mean[k] = min(max(mean[k], LEAST_DRAG), MOST_DRAG)


@njit(cache=True, nogil=True)
def solve(A: Float64Array, B: Float64Array) -> None:
    """Write A⁻¹ B into B, by elimination with pivots; A is destroyed."""
    n, m = B.shape
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(n):
                A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
            for j in range(m):
                B[k, j], B[pivot, j] = B[pivot, j], B[k, j]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            for j in range(k, n):
                A[i, j] -= factor * A[k, j]
            for j in range(m):
                B[i, j] -= factor * B[k, j]
    for k in range(n - 1, -1, -1):
        for j in range(m):
            for i in range(k + 1, n):
                B[k, j] -= A[k, i] * B[i, j]
            B[k, j] /= A[k, k]


@njit(cache=True, nogil=True)
def compare(plant: Plant, memory: Memory, out: Float64Array, forces: Float64Array) -> None:
    """The likelihood of every fault over that of none, and how well the likeliest fits.

    What a fault of thruster i adds to what is measured lies along its column of the allocation: −f where it
    is dead, −(1 − `WEAK_SHARE`) f where it is weak, J − f where it is jammed and does J: the likeliest that
    is not too little to be a jammed one's.
    What is not known of the vehicle is the same throughout a window, and known before as well as it was then;
    the likelihoods are those of Gaussians without it (generalized least squares).

    Args:
        plant: The vehicle.
        memory: With its bins.
        out: (n, 3) is filled with the greatest logarithm of a likelihood ratio over the windows that a fault
            explains, for each thruster and kind; −∞ where it explains none.
        forces: (n,) is filled with what each would do if it were jammed, N.
    """
    count, n = int(memory.clock[COUNT]), len(memory.force)
    out[:] = -math.inf
    forces[:] = 0.0
    # Sums over the window, in standard deviations: of y (what is measured), H (slopes), and the columns of
    # each thruster, times its force and times one.
    yy, Hy, HH = 0.0, np.zeros(UNKNOWN), np.zeros((UNKNOWN, UNKNOWN))
    ff, fc, cc, fy, cy = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    Hf, Hc = np.zeros((n, UNKNOWN)), np.zeros((n, UNKNOWN))
    A, B = np.empty((UNKNOWN, UNKNOWN)), np.empty((UNKNOWN, UNKNOWN))
    off, inner = np.empty(UNKNOWN), np.empty(UNKNOWN)
    window = 0
    for back in range(1, min(count, BINS) + 1):
        at = (count - back) % BINS
        row = memory.bins[at]
        for i in range(6):
            sure = 1.0 / (row[NOISE + i] * row[NOISE + i])
            y = row[MEASURED + i]
            yy += sure * y * y
            for k in range(UNKNOWN):
                hk = row[SLOPES + UNKNOWN * i + k]
                Hy[k] += sure * hk * y
                for j in range(UNKNOWN):
                    HH[k, j] += sure * hk * row[SLOPES + UNKNOWN * i + j]
            for t in range(n):
                column = plant.allocation[i, t]
                if column == 0.0:
                    continue
                force = row[THRUST + t]
                weight = sure * column
                cc[t] += weight * column
                fc[t] += weight * column * force
                ff[t] += weight * column * force * force
                cy[t] += weight * y
                fy[t] += weight * force * y
                for k in range(UNKNOWN):
                    hk = row[SLOPES + UNKNOWN * i + k]
                    Hc[t, k] += weight * hk
                    Hf[t, k] += weight * force * hk
        if window == len(WINDOWS) or back != WINDOWS[window]:
            continue
        window += 1
        # What is not known, as it was at the beginning, and what may have come to it since.
        known, P = memory.means[at], memory.covariances[at]
        for k in range(UNKNOWN):
            for j in range(UNKNOWN):
                B[k, j] = P[k, j]
            B[k, k] += plant.walk[k] * plant.walk[k] * back * 0.1
        # (P⁻¹ + HᵀH)⁻¹ = (I + P HᵀH)⁻¹ P.
        for k in range(UNKNOWN):
            for j in range(UNKNOWN):
                value = 1.0 if k == j else 0.0
                for m in range(UNKNOWN):
                    value += B[k, m] * HH[m, j]
                A[k, j] = value
        solve(A, B)
        # y less what is expected.
        left = yy
        for k in range(UNKNOWN):
            expected = 0.0
            for j in range(UNKNOWN):
                expected += HH[k, j] * known[j]
            off[k] = Hy[k] - expected
            left += known[k] * (expected - 2.0 * Hy[k])
        for k in range(UNKNOWN):
            inner[k] = 0.0
            for j in range(UNKNOWN):
                inner[k] += B[k, j] * off[j]
            left -= off[k] * inner[k]
        for t in range(n):
            f_y, c_y = fy[t], cy[t]
            f_f, f_c, c_c = ff[t], fc[t], cc[t]
            for k in range(UNKNOWN):
                f_y -= Hf[t, k] * (known[k] + inner[k])
                c_y -= Hc[t, k] * (known[k] + inner[k])
                for j in range(UNKNOWN):
                    f_f -= Hf[t, k] * B[k, j] * Hf[t, j]
                    f_c -= Hf[t, k] * B[k, j] * Hc[t, j]
                    c_c -= Hc[t, k] * B[k, j] * Hc[t, j]
            dead = -f_y - 0.5 * f_f
            lost = 1.0 - WEAK_SHARE
            weak = -lost * f_y - 0.5 * lost * lost * f_f
            jammed, force = -math.inf, 0.0
            for side in (-1.0, 1.0):
                does = side * max(side * (c_y + f_c) / c_c, plant.jam)
                more = does * (c_y + f_c) - 0.5 * does * does * c_c
                if dead + more > jammed:
                    jammed, force = dead + more, does
            for kind, ratio in ((DEAD, dead), (WEAK, weak), (JAMMED, jammed)):
                # A window that begins before the fault says less than a shorter one.
                if left - 2.0 * ratio > FIT * 6 * back:
                    continue
                if ratio > out[t, kind]:
                    out[t, kind] = ratio
                    if kind == JAMMED:
                        forces[t] = force


@njit(cache=True, nogil=True)
def judge(plant: Plant, memory: Memory) -> bool:
    """Write the thruster, the kind and the force of a fault that is certain by the last bins; is one?"""
    n = len(memory.force)
    ratios, forces = np.empty((n, 3)), np.empty(n)
    compare(plant, memory, ratios, forces)
    best, found = -math.inf, -1
    for t in range(n):
        for kind in range(3):
            if ratios[t, kind] > best:
                best, found = ratios[t, kind], 3 * t + kind
    clock = memory.clock
    clock[AGREED] = clock[AGREED] + 1.0 if clock[LIKELIEST] == found else 1.0
    clock[LIKELIEST] = found
    if not (best > plant.certain and clock[AGREED] >= AGREE):
        return False
    for t in range(n):
        for kind in range(3):
            if 3 * t + kind != found and ratios[t, kind] > best - plant.margin:
                return False
    clock[NAMED], clock[KIND], clock[FORCE] = found // 3, found % 3, forces[found // 3]
    return True


@njit(cache=True, nogil=True)
def beat(
    plant: Plant,
    memory: Memory,
    commands: Float64Array,
    gyro: Float64Array,
    pull: Float64Array,
    heard: bool,
    rotation: Float64Array,
    velocity: Float64Array,
    level: float,
    push: Float64Array,
    dt: float,
) -> bool:
    """Take in one beat; was a fault named by it?

    Args:
        plant: The vehicle.
        memory: Changed.
        commands: (n,) that held for the beat.
        gyro: (3,) rad/s in `base` during it, without bias.
        pull: (3,) m/s², the specific force, likewise.
        heard: Was there a sample of the inertial unit?
        rotation: (3, 3) `R_world_base` after it, by the estimate.
        velocity: (3,) m/s over ground in the world, likewise.
        level: Radians, standard deviation of which way is up.
        push: (6,) what the autopilot has learnt.
        dt: Seconds.
    """
    clock, sums, n = memory.clock, memory.sums, len(memory.force)
    kept = math.exp(-dt / plant.lag)
    for t in range(n):
        target = thrust(plant.commands, plant.roots, commands[t])
        lacks = target - memory.force[t]
        # The mean of the beat, exactly for a first-order lag.
        sums[SUMS + t] += target - lacks * (1.0 - kept) * plant.lag / dt
        memory.force[t] = target - lacks * kept
    if clock[NAMED] >= 0.0:
        return False
    for i in range(3):
        sums[TURN + i] += gyro[i]
        sums[PULL + i] += pull[i]
        sums[SPEED + i] += (
            rotation[0, i] * velocity[0] + rotation[1, i] * velocity[1] + rotation[2, i] * velocity[2]
        )
        sums[DOWN + i] += rotation[2, i]
    clock[FILLED] = clock[FILLED] + 1.0 if heard else -BEATS
    if clock[FILLED] < 0.0:
        # Silence: the bin is given up, and the next turn rate follows none.
        clock[FILLED] = 0.0
        sums[:] = 0.0
        memory.gyro[:] = math.nan
        return False
    if clock[FILLED] < BEATS:
        return False
    named = False
    if not math.isnan(memory.gyro[0]):
        named = close(plant, memory, gyro, rotation, level, push, BEATS * dt)
    memory.gyro[:] = gyro
    memory.before[:] = sums[SUMS:] / BEATS
    clock[FILLED] = 0.0
    sums[:] = 0.0
    return named


@njit(cache=True, nogil=True)
def close(
    plant: Plant,
    memory: Memory,
    gyro: Float64Array,
    rotation: Float64Array,
    level: float,
    push: Float64Array,
    seconds: float,
) -> bool:
    """Keep the bin that is full, and judge by it; was a fault named?"""
    sums, n = memory.sums / BEATS, len(memory.force)
    rates, velocity = sums[TURN : TURN + 3], sums[SPEED : SPEED + 3]
    at = int(memory.clock[COUNT]) % BINS
    row = memory.bins[at]
    expected, slope = np.empty(6), np.empty((6, UNKNOWN))
    residual, learnt = np.empty(6), np.empty(6)
    spread = np.empty(UNKNOWN)
    for k in range(UNKNOWN):
        spread[k] = math.sqrt(memory.covariance[k, k])
    slopes(plant, memory.mean, rotation, velocity, rates, spread, expected, slope)
    p, q, r = rates
    u, v, w = velocity
    turned = (q * w - r * v, r * u - p * w, p * v - q * u)
    for i in range(6):
        if i < 3:
            rate = sums[PULL + i] - plant.gravity * sums[DOWN + i] - turned[i]
            inertia = plant.mass + plant.added[i]
        else:
            rate = (gyro[i - 3] - memory.gyro[i - 3]) / seconds
            inertia = plant.moments[i - 3] + plant.added[i]
        thrusts, variance = 0.0, plant.floor[i] * plant.floor[i]
        variance += (plant.inertia_error * plant.added[i] * rate) ** 2
        if i < 2:
            variance += (plant.weight * level) ** 2
        for t in range(n):
            force = sums[SUMS + t]
            thrusts += plant.allocation[i, t] * force
            wrong = (plant.thrust_error * force) ** 2
            wrong += (plant.lag_error * (force - memory.before[t])) ** 2
            variance += plant.allocation[i, t] * plant.allocation[i, t] * wrong
        residual[i] = inertia * rate - expected[i] - thrusts
        row[MEASURED + i] = residual[i]
        learnt[i] = math.sqrt(variance)
        # What a gust changes is learnt, but not at once: a fault is not to be seen in it.
        variance += plant.gust**2 * (slope[i, EAST] ** 2 + slope[i, NORTH] ** 2)
        row[NOISE + i] = math.sqrt(variance)
        for k in range(UNKNOWN):
            # About no estimate at all, so that it may be taken about any.
            row[MEASURED + i] += slope[i, k] * memory.mean[k]
            row[SLOPES + UNKNOWN * i + k] = slope[i, k]
    for t in range(n):
        row[THRUST + t] = sums[SUMS + t]
    for k in range(UNKNOWN):
        memory.covariance[k, k] += plant.walk[k] * plant.walk[k] * seconds
    memory.means[at] = memory.mean
    memory.covariances[at] = memory.covariance
    memory.pushes[at] = push
    absorb(memory.mean, memory.covariance, residual, learnt, slope)
    memory.clock[COUNT] += 1.0
    return judge(plant, memory)


@njit(cache=True, nogil=True)
def forget(memory: Memory) -> None:
    """Look back no farther than now: something touched the vehicle that is no thruster."""
    memory.clock[COUNT] = memory.clock[FILLED] = 0.0
    memory.clock[LIKELIEST], memory.clock[AGREED] = -1.0, 0.0
    memory.gyro[:] = math.nan
    memory.sums[:] = 0.0
