"""What a comparison says of two surveys: false change where nothing changed, and a planted loss found.

    python perf/change.py                        24 worlds in dream-v1-noisy; some two hours on two cores
    python perf/change.py --worlds 4 --tables    the first ones only; only what is measured already

Of each world three missions of `belief` from different starts: two of the world as it is, and one after a
share of the individuals in one measured patch died, here and there in it. Surveys are kept in the folder of
`--kept`, so that what is broken off goes on. Comparisons are made anew each time. Seeds from 90_000 on chose
the constants of `Comparing`; those from 80_000 on are told of in docs/survey.md.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import fields, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dream.evaluation.runner import simulate
from dream.evaluation.statistics import share_interval
from dream.planning import Belief
from dream.protocol import protocol_named
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.survey import Survey, files
from dream.survey.comparison import Comparing, Comparison, PatchChange
from dream.survey.measuring import About, measure_observations
from dream.types import Target

FAMILIES = ("string", "patch", "fringing", "mixed")
VALIDATION, CHOSEN_ON = 80_000, 90_000
SMALLEST = 60
"""Individuals: of a smaller patch no loss is planted."""


def main() -> None:
    """Fly, measure, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--worlds", type=int, default=24)
    parser.add_argument("--seed", type=int, default=VALIDATION, help="of the first world")
    parser.add_argument("--protocol", default="dream-v1-noisy")
    parser.add_argument("--share", type=float, default=0.2, help="of the individuals of a patch that die")
    parser.add_argument("--kept", type=Path, default=Path("runs/change"))
    parser.add_argument("--tables", action="store_true", help="of what is measured already")
    options = parser.parse_args()
    options.kept.mkdir(parents=True, exist_ok=True)
    same, lost = [], []
    for number in range(options.worlds):
        surveys = _surveys(options, FAMILIES[number % 4], options.seed + number)
        if surveys is None:
            continue
        first, again, after, patch = surveys
        comparing = Comparing()
        same.append(comparing.compare(first, again))
        lost.append((comparing.compare(first, after), patch))
    _tell(same, lost)


def _surveys(
    options: argparse.Namespace, family: str, seed: int
) -> tuple[Survey, Survey, Survey, int] | None:
    world = make_world(f"reef/{family}", seed)
    first = _survey(options, world, 0, f"{family}-{seed}-first")
    again = _survey(options, world, 1, f"{family}-{seed}-again")
    if first is None or again is None:
        return None
    patch = _chosen(world, first)
    if patch is None:
        return None
    rng = np.random.default_rng(seed)
    there = np.flatnonzero(_inside(world, first, patch))
    dead = rng.choice(there, round(options.share * len(there)), replace=False)
    label = f"{family}-{seed}-less-{options.share:g}"
    after = _survey(options, _without(world, dead), 2 % len(world.starts), label)
    return None if after is None else (first, again, after, patch)


def _survey(options: argparse.Namespace, world: World, start: int, label: str) -> Survey | None:
    path = options.kept / f"{label}-{options.protocol}{files.SUFFIX}"
    if path.is_file():
        return files.read(path)
    if options.tables:
        return None
    began = time.perf_counter()
    protocol = protocol_named(options.protocol)
    steps = list(simulate(world, Belief(), protocol, start=start))
    flown = time.perf_counter()
    about = About(name=label, began=datetime(2026, 6, 1, tzinfo=UTC), target=Target.OYSTERS)
    survey = measure_observations([step.observation for step in steps], steps[-1].occupancy, about)
    files.write(survey, path)
    took = f"flown in {flown - began:.0f} s, measured in {time.perf_counter() - flown:.0f} s"
    print(f"{label}: {len(steps)} steps, {len(survey.individuals)} individuals, {took}", file=sys.stderr)
    return survey


def _chosen(world: World, survey: Survey) -> int | None:
    """The patch with the fewest individuals of those that are large enough."""
    counts = [int(_inside(world, survey, k).sum()) for k in range(len(survey.patches))]
    large = [(count, k) for k, count in enumerate(counts) if count >= SMALLEST]
    return min(large)[1] if large else None


def _inside(world: World, survey: Survey, patch: int) -> npt.NDArray[np.bool_]:
    from matplotlib.path import Path as Outline

    points = world.targets.position[:, :2].astype(np.float64)
    outline, *holes = survey.patches[patch].rings
    inside: npt.NDArray[np.bool_] = Outline(outline).contains_points(points)
    for hole in holes:
        inside &= ~Outline(hole).contains_points(points)
    return inside


def _without(world: World, dead: npt.NDArray[np.intp]) -> World:
    kept = np.setdiff1d(np.arange(len(world.targets)), dead)
    table = world.targets
    return replace(
        world, targets=replace(table, **{f.name: getattr(table, f.name)[kept] for f in fields(table)})
    )


def _tell(same: list[Comparison], lost: list[tuple[Comparison, int]]) -> None:
    tested = [patch for one in same for patch in one.patches if patch.p is not None]
    spared = [p for one, k in lost for p in one.patches if p.p is not None and p.before != k]
    planted = [p for one, k in lost for p in one.patches if p.before == k]
    for title, patches, verdicts in (
        ("false change, nothing changed", tested, ("gain", "loss")),
        ("false change, another patch changed", spared, ("gain", "loss")),
        ("planted loss found", planted, ("loss",)),
    ):
        found = sum(patch.verdict in verdicts for patch in patches)
        if patches:
            limits = share_interval(found, len(patches))
            print(f"{title}: {found} of {len(patches)} ({limits.low:.3f} to {limits.high:.3f})")
    for name in ("found", "target_area"):
        ratios = np.array([_log_ratio(patch, name) for patch in tested])
        ratios = ratios[np.isfinite(ratios)]
        if len(ratios):
            middle = 1.4826 * float(np.median(np.abs(ratios - np.median(ratios))))
            told = f"mean {ratios.mean():+.3f}, sd {ratios.std():.3f}, robust {middle:.3f}"
            print(f"{name} again / first, log: {told}")
    p = np.array([patch.p for patch in tested if patch.p is not None])
    if len(p):
        print(
            "p of unchanged patches below 0.01, 0.05, 0.2, 0.5:",
            *(f"{(p < at).mean():.3f}" for at in (0.01, 0.05, 0.2, 0.5)),
        )
    shift = [math.hypot(one.registration.moved.x, one.registration.moved.y) for one in same]
    by = [one.registration.by for one in same]
    print(f"registration: {', '.join(f'{kind} {by.count(kind)}' for kind in sorted(set(by)))};", end=" ")
    print(f"error {np.median(shift):.3f} m median, {max(shift):.3f} m at most" if shift else "")


def _log_ratio(patch: PatchChange, name: str) -> float:
    figure = next((one for one in patch.differences if one.name == name), None)
    if figure is None or min(figure.before, figure.after) <= 5.0:
        return math.nan
    return math.log(figure.after / figure.before)


if __name__ == "__main__":
    main()
