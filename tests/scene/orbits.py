"""A scene to look at: a wreck of the simulator, and a vehicle on rings around it that nobody flew.

What it saw is by distance and angle alone, whatever stands in between: good enough for a picture.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from dream.scene import HeightGrid, Path, RunScene, Targets, Voxels, made, mapped
from dream.sim.solids import corners
from dream.sim.world import Instances, World
from dream.sim.worlds import make_world

Float64Array = npt.NDArray[np.float64]

REACH = 8.0
TILT = math.radians(20.0)
FIELD = (math.radians(80.0), math.radians(64.0))
VOXEL = 0.25


def orbited(name: str = "wreck/1", seed: int = 1004, steps: int = 60) -> RunScene:
    """A scene with every part."""
    world = make_world(name, seed)
    triangles, owner = soup(world, world.targets)
    path = rings(triangles, steps)
    seen_at, inspected_at = looks(triangles, owner, len(world.targets), path)
    bounds = world.bounds
    heights = world.terrain.heights
    return made(
        title=f"{name} seed {seed}",
        bounds=[[bounds.x_min, bounds.y_min, heights.min()], [bounds.x_max, bounds.y_max, 0.0]],
        water=0.0,
        field_of_view=FIELD,
        targets=Targets(
            triangles,
            owner,
            ("hull",) if world.hull.all() else ("oysters",),
            np.zeros(len(world.targets), np.uint8),
            seen_at,
            inspected_at,
        ),
        obstacles=soup(world, world.obstacles)[0],
        seabed=HeightGrid(heights, world.terrain.x0, world.terrain.y0, world.terrain.spacing),
        voxels=solid(world, triangles, owner, seen_at, inspected_at, path),
        path=path,
    )


def soup(world: World, instances: Instances) -> tuple[Float64Array, npt.NDArray[np.intp]]:
    """(T, 3, 3) triangles of all instances, and whose each is."""
    parts, owners = [np.empty((0, 3, 3))], [np.empty(0, np.intp)]
    for mesh in np.unique(instances.mesh):
        which = np.flatnonzero(instances.mesh == mesh)
        placed = corners(world.meshes[mesh], instances, which)
        parts.append(placed.reshape(-1, 3, 3))
        owners.append(np.repeat(which, placed.shape[1]))
    return np.concatenate(parts), np.concatenate(owners)


def rings(triangles: Float64Array, steps: int) -> Path:
    """Three rings, each higher than the one before; the vehicle looks inwards."""
    low, high = triangles.reshape(-1, 3).min(axis=0), triangles.reshape(-1, 3).max(axis=0)
    plan = triangles.reshape(-1, 3)[:, :2] - 0.5 * (low + high)[:2]
    _, axes = np.linalg.eigh(np.cov(plan.T))
    half = np.quantile(np.abs(plan @ axes), 0.98, axis=0) + 2.5
    at = np.arange(steps)
    angle = 2.0 * np.pi * 3.0 * at / max(1, steps - 1)
    ring = np.minimum(2, 3 * at // max(1, steps - 1))
    # A superellipse, which follows the sides.
    round_off = np.column_stack(
        [np.sign(part) * np.abs(part) ** 0.5 for part in (np.cos(angle), np.sin(angle))]
    )
    middle = 0.5 * (low + high)
    x, y = (round_off * half @ axes.T + middle[:2]).T
    z = low[2] + 1.5 + 1.7 * ring
    inwards = -(round_off**3 / half @ axes.T)
    return Path(
        step=at.astype(np.int32),
        positions=np.column_stack([x, y, z]).astype(np.float32),
        yaw=np.arctan2(inwards[:, 1], inwards[:, 0]).astype(np.float32),
        tilt=np.where(ring == 2, math.radians(45.0), TILT).astype(np.float32),
        collided=at == steps // 3,
    )


def looks(
    triangles: Float64Array, owner: npt.NDArray[np.intp], count: int, path: Path
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """(N,) steps at which each individual is first within reach and in the picture, and at 70° or less."""
    normals: Float64Array = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(normals, axis=1)
    weights = np.maximum(np.bincount(owner, area, count), 1e-12)
    middles = triangles.mean(axis=1) * area[:, None]
    centre = np.column_stack([np.bincount(owner, column, count) for column in middles.T]) / weights[:, None]
    facing = np.column_stack([np.bincount(owner, column, count) for column in normals.T])
    facing = facing / np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-12)
    seen, inspected = np.full(count, -1), np.full(count, -1)
    for step in range(len(path.step)):
        towards = path.positions[step] - centre
        distance = np.linalg.norm(towards, axis=1)
        bearing = np.arctan2(-towards[:, 1], -towards[:, 0]) - path.yaw[step]
        aside = np.abs((bearing + np.pi) % (2.0 * np.pi) - np.pi)
        slant = (towards * facing).sum(axis=1) / np.maximum(distance, 1e-9)
        shown = (distance < REACH) & (aside < 0.5 * FIELD[0]) & (slant > 0.0)
        seen[shown & (seen < 0)] = step
        inspected[shown & (slant > math.cos(math.radians(70.0))) & (inspected < 0)] = step
    return seen, inspected


def solid(
    world: World,
    triangles: Float64Array,
    owner: npt.NDArray[np.intp],
    seen_at: npt.NDArray[np.intp],
    inspected_at: npt.NDArray[np.intp],
    path: Path,
) -> Voxels:
    """Voxels at the triangles of what was seen, and at the seabed below the way."""
    seen = seen_at[owner] >= 0
    rng = np.random.default_rng(0)
    shares = rng.dirichlet((1.0, 1.0, 1.0), (seen.sum(), 6))
    hull = np.einsum("tkc,tcx->tkx", shares, triangles[seen]).reshape(-1, 3)
    whose = np.repeat(owner[seen], 6)
    cells, first = np.unique(np.floor(hull / VOXEL).astype(int), axis=0, return_index=True)
    whose = whose[first]
    bounds = world.bounds
    x, y = (
        part.ravel()
        for part in np.meshgrid(
            *(
                np.arange(low, high, VOXEL) + VOXEL / 2
                for low, high in ((bounds.x_min, bounds.x_max), (bounds.y_min, bounds.y_max))
            )
        )
    )
    far = np.linalg.norm(np.column_stack([x, y])[:, None] - path.positions[None, :, :2], axis=2)
    near = far.min(axis=1) < 5.0
    ground = np.column_stack([x, y, world.terrain.height(x, y)])[near]
    floor, kept = np.unique(np.floor(ground / VOXEL).astype(int), axis=0, return_index=True)
    taken = set(map(tuple, cells.tolist()))
    alone = np.array([tuple(cell) not in taken for cell in floor.tolist()])
    floor, kept = floor[alone], kept[alone]
    return mapped(
        VOXEL,
        (np.concatenate([cells, floor]) + 0.5) * VOXEL,
        np.concatenate([np.ones(len(cells), bool), np.zeros(len(floor), bool)]),
        np.concatenate([seen_at[whose], (far < 5.0).argmax(axis=1)[near][kept]]),
        np.concatenate([inspected_at[whose], np.full(len(floor), -1)]),
    )
