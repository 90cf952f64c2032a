"""A surface computer to kill: all that a dive has but camera and planner.

It says where it listens and when its clock began, is told where the A50 is, and swims to and fro
until it is killed.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
import time
from pathlib import Path
from typing import Any

from dream.geometry import SE2
from dream.robots.bluerov2.bridge import LEASE, Bridge
from dream.robots.bluerov2.drives import AltHold
from dream.robots.bluerov2.dvl_a50 import DvlA50
from dream.robots.bluerov2.home import WayHome
from dream.robots.bluerov2.limits import LastResort, Limits
from dream.robots.bluerov2.log import DiveLog
from dream.robots.bluerov2.mavlink import Link
from dream.robots.bluerov2.navigation import Instruments, Navigator
from dream.robots.bluerov2.standin.telemetry import AIR_PRESSURE
from dream.sim.world import World
from dream.sim.worlds import make_world

STILL = 2.0
"""Seconds at the launch that the sensors are listened to."""
HEIGHT = 0.6
"""Metres above the floor."""
NEAR_END, FAR_END = 0.1, 0.9
"""Metres from the start, towards the middle of the tank, between which it swims to and fro."""
TURNS = 4.0
"""Seconds from one end to the other."""


def swim(folder: Path, world: World) -> None:
    """Dive from the first start of a world, with a log in a folder; never returns."""
    began = time.monotonic()
    start = world.starts[0]
    limits = Limits(area=world.bounds, patience=2.0, last_resort=LastResort.SURFACE)
    heard: list[Any] = []

    def now() -> float:
        return time.monotonic() - began

    def deliver(message: Any) -> None:
        heard.append(message)
        navigator.deliver(message)
        log.tap(now(), "measurement", False, message)

    navigator = Navigator(Instruments(), now)
    with contextlib.ExitStack() as stack:
        log = stack.enter_context(DiveLog(folder, epoch_ns=time.time_ns()))
        link = stack.enter_context(
            Link("udpin:127.0.0.1:0", now=now, deliver=deliver, tap=log.tap, surface_pressure=AIR_PRESSURE)
        )
        sys.stdout.write(f"{link.port} {began}\n")
        sys.stdout.flush()
        host, port = sys.stdin.readline().split()
        dvl = stack.enter_context(DvlA50(host, int(port), now=now, deliver=deliver, tap=log.tap))
        link.operator_alive()
        link.connect(10.0)
        link.correct(link.check_parameters())
        heard.clear()
        until = now() + STILL
        while now() < until:
            link.operator_alive()
            time.sleep(0.05)
        navigator.align(start, heard.copy())
        link.set_mode("ALT_HOLD")
        link.arm()
        bridge = Bridge(
            navigator,
            AltHold(link, link.joystick(), WayHome(link, limits, now)),
            limits,
            now,
            failing=lambda: dvl.problem if dvl.hot else "",
        )
        stack.callback(bridge.close)
        bridge.start()
        length = math.hypot(start.x, start.y)
        turned, far = -math.inf, False
        while True:
            bridge.renew(LEASE)
            if now() - turned > TURNS:
                turned, far = now(), not far
                share = 1.0 - (FAR_END if far else NEAR_END) / length
                bridge.go(SE2(share * start.x, share * start.y, start.yaw), HEIGHT)
            time.sleep(0.05)


def main() -> None:
    """Swim in a simulated tank."""
    parser = argparse.ArgumentParser(prog="topside", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--world", default="pool/arc")
    parser.add_argument("--seed", type=int, default=1)
    told = parser.parse_args()
    swim(told.folder, make_world(told.world, told.seed))


if __name__ == "__main__":
    main()
