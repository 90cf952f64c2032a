"""A device's own clock → the dive's clock."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

PATIENCE = 3.0
"""Seconds for which all stamps must come late before the device is believed to have changed its clock."""
SLIP = 0.05
"""Seconds beyond what round trips leave open, from which on a clock was set."""
REMEMBERED = 128
"""Stamps that the jitter is told of."""


@dataclass(slots=True)
class DeviceClock:
    """Tells when on the dive's clock a stamp of a device was taken.

    What it does: what a stamp lies behind its arrival is the offset between the clocks plus the way. The way
    is never shorter than nothing, so the least of these over a window bounds the offset from above; a round
    trip bounds it from below, too, and then the middle of the bounds is taken. A bound from a while ago is
    let out by as much as the clock may have drifted since. So, while the clock drifts no faster than that, a
    stamp is never mapped to earlier than it was taken, unless a round trip says so, and by no more than half
    of that trip; and never to later than it arrived.
    Reference: Cristian, *Probabilistic clock synchronization* (1989), for round trips; the least delay over a
    window is the filter of NTP (RFC 5905, section 10).
    Assumes: one thread.
    Fails when: no stamp of a whole window came straight: then all of them are mapped late by the least delay.
    """

    window: float = 30.0
    """Seconds that a bound is kept."""
    drift: float = 100e-6
    """Seconds per second that the device's clock may run fast or slow. Cheap crystals keep 50e-6."""
    jump: float = 0.5
    """Seconds. A greater step is a reboot or a clock that was set: all bounds are forgotten."""
    jumps: int = field(default=0, init=False)
    """How many there were."""
    slipped: float = field(default=0.0, init=False)
    """Seconds that the device's clock was set forward at the last jump that round trips prove."""
    newest: float = field(default=-math.inf, init=False)
    """The device's greatest stamp since the last of them, in its own seconds."""
    _above: deque[tuple[float, float]] = field(default_factory=deque, init=False)
    _below: deque[tuple[float, float]] = field(default_factory=deque, init=False)
    _late: deque[float] = field(default_factory=lambda: deque(maxlen=REMEMBERED), init=False)
    _straight: float = field(default=-math.inf, init=False)
    _trip: tuple[float, float, float] | None = field(default=None, init=False)
    """Of the last round trip: when, and least and greatest offset that it leaves open."""

    def __post_init__(self) -> None:
        for name in ("window", "drift", "jump"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"clock.{name}: expected a number above 0, got {getattr(self, name)}")

    def time(self, stamp: float, arrival: float) -> float:
        """When the stamp was taken.

        Args:
            stamp: Seconds on the device's clock, whatever it counts from.
            arrival: Seconds on the dive's clock when it came in.

        Returns:
            Seconds on the dive's clock, `arrival` at the latest.

        Raises:
            ValueError: One of them is not finite.
        """
        if not (math.isfinite(stamp) and math.isfinite(arrival)):
            raise ValueError(f"stamp: expected finite seconds, got {stamp} that came at {arrival}")
        behind = arrival - stamp
        self._forget(arrival)
        if not self._above:
            self._straight = arrival
        elif self._jumped(stamp, behind, arrival):
            self.restart()
            self.jumps += 1
            self._straight = arrival
        self.newest = max(self.newest, stamp)
        _push(self._above, arrival, behind - self.drift * arrival)
        offset = self._offset(arrival)
        self._late.append(behind - offset)
        return min(stamp + offset, arrival)

    def round_trip(self, sent: float, stamp: float, received: float) -> None:
        """Learn from a question and its answer: the device read `stamp` between `sent` and `received`.

        Raises:
            ValueError: Something is not finite, or the answer came before the question.
        """
        if not (math.isfinite(sent) and math.isfinite(stamp) and sent <= received < math.inf):
            raise ValueError(f"round trip: expected finite and rising times, got {sent}, {stamp}, {received}")
        self._forget(received)
        low, high = sent - stamp, received - stamp
        if self._trip is not None:
            when, lowest, highest = self._trip
            may = self.drift * (received - when) + SLIP
            if low > highest + may or high < lowest - may:
                self.restart()
                self.jumps += 1
                self.slipped = 0.5 * (lowest + highest - low - high)
        self._trip = received, low, high
        if self._above:
            # An answer that was held up on its way leaves more open, and is no sign that the clock was set.
            above = self._above[0][1] + self.drift * received
            if high < above - self.jump or low > above + self.jump:
                self.restart()
                self.jumps += 1
            elif high <= above + self.jump:
                self._straight = received
        _push(self._above, received, received - stamp - self.drift * received)
        _push(self._below, sent, -(sent - stamp) - self.drift * sent)

    @property
    def jitter(self) -> float:
        """Seconds that nine of ten of the last stamps were late by at most; NaN before the first."""
        return float(np.quantile(self._late, 0.9)) if self._late else math.nan

    def restart(self) -> None:
        """Forget the offset."""
        self._above.clear()
        self._below.clear()
        self._late.clear()
        self.newest = -math.inf

    def _offset(self, now: float) -> float:
        above = self._above[0][1] + self.drift * now
        if not self._below:
            return above
        below = -(self._below[0][1] + self.drift * now)
        return above if below > above else 0.5 * (above + below)

    def _jumped(self, stamp: float, behind: float, arrival: float) -> bool:
        """Whether the clock was set. A late stamp alone is no sign: it may have been held up on the way."""
        late = behind - (self._above[0][1] + self.drift * arrival)
        if abs(late) <= self.jump:
            self._straight = arrival
            return False
        return late < 0.0 or stamp < self.newest - self.jump or arrival - self._straight > PATIENCE

    def _forget(self, now: float) -> None:
        for bounds in (self._above, self._below):
            while bounds and bounds[0][0] < now - self.window:
                bounds.popleft()


def _push(bounds: deque[tuple[float, float]], time: float, bound: float) -> None:
    """Keep what may yet be the least of a window: of bounds that are no better than a newer one, none."""
    while bounds and bounds[-1][1] >= bound:
        bounds.pop()
    bounds.append((time, bound))
