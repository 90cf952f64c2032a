"""All that DREAM talks to during a dive, opened together and closed in order."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from dream.geometry import SE2, Camera, FloatArray
from dream.measurements import Imu, Measurement
from dream.perception import beam_ends
from dream.robots.bluerov2.camera import (
    LiveCamera,
    RtpVideo,
    RtspVideo,
    Source,
    VideoDevice,
    VideoFile,
    opencv,
)
from dream.robots.bluerov2.check import Finding, Seen, findings
from dream.robots.bluerov2.dvl_a50 import PORT, DvlA50, Stream, sound_in
from dream.robots.bluerov2.lens import Lens, Rectifier
from dream.robots.bluerov2.limits import Limits
from dream.robots.bluerov2.log import DiveLog
from dream.robots.bluerov2.mavlink import Link
from dream.robots.bluerov2.navigation import Instruments, Navigator, NotReady, State
from dream.robots.bluerov2.reports import FRESH, SEA
from dream.robots.bluerov2.rov import Picture
from dream.robots.bluerov2.station import Door, Station
from dream.robots.bluerov2.threads import REAL_TIME, Threads
from dream.robots.bluerov2.wire import Pipe
from dream.types import BoolArray, UInt8Array

EVEN = 1.1
"""How many times as long as the shortest of the DVL's beams the others may be on even ground."""
PARAMETERS_BEFORE = "parameters-before.json"
"""In the folder of the run: what the vehicle had before DREAM changed it."""
DENSITY = {"fresh": FRESH, "sea": SEA}
"""kg/m³."""


@dataclass(frozen=True, slots=True)
class Addresses:
    """Where the devices are."""

    vehicle: str | Pipe
    """MAVLink, see `mavlink.Link`."""
    dvl: str | Callable[[], Stream]
    """HOST or HOST:PORT, or what dials it."""
    camera: str | Source
    """rtp:PORT, rtp:HOST:PORT, an rtsp:// address, a file, or the number of a device."""
    pilot: str | Door | None = None
    """udpin:HOST:PORT, where a ground station with a joystick may come; None for nowhere."""


def source_of(camera: str) -> Source:
    """A camera's source by its address.

    Raises:
        ValueError: It is none of those.
    """
    kind, _, rest = camera.partition(":")
    if kind == "rtp":
        host, _, port = rest.rpartition(":")
        if not port.isdigit():
            raise ValueError(f"--camera: expected rtp:PORT or rtp:HOST:PORT, got {camera}")
        # A vehicle sends to the address of its tether: any of this computer's will do.
        return RtpVideo(host=host or "0.0.0.0", port=int(port))
    if kind in ("rtsp", "rtsps"):
        return RtspVideo(camera)
    if camera.isdigit():
        return VideoDevice(int(camera))
    if not Path(camera).is_file():
        raise ValueError(
            f"--camera: expected rtp:PORT, an rtsp:// address, a file or a number, got {camera}, "
            "where there is no file"
        )
    return VideoFile(Path(camera))


def dvl_at(address: str) -> tuple[str, int]:
    """Host and port of a DVL by its address.

    Raises:
        ValueError: It is neither HOST nor HOST:PORT.
    """
    host, colon, port = address.rpartition(":") if ":" in address else (address, "", "")
    if not host or (colon and not (port.isdecimal() and 1 <= int(port) <= 65535)):
        raise ValueError(
            f"--dvl: expected HOST or HOST:PORT with a port of 1 to 65535, got {address}. An A50's is {PORT}"
        )
    return host, int(port) if colon else PORT


class Devices:
    """Vehicle, DVL, camera, estimate and log of one dive.

    What it does: every measurement goes to the navigator and to the log, every packet, line and picture to
    the log. `listen` collects what the sensors say while the vehicle lies still, which is what the pre-dive
    list and the estimate begin with.

    Assumes: handlers of logging that do not wait. The threads that steer the vehicle and speak to it log
    under `dream.robots.bluerov2`, and one that waits for a terminal or a disk keeps the vehicle waiting.
    `dream dive` sees to its own; any other program puts Python's `QueueHandler` before such a handler.
    """

    def __init__(
        self,
        addresses: Addresses,
        instruments: Instruments,
        folder: Path,
        *,
        epoch_ns: int,
        density: float = DENSITY["fresh"],
        surface_pressure: float = math.nan,
        sound: float | None = None,
        threads: Threads = REAL_TIME,
    ) -> None:
        """Open all of it. The dive's clock begins.

        Args:
            addresses: Where the devices are.
            instruments: Which estimator reads which instruments.
            folder: Of the run, that the log goes to.
            epoch_ns: UTC of now, nanoseconds since 1970.
            density: kg/m³ of the water.
            surface_pressure: hPa at the surface; NaN where it has to be measured.
            sound: m/s at which sound goes in this water; by its density where None.
            threads: What all of it waits by.

        Raises:
            ValueError: An address is none.
            OSError: The log cannot be written, or a port is taken.
        """
        self.threads = threads
        began = threads.monotonic()
        self.now: Callable[[], float] = lambda: threads.monotonic() - began
        self._density, self._sound = density, sound
        self._heard: list[Imu | Measurement] = []
        self._listening = threads.event()
        self.station: Station | None = None
        source = source_of(addresses.camera) if isinstance(addresses.camera, str) else addresses.camera
        dial = None if isinstance(addresses.dvl, str) else addresses.dvl
        host, port = dvl_at(addresses.dvl) if isinstance(addresses.dvl, str) else ("aboard", PORT)
        with ExitStack() as stack:
            self.log = stack.enter_context(DiveLog(folder, epoch_ns=epoch_ns))
            mounting = self._mounting = instruments.mounting
            seats = {
                "dvl": np.asarray(mounting.T_base_dvl.translation).tolist(),
                "gauge": list(mounting.pressure_sensor),
            }
            self.log.tap(self.now(), "mounting", False, seats)
            # As the estimator was given them: a replay of the log makes the same estimate.
            self.navigator = Navigator(
                instruments,
                self.now,
                took=lambda message: self.log.tap(self.now(), "measurement", False, message),
                began=lambda state: self.log.tap(state.time, "begun", False, _plain(state)),
            )
            self.link = Link(
                addresses.vehicle,
                now=self.now,
                deliver=self._deliver,
                tap=self._heard_of,
                density=density,
                surface_pressure=surface_pressure,
                keep=folder / PARAMETERS_BEFORE,
                threads=threads,
            )
            stack.enter_context(self.link)
            if addresses.pilot is not None:
                station = Station(addresses.pilot, self.link, now=self.now, tap=self.log.tap, threads=threads)
                self.station = stack.enter_context(station)
            self.camera = stack.enter_context(LiveCamera(source, self.now, self.log.tap, threads=threads))
            self.dvl = stack.enter_context(
                DvlA50(
                    host,
                    port,
                    now=self.now,
                    deliver=self._deliver,
                    tap=self.log.tap,
                    threads=threads,
                    dial=dial,
                )
            )
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def connect(self, timeout: float = 30.0) -> None:
        """Find the vehicle, and have it send what is needed.

        Raises:
            TimeoutError: It does not answer.
            Refused: It does not send something that is needed.
        """
        self.link.operator_alive()
        self.link.connect(timeout)
        if self.station is not None:
            self.station.learn_buttons()

    def failing(self) -> str:
        """Which device says that it will fail soon, or is set to something else than before the dive, in
        words; empty where none does.
        """
        return self.dvl.problem if self.dvl.hot else self.dvl.misread

    def tell_sound(self, timeout: float) -> str:
        """Tell the DVL how fast sound goes, where that was given; what it had before, in words.

        Raises:
            ConnectionError: There is no connection to it.
            TimeoutError: It does not answer.
            ValueError: It refuses, or does not do as told.
        """
        if self._sound is None:
            raise ValueError("sound: expected m/s to be given, got none")
        began = self.now()
        while self.dvl.config is None and self.now() - began < timeout:
            self.link.operator_alive()
            self.threads.sleep(0.1)
        before = None if self.dvl.config is None else self.dvl.config.speed_of_sound
        if before != self._sound:
            self.dvl.set_config(speed_of_sound=self._sound)
        after = None if self.dvl.config is None else self.dvl.config.speed_of_sound
        if after != self._sound:
            raise ValueError(f"speed_of_sound: expected {self._sound:g} m/s of the DVL, got {after}")
        return "as before" if before == after else f"it had {'none' if before is None else f'{before:g}'}"

    def zero_depth(self) -> None:
        """Take the pressure of now for that at the surface, unless it was given.

        Raises:
            NotReady: There are too few readings, or they differ.
        """
        if math.isnan(self.link.telemetry.depth):
            try:
                self.link.zero_depth()
            except RuntimeError as error:
                raise NotReady(str(error)) from error

    def listen(self, seconds: float, start: SE2) -> tuple[str, Seen]:
        """Hear what the sensors say of a vehicle that lies still, and begin the estimate there.

        Args:
            seconds: How long.
            start: Where it lies in the map.

        Returns:
            Why the estimate cannot begin, empty where it can; and what the camera gave meanwhile.
        """
        self._heard = []
        before, began = self.camera.counts.received, self.now()
        self._listening.set()
        while self.now() - began < seconds:
            self.link.operator_alive()
            self.threads.sleep(0.05)
        self._listening.clear()
        seen = Seen(
            self.camera.counts.received - before, self.now() - began, self.camera.age, self.camera.problem
        )
        try:
            self.navigator.align(start, self._heard)
        except NotReady as not_ready:
            return str(not_ready), seen
        return "", seen

    def findings(self, seconds: float, start: SE2, limits: Limits, folder: Path) -> list[Finding]:
        """Go through the pre-dive list; the estimate has begun where it says so."""
        unzeroed, zeroed_here = "", math.isnan(self.link.telemetry.depth)
        try:
            self.zero_depth()
        except NotReady as not_ready:
            unzeroed = str(not_ready)
        aligned, seen = self.listen(seconds, start)
        aligned, link = unzeroed or aligned, self.link
        sound = sound_in(self._density) if self._sound is None else (self._sound, self._sound)
        checks = link.check_parameters()
        return findings(
            link.telemetry,
            link.busy,
            checks,
            self.dvl,
            seen,
            aligned,
            limits,
            folder,
            sound,
            zeroed_here=zeroed_here,
        )

    @property
    def beams(self) -> FloatArray | None:
        """(4, 3) metres in `base`: where the DVL's beams ended just now; None where that is not known.

        Which of them looks where its reports do not tell: they have to agree, as on even ground.
        """
        ranges = self.dvl.ranges
        if ranges is None or not float(ranges.max()) <= EVEN * float(ranges.min()):
            return None
        return beam_ends(ranges, self._mounting.T_base_dvl)

    def _heard_of(self, time: float, channel: str, sent: bool, message: Any) -> None:
        self.log.tap(time, channel, sent, message)
        if self.station is not None and not sent:
            self.station.forward(message)

    def _deliver(self, message: Imu | Measurement) -> None:
        if self._listening.is_set():
            self._heard.append(message)
        self.navigator.deliver(message)


def _plain(state: State) -> dict[str, object]:
    """All fields of an estimator's state, that the log may hold it to the last bit."""
    fields = {field.name: getattr(state, field.name) for field in dataclasses.fields(state)}  # type: ignore[arg-type]
    return {name: value for name, value in fields.items() if name != "outcome"}


@dataclass(slots=True)
class LiveEye:
    """The live camera as the robot asks for it."""

    camera: LiveCamera
    lens: Lens | None = None
    """Of the camera; None where its pictures are those of the pinhole already."""
    latency: float = 0.25
    """Seconds that a picture may be older than it seems: what is taken for one after a move has to be."""
    _rectifiers: dict[tuple[int, int, int], Rectifier] = field(default_factory=dict)

    def newest(self, after: float, timeout: float) -> Picture | None:
        """The first picture that was seen after a time; None where none comes."""
        try:
            return self.camera.after(after + self.latency, timeout + self.latency)
        except TimeoutError:
            return None

    def view(self, picture: Picture, camera: Camera) -> tuple[UInt8Array, BoolArray]:
        """The picture as that camera would have taken it, and which of its pixels the lens saw."""
        cv2, rgb = opencv(), picture.rgb
        if self.lens is not None:
            height, width = rgb.shape[:2]
            key = (height, width, camera.width)
            if key not in self._rectifiers:
                self._rectifiers[key] = Rectifier(self.lens.at(width, height), camera)
            rectifier = self._rectifiers[key]
            return rectifier.rectified(rgb), rectifier.seen
        if rgb.shape[:2] != (camera.height, camera.width):
            how = cv2.INTER_AREA if rgb.shape[1] > camera.width else cv2.INTER_CUBIC
            rgb = np.asarray(cv2.resize(rgb, (camera.width, camera.height), interpolation=how), np.uint8)
        return rgb, np.ones((camera.height, camera.width), np.bool_)
