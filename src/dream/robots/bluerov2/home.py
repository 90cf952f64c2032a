"""The way home: up to the surface and disarmed, by whatever means the vehicle still obeys."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable

from dream.robots.bluerov2.limits import SAG, LastResort, Limits
from dream.robots.bluerov2.mavlink import Link
from dream.robots.bluerov2.sticks import NEUTRAL, Sticks
from dream.robots.bluerov2.threads import REAL_TIME, Thread, Threads

logger = logging.getLogger(__name__)

EVERY = 0.1
"""Seconds between two looks at how it goes."""
SHALLOW = 0.4
"""Metres of depth at which a vehicle that surfaces is there: its gauge sits below its top."""
RISES = 0.1
"""Metres by which it has to rise ..."""
WITHIN = 4.0
"""... within so many seconds, or the next means is tried."""
LEAVING = 120.0
"""Seconds that the way may take: a vehicle that has not come up by then is disarmed, and floats."""
DEAF, SILENT = 15.0, 8.0
"""Seconds for which disarming may fail, and for which it then is not spoken to: its failsafe disarms it."""
SURE = 5.0
"""Seconds within which Ctrl-C has to come a second time."""
UNHEARD = 10.0
"""Seconds without a heartbeat after which it is not spoken to any more: its own failsafe disarms it then."""
UP = Sticks(z=1000)

MEANS = ("SURFACE", "sticks in ALT_HOLD", "sticks in MANUAL", "disarming")
"""In this order, round and round."""


class WayHome:
    """Brings the vehicle where its operator wants it in the end, and goes on until it is there.

    What it does: a thread of its own, so that neither the mission nor the terminal can hold it up. To surface
    it asks for the mode SURFACE. Where that is refused, not answered, or does not lift the vehicle, it sends
    sticks upwards, in ALT_HOLD, then in MANUAL, then it disarms; and begins again for as long as
    the vehicle is armed. Near the surface it is disarmed; one that does not listen to that is not spoken to
    for a while, so that its own failsafe disarms it. To hold, it keeps ALT_HOLD, until there is water in
    the hull or the battery is low: then it surfaces.

    Assumes: a vehicle that floats up by itself, as a BlueROV2 is trimmed.
    """

    def __init__(
        self,
        link: Link,
        limits: Limits,
        now: Callable[[], float],
        *,
        person: Callable[[], bool] = lambda: False,
        threads: Threads = REAL_TIME,
    ) -> None:
        """Nothing is done before `begin`.

        Args:
            link: To the vehicle.
            limits: Which last resort, and which voltage is low.
            now: The dive's clock.
            person: Has somebody the sticks? Then they bring it home.
            threads: What it waits by.
        """
        self._link, self._limits, self._now = link, limits, now
        self._person, self._threads = person, threads
        self._lock = threads.lock()
        self._thread: Thread | None = None
        self._closing = threads.event()
        self.how: LastResort | None = None
        """What it is about; None before it begins."""
        self.troubles: list[str] = []
        """What was refused, or led nowhere, so far."""
        said = link.telemetry
        lay = said.own_altitude + said.depth
        self._own_zero = said.own_altitude_from, lay if math.isfinite(lay) else 0.0
        """What the autopilot tells its height by, and metres there where the depth is 0."""
        self._means = 0
        self._depth = self._risen_at = math.nan
        self._fed = now()
        self._until = math.inf
        self._disarming_since = math.inf
        self._silent_until = -math.inf

    def begin(self, how: LastResort) -> None:
        """Set out, or go on; a vehicle that holds may be told to surface, and not the other way round."""
        with self._lock:
            if self.how is None or (self.how is LastResort.HOLD and how is not LastResort.HOLD):
                self.how = how
                self._until = self._now() + LEAVING if how is LastResort.SURFACE else math.inf
            if self._thread is None:
                self._fed = self._now()
                self._thread = self._threads.start(self._run, "way home")

    @property
    def there(self) -> bool:
        """Is nothing left to do: the vehicle is not armed by us, or is somebody else's?"""
        link = self._link
        return not link.engaged or bool(link.yielding)

    @property
    def unheard(self) -> bool:
        """Was the vehicle silent for so long that it is left to its own failsafe?"""
        return self._link.age > UNHEARD

    def finish(self, tell: Callable[[str], None]) -> None:
        """Set out where it has not, and return once the vehicle is there.

        Ctrl-C leaves one that holds as it is; one that comes up only by a second Ctrl-C within `SURE`.

        Args:
            tell: Takes a line for the operator. May wait: nothing hangs on it.
        """
        if self.there:
            return
        self.begin(self._limits.last_resort)
        tell(_DOING[self._limits.last_resort])
        silent_since, pressed = math.inf, -math.inf
        while not self.there and self._now() - silent_since < LEAVING:
            try:
                silent_since = min(silent_since, self._now()) if self.unheard else math.inf
                self._threads.sleep(EVERY)
            except KeyboardInterrupt:
                if self.how is LastResort.HOLD or self._now() - pressed < SURE:
                    tell("the vehicle is left as it is: interrupted")
                    break
                pressed = self._now()
                tell(f"it is on its way up: Ctrl-C again within {SURE:g} s leaves it as it is")
        else:
            if not self.there:
                tell(f"no heartbeat for {UNHEARD + LEAVING:g} s: the vehicle is left to its own failsafe")
        self.close()

    def close(self) -> None:
        """Leave the vehicle as it is."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join(2.0)

    def _run(self) -> None:
        while not (self._closing.is_set() or self.there):
            if not (self.unheard or self._now() < self._silent_until):
                try:
                    self._look()
                except Exception as error:  # noqa: BLE001 - it goes on, whatever it meets.
                    self._fail(str(error))
            self._closing.wait(EVERY)

    def _look(self) -> None:
        self._link.operator_alive()
        how, now = self._judged(), self._now()
        if not self._person():
            self._go(how, now)
        elif how is LastResort.SURFACE:
            # What they do says nothing of its means, and their time is not counted.
            self._risen_at, self._until = math.nan, now + LEAVING

    def _go(self, how: LastResort, now: float) -> None:
        if how is LastResort.DISARM or (how is LastResort.SURFACE and (self._up() or now > self._until)):
            if now > self._until:
                # Where that is refused as well, it begins again.
                self._until = now + LEAVING
            self._disarm()
        elif how is LastResort.HOLD:
            self._mode("ALT_HOLD")
        else:
            self._watch(now)
            self._lift(MEANS[self._means])

    def _judged(self) -> LastResort:
        """A vehicle that holds comes up for water in it, for a low battery, and where it does by itself."""
        said, now = self._link.telemetry, self._now()
        if not said.voltage < self._limits.voltage:
            self._fed = now
        low = now - self._fed > SAG
        assert self.how is not None
        why = "water in the hull" if said.leak else f"battery at {said.voltage:.1f} V" if low else ""
        why = why or self._link.surfacing
        if self.how is LastResort.HOLD and why:
            self.begin(LastResort.SURFACE)
            logger.warning("%s: it does not hold any longer, but comes to the surface", why)
        return self.how

    @property
    def depth(self) -> float:
        """Metres by the autopilot's own reckoning or by the pressure, whichever is more; NaN without both.

        One of them may be stuck: a vehicle that is disarmed has to be up by both. What the autopilot tells
        has a zero of its own, which is taken where it lay at the launch.
        """
        said = self._link.telemetry
        own = math.nan
        if said.own_altitude_age < WITHIN and said.own_altitude_from == self._own_zero[0]:
            own = self._own_zero[1] - said.own_altitude
        by_pressure = said.depth if said.pressure_age < WITHIN else math.nan
        return max((depth for depth in (own, by_pressure) if math.isfinite(depth)), default=math.nan)

    def _up(self) -> bool:
        return self.depth < SHALLOW

    def _watch(self, now: float) -> None:
        """The next means where this one does not lift it."""
        depth = self.depth
        if not self._link.connected:
            self._risen_at = math.nan
        elif math.isnan(self._risen_at) or depth < self._depth - RISES:
            self._depth, self._risen_at = depth, now
        elif now - self._risen_at > WITHIN:
            self._fail(f"{MEANS[self._means]}: expected it to rise, got {depth:.1f} m for {WITHIN:g} s")

    def _fail(self, why: str) -> None:
        # What fails while nothing is heard of the vehicle says nothing of the means.
        if self.how is LastResort.SURFACE and self._link.connected:
            self._means = (self._means + 1) % len(MEANS)
            self._depth, self._risen_at = self.depth, self._now()
        if why not in self.troubles[-len(MEANS) :]:
            self.troubles.append(why)
            logger.warning("on the way home: %s", why)

    def _lift(self, means: str) -> None:
        link = self._link
        if means == "SURFACE":
            self._mode("SURFACE")
        elif means == "disarming":
            self._disarm()
        else:
            self._mode(means.rpartition(" ")[2])
            link.command(UP, self._now() + 0.4)

    def _disarm(self) -> None:
        now = self._now()
        self._disarming_since = min(self._disarming_since, now)
        if now - self._disarming_since > DEAF:
            self._disarming_since, self._silent_until = math.inf, now + SILENT
            raise RuntimeError("disarming: expected a disarmed vehicle, got none. It is left to its failsafe")
        self._link.disarm()

    def _mode(self, mode: str) -> None:
        if self._link.telemetry.mode != mode:
            self._link.command(NEUTRAL, self._now() + 0.4)
            self._link.set_mode(mode)


_DOING = {
    LastResort.SURFACE: "it comes to the surface",
    LastResort.HOLD: "it holds its depth: take the sticks, or end with Ctrl-C",
    LastResort.DISARM: "it is disarmed",
}
