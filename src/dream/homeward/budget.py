"""What a mission may spend until it is home, as its operator says."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dream.geometry import Bounds
from dream.homeward.pace import nominal_seconds
from dream.protocol import SurveyProtocol
from dream.types import LOOK_AROUND, Decision
from dream.vehicle import HOTEL_W

SLACK = 0.05
"""Share of a tether that is kept back, since it is never quite taut."""
LIMITS = {
    "seconds": ("--budget-s", "s"),
    "battery_wh": ("--battery-wh", "Wh"),
    "tether_m": ("--tether-m", "m"),
}
"""What a budget may limit: the option that says so, and the unit."""


@dataclass(frozen=True, slots=True)
class Budget:
    """What a mission may spend until it is home; with the defaults it goes home and may spend what it
    likes."""

    seconds: float = math.inf
    """On the mission's clock, from the first look."""
    battery_wh: float = math.inf
    """Watt-hours that all that the vehicle carries may draw, from the first look."""
    tether_m: float = math.inf
    """Metres of tether, from where it begins."""
    home: tuple[float, float] | None = None
    """x and y, metres in the world; where it begins unless given."""

    def __post_init__(self) -> None:
        for name, (_, unit) in LIMITS.items():
            if not getattr(self, name) > 0.0:
                raise ValueError(f"budget: expected more than 0 {unit}, got {getattr(self, name)}")
        if self.home is not None and not all(map(math.isfinite, self.home)):
            raise ValueError(f"home: expected finite metres, got {self.home}")

    def as_dict(self) -> dict[str, Any]:
        """As it stands in a file: what has no limit is None."""
        limits = {name: getattr(self, name) for name in LIMITS}
        told = {name: most if math.isfinite(most) else None for name, most in limits.items()}
        return {**told, "home": None if self.home is None else list(self.home)}

    @property
    def options(self) -> list[str]:
        """The words of a command line that say so."""
        words = ["--return", "start" if self.home is None else f"{self.home[0]:g},{self.home[1]:g}"]
        for name, (option, _) in LIMITS.items():
            most = getattr(self, name)
            words += [option, f"{most:g}"] if math.isfinite(most) else []
        return words

    def check(self, bounds: Bounds, protocol: SurveyProtocol) -> None:
        """Raise a ValueError where no mission can keep to it, whatever lies there.

        Args:
            bounds: The survey area.
            protocol: Whose look-around every mission begins with.
        """
        least = LOOK_AROUND * nominal_seconds(Decision(turn=0.5 * math.pi))
        if self.battery_wh < least * HOTEL_W / 3600.0:
            raise ValueError(
                f"budget: expected {least * HOTEL_W / 3600.0:.2f} Wh or more, which the first look around "
                f"draws, got {self.battery_wh:g}"
            )
        if self.seconds < least:
            raise ValueError(
                f"budget: expected {math.ceil(least)} s or more, which the first look around takes, "
                f"got {self.seconds:g}"
            )
        longest = math.hypot(max(protocol.advances) + protocol.lattice, *protocol.climbs[-1:])
        if (1.0 - SLACK) * self.tether_m < longest:
            raise ValueError(
                f"tether: expected {longest / (1.0 - SLACK):.1f} m or more, for one move of {protocol.name} "
                f"and a share of {SLACK:g} that is kept back, got {self.tether_m:g}"
            )
        if self.home is not None and not bounds.contains(*self.home, margin=protocol.body_radius):
            raise ValueError(
                f"home: expected a place inside the survey area, {bounds}, with room for the vehicle, "
                f"got ({self.home[0]:g}, {self.home[1]:g})"
            )

    def check_from(self, x: float, y: float) -> None:
        """Raise a ValueError where the tether does not reach from where it begins to where it should go home
        to.

        Args:
            x: Where it begins, metres in the world.
            y: Likewise.
        """
        if self.home is None:
            return
        away = math.hypot(self.home[0] - x, self.home[1] - y)
        if away > (1.0 - SLACK) * self.tether_m:
            raise ValueError(
                f"home: expected a place within {(1.0 - SLACK) * self.tether_m:.1f} m of the start at "
                f"({x:g}, {y:g}), as far as a tether of {self.tether_m:g} m reaches with a share of "
                f"{SLACK:g} kept back, got ({self.home[0]:g}, {self.home[1]:g}), {away:.1f} m away"
            )


def read_budget(told: Mapping[str, Any]) -> Budget:
    """A budget from what `as_dict` made of it.

    Raises:
        ValueError: Something in it is no number, or none that a budget may have.
    """
    try:
        # A file that says nothing of a tether is of a mission without one.
        told = {"tether_m": None, **told}
        limits = {name: math.inf if told[name] is None else float(told[name]) for name in LIMITS}
        home = None if told["home"] is None else tuple(map(float, told["home"]))
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"budget: expected {', '.join(LIMITS)} and home, got {str(told)[:80]}") from error
    if home is not None and len(home) != 2:
        raise ValueError(f"budget: home: expected x and y, got {str(told['home'])[:80]}")
    return Budget(home=home, **limits)
