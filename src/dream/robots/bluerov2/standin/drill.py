"""Faults, one at a time, while the vehicle is on its way: when they are found, and what is done.

Everything is real but the water: the link, the DVL's line, the camera's stream, the estimate and the bridge
are those of a dive.
"""

from __future__ import annotations

import contextlib
import math
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from dream.control.health import Watch
from dream.errors import MissionAborted
from dream.geometry import SE2, Camera
from dream.protocol import protocol_named
from dream.robots.bluerov2.bridge import LEASE, Stance
from dream.robots.bluerov2.log import NAME, read_log
from dream.robots.bluerov2.standin.a50 import DvlFaults
from dream.robots.bluerov2.standin.ardusub import ArduSub
from dream.robots.bluerov2.standin.dive import StandIn
from dream.robots.bluerov2.standin.motors import Sticks
from dream.robots.bluerov2.standin.parameters import NEXT
from dream.robots.bluerov2.standin.topside import HEIGHT, Topside
from dream.robots.bluerov2.standin.video import Faults, VideoSource, eye
from dream.robots.bluerov2.standin.wire import LinkFaults
from dream.sim.worlds import make_world
from dream.types import Setpoint

UNDER_WAY = 1.0
"""Seconds that it has been moving when the fault comes."""
HEALING = 4.0
"""Seconds that it may take to go on after a fault was put right."""
GOING = 0.3
"""Seconds of going on after which it counts as healed."""
TICK = 0.05
"""Seconds between two signs of life."""
WATCH = Watch(lost=1.5)
"""As in a dive, but that the bottom may be lost for a shorter time, so that a drill need not wait for it."""
PICTURE = 160
"""Pixels of width: enough to be used, and drawn in a few milliseconds."""
FIRST = 15.0
"""Seconds that the first picture may take."""
MOVE = 0.4
"""Metres of a step of the drills with a camera."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that goes wrong."""

    name: str
    begin: Callable[[Drill], object]
    lasts: float = 3.0
    """Seconds that are watched."""
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
    """What it did then, and the last resort where it was taken."""
    reason: str
    lost: float
    """When that was lost without which nothing may move; NaN where nothing such was."""
    last_motion: float
    """When the last packet was sent that can move the vehicle: before 0 where the fault kept the next one
    back, −inf where there was none."""
    slid: float
    """Metres that the vehicle really moved while it was watched."""
    off: float
    """Metres between estimate and truth in the end, horizontally; NaN where nobody is left who estimates."""
    healed: bool
    """It goes on, or still goes on, in the end."""
    log_lost: int
    """Messages that are missing from the log."""
    kept: str
    """What is on disk."""

    @property
    def after_loss(self) -> float:
        """Seconds from the loss to the last packet that can move the vehicle; NaN without a loss."""
        return max(self.last_motion - self.lost, 0.0) if math.isfinite(self.lost) else math.nan


class Drill:
    """A vehicle in its tank, on its way, with all that a dive has but a planner."""

    def __init__(self, folder: Path, *, seed: int = 1, camera: bool = False, guided: bool = False) -> None:
        """Start it; takes some seconds.

        Args:
            folder: For the log.
            seed: Of the stand-in.
            camera: Send pictures, and let the mission look and move in turn, as a survey does.
            guided: Drive by velocities.
        """
        world = make_world("pool/arc", seed)
        self.alive = self.attended = True
        """Do mission and operator live?"""
        self.calm = threading.Event()
        """Set where a fault that grows is to end."""
        self.mission_seen = self.operator_seen = math.inf
        """When they last showed it."""
        self.pictures = 0
        """That the mission looked at."""
        self._looking = threading.Event()
        self._ending = threading.Event()
        with contextlib.ExitStack() as stack:
            self.topside = topside = stack.enter_context(Topside(folder, world, watch=WATCH, guided=guided))
            self.standin = stack.enter_context(
                StandIn(world, seed=seed, ground=("127.0.0.1", topside.link.port), firmware=NEXT)
            )
            self.standin.ardusub.fix = guided
            self.standin.start()
            topside.begin(self.standin.a50_address)
            threads: list[Callable[[], None]] = [self._operate]
            if camera:
                threads.append(self._survey(stack))
            else:
                threads.append(self._renew)
            for work in threads:
                thread = threading.Thread(target=work, name=work.__name__, daemon=True)
                stack.callback(thread.join, 5.0)
                thread.start()
            stack.callback(self._ending.set)
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def suffer(self, fault: Fault) -> Outcome:
        """Let it happen to a vehicle that is on its way."""
        topside, standin = self.topside, self.standin
        self.calm.clear()
        if fault.camera:
            self._looking.wait(FIRST)
        else:
            topside.go()
        time.sleep(UNDER_WAY)
        from_here = standin.T_world_base.translation.copy()
        began = topside.now()
        fault.begin(self)
        time.sleep(fault.lasts)
        ended = topside.now()
        slid = math.dist(standin.T_world_base.translation, from_here)
        lost = fault.loss(self, began)
        self.calm.set()
        if fault.heals is not None:
            fault.heals(self)
        healed = fault.heals is None or self._goes_on()
        found = [(at, standing) for at, standing in topside.said if began < at <= ended and standing.reason]
        # A loss may be told in two stages, slower first.
        lost_at = [entry for entry in found if entry[1].stance is not Stance.SLOW]
        detected, standing = (lost_at or found or [(math.inf, topside.bridge.standing)])[0]
        resort = ", then it surfaces" if topside.surfaced else ""
        kept = f"{topside.log.written} messages"
        return Outcome(
            fault=fault.name,
            detected=detected - began,
            did=f"{standing.stance}{resort}",
            reason=standing.reason,
            lost=lost - began,
            last_motion=max((at - began for at in topside.moves if at <= ended), default=-math.inf),
            slid=slid,
            off=math.dist(
                topside.bridge.fix.T_world_base.translation[:2], standin.T_world_base.translation[:2]
            ),
            healed=healed and topside.bridge.standing.stance is Stance.GO and topside.link.telemetry.armed,
            log_lost=sum(topside.log.lost.values()),
            kept=f"{kept}, {self.pictures} pictures" if fault.camera else kept,
        )

    def _goes_on(self) -> bool:
        """Does it go on for a while, before its time for that is over?"""
        since, end = math.inf, self.topside.now() + HEALING
        while (now := self.topside.now()) < end:
            since = min(since, now) if self.topside.bridge.standing.stance is Stance.GO else math.inf
            if now - since > GOING:
                return True
            time.sleep(TICK)
        return False

    def _renew(self) -> None:
        """A mission that lives, and waits."""
        while not self._ending.wait(TICK):
            if self.alive:
                self.topside.bridge.renew()
                self.mission_seen = self.topside.now()

    def _operate(self) -> None:
        """An operator's terminal."""
        while not self._ending.wait(TICK):
            if self.attended:
                self.topside.bridge.renew_operator(LEASE)
                self.operator_seen = self.topside.now()

    def _survey(self, stack: contextlib.ExitStack) -> Callable[[], None]:
        """Open a camera, and give a mission that looks and moves in turn until it is aborted."""
        from dream.perception import FlatFloor, Perception, Shells
        from dream.robots.bluerov2.camera import LiveCamera, RtpVideo
        from dream.robots.bluerov2.devices import LiveEye
        from dream.robots.bluerov2.rov import BlueRov2, Sight
        from dream.sim.render import Renderer

        topside, standin, world = self.topside, self.standin, self.standin.tank.world
        protocol = protocol_named(world.protocol)
        camera = Camera.from_fov(PICTURE, PICTURE * 3 // 4, protocol.camera.horizontal_fov)
        draw = eye(Renderer(world), camera, lambda: standin.T_world_base @ protocol.T_base_camera)
        live = stack.enter_context(LiveCamera(RtpVideo(port=0), now=topside.now, tap=topside.log.tap))
        self.video = stack.enter_context(VideoSource(draw, ("127.0.0.1", live.port)))
        perception = Perception(Shells(), FlatFloor())
        robot = BlueRov2(topside.bridge, topside.navigator, LiveEye(live), perception, protocol, topside.now)

        # Pictures begin to come a while after it has begun to beat.
        seen = Sight(live)
        topside.sight = lambda fix: seen(fix) if self.pictures else ""

        def survey() -> None:
            start = topside.start
            there = SE2(start.x * (1.0 - MOVE / math.hypot(start.x, start.y)), start.y, start.yaw)
            try:
                while not (live.connected or self._ending.is_set()):
                    topside.bridge.renew()
                    time.sleep(TICK)
                while not self._ending.is_set():
                    robot.observe()
                    self.pictures += 1
                    self._looking.set()
                    goal = there if self.pictures % 2 else start
                    robot.go_to(Setpoint(goal.x, goal.y, goal.yaw, HEIGHT))
            except MissionAborted as error:
                topside.bridge.end(str(error))

        return survey


# What is done to it


def _set(part: str, faults: object) -> Callable[[Drill], object]:
    """Give wire or a50 of the stand-in other faults."""

    def begin(drill: Drill) -> None:
        with drill.standin.lock:
            setattr(getattr(drill.standin, part), "faults", faults)  # noqa: B010 - the part is a word here.

    return begin


def _do(what: Callable[[StandIn], object]) -> Callable[[Drill], object]:
    """Do something to the stand-in."""

    def begin(drill: Drill) -> None:
        with drill.standin.lock:
            what(drill.standin)

    return begin


def _see(faults: Faults) -> Callable[[Drill], object]:
    """Give the camera's stream faults."""
    return lambda drill: setattr(drill.video, "faults", faults)


def _nothing(drill: Drill) -> None:
    """It passes by itself."""


def _send(drill: Drill, packets: Sequence[bytes]) -> None:
    """Let the link hear something, as a router would."""
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as out:
        for packet in packets:
            out.sendto(packet, ("127.0.0.1", drill.topside.link.port))


def _rival(drill: Drill) -> None:
    """Another station with our id speaks to the vehicle, whose router passes that on to us."""
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    other = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    packet = other.manual_control_encode(1, 400, 0, 500, 0, 0).pack(other)
    with drill.standin.lock:
        for _ in range(5):
            drill.standin.wire.send(packet, None, drill.standin.tank.time)


def _stranger(drill: Drill) -> None:
    """Another vehicle reports to our port for as long as it is watched: disarmed, and leaning over."""
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    other = dialect.MAVLink(None, srcSystem=7, srcComponent=1)

    def report() -> None:
        while not drill.calm.wait(0.02):
            beat = other.heartbeat_encode(dialect.MAV_TYPE_SUBMARINE, 3, 0, 19, 3)
            sample = other.raw_imu_encode(round(1e6 * time.monotonic()), 0, 900, 400, 2000, 2000, 0, 0, 0, 0)
            _send(drill, [beat.pack(other), sample.pack(other)])

    threading.Thread(target=report, name="stranger", daemon=True).start()


def _slower(drill: Drill) -> None:
    """The delay grows by 0.05 s a second, both ways."""

    def grow() -> None:
        delay = 0.0
        while not drill.calm.wait(0.1):
            delay += 0.005
            _set("wire", LinkFaults(delay=delay))(drill)

    threading.Thread(target=grow, name="slower", daemon=True).start()


def _hang(drill: Drill) -> None:
    """Whoever asks for the estimate waits until it is put right."""
    navigator = drill.topside.navigator
    update = navigator.update

    def late() -> Any:
        drill.calm.wait()
        navigator.update = update  # type: ignore[method-assign]
        return update()

    navigator.update = late  # type: ignore[method-assign]


def _unheard(standin: StandIn) -> None:
    """The vehicle takes another system id for its ground station's."""
    parameters = standin.ardusub.parameters
    parameters.change(parameters.firmware.gcs_parameter, 252)


_LINKED, _SEEN = _set("wire", LinkFaults()), _set("a50", DvlFaults())

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
        lambda d: setattr(d, "attended", False),
        heals=lambda d: setattr(d, "attended", True),
        lasts=1.0,
        loss=lambda d, _: d.operator_seen,
    ),
    Fault("the estimate hangs for 1 s", _hang, heals=_nothing, lasts=1.0, loss=lambda d, began: began),
    Fault("a third of the packets is lost, both ways", _set("wire", LinkFaults(loss=0.33)), heals=_LINKED),
    Fault(
        "packets come up to 0.15 s late, out of order", _set("wire", LinkFaults(jitter=0.15)), heals=_LINKED
    ),
    Fault(
        "packets come 0.3 s late",
        _set("wire", LinkFaults(delay=0.3, jitter=0.1)),
        heals=_LINKED,
        lasts=1.3,
        loss=lambda d, began: d.topside.inertia_lost(began),
    ),
    Fault(
        "the link is dead for 0.7 s",
        _set("wire", LinkFaults(loss=1.0)),
        heals=_LINKED,
        lasts=0.7,
        loss=lambda d, began: d.topside.inertia_lost(began),
    ),
    Fault("another vehicle reports to our port", _stranger, heals=_nothing, lasts=2.0),
    Fault(
        "the autopilot's clock jumps by 100 s",
        _do(lambda s: s.ardusub.jump_clock(100.0)),
        heals=_nothing,
        lasts=1.0,
    ),
    Fault(
        "the DVL's clock jumps back by 30 s",
        _do(lambda s: s.a50.jump_clock(-30.0)),
        heals=_nothing,
        lasts=1.0,
    ),
    Fault("the DVL talks nonsense", _set("a50", DvlFaults(garbage="all")), heals=_SEEN),
    Fault(
        "the DVL is silent",
        _set("a50", DvlFaults(silent=True)),
        heals=_SEEN,
        lasts=2.5,
        loss=lambda d, began: d.topside.bottom_lost(began),
    ),
    Fault(
        "the DVL loses the bottom",
        _set("a50", DvlFaults(lost=True)),
        heals=_SEEN,
        lasts=2.5,
        loss=lambda d, began: d.topside.bottom_lost(began),
    ),
    Fault(
        "the tether pulls with 15 N for 1 s",
        _do(lambda s: s.tank.pull((15.0, 0.0, 0.0), 1.0)),
        heals=_nothing,
    ),
    Fault("another station has our id", _rival, lasts=0.6, heals=lambda d: d.topside.link.resume()),
)
"""From which the vehicle goes on, one after the other if need be."""

FAULTS = (
    *HEALING_FAULTS,
    Fault(
        "the delay grows by 0.05 s a second",
        _slower,
        heals=_LINKED,
        lasts=5.0,
        loss=lambda d, began: d.topside.inertia_lost(began),
    ),
    Fault(
        "the link stays dead",
        _set("wire", LinkFaults(loss=1.0)),
        lasts=6.0,
        loss=lambda d, began: d.topside.inertia_lost(began),
    ),
    Fault("the estimate hangs for good", _hang, lasts=6.0, loss=lambda d, began: began),
    Fault(
        "the autopilot begins anew",
        _do(lambda s: s.ardusub.reboot(1.0)),
        lasts=5.0,
        loss=lambda d, began: d.topside.inertia_lost(began),
    ),
    Fault(
        "the DVL stays silent",
        _set("a50", DvlFaults(silent=True)),
        lasts=6.0,
        loss=lambda d, began: d.topside.bottom_lost(began),
    ),
    Fault("the DVL is about to shut down, too hot", _set("a50", DvlFaults(hot=True)), lasts=4.0),
    Fault("the battery falls to 13.5 V", _do(lambda s: s.tank.drain(13.5)), lasts=8.0),
    Fault("water comes in", _do(lambda s: setattr(s.tank, "leak", True)), lasts=5.0),
    Fault("somebody changes the mode", _do(lambda s: s.ardusub.set_mode(19)), lasts=2.0),
    Fault("somebody disarms it", _do(lambda s: s.ardusub.disarm()), lasts=4.0),
    Fault("the vehicle listens to another station", _do(_unheard), lasts=4.0),
    Fault("the camera is silent", _see(Faults(silent=True)), lasts=10.0, camera=True),
    Fault("the camera is frozen", _see(Faults(frozen=True)), lasts=10.0, camera=True),
    Fault("a tenth of the camera's packets is broken", _see(Faults(corrupt=0.1)), lasts=8.0, camera=True),
    Fault("all of the camera's packets are broken", _see(Faults(corrupt=1.0)), lasts=10.0, camera=True),
)


def drill(faults: Sequence[Fault] = FAULTS, *, seed: int = 1, guided: bool = False) -> Iterator[Outcome]:
    """Each fault on a vehicle of its own."""
    for fault in faults:
        with tempfile.TemporaryDirectory() as folder:
            with Drill(Path(folder), seed=seed, camera=fault.camera, guided=guided) as scene:
                outcome = scene.suffer(fault)
            # What the log still has to write when it is closed counts, too.
            yield replace(outcome, log_lost=sum(scene.topside.log.lost.values()))


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
            if sub.sticks != Sticks():
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
            log_lost=0,
            kept=f"{len(logged)} messages, to {max(behind, 0.0):.1f} s before",
        )
