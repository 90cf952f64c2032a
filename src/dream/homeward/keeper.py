"""When a mission has to turn round, and the moves that lead it home."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

from dream.geometry import SE2
from dream.homeward.budget import Budget
from dream.homeward.pace import DEVIATIONS, SPEED, TURN_RATE, Pace, nominal_seconds
from dream.homeward.strands import Strands
from dream.homeward.tether import TetherKeeper
from dream.homeward.ways import Node, Place, after, move_to, node_of, places, way_home
from dream.types import LOOK_AROUND, Arrival, Balance, Decision, Home, Observation, Reasoning
from dream.vehicle import HOTEL_W

if TYPE_CHECKING:
    from dream.mapping import OccupancyMap

SURPRISE = 0.15
"""Share by which a way may become longer since something solid shows in it: it was free by the map only."""
ASKED = 5
"""Times that a place may be asked for to which no way leads that the tether allows, before it goes home."""
COMPLETE = "the mission is complete"
"""Why a mission goes home that has nothing left to do."""
CRUISE_W = 100.0
"""Watts that are believed in before any move was made: of a BlueROV2 Heavy at `SPEED`
(`vehicle.PowerModel`)."""


@dataclass(slots=True, eq=False)
class Homeward:
    """Keeps the way home affordable through a mission, and leads it home when that is due.

    What it does: before every move, the way home from where that move ends, over what is known to be free,
    has to take no more than what is left after the move, with a margin for how moves spread and for how far
    the position may err. Else the mission turns round, and goes home from then on. A place to go home to that
    no known way leads to is replaced by where the mission began. Where no way is known at all, one is
    reckoned to take what all moves took so far. A tether must be neither too long nor wound too far after a
    move, and come in on a known way: else it leads there by a way on which it does, back along the tether
    first; where there is none, a few moves back. Where the map changes so that it comes in on no known way,
    it goes back as it came until it does.

    Fails when: what was free turns out to be solid, so that no known way leads home. It goes back as it came
    then, and where that fails too it looks around, until a way is known.
    """

    budget: Budget
    start: Place
    """Where the mission began: x, y and z, metres in the world."""
    began: Observation
    """The first look."""
    cap: int
    """Steps at most."""
    why: str = ""
    """Why it goes home; empty while it does not."""
    _seconds: Pace = field(default_factory=Pace)
    _watt_hours: Pace = field(default_factory=lambda: Pace(rate=CRUISE_W / 3600.0))
    _sigma: float = 0.0
    """Metres by which the position may err."""
    ticking: bool = False
    """Does the clock of observations go on while a planner thinks?"""
    _waited: float = 0.0
    """Seconds that it stood still for answers, beside that clock."""
    _longest: float = 0.0
    """Seconds that an answer took at most: the next may take as long."""
    _to_start: bool = False
    """Is the place that was asked for too far?"""
    _steps: int = 0
    """Made in the mission."""
    _made: list[Decision] = field(default_factory=list)
    """All moves so far."""
    _came: list[Node] = field(default_factory=list)
    """Where it came along, from the start to here, each a move from the one before; without loops."""
    _going_back: bool = False
    """Is the move at hand one back along it?"""
    _looks: int = 0
    """Looks around that are due, since going back as it came failed."""
    tether: TetherKeeper | None = None
    """That it drags."""
    _unwinds_to: Place | None = None
    """Where it was asked to go, to which it leads by another way; None while it leads nowhere."""
    _recovers: bool = False
    """Does it go back as it came, since the map has changed so that on no known way all of the tether comes
    in?"""

    @classmethod
    def of(
        cls, budget: Budget, first: Observation, cap: int, occupancy: OccupancyMap, *, ticking: bool
    ) -> Homeward:
        """For a mission that begins with a look; the map is told how far its tether reaches.

        Raises:
            ValueError: The tether does not reach the place to go home to.
        """
        start = first.pose.x, first.pose.y, first.z
        budget.check_from(*start[:2])
        tether = None
        if math.isfinite(budget.tether_m):
            tether = TetherKeeper(budget.tether_m, start)
            occupancy.hold(tether.leash)
        return cls(budget, start, first, cap, ticking=ticking, tether=tether)

    @property
    def leads(self) -> bool:
        """Does it say where to go, in the planner's place?"""
        return bool(self.why) or self._unwinds_to is not None or self._recovers

    def affords(self, move: Decision, seen: Observation, occupancy: OccupancyMap, steps: int) -> bool:
        """Does the way home stay affordable when a move is made? Else it goes home from now on.

        True for whatever it makes on its way home itself.

        Args:
            move: As the guard lets it pass.
            seen: From where it begins.
            occupancy: What is known.
            steps: Made before it.
        """
        if self.why:
            return True
        pose, z = after(seen.pose, seen.z, move, occupancy)
        lies = None
        if self.tether is not None:
            before = self.tether.lies
            (lies,) = self.tether.along([move], before, seen.pose, seen.z, occupancy)
            too_far = self.tether.over(lies, before, back=self._unwinds_to is not None) > 0.0
            if not self._recovers and (too_far or not self.tether.comes_in(lies, pose, z, occupancy)):
                self._unwind(self.tether.place(pose, z, occupancy), seen, occupancy)
                return False
        waited = self._waited if self.ticking else self._waited + move.waited
        short = self._short(move, self._way(pose, z, occupancy, lies), seen, steps, waited)
        if short is not None and self.budget.home is not None:
            # What is not enough for the place that was asked for may be enough for the start.
            there = self._way(seen.pose, seen.z, occupancy, self._lies)
            if self._short(Decision(), there, seen, steps, waited) is not None:
                self._to_start = True
                back = self._way(seen.pose, seen.z, occupancy, self._lies)
                self._to_start = there is None or (back is not None and len(back) < len(there))
        if short is not None:
            most, digits = short.way + short.margin, 1 if short.unit == "Wh" else 0
            self.why = (
                f"the way home takes up to {most:.{digits}f} {short.unit} with one more move, "
                f"and {short.left:.{digits}f} {short.unit} are left of the {short.name}"
            )
        return short is None

    def _unwind(self, place: Place, seen: Observation, occupancy: OccupancyMap) -> None:
        """Lead to a place by a way that the tether allows; back along it where there is none.

        Planners are told then to go elsewhere.
        """
        assert self.tether is not None
        here = self.tether.place(seen.pose, seen.z, occupancy)
        was_led, times = self._unwinds_to is not None, self.tether.times_led(place)
        self._unwinds_to, back = self._unwinds_to or place, 1
        if times == 1 and not was_led and self._way_now(seen, occupancy):
            return
        if self.tether.close(self._unwinds_to, here, occupancy):
            occupancy.hold(self.tether.leash)
        elif times > ASKED:
            self.why = f"no way that a tether of {self.tether.metres:g} m allows leads where it was to go"
        elif times > 1 and not was_led:
            # A place that it came along stays open, and may be asked for again: from farther off each time.
            if self._way_now(seen, occupancy):
                return
            back = times
        self._unwinds_to = self.start
        if self._way_now(seen, occupancy) is None:
            self.why = f"no way that a tether of {self.tether.metres:g} m allows leads back"
        if self.why:
            self._unwinds_to = None
        else:
            del self.tether.plan[back:]

    def _short(
        self, move: Decision, way: list[Decision] | None, seen: Observation, steps: int, waited: float
    ) -> Balance | None:
        """What may be short for a way home after a move; None where nothing may.

        Where no way is known it is reckoned as what all moves took so far.
        """
        moves = [move, *(self._made if way is None else way)]
        balances = self._balances(moves, seen, steps, waited, None)
        return next((one for one in balances if one.short), None)

    def move(self, seen: Observation, occupancy: OccupancyMap) -> Decision:
        """The next move of the way home, or of the way to where the planner asked to go."""
        if self.tether is not None and self._recovers and not self.why:
            move = self.tether.move_back(seen, occupancy)
            if move is not None:
                told = "Going back as it came, until a way is known on which all of the tether comes in."
                return replace(move, reasoning=Reasoning(action=told))
            self.why = f"no way is known on which all of a tether of {self.tether.metres:g} m comes in"
        way = self._way_now(seen, occupancy)
        if way is None:
            back = None
            if len(self._came) > 1 and not self._looks:
                back = move_to(self._came[-2], seen.pose, seen.z, occupancy.protocol)
            if back is not None:
                self._going_back = back.advance > 0.0 or back.climb != 0.0
                told = f"No way home is known: going back as it came, since {self.why}."
                return replace(back, reasoning=Reasoning(action=told))
            self._looks = max(self._looks - 1, 0)
            told = "No way home is known: looking around for one."
            return Decision(turn=0.5 * math.pi, reasoning=Reasoning(action=told))
        if self.why:
            told = f"Going home, {len(way)} steps away: {self.why}."
        elif self._unwinds_to == self.start:
            told = f"Going {len(way)} steps back along the tether: no way that it allows leads there."
        else:
            told = f"Going {len(way)} steps back along the tether and round: it would be too long, or wound."
        return replace(way[0] if way else Decision(), reasoning=Reasoning(action=told))

    def move_instead(self, asked: Decision, seen: Observation, occupancy: OccupancyMap) -> Decision:
        """The same in the place of what a planner asked for, with what asking took."""
        return replace(self.move(seen, occupancy), exchanges=asked.exchanges, waited=asked.waited)

    def learn(
        self,
        move: Decision,
        before: Observation,
        arrival: Arrival,
        seen: Observation,
        occupancy: OccupancyMap,
    ) -> None:
        """Take in what a move took, and where the tether lies after it."""
        nominal = nominal_seconds(move)
        if not self.ticking:
            self._waited += move.waited
        self._longest = max(self._longest, move.waited)
        self._made.append(move)
        thinking = move.waited if self.ticking else 0.0
        self._seconds.learn(nominal, max(seen.time - before.time - thinking, 0.0))
        self._watt_hours.learn(nominal, self._drawn(seen) - self._drawn(before))
        self._sigma = arrival.sigma
        if self.tether is not None:
            self.tether.went(move, seen, arrival.sigma, occupancy)
            if not self.tether.plan:
                self._unwinds_to = None

    def stands(
        self, seen: Observation, occupancy: OccupancyMap, steps: int, *, complete: bool = False
    ) -> Home:
        """How it stands after so many steps.

        Args:
            seen: Where it is.
            occupancy: What is known.
            steps: Made so far.
            complete: The mission has nothing left to do: it goes home.
        """
        self.why = self.why or seen.trouble or (COMPLETE if complete else "")
        self._steps = steps
        self._keep_trail(node_of(seen.pose, seen.z, occupancy.protocol))
        if self.tether is not None and not self.why:
            if self._recovers and self.tether.may_be_in(seen.pose, seen.z, occupancy):
                self.tether.take_in()
            did, place = self._recovers, self.tether.place(seen.pose, seen.z, occupancy)
            self._recovers = not self.tether.comes_in(self.tether.lies, seen.pose, seen.z, occupancy)
            if self._recovers:
                self._unwinds_to, self.tether.plan = None, []
                if not did:
                    self.tether.times_led(place)
        if self.why:
            self._unwinds_to = None
            way = self._way_now(seen, occupancy)
        else:
            way = self._way(seen.pose, seen.z, occupancy, self._lies)
        if way is None:
            return Home(None, (), self.why)
        path = places(seen.pose, seen.z, way, occupancy)
        balances = self._balances(way, seen, steps, self._waited, self._lies)
        return Home(path if way else (), balances, self.why)

    def _keep_trail(self, here: Node) -> None:
        if self._going_back and here != self._came[-2]:
            # The guard or a contact stopped it, here or on the way there.
            self._looks = LOOK_AROUND
            self._came.pop()
        self._going_back = False
        if here in self._came:
            del self._came[self._came.index(here) + 1 :]
        else:
            self._came.append(here)

    @property
    def _lies(self) -> Strands | None:
        return None if self.tether is None else self.tether.lies

    @property
    def _homes(self) -> tuple[Place, ...]:
        """The place that was asked for, while that can be reached in time, and the start."""
        if self.budget.home is None or self._to_start:
            return (self.start,)
        return (*self.budget.home, self.start[2]), self.start

    def _way(
        self, pose: SE2, z: float, occupancy: OccupancyMap, lies: Strands | None
    ) -> list[Decision] | None:
        """The way home."""
        if self.tether is None or lies is None:
            ways = (way_home(pose, z, occupancy, place) for place in self._homes)
        else:
            ways = (self.tether.way(lies, pose, z, occupancy, place) for place in self._homes)
        return next((way for way in ways if way is not None), None)

    def _way_now(self, seen: Observation, occupancy: OccupancyMap) -> list[Decision] | None:
        """The way that it is on, home or where the planner asked to go."""
        if self.tether is None:
            return self._way(seen.pose, seen.z, occupancy, None)
        goals = self._homes if self._unwinds_to is None else (self._unwinds_to,)
        if self.why and goals == (self.start,) and self.tether.may_be_in(seen.pose, seen.z, occupancy):
            return []
        return self.tether.way_on(goals, seen, occupancy, partial(self._affords_way, seen))

    def _affords_way(self, seen: Observation, way: list[Decision]) -> bool:
        """Is there enough for a way, nothing kept back?"""
        balances = self._balances(way, seen, self._steps, self._waited, None)
        return all(one.way <= one.left for one in balances)

    def _balances(
        self, way: list[Decision], seen: Observation, steps: int, waited: float, lies: Strands | None
    ) -> tuple[Balance, ...]:
        """What is left now, after so many seconds of waiting, and what a way takes of it from here on; and
        how a tether lies."""
        nominal, moves = sum(map(nominal_seconds, way)), len(way)
        # What may come: a way round, a turn back to it, and a detour for where it really is.
        more = SURPRISE * nominal + math.pi / TURN_RATE + DEVIATIONS * self._sigma / SPEED if way else 0.0
        balances = [
            Balance("steps", "steps", self.cap - steps, moves, math.ceil(SURPRISE * moves) + bool(way))
        ]

        def add(name: str, unit: str, left: float, pace: Pace, think: float) -> None:
            takes = pace.mean(nominal, moves)
            margin = pace.mean(nominal + more, moves) - takes + pace.margin(moves)
            if not self.why:
                margin += think
            balances.append(Balance(name, unit, left, takes, margin))

        if math.isfinite(self.budget.seconds):
            spent = seen.time - self.began.time + waited
            add("time", "s", self.budget.seconds - spent, self._seconds, self._longest)
        if math.isfinite(self.budget.battery_wh):
            # Who waits draws what everything but the thrusters does, which a simulated clock leaves out.
            left = self.budget.battery_wh - self._drawn(seen) - waited * HOTEL_W / 3600.0
            add("battery", "Wh", left, self._watt_hours, self._longest * HOTEL_W / 3600.0)
        if self.tether is not None and lies is not None:
            balances += self.tether.balances(lies)
        return tuple(balances)

    def _drawn(self, seen: Observation) -> float:
        """Watt-hours since the first look, as measured; reckoned by the time where nobody does."""
        if seen.drawn_wh is not None and self.began.drawn_wh is not None:
            return seen.drawn_wh - self.began.drawn_wh
        return (seen.time - self.began.time) * CRUISE_W / 3600.0
