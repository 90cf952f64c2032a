"""`dream dive`: a mission with a real BlueROV2, or with its stand-in."""

from __future__ import annotations

import contextlib
import datetime
import logging
import shutil
import signal
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from dream import extras
from dream.commands.console import check_max_steps, check_writable, compiling_told, kept_interrupts
from dream.commands.dive.console import tell
from dream.commands.dive.flight import Flight
from dream.commands.dive.options import Sight, check_options, limits_told, sight_told, waters_told
from dream.commands.dive.predive import STILL, predive_list, print_findings
from dream.commands.dive.ready import Ready, opened
from dream.commands.dive.tank import Tank, rehearse_mission, rehearse_return
from dream.commands.dive.terminal import Terminal
from dream.commands.ground import Ground
from dream.commands.homing import Homing
from dream.commands.progress import stage
from dream.ending import asked_to_end
from dream.geometry import Bounds
from dream.options import First
from dream.planning import PLANNERS, AnyPlanner, check_installed, planner_name
from dream.protocol import protocol_named

if TYPE_CHECKING:
    from dream.commands.ground import Known
    from dream.protocol import SurveyProtocol
    from dream.survey.site import Site

    ChosenPlanner = AnyPlanner
else:
    ChosenPlanner = tyro.extras.subcommand_type_from_defaults(PLANNERS, sort_subcommands=False)

logger = logging.getLogger(__name__)

LAST_CHECK = ".dream-check"
"""Name of the folder of the last check: made anew each time, so that it is one that nobody else has."""
PRESSED = 2.0
"""Seconds in which Ctrl-C pressed again is the same: who sees nothing happen presses it several times."""
SEEN = 0.5
"""Seconds since the terminal took something, within which a second Ctrl-C is obeyed: only who is told that
the vehicle comes up can want that it does not."""


@dataclass(frozen=True, slots=True)
class Dive:
    """Fly one mission with a BlueROV2, or with its stand-in in a simulated tank.

    The folder of the dive keeps its recording, its log and its report.

    --check goes through the list before a dive, and ends there. --stand-in needs no vehicle: it starts
    programs that speak the same protocols, and explores a simulated tank through them.

    Examples:
        dream dive --stand-in
        dream dive --check --area 0 0 8 5
        dream dive --calibration camera.yaml --area 0 0 8 5 --at 1 1 0
    """

    planner: ChosenPlanner = PLANNERS["belief"]
    """Who decides."""
    vehicle: First[Annotated[str, tyro.conf.arg(metavar="ADDRESS")]] = "udpin:0.0.0.0:14550"
    """MAVLink: udpin:HOST:PORT listens, as BlueOS wants it; udpout: and tcp: connect."""
    dvl: Annotated[str, tyro.conf.arg(metavar="HOST[:PORT]")] = "192.168.2.95"
    """Address of the DVL A50."""
    speed_of_sound: float | None = None
    """Speed of sound in this water, m/s. The A50 is set to it, and keeps it. Unless given, the A50 stays
    as it is, and the list compares it with what --water makes likely."""
    dvl_at: tuple[float, float, float] | None = None
    """Where the A50 sits: metres forward, left and up of the autopilot. Unless given, -0.15 0 -0.1."""
    gauge_at: tuple[float, float, float] | None = None
    """Where the pressure gauge sits: metres forward, left and up of the autopilot. Unless given, -0.2 0 0."""
    camera: First[Annotated[str, tyro.conf.arg(metavar="SOURCE")]] = "rtp:5600"
    """rtp:PORT for H.264 over UDP, an rtsp:// address, a video file, or the number of a device."""
    pilot: str | None = None
    """Address at which a ground station may connect, such as udpin:127.0.0.1:14551. It sees the vehicle, and
    its joystick outranks the mission."""
    calibration: First[Path | None] = None
    """Lens file of the camera: OpenCV's YAML with `calibrated_in`. Not needed with --stand-in or --check."""
    tilt: float = 20.0
    """Degrees that the camera looks down."""
    camera_at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the camera's lens sits: metres forward, left and up of the autopilot."""
    lights: float | None = None
    """Brightness of the lights, 0 to 1. Unless given, they stay as they are."""
    see: First[Annotated[str | None, tyro.conf.arg(metavar="HOW")]] = None
    """How pictures become labels and depth: `learned`; `shells`, as in a tank; or a network's FILE.onnx."""
    labels: Path | None = None
    """ONNX file of a network that labels pictures, such as one of `dream teach`; what it knows nothing of is
    labelled by --see."""
    depth: Path | None = None
    """ONNX file of a network that estimates depth, in the place of that of --see."""
    area: First[Annotated[tuple[float, float, float, float] | None, tyro.conf.arg(metavar="X Y X Y")]] = None
    """Area to survey: least x and y, largest x and y, metres in the map. Not needed with --stand-in."""
    at: First[Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y DEGREES")]] = (0.0, 0.0, 0.0)
    """Where the vehicle lies at the launch, metres in the map, and its heading: 0 along x, 90 along y."""
    protocol: str = "pool-v1"
    """Rules of the survey: sensors, reach and cap."""
    drive: Literal["alt-hold", "guided"] = "alt-hold"
    """How the vehicle is driven: alt-hold by sticks in ALT_HOLD, which needs no position of the autopilot;
    guided by velocities in GUIDED."""
    estimator: Literal["inekf", "ekf", "cipg", "dead-reckoning"] = "inekf"
    """Filter that estimates the pose."""
    max_steps: int | None = None
    """Steps at most, that is decisions carried out. Unless given, the cap of the protocol."""
    max_depth: float = 10.0
    """Depth at most, metres."""
    minutes: float = 60.0
    """Length of the dive at most, minutes. A mission that goes home is there before; any other ends where it
    is, and the vehicle comes up there."""
    min_voltage: float = 14.0
    """Voltage of the battery at least, volts. Below it the vehicle comes up where it is; from 0.4 V above it
    on downwards the mission goes home."""
    min_altitude: float = 0.2
    """Height of the A50 above the floor at least, metres."""
    last_resort: Literal["hold", "surface", "disarm"] = "surface"
    """What the vehicle does at the end, and when it must not go on."""
    water: Literal["fresh", "sea"] = "fresh"
    """Kind of water, for its density."""
    surface_pressure: float | None = None
    """Air pressure at the surface, hPa. Unless given, it is measured: the vehicle has to lie there."""
    set_parameters: bool = False
    """Set the parameters of the vehicle that the list wants otherwise, and put them back at the end."""
    unattended: bool = False
    """Dive without an operator at this terminal."""
    check: First[bool] = False
    """Go through the list before a dive, and say go or no-go."""
    stand_in: First[bool] = False
    """Dive in a simulated tank, through programs that stand in for vehicle, DVL and camera."""
    world: Annotated[str, tyro.conf.arg(metavar="WORLD")] = "pool/arc"
    """World of the stand-in: a name from `dream worlds`, or the folder of a saved world."""
    seed: int = 1
    """Which world of that name."""
    live: First[bool] = False
    """Show the dive in a browser, at an address that is printed."""
    out: Path = Path("runs")
    """Folder in which the dive's own folder is made."""
    json: bool = False
    """Print the summary, or the list, as one JSON object and nothing else."""
    ground: Ground = field(default_factory=Ground)
    homing: Homing = field(default_factory=Homing)

    def __call__(self) -> int:
        """Exit status 0; 1 for a no-go; a MissionAborted where the mission did not end by itself."""
        check_max_steps(self.max_steps, protocol_named(self.protocol))
        if self.area is None and not self.stand_in:
            raise ValueError(
                "--area: expected the least x and y and the largest x and y in metres, got none. "
                "Say --area 0 0 8 5, for a tank of 8 by 5 m; or --stand-in, to dive in a simulated one"
            )
        if self.calibration is None and not (self.stand_in or self.check):
            raise ValueError(
                "--calibration: expected the lens file of the camera, got none. docs/bluerov2.md says how to "
                "make one"
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
            from dream.live import beside

            beside.check_installed()
        check_installed(self.planner)
        extras.check_installed("rov", "dive", "pymavlink", "cv2", "rosbags", "ruamel.yaml")
        check_options(self)
        budget = self.homing.budget()
        if budget is not None and self.area is not None:
            budget.check(Bounds(*self.area), protocol_named(self.protocol))
        if self.area is not None:
            limits_told(self, Bounds(*self.area))
        # A file that cannot be read is told at a desk too, where no vehicle answers.
        sight, site = sight_told(self), self.ground.where()
        with Terminal() as terminal, contextlib.ExitStack() as shown:
            return self._dive(sight, site, shown, terminal)

    def _dive(self, sight: Sight, site: Site | None, shown: contextlib.ExitStack, terminal: Terminal) -> int:
        """The same; a page that stays until it is closed is left to `shown`: the vehicle waits for none."""
        from dream import recording
        from dream.evaluation.runner import check_home

        protocol = protocol_named(self.protocol)
        name = planner_name(self.planner)
        with contextlib.ExitStack() as stack:
            stack.enter_context(compiling_told())
            stack.enter_context(_outlives_its_terminal())
            interrupted = stack.enter_context(
                kept_interrupts(lambda since: since > PRESSED and terminal.idle < SEEN)
            )
            with stage("preparing the dive"):
                tank = Tank(self.world, self.seed, self.drive) if self.stand_in else None
                known = self._known(site, protocol, tank)
                rehearse_mission(protocol, self.estimator)
                if known.prior is not None:
                    rehearse_return()
            interrupted()
            begun = datetime.datetime.now(datetime.UTC)
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
            waters = waters_told(self) if tank is None else tank.waters(protocol, self.pilot)
            limits = limits_told(self, waters.area)
            if (budget := self.homing.budget()) is not None:
                budget.check(waters.area, protocol)
                if tank is not None:
                    check_home(budget, tank.world, protocol)
            devices = stack.enter_context(opened(self, waters, folder, begun))
            ready = Ready(self, protocol, devices, limits, waters.start, folder, tank, sight, known)
            tell(f"listening to the sensors for {STILL:g} s: the vehicle has to lie still", quiet=self.json)
            with stage("looking the vehicle over"):
                found = predive_list(ready)
            interrupted()
            if self.check or not all(finding.ok for finding in found):
                return print_findings(found, as_json=self.json)
            return Flight(ready, name).fly(interrupted, terminal)

    def _known(self, site: Site | None, protocol: SurveyProtocol, tank: Tank | None) -> Known:
        """What is known of the ground, on the cells of the map that the dive will make."""
        world = None if tank is None else tank.world
        if world is not None:
            return self.ground.known(site, self.planner, world.bounds, protocol, world)
        assert self.area is not None
        return self.ground.known(site, self.planner, Bounds(*self.area), protocol, None)


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
        with stage("drawing the dive"):
            paths = draw_dive(folder)
    except (ValueError, OSError) as error:
        logger.warning("the dive was not drawn: %s", error)
        return
    if not quiet:
        print(f"  drawn: {paths[0]}")


@contextlib.contextmanager
def _outlives_its_terminal() -> Iterator[None]:
    """A terminal that closes takes the operator with it, and not what has to bring the vehicle up.

    Nor does it stop the program, by Ctrl-Z or for being used from the background. Who asks the program to end
    has the dive ended in order, as by Ctrl-C.
    """
    if not hasattr(signal, "SIGHUP") or threading.current_thread() is not threading.main_thread():
        yield
        return
    ignored = (signal.SIGHUP, signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU)
    before = {number: signal.signal(number, signal.SIG_IGN) for number in ignored}
    before[signal.SIGTERM] = signal.signal(signal.SIGTERM, asked_to_end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
