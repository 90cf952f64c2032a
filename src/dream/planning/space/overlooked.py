"""How likely what lies on the ground was overlooked, by the angles under which it was looked at."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dream.types import Float32Array, IntArray, Mission, Observation

PARTS = 8
"""Of the compass. Looks out of different ones miss independently of each other."""
MISSED = 0.75
"""An individual that is looked at under the angle θ to the vertical is not inspected with a probability of
this times (1 − cos θ)²: the others around it hide it. From 25° that is 1 %, from 48° 8 %, from 60° 19 %."""


def overlooked(cosine: Float32Array) -> Float32Array:
    """The probability that a look misses an individual, by the cosine of its angle to the vertical."""
    return np.asarray(MISSED * np.square(1.0 - cosine), np.float32)


@dataclass(slots=True, eq=False)
class Overlooked:
    """The looks that each cell of the ground had, and what they leave.

    What it does: keeps for each cell the steepest look out of each eighth of the compass. A cell counts as
    looked at where a pixel returned from it within reach.

    Assumes: clumps on ground that is level within some ten degrees, of which three in five cells at most are
    full. Fails when: targets stand up or hang over.

    Reference: `perf/overlooked.py` measures it, by family of worlds.
    """

    mission: Mission
    share: Float32Array = field(init=False)
    """(rows, cols) expected share of the individuals in each cell that no look inspected."""
    parts: IntArray = field(init=False)
    """(rows, cols) out of how many parts of the compass each cell was looked at."""
    _steepest: Float32Array = field(init=False)
    """(parts, rows, cols) cosines; 0 where there was no look."""

    def __post_init__(self) -> None:
        cell, bounds = self.mission.protocol.cell, self.mission.bounds
        shape = round(bounds.depth / cell), round(bounds.width / cell)
        self._steepest = np.zeros((PARTS, *shape), np.float32)
        self.share, self.parts = np.ones(shape, np.float32), np.zeros(shape, np.int64)

    def take(self, observation: Observation) -> None:
        """Add a frame."""
        from dream.planning._kernels import overlooked as kernels

        protocol, bounds, camera = self.mission.protocol, self.mission.bounds, observation.camera
        T_world_camera = observation.T_world_camera
        kernels.look(
            self._steepest,
            observation.depth,
            np.ascontiguousarray(T_world_camera.rotation),
            T_world_camera.translation,
            (camera.fx, camera.fy, camera.cx, camera.cy),
            protocol.returns,
            protocol.reach,
            (bounds.x_min, bounds.y_min),
            protocol.cell,
        )
        left = np.where(self._steepest > 0.0, overlooked(self._steepest), np.float32(1.0))
        self.share, self.parts = left.prod(axis=0), np.count_nonzero(self._steepest, axis=0)
