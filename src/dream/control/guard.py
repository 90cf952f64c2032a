"""The guard: no decision, whoever made it, takes the vehicle where the map has not shown free ground.

It knows nothing of planners and reads only the map, so that a planner's mistake stays a planner's mistake.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dream.control.setpoints import setpoint
from dream.geometry import SE2, wrap_angle
from dream.mapping import OccupancyMap
from dream.protocol import SurveyProtocol
from dream.types import Decision, Guarded


def guard(
    decision: Decision, pose: SE2, occupancy: OccupancyMap, protocol: SurveyProtocol, z: float | None = None
) -> Guarded:
    """Shorten or refuse a move so that the swept vehicle stays on traversable ground, clear of solids.

    A turn becomes the nearest one that the protocol allows, and so does a tilt. An advance is shortened only
    to another advance of the protocol, a climb to another of its climbs; where none is safe the vehicle turns
    only. In space the swept body must lie in water that is known to be free.

    Args:
        decision: What the planner asked for.
        pose: Where the vehicle is.
        occupancy: What is known; `passable` is the whole test, or in space the volume's `room`.
        protocol: The allowed turns, advances, climbs and tilts.
        z: The vehicle's height in the world, where the protocol moves in space.

    Returns:
        What to carry out, and a sentence where it differs from what was asked.
    """
    if decision.done:
        return Guarded(decision)
    turn = min(protocol.turn_angles, key=lambda allowed: abs(wrap_angle(decision.turn - allowed)))
    notes = []
    if abs(wrap_angle(decision.turn - turn)) > 1e-6:
        asked = math.degrees(decision.turn)
        notes.append(f"a turn of {asked:.0f}° is not in the protocol: {math.degrees(turn):.0f}° instead")
    decision = replace(decision, turn=turn)
    if protocol.space is not None:
        guarded, more = _in_space(decision, pose, occupancy, protocol, z)
        return Guarded(guarded, "; ".join([*notes, *more]))
    lengths = [a for a in sorted(protocol.advances, reverse=True) if a <= decision.advance + 1e-6]
    advance = next(
        (a for a in lengths if _is_safe(replace(decision, advance=a), pose, occupancy, protocol)), 0.0
    )
    if advance < decision.advance - 1e-6:
        how = f"advance {advance:g} m" if advance else "turn only"
        safe = bool(lengths) and lengths[0] == advance
        why = "is not in the protocol" if safe or not lengths else "leaves known free ground"
        notes.append(f"an advance of {decision.advance:g} m {why}: {how}")
    return Guarded(replace(decision, advance=advance), "; ".join(notes))


def _is_safe(move: Decision, pose: SE2, occupancy: OccupancyMap, protocol: SurveyProtocol) -> bool:
    end = setpoint(pose, move, protocol)
    return bool(occupancy.passable(np.array([[pose.x, pose.y]]), np.array([[end.x, end.y]]))[0])


# ---------------------------------------------------------------------------------------------- in space


def _in_space(
    decision: Decision, pose: SE2, occupancy: OccupancyMap, protocol: SurveyProtocol, z: float | None
) -> tuple[Decision, list[str]]:
    """The longest move that is safe and goes no farther ahead, up or down; and what to say of it."""
    notes = []
    tilt = decision.tilt
    if tilt is not None:
        tilt = min(protocol.tilts, key=lambda allowed: abs(allowed - decision.tilt))  # type: ignore[operator]
        if abs(tilt - decision.tilt) > 1e-6:  # type: ignore[operator]
            asked, got = math.degrees(decision.tilt), math.degrees(tilt)  # type: ignore[arg-type]
            notes.append(f"a tilt of {asked:.0f}° is not in the protocol: {got:.0f}° instead")
    asked_for = _words(decision)
    ways = [
        (advance, climb)
        for advance in (0.0, *protocol.advances)
        for climb in protocol.climbs
        if advance <= decision.advance + 1e-6 and climb * decision.climb >= 0.0
        if abs(climb) <= abs(decision.climb) + 1e-6 and (advance > 0.0 or climb != 0.0)
    ]
    # Of two that lead equally far, the one that keeps more of the climb.
    ways.sort(key=lambda way: (math.hypot(*way), abs(way[1])), reverse=True)
    moves = [replace(decision, advance=advance, climb=climb, tilt=tilt) for advance, climb in ways]
    refused = ""
    for move in moves:
        why = obstruction(move, pose, occupancy, protocol, z)
        if not why:
            break
        refused = refused or why
    else:
        move = replace(decision, advance=0.0, climb=0.0, tilt=tilt)
    if (move.advance, move.climb) != (decision.advance, decision.climb):
        why = refused or "is not in the protocol"
        notes.append(f"{asked_for} {why}: {_words(move) or 'turn only'}")
    return move, notes


def obstruction(
    move: Decision, pose: SE2, occupancy: OccupancyMap, protocol: SurveyProtocol, z: float | None
) -> str:
    """Why a move in space is not safe, as the end of a sentence about it; empty where it is.

    Args:
        move: One of the protocol's.
        pose: Where the vehicle is.
        occupancy: With a volume.
        protocol: That moves in space.
        z: The vehicle's height in the world.
    """
    from dream.mapping.volume import SOLID

    assert protocol.space is not None
    assert z is not None
    assert occupancy.volume is not None
    end = setpoint(pose, move, protocol, z)
    assert end.z is not None
    if not occupancy.bounds.contains(end.x, end.y):
        return "leaves the survey area"
    if end.z > -protocol.space.surface:
        return f"leads nearer than {protocol.space.surface:g} m to the surface of the water"
    start, goal = np.array([[pose.x, pose.y, z]]), np.array([[end.x, end.y, end.z]])
    room = occupancy.volume.room(start, goal)
    if not room.clear[0]:
        is_solid = occupancy.volume.state(room.where)[0] == SOLID
        what = "something solid" if is_solid else "water that was never looked into"
        east, north, up = room.where[0].tolist()
        return f"meets {what} at ({east:.1f}, {north:.1f}, {up:.1f})"
    spacing = 0.5 * occupancy.volume.cell
    below = np.arange(0.5 * protocol.body_height, protocol.space.lowest, spacing)
    column = np.column_stack([np.tile(goal[:, :2], (len(below), 1)), end.z - below])
    if (occupancy.volume.state(column) == SOLID).any():
        return f"leads nearer than {protocol.space.lowest:g} m to what lies below"
    return ""


def _words(move: Decision) -> str:
    """An advance and a climb; empty where there is neither."""
    ahead = f"an advance of {move.advance:g} m" if move.advance else ""
    way = "climb" if move.climb > 0.0 else "descent"
    up = f"a {way} of {abs(move.climb):g} m" if move.climb else ""
    return " with ".join(filter(None, (ahead, up)))
