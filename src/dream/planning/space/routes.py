"""Lanes over the area in space: where they lead, how high they may, and what was searched already."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dream.geometry import SE2
from dream.planning.baselines.lanes import Points, across, densified, lanes, mirrored, shortest
from dream.types import Mission

if TYPE_CHECKING:
    from dream.mapping.volume import Volume

PIECE = 4.0
"""Metres between places along a lane."""
DISC = 3.0
"""Metres around a place within which ground is looked up."""
SEARCHED = 0.8
"""Share of that ground that something must have returned from, within reach."""

BESIDE = 1.0
"""Metres from a place within which what lies there is what lies below."""


def crossing(mission: Mission, start: SE2, spacing: float) -> Points:
    """(n, 2) places along the shortest way over lanes of a box: of both directions and all corners.

    Args:
        mission: Of whose area all is crossed.
        start: Where the vehicle is.
        spacing: Metres between lanes at most.
    """
    return shortest([along(mission, start, spacing, turned=turned) for turned in (False, True)], start)


def along(mission: Mission, start: SE2, spacing: float, *, turned: bool) -> Points:
    """Likewise over lanes that run south-north, or `turned` west-east."""
    box, inset = mission.to_see, 0.5 * mission.protocol.reach
    box = across(box) if turned else box
    routes = mirrored(lanes(box, spacing, inset), box)
    return densified(shortest([route[:, ::-1] if turned else route for route in routes], start), PIECE)


def highest(mission: Mission, z: float) -> float:
    """A height, or the greatest that the surface of the water allows."""
    assert mission.protocol.space is not None
    return min(z, -mission.protocol.space.surface)


def searched(volume: Volume, place: Points) -> bool:
    """Did something return from within reach from most of the ground around a place (2,)?"""
    surface = volume.surface()
    middles = surface.middles[surface.seen, :2]
    near = middles[np.hypot(*(middles - place).T) <= DISC]
    squares = len(np.unique(np.floor(near), axis=0))
    return bool(squares >= SEARCHED * np.pi * DISC**2)


def top(volume: Volume, place: Points, otherwise: float) -> float:
    """World z of the highest surface near a place (2,), or another height where none is known there."""
    middles = volume.surface().middles
    near = middles[np.hypot(*(middles[:, :2] - place).T) <= BESIDE]
    return float(near[:, 2].max()) if len(near) else otherwise
