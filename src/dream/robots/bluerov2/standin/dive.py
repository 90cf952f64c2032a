"""A tank, an ArduSub and an A50 that beat together: by hand, or with real time."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from types import TracebackType

import numpy as np

from dream.geometry import SE2, SE3, camera_mount
from dream.protocol import SurveyProtocol
from dream.robots.bluerov2.standin.a50 import A50
from dream.robots.bluerov2.standin.ardusub import ArduSub
from dream.robots.bluerov2.standin.parameters import STABLE, Firmware
from dream.robots.bluerov2.standin.tank import BEAT, Conditions, Tank
from dream.robots.bluerov2.standin.wire import Address, Wire
from dream.sim.world import World

LOG = logging.getLogger(__name__)

MOST_BEHIND = 1.0
"""Seconds of lag that are caught up; what goes beyond is dropped, and the dive is that much slower."""
REHEARSED = 20
"""Beats before it starts."""
AT_ONCE = 20
"""Beats that are caught up before the lock is free for others again."""


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
        host: str = "127.0.0.1",
        a50_port: int = 0,
        conditions: Conditions | None = None,
        start: SE2 | None = None,
        system: int = 1,
        gcs: int = 255,
        firmware: Firmware = STABLE,
        booted: float = 137.0,
    ) -> None:
        """Put the vehicle into its world and bind the sockets.

        Args:
            world: Where.
            protocol: Whose altitude, body and camera; the world's own unless given.
            seed: Of the vehicle, its instruments and its wire.
            ground: Address of the ground station; none is told of itself where None.
            host: Where sockets are bound.
            a50_port: Of the A50; 0 for any free one.
            conditions: What swims; a BlueROV2 Heavy in still water unless given.
            start: Where; the world's first start pose unless given.
            system: MAVLink id of the vehicle.
            gcs: MAVLink id of the ground station that it listens to.
            firmware: Release of ArduSub.
            booted: Seconds that ArduSub has run when the dive begins.
        """
        self._world, self._protocol, self._conditions = world, protocol, conditions
        self.tank = Tank(world, protocol, seed=seed, conditions=conditions, start=start)
        self.wire = Wire(ground, host=host, seed=seed)
        self.ardusub = ArduSub(
            self.tank,
            lambda data, to: self.wire.send(data, to, self.tank.time),
            system=system,
            gcs=gcs,
            firmware=firmware,
            booted=booted,
        )
        self.a50 = A50(self.tank, host=host, port=a50_port)
        self.watchers: list[Callable[[StandIn], None]] = []
        self.lock = threading.RLock()
        self.lag = 0.0
        """Seconds that it is behind real time."""
        self.dropped = 0.0
        """Seconds that it has given up."""
        self.problem = ""
        """Why it stopped beating; empty while it does."""
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

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
        return camera_mount(-self.ardusub.tilt)

    def step(self, seconds: float) -> None:
        """Carry all on by so many seconds, to the nearest beat, without waiting."""
        for _ in range(round(seconds / BEAT)):
            self.beat()

    def beat(self) -> None:
        """One hundredth of a second."""
        with self.lock:
            now = self.tank.time
            for data, sender in self.wire.receive(now):
                self.ardusub.hear(data, sender)
            self.tank.advance(self.ardusub.commands)
            self.ardusub.beat()
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
            tank.advance(np.zeros(len(self.ardusub.commands)))
        tank.ping()

    def _run(self) -> None:
        try:
            due = time.monotonic()
            while not self._ending.is_set():
                self.lag = max(time.monotonic() - due, 0.0)
                if self.lag > MOST_BEHIND:
                    self.dropped += self.lag - MOST_BEHIND
                    due += self.lag - MOST_BEHIND
                for _ in range(AT_ONCE):
                    if time.monotonic() < due:
                        break
                    self.beat()
                    due += BEAT
                self._ending.wait(max(due - time.monotonic(), 0.0005))
        except Exception as error:  # noqa: BLE001 - a dead stand-in has to say why, and not by a trace in a thread.
            self.problem = f"{type(error).__name__}: {error}"
            LOG.error("stand-in: %s", self.problem)
