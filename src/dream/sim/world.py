"""What the simulator holds: seabed, targets, obstacles, bounds, starts and water, as frozen data."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds
from dream.sim.water import Water

Float32Array = npt.NDArray[np.float32]
Int32Array = npt.NDArray[np.int32]
UInt8Array = npt.NDArray[np.uint8]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A triangle mesh in its own frame."""

    vertices: Float32Array
    """(V, 3) metres."""
    faces: Int32Array
    """(F, 3) vertex indices, counter-clockwise seen from outside."""
    colors: UInt8Array
    """(V, 3) sRGB albedo."""
    two_sided: bool = False
    """Seen from both sides, as a plate is. A closed mesh is not."""


@dataclass(frozen=True, slots=True, eq=False)
class Instances:
    """N placed meshes: `p_world = position + R(wxyz) @ (scale * p_mesh)`."""

    mesh: Int32Array
    """(N,) index into `World.meshes`."""
    position: Float32Array
    """(N, 3) metres in the world."""
    wxyz: Float32Array
    """(N, 4) unit quaternions."""
    scale: Float32Array
    """(N, 3) along the mesh's own axes, all positive."""
    tint: Float32Array
    """(N, 3) factors on the mesh's colours."""
    group: Int32Array
    """(N,) the reef patch or part of the wreck that it belongs to; −1 for none."""

    def __len__(self) -> int:
        return len(self.mesh)

    def chosen(self, which: BoolArray) -> Instances:
        """Those for which `which`, (N,), is true."""
        return Instances(*(getattr(self, field.name)[which] for field in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """Seabed heights on a grid of squares, wider than the bounds so that the camera never sees its edge."""

    heights: Float32Array
    """(rows, cols) world z in metres at the grid points; row grows with y, col with x."""
    x0: float
    y0: float
    """World position of `heights[0, 0]`."""
    spacing: float

    def height(self, x: npt.ArrayLike, y: npt.ArrayLike) -> npt.NDArray[Any]:
        """World z of the seabed, float64.

        Each square is two triangles, split from its lower-left to its upper-right corner; the
        renderer, the line of sight and the contact test use the same two.
        """
        gx = np.clip(
            (np.asarray(x, np.float64) - self.x0) / self.spacing, 0, self.heights.shape[1] - 1 - 1e-9
        )
        gy = np.clip(
            (np.asarray(y, np.float64) - self.y0) / self.spacing, 0, self.heights.shape[0] - 1 - 1e-9
        )
        col, row = gx.astype(np.intp), gy.astype(np.intp)
        fx, fy = gx - col, gy - row
        z = self.heights.astype(np.float64)
        z00, z01 = z[row, col], z[row, col + 1]
        z10, z11 = z[row + 1, col], z[row + 1, col + 1]
        lower = z00 + fx * (z01 - z00) + fy * (z11 - z01)
        upper = z00 + fy * (z10 - z00) + fx * (z11 - z10)
        return np.where(fx >= fy, lower, upper)


GROUP_RADIUS = 1.5
"""Metres: what `dream-v1` promises of each group of targets."""


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Everything the simulator holds. Planners never see it."""

    name: str
    seed: int
    protocol: str
    """Name of the survey protocol it is made for."""
    bounds: Bounds
    """The operator's box. Its sides are multiples of the protocol's lattice."""
    starts: tuple[SE2, ...]
    """Start poses on the protocol's lattice, in free water; a mission takes the first unless told."""
    terrain: Terrain
    meshes: tuple[Mesh, ...]
    targets: Instances
    """The individuals: clumps of shells, or patches of a wreck's surface, each its own mesh instance."""
    hull: BoolArray
    """(N,) of each individual: is it hull, which blocks sight and motion? Clumps of shells do neither."""
    obstacles: Instances
    water: Water
    group_radius: float = GROUP_RADIUS
    """Metres: what the operator's orders promise, that no group of targets has a smaller radius. A group's is
    that of a disc about its middle that holds its individuals."""
