"""Water: what it takes from the light and what it adds.

The model is the revised image formation model of Akkaynak and Treibitz (2018): direct light and veil have
coefficients of their own. The attenuations of the named types are Jerlov's diffuse coefficients
(*Marine Optics*, 1976, table XXVII) at 600, 525 and 475 nm, where a camera's red, green and blue bands lie
once the water has filtered them. Diffuse coefficients are a lower bound of what a narrow beam loses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.names import look_up

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Shares of linear red, green and blue in luminance: Rec. ITU-R BT.709-6, item 3.2, for the primaries of
sRGB."""


@dataclass(frozen=True, slots=True)
class Water:
    """An underwater image formation model, per channel (R, G, B): `I = J·e^(−a·r) + B·(1 − e^(−b·r))`.

    r is the length of the ray from camera to surface, in metres.
    """

    name: str
    attenuation: tuple[float, float, float]
    """a, per metre: what the direct light loses."""
    backscatter: tuple[float, float, float]
    """b, per metre: how fast the veil builds up."""
    veil: tuple[float, float, float]
    """B, linear light in [0, 1]: the colour of open water."""
    particles: float = 0.0
    """Marine snow: expected number of visible flakes in an image."""

    @property
    def attenuation_length(self) -> float:
        """Metres over which direct light falls to 1/e, by the attenuations' mean weighed as luminance.

        Infinity where the water takes nothing.
        """
        rate = math.fsum(share * a for share, a in zip(LUMINANCE, self.attenuation, strict=True))
        return 1.0 / rate if rate > 0.0 else math.inf

    @property
    def visibility(self) -> float:
        """Metres at which a Secchi disc vanishes in such a water; see `SECCHI`."""
        return SECCHI * self.attenuation_length

    def direct(self, distance: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Share of the light that arrives over `distance` metres: (..., 3)."""
        r = np.asarray(distance, np.float64)[..., None]
        share: npt.NDArray[np.float64] = np.exp(-r * np.array(self.attenuation))
        return share

    def scattered(self, distance: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Light that the water itself adds over `distance` metres: (..., 3), linear."""
        r = np.asarray(distance, np.float64)[..., None]
        light: npt.NDArray[np.float64] = np.array(self.veil) * (1.0 - np.exp(-r * np.array(self.backscatter)))
        return light


# Veils are what a camera balanced for the seabed at 10 m records of open water.
WATERS = {
    water.name: water
    for water in (
        # Jerlov IB: the clearest water that divers meet; a filled tank behaves alike.
        Water("pool", (0.245, 0.054, 0.033), (0.10, 0.06, 0.05), (0.09, 0.36, 0.46)),
        # Jerlov II: tropical and subtropical seas.
        Water("clear", (0.260, 0.076, 0.062), (0.15, 0.11, 0.11), (0.016, 0.135, 0.26), particles=15.0),
        # Jerlov III: shelf seas of middle latitudes.
        Water("coastal", (0.295, 0.116, 0.116), (0.19, 0.15, 0.15), (0.02, 0.155, 0.205), particles=40.0),
        # Jerlov 1C: coastal water in which blue already dies before green.
        Water("green", (0.300, 0.130, 0.170), (0.22, 0.19, 0.21), (0.032, 0.165, 0.128), particles=80.0),
        # Jerlov 3C: a bay after wind; little is seen past 8 m.
        Water("turbid", (0.330, 0.200, 0.290), (0.30, 0.27, 0.31), (0.055, 0.155, 0.095), particles=160.0),
    )
}


SECCHI = 1.7
"""Attenuation lengths to which a Secchi disc is seen: Poole and Atkins (1929), J. Mar. Biol. Assoc. UK 16:
297-324, found the diffuse attenuation of daylight in the English Channel to be 1.7 over its depth."""


def water_of(visibility: float) -> Water:
    """A water in which a Secchi disc is seen to that depth: its `attenuation_length` is `visibility` / 1.7.

    Colour, backscatter and particles lie between those of the two named types that are next to it, by the
    rate at which each takes light. A murkier one than the last is that one, with more of it in the water; a
    clearer one than the first likewise with less.

    Args:
        visibility: Metres, from 1 to 30.

    Raises:
        ValueError: It is not.
    """
    if not 1.0 <= visibility <= 30.0:
        raise ValueError(f"visibility: expected 1 to 30 m, got {visibility:g}")
    rate = SECCHI / visibility
    known = sorted(WATERS.values(), key=lambda water: -water.attenuation_length)
    rates = [1.0 / water.attenuation_length for water in known]
    low = max(sum(r <= rate for r in rates[:-1]) - 1, 0)
    share = min(max((rate - rates[low]) / (rates[low + 1] - rates[low]), 0.0), 1.0)
    # Between two types the rates blend to just this one; beyond the outermost, all of it is scaled.
    scale = rate / ((1.0 - share) * rates[low] + share * rates[low + 1])

    def blend(clearer: float, murkier: float, by: float = 1.0) -> float:
        return round(by * ((1.0 - share) * clearer + share * murkier), 6)

    one, other = known[low], known[low + 1]
    red, green, blue = (blend(a, b, scale) for a, b in zip(one.attenuation, other.attenuation, strict=True))
    spread = [blend(a, b, scale) for a, b in zip(one.backscatter, other.backscatter, strict=True)]
    veil = [blend(a, b) for a, b in zip(one.veil, other.veil, strict=True)]
    return Water(
        f"visibility {visibility:g} m",
        (red, green, blue),
        (spread[0], spread[1], spread[2]),
        (veil[0], veil[1], veil[2]),
        particles=blend(one.particles, other.particles, scale),
    )


def water_named(name: str) -> Water:
    """The water of that name; a ValueError with the nearest name where there is none."""
    return look_up(WATERS, name, "water")
