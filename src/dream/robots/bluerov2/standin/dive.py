"""A tank, an ArduSub and an A50 that beat together: by hand, or with real time."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Protocol

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, SE3, camera_mount
from dream.protocol import SurveyProtocol
from dream.robots.bluerov2.standin.a50 import A50
from dream.robots.bluerov2.standin.ardusub import ArduSub, Send
from dream.robots.bluerov2.standin.parameters import STABLE, Firmware
from dream.robots.bluerov2.standin.tank import BEAT, Conditions, Tank
from dream.robots.bluerov2.standin.wire import Address, Datagrams, Wire
from dream.sim.world import World

LOG = logging.getLogger(__name__)

MOST_BEHIND = 1.0
"""Seconds of lag that are caught up; what goes beyond is dropped, and the dive is that much slower."""
REHEARSED = 20
"""Beats before it starts."""
AT_ONCE = 20
"""Beats that are caught up before the lock is free for others again."""


class Autopilot(Protocol):
    """What turns messages into thrust: our own stand-in, or the real one."""

    @property
    def commands(self) -> npt.NDArray[np.float64]:
        """(n,) to the thrusters of the tank."""

    @property
    def tilt(self) -> float:
        """Radians that the camera looks up."""

    def hear(self, data: bytes, sender: Address | None = None) -> None:
        """Bytes from a ground station; answers go back to the sender."""

    def beat(self) -> None:
        """After each beat of the tank: feel, steer, report."""

    def close(self) -> None:
        """Let go of all it holds."""


class StandIn:
    """A BlueROV2 and its A50 on loopback, in a simulated tank.

    What it does: `step` carries tank, ArduSub and A50 on together, a hundred beats a second, without
    sleeping: that is for tests. `start` lets a thread do the same against a monotonic clock. Sockets are
    bound from the beginning: `ardusub_address` is the vehicle's own, from which it tells its ground station,
    `a50_address` is where the A50 listens.
    The vehicle is held at its launch until it is first armed, see `Tank`. What is to be shown at any time, by
    a camera say, takes `T_world_base`, or is called after each beat as one of `watchers`.

    Faults: `wire.faults`, `a50.faults`, and the methods of `tank`, `ardusub` and `a50`; from another thread
    than the one that beats, under `lock`.
    """

    def __init__(
        self,
        world: World,
        protocol: SurveyProtocol | None = None,
        *,
        seed: int = 1,
        ground: Address | None = None,
        host: str | None = "127.0.0.1",
        a50_port: int = 0,
        conditions: Conditions | None = None,
        start: SE2 | None = None,
        depth: float | None = None,
        system: int = 1,
        gcs: int = 255,
        firmware: Firmware = STABLE,
        booted: float = 137.0,
        autopilot: Callable[[Tank, Send], Autopilot] | None = None,
        datagrams: Datagrams | None = None,
    ) -> None:
        """Put the vehicle into its world and bind the sockets.

        Args:
            world: Where.
            protocol: Whose altitude, body and camera; the world's own unless given.
            seed: Of the vehicle, its instruments and its wire.
            ground: Address of the ground station; none is told of itself where None.
            host: Where sockets are bound; None for nowhere: `a50.attach` and `datagrams` are the ways in.
            datagrams: What carries MAVLink in place of a socket.
            a50_port: Of the A50; 0 for any free one.
            conditions: What swims; a BlueROV2 Heavy in still water unless given.
            start: Where; the world's first start pose unless given.
            depth: Metres below the surface where it starts; at the protocol's altitude unless given.
            system: MAVLink id of the vehicle.
            gcs: MAVLink id of the ground station that it listens to.
            firmware: Release of ArduSub.
            booted: Seconds that ArduSub has run when the dive begins.
            autopilot: Makes another autopilot than ours, which the four before it are for.
        """
        self._world, self._protocol, self._conditions = world, protocol, conditions
        self.tank = tank = Tank(world, protocol, seed=seed, conditions=conditions, start=start, depth=depth)
        self.wire = wire = Wire(ground, host=host or "127.0.0.1", seed=seed, datagrams=datagrams)

        def send(data: bytes, to: Address | None) -> None:
            wire.send(data, to, tank.time)

        self.autopilot: Autopilot = (
            ArduSub(tank, send, system=system, gcs=gcs, firmware=firmware, booted=booted)
            if autopilot is None
            else autopilot(tank, send)
        )
        self.a50 = A50(self.tank, host=host, port=a50_port)
        self.watchers: list[Callable[[StandIn], None]] = []
        self.lock = threading.RLock()
        self.lag = 0.0
        """Seconds that it is behind real time."""
        self.behind = 0.0
        """The same, at most so far."""
        self.problem = ""
        """Why it stopped beating; empty while it does."""
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def ardusub(self) -> ArduSub:
        """Our own autopilot.

        Raises:
            TypeError: It has another.
        """
        if not isinstance(self.autopilot, ArduSub):
            raise TypeError(f"autopilot: expected our own ArduSub, got {self.autopilot!r}")
        return self.autopilot

    @property
    def ardusub_address(self) -> Address:
        """The vehicle's own socket."""
        return self.wire.address

    @property
    def a50_address(self) -> Address:
        """Where the A50 listens."""
        return self.a50.address

    @property
    def T_world_base(self) -> SE3:
        """Where the vehicle truly is; from any thread."""
        return self.tank.T_world_base

    @property
    def T_base_camera(self) -> SE3:
        """The camera at the vehicle's centre, as its mount is tilted."""
        return camera_mount(-self.autopilot.tilt)

    def step(self, seconds: float) -> None:
        """Carry all on by so many seconds, to the nearest beat, without waiting."""
        for _ in range(round(seconds / BEAT)):
            self.beat()

    def beat(self) -> None:
        """One hundredth of a second."""
        with self.lock:
            now = self.tank.time
            for data, sender in self.wire.receive(now):
                self.autopilot.hear(data, sender)
            self.tank.advance(self.autopilot.commands)
            self.autopilot.beat()
            self.a50.beat()
            self.wire.flush(self.tank.time)
            for watcher in self.watchers:
                watcher(self)

    def start(self) -> None:
        """Let a thread beat with real time."""
        if self._thread is not None:
            raise RuntimeError("stand-in: expected to be started once")
        self._rehearse()
        self.beat()
        self._thread = threading.Thread(target=self._run, name="stand-in", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop, and let go of the sockets."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(5.0)
        self.autopilot.close()
        self.wire.close()
        self.a50.close()

    def __enter__(self) -> StandIn:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _rehearse(self) -> None:
        """Swim in a tank of its own: what is compiled now does not keep the real one waiting."""
        tank = Tank(self._world, self._protocol, conditions=self._conditions)
        tank.release()
        for _ in range(REHEARSED):
            tank.advance(np.zeros(len(self.autopilot.commands)))
        tank.ping()

    def _run(self) -> None:
        try:
            due = time.monotonic()
            while not self._ending.is_set():
                self.lag = max(time.monotonic() - due, 0.0)
                self.behind = max(self.behind, self.lag)
                due += max(self.lag - MOST_BEHIND, 0.0)
                for _ in range(AT_ONCE):
                    if time.monotonic() < due:
                        break
                    self.beat()
                    due += BEAT
                self._ending.wait(max(due - time.monotonic(), 0.0005))
        except Exception as error:  # noqa: BLE001 - a dead stand-in has to say why, and not by a trace in a thread.
            self.problem = f"{type(error).__name__}: {error}"
            LOG.error("stand-in: %s", self.problem)
