"""State, world → a state that touches nothing, and how often it did."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dream.protocol import SurveyProtocol
from dream.sim.solids import Solids
from dream.sim.vehicle import _kernels
from dream.sim.vehicle.hydrodynamics import State, Vehicle


@dataclass(frozen=True, slots=True)
class Contact:
    """What a vehicle has run into so far."""

    collisions: int = 0
    """How often a contact began. Leaning on a wall, or sliding along it, is one."""
    touching: bool = False
    """Is it within 2 cm of what it touched last?"""
    stuck: bool = False
    """Did it touch something from the start, and has not been free since?"""


def held(
    vehicle: Vehicle,
    solids: Solids,
    protocol: SurveyProtocol,
    before: State,
    after: State,
    contact: Contact,
) -> tuple[State, Contact]:
    """The state after a step, kept out of terrain, obstacles and hulls.

    The body is the protocol's cylinder about the vehicle's centre; it stays level however the vehicle tilts.
    Contact is an inelastic impact without friction: the velocity towards the solid goes, by an impulse along
    its horizontal normal, or upwards or downwards, on the vehicle and the water that it moves; so kinetic
    energy never grows. Turn rates stay. A vehicle that begins in contact can only
    rise.

    Args:
        vehicle: What moves.
        solids: What is in the way.
        protocol: Radius and height of the body.
        before: The state at the start of the step.
        after: The state at its end, as `Vehicle.step` gives it.
        contact: Before the step.
    """
    x = State.of(after.vector).vector
    memory = np.array([contact.collisions, contact.touching, contact.stuck], np.float64)
    _kernels.hold(
        vehicle.body,
        solids.index,
        protocol.body_radius,
        protocol.body_height,
        State.of(before.vector).vector,
        x,
        memory,
    )
    return State.of(x), Contact(int(memory[0]), bool(memory[1]), bool(memory[2]))
