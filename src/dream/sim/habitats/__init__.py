"""The families of wide worlds: arenas of 30 to 100 m, in water clear to 3 to 15 m, with real relief.

Each is a recipe whose ranges are published; docs/habitats.md has them all, with their sources.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from dream.sim.habitats.arena import arena_in
from dream.sim.habitats.building import world_of
from dream.sim.habitats.mounds import ledges_in, mounds_in
from dream.sim.world import World


def _mound(rng: np.random.Generator) -> World:
    arena = arena_in(rng)
    return world_of(arena, [mounds_in(arena, arena.bounds, rng)], rng)


def _ledge(rng: np.random.Generator) -> World:
    arena = arena_in(rng)
    return world_of(arena, [ledges_in(arena, arena.bounds, rng)], rng)


HABITATS: Mapping[str, Callable[[np.random.Generator], World]] = {
    "reef/mound": _mound,
    "reef/ledge": _ledge,
}
"""What makes each of them from a random generator."""
