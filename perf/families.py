"""Planners side by side, family by family, from the files of a benchmark: two tables of docs/benchmark.md.

    python perf/families.py results/test
    python perf/families.py results/dev --planners belief sixsteps frontier

How soon they see 98.26 %: times that were never reached count as the cap; ratios are those of the means, with
95 % intervals that resample worlds, in pairs, on a logarithmic scale. How they end: successes, missions that
stopped by themselves with less than 98.26 % seen, steps to their own stop, and what they had seen in the end.
Wrecks stand design by design, those together that no planner saw enough of.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import stats

from dream.evaluation import statistics
from dream.evaluation.comparison import FAMILIES
from dream.evaluation.oracle.bounds import known_bounds
from dream.evaluation.results import Row, read_results
from dream.evaluation.suites import family_of
from dream.protocol import protocol_named

FloatArray = npt.NDArray[np.float64]

OTHERS = "wrecks that nobody saw enough of"
"""One row."""


def times(rows: Sequence[Row], mark: str) -> FloatArray:
    """(n,) steps to a mark, the cap where it was never reached."""
    reached = [getattr(row, mark) for row in rows]
    caps = [protocol_named(row.protocol).cap for row in rows]
    return np.array([cap if step is None else step for step, cap in zip(reached, caps, strict=True)], float)


def over_bound(rows: Sequence[Row]) -> list[float]:
    """Steps to 98.26 % over the certified bound, of the worlds whose bound is known."""
    found = []
    for row, step in zip(rows, times(rows, "t98"), strict=True):
        limits = known_bounds(row.protocol, row.world, row.seed, row.start, row.world_hash)
        if limits is not None:
            found.append(step / limits.t98.lower_bound)
    return found


def groups(worlds: Iterable[str], reached: Collection[str]) -> dict[str, set[str]]:
    """Worlds that stand in a row together, by its title.

    Args:
        worlds: Names.
        reached: Those in which any mission reached 98.26 %.
    """
    found: dict[str, set[str]] = {}
    for world in sorted(worlds, key=lambda world: (list(FAMILIES).index(family_of(world)), world)):
        family = family_of(world)
        if family == "wreck":
            kept = world in reached
            found.setdefault(world if kept else OTHERS, set()).add(world)
        else:
            found.setdefault("reefs", set()).add(world)
            found.setdefault(FAMILIES[family].partition(" ")[0].lower(), set()).add(world)
    return found


def ratio(ours: FloatArray, theirs: FloatArray, strata: Sequence[str]) -> str:
    """Of the means, with its interval; without where no pair differs."""
    value = ours.mean() / theirs.mean()
    freedom = len(ours) - len(set(strata))
    if not np.any(ours - theirs) or freedom < statistics.LEAST_FREEDOM:
        return f"{value:.2f}"
    weights = statistics.resampling_weights(strata, np.random.default_rng(0))
    # On a logarithmic scale, so that it is the same whichever of the two is above the line.
    error = np.log((weights @ ours) / (weights @ theirs)).std(ddof=1)
    margin = error * stats.t.ppf(0.5 + 0.5 * statistics.LEVEL, freedom)
    low, high = value * np.exp([-margin, margin])
    return f"{value:.2f} [{low:.2f}, {high:.2f}]"


def how_soon(flown: Sequence[Sequence[Row]]) -> list[str]:
    """Cells on missions in the same worlds: of the first planner, then of each other with the ratio to it."""
    mine, *others = flown
    ours, strata = times(mine, "t98"), [family_of(row.world) for row in mine]
    cells = [f"**{ours.mean():.1f}**"]
    for other in others:
        theirs = times(other, "t98")
        cells += [f"{theirs.mean():.1f}", ratio(ours, theirs, strata)]
    bounds = over_bound(mine)
    return [*cells, f"{np.median(bounds):.2f} ({len(bounds)})" if bounds else "–"]


def how_it_ends(rows: Sequence[Row]) -> str:
    """Successes, missions that stopped too early, steps to the own stop, and what was seen in the end."""
    early = sum(row.too_early for row in rows)
    seen = 100.0 * np.mean([row.instances for row in rows])
    success = f"{sum(row.success for row in rows)}/{len(rows)}"
    return f"{success} · {early} · {times(rows, 't_stop').mean():.1f} · {seen:.{2 if seen > 99.0 else 1}f} %"


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bench", type=Path, help="folder of a benchmark")
    parser.add_argument("--planners", nargs="+", default=["belief", "sixsteps", "sweep-and-graze"])
    options = parser.parse_args()
    flown: dict[str, dict[tuple[str, int, int], Row]] = {}
    for row in read_results(options.bench).rows:
        flown.setdefault(row.planner, {})[row.world, row.seed, row.start] = row
    if lost := [name for name in options.planners if name not in flown]:
        parser.error(
            f"{options.bench}: expected missions of {', '.join(lost)}, got those of {', '.join(flown)}"
        )
    chosen = [flown[name] for name in options.planners]
    shared = sorted(set.intersection(*map(set, chosen)))
    reached = {key[0] for key in shared for missions in chosen if missions[key].t98 is not None}
    found = groups({world for world, _, _ in shared}, reached)
    first, *others = options.planners
    heads = [first, *(head for name in others for head in (name, "ratio")), "÷ bound, median"]
    soon = [f"| worlds | {' | '.join(heads)} |"]
    ends = [f"| worlds | {' | '.join(options.planners)} |", f"|---|{'--:|' * len(options.planners)}"]
    soon.append(f"|---|{'--:|' * len(heads)}")
    for title, worlds in found.items():
        keys = [key for key in shared if key[0] in worlds]
        rows = [[missions[key] for key in keys] for missions in chosen]
        name = (
            f"{len(keys)} {', '.join(sorted(worlds)).replace(', wreck/', ', ') if title == OTHERS else title}"
        )
        name = f"**{name}**" if title == "reefs" else name
        soon.append(f"| {name} | {' | '.join(how_soon(rows))} |")
        ends.append(f"| {name} | {' | '.join(map(how_it_ends, rows))} |")
    contacts = sum(missions[key].collisions for missions in chosen for key in shared)
    print("Steps to 98.26 %", *soon, "", "Success · stopped too early · own stop · seen at the end", sep="\n")
    print(*ends, "", f"Contacts: {contacts}", sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
