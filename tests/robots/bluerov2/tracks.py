"""Vehicles over made grounds, and what a DVL would say there: for the seabed's own tests, without a dive."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3
from dream.measurements import Dvl
from dream.robots.bluerov2.seabed import Seabed
from dream.sim.sensors import DVL_A50, RANGE_MODES

Float64Array = npt.NDArray[np.float64]
Ground = Callable[[Float64Array, Float64Array], Float64Array]
"""Heights of the ground, metres in the world, at x and y."""
BEAMS = DVL_A50.beams
BEAT = 0.04
CLIMB = 0.25
"""m/s at most, up and down."""


def flat(height: float = -4.0) -> Ground:
    return lambda x, y: np.full(np.shape(x), height)


def slope(degrees: float, towards: float = 0.0, height: float = -4.0) -> Ground:
    """Rises towards a direction, radians."""
    gradient = math.tan(math.radians(degrees))
    return lambda x, y: height + gradient * (math.cos(towards) * x + math.sin(towards) * y)


def step(rise: float, at: float = 1.0, height: float = -4.0) -> Ground:
    """A wall across x, as a wreck's side."""
    return lambda x, y: np.where(np.asarray(x) > at, height + rise, height)


def tank(half: float = 1.85, height: float = -1.5) -> Ground:
    """A square one, with walls up to above the surface."""
    return lambda x, y: np.where(np.maximum(np.abs(x), np.abs(y)) < half, height, 1.0)


def relief(rng: np.random.Generator, steepest: float = 1.0, height: float = -4.0) -> Ground:
    """Waves of one to six metres each way, nowhere steeper than that."""
    lengths = rng.uniform(1.0, 6.0, 4)
    shares = rng.dirichlet(np.ones(4))
    angles, phases = rng.uniform(0.0, 2.0 * math.pi, 4), rng.uniform(0.0, 2.0 * math.pi, 4)
    numbers = 2.0 * math.pi / lengths

    def ground(x: Float64Array, y: Float64Array) -> Float64Array:
        x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
        total = np.full(x.shape, height)
        for k in range(4):
            along = math.cos(angles[k]) * x + math.sin(angles[k]) * y
            total += steepest * shares[k] / numbers[k] * np.sin(numbers[k] * along + phases[k])
        return total

    return ground


@dataclass
class Track:
    """A vehicle that is flown by what the seabed says, for as long as nobody stops it.

    It goes along with `speed` in directions that change, at altitudes that change; it looks to where the
    seabed's height and the altitude that is wanted lead it, no faster than `CLIMB`.
    """

    ground: Ground
    rng: np.random.Generator
    speed: float = 0.25
    altitudes: tuple[float, ...] = (2.0,)
    """Metres that are wanted, one after the other."""
    every: float = 12.0
    """Seconds for each, and for each heading."""
    start: float = -1.0
    """Metres in the world where it begins; as high above the ground as it first wants to be, where NaN."""
    noise: float = 0.015
    """Metres of an altitude."""
    lost: float = 0.02
    """Share of the beams that do not come back."""
    outages: float = 0.02
    """How often a second it has no lock for up to 3 s."""
    late: float = 0.05
    """Seconds by which the height is older than the echo."""
    tilt: float = 0.03
    """Radians by which it rolls and pitches."""
    straight: bool = False
    """Always along x."""
    fault: Callable[[float, float, float], float] = lambda time, altitude, z: altitude
    """What it says at a time, for an altitude, at a height."""
    gauge: Callable[[float], float] = lambda time: 0.0
    """What the height reads too much."""
    seabed: Seabed = field(default_factory=Seabed)
    time: float = 0.0

    place: tuple[float, float] = (-2.0, 0.0)
    """Where it begins, x and y."""

    def __post_init__(self) -> None:
        (self.x, self.y), self.yaw = self.place, 0.0
        here = self.height_of_ground()
        self.z = here + self.altitudes[0] if math.isnan(self.start) else self.start
        self.held = self.z
        self.heights = [(self.time, self.z)]
        self._next = self._silent = 0.0
        self._course = 0.0
        self._lean = np.zeros(2)
        self._error = 0.0
        self.alarms: list[tuple[float, str]] = []

    def height_of_ground(self) -> float:
        return float(self.ground(np.array(self.x), np.array(self.y)))

    def run(self, seconds: float) -> Iterator[Seabed]:
        """Swim on; the seabed after each beat."""
        end = self.time + seconds
        while self.time < end - 1e-9:
            self._beat()
            said = self.seabed.problem
            if said and (not self.alarms or self.alarms[-1][1] != said):
                self.alarms.append((self.time, said))
            yield self.seabed

    def fly(self, seconds: float) -> Track:
        for _ in self.run(seconds):
            pass
        return self

    def found(self, seconds: float) -> float:
        """Swim until a problem is told; when, in seconds from now, or inf."""
        began = self.time
        for seabed in self.run(seconds):
            if seabed.problem:
                return self.time - began
        return math.inf

    def _beat(self) -> None:
        rng, self.time = self.rng, self.time + BEAT
        leg = int(self.time / self.every)
        if int((self.time - BEAT) / self.every) != leg and not self.straight:
            self._course = rng.uniform(-math.pi, math.pi)
        pace = self.speed if leg % 4 != 3 else 0.0
        self.x += pace * math.cos(self._course) * BEAT + 2e-4 * rng.standard_normal()
        self.y += pace * math.sin(self._course) * BEAT + 2e-4 * rng.standard_normal()
        self.yaw += 0.3 * BEAT * math.sin(self._course - self.yaw)
        wanted = self.altitudes[leg % len(self.altitudes)]
        # Held where it is while the seabed is not known.
        if math.isnan(self.seabed.height) or self.seabed.age(self.time) > 1.0:
            target = self.held
        else:
            target, self.held = self.seabed.height + wanted, self.z + self.gauge(self.time)
        rate = min(max(0.8 * (target - self.z - self.gauge(self.time)), -CLIMB), CLIMB)
        rate += 0.02 * math.sin(1.7 * self.time)
        before = self.z
        self.z = max(self.z + rate * BEAT, self.height_of_ground() + 0.1)
        self.z = min(self.z, 0.0)
        self.heights.append((self.time, self.z))
        self._lean += 0.1 * (self.tilt * rng.standard_normal(2) - self._lean)
        self._error += 0.1 * (0.005 * rng.standard_normal() - self._error)
        if rng.random() < self.outages * BEAT:
            self._silent = self.time + rng.uniform(0.2, 3.0)
        if self.time >= self._next:
            self._ping((self.z - before) / BEAT, pace)

    def _ping(self, climb: float, pace: float) -> None:
        rng = self.rng
        at = np.array([self.x, self.y, self.z])
        pose = SE3(SE3.level(0.0, 0.0, 0.0, self.yaw).rotation @ _leaning(*self._lean), at)
        heights = [
            -beam[2] * _reach(self.ground, at, np.asarray(pose.rotation @ beam))
            for beam in BEAMS
            if rng.random() >= self.lost
        ]
        world = np.array([pace * math.cos(self._course), pace * math.sin(self._course), climb])
        velocity = pose.rotation.T @ world + 0.004 * rng.standard_normal(3)
        valid = len(heights) >= 3 and self.time >= self._silent
        altitude = float(np.mean(heights)) + self.noise * rng.standard_normal() if heights else math.nan
        self._next = self.time + 1.0 / next((rate for top, rate in RANGE_MODES if altitude <= top), 2.0)
        altitude = self.fault(self.time, max(altitude, 0.05), self.z)
        lag = min(round(self.late / BEAT), len(self.heights) - 1)
        z = self.heights[-1 - lag][1] + self._error + self.gauge(self.time)
        known = SE3(pose.rotation, np.array([self.x, self.y, z]))
        self.seabed.take(Dvl(self.time, velocity, 1e-5 * np.eye(3), altitude, valid), known)


def _leaning(roll: float, pitch: float) -> Float64Array:
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    return np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])


REACHES = np.arange(0.0, 12.0, 0.02)


def _reach(ground: Ground, origin: Float64Array, along: Float64Array) -> float:
    """Metres along a ray to the ground."""
    x, y, z = (origin[k] + REACHES * along[k] for k in range(3))
    above = z - ground(x, y)
    below = above <= 0.0
    if not below.any():
        return float(REACHES[-1])
    k = int(np.argmax(below))
    if k == 0:
        return 0.0
    share = min(above[k - 1] / max(above[k - 1] - above[k], 1e-9), 1.0)
    return float(REACHES[k - 1] + share * (REACHES[k] - REACHES[k - 1]))
