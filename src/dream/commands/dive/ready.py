"""A dive whose devices are open."""

from __future__ import annotations

import contextlib
import datetime
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from dream.commands.dive.console import tell
from dream.commands.dive.options import Sight, Waters, mounting_told
from dream.errors import MissionAborted
from dream.geometry import SE2, SE3
from dream.protocol import SurveyProtocol

if TYPE_CHECKING:
    from dream.commands.dive import Dive
    from dream.commands.dive.tank import Tank
    from dream.commands.ground import Known
    from dream.robots.bluerov2.devices import Devices, LiveEye
    from dream.robots.bluerov2.limits import Limits

HEARTBEAT = 30.0
"""Seconds that the first heartbeat of the vehicle may take."""


@dataclass
class Ready:
    """A dive whose devices answer."""

    told: Dive
    protocol: SurveyProtocol
    devices: Devices
    limits: Limits
    start: SE2
    folder: Path
    tank: Tank | None
    sight: Sight
    known: Known
    """Of the ground."""

    def steered(self) -> bool:
        """Has a person the sticks?"""
        station = self.devices.station
        return station is not None and station.has

    @cached_property
    def mount(self) -> SE3:
        """`T_base_camera`."""
        from dream.robots.bluerov2.camera import mounted

        return mounted(math.radians(self.told.tilt), self.told.camera_at)

    @cached_property
    def eye(self) -> LiveEye:
        """The camera, behind its lens. Made once: a lens takes a second to prepare."""
        from dream.robots.bluerov2.devices import LiveEye

        return LiveEye(self.devices.camera, self.sight.lens)


@contextlib.contextmanager
def opened(told: Dive, waters: Waters, folder: Path, began: datetime.datetime) -> Iterator[Devices]:
    """All devices, connected; closed again in the end, and the vehicle's parameters put back."""
    from dream.robots.bluerov2.devices import DENSITY, Devices
    from dream.robots.bluerov2.mavlink import Refused
    from dream.robots.bluerov2.navigation import Instruments

    with Devices(
        waters.addresses,
        Instruments(told.estimator, mounting_told(told)),
        folder,
        epoch_ns=round(1e9 * began.timestamp()),
        density=DENSITY[told.water],
        surface_pressure=waters.surface_pressure,
        sound=told.speed_of_sound,
    ) as devices:
        try:
            devices.connect(HEARTBEAT)
            if told.set_parameters or told.stand_in:
                devices.link.correct(devices.link.check_parameters())
            yield devices
        except (TimeoutError, Refused) as error:
            raise MissionAborted(f"vehicle: {str(error).removeprefix('vehicle: ')}") from error
        finally:
            # None of a vehicle that is still armed: its failsafes stop it once nobody speaks to it.
            with contextlib.suppress(OSError):
                if left := devices.link.restore().left:
                    tell(how_to_restore(len(left), folder), quiet=told.json)


def how_to_restore(left: int, folder: Path) -> str:
    """What an operator has to do where parameters could not be put back."""
    from dream.robots.bluerov2.devices import PARAMETERS_BEFORE

    of = "1 parameter is" if left == 1 else f"{left} parameters are"
    return (
        f"{of} not as before the dive: their values stand in {folder / PARAMETERS_BEFORE}. Put them back "
        "with a ground station, such as QGroundControl"
    )
