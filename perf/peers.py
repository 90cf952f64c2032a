"""Other renderers on the same triangles: each gives depth and labels, and colours where asked.

What a peer does not do by itself is done for it in NumPy, with less than our own shading does: one albedo a
triangle, Lambert's law, and the water's formula; no texture, caustics or smooth normals.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, Camera
from dream.sim.world import Instances, World

Array = npt.NDArray[Any]
FAR = 20.0


@dataclass(frozen=True)
class Soup:
    """All triangles of a world."""

    corners: Array
    """(T, 3, 3) float32."""
    normals: Array
    """(T, 3)."""
    colors: Array
    """(T, 3) linear albedo."""
    labels: Array
    """(T,) uint8."""
    ids: Array
    """(T,) int32."""


@dataclass(frozen=True)
class Peer:
    """A renderer by name, and how it measures and draws; None where it cannot."""

    name: str
    measure: Callable[[Camera, SE3], object]
    draw: Callable[[Camera, SE3], object]
    does: str


def soup_of(world: World) -> Soup:
    """Everything in world coordinates."""
    corners, colors, labels, ids = [], [], [], []

    def add(instances: Instances, label: int) -> None:
        for i in range(len(instances)):
            mesh = world.meshes[instances.mesh[i]]
            w, x, y, z = instances.wxyz[i].astype(float)
            turn = np.array(
                [
                    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
                ]
            )
            points = (mesh.vertices * instances.scale[i]) @ turn.T + instances.position[i]
            corners.append(points[mesh.faces])
            colors.append((mesh.colors[mesh.faces].mean(axis=1) / 255.0) ** 2.2 * instances.tint[i])
            labels.append(np.full(len(mesh.faces), label, np.uint8))
            ids.append(np.full(len(mesh.faces), i if label == 2 else -1, np.int32))

    add(world.targets, 2)
    add(world.obstacles, 3)
    terrain = world.terrain
    rows, cols = terrain.heights.shape
    x, y = np.meshgrid(
        terrain.x0 + terrain.spacing * np.arange(cols), terrain.y0 + terrain.spacing * np.arange(rows)
    )
    grid = np.stack([x, y, terrain.heights], axis=-1)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    ground = np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)], axis=2).reshape(-1, 3, 3)
    corners.append(ground)
    colors.append(np.full((len(ground), 3), (0.44, 0.37, 0.27)))
    labels.append(np.ones(len(ground), np.uint8))
    ids.append(np.full(len(ground), -1, np.int32))
    every = np.concatenate(corners).astype(np.float32)
    cross = np.cross(every[:, 1] - every[:, 0], every[:, 2] - every[:, 0])
    normals = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-20)
    return Soup(
        every,
        normals.astype(np.float32),
        np.concatenate(colors).astype(np.float32),
        np.concatenate(labels),
        np.concatenate(ids),
    )


class _Rays:
    """Rays of a camera with 1 along the optical axis, so that a hit's distance is its depth."""

    def __init__(self, camera: Camera) -> None:
        u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
        self.camera = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3).astype(np.float32)
        self.stretch = np.linalg.norm(self.camera, axis=1)

    def world(self, pose: SE3) -> tuple[Array, Array]:
        rays = self.camera @ pose.rotation.T.astype(np.float32)
        return np.broadcast_to(pose.translation.astype(np.float32), rays.shape), rays


def _shaded(world: World, soup: Soup, triangle: Array, depth: Array, stretch: Array) -> Array:
    """(P, 3) uint8 of the hit triangles, −1 for none."""
    water = world.water
    veil = np.array(water.veil, np.float32)
    hit = triangle >= 0
    sun = np.array([0.3, 0.22, 0.93], np.float32)
    facing = np.abs(soup.normals[triangle[hit]] @ sun)
    direct = soup.colors[triangle[hit]] * (0.45 + 0.55 * facing)[:, None]
    r = (depth[hit] * stretch[hit]).astype(np.float32)[:, None]
    image = np.empty((len(triangle), 3), np.float32)
    image[~hit] = veil
    image[hit] = direct * np.exp(-r * np.array(water.attenuation, np.float32))
    image[hit] += veil * (1.0 - np.exp(-r * np.array(water.backscatter, np.float32)))
    return (255.0 * np.sqrt(np.minimum(image, 1.0))).astype(np.uint8)


def _by_rays(
    name: str, world: World, soup: Soup, cast: Callable[[Array, Array], tuple[Array, Array]]
) -> Peer:
    """A peer that only casts rays: `cast(origins, directions) -> (triangle or −1, distance)`."""
    rays: dict[Camera, _Rays] = {}

    def hits(camera: Camera, pose: SE3) -> tuple[Array, Array, Array]:
        of_camera = rays.setdefault(camera, _Rays(camera))
        triangle, depth = cast(*of_camera.world(pose))
        triangle = np.where(depth <= FAR, triangle, -1)
        return triangle, np.where(triangle >= 0, depth, np.nan), of_camera.stretch

    def measure(camera: Camera, pose: SE3) -> object:
        triangle, depth, _ = hits(camera, pose)
        return (
            depth,
            np.where(triangle >= 0, soup.labels[triangle], 0),
            np.where(triangle >= 0, soup.ids[triangle], -1),
        )

    def draw(camera: Camera, pose: SE3) -> object:
        triangle, depth, stretch = hits(camera, pose)
        labels = np.where(triangle >= 0, soup.labels[triangle], 0)
        ids = np.where(triangle >= 0, soup.ids[triangle], -1)
        return _shaded(world, soup, triangle, depth, stretch), depth, labels, ids

    return Peer(name, measure, draw, "rays on one merged mesh; Lambert and water in NumPy")


def embree(world: World, soup: Soup) -> Peer:
    """Embree through embreex."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    scene = rtcore_scene.EmbreeScene()
    mesh = TriangleMesh(scene, soup.corners)  # the scene holds no reference to it

    def cast(origins: Array, directions: Array) -> tuple[Array, Array]:
        assert mesh is not None
        found = scene.run(np.ascontiguousarray(origins), directions, output=1)
        return found["primID"], found["tfar"]

    return _by_rays("embreex", world, soup, cast)


def open3d(world: World, soup: Soup) -> Peer:
    """Embree through Open3D's RaycastingScene."""
    import open3d

    vertices = soup.corners.reshape(-1, 3)
    triangles = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(open3d.core.Tensor(vertices), open3d.core.Tensor(triangles))

    def cast(origins: Array, directions: Array) -> tuple[Array, Array]:
        rays = np.concatenate([origins, directions], axis=1)
        found = scene.cast_rays(open3d.core.Tensor(rays), nthreads=1)
        triangle = found["primitive_ids"].numpy().astype(np.int64)
        return np.where(triangle == scene.INVALID_ID, -1, triangle), found["t_hit"].numpy()

    return _by_rays("Open3D RaycastingScene", world, soup, cast)


def mujoco(world: World, soup: Soup) -> Peer:
    """MuJoCo's own OpenGL renderer: one mesh for each label, its own light, no water, labels but no ids."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    import mujoco as mj

    spec = mj.MjSpec()
    for label, color in ((1, (0.7, 0.62, 0.5)), (2, (0.6, 0.55, 0.48)), (3, (0.4, 0.38, 0.35))):
        corners = soup.corners[soup.labels == label]
        # MuJoCo limits the vertices of a mesh, so that a large one is cut.
        for part, chunk in enumerate(np.array_split(corners, len(corners) // 60_000 + 1)):
            if not len(chunk):
                continue
            name = f"mesh{label}_{part}"
            mesh = spec.add_mesh(name=name, inertia=mj.mjtMeshInertia.mjMESH_INERTIA_SHELL)
            points, index = np.unique(chunk.reshape(-1, 3), axis=0, return_inverse=True)
            mesh.uservert, mesh.userface = points.ravel().tolist(), index.ravel().astype(np.int32).tolist()
            spec.worldbody.add_geom(
                type=mj.mjtGeom.mjGEOM_MESH,
                meshname=name,
                rgba=(*color, 1.0),
                contype=0,
                conaffinity=0,
                group=label,
            )
    spec.worldbody.add_camera(name="eye", fovy=60.0)
    spec.worldbody.add_light(pos=(0, 0, 10), dir=(0, 0, -1), type=mj.mjtLightType.mjLIGHT_DIRECTIONAL)
    spec.visual.map.znear, spec.visual.map.zfar = 0.001, 1.0
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1920, 1080
    model = spec.compile()
    data = mj.MjData(model)
    mj.mj_forward(model, data)
    renderers: dict[tuple[int, int], Any] = {}

    def passes(camera: Camera, pose: SE3, *, colour: bool) -> object:
        size = (camera.height, camera.width)
        if size not in renderers:
            renderers[size] = mj.Renderer(model, *size)
        renderer = renderers[size]
        model.cam_fovy[0] = math.degrees(2.0 * math.atan(0.5 * camera.height / camera.fy))
        # An OpenGL camera looks along −z with y up.
        data.cam_xpos[0], data.cam_xmat[0] = pose.translation, (pose.rotation * (1.0, -1.0, -1.0)).ravel()
        renderer.update_scene(data, camera=0)
        images = []
        if colour:
            images.append(renderer.render())
        renderer.enable_depth_rendering()
        images.append(renderer.render())
        renderer.disable_depth_rendering()
        renderer.enable_segmentation_rendering()
        images.append(renderer.render())
        renderer.disable_segmentation_rendering()
        return images

    return Peer(
        "MuJoCo",
        lambda camera, pose: passes(camera, pose, colour=False),
        lambda camera, pose: passes(camera, pose, colour=True),
        "its own OpenGL passes and light; no water, labels without ids",
    )


PEERS = {"embreex": embree, "Open3D RaycastingScene": open3d, "MuJoCo": mujoco}
