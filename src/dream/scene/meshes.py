"""RunScene → its surfaces as coloured meshes, as of a step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.scene.encoding import SIDES, exposed
from dream.scene.parts import LEGEND, Float32Array, Int32Array, RunScene, SceneState, UInt8Array, Voxels

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class SceneMesh:
    """A part of a scene."""

    name: str
    positions: Float32Array
    """(V, 3) metres in the world, east, north and up."""
    faces: Int32Array
    """(F, 3) indices of vertices, none empty."""
    state: UInt8Array
    """(V,) `SceneState`."""

    @property
    def colors(self) -> UInt8Array:
        """(V, 3) sRGB."""
        return np.array([color for _, color in LEGEND.values()], np.uint8)[self.state]


def meshes(scene: RunScene, step: int) -> Iterator[SceneMesh]:
    """The parts that have a face: targets by kind, obstacles, seabed, and what the vehicle had mapped."""
    states = scene.states(step)
    targets = scene.targets
    for number, name in enumerate(scene.kinds):
        of_kind = scene.kind[targets.owner] == number if len(scene.kind) else np.zeros(0, bool)
        place = (np.cumsum(of_kind) - 1).astype(np.int32)
        faces = place[targets.faces[of_kind[targets.faces[:, 0]]]]
        if len(faces):
            yield SceneMesh(name, targets.positions[of_kind], faces, states[targets.owner[of_kind]])
    for name, surface in (("obstacles", scene.obstacles), ("seabed", scene.seabed)):
        if len(surface.faces):
            other = np.full(len(surface.positions), SceneState.OTHER, np.uint8)
            yield SceneMesh(name, surface.positions, surface.faces, other)
    if (scene.voxels.seen_at <= step).any():
        yield _boxes(scene.voxels, step)


def _boxes(voxels: Voxels, step: int) -> SceneMesh:
    positions, faces, owner = boxes(voxels, step)
    return SceneMesh("mapped", positions, faces, voxels.states(step)[owner])


def boxes(voxels: Voxels, step: int) -> tuple[Float32Array, Int32Array, IntArray]:
    """Those sides of what is mapped at a step that can be looked at: two triangles and four vertices each.

    Returns:
        positions: (V, 3) metres in the world.
        faces: (F, 3) indices of vertices.
        owner: (V,) the voxel that a vertex belongs to.
    """
    sides = np.where(voxels.seen_at <= step, exposed(voxels), 0)
    corners, owners = [], []
    for bit, side in enumerate(SIDES):
        which = np.flatnonzero((sides >> bit) & 1)
        outwards = np.array(side, np.float64)
        along = np.roll(outwards, 1)
        across = np.cross(outwards, along)
        square = np.array(
            [outwards + a * along + b * across for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        )
        corners.append(voxels.positions[which, None, :] + 0.5 * voxels.size * square)
        owners.append(np.repeat(which, 4))
    first = 4 * np.arange(sum(map(len, corners)), dtype=np.int32)[:, None, None]
    faces = (first + np.array([[0, 1, 2], [0, 2, 3]], np.int32)).reshape(-1, 3)
    positions = np.concatenate(corners).reshape(-1, 3).astype(np.float32)
    return positions, faces, np.concatenate(owners)
