"""Square tiles of texture: cells, reaction and diffusion, flakes on each other, spectra of photographs.

All are periodic and have mean 0 and standard deviation 1; rows are those of v, columns of u.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import fft, ndimage
from scipy.spatial import cKDTree

from dream.geometry import FloatArray

Float32Array = npt.NDArray[np.float32]

SIDE = 256
"""Pixels of a tile."""


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """A tile and its ever coarser copies, so that what is far away does not sparkle."""

    levels: tuple[Float32Array, ...]
    """(SIDE, SIDE), then half of that, and so on down to 4."""

    @staticmethod
    def of(tile: FloatArray | Float32Array) -> Texture:
        """A tile (SIDE, SIDE), brought to mean 0 and standard deviation 1."""
        level = ((tile - tile.mean()) / max(float(tile.std()), 1e-9)).astype(np.float32)
        levels = [level]
        while len(level) > 4:
            half = len(level) // 2
            level = level.reshape(half, 2, half, 2).mean(axis=(1, 3), dtype=np.float32)
            levels.append(level)
        return Texture(tuple(levels))

    def at(self, u: Float32Array, v: Float32Array, footprint: Float32Array) -> Float32Array:
        """Values (n,) between the pixels of the level that fits.

        Args:
            u: (n,) in tiles.
            v: (n,) in tiles.
            footprint: (n,) tiles that a pixel of the picture covers.
        """
        values = np.empty(u.shape, np.float32)
        coarse = np.log2(np.maximum(footprint * SIDE, 1.0)) + 0.5
        which = np.minimum(coarse.astype(np.int8), len(self.levels) - 1)
        for n, level in enumerate(self.levels):
            chosen = np.flatnonzero(which == n)
            if len(chosen):
                values[chosen] = _between(level, u[chosen], v[chosen])
        return values


def _between(level: Float32Array, u: Float32Array, v: Float32Array) -> Float32Array:
    """Bilinear in a periodic tile."""
    side = len(level)
    x, y = u * side - 0.5, v * side - 0.5
    left, low = np.floor(x), np.floor(y)
    p, q = x - left, y - low
    i, j = left.astype(np.int32) % side, low.astype(np.int32) % side
    right, high = (i + 1) % side, (j + 1) % side
    flat = level.ravel()
    below = flat[j * side + i] * (1.0 - p) + flat[j * side + right] * p
    above = flat[high * side + i] * (1.0 - p) + flat[high * side + right] * p
    between: Float32Array = below * (1.0 - q) + above * q
    return between


def _frequencies() -> tuple[FloatArray, FloatArray]:
    """Cycles a tile along v and u, of the half plane of a real transform."""
    along_v, along_u = fft.fftfreq(SIDE, 1.0 / SIDE), fft.rfftfreq(SIDE, 1.0 / SIDE)
    v, u = np.meshgrid(along_v, along_u, indexing="ij")
    return v, u


def _of_spectrum(rng: np.random.Generator, amplitude: FloatArray) -> FloatArray:
    """White noise with other amplitudes."""
    return np.asarray(fft.irfft2(fft.rfft2(rng.normal(size=(SIDE, SIDE))) * amplitude, s=(SIDE, SIDE)))


def _lattice() -> FloatArray:
    """(SIDE², 2) places of the pixels in the tile."""
    place = (np.arange(SIDE) + 0.5) / SIDE
    return np.stack(np.meshgrid(place, place), axis=-1).reshape(-1, 2)


def _bent(rng: np.random.Generator, by: float) -> FloatArray:
    """The same places, each moved a little: no straight borders."""
    v, u = _frequencies()
    smooth = 1.0 / (1.0 + (u**2 + v**2) / 9.0) ** 3
    moves = [_of_spectrum(rng, smooth).ravel() for _ in range(2)]
    return np.mod(_lattice() + by * np.stack([move / move.std() for move in moves], axis=-1), 1.0)


def photographic(rng: np.random.Generator) -> Texture:
    """Amplitudes that fall with a power of the frequency, as those of photographs do.

    Reference: Field, Relations between the statistics of natural images and the response properties of
    cortical cells, JOSA A 4 (1987).
    """
    v, u = _frequencies()
    frequency = np.hypot(u, v)
    frequency[0, 0] = np.inf
    return Texture.of(_of_spectrum(rng, frequency ** -rng.uniform(0.7, 1.5)))


def ripples(rng: np.random.Generator) -> Texture:
    """Crests of one spacing that branch and end, as on sand."""
    v, u = _frequencies()
    crests, spread = rng.uniform(6.0, 18.0), rng.uniform(0.08, 0.25)
    direction = np.arctan2(v, u) - rng.uniform(-np.pi / 2, np.pi / 2)
    width = rng.uniform(0.1, 0.5)
    band = np.exp(-0.5 * ((np.hypot(u, v) / crests - 1.0) / spread) ** 2)
    turned = np.exp(-0.5 * (np.sin(direction) / width) ** 2)
    wave = _of_spectrum(rng, band * turned)
    return Texture.of(np.exp(0.6 * wave / wave.std()))


def cells(rng: np.random.Generator) -> Texture:
    """Grains, cracks or pebbles: distances to the nearest of random points.

    Reference: Worley, A cellular texture basis function, SIGGRAPH 1996.
    """
    points = rng.random((int(rng.integers(200, 1500)), 2))
    found = cKDTree(points, boxsize=np.ones(2)).query(_bent(rng, rng.uniform(0.0, 0.01)), k=2)
    near, which = np.asarray(found[0]), np.asarray(found[1])
    scale = np.sqrt(len(points))
    first, gap = near[:, 0] * scale, (near[:, 1] - near[:, 0]) * scale
    kind = rng.integers(3)
    if kind == 0:
        tile = -first
    elif kind == 1:
        tile = -np.exp(-gap / 0.15)
    else:
        tile = rng.normal(size=len(points))[which[:, 0]] * 0.6 + np.minimum(gap, 0.4) * 4.0
    return Texture.of(tile.reshape(SIDE, SIDE))


def leaves(rng: np.random.Generator) -> Texture:
    """Round flakes that cover each other, of sizes by a power law.

    Reference: Lee, Mumford, Huang, Occlusion models for natural images, IJCV 41 (2001).
    """
    least, most = 0.006, 0.12
    share = rng.random(2500)
    radii = (least**-2 + share * (most**-2 - least**-2)) ** -0.5
    grey = rng.normal(size=len(radii))
    tile = np.zeros((SIDE, SIDE))
    pixels = np.arange(SIDE)
    for radius, value, (x, y) in zip(radii, grey, rng.random((len(radii), 2)), strict=True):
        reach = int(np.ceil(radius * SIDE))
        cols, rows = (
            (int(c * SIDE) + np.arange(-reach, reach + 1)) % SIDE if 2 * reach < SIDE else pixels
            for c in (x, y)
        )
        away = [np.abs((p + 0.5) / SIDE - c) for p, c in ((cols, x), (rows, y))]
        dx, dy = (np.minimum(a, 1.0 - a) for a in away)
        inside = dx[None, :] ** 2 + rng.uniform(0.5, 2.0) * dy[:, None] ** 2 < radius**2
        patch = tile[np.ix_(rows, cols)]
        patch[inside] = value
        tile[np.ix_(rows, cols)] = patch
    return Texture.of(ndimage.gaussian_filter(tile, 0.5, mode="wrap"))


FEEDS = ((0.035, 0.060), (0.030, 0.057), (0.037, 0.065), (0.025, 0.060), (0.039, 0.058))
"""Rates of feed and of decay that end in spots, worms or mazes."""


def grown(rng: np.random.Generator) -> Texture:
    """Spots and mazes of two substances that react and diffuse: crusts and growth.

    Reference: Pearson, Complex patterns in a simple system, Science 261 (1993).
    """
    side = SIDE // 2
    feed, decay = FEEDS[rng.integers(len(FEEDS))]
    seeds = ndimage.gaussian_filter(rng.normal(size=(side, side)), 3.0, mode="wrap")
    eaten = np.where(seeds > np.quantile(seeds, 0.8), 0.4, 0.0).astype(np.float32)
    fed = np.where(eaten > 0.0, 0.5, 1.0).astype(np.float32)
    for _ in range(1400):
        spread = [
            np.roll(f, 1, 0) + np.roll(f, -1, 0) + np.roll(f, 1, 1) + np.roll(f, -1, 1) - 4.0 * f
            for f in (fed, eaten)
        ]
        made = fed * eaten * eaten
        fed += 0.16 * spread[0] - made + np.float32(feed) * (1.0 - fed)
        eaten += 0.08 * spread[1] + made - np.float32(feed + decay) * eaten
    tile = np.repeat(np.repeat(eaten, 2, 0), 2, 1).astype(np.float64)
    if tile.std() < 1e-3:
        return photographic(rng)
    return Texture.of(ndimage.gaussian_filter(tile, 0.7, mode="wrap"))


def caustics(rng: np.random.Generator) -> Texture:
    """The light that a wavy surface gathers: rays bent by its slope, counted where they arrive.

    Mean 0 and standard deviation 1, like all; the brightest lines are far above.
    """
    v, u = _frequencies()
    frequency = np.hypot(u, v)
    waves = _of_spectrum(rng, np.where(frequency > 2.0, np.maximum(frequency, 1.0) ** -2.5, 0.0))
    fine = 3
    heights = ndimage.zoom(waves / waves.std(), fine, order=3, mode="grid-wrap", grid_mode=True)
    slopes = [np.roll(heights, -1, axis) - np.roll(heights, 1, axis) for axis in (1, 0)]
    place = (np.arange(SIDE * fine) + 0.5) / (SIDE * fine)
    x, y = np.meshgrid(place, place)
    bent = rng.uniform(0.012, 0.03) / max(float(s.std()) for s in slopes)
    landed = [np.mod(c + bent * s, 1.0).ravel() for c, s in zip((x, y), slopes, strict=True)]
    counted, _, _ = np.histogram2d(landed[1], landed[0], bins=SIDE, range=((0, 1), (0, 1)))
    return Texture.of(ndimage.gaussian_filter(counted, 0.8, mode="wrap"))


KINDS = (photographic, cells, cells, leaves, grown)
"""What surfaces are made of."""


def some_texture(rng: np.random.Generator) -> Texture:
    """Any of them."""
    return KINDS[rng.integers(len(KINDS))](rng)
