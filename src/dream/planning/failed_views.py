"""Ground that views should have shown and did not, as one mission remembers it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2
from dream.types import BoolArray, Mission

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

GIVEN_UP = np.iinfo(np.uint16).max // 2
"""Views that failed at a cell of which nothing is hoped for."""


@dataclass(slots=True, eq=False)
class FailedViews:
    """How often each cell should have been seen and was not.

    The map's view of a pose is flat; what stands on the ground may hide a cell that it promises. Without a
    memory of that a planner would look there for ever.
    """

    mission: Mission
    patience: int
    """Failed views after which a cell is given up."""
    count: npt.NDArray[np.uint16] = field(init=False)
    """(rows, cols) views that failed since anything beside the cell was observed."""
    observed: BoolArray = field(init=False)
    """(rows, cols) what was observed at the last view."""

    def __post_init__(self) -> None:
        cell, bounds = self.mission.protocol.cell, self.mission.bounds
        shape = round(bounds.depth / cell), round(bounds.width / cell)
        self.count = np.zeros(shape, np.uint16)
        self.observed = np.zeros(shape, np.bool_)

    def note(self, pose: SE2, occupancy: OccupancyMap, promised: BoolArray | None = None) -> None:
        """Take in the observation that was made at `pose` and is in the map.

        Args:
            pose: Where it was made.
            occupancy: With it.
            promised: (rows, cols) cells that it was hoped to show, beside those of the map's view.
        """
        from dream.mapping import view, within

        changed = occupancy.observed & ~self.observed
        cell = self.mission.protocol.cell
        self.count[within(changed, 1.5 * cell, cell)] = 0
        shown = view(occupancy, pose.x, pose.y, pose.yaw)
        if promised is not None:
            shown |= promised
        self.count[shown & ~occupancy.observed] += 1
        self.observed = occupancy.observed

    @property
    def given_up(self) -> BoolArray:
        """(rows, cols) cells that views failed to show as often as patience lasts."""
        return np.asarray(self.count >= self.patience)

    def left(self, occupancy: OccupancyMap) -> BoolArray:
        """(rows, cols) cells that were not observed and are not given up."""
        return np.asarray(~occupancy.observed & ~self.given_up)

    def area_given_up(self, occupancy: OccupancyMap) -> float:
        """Square metres that were never observed and are given up."""
        given_up = ~occupancy.observed & self.given_up
        return float(np.count_nonzero(given_up)) * self.mission.protocol.cell**2

    def give_up(self, cells: BoolArray) -> None:
        """Hope for nothing more in some cells (rows, cols)."""
        self.count[cells] = GIVEN_UP

    def try_again(self) -> None:
        """Have more patience, and look once more at what was given up."""
        self.patience += 1
        np.minimum(self.count, self.patience + 1, out=self.count)
