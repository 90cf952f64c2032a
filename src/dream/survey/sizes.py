"""Sizes of individuals: of those that stand clear the extents show, and what they tell of all.

Three things stand between these extents and the sizes of a reef. Those that stand clear are not like the
others: what settled since stands apart, what is old has grown into crusts. Extents scatter about sizes, too.
And some that show as one are two.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from dream.survey.calibration import SCATTERED, SHARP, Calibration
from dream.survey.individuals import Peaks
from dream.survey.intervals import LEVEL, around, together, unknown
from dream.survey.survey import Measure, Survey
from dream.types import BoolArray

Float64Array = npt.NDArray[np.float64]

CLEAR = 4.5
"""Metres: deeper in the image no outline is sharp enough to be sized."""
FEWEST = 3
"""Individuals that stand clear from which sizes are told."""
STRATA = 4
"""Classes of stature in which those that stand clear are held against all."""
OF_A_STRATUM = 6
"""Of those that stand clear at least, or there are fewer classes."""
STEP = 0.04
"""Logarithm of the ratio of neighbouring sizes of the distribution."""
SIZES: Float64Array = np.exp(np.arange(math.log(0.05), math.log(0.8), STEP))
"""Metres: the sizes that it is made of."""
ROUNDS = 15
"""Of unfolding. More follow the scatter of the sample."""
BIN = 0.05
"""Metres: the width of the bins of the size-frequency."""
LEAST_ROOM = 0.01
"""Of the square of the error of a bin's share over that of the calibration."""
RARE = 0.005
"""Share below which a bin beyond all others is not told."""


@dataclass(frozen=True, slots=True, eq=False)
class Sizes:
    """The sizes on a reef, and of each individual."""

    share: Float64Array
    """(K,) of the individuals of the reef that have each of `SIZES`; all 0 where none stands clear."""
    size: Float64Array
    """(N,) metres, of each; of those that do not stand clear, the mean of all, or a guess from their extent
    where none does."""
    error: Float64Array
    """(N,) its standard deviation, metres."""
    sample: float
    """As many as if all told alike: Kish's effective size of the sample."""
    clear: BoolArray
    """(N,) it stands clear, near enough, and is likelier an individual than not: its size is its own. None
    where fewer than `FEWEST` are."""
    calibration: Calibration

    @property
    def count(self) -> int:
        """Individuals whose size is their own."""
        return int(np.count_nonzero(self.clear))

    @property
    def typical(self) -> float | None:
        """Metres: smaller ones cover half of the ground that all cover; None where too few stand clear.

        It is that of what makes a crust, however many have settled since.
        """
        if not self.count:
            return None
        cover = np.cumsum(self.share * np.square(SIZES))
        return float(np.exp(np.interp(0.5 * cover[-1], cover, np.log(SIZES) + 0.5 * STEP)))

    def quantile(self, below: float) -> float:
        """The size that such a share is smaller than."""
        return float(np.exp(np.interp(below, np.cumsum(self.share), np.log(SIZES) + 0.5 * STEP)))

    def below(self, size: float) -> float:
        """Share that is smaller than so many metres."""
        at = math.log(max(size, 1e-9))
        return float(np.interp(at, np.log(SIZES) + 0.5 * STEP, np.cumsum(self.share), left=0.0))

    def measures(self) -> tuple[Measure, ...]:
        """The median, and the shares in bins of size."""
        if not self.count:
            return (unknown("median_size", "m", f"fewer than {FEWEST} individuals stand clear of others"),)
        note = f"from {self.count} that stand clear of others"
        # Where sizes are two heaps and the middle lies between them, a small share is a long way.
        error = LEVEL * together(self.calibration.rank_spread, 0.5 / math.sqrt(self.sample))
        low, median, high = (self.quantile(0.5 + side * min(error, 0.49)) for side in (-1.0, 0.0, 1.0))
        measures = [Measure("median_size", median, low, high, "m", note)]
        edges = [k * BIN for k in range(math.ceil(SIZES[-1] / BIN) + 1)]
        shares = np.diff([self.below(edge) for edge in edges])
        told = np.flatnonzero(shares >= RARE)
        shares /= shares[told[0] : told[-1] + 1].sum()
        for k in range(int(told[0]), int(told[-1]) + 1):
            error = _share_error(float(shares[k]), self.calibration.share_spread, self.sample)
            share = around(bin_name(k), float(shares[k]), error, "", note)
            measures.append(replace(share, high=min(share.high or 0.0, 1.0)))
        return tuple(measures)


def sizes_of(peaks: Peaks, sure: Float64Array, on_reef: BoolArray, calibration: Calibration) -> Sizes:
    """The sizes of a reef, from the extents of the individuals that stand clear.

    What it does: those that stand clear are weighed so that in each class of stature, the height of the shell
    around, they are as many as all. The scatter about sizes is taken off the distribution of their extents.

    Reference: post-stratification as in Cochran, *Sampling Techniques* (1977), 5A.9; the unfolding of
    Richardson, J. Opt. Soc. Am. 62 (1972) and Lucy, Astron. J. 79 (1974), stopped early.

    Assumes: those of like stature are of like size, whether they stand clear or not; extents scatter as they
    did where the calibration was made.
    Fails when: none of the large, or of the small, stands clear.
    """
    there = (sure > 0.5) & (on_reef if np.count_nonzero(on_reef & (sure > 0.5)) >= FEWEST else True)
    clear = there & peaks.lone & (peaks.nearest <= CLEAR)
    across = np.maximum(peaks.across, SIZES[0])
    if np.count_nonzero(clear) < FEWEST:
        guess = across / math.exp(calibration.extent[0][1])
        return Sizes(np.zeros(len(SIZES)), guess, 0.5 * guess, 0.0, np.zeros_like(clear), calibration)
    weight = _weights(peaks.stature[there], peaks.stature[clear])
    likely = _likely(across[clear], calibration)
    share = unfolded(likely, weight)
    each = likely * share
    each /= each.sum(axis=1, keepdims=True)
    mean = float(share @ SIZES)
    size = np.full(len(peaks), mean)
    error = np.full(len(peaks), math.sqrt(float(share @ np.square(SIZES - mean))))
    size[clear] = each @ SIZES
    error[clear] = np.sqrt(np.maximum(each @ np.square(SIZES) - np.square(size[clear]), 0.0))
    sample = float(weight.sum() ** 2 / np.square(weight).sum())
    return Sizes(share, size, error, sample, clear, calibration)


def unfolded(likely: Float64Array, weight: Float64Array) -> Float64Array:
    """(K,) the distribution of sizes that makes what was measured likeliest, after `ROUNDS` of the way there.

    Args:
        likely: (n, K) density of each measurement, were it of each of `SIZES`.
        weight: (n,) of the measurements.
    """
    share = np.full(likely.shape[1], 1.0 / likely.shape[1])
    for _ in range(ROUNDS):
        share = share * (weight @ (likely / (likely @ share)[:, None])) / weight.sum()
    return share


def bin_name(number: int) -> str:
    """Of the measure of the share in a bin of sizes, counted from 0, such as `size_share_015_020_cm`."""
    low, high = (round(100.0 * edge * BIN) for edge in (number, number + 1))
    return f"size_share_{low:03d}_{high:03d}_cm"


def size_bin(name: str) -> tuple[int, int] | None:
    """Centimetres, the ends of the sizes whose share a measure tells; None of another measure."""
    found = re.fullmatch(r"size_share_(\d+)_(\d+)_cm", name)
    return (int(found[1]), int(found[2])) if found else None


def measures_over(surveys: Sequence[Survey]) -> dict[str, list[Measure | None]]:
    """What each survey tells of each measure that any of them tells; None where it does not.

    A survey lists shares of sizes from its least to its largest. Of sizes beyond these it found none, which
    is a share of 0 and not one that was not measured.
    """
    names = dict.fromkeys(measure.name for survey in surveys for measure in survey.measures)
    told = [{measure.name: measure for measure in survey.measures} for survey in surveys]
    return {
        name: [
            of.get(name) or (_none_of_that_size(name, of.values()) if size_bin(name) else None) for of in told
        ]
        for name in sorted(names, key=lambda name: (size_bin(name) is not None, size_bin(name) or (0, 0)))
    }


def _none_of_that_size(name: str, measures: Iterable[Measure]) -> Measure | None:
    """The share of a size that a survey does not list; None where it measured no sizes."""
    shares = [m for m in measures if size_bin(m.name) is not None and m.value is not None]
    if not shares:
        return None
    # A survey says of how many, but not by which calibration: by the wider.
    said = re.match(r"from (\d+) ", shares[0].note)
    error = _share_error(0.0, max(SHARP.share_spread, SCATTERED.share_spread), int(said[1]) if said else 1)
    return around(name, 0.0, error, "", shares[0].note)


def _share_error(share: float, spread: float, sample: float) -> float:
    # A bin that seems empty may not be.
    return math.sqrt(share * (1.0 - share) + LEAST_ROOM) * together(spread, 1.0 / math.sqrt(sample))


def _likely(extent: Float64Array, calibration: Calibration) -> Float64Array:
    """(n, K) chance of each extent, to a step of the logarithm, were it of each of `SIZES`."""
    from scipy.special import ndtr

    off = np.log(extent)[:, None] - np.log(SIZES)
    # What no size explains is believed of none.
    chance = np.full(off.shape, 1e-6)
    for share, mean, sigma in calibration.extent:
        high, low = (off + side * STEP - mean for side in (0.5, -0.5))
        chance += share * (ndtr(high / sigma) - ndtr(low / sigma))
    return chance


def _weights(of_all: Float64Array, of_clear: Float64Array) -> Float64Array:
    """(n,) individuals that each one that stands clear tells of: all of its class, over those that do."""
    strata = max(1, min(STRATA, len(of_clear) // OF_A_STRATUM))
    edges = np.quantile(of_clear, np.arange(1, strata) / strata)
    mine = np.searchsorted(edges, of_clear)
    there = np.bincount(np.searchsorted(edges, of_all), minlength=strata)
    return np.asarray((there / np.maximum(np.bincount(mine, minlength=strata), 1))[mine], np.float64)
