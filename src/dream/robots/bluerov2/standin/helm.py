"""Mode, sticks and targets → what a stand-in ArduSub asks of its motors."""

from __future__ import annotations

import math

from dream.geometry import wrap_angle
from dream.robots.bluerov2.standin import motors
from dream.robots.bluerov2.standin.attitude import Ahrs
from dream.robots.bluerov2.standin.loops import WAY, Loops
from dream.robots.bluerov2.standin.motors import Channels
from dream.robots.bluerov2.standin.parameters import Parameters
from dream.robots.bluerov2.standin.tank import BEAT, Tank

STABILIZE, ALT_HOLD, GUIDED, SURFACE, POSHOLD, MANUAL = 0, 2, 4, 9, 16, 19
"""custom_mode of the modes that are here."""
MODES = {
    STABILIZE: "STABILIZE",
    ALT_HOLD: "ALT_HOLD",
    GUIDED: "GUIDED",
    SURFACE: "SURFACE",
    POSHOLD: "POSHOLD",
    MANUAL: "MANUAL",
}
NEED_POSITION = (GUIDED, POSHOLD)

GUIDED_TIMEOUT = 3.0
"""Seconds after which a velocity that is not repeated is forgotten; the rate of turn never is."""
RELEASED = 0.25
"""Seconds after the yaw stick is let go of in which the vehicle stops turning, before it holds a heading."""
BUFFER = 0.05
"""Metres by which it has to leave the surface again to be away from it."""
BOTTOMED = 1.0
"""Seconds of full thrust down without a way that make a bottom."""
OFF_BOTTOM = 0.1
"""Metres over a bottom that it then holds."""
STILL = 0.05
"""m/s that are no way."""
THROTTLE_UNIT = 1000.0 / 800.0
"""Units of throttle in a microsecond."""

Axes = tuple[float, float, float, float, float, float]
"""Roll, pitch, yaw, throttle, forward and lateral, in [−1, 1], as `motors.mixed` takes them."""


class ModeControl:
    """What the modes do.

    What it does: MANUAL passes the sticks on; STABILIZE levels and holds the heading; ALT_HOLD also holds
    depth, with the throttle for a climb rate; SURFACE climbs; POSHOLD also holds its place while forward and
    lateral are let go of; GUIDED follows setpoints. A yaw stick turns at a rate, and when it is let go of,
    the heading is held. At the surface depth is held at SURFACE_DEPTH at least, with little thrust upwards.

    Attitude, heading and depth are those of the filter; horizontal position and velocity are the truth.
    """

    _velocity: tuple[float, float, float]
    """Of GUIDED: north, east and up, m/s."""
    _turn: float | None
    """Of GUIDED: rad/s clockwise; None where a heading is held."""
    _target: tuple[float, float, float] | None
    """Of GUIDED: north, east and up, metres; None where it follows a velocity."""

    def __init__(self, tank: Tank, ahrs: Ahrs, parameters: Parameters) -> None:
        """In MANUAL, with sticks let go of."""
        self._tank, self._ahrs, self._parameters = tank, ahrs, parameters
        self.sticks = Channels()
        self.gain = 1.0
        self.pilot_lost = False
        """Is there nobody at the sticks?"""
        self.loops = Loops(ahrs.z, self.yaw)
        self.surfaced = False
        """Is it at the surface?"""
        self._down_since = math.inf
        self.adjust()
        self.relax()
        self.enter(MANUAL)

    def adjust(self) -> None:
        """Take the gain of the sticks from its parameter."""
        self.gain = min(max(self._parameters["JS_GAIN_DEFAULT"], 0.1), 1.0)

    def enter(self, mode: int) -> None:
        """Begin a mode: here, at this heading, without any target."""
        self.mode = mode
        self._turned_at = self._velocity_at = -math.inf
        self._velocity, self._turn, self._target = (0.0, 0.0, 0.0), None, None
        self.loops.hold(self._ahrs.z, self._ahrs.climb)
        self._heading, self._at = self.yaw, self.here
        if mode == MANUAL:
            self.sticks = Channels()

    def relax(self) -> None:
        """Hold what is now, as long as it is disarmed."""
        self.loops.relax(self._ahrs.z, self.yaw)
        self._heading, self._at = self.yaw, self.here
        self.surfaced, self._down_since = False, math.inf

    def look(self) -> None:
        """Is it at the surface?"""
        self.surfaced = self._ahrs.z > self._surface - (BUFFER if self.surfaced else 0.0)

    def swung(self, by: float) -> None:
        """What is known of the heading has leapt, clockwise: what is steered at leaps with it."""
        self.loops.aim = wrap_angle(self.loops.aim + by)

    @property
    def yaw(self) -> float:
        """Radians, clockwise from north."""
        return wrap_angle(0.5 * math.pi - self._ahrs.euler[2])

    @property
    def here(self) -> tuple[float, float]:
        """Metres north and east: the truth."""
        x, y, _ = self._tank.state.position.tolist()
        return y, x

    @property
    def over_ground(self) -> tuple[float, float]:
        """m/s north and east: the truth."""
        x, y, _ = self._tank.state.velocity_world.tolist()
        return y, x

    def follow(
        self,
        velocity: tuple[float, float, float],
        position: tuple[float, float, float] | None = None,
        *,
        heading: float | None = None,
        turn: float | None = None,
    ) -> None:
        """A setpoint of GUIDED: north, east and up; a heading outdoes a rate of turn."""
        self._velocity, self._target, self._velocity_at = velocity, position, self._tank.time
        self._turn = turn if heading is None else None
        if heading is not None:
            self._heading = heading

    def drift(self, velocity: tuple[float, float, float]) -> None:
        """A setpoint of GUIDED that says nothing of where to look."""
        self._velocity, self._target, self._velocity_at = velocity, None, self._tank.time

    def axes(self) -> Axes:
        """What is asked of the motors for the next beat."""
        sticks = self.sticks
        forward, lateral = motors.share(sticks.forward), motors.share(sticks.lateral)
        if self.mode == MANUAL:
            roll, pitch = motors.share(sticks.roll), motors.share(sticks.pitch)
            return roll, pitch, motors.share(sticks.yaw), motors.share(sticks.throttle), forward, lateral
        turn = self._stick_turn()
        if self.mode == STABILIZE:
            return (*self._held(turn), motors.share(sticks.throttle), forward, lateral)
        if self.mode == ALT_HOLD:
            return (*self._held(turn), self._depth_held(), forward, lateral)
        if self.mode == SURFACE:
            rising = 0.01 * min(self._parameters["WPNAV_SPEED_UP"], self._parameters["PILOT_SPEED_UP"])
            return (*self._levelled(None, turn), self._throttle(rising), forward, lateral)
        if self.mode == POSHOLD:
            return self._position_held(turn, forward, lateral)
        return self._guided(turn)

    def _position_held(self, turn: float, forward: float, lateral: float) -> Axes:
        axes, throttle = self._held(turn), self._depth_held()
        if forward != 0.0 or lateral != 0.0:
            self._at = self.here
            return (*axes, throttle, forward, lateral)
        return (*axes, throttle, *self._moved(self._way(self._at)))

    def _guided(self, turn: float) -> Axes:
        if self._tank.time - self._velocity_at > GUIDED_TIMEOUT:
            # The rate of turn is not forgotten: so it is on the vehicle.
            self._velocity = (0.0, 0.0, 0.0)
        if self._target is None:
            wanted, climb = self._velocity[:2], self._velocity[2]
        else:
            north, east, up = self._target
            way = self._way((north, east))
            wanted, climb = (way[0] + self._velocity[0], way[1] + self._velocity[1]), 0.0
            self.loops.z = up
        heading: float | None = self._heading
        if turn != 0.0 and not self.pilot_lost:
            self._heading, heading = self.yaw, None
        elif self._turn is not None:
            self._heading, heading, turn = self.yaw, None, self._turn
        return (*self._levelled(heading, turn), self._throttle(climb), *self._moved(wanted))

    def _way(self, to: tuple[float, float]) -> tuple[float, float]:
        """Velocity north and east towards a place, at most WPNAV_SPEED."""
        here = self.here
        north, east = WAY * (to[0] - here[0]), WAY * (to[1] - here[1])
        factor = min(1.0, 0.01 * self._parameters["WPNAV_SPEED"] / max(math.hypot(north, east), 1e-9))
        return factor * north, factor * east

    def _moved(self, wanted: tuple[float, float]) -> tuple[float, float]:
        return self.loops.ground(self.over_ground, wanted, self.yaw, BEAT)

    def _levelled(self, heading: float | None, turn: float) -> tuple[float, float, float]:
        """Roll, pitch and yaw outputs: level but for the sticks, to a heading or at a rate of turn."""
        most = math.radians(0.01 * self._parameters["ANGLE_MAX"])
        roll, pitch = self._share(2, self.sticks.roll), self._share(1, self.sticks.pitch)
        most /= max(math.hypot(roll, pitch), 1.0)
        rate = self.loops.head(self.yaw, heading, turn, BEAT)
        return self.loops.attitude(self._ahrs, most * roll, most * pitch, rate, BEAT)

    def _held(self, turn: float) -> tuple[float, float, float]:
        """The same for the stick's rate of turn; where it says none, for the heading that it left."""
        if turn != 0.0:
            self._turned_at = self._tank.time
        elif self._tank.time >= self._turned_at + RELEASED:
            return self._levelled(self._heading, 0.0)
        self._heading = self.yaw
        return self._levelled(None, turn)

    def _stick_turn(self) -> float:
        """rad/s clockwise."""
        dead = self.gain if self.mode == ALT_HOLD else 1.0
        share = self._share(4, self.sticks.yaw, dead)
        return math.radians(45.0 * self._parameters["ACRO_YAW_P"]) * share

    def _share(self, channel: int, pwm: int, dead: float = 1.0) -> float:
        """In [−1, 1]: a stick's pulse width from its middle, without its dead zone or a part of that."""
        trim, zone = self._parameters[f"RC{channel}_TRIM"], dead * self._parameters[f"RC{channel}_DZ"]
        beyond = max(abs(pwm - trim) - zone, 0.0)
        return math.copysign(min(beyond / (motors.HALF_PWM - zone), 1.0), pwm - trim)

    def _stick_climb(self) -> float:
        """m/s upwards."""
        up, down = self._speeds
        dead = min(max(self._parameters["THR_DZ"], 0.0), 400.0) * self.gain
        away = THROTTLE_UNIT * (self.sticks.throttle - self._parameters["RC3_TRIM"])
        if self.pilot_lost or abs(away) <= dead:
            return 0.0
        return math.copysign((up if away > 0.0 else down) * (abs(away) - dead) / (500.0 - dead), away)

    @property
    def _speeds(self) -> tuple[float, float]:
        """m/s up and down at most."""
        up, down = self._parameters["PILOT_SPEED_UP"], self._parameters["PILOT_SPEED_DN"]
        return 0.01 * up, 0.01 * (down or up)

    @property
    def _surface(self) -> float:
        return 0.01 * self._parameters["SURFACE_DEPTH"]

    def _depth_held(self) -> float:
        """Throttle for the stick, or for a depth off surface and bottom."""
        climb, loops, z = self._stick_climb(), self.loops, self._ahrs.z
        if climb == 0.0:
            if self.surfaced:
                loops.z = min(loops.z, self._surface)
            elif self._tank.time >= self._down_since + BOTTOMED:
                loops.z = max(loops.z, z + OFF_BOTTOM)
        least = self._parameters["SURFACE_MAX_THR"]
        return self._throttle(climb, least + (1.0 - least) * min(max(self._surface - z, 0.0), 1.0))

    def _throttle(self, climb: float, most: float = 1.0) -> float:
        ahrs, acceleration = self._ahrs, 0.01 * self._parameters["PILOT_ACCEL_Z"]
        out = self.loops.depth(ahrs, climb, max(self._speeds), acceleration, most, BEAT)
        if out > -1.0 or abs(ahrs.climb) > STILL:
            self._down_since = math.inf
        else:
            self._down_since = min(self._down_since, self._tank.time)
        return out
