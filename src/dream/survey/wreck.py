"""The measures of a wreck: outline, how much of the hull was seen, debris, highest point."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.mapping.hull import PATCH, Hull
from dream.protocol import SurveyProtocol
from dream.survey import patches, relief
from dream.survey.calibration import BETWEEN
from dream.survey.footprint import Footprint
from dream.survey.ground import Frame, Ground
from dream.survey.intervals import around, together, unknown
from dream.survey.survey import Individuals, Measure, Patch
from dream.types import BoolArray

Float64Array = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]

SMALLEST_PIECE = 0.25
"""Square metres: a smaller piece is no debris but may be a false target."""
BRIDGE = 0.05
"""Metres by which the radius of the closing may differ: debris whose gap to the hull is within that of being
bridged may be hull, or not."""
END = 0.05
"""Metres, standard error of a greatest distance across: of a thin end some is not seen. From wrecks of seeds
7101 and 7102; those that the other errors come from gave 2 cm."""
FOOT = 0.3
"""Metres around the hull in which the seabed is what it stands on; further off it lies deeper, scoured."""
GAP = 0.05
"""Metres around the hull in which seabed and hull may be mistaken for each other."""
CUT = 0.5
"""Metres that a wreck may reach beyond the upper edge of the image. A guess: nothing shows it."""
PIECE_TOP = 0.15
"""Metres by which the height of a piece of debris may be off. A guess."""
HIGHEST = 5
"""A piece of debris is as high as so many cells of the fine picture."""
HULL_SPREAD = 0.3
"""Share of the unseen hull by which what is expected of it may be wrong."""


@dataclass(frozen=True, slots=True)
class _Errors:
    """What a wreck's measures err by, as standard errors.

    From wrecks 1 to 5 of seed 7001 and 1 to 4 of seed 7002, which no suite and no table uses.
    """

    edge: float
    """Metres by which the outline is off all along."""
    top: float
    """Metres, of the highest point."""
    unseen: float
    """Times the hull that is expected and not seen, as the belief has it. It gives up what it looked at in
    vain, of which some is there; noise makes walls thicker, and leaves it expecting what is not."""
    seen: float
    """Of the share of the hull that was seen."""


_SHARP = _Errors(edge=0.005, top=0.02, unseen=1.6, seen=0.01)
"""For depths that hardly scatter, as in `dream-v1`."""
_SCATTERED = _Errors(edge=0.008, top=0.025, unseen=0.45, seen=0.03)
"""For depths that scatter by about 0.002 z², and labels that err, as in `dream-v1-noisy`."""


@dataclass(frozen=True, slots=True, eq=False)
class _Layout:
    """A wreck on the ground, from straight above."""

    marks: Int32Array
    """(rows, cols) 0 the hull, from 1 on the debris, −1 neither."""
    rings: tuple[tuple[Float64Array, ...], ...]
    """Outline and holes of each piece, the hull's first."""
    areas: tuple[float, ...]
    """Square metres of each."""

    @property
    def debris(self) -> float:
        """Square metres of all but the hull."""
        return math.fsum(self.areas[1:])

    @property
    def extent(self) -> float:
        """Greatest distance across it all."""
        return patches.calipers(np.concatenate([rings[0] for rings in self.rings]))[0]

    def around(self, number: int) -> float:
        """Metres along the outline of a piece."""
        return patches.perimeter(self.rings[number][:1])


def measure_wreck(
    ground: Ground, frames: Iterable[Frame], protocol: SurveyProtocol, hull: Hull | None, sigma: float
) -> tuple[tuple[Measure, ...], tuple[Patch, ...], Float64Array]:
    """Everything about a wreck.

    The outline is that of the largest piece of what was labelled target, seen from straight above, closed as
    a reef's is; every other piece of at least `SMALLEST_PIECE` is debris.

    Args:
        ground: What all frames together show.
        frames: Of the mission. They are gone through once.
        protocol: Of the mission.
        hull: The belief over its surface that planners go by in the plane, of all observations: how much of
            the hull was seen. None where that is told by a volume.
        sigma: Metres by which poses may err against each other.

    Returns:
        Measures of the whole, the hull and its debris as patches, and (rows, cols) metres above the seabed on
        the map's grid.
    """
    footprint = Footprint(ground.bounds, ground.cell, protocol, ground.scatter)
    for frame in frames:
        footprint.integrate(frame)
    cover, cell = footprint.covered(footprint.support), ground.cell
    base, above = _relief(ground, cover, round(protocol.cell / cell))
    corner = (ground.bounds.x_min, ground.bounds.y_min)
    found = _laid_out(cover, corner, cell)
    if found is None:
        seen = (("hull_seen", ""),) * (hull is not None)
        every = ("outline_area", "m2"), *seen, ("debris_extent", "m"), ("debris_area", "m2")
        every = (*every, ("highest_point", "m"))
        return tuple(unknown(name, unit, "no wreck was found") for name, unit in every), (), above
    known = _SCATTERED if ground.scatter > BETWEEN else _SHARP
    # A cell that is covered in part counts whole.
    edge = together(known.edge, 0.5 * cell, sigma)
    # Whether debris beside a hull is part of it hangs on a few centimetres, and on what one frame shows.
    others = [
        _laid_out(footprint.covered(support), corner, cell, radius=patches.CLOSING + by) or found
        for support in range(1, footprint.support + 1)
        for by in (-BRIDGE, 0.0, BRIDGE)
    ]
    area = _between(
        around("outline_area", found.areas[0], edge * found.around(0), "m2"),
        [other.areas[0] for other in others],
    )
    top = _highest(footprint, _foot(ground, found.marks), together(known.top, sigma))
    measures = (
        area,
        *((_seen_share(hull, known),) if hull is not None else ()),
        _extent(found, cover, corner, cell, together(END, sigma)),
        _debris(found, others, edge),
        top,
    )
    side = math.sqrt(2.0) * together(END, sigma)
    pieces = []
    for number, rings in enumerate(found.rings):
        length, width = patches.calipers(rings[0])
        own = around("area", found.areas[number], edge * found.around(number), "m2")
        pieces.append(
            Patch(
                rings,
                (
                    own if number else _renamed(area, "area"),
                    around("length", length, side, "m", "greatest distance across"),
                    around("width", width, side, "m", "least distance across"),
                    _height(ground, base, found.marks == number) if number else _renamed(top, "height"),
                ),
            )
        )
    return measures, tuple(pieces), above


def no_individuals() -> Individuals:
    """A wreck has none."""
    none, whole = np.zeros(0), np.zeros(0, np.int32)
    return Individuals(np.zeros((0, 3)), none, none, none, whole, whole, none, whole, np.zeros(0, np.bool_))


def _relief(ground: Ground, cover: BoolArray, times: int) -> tuple[Float64Array, Float64Array]:
    """World z of the seabed on the fine grid, and heights above it on the map's grid."""
    height = ground.height.astype(np.float64)
    level, _ = relief.averaged(height, ground.seen & ~cover, times)
    under, _ = relief.averaged(cover.astype(np.float64), np.ones_like(cover), times)
    base = relief.spanned(level, under > 0.0)
    top, _ = relief.averaged(height, ground.seen, times)
    return np.repeat(np.repeat(base, times, axis=0), times, axis=1), top - base


def _laid_out(
    cover: BoolArray,
    corner: tuple[float, float],
    cell: float,
    *,
    radius: float = patches.CLOSING,
    smallest: float = SMALLEST_PIECE,
) -> _Layout | None:
    """Hull and debris; None where nothing is large enough."""
    from scipy import ndimage

    closed = patches.closed(cover, cell, radius)
    # A deck above the camera is not seen: what an outline holds is hull. A ring of debris stays a ring.
    whole, _ = patches.parts(np.asarray(ndimage.binary_fill_holes(closed)), cell, smallest)
    hull = whole == 0
    if not hull.any():
        return None
    marks, count = patches.parts(closed & ~hull, cell, smallest)
    marks[marks >= 0] += 1
    marks[hull] = 0
    rings: list[tuple[Float64Array, ...]] = []
    areas: list[float] = []
    for number in range(count + 1):
        own = marks == number
        rows, cols = (np.flatnonzero(own.any(axis=axis)) for axis in (1, 0))
        box = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        rings.append(patches.rings(own[box], (corner[0] + cols[0] * cell, corner[1] + rows[0] * cell), cell))
        areas.append(float(np.count_nonzero(own)) * cell * cell)
    return _Layout(marks, tuple(rings), tuple(areas))


def _between(told: Measure, others: Sequence[float]) -> Measure:
    """A measure that may as well be one of the others, with the same error."""
    assert told.value is not None
    assert told.low is not None
    assert told.high is not None
    low = told.low - max(told.value - min(others), 0.0)
    high = told.high + max(max(others) - told.value, 0.0)
    return Measure(told.name, told.value, max(low, 0.0), high, told.unit, told.note)


def _extent(
    found: _Layout, cover: BoolArray, corner: tuple[float, float], cell: float, error: float
) -> Measure:
    """A piece at the far end that hardly counts as debris, or hardly does not, is metres of extent."""
    fewer, more = (
        _laid_out(cover, corner, cell, smallest=times * SMALLEST_PIECE) or found for times in (2.0, 0.5)
    )
    told = around("debris_extent", found.extent, error, "m", "greatest distance across hull and debris")
    return _between(told, (fewer.extent, more.extent))


def _debris(found: _Layout, others: Sequence[_Layout], edge: float) -> Measure:
    rim = math.fsum(found.around(number) for number in range(1, len(found.rings)))
    told = around("debris_area", found.debris, together(edge * rim, 0.5 * SMALLEST_PIECE), "m2")
    return _between(told, [other.debris for other in others])


def _foot(ground: Ground, marks: Int32Array) -> float:
    """World z of the seabed around the hull; NaN where none was seen."""
    from scipy import ndimage

    away = ndimage.distance_transform_edt(marks != 0, ground.cell)
    bare = ground.seen & (ground.share == 0.0) & (marks < 0)
    near = bare & (away > GAP) & (away <= FOOT)
    return float(np.median(ground.height[near])) if near.any() else math.nan


def _highest(footprint: Footprint, foot: float, error: float) -> Measure:
    top = footprint.top
    if top is None or math.isnan(foot):
        return unknown("highest_point", "m", "too little of it was seen with seabed beside it")
    height, note = top.sure - foot, "above the seabed around"
    if top.cut:
        note += "; the edge of the image cuts it off, it may be higher"
    told = around("highest_point", height, together(error, top.error), "m", note)
    return _between(told, (height, height + (CUT if top.cut else 0.0)))


def _height(ground: Ground, base: Float64Array, piece: BoolArray) -> Measure:
    """Of a piece of debris."""
    heights = (ground.height - base)[piece]
    heights = np.sort(heights[np.isfinite(heights)])
    if len(heights) < HIGHEST:
        return unknown("height", "m", "too little of it was seen with seabed beside it")
    return around("height", float(heights[-HIGHEST]), PIECE_TOP, "m", "above the seabed around")


def _seen_share(hull: Hull, known: _Errors) -> Measure:
    unseen = known.unseen * hull.unseen
    total = hull.found + unseen
    if total <= 0.0:
        return unknown("hull_seen", "", "no hull was seen")
    share, rest = hull.found / total, unseen / total
    error = together(HULL_SPREAD * rest, rest / math.sqrt(max(unseen, 1.0)), known.seen)
    note = f"about {total:.0f} patches of {PATCH:g} m, {unseen:.0f} of them expected and not seen"
    told = around("hull_seen", share, error, "", note)
    return Measure(told.name, share, told.low, min(1.0, told.high or 1.0), "", note)


def _renamed(measure: Measure, name: str) -> Measure:
    return Measure(name, measure.value, measure.low, measure.high, measure.unit, measure.note)
