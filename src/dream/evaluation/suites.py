"""Suites: fixed lists of worlds to develop on and to report."""

from __future__ import annotations

from dataclasses import dataclass

from dream.names import look_up

REEF_FAMILIES = ("fringing", "string", "patch", "mixed")
"""The paper's kinds of reef."""
LETTERS = ("L", "S", "O", "K", "E")
"""The successor paper's shapes of reef."""
WRECKS = (1, 2, 3, 4, 5)


@dataclass(frozen=True, slots=True)
class Case:
    """One world of a suite, and where in it the mission starts."""

    world: str
    seed: int
    start: int = 0
    """Which of the world's start poses."""


def _generated(reefs: range, letters: range, wrecks: range) -> tuple[Case, ...]:
    """All families, each with its own seeds."""
    return (
        *(Case(f"reef/{family}", seed) for family in REEF_FAMILIES for seed in reefs),
        *(Case(f"reef/{letter}", seed) for letter in LETTERS for seed in letters),
        *(Case(f"wreck/{number}", seed) for number in WRECKS for seed in wrecks),
    )


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
    "dev": _generated(range(101, 106), range(101, 105), range(101, 105)),
    "test": _generated(range(1001, 1026), range(1001, 1011), range(1001, 1011)),
}
"""`paper`: ten reefs and five wrecks, as many as the paper has. `dev`: 60 worlds to develop and tune on.
`test`: 200 worlds to report; no parameter was chosen by them, and whoever tunes on them has no result. Of
its wrecks, seeds 1001 to 1003 of `wreck/1` to `wreck/4` were looked at while the belief about hulls was made
finer."""


def suite_named(name: str) -> tuple[Case, ...]:
    """The worlds of a suite; a ValueError with the nearest name where there is none."""
    return look_up(SUITES, name, "suite")


def family_of(world: str) -> str:
    """The family that a world is counted with: one of `REEF_FAMILIES`, letter, wreck, pool or flat.

    A reef some years on, `reef/string+1y1`, is of the family that it was of.

    Raises:
        ValueError: The world is of no family.
    """
    kind, _, name = world.partition("+")[0].partition("/")
    if kind in ("wreck", "pool", "flat"):
        return kind
    if kind == "reef" and name in LETTERS:
        return "letter"
    if kind == "reef" and name in REEF_FAMILIES:
        return name
    raise ValueError(f'no family for the world "{world}". See dream worlds')
