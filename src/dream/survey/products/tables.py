"""Measures and individuals as plain CSV, which opens in any spreadsheet; needs no origin."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from dream.survey.products.ground import Ground
from dream.survey.products.words import of_structures, world
from dream.survey.survey import Survey

MEASURES, INDIVIDUALS = "measures.csv", "individuals.csv"
SIMULATED = "simulated"
"""A column, and no line above the table, which would break readers."""


def write(survey: Survey, folder: Path) -> list[Path]:
    """Write `measures.csv`, of the survey, of each patch, structure and side, and `individuals.csv`.

    Positions are metres in the world of the run; longitude and latitude come with them where there is an
    origin. The last column of both says which world was simulated, and is empty of real water.

    Raises:
        OSError: They cannot be written.
    """
    measures, individuals = folder / MEASURES, folder / INDIVIDUALS
    _write(measures, ("of", "name", "value", "low", "high", "unit", "note", SIMULATED), _measures(survey))
    _write(individuals, *_individuals(survey))
    return [measures, individuals]


def _measures(survey: Survey) -> Iterable[Sequence[Any]]:
    of = [("survey", survey.measures)]
    of += [(f"patch {number}", patch.measures) for number, patch in enumerate(survey.patches, start=1)]
    of += [
        (f"structure {number}" + f", {side}" * bool(side), measures)
        for number, side, measures in of_structures(survey)
    ]
    for what, measures in of:
        for m in measures:
            numbers = map(plain, (m.value, m.low, m.high))
            texts = map(harmless, (m.unit, m.note, world(survey)))
            yield what, harmless(m.name), *numbers, *texts


def _individuals(survey: Survey) -> tuple[tuple[str, ...], list[list[Any]]]:
    found = survey.individuals
    columns: tuple[str, ...] = (
        "individual",
        "patch",
        "x_m",
        "y_m",
        "z_m",
        "position_sigma_m",
        "size_m",
        "size_sigma_m",
    )
    columns += ("confidence", "hits", "looks")
    rows = [
        [
            number + 1,
            int(found.patch[number]) + 1 if found.patch[number] >= 0 else "",
            *(f"{value:.3f}" for value in found.position[number]),
            f"{found.sigma[number]:.3f}",
            f"{found.size[number]:.3f}" if found.clear[number] else "",
            f"{found.size_sigma[number]:.3f}" if found.clear[number] else "",
            f"{found.confidence[number]:.3f}",
            int(found.hits[number]),
            int(found.looks[number]),
        ]
        for number in range(len(found))
    ]
    if survey.site is not None:
        ground = Ground(survey.site)
        longitude, latitude = ground.globe(found.position[:, 0], found.position[:, 1])
        depth = ground.depth(found.position[:, 2])
        columns += ("longitude", "latitude", "depth_m")
        for number, row in enumerate(rows):
            row += [f"{longitude[number]:.8f}", f"{latitude[number]:.8f}", f"{depth[number]:.3f}"]
    made_up = harmless(world(survey))
    return (*columns, SIMULATED), [[*row, made_up] for row in rows]


def harmless(text: str) -> str:
    """Text that no spreadsheet takes for a formula: an apostrophe before what one could begin with.

    Notes and names come from whoever made the survey; numbers are ours and stay as they are.
    """
    return f"'{text}" if text[:1] in _FORMULA else text


_FORMULA = tuple("=+-@\t\r")
"""With which OWASP has formulas begin ("CSV Injection")."""


def _write(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    path.write_text(text.getvalue(), encoding="utf-8")


def plain(value: float | None) -> str:
    """A number as a spreadsheet reads it; nothing where it was not measured."""
    return "" if value is None else f"{value:.6g}"
