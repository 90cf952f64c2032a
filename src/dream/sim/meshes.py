"""The shapes that worlds are furnished with: shells, clumps of shells, boulders, pipes and walls."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from dream.sim.sampling import (
    MILLIMETRE,
    Float64Array,
    directions,
    quantised,
    uniform,
    uniforms,
    unit_vectors,
)
from dream.sim.world import Mesh

Faces = npt.NDArray[np.int32]


def mesh(
    vertices: Float64Array, faces: npt.ArrayLike, colors: npt.ArrayLike, *, two_sided: bool = False
) -> Mesh:
    """A mesh with its vertices rounded to whole millimetres and its colours to whole steps."""
    return Mesh(
        quantised(vertices, MILLIMETRE).astype(np.float32),
        np.asarray(faces, np.int32),
        np.clip(np.rint(np.asarray(colors, np.float64)), 0, 255).astype(np.uint8),
        two_sided,
    )


def icosphere(subdivisions: int) -> tuple[Float64Array, Faces]:
    """Vertices (V, 3) on the unit sphere and faces (F, 3); 20·4ⁿ triangles of nearly equal size."""
    g = 0.5 * (1.0 + math.sqrt(5.0))
    corners = [
        (-1.0, g, 0.0),
        (1.0, g, 0.0),
        (-1.0, -g, 0.0),
        (1.0, -g, 0.0),
        (0.0, -1.0, g),
        (0.0, 1.0, g),
        (0.0, -1.0, -g),
        (0.0, 1.0, -g),
        (g, 0.0, -1.0),
        (g, 0.0, 1.0),
        (-g, 0.0, -1.0),
        (-g, 0.0, 1.0),
    ]
    sides = "0 11 5 0 5 1 0 1 7 0 7 10 0 10 11 1 5 9 5 11 4 11 10 2 10 7 6 7 1 8"
    sides += " 3 9 4 3 4 2 3 2 6 3 6 8 3 8 9 4 9 5 2 4 11 6 2 10 8 6 7 9 8 1"
    vertices = np.array(corners)
    faces = np.array([int(word) for word in sides.split()], np.int32).reshape(-1, 3)
    for _ in range(subdivisions):
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        unique, inverse = np.unique(edges, axis=0, return_inverse=True)
        middle = (len(vertices) + inverse.reshape(3, -1)).astype(np.int32)
        ab, bc, ca = middle
        vertices = np.concatenate([vertices, 0.5 * (vertices[unique[:, 0]] + vertices[unique[:, 1]])])
        a, b, c = faces.T
        faces = np.concatenate(
            [np.stack(corner, 1) for corner in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
        )
    return vertices / np.sqrt((vertices * vertices).sum(axis=1, keepdims=True)), faces


def boulder(rng: np.random.Generator, *, planes: int = 16, subdivisions: int = 3) -> Mesh:
    """A weathered rock about 2 m across: a ball cut by random planes, with worn corners and a silted top.

    Args:
        rng: Source of the shape.
        planes: Few give a slab-sided block, many a cobble.
        subdivisions: Of the sphere it is made from; 3 gives 1,280 triangles.
    """
    ball, faces = icosphere(subdivisions)
    normals, distances = unit_vectors(rng, planes), uniforms(rng, 0.68, 0.95, planes)
    reach = np.ones(len(ball))
    for normal, distance in zip(normals, distances, strict=True):
        along = ball[:, 0] * normal[0] + ball[:, 1] * normal[1] + ball[:, 2] * normal[2]
        cut = distance / np.maximum(along, 0.3)
        # A soft minimum wears the corner between neighbouring cuts.
        h = np.clip(0.5 + (cut - reach) / 0.16, 0.0, 1.0)
        reach = reach * h + cut * (1.0 - h) - 0.08 * h * (1.0 - h)
    grain = np.zeros(len(ball))
    for normal in unit_vectors(rng, 14):
        along = ball[:, 0] * normal[0] + ball[:, 1] * normal[1] + ball[:, 2] * normal[2]
        t = 2.3 * along + uniform(rng, 0.0, 1.0)
        t = t - np.floor(t)
        grain += 16.0 * t * t * (1.0 - t) * (1.0 - t) - 0.533
    vertices = ball * (reach + 0.012 * grain)[:, None]
    # The lower half is nearly upright: a rock stands on a broad foot, not on a point.
    below = np.minimum(ball[:, 2], 0.0)
    spread = 1.0 / np.sqrt(np.maximum(1.0 - below * below, 0.3))
    vertices[:, :2] *= (0.1 + 0.9 * spread)[:, None]
    silt = np.clip(1.4 * ball[:, 2] - 0.2 + 0.12 * grain, 0.0, 1.0)[:, None]
    stone = np.array([98.0, 94.0, 86.0]) * (1.0 + 0.07 * grain)[:, None]
    growth = np.array([116.0, 112.0, 78.0]) * (1.0 + 0.05 * grain)[:, None]
    return mesh(vertices, faces, (1.0 - silt) * stone + silt * growth)


def shell(rng: np.random.Generator) -> Mesh:
    """One oyster shell lying flat, 1 m long from hinge to lip, to be scaled: 20 triangles."""
    vertices, faces, colors = _valve(rng)
    vertices[:, 0] -= 0.5
    vertices[:, 2] -= vertices[:, 2].min()
    return mesh(vertices, faces, colors)


def clump(rng: np.random.Generator) -> Mesh:
    """A clump of about a dozen shells that grow up and out of one base, 1 m across, to be scaled."""
    count = 10 + int(rng.random() * 4)
    parts, colors, faces, total = [], [], [], 0
    for number in range(count):
        vertices, triangles, color = _valve(rng)
        # Inner shells stand, outer ones lie half over; the golden angle spreads them evenly.
        outward = number / (count - 1)
        lean = 0.85 - 0.7 * outward + uniform(rng, -0.4, 0.4)
        azimuth = 2.399963 * number + uniform(rng, -0.7, 0.7)
        roll = uniform(rng, 0.0, 2.0 * math.pi)
        size = uniform(rng, 0.6, 1.0)
        (cl, sl), (ca, sa), (cr, sr) = directions(np.array([lean, azimuth, roll]))
        x, y, z = (size * vertices).T
        y, z = cr * y - sr * z, sr * y + cr * z
        x, z = cl * x - sl * z, sl * x + cl * z
        x, y = ca * x - sa * y, sa * x + ca * y
        base = uniform(rng, -0.15, 0.4) * outward
        parts.append(np.stack([x + base * ca, y + base * sa, z], axis=1))
        faces.append(triangles + total)
        colors.append(color)
        total += len(vertices)
    vertices = np.concatenate(parts)
    across = np.sqrt(np.square(vertices[:, :2]).sum(axis=1).max())
    vertices *= 0.5 / across
    # Silt hides the lowest fifth; the base lies at z = 0 and what is below it is in the ground.
    vertices[:, 2] *= 0.48 / vertices[:, 2].max()
    return mesh(vertices, np.concatenate(faces), np.concatenate(colors))


def post(radius: float, height: float, sides: int, color: tuple[int, int, int]) -> Mesh:
    """A closed upright cylinder; its foot is at z = 0."""
    ring = radius * directions(2.0 * math.pi / sides * np.arange(sides))
    low = np.concatenate([ring, np.zeros((sides, 1))], 1)
    high = np.concatenate([ring, np.full((sides, 1), height)], 1)
    centres = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, height]])
    a = np.arange(sides)
    b = (a + 1) % sides
    faces = [
        *zip(a, b, b + sides, strict=True),
        *zip(a, b + sides, a + sides, strict=True),
        *zip(b, a, np.full(sides, 2 * sides), strict=True),
        *zip(a + sides, b + sides, np.full(sides, 2 * sides + 1), strict=True),
    ]
    vertices = np.concatenate([low, high, centres])
    return mesh(vertices, np.array(faces), np.broadcast_to(color, (len(vertices), 3)))


def ring_wall(
    radius: float, thickness: float, height: float, sides: int, color: tuple[int, int, int]
) -> Mesh:
    """A closed round wall about the origin: `radius` to its inner face, foot at z = 0."""
    around = directions(2.0 * math.pi / sides * np.arange(sides))
    rings = [(radius, 0.0), (radius, height), (radius + thickness, height), (radius + thickness, 0.0)]
    vertices = np.concatenate([np.concatenate([r * around, np.full((sides, 1), z)], 1) for r, z in rings])
    a = np.arange(sides)
    b = (a + 1) % sides
    faces = []
    for ring in range(4):
        low, high = ring * sides, (ring + 1) % 4 * sides
        faces += [
            *zip(b + low, a + low, a + high, strict=True),
            *zip(b + low, a + high, b + high, strict=True),
        ]
    return mesh(vertices, np.array(faces), np.broadcast_to(color, (len(vertices), 3)))


def _valve(rng: np.random.Generator) -> tuple[Float64Array, Faces, Float64Array]:
    """A cupped, tear-shaped plate from the hinge at the origin to the lip at x = 1, convex side up."""
    along = np.array([0.0, 0.28, 0.7, 0.97, 0.98, 0.7, 0.28, 0.0]) + uniforms(rng, -0.04, 0.04, 8)
    width = uniform(rng, 0.27, 0.4)
    across = width * np.array([0.16, 0.74, 1.0, 0.5, -0.45, -0.96, -0.78, -0.16]) + uniforms(
        rng, -0.04, 0.04, 8
    )
    bend = uniform(rng, -0.15, 0.15)
    rim = np.stack([along, across + bend * along * along, uniforms(rng, -0.04, 0.04, 8)], axis=1)
    spine_x = np.array([0.3, 0.68])
    spine_y = bend * spine_x * spine_x
    dome = uniform(rng, 0.13, 0.2)
    top = np.stack([spine_x, spine_y, np.array([dome, 0.75 * dome])], axis=1)
    low = np.stack([spine_x, spine_y, np.array([-0.3, -0.15]) * dome], axis=1)
    vertices = np.concatenate([rim, top, low])
    upper = [(1, 0, 8), (0, 7, 8), (7, 6, 8), (6, 9, 8), (6, 5, 9), (5, 4, 9), (4, 3, 9), (3, 2, 9)]
    upper += [(2, 1, 9), (1, 8, 9)]
    # The same fan turned over, on the lower spine, closes the plate.
    lower = [(a, c + 2 * (c >= 8), b + 2 * (b >= 8)) for a, b, c in upper]
    brightness = uniform(rng, 0.75, 1.15)
    bleached = rng.random() < 0.18
    body = np.array([178.0, 170.0, 152.0] if bleached else [134.0, 124.0, 105.0])
    lip = np.array([214.0, 207.0, 190.0])
    hinge = np.array([74.0, 68.0, 54.0])
    share = np.clip((along - 0.5) / 0.6, 0.0, 1.0)[:, None]
    rims = (1.0 - share) * (hinge + (body - hinge) * np.clip(2.0 * along, 0.0, 1.0)[:, None]) + share * lip
    colors = np.concatenate([rims, [body, body * 1.08], [lip * 0.9, lip]]) * brightness
    return vertices, np.array(upper + lower, np.int32), colors
