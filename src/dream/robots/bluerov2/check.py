"""Go or no-go: what has to be well before a dive, each with what was found."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from dream.robots.bluerov2.dvl_a50 import Config
from dream.robots.bluerov2.limits import LOW_SHARE, Limits
from dream.robots.bluerov2.parameters import Check
from dream.robots.bluerov2.telemetry import Telemetry

LOGGED = 1.4e6
"""Bytes of log a second: a stream of 10 Mbit/s, and a tenth of that for all the rest."""
DEPTHS_APART = 0.3
"""Metres by which the depth may differ from what the autopilot holds it to be: they sit apart."""
HIGHEST = 0.2
"""Metres above the surface that a depth may be at the launch, by what its gauge errs."""
SOUND_OFF = 0.02
"""Share by which the DVL's speed of sound, and with it every velocity, may be off."""
WORST_LOSS = 0.05
"""Share of the vehicle's packets that may be missing."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One item of the list."""

    name: str
    ok: bool
    said: str
    """What was found."""
    wanted: str = ""
    """What was expected, and what to do; for an item that is not ok."""


class Sonar(Protocol):
    """What is asked of the DVL."""

    @property
    def connected(self) -> bool: ...  # noqa: D102
    @property
    def age(self) -> float: ...  # noqa: D102
    @property
    def hot(self) -> bool: ...  # noqa: D102
    @property
    def problem(self) -> str: ...  # noqa: D102
    @property
    def config(self) -> Config | None: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class Seen:
    """What the camera gave in the seconds of the check."""

    frames: int
    seconds: float
    age: float
    """Seconds, of the newest."""
    problem: str = ""


def findings(
    telemetry: Telemetry,
    busy: str,
    parameters: Sequence[Check],
    sonar: Sonar,
    seen: Seen,
    aligned: str,
    limits: Limits,
    folder: Path,
    sound: tuple[float, float],
    *,
    zeroed_here: bool,
) -> list[Finding]:
    """The whole list, in the order in which one would mend it.

    Args:
        telemetry: What the vehicle says.
        busy: Why it is not ours to touch, as `mavlink.Link` has it; empty where it is free.
        parameters: What safety hangs on.
        sonar: The DVL.
        seen: What the camera gave.
        aligned: Why the estimate cannot begin; empty where it can.
        limits: Of the dive.
        folder: Where the dive is kept.
        sound: From and to what m/s sound goes in this water.
        zeroed_here: Whether the depth has its zero where the vehicle lies, since nobody told the pressure at
            the surface.
    """
    room = 60.0 * limits.minutes * LOGGED
    free = shutil.disk_usage(folder).free
    rate = seen.frames / seen.seconds if seen.seconds > 0.0 else 0.0
    lasted = math.inf if math.isnan(telemetry.sagged) else telemetry.sagged
    return [
        Finding(
            "link",
            telemetry.heartbeat_age < 2.0 and telemetry.loss <= WORST_LOSS,
            f"heartbeat {telemetry.heartbeat_age:.1f} s old, {telemetry.loss:.1%} of the packets missing",
            f"a heartbeat every second, at most {WORST_LOSS:.0%} missing. Look at the tether and BlueOS",
        ),
        Finding(
            "autopilot",
            bool(telemetry.version),
            telemetry.version or "no version",
            "ArduSub 4.1 or newer that answers",
        ),
        Finding(
            "mode",
            not telemetry.armed,
            f"{telemetry.mode}, {'armed' if telemetry.armed else 'disarmed'}",
            "a vehicle that is disarmed: DREAM only moves one that it armed itself",
        ),
        Finding(
            "nobody else",
            not busy,
            busy or "nobody else drives it",
            "a vehicle that nobody else arms, nobody changes the mode of, and no station with our id",
        ),
        *(
            Finding(
                check.name,
                check.ok,
                "not there" if math.isnan(check.value) else f"{check.value:g}",
                check.why
                + ("" if math.isnan(check.wanted) else f"; --set-parameters makes it {check.wanted:g}"),
            )
            for check in parameters
        ),
        Finding(
            "inertial unit",
            telemetry.imu_age < 0.2 and telemetry.attitude_age < 0.5,
            f"sample {telemetry.imu_age:.2f} s old, attitude {telemetry.attitude_age:.2f} s",
            "RAW_IMU and ATTITUDE at 50 Hz",
        ),
        _depth(telemetry, zeroed_here=zeroed_here),
        Finding(
            "battery",
            min(telemetry.voltage, lasted) >= limits.homing_voltage and not telemetry.battery <= LOW_SHARE,
            battery_told(telemetry) + (f", {lasted:.1f} V for 3 s" if lasted < limits.homing_voltage else ""),
            f"{limits.homing_voltage:g} V or more, and above {LOW_SHARE:.0%} where it tells that: with less "
            "the mission would go home at once",
        ),
        Finding("hull", not telemetry.leak, "water!" if telemetry.leak else "dry", "a dry hull"),
        Finding(
            "DVL",
            sonar.connected
            and sonar.age < 1.0
            and not sonar.hot
            and not sonar.problem
            and sonar.config is not None,
            sonar.problem
            or ("it does not tell its settings" if sonar.config is None else f"report {sonar.age:.1f} s old"),
            "an A50 that pings, in the water, below 45 °C, and tells how it is set",
        ),
        _speed_of_sound(sonar.config, sound),
        Finding(
            "camera",
            rate >= 5.0 and seen.age < 0.5 and not seen.problem,
            seen.problem or f"{rate:.0f} frames a second, the newest {seen.age:.2f} s old",
            "five frames a second or more. Is the stream sent to this computer?",
        ),
        Finding(
            "navigation",
            not aligned,
            aligned or "begins: all sensors agree that the vehicle lies still",
            "a vehicle that lies still, with bottom lock",
        ),
        Finding(
            "disk",
            free >= room,
            f"{free / (1 << 30):.1f} GiB free",
            f"{room / (1 << 30):.1f} GiB or more for the log of {limits.minutes:g} minutes",
        ),
    ]


def battery_told(telemetry: Telemetry) -> str:
    """Its voltage, and what is left of it where the vehicle says that."""
    if math.isnan(telemetry.voltage):
        return "unknown"
    left = "" if math.isnan(telemetry.battery) else f", {telemetry.battery:.0%} left"
    return f"{telemetry.voltage:.1f} V{left}"


def _depth(telemetry: Telemetry, *, zeroed_here: bool) -> Finding:
    own, depth = -telemetry.own_altitude, telemetry.depth
    known = telemetry.own_altitude_age < 1.0 and math.isfinite(own)
    alike = known and abs(own - depth) <= DEPTHS_APART
    said = f"{depth:.2f} m, {telemetry.pressure_age:.1f} s old"
    if not known:
        said += "; the autopilot does not tell its own"
    elif not alike:
        said += f", but {own:.2f} m by the autopilot"
    wanted = "GLOBAL_POSITION_INT, and a Bar30 that agrees with it: SCALED_PRESSURE2 from outside the hull"
    if zeroed_here and known:
        wanted = (
            "a Bar30 that was zeroed at the surface: lay the vehicle there, or say --surface-pressure in "
            "hPa. All depths, and the limit, count from where it lies now"
        )
    return Finding("depth", telemetry.pressure_age < 1.0 and depth > -HIGHEST and alike, said, wanted)


def _speed_of_sound(config: Config | None, sound: tuple[float, float]) -> Finding:
    slowest, fastest = sound
    water = f"{slowest:g}" if slowest == fastest else f"{slowest:g} to {fastest:g}"
    wanted = f"{water} m/s in this water, within {SOUND_OFF:.0%}: set speed_of_sound of the DVL, or --water"
    speed = None if config is None else config.speed_of_sound
    if speed is None:
        return Finding("speed of sound", ok=False, said="the DVL does not tell it", wanted=wanted)
    # A velocity is the shift of the echo's frequency times the speed of sound that is believed.
    nearest = min(max(speed, slowest), fastest)
    off = speed / nearest - 1.0
    said = f"{speed:g} m/s" + (f", all velocities are {off:+.1%} off" if off else "")
    return Finding("speed of sound", abs(off) <= SOUND_OFF, said, wanted)
