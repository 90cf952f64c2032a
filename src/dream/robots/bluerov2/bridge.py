"""Who has the vehicle: the goal it is held to, and whether it may move at all."""

from __future__ import annotations

import enum
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from dream.control.health import SLOW, Condition, Watch
from dream.geometry import SE2
from dream.robots.bluerov2.limits import SAG, LastResort, Limits
from dream.robots.bluerov2.navigation import GAUGE_DRIFTS, Fix, Navigator
from dream.robots.bluerov2.threads import REAL_TIME, Thread, Threads
from dream.robots.bluerov2.watches import Parted, Pressing

logger = logging.getLogger(__name__)

BEATS = 25.0
"""A second."""
LEASE = 0.4
"""Seconds after which a command that was not renewed is neutral: half a second, less what sending takes."""

ON_THE_SPOT = 0.05
"""Metres from a goal, over ground, at which it is above or below it."""
TOLERATED = 0.1
"""Metres that the way may lead below the greatest depth: what a floor undulates by."""
ABOVE, ABOVE_FOR = 0.3, 1.0
"""Metres above the surface that the estimate may be, and seconds: no vehicle flies."""
DEPTHS_PART = 0.3
"""Metres by which two depths may part that were alike."""
UNTOLD = 5.0
"""Seconds for which nothing may be known of battery and leak."""
HEADLESS = 1.0
"""Seconds for which nothing may be known of the heading."""
DEPTHLESS = 1.0
"""Seconds for which the autopilot's own depth may be unknown: it is held against the pressure."""
VAGUEST = 0.1
"""Share of the area's shorter side that the position may be uncertain by."""
LOW = 1.0
"""Seconds that the altitude may."""
UNSOUNDED, UNBELIEVED = 1.0, 5.0
"""Seconds without an altitude that is believed, after which the depth is held; and the same while there is
bottom track, after which nothing is steered."""


class Stance(enum.StrEnum):
    """What the bridge does, whatever the goal."""

    GO = "go"
    SLOW = "slow"
    """On to the goal at a part of the speeds."""
    NEUTRAL = "neutral"
    """No motion is asked for; the autopilot holds depth and heading. If it lasts, the last resort comes."""
    YIELD = "yield"
    """Somebody else has the vehicle: nothing is sent that moves it."""
    OVER = "over"
    """The dive cannot go on, even if its reason goes: neutral, and the last resort at once."""


@dataclass(frozen=True, slots=True)
class Standing:
    """What the bridge does, and why."""

    stance: Stance
    reason: str = ""
    """Empty where all is well."""


FINE = Standing(Stance.GO)


@dataclass(slots=True)
class Aim:
    """What the vehicle is held to: a pose of the map, and an altitude or a height.

    To a height it climbs as far as it has come nearer to the pose, so that the way is the straight one that
    the guard has looked at.
    """

    pose: SE2
    altitude: float | None
    """Metres above the seabed; None where there is a height."""
    z: float | None
    """Metres in the world; None where there is an altitude."""
    start: tuple[float, float, float]
    """Where it was when it was sent, metres in the world."""
    _way: float = 0.0
    """Share of the way that it has come, at most so far: it does not sink again where it is pushed back."""

    def height(self, fix: Fix) -> float:
        """Metres in the world that it is held to just now."""
        if self.z is not None:
            x, y, z = self.start
            length = self.pose.distance(SE2(x, y, 0.0))
            left = self.pose.distance(fix.T_world_base.se2)
            come = 1.0 if min(left, length) <= ON_THE_SPOT else 1.0 - left / length
            self._way = max(self._way, come)
            return z + self._way * (self.z - z)
        assert self.altitude is not None
        sounded = math.isfinite(fix.seabed) and fix.altitude_age <= UNSOUNDED
        return fix.seabed + self.altitude if sounded else float(fix.T_world_base.translation[2])

    def check_depth(self, height: float, deepest: float) -> str:
        """Why it must not go there, in words; empty where it may.

        Args:
            height: Of `height`.
            deepest: Metres below the surface, at most.
        """
        if self.z is not None:
            height, where = self.z, "the goal"
        else:
            where = f"{self.altitude:g} m above the floor"
        if height >= -deepest - TOLERATED:
            return ""
        return f"{where} is {-height:.1f} m deep, {deepest:g} m are allowed"


@dataclass(frozen=True, slots=True)
class Craft:
    """What the vehicle itself reports."""

    armed: bool
    link_age: float
    """Seconds since its last heartbeat."""
    voltage: float
    """NaN where it does not say."""
    depth: float
    """Metres, by the pressure; NaN likewise."""
    own_depth: float = math.nan
    """Metres, by its autopilot's own reckoning, whose zero may be another."""
    own_depth_from: str = ""
    """What told that: each may have a zero of its own."""
    own_depth_age: float = 0.0
    """Seconds since it last told that."""
    imu_heard: float = 0.0
    """Seconds since an inertial sample came in, whenever it was taken."""
    slipped: str = ""
    """That its clock was set of late, in words."""
    status_age: float = 0.0
    """Seconds since it last told of battery and leak."""
    leak: bool = False
    taken: str = ""
    """Who else has it, and how that is known; empty where nobody."""
    surfacing: str = ""
    """Why it comes up by itself; empty where it does not."""
    lost: str = ""
    """Why it will not be moved any more: disarmed by somebody, or begun anew; empty where it may."""


class Drive(Protocol):
    """One way to move the vehicle: goal and estimate in, commands out on the wire."""

    def begin(self, fix: Fix) -> None:
        """Stand here; what was learnt of the water is kept."""

    def steer(self, fix: Fix, goal: SE2, z: float, dt: float, pace: float, expires: float) -> None:
        """Send the command of this beat, which turns neutral by itself at that time."""

    def neutral(self) -> None:
        """Send, now, that nothing shall move it."""

    def release(self) -> None:
        """Send nothing any more that could move it: somebody else has it."""

    def resort(self, how: LastResort) -> None:
        """Begin the last resort, or go on with it; returns at once."""

    def craft(self) -> Craft:
        """What the vehicle reports."""

    @property
    def effort(self) -> float:
        """Share of what it may ask of the thrusters that it asks now."""


class HumanPilot(Protocol):
    """A person who may take the vehicle, through DREAM."""

    @property
    def has(self) -> bool:
        """Do they steer now?"""

    @property
    def gone(self) -> bool:
        """Did their sticks stop coming while they steered?"""

    @property
    def ended(self) -> str:
        """Why they ended the dive; empty where they did not."""


class Bridge:
    """Steers to the goal at a fixed rate while everything that has to be well is; else says why not.

    What it does: every beat takes the estimate up to date and judges, in this order: who has the vehicle, is
    it within its limits, do mission and operator live, can the estimate be relied on. Only then it steers. A
    command lives for `LEASE` seconds: when this loop dies, the link itself falls to neutral.
    Assumes: `beat` is called on one thread; all else on any.
    """

    def __init__(
        self,
        navigator: Navigator,
        drive: Drive,
        limits: Limits,
        now: Callable[[], float],
        *,
        watch: Watch | None = None,
        pilot: HumanPilot | None = None,
        rate: float = BEATS,
        said: Callable[[Standing], None] | None = None,
        fixed: Callable[[Fix], None] | None = None,
        failing: Callable[[], str] = lambda: "",
        sight: Callable[[Fix], str] = lambda fix: "",
        aimed: Callable[[SE2, float | None, float | None], None] | None = None,
        threads: Threads = REAL_TIME,
    ) -> None:
        """On a vehicle whose navigator is aligned.

        Args:
            navigator: Says where it is.
            drive: How it is moved.
            limits: Where and how long it may be.
            now: The dive's clock.
            watch: When the estimate is too old or too vague; by the size of the area unless given.
            pilot: Outranks the goal, the limits and the last resort while they have the sticks.
            rate: Beats a second.
            said: Told of every change of what it does.
            fixed: Told of the estimate at every beat.
            failing: Which device says that it will fail soon, in words; empty where none does. The dive is
                over while all that surfacing needs still works.
            sight: Why the mission would not see what is before the vehicle, in words; empty where it would.
                It goes slowly then, and whoever next looks for a picture ends the dive.
            aimed: Told of every new goal with its altitude and its height, of which one is None.
            threads: What it waits by.
        """
        self._navigator, self._drive, self._limits = navigator, drive, limits
        self._now, self._threads = now, threads
        # What may be vague in the sea is lost in a tank.
        self._watch = watch or Watch(position_sigma=min(Watch().position_sigma, VAGUEST * limits.shorter))
        self._pilot = pilot
        self._period = 1.0 / rate
        self._said, self._fixed, self._aimed, self._failing = said, fixed, aimed, failing
        self._sight = sight
        self._lock = threads.lock()
        self._goal: Aim | None = None
        self._asked = math.nan
        self._mission_until = self._operator_until = math.inf
        self._ended: str = ""
        self._over = ""
        self._resorted = self._lost = False
        self._fed = self._under = now()
        """When the battery last had its voltage, or did not say; when the estimate was last in the water."""
        self._depths, self._own_depth_from = Parted(DEPTHS_PART), ""
        self._pressing = Pressing()
        self._low_since = math.inf
        """When it came too near the seabed; inf where it is not."""
        self._standing = FINE
        self._neutral_since = math.nan
        self._began = self._last_beat = now()
        self._wake = threads.event()
        self._stopping = threads.event()
        self._thread: Thread | None = None
        self.fix = navigator.update()
        self.lags: list[float] = []
        """Seconds from each new goal to the command that begins to follow it."""
        self.late_beats = 0
        """Beats that came later than twice their time."""
        self._drive.begin(self.fix)

    def start(self) -> None:
        """Begin to beat, on a thread of its own."""
        self._thread = self._threads.start(self._run, "bridge")

    def close(self) -> None:
        """Neutral, and no beat any more."""
        self._stopping.set()
        self._wake.set()
        if self._thread is not None:
            self._thread.join(timeout=2.0)
        if self._standing.stance is not Stance.YIELD and not self._resorted:
            self._drive.neutral()

    def go(self, goal: SE2, altitude: float | None, z: float | None = None) -> None:
        """Hold the vehicle to this pose of the map, from now on.

        Args:
            goal: Of the map.
            altitude: Metres above the seabed; None where a height is given.
            z: Height in the world, metres, to which the way is straight; None where an altitude is given.

        Raises:
            ValueError: Both are given, or none, or one that is not finite.
        """
        given = [value for value in (altitude, z) if value is not None]
        if len(given) != 1 or not math.isfinite(given[0]):
            raise ValueError(f"goal: expected either an altitude or a height, got {altitude} and {z}")
        x, y, up = self.fix.T_world_base.translation.tolist()
        with self._lock:
            self._goal, self._asked = Aim(goal, altitude, z, (x, y, up)), self._now()
        self._wake.set()
        if self._aimed is not None:
            self._aimed(goal, altitude, z)

    def renew(self, seconds: float = LEASE) -> None:
        """The mission lives, and will say so again within that time."""
        with self._lock:
            self._mission_until = self._now() + seconds

    def renew_operator(self, seconds: float) -> None:
        """The operator is there, and will show it again within that time."""
        with self._lock:
            self._operator_until = self._now() + seconds

    def end(self, why: str) -> None:
        """The dive is over: neutral, then the last resort."""
        with self._lock:
            self._ended = self._ended or why
        self._wake.set()

    @property
    def standing(self) -> Standing:
        """What it does now, and why."""
        return self._standing

    @property
    def over(self) -> str:
        """Why the dive cannot go on, whoever has the vehicle; empty while it can."""
        return self._over

    @property
    def seconds_left(self) -> float:
        """Until the minutes of the dive are over."""
        return 60.0 * self._limits.minutes - (self._now() - self._began)

    @property
    def goal(self) -> SE2 | None:
        """Where it is held to."""
        goal = self._goal
        return None if goal is None else goal.pose

    def beat(self) -> None:
        """Take in, judge, and steer or not."""
        now = self._now()
        dt = min(max(now - self._last_beat, 1e-3), 0.5)
        self.late_beats += dt > 2.0 * self._period
        self._last_beat = now
        self.fix = fix = self._navigator.update()
        if self._fixed is not None:
            self._fixed(fix)
        standing = self._judge(fix, now)
        self._change(standing, now)
        if standing.stance in (Stance.GO, Stance.SLOW):
            self._steer(fix, dt, SLOW if standing.stance is Stance.SLOW else 1.0)
        elif standing.stance is Stance.YIELD:
            self._drive.release()
        else:
            self._stay(standing, now)

    def _stay(self, standing: Standing, now: float) -> None:
        """Neutral, and the last resort where that lasts."""
        try:
            if not self._resorted:
                self._drive.neutral()
        finally:
            # Comes also where it could not be told to stay, and at the next beat where it could not begin.
            late = now - self._neutral_since >= self._limits.patience
            if (late or standing.stance is Stance.OVER) and not self._lost:
                self._over = self._over or standing.reason
                self._drive.resort(self._limits.last_resort)
                self._resorted = True

    def _fail(self, error: Exception) -> None:
        """End the dive by a beat that failed, and will perhaps fail every time."""
        now, why = self._now(), f"bridge: {type(error).__name__}: {error}"
        # Not by `end`, which would wake this very loop, to fail again at once.
        self._over = self._over or why
        if self._standing.stance is Stance.YIELD:
            self._drive.release()
            return
        standing = Standing(Stance.OVER, self._over)
        self._change(standing, now)
        self._stay(standing, now)

    def _run(self) -> None:
        due = self._now()
        while not self._stopping.is_set():
            due += self._period
            self._wake.wait(max(due - self._now(), 0.0))
            if self._wake.is_set():
                # A new goal is not kept waiting for the next beat.
                self._wake.clear()
                due = self._now()
            if self._stopping.is_set():
                return
            due = max(due, self._now() - self._period)
            try:
                self.beat()
            except Exception as error:  # the loop must outlive whatever it meets, and say so.
                if not self._over:
                    logger.exception("bridge: a beat failed")
                try:
                    self._fail(error)
                except Exception:  # the next beat tries again.
                    logger.debug("bridge: the vehicle could not be stopped", exc_info=True)

    def _steer(self, fix: Fix, dt: float, pace: float) -> None:
        with self._lock:
            goal, asked = self._goal, self._asked
            self._asked = math.nan
            alive = min(self._mission_until, self._operator_until)
        if goal is None:
            self._drive.neutral()
            self._pressing.forget()
            return
        z = goal.height(fix)
        if too_deep := goal.check_depth(z, self._limits.depth):
            self.end(too_deep)
        if wrong := self._pressing(self._now(), fix, goal.pose, z, self._drive.effort):
            self.end(wrong)
        self._drive.steer(fix, goal.pose, z, dt, pace, min(self._now() + LEASE, alive))
        if not math.isnan(asked):
            self.lags.append(self._now() - asked)

    def _change(self, standing: Standing, now: float) -> None:
        moves = (Stance.GO, Stance.SLOW)
        if standing.stance not in moves:
            self._pressing.forget()
        if standing.stance in (Stance.NEUTRAL, Stance.OVER):
            if math.isnan(self._neutral_since):
                self._neutral_since = now
        else:
            self._neutral_since = math.nan
            if standing.stance in moves and self._standing.stance not in moves:
                self._drive.begin(self.fix)
        if standing != self._standing:
            self._standing = standing
            if self._said is not None:
                self._said(standing)

    def _judge(self, fix: Fix, now: float) -> Standing:
        craft, pilot = self._drive.craft(), self._pilot
        dim = self._sight(fix)
        steered = pilot is not None and pilot.has and not (craft.lost or craft.taken)
        with self._lock:
            ended, mission, operator = self._ended, self._mission_until, self._operator_until
        if pilot is not None:
            ended = ended or pilot.ended
        self._over = self._over or ended or craft.surfacing
        self._over = self._over or self._broken_limit(fix, craft, now) or self._failing()
        if craft.lost:
            # Nothing is left to resort to: who disarmed it may arm it again, for something else.
            self._over, self._lost = self._over or craft.lost, True
        elif craft.taken and not self._resorted:
            # Whatever is wrong, it is theirs to deal with; the mission ends, and nothing is sent.
            return Standing(Stance.YIELD, craft.taken)
        if steered:
            # Whatever is wrong: a person may bring the vehicle home.
            return Standing(Stance.YIELD, "the pilot has the sticks")
        if self._over:
            return Standing(Stance.OVER, self._over)
        if craft.link_age > 3.0:
            return Standing(Stance.NEUTRAL, f"no heartbeat from the vehicle for {craft.link_age:.0f} s")
        for until, who in ((mission, "the mission"), (operator, "the operator")):
            if now > until:
                return Standing(Stance.NEUTRAL, f"no sign of life from {who}")
        if pilot is not None and pilot.gone:
            return Standing(Stance.YIELD, "the pilot is gone: waiting for neutral sticks, or the operator")
        if fix.heading_age > HEADLESS:
            return Standing(Stance.NEUTRAL, "no heading")
        if craft.own_depth_age > DEPTHLESS:
            return Standing(Stance.NEUTRAL, "the autopilot does not tell its depth")
        if craft.status_age > UNTOLD:
            return Standing(Stance.NEUTRAL, "the vehicle tells nothing of battery and leak")
        condition = self._watch.condition(
            imu_age=fix.imu_age,
            depth_age=fix.depth_age,
            dvl_age=fix.dvl_age,
            velocity_sigma=fix.velocity_sigma,
            position_sigma=fix.position_sigma,
        )
        if fix.altitude_problem or not fix.altitude_age - fix.dvl_age <= UNBELIEVED:
            return Standing(Stance.NEUTRAL, fix.altitude_problem or "no altitude of the DVL can be believed")
        if condition is Condition.BLIND:
            return Standing(Stance.SLOW, "no bottom track for a while")
        if condition is Condition.STALE and fix.imu_age > self._watch.stale > craft.imu_heard:
            late = f"inertial samples come {fix.imu_age:.1f} s late: a slow link, or a clock that was set"
            return Standing(Stance.NEUTRAL, craft.slipped or late)
        if condition is not Condition.FINE:
            return Standing(Stance.NEUTRAL, _TROUBLE[condition])
        return Standing(Stance.SLOW, dim) if dim else FINE

    def _broken_limit(self, fix: Fix, craft: Craft, now: float) -> str:
        """Which limit does not hold, in words; empty where all do."""
        limits, area = self._limits, self._limits.area
        x, y, _ = fix.T_world_base.translation
        beyond = max(area.x_min - x, x - area.x_max, area.y_min - y, y - area.y_max)
        if beyond > limits.margin:
            return f"{beyond:.1f} m outside the area"
        if craft.depth > limits.depth + 0.5:
            return f"{craft.depth:.1f} m deep, {limits.depth:g} m are allowed"
        if craft.own_depth_from != self._own_depth_from:
            self._own_depth_from, self._depths = craft.own_depth_from, Parted(DEPTHS_PART)
        if self._depths(now, craft.own_depth, craft.depth):
            return (
                f"the depths part: {craft.depth:.2f} m by the pressure, "
                f"{craft.own_depth:.2f} m by the autopilot"
            )
        if abs(fix.drifts) > GAUGE_DRIFTS:
            return (
                f"gauge and DVL part: of late it climbed {fix.drifts:.1f} m more by the one than by the other"
            )
        if float(fix.T_world_base.translation[2]) < ABOVE:
            self._under = now
        elif now - self._under > ABOVE_FOR:
            return f"the estimate is {fix.T_world_base.translation[2]:.1f} m above the surface"
        if self.seconds_left < 0.0:
            return f"the {limits.minutes:g} minutes of the dive are over"
        if fix.altitude >= limits.altitude:
            self._low_since = math.inf
        elif fix.altitude < limits.altitude:
            self._low_since = min(self._low_since, now)
            if now - self._low_since > LOW:
                return f"{fix.altitude:.1f} m above the floor, {limits.altitude:g} m are needed"
        # Thrusters make the voltage sag for a moment.
        if not craft.voltage < limits.voltage:
            self._fed = now
        elif now - self._fed > SAG:
            return f"battery at {craft.voltage:.1f} V, {limits.voltage:g} V are needed"
        return "water in the hull" if craft.leak else ""


_TROUBLE = {
    Condition.LOST: "no bottom track for long",
    Condition.DIVERGED: "the estimate does not know any more where it is",
    Condition.STALE: "no inertial samples, or no depth",
}
