"""What a vehicle says of itself, gathered from its messages."""

from __future__ import annotations

import math
import statistics
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

from dream.measurements import Depth, Heading, Imu
from dream.robots.bluerov2.clocks import DeviceClock
from dream.robots.bluerov2.limits import SAG
from dream.robots.bluerov2.reports import (
    FRESH,
    MODES,
    MOUNT_MESSAGES,
    Attitude,
    Strange,
    attitude_of,
    depth_of,
    heading_of,
    imu_of,
    own_altitude_of,
    pressure_of,
    text_of,
    thrust_of,
    tilt_of,
)

Measurement = Imu | Heading | Depth

HEADING_SIGMA = 0.4
"""Radians of one of 50 headings a second. By what a compass errs, iron or an estimate that settles, lasts: a
thousand readings know no more than one, and together count little against gyroscopes within a minute."""
LOCAL = 1.0
"""Seconds after which the autopilot's position counts as gone: another message tells its depth then."""
SLIPPED = 10.0
"""Seconds for which a clock that slipped is told."""

UNHEARD = ("Lost manual control", "heartbeat lost")
"""What ArduSub says where it hears nothing of us: `failsafe_pilot_input_check` and `failsafe_gcs_check`, in
ArduSub/failsafe.cpp."""


@dataclass(frozen=True, slots=True)
class Telemetry:
    """What the vehicle says of itself, at one moment. Ages are in seconds, infinite before the first."""

    time: float
    """Seconds on the dive's clock."""
    mode: str = "UNKNOWN"
    armed: bool = False
    voltage: float = math.nan
    """Volts at the battery."""
    sagged: float = math.nan
    """Volts above which it was not for `SAG` seconds on end, at their lowest so far; NaN before."""
    battery: float = math.nan
    """Share that is left, 0 to 1."""
    drawn_wh: float = math.nan
    """Watt-hours that were drawn since it was first heard, by its battery monitor; NaN where it has none."""
    depth: float = math.nan
    """Metres below the surface; NaN until the pressure there is known."""
    own_altitude: float = math.nan
    """Metres up by the autopilot's own reckoning, whose zero is not that of `depth`."""
    own_altitude_from: str = ""
    """Which message told it: each may have a zero of its own."""
    thrust: float = math.nan
    """Of the hardest working thruster, 0 to 1."""
    attitude: Attitude | None = None
    pilot_gain: float = math.nan
    """What buttons have made of JS_GAIN_DEFAULT."""
    input_hold: bool = False
    """The autopilot keeps old sticks until all are near neutral."""
    lights: float = math.nan
    """0 to 1."""
    camera_tilt: float = math.nan
    """Radians up."""
    leak: bool = False
    failsafe: bool = False
    """The vehicle's state is critical: one of its failsafes acts."""
    version: str = ""
    heartbeat_age: float = math.inf
    imu_age: float = math.inf
    imu_heard: float = math.inf
    """Since one came, though it may have been taken long before."""
    attitude_age: float = math.inf
    pressure_age: float = math.inf
    own_altitude_age: float = math.inf
    status_age: float = math.inf
    """Of what it says of battery and leak."""
    loss: float = 0.0
    """Share of the vehicle's packets that never came, by their numbers."""
    jitter: float = math.nan
    """Seconds, as `DeviceClock` tells it."""
    reboots: int = 0
    slipped: str = ""
    """That its clock was set a while ago, in words; empty where it was not."""


@dataclass(frozen=True, slots=True)
class TelemetrySources:
    """Which messages measurements come from, and what they are worth."""

    imu_from: str = "RAW_IMU"
    """Or SCALED_IMU, SCALED_IMU2."""
    heading_from: str = "ATTITUDE"
    """Or ATTITUDE_QUATERNION."""
    density: float = FRESH
    """kg/m³ of the water."""
    heading_sigma: float = HEADING_SIGMA
    """Radians."""
    depth_sigma: float = 0.02
    """Metres."""

    def __post_init__(self) -> None:
        if not 900.0 <= self.density <= 1200.0:
            raise ValueError(f"density: expected 900 to 1200 kg/m³ of water, got {self.density}")


class Sag:
    """Volts that lasted.

    What it does: takes every voltage that is told, and says the least so far of which none was above it for
    `SAG` seconds on end. A moment's load is in no such time, and no voltage is missed by whoever asks late.
    """

    def __init__(self) -> None:
        self._told: deque[tuple[float, float]] = deque()
        """Of the last `SAG` seconds, and the last one before."""
        self._least = math.inf

    def __call__(self, now: float, volts: float) -> float:
        """One more voltage; NaN as long as none lasted.

        Args:
            now: Seconds on the dive's clock.
            volts: NaN where it is not known.
        """
        told = self._told
        if math.isnan(volts) or (told and now - told[-1][0] > SAG):
            # Of what nobody told, nothing is known.
            told.clear()
        if not math.isnan(volts):
            told.append((now, volts))
        while len(told) > 1 and told[1][0] <= now - SAG:
            told.popleft()
        if told and told[0][0] <= now - SAG:
            self._least = min(self._least, max(each for _, each in told))
        return self._least if self._least < math.inf else math.nan


class Reports:
    """What was heard of the vehicle. Not thread-safe."""

    def __init__(self, dialect: Any, instruments: TelemetrySources, surface: float) -> None:
        """Begin with nothing; `surface` is the pressure there in hPa, NaN while unknown."""
        self._dialect = dialect
        self._instruments = instruments
        self.surface = surface
        self.values: dict[str, Any] = {}
        """Fields of `Telemetry` that are known."""
        self.seen: dict[str, float] = {}
        """When a kind of message last came: heartbeat, imu, attitude, pressure, own_altitude and so on."""
        self._sag = Sag()
        self._metered: tuple[float, float] | None = None
        """When the battery monitor last told a current, and the watts by it."""
        self.texts: deque[tuple[float, int, str]] = deque(maxlen=200)
        """(time, severity, text) of what the vehicle said; severity 0 is worst."""
        self.reboots = 0
        self._clocks = {"boot": DeviceClock(), "usec": DeviceClock()}
        self._last_stamp: dict[str, float] = {}
        self._last_time: dict[str, float] = {}
        self._trips: dict[int, float] = {}
        self._pressures: deque[tuple[float, float]] = deque(maxlen=400)
        self._newest = self._last_heartbeat = -1
        self._packets = self._missing = 0
        self._boot = -math.inf
        self._backwards = 0
        self._slipped: tuple[str, float] = ("", -math.inf)

    def age(self, kind: str, now: float) -> float:
        """Seconds since such a message came; infinite before the first."""
        return now - self.seen.get(kind, -math.inf)

    def telemetry(self, now: float) -> Telemetry:
        """All of it, at this moment."""
        received = self._packets + self._missing
        return Telemetry(
            time=now,
            **self.values,
            heartbeat_age=self.age("heartbeat", now),
            imu_age=self.age("imu", now),
            imu_heard=self.age("imu_heard", now),
            attitude_age=self.age("attitude", now),
            pressure_age=self.age("pressure", now),
            own_altitude_age=self.age("own_altitude", now),
            status_age=self.age("status", now),
            loss=self._missing / received if received else 0.0,
            jitter=self._clocks["boot"].jitter,
            reboots=self.reboots,
            slipped=self._slipped[0] if now < self._slipped[1] + SLIPPED else "",
        )

    def words_since(self, since: float) -> list[str]:
        """What the vehicle said that was more than a remark."""
        return [text for when, severity, text in self.texts if when >= since and severity <= 4]

    def last_words(self, now: float) -> str:
        """What the vehicle said a moment ago: mostly, why."""
        words = self.words_since(now - 3.0)[-3:]
        if not words:
            return ""
        unheard = any(text in word for text in UNHEARD for word in words)
        meant = (
            ", as it missed what it is sent: this computer, or the link, did not keep up" if unheard else ""
        )
        return f'. It said: "{"; ".join(words)}"{meant}'

    def ask_time(self, now: float) -> int:
        """The number to send in TIMESYNC, by which the answer is known again."""
        stamp = int(now * 1e9) + 1
        if len(self._trips) > 16:
            self._trips.clear()
        self._trips[stamp] = now
        return stamp

    def zero_depth(self, now: float) -> float:
        """As `Link.zero_depth`."""
        recent = [pressure for when, pressure in self._pressures if when > now - 2.0]
        if len(recent) < 5:
            raise RuntimeError(
                f"surface pressure: expected 5 readings within 2 s, got {len(recent)}. "
                "Is the Bar30 connected, and SCALED_PRESSURE2 asked for?"
            )
        if max(recent) - min(recent) > 10.0:
            raise RuntimeError(
                f"surface pressure: expected readings within 10 hPa, got {min(recent)} to {max(recent)}. "
                "Let the vehicle float still"
            )
        self.surface = statistics.median(recent)
        return self.surface

    def take(self, message: Any, now: float) -> Measurement | None:
        """Take a message of the vehicle, and give the measurement in it.

        Raises:
            Strange: Its numbers cannot be true, or it came before.
        """
        kind, told = message.get_type(), self._instruments
        place = self._count(message.get_seq()) if message.get_srcComponent() == 1 else 0
        if hasattr(message, "time_boot_ms") and message.get_srcComponent() == 1:
            self._look_for_reboot(message.time_boot_ms / 1000.0, now)
        values = self.values
        if kind == "HEARTBEAT":
            # Overtaken by other messages it is still news; by a later one of its own it is not.
            if place <= self._last_heartbeat:
                raise Strange("HEARTBEAT: repeated or overtaken")
            self._heartbeat(message, now)
            self._last_heartbeat = place
        elif kind == told.imu_from:
            imu = imu_of(message, now)
            # Heard is also what is dated wrongly, but nothing that cannot be true.
            self.seen["imu_heard"] = now
            imu = replace(imu, time=self._time(message, kind, now))
            self.seen["imu"] = now
            return imu
        elif kind in ("ATTITUDE", "ATTITUDE_QUATERNION"):
            attitude = attitude_of(message)
            values["attitude"] = attitude
            if kind == told.heading_from:
                heading = heading_of(attitude, self._time(message, kind, now), told.heading_sigma)
                self.seen["attitude"] = now
                return heading
        elif kind == "SCALED_PRESSURE2":
            pressure = pressure_of(message)
            when = self._time(message, kind, now)
            self.seen["pressure"] = now
            self._pressures.append((now, pressure))
            if math.isfinite(self.surface):
                depth = depth_of(pressure, self.surface, told.density, when, told.depth_sigma)
                values["depth"] = -depth.z
                return depth
            raise Strange("depth: surface pressure not known yet")
        elif kind == "LOCAL_POSITION_NED":
            values["own_altitude"], values["own_altitude_from"] = own_altitude_of(message), kind
            self.seen["own_altitude"] = self.seen["local"] = now
        elif kind == "GLOBAL_POSITION_INT":
            altitude = own_altitude_of(message)
            if self.age("local", now) > LOCAL:
                values["own_altitude"], values["own_altitude_from"] = altitude, kind
                self.seen["own_altitude"] = now
        elif kind == "SERVO_OUTPUT_RAW" and message.port == 0:
            values["thrust"] = thrust_of(message)
        elif kind == "SYS_STATUS":
            self._status(message, now)
            self.seen["status"] = now
        elif kind == "NAMED_VALUE_FLOAT":
            self._named(text_of(message.name), float(message.value))
        elif kind == "STATUSTEXT":
            text = text_of(message.text)
            self.texts.append((now, int(message.severity), text))
            if "leak" in text.lower() and message.severity <= self._dialect.MAV_SEVERITY_WARNING:
                values["leak"] = True
        elif kind == "AUTOPILOT_VERSION":
            v = int(message.flight_sw_version)
            values["version"] = f"{v >> 24 & 255}.{v >> 16 & 255}.{v >> 8 & 255}"
        elif kind == "TIMESYNC":
            self._synchronise(message, now)
        elif kind in MOUNT_MESSAGES:
            values["camera_tilt"] = tilt_of(message)
        return None

    def _count(self, sequence: int) -> int:
        """The place of a packet in the order in which they were sent; their numbers go round after 255."""
        ahead = (sequence - self._newest) % 256 if self._newest >= 0 else sequence - self._newest
        if self._newest >= 0 and (ahead > 128 or ahead == 0):
            return self._newest - (256 - ahead) % 256  # overtaken on its way, or a second copy
        self._packets += 1
        self._missing += ahead - 1 if self._newest >= 0 else 0
        self._newest += ahead
        return self._newest

    def _time(self, message: Any, kind: str, now: float) -> float:
        """When it was true, later than any before it of its kind."""
        if hasattr(message, "time_boot_ms"):
            name, stamp = "boot", message.time_boot_ms / 1e3
        else:
            name, stamp = "usec", message.time_usec / 1e6
        clock = self._clocks[name]
        jumps = clock.jumps
        when = clock.time(stamp, now)
        if clock.jumps != jumps:
            self._last_stamp.clear()
        if stamp <= self._last_stamp.get(kind, -math.inf) or when <= self._last_time.get(kind, -math.inf):
            raise Strange(f"{kind}: repeated or overtaken")
        self._last_stamp[kind] = stamp
        self._last_time[kind] = when
        return when

    def _look_for_reboot(self, boot: float, now: float) -> None:
        """The boot clock went back, twice: once may be a packet that came late."""
        if boot < self._boot - 1.0:
            self._backwards += 1
            if self._backwards < 2:
                return
            self.reboots += 1
            self._newest = self._last_heartbeat = -1
            for forgotten in ("version", "own_altitude", "local"):  # it may have another zero
                self.values.pop(forgotten, None)
                self.seen.pop(forgotten, None)
            self.texts.append((now, 0, "the autopilot started anew"))
            self._boot = boot
        self._backwards = 0
        self._boot = max(self._boot, boot)

    def _heartbeat(self, message: Any, now: float) -> None:
        d = self._dialect
        if message.type != d.MAV_TYPE_SUBMARINE or message.autopilot != d.MAV_AUTOPILOT_ARDUPILOTMEGA:
            raise Strange("heartbeat: not of an ArduSub")
        self.values["mode"] = MODES.get(message.custom_mode, f"MODE_{message.custom_mode}")
        self.values["armed"] = bool(message.base_mode & d.MAV_MODE_FLAG_SAFETY_ARMED)
        self.values["failsafe"] = message.system_status == d.MAV_STATE_CRITICAL
        self.seen["heartbeat"] = now

    def _status(self, message: Any, now: float) -> None:
        millivolts, percent = message.voltage_battery, message.battery_remaining
        self.values["voltage"] = millivolts / 1000.0 if 0 < millivolts < 65535 else math.nan
        self.values["sagged"] = self._sag(now, self.values["voltage"])
        self.values["battery"] = percent / 100.0 if 0 <= percent <= 100 else math.nan
        if message.current_battery >= 0 and 0 < millivolts < 65535:
            watts = millivolts / 1000.0 * message.current_battery / 100.0
            then, drew = self._metered or (now, watts)
            drawn = self.values.get("drawn_wh", 0.0) + 0.5 * (watts + drew) * (now - then) / 3600.0
            self.values["drawn_wh"], self._metered = drawn, (now, watts)
        leak = self._dialect.MAV_SYS_STATUS_SENSOR_LEAK
        if message.onboard_control_sensors_present & self._dialect.MAV_SYS_STATUS_EXTENSION_USED:
            enabled = message.onboard_control_sensors_enabled_extended & leak
            if enabled and not message.onboard_control_sensors_health_extended & leak:
                self.values["leak"] = True

    def _named(self, name: str, value: float) -> None:
        if not math.isfinite(value):
            raise Strange("named value: not finite")
        if name == "PilotGain":
            self.values["pilot_gain"] = value
        elif name == "Lights1":
            self.values["lights"] = value
        elif name == "InputHold":
            self.values["input_hold"] = value > 0.5

    def _synchronise(self, message: Any, now: float) -> None:
        sent = self._trips.pop(message.ts1, None)
        if sent is None or message.tc1 <= 0 or not sent <= now <= sent + 1.0:
            return
        stamp = message.tc1 / 1e9
        for clock in self._clocks.values():
            if abs(clock.newest - stamp) < 10.0:  # not a clock that counts from elsewhere
                jumps = clock.jumps
                clock.round_trip(sent, stamp, now)
                if clock.jumps != jumps:
                    self._last_stamp.clear()
                    self._slipped = f"the autopilot's clock slipped by {clock.slipped:+.2f} s", now
