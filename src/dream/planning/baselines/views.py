"""Which poses can be reached, what each would show, and which ground never shows."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.planning.travel import IntArray, Pose, Travel, travel_from
from dream.planning.vain import VainLooks
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, Decision, Mission, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

FloatArray = npt.NDArray[np.floating[Any]]
MOST_PATIENCE = 8
"""Looks in vain after which a cell is given up for good."""


@dataclass(frozen=True, slots=True)
class View:
    """A pose, the steps there, and what it would show."""

    pose: Pose
    steps: int
    gain: float


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


@dataclass(slots=True)
class Remains:
    """What is left to look at, as one mission remembers it.

    Cells that were looked at in vain are given up. And a rest too small to go for may be what a refused
    `done` is about, so that a refusal makes smaller rests count.
    """

    mission: Mission
    least: float
    """Cells that a view must show to be worth going to."""
    patience: int = 2
    """Looks in vain after which a cell is given up."""
    goal: Pose | None = None
    """The pose that was headed for last."""
    refused: bool = False
    """The last decision was `done`."""
    claims: int = 0
    """How often `done` was said."""
    vain: VainLooks = field(init=False)

    def __post_init__(self) -> None:
        self.vain = VainLooks(self.mission)

    def look(self, pose: SE2, occupancy: OccupancyMap) -> None:
        """Take in the observation that was made at `pose` and is in the map."""
        self.vain.note(pose, occupancy)

    def worth_looking(self, occupancy: OccupancyMap) -> BoolArray:
        """(rows, cols) cells that were not observed and are not given up."""
        return np.asarray(~occupancy.observed & (self.vain.count < self.patience))

    def go(
        self, pose: SE2, travel: Travel, occupancy: OccupancyMap, choose: Callable[[Travel], View | None]
    ) -> tuple[View, Decision] | None:
        """The first move to the view that `choose` chooses; None where it finds none.

        It may have to come nearer to something solid than `travel` does. After a refused `done` it is asked
        again with a smaller `least`, and then with more patience; from then on a complete map ends it.
        """
        from dream.mapping import check_completion

        if self.claims and check_completion(occupancy, pose).complete:
            return None
        ways = [travel]
        while True:
            for way in ways:
                view = choose(way)
                if view is not None:
                    self.goal, self.refused = view.pose, False
                    path = way.path(view.pose)
                    return view, Decision(*way.move(path[0], path[1]))
            if len(ways) == 1:
                ways.append(travel_from(pose, occupancy))
            elif not self.refused or (self.least <= 1.0 and self.patience >= MOST_PATIENCE):
                self.goal = None
                return None
            elif self.least > 1.0:
                self.least = max(1.0, self.least / 2.0)
            else:
                self.patience += 1

    def done(self, why: str) -> Decision:
        """Say so."""
        self.refused = True
        self.claims += 1
        return Decision(done=True, reasoning=Reasoning(action=why))


def group_cells(protocol: SurveyProtocol) -> float:
    """Map cells that the smallest group of targets covers."""
    return math.pi * (protocol.group_radius / protocol.cell) ** 2
