"""Rocks, ridges and quays: oysters on their tops and on their vertical sides, or reefs that they cut.

Flat oysters make small reefs on rocky outcrops at 10 to 20 m (EUNIS MB243); seawalls in Sydney Harbour have
14 to 56 % of their surface under rock oysters (Strain et al. 2020, PLoS ONE 15: e0230807). A rocky reef of
high profile rises by up to 4 m over 10 m (SeaMap Tasmania). What is built for oysters off South Australia
are some 150 low ridges of limestone on 20 ha in 10 m of water (Windara).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dream.geometry import Bounds
from dream.sim import boulders
from dream.sim.boulders import CLEAR, Rock
from dream.sim.habitats.arena import USUAL_AREA, Arena, NoRoomError
from dream.sim.habitats.building import Stands, clear_of
from dream.sim.habitats.growth import Bottom, IntpArray, Places, density_in, pieces
from dream.sim.meshes import mesh
from dream.sim.sampling import (
    MILLIMETRE,
    Float64Array,
    between,
    direction,
    index,
    quantised,
    rotated,
    uniform,
    uniforms,
)
from dream.sim.world import Instances, Mesh, Terrain

DENSITY = 3.0, 12.0
"""Clumps to the square metre of rock: 14 to 56 % of it under clumps 0.24 m across."""
ROCKS = 12, 26
"""Rocks of an arena of 45 m by 45 m."""
FIELDS = 2, 5
"""Fields that most of them lie in."""
RADIUS = 0.9, 2.2
TOP = 0.5, 2.0
"""Metres: half the width of a rock, and how high it rises."""
BETWEEN = 1.0
"""Least metres between two rocks."""
BARE = 0.2, 0.5
"""Share of the rocks that nothing grows on."""
LEAST_TOP = 0.12
"""Metres over the bed from which oysters grow: below, sand scours the rock."""
OVERHANG = -0.1
"""Upward part of a rock's normal below which none grow."""
APART = 0.12
"""Least metres between the middles of two clumps on a rock."""

WALLS = 1, 3
TALL = 1.0, 2.5
"""Metres that a wall rises."""
PASSAGE = 3.0, 6.0
"""Metres: how wide the gaps in a wall are."""
EVERY = 14.0, 30.0
"""Metres of wall to one gap."""
WALLS_APART = 7.0
STATION = 1.0
"""Metres between the cross-sections of a wall."""
TRIES = 2000


@dataclass(frozen=True, slots=True, eq=False)
class Rocks:
    """Boulders and outcrops, in fields and alone."""

    rocks: tuple[Rock, ...]

    def feet(self) -> Float64Array:
        """The circles they stand in."""
        return boulders.feet(list(self.rocks))

    def on(self, seabed: Terrain, rng: np.random.Generator) -> Stands:
        """Each a formation of its own."""
        stones = boulders.variants(rng)
        return Stands(stones, boulders.placed(list(self.rocks), stones, 0, seabed, rng))


def rocks_in(arena: Arena, taken: Float64Array, rng: np.random.Generator) -> Rocks:
    """Rocks off all starts and off what is taken, (T, 3) circles."""
    box = arena.bounds
    scale = box.area / USUAL_AREA
    count = max(round(uniform(rng, *ROCKS) * scale), 8)
    fields = [
        (uniform(rng, box.x_min + 4.0, box.x_max - 4.0), uniform(rng, box.y_min + 4.0, box.y_max - 4.0))
        for _ in range(max(round(between(rng, *FIELDS) * max(scale, 1.0)), 2))
    ]
    found: list[Rock] = []
    for _ in range(TRIES):
        if len(found) == count:
            break
        radius = round(uniform(rng, *RADIUS), 3)
        if rng.random() < 0.8:
            middle = fields[index(rng, len(fields))]
            x, y = np.array(middle) + 5.0 * (rng.random(2) + rng.random(2) - 1.0)
        else:
            x, y = uniform(rng, box.x_min, box.x_max), uniform(rng, box.y_min, box.y_max)
        x, y = round(float(x), 3), round(float(y), 3)
        if (
            box.contains(x, y, radius + 1.0)
            and clear_of(arena, x, y, radius)
            and all(math.hypot(x - o.x, y - o.y) >= radius + o.radius + BETWEEN for o in found)
            and all(math.hypot(x - u, y - v) >= radius + r + BETWEEN for u, v, r in taken)
        ):
            # No slimmer than it is high, and no flatter than a table.
            top = uniform(rng, max(TOP[0], 0.35 * radius), min(TOP[1], 1.6 * radius))
            found.append(Rock(x, y, radius, top, 1.35 * top + 0.2, len(found), sheer=rng.random() < 0.6))
    return Rocks(tuple(found))


@dataclass(frozen=True, slots=True)
class Wall:
    """A straight piece of a ridge of rock or of a quay. Metres."""

    ax: float
    ay: float
    bx: float
    by: float
    foot: float
    """Half its width at the bed."""
    crown: float
    """Half its width at the top."""
    height: float
    built: bool
    """A quay, its sides upright and its top level; else a ridge."""

    @property
    def length(self) -> float:
        """Along it."""
        return math.hypot(self.bx - self.ax, self.by - self.ay)


@dataclass(frozen=True, slots=True, eq=False)
class Walls:
    """Ridges of rock, or quays, with gaps to pass by."""

    walls: tuple[Wall, ...]

    def segments(self, beside: float) -> Float64Array:
        """(L, 5) from x, y to x, y, and the metres from there to `beside` the foot."""
        return np.array([(w.ax, w.ay, w.bx, w.by, w.foot + beside) for w in self.walls])

    def feet(self) -> Float64Array:
        """Circles that hold all of it, half a metre apart."""
        circles = []
        for w in self.walls:
            share = np.linspace(0.0, 1.0, max(math.ceil(2.0 * w.length), 2))
            x, y = w.ax + share * (w.bx - w.ax), w.ay + share * (w.by - w.ay)
            circles.append(np.stack([x, y, np.full(len(x), w.foot + 0.2)], axis=1))
        return np.concatenate(circles)

    def on(self, seabed: Terrain, rng: np.random.Generator) -> Stands:
        """A mesh for each piece, its foot in the bed all along."""
        meshes, middles = zip(*(_wall(wall, seabed, rng) for wall in self.walls), strict=True)
        count = len(meshes)
        return Stands(
            meshes,
            Instances(
                mesh=np.arange(count, dtype=np.int32),
                position=np.array(middles, np.float32),
                wxyz=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
                scale=np.ones((count, 3), np.float32),
                tint=np.ones((count, 3), np.float32),
                group=np.arange(count, dtype=np.int32),
            ),
        )


def walls_in(arena: Arena, number: tuple[int, int], rng: np.random.Generator) -> Walls:
    """Walls from side to side of an arena, beside each other and off all starts, each with a gap or more."""
    box = arena.bounds
    count = between(rng, *number)
    for tries in range(TRIES):
        turn = index(rng, 2) * 0.5 * math.pi + uniform(rng, -0.3, 0.3)
        along, across = direction(turn), direction(turn + 0.5 * math.pi)
        room = 0.5 * (abs(across[0]) * box.width + abs(across[1]) * box.depth) - 5.0
        # Where many do not fit, fewer stand.
        offsets = np.sort(uniforms(rng, -room, room, max(count - tries // 200, 1)))
        if len(offsets) > 1 and np.diff(offsets).min() < WALLS_APART:
            continue
        walls = [wall for offset in offsets for wall in _across(box, offset * across, along, rng)]
        if walls and _off_starts(arena, walls):
            return Walls(tuple(walls))
    raise NoRoomError(f"walls: expected one that leaves all starts free in {TRIES} tries, got none")


def _across(box: Bounds, through: Float64Array, along: Float64Array, rng: np.random.Generator) -> list[Wall]:
    """The pieces of one wall, from side to side of the arena."""
    with np.errstate(divide="ignore"):
        ends = np.sort(
            (np.array([[box.x_min, box.x_max], [box.y_min, box.y_max]]) - through[:, None]) / along[:, None],
            axis=1,
        )
    begin, end = float(ends[:, 0].max()), float(ends[:, 1].min())
    if end - begin < 8.0:
        return []
    built = rng.random() < 0.5
    height = uniform(rng, *TALL)
    foot = uniform(rng, 0.3, 0.5) if built else uniform(rng, 0.6, 1.1)
    crown = foot if built else uniform(rng, 0.2, 0.4)
    gaps = max(round((end - begin) / uniform(rng, *EVERY)), 1)
    pitch = (end - begin) / gaps
    at, walls = begin, []
    for k in range(gaps + 1):
        wide = uniform(rng, *PASSAGE)
        middle = begin + (k + uniform(rng, 0.3, 0.7)) * pitch
        stop = end if k == gaps else middle - 0.5 * wide
        if stop - at >= 2.0:
            a, b = quantised(through + at * along, MILLIMETRE), quantised(through + stop * along, MILLIMETRE)
            walls.append(Wall(float(a[0]), float(a[1]), float(b[0]), float(b[1]), foot, crown, height, built))
        at = middle + 0.5 * wide
    return walls


def _off_starts(arena: Arena, walls: list[Wall]) -> bool:
    from dream.sim.habitats.beds import to_segment

    x, y = np.array([(start.x, start.y) for start in arena.starts]).T
    return all(float(to_segment(x, y, w.ax, w.ay, w.bx, w.by).min()) >= w.foot + CLEAR for w in walls)


def _wall(wall: Wall, seabed: Terrain, rng: np.random.Generator) -> tuple[Mesh, tuple[float, float, float]]:
    """A closed mesh about its own middle, and that middle."""
    count = max(round(wall.length / STATION), 1) + 1
    share = np.linspace(0.0, 1.0, count)
    x, y = wall.ax + share * (wall.bx - wall.ax), wall.ay + share * (wall.by - wall.ay)
    side = np.array([wall.ay - wall.by, wall.bx - wall.ax]) / wall.length
    worn = 0.02 if wall.built else 0.12
    ground = seabed.height(x, y)
    if wall.built:
        top = np.full(count, float(ground.max()) + wall.height)
    else:
        top = ground + np.clip(wall.height * uniforms(rng, 0.75, 1.0, count), *TALL)
    # Down one side and up the other: foot, half way up, crown.
    out = np.array([1.0, 0.5, 0.0, 0.0, 0.5, 1.0])
    left = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])
    half = left * (wall.crown + (wall.foot - wall.crown) * out)
    away = half + worn * uniforms(rng, -1.0, 1.0, (count, 6)) * left
    low = ground - 0.6
    z = top[:, None] + (low - top)[:, None] * np.array([1.0, 0.5, 0.0, 0.0, 0.5, 1.0])
    z += worn * uniforms(rng, -1.0, 1.0, (count, 6)) * np.array([0.0, 1.0, 0.0, 0.0, 1.0, 0.0])
    points = np.stack([x[:, None] + away * side[0], y[:, None] + away * side[1], z], axis=-1)
    a = np.arange(count - 1)[:, None] * 6 + np.arange(6)
    b = np.arange(count - 1)[:, None] * 6 + (np.arange(6) + 1) % 6
    quads = np.stack([a, b, b + 6, a + 6], axis=-1).reshape(-1, 4)
    faces = [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
    fan = np.array([(0, k + 1, k + 2) for k in range(4)])
    faces += [fan[:, ::-1], fan + 6 * (count - 1)]
    grey = np.array([124.0, 122.0, 114.0]) if wall.built else np.array([98.0, 94.0, 86.0])
    shade = uniforms(rng, 0.85, 1.12, (count * 6, 1))
    vertices = quantised(points.reshape(-1, 3), MILLIMETRE)
    middle = quantised(0.5 * (vertices.min(axis=0) + vertices.max(axis=0)), MILLIMETRE)
    return (
        mesh(vertices - middle, np.concatenate(faces), grey * shade),
        (float(middle[0]), float(middle[1]), float(middle[2])),
    )


@dataclass(frozen=True, slots=True, eq=False)
class RockFaces:
    """The open faces of what stands first in an arena: rocks, then pieces of wall."""

    first: int
    """So many of the obstacles, some of which are bare."""
    group_radius: float = 0.7

    def relief(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """None: rocks are not the bed."""
        return np.zeros(np.broadcast_shapes(x.shape, y.shape))

    def kept_free(self) -> Float64Array:
        """Nothing more than the rocks themselves."""
        return np.empty((0, 3))

    def places(self, bottom: Bottom, most: int, rng: np.random.Generator) -> Places:
        """By area, more of them on one side than on the other."""
        table = bottom.obstacles
        grown = rng.random(self.first) >= uniform(rng, *BARE)
        # The largest bears some, whatever comes.
        grown[int(np.argmax(table.scale[: self.first].max(axis=1)))] = True
        faces = [_faces(bottom, int(k)) for k in np.flatnonzero(grown)]
        owner = np.repeat(np.flatnonzero(grown), [len(each) for each in faces])
        triangles = np.concatenate(faces)
        one, other = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
        normals = np.cross(one, other)
        twice = np.sqrt(np.square(normals).sum(axis=1))
        normals /= np.maximum(twice, 1e-12)[:, None]
        middle = triangles.mean(axis=1)
        over = middle[:, 2] - bottom.seabed.height(middle[:, 0], middle[:, 1])
        bears = (normals[:, 2] >= OVERHANG) & (over >= LEAST_TOP)
        area = np.where(bears, 0.5 * twice, 0.0)
        total = float(area.sum())
        density = density_in(DENSITY, total, most, rng)
        c, s = direction(uniform(rng, 0.0, 2.0 * math.pi))
        liked = area * (1.0 + 0.6 * (c * normals[:, 0] + s * normals[:, 1]))
        mass = np.cumsum(liked)
        count = round(density * total)
        # More than are wanted, since some come to lie too near to another.
        drawn = np.searchsorted(mass, rng.random(2 * count) * mass[-1], side="right")
        drawn = np.minimum(drawn, len(mass) - 1)
        u, v = np.sqrt(rng.random(len(drawn)))[:, None], rng.random(len(drawn))[:, None]
        corner = triangles[drawn]
        points = (1.0 - u) * corner[:, 0] + u * (1.0 - v) * corner[:, 1] + u * v * corner[:, 2]
        open_ = points[:, 2] - bottom.seabed.height(points[:, 0], points[:, 1]) >= LEAST_TOP
        kept = np.flatnonzero(open_)
        kept = kept[_spaced(points[kept], APART)][:count]
        points, drawn = points[kept], drawn[kept]
        group = pieces(points[:, 0], points[:, 1], owner[drawn], bottom.bounds, self.group_radius, rng)
        held = group >= 0
        return Places(points[held], normals[drawn][held], group[held])


def _faces(bottom: Bottom, row: int) -> Float64Array:
    """(F, 3, 3) the triangles of an obstacle, in the world."""
    table = bottom.obstacles
    shape = bottom.meshes[table.mesh[row]]
    turned = rotated(table.wxyz[row], shape.vertices.astype(np.float64) * table.scale[row])
    return np.asarray((turned + table.position[row].astype(np.float64))[shape.faces])


def _spaced(points: Float64Array, apart: float) -> IntpArray:
    """Those of the points, in their order, that lie so far from all before them that are kept."""
    kept: list[int] = []
    cells: dict[tuple[int, int, int], list[int]] = {}
    near = [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)]
    home = np.floor(points / apart).astype(int).tolist()
    places = points.tolist()
    for number, ((a, b, c), (x, y, z)) in enumerate(zip(home, places, strict=True)):
        others = (other for i, j, k in near for other in cells.get((a + i, b + j, c + k), ()))
        if all(
            (x - places[o][0]) ** 2 + (y - places[o][1]) ** 2 + (z - places[o][2]) ** 2 >= apart * apart
            for o in others
        ):
            cells.setdefault((a, b, c), []).append(number)
            kept.append(number)
    return np.array(kept, np.intp)
