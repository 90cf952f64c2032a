"""A thruster that fails: which one, how, and when."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from dream.vehicle import _kernels


class FaultKind(enum.StrEnum):
    """What a thruster does that fails."""

    DEAD = "dead"
    """It gives no force."""
    WEAK = "weak"
    """It gives 30 % of its force: a propeller that lost blades, or has something wound about it."""
    JAMMED = "jammed"
    """It runs at half throttle ahead, whatever is commanded."""

    @property
    def code(self) -> int:
        """As the kernels count them."""
        return CODES[self]

    @property
    def told(self) -> str:
        """What is said of such a thruster."""
        return TOLD[self]


CODES = {
    FaultKind.DEAD: _kernels.DEAD,
    FaultKind.WEAK: _kernels.WEAK,
    FaultKind.JAMMED: _kernels.JAMMED,
}
TOLD = {FaultKind.DEAD: "is dead", FaultKind.WEAK: "is weak", FaultKind.JAMMED: "is jammed on"}


@dataclass(frozen=True, slots=True)
class ThrusterFault:
    """The fault of one thruster, from a time on."""

    thruster: int
    """Counted from 1, as ArduSub does."""
    kind: FaultKind
    at_s: float
    """Seconds on the mission's clock."""

    def __post_init__(self) -> None:
        if self.thruster < 1:
            raise ValueError(f"fault.thruster: expected a number from 1 on, got {self.thruster}")
        if not 0.0 <= self.at_s < math.inf:
            raise ValueError(f"fault.at_s: expected 0 s or more, got {self.at_s}")

    def check_fits(self, count: int) -> None:
        """Raise a ValueError where a vehicle of so many thrusters has not got it."""
        if self.thruster > count:
            raise ValueError(
                f"fault: expected one of the vehicle's thrusters, 1 to {count}, got {self.thruster}"
            )

    @property
    def packed(self) -> _kernels.PackedFault:
        """As the kernels take it."""
        return _kernels.PackedFault(self.thruster - 1, self.kind.code, float(self.at_s))


def read_fault(told: str) -> ThrusterFault:
    """The fault that `KIND:NUMBER@SECONDS` names, such as `dead:3@40`.

    Raises:
        ValueError: It names none.
    """
    kind, _, rest = told.partition(":")
    number, _, seconds = rest.partition("@")
    try:
        return ThrusterFault(int(number), FaultKind(kind), float(seconds))
    except ValueError as error:
        if str(error).startswith("fault."):
            raise
        kinds = "|".join(FaultKind)
        raise ValueError(
            f"fault: expected {kinds}, the thruster's number and when, in seconds, as dead:3@40, got {told!r}"
        ) from None
