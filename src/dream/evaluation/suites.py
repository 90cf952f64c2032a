"""Suites: fixed lists of worlds."""

from __future__ import annotations

from dataclasses import dataclass

from dream.names import look_up


@dataclass(frozen=True, slots=True)
class Case:
    """One world of a suite."""

    world: str
    seed: int


SUITES: dict[str, tuple[Case, ...]] = {
    "paper": (
        Case("reef/fringing", 1),
        Case("reef/string", 1),
        Case("reef/patch", 1),
        Case("reef/mixed", 1),
        Case("reef/mixed", 2),
        Case("reef/L", 1),
        Case("reef/S", 1),
        Case("reef/O", 1),
        Case("reef/K", 1),
        Case("reef/E", 1),
        Case("wreck/1", 1),
        Case("wreck/2", 1),
        Case("wreck/3", 1),
        Case("wreck/4", 1),
        Case("wreck/5", 1),
    ),
}
"""`paper`: ten reefs and five wrecks, as many as the paper has."""


def suite_named(name: str) -> tuple[Case, ...]:
    """The worlds of a suite; a ValueError with the nearest name where there is none."""
    return look_up(SUITES, name, "suite")
