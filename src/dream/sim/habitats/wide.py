"""What dream-v1 calls a reef, in wider arenas and murkier water."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dream.sim import reef_shapes
from dream.sim.habitats.arena import Arena
from dream.sim.habitats.growth import Bottom, Crust, Places, spread
from dream.sim.reef_shapes import Stroke
from dream.sim.reefs import Bed
from dream.sim.sampling import Float64Array, index, uniform
from dream.sim.terrain import APRON

SHAPES = (reef_shapes.strings, reef_shapes.patches, reef_shapes.fringes, reef_shapes.mixed)
DENSITY = 8.0, 13.0
"""Clumps to the square metre, as in the arenas of dream-v1."""
HEIGHT = 0.08, 0.17
"""Likewise metres that a reef rises."""


@dataclass(frozen=True, slots=True, eq=False)
class Strokes:
    """Strings, patches, fringes, or some of each."""

    bed: Bed
    height: float
    group_radius: float = 1.5

    def share(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """1 well inside a stroke, 0 off all of them."""
        return self.bed.cover(x, y)[0]

    def relief(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """Old shell."""
        return self.bed.relief(x, y, self.height)

    def kept_free(self) -> Float64Array:
        """Small patches, of which a rock would leave little."""
        small = [stroke for stroke in self.bed.strokes if stroke.length < reef_shapes.PATCH]
        return np.array([(*stroke.line.mean(axis=0), stroke.half_width - 2.3) for stroke in small]).reshape(
            -1, 3
        )

    def places(self, bottom: Bottom, most: int, rng: np.random.Generator) -> Places:
        """All over the strokes, one clump high."""
        crust = Crust(self.bed.holes, self.bed.stands, 0.03)
        return spread(self, crust, DENSITY, self.group_radius, bottom, most, rng)


def strokes_in(arena: Arena, rng: np.random.Generator) -> Strokes:
    """A reef of one of the four shapes."""
    shape = SHAPES[index(rng, len(SHAPES))]
    strokes: list[Stroke] = []
    # A narrow arena may have no room for a string, or break a fringe where it has no second half.
    while not strokes or any(len(stroke.line) < 2 for stroke in strokes):
        strokes = shape(arena.bounds, rng)
    return Strokes(Bed.of(strokes, arena.bounds.widened(APRON), rng), uniform(rng, *HEIGHT))
