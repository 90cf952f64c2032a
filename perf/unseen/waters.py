"""Light in water with algae, yellow matter and minerals, in ten bands of colour: no table of water types.

Absorption and scattering follow from what is in the water; what is scattered once towards the camera is
summed along every ray, from the sun and from lamps. Small angles of scattering count as blur of the picture.

Reference: Jaffe, Computer modeling and the design of optimal underwater imaging systems, IEEE JOE 15 (1990);
Pope, Fry, Applied Optics 36 (1997), pure water; Prieur, Sathyendranath, Limnology and Oceanography 26 (1981),
and Morel, JGR 96 (1991), algae; Gordon, Morel (1983), their scattering; Bricaud et al., Limnology and
Oceanography 26 (1981), yellow matter; Babin et al., JGR 108 (2003), minerals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.geometry import FloatArray

Float32Array = npt.NDArray[np.float32]

BANDS = np.arange(420.0, 691.0, 30.0)
"""Nanometres, the middles of ten bands."""
PURE_ABSORPTION = np.array([0.00454, 0.00922, 0.0127, 0.0325, 0.0474, 0.0695, 0.2224, 0.2916, 0.410, 0.516])
"""Per metre."""
ALGAE = np.array([0.913, 0.944, 0.798, 0.618, 0.416, 0.276, 0.236, 0.317, 0.441, 0.329])
"""Absorption beside that at 440 nm."""
EYE = np.array([0.004, 0.038, 0.139, 0.503, 0.954, 0.952, 0.631, 0.265, 0.061, 0.008])
"""Photopic luminous efficiency (CIE 1924)."""
DAYLIGHT = np.array([0.86, 1.05, 1.10, 1.06, 1.05, 1.00, 0.96, 0.93, 0.92, 0.87])
"""Of a clear sky, beside 570 nm."""
FORWARD = 0.45
"""Share of the scattering that stays within some degrees."""
SEEN = 3.5
"""Attenuation lengths at which 3 % is left, and a picture shows nothing but water."""
WITHIN = 2.0
"""Attenuation lengths up to which labels are asked for."""
FARTHEST = 20.0
"""Metres, likewise."""


def _bell(middle: float, width: float) -> FloatArray:
    bell: FloatArray = np.exp(-0.5 * ((BANDS - middle) / width) ** 2)
    return bell


def sensor(rng: np.random.Generator) -> FloatArray:
    """(10, 3): what red, green and blue pixels take of each band; neutral under even light."""
    takes = np.stack(
        [
            _bell(610.0 + rng.normal(0, 8), 34.0) + 0.06 * _bell(450.0, 30.0),
            _bell(535.0 + rng.normal(0, 6), 36.0) + 0.04,
            _bell(462.0 + rng.normal(0, 6), 28.0) + 0.02,
        ],
        axis=-1,
    )
    return np.asarray(takes / takes.sum(axis=0))


def reflected(rgb: FloatArray | Float32Array) -> Float32Array:
    """(..., 10) smooth reflectance of the bands from linear red, green and blue (..., 3)."""
    parts = np.stack(
        [1.0 / (1.0 + np.exp((580.0 - BANDS) / 10.0)), 1.0 / (1.0 + np.exp((BANDS - 492.0) / 10.0))]
    )
    basis = np.stack([parts[0], 1.0 - parts[0] - parts[1], parts[1]]).astype(np.float32)
    return np.asarray(rgb, np.float32) @ basis


@dataclass(frozen=True, slots=True, eq=False)
class Water:
    """What a water does to light, per metre in each band; and how it scatters."""

    absorption: FloatArray
    """(10,)."""
    scattering: FloatArray
    """(10,)."""
    back: float
    """Share of the wide scattering that goes backwards."""

    @property
    def beam(self) -> FloatArray:
        """(10,) of what goes straight."""
        return self.absorption + self.scattering

    @property
    def wide(self) -> FloatArray:
        """(10,) scattering by more than some degrees."""
        return (1.0 - FORWARD) * self.scattering

    @property
    def kept(self) -> FloatArray:
        """(10,) of what goes straight or nearly so."""
        return self.absorption + self.wide

    @property
    def downwards(self) -> FloatArray:
        """(10,) of daylight, with depth."""
        return 1.15 * (self.absorption + 2.0 * self.back * self.wide)

    def attenuation(self, light: FloatArray) -> float:
        """Of the luminance of (10,) light, per metre, of what goes straight."""
        weight = EYE * light
        return float((weight * self.beam).sum() / weight.sum())

    def phase(self, cosine: FloatArray) -> FloatArray:
        """Per steradian, of wide scattering by an angle: two lobes of Henyey and Greenstein."""
        mixed = np.zeros_like(cosine)
        for share, g in ((1.0 - 2.0 * self.back, 0.85), (2.0 * self.back, -0.15)):
            mixed += share * (1.0 - g * g) / (4.0 * math.pi * (1.0 + g * g - 2.0 * g * cosine) ** 1.5)
        return mixed


def some_water(rng: np.random.Generator) -> Water:
    """Of the open sea, or of a coast with minerals and yellow matter."""
    coast = rng.random() < 0.6
    algae = math.exp(rng.uniform(math.log(0.05), math.log(4.0 if coast else 1.0)))
    yellow = math.exp(rng.uniform(math.log(0.02), math.log(0.35))) if coast else 0.02 + 0.02 * algae
    minerals = math.exp(rng.uniform(math.log(0.03), math.log(0.9))) if coast else 0.0
    ratio = 0.06 * algae**0.65
    absorption = (PURE_ABSORPTION + ratio * ALGAE) * (1.0 + 0.2 * np.exp(-0.014 * (BANDS - 440.0)))
    absorption = absorption + yellow * np.exp(-rng.uniform(0.014, 0.019) * (BANDS - 440.0))
    absorption = absorption + 0.031 * minerals * np.exp(-0.0123 * (BANDS - 443.0))
    scattering = 0.00193 * (550.0 / BANDS) ** 4.32 + 0.30 * algae**0.62 * (550.0 / BANDS) * rng.uniform(
        0.3, 1.0
    )
    scattering = scattering + 0.51 * minerals * (555.0 / BANDS) ** 0.3
    return Water(absorption, scattering, float(rng.uniform(0.01, 0.035)))


@dataclass(frozen=True, slots=True, eq=False)
class Lamp:
    """A lamp on the vehicle."""

    place: FloatArray
    """(3,) metres in the camera's frame."""
    towards: FloatArray
    """(3,) unit vector in it."""
    wide: float
    """Radians: deviation of its beam."""
    strength: FloatArray
    """(10,) per steradian."""

    def reaching(self, points_camera: FloatArray, water: Water) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What reaches points (..., 3): irradiance (..., 10) across the beam, its way (..., 3), metres (...).

        All is of the precision of the points.
        """
        kind = points_camera.dtype
        way = points_camera - self.place.astype(kind)
        far = np.maximum(np.sqrt((way * way).sum(axis=-1)), kind.type(0.05))
        way = way / far[..., None]
        beam = np.exp((way @ self.towards.astype(kind) - 1.0) / kind.type(self.wide**2)) / far**2
        left = np.exp(-water.kept.astype(kind) * far[..., None])
        return self.strength.astype(kind) * beam[..., None] * left, way, far


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """The sun, from above, and lamps."""

    water: Water
    surface: FloatArray
    """(10,) irradiance just below the surface."""
    sun: FloatArray
    """(3,) unit vector to the sun in the world, below the surface."""
    straight: float
    """Share of daylight that still comes from there."""
    lamps: tuple[Lamp, ...]

    def daylight(self, z: FloatArray) -> FloatArray:
        """(..., 10) downward irradiance at z (...) metres, which is below 0; of the precision of z."""
        rate = self.water.downwards.astype(z.dtype)
        return np.asarray(self.surface.astype(z.dtype) * np.exp(rate * np.minimum(z, 0.0)[..., None]))

    def path(self, rays_camera: FloatArray, rotation: FloatArray, z: float, ranges: FloatArray) -> FloatArray:
        """What the water sends to the camera from up to each range, summed along each ray.

        Args:
            rays_camera: (R, 3) unit vectors.
            rotation: (3, 3) `R_world_camera`.
            z: Metres of the camera in the world.
            ranges: (K,) metres that grow from 0.

        Returns:
            (R, K, 10).
        """
        rays = rays_camera @ rotation.T
        middle = 0.5 * (ranges[1:] + ranges[:-1])
        level = z + middle[None, :] * rays[:, 2:3]
        below = level < 0.0
        cosine = -rays @ self.sun
        share = self.straight * self.water.phase(cosine) + (1.0 - self.straight) * self._diffuse(rays[:, 2])
        source = self.daylight(level) * share[:, None, None] * below[..., None]
        for lamp in self.lamps:
            reaching, way, _ = lamp.reaching(rays_camera[:, None, :] * middle[None, :, None], self.water)
            angle = -np.einsum("rkx,rx->rk", way, rays_camera)
            source += reaching * self.water.phase(angle)[..., None]
        left = np.exp(-self.water.kept * middle[:, None])
        sums = np.zeros((len(rays), len(ranges), len(BANDS)))
        np.cumsum(source * self.water.wide * left * np.diff(ranges)[:, None], axis=1, out=sums[:, 1:])
        return sums

    def _diffuse(self, up: FloatArray) -> FloatArray:
        """Per steradian: what was scattered often comes from above, and 30 times less of it from below."""
        return np.asarray(0.065 * np.exp(1.7 * up))


def some_light(rng: np.random.Generator, water: Water, z: float) -> Light:
    """Sun with lamps for a camera at about z metres; the deeper the darker, and lamps count for more."""
    zenith, towards = math.radians(rng.uniform(2.0, 42.0)), rng.uniform(0, 2 * math.pi)
    flat = math.sin(zenith)
    sun = np.array([flat * math.cos(towards), flat * math.sin(towards), math.cos(zenith)])
    straight = math.exp(z * float(water.beam[4]) * 0.5) * rng.uniform(0.2, 0.8)
    sky = Light(water, DAYLIGHT, sun, straight, ())
    ambient = float((EYE * sky.daylight(np.array(float(z)))).sum() / EYE.sum())
    lit = rng.random()
    if lit < 0.45:
        return sky
    night = lit > 0.88
    count, warm = int(rng.integers(1, 3)), rng.normal(0.0, 0.25)
    colour = np.exp(warm * (BANDS - 550.0) / 150.0) * (
        1.0 + 0.6 * _bell(450.0, 18.0) - 0.3 * _bell(480.0, 15.0)
    )
    strength = ambient * math.exp(rng.uniform(math.log(0.5), math.log(25.0))) / count
    side, lift = rng.uniform(0.12, 0.4), rng.uniform(-0.3, 0.2)
    lamps = []
    for n in range(count):
        place = np.array([side * (1 - 2 * n), lift, rng.uniform(-0.2, 0.0)])
        aim = np.array([rng.normal(0.0, 0.3), rng.normal(0.1, 0.3), rng.uniform(1.5, 4.0)]) - place
        wide = math.radians(rng.uniform(16.0, 48.0))
        lamps.append(Lamp(place, aim / np.linalg.norm(aim), wide, strength * colour))
    surface = DAYLIGHT * (rng.uniform(0.0, 0.05) if night else 1.0)
    return Light(water, surface, sun, straight, tuple(lamps))
