"""What a stand-in ArduSub does when pilot, ground station or battery are lost, or water comes in."""

from __future__ import annotations

import math
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as mav

from dream.robots.bluerov2.standin.helm import ALT_HOLD, SURFACE, ModeControl
from dream.robots.bluerov2.standin.motors import Channels
from dream.robots.bluerov2.standin.parameters import Parameters
from dream.robots.bluerov2.standin.tank import Tank

WARNED_GCS, WARNED_LEAK = 30.0, 20.0
"""Seconds between two warnings of the same."""
NONE, DISARM, HOLD, SURFACES = 0.0, 2.0, 3.0, 4.0
"""FS_GCS_ENABLE; FS_PILOT_INPUT knows the first two, and 1 is to warn in both."""
BATTERY = (("low", "BATT_LOW_VOLT", "BATT_FS_LOW_ACT"), ("critical", "BATT_CRT_VOLT", "BATT_FS_CRT_ACT"))
"""Word, voltage and action of the levels of the battery; 2 disarms and 3 surfaces."""


class Protected(Protocol):
    """The autopilot that failsafes act on."""

    @property
    def tank(self) -> Tank:
        """Where it swims."""
        ...

    @property
    def helm(self) -> ModeControl:
        """Mode, sticks and targets."""
        ...

    @property
    def parameters(self) -> Parameters:
        """By their names."""
        ...

    @property
    def drawn(self) -> float:
        """Ampere-hours that were drawn since it booted."""
        ...

    @property
    def armed(self) -> bool:
        """Do its motors run?"""
        ...

    def set_mode(self, mode: int) -> bool:
        """Change the mode, where it may be; does it hold now?"""
        ...

    def disarm(self) -> None:
        """Stop the motors."""
        ...

    def say(self, severity: int, text: str) -> None:
        """A STATUSTEXT."""
        ...


class Failsafes:
    """Checked each beat; each acts once, until what was lost is back.

    Reference: ArduSub, `failsafe.cpp`. A pilot who never was is lost once, that long after booting; a ground
    station that never was is never lost.
    """

    def __init__(self, sub: Protected, booted_at: float) -> None:
        """Since when it runs, in the tank's time."""
        self._sub, self._booted_at = sub, booted_at
        self._piloted_at = self._station_at = -math.inf
        self._station_lost = self._leaking = False
        self._warned_station = self._warned_leak = -math.inf
        self._low_since = {word: math.inf for word, _, _ in BATTERY}
        self._battery_failed: set[str] = set()

    @property
    def triggered(self) -> bool:
        """Is any?"""
        lost = self._sub.helm.pilot_lost or self._station_lost
        return lost or self._leaking or bool(self._battery_failed)

    def piloted(self) -> None:
        """The pilot has moved the sticks, or left them where they are; that is a sign of the station, too."""
        self._piloted_at = self._station_at = self._sub.tank.time

    def seen(self) -> None:
        """A heartbeat of the ground station."""
        self._station_at = self._sub.tank.time

    def check(self) -> None:
        """Act on what is lost."""
        self._pilot()
        self._station()
        self._leak()
        for word, volts, action in BATTERY:
            self._battery(word, volts, action)

    def _pilot(self) -> None:
        sub = self._sub
        action, timeout = sub.parameters["FS_PILOT_INPUT"], sub.parameters["FS_PILOT_TIMEOUT"]
        if action == NONE or sub.tank.time < max(self._piloted_at, self._booted_at) + timeout:
            sub.helm.pilot_lost = False
            return
        if sub.helm.pilot_lost:
            return
        sub.helm.pilot_lost = True
        sub.say(mav.MAV_SEVERITY_CRITICAL, "Lost manual control")
        sub.helm.sticks = Channels()
        if action == DISARM:
            sub.disarm()

    def _station(self) -> None:
        sub = self._sub
        action, timeout = sub.parameters["FS_GCS_ENABLE"], sub.parameters["FS_GCS_TIMEOUT"]
        if action == NONE or self._station_at == -math.inf:
            return
        now = sub.tank.time
        if now - self._station_at < timeout:
            self._station_lost = False
            return
        if now - self._warned_station > WARNED_GCS:
            self._warned_station = now
            sub.say(mav.MAV_SEVERITY_WARNING, f"MYGCS: {sub.parameters.gcs}, heartbeat lost")
        if self._station_lost or not sub.armed:
            return
        self._station_lost = True
        mode = {HOLD: ALT_HOLD, SURFACES: SURFACE}.get(action)
        if action == DISARM or (mode is not None and not sub.set_mode(mode)):
            sub.disarm()

    def _leak(self) -> None:
        sub = self._sub
        action, now = sub.parameters["FS_LEAK_ENABLE"], sub.tank.time
        if not sub.tank.leak or action == NONE:
            self._leaking = False
            return
        if now - self._warned_leak > WARNED_LEAK:
            self._warned_leak = now
            sub.say(mav.MAV_SEVERITY_CRITICAL, "Leak Detected")
        if not self._leaking:
            self._leaking = True
            if action == 2.0 and sub.armed:
                sub.set_mode(SURFACE)

    def _battery(self, word: str, volts: str, action: str) -> None:
        sub = self._sub
        least, now = sub.parameters[volts], sub.tank.time
        if least <= 0.0 or sub.tank.voltage >= least:
            self._low_since[word] = math.inf
            return
        self._low_since[word] = min(self._low_since[word], now)
        late = now - self._low_since[word] >= sub.parameters["BATT_LOW_TIMER"]
        if not late or word in self._battery_failed:
            return
        self._battery_failed.add(word)
        used = f"{sub.tank.voltage:.1f}V used {1000.0 * sub.drawn:.0f} mAh"
        sub.say(mav.MAV_SEVERITY_WARNING, f"Battery 1 is {word} {used}")
        if sub.parameters[action] == 2.0:
            sub.disarm()
        elif sub.parameters[action] == 3.0:
            sub.set_mode(SURFACE)
