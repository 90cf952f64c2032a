"""A whole dive on a real ArduSub in software, in lock-step with our tank, A50 and camera: when asked for.

    DREAM_ARDUSUB_SITL=/path/to/ardusub pytest tests/hardware/test_dive.py -v
    unshare -n bash -c 'ip link set lo up; DREAM_ARDUSUB_SITL=... pytest tests/hardware/test_dive.py -v'

Link, estimate, bridge, drives, planner and way home are those of `dream dive`; see `sitl` for the other end.
DREAM_DIVES=FOLDER keeps the runs, and a table of them (`table.md`).
"""

import functools
import json
import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from dream.evaluation.dive_figure import read_dive
from dream.geometry import wrap_angle
from dream.recording import read_steps
from dream.robots.bluerov2.home import SHALLOW
from dream.robots.bluerov2.limits import Limits
from dream.robots.bluerov2.standin.rig import Rig
from dream.sim.worlds import make_world
from tests.hardware.sitl import BINARY, SETUPS, Sitl
from tests.robots.bluerov2 import rigged

pytestmark = pytest.mark.skipif(not BINARY, reason="DREAM_ARDUSUB_SITL names no ArduSub built for SITL")

STEPS = 25
DIVES = [*((name, False) for name in SETUPS if name != "gps-lake"), ("gps", True)]
"""Set-ups, and whether it is GUIDED: that needs a position."""
SETTLED = {False: 25.0, True: 50.0}
"""Seconds until the autopilot is ready to arm; and until it has a position."""
CALLED = 60.0
"""Seconds after it set out at which the battery becomes low."""
OFF, ASTRAY, HIGH, LONG = 0.1, math.radians(3.0), 0.05, 6.0
"""Metres, radians and metres of height by which a step may end elsewhere, and seconds that one takes."""


NEAR = 0.25
"""Metres from where a mission began within which it is home: a step, and what it errs by."""


@dataclass
class Flown:
    """What came of a dive, by truth."""

    ended: str
    steps: int
    contacts: int
    off: float
    """Metres between estimate and truth at the end of a step, at most."""
    astray: float
    """Radians between where it looks and where it was sent to look, likewise."""
    strays: int
    """Steps that end farther than `ASTRAY` from there."""
    high: float
    """Metres of altitude, likewise."""
    seconds: float
    """Of a step, in the mean."""
    armed: bool
    left: dict[str, float]
    """Parameters that are not as before."""

    def row(self, setup: str, guided: bool) -> str:
        drive = "GUIDED" if guided else "ALT_HOLD"
        errors = f"{self.off:.3f} | {math.degrees(self.astray):.1f}° | {self.high:.3f}"
        how = "armed" if self.armed else "disarmed"
        kept = "parameters back" if not self.left else f"{', '.join(self.left)} not back"
        return (
            f"| {setup} | {drive} | {self.steps}, {self.ended} | {self.contacts} | {errors} | "
            f"{self.seconds:.1f} | {how}, {kept} |"
        )


def flown(setup: str, guided: bool, folder: Path) -> Flown:
    world = make_world("pool/arc", 1)
    real = functools.partial(Sitl, parameters=SETUPS[setup])
    with Rig(folder, world, autopilot=real, depth=0.25, pictures=6.0, width=320, guided=guided) as rig:
        way = rigged.truth_at(rig)
        dived = rigged.dive(rig, folder, settle=SETTLED[guided], max_steps=STEPS)
        assert [finding for finding in dived.found if not finding.ok] == []
        armed, contacts, left = rig.link.telemetry.armed, rig.standin.tank.collisions, dict(rig.link._before)
    summary = json.loads((folder / "summary.json").read_text())
    steps, told = read_steps(folder), read_dive(folder)
    # One goal to begin with, and one for each step.
    astray = [abs(wrap_angle(float(turn))) for turn in told.truth[:, 3] - told.goals[1:, 3]]
    off = [math.dist((s.truth.x, s.truth.y), (s.pose.x, s.pose.y)) for s in steps if s.truth is not None]
    high = []
    for time, x, y, *_ in told.truth:
        at = min(range(len(way)), key=lambda k: abs(way[k][0] - time))
        floor = float(world.terrain.height(x, y))
        high.append(abs(float(way[at][1].translation[2]) - floor - rig.protocol.altitude))
    return Flown(
        ended=summary["ended"],
        steps=summary["steps"],
        contacts=contacts,
        off=max(off),
        astray=max(astray),
        strays=sum(turn > ASTRAY for turn in astray),
        high=max(high),
        seconds=(steps[-1].time - steps[0].time) / max(len(steps) - 1, 1),
        armed=armed,
        left=left,
    )


@pytest.mark.parametrize(("setup", "guided"), DIVES, ids=lambda value: str(value))
def test_a_whole_dive_ends_by_itself_and_leaves_the_vehicle_as_it_was(
    setup: str, guided: bool, tmp_path: Path
) -> None:
    kept = os.environ.get("DREAM_DIVES")
    folder = Path(kept) / f"{setup}-{'guided' if guided else 'alt-hold'}" if kept else tmp_path
    folder.mkdir(parents=True, exist_ok=True)
    came = flown(setup, guided, folder)
    if kept:
        with (Path(kept) / "table.md").open("a", encoding="utf-8") as table:
            table.write(came.row(setup, guided) + "\n")
    assert came.ended in ("done", "cap")
    assert came.contacts == 0
    assert came.high <= HIGH
    assert not came.armed
    assert came.left == {}
    # A drive rests within 2.5° by the estimate, and the estimate is off by its own degree.
    # GUIDED takes as long, and strays as far, as the autopilot's own loops: see docs/mavlink.md.
    assert guided or (came.off <= OFF and came.strays <= 1 and came.seconds <= LONG)


Message = Any


def left(share: float) -> Message:
    """Tells it how much its battery holds: it takes that for full where it boots."""
    return mav.MAVLink_command_long_message(
        1, 1, mav.MAV_CMD_BATTERY_RESET, 0, 1, 100.0 * share, 0, 0, 0, 0, 0
    )


def volts(value: float) -> Message:
    """The voltage of its simulated battery."""
    kind = mav.MAV_PARAM_TYPE_REAL32
    return mav.MAVLink_param_set_message(1, 1, b"SIM_BATT_VOLTAGE", value, kind)


@pytest.mark.parametrize(
    ("said", "voltage", "why"),
    [
        (left(0.205), 13.0, "the battery has 20% left"),
        (volts(14.3), 14.0, r"the battery is at 14\.[0-3] V"),
    ],
    ids=["share", "voltage"],
)
def test_a_battery_that_gets_low_brings_it_home_up_and_disarmed(
    said: Message, voltage: float, why: str, tmp_path: Path
) -> None:
    kept = os.environ.get("DREAM_DIVES")
    folder = Path(kept) / f"battery-{voltage:g}" if kept else tmp_path
    folder.mkdir(parents=True, exist_ok=True)
    world = make_world("pool/arc", 1)
    real = functools.partial(Sitl, parameters={**SETUPS["stock"], "BATT_CAPACITY": 18_000})
    limits = Limits(world.bounds, voltage=voltage)
    with Rig(folder, world, autopilot=real, depth=0.25, pictures=6.0, width=320, limits=limits) as rig:
        speaker = mav.MAVLink(None, srcSystem=254, srcComponent=190)
        rig.after(SETTLED[False] + CALLED, lambda: rig.standin.autopilot.hear(said.pack(speaker)))
        dived = rigged.dive(rig, folder, settle=SETTLED[False])
        assert [finding for finding in dived.found if not finding.ok] == []
        armed, contacts = rig.link.telemetry.armed, rig.standin.tank.collisions
        x, y, z = rig.standin.T_world_base.translation
        away = math.hypot(x - rig.start.x, y - rig.start.y)
    assert dived.error is None
    steps = read_steps(folder)
    turned = next(step for step in steps if step.home is not None and step.home.why)
    assert turned.home is not None
    assert re.fullmatch(why, turned.home.why)
    assert turned.time > CALLED
    assert steps[-1].ended == "returned"
    assert contacts == 0
    assert (armed, away < NEAR, -z < SHALLOW) == (False, True, True)
