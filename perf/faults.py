"""Faults of vehicle, sensors, link and program during a dive, one at a time: what was done, how it ended.

    python perf/faults.py                            the list, some four minutes
    python perf/faults.py --page docs/bluerov2.md    also renew the table that ends that page
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


def main() -> int:
    """Print the table; status 1 where a law is broken."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--page", type=Path, help="Markdown file that ends with the table, to renew there")
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
            print(_row(outcome), *filter(None, [outcome.reason]), flush=True)
    if told.page is not None:
        text, top, _ = told.page.read_text(encoding="utf-8").partition(_TOP[0])
        if not top:
            parser.error(f"--page: expected a file with the line {_TOP[0]}, got {told.page}")
        told.page.write_text("\n".join([f"{text}{top}", *_TOP[1:], *map(_row, rows), ""]), encoding="utf-8")
    broken = [(row.fault, law) for row in rows if row.did != _KILLED for law in row.broken]
    for name, law in broken:
        print(f"broken: {name}: {law}", file=sys.stderr)
    print(f"{len(rows)} faults, {len(broken)} laws broken", file=sys.stderr)
    return 1 if broken else 0


_ENDS = ((signal.SIGKILL, "the program is killed"), (signal.SIGSTOP, "the program is stopped"))
_KILLED = "disarmed by the autopilot"
_TOP = (
    "| fault | found, s | did | slid, m | off, m | contacts | disarmed |",
    "|---|--:|---|--:|--:|--:|---|",
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
    done = outcome.did.replace("the way home", "home")
    if not math.isfinite(outcome.detected):
        done = "the command expires" if math.isfinite(outcome.lost) else str(Stance.GO)
    ended = "–" if outcome.healed else f"{max(outcome.depth, 0.0):.1f} m, {outcome.ended:.1f} s"
    if outcome.did == _KILLED:
        done, ended = "ArduSub disarms it", f"{outcome.ended:.1f} s"
    elif outcome.armed and not outcome.healed:
        ended = f"**armed at {outcome.depth:.1f} m**"
    lost = f"; {outcome.log_lost} messages lost" if outcome.log_lost else ""
    cells = (
        outcome.fault,
        _number(outcome.detected),
        done,
        f"{outcome.slid:.2f}",
        _number(outcome.off),
        str(outcome.contacts),
        ended + lost,
    )
    return f"| {' | '.join(cells)} |"


def _number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "–"


if __name__ == "__main__":
    sys.exit(main())
