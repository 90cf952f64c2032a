"""UIVNav beside blind baselines, and what noise does to it: figures of docs/results/uivnav.md.

    dream bench test --protocol dream-v1 --planners uivnav random lawnmower --out bench/uivnav
    dream bench --world pool/arc --seeds 1001..1010 --planners uivnav random lawnmower --out bench/uivnav-pool
    dream bench paper --protocol dream-v1 --planners uivnav --out bench/uivnav-paper
    python perf/uivnav.py early bench/uivnav                      targets per metre in the first steps
    python perf/uivnav.py early bench/uivnav-pool
    python perf/uivnav.py table bench/uivnav-paper results/paper  in the form of the paper's Table I
    python perf/uivnav.py noise                                   9 reefs of dev → results/uivnav/noise.jsonl
    python perf/uivnav.py draw                                    → docs/uivnav-noise.svg
    python perf/uivnav.py speed                                   milliseconds a decision

A folder may hold some of the planners and another one the rest, and some may be flown for fewer steps.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from scipy import ndimage

from dream.evaluation import published, statistics
from dream.evaluation.figures import Picture, Theme
from dream.evaluation.metrics import Scorer
from dream.evaluation.results import Row, Trace, read_results
from dream.evaluation.runner import simulate
from dream.evaluation.suites import LETTERS, REEF_FAMILIES, family_of
from dream.mapping import OccupancyMap
from dream.planning import PLANNERS, AnyPlanner, UivNav
from dream.protocol import protocol_named
from dream.sim.render import Renderer
from dream.sim.visibility import Visibility
from dream.sim.worlds import make_world
from dream.types import LOOK_AROUND, Decision, Float32Array, Label, Mission, Observation, UInt8Array

Array = npt.NDArray[np.float64]
Mission_ = tuple[Row, Trace]
OURS = "uivnav"
EARLY = 60
"""Steps within which a planner without a memory has to show what it can."""
METRES = (25.0, 50.0, 75.0)
IOUS = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4)
DEPTH_ERRORS = (0.1, 0.2, 0.3, 0.5)
LONG = 100
"""Steps of a mission with noise."""
PATCH = 6.0, 16.0
"""Pixels of 320: how wide the patches are in which labels, and depths, are wrong together."""
NOISE = Path("results/uivnav/noise.jsonl")


def missions(folders: Sequence[Path]) -> dict[str, dict[tuple[str, int, int], Mission_]]:
    """Finished missions of some folders, by planner and case; the first folder that has one counts."""
    found: dict[str, dict[tuple[str, int, int], Mission_]] = defaultdict(dict)
    for folder in folders:
        results = read_results(folder)
        for row in results.rows:
            key = row.world, row.seed, row.start
            found[row.planner].setdefault(key, (row, results.traces[row.key]))
    return found


def travelled(trace: Trace) -> Array:
    """(n + 1,) metres since the start, straight from step to step."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(trace.x), np.diff(trace.y)))])


def per_metre(mission: Mission_) -> tuple[float, float]:
    """Individuals first seen, and metres travelled, after the look-around and within the first steps.

    The look-around is the same for everybody and takes no metre.
    """
    row, trace = mission
    last = min(EARLY, len(trace) - 1)
    share = trace.instances[last] - trace.instances[min(LOOK_AROUND, last)]
    return float(share) * (row.countable or 0), float(travelled(trace)[last])


def after_metres(mission: Mission_, metres: float) -> float:
    """Share of the individuals seen by then; at the end where a mission is shorter."""
    _, trace = mission
    return float(trace.instances[np.searchsorted(travelled(trace), metres + 1e-9) - 1])


def groups(keys: Sequence[tuple[str, int, int]]) -> dict[str, list[tuple[str, int, int]]]:
    """Cases by title: reefs together, then each family."""
    families = list(dict.fromkeys(family_of(world) for world, _, _ in keys))
    reefs = [key for key in keys if family_of(key[0]) not in ("wreck", "pool", "flat")]
    found = {"reefs": reefs} if reefs else {}
    return found | {name: [key for key in keys if family_of(key[0]) == name] for name in families}


def told(
    values: Array,
    strata: Sequence[str],
    digits: int = 2,
    limits: tuple[float, float] = (-math.inf, math.inf),
) -> str:
    """A mean with its interval; see `statistics.interval`."""
    got = statistics.interval(values, strata, statistics.mean, limits=limits)
    return f"{got.value:.{digits}f} [{got.low:.{digits}f}, {got.high:.{digits}f}]"


def early(folders: Sequence[Path]) -> None:
    """Print targets per metre, the share seen by metres travelled, and where it lands."""
    flown = missions(folders)
    others = [name for name in flown if name != OURS]
    keys = sorted(set.intersection(*(set(each) for each in flown.values())))
    rates = {
        name: {key: seen / max(way, 1e-9) for key in keys for seen, way in [per_metre(flown[name][key])]}
        for name in flown
    }
    names = [OURS, *others]
    columns = ["worlds", *names, *(f"{OURS} − {name}" for name in others), *(f"÷ {name}" for name in others)]
    print(f"Individuals first seen per metre, after the look-around, within {EARLY} steps; mean of worlds\n")
    print(f"| {' | '.join(columns)} |\n|---|{'--:|' * (len(columns) - 1)}")
    for title, members in groups(keys).items():
        strata = [family_of(key[0]) for key in members]
        mine = np.array([rates[OURS][key] for key in members])
        cells = [f"{title} ({len(members)})", f"{mine.mean():.2f}"]
        theirs = {name: np.array([rates[name][key] for key in members]) for name in others}
        cells += [f"{values.mean():.2f}" for values in theirs.values()]
        cells += [told(mine - values, strata) for values in theirs.values()]
        cells += [f"{mine.mean() / values.mean():.2f}" for values in theirs.values()]
        print(f"| {' | '.join(cells)} |")
    print("\nShare of the individuals seen by metres travelled, %\n")
    columns = ["worlds", "metres", *names, *(f"{OURS} − {name}" for name in others)]
    print(f"| {' | '.join(columns)} |\n|---|{'--:|' * (len(columns) - 1)}")
    for title, members in groups(keys).items():
        if title not in ("reefs", "wreck", "pool"):
            continue
        strata = [family_of(key[0]) for key in members]
        for metres in METRES:
            by = {
                name: 100.0 * np.array([after_metres(flown[name][key], metres) for key in members])
                for name in names
            }
            cells = [
                f"{title} ({len(members)})",
                f"{metres:g}",
                *(f"{by[name].mean():.1f}" for name in names),
            ]
            cells += [told(by[OURS] - by[name], strata, 1) for name in others]
            print(f"| {' | '.join(cells)} |")
    print(f"\nWhere {OURS} lands, and how\n")
    print(
        "| worlds | steps | instances, % | clusters, % | area, % | stopped by itself | contacts | guarded |"
    )
    print(f"|---|{'--:|' * 7}")
    every = sorted(flown[OURS])
    for title, members in groups(every).items():
        rows = [flown[OURS][key][0] for key in members]
        strata = [family_of(key[0]) for key in members]
        cells = [f"{title} ({len(rows)})", f"{np.mean([row.steps for row in rows]):.1f}"]
        for name in ("instances", "clusters", "area"):
            cells.append(
                told(100.0 * np.array([getattr(row, name) for row in rows]), strata, 1, (0.0, 100.0))
            )
        cells.append(str(sum(row.t_stop is not None for row in rows)))
        cells.append(str(sum(row.collisions for row in rows)))
        cells.append(f"{100.0 * np.mean([row.guarded / row.steps for row in rows]):.0f} % of steps")
        print(f"| {' | '.join(cells)} |")


def table(folders: Sequence[Path]) -> None:
    """Print methods with steps and coverage, ours in our worlds and the paper's in its own.

    Steps to the planner's own stop, the cap without one. Of reefs the share of individuals is seen, of wrecks
    that of their surface.
    """
    flown = missions(folders)
    print("| method | reefs: steps | reefs: coverage, % | wrecks: steps | wrecks: coverage, % |")
    print("|---|--:|--:|--:|--:|")
    for name, of_it in flown.items():
        title = f"UIVNav, re-implemented (`{name}`)" if name == OURS else f"`{name}`"
        cells = [title]
        for is_wreck in (False, True):
            rows = [
                row for (world, _, _), (row, _) in of_it.items() if (family_of(world) == "wreck") == is_wreck
            ]
            if rows:
                steps = [
                    protocol_named(row.protocol).cap if row.t_stop is None else row.t_stop for row in rows
                ]
                cells.append(f"{np.mean(steps):.1f}")
                seen = [row.area if is_wreck else row.instances for row in rows]
                cells.append(f"{100.0 * np.mean(seen):.2f}")
            else:
                cells += ["–", "–"]
        print(f"| {' | '.join(cells)} |")
    wrecks = {method.name: method for method in published.WRECKS}
    for method in published.REEFS:
        cells = [f"{method.name}, as published", f"{method.steps:g}", f"{method.coverage:g}"]
        other = wrecks.get(method.name)
        cells += [f"{other.steps:g}", f"{other.coverage:g}"] if other else ["–", "–"]
        print(f"| {' | '.join(cells)} |")


# ------------------------------------------------------------------------------------------------- noise


def field(shape: tuple[int, ...], width: float, rng: np.random.Generator) -> Array:
    """(H, W) of mean 0 and spread 1, alike within patches of some width."""
    smooth = ndimage.gaussian_filter(rng.normal(size=shape), width)
    return np.asarray((smooth - smooth.mean()) / smooth.std())


def with_iou(labels: UInt8Array, iou: float, rng: np.random.Generator) -> UInt8Array:
    """Labels whose target overlaps the true one by that intersection over union.

    As many pixels are missed as are taken for target, in patches: of a target T a share r each, so that
    IoU = (1 − r) / (1 + r). A frame without target stays as it is.
    """
    found = labels.copy()
    target = labels == Label.TARGET
    wrong = round(target.sum() * (1.0 - iou) / (1.0 + iou))
    if wrong == 0:
        return found
    order = np.argsort(field(labels.shape, PATCH[0], rng), axis=None)[::-1]
    missed = order[target.flat[order]][:wrong]
    false = order[(labels == Label.SEABED).flat[order]][:wrong]
    found.flat[missed] = Label.SEABED
    found.flat[false] = Label.TARGET
    return found


def with_depth_error(depth: Float32Array, error: float, rng: np.random.Generator) -> Float32Array:
    """Depths that are wrong by a factor, alike within patches, as a network's are: z · exp(error · field)."""
    if error == 0.0:
        return depth
    return np.asarray(depth * np.exp(error * field(depth.shape, PATCH[1], rng)), np.float32)


@dataclass(frozen=True)
class Misled:
    """A planner that is shown worse frames than the map."""

    planner: AnyPlanner
    iou: float
    depth_error: float
    seed: int

    def begin(self, mission: Mission) -> _Misled:
        """A pilot whose noise is the same for the same seed."""
        return _Misled(self, self.planner.begin(mission), np.random.default_rng(self.seed))


@dataclass
class _Misled:
    of: Misled
    pilot: Any
    rng: np.random.Generator

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        labels = with_iou(observation.labels, self.of.iou, self.rng)
        depth = with_depth_error(observation.depth, self.of.depth_error, self.rng)
        decision: Decision = self.pilot.decide(replace(observation, labels=labels, depth=depth), occupancy)
        return decision


def noise(out: Path, weights: str | None) -> None:
    """Fly what is missing in the file, world by world."""
    kinds = [*(f"reef/{family}" for family in REEF_FAMILIES), *(f"reef/{letter}" for letter in LETTERS)]
    cases = [(kind, 101) for kind in kinds]
    shown = [(1.0, 0.0), *((iou, 0.0) for iou in IOUS[1:]), *((1.0, error) for error in DEPTH_ERRORS)]
    out.parent.mkdir(parents=True, exist_ok=True)
    kept = [json.loads(line) for line in out.read_text().splitlines()] if out.is_file() else []
    have = {(k["planner"], k["world"], k["seed"], k["iou"], k["depth_error"]) for k in kept}
    planners: list[tuple[str, AnyPlanner, float, float]] = [("random", PLANNERS["random"], 1.0, 0.0)]
    planners += [(OURS, UivNav(weights=weights), iou, error) for iou, error in shown]
    for world_name, seed in cases:
        missing = [p for p in planners if (p[0], world_name, seed, p[2], p[3]) not in have]
        if not missing:
            continue
        world = make_world(world_name, seed)
        protocol = protocol_named(world.protocol)
        visibility, renderer = Visibility(world, protocol), Renderer(world)
        for name, planner, iou, error in missing:
            scorer = Scorer(world, protocol, visibility=visibility, renderer=renderer)
            misled = Misled(planner, iou, error, seed)
            steps = simulate(
                world, misled, protocol, max_steps=LONG, renderer=renderer, solids=visibility.solids
            )
            shares, metres = zip(
                *((scorer.add(step).instances, step.arrival.distance) for step in steps), strict=True
            )
            line = {
                "planner": name,
                "world": world_name,
                "seed": seed,
                "iou": iou,
                "depth_error": error,
                "seen_early": (shares[EARLY] - shares[LOOK_AROUND]) * scorer.summary()["countable"],
                "metres_early": sum(metres[: EARLY + 1]),
                "coverage": shares[-1],
            }
            with out.open("a") as file:
                file.write(json.dumps(line) + "\n")
        print(f"{world_name} {seed}", flush=True)


def whole(kept: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Missions of the worlds in which all were flown, so that levels are compared on the same worlds."""
    count: dict[tuple[str, int], int] = defaultdict(int)
    for k in kept:
        count[k["world"], k["seed"]] += 1
    every = 1 + len(IOUS) + len(DEPTH_ERRORS)
    return [k for k in kept if count[k["world"], k["seed"]] == every]


def curve(kept: Sequence[dict[str, Any]], what: str, key: str) -> Iterator[tuple[float, Array, list[str]]]:
    """Of each level of a kind of noise, the least first: the level, a value for each world, the families."""
    rest = {"iou": ("depth_error", 0.0), "depth_error": ("iou", 1.0)}[key]
    ours = [k for k in kept if k["planner"] == OURS and k[rest[0]] == rest[1]]
    for level in sorted({k[key] for k in ours}, reverse=key == "iou"):
        of_it = sorted((k for k in ours if k[key] == level), key=lambda k: (k["world"], k["seed"]))
        yield level, np.array([value(k, what) for k in of_it]), [family_of(k["world"]) for k in of_it]


def value(mission: dict[str, Any], what: str) -> float:
    """One number of a mission."""
    if what == "coverage":
        return 100.0 * float(mission["coverage"])
    return float(mission["seen_early"] / max(mission["metres_early"], 1e-9))


def draw(kept: Sequence[dict[str, Any]], theme: Theme) -> Figure:
    """Two panels for labels, two for depth; means with intervals, and the random walk as a line."""
    figure = Figure(figsize=(9.6, 5.6), layout="constrained", facecolor=theme.ground)
    grid = figure.subplots(2, 2, sharey="row")
    whats = {
        "rate": f"individuals per metre,\nfirst {EARLY} steps",
        "coverage": f"seen after {LONG} steps, %",
    }
    keys = {
        "iou": "intersection over union of the target's labels",
        "depth_error": "depth error, share of depth",
    }
    for axes_row, (what, title) in zip(grid, whats.items(), strict=True):
        walk = [value(k, what) for k in kept if k["planner"] == "random"]
        for axes, (key, below) in zip(axes_row, keys.items(), strict=True):
            levels, means, lows, highs = [], [], [], []
            for level, values, strata in curve(kept, what, key):
                limits = (0.0, 100.0) if what == "coverage" else (0.0, math.inf)
                got = statistics.interval(values, strata, statistics.mean, limits=limits)
                levels.append(level)
                means.append(got.value)
                lows.append(got.value - got.low)
                highs.append(got.high - got.value)
            axes.errorbar(
                levels,
                means,
                yerr=[lows, highs],
                color=theme.tracks[0],
                marker="o",
                ms=4,
                capsize=2.5,
                elinewidth=0.9,
                label="UIVNav, re-implemented",
            )
            axes.axhline(float(np.mean(walk)), color=theme.soft, linestyle=(0, (2, 3)), label="random walk")
            if key == "iou":
                axes.invert_xaxis()
                axes.set_ylabel(title)
            if what == "coverage":
                axes.set_xlabel(below)
            axes.set_ylim(bottom=0.0)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


def levels(kept: Sequence[dict[str, Any]]) -> None:
    """Print what is drawn."""
    print("| noise | level | individuals per metre | against none | seen, % | against none |")
    print(f"|---|{'--:|' * 5}")
    for key in ("iou", "depth_error"):
        rates, seen = list(curve(kept, "rate", key)), list(curve(kept, "coverage", key))
        for (level, rate, strata), (_, share, _) in zip(rates, seen, strict=True):
            cells = [key.replace("_", " "), f"{level:g}", told(rate, strata)]
            cells.append(told(rate - rates[0][1], strata) if level != rates[0][0] else "")
            cells.append(told(share, strata, 1, (0.0, 100.0)))
            cells.append(told(share - seen[0][1], strata, 1) if level != rates[0][0] else "")
            print(f"| {' | '.join(cells)} |")
    for what in ("rate", "coverage"):
        walk = [value(k, what) for k in kept if k["planner"] == "random"]
        print(f"random walk, {what}: {np.mean(walk):.2f} over {len(walk)} worlds")


def speed(weights: str | None) -> None:
    """Print how long a decision takes, on the frames of one mission, again and again."""
    world = make_world("reef/string", 101)
    protocol = protocol_named(world.protocol)
    planner = UivNav(weights=weights)
    steps = list(simulate(world, planner, protocol, max_steps=40))
    pilot = planner.begin(Mission(protocol, world.bounds, 200))
    spent = []
    for step in [*steps[:5], *steps * 25]:
        wall, cpu = time.perf_counter(), time.process_time()
        pilot.decide(step.observation, step.occupancy)
        spent.append((time.perf_counter() - wall, time.process_time() - cpu))
    for name, times in zip(("wall", "processor"), 1e3 * np.array(spent[5:]).T, strict=True):
        p50, p99 = np.percentile(times, [50, 99])
        print(f"{len(times)} decisions, {name}: p50 {p50:.2f} ms, p99 {p99:.2f} ms")


def main() -> int:
    """Do what was asked."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("early", "table", "noise", "draw", "speed"))
    parser.add_argument("folders", type=Path, nargs="*", help="of benchmarks")
    parser.add_argument("--noise", type=Path, default=NOISE, help="file of the missions with noise")
    parser.add_argument("--picture", type=Path, default=Path("docs/uivnav-noise.svg"))
    parser.add_argument("--weights", help="another network")
    options = parser.parse_args()
    if options.what in ("early", "table"):
        if not options.folders:
            parser.error("expected one or more folders of benchmarks")
        (early if options.what == "early" else table)(options.folders)
    elif options.what == "noise":
        noise(options.noise, options.weights)
    elif options.what == "speed":
        speed(options.weights)
    else:
        kept = whole([json.loads(line) for line in options.noise.read_text().splitlines()])
        levels(kept)
        picture = Picture("uivnav-noise", "What noise does to UIVNav", "", lambda theme: draw(kept, theme))
        options.picture.write_bytes(picture.svg())
        print(f"written: {options.picture}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
