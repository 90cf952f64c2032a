"""What an earlier survey is worth: `belief` on a reef a year on, with the survey of then and without.

    python perf/revisit.py                    dev-like worlds of four families; hours on a busy machine
    python perf/revisit.py --seeds 101 102    only some
    python perf/revisit.py --kind other       with the survey of another reef; also shift, empty, came
    python perf/revisit.py --whole            fly with a survey to the own stop too, not only to 98.26 %
    python perf/revisit.py --years 3          after three years; --protocol dream-v1-noisy: both under noise
    python perf/revisit.py --sigma 0.1        as if the survey did not know its place to 0.1 m
    python perf/revisit.py --clairvoyant 60   and search a minute a world for the tour of one who knows it

The survey is measured as `dream survey add` does it, and told as `dream run --from-survey` does. Missions are
kept in `--out` as they end, so that the same call goes on where it was, and those that end at 98.26 % apart
from those that end at their own stop. Ratios are of steps to 98.26 %, in pairs, 200 where it was never
reached; see docs/survey.md.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import astuple, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.progress import track
from scipy.ndimage import label

from dream.evaluation.metrics import COMPLETE, Scorer
from dream.evaluation.oracle.bounds import bound
from dream.evaluation.runner import simulate
from dream.evaluation.suites import REEF_FAMILIES
from dream.geometry import Bounds
from dream.mapping import OccupancyMap, within
from dream.mapping.prior import Prior
from dream.planning import Belief
from dream.protocol import DREAM_V1, SurveyProtocol, protocol_named
from dream.sim.worlds import make_world
from dream.survey import Survey, files
from dream.survey.measuring import About, measure_observations
from dream.survey.prior import prior_of
from dream.types import BoolArray

KINDS = ("right", "other", "shift", "empty", "came")
SHIFT = 4.0
"""Metres east and north by which a survey is told in the wrong place."""
BEGAN = datetime(2026, 1, 1, tzinfo=UTC)
"""Of every survey; the mission that comes back is so many years later."""
APART = 3.0
"""Metres between groups: a survey of the kind `came` says of the one farthest off that it was bare ground."""


def fly(
    name: str,
    seed: int,
    keep: Path,
    prior: Prior | None = None,
    *,
    planner: Belief | None = None,
    protocol: SurveyProtocol = DREAM_V1,
    whole: bool = True,
) -> dict[str, Any]:
    """One mission, or its record where it was flown before; its map lies beside it.

    To its own stop, or only until 98.26 % are seen.
    """
    if keep.exists():
        return dict(json.loads(keep.read_text()))
    world = make_world(name, seed)
    scorer = Scorer(world, protocol)
    for step in simulate(world, planner or Belief(), protocol, prior=prior):
        scorer.add(step)
        if not whole and scorer.summary()["t98"] is not None:
            break
    step.occupancy.save(keep.with_suffix(".npz"))
    summary = scorer.summary()
    told = {key: summary[key] for key in ("t90", "t98", "t_stop", "collisions", "planner_ms")}
    told["seen"] = summary["coverage"]["instances"]
    keep.write_text(json.dumps(told))
    return told


def survey_of(name: str, seed: int, keep: Path, protocol: SurveyProtocol) -> Survey:
    """The survey of a mission to its own stop, or that which was kept; its map lies beside it."""
    kept = keep.with_suffix(".survey.npz")
    if not kept.exists():
        seen = []
        for step in simulate(make_world(name, seed), Belief(), protocol):
            seen.append(step.observation)
        step.occupancy.save(keep.with_suffix(".npz"))
        files.write(measure_observations(seen, step.occupancy, About(keep.stem, BEGAN)), kept)
    return files.read(kept)


def told_wrong(survey: Survey, kind: str, keep: Path) -> Survey:
    """The same survey, wrong in one of the ways; `keep` is that of `survey_of`."""
    layers = survey.layers
    told = layers.target_probability.copy()
    if kind == "empty":
        told[~np.isnan(told)] = 0.0
    if kind == "came":
        told[farthest_group(OccupancyMap.load(keep.with_suffix(".npz"))) & ~np.isnan(told)] = 0.0
    bounds = layers.bounds
    if kind == "shift":
        bounds = Bounds(*(side + SHIFT for side in astuple(bounds)))
    return replace(survey, layers=replace(layers, bounds=bounds, target_probability=told))


def clairvoyant(name: str, seed: int, keep: Path, budget_s: float) -> tuple[int, int]:
    """Steps to 98.26 % of one who knows the reef: lower bound, and best known tour or the cap."""
    if not keep.exists():
        found = bound(make_world(name, seed), DREAM_V1, budget_s=budget_s).t98
        keep.write_text(json.dumps([found.lower_bound, found.best_tour or DREAM_V1.cap]))
    fewest, tour = json.loads(keep.read_text())
    return fewest, tour


def farthest_group(occupancy: OccupancyMap) -> BoolArray:
    """(rows, cols) on and around the group of targets whose nearest cell is farthest from the origin."""
    cell = occupancy.protocol.cell
    near = within(occupancy.target, 0.5 * APART, cell)
    parts, count = label(near, np.ones((3, 3)))
    x, y = occupancy.center_of(*np.nonzero(occupancy.target))
    away, part_of = np.hypot(x, y), parts[occupancy.target]
    farthest = max(range(1, count + 1), key=lambda part: away[part_of == part].min())
    return np.asarray(parts == farthest)


def draw(rows: dict[str, list[list[float]]], path: Path) -> None:
    """A picture of the pairs: without a survey to the right, with one upwards."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams["svg.hashsalt"] = "revisit"
    figure, axes = plt.subplots(figsize=(5.0, 5.0), layout="constrained")
    most = 1.05 * max(max(row[:2]) for of_family in rows.values() for row in of_family)
    for share, said in ((1.0, "as without"), (0.6, "60 %")):
        axes.plot([0.0, most], [0.0, share * most], color="0.7", lw=1.0)
        axes.text(0.93 * most, 0.93 * share * most, said, color="0.4", ha="right", va="bottom")
    for family, of_family in rows.items():
        told = np.array(of_family)
        axes.scatter(told[:, 1], told[:, 0], s=28, label=family)
    axes.set(xlim=(0, most), ylim=(0, most), aspect="equal")
    axes.set(xlabel="steps to 98.26 % without a survey", ylabel="with an earlier survey")
    axes.legend(frameon=False, loc="upper left")
    figure.savefig(path, metadata={"Date": None})


def say_clairvoyant(rows: npt.NDArray[np.float64]) -> None:
    """Print how near a mission with a survey comes to one who knows the reef as it is."""
    told, without, fewest, tour = rows[:, [0, 1, -2, -1]].T
    print("\n| to 98.26 % | steps | median ratio to without | ratio of the means |\n|---|--:|--:|--:|")
    for title, steps in (
        ("with a survey", told),
        ("best known tour of one who knows the reef", tour),
        ("certified: no tour takes fewer", fewest),
    ):
        ratio = np.median(steps / without), steps.sum() / without.sum()
        print(f"| {title} | {steps.mean():.1f} | {ratio[0]:.2f} | {ratio[1]:.2f} |")
    print(f"\nwith a survey, to the best known tour: median {np.median(told / tour):.2f}")


def main() -> int:
    """Fly what is missing and print a line a family."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=range(101, 111))
    parser.add_argument("--kind", choices=KINDS, default="right")
    parser.add_argument("--whole", action="store_true", help="to the own stop; else to 98.26 %%")
    parser.add_argument("--arriving", type=float, default=Belief().arriving, help="of the planner")
    parser.add_argument("--years", type=int, default=1, help="between the survey and the mission")
    parser.add_argument("--sigma", type=float, help="metres that the survey may err by; else its own word")
    parser.add_argument("--protocol", choices=(DREAM_V1.name, "dream-v1-noisy"), default=DREAM_V1.name)
    parser.add_argument("--clairvoyant", type=float, metavar="SECONDS", help="of processor time a world")
    parser.add_argument("--out", type=Path, default=Path("bench/revisit"))
    parser.add_argument("--picture", type=Path, help="file to draw the pairs to")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    protocol = protocol_named(options.protocol)
    if options.years < 1:
        parser.error(f"--years: expected 1 or more, got {options.years}")
    cases = [(family, seed) for seed in options.seeds for family in REEF_FAMILIES]
    rows: dict[str, list[list[float]]] = {}
    for family, seed in track(cases, description=options.kind, transient=True):
        first, later = f"reef/{family}", f"reef/{family}+{options.years}y1"
        of = seed if options.kind != "other" else options.seeds[0] + (seed - options.seeds[0] + 1) % 5
        under = "" if protocol == DREAM_V1 else f"{protocol.name}-"
        on = f"{under}{family}-{seed}" + ("" if options.years == 1 else f"-{options.years}y")
        before = options.out / f"{under}{family}-{of}-before"
        survey = told_wrong(survey_of(first, of, before, protocol), options.kind, before)
        without = fly(later, seed, options.out / f"{on}-without.json", protocol=protocol)
        bounds = make_world(later, seed).bounds
        now = BEGAN + timedelta(days=365.25 * options.years)
        prior = prior_of(survey, bounds, protocol.cell, now=now)
        if options.sigma is not None:
            prior = replace(prior, sigma=options.sigma)
        planner = Belief(arriving=options.arriving)
        flown = f"{options.kind}-{options.arriving:g}-{prior.sigma:g}m{'-whole' if options.whole else ''}"
        keep = options.out / f"{on}-{flown}.json"
        with_it = fly(later, seed, keep, prior, planner=planner, protocol=protocol, whole=options.whole)
        pair = [mission[key] or DREAM_V1.cap for key in ("t98", "t_stop") for mission in (with_it, without)]
        pair += [mission["seen"] < COMPLETE for mission in (with_it, without)]
        if options.clairvoyant is not None:
            keep = options.out / f"{on}-clairvoyant-{options.clairvoyant:g}.json"
            pair += clairvoyant(later, seed, keep, options.clairvoyant)
        rows.setdefault(family, []).append(pair)
    head = ["worlds", "with", "without", "median ratio", "ratio of the means"]
    head += ["own stop with", "without", "missed with", "without"] if options.whole else []
    print(f"| {' | '.join(head)} |\n|---|{'--:|' * (len(head) - 1)}")
    everything = [row for of_family in rows.values() for row in of_family]
    for title, chosen in [("all", everything), *rows.items()]:
        table = np.array(chosen, float)
        mean = table.mean(axis=0)
        ratios = float(np.median(table[:, 0] / table[:, 1])), mean[0] / mean[1]
        cells = [f"{title} ({len(table)})", *(f"{k:.1f}" for k in mean[:2]), *(f"{k:.2f}" for k in ratios)]
        if options.whole:
            cells += [*(f"{k:.1f}" for k in mean[2:4]), *(f"{k:.0f}" for k in table[:, 4:6].sum(axis=0))]
        print(f"| {' | '.join(cells)} |")
    if options.picture is not None:
        draw(rows, options.picture)
    if options.clairvoyant is not None:
        say_clairvoyant(np.array(everything, float))
    return 0


if __name__ == "__main__":
    sys.exit(main())
