"""The surface computer of a drill: all that a dive has but camera and planner.

As a program of its own it swims to and fro until it is killed, which is what it is for.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from dream.control.health import Watch
from dream.geometry import SE2
from dream.measurements import Dvl, Imu
from dream.robots.bluerov2.bridge import LEASE, Bridge, Standing
from dream.robots.bluerov2.drives import AltHold, Guided
from dream.robots.bluerov2.dvl_a50 import DvlA50
from dream.robots.bluerov2.home import WayHome
from dream.robots.bluerov2.limits import LastResort, Limits
from dream.robots.bluerov2.log import DiveLog
from dream.robots.bluerov2.mavlink import Link
from dream.robots.bluerov2.navigation import Fix, Instruments, Navigator
from dream.robots.bluerov2.standin.helm import SURFACE
from dream.robots.bluerov2.standin.telemetry import AIR_PRESSURE
from dream.sim.world import World
from dream.sim.worlds import make_world

STILL = 2.0
"""Seconds at the launch that the sensors are listened to."""
NEUTRAL = (0, 0, 500, 0)
HEIGHT = 0.6
"""Metres above the floor."""
NEAR_END, FAR_END = 0.1, 0.9
"""Metres from the start, towards the middle of the tank, between which it swims to and fro."""


class Topside:
    """Link, DVL, estimate, bridge and log; opened at once, under way after `begin`."""

    def __init__(
        self,
        folder: Path,
        world: World,
        *,
        patience: float = 2.0,
        watch: Watch | None = None,
        guided: bool = False,
    ) -> None:
        """Open link and log; the vehicle is to be told of `link.port`.

        Args:
            folder: For the log.
            world: Whose first start is where the vehicle lies, and whose bounds are the fence.
            patience: Seconds in neutral before the last resort, which is to surface.
            watch: When the estimate is too old or too vague.
            guided: By velocities, in GUIDED; by sticks in ALT_HOLD else.
        """
        self.began = time.monotonic()
        self.now: Callable[[], float] = lambda: time.monotonic() - self.began
        self.start = world.starts[0]
        self.limits = Limits(area=world.bounds, patience=patience, last_resort=LastResort.SURFACE)
        self.watch = watch or Watch()
        self.moves: list[float] = []
        """When something was sent that can move the vehicle: sticks, a velocity, a depth to go to."""
        self.heard: list[tuple[float, Any]] = []
        """Measurements, and when they came in."""
        self.said: list[tuple[float, Standing]] = []
        """What the bridge did, and from when on."""
        self.sight: Callable[[Fix], str] = lambda fix: ""
        """What is wrong with the camera, where there is one."""
        self.surfaced = False
        """Was the last resort taken?"""
        self._guided = guided
        self._far = False
        with contextlib.ExitStack() as stack:
            self.log = stack.enter_context(DiveLog(folder, epoch_ns=time.time_ns()))
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
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def begin(self, a50: tuple[str, int]) -> None:
        """Connect, align, arm, and have the bridge beat."""
        link = self.link
        self.dvl = self._stack.enter_context(
            DvlA50(*a50, now=self.now, deliver=self._deliver, tap=self.log.tap)
        )
        link.operator_alive()
        link.connect(10.0)
        link.correct(link.check_parameters())
        self.heard.clear()
        until = self.now() + STILL
        while self.now() < until:
            link.operator_alive()
            time.sleep(0.05)
        self.navigator.align(self.start, [message for _, message in self.heard])
        link.set_mode("GUIDED" if self._guided else "ALT_HOLD")
        link.arm()
        self.bridge = Bridge(
            self.navigator,
            (Guided if self._guided else AltHold)(
                link, link.joystick(), WayHome(link, self.limits, self.now)
            ),
            self.limits,
            self.now,
            watch=self.watch,
            said=self._say,
            failing=lambda: self.dvl.problem if self.dvl.hot else "",
            sight=lambda fix: self.sight(fix),
        )
        self._stack.callback(self.bridge.close)
        self.bridge.start()

    def go(self) -> None:
        """To the other end of its way."""
        self._far = not self._far
        length = math.hypot(self.start.x, self.start.y)
        share = 1.0 - (FAR_END if self._far else NEAR_END) / length
        self.bridge.go(SE2(share * self.start.x, share * self.start.y, self.start.yaw), HEIGHT)

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

    def _say(self, standing: Standing) -> None:
        self.said.append((self.now(), standing))
        told = {"stance": str(standing.stance), "reason": standing.reason}
        self.log.tap(self.now(), "standing", True, told)

    def _deliver(self, message: Any) -> None:
        self.heard.append((self.now(), message))
        self.navigator.deliver(message)
        self.log.tap(self.now(), "measurement", False, message)

    def _tap(self, at: float, channel: str, sent: bool, payload: Any) -> None:
        self.log.tap(at, channel, sent, payload)
        if sent and _moving(payload):
            self.moves.append(at)
        if not sent and payload.get_type() == "HEARTBEAT" and payload.get_srcSystem() == self.link.vehicle:
            self.surfaced |= payload.custom_mode == SURFACE


def _moving(packet: Any) -> bool:
    """Can it move a vehicle?"""
    match packet.get_type():
        case "MANUAL_CONTROL":
            return (packet.x, packet.y, packet.z, packet.r) != NEUTRAL
        case "SET_POSITION_TARGET_LOCAL_NED":
            return (packet.vx, packet.vy, packet.vz, packet.yaw_rate) != (0.0, 0.0, 0.0, 0.0)
        case "SET_POSITION_TARGET_GLOBAL_INT":
            return True
    return False


def _outlived(samples: list[tuple[float, float]], since: float, until: float, limit: float) -> float:
    """When the newest of (came in, was true) got older than a limit, between two times; NaN for never."""
    newest = -math.inf
    for came, true in [*samples, (until, math.inf)]:
        if max(newest + limit, since) < came and came > since:
            return max(newest + limit, since)
        newest = max(newest, true)
    return math.nan


def main() -> None:
    """Say where it listens, be told where the A50 is, and swim until killed."""
    parser = argparse.ArgumentParser(prog="topside", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--world", default="pool/arc")
    parser.add_argument("--seed", type=int, default=1)
    told = parser.parse_args()
    with Topside(told.folder, make_world(told.world, told.seed)) as topside:
        sys.stdout.write(f"{topside.link.port} {topside.began}\n")
        sys.stdout.flush()
        host, port = sys.stdin.readline().split()
        topside.begin((host, int(port)))
        turned = -math.inf
        while True:
            topside.bridge.renew(LEASE)
            if topside.now() - turned > 4.0:
                turned = topside.now()
                topside.go()
            time.sleep(0.05)


if __name__ == "__main__":
    main()
