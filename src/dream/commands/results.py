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
    out: Path = Path("docs/results.md")
    """The page to write."""
    figures: Path | None = None
    """Folder for its pictures; one beside the page, of the same name, unless given."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.evaluation.report import write_results

        if not self.folders:
            raise ValueError("expected one or more benchmark folders, got none")
        if self.out.suffix != ".md":
            raise ValueError(f"--out: expected a name that ends in .md, got {self.out}")
        pictures = write_results(self.folders, self.out, self.figures or self.out.with_suffix(""))
        if self.json:
            print_json({"page": str(self.out), "figures": [str(path) for path in pictures]})
        else:
            print(self.out)
        return 0
