"""The layers of a comparison, as a GeoPackage that QGIS opens in the colours of its picture."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.survey import globe
from dream.survey.archive import wkb
from dream.survey.archive.geopackage import write_layers
from dream.survey.archive.schema import Column, Table
from dream.survey.change_words import CHANGED
from dream.survey.comparison import Change, Comparison, Verdict
from dream.survey.fates import Fate, Missing
from dream.survey.products import styles
from dream.survey.products.outlines import outlines

Float64Array = npt.NDArray[np.float64]

GROUND = {
    Change.NOT_COMPARABLE: "#f2f2f2",
    Change.BARE: "#d8d2c4",
    Change.KEPT: "#8a8a84",
    Change.GAIN: "#0072b2",
    Change.LOSS: "#d55e00",
}
"""Colours of ground: gain and loss are told apart by those who do not tell red from green (Okabe and Ito)."""
GROUND_WORDS = {
    Change.NOT_COMPARABLE: "not comparable",
    Change.BARE: "bare in both",
    Change.KEPT: "target in both",
    Change.GAIN: "gain",
    Change.LOSS: "loss",
}
VERDICTS: Mapping[Verdict, str] = {
    "gain": "#0072b2",
    "loss": "#d55e00",
    "mixed": "#7b3294",
    "no change shown": "#333333",
    "not comparable": "#aaaaaa",
}
INDIVIDUALS = {
    Fate.NOT_COMPARABLE: "#aaaaaa",
    Fate.THERE: "#000000",
    Fate.HIDDEN: "#000000",
    Fate.LOST: "#7a2e00",
    Fate.NEW: "#00304d",
}

_TABLES = (
    Table(
        "ground",
        "Ground by what became of it; what is not comparable was not seen by both",
        (
            Column("id", "id"),
            Column("change", "text"),
            Column("area_m2", "real"),
            Column("geom", "MULTIPOLYGON"),
        ),
    ),
    Table(
        "patches",
        "Patches and what became of them",
        (
            Column("id", "id"),
            Column("patch", "integer"),
            Column("verdict", "text"),
            Column("p", "real", required=False),
            Column("q", "real", required=False),
            Column("seen_share", "real"),
            Column("before_patch", "integer", required=False),
            Column("after_patches", "text"),
            Column("gone_share", "real", required=False),
            Column("gone_low", "real", required=False),
            Column("gone_high", "real", required=False),
            Column("come_share", "real", required=False),
            Column("come_low", "real", required=False),
            Column("come_high", "real", required=False),
            Column("found_before", "real", required=False),
            Column("found_after", "real", required=False),
            Column("target_before_m2", "real", required=False),
            Column("target_after_m2", "real", required=False),
            Column("target_change_low_m2", "real", required=False),
            Column("target_change_high_m2", "real", required=False),
            Column("geom", "MULTIPOLYGON"),
        ),
    ),
    Table(
        "individuals",
        "Individuals that were found, and what became of them",
        (
            Column("id", "id"),
            Column("survey", "text"),
            Column("fate", "text"),
            Column("size_m", "real", required=False),
            Column("confidence", "real"),
            Column("geom", "POINT"),
        ),
    ),
)
"""The lowest first, as QGIS lays them on each other."""


def write_change_layers(comparison: Comparison, path: Path) -> None:
    """Write ground, patches and individuals, with how QGIS draws them.

    Args:
        comparison: That is told of.
        path: Of a file that is not there.

    Raises:
        OSError: It could not be written.
    """
    made_up = comparison.a.simulated or comparison.b.simulated
    tables = [replace(one, title=f"SIMULATED: {one.title}") if made_up else one for one in _TABLES]
    rows = {
        "ground": _ground(comparison),
        "patches": _patches(comparison),
        "individuals": _individuals(comparison),
    }
    write_layers(path, tables, rows, _styles(), on_globe=comparison.a.site is not None)


def _styles() -> dict[str, str]:
    """By layer."""
    ground = []
    for change in Change:
        color, unseen = GROUND[change], change is Change.NOT_COMPARABLE
        # Hatched, so that nobody takes it for ground that is bare.
        look = styles.fill("#aaaaaa" if unseen else color, color, 0.1, 255, hatched=unseen)
        ground.append((told(change), GROUND_WORDS[change], look))
    patches = [
        (verdict, verdict, styles.fill("#ffffff", color, 0.7 if verdict in CHANGED else 0.35, 0))
        for verdict, color in VERDICTS.items()
    ]
    dot, cross = partial(styles.marker, size=0.8), partial(styles.marker, size=2.2, width=0.35)
    dots = {
        Fate.NOT_COMPARABLE: ("not comparable", dot),
        Fate.THERE: ("there in both", dot),
        Fate.HIDDEN: ("not found again, on covered ground", dot),
        Fate.LOST: ("only before", partial(cross, shape="cross2")),
        Fate.NEW: ("only after", partial(cross, shape="triangle", size=2.6)),
    }
    individuals = [
        (told(fate), words, look(INDIVIDUALS[fate], border=INDIVIDUALS[fate]))
        for fate, (words, look) in dots.items()
    ]
    return {
        "ground": styles.categories_qml("fill", "change", ground),
        "patches": styles.categories_qml("fill", "verdict", patches),
        "individuals": styles.categories_qml("marker", "fate", individuals),
    }


def told(one: Change | Fate) -> str:
    """As the layers name it."""
    return one.name.lower().replace("_", " ")


def _on_globe(comparison: Comparison, points: Float64Array) -> Float64Array:
    """(n, 2) longitude and latitude, or metres of the earlier survey's world where it has no site."""
    site = comparison.a.site
    if site is None:
        return points
    return np.column_stack(globe.degrees(site, points[:, 0], points[:, 1]))


def _patches(comparison: Comparison) -> Iterator[dict[str, Any]]:
    for number, patch in enumerate(comparison.patches, start=1):
        figures = {one.name: one for one in patch.differences}
        count, area = figures.get("found"), figures.get("target_area")
        yield {
            "patch": number,
            "verdict": patch.verdict,
            "p": patch.p,
            "q": patch.q,
            "seen_share": patch.seen,
            "before_patch": None if patch.before is None else patch.before + 1,
            "after_patches": ", ".join(str(k + 1) for k in patch.after),
            **_interval("gone", patch.gone),
            **_interval("come", patch.come),
            "found_before": None if count is None else count.before,
            "found_after": None if count is None else count.after,
            "target_before_m2": None if area is None else area.before,
            "target_after_m2": None if area is None else area.after,
            "target_change_low_m2": None if area is None else area.low,
            "target_change_high_m2": None if area is None else area.high,
            "geom": wkb.multipolygon([_on_globe(comparison, ring) for ring in patch.rings]),
        }


def _interval(name: str, of: Missing | None) -> dict[str, float | None]:
    return {f"{name}_{part}": None if of is None else getattr(of, part) for part in ("share", "low", "high")}


def _individuals(comparison: Comparison) -> Iterator[dict[str, Any]]:
    for survey, them, places, fates in (
        ("before", comparison.a.individuals, comparison.a.individuals.position[:, :2], comparison.fate_a),
        ("after", comparison.b.individuals, comparison.positions_b, comparison.fate_b),
    ):
        for k, place in enumerate(_on_globe(comparison, places)):
            yield {
                "survey": survey,
                "fate": told(Fate(int(fates[k]))),
                "size_m": float(them.size[k]) if them.clear[k] else None,
                "confidence": float(them.confidence[k]),
                "geom": wkb.point(*place.tolist()),
            }


def _ground(comparison: Comparison) -> Iterator[dict[str, Any]]:
    """The cells of each kind as one: along their edges, so that areas are those of the cells."""
    corner = (comparison.bounds.x_min, comparison.bounds.y_min)
    for change in Change:
        cells = comparison.change == change
        rings = [ring for polygon in outlines(cells) for ring in polygon]
        if rings:
            places = [_on_globe(comparison, comparison.cell * ring + corner) for ring in rings]
            yield {
                "change": told(change),
                "area_m2": float(cells.sum()) * comparison.cell**2,
                "geom": wkb.multipolygon(places),
            }
