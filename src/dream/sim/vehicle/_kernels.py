"""Kernels of the vehicle: thrust, the equations of motion, the current and contact.

All take plain numbers, float64 arrays and tuples of those. A state is one vector of 13 + n numbers for n
thrusters: position (3) in the world, attitude wxyz (4), velocity (3) and turn rates (3) in `base`, and the
force (n) that each thruster gives.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.sim._kernels import PAD, Index, room
from dream.vehicle._kernels import thrust

Float64Array = npt.NDArray[np.float64]

MOTION = 13
"""Numbers of a state before the thrusters."""
RELEASE = 0.02
"""Metres that a body must get away from what it touched before touching it again is another collision."""


class Body(NamedTuple):
    """A hull with its thrusters and tether, as `Vehicle.body` makes it."""

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
    buoyancy: float
    """N, wholly under water."""
    buoyancy_centre: Float64Array
    """(3,) in `base`."""
    height: float
    allocation: Float64Array
    """(6, n) wrench in `base` for one newton of each thruster."""
    lag: float
    """Seconds."""
    commands: Float64Array
    """(K,) the thrust curve: commands, never falling."""
    roots: Float64Array
    """(K,) and the root of the force with its sign, √N."""
    line_drag: float
    """½ ρ C_d d of the tether, kg/m²; 0 without one."""
    line_at: Float64Array
    """(3,) where it is fixed, in `base`."""


class Flow(NamedTuple):
    """A current, as `Current.flow` makes it."""

    mean: Float64Array
    """(3,) m/s in the world, at height `level`."""
    shear: Float64Array
    """(3,) 1/s: more of it per metre of height."""
    level: float
    gust: float
    """m/s: the deviation of either horizontal axis."""
    gust_time: float
    """Seconds."""


@njit(cache=True, nogil=True)
def rotation(x: Float64Array) -> tuple[float, float, float, float, float, float, float, float, float]:
    """`R_world_base` of a state, row by row, whatever the length of its quaternion."""
    w, i, j, k = x[3], x[4], x[5], x[6]
    s = 2.0 / (w * w + i * i + j * j + k * k)
    return (
        1.0 - s * (j * j + k * k),
        s * (i * j - w * k),
        s * (i * k + w * j),
        s * (i * j + w * k),
        1.0 - s * (i * i + k * k),
        s * (j * k - w * i),
        s * (i * k - w * j),
        s * (j * k + w * i),
        1.0 - s * (i * i + j * j),
    )


@njit(cache=True, nogil=True)
def _line_force(
    body: Body, flow: Flow, gust: Float64Array, z: float, vx: float, vy: float
) -> tuple[float, float]:
    """Horizontal drag of the tether on the vehicle, whose end of it moves at (vx, vy) over ground."""
    fx = fy = 0.0
    # Two points of Gauss: exact for a line that is towed, and for one that hangs in an even current.
    for part in (0.5 - math.sqrt(1.0 / 12.0), 0.5 + math.sqrt(1.0 / 12.0)):
        above = part * z - flow.level
        ux = part * vx - (flow.mean[0] + flow.shear[0] * above + gust[0])
        uy = part * vy - (flow.mean[1] + flow.shear[1] * above + gust[1])
        drag = 0.5 * part * body.line_drag * -z * math.hypot(ux, uy)
        fx -= drag * ux
        fy -= drag * uy
    return fx, fy


@njit(cache=True, nogil=True)
def rates(
    body: Body,
    flow: Flow,
    gust: Float64Array,
    pull: Float64Array,
    targets: Float64Array,
    x: Float64Array,
    out: Float64Array,
) -> None:
    """Write the time derivative of state x into `out` (Fossen 2011, eq. 8.1 to 8.18).

    The rigid body moves over ground, the added mass and the drag through the water. With both masses
    diagonal in `base`, the Coriolis terms are the cross products of Kirchhoff's equations.

    Args:
        body: The vehicle.
        flow: The current.
        gust: (2,) what it is more than its mean.
        pull: (3,) N in the world, on the end of the tether.
        targets: (n,) N that the thrusters tend to.
        x: (13 + n,) the state.
        out: (13 + n,).
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation(x)
    z = x[2]
    u, v, w = x[7], x[8], x[9]
    p, q, r = x[10], x[11], x[12]
    thrusters = len(targets)

    wx = r00 * u + r01 * v + r02 * w
    wy = r10 * u + r11 * v + r12 * w
    out[0], out[1], out[2] = wx, wy, r20 * u + r21 * v + r22 * w
    a, b, c, d = x[3], x[4], x[5], x[6]
    out[3] = 0.5 * (-b * p - c * q - d * r)
    out[4] = 0.5 * (a * p + c * r - d * q)
    out[5] = 0.5 * (a * q + d * p - b * r)
    out[6] = 0.5 * (a * r + b * q - c * p)

    # Water, in base; and the velocity through it.
    above = z - flow.level
    ex = flow.mean[0] + flow.shear[0] * above + gust[0]
    ey = flow.mean[1] + flow.shear[1] * above + gust[1]
    ez = flow.mean[2] + flow.shear[2] * above
    cu = r00 * ex + r10 * ey + r20 * ez
    cv = r01 * ex + r11 * ey + r21 * ez
    cw = r02 * ex + r12 * ey + r22 * ez
    ur, vr, wr = u - cu, v - cv, w - cw

    # Thrust.
    fx = fy = fz = mx = my = mz = 0.0
    for i in range(thrusters):
        force = x[MOTION + i]
        fx += body.allocation[0, i] * force
        fy += body.allocation[1, i] * force
        fz += body.allocation[2, i] * force
        mx += body.allocation[3, i] * force
        my += body.allocation[4, i] * force
        mz += body.allocation[5, i] * force
        out[MOTION + i] = (targets[i] - force) / body.lag

    # Weight at the origin, buoyancy above it; what has come out of the water does not float.
    bx, by, bz = body.buoyancy_centre[0], body.buoyancy_centre[1], body.buoyancy_centre[2]
    under = 0.5 - (z + r20 * bx + r21 * by + r22 * bz) / body.height
    buoyancy = body.buoyancy * min(max(under, 0.0), 1.0)
    lift = buoyancy - body.weight
    fx += r20 * lift
    fy += r21 * lift
    fz += r22 * lift
    mx += buoyancy * (by * r22 - bz * r21)
    my += buoyancy * (bz * r20 - bx * r22)
    mz += buoyancy * (bx * r21 - by * r20)

    # The tether.
    tx, ty, tz = pull[0], pull[1], pull[2]
    lx, ly, lz = body.line_at[0], body.line_at[1], body.line_at[2]
    if body.line_drag > 0.0 and z < 0.0:
        au, av, aw = u + q * lz - r * ly, v + r * lx - p * lz, w + p * ly - q * lx
        line_x, line_y = _line_force(
            body, flow, gust, z, r00 * au + r01 * av + r02 * aw, r10 * au + r11 * av + r12 * aw
        )
        tx += line_x
        ty += line_y
    gx = r00 * tx + r10 * ty + r20 * tz
    gy = r01 * tx + r11 * ty + r21 * tz
    gz = r02 * tx + r12 * ty + r22 * tz
    fx += gx
    fy += gy
    fz += gz
    mx += ly * gz - lz * gy
    my += lz * gx - lx * gz
    mz += lx * gy - ly * gx

    # Momentum of body and water (Coriolis), drag, and the water that turns past as the body turns.
    added = body.added
    mass = body.mass
    px, py, pz = added[0] * ur, added[1] * vr, added[2] * wr
    fx -= q * (mass * w + pz) - r * (mass * v + py)
    fy -= r * (mass * u + px) - p * (mass * w + pz)
    fz -= p * (mass * v + py) - q * (mass * u + px)
    hx = (body.moments[0] + added[3]) * p
    hy = (body.moments[1] + added[4]) * q
    hz = (body.moments[2] + added[5]) * r
    mx -= q * hz - r * hy + vr * pz - wr * py
    my -= r * hx - p * hz + wr * px - ur * pz
    mz -= p * hy - q * hx + ur * py - vr * px
    fx -= (body.linear[0] + body.quadratic[0] * abs(ur)) * ur + added[0] * (q * cw - r * cv)
    fy -= (body.linear[1] + body.quadratic[1] * abs(vr)) * vr + added[1] * (r * cu - p * cw)
    fz -= (body.linear[2] + body.quadratic[2] * abs(wr)) * wr + added[2] * (p * cv - q * cu)
    mx -= (body.linear[3] + body.quadratic[3] * abs(p)) * p
    my -= (body.linear[4] + body.quadratic[4] * abs(q)) * q
    mz -= (body.linear[5] + body.quadratic[5] * abs(r)) * r
    out[7] = fx / (mass + added[0])
    out[8] = fy / (mass + added[1])
    out[9] = fz / (mass + added[2])
    out[10] = mx / (body.moments[0] + added[3])
    out[11] = my / (body.moments[1] + added[4])
    out[12] = mz / (body.moments[2] + added[5])


@njit(cache=True, nogil=True)
def advance(
    body: Body,
    flow: Flow,
    gust: Float64Array,
    pull: Float64Array,
    commands: Float64Array,
    dt: float,
    x: Float64Array,
) -> bool:
    """Carry state x on by one step of Runge and Kutta's fourth order; False where it is finite no more.

    Commands (n,), gust and pull hold for the step.
    """
    size = len(x)
    thrusters = size - MOTION
    targets = np.empty(thrusters)
    for i in range(thrusters):
        targets[i] = thrust(body.commands, body.roots, commands[i])
    slopes = np.empty((4, size))
    at = np.empty(size)
    rates(body, flow, gust, pull, targets, x, slopes[0])
    for stage in range(1, 4):
        part = dt if stage == 3 else 0.5 * dt
        for i in range(size):
            at[i] = x[i] + part * slopes[stage - 1, i]
        rates(body, flow, gust, pull, targets, at, slopes[stage])
    total = 0.0
    for i in range(size):
        x[i] += dt / 6.0 * (slopes[0, i] + 2.0 * slopes[1, i] + 2.0 * slopes[2, i] + slopes[3, i])
        total += abs(x[i])
    length = math.sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5] + x[6] * x[6])
    for i in range(3, 7):
        x[i] /= length
    return math.isfinite(total)


@njit(cache=True, nogil=True)
def stir(flow: Flow, dt: float, rng: np.random.Generator, gust: Float64Array) -> None:
    """Carry the gust (2,) on by dt: the Ornstein-Uhlenbeck process, exactly."""
    if flow.gust == 0.0:
        return
    kept = math.exp(-dt / flow.gust_time)
    fresh = flow.gust * math.sqrt(1.0 - kept * kept)
    gust[0] = kept * gust[0] + fresh * rng.standard_normal()
    gust[1] = kept * gust[1] + fresh * rng.standard_normal()


@njit(cache=True, nogil=True)
def _free(index: Index, radius: float, height: float, x: float, y: float, z: float) -> bool:
    """Does a level cylinder about (x, y, z) touch nothing?"""
    return bool(room(index, x, y, z - 0.5 * height, z + 0.5 * height, radius + PAD) > radius)


@njit(cache=True, nogil=True)
def _stop(body: Body, x: Float64Array, nx: float, ny: float, nz: float) -> None:
    """Take away the velocity against a unit normal, by an impulse along it on the body and its added mass."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation(x)
    a = r00 * nx + r10 * ny + r20 * nz
    b = r01 * nx + r11 * ny + r21 * nz
    c = r02 * nx + r12 * ny + r22 * nz
    into = a * x[7] + b * x[8] + c * x[9]
    if into >= 0.0:
        return
    ea, eb, ec = (
        a / (body.mass + body.added[0]),
        b / (body.mass + body.added[1]),
        c / (body.mass + body.added[2]),
    )
    impulse = -into / (a * ea + b * eb + c * ec)
    x[7] += impulse * ea
    x[8] += impulse * eb
    x[9] += impulse * ec


@njit(cache=True, nogil=True)
def hold(
    body: Body,
    index: Index,
    radius: float,
    height: float,
    before: Float64Array,
    x: Float64Array,
    contact: Float64Array,
) -> bool:
    """Keep state x, a step after `before`, out of all that is solid; is there contact?

    Where the body touches something it slides along it, or stays in a corner, and loses the velocity towards
    it. One that touched something before it ever was free can only rise. Contact (3) is how often one began;
    whether it lasts; and whether the body has not been free yet.
    """
    if _free(index, radius, height, x[0], x[1], x[2]):
        contact[2] = 0.0
        if contact[1] != 0.0 and _free(index, radius + RELEASE, height + 2.0 * RELEASE, x[0], x[1], x[2]):
            contact[1] = 0.0
        return False
    bx, by, bz = before[0], before[1], before[2]
    if contact[1] == 0.0:
        contact[0] += 1.0
        contact[1] = 1.0
        contact[2] = 0.0 if _free(index, radius, height, bx, by, bz) else 1.0
    z = x[2]
    if contact[2] != 0.0:
        r = rotation(x)
        up = max(r[6] * x[7] + r[7] * x[8] + r[8] * x[9], 0.0)
        x[0], x[1], x[2] = bx, by, max(z, bz)
        x[7], x[8], x[9] = r[6] * up, r[7] * up, r[8] * up
        return True

    blocked = True
    if not _free(index, radius, height, x[0], x[1], bz):
        # The way out is the slope of the room about where it still was free.
        low, high, eps = bz - 0.5 * height, bz + 0.5 * height, 1e-3
        far = radius + math.hypot(x[0] - bx, x[1] - by) + 2.0 * eps
        nx = room(index, bx + eps, by, low, high, far) - room(index, bx - eps, by, low, high, far)
        ny = room(index, bx, by + eps, low, high, far) - room(index, bx, by - eps, low, high, far)
        length = math.hypot(nx, ny)
        moved = False
        if length > 0.0:
            nx, ny = nx / length, ny / length
            dx, dy = x[0] - bx, x[1] - by
            into = min(dx * nx + dy * ny, 0.0)
            x[0], x[1] = bx + dx - into * nx, by + dy - into * ny
            moved = _free(index, radius, height, x[0], x[1], bz)
            _stop(body, x, nx, ny, 0.0)
        if not moved:
            x[0], x[1] = bx, by
            x[7] = x[8] = x[9] = 0.0
        blocked = not _free(index, radius, height, x[0], x[1], z)
    if blocked:
        _stop(body, x, 0.0, 0.0, 1.0 if z < bz else -1.0)
        x[2] = bz
    return True
