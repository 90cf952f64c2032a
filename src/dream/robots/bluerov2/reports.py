"""MAVLink messages of ArduSub → measurements: units, frames and what is too strange to be true."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from dream.geometry import UNTRUE, wrap_angle
from dream.measurements import Depth, Heading, Imu

MODES = {
    0: "STABILIZE",
    1: "ACRO",
    2: "ALT_HOLD",
    3: "AUTO",
    4: "GUIDED",
    7: "CIRCLE",
    9: "SURFACE",
    16: "POSHOLD",
    19: "MANUAL",
    20: "MOTOR_DETECT",
    21: "SURFTRAK",
}
"""`custom_mode` of ArduSub's heartbeat."""
NUMBERS = {name: number for number, name in MODES.items()}

MOUNT_MESSAGES = ("MOUNT_STATUS", "MOUNT_ORIENTATION", "GIMBAL_DEVICE_ATTITUDE_STATUS")
"""What tells where the camera points; it may come from a component of its own."""

FRESH, SEA = 997.0, 1025.0
"""kg/m³."""
GRAVITY = 9.80665
"""m/s²: what ArduPilot takes a thousand mG for, and water to weigh."""
MOST_FORCE = 8.0 * GRAVITY
"""m/s². A vehicle of 10 kg in water feels no more, not even from a wall."""
MOST_TURN = 10.0
"""rad/s, likewise."""
PRESSURES = (500.0, 40_000.0)
"""hPa that the air over a mountain lake, and the water at 300 m with some to spare, have."""

SURFACE_PRESSURES = (300.0, 1200.0)
"""hPa that the air over any water has, with some to spare."""
PULSES = (800, 2200)
"""Microseconds of a servo's pulse."""
MOST_HEIGHT = 500.0
"""Metres from its own zero that a vehicle may say it is, either way."""


class Strange(ValueError):  # noqa: N818 - it names what the message is.
    """A message whose numbers cannot be true; its text says which."""


@dataclass(frozen=True, slots=True)
class Attitude:
    """Roll, pitch and yaw by the autopilot's own estimate: radians in `world` and `base`, yaw last."""

    roll: float
    """Positive: right side down."""
    pitch: float
    """Positive: nose down, as about the axis to the left."""
    yaw: float
    """0 = east, counter-clockwise."""


def imu_of(message: Any, time: float) -> Imu:
    """RAW_IMU, SCALED_IMU or SCALED_IMU2: mG and mrad/s, forward-right-down.

    ArduPilot's accelerometers tell specific force: level and at rest z is −1000 mG, which here is +g.

    Raises:
        Strange: More than a vehicle can feel.
    """
    force = np.array([message.xacc, -message.yacc, -message.zacc], np.float64) * (GRAVITY / 1000.0)
    rate = np.array([message.xgyro, -message.ygyro, -message.zgyro], np.float64) / 1000.0
    if not np.abs(force).max() <= MOST_FORCE:
        raise Strange("imu: force out of range")
    if not np.abs(rate).max() <= MOST_TURN:
        raise Strange("imu: turn rate out of range")
    return Imu(time, rate, force)


def attitude_of(message: Any) -> Attitude:
    """ATTITUDE (radians) or ATTITUDE_QUATERNION (w, x, y, z), forward-right-down in north-east-down.

    Raises:
        Strange: Not finite, or a quaternion that is not of length 1.
    """
    if message.get_type() == "ATTITUDE_QUATERNION":
        w, x, y, z = message.q1, message.q2, message.q3, message.q4
        if not abs(math.sqrt(w * w + x * x + y * y + z * z) - 1.0) <= UNTRUE:
            raise Strange("attitude: quaternion not of length 1")
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
        yaw_ned = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    else:
        roll, pitch, yaw_ned = message.roll, message.pitch, message.yaw
    if not all(math.isfinite(angle) and abs(angle) < 7.0 for angle in (roll, pitch, yaw_ned)):
        raise Strange("attitude: angle out of range")
    return Attitude(roll, 0.0 - pitch, wrap_angle(0.5 * math.pi - yaw_ned))


def heading_of(attitude: Attitude, time: float, sigma: float) -> Heading:
    """The yaw of an attitude as a measurement."""
    return Heading(time, attitude.yaw, sigma)


def pressure_of(message: Any) -> float:
    """SCALED_PRESSURE2: hPa, absolute.

    Raises:
        Strange: Neither air's nor that of any water a BlueROV2 bears.
    """
    pressure = float(message.press_abs)
    if not PRESSURES[0] <= pressure <= PRESSURES[1]:
        raise Strange("pressure: out of range")
    return pressure


def depth_of(pressure: float, surface: float, density: float, time: float, sigma: float) -> Depth:
    """Height of the pressure sensor, from hPa there and at the surface: z = −(p − p₀) / (ρ g)."""
    return Depth(time, -100.0 * (pressure - surface) / (density * GRAVITY), sigma)


def own_altitude_of(message: Any) -> float:
    """LOCAL_POSITION_NED or GLOBAL_POSITION_INT: metres up by the autopilot's own reckoning.

    The first comes where the autopilot has a position, and counts from the origin of its estimate. The second
    comes always; its `relative_alt` counts from there without a position, and with one from a home, and is
    then above sea level (`Sub::get_alt_rel`). VFR_HUD.alt and `alt` always are, or 0 without an origin.

    Raises:
        Strange: Not finite, or deeper or higher than a BlueROV2 gets.
    """
    local = message.get_type() == "LOCAL_POSITION_NED"
    altitude = -float(message.z) if local else float(message.relative_alt) / 1000.0
    if not abs(altitude) <= MOST_HEIGHT:
        raise Strange("own altitude: out of range")
    return altitude


def thrust_of(message: Any) -> float:
    """SERVO_OUTPUT_RAW: how far the hardest working of the first eight outputs is from neutral, 0 to 1.

    Raises:
        Strange: A pulse that is none.
    """
    pulses = [getattr(message, f"servo{k}_raw") for k in range(1, 9)]
    driven = [pulse for pulse in pulses if pulse != 0]
    if not all(PULSES[0] <= pulse <= PULSES[1] for pulse in driven):
        raise Strange("servo output: out of range")
    return max((abs(pulse - 1500) / 400.0 for pulse in driven), default=0.0)


def tilt_of(message: Any) -> float:
    """Radians by which the camera looks up, from MOUNT_STATUS (hundredths of a degree), MOUNT_ORIENTATION
    (degrees) or GIMBAL_DEVICE_ATTITUDE_STATUS (quaternion).

    Raises:
        Strange: Beyond ±100°, or not finite.
    """
    kind = message.get_type()
    if kind == "MOUNT_STATUS":
        tilt = math.radians(message.pointing_a / 100.0)
    elif kind == "MOUNT_ORIENTATION":
        tilt = math.radians(message.pitch)
    else:
        w, x, y, z = message.q
        if not abs(math.sqrt(w * w + x * x + y * y + z * z) - 1.0) <= UNTRUE:
            raise Strange("camera tilt: quaternion not of length 1")
        tilt = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    if not abs(tilt) < math.radians(100.0):
        raise Strange("camera tilt: out of range")
    return tilt


def text_of(field: str | bytes) -> str:
    """A text field up to its end."""
    return field if isinstance(field, str) else field.split(b"\0")[0].decode("ascii", "replace")
