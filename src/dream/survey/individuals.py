"""The fine picture of the ground → individuals, each located, sized and counted once.

Clumps of shells grow into crusts, so that a connected patch of target is no individual. What tells neighbours
apart is relief: each clump is a small mound, and all frames together draw it. A peak of that relief, weighed
by how sure its spot is target, is an individual. One that lies under or hard beside another shows no
peak of its own; for those each peak that is found stands for more than one, by a capture model.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.protocol import SurveyProtocol
from dream.survey.calibration import Calibration
from dream.survey.ground import Frame, Ground
from dream.types import BoolArray, Float32Array

Float64Array = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]

BLUR = 0.04
"""Metres: the picture is blurred so much, so that the shells of one clump make one peak."""
APART = 0.08
"""Metres between two peaks at least."""
TALLEST = 0.3
"""Metres: what stands higher above the ground around it counts as this high."""
FLAT = 0.03
"""Metres: what target is worth in relief where it has none."""
SPARSEST = 0.25
"""Share of the ground around a peak, so blurred, that is target at least."""
AROUND = 2.0
"""Metres: how far around target the ground matters to it."""
CROWD = 0.25
"""Metres: how far around a peak its crowding is looked at."""
BLOCK = 4
"""Cells along a block for what is smooth."""
WIDEST = 0.25
"""Metres from its peak where the shell of an individual ends at the latest."""
DIRECTIONS = 12
"""Along which an extent is taken."""
TYPICAL = 0.24
"""Metres: the size of what makes up the cover of a reef of a year, about."""
LARGER = 0.25
"""Logarithm of the ratio to it up to which the capture model goes."""
HIDDEN = 0.12
"""Metres before a peak at which a return hides it."""
RECOGNISED = 0.75
"""How often an individual in view is labelled target, hidden ones included; a frame has one vote."""
MISTAKEN = 0.03
"""How often bare ground is."""


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """N peaks of relief. Arrays share their first axis."""

    position: Float64Array
    """(N, 3) metres in the world: over its middle, at the height of its top."""
    cover: Float64Array
    """(N,) share of the ground within about `CROWD` that is target."""
    nearest: Float64Array
    """(N,) least depth that it was seen at, metres."""
    across: Float64Array
    """(N,) metres: the greatest extent of its shell, as it shows."""
    lone: BoolArray
    """(N,) its shell touches that of no other peak."""
    stature: Float64Array
    """(N,) metres: mean height of the shell within about `CROWD`, above the ground between the shells."""

    def __len__(self) -> int:
        return len(self.position)


def peaks(ground: Ground) -> Peaks:
    """Every peak of the relief of what is target."""
    from scipy import ndimage

    ground = ground.around_target(AROUND)
    cell, seen = ground.cell, ground.seen
    share = np.where(seen, ground.share, np.float32(0.0))
    above = np.where(seen, ground.height - bare_ground(ground), np.float32(0.0))
    raw = share * (np.clip(above, -0.02, TALLEST) + np.float32(FLAT))
    sigma = BLUR / cell
    weight = np.maximum(ndimage.gaussian_filter(seen.astype(np.float32), sigma), 0.05)
    dense = ndimage.gaussian_filter(share, sigma) / weight
    relief = ndimage.gaussian_filter(raw, sigma) / weight
    reach = round(APART / cell)
    disc = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1]) <= reach + 0.3
    top = (dense > SPARSEST) & (weight > 0.1)
    top &= relief == ndimage.maximum_filter(relief, footprint=disc)
    row, col = np.nonzero(top)
    x, y = ground.centres(row, col)
    place = np.column_stack([x, y])
    block = np.minimum(row // BLOCK, -(-share.shape[0] // BLOCK) - 1), col // BLOCK
    near = ndimage.minimum_filter(ground.nearest, 5)[row, col].astype(np.float64)
    across, lone, height = _shells(ground, place, share)
    cover, stature = crowding(ground)[block], _statures(ground.cell, share, above)[block]
    return Peaks(np.column_stack([place, height]), cover, near, across, lone, stature)


def bare_ground(ground: Ground) -> Float32Array:
    """(rows, cols) world z of the ground between the shells: a smooth surface through what is not target."""
    from scipy import ndimage

    bare = ground.seen & (ground.share < 0.3)
    total = _blocks(np.where(bare, ground.height, 0.0))
    count = _blocks(bare.astype(np.float64))
    surface, weight = np.zeros_like(total), np.zeros_like(count)
    # Where nothing bare is near, the wider means decide.
    for sigma, worth in ((0.08, 1.0), (0.16, 0.05), (0.4, 1e-3), (1.2, 1e-6), (4.0, 1e-12)):
        width = sigma / (BLOCK * ground.cell)
        surface += worth * ndimage.gaussian_filter(total, width)
        weight += worth * ndimage.gaussian_filter(count, width)
    level = np.divide(surface, weight, out=np.full_like(surface, _level(ground)), where=weight > 1e-30)
    row, col = ((np.arange(side) + 0.5) / BLOCK - 0.5 for side in ground.height.shape)
    return _bilinear(level, row, col)


def crowding(ground: Ground) -> Float64Array:
    """Share of what was seen within about `CROWD` that is target, in blocks of `BLOCK` cells."""
    from scipy import ndimage

    width = CROWD / (BLOCK * ground.cell)
    cover = ndimage.gaussian_filter(_blocks(np.where(ground.seen, ground.share, 0.0)), width)
    seen = ndimage.gaussian_filter(_blocks(ground.seen.astype(np.float64)), width)
    share: Float64Array = cover / np.maximum(seen, 0.05 * BLOCK * BLOCK)
    return share


def _statures(cell: float, share: Float32Array, above: Float32Array) -> Float64Array:
    """Mean heights of shell, in blocks of `BLOCK` cells."""
    from scipy import ndimage

    width = CROWD / (BLOCK * cell)
    total = ndimage.gaussian_filter(_blocks(share * np.clip(above, -0.02, TALLEST)), width)
    stature: Float64Array = total / np.maximum(ndimage.gaussian_filter(_blocks(share), width), 1e-3)
    return stature


def features(found: Peaks, typical_size: float | None) -> Float64Array:
    """(N, 4) what the capture model goes by: one, crowding, range, and how large individuals are there.

    Args:
        found: Peaks.
        typical_size: Metres, of what makes up the reef's cover; None where it is not known.
    """
    range_ = np.clip(found.nearest - 3.0, -2.0, 6.0)
    larger = 0.0 if typical_size is None else math.log(typical_size / TYPICAL)
    # Beyond what the model was found on it does not go.
    larger = min(max(larger, -LARGER), LARGER)
    one = np.ones(len(found))
    return np.column_stack([one, found.cover - 0.5, range_, larger * one])


def stands_for(found: Peaks, typical_size: float | None, calibration: Calibration) -> Float64Array:
    """(N,) individuals that each peak stands for: the capture model. See `features`."""
    worth = np.clip(features(found, typical_size) @ calibration.capture, -2.0, 2.5)
    weight: Float64Array = np.exp(worth)
    return weight


def recognised(
    found: Peaks, frames: Iterable[Frame], protocol: SurveyProtocol
) -> tuple[Int32Array, Int32Array]:
    """(N,) frames in which each peak was labelled target, and in which it could have been."""
    from dream.survey import _kernels

    hits, looks = np.zeros(len(found), np.int32), np.zeros(len(found), np.int32)
    limits = np.array([*protocol.returns, protocol.reach])
    for frame in frames:
        _kernels.recognise(
            found.position,
            frame.depth,
            frame.labels,
            frame.lens,
            frame.rotation,
            frame.origin,
            limits,
            HIDDEN,
            hits,
            looks,
        )
    return hits, np.maximum(looks, hits)


def confidence(hits: Int32Array, looks: Int32Array, in_patch: BoolArray) -> Float64Array:
    """(N,) probability that each peak is an individual: every look an independent witness (Bayes).

    Beforehand that is likely on a patch of reef, and not elsewhere.
    """
    prior = np.where(in_patch, 0.95, 0.3)
    odds = np.log(prior / (1.0 - prior)) + hits * math.log(RECOGNISED / MISTAKEN)
    odds = odds + (looks - hits) * math.log((1.0 - RECOGNISED) / (1.0 - MISTAKEN))
    probability: Float64Array = 1.0 / (1.0 + np.exp(-np.clip(odds, -30.0, 30.0)))
    return probability


def _shells(
    ground: Ground, place: Float64Array, share: Float32Array
) -> tuple[Float64Array, BoolArray, Float64Array]:
    """The greatest extent of each peak's shell, whether it touches no other's, and the height of its top.

    A cell of shell belongs to the nearest peak within `WIDEST`. Extents are taken along `DIRECTIONS` lines.
    """
    from scipy import ndimage
    from scipy.spatial import cKDTree

    count = len(place)
    if count == 0:
        return np.zeros(0), np.zeros(0, np.bool_), np.zeros(0)
    shell = share > 0.5
    row, col = np.nonzero(shell)
    x, y = ground.centres(row, col)
    away, nearest = cKDTree(place).query(np.column_stack([x, y]), distance_upper_bound=WIDEST)
    mine = np.isfinite(away)
    owner = np.asarray(nearest)[mine]
    row, col, x, y = row[mine], col[mine], x[mine], y[mine]
    across = np.zeros(count)
    for angle in np.arange(DIRECTIONS) * (math.pi / DIRECTIONS):
        along = math.cos(angle) * x + math.sin(angle) * y
        high, low = np.full(count, -np.inf), np.full(count, np.inf)
        np.maximum.at(high, owner, along)
        np.minimum.at(low, owner, along)
        np.maximum(across, high - low, out=across, where=high >= low)
    marks, _ = ndimage.label(shell, np.ones((3, 3)))
    # Parts of shell, and the peaks that own a cell of each.
    pairs = np.unique(np.column_stack([marks[row, col], owner]), axis=0)
    owners = np.bincount(pairs[:, 0])
    shared = np.zeros(count, np.bool_)
    shared[pairs[owners[pairs[:, 0]] > 1, 1]] = True
    height = np.full(count, -np.inf)
    np.maximum.at(height, owner, ground.height[row, col].astype(np.float64))
    middle = ((place - (ground.bounds.x_min, ground.bounds.y_min)) / ground.cell).astype(np.intp)
    here = ground.height[middle[:, 1], middle[:, 0]].astype(np.float64)
    level = np.where(np.isfinite(height), height, np.nan_to_num(here, nan=_level(ground)))
    return across + ground.cell, ~shared & (across > 0.0), level


def _level(ground: Ground) -> float:
    """World z of all that was seen, about."""
    return float(np.median(ground.height[ground.seen])) if ground.seen.any() else 0.0


def _blocks(values: npt.NDArray[np.floating]) -> Float64Array:
    """Sums over blocks."""
    pad = [(0, -side % BLOCK) for side in values.shape]
    wide = np.pad(values, pad)
    rows, cols = wide.shape
    sums: Float64Array = wide.reshape(rows // BLOCK, BLOCK, cols // BLOCK, BLOCK).sum(
        axis=(1, 3), dtype=np.float64
    )
    return sums


def _bilinear(values: Float64Array, row: Float64Array, col: Float64Array) -> Float32Array:
    """Values of a coarse grid at every pair of rows and columns of a fine one."""
    i = np.clip(np.floor(row).astype(np.intp), 0, max(values.shape[0] - 2, 0))
    j = np.clip(np.floor(col).astype(np.intp), 0, max(values.shape[1] - 2, 0))
    fy, fx = np.clip(row - i, 0.0, 1.0), np.clip(col - j, 0.0, 1.0)
    below, right = np.minimum(i + 1, values.shape[0] - 1), np.minimum(j + 1, values.shape[1] - 1)
    lines = values[i] * (1.0 - fy)[:, None] + values[below] * fy[:, None]
    return np.asarray(lines[:, j] * (1.0 - fx) + lines[:, right] * fx, np.float32)
