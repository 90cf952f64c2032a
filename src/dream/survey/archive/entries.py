"""What an archive tells of its surveys without opening them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from dream.survey.archive.rows import Row
from dream.survey.survey import Measure, Survey


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


OF_ITS_RUN = ("digest", "run", "name", "began")
"""By what a survey is known to be kept, or another one of its run. A run that is not known, in files and
archives of older versions, is the one of that name and time."""


def kept(head: Row, there: Iterable[tuple[int, str, str]]) -> int | None:
    """The number of a survey that is in the archive already; None where it is not.

    Args:
        head: Its row of `surveys`.
        there: Number, digest and name of surveys of its run.
    """
    return next((number for number, digest, _ in there if digest == head["digest"]), None)


def check_first_of_its_run(head: Row, there: Iterable[tuple[int, str, str]]) -> None:
    """Raise a ValueError where the archive has another survey of its run. Arguments as of `kept`."""
    for number, _, name in there:
        raise ValueError(
            f"{head['name']}: expected a run that is not in the archive, got that of survey {number} "
            f"({name}). Put this one in its place with --replace {number}, or take that one out with "
            f"dream survey remove {number}"
        )


def check_same_run(number: int, before: Survey, after: Survey) -> None:
    """Raise a ValueError unless both were measured from one run."""
    if before.run is None or after.run is None:
        # An older version did not keep which run: then by where the vehicle was, and when.
        same = np.array_equal(before.track.time, after.track.time)
        same = same and np.array_equal(before.track.position, after.track.position)
    else:
        same = before.run == after.run
    if not same:
        raise ValueError(
            f"--replace {number}: expected another measurement of the run of survey {number} "
            f"({before.name}), got another run ({after.name}). Add it without --replace"
        )


def missing(where: str, number: int, numbers: Iterable[int]) -> ValueError:
    """What is said where there is no survey of that number, but those."""
    there = ", ".join(map(str, numbers)) or "none"
    return ValueError(
        f"{where}: expected the number of a survey in it, got {number}. There are: {there}. "
        "See dream survey list"
    )
