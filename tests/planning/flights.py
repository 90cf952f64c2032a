"""Maps and observations for pilots that are asked without a simulator."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3
from dream.mapping import OccupancyMap
from dream.planning.belief import BeliefPilot
from dream.planning.sources import BeliefSource, HullSurface, Situation
from dream.planning.sources.hull import away_from_hull
from dream.protocol import DREAM_V1
from dream.types import Observation

S = TypeVar("S", bound=BeliefSource)

SIDE = 96
"""Cells along `tests.mapping.analytic.AREA`."""


def observed_at(x: float, y: float, yaw: float) -> Observation:
    """An observation from there, of nothing."""
    camera = DREAM_V1.camera
    image = (camera.height, camera.width)
    return Observation(
        time=0.0,
        rgb=np.zeros((*image, 3), np.uint8),
        depth=np.full(image, np.nan, np.float32),
        labels=np.zeros(image, np.uint8),
        camera=camera,
        T_world_base=SE3.level(x, y, -8.0, yaw),
        T_base_camera=DREAM_V1.T_base_camera,
    )


def all_but(*boxes: tuple[slice, slice]) -> npt.NDArray[np.bool_]:
    """(rows, cols) of `AREA`, false in the boxes of rows and columns."""
    cells = np.ones((SIDE, SIDE), np.bool_)
    for box in boxes:
        cells[box] = False
    return cells


def source_of(pilot: BeliefPilot, kind: type[S]) -> S | None:
    """That source of a pilot; None where it has none."""
    return next((source for source in pilot.sources if isinstance(source, kind)), None)


def situation_of(pilot: BeliefPilot, observation: Observation, occupancy: OccupancyMap) -> Situation:
    """What a pilot would have to go by, without having it take in anything."""
    pose = observation.pose
    here = pilot.pose_views.lattice.pose(pose)
    situation = Situation(observation, occupancy, here, pilot.pose_views, pilot.failed)
    if source_of(pilot, HullSurface) is not None:
        situation.away_from_hull = away_from_hull(occupancy)
    return situation
