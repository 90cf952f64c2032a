"""Goal and estimate → commands on the wire: the two ways to move a vehicle that runs ArduSub."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.control import Pd, _kernels
from dream.control.autopilot import Autopilot, Helm
from dream.control.health import Watch
from dream.geometry import SE2, SE3, wrap_angle
from dream.measurements import Depth, Dvl, Heading, Imu
from dream.robots.bluerov2.bridge import Craft
from dream.robots.bluerov2.home import WayHome
from dream.robots.bluerov2.limits import LastResort
from dream.robots.bluerov2.mavlink import Link
from dream.robots.bluerov2.navigation import Fix, Instruments
from dream.robots.bluerov2.sticks import Joystick
from dream.sim.vehicle import BLUEROV2, BLUEROV2_HEAVY, Vehicle
from dream.types import BodyVelocity, Setpoint

GENTLE = Autopilot(
    position=1.5,
    velocity=4.0,
    disturbance=1.0,
    yaw=1.0,
    speed=0.25,
    acceleration=0.2,
    turn_rate=0.8,
    turn_acceleration=1.0,
)
"""Gains for a loop that is closed over a link: a tenth of a second passes from a motion to the thrusters that
answer it, twice the time of the loop that runs on the vehicle. Speeds for moves of decimetres in a tank."""
TURN_LAG = 0.35
"""Seconds by which the vehicle's heading follows a rate of turn that is asked for: ArduSub adds rates up to a
heading to be at, and its loop and thrusters take so long to be there (0.3 to 0.5 s, measured)."""
LEVEL_YAW, ASTRAY_YAW = math.radians(1.0), math.radians(2.5)
"""Radians of heading error below which the autopilot's own heading hold takes over, and from which on it is
turned again. In between is what it hunts by itself: two loops that answer each other never come to rest."""
CLIMB_LAG = 0.6
"""Seconds by which its height follows a rate of climb, likewise."""
LEVEL_DEPTH, ASTRAY_DEPTH = 0.01, 0.03
"""Metres of depth, likewise."""
RESTING = 1e-6
"""Radians, metres or either a second, by which a reference that rests may move: rounding keeps it from 0."""
NEAR, MOST_LEARNT = 0.3, 0.1
"""Metres from the goal within which it is learnt by what velocity an autopilot errs, and m/s at most."""
LEVEL = np.array([1.0, 1.0, 0.0])
"""Of a velocity in the world, what is level."""
STALE = 1.0
"""Seconds after which the autopilot's own height is none to reckon from."""


def vehicle_of(joystick: Joystick) -> Vehicle:
    """The vehicle that has these thrusters."""
    return BLUEROV2_HEAVY if joystick.thrusters.count == 8 else BLUEROV2


@dataclass(slots=True, eq=False)
class Lag:
    """What a reference was a while ago, and whether the vehicle is there: for what follows rates with a lag.

    What it does: the vehicle is compared with where the reference was `seconds` ago. What is under way
    already is no error, and is not asked for a second time. Once it is within `level` of a reference that
    rests it is left alone, until it is `astray`: two loops that answer each other never come to rest.
    """

    seconds: float
    level: float
    astray: float
    _past: deque[tuple[float, float]] = field(default_factory=deque)
    _there: bool = False

    def forget(self) -> None:
        """Begin anew."""
        self._past.clear()
        self._there = False

    @property
    def oldest(self) -> float:
        """What the reference was, as far back as that is known."""
        return self._past[0][1]

    def before(self, now: float, reference: float) -> float:
        """Note what the reference is, and say what it was."""
        self._past.append((now, reference))
        while len(self._past) > 1 and self._past[1][0] <= now - self.seconds:
            self._past.popleft()
        return self.oldest

    def holds(self, lacking: float, *, moving: bool) -> bool:
        """Is it there, and left to hold itself?"""
        self._there = not moving and abs(lacking) < (self.astray if self._there else self.level)
        return self._there


@dataclass(slots=True, eq=False)
class _Wired:
    """What both ways have in common: the link, and what is done in trouble."""

    link: Link
    joystick: Joystick
    home: WayHome
    autopilot: Autopilot = GENTLE
    turn: float = 0.8
    """1/s: rad/s for a radian of heading."""
    _helm: Helm | None = None
    _wrench: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros(6))
    _heading: Lag = field(default_factory=lambda: Lag(TURN_LAG, LEVEL_YAW, ASTRAY_YAW))

    def begin(self, fix: Fix) -> None:
        """The reference stands where the vehicle is; what was learnt of the water is kept."""
        vehicle = vehicle_of(self.joystick)
        before = self._helm
        self._helm = self.autopilot.begin(vehicle.hull, vehicle.thrusters, fix.T_world_base)
        if before is not None:
            self._helm.memory[8:10] = before.memory[8:10]
            self._helm.memory[12:14] = before.memory[12:14]
        self._heading.forget()

    def neutral(self) -> None:
        """Nothing shall move it."""
        self.link.operator_alive()
        self.link.stop()

    def release(self) -> None:
        """The link itself is silent while somebody else has the vehicle; it only stays there."""
        self.link.operator_alive()

    def resort(self, how: LastResort) -> None:
        """Leave the vehicle to its way home."""
        self.home.begin(how)

    def craft(self) -> Craft:
        """What the vehicle reports."""
        said = self.link.telemetry
        lost = self.link.armed_by_other if not said.armed else ""
        if said.reboots:
            lost = "the autopilot began anew"
        return Craft(
            armed=said.armed,
            link_age=said.heartbeat_age,
            voltage=said.voltage,
            depth=said.depth,
            own_depth=-said.own_altitude if said.own_altitude_age < STALE else math.nan,
            own_depth_from=said.own_altitude_from,
            own_depth_age=said.own_altitude_age,
            imu_heard=said.imu_heard,
            slipped=said.slipped,
            status_age=said.status_age,
            leak=said.leak,
            taken=self.link.yielding,
            surfacing=self.link.surfacing,
            lost=lost,
        )

    def _reference(self, fix: Fix, goal: SE2, dt: float, pace: float) -> Helm:
        """The helm, its reference one beat on.

        Height is the autopilot's: the reference has the vehicle's, and neither climbs. Else the limit of its
        acceleration would be spent on that, and it would not brake before its goal.
        """
        helm = self._helm
        assert helm is not None
        height = float(fix.T_world_base.translation[2])
        helm.memory[2], helm.memory[6], helm.memory[10] = height, 0.0, 0.0
        self._wrench = helm.demand(
            fix.T_world_base,
            fix.velocity * LEVEL,
            fix.angular_velocity,
            (goal.x, goal.y, height, goal.yaw),
            dt,
            pace=pace,
        )
        helm.memory[11] = 0.0
        return helm

    def _turn_rate(self, helm: Helm, fix: Fix) -> float:
        """rad/s that follow the reference's heading; exactly 0 where the autopilot can hold it itself.

        The paper's law (Eq. 11) with k_r = 0, about where the reference was `TURN_LAG` ago: what is under way
        already is no error, and is not asked for a second time.
        """
        reference, rate = float(helm.memory[3]), float(helm.memory[7])
        lacking = wrap_angle(self._heading.before(fix.time, reference) - fix.T_world_base.yaw)
        moving = abs(wrap_angle(reference - self._heading.oldest)) > RESTING or abs(rate) > RESTING
        if self._heading.holds(lacking, moving=moving):
            return 0.0
        asked = _kernels.track(lacking, 0.0, rate, self.turn, 0.0)
        return _within(asked, 1.5 * self.autopilot.turn_rate)


@dataclass(slots=True, eq=False)
class AltHold(_Wired):
    """Forces, turns and climbs by the sticks, in ALT_HOLD: the autopilot holds depth and attitude.

    What it does: the horizontal part of what `Autopilot` asks for becomes x and y of MANUAL_CONTROL through
    the thrusters' curve; its heading becomes a rate of turn, and what the height lacks a rate of climb. Both
    expire with the sticks: an autopilot that hears no more holds the depth and the heading that it has.
    Rates have no zero that could be misunderstood, as depth targets have: ArduSub takes those from the origin
    of its estimate, and tells its own depth from elsewhere where a receiver or an origin is set up.
    Assumes: no position fix of the autopilot; works with whatever it is.
    """

    climb: float = 0.5
    """1/s: m/s upwards for a metre of height."""
    _effort: float = 0.0
    _height: Lag = field(default_factory=lambda: Lag(CLIMB_LAG, LEVEL_DEPTH, ASTRAY_DEPTH))
    _reference_z: float = math.nan

    def begin(self, fix: Fix) -> None:
        """See `bridge.Drive`."""
        _Wired.begin(self, fix)
        self._height.forget()
        self._reference_z = float(fix.T_world_base.translation[2])

    @property
    def effort(self) -> float:
        """Share of what it may ask of the horizontal thrusters that it asks now."""
        return self._effort

    def steer(self, fix: Fix, goal: SE2, z: float, dt: float, pace: float, expires: float) -> None:
        """See `bridge.Drive`."""
        helm = self._reference(fix, goal, dt, pace)
        ahead, left = float(self._wrench[0]), float(self._wrench[1])
        sticks = self.joystick.sticks(
            ahead, left, turn_rate=self._turn_rate(helm, fix), climb_rate=self._climb_rate(fix, z, dt, pace)
        )
        full = max(abs(sticks.x), abs(sticks.y)) >= 1000
        self._effort = max(abs(sticks.x), abs(sticks.y), abs(sticks.r)) / 1000.0
        helm.learn(0.99 if full else 1.0, dt)
        self.link.operator_alive()
        self.link.command(sticks, expires)

    def _climb_rate(self, fix: Fix, z: float, dt: float, pace: float) -> float:
        """m/s upwards that follow a height; exactly 0 where the autopilot can hold the depth itself."""
        most = pace * self.autopilot.speed
        step = _within(z - self._reference_z, most * dt)
        self._reference_z += step
        lacking = self._height.before(fix.time, self._reference_z) - float(fix.T_world_base.translation[2])
        moving = max(abs(self._reference_z - self._height.oldest), abs(step)) > RESTING
        if self._height.holds(lacking, moving=moving):
            return 0.0
        return _within(step / dt + self.climb * lacking, 1.5 * most)


@dataclass(slots=True, eq=False)
class Guided(_Wired):
    """Velocities, in GUIDED: the autopilot closes the loops of velocity, attitude and depth.

    What it does: the paper's law with K_d = 0 straight to the goal, no faster than the reference may be; the
    heading follows the reference. A velocity loop that is slow to speed up makes of a reference that speeds
    up and slows down, and is followed, an overshoot of a third of a move of 0.2 m; of this it makes none.
    Assumes: an autopilot that knows its position, or it refuses the mode; and that speeds up and slows down
    by `law.K_p` times `autopilot.speed` a second, 0.15 m/s².
    Fails when: its own velocity loop is slower than that: it overshoots.
    """

    law: Pd = field(default_factory=lambda: Pd(K_p=0.6, K_d=0.0, k_psi=0.0, k_r=0.0))
    climb: float = 0.8
    """1/s: m/s upwards for a metre of height."""
    bias: float = 0.1
    """1/s²: how fast it is learnt by what velocity the autopilot errs. Its position is a receiver's or some
    other program's, and its thrusters leave a few centimetres a second undone."""
    turn: float = 0.3
    """1/s: less than with sticks, since a rate of 0 is a heading that the vehicle swings about here."""
    _heading: Lag = field(default_factory=lambda: Lag(TURN_LAG, 2.0 * LEVEL_YAW, 1.6 * ASTRAY_YAW))
    _learnt: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    """(2,) m/s in the world that are added, since the autopilot falls short of them."""

    @property
    def effort(self) -> float:
        """Share of the hardest working thruster: the autopilot pushes until its velocities are met."""
        thrust = self.link.telemetry.thrust
        return 0.0 if math.isnan(thrust) else thrust

    def steer(self, fix: Fix, goal: SE2, z: float, dt: float, pace: float, expires: float) -> None:
        """See `bridge.Drive`."""
        helm = self._reference(fix, goal, dt, pace)
        still = BodyVelocity(0.0, 0.0, 0.0, 0.0)
        # Eq. 9–10 with K_d = 0. The goal rests, and the heading has its own way, as with sticks.
        wanted = self.law.track(fix.T_world_base.se2, still, Setpoint(goal.x, goal.y, goal.yaw, 0.0))
        most = pace * self.autopilot.speed
        slower = min(1.0, most / max(math.hypot(wanted.surge, wanted.sway), 1e-9))
        surge, sway = self._learn(fix, goal, dt)
        lacking = z - float(fix.T_world_base.translation[2])
        velocity = BodyVelocity(
            surge=slower * wanted.surge + surge,
            sway=slower * wanted.sway + sway,
            heave=_within(self.climb * lacking, most),
            yaw_rate=self._turn_rate(helm, fix),
        )
        self.link.operator_alive()
        self.link.command(velocity, expires)

    def _learn(self, fix: Fix, goal: SE2, dt: float) -> tuple[float, float]:
        """m/s ahead and to the left by which the autopilot falls short, learnt near the goal."""
        pose = fix.T_world_base.se2
        if pose.distance(goal) < NEAR:
            self._learnt += self.bias * dt * np.array([goal.x - pose.x, goal.y - pose.y])
            self._learnt *= min(1.0, MOST_LEARNT / max(float(np.linalg.norm(self._learnt)), 1e-9))
        ahead, left = _kernels.into_body(pose.yaw, *self._learnt)
        return ahead, left


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)


def rehearse(estimator: str) -> None:
    """Estimate and steer once, with no vehicle: what is compiled then does not keep a real one waiting."""
    filtering = Instruments(estimator=estimator).filter
    pose = SE3.level(0.0, 0.0, -1.0, 0.0)
    state: Any = filtering.begin(0.0, pose)
    still = np.zeros(3)
    state = filtering.predict(state, Imu(0.02, still, np.array([0.0, 0.0, 9.81])), 0.02)
    for measurement in (
        Dvl(0.02, still, 1e-4 * np.eye(3), 1.0, True),
        Depth(0.02, -1.0, 0.01),
        Heading(0.02, 0.0, 0.05),
    ):
        state = filtering.correct(state, measurement)
    for vehicle in (BLUEROV2, BLUEROV2_HEAVY):
        helm = GENTLE.begin(vehicle.hull, vehicle.thrusters, pose)
        wrench = helm.demand(pose, still, still, (0.1, 0.0, -1.0, 0.1), 0.04)
        helm.learn(1.0, 0.04)
        Pd().track(pose.se2, BodyVelocity(0.0, 0.0, 0.0, 0.0), Setpoint(0.1, 0.0, 0.1, 0.0))
        Joystick(thrusters=vehicle.thrusters).sticks(float(wrench[0]), float(wrench[1]), turn_rate=0.1)
    Watch().condition(imu_age=0.0, depth_age=0.0, dvl_age=0.0, velocity_sigma=0.0, position_sigma=0.0)
