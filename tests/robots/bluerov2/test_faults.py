"""Faults over the real protocols, in real time: what is lost ends all motion, and nothing else does.

Times are those of the packets' own taps against the last sign of what was lost, so that a busy computer
changes what is measured, and not whether it holds. One that stood still is a fault of its own, which is told
first: then the fault is begun once more.
"""

import ctypes
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from types import TracebackType

import pytest

from dream.robots.bluerov2.bridge import SAG, Stance, Standing
from dream.robots.bluerov2.standin.drill import HEALING_FAULTS, Drill, Fault, Outcome, killed

OFF = 0.1
"""Metres by which the estimate may err in the end: centimetres, and what it lags behind on its way."""
LIMIT = 0.5
"""Seconds from a loss to the last packet that can move the vehicle."""
DRILLED = (
    "the mission hangs",
    "the operator's terminal is gone",
    "the estimate hangs for 1 s",
    "packets come 0.3 s late",
    # The DVL's last: without it the estimate lives on what it knows of itself after so long without samples.
    "the link is dead for 0.7 s",
    "the DVL is silent",
    "another station has our id",
)
LOSSES = DRILLED[:-1]
"""Those in which something is lost without which nothing may move."""


STALL = 0.15
"""Seconds: samples that come later by 0.2 s are missed."""
PAUSE = 0.02
"""Seconds that it sleeps at a time."""
TRIES = 4


WATCHING = f"""
import select, sys, time
ended, worst, before = [], 0.0, time.monotonic()
print("watching", flush=True)
while not ended:
    ended, _, _ = select.select([sys.stdin], [], [], {PAUSE})
    now = time.monotonic()
    worst, before = max(worst, now - before - {PAUSE}), now
print(worst)
"""
"""Until its input ends."""


class Stalls:
    """Watches whether the computer goes on.

    From a process of its own: a program that holds itself up is what is tested, and no fault of the computer.
    """

    def __init__(self) -> None:
        self.worst = 0.0
        """Seconds by which a short sleep was too long; known at the end."""

    def __enter__(self) -> "Stalls":
        command = [sys.executable, "-I", "-S", "-c", WATCHING]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "watching\n"
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        told, _ = self.process.communicate(timeout=30.0)
        self.worst = float(told)


def suffered(drill: Drill, fault: Fault) -> Outcome:
    """What came of a fault of a computer that went on, if one of a few tries was of one."""
    for _ in range(TRIES):
        with Stalls() as stalls:
            outcome = drill.suffer(fault)
        if stalls.worst < STALL:
            break
    return outcome


def test_a_program_that_holds_itself_up_is_not_taken_for_a_computer_that_stands_still() -> None:
    """No thread of it goes on meanwhile. The computer may truly stand still, but not each time."""
    for _ in range(TRIES):
        with Stalls() as stalls:
            ctypes.PyDLL(None).usleep(round(3e6 * STALL))  # Keeps the lock of the interpreter.
        if stalls.worst < STALL:
            return
    raise AssertionError(f"told as a computer that stood still for {stalls.worst:.2f} s, {TRIES} times")


def test_a_computer_that_stands_still_is_told() -> None:
    with Stalls() as stalls:
        os.kill(stalls.process.pid, signal.SIGSTOP)
        time.sleep(2.0 * STALL)
        os.kill(stalls.process.pid, signal.SIGCONT)
    assert stalls.worst > STALL


@dataclass(frozen=True)
class End:
    """What came of a fault that does not heal."""

    did: str
    """What it did first."""
    over: Standing
    since_over: float
    """Seconds that were watched after the battery had recovered."""
    moved_since_over: list[float]
    """When, since the dive was over, something was sent that can move the vehicle."""
    stance: Stance


@dataclass(frozen=True)
class Drilled:
    """What came of the faults that heal, one after the other on one vehicle, and of one that does not."""

    outcomes: dict[str, Outcome]
    end: End
    log_lost: dict[str, int]


def full_again(drill: Drill) -> None:
    with drill.standin.lock:
        drill.standin.tank.drain(drill.standin.tank.conditions.battery.full)


def flat(drill: Drill) -> None:
    with drill.standin.lock:
        drill.standin.tank.drain(13.5)


def ended(drill: Drill) -> End:
    topside = drill.topside
    did = drill.suffer(Fault("the battery falls to 13.5 V", flat, lasts=SAG + 1.5)).did
    at_the_end, over = next(entry for entry in topside.said if entry[1].stance is Stance.OVER)
    full_again(drill)
    topside.go()
    time.sleep(2.5)
    moved = [at - at_the_end for at in topside.moves if at > at_the_end]
    stance = topside.bridge.standing.stance
    return End(did, over, topside.now() - at_the_end, moved, stance)


@pytest.fixture(scope="module")
def drilled(tmp_path_factory: pytest.TempPathFactory) -> Drilled:
    faults = {fault.name: fault for fault in HEALING_FAULTS}
    with Drill(tmp_path_factory.mktemp("faults")) as drill:
        outcomes = {name: suffered(drill, faults[name]) for name in DRILLED}
        end, log_lost = ended(drill), drill.topside.log.lost
    # On a computer that is busy something else may be lost for a moment first. What is over stays so, and the
    # fault is begun once more on another vehicle.
    for _ in range(TRIES - 1):
        if end.did.startswith("over"):
            break
        with Drill(tmp_path_factory.mktemp("faults")) as drill:
            end = ended(drill)
    return Drilled(outcomes, end, log_lost)


@pytest.mark.slow
@pytest.mark.parametrize("name", LOSSES)
def test_nothing_moves_it_later_than_half_a_second_after_a_loss(drilled: Drilled, name: str) -> None:
    outcome = drilled.outcomes[name]
    assert math.isfinite(outcome.lost)
    assert outcome.after_loss <= LIMIT
    # It was on its way when the fault began, or nothing would be shown.
    assert outcome.last_motion > -LIMIT


@pytest.mark.slow
@pytest.mark.parametrize("name", DRILLED)
def test_it_goes_on_once_the_fault_is_put_right(drilled: Drilled, name: str) -> None:
    assert drilled.outcomes[name].healed


@pytest.mark.slow
@pytest.mark.parametrize("name", DRILLED)
def test_the_estimate_is_as_good_as_before(drilled: Drilled, name: str) -> None:
    assert drilled.outcomes[name].off < OFF


@pytest.mark.slow
def test_a_reason_is_told(drilled: Drilled) -> None:
    reasons = {name: outcome.reason for name, outcome in drilled.outcomes.items()}
    assert "the mission" in reasons["the mission hangs"]
    assert "the operator" in reasons["the operator's terminal is gone"]
    assert "inertial" in reasons["the link is dead for 0.7 s"]
    assert "bottom track" in reasons["the DVL is silent"]
    assert "our system id" in reasons["another station has our id"]


@pytest.mark.slow
def test_a_dive_that_is_over_is_never_moved_again(drilled: Drilled) -> None:
    end = drilled.end
    assert end.did.startswith("over")
    assert "battery" in end.over.reason
    # The battery has recovered, and there is a new goal; both came too late.
    assert end.stance is Stance.OVER
    assert end.since_over > 2.0
    assert max(end.moved_since_over, default=0.0) <= LIMIT


@pytest.mark.slow
def test_no_message_of_the_log_is_lost(drilled: Drilled) -> None:
    assert drilled.log_lost == {}


@pytest.mark.slow
def test_a_program_that_is_killed_leaves_a_vehicle_that_disarms_and_a_log_that_reads() -> None:
    outcome = killed(lasts=2.6)
    # FS_PILOT_TIMEOUT is 1 s of the tank's time, which may lag by 1 s behind.
    assert 0.0 < outcome.detected < 2.5
    assert -LIMIT < outcome.last_motion < 2.5
    assert int(outcome.kept.split()[0]) > 500
