"""Kernels of the sensors of motion.

States are the vectors of `dream.sim.vehicle`: position (3) in the world, wxyz (4), velocity (3) and turn
rates (3) in `base`. Each kernel draws the same number of random numbers whatever it sees.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.sim._kernels import Index, cast
from dream.sim.vehicle._kernels import rotation

Float64Array = npt.NDArray[np.float64]

IMU, DVL, DEPTH, COMPASS = range(4)
"""Places in `outage.SENSORS`."""


class Inertial(NamedTuple):
    """`InertialUnit`, as the kernels take it."""

    gyro_noise: float
    gyro_walk: float
    accel_noise: float
    accel_walk: float
    gyro_range: float
    accel_range: float
    gravity: float


class Acoustic(NamedTuple):
    """`DopplerLog`, as the kernels take it."""

    position: Float64Array
    """(3,) of its origin, in `base`."""
    mounting: Float64Array
    """(3, 3) `R_base_dvl`."""
    beams: Float64Array
    """(4, 3) unit vectors along the beams, in its own frame."""
    min_altitude: float
    max_altitude: float
    max_incidence: float
    max_speed: float
    dropout: float
    beam_noise: float
    latency: float
    latency_spread: float
    sound_speed: float


class Pressure(NamedTuple):
    """`PressureGauge`, as the kernels take it."""

    position: Float64Array
    noise: float
    walk: float
    resolution: float
    max_depth: float


class Magnetic(NamedTuple):
    """`Compass`, as the kernels take it."""

    noise: float
    wander: float
    wander_time: float
    steel: Float64Array
    """(K, 6) positions and moments of pieces of steel."""


@njit(cache=True, nogil=True)
def _turned(a: Float64Array, b: Float64Array) -> tuple[float, float, float]:
    """The rotation vector from attitude to attitude of two states, in the `base` of the first."""
    w = a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6]
    i = a[3] * b[4] - a[4] * b[3] - a[5] * b[6] + a[6] * b[5]
    j = a[3] * b[5] - a[5] * b[3] - a[6] * b[4] + a[4] * b[6]
    k = a[3] * b[6] - a[6] * b[3] - a[4] * b[5] + a[5] * b[4]
    if w < 0.0:
        w, i, j, k = -w, -i, -j, -k
    sine = math.sqrt(i * i + j * j + k * k)
    factor = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, w) / sine
    return factor * i, factor * j, factor * k


@njit(cache=True, nogil=True)
def inertial(
    unit: Inertial,
    before: Float64Array,
    after: Float64Array,
    dt: float,
    bias: Float64Array,
    rng: np.random.Generator,
    out: Float64Array,
) -> bool:
    """Write the mean turn rate (3) and specific force (3) between two states into `out`; is one saturated?

    They are those constants that carry a strapdown integration from `before` to `after`. The bias (6) walks
    on.
    """
    px, py, pz = _turned(before, after)
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation(before)
    s00, s01, s02, s10, s11, s12, s20, s21, s22 = rotation(after)
    ax = s00 * after[7] + s01 * after[8] + s02 * after[9]
    ay = s10 * after[7] + s11 * after[8] + s12 * after[9]
    az = s20 * after[7] + s21 * after[8] + s22 * after[9]
    ax = (ax - (r00 * before[7] + r01 * before[8] + r02 * before[9])) / dt
    ay = (ay - (r10 * before[7] + r11 * before[8] + r12 * before[9])) / dt
    az = (az - (r20 * before[7] + r21 * before[8] + r22 * before[9])) / dt + unit.gravity
    fx = r00 * ax + r10 * ay + r20 * az
    fy = r01 * ax + r11 * ay + r21 * az
    fz = r02 * ax + r12 * ay + r22 * az

    # The inverse of SO(3)'s left Jacobian: the force of a sample is seen from the whole turn.
    square = px * px + py * py + pz * pz
    if square < 1e-8:
        factor = 1.0 / 12.0
    else:
        angle = math.sqrt(square)
        factor = 1.0 / square - 0.5 * math.cos(0.5 * angle) / (angle * math.sin(0.5 * angle))
    cx, cy, cz = py * fz - pz * fy, pz * fx - px * fz, px * fy - py * fx
    out[0], out[1], out[2] = px / dt, py / dt, pz / dt
    out[3] = fx - 0.5 * cx + factor * (py * cz - pz * cy)
    out[4] = fy - 0.5 * cy + factor * (pz * cx - px * cz)
    out[5] = fz - 0.5 * cz + factor * (px * cy - py * cx)

    root = math.sqrt(dt)
    saturated = False
    for i in range(6):
        noise = unit.gyro_noise if i < 3 else unit.accel_noise
        walk = unit.gyro_walk if i < 3 else unit.accel_walk
        most = unit.gyro_range if i < 3 else unit.accel_range
        bias[i] += walk * root * rng.standard_normal()
        value = out[i] + bias[i] + noise / root * rng.standard_normal()
        out[i] = min(max(value, -most), most)
        saturated = saturated or abs(value) > most
    return saturated


@njit(cache=True, nogil=True)
def ping(
    log: Acoustic,
    index: Index,
    x: Float64Array,
    scale: float,
    rng: np.random.Generator,
    velocity: Float64Array,
    covariance: Float64Array,
    ranges: Float64Array,
) -> tuple[float, float, bool]:
    """One ping: write velocity (3), its covariance (3, 3) and the beams' ranges (4); altitude, delay, valid.

    A lost beam has a range of NaN. Where the ping is not valid, velocity and covariance are NaN; where no
    beam came back, so is the altitude.
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation(x)
    lx, ly, lz = log.position[0], log.position[1], log.position[2]
    ex = x[0] + r00 * lx + r01 * ly + r02 * lz
    ey = x[1] + r10 * lx + r11 * ly + r12 * lz
    ez = x[2] + r20 * lx + r21 * ly + r22 * lz
    u = x[7] + x[11] * lz - x[12] * ly
    v = x[8] + x[12] * lx - x[10] * lz
    w = x[9] + x[10] * ly - x[11] * lx

    # Normal equations of the beams that came back: n vx.. = b.
    n00 = n01 = n02 = n11 = n12 = n22 = b0 = b1 = b2 = 0.0
    altitude = farthest = 0.0
    count = 0
    for beam in range(4):
        luck, error = rng.random(), rng.standard_normal()
        d0, d1, d2 = log.beams[beam, 0], log.beams[beam, 1], log.beams[beam, 2]
        M = log.mounting
        dx = M[0, 0] * d0 + M[0, 1] * d1 + M[0, 2] * d2
        dy = M[1, 0] * d0 + M[1, 1] * d1 + M[1, 2] * d2
        dz = M[2, 0] * d0 + M[2, 1] * d1 + M[2, 2] * d2
        distance, cosine = cast(
            index,
            ex,
            ey,
            ez,
            r00 * dx + r01 * dy + r02 * dz,
            r10 * dx + r11 * dy + r12 * dz,
            r20 * dx + r21 * dy + r22 * dz,
            log.max_altitude / -d2,
        )
        ranges[beam] = math.nan
        height = -d2 * distance
        if not log.min_altitude <= height <= log.max_altitude:
            continue
        faint = (height / log.max_altitude) ** 4
        slant = min(math.acos(min(cosine, 1.0)) / log.max_incidence, 1.0) ** 4
        if luck >= (1.0 - log.dropout) * (1.0 - faint) * (1.0 - slant):
            continue
        ranges[beam] = distance
        altitude += height
        farthest = max(farthest, distance)
        count += 1
        along = (dx * u + dy * v + dz * w) * (1.0 + scale) + log.beam_noise * error
        n00 += d0 * d0
        n01 += d0 * d1
        n02 += d0 * d2
        n11 += d1 * d1
        n12 += d1 * d2
        n22 += d2 * d2
        b0 += d0 * along
        b1 += d1 * along
        b2 += d2 * along
    delay = (
        max(log.latency + log.latency_spread * rng.standard_normal(), 0.0) + 2.0 * farthest / log.sound_speed
    )
    velocity[:] = math.nan
    covariance[:] = math.nan
    if count == 0:
        return math.nan, delay, False
    altitude /= count
    if count < 3:
        return altitude, delay, False

    c00, c01, c02 = n11 * n22 - n12 * n12, n02 * n12 - n01 * n22, n01 * n12 - n02 * n11
    c11, c12, c22 = n00 * n22 - n02 * n02, n01 * n02 - n00 * n12, n00 * n11 - n01 * n01
    det = n00 * c00 + n01 * c01 + n02 * c02
    v0 = (c00 * b0 + c01 * b1 + c02 * b2) / det
    v1 = (c01 * b0 + c11 * b1 + c12 * b2) / det
    v2 = (c02 * b0 + c12 * b1 + c22 * b2) / det
    if v0 * v0 + v1 * v1 + v2 * v2 > log.max_speed * log.max_speed:
        return altitude, delay, False
    velocity[0], velocity[1], velocity[2] = v0, v1, v2
    square = log.beam_noise * log.beam_noise / det
    covariance[0, 0], covariance[1, 1], covariance[2, 2] = square * c00, square * c11, square * c22
    covariance[0, 1] = covariance[1, 0] = square * c01
    covariance[0, 2] = covariance[2, 0] = square * c02
    covariance[1, 2] = covariance[2, 1] = square * c12
    return altitude, delay, True


@njit(cache=True, nogil=True)
def ping_rate(tops: Float64Array, rates: Float64Array, altitude: float) -> float:
    """Pings a second: of the first range mode that reaches the altitude; of the last for NaN."""
    for mode in range(len(tops)):
        if altitude <= tops[mode]:
            return float(rates[mode])
    return float(rates[-1])


@njit(cache=True, nogil=True)
def pressure(
    gauge: Pressure, x: Float64Array, dt: float, error: Float64Array, rng: np.random.Generator
) -> float:
    """Height in the world by water pressure, dt after the last; the error (2: metres, share) drifts on."""
    _, _, _, _, _, _, r20, r21, r22 = rotation(x)
    at = gauge.position
    z = x[2] + r20 * at[0] + r21 * at[1] + r22 * at[2]
    error[0] += gauge.walk * math.sqrt(dt) * rng.standard_normal()
    # In air there is no pressure to read, and beyond its range it reads the end of it.
    read = min(z, 0.0) * (1.0 + error[1]) + error[0] + gauge.noise * rng.standard_normal()
    return float(gauge.resolution * round(max(read, -gauge.max_depth) / gauge.resolution))


@njit(cache=True, nogil=True)
def heading(
    compass: Magnetic, x: Float64Array, dt: float, error: Float64Array, rng: np.random.Generator
) -> float:
    """Yaw by the horizontal field, dt after the last, in (−π, π].

    The error (4) is a constant offset, what wanders (radians both), and the iron that the vehicle carries,
    ahead and to the left, as a share of the horizontal field. What wanders goes on by dt.
    """
    r00, _, _, r10, _, _, _, _, _ = rotation(x)
    kept = math.exp(-dt / compass.wander_time)
    error[1] = kept * error[1] + compass.wander * math.sqrt(1.0 - kept * kept) * rng.standard_normal()
    east, north = 0.0, 1.0
    for k in range(len(compass.steel)):
        sx, sy, sz, mx, my, mz = compass.steel[k]
        dx, dy, dz = x[0] - sx, x[1] - sy, x[2] - sz
        square = max(dx * dx + dy * dy + dz * dz, 0.25)
        cube = square * math.sqrt(square)
        along = 3.0 * (mx * dx + my * dy + mz * dz) / square
        east += (along * dx - mx) / cube
        north += (along * dy - my) / cube
    yaw = math.atan2(r10, r00)
    c, s = math.cos(yaw), math.sin(yaw)
    ahead = c * east + s * north + error[2]
    left = c * north - s * east + error[3]
    read = (
        0.5 * math.pi - math.atan2(left, ahead) + error[0] + error[1] + compass.noise * rng.standard_normal()
    )
    return float(math.pi - (math.pi - read) % (2.0 * math.pi))


@njit(cache=True, nogil=True)
def silent(outages: Float64Array, sensor: int, time: float) -> bool:
    """Is it in an outage? They are rows of sensor, begin and end."""
    out = False
    for k in range(len(outages)):
        out = out or (outages[k, 0] == sensor and outages[k, 1] <= time < outages[k, 2])
    return out


@njit(cache=True, nogil=True)
def burst(means: Float64Array, time: float, chain: Float64Array, rng: np.random.Generator) -> bool:
    """Is it silent by then? The chain (2) is its state, 0 or 1, and when that ends; it is carried on."""
    if means[0] == math.inf:
        return False
    while chain[1] <= time:
        chain[0] = 1.0 - chain[0]
        chain[1] += means[int(chain[0])] * rng.standard_exponential()
    return bool(chain[0] == 1.0)
