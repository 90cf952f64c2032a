"""`dream survey export`: a survey in the formats that its readers open."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from dream.commands.console import compiling_told, print_json
from dream.commands.progress import with_progress
from dream.commands.survey.sources import archive_at, check_archive, found
from dream.options import First

if TYPE_CHECKING:
    from dream.survey import Survey

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Export:
    """Write a survey into a folder: maps, GeoPackage, netCDF, Darwin Core, mosaic, tables, reports.

    What cannot be made of the survey is left out, and the command says why: maps on the globe need an origin,
    a mosaic needs the run, Darwin Core needs the species.

    Examples:
        dream survey export 1 --to products
        dream survey export runs/latest --to products --only html tables
    """

    survey: tyro.conf.Positional[str]
    """Number of a survey in the archive, its file, or the folder of a run."""
    to: Path
    """Folder to make. It must not exist."""
    site: First[Path | None] = None
    """File that says where on earth it was, for a run that does not know."""
    archive: str | None = None
    """The archive: its path, or a postgresql:// URL. Unless given, the one that DREAM_ARCHIVE names, else
    surveys.gpkg."""
    run: First[Path | None] = None
    """Folder of the run with its observations, for the mosaic. Not needed where SURVEY is that folder."""
    earlier: First[Annotated[tuple[str, ...], tyro.conf.arg(metavar="SURVEY ...")]] = ()
    """Other surveys of the site, for the series over time: numbers, files or folders. Unless given, all in
    the archive."""
    only: First[Annotated[tuple[str, ...], tyro.conf.arg(metavar="PRODUCT ...")]] = ()
    """Products to make, of geotiff, geopackage, netcdf, darwin-core, mosaic, tables, series, html and pdf.
    Unless given, all."""
    species: First[str] = ""
    """What the individuals are, for Darwin Core: a scientific name."""
    species_id: str = ""
    """Identifier of that name in a register: urn:lsid:marinespecies.org:taxname:NUMBER."""
    author: str = ""
    """Who answers for the data, for Darwin Core."""
    email: str = ""
    """Mail address of the author."""
    licence: str = ""
    """Terms on which the data may be used: CC0-1.0, CC-BY-4.0, CC-BY-NC-4.0, or the address of others."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.survey.products import OVER_TIME, Author, Species, export, page
        from dream.survey.products.geotiff import check_installed

        for one, other, both in (
            (self.species, self.species_id, "--species and --species-id"),
            (self.author, self.licence, "--author and --licence"),
        ):
            if bool(one) != bool(other):
                raise ValueError(f"export: expected both {both}, got one of them")
        if self.to.exists():  # Before a run is measured, which takes a while.
            raise ValueError(f"export: expected a folder that does not exist, got {self.to}. Choose another")
        check_archive(self.archive)
        if not self.only or {"geotiff", "mosaic"} & set(self.only):
            check_installed()
        with compiling_told():
            survey = found(self.survey, self.archive, self.site)
            others = [found(one, self.archive, self.site) for one in self.earlier]
        if not others and (not self.only or set(self.only) & set(OVER_TIME)):
            others = _kept_of_its_site(survey, self.archive)
        run = self.run or (Path(self.survey) if Path(self.survey).is_dir() else None)
        title = f"mosaic of {survey.name}"
        made = export(
            survey,
            self.to,
            run=run,
            species=Species(self.species, self.species_id) if self.species else None,
            author=Author(self.author, self.licence, self.email) if self.author else None,
            others=others,
            only=self.only,
            watched=lambda files: with_progress(files, title, len(files), "frames"),
            each=lambda names: with_progress(names, f"writing {self.to.name}", len(names), "products"),
        )
        for warning in made.warnings:
            logger.warning("%s", warning)
        told = {"survey": survey.name, "to": str(made.folder), "files": list(made.files)}
        if self.json:
            print_json({**told, "left_out": dict(made.left_out), "warnings": list(made.warnings)})
            return 0
        print(f"{made.folder}: {', '.join(made.files)}")
        for name, reason in made.left_out.items():
            print(f"  without {name}: {reason}")
        if page.NAME in made.files:
            print(f"  to read: {made.folder / page.NAME}")
        return 0


def _kept_of_its_site(survey: Survey, archive: str | None) -> list[Survey]:
    """All that the archive keeps of the site of a survey; what cannot be read there is warned of."""
    if survey.site is None:
        return []
    kept = []
    try:
        with archive_at(archive) as there:
            for entry in there.entries():
                if not survey.site.is_called(entry.site) or entry.target != survey.target:
                    continue
                try:
                    kept.append(there.get(entry.number))
                except ValueError as error:
                    logger.warning("%s is not in the series: %s", entry.name, error)
    except FileNotFoundError:
        pass  # Nobody keeps surveys here.
    except (OSError, ValueError) as error:
        logger.warning("the series is without what the archive keeps: %s", error)
    return kept
