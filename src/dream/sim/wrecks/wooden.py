"""A wooden sailing vessel of which the sand has taken half."""

from __future__ import annotations

import math

import numpy as np

from dream.sim.sampling import between, index, power
from dream.sim.wrecks.debris import board, debris_field, scattered, timber
from dream.sim.wrecks.fittings import spar
from dream.sim.wrecks.hull import Bays, HullForm
from dream.sim.wrecks.paint import FRAME_WOOD, OLD_TIMBER, PLANKING, RUST, STONES, waves
from dream.sim.wrecks.shapes import FloatArray, Part, beam, rounded, sheet, squared, turn

_SPACING = 0.72
"""Between the frames."""
_STRAKE = 0.36
"""Width of a plank."""
_FLOOR = Bays((-2.5, 2.5), "floor", sides=False)


def _region(x: float, side: int, length: float) -> str:
    bay = int(np.clip((x / length + 0.5) * 5, 0, 4))
    return f"frames {bay} {'port' if side > 0 else 'starboard'}"


def _frame(form: HullForm, x: float, side: int, top: float, region: str) -> Part:
    """One rib from the turn of the bilge up to a share of the depth."""
    h = np.linspace(0.08, top, 49)
    y = np.array([float(form.half_breadth(np.array([x]), float(share))[0]) for share in h])
    path = np.stack([np.full_like(h, x), side * np.maximum(y - 0.12, 0.12), h * form.depth], axis=1)
    return beam(
        path, squared(0.2, 0.24), region, FRAME_WOOD, across=(1, 0, 0), scale=np.array([1.1, 0.75]), around=1
    )


def _strakes(
    form: HullForm, rng: np.random.Generator, side: int, tops: FloatArray, xs: FloatArray
) -> list[Part]:
    """The planks that still hold, low down, each over a few frames."""
    parts = []
    rows = int(form.depth / _STRAKE)
    for row in range(1, rows):
        h = (row + 0.5) * _STRAKE / form.depth
        line = form.side(h)[::-1] * (1, side, 1)
        line[:, 2] = h * form.depth
        i = 0
        while i < len(xs) - 1:
            j = min(len(xs) - 1, i + 2 + index(rng, 4))
            # High planks went first; none outlives its frames.
            stays = rng.random() < 1.2 - 1.25 * h and h * 1.02 < tops[i : j + 1].min()
            if stays:
                x = np.linspace(xs[i] - 0.1, xs[j] + 0.04, 33)
                path = np.stack(
                    [x, np.interp(x, line[:, 0], line[:, 1]), np.interp(x, line[:, 0], line[:, 2])], axis=1
                )
                path[:, 1] += side * 0.03
                region = _region(float(x.mean()), side, form.length)
                parts.append(beam(path, squared(0.07, _STRAKE - 0.015), region, PLANKING, around=1))
            i = j
    return parts


def wooden(rng: np.random.Generator) -> list[Part]:
    """Ribs in two rows, the planks that are left, both posts, ballast, a windlass and fallen timbers."""
    form = HullForm(
        length=round(16.5 + 2.5 * float(rng.random()), 2),
        beam=round(5.0 + 0.6 * float(rng.random()), 2),
        depth=3.1,
        sheer_fore=0.0,
        sheer_aft=0.0,
        bulwark=0.0,
        entrance=5.5,
        run=5.0,
        rake=0.6,
        overhang=0.4,
        bilge=0.45,
    )
    half = form.length / 2
    xs = np.arange(-half + 1.0, half - 1.1, _SPACING)
    parts: list[Part] = []
    for side in (1, -1):
        decay = waves(rng, 5.0)(np.stack([xs, np.full_like(xs, 3.0 * side), np.zeros_like(xs)], axis=1))
        tops = 0.74 + 0.24 * np.square(xs / half) + 0.16 * decay + 0.18 * (rng.random(len(xs)) - 0.5)
        tops = np.clip(tops, 0.38, 1.02)
        standing = rng.random(len(xs)) < 0.93
        parts += [
            _frame(form, x, side, top, _region(x, side, form.length))
            for x, top, stands in zip(xs.tolist(), tops.tolist(), standing.tolist(), strict=True)
            if stands
        ]
        parts += _strakes(form, rng, side, tops, xs)
    h = np.linspace(0.0, 1.06, 33)
    stem = np.stack([[form.ends(float(share))[0] - 0.15, 0.0, share * form.depth] for share in h])
    post = np.stack([[form.ends(float(share))[1] + 0.25, 0.0, share * form.depth] for share in h[:-6]])
    parts += [
        beam(stem, squared(0.34, 0.4), "bow", OLD_TIMBER, across=(1, 0, 0)),
        beam(post, squared(0.32, 0.36), "stern", OLD_TIMBER, across=(1, 0, 0)),
    ]
    keelson = spar((-half + 2.4, 0.0, 0.85), (half - 2.6, 0.0, 0.85), 0.22, "floor", OLD_TIMBER)
    parts += keelson.divided(_FLOOR)
    parts += _ballast(rng)
    parts += _windlass(form)
    beams = [between(rng, 2, len(xs) // 3 - 1), between(rng, 2 * len(xs) // 3, len(xs) - 4)]
    for i in beams:
        # A deck beam that one knee still holds: its other end lies on the floor.
        x = float(xs[i]) + 0.3
        reach = float(form.half_breadth(np.array([x]), 0.6)[0])
        path = np.array([(x, -reach, 0.58 * form.depth), (x + 0.5, 0.7 * reach, 0.75)])
        parts += beam(path, squared(0.22, 0.22), "floor", OLD_TIMBER, around=1).divided(_FLOOR)
    heel = math.radians(3 + 3 * float(rng.random()))
    lying = turn("y", math.radians(-1.5))
    parts = [part.moved(turn("x", heel)).moved(lying, (0.0, 0.0, -0.7)) for part in parts]
    return parts + _about(rng, form)


def _ballast(rng: np.random.Generator) -> list[Part]:
    """The stones amidships, a low heap that has spread, with single stones on it."""
    u, v = np.meshgrid(np.linspace(-1, 1, 33), np.linspace(-1, 1, 25), indexing="ij")
    lumps = waves(rng, 0.9)(np.stack([2.4 * u.ravel(), 1.5 * v.ravel(), 0 * u.ravel()], axis=1)).reshape(
        u.shape
    )
    height = np.clip(1 - u * u, 0, 1) * np.clip(1 - v * v, 0, 1)
    heap = np.stack(
        [2.4 * u - 0.6, 1.5 * v, 0.4 + 0.75 * height + 0.14 * lumps * power(height, 0.3)], axis=-1
    )
    parts = [sheet(heap, "ballast", STONES)]
    for _ in range(9):
        x, y = 2.0 * (2 * rng.random() - 1) - 0.6, 1.3 * (2 * rng.random() - 1)
        z = 0.4 + 0.75 * max(0.0, 1 - (x + 0.6) * (x + 0.6) / 5.76) * max(0.0, 1 - y * y / 2.25)
        size = 0.16 + 0.1 * rng.random()
        path = np.array([(x - size, y, z), (x + size, y + 0.1, z + 0.08)])
        parts.append(
            beam(
                path,
                size * rounded(6),
                "ballast",
                STONES,
                scale=np.array([0.75, 1.0, 0.6]),
                around=1,
                bends=2,
            )
        )
    return parts


def _windlass(form: HullForm) -> list[Part]:
    """The barrel of the windlass between two bitts, fallen to the floor behind the stem."""
    x = form.length / 2 - 3.4
    region = str(_FLOOR(np.array([(x, 0.0, 0.0)]))[0])
    barrel = np.array([(x, -0.85, 1.25), (x, 0.85, 1.25)])
    posts = [
        beam(
            np.array([(x, y, 0.3), (x, y, 1.75)]),
            squared(0.24, 0.24),
            region,
            OLD_TIMBER,
            across=(1, 0, 0),
            around=1,
        )
        for y in (-1.0, 1.0)
    ]
    return [beam(barrel, 0.26 * rounded(8), region, OLD_TIMBER, around=2), *posts]


def _about(rng: np.random.Generator, form: HullForm) -> list[Part]:
    """What fell outward: ribs, boards, the mast, an anchor off the bow."""
    half, breadth = form.length / 2, form.beam / 2
    side = 1 if rng.random() < 0.5 else -1
    start = np.array([-1.5 + rng.random(), side * (breadth + 1.0), 0.16])
    end = start + np.array([6.2, side * 2.2, -0.06])
    parts = [
        beam(
            np.stack([start, end]),
            0.2 * rounded(8),
            debris_field(2.5, side),
            OLD_TIMBER,
            scale=np.array([1.0, 0.7]),
            around=1,
        )
    ]
    x, y = half + 1.6, -side * 1.4
    parts += _anchor((x, y), 2.2 + 0.5 * float(rng.random()), debris_field(x, y))
    return parts + scattered(rng, (timber, timber, board), 62, half, breadth + 0.2)


def _anchor(place: tuple[float, float], heading: float, region: str) -> list[Part]:
    """An iron anchor lying flat: shank, arms and stock."""
    t = np.linspace(-1, 1, 33)
    arms = np.stack([-1.0 + 0.35 * t * t, 0.7 * t, np.full_like(t, 0.1)], axis=1)
    iron = [
        spar((-1.0, 0.0, 0.12), (1.1, 0.0, 0.1), 0.09, region, RUST),
        beam(arms, squared(0.14, 0.18), region, RUST, around=1),
        spar((0.85, -0.75, 0.14), (0.85, 0.75, 0.1), 0.08, region, OLD_TIMBER),
    ]
    return [part.moved(turn("z", heading), (*place, 0.0)) for part in iron]
