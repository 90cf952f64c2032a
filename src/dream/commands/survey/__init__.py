"""`dream survey`: surveys kept over the years, and what changed between them. One file a subcommand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from dream.commands.survey.add import Add
from dream.commands.survey.compare import Compare
from dream.commands.survey.export import Export
from dream.commands.survey.list import List
from dream.commands.survey.remove import Remove
from dream.commands.survey.show import Show


@dataclass(frozen=True, slots=True)
class Survey:
    """Measure what a run saw, keep it in an archive, tell what changed, and make maps for others.

    Examples:
        dream survey add runs/latest --site site.json
        dream survey list
    """

    command: (
        Annotated[Add, tyro.conf.subcommand("add")]
        | Annotated[List, tyro.conf.subcommand("list")]
        | Annotated[Show, tyro.conf.subcommand("show")]
        | Annotated[Remove, tyro.conf.subcommand("remove")]
        | Annotated[Compare, tyro.conf.subcommand("compare")]
        | Annotated[Export, tyro.conf.subcommand("export")]
    )

    def __call__(self) -> int:
        """Exit status of the subcommand."""
        return self.command()
