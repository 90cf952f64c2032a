"""How surveys come into an archive, take each other's place and leave it: alike in every kind of database."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager

import numpy as np

from dream.survey import files
from dream.survey.archive import entries as told
from dream.survey.archive.entries import Entry
from dream.survey.archive.rows import Row, digest, rows
from dream.survey.survey import Survey

OF_ITS_RUN = ("digest", "run", "name", "began")
"""By what a survey is known to be kept, or another one of its run. A run that is not known, in files and
archives of older versions, is the one of that name and time."""


class Keeping(ABC):
    """The part of an `Archive` that decides; a database of one kind does what is abstract."""

    def add(self, survey: Survey) -> tuple[int, bool]:
        """Keep a survey; its number, and whether it is new there."""
        head, others = rows(survey)
        with self._changing():
            there = self._of_its_run(head)
            if (number := self._kept(head, there)) is not None:
                return number, False
            _check_first_of_its_run(head, there)
            number = self._begin_survey(head)
            self._fill(number, others)
            self._confirm(number, head, others)
            self._register_change()
        return number, True

    def replace(self, number: int, survey: Survey) -> bool:
        """Keep a survey in the place of another one of its run, by its number; whether that was another."""
        head, others = rows(survey)
        with self._changing():
            before, there = self.get(number), self._of_its_run(head)
            if self._kept(head, there) == number:
                return False
            _check_first_of_its_run(head, [one for one in there if one[0] != number])
            _check_same_run(number, before, survey)
            self._empty(number)
            self._renew_survey(number, head)
            self._fill(number, others)
            self._confirm(number, head, others)
            self._register_change()
        return True

    def remove(self, number: int) -> Entry:
        """Take the survey of that number out, with all that belongs to it; what it was."""
        with self._changing():
            entries = {entry.number: entry for entry in self._entries()}
            if number not in entries:
                raise missing(self.name, number, entries)
            self._empty(number)
            self._end_survey(number)
            self._register_change()
        return entries[number]

    def _kept(self, head: Row, there: Iterable[tuple[int, str, str]]) -> int | None:
        """The number of a survey that is in the archive already; None where it is not.

        Args:
            head: Its row of `surveys`.
            there: Number, digest and name of surveys of its run.
        """
        for number, kept, _ in there:
            # A file of an older version holds the same survey in other bytes.
            if head["digest"] == kept or head["digest"] == digest(files.dumped(self.get(number))):
                return number
        return None

    def _confirm(self, number: int, head: Row, others: Mapping[str, list[Row]]) -> None:
        """Raise a ValueError unless the database holds what was just written to it.

        A table of a stranger may ignore or replace what it is given.
        """
        wrote = told.entries(
            [(number, *(head[name] for name in told.COLUMNS[1:]))],
            [
                (number, *(row[name] for name in told.MEASURES[1:]))
                for row in others["measures"]
                if row["patch"] is None
            ],
            self.name,
        )
        found, body, counts = self._read_back(number)
        what = next((table for table, rows_of in others.items() if counts[table] != len(rows_of)), "")
        if not what and (found, body) != (head["digest"], others["documents"][0]["body"]):
            what = "documents"
        if not what and [entry for entry in self._entries() if entry.number == number] != wrote:
            what = "surveys"
        if what:
            raise ValueError(
                f"{self.name}: expected the survey that was just written, got other rows of {what}. "
                "Nothing was changed. Does the archive have rules of its own? Begin a new one"
            )

    @property
    @abstractmethod
    def name(self) -> str:
        """Where it is, for people to read."""

    @abstractmethod
    def get(self, number: int) -> Survey:
        """The survey of that number."""

    @abstractmethod
    def _changing(self) -> AbstractContextManager[None]:
        """A transaction in which nobody else changes the archive."""

    @abstractmethod
    def _entries(self) -> list[Entry]:
        """What is there, by number."""

    @abstractmethod
    def _of_its_run(self, head: Row) -> list[tuple[int, str, str]]:
        """Number, digest and name of the surveys of its run, as `OF_ITS_RUN` has it."""

    @abstractmethod
    def _begin_survey(self, head: Row) -> int:
        """Add a row of `surveys`; its number."""

    @abstractmethod
    def _renew_survey(self, number: int, head: Row) -> None:
        """Put a row of `surveys` in the place of another."""

    @abstractmethod
    def _end_survey(self, number: int) -> None:
        """Take a row of `surveys` out."""

    @abstractmethod
    def _fill(self, number: int, others: Mapping[str, list[Row]]) -> None:
        """Put in what belongs to a survey."""

    @abstractmethod
    def _read_back(self, number: int) -> tuple[str, bytes, dict[str, int]]:
        """Digest and body of a survey as the database holds them, and its rows in each table."""

    @abstractmethod
    def _empty(self, number: int) -> None:
        """Take out what belongs to a survey."""

    @abstractmethod
    def _register_change(self) -> None:
        """Tell those who read that something changed, where the database does not."""


def missing(where: str, number: int, numbers: Iterable[int]) -> ValueError:
    """What is said where there is no survey of that number, but those."""
    there = ", ".join(map(str, numbers)) or "none"
    return ValueError(
        f"{where}: expected the number of a survey in it, got {number}. There are: {there}. "
        "See dream survey list"
    )


def _check_first_of_its_run(head: Row, there: Iterable[tuple[int, str, str]]) -> None:
    """Raise a ValueError where the archive has another survey of its run. Arguments as of
    `Keeping._kept`."""
    for number, _, name in there:
        raise ValueError(
            f"{head['name']}: expected a run that is not in the archive, got that of survey {number} "
            f"({name}). Put this one in its place with --replace {number}, or take that one out with "
            f"dream survey remove {number}"
        )


def _check_same_run(number: int, before: Survey, after: Survey) -> None:
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
