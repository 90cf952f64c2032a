"""What a map that was read means: what is free, what is open, what can be seen from where."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from dream.standin import sight
from dream.standin.eyes import Chart
from dream.standin.sight import Bool, Floats

BODY = 0.35
"""Metres: radius of the vehicle."""
STANDOFF = 0.8
"""Metres from what is black, where there is room."""
GROUP = 0.1875
"""Radius of the smallest group of targets, in reaches of the camera."""
LAUNCH = 0.4
"""Around the start, ground that is white is known to be free; in reaches of the camera."""

CRUMB = 4
"""Cells of target that are taken for one, at least."""

Ints = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """A map's cells and what follows from them. All arrays are (rows, cols), rows from the north."""

    chart: Chart
    green: Bool
    """Target."""
    black: Bool
    """Solid, target or not."""
    white: Bool
    """Unexplored."""
    open: Bool
    """White beside target that is not solid all round: there a region goes on, or may."""
    hiding: Bool
    """White around which a whole group of targets could hide."""
    room: Floats
    """Metres from the middle of each cell to the nearest that is not known to be free, or to the edge."""
    away: Floats
    """Metres to the nearest black cell."""

    @property
    def least_room(self) -> float:
        """Metres that the middle of a cell must have around it for the vehicle to be in it."""
        return BODY + 1.5 * self.chart.cell

    def at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[Ints, Ints]:
        """Rows and columns of points in the world, metres; may lie outside."""
        rows, cols = self.chart.place(np.asarray(x), np.asarray(y))  # type: ignore[arg-type]
        return np.floor(rows).astype(np.int64), np.floor(cols).astype(np.int64)

    def middle(self, cells: Ints) -> Floats:
        """(N, 2) world x and y of the middles of (N, 2) cells."""
        chart = self.chart
        return np.stack(
            [chart.west + (cells[:, 1] + 0.5) * chart.cell, chart.north - (cells[:, 0] + 0.5) * chart.cell],
            axis=1,
        )

    def look(
        self, layer: npt.NDArray[np.generic], x: npt.ArrayLike, y: npt.ArrayLike, outside: float
    ) -> Floats:
        """Values of a layer at points in the world; `outside` beyond the edge."""
        rows, cols = self.at(x, y)
        inside = (rows >= 0) & (rows < layer.shape[0]) & (cols >= 0) & (cols < layer.shape[1])
        values = layer[np.where(inside, rows, 0), np.where(inside, cols, 0)]
        return np.where(inside, values, outside)


def understand(chart: Chart) -> Ground:
    """What follows from a map."""
    cells, cell = chart.cells, chart.cell
    white = cells == sight.UNKNOWN
    black = (cells == sight.SOLID) | (cells == sight.SOLID_TARGET)
    green = (cells == sight.TARGET) | (cells == sight.SOLID_TARGET)
    free_white = _launch(chart, white)
    free = np.pad((~white | free_white) & ~black, 1)
    room = ndimage.distance_transform_edt(free)[1:-1, 1:-1] * cell
    away = ndimage.distance_transform_edt(~black) * cell if black.any() else np.full(cells.shape, np.inf)
    around = np.ones((3, 3), np.bool_)
    beside = white & ndimage.binary_dilation(green, around, iterations=2)
    places = ndimage.distance_transform_edt(np.pad(white, 1))[1:-1, 1:-1] * cell > GROUP * chart.reach
    return Ground(
        chart=chart,
        green=green,
        black=black,
        white=white,
        open=beside,
        hiding=places & ~free_white,
        room=room,
        away=away,
    )


def understand_in_space(chart: Chart, level: Chart | None) -> Ground:
    """What follows from a map that says what is inspected, and from a level cut at the vehicle's height.

    Without a cut, what is solid on the map is.
    """
    cells, cell = chart.cells, chart.cell
    white = cells == sight.UNKNOWN
    if level is None:
        black = np.isin(cells, (sight.SOLID, sight.SOLID_TARGET, sight.SOLID_INSPECTED))
        free = ~white & ~black
    else:
        free = level.cells == sight.FREE
        black = ~free & (level.cells != sight.UNKNOWN)
    green = (cells == sight.TARGET) | (cells == sight.SOLID_TARGET)
    inspected = (cells == sight.INSPECTED) | (cells == sight.SOLID_INSPECTED)
    # Crumbs are what the sensor takes for a target now and then.
    parts, count = ndimage.label(green, np.ones((3, 3)))
    large = np.bincount(parts.ravel(), minlength=count + 1) >= CRUMB
    large[0] = False
    beside = white & ndimage.binary_dilation(large[parts] | inspected, np.ones((3, 3), np.bool_))
    places = ndimage.distance_transform_edt(np.pad(white, 1))[1:-1, 1:-1] * cell > GROUP * chart.reach
    return Ground(
        chart=chart,
        green=green,
        black=black,
        white=white,
        open=beside | large[parts],
        hiding=places & ~_launch(chart, white),
        room=ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1] * cell,
        away=ndimage.distance_transform_edt(~black) * cell if black.any() else np.full(cells.shape, np.inf),
    )


def _launch(chart: Chart, white: Bool) -> Bool:
    """(rows, cols) white that is known to be free, around the start."""
    cell, launch = chart.cell, LAUNCH * chart.reach
    start = chart.trail & white
    if start.any():
        free_white = white & (ndimage.distance_transform_edt(~start) * cell < launch)
    else:
        free_white = np.zeros_like(white)
    row, col = (math.floor(v) for v in chart.place(chart.x, chart.y))
    rows, cols = np.ogrid[: white.shape[0], : white.shape[1]]
    close = np.hypot(rows - row, cols - col) * cell
    free_white |= white & (close < launch) & (not (chart.trail & ~white).any())
    return np.asarray(free_white)


def sees(ground: Ground, places: Floats, points: Floats, *, nearest: float, farthest: float) -> Bool:
    """(P, N), true where nothing black, and little white, stands between a place and a point.

    Args:
        ground: The map.
        places: (P, 2) metres in the world.
        points: (N, 2) metres in the world.
        nearest: Metres: what is nearer is not in view.
        farthest: Metres: what is farther is not trusted.
    """
    between = points[None] - places[:, None]
    far = np.hypot(between[..., 0], between[..., 1])
    possible = np.argwhere((far >= nearest) & (far <= farthest))
    clear = np.zeros(far.shape, np.bool_)
    if not len(possible):
        return clear
    start, line = places[possible[:, 0]], between[possible[:, 0], possible[:, 1]]
    blocked = ground.black.astype(np.uint8)
    free = np.ones(len(possible), np.bool_)
    pieces = max(2, math.ceil(farthest / max(0.35, ground.chart.cell)))
    for along in (np.arange(pieces) + 0.5) / pieces:
        left = np.flatnonzero(free)
        at = start[left] + along * line[left]
        free[left[ground.look(blocked, at[:, 0], at[:, 1], 1.0) > 0]] = False
    clear[possible[:, 0], possible[:, 1]] = free
    return clear
