"""All products of a survey into one folder, which is there whole or not at all.

What needs an origin is left out of a survey without one, and the folder's README.md says so; the reports and
the tables need none.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from dream.names import look_up
from dream.survey import files
from dream.survey.products import (
    areas,
    darwin_core,
    geopackage,
    geotiff,
    mesh,
    mosaic,
    netcdf,
    page,
    pdf,
    series,
    tables,
    words,
)
from dream.survey.products.darwin_core import Author, Species
from dream.survey.products.ground import epsg_of, site_of
from dream.survey.survey import Survey
from dream.types import Target

PRODUCTS: Mapping[str, str] = {
    "geotiff": "maps as cloud-optimised GeoTIFFs, with styles for QGIS",
    "geopackage": "track, decisions, patches, individuals, swath",
    "netcdf": "measures and maps by the CF conventions, of all surveys of the site",
    "darwin-core": "individuals that were found as occurrences for OBIS and GBIF",
    "mosaic": "the sea floor as one georeferenced picture",
    "mesh": "what stands, of a mission in three dimensions, as a mesh",
    "tables": "measures and individuals as CSV",
    "series": "measures of all surveys of the site, as CSV and as a picture",
    "html": "a report to read on a screen",
    "pdf": "a report to print",
}
OVER_TIME = ("netcdf", "series", "html", "pdf")
"""Those of `PRODUCTS` that tell of the other surveys of the site, too."""
FILES: Mapping[str, str] = {
    "habitat.tif": "what each place is, coloured; QGIS takes the legend from habitat.qml",
    "target_probability.tif": "how sure it is that the target stands in a place, 0 to 1",
    "relief.tif": "metres above the bare seabed",
    "times_seen.tif": "frames in which each place was looked at",
    mosaic.NAME: "the sea floor from above, as the camera saw it",
    geopackage.NAME: "track, decisions with their reasoning, patches, individuals, swath; styles inside",
    netcdf.NAME: "measures with intervals, and the maps, by CF 1.8",
    darwin_core.CSV: "one Darwin Core occurrence for each individual that was found and is likely one",
    darwin_core.ARCHIVE: "the same with sizes as a Darwin Core Archive, for OBIS and GBIF",
    mesh.NAME: "the surface of what stands, coloured by what was inspected; in the map's own metres",
    tables.MEASURES: "all measures with their intervals, of the survey and of each patch",
    tables.INDIVIDUALS: "position, size and confidence of the individuals that were found, which are not "
    "all; one that touches others has no size",
    series.CSV: "the measures of all surveys of the site, one a row",
    series.PICTURE: "how the main measures went, with the 95 % interval of each survey",
    page.NAME: "the survey report, for a browser",
    pdf.NAME: "the survey report, for print",
    "README.md": "what the files are",
}


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written."""

    folder: Path
    files: tuple[str, ...]
    """Names, sorted."""
    left_out: Mapping[str, str]
    """Why, by product."""
    warnings: tuple[str, ...] = ()
    """What is to be known of what was written."""


def export(
    survey: Survey,
    to: Path,
    *,
    run: Path | None = None,
    species: Species | None = None,
    author: Author | None = None,
    others: Sequence[Survey] = (),
    only: Sequence[str] = (),
    watched: Callable[[Sequence[Path]], Iterable[Path]] = iter,
    each: Callable[[Sequence[str]], Iterable[str]] = iter,
) -> Exported:
    """Write the products of a survey.

    They grow in `.partial.NAME` beside `to`, which takes its place at the end. Whatever interrupts it, `to`
    is not made.

    Args:
        survey: That is told of.
        to: The folder to make; it must not exist.
        run: Folder of the run with its observations, for the mosaic.
        species: What the individuals are, for Darwin Core.
        author: Who answers for the data, for Darwin Core.
        others: Other surveys of the site: with them netCDF, series and reports tell how it went. One that
            is of another site is left out, and it is warned of.
        only: Names of `PRODUCTS`; all where empty. What is named and cannot be made is an error, not left
            out.
        watched: Passes the files of the frames on, and may show how far the mosaic is.
        each: Passes the names of the products on, likewise.

    Raises:
        ValueError: `to` exists, the survey is damaged, what was named cannot be made of it, or what a product
            needs is not installed.
        OSError: It cannot be written; nothing is left then.
    """
    for name in only:
        look_up(PRODUCTS, name, "product")
    if to.exists():
        raise ValueError(f"export: expected a folder that does not exist, got {to}. Choose another")
    for one in (survey, *others):
        files.check(one)
    surveys, warnings = series.of_one_site(survey, others)
    if any(one.calibration != survey.calibration for one in surveys):
        warnings.append(
            "the surveys of the series were measured by different calibrations: sizes, counts and densities "
            "may differ by that alone. Measure all by one version: dream survey add RUN --replace NUMBER"
        )
    if not survey.tells_clear:
        warnings.append(
            "no individual is given a size: an older version measured the survey, and did not say whose size "
            "is its own. Measure again: dream survey add RUN --replace NUMBER"
        )
    folder = to.with_name(f".partial.{to.name}")
    makers = _makers(survey, folder, run, species, author, surveys, watched)
    left_out: dict[str, str] = {}
    try:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        every = tuple(name for name in PRODUCTS if name != "mesh" or survey.structures)
        for name in each(only or every):
            if reason := _missing(name, survey, run, species, surveys):
                if name in only:
                    raise ValueError(f"{name}: {reason}")
                left_out[name] = reason
                continue
            makers[name]()
        told = [(name, FILES[name]) for name in FILES if (folder / name).exists()]
        if not only or "html" in only:
            picture = folder / mosaic.NAME
            beside = [line for line in told if line[0] != page.NAME]
            page.write(survey, folder / page.NAME, beside, picture if picture.exists() else None, surveys)
        (folder / "README.md").write_text(_readme(survey, folder, left_out, warnings), encoding="utf-8")
        names = tuple(sorted(path.name for path in folder.iterdir()))
        folder.rename(to)
    except OSError as error:
        why = error.strerror or error
        raise OSError(
            f"export: expected a place that can be written, got {to} ({why}). Choose another"
        ) from error
    finally:
        with suppress(OSError):
            shutil.rmtree(folder)
    return Exported(to, names, left_out, tuple(warnings))


def _makers(
    survey: Survey,
    folder: Path,
    run: Path | None,
    species: Species | None,
    author: Author | None,
    surveys: Sequence[Survey],
    watched: Callable[[Sequence[Path]], Iterable[Path]],
) -> dict[str, Callable[[], object]]:
    """How each product is written; only those are called of which nothing is missing."""

    def occurrences() -> None:
        assert species is not None
        darwin_core.write(survey, species, folder, author)

    def picture() -> None:
        assert run is not None
        mosaic.mosaic_for(survey).write(survey, run, folder / mosaic.NAME, watched)

    return {
        "geotiff": lambda: geotiff.write(survey, folder),
        "geopackage": lambda: geopackage.write(survey, folder / geopackage.NAME),
        "netcdf": lambda: netcdf.write(survey, folder / netcdf.NAME, surveys),
        "darwin-core": occurrences,
        "mosaic": picture,
        "mesh": lambda: mesh.write(survey, folder / mesh.NAME),
        "tables": lambda: tables.write(survey, folder),
        "series": lambda: series.write(surveys, folder),
        # Last of all, as it lists the others.
        "html": lambda: None,
        "pdf": lambda: pdf.write(survey, folder / pdf.NAME, surveys),
    }


def _missing(
    name: str, survey: Survey, run: Path | None, species: Species | None, surveys: Sequence[Survey]
) -> str:
    """Why a product cannot be made; empty where it can."""
    if name in ("geotiff", "geopackage", "netcdf", "darwin-core", "mosaic", "series"):
        try:
            site_of(survey)
        except ValueError as error:
            return str(error)
    if name == "darwin-core":
        if survey.target == "wreck":
            return "a wreck is no occurrence of a species"
        if species is None:
            return "which species the individuals are has to be said: --species and --species-id"
        if not darwin_core.likely(survey):
            return "no individual was found that is likely one"
    if name == "mesh" and not survey.structures:
        return "nothing stands in it, or it is of a mission in the plane"
    if name == "series" and len(surveys) < 2:
        return "it takes two surveys of the site: keep them in an archive, or name others with --earlier"
    if name == "mosaic":
        if run is None:
            return "the pictures lie in the folder of the run: say --run FOLDER"
        if not any((run / "observations").glob("*.npz")):
            return f"{run} keeps no observations. Fly with --keep-observations"
    return ""


def _readme(survey: Survey, folder: Path, left_out: Mapping[str, str], warnings: Sequence[str]) -> str:
    place = survey.site.name if survey.site is not None else "a place without origin"
    lines = [f"# Survey {survey.name}: {place}", ""]
    if told := words.warning(survey):
        lines += [f"**{told}.** Publish none of it as an observation.", ""]
    lines += [f"- `{name}`: {what}" for name, what in FILES.items() if (folder / name).exists()]
    if left_out or warnings:
        lines += ["", "Left out:", ""]
        lines += [f"- {name}: {reason}" for name, reason in left_out.items()]
        lines += [f"- {warning}" for warning in warnings]
    if survey.target is not Target.WRECK:
        lines += ["", words.CLUMPS]
        lines += ["", "Areas differ by what they are of:", ""]
        lines += [f"- {area.title}, {area.value}: {area.says}." for area in areas.areas(survey)]
    if survey.site is not None:
        sheet = epsg_of(survey.site.latitude, survey.site.longitude)
        lines += ["", f"Depths are below {survey.site.datum}. Maps lie on EPSG:{sheet}, north up."]
    return "\n".join(lines) + "\n"
