"""Where a frame fits best on what other frames showed of the same ground."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, SE3, Camera
from dream.protocol import SurveyProtocol
from dream.types import Label

Float64Array = npt.NDArray[np.float64]
EAST, NORTH, TARGET, HEIGHT = range(4)
"""Columns of ground points: metres in the world, the share of target, world z in metres."""
PART = 0.125
"""Metres: what falls into a square of this side is one ground point, so that what is near, and shown by more
pixels, does not outweigh what is far."""


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Where a frame fits, seen from where it was taken for."""

    offset: SE2
    """What to add to the vehicle's x, y and yaw, metres and radians in the world."""
    information: Float64Array
    """(3, 3) inverse of the offset's covariance; singular where a direction says nothing, as along a straight
    edge."""
    mismatch: float
    """Mean squared difference there: 1 where target lies on bare seabed throughout."""
    overlap: float
    """Square metres of ground that both show."""


@dataclass(frozen=True, slots=True)
class Matching:
    """Correlative matching of ground points.

    What it does: the other frames' points make a grid of how much is target and how high the ground is,
    between its cells' centres by interpolation. In a whole window of offsets the one with the least mean
    squared difference is looked for, then refined by quadrics. Their curvature says how sure each direction
    is. Another minimum that fits about as well takes away all information along the line to it: a straight
    edge corrects only across, a pattern that repeats not at all.

    Reference: Olson, Real-Time Correlative Scan Matching, ICRA 2009: a search of the whole window, and the
    covariance from its scores. The numbers were chosen on recorded missions.

    Assumes: a vehicle that is level but for a few degrees, with its camera at its centre.
    Fails when: the offset is greater than the window.
    """

    window: float = 0.5
    """Metres that are searched to the east, west, north and south."""
    turn: float = math.radians(3.0)
    """Radians that are searched to both sides."""
    step: float = 0.125
    """Metres between offsets."""
    turn_step: float = math.radians(1.0)
    """Radians between turns."""
    cell: float = 0.2
    """Side of the grid's cells, metres."""
    height_scale: float = 4.0
    """Metres in height that count as much as target instead of bare seabed. Heights are weak witnesses: what
    stands up hides ground behind it, and shows other sides from elsewhere."""
    relief: float = 1.0
    """Metres above and below the mean height within which heights are told apart: the sides of what is higher
    are not seen alike from everywhere."""
    min_overlap: float = 6.0
    """Square metres of common ground below which nothing is said."""
    floor: float = 0.02
    """Least mean squared difference that is believed."""
    trust: float = 0.1
    """Witnesses that one ground point is worth: neighbours err alike."""
    rival: float = 4.0
    """Nats by which another minimum must be worse than the best, or it is as good."""
    sigma: float = 0.2
    """Metres: what is less sure than this says nothing."""
    leverage: float = 4.0
    """Metres from the vehicle at which a turn is judged by the shift that it causes."""

    def __post_init__(self) -> None:
        lengths = ("window", "turn", "step", "turn_step", "cell", "height_scale", "relief", "sigma")
        for name in (*lengths, "floor", "trust", "leverage"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected a number above 0, got {getattr(self, name)}")
        for name in ("min_overlap", "rival"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected 0 or more, got {getattr(self, name)}")
        for step, reach in (("step", "window"), ("turn_step", "turn")):
            if getattr(self, step) > getattr(self, reach):
                most = getattr(self, reach)
                raise ValueError(f"{step}: expected at most the {reach}, {most}, got {getattr(self, step)}")

    def align(
        self, points: Float64Array, pivot: tuple[float, float], others: Float64Array
    ) -> Alignment | None:
        """Where the points of a frame fit those of others.

        Args:
            points: (n, 4) ground points of the frame; see `ground_points`.
            pivot: World x and y of the vehicle, about which they are turned.
            others: (m, 4) ground points of other frames.

        Returns:
            None where they have too little in common, no direction is sure, or the best offset is not inside
            the window.
        """
        if not (len(points) and len(others)):
            return None
        fit = _Fit(self, points, pivot, others)
        return _best(self, fit) if fit.overlap(np.zeros(3)) >= self.min_overlap else None


def ground_points(
    depth: npt.NDArray[Any],
    labels: npt.NDArray[Any],
    camera: Camera,
    T_world_camera: SE3,
    protocol: SurveyProtocol,
) -> Float64Array:
    """(n, 4) what a frame shows of the ground within reach, one point for each part that it shows of it.

    Args:
        depth: (H, W) metres along the optical axis; NaN for no return.
        labels: (H, W) values of `Label`.
        camera: Intrinsics of both images.
        T_world_camera: Where the optical frame was.
        protocol: Depth limits and reach.
    """
    camera.check(depth, "depth")
    camera.check(labels, "labels")
    offsets = camera.back_project(depth, SE3(T_world_camera.rotation, np.zeros(3)))
    least, greatest = protocol.returns
    counts = (depth > least) & (depth <= greatest) & (labels != Label.WATER)
    counts &= np.hypot(offsets[..., 0], offsets[..., 1]) <= protocol.reach
    offsets, target = offsets[counts], labels[counts] == Label.TARGET
    side = 2 * math.ceil(protocol.reach / PART) + 2
    col, row = (np.floor(offsets[:, axis] / PART).astype(np.intp) + side // 2 for axis in (0, 1))
    values = (offsets[:, 0], offsets[:, 1], target, offsets[:, 2])
    parts = _means(row * side + col, values, side * side)
    points = np.column_stack(parts[1:])[parts[0] > 0.0]
    points[:, [EAST, NORTH, HEIGHT]] += T_world_camera.translation
    return points


def moved(points: Float64Array, pivot: tuple[float, float], offset: SE2) -> Float64Array:
    """Ground points turned about a pivot, then shifted."""
    c, s = math.cos(offset.yaw), math.sin(offset.yaw)
    x, y = points[:, EAST] - pivot[0], points[:, NORTH] - pivot[1]
    east, north = pivot[0] + offset.x + c * x - s * y, pivot[1] + offset.y + s * x + c * y
    return np.column_stack([east, north, points[:, TARGET], points[:, HEIGHT]])


class _Fit:
    """How well the points fit at any offset."""

    def __init__(
        self, matching: Matching, points: Float64Array, pivot: tuple[float, float], others: Float64Array
    ) -> None:
        cell = matching.cell
        place = points[:, [EAST, NORTH]] - pivot
        # As far as they reach, at any offset.
        half = math.ceil((np.hypot(*place.T).max() + math.sqrt(2.0) * matching.window) / cell) + 1
        side = 2 * half
        col, row = (
            np.floor((others[:, axis] - pivot[axis]) / cell).astype(np.intp) + half for axis in (0, 1)
        )
        inside = (row >= 0) & (row < side) & (col >= 0) & (col < side)
        datum = float(others[inside, HEIGHT].mean()) if inside.any() else 0.0
        values = _channels(matching, others[inside], datum)
        count, *means = _means((row * side + col)[inside], values.T, side * side)
        known = np.tile(count > 0.0, (2, 1)).reshape(2, side, side)
        self._known = known.astype(np.float64)
        self._weighted = np.reshape(means, known.shape) * self._known
        self._points, self._said = place / cell, _channels(matching, points, datum)
        self._center = (float(half), float(half))
        self._unit = np.array([1.0 / cell, 1.0 / cell, 1.0])

    def mismatch(self, offsets: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(m,) mean squared differences, and (m,) points that counted, for (m, 3) offsets."""
        from dream.mapping._kernels import alignment as kernels

        offsets = np.ascontiguousarray(offsets * self._unit)
        mean, weight = kernels.mismatch(
            self._points, self._said, self._known, self._weighted, self._center, offsets
        )
        return mean, weight / len(self._known)

    def overlap(self, offset: Float64Array) -> float:
        """Square metres."""
        return float(self.mismatch(offset[None, :])[1][0]) * PART**2


def _channels(matching: Matching, points: Float64Array, datum: float) -> Float64Array:
    """(n, 2): target, and height as its differences count."""
    height = np.clip(points[:, HEIGHT] - datum, -matching.relief, matching.relief)
    return np.column_stack([points[:, TARGET], height / matching.height_scale])


def _means(flat: npt.NDArray[np.intp], values: Any, size: int) -> list[Float64Array]:
    """How many fall on each of `size` places, and the mean of each of the values there, 0 where none."""
    count = np.bincount(flat, minlength=size).astype(np.float64)
    sums = (np.bincount(flat, weights=value, minlength=size) for value in values)
    return [count, *(total / np.maximum(count, 1.0) for total in sums)]


def _best(matching: Matching, fit: _Fit) -> Alignment | None:
    window, turn = matching.window, matching.turn
    limits, steps = np.array([window, window, turn]), np.array([matching.step] * 2 + [matching.turn_step])
    shifts, angles = (
        np.arange(-n, n + 1) * step
        for n, step in ((round(window / steps[0]), steps[0]), (round(turn / steps[2]), steps[2]))
    )
    grid = np.array(list(itertools.product(shifts, shifts, angles)))
    mean, weight = fit.mismatch(grid)
    # An offset that loses the common ground must not win by what little is left.
    mean = np.where(weight >= 0.5 * weight.max(), mean, np.inf)
    per_mismatch = 0.5 * matching.trust * float(np.median(weight)) / max(float(mean.min()), matching.floor)
    # Weak, so that of those that fit alike the nearest is the best.
    weak = np.diag(1.0 / limits**2)

    def nats(offsets: Float64Array, mean: Float64Array) -> Float64Array:
        pulled: Float64Array = 0.5 * np.einsum("ni,ij,nj->n", offsets, weak, offsets)
        return per_mismatch * mean + pulled

    cost = nats(grid, mean).reshape(len(shifts), len(shifts), len(angles))
    best = grid[int(np.argmin(cost))]
    h, curvature = steps, np.zeros((3, 3))
    for finer in (1.0, 0.5, 0.5, 0.5):
        h = finer * steps
        near = best + _CUBE * h
        gradient, curvature = _quadric(nats(near, fit.mismatch(near)[0]))
        best = best + np.clip(_downhill(gradient, curvature), -1.0, 1.0) * h
    if (np.abs(best) > limits).any():
        return None
    information = curvature / np.outer(h, h) - weak
    flat = cost.min(axis=2)
    for i, j in _minima(flat):
        line = np.array([shifts[i] - best[0], shifts[j] - best[1], 0.0])
        if flat[i, j] - flat.min() < matching.rival and np.abs(line).max() > 1.5 * matching.step:
            information = _without(information, line)
    information = _sure(information, matching.sigma, matching.leverage)
    if not information.any():
        return None
    mean, weight = fit.mismatch(best[None, :])
    return Alignment(SE2(*best.tolist()), information, float(mean[0]), float(weight[0]) * PART**2)


_CUBE = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))


@lru_cache(maxsize=1)
def _to_quadric() -> Float64Array:
    """(10, 27): values on `_CUBE` to the coefficients of 1, x, y, z, xx, yy, zz, xy, xz and yz."""
    x, y, z = _CUBE.T
    terms = np.column_stack([np.ones(27), x, y, z, x * x, y * y, z * z, x * y, x * z, y * z])
    return np.asarray(np.linalg.pinv(terms))


def _quadric(values: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Gradient (3,) and second derivatives (3, 3), in the middle, of the quadric nearest to the values."""
    _, x, y, z, xx, yy, zz, xy, xz, yz = _to_quadric() @ values
    return np.array([x, y, z]), np.array([[2.0 * xx, xy, xz], [xy, 2.0 * yy, yz], [xz, yz, 2.0 * zz]])


def _downhill(gradient: Float64Array, curvature: Float64Array) -> Float64Array:
    """To the least of a quadric; nowhere along directions in which it has none."""
    values, vectors = np.linalg.eigh(curvature)
    slopes = vectors.T @ gradient
    return np.asarray(vectors @ np.where(values > 1e-9, -slopes / np.maximum(values, 1e-9), 0.0))


def _minima(values: Float64Array) -> list[tuple[int, int]]:
    """Places that are no greater than their eight neighbours."""
    wide = np.pad(values, 1, constant_values=np.inf)
    rows, cols = values.shape
    around = [wide[i : i + rows, j : j + cols] for i, j in itertools.product(range(3), repeat=2)]
    return [(int(i), int(j)) for i, j in np.argwhere(values <= np.min(around, axis=0))]


def _without(information: Float64Array, line: Float64Array) -> Float64Array:
    """What is left when nothing is known along a line."""
    along = float(line @ information @ line)
    if along <= 0.0:
        return information
    pushed = information @ line
    return np.asarray(information - np.outer(pushed, pushed) / along)


def _sure(information: Float64Array, sigma: float, leverage: float) -> Float64Array:
    """Without the directions that are less sure than sigma; a turn is judged at the leverage."""
    scale = np.array([1.0, 1.0, 1.0 / leverage])
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    kept = np.where(values >= 1.0 / sigma**2, values, 0.0)
    return np.asarray((vectors * kept) @ vectors.T / np.outer(scale, scale))
