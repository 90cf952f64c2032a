"""What a vehicle is made of, as its simulator and its autopilot both need to know."""

from dream.vehicle.faults import Fault, FaultKind, PartFault, ThrusterFault, VehiclePart, light, read_fault
from dream.vehicle.hull import GRAVITY, Hull
from dream.vehicle.power import HOTEL_W, PowerModel, watt_points, watts
from dream.vehicle.thrusters import VECTORED, VECTORED_6DOF, Thrusters

__all__ = [
    "GRAVITY",
    "HOTEL_W",
    "VECTORED",
    "VECTORED_6DOF",
    "Fault",
    "FaultKind",
    "Hull",
    "PartFault",
    "PowerModel",
    "ThrusterFault",
    "Thrusters",
    "VehiclePart",
    "light",
    "read_fault",
    "watt_points",
    "watts",
]
