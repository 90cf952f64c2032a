"""Oyster reefs: from strokes on a map to clumps of shells on the seabed.

Densities, clump sizes and relief follow surveys of live reefs: 8 to 13 clumps to the square metre
of reef on average, grown together in crusts with bare spots of up to a metre between them, a mound
of 5 to 20 cm, and a surface whose height varies by about 10 cm.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.geometry import Bounds
from dream.sim.meshes import clump
from dream.sim.reef_shapes import Stroke
from dream.sim.sampling import (
    FACTOR,
    MILLIMETRE,
    QUATERNION,
    Float64Array,
    indices,
    quantised,
    uniform,
    uniforms,
    yaw_and_tilt,
)
from dream.sim.terrain import Noise, smoothstep
from dream.sim.world import Instances, Int32Array, Mesh, Terrain

FEWEST, MOST = 800, 3000
"""Individuals of a reef."""
VARIANTS = 10
"""Different clumps."""
PITCH = 0.14
"""Metres between the places where a clump may sit, before they are jittered."""


@dataclass(frozen=True, slots=True, eq=False)
class Bed:
    """The ground that a reef grows on.

    A group is one patch, or one piece of a string, fringe or letter about 6.5 m long.
    """

    strokes: tuple[Stroke, ...]
    rim: Noise
    """Makes the outline ragged."""
    holes: Noise
    """Bare spots less than a metre across."""
    stands: Noise
    """Dense and sparse stretches of a few metres."""
    vigour: Float64Array
    """(G,) density of each group, relative to the others."""

    @staticmethod
    def of(strokes: list[Stroke], bounds: Bounds, rng: np.random.Generator) -> Bed:
        """A bed on these strokes in that box."""
        return Bed(
            tuple(strokes),
            Noise.over(bounds, 1.3, rng),
            Noise.over(bounds, 0.55, rng),
            Noise.over(bounds, 2.2, rng),
            uniforms(rng, 0.6, 1.25, sum(stroke.pieces for stroke in strokes)),
        )

    def cover(self, x: Float64Array, y: Float64Array) -> tuple[Float64Array, npt.NDArray[np.intp]]:
        """How much a part of the reef each point is, 0 to 1, and the group it belongs to.

        The outline keeps at least 1.5 m from the centre line, so that no group is thinner than that.
        """
        x, y = np.broadcast_arrays(x, y)
        inside, group = np.zeros(x.shape), np.zeros(x.shape, np.intp)
        near = self._near(x, y)
        inside[near], group[near] = self._cover(x[near], y[near])
        return inside, group

    def _near(self, x: Float64Array, y: Float64Array) -> npt.NDArray[np.bool_]:
        """A quick test on squares of a metre that spares most points the distances."""
        lines = np.concatenate([stroke.line for stroke in self.strokes])
        west, south = np.floor(lines.min(axis=0)) - 6.0
        cols, rows = (np.ceil(np.ptp(lines, axis=0)) + 14.0).astype(np.intp)
        marked = np.zeros((rows, cols), np.bool_)
        for stroke in self.strokes:
            reach = math.ceil(stroke.half_width + 1.5)
            for (ax, ay), (bx, by) in itertools.pairwise(stroke.line - (west, south)):
                west_end, east_end = math.floor(min(ax, bx)) - reach, math.floor(max(ax, bx)) + reach
                south_end, north_end = math.floor(min(ay, by)) - reach, math.floor(max(ay, by)) + reach
                marked[south_end : north_end + 1, west_end : east_end + 1] = True
        col, row = np.floor(x - west).astype(np.intp), np.floor(y - south).astype(np.intp)
        valid = (col >= 0) & (col < cols) & (row >= 0) & (row < rows)
        valid &= marked[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)]
        return np.asarray(valid, np.bool_)

    def _cover(self, x: Float64Array, y: Float64Array) -> tuple[Float64Array, npt.NDArray[np.intp]]:
        """`cover` of a list of points."""
        inside, group = np.zeros(len(x)), np.zeros(len(x), np.intp)
        ragged = self.rim.at(x, y)
        offset = 0
        for stroke in self.strokes:
            distance, along = stroke.nearest(x, y)
            give = min(0.6, stroke.half_width - 1.5)
            edge = stroke.half_width + give * np.clip(ragged, -1.0, 1.0) - distance
            share = np.clip((edge + 0.15) / 0.6, 0.0, 1.0)
            mine = share > inside
            inside = np.where(mine, share, inside)
            piece = np.minimum((along * stroke.pieces).astype(np.intp), stroke.pieces - 1)
            group = np.where(mine, offset + piece, group)
            offset += stroke.pieces
        return inside, group

    def relief(self, x: Float64Array, y: Float64Array, height: float) -> Float64Array:
        """Metres that the reef's old shell raises the seabed: a mound `height` metres high, rough on top."""
        inside, _ = self.cover(x, y)
        x, y = np.broadcast_arrays(x, y)
        reef = inside > 0.0
        rough = 0.5 * self.stands.at(x[reef], y[reef]) + 0.5 * self.holes.at(x[reef], y[reef])
        raised = np.zeros(inside.shape)
        raised[reef] = smoothstep(0.0, 1.0, inside[reef]) * np.maximum(height + 0.06 * rough, 0.02)
        return raised

    def suitability(self, x: Float64Array, y: Float64Array) -> tuple[Float64Array, npt.NDArray[np.intp]]:
        """How likely a clump sits at each point (N,), relative to the others, and the group of the point."""
        inside, group = self.cover(x, y)
        overgrown = smoothstep(-0.4, 0.3, self.holes.at(x, y) + 0.3 * self.stands.at(x, y))
        return inside * (0.03 + 0.97 * overgrown) * self.vigour[group], group


def places_in(bounds: Bounds, pitch: float, rng: np.random.Generator) -> tuple[Float64Array, Float64Array]:
    """x and y, (K,) each, of the places in a box where a clump may sit: about `pitch` metres apart."""
    cols, rows = (math.ceil(side / pitch) for side in (bounds.width, bounds.depth))
    east = bounds.x_min + (np.arange(cols) + 0.5) * pitch
    north = bounds.y_min + (np.arange(rows) + 0.5) * pitch
    x = (east[None, :] + uniforms(rng, -0.45, 0.45, (rows, cols)) * pitch).ravel()
    y = (north[:, None] + uniforms(rng, -0.45, 0.45, (rows, cols)) * pitch).ravel()
    return x, y


def individuals(
    bed: Bed, terrain: Terrain, bare: Float64Array, bounds: Bounds, rng: np.random.Generator
) -> tuple[tuple[Mesh, ...], Instances]:
    """The clumps of a reef on its terrain, 800 to 3,000 of them, some stacked on others.

    A clump is 0.15-0.35 m across and its top less than 0.35 m above the seabed.

    Args:
        bed: Where they grow.
        terrain: What they sit on.
        bare: (T, 3) circles x, y, radius without any: the feet of boulders.
        bounds: Of the arena.
        rng: Source of places, sizes and poses.
    """
    x, y = places_in(bounds, PITCH, rng)
    luck = rng.random(len(x))
    grown = bed.cover(x, y)[0] > 0.0
    for x_bare, y_bare, radius in bare:
        grown &= np.square(x - x_bare) + np.square(y - y_bare) > radius * radius
    x, y, luck = x[grown], y[grown], luck[grown]
    suitable, group = bed.suitability(x, y)
    area = len(x) * PITCH * PITCH
    wanted = min(max(round(uniform(rng, 8.0, 13.0) * area), FEWEST), MOST)
    stacked = round(0.1 * wanted)
    # The least of luck / suitability: a draw without replacement that favours suitable places.
    chosen = np.argsort(luck / suitable, kind="stable")[: wanted - stacked]
    x, y, group = x[chosen], y[chosen], group[chosen]
    size = 0.18 + 0.125 * rng.random(len(x))
    # The best places come first: they carry a second, smaller storey.
    upper = np.arange(stacked)
    lean = uniforms(rng, -0.3, 0.3, (len(upper), 2)) * size[upper, None]
    x, y = np.concatenate([x, x[upper] + lean[:, 0]]), np.concatenate([y, y[upper] + lean[:, 1]])
    group = np.concatenate([group, group[upper]])
    size = np.concatenate([size, uniforms(rng, 0.165, 0.19, len(upper))])
    raised = np.concatenate([np.zeros(len(chosen)), 0.3 * size[upper]])
    total = len(x)
    stretch = uniforms(rng, 0.92, 1.12, (total, 3))
    scale = size[:, None] * stretch
    x, y = quantised(x, MILLIMETRE), quantised(y, MILLIMETRE)
    z = terrain.height(x, y) + raised - uniforms(rng, 0.05, 0.15, total) * size
    tilt = uniforms(rng, -0.12, 0.12, (total, 2))
    brightness = uniforms(rng, 0.72, 1.18, total)
    algae = uniforms(rng, 0.0, 1.0, total)
    algae = algae * algae
    tint = brightness[:, None] * (1.0 - algae[:, None] * np.array([0.22, 0.08, 0.30]))
    meshes = tuple(clump(rng) for _ in range(VARIANTS))
    return meshes, Instances(
        mesh=indices(rng, VARIANTS, total).astype(np.int32),
        position=quantised(np.stack([x, y, z], 1), MILLIMETRE).astype(np.float32),
        wxyz=quantised(yaw_and_tilt(uniforms(rng, 0.0, 2.0 * math.pi, total), tilt), QUATERNION).astype(
            np.float32
        ),
        scale=quantised(scale, FACTOR).astype(np.float32),
        tint=quantised(tint, FACTOR).astype(np.float32),
        group=group.astype(np.int32),
    )


def renumbered(group: Int32Array) -> Int32Array:
    """Groups 0, 1, 2, ... without gaps, in their old order; −1 stays −1."""
    names, number = np.unique(group[group >= 0], return_inverse=True)
    new = np.full_like(group, -1)
    new[group >= 0] = np.arange(len(names), dtype=np.int32)[number]
    return new
