"""Reefs that rise: mounds of old shell, and ledges of the bed.

Mounds. Subtidal reefs of eastern oysters once stood metres over the bed: Wreck Shoal grew by almost 1.5 m
between 1550 and 1850 (DeAlteris 1988, Estuaries 11: 240-249); Lenihan (1999, Ecol. Monogr. 69: 251-275)
built reefs of 1 and 2 m; mounds that are built today are some 0.6 m high (Pollack et al. 2024, Front. Mar.
Sci. 11: 1385866). Loose shell lies no steeper than it was heaped, some 35°.

Ledges. Where rock crops out, the bed steps: at Gray's Reef by up to 6 to 8 ft, 1.8 to 2.4 m, over sand (NOAA
Ocean Service, June 2009). Oysters keep to the edge, where the water moves and no silt stays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dream.geometry import Bounds
from dream.sim.boulders import CLEAR
from dream.sim.habitats.arena import Arena, NoRoomError
from dream.sim.habitats.growth import Bottom, Crust, Places, islands, spread
from dream.sim.sampling import Float64Array, between, direction, uniform, uniforms
from dream.sim.terrain import APRON, SPACING, Noise, smoothstep

TRIES = 3000
"""Places that are looked at for mounds, ..."""
STEP_TRIES = 200
"""... and lines for ledges."""
DENSITY = 2.0, 13.0
"""Clumps to the square metre: from 15 oysters, the least that is called a restored reef (Oyster Metrics
Workgroup 2011), at 7.5 to a clump (EUNIS MB243 has 5 to 10), up to what dream-v1's reefs have. High reefs of
the Great Wicomico had 1,000 oysters in their best year, low ones 250 (Schulte et al. 2009, Science 325:
1124-1128)."""
LEAST_AREA = 45.0
"""Square metres of the bed on which oysters grow along ledges, so that they are a world's fewest."""
MOST_AREA = 1400.0
"""Square metres of the bed that mounds cover, so that 2 clumps to each are half of a world's most."""
MOUNDS = 1, 5
HEIGHT = 0.5, 2.0
"""Metres that a mound or the step of a ledge rises."""
FLANK = 14.0, 30.0
"""Degrees: the steepest slope of a mound before its surface is roughened, which adds some five."""
TOP = 0.5, 3.0
"""Metres: half the width of the part of a mound that is not flank."""
LONG = 1.0, 1.8
"""Times its width that a mound is long."""
LEDGES = 1, 3
STEP = 0.3, 0.7
"""Metres over ground in which a ledge rises."""
BAND = 1.2, 3.0
"""Metres from the edge to which oysters grow above it."""
FOOT = 0.8
"""Metres to which they do below it."""
APART = 6.0
"""Least metres between two ledges."""


@dataclass(frozen=True, slots=True)
class Mound:
    """One heap of old shell. Metres and radians."""

    x: float
    y: float
    long: float
    wide: float
    """Half its length and half its width at the foot."""
    top: float
    """Share of that which is not flank."""
    height: float
    turn: float
    """From east to its long axis."""

    def out(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """How far out each place is: 0 in the middle, 1 at the foot."""
        c, s = direction(self.turn)
        along, across = c * (x - self.x) + s * (y - self.y), c * (y - self.y) - s * (x - self.x)
        return np.asarray(np.sqrt(np.square(along / self.long) + np.square(across / self.wide)))


@dataclass(frozen=True, slots=True, eq=False)
class Mounds:
    """One to five mounds, overgrown from the foot to the top."""

    mounds: tuple[Mound, ...]
    rim: Noise
    crust: Crust
    group_radius: float = 1.5

    def share(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """1 on a mound, less near its foot, 0 off it."""
        return 1.0 - smoothstep(0.9, 1.0, self._out(x, y)[0])

    def relief(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """Flanks as smooth as a step of the cubic kind."""
        out, which = self._out(x, y)
        heights = np.array([mound.height for mound in self.mounds])[which]
        tops = np.array([mound.top for mound in self.mounds])[which]
        t = np.clip((1.0 - out) / (1.0 - tops), 0.0, 1.0)
        rise = t * t * (3.0 - 2.0 * t)
        return rise * (heights + self.crust.rough(x, y))

    def kept_free(self) -> Float64Array:
        """The circles about all mounds."""
        return np.array([(mound.x, mound.y, mound.long) for mound in self.mounds])

    def places(self, bottom: Bottom, most: int, rng: np.random.Generator) -> Places:
        """All over them."""
        return spread(self, self.crust, DENSITY, self.group_radius, bottom, most, rng)

    def _out(self, x: Float64Array, y: Float64Array) -> tuple[Float64Array, np.typing.NDArray[np.intp]]:
        """How far out of the mound that is nearest each place is, its foot ragged; and which that is."""
        each = np.stack([np.broadcast_arrays(mound.out(x, y))[0] for mound in self.mounds])
        return each.min(axis=0) * (1.0 + 0.1 * self.rim.at(x, y)), each.argmin(axis=0)


def mounds_in(arena: Arena, region: Bounds, rng: np.random.Generator) -> Mounds:
    """Mounds in a part of an arena, 2 m apart and off all starts. Where many do not fit, fewer stand."""
    count, found, area = between(rng, *MOUNDS), list[Mound](), 0.0
    for _ in range(TRIES):
        height, top = uniform(rng, *HEIGHT), uniform(rng, *TOP)
        # A cubic step is half as steep again in its middle as on average.
        flank = 1.5 * height / math.tan(math.radians(uniform(rng, *FLANK)))
        wide = round(top + flank, 3)
        long = round(wide * uniform(rng, *LONG), 3)
        x = uniform(rng, region.x_min, region.x_max)
        y = uniform(rng, region.y_min, region.y_max)
        mound = Mound(round(x, 3), round(y, 3), long, wide, top / wide, height, uniform(rng, 0.0, math.pi))
        area += math.pi * long * wide
        if area <= MOST_AREA and _fits(mound, found, arena, region):
            found.append(mound)
        else:
            area -= math.pi * long * wide
        if len(found) == count:
            break
    if not found:
        raise NoRoomError(f"mounds: expected room for one in {region.width:g} x {region.depth:g} m, got none")
    wide_box = arena.bounds.widened(APRON)
    return Mounds(tuple(found), Noise.over(wide_box, 2.5, rng), Crust.over(wide_box, 0.03, rng))


def _fits(mound: Mound, others: list[Mound], arena: Arena, region: Bounds) -> bool:
    c, s = direction(mound.turn)
    east = math.sqrt(float((mound.long * c) ** 2 + (mound.wide * s) ** 2))
    north = math.sqrt(float((mound.long * s) ** 2 + (mound.wide * c) ** 2))
    if not (
        region.x_min + 1.0 + east <= mound.x <= region.x_max - 1.0 - east
        and region.y_min + 1.0 + north <= mound.y <= region.y_max - 1.0 - north
    ):
        return False
    # The ellipse that is wider all round holds, but for a hand's breadth, all that is so near.
    clear = CLEAR + 0.5
    ring = Mound(mound.x, mound.y, mound.long + clear, mound.wide + clear, 0.0, 0.0, mound.turn)
    starts = np.array([(start.x, start.y) for start in arena.starts])
    return bool((ring.out(starts[:, 0], starts[:, 1]) >= 1.0).all()) and all(
        math.hypot(mound.x - other.x, mound.y - other.y) >= mound.long + other.long + 2.0 for other in others
    )


@dataclass(frozen=True, slots=True, eq=False)
class Ledges:
    """Steps of the bed, one above the other, with oysters on and along their edges."""

    across: float
    """Radians from east to the way up."""
    edges: tuple[float, ...]
    """Metres up that way from the origin to the middle of each step."""
    low: float
    high: float
    """Metres: a step rises by between so many, from place to place."""
    width: float
    """Metres over ground in which it does."""
    band: float
    """Metres above an edge to which oysters grow."""
    bend: Noise
    sway: float
    """Metres that an edge winds to either side."""
    tall: Noise
    """Makes a step higher here than there."""
    stretches: Noise
    """Leaves some of an edge bare."""
    crust: Crust
    group_radius: float = 1.5

    def above(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """Metres up from the origin, were all edges straight."""
        c, s = direction(self.across)
        return np.asarray(c * x + s * y + self.sway * self.bend.at(x, y))

    def share(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """1 at an edge, 0 beyond the band above it and its foot, and where a stretch is bare."""
        up = self.above(x, y)
        best = np.zeros_like(up)
        for edge in self.edges:
            s = up - edge
            near = smoothstep(-FOOT - 0.4, -FOOT, s) * (1.0 - smoothstep(self.band - 0.5, self.band, s))
            best = np.maximum(best, near)
        return best * smoothstep(-0.35, -0.2, self.stretches.at(x, y))

    def relief(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """About 0 in the middle of all steps."""
        up = self.above(x, y)
        step = self.low + (self.high - self.low) * np.clip(0.5 + self.tall.at(x, y), 0.0, 1.0)
        total = -0.5 * len(self.edges) * 0.5 * (self.low + self.high) * np.ones_like(up)
        for edge in self.edges:
            total = total + step * smoothstep(-0.5 * self.width, 0.5 * self.width, up - edge)
        return total + self.share(x, y) * self.crust.rough(x, y)

    def kept_free(self) -> Float64Array:
        """Nothing: boulders lie at the foot of many a ledge."""
        return np.empty((0, 3))

    def places(self, bottom: Bottom, most: int, rng: np.random.Generator) -> Places:
        """On the steep face as well, by its surface."""
        return spread(self, self.crust, DENSITY, self.group_radius, bottom, most, rng)


def ledges_in(arena: Arena, region: Bounds, rng: np.random.Generator, across: float | None = None) -> Ledges:
    """Ledges in a part of an arena, off all starts.

    Args:
        arena: Where.
        region: The part that all edges cross.
        rng: Source of number, place and form.
        across: Radians from east to the way up; any unless given.
    """
    box = arena.bounds.widened(APRON)
    bend, tall, stretches = (Noise.over(box, pitch, rng) for pitch in (9.0, 12.0, 6.0))
    low = uniform(rng, HEIGHT[0], 1.2)
    high = uniform(rng, low, HEIGHT[1])
    width, band, sway = uniform(rng, *STEP), uniform(rng, *BAND), uniform(rng, 1.0, 2.5)
    crust = Crust.over(box, 0.03, rng)
    count = between(rng, *LEDGES)
    starts = np.array([(start.x, start.y) for start in arena.starts])
    middle = 0.5 * np.array([region.x_min + region.x_max, region.y_min + region.y_max])
    for tries in range(STEP_TRIES):
        way = uniform(rng, 0.0, 2.0 * math.pi) if across is None else across
        c, s = direction(way)
        # So far from the middle that an edge still has a good part of the region on either side.
        room = 0.5 * (abs(c) * region.width + abs(s) * region.depth) - 4.0
        fit = max(count - tries // 50, 1)
        edges = np.sort(c * middle[0] + s * middle[1] + uniforms(rng, -room, room, fit))
        ledges = Ledges(
            way, tuple(edges.round(3).tolist()), low, high, width, band, bend, sway, tall, stretches, crust
        )
        away = np.abs(ledges.above(starts[:, 0], starts[:, 1])[:, None] - edges).min()
        # Where an edge bends, it is nearer than the way up tells.
        if away < 1.4 * CLEAR or (fit > 1 and np.diff(edges).min() < APART):
            continue
        if np.count_nonzero(islands(ledges, region, ledges.group_radius)) * SPACING * SPACING >= LEAST_AREA:
            return ledges
    raise NoRoomError(f"ledges: expected one that leaves all starts free in {STEP_TRIES} tries, got none")
