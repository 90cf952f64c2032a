"""Where the missions in an arena begin."""

from __future__ import annotations

import numpy as np

from dream.geometry import SE2, Bounds
from dream.protocol import DREAM_V1
from dream.sim.sampling import Float64Array, between, index, uniforms

START_MARGIN = 4.0
"""Least metres between a start and the sides."""
HULL_CLEAR = 4.5
"""Least metres over ground between a start and a wreck."""


def starts_in(bounds: Bounds, hull: Float64Array, rng: np.random.Generator) -> tuple[SE2, ...]:
    """Four start poses on the lattice. The first lies near the middle, an edge or a corner, by seed.

    Args:
        bounds: Their middle is at the origin.
        hull: (V, 2) places that they keep `HULL_CLEAR` from.
        rng: Source of places and headings.
    """
    half = 0.5 * np.array([bounds.width, bounds.depth])
    starts: list[SE2] = []
    for _ in range(10000):
        if not starts:
            kind = index(rng, 4)
            edge = half - START_MARGIN - uniforms(rng, 0.0, 3.0, 2)
            sign = np.where(rng.random(2) < 0.5, -1.0, 1.0)
            free = uniforms(rng, -1.0, 1.0, 2)
            if kind < 2:
                x, y = 4.0 * free
            elif kind == 2:
                x, y = sign * edge
            else:
                along = index(rng, 2)
                x, y = np.where(np.arange(2) == along, free * (half - START_MARGIN), sign * edge)
        else:
            x, y = uniforms(rng, -1.0, 1.0, 2) * (half - START_MARGIN)
        heading = between(rng, 0, DREAM_V1.headings - 1) * DREAM_V1.heading_step
        # Towards the middle, so that rounding never leaves the margin.
        x, y = (np.trunc(v / DREAM_V1.lattice) * DREAM_V1.lattice + 0.0 for v in (x, y))
        pose = DREAM_V1.snap(SE2(float(x), float(y), heading))
        if len(hull) and np.square(hull - (pose.x, pose.y)).sum(axis=1).min() < HULL_CLEAR * HULL_CLEAR:
            continue
        if all(pose.distance(other) >= 8.0 for other in starts):
            starts.append(pose)
        if len(starts) == 4:
            return tuple(starts)
    raise ValueError(
        f"starts: expected free water for 4 in {bounds.width:g} x {bounds.depth:g} m, got {len(starts)}"
    )
