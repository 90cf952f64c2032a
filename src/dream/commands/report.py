"""`dream report`: the page of a recorded run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dream.commands.console import print_json
from dream.commands.progress import stage


@dataclass(frozen=True, slots=True)
class Report:
    """Write the page of a run again, also of one that was aborted. Of a dive, its picture is drawn too.

    Examples:
        dream report runs/latest
    """

    run: tyro.conf.Positional[Path]
    """Folder of the run; runs/latest is the newest."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.commands.dive import draw_flown
        from dream.report import write_report

        if (self.run / "log.mcap").is_file():
            draw_flown(self.run, quiet=self.json)
        with stage("writing report.html"):
            page = write_report(self.run)
        if self.json:
            print_json({"run": str(self.run), "report": str(page)})
        else:
            print(page)
        return 0
