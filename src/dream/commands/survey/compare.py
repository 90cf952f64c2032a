"""`dream survey compare`: what changed between two surveys of one site."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from dream.commands.console import check_writable, compiling_told, print_json
from dream.commands.survey.sources import found
from dream.commands.survey.words import UNITS, named, number, plain

if TYPE_CHECKING:
    from rich.table import Table

    from dream.survey import Survey
    from dream.survey.comparison import Comparison, Difference
    from dream.survey.fates import Missing


logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Compare:
    """Tell what changed from one survey of a site to a later one, where both looked, and how sure that is.

    Writes a map of the change as a picture, and its layers as a GeoPackage.
    """

    before: tyro.conf.Positional[str]
    """The earlier survey: its number in the archive, its file, or the folder of its run."""
    after: tyro.conf.Positional[str]
    """The later one."""
    out: Path = Path("change")
    """Folder for change.png, change.gpkg and change.json; made if it is not there."""
    site: Path | None = None
    """Of runs that do not know their origin: the file that does."""
    archive: str | None = None
    """Path, or postgresql:// URL, of the archive. Default: that in DREAM_ARCHIVE, else surveys.gpkg."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.survey.change_map import write_change
        from dream.survey.comparison import Comparing

        check_writable(self.out)
        with compiling_told():
            a, b = (found(what, self.archive, self.site) for what in (self.before, self.after))
            for doubt in _doubts(a, b):
                logger.warning("compare: %s", doubt)
            comparison = Comparing().compare(a, b)
        files = write_change(comparison, self.out)
        if self.json:
            print_json({**comparison.as_dict(), "files": [str(path) for path in files]})
        else:
            _print(comparison, files)
        return 0


def _doubts(a: Survey, b: Survey) -> list[str]:
    """What two surveys have that makes their comparison less than it says."""
    doubts = []
    if (a.name, a.began) == (b.name, b.began):
        doubts.append(
            f"both are {a.name}: expected two of a site. What differs is how one was laid on the other"
        )
    if a.began > b.began:
        doubts.append(
            f"{a.name} began after {b.name}; what is told as gained was lost, if their clocks are right"
        )
    if a.protocol != b.protocol:
        doubts.append(
            f"{a.name} was made by {a.protocol} and {b.name} by {b.protocol}: what two ways of looking "
            "differ by is not in the intervals, and may be told as a change"
        )
    return doubts


def _print(comparison: Comparison, files: tuple[Path, ...]) -> None:
    from rich.console import Console

    console, told = Console(), comparison.as_dict()
    console.print(f"[bold]{plain(comparison.a.name)}[/bold] → [bold]{plain(comparison.b.name)}[/bold]")
    laid, ground, fates = told["registration"], told["ground_m2"], told["individuals"]
    console.print(
        f"laid on each other by {laid['by']} to {100.0 * laid['sigma_m']:.1f} cm; "
        f"{ground['comparable']:.0f} m² seen by both, {ground['only_before']:.0f} m² only before, "
        f"{ground['only_after']:.0f} m² only after",
        highlight=False,
    )
    if laid["note"]:
        console.print(plain(laid["note"]), highlight=False)
    console.print(
        f"individuals found: {fates['there']} there in both, {fates['lost']} only before, "
        f"{fates['new']} only after, {fates['hidden_before']} and {fates['hidden_after']} not found again on "
        f"covered ground, {fates['not_comparable']} on ground that one of them did not see",
        highlight=False,
    )
    table = _table("where both looked")
    for one in comparison.differences:
        table.add_row("all", *_cells(one), "", f"{one.p:.2g}")
    for k, patch in enumerate(comparison.patches, start=1):
        colour = {"gain": "green", "loss": "red", "mixed": "magenta"}.get(patch.verdict, "default")
        verdict = f"[{colour}]{patch.verdict}[/]"
        verdict += "" if patch.p is None else f" (p {patch.p:.2g})"
        name = f"patch {k}" if patch.before is not None else f"patch {k}, new"
        if not patch.differences:
            table.add_row(name, "", "", "", "", verdict, "")
        rows = [
            (*_share(what, share), share.p)
            for what, share in (("gone", patch.gone), ("come", patch.come))
            if share is not None
        ]
        rows += [(*_cells(one), one.p) for one in patch.differences]
        # The verdict is the patch's, not each figure's.
        heads = [(name, verdict)] + [("", "")] * len(rows)
        for (head, last), (*cells, p) in zip(heads, rows, strict=False):
            table.add_row(head, *cells, last, f"{p:.2g}")
    console.print(table)
    console.print(", ".join(map(str, files)), markup=False, highlight=False, soft_wrap=True)


def _table(title: str) -> Table:
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for heading in ("", "figure", "before → after", "change", "95 % interval", "verdict", "p"):
        table.add_column(heading, justify="left" if heading in ("", "figure", "verdict") else "right")
    return table


def _share(what: str, of: Missing) -> tuple[str, str, str, str]:
    sign = -1.0 if what == "gone" else 1.0
    low, share, high = (f"{sign * one:+z.0%}" for one in (of.low, of.share, of.high))
    return what, f"{of.bare} of {of.of}", share, f"{low} to {high}"


def _cells(one: Difference) -> tuple[str, str, str, str]:
    unit = UNITS.get(one.unit, one.unit)
    share = f" ({one.change / one.before:+z.0%})" if one.before > 0.0 else ""
    return (
        named(one.name),
        f"{number(one.before)} → {number(one.after)} {unit}".strip(),
        f"{one.change:+.3g}{share}",
        f"{number(one.low)} to {number(one.high)}",
    )
