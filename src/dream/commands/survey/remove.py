"""`dream survey remove`: a survey out of the archive."""

from __future__ import annotations

from dataclasses import dataclass

import tyro

from dream.commands.console import print_json
from dream.commands.survey.sources import archive_at


@dataclass(frozen=True, slots=True)
class Remove:
    """Take a survey out of the archive, with all that belongs to it; the others keep their numbers.

    It does so without asking. The run itself is left alone, and can be added again, under another number.
    """

    survey: tyro.conf.Positional[int]
    """Its number in the archive."""
    archive: str | None = None
    """Path, or postgresql:// URL, of the archive. Default: that in DREAM_ARCHIVE, else surveys.gpkg."""
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
