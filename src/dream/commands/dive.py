"""`dream dive`: a mission with a real BlueROV2, or with its stand-in."""

from __future__ import annotations

import contextlib
import datetime
import importlib.util
import logging
import math
import shlex
import shutil
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
import tyro

from dream import __version__
from dream.commands.console import (
    check_max_steps,
    check_writable,
    compiling_told,
    kept_interrupts,
    print_json,
    with_progress,
)
from dream.commands.dive_console import Operator, Reading, Will, console
from dream.commands.run import planner_name
from dream.errors import MissionAborted
from dream.geometry import SE2, SE3, Bounds
from dream.planning import PLANNERS, AnyPlanner
from dream.planning.identity import identity
from dream.protocol import SurveyProtocol, protocol_named
from dream.types import Setpoint
from dream.versions import commit

if TYPE_CHECKING:
    from dream.estimation import Mounting
    from dream.evaluation.metrics import Logbook
    from dream.perception import Perception
    from dream.robots.bluerov2.bridge import Bridge, Limits, Standing
    from dream.robots.bluerov2.check import Finding
    from dream.robots.bluerov2.devices import Devices, LiveEye
    from dream.robots.bluerov2.lens import Lens
    from dream.robots.bluerov2.mavlink import Link
    from dream.robots.bluerov2.navigation import Fix
    from dream.robots.bluerov2.rov import BlueRov2, Manners
    from dream.robots.bluerov2.standin.process import StandInProcess
    from dream.sim.world import World
    from dream.types import Step

    ChosenPlanner = AnyPlanner
else:
    ChosenPlanner = tyro.extras.subcommand_type_from_defaults(PLANNERS, sort_subcommands=False)

logger = logging.getLogger(__name__)

STILL = 4.0
"""Seconds that the sensors are listened to before the dive, with the vehicle lying still."""
HEARTBEAT = 30.0
"""Seconds that the first heartbeat of the vehicle may take."""
LEAVING = 120.0
"""Seconds that the way to the surface may take."""
SHALLOW = 0.4
"""Metres of depth at which a vehicle that surfaces is there: its gauge sits below its top."""
REHEARSED = 12
"""Steps of a simulated mission before the dive."""
SLOWEST_SOUND, FASTEST_SOUND = 1400.0, 1600.0
"""m/s. Fresh water of 0 °C has 1402 (Del Grosso and Mader 1972), sea water of 30 °C 1545 (Mackenzie 1981)."""
LAST_CHECK = ".dream-check"
"""Name of the folder of the last check: made anew each time, so that it is one that nobody else has."""
FIRST_REPORT = 5.0
"""Seconds that the connection to the DVL may take."""
FIRST_FRAME = 15.0
"""Seconds that the first frame of the camera may take."""


@dataclass(frozen=True, slots=True)
class Dive:
    """Fly one mission with a BlueROV2; leave its recording, its log and its report.

    --check only goes through the list before a dive. --stand-in needs no vehicle: it starts programs that
    speak the same protocols, and explores a simulated tank through them.
    """

    planner: ChosenPlanner = PLANNERS["belief"]
    """Who decides."""
    vehicle: str = "udpin:0.0.0.0:14550"
    """MAVLink: udpin:HOST:PORT listens (BlueOS sends to 14550), udpout: and tcp:HOST:PORT go there."""
    dvl: str = "192.168.2.95"
    """HOST or HOST:PORT of the A50."""
    speed_of_sound: float | None = None
    """m/s in this water. The A50 is set to it and keeps it; left as it is, and compared with what --water
    makes likely, unless given."""
    dvl_at: tuple[float, float, float] | None = None
    """Where the A50 sits: metres forward, left and up of the autopilot; -0.15 0 -0.1 unless given."""
    gauge_at: tuple[float, float, float] | None = None
    """Where the pressure sensor sits, likewise; -0.2 0 0 unless given."""
    camera: str = "rtp:5600"
    """rtp:PORT for H.264 over UDP, an rtsp:// address, a video file, or the number of a device."""
    pilot: str | None = None
    """udpin:HOST:PORT, as udpin:127.0.0.1:14551: a ground station that connects there sees the vehicle, and
    its joystick outranks the mission."""
    calibration: Path | None = None
    """OpenCV's YAML of the camera, with `calibrated_in`; needed, but with --stand-in and --check."""
    tilt: float = 20.0
    """Degrees that the camera looks down."""
    camera_at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where its lens sits: metres forward, left and up of the autopilot."""
    lights: float | None = None
    """Brightness, 0 to 1; left as they are unless given."""
    labels: Path | None = None
    """ONNX file that labels pictures; light shells on a dark floor are found without one."""
    depth: Path | None = None
    """ONNX file that estimates depth; without one the floor is taken for flat, at the DVL's altitude."""
    area: tuple[float, float, float, float] | None = None
    """x_min y_min x_max y_max of what to survey, metres in the map. Needed, but with --stand-in."""
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """x, y and heading in degrees where the vehicle lies at the launch, in the map: 0 looks along x."""
    protocol: str = "pool-v1"
    """Survey protocol."""
    drive: Literal["alt-hold", "guided"] = "alt-hold"
    """ALT_HOLD and sticks, which needs no position of the autopilot; or GUIDED and velocities."""
    estimator: Literal["inekf", "ekf", "cipg", "dead-reckoning"] = "inekf"
    """What reckons the pose."""
    max_steps: int | None = None
    """Decisions at most; the protocol's cap unless given."""
    max_depth: float = 10.0
    """Metres."""
    minutes: float = 60.0
    """Of the dive, at most."""
    min_voltage: float = 14.0
    """Volts of the battery, at least."""
    last_resort: Literal["hold", "surface", "disarm"] = "surface"
    """What is done with the vehicle in the end, and when it must not go on."""
    water: Literal["fresh", "sea"] = "fresh"
    """For its density."""
    surface_pressure: float | None = None
    """hPa at the surface; measured where the vehicle lies, unless given: then it has to lie there."""
    set_parameters: bool = False
    """Set those parameters of the vehicle that the list wants otherwise, and put them back at the end."""
    unattended: bool = False
    """Dive without an operator at this terminal."""
    check: bool = False
    """Only go through the list, and say go or no-go."""
    stand_in: bool = False
    """Dive in a simulated tank, through programs that stand in for vehicle, DVL and camera."""
    world: str = "pool/arc"
    """Of the stand-in."""
    seed: int = 1
    """Likewise."""
    live: bool = False
    """Show it in a browser while it dives, at an address that is printed."""
    out: Path = Path("runs")
    """Folder that the dive's own folder is made in."""
    json: bool = False
    """Print the summary, or the list, as one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0; 1 for a no-go; a MissionAborted where the mission did not end by itself."""
        check_max_steps(self.max_steps, protocol_named(self.protocol))
        if self.area is None and not self.stand_in:
            raise ValueError("--area: expected x_min y_min x_max y_max in metres, got none")
        if self.calibration is None and not (self.stand_in or self.check):
            raise ValueError(
                "--calibration: expected OpenCV's YAML of the camera, got none. See docs/bluerov2.md"
            )
        if self.speed_of_sound is not None and not SLOWEST_SOUND <= self.speed_of_sound <= FASTEST_SOUND:
            raise ValueError(
                f"--speed-of-sound: expected {SLOWEST_SOUND:g} to {FASTEST_SOUND:g} m/s, "
                f"got {self.speed_of_sound:g}"
            )
        if self.pilot is not None and self.drive == "guided":
            raise ValueError("--pilot: expected --drive alt-hold, got guided, in which sticks do not move it")
        if not (
            self.unattended or self.stand_in or self.check or (sys.stdin.isatty() and sys.stderr.isatty())
        ):
            raise ValueError(
                "dive: expected an operator at a terminal, got none. Say --unattended to dive without one"
            )
        if self.live:
            from dream.live.beside import check_installed

            check_installed()
        _check_extra()
        _check_options(self)
        if self.area is not None:
            _limits_told(self, Bounds(*self.area))
        # A file that cannot be read is told at a desk too, where no vehicle answers.
        sight = _sight_told(self)
        with contextlib.ExitStack() as shown:
            return self._dive(sight, shown)

    def _dive(self, sight: _Sight, shown: contextlib.ExitStack) -> int:
        """The same; a page that stays until it is closed is left to `shown`: the vehicle waits for none."""
        from dream import recording

        protocol = protocol_named(self.protocol)
        name = planner_name(self.planner)
        with contextlib.ExitStack() as stack:
            stack.enter_context(compiling_told())
            stack.enter_context(_outlives_its_terminal())
            interrupted = stack.enter_context(kept_interrupts())
            if not self.check:
                _rehearse(protocol, self.estimator)
                interrupted()
            begun = datetime.datetime.now(datetime.UTC)
            tank = _Tank(self.world, self.seed, self.drive) if self.stand_in else None
            where = "dive" if tank is None else tank.world.name
            if self.check:
                # What was heard is kept, but nothing is flown: it is no run, and the last check is enough.
                check_writable(self.out)
                folder = self.out / LAST_CHECK
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir(exist_ok=True)
            else:
                folder = recording.new_run_folder(self.out, where, self.seed, name, begun)
            if self.live and not self.check:
                from dream.live.beside import shown_live

                shown.enter_context(shown_live(folder))
            if tank is not None:
                stack.enter_context(tank)
            # The log is whole once the devices are closed.
            stack.callback(draw_flown, folder, quiet=self.json)
            dive = stack.enter_context(_opened(self, protocol, folder, begun, tank, sight))
            _tell(f"listening to the sensors for {STILL:g} s: the vehicle has to lie still", quiet=self.json)
            found = dive.listen()
            interrupted()
            ready = all(finding.ok for finding in found)
            if self.check or not ready:
                return _print_findings(found, ready, as_json=self.json)
            return dive.fly(name, interrupted)


def _check_extra() -> None:
    missing = [name for name in ("pymavlink", "cv2", "rosbags") if importlib.util.find_spec(name) is None]
    if missing:
        raise ValueError(
            f"dive: expected the extra rov, got none ({', '.join(missing)}). "
            'Say: pip install "dream-auv[rov]"'
        )


def draw_flown(folder: Path, *, quiet: bool) -> None:
    """Draw what a dive's log tells, beside it. Where nothing was flown, or it cannot be, nothing stays.

    Args:
        folder: Of the run.
        quiet: Do not print where.
    """
    if not (folder / "steps.jsonl").is_file():
        return
    from dream.evaluation.dive_figure import draw_dive

    try:
        paths = draw_dive(folder)
    except (ValueError, OSError, ImportError) as error:
        logger.warning("the dive was not drawn: %s", error)
        return
    if not quiet:
        print(f"  drawn: {paths[0]}")


@dataclass(frozen=True, slots=True)
class _Sight:
    """What pictures are made labels and depth with."""

    lens: Lens | None
    """None where they come without distortion."""
    perception: Perception


def _sight_told(told: Dive) -> _Sight:
    from dream.perception import FlatFloor, LearnedDepth, LearnedLabels, Perception, Shells
    from dream.robots.bluerov2.lens import Lens

    return _Sight(
        None if told.calibration is None else Lens.read(told.calibration),
        Perception(
            Shells() if told.labels is None else LearnedLabels(told.labels),
            FlatFloor() if told.depth is None else LearnedDepth(told.depth),
        ),
    )


def _check_options(told: Dive) -> None:
    from dream.robots.bluerov2.navigation import check_aboard

    places = {"--dvl-at": told.dvl_at, "--gauge-at": told.gauge_at, "--camera-at": told.camera_at}
    for name, place in places.items():
        if place is not None:
            check_aboard(name, place)
    if not -90.0 <= told.tilt <= 90.0:
        raise ValueError(f"--tilt: expected -90 to 90 degrees down, got {told.tilt:g}")
    if told.lights is not None and not 0.0 <= told.lights <= 1.0:
        raise ValueError(f"--lights: expected a share from 0 to 1, got {told.lights:g}")
    if told.stand_in:
        own = ("area", "at", "vehicle", "dvl", "camera", "surface_pressure")
        for given in fields(Dive):
            if given.name in own and getattr(told, given.name) != given.default:
                option = "--" + given.name.replace("_", "-")
                raise ValueError(f"{option}: expected none with --stand-in, which has its own: see --world")
    if told.area is None:
        return
    x, y, _ = told.at
    if not Bounds(*told.area).contains(x, y):
        area = " ".join(f"{side:g}" for side in told.area)
        raise ValueError(f"--at: expected a place inside --area {area}, got {x:g} {y:g}")


def _limits_told(told: Dive, bounds: Bounds) -> Limits:
    """Where and how long the vehicle may be, by the options."""
    from dream.robots.bluerov2.bridge import LastResort, Limits

    options = {"depth": "--max-depth", "minutes": "--minutes", "voltage": "--min-voltage"}
    try:
        return Limits(
            area=bounds,
            depth=told.max_depth,
            minutes=told.minutes,
            voltage=told.min_voltage,
            last_resort=LastResort(told.last_resort),
        )
    except ValueError as error:
        name, _, wrong = str(error).partition(": ")
        raise ValueError(f"{options.get(name, name)}: {wrong}") from error


def _mounting_told(told: Dive) -> Mounting:
    """Where the instruments sit, by the options."""
    from dream.robots.bluerov2.navigation import DVL_AT, GAUGE_AT, mounting_of

    return mounting_of(told.dvl_at or DVL_AT, told.gauge_at or GAUGE_AT)


@contextlib.contextmanager
def _outlives_its_terminal() -> Iterator[None]:
    """A terminal that closes takes the operator with it, and not what has to bring the vehicle up.

    Who asks the program to end has the dive ended in order, as by Ctrl-C.
    """
    if not hasattr(signal, "SIGHUP") or threading.current_thread() is not threading.main_thread():
        yield
        return
    closed = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    ended = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, closed)
        signal.signal(signal.SIGTERM, ended)


def _tell(line: str, *, quiet: bool) -> None:
    if not quiet:
        with contextlib.suppress(OSError):  # The terminal may be gone.
            print(f"dream: {line}", file=sys.stderr)


class _Tank:
    """A simulated tank, in a process of its own once it is entered."""

    def __init__(self, world: str, seed: int, drive: str) -> None:
        from dream.sim.worlds import make_world

        self.world: World = make_world(world, seed)
        self._seed = seed
        self._options = ("--position",) if drive == "guided" else ()
        self.ground = _free_port()
        self.video = _free_port()
        self.process: StandInProcess | None = None

    def __enter__(self) -> Self:
        from dream.robots.bluerov2.standin.process import StandInProcess

        loopback = "127.0.0.1"
        self.process = StandInProcess(
            self.world.name,
            self._seed,
            ground=(loopback, self.ground),
            video=(loopback, self.video),
            options=self._options,
        )
        return self

    def __exit__(self, *_: object) -> None:
        if self.process is not None:
            self.process.close()

    @property
    def running(self) -> StandInProcess:
        assert self.process is not None
        return self.process

    def truth(self) -> tuple[SE3, int]:
        """`T_world_base` as it is, and how often the vehicle ran into something."""
        told = self.running.truth()
        return told.T_world_base, told.collisions


def _free_port() -> int:
    """A UDP port of this computer that nobody uses just now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def _opened(
    told: Dive,
    protocol: SurveyProtocol,
    folder: Path,
    begun: datetime.datetime,
    tank: _Tank | None,
    sight: _Sight,
) -> Iterator[_Ready]:
    """All devices, connected; closed again in the end, and the vehicle's parameters put back."""
    from dream.robots.bluerov2.devices import DENSITY, Addresses, Devices
    from dream.robots.bluerov2.mavlink import Refused
    from dream.robots.bluerov2.navigation import Instruments

    pressure = math.nan if told.surface_pressure is None else told.surface_pressure
    addresses = Addresses(told.vehicle, told.dvl, told.camera, told.pilot)
    if tank is None:
        assert told.area is not None
        bounds, (x, y, heading) = Bounds(*told.area), told.at
        start = SE2(x, y, math.radians(heading))
    else:
        bounds, start = tank.world.bounds, protocol.snap(tank.world.starts[0])
        host, port = tank.running.a50
        pressure = tank.running.surface_pressure
        addresses = Addresses(
            f"udpin:127.0.0.1:{tank.ground}", f"{host}:{port}", f"rtp:127.0.0.1:{tank.video}", told.pilot
        )
    limits = _limits_told(told, bounds)
    with Devices(
        addresses,
        Instruments(told.estimator, _mounting_told(told)),
        folder,
        epoch_ns=round(1e9 * begun.timestamp()),
        density=DENSITY[told.water],
        surface_pressure=pressure,
        sound=told.speed_of_sound,
    ) as devices:
        try:
            devices.connect(HEARTBEAT)
            if told.set_parameters or tank is not None:
                devices.link.correct(devices.link.check_parameters())
            yield _Ready(told, protocol, devices, limits, start, folder, tank, sight)
        except (TimeoutError, Refused) as error:
            raise MissionAborted(f"vehicle: {str(error).removeprefix('vehicle: ')}") from error
        finally:
            # None of a vehicle that is still armed: its failsafes stop it once nobody speaks to it.
            with contextlib.suppress(OSError):
                if left := devices.link.restore().left:
                    _tell(_how_to_restore(len(left), folder), quiet=told.json)


def _how_to_restore(left: int, folder: Path) -> str:
    """What an operator has to do where parameters could not be put back."""
    from dream.robots.bluerov2.devices import PARAMETERS_BEFORE

    of = "1 parameter is" if left == 1 else f"{left} parameters are"
    return (
        f"{of} not as before the dive: their values stand in {folder / PARAMETERS_BEFORE}. Put them back "
        "with a ground station, such as QGroundControl"
    )


@dataclass
class _Ready:
    """A dive whose devices answer."""

    told: Dive
    protocol: SurveyProtocol
    devices: Devices
    limits: Limits
    start: SE2
    folder: Path
    tank: _Tank | None
    sight: _Sight
    last: Step | None = None
    """The last one that was made."""

    def listen(self) -> list[Finding]:
        """The pre-dive list; the camera is pointed before, since its pictures are part of it."""
        link = self.devices.link
        pointed, sounded = self._pointed(link), self._sounded()
        began = time.monotonic()
        while not self.devices.camera.connected and time.monotonic() - began < FIRST_FRAME:
            link.operator_alive()
            time.sleep(0.1)
        found = self.devices.findings(STILL, self.start, self.limits, self.folder)
        return [pointed, *sounded, *found, self._floor(), self._looked()]

    def _floor(self) -> Finding:
        """Whether the dive may go as deep as it has to."""
        from dream.robots.bluerov2.check import Finding
        from dream.robots.bluerov2.navigation import NotReady

        altitude, deepest = self.protocol.altitude, self.limits.depth
        wanted = f"a floor over which {altitude:g} m are at most {deepest:g} m deep: see --max-depth"
        seabed, began = math.nan, time.monotonic()
        try:
            while math.isnan(seabed) and time.monotonic() - began < FIRST_REPORT:
                seabed = self.devices.navigator.update().seabed
                time.sleep(0.05)
        except NotReady:
            return Finding("floor", ok=False, said="not known before navigation begins", wanted=wanted)
        if math.isnan(seabed):
            return Finding("floor", ok=False, said="the DVL does not see it", wanted=wanted)
        deep = -(seabed + altitude)
        said = f"{altitude:g} m above it is {deep:.1f} m deep, {deepest:g} m are allowed"
        return Finding("floor", ok=deep <= deepest, said=said, wanted=wanted)

    def _looked(self) -> Finding:
        """Make of one picture what the map is made from: lens and models fit it, or the dive is none."""
        from dream.robots.bluerov2.check import Finding

        wanted = "a picture that --calibration, --labels and --depth fit"
        if self.sight.lens is None and self.tank is None:
            return Finding("pictures", ok=False, said="no --calibration was given", wanted=wanted)
        try:
            eye, perception = self.eye, self.sight.perception
            picture = self.devices.camera.newest(FIRST_FRAME)
            began, camera = time.perf_counter(), self.protocol.camera
            rgb, seen = eye.view(picture, camera)
            level = SE3.level(self.start.x, self.start.y, 0.0, self.start.yaw)
            perception.perceive(rgb, camera, level, self.mount, self.protocol.altitude)
        except (OSError, ValueError, RuntimeError) as error:
            return Finding("pictures", ok=False, said=str(error), wanted=wanted)
        ms = 1e3 * (time.perf_counter() - began)
        return Finding("pictures", ok=True, said=f"{seen.mean():.0%} of the view, labelled in {ms:.0f} ms")

    @cached_property
    def mount(self) -> SE3:
        """`T_base_camera`."""
        from dream.robots.bluerov2.camera import mounted

        return mounted(math.radians(self.told.tilt), self.told.camera_at)

    @cached_property
    def eye(self) -> LiveEye:
        """The camera, behind its lens. Made once: a lens takes a second to prepare."""
        from dream.robots.bluerov2.devices import LiveEye

        return LiveEye(self.devices.camera, self.sight.lens)

    def _sounded(self) -> list[Finding]:
        """Tell the DVL how fast sound goes, where that was given."""
        from dream.robots.bluerov2.check import Finding

        speed = self.told.speed_of_sound
        if speed is None:
            return []
        try:
            said, ok = f"told {speed:g} m/s, {self.devices.tell_sound(FIRST_REPORT)}", True
        except (ConnectionError, TimeoutError, ValueError) as error:
            said, ok = str(error), False
        return [Finding("sound", ok, said, wanted=f"a DVL that takes {speed:g} m/s for its speed of sound")]

    def _pointed(self, link: Link) -> Finding:
        """Point the camera, and see where it looks, as the map depends on it; and set the lights."""
        from dream.robots.bluerov2.check import Finding
        from dream.robots.bluerov2.mavlink import Refused

        wanted = f"a mount that looks {self.told.tilt:g}° down and says so: see MNT1_* and --tilt"
        try:
            if self.told.lights is not None:
                link.set_lights(self.told.lights)
            up = link.tilt_camera(-math.radians(self.told.tilt))
        except (Refused, RuntimeError, TimeoutError, ValueError) as error:
            return Finding("camera mount", ok=False, said=str(error), wanted=wanted)
        return Finding("camera mount", ok=True, said=f"looks {-math.degrees(up):.0f}° down")

    def fly(self, name: str, interrupted: Callable[[], None]) -> int:
        """Arm, dive, explore, and leave all of it on disk.

        Args:
            name: Of the planner.
            interrupted: Raises the KeyboardInterrupt that compiled code may have swallowed.
        """
        from dream import recording
        from dream.evaluation.metrics import Logbook, Scorer
        from dream.mapping import OccupancyMap
        from dream.mission import explore
        from dream.robots.bluerov2.bridge import LEASE, Bridge
        from dream.robots.bluerov2.drives import AltHold, Guided
        from dream.robots.bluerov2.rov import Sight
        from dream.robots.replay import Keeping

        told, devices, protocol = self.told, self.devices, self.protocol
        began = time.perf_counter()
        recording.write_config(self.folder, self._config(name))
        link = devices.link
        drive = (Guided if told.drive == "guided" else AltHold)(link, link.joystick())
        bridge = Bridge(
            devices.navigator,
            drive,
            self.limits,
            devices.now,
            pilot=devices.station,
            said=self._log_standing,
            fixed=self._log_fix,
            failing=devices.failing,
            sight=Sight(devices.camera),
            aimed=self._log_goal,
        )
        operator = Operator(
            willed=lambda will: self._willed(bridge, will),
            alive=lambda: bridge.renew_operator(LEASE),
        )
        vehicle = self._robot(bridge, operator)
        logbook: Logbook = Logbook(protocol) if self.tank is None else Scorer(self.tank.world, protocol)
        stopped: BaseException | None = None
        try:
            # All that can fail before is done: from here on, whatever comes, the vehicle is brought home.
            if link.busy:
                raise MissionAborted(f"vehicle: {link.busy}")
            link.set_mode("GUIDED" if told.drive == "guided" else "ALT_HOLD")
            link.arm()
            bridge.start()
            title = f"{name} · {self.folder.name}"
            with console(title, lambda: self._readings(bridge), operator) as shown:
                vehicle.go_to(Setpoint(self.start.x, self.start.y, self.start.yaw, protocol.altitude))
                occupancy = OccupancyMap(self.limits.area, protocol)
                robot = Keeping(vehicle, self.folder)
                steps = explore(robot, _in_real_time(told.planner), occupancy, max_steps=told.max_steps)
                recorded = recording.record(
                    self._logged(steps), self.folder, annotate=lambda step: self._annotated(step, logbook)
                )
                with contextlib.closing(recorded):
                    total = told.max_steps or protocol.cap
                    for _ in recorded if shown else with_progress(recorded, name, total):
                        interrupted()
        except (KeyboardInterrupt, Exception) as error:  # noqa: BLE001 - whatever it was, what was flown is kept.
            stopped = error
        finally:
            try:
                bridge.close()
            finally:
                self._leave(link)
        summary = self._summary(name, logbook, bridge, vehicle, time.perf_counter() - began)
        recording.write_summary(self.folder, summary)
        return self._end(summary, stopped)

    def _end(self, summary: Mapping[str, Any], stopped: BaseException | None) -> int:
        """Tell what came of it and leave the page: exit status 0, or a MissionAborted by what stopped it."""
        from dream.report import write_report

        if lost := {name: count for name, count in self.devices.log.lost.items() if count}:
            which = ", ".join(f"{count} of {name}" for name, count in lost.items())
            logger.warning("the log is not whole, messages are lost: %s. Was the disk full?", which)
        what = "interrupted" if isinstance(stopped, KeyboardInterrupt) else str(stopped)
        if stopped is not None and not (self.folder / "steps.jsonl").is_file():
            raise MissionAborted(f"aborted: {what}; no step was made. The log is kept in {self.folder}")
        page = write_report(self.folder)
        if self.told.json:
            print_json(summary)
        else:
            _print_outcome(summary, page)
        if stopped is not None:
            raise MissionAborted(f"aborted: {what}; {summary['steps']} steps are kept in {self.folder}")
        return 0

    def _robot(self, bridge: Bridge, operator: Operator) -> BlueRov2:
        from dream.planning.vlm import Asking
        from dream.protocol import SHOWN
        from dream.robots.bluerov2.rov import BlueRov2

        told = self.told
        return BlueRov2(
            bridge,
            self.devices.navigator,
            self.eye,
            self.sight.perception,
            self.protocol,
            self.devices.now,
            T_base_camera=self.mount,
            fineness=SHOWN if isinstance(told.planner, Asking) else 1,
            manners=_manners(told.planner),
            waits=lambda: operator.will is not Will.GO,
            holds=lambda: operator.will is Will.HOLD,
            truth=None if self.tank is None else self.tank.truth,
        )

    def _willed(self, bridge: Bridge, will: Will) -> None:
        """The operator's word is the last: also where a joystick is broken, or its station gone."""
        station = self.devices.station
        if will in _ENDS:
            if station is not None:
                station.dismiss()
            bridge.end(_ENDS[will])
        elif will is Will.GO and station is not None:
            station.release()

    def _leave(self, link: Link) -> None:
        """Bring the vehicle where the operator wants it in the end; one that is not ours stays.

        One that holds comes up as well when there is water in it, or its battery is low.
        """
        from dream.robots.bluerov2.bridge import SAG
        from dream.robots.bluerov2.mavlink import Refused

        if not link.engaged or link.yielding:
            return
        how, station = self.told.last_resort, self.devices.station
        try:
            while station is not None and station.has:
                # A person at the sticks brings it home.
                link.operator_alive()
                time.sleep(0.1)
            if how == "hold":
                _tell("it holds its depth: take the sticks, or end with Ctrl-C", quiet=self.told.json)
            elif how == "surface":
                link.set_mode("SURFACE")
                _tell("it comes to the surface", quiet=self.told.json)
            fed = self.devices.now()
            until = fed + (LEAVING if how == "surface" else math.inf)
            while how != "disarm" and link.engaged and not link.yielding and self.devices.now() < until:
                said = link.telemetry
                # By its own reckoning, where it tells: a dive may have begun under water.
                depth = -said.own_altitude if math.isfinite(said.own_altitude) else said.depth
                if how == "surface" and depth < SHALLOW:
                    break
                if not said.voltage < self.limits.voltage:
                    fed = self.devices.now()
                low = self.devices.now() - fed > SAG
                if how == "hold" and (said.leak or low):
                    why = "water in the hull" if said.leak else f"battery at {said.voltage:.1f} V"
                    logger.warning("%s: it does not hold any longer, but comes to the surface", why)
                    link.set_mode("SURFACE")
                    how, until = "surface", self.devices.now() + LEAVING
                link.operator_alive()
                time.sleep(0.1)
            if link.engaged and not link.yielding:
                link.disarm()
        except (KeyboardInterrupt, TimeoutError, Refused, OSError) as error:
            logger.warning("the vehicle was left as it is: %s", str(error) or "interrupted")

    def _logged(self, steps: Iterator[Step]) -> Iterator[Step]:
        """Tell the log of each decision."""
        for step in steps:
            self.last, decision = step, step.decision
            told = {
                "step": step.index,
                "turn": decision.turn,
                "advance": decision.advance,
                "done": decision.done,
                "note": step.guarded.note,
                "reasoning": asdict(decision.reasoning),
                "arrival": step.arrival.note,
            }
            self.devices.log.tap(self.devices.now(), "decision", True, told)
            yield step

    def _annotated(self, step: Step, logbook: Logbook) -> Mapping[str, Any]:
        from dream.evaluation.metrics import Scorer

        if isinstance(logbook, Scorer):
            return {"coverage": logbook.add(step).as_dict()}
        logbook.note(step)
        return {}

    def _log_standing(self, standing: Standing) -> None:
        self.devices.log.tap(
            self.devices.now(), "standing", True, {"stance": str(standing.stance), "reason": standing.reason}
        )
        if standing.reason:
            logger.warning("%s: %s", standing.stance, standing.reason)

    def _log_goal(self, goal: SE2, altitude: float) -> None:
        told = {"x": goal.x, "y": goal.y, "yaw": goal.yaw, "altitude": altitude}
        self.devices.log.tap(self.devices.now(), "goal", True, told)

    def _log_fix(self, fix: Fix) -> None:
        self.devices.log.tap(fix.time, "estimate", False, fix)

    def _readings(self, bridge: Bridge) -> list[Reading]:
        """What the operator's console shows."""
        devices, standing, fix = self.devices, bridge.standing, bridge.fix
        said, pose, goal = devices.link.telemetry, bridge.fix.T_world_base.se2, bridge.goal
        here = f"{pose.x:+.2f} {pose.y:+.2f} m, heading {math.degrees(pose.yaw):+.0f}°"
        there = "none" if goal is None else f"{goal.x:+.2f} {goal.y:+.2f} m, {math.degrees(goal.yaw):+.0f}°"
        ages = (
            f"IMU {fix.imu_age:.2f}, depth {fix.depth_age:.2f}, DVL {fix.dvl_age:.2f}, "
            f"camera {devices.camera.age:.2f} s"
        )
        station = devices.station
        return [
            Reading(
                "it",
                f"{standing.stance}: {standing.reason}" if standing.reason else str(standing.stance),
                not standing.reason,
            ),
            Reading("step", "none yet" if self.last is None else self._step_line(self.last)),
            Reading("vehicle", f"{said.mode}, {'armed' if said.armed else 'disarmed'}", said.armed),
            *([] if station is None else [Reading("pilot", station.words, not station.gone)]),
            Reading("is at", f"{here} ± {fix.position_sigma:.2f} m"),
            Reading("goes to", there),
            Reading("depth", f"{said.depth:.2f} m, {fix.altitude:.2f} m above the floor"),
            Reading("battery", f"{said.voltage:.1f} V", not said.voltage < self.limits.voltage + 0.3),
            Reading("ages", ages, max(fix.imu_age, fix.dvl_age - 0.8, devices.camera.age - 0.8) < 0.2),
            Reading("camera", devices.camera.problem or "well", devices.camera.connected),
            Reading("DVL", devices.dvl.problem or "well", not devices.dvl.problem),
            Reading("log", devices.log.problem or f"{devices.log.written} messages", not devices.log.problem),
        ]

    def _step_line(self, step: Step) -> str:
        total = self.told.max_steps or self.protocol.cap
        return f"{step.index} of {total} at most. {step.decision.reasoning.action}"

    def _config(self, name: str) -> dict[str, Any]:
        """`config.json`: what the dive was begun with."""
        told = asdict(replace(self.told, planner=PLANNERS["belief"]))
        del told["planner"]
        mounting = _mounting_told(self.told)
        return {
            "version": __version__,
            "commit": commit(),
            "protocol": self.protocol.name,
            "world": "dive" if self.tank is None else self.tank.world.name,
            "seed": self.told.seed,
            **identity(name, self.told.planner),
            "max_steps": self.told.max_steps,
            "command": repeating_command(self.told, name),
            "began": datetime.datetime.fromtimestamp(self.devices.log.epoch_ns / 1e9, datetime.UTC),
            "mounting": {
                "dvl": np.asarray(mounting.T_base_dvl.translation).tolist(),
                "gauge": list(mounting.pressure_sensor),
                "camera": np.asarray(self.mount.translation).tolist(),
            },
            "dive": {key: str(value) if isinstance(value, Path) else value for key, value in told.items()},
        }

    def _summary(
        self, name: str, logbook: Logbook, bridge: Bridge, robot: BlueRov2, wall_s: float
    ) -> dict[str, Any]:
        """`summary.json`: of the mission, and of the devices."""
        from dream.sim.files import world_hash

        devices = self.devices
        lags = [1e3 * lag for lag in bridge.lags] or [0.0]
        ages = [1e3 * age for age in robot.picture_ages] or [0.0]
        counts, seconds = devices.camera.counts, devices.now()
        tank = self.tank
        return {
            "protocol": self.protocol.name,
            "world": "dive" if tank is None else tank.world.name,
            "seed": self.told.seed,
            "world_hash": "" if tank is None else world_hash(tank.world),
            "planner": name,
            **logbook.summary(),
            # Nobody feels a touch but a simulator.
            **({"collisions": None} if tank is None else {}),
            "wall_s": round(wall_s, 3),
            "dive": {
                "estimator": self.told.estimator,
                "drive": self.told.drive,
                "command_lag_ms": {f"p{p}": round(float(np.percentile(lags, p)), 1) for p in (50, 99)},
                "late_beats": bridge.late_beats,
                "picture_age_ms": {f"p{p}": round(float(np.percentile(ages, p)), 1) for p in (50, 99)},
                "pictures": counts.received,
                "pictures_per_s": round(counts.received / seconds, 2),
                "packets_lost": counts.lost,
                "link_loss": round(devices.link.telemetry.loss, 4),
                "refused": {**devices.link.refused, **devices.dvl.refused, **devices.navigator.refused},
                "pilot_refused": None if devices.station is None else dict(devices.station.refused),
                "log_lost": devices.log.lost,
                "behind_s": None if tank is None else round(tank.running.truth().behind, 3),
            },
        }


def repeating_command(told: Dive, name: str) -> str:
    """The command line that dives so again; options at their defaults are left out."""
    words = ["dream", "dive", name]
    for owner, default in ((told.planner, PLANNERS[name]), (told, Dive())):
        for field in fields(owner):
            value = getattr(owner, field.name)
            if field.name in ("planner", "out", "json", "live") or value == getattr(default, field.name):
                continue
            words.append("--" + field.name.replace("_", "-"))
            if value is not True:
                words += [f"{one:g}" for one in value] if isinstance(value, tuple) else [str(value)]
    return shlex.join(words)


def _manners(planner: AnyPlanner) -> Manners:
    """How long a planner may think: one that asks a model, for as long as it waits for an answer."""
    from dream.planning.vlm import Asking
    from dream.robots.bluerov2.rov import Manners

    thinking = Manners().thinking
    return Manners(thinking=planner.timeout + thinking) if isinstance(planner, Asking) else Manners()


def _in_real_time(planner: AnyPlanner) -> AnyPlanner:
    """A planner that asks a model, with no time to be waited for an answer but that which it takes."""
    from dream.planning.vlm import Asking

    return replace(planner, latency=None) if isinstance(planner, Asking) else planner


def _rehearse(protocol: SurveyProtocol, estimator: str) -> None:
    """Explore a simulated place for some steps, and steer: what is compiled now stops nothing under water."""
    from dream.evaluation.runner import simulate
    from dream.planning.belief import Belief
    from dream.robots.bluerov2.drives import rehearse
    from dream.sim.worlds import make_world

    world = make_world("pool/arc" if protocol.traversal is not None else "reef/patch", 1)
    for _ in simulate(world, Belief(), protocol, max_steps=REHEARSED):
        pass
    rehearse(estimator)


_ENDS = {Will.END: "ended by the operator", Will.SURFACE: "the operator wants it at the surface"}


def _print_findings(found: list[Finding], ready: bool, *, as_json: bool) -> int:
    """The pre-dive list; returns the exit status."""
    if as_json:
        print_json({"go": ready, "findings": [asdict(finding) for finding in found]})
        return 0 if ready else 1
    width = max(len(finding.name) for finding in found)
    for finding in found:
        mark = "ok" if finding.ok else "NO"
        wanted = "" if finding.ok else f"   wanted: {finding.wanted}"
        print(f"  {mark}  {finding.name:<{width}}  {finding.said}{wanted}")
    wrong = sum(not finding.ok for finding in found)
    print("go" if ready else f"no-go: {wrong} of {len(found)} are not well")
    return 0 if ready else 1


def _print_outcome(summary: Mapping[str, Any], page: Path) -> None:
    ended = {"done": "done", "cap": "out of steps", "aborted": "aborted"}[summary["ended"]]
    print(f"{summary['world']} {summary['seed']} · {summary['planner']} · {summary['protocol']}")
    print(f"  {ended} after {summary['steps']} steps and {summary['distance_m']:.1f} m")
    if summary["coverage"]["instances"] is not None:
        error = summary["position_error_m"]
        print(
            f"  traversed {summary['coverage']['instances']:.1%} of the targets, {summary['collisions']} "
            f"collisions; {error['rmse']:.3f} m (rms) from where it believed to be"
        )
    dive = summary["dive"]
    print(
        f"  {dive['pictures_per_s']:.1f} pictures a second; from goal to command "
        f"{dive['command_lag_ms']['p50']:.0f} ms, at most {dive['command_lag_ms']['p99']:.0f} ms in 99 of 100"
    )
    print(f"  report: {page}")
