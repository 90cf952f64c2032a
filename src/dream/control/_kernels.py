"""Kernels of the autopilot: reference, the paper's law, velocity loop, disturbance, allocation, health.

All take plain numbers, float64 arrays and tuples of those. What a controller remembers is one vector of
`MEMORY` numbers: the reference's position (3) in the world and its yaw, its velocity (3) and yaw rate, what
pushes the vehicle by the controller's estimate: a force (3) in the world and a yawing moment, and the shares
of the model's drag that it turned out to have, along and in yaw.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.vehicle._kernels import command

Float64Array = npt.NDArray[np.float64]

MEMORY = 14
MOST_DRAG = 1.5
"""Of the model's, that it can learn."""
LEAST_SHARE = 0.1
"""Of the model's drag by which a push is turned into a current: with less, any push would be a torrent."""
FINE, BLIND, LOST, DIVERGED, STALE = range(5)
"""See `health.Condition`."""
CLIMBING = 2.0
"""1/s: m/s² for a m/s that the way up is too slow. What is read of the pressure lags half a second behind."""
CATCHING_UP = 0.7
"""1/s²: m/s² for a metre that it is behind."""
SLOW = 0.5
"""Share of its speeds at which a vehicle goes that is blind."""


class Gains(NamedTuple):
    """Fields of `autopilot.Autopilot`, ready for the loops."""

    position: float
    velocity: float
    disturbance: float
    yaw: float
    yaw_rate: float
    yaw_disturbance: float
    level: float
    level_rate: float
    drag_share: float
    drag_learning: float
    speed: float
    acceleration: float
    turn_rate: float
    turn_acceleration: float
    ascent: float


class Nominal(NamedTuple):
    """The vehicle that the controller believes to drive; see `dream.vehicle`."""

    inertia: Float64Array
    """(6,) kg and kg m², with added mass."""
    linear: Float64Array
    """(6,) N s/m and N m s."""
    quadratic: Float64Array
    """(6,) N s²/m² and N m s²."""
    lift: float
    """N, upwards, of the vehicle left alone."""
    sharing: Float64Array
    """(n, 6) newtons of each thruster for one unit of each axis: the pseudo-inverse of the allocation."""
    commands: Float64Array
    """(K,) the thrust curve: commands, never falling."""
    roots: Float64Array
    """(K,) and the root of the force with its sign, √N."""
    least: Float64Array
    """(n,) N that may be asked of each thruster, the hardest astern,"""
    most: Float64Array
    """(n,) and the hardest ahead."""
    held: Float64Array
    """(n,) N of each thruster that stand against what a jammed one does; 0 where none is."""


class Limits(NamedTuple):
    """Fields of `health.Watch`, ready for the loops."""

    stale: float
    blind: float
    lost: float
    velocity_sigma: float
    position_sigma: float


@njit(cache=True, nogil=True)
def wrapped(angle: float) -> float:
    """The same direction in [−π, π)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@njit(cache=True, nogil=True)
def into_body(yaw: float, east: float, north: float) -> tuple[float, float]:
    """A horizontal vector ahead and to the left: R(ψ̂)ᵀ of Eq. 9, e_p = R(ψ̂)ᵀ (p* − p̂)."""
    c, s = math.cos(yaw), math.sin(yaw)
    return c * east + s * north, -s * east + c * north


@njit(cache=True, nogil=True)
def track(error: float, velocity: float, reference_velocity: float, gain: float, damping: float) -> float:
    """The paper's law along one axis: u and v of Eq. 10, K_p e_p − K_d v̂, and r of Eq. 11, k_ψ ψ̃ − k_r r̂.

    Args:
        error: Metres or radians that it lacks.
        velocity: m/s or rad/s, by the estimate.
        reference_velocity: m/s or rad/s of what is followed, which is added; 0 for a goal at rest.
        gain: 1/s, K_p or k_ψ.
        damping: Share of the velocity that is taken off, K_d or k_r.
    """
    return reference_velocity + gain * error - damping * velocity


@njit(cache=True, nogil=True)
def begin(position: Float64Array, yaw: float, drag_share: float) -> Float64Array:
    """(MEMORY,) of a controller whose reference stands there; nothing pushes as far as it knows."""
    memory = np.zeros(MEMORY)
    memory[:3] = position
    memory[3] = yaw
    memory[12] = memory[13] = drag_share
    return memory


@njit(cache=True, nogil=True)
def approach(gap: float, speed: float, top: float, acceleration: float, dt: float) -> float:
    """Speed one step later on the way over a gap ≥ 0 that ends at rest: a trapezoid in time, no overshoot."""
    # The fastest speed from which braking in steps of dt still ends within the gap.
    step = 0.5 * acceleration * dt
    fastest = math.sqrt(step * step + 2.0 * acceleration * gap) - step
    wanted = min(top, fastest, gap / dt)
    return min(max(wanted, speed - acceleration * dt), speed + acceleration * dt)


@njit(cache=True, nogil=True)
def guide(
    memory: Float64Array, goal: Float64Array, gains: Gains, pace: float, dt: float
) -> tuple[float, float, float, float]:
    """Carry the reference on towards the goal (x, y, z, yaw), on a straight line where it starts at rest.

    Args:
        memory: Its reference is changed.
        goal: (4,) metres in the world, and radians.
        gains: With the limits of speed and acceleration.
        pace: Share of these speeds that is allowed.
        dt: Seconds.

    Returns:
        Accelerations of the reference: three in the world, and in yaw.
    """
    dx, dy, dz = goal[0] - memory[0], goal[1] - memory[1], goal[2] - memory[2]
    gap = math.sqrt(dx * dx + dy * dy + dz * dz)
    vx = vy = vz = 0.0
    if gap > 1e-9:
        nx, ny, nz = dx / gap, dy / gap, dz / gap
        along = max(memory[4] * nx + memory[5] * ny + memory[6] * nz, 0.0)
        speed = approach(gap, along, pace * gains.speed, gains.acceleration, dt)
        vx, vy, vz = speed * nx, speed * ny, speed * nz
    ax, ay, az = (vx - memory[4]) / dt, (vy - memory[5]) / dt, (vz - memory[6]) / dt
    hard = math.sqrt(ax * ax + ay * ay + az * az)
    # A goal that moves aside turns the velocity no faster than that, either.
    if hard > 1.5 * gains.acceleration and gap > 1e-6:
        part = gains.acceleration / hard
        ax, ay, az = part * ax, part * ay, part * az
        vx, vy, vz = memory[4] + ax * dt, memory[5] + ay * dt, memory[6] + az * dt
    memory[0] += vx * dt
    memory[1] += vy * dt
    memory[2] += vz * dt
    memory[4], memory[5], memory[6] = vx, vy, vz

    turn = wrapped(goal[3] - memory[3])
    side = 1.0 if turn >= 0.0 else -1.0
    rate = side * approach(abs(turn), side * memory[7], pace * gains.turn_rate, gains.turn_acceleration, dt)
    spin = (rate - memory[7]) / dt
    memory[7] = rate
    memory[3] = wrapped(memory[3] + rate * dt)
    return ax, ay, az, spin


@njit(cache=True, nogil=True)
def righting(
    roll: float, pitch: float, rates: Float64Array, gains: Gains, nominal: Nominal
) -> tuple[float, float]:
    """Moments in roll and pitch, N m, that bring a vehicle back to level."""
    return (
        -nominal.inertia[3] * (gains.level * roll + gains.level_rate * rates[0]),
        -nominal.inertia[4] * (gains.level * pitch + gains.level_rate * rates[1]),
    )


@njit(cache=True, nogil=True)
def drag_of(linear: float, quadratic: float, speed: float) -> float:
    """Force against a speed through the water along one axis."""
    return (linear + quadratic * abs(speed)) * speed


@njit(cache=True, nogil=True)
def speed_of(linear: float, quadratic: float, force: float, top: float) -> float:
    """The inverse of `drag_of`, up to a top speed."""
    size = abs(force)
    if quadratic > 0.0:
        speed = (math.sqrt(linear * linear + 4.0 * quadratic * size) - linear) / (2.0 * quadratic)
    else:
        speed = size / linear if linear > 0.0 else 0.0
    return math.copysign(min(speed, top), force)


@njit(cache=True, nogil=True)
def wrench(
    memory: Float64Array,
    acceleration: tuple[float, float, float, float],
    rotation: Float64Array,
    position: Float64Array,
    velocity: Float64Array,
    rates: Float64Array,
    gains: Gains,
    nominal: Nominal,
) -> tuple[Float64Array, Float64Array, tuple[float, float]]:
    """The wrench in `base` that follows the reference, and what the velocities lack.

    What they lack is the paper's law (Eq. 9 to 11) about the reference, with all of the velocity taken off:
    K_d = k_r = 1. The law's gain is the same along all axes, so that R(ψ̂)ᵀ of Eq. 9 may come last.

    Args:
        memory: With the reference.
        acceleration: Of the reference.
        rotation: (3, 3) `R_world_base` by the estimate.
        position: (3,) metres in the world, by the estimate.
        velocity: (3,) m/s over ground in the world, by the estimate.
        rates: (3,) rad/s in `base`.
        gains: Of the loops.
        nominal: The vehicle.

    Returns:
        (6,) N and N m in `base`; (4,) m/s in the world and rad/s that are lacking; and these times the
        model's drag, along and in yaw, in watts: above 0 where it drags more than believed.
    """
    error, wanted, out, along_drag = np.empty(4), np.empty(3), np.empty(6), 0.0
    for i in range(3):
        # Eq. 10, in the world: v_r + K_p (p_r − p̂) − v̂.
        error[i] = track(memory[i] - position[i], velocity[i], memory[4 + i], gains.position, 1.0)
        # What Eq. 10 asks for changes at v̇_r + K_p (v_r − v̂); to that comes what is lacking of it.
        wanted[i] = (
            acceleration[i] + gains.position * (memory[4 + i] - velocity[i]) + gains.velocity * error[i]
        )
    for i in range(3):
        along = speed = push = lack = 0.0
        # Eq. 9: from the world into the body.
        for j in range(3):
            along += rotation[j, i] * wanted[j]
            speed += rotation[j, i] * memory[4 + j]
            push += rotation[j, i] * memory[8 + j]
            lack += rotation[j, i] * error[j]
        # Of the reference's speed, not the vehicle's: fed back, a drag that is too large by the model would
        # drive instead of slow.
        linear, quadratic = nominal.linear[i], nominal.quadratic[i]
        drag = drag_of(linear, quadratic, speed)
        if i < 2:
            # What pushes it level is taken for a current. Drag is of the way through that, of which standing
            # still in it is in the push already.
            water = speed_of(linear, quadratic, push / max(memory[12], LEAST_SHARE), gains.speed)
            drag = drag_of(linear, quadratic, speed - water) + drag_of(linear, quadratic, water)
        out[i] = nominal.inertia[i] * along + memory[12] * drag - push - rotation[2, i] * nominal.lift
        along_drag += drag * lack
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    pitch = -math.asin(min(max(rotation[2, 0], -1.0), 1.0))
    out[3], out[4] = righting(roll, pitch, rates, gains, nominal)
    r, yaw = memory[7], math.atan2(rotation[1, 0], rotation[0, 0])
    # Eq. 11: r_r + k_ψ ψ̃ − r̂, and how fast that changes, as above.
    error[3] = track(wrapped(memory[3] - yaw), rates[2], r, gains.yaw, 1.0)
    spin = acceleration[3] + gains.yaw * (r - rates[2]) + gains.yaw_rate * error[3]
    drag = drag_of(nominal.linear[5], nominal.quadratic[5], r)
    out[5] = nominal.inertia[5] * spin + memory[13] * drag - memory[11]
    return out, error, (along_drag, drag * error[3])


@njit(cache=True, nogil=True)
def blame(
    memory: Float64Array,
    error: Float64Array,
    power: tuple[float, float],
    gains: Gains,
    nominal: Nominal,
    dt: float,
) -> None:
    """What the velocities fall short of, a push explains, or a drag that is not the model's.

    The push is held in the world, where a current stays. Drag comes and goes with the reference: taken for a
    push, it would have to be unlearnt while braking, and carry the vehicle beyond its goal.
    """
    mass = 0.5 * (nominal.inertia[0] + nominal.inertia[1])
    memory[8] -= gains.disturbance * mass * error[0] * dt
    memory[9] -= gains.disturbance * mass * error[1] * dt
    memory[10] -= gains.disturbance * nominal.inertia[2] * error[2] * dt
    memory[11] -= gains.yaw_disturbance * nominal.inertia[5] * error[3] * dt
    # The gradient, in such units that at top speed it acts `drag_learning` times as fast as the push.
    top = drag_of(nominal.linear[0], nominal.quadratic[0], gains.speed)
    spin = drag_of(nominal.linear[5], nominal.quadratic[5], gains.turn_rate)
    if top > 0.0:
        rate = gains.drag_learning * gains.disturbance * mass * power[0] / (top * top)
        memory[12] = min(max(memory[12] + rate * dt, 0.0), MOST_DRAG)
    if spin > 0.0:
        # A hull that drags hard falls short by little: what is missing over the loop's gain and its slope.
        slope = nominal.linear[5] + 2.0 * memory[13] * nominal.quadratic[5] * abs(memory[7])
        inert = nominal.inertia[5] + slope / gains.yaw_rate
        rate = gains.drag_learning * gains.yaw_disturbance * inert * power[1] / (spin * spin)
        memory[13] = min(max(memory[13] + rate * dt, 0.0), MOST_DRAG)


@njit(cache=True, nogil=True)
def allocate(demand: Float64Array, nominal: Nominal, commands: Float64Array) -> float:
    """Write the thruster commands (n,) for a wrench; where one would saturate, all give less of it.

    Returns:
        The share of the wrench that is given.
    """
    forces, share = np.dot(nominal.sharing, demand), 1.0
    for i in range(len(forces)):
        force = forces[i]
        # Not that of what a jammed thruster does: less of that would turn the vehicle.
        if force > nominal.most[i] - nominal.held[i]:
            share = min(share, (nominal.most[i] - nominal.held[i]) / force)
        elif force < nominal.least[i] - nominal.held[i]:
            share = min(share, (nominal.least[i] - nominal.held[i]) / force)
    for i in range(len(commands)):
        commands[i] = command(nominal.commands, nominal.roots, share * forces[i] + nominal.held[i])
    return share


@njit(cache=True, nogil=True)
def steer(
    memory: Float64Array,
    goal: Float64Array,
    pace: float,
    rotation: Float64Array,
    position: Float64Array,
    velocity: Float64Array,
    rates: Float64Array,
    gains: Gains,
    nominal: Nominal,
    dt: float,
    commands: Float64Array,
) -> float:
    """One beat of the autopilot: goal and estimate in, thruster commands out; see `guide` and `wrench`.

    Returns:
        The share of the wrench that the thrusters can give.
    """
    acceleration = guide(memory, goal, gains, pace, dt)
    demand, error, power = wrench(memory, acceleration, rotation, position, velocity, rates, gains, nominal)
    share = allocate(demand, nominal, commands)
    # While the thrusters give less than is asked, the shortfall says nothing of what pushes.
    if share == 1.0:
        blame(memory, error, power, gains, nominal, dt)
    return share


@njit(cache=True, nogil=True)
def rise(
    rates: Float64Array,
    force: Float64Array,
    climb: float,
    behind: float,
    gains: Gains,
    nominal: Nominal,
    commands: Float64Array,
) -> None:
    """Write the commands (n,) that lead straight up, by no estimate: heave alone, and level.

    Args:
        rates: (3,) rad/s in `base`.
        force: (3,) m/s² of the accelerometers in `base`, which tell where up is; NaN where they are silent:
            then its own buoyancy has to keep it level.
        climb: m/s upwards by the pressure; NaN where that is silent: then it is driven by the model's drag.
        behind: Metres that it is behind an ascent at its speed, by the pressure.
        gains: With the speed of the ascent.
        nominal: The vehicle.
        commands: (n,) of the thrusters.
    """
    demand = np.zeros(6)
    if math.isnan(climb):
        drag = drag_of(nominal.linear[2], nominal.quadratic[2], gains.ascent)
        demand[2] = gains.drag_share * drag - nominal.lift
    else:
        lack = CLIMBING * (gains.ascent - climb) + CATCHING_UP * behind
        demand[2] = nominal.inertia[2] * lack - nominal.lift
    length = math.sqrt(force[0] * force[0] + force[1] * force[1] + force[2] * force[2])
    if length > 0.0:
        roll, pitch = math.atan2(force[1], force[2]), -math.asin(force[0] / length)
        demand[3], demand[4] = righting(roll, pitch, rates, gains, nominal)
    allocate(demand, nominal, commands)


@njit(cache=True, nogil=True)
def condition(
    limits: Limits,
    imu_age: float,
    depth_age: float,
    dvl_age: float,
    velocity_sigma: float,
    position_sigma: float,
) -> int:
    """See `health.Watch`; a comparison with NaN fails, so that what is not a number is over its limit."""
    if not (imu_age <= limits.stale and depth_age <= 10.0 * limits.stale):
        return STALE
    if not (velocity_sigma <= limits.velocity_sigma and position_sigma <= limits.position_sigma):
        return DIVERGED
    if not dvl_age <= limits.lost:
        return LOST
    return BLIND if dvl_age > limits.blind else FINE
