"""MAVLink → thruster commands: a scripted ArduSub."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

try:
    from pymavlink.dialects.v20 import ardupilotmega as mav
except ImportError as error:
    raise ImportError('a BlueROV2 needs pymavlink: pip install "dream-auv[rov]"') from error

from dream.geometry import wrap_angle
from dream.robots.bluerov2.standin import motors
from dream.robots.bluerov2.standin.attitude import Ahrs
from dream.robots.bluerov2.standin.loops import WAY, Loops, towards
from dream.robots.bluerov2.standin.motors import NEUTRAL_PWM, Sticks
from dream.robots.bluerov2.standin.parameters import STABLE, Firmware, Parameters
from dream.robots.bluerov2.standin.tank import BEAT, Tank
from dream.robots.bluerov2.standin.wire import Address
from dream.vehicle import GRAVITY

Float64Array = npt.NDArray[np.float64]
Message = Any
"""A message of pymavlink, which has no types."""

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
YAW_DEAD, THROTTLE_DEAD_UNIT = 40.0, 1000.0 / 800.0
"""Microseconds about the middle in which a yaw stick at full gain says nothing; units of throttle per one."""
WARNED_GCS, WARNED_LEAK = 30.0, 20.0
"""Seconds between two warnings of the same."""
AIDED = 1.0
"""Seconds for which a report of external navigation counts."""
FASTEST = 50.0
"""Hertz: the greatest rate of a stream over the link."""
AIR_PRESSURE, WATER_PRESSURE = 1013.25, 98.0665
"""hPa at the surface, and per metre of fresh water."""
FIELD = (180.0, 420.0)
"""Milligauss of the Earth's field, horizontally and down."""
ARM_MAGIC, DISARM_MAGIC = 2989.0, 21196.0
"""Second parameter of MAV_CMD_COMPONENT_ARM_DISARM that overrules the checks."""
PARAMETERS_A_BEAT = 2
"""Parameters sent in a beat while the whole list is asked for."""
MOST_TEXT = 50
"""Bytes of a STATUSTEXT."""
LIGHTS_CHANNEL, TILT_CHANNEL = 13, 16
"""Outputs of a Navigator."""
SENSORS = 0x1 | 0x2 | 0x4 | 0x8 | 0x400 | 0x800 | 0x1000 | 0x8000 | 0x200000
"""MAV_SYS_STATUS_SENSOR bits that it has: gyroscopes, accelerometers, compass, pressure, its controllers,
motors and attitude."""
PREARM = 0x10000000
CAPABILITIES = 0x2 | 0x4 | 0x80 | 0x100 | 0x2000
"""MAV_PROTOCOL_CAPABILITY: float parameters, missions, both position targets, MAVLink 2."""

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
"""MAV_RESULT."""

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
    they were last put until a failsafe neutralises them.

    Simplified: the modes `MODES` only, no missions, no fences, no crash check, no input hold (buttons do
    nothing); GUIDED without any yaw holds its heading, where ArduSub turns to the last one it was told.

    Faults: `reboot`, `jump_clock`, and those of the tank and the wire.
    """

    _mode: int
    _sticks: Sticks
    _pulses: list[int]
    _loops: Loops
    _velocity: tuple[float, float, float]
    """Of GUIDED: north, east and up, m/s."""
    _turn: float | None
    """Of GUIDED: rad/s clockwise; None where a heading is held."""
    _target: tuple[float, float, float] | None
    """Of GUIDED: north, east and up, metres; None where it follows a velocity."""
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
        self._ahrs = Ahrs(tank.imu, tank.heading, tank.depth)
        self.fix = False
        """Has it a position, whatever it is fed? A field for tests."""
        self.refused: dict[str, int] = {}
        """How often what was refused without a word, by reason."""
        self._booted_at, self._offset = tank.time, booted
        self._started_at = tank.time - booted
        self._asleep_until = -math.inf
        self._builders: dict[int, Callable[[], Message]] = {
            mav.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self._attitude_quaternion,
            mav.MAVLINK_MSG_ID_RAW_IMU: self._raw_imu,
            mav.MAVLINK_MSG_ID_SCALED_IMU2: self._scaled_imu2,
            mav.MAVLINK_MSG_ID_SCALED_PRESSURE2: self._scaled_pressure2,
            mav.MAVLINK_MSG_ID_VFR_HUD: self._vfr_hud,
            mav.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mav.MAVLINK_MSG_ID_SYSTEM_TIME: self._system_time,
            mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: self._gimbal,
            mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: self._servo_output_raw,
            mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT: self._ekf_status_report,
            mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position_ned,
            mav.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: self._cam_tilt,
            mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._autopilot_version,
            mav.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
        }
        self._boot()

    # ------------------------------------------------------------------------------------ what others see
    @property
    def armed(self) -> bool:
        """Do its motors run?"""
        return self._armed

    @property
    def mode(self) -> int:
        """custom_mode."""
        return self._mode

    @property
    def sticks(self) -> Sticks:
        """As the pilot last put them."""
        return self._sticks

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
        return min(max((self._servos.get(LIGHTS_CHANNEL, 1100) - 1100) / 800.0, 0.0), 1.0)

    @property
    def position_ok(self) -> bool:
        """Has it a position? By `fix`, or by external navigation with an origin (ArduSub: `position_ok`)."""
        chosen = self.parameters["VISO_TYPE"] >= 1.0 and self.parameters["EK3_SRC1_POSXY"] == 6.0
        return self.fix or (chosen and self._origin and self._now - self._aided < AIDED)

    @property
    def clock(self) -> float:
        """Seconds since it booted, as it counts them."""
        return self._now - self._booted_at + self._offset

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
            self._booted_at = self._started_at = self._now
            self._boot()
        tank, ahrs = self.tank, self._ahrs
        ahrs.feel(tank.imu, BEAT)
        if tank.heading.time == tank.time:
            ahrs.face(tank.heading)
        if tank.depth.time == tank.time:
            ahrs.sink(tank.depth)
        if self._asleep:
            return
        self._check()
        self._steer()
        self._report()

    def set_mode(self, mode: int) -> bool:
        """Change the mode, where it may be; does it hold now?"""
        if mode == self._mode:
            return True
        if mode not in MODES:
            self._say(mav.MAV_SEVERITY_WARNING, f"No such mode {mode}")
            return False
        if mode in NEED_POSITION and not self.position_ok:
            self._say(mav.MAV_SEVERITY_WARNING, f"Mode change failed: {MODES[mode]} requires position")
            return False
        self._mode = mode
        self._loops.relax(self._ahrs.z)
        self._heading = self._yaw
        self._turned_at = -math.inf
        self._at = self._here
        self._velocity, self._velocity_at, self._turn, self._target = (0.0, 0.0, 0.0), -math.inf, None, None
        if mode == MANUAL:
            self._sticks = Sticks()
        self._tell(self._heartbeat())
        return True

    def arm(self, *, force: bool = False) -> bool:
        """Let the motors run, where all checks pass; do they now?"""
        if self._armed:
            return True
        lowest = self.parameters["BATT_ARM_VOLT"]
        if not force and self.parameters["ARMING_CHECK"] != 0.0 and self.tank.voltage < lowest:
            self._say(mav.MAV_SEVERITY_CRITICAL, "Arm: Battery 1 below minimum arming voltage")
            return False
        self._say(mav.MAV_SEVERITY_INFO, "Arming motors")
        self._armed = True
        self.tank.release()
        self._loops.relax(self._ahrs.z)
        self._heading, self._at = self._yaw, self._here
        return True

    def disarm(self) -> None:
        """Stop the motors."""
        if self._armed:
            self._say(mav.MAV_SEVERITY_INFO, "Disarming motors")
            self._armed = False

    @property
    def _now(self) -> float:
        return self.tank.time

    @property
    def _asleep(self) -> bool:
        return self._now < self._asleep_until

    @property
    def _yaw(self) -> float:
        """Radians, clockwise from north."""
        return wrap_angle(0.5 * math.pi - self._ahrs.euler[2])

    @property
    def _here(self) -> tuple[float, float]:
        """Metres north and east: the truth."""
        x, y, _ = self.tank.state.position.tolist()
        return y, x

    def _ready(self, count: int) -> None:
        config = {6: 1, 8: 2}.get(count)
        if config is None:
            raise ValueError(f"vehicle: expected 6 or 8 thrusters, as ArduSub mixes them, got {count}")
        self.parameters.change("FRAME_CONFIG", config)

    def _boot(self) -> None:
        """All that does not last over a reboot."""
        self._armed, self._mode = False, MANUAL
        self._sticks = Sticks()
        self._gain = min(max(self.parameters["JS_GAIN_DEFAULT"], 0.1), 1.0)
        config = int(self.parameters["FRAME_CONFIG"])
        name, table = motors.FRAMES.get(config, motors.FRAMES[2])
        self._table = np.array(table)
        self._pulses = [NEUTRAL_PWM] * self.tank.vehicle.thrusters.count
        self._loops = Loops(self._ahrs.z)
        self._heading, self._turned_at, self._at = self._yaw, -math.inf, self._here
        self._velocity, self._velocity_at, self._turn, self._target = (0.0, 0.0, 0.0), -math.inf, None, None
        self._origin, self._aided = False, -math.inf
        self._piloted_at, self._gcs_at = -math.inf, -math.inf
        self._pilot_lost = self._gcs_lost = self._leaking = False
        self._warned_gcs = self._warned_leak = -math.inf
        self._low_since = {"low": math.inf, "critical": math.inf}
        self._battery_failed: set[str] = set()
        self._tilt_deg = 0.0
        self._servos = {LIGHTS_CHANNEL: 1100}
        self._listing: list[str] = []
        self._lister: Address | None = None
        self._asker = None
        self._next_heartbeat = self._now
        self._intervals = dict(_DEFAULT_INTERVALS)
        self._due = dict.fromkeys(self._intervals, self._now)
        self._mav.srcSystem = self.parameters.system
        version = ".".join(map(str, self.parameters.firmware.version))
        self._say(mav.MAV_SEVERITY_INFO, f"ArduSub V{version} (stand-in)")
        self._say(mav.MAV_SEVERITY_INFO, f"Frame: {name}")

    # ------------------------------------------------------------------------------------ failsafes
    def _check(self) -> None:
        self._check_pilot()
        self._check_gcs()
        self._check_leak()
        self._check_battery()

    def _check_pilot(self) -> None:
        action, timeout = self.parameters["FS_PILOT_INPUT"], self.parameters["FS_PILOT_TIMEOUT"]
        # What was never there is lost once that long after booting, and then not again.
        since = max(self._piloted_at, self._started_at)
        if action == 0.0 or self._now < since + timeout:
            self._pilot_lost = False
            return
        if self._pilot_lost:
            return
        self._pilot_lost = True
        self._say(mav.MAV_SEVERITY_CRITICAL, "Lost manual control")
        self._sticks = Sticks()
        if action == 2.0:
            self.disarm()

    def _check_gcs(self) -> None:
        action, timeout = self.parameters["FS_GCS_ENABLE"], self.parameters["FS_GCS_TIMEOUT"]
        if action == 0.0 or self._gcs_at == -math.inf:
            return
        if self._now - self._gcs_at < timeout:
            self._gcs_lost = False
            return
        if self._now - self._warned_gcs > WARNED_GCS:
            self._warned_gcs = self._now
            self._say(mav.MAV_SEVERITY_WARNING, f"MYGCS: {self.parameters.gcs}, heartbeat lost")
        if self._gcs_lost or not self._armed:
            return
        self._gcs_lost = True
        if action == 2.0 or (
            action in (3.0, 4.0) and not self.set_mode(ALT_HOLD if action == 3.0 else SURFACE)
        ):
            self.disarm()

    def _check_leak(self) -> None:
        action = self.parameters["FS_LEAK_ENABLE"]
        if not self.tank.leak or action == 0.0:
            self._leaking = False
            return
        if self._now - self._warned_leak > WARNED_LEAK:
            self._warned_leak = self._now
            self._say(mav.MAV_SEVERITY_CRITICAL, "Leak Detected")
        if not self._leaking:
            self._leaking = True
            if action == 2.0 and self._armed:
                self.set_mode(SURFACE)

    def _check_battery(self) -> None:
        levels = (
            ("low", "BATT_LOW_VOLT", "BATT_FS_LOW_ACT"),
            ("critical", "BATT_CRT_VOLT", "BATT_FS_CRT_ACT"),
        )
        for word, volts, act in levels:
            if self.parameters[volts] <= 0.0 or self.tank.voltage >= self.parameters[volts]:
                self._low_since[word] = math.inf
                continue
            self._low_since[word] = min(self._low_since[word], self._now)
            late = self._now - self._low_since[word] >= self.parameters["BATT_LOW_TIMER"]
            if not late or word in self._battery_failed:
                continue
            self._battery_failed.add(word)
            used = f"{self.tank.voltage:.1f}V used {1000.0 * self.tank.used:.0f} mAh"
            self._say(mav.MAV_SEVERITY_WARNING, f"Battery 1 is {word} {used}")
            if self.parameters[act] == 2.0:
                self.disarm()
            elif self.parameters[act] == 3.0:
                self.set_mode(SURFACE)

    # ------------------------------------------------------------------------------------ steering
    def _steer(self) -> None:
        if not self._armed:
            self._loops.relax(self._ahrs.z)
            self._heading, self._at = self._yaw, self._here
            self._pulses = [NEUTRAL_PWM] * len(self._pulses)
            return
        axes = self._axes()
        table = self._table[: len(self._pulses)]
        directions = np.array([self.parameters[f"MOT_{k + 1}_DIRECTION"] for k in range(len(table))])
        self._pulses = motors.mixed(axes, table, directions) + [NEUTRAL_PWM] * (
            len(self._pulses) - len(table)
        )

    def _axes(self) -> tuple[float, float, float, float, float, float]:
        """Roll, pitch, yaw, throttle, forward and lateral."""
        sticks = self._sticks
        forward, lateral = motors.share(sticks.forward), motors.share(sticks.lateral)
        if self._mode == MANUAL:
            roll, pitch = motors.share(sticks.roll), motors.share(sticks.pitch)
            return roll, pitch, motors.share(sticks.yaw), motors.share(sticks.throttle), forward, lateral
        turn = self._stick_turn()
        climb = self._stick_climb()
        if self._mode == STABILIZE:
            return (*self._levelled(self._held(turn)), motors.share(sticks.throttle), forward, lateral)
        if self._mode == ALT_HOLD:
            return (*self._levelled(self._held(turn)), self._throttle(climb), forward, lateral)
        if self._mode == SURFACE:
            if self._ahrs.z > 0.01 * self.parameters["SURFACE_DEPTH"]:
                self.set_mode(ALT_HOLD)
            rising = 0.01 * min(self.parameters["WPNAV_SPEED_UP"], self.parameters["PILOT_SPEED_UP"])
            return (*self._levelled(turn), self._throttle(rising), forward, lateral)
        if self._mode == POSHOLD:
            return self._position_held(turn, climb, forward, lateral)
        return self._guided(turn)

    def _position_held(
        self, turn: float, climb: float, forward: float, lateral: float
    ) -> tuple[float, float, float, float, float, float]:
        axes, throttle = self._levelled(self._held(turn)), self._throttle(climb)
        if forward != 0.0 or lateral != 0.0:
            self._at = self._here
            self._loops.velocity = list(self._ground_velocity()[:2])
            return (*axes, throttle, forward, lateral)
        return (*axes, throttle, *self._over_ground(self._way(self._at)))

    def _guided(self, turn: float) -> tuple[float, float, float, float, float, float]:
        if self._now - self._velocity_at > GUIDED_TIMEOUT:
            # The rate of turn is not forgotten: so it is on the vehicle.
            self._velocity = (0.0, 0.0, 0.0)
        if self._target is None:
            wanted, climb = self._velocity[:2], self._velocity[2]
        else:
            north, east, up = self._target
            way = self._way((north, east))
            wanted, climb = (way[0] + self._velocity[0], way[1] + self._velocity[1]), 0.0
            self._loops.z = up
        if turn != 0.0 and not self._pilot_lost:
            rate = turn
            self._heading = self._yaw
        elif self._turn is not None:
            rate = self._turn
            self._heading = self._yaw
        else:
            rate = towards(self._heading, self._yaw)
        return (*self._levelled(rate), self._throttle(climb), *self._over_ground(wanted))

    def _way(self, to: tuple[float, float]) -> tuple[float, float]:
        """Velocity north and east towards a place, at most WPNAV_SPEED."""
        here = self._here
        north, east = WAY * (to[0] - here[0]), WAY * (to[1] - here[1])
        factor = min(1.0, 0.01 * self.parameters["WPNAV_SPEED"] / max(math.hypot(north, east), 1e-9))
        return factor * north, factor * east

    def _ground_velocity(self) -> tuple[float, float, float]:
        """m/s north, east and up: the truth."""
        x, y, z = self.tank.state.velocity_world.tolist()
        return y, x, z

    def _over_ground(self, wanted: tuple[float, float]) -> tuple[float, float]:
        return self._loops.ground(self._ground_velocity()[:2], wanted, self._yaw, BEAT)

    def _levelled(self, turn: float) -> tuple[float, float, float]:
        most = math.radians(0.01 * self.parameters["ANGLE_MAX"])
        roll, pitch = most * motors.share(self._sticks.roll), most * motors.share(self._sticks.pitch)
        return self._loops.attitude(self._ahrs, roll, pitch, turn, BEAT)

    def _held(self, turn: float) -> float:
        """The stick's rate of turn; where it says none, one that holds the heading."""
        if turn != 0.0:
            self._turned_at = self._now
        elif self._now >= self._turned_at + RELEASED:
            return towards(self._heading, self._yaw)
        self._heading = self._yaw
        return turn

    def _stick_turn(self) -> float:
        """rad/s clockwise."""
        dead, away = YAW_DEAD * self._gain, self._sticks.yaw - NEUTRAL_PWM
        if abs(away) <= dead:
            return 0.0
        angle = 45.0 * (abs(away) - dead) / (motors.HALF_PWM - dead)
        return math.copysign(math.radians(angle * self.parameters["ACRO_YAW_P"]), away)

    def _stick_climb(self) -> float:
        """m/s upwards."""
        if self._pilot_lost:
            return 0.0
        up = self.parameters["PILOT_SPEED_UP"]
        down = self.parameters["PILOT_SPEED_DN"] or up
        dead = min(max(self.parameters["THR_DZ"], 0.0), 400.0) * self._gain
        away = THROTTLE_DEAD_UNIT * (self._sticks.throttle - NEUTRAL_PWM)
        if abs(away) <= dead:
            return 0.0
        return math.copysign(0.01 * (up if away > 0.0 else down) * (abs(away) - dead) / (500.0 - dead), away)

    def _throttle(self, climb: float) -> float:
        surface = 0.01 * self.parameters["SURFACE_DEPTH"]
        least = self.parameters["SURFACE_MAX_THR"]
        most = least + (1.0 - least) * min(max(surface - self._ahrs.z, 0.0), 1.0)
        acceleration = 0.01 * self.parameters["PILOT_ACCEL_Z"]
        return min(self._loops.depth(self._ahrs, climb, acceleration, surface, BEAT), most)

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
            self._gcs_at = self._now

    def _on_manual_control(self, message: Message) -> None:
        if not self._from_gcs(message):
            return
        if message.target != self.parameters.system:
            self._refuse("MANUAL_CONTROL for another system")
            return
        sticks = Sticks.of(
            message.x,
            message.y,
            message.z,
            message.r,
            gain=self._gain,
            throttle_gain=self.parameters["JS_THR_GAIN"],
        )
        extra = message.enabled_extensions
        s, t = message.s if extra & 1 else 0, message.t if extra & 2 else 0
        self._sticks = sticks.tilted(s, t, gain=self._gain)
        self._piloted_at = self._gcs_at = self._now

    def _on_rc_channels_override(self, message: Message) -> None:
        if not self._from_gcs(message):
            return
        names = ("pitch", "roll", "throttle", "yaw", "forward", "lateral")
        old = self._sticks
        given = {}
        for k, name in enumerate(names, 1):
            pwm = getattr(message, f"chan{k}_raw")
            given[name] = getattr(old, name) if pwm in (0, 65535) else min(max(pwm, 1100), 1900)
        self._sticks = Sticks(**given)
        self._piloted_at = self._gcs_at = self._now

    def _on_set_mode(self, message: Message) -> None:
        if message.base_mode & mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            done = self.set_mode(message.custom_mode)
            result = ACCEPTED if done else FAILED
            self._acknowledge(mav.MAVLINK_MSG_ID_SET_MODE, result, message)
        else:
            self._refuse("SET_MODE without a custom mode")

    def _on_set_position_target_local_ned(self, message: Message) -> None:
        if self._mode != GUIDED:
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
        turned = self._yaw if frame in BODY_FRAMES else 0.0
        c, s = math.cos(turned), math.sin(turned)
        if position:
            x, y, z = place
            north, east, up = c * x - s * y, s * x + c * y, -z
            if frame in OFFSET_FRAMES:
                here = self._here
                north, east, up = north + here[0], east + here[1], up + self._ahrs.z
            self._target = (north, east, up)
        else:
            self._target = None
        self._velocity = (c * vx - s * vy, s * vx + c * vy, -vz)
        self._velocity_at = self._now
        self._turn = rate if yaw_rate else None
        if yaw:
            self._turn = None
            relative = frame == Frame.BODY_OFFSET_NED
            self._heading = wrap_angle(heading + (self._yaw if relative else 0.0))

    def _on_set_position_target_global_int(self, message: Message) -> None:
        if self._mode not in (GUIDED, ALT_HOLD):
            self._refuse("SET_POSITION_TARGET_GLOBAL_INT outside GUIDED and ALT_HOLD")
            return
        mask = message.type_mask
        if self._mode == ALT_HOLD:
            if not mask & 0x4 and math.isfinite(message.alt):
                self._loops.z = message.alt
            else:
                self._refuse("SET_POSITION_TARGET_GLOBAL_INT without a depth")
            return
        if mask & 0x1C0 != 0x1C0 or mask & 0x38 or not mask & 0x7:
            # Places on the globe mean nothing in a tank.
            self._refuse("SET_POSITION_TARGET_GLOBAL_INT of another kind than velocity")
            return
        velocity = (message.vx, message.vy, -message.vz)
        if all(map(math.isfinite, velocity)):
            self._target, self._velocity, self._velocity_at = None, velocity, self._now

    def _on_set_gps_global_origin(self, message: Message) -> None:
        self._origin = True

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
            self._gain = min(max(self.parameters[name], 0.1), 1.0)
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
        if kind not in self._builders or not math.isfinite(interval):
            return FAILED
        if interval < 0.0:
            self._intervals.pop(kind, None)
        elif interval == 0.0:
            self._intervals[kind] = _DEFAULT_INTERVALS.get(kind, 1.0)
        else:
            self._intervals[kind] = max(1e-6 * interval, 1.0 / FASTEST)
        self._due[kind] = self._now
        return ACCEPTED

    def _do_tell_interval(self, values: tuple[float, ...]) -> int:
        kind = _whole(values[0])
        if kind not in self._builders:
            return FAILED
        interval = self._intervals.get(kind)
        self._answer(
            mav.MAVLink_message_interval_message(kind, -1 if interval is None else round(1e6 * interval))
        )
        return ACCEPTED

    def _do_message(self, values: tuple[float, ...]) -> int:
        build = self._builders.get(_whole(values[0]))
        if build is None:
            return FAILED
        self._answer(build())
        return ACCEPTED

    def _do_servo(self, values: tuple[float, ...]) -> int:
        channel, pwm = _whole(values[0]), _whole(values[1])
        if channel <= len(self._pulses) or channel == TILT_CHANNEL:
            self._say(mav.MAV_SEVERITY_INFO, f"ServoRelayEvent: Channel {channel} is already in use")
            return FAILED
        if not (channel <= 16 and 800 <= pwm <= 2200):
            return FAILED
        self._servos[channel] = pwm
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

    def _say(self, severity: int, text: str) -> None:
        self._tell(mav.MAVLink_statustext_message(severity, text.encode()[:MOST_TEXT]))

    def _acknowledge(self, command: int, result: int, to: Message) -> None:
        source, component = to.get_srcSystem(), to.get_srcComponent()
        self._answer(mav.MAVLink_command_ack_message(command, result, 0, 0, source, component))

    def _report(self) -> None:
        now = self._now
        if now >= self._next_heartbeat:
            self._next_heartbeat += 1.0
            self._tell(self._heartbeat())
        for kind, interval in self._intervals.items():
            if now >= self._due[kind] - 1e-9:
                self._due[kind] = max(self._due[kind] + interval, now)
                if kind != mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED or self.position_ok:
                    self._tell(self._builders[kind]())
        for name in self._listing[:PARAMETERS_A_BEAT]:
            self._out(self._parameter(name), self._lister)
        del self._listing[:PARAMETERS_A_BEAT]

    @property
    def _boot_ms(self) -> int:
        return int(1e3 * self.clock) % (1 << 32)

    def _parameter(self, name: str) -> Message:
        names = self.parameters.names
        return mav.MAVLink_param_value_message(
            name.encode(), self.parameters[name], self.parameters.kind(name), len(names), names.index(name)
        )

    def _heartbeat(self) -> Message:
        flags = mav.MAV_MODE_FLAG_STABILIZE_ENABLED | mav.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        flags |= mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if self._armed:
            flags |= mav.MAV_MODE_FLAG_SAFETY_ARMED
        if self._mode in NEED_POSITION:
            flags |= mav.MAV_MODE_FLAG_GUIDED_ENABLED
        status = mav.MAV_STATE_ACTIVE if self._armed else mav.MAV_STATE_STANDBY
        if self._pilot_lost or self._gcs_lost or self._leaking or self._battery_failed:
            status = mav.MAV_STATE_CRITICAL
        return mav.MAVLink_heartbeat_message(
            mav.MAV_TYPE_SUBMARINE, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, flags, self._mode, status, 3
        )

    def _attitude(self) -> Message:
        roll, pitch, _ = self._ahrs.euler
        p, q, r = self._ahrs.rates
        return mav.MAVLink_attitude_message(self._boot_ms, roll, -pitch, self._yaw, p, -q, -r)

    def _attitude_quaternion(self) -> Message:
        roll, pitch, _ = self._ahrs.euler
        p, q, r = self._ahrs.rates
        wxyz = _quaternion(roll, -pitch, self._yaw)
        return mav.MAVLink_attitude_quaternion_message(self._boot_ms, *wxyz, p, -q, -r)

    def _inertial(self) -> tuple[int, ...]:
        """Milligravities, milliradians a second and milligauss, forward-right-down."""
        fx, fy, fz = self.tank.imu.specific_force.tolist()
        p, q, r = self._ahrs.rates
        force = [1000.0 * value / GRAVITY for value in (fx, -fy, -fz)]
        turn = [1000.0 * value for value in (p, -q, -r)]
        yaw = 0.5 * math.pi - self.tank.heading.yaw
        field = (FIELD[0] * math.cos(yaw), -FIELD[0] * math.sin(yaw), FIELD[1])
        return tuple(min(max(round(value), -32768), 32767) for value in (*force, *turn, *field))

    def _raw_imu(self) -> Message:
        return mav.MAVLink_raw_imu_message(int(1e6 * self.clock), *self._inertial(), 0, 2500)

    def _scaled_imu2(self) -> Message:
        return mav.MAVLink_scaled_imu2_message(self._boot_ms, *self._inertial(), 2500)

    def _scaled_pressure2(self) -> Message:
        water = -self.tank.depth.z * WATER_PRESSURE
        return mav.MAVLink_scaled_pressure2_message(self._boot_ms, AIR_PRESSURE + water, water, 2000)

    def _vfr_hud(self) -> Message:
        speed = math.hypot(*self._ground_velocity()[:2]) if self.position_ok else 0.0
        heading = int(math.degrees(self._yaw) % 360.0)
        thrust = int(50.0 + 50.0 * motors.share(self._sticks.throttle)) if self._armed else 0
        return mav.MAVLink_vfr_hud_message(0.0, speed, heading, thrust, self._ahrs.z, self._ahrs.climb)

    def _sys_status(self) -> Message:
        tank = self.tank
        ready = self.parameters["BATT_ARM_VOLT"] <= tank.voltage
        capacity = max(self.parameters["BATT_CAPACITY"], 1.0)
        left = min(max(100.0 - 1e5 * tank.used / capacity, 0.0), 100.0)
        present = SENSORS | PREARM
        healthy = present if ready else SENSORS
        volts, amperes = round(1000.0 * tank.voltage), round(100.0 * tank.amperes)
        return mav.MAVLink_sys_status_message(
            present, present, healthy, 250, volts, min(amperes, 32767), int(left), 0, 0, 0, 0, 0, 0
        )

    def _system_time(self) -> Message:
        return mav.MAVLink_system_time_message(0, self._boot_ms)

    def _gimbal(self) -> Message:
        # A servo mount: forward-right-down, about the vehicle.
        wxyz = _quaternion(0.0, self.tilt, 0.0)
        flags = mav.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
        return mav.MAVLink_gimbal_device_attitude_status_message(
            0, 0, self._boot_ms, flags, wxyz, math.nan, math.nan, math.nan, 0, math.nan, math.nan, 1
        )

    def _cam_tilt(self) -> Message:
        return mav.MAVLink_named_value_float_message(self._boot_ms, b"CamTilt", 0.5 + self._tilt_deg / 90.0)

    def _servo_output_raw(self) -> Message:
        outputs = {**dict(enumerate(self._pulses, 1)), **self._servos}
        outputs[TILT_CHANNEL] = round(NEUTRAL_PWM - motors.HALF_PWM * self._tilt_deg / 45.0)
        pulses = [outputs.get(channel, 0) for channel in range(1, 17)]
        return mav.MAVLink_servo_output_raw_message(int(1e6 * self.clock) % (1 << 32), 0, *pulses)

    def _ekf_status_report(self) -> Message:
        flags = mav.EKF_ATTITUDE | mav.EKF_VELOCITY_VERT | mav.EKF_POS_VERT_ABS
        if self.position_ok:
            flags |= mav.EKF_VELOCITY_HORIZ | mav.EKF_POS_HORIZ_REL | mav.EKF_POS_HORIZ_ABS
        else:
            flags |= mav.EKF_CONST_POS_MODE
        return mav.MAVLink_ekf_status_report_message(flags, 0.05, 0.05, 0.02, 0.05, 0.0)

    def _local_position_ned(self) -> Message:
        north, east = self._here
        vn, ve, _ = self._ground_velocity()
        z, climb = self._ahrs.z, self._ahrs.climb
        return mav.MAVLink_local_position_ned_message(self._boot_ms, north, east, -z, vn, ve, -climb)

    def _autopilot_version(self) -> Message:
        major, minor, patch = self.parameters.firmware.version
        version = major << 24 | minor << 16 | patch << 8 | 255
        return mav.MAVLink_autopilot_version_message(
            CAPABILITIES, version, 0, 0, 0, b"standin\0", b"\0" * 8, b"\0" * 8, 0, 0, 1
        )


def _whole(value: float) -> int:
    """A parameter of a command as a whole number; −1 where it is none."""
    return int(value) if math.isfinite(value) and abs(value) < 1e9 else -1


def _quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


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
_DEFAULT_INTERVALS = {
    mav.MAVLINK_MSG_ID_ATTITUDE: 0.25,
    mav.MAVLINK_MSG_ID_RAW_IMU: 0.5,
    mav.MAVLINK_MSG_ID_SCALED_IMU2: 0.5,
    mav.MAVLINK_MSG_ID_SCALED_PRESSURE2: 0.5,
    mav.MAVLINK_MSG_ID_VFR_HUD: 0.25,
    mav.MAVLINK_MSG_ID_SYS_STATUS: 0.5,
    mav.MAVLINK_MSG_ID_SYSTEM_TIME: 0.5,
    mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: 0.5,
    mav.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: 0.5,
    mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 0.5,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 0.5,
}
"""Seconds between two of a stream that nobody has asked for otherwise."""
