"""Observations → a fine picture of the ground: its height, and how sure each spot is target."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.geometry import Bounds, Camera
from dream.perception.scatter import SCATTERS
from dream.protocol import SurveyProtocol
from dream.types import Float32Array, Observation, UInt8Array

Float64Array = npt.NDArray[np.float64]

CELL = 0.025
"""Metres: an eighth of a clump of shells, and a pixel at the distance of a near view."""
MOST_CELLS = 1 << 23
"""Of larger areas the cells grow."""
MOST_PIXELS = 1 << 17
"""Of larger images every n-th row and column is taken."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """What measuring needs of an observation: everything but its colour."""

    depth: Float32Array
    """(H, W) metres along the optical axis; NaN where there is no return, or one outside the limits."""
    labels: UInt8Array
    """(H, W) values of `Label`."""
    lens: Float64Array
    """fx, fy, cx, cy."""
    rotation: Float64Array
    """(3, 3) camera to world."""
    origin: Float64Array
    """(3,) of the camera in the world."""

    @staticmethod
    def of(seen: Observation) -> Frame:
        """Of one observation, with every n-th pixel of a large one."""
        n = max(1, math.ceil(math.sqrt(seen.depth.size / MOST_PIXELS)))
        camera, half = seen.camera, 0.5 - 0.5 / n
        T = seen.T_world_camera
        return Frame(
            np.ascontiguousarray(seen.depth[::n, ::n], np.float32),
            np.ascontiguousarray(seen.labels[::n, ::n], np.uint8),
            _lens(camera, n, half),
            np.ascontiguousarray(T.rotation, np.float64),
            np.ascontiguousarray(T.translation, np.float64),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """What all frames together say of the ground, on one fine grid.

    `cells[row, col]`, row grows with y, from the lower left corner of `bounds`. Obstacles are left out.
    """

    bounds: Bounds
    cell: float
    """Metres; a whole number of them makes a cell of the map."""
    height: Float32Array
    """(rows, cols) world z of what is on top, as far as it was seen; NaN where nothing was."""
    share: Float32Array
    """(rows, cols) share of the views, by weight, that took it for target; 0 where nothing was seen."""
    nearest: Float32Array
    """(rows, cols) least depth that it was seen at, metres; inf where it was not."""
    top: Float32Array
    """(rows, cols) world z of the highest point of target; −inf where there is none."""
    times: npt.NDArray[np.uint16]
    """Frames that saw each cell of the map within reach, on the map's grid."""
    scatter: float
    """Per metre: depths z scatter by σ = this z², as the frames themselves show."""

    @property
    def seen(self) -> npt.NDArray[np.bool_]:
        """(rows, cols)."""
        return np.isfinite(self.nearest)

    def around_target(self, margin: float) -> Ground:
        """The part within so many metres of anything that may be target; `times` stays that of the whole."""
        target = self.share > 0.0
        if not target.any():
            return self
        box = []
        for axis, side in ((1, self.height.shape[0]), (0, self.height.shape[1])):
            found, far = np.flatnonzero(target.any(axis=axis)), math.ceil(margin / self.cell)
            box.append((max(int(found[0]) - far, 0), min(int(found[-1]) + far + 1, side)))
        (south, north), (west, east) = box
        part = np.s_[south:north, west:east]
        corner = (self.bounds.x_min, self.bounds.y_min)
        return Ground(
            Bounds(
                corner[0] + west * self.cell,
                corner[1] + south * self.cell,
                corner[0] + east * self.cell,
                corner[1] + north * self.cell,
            ),
            self.cell,
            self.height[part],
            self.share[part],
            self.nearest[part],
            self.top[part],
            self.times,
            self.scatter,
        )

    def centres(
        self, row: npt.NDArray[np.intp], col: npt.NDArray[np.intp]
    ) -> tuple[Float64Array, Float64Array]:
        """World x and y of the middles of cells."""
        x, y = self.bounds.x_min + (col + 0.5) * self.cell, self.bounds.y_min + (row + 0.5) * self.cell
        return np.asarray(x, np.float64), np.asarray(y, np.float64)


def fuse(frames: Iterable[Frame], bounds: Bounds, protocol: SurveyProtocol, scatter: float) -> Ground:
    """All frames on one grid; the nearest views weigh most.

    Args:
        frames: Of a whole mission.
        bounds: What to draw.
        protocol: Reach, depth limits, and the cells of the map.
        scatter: Of the depths, from `perception.scatter.scatter_of`.
    """
    from dream.survey import _kernels

    least = max(CELL, math.sqrt(bounds.width * bounds.depth / MOST_CELLS))
    cell = protocol.cell / max(1, math.floor(protocol.cell / least + 1e-9))
    shape = (round(bounds.depth / cell), round(bounds.width / cell))
    weight, height, share = (np.zeros(shape, np.float32) for _ in range(3))
    nearest, top = np.full(shape, np.inf, np.float32), np.full(shape, -np.inf, np.float32)
    coarse = (round(bounds.depth / protocol.cell), round(bounds.width / protocol.cell))
    last, times = np.full(coarse, -1, np.int32), np.zeros(coarse, np.uint16)
    corner = np.array([bounds.x_min, bounds.y_min])
    limits = np.array([*protocol.returns, protocol.reach])
    for number, frame in enumerate(frames):
        depth = smoothed(frame.depth) if scatter > SCATTERS else frame.depth
        _kernels.splat(
            depth,
            frame.labels,
            frame.lens,
            frame.rotation,
            frame.origin,
            limits,
            corner,
            cell,
            weight,
            height,
            share,
            nearest,
            top,
        )
        _kernels.count_looks(
            frame.depth,
            frame.lens,
            frame.rotation,
            frame.origin,
            limits,
            corner,
            protocol.cell,
            number,
            last,
            times,
        )
    seen = weight > 0.0
    np.divide(height, weight, out=height, where=seen)
    np.divide(share, weight, out=share, where=seen)
    height[~seen] = np.nan
    return Ground(bounds, cell, height, share, nearest, top, times, scatter)


def smoothed(depth: Float32Array) -> Float32Array:
    """(H, W) depths of which the inverse is a mean over 3 × 3 pixels: unbiased on a plane, σ a third."""
    from scipy import ndimage

    valid = np.isfinite(depth) & (depth > 0.0)
    inverse = np.where(valid, 1.0 / np.where(valid, depth, 1.0), 0.0)
    total = ndimage.uniform_filter(inverse, 3, mode="nearest")
    count = ndimage.uniform_filter(valid.astype(np.float64), 3, mode="nearest")
    return np.where(valid, count / np.maximum(total, 1e-9), np.nan).astype(np.float32)


def _lens(camera: Camera, n: int, half: float) -> Float64Array:
    # A pixel's centre moves to that of the pixels around it.
    return np.array([camera.fx / n, camera.fy / n, camera.cx / n + half, camera.cy / n + half])
