"""Attitude and depth, and what is wanted of them → what ArduSub asks of its motors.

Cascades of proportional and integral terms on the stand-in's own attitude filter. Gains that ArduSub has a
parameter for are its defaults; how they act was fitted to what a real one did in the same tank
(`tests/recorded/ardusub`). Axes are forward-right-down, outputs in [−1, 1] as `motors.mixed` takes them.
"""

from __future__ import annotations

import math

from dream.geometry import wrap_angle
from dream.robots.bluerov2.standin.attitude import Ahrs

ANGLE = 6.0
"""rad/s for a radian of attitude error (ATC_ANG_*_P)."""
TURN = ((0.135, 0.09, 0.444), (0.135, 0.09, 0.444), (0.18, 0.018, 0.222))
"""Output for an error of one rad/s, by how much it grows a second, and the most that grows to, in roll, pitch
and yaw (ATC_RAT_*)."""
YAW_LAG = 1.0 / (2.0 * math.pi * 5.0)
"""Seconds by which the rate that yaw is asked for lags (ATC_RAT_YAW_FLTT)."""
EASE = 0.1
"""Seconds in which the heading that is steered at takes up a rate (ATC_INPUT_TC)."""
SLEW = math.radians(60.0)
"""rad/s at most with which it goes to another heading (ATC_SLEW_YAW)."""
AHEAD = math.radians(30.0)
"""Radians at most that it is ahead of the vehicle."""
RISE = 3.0
"""m/s for a metre of depth error (PSC_POSZ_P)."""
CLIMB = 8.0
"""m/s² for an error of one m/s (PSC_VELZ_P)."""
CLIMB_LAG = 1.0 / (2.0 * math.pi * 5.0)
"""Seconds by which that error is smoothed (PSC_VELZ_FLTE)."""
LIFT = (0.1, 0.02, 1.0)
"""Output for an error of one m/s², by how much it grows a second, and the most that grows to (PSC_ACCZ_*; the
most is more than PSC_ACCZ_IMAX says)."""
LIFT_LAG = 1.0 / (2.0 * math.pi * 20.0)
"""Seconds by which that error is smoothed (PSC_ACCZ_FLTE)."""
WAY = 1.0
"""m/s for a metre of position error (PSC_POSXY_P)."""
SPEED = (0.78, 0.065)
"""Output for an error of one m/s over ground, and growth (PSC_VELXY_*, as a lean of 45° is all there is)."""
SPEED_LAG = 1.0 / (2.0 * math.pi * 5.0)
"""Seconds by which that error is smoothed (PSC_VELXY_FLTE)."""


class Loops:
    """The integrators, and the targets that move by themselves."""

    __slots__ = (
        "_climb",
        "_force",
        "_lift",
        "_rate",
        "_slow",
        "_speed",
        "_spent",
        "_swing",
        "_throttle",
        "_turn",
        "_yaw",
        "aim",
        "z",
    )

    def __init__(self, z: float, yaw: float) -> None:
        """Begin at rest at a height and a heading."""
        self.relax(z, yaw)

    def relax(self, z: float, yaw: float) -> None:
        """Forget all errors, and hold these."""
        self.aim = yaw
        """Radians clockwise from north that it steers at."""
        self._swing = self._yaw = 0.0
        self._turn = [0.0, 0.0, 0.0]
        self._throttle = 0.0
        self.hold(z, 0.0)

    def hold(self, z: float, climb: float) -> None:
        """Hold this height, coming to it at this speed, with no jump of the throttle; forget the way."""
        self.z = z
        """Metres in the world that it holds."""
        self._rate = climb
        self._climb = self._force = self._spent = 0.0
        self._lift = _bounded(self._throttle, LIFT[2])
        self._slow = [0.0, 0.0]
        self._speed = [0.0, 0.0]

    def head(self, yaw: float, heading: float | None, turn: float, dt: float) -> float:
        """The rate of turn, clockwise, that leads to a heading, or turns at a rate where there is none."""
        if heading is not None:
            turn = _bounded(wrap_angle(heading - self.aim) / EASE, SLEW)
        self._swing += (turn - self._swing) * dt / (EASE + dt)
        off = _bounded(wrap_angle(self.aim - yaw) + self._swing * dt, AHEAD)
        self.aim = wrap_angle(yaw + off)
        return ANGLE * off + self._swing

    def attitude(
        self, ahrs: Ahrs, roll: float, pitch: float, turn: float, dt: float
    ) -> tuple[float, float, float]:
        """Roll, pitch and yaw outputs for these angles and this rate of turn, clockwise."""
        r, p, _ = ahrs.euler
        self._yaw += (turn - self._yaw) * dt / (YAW_LAG + dt)
        wanted = (ANGLE * (roll - r), ANGLE * (pitch + p), self._yaw)
        rates = (ahrs.rates[0], -ahrs.rates[1], -ahrs.rates[2])
        out = []
        for k, (gain, growth, most) in enumerate(TURN):
            error = wanted[k] - rates[k]
            self._turn[k] = _bounded(self._turn[k] + growth * error * dt, most)
            out.append(_bounded(gain * error + self._turn[k], 1.0))
        return out[0], out[1], out[2]

    def depth(
        self, ahrs: Ahrs, climb: float, fastest: float, acceleration: float, most: float, dt: float
    ) -> float:
        """Throttle, at most so much, that follows a climb rate and holds depth where it is zero.

        The target stays where the vehicle, at its fastest, could still stop for it, and does not run on while
        the throttle is at its end.
        """
        self._rate += _bounded(climb - self._rate, acceleration * dt)
        if self._rate * self._spent <= 0.0:
            self.z += self._rate * dt
        near = acceleration / RISE**2
        leash = 0.5 * near + 0.5 * fastest**2 / acceleration
        self.z = min(max(self.z, ahrs.z - leash), ahrs.z + leash)
        off = self.z - ahrs.z
        fast = RISE * off
        if abs(off) > near:
            fast = math.copysign(math.sqrt(2.0 * acceleration * (abs(off) - 0.5 * near)), off)
        self._climb += (fast + self._rate - ahrs.climb - self._climb) * dt / (CLIMB_LAG + dt)
        self._force += (CLIMB * self._climb - ahrs.lift - self._force) * dt / (LIFT_LAG + dt)
        gain, growth, bound = LIFT
        grown = _bounded(self._lift + growth * self._force * dt, bound)
        free = gain * self._force + grown
        self._throttle = min(max(free, -1.0), most)
        self._spent = free - self._throttle
        # What the output cannot follow makes it grow no further.
        if self._spent == 0.0 or abs(grown) < abs(self._lift):
            self._lift = grown
        return self._throttle

    def ground(
        self, velocity: tuple[float, float], wanted: tuple[float, float], yaw: float, dt: float
    ) -> tuple[float, float]:
        """Forward and lateral output for velocities over ground, north and east, at this heading."""
        c, s = math.cos(yaw), math.sin(yaw)
        north, east = wanted[0] - velocity[0], wanted[1] - velocity[1]
        out = []
        for k, error in enumerate((c * north + s * east, c * east - s * north)):
            self._slow[k] += (error - self._slow[k]) * dt / (SPEED_LAG + dt)
            self._speed[k] = _bounded(self._speed[k] + SPEED[1] * self._slow[k] * dt, 1.0)
            out.append(_bounded(SPEED[0] * self._slow[k] + self._speed[k], 1.0))
        return out[0], out[1]


def _bounded(value: float, most: float) -> float:
    return min(max(value, -most), most)
