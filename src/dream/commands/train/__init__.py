"""`dream train`: the networks that come with DREAM, made again. One file a subcommand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from dream.commands.train.sight import TrainSight
from dream.commands.train.uivnav import TrainUivnav


@dataclass(frozen=True, slots=True)
class Train:
    """Make a network: one that tells labels and depth of a picture, or one that steers by them.

    Examples:
        dream train sight --out sight
        dream train uivnav
    """

    command: (
        Annotated[TrainSight, tyro.conf.subcommand("sight")]
        | Annotated[TrainUivnav, tyro.conf.subcommand("uivnav")]
    )

    def __call__(self) -> int:
        """Exit status of the subcommand."""
        return self.command()
