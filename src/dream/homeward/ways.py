"""The way home over what is known to be free."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from dream.control import setpoint
from dream.geometry import SE2
from dream.types import Decision

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

Place = tuple[float, float, float]
"""x, y and z, metres in the world."""


def way_home(pose: SE2, z: float, occupancy: OccupancyMap, home: Place) -> list[Decision] | None:
    """The moves of a way with the fewest steps; empty where it is home, None where none is known.

    Args:
        pose: From where.
        z: At which height.
        occupancy: What is known.
        home: Under a planar protocol its height counts for nothing.
    """
    protocol = occupancy.protocol
    if protocol.space is None:
        from dream.planning.travel import travel_from

        travel = travel_from(pose, occupancy)
        node = travel.lattice.node(home[0], home[1])
        if travel.nearest[node] < 0:
            return None
        path = travel.path_to_node(node)
        return [Decision(*travel.move(a, b)) for a, b in pairwise(path)]
    from dream.planning.space.ways import ways_in

    assert occupancy.volume is not None
    ways = ways_in(occupancy.volume, occupancy.bounds, protocol)
    goal = np.zeros(ways.shape, np.bool_)
    goal[ways.node(*home)] = True
    return ways.to(pose, z, goal, np.ones(protocol.headings, np.bool_))


def after(pose: SE2, z: float, move: Decision, occupancy: OccupancyMap) -> tuple[SE2, float]:
    """Where a move leads: pose and height."""
    to = setpoint(pose, move, occupancy.protocol, z)
    return SE2(to.x, to.y, to.yaw), z if to.z is None else to.z


def places(pose: SE2, z: float, moves: list[Decision], occupancy: OccupancyMap) -> tuple[Place, ...]:
    """Where moves lead, one after the other; turns on the spot add none."""
    found: list[Place] = []
    for move in moves:
        pose, z = after(pose, z, move, occupancy)
        if move.advance > 0.0 or move.climb != 0.0:
            found.append((pose.x, pose.y, z))
    return tuple(found)
