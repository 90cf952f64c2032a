"""Maps and the size-frequency figure of the reports."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.survey.products.outlines import ring_around
from dream.survey.products.sheet import (
    GRID,
    INK,
    SOFT,
    corners_of,
    east_north,
    north_arrow,
    scale_bar,
    show_map,
)
from dream.survey.products.styles import (
    DECISION,
    EXPLORED,
    INDIVIDUAL,
    NOT_SEEN,
    PROBABILITY_COLORS,
    RELIEF_COLORS,
    SEEN_COLORS,
    STATE_COLORS,
    TRACK,
    UNKNOWN,
    outline_color,
    rgb,
    state_names,
)
from dream.survey.products.words import HEADLINES, UNITS, day, meaning, place, warning
from dream.survey.sizes import size_bin
from dream.survey.survey import Measure, Patch, Survey

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Float64Array = npt.NDArray[np.float64]

BIN = 0.025
"""Metres, width of the bins of sizes; doubled until there are at most 24."""
DOT: dict[str, Any] = {
    "linestyle": "",
    "marker": "o",
    "markersize": 1.3,
    "markeredgewidth": 0.35,
    "markerfacecolor": "white",
    "markeredgecolor": INDIVIDUAL,
}
"""An individual whose size was not measured: hollow, or it would look like a small one drawn to scale."""
DATES_APART = 0.3
"""Share of the span of an axis that a date takes where its figure is narrowest, in print."""


def habitat_map(axes: Axes, survey: Survey) -> None:
    """What was found: the map, outlines of patches with their numbers, individuals, the track.

    Individuals whose size was measured are drawn to scale, the others as dots.
    """
    from matplotlib.collections import EllipseCollection
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch as Swatch
    from matplotlib.patheffects import withStroke

    layers = survey.layers
    picture = np.empty((*layers.state.shape, 3), np.uint8)
    picture[:] = rgb(NOT_SEEN)
    for value, color in STATE_COLORS.items():
        picture[layers.state == value] = rgb(color)
    _show(axes, survey, picture)
    halo = [withStroke(linewidth=2.2, foreground="white")]
    for number, patch in enumerate(survey.patches, start=1):
        axes.add_patch(_outlined(survey, patch))
        if len(survey.patches) > 1:
            x, y = east_north(survey.site, patch.rings[0]).T
            axes.text(
                (x.min() + x.max()) / 2.0,
                y.max(),
                str(number),
                ha="center",
                va="bottom",
                fontsize=9,
                weight="bold",
                path_effects=halo,
                zorder=6,
            )
    found = survey.individuals
    sized = found.size[found.clear]
    places = east_north(survey.site, found.position[:, :2])
    axes.add_collection(
        EllipseCollection(
            sized,
            sized,
            np.zeros(len(sized)),
            units="xy",
            offsets=places[found.clear],
            transOffset=axes.transData,
            facecolor=INDIVIDUAL,
            edgecolor="white",
            linewidth=0.25,
            zorder=4,
        )
    )
    # Of the others the size is a guess, which must not be read off a map.
    axes.plot(*places[~found.clear].T, zorder=4, **DOT)
    track = east_north(survey.site, survey.track.position[:, :2])
    axes.plot(*track.T, color=TRACK, linewidth=1.1, zorder=5, alpha=0.85)
    for at, marker in ((0, "o"), (-1, "s")):
        if len(track):
            axes.plot(*track[at], marker=marker, color=DECISION, markeredgecolor=INK, markersize=5, zorder=6)
    names = state_names(survey.target)
    handles: list[Any] = [
        Swatch(facecolor=STATE_COLORS[value], edgecolor=SOFT, linewidth=0.4, label=name)
        for value, name in names.items()
        if (layers.state == value).any() or value == EXPLORED
    ]
    if (layers.state == UNKNOWN).any():
        handles.append(Swatch(facecolor=NOT_SEEN, edgecolor=SOFT, linewidth=0.4, label="not seen"))
    if len(sized):
        handles.append(
            Line2D(
                [], [], marker="o", linestyle="", color=INDIVIDUAL, markersize=4, label="individual, to scale"
            )
        )
    if len(found) > len(sized):
        handles.append(Line2D([], [], label="individual, size not measured", **DOT))
    handles.append(Line2D([], [], color=TRACK, linewidth=1.3, label="track, ○ start □ end"))
    axes.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.09),
        ncols=min(4, len(handles)),
        fontsize=8,
        handlelength=1.4,
        columnspacing=1.4,
    )


def _outlined(survey: Survey, patch: Patch) -> Any:
    """A patch on the map, its holes left open."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    # Holes turn the other way than outlines, which is how they stay empty.
    shape = Path.make_compound_path(
        *(Path(east_north(survey.site, ring), closed=True) for ring in patch.rings)
    )
    edge = outline_color(survey.target)
    return PathPatch(
        shape,
        facecolor=(*(value / 255 for value in rgb(edge)), 0.3),
        edgecolor=edge,
        linewidth=0.8,
        zorder=3,
    )


def relief_map(axes: Axes, survey: Survey) -> None:
    """Height above the bare seabed."""
    relief = survey.layers.relief
    known = relief[np.isfinite(relief)]
    highest = max(0.1, float(np.quantile(known, 0.995))) if known.size else 1.0
    _ramp_map(axes, survey, relief, (0.0, highest), RELIEF_COLORS, "metres above the bare seabed")


def probability_map(axes: Axes, survey: Survey) -> None:
    """How sure it is that the target stands in a place."""
    _ramp_map(
        axes,
        survey,
        survey.layers.target_probability,
        (0.0, 1.0),
        PROBABILITY_COLORS,
        "probability of target",
    )


def times_seen_map(axes: Axes, survey: Survey) -> None:
    """In how many frames each place was looked at."""
    seen = survey.layers.times_seen.astype(np.float32)
    seen[seen == 0] = np.nan
    known = seen[np.isfinite(seen)]
    most = max(2.0, float(np.quantile(known, 0.98))) if known.size else 2.0
    _ramp_map(axes, survey, seen, (1.0, most), SEEN_COLORS, "frames that saw it")


def _ramp_map(
    axes: Axes,
    survey: Survey,
    values: npt.NDArray[np.float32],
    span: tuple[float, float],
    colors: tuple[str, ...],
    label: str,
) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    ramp = LinearSegmentedColormap.from_list("ramp", list(colors)).with_extremes(bad=NOT_SEEN)
    image = _show(axes, survey, np.ma.masked_invalid(values), cmap=ramp, vmin=span[0], vmax=span[1])
    assert axes.figure is not None
    bar = axes.figure.colorbar(
        image, ax=axes, shrink=0.7, pad=0.02, aspect=28, extend="max" if span[1] != 1.0 else "neither"
    )
    bar.set_label(label, fontsize=8)
    bar.ax.tick_params(labelsize=7.5)
    bar.outline.set_linewidth(0.4)


def _show(axes: Axes, survey: Survey, picture: npt.NDArray[Any], **options: Any) -> Any:
    """A map of a survey, with the box that was asked for."""
    ring, layers = ring_around(survey.area), survey.layers
    around = np.concatenate([corners_of(layers.bounds), ring])
    image = show_map(axes, survey.site, layers.bounds, picture, around, **options)
    axes.plot(*east_north(survey.site, ring).T, color=SOFT, linewidth=0.7, linestyle=(0, (4, 2)), zorder=2)
    return image


def size_figure(axes: Axes, survey: Survey) -> None:
    """How many individuals there are of each size: shares with their intervals, the median with its own.

    Where the survey tells no shares, those whose size was measured are counted as they are.
    """
    if shares := _shares_of(survey):
        _size_shares(axes, shares)
    else:
        _size_counts(axes, survey.individuals.size[survey.individuals.clear])
    median = next((m for m in survey.measures if m.name == "median_size" and m.value is not None), None)
    if median is not None and median.value is not None:
        if median.low is not None and median.high is not None:
            axes.axvspan(median.low, median.high, color=DECISION, alpha=0.35, linewidth=0, zorder=2.5)
        axes.axvline(median.value, color=INK, linewidth=1.3, zorder=3)
        axes.annotate(
            f"median {median.value:.3f} m, with its 95 % interval",
            (median.value, 1.0),
            (5, 3),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            fontsize=8,
            ha="left" if median.value < sum(axes.get_xlim()) / 2.0 else "right",
        )
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color=GRID, linewidth=0.6, zorder=0)


def tells_sizes(survey: Survey) -> bool:
    """Is there anything that `size_figure` would show?"""
    return bool(_shares_of(survey) or survey.individuals.clear.any())


def _shares_of(survey: Survey) -> list[tuple[tuple[int, int], Measure]]:
    """The shares of sizes that it tells, each with its ends in centimetres."""
    told = ((size_bin(measure.name), measure) for measure in survey.measures if measure.value is not None)
    return [(ends, measure) for ends, measure in told if ends is not None]


def _size_shares(axes: Axes, shares: Sequence[tuple[tuple[int, int], Measure]]) -> None:
    for (first, last), measure in shares:
        assert measure.value is not None  # `_shares_of` gives no others.
        middle, height = 0.005 * (first + last), 100.0 * measure.value
        axes.bar(
            middle, height, 0.01 * (last - first), color="#1f9e62", edgecolor="white", linewidth=0.8, zorder=2
        )
        if measure.low is not None and measure.high is not None:
            low, high = 100.0 * measure.low, 100.0 * measure.high
            axes.plot(
                [middle, middle], [low, high], color=INK, linewidth=1.1, marker="_", markersize=5, zorder=4
            )
    axes.set_xlabel("longest diameter, metres", fontsize=8)
    axes.set_ylabel("% of the individuals, with 95 % intervals", fontsize=8)
    axes.set_ylim(bottom=0.0)


def _size_counts(axes: Axes, sizes: Float64Array) -> None:
    from matplotlib.ticker import MaxNLocator

    width = BIN
    while sizes.size and np.ptp(sizes) / width > 24.0:
        width *= 2.0
    first = math.floor(float(sizes.min()) / width) if sizes.size else 0
    last = math.floor(float(sizes.max(initial=0.0)) / width) + 1
    edges = width * np.arange(first, max(last, first + 1) + 1)
    axes.hist(sizes, edges.tolist(), color="#1f9e62", edgecolor="white", linewidth=0.8, zorder=2)
    axes.set_xlabel(f"longest diameter, metres (bins of {100.0 * width:g} cm)", fontsize=8)
    axes.set_ylabel("individuals found", fontsize=8)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.margins(x=0.02)


def sea_floor(axes: Axes, picture: npt.NDArray[np.uint8], extent: tuple[float, float, float, float]) -> None:
    """The mosaic, north of the map sheet up.

    Args:
        axes: To draw on.
        picture: (rows, cols, 4) RGBA, the first row in the north.
        extent: West, east, south, north, in metres from the origin.
    """
    axes.imshow(picture, extent=extent, interpolation="nearest", zorder=1)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7.5, length=2.5)
    axes.set_xlabel("metres east of the origin", fontsize=8)
    axes.set_ylabel("metres north of the origin", fontsize=8)
    north_arrow(axes)
    scale_bar(axes, extent[1] - extent[0])


def series_figure(surveys: Sequence[Survey]) -> Figure:
    """How the main measures of a site went: a panel for each, with the 95 % interval of each survey.

    Args:
        surveys: Of one site, by time.
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    names = in_series(surveys)
    rows = math.ceil(len(names) / 2)
    layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.08)
    figure = Figure(figsize=(9.0, 0.9 + 2.5 * rows), layout=layout, facecolor="white")
    days = " to ".join(dict.fromkeys(map(day, (surveys[0], surveys[-1]))))
    made_up = any(map(warning, surveys))
    title = f"{'SIMULATED · ' * made_up}{place(surveys[-1])}: {len(surveys)} surveys, {days}"
    figure.suptitle(title, x=0.012, ha="left", fontsize=11, weight="bold")
    for number, name in enumerate(names, start=1):
        over_time(figure.add_subplot(rows, 2, number), surveys, name)
    under = "Points are surveys, bars their 95 % intervals."
    if made_up:
        under += " Nothing real was seen."
    if any(survey.years_on for survey in surveys):
        under += " The years that passed are simulated."
    figure.supxlabel(under, x=0.012, ha="left", fontsize=9, color=INK)
    return figure


def in_series(surveys: Sequence[Survey]) -> list[str]:
    """The main measures that any of the surveys tells."""
    told = {measure.name for survey in surveys for measure in survey.measures if measure.value is not None}
    return [name for name in HEADLINES if name in told]


def over_time(axes: Axes, surveys: Sequence[Survey], name: str) -> None:
    """How one measure went, with the 95 % interval of each survey."""
    told = [next((m for m in survey.measures if m.name == name), None) for survey in surveys]
    scale = 100.0 if meaning(name).share else 1.0
    values, lows, highs = (
        [math.nan if m is None or (value := getattr(m, end)) is None else scale * value for m in told]
        for end in ("value", "low", "high")
    )
    moments = [survey.began.timestamp() for survey in surveys]
    axes.plot(moments, values, color=TRACK, linewidth=0.8, alpha=0.4)
    axes.vlines(moments, lows, highs, color=TRACK, linewidth=2.6, alpha=0.45)
    axes.plot(moments, values, color=TRACK, linestyle="", marker="o", markersize=3.4)
    unit = "%" if meaning(name).share else next((UNITS.get(m.unit, m.unit) for m in told if m), "")
    axes.set_title(f"{meaning(name).title}, {unit}" if unit else meaning(name).title)
    # From 0, or a change looks larger than it is.
    axes.set_ylim(bottom=min(0.0, *lows, *values))
    axes.margins(x=0.1)
    dates = _dates(surveys)
    axes.set_xticks(list(dates), list(dates.values()))
    axes.tick_params(labelsize=8, length=2.5)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)


def _dates(surveys: Sequence[Survey]) -> dict[float, str]:
    """Marks of an axis: when each began; empty where it would cover the one before it."""
    moments = [survey.began.astimezone(UTC) for survey in surveys]
    span = moments[-1] - moments[0]
    one_day = moments[0].date() == moments[-1].date()
    told: dict[float, str] = {}
    last = None
    for moment in moments:
        if last is not None and moment - last <= DATES_APART * span:
            told.setdefault(moment.timestamp(), "")
            continue
        told[moment.timestamp()] = f"{moment:%H:%M:%S}" if one_day else f"{moment:%d %b %Y}".lstrip("0")
        last = moment
    return told
