"""What a comparison says of two surveys: false change where nothing changed, and planted change found.

    python perf/change.py --seed 81000 --worlds 40   the table of docs/survey.md; an hour on two cores
    python perf/change.py --seed 90000 --worlds 36 --kept runs/constants --constants
    python perf/change.py --worlds 4 --tables        the first worlds only, and of what is measured already

Of each world three missions of `belief` in dream-v1-noisy from different starts: two of the world as it is,
and one after a share of the individuals in one measured patch died, here and there in it. Held the other way
round that is as much of a gain. Surveys are kept in the folder of `--kept`, so that what is broken off goes
on. Comparisons are made anew each time. With `--constants` those of `Comparing` are found on these worlds,
and each quarter of them is told by what the others give. The 24 from seed 80_000 and the 36 from 90_000 on
chose them; the 40 from 81_000 on are told of in docs/survey.md.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.special import expit, logit
from scipy.stats import betabinom

from dream.evaluation.runner import simulate
from dream.evaluation.statistics import share_interval
from dream.planning import Belief
from dream.protocol import protocol_named
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.survey import Survey, files
from dream.survey.comparison import Z95, Comparing, Comparison, PatchChange
from dream.survey.measuring import About, measure_observations
from dream.types import Target

Array = npt.NDArray[np.float64]
FAMILIES = ("string", "patch", "fringing", "mixed")
SMALLEST = 60
"""Individuals: of a smaller patch no loss is planted."""


@dataclass(frozen=True, slots=True)
class Compared:
    """The comparisons of one world."""

    family: str
    same: Comparison
    """Two surveys of the world as it is."""
    lost: Comparison
    """Before and after a patch lost some."""
    gained: Comparison
    """The other way round."""
    patch: int
    """Which one, in the earlier survey of `lost`."""

    @property
    def loss(self) -> PatchChange:
        """What is said of that patch."""
        return next(one for one in self.lost.patches if one.before == self.patch)

    @property
    def gain(self) -> PatchChange:
        """The same, the other way round: of the part that has most of it."""
        parts = [one for one in self.gained.patches if self.patch in one.after]
        return max(parts, key=lambda one: one.come.of if one.come is not None else 0)

    @property
    def unchanged(self) -> list[PatchChange]:
        """All patches of the world as it is."""
        return [one for one in self.same.patches if one.p is not None]

    @property
    def spared(self) -> list[PatchChange]:
        """Patches beside the one that lost some."""
        return [one for one in self.lost.patches if one.p is not None and one.before != self.patch]


def main() -> None:
    """Fly, measure, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--worlds", type=int, default=24)
    parser.add_argument("--seed", type=int, action="append", help="of the first world; may be given again")
    parser.add_argument("--protocol", default="dream-v1-noisy")
    parser.add_argument("--share", type=float, default=0.2, help="of the individuals of a patch that die")
    parser.add_argument("--kept", type=Path, action="append", help="one for each seed, in their order")
    parser.add_argument("--tables", action="store_true", help="of what is measured already")
    parser.add_argument("--constants", action="store_true", help="found on these worlds, and tried on others")
    options = parser.parse_args()
    worlds = []
    for first, kept in zip(options.seed or [81_000], options.kept or [Path("runs/change")], strict=True):
        kept.mkdir(parents=True, exist_ok=True)
        for number in range(options.worlds):
            found = _surveys(options, kept, FAMILIES[number % 4], first + number)
            if found is not None:
                worlds.append((FAMILIES[number % 4], found))
    compared = [_compared(Comparing(), family, *found) for family, found in worlds]
    _tell(compared)
    if options.constants:
        print("constants:", _constants(compared))
        # Each quarter of the worlds is told by constants that were found on the others.
        told: list[Compared] = []
        for fold in range(4):
            others = [one for number, one in enumerate(compared) if number // 4 % 4 != fold]
            comparing = replace(Comparing(), **_constants(others))
            held = [one for number, one in enumerate(worlds) if number // 4 % 4 == fold]
            told += [_compared(comparing, family, *found) for family, found in held]
        print("by constants of other worlds:")
        _tell(told)


def _compared(
    comparing: Comparing, family: str, first: Survey, again: Survey, after: Survey, patch: int
) -> Compared:
    same, lost = comparing.compare(first, again), comparing.compare(first, after)
    return Compared(family, same, lost, comparing.compare(after, first), patch)


def _constants(compared: list[Compared]) -> dict[str, Any]:
    """Of `Comparing`: those that make what unchanged patches show likeliest."""
    patches = [patch for one in compared for patch in (*one.unchanged, *one.spared)]
    told = [missing for patch in patches for missing in (patch.gone, patch.come) if missing is not None]
    bare, of = np.array([(one.bare, one.of) for one in told]).T

    def missed(at: Array) -> float:
        rate, alike = expit(at)
        strength = 1.0 / alike - 1.0
        return -float(betabinom.logpmf(bare, of, rate * strength, (1.0 - rate) * strength).sum())

    rate, alike = expit(minimize(missed, logit([0.03, 0.003]), method="Nelder-Mead").x)
    constants = {"missed": float(rate), "alike": float(alike)}
    now = Comparing()
    for name, spread, least in (
        ("cover", "cover_spread", "cover_least"),
        ("found", "spread", None),
        ("target_area", "area_spread", None),
    ):
        figures = [one for patch in patches for one in patch.differences if one.name == name]
        change = np.array([one.change for one in figures])
        middle = np.array([0.5 * (one.before + one.after) for one in figures])
        error = np.array([(one.high - one.low) / (2.0 * Z95) for one in figures])
        chance = error**2 - (getattr(now, spread) * middle) ** 2
        if least is not None:
            chance = np.zeros(len(figures))

        def unlikely(
            at: Array, change: Array = change, middle: Array = middle, chance: Array = chance
        ) -> float:
            variance = chance + (np.exp(at[0]) * middle) ** 2 + (np.exp(2.0 * at[1]) if len(at) > 1 else 0.0)
            return float((np.log(variance) + change**2 / variance).sum())

        start = np.log([0.05] if least is None else [0.05, 0.1])
        best = np.exp(minimize(unlikely, start, method="Nelder-Mead").x)
        constants[spread] = float(best[0])
        if least is not None:
            constants[least] = float(best[1])
    return constants


def _surveys(
    options: argparse.Namespace, kept: Path, family: str, seed: int
) -> tuple[Survey, Survey, Survey, int] | None:
    world = make_world(f"reef/{family}", seed)
    first = _survey(options, kept, world, 0, f"{family}-{seed}-first")
    again = _survey(options, kept, world, 1, f"{family}-{seed}-again")
    if first is None or again is None:
        return None
    patch = _chosen(world, first)
    if patch is None:
        return None
    rng = np.random.default_rng(seed)
    there = np.flatnonzero(_inside(world, first, patch))
    dead = rng.choice(there, round(options.share * len(there)), replace=False)
    label = f"{family}-{seed}-less-{options.share:g}"
    after = _survey(options, kept, _without(world, dead), 2 % len(world.starts), label)
    return None if after is None else (first, again, after, patch)


def _survey(options: argparse.Namespace, kept: Path, world: World, start: int, label: str) -> Survey | None:
    path = kept / f"{label}-{options.protocol}{files.SUFFIX}"
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
    kept = ~np.isin(np.arange(len(world.targets)), dead)
    return replace(world, targets=world.targets.chosen(kept), hull=world.hull[kept])


def _tell(compared: list[Compared]) -> None:
    changed = ("gain", "loss", "mixed")
    for family in ("all", *FAMILIES):
        ours = [one for one in compared if family in ("all", one.family)]
        print(f"{family}: {len(ours)} worlds")
        for title, patches, verdicts in (
            ("false change, nothing changed", [patch for one in ours for patch in one.unchanged], changed),
            ("false change, another patch changed", [patch for one in ours for patch in one.spared], changed),
            ("planted loss found", [one.loss for one in ours], ("loss",)),
            ("planted gain found", [one.gain for one in ours], ("gain",)),
        ):
            found = sum(patch.verdict in verdicts for patch in patches)
            if patches:
                limits = share_interval(found, len(patches))
                print(f"  {title}: {found} of {len(patches)} ({limits.low:.3f} to {limits.high:.3f})")
    tested = [patch for one in compared for patch in one.unchanged]
    for name in ("found", "cover", "target_area"):
        ratios = np.array([_log_ratio(patch, name) for patch in tested])
        ratios = ratios[np.isfinite(ratios)]
        if len(ratios):
            middle = 1.4826 * float(np.median(np.abs(ratios - np.median(ratios))))
            told = f"mean {ratios.mean():+.3f}, sd {ratios.std():.3f}, robust {middle:.3f}"
            print(f"{name} again / first, log: {told}")
    p = np.array([patch.p for patch in tested])
    if len(p):
        print(
            "p of unchanged patches below 0.01, 0.05, 0.2, 0.5:",
            *(f"{(p < at).mean():.3f}" for at in (0.01, 0.05, 0.2, 0.5)),
        )
    for title, said in (
        ("loss", [one.loss.gone for one in compared]),
        ("gain", [one.gain.come for one in compared]),
    ):
        shares = [one.share for one in said if one is not None]
        if shares:
            print(f"share of a planted {title} that shows: {np.mean(shares):.3f}, sd {np.std(shares):.3f}")
    same = [one.same.registration for one in compared]
    shift = [math.hypot(one.moved.x, one.moved.y) for one in same]
    by = [one.by for one in same]
    print(f"registration: {', '.join(f'{kind} {by.count(kind)}' for kind in sorted(set(by)))};", end=" ")
    print(f"error {np.median(shift):.3f} m median, {max(shift):.3f} m at most" if shift else "")


def _log_ratio(patch: PatchChange, name: str) -> float:
    figure = next((one for one in patch.differences if one.name == name), None)
    if figure is None or min(figure.before, figure.after) <= 5.0:
        return math.nan
    return math.log(figure.after / figure.before)


if __name__ == "__main__":
    main()
