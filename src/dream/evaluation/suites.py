"""Suites: fixed lists of worlds to develop on and to report, and lists of the user's own."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from dream.names import look_up
from dream.protocol import DREAM_V2
from dream.sim.files import load_world, world_hash
from dream.sim.habitats import HABITATS
from dream.sim.world import World
from dream.sim.worlds import check_named, is_saved, make_world, origin, saved_world

REEF_FAMILIES = ("fringing", "string", "patch", "mixed")
"""The paper's kinds of reef."""
LETTERS = ("L", "S", "O", "K", "E")
"""The successor paper's shapes of reef."""
WRECKS = (1, 2, 3, 4, 5)
WEAK = ("reef/mound", "reef/carpet", "reef/tiny", "reef/dense")
"""Those on which a stop that was right on the paper's kinds of reef was wrong, so that many are needed."""
SEVERAL = (
    "wreck/1+wreck/3",
    "wreck/2+wreck/4",
    "wreck/5+reef/patch",
    "wreck/3+reef/string",
    "wreck/4+reef/mixed",
)
"""Two structures in one world."""
SEALED_FAMILIES: tuple[tuple[str, ...], ...] = (
    *((name,) for name in HABITATS),
    tuple(f"wreck/{number}" for number in WRECKS),
    SEVERAL,
)
"""What the worlds of a sealed test are drawn from (`dream.evaluation.sealed`): each family is as likely as
every other, and in it each name. Whatever changes here changes what every key makes, and its commitment."""
SEALED_PROTOCOL = DREAM_V2.name
"""By which they are flown unless another is asked for: one for all blocks, whichever world is drawn first."""
SEALED_STEPS = 1200
"""No mission of a sealed test has more: arenas for which a search needs more are not drawn."""

MOST_SEEDS = 10_000
MOST_CASES = 10_000
"""A longer list of the user's own is refused."""
MOST_BYTES = 1 << 20
"""A larger file of such a list is refused."""
LISTED = ".txt"
"""How the name of such a file ends."""
LINE = "WORLD [SEED or A..B] [start N]"
WORLD_NAME = re.compile(r"[^\W_][\w ./+()-]{0,99}")
"""What a world can be called in the results of a benchmark."""


@dataclass(frozen=True, slots=True)
class Case:
    """One world of a suite, and where in it the mission starts."""

    world: str
    seed: int
    start: int = 0
    """Which of the world's start poses."""
    folder: str = field(default="", compare=False)
    """Where the world is saved; empty where its name and seed make it."""
    world_hash: str = field(default="", compare=False)
    """Of what is saved there."""

    def as_dict(self) -> dict[str, str | int]:
        """What it is known by."""
        return {"world": self.world, "seed": self.seed, "start": self.start}

    def open(self) -> World:
        """The world.

        Raises:
            ValueError: It cannot be read, or is not what it was when the case was made.
        """
        if not self.folder:
            return make_world(self.world, self.seed)
        world = load_world(self.folder)
        if (found := world_hash(world)) != self.world_hash:
            raise ValueError(
                f"{self.folder}: expected the world {self.world_hash[:12]} that was there before, got "
                f"{found[:12]}. Was it edited?"
            )
        return replace(world, name=self.world)


def _generated(reefs: range, letters: range, wrecks: range) -> tuple[Case, ...]:
    """All families, each with its own seeds."""
    return (
        *(Case(f"reef/{family}", seed) for family in REEF_FAMILIES for seed in reefs),
        *(Case(f"reef/{letter}", seed) for letter in LETTERS for seed in letters),
        *(Case(f"wreck/{number}", seed) for number in WRECKS for seed in wrecks),
    )


def _wide(reefs: range, weak: range, others: range) -> tuple[Case, ...]:
    """The families of wide worlds, more of the weak ones; wrecks, and several structures."""
    return (
        *(Case(name, seed) for name in HABITATS for seed in (weak if name in WEAK else reefs)),
        *(Case(f"wreck/{number}", seed) for number in WRECKS for seed in others),
        *(Case(name, seed) for name in SEVERAL for seed in others[: len(others) // 2]),
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
    "dev-v2": _wide(range(2001, 2026), range(2001, 2101), range(2001, 2005)),
    "test-v2": _wide(range(3001, 3026), range(3001, 3026), range(3001, 3011)),
    "test-seen": (
        *(Case(name, seed) for name in HABITATS for seed in range(4001, 4006)),
        *(Case(name, 4006) for name in (*WEAK, "reef/two")),
        *(Case(f"wreck/{number}", seed) for number in WRECKS for seed in (4001, 4002)),
    ),
}
"""`paper`: ten reefs and five wrecks, as many as the paper has. `dev`: 60 worlds to develop and tune on.
`test`: 200 worlds to report; no parameter was chosen by them, and whoever tunes on them has no result. Of
its wrecks, seeds 1001 to 1003 of `wreck/1` to `wreck/4` were looked at while the belief about hulls was made
finer. `dev-v2` and `test-v2` are the same for protocols that move in space: 605 and 350 worlds. Of `test-v2`
the first two reefs of each wide family and the first of each wreck were flown once. `test-seen`: 60 reefs and
ten wrecks for `dream-v2-seen`, whose network learned from none of them."""


def suite_named(name: str) -> tuple[Case, ...]:
    """The worlds of a suite, or those that a file lists; see `read_suite`.

    Raises:
        ValueError: With the nearest name where there is none.
    """
    if name.endswith(LISTED):
        return read_suite(Path(name))
    see = f"There are: {', '.join(SUITES)}; a list of your own is a file {LISTED}"
    return look_up(SUITES, name, "suite", see=see)


def read_suite(path: Path) -> tuple[Case, ...]:
    """The worlds that a file lists: a line `WORLD [SEED or A..B] [start N]` each, in UTF-8.

    WORLD is a name from `dream worlds`, or a folder that holds a saved world, as seen from where the file
    lies; the seed of such a one is its own. Quotes hold together what has spaces; # begins a remark.

    Raises:
        ValueError: What is wrong, and in which line.
    """
    if not path.is_file():
        raise ValueError(f"{path}: expected a file that lists worlds, a line {LINE} each, got none")
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path}: expected at most {MOST_BYTES} bytes, got {path.stat().st_size}")
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected UTF-8 text, got {error.reason} at byte {error.start}") from None
    found: dict[Case, int] = {}
    for number, line in enumerate(lines, start=1):
        try:
            for case in _listed(line, path.parent):
                if case in found:
                    raise ValueError(_twice(case, found[case]))
                if len(found) == MOST_CASES:
                    raise ValueError(f"expected at most {MOST_CASES} worlds, got more")
                found[case] = number
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from error
    if not found:
        raise ValueError(f"{path}: expected at least one world, a line {LINE} each, got none")
    return tuple(found)


def _twice(case: Case, line: int) -> str:
    said = f"expected each world once, got {case.world} {case.seed}, start {case.start}, of line {line} again"
    return said + '. If it is another, change "name" or "seed" in its world.json' * bool(case.folder)


def _listed(line: str, beside: Path) -> Iterator[Case]:
    """The cases of a line, whose folders are as seen from `beside`."""
    try:
        words = shlex.split(line, comments=True)
    except ValueError as error:
        raise ValueError(f"expected {LINE}, got {line.strip()[:80]} ({error})") from None
    if not words:
        return
    world, *rest = words
    start = 0
    if len(rest) > 1 and rest[-2] == "start" and re.fullmatch(r"\d{1,4}", rest[-1], re.ASCII):
        start, rest = int(rest[-1]), rest[:-2]
    if len(rest) > 1:
        raise ValueError(f"expected {LINE}, got {line.strip()[:80]}")
    if not is_saved(beside / world):
        check_named(world, beside / world)
        for seed in seeds_of(rest[0] if rest else "1", "seed"):
            yield named_case(world, seed, start)
    elif rest:
        raise ValueError(
            f"expected no seed behind a folder, whose world has its own, got {rest[0]}. Is it a start? "
            f"Then write: {world} start {rest[0]}"
        )
    else:
        yield saved_case(beside / world, start)


def named_case(world: str, seed: int, start: int = 0) -> Case:
    """A world of that name; a ValueError with the nearest one where there is none."""
    check_named(world, Path(world))
    return Case(world, seed, start)


def saved_case(folder: Path, start: int = 0) -> Case:
    """The world in a folder.

    Raises:
        ValueError: It cannot be read, cannot be called what it is called, or has no such start.
    """
    world = saved_world(folder)
    if not WORLD_NAME.fullmatch(world.name):
        raise ValueError(
            f"{folder}: expected a world named by letters, digits, spaces and _ . / + - ( ), a letter or a "
            f'digit first, got "{world.name}". Change "name" in its world.json'
        )
    if start >= len(world.starts):
        raise ValueError(f"{folder}: start: expected 0 to {len(world.starts) - 1}, got {start}")
    return Case(world.name, world.seed, start, folder.as_posix(), world_hash(world))


def seeds_of(text: str, what: str) -> range:
    """The seeds that a number or `A..B` names, both ends included.

    Args:
        text: The words.
        what: What an error calls them.
    """
    found = re.fullmatch(r"(\d{1,18})(?:\.\.(\d{1,18}))?", text, re.ASCII)
    if not found:
        raise ValueError(f"{what}: expected a number or A..B such as 1..5, got {text}")
    first, last = int(found[1]), int(found[2] or found[1])
    if last < first:
        raise ValueError(f"{what}: expected the lower seed first, got {text}. Did you mean {last}..{first}?")
    if last - first >= MOST_SEEDS:
        raise ValueError(f"{what}: expected at most {MOST_SEEDS} seeds, got {last - first + 1}")
    return range(first, last + 1)


def family_of(world: str) -> str:
    """The family that a world is counted with: one of `REEF_FAMILIES`, letter, wreck, several, pool or flat.

    One of `HABITATS` is a family of its own, called as it is behind `reef/`.

    A reef some years on, `reef/string+1y1`, is of the family that it was of.

    Raises:
        ValueError: The world is of no family, since it is the user's own: made, or changed.
    """
    kind, _, name = (origin(world) or "").partition("/")
    if "+" in name:
        return "several"
    if kind in ("wreck", "pool", "flat"):
        return kind
    if kind == "reef" and name in LETTERS:
        return "letter"
    if kind == "reef" and (name in REEF_FAMILIES or f"reef/{name}" in HABITATS):
        return name
    raise ValueError(f'no family for the world "{world}". See dream worlds')
