"""Attitude and depth, and what is wanted of them → what ArduSub asks of its motors.

Cascades of proportional and integral terms on the stand-in's own attitude filter: they hold what ArduSub's
do, not how. Axes are forward-right-down, outputs in [−1, 1] as `motors.mixed` takes them.
"""

from __future__ import annotations

import math

from dream.geometry import wrap_angle
from dream.robots.bluerov2.standin.attitude import Ahrs

ANGLE = 5.0
"""rad/s for a radian of attitude error."""
HEADING = 3.0
"""rad/s for a radian of heading error."""
MOST_TURN = 1.0
"""rad/s that a heading error may ask for."""
TURN = ((0.25, 0.5), (0.25, 0.5), (0.4, 0.3))
"""Output for an error of one rad/s, and by how much it grows a second, in roll, pitch and yaw."""
DEAD, DEAD_WIDTH = 0.06, 0.03
"""Output that little turning is lifted by, over the dead band of the thrusters, and where it is little."""
RISE = 1.2
"""m/s for a metre of depth error."""
CLIMB = (1.2, 1.2)
"""Output for an error of one m/s, and growth."""
LEASH = 1.0
"""Metres that the depth target may run ahead of the vehicle."""
WAY = 0.7
"""m/s for a metre of position error."""
SPEED = (1.5, 1.0)
"""Output for an error of one m/s over ground, and growth."""
WAY_ACCELERATION = 0.15
"""m/s² by which a velocity target is approached: a step of 0.3 m/s makes 1.3 m in 6 s."""


class Loops:
    """The integrators, and the targets that move by themselves."""

    __slots__ = ("_climb", "_rate", "_speed", "_turn", "velocity", "z")

    def __init__(self, z: float) -> None:
        """Begin at rest at a height."""
        self.relax(z)

    def relax(self, z: float) -> None:
        """Forget all errors, and hold this height."""
        self.z = z
        """Metres in the world that it holds."""
        self.velocity = [0.0, 0.0]
        """m/s north and east that it steers at now."""
        self._turn = [0.0, 0.0, 0.0]
        self._climb = self._rate = 0.0
        self._speed = [0.0, 0.0]

    def attitude(
        self, ahrs: Ahrs, roll: float, pitch: float, turn: float, dt: float
    ) -> tuple[float, float, float]:
        """Roll, pitch and yaw outputs for these angles and this rate of turn, clockwise."""
        r, p, _ = ahrs.euler
        wanted = (ANGLE * (roll - r), ANGLE * (pitch + p), turn)
        rates = (ahrs.rates[0], -ahrs.rates[1], -ahrs.rates[2])
        yaw = self._axis(2, wanted, rates, dt)
        return (
            self._axis(0, wanted, rates, dt),
            self._axis(1, wanted, rates, dt),
            _bounded(yaw + DEAD * math.tanh(yaw / DEAD_WIDTH), 1.0),
        )

    def depth(self, ahrs: Ahrs, climb: float, acceleration: float, ceiling: float, dt: float) -> float:
        """Throttle that follows a climb rate and holds depth where it is zero; never above the ceiling."""
        self._rate += min(max(climb - self._rate, -acceleration * dt), acceleration * dt)
        self.z += self._rate * dt
        self.z = min(max(self.z, ahrs.z - LEASH), ahrs.z + LEASH, ceiling)
        error = RISE * (self.z - ahrs.z) + self._rate - ahrs.climb
        self._climb = _bounded(self._climb + CLIMB[1] * error * dt, 0.6)
        return _bounded(CLIMB[0] * error + self._climb, 1.0)

    def ground(
        self, velocity: tuple[float, float], wanted: tuple[float, float], yaw: float, dt: float
    ) -> tuple[float, float]:
        """Forward and lateral output for velocities over ground, north and east, at this heading."""
        for k in range(2):
            step = WAY_ACCELERATION * dt
            self.velocity[k] += min(max(wanted[k] - self.velocity[k], -step), step)
        c, s = math.cos(yaw), math.sin(yaw)
        north, east = self.velocity[0] - velocity[0], self.velocity[1] - velocity[1]
        out = []
        for k, error in enumerate((c * north + s * east, c * east - s * north)):
            self._speed[k] = _bounded(self._speed[k] + SPEED[1] * error * dt, 0.7)
            out.append(_bounded(SPEED[0] * error + self._speed[k], 1.0))
        return out[0], out[1]

    def _axis(
        self, k: int, wanted: tuple[float, float, float], rates: tuple[float, float, float], dt: float
    ) -> float:
        error = wanted[k] - rates[k]
        self._turn[k] = _bounded(self._turn[k] + TURN[k][1] * error * dt, 0.5)
        return _bounded(TURN[k][0] * error + self._turn[k], 1.0)


def towards(heading: float, yaw: float) -> float:
    """The rate of turn that takes a yaw to a heading, both clockwise from north."""
    return _bounded(HEADING * wrap_angle(heading - yaw), MOST_TURN)


def _bounded(value: float, most: float) -> float:
    return min(max(value, -most), most)
