"""The parameters of a stand-in ArduSub, by their names."""

from __future__ import annotations

import math
from dataclasses import dataclass

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9
"""MAV_PARAM_TYPE. ArduPilot sends the value as a float, whatever the type."""
_RANGES = {INT8: (-128, 127), INT16: (-32768, 32767), INT32: (-(1 << 31), (1 << 31) - 1)}


@dataclass(frozen=True, slots=True)
class Firmware:
    """A release, in what differs between releases."""

    version: tuple[int, int, int]
    system_parameter: str
    """Name of the parameter that holds the vehicle's system id."""
    gcs_parameter: str
    """And of the one that holds the system id of its ground station."""


STABLE = Firmware((4, 5, 3), "SYSID_THISMAV", "SYSID_MYGCS")
NEXT = Firmware((4, 7, 0), "MAV_SYSID", "MAV_GCS_SYSID")
"""The release that renamed them."""

_RANGE = (("MIN", 1100), ("MAX", 1900), ("TRIM", 1500))
DEFAULTS: tuple[tuple[str, float, int], ...] = (
    ("ACRO_YAW_P", 3.375, REAL32),
    ("AHRS_EKF_TYPE", 3, INT8),
    ("ANGLE_MAX", 4500, INT16),
    ("ARMING_CHECK", 448, INT32),
    ("BARO_SPEC_GRAV", 1.0, REAL32),
    ("BATT_ARM_VOLT", 0, REAL32),
    ("BATT_CAPACITY", 0, INT32),
    ("BATT_CRT_VOLT", 0, REAL32),
    ("BATT_FS_CRT_ACT", 0, INT8),
    ("BATT_FS_LOW_ACT", 0, INT8),
    ("BATT_LOW_TIMER", 10, INT8),
    ("BATT_LOW_VOLT", 0, REAL32),
    ("BATT_MONITOR", 4, INT8),
    ("EK3_ENABLE", 1, INT8),
    ("EK3_SRC1_POSXY", 0, INT8),
    ("EK3_SRC1_POSZ", 1, INT8),
    ("EK3_SRC1_VELXY", 3, INT8),
    ("EK3_SRC1_YAW", 1, INT8),
    ("FRAME_CONFIG", 2, INT8),
    ("FS_EKF_ACTION", 0, INT8),
    ("FS_EKF_THRESH", 0.8, REAL32),
    ("FS_GCS_ENABLE", 2, INT8),
    ("FS_GCS_TIMEOUT", 5, REAL32),
    ("FS_LEAK_ENABLE", 1, INT8),
    ("FS_PILOT_INPUT", 2, INT8),
    ("FS_PILOT_TIMEOUT", 3, REAL32),
    ("FS_PRESS_ENABLE", 0, INT8),
    ("FS_PRESS_MAX", 105000, INT32),
    ("FS_TEMP_ENABLE", 0, INT8),
    ("FS_TEMP_MAX", 62, INT8),
    ("JS_GAIN_DEFAULT", 0.5, REAL32),
    ("JS_GAIN_MAX", 1.0, REAL32),
    ("JS_GAIN_MIN", 0.25, REAL32),
    ("JS_GAIN_STEPS", 4, INT8),
    ("JS_THR_GAIN", 1.0, REAL32),
    ("MNT1_DEFLT_MODE", 3, INT8),
    ("MNT1_PITCH_MAX", 45, INT16),
    ("MNT1_PITCH_MIN", -45, INT16),
    ("MNT1_TYPE", 1, INT8),
    *((f"MOT_{motor}_DIRECTION", 1.0, INT8) for motor in range(1, 9)),
    ("ORIGIN_ALT", 0, REAL32),
    ("ORIGIN_LAT", 0, REAL32),
    ("ORIGIN_LON", 0, REAL32),
    ("PILOT_ACCEL_Z", 100, INT16),
    ("PILOT_SPEED", 200, INT16),
    ("PILOT_SPEED_DN", 0, INT16),
    ("PILOT_SPEED_UP", 100, INT16),
    ("PILOT_THR_FILT", 0, REAL32),
    *((f"RC{n}_DZ", dead, INT16) for n, dead in enumerate((30, 30, 30, 40, 30, 30, 0, 0), 1)),
    *((f"RC{n}_{name}", pwm, INT16) for n in range(1, 9) for name, pwm in _RANGE),
    ("RC_OVERRIDE_TIME", 3, REAL32),
    ("RNGFND1_TYPE", 10, INT8),
    ("SERVO13_FUNCTION", 181, INT16),
    ("SERVO16_FUNCTION", 7, INT16),
    ("SURFACE_DEPTH", -10, REAL32),
    ("SURFACE_MAX_THR", 0.1, REAL32),
    ("THR_DZ", 100, INT16),
    ("VISO_TYPE", 0, INT8),
    ("WPNAV_SPEED", 100, REAL32),
    ("WPNAV_SPEED_DN", 150, REAL32),
    ("WPNAV_SPEED_UP", 250, REAL32),
)
"""Name, value and type, as read from an ArduSub 4.7-dev with Blue Robotics' set for a Heavy and a Navigator,
as far as somebody here asks for them; centimetres and microseconds are ArduSub's."""


class Parameters:
    """Values that last over a reboot."""

    __slots__ = ("_types", "_values", "firmware")

    def __init__(self, firmware: Firmware, system: int, gcs: int) -> None:
        """As delivered, with these system ids of vehicle and ground station."""
        self.firmware = firmware
        own = ((firmware.system_parameter, system, INT16), (firmware.gcs_parameter, gcs, INT16))
        rows = sorted((*DEFAULTS, *own))
        self._values = {name: float(value) for name, value, _ in rows}
        self._types = {name: kind for name, _, kind in rows}

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __contains__(self, name: object) -> bool:
        return name in self._values

    @property
    def names(self) -> list[str]:
        """In the order of their indices."""
        return list(self._values)

    @property
    def system(self) -> int:
        """System id of the vehicle."""
        return int(self[self.firmware.system_parameter])

    @property
    def gcs(self) -> int:
        """System id of the ground station that it listens to."""
        return int(self[self.firmware.gcs_parameter])

    def kind(self, name: str) -> int:
        """MAV_PARAM_TYPE."""
        return self._types[name]

    def change(self, name: str, value: float) -> bool:
        """Set one that exists, rounded and bounded to its type; did it?"""
        if name not in self._values or not math.isfinite(value):
            return False
        kind = self._types[name]
        if kind != REAL32:
            low, high = _RANGES[kind]
            value = float(min(max(round(value), low), high))
        self._values[name] = value
        return True
