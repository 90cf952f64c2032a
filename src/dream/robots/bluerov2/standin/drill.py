"""Faults, one at a time, while the vehicle is on its way: when they are found, and what is done.

Everything is real but the water: the link, the DVL's line, the estimate and the bridge are those of a dive.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dream.geometry import SE2
from dream.robots.bluerov2.bridge import Bridge, LastResort, Limits, Stance, Standing
from dream.robots.bluerov2.drives import AltHold
from dream.robots.bluerov2.dvl_a50 import DvlA50
from dream.robots.bluerov2.log import DiveLog
from dream.robots.bluerov2.mavlink import Link
from dream.robots.bluerov2.navigation import Instruments, Navigator
from dream.robots.bluerov2.standin.a50 import DvlFaults
from dream.robots.bluerov2.standin.dive import StandIn
from dream.robots.bluerov2.standin.telemetry import AIR_PRESSURE
from dream.robots.bluerov2.standin.wire import LinkFaults
from dream.sim.worlds import make_world

STILL = 2.0
"""Seconds at the launch that the sensors are listened to."""
UNDER_WAY = 1.2
"""Seconds that it has been moving when the fault comes."""
NEUTRAL = (0, 0, 500, 0)


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that goes wrong."""

    name: str
    begin: Callable[[Drill], object]
    lasts: float = 3.0
    """Seconds that are watched."""
    heals: Callable[[Drill], object] | None = None
    """Puts it right, after which the vehicle is watched for another three seconds."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a fault. Times are seconds from its beginning."""

    fault: str
    detected: float
    """Until the bridge did something else than go on; inf where it never did."""
    stance: Stance
    """What it did then."""
    reason: str
    last_motion: float
    """Until the last command that moves the vehicle was sent; 0 where none was sent after it."""
    slid: float
    """Metres that the vehicle really moved within the seconds that were watched."""
    resorted: str
    """The last resort, where it was taken."""
    healed: bool
    """It went on after the fault was put right."""
    log_lost: int
    """Lines that are missing from the log."""


class Drill:
    """A vehicle in its tank, on its way to a goal, with all that a dive has but camera and planner."""

    def __init__(self, folder: Path, *, seed: int = 1, patience: float = 2.0) -> None:
        """Start it; takes some seconds.

        Args:
            folder: For the log.
            seed: Of the stand-in.
            patience: Seconds in neutral before the last resort.
        """
        began = time.monotonic()
        self.now: Callable[[], float] = lambda: time.monotonic() - began
        world = make_world("pool/arc", seed)
        self.start = world.starts[0]
        self._stack = contextlib.ExitStack()
        with contextlib.ExitStack() as stack:
            self.log = stack.enter_context(DiveLog(folder, epoch_ns=time.time_ns()))
            self.heard: list[Any] = []
            self.navigator = Navigator(Instruments(), self.now)
            self.link = stack.enter_context(
                Link(
                    "udpin:127.0.0.1:0",
                    now=self.now,
                    deliver=self._deliver,
                    tap=self._tap,
                    surface_pressure=AIR_PRESSURE,
                )
            )
            self.standin = stack.enter_context(
                StandIn(world, seed=seed, ground=("127.0.0.1", self.link.port))
            )
            self.standin.start()
            host, port = self.standin.a50_address
            self.dvl = stack.enter_context(
                DvlA50(host, port, now=self.now, deliver=self._deliver, tap=self.log.tap)
            )
            self.sent: list[tuple[float, tuple[int, int, int, int]]] = []
            """When sticks were sent, and which."""
            self.said: list[tuple[float, Standing]] = []
            self.link.operator_alive()
            self.link.connect(10.0)
            self.link.correct(self.link.check_parameters())
            self.heard.clear()
            self._living(STILL)
            self.navigator.align(self.start, list(self.heard))
            self.link.set_mode("ALT_HOLD")
            self.link.arm()
            self.limits = Limits(area=world.bounds, patience=patience, last_resort=LastResort.SURFACE)
            self.bridge = Bridge(
                self.navigator,
                AltHold(self.link, self.link.joystick()),
                self.limits,
                self.now,
                said=lambda standing: self.said.append((self.now(), standing)),
            )
            stack.callback(self.bridge.close)
            self.bridge.start()
            self.alive = True
            """Does the mission live?"""
            self._ending = threading.Event()
            mission = threading.Thread(target=self._mission, name="mission", daemon=True)
            stack.callback(self._ending.set)
            mission.start()
            self._stack = stack.pop_all()

    def close(self) -> None:
        """End it."""
        self._stack.close()

    def go(self, metres: float = 0.9) -> None:
        """Towards the middle of the tank, and beyond."""
        length = math.hypot(self.start.x, self.start.y)
        x, y = (-c / length * (metres - length) for c in (self.start.x, self.start.y))
        self.bridge.go(SE2(x, y, self.start.yaw), 0.6)

    def suffer(self, fault: Fault) -> Outcome:
        """Let it happen to a vehicle that is on its way."""
        self.go()
        time.sleep(UNDER_WAY)
        self.said.clear()
        from_here = self.standin.T_world_base.translation.copy()
        began = self.now()
        fault.begin(self)
        time.sleep(fault.lasts)
        slid = math.dist(self.standin.T_world_base.translation, from_here)
        found = [(at - began, standing) for at, standing in self.said if standing.reason]
        moved = [at - began for at, sticks in self.sent if at > began and sticks != NEUTRAL]
        healed = False
        if fault.heals is not None:
            fault.heals(self)
            time.sleep(3.0)
            healed = self.bridge.standing.stance is Stance.GO
        detected, standing = found[0] if found else (math.inf, self.bridge.standing)
        mode = self.link.telemetry.mode
        return Outcome(
            fault=fault.name,
            detected=detected,
            stance=standing.stance,
            reason=standing.reason,
            last_motion=max(moved, default=0.0),
            slid=slid,
            resorted=mode if mode == "SURFACE" else "",
            healed=healed,
            log_lost=sum(self.log.lost.values()),
        )

    def _mission(self) -> None:
        while not self._ending.wait(0.05):
            if self.alive:
                self.bridge.renew()

    def _living(self, seconds: float) -> None:
        until = self.now() + seconds
        while self.now() < until:
            self.link.operator_alive()
            time.sleep(0.05)

    def _deliver(self, message: Any) -> None:
        self.heard.append(message)
        self.navigator.deliver(message)
        self.log.tap(self.now(), "measurement", False, message)

    def _tap(self, at: float, channel: str, sent: bool, payload: Any) -> None:
        self.log.tap(at, channel, sent, payload)
        if sent and payload.get_type() == "MANUAL_CONTROL":
            self.sent.append((at, (payload.x, payload.y, payload.z, payload.r)))


def _on(drill: Drill, part: str, faults: object) -> None:
    with drill.standin.lock:
        setattr(getattr(drill.standin, part), "faults", faults)  # noqa: B010 - the part is a word here.


def _do(drill: Drill, what: Callable[[StandIn], object]) -> None:
    with drill.standin.lock:
        what(drill.standin)


def _rival(drill: Drill) -> None:
    """Another station with our id speaks to the vehicle; a router lets us hear it."""
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    other = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    packet = other.manual_control_encode(1, 400, 0, 500, 0, 0).pack(other)
    with contextlib.closing(_socket()) as out:
        for _ in range(5):
            out.sendto(packet, ("127.0.0.1", drill.link.port))


def _socket() -> Any:
    import socket

    return socket.socket(socket.AF_INET, socket.SOCK_DGRAM)


FAULTS = (
    Fault(
        "the mission hangs",
        lambda d: setattr(d, "alive", False),
        heals=lambda d: setattr(d, "alive", True),
        lasts=1.5,
    ),
    Fault(
        "the operator's terminal is gone",
        lambda d: d.bridge.renew_operator(0.0),
        heals=lambda d: d.bridge.renew_operator(60.0),
        lasts=1.5,
    ),
    Fault(
        "a third of the packets is lost, both ways",
        lambda d: _on(d, "wire", LinkFaults(loss=0.33)),
        heals=lambda d: _on(d, "wire", LinkFaults()),
    ),
    Fault(
        "packets come 0.3 s late, and not in order",
        lambda d: _on(d, "wire", LinkFaults(delay=0.3, jitter=0.1)),
        heals=lambda d: _on(d, "wire", LinkFaults()),
        lasts=2.0,
    ),
    Fault(
        "the link is dead",
        lambda d: _on(d, "wire", LinkFaults(loss=1.0)),
        heals=lambda d: _on(d, "wire", LinkFaults()),
        lasts=1.5,
    ),
    Fault("the autopilot begins anew", lambda d: _do(d, lambda s: s.ardusub.reboot(1.0)), lasts=5.0),
    Fault(
        "the autopilot's clock jumps by 100 s",
        lambda d: _do(d, lambda s: s.ardusub.jump_clock(100.0)),
        heals=lambda d: None,
    ),
    Fault(
        "the DVL is silent",
        lambda d: _on(d, "a50", DvlFaults(silent=True)),
        heals=lambda d: _on(d, "a50", DvlFaults()),
    ),
    Fault(
        "the DVL talks nonsense",
        lambda d: _on(d, "a50", DvlFaults(garbage="all")),
        heals=lambda d: _on(d, "a50", DvlFaults()),
    ),
    Fault(
        "the DVL loses the bottom",
        lambda d: _on(d, "a50", DvlFaults(lost=True)),
        heals=lambda d: _on(d, "a50", DvlFaults()),
    ),
    Fault(
        "the tether pulls with 15 N for 1 s",
        lambda d: _do(d, lambda s: s.tank.pull((15.0, 0.0, 0.0), 1.0)),
        heals=lambda d: None,
    ),
    Fault("the battery falls to 13.5 V", lambda d: _do(d, lambda s: s.tank.drain(13.5)), lasts=5.0),
    Fault("another station has our id", _rival, lasts=1.5, heals=lambda d: d.link.resume()),
    Fault("somebody changes the mode", lambda d: _do(d, lambda s: s.ardusub.set_mode(19)), lasts=2.0),
    Fault("somebody disarms it", lambda d: _do(d, lambda s: s.ardusub.disarm()), lasts=2.5),
)


def drill(faults: tuple[Fault, ...] = FAULTS, *, seed: int = 1) -> Iterator[Outcome]:
    """Each fault on a vehicle of its own."""
    for fault in faults:
        with tempfile.TemporaryDirectory() as folder:
            scene = Drill(Path(folder), seed=seed)
            try:
                outcome = scene.suffer(fault)
            finally:
                scene.close()
            # What the log still has to write when it is closed counts, too.
            yield replace(outcome, log_lost=sum(scene.log.lost.values()))
