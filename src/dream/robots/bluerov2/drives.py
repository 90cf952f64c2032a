"""Goal and estimate → commands on the wire: the two ways to move a vehicle that runs ArduSub."""

from __future__ import annotations

import contextlib
import logging
import math
import threading
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.control import Pd
from dream.control.autopilot import Autopilot, Helm
from dream.control.health import Watch
from dream.geometry import SE2, SE3, wrap_angle
from dream.measurements import Depth, Dvl, Heading, Imu
from dream.robots.bluerov2.bridge import Craft, LastResort
from dream.robots.bluerov2.mavlink import Link, Refused
from dream.robots.bluerov2.navigation import Fix, Instruments
from dream.robots.bluerov2.sticks import Joystick
from dream.sim.vehicle import BLUEROV2, BLUEROV2_HEAVY, Vehicle
from dream.types import BodyVelocity, Setpoint

logger = logging.getLogger(__name__)

GENTLE = Autopilot(
    position=1.5,
    velocity=4.0,
    disturbance=1.0,
    yaw=2.0,
    speed=0.25,
    acceleration=0.2,
    turn_rate=0.8,
    turn_acceleration=1.0,
)
"""Gains for a loop that is closed over a link: a tenth of a second passes from a motion to the thrusters that
answer it, twice the time of the loop that runs on the vehicle. Speeds for moves of decimetres in a tank."""
LEVEL_YAW = math.radians(0.5)
"""Radians of heading error at which the autopilot's own heading hold takes over."""
DEPTH_STEP = 0.01
"""Metres by which a depth target has to change before it is sent again."""
DEPTH_EVERY = 0.3
"""Seconds after which it is sent again anyway: a packet may be lost, and on its way it is farther."""
STALE = 1.0
"""Seconds after which the autopilot's own height is none to reckon from."""
CARROT = 0.25
"""Metres that a depth target may be away."""
HIGHEST = -0.05
"""Metres in the autopilot's reckoning: no target is above the surface."""


def vehicle_of(joystick: Joystick) -> Vehicle:
    """The vehicle that has these thrusters."""
    return BLUEROV2_HEAVY if joystick.thrusters.count == 8 else BLUEROV2


@dataclass(slots=True, eq=False)
class _Wired:
    """What both ways have in common: the link, and what is done in trouble."""

    link: Link
    joystick: Joystick
    autopilot: Autopilot = GENTLE
    _helm: Helm | None = None
    _wrench: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros(6))
    _resorting: threading.Thread | None = None

    def begin(self, fix: Fix) -> None:
        """The reference stands where the vehicle is; what was learnt of the water is kept."""
        vehicle = vehicle_of(self.joystick)
        before = self._helm
        self._helm = self.autopilot.begin(vehicle.hull, vehicle.thrusters, fix.T_world_base)
        if before is not None:
            self._helm.memory[8:10] = before.memory[8:10]
            self._helm.memory[12:14] = before.memory[12:14]

    def neutral(self) -> None:
        """Nothing shall move it."""
        self.link.operator_alive()
        self.link.stop()

    def release(self) -> None:
        """The link itself is silent while somebody else has the vehicle; it only stays there."""
        self.link.operator_alive()

    def resort(self, how: LastResort) -> None:
        """Ask for it, on a thread of its own: an answer may take a while, or never come."""
        self._resorting = threading.Thread(target=self._resort, args=(how,), name="resort", daemon=True)
        self._resorting.start()

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
            leak=said.leak,
            taken=self.link.yielding,
            lost=lost,
        )

    def _resort(self, how: LastResort) -> None:
        try:
            if how is LastResort.SURFACE:
                self.link.set_mode("SURFACE")
            elif how is LastResort.DISARM:
                self.link.disarm()
            else:
                self.link.set_mode("ALT_HOLD")
        except (Refused, OSError, RuntimeError) as error:
            logger.warning("the last resort, %s, was not taken: %s", how, error)

    def _reference(self, fix: Fix, goal: SE2, dt: float, pace: float) -> Helm:
        """The helm, its reference one beat on. Height is the autopilot's: the reference has the vehicle's."""
        helm = self._helm
        assert helm is not None
        height, climb = float(fix.T_world_base.translation[2]), float(fix.velocity[2])
        helm.memory[2], helm.memory[6], helm.memory[10] = height, climb, 0.0
        self._wrench = helm.demand(
            fix.T_world_base,
            fix.velocity,
            fix.angular_velocity,
            (goal.x, goal.y, height, goal.yaw),
            dt,
            pace=pace,
        )
        helm.memory[11] = 0.0
        return helm

    def _turn_rate(self, helm: Helm, fix: Fix) -> float:
        """rad/s that follow the reference's heading; exactly 0 where the autopilot can hold it itself."""
        lacking = wrap_angle(float(helm.memory[3]) - fix.T_world_base.yaw)
        rate = float(helm.memory[7])
        if rate == 0.0 and abs(lacking) < LEVEL_YAW:
            return 0.0
        most = 1.5 * self.autopilot.turn_rate
        return min(max(rate + self.autopilot.yaw * lacking, -most), most)


@dataclass(slots=True, eq=False)
class AltHold(_Wired):
    """Forces by the sticks, in ALT_HOLD: the autopilot holds depth and attitude, DREAM the place.

    What it does: the horizontal part of what `Autopilot` asks for becomes x and y of MANUAL_CONTROL through
    the thrusters' curve, its heading a turn rate; the depth is a target of its own.
    Assumes: no position fix of the autopilot; works with whatever it is.
    """

    _depth_sent: tuple[float, float] = (math.inf, -math.inf)

    def neutral(self) -> None:
        """Nothing shall move it: also no depth that it was on its way to."""
        _Wired.neutral(self)
        if math.isfinite(self._depth_sent[0]):
            self._send_depth(0.0)
            self._depth_sent = (math.inf, -math.inf)

    def steer(self, fix: Fix, goal: SE2, z: float, dt: float, pace: float, expires: float) -> None:
        """See `bridge.Drive`."""
        helm = self._reference(fix, goal, dt, pace)
        ahead, left = float(self._wrench[0]), float(self._wrench[1])
        sticks = self.joystick.sticks(ahead, left, turn_rate=self._turn_rate(helm, fix))
        full = max(abs(sticks.x), abs(sticks.y)) >= 1000
        helm.learn(0.99 if full else 1.0, dt)
        self.link.operator_alive()
        self.link.command(sticks, expires)
        # A target outlives whoever sent it, so none is ever far away.
        step = _within(z - float(fix.T_world_base.translation[2]), CARROT)
        sent, at = self._depth_sent
        if abs(step - sent) > DEPTH_STEP or fix.time - at > DEPTH_EVERY:
            self._send_depth(step)
            self._depth_sent = (step, fix.time)

    def _send_depth(self, step: float) -> None:
        """Have it go up by so many metres from where it is by its own reckoning, whose zero is not ours."""
        said = self.link.telemetry
        own = said.own_altitude
        if math.isfinite(own) and said.own_altitude_age < STALE:
            # Refused only where somebody changed the mode just now: the next beat finds that out.
            with contextlib.suppress(RuntimeError):
                self.link.depth_target(min(own + step, HIGHEST))


@dataclass(slots=True, eq=False)
class Guided(_Wired):
    """Velocities, in GUIDED: the autopilot closes the loops of velocity, attitude and depth.

    What it does: the paper's proportional law straight to the goal, no faster than the reference may be; the
    heading follows the reference. A velocity loop that is slow to speed up makes of a reference that speeds
    up and slows down, and is followed, an overshoot of a third of a move of 0.2 m; of this it makes none.
    Assumes: an autopilot that knows its position, or it refuses the mode; and that speeds up and slows down
    by `law.K_p` times `autopilot.speed` a second, 0.15 m/s².
    Fails when: its own velocity loop is slower than that: it overshoots.
    """

    law: Pd = field(default_factory=lambda: Pd(K_p=0.6, K_d=0.0, k_psi=0.0, k_r=0.0))
    climb: float = 0.8
    """1/s: m/s upwards for a metre of height."""

    def steer(self, fix: Fix, goal: SE2, z: float, dt: float, pace: float, expires: float) -> None:
        """See `bridge.Drive`."""
        helm = self._reference(fix, goal, dt, pace)
        still = BodyVelocity(0.0, 0.0, 0.0, 0.0)
        wanted = self.law.track(fix.T_world_base.se2, still, Setpoint(goal.x, goal.y, goal.yaw, 0.0))
        most = pace * self.autopilot.speed
        slower = min(1.0, most / max(math.hypot(wanted.surge, wanted.sway), 1e-9))
        lacking = z - float(fix.T_world_base.translation[2])
        velocity = BodyVelocity(
            surge=slower * wanted.surge,
            sway=slower * wanted.sway,
            heave=_within(self.climb * lacking, most),
            yaw_rate=self._turn_rate(helm, fix),
        )
        self.link.operator_alive()
        self.link.command(velocity, expires)


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
        Joystick(thrusters=vehicle.thrusters).sticks(float(wrench[0]), float(wrench[1]), turn_rate=0.1)
    Watch().condition(imu_age=0.0, depth_age=0.0, dvl_age=0.0, velocity_sigma=0.0, position_sigma=0.0)
