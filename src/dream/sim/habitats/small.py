"""Small groups far apart: what is left of a reef, or what begins one.

What divers find of *Ostrea* on rocky outcrops are clumps of 5 to 10 oysters and small reefs of such (EUNIS
MB243); in Strangford Lough oysters that settle on each other have begun to make small heaps (Smyth et al.
2020, doi 10.1016/j.seares.2020.101927). How wide such groups are is our choice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dream.geometry import Bounds
from dream.sim.habitats.growth import SLACK, SPARE, Bottom, Places
from dream.sim.reefs import places_in
from dream.sim.sampling import MILLIMETRE, Float64Array, between, length, quantised, uniform, uniforms

GROUPS = 6, 15
RADIUS = 0.4, 0.9
"""Metres, of a disc about a group's middle that holds its clumps."""
DENSITY = 8.0, 13.0
"""Clumps to the square metre: as dream-v1's reefs."""
APART = 4.0
"""Least metres between the middles of two groups; most are farther, see `small_groups_in`."""
TRIES = 12
FEWEST_CLUMPS = 4


@dataclass(frozen=True, slots=True, eq=False)
class SmallGroups:
    """Six to fifteen small groups on the bare bed."""

    middles: Float64Array
    """(G, 2) metres."""
    radii: Float64Array
    """(G,) metres."""
    density: float
    group_radius: float = RADIUS[0]

    def relief(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """None: they lie on the bed as it is."""
        return np.zeros(np.broadcast_shapes(x.shape, y.shape))

    def kept_free(self) -> Float64Array:
        """Their discs."""
        return np.column_stack([self.middles, self.radii])

    def places(self, bottom: Bottom, most: int, rng: np.random.Generator) -> Places:
        """Clumps that are spread over each disc, the farthest on its rim."""
        x, y, group = [], [], []
        for number, ((east, north), radius) in enumerate(zip(self.middles, self.radii, strict=True)):
            count = max(round(self.density * math.pi * radius * radius), FEWEST_CLUMPS)
            # Places apart from each other, in a disc of the size that gives so many.
            wide = 1.0 + 0.16 * math.sqrt(count)
            dx, dy = places_in(Bounds(-wide, -wide, wide, wide), 0.16, rng)
            luck, far = rng.random(len(dx)), length(np.stack([dx, dy], axis=1))
            near = np.flatnonzero(far <= radius)
            near = near[np.argsort(luck[near], kind="stable")][:count]
            dx, dy = dx[near] - dx[near].mean(), dy[near] - dy[near].mean()
            grown = (radius + SLACK) / float(length(np.stack([dx, dy], axis=1)).max())
            x.append(east + grown * dx)
            y.append(north + grown * dy)
            group.append(np.full(len(near), number))
        east, north = (quantised(np.concatenate(parts), MILLIMETRE) for parts in (x, y))
        points = np.stack([east, north, bottom.seabed.height(east, north)], axis=1)
        return Places(points, bottom.normals(east, north), np.concatenate(group).astype(np.intp))


def small_groups_in(region: Bounds, fewest: int, rng: np.random.Generator) -> SmallGroups:
    """Groups in a part of an arena, each as far from the others as a few tries find.

    Args:
        region: The part.
        fewest: Clumps that they have together, at least.
        rng: Source of number, size and place.
    """
    inner = region.widened(-1.5)
    low, high = np.array([inner.x_min, inner.y_min]), np.array([inner.x_max, inner.y_max])
    while True:
        radii = quantised(uniforms(rng, *RADIUS, between(rng, *GROUPS)), MILLIMETRE)
        least = max(DENSITY[0], SPARE * fewest / float(math.pi * np.square(radii).sum()))
        if least > DENSITY[1]:
            continue
        middles = low + (high - low) * rng.random((1, 2))
        while len(middles) < len(radii):
            tries = low + (high - low) * rng.random((TRIES, 2))
            gaps = np.array([length(middles - place).min() for place in tries])
            # Ten metres are as far as any.
            best = int(np.argmax(np.minimum(gaps, 10.0)))
            if gaps[best] < APART:
                break
            middles = np.concatenate([middles, tries[best : best + 1]])
        else:
            return SmallGroups(quantised(middles, MILLIMETRE), radii, uniform(rng, least, DENSITY[1]))
