"""Benchmark results as pictures. Equal results give equal bytes: no dates, no random names."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from dream.evaluation.comparison import FAMILIES, Comparison, coverage_at_end, family, groups, label
from dream.evaluation.results import Results
from dream.evaluation.statistics import FloatArray, kaplan_meier, mean_band, ratio
from dream.evaluation.suites import Case
from dream.protocol import protocol_named

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_CHARTS = 16
"""Worlds whose trajectories are shown; more are thinned out over the families."""
CHART_PIXELS = 560
TOUR = "best known tour to 100 %"
PALER = 0.3
"""How far a world's chart is drawn towards white below the trajectories."""


@dataclass(frozen=True, slots=True)
class Theme:
    """Colours of a figure, as hexadecimal strings."""

    ground: str
    ink: str
    soft: str
    grid: str
    tracks: tuple[str, ...]


LIGHT = Theme(
    ground="#ffffff",
    ink="#0c2431",
    soft="#4d6573",
    grid="#d5e0e5",
    tracks=("#0b7f86", "#d1570a", "#5a49c4", "#c23b80", "#8a6d00", "#2f78d0", "#4d8f1f", "#7a4b2a"),
)
DARK = Theme(
    ground="#0c1e29",
    ink="#e3eef3",
    soft="#96b0bd",
    grid="#1d3644",
    tracks=("#4ecdc4", "#ff9c5b", "#a99bff", "#ff8cc3", "#e2c044", "#7db5ff", "#9fd968", "#d9a58a"),
)
DASHES = ("solid", (0, (5, 2)), (0, (1.5, 1.5)))


@dataclass(frozen=True, slots=True)
class Picture:
    """A drawing that can be made in any theme."""

    name: str
    title: str
    says: str
    """What it shows and how to read it."""
    draw: Callable[[Theme], Figure]

    def svg(self, theme: Theme = LIGHT) -> bytes:
        """As SVG, the same bytes each time."""
        return self._bytes(theme, "svg")

    def png(self, theme: Theme = LIGHT, *, dpi: int = 110) -> bytes:
        """As PNG, the same bytes each time."""
        return self._bytes(theme, "png", dpi=dpi)

    def _bytes(self, theme: Theme, kind: str, **options: Any) -> bytes:
        with _settings(theme):
            buffer = io.BytesIO()
            nameless = {"Date": None, "Creator": None} if kind == "svg" else {"Software": None}
            self.draw(theme).savefig(buffer, format=kind, metadata=nameless, **options)
        return buffer.getvalue()


@contextmanager
def _settings(theme: Theme) -> Iterator[None]:
    import matplotlib as mpl

    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(
            {
                "svg.hashsalt": "dream",
                "svg.fonttype": "path",
                "font.size": 9.5,
                "axes.edgecolor": theme.grid,
                "axes.labelcolor": theme.soft,
                "axes.facecolor": theme.ground,
                "axes.grid": True,
                "axes.axisbelow": True,
                "axes.spines.top": False,
                "axes.spines.right": False,
                "axes.titlesize": 10.5,
                "axes.titlelocation": "left",
                "axes.titlecolor": theme.ink,
                "grid.color": theme.grid,
                "grid.linewidth": 0.7,
                "figure.facecolor": theme.ground,
                "text.color": theme.ink,
                "xtick.color": theme.soft,
                "ytick.color": theme.soft,
                "legend.frameon": False,
                "legend.fontsize": 9,
                "lines.linewidth": 1.8,
            }
        )
        yield


def look(theme: Theme, planners: Sequence[str], planner: str) -> dict[str, Any]:
    """Colour and dashes of a planner, the same in every figure."""
    turns, k = divmod(planners.index(planner), len(theme.tracks))
    return {"color": theme.tracks[k], "linestyle": DASHES[turns % len(DASHES)]}


def panels(comparison: Comparison) -> dict[str, tuple[Case, ...]]:
    """Groups of worlds that have curves of their own: reefs and wrecks, else whatever there is."""
    found = {
        title: cases
        for title, cases in groups(comparison).items()
        if any(comparison.flown(planner, cases) for planner in comparison.planners)
    }
    chosen = {
        title: cases for title, cases in found.items() if title in ("Reefs together", FAMILIES["wreck"])
    }
    return chosen or {title: found[title] for title in list(found)[:1]}


FEW_REACHED = 0.25
"""Share of the missions up to which the time to 98.26 % is not drawn."""


def pictures(results: Results, comparison: Comparison) -> list[Picture]:
    """The curves: coverage and time to 98.26 % of each group, and the performance profile."""
    found = []
    for title, cases in panels(comparison).items():
        slug = title.split()[0].lower()
        found.append(coverage_curves(results, comparison, cases, f"coverage-{slug}", title))
        times = [row.t98 for planner in comparison.planners for _, row in comparison.flown(planner, cases)]
        # Where few got there, the curves are one line along the top.
        if FEW_REACHED * len(times) < sum(time is not None for time in times):
            found.append(survival_curves(comparison, cases, f"survival-{slug}", title))
    if any(comparison.limit(case, "t98") for case in comparison.cases):
        found.append(performance_profile(comparison))
    return found


def _axes(theme: Theme, title: str, width: float = 6.4, height: float = 4.1) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained", facecolor=theme.ground)
    axes = figure.add_subplot()
    axes.set_title(title)
    return figure, axes


def _key(figure: Figure, axes: Axes, count: int) -> None:
    handles, names = axes.get_legend_handles_labels()
    figure.legend(
        handles,
        names,
        loc="outside lower center",
        ncols=math.ceil(count / math.ceil(count / 4)),
        handlelength=2.2,
    )


def coverage_curves(
    results: Results, comparison: Comparison, cases: Sequence[Case], name: str, title: str
) -> Picture:
    """Mean coverage after each step, with its pointwise interval over worlds."""
    steps = np.arange(comparison.horizon + 1)

    def draw(theme: Theme) -> Figure:
        figure, axes = _axes(theme, f"{title}: individuals seen after each step")
        for planner in comparison.planners:
            curves, strata = _curves(results, comparison, planner, cases)
            if not len(curves):
                continue
            style = look(theme, comparison.planners, planner)
            middle, low, high = mean_band(100.0 * curves, strata)
            if np.isfinite(low).all() and not comparison.sealed:
                axes.fill_between(
                    steps, low.clip(0, 100), high.clip(0, 100), color=style["color"], alpha=0.1, linewidth=0
                )
            axes.plot(steps, middle, label=planner, **style)
        axes.axhline(98.26, color=theme.soft, linewidth=0.9, linestyle=(0, (2, 3)))
        axes.annotate(
            "98.26 %",
            (comparison.horizon, 98.26),
            (0, -3),
            textcoords="offset points",
            ha="right",
            va="top",
            color=theme.soft,
            fontsize=8.5,
        )
        axes.set(xlim=(0, comparison.horizon), ylim=(0, 102), xlabel="steps", ylabel="%")
        _key(figure, axes, len(comparison.planners))
        return figure

    return Picture(
        name,
        f"Coverage, {title.lower()}",
        "Mean share of the individuals seen after each step, held after a mission ended."
        + _about_bands(comparison, " Bands: pointwise 95 % intervals over worlds."),
        draw,
    )


def _about_bands(comparison: Comparison, others: str) -> str:
    """What is said of bands; a sealed test has none."""
    if comparison.sealed:
        return " Without bands, which would hold at one number of worlds alone."
    return others


def _curves(
    results: Results, comparison: Comparison, planner: str, cases: Sequence[Case]
) -> tuple[FloatArray, list[str]]:
    """(worlds, horizon + 1) shares seen, averaged over the starts of a world, and the families."""
    found: dict[tuple[str, int], list[FloatArray]] = {}
    strata: dict[tuple[str, int], str] = {}
    for case, row in comparison.flown(planner, cases):
        seen = results.traces[row.key].instances
        steps = np.minimum(np.arange(comparison.horizon + 1), len(seen) - 1)
        found.setdefault((case.world, case.seed), []).append(seen[steps])
        strata[case.world, case.seed] = family(case)
    curves = [np.mean(starts, axis=0) for starts in found.values()]
    return np.array(curves).reshape(len(curves), comparison.horizon + 1), list(strata.values())


def survival_curves(comparison: Comparison, cases: Sequence[Case], name: str, title: str) -> Picture:
    """Kaplan–Meier curves of the time to 98.26 %."""

    def draw(theme: Theme) -> Figure:
        figure, axes = _axes(theme, f"{title}: missions that have not yet seen 98.26 %")
        first = comparison.ranked[:2]
        for planner in comparison.planners:
            times = [row.t98 for _, row in comparison.flown(planner, cases)]
            if not times:
                continue
            style = look(theme, comparison.planners, planner)
            curve = kaplan_meier(times, comparison.horizon)
            if planner in first and not comparison.sealed:
                axes.fill_between(
                    curve.time,
                    100 * curve.low,
                    100 * curve.high,
                    step="post",
                    color=style["color"],
                    alpha=0.07,
                    linewidth=0,
                )
            axes.step(curve.time, 100 * curve.share, where="post", label=planner, **style)
        axes.set(xlim=(0, comparison.horizon), ylim=(0, 102), xlabel="steps", ylabel="%")
        _key(figure, axes, len(comparison.planners))
        return figure

    return Picture(
        name,
        f"Time to 98.26 %, {title.lower()}",
        "Kaplan–Meier: share of missions that have not seen 98.26 % of the individuals yet; what is left at "
        "the right end never did."
        + _about_bands(
            comparison, " Bands, of the two best ranked planners only: pointwise 95 % confidence."
        ),
        draw,
    )


def performance_profile(comparison: Comparison) -> Picture:
    """Share of missions within each ratio of the certified bound (Dolan and Moré 2002)."""
    limits = {case: limit for case in comparison.cases if (limit := comparison.limit(case, "t98"))}

    def draw(theme: Theme) -> Figure:
        from matplotlib.ticker import FuncFormatter, NullFormatter

        figure, axes = _axes(theme, "Missions within a multiple of the certified bound")
        most = 2.0
        for planner in comparison.planners:
            flown = comparison.flown(planner, tuple(limits))
            every = [
                ratio(row, row.t98, limits[case].lower_bound, comparison.horizon)
                for case, row in flown
                if row.t98 is not None and row.t98 <= comparison.horizon
            ]
            ratios = sorted(value for value in every if not math.isnan(value))
            if not flown:
                continue
            most = max([most, *ratios])
            share = 100.0 * np.arange(len(ratios) + 1) / len(flown)
            axes.step(
                [1.0, *ratios, 1e3],
                [*share, share[-1]],
                where="post",
                label=planner,
                **look(theme, comparison.planners, planner),
            )
        axes.set_xscale("log", base=2)
        axes.set(
            xlim=(1.0, 1.08 * most),
            ylim=(0, 102),
            ylabel="%",
            xlabel="steps to 98.26 % ÷ certified lower bound",
        )
        ticks = [t for t in (1, 1.5, 2, 3, 4, 6, 8, 12, 16, 24, 32) if t <= 1.08 * most]
        axes.set_xticks(ticks)
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        _key(figure, axes, len(comparison.planners))
        return figure

    return Picture(
        "profile",
        "Performance profile",
        "Share of missions that saw 98.26 % within x times the certified lower bound, over the "
        f"{len(limits)} cases whose bound is known. A mission that never did, or that touched something, "
        "stays out at every x. No planner can be left of 1.",
        draw,
    )


# ---- trajectories over the worlds ----


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A world from above with the ways that planners took in it. Points are pixels, down and right."""

    case: Case
    chart: Image.Image | None
    """Paled; None where the world cannot be made again or has another hash."""
    pixels: int
    tracks: Mapping[str, FloatArray]
    """(n + 1, 2) by planner."""
    contacts: Mapping[str, FloatArray]
    """(k, 2) where it collided."""
    tour: FloatArray | None
    """(m + 1, 2) the best known tour to 100 %, from the end of the look-around."""


def shown_cases(comparison: Comparison, most: int = MOST_CHARTS) -> list[Case]:
    """At most that many cases, dealt out over the families and spread within each."""
    flown = [
        case
        for case in comparison.cases
        if any((case, name) in comparison.rows for name in comparison.planners)
    ]
    if len(flown) <= most:
        return flown
    decks: dict[str, list[Case]] = {}
    for case in flown:
        decks.setdefault(family(case), []).append(case)
    sizes = dict.fromkeys(decks, 0)
    while sum(sizes.values()) < most:
        for name, deck in decks.items():
            if sizes[name] < len(deck) and sum(sizes.values()) < most:
                sizes[name] += 1
    chosen = {
        deck[(2 * k + 1) * len(deck) // (2 * sizes[name])]
        for name, deck in decks.items()
        for k in range(sizes[name])
    }
    return [case for case in flown if case in chosen]


def scene(results: Results, comparison: Comparison, case: Case, *, pixels: int = CHART_PIXELS) -> Scene:
    """One world and all that was flown in it."""
    from dream.sim.chart import chart
    from dream.sim.files import world_hash

    flown = {
        name: comparison.rows[case, name] for name in comparison.planners if (case, name) in comparison.rows
    }
    traces = {name: results.traces[row.key] for name, row in flown.items()}
    picture, tour = None, None
    try:
        world = case.open()
    except ValueError:
        world = None
    if world is not None and {row.world_hash for row in flown.values()} == {world_hash(world)}:
        # The same margins as the chart's.
        side = max(world.bounds.width, world.bounds.depth)
        pad = 0.04 * side
        west, north, scale = world.bounds.x_min - pad, world.bounds.y_max + pad, pixels / (side + 2.0 * pad)
        drawn = chart(world, pixels=pixels).crop((0, 0, pixels, pixels)).convert("RGB")
        picture = Image.blend(drawn, Image.new("RGB", drawn.size, "white"), PALER)
        known = comparison.bounds.get(case)
        if known is not None and known.full.best_tour is not None:
            from dream.evaluation.oracle.bounds import tour_poses

            tour = tour_poses(known, world, protocol_named(comparison.protocol))
    else:
        points = np.concatenate([np.column_stack([trace.x, trace.y]) for trace in traces.values()])
        low, high = points.min(axis=0), points.max(axis=0)
        side = max(float((high - low).max()), 1.0)
        west, north = low[0] - 0.05 * side, high[1] + 0.05 * side
        scale = pixels / (1.1 * side)

    def at(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.column_stack([(x - west) * scale, (north - y) * scale])

    return Scene(
        case=case,
        chart=picture,
        pixels=pixels,
        tracks={name: at(trace.x, trace.y) for name, trace in traces.items()},
        contacts={
            name: at(trace.x[trace.collided], trace.y[trace.collided]) for name, trace in traces.items()
        },
        tour=None if tour is None else at(tour[:, 0], tour[:, 1]),
    )


def trajectories(comparison: Comparison, planners: Sequence[str], scenes: Sequence[Scene]) -> Picture:
    """The ways of some planners over all worlds in one sheet, as in the paper's figure."""

    def draw(theme: Theme) -> Figure:
        from matplotlib.figure import Figure

        columns = min(5, len(scenes))
        rows = math.ceil(len(scenes) / columns)
        figure = Figure(
            figsize=(2.5 * columns, 2.66 * rows + 0.4), layout="constrained", facecolor=theme.ground
        )
        grid = figure.subplots(rows, columns, squeeze=False)
        for axes in grid.flat:
            axes.set_axis_off()
        for axes, each in zip(grid.flat, scenes, strict=False):
            axes.set_title(label(each.case), fontsize=9)
            axes.set(xlim=(0, each.pixels), ylim=(each.pixels, 0), aspect="equal")
            if each.chart is not None:
                axes.imshow(np.asarray(each.chart), extent=(0, each.pixels, each.pixels, 0))
            if each.tour is not None:
                axes.plot(
                    *each.tour.T,
                    color="#0c2431",
                    linewidth=1.0,
                    linestyle=(0, (3, 2)),
                    label=TOUR,
                )
            for planner in planners:
                if planner not in each.tracks:
                    continue
                track = each.tracks[planner]
                style = look(LIGHT, comparison.planners, planner)
                axes.plot(*track.T, linewidth=1.1, alpha=0.9, label=planner, **style)
                axes.plot(
                    *track[-1], marker="o", markersize=3.5, color=style["color"], markeredgecolor="white"
                )
                axes.plot(
                    *each.contacts[planner].T, linestyle="none", marker="x", markersize=5, color="#b3261e"
                )
        named = {
            name: handle
            for axes in grid.flat
            for handle, name in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        figure.legend(named.values(), named, loc="outside lower center", ncols=min(len(named), 6))
        return figure

    return Picture(
        "trajectories",
        "Trajectories",
        f"The ways of {', '.join(planners)} over the worlds, north up; a dot where one ended, a red cross "
        "where it touched something.",
        draw,
    )


# ---- sweeps ----


def sweep(comparisons: Mapping[float, Comparison]) -> Picture:
    """Time to 98.26 % and coverage at the end against the reach of the sensor."""
    planners = tuple(dict.fromkeys(name for each in comparisons.values() for name in each.planners))
    reaches = sorted(comparisons)
    horizon = max(each.horizon for each in comparisons.values())

    def draw(theme: Theme) -> Figure:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(9.2, 4.1), layout="constrained", facecolor=theme.ground)
        left, right = figure.subplots(1, 2)
        for planner in planners:
            style = look(theme, planners, planner)
            flown = [reach for reach in reaches if planner in comparisons[reach].planners]
            for axes, mark, scale, limits in (
                (left, "t98", 1.0, (0.0, float(horizon))),
                (right, "instances", 100.0, (0.0, 1.0)),
            ):
                found = []
                for reach in flown:
                    each = comparisons[reach]
                    measure = each.time("t98") if mark == "t98" else coverage_at_end
                    found.append(each.estimate(planner, each.cases, measure, limits=limits))
                values = scale * np.array([each.value for each in found])
                ends = scale * np.array([(each.value - each.low, each.high - each.value) for each in found]).T
                axes.errorbar(
                    flown,
                    values,
                    yerr=np.nan_to_num(ends),
                    marker="o",
                    markersize=4,
                    capsize=2.5,
                    elinewidth=0.9,
                    label=planner,
                    **style,
                )
        left.set_title("Steps to 98.26 %")
        left.set(xlabel="reach, m", ylabel="steps", ylim=(0, 1.04 * horizon), xticks=reaches)
        right.set_title("Individuals seen at the end")
        right.set(xlabel="reach, m", ylabel="%", ylim=(0, 102), xticks=reaches)
        _key(figure, left, len(planners))
        return figure

    return Picture(
        "sweep",
        "How far one can see decides",
        f"Mean over worlds with its 95 % interval; what was never reached counts as {horizon}.",
        draw,
    )
