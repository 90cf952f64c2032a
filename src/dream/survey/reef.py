"""The measures of an oyster reef: area and patches, height, density of individuals, sizes.

Definitions after Baggett et al. 2014, *Oyster Habitat Restoration Monitoring and Assessment Handbook*, and
as docs/survey-measures.md says them exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.mapping import Layers as MapLayers
from dream.protocol import SurveyProtocol
from dream.survey import individuals, patches, relief
from dream.survey.calibration import Calibration, calibration_for
from dream.survey.ground import Frame, Ground
from dream.survey.individuals import Peaks
from dream.survey.intervals import around, in_ratio, together, unknown
from dream.survey.sizes import sizes_of
from dream.survey.survey import Individuals, Measure, Patch
from dream.types import BoolArray

Float64Array = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]

FINE = 0.05
"""Metres: the cells that patches are drawn in, about."""
SURE = 0.5
"""Share of the views that take a cell for target, from which it is."""
REACHES_ON = 0.75
"""Metres over which a reef is half as likely to go on into ground that was not seen, about."""
WANDER = 3.0
"""Metres along an outline over which errors of the pose move it alike."""
STEEPEST = 0.2
"""Slope of a seabed on which what errs over ground errs in height, at most."""
HIGHEST_SPREAD = 0.06
"""Share by which the highest percent of a reef may be off: few cells make it."""
NONE_FOUND = 3.0 / 1.96
"""Standard error of a count of none: three may be there and be missed, as the rule of three has it."""


@dataclass(frozen=True, slots=True, eq=False)
class Reef:
    """All of a reef that a survey tells."""

    measures: tuple[Measure, ...]
    patches: tuple[Patch, ...]
    individuals: Individuals
    height: Float64Array
    """(rows, cols) metres above the seabed on the map's grid; NaN where nothing was seen."""


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """What is read off the fine picture of the ground, before any correction."""

    corner: tuple[float, float]
    """x and y of the lower left corner of `marks`."""
    cell: float
    """Metres, of `marks`."""
    marks: Int32Array
    """(rows, cols) the patch of a cell, −1 for none."""
    count: int
    """Patches."""
    peaks: Peaks
    patch: Int32Array
    """(N,) the patch of each peak; −1 for none."""
    hits: Int32Array
    looks: Int32Array
    sure: Float64Array
    """(N,) probability that a peak is an individual."""
    heights: relief.Relief
    rugosity: float | None
    """Chain ratio of what was seen of the reef."""

    @property
    def reef(self) -> BoolArray:
        """(rows, cols) is it reef?"""
        return self.marks >= 0

    @property
    def above(self) -> Float64Array:
        """(M,) metres above the seabed of the cells of the map that are reef, as far as they were seen."""
        share = _reduced(self.reef, self.heights.above.shape)
        above = self.heights.above[share > 0.5]
        return above[np.isfinite(above)]


def read(ground: Ground, frames: Sequence[Frame], protocol: SurveyProtocol) -> Reading:
    """Patches, peaks and heights as they show.

    Args:
        ground: What all frames together show.
        frames: To look for each individual in.
        protocol: Of the mission.
    """
    times = max(1, round(FINE / ground.cell))
    cell = times * ground.cell
    cover = _any(ground.seen & (ground.share >= SURE), times)
    marks, count = patches.parts(patches.closed(cover, cell), cell)
    corner = (ground.bounds.x_min, ground.bounds.y_min)
    peaks = individuals.peaks(ground)
    patch = _at(marks, peaks, corner, cell)
    hits, looks = individuals.recognised(peaks, frames, protocol)
    links = max(1, round(relief.CHAIN / ground.cell))
    level, _ = relief.averaged(ground.height.astype(np.float64), ground.seen, links)
    return Reading(
        corner=corner,
        cell=cell,
        marks=marks,
        count=count,
        peaks=peaks,
        patch=patch,
        hits=hits,
        looks=looks,
        sure=individuals.confidence(hits, looks, patch >= 0),
        heights=_heights(ground, marks >= 0, cell, protocol.cell),
        rugosity=relief.chain_ratio(level, _reduced(marks >= 0, level.shape) > 0.5),
    )


def measure_reef(
    ground: Ground,
    frames: Sequence[Frame],
    occupancy: MapLayers,
    sigma: float,
    calibration: Calibration | None = None,
) -> Reef:
    """Everything about a reef.

    Args:
        ground: What all frames together show.
        frames: To look for each individual in.
        occupancy: The mission's map, over the bounds of `ground`.
        sigma: Metres by which poses may err against each other.
        calibration: That of the depths' scatter unless given.
    """
    calibration = calibration or calibration_for(ground.scatter)
    seen = read(ground, frames, occupancy.protocol)
    peaks, patch = seen.peaks, seen.patch
    sizes = sizes_of(peaks, seen.sure, patch >= 0, calibration)
    worth = np.where(patch >= 0, seen.sure * individuals.stands_for(peaks, sizes.typical, calibration), 0.0)
    shapes = [
        _shape(number, seen, worth[patch == number], sigma, calibration) for number in range(seen.count)
    ]
    measures = _totals(shapes, worth, _unseen(seen, occupancy), sigma, calibration)
    measures += sizes.measures()
    outline = math.fsum(shape.perimeter for shape in shapes)
    measures += _relief_measures(seen, _height_error(seen, outline, sigma, calibration), calibration)
    error = together(sigma, ground.cell) + ground.scatter * peaks.nearest**2
    found = Individuals(
        position=peaks.position,
        sigma=error,
        size=sizes.size,
        size_sigma=sizes.error,
        clear=sizes.clear,
        hits=seen.hits,
        looks=seen.looks,
        confidence=seen.sure,
        patch=patch,
    )
    return Reef(
        measures,
        tuple(Patch(shape.rings, shape.measures) for shape in shapes),
        found,
        seen.heights.above,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """One patch."""

    rings: tuple[Float64Array, ...]
    area: float
    perimeter: float
    count: float
    measures: tuple[Measure, ...]


def _shape(number: int, seen: Reading, worth: Float64Array, sigma: float, calibration: Calibration) -> _Shape:
    corner, cell, heights = seen.corner, seen.cell, seen.heights
    mask = seen.marks == number
    rows, cols = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    low = (int(rows[0]), int(cols[0]))
    box = np.s_[low[0] : rows[-1] + 1, low[1] : cols[-1] + 1]
    rings = patches.rings(mask[box], (corner[0] + low[1] * cell, corner[1] + low[0] * cell), cell)
    outline = patches.perimeter(rings)
    inside = float(np.count_nonzero(mask)) * cell * cell
    area = max(inside + calibration.edge * outline, 0.25 * inside)
    own = calibration.edge_wander * math.sqrt(outline)
    error = together(_area_error(outline, cell, sigma, calibration), own)
    length, width = patches.calipers(rings[0])
    side = together(2.0 * calibration.edge_spread, sigma, cell)
    count = float(worth.sum())
    count_error = _count_error(worth, calibration)
    ratio = together(count_error, error / area)
    above = heights.above[_reduced(mask, heights.above.shape) > 0.5]
    above = above[np.isfinite(above)]
    measures = [
        around("area", area, error, "m2"),
        around("length", length + 2.0 * calibration.edge, side, "m", "greatest distance across"),
        around("width", width + 2.0 * calibration.edge, side, "m", "least distance across"),
        _height("height", above, _height_error(seen, outline, sigma, calibration), calibration),
        in_ratio("density", count / area, ratio, "1/m2")
        if count
        else around("density", 0.0, NONE_FOUND / area, "1/m2"),
        in_ratio("count", count, count_error, "") if count else around("count", 0.0, NONE_FOUND, ""),
    ]
    return _Shape(rings, area, outline, count, tuple(measures))


def _totals(
    shapes: Sequence[_Shape], worth: Float64Array, unseen: float, sigma: float, calibration: Calibration
) -> tuple[Measure, ...]:
    """Of the whole reef: area, patches, count, density."""
    area, outline = (math.fsum(getattr(shape, name) for shape in shapes) for name in ("area", "perimeter"))
    if not shapes:
        none = "no patch of reef was found"
        return (
            around("reef_area", 0.0, 0.5 * patches.SMALLEST + unseen, "m2", none),
            # One of just the least area may have been passed over, and what stands on it.
            Measure("patch_count", 0.0, 0.0, 1.0, "", none),
            unknown("density", "1/m2", none),
            around("count", 0.0, NONE_FOUND, "", none),
        )
    error = _area_error(outline, FINE, sigma, calibration)
    count = float(worth.sum())
    # The parts that were not seen are as likely to be there as not, and as densely grown.
    share = unseen / (area + unseen)
    count_error = _count_error(worth, calibration)
    density = count / area
    doubtful = sum(shape.area < 1.5 * patches.SMALLEST for shape in shapes)
    note = f"{unseen:.1f} square metres of it not seen but likely" if unseen >= 0.05 else ""
    if count == 0.0:
        # A ratio of nothing has no width.
        told = around("density", 0.0, NONE_FOUND / area, "1/m2"), around("count", 0.0, NONE_FOUND, "")
    else:
        told = (
            in_ratio("density", density, together(count_error, error / area), "1/m2"),
            in_ratio("count", count + density * unseen, together(count_error, share), ""),
        )
    return (
        around("reef_area", area + unseen, together(error, unseen), "m2", note),
        Measure("patch_count", float(len(shapes)), float(len(shapes) - doubtful), float(len(shapes) + 1), ""),
        *told,
    )


def _area_error(outline: float, cell: float, sigma: float, calibration: Calibration) -> float:
    """Square metres: the outline may be off all along, wander with the poses, and end anywhere in a cell."""
    return together(
        calibration.edge_spread * outline,
        sigma * math.sqrt(outline * WANDER),
        cell / math.sqrt(12.0) * math.sqrt(outline * cell),
    )


def _count_error(worth: Float64Array, calibration: Calibration) -> float:
    """Of the logarithm of a count: of the capture model, and of chance where few were found."""
    total = float(worth.sum())
    chance = float((worth * np.maximum(worth - 1.0, 0.1)).sum())
    return together(calibration.capture_spread, math.sqrt(chance) / max(total, 1.0))


def _heights(ground: Ground, reef: BoolArray, cell: float, post: float) -> relief.Relief:
    """Heights on the map's grid above the membrane through the bare seabed."""
    times = round(post / ground.cell)
    level, _ = relief.averaged(ground.height.astype(np.float64), ground.seen, times)
    rows, cols = level.shape
    near = _grown(reef, relief.RIM, cell)
    under = _reduced(near, (rows, cols)) > 0.0
    base = relief.spanned(level, under)
    return relief.Relief(base, level - base, post)


def _relief_measures(seen: Reading, error: float, calibration: Calibration) -> tuple[Measure, ...]:
    above = seen.above
    measures = [_height("reef_height", above, error, calibration)]
    if len(above) >= 4:
        highest = calibration.relief * float(np.quantile(above, 0.99))
        spread = together(HIGHEST_SPREAD * highest, error)
        measures.append(around("reef_height_max", highest, spread, "m", "1 % of it is higher"))
    if seen.rugosity is None:
        measures.append(unknown("rugosity", "", "too little of the reef's surface was seen"))
    else:
        excess = calibration.rugosity * (seen.rugosity - 1.0)
        told = in_ratio("rugosity", excess, calibration.rugosity_spread, "")
        assert told.low is not None
        assert told.high is not None
        note = f"chain ratio, links of {relief.CHAIN:g} m"
        measures.append(Measure("rugosity", 1.0 + excess, 1.0 + told.low, 1.0 + told.high, "", note))
    return tuple(measures)


def _height(name: str, above: Float64Array, error: float, calibration: Calibration) -> Measure:
    if len(above) < 4:
        return unknown(name, "m", "less than a square metre of it was seen with seabed beside it")
    mean = calibration.relief * float(above.mean())
    return around(name, mean, error, "m", "mean above the seabed around", least=-math.inf)


def _height_error(seen: Reading, outline: float, sigma: float, calibration: Calibration) -> float:
    """Metres: the seabed that holds the membrane begins anywhere in a cell of the map, all along the rim."""
    stretches = max(outline / WANDER, 1.0)
    resolution = STEEPEST * seen.heights.cell / math.sqrt(12.0 * stretches)
    return together(calibration.relief_spread, resolution, STEEPEST * sigma)


def _unseen(seen: Reading, occupancy: MapLayers) -> float:
    """Square metres of reef to be expected where nothing was seen: the likelier the nearer to reef."""
    from scipy import ndimage

    reef = seen.reef
    hidden = occupancy.to_see & ~occupancy.known
    if not reef.any() or not hidden.any():
        return 0.0
    side = occupancy.protocol.cell
    within = _reduced(reef, hidden.shape) > 0.0
    away = ndimage.distance_transform_edt(~within, side)
    chance = np.where(hidden & ~within, 0.5 * np.exp(-away / REACHES_ON), 0.0)
    return float(chance.sum()) * side * side


def _at(marks: Int32Array, peaks: Peaks, corner: tuple[float, float], cell: float) -> Int32Array:
    """(N,) the patch that each peak lies in."""
    col, row = np.floor((peaks.position[:, :2] - corner) / cell).astype(np.intp).T
    row, col = np.clip(row, 0, marks.shape[0] - 1), np.clip(col, 0, marks.shape[1] - 1)
    return np.asarray(marks[row, col], np.int32)


def _grown(mask: BoolArray, radius: float, cell: float) -> BoolArray:
    from scipy import ndimage

    if not mask.any():
        return mask
    near: BoolArray = ndimage.distance_transform_edt(~mask, cell) <= radius
    return near


def _any(fine: BoolArray, times: int) -> BoolArray:
    """Squares of cells of which any is set."""
    return _sums(fine, times) > 0.0


def _sums(fine: BoolArray, times: int) -> Float64Array:
    pad = [(0, -side % times) for side in fine.shape]
    wide = np.pad(fine, pad)
    rows, cols = wide.shape
    sums: Float64Array = wide.reshape(rows // times, times, cols // times, times).sum(
        axis=(1, 3), dtype=np.float64
    )
    return sums


def _reduced(fine: BoolArray, shape: tuple[int, ...]) -> Float64Array:
    """Share of each cell of a coarser grid over the same ground that is set."""
    times = max(1, round(fine.shape[0] / shape[0]))
    if fine.shape[0] < shape[0]:
        times_up = round(shape[0] / fine.shape[0])
        up = np.repeat(np.repeat(fine, times_up, axis=0), times_up, axis=1)
        return up[: shape[0], : shape[1]].astype(np.float64)
    share = _sums(fine, times) / (times * times)
    full = np.zeros(shape)
    rows, cols = min(shape[0], share.shape[0]), min(shape[1], share.shape[1])
    full[:rows, :cols] = share[:rows, :cols]
    return full
