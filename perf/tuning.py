"""How a planner was tuned: settings of it on some reefs of the suite `dev`, one line a mission.

    python perf/tuning.py sweep-and-graze                          flies what its list has and the log has not
    python perf/tuning.py sweep-and-graze --only swath=0.7         of it these settings alone
    python perf/tuning.py tiers sixsteps --protocol dream-v2       the defaults, to stand beside
    python perf/tuning.py mutual-information --table               what was flown so far

The log is `results/tuning/NAME.jsonl`. It is kept with the code, so that nobody has to believe that a planner
that others are compared with was given its chance. A setting that is chosen becomes the default, and its
lines stay under what was set when they were flown.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dream.evaluation.runner import fly_mission
from dream.planning import PLANNERS
from dream.protocol import protocol_named
from dream.sim.worlds import make_world

LOGS = Path(__file__).parents[1] / "results" / "tuning"
REEFS = ("reef/string", "reef/patch", "reef/fringing", "reef/mixed", "reef/K")
SEED = 101
"""Of the first reef of each family in `dev`."""
CAP = 300
SETTINGS: dict[str, tuple[str, ...]] = {
    "sweep-and-graze": ("", "swath=0.81", "swath=1.3", "glimpse=1.6", "glimpse=2.5"),
    "mutual-information": ("", "tell=0", "tell=30", "beta=2", "level=0.3", "mean=0.2", "related=2.5"),
    "sixsteps": ("", "glimpse=2.5"),
}
"""Planner → its settings, `name=value` with commas between; the default is empty."""


def planner_with(name: str, setting: str) -> Any:
    """A planner whose parameters are the default's but for those of a setting."""
    planner: Any = PLANNERS[name]
    changed = {}
    for part in filter(None, setting.split(",")):
        field, _, value = part.partition("=")
        changed[field] = type(getattr(planner, field))(value)
    return replace(planner, **changed)


def read(path: Path) -> list[dict[str, Any]]:
    """The lines of a log."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def flown(name: str, setting: str, world: str, protocol: str, cap: int) -> dict[str, Any]:
    """One mission as a line of the log: steps to 98.26 % and own stop are null where it came to none."""
    row = fly_mission(
        make_world(world, SEED), planner_with(name, setting), protocol_named(protocol), max_steps=cap
    ).row
    return {
        "planner": name,
        "setting": setting,
        "protocol": protocol,
        "world": world,
        "seed": SEED,
        "cap": cap,
        "t98": row.t98,
        "t_stop": row.t_stop,
        "steps": row.steps,
        "instances": round(row.instances, 5),
        "collisions": row.collisions,
        "planner_ms_p50": round(row.planner_ms_p50, 1),
    }


def table(lines: list[dict[str, Any]]) -> None:
    """Print one row a setting: means, the cap standing for never."""
    by_setting: dict[tuple[str, ...], list[dict[str, Any]]] = defaultdict(list)
    for line in lines:
        by_setting[line["planner"], line["protocol"], line["setting"]].append(line)
    print("| planner | protocol | setting | reefs | to 98.26 % | own stop | inspected | of each reef |")
    print("|---|---|---|--:|--:|--:|--:|---|")
    for (name, protocol, setting), some in by_setting.items():
        t98 = np.mean([line["t98"] or line["cap"] for line in some])
        stop = np.mean([line["t_stop"] or line["cap"] for line in some])
        share = 100.0 * np.mean([line["instances"] for line in some])
        each = ", ".join(f"{line['world'][5:]} {line['t98'] or '–'}/{line['t_stop'] or '–'}" for line in some)
        setting, count = setting or "default", len(some)
        print(
            f"| {name} | {protocol} | {setting} | {count} | {t98:.1f} | {stop:.1f} | {share:.2f} % | {each} |"
        )


def main() -> int:
    """Fly what is missing, line by line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("planners", nargs="+", choices=list(PLANNERS), metavar="PLANNER")
    parser.add_argument("--protocol", default="dream-v2", help="by which rules")
    parser.add_argument(
        "--only", nargs="*", help="settings to fly, of the list or not; all of the list unless given"
    )
    parser.add_argument("--reefs", nargs="*", default=list(REEFS), help="worlds of seed 101")
    parser.add_argument("--cap", type=int, default=CAP, help="steps at most")
    parser.add_argument("--table", action="store_true", help="fly nothing")
    options = parser.parse_args()
    LOGS.mkdir(parents=True, exist_ok=True)
    for name in options.planners:
        path = LOGS / f"{name}.jsonl"
        keys = ("setting", "protocol", "world", "cap")
        done = {tuple(line[key] for key in keys) for line in read(path)}
        settings = SETTINGS.get(name, ("",)) if options.only is None else options.only
        for setting in () if options.table else settings:
            for world in options.reefs:
                if (setting, options.protocol, world, options.cap) in done:
                    continue
                line = flown(name, setting, world, options.protocol, options.cap)
                with path.open("a") as log:
                    log.write(json.dumps(line) + "\n")
                print(line, file=sys.stderr, flush=True)
        table(read(path))
    return 0


if __name__ == "__main__":
    sys.exit(main())
