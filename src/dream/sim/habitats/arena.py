"""What every wide world begins with: an arena, its water, and four starts that know nothing of the reef."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dream.geometry import SE2, Bounds
from dream.protocol import DREAM_V2
from dream.sim.sampling import power, quantised
from dream.sim.sizes import Size
from dream.sim.starts import starts_in
from dream.sim.water import Water, water_of

SIDES = 30.0, 100.0
"""Metres: the least and the greatest side of an arena."""
VISIBILITY = 3.0, 15.0
"""Metres at which a Secchi disc vanishes, least and greatest: from water in which a survey by camera is only
just worth while, to the clearest that `dream.sim.water` has but for a tank. Our choice."""
USUAL_STEPS = 300
"""Steps that a mission may take in the usual arena, ..."""
USUAL_AREA = 45.0 * 45.0
"""... of so many square metres, ..."""
USUAL_RANGE = 7.0
"""... where labels are told for so many metres or more: from there on, the reach of a look counts."""
MOST_STEPS = 1200.0
"""A BlueROV2 dives for some two hours on its battery, and a step takes it four to six seconds. What would
need more steps than that, no operator orders as one mission."""


class NoRoomError(ValueError):
    """An arena, or where its starts lie, has no room for what a recipe asks for: draw another."""


@dataclass(frozen=True, slots=True)
class Arena:
    """Where a mission flies, before anything grows there."""

    bounds: Bounds
    """Its middle at the origin, its sides even numbers of metres."""
    starts: tuple[SE2, ...]
    water: Water


def steps_for(bounds: Bounds, water: Water) -> float:
    """Steps to survey an arena: in proportion to its area, and to how short labels are told."""
    assert DREAM_V2.space is not None
    told = DREAM_V2.space.label_lengths * water.attenuation_length
    return USUAL_STEPS * bounds.area / USUAL_AREA * USUAL_RANGE / min(USUAL_RANGE, told)


def arena_in(rng: np.random.Generator, size: Size | None = None) -> Arena:
    """Sides and visibility evenly on a scale of logarithms, drawn again until `MOST_STEPS` suffice.

    Where a size is wanted, only what it leaves open is drawn, and however many steps that needs.
    """
    if size is not None:
        water = size.water or water_of(float(quantised(log_uniform(rng, *VISIBILITY), 10)))
        return Arena(size.bounds, starts_in(size.bounds, np.empty((0, 2)), rng), water)
    while True:
        east, north = (log_uniform(rng, *SIDES) for _ in range(2))
        half = np.clip(np.rint(0.5 * np.array([east, north])), 0.5 * SIDES[0], 0.5 * SIDES[1])
        bounds = Bounds(-float(half[0]), -float(half[1]), float(half[0]), float(half[1]))
        water = water_of(float(quantised(log_uniform(rng, *VISIBILITY), 10)))
        if half[0] != half[1] and steps_for(bounds, water) <= MOST_STEPS:
            return Arena(bounds, starts_in(bounds, np.empty((0, 2)), rng), water)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between two, even on a scale of logarithms."""
    return low * float(power(high / low, float(rng.random())))
