"""A survey as a PDF for print, drawn with Matplotlib: three pages of A4, and one for a series of surveys."""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dream.survey.products import areas, figures, sheet, words
from dream.survey.products.sheet import GRID, SOFT
from dream.survey.survey import Survey
from dream.types import Target

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAME = "report.pdf"
WIDTH, HEIGHT = 8.27, 11.69
"""Inches of A4."""
LEFT, RIGHT = 0.08, 0.92
BAND = "#0a4a63"
LINE = 0.0155
"""Of the height of a page."""


def write(survey: Survey, path: Path, surveys: Sequence[Survey] = ()) -> None:
    """Write the report.

    Args:
        survey: With or without an origin.
        path: Of the file.
        surveys: All of the site, by time; two or more have a page of their own.

    Raises:
        OSError: It cannot be written.
    """
    from matplotlib.backends.backend_pdf import PdfPages

    place = words.place(survey)
    with sheet.settings():
        pages = list(_pages(survey, surveys))
        # A fixed date, so that the same survey gives the same bytes.
        about = {"Title": f"{place}: survey report", "Creator": "DREAM", "CreationDate": survey.began}
        content = io.BytesIO()
        with PdfPages(content, metadata=about) as pdf:
            for number, page in enumerate(pages, start=1):
                parts = (place, survey.name, words.warning(survey), f"page {number} of {len(pages)}")
                foot = " · ".join(filter(None, parts))
                page.text(0.5, 0.025, foot, ha="center", fontsize=7.5, color=SOFT)
                pdf.savefig(page)
    path.write_bytes(content.getvalue())


def _pages(survey: Survey, surveys: Sequence[Survey]) -> Iterator[Figure]:
    yield _first(survey)
    yield _second(survey)
    yield _third(survey)
    if len(surveys) > 1:
        yield _over_time(surveys)


def _first(survey: Survey) -> Figure:
    """What it is, what was found in short, and the map."""
    page = _blank()
    top = _masthead(page, survey)
    y = top - 0.032
    for line in words.summary(survey):
        y = _paragraph(page, line, y, size=10.5, gap=0.35)
    axes = page.add_axes((0.13, 0.145, 0.78, y - 0.185))
    figures.habitat_map(axes, survey)
    axes.set_title("What was found, and where")
    return page


def _second(survey: Survey) -> Figure:
    """The measures, the sizes and the patches."""
    page = _blank()
    y = _heading(page, "Measures", 0.945)
    rows = [
        (
            words.meaning(m.name).title,
            words.value_text(m),
            words.interval_text(m),
            words.explained(m),
        )
        for m in words.listed(survey)
    ]
    y = _table(
        page, ("", "value", "95 % interval", "what it says"), rows, (0.08, 0.26, 0.40, 0.58), y, wrap=44
    )
    for area in areas.areas(survey):
        y = _paragraph(page, f"{area.title}, {area.value}: {area.says}.", y, size=8.0, gap=0.2)
    if figures.tells_sizes(survey):
        y = _heading(page, "Sizes of the individuals, told by those that stand clear of others", y - 0.012)
        axes = page.add_axes((0.13, y - 0.185, 0.78, 0.17))
        figures.size_figure(axes, survey)
        y -= 0.235
    if survey.patches:
        title = "Hull and pieces" if survey.target is Target.WRECK else "Patch by patch"
        y = _heading(page, title, y - 0.012)
        _patch_table(page, survey, y)
    return page


def _third(survey: Survey) -> Figure:
    """More maps, what the figures do not say, and how they were got."""
    page = _blank()
    for left, title, draw in (
        (0.085, "Relief", figures.relief_map),
        (0.545, "How often each place was looked at", figures.times_seen_map),
    ):
        axes = page.add_axes((left, 0.66, 0.36, 0.28))
        draw(axes, survey)
        axes.set_title(title, fontsize=9.5)
    y = _heading(page, "What these figures do not say", 0.635)
    for line in words.limits(survey):
        y = _paragraph(page, f"–  {line}", y, size=9.0, gap=0.45)
    y = _heading(page, "The survey", y - 0.012)
    for what, value in words.facts(survey):
        page.text(LEFT, y, what, fontsize=9, color=SOFT, va="top")
        page.text(LEFT + 0.16, y, value, fontsize=9, va="top")
        y -= LINE
    return page


def _over_time(surveys: Sequence[Survey]) -> Figure:
    """How the main measures went, and their figures."""
    page = _blank()
    y = _heading(page, f"Over time: {len(surveys)} surveys of this site", 0.945)
    names = figures.in_series(surveys)
    for number, name in enumerate(names):
        row, column = divmod(number, 2)
        axes = page.add_axes((0.115 + 0.435 * column, y - 0.165 - 0.21 * row, 0.365, 0.145))
        figures.over_time(axes, surveys, name)
    y -= 0.21 * math.ceil(len(names) / 2) + 0.015
    columns = [LEFT, *(LEFT + 0.21 + 0.16 * n for n in range(len(names)))]
    for x, name in zip(columns[1:], names, strict=True):
        page.text(x, y, words.meaning(name).title, fontsize=8, color=SOFT, va="top")
    y -= LINE
    # The last ones, above the lines that end the page.
    shown = surveys[-int((y - 0.17) / (2.0 * LINE)) :]
    for one in shown:
        _rule(page, y + 0.003)
        page.text(LEFT, y, words.day(one), fontsize=9, va="top")
        page.text(LEFT, y - 0.013, _shortened(one.name, 34), fontsize=6.3, color=SOFT, va="top")
        of = {m.name: m for m in one.measures}
        for x, name in zip(columns[1:], names, strict=True):
            if name in of:
                page.text(x, y, words.value_text(of[name]), fontsize=9, va="top")
                page.text(x, y - 0.013, words.interval_text(of[name]), fontsize=6.3, color=SOFT, va="top")
        y -= 2.0 * LINE
    if rest := len(surveys) - len(shown):
        page.text(LEFT, y, f"and {rest} before: see series.csv", fontsize=8, color=SOFT, va="top")
        y -= 1.5 * LINE
    y -= 0.5 * LINE
    for line in words.trend_limits(surveys[-1].target):
        y = _paragraph(page, line, y, size=9.0, gap=0.35)
    return page


def _blank() -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH, HEIGHT), facecolor="white")


def _masthead(page: Figure, survey: Survey) -> float:
    """The dark band with the name and the chief figures; returns where it ends."""
    from matplotlib.patches import Rectangle

    bottom = 0.845
    page.add_artist(Rectangle((0.0, bottom), 1.0, 1.0 - bottom, transform=page.transFigure, facecolor=BAND))
    place = words.place(survey)
    size = 21 if len(place) < 34 else 13
    page.text(LEFT, 0.975, "DREAM  survey report", fontsize=8.5, color="#b9d9e0", va="top")
    page.text(LEFT, 0.957, _shortened(place, 60), fontsize=size, weight="bold", color="white", va="top")
    told = "  ·  ".join(filter(None, (words.day(survey), words.simulated(survey))))
    page.text(LEFT, 0.926, told, fontsize=9.5, color="#cbe3e8", va="top")
    of = {m.name: m for m in survey.measures}
    for n, m in enumerate([of[name] for name in words.HEADLINES if name in of][:4]):
        x = LEFT + n * 0.215
        page.text(x, 0.903, words.meaning(m.name).title, fontsize=8, color="#c3dee4", va="top")
        page.text(x, 0.890, words.value_text(m), fontsize=14, weight="bold", color="white", va="top")
        page.text(x, 0.868, words.interval_text(m), fontsize=7.5, color="#c3dee4", va="top")
    return bottom


def _heading(page: Figure, text: str, y: float) -> float:
    page.text(LEFT, y, text, fontsize=11.5, weight="bold", va="top")
    return y - 0.026


def _paragraph(page: Figure, text: str, y: float, *, size: float, gap: float) -> float:
    """Wrapped to the width of the page; returns where the next one begins."""
    lines = textwrap.wrap(text, int(915 / size), subsequent_indent="    " if text.startswith("–") else "")
    for line in lines:
        page.text(LEFT, y, line, fontsize=size, va="top")
        y -= LINE * size / 9.5
    return y - gap * LINE


def _rule(page: Figure, y: float) -> None:
    from matplotlib.lines import Line2D

    page.add_artist(Line2D([LEFT, RIGHT], [y, y], transform=page.transFigure, color=GRID, linewidth=0.7))


def _table(
    page: Figure,
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    columns: Sequence[float],
    y: float,
    *,
    wrap: int,
) -> float:
    """Columns begin at `columns`; the last is wrapped. Returns where the table ends."""
    for x, text in zip(columns, head, strict=True):
        page.text(x, y, text, fontsize=8, color=SOFT, va="top")
    y -= LINE
    for row in rows:
        _rule(page, y + 0.003)
        lines = textwrap.wrap(row[-1], wrap) or [""]
        for n, (x, text) in enumerate(zip(columns[:-1], row[:-1], strict=True)):
            page.text(x, y, text, fontsize=9, va="top", weight="bold" if n == 1 else "normal")
        for n, line in enumerate(lines):
            page.text(columns[-1], y - 0.85 * n * LINE, line, fontsize=8, color=SOFT, va="top")
        y -= LINE * max(1.25, 0.85 * len(lines) + 0.35)
    return y


def _patch_table(page: Figure, survey: Survey, y: float) -> None:
    names = list(dict.fromkeys(m.name for patch in survey.patches for m in patch.measures))[:7]
    step = (RIGHT - LEFT - 0.04) / max(1, len(names))
    page.text(LEFT, y, "no.", fontsize=8, color=SOFT, va="top")
    for n, name in enumerate(names):
        page.text(LEFT + 0.04 + n * step, y, words.meaning(name).title, fontsize=8, color=SOFT, va="top")
    y -= LINE
    for number, patch in enumerate(survey.patches, start=1):
        if y < 0.08:
            rest = len(survey.patches) - number + 1
            page.text(LEFT, y, f"and {rest} more: see measures.csv", fontsize=8, color=SOFT, va="top")
            return
        _rule(page, y + 0.003)
        page.text(LEFT, y, str(number), fontsize=9, va="top")
        of = {m.name: m for m in patch.measures}
        for n, name in enumerate(names):
            if name in of:
                x = LEFT + 0.04 + n * step
                page.text(x, y, words.value_text(of[name]), fontsize=9, va="top")
                page.text(x, y - 0.013, words.interval_text(of[name]), fontsize=6.3, color=SOFT, va="top")
        y -= 2.0 * LINE


def _shortened(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"
