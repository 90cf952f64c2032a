"""Orders that expire: what may move the vehicle now."""

from __future__ import annotations

import math

from dream.robots.bluerov2.sticks import NEUTRAL, STILL, Sticks, forward_right_down
from dream.types import BodyVelocity

Order = Sticks | BodyVelocity

LONGEST = 0.5
"""Seconds. No order holds for longer than this unless it is given again."""


class ExpiringOrders:
    """What moves the vehicle now: orders that expire. Not thread-safe."""

    def __init__(self) -> None:
        self._mission: tuple[Order, float] = (NEUTRAL, -math.inf)
        self._pilot: tuple[Sticks, float] = (NEUTRAL, -math.inf)

    def command(self, order: Order, expires: float, now: float) -> float:
        """The mission's order until `expires`, at most `LONGEST` ahead; returns until when it holds."""
        if isinstance(order, BodyVelocity):
            forward_right_down(order)
        until = _until(expires, now)
        self._mission = order, until
        return until

    def pilot(self, sticks: Sticks, expires: float, now: float) -> float:
        """As `command`, from a person: outranks the mission for as long as it holds."""
        until = _until(expires, now)
        self._pilot = sticks, until
        return until

    def stop(self) -> None:
        """Forget all orders."""
        self._mission = NEUTRAL, -math.inf
        self._pilot = NEUTRAL, -math.inf

    def due(self, now: float, *, guided: bool) -> tuple[Sticks, BodyVelocity | None]:
        """Sticks to send, and in GUIDED the velocity beside them; neutral where no order holds.

        Sticks are no order in GUIDED, where they would turn the vehicle behind the velocity's back, unless
        they are a person's; a velocity is none elsewhere, where ArduSub ignores it without a word.
        """
        sticks, velocity = NEUTRAL, STILL
        if now < self._pilot[1]:
            sticks = self._pilot[0]
        elif now < self._mission[1]:
            order = self._mission[0]
            if isinstance(order, BodyVelocity):
                velocity = order
            elif not guided:
                sticks = order
        return sticks, velocity if guided else None

    def next_expiry(self, now: float) -> float:
        """Seconds until the next order expires; infinite when none holds."""
        return min((t - now for t in (self._mission[1], self._pilot[1]) if t > now), default=math.inf)


def _until(expires: float, now: float) -> float:
    if not math.isfinite(expires):
        raise ValueError(f"expires: expected finite seconds on the dive's clock, got {expires}")
    return min(expires, now + LONGEST)
