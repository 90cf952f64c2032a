"""Faults of vehicle, sensors, link and program during a dive, one at a time: what was done, and how soon.

    python perf/faults.py                            some six minutes, all of it in real time
    python perf/faults.py --out docs/faults.md       also write the table
    python perf/faults.py --only DVL --guided        those whose name holds a word; by velocities

Each fault meets a vehicle of its own that is on its way through the simulated tank, by way of the real
protocols. A computer that is busy with other things makes the times longer, and none of the laws void.
"""

from __future__ import annotations

import argparse
import math
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

from rich.progress import Progress

from dream.robots.bluerov2.bridge import LEASE, Stance
from dream.robots.bluerov2.standin.drill import FAULTS, Fault, Outcome, drill, killed

HEAD = """# What happens when something fails

Measured by `python perf/faults.py --out docs/faults.md`: a stand-in of the vehicle on its way through the
simulated tank, over the real protocols and in real time; the fault comes 1 s after it set out. The
limits are those of a dive, but that the bottom may be lost for 1.5 s instead of 10, and that the last resort
(to surface) comes after 2 s in neutral instead of 5.

| column | meaning, seconds from the fault unless said otherwise |
|---|---|
| found | until something else was done than to go on; – where it was ridden out |
| did | what; see below |
| lost | when that was lost without which nothing may move |
| after it | from then to the last packet that can move the vehicle; 0.5 is the limit |
| slid | metres that the vehicle moved while it was watched, those on its way included |
| off | metres between estimate and truth in the end |
| goes on | once the fault was put right |
| kept | on disk; no message of a log was lost, unless said |

What it did: *slow*, on at a part of the speed; *neutral*, the autopilot holds depth and heading, and the last
resort comes if it lasts; *yield*, somebody else has it, and DREAM is silent; *over*, neutral for good, then
the last resort. Lost is the last sign of life of mission or operator; for the sensors, the moment when
the newest sample got older than is borne (0.2 s for the inertial unit).

"""
TAIL = """
Laws, which `tests/robots/bluerov2/test_faults.py` holds:

* What is lost ends all motion: no packet that can move the vehicle is sent later than 0.5 s after it.
* No message of the log is lost.
* Where it goes on, the estimate is within 0.1 m of the truth, also after faults one after the other: a link
  that is dead for 0.7 s, and then a DVL that is silent.
* After *over* DREAM never moves the vehicle again, even if the reason goes.

The autopilot's own failsafe is the last of the ladder: a program that is killed sends nothing any more, the
last sticks hold until ArduSub misses the pilot (`FS_PILOT_TIMEOUT`, 1 s at most as the list before a dive
wants it), and then it disarms. The log is read as far as it goes.
"""


def main() -> int:
    """Print the table; status 1 where a law is broken."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, help="Markdown file to write")
    parser.add_argument("--only", default="", help="faults whose name holds this")
    parser.add_argument("--guided", action="store_true", help="in GUIDED, by velocities")
    parser.add_argument("--seed", type=int, default=1)
    told = parser.parse_args()
    chosen = [fault for fault in FAULTS if told.only in fault.name]
    ends = [
        how
        for how, name in (
            (signal.SIGKILL, "the program is killed"),
            (signal.SIGSTOP, "the program is stopped"),
        )
        if told.only in name
    ]
    rows: list[Outcome] = []
    with Progress(disable=not sys.stderr.isatty()) as progress:
        task = progress.add_task("faults", total=len(chosen) + len(ends))
        for outcome in _suffered(chosen, ends, told.seed, guided=told.guided):
            rows.append(outcome)
            progress.advance(task)
            print(_row(outcome), flush=True)
    if told.out is not None:
        table = "\n".join([*_TOP, *map(_row, rows)])
        told.out.write_text(f"{HEAD}{table}\n{TAIL}")
    broken = [row.fault for row in rows if row.log_lost or (row.did != _KILLED and row.after_loss > LEASE)]
    for name in broken:
        print(f"broken: {name}", file=sys.stderr)
    return 1 if broken else 0


_KILLED = "disarmed by the autopilot"
_TOP = (
    "| fault | found | did | because | lost | after it | slid, m | off, m | goes on | kept |",
    "|---|---|---|---|---|---|---|---|---|---|",
)


def _suffered(
    chosen: list[Fault], ends: list[signal.Signals], seed: int, *, guided: bool
) -> Iterator[Outcome]:
    yield from drill(chosen, seed=seed, guided=guided)
    for how in ends:
        yield killed(how, seed=seed)


def _row(outcome: Outcome) -> str:
    done = outcome.did
    if not math.isfinite(outcome.detected):
        done = "the command expires" if math.isfinite(outcome.lost) else str(Stance.GO)
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
        "yes" if outcome.healed else "no",
        outcome.kept + lost,
    )
    return f"| {' | '.join(cells)} |"


def _number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "–"


if __name__ == "__main__":
    sys.exit(main())
