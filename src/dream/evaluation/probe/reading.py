"""What a map shows, measured on its cells: the right answers, where they are clear.

All measures are those of the picture: a cell is white, gray, green, black or dark green.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, Bounds
from dream.mapping import OccupancyMap
from dream.types import BoolArray

FloatArray = npt.NDArray[np.float64]

WHITE, GRAY, GREEN, BLACK, DARK_GREEN = range(5)


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """The coloured cells of a map."""

    cells: npt.NDArray[np.uint8]
    """(rows, cols) WHITE, GRAY, GREEN, BLACK or DARK_GREEN; row 0 is the southernmost."""
    bounds: Bounds
    cell: float
    """Side of a cell, metres."""

    @staticmethod
    def of(occupancy: OccupancyMap) -> Ground:
        """As the map is drawn."""
        cells = np.full(occupancy.shape, WHITE, np.uint8)
        cells[occupancy.observed] = GRAY
        cells[occupancy.target] = GREEN
        cells[occupancy.solid] = BLACK
        cells[occupancy.solid & occupancy.target] = DARK_GREEN
        return Ground(cells, occupancy.bounds, occupancy.protocol.cell)

    @property
    def target(self) -> BoolArray:
        """(rows, cols) green or dark green."""
        return np.isin(self.cells, (GREEN, DARK_GREEN))

    @property
    def solid(self) -> BoolArray:
        """(rows, cols) black or dark green."""
        return np.isin(self.cells, (BLACK, DARK_GREEN))

    @property
    def explored_share(self) -> float:
        """Share of the cells that are not white."""
        return float(np.mean(self.cells != WHITE))

    def boundary(self, *colors: int) -> BoolArray:
        """(rows, cols) cells of these colours with a white one to the east, north, west or south."""
        white = np.pad(self.cells == WHITE, 1)
        beside = white[:-2, 1:-1] | white[2:, 1:-1] | white[1:-1, :-2] | white[1:-1, 2:]
        return np.asarray(np.isin(self.cells, colors) & beside)

    def centers(self, cells: BoolArray) -> FloatArray:
        """(n, 2) metres in the world, the middles of the cells that are set."""
        row, col = np.nonzero(cells)
        x = self.bounds.x_min + (col + 0.5) * self.cell
        return np.stack([x, self.bounds.y_min + (row + 0.5) * self.cell], axis=-1)

    def index(self, points: npt.ArrayLike) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Rows and columns of the cells that hold points (N, 2), metres; the nearest for those outside."""
        x, y = np.asarray(points, np.float64).reshape(-1, 2).T
        row = np.floor((y - self.bounds.y_min) / self.cell).astype(np.intp)
        col = np.floor((x - self.bounds.x_min) / self.cell).astype(np.intp)
        return np.clip(row, 0, self.cells.shape[0] - 1), np.clip(col, 0, self.cells.shape[1] - 1)

    def distance_at(self, cells: BoolArray, points: npt.ArrayLike) -> FloatArray:
        """(N,) metres from the cells that hold points (N, 2) to the nearest one that is set."""
        return np.asarray(self.distance(cells)[self.index(points)])

    def distance(self, cells: BoolArray) -> FloatArray:
        """(rows, cols) metres from the middle of each cell to that of the nearest one that is set."""
        from scipy.ndimage import distance_transform_edt

        if not cells.any():
            return np.full(cells.shape, np.inf)
        return np.asarray(distance_transform_edt(~cells, self.cell), np.float64)

    # ------------------------------------------------------------------------------- about places

    def count_near(self, cells: BoolArray, points: npt.ArrayLike, radius: float) -> FloatArray:
        """(N,) how many cells that are set have their middle within `radius` metres of points (N, 2)."""
        from scipy.spatial import cKDTree

        middles = self.centers(cells)
        at = np.asarray(points, np.float64).reshape(-1, 2)
        if not len(middles):
            return np.zeros(len(at))
        found = cKDTree(middles).query_ball_point(at, radius, return_length=True)
        return np.asarray(found, np.float64)

    def on_the_way(self, start: SE2, points: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Along the straight lines from `start` to points (N, 2).

        Returns:
            (N,) metres in solid cells, and (N,) least metres to the middle of one.
        """
        at = np.asarray(points, np.float64).reshape(-1, 2)
        away = self.distance(self.solid)
        inside, least = np.zeros(len(at)), np.zeros(len(at))
        for k, (x, y) in enumerate(at):
            count = max(2, math.ceil(math.hypot(x - start.x, y - start.y) / PACE))
            line = np.stack([np.linspace(start.x, x, count), np.linspace(start.y, y, count)], axis=-1)
            passed = away[self.index(line)]
            inside[k], least[k] = PACE * np.count_nonzero(passed == 0.0), passed.min()
        return inside, least

    def regions(self, gap: float) -> npt.NDArray[np.intp]:
        """(rows, cols) 0 off the targets; the same number in target cells that lie within `gap` metres."""
        from scipy.ndimage import label

        joined, _ = label(self.distance(self.target) <= 0.5 * gap, np.ones((3, 3)))
        return np.asarray(np.where(self.target, joined, 0), np.intp)


PACE = 0.05
"""Metres between the looks along a straight line."""
COMPASS = ("east", "northeast", "north", "northwest", "west", "southwest", "south", "southeast")
"""Counter-clockwise from yaw 0."""
BANDS = ("less than 20 %", "20 to 40 %", "40 to 60 %", "more than 60 %")
THINGS = ("target", "explored", "unexplored", "solid")
YES_NO = ("yes", "no")

NEARER = 1.5
"""Metres by which the nearest mark is nearer than the second."""
AROUND = 3.0
"""Metres around a mark in which white ground counts."""
WHITER = 4.0
"""Square metres of white ground around a mark that the most has more than the second."""
BESIDE, NOT_BESIDE = 2.0, 3.5
"""Metres: the one mark has a boundary within the first, no other has one within the second."""
SEEN_BESIDE, HIDDEN = 1.6, 0.6
"""Metres: its boundary lies between them, so that the disc of the mark does not hide it."""
LEAST_BOUNDARY = 5
"""Cells of it."""
BLOCKED, CLEAR = 0.5, 0.5
"""Metres in solid cells on the way to the one mark; least metres to solid cells on the way to the others."""
OFF_COURSE = math.radians(10.0)
"""At most between the heading and the point of the compass that it is nearest to; 22.5 degrees would do."""
GAP, LEAST_GAP, MOST_GAP = 2.0, 1.25, 2.75
"""Metres between target cells of one region, and what may be taken for that without another answer."""
REGION_NEARER, REGION_FARTHEST = 1.5, 4.0
"""Metres that a region may be farther than the nearest one to be taken for it, and metres to it at most."""
LEAST_REGION = 12
"""Cells."""
SURROUNDED = 0.75
"""Metres around an enclosed region without a white cell."""
LEAST_OPEN = 10
"""Green cells of an open region that touch white ones."""
ALIKE = 0.6
"""Metres around a point in which all cells are what the point is."""
INSIDE_BAND = 0.04
"""Share of the area between what is explored and the ends of the band."""


@dataclass(frozen=True, slots=True)
class Contest:
    """A measure of places that only one of some marks may win."""

    strength: FloatArray
    """(N,) of each place."""
    least: float
    """Of the winner."""
    margin: float
    """That the winner is ahead of every other."""
    most: float
    """Of the others."""
    tempting: BoolArray
    """(N,) which places may be taken for the winner by mistake."""

    def rivals(self, winner: int) -> BoolArray:
        """(N,) places that clearly lose against the winner."""
        return np.asarray(self.strength <= min(self.strength[winner] - self.margin, self.most))

    @property
    def may_win(self) -> BoolArray:
        """(N,) places that win where all others lose."""
        return np.asarray(self.strength >= self.least)

    def winner(self) -> int | None:
        """The place that wins against all others; None where that is not clear."""
        best = int(np.argmax(self.strength))
        others = np.delete(self.rivals(best), best)
        return best if self.may_win[best] and bool(others.all()) else None


def nearest(ground: Ground, pose: SE2, points: FloatArray) -> Contest:
    """Which place is nearest to the robot?"""
    away = np.hypot(*(points - (pose.x, pose.y)).T)
    return Contest(-away, -math.inf, NEARER, math.inf, np.zeros(len(points), np.bool_))


def whitest(ground: Ground, pose: SE2, points: FloatArray) -> Contest:
    """Which place has the most white ground around it?"""
    area = ground.count_near(ground.cells == WHITE, points, AROUND) * ground.cell**2
    return Contest(area, WHITER, WHITER, math.inf, area > 0.0)


def open_ended(ground: Ground, pose: SE2, points: FloatArray) -> Contest:
    """Which place is beside a boundary, where targets touch white ground?"""
    # Right whether or not dark green is taken for green.
    green = ground.boundary(GREEN)
    seen = ground.count_near(green, points, SEEN_BESIDE) - ground.count_near(green, points, HIDDEN)
    some = np.minimum(ground.count_near(ground.boundary(GREEN, DARK_GREEN), points, NOT_BESIDE), 0.5)
    beside_target = ground.distance_at(ground.target, points) <= BESIDE
    return Contest(np.maximum(seen, some), LEAST_BOUNDARY, 0.0, 0.0, beside_target)


def shut_off(ground: Ground, pose: SE2, points: FloatArray) -> Contest:
    """To which place does the straight line from the robot cross something solid?"""
    inside, least = ground.on_the_way(pose, points)
    strength = np.where(least >= CLEAR, 0.0, np.maximum(inside, 0.01))
    return Contest(strength, BLOCKED, 0.0, 0.0, least <= 4.0 * CLEAR)


def heading(yaw: float) -> str | None:
    """The point of the compass; None where that is not clear."""
    eighths = yaw / (0.25 * math.pi)
    off = abs(eighths - round(eighths)) * 0.25 * math.pi
    return COMPASS[round(eighths) % 8] if off <= OFF_COURSE + 1e-9 else None


def band(ground: Ground) -> str | None:
    """How much is explored; None where that is not clear."""
    share = ground.explored_share
    k = min(int(share / 0.2), 3)
    clear = all(abs(share - end) >= INSIDE_BAND for end in (0.2, 0.4, 0.6))
    return BANDS[k] if clear else None


def thing(ground: Ground, x: float, y: float) -> str | None:
    """What is at a point; None where that is not clear."""
    row, col = ground.index([[x, y]])
    reach = math.ceil(ALIKE / ground.cell)
    if not (
        reach <= row[0] < ground.cells.shape[0] - reach and reach <= col[0] < ground.cells.shape[1] - reach
    ):
        return None
    window = np.zeros_like(ground.cells, np.bool_)
    window[row[0] - reach : row[0] + reach + 1, col[0] - reach : col[0] + reach + 1] = True
    middles = ground.centers(window)
    near = np.hypot(*(middles - (x, y)).T) <= ALIKE
    (kinds,) = (np.unique(ground.cells[ground.index(middles[near])]),)
    names = {GREEN: THINGS[0], GRAY: THINGS[1], WHITE: THINGS[2], BLACK: THINGS[3]}
    return names.get(int(kinds[0])) if len(kinds) == 1 else None


@dataclass(frozen=True, slots=True, eq=False)
class Regions:
    """The target regions of a map, and which of them are enclosed.

    A piece is the least that may be taken for a region. Where a piece is open, so is every region that
    holds it; where a region is enclosed, so is every piece of it.
    """

    middles: tuple[FloatArray, ...]
    """Of each piece, (n, 2) metres in the world, the middles of its cells."""
    enclosed: tuple[str | None, ...]
    """Of each piece, one of YES_NO; None where that is not clear."""

    @staticmethod
    def of(ground: Ground) -> Regions:
        """All of them."""
        regions, pieces = ground.regions(MOST_GAP), ground.regions(LEAST_GAP)
        green = ground.boundary(GREEN)
        whole = {n: _is_enclosed(ground, regions == n) for n in np.unique(regions[regions > 0]).tolist()}
        middles, answers = [], []
        for number in np.unique(pieces[pieces > 0]).tolist():
            piece = pieces == number
            is_open = np.count_nonzero(green & piece) >= LEAST_OPEN
            middles.append(ground.centers(piece))
            answers.append("no" if is_open else "yes" if whole[int(regions[piece][0])] else None)
        return Regions(tuple(middles), tuple(answers))

    def nearest_enclosed(self, points: FloatArray) -> list[str | None]:
        """Is the region nearest to each place (N, 2) enclosed? None where that is not clear."""
        from scipy.spatial import cKDTree

        if not self.middles:
            return [None] * len(points)
        away = np.stack([cKDTree(middles).query(points)[0] for middles in self.middles])
        first = away.min(axis=0)
        found: list[str | None] = []
        for k, near in enumerate((away <= first + REGION_NEARER).T):
            answers = {self.enclosed[piece] for piece in np.flatnonzero(near).tolist()}
            found.append(answers.pop() if len(answers) == 1 and first[k] <= REGION_FARTHEST else None)
        return found


def _is_enclosed(ground: Ground, region: BoolArray) -> bool:
    """Is there no white cell near a region or inside its outline?"""
    from scipy.ndimage import binary_fill_holes

    if np.count_nonzero(region) < LEAST_REGION:
        return False
    margin = math.ceil(MOST_GAP / ground.cell)
    window = tuple(
        slice(max(k.min() - margin, 0), k.max() + margin + 1) for k in map(np.asarray, np.nonzero(region))
    )
    part = Ground(ground.cells[window], ground.bounds, ground.cell)
    around = part.distance(region[window])
    outline = binary_fill_holes(around <= 0.5 * GAP)
    return not ((part.cells == WHITE) & ((around <= SURROUNDED) | outline)).any()
