"""MAVLink → thruster commands: a scripted ArduSub."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dream import extras

try:
    from pymavlink.dialects.v20 import ardupilotmega as mav
except ImportError as error:
    raise ImportError(extras.missing("rov", "pymavlink", "vehicle")) from error

from dream.geometry import wrap_angle
from dream.measurements import Depth
from dream.robots.bluerov2.standin import motors, telemetry
from dream.robots.bluerov2.standin.attitude import Ahrs, Origin
from dream.robots.bluerov2.standin.failsafes import Failsafes
from dream.robots.bluerov2.standin.helm import ALT_HOLD, GUIDED, MODES, NEED_POSITION, SURFACE, ModeControl
from dream.robots.bluerov2.standin.motors import NEUTRAL_PWM, Channels
from dream.robots.bluerov2.standin.parameters import STABLE, Firmware, Parameters
from dream.robots.bluerov2.standin.tank import BEAT, Tank
from dream.robots.bluerov2.standin.wire import Address

Float64Array = npt.NDArray[np.float64]
Message = Any
"""A message of pymavlink, which has no types."""

SPOOLED = 0.5
"""Seconds after it is armed in which its motors do not run yet."""
TRUED = 0.13
"""Share a second by which a heading that turns out to be magnetic goes to where it then ends."""
OVERTRUED = 0.27
"""Share of the declination by which that is beyond true north."""
DIVED = 0.5
"""Metres below where it was armed at which it aligns its heading anew, once."""
AIDED = 1.0
"""Seconds for which a report of external navigation counts."""
FASTEST = 50.0
"""Hertz: the greatest rate of a stream over the link."""
ARM_MAGIC = 2989.0
"""Second parameter of MAV_CMD_COMPONENT_ARM_DISARM that overrules the checks."""
PARAMETERS_A_BEAT = 2
"""Parameters sent in a beat while the whole list is asked for."""
MOST_TEXT = 50
"""Bytes of a STATUSTEXT."""
LIGHTS_CHANNEL = 13
"""Output of the lights on a Navigator."""
HERE = (223_000_000, 1_142_000_000)
"""Degrees of latitude and longitude, times 1e7, that a receiver has."""
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
"""MAV_RESULT."""

BATTERY_CHECK = 0x1 | 0x100
"""Bits of ARMING_CHECK, for all and for this."""
UNASKED = (mav.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT,)
"""Messages that come, but not when they are asked for."""

Send = Callable[[bytes, "Address | None"], None]


class Frame(enum.IntEnum):
    """MAV_FRAME of the position targets that are taken."""

    LOCAL_NED = 1
    LOCAL_OFFSET_NED = 7
    BODY_NED = 8
    BODY_OFFSET_NED = 9
    BODY_FRD = 12


BODY_FRAMES = (Frame.BODY_NED, Frame.BODY_OFFSET_NED, Frame.BODY_FRD)
OFFSET_FRAMES = (Frame.LOCAL_OFFSET_NED, *BODY_FRAMES)


class ArduSub:
    """An autopilot that keeps ArduSub's rules towards its ground station.

    What it does: speaks MAVLink 2 as ArduSub does (modes and their gates, arming, MANUAL_CONTROL, position
    targets, failsafes, parameters, streams), and drives the vehicle of a `Tank` with simple loops of its own
    at 100 Hz. It knows attitude, heading and depth by the tank's noisy instruments (`attitude.Ahrs`).
    Horizontal position and velocity, which it has only with `fix` or while it is fed by external navigation,
    are the truth.

    Reference: ArduSub 4.5 to 4.7 (`GCS_MAVLink_Sub.cpp`, `failsafe.cpp`, `mode_*.cpp`), behaviour only. Kept
    faithfully, because they bite: a yaw rate of GUIDED outlives the time-out of its velocity; what is not
    understood is ignored without a word; pilot input that was never there does not disarm; sticks stay where
    they were last put until a failsafe neutralises them; why it refuses is told after that it does; its
    altitude above the sea is 0 until it has an origin, and then what that says; its heading is magnetic until
    then, true some ten seconds later, and leaps where it first dives; a depth target is cut to what it could
    stop for; what is left of the battery it tells only where it knows a capacity, and as if it had booted on
    a full one.

    Simplified: the modes `MODES` only, no missions, no fences, no crash check, no input hold (buttons do
    nothing); GUIDED without any yaw holds its heading, where ArduSub turns to the last one it was told.

    Faults: `reboot`, `jump_clock`, and those of the tank and the wire.
    """

    _pulses: list[int]
    _home: bool
    """Has it had a position, and by that a home?"""
    _asker: Address | None
    """Who is answered."""

    def __init__(
        self,
        tank: Tank,
        send: Send,
        *,
        system: int = 1,
        gcs: int = 255,
        firmware: Firmware = STABLE,
        booted: float = 137.0,
    ) -> None:
        """Boot, disarmed and in MANUAL.

        Args:
            tank: The vehicle.
            send: Takes the bytes of a message and where they go: to who asked, or None for the ground
                station.
            system: System id of the vehicle.
            gcs: System id of the ground station that it listens to.
            firmware: What it is called and how it calls its parameters.
            booted: Seconds since it started, at the tank's start.
        """
        self.tank = tank
        self.parameters = Parameters(firmware, system, gcs)
        self._ready(tank.vehicle.thrusters.count)
        self._send = send
        self._mav = mav.MAVLink(None, srcSystem=system, srcComponent=mav.MAV_COMP_ID_AUTOPILOT1)
        self._parser = mav.MAVLink(None)
        self._parser.robust_parsing = True
        self._zero = self._switched_on_at = tank.conditions.depth_zero
        self.ahrs = Ahrs(tank.imu, tank.heading, self._own_depth)
        """What it knows of its attitude and depth, which counts from `Conditions.depth_zero`, or from where
        it has since been higher."""
        self.fix = False
        """Has it a receiver, and by that a position and an origin? A field for tests."""
        self.refused: dict[str, int] = {}
        """How often what was refused without a word, by reason."""
        self._booted_at, self._offset = tank.time, booted
        self._asleep_until = -math.inf
        self._boot(tank.time - booted)

    # ------------------------------------------------------------------------------------ what others see
    @property
    def armed(self) -> bool:
        """Do its motors run?"""
        return self._armed

    @property
    def mode(self) -> int:
        """custom_mode."""
        return self.helm.mode

    @property
    def sticks(self) -> Channels:
        """As the pilot last put them."""
        return self.helm.sticks

    @property
    def pulses(self) -> list[int]:
        """Microseconds to each motor."""
        return list(self._pulses)

    @property
    def commands(self) -> Float64Array:
        """(n,) to the thrusters of the tank."""
        return motors.commands(self._pulses)

    @property
    def tilt(self) -> float:
        """Radians that the camera looks up."""
        return math.radians(self._tilt_deg)

    @property
    def lights(self) -> float:
        """Of full brightness."""
        return min(max((self.servos.get(LIGHTS_CHANNEL, 1100) - 1100) / 800.0, 0.0), 1.0)

    @property
    def position_ok(self) -> bool:
        """Has it a position? By `fix`, or by external navigation with an origin (ArduSub: `position_ok`)."""
        chosen = self.parameters["VISO_TYPE"] >= 1.0 and self.parameters["EK3_SRC1_POSXY"] == 6.0
        return self.fix or (chosen and self._origin is not None and self._now - self._aided < AIDED)

    @property
    def origin(self) -> Origin | None:
        """Of its estimate; None as long as nobody has told it any."""
        if self.fix:
            return Origin(*HERE, self.tank.conditions.altitude + self._switched_on_at)
        return self._origin

    @property
    def altitude(self) -> float:
        """Metres above the sea, as far as it knows; 0 without an origin."""
        origin = self.origin
        return 0.0 if origin is None else self.ahrs.z + origin.alt

    @property
    def relative_altitude(self) -> float:
        """Metres above its home; once that is set, it is given as if the sea were the home (as in 4.7)."""
        return self.altitude if self.fix or self._home else self.ahrs.z

    @property
    def drawn(self) -> float:
        """Ampere-hours that were drawn from the battery since it booted: it takes that for a full one."""
        return self.tank.used - self._drawn_before

    @property
    def clock(self) -> float:
        """Seconds since it booted, as it counts them; never below 0."""
        return max(self._now - self._booted_at + self._offset, 0.0)

    @property
    def boot_ms(self) -> int:
        """The same in milliseconds, as stamps have it."""
        return int(1e3 * self.clock) % (1 << 32)

    # ------------------------------------------------------------------------------------ faults
    def reboot(self, silent: float = 5.0) -> None:
        """Start anew: silent for so many seconds, then disarmed, in MANUAL, with its clock at zero."""
        self._asleep_until = self._now + silent
        self._armed = False
        self._pulses = [NEUTRAL_PWM] * len(self._pulses)

    def jump_clock(self, seconds: float) -> None:
        """Its clock leaps."""
        self._offset += seconds

    # ------------------------------------------------------------------------------------ running
    def hear(self, data: bytes, sender: Address | None = None) -> None:
        """Bytes from a ground station; answers go back to the sender."""
        if self._asleep:
            return
        for message in self._parser.parse_buffer(data) or ():
            if message.get_type() == "BAD_DATA":
                self._refuse("not MAVLink")
            else:
                self._asker = sender
                self._handle(message)
        self._asker = None

    def beat(self) -> None:
        """After each beat of the tank: feel, check, steer, report."""
        if self._asleep_until > -math.inf and not self._asleep:
            self._asleep_until, self._offset = -math.inf, 0.0
            self._booted_at = self._now
            self._boot(self._now)
        tank, ahrs = self.tank, self.ahrs
        ahrs.feel(tank.imu, BEAT)
        if tank.heading.time == tank.time:
            ahrs.face(tank.heading)
        if tank.depth.time == tank.time:
            # It is never in the air: what is above its zero is its zero.
            self._zero = max(self._zero, tank.depth.z)
            ahrs.sink(self._own_depth)
        if self._asleep:
            return
        self._home = self._home or self.position_ok
        self._orient()
        self.failsafes.check()
        self._steer()
        self._report()

    def close(self) -> None:
        """It holds nothing."""

    def set_mode(self, mode: int) -> bool:
        """Change the mode, where it may be; does it hold now?"""
        if mode == self.mode:
            return True
        if mode not in MODES:
            self.say(mav.MAV_SEVERITY_WARNING, f"No such mode {mode}")
            return False
        if mode in NEED_POSITION and not self.position_ok:
            self.say(mav.MAV_SEVERITY_WARNING, f"Mode change failed: {MODES[mode]} requires position")
            return False
        self.helm.enter(mode)
        self._later.append(telemetry.heartbeat(self))
        return True

    def arm(self, *, force: bool = False) -> bool:
        """Let the motors run, where all checks pass; do they now?"""
        if self._armed:
            return True
        lowest = self.parameters["BATT_ARM_VOLT"]
        checks = int(self.parameters["ARMING_CHECK"]) & BATTERY_CHECK
        if not force and checks and self.tank.voltage < lowest:
            self.say(mav.MAV_SEVERITY_CRITICAL, "Arm: Battery 1 below minimum arming voltage")
            return False
        self.say(mav.MAV_SEVERITY_INFO, "Arming motors")
        self._armed, self._armed_at = True, self._now
        self.tank.release()
        self.helm.relax()
        self._dives_from = self.ahrs.z
        if self.origin is None:
            self._locate()
        return True

    def disarm(self) -> None:
        """Stop the motors."""
        if self._armed:
            self.say(mav.MAV_SEVERITY_INFO, "Disarming motors")
            self._armed = False

    @property
    def _now(self) -> float:
        return self.tank.time

    @property
    def _asleep(self) -> bool:
        return self._now < self._asleep_until

    @property
    def _own_depth(self) -> Depth:
        """The gauge's height from the zero of its own."""
        depth = self.tank.depth
        return replace(depth, z=depth.z - self._zero)

    def _ready(self, count: int) -> None:
        config = {6: 1, 8: 2}.get(count)
        if config is None:
            raise ValueError(f"vehicle: expected 6 or 8 thrusters, as ArduSub mixes them, got {count}")
        self.parameters.change("FRAME_CONFIG", config)

    def _boot(self, at: float) -> None:
        """All that does not last over a reboot."""
        self._drawn_before = self.tank.used
        config = int(self.parameters["FRAME_CONFIG"])
        name, table = motors.FRAMES.get(config, motors.FRAMES[2])
        self._table = np.array(table)
        self._pulses = [NEUTRAL_PWM] * self.tank.vehicle.thrusters.count
        self._armed, self._armed_at = False, -math.inf
        self.helm = ModeControl(self.tank, self.ahrs, self.parameters)
        """Mode, sticks and targets."""
        self.failsafes = Failsafes(self, at)
        self._origin: Origin | None = None
        self._home, self._aided = False, -math.inf
        self._dives_from = -math.inf
        self.ahrs.deviate(self.tank.conditions.declination)
        self._later: list[Message] = []
        self._tilt_deg = 0.0
        self.servos = {LIGHTS_CHANNEL: 1100}
        """Microseconds of the outputs that are no motors, by channel."""
        self._listing: list[str] = []
        self._lister: Address | None = None
        self._asker = None
        self._intervals = dict(telemetry.DEFAULT_INTERVALS)
        self._due = dict.fromkeys(self._intervals, self._now)
        self._mav.srcSystem = self.parameters.system
        version = ".".join(map(str, self.parameters.firmware.version))
        self.say(mav.MAV_SEVERITY_INFO, f"ArduSub V{version} (stand-in)")
        self.say(mav.MAV_SEVERITY_INFO, f"Frame: {name}")

    def _locate(self) -> None:
        """Take the origin of its parameters, where they have one."""
        lat, lon, alt = (self.parameters[f"ORIGIN_{name}"] for name in ("LAT", "LON", "ALT"))
        if lat == 0.0 or lon == 0.0:
            self.say(mav.MAV_SEVERITY_WARNING, "Backup location parameters are missing or zero")
        elif self._begins_at(Origin(round(1e7 * lat), round(1e7 * lon), alt)):
            self.say(mav.MAV_SEVERITY_INFO, "Using backup location")
            return
        else:
            self.say(mav.MAV_SEVERITY_WARNING, "Failed to set origin, check EK3_SRC parameters")
        self.say(mav.MAV_SEVERITY_WARNING, "Compass performance degraded")

    def _begins_at(self, origin: Origin) -> bool:
        """Take an origin, once; not where a receiver is to tell it."""
        if self.origin is not None or self.parameters["EK3_SRC1_POSXY"] == 3.0:
            return False
        self._origin = origin
        self.say(mav.MAV_SEVERITY_INFO, "EKF3 IMU0 origin set")
        return True

    def _orient(self) -> None:
        """With an origin it knows its declination, and goes to true north, and beyond; a dive aligns it."""
        ahrs, declination = self.ahrs, self.tank.conditions.declination
        if self.origin is not None and ahrs.deviation != 0.0:
            ends = -OVERTRUED * declination
            ahrs.deviate(ahrs.deviation + TRUED * BEAT * (ends - ahrs.deviation))
        if self._armed and ahrs.z < self._dives_from - DIVED:
            self._dives_from = -math.inf
            leapt = ahrs.deviate(declination if self.origin is None else 0.0)
            self.helm.swung(-leapt - ahrs.align(self.tank.heading))
            self.say(mav.MAV_SEVERITY_INFO, "EKF3 IMU0 MAG0 in-flight yaw alignment complete")

    def _steer(self) -> None:
        if not self._armed or self._now < self._armed_at + SPOOLED:
            self.helm.relax()
            self._pulses = [NEUTRAL_PWM] * len(self._pulses)
            return
        self.helm.look()
        if self.mode == SURFACE and self.helm.surfaced:
            self.set_mode(ALT_HOLD)
        table = self._table[: len(self._pulses)]
        directions = np.array([self.parameters[f"MOT_{k + 1}_DIRECTION"] for k in range(len(table))])
        pulses = motors.mixed(self.helm.axes(), table, directions)
        self._pulses = pulses + [NEUTRAL_PWM] * (len(self._pulses) - len(table))

    # ------------------------------------------------------------------------------------ what it hears
    def _handle(self, message: Message) -> None:
        kind = message.get_type()
        handler = getattr(self, f"_on_{kind.lower()}", None)
        if handler is None:
            self._refuse(f"{kind} unknown")
            return
        target = getattr(message, "target_system", None)
        if target is not None and target not in (0, self.parameters.system):
            self._refuse(f"{kind} for another system")
            return
        component = getattr(message, "target_component", 0)
        if component not in (0, mav.MAV_COMP_ID_AUTOPILOT1):
            self._refuse(f"{kind} for another component")
            return
        handler(message)

    def _from_gcs(self, message: Message) -> bool:
        if message.get_srcSystem() == self.parameters.gcs:
            return True
        self._refuse(f"{message.get_type()} from another ground station")
        return False

    def _on_heartbeat(self, message: Message) -> None:
        if message.get_srcSystem() == self.parameters.gcs:
            self.failsafes.seen()

    def _on_manual_control(self, message: Message) -> None:
        if not self._from_gcs(message):
            return
        if message.target != self.parameters.system:
            self._refuse("MANUAL_CONTROL for another system")
            return
        sticks = Channels.of(
            message.x,
            message.y,
            message.z,
            message.r,
            gain=self.helm.gain,
            throttle_gain=self.parameters["JS_THR_GAIN"],
        )
        extra = message.enabled_extensions
        s, t = message.s if extra & 1 else 0, message.t if extra & 2 else 0
        self.helm.sticks = sticks.tilted(s, t)
        self.failsafes.piloted()

    def _on_rc_channels_override(self, message: Message) -> None:
        if not self._from_gcs(message):
            return
        names = ("pitch", "roll", "throttle", "yaw", "forward", "lateral")
        old = self.helm.sticks
        given = {}
        for k, name in enumerate(names, 1):
            pwm = getattr(message, f"chan{k}_raw")
            given[name] = getattr(old, name) if pwm in (0, 65535) else min(max(pwm, 1100), 1900)
        self.helm.sticks = Channels(**given)
        self.failsafes.piloted()

    def _on_set_mode(self, message: Message) -> None:
        if message.base_mode & mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            done = self.set_mode(message.custom_mode)
            result = ACCEPTED if done else FAILED
            self._acknowledge(mav.MAVLINK_MSG_ID_SET_MODE, result, message)
        else:
            self._refuse("SET_MODE without a custom mode")

    def _on_set_position_target_local_ned(self, message: Message) -> None:
        if self.mode != GUIDED:
            self._refuse("SET_POSITION_TARGET_LOCAL_NED outside GUIDED")
            return
        if message.coordinate_frame not in set(Frame):
            self._refuse("SET_POSITION_TARGET_LOCAL_NED in an unknown frame")
            return
        mask, frame = message.type_mask, Frame(message.coordinate_frame)
        # Any bit of a triple ignores all three of it.
        takes = not mask & 0x7, not mask & 0x38, not mask & 0x1C0, not mask & 0x400, not mask & 0x800
        position, velocity, acceleration, yaw, yaw_rate = takes
        if acceleration or not (position or velocity):
            self._refuse("SET_POSITION_TARGET_LOCAL_NED with acceleration, or with nothing")
            return
        vx, vy, vz = (message.vx, message.vy, message.vz) if velocity else (0.0, 0.0, 0.0)
        heading, rate = message.yaw if yaw else 0.0, message.yaw_rate if yaw_rate else 0.0
        place = (message.x, message.y, message.z) if position else (0.0, 0.0, 0.0)
        if not all(map(math.isfinite, (*place, vx, vy, vz, heading, rate))):
            self._refuse("SET_POSITION_TARGET_LOCAL_NED that is not finite")
            return
        helm = self.helm
        turned = helm.yaw if frame in BODY_FRAMES else 0.0
        c, s = math.cos(turned), math.sin(turned)
        target = None
        if position:
            x, y, z = place
            target = (c * x - s * y, s * x + c * y, -z)
            if frame in OFFSET_FRAMES:
                north, east = helm.here
                target = (target[0] + north, target[1] + east, target[2] + self.ahrs.z)
        relative = helm.yaw if frame == Frame.BODY_OFFSET_NED else 0.0
        helm.follow(
            (c * vx - s * vy, s * vx + c * vy, -vz),
            target,
            heading=wrap_angle(heading + relative) if yaw else None,
            turn=rate if yaw_rate else None,
        )

    def _on_set_position_target_global_int(self, message: Message) -> None:
        if self.mode not in (GUIDED, ALT_HOLD):
            self._refuse("SET_POSITION_TARGET_GLOBAL_INT outside GUIDED and ALT_HOLD")
            return
        mask = message.type_mask
        if self.mode == ALT_HOLD:
            if not mask & 0x4 and math.isfinite(message.alt):
                self.helm.loops.z = message.alt
            else:
                self._refuse("SET_POSITION_TARGET_GLOBAL_INT without a depth")
            return
        if mask & 0x1C0 != 0x1C0 or mask & 0x38 or not mask & 0x7:
            # Places on the globe mean nothing in a tank.
            self._refuse("SET_POSITION_TARGET_GLOBAL_INT of another kind than velocity")
            return
        velocity = (message.vx, message.vy, -message.vz)
        if all(map(math.isfinite, velocity)):
            self.helm.drift(velocity)

    def _on_set_gps_global_origin(self, message: Message) -> None:
        if not self._begins_at(Origin(message.latitude, message.longitude, 1e-3 * message.altitude)):
            self._refuse("SET_GPS_GLOBAL_ORIGIN where it has one, or a receiver")

    def _aid(self, message: Message) -> None:
        self._aided = self._now

    _on_odometry = _on_vision_position_delta = _on_vision_speed_estimate = _aid
    _on_vision_position_estimate = _on_global_vision_position_estimate = _aid

    def _on_distance_sensor(self, message: Message) -> None:
        """Taken, and of no use here."""

    def _on_system_time(self, message: Message) -> None:
        """Taken, and of no use here."""

    def _on_timesync(self, message: Message) -> None:
        if message.tc1 == 0:
            self._answer(mav.MAVLink_timesync_message(int(self.clock * 1e9), message.ts1))

    def _on_param_request_list(self, message: Message) -> None:
        self._listing, self._lister = self.parameters.names, self._asker

    def _on_param_request_read(self, message: Message) -> None:
        names = self.parameters.names
        name = message.param_id if message.param_index < 0 else ""
        if 0 <= message.param_index < len(names):
            name = names[message.param_index]
        if name in self.parameters:
            self._answer(self._parameter(name))
        else:
            self._refuse("PARAM_REQUEST_READ of no parameter")

    def _on_param_set(self, message: Message) -> None:
        name = message.param_id
        if not self.parameters.change(name, message.param_value):
            self._refuse("PARAM_SET of no parameter")
            return
        if name == "JS_GAIN_DEFAULT":
            self.helm.adjust()
        self._answer(self._parameter(name))

    def _on_command_int(self, message: Message) -> None:
        values = (message.param1, message.param2, message.param3, message.param4)
        self._command(message, (*values, message.x, message.y, message.z))

    def _on_command_long(self, message: Message) -> None:
        self._command(message, tuple(getattr(message, f"param{k}") for k in range(1, 8)))

    def _command(self, message: Message, values: tuple[float, ...]) -> None:
        handler = _COMMANDS.get(message.command)
        result = UNSUPPORTED if handler is None else handler(self, values)
        self._acknowledge(message.command, result, message)

    def _do_arm(self, values: tuple[float, ...]) -> int:
        if values[0] == 1.0:
            done = self.arm(force=values[1] == ARM_MAGIC)
            return ACCEPTED if done else FAILED
        if values[0] == 0.0:
            self.disarm()
            return ACCEPTED
        return UNSUPPORTED

    def _do_mode(self, values: tuple[float, ...]) -> int:
        if not _whole(values[0]) & mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return DENIED
        return ACCEPTED if self.set_mode(_whole(values[1])) else FAILED

    def _do_interval(self, values: tuple[float, ...]) -> int:
        kind, interval = _whole(values[0]), values[1]
        if kind not in telemetry.BUILDERS or kind in UNASKED or not math.isfinite(interval):
            self.say(mav.MAV_SEVERITY_INFO, f"No ap_message for mavlink id ({kind})")
            return DENIED
        if interval < 0.0:
            self._intervals.pop(kind, None)
        elif interval == 0.0:
            self._intervals[kind] = telemetry.DEFAULT_INTERVALS.get(kind, 1.0)
        else:
            self._intervals[kind] = max(1e-6 * interval, 1.0 / FASTEST)
        self._due[kind] = self._now
        return ACCEPTED

    def _do_tell_interval(self, values: tuple[float, ...]) -> int:
        kind = _whole(values[0])
        if kind not in telemetry.BUILDERS:
            return FAILED
        interval = self._intervals.get(kind)
        self._answer(
            mav.MAVLink_message_interval_message(kind, -1 if interval is None else round(1e6 * interval))
        )
        return ACCEPTED

    def _do_message(self, values: tuple[float, ...]) -> int:
        kind = _whole(values[0])
        build = telemetry.BUILDERS.get(kind)
        if build is None or kind in UNASKED:
            return FAILED
        self._answer(build(self))
        return ACCEPTED

    def _do_servo(self, values: tuple[float, ...]) -> int:
        channel, pwm = _whole(values[0]), _whole(values[1])
        if channel <= len(self._pulses) or channel == telemetry.TILT_CHANNEL:
            self.say(mav.MAV_SEVERITY_INFO, f"ServoRelayEvent: Channel {channel} is already in use")
            return FAILED
        if not (channel <= 16 and 800 <= pwm <= 2200):
            return FAILED
        self.servos[channel] = pwm
        return ACCEPTED

    def _do_mount(self, values: tuple[float, ...]) -> int:
        if _whole(values[6]) == mav.MAV_MOUNT_MODE_NEUTRAL:
            return self._tilted(0.0)
        if _whole(values[6]) != mav.MAV_MOUNT_MODE_MAVLINK_TARGETING:
            return UNSUPPORTED
        return self._tilted(values[0])

    def _do_gimbal(self, values: tuple[float, ...]) -> int:
        return self._tilted(values[0])

    def _tilted(self, pitch_deg: float) -> int:
        if not math.isfinite(pitch_deg):
            return FAILED
        low, high = self.parameters["MNT1_PITCH_MIN"], self.parameters["MNT1_PITCH_MAX"]
        self._tilt_deg = min(max(pitch_deg, low), high)
        return ACCEPTED

    def _do_reboot(self, values: tuple[float, ...]) -> int:
        if values[0] != 1.0:
            return UNSUPPORTED
        if self._armed:
            return FAILED
        self.reboot()
        return ACCEPTED

    # ------------------------------------------------------------------------------------ what it says
    def _refuse(self, why: str) -> None:
        self.refused[why] = self.refused.get(why, 0) + 1

    def _tell(self, message: Message) -> None:
        self._out(message, None)

    def _answer(self, message: Message) -> None:
        self._out(message, self._asker)

    def _out(self, message: Message, to: Address | None) -> None:
        data = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        self._send(data, to)

    def say(self, severity: int, text: str) -> None:
        """A STATUSTEXT, with the next beat: after the answer to what is heard now."""
        self._later.append(mav.MAVLink_statustext_message(severity, text.encode()[:MOST_TEXT]))

    def _acknowledge(self, command: int, result: int, to: Message) -> None:
        source, component = to.get_srcSystem(), to.get_srcComponent()
        self._answer(mav.MAVLink_command_ack_message(command, result, 0, 0, source, component))

    def _report(self) -> None:
        now = self._now
        for message in self._later:
            self._tell(message)
        self._later.clear()
        for kind, interval in self._intervals.items():
            if now >= self._due[kind] - 1e-9:
                self._due[kind] = max(self._due[kind] + interval, now)
                if kind != mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED or self.position_ok:
                    self._tell(telemetry.BUILDERS[kind](self))
        for name in self._listing[:PARAMETERS_A_BEAT]:
            self._out(self._parameter(name), self._lister)
        del self._listing[:PARAMETERS_A_BEAT]

    def _parameter(self, name: str) -> Message:
        names = self.parameters.names
        return mav.MAVLink_param_value_message(
            name.encode(), self.parameters[name], self.parameters.kind(name), len(names), names.index(name)
        )


def _whole(value: float) -> int:
    """A parameter of a command as a whole number; −1 where it is none."""
    return int(value) if math.isfinite(value) and abs(value) < 1e9 else -1


_COMMANDS: dict[int, Callable[[ArduSub, tuple[float, ...]], int]] = {
    mav.MAV_CMD_COMPONENT_ARM_DISARM: ArduSub._do_arm,
    mav.MAV_CMD_DO_SET_MODE: ArduSub._do_mode,
    mav.MAV_CMD_SET_MESSAGE_INTERVAL: ArduSub._do_interval,
    mav.MAV_CMD_GET_MESSAGE_INTERVAL: ArduSub._do_tell_interval,
    mav.MAV_CMD_REQUEST_MESSAGE: ArduSub._do_message,
    mav.MAV_CMD_DO_SET_SERVO: ArduSub._do_servo,
    mav.MAV_CMD_DO_MOUNT_CONTROL: ArduSub._do_mount,
    mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: ArduSub._do_gimbal,
    mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: ArduSub._do_reboot,
}
