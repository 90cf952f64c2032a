"""`dream survey compare`: what changed between two surveys of one site."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from dream.commands.console import check_writable, compiling_told, print_json
from dream.commands.progress import stage
from dream.commands.survey.sources import check_archive, found
from dream.commands.survey.words import slim_table
from dream.options import First
from dream.telling import one_line, rich_console

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from dream.survey.comparison import Comparison


logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Compare:
    """Tell what changed between two surveys of a site, on ground that both saw, and how sure that is.

    Writes a page to read (change.html), a map of the change as a picture, and its layers as a GeoPackage.

    Examples:
        dream survey compare 1 2 --out change
    """

    before: tyro.conf.Positional[str]
    """The earlier survey: its number in the archive, its file, or the folder of its run."""
    after: tyro.conf.Positional[str]
    """The later survey."""
    out: First[Path] = Path("change")
    """Folder for change.html, change.png, change.gpkg and change.json. It is made where it does not exist."""
    site: First[Path | None] = None
    """File that says where on earth it was, for runs that do not know."""
    archive: First[str | None] = None
    """The archive: its path, or a postgresql:// URL. Unless given, the one that DREAM_ARCHIVE names, else
    surveys.gpkg."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.survey.change_map import write_change
        from dream.survey.comparison import Comparing, doubts

        check_archive(self.archive)
        with _made_only_to_last(self.out):
            with compiling_told():
                a, b = (found(what, self.archive, self.site) for what in (self.before, self.after))
                for doubt in doubts(a, b):
                    logger.warning("compare: %s", doubt)
                with stage("comparing"):
                    comparison = Comparing().compare(a, b)
            with stage(f"writing {self.out}"):
                files = write_change(comparison, self.out)
        if self.json:
            print_json({**comparison.as_dict(), "files": [str(path) for path in files]})
        else:
            _print(comparison, files)
        return 0


@contextlib.contextmanager
def _made_only_to_last(folder: Path) -> Iterator[None]:
    """Make a folder, and take it away again, with those it is in that were made for it, where what follows
    fails."""
    made = [one for one in (folder, *folder.parents) if not one.exists()]
    try:
        check_writable(folder)
        yield
    except BaseException:
        for one in made:
            # Others may have put something there meanwhile.
            with contextlib.suppress(OSError):
                one.rmdir()
        raise


def _print(comparison: Comparison, files: tuple[Path, ...]) -> None:
    from rich.text import Text

    from dream.survey.change_map import PAGE
    from dream.survey.change_words import difference_cells, patch_rows, summary
    from dream.survey.numbers import p_value
    from dream.survey.sizes import size_bin

    console, told = rich_console(), comparison.as_dict()
    names = [(one_line(one.name), "bold") for one in (comparison.a, comparison.b)]
    console.print(Text.assemble(names[0], " → ", names[1]))
    if comparison.withheld:
        console.print("\n\n".join(summary(comparison)), highlight=False)
    else:
        _print_laid(console, told)
    for heading, differences in (
        ("what each tells of all that it saw itself", comparison.measures),
        ("all that both saw", () if comparison.withheld else comparison.differences),
    ):
        # The page has room for the size-frequency and for rates of a year.
        shown = [one for one in differences if size_bin(one.name) is None]
        if shown:
            rows = [(one.name, difference_cells(one), one.p) for one in shown]
            console.print()
            console.print(_table(heading, rows))
    for k, patch in enumerate(() if comparison.withheld else comparison.patches, start=1):
        colour = {"gain": "green", "loss": "red", "mixed": "magenta"}.get(patch.verdict, "default")
        # The verdict is the patch's, not each figure's.
        title = Text.assemble(
            f"patch {k}{'' if patch.before is not None else ', new'}: ",
            (patch.verdict, colour),
            "" if patch.p is None else f" (p {p_value(patch.p)})",
        )
        rows = list(patch_rows(patch))
        console.print()
        console.print(_table(title, rows) if rows else title)
    console.print()
    console.print(", ".join(map(str, files)), markup=False, highlight=False, soft_wrap=True)
    page = next(path for path in files if path.name == PAGE)
    console.print(f"  to read: {page}", markup=False, highlight=False, soft_wrap=True)


def _print_laid(console: Console, told: dict[str, Any]) -> None:
    """How one lies on the other, and what became of the individuals of both."""
    laid, ground, fates = told["registration"], told["ground_m2"], told["individuals"]
    console.print(
        f"laid on each other by {laid['by']} to {100.0 * laid['sigma_m']:.1f} cm; "
        f"{ground['comparable']:.0f} m² seen by both, {ground['only_before']:.0f} m² only before, "
        f"{ground['only_after']:.0f} m² only after",
        highlight=False,
    )
    if laid["note"]:
        console.print(one_line(laid["note"]), highlight=False)
    console.print(
        f"individuals found: {fates['there']} there in both, {fates['lost']} only before, "
        f"{fates['new']} only after, {fates['hidden_before']} and {fates['hidden_after']} not found again on "
        f"covered ground, {fates['not_comparable']} on ground that one of them did not see",
        highlight=False,
    )


def _table(title: str | Text, rows: Iterable[tuple[str, tuple[str, str, str], float]]) -> Table:
    """Of figures, each with its name, cells and p; all tables have the same columns."""
    from dream.survey.numbers import named, p_value

    table = slim_table(title)
    widths = {"": 13, "before → after": 16, "change": 15, "95 % interval": 17, "p": 7}
    for heading, width in widths.items():
        table.add_column(heading, justify="right" if heading else "left", min_width=width)
    for name, cells, p in rows:
        table.add_row(named(name), *cells, p_value(p))
    return table
