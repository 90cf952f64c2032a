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


def guard(decision: Decision, pose: SE2, occupancy: OccupancyMap, protocol: SurveyProtocol) -> Guarded:
    """Shorten or refuse a move so that the swept vehicle stays on traversable ground, clear of solids.

    A turn becomes the nearest one that the protocol allows. An advance is shortened only to another
    advance of the protocol; where none is safe the vehicle turns only.

    Args:
        decision: What the planner asked for.
        pose: Where the vehicle is.
        occupancy: What is known; `passable` is the whole test.
        protocol: The allowed turns and advances.

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
    lengths = [a for a in sorted(protocol.advances, reverse=True) if a <= decision.advance + 1e-6]
    advance = next(
        (a for a in lengths if _is_safe(replace(decision, turn=turn, advance=a), pose, occupancy, protocol)),
        0.0,
    )
    if advance < decision.advance - 1e-6:
        how = f"advance {advance:g} m" if advance else "turn only"
        safe = bool(lengths) and lengths[0] == advance
        why = "is not in the protocol" if safe or not lengths else "leaves known free ground"
        notes.append(f"an advance of {decision.advance:g} m {why}: {how}")
    return Guarded(replace(decision, turn=turn, advance=advance), "; ".join(notes))


def _is_safe(move: Decision, pose: SE2, occupancy: OccupancyMap, protocol: SurveyProtocol) -> bool:
    end = setpoint(pose, move, protocol)
    return bool(occupancy.passable(np.array([[pose.x, pose.y]]), np.array([[end.x, end.y]]))[0])
