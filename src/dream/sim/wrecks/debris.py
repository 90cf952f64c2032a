"""What lies about a wreck: plates, pipes, timbers, drums."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from dream.sim.sampling import index, power
from dream.sim.wrecks.paint import OLD_TIMBER, RUST, Paint
from dream.sim.wrecks.shapes import Part, beam, rounded, sheet, squared, turn

Piece = Callable[[np.random.Generator, str], Part]
"""A piece of debris in its own frame, lying about the origin on z = 0."""


def plate(rng: np.random.Generator, region: str) -> Part:
    """A bent piece of shell plating."""
    length, width = 0.7 + 0.9 * rng.random(), 0.5 + 0.5 * rng.random()
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 17), np.linspace(-0.5, 0.5, 9), indexing="ij")
    bend, twist = 0.18 * rng.random(), 0.2 * (rng.random() - 0.5)
    skew = 0.3 * (rng.random() - 0.5)
    z = bend * (0.5 - 2 * u * u) + twist * u * v * 2
    points = np.stack([length * u + skew * v, width * v * (1 + 0.4 * u), z + 0.05], axis=-1)
    return sheet(points, region, RUST, two_sided=True).moved(turn("y", 0.2 * (rng.random() - 0.5)))


def pipe(rng: np.random.Generator, region: str) -> Part:
    """A length of pipe."""
    radius = 0.07 + 0.08 * rng.random()
    half = 0.5 + 1.0 * rng.random()
    path = np.array([(-half, 0.0, 0.6 * radius), (half, 0.0, 0.6 * radius + 0.12 * rng.random())])
    return beam(path, radius * rounded(7), region, RUST, around=1)


def girder(rng: np.random.Generator, region: str) -> Part:
    """A bent frame of the hull."""
    half, bow = 0.7 + 0.8 * rng.random(), 0.5 * rng.random()
    s = np.linspace(-1, 1, 33)
    path = np.stack([half * s, bow * (1 - s * s), np.full_like(s, 0.09)], axis=1)
    return beam(path, squared(0.1, 0.22), region, RUST, around=1)


def drum(rng: np.random.Generator, region: str) -> Part:
    """A barrel on its side, sunk in to the middle."""
    path = np.array([(-0.45, 0.0, 0.06), (0.45, 0.0, 0.06 + 0.1 * rng.random())])
    paint = Paint((70, 84, 92), (128, 76, 46), 0.6, 0.4)
    return beam(path, 0.3 * rounded(10), region, paint, around=2)


def timber(rng: np.random.Generator, region: str) -> Part:
    """A squared timber, perhaps a rib that has fallen."""
    half, bow = 0.6 + 1.1 * rng.random(), 0.7 * float(power(rng.random(), 2.0))
    s = np.linspace(-1, 1, 33)
    path = np.stack([half * s, bow * (1 - s * s), 0.08 + 0.05 * s * (rng.random() - 0.5)], axis=1)
    return beam(path, squared(0.16 + 0.1 * rng.random(), 0.2), region, OLD_TIMBER, around=1)


def board(rng: np.random.Generator, region: str) -> Part:
    """A plank lying flat."""
    half = 0.6 + 1.2 * rng.random()
    path = np.array([(-half, 0.0, 0.05), (half, 0.0, 0.05 + 0.08 * rng.random())])
    return beam(path, squared(0.32, 0.06), region, OLD_TIMBER, around=1)


def debris_field(x: float, y: float) -> str:
    """The group of what lies at a place: a square of 6 m of the ground."""
    return f"debris {math.floor(x / 6.0 + 0.5)} {math.floor(y / 6.0)}"


def scattered(
    rng: np.random.Generator,
    pieces: Sequence[Piece],
    count: int,
    half_length: float,
    half_beam: float,
    *,
    middle: tuple[float, float] = (0.0, 0.0),
) -> list[Part]:
    """Pieces strewn about a rectangle of ground, most of them close to it, none farther than 4.5 m.

    They belong to fields, see `debris_field`.
    """
    parts = []
    for _ in range(count):
        piece = pieces[index(rng, len(pieces))]
        side = 1 if rng.random() < 0.5 else -1
        away = 0.6 + 3.6 * float(power(rng.random(), 1.6))
        if rng.random() < 0.8:
            x = (2 * rng.random() - 1) * (half_length + 1.0)
            y = side * (half_beam + away)
        else:
            x = side * (half_length + 0.6 * away)
            y = (2 * rng.random() - 1) * (half_beam + 1.0)
        x, y = x + middle[0], y + middle[1]
        parts.append(piece(rng, debris_field(x, y)).moved(turn("z", 2 * np.pi * rng.random()), (x, y, 0.0)))
    return parts
