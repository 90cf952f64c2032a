"""What an archive tells of its surveys without opening them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from dream.survey.survey import Measure


@dataclass(frozen=True, slots=True)
class Entry:
    """A survey in an archive."""

    number: int
    name: str
    site: str
    began: datetime
    target: str
    protocol: str
    steps: int
    patches: int
    individuals: int
    measures: tuple[Measure, ...]
    """Of the whole survey."""


COLUMNS = ("id", "name", "site", "began", "target", "protocol", "steps", "patches", "individuals")
MEASURES = ("survey_id", "name", "value", "low", "high", "unit", "note")


_TEXTS = {"name", "site", "target", "protocol", "unit", "note"}
MOST_TEXT = 20_000
"""Characters of one; as many as the file of a survey may have."""


def entries(surveys: Iterable[Sequence[Any]], measures: Iterable[Sequence[Any]], where: str) -> list[Entry]:
    """From rows of `COLUMNS` and of `MEASURES`, each in order.

    A database of a stranger holds what it likes in any column.

    Raises:
        ValueError: A row holds something else than it should; the message names `where`.
    """
    of: dict[int, list[Measure]] = {}
    for row in measures:
        named = _checked(MEASURES, row, where)
        of.setdefault(named.pop("survey_id"), []).append(Measure(**named))
    found = []
    for row in surveys:
        named = _checked(COLUMNS, row, where)
        number = named.pop("id")
        found.append(Entry(number=number, measures=tuple(of.get(number, ())), **named))
    return found


def _checked(columns: Sequence[str], row: Sequence[Any], where: str) -> dict[str, Any]:
    named = dict(zip(columns, row, strict=True))
    for name, value in named.items():
        if name == "began":
            expected, good = "a time with its zone", isinstance(value, datetime)
            if isinstance(value, str):
                try:
                    named[name] = datetime.fromisoformat(value)
                    good = named[name].tzinfo is not None
                except ValueError:
                    good = False
        elif name in _TEXTS:
            expected, good = "words", isinstance(value, str) and len(value) <= MOST_TEXT
        elif name in ("value", "low", "high"):
            expected = "a number or none"
            good = value is None or (isinstance(value, int | float) and math.isfinite(value))
        else:
            expected, good = "a whole number", isinstance(value, int)
        if not good:
            raise ValueError(f"{where}: {name} of a row: expected {expected}, got {str(value)[:80]!r}")
    return named
