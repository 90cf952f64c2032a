"""The way home over what is known to be free."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from dream.control import setpoint
from dream.geometry import SE2, FloatArray
from dream.protocol import SurveyProtocol
from dream.types import BoolArray, Decision

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap
    from dream.planning.space.ways import KnownWays

Place = tuple[float, float, float]
"""x, y and z, metres in the world."""
Node = tuple[int, int, int]
"""Of the lattice from the world's origin: steps east, north and up; 0 up under a planar protocol."""


def way_home(
    pose: SE2,
    z: float,
    occupancy: OccupancyMap,
    home: Place,
    kept_to: Callable[[FloatArray], BoolArray] | None = None,
    near: float = 0.0,
) -> list[Decision] | None:
    """The moves of a way with the fewest steps; empty where it is home, None where none is known.

    Args:
        pose: From where.
        z: At which height.
        occupancy: What is known.
        home: Under a planar protocol its height counts for nothing.
        kept_to: Which of some positions, (n, 3) metres, moves may end at; all that are known to be free
            unless given.
        near: Metres from home that are near enough; where 0, only the node nearest to it is.
    """
    protocol = occupancy.protocol
    if protocol.space is None:
        from dream.planning.travel import travel_from

        travel = travel_from(pose, occupancy)
        if kept_to is not None:
            at = np.insert(travel.lattice.positions, 2, z, axis=1)
            travel = travel.kept_to(kept_to(at))
        ends = np.array([travel.lattice.node(home[0], home[1])])
        if near > 0.0:
            ends = np.flatnonzero(np.linalg.norm(travel.lattice.positions - home[:2], axis=1) <= near)
        ends = ends[travel.nearest[ends] >= 0]
        if not len(ends):
            return None
        path = travel.path_to_node(int(ends[np.argmin(travel.nearest[ends])]))
        return [Decision(*travel.move(a, b)) for a, b in pairwise(path)]
    ways = ways_in_space(occupancy)
    positions = ways.positions
    if kept_to is not None:
        stands = ways.stands.copy()
        stands[ways.stands > 0] = kept_to(positions[ways.stands > 0])
        ways = replace(ways, stands=stands, _from={})
    if near > 0.0:
        goal = np.linalg.norm(positions - home, axis=-1) <= near
    else:
        goal = np.zeros(ways.shape, np.bool_)
        goal[ways.node(*home)] = True
    return ways.to(pose, z, goal, np.ones(protocol.headings, np.bool_))


def ways_in_space(occupancy: OccupancyMap) -> KnownWays:
    """The ways that a map with a volume knows; the same to all who ask until it changes."""
    from dream.planning.space.ways import ways_in

    assert occupancy.volume is not None
    volume, bounds, protocol = occupancy.volume, occupancy.bounds, occupancy.protocol
    return occupancy.answer("ways in space", lambda: ways_in(volume, bounds, protocol))


def node_of(pose: SE2, z: float, protocol: SurveyProtocol) -> Node:
    """The node of the lattice nearest to where a vehicle is."""
    x, y, level = (round(v / protocol.lattice) for v in (pose.x, pose.y, z))
    return x, y, 0 if protocol.space is None else level


def move_to(node: Node, pose: SE2, z: float, protocol: SurveyProtocol) -> Decision | None:
    """The move straight to a node; a turn towards it where the protocol has none that turns so far at once.

    Args:
        node: Another than that of the pose.
        pose: From where.
        z: At which height.
        protocol: Whose moves.

    Returns:
        None where no move leads there.
    """
    heading, headings = protocol.heading_index(pose.yaw), protocol.headings
    east, north, up = (b - a for a, b in zip(node_of(pose, z, protocol), node, strict=True))
    found = [
        (turn, advance)
        for turn in range(1 - headings // 2, headings // 2 + 1)
        for advance in (0.0, *protocol.advances)
        if protocol.offset(heading + turn, advance) == (east, north)
    ]
    climb = up * protocol.lattice
    if not found or climb not in protocol.climbs:
        return None
    turn, advance = min(found, key=lambda one: abs(one[0]))
    if turn in protocol.turns:
        return Decision(turn * protocol.heading_step, advance, climb=climb)
    return Decision(min(protocol.turns, key=lambda one: abs(one - turn)) * protocol.heading_step)


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
