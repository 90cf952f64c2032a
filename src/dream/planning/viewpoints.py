"""Which poses can be reached, and what each would show."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.lattice import Lattice, Pose
from dream.planning.travel import Travel
from dream.types import BoolArray, IntArray

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

FloatArray = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """A pose, the steps there, and what it would show."""

    pose: Pose
    steps: int
    gain: float

    @property
    def rate(self) -> float:
        """What it would show for each step there."""
        return self.gain / self.steps


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoints:
    """Poses that can be reached, and what each would show."""

    lattice: Lattice
    nodes: IntArray
    """(n,) their positions."""
    steps: IntArray
    """(n, headings); −1 where it cannot be reached, 0 where the vehicle is."""
    gains: FloatArray
    """(n, headings) weight of what would be seen."""

    @property
    def positions(self) -> npt.NDArray[np.float64]:
        """(n, 2) metres in the world."""
        return self.lattice.positions[self.nodes]

    @property
    def rates(self) -> FloatArray:
        """(n, headings) what each would show for each step there; 0 where none leads there."""
        return np.where(self.steps > 0, self.gains / np.maximum(self.steps, 1), 0.0)

    def only(self, chosen: BoolArray) -> Viewpoints:
        """Those from some of the positions, (n,)."""
        return replace(self, nodes=self.nodes[chosen], steps=self.steps[chosen], gains=self.gains[chosen])

    def best(self, scores: FloatArray) -> Viewpoint | None:
        """The pose of the highest score; None where none is above −inf.

        Args:
            scores: (n, headings). Poses that cannot be reached, and where the vehicle is, do not take part.
        """
        scores = np.where(self.steps > 0, scores, -np.inf)
        if not np.isfinite(scores).any():
            return None
        # Rounded, so that a tie is a tie on every machine.
        k, heading = np.unravel_index(int(scores.round(6).argmax()), scores.shape)
        return self._viewpoint(int(k), int(heading))

    def nearest(self, least: float) -> Viewpoint | None:
        """The pose of fewest steps that would show at least that much; of several, what shows most."""
        most = float(self.gains.max(initial=0.0)) + 1.0
        return self.best(np.where(self.gains >= least, self.gains / most - self.steps, -np.inf))

    def at(self, pose: Pose) -> Viewpoint | None:
        """That of a pose; None where it is not among these, out of reach, or where the vehicle is."""
        (k,) = np.nonzero(self.nodes == self.lattice.node_of(pose))
        heading = self.lattice.heading_of(pose)
        if not len(k) or self.steps[k[0], heading] <= 0:
            return None
        return self._viewpoint(int(k[0]), heading)

    def _viewpoint(self, k: int, heading: int) -> Viewpoint:
        pose = self.lattice.pose_at(self.nodes[k], heading)
        return Viewpoint(pose, int(self.steps[k, heading]), float(self.gains[k, heading]))


def spread(travel: Travel, keep: Pose | None = None) -> IntArray:
    """(n,) nodes that can be reached: half of them near by, every third in each direction far away.

    Args:
        travel: From where the vehicle is.
        keep: A pose whose node is always among them.
    """
    lattice, nearest = travel.lattice, travel.nearest
    chosen = (nearest <= 4) & lattice.checkered | (nearest <= 8) & lattice.every(2) | lattice.every(3)
    if keep is not None:
        chosen[lattice.node_of(keep)] = True
    return np.flatnonzero(travel.reached & chosen)


def viewpoints_from(
    travel: Travel, occupancy: OccupancyMap, weights: FloatArray, *, keep: Pose | None = None
) -> Viewpoints:
    """What would be seen from a choice of positions, those of `spread`.

    Args:
        travel: From where the vehicle is.
        occupancy: What is known.
        weights: (rows, cols) worth of each cell not yet observed.
        keep: A pose whose position is always among them.
    """
    return _viewpoints(travel, occupancy, weights, spread(travel, keep))


def all_viewpoints_from(travel: Travel, occupancy: OccupancyMap, weights: FloatArray) -> Viewpoints:
    """What would be seen from every position; slow."""
    return _viewpoints(travel, occupancy, weights, np.flatnonzero(travel.reached))


def _viewpoints(travel: Travel, occupancy: OccupancyMap, weights: FloatArray, nodes: IntArray) -> Viewpoints:
    from dream.mapping import gain

    gains = gain(occupancy, travel.lattice.positions[nodes], weights)
    return Viewpoints(travel.lattice, nodes, travel.steps_to(nodes), gains)
