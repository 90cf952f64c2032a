"""One planner beside another, family by family, from the files of a benchmark: what the README's table says.

    python perf/families.py results/test
    python perf/families.py bench/dev --planner belief --against sixsteps

Times that were never reached count as the cap. Intervals at 95 % resample worlds, in pairs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import stats

from dream.evaluation import statistics
from dream.evaluation.oracle.bounds import known_bounds
from dream.evaluation.results import Row, read_results
from dream.evaluation.suites import family_of
from dream.protocol import protocol_named


def times(rows: Sequence[Row], mark: str) -> npt.NDArray[np.float64]:
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


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bench", type=Path, help="folder of a benchmark")
    parser.add_argument("--planner", default="belief")
    parser.add_argument("--against", default="sweep-and-graze")
    options = parser.parse_args()
    flown: dict[str, dict[tuple[str, int, int], Row]] = {}
    for row in read_results(options.bench).rows:
        flown.setdefault(row.planner, {})[row.world, row.seed, row.start] = row
    for name in (options.planner, options.against):
        if name not in flown:
            parser.error(f"{options.bench}: expected missions of {name}, got those of {', '.join(flown)}")
    ours, theirs = flown[options.planner], flown[options.against]
    shared = sorted(ours.keys() & theirs.keys())
    families = list(dict.fromkeys(family_of(world) for world, _, _ in shared))
    reefs = [family for family in families if family != "wreck"]
    print(
        f"| worlds | 98.26 % seen | {options.against} | ratio of the means | ÷ bound, median | success | "
        f"{options.against} | own stop | {options.against} | seen at the end | contacts |"
    )
    print(f"|---|{'--:|' * 10}")
    groups = [("all reefs", reefs), *((family, [family]) for family in families)]
    for title, members in groups:
        keys = [key for key in shared if family_of(key[0]) in members]
        if not keys:
            continue
        mine, other = [ours[key] for key in keys], [theirs[key] for key in keys]
        a, b = times(mine, "t98"), times(other, "t98")
        strata = [family_of(key[0]) for key in keys]
        weights = statistics.resampling_weights(strata, np.random.default_rng(0))
        ratio = a.mean() / b.mean()
        # On a logarithmic scale, so that it is the same whichever of the two is above the line.
        error = np.log((weights @ a) / (weights @ b)).std(ddof=1)
        margin = error * stats.t.ppf(0.5 + 0.5 * statistics.LEVEL, len(keys) - len(members))
        low, high = ratio * np.exp([-margin, margin])
        ratios = over_bound(mine)
        bound = f"{np.median(ratios):.2f} · {len(ratios)}" if ratios else "–"
        won = statistics.share_interval(sum(row.success for row in mine), len(mine))
        cells = [
            f"{title} ({len(keys)})",
            f"{a.mean():.1f}",
            f"{b.mean():.1f}",
            f"{ratio:.2f} [{low:.2f}, {high:.2f}]",
            bound,
            f"{sum(row.success for row in mine)} [{won.low:.0%}, {won.high:.0%}]",
            f"{sum(row.success for row in other)}",
            f"{times(mine, 't_stop').mean():.1f}",
            f"{times(other, 't_stop').mean():.1f}",
            f"{100.0 * np.mean([row.instances for row in mine]):.2f} %",
            f"{sum(row.collisions for row in mine)}",
        ]
        print(f"| {' | '.join(cells)} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
