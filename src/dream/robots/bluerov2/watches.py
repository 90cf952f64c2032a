"""What a vehicle should do and does not, by what it reports: readings that part, work that leads nowhere."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from dream.geometry import SE2, wrap_angle
from dream.robots.bluerov2.navigation import Fix

HARD = 0.6
"""Share of what it may ask of its thrusters, from which on a vehicle presses."""
PRESSED = 2.7
"""Seconds of that after which it is told: with what it takes to stop, three."""
EASING = 0.3
"""Seconds over which that share is smoothed: sticks flicker."""
OFF, OFF_YAW = 0.1, math.radians(10.0)
"""Metres and radians from the target, from which on a vehicle is not there."""
NEARER, NEARER_YAW = 0.03, math.radians(2.0)
"""Metres and radians by which a target has to come nearer meanwhile."""
FARTHER, FARTHER_YAW = 0.25, math.radians(30.0)
"""Metres and radians by which it may get farther: past that it is told at once (a reversed thruster)."""


@dataclass(slots=True)
class Parted:
    """Two readings of one quantity that have to stay as far apart as they were.

    What it does: takes how far they are apart when both are first there, and says so once that has changed by
    more than a limit for a while. A zero of their own that each may have does not matter.
    """

    limit: float
    """By how much it may change."""
    patience: float = 1.0
    """Seconds."""
    _apart: float = math.nan
    _since: float = math.inf

    def __call__(self, now: float, one: float, other: float) -> bool:
        """Have they parted? Not where one of them is not known."""
        apart = one - other
        if math.isnan(self._apart):
            self._apart = apart
        if not abs(apart - self._apart) > self.limit:
            self._since = math.inf
            return False
        self._since = min(self._since, now)
        return now - self._since >= self.patience


@dataclass(slots=True)
class _Effort:
    """How long an error has not shrunk."""

    nearer: float
    """By how much it has to shrink to count."""
    farther: float = math.inf
    """By how much it may grow."""
    _from: float = math.nan
    _since: float = math.inf

    def forget(self) -> None:
        self._from, self._since = math.nan, math.inf

    def lasting(self, now: float, error: float) -> float:
        """Seconds for which it has not been less by `nearer`; inf where it is more by `farther`."""
        if not error > self._from - self.nearer:
            self._from, self._since = error, now
        return math.inf if error > self._from + self.farther else now - self._since


@dataclass(slots=True)
class Pressing:
    """Says when the vehicle works for nothing: it presses against something, or its depth stays where it was.

    What it does: a vehicle that works hard (`HARD`) while its goal is off (`OFF`, `OFF_YAW`) has to come
    nearer to it; one whose depth is off has to move towards its target, however hard it works, since depth is
    the autopilot's. Where it does neither for `PRESSED` seconds it is told.
    Assumes: it is asked at every beat that steers; `forget` where one does not. One that holds its place
    against a current or a tether is at its goal, and presses on nothing.
    """

    _share: float = 0.0
    _goal: SE2 | None = None
    _place: _Effort = field(default_factory=lambda: _Effort(NEARER, FARTHER))
    _yaw: _Effort = field(default_factory=lambda: _Effort(NEARER_YAW, FARTHER_YAW))
    _depth: _Effort = field(default_factory=lambda: _Effort(NEARER))
    _z: float = math.nan
    _last: float = math.nan

    def forget(self) -> None:
        """Nothing is asked of it now."""
        self._share, self._last = 0.0, math.nan
        for effort in (self._place, self._yaw, self._depth):
            effort.forget()

    def __call__(self, now: float, fix: Fix, goal: SE2, z: float, effort: float) -> str:
        """What is wrong, in words; empty where nothing is.

        Args:
            now: Seconds on the dive's clock.
            fix: Where it is.
            goal: Where it is sent.
            z: Metres in the world, likewise.
            effort: Share of what it may ask of its thrusters that it asks now.
        """
        pose, dt = fix.T_world_base.se2, now - self._last
        self._last = now
        share = 1.0 if math.isnan(dt) else 1.0 - math.exp(-dt / EASING)
        self._share += share * (effort - self._share)
        if goal != self._goal:
            self._goal = goal
            self._place.forget()
            self._yaw.forget()
        away, turned = pose.distance(goal), abs(wrap_angle(goal.yaw - pose.yaw))
        pressed = 0.0
        for watch, error, off in ((self._place, away, OFF), (self._yaw, turned, OFF_YAW)):
            if self._share < HARD or error <= off:
                watch.forget()
            else:
                pressed = max(pressed, watch.lasting(now, error))
        if pressed >= PRESSED:
            lasts = f" for {pressed:.1f} s" if pressed < math.inf else ""
            comes = "comes no nearer" if pressed < math.inf else "gets farther"
            return (
                f"it presses: {self._share:.0%} of its thrust{lasts}, "
                f"{away:.2f} m and {math.degrees(turned):.0f}° from its goal, and {comes}"
            )
        sunk = self._lag(now, float(fix.T_world_base.translation[2]), z)
        if sunk >= PRESSED:
            height = float(fix.T_world_base.translation[2])
            return f"its depth does not follow: {-height:.2f} m for {sunk:.1f} s, {-z:.2f} m are wanted"
        return ""

    def _lag(self, now: float, height: float, z: float) -> float:
        """Seconds for which the depth is off and does not move towards its target, which may move away."""
        error = z - height
        if not abs(error) > OFF:
            self._depth.forget()
            self._z = math.nan
            return 0.0
        side = float(np.sign(error))
        if math.isnan(self._z) or math.copysign(1.0, self._z) != side:
            self._depth.forget()
        self._z = side
        return self._depth.lasting(now, -side * height)
