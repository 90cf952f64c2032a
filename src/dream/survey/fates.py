"""What became of individuals between two surveys, and how many are gone beyond what surveys miss."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.spatial import cKDTree

from dream.survey.individuals import BLUR
from dream.survey.registration import Registration, mutual
from dream.survey.survey import Individuals, Picture, under

Float64Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
FateArray = npt.NDArray[np.uint8]

BARE = 0.1
"""Share of target, in a picture blurred by `BLUR`, below which ground is bare."""
SEEN = 0.5
"""Share of such a blur that must have been seen to say so."""
TAIL = 0.025
"""Of each side of a 95 % interval."""


class Fate(enum.IntEnum):
    """What became of an individual."""

    NOT_COMPARABLE = 0
    THERE = 1
    """In both."""
    LOST = 2
    """Only in the earlier survey: the later one shows bare ground in its place."""
    NEW = 3
    """Only in the later one: the earlier one shows bare ground in its place."""
    HIDDEN = 4
    """Not found again, but its place is not shown bare: under or beside another, or taken for another."""


class Shown:
    """How much target a picture shows around a place, blurred as it is where peaks are looked for."""

    def __init__(self, picture: Picture) -> None:
        self._bounds, self._cell = picture.bounds, picture.cell
        seen = picture.share <= 200
        sigma = BLUR / picture.cell
        weight = ndimage.gaussian_filter(seen.astype(np.float32), sigma)
        target = np.where(seen, picture.share / np.float32(200.0), np.float32(0.0))
        share = ndimage.gaussian_filter(target, sigma) / np.maximum(weight, np.float32(SEEN))
        self._share = np.where(weight >= SEEN, share, np.float32(np.nan))

    def around(self, points: Float64Array) -> Float64Array:
        """(N,) share of target around points in the picture's world; NaN where it was not seen.

        All target is in the picture, so that what lies beyond it is bare.
        """
        share: Float64Array = under(points, self._share, self._bounds, self._cell, 0.0).astype(np.float64)
        return share


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """What the pictures show in the places of the individuals of one survey."""

    known: BoolArray
    """(N,) both pictures show the place."""
    bare: BoolArray
    """(N,) the other survey's picture shows bare ground there, and that of their own does not."""


def standing(
    shown: tuple[Shown, Shown], individuals: tuple[Individuals, Individuals], laid: Registration
) -> tuple[Standing, Standing]:
    """Of the earlier survey and of the later one."""
    a, b = (one.position[:, :2] for one in individuals)

    def of(own: Float64Array, other: Float64Array) -> Standing:
        return Standing(np.isfinite(own) & np.isfinite(other), (own >= BARE) & (other < BARE))

    return (
        of(shown[0].around(a), shown[1].around(laid.back(a))),
        of(shown[1].around(b), shown[0].around(laid.place(b))),
    )


def fates(
    individuals: tuple[Individuals, Individuals],
    at_b: Float64Array,
    common: tuple[BoolArray, BoolArray],
    stand: tuple[Standing, Standing] | None,
    laid: Registration,
) -> tuple[FateArray, FateArray]:
    """Fates of the individuals of an earlier survey and of a later one.

    Pairs of nearest, one to one, within what their places may err, are the same individual. Of two that
    stand close now the one and now the other makes the peak of both: one without a pair is lost or new only
    where the other survey shows bare ground, or where it has no picture to tell.

    Args:
        individuals: Of the earlier survey and of the later one.
        at_b: (N, 2) places of the later ones in the earlier one's world.
        common: On ground that both saw.
        stand: Where they do; None without pictures.
        laid: Where the later survey lies on the earlier one.
    """
    a, b = individuals
    told = []
    for k, only in enumerate((Fate.LOST, Fate.NEW)):
        fate = np.full(len(individuals[k]), np.uint8(only))
        if stand is not None:
            fate[~stand[k].bare] = Fate.HIDDEN
        fate[~common[k]] = Fate.NOT_COMPARABLE
        told.append(fate)
    fate_a, fate_b = told
    if not (len(a) and len(b)):
        return fate_a, fate_b
    pairs = mutual(cKDTree(a.position[:, :2]), at_b, 0.5)
    gap = np.hypot(*(a.position[pairs[:, 0], :2] - at_b[pairs[:, 1]]).T)
    sigma = np.sqrt(a.sigma[pairs[:, 0]] ** 2 + b.sigma[pairs[:, 1]] ** 2 + laid.sigma**2)
    first, second = pairs[gap <= 3.0 * np.maximum(sigma, 0.02)].T
    same = common[0][first] & common[1][second]
    # One whose partner lies beyond what both saw is neither lost nor new.
    fate_a[first[~same]] = Fate.NOT_COMPARABLE
    fate_b[second[~same]] = Fate.NOT_COMPARABLE
    if stand is not None:
        same &= ~(stand[0].bare[first] | stand[1].bare[second])
    fate_a[first[same]] = Fate.THERE
    fate_b[second[same]] = Fate.THERE
    return fate_a, fate_b


@dataclass(frozen=True, slots=True)
class Missing:
    """Individuals of one survey in whose place the other shows bare ground."""

    bare: int
    of: int
    """Individuals whose place is well known, on ground that the other survey's picture shows."""
    share: float
    """Share of them that is gone, beyond what is missed where nothing changed. Fewer than have died: where
    one did, another may stand so near that its place is covered still."""
    low: float
    high: float
    """95 % interval of the share."""
    p: float
    """How often as many and more are missed where none is gone."""


def missing(bare: int, of: int, rate: float, alike: float) -> Missing:
    """How many are gone, where `rate` of them are missed though they are there.

    Neighbours are missed together: their number is beta-binomial, with a correlation of `alike` between two
    of a patch. P is the mid-p, which counts half of what is exactly so; the interval holds the shares that
    such a test does not reject.

    Reference: Skellam, JRSS B 10 (1948), for the distribution; Lancaster, JASA 56 (1961), for the mid-p.
    """
    from scipy.stats import betabinom

    strength = 1.0 / alike - 1.0

    def at_least(share: float) -> float:
        expected = rate + (1.0 - rate) * share
        numbers = betabinom(of, expected * strength, (1.0 - expected) * strength)
        return float(numbers.sf(bare) + 0.5 * numbers.pmf(bare))

    def share_where(tail: float) -> float:
        """At which as many and more are found that often; it grows with the share."""
        low, high = 0.0, 1.0 - 1e-6
        if at_least(low) >= tail:
            return low
        for _ in range(30):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if at_least(middle) < tail else (low, middle)
        return 0.5 * (low + high)

    share = max(0.0, (bare / of - rate) / (1.0 - rate)) if of else 0.0
    return Missing(bare, of, share, share_where(TAIL), share_where(1.0 - TAIL), at_least(0.0))
