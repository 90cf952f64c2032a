"""Which options `--help` shows: those that are marked where they are declared."""

from __future__ import annotations

from typing import Annotated, TypeVar

T = TypeVar("T")


class FirstRank:
    """Mark of an option that people use first; `--help` shows it, and `--help-all` shows the others too."""


First = Annotated[T, FirstRank()]
"""Type of such an option: `seed: First[int] = 1`."""
