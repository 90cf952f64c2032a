"""Colours of things that have lain in the sea: rust, old paint, wood, growth and silt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.sim.sampling import power, products, sine, unit_vectors

FloatArray = npt.NDArray[np.float64]
Colour = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Waves:
    """A smooth random function of position with values about [−1, 1]: a sum of plane waves."""

    vectors: FloatArray
    """(K, 3) radians per metre."""
    phases: FloatArray
    """(K,) radians."""

    def __call__(self, points: FloatArray) -> FloatArray:
        """Its values (N,) at points (N, 3)."""
        along = products(points, self.vectors) + self.phases
        return np.asarray(sine(along).sum(axis=1) / np.sqrt(len(self.phases)))


def waves(rng: np.random.Generator, wavelength: float, count: int = 7) -> Waves:
    """Plane waves in random directions, their lengths within a factor of 1.5 of the given one."""
    ahead = unit_vectors(rng, count)
    lengths = wavelength * power(1.5, 2 * rng.random(count) - 1)
    return Waves(2 * np.pi / lengths[:, None] * ahead, 2 * np.pi * rng.random(count))


@dataclass(frozen=True, slots=True)
class Paint:
    """What a surface was, what it became, and how much lives on it."""

    old: Colour
    """Where the first coat, or sound wood, is left."""
    bare: Colour
    """Where it is not: rust, or rot."""
    worn: float
    """Share of the surface that is bare."""
    growth: float = 0.45
    """Share of the surface that is overgrown."""


RED_LEAD = Paint((146, 66, 50), (150, 94, 58), 0.5)
BLACK_HULL = Paint((86, 80, 76), (158, 96, 56), 0.6)
GREY_HULL = Paint((128, 132, 130), (152, 92, 56), 0.5)
GREEN_HULL = Paint((66, 106, 86), (156, 96, 58), 0.45)
WHITE_HOUSE = Paint((206, 202, 186), (158, 108, 70), 0.4, 0.3)
OCHRE = Paint((200, 148, 66), (150, 94, 58), 0.4, 0.25)
RUST = Paint((172, 108, 64), (124, 80, 56), 0.5)
INSIDE = Paint((116, 78, 58), (88, 62, 50), 0.5, 0.2)
PLANKING = Paint((132, 112, 84), (92, 80, 64), 0.5, 0.35)
FRAME_WOOD = Paint((118, 98, 74), (84, 72, 58), 0.5, 0.3)
OLD_TIMBER = Paint((108, 92, 72), (78, 68, 56), 0.5, 0.35)
STONES = Paint((146, 142, 132), (116, 112, 106), 0.5, 0.4)

_GROWTH = np.array([(128, 130, 72), (172, 162, 132), (156, 118, 104), (108, 122, 92)], np.float64)
"""Algae, bryozoans and barnacles, coralline crust, hydroids."""
_SILT = np.array((180, 168, 138), np.float64)


@dataclass(frozen=True, slots=True)
class Weathering:
    """The patterns that all parts of one wreck share, so that growth runs on from part to part."""

    wear: Waves
    blotch: Waves
    growth: Waves
    kind: Waves
    fine: Waves

    def colours(self, paint: Paint, points: FloatArray, upward: FloatArray) -> npt.NDArray[np.uint8]:
        """(N, 3) sRGB albedo of points (N, 3) in metres above the seabed.

        Args:
            paint: Of the part.
            points: In the wreck's frame.
            upward: (N,) z of the surface normal; silt settles on what faces up and growth likes the light.
        """
        fine = self.fine(points)
        wear = 0.6 * self.wear(points) + 0.5 * self.blotch(points) + 0.35 * fine
        bare = _ramp(wear + 1.6 * (paint.worn - 0.5), 0.25)
        colour = (1 - bare) * np.asarray(paint.old, np.float64) + bare * np.asarray(paint.bare, np.float64)
        alive = 0.7 * self.growth(points) + 0.45 * fine + 0.3 * upward + 0.08 * points[:, 2] - 0.15
        living = 0.75 * _ramp(alive + 1.6 * (paint.growth - 0.5), 0.2)
        place = np.clip((self.kind(points) + 1.2) / 2.4, 0, 1) * (len(_GROWTH) - 1)
        species = np.minimum(place.astype(np.intp), len(_GROWTH) - 2)
        share = (place - species)[:, None]
        colour = (1 - living) * colour + living * (
            (1 - share) * _GROWTH[species] + share * _GROWTH[species + 1]
        )
        settled = 0.55 * _ramp(upward[:, None] - 0.75 + 0.25 * self.blotch(points)[:, None], 0.2)
        near_bed = 0.5 * np.clip(1 - points[:, 2:] / 0.35, 0, 1)
        silt = np.maximum(settled, near_bed)
        colour = (1 - silt) * colour + silt * _SILT
        albedo: npt.NDArray[np.uint8] = np.clip(np.rint(colour * (1 + 0.09 * fine[:, None])), 0, 255).astype(
            np.uint8
        )
        return albedo


def _ramp(values: FloatArray, softness: float) -> FloatArray:
    """0 well below zero, 1 well above, (N, 1)."""
    return np.clip(0.5 + 0.5 * values.reshape(len(values), -1)[:, :1] / softness, 0, 1)


def weathering(rng: np.random.Generator) -> Weathering:
    """The patterns of one wreck."""
    return Weathering(waves(rng, 3.5), waves(rng, 1.5), waves(rng, 2.4), waves(rng, 4.0), waves(rng, 0.9))
