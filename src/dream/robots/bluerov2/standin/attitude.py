"""Inertial samples, compass and depth gauge → attitude and depth, as the stand-in's autopilot knows them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dream.geometry import wrap_angle
from dream.measurements import Depth, Heading, Imu
from dream.vehicle import GRAVITY

CALIBRATED = 1.0
"""Seconds after it starts over which turn rates and force are averaged for their bias."""
LEVELLING = 0.15
"""rad/s by which a radian of tilt against the felt vertical is turned back."""
LEARNING = 0.003
"""rad/s² by which the bias follows it."""
TURNING = 0.05
"""Share of a compass error that a reading takes away."""
SETTLING = (0.3, 0.4, 0.15)
"""Share of a depth error that a reading takes from depth, and how much it changes vertical speed (1/s) and
bias (1/s²) by it."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Where its estimate has its zero."""

    lat: int
    """Degrees, times 1e7."""
    lon: int
    alt: float
    """Metres above the sea, as somebody believes."""


class Ahrs:
    """Attitude, heading and depth by a complementary filter.

    What it does: turns with the gyroscopes, is levelled slowly by the accelerometers where they feel about
    one gravity, and turned slowly to the compass (Mahony, Hamel and Pflimlin, 2008). Depth is integrated from
    the vertical force and corrected by the gauge.
    Assumes: held still for the first second, which frees the gyroscopes of their bias. Much simpler than
    ArduSub's EKF3; its errors are of the same kind.
    """

    __slots__ = ("_lift_bias", "_still", "bias", "climb", "deviation", "lift", "q", "rates", "z")

    def __init__(self, imu: Imu, heading: Heading, depth: Depth) -> None:
        """Begin at the attitude that the first readings say."""
        self.deviation = 0.0
        """Radians to the left by which it takes its compass to be wrong, and is wrong itself."""
        x, y, z = imu.specific_force.tolist()
        pitch, roll = math.atan2(-x, math.hypot(y, z)), math.atan2(y, z)
        self.q = quaternion(roll, pitch, heading.yaw)
        """wxyz, `R_world_base`."""
        self.bias = [0.0, 0.0, 0.0]
        self.rates = (0.0, 0.0, 0.0)
        """rad/s in `base`, less the bias."""
        self.z, self.climb = depth.z, 0.0
        """Metres in the world, and m/s upwards."""
        self.lift = 0.0
        """m/s² upwards."""
        self._lift_bias = 0.0
        self._still: list[tuple[float, float, float, float]] = []

    @property
    def euler(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw in radians, forward-left-up: pitch is positive nose down."""
        w, x, y, z = self.q
        return (
            math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0)),
            math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        )

    def feel(self, imu: Imu, dt: float) -> None:
        """An inertial sample that ended dt seconds after the last."""
        p, q, r = imu.angular_velocity.tolist()
        fx, fy, fz = imu.specific_force.tolist()
        still = self._still
        calibrating = len(still) * dt < CALIBRATED
        if calibrating:
            still.append((p, q, r, math.sqrt(fx * fx + fy * fy + fz * fz)))
            *self.bias, felt = (sum(column) / len(still) for column in zip(*still, strict=True))
            self._lift_bias = felt - GRAVITY
        bias = self.bias
        p, q, r = p - bias[0], q - bias[1], r - bias[2]
        self.rates = (p, q, r)
        w, x, y, z = self.q
        ux, uy, uz = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
        size = math.sqrt(fx * fx + fy * fy + fz * fz)
        if 0.9 * GRAVITY < size < 1.1 * GRAVITY:
            ex, ey, ez = (
                (fy * uz - fz * uy) / size,
                (fz * ux - fx * uz) / size,
                (fx * uy - fy * ux) / size,
            )
            p, q, r = p + LEVELLING * ex, q + LEVELLING * ey, r + LEVELLING * ez
            bias[0] -= LEARNING * ex * dt
            bias[1] -= LEARNING * ey * dt
            bias[2] -= LEARNING * ez * dt
        h = 0.5 * dt
        w, x, y, z = (
            w + h * (-x * p - y * q - z * r),
            x + h * (w * p + y * r - z * q),
            y + h * (w * q - x * r + z * p),
            z + h * (w * r + x * q - y * p),
        )
        length = math.sqrt(w * w + x * x + y * y + z * z)
        self.q = (w / length, x / length, y / length, z / length)
        if calibrating:
            return
        self.lift = ux * fx + uy * fy + uz * fz - GRAVITY - self._lift_bias
        self.climb += self.lift * dt
        self.z += self.climb * dt

    def face(self, heading: Heading) -> None:
        """A reading of the compass."""
        self._turn(TURNING * self._off(heading))

    def deviate(self, deviation: float) -> float:
        """Take the compass to be wrong by so much; by how much is its own heading another?"""
        turned = wrap_angle(deviation - self.deviation)
        self.deviation = deviation
        self._turn(turned)
        return turned

    def align(self, heading: Heading) -> float:
        """Take a reading of the compass for the heading; by how much is it another?"""
        turned = self._off(heading)
        self._turn(turned)
        return turned

    def _off(self, heading: Heading) -> float:
        return wrap_angle(heading.yaw + self.deviation - self.euler[2])

    def _turn(self, angle: float) -> None:
        c, s = math.cos(0.5 * angle), math.sin(0.5 * angle)
        w, x, y, z = self.q
        self.q = (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)

    def sink(self, depth: Depth) -> None:
        """A reading of the gauge."""
        off = depth.z - self.z
        self.z += SETTLING[0] * off
        self.climb += SETTLING[1] * off
        self._lift_bias -= SETTLING[2] * off


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """wxyz of a rotation by roll, pitch and yaw, the last first."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
