"""What an earlier survey foretells, and how far it is to be believed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.mapping.layers import probability_of_votes
from dream.mapping.prior import Prior
from dream.types import BoolArray, Float32Array

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.mapping.completion import Region

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
"""Looks after which a cell is given up of which nothing is heard."""
WITNESS = 2.0
"""Metres: cells this near say the same about whether the survey is to be believed."""
BELIEVED = 0.9
"""Probability that a survey is of this place, before anything was seen."""
WINDOW = 6.0
"""Metres east and north within which a survey that is told in the wrong place is looked for."""
MISPLACED = 0.1
"""Probability that a survey of this place is told somewhere else in that window, before anything was seen."""
CLUMP = 1.0
"""Metres: cells this near say the same about where exactly a survey lies."""
UNFORESEEN = 0.01
"""Probability of a target up to which one that is found was not to be expected."""
AROUND = 1.5
"""Metres around such a target in which the survey does not count for less than what was seen."""


@dataclass(slots=True, eq=False)
class PriorSurvey:
    """A survey, weighed by what a mission sees of the same ground.

    What it does: foretells where targets are now, from where they were, from how many live on and from where
    new ones settle. What the mission sees is then compared with what was foretold, wherever within `WINDOW`
    metres the survey may lie, and with a survey that foretells the same everywhere: Bayes' rule says which of
    them is to be believed. The survey is moved to the place that explains most.

    Assumes: what is within `WITNESS` metres is one witness; a survey is shifted, never turned. Fails when: a
    survey of another place looks like this one, or as soon as most of the targets are gone.
    """

    prior: Prior
    """Moved to where it is believed to lie."""
    radius: float = 3.0
    """Metres: of the groups that it would have noticed."""
    foretold: Float32Array = field(init=False)
    """(rows, cols) probability of a target now; NaN where the survey saw nothing."""
    looks: npt.NDArray[np.uint8] = field(init=False)
    """(rows, cols) how often a cell should have shown what is foretold, and nothing was heard of it."""
    believed: float = BELIEVED
    """Probability that the survey is of this place and holds."""
    shift: tuple[int, int] = (0, 0)
    """Cells (north, east) by which it was moved."""
    spread: float = 0.0
    """Metres by which that may err, one standard deviation."""
    empty: BoolArray = field(init=False)
    """(rows, cols) middles at which it would have noticed a group, and foretells no target of one. Nowhere
    if it foretells none at all: then it is no reason to look elsewhere first."""
    surprising: BoolArray = field(init=False)
    """(rows, cols) around targets that were found where none was foretold."""
    _given: Prior = field(init=False)
    _usual: float = field(init=False)
    _said: npt.NDArray[np.complexfloating[Any]] = field(init=False)
    """(2, ...) spectra of what a target and bare ground in a cell say for the survey as it was given."""

    def __post_init__(self) -> None:
        from scipy.fft import rfft2

        prior = self._given = self.prior
        seen = prior.seen
        now = _foretold(prior, prior.sigma)
        self._usual = float(np.clip(now[seen].mean(), UNTOLD, 0.98)) if seen.any() else UNTOLD
        self.foretold = np.where(seen, now, np.nan).astype(np.float32)
        self.empty = self._empty()
        self.looks = np.zeros(seen.shape, np.uint8)
        self.surprising = np.zeros(seen.shape, np.bool_)
        yes = np.where(seen, np.log(now / self._usual), 0.0)
        no = np.where(seen, np.log((1.0 - now) / (1.0 - self._usual)), 0.0)
        self._said = rfft2(np.stack([yes, no]), self._padded)

    @property
    def _padded(self) -> tuple[int, int]:
        """So many rows and columns that no shift in the window wraps around."""
        rows, cols = self._given.target.shape
        return rows + self._most, cols + self._most

    @property
    def _most(self) -> int:
        return round(WINDOW / self._given.cell)

    def evidence(self, occupancy: OccupancyMap) -> FloatArray:
        """What is heard by now says for the survey, by where it may lie.

        Returns:
            (n, n) log of the ratio to a survey that foretells the same everywhere, as if each cell were a
            witness; row and column grow with the cells by which the survey is moved north and east, in the
            middle it is where it was told. Cells of which nothing was heard say nothing.
        """
        from scipy.fft import irfft2, rfft2

        heard = occupancy.seen & ~_unheard(occupancy)
        seen_now = rfft2(
            np.stack([occupancy.target & heard, heard & ~occupancy.target]).astype(float), self._padded
        )
        said = irfft2((seen_now * self._said.conj()).sum(axis=0), self._padded)
        lags = np.arange(-self._most, self._most + 1)
        return np.asarray(said[np.ix_(lags, lags)])

    def compare(self, occupancy: OccupancyMap) -> None:
        """Weigh the survey by all that is heard by now, and move it to where it is likeliest to lie."""
        from dream.mapping import within

        cell, most = self._given.cell, self._most
        evidence = self.evidence(occupancy)
        north, east = np.mgrid[-most : most + 1, -most : most + 1] * cell
        before = np.full(evidence.shape, MISPLACED / evidence.size)
        before[most, most] += 1.0 - MISPLACED
        weights = np.log(before) + evidence * (cell / WITNESS) ** 2
        row, col = np.unravel_index(int(np.argmax(np.round(weights, 6))), weights.shape)
        top = float(weights[row, col])
        odds = math.log(BELIEVED / (1.0 - BELIEVED)) + top + math.log(float(np.exp(weights - top).sum()))
        self.believed = 1.0 / (1.0 + math.exp(-min(max(odds, -50.0), 50.0)))
        shift, spread = (int(row) - most, int(col) - most), 0.0
        if shift != (0, 0):
            # How sure that is: of where it lies each clump is a witness.
            near = np.hypot(north - shift[0] * cell, east - shift[1] * cell)
            sure = np.exp((evidence - evidence[row, col]) * (cell / CLUMP) ** 2) * (near <= WITNESS)
            spread = math.sqrt(0.5 * float((sure * near**2).sum() / sure.sum()))
        spread = round(spread, 1)
        if self.believed > 0.5 and (*shift, spread) != (*self.shift, self.spread):
            self._move(shift, spread)
        found = occupancy.target & (np.nan_to_num(self.foretold, nan=1.0) < UNFORESEEN)
        self.surprising = within(found, AROUND, cell)

    def _move(self, shift: tuple[int, int], spread: float) -> None:
        """Take the survey as lying so many cells north and east of where it was told, give or take metres."""
        given = self._given
        target = _moved(given.target, shift, np.float32(np.nan))
        solid = _moved(given.solid, shift, np.False_)
        self.shift, self.spread = shift, spread
        self.prior = replace(given, target=target, solid=solid)
        now = _foretold(self.prior, math.hypot(given.sigma, spread))
        self.foretold = np.where(self.prior.seen, now, np.nan).astype(np.float32)
        self.empty = self._empty()

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

    def _empty(self) -> BoolArray:
        from dream.mapping import within

        likely = np.nan_to_num(self.foretold) >= LIKELY
        if not likely.any():
            return np.zeros_like(likely)
        noticed = within(self.prior.seen, self.radius, self.prior.cell)
        return noticed & ~within(likely, self.radius, self.prior.cell)

    def came(self, regions: Iterable[Region]) -> int:
        """How many of the regions lie where it foretells none."""
        return sum(bool(self.empty[tuple(region.cells.T)].all()) for region in regions)

    def told(self, occupancy: OccupancyMap) -> tuple[int, int, int]:
        """Cells where a target is foretold and is still to be seen; with a new target; and with one gone."""
        likely, seen = np.nan_to_num(self.foretold) >= LIKELY, self.prior.seen
        unheard = _unheard(occupancy)
        new = occupancy.target & seen & ~likely
        gone = (np.nan_to_num(self.prior.target) > 0.5) & ~unheard & ~occupancy.target
        left, came, went = (int(np.count_nonzero(cells)) for cells in (likely & unheard, new, gone))
        return left, came, went

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
        mixed = np.where(self.surprising, np.maximum(mixed, beside), mixed)
        return np.where(told, mixed, beside).astype(np.float32)


def _foretold(prior: Prior, sigma: float) -> FloatArray:
    """(rows, cols) probability of a target now, for a survey that errs by `sigma` metres.

    Where it saw nothing it means nothing.
    """
    seen = prior.seen
    was = np.where(seen, np.maximum(prior.target - UNTOLD, 0.0) / (1.0 - UNTOLD), 0.0).astype(np.float32)
    stays = SURVIVAL**prior.years * _spread(was, seen, sigma / prior.cell)
    coming = 1.0 - math.exp(-COMING * prior.years)
    beside = _spread(was, seen, math.hypot(sigma, SPREAD) / prior.cell)
    strays = 1.0 - (1.0 - STRAYS) ** max(prior.years, 0.5)
    now = 1.0 - (1.0 - stays) * (1.0 - coming * beside) * (1.0 - strays)
    return np.asarray(np.clip(now, 1e-3, 0.98))


def _moved(cells: npt.NDArray[Any], shift: tuple[int, int], beyond: Any) -> npt.NDArray[Any]:
    """The cells so many rows and columns farther on; what comes in from outside is unknown."""
    moved = np.full_like(cells, beyond)
    (row, col), (rows, cols) = shift, cells.shape
    to = slice(max(row, 0), rows + min(row, 0)), slice(max(col, 0), cols + min(col, 0))
    of = slice(max(-row, 0), rows + min(-row, 0)), slice(max(-col, 0), cols + min(-col, 0))
    moved[to] = cells[of]
    return moved


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
