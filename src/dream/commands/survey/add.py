"""`dream survey add`: a survey into the archive."""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass
from pathlib import Path

import tyro

from dream.commands.console import compiling_told, print_json
from dream.commands.survey.sources import archive_at, found

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Add:
    """Measure a run and keep its survey in the archive, which is begun where there is none.

    Added again, a survey keeps its number.
    """

    survey: tyro.conf.Positional[str]
    """Folder of a run that was flown with --site or --keep-observations, or the file of a survey."""
    site: Path | None = None
    """Of a run that does not know its origin: the file that does."""
    archive: str | None = None
    """Path, or postgresql:// URL, of the archive. Default: that in DREAM_ARCHIVE, else surveys.gpkg."""
    save: Path | None = None
    """Write the survey to this file too, such as reef.survey.npz."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.survey import files
        from dream.survey.archive.schema import FROM_NOWHERE
        from dream.survey.calibration import doubt

        with compiling_told():
            survey = found(self.survey, self.archive, self.site)
        if survey.site is None:
            raise ValueError(f"{survey.name}: {FROM_NOWHERE}")
        with contextlib.ExitStack() as stack:
            if self.save is not None:
                stack.enter_context(files.appearing(survey, self.save))
            archive = stack.enter_context(archive_at(self.archive, begin=True))
            number, new = archive.add(survey)
            where = archive.name
        if doubtful := doubt(survey.protocol, survey.target):
            logger.warning("%s: %s", survey.name, doubtful)
        if self.json:
            print_json({"archive": where, "survey": number, "name": survey.name, "new": new})
        elif new:
            print(f"{where}: kept {survey.name} ({survey.site.name}) as survey {number}")
        else:
            print(f"{where}: has {survey.name} ({survey.site.name}) already, as survey {number}")
        return 0
