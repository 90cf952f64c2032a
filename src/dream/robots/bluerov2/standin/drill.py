"""Faults, one at a time, while the vehicle is on its way: when they are found, what is done, how it ends.

All of it is on the clock of a `Rig`, so that a fault takes the same course every time and no computer is too
slow for it. `FAULTS` is the list; `killed` needs programs, and real time.
"""

from __future__ import annotations

import contextlib
import math
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mav

from dream.control.health import Watch
from dream.errors import MissionAborted
from dream.geometry import SE2
from dream.measurements import Dvl, Imu
from dream.perception import FlatFloor, Perception, Shells
from dream.robots.bluerov2.bridge import LEASE, Stance
from dream.robots.bluerov2.devices import LiveEye
from dream.robots.bluerov2.limits import Limits
from dream.robots.bluerov2.log import NAME, read_log
from dream.robots.bluerov2.rov import BlueRov2
from dream.robots.bluerov2.sight import Sight
from dream.robots.bluerov2.standin.a50 import DvlFaults
from dream.robots.bluerov2.standin.ardusub import ArduSub
from dream.robots.bluerov2.standin.dive import StandIn
from dream.robots.bluerov2.standin.helm import SURFACE
from dream.robots.bluerov2.standin.motors import HALF_PWM, NEUTRAL_PWM, Channels
from dream.robots.bluerov2.standin.parameters import NEXT
from dream.robots.bluerov2.standin.rig import Rig, UInt8Array
from dream.robots.bluerov2.standin.wire import Change, LinkFaults
from dream.robots.bluerov2.sticks import NEUTRAL
from dream.robots.bluerov2.watches import HARD
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import Setpoint

UNDER_WAY = 1.0
"""Seconds that it has been moving when the fault comes."""
HEALING = 6.0
"""Seconds that it may take to go on after a fault was put right."""
GOING = 0.3
"""Seconds of going on after which it counts as healed."""
COMING_UP = 150.0
"""Seconds that the way home may take."""
TICK = 0.05
"""Seconds between two looks, and between two signs of life."""
NEAR_END, FAR_END = 0.1, 0.9
"""Metres from the start, towards the middle of the tank, between which it swims to and fro."""
LIMIT = 0.5
"""Seconds from a loss to the last packet that can move the vehicle."""
PRESSED = 3.0
"""Seconds for which it may work hard and stand."""
TOUCHING = 3.0
"""Seconds within which touches are one contact: so long it may press."""
STANDS = 0.02
"""m/s below which a vehicle stands."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that goes wrong."""

    name: str
    begin: Callable[[Drill], object]
    lasts: float = 3.0
    """Seconds that are watched at least; one that ends the dive is watched until the vehicle is home."""
    heals: Callable[[Drill], object] | None = None
    """Puts it right, after which the vehicle has `HEALING` seconds to go on."""
    loss: Callable[[Drill, float], float] = lambda drill, began: math.nan
    """When, on the dive's clock, that was lost without which nothing may move: drill and beginning of the
    fault → seconds; NaN where nothing such is."""
    camera: bool = False
    """Needs pictures, and a mission that looks at them."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a fault. Times are seconds from its beginning."""

    fault: str
    detected: float
    """Until the bridge did something else than go on; inf where it never did."""
    did: str
    """What it did then."""
    reason: str
    lost: float
    """When that was lost without which nothing may move; NaN where nothing such was."""
    last_motion: float
    """When the last packet was sent that can move the vehicle, but for those of the way up; −inf for none."""
    slid: float
    """Metres that the vehicle really moved while it was watched, horizontally."""
    off: float
    """Metres between estimate and truth in the end, horizontally; NaN where nobody is left who estimates."""
    healed: bool
    """It goes on, or still goes on, in the end."""
    contacts: int
    """How often it ran into something since; within `TOUCHING` of the last time it is the same contact."""
    pressed: float
    """Longest seconds for which it really worked hard, and stood."""
    armed: bool
    """It is armed in the end."""
    depth: float
    """Metres, in the end."""
    ended: float
    """When it was disarmed, or watched no more."""
    told: str
    """What the operator was told last."""
    log_lost: int
    """Messages that are missing from the log."""
    kept: str
    """What is on disk."""

    @property
    def broken(self) -> list[str]:
        """Which of what has to hold after any fault does not, in words."""
        found = []
        if self.log_lost:
            found.append(f"{self.log_lost} messages of the log are lost")
        if self.after_loss > LIMIT:
            found.append(f"moved {self.after_loss:.2f} s after the loss")
        if self.pressed > PRESSED:
            found.append(f"pressed for {self.pressed:.1f} s")
        if self.armed and not self.healed:
            found.append(f"armed at {self.depth:.1f} m")
        if self.contacts > 1:
            found.append(f"{self.contacts} contacts")
        return found

    @property
    def after_loss(self) -> float:
        """Seconds from the loss to the last packet that can move the vehicle; NaN without a loss."""
        return max(self.last_motion - self.lost, 0.0) if math.isfinite(self.lost) else math.nan


class Drill:
    """A vehicle in its tank, on its way, with all that a dive has but a planner."""

    def __init__(
        self,
        folder: Path,
        *,
        world: World | None = None,
        seed: int = 1,
        camera: bool = False,
        guided: bool = False,
    ) -> None:
        """Bring it under way.

        Args:
            folder: For the log.
            world: Where; the paper's tank unless given.
            seed: Of the stand-in.
            camera: Take pictures, and let the mission look and move in turn, as a survey does.
            guided: Drive by velocities.
        """
        world = world or make_world("pool/arc", 1)
        self.alive = self.attended = True
        """Do mission and operator live?"""
        self.mission_seen = self.operator_seen = math.inf
        """When they last showed it."""
        self.pictures = 0
        """That the mission looked at."""
        self.aborted = ""
        self.heard: list[tuple[float, Any]] = []
        """Measurements, and when they came in."""
        self.moves: list[float] = []
        """When something was sent that can move the vehicle: sticks, a velocity, a depth to go to."""
        self.pressed = self._pressing = 0.0
        self.contacts, self._touches, self._touched = 0, 0, -math.inf
        self._ending = False
        self._stack = contextlib.ExitStack()
        self.rig = rig = self._stack.enter_context(
            Rig(
                folder,
                world,
                seed=seed,
                guided=guided,
                pictures=5.0 if camera else 0.0,
                limits=Limits(area=world.bounds),
            )
        )
        self.standin, self.clock, self.now = rig.standin, rig.clock, rig.now
        self.watch = Watch()
        log, deliver = rig.devices.log, rig.navigator.deliver
        tap = log.tap

        def listening(at: float, channel: str, sent: bool, payload: Any) -> None:
            tap(at, channel, sent, payload)
            if sent and channel == "mavlink" and self._moving(payload):
                self.moves.append(at)

        def hearing(message: Any) -> None:
            self.heard.append((self.now(), message))
            deliver(message)

        log.tap = listening  # type: ignore[method-assign, assignment]
        rig.navigator.deliver = hearing  # type: ignore[method-assign]
        rig.ready()
        sight = Sight(rig.devices.camera)
        if camera:
            rig.sight = sight
        rig.clock.start(self._operate, "operator")
        rig.clock.start(self._look, "looks")
        self.bridge = rig.begin()
        self.robot = BlueRov2(
            self.bridge,
            rig.navigator,
            LiveEye(rig.devices.camera),
            Perception(Shells(), FlatFloor()),
            rig.protocol,
            self.now,
            frozen=lambda: sight.frozen,
            holds=self._hangs,
            threads=rig.clock,
        )
        self._mission = rig.clock.start(lambda: self._fly(camera=camera), "mission")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending = True
        self.bridge.end("the drill is over")
        self._stack.close()

    def suffer(self, fault: Fault, after: float = UNDER_WAY) -> Outcome:
        """Let it happen to a vehicle that has been on its way for so many seconds."""
        rig, clock = self.rig, self.clock
        self._until(lambda: self._sets_out(camera=fault.camera), 60.0)
        clock.sleep(after)
        here = self.standin.T_world_base.translation.copy()
        began, self.pressed, self.contacts = self.now(), 0.0, 0
        fault.begin(self)
        clock.sleep(fault.lasts)
        ended = self.now()
        lost = fault.loss(self, began)
        slid = math.dist(self.standin.T_world_base.translation[:2], here[:2])
        healed = True
        if fault.heals is not None:
            fault.heals(self)
        if (fault.heals is None and self.bridge.over) or not self._goes_on():
            # Home, whoever brings it there: the mission that is aborted, or the bridge where it hangs.
            self._until(lambda: not self.armed, COMING_UP)
            healed, ended = False, self.now()
        pose = self.standin.T_world_base
        found = [(at, said) for at, said in rig.said if at > began and said.reason]
        # A loss may be told in two stages, slower first.
        lost_at = [entry for entry in found if entry[1].stance is not Stance.SLOW]
        detected, standing = (lost_at or found or [(math.inf, self.bridge.standing)])[0]
        # What moves it once it goes on again is none that it should not.
        going = (Stance.GO, Stance.SLOW)
        gone_on = [at for at, said in rig.said if at > detected and said.stance in going]
        again = min([began + fault.lasts, *gone_on])
        home = rig.home.how is not None or self.mode == SURFACE
        kept = f"{rig.devices.log.written} messages"
        return Outcome(
            fault=fault.name,
            detected=detected - began,
            did=f"{standing.stance}" + (", then the way home" if home else ""),
            reason=standing.reason,
            lost=lost - began,
            last_motion=max((at - began for at in self.moves if at < again), default=-math.inf),
            slid=slid,
            off=math.dist(self.bridge.fix.T_world_base.translation[:2], pose.translation[:2]),
            healed=healed and self.bridge.standing.stance in (Stance.GO, Stance.SLOW) and self.armed,
            contacts=self.contacts,
            pressed=self.pressed,
            armed=self.armed,
            depth=-float(pose.translation[2]),
            ended=ended - began,
            told=rig.told[-1][1] if rig.told else "",
            log_lost=sum(rig.devices.log.lost.values()),
            kept=f"{kept}, {self.pictures} pictures" if fault.camera else kept,
        )

    @property
    def armed(self) -> bool:
        """Do its motors run, in truth?"""
        return self.standin.ardusub.armed

    @property
    def mode(self) -> int:
        """Its mode, in truth."""
        return self.standin.ardusub.mode

    def inertia_lost(self, since: float) -> float:
        """When, after a time, the newest inertial sample got older than is borne; NaN where it never did."""
        samples = [(at, message.time) for at, message in self.heard if isinstance(message, Imu)]
        return _outlived(samples, since, self.now(), self.watch.stale)

    def bottom_lost(self, since: float) -> float:
        """When, after a time, the newest velocity with bottom lock got older than is borne; NaN likewise."""
        locks = [
            (at, message.time) for at, message in self.heard if isinstance(message, Dvl) and message.valid
        ]
        return _outlived(locks, since, self.now(), self.watch.lost)

    def _sets_out(self, *, camera: bool) -> bool:
        looked = self.pictures >= 2 if camera else True
        v = self.standin.tank.state.velocity_world
        return looked and float(np.hypot(v[0], v[1])) > 0.05 and self.bridge.standing.stance is Stance.GO

    def _until(self, true: Callable[[], bool], seconds: float) -> None:
        end = self.now() + seconds
        while not true() and self.now() < end:
            self.clock.sleep(TICK)

    def _goes_on(self) -> bool:
        """Does it go on for a while, before its time for that is over?"""
        since, end = math.inf, self.now() + HEALING
        while (now := self.now()) < end and not self.bridge.over:
            going = self.bridge.standing.stance in (Stance.GO, Stance.SLOW) and not self.aborted
            since = min(since, now) if going else math.inf
            if now - since > GOING:
                return True
            self.clock.sleep(TICK)
        return False

    def _fly(self, *, camera: bool) -> None:
        """A mission that swims to and fro, and looks in between, until it is aborted; then home."""
        start, far = self.rig.start, False
        length = math.hypot(start.x, start.y)
        try:
            while not self._ending:
                far = not far
                share = 1.0 - (FAR_END if far else NEAR_END) / length
                goal = SE2(share * start.x, share * start.y, start.yaw)
                self.robot.go_to(Setpoint(goal.x, goal.y, goal.yaw, self.rig.protocol.altitude))
                if camera:
                    self.robot.observe()
                    self.pictures += 1
        except MissionAborted as error:
            self.aborted = str(error)
        finally:
            self.bridge.close()
            self.rig.home.finish(self.rig.tell)

    def _operate(self) -> None:
        """An operator's terminal."""
        while not self._ending:
            if self.attended:
                self.bridge.renew_operator(LEASE) if hasattr(self, "bridge") else None
                self.operator_seen = self.now()
            self.clock.sleep(TICK)

    def _moving(self, packet: Any) -> bool:
        """Can it move a vehicle, other than up? Straight up is the way home."""
        match packet.get_type():
            case "MANUAL_CONTROL":
                level = (packet.x, packet.y, packet.r) == (NEUTRAL.x, NEUTRAL.y, NEUTRAL.r)
                return not (level and packet.z >= NEUTRAL.z)
            case "SET_POSITION_TARGET_LOCAL_NED":
                return (packet.vx, packet.vy, packet.vz, packet.yaw_rate) != (0.0, 0.0, 0.0, 0.0)
            case "SET_POSITION_TARGET_GLOBAL_INT":
                return True
        return False

    def _hangs(self) -> bool:
        """What the mission asks again and again: it goes on, unless it hangs."""
        while not self.alive:
            self.clock.sleep(TICK)
        self.mission_seen = self.now()
        return False

    def _look(self) -> None:
        """How long it works hard and stands."""
        while not self._ending:
            sub = self.standin.autopilot
            gain = sub.helm.gain if isinstance(sub, ArduSub) else 1.0
            pulses = sub.pulses if isinstance(sub, ArduSub) and sub.armed else []
            hard = max((abs(p - NEUTRAL_PWM) / HALF_PWM for p in pulses[:4]), default=0.0) > HARD * gain
            v = self.standin.tank.state.velocity_world
            stands = float(np.linalg.norm(v)) < STANDS
            self._pressing = self._pressing + TICK if hard and stands else 0.0
            self.pressed = max(self.pressed, self._pressing)
            if (touches := self.standin.tank.collisions) > self._touches:
                self.contacts += self.now() - self._touched > TOUCHING
                self._touches, self._touched = touches, self.now()
            self.clock.sleep(TICK)


def _outlived(samples: list[tuple[float, float]], since: float, until: float, limit: float) -> float:
    """When the newest of (came in, was true) got older than a limit, between two times; NaN for never."""
    newest = -math.inf
    for came, true in [*samples, (until, math.inf)]:
        if max(newest + limit, since) < came and came > since:
            return max(newest + limit, since)
        newest = max(newest, true)
    return math.nan


# What is done to it


def _do(what: Callable[[StandIn], object]) -> Callable[[Drill], object]:
    """Do something to the stand-in."""
    return lambda drill: what(drill.standin)


def _link(faults: LinkFaults) -> Callable[[Drill], object]:
    """Let something befall the datagrams, both ways."""
    return lambda drill: setattr(drill.standin.wire, "faults", faults)


def _dvl(**faults: Any) -> Callable[[Drill], object]:
    """Let the DVL err."""
    return lambda drill: setattr(drill.standin.a50, "faults", DvlFaults(**faults))


def _tank(**faults: Any) -> Callable[[Drill], object]:
    """Let something happen in the water."""

    def begin(drill: Drill) -> None:
        for name, value in faults.items():
            setattr(drill.standin.tank, name, value)

    return begin


def _all(*begins: Callable[[Drill], object]) -> Callable[[Drill], object]:
    """Several at once."""

    def begin(drill: Drill) -> None:
        for one in begins:
            one(drill)

    return begin


def _nothing(drill: Drill) -> None:
    """It passes by itself."""


def _altered(change: Callable[[Any], Any]) -> Change:
    """Messages of MAVLink changed on their way; None where one is lost."""
    reader, writer = mav.MAVLink(None), mav.MAVLink(None)
    reader.robust_parsing = True

    def alter(data: bytes) -> bytes | None:
        out = b""
        for message in reader.parse_buffer(data) or ():
            changed = None if message.get_type() == "BAD_DATA" else change(message)
            if changed is not None:
                writer.srcSystem, writer.srcComponent = message.get_srcSystem(), message.get_srcComponent()
                writer.seq = message.get_seq()
                out += bytes(changed.pack(writer))
        return out or None

    return alter


def _up(kind: str, change: Callable[[Any], Any] = lambda message: None) -> Callable[[Drill], object]:
    """Change messages of a kind on their way from the vehicle; they are lost unless said."""
    one = _altered(lambda message: change(message) if message.get_type() == kind else message)
    return lambda drill: setattr(drill.rig.cable, "up", one)


def _down(kind: str, change: Callable[[Any], Any] = lambda message: None) -> Callable[[Drill], object]:
    """Change messages of a kind on their way to the vehicle; they are lost unless said."""
    one = _altered(lambda message: change(message) if message.get_type() == kind else message)
    return lambda drill: setattr(drill.rig.cable, "down", one)


def _whole(drill: Drill) -> None:
    """The cable carries what it is given again."""
    drill.rig.cable.up = drill.rig.cable.down = lambda data: data


def _set(field: str, value: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A message with another value in a field."""

    def change(message: Any) -> Any:
        setattr(message, field, value(getattr(message, field)))
        return message

    return change


def _passing(begin: Callable[[Drill], object], seconds: float) -> Callable[[Drill], object]:
    """On the cable, for so long."""

    def both(drill: Drill) -> None:
        begin(drill)
        drill.rig.after(seconds, lambda: _whole(drill))

    return both


def _frozen(drill: Drill) -> Callable[[UInt8Array], UInt8Array]:
    """The picture of now, for ever."""
    kept: list[UInt8Array] = []

    def look(picture: UInt8Array) -> UInt8Array:
        kept.append(picture)
        return kept[0].copy()

    return look


def _see(what: Callable[[Drill], Callable[[UInt8Array], UInt8Array | None]]) -> Callable[[Drill], object]:
    """Change the pictures on their way."""
    return lambda drill: setattr(drill.rig, "look", what(drill))


def _with_a_clock(drill: Drill) -> Callable[[UInt8Array], UInt8Array]:
    """A frozen picture in which one small patch goes on changing."""
    frozen, rng = _frozen(drill), np.random.default_rng(1)

    def look(picture: UInt8Array) -> UInt8Array:
        shown = frozen(picture)
        height, width = shown.shape[:2]
        patch = shown[: height // 8, : width // 4]
        patch[:] = rng.integers(0, 256, patch.shape, np.uint8)
        return shown

    return look


def _flickering(drill: Drill) -> Callable[[UInt8Array], UInt8Array]:
    """A frozen picture with the noise of a sensor over it."""
    frozen, rng = _frozen(drill), np.random.default_rng(1)

    def look(picture: UInt8Array) -> UInt8Array:
        shown = frozen(picture)
        noise = rng.normal(0.0, 2.0, shown.shape)
        return np.clip(shown + noise, 0, 255).astype(np.uint8)

    return look


def _refuses(drill: Drill, *modes: int) -> None:
    """The vehicle takes some modes no more."""
    sub = drill.standin.ardusub
    takes = sub.set_mode
    sub.set_mode = lambda mode: mode not in modes and takes(mode)  # type: ignore[method-assign]


def _keeps_armed(drill: Drill, seconds: float) -> None:
    """It cannot be disarmed for so long."""
    sub = drill.standin.ardusub
    disarm, until = sub.disarm, drill.now() + seconds
    sub.disarm = lambda: disarm() if drill.now() > until else None  # type: ignore[method-assign]


def _rival(drill: Drill) -> None:
    """Another station with our id speaks to the vehicle, whose router passes that on to us."""
    other = mav.MAVLink(None, srcSystem=255, srcComponent=190)
    packet = other.manual_control_encode(1, 400, 0, 500, 0, 0).pack(other)
    for _ in range(5):
        drill.standin.wire.send(packet, None, drill.standin.tank.time)


def _stranger(drill: Drill) -> None:
    """Another vehicle reports to our port for two seconds: disarmed, and leaning over."""
    other = mav.MAVLink(None, srcSystem=7, srcComponent=1)

    def report() -> None:
        for _ in range(100):
            beat = other.heartbeat_encode(mav.MAV_TYPE_SUBMARINE, 3, 0, 19, 3)
            stamp = round(1e6 * drill.now())
            sample = other.raw_imu_encode(stamp, 0, 900, 400, 2000, 2000, 0, 0, 0, 0)
            for packet in (beat, sample):
                drill.standin.wire.send(packet.pack(other), None, drill.standin.tank.time)
            drill.clock.sleep(0.02)

    drill.clock.start(report, "stranger")


def _slower(drill: Drill) -> None:
    """The delay grows by 0.05 s a second, both ways, for five seconds."""

    def grow() -> None:
        for k in range(50):
            _link(LinkFaults(delay=0.005 * k))(drill)
            drill.clock.sleep(0.1)

    drill.clock.start(grow, "slower")


def _hang(drill: Drill, seconds: float) -> None:
    """Whoever asks for the estimate waits so long."""
    navigator = drill.rig.navigator
    update, until = navigator.update, drill.now() + seconds

    def late() -> Any:
        drill.clock.sleep(max(until - drill.now(), 0.0))
        navigator.update = update  # type: ignore[method-assign]
        return update()

    navigator.update = late  # type: ignore[method-assign]


def _unheard(standin: StandIn) -> None:
    """The vehicle takes another system id for its ground station's."""
    parameters = standin.ardusub.parameters
    parameters.change(parameters.firmware.gcs_parameter, 252)


def _own_failsafe(standin: StandIn) -> None:
    """Water comes in, and the vehicle surfaces by itself."""
    standin.ardusub.parameters.change("FS_LEAK_ENABLE", 2.0)
    standin.tank.leak = True


def _broken(index: int, share: float) -> Callable[[Drill], object]:
    """One thruster follows its commands no more."""

    def begin(drill: Drill) -> None:
        drill.standin.tank.thrust[index] = share

    return begin


_GONE: Callable[[Drill], object] = lambda drill: setattr(drill, "attended", False)  # noqa: E731
_LEAK = _tank(leak=True)
_LINKED, _SEEN = _link(LinkFaults()), _dvl()
_ESTIMATE_GONE = 1000.0
"""Seconds: for good."""


def _since(drill: Drill, began: float) -> float:
    return began


HEALING_FAULTS = (
    Fault(
        "the mission hangs",
        lambda d: setattr(d, "alive", False),
        heals=lambda d: setattr(d, "alive", True),
        lasts=1.0,
        loss=lambda d, _: d.mission_seen,
    ),
    Fault(
        "the operator's terminal is gone",
        _GONE,
        heals=lambda d: setattr(d, "attended", True),
        lasts=1.0,
        loss=lambda d, _: d.operator_seen,
    ),
    Fault("the estimate hangs for 1 s", lambda d: _hang(d, 1.0), heals=_nothing, lasts=1.0, loss=_since),
    Fault("a third of the packets is lost, both ways", _link(LinkFaults(loss=0.33)), heals=_LINKED),
    Fault("packets come up to 0.15 s late, out of order", _link(LinkFaults(jitter=0.15)), heals=_LINKED),
    Fault(
        "packets come 0.3 s late",
        _link(LinkFaults(delay=0.3, jitter=0.1)),
        heals=_LINKED,
        lasts=1.3,
        loss=lambda d, began: d.inertia_lost(began),
    ),
    Fault(
        "the link is dead for 0.7 s",
        _link(LinkFaults(loss=1.0)),
        heals=_LINKED,
        lasts=0.7,
        loss=lambda d, began: d.inertia_lost(began),
    ),
    Fault("another vehicle reports to our port", _stranger, heals=_nothing, lasts=2.0),
    Fault(
        "the autopilot's clock jumps by 100 s",
        _do(lambda s: s.ardusub.jump_clock(100.0)),
        heals=_nothing,
        lasts=1.0,
    ),
    Fault(
        "the autopilot's clock slips by 0.3 s",
        _do(lambda s: s.ardusub.jump_clock(-0.3)),
        heals=_nothing,
        lasts=2.0,
        loss=lambda d, began: d.inertia_lost(began),
    ),
    Fault("the DVL's clock jumps back by 30 s", _do(lambda s: s.a50.jump_clock(-30.0)), heals=_nothing),
    Fault("the DVL talks nonsense", _dvl(garbage="all"), heals=_SEEN),
    Fault(
        "the DVL is silent for 6 s",
        _dvl(silent=True),
        heals=_SEEN,
        lasts=6.0,
        loss=lambda d, began: d.bottom_lost(began),
    ),
    Fault(
        "the DVL loses the bottom for 6 s",
        _dvl(lost=True),
        heals=_SEEN,
        lasts=6.0,
        loss=lambda d, began: d.bottom_lost(began),
    ),
    Fault("the DVL's reports come 0.5 s late", _dvl(latency=0.5), heals=_SEEN),
    Fault(
        "the tether pulls with 15 N for 1 s",
        _do(lambda s: s.tank.pull((15.0, 0.0, 0.0), 1.0)),
        heals=_nothing,
    ),
    Fault("the heading jumps by 20°", _up("ATTITUDE", _set("yaw", lambda yaw: yaw + 0.35)), heals=_nothing),
    Fault("a thruster is dead", _broken(0, 0.0), heals=_nothing, lasts=5.0),
    Fault("another station has our id", _rival, lasts=0.6, heals=lambda d: d.rig.link.resume()),
)
"""From which the vehicle goes on, one after the other if need be."""

FAULTS = (
    *HEALING_FAULTS,
    Fault("the delay grows by 0.05 s a second", _slower, lasts=5.0, loss=lambda d, b: d.inertia_lost(b)),
    Fault("the link stays dead", _link(LinkFaults(loss=1.0)), loss=lambda d, b: d.inertia_lost(b)),
    Fault("the estimate hangs for good", lambda d: _hang(d, _ESTIMATE_GONE), lasts=10.0, loss=_since),
    Fault(
        "the autopilot begins anew",
        _do(lambda s: s.ardusub.reboot(1.0)),
        lasts=5.0,
        loss=lambda d, b: d.inertia_lost(b),
    ),
    Fault("the DVL stays silent", _dvl(silent=True), lasts=20.0, loss=lambda d, b: d.bottom_lost(b)),
    Fault("the DVL is about to shut down, too hot", _dvl(hot=True)),
    Fault("the battery falls to 13.5 V", _do(lambda s: s.tank.drain(13.5)), lasts=8.0),
    Fault("water comes in", _LEAK),
    Fault("somebody changes the mode", _do(lambda s: s.ardusub.set_mode(19))),
    Fault("somebody disarms it", _do(lambda s: s.ardusub.disarm())),
    Fault("the vehicle listens to another station", _do(_unheard)),
    Fault("the camera is silent", _see(lambda d: lambda picture: None), lasts=10.0, camera=True),
    Fault("the camera is frozen", _see(_frozen), lasts=10.0, camera=True),
    Fault("the camera is frozen but for a clock in its corner", _see(_with_a_clock), lasts=10.0, camera=True),
    Fault("the camera is frozen, with noise over it", _see(_flickering), lasts=10.0, camera=True),
    Fault("the camera is black", _see(lambda d: lambda p: np.zeros_like(p)), lasts=10.0, camera=True),
    Fault("the terminal is frozen for good", _GONE, lasts=8.0, loss=lambda d, _: d.operator_seen),
    Fault(
        "the mission hangs for good, as on a disk that does not answer",
        lambda d: setattr(d, "alive", False),
        lasts=8.0,
        loss=lambda d, _: d.mission_seen,
    ),
    Fault("water comes in, and commands are lost for 4 s", _all(_passing(_down("COMMAND_LONG"), 4.0), _LEAK)),
    Fault("water comes in, and no command is answered", _all(_down("COMMAND_LONG"), _LEAK)),
    Fault("water comes in, and SURFACE is refused", _all(lambda d: _refuses(d, SURFACE), _LEAK)),
    Fault(
        "water comes in, and no mode is taken but MANUAL",
        _all(lambda d: _refuses(d, SURFACE, 0, 2, 4), _LEAK),
    ),
    Fault("water comes in, and it cannot be disarmed for 40 s", _all(lambda d: _keeps_armed(d, 40.0), _LEAK)),
    Fault("water comes in, and the vehicle surfaces by itself", _do(_own_failsafe)),
    Fault("the DVL's altitude is stuck at 5 m", _dvl(altitude_stuck=5.0), lasts=8.0),
    Fault("the DVL's altitude is stuck at 0.1 m", _dvl(altitude_stuck=0.1), lasts=8.0),
    Fault("the DVL's altitude is doubled", _dvl(altitude_factor=2.0), lasts=8.0),
    Fault("a third of the DVL's altitudes is ten-fold", _dvl(outliers=0.3), lasts=8.0),
    Fault("a second bottom comes and goes", _dvl(false_bottom=0.3, false_share=0.5), lasts=8.0),
    Fault("the DVL's velocity is frozen", _dvl(velocity_frozen=True), lasts=15.0),
    Fault("the bottom moves at 0.1 m/s", _dvl(bottom_moves=(0.1, 0.0, 0.0)), lasts=25.0),
    Fault("the pressure gauge drifts by 5 cm/s", _tank(gauge_drift=0.05), lasts=12.0),
    Fault("the pressure gauge says the same for ever", _tank(gauge_stuck=True), lasts=12.0),
    Fault("the pressure is that of the hull", _up("SCALED_PRESSURE2", _set("press_abs", lambda p: 1013.0))),
    Fault(
        "the autopilot's own depth leaps by 5 m",
        _up("GLOBAL_POSITION_INT", _set("relative_alt", lambda z: z - 5000)),
    ),
    Fault(
        "a throttle at neutral is taken for a climb of 0.2 m/s",
        _down("MANUAL_CONTROL", _set("z", lambda z: min(z + 250, 1000))),
        lasts=12.0,
    ),
    Fault(
        "the vehicle goes down whatever it is told",
        _down("MANUAL_CONTROL", _set("z", lambda z: 100)),
        lasts=12.0,
    ),
    Fault("the autopilot does not tell its depth", _up("GLOBAL_POSITION_INT"), lasts=8.0),
    Fault("ATTITUDE is silent", _up("ATTITUDE"), lasts=8.0),
    Fault("ATTITUDE is frozen, with new stamps", _up("ATTITUDE", _set("yaw", lambda yaw: 1.0)), lasts=8.0),
    Fault(
        "SYS_STATUS is silent, and the battery falls",
        _all(_up("SYS_STATUS"), _do(lambda s: s.tank.drain(13.5))),
        lasts=12.0,
    ),
    Fault(
        "the tether is caught, and pulls with 60 N",
        _do(lambda s: s.tank.pull((-60.0, 0.0, 0.0), 300.0)),
        lasts=10.0,
    ),
    Fault("a thruster pushes the wrong way", _broken(0, -1.0), lasts=15.0),
    Fault(
        "the terminal is frozen, and a third of the packets is lost",
        _all(_GONE, _link(LinkFaults(loss=0.33))),
        lasts=8.0,
        loss=lambda d, _: d.operator_seen,
    ),
)


def drill(
    faults: Sequence[Fault] = FAULTS,
    *,
    seed: int = 1,
    guided: bool = False,
    world: World | None = None,
    after: float = UNDER_WAY,
) -> Iterator[Outcome]:
    """Each fault on a vehicle of its own that has been on its way for so many seconds."""
    for fault in faults:
        with tempfile.TemporaryDirectory() as folder:
            with Drill(Path(folder), seed=seed, camera=fault.camera, guided=guided, world=world) as scene:
                outcome = scene.suffer(fault, after)
            # What the log still has to write when it is closed counts, too.
            yield replace(outcome, log_lost=sum(scene.rig.devices.log.lost.values()))


# The surface computer itself


@dataclass(slots=True)
class _Watcher:
    """What the autopilot has to go by, beat by beat; times are `time.monotonic`'s."""

    moved: float = -math.inf
    """When sticks that move it last held."""
    armed: float = -math.inf
    """When it last was armed."""

    def __call__(self, standin: StandIn) -> None:
        sub: ArduSub = standin.ardusub
        if sub.armed:
            self.armed = time.monotonic()
            if sub.sticks != Channels():
                self.moved = self.armed


def killed(how: signal.Signals = signal.SIGKILL, *, lasts: float = 4.0, seed: int = 1) -> Outcome:
    """Kill, or stop, the program that steers; the autopilot is left to its own failsafes."""
    world = make_world("pool/arc", seed)
    watcher = _Watcher()
    with tempfile.TemporaryDirectory() as folder, StandIn(world, seed=seed, firmware=NEXT) as standin:
        standin.watchers.append(watcher)
        process = subprocess.Popen(
            [sys.executable, "-m", "dream.robots.bluerov2.standin.topside", folder, "--seed", str(seed)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert process.stdin is not None
            assert process.stdout is not None
            port, epoch = process.stdout.readline().split()
            standin.wire.ground = ("127.0.0.1", int(port))
            standin.start()
            host, a50 = standin.a50_address
            process.stdin.write(f"{host} {a50}\n")
            process.stdin.flush()
            patience = time.monotonic() + 60.0
            while watcher.moved == -math.inf and time.monotonic() < patience:
                time.sleep(0.05)
            time.sleep(UNDER_WAY)
            from_here = standin.T_world_base.translation.copy()
            began = time.monotonic()
            process.send_signal(how)
            time.sleep(lasts)
            slid = math.dist(standin.T_world_base.translation, from_here)
            moved, armed = watcher.moved - began, watcher.armed - began
        finally:
            process.kill()
            process.wait(5.0)
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    pipe.close()
        logged = [entry.time for entry in read_log(Path(folder) / NAME)]
        behind = began - float(epoch) - max(logged, default=-math.inf)
        return Outcome(
            fault={signal.SIGKILL: "the program is killed", signal.SIGSTOP: "the program is stopped"}[how],
            detected=armed,
            did="disarmed by the autopilot",
            reason="Lost manual control",
            lost=0.0,
            last_motion=moved,
            slid=slid,
            off=math.nan,
            healed=False,
            contacts=0,
            pressed=math.nan,
            armed=False,
            depth=math.nan,
            ended=armed,
            told="",
            log_lost=0,
            kept=f"{len(logged)} messages, to {max(behind, 0.0):.1f} s before",
        )
