"""Where a command of `dream survey` finds a survey, and the archive."""

from __future__ import annotations

import logging
import os
import re
import shlex
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from dream.commands.progress import stage

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from dream.survey import Survey
    from dream.survey.archive import Archive

logger = logging.getLogger(__name__)

NEAR = 3
"""Archives that are named where there is none at the place that was meant."""


def archive_at(where: str | None, *, begin: bool = False) -> AbstractContextManager[Archive]:
    """The archive that `--archive` names, else DREAM_ARCHIVE, else surveys.gpkg.

    Raises:
        FileNotFoundError: There is none, and none is to be begun; those that are near are named.
    """
    from dream.survey.archive import open_archive

    place = _place(where)
    if not begin and "://" not in place and not Path(place).exists():
        raise FileNotFoundError(f"{place}: expected an archive of surveys, got no file. {_others()}")
    return open_archive(place, begin=begin)


def option(where: str) -> str:
    """What to add to a command so that it finds an archive from any shell; empty for the default, and for a
    database, which has its password from elsewhere."""
    from dream.survey.archive import DEFAULT

    return "" if where == DEFAULT or "://" in where else f" --archive {shlex.quote(where)}"


def _place(where: str | None) -> str:
    from dream.survey.archive import DEFAULT, VARIABLE

    return where or os.environ.get(VARIABLE) or DEFAULT


def _others() -> str:
    """Which archives are near, the newest first, and how one is named."""
    from dream.survey.archive import DEFAULT, VARIABLE

    found = [path for depth in ("*", "*/*") for path in Path().glob(f"{depth}/{DEFAULT}") if path.is_file()]
    found.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    if not found:
        return "Begin one with dream survey add, or name it with --archive or DREAM_ARCHIVE"
    near = ", ".join(map(str, found[:NEAR])) + f" and {len(found) - NEAR} more" * (len(found) > NEAR)
    newest = shlex.quote(str(found[0]))
    return f"Near here: {near}. Say --archive {newest}, or export {VARIABLE}={newest}"


def check_archive(where: str | None) -> None:
    """Raise a ValueError where what the archive needs is not installed."""
    from dream.survey.archive import VARIABLE, check_installed

    check_installed(where or os.environ.get(VARIABLE) or "")


def found(what: str, archive: str | None, site: Path | None = None) -> Survey:
    """The survey that somebody named, as `named` finds it, at a site.

    Args:
        what: As it was typed.
        archive: As `--archive` gives it.
        site: A file that says where it was, for one that does not know.

    Raises:
        FileNotFoundError: There is nothing of that name.
        ValueError: It is damaged; or it knows its site, and another was named.
        OSError: The archive cannot be reached.
    """
    from dream.survey.site import read_site

    where = None if site is None else read_site(site)
    survey = named(what, archive)
    if Path(what).exists():  # One in the archive was warned of when it was added.
        warn_of_date(survey, what)
    if where is None or where == survey.site:
        return survey
    if survey.site is not None:
        raise ValueError(
            f"--site: expected none, because {survey.name} says where it was ({survey.site.name}), got "
            f"{site}. If that is wrong, put it right in the archive: dream survey add {what} --site {site}"
        )
    return replace(survey, site=where)


def named(what: str, archive: str | None) -> Survey:
    """The survey that somebody named: the number of one in the archive, its file, or the folder of a run.

    Args:
        what: As it was typed. A folder or file of that name comes before a number.
        archive: As `--archive` gives it.

    Raises:
        FileNotFoundError: There is nothing of that name.
        ValueError: It is damaged.
        OSError: The archive cannot be reached.
    """
    path = Path(what)
    if path.is_dir():
        return _measured(path)
    if path.is_file():
        from dream.survey import files

        return files.read(path)
    if re.fullmatch(r"[0-9]{1,18}", what):  # As many digits as a database counts with.
        with archive_at(archive) as kept:
            return kept.get(int(what))
    raise FileNotFoundError(
        f"{what}: expected the number of a survey in the archive, its file, or the folder of a run, got "
        "none of them. See dream survey list"
    )


def warn_of_date(survey: Survey, what: str) -> None:
    """Warn where it is guessed when a survey began, or where that is still to come.

    Args:
        survey: As it was found.
        what: As what it was named.
    """
    from dream.survey.measuring import GUESSED
    from dream.survey.survey import DAYS_A_YEAR

    began = f"{survey.began:%Y-%m-%d %H:%M:%S %Z}"
    say = f"If that is wrong, say when with dream survey add {what} --date"
    if survey.made_by.get("began_by") == GUESSED:
        logger.warning(
            "%s: began at %s, going by when its config.json was written, as neither the run nor the name of "
            "its folder says. %s",
            *(survey.name, began, say),
        )
    elif survey.began - timedelta(days=DAYS_A_YEAR * survey.years_on) > datetime.now(UTC):
        logger.warning("%s: began at %s, which is still to come. %s", survey.name, began, say)


def _measured(run: Path) -> Survey:
    """A run's survey; how far it is is told."""
    from dream.survey.measuring import measure

    with stage(f"measuring {run.resolve().name}", unit="frames") as work:

        def note(done: int, of: int) -> None:
            work.done, work.total = done, of

        return measure(run, told=note)
