"""`dream results`: the page of results in the documentation, from the folders of benchmarks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dream.commands.console import print_json


@dataclass(frozen=True, slots=True)
class Results:
    """Write the documentation's page of results from benchmark folders; equal folders give equal bytes."""

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of `dream bench`, or of `dream sweep`, which hold one benchmark a reach."""
    out: Path | None = None
    """The page to write; `results.md` in the first of the folders unless given."""
    figures: Path | None = None
    """Folder for its pictures; one beside the page, of the same name, unless given."""
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
        pictures = write_results(self.folders, page, self.figures or page.with_suffix(""))
        if self.json:
            print_json({"page": str(page), "figures": [str(path) for path in pictures]})
        else:
            print(page)
        return 0
