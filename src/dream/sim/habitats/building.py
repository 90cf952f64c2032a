"""From an arena and its habitats to a world."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from dream.protocol import DREAM_V2
from dream.sim import boulders
from dream.sim.habitats.arena import USUAL_AREA, Arena
from dream.sim.habitats.growth import MOST, Bottom, Habitat, clumps, joined
from dream.sim.sampling import Float64Array
from dream.sim.terrain import APRON, SPACING, grid, terrain, undulation
from dream.sim.world import Instances, Mesh, Terrain, World

FLOOR = -10.0
"""World z of the nominal seabed."""


@dataclass(frozen=True, slots=True, eq=False)
class Stands:
    """Solid things on a seabed."""

    meshes: tuple[Mesh, ...]
    table: Instances
    """Of these meshes, counted from 0."""


class StandingStructure(Protocol):
    """What stands on the seabed of an arena beside the usual boulders: rocks, a ridge, a quay."""

    def feet(self) -> Float64Array:
        """(T, 3) circles x, y, radius that it covers."""

    def on(self, seabed: Terrain, rng: np.random.Generator) -> Stands:
        """It, on that seabed."""


def world_of(
    arena: Arena,
    habitats: Sequence[Habitat],
    rng: np.random.Generator,
    structures: Sequence[StandingStructure] = (),
    near: Float64Array | None = None,
    *,
    strewn: bool = True,
) -> World:
    """The world of an arena: its bed, what stands on it, and clumps of oysters.

    Args:
        arena: Where.
        habitats: What oysters grow on. Of several, each has its share of `MOST` clumps.
        rng: Source of all else.
        structures: What stands there. A habitat finds it in the `Bottom`, before the boulders.
        near: (K, 2) places that attract boulders; none unless given.
        strewn: With boulders, as many to the square metre as in the arenas of dream-v1.
    """
    wide = arena.bounds.widened(APRON)
    x, y = grid(wide, SPACING)
    heights = FLOOR + undulation(wide, rng)
    for habitat in habitats:
        heights = heights + habitat.relief(x, y)
    seabed = terrain(heights, wide)

    meshes: tuple[Mesh, ...] = ()
    tables: list[Instances] = []
    covered = [np.empty((0, 3)), *(structure.feet() for structure in structures)]
    for structure in structures:
        stands = structure.on(seabed, rng)
        tables.append(_shifted(stands.table, len(meshes), sum(map(len, tables))))
        meshes += stands.meshes
    bare = np.concatenate(covered)
    if strewn:
        taken = np.concatenate([bare, *(habitat.kept_free() for habitat in habitats)])
        fewest, most = (max(round(k * arena.bounds.area / USUAL_AREA), 4) for k in boulders.NUMBER)
        rocks = boulders.formations(
            arena.bounds,
            arena.starts,
            np.empty((0, 2)) if near is None else near,
            taken,
            rng,
            ring=rng.random() < 0.25,
            number=(fewest, most),
        )
        stones = boulders.variants(rng)
        placed = boulders.placed(rocks, stones, 0, seabed, rng)
        tables.append(_shifted(placed, len(meshes), sum(map(len, tables))))
        meshes += stones
        bare = np.concatenate([bare, boulders.feet(rocks)])
    bottom = Bottom(arena.bounds, seabed, meshes, together(tables), bare)
    grown = joined([habitat.places(bottom, MOST // len(habitats), rng) for habitat in habitats])
    shells, targets = clumps(grown, rng)
    return World(
        name="reef",
        seed=0,
        protocol=DREAM_V2.name,
        bounds=arena.bounds,
        starts=arena.starts,
        terrain=seabed,
        meshes=meshes + shells,
        targets=_shifted(targets, len(meshes), 0),
        hull=np.zeros(len(targets), np.bool_),
        obstacles=bottom.obstacles,
        water=arena.water,
        group_radius=min(habitat.group_radius for habitat in habitats),
    )


def clear_of(arena: Arena, x: float, y: float, radius: float) -> bool:
    """Does a circle leave the water about all starts free, as boulders do?"""
    return all(math.hypot(x - start.x, y - start.y) >= radius + boulders.CLEAR for start in arena.starts)


def together(tables: Sequence[Instances]) -> Instances:
    """One after the other."""
    if not tables:
        number, three = np.empty(0, np.int32), np.empty((0, 3), np.float32)
        return Instances(number, three, np.empty((0, 4), np.float32), three, three, number)
    return Instances(
        *(np.concatenate([getattr(table, field.name) for table in tables]) for field in fields(Instances))
    )


def _shifted(table: Instances, meshes: int, groups: int) -> Instances:
    """With so many meshes and groups before its own."""
    return Instances(
        table.mesh + np.int32(meshes),
        table.position,
        table.wxyz,
        table.scale,
        table.tint,
        np.where(table.group < 0, table.group, table.group + groups).astype(np.int32),
    )
