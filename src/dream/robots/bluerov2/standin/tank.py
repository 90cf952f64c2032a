"""Thruster commands → the true vehicle in its world, and what its instruments read."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, SE3
from dream.measurements import Depth, Dvl, Heading, Imu
from dream.protocol import SurveyProtocol, protocol_named
from dream.sim.sensors import AHRS, BAR30, DVL_A50, ICM_20602, Compass, DopplerLog, InertialUnit, Ping
from dream.sim.sensors import PressureGauge as Gauge
from dream.sim.sensors import _kernels as sensors
from dream.sim.solids import Solids
from dream.sim.vehicle import BLUEROV2_HEAVY, STILL, Current, Diverged, Spread, State, Vehicle
from dream.sim.vehicle import _kernels as water
from dream.sim.world import World
from dream.vehicle import watts
from dream.vehicle.thrusters import TABLE_VOLTAGE, VOLTAGE_POWER

Float64Array = npt.NDArray[np.float64]

BEAT = 0.01
"""Seconds of water and inertial unit."""
LOAD_EVERY = 10
"""Beats between two looks at the battery."""


CELLS = 4
"""In series."""
OPEN_CIRCUIT = np.array(
    [
        (0.0, 2.5),
        (0.005, 2.808),
        (0.0352, 3.1179),
        (0.0854, 3.3182),
        (0.1357, 3.4193),
        (0.2915, 3.5826),
        (0.4523, 3.6941),
        (0.8392, 4.0664),
        (0.9548, 4.1121),
        (1.0, 4.17),
    ]
).T
"""(2, 10): share of the charge that is left, and volts of a cell at rest then. Of a Samsung INR21700-40T at
C/20, in the breakpoints that Sunil, Pattipati and Balasingam find for straight lines between them (*Piecewise
Linear Approximation of Battery Open-Circuit Voltage Characteristics Using Dynamic Programming*, IEEE
Transactions on Instrumentation and Measurement 2025; github.com/soorajsunil/Piecewise-Battery-OCV). The last
point there is where charging ends, 4.2 V; that a cell rests at 4.17 V after it is an assumption."""


@dataclass(frozen=True, slots=True)
class Battery:
    """Four lithium-ion cells in series, and what draws on them.

    What it does: the voltage at rest follows `OPEN_CIRCUIT`, and under load it is lower by the current times
    a resistance. Thrusters draw what the maker's table says at 16 V.
    Reference: Blue Robotics' battery of 18 Ah, four times six cells of 18650. Who makes them is not told:
    that they are like those of the table is an assumption (another that the same authors measured, a Molicel
    INR21700-P42A, is within 0.03 V of them from 5 % on). So is the resistance, with the wiring.
    """

    charge: float = 18.0
    """Ampere-hours."""
    resistance: float = 0.03
    """Ohms."""
    idle: float = 1.5
    """Amperes of everything but the thrusters."""

    def __post_init__(self) -> None:
        if not (0.0 < self.charge < math.inf and self.resistance >= 0.0 and self.idle >= 0.0):
            raise ValueError(
                f"battery: expected a charge above 0, resistance and idle of 0 or more, got {self}"
            )

    @property
    def full(self) -> float:
        """Volts at rest, charged."""
        return self.at_rest(1.0)

    @property
    def empty(self) -> float:
        """Volts at rest, when the charge is gone."""
        return self.at_rest(0.0)

    def at_rest(self, left: float) -> float:
        """Volts, with this share of its charge left."""
        return CELLS * float(np.interp(left, *OPEN_CIRCUIT))

    def left_at(self, volts: float) -> float:
        """Share of its charge that is left where it has so many volts at rest."""
        shares, cell = OPEN_CIRCUIT
        return float(np.interp(volts / CELLS, cell, shares))


@dataclass(frozen=True, slots=True)
class Conditions:
    """What swims, in what water, and by what instruments."""

    vehicle: Vehicle = BLUEROV2_HEAVY
    spread: Spread | None = None
    """Draws the vehicle in the water, where given; else it is as published."""
    current: Current = STILL
    imu: InertialUnit = ICM_20602
    dvl: DopplerLog = DVL_A50
    gauge: Gauge = BAR30
    compass: Compass = AHRS
    battery: Battery = field(default_factory=Battery)
    depth_zero: float = 0.0
    """Metres in the world where the autopilot takes its own altitude for 0: where it was switched on in the
    water, or in other weather."""
    declination: float = 0.0
    """Radians by which the compass points to the right of true north there, which `compass` is about."""
    altitude: float = 0.0
    """Metres of the water's surface above the sea, as a receiver says."""

    def __post_init__(self) -> None:
        for name, rate in (("gauge", self.gauge.rate), ("compass", self.compass.rate)):
            every = 1.0 / (rate * BEAT)
            if every < 1.0 - 1e-9 or abs(every - round(every)) > 1e-6:
                raise ValueError(f"{name}.rate: expected a part of {1.0 / BEAT:g} Hz, got {rate:g}")
        if abs(self.imu.rate * BEAT - 1.0) > 1e-9:
            raise ValueError(f"imu.rate: expected {1.0 / BEAT:g} Hz, as the loop, got {self.imu.rate:g}")


@dataclass(frozen=True, slots=True)
class Pull:
    """Somebody pulls at the tether."""

    force: tuple[float, float, float]
    """N in the world."""
    start: float
    """Seconds of the tank's time."""
    end: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.force).all() and self.start <= self.end):
            raise ValueError(f"pull: expected a finite force, and an end not before its start, got {self}")


class Tank:
    """The true vehicle, shared by all stand-ins of one dive.

    What it does: each `advance` is a hundredth of a second of `dream.sim.vehicle` and of the sensors of
    `dream.sim.sensors`, as `dream.robots.Simulated` flies them, with all randomness drawn from one seed. The
    pings of the DVL have a generator of their own, so that nobody's listening changes how the vehicle swims.
    The vehicle starts at a start pose of its world, at the protocol's altitude or a depth, and is **held
    there until `release`**, which the autopilot calls when it is first armed; after that a vehicle without
    thrust floats up.

    Faults are fields: `pulls` at the tether, `leak`, `resistance` of the battery, those of gauge and
    thrusters; and `drain` and `leave` for the battery's charge.

    Assumes: one thread advances. What others may read at any time (`state`, `T_world_base`, `imu`, `depth`,
    `heading`, `voltage`) is replaced as a whole after each beat.
    """

    def __init__(
        self,
        world: World,
        protocol: SurveyProtocol | None = None,
        *,
        seed: int = 1,
        conditions: Conditions | None = None,
        start: SE2 | None = None,
        depth: float | None = None,
        solids: Solids | None = None,
    ) -> None:
        """Put the vehicle into the world, at its first start pose unless told otherwise.

        Args:
            world: Where.
            protocol: Whose altitude and body; the world's own unless given.
            seed: Of everything that is drawn.
            conditions: What swims; a BlueROV2 Heavy in still water unless given.
            start: Where.
            depth: Metres below the surface; at the protocol's altitude unless given.
            solids: Of this world, where they are made already.
        """
        self.world = world
        self.protocol = protocol or protocol_named(world.protocol)
        self.conditions = conditions = conditions or Conditions()
        motion, pings = np.random.SeedSequence(seed).spawn(2)
        self._rng, self._pinging = np.random.default_rng(motion), np.random.default_rng(pings)
        pose = world.starts[0] if start is None else start
        if not world.bounds.contains(pose.x, pose.y):
            raise ValueError(f"start: expected a pose inside {world.bounds}, got ({pose.x}, {pose.y})")
        seabed = float(world.terrain.height(pose.x, pose.y))
        z = seabed + self.protocol.altitude if depth is None else -depth
        if not seabed < z <= 0.0:
            raise ValueError(f"depth: expected 0 to {-seabed:.2f} m, the seabed, got {depth}")
        vehicle, spread = conditions.vehicle, conditions.spread
        self.vehicle = vehicle if spread is None else spread.draw(vehicle, self._rng)
        at_rest = self.vehicle.at_rest(SE3.level(pose.x, pose.y, z, pose.yaw))

        thrusters = replace(self.vehicle.thrusters, voltage=TABLE_VOLTAGE)
        self._body = replace(self.vehicle, thrusters=thrusters).body
        self._table = self._body.roots.copy()
        self._flow = conditions.current.flow
        self._solids = solids or Solids(world)
        self._inertial, self._acoustic = conditions.imu.constants, conditions.dvl.constants
        self._pressure, self._magnetic = conditions.gauge.constants, conditions.compass.constants
        self._depth_every = round(1.0 / (conditions.gauge.rate * BEAT))
        self._heading_every = round(1.0 / (conditions.compass.rate * BEAT))

        self._gust = conditions.current.begin(self._rng)
        self._bias = conditions.imu.begin(self._rng)
        self._gauge_error = conditions.gauge.begin(self._rng)
        self._compass_error = conditions.compass.begin(self._rng)
        self._scale = conditions.dvl.begin(self._pinging)
        self._x, self._before = at_rest.vector, at_rest.vector
        self._seen = self._x.copy()
        self._contact = np.zeros(3)
        self._commands = np.zeros(self.vehicle.thrusters.count)
        self._beats = 0
        self._used = 0.0

        self.held = True
        """Is it still held at the launch?"""
        self.pulls: tuple[Pull, ...] = ()
        self.leak = False
        self.gauge_drift = 0.0
        """m/s upwards by which its pressure gauge drifts."""
        self.gauge_stuck = False
        """Does it say the same for ever?"""
        self.thrust = np.ones(len(self._commands))
        """(n,) share of its command that each thruster follows: 0 for a dead one, -1 for a reversed one."""
        self._drifted = 0.0
        self.resistance = conditions.battery.resistance
        """Ohms of battery and wiring."""
        self.voltage = conditions.battery.full
        """Volts under load."""
        self.amperes = conditions.battery.idle
        self.imu: Imu
        self.depth: Depth
        self.heading: Heading
        self._read(first=True)

    @property
    def beats(self) -> int:
        """How many there were."""
        return self._beats

    @property
    def time(self) -> float:
        """Seconds since it was filled."""
        return self._beats * BEAT

    @property
    def state(self) -> State:
        """As it is."""
        return State.of(self._seen)

    @property
    def T_world_base(self) -> SE3:
        """Where the vehicle is."""
        return self.state.T_world_base

    @property
    def collisions(self) -> int:
        """How often it ran into something."""
        return int(self._contact[0])

    @property
    def used(self) -> float:
        """Ampere-hours taken from the battery."""
        return self._used

    def release(self) -> None:
        """Let go of the vehicle; once free, it stays so."""
        self.held = False

    def drain(self, volts: float) -> None:
        """Take so much charge that the battery has this voltage at rest."""
        battery = self.conditions.battery
        if not battery.empty <= volts <= battery.full:
            raise ValueError(f"volts: expected {battery.empty:g} to {battery.full:g}, got {volts}")
        self.leave(battery.left_at(volts))

    def leave(self, share: float) -> None:
        """Take so much charge that this share of it, 0 to 1, is left."""
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"share: expected 0 to 1, got {share}")
        self._used = (1.0 - share) * self.conditions.battery.charge
        self._load()

    def pull(self, force: tuple[float, float, float], seconds: float, *, after: float = 0.0) -> None:
        """Pull at the tether with so many newtons in the world, for so long."""
        self.pulls = (*self.pulls, Pull(force, self.time + after, self.time + after + seconds))

    def advance(self, commands: npt.ArrayLike) -> None:
        """One beat later, with these commands (n,) in [−1, 1] to the thrusters.

        Raises:
            ValueError: There are not as many commands as thrusters, or one is not finite.
            Diverged: The motion is finite no more.
        """
        given = np.ascontiguousarray(commands, np.float64)
        if given.shape != self._commands.shape or not math.isfinite(float(given.sum())):
            raise ValueError(f"commands: expected {len(self._commands)} finite numbers, got {given}")
        self._commands = given
        self._before[:] = self._x
        water.stir(self._flow, BEAT, self._rng, self._gust)
        if not self.held:
            pull = np.zeros(3)
            for one in self.pulls:
                if one.start <= self.time < one.end:
                    pull += one.force
            turning = given * self.thrust
            if not water.advance(self._body, self._flow, self._gust, pull, turning, BEAT, self._x):
                raise Diverged(
                    f"motion: expected a finite state at {self.time:.2f} s, got {self._x.tolist()}"
                )
            radius, height = self.protocol.body_radius, self.protocol.body_height
            water.hold(self._body, self._solids.index, radius, height, self._before, self._x, self._contact)
        self._beats += 1
        self._used += self.amperes * BEAT / 3600.0
        if self._beats % LOAD_EVERY == 0:
            self._load()
        self._read()
        self._seen = self._x.copy()

    def ping(self) -> Ping:
        """What a ping of the DVL brings that is sent now, and when its report can be there."""
        velocity, covariance, ranges = np.empty(3), np.empty((3, 3)), np.empty(4)
        altitude, delay, valid = sensors.ping(
            self._acoustic,
            self._solids.index,
            self._x,
            self._scale,
            self._pinging,
            velocity,
            covariance,
            ranges,
        )
        now = self.time
        return Ping(Dvl(now, velocity, covariance, altitude, valid), now + delay, ranges)

    def _load(self) -> None:
        """The battery's voltage by its charge and what the thrusters draw; thrust goes with it."""
        battery = self.conditions.battery
        drawn = 0.0 if self.held else float(watts(self._commands).sum()) / TABLE_VOLTAGE
        left = max(1.0 - self._used / battery.charge, 0.0)
        self.amperes = battery.idle + drawn
        self.voltage = max(battery.at_rest(left) - self.resistance * self.amperes, 1.0)
        factor = (self.voltage / TABLE_VOLTAGE) ** (0.5 * VOLTAGE_POWER)
        np.multiply(self._table, factor, out=self._body.roots)

    def _read(self, *, first: bool = False) -> None:
        sample = np.empty(6)
        sensors.inertial(self._inertial, self._before, self._x, BEAT, self._bias, self._rng, sample)
        now = self.time
        self.imu = Imu(now, sample[:3], sample[3:])
        if first or self._beats % self._depth_every == 0:
            z = sensors.pressure(
                self._pressure, self._x, self._depth_every * BEAT, self._gauge_error, self._rng
            )
            self._drifted += self.gauge_drift * self._depth_every * BEAT
            told = self.depth.z if self.gauge_stuck and not first else z + self._drifted
            self.depth = Depth(now, told, self.conditions.gauge.sigma)
        if first or self._beats % self._heading_every == 0:
            yaw = sensors.heading(
                self._magnetic, self._x, self._heading_every * BEAT, self._compass_error, self._rng
            )
            self.heading = Heading(now, yaw, self.conditions.compass.sigma)
