"""What the seabed's shading knows of a place: slope, shade of the things that stand near, growth and silt."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.sim.render.textures import SLOPE_RANGE, packed, spectral_noise
from dream.sim.world import Instances, Mesh, Terrain, World

Array = npt.NDArray[Any]

CELL = 0.1
"""Metres between map points where the terrain is not too wide for it."""
MAX_CELLS = 1200
"""Along a side."""
LEAST_OPEN = 0.38
"""Of the sky, under the densest bed."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundMap:
    """Four channels over the terrain, to be blended between points."""

    texels: Array
    """(rows, cols) int64: slope along x and y, openness to the light, share of growth."""
    x0: float
    y0: float
    """World position of `texels[0, 0]`."""
    spacing: float
    """Metres."""


def ground_map(world: World) -> GroundMap:
    """Bake the map of one world; the same world gives the same map."""
    terrain = world.terrain
    rows, cols = terrain.heights.shape
    across, along = (cols - 1) * terrain.spacing, (rows - 1) * terrain.spacing
    spacing = min(terrain.spacing, max(CELL, max(across, along) / MAX_CELLS))
    shape = math.ceil(along / spacing) + 1, math.ceil(across / spacing) + 1
    y, x = np.arange(shape[0]) * spacing, np.arange(shape[1]) * spacing
    heights = terrain.heights.astype(np.float64)
    slope_x = np.asarray(np.gradient(heights, terrain.spacing, axis=1))
    slope_y = np.asarray(np.gradient(heights, terrain.spacing, axis=0))
    openness = np.ones(shape, np.float32)
    for instances in (world.targets, world.obstacles):
        _darken(openness, spacing, terrain, world.meshes, instances)
    # Light still comes in from the side where many shades overlap.
    openness = np.maximum(openness, LEAST_OPEN)
    channels = np.stack(
        [
            0.5 + 0.5 * _resampled(slope_x, terrain.spacing, x, y) / SLOPE_RANGE,
            0.5 + 0.5 * _resampled(slope_y, terrain.spacing, x, y) / SLOPE_RANGE,
            openness,
            _growth(world.seed, shape),
        ],
        axis=-1,
    )
    return GroundMap(packed(channels), terrain.x0, terrain.y0, spacing)


def _resampled(grid: Array, spacing: float, x: Array, y: Array) -> Array:
    """Bilinear values of a grid at the crossings of x and y, measured from its first point."""
    column, row = np.minimum(x / spacing, grid.shape[1] - 1), np.minimum(y / spacing, grid.shape[0] - 1)
    c, r = np.minimum(column.astype(int), grid.shape[1] - 2), np.minimum(row.astype(int), grid.shape[0] - 2)
    s = column - c
    lines = grid[:, c] * (1.0 - s) + grid[:, c + 1] * s
    t = (row - r)[:, None]
    values: Array = lines[r] * (1.0 - t) + lines[r + 1] * t
    return values


def _growth(seed: int, shape: tuple[int, int]) -> Array:
    """Patches of algae and darker silt, metres to tens of metres across, in [0, 1]."""
    rng = np.random.default_rng(seed)
    size = 512
    noise = spectral_noise(size, 1.25, 1, 150, rng)
    # The tile spans the map, so that it never repeats within a world.
    row = np.minimum((np.arange(shape[0]) * size / max(shape)).astype(int), size - 1)
    column = np.minimum((np.arange(shape[1]) * size / max(shape)).astype(int), size - 1)
    share: Array = np.clip(0.42 + 0.38 * noise[row[:, None], column[None, :]], 0.0, 1.0)
    return share


def _darken(
    openness: Array, spacing: float, terrain: Terrain, meshes: tuple[Mesh, ...], instances: Instances
) -> None:
    """Multiply in the part of the sky that each instance hides from the ground about it.

    Each stands for a ball as wide as its mesh: under and beside it the ground loses the share that a
    ball of that size would cover, and nothing farther than three radii.
    """
    extent = np.array([0.5 * np.ptp(m.vertices, axis=0) for m in meshes]).reshape(-1, 3)[instances.mesh]
    middle = (
        np.array([m.vertices.mean(axis=0) for m in meshes]).reshape(-1, 3)[instances.mesh] * instances.scale
    )
    half = extent * instances.scale
    position = instances.position + middle
    radius = np.sqrt(half[:, 0] * half[:, 1] + 1e-6)
    reach = np.maximum(1.35 * radius, 1.5 * spacing)
    above = np.maximum(position[:, 2] - half[:, 2] - terrain.height(position[:, 0], position[:, 1]), 0.0)
    # What lies flat hides little of the sky.
    strength = 0.62 * np.minimum(half[:, 2] / radius, 1.0) * np.exp(-above / (1.2 * radius + 0.05))
    rows, cols = openness.shape
    for (x, y, _), r, s in zip(position, reach, strength, strict=True):
        if s < 0.02:
            continue
        c0, c1 = int((x - 1.6 * r - terrain.x0) / spacing), int((x + 1.6 * r - terrain.x0) / spacing) + 2
        r0, r1 = int((y - 1.6 * r - terrain.y0) / spacing), int((y + 1.6 * r - terrain.y0) / spacing) + 2
        c0, r0, c1, r1 = max(c0, 0), max(r0, 0), min(c1, cols), min(r1, rows)
        if c0 >= c1 or r0 >= r1:
            continue
        dx = (terrain.x0 + np.arange(c0, c1) * spacing - x) / r
        dy = (terrain.y0 + np.arange(r0, r1) * spacing - y) / r
        near = dx[None, :] ** 2 + dy[:, None] ** 2
        openness[r0:r1, c0:c1] *= 1.0 - s * np.exp(-1.4 * near * near)
