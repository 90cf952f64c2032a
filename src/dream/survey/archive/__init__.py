"""Surveys of a site, kept: in a GeoPackage on disk, or in PostgreSQL with PostGIS.

Both hold the same tables, which QGIS opens, and pass the same tests. A survey is added, replaced or removed
in one transaction: it is there whole or not at all, whatever dies meanwhile. Added again, it keeps its
number; no number is given twice.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from dream.survey.archive.entries import Entry
from dream.survey.survey import Survey

DEFAULT = "surveys.gpkg"
"""The archive where none is named."""
VARIABLE = "DREAM_ARCHIVE"
"""Of the environment, which names another."""

__all__ = ["DEFAULT", "VARIABLE", "Archive", "Entry", "check_installed", "open_archive"]


class Archive(Protocol):
    """Surveys by number.

    Every method raises an OSError where the archive cannot be reached, read or written, and a ValueError
    where it holds something else than it should; the message says which, and names no password.
    """

    @property
    def name(self) -> str:
        """Where it is, for people to read; without any password."""
        ...

    def add(self, survey: Survey) -> tuple[int, bool]:
        """Keep a survey; its number, and whether it is new there.

        Raises:
            ValueError: The survey is inconsistent, its run had no origin, or another survey of its run is
                there.
        """
        ...

    def replace(self, number: int, survey: Survey) -> bool:
        """Keep a survey in the place of another one of its run, by its number; whether that was another.

        Raises:
            ValueError: There is none of that number, it is of another run, or the survey is inconsistent.
        """
        ...

    def remove(self, number: int) -> Entry:
        """Take the survey of that number out, with all that belongs to it; what it was.

        Raises:
            ValueError: There is none.
        """
        ...

    def entries(self) -> list[Entry]:
        """What is there, by number."""
        ...

    def get(self, number: int) -> Survey:
        """The survey of that number.

        Raises:
            ValueError: There is none, or it is damaged.
        """
        ...


def check_installed(where: str) -> None:
    """Raise a ValueError where an archive there needs what is not installed."""
    if "://" in where:
        from dream.survey.archive.postgis import import_psycopg

        import_psycopg()


def open_archive(where: str, *, begin: bool = False) -> AbstractContextManager[Archive]:
    """The archive at a path, or at a URL of PostgreSQL: a context that closes it.

    Args:
        where: A path such as `surveys.gpkg`, or `postgresql://user@host/database`.
        begin: Make it where there is none yet.

    Raises:
        FileNotFoundError: There is none, and none is to be begun.
        OSError: It cannot be reached.
        ValueError: It is something else, or damaged, or of a later version.
    """
    if "://" in where:
        from dream.survey.archive.postgis import PostgisArchive

        return PostgisArchive(where, begin=begin)
    from dream.survey.archive.geopackage import GeoPackageArchive

    return GeoPackageArchive(Path(where), begin=begin)
