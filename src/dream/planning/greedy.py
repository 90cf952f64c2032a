"""The best next view by everything that `belief` believes: what looking ahead is measured against."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import numpy.typing as npt

from dream.options import First
from dream.planning.belief import Belief, BeliefPilot
from dream.planning.lookahead import Plan, Prospect, best_view
from dream.planning.parameters import check_range
from dream.planning.space.lookahead import SpacePlan, best_look
from dream.planning.space.remains import LeftToInspect, elements_of
from dream.planning.space.ways import KnownWays
from dream.planning.travel import Travel
from dream.types import BoolArray, Mission, Observation

if TYPE_CHECKING:
    from dream.planning.space.belief import SpaceBelief


@dataclass(frozen=True, slots=True)
class Greedy:
    """Go to the view that shows most of what is expected for each step there.

    What it does: believes all that `belief` does, of the same sources and with the same stop, and weighs it
    alike but for two weights of its own. Each step it goes for the one view, of all that known ways lead to,
    that shows most for its distance; what comes after that view does not count.

    Reference: the next best view by utility over travel time (González-Baños and Latombe, IJRR 2002).

    Assumes: what is best next leaves a good rest. Fails when: single cells are left on the way, which cost
    a way back.
    """

    spatial: ClassVar[bool] = True

    eager: First[float] = 3.0
    """As `belief`'s."""
    search: First[float] = 0.05
    """As `belief`'s."""

    def __post_init__(self) -> None:
        check_range("eager", self.eager, 0.0, 1000.0)
        check_range("search", self.search, 1e-6, 1.0)

    @property
    def believes(self) -> Belief:
        """Whose beliefs it has."""
        return Belief(eager=self.eager, search=self.search)

    def begin(self, mission: Mission) -> BeliefPilot | SpaceBelief:
        """A fresh pilot."""
        if mission.protocol.space is None:
            return self.in_plane(mission)
        from dream.planning.space.belief import SpaceBelief
        from dream.planning.space.ground import GroundSearch

        return SpaceBelief(mission, GroundSearch(mission, self.of_all_ground), NextLook())

    def in_plane(self, mission: Mission) -> BeliefPilot:
        """A fresh pilot that keeps its altitude, under whatever protocol."""
        return BeliefPilot(self.believes, mission, NextView())

    def of_all_ground(self, mission: Mission) -> BeliefPilot:
        """The same, with all ground to be seen, as `belief` searches it in three dimensions."""
        return BeliefPilot(self.believes.over_ground, mission, NextView())


@dataclass(frozen=True, slots=True)
class NextView:
    """Chooses the best single view in the plane."""

    def plan(
        self, prospect: Prospect, travel: Travel, moves: npt.NDArray[np.uint8], known: BoolArray
    ) -> Plan | None:
        """The way to it; None where nothing is in sight."""
        weights = prospect.weights.astype(np.float64)
        return best_view(prospect, weights, prospect.pose_views.views(prospect.listed), travel)


@dataclass(frozen=True, slots=True)
class NextLook:
    """Chooses the best single look in three dimensions."""

    def plan(self, ways: KnownWays, left: LeftToInspect, observation: Observation) -> SpacePlan | None:
        """The way to it; None where nothing is in sight."""
        return best_look(ways, elements_of(left, ways.protocol), observation) if len(left) else None
