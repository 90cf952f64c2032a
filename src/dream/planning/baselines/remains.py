"""What is left to look at, and which ground never shows."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from dream.geometry import SE2
from dream.lattice import Pose
from dream.planning.failed_views import FailedViews
from dream.planning.travel import Travel, travel_from
from dream.planning.viewpoints import Viewpoint
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, Decision, Mission, Reasoning

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

MOST_PATIENCE = 8
"""Failed views after which a cell is given up for good."""


@dataclass(slots=True)
class Remains:
    """What is left to look at, as one mission remembers it.

    Cells that views failed to show are given up. And a rest too small to go for may be what a refused
    `done` is about, so that a refusal makes smaller rests count.
    """

    mission: Mission
    least: float
    """Cells that a view must show to be worth going to."""
    goal: Pose | None = None
    """The pose that was headed for last."""
    refused: bool = False
    """The last decision was `done`."""
    claims: int = 0
    """How often `done` was said."""
    failed: FailedViews = field(init=False)

    def __post_init__(self) -> None:
        self.failed = FailedViews(self.mission, patience=2)

    def look(self, pose: SE2, occupancy: OccupancyMap) -> None:
        """Take in the observation that was made at `pose` and is in the map."""
        self.failed.note(pose, occupancy)

    def worth_looking(self, occupancy: OccupancyMap) -> BoolArray:
        """(rows, cols) cells that were not observed and are not given up."""
        return self.failed.left(occupancy)

    def go(
        self, pose: SE2, travel: Travel, occupancy: OccupancyMap, choose: Callable[[Travel], Viewpoint | None]
    ) -> tuple[Viewpoint, Decision] | None:
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
            elif not self.refused or (self.least <= 1.0 and self.failed.patience >= MOST_PATIENCE):
                self.goal = None
                return None
            elif self.least > 1.0:
                self.least = max(1.0, self.least / 2.0)
            else:
                self.failed.patience += 1

    def done(self, why: str) -> Decision:
        """Say so."""
        self.refused = True
        self.claims += 1
        return Decision(done=True, reasoning=Reasoning(action=why))


def group_cells(protocol: SurveyProtocol) -> float:
    """Map cells that the smallest group of targets covers."""
    return math.pi * (protocol.group_radius / protocol.cell) ** 2
