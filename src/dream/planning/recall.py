"""What an earlier survey foretells, and how far it is to be believed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.mapping.layers import probability_of_votes
from dream.mapping.prior import Prior
from dream.types import BoolArray, Float32Array

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

FloatArray = npt.NDArray[np.floating[Any]]

SURVIVAL = 0.8
"""Share of targets that are still there a year later."""
SPREAD = 0.75
"""Metres around targets within which new ones come, one standard deviation."""
COMING = 0.15
"""How many come in a year for each that is there."""
STRAYS = 0.002
"""Probability that a cell becomes target in a year wherever it is."""
UNTOLD = 0.05
"""Probability of target that a map gives a cell of which it heard nothing: it says no more than nothing."""
LIKELY = 0.05
"""Probability of a target from which on a cell is worth going to."""
LOOKS = 3
"""Looks in vain after which a cell is given up."""
WITNESS = 2.0
"""Metres: cells this near say the same about whether the survey is to be believed."""
BELIEVED = 0.9
"""Probability that a survey is of this place, before anything was seen."""


@dataclass(slots=True, eq=False)
class Recall:
    """A survey, weighed by what a mission sees of the same ground.

    What it does: foretells where targets are now, from where they were, from how many live on and from where
    new ones settle. What the mission sees is then compared with what was foretold and with a survey that
    foretells the same everywhere: Bayes' rule says which of them is to be believed.

    Assumes: what is within `WITNESS` metres is one witness. Fails when: a survey of another place looks like
    this one, or as soon as most of the targets are gone.
    """

    prior: Prior
    foretold: Float32Array = field(init=False)
    """(rows, cols) probability of a target now; NaN where the survey saw nothing."""
    looks: npt.NDArray[np.uint8] = field(init=False)
    """(rows, cols) how often a cell should have shown what is foretold, and nothing was heard of it."""
    believed: float = BELIEVED
    """Probability that the survey is of this place and holds."""
    _usual: float = field(init=False)

    def __post_init__(self) -> None:
        prior, seen = self.prior, self.prior.seen
        was = np.where(seen, np.maximum(prior.target - UNTOLD, 0.0) / (1.0 - UNTOLD), 0.0).astype(np.float32)
        stays = SURVIVAL**prior.years * _spread(was, seen, prior.sigma / prior.cell)
        coming = 1.0 - math.exp(-COMING * prior.years)
        beside = _spread(was, seen, math.hypot(prior.sigma, SPREAD) / prior.cell)
        strays = 1.0 - (1.0 - STRAYS) ** max(prior.years, 0.5)
        now = 1.0 - (1.0 - stays) * (1.0 - coming * beside) * (1.0 - strays)
        self.foretold = np.where(seen, np.clip(now, 1e-3, 0.98), np.nan).astype(np.float32)
        self.looks = np.zeros(self.foretold.shape, np.uint8)
        self._usual = float(np.clip(now[seen].mean(), UNTOLD, 0.98)) if seen.any() else UNTOLD

    def compare(self, occupancy: OccupancyMap) -> None:
        """Weigh the survey by all that is seen by now."""
        common = occupancy.seen & self.prior.seen
        p, usual, found = self.foretold[common], self._usual, occupancy.target[common]
        evidence = np.where(found, np.log(p / usual), np.log((1.0 - p) / (1.0 - usual))).sum()
        evidence *= (self.prior.cell / WITNESS) ** 2
        odds = math.log(BELIEVED / (1.0 - BELIEVED)) + float(evidence)
        self.believed = 1.0 / (1.0 + math.exp(-min(max(odds, -50.0), 50.0)))

    def look(self, shown: BoolArray, occupancy: OccupancyMap) -> None:
        """Remember that a pose should have shown these cells (rows, cols)."""
        self.looks[shown & _unheard(occupancy)] += 1

    def unheard(self, occupancy: OccupancyMap) -> BoolArray:
        """(rows, cols) cells where a target is foretold and of which no frame said anything yet.

        The map takes ground behind a low rock for explored. Where nothing is known of it that will do; where
        targets were it is worth another look.
        """
        likely = np.nan_to_num(self.foretold) >= LIKELY
        return likely & _unheard(occupancy) & occupancy.to_see & (self.looks < LOOKS)

    def told(self, occupancy: OccupancyMap) -> tuple[int, int, int]:
        """Cells where a target is foretold and is still to be seen; with a new target; and with one gone."""
        likely, seen = np.nan_to_num(self.foretold) >= LIKELY, self.prior.seen
        unheard = _unheard(occupancy)
        new = occupancy.target & seen & ~likely
        gone = (np.nan_to_num(self.prior.target) > 0.5) & ~unheard & ~occupancy.target
        return tuple(int(np.count_nonzero(k)) for k in (likely & unheard, new, gone))  # type: ignore[return-value]

    def solid(self, occupancy: OccupancyMap) -> BoolArray | None:
        """(rows, cols) what stood in ground that is not known yet; None where the survey is not believed."""
        return self.prior.solid & ~occupancy.known if self.believed > 0.5 else None

    def weighed(self, beside: FloatArray, left: BoolArray) -> Float32Array:
        """(rows, cols) probability of a target: foretold as far as the survey is believed, else as told.

        Args:
            beside: (rows, cols) without the survey.
            left: (rows, cols) cells that are still to be seen.
        """
        told = left & self.prior.seen
        mixed = self.believed * np.where(told, self.foretold, 0.0) + (1.0 - self.believed) * beside
        return np.where(told, mixed, beside).astype(np.float32)


def _unheard(occupancy: OccupancyMap) -> BoolArray:
    """(rows, cols) cells without a vote."""
    unheard: BoolArray = occupancy.target_probability == probability_of_votes(occupancy.evidence)[0]
    return unheard


def _spread(was: FloatArray, seen: BoolArray, sigma: float) -> FloatArray:
    """Blurred over the cells that were seen; `sigma` in cells."""
    from scipy.ndimage import gaussian_filter

    if sigma < 0.25:
        return was
    share = gaussian_filter(seen.astype(np.float32), sigma)
    return np.asarray(gaussian_filter(was, sigma) / np.maximum(share, 1e-3))
