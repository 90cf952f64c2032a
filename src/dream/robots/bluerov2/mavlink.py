"""The link to ArduSub: telemetry and measurements in, requests and motion out."""

from __future__ import annotations

import contextlib
import importlib
import json
import logging
import math
import struct
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

from dream import extras
from dream.files import write_whole
from dream.robots.bluerov2.motion import ExpiringOrders, Order
from dream.robots.bluerov2.parameters import JOYSTICK_PARAMETERS, STATION_ID, Check, rules
from dream.robots.bluerov2.reports import FRESH, MOUNT_MESSAGES, NUMBERS, SURFACE_PRESSURES, Strange, text_of
from dream.robots.bluerov2.sticks import (
    BODY_NED,
    NEUTRAL,
    STILL,
    VELOCITY_AND_YAW_RATE,
    Joystick,
    Sticks,
    forward_right_down,
)
from dream.robots.bluerov2.telemetry import HEADING_SIGMA, Measurement, Reports, Telemetry, TelemetrySources
from dream.robots.bluerov2.threads import REAL_TIME, Thread, Threads
from dream.robots.bluerov2.wire import Pipe, Tcp, Udp, open_pipe

if TYPE_CHECKING:
    from types import ModuleType

logger = logging.getLogger(__name__)

Tap = Callable[[float, str, bool, object], None]

PERIOD = 0.05
"""Seconds between two motion messages."""
LIFELINE = 3.0
"""Seconds for which the link speaks for a dive that does not say that it is alive."""
LOST = 3.0
"""Seconds without a heartbeat of the vehicle after which the link counts as broken."""
EXPECTED = 3.0
"""Seconds within which a mode or an arming that was asked for shows in the heartbeat."""
RATES = MappingProxyType(
    {
        "HEARTBEAT": 5.0,
        "RAW_IMU": 50.0,
        "ATTITUDE": 50.0,
        "SCALED_PRESSURE2": 20.0,
        "GLOBAL_POSITION_INT": 10.0,
        "LOCAL_POSITION_NED": 10.0,
        "SERVO_OUTPUT_RAW": 5.0,
        "SYS_STATUS": 2.0,
        "GIMBAL_DEVICE_ATTITUDE_STATUS": 5.0,
    }
)
"""Hertz that are asked for; ArduSub's own loop for them has 50. A change of mode or arming shows in the
heartbeat, which comes once a second unasked: so long would an order go on in a mode that is not ours.
NAMED_VALUE_FLOAT has no interval and comes unasked."""
OPTIONAL = ("HEARTBEAT", "LOCAL_POSITION_NED", "SERVO_OUTPUT_RAW", "GIMBAL_DEVICE_ATTITUDE_STATUS")
"""Of these, what some versions of ArduSub do not have an interval for."""
BRIGHTER, DIMMER = 32, 33
"""BTNn_FUNCTION of the buttons for the lights. Lights are moved as a pilot does: DO_SET_SERVO is refused for
the output function Lights1 that ArduSub has since 4.5.6, and before that MANUAL_CONTROL overrode it."""
PRESS = 0.15
"""Seconds for which a button is held, and then let go."""
UP = 1.0
"""Metres of depth from which on it is somebody else who ends SURFACE: ArduSub does at 0.1 m."""
REASON = 0.3
"""Seconds that the reason of a refusal may come after it."""
ECHOES = 512
"""Messages of ours that are remembered, to know them again when a router sends them back."""
STATION_MESSAGES = (
    "HEARTBEAT",
    "MANUAL_CONTROL",
    "RC_CHANNELS_OVERRIDE",
    "COMMAND_LONG",
    "COMMAND_INT",
    "SET_MODE",
    "PARAM_SET",
    "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT",
    "SET_ATTITUDE_TARGET",
)
"""What only a station that drives sends."""


class Refused(RuntimeError):  # noqa: N818 - it names what happened.
    """The vehicle answered, and the answer was no."""


@dataclass(frozen=True, slots=True)
class Restored:
    """What became of the parameters that were changed."""

    done: dict[str, float]
    """Name and value of those that are as they were."""
    left: dict[str, str]
    """Name of those that are not, and why."""


class Link:
    """Talks to one ArduSub as its ground station.

    What it does: one thread receives, checks who sent it, keeps telemetry and hands measurements on; one
    thread sends. While the vehicle is armed by this link it repeats the order that holds at 20 Hz, and
    neutral sticks (in GUIDED also a velocity and a yaw rate of zero) when none does. It falls silent, so that
    the vehicle's own failsafe acts, when the dive no longer calls `operator_alive`; and it yields, so that
    somebody else may drive, when another station uses its system id or changes mode or arming.

    Reference: ArduSub 4.7 (`GCS_MAVLink_Sub.cpp`, `joystick.cpp`, `failsafe.cpp`), MAVLink's common.xml.

    Assumes: MAV_GCS_SYSID of the vehicle is `system`; nothing else may send with it.
    Fails when: a router hides other stations' messages from us: then a rival shows only by what it changes.

    Methods that ask (`connect`, `arm`, `set_mode`, `param`, …) wait for the answer, try three times, and
    raise TimeoutError when none comes and `Refused` when it is no. They count as signs of life, too.
    """

    def __init__(
        self,
        address: str | Pipe = "udpin:127.0.0.1:14550",
        *,
        now: Callable[[], float],
        deliver: Callable[[Measurement], None] = lambda _: None,
        tap: Tap | None = None,
        vehicle: int = 1,
        system: int = 255,
        component: int = 190,
        density: float = FRESH,
        surface_pressure: float = math.nan,
        heading_sigma: float = HEADING_SIGMA,
        depth_sigma: float = 0.02,
        imu_from: str = "RAW_IMU",
        heading_from: str = "ATTITUDE",
        rates: Mapping[str, float] = RATES,
        retry: float = 0.5,
        keep: Path | None = None,
        threads: Threads = REAL_TIME,
    ) -> None:
        """Open the port; the threads begin in the with-block.

        Args:
            address: udpin:HOST:PORT (or HOST:PORT) listens, port 0 takes any free one; udpout:HOST:PORT and
                tcp:HOST:PORT go there. Or anything that carries datagrams.
            now: The dive's clock.
            deliver: Takes measurements, in the receiving thread, where nothing may be asked of the vehicle.
            tap: Takes (time, "mavlink", sent, message) for each message. Must not wait for another thread.
            vehicle: System id of the vehicle; its autopilot has component id 1.
            system: System id of ours, which MAV_GCS_SYSID of the vehicle must be.
            component: Component id of ours.
            density: kg/m³ of the water.
            surface_pressure: hPa at the surface, if known; else `zero_depth` finds it.
            heading_sigma: Radians that a heading is uncertain by.
            depth_sigma: Metres that a depth is uncertain by.
            imu_from: RAW_IMU, SCALED_IMU or SCALED_IMU2.
            heading_from: ATTITUDE or ATTITUDE_QUATERNION.
            rates: Names of messages and the hertz to ask for; `imu_from` and `heading_from` among them.
            retry: Seconds to wait for an answer before asking again.
            keep: A file for the old values of parameters, as JSON, written before one is changed: to put
                them back by hand where this program ends without doing so.
            threads: What it waits by.
        """
        if not (1 <= vehicle <= 255 and 1 <= system <= 255 and vehicle != system):
            raise ValueError(
                f"system ids: expected two different ones of 1 to 255, got {vehicle} and {system}"
            )
        lowest, highest = SURFACE_PRESSURES
        if not (math.isnan(surface_pressure) or lowest <= surface_pressure <= highest):
            raise ValueError(
                f"surface_pressure: expected {lowest:g} to {highest:g} hPa, got {surface_pressure:g}. "
                "1 bar is 1000 hPa, 1 kPa is 10 hPa, 1 hPa is 100 Pa"
            )
        self._dialect = dialect()
        self._now, self._threads = now, threads
        self._deliver = deliver
        self._tap = tap
        self.vehicle, self.system, self.component = vehicle, system, component
        self._reports = Reports(
            self._dialect,
            TelemetrySources(imu_from, heading_from, density, heading_sigma, depth_sigma),
            surface_pressure,
        )
        self._rates = dict(rates)
        self._retry = retry
        self._keep = keep
        self.refused: Counter[str] = Counter()
        """What came and was not taken, by reason."""
        self._pipe = open_pipe(address, self.refused) if isinstance(address, str) else address
        self._datagrams = not isinstance(self._pipe, Tcp)
        for name in self._rates:
            self._message_id(name)

        self.rival = ""
        """Who else uses our system id; empty for nobody."""
        self.mode_changed_by_other = ""
        self.armed_by_other = ""
        """Arming or disarming that nobody here asked for; empty for none."""
        self.surfacing = ""
        """Why the vehicle comes up by itself; empty where it does not."""
        self.problem = ""
        """Why the port does not work; empty while it does."""

        self._news = threads.condition()
        self._out = threads.lock()
        self._wake = threads.event()
        self._closed = False
        self._working: list[Thread] = []
        self._reader = self._parser()
        self._writer = self._dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        self._own: deque[bytes] = deque(maxlen=ECHOES)
        self._waiting: list[tuple[Callable[[Any], bool], list[Any]]] = []

        self._motion = ExpiringOrders()
        self._piloting = False
        self._ours = self._disarming = False
        self._expected_armed: tuple[bool, float] = (False, -math.inf)
        self._expected_mode: tuple[str, float] = ("", -math.inf)
        self._alive_until = -math.inf
        self._press: tuple[int, float] = (0, -math.inf)
        self._next_heartbeat = -math.inf
        self._next_beat = -math.inf
        self._ask_again = False

        self._before: dict[str, float] = {}
        self._kept: dict[str, float] = {}
        self._types: dict[str, int] = {}
        self._spelling: dict[str, str] = {}

    # Opening and closing

    def __enter__(self) -> Self:
        for work in (self._receiving, self._sending):
            self._working.append(self._threads.start(work, f"mavlink {work.__name__}"))
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Send neutral if the vehicle moves by our orders, and let go of the port."""
        if self._closed:
            return
        self.stop()
        self._closed = True
        self._wake.set()
        for thread in self._working:
            thread.join(2.0)
        self._pipe.close()

    @property
    def port(self) -> int:
        """The port it listens on; 0 where it does not listen."""
        return self._pipe.port if isinstance(self._pipe, Udp) else 0

    @property
    def connected(self) -> bool:
        """Whether the vehicle's heartbeat is there."""
        return self.age < LOST

    @property
    def age(self) -> float:
        """Seconds since the vehicle's last heartbeat; infinite before the first."""
        return self._reports.age("heartbeat", self._now())

    @property
    def engaged(self) -> bool:
        """Whether this link armed the vehicle, and it still is."""
        return self._ours

    @property
    def yielding(self) -> str:
        """Why it leaves the vehicle to somebody else; empty when it does not."""
        return self.rival or self.mode_changed_by_other or self.armed_by_other

    @property
    def busy(self) -> str:
        """Why the vehicle is not ours to touch, and what to do; empty where it is free, or armed by us."""
        with self._news:
            if self.rival:
                return self.rival
            why = self.yielding
            if not why and self._armed_elsewhere:
                why = "it is armed, and not by this link"
        return f"{why}. Somebody else drives: have it disarmed and let go of, then begin anew" if why else ""

    @property
    def telemetry(self) -> Telemetry:
        """What is known of the vehicle now."""
        with self._news:
            return self._reports.telemetry(self._now())

    @property
    def texts(self) -> list[tuple[float, int, str]]:
        """(time, severity, text) of what the vehicle said lately; severity 0 is worst."""
        with self._news:
            return list(self._reports.texts)

    # Signs of life

    def operator_alive(self) -> None:
        """Say that the dive's main loop runs: for `LIFELINE` seconds from now the link speaks for it."""
        with self._news:
            self._alive_until = self._now() + LIFELINE

    # Motion

    def command(self, order: Order, expires: float) -> float:
        """Move so until then.

        Args:
            order: `Sticks` in ALT_HOLD and other modes, `BodyVelocity` in GUIDED.
            expires: Seconds on the dive's clock. More than 0.5 s ahead is cut to that.

        Returns:
            When it will expire.

        Raises:
            ValueError: Not finite, or faster than a BlueROV2 can be. The order before it holds on.
        """
        with self._news:
            return self._motion.command(order, expires, self._now())

    def pilot(self, sticks: Sticks, expires: float) -> float:
        """A person's sticks, through this program: outrank the mission until then. As `command` else.

        They end a little before the link falls silent for a dive that hangs: ArduSub keeps the last sticks it
        got, and these come from elsewhere than the dive's loop.
        """
        with self._news:
            now = self._now()
            spoken = max(now, self._alive_until - 2.0 * PERIOD)
            return self._motion.pilot(
                sticks, min(expires, spoken) if math.isfinite(expires) else expires, now
            )

    def stop(self) -> None:
        """Forget all orders and send neutral at once."""
        with self._news:
            self._motion.stop()
            self._drive(self._now())

    def resume(self) -> None:
        """Take over again after it yielded: whoever asks for this knows that nobody else drives."""
        with self._news:
            self._motion.stop()
            self.rival = self.mode_changed_by_other = self.armed_by_other = ""
            self._expected_mode = self._reports.values.get("mode", ""), self._now()

    # Questions

    def connect(self, timeout: float = 30.0) -> Telemetry:
        """Wait for the vehicle's heartbeat, learn its version and ask for the messages of `rates`.

        Raises:
            TimeoutError: No heartbeat came, or no answer.
            Refused: It does not send one of the messages.
        """
        if not self._wait(lambda: self.connected, timeout):
            others = ", ".join(reason for reason in self.refused if "system" in reason)
            raise TimeoutError(
                f"vehicle: expected a heartbeat of system {self.vehicle} within {timeout} s, got none"
                f"{' but ' + others if others else ''}. {self.problem} "
                "Does BlueOS have an endpoint to this computer and port?"
            )
        for name, rate in self._rates.items():
            with contextlib.suppress(Refused) if name in OPTIONAL else contextlib.nullcontext():
                self.set_message_interval(name, rate)
        with contextlib.suppress(TimeoutError, Refused):
            self._command("REQUEST_MESSAGE", self._dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, tries=1)
            self._wait(lambda: "version" in self._reports.values, self._retry)
        return self.telemetry

    def arm(self) -> None:
        """Arm, with sticks at neutral from before that on.

        Raises:
            TimeoutError: No answer, or the heartbeat never showed it.
            Refused: It is armed already, somebody else drives, or the vehicle's checks before arming
                failed; the text says which.
        """
        with self._news:
            if self.busy:
                raise Refused(f"arm: expected a vehicle that nobody else drives, got: {self.busy}")
            if self.telemetry.armed:
                raise Refused(
                    "arm: expected a disarmed vehicle, got one that this link armed. disarm() first"
                )
            self.operator_alive()
            self._motion.stop()
            self._piloting = True
            self._expected_armed = True, self._now() + EXPECTED + 3 * self._retry
            self._drive(self._now())
        try:
            self._command("COMPONENT_ARM_DISARM", 1.0)
            if not self._wait(lambda: self._ours, EXPECTED):
                raise TimeoutError(f"arm: expected an armed heartbeat within {EXPECTED} s, got none")
        except (TimeoutError, Refused):
            with self._news:
                # One that says no and arms all the same, as without an origin, is ours to disarm.
                self._piloting = self._ours
                if not self._ours:
                    self._expected_armed = False, self._now() + EXPECTED
            raise

    def disarm(self) -> None:
        """Stop, and disarm.

        Raises:
            TimeoutError: No answer, or the heartbeat never showed it.
            Refused: The vehicle said no.
        """
        self.stop()
        with self._news:
            self._disarming = True
            self._expected_armed = False, self._now() + EXPECTED + 3 * self._retry
        try:
            self._command("COMPONENT_ARM_DISARM", 0.0)
            if not self._wait(lambda: not self._reports.values.get("armed", True), EXPECTED):
                raise TimeoutError(f"disarm: expected a disarmed heartbeat within {EXPECTED} s, got none")
            with self._news:
                self._piloting = False
        finally:
            with self._news:
                self._disarming = False

    def set_mode(self, name: str) -> None:
        """Change the mode, and stop: an order for one mode is none for the next.

        Raises:
            ValueError: There is no such mode.
            TimeoutError: No answer, or the heartbeat never showed it.
            Refused: The vehicle said no: GUIDED, say, needs a position.
        """
        if name not in NUMBERS:
            raise ValueError(f"mode: expected one of {', '.join(NUMBERS)}, got {name!r}")
        self.stop()
        with self._news:
            before = self._expected_mode
            self._expected_mode = name, self._now() + EXPECTED + 3 * self._retry
        try:
            self._command("DO_SET_MODE", self._dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, NUMBERS[name])
            # One that is at the surface already is back in ALT_HOLD before SURFACE ever shows.
            shows = (name, "ALT_HOLD") if name == "SURFACE" else (name,)
            if not self._wait(lambda: self._reports.values.get("mode") in shows, EXPECTED):
                raise TimeoutError(
                    f"mode: expected a heartbeat with {name} within {EXPECTED} s, "
                    f"got {self._reports.values.get('mode')}"
                )
        except Refused:
            with self._news:
                self._expected_mode = before
            raise
        self.stop()

    def set_message_interval(self, name: str, rate: float) -> None:
        """Have a message sent `rate` times a second.

        Raises:
            ValueError: There is no such message, or no such rate.
            TimeoutError: No answer.
            Refused: The vehicle does not send it.
        """
        if not 0.0 < rate <= 400.0:
            raise ValueError(f"rate of {name}: expected hertz above 0 and up to 400, got {rate}")
        self._command("SET_MESSAGE_INTERVAL", self._message_id(name), round(1e6 / rate))

    def param(self, name: str) -> float:
        """A parameter's value; both names of the station's id will do.

        Raises:
            TimeoutError: No answer: mostly, there is no such parameter.
        """
        known = self._spelling.get(name, "")
        spellings = (known,) if known else STATION_ID if name in STATION_ID else (name,)
        for spelling in spellings:
            with contextlib.suppress(TimeoutError):
                value = self._ask_param(spelling)
                self._spelling[name] = spelling
                return value
        raise TimeoutError(
            f"parameter {' or '.join(spellings)}: expected a value, got no answer in 3 tries. "
            "Does this version of ArduSub have it?"
        )

    def set_param(self, name: str, value: float) -> None:
        """Change a parameter and see it changed; `restore` puts the old value back.

        Raises:
            ValueError: Not finite.
            TimeoutError: No answer.
            Refused: The vehicle kept another value, or it is `busy`.
            OSError: The old value cannot be kept; nothing is changed then.
        """
        if not math.isfinite(value):
            raise ValueError(f"parameter {name}: expected a finite number, got {value}")
        self._free(f"parameter {name}")
        old = self.param(name)
        spelling = self._spelling[name]
        with self._news:
            if self._keep is not None and spelling not in self._kept:
                # It stays there after `restore`: it says what the vehicle had.
                values = {**self._kept, spelling: old}
                write_whole(self._keep, (json.dumps(values, indent=2) + "\n").encode())
            self._kept.setdefault(spelling, old)
            self._before.setdefault(spelling, old)
        self._change(spelling, value)

    def _change(self, spelling: str, value: float) -> None:
        message = self._dialect.MAVLink_param_set_message(
            self.vehicle, 1, spelling.encode(), value, self._types[spelling]
        )

        def taken(answer: Any) -> bool:
            return (
                answer.get_type() == "PARAM_VALUE"
                and text_of(answer.param_id) == spelling
                and math.isclose(answer.param_value, value, rel_tol=1e-6, abs_tol=1e-9)
            )

        try:
            self._ask(lambda: message, taken, f"parameter {spelling}")
        except TimeoutError:
            kept = self._ask_param(spelling)
            raise Refused(f"parameter {spelling}: expected {value}, got {kept} from the vehicle") from None

    def restore(self) -> Restored:
        """Put all parameters that `set_param` changed back, each on its own.

        None of an armed vehicle: they are what its failsafes hang on. What is left stays remembered, for
        another try; a warning names it.
        """
        done: dict[str, float] = {}
        left: dict[str, str] = {}
        for name, value in reversed(list(self._before.items())):
            if self._reports.values.get("armed"):
                left[name] = f"expected {value:g}: the vehicle is armed. Disarm it"
                continue
            try:
                self._change(name, value)
            except (TimeoutError, Refused) as error:
                left[name] = str(error)
                continue
            done[name] = value
            with self._news:
                del self._before[name]
        for name, why in left.items():
            logger.warning("%s was %g and is not put back: %s", name, self._before[name], why)
        return Restored(done, left)

    def check_parameters(self) -> list[Check]:
        """Read what safety hangs on. Changes nothing: see `correct`."""
        checks = []
        for rule in rules(self.system):
            try:
                value = self.param(rule.name)
            except TimeoutError:
                value = math.nan
            checks.append(rule.check(self._spelling.get(rule.name, rule.name), value))
        return checks

    def correct(self, checks: list[Check]) -> None:
        """Set those of the checks that are not ok and have a wanted value, as `set_param`."""
        for check in checks:
            if not check.ok and math.isfinite(check.wanted):
                self.set_param(check.name, check.wanted)

    def joystick(self) -> Joystick:
        """What this vehicle makes of sticks, by its parameters and its present gain.

        Raises:
            TimeoutError: FRAME_CONFIG or PILOT_SPEED_UP has no answer; others keep their defaults.
            ValueError: The frame is neither of those that DREAM knows.
        """
        values = {name: self.param(name) for name in ("FRAME_CONFIG", "PILOT_SPEED_UP")}
        for name in JOYSTICK_PARAMETERS:
            with contextlib.suppress(TimeoutError):
                values[name] = values.get(name) or self.param(name)
        gain = self.telemetry.pilot_gain
        return Joystick.of(values, gain=gain if math.isfinite(gain) else None)

    def zero_depth(self) -> float:
        """Take the present pressure for that at the surface, in hPa, and return it.

        Raises:
            RuntimeError: Too few readings within 2 s, or the vehicle bobs by more than a hand's breadth.
        """
        with self._news:
            return self._reports.zero_depth(self._now())

    def tilt_camera(self, up: float, *, tolerance: float = math.radians(3.0), timeout: float = 4.0) -> float:
        """Point the camera and see it point there.

        Args:
            up: Radians; negative looks down.
            tolerance: Radians that it may be off by.
            timeout: Seconds it may take.

        Returns:
            Radians up, as the vehicle reports them.

        Raises:
            ValueError: Beyond what the mount can.
            TimeoutError: No report of the mount, or it stays elsewhere.
            Refused: The vehicle has no mount, or it is `busy`.
        """
        self._free("camera tilt")
        if not abs(up) <= math.radians(60.0):
            raise ValueError(f"camera tilt: expected at most 60° either way, got {math.degrees(up)}°")
        with self._news:
            self._reports.values.pop("camera_tilt", None)
        self._command("DO_MOUNT_CONTROL", math.degrees(up), last=2.0)
        if not self._wait(lambda: abs(self.telemetry.camera_tilt - up) <= tolerance, timeout):
            got = math.degrees(self.telemetry.camera_tilt)
            raise TimeoutError(
                f"camera tilt: expected {math.degrees(up):.0f}° within {timeout} s, got {got:.0f}°. "
                "Is the mount set up in BlueOS?"
            )
        return self.telemetry.camera_tilt

    def set_lights(self, share: float) -> float:
        """Press the buttons for the lights until they are as bright as can be to that share, 0 to 1.

        Returns:
            The share that the vehicle reports.

        Raises:
            ValueError: Not a share.
            Refused: The vehicle is `busy`.
            RuntimeError: No buttons for the lights, or no report of them.
            TimeoutError: The lights do not change.
        """
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"lights: expected a share from 0 to 1, got {share}")
        self._free("lights")
        if not self._wait(lambda: "lights" in self._reports.values, 4.0):
            raise RuntimeError("lights: expected the vehicle's report Lights1, got none")
        buttons = self._light_buttons()
        step = 1.0 / 8.0
        for _ in range(24):
            lights = self.telemetry.lights
            if abs(lights - share) <= 0.5 * step + 0.01:
                return lights
            begin = self._now()
            with self._news:
                # Held for three messages, and let go for three, or the next press would be none.
                self._press = 1 << buttons[BRIGHTER if share > lights else DIMMER], begin
            self._wait(lambda: self._now() > begin + 2.0 * PRESS, 1.0)  # noqa: B023 - it is called here
            if not self._wait(partial(self._lights_moved, lights), 2.0):
                break
            step = abs(self.telemetry.lights - lights)
        raise TimeoutError(f"lights: expected {share:.2f}, got {self.telemetry.lights:.2f} and no change")

    # What the threads do; tests call these with a clock of their own

    def receive(self, data: bytes) -> None:
        """Take what came in: a datagram, or any piece of a stream."""
        messages = []
        try:
            message = self._reader.parse_char(data)
            while message is not None:
                messages.append(message)
                message = self._reader.parse_char(b"")
        except (self._dialect.MAVError, struct.error, ValueError, IndexError, TypeError) as error:
            self.refused[f"broken packet: {type(error).__name__}"] += 1
            self._reader = self._parser()
        if self._datagrams and self._reader.buf_len():
            # A packet ends with its datagram: what is cut off must not eat the next one.
            self.refused["truncated packet"] += 1
            self._reader = self._parser()
        for message in messages:
            self._take(message)

    def beat(self) -> float:
        """Send what is due, and return the seconds until the next time."""
        now = self._now()
        with self._news:
            alive = now < self._alive_until
            if alive and now >= self._next_heartbeat:
                self._next_heartbeat = now + 1.0
                self._heartbeat(now)
            if not alive:
                # Sticks refresh the vehicle's failsafes as heartbeats do: both must end.
                self._motion.stop()
            if now >= self._next_beat:
                if alive:
                    self._drive(now)
                self._next_beat = now + min(PERIOD, self._motion.next_expiry(now))
            return max(0.001, self._next_beat - now)

    # Receiving

    def _receiving(self) -> None:
        pause = 0.1
        while not self._closed:
            try:
                data = self._pipe.receive()
                if data:
                    self.problem, pause = "", 0.1
                    self.receive(data)
            except OSError as error:
                self._trouble(f"cannot receive: {error}")
                self._wake.wait(pause)
                pause = min(2.0 * pause, 5.0)
            except Exception:
                logger.exception("a message of the vehicle was lost")

    def _take(self, message: Any) -> None:
        now = self._now()
        kind = message.get_type()
        if kind == "BAD_DATA":
            reason = str(message.reason)
            self.refused["wrong checksum" if "CRC" in reason else "no packet"] += 1
            return
        self._record(now, False, message)
        sender, component = message.get_srcSystem(), message.get_srcComponent()
        with self._news:
            if sender == self.system:
                self._station(message, kind, component)
                return
            if sender != self.vehicle:
                self.refused[f"from system {sender}"] += 1
                return
            if component != 1 and kind not in MOUNT_MESSAGES:
                self.refused[f"from component {component}"] += 1
                return
            measurement = self._hear(message, kind, now)
            for wanted, answers in self._waiting:
                if wanted(message):
                    answers.append(message)
            self._news.notify_all()
        if measurement is not None:
            self._deliver(measurement)

    def _station(self, message: Any, kind: str, component: int) -> None:
        """A message under our own id: an echo of ours, or somebody who takes it for theirs."""
        if bytes(message.get_msgbuf()) in self._own:
            self.refused["our own, sent back"] += 1
            return
        self.refused["from our own system id"] += 1
        if kind in STATION_MESSAGES and not self.rival:
            self._motion.stop()
            self.rival = (
                f"another station uses our system id {self.system}: {kind} from its component {component}. "
                "Close it, or give one of the two another id"
            )
            logger.warning("%s", self.rival)

    def _hear(self, message: Any, kind: str, now: float) -> Measurement | None:
        reports, measurement = self._reports, None
        before, reboots = dict(reports.values), reports.reboots
        try:
            measurement = reports.take(message, now)
        except Strange as error:
            self.refused[str(error)] += 1
        else:
            if kind == "HEARTBEAT":
                self._pipe.answered(LOST)
                self._watch(before, now)
        if reports.reboots != reboots:
            self._ours = self._piloting = False
            self._motion.stop()
            self._ask_again = True
            logger.warning("the autopilot started anew: it is not armed by us any more")
        return measurement

    def _watch(self, before: dict[str, Any], now: float) -> None:
        """Look whether mode and arming are what was asked for here."""
        mode, armed = self._reports.values["mode"], self._reports.values["armed"]
        wanted_mode, until = self._expected_mode
        changed = mode != before.get("mode", mode)
        values = self._reports.values
        up = min(-values.get("own_altitude", 0.0), values.get("depth", math.inf)) < UP
        surfaced = (mode, wanted_mode) == ("ALT_HOLD", "SURFACE") and up
        if changed and surfaced and (before["mode"] == "SURFACE" or now <= until):
            # ArduSub itself ends SURFACE at the surface, perhaps before it ever showed, and holds its depth.
            self._expected_mode = mode, now
        elif changed and mode == "SURFACE" and self._reports.values["failsafe"]:
            self._motion.stop()
            self._expected_mode = mode, now
            self.surfacing = f"a failsafe of the vehicle brings it up{self._reports.last_words(now)}"
        elif changed and not (mode == wanted_mode and now <= until):
            self._motion.stop()
            self.mode_changed_by_other = (
                f"mode {mode} instead of {before['mode']}, which nobody here asked for"
                f"{self._reports.last_words(now)}"
            )
            logger.warning("%s", self.mode_changed_by_other)
        if armed != before.get("armed", armed):
            wanted_armed, until = self._expected_armed
            if armed == wanted_armed and now <= until:
                self._ours = armed
            else:
                self._motion.stop()
                self._ours = False
                self.armed_by_other = (
                    f"{'armed' if armed else 'disarmed'}, which nobody here asked for"
                    f"{self._reports.last_words(now)}"
                )
                logger.warning("%s", self.armed_by_other)

    # Sending

    def _sending(self) -> None:
        while not self._closed:
            pause = PERIOD
            try:
                pause = self.beat()
            except Exception:
                logger.exception("a message to the vehicle was lost")
            self._wake.wait(pause)

    def _heartbeat(self, now: float) -> None:
        d = self._dialect
        if not self._armed_elsewhere:
            # Who drives it hangs on a heartbeat of their own, which ours would hide the loss of.
            kind, none = d.MAV_TYPE_GCS, d.MAV_AUTOPILOT_INVALID
            self._send(d.MAVLink_heartbeat_message(kind, none, 0, 0, d.MAV_STATE_ACTIVE, 3))
        if self.connected:
            self._send(d.MAVLink_timesync_message(0, self._reports.ask_time(now)))
            if self._ask_again:
                self._ask_again = False
                for name, rate in self._rates.items():
                    self._send(self._long("SET_MESSAGE_INTERVAL", self._message_id(name), round(1e6 / rate)))

    def _drive(self, now: float) -> None:
        """Send the order that holds, or neutral; or nothing where that is not ours to do."""
        mode = self._reports.values.get("mode", "")
        pressed = now - self._press[1]
        buttons = self._press[0] if pressed < PRESS else 0
        if not (self._piloting or pressed < 2.0 * PRESS) or self.rival:
            return
        if self.yielding and mode != "SURFACE":
            return  # SURFACE needs a pilot's neutral, or the vehicle would disarm on its way up
        guided = mode == "GUIDED"
        sticks, velocity = NEUTRAL, STILL if guided and self._ours else None
        if self._ours and self.connected and not (self._disarming or self.yielding):
            sticks, velocity = self._motion.due(now, guided=guided)
        if velocity is not None:
            vx, vy, vz, yaw_rate = forward_right_down(velocity)
            numbers = 0.0, 0.0, 0.0, vx, vy, vz, 0.0, 0.0, 0.0, 0.0, yaw_rate
            self._send(
                self._dialect.MAVLink_set_position_target_local_ned_message(
                    0, self.vehicle, 1, BODY_NED, VELOCITY_AND_YAW_RATE, *numbers
                )
            )
        self._send(
            self._dialect.MAVLink_manual_control_message(
                self.vehicle, sticks.x, sticks.y, sticks.z, sticks.r, buttons
            )
        )

    def _send(self, message: Any) -> None:
        with self._out:
            data = bytes(message.pack(self._writer))
            self._writer.seq = (self._writer.seq + 1) % 256
            self._own.append(data)
            try:
                if not self._pipe.send(data):
                    return
            except OSError as error:
                self._trouble(f"cannot send: {error}")
                return
        self._record(self._now(), True, message)

    def _record(self, now: float, sent: bool, message: Any) -> None:
        if self._tap is None:
            return
        try:
            self._tap(now, "mavlink", sent, message)
        except Exception:  # a full disk must not stop the motion messages
            logger.exception("a message was not logged")

    # Asking

    def _command(self, name: str, *numbers: float, last: float = 0.0, tries: int = 3) -> None:
        number = getattr(self._dialect, f"MAV_CMD_{name}")
        d = self._dialect

        def answer(message: Any) -> bool:
            return (
                message.get_type() == "COMMAND_ACK"
                and message.command == number
                and message.target_system in (0, self.system)
                and message.result not in (d.MAV_RESULT_IN_PROGRESS, d.MAV_RESULT_TEMPORARILY_REJECTED)
            )

        asked = self._now()
        reply = self._ask(lambda: self._long(name, *numbers, last=last), answer, name, tries)
        if reply.result != d.MAV_RESULT_ACCEPTED:
            result = d.enums["MAV_RESULT"].get(reply.result)
            word = result.name.removeprefix("MAV_RESULT_") if result else str(reply.result)
            # ArduSub says no first, and why a moment later.
            self._wait(lambda: bool(self._reports.words_since(asked)), REASON)
            raise Refused(f"{name}: expected ACCEPTED, got {word}{self._words(asked + 1.0)}")

    def _long(self, name: str, *numbers: float, last: float = 0.0) -> Any:
        number = getattr(self._dialect, f"MAV_CMD_{name}")
        seven = [*map(float, numbers), *[0.0] * (6 - len(numbers)), last]
        return self._dialect.MAVLink_command_long_message(self.vehicle, 1, number, 0, *seven)

    def _ask_param(self, name: str) -> float:
        answer = self._ask(
            lambda: self._dialect.MAVLink_param_request_read_message(self.vehicle, 1, name.encode(), -1),
            lambda m: m.get_type() in ("PARAM_VALUE", "PARAM_ERROR") and text_of(m.param_id) == name,
            f"parameter {name}",
        )
        if answer.get_type() == "PARAM_ERROR" or not math.isfinite(answer.param_value):
            raise TimeoutError(f"parameter {name}: expected a value, got an error from the vehicle")
        self._types[name] = answer.param_type
        return float(answer.param_value)

    def _ask(
        self, message: Callable[[], Any], answer: Callable[[Any], bool], what: str, tries: int = 3
    ) -> Any:
        answers: list[Any] = []
        entry = answer, answers
        with self._news:
            self._waiting.append(entry)
        try:
            for _ in range(tries):
                self.operator_alive()
                self._send(message())
                if self._wait(lambda: bool(answers), self._retry):
                    return answers[0]
        finally:
            with self._news:
                self._waiting.remove(entry)
        raise TimeoutError(
            f"{what}: expected an answer of the vehicle, got none in {tries} tries. "
            f"Its last heartbeat is {self.age:.1f} s old"
        )

    def _wait(self, true: Callable[[], bool], timeout: float) -> bool:
        end = self._threads.monotonic() + timeout
        with self._news:
            while not (true() or self._closed) and self._threads.monotonic() < end:
                self.operator_alive()
                self._news.wait(min(0.5, max(0.0, end - self._threads.monotonic())))
            return true()

    @property
    def _armed_elsewhere(self) -> bool:
        return bool(self._reports.values.get("armed")) and not self._ours

    def _free(self, what: str) -> None:
        busy = self.busy
        if busy:
            raise Refused(f"{what}: expected a vehicle that nobody else drives, got: {busy}")

    def _words(self, now: float) -> str:
        with self._news:
            return self._reports.last_words(now)

    def _lights_moved(self, old: float) -> bool:
        return abs(self.telemetry.lights - old) > 0.01

    def _light_buttons(self) -> dict[int, int]:
        found: dict[int, int] = {}
        for button in range(16):
            with contextlib.suppress(TimeoutError):
                found.setdefault(int(self.param(f"BTN{button}_FUNCTION")), button)
        if BRIGHTER not in found or DIMMER not in found:
            raise RuntimeError(
                f"lights: expected buttons with functions {BRIGHTER} and {DIMMER} (BTNn_FUNCTION), "
                f"got {sorted(found)}. Set them up in Cockpit or QGroundControl"
            )
        return found

    def _message_id(self, name: str) -> int:
        number = getattr(self._dialect, f"MAVLINK_MSG_ID_{name}", None)
        if number is None:
            raise ValueError(f"message: expected a name of MAVLink's, got {name!r}")
        return int(number)

    def _parser(self) -> Any:
        parser = self._dialect.MAVLink(None)
        parser.robust_parsing = True
        return parser

    def _trouble(self, problem: str) -> None:
        if problem != self.problem:
            logger.warning("%s", problem)
        self.problem = problem


def dialect() -> ModuleType:
    """The messages that ArduSub knows; a ValueError that says what to install."""
    try:
        return importlib.import_module("pymavlink.dialects.v20.ardupilotmega")
    except ImportError as error:
        raise ValueError(extras.missing("rov", "pymavlink", "vehicle")) from error
