"""Parameters of ArduSub that a dive hangs on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

STATION_ID = ("MAV_GCS_SYSID", "SYSID_MYGCS")
"""One parameter, by its name from ArduSub 4.7 on and by its name before that."""
JOYSTICK_PARAMETERS = (
    "FRAME_CONFIG",
    "JS_GAIN_DEFAULT",
    "JS_THR_GAIN",
    "ACRO_YAW_P",
    "RC4_DZ",
    "PILOT_SPEED_UP",
    "PILOT_SPEED_DN",
    "THR_DZ",
)


@dataclass(frozen=True, slots=True)
class Check:
    """A parameter that safety hangs on."""

    name: str
    value: float
    """NaN where the vehicle does not have it."""
    wanted: float
    """What `correct` would set; NaN where that is not for a program to decide."""
    why: str
    ok: bool


@dataclass(frozen=True, slots=True)
class Rule:
    """What a parameter has to be."""

    name: str
    wanted: float
    """NaN where that is not for a program to decide."""
    why: str
    good: Callable[[float], bool]

    def check(self, name: str, value: float) -> Check:
        """Judge a value; `name` is how the vehicle calls it."""
        return Check(name, value, self.wanted, self.why, self.good(value))


def rules(system: int) -> tuple[Rule, ...]:
    """What has to hold for a station with this system id."""
    return (
        Rule(
            STATION_ID[0],
            system,
            "only this station's sticks and heartbeats count",
            lambda v: v == system,
        ),
        Rule(
            "MAV_GCS_SYSID_HI",
            0.0,
            "0: a range of ids would let others steer; versions before 4.7 do not have it",
            lambda v: math.isnan(v) or v in (0.0, system),
        ),
        Rule("FS_PILOT_INPUT", 2.0, "2: disarms when our sticks fall silent", lambda v: v == 2.0),
        Rule("FS_PILOT_TIMEOUT", 1.0, "seconds until then: 1 at most", lambda v: 0.0 < v <= 1.0),
        Rule(
            "FS_GCS_ENABLE",
            2.0,
            "2 disarms, 3 holds depth, 4 surfaces when our heartbeat stops",
            lambda v: v in (2.0, 3.0, 4.0),
        ),
        Rule("FS_LEAK_ENABLE", 1.0, "1 warns, 2 surfaces", lambda v: v in (1.0, 2.0)),
        Rule(
            "FRAME_CONFIG",
            math.nan,
            "1 VECTORED or 2 VECTORED_6DOF: whose thrusters DREAM knows",
            lambda v: v in (1.0, 2.0),
        ),
        Rule(
            "JS_GAIN_DEFAULT",
            math.nan,
            "0.1 to 1: what share of full throttle sticks reach",
            lambda v: 0.1 <= v <= 1.0,
        ),
        Rule("JS_THR_GAIN", math.nan, "0.5 to 4: what z is multiplied by", lambda v: 0.5 <= v <= 4.0),
    )
