"""Several structures in one world: a wreck beside another, and a reef around a wreck."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds
from dream.protocol import protocol_named
from dream.sim.boulders import CLEAR, PASSAGE
from dream.sim.reefs import renumbered
from dream.sim.sampling import MILLIMETRE, Float64Array, length, quantised, rotated
from dream.sim.terrain import APRON, grid, smoothstep
from dream.sim.world import BoolArray, Instances, Mesh, Terrain, World

BLEND = 4.0
"""Metres across the border of two arenas over which one seabed passes into the other."""
OFF_HULL = 0.6
"""Least metres over ground between a hull and the middle of a clump, so that none grows through it."""
SETTLED = 1.0, 4.0
"""Metres from a hull: nearer, the seabed is that of the wreck; farther, that of the reef around it."""


def beside(west: World, east: World, apart: float | None = None) -> World:
    """Both in one world, the second to the east of the first; half of its starts lie in either.

    Args:
        west: A world of the package, with all hull 4 m or more inside its bounds.
        east: Another, of the same protocol.
        apart: Metres that the second is moved, on the lattice; the arenas touch unless given.
    """
    east = _moved(east, west.bounds.x_max - east.bounds.x_min if apart is None else apart, 0.0)
    border = 0.5 * (west.bounds.x_max + east.bounds.x_min)
    bounds = _hold(west.bounds, east.bounds)
    x, y = grid(bounds.widened(APRON), west.terrain.spacing)
    share = smoothstep(border - 0.5 * BLEND, border + 0.5 * BLEND, x)
    return _joined(west, east, bounds, _blended(west.terrain, east.terrain, share, x, y), 2)


def around(wreck: World, reef: World) -> World:
    """The reef around the wreck: its clumps and boulders, but for those where the wreck stands.

    The middles of both arenas lie at the same place. The starts are those of the wreck.

    Args:
        wreck: A world with hull.
        reef: A world without, of the same protocol.
    """
    lattice, box = protocol_named(wreck.protocol).lattice, wreck.bounds
    middle = np.array([box.x_min + box.x_max, box.y_min + box.y_max]) * 0.5
    reef = _moved(reef, *(np.floor(middle / lattice) * lattice).tolist())
    bounds = _hold(box, reef.bounds)
    x, y = grid(bounds.widened(APRON), wreck.terrain.spacing)
    hull = _footprint(wreck)
    away = _distances(hull, np.stack(np.broadcast_arrays(x, y), axis=-1).reshape(-1, 2))
    ground = _blended(wreck.terrain, reef.terrain, smoothstep(*SETTLED, away.reshape(y.size, x.size)), x, y)
    stones = feet(wreck.meshes, wreck.obstacles)
    kept = _distances(hull, reef.targets.position[:, :2]) >= OFF_HULL
    for east, north, radius in stones:
        kept &= length(reef.targets.position[:, :2] - (east, north)) > radius
    kept &= ~np.isin(
        reef.targets.group, _remnants(reef.targets, kept, protocol_named(reef.protocol).group_radius)
    )
    clumps = reef.targets.chosen(kept)
    reef = replace(reef, targets=clumps, hull=np.zeros(len(clumps), np.bool_))
    rocks = feet(reef.meshes, reef.obstacles)
    free = _distances(hull, rocks[:, :2]) >= rocks[:, 2] + PASSAGE
    for east, north, radius in [*stones, *((start.x, start.y, CLEAR - PASSAGE) for start in wreck.starts)]:
        free &= length(rocks[:, :2] - (east, north)) >= rocks[:, 2] + radius + PASSAGE
    whole = ~np.isin(reef.obstacles.group, reef.obstacles.group[~free])
    reef = replace(reef, obstacles=reef.obstacles.chosen(whole))
    return _joined(wreck, reef, bounds, ground, len(wreck.starts))


def feet(meshes: tuple[Mesh, ...], table: Instances) -> Float64Array:
    """(R, 3) circles x, y, radius around all that stands on the ground."""
    reach = np.array([float(length(mesh.vertices).max(initial=0.0)) for mesh in meshes])
    radius = reach[table.mesh] * table.scale.max(axis=1, initial=0.0)
    return np.column_stack([table.position[:, :2], radius]).astype(np.float64)


def _remnants(targets: Instances, kept: BoolArray, least: float) -> npt.NDArray[np.int32]:
    """Groups of which so little is kept that they are no patch: less than that radius."""
    small = []
    for group in np.unique(targets.group):
        places = targets.position[kept & (targets.group == group), :2].astype(np.float64)
        if len(places) and length(places - places.mean(axis=0)).max() < least:
            small.append(group)
    return np.array(small, np.int32)


def _footprint(world: World) -> Float64Array:
    """(V, 2) the places of all corners of hull, seen from above."""
    hull = world.targets.chosen(world.hull)
    corners = [
        rotated(hull.wxyz[k], hull.scale[k] * world.meshes[mesh].vertices)[:, :2] + hull.position[k, :2]
        for k, mesh in enumerate(hull.mesh)
    ]
    return np.unique(quantised(np.concatenate(corners), MILLIMETRE), axis=0)


def _distances(places: Float64Array, points: npt.NDArray[np.floating]) -> Float64Array:
    """(N,) metres from points, (N, 2), to the nearest place, rounded so that a tree's last digit is none."""
    from scipy.spatial import cKDTree

    found, _ = cKDTree(places).query(points.astype(np.float64))
    return quantised(found, 1_000_000)


def _hold(one: Bounds, other: Bounds) -> Bounds:
    return Bounds(
        min(one.x_min, other.x_min),
        min(one.y_min, other.y_min),
        max(one.x_max, other.x_max),
        max(one.y_max, other.y_max),
    )


def _blended(
    first: Terrain, second: Terrain, share: Float64Array, x: Float64Array, y: Float64Array
) -> Terrain:
    """The share (M, N) of the second seabed, the rest of the first, at the points x (1, N) and y (M, 1)."""
    heights = (1.0 - share) * first.height(x, y) + share * second.height(x, y)
    return Terrain(
        quantised(heights, MILLIMETRE).astype(np.float32), float(x[0, 0]), float(y[0, 0]), first.spacing
    )


def _moved(world: World, x: float, y: float) -> World:
    """The world that many metres farther east and north."""

    def moved(table: Instances) -> Instances:
        position = quantised(table.position + np.array([x, y, 0.0]), MILLIMETRE)
        return replace(table, position=position.astype(np.float32))

    box, ground = world.bounds, world.terrain
    return replace(
        world,
        bounds=Bounds(box.x_min + x, box.y_min + y, box.x_max + x, box.y_max + y),
        starts=tuple(SE2(start.x + x, start.y + y, start.yaw) for start in world.starts),
        terrain=replace(ground, x0=ground.x0 + x, y0=ground.y0 + y),
        targets=moved(world.targets),
        obstacles=moved(world.obstacles),
    )


def _joined(first: World, second: World, bounds: Bounds, ground: Terrain, starts: int) -> World:
    """All of both on one seabed, with so many starts of the first, and of the second what lacks to four."""
    parts, meshes = (first, second), len(first.meshes)
    targets = [_standing(part.targets, ~part.hull, part.terrain, ground) for part in parts]
    obstacles = [_standing(part.obstacles, True, part.terrain, ground) for part in parts]
    return replace(
        first,
        name=f"{first.name}+{second.name}",
        bounds=bounds,
        starts=(*first.starts[:starts], *second.starts[: len(first.starts) - starts]),
        terrain=ground,
        meshes=first.meshes + second.meshes,
        targets=_both(targets, meshes),
        hull=np.concatenate([first.hull, second.hull]),
        obstacles=_both(obstacles, meshes),
    )


def _standing(table: Instances, which: BoolArray | bool, before: Terrain, after: Terrain) -> Instances:
    """Those of the table as high above the seabed as they were. A hull keeps its height and stays whole."""
    position = table.position.astype(np.float64)
    x, y = position[:, 0], position[:, 1]
    position[:, 2] += np.where(which, after.height(x, y) - before.height(x, y), 0.0)
    return replace(table, position=quantised(position, MILLIMETRE).astype(np.float32))


def _both(tables: list[Instances], meshes: int) -> Instances:
    """One after the other; the second's meshes and groups come after those of the first."""
    first, second = tables
    past = int(first.group.max(initial=-1)) + 1
    second = replace(
        second,
        mesh=(second.mesh + meshes).astype(np.int32),
        group=np.where(second.group < 0, -1, second.group + past).astype(np.int32),
    )
    names = [field.name for field in fields(Instances)]
    both = Instances(*(np.concatenate([getattr(first, name), getattr(second, name)]) for name in names))
    return replace(both, group=renumbered(both.group))
