"""Where targets are to be expected: beside those that were seen, and where a whole group could hide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.planning.parameters import check_range
from dream.types import BoolArray, Float32Array

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

FloatArray = npt.NDArray[np.floating[Any]]
Cells = BoolArray | Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class TargetEvidence:
    """What is known of targets and of ground, where something was observed or only glimpsed."""

    targets: Cells
    """(rows, cols) share of each cell that is target."""
    ground: Cells
    """(rows, cols) share of each cell that was seen."""
    glimpsed: BoolArray
    """(rows, cols) cells of which something was seen, but never within reach."""
    hints: BoolArray
    """(rows, cols) those of them that seemed to be targets."""
    precision: float = 1.0
    """Probability that a hint of a target comes true."""
    sensitivity: float = 0.0
    """Probability that a target in ground that was glimpsed is hinted at."""

    @classmethod
    def of_map(cls, occupancy: OccupancyMap) -> TargetEvidence:
        """Of what was observed, alone."""
        nothing = np.zeros(occupancy.shape, np.bool_)
        return cls(occupancy.target, occupancy.seen, nothing, nothing)

    def weighed(self, beside: Float32Array) -> Float32Array:
        """(rows, cols) probability of a target, of cells not observed, with what was glimpsed of the cell.

        Where nothing was hinted at by Bayes' rule, bare ground being taken never to hint; a hint is worth
        what hints are worth, or what lies around where that is more.

        Args:
            beside: (rows, cols) by what lies around.
        """
        missed = (1.0 - self.sensitivity) * beside
        unhinted = np.where(self.glimpsed, missed / (missed + 1.0 - beside), beside)
        hinted = np.maximum(self.precision, beside)
        return np.where(self.hints, hinted, unhinted).astype(np.float32)

    def unnoticed(self, radius: float, cell: float) -> Float32Array:
        """(rows, cols) probability that a group with its middle there was glimpsed and missed.

        It is 1 where no ground of one was glimpsed.

        Args:
            radius: Of a group, metres.
            cell: Metres.
        """
        from dream.mapping import within

        near = within(self.glimpsed, radius, cell)
        return np.where(near, np.float32(1.0 - self.sensitivity), np.float32(1.0))


def expectation(
    occupancy: OccupancyMap,
    radius: float,
    prior: float,
    prior_weight: float,
    where: BoolArray,
    evidence: TargetEvidence | None = None,
) -> npt.NDArray[np.float32]:
    """(rows, cols) probability of a target in every cell not observed that is asked about, 0 elsewhere.

    A kernel estimate (Nadaraya-Watson): blurred targets over blurred observed ground, pulled to the prior
    where neither says much.

    Args:
        occupancy: What is known.
        radius: Standard deviation of the blur, metres.
        prior: Probability in a cell about which nothing is known.
        prior_weight: How much blurred evidence the prior is worth.
        where: (rows, cols) the cells asked about.
        evidence: What is known; what was observed unless given.
    """
    where = where & ~occupancy.observed
    known = TargetEvidence.of_map(occupancy) if evidence is None else evidence
    targets = blurred(known.targets, radius, occupancy, where)
    observed = blurred(known.ground, radius, occupancy, where)
    p = (targets + prior * prior_weight) / (observed + prior_weight)
    return np.where(where, np.clip(p, 0.0, 1.0), 0.0).astype(np.float32)


def blurred(
    cells: Cells, radius: float, occupancy: OccupancyMap, where: BoolArray
) -> npt.NDArray[np.float32]:
    """(rows, cols) mean of the cells around, weighted by a Gaussian of `radius` metres: of a mask, its share.

    What lies outside the bounds is neither in the mask nor missing from it: it counts as the edge does.
    Cells not asked about have 0.
    """
    from dream.planning._kernels.blur import blur

    sigma = radius / occupancy.protocol.cell
    far = int(3.0 * sigma + 0.5)
    weights = np.exp(-0.5 / sigma**2 * np.arange(-far, far + 1) ** 2)
    shares: npt.NDArray[np.float32] = blur(
        np.asarray(cells, np.float32), (weights / weights.sum())[far:], where
    )
    return shares


@dataclass(frozen=True, slots=True)
class Groups:
    """How many groups of targets there are: a Poisson process whose intensity is learnt on the way.

    The intensity has a Gamma distribution, and has one again once some ground was searched. The number in
    hidden ground has a negative binomial distribution; that it is not zero is the risk of stopping now.
    """

    shape: float
    """Groups that it rests on: those that the prior is worth, and those that were found."""
    area: float
    """Square metres of ground that it rests on, likewise."""

    def __post_init__(self) -> None:
        check_range("shape", self.shape, 1e-3, 1e9)
        check_range("area", self.area, 1e-3, 1e9)

    def after(self, found: int, searched: float) -> Groups:
        """What is known once `found` groups were found on `searched` square metres."""
        return Groups(self.shape + found, self.area + searched)

    @property
    def intensity(self) -> float:
        """Groups to be expected per square metre."""
        return self.shape / self.area

    def risk(self, hidden: float) -> float:
        """Probability of at least one group on `hidden` square metres."""
        return float(1.0 - (self.area / (self.area + hidden)) ** self.shape)


@dataclass(frozen=True, slots=True)
class Calibration:
    """How often more than a success may was missed where `Groups` gives a probability of a hidden group.

    Where little ground is left to search it comes in slivers, and a group that hid in one would mostly reach
    out of it: then less often than the process says. Where much is left, more often.

    Reference: a line in log odds, as Platt (1999) calibrates scores.
    """

    scale: float
    """The odds of a risk come true this many times ..."""
    power: float
    """... to this power."""

    def calibrated(self, risk: float) -> float:
        """How often a risk by `Groups` comes true."""
        return _odds_times(risk, self.scale, self.power)

    def uncalibrated(self, risk: float) -> float:
        """The probability by `Groups` of what comes true as often as that."""
        return _odds_times(risk, self.scale ** (-1.0 / self.power), 1.0 / self.power)


OBSERVED = Calibration(1.5, 1.7)
"""Where only what came within reach tells of hidden groups ..."""
GLIMPSED = Calibration(10.0, 2.5)
"""... and where hints do as well. Both fitted on the reefs of the suite `dev` (`perf/stop.py`)."""


def _odds_times(probability: float, scale: float, power: float) -> float:
    for_it, against = scale * probability**power, (1.0 - probability) ** power
    return float(for_it / (for_it + against))
