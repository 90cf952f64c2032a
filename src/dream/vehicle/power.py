"""What a vehicle draws from its battery: its thrusters, and all else that it carries."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.vehicle import _kernels
from dream.vehicle.hull import Hull
from dream.vehicle.thrusters import TABLE_VOLTAGE, Thrusters

Float64Array = npt.NDArray[np.float64]

T200_AMPERES = (
    (-1.0, 24.3),
    (-0.75, 11.9),
    (-0.5, 4.4),
    (-0.25, 0.7),
    (-0.15, 0.2),
    (-0.1, 0.05),
    (-0.07, 0.0),
    (0.07, 0.0),
    (0.1, 0.05),
    (0.15, 0.2),
    (0.25, 0.8),
    (0.5, 4.6),
    (0.75, 11.9),
    (1.0, 23.8),
)
"""Command and amperes of a Blue Robotics T200 at 16 V, of the same table as `thrusters.T200`."""
AMPERES_POWER = 1.15
"""Amperes grow with this power of the voltage at the same command. The maker's table at 12 V has 16.9 A ahead
and 17.0 A astern at full throttle, 8.9 A both ways at three quarters and 3.3 A at half: from half throttle on
they are met within 5 %."""
HOTEL_W = 24.0
"""Watts of everything but thrusters and lamps, an assumption: a single-board computer with its flight
controller takes about 8, camera and servo 3, the tether's modem 2, the DVL A50 4, and eight idle speed
controllers 6."""


def watt_points(voltage: float = TABLE_VOLTAGE) -> tuple[Float64Array, Float64Array]:
    """Commands, and cube roots of the watts that a T200 draws at them, which go with the propeller's
    speed."""
    command, amperes = np.array(T200_AMPERES, np.float64).T
    watts = voltage * amperes * (voltage / TABLE_VOLTAGE) ** AMPERES_POWER
    return command.copy(), np.cbrt(watts)


def watts(commands: npt.ArrayLike, voltage: float = TABLE_VOLTAGE) -> Float64Array:
    """(...) watts that T200s draw at commands (...), by the maker's table; beyond ±1 as at ±1."""
    values = np.asarray(commands, np.float64)
    points, roots = watt_points(voltage)
    return np.array([_kernels.watts(points, roots, u) for u in values.ravel()]).reshape(values.shape)


@dataclass(frozen=True, slots=True)
class PowerModel:
    """What a vehicle draws by the forces of its thrusters, whatever the voltage.

    What it does: a propeller's power goes with about the 1.5th power of its force (actuator disk); the
    exponents and factors are fitted to the maker's table at 16 V.
    Fails when: below 4 N it is up to a third too little; at 12 V up to 17 % too much.
    """

    ahead: tuple[float, float] = (0.801, 1.564)
    """Factor and exponent: W of N."""
    astern: tuple[float, float] = (0.855, 1.66)
    hotel: float = HOTEL_W

    def thruster(self, newtons: npt.ArrayLike) -> Float64Array:
        """(...) watts of thrusters that give forces (...)."""
        force = np.asarray(newtons, np.float64)
        (a, b), (c, d) = self.ahead, self.astern
        return np.where(force >= 0.0, a * np.maximum(force, 0.0) ** b, c * np.maximum(-force, 0.0) ** d)

    def under_way(self, hull: Hull, thrusters: Thrusters, speed: float) -> float:
        """Watts that it draws while it swims straight ahead at a steady speed, m/s, in still water.

        The thrusters also hold it down against its net buoyancy.
        """
        drag = (hull.linear[0] + hull.quadratic[0] * abs(speed)) * speed
        wrench = np.array([drag, 0.0, -hull.net_buoyancy, 0.0, 0.0, 0.0])
        forces = np.linalg.lstsq(thrusters.allocation, wrench, rcond=None)[0]
        return self.hotel + float(self.thruster(forces).sum())
