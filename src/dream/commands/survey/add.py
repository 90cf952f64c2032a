"""`dream survey add`: a survey into the archive."""

from __future__ import annotations

import contextlib
import logging
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from dream.commands.console import compiling_told, print_json
from dream.commands.survey.sources import archive_at, check_archive, named, option, warn_of_date
from dream.options import First

if TYPE_CHECKING:
    from dream.survey import Survey
    from dream.survey.archive import Entry

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Add:
    """Measure a run, and keep its survey in the archive. An archive that does not exist is made.

    A survey that is added again keeps its number. --replace puts another survey of the same run in the place
    of the one that is kept: one that was measured by a later version, or whose site was corrected.

    Examples:
        dream survey add runs/latest --site site.json
        dream survey add 3 --date 2026-06-01 --replace 3
    """

    survey: tyro.conf.Positional[str]
    """Folder of a run that was flown with --site or --keep-observations, or the file of a survey. To correct
    a survey in the archive, its number."""
    site: First[Path | None] = None
    """File that says where on earth it was, for a run that does not know or whose origin is wrong."""
    date: First[Annotated[str | None, tyro.conf.arg(metavar="YYYY-MM-DD[THH:MM[:SS]]")]] = None
    """When it began, in UTC, if the clock of the run was wrong or the date is not known."""
    replace: First[int | None] = None
    """Number of the survey in whose place it is put. Both are of the same run."""
    archive: First[str | None] = None
    """The archive: its path, or a postgresql:// URL. Unless given, the one that DREAM_ARCHIVE names, else
    surveys.gpkg."""
    save: First[Path | None] = None
    """File to write the survey to as well, such as reef.survey.npz."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.survey import files
        from dream.survey.archive.schema import FROM_NOWHERE
        from dream.survey.calibration import doubt
        from dream.survey.correcting import corrections, dated, located
        from dream.survey.site import read_site

        # What may be wrong here is read before a run is measured, which takes a while.
        check_archive(self.archive)
        site = None if self.site is None else read_site(self.site)
        date = None if self.date is None else _moment(self.date)
        before = None
        if self.replace is not None:
            with archive_at(self.archive) as archive:
                before = archive.get(self.replace)
        with compiling_told():
            survey = found = named(self.survey, self.archive)
        if site is not None:
            survey = located(survey, site)
        if date is not None:
            survey = dated(survey, date)
        if survey.site is None:
            raise ValueError(f"{survey.name}: {FROM_NOWHERE}")
        files.check(survey)  # Before an archive is begun for it.
        with contextlib.ExitStack() as stack:
            if self.save is not None:
                stack.enter_context(files.appearing(survey, self.save))
            archive = stack.enter_context(archive_at(self.archive, begin=True))
            if self.replace is None:
                number, new = archive.add(survey)
                replaced = False
            else:
                number, new, replaced = self.replace, False, archive.replace(self.replace, survey)
            where, entries = archive.name, archive.entries()
        for correction in corrections(before or found, survey):
            logger.warning("%s: %s", survey.name, correction)
        warn_of_date(survey, self.survey)
        if doubtful := doubt(survey.protocol, survey.target):
            logger.warning("%s: %s", survey.name, doubtful)
        if self.json:
            told = {"survey": number, "name": survey.name, "new": new, "replaced": replaced}
            print_json({"archive": where, **told, "measures": [asdict(one) for one in survey.measures]})
            return 0
        named_so = f"{survey.name} ({survey.site.name})"
        if new:
            print(f"{where}: kept {named_so} as survey {number}")
        elif replaced:
            print(f"{where}: put {named_so} in the place of survey {number}")
        else:
            print(f"{where}: has {named_so} already, as survey {number}")
        _print_measures(survey)
        _print_next(number, entries, option(where), self.survey)
        return 0


def _print_measures(survey: Survey) -> None:
    """What stands first in a report, each with its interval, and what is counted."""
    from dream.survey.products.words import FIRST, NOT_OYSTERS, interval_text, meaning, simulated, value_text
    from dream.types import Target

    if told := simulated(survey):
        print(f"  {told}")
    of = {measure.name: measure for measure in survey.measures}
    shown = [of[name] for name in FIRST if name in of]
    for measure in shown:
        between = f"  ({interval})" if (interval := interval_text(measure)) else ""
        print(f"  {meaning(measure.name).title:21}{value_text(measure)}{between}")
    if not shown:
        return
    caveat = "" if survey.target is Target.WRECK else f" {NOT_OYSTERS}."
    print(f"  In brackets: 95 % intervals.{caveat}")


def _print_next(number: int, entries: Sequence[Entry], archive: str, run: str) -> None:
    """Commands that go on with a survey, to be pasted.

    Args:
        number: Of the survey.
        entries: All that the archive holds.
        archive: What names it.
        run: As what the survey was given.
    """
    this = next(one for one in entries if one.number == number)
    others = [
        one for one in entries if (one.site, one.target) == (this.site, this.target) and one.number != number
    ]
    print("next:")
    print(f"  dream survey show {number}{archive}")
    if others:
        # With the one that is nearest in time.
        other = min(others, key=lambda one: abs(one.began - this.began))
        before, after = sorted((this, other), key=lambda one: (one.began, one.number))
        print(f"  dream survey compare {before.number} {after.number}{archive}")
    else:
        print("  survey the site again another time and add that run, to see what changed")
    pictures = f" --run {shlex.quote(run)}" if Path(run).is_dir() else ""
    print(f"  dream survey export {number}{pictures} --to products{archive}")


def _moment(said: str) -> datetime:
    """What `--date` says: UTC, unless it names another zone."""
    try:
        moment = datetime.fromisoformat(said)
        return (moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)).astimezone(UTC)
    except (ValueError, OverflowError):
        raise ValueError(
            "--date: expected a date, or a date and a time in UTC, such as 2026-06-01 or 2026-06-01T09:30, "
            f"got {said}"
        ) from None
