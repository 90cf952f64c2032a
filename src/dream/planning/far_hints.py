"""Hints from beyond the reach, believed as far as earlier ones came true."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream.planning.distribution import TargetEvidence
from dream.types import BoolArray, Label, Mission, Observation

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

HALF = 0.5
"""Share of a cell's pixels from which on it is hinted at as a target."""
USUAL = 0.8
"""How often hints are thought to come true before any did ..."""
WORTH = 10.0
"""... as if that had been seen on so many square metres."""


@dataclass(slots=True, eq=False)
class FarHints:
    """Labels of ground beyond the reach, weighed by what a mission later sees there.

    Labels are trusted within the reach only, and nothing beyond counts as explored. But what a frame shows
    there is no accident either: how often a hint of a target came true, and how many of the targets that
    were in view had been hinted at, is learnt from all ground that was glimpsed first and observed later.
    Where the water lets nothing be seen there are no hints; where labels err far off they soon count little.

    Assumes: hints that come true alike wherever they are; a pixel's depth that errs by little more than a
    cell. Fails when: the first hints are right and the later ones are not.
    """

    mission: Mission
    farthest: float
    """Metres over ground."""
    came_true: float = 0.0
    """Square metres of targets where one was hinted at, ..."""
    hinted: float = 0.0
    """... of so many that were hinted at and observed later."""
    foreseen: float = 0.0
    """Square metres of targets that had been hinted at, ..."""
    found: float = 0.0
    """... of so many that were found where something had been glimpsed."""
    _pixels: npt.NDArray[np.uint32] = field(init=False)
    """(2, rows, cols) that showed a target, and that showed one or the seabed."""
    _observed: BoolArray = field(init=False)
    """(rows, cols) what was observed when it last learnt."""

    def __post_init__(self) -> None:
        cell, bounds = self.mission.protocol.cell, self.mission.bounds
        shape = round(bounds.depth / cell), round(bounds.width / cell)
        self._pixels = np.zeros((2, *shape), np.uint32)
        self._observed = np.zeros(shape, np.bool_)

    def add(self, observation: Observation, occupancy: OccupancyMap) -> None:
        """Learn from what the map holds by now, then take in what this observation shows beyond the reach."""
        from dream.planning._kernels import far_hints as kernels

        self._learn(occupancy)
        protocol, bounds, camera = self.mission.protocol, self.mission.bounds, observation.camera
        T_world_camera = observation.T_world_camera
        kernels.add(
            self._pixels,
            observation.depth,
            observation.labels,
            int(Label.TARGET),
            int(Label.SEABED),
            np.ascontiguousarray(T_world_camera.rotation),
            T_world_camera.translation,
            (camera.fx, camera.fy, camera.cx, camera.cy),
            protocol.returns,
            (protocol.reach, self.farthest),
            (bounds.x_min, bounds.y_min),
            protocol.cell,
        )

    def _learn(self, occupancy: OccupancyMap) -> None:
        new = occupancy.seen & ~self._observed & self._looked_at
        self._observed = occupancy.seen
        hinted, target = self._hinted[new], occupancy.target[new]
        square = self.mission.protocol.cell**2
        both = square * np.count_nonzero(hinted & target)
        self.came_true += both
        self.foreseen += both
        self.hinted += square * np.count_nonzero(hinted)
        self.found += square * np.count_nonzero(target)

    @property
    def precision(self) -> float:
        """Probability that a hint of a target comes true."""
        return (USUAL * WORTH + self.came_true) / (WORTH + self.hinted)

    @property
    def sensitivity(self) -> float:
        """Probability that a target in ground that was glimpsed is hinted at."""
        return (USUAL * WORTH + self.foreseen) / (WORTH + self.found)

    @property
    def _looked_at(self) -> BoolArray:
        return np.asarray(self._pixels[1] > 0)

    @property
    def _hinted(self) -> BoolArray:
        return np.asarray(self._looked_at & (self._pixels[0] >= HALF * self._pixels[1]))

    def glimpsed(self, occupancy: OccupancyMap) -> BoolArray:
        """(rows, cols) cells of which something was seen, but never within reach."""
        return self._looked_at & ~occupancy.observed

    def hints(self, occupancy: OccupancyMap) -> BoolArray:
        """(rows, cols) those of them that seemed to be targets."""
        return self._hinted & ~occupancy.observed

    def evidence(self, occupancy: OccupancyMap) -> TargetEvidence:
        """What the hints are worth beside what was observed.

        A cell that was only glimpsed counts as so much ground as hints are to be relied on, and as so much
        target as they come true.
        """
        glimpsed, hints = self.glimpsed(occupancy), self.hints(occupancy)
        precision, sensitivity = self.precision, self.sensitivity
        return TargetEvidence(
            np.where(occupancy.target, 1.0, sensitivity * precision * hints).astype(np.float32),
            np.where(occupancy.seen, 1.0, sensitivity * glimpsed).astype(np.float32),
            glimpsed,
            hints,
            precision,
            sensitivity,
        )


def hints_up_to(mission: Mission, glimpse: float) -> FarHints | None:
    """What is to learn from pictures beyond the reach; None where no hints are taken.

    Args:
        mission: Whose pictures.
        glimpse: Distance up to which they are searched, as a multiple of the reach; 1 takes none.
    """
    return FarHints(mission, glimpse * mission.protocol.reach) if glimpse > 1.0 else None
