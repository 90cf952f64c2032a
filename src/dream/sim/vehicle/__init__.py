"""Thruster commands → motion: hulls, thrusters, currents, tether and contact."""

from dream.sim.vehicle.contact import Contact, held
from dream.sim.vehicle.disturbances import STILL, Current, Tether
from dream.sim.vehicle.hydrodynamics import (
    BLUEROV2,
    BLUEROV2_HEAVY,
    GRAVITY,
    Diverged,
    Hull,
    Spread,
    State,
    Vehicle,
)
from dream.sim.vehicle.thrusters import VECTORED, VECTORED_6DOF, Thrusters

__all__ = [
    "BLUEROV2",
    "BLUEROV2_HEAVY",
    "GRAVITY",
    "STILL",
    "VECTORED",
    "VECTORED_6DOF",
    "Contact",
    "Current",
    "Diverged",
    "Hull",
    "Spread",
    "State",
    "Tether",
    "Thrusters",
    "Vehicle",
    "held",
]
