"""A camera that casts one ray through each pixel at all triangles near it: slow, obvious, and independent."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, Camera
from dream.sim.world import Instances, World

Array = npt.NDArray[Any]
BLOCK = 6  # squares of terrain along the side of one part


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles (F, 3, 3) in the world that share a label and an id."""

    triangles: Array
    label: int
    id: int
    two_sided: bool

    @functools.cached_property
    def low(self) -> Array:
        return np.asarray(self.triangles.min(axis=(0, 1)) - 1e-6)

    @functools.cached_property
    def high(self) -> Array:
        return np.asarray(self.triangles.max(axis=(0, 1)) + 1e-6)


def parts_of(world: World) -> list[Part]:
    parts = [*_placed(world, world.targets, 2), *_placed(world, world.obstacles, 3)]
    terrain = world.terrain
    rows, cols = terrain.heights.shape
    for row in range(0, rows - 1, BLOCK):
        for col in range(0, cols - 1, BLOCK):
            triangles = []
            for i in range(row, min(row + BLOCK, rows - 1)):
                for j in range(col, min(col + BLOCK, cols - 1)):

                    def corner(i: int, j: int) -> list[float]:
                        x, y = terrain.x0 + j * terrain.spacing, terrain.y0 + i * terrain.spacing
                        return [x, y, float(terrain.heights[i, j])]

                    a, b, c, d = corner(i, j), corner(i, j + 1), corner(i + 1, j + 1), corner(i + 1, j)
                    triangles += [[a, b, c], [a, c, d]]
            parts.append(Part(np.array(triangles), 1, -1, False))
    return parts


def _placed(world: World, instances: Instances, label: int) -> list[Part]:
    parts = []
    for i in range(len(instances)):
        mesh = world.meshes[instances.mesh[i]]
        w, *v = instances.wxyz[i].astype(float)
        points = mesh.vertices.astype(float) * instances.scale[i]
        # The quaternion rotates by p + 2w (v × p) + 2 v × (v × p).
        around = np.cross(v, points)
        points = points + 2.0 * w * around + 2.0 * np.cross(v, around) + instances.position[i]
        parts.append(Part(points[mesh.faces], label, i if label == 2 else -1, mesh.two_sided))
    return parts


def cast(
    parts: list[Part], camera: Camera, T_world_camera: SE3, *, near: float, far: float
) -> tuple[Array, Array, Array]:
    """Depth (H, W), NaN where no triangle lies between near and far, labels and ids."""
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    # With 1 along the optical axis, the length along a ray in these units is the depth.
    rays_camera = np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1
    )
    rays = rays_camera.reshape(-1, 3) @ T_world_camera.rotation.T
    eye = T_world_camera.translation
    axis = T_world_camera.rotation[:, 2]
    spread = float(np.linalg.norm(rays_camera[..., :2], axis=-1).max())
    depth = np.full(len(rays), np.inf)
    labels, ids = np.zeros(len(rays), int), np.full(len(rays), -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        reciprocal = 1.0 / rays
    # No ray leaves the cone about the optical axis that holds the image's corners.
    lows, highs = np.array([part.low for part in parts]), np.array([part.high for part in parts])
    middle, radius = 0.5 * (lows + highs) - eye, 0.5 * np.linalg.norm(highs - lows, axis=1)
    ahead = middle @ axis
    aside = np.linalg.norm(middle - ahead[:, None] * axis, axis=1)
    inside = (-radius <= ahead) & (ahead <= far + radius) & (aside <= radius + spread * (ahead + radius))
    for index in np.flatnonzero(inside)[np.argsort(ahead[inside])]:
        part, low, high = parts[index], lows[index], highs[index]
        with np.errstate(invalid="ignore"):
            t0, t1 = (low - eye) * reciprocal, (high - eye) * reciprocal
        enter, leave = np.fmin(t0, t1).max(axis=1), np.fmax(t0, t1).min(axis=1)
        chosen = np.flatnonzero((enter <= leave) & (leave >= near) & (enter <= np.minimum(far, depth)))
        for some in np.array_split(chosen, len(chosen) * len(part.triangles) // 100_000 + 1):
            t = _hits(part, eye, rays[some], near)
            nearer = (t < depth[some]) & (t <= far)
            depth[some[nearer]] = t[nearer]
            labels[some[nearer]], ids[some[nearer]] = part.label, part.id
    shape = (camera.height, camera.width)
    return np.where(np.isinf(depth), np.nan, depth).reshape(shape), labels.reshape(shape), ids.reshape(shape)


def _hits(part: Part, eye: Array, rays: Array, near: float) -> Array:
    """(R,) nearest hit of each ray by Möller and Trumbore (1997), inf for none."""
    a, b, c = np.moveaxis(part.triangles, 1, 0)
    edge1, edge2 = b - a, c - a
    s = eye - a
    q = np.cross(s, edge1)
    # d · (e1 × e2) and its like: the scalar triple products of the paper, for every ray and triangle.
    determinant = -rays @ np.cross(edge1, edge2).T
    facing = np.abs(determinant) > 1e-14 if part.two_sided else determinant > 1e-14
    inverse = 1.0 / np.where(facing, determinant, 1.0)
    u = (rays @ np.cross(edge2, s).T) * inverse
    v = (rays @ q.T) * inverse
    t = (edge2 * q).sum(axis=1) * inverse
    hit = facing & (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= near)
    return np.asarray(np.where(hit, t, np.inf).min(axis=1, initial=np.inf))
