"""Every fault of the drill: it is named, what is lost ends all motion, and no vehicle is left armed."""

import signal
import threading
from pathlib import Path

import pytest

from dream.robots.bluerov2.bridge import Stance
from dream.robots.bluerov2.limits import SAG
from dream.robots.bluerov2.standin.drill import FAULTS, LIMIT, Drill, Fault, Outcome, killed

OFF = 0.1
"""Metres by which the estimate may err where it goes on: centimetres, and what it lags behind on its way."""

NAMED = {
    "the mission hangs": "the mission",
    "the operator's terminal is gone": "the operator",
    "the estimate hangs for 1 s": "",
    "a third of the packets is lost, both ways": "",
    "packets come up to 0.15 s late, out of order": "",
    "packets come 0.3 s late": "inertial samples",
    "the link is dead for 0.7 s": "inertial samples",
    "another vehicle reports to our port": "",
    "the autopilot's clock jumps by 100 s": "",
    "the autopilot's clock slips by 0.3 s": "a clock that was set",
    "the DVL's clock jumps back by 30 s": "",
    "the DVL talks nonsense": "",
    "the DVL is silent for 6 s": "does not know any more where it is",
    "the DVL loses the bottom for 6 s": "does not know any more where it is",
    "the DVL's reports come 0.5 s late": "",
    "the tether pulls with 15 N for 1 s": "",
    "the heading jumps by 20°": "",
    "a thruster is dead": "",
    "another station has our id": "our system id",
    "the delay grows by 0.05 s a second": "inertial samples",
    "the link stays dead": "inertial samples",
    "the estimate hangs for good": "",
    "the autopilot begins anew": "inertial samples",
    "the DVL stays silent": "does not know any more where it is",
    "the DVL is about to shut down, too hot": "too hot",
    "the battery falls to 13.5 V": "battery",
    "water comes in": "water in the hull",
    "somebody changes the mode": "MANUAL instead of ALT_HOLD",
    "somebody disarms it": "disarmed",
    "the vehicle listens to another station": "Lost manual control",
    "the camera is silent": "no pictures",
    "the camera is frozen": "the same picture",
    "the camera is frozen but for a clock in its corner": "the same picture",
    "the camera is frozen, with noise over it": "the same picture",
    "the camera is black": "too little to see",
    "the terminal is frozen for good": "the operator",
    "the mission hangs for good, as on a disk that does not answer": "the mission",
    "water comes in, and commands are lost for 4 s": "water in the hull",
    "water comes in, and no command is answered": "water in the hull",
    "water comes in, and SURFACE is refused": "water in the hull",
    "water comes in, and no mode is taken but MANUAL": "water in the hull",
    "water comes in, and it cannot be disarmed for 40 s": "water in the hull",
    "water comes in, and the vehicle surfaces by itself": "a failsafe of the vehicle",
    "the DVL's altitude is stuck at 5 m": "altitude is stuck",
    "the DVL's altitude is stuck at 0.1 m": "altitude is stuck",
    "the DVL's altitude is doubled": "times as much as the depth",
    "a third of the DVL's altitudes is ten-fold": "jumps to and fro",
    "a second bottom comes and goes": "",
    "the DVL's velocity is frozen": "does not know any more where it is",
    "the bottom moves at 0.1 m/s": "it presses",
    "the pressure gauge drifts by 5 cm/s": "gauge and DVL part",
    "the pressure gauge says the same for ever": "gauge and DVL part",
    "the pressure is that of the hull": "part",
    "the autopilot's own depth leaps by 5 m": "the depths part",
    "a throttle at neutral is taken for a climb of 0.2 m/s": "its depth does not follow",
    "the vehicle goes down whatever it is told": "above the floor",
    "the autopilot does not tell its depth": "does not tell its depth",
    "ATTITUDE is silent": "no heading",
    "ATTITUDE is frozen, with new stamps": "no heading",
    "SYS_STATUS is silent, and the battery falls": "nothing of battery and leak",
    "the tether is caught, and pulls with 60 N": "it presses",
    "a thruster pushes the wrong way": "it presses",
    "the terminal is frozen, and a third of the packets is lost": "the operator",
}
"""What the reason says; empty where the vehicle goes on, or nothing is left that could say it."""

OFTEN = {
    "the operator's terminal is gone",
    "the estimate hangs for 1 s",
    "packets come 0.3 s late",
    "the DVL loses the bottom for 6 s",
    "the link stays dead",
    "the autopilot begins anew",
    "the battery falls to 13.5 V",
    "somebody disarms it",
    "the vehicle listens to another station",
    "the camera is frozen but for a clock in its corner",
    "the terminal is frozen for good",
    "water comes in, and SURFACE is refused",
    "the DVL's altitude is stuck at 5 m",
    "the bottom moves at 0.1 m/s",
    "the pressure gauge drifts by 5 cm/s",
    "the autopilot's own depth leaps by 5 m",
    "the vehicle goes down whatever it is told",
    "ATTITUDE is frozen, with new stamps",
    "the tether is caught, and pulls with 60 N",
}
"""One of each kind, which `make test` drills too; `make test-slow` drills all."""


def suffered(fault: Fault, folder: Path, *, guided: bool = False) -> Outcome:
    with Drill(folder, camera=fault.camera, guided=guided) as drill:
        return drill.suffer(fault)


def test_every_fault_is_here() -> None:
    assert [fault.name for fault in FAULTS] == list(NAMED)
    assert set(NAMED) >= OFTEN


@pytest.mark.few(3)
@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(fault, id=fault.name, marks=[] if fault.name in OFTEN else pytest.mark.rare)
        for fault in FAULTS
    ],
)
def test_a_fault_is_named_ends_all_motion_and_leaves_no_vehicle_armed(fault: Fault, tmp_path: Path) -> None:
    outcome = suffered(fault, tmp_path)
    assert outcome.broken == []
    assert NAMED[fault.name] in outcome.reason
    assert bool(outcome.reason) >= bool(NAMED[fault.name])
    if fault.heals is not None:
        assert outcome.healed
        assert outcome.off < OFF
    # It was on its way when the fault began, or nothing would be shown.
    assert outcome.slid > 0.05


@pytest.mark.rare
def test_a_dive_that_is_over_is_never_moved_again_but_up(tmp_path: Path) -> None:
    with Drill(tmp_path) as drill:
        drain = drill.standin.tank.drain
        flat = Fault("the battery falls", lambda _: drain(13.5), lasts=SAG + 0.5)
        drill.suffer(flat)
        over = next(at for at, standing in drill.rig.said if standing.stance is Stance.OVER)
        # The battery has recovered, and there is a new goal; both come too late.
        drain(drill.standin.tank.conditions.battery.full)
        drill.bridge.renew(60.0)
        drill.bridge.go(drill.rig.start, drill.rig.protocol.altitude)
        drill.clock.sleep(5.0)
        assert drill.bridge.standing.stance is Stance.OVER
        assert max(at for at in drill.moves) <= over + LIMIT


def test_the_same_fault_takes_the_same_course(tmp_path: Path) -> None:
    fault = next(fault for fault in FAULTS if fault.name == "packets come up to 0.15 s late, out of order")
    folders = [tmp_path / name for name in ("one", "other")]
    outcomes = []
    for folder in folders:
        folder.mkdir()
        outcomes.append(suffered(fault, folder))
    one, other = outcomes
    assert (one.slid, one.off, one.last_motion) == (other.slid, other.off, other.last_motion)


@pytest.mark.rare
@pytest.mark.slow
@pytest.mark.parametrize("name", ["the DVL stays silent", "water comes in", "the link stays dead"])
def test_by_velocities_it_ends_as_well(name: str, tmp_path: Path) -> None:
    fault = next(fault for fault in FAULTS if fault.name == name)
    assert suffered(fault, tmp_path, guided=True).broken == []


def test_no_thread_of_a_drill_is_left(tmp_path: Path) -> None:
    before = threading.active_count()
    with Drill(tmp_path) as drill:
        drill.clock.sleep(1.0)
    assert threading.active_count() <= before + 1


@pytest.mark.rare
@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_program_that_is_killed_leaves_a_vehicle_that_disarms_and_a_log_that_reads(
    how: signal.Signals,
) -> None:
    outcome = killed(how, lasts=2.6)
    # FS_PILOT_TIMEOUT is 1 s of the tank's time, which may lag by 1 s behind.
    assert 0.0 < outcome.detected < 2.5
    assert -LIMIT < outcome.last_motion < 2.5
