"""All surveys of a site: which belong together, and how their measures went, as a table and a picture.

`series.csv` has one row for each measure of each survey; what was not measured has no value. Shares of sizes
are told alike in all of them, see `measures_over`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC
from pathlib import Path

from dream.survey import globe
from dream.survey.products import figures, sheet
from dream.survey.products.tables import SIMULATED, harmless, plain
from dream.survey.products.words import world
from dream.survey.registration import SAME_PLACE
from dream.survey.sizes import measures_over
from dream.survey.survey import Survey

CSV, PICTURE = "series.csv", "series.png"
COLUMNS = ("survey", "date", "measure", "value", "low", "high", "unit", SIMULATED)
NONE_OF_THAT_SIZE = (
    "0 where sizes were measured and none is of this size; the interval is then that of a bin in which none "
    "is found"
)
"""Of the shares of sizes that a survey does not list."""


def of_one_site(survey: Survey, others: Iterable[Survey]) -> tuple[list[Survey], list[str]]:
    """The surveys of the site of one of them, each once and by time, and why each of the rest is none.

    Origins of one site may be apart, as those of site files that were corrected are. A run is told once: as
    `survey` tells it, or else the first of the others.

    Args:
        survey: With an origin; it is among them.
        others: That are said to be of its site; what is `survey` itself is passed over.
    """
    among, reasons = [survey], []
    for other in others:
        told = next((one for one in among if _same(one, other)), None)
        if told is not None and told.began == other.began:
            continue
        if reason := _elsewhere(survey, other) if told is None else _twice(told, other):
            reasons.append(f"{other.name} is not in the series: {reason}")
        else:
            among.append(other)
    return sorted(among, key=lambda one: one.began), reasons


def _same(one: Survey, other: Survey) -> bool:
    """Are both of one run, however it was measured, called or dated?"""
    if one.run is not None and other.run is not None:
        return one.run == other.run
    return (one.name, one.began) == (other.name, other.began)


def _twice(told: Survey, other: Survey) -> str:
    """Why another survey of a run that is told is not: its date was corrected, or that of the other."""
    one, two = (f"{survey.began.astimezone(UTC):%Y-%m-%d %H:%M}" for survey in (told, other))
    return (
        f"expected a run once, got that of {told.name} with two dates, {one} and {two}, of which the first "
        "is told. Where the second is right, export that survey"
    )


def _elsewhere(survey: Survey, other: Survey) -> str:
    """Why another is not of the site of a survey; empty where it is."""
    if survey.site is None or other.site is None:
        return "a run without origin"
    if not survey.site.is_called(other.site.name):
        return f"expected the site {survey.site.name}, got {other.site.name}"
    if survey.target is not other.target:
        return f"expected a survey of {survey.target}, got one of {other.target}"
    apart = globe.apart(survey.site, other.site)
    if apart > SAME_PLACE:
        return (
            f"expected origins at most {SAME_PLACE / 1000.0:g} km apart, got {apart / 1000.0:.1f} km. Is one "
            "of the two site files wrong?"
        )
    return ""


def write(surveys: Sequence[Survey], folder: Path) -> list[Path]:
    """Write `series.csv` and `series.png`.

    Args:
        surveys: Of one site, by time.
        folder: To write to.

    Raises:
        OSError: They cannot be written.
    """
    table, picture = folder / CSV, folder / PICTURE
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(_rows(surveys))
    table.write_text(text.getvalue(), encoding="utf-8")
    with sheet.settings():
        picture.write_bytes(sheet.png(figures.series_figure(surveys)))
    return [table, picture]


def _rows(surveys: Sequence[Survey]) -> Iterator[tuple[str, ...]]:
    over = measures_over(surveys)
    for number, survey in enumerate(surveys):
        date = survey.began.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        for name, of in over.items():
            if (m := of[number]) is not None:
                numbers = map(plain, (m.value, m.low, m.high))
                yield (
                    harmless(survey.name),
                    date,
                    harmless(name),
                    *numbers,
                    harmless(m.unit),
                    harmless(world(survey)),
                )
