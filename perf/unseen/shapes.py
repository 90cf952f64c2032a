"""Triangles of what lies on a seabed: shells, hulls, boulders, poles, chains, walls, pipes, tyres; and of it.

Everything is in metres with z up, about its own origin, unless told otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.spatial import ConvexHull

from dream.geometry import FloatArray

IntArray = npt.NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles."""

    points: FloatArray
    """(N, 3)."""
    faces: IntArray
    """(M, 3) rows of `points`."""

    def moved(self, rotation: FloatArray, translation: FloatArray, scale: float | FloatArray = 1.0) -> Mesh:
        """Scaled, then turned by (3, 3), then shifted by (3,)."""
        return Mesh((self.points * scale) @ rotation.T + translation, self.faces)

    def without_lost(self) -> Mesh:
        """Only the points that some triangle has."""
        used, faces = np.unique(self.faces, return_inverse=True)
        return Mesh(self.points[used], faces.reshape(-1, 3).astype(np.int32))

    @property
    def normals(self) -> FloatArray:
        """(N, 3) of unit length, a mean over the triangles at each point by area."""
        a, b, c = (self.points[self.faces[:, k]] for k in range(3))
        across = np.cross(b - a, c - a)
        sums = np.stack(
            [np.bincount(self.faces.ravel(), np.repeat(across[:, k], 3), len(self.points)) for k in range(3)],
            axis=-1,
        )
        return np.asarray(sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12))


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """All as one."""
    starts = np.cumsum([0] + [len(mesh.points) for mesh in meshes[:-1]])
    return Mesh(
        np.concatenate([mesh.points for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]).astype(
            np.int32
        ),
    )


def sheet(points: FloatArray, *, round_rows: bool = False, round_cols: bool = False) -> Mesh:
    """A net of (R, C, 3) points, closed to a ring along rows or columns where asked."""
    rows, cols = points.shape[:2]
    index = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    if round_rows:
        index = np.concatenate([index, index[:1]])
    if round_cols:
        index = np.concatenate([index, index[:, :1]], axis=1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return Mesh(points.reshape(-1, 3).astype(np.float64), faces)


def turned(rng: np.random.Generator, tilt: float) -> FloatArray:
    """A rotation (3, 3): any heading, then leaning by some angle of deviation `tilt`, radians."""
    yaw, lean, towards = rng.uniform(0, 2 * math.pi), rng.normal(0.0, tilt), rng.uniform(0, 2 * math.pi)
    axis = np.array([math.cos(towards), math.sin(towards), 0.0])
    return about(axis, lean) @ about(np.array([0.0, 0.0, 1.0]), yaw)


def about(axis: FloatArray, angle: float) -> FloatArray:
    """The rotation (3, 3) about a unit vector (3,) by radians."""
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * skew + (1.0 - math.cos(angle)) * skew @ skew)


def _wavy(rng: np.random.Generator, angles: FloatArray, most: int, size: float) -> FloatArray:
    """1 plus a sum of harmonics of angles, the higher the weaker."""
    orders = np.arange(1, most + 1)
    phases, sizes = rng.uniform(0, 2 * math.pi, most), size * rng.normal(size=most) / orders**0.8
    waves: FloatArray = 1.0 + (sizes * np.cos(angles[..., None] * orders + phases)).sum(axis=-1)
    return waves


# Shells


def valve(rng: np.random.Generator, rings: int, spokes: int) -> Mesh:
    """Half a bivalve of length 1, its umbo at the origin: a margin that grows along a logarithmic spiral.

    Reference: Raup, Geometric analysis of shell coiling, Journal of Paleontology 40 (1966).
    """
    growth = np.linspace(0.08, 1.0, rings)[:, None]
    angles = np.linspace(0.0, 2.0 * math.pi, spokes, endpoint=False)[None, :]
    radius = 0.5 * _wavy(rng, angles, 5, 0.07)
    narrow = rng.uniform(0.5, 0.9)
    x = radius * np.cos(angles) + 0.5
    y = narrow * radius * np.sin(angles) * (0.45 + 0.55 * x)
    frill = 0.03 * rng.normal(size=(rings, 1)) + 0.025 * rng.normal(size=(rings, spokes))
    coil = rng.uniform(0.1, 0.9) * np.log(growth)
    twist = rng.normal(0.0, 0.15) * np.log(growth)
    x, y, z = growth * x, growth * y, growth * frill
    x, z = x * np.cos(coil) + z * np.sin(coil), z * np.cos(coil) - x * np.sin(coil)
    x, y = x * np.cos(twist) - y * np.sin(twist), x * np.sin(twist) + y * np.cos(twist)
    z = z - z[-1].mean()
    return sheet(np.stack([x, y, z], axis=-1), round_cols=True)


def bivalve(rng: np.random.Generator, rings: int = 5, spokes: int = 9) -> Mesh:
    """Both halves, of length 1 and some gape; an empty one has only one."""
    lower = valve(rng, rings, spokes)
    if rng.random() < 0.3:
        return lower
    flip = np.diag([1.0, 1.0, -rng.uniform(0.2, 0.9)])
    upper = valve(rng, rings, spokes)
    gape = about(np.array([0.0, 1.0, 0.0]), -rng.uniform(0.0, 0.5))
    flipped = Mesh(upper.points @ flip.T @ gape.T, upper.faces[:, ::-1].copy())
    return joined([lower, flipped])


def clump(rng: np.random.Generator, count: int, length: float) -> Mesh:
    """Oysters that grow on each other, most with the umbo down; `length` metres of one.

    Kinds: upright as in a fringing reef, lying as in a bed, or all ways as on a mound.
    """
    some = [bivalve(rng) for _ in range(6)]
    upright, spread = rng.uniform(0.0, 1.0), length * 0.42 * math.sqrt(count) * rng.uniform(0.7, 1.3)
    height = rng.uniform(0.1, 0.9) * spread
    placed = []
    for _ in range(count):
        place = rng.normal(0.0, 0.45, 2).clip(-1.0, 1.0)
        level = height * max(0.0, 1.0 - float(place @ place)) * rng.uniform(0.6, 1.0)
        rise = -rng.normal(upright * 1.3, 0.45)
        rotation = turned(rng, 0.35) @ about(np.array([0.0, 1.0, 0.0]), rise)
        rotation = rotation @ about(np.array([1.0, 0.0, 0.0]), rng.uniform(0, 2 * math.pi))
        size = length * rng.lognormal(0.0, 0.3)
        at = np.array([*(spread * place), level - 0.15 * length])
        placed.append(some[rng.integers(len(some))].moved(rotation, at, size))
    return joined(placed)


# Wrecks


def hull(rng: np.random.Generator) -> tuple[Mesh, float]:
    """A boat of planks on ribs, with planks missing, keel at z = 0, and its length in metres."""
    length = rng.uniform(4.0, 16.0)
    beam, depth = length * rng.uniform(0.18, 0.34), length * rng.uniform(0.09, 0.2)
    stations, strakes = int(rng.integers(26, 44)), int(rng.integers(9, 16))
    along = np.linspace(-1.0, 1.0, stations)[:, None]
    girth = np.linspace(-1.0, 1.0, 2 * strakes + 1)[None, :]
    full = (1.0 - np.abs(along) ** rng.uniform(2.0, 4.0)) ** rng.uniform(0.5, 0.9)
    bilge = rng.uniform(1.4, 4.0)
    side = np.sign(girth) * (1.0 - (1.0 - np.abs(girth)) ** bilge) ** (1.0 / bilge)
    rise = np.abs(girth) ** rng.uniform(1.5, 3.5)
    sheer = 1.0 + rng.uniform(0.1, 0.5) * along**2
    x = 0.5 * length * along * (1.0 + 0.08 * rise * sheer) + 0.0 * girth
    y = 0.5 * beam * full * side
    z = depth * rise * sheer + 0.25 * depth * np.abs(along) ** 4
    lap = 0.012 * length / 10.0 * (np.arange(2 * strakes + 1) % 2)
    skin = np.stack([x, y + np.sign(girth) * lap, z], axis=-1)
    planks = sheet(skin)
    kept = _holes(rng, (stations - 1, 2 * strakes), rng.uniform(0.0, 0.35))
    planks = Mesh(planks.points, planks.faces[np.concatenate([kept.ravel()] * 2)])
    parts = [planks]
    thick = length * rng.uniform(0.006, 0.014)
    for station in range(2, stations - 2, int(rng.integers(2, 4))):
        inside = skin[station] * np.array([1.0, 0.97, 1.0]) + np.array([0.0, 0.0, 0.5 * thick])
        first, last = sorted(rng.integers(0, 2 * strakes + 1, 2)) if rng.random() < 0.3 else (0, 2 * strakes)
        if last - first > 2:
            parts.append(rod(inside[first : last + 1], thick, 5))
        if rng.random() < 0.25:
            parts.append(rod(inside[[0, -1]] - np.array([0, 0, 0.1 * depth]), thick, 5))
    keel = np.stack([x[:, strakes], 0.0 * x[:, strakes], z[:, strakes]], axis=-1)
    parts.append(rod(keel, 1.5 * thick, 6))
    if rng.random() < 0.5:
        foot = np.array([rng.uniform(-0.2, 0.2) * length, 0.0, 0.1 * depth])
        lean = turned(rng, 0.9) @ np.array([0.0, 0.0, rng.uniform(0.3, 0.7) * length])
        parts.append(rod(np.stack([foot, foot + lean]), 1.6 * thick, 8))
    return joined(parts).without_lost(), length


def _holes(rng: np.random.Generator, shape: tuple[int, int], share: float) -> npt.NDArray[np.bool_]:
    """Which squares of a net are left: gone ones lie together, longer than high."""
    rough = ndimage.gaussian_filter(rng.normal(size=shape), (1.6, 0.7))
    return np.asarray(rough > np.quantile(rough, share))


def scanned_wreck(path: Path, rng: np.random.Generator) -> tuple[Mesh, float]:
    """A part of the scan of a steel wreck, without the bed around it, and its length in metres."""
    whole = _scan(path)
    low = np.quantile(whole.points[:, 2], 0.25)
    middles = whole.points[whole.faces].mean(axis=1)
    length, width = rng.uniform(8.0, 30.0), rng.uniform(6.0, 16.0)
    above = middles[:, 2] > low + 0.5
    seed = middles[above][rng.integers(int(above.sum()))]
    inside = (np.abs(middles[:, 1] - seed[1]) < 0.5 * length) & (
        np.abs(middles[:, 0] - seed[0]) < 0.5 * width
    )
    part = Mesh(whole.points - np.array([seed[0], seed[1], low + 0.5]), whole.faces[above & inside])
    scale = rng.uniform(0.35, 1.1)
    return part.without_lost().moved(np.eye(3), np.zeros(3), scale), scale * length


def scanned_coral(path: Path) -> Mesh:
    """A scanned colony, its foot at the origin."""
    whole = _scan(path, upright=True)
    low, high = whole.points.min(axis=0), whole.points.max(axis=0)
    return Mesh(whole.points - np.array([*(0.5 * (low + high))[:2], low[2]]), whole.faces)


@lru_cache(maxsize=4)
def _scan(path: Path, upright: bool = False) -> Mesh:
    """A file of triangles; y is up in it unless it is upright."""
    import trimesh

    found: Any = trimesh.load(path, process=False)
    points, faces = np.asarray(found.vertices, np.float64), np.asarray(found.faces, np.int32)
    return Mesh(points if upright else points[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0]), faces)


# What stands in the way


def rod(line: FloatArray, radius: float, sides: int) -> Mesh:
    """A round bar along (n, 3) points, with closed ends."""
    ahead = np.gradient(line, axis=0)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    helper = np.eye(3)[np.argmin(np.abs(ahead).max(axis=0))]
    right = np.cross(ahead, helper)
    right /= np.maximum(np.linalg.norm(right, axis=1, keepdims=True), 1e-9)
    up = np.cross(right, ahead)
    angles = np.linspace(0, 2 * math.pi, sides, endpoint=False)
    ring = np.cos(angles)[:, None, None] * right + np.sin(angles)[:, None, None] * up
    tube = line + radius * ring
    closed = np.concatenate(
        [np.repeat(line[None, :1], sides, 0), tube, np.repeat(line[None, -1:], sides, 0)], 1
    )
    return sheet(closed, round_rows=True)


def boulder(rng: np.random.Generator) -> Mesh:
    """The hull of random points of size about 1, broken or worn round."""
    points = rng.normal(size=(int(rng.integers(14, 60)), 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True) ** rng.uniform(0.4, 1.0)
    points *= rng.uniform(0.45, 1.0, 3)
    found = ConvexHull(points)
    faces = found.simplices.astype(np.int32)
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    mesh = Mesh(points, faces)
    for _ in range(3):
        mesh = _halved(mesh)
    worn = mesh.points
    sphere = worn / np.linalg.norm(worn, axis=1, keepdims=True)
    smooth = rng.uniform(0.0, 0.5)
    shape = (1.0 - smooth) * worn + smooth * 0.8 * sphere
    for _ in range(int(rng.integers(4, 30))):
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        far = shape @ normal
        cut = rng.uniform(0.7, 1.0) * float(far.max())
        shape = shape - np.maximum(far - cut, 0.0)[:, None] * normal * rng.uniform(0.5, 1.0)
    return Mesh(shape + 0.012 * rng.normal(size=shape.shape), mesh.faces).without_lost()


def _halved(mesh: Mesh) -> Mesh:
    """Each triangle as four."""
    edges = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, where = np.unique(edges, axis=0, return_inverse=True)
    middle = where.reshape(-1, 3) + len(mesh.points)
    points = np.concatenate([mesh.points, mesh.points[unique].mean(axis=1)])
    (a, b, c), (p, q, r) = mesh.faces.T, middle.T
    four = [np.stack(t, axis=-1) for t in ((a, p, r), (p, b, q), (r, q, c), (p, q, r))]
    return Mesh(points, np.concatenate(four).astype(np.int32))


def box(size: FloatArray) -> Mesh:
    """Upright, of (3,) metres, its foot at the origin; no points are shared, so that its edges are sharp."""
    quads = []
    for axis in range(3):
        for way in (-1.0, 1.0):
            a, b = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            centre = way * np.eye(3)[axis]
            corners = [centre + s * way * a + t * b for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            quads.append(sheet(np.array([[corners[0], corners[1]], [corners[3], corners[2]]])))
    mesh = joined(quads)
    return Mesh((mesh.points * 0.5 + np.array([0.0, 0.0, 0.5])) * size, mesh.faces)


def pole(rng: np.random.Generator) -> Mesh:
    """Upright or leaning, with a bend."""
    height, radius = rng.uniform(0.8, 6.0), rng.uniform(0.02, 0.22)
    up = np.linspace(-0.3, height, 9)
    bend = rng.normal(0.0, 0.03, 2)
    line = np.stack([bend[0] * up**2, bend[1] * up**2, up], axis=-1)
    return rod(line, radius, 12)


def pipe(rng: np.random.Generator) -> Mesh:
    """Lying, open at both ends, some with flanges."""
    radius, length = rng.uniform(0.06, 0.6), rng.uniform(1.0, 9.0)
    along = np.linspace(-0.5, 0.5, 12) * length
    angles = np.linspace(0, 2 * math.pi, 22, endpoint=False)

    def tube(r: float, x: FloatArray) -> FloatArray:
        a, b = np.meshgrid(angles, x, indexing="ij")
        return np.stack([b, r * np.cos(a), radius + r * np.sin(a)], axis=-1)

    wall = [
        sheet(tube(radius, along), round_rows=True),
        sheet(tube(0.86 * radius, along)[::-1], round_rows=True),
    ]
    rims = [tube(r, along[[0, -1]]) for r in (radius, 0.86 * radius)]
    ends = [sheet(np.stack([rims[0][:, k], rims[1][:, k]], axis=1), round_rows=True) for k in (0, 1)]
    flanges = [
        sheet(tube(1.25 * radius, at + np.array([-0.08, 0.08]) * radius), round_rows=True)
        for at in rng.uniform(-0.5, 0.5, int(rng.integers(0, 4))) * length
    ]
    return joined([*wall, *ends, *flanges])


def ring(large: float, small: float, around: int, across: int, squash: float = 1.0) -> Mesh:
    """A torus that lies; `squash` widens its section along its axis."""
    a, b = np.meshgrid(
        np.linspace(0, 2 * math.pi, around, endpoint=False),
        np.linspace(0, 2 * math.pi, across, endpoint=False),
        indexing="ij",
    )
    r = large + small * np.cos(b)
    points = np.stack([r * np.cos(a), r * np.sin(a), squash * small * np.sin(b)], axis=-1)
    return sheet(points, round_rows=True, round_cols=True)


def tyre(rng: np.random.Generator) -> Mesh:
    """Lying or leaning, some on others."""
    large = rng.uniform(0.22, 0.5)
    one = ring(large, 0.36 * large, 26, 10, squash=1.3)
    pile = []
    for level in range(int(rng.integers(1, 4))):
        tilt = rng.choice([0.1, 1.2], p=[0.7, 0.3])
        place = np.array([*rng.normal(0.0, 0.4 * large, 2), large * (0.4 + 0.9 * level)])
        pile.append(one.moved(turned(rng, tilt), place))
    return joined(pile)


def chain(rng: np.random.Generator) -> Mesh:
    """Links along a curve on the ground, every other one upright."""
    thick = rng.uniform(0.012, 0.05)
    one = ring(3.0 * thick, 0.9 * thick, 14, 6)
    stretched = Mesh(one.points * np.array([1.45, 0.85, 1.0]), one.faces)
    heading, place, links = rng.uniform(0, 2 * math.pi), np.array([0.0, 0.0, 1.5 * thick]), []
    curve = 0.0
    for n in range(int(rng.integers(30, 70))):
        curve = 0.9 * curve + rng.normal(0.0, 0.03)
        heading += curve
        lean = about(np.array([1.0, 0.0, 0.0]), 0.5 * math.pi * (n % 2) + rng.normal(0.0, 0.2))
        links.append(stretched.moved(about(np.array([0.0, 0.0, 1.0]), heading) @ lean, place))
        place = place + 6.2 * thick * np.array([math.cos(heading), math.sin(heading), 0.0])
    return joined(links)


def blocks(rng: np.random.Generator) -> Mesh:
    """Concrete: a wall, or some blocks on a heap."""
    if rng.random() < 0.4:
        size = np.array([rng.uniform(2.0, 9.0), rng.uniform(0.2, 0.6), rng.uniform(0.6, 3.5)])
        return box(size)
    pile = []
    for level in range(int(rng.integers(1, 5))):
        size = rng.uniform(0.3, 1.2, 3)
        place = np.array([*rng.normal(0.0, 0.6, 2), 0.35 * level - 0.05])
        pile.append(box(size).moved(turned(rng, 0.25 * level), place))
    return joined(pile)


def frame(rng: np.random.Generator) -> Mesh:
    """A scaffold of bars, as of a jetty or a trap."""
    size = rng.uniform((0.8, 0.8, 0.6), (3.0, 3.0, 3.0))
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * size
    radius, bars = rng.uniform(0.015, 0.07), []
    for n, a in enumerate(corners):
        for b in corners[n + 1 :]:
            apart = int((a != b).sum())
            if rng.random() < (0.9 if apart == 1 else 0.3 if apart == 2 else 0.0):
                bars.append(rod(np.stack([a, b]), radius, 8))
    bars.append(rod(corners[[0, -1]], radius, 8))
    return joined(bars).moved(turned(rng, 0.1), np.zeros(3))


OBSTACLES = (boulder, pole, pipe, tyre, chain, blocks, frame)


# The bed


def displaced(rng: np.random.Generator, levels: int, roughness: float) -> FloatArray:
    """(2^levels, 2^levels) periodic heights of deviation 1 by midpoint displacement.

    Reference: Fournier, Fussell, Carpenter, Computer rendering of stochastic models, CACM 25 (1982).
    """
    heights = rng.normal(size=(2, 2))
    for level in range(1, levels):
        size = 0.5 ** (level * roughness)
        fine = ndimage.zoom(heights, 2, order=1, mode="grid-wrap", grid_mode=True)
        heights = fine + size * rng.normal(size=fine.shape)
    return np.asarray((heights - heights.mean()) / heights.std())


@dataclass(frozen=True, slots=True, eq=False)
class Bed:
    """Heights: layers of tiles, and a slope with a step across it."""

    layers: tuple[tuple[FloatArray, float, float, float], ...]
    """Each (n, n) of deviation 1, metres of a tile, metres of height, radians that it is turned by."""
    slope: tuple[float, float]
    """Rise along x and y."""
    step: tuple[float, float, float, float]
    """Metres of height, radians of its direction, metres from the origin, metres it takes."""
    level: float
    """Metres of z at the middle."""

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Metres of z at places (n,) or (n, m)."""
        z = self.level + self.slope[0] * x + self.slope[1] * y
        for tile, size, tall, turn in self.layers:
            side, (c, s) = len(tile), (math.cos(turn), math.sin(turn))
            place = [(c * x - s * y) / size * side, (s * x + c * y) / size * side]
            z = z + tall * ndimage.map_coordinates(tile, place, order=1, mode="grid-wrap")
        tall, turn, off, takes = self.step
        tile = self.layers[0][0]
        wander = ndimage.map_coordinates(
            tile, [x / 14.0 * len(tile), y / 14.0 * len(tile)], order=1, mode="grid-wrap"
        )
        away = math.cos(turn) * x + math.sin(turn) * y - off + wander
        return np.asarray(z + 0.5 * tall * np.tanh(away / takes), np.float64)

    def height_at(self, x: float, y: float) -> float:
        """Metres of z at one place."""
        return float(self.height(np.array([x]), np.array([y]))[0])

    def mesh(self, side: int = 320, reach: float = 32.0) -> Mesh:
        """Finest at the middle: (side, side) points up to `reach` metres from it."""
        even = np.linspace(-1.0, 1.0, side)
        line = reach * (0.3 * even + 0.7 * even**3)
        x, y = np.meshgrid(line, line)
        return sheet(np.stack([x, y, self.height(x, y)], axis=-1))


def bed(rng: np.random.Generator, level: float, scanned: FloatArray | None, crests: FloatArray) -> Bed:
    """Some bed.

    Args:
        level: Metres of z.
        scanned: (n, n) metres of a real reef's heights of 1 cm cells, where there are any.
        crests: (n, n) ripples of deviation 1.
    """
    rough = rng.choice([0.15, 0.5, 1.0], p=[0.5, 0.3, 0.2])
    turns = rng.uniform(0, 2 * math.pi, 3)
    large = (displaced(rng, 8, rng.uniform(0.8, 1.3)), rng.uniform(25.0, 60.0), rough, turns[0])
    layers = [large]
    if scanned is not None and rng.random() < 0.7:
        mirrored = np.concatenate([scanned, scanned[::-1]])
        mirrored = np.concatenate([mirrored, mirrored[:, ::-1]], axis=1)[::4, ::4]
        stretch, tall = rng.uniform(0.6, 2.5), rng.choice([0.04, 0.15, 0.35], p=[0.5, 0.3, 0.2])
        layers.append(((mirrored - mirrored.mean()) / mirrored.std(), 16.0 * stretch, tall, turns[1]))
    if rng.random() < 0.5:
        layers.append((crests.astype(np.float64), rng.uniform(1.5, 6.0), rng.uniform(0.003, 0.025), turns[2]))
    steep = rng.normal(0.0, 0.08, 2)
    tall = rng.uniform(0.5, 3.0) if rng.random() < 0.2 else 0.0
    step = (tall, rng.uniform(0, 2 * math.pi), rng.uniform(2.0, 8.0), rng.uniform(0.3, 2.0))
    return Bed(tuple(layers), (float(steep[0]), float(steep[1])), step, level)
