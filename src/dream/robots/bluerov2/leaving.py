"""The end of a dive: the vehicle is brought where its operator wants it."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable

from dream.robots.bluerov2.bridge import SAG, LastResort, Limits
from dream.robots.bluerov2.devices import Devices
from dream.robots.bluerov2.mavlink import Refused

logger = logging.getLogger(__name__)

LEAVING = 120.0
"""Seconds that the way to the surface may take."""
SHALLOW = 0.4
"""Metres of depth at which a vehicle that surfaces is there: its gauge sits below its top."""


def leave(devices: Devices, limits: Limits, tell: Callable[[str], None]) -> None:
    """Bring the vehicle where the operator wants it in the end; one that is not ours stays.

    One that holds comes up as well when there is water in it, or its battery is low.
    """
    link, station, how = devices.link, devices.station, limits.last_resort
    if not link.engaged or link.yielding:
        return
    try:
        while station is not None and station.has:
            # A person at the sticks brings it home.
            link.operator_alive()
            time.sleep(0.1)
        if how is LastResort.HOLD:
            tell("it holds its depth: take the sticks, or end with Ctrl-C")
        elif how is LastResort.SURFACE:
            link.set_mode("SURFACE")
            tell("it comes to the surface")
        fed = devices.now()
        until = fed + (LEAVING if how is LastResort.SURFACE else math.inf)
        while how is not LastResort.DISARM and link.engaged and not link.yielding and devices.now() < until:
            said = link.telemetry
            # By its own reckoning, where it tells: a dive may have begun under water.
            depth = -said.own_altitude if math.isfinite(said.own_altitude) else said.depth
            if how is LastResort.SURFACE and depth < SHALLOW:
                break
            if not said.voltage < limits.voltage:
                fed = devices.now()
            low = devices.now() - fed > SAG
            if how is LastResort.HOLD and (said.leak or low):
                why = "water in the hull" if said.leak else f"battery at {said.voltage:.1f} V"
                logger.warning("%s: it does not hold any longer, but comes to the surface", why)
                link.set_mode("SURFACE")
                how, until = LastResort.SURFACE, devices.now() + LEAVING
            link.operator_alive()
            time.sleep(0.1)
        if link.engaged and not link.yielding:
            link.disarm()
    except (KeyboardInterrupt, TimeoutError, Refused, OSError) as error:
        logger.warning("the vehicle was left as it is: %s", str(error) or "interrupted")
