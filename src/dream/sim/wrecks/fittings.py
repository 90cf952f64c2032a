"""What stands on a deck: houses, funnels, masts, hatches, bitts; and what time does to all of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dream.sim.sampling import cosine, length, sine, steady
from dream.sim.wrecks.paint import OCHRE, RUST, Paint, waves
from dream.sim.wrecks.shapes import FloatArray, Part, beam, box, rounded, squared

_LEAST_FACES = 24
Corner = tuple[float, float, float]


def without(part: Part, low: Corner, high: Corner) -> Part:
    """The part less the faces whose middle lies in an upright box: doors, windows and hatches."""
    middles = part.quad_middles
    inside = np.all((middles > low) & (middles < high), axis=1)
    return part.kept(np.logical_not(inside))


def house(low: Corner, high: Corner, region: str, paint: Paint) -> Part:
    """A deckhouse: four walls and a roof."""
    return box(low, high, region, paint, faces="XxYyZ", two_sided=True)


def glazed(walls: Part, low: Corner, high: Corner, sill: float, head: float) -> Part:
    """The walls of a house between two corners with window openings between two heights.

    The panes are long gone. A mullion of a quarter of a metre is left between two openings.
    """
    middle = walls.quad_middles
    band = (middle[:, 2] > sill) & (middle[:, 2] < head)
    ends = (np.abs(middle[:, 0] - low[0]) < 1e-3) | (np.abs(middle[:, 0] - high[0]) < 1e-3)
    start = np.where(ends, middle[:, 1] - low[1], middle[:, 0] - low[0])
    length = np.where(ends, high[1] - low[1], high[0] - low[0])
    quads = np.maximum(1, np.rint(length / 0.5)) * 2
    quad = np.floor(start / length * quads)
    opening = (quad % 3 != 0) & (quad < quads - 1)
    return walls.kept(~(band & opening))


def funnel(
    foot: Sequence[float],
    height: float,
    radius: float,
    region: str,
    *,
    rake: float = 0.15,
    paint: Paint = OCHRE,
) -> list[Part]:
    """A funnel that leans aft, with a dark inside and a rim."""
    base = np.asarray(foot, np.float64)
    top = base + np.array([-rake * height, 0, height])
    path = np.stack([base, top])
    profile = rounded(12) * (1.0, 1.25)
    collar = np.stack([base + 0.72 * (top - base), base + 0.86 * (top - base)])
    return [
        beam(path, radius * profile, region, paint, across=(1, 0, 0), open_ended=True),
        beam(collar, (radius + 0.05) * profile, region, RUST, across=(1, 0, 0)),
    ]


def mast(foot: Sequence[float], height: float, radius: float, region: str, *, lean: float = 0.0) -> Part:
    """A pole that tapers and leans aft."""
    base = np.asarray(foot, np.float64)
    path = np.stack([base, base + np.array([-lean * height, 0, height])])
    return beam(
        path, radius * rounded(8), region, RUST, across=(1, 0, 0), scale=np.array([1.0, 0.7]), around=1
    )


def spar(
    start: Sequence[float], end: Sequence[float], radius: float, region: str, paint: Paint = RUST
) -> Part:
    """A round bar between two points."""
    path = np.stack([np.asarray(start, np.float64), np.asarray(end, np.float64)])
    steep = abs(path[1, 2] - path[0, 2]) > 0.9 * float(length(path[1] - path[0]))
    return beam(path, radius * rounded(6), region, paint, across=(1, 0, 0) if steep else (0, 0, 1), around=1)


def hatch(low: Corner, high: Corner, region: str) -> Part:
    """A coaming between two corners with its covers on: nothing of the hold shows."""
    return box(low, high, region, RUST, faces="XxYyZ")


def bitts(middle: Sequence[float], spread: float, height: float, region: str) -> list[Part]:
    """Two posts with a crossbar: where the tow was made fast."""
    x, y, z = middle
    posts = [
        beam(
            np.array([(x, y + side * spread / 2, z), (x, y + side * spread / 2, z + height)]),
            0.17 * rounded(8),
            region,
            RUST,
            across=(1, 0, 0),
        )
        for side in (-1, 1)
    ]
    bar = np.array([(x, y - spread * 0.85, z + height * 0.62), (x, y + spread * 0.85, z + height * 0.62)])
    return [*posts, beam(bar, squared(0.26, 0.26), region, RUST)]


def tyre(middle: Sequence[float], outward: Sequence[float], region: str) -> Part:
    """A fender: a tyre that hangs flat against the side."""
    normal = np.asarray(outward, np.float64) / float(length(outward))
    along = np.cross((0.0, 0.0, 1.0), normal)
    along /= length(along)
    angles = np.linspace(0, 2 * np.pi, 33)
    ring = cosine(angles)[:, None] * along + sine(angles)[:, None] * np.cross(normal, along)
    rubber = Paint((40, 40, 40), (56, 52, 46), 0.4, 0.3)
    return beam(
        np.asarray(middle, np.float64) + 0.34 * ring,
        0.12 * rounded(5),
        region,
        rubber,
        across=(float(normal[0]), float(normal[1]), float(normal[2])),
        around=1,
        bends=2,
    )


def dented(parts: Sequence[Part], rng: np.random.Generator, depth: float, wavelength: float) -> list[Part]:
    """All parts bent by one smooth field, so that what touched still touches."""
    fields = [waves(rng, wavelength) for _ in range(3)]

    def displacement(points: FloatArray) -> FloatArray:
        return depth * np.stack([field(points) for field in fields], axis=1)

    return [part.warped(displacement) for part in parts]


def holed(part: Part, rng: np.random.Generator, share: float, *, size: float = 1.2) -> Part:
    """The part with about a share of it rusted through, in holes of about a size."""
    eaten = steady(waves(rng, 2 * size)(part.centroids) + 0.25 * waves(rng, 0.5)(part.centroids))
    left = np.sort(eaten)[round((1 - share) * (len(eaten) - 1))]
    return without_islands(part.kept(eaten <= left))


def collapsed(rail: Part, rng: np.random.Generator, side: int) -> Part:
    """A bulwark sound on one side, of which little stands on the other (±1 in y), where the ship lies low."""
    sound = side * rail.centroids[:, 1] <= 0
    # A hole size and a half of a bay: what is left stands in lengths of a few metres.
    wasted = waves(rng, 5.0)(rail.centroids) + 0.3 * waves(rng, 1.2)(rail.centroids)
    return without_islands(rail.kept(sound | (steady(wasted) > 0.45)))


def without_islands(part: Part) -> Part:
    """The part less what no longer hangs together with more than a few faces of it."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(part.vertices)
    a, b = part.faces[:, [0, 1]].ravel(), part.faces[:, [1, 2]].ravel()
    links = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(count, count))
    island = connected_components(links, directed=False)[1][part.faces[:, 0]]
    return part.kept(np.bincount(island)[island] > _LEAST_FACES)
