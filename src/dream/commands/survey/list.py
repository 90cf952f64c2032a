"""`dream survey list`: what is in the archive."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from dream.commands.console import print_json
from dream.commands.survey.sources import archive_at
from dream.commands.survey.words import slim_table
from dream.options import First
from dream.telling import one_line, rich_console


@dataclass(frozen=True, slots=True)
class List:
    """List the surveys in the archive, oldest first, with their main figures.

    Examples:
        dream survey list
    """

    site: First[str | None] = None
    """Name of a site: only its surveys are listed."""
    archive: First[str | None] = None
    """The archive: its path, or a postgresql:// URL. Unless given, the one that DREAM_ARCHIVE names, else
    surveys.gpkg."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.names import look_up

        with archive_at(self.archive) as archive:
            entries, where = archive.entries(), archive.name
        if self.site is not None:
            sites = {entry.site: [one for one in entries if one.site == entry.site] for entry in entries}
            entries = look_up(sites, self.site, "site", see="dream survey list")
        entries = sorted(entries, key=lambda entry: (entry.began, entry.number))
        if self.json:
            surveys = [
                {
                    "survey": entry.number,
                    "name": entry.name,
                    "site": entry.site,
                    "began": entry.began.isoformat(),
                    "target": entry.target,
                    "protocol": entry.protocol,
                    "patches": entry.patches,
                    "individuals_found": entry.individuals,
                    "measures": [asdict(measure) for measure in entry.measures],
                }
                for entry in entries
            ]
            print_json({"archive": where, "surveys": surveys})
            return 0
        from dream.types import Target

        table = slim_table(f"Surveys in {one_line(where)}")
        table.add_column("no", justify="right", no_wrap=True)
        table.add_column("site, when it began, and survey", overflow="fold")
        for heading in ("patches", "count", "area", "density"):
            table.add_column(heading, justify="right", no_wrap=True)
        for entry in entries:
            figures = {measure.name: measure for measure in entry.measures}
            area = figures.get("reef_area") or figures.get("outline_area")
            table.add_row(
                str(entry.number),
                f"{one_line(entry.site)}, {entry.began:%Y-%m-%d %H:%M}\n{one_line(entry.name)}",
                "" if entry.target == Target.WRECK else str(entry.patches),
                ""
                if (all_of := figures.get("count")) is None or all_of.value is None
                else f"{all_of.value:.0f}",
                "" if area is None or area.value is None else f"{area.value:.1f} m²",
                ""
                if (one := figures.get("density")) is None or one.value is None
                else f"{one.value:.1f} /m²",
            )
        rich_console().print(table)
        return 0
