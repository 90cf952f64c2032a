"""What is wrong with the estimate, and what is done about it."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, fields

from dream.control import _kernels


class Reaction(enum.StrEnum):
    """What the autopilot does, whatever the goal."""

    GO = "go"
    SLOW = "slow"
    """On to the goal at `SLOW` of the speeds."""
    HOLD = "hold"
    """Stay where the estimate is now."""
    SURFACE = "surface"
    """Straight up without an estimate (`_kernels.rise`), and the mission is over."""


class Condition(enum.IntEnum):
    """How far the estimate can be relied on; the higher, the worse."""

    FINE = _kernels.FINE
    BLIND = _kernels.BLIND
    """No velocity from the DVL of late: the position drifts with the square of the time."""
    LOST = _kernels.LOST
    """None for so long that a move may end anywhere."""
    DIVERGED = _kernels.DIVERGED
    """The filter itself says that it does not know, or what it says is not finite."""
    STALE = _kernels.STALE
    """No inertial samples, or nothing that tells heights: nothing that could be flown by."""

    @property
    def reaction(self) -> Reaction:
        """What is done about it."""
        return REACTIONS[self]


REACTIONS = {
    Condition.FINE: Reaction.GO,
    Condition.BLIND: Reaction.SLOW,
    Condition.LOST: Reaction.HOLD,
    Condition.DIVERGED: Reaction.SURFACE,
    Condition.STALE: Reaction.SURFACE,
}
SLOW = _kernels.SLOW


@dataclass(frozen=True, slots=True)
class Watch:
    """When sensors are too old and an estimate too vague. Nothing is let pass without a name."""

    stale: float = 0.2
    """Seconds without an inertial sample; ten times as long without anything that tells heights."""
    blind: float = 1.0
    """Seconds without a velocity of the DVL after which it goes slowly; one comes at least twice a second."""
    lost: float = 10.0
    """Seconds after which it holds."""
    velocity_sigma: float = 0.5
    """m/s of one axis over ground, from which on the filter has diverged."""
    position_sigma: float = 5.0
    """Metres of one horizontal axis, likewise."""

    def __post_init__(self) -> None:
        for limit in fields(self):
            if not 0.0 < getattr(self, limit.name) < math.inf:
                raise ValueError(f"{limit.name}: expected a limit above 0, got {getattr(self, limit.name)}")

    @property
    def limits(self) -> _kernels.Limits:
        """As the kernels take them."""
        return _kernels.Limits(self.stale, self.blind, self.lost, self.velocity_sigma, self.position_sigma)

    def condition(
        self,
        *,
        imu_age: float,
        depth_age: float,
        dvl_age: float,
        velocity_sigma: float,
        position_sigma: float,
    ) -> Condition:
        """The worst that holds; what is not a number is over its limit.

        Args:
            imu_age: Seconds since the last inertial sample.
            depth_age: Seconds since the last depth, or since what tells heights in its place.
            dvl_age: Seconds since the last velocity with bottom lock.
            velocity_sigma: m/s, by the filter.
            position_sigma: Metres, by the filter.
        """
        ages = (imu_age, depth_age, dvl_age)
        return Condition(_kernels.condition(self.limits, *ages, velocity_sigma, position_sigma))
