"""The measures of a wreck: outline, how much of the hull was seen, debris, highest point."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from dream.mapping import Layers as MapLayers
from dream.planning.hull import PATCH, Hull
from dream.survey import patches, relief
from dream.survey.calibration import calibration_for
from dream.survey.ground import Ground
from dream.survey.intervals import around, together, unknown
from dream.survey.survey import Individuals, Measure, Patch
from dream.types import Observation

Float64Array = npt.NDArray[np.float64]

SMALLEST_PIECE = 0.25
"""Square metres: a smaller piece is no debris but may be a false target."""
EDGE = 0.08
"""Metres by which an outline may be off all along: a flare hides the foot of a hull, and depths that scatter
thicken its walls. Seen on a few simulated wrecks, not calibrated."""
APART = 0.5
"""Share of the debris that may be taken for hull or the other way round, or not be seen."""
TOP = 0.15
"""Metres by which the highest point may be off: thin fittings are seen in part."""
LEAST_UNSEEN = 0.02
"""Share of a hull that may be hidden where nothing is expected to be."""
DISTANCE = 10.0
"""Metres: how far off the top of a hull is where it is in the image, about."""
HIGHEST = 5
"""The highest point is as high as so many cells of the fine picture."""
HULL_SPREAD = 0.5
"""Share of the unseen hull by which what is expected of it may be wrong."""


def measure_wreck(
    ground: Ground, observations: Iterable[Observation], occupancy: MapLayers, sigma: float
) -> tuple[tuple[Measure, ...], tuple[Patch, ...], Float64Array]:
    """Everything about a wreck.

    The outline is that of the largest piece of what was labelled target, seen from straight above, closed as
    a reef's is; every other piece of at least `SMALLEST_PIECE` is debris. How much of the hull was seen
    comes from the belief over its surface that planners go by (`planning.hull`).

    Args:
        ground: What all frames together show.
        observations: Of the mission.
        occupancy: The mission's map, over the bounds of `ground`.
        sigma: Metres by which poses may err against each other.

    Returns:
        Measures of the whole, the hull and its debris as patches, and (rows, cols) metres above the seabed on
        the map's grid.
    """
    from scipy import ndimage

    calibration, cell = calibration_for(ground.scatter), ground.cell
    times = round(occupancy.protocol.cell / cell)
    covered = ground.seen & (ground.share >= 0.5)
    level, _ = relief.averaged(ground.height.astype(np.float64), ground.seen & ~covered, times)
    under, _ = relief.averaged(covered.astype(np.float64), np.ones_like(covered), times)
    base = relief.spanned(level, under > 0.0)
    top, _ = relief.averaged(ground.height.astype(np.float64), ground.seen, times)
    above = top - base
    marks, count = patches.parts(patches.closed(covered, cell), cell, SMALLEST_PIECE)
    if count == 0:
        none = "no wreck was found"
        names = (("outline_area", "m2"), ("hull_seen", ""), ("debris_extent", "m"), ("highest_point", "m"))
        return tuple(unknown(name, unit, none) for name, unit in names), (), above
    corner = (ground.bounds.x_min, ground.bounds.y_min)
    pieces, outlines = [], []
    fine = np.repeat(np.repeat(base, times, axis=0), times, axis=1)
    edge = together(EDGE, sigma)
    for number in range(count):
        mask = marks == number
        rows, cols = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
        box = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        # A deck above the camera is not seen: what the outline holds is hull.
        mask[box] = ndimage.binary_fill_holes(mask[box])
        rings = patches.rings(mask[box], (corner[0] + cols[0] * cell, corner[1] + rows[0] * cell), cell)
        outlines.append(rings)
        outline = patches.perimeter(rings[:1])
        area = float(np.count_nonzero(mask)) * cell * cell + calibration.edge * outline
        length, width = patches.calipers(rings[0])
        heights = (ground.top - fine)[mask & (ground.top > -math.inf)]
        heights = np.sort(heights[np.isfinite(heights)])
        side = math.sqrt(2.0) * edge
        pieces.append(
            Patch(
                rings,
                (
                    around("area", area, edge * outline, "m2"),
                    around("length", length, side, "m", "greatest distance across"),
                    around("width", width, side, "m", "least distance across"),
                    _highest("height", heights, ground),
                ),
            )
        )
    hull = _renamed(pieces[0].measures[0], "outline_area"), _renamed(pieces[0].measures[3], "highest_point")
    points = np.concatenate([rings[0] for rings in outlines])
    extent, _ = patches.calipers(points)
    debris = sum(float(piece.measures[0].value or 0.0) for piece in pieces[1:])
    measures = (
        hull[0],
        _seen_share(observations, occupancy),
        around("debris_extent", extent, 2.0 * edge, "m", "greatest distance across hull and debris"),
        around("debris_area", debris, together(APART * debris, patches.SMALLEST), "m2"),
        hull[1],
    )
    return measures, tuple(pieces), above


def no_individuals() -> Individuals:
    """A wreck has none."""
    none, whole = np.zeros(0), np.zeros(0, np.int32)
    return Individuals(np.zeros((0, 3)), none, none, none, whole, whole, none, whole, np.zeros(0, np.bool_))


def _highest(name: str, heights: Float64Array, ground: Ground) -> Measure:
    if len(heights) < HIGHEST:
        return unknown(name, "m", "too little of it was seen with seabed beside it")
    # The greatest of many depths that scatter is too great; a few cells are passed over for it.
    passed = HIGHEST if ground.scatter < 5e-4 else max(HIGHEST, round(0.002 * len(heights)))
    error = together(TOP, 2.0 * ground.scatter * DISTANCE**2)
    return around(name, float(heights[-min(passed, len(heights))]), error, "m", "above the seabed around")


def _seen_share(observations: Iterable[Observation], occupancy: MapLayers) -> Measure:
    hull = Hull(occupancy.bounds, occupancy.protocol)
    for seen in observations:
        hull.integrate(seen)
    total = hull.found + hull.unseen
    if total <= 0.0:
        return unknown("hull_seen", "", "no hull was seen")
    share, rest = hull.found / total, hull.unseen / total
    error = together(HULL_SPREAD * rest, rest / math.sqrt(max(hull.unseen, 1.0)), LEAST_UNSEEN)
    note = f"about {total:.0f} patches of {PATCH:g} m, {hull.unseen:.0f} of them expected and not seen"
    told = around("hull_seen", share, error, "", note)
    return Measure(told.name, share, told.low, min(1.0, told.high or 1.0), "", note)


def _renamed(measure: Measure, name: str) -> Measure:
    return Measure(name, measure.value, measure.low, measure.high, measure.unit, measure.note)
