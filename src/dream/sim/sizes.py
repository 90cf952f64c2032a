"""A world of a wanted size and water, as its name says it: `reef/mound+40x30`, `wreck/2+60x50v6`.

`+40x30` makes it 40 m from west to east and 30 m from south to north; `v6` fills it with water in which a
Secchi disc vanishes at 6 m. Without it the water is drawn, as in a world of no wanted size.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dream.geometry import Bounds
from dream.sim.water import Water, water_of
from dream.sim.world import World

LEAST, MOST = 26, 100
"""Metres: the shortest and the longest side."""
TRIES = 200
"""Draws of a world until one has room for what it holds; then it has none."""
SIZED = re.compile(r"(?P<name>.+)\+(?P<east>\d{1,3})x(?P<north>\d{1,3})(?:v(?P<seen>\d{1,2}(?:\.\d)?))?")


@dataclass(frozen=True, slots=True)
class Size:
    """Of a survey area, and its water."""

    east: int
    """Metres from west to east, an even number."""
    north: int
    """Metres from south to north likewise."""
    visibility: float | None = None
    """Metres at which a Secchi disc vanishes; None where the water is drawn."""

    def __post_init__(self) -> None:
        for side in (self.east, self.north):
            if not LEAST <= side <= MOST or side % 2:
                raise ValueError(
                    f"area: expected two even numbers of metres from {LEAST} to {MOST}, such as 40x30, "
                    f"got {self.east}x{self.north}"
                )
        if self.visibility is not None:
            water_of(self.visibility)

    def __str__(self) -> str:
        seen = "" if self.visibility is None else f"v{self.visibility:g}"
        return f"{self.east}x{self.north}{seen}"

    @property
    def bounds(self) -> Bounds:
        """Its middle at the origin."""
        x, y = 0.5 * self.east, 0.5 * self.north
        return Bounds(-x, -y, x, y)

    @property
    def water(self) -> Water | None:
        """None where it is drawn."""
        return None if self.visibility is None else water_of(self.visibility)


class SizedBuilder(Protocol):
    """Makes a world from a random generator, of a wanted size if one is."""

    def __call__(self, rng: np.random.Generator, size: Size | None = None) -> World:
        """A ValueError where that size has no room for it."""
        ...


def sized(name: str) -> tuple[str, Size] | None:
    """The name of the world and the size that it is wanted in; None where a name asks for no size.

    Raises:
        ValueError: It asks for one that there is not.
    """
    found = SIZED.fullmatch(name)
    if found is None:
        return None
    seen = found["seen"]
    size = Size(int(found["east"]), int(found["north"]), None if seen is None else float(seen))
    return found["name"], size
