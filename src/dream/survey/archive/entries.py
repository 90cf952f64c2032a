"""What an archive tells of its surveys without opening them."""

from __future__ import annotations

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


def entries(surveys: Iterable[Sequence[Any]], measures: Iterable[Sequence[Any]]) -> list[Entry]:
    """From rows of `COLUMNS` and of `MEASURES`, each in order."""
    of: dict[int, list[Measure]] = {}
    for number, *fields in measures:
        of.setdefault(number, []).append(Measure(*fields))
    found = []
    for row in surveys:
        named: dict[str, Any] = dict(zip(COLUMNS, row, strict=True))
        number, began = named.pop("id"), named.pop("began")
        moment = began if isinstance(began, datetime) else datetime.fromisoformat(began)
        found.append(Entry(number=number, began=moment, measures=tuple(of.get(number, ())), **named))
    return found
