"""How clumps of oysters come to stand on the bed, on a ledge or on the side of a rock, and make groups."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from dream.geometry import Bounds
from dream.sim.habitats.arena import NoRoomError, log_uniform
from dream.sim.meshes import clump
from dream.sim.reefs import PITCH, VARIANTS, places_in, renumbered
from dream.sim.sampling import (
    FACTOR,
    MILLIMETRE,
    QUATERNION,
    Float64Array,
    indices,
    quantised,
    steady,
    uniforms,
    yaw_and_tilt,
)
from dream.sim.terrain import SPACING, Noise, smoothstep
from dream.sim.world import Instances, Mesh, Terrain

FEWEST, MOST = 60, 6000
"""Individuals of a world."""
SPARE = 1.4
"""Times the fewest that are sown at least, since some are left out: on too small an island, or too near."""
PIECE = 6.5
"""Metres: a larger patch is cut into groups about so wide."""
SUNK = 0.05, 0.15
"""Share of its width that a clump sits in what it grows on."""
SLACK = 0.002
"""Metres by which a group is larger than what is promised, so that rounding does not break the promise."""

IntpArray = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Bottom:
    """The seabed of an arena, and what stands on it, before oysters grow."""

    bounds: Bounds
    seabed: Terrain
    meshes: tuple[Mesh, ...]
    obstacles: Instances
    bare: Float64Array
    """(T, 3) circles x, y, radius on the bed where none grow: the feet of what stands on it."""

    def normals(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """(K, 3) upward normals of length 1 of the seabed, over a hand's breadth."""
        wide = 0.1
        east = (self.seabed.height(x + wide, y) - self.seabed.height(x - wide, y)) / (2.0 * wide)
        north = (self.seabed.height(x, y + wide) - self.seabed.height(x, y - wide)) / (2.0 * wide)
        up = np.stack([-east, -north, np.ones_like(east)], axis=1)
        return np.asarray(up / np.sqrt(east * east + north * north + 1.0)[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Where K clumps sit."""

    points: Float64Array
    """(K, 3) metres, on the surface."""
    normals: Float64Array
    """(K, 3) of length 1, outwards."""
    group: IntpArray
    """(K,) from 0."""

    def __len__(self) -> int:
        return len(self.points)


class Habitat(Protocol):
    """Something that oysters grow on, in an arena or a part of one."""

    @property
    def group_radius(self) -> float:
        """Metres: no group of it is smaller."""

    def relief(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """(N, M) metres that it raises the open bed at x (1, M) and y (N, 1)."""

    def kept_free(self) -> Float64Array:
        """(T, 3) circles x, y, radius where no boulder may stand."""

    def places(self, bottom: Bottom, most: int, rng: np.random.Generator) -> Places:
        """Where its clumps sit, so many at most."""


class Cover(Protocol):
    """How much of its full density a habitat has at each place."""

    def share(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """0 to 1, of arrays that broadcast."""


@dataclass(frozen=True, slots=True, eq=False)
class Crust:
    """The small pattern of a bed: bare spots less than a metre across, in denser and sparser stretches."""

    holes: Noise
    stands: Noise
    bare: float
    """Share of the full density that a bare spot has."""

    @staticmethod
    def over(bounds: Bounds, bare: float, rng: np.random.Generator) -> Crust:
        """As that of the reefs of dream-v1."""
        return Crust(Noise.over(bounds, 0.55, rng), Noise.over(bounds, 2.2, rng), bare)

    def at(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """From `bare` to 1."""
        grown = smoothstep(-0.4, 0.3, self.holes.at(x, y) + 0.3 * self.stands.at(x, y))
        return self.bare + (1.0 - self.bare) * grown

    def rough(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """Metres about 0: the surface of old shell varies by about 10 cm."""
        return 0.03 * self.stands.at(x, y) + 0.03 * self.holes.at(x, y)


def islands(cover: Cover, bounds: Bounds, least: float) -> IntpArray:
    """(N, M) the patch of each square of 0.25 m in the bounds, from the south-west, 0 where none is.

    Patches that are smaller than a radius of `least` are left out.
    """
    from scipy import ndimage

    cols, rows = (round(side / SPACING) for side in (bounds.width, bounds.depth))
    x = bounds.x_min + (np.arange(cols, dtype=np.float64) + 0.5) * SPACING
    y = bounds.y_min + (np.arange(rows, dtype=np.float64) + 0.5) * SPACING
    found, _ = ndimage.label(cover.share(x[None, :], y[:, None]) > 0.0, structure=np.ones((3, 3)))
    label = np.asarray(found, np.intp)
    for number, box in enumerate(ndimage.find_objects(label), start=1):
        row, col = np.nonzero(label[box] == number)
        away = np.hypot(row - row.mean(), col - col.mean()).max() * SPACING
        # A group that fills such an island sparsely is smaller than it.
        if away < least + SPACING:
            label[box][label[box] == number] = 0
    return label


def spread(
    cover: Cover,
    crust: Crust,
    published: tuple[float, float],
    least: float,
    bottom: Bottom,
    most: int,
    rng: np.random.Generator,
) -> Places:
    """Clumps on the seabed under a cover, in groups.

    Args:
        cover: Where.
        crust: In what small pattern.
        published: Clumps to the square metre of the surface of the patches, from least to most.
        least: Metres, the smallest radius of a group.
        bottom: What they grow on.
        most: Clumps.
        rng: Source of density and places.
    """
    bounds = bottom.bounds
    label = islands(cover, bounds, least)
    x, y = places_in(bounds, PITCH, rng)
    inside = bounds.covers(x, y)
    x, y, luck = x[inside], y[inside], rng.random(len(x))[inside]
    row = np.clip((y - bounds.y_min) / SPACING, 0, label.shape[0] - 1).astype(np.intp)
    col = np.clip((x - bounds.x_min) / SPACING, 0, label.shape[1] - 1).astype(np.intp)
    patch = label[row, col]
    grown = np.flatnonzero(patch > 0)
    grown = grown[~_within(bottom.bare, x[grown], y[grown])]
    x, y, luck, patch = x[grown], y[grown], luck[grown], patch[grown]
    share = cover.share(x, y)
    within = share > 0.0
    x, y, luck, patch, share = x[within], y[within], luck[within], patch[within], share[within]
    normals = bottom.normals(x, y)
    area = float((PITCH * PITCH / normals[:, 2]).sum())
    density = density_in(published, area, most, rng)
    suitable = share * crust.at(x, y) / normals[:, 2]
    chosen = np.argsort(luck / suitable, kind="stable")[: round(density * area)]
    x, y, patch = quantised(x[chosen], MILLIMETRE), quantised(y[chosen], MILLIMETRE), patch[chosen]
    group = pieces(x, y, patch, bounds, least, rng)
    kept = group >= 0
    x, y = x[kept], y[kept]
    points = np.stack([x, y, bottom.seabed.height(x, y)], axis=1)
    return Places(points, bottom.normals(x, y), group[kept])


def density_in(published: tuple[float, float], area: float, most: int, rng: np.random.Generator) -> float:
    """Clumps to the square metre, evenly on a scale of logarithms, of what is published and gives a world.

    Args:
        published: From least to most.
        area: Square metres that there are.
        most: Clumps; `FEWEST` and some to spare are the least.
        rng: Source of it.

    Raises:
        NoRoomError: No published density gives so few or so many.
    """
    low, high = max(published[0], SPARE * FEWEST / area), min(published[1], most / area)
    if low > high:
        raise NoRoomError(
            f"density: expected {published[0]:g} to {published[1]:g} clumps to the square metre to give "
            f"{FEWEST} to {most} on {area:.0f} m²"
        )
    return log_uniform(rng, low, high)


def pieces(
    x: Float64Array, y: Float64Array, patch: IntpArray, bounds: Bounds, least: float, rng: np.random.Generator
) -> IntpArray:
    """(K,) the group of each clump, from 0; −1 of those in a patch that is too small for any.

    A patch is cut about points that lie `PIECE` metres apart, more or less; a piece that is smaller than a
    radius of `least` goes to the one beside it.
    """
    cols, rows = (math.ceil(side / PIECE) + 1 for side in (bounds.width, bounds.depth))
    shift = uniforms(rng, -0.3, 0.3, (2, rows, cols))
    seed_x = bounds.x_min + (np.arange(cols)[None, :] + shift[0]) * PIECE
    seed_y = bounds.y_min + (np.arange(rows)[:, None] + shift[1]) * PIECE
    row0 = np.rint((y - bounds.y_min) / PIECE).astype(np.intp)
    col0 = np.rint((x - bounds.x_min) / PIECE).astype(np.intp)
    best, seed = np.full(len(x), np.inf), np.zeros(len(x), np.intp)
    for down in (-1, 0, 1):
        for along in (-1, 0, 1):
            row, col = np.clip(row0 + down, 0, rows - 1), np.clip(col0 + along, 0, cols - 1)
            away = steady(np.square(x - seed_x[row, col]) + np.square(y - seed_y[row, col]))
            nearer = away < best
            best = np.where(nearer, away, best)
            seed = np.where(nearer, row * cols + col, seed)
    _, group = np.unique(patch * rows * cols + seed, return_inverse=True)
    group = group.astype(np.intp)
    for number in np.unique(patch):
        _merge(group, np.flatnonzero(patch == number), x, y, least + SLACK)
    return renumbered(group.astype(np.int32)).astype(np.intp)


def _merge(group: IntpArray, which: IntpArray, x: Float64Array, y: Float64Array, least: float) -> None:
    """Join the groups of one patch, the clumps `which`, until none is too small; −1 where that cannot be."""
    while True:
        names = np.unique(group[which])
        members = [which[group[which] == name] for name in names]
        middles = np.array([(x[own].mean(), y[own].mean()) for own in members])
        radii = [
            math.sqrt(float((np.square(x[own] - u) + np.square(y[own] - v)).max()))
            for own, (u, v) in zip(members, middles, strict=True)
        ]
        small = int(np.argmin(radii))
        if radii[small] >= least:
            return
        if len(names) == 1:
            group[which] = -1
            return
        away = steady(np.square(middles - middles[small]).sum(axis=1))
        away[small] = np.inf
        group[members[small]] = names[int(np.argmin(away))]


def clumps(places: Places, rng: np.random.Generator) -> tuple[tuple[Mesh, ...], Instances]:
    """The clumps in those places: each stands along the normal of what it grows on, more or less.

    A clump is 0.17 to 0.34 m across.
    """
    total = len(places)
    size = 0.18 + 0.125 * rng.random(total)
    scale = size[:, None] * uniforms(rng, 0.92, 1.12, (total, 3))
    at = places.points - (uniforms(rng, *SUNK, total) * size)[:, None] * places.normals
    turn = yaw_and_tilt(uniforms(rng, 0.0, 2.0 * math.pi, total), uniforms(rng, -0.12, 0.12, (total, 2)))
    algae = np.square(uniforms(rng, 0.0, 1.0, total))
    tint = uniforms(rng, 0.72, 1.18, total)[:, None] * (1.0 - algae[:, None] * np.array([0.22, 0.08, 0.30]))
    meshes = tuple(clump(rng) for _ in range(VARIANTS))
    return meshes, Instances(
        mesh=indices(rng, VARIANTS, total).astype(np.int32),
        position=quantised(at, MILLIMETRE).astype(np.float32),
        wxyz=quantised(_leaning(places.normals, turn), QUATERNION).astype(np.float32),
        scale=quantised(scale, FACTOR).astype(np.float32),
        tint=quantised(tint, FACTOR).astype(np.float32),
        group=renumbered(places.group.astype(np.int32)),
    )


def _leaning(normals: Float64Array, turn: Float64Array) -> Float64Array:
    """(K, 4) the turns (K, 4) about and near z, then the shortest way from z to the normals (K, 3)."""
    x, y, z = normals.T
    w = 1.0 + z
    length = np.sqrt(w * w + x * x + y * y)
    w, a, b = w / length, -y / length, x / length
    tw, tx, ty, tz = turn.T
    wxyz = np.stack(
        [
            w * tw - a * tx - b * ty,
            w * tx + a * tw + b * tz,
            w * ty + b * tw - a * tz,
            w * tz + a * ty - b * tx,
        ],
        axis=1,
    )
    return np.asarray(wxyz / np.sqrt((wxyz * wxyz).sum(axis=1, keepdims=True)))


def joined(parts: list[Places]) -> Places:
    """All of them; the groups of each come after those before."""
    past, groups = 0, []
    for part in parts:
        groups.append(part.group + past)
        past += int(part.group.max(initial=-1)) + 1
    return Places(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate(groups),
    )


def _within(circles: Float64Array, x: Float64Array, y: Float64Array) -> npt.NDArray[np.bool_]:
    """(K,) does a circle, of (T, 3), hold the point?"""
    found = np.zeros(len(x), np.bool_)
    for east, north, radius in circles:
        found |= np.square(x - east) + np.square(y - north) <= radius * radius
    return found
