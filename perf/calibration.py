"""Does what the planner `belief` expects come true: the probability of a target in a cell, on reefs of `dev`.

    python perf/calibration.py                                   four minutes on two cores
    python perf/calibration.py --out docs/calibration.svg        and the curve as a picture
    python perf/calibration.py --protocol dream-v1-noisy

Each world is flown once to the end of all doubt. At every fifth decision each cell that was not observed, and
that was by the end, is a forecast, held against whether it was a target cell in the end. Beside known targets
the forecast is the planner's kernel estimate. Anywhere else it is that of a cell in a group of the size that
it searches for, whose middle lies where one could hide: 1 − exp(−λ A), with λ the groups to be expected per
square metre and A the ground within that size where a middle could hide. Hints from beyond the reach are left
out, of which `perf/stop.py` tells how often they come true.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.signal import fftconvolve

from dream.evaluation.calibration import NOTHING, Bin, ForecastTally, brier, reliability_curve, tally
from dream.evaluation.engines import Failure, Processes, processors
from dream.evaluation.figures import Picture, Theme
from dream.evaluation.suites import Case, family_of, suite_named
from dream.mapping import OccupancyMap, within
from dream.mission import explore
from dream.planning import Belief
from dream.planning.belief import BeliefPilot
from dream.planning.distribution import expectation
from dream.planning.sources import Expected, Situation
from dream.protocol import protocol_named
from dream.robots import Teleport
from dream.sim.worlds import make_world
from dream.types import BoolArray
from dream.types import Mission as MissionBrief

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EVERY = 5
"""Decisions from one look at the forecasts to the next."""
BESIDE, ANYWHERE = "beside known targets", "anywhere else"


@dataclass(frozen=True, slots=True, eq=False)
class _Forecast:
    """What was told at one decision."""

    unseen: BoolArray
    """(rows, cols)."""
    near: BoolArray
    """(rows, cols) beside known targets."""
    told: npt.NDArray[np.floating[Any]]
    """(rows, cols) probability of a target."""
    expected: float
    """Square metres of targets that its words say are to be expected beside known ones."""


@dataclass(slots=True)
class _WatchedPilot(BeliefPilot):
    forecasts: list[_Forecast | None] = field(kw_only=True)

    def expect(self, situation: Situation) -> Expected:
        expected = BeliefPilot.expect(self, situation)
        told = len(self.forecasts) % EVERY == 0
        self.forecasts.append(self._forecast(situation.occupancy, expected) if told else None)
        return expected

    def _forecast(self, occupancy: OccupancyMap, expected: Expected) -> _Forecast:
        planner, protocol = self.planner, self.mission.protocol
        kernel = planner.kernel * protocol.group_radius
        near = within(occupancy.target, 2.0 * kernel, protocol.cell)
        beside = expectation(occupancy, kernel, planner.prior, planner.prior_weight, near)
        size = planner.size_of_groups(self.mission)
        anywhere = in_a_group(expected.hiding, expected.to_come, size, protocol.cell)
        return _Forecast(
            ~occupancy.observed & occupancy.to_see,
            near,
            np.where(near, beside, anywhere),
            float(expected.beside.sum()) * protocol.cell**2,
        )


def in_a_group(hiding: BoolArray, groups: float, radius: float, cell: float) -> npt.NDArray[np.float64]:
    """(rows, cols) probability that a cell lies in a hidden group.

    Args:
        hiding: (rows, cols) cells where the middle of one could be.
        groups: How many are to be expected in all of them.
        radius: Of a group, metres.
        cell: Side of a cell, metres.
    """
    many = np.count_nonzero(hiding)
    if not many:
        return np.zeros(hiding.shape)
    far = int(radius / cell)
    north, east = np.mgrid[-far : far + 1, -far : far + 1]
    around = fftconvolve(hiding.astype(np.float64), (np.hypot(north, east) * cell <= radius) * 1.0, "same")
    return np.asarray(1.0 - np.exp(-groups / many * np.clip(np.rint(around), 0.0, None)))


@dataclass(frozen=True, slots=True)
class _Watched:
    """The planner, which does not stop while there is doubt, and what it told."""

    forecasts: list[_Forecast | None] = field(default_factory=list)

    def begin(self, mission: MissionBrief) -> _WatchedPilot:
        planner = Belief(risk=0.0, glimpse=1.0)
        return _WatchedPilot(planner, mission, planner.look_ahead, forecasts=self.forecasts)


@dataclass(frozen=True, slots=True)
class Flown:
    """What one mission's forecasts came to."""

    beside: ForecastTally
    anywhere: ForecastTally
    area: tuple[tuple[float, float], ...]
    """At each look: square metres of targets to be expected beside known ones, by its words; and how many
    there were."""


def flown(task: tuple[Case, str]) -> Flown:
    """Fly a mission to the end of all doubt and hold what was told against the last map."""
    case, name = task
    protocol, world = protocol_named(name), make_world(case.world, case.seed)
    planner, occupancy = _Watched(), OccupancyMap(world.bounds, protocol)
    for _ in explore(Teleport(world, protocol, world.starts[case.start]), planner, occupancy):
        pass
    beside = anywhere = NOTHING
    area: list[tuple[float, float]] = []
    for forecast in filter(None, planner.forecasts):
        known = forecast.unseen & occupancy.observed
        near, far = known & forecast.near, known & ~forecast.near
        beside += tally(forecast.told[near], occupancy.target[near])
        anywhere += tally(forecast.told[far], occupancy.target[far])
        if forecast.near.any():
            came = np.count_nonzero(occupancy.target & near) * protocol.cell**2
            area.append((forecast.expected, float(came)))
    return Flown(beside, anywhere, tuple(area))


def draw(curves: dict[str, list[Bin]], theme: Theme) -> Figure:
    """What came true of what was told, on logarithmic axes: most of it is unlikely."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.6), layout="constrained", facecolor=theme.ground)
    axes = figure.add_subplot()
    axes.plot(
        [1e-3, 1.0], [1e-3, 1.0], color=theme.soft, linewidth=0.9, linestyle=(0, (5, 3)), label="as told"
    )
    for colour, mark, (name, curve) in zip(theme.tracks, "os", curves.items(), strict=False):
        shown = [point for point in curve if point.told >= 1e-3 and point.true.low > 0.0]
        true = np.array([point.true.value for point in shown])
        low, high = (np.array([getattr(point.true, end) for point in shown]) for end in ("low", "high"))
        axes.errorbar(
            [point.told for point in shown],
            true,
            yerr=np.maximum([true - low, high - true], 0.0),
            color=colour,
            marker=mark,
            markersize=5,
            linewidth=1.4,
            elinewidth=0.9,
            capsize=2.5,
            label=name,
        )
    axes.set(xscale="log", yscale="log", xlim=(1e-3, 1.0), ylim=(1e-3, 1.0))
    ticks = [0.001, 0.01, 0.1, 1.0]
    axes.set_xticks(ticks, [f"{100.0 * tick:g} %" for tick in ticks])
    axes.set_yticks(ticks, [f"{100.0 * tick:g} %" for tick in ticks])
    axes.set_xlabel("probability of a target that was told of unseen cells")
    axes.set_ylabel("share of them that were target cells")
    axes.set_aspect("equal")
    axes.legend(loc="upper left", frameon=False)
    return figure


def main() -> int:
    """Fly all, print the tables, and draw the curve."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--protocol", default="dream-v1")
    parser.add_argument("--out", type=Path, help="where to leave the picture")
    parser.add_argument("--jobs", type=int, default=processors(), help="missions at a time")
    options = parser.parse_args()
    cases = [case for case in suite_named("dev") if family_of(case.world) != "wreck"]
    found: list[tuple[Case, Flown]] = []
    for task, outcome in Processes(options.jobs).run(flown, [[(case, options.protocol)] for case in cases]):
        if isinstance(outcome, Failure):
            print(f"failed: {task}: {outcome}", file=sys.stderr)
            continue
        found.append((task[0], outcome))
        print(f"\r{len(found)}/{len(cases)} missions", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)

    # As the suite lists them, not as they ended: the intervals draw worlds by their places.
    found.sort(key=lambda of: cases.index(of[0]))
    strata = [family_of(case.world) for case, _ in found]
    tallies = {
        BESIDE: [outcome.beside for _, outcome in found],
        ANYWHERE: [outcome.anywhere for _, outcome in found],
    }
    curves = {name: reliability_curve(these, strata) for name, these in tallies.items()}
    for name, these in tallies.items():
        score = brier(these)
        print(f"{name}: Brier score {score.score:.4f}, of the base rate {score.uncertainty:.4f}; ", end="")
        print(f"reliability {score.reliability:.5f}, resolution {score.resolution:.5f}\n")
        print("| told | forecasts | mean | came true |\n|---|--:|--:|--:|")
        for point in curves[name]:
            true = f"{point.true.value:.1%} [{point.true.low:.1%}, {point.true.high:.1%}]"
            print(f"| {point.low:.1%} to {point.high:.1%} | {point.count:,} | {point.told:.1%} | {true} |")
        print()
    area = np.array([pair for _, outcome in found for pair in outcome.area])
    print(
        f"targets beside known ones, mean of {len(area)} looks: {area[:, 0].mean():.1f} m² expected, ", end=""
    )
    print(f"{area[:, 1].mean():.1f} m² found; correlation {np.corrcoef(area.T)[0, 1]:.2f}")
    if options.out is not None:
        picture = Picture("calibration", "Calibration", "", lambda theme: draw(curves, theme))
        options.out.write_bytes(picture.svg())
        print(f"written: {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
