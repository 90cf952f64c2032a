"""Faults of vehicle, sensors, link and program during a dive, one at a time: what was done, how it ended.

    python perf/faults.py                            the list, some four minutes
    python perf/faults.py --out docs/faults.md       also write the table
    python perf/faults.py --only DVL --guided        those whose name holds a word; by velocities
    python perf/faults.py --random 200               faults drawn from the list, at seconds that are drawn

Each fault meets a vehicle of its own that is on its way through the simulated tank, on a clock of its own: a
computer that is busy with other things changes nothing. Two that need a program to kill take real time.
"""

from __future__ import annotations

import argparse
import math
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.progress import Progress

from dream.robots.bluerov2.bridge import Stance
from dream.robots.bluerov2.standin.drill import FAULTS, Fault, Outcome, drill, killed

WATCHED = 20.0
"""Seconds of a mission within which a fault that is drawn begins."""
HEAD = """# What happens when something fails

Measured by `python perf/faults.py --out docs/faults.md`: a vehicle on its way through the simulated tank,
with all of a dive but its planner, on a simulated clock. The fault comes 1 s after it set out; the limits are
those of a dive, and the last resort is to surface.

| column | meaning, seconds from the fault unless said otherwise |
|---|---|
| found | until something else was done than to go on; – where it was ridden out |
| did | what; see below |
| lost | when that was lost without which nothing may move |
| after it | from then to the last packet that can move the vehicle, but up; 0.5 is the limit |
| slid | metres that the vehicle moved while it was watched, those on its way included |
| off | metres between estimate and truth in the end |
| contacts | with walls, pipes and floor |
| pressed | longest time in which its thrusters truly worked hard, and it stood |
| ended | goes on; or where and when it was disarmed |

What it did: *slow*, on at a part of the speed; *neutral*, the autopilot holds depth and heading, and the way
home begins if it lasts for 5 s; *yield*, somebody else has it, and DREAM is silent; *over*, the way home at
once. Lost is the last sign of life of mission or operator; for the sensors, the moment when the newest sample
got older than is borne (0.2 s for the inertial unit). No message of a log was lost, unless said.

"""
TAIL = """
Laws, which `tests/robots/bluerov2/test_faults.py` holds:

* What is lost ends all motion: no packet that can move the vehicle, but up, is sent later than 0.5 s after.
* No message of the log is lost.
* Where it goes on, the estimate is within 0.1 m of the truth.
* After *over* DREAM never moves the vehicle again but up, even if the reason goes.
* No vehicle stays armed under water, whether mission, terminal or disk answer or not.

The autopilot's own failsafe is the last of the ladder: a program that is killed sends nothing any more, the
last sticks hold until ArduSub misses the pilot (`FS_PILOT_TIMEOUT`, 1 s at most as the list before a dive
wants it), and then it disarms. A vehicle that hears nothing of a request to disarm is left to it as well.
"""


def main() -> int:
    """Print the table; status 1 where a law is broken."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, help="Markdown file to write")
    parser.add_argument("--only", default="", help="faults whose name holds this")
    parser.add_argument("--guided", action="store_true", help="in GUIDED, by velocities")
    parser.add_argument("--random", type=int, default=0, metavar="N", help="so many that are drawn")
    parser.add_argument("--seed", type=int, default=1)
    told = parser.parse_args()
    chosen = [fault for fault in FAULTS if told.only in fault.name]
    ends = [(how, name) for how, name in _ENDS if told.only in name and not told.random]
    count = told.random or len(chosen) + len(ends)
    rows: list[Outcome] = []
    with Progress(disable=not sys.stderr.isatty()) as progress:
        task = progress.add_task("faults", total=count)
        drawn = _drawn(chosen, told.random, told.seed, guided=told.guided)
        for outcome in drawn if told.random else _suffered(chosen, ends, told.seed, guided=told.guided):
            rows.append(outcome)
            progress.advance(task)
            print(_row(outcome), flush=True)
    if told.out is not None:
        table = "\n".join([*_TOP, *map(_row, rows)])
        told.out.write_text(f"{HEAD}{table}\n{TAIL}")
    broken = [(row.fault, law) for row in rows if row.did != _KILLED for law in row.broken]
    for name, law in broken:
        print(f"broken: {name}: {law}", file=sys.stderr)
    print(f"{len(rows)} faults, {len(broken)} laws broken", file=sys.stderr)
    return 1 if broken else 0


_ENDS = ((signal.SIGKILL, "the program is killed"), (signal.SIGSTOP, "the program is stopped"))
_KILLED = "disarmed by the autopilot"
_TOP = (
    "| fault | found | did | because | lost | after it | slid, m | off, m | contacts | pressed | ended |",
    "|---|---|---|---|---|---|---|---|---|---|---|",
)


def _suffered(
    chosen: list[Fault], ends: list[tuple[signal.Signals, str]], seed: int, *, guided: bool
) -> Iterator[Outcome]:
    yield from drill(chosen, seed=seed, guided=guided)
    for how, _ in ends:
        yield killed(how, seed=seed)


def _drawn(chosen: list[Fault], count: int, seed: int, *, guided: bool) -> Iterator[Outcome]:
    """Single faults at seconds that are drawn, each on a vehicle with a seed of its own."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        fault = chosen[int(rng.integers(len(chosen)))]
        yield from drill([fault], seed=1000 * seed + k, guided=guided, after=float(rng.uniform(0.0, WATCHED)))


def _row(outcome: Outcome) -> str:
    done = outcome.did
    if not math.isfinite(outcome.detected):
        done = "the command expires" if math.isfinite(outcome.lost) else str(Stance.GO)
    ended = "goes on" if outcome.healed else f"disarmed at {outcome.depth:.1f} m, {outcome.ended:.1f} s"
    if outcome.did == _KILLED:
        ended = f"disarmed, {outcome.ended:.1f} s"
    elif outcome.armed and not outcome.healed:
        ended = f"**armed at {outcome.depth:.1f} m**"
    lost = f"; {outcome.log_lost} messages lost" if outcome.log_lost else ""
    cells = (
        outcome.fault,
        _number(outcome.detected),
        done,
        outcome.reason or "",
        _number(outcome.lost),
        _number(outcome.after_loss),
        f"{outcome.slid:.2f}",
        _number(outcome.off),
        str(outcome.contacts),
        f"{outcome.pressed:.1f}" if math.isfinite(outcome.pressed) else "–",
        ended + lost,
    )
    return f"| {' | '.join(cells)} |"


def _number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "–"


if __name__ == "__main__":
    sys.exit(main())
