"""Stand-ins for a BlueROV2 and its A50: the real wire protocols over a simulated vehicle."""

from dream.robots.bluerov2.standin.a50 import A50, DvlFaults
from dream.robots.bluerov2.standin.ardusub import ArduSub
from dream.robots.bluerov2.standin.dive import StandIn
from dream.robots.bluerov2.standin.parameters import NEXT, STABLE, Firmware
from dream.robots.bluerov2.standin.tank import Battery, Conditions, Tank
from dream.robots.bluerov2.standin.wire import LinkFaults, Wire

__all__ = [
    "A50",
    "NEXT",
    "STABLE",
    "ArduSub",
    "Battery",
    "Conditions",
    "DvlFaults",
    "Firmware",
    "LinkFaults",
    "StandIn",
    "Tank",
    "Wire",
]
