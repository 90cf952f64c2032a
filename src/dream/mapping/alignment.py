"""Where a frame fits the map best."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, SE3, Bounds, Camera
from dream.mapping.layers import Layers
from dream.mapping.occupancy import OccupancyMap
from dream.types import Label

Float64Array = npt.NDArray[np.float64]
PIXELS = 2
"""Of the rows and columns of an image every so many-th is looked at."""
PARTS = 2
"""Points along the side of a cell, at most: so that what is near does not outweigh what is far."""
SOLID_SHARE = 0.05
"""Share of a part's pixels in the height band that make it solid, as in the map's own rule."""


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Where a frame fits, seen from where it was taken for."""

    offset: SE2
    """What to add to the vehicle's x, y and yaw, metres and radians in the world."""
    information: Float64Array
    """(3, 3) inverse covariance of the offset; along a straight edge it is singular, and 0 along it."""
    mismatch: float
    """Mean squared difference between the frame and the map there, 0 to 1."""
    overlap: float
    """Square metres of known map that the frame fell on."""


@dataclass(frozen=True, slots=True)
class Matching:
    """Correlative matching of a frame to a map.

    What it does: the frame's ground points say target or not, and solid or not. So does the map, between its
    cells' centres by interpolation. The offset with the least mean squared difference is looked for on a grid
    over the whole window, then by quadrics. Their curvature says how sure each direction is. Other minima that
    fit about as well take away all information along the line to them, so that a straight edge corrects only
    across it, and a pattern that repeats not at all.

    Reference: Olson, Real-Time Correlative Scan Matching, ICRA 2009: the search, and the covariance from its
    scores.

    Assumes: a level vehicle with the camera at its centre; a map of what is there now.
    Fails when: the error is greater than the window.
    """

    window: float = 0.5
    """Metres east, west, north and south that are searched."""
    turn: float = math.radians(3.0)
    """Radians to both sides, likewise."""
    step: float = 0.125
    """Metres between offsets."""
    turn_step: float = math.radians(1.0)
    """Radians between turns."""
    min_overlap: float = 6.0
    """Square metres of known map below which nothing is said."""
    floor: float = 0.02
    """Least mean squared difference that is believed."""
    trust: float = 0.25
    """Independent witnesses a cell: neighbours err alike, and so do the frames that the map was made from."""
    rival: float = 4.0
    """Nats by which another minimum must be worse than the best."""
    sigma: float = 0.2
    """Metres: a direction that is less sure is not known at all."""
    leverage: float = 4.0
    """Metres at which a turn counts as the shift that it causes."""

    def align(
        self,
        occupancy: OccupancyMap,
        depth: npt.NDArray[np.floating],
        labels: npt.NDArray[np.integer],
        camera: Camera,
        T_world_camera: SE3,
    ) -> Alignment | None:
        """Where a frame fits a map that does not hold it yet.

        Args:
            occupancy: The map; not changed.
            depth: (H, W) metres along the optical axis; NaN for no return.
            labels: (H, W) values of `Label`.
            camera: Intrinsics of both images.
            T_world_camera: Where the optical frame is taken to be.

        Returns:
            None where too little of the map is in view, it has too little structure, or the best offset is not
            inside the window.
        """
        protocol = occupancy.protocol
        x, y = (float(a) for a in T_world_camera.translation[:2])
        half = protocol.reach * (1.0 + self.turn) + self.window + 2.0 * protocol.cell
        layers = occupancy.over(Bounds(x - half, y - half, x + half, y + half))
        points, said = _said(layers, depth, labels, camera, T_world_camera)
        if not len(points):
            return None
        fit = _Fit(self, layers, points, said, (x, y))
        if fit.overlap(np.zeros((1, 3)))[0] < self.min_overlap:
            return None
        return _best(self, fit)


class _Fit:
    """Log-likelihood of offsets, in metres and radians."""

    def __init__(
        self,
        matching: Matching,
        layers: Layers,
        points: Float64Array,
        said: Float64Array,
        position: tuple[float, float],
    ) -> None:
        self._cell = cell = layers.protocol.cell
        known = np.stack([layers.voted, layers.known]).astype(np.float64)
        values = np.stack([layers.target_probability, layers.solid]).astype(np.float64)
        self._known, self._weighted = known, known * values
        self._points, self._said = points / cell, said
        row, col = layers.low
        (x, y), corner = position, layers.center_of(0, 0)
        self._center = ((x - float(corner[0])) / cell + 0.5, (y - float(corner[1])) / cell + 0.5)
        self._matching = matching
        self._unit = np.array([1.0 / cell, 1.0 / cell, 1.0])

    def mismatch(self, offsets: Float64Array) -> tuple[Float64Array, Float64Array]:
        from dream.mapping._kernels import alignment as kernels

        return kernels.mismatch(  # type: ignore[no-any-return]
            self._points, self._said, self._known, self._weighted, self._center, offsets * self._unit
        )

    def overlap(self, offsets: Float64Array) -> Float64Array:
        """Square metres."""
        channels = len(self._known)
        square: Float64Array = self.mismatch(offsets)[1] / channels * (self._cell / PARTS) ** 2
        return square


def _said(
    layers: Layers,
    depth: npt.NDArray[np.floating],
    labels: npt.NDArray[np.integer],
    camera: Camera,
    T_world_camera: SE3,
) -> tuple[Float64Array, Float64Array]:
    """(n, 2) metres east and north from the camera, and (n, 2) shares of target and, 0 or 1, solid."""
    protocol = layers.protocol
    lower, upper = protocol.band
    depth, labels = depth[::PIXELS, ::PIXELS], labels[::PIXELS, ::PIXELS]
    rays = Camera(
        depth.shape[1], depth.shape[0], *(a / PIXELS for a in (camera.fx, camera.fy, camera.cx, camera.cy))
    )
    offsets = rays.back_project(depth, SE3(T_world_camera.rotation, np.zeros(3)))
    near = (depth > protocol.min_depth) & (depth <= protocol.max_depth) & (labels != Label.WATER)
    near &= np.hypot(offsets[..., 0], offsets[..., 1]) <= protocol.reach
    offsets, kinds = offsets[near], labels[near]
    places = offsets + T_world_camera.translation
    row, col = layers.cell_of(places[:, 0], places[:, 1])
    height = places[:, 2] - layers.ground[row, col]
    sees = height <= upper
    offsets, kinds, height = offsets[sees], kinds[sees], height[sees]
    part = protocol.cell / PARTS
    span = 2 * math.ceil(protocol.reach / part) + 1
    i, j = (np.floor(offsets[:, axis] / part + span / 2).astype(np.intp) for axis in (1, 0))
    flat = i * span + j
    count = np.bincount(flat, minlength=span * span)
    some = count > 0
    sums = [
        np.bincount(flat, weights=values, minlength=span * span)[some] / count[some]
        for values in (offsets[:, 0], offsets[:, 1], kinds == Label.TARGET, height >= lower)
    ]
    east, north, target, inside = sums
    return np.column_stack([east, north]), np.column_stack([target, inside >= SOLID_SHARE]).astype(np.float64)


def _best(matching: Matching, fit: _Fit) -> Alignment | None:
    window, turn = matching.window, matching.turn
    steps, turns = round(window / matching.step), round(turn / matching.turn_step)
    shifts = np.arange(-steps, steps + 1) * matching.step
    angles = np.arange(-turns, turns + 1) * matching.turn_step
    grid = np.array(list(itertools.product(shifts, shifts, angles)))
    mean, weight = fit.mismatch(grid)
    least = max(float(mean.min()), matching.floor)
    witnesses = matching.trust * float(np.median(weight)) / (2 * PARTS**2)
    weak = np.array([1.0 / window**2, 1.0 / window**2, 1.0 / turn**2])

    def cost(offsets: Float64Array, mean: Float64Array) -> Float64Array:
        """Nats; of those that fit alike the nearest is the best."""
        total: Float64Array = 0.5 * witnesses * mean / least + 0.5 * (offsets**2 @ weak)
        return total

    nats = cost(grid, mean).reshape(len(shifts), len(shifts), len(angles))
    here = grid[int(np.argmin(nats))]
    h = np.array([matching.step, matching.step, matching.turn_step])
    curvature = np.zeros((3, 3))
    for _ in range(2):
        around = here + _CUBE * h
        near = fit.mismatch(around)[0]
        gradient, curvature = _quadric(cost(around, near))
        move = _downhill(gradient, curvature)
        here = here + np.clip(move, -1.0, 1.0) * h
    if (np.abs(here) > np.array([window, window, turn])).any():
        return None
    information = curvature / np.outer(h, h) - np.diag(weak)
    flat = nats.min(axis=2)
    for i, j in _minima(flat):
        rival = np.array([shifts[i], shifts[j]]) - here[:2]
        if flat[i, j] - flat.min() < matching.rival and np.abs(rival).max() > 1.5 * matching.step:
            line = np.array([*rival, 0.0])
            along = float(line @ information @ line)
            if along > 0.0:
                information = information - np.outer(information @ line, information @ line) / along
    information = _sure(information, matching.sigma, matching.leverage)
    if not information.any():
        return None
    mean, _ = fit.mismatch(here[None, :])
    return Alignment(
        SE2(float(here[0]), float(here[1]), float(here[2])),
        information,
        float(mean[0]),
        float(fit.overlap(here[None, :])[0]),
    )


_CUBE = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))


@lru_cache(maxsize=1)
def _to_quadric() -> Float64Array:
    """(10, 27): values on `_CUBE` to the coefficients of 1, x, y, z, xx, yy, zz, xy, xz, yz."""
    x, y, z = _CUBE.T
    terms = np.column_stack([np.ones(27), x, y, z, x * x, y * y, z * z, x * y, x * z, y * z])
    return np.asarray(np.linalg.pinv(terms))


def _quadric(values: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Gradient (3,) and second derivatives (3, 3) of the quadric nearest to the values on `_CUBE`."""
    _, x, y, z, xx, yy, zz, xy, xz, yz = _to_quadric() @ values
    return np.array([x, y, z]), np.array([[2.0 * xx, xy, xz], [xy, 2.0 * yy, yz], [xz, yz, 2.0 * zz]])


def _downhill(gradient: Float64Array, curvature: Float64Array) -> Float64Array:
    """To the least of a quadric; along directions in which it has none, nowhere."""
    values, vectors = np.linalg.eigh(curvature)
    slopes = vectors.T @ gradient
    return np.asarray(vectors @ np.where(values > 1e-9, -slopes / np.maximum(values, 1e-9), 0.0))


def _minima(values: Float64Array) -> list[tuple[int, int]]:
    """Places that are no greater than their eight neighbours."""
    wide = np.pad(values, 1, constant_values=np.inf)
    rows, cols = values.shape
    least = np.min(
        [wide[i : i + rows, j : j + cols] for i, j in itertools.product(range(3), repeat=2)], axis=0
    )
    return [(int(i), int(j)) for i, j in np.argwhere(values <= least)]


def _sure(information: Float64Array, sigma: float, leverage: float) -> Float64Array:
    """Without the directions that are less sure than a sigma; a turn counts as a shift at the leverage."""
    scale = np.array([1.0, 1.0, 1.0 / leverage])
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    kept = np.where(values >= 1.0 / sigma**2, values, 0.0)
    return np.asarray((vectors * kept) @ vectors.T / np.outer(scale, scale))
