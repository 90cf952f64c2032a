"""The whole vehicle in one compiled loop: water, sensors, estimate and autopilot."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from dream.control import _kernels as control
from dream.control.diagnosis import _kernels as diagnosis
from dream.estimation._kernels import inekf, kalman
from dream.estimation._kernels.sensors import Parameters as Instruments
from dream.sim import _kernels as world
from dream.sim.sensors import _kernels as sensors
from dream.sim.vehicle import _kernels as water
from dream.vehicle._kernels import SAG_OHM, PackedFault, obeyed, thrust, watts
from dream.vehicle.power import AMPERES_POWER
from dream.vehicle.thrusters import VOLTAGE_POWER

Float64Array = npt.NDArray[np.float64]

ARRIVED, COLLIDED, LATE, GIVEN_UP, BROKEN, NAMED = range(6)
"""How a move ended: there, by contact, out of time, given up because the estimate is not to be trusted, or
because the simulated motion is not, or broken off because the fault of a thruster was named."""
FARTHEST = 1e5
"""Metres from the origin beyond which it is not."""
MOST_BEATS = 64
"""Beats that a ping may take until its report is there; a longer one is lost."""
SEABED_TIME = 2.0
"""Seconds over which the height of the seabed is smoothed: at half a metre a second, about the length of the
vehicle's shadow, so that what lies on it hardly lifts the vehicle."""
CLIMB_TIME = 0.5
"""Seconds over which the speed upwards is smoothed: between two readings, noise makes it 4 cm/s."""
MOST_BEHIND = 2.0
"""Metres that it catches up with, at most."""
SHALLOW = 0.3
"""Metres of depth, by the pressure, at which it has surfaced."""
CHECKED = 10
"""Beats between two looks at how sure the filter is."""

SETTLES = 0.05
"""Seconds in which the voltage follows the load: what speed controllers hold in their capacitors."""
SAG_TIME = 3.0
"""Seconds over which the voltage is smoothed: a burst of thrust is no sag."""
ALIKE_AT_LEAST = 2
"""Readings that are the same as the one before, on end, before a gauge can be stuck."""

# What `Voyage.clock` holds.
CLOCK = 24
TIME, NEXT_PING, ARRIVES, SENT, ABOVE, LAST_DVL, LAST_DEPTH, LAST_IMU = range(8)
SEABED, DISTANCE, WAY, CLEARANCE, CONDITION, DRAWN, FAILED = range(8, 15)
VOLTS, MEAN_VOLTS, LEAST_VOLTS, READING, HEARD, ALIKE, RISEN, STUCK, SILENT = range(15, CLOCK)
"""`DISTANCE` is over ground, `WAY` through the water, heights counted; `DRAWN` is in joules, and `FAILED` is
when a thruster first gave another force than it was commanded. `VOLTS` are the battery's, `MEAN_VOLTS` are
smoothed, and `LEAST_VOLTS` their least in a sag. `READING` is the gauge's last and `HEARD` when it came;
`ALIKE` counts those before it that were the same, `RISEN` is by how many metres the estimate rose since;
`STUCK` and `SILENT` are when the gauge was found to be so."""


class Ship(NamedTuple):
    """All that stays as it is during a mission."""

    body: water.Body
    fault: PackedFault
    """Of a thruster, of which the autopilot is not told."""
    sags_at: float
    """Seconds at which the battery begins to sag, and"""
    sticks_at: float
    """those at which the gauge sticks; infinite where they never do."""
    flow: water.Flow
    solids: world.Index
    radius: float
    height: float
    inertial: sensors.Inertial
    acoustic: sensors.Acoustic
    gauge: sensors.Pressure
    magnetic: sensors.Magnetic
    ping_tops: Float64Array
    ping_rates: Float64Array
    depth_sigma: float
    heading_sigma: float
    heading_zero: float
    """Radians that the compass reads too much, by what it read at the launch."""
    scale: float
    """Share by which the DVL reads long."""
    outages: Float64Array
    """(n, 3) sensor, begin and end."""
    bursts: Float64Array
    """(2,) mean seconds between and of the losses of the DVL."""
    filter: Instruments
    gains: control.Gains
    nominal: control.Nominal
    plant: diagnosis.Plant
    limits: control.Limits
    stuck_rise: float
    stuck_readings: float
    """See `sim.sensors.PressureGauge`."""
    rest_volts: float
    """Of the battery, without load."""
    watt_commands: Float64Array
    """Commands at the points of what a thruster draws,"""
    watt_roots: Float64Array
    """and the cube roots of watts there."""
    hotel: float
    """Watts of all else."""
    dt: float
    depth_every: int
    """Beats."""
    heading_every: int


class Voyage(NamedTuple):
    """All that changes: vectors that the loop writes into."""

    x: Float64Array
    """(13 + n,) the true state."""
    contact: Float64Array
    """(3,) how often one began, whether one lasts, and whether there was one from the start."""
    gust: Float64Array
    bias: Float64Array
    """(6,) of the inertial unit."""
    gauge_error: Float64Array
    compass_error: Float64Array
    memory: Float64Array
    """(14,) of the autopilot."""
    commands: Float64Array
    diagnosis: diagnosis.Memory
    clock: Float64Array
    """(CLOCK,) seconds, metres, the worst condition of the move and joules; see the names above."""
    sample: Float64Array
    """(8,) turn rate, force, depth and heading of the last beat, NaN where none; what the unit said last
    stands for what it does not say."""
    chain: Float64Array
    """(2,) whether the DVL is in a burst of losses, and until when."""
    ping_velocity: Float64Array
    ping_covariance: Float64Array
    since: Float64Array
    """(MOST_BEATS, 8) samples since the last ping: turn rate, force, depth and heading, NaN where none."""


@njit(cache=True, nogil=True)
def carried(ship: Ship, s: inekf.State, sample: Float64Array) -> inekf.State:
    """The estimate one beat later, by what the sensors said in it."""
    s = inekf.predict(ship.filter, s, sample[:3].copy(), sample[3:6].copy(), ship.dt)
    if not math.isnan(sample[6]):
        s = inekf.correct_depth(ship.filter, s, sample[6], ship.depth_sigma)[0]
    if not math.isnan(sample[7]):
        s = inekf.correct_heading(ship.filter, s, sample[7], ship.heading_sigma)[0]
    return s


@njit(cache=True, nogil=True)
def velocity_sigma(s: inekf.State) -> float:
    """m/s of the least certain axis over ground."""
    spread = inekf.velocity_covariance(s)
    return math.sqrt(max(spread[0, 0], spread[1, 1], spread[2, 2]))


@njit(cache=True, nogil=True)
def position_sigma(s: inekf.State) -> float:
    """Metres of the less certain horizontal axis."""
    spread = inekf.position_covariance(s)
    return math.sqrt(max(spread[0, 0], spread[1, 1]))


@njit(cache=True, nogil=True)
def sag(ship: Ship, clock: Float64Array, drawn: float) -> float:
    """A beat of a battery that sags: its voltage by the load, and thrust by the voltage.

    The autopilot hears of the voltage by the battery's monitor, and asks its thrusters for the more.

    Args:
        ship: Its curves of thrust are changed, true and believed.
        clock: Changed.
        drawn: W of the thrusters at the voltage without load.

    Returns:
        W that they and all else draw at this voltage.
    """
    drawn = ship.hotel + drawn * (clock[VOLTS] / ship.rest_volts) ** (1.0 + AMPERES_POWER)
    amperes = drawn / clock[VOLTS]
    before = clock[VOLTS]
    clock[VOLTS] += ship.dt / SETTLES * (max(ship.rest_volts - SAG_OHM * amperes, 1.0) - clock[VOLTS])
    clock[MEAN_VOLTS] += ship.dt / SAG_TIME * (clock[VOLTS] - clock[MEAN_VOLTS])
    clock[LEAST_VOLTS] = min(clock[LEAST_VOLTS], clock[MEAN_VOLTS])
    factor = (clock[VOLTS] / before) ** (0.5 * VOLTAGE_POWER)
    ship.body.roots[:] *= factor
    ship.nominal.roots[:] *= factor
    ship.plant.roots[:] *= factor
    return drawn


@njit(cache=True, nogil=True)
def swim(ship: Ship, voyage: Voyage, before: Float64Array, rng: np.random.Generator) -> bool:
    """A beat of water and contact, from the state that is copied to `before`; False where it is none."""
    clock, x, none = voyage.clock, voyage.x, np.zeros(3)
    before[:] = x
    commands = voyage.commands.copy()
    if clock[TIME] >= ship.fault.at:
        fails, u = ship.fault.thruster, commands[ship.fault.thruster]
        commands[fails] = obeyed(ship.fault, ship.body.commands, ship.body.roots, u)
        given = thrust(ship.body.commands, ship.body.roots, commands[fails])
        if given != thrust(ship.body.commands, ship.body.roots, u):
            clock[FAILED] = min(clock[FAILED], clock[TIME])
    water.stir(ship.flow, ship.dt, rng, voyage.gust)
    if not water.advance(ship.body, ship.flow, voyage.gust, none, commands, ship.dt, x):
        return False
    if abs(x[0]) + abs(x[1]) + abs(x[2]) > FARTHEST:
        return False
    clock[TIME] += ship.dt
    drawn = ship.hotel
    for u in commands:
        drawn += watts(ship.watt_commands, ship.watt_roots, u)
    if clock[TIME] >= ship.sags_at:
        drawn = sag(ship, clock, drawn - ship.hotel)
    clock[DRAWN] += drawn * ship.dt
    over_ground = math.hypot(x[0] - before[0], x[1] - before[1])
    clock[DISTANCE] += over_ground
    clock[WAY] += math.hypot(over_ground, x[2] - before[2])
    water.hold(ship.body, ship.solids, ship.radius, ship.height, before, x, voyage.contact)
    return True


@njit(cache=True, nogil=True)
def feel(ship: Ship, voyage: Voyage, before: Float64Array, rng: np.random.Generator) -> None:
    """Write what unit, gauge and compass make of that beat into the sample."""
    clock, x, sample = voyage.clock, voyage.x, voyage.sample
    now, turned = clock[TIME], np.empty(6)
    sensors.inertial(ship.inertial, before, x, ship.dt, voyage.bias, rng, turned)
    if not sensors.silent(ship.outages, sensors.IMU, now):
        sample[:6] = turned
        clock[LAST_IMU] = now
    count = round(now / ship.dt)
    sample[6] = sample[7] = math.nan
    if count % ship.depth_every == 0:
        z = sensors.pressure(ship.gauge, x, ship.depth_every * ship.dt, voyage.gauge_error, rng)
        if now >= ship.sticks_at and not math.isnan(clock[READING]):
            z = clock[READING]
        if not sensors.silent(ship.outages, sensors.DEPTH, now):
            # Of what moved while nothing was heard, equal readings say nothing.
            follows = now - clock[HEARD] < 1.5 * ship.depth_every * ship.dt
            if z == clock[READING] and follows:
                clock[ALIKE] += 1.0
            else:
                clock[ALIKE] = clock[RISEN] = 0.0
            moves = clock[ALIKE] >= ALIKE_AT_LEAST and abs(clock[RISEN]) > ship.stuck_rise
            if moves or clock[ALIKE] >= ship.stuck_readings:
                clock[STUCK] = min(clock[STUCK], now)
            clock[READING], clock[HEARD] = z, now
            if clock[STUCK] > now:
                sample[6] = z
                clock[LAST_DEPTH] = now
    if count % ship.heading_every == 0:
        yaw = sensors.heading(ship.magnetic, x, ship.heading_every * ship.dt, voyage.compass_error, rng)
        if not sensors.silent(ship.outages, sensors.COMPASS, now):
            sample[7] = control.wrapped(yaw - ship.heading_zero)


@njit(cache=True, nogil=True)
def surface(ship: Ship, voyage: Voyage, seconds: float, rng: np.random.Generator) -> bool:
    """Rise by pressure and accelerometers alone, until it is shallow or the seconds are over.

    Returns:
        Whether the simulated motion is to be trusted.
    """
    clock, sample, before = voyage.clock, voyage.sample, np.empty(len(voyage.x))
    z, climb, behind = math.nan, math.nan, 0.0
    read, end, unknown = clock[LAST_DEPTH], clock[TIME] + seconds, np.full(3, math.nan)
    while clock[TIME] < end and not z >= -SHALLOW:
        if clock[TIME] - read > ship.limits.stale:
            climb = math.nan
        up = sample[3:6] if clock[TIME] - clock[LAST_IMU] <= ship.limits.stale else unknown
        control.rise(sample[:3], up, climb, behind, ship.gains, ship.nominal, voyage.commands)
        if not swim(ship, voyage, before, rng):
            return False
        feel(ship, voyage, before, rng)
        if not math.isnan(sample[6]):
            since, gained = clock[TIME] - read, sample[6] - z
            if math.isnan(climb):
                climb = 0.0
            if since <= ship.limits.stale and not math.isnan(gained):
                climb += since / CLIMB_TIME * (gained / since - climb)
                behind += ship.gains.ascent * since - gained
                behind = min(max(behind, -MOST_BEHIND), MOST_BEHIND)
            z, read = sample[6], clock[TIME]
    voyage.commands[:] = 0.0
    return True


@njit(cache=True, nogil=True)
def fly(
    ship: Ship,
    voyage: Voyage,
    s: inekf.State,
    at_ping: inekf.State,
    goal: Float64Array,
    altitude: float,
    z: float,
    seconds: float,
    near: float,
    aligned: float,
    slow: float,
    stay: float,
    rng: np.random.Generator,
    track: Float64Array,
) -> tuple[inekf.State, inekf.State, int, int]:
    """Fly to a goal, until the vehicle believes to be there and still.

    Args:
        ship: Constants.
        voyage: Where it is; changed.
        s: The estimate.
        at_ping: The estimate when the ping was sent whose report is on its way.
        goal: (3,) x, y and yaw.
        altitude: Metres above the seabed that it holds on the way; NaN where it has a height.
        z: Height in the world that the way leads straight to; NaN where it holds an altitude.
        seconds: At most.
        near: Metres and
        aligned: radians from the goal, by the estimate, and
        slow: m/s over ground that count as being there, each in height as well where it has one, for
        stay: seconds on end.
        rng: Of the mission.
        track: (B, 9) is filled with a row each beat, as far as it goes: time, true x, y, z and yaw, and the
            estimated ones.

    Returns:
        The estimate, that at the last ping, how it ended, and the beats that were flown.
    """
    clock, x, sample = voyage.clock, voyage.x, voyage.sample
    target, before = np.empty(4), np.empty(len(x))
    ranges, still = np.empty(4), 0.0
    beats = math.ceil(seconds / ship.dt)
    condition = control.FINE
    straight = not math.isnan(z)
    for beat in range(beats):
        now = clock[TIME]
        # ------------------------------------------------------------------------------ what is to be done
        if beat % CHECKED == 0:
            condition = control.condition(
                ship.limits,
                now - clock[LAST_IMU],
                # The DVL tells how fast it rises, too: without the gauge, heights drift as positions do.
                now - max(clock[LAST_DEPTH], clock[LAST_DVL]),
                now - clock[LAST_DVL],
                velocity_sigma(s),
                position_sigma(s),
            )
            clock[CONDITION] = max(clock[CONDITION], condition)
            if now - clock[HEARD] > 10.0 * ship.limits.stale:
                clock[SILENT] = min(clock[SILENT], now)
            if condition >= control.DIVERGED:
                return s, at_ping, GIVEN_UP, beat
        target[0], target[1], target[3] = goal[0], goal[1], goal[2]
        target[2] = z if straight else clock[SEABED] + altitude
        pace = 1.0
        if condition == control.BLIND:
            pace = control.SLOW
        elif condition == control.LOST:
            # Where the reference is then is where it stays.
            target[0], target[1], target[3] = voyage.memory[0], voyage.memory[1], voyage.memory[3]
            if straight:
                target[2] = voyage.memory[2]
        rates = s.gyro - s.gyro_bias
        control.steer(
            voyage.memory,
            target,
            pace,
            s.rotation,
            s.position,
            s.velocity,
            rates,
            ship.gains,
            ship.nominal,
            ship.dt,
            voyage.commands,
        )
        # ------------------------------------------------------------------------------ what happens
        touched = voyage.contact[0]
        if not swim(ship, voyage, before, rng):
            return s, at_ping, BROKEN, beat
        now = clock[TIME]
        struck = voyage.contact[0] > touched
        clock[CLEARANCE] = min(clock[CLEARANCE], 0.0 if struck else clearance(ship, x))
        # ------------------------------------------------------------------------------ what is felt
        feel(ship, voyage, before, rng)
        sent = int(clock[SENT])
        if sent >= 0 and now >= clock[ARRIVES]:
            # The report is of when the ping was sent: from there it is reckoned anew.
            s, code, _ = inekf.correct_dvl(ship.filter, at_ping, voyage.ping_velocity, voyage.ping_covariance)
            for k in range(sent):
                s = carried(ship, s, voyage.since[k])
            clock[SENT] = sent = -1
            if code != kalman.REFUSED:
                clock[LAST_DVL] = now
            seabed = at_ping.position[2] + ship.acoustic.position[2] - clock[ABOVE]
            period = 1.0 / sensors.ping_rate(ship.ping_tops, ship.ping_rates, clock[ABOVE])
            clock[SEABED] += min(period / SEABED_TIME, 1.0) * (seabed - clock[SEABED])
        s = carried(ship, s, sample)
        clock[RISEN] += ship.dt * s.velocity[2]
        if sent >= 0:
            if sent < MOST_BEATS:
                voyage.since[sent] = sample
                clock[SENT] = sent + 1
            else:
                clock[SENT] = -1
        elif now >= clock[NEXT_PING]:
            above, delay, valid = sensors.ping(
                ship.acoustic,
                ship.solids,
                x,
                ship.scale,
                rng,
                voyage.ping_velocity,
                voyage.ping_covariance,
                ranges,
            )
            clock[NEXT_PING] = now + 1.0 / sensors.ping_rate(ship.ping_tops, ship.ping_rates, above)
            lost = sensors.burst(ship.bursts, now, voyage.chain, rng)
            if valid and not lost and not sensors.silent(ship.outages, sensors.DVL, now):
                clock[SENT], clock[ARRIVES], clock[ABOVE] = 0, now + delay, above
                at_ping = s
        named = diagnosis.beat(
            ship.plant,
            voyage.diagnosis,
            voyage.commands,
            sample[:3] - s.gyro_bias,
            sample[3:6] - s.accelerometer_bias,
            # Without the bottom its velocity drifts, and all that is reckoned from that.
            clock[LAST_IMU] == now and condition == control.FINE,
            s.rotation,
            s.velocity,
            math.sqrt(s.covariance[0, 0] + s.covariance[1, 1]),
            voyage.memory[8:14],
            ship.dt,
        )
        # ------------------------------------------------------------------------------ is it there?
        yaw = math.atan2(s.rotation[1, 0], s.rotation[0, 0])
        if beat < len(track):
            r = water.rotation(x)
            track[beat, 0], track[beat, 4], track[beat, 8] = now, math.atan2(r[3], r[0]), yaw
            track[beat, 1:4], track[beat, 5:8] = x[:3], s.position
        if struck:
            # A contact that goes on is one: so it can slide off the way it came.
            return s, at_ping, COLLIDED, beat + 1
        if named:
            return s, at_ping, NAMED, beat + 1
        there = (
            math.hypot(goal[0] - s.position[0], goal[1] - s.position[1]) <= near
            and abs(control.wrapped(goal[2] - yaw)) <= aligned
            and math.hypot(s.velocity[0], s.velocity[1]) <= slow
            and (not straight or (abs(z - s.position[2]) <= near and abs(s.velocity[2]) <= slow))
        )
        still = still + ship.dt if there else 0.0
        if still >= stay:
            return s, at_ping, ARRIVED, beat + 1
    # One that still leans on what it touched did not come to stand by itself.
    return s, at_ping, COLLIDED if voyage.contact[1] != 0.0 else LATE, beats


@njit(cache=True, nogil=True)
def clearance(ship: Ship, x: Float64Array) -> float:
    """Horizontal metres between the body, a level cylinder, and what is solid at its height; at most 5."""
    low, high = x[2] - 0.5 * ship.height, x[2] + 0.5 * ship.height
    return float(world.room(ship.solids, x[0], x[1], low, high, 5.0 + ship.radius) - ship.radius)
