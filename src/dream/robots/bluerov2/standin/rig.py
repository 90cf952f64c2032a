"""A whole dive on one simulated clock: water, vehicle, link, DVL, camera, estimate, bridge and way home."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, Camera
from dream.protocol import SurveyProtocol, protocol_named
from dream.robots.bluerov2.bridge import Bridge, Standing
from dream.robots.bluerov2.camera import Frames
from dream.robots.bluerov2.devices import Addresses, Devices
from dream.robots.bluerov2.drives import AltHold, Guided
from dream.robots.bluerov2.home import WayHome
from dream.robots.bluerov2.limits import Limits
from dream.robots.bluerov2.navigation import Fix, Instruments
from dream.robots.bluerov2.standin.ardusub import Send
from dream.robots.bluerov2.standin.dive import Autopilot, StandIn
from dream.robots.bluerov2.standin.lockstep import LockStep
from dream.robots.bluerov2.standin.parameters import NEXT, Firmware
from dream.robots.bluerov2.standin.tank import BEAT, Conditions, Tank
from dream.robots.bluerov2.standin.telemetry import AIR_PRESSURE
from dream.robots.bluerov2.standin.video import eye
from dream.robots.bluerov2.standin.wire import SURFACE, Cable
from dream.sim.render import Renderer
from dream.sim.world import World

UInt8Array = npt.NDArray[np.uint8]

EPOCH_NS = 1_767_225_600_000_000_000
"""When the clock is 0: UTC, nanoseconds since 1970. The first of January 2026."""
LISTENS = 4.0
"""Seconds that the sensors are listened to before the dive."""


class Rig:
    """A vehicle in its tank and the surface computer that drives it, of which no thread waits for real time.

    What it does: link, DVL, camera, estimate, log, bridge, drives and way home are those of a dive; so are
    the bytes of MAVLink and the lines of the A50. Only what carries them is in memory, and pictures come
    uncompressed. `ready` does what a dive does before it arms, `begin` arms it.

    Assumes: one rig at a time in a thread. Whatever has to happen at a time is a thread of its `clock`.
    """

    def __init__(
        self,
        folder: Path,
        world: World,
        protocol: SurveyProtocol | None = None,
        *,
        seed: int = 1,
        guided: bool = False,
        depth: float | None = None,
        pictures: float = 0.0,
        width: int = 160,
        conditions: Conditions | None = None,
        firmware: Firmware = NEXT,
        autopilot: Callable[[Tank, Send], Autopilot] | None = None,
        limits: Limits | None = None,
    ) -> None:
        """Put the vehicle into the water, and open all that a dive opens.

        Args:
            folder: For the log.
            world: Whose first start is where the vehicle lies, and whose bounds are the fence.
            protocol: Of the mission; the world's own unless given.
            seed: Of all that is drawn.
            guided: Drive by velocities.
            depth: Metres at which it lies at the launch; at the protocol's altitude unless given.
            pictures: A second, that the camera takes; 0 for no camera.
            width: Pixels of a picture, 4:3.
            conditions: What swims in what.
            firmware: Release of our own ArduSub.
            autopilot: Makes another autopilot than ours.
            limits: Of the dive; the world's bounds unless given.
        """
        self.world, self.guided, self._pictures = world, guided, pictures
        self.protocol = protocol or protocol_named(world.protocol)
        self.start = self.protocol.snap(world.starts[0])
        self.limits = limits or Limits(area=world.bounds)
        self.clock = clock = LockStep()
        self.said: list[tuple[float, Standing]] = []
        """What the bridge did, and from when on."""
        self.told: list[tuple[float, str]] = []
        """What the operator was told."""
        self.look: Callable[[UInt8Array], UInt8Array | None] = lambda picture: picture
        """What becomes of a picture on its way; None where it is lost."""
        self.sight: Callable[[Fix], str] = lambda fix: ""
        """Why the mission would not see, as the bridge asks."""
        self._swimming = True
        with contextlib.ExitStack() as stack:
            self.cable = cable = Cable(clock)
            self.standin = stack.enter_context(
                StandIn(
                    world,
                    self.protocol,
                    seed=seed,
                    ground=SURFACE,
                    host=None,
                    datagrams=cable,
                    depth=depth,
                    conditions=conditions,
                    firmware=firmware,
                    autopilot=autopilot,
                )
            )
            if guided and autopilot is None:
                self.standin.ardusub.fix = True
            self._camera = Camera.from_fov(width, width * 3 // 4, self.protocol.camera.horizontal_fov)
            clock.start(self._swim, "water")
            self.devices = stack.enter_context(
                Devices(
                    Addresses(cable, lambda: self.standin.a50.attach(clock), Frames(self._frames)),
                    Instruments(),
                    folder,
                    epoch_ns=EPOCH_NS,
                    surface_pressure=AIR_PRESSURE,
                    threads=clock,
                )
            )
            self._stack = stack.pop_all()
        self.now = self.devices.now
        self.link, self.navigator = self.devices.link, self.devices.navigator
        self.home = WayHome(self.link, self.limits, self.now, threads=clock)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()
        self._swimming = False
        self.clock.sleep(2.0 * BEAT)

    def ready(self) -> None:
        """Connect, set the parameters, and begin the estimate.

        Raises:
            RuntimeError: The estimate cannot begin.
        """
        link = self.link
        self.devices.connect(30.0)
        link.correct(link.check_parameters())
        link.tilt_camera(-self.protocol.camera_pitch)
        not_ready, _ = self.devices.listen(LISTENS, self.start)
        if not_ready:
            raise RuntimeError(not_ready)

    def begin(self) -> Bridge:
        """Arm, and let the bridge beat."""
        link = self.link
        drive = (Guided if self.guided else AltHold)(link, link.joystick(), self.home)
        self.bridge = bridge = Bridge(
            self.navigator,
            drive,
            self.limits,
            self.now,
            said=self._say,
            failing=self.devices.failing,
            sight=lambda fix: self.sight(fix),
            fixed=lambda fix: self.devices.log.tap(fix.time, "estimate", False, fix),
            threads=self.clock,
        )
        link.set_mode("GUIDED" if self.guided else "ALT_HOLD")
        link.arm()
        self._stack.callback(bridge.close)
        bridge.start()
        return bridge

    def after(self, seconds: float, what: Callable[[], object]) -> None:
        """Let something happen in so many seconds."""

        def wait() -> None:
            self.clock.sleep(seconds)
            what()

        self.clock.start(wait, "later")

    def truth(self) -> tuple[SE3, int]:
        """`T_world_base` as it is, and how often the vehicle ran into something."""
        return self.standin.T_world_base, self.standin.tank.collisions

    def tell(self, line: str) -> None:
        """Tell the operator."""
        self.told.append((self.now(), line))

    def _say(self, standing: Standing) -> None:
        self.said.append((self.now(), standing))
        told = {"stance": str(standing.stance), "reason": standing.reason}
        self.devices.log.tap(self.now(), "standing", True, told)

    def _swim(self) -> None:
        beats = 0
        while self._swimming:
            self.standin.beat()
            beats += 1
            self.clock.sleep(beats * BEAT - self.clock())

    def _frames(self, closed: Callable[[], bool]) -> Iterator[tuple[float, Any]]:
        """Arrival and picture, blue first."""
        while self._pictures <= 0.0 and not closed():
            self.clock.sleep(1.0)
        draw = eye(Renderer(self.world), self._camera, self._T_world_camera)
        while not closed():
            picture = self.look(draw())
            if picture is not None:
                yield self.now(), np.ascontiguousarray(picture[..., ::-1])
            self.clock.sleep(1.0 / self._pictures)

    def _T_world_camera(self) -> SE3:
        return self.standin.T_world_base @ self.standin.T_base_camera
