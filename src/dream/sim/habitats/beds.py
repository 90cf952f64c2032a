"""Reefs that lie flat on the bed: beds that cover most of it, with holes in them, along a border; carpets.

How much of a ground they cover: of the public oyster grounds of the James River 17.1 % were consolidated
reef and 47.5 % shell with mud or sand (Haven and Whitcomb 1983, J. Shellfish Res. 3: 141-151). How high old
shell lies: reefs that were built 8 to 12 cm and 25 to 45 cm high (Schulte et al. 2009, Science 325:
1124-1128). How dense they are: a bed of flat oysters is what has 5 to the square metre or more (OSPAR), a
clump is 5 to 10 oysters (EUNIS MB243), and grounds that are harvested keep 2 to 11 to the square metre
(VIMS, of the same study).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dream.geometry import Bounds
from dream.sim.habitats.arena import Arena
from dream.sim.habitats.growth import Bottom, Crust, Places, islands, spread
from dream.sim.sampling import Float64Array, between, directions, quantised, steady, uniform, uniforms
from dream.sim.terrain import APRON, SPACING, Noise, smoothstep

BED = 0.5, 13.0
"""Clumps to the square metre of a bed: 5 flat oysters at 10 to a clump, up to what dream-v1's reefs have."""
CARPET = 0.2, 1.0
"""Clumps to the square metre of a carpet: 1 to 10 oysters, as on harvested ground. Flat oysters of Strangford
Lough breed well where the next lies within 1.5 m (Guy et al. 2018, doi 10.1017/S0025315418000395): with 0.2
clumps to the square metre strewn at random, the next is 1.1 m off on average."""
HEIGHT = 0.08, 0.45
"""Metres that old shell raises a bed."""
DENSE = 0.52, 0.7
"""Share of an arena that a dense bed covers, before its smallest islands go."""
SPARSE = 0.25, 0.5
"""Likewise a carpet."""
LARGE = 0.35, 0.6
"""Likewise reefs with holes, and their holes."""
CUT = 0.2, 0.45
"""Likewise reefs that walls cut."""
HOLE = 2.0, 6.0
"""Metres across: bare holes. Our choice, between the bare spots of a crust and the gaps between two reefs; we
found no measured sizes."""
RAGGED = 0.1
"""Share by which a hole is wider here, narrower there."""
HOLE_EVERY = 45.0, 120.0
"""Square metres of reef to one hole."""
RIM = 1.5
"""Least metres of reef between two holes."""
BORDERS = 1, 3
WIDTH = 3.0, 9.0
"""Metres that a reef along a border reaches into the arena where it is widest: our choice, a string or fringe
of dream-v1 or half a large patch."""
FULL = 0.25
"""Of the field's unit: from the edge of a bed to its full density."""


@dataclass(frozen=True, slots=True, eq=False)
class Beds:
    """Beds where a smooth random field is high, without some circles and what is near some lines."""

    limit: Bounds
    """They end there, where their part of an arena does."""
    field: Noise
    grain: Noise
    level: float
    """Of the field, above which a bed lies."""
    holes: Float64Array
    """(H, 3) circles x, y, radius, more or less."""
    lines: Float64Array
    """(L, 5) segments x, y to x, y and the metres from them that stay bare."""
    crust: Crust
    density: tuple[float, float]
    height: float
    group_radius: float

    def value(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """The field, its outline ragged."""
        return 0.8 * self.field.at(x, y) + 0.2 * self.grain.at(x, y)

    def share(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """1 well inside a bed, 0 off it."""
        share = smoothstep(self.level, self.level + FULL, self.value(x, y))
        inner = np.minimum(
            np.minimum(x - self.limit.x_min, self.limit.x_max - x),
            np.minimum(y - self.limit.y_min, self.limit.y_max - y),
        )
        share[inner < 0.0] = 0.0
        ragged = np.ones_like(share)
        if len(self.holes):
            ragged = np.square(1.0 + RAGGED * np.clip(self.grain.at(x, y), -1.0, 1.0))
        for east, north, radius in self.holes:
            share[np.square(x - east) + np.square(y - north) < radius * radius * ragged] = 0.0
        for ax, ay, bx, by, bare in self.lines:
            share[to_segment(x, y, ax, ay, bx, by) < bare] = 0.0
        return share

    def relief(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """Old shell, its edges no steeper than one in two."""
        return shell(self.share(x, y) > 0.0, self.height, self.crust.rough(x, y))

    def kept_free(self) -> Float64Array:
        """Nothing: boulders stand in beds, too."""
        return np.empty((0, 3))

    def places(self, bottom: Bottom, most: int, rng: np.random.Generator) -> Places:
        """All over the beds."""
        return spread(self, self.crust, self.density, self.group_radius, bottom, most, rng)


def to_segment(x: Float64Array, y: Float64Array, ax: float, ay: float, bx: float, by: float) -> Float64Array:
    """Metres from each place to the straight line between two points."""
    length = math.hypot(bx - ax, by - ay)
    ux, uy = (bx - ax) / length, (by - ay) / length
    t = np.clip((x - ax) * ux + (y - ay) * uy, 0.0, length)
    return np.asarray(np.sqrt(np.square(x - ax - t * ux) + np.square(y - ay - t * uy)))


def shell(reef: np.typing.NDArray[np.bool_], height: float, rough: Float64Array) -> Float64Array:
    """(N, M) metres that old shell raises the bed where `reef` is, on the grid of the seabed."""
    from scipy import ndimage

    if height == 0.0:
        return np.zeros(reef.shape)
    inside = steady(ndimage.distance_transform_edt(reef)) * SPACING
    # A cubic step is half as steep again in its middle.
    return smoothstep(0.0, max(0.8, 3.0 * height), inside) * np.maximum(height + rough, 0.02)


def beds_in(
    arena: Arena,
    region: Bounds,
    cover: tuple[float, float],
    pitch: tuple[float, float],
    density: tuple[float, float],
    height: tuple[float, float],
    group_radius: float,
    rng: np.random.Generator,
    *,
    bare: float = 0.03,
) -> Beds:
    """Beds in a part of an arena.

    Args:
        arena: Where.
        region: The part.
        cover: Share of it that they cover, from least to most.
        pitch: Metres between the knots of the field that they follow, from least to most; a bed is about two
            of these across.
        density: Clumps to the square metre, from least to most.
        height: Metres that they rise, from least to most.
        group_radius: Metres; smaller islands are left out.
        rng: Source of it all.
        bare: See `Crust`.
    """
    box = arena.bounds.widened(APRON)
    beds = Beds(
        # In a whole arena, the reef goes on beyond the border, and its shell with it.
        box if region == arena.bounds else region,
        Noise.over(box, uniform(rng, *pitch), rng),
        Noise.over(box, 2.0, rng),
        0.0,
        np.empty((0, 3)),
        np.empty((0, 5)),
        Crust.over(box, bare, rng),
        density,
        uniform(rng, *height),
        group_radius,
    )
    return _leveled(beds, region, uniform(rng, *cover))


def _leveled(beds: Beds, region: Bounds, cover: float) -> Beds:
    """With its level where that share of the region lies higher."""
    x = region.x_min + (np.arange(round(region.width / SPACING), dtype=np.float64) + 0.5) * SPACING
    y = region.y_min + (np.arange(round(region.depth / SPACING), dtype=np.float64) + 0.5) * SPACING
    values = np.sort(beds.value(x[None, :], y[:, None]), axis=None)
    level = float(quantised(values[int((1.0 - cover) * (len(values) - 1))], 1_000_000))
    return replace(beds, level=level)


def holed(beds: Beds, bounds: Bounds, rng: np.random.Generator) -> Beds:
    """The same beds with bare holes in them, inside those bounds, each with reef all around it."""
    label = islands(beds, bounds, beds.group_radius)
    squares = np.argwhere(label > 0)
    wanted = max(round(len(squares) * SPACING * SPACING / uniform(rng, *HOLE_EVERY)), 1)
    found = np.empty((0, 3))
    for _ in range(40 * wanted):
        if len(found) == wanted:
            break
        row, col = squares[int(rng.random() * len(squares))]
        x = bounds.x_min + (col + 0.5) * SPACING
        y = bounds.y_min + (row + 0.5) * SPACING
        radius = 0.5 * uniform(rng, HOLE[0] / (1.0 - RAGGED), HOLE[1] / (1.0 + RAGGED))
        apart = np.sqrt(np.square(found[:, 0] - x) + np.square(found[:, 1] - y)) - found[:, 2] - radius
        if (apart >= RIM).all() and _surrounded(label, row, col, radius + 0.75):
            found = np.concatenate([found, quantised([[x, y, radius]], 1000)])
    return replace(beds, holes=found)


def _surrounded(label: np.typing.NDArray[np.intp], row: int, col: int, radius: float) -> bool:
    """Is there reef all around a circle, but for a gap here and there, and all of it in the bounds?"""
    around = radius / SPACING * directions(2.0 * math.pi * np.arange(24) / 24)
    cols, rows = (np.rint(middle + around[:, k]).astype(np.intp) for k, middle in enumerate((col, row)))
    inside = (rows >= 0) & (rows < label.shape[0]) & (cols >= 0) & (cols < label.shape[1])
    return bool(inside.all() and (label[rows, cols] == label[row, col]).mean() > 0.95)


@dataclass(frozen=True, slots=True, eq=False)
class Borders:
    """Reefs that lie across some sides of an arena, which ends in the midst of them."""

    bounds: Bounds
    sides: tuple[tuple[int, float], ...]
    """Which of west, east, south and north, from 0; and how far the reef reaches in there, metres."""
    wide: Noise
    """Makes it reach farther here than there, and not at all between."""
    crust: Crust
    height: float
    group_radius: float = 1.5

    def share(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """1 well inside, 0 off the reef."""
        box = self.bounds
        away = (x - box.x_min, box.x_max - x, y - box.y_min, box.y_max - y)
        reach = np.clip(0.45 + 1.3 * self.wide.at(x, y), 0.0, 1.0)
        edge = np.full(np.broadcast_shapes(x.shape, y.shape), -np.inf)
        for side, width in self.sides:
            edge = np.maximum(edge, width * reach - np.abs(away[side]))
        return np.clip((edge + 0.15) / 0.6, 0.0, 1.0)

    def relief(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """Old shell, on both sides of the border."""
        return shell(self.share(x, y) > 0.0, self.height, self.crust.rough(x, y))

    def kept_free(self) -> Float64Array:
        """Nothing: boulders stand in reefs, too."""
        return np.empty((0, 3))

    def places(self, bottom: Bottom, most: int, rng: np.random.Generator) -> Places:
        """Up to the border."""
        return spread(self, self.crust, BORDER, self.group_radius, bottom, most, rng)


BORDER = 2.0, 13.0
"""Clumps to the square metre of a reef at a border: 15 oysters, the least that is called a restored reef
(Oyster Metrics Workgroup 2011), at 7.5 to a clump, up to what dream-v1's reefs have."""
LEAST_AREA = 30.0
"""Square metres of reef, so that it has 60 clumps at 2 to the square metre."""


def borders_in(arena: Arena, rng: np.random.Generator) -> Borders:
    """Reefs along one to three sides."""
    box = arena.bounds.widened(APRON)
    while True:
        count = between(rng, *BORDERS)
        order = np.argsort(rng.random(4), kind="stable")[:count]
        widths = uniforms(rng, *WIDTH, count)
        found = Borders(
            arena.bounds,
            tuple((int(side), float(width)) for side, width in zip(order, widths, strict=True)),
            Noise.over(box, uniform(rng, 6.0, 10.0), rng),
            Crust.over(box, 0.03, rng),
            uniform(rng, *HEIGHT),
        )
        label = islands(found, arena.bounds, found.group_radius)
        if np.count_nonzero(label) * SPACING * SPACING >= LEAST_AREA:
            return found
