"""Altitudes of the DVL → how high the seabed lies, as far as they can be believed."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean, median

from dream.geometry import SE3
from dream.measurements import Dvl

SMOOTHED = 2.0
"""Seconds over which the height of the seabed is smoothed: what lies on it hardly lifts the vehicle."""
STEEPEST = 1.8
"""Metres that a seabed seems to rise in a metre: 45° of relief are real, and down a wall two of the four
slanted beams slide by 3.4 m in a metre."""
DRIFT = 0.02
"""m/s by which the vehicle's own height may be off, more and more, between two echoes."""
NEAR, NEAR_SHARE = 0.1, 0.15
"""Metres, and share of the altitude, by which echoes of the same ground differ: noise, stones, and a beam of
the four that does not come back, which on a slope of 45° is worth a fifth of the altitude."""
FAR, FAR_SHARE = 0.1, 1.0
"""Metres, and share of the altitude, beyond which they do so by no ground that the vehicle has not moved
over: an altitude is the mean of four beams, and where two of them pass an edge at once, the mean is at most
doubled or halved."""
MOVED = 0.05
"""Metres, horizontally, without which the ground does not change that far."""
APART = 0.5
"""Share of the altitude within which nothing comes and goes: the beams are farther from each other."""

GAP = 1.0
"""Seconds without an echo after which what was believed before says nothing."""
NEARER, FARTHER = (1.0, 0.6), (2.0, 0.8)
"""Seconds of which so great a share of the echoes has to agree on a new height of the seabed: on one that is
nearer to the vehicle, and on one that is farther away. To go up is safer than to go down."""
FEWEST, CROWD = 7, 4
"""Echoes at least that it is judged by, and that have to agree."""
LASTING = 0.5
"""Seconds that it has to last."""
KEPT = 10.0
"""Seconds of echoes that are looked back at."""

STRETCHES = (0.2, 0.4, 0.8, 1.6)
"""Metres of change of height over which altitude and height are compared."""
COMPARED = 12
"""Echoes that it takes."""
LACKING, LACKING_SHARE = 0.05, 0.02
"""Metres, and share of the altitude, by which both may differ: noise, beams that do not come back, and
heights and altitudes of different times."""
ALIKE = 0.25
"""Share of the change of height by which the altitude may change more or less, and is right."""
STUCK, SCALED = 0.15, 1.35
"""How many times as much as the height an altitude at most changes that is stuck, and at least one that is
scaled. Between both there is ground that does so: of four beams, those on a wall beside the vehicle do not
change at all, and on a slope of 60° those down it twice as much."""
UNEVEN = 3.0
"""How many times as much, in one part of a stretch as in another, it may be off."""
EQUAL = 1e-3
"""Metres: no altitude that is measured stays within it while the vehicle rises or sinks."""
RISEN = 0.15
"""Metres that it rises or sinks meanwhile."""
SAME, SWAYED, TRAVELLED = 20, 0.02, 0.3
"""Echoes that are equal to the last bit, and metres up or down, and along, over which none are."""
WAVERING = ((3.0, 3), (10.0, 2))
"""Seconds, and how often in them echoes may go far off and come back."""
FALSE_SHARE, FALSE_OF = 0.2, 20
"""Share of the echoes in that time, and of how many at least, that may be far off; fewer are left out, and
that is all."""


@dataclass(frozen=True, slots=True)
class _Echo:
    """An altitude, and where it was measured."""

    time: float
    altitude: float
    x: float
    """Metres in the world, of the DVL."""
    y: float
    z: float
    east: float
    """Metres in the world, where the echo came from."""
    north: float
    floor: float
    """Height of it."""
    rate: float
    """m/s at which the DVL rises, by its own velocity."""
    climb: float
    """Metres that it rose since the first echo, likewise."""


class Seabed:
    """The height of the seabed below the vehicle, and whether the DVL's altitude can be true.

    What it does: an echo is believed that agrees with those before it, as far as the ground can have changed
    over the distance that the vehicle moved. A new height, as of a step, is taken once most echoes of a while
    agree on it. What was believed is held against the height of the vehicle: where it rises or sinks over one
    place, the altitude has to change as much. `problem` says what cannot be: an altitude that is stuck, that
    changes by another measure than the height, that jumps over one place, or that jumps to and fro; or a
    height that changes while the DVL does not move. While there is one, nothing is believed.
    Assumes: heights from a pressure gauge; a vehicle that is nearly level.
    Fails when: the altitude is wrong by a factor while the vehicle keeps its height, or moves along as much
    as it rises or sinks: that may be ground. Where it is too small by a factor, which keeps the vehicle
    higher than it should be: beams on a wall do that.
    """

    def __init__(self) -> None:
        """Nothing heard yet."""
        self._heard: deque[_Echo] = deque()
        """All echoes of late."""
        self._believed: deque[_Echo] = deque()
        """Those that are believed, since the seabed was last begun anew."""
        self._height = self._altitude = math.nan
        self._time = self._smoothed = -math.inf
        self._since = -math.inf
        """From when on altitude and height are compared."""
        self._jump: tuple[bool, _Echo] | None = None
        """The last jump of the floor: whether up, and the echo after it."""
        self._run = self._run_before = 0
        """How many echoes there were since that jump, and before it, since the one before."""
        self._returns: deque[tuple[float, int]] = deque()
        """When it jumped back, and after how many echoes."""
        self._between = (math.nan, math.nan)
        """Between which altitudes."""
        self._leapt = (-math.inf, 1.0)
        """When another height of the seabed was taken last, and how many times as much the altitude was."""
        self._off = self._jumped = self._wavering = ""

    @property
    def problem(self) -> str:
        """Why the altitude is not believed, in words that stay the same while it lasts; empty where it is."""
        return self._off or self._jumped or self._wavering

    @property
    def height(self) -> float:
        """Metres in the world, smoothed; NaN where it is not known."""
        return math.nan if self.problem else self._height

    @property
    def altitude(self) -> float:
        """Metres of the DVL above it by its last report; NaN where that had none, or it is not believed."""
        return self._altitude

    def age(self, now: float) -> float:
        """Seconds since the last altitude that is believed; inf where none was."""
        return now - self._time

    def take(self, dvl: Dvl, T_world_dvl: SE3) -> None:
        """Hear what the DVL says, that was there at the time of which it says it."""
        self._altitude = math.nan
        if not (dvl.valid and math.isfinite(dvl.altitude)):
            return
        if self._heard and dvl.time <= self._heard[-1].time:
            return
        echo = self._echo(dvl, T_world_dvl)
        if self._heard:
            self._count_jumps(self._heard[-1], echo)
        self._heard.append(echo)
        for echoes, kept in ((self._heard, FEWEST), (self._believed, CROWD)):
            while len(echoes) > kept and echoes[0].time < echo.time - KEPT:
                echoes.popleft()
        if self._agreed(echo):
            self._believe(echo)
        elif crowd := self._crowd(echo):
            self._begin_anew(crowd)
        self._look_for_false_echoes(echo)
        if not self.problem and self._believed and self._believed[-1] is echo:
            self._altitude, self._time = echo.altitude, echo.time

    def _echo(self, dvl: Dvl, T_world_dvl: SE3) -> _Echo:
        """With what is known since the echo before."""
        x, y, z = (float(value) for value in T_world_dvl.translation)
        east, north, down = (float(-dvl.altitude * value) for value in T_world_dvl.rotation[:, 2])
        floor, climb, rate = z + down, 0.0, float(T_world_dvl.rotation[2] @ dvl.velocity)
        if self._heard:
            last = self._heard[-1]
            risen = 0.5 * (rate + last.rate) * (dvl.time - last.time)
            climb = last.climb + (risen if math.isfinite(risen) else 0.0)
        return _Echo(dvl.time, dvl.altitude, x, y, z, x + east, y + north, floor, rate, climb)

    def _count_jumps(self, last: _Echo, echo: _Echo) -> None:
        """See whether the floor jumped between two echoes, and whether back over one place."""
        self._run += 1
        if not _far(last, echo):
            return
        up, run = echo.floor > last.floor, self._run
        nearest = min(last.altitude, echo.altitude)
        was_up, there = (up, echo) if self._jump is None else self._jump
        # Of two heights that come and go, that is false which is there for the shorter time.
        if up is not was_up and run <= self._run_before and _moved(there, echo) < APART * nearest:
            self._returns.append((echo.time, run))
            self._between = (nearest, max(last.altitude, echo.altitude))
        self._jump, self._run, self._run_before = (up, echo), 0, run

    def _agreed(self, echo: _Echo) -> bool:
        """Does it agree with the last one that is believed, which came just now?"""
        if not self._believed or self._believed[-1].time < echo.time - GAP:
            return False
        # As the vehicle moves on, a slope to the last one that is believed becomes less and less steep: where
        # the one before was not believed, it must not be that which it is like.
        last = self._believed[-1]
        return _agree(last, echo) and _nearer(echo, last, self._heard[-2])

    def _crowd(self, echo: _Echo) -> list[_Echo]:
        """Those echoes of late that agree with it, where they are most and last; else none."""
        last = self._believed[-1] if self._believed else echo
        seconds, most = FARTHER if echo.floor < last.floor else NEARER
        recent: list[_Echo] = []
        for other in reversed(self._heard):
            late = other.time < echo.time - seconds and len(recent) >= FEWEST
            if late or (recent and other.time < recent[-1].time - GAP):
                break
            recent.append(other)
        first = next((other for other in reversed(recent) if other.time > last.time), echo)
        crowd = [other for other in reversed(recent) if _agree(other, echo)]
        if not _agree(last, first):
            # It jumped. As the vehicle moves on, a slope could lead to both: each is of that which is nearer.
            crowd = [other for other in crowd if _nearer(other, echo, last)]
        lasts = len(crowd) >= CROWD and echo.time - crowd[0].time >= LASTING
        return crowd if lasts and len(crowd) >= most * len(recent) else []

    def _begin_anew(self, crowd: list[_Echo]) -> None:
        """Take another height of the seabed, on which echoes of a while agree, unless no ground has that."""
        echo = crowd[-1]
        if self._believed:
            last = self._believed[-1]
            if _far(last, echo) and _moved(last, echo) < MOVED:
                between = f"from {last.altitude:.1f} to {echo.altitude:.1f} m"
                self._jumped = self._jumped or f"the DVL's altitude jumped {between} over one place"
                return
            if not _agree(last, crowd[0]):
                self._believed.clear()
                if crowd[0].time < last.time + GAP:
                    self._leapt = (echo.time, crowd[0].altitude / last.altitude)
        self._jumped = ""
        newest = self._believed[-1].time if self._believed else -math.inf
        self._believed.extend(other for other in crowd if other.time > newest)
        self._height, self._smoothed = median(other.floor for other in crowd[-CROWD:]), echo.time

    def _believe(self, echo: _Echo) -> None:
        """Take its part in the height of the seabed."""
        self._believed.append(echo)
        share = min((echo.time - self._smoothed) / SMOOTHED, 1.0)
        self._height += share * (echo.floor - self._height)
        self._smoothed = echo.time
        if self._jumped and self._crowd(echo):
            self._jumped = ""
        self._compare()

    def _compare(self) -> None:
        """Hold altitudes against heights: see that they change alike, or do so again."""
        echoes = [echo for echo in self._believed if echo.time > self._since]
        wrong, right = _stuck(echoes), False
        when, leap = self._leapt
        for stretch in _stretches(echoes):
            found, alike = _unlike(stretch, leap if when > stretch[-1].time - KEPT else 1.0)
            wrong, right = wrong or found, right or alike
        if wrong:
            self._off, self._since = self._off or wrong, echoes[-1].time
        elif right:
            self._off = ""

    def _look_for_false_echoes(self, echo: _Echo) -> None:
        """See whether too many are far off, or were until a moment ago."""
        while self._returns and self._returns[0][0] < echo.time - KEPT:
            self._returns.popleft()
        for seconds, often in WAVERING:
            counts = [count for time, count in self._returns if time >= echo.time - seconds]
            heard = sum(other.time >= echo.time - seconds for other in self._heard)
            many = len(counts) >= often and sum(counts) >= FALSE_SHARE * max(heard, FALSE_OF)
            if many and not self._wavering:
                low, high = self._between
                self._wavering = f"the DVL's altitude jumps to and fro between {low:.1f} and {high:.1f} m"
        if not self._returns or self._returns[-1][0] < echo.time - WAVERING[0][0]:
            self._wavering = ""


def _moved(one: _Echo, other: _Echo) -> float:
    """Metres, horizontally, between the places of the DVL."""
    return math.hypot(other.x - one.x, other.y - one.y)


def _differs(one: _Echo, other: _Echo) -> float:
    """Metres between two heights of the seabed, less what the ground can have risen between them."""
    along = math.hypot(other.east - one.east, other.north - one.north)
    return abs(other.floor - one.floor) - STEEPEST * along - DRIFT * abs(other.time - one.time)


def _nearer(echo: _Echo, one: _Echo, other: _Echo) -> bool:
    """Is its floor at least as near to that of one as to that of the other?"""
    return abs(echo.floor - one.floor) <= abs(echo.floor - other.floor)


def _agree(one: _Echo, other: _Echo) -> bool:
    """Can both be of the same ground?"""
    return _differs(one, other) <= NEAR + NEAR_SHARE * min(one.altitude, other.altitude)


def _far(one: _Echo, other: _Echo) -> bool:
    """Can they only be of different ground?"""
    return _differs(one, other) > FAR + FAR_SHARE * min(one.altitude, other.altitude)


def _stretches(echoes: Sequence[_Echo]) -> list[Sequence[_Echo]]:
    """The shortest ones up to the last echo over which the height changes so much."""
    found: list[Sequence[_Echo]] = []
    low, high = math.inf, -math.inf
    for k in range(len(echoes) - 1, -1, -1):
        low, high = min(low, echoes[k].z), max(high, echoes[k].z)
        if len(echoes) - k >= COMPARED and high - low >= STRETCHES[len(found)]:
            found.append(echoes[k:])
            if len(found) == len(STRETCHES):
                break
    return found


def _unlike(echoes: Sequence[_Echo], leap: float) -> tuple[str, bool]:
    """What is wrong where altitudes do not change as heights do, in words; and whether they do so.

    Args:
        echoes: Over which the height changes.
        leap: How many times as much the altitude became at once, a while before.
    """
    low, high = min(echo.z for echo in echoes), max(echo.z for echo in echoes)
    parts: list[list[_Echo]] = [[], [], [], []]
    for echo in echoes:
        parts[min(int(4.0 * (echo.z - low) / (high - low)), 3)].append(echo)
    if min(len(part) for part in parts) < 2:
        return "", False
    risen, share = high - low, _slope([echo.z for echo in echoes], [echo.floor for echo in echoes])
    factor = 1.0 - share
    z = [median(echo.z for echo in part) for part in parts]
    floor = [median(echo.floor for echo in part) for part in parts]
    if STUCK < factor < SCALED or factor < -STUCK:
        return "", abs(share) <= ALIKE and _spread(floor) <= ALIKE * risen
    # A step of the ground is in one part of a stretch, and what is wrong with the altitude in all of them.
    shares = [(floor[k + 1] - floor[k]) / (z[k + 1] - z[k]) / share for k in range(3)]
    steps = (abs(b.floor - a.floor - share * (b.z - a.z)) for a, b in pairwise(echoes))
    even = min(shares) > 0.0 and max(shares) < UNEVEN * min(shares)
    if not even or max(steps) > 0.5 * abs(share) * risen:
        return "", False
    along = math.hypot(_spread(echo.x for echo in echoes), _spread(echo.y for echo in echoes))
    leans = [(median(e.east - e.x for e in part), median(e.north - e.y for e in part)) for part in parts]
    along += math.hypot(_spread(x for x, _ in leans), _spread(y for _, y in leans))
    allowed = LACKING + LACKING_SHARE * min(echo.altitude for echo in echoes)
    # A ground that is twice as far away at once, and then goes up as much as the vehicle goes down, is none:
    # both are the same factor.
    if not (factor >= SCALED and abs(factor - leap) < ALIKE * leap):
        allowed += STEEPEST * along
    if factor <= STUCK:
        # Two beams on a wall sink with the vehicle, whatever the ground does.
        allowed += 0.5 * risen
    if abs(share) * risen <= allowed:
        return "", False
    climbed = _slope([echo.z for echo in echoes], [echo.climb for echo in echoes])
    if abs(climbed - factor) < ALIKE * abs(share):
        return "the depth changes, and the DVL neither climbs nor sinks so much", False
    if factor <= STUCK:
        return _stuck_at(echoes[-1]), False
    return f"the DVL's altitude changes {factor:.1f} times as much as the depth", False


def _slope(x: list[float], y: list[float]) -> float:
    """Of the straight line through so many points."""
    x_mean, y_mean = fmean(x), fmean(y)
    across = sum((a - x_mean) * (b - y_mean) for a, b in zip(x, y, strict=True))
    return across / sum((a - x_mean) ** 2 for a in x)


def _spread(values: Iterable[float]) -> float:
    values = list(values)
    return max(values) - min(values)


def _stuck(echoes: Sequence[_Echo]) -> str:
    """Which altitude stays equal while the vehicle does not, in words; empty where none does."""
    if not echoes:
        return ""
    last = echoes[-1]
    low = high = last.z
    equal = exactly = 0
    for echo in reversed(echoes):
        if abs(echo.altitude - last.altitude) > EQUAL:
            break
        low, high, equal = min(low, echo.z), max(high, echo.z), equal + 1
        if equal >= COMPARED and high - low >= RISEN:
            return _stuck_at(last)
        if echo.altitude == last.altitude and exactly == equal - 1:
            exactly = equal
            if exactly >= SAME and high - low >= SWAYED and _moved(echo, last) >= TRAVELLED:
                return _stuck_at(last)
    return ""


def _stuck_at(echo: _Echo) -> str:
    return f"the DVL's altitude is stuck at {echo.altitude:.1f} m"
