"""A person in the place of a planner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NoReturn

from dream.types import Mission


@dataclass(frozen=True, slots=True)
class Human:
    """A person who decides: what a run and a benchmark name as their planner where somebody flew by hand.

    It has no parameters and decides nothing by itself. Decisions come from the page of `dream fly`
    (`dream.live.helm`), or, flown again, from a record of them (`dream.evaluation.again`).
    """

    spatial: ClassVar[bool] = True

    def begin(self, mission: Mission) -> NoReturn:
        """Raise a ValueError: there is nobody here to ask."""
        raise ValueError("human: expected a person at the page of dream fly, got none")
