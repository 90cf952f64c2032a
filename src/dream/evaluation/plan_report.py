"""A plan in words, as `plan.json` and as one self-contained HTML page."""

from __future__ import annotations

import base64
import html
import json
import math
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dream.ending import ENDED
from dream.evaluation.figures import DARK, LIGHT, Picture, Theme
from dream.evaluation.foresight import Foreseen, Foresight, Quantiles, held
from dream.files import write_whole
from dream.homeward import Budget
from dream.report import digest, fill

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BATTERY_WH = 266.0
"""Of a BlueROV2's battery: 18 Ah at 14.8 V."""
FIGURES = {
    "time_s": "time",
    "way_m": "way",
    "battery_wh": "battery",
    "steps": "steps",
    "coverage": "coverage",
}
"""What is told, and what it is called."""
UNITS: Mapping[str, tuple[str, float]] = {
    "time_s": ("min", 1 / 60),
    "way_m": ("m", 1.0),
    "battery_wh": ("Wh", 1.0),
    "steps": ("", 1.0),
    "coverage": ("%", 100.0),
}
"""In which unit, and how many of it are one of the file's."""
DRAWN = ("time_s", "way_m", "battery_wh", "coverage")


def write_plan(folder: Path, foreseen: Foreseen) -> Path:
    """Write `plan.json` and `plan.html` into a folder, which is there. Returns the path of the page."""
    told = json.dumps(foreseen.as_dict(), allow_nan=False, indent=1)
    write_whole(folder / "plan.json", (told + "\n").encode())
    page = folder / "plan.html"
    write_whole(page, _page(foreseen).encode())
    return page


def told(foreseen: Foreseen) -> list[str]:
    """A plan in lines for a terminal."""
    lines = [f"{_title(foreseen)} · {_how(foreseen)}"]
    lines.append(f"  {'':10}{'10 %':>12}{'median':>12}{'90 %':>12}")
    for name, one in foreseen.free.spreads().items():
        low, median, high = (_value(name, one, k) for k in range(3))
        lines.append(f"  {FIGURES[name]:10}{low:>12}{median:>12}{high:>12}")
    lines += [f"  {line}" for line in (*_certainty(foreseen), *_within(foreseen), _clock(foreseen))]
    return lines


# ---- words ----


def _title(foreseen: Foreseen) -> str:
    return f"{foreseen.size.east} × {foreseen.size.north} m"


def _how(foreseen: Foreseen) -> str:
    seen = foreseen.size.visibility
    water = "water of every kind" if seen is None else f"a Secchi disc vanishes at {seen:g} m"
    return f"{foreseen.planner} · {foreseen.protocol.name} · {water} · {len(foreseen.free.flown)} missions"


def _number(name: str, value: float) -> str:
    """Without a unit."""
    scaled = value * UNITS[name][1]
    return f"{scaled:.1f}" if name != "steps" and scaled < 99.95 else f"{scaled:.0f}"


def _value(name: str, one: Quantiles, which: int) -> str:
    """One of the three quantiles with its unit; a lower bound is marked."""
    value = (one.low, one.median, one.high)[which]
    least = "≥ " if one.at_least[which] else ""
    return f"{least}{_number(name, value)} {UNITS[name][0]}".rstrip()


def _certainty(foreseen: Foreseen) -> list[str]:
    """How sure it is of one more mission, and how many ended as they should."""
    free = foreseen.free
    count = len(free.flown)
    share = held(count)
    few = "" if count >= 9 else f": {count} are too few for 80 %, which 9 tell"
    lines = [f"One more mission lies between the outer two figures with {100.0 * share:.0f} %{few}."]
    if free.complete < count:
        lines.append(
            f"{count - free.complete} of {count} were not complete ({_ends(free)}): ≥ marks figures that "
            "would be more, had they gone on."
        )
    else:
        lines.append("The planner held all of them to be complete; all went home.")
    return lines


def _ends(flown: Foresight) -> str:
    return ", ".join(f"{times} {ENDED[end]}" for end, times in flown.ended.items())


def _within(foreseen: Foreseen) -> list[str]:
    """What a budget gives."""
    within = foreseen.within
    if within is None or within.budget is None:
        return []
    spreads = within.spreads()
    coverage = spreads["coverage"]
    low, median, high = (_value("coverage", coverage, k) for k in range(3))
    time, battery = (_value(name, spreads[name], 1) for name in ("time_s", "battery_wh"))
    return [
        f"Home {_limits(within.budget)}: {median} seen ({low} to {high}), in {time} and with {battery}; "
        f"{within.home} of {len(within.flown)} were home in time."
    ]


def _limits(budget: Budget) -> str:
    said = []
    if math.isfinite(budget.seconds):
        said.append(f"within {budget.seconds:g} s")
    if math.isfinite(budget.battery_wh):
        said.append(f"with {budget.battery_wh:g} Wh")
    if math.isfinite(budget.tether_m):
        said.append(f"on a tether of {budget.tether_m:g} m")
    return " and ".join(said)


def _clock(foreseen: Foreseen) -> str:
    name = foreseen.protocol.name
    if foreseen.protocol.swims:
        return f"Times are those of a vehicle that swims under {name}."
    return (
        f"Times and battery are nominal: under {name} a vehicle moves at a set speed. A protocol that swims, "
        "such as dream-v2-nav, tells truer ones."
    )


# ---- pictures ----


def pictures(foreseen: Foreseen) -> tuple[Picture, Picture]:
    """The missions one by one with their quantiles, and coverage over time."""
    return (
        Picture(
            "missions",
            "What each mission took",
            "A dot is a mission; the bar is from 10 % to 90 % of missions, the line across it the median. A "
            "hollow dot was not complete: it would have taken more.",
            lambda theme: _strips(foreseen, theme),
        ),
        Picture(
            "coverage",
            "Coverage over time",
            "Share of the individuals that a mission has seen. Thin lines are missions, the thick one is "
            "their median, the band is from 10 % to 90 %."
            + (" Squares are the missions with a budget, when they were home." if foreseen.within else ""),
            lambda theme: _curves(foreseen, theme),
        ),
    )


def _strips(foreseen: Foreseen, theme: Theme) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.6), layout="constrained", facecolor=theme.ground)
    free, spreads = foreseen.free, foreseen.free.spreads()
    complete = np.array([one.row.ended == "done" for one in free.flown])
    values = {
        "time_s": free.seconds,
        "way_m": [one.row.distance_m for one in free.flown],
        "battery_wh": free.watt_hours,
        "coverage": [one.row.instances for one in free.flown],
    }
    for row, name in enumerate(DRAWN, start=1):
        axes = figure.add_subplot(len(DRAWN), 1, row)
        hollow = ~complete if name != "coverage" else np.zeros_like(complete)
        _strip(axes, theme, name, np.array(values[name]), hollow, spreads[name])
    return figure


def _strip(
    axes: Axes,
    theme: Theme,
    name: str,
    values: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    hollow: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    one: Quantiles,
) -> None:
    """One figure of all missions, along its own axis."""
    unit, scale = UNITS[name]
    accent = theme.tracks[0]
    scaled = values * scale
    low, median, high = (scale * v for v in (one.low, one.median, one.high))
    axes.barh(0.0, high - low, left=low, height=0.62, color=accent, alpha=0.16, linewidth=0)
    axes.plot([median, median], [-0.42, 0.42], color=accent, linewidth=2.4, solid_capstyle="round")
    for open_, fill_ in ((False, accent), (True, theme.ground)):
        some = scaled[hollow == open_]
        axes.scatter(
            some, np.zeros(len(some)), s=34, color=fill_, edgecolors=accent, linewidths=1.2, zorder=3
        )
    left, right = min(scaled.min(), low), max(scaled.max(), high)
    room = max(right - left, 1e-3 * max(abs(right), 1.0))
    most = min(right + 0.06 * room, 100.0 + 0.02 * room) if name == "coverage" else right + 0.06 * room
    axes.set(xlim=(left - 0.06 * room, most), ylim=(-0.75, 0.75), yticks=[])
    axes.set_title(f"{FIGURES[name]}, {unit}", fontsize=9.5, color=theme.ink, pad=3)
    axes.spines["left"].set_visible(False)
    axes.grid(axis="y", visible=False)


def _curves(foreseen: Foreseen, theme: Theme) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.6), layout="constrained", facecolor=theme.ground)
    axes = figure.add_subplot()
    free, within = foreseen.free, foreseen.within
    accent, other = theme.tracks[:2]
    minutes = free.moments / 60.0
    for one, curve, seconds in zip(free.flown, free.coverage, free.seconds, strict=True):
        flown = free.moments <= seconds + 1e-9
        axes.plot(minutes[flown], 100.0 * curve[flown], color=accent, linewidth=0.8, alpha=0.45)
        inside = accent if one.row.ended == "done" else theme.ground
        axes.scatter(
            seconds / 60.0,
            100.0 * one.row.instances,
            s=14,
            edgecolors=accent,
            linewidths=1.0,
            zorder=3,
            color=inside,
        )
    low, median, high = 100.0 * free.band()
    axes.fill_between(minutes, low, high, color=accent, alpha=0.16, linewidth=0, label="10 % to 90 %")
    axes.plot(minutes, median, color=accent, linewidth=2.4, label="median")
    if within is not None and within.budget is not None:
        if math.isfinite(within.budget.seconds):
            axes.axvline(within.budget.seconds / 60.0, color=other, linewidth=1.2, linestyle=(0, (4, 3)))
        axes.scatter(
            [seconds / 60.0 for seconds in within.seconds],
            [100.0 * one.row.instances for one in within.flown],
            s=30,
            marker="s",
            color=other,
            edgecolors=theme.ground,
            linewidths=0.8,
            zorder=4,
            label=f"home {_limits(within.budget)}",
        )
    axes.set(
        xlim=(0.0, 1.02 * minutes[-1]),
        ylim=(0.0, 102.0),
        xlabel="minutes on the mission's clock",
        ylabel="% seen",
    )
    axes.legend(loc="lower right")
    return figure


# ---- page ----


def _page(foreseen: Foreseen) -> str:
    style = _part("dream", "report_page/page.css") + _part("dream.evaluation", "plan_page/page.css")
    spreads = foreseen.free.spreads()
    return fill(
        _part("dream.evaluation", "plan_page/page.html"),
        {
            "policy": f"default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'; style-src "
            f"{digest(style)}",
            "title": html.escape(f"{_title(foreseen)} · DREAM mission plan"),
            "style": style,
            "heading": html.escape(_title(foreseen)),
            "how": html.escape(_how(foreseen)),
            "figures": "".join(_figure(name, spreads[name]) for name in DRAWN),
            "lead": html.escape(" ".join(_certainty(foreseen))),
            "pictures": "".join(map(_picture, pictures(foreseen))),
            "table": _table(("", "10 %", "median", "90 %"), _rows(spreads)),
            "within": _budget(foreseen),
            "missions": _each(foreseen),
            "notes": "".join(f"<li>{html.escape(note)}</li>" for note in _notes(foreseen)),
        },
    )


def _figure(name: str, one: Quantiles) -> str:
    """A figure in the masthead: its median, and from where to where."""
    unit = UNITS[name][0]
    least = "≥ " if any(one.at_least) else ""
    return (
        f"<div><dt>{FIGURES[name]}, {unit}</dt><dd>{'≥ ' if one.at_least[1] else ''}"
        f"{_number(name, one.median)} <small>{_number(name, one.low)} to {least}{_number(name, one.high)}"
        "</small></dd></div>"
    )


def _rows(spreads: Mapping[str, Quantiles]) -> list[tuple[str, ...]]:
    return [(FIGURES[name], *(_value(name, one, k) for k in range(3))) for name, one in spreads.items()]


def _budget(foreseen: Foreseen) -> str:
    within = foreseen.within
    if within is None or within.budget is None:
        return ""
    table = _table(("", "10 %", "median", "90 %"), _rows(within.spreads()))
    return (
        f'<section class="panel"><h2>Home {html.escape(_limits(within.budget))}</h2>'
        f'<p class="lead">{html.escape(" ".join(_within(foreseen)))}</p>{table}</section>'
    )


def _each(foreseen: Foreseen) -> str:
    """A row a mission."""
    heads = ["world", "seed", "ended", *(FIGURES[name] for name in FIGURES)]
    columns: list[Callable[[int], str]] = []
    if foreseen.within is not None and foreseen.within.budget is not None:
        heads.append(f"seen, home {_limits(foreseen.within.budget)}")
        limited = foreseen.within.flown
        columns.append(lambda k: f"{100.0 * limited[k].row.instances:.1f} %")
    rows = []
    for k, mission in enumerate(foreseen.free.as_dict()["each"]):
        figures = [f"{_number(name, float(mission[name]))} {UNITS[name][0]}".rstrip() for name in FIGURES]
        named = (mission["world"].partition("+")[0], str(mission["seed"]), ENDED[mission["ended"]])
        rows.append((*named, *figures, *(column(k) for column in columns)))
    return _table(tuple(heads), rows)


def _notes(foreseen: Foreseen) -> list[str]:
    kinds = ", ".join(kind.partition("/")[2] if kind.startswith("reef/") else kind for kind in foreseen.kinds)
    battery = foreseen.free.spreads()["battery_wh"]
    drawn = f"{100.0 * battery.median / BATTERY_WH:.0f} % of the {BATTERY_WH:g} Wh of a BlueROV2's battery"
    return [
        f"Each world is one of {kinds}, drawn alike likely; what lies in the real area may be another.",
        "Figures are of whole missions, from the first look until the vehicle is home again; launch and "
        "surfacing come on top.",
        _clock(foreseen),
        f"The median mission draws {drawn}, by the model of the simulated vehicle.",
        "Coverage is of the individuals that can be seen at all from where the vehicle can go.",
        "Quantiles are those that one more mission falls below with 10, 50 and 90 %, however they spread.",
    ]


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f'<th scope="col">{html.escape(one)}</th>' for one in heads)
    body = "".join(
        f'<tr><th scope="row">{html.escape(first)}</th>'
        + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
        + "</tr>"
        for first, *cells in rows
    )
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _picture(picture: Picture) -> str:
    light, dark = (
        f"data:image/svg+xml;base64,{base64.b64encode(picture.svg(theme)).decode()}"
        for theme in (LIGHT, DARK)
    )
    return (
        f'<figure><picture><source media="(prefers-color-scheme: dark)" srcset="{dark}">'
        f'<img src="{light}" alt="{html.escape(picture.title)}"></picture>'
        f"<figcaption><span>{html.escape(picture.title)}</span> <span>{html.escape(picture.says)}</span>"
        "</figcaption></figure>"
    )


def _part(package: str, name: str) -> str:
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")
