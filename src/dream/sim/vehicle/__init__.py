"""Thruster commands → motion: a vehicle in currents, on a tether, and in contact."""

from dream.sim.vehicle.contact import Contact, held
from dream.sim.vehicle.disturbances import STILL, Current, Tether
from dream.sim.vehicle.hydrodynamics import BLUEROV2, BLUEROV2_HEAVY, Diverged, Spread, State, Vehicle

__all__ = [
    "BLUEROV2",
    "BLUEROV2_HEAVY",
    "STILL",
    "Contact",
    "Current",
    "Diverged",
    "Spread",
    "State",
    "Tether",
    "Vehicle",
    "held",
]
