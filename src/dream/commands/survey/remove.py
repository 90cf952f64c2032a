"""`dream survey remove`: a survey out of the archive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from dream.commands.console import print_json
from dream.commands.survey.sources import archive_at
from dream.options import First


@dataclass(frozen=True, slots=True)
class Remove:
    """Take a survey out of the archive, without asking. The other surveys keep their numbers.

    The folder of the run stays. It can be added again, and gets another number.

    Examples:
        dream survey remove 3
    """

    survey: tyro.conf.Positional[Annotated[int, tyro.conf.arg(metavar="SURVEY")]]
    """Number of the survey in the archive."""
    archive: First[str | None] = None
    """The archive: its path, or a postgresql:// URL. Unless given, the one that DREAM_ARCHIVE names, else
    surveys.gpkg."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        with archive_at(self.archive) as archive:
            entry = archive.remove(self.survey)
            where = archive.name
        began = entry.began.isoformat()
        if self.json:
            told = {"survey": entry.number, "name": entry.name, "site": entry.site, "began": began}
            print_json({"archive": where, **told})
        else:
            print(
                f"{where}: removed survey {entry.number}, {entry.name} ({entry.site}, "
                f"{entry.began:%Y-%m-%d %H:%M})"
            )
        return 0
