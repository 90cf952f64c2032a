"""The state of a stand-in ArduSub → the messages that it streams.

All axes are forward-right-down and north-east-down.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as mav

from dream.robots.bluerov2.standin import motors
from dream.robots.bluerov2.standin.attitude import Ahrs, Origin, quaternion
from dream.robots.bluerov2.standin.failsafes import Failsafes
from dream.robots.bluerov2.standin.helm import NEED_POSITION, ModeControl
from dream.robots.bluerov2.standin.motors import NEUTRAL_PWM
from dream.robots.bluerov2.standin.parameters import Parameters
from dream.robots.bluerov2.standin.tank import Tank
from dream.vehicle import GRAVITY

Message = Any
"""A message of pymavlink, which has no types."""

AIR_PRESSURE, WATER_PRESSURE = 1013.25, 98.0665
"""hPa at the surface, and per metre of fresh water."""
FIELD = (180.0, 420.0)
"""Milligauss of the Earth's field, horizontally and down."""
EARTH = 6_378_137.0
"""Metres of its radius."""
TILT_CHANNEL = 16
"""Output of the camera's servo on a Navigator."""
SENSORS = 0x1 | 0x2 | 0x4 | 0x8 | 0x400 | 0x800 | 0x1000 | 0x8000 | 0x200000
"""MAV_SYS_STATUS_SENSOR bits that it has: gyroscopes, accelerometers, compass, pressure, its controllers,
motors and attitude."""
PREARM = 0x10000000
CAPABILITIES = 0x2 | 0x4 | 0x80 | 0x100 | 0x2000
"""MAV_PROTOCOL_CAPABILITY: float parameters, missions, both position targets, MAVLink 2."""


class Reported(Protocol):
    """The autopilot whose state is told."""

    @property
    def tank(self) -> Tank:
        """Where it swims."""
        ...

    @property
    def ahrs(self) -> Ahrs:
        """Its estimate of attitude and depth."""
        ...

    @property
    def helm(self) -> ModeControl:
        """Mode, sticks and targets."""
        ...

    @property
    def failsafes(self) -> Failsafes:
        """Is any triggered?"""
        ...

    @property
    def parameters(self) -> Parameters:
        """By their names."""
        ...

    @property
    def drawn(self) -> float:
        """Ampere-hours that were drawn since it booted."""
        ...

    @property
    def armed(self) -> bool:
        """Do its motors run?"""
        ...

    @property
    def mode(self) -> int:
        """custom_mode."""
        ...

    @property
    def pulses(self) -> list[int]:
        """Microseconds to each motor."""
        ...

    @property
    def servos(self) -> dict[int, int]:
        """Microseconds of the outputs that are no motors, by channel."""
        ...

    @property
    def tilt(self) -> float:
        """Radians that the camera looks up."""
        ...

    @property
    def position_ok(self) -> bool:
        """Has it a position?"""
        ...

    @property
    def origin(self) -> Origin | None:
        """Of its estimate; None as long as nobody has told it any."""
        ...

    @property
    def altitude(self) -> float:
        """Metres above the sea, as far as it knows."""
        ...

    @property
    def relative_altitude(self) -> float:
        """Metres above its home."""
        ...

    @property
    def clock(self) -> float:
        """Seconds since it booted, as it counts them."""
        ...

    @property
    def boot_ms(self) -> int:
        """The same in milliseconds."""
        ...


def heartbeat(sub: Reported) -> Message:
    """What it is, and in which mode."""
    flags = mav.MAV_MODE_FLAG_STABILIZE_ENABLED | mav.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    flags |= mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    if sub.armed:
        flags |= mav.MAV_MODE_FLAG_SAFETY_ARMED
    if sub.mode in NEED_POSITION:
        flags |= mav.MAV_MODE_FLAG_GUIDED_ENABLED
    status = mav.MAV_STATE_ACTIVE if sub.armed else mav.MAV_STATE_STANDBY
    if sub.failsafes.triggered:
        status = mav.MAV_STATE_CRITICAL
    return mav.MAVLink_heartbeat_message(
        mav.MAV_TYPE_SUBMARINE, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, flags, sub.mode, status, 3
    )


def attitude(sub: Reported) -> Message:
    """By its filter."""
    roll, pitch, _ = sub.ahrs.euler
    p, q, r = sub.ahrs.rates
    return mav.MAVLink_attitude_message(sub.boot_ms, roll, -pitch, sub.helm.yaw, p, -q, -r)


def attitude_quaternion(sub: Reported) -> Message:
    """The same as a quaternion."""
    roll, pitch, _ = sub.ahrs.euler
    p, q, r = sub.ahrs.rates
    wxyz = quaternion(roll, -pitch, sub.helm.yaw)
    return mav.MAVLink_attitude_quaternion_message(sub.boot_ms, *wxyz, p, -q, -r)


def inertial(sub: Reported) -> tuple[int, ...]:
    """Milligravities, milliradians a second and milligauss, forward-right-down."""
    fx, fy, fz = sub.tank.imu.specific_force.tolist()
    p, q, r = sub.ahrs.rates
    force = [1000.0 * value / GRAVITY for value in (fx, -fy, -fz)]
    turn = [1000.0 * value for value in (p, -q, -r)]
    yaw = 0.5 * math.pi - sub.tank.heading.yaw
    field = (FIELD[0] * math.cos(yaw), -FIELD[0] * math.sin(yaw), FIELD[1])
    return tuple(min(max(round(value), -32768), 32767) for value in (*force, *turn, *field))


def raw_imu(sub: Reported) -> Message:
    """Inertial unit and compass."""
    return mav.MAVLink_raw_imu_message(int(1e6 * sub.clock), *inertial(sub), 0, 2500)


def scaled_imu2(sub: Reported) -> Message:
    """The same; with milliseconds."""
    return mav.MAVLink_scaled_imu2_message(sub.boot_ms, *inertial(sub), 2500)


def scaled_pressure2(sub: Reported) -> Message:
    """The Bar30."""
    water = -sub.tank.depth.z * WATER_PRESSURE
    return mav.MAVLink_scaled_pressure2_message(sub.boot_ms, AIR_PRESSURE + water, water, 2000)


def vfr_hud(sub: Reported) -> Message:
    """Height above the sea, as far as it knows, and heading."""
    speed = math.hypot(*sub.helm.over_ground) if sub.position_ok else 0.0
    heading = int(math.degrees(sub.helm.yaw) % 360.0)
    thrust = int(50.0 + 50.0 * motors.share(sub.helm.sticks.throttle)) if sub.armed else 0
    return mav.MAVLink_vfr_hud_message(0.0, speed, heading, thrust, sub.altitude, sub.ahrs.climb)


def global_position_int(sub: Reported) -> Message:
    """Where it is on the globe, and how high: `alt` above the sea, `relative_alt` by rules of its own."""
    origin, (north, east) = sub.origin, sub.helm.here if sub.position_ok else (0.0, 0.0)
    lat = lon = 0
    if origin is not None:
        lat = origin.lat + round(1e7 * math.degrees(north / EARTH))
        lon = origin.lon + round(1e7 * math.degrees(east / EARTH / math.cos(math.radians(1e-7 * lat))))
    vn, ve = sub.helm.over_ground if sub.position_ok else (0.0, 0.0)
    speeds = [round(100.0 * speed) for speed in (vn, ve, -sub.ahrs.climb)]
    heights = round(1000.0 * sub.altitude), round(1000.0 * sub.relative_altitude)
    heading = round(100.0 * math.degrees(sub.helm.yaw)) % 36000
    return mav.MAVLink_global_position_int_message(sub.boot_ms, lat, lon, *heights, *speeds, heading)


def ahrs2(sub: Reported) -> Message:
    """By its second filter: the same attitude, and the height that is relative, rounded."""
    roll, pitch, _ = sub.ahrs.euler
    height = round(sub.relative_altitude, 2)
    return mav.MAVLink_ahrs2_message(roll, -pitch, sub.helm.yaw, height, 0, 0)


def nav_controller_output(sub: Reported) -> Message:
    """What it steers at: heading, and height above where it is."""
    loops = sub.helm.loops
    off = loops.z - sub.ahrs.z if sub.armed else 0.0
    return mav.MAVLink_nav_controller_output_message(
        0.0, 0.0, int(math.degrees(loops.aim)), 0, 0, off, 0.0, 0.0
    )


def sys_status(sub: Reported) -> Message:
    """Battery and health.

    What is left of the charge it reckons from a capacity, as if it booted on a full battery; it does not know
    that without one.
    """
    tank = sub.tank
    ready = sub.parameters["BATT_ARM_VOLT"] <= tank.voltage
    capacity = sub.parameters["BATT_CAPACITY"]
    left = min(max(100.0 - 1e5 * sub.drawn / capacity, 0.0), 100.0) if capacity > 0.0 else -1.0
    present = SENSORS | PREARM
    healthy = present if ready else SENSORS
    volts, amperes = round(1000.0 * tank.voltage), round(100.0 * tank.amperes)
    return mav.MAVLink_sys_status_message(
        present, present, healthy, 250, volts, min(amperes, 32767), int(left), 0, 0, 0, 0, 0, 0
    )


def system_time(sub: Reported) -> Message:
    """Without a receiver it does not know the time."""
    return mav.MAVLink_system_time_message(0, sub.boot_ms)


def gimbal(sub: Reported) -> Message:
    """The tilt of the camera; a servo mount reports what it was told, about the vehicle."""
    wxyz = quaternion(0.0, sub.tilt, 0.0)
    flags = mav.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
    return mav.MAVLink_gimbal_device_attitude_status_message(
        0, 0, sub.boot_ms, flags, wxyz, math.nan, math.nan, math.nan, 0, math.nan, math.nan, 1
    )


def cam_tilt(sub: Reported) -> Message:
    """The same, as a share from down to up."""
    return mav.MAVLink_named_value_float_message(sub.boot_ms, b"CamTilt", 0.5 + math.degrees(sub.tilt) / 90.0)


def servo_output_raw(sub: Reported) -> Message:
    """Pulses of motors, lights and tilt."""
    outputs = {**dict(enumerate(sub.pulses, 1)), **sub.servos}
    outputs[TILT_CHANNEL] = round(NEUTRAL_PWM - motors.HALF_PWM * math.degrees(sub.tilt) / 45.0)
    pulses = [outputs.get(channel, 0) for channel in range(1, 17)]
    return mav.MAVLink_servo_output_raw_message(int(1e6 * sub.clock) % (1 << 32), 0, *pulses)


def ekf_status_report(sub: Reported) -> Message:
    """What it has an estimate of."""
    flags = mav.EKF_ATTITUDE | mav.EKF_VELOCITY_HORIZ | mav.EKF_VELOCITY_VERT | mav.EKF_POS_VERT_ABS
    if sub.position_ok:
        flags |= mav.EKF_POS_HORIZ_REL | mav.EKF_POS_HORIZ_ABS
        flags |= mav.EKF_PRED_POS_HORIZ_REL | mav.EKF_PRED_POS_HORIZ_ABS
    else:
        flags |= mav.EKF_CONST_POS_MODE
    return mav.MAVLink_ekf_status_report_message(flags, 0.05, 0.05, 0.02, 0.05, 0.0)


def local_position_ned(sub: Reported) -> Message:
    """Where it is; only while it has a position."""
    north, east = sub.helm.here
    vn, ve = sub.helm.over_ground
    z, climb = sub.ahrs.z, sub.ahrs.climb
    return mav.MAVLink_local_position_ned_message(sub.boot_ms, north, east, -z, vn, ve, -climb)


def autopilot_version(sub: Reported) -> Message:
    """Which release it is."""
    major, minor, patch = sub.parameters.firmware.version
    version = major << 24 | minor << 16 | patch << 8 | 255
    return mav.MAVLink_autopilot_version_message(
        CAPABILITIES, version, 0, 0, 0, b"standin\0", b"\0" * 8, b"\0" * 8, 0, 0, 1
    )


BUILDERS: dict[int, Callable[[Reported], Message]] = {
    mav.MAVLINK_MSG_ID_ATTITUDE: attitude,
    mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: attitude_quaternion,
    mav.MAVLINK_MSG_ID_RAW_IMU: raw_imu,
    mav.MAVLINK_MSG_ID_SCALED_IMU2: scaled_imu2,
    mav.MAVLINK_MSG_ID_SCALED_PRESSURE2: scaled_pressure2,
    mav.MAVLINK_MSG_ID_VFR_HUD: vfr_hud,
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_position_int,
    mav.MAVLINK_MSG_ID_AHRS2: ahrs2,
    mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: nav_controller_output,
    mav.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    mav.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
    mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: gimbal,
    mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: servo_output_raw,
    mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT: ekf_status_report,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: local_position_ned,
    mav.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: cam_tilt,
    mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
    mav.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
}
"""By message id."""
DEFAULT_INTERVALS = {
    mav.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mav.MAVLINK_MSG_ID_ATTITUDE: 0.25,
    mav.MAVLINK_MSG_ID_RAW_IMU: 0.5,
    mav.MAVLINK_MSG_ID_SCALED_IMU2: 0.5,
    mav.MAVLINK_MSG_ID_SCALED_PRESSURE2: 0.5,
    mav.MAVLINK_MSG_ID_VFR_HUD: 0.25,
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.33,
    mav.MAVLINK_MSG_ID_AHRS2: 0.25,
    mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: 0.5,
    mav.MAVLINK_MSG_ID_SYS_STATUS: 0.5,
    mav.MAVLINK_MSG_ID_SYSTEM_TIME: 0.5,
    mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: 0.5,
    mav.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: 0.5,
    mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 0.5,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 0.5,
}
"""Seconds between two of a stream that nobody has asked for otherwise."""
