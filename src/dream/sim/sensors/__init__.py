"""Truth → Imu, Dvl, Depth, Heading: the sensors of motion, and how they err."""

from dream.sim.sensors.compass import AHRS, Compass, Dipole
from dream.sim.sensors.dvl import DVL_A50, DVL_A50_PERFORMANCE, RANGE_MODES, DopplerLog, Ping
from dream.sim.sensors.imu import ICM_20602, InertialUnit
from dream.sim.sensors.outage import Bursts, Outage
from dream.sim.sensors.pressure import BAR30, PressureGauge

__all__ = [
    "AHRS",
    "BAR30",
    "DVL_A50",
    "DVL_A50_PERFORMANCE",
    "ICM_20602",
    "RANGE_MODES",
    "Bursts",
    "Compass",
    "Dipole",
    "DopplerLog",
    "InertialUnit",
    "Outage",
    "Ping",
    "PressureGauge",
]
