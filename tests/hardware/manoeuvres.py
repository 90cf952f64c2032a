"""The same orders at the same times to any autopilot around our tank, and what came of them.

A `Trace` is small enough to be kept: `record` writes those of a real ArduSub, and
`tests/robots/bluerov2/standin/test_recorded.py` holds the stand-in's against them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import ardupilotmega as mav

from dream.geometry import SE2
from dream.robots.bluerov2.standin.ardusub import Send
from dream.robots.bluerov2.standin.dive import Autopilot
from dream.robots.bluerov2.standin.motors import NEUTRAL_PWM
from dream.robots.bluerov2.standin.tank import Conditions, Tank
from dream.robots.bluerov2.standin.wire import Address
from dream.sim.world import World
from tests.hardware.sitl import HOME, SETUPS

Float64Array = npt.NDArray[np.float64]
RECORDED = Path(__file__).parents[1] / "recorded" / "ardusub"
"""Traces of a real ArduSub 4.7-dev."""

Message = Any
Make = Callable[[Tank, Send], Autopilot]

FAR = (-36.8, 174.7)
"""Degrees of latitude and longitude of a place where the compass points 19.7° to the east of north."""
NORTH = SE2(0.0, -0.8, 0.5 * math.pi)
STABILIZE, ALT_HOLD, GUIDED, SURFACE, MANUAL = 0, 2, 4, 9, 19
EVERY = 10
"""Beats between two samples of the truth."""
COLUMNS = ("time", "north", "east", "up", "roll", "pitch", "yaw", "turn")
"""Of the truth: seconds, metres, and radians as ArduSub has them, forward-right-down."""
STREAMS: dict[str, tuple[str, ...]] = {
    "ATTITUDE": ("yaw", "yawspeed", "time_boot_ms"),
    "VFR_HUD": ("alt", "climb", "throttle"),
    "GLOBAL_POSITION_INT": ("alt", "relative_alt", "lat", "hdg"),
    "AHRS2": ("altitude", "yaw"),
    "NAV_CONTROLLER_OUTPUT": ("alt_error", "nav_bearing", "wp_dist"),
    "LOCAL_POSITION_NED": ("x", "y", "z"),
    "EKF_STATUS_REPORT": ("flags",),
}
"""Fields that are kept, by message; each with its time."""
RATES = {30: 10.0, 74: 4.0, 33: 4.0, 178: 4.0, 62: 4.0, 32: 4.0, 193: 1.0}
"""Hertz that are asked for, by message id."""


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """What was seen of one run."""

    truth: Float64Array
    """(n, 8), see COLUMNS."""
    pulses: npt.NDArray[np.int16]
    """(n, 8) microseconds."""
    told: dict[str, Float64Array]
    """(m, 1 + fields) time and fields by message, see STREAMS."""
    events: list[tuple[float, str]]
    """What was done and what was answered, with its time."""

    def save(self, path: Path) -> None:
        """Write it, to a tenth of a millimetre."""
        path.parent.mkdir(parents=True, exist_ok=True)
        told = {f"told/{name}": np.round(rows, 4) for name, rows in self.told.items() if len(rows)}
        np.savez_compressed(
            path,
            truth=np.round(self.truth, 4).astype(np.float32),
            pulses=self.pulses,
            events=np.array(json.dumps(self.events)),
            **told,  # type: ignore[arg-type]
        )

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read it."""
        with np.load(path) as file:
            told = {name[5:]: file[name] for name in file.files if name.startswith("told/")}
            events = [(float(at), str(text)) for at, text in json.loads(str(file["events"]))]
            return cls(file["truth"].astype(np.float64), file["pulses"], told, events)

    def __getitem__(self, column: str) -> Float64Array:
        """Of the truth."""
        return self.truth[:, COLUMNS.index(column)]

    def at(self, mark: str, nth: int = 0) -> float:
        """When something was done or said."""
        return [at for at, text in self.events if mark in text][nth]

    def during(self, start: float, end: float) -> Self:
        """What lies between two times, counted from the first."""
        inside = (self["time"] >= start - 1e-6) & (self["time"] <= end + 1e-6)
        truth = self.truth[inside].copy()
        truth[:, 0] -= start
        told = {}
        for name, rows in self.told.items():
            part = rows[(rows[:, 0] >= start - 1e-6) & (rows[:, 0] <= end + 1e-6)].copy()
            part[:, 0] -= start
            told[name] = part
        events = [(at - start, text) for at, text in self.events if start <= at <= end]
        return type(self)(truth, self.pulses[inside], told, events)

    def said(self, message: str, field: str) -> Float64Array:
        """(m,) values of a field."""
        rows = self.told.get(message, np.empty((0, 1 + len(STREAMS[message]))))
        return rows[:, 1 + STREAMS[message].index(field)]


class Station:
    """A ground station without a network, and a tank."""

    def __init__(
        self,
        world: World,
        make: Make,
        *,
        depth: float = 0.25,
        conditions: Conditions | None = None,
        home: tuple[float, float] = HOME,
    ) -> None:
        self.tank = Tank(world, start=NORTH, depth=depth, conditions=conditions)
        self.home = home
        """Degrees of latitude and longitude."""
        self.sticks: tuple[int, int, int, int] | None = (0, 0, 500, 0)
        """x, y, z and r, at 20 Hz; None for silence."""
        self.beats = True
        """Are heartbeats sent, at 2 Hz?"""
        self.repeat: Callable[[], Message] | None = None
        """Sent at 20 Hz."""
        self.last: dict[str, Message] = {}
        self._truth: list[list[float]] = []
        self._pulses: list[list[int]] = []
        self._told: dict[str, list[list[float]]] = {name: [] for name in STREAMS}
        self._events: list[tuple[float, str]] = []
        self._state: tuple[int, bool] | None = None
        self._parser = mav.MAVLink(None)
        self._parser.robust_parsing = True
        self._speaker = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        self.sub = make(self.tank, self._take)

    @property
    def trace(self) -> Trace:
        """Of all since it began."""
        return Trace(
            np.array(self._truth),
            np.array(self._pulses, np.int16),
            {name: np.array(rows) for name, rows in self._told.items() if rows},
            self._events,
        )

    def note(self, text: str) -> None:
        """Keep what happens now."""
        self._events.append((round(self.tank.time, 3), text))

    def say(self, message: Message) -> None:
        """As the ground station."""
        self.sub.hear(message.pack(self._speaker))

    def command(self, number: int, *values: float) -> None:
        """A COMMAND_LONG; its answer is one of the events."""
        padded = (*values, *([0.0] * (7 - len(values))))
        self.note(f"> command {number} {' '.join(f'{value:g}' for value in values)}")
        self.say(mav.MAVLink_command_long_message(1, 1, number, 0, *padded))

    def mode(self, number: int) -> None:
        """MAV_CMD_DO_SET_MODE."""
        self.command(mav.MAV_CMD_DO_SET_MODE, 1, number)

    def arm(self) -> None:
        """MAV_CMD_COMPONENT_ARM_DISARM."""
        self.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def disarm(self) -> None:
        """The same with 0."""
        self.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0)

    def change(self, name: str, value: float) -> None:
        """PARAM_SET."""
        self.note(f"> {name} {value:g}")
        self.say(mav.MAVLink_param_set_message(1, 1, name.encode(), value, 9))

    def depth_target(self, altitude: float) -> None:
        """SET_POSITION_TARGET_GLOBAL_INT in ALT_HOLD, once."""
        self.note(f"> depth target {altitude:.3f}")
        self.say(
            mav.MAVLink_set_position_target_global_int_message(
                0, 1, 1, 5, 0xDFB, 0, 0, altitude, 0, 0, 0, 0, 0, 0, 0, 0
            )
        )

    def velocity(self, forward: float, right: float, down: float, turn: float) -> None:
        """A setpoint of GUIDED in the body's frame, repeated."""
        self.note(f"> velocity {forward:g} {right:g} {down:g} {turn:g}")
        self.repeat = lambda: mav.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, 8, 0x5C7, 0, 0, 0, forward, right, down, 0, 0, 0, 0, turn
        )

    def push(self, x: int = 0, y: int = 0, z: int = 500, r: int = 0, *, seconds: float) -> None:
        """Hold the sticks so for a while, then let go."""
        self.note(f"> sticks {x} {y} {z} {r}")
        self.sticks = (x, y, z, r)
        self.run(seconds)
        self.note("> neutral")
        self.sticks = (0, 0, 500, 0)

    def boot(self, seconds: float = 25.0) -> None:
        """Until it can be armed, with all streams asked for."""
        self.run(1.0)
        for number, rate in RATES.items():
            self.say(mav.MAVLink_command_long_message(1, 1, 511, 0, number, 1e6 / rate, 0, 0, 0, 0, 0))
        self.run(seconds - 1.0)

    def dive(self, mode: int = ALT_HOLD, seconds: float = 3.0, *, boot: float = 25.0) -> None:
        """Boot, arm in a mode, and let it settle."""
        self.boot(boot)
        self.mode(mode)
        self.run(0.5)
        self.arm()
        self.run(seconds)

    def run(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds * 100)):
            beat = self.tank.beats
            if beat % 50 == 0 and self.beats:
                self.say(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            if beat % 5 == 0 and self.sticks is not None:
                x, y, z, r = self.sticks
                self.say(mav.MAVLink_manual_control_message(1, x, y, z, r, 0))
            if beat % 5 == 0 and self.repeat is not None:
                self.say(self.repeat())
            self.tank.advance(self.sub.commands)
            self.sub.beat()
            if self.tank.beats % EVERY == 0:
                self._sample()

    def _sample(self) -> None:
        state = self.tank.state
        rotation = state.T_world_base.rotation
        x, y, z = state.position.tolist()
        roll = math.atan2(rotation[2, 1], rotation[2, 2])
        pitch = math.asin(max(-1.0, min(1.0, rotation[2, 0])))
        yaw = math.atan2(rotation[0, 0], rotation[1, 0])
        self._truth.append([self.tank.time, y, x, z, roll, pitch, yaw, -float(state.angular_velocity[2])])
        self._pulses.append([round(NEUTRAL_PWM - 400.0 * u) for u in self.sub.commands])

    def _take(self, data: bytes, to: Address | None) -> None:
        now = self.tank.time
        for message in self._parser.parse_buffer(data) or []:
            kind = message.get_type()
            self.last[kind] = message
            if kind in STREAMS:
                self._told[kind].append([now, *(float(getattr(message, f)) for f in STREAMS[kind])])
            elif kind == "HEARTBEAT":
                state = (message.custom_mode, bool(message.base_mode & 128))
                if state != self._state:
                    self.note(f"mode {state[0]} {'armed' if state[1] else 'disarmed'}")
                self._state = state
            elif kind == "STATUSTEXT":
                self.note(f"text {message.severity} {message.text}")
            elif kind == "COMMAND_ACK":
                self.note(f"ack {message.command} {message.result}")


# ---------------------------------------------------------------------------------------- manoeuvres
def altitudes(it: Station) -> None:
    """What each message calls depth: at rest, armed, deeper."""
    it.boot()
    it.mode(ALT_HOLD)
    it.run(1.0)
    it.arm()
    it.run(15.0)
    it.push(z=250, seconds=3.0)
    it.run(6.0)
    it.disarm()
    it.run(1.0)


def depths(it: Station) -> None:
    """Steps of a depth target, then the throttle."""
    it.dive(seconds=5.0)
    for step in (-0.25, -0.25, 0.25):
        it.depth_target(it.last["GLOBAL_POSITION_INT"].relative_alt / 1e3 + step)
        it.run(8.0)
    for z in (650, 350, 900, 100):
        it.push(z=z, seconds=2.0)
        it.run(4.0)


def moves(it: Station) -> None:
    """Surge and sway, one way and back."""
    it.dive()
    for x, y in ((300, 0), (-300, 0), (0, 300), (0, -300), (80, 0)):
        it.push(x=x, y=y, seconds=2.0)
        it.run(3.0)


def turns(it: Station) -> None:
    """Yaw sticks of several sizes and lengths."""
    it.dive(seconds=5.0)
    for r, seconds in (
        (300, 2.0),
        (-300, 2.0),
        (150, 2.0),
        (100, 2.0),
        (300, 0.5),
        (-600, 1.0),
        (60, 4.0),
        (1000, 0.3),
    ):
        it.push(r=r, seconds=seconds)
        it.run(5.0)


def rest(it: Station) -> None:
    """A minute with the sticks let go of."""
    it.dive(seconds=60.0)


def surfacing(it: Station) -> None:
    """SURFACE from a metre, and again where it then is."""
    it.dive()
    it.depth_target(-1.0)
    it.run(8.0)
    it.mode(SURFACE)
    it.run(20.0)
    it.mode(SURFACE)
    it.run(5.0)
    it.depth_target(-0.25)
    it.run(6.0)
    it.mode(SURFACE)
    it.run(8.0)
    it.disarm()
    it.run(2.0)


def launch(it: Station) -> None:
    """Armed at 0.25 m with sticks let go of; told to hold 0.05 m; SURFACE there."""
    it.dive(seconds=5.0)
    it.depth_target(-0.05)
    it.run(10.0)
    it.mode(SURFACE)
    it.run(2.0)


def guided(it: Station) -> None:
    """GUIDED: velocities, a turn, a stop, silence."""
    it.dive(boot=45.0)
    it.depth_target(-0.25)
    it.run(6.0)
    it.mode(GUIDED)
    it.run(2.0)
    for order in ((0.15, 0, 0, 0), (0, 0.15, 0, 0), (0, 0, 0.1, 0), (0, 0, 0, 0.4)):
        it.velocity(*order)
        it.run(4.0)
        it.velocity(0, 0, 0, 0)
        it.run(4.0)
    it.velocity(0.1, 0, 0, 0.3)
    it.run(2.0)
    it.repeat = None
    it.note("> silence")
    it.run(6.0)
    it.velocity(0, 0, 0, 0)
    it.run(4.0)


def refusals(it: Station) -> None:
    """What is denied, how, and in which order that is said."""
    it.boot()
    for mode in (GUIDED, 16, 77):
        it.mode(mode)
        it.run(1.0)
    it.command(mav.MAV_CMD_DO_SET_MODE, 0, MANUAL)
    it.run(1.0)
    for number in (251, 30, 33, 178, 62, 9999):
        it.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e5)
        it.run(1.0)
    for number in (251, 148, 33):
        it.command(mav.MAV_CMD_REQUEST_MESSAGE, number)
        it.run(1.0)
    it.command(31999)
    it.run(1.0)
    it.change("BATT_ARM_VOLT", 17.0)
    it.run(1.0)
    it.arm()
    it.run(1.0)
    it.change("BATT_ARM_VOLT", 0.0)
    it.run(4.0)
    it.arm()
    it.run(1.0)
    it.arm()
    it.run(1.0)
    it.disarm()
    it.run(1.0)
    it.disarm()
    it.run(1.0)


def losses(it: Station) -> None:
    """The pilot lost; then all silent; then the station alone."""
    it.dive()
    it.change("FS_PILOT_TIMEOUT", 1.0)
    it.run(0.5)
    it.push(x=200, seconds=1.0)
    it.sticks = None
    it.note("> no sticks")
    it.run(4.0)
    it.sticks = (0, 0, 500, 0)
    it.run(2.0)
    it.arm()
    it.run(3.0)
    it.sticks, it.beats = None, False
    it.note("> silent")
    it.run(8.0)
    it.sticks, it.beats = (0, 0, 500, 0), True
    it.run(2.0)
    it.change("FS_PILOT_INPUT", 0.0)
    it.run(0.5)
    it.arm()
    it.run(3.0)
    it.sticks, it.beats = None, False
    it.note("> silent without FS_PILOT_INPUT")
    it.run(8.0)


def origins(it: Station) -> None:
    """An origin that comes under way."""
    it.dive(seconds=8.0)
    it.note("> origin")
    lat, lon = it.home
    it.say(mav.MAVLink_set_gps_global_origin_message(1, round(lat * 1e7), round(lon * 1e7), 12_000))
    it.run(15.0)


@dataclass(frozen=True, slots=True)
class Run:
    """A manoeuvre, and with what it is flown."""

    setup: str
    """Of `sitl.SETUPS`."""
    manoeuvre: Callable[[Station], None]
    depth: float = 0.6
    """Metres at which it lies when it boots."""
    home: tuple[float, float] = HOME
    """Degrees of latitude and longitude."""

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{'far-' if self.home == FAR else ''}{self.setup}-{self.manoeuvre.__name__}"

    @property
    def path(self) -> Path:
        """Where the trace of the real one is."""
        return RECORDED / f"{self.name}.npz"

    def fly(self, world: World, make: Make, conditions: Conditions | None = None) -> Trace:
        """With this autopilot."""
        station = Station(world, make, depth=self.depth, conditions=conditions, home=self.home)
        try:
            self.manoeuvre(station)
        finally:
            station.sub.close()
        return station.trace


RUNS = {
    run.name: run
    for run in (
        *(Run(setup, altitudes, 0.25) for setup in SETUPS),
        Run("origin", altitudes, 0.25, FAR),
        Run("stock", origins, home=FAR),
        *(Run("stock", one) for one in (depths, moves, turns, rest, losses)),
        *(Run("stock", one, 0.25) for one in (surfacing, launch, refusals)),
        Run("gps", guided),
    )
}
"""By name."""
