"""Decision → Setpoint, on the lattice of the protocol."""

from __future__ import annotations

from dream.geometry import SE2, wrap_angle
from dream.protocol import SurveyProtocol
from dream.types import Decision, Setpoint


def setpoint(pose: SE2, decision: Decision, protocol: SurveyProtocol, z: float | None = None) -> Setpoint:
    """Where a decision leads from `pose`: the nearest lattice pose, turned, plus the published offset.

    Without an advance the position stays what it is, and without a climb the height: a turn must not move
    the vehicle.

    Args:
        pose: Where the vehicle is; an advance snaps it to the lattice, so that errors do not add up.
        decision: Its turn is snapped to the headings; an advance is nominal (see `SurveyProtocol.offset`).
        protocol: Lattice and altitude.
        z: The vehicle's height in the world, where the protocol moves in space.

    Raises:
        ValueError: The protocol moves in space, and no height is given.
    """
    heading = protocol.heading_index(pose.yaw + decision.turn)
    x, y, spacing = pose.x, pose.y, protocol.lattice
    if decision.advance > 0.0:
        east, north = protocol.offset(heading, decision.advance)
        x = (round(pose.x / spacing) + east) * spacing
        y = (round(pose.y / spacing) + north) * spacing
    yaw = wrap_angle(heading * protocol.heading_step)
    if protocol.space is None:
        return Setpoint(x=x, y=y, yaw=yaw, altitude=protocol.altitude)
    if z is None:
        raise ValueError(f"z: expected the vehicle's height, since {protocol.name} moves in space, got none")
    if decision.advance > 0.0 or decision.climb != 0.0:
        z = (round(z / spacing) + round(decision.climb / spacing)) * spacing
    return Setpoint(x=x, y=y, yaw=yaw, altitude=None, z=z, tilt=decision.tilt)
