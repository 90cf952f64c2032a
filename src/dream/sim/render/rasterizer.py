"""The camera of the simulator: colour, depth, labels and ids of one view, from one visibility buffer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from dream.geometry import SE3, Camera
from dream.sim.render import textures
from dream.sim.render.scene import build_scene
from dream.sim.render.shading import FLAKE, SUN, TILES, WATER_STEP, Shading, encode_table, flakes, shading
from dream.sim.world import Float32Array, Int32Array, UInt8Array, World

NEAR = 0.05
"""Metres along the optical axis; triangles are clipped there."""
FAR = 20.0
"""Metres along the optical axis; what lies beyond is water."""


class Measurement(NamedTuple):
    """What a view measures, without its colours."""

    depth: Float32Array
    """(H, W) metres along the optical axis; NaN where there is only water."""
    labels: UInt8Array
    """(H, W) values of `Label`."""
    ids: Int32Array
    """(H, W) index into `World.targets`, −1 elsewhere."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One view."""

    rgb: UInt8Array
    """(H, W, 3) sRGB."""
    depth: Float32Array
    """(H, W) metres along the optical axis; NaN where there is only water."""
    labels: UInt8Array
    """(H, W) values of `Label`."""
    ids: Int32Array
    """(H, W) index into `World.targets`, −1 elsewhere."""


class Renderer:
    """Draws one world from any number of poses. Prepared once; drawing changes nothing that it shows."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._scene = build_scene(world)
        self._encode = encode_table()
        # A flake scatters daylight back: the colour of the water itself, but brighter.
        self._snow = (
            self._encode[np.minimum(4095 * (0.12 + 1.6 * np.array(world.water.veil)), 4095).astype(int)] * 1.0
        )

    @cached_property
    def _shading(self) -> Shading:
        """Half of the preparation, and for colours only."""
        return shading(self._world, self._scene.entity_offset, FAR)

    def measure(self, camera: Camera, T_world_camera: SE3) -> Measurement:
        """Depth, labels and ids, without the cost of colour."""
        return self._visible(camera, T_world_camera)[0]

    def render(self, camera: Camera, T_world_camera: SE3) -> Frame:
        """Colour, depth, labels and ids of one view; the same bits each time it is asked."""
        from dream.sim.render import _kernels

        measured, triangle = self._visible(camera, T_world_camera)
        scene, shading = self._scene, self._shading
        sand, stone, caustics = textures.sand(), textures.stone(), textures.caustics()
        focal = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        rgb = np.empty((camera.height, camera.width, 3), np.uint8)
        _kernels.shade(
            triangle,
            measured.depth,
            np.ascontiguousarray(T_world_camera.rotation),
            T_world_camera.translation,
            focal,
            scene.clusters,
            scene.face_shade,
            scene.entity_cluster,
            scene.entity_inverse,
            scene.entity_offset,
            scene.entity_two_sided,
            scene.entity_material,
            scene.entity_tint,
            shading.foot,
            shading.ground.texels,
            np.array([shading.ground.x0, shading.ground.y0, 1.0 / shading.ground.spacing]),
            sand.texels,
            sand.starts,
            stone.texels,
            stone.starts,
            caustics.texels,
            caustics.starts,
            TILES,
            shading.light,
            shading.light_frame,
            SUN,
            shading.water,
            WATER_STEP,
            shading.veil,
            shading.seabed,
            self._encode,
            rgb,
        )
        drifting = flakes(self._world.water, T_world_camera.translation) @ T_world_camera.rotation
        _kernels.snow(measured.depth, focal, drifting, FLAKE, self._snow, rgb)
        return Frame(rgb, *measured)

    def _visible(self, camera: Camera, T_world_camera: SE3) -> tuple[Measurement, Int32Array]:
        """The measurement, and which triangle each pixel shows."""
        from dream.sim.render import _kernels

        _check(camera, T_world_camera)
        shape = (camera.height, camera.width)
        scene = self._scene
        inverse_depth = np.zeros(shape, np.float32)
        triangle = np.empty(shape, np.int32)
        _kernels.rasterize(
            np.ascontiguousarray(T_world_camera.rotation.T),
            T_world_camera.translation,
            np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
            NEAR,
            FAR,
            scene.vertices,
            scene.faces,
            scene.clusters,
            scene.entity_cluster,
            scene.entity_matrix,
            scene.entity_offset,
            scene.entity_sphere,
            scene.entity_two_sided,
            inverse_depth,
            triangle,
        )
        measured = Measurement(
            np.empty(shape, np.float32), np.empty(shape, np.uint8), np.empty(shape, np.int32)
        )
        _kernels.resolve(
            inverse_depth,
            triangle,
            FAR,
            scene.clusters,
            scene.entity_cluster,
            scene.entity_label,
            scene.entity_id,
            scene.face_id,
            *measured,
        )
        return measured, triangle


def _check(camera: Camera, T_world_camera: SE3) -> None:
    if not isinstance(camera, Camera):
        raise ValueError(f"camera: expected a Camera, got {type(camera).__name__}")
    if not isinstance(T_world_camera, SE3):
        raise ValueError(f"T_world_camera: expected an SE3, got {type(T_world_camera).__name__}")
    if camera.width < 1 or camera.height < 1 or not (camera.fx > 0.0 and camera.fy > 0.0):
        raise ValueError(
            f"camera: expected at least one pixel and positive focal lengths, "
            f"got {camera.width} x {camera.height} with fx={camera.fx}, fy={camera.fy}"
        )
    if np.abs(T_world_camera.rotation @ T_world_camera.rotation.T - np.eye(3)).max() > 1e-3:
        raise ValueError("T_world_camera: expected a rotation (R Rᵀ = I), got a matrix that scales or shears")
