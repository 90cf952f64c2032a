"""Decision → Setpoint, on the lattice of the protocol."""

from __future__ import annotations

from dream.geometry import SE2, wrap_angle
from dream.protocol import SurveyProtocol
from dream.types import Decision, Setpoint


def setpoint(pose: SE2, decision: Decision, protocol: SurveyProtocol) -> Setpoint:
    """Where a decision leads from `pose`: the nearest lattice pose, turned, plus the published offset.

    Without an advance the position stays what it is: a turn must not move the vehicle.

    Args:
        pose: Where the vehicle is; an advance snaps it to the lattice, so that errors do not add up.
        decision: Its turn is snapped to the headings; an advance is nominal (see `SurveyProtocol.offset`).
        protocol: Lattice and altitude.
    """
    heading = protocol.heading_index(pose.yaw + decision.turn)
    x, y = pose.x, pose.y
    if decision.advance > 0.0:
        east, north = protocol.offset(heading, decision.advance)
        x = (round(pose.x / protocol.lattice) + east) * protocol.lattice
        y = (round(pose.y / protocol.lattice) + north) * protocol.lattice
    return Setpoint(
        x=x,
        y=y,
        yaw=wrap_angle(heading * protocol.heading_step),
        altitude=protocol.altitude,
    )
