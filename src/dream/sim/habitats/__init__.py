"""The families of wide worlds: arenas of 30 to 100 m, in water clear to 3 to 15 m, with real relief.

Each is a recipe whose ranges are published; docs/habitats.md has them all, with their sources.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import count

import numpy as np

from dream.geometry import Bounds
from dream.sim.habitats import beds
from dream.sim.habitats.arena import Arena, NoRoomError, arena_in
from dream.sim.habitats.beds import beds_in, borders_in, holed
from dream.sim.habitats.building import world_of
from dream.sim.habitats.growth import FEWEST, Habitat
from dream.sim.habitats.mounds import ledges_in, mounds_in
from dream.sim.habitats.rocks import WALLS, RockFaces, rocks_in, walls_in
from dream.sim.habitats.small import small_groups_in
from dream.sim.habitats.wide import strokes_in
from dream.sim.sampling import index, uniform
from dream.sim.sizes import TRIES, Size, SizedBuilder
from dream.sim.world import World

Random = np.random.Generator
logger = logging.getLogger(__name__)

BETWEEN = 4.0
"""Metres between the parts of an arena that two habitats lie in."""
LEAST_CUT = 6.0
"""Metres of wall in a reef, so that walls cut it."""
SPLIT = 0.4, 0.6
"""Share of an arena's longer side that the first of two has."""


def _mound(arena: Arena, rng: Random) -> World:
    """One to five mounds of old shell, overgrown all over."""
    return world_of(arena, [mounds_in(arena, arena.bounds, rng)], rng)


def _ledge(arena: Arena, rng: Random) -> World:
    """Steps of the bed, with oysters on and along their edges."""
    return world_of(arena, [ledges_in(arena, arena.bounds, rng)], rng)


def _carpet(arena: Arena, rng: Random) -> World:
    """Single clumps strewn over large patches."""
    return world_of(arena, [_carpet_in(arena, arena.bounds, rng)], rng)


def _tiny(arena: Arena, rng: Random) -> World:
    """Small groups far apart."""
    return world_of(arena, [small_groups_in(arena.bounds, FEWEST, rng)], rng)


def _dense(arena: Arena, rng: Random) -> World:
    """A bed that covers most of the arena."""
    bed = beds_in(arena, arena.bounds, beds.DENSE, (4.0, 9.0), beds.BED, beds.HEIGHT, 1.5, rng)
    return world_of(arena, [bed], rng)


def _rocks(arena: Arena, rng: Random) -> World:
    """Oysters on rocks and, in one world of two, on a wall."""
    walls = [walls_in(arena, (1, 1), rng)] if rng.random() < 0.5 else []
    taken = walls[0].feet() if walls else np.empty((0, 3))
    stones = rocks_in(arena, taken, rng)
    first = len(stones.rocks) + sum(len(each.walls) for each in walls)
    return world_of(arena, [RockFaces(first)], rng, [stones, *walls], strewn=False)


def _holes(arena: Arena, rng: Random) -> World:
    """Large reefs with bare holes in them."""
    bed = beds_in(arena, arena.bounds, beds.LARGE, (9.0, 14.0), beds.BED, beds.HEIGHT, 1.5, rng)
    return world_of(arena, [holed(bed, arena.bounds, rng)], rng)


def _border(arena: Arena, rng: Random) -> World:
    """Reefs along the border, cut by it."""
    return world_of(arena, [borders_in(arena, rng)], rng)


def _walls(arena: Arena, rng: Random) -> World:
    """Beds that ridges of rock, or quays, cut."""
    while True:
        found = walls_in(arena, WALLS, rng)
        bed = beds_in(arena, arena.bounds, beds.CUT, (6.0, 11.0), beds.BED, beds.HEIGHT, 1.5, rng)
        x, y, _ = found.feet().T
        # The feet are circles half a metre apart.
        if 0.5 * np.count_nonzero(bed.share(x, y)) >= LEAST_CUT:
            return world_of(arena, [replace(bed, lines=found.segments(beside=0.2))], rng, [found])


def _two(arena: Arena, rng: Random) -> World:
    """A mound or a ledge in one part of the arena, a carpet or small groups in the other."""
    box = arena.bounds
    at = uniform(rng, *SPLIT)
    if box.width > box.depth:
        x = box.x_min + at * box.width
        parts = [replace(box, x_max=x - 0.5 * BETWEEN), replace(box, x_min=x + 0.5 * BETWEEN)]
        across = 0.0
    else:
        y = box.y_min + at * box.depth
        parts = [replace(box, y_max=y - 0.5 * BETWEEN), replace(box, y_min=y + 0.5 * BETWEEN)]
        across = 0.5 * math.pi
    if rng.random() < 0.5:
        parts.reverse()
    steep: Habitat
    if rng.random() < 0.5:
        steep = mounds_in(arena, parts[0], rng)
    else:
        steep = ledges_in(arena, parts[0], rng, across + math.pi * index(rng, 2))
    flat: Habitat
    if rng.random() < 0.5:
        flat = _carpet_in(arena, parts[1], rng)
    else:
        flat = small_groups_in(parts[1], FEWEST // 2, rng)
    return world_of(arena, [steep, flat], rng)


def _wide(arena: Arena, rng: Random) -> World:
    """A reef of dream-v1's shapes."""
    reef = strokes_in(arena, rng)
    near = np.concatenate([stroke.line for stroke in reef.bed.strokes])
    return world_of(arena, [reef], rng, near=near)


def _carpet_in(arena: Arena, region: Bounds, rng: Random) -> Habitat:
    return beds_in(arena, region, beds.SPARSE, (9.0, 14.0), beds.CARPET, (0.0, 0.0), 3.0, rng, bare=0.3)


def _in_some_arena(family: Callable[[Arena, Random], World], rng: Random, size: Size | None = None) -> World:
    """A world of that family in the first arena that has room for it; of a size, where one is wanted."""
    for _ in count() if size is None else range(TRIES):
        try:
            return family(arena_in(rng, size), rng)
        except NoRoomError as none:
            logger.debug("%s", none)
    raise ValueError(f"area: expected room for what grows there, got {size} m, too small for it")


HABITATS: Mapping[str, SizedBuilder] = {
    f"reef/{name}": partial(_in_some_arena, family)
    for name, family in {
        "mound": _mound,
        "ledge": _ledge,
        "carpet": _carpet,
        "tiny": _tiny,
        "dense": _dense,
        "rocks": _rocks,
        "holes": _holes,
        "border": _border,
        "walls": _walls,
        "two": _two,
        "wide": _wide,
    }.items()
}
"""What makes each of them from a random generator."""
