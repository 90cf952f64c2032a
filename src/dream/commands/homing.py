"""Options of the commands that fly: what a mission may spend, and where it goes in the end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from dream.homeward import Budget


@dataclass(frozen=True, slots=True)
class Homing:
    """The way home: with any of these the mission ends at home, and turns back in time for it."""

    budget_s: float | None = None
    """Seconds that the mission may take until it is home."""
    battery_wh: float | None = None
    """Watt-hours that the vehicle may draw until it is home. A BlueROV2's battery of 18 Ah holds 266."""
    tether_m: float | None = None
    """Metres of the tether that it drags from where it begins: its way through the scene is never longer."""
    home: Annotated[str | None, tyro.conf.arg(name="return", metavar="start|X,Y")] = None
    """Where home is: `start`, where the mission begins, or a place, metres in the map. Unless given,
    `start`."""

    def budget(self) -> Budget | None:
        """None where nothing was chosen: the mission ends where it is.

        Raises:
            ValueError: An option is not what it should be.
        """
        if self == Homing():
            return None
        from dream.homeward import Budget

        for name, most in (
            ("--budget-s", self.budget_s),
            ("--battery-wh", self.battery_wh),
            ("--tether-m", self.tether_m),
        ):
            if most is not None and not 0.0 < most < math.inf:
                raise ValueError(f"{name}: expected a number above 0, got {most:g}")
        return Budget(
            seconds=math.inf if self.budget_s is None else self.budget_s,
            battery_wh=math.inf if self.battery_wh is None else self.battery_wh,
            tether_m=math.inf if self.tether_m is None else self.tether_m,
            home=_place(self.home),
        )


def _place(told: str | None) -> tuple[float, float] | None:
    """x and y; None where home is the start."""
    if told in (None, "start"):
        return None
    try:
        x, y = (float(part) for part in told.split(","))
    except ValueError:
        raise ValueError(f"--return: expected start, or x and y in metres as 3.5,-2, got {told!r}") from None
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError(f"--return: expected finite metres, got {told!r}")
    return x, y
