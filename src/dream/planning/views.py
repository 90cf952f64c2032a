"""Which poses can be reached, and what each would show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.planning.travel import IntArray, Pose, Travel
from dream.types import BoolArray

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

FloatArray = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class View:
    """A pose, the steps there, and what it would show."""

    pose: Pose
    steps: int
    gain: float

    @property
    def rate(self) -> float:
        """What it would show for each step there."""
        return self.gain / self.steps


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Poses that can be reached, and what each would show."""

    rows: IntArray
    """(n,) lattice rows of the positions."""
    cols: IntArray
    """(n,) lattice columns."""
    steps: IntArray
    """(n, headings); −1 where it cannot be reached, 0 where the vehicle is."""
    gains: FloatArray
    """(n, headings) weight of what would be seen."""

    @property
    def rates(self) -> FloatArray:
        """(n, headings) what each would show for each step there; 0 where none leads there."""
        return np.where(self.steps > 0, self.gains / np.maximum(self.steps, 1), 0.0)

    def only(self, chosen: BoolArray) -> Views:
        """Those from some of the positions, (n,)."""
        return Views(self.rows[chosen], self.cols[chosen], self.steps[chosen], self.gains[chosen])

    def best(self, scores: FloatArray) -> View | None:
        """The pose of the highest score; None where none is above −inf.

        Args:
            scores: (n, headings). Poses that cannot be reached, and where the vehicle is, do not take part.
        """
        scores = np.where(self.steps > 0, scores, -np.inf)
        if not np.isfinite(scores).any():
            return None
        # Rounded, so that a tie is a tie on every machine.
        k, heading = np.unravel_index(int(scores.round(6).argmax()), scores.shape)
        return self._view(int(k), int(heading))

    def nearest(self, least: float) -> View | None:
        """The pose of fewest steps that would show at least that much; of several, what shows most."""
        most = float(self.gains.max(initial=0.0)) + 1.0
        return self.best(np.where(self.gains >= least, self.gains / most - self.steps, -np.inf))

    def at(self, pose: Pose) -> View | None:
        """The view from a pose; None where it is not among these, out of reach, or where the vehicle is."""
        (k,) = np.nonzero((self.rows == pose[0]) & (self.cols == pose[1]))
        if not len(k) or self.steps[k[0], pose[2]] <= 0:
            return None
        return self._view(int(k[0]), pose[2])

    def _view(self, k: int, heading: int) -> View:
        pose = int(self.rows[k]), int(self.cols[k]), heading
        return View(pose, int(self.steps[k, heading]), float(self.gains[k, heading]))


def views_from(
    travel: Travel, occupancy: OccupancyMap, weights: FloatArray, *, keep: Pose | None = None
) -> Views:
    """What would be seen from a choice of positions: every one near by, every third one far away.

    Args:
        travel: From where the vehicle is.
        occupancy: What is known.
        weights: (rows, cols) worth of each cell not yet observed.
        keep: A pose whose position is always among them.
    """
    rows, cols = np.nonzero(travel.reached)
    nearest = travel.nearest[rows, cols]
    chosen = (
        (nearest <= 4) & ((rows + cols) % 2 == 0)
        | (nearest <= 8) & (rows % 2 == 0) & (cols % 2 == 0)
        | (rows % 3 == 0) & (cols % 3 == 0)
    )
    if keep is not None:
        chosen |= (rows == keep[0]) & (cols == keep[1])
    return _views(travel, occupancy, weights, rows[chosen], cols[chosen])


def all_views_from(travel: Travel, occupancy: OccupancyMap, weights: FloatArray) -> Views:
    """What would be seen from every position; slow."""
    return _views(travel, occupancy, weights, *np.nonzero(travel.reached))


def _views(
    travel: Travel, occupancy: OccupancyMap, weights: FloatArray, rows: IntArray, cols: IntArray
) -> Views:
    from dream.mapping import gain

    gains = gain(occupancy, travel.position(rows, cols), weights)
    return Views(rows, cols, travel.steps[rows, cols], gains)
