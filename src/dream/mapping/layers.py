"""What a map holds over a window, as arrays of (rows, cols)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.geometry import Bounds
from dream.mapping._kernels import flags
from dream.mapping._kernels.flags import EDGE
from dream.mapping.blocks import BlockStore
from dream.mapping.leash import Leash, flat_water
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, Float32Array, IntArray

CELLS = ("log_odds", "flags", "votes")
"""What a map remembers of every cell."""
TRAVERSED = "traversed"
"""What it remembers beside them under a protocol with a `traversal`."""
POSTS = ("ground_sum", "ground_count")
"""What it remembers of the seabed, on a coarser grid."""
POST = 0.64
"""Metres between posts, about: as far as the seabed is smooth."""
LEVELS = 3
"""Coarser grids that fill the gaps between posts."""
MOST_CELLS = 1 << 26
"""Of a window whose layers are read, each a byte or more; a map without an end may reach farther."""
QUANTUM = 0.05
"""Log-odds that one unit of the stored bytes stands for."""


Rectangle = tuple[int, int, int, int]
"""First row and column, past row and column."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """How much a frame changes the map's mind."""

    step: float = 0.6
    """Log-odds that a cell gains in a frame with returns from the height band, and loses where the ground
    below the band was seen, or a ray passed without a return."""
    doubt: float = 0.15
    """Log-odds that it loses where the way to the ground may lead under what is solid: where that was never
    seen to reach down to the lower edge of the band, as the flare of a hull does not."""
    clamp: tuple[float, float] = (-0.3, 3.5)
    """Limits of the log-odds: so soon the map changes its mind."""
    range_noise: float = 0.002
    """Standard deviation of the depth over its square, 1/m. A hit counts the less the wider it scatters."""
    min_pixels: int = 2
    """Pixels in the height band that make a hit; fewer are taken for errors, and have no vote."""
    min_share: float = 0.05
    """Share of a cell's pixels that must be in the band for a hit."""
    peak_share: float = 0.4
    """Where the depth scatters over cells: share that a cell's hits must have of those just behind it. Fewer
    only scattered to this side of a surface; they are half a miss."""
    min_ground: int = 2
    """Pixels below the band that show a cell to be free."""
    vote_pixels: int = 1
    """Pixels that give a cell a vote on whether it is target: one vote a frame."""
    vote_share: float = 0.5
    """Share of a cell's pixels that must be target for a yes."""
    against_share: float = 0.1
    """Share of them that may be target for a no. What lies between is no vote: of a cell that is target it is
    likelier than of any other."""
    detection: float = 0.9
    """How often a target is voted one."""
    false_alarm: float = 0.02
    """How often anything else is."""
    target_prior: float = 0.05
    """Share of cells that are target, before any vote."""
    ground_pixels: float = 2.0
    """The seabed around a post weighs as much as so many of its own points in its height."""
    ground_share: float = 20.0
    """A post weighs at most as much as so many points in the height of the seabed around it."""
    ground_memory: float = 1000.0
    """Seabed points that a post remembers."""

    def __post_init__(self) -> None:
        for name in ("detection", "false_alarm", "target_prior"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ValueError(f"{name}: expected a share between 0 and 1, got {getattr(self, name)}")
        if self.detection <= self.false_alarm:
            raise ValueError(f"detection: expected more than {self.false_alarm}, got {self.detection}")
        for name in ("min_share", "peak_share", "vote_share", "against_share"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name}: expected a share of 0 to 1, got {getattr(self, name)}")
        if self.against_share > self.vote_share:
            raise ValueError(
                f"against_share: expected at most vote_share, {self.vote_share}, got {self.against_share}"
            )
        for name in (
            "min_pixels",
            "min_ground",
            "vote_pixels",
            "ground_pixels",
            "ground_share",
            "ground_memory",
        ):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected a number above 0, got {getattr(self, name)}")
        if not 0.0 <= self.range_noise < math.inf:
            raise ValueError(f"range_noise: expected 0 or more, got {self.range_noise}")
        if not self.clamp[0] < 0.0 < self.clamp[1] or max(map(abs, self.clamp)) > 127 * QUANTUM:
            raise ValueError(
                f"clamp: expected limits on both sides of 0 within ±{127 * QUANTUM}, got {self.clamp}"
            )
        for name in ("step", "doubt"):
            if not 0.0 <= getattr(self, name) <= 127 * QUANTUM:
                raise ValueError(f"{name}: expected 0 to {127 * QUANTUM}, got {getattr(self, name)}")


@lru_cache(maxsize=8)
def probability_of_votes(evidence: Evidence) -> Float32Array:
    """(256,) float32: probability of target for every byte of votes, each an independent witness (Bayes)."""
    yes, no = np.divmod(np.arange(256), 16)
    odds = (
        math.log(evidence.target_prior / (1.0 - evidence.target_prior))
        + yes * math.log(evidence.detection / evidence.false_alarm)
        + no * math.log((1.0 - evidence.detection) / (1.0 - evidence.false_alarm))
    )
    probability: Float32Array = (1.0 / (1.0 + np.exp(-odds))).astype(np.float32)
    probability.flags.writeable = False
    return probability


def post_bits(protocol: SurveyProtocol) -> int:
    """A post is 2 to this many cells wide."""
    return min(max(round(math.log2(POST / protocol.cell)), 0), 4)


def cells_of(protocol: SurveyProtocol) -> tuple[str, ...]:
    """What a map remembers of every cell under a protocol."""
    return CELLS if protocol.traversal is None else (*CELLS, TRAVERSED)


def _is_crossable(bits: npt.NDArray[np.uint8]) -> BoolArray:
    both = flags.EXPLORED | flags.BARE
    crossable: BoolArray = ((bits & flags.CROSSED) != 0) | ((bits & both) == both)
    return crossable


def cells_within(area: Bounds, origin: tuple[float, float], cell: float) -> Rectangle:
    """The cells of a store whose middles lie in a box; one on its west or south side does.

    Args:
        area: The box.
        origin: World x and y of the corner of cell (0, 0).
        cell: Side of a cell, metres.
    """
    row, col, past_row, past_col = (
        math.ceil((edge - corner) / cell - 0.5 - EDGE)
        for edge, corner in (
            (area.y_min, origin[1]),
            (area.x_min, origin[0]),
            (area.y_max, origin[1]),
            (area.x_max, origin[0]),
        )
    )
    return row, col, past_row, past_col


def room_radius(needed_room: int) -> int:
    """Cells away at which something solid may still take a cell's `room` down to what is needed."""
    return (math.isqrt(needed_room) + 1) // 2


class Layers:
    """A window of a semantic occupancy grid; every layer a read-only array that keeps its values.

    `cells[row, col]`: row grows with y, col with x, from the window's lower left corner. This is all that
    planning and drawing read of a map.
    """

    def __init__(
        self,
        store: BlockStore,
        low: tuple[int, int],
        bounds: Bounds,
        protocol: SurveyProtocol,
        evidence: Evidence,
        origin: tuple[float, float],
        datum: float,
        area: Bounds | None = None,
    ) -> None:
        """A window on a store.

        Args:
            store: The cells.
            low: Row and column in the store of the window's lower left cell.
            bounds: The window; its sides are whole numbers of cells.
            protocol: Cell size, height band and body.
            evidence: What votes mean.
            origin: World x and y of the corner where the store's cell (0, 0) begins.
            datum: World z of the seabed where nothing around was seen; NaN where nothing ever was.
            area: What has to be seen; everything where None.
        """
        self.bounds = bounds
        self.protocol = protocol
        self.evidence = evidence
        self.area = area
        self.leash: Leash | None = None
        """Beyond which the vehicle may not go; see `OccupancyMap.hold`."""
        self._store = store
        self._origin = origin
        self._low = low
        self._shape = (round(bounds.depth / protocol.cell), round(bounds.width / protocol.cell))
        self._datum = datum
        self._layers: dict[str, npt.NDArray[Any]] = {}

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self._shape

    @property
    def origin(self) -> tuple[float, float]:
        """World x and y of the corner of the map's cell (0, 0)."""
        return self._origin

    @property
    def low(self) -> tuple[int, int]:
        """Row and column in the map of this window's lower left cell."""
        return self._low

    # ------------------------------------------------------------------------------ where cells are

    def cell_of(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[IntArray, IntArray]:
        """Row and column of world positions; outside the grid where they are outside the bounds."""
        row, col = (
            np.floor((np.asarray(at, np.float64) - origin) / self.protocol.cell + EDGE).astype(np.intp) - low
            for at, origin, low in zip((y, x), self._origin[::-1], self._low, strict=True)
        )
        return row, col

    def center_of(
        self, row: npt.ArrayLike, col: npt.ArrayLike
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """World x and y of cells' centres."""
        x = self._origin[0] + (np.asarray(col) + self._low[1] + 0.5) * self.protocol.cell
        y = self._origin[1] + (np.asarray(row) + self._low[0] + 0.5) * self.protocol.cell
        return x, y

    def contains(self, x: npt.ArrayLike, y: npt.ArrayLike) -> BoolArray:
        """Whether world positions fall into a cell of the window."""
        row, col = self.cell_of(x, y)
        inside: BoolArray = (row >= 0) & (row < self.shape[0]) & (col >= 0) & (col < self.shape[1])
        return inside

    # ---------------------------------------------------------------------------------- what is known

    def _layer(self, name: str, compute: Callable[[], npt.NDArray[Any]]) -> npt.NDArray[Any]:
        if name not in self._layers:
            rows, cols = self._shape
            if rows * cols > MOST_CELLS:
                raise ValueError(
                    f"window: expected at most {MOST_CELLS} cells to be read at a time, got {rows} x {cols}. "
                    "Read parts of the map with over"
                )
            layer = compute()
            layer.flags.writeable = False
            self._layers[name] = layer
        return self._layers[name]

    def _wide(self, name: str) -> npt.NDArray[Any]:
        """A stored layer with a margin as wide as the room that is measured."""
        margin = self._room_radius
        (row, col), (rows, cols) = self._low, self._shape
        return self._layer(
            f"wide {name}",
            lambda: self._store.read(
                name, (row - margin, col - margin), (rows + 2 * margin, cols + 2 * margin)
            ),
        )

    def _cells(self, name: str) -> npt.NDArray[Any]:
        margin, (rows, cols) = self._room_radius, self._shape
        return self._wide(name)[margin : margin + rows, margin : margin + cols]

    def _flag(self, bits: int) -> BoolArray:
        marked: BoolArray = (self._cells("flags") & bits) != 0
        return marked

    @property
    def known(self) -> BoolArray:
        """Explored, crossed or solid, or some return fell in."""
        return self._layer("known", lambda: self.solid | self._flag(flags.KNOWN))

    @property
    def solid(self) -> BoolArray:
        """Something stands in the height band above the local seabed, target or not."""
        return self._layer("solid", lambda: self._cells("log_odds") > 0)

    @property
    def target(self) -> BoolArray:
        """More likely target than not."""
        return self._layer("target", lambda: self.target_probability > 0.5)

    @property
    def target_probability(self) -> Float32Array:
        """Probability that the cell is target given what was voted, float32; the prior where nothing was."""
        return self._layer(
            "target_probability", lambda: probability_of_votes(self.evidence)[self._cells("votes")]
        )

    @property
    def explored(self) -> BoolArray:
        """The paper's E_t. Never forgets."""
        return self._layer("explored", lambda: self._flag(flags.EXPLORED))

    @property
    def seen(self) -> BoolArray:
        """Explored, or seen by a return of its own.

        A ray over a low boulder shows ground that the paper's flat rays do not explore.
        """
        return self._layer("seen", lambda: self._flag(flags.EXPLORED | flags.RETURNED))

    @property
    def unseen(self) -> Float32Array:
        """Share of what lies in the cell that is still to be seen: 1 where it was not seen, 0 where it was.

        Between the two on a map on which looks may have overlooked something; see `OccupancyMap.counting`.
        """
        return self._layer("unseen", lambda: (~self.seen).astype(np.float32))

    @property
    def to_see(self) -> BoolArray:
        """In the area that has to be seen, seen or not."""
        return self._layer("to_see", self._find_to_see)

    def _find_to_see(self) -> BoolArray:
        if self.area is None:
            return np.ones(self.shape, np.bool_)
        row, col, past_row, past_col = cells_within(self.area, self._origin, self.protocol.cell)
        inside = np.zeros(self.shape, np.bool_)
        rows = slice(max(row - self.low[0], 0), max(past_row - self.low[0], 0))
        inside[rows, max(col - self.low[1], 0) : max(past_col - self.low[1], 0)] = True
        return inside

    @property
    def observed(self) -> BoolArray:
        """Seen, or outside the area: nothing is left to look for."""
        return self.seen if self.area is None else self._layer("observed", lambda: self.seen | ~self.to_see)

    @property
    def seabed_seen(self) -> BoolArray:
        """A return from below the height band, or a target, fell into the cell. Never forgets."""
        return self._layer("seabed_seen", lambda: self._flag(flags.SEABED))

    @property
    def crossed(self) -> BoolArray:
        """A ray at the vehicle's own height passed through, or the launch was there. Never forgets."""
        return self._layer("crossed", lambda: self._flag(flags.CROSSED))

    @property
    def traversed(self) -> BoolArray:
        """Its middle passed under the body, or ahead of it as near as the protocol asks. Never forgets.

        Nowhere under a protocol that asks for no traversal.
        """
        if self.protocol.traversal is None:
            return self._layer(TRAVERSED, lambda: np.zeros(self.shape, np.bool_))
        return self._layer(TRAVERSED, lambda: self._cells(TRAVERSED) != 0)

    @property
    def traversable(self) -> BoolArray:
        """Crossed, or explored and bare, and not solid.

        What only rays explored, or returns from above the band, a deck or an overhang, is left out: what
        stands there was not seen. So is bare ground that no ray explored: beside a
        hull it is seen below its flare.
        """
        return self._layer("traversable", lambda: _is_crossable(self._cells("flags")) & ~self.solid)

    @property
    def standable(self) -> BoolArray:
        """Where the vehicle's centre may be.

        Wherever inside such a cell it is, the whole disc of its body lies in bounds and on traversable
        ground (half a cell's diagonal of margin makes it so).
        """
        return self._layer("standable", lambda: self.room > self.needed_room)

    @property
    def ground(self) -> Float32Array:
        """World z of the seabed, float32 metres: a smooth surface through the seabed's points.

        Where none were, it follows from those around; where none were within some ten metres, from the
        camera's height less the protocol's altitude. NaN before the first frame.
        """
        return self._layer("ground", self._smooth_ground)

    def _smooth_ground(self) -> npt.NDArray[Any]:
        from dream.mapping._kernels import evidence as kernels

        bits = post_bits(self.protocol)
        width, coarse = 1 << bits, 1 << LEVELS
        first = [a // width for a in self._low]
        sides = [-(-(a + n) // width) - f for a, n, f in zip(self._low, self._shape, first, strict=True)]
        low = [(f // coarse - 2) * coarse for f in first]
        shape = [(-(-(f + n) // coarse) + 2) * coarse - a for f, n, a in zip(first, sides, low, strict=True)]
        pyramid = np.empty((LEVELS + 1, 3, *shape))
        for name, grid in zip(POSTS, (kernels.SUM, kernels.COUNT), strict=True):
            pyramid[0, grid] = self._store.read(name, low, shape)
        row, col = first[0] - low[0], first[1] - low[1]
        region = (row - 1, row + sides[0] + 1, col - 1, col + sides[1] + 1)
        evidence = self.evidence
        kernels.smooth_ground(
            pyramid,
            shape[0],
            shape[1],
            LEVELS,
            evidence.ground_share,
            evidence.ground_pixels,
            self._datum,
            region,
        )
        posts = pyramid[0, kernels.MEAN]
        y, x = (
            (np.arange(a, a + n) + 0.5) / width - 0.5 - b
            for a, n, b in zip(self._low, self._shape, low, strict=True)
        )
        i, j = np.floor(y).astype(np.intp), np.floor(x).astype(np.intp)
        fy, fx = (y - i)[:, None], (x - j)[None, :]
        west = posts[i][:, j] * (1.0 - fy) + posts[i + 1][:, j] * fy
        east = posts[i][:, j + 1] * (1.0 - fy) + posts[i + 1][:, j + 1] * fy
        return np.asarray(west + (east - west) * fx, np.float32)

    @property
    def distance_to_solid(self) -> Float32Array:
        """Metres between each cell's centre and the nearest solid cell's, float32; inf without one."""
        return self._layer("distance_to_solid", self._distance_to_solid)

    @property
    def distance_to_bounds(self) -> npt.NDArray[np.float64]:
        """(rows, cols) metres between each cell's centre and the nearest side of the bounds."""
        return self._layer("distance_to_bounds", self._distance_to_bounds)

    def _distance_to_bounds(self) -> npt.NDArray[Any]:
        rows, cols = np.indices(self.shape, sparse=True)
        x, y = self.center_of(rows, cols)
        bounds = self.bounds
        away: npt.NDArray[np.float64] = np.minimum(
            np.minimum(x - bounds.x_min, bounds.x_max - x), np.minimum(y - bounds.y_min, bounds.y_max - y)
        )
        return away

    @property
    def left_of_leash(self) -> npt.NDArray[np.float64]:
        """(rows, cols) metres that are left of the leash at each cell's centre, less than 0 beyond it.

        Over traversable ground where the cell is that, else straight; infinite where there is none.
        """
        return self._layer("left_of_leash", self._left_of_leash)

    def _left_of_leash(self) -> npt.NDArray[Any]:
        if self.leash is None:
            return np.full(self.shape, np.inf)
        (x, y, z), cell, bounds = self.leash.anchor, self.protocol.cell, self.bounds
        water = flat_water(self.traversable, (bounds.x_min, bounds.y_min), cell)
        first = np.array([bounds.x_min + 0.5 * cell, bounds.y_min + 0.5 * cell, z])
        lengths = self.leash.lengths(water, first, cell, (1, *self._shape))[0]
        east, north = self.center_of(*np.indices(self._shape))
        straight = np.hypot(east - x, north - y)
        return np.asarray(self.leash.metres - np.where(self.traversable, lengths, straight))

    def _distance_to_solid(self) -> npt.NDArray[Any]:
        from scipy import ndimage

        if not self.solid.any():
            return np.full(self.shape, np.inf, np.float32)
        distance: npt.NDArray[Any] = ndimage.distance_transform_edt(~self.solid, self.protocol.cell)
        return distance.astype(np.float32)

    # ------------------------------------------------------------------------- where the vehicle may be

    @property
    def needed_room(self) -> int:
        """`room` that a standable cell exceeds: body radius and half a cell's diagonal."""
        return math.floor((2.0 * self.protocol.body_radius / self.protocol.cell + math.sqrt(2.0)) ** 2 - 1e-9)

    @property
    def _room_radius(self) -> int:
        return room_radius(self.needed_room)

    @property
    def room(self) -> npt.NDArray[np.int32]:
        """Squared distance, int32 in half cells, from each cell's centre to what is not traversable.

        Measured to the nearest such cell's square, or to the outside. Beyond `needed_room` it is only known
        to be larger.
        """
        return self._layer("room", self._measure_room)

    def _measure_room(self) -> npt.NDArray[np.int32]:
        # What lies outside the map's bounds was never written: it is not traversable either.
        barrier = ~_is_crossable(self._wide("flags")) | (self._wide("log_odds") > 0)
        if self.leash is not None:
            barrier |= np.pad(self.left_of_leash < 0.0, self._room_radius, constant_values=True)
        return self._clearance(barrier)

    def _clearance(self, barrier: BoolArray) -> npt.NDArray[np.int32]:
        from dream.mapping._kernels import room

        radius, (rows, cols) = self._room_radius, self._shape
        squared: npt.NDArray[np.int32] = room.clearance(barrier, radius)
        return squared[radius : radius + rows, radius : radius + cols].copy()

    def passable(self, starts: npt.ArrayLike, ends: npt.ArrayLike) -> BoolArray:
        """Whether the vehicle may move straight from each start to its end.

        Every sample along the segment, half a cell apart, must lie in a standable cell. From a start
        that is not standable itself (a wall turned out to be nearer than thought), only a way out is
        free: its room never shrinks, and its end has more of it.

        Args:
            starts: (N, 2) metres in the world.
            ends: (N, 2) metres in the world.

        Returns:
            (N,) bool.
        """
        from dream.mapping._kernels import room

        pairs = []
        for name, points in (
            ("starts", np.asarray(starts, np.float64)),
            ("ends", np.asarray(ends, np.float64)),
        ):
            if points.ndim != 2 or points.shape[1] != 2:
                raise ValueError(f"{name}: expected (N, 2) metres, got {points.shape}")
            if not np.isfinite(points).all():
                raise ValueError(f"{name}: expected finite positions, got NaN or infinity")
            pairs.append((points - self._origin) / self.protocol.cell + EDGE)
        if len(pairs[0]) != len(pairs[1]):
            raise ValueError(f"ends: expected {len(pairs[0])}, one for every start, got {len(pairs[1])}")
        free: BoolArray = room.segments_are_free(self.room, self.needed_room, pairs[0], pairs[1], *self._low)
        return free

    def areas(self) -> dict[str, float]:
        """Square metres explored, target, solid and of seabed really seen."""
        square = self.protocol.cell**2
        layers = ("explored", "target", "solid", "seabed_seen")
        return {name: float(np.count_nonzero(getattr(self, name))) * square for name in layers}
