"""What fails on a vehicle: a thruster or another part, how, and when."""

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
        _check_time(self.at_s)

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


class VehiclePart(enum.StrEnum):
    """What fails beside thrusters."""

    SAG = "sag"
    """The battery: a contact or a cell of `_kernels.SAG_OHM`, at which its voltage falls under load."""
    LAMP = "lamp"
    """The lamp goes out: a share of `LAMP_LEFT` of the light is left."""
    GAUGE = "gauge"
    """The depth sensor repeats what it said last."""
    CAMERA = "camera"
    """Its pictures are black."""


LAMP_LEFT = 0.15
"""Of the light, by day, without a lamp. Assumption."""


@dataclass(frozen=True, slots=True)
class PartFault:
    """The fault of another part, from a time on."""

    part: VehiclePart
    at_s: float
    """Seconds on the mission's clock."""

    def __post_init__(self) -> None:
        _check_time(self.at_s)


Fault = ThrusterFault | PartFault


def light(fault: Fault | None, time: float) -> float:
    """The share of the light that pictures have at a time, in seconds on the mission's clock."""
    if not isinstance(fault, PartFault) or time < fault.at_s:
        return 1.0
    return {VehiclePart.LAMP: LAMP_LEFT, VehiclePart.CAMERA: 0.0}.get(fault.part, 1.0)


def read_fault(told: str) -> Fault:
    """The fault that `KIND:NUMBER@SECONDS` names for a thruster, such as `dead:3@40`, or `PART@SECONDS`.

    Raises:
        ValueError: It names none.
    """
    what, _, seconds = told.partition("@")
    kind, _, number = what.partition(":")
    try:
        if what in list(VehiclePart):
            return PartFault(VehiclePart(what), float(seconds))
        return ThrusterFault(int(number), FaultKind(kind), float(seconds))
    except ValueError as error:
        if str(error).startswith("fault."):
            raise
        raise ValueError(
            f"fault: expected {'|'.join(FaultKind)} and the thruster's number, or {'|'.join(VehiclePart)}, "
            f"and when, in seconds, as dead:3@40 or lamp@40, got {told!r}"
        ) from None


def _check_time(seconds: float) -> None:
    if not 0.0 <= seconds < math.inf:
        raise ValueError(f"fault.at_s: expected 0 s or more, got {seconds}")
