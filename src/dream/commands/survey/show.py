"""`dream survey show`: the figures of one survey."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from dream.commands.console import compiling_told, print_json
from dream.commands.survey.sources import found
from dream.commands.survey.words import measure_row, slim_table
from dream.options import First
from dream.telling import one_line, rich_console

if TYPE_CHECKING:
    from dream.survey import Measure, Survey


@dataclass(frozen=True, slots=True)
class Show:
    """Show the measures of a survey with their 95 % intervals: of the whole, and of each patch.

    Examples:
        dream survey show 1
        dream survey show runs/latest
    """

    survey: tyro.conf.Positional[str]
    """Number of a survey in the archive, its file, or the folder of a run."""
    site: First[Path | None] = None
    """File that says where on earth it was, for a run that does not know."""
    archive: First[str | None] = None
    """The archive: its path, or a postgresql:// URL. Unless given, the one that DREAM_ARCHIVE names, else
    surveys.gpkg."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        with compiling_told():
            survey = found(self.survey, self.archive, self.site)
        if self.json:
            print_json(_told(survey))
        else:
            _print(survey)
        return 0


def _told(survey: Survey) -> dict[str, Any]:
    site = survey.site
    return {
        "name": survey.name,
        "began": survey.began.isoformat(),
        "site": None
        if site is None
        else {
            "name": site.name,
            "latitude": site.latitude,
            "longitude": site.longitude,
            "heading_deg": site.heading_deg,
            "datum": site.datum,
        },
        "target": str(survey.target),
        "protocol": survey.protocol,
        "steps": len(survey.decisions),
        "individuals_found": len(survey.individuals),
        "measures": [asdict(measure) for measure in survey.measures],
        "patches": [[asdict(measure) for measure in patch.measures] for patch in survey.patches],
        **({"structures": _structures(survey)} if survey.structures else {}),
        "made_by": survey.made_by,
    }


def _structures(survey: Survey) -> list[dict[str, Any]]:
    from dream.survey.products.words import side_name

    return [
        {
            "axis": one.axis,
            "measures": [asdict(measure) for measure in one.measures],
            "sides": [
                {
                    "name": side_name(side, survey.site),
                    "kind": side.kind,
                    "bearing": side.bearing,
                    "measures": [asdict(measure) for measure in side.measures],
                }
                for side in one.sides
            ],
        }
        for one in survey.structures
    ]


def _print(survey: Survey) -> None:
    from rich.text import Text

    from dream.survey.calibration import doubt
    from dream.types import Target

    console = rich_console()
    # The hull is one, what lies around it are others.
    part, parts = ("piece", "pieces") if survey.target is Target.WRECK else ("patch", "patches")
    where = "no origin" if survey.site is None else one_line(survey.site.name)
    began = f"{survey.began:%Y-%m-%d %H:%M:%S %Z}"
    console.print(Text.assemble((one_line(survey.name), "bold"), f"  {where}, {began}"))
    console.print(
        f"{survey.target} by {one_line(survey.protocol)}, {len(survey.decisions)} decisions"
        # A wreck has neither.
        + f", {len(survey.individuals)} individuals found (count tells how many there are)"
        * any(measure.name == "count" for measure in survey.measures)
        + f", {parts}: {len(survey.patches)}" * bool(survey.patches)
    )
    if doubtful := doubt(survey.protocol, survey.target):
        console.print(f"\n{one_line(doubtful)}", highlight=False)
    table = slim_table()
    for heading in ("measure", "value", "95 % interval"):
        table.add_column(heading, no_wrap=True)
    table.add_column("note")
    for measure in survey.measures:
        table.add_row(*measure_row(measure))
    console.print()
    console.print(table)
    if survey.patches:
        _print_rows(part, [(str(k), patch.measures) for k, patch in enumerate(survey.patches, start=1)])
    if survey.structures:
        from dream.survey.products.words import of_structures

        rows = [(f"{number} {side}".strip(), measures) for number, side, measures in of_structures(survey)]
        _print_rows("structure", rows)


def _print_rows(what: str, rows: Sequence[tuple[str, Sequence[Measure]]]) -> None:
    """A table with a row for each of some parts, and a column for each of their measures."""
    from dream.survey.numbers import named

    names = list(dict.fromkeys(measure.name for _, measures in rows for measure in measures))
    table = slim_table()
    for heading in (what, *map(named, names)):
        table.add_column(heading)
    for name, measures in rows:
        values = {measure.name: measure_row(measure) for measure in measures}
        cells = (values.get(one, ("", "", "", "")) for one in names)
        table.add_row(name, *(f"{value}\n{interval}".strip() for _, value, interval, _ in cells))
    console = rich_console()
    console.print()
    console.print(table)
