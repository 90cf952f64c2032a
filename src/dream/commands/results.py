"""`dream results`: the page of results in the documentation, from the folders of benchmarks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dream.commands.console import print_json
from dream.commands.progress import with_progress
from dream.options import First


@dataclass(frozen=True, slots=True)
class Results:
    """Write the page of results from folders of benchmarks. The same folders give the same bytes.

    Examples:
        dream results bench/paper --out results.md
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of `dream bench`, or of `dream sweep`."""
    out: First[Path | None] = None
    """Page to write. Unless given, `results.md` in the first of the folders."""
    figures: First[Path | None] = None
    """Folder for its pictures. Unless given, a folder beside the page, named as the page."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.evaluation.report import write_results

        if not self.folders:
            raise ValueError("expected one or more benchmark folders, got none")
        # Where no other page can be: one that was released is written over only where it is named.
        page = self.folders[0] / "results.md" if self.out is None else self.out
        if page.suffix != ".md":
            raise ValueError(f"--out: expected a name that ends in .md, got {page}")
        pictures = write_results(
            self.folders,
            page,
            self.figures or page.with_suffix(""),
            watched=lambda folders: with_progress(folders, f"writing {page.name}", len(folders), "folders"),
        )
        if self.json:
            print_json({"page": str(page), "figures": [str(path) for path in pictures]})
        else:
            print(page)
        return 0
