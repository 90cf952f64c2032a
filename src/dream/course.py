"""Which leg of the orders is flown, and by whom."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

from dream.approach import Approach
from dream.flies import check_flies
from dream.geometry import Bounds
from dream.mapping import OccupancyMap
from dream.mapping.targets import connected_extent, target_extent
from dream.orders import Flown, Orders, Outcome, SideOf, Task, place
from dream.own_code import check_decision, checked_pilot, is_own, own_file, told_where
from dream.types import LOOK_AROUND, UNASKED, Asked, Decision, Mission, Observation

if TYPE_CHECKING:
    from dream.mapping.prior import Prior


class Pilot(Protocol):
    """One planner during one mission: what it remembers lives here."""

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        """The next move. Neither argument is changed."""
        ...


class Planner(Protocol):
    """A planner's parameters. One planner can fly many missions at once."""

    def begin(self, mission: Mission) -> Pilot:
        """A fresh pilot for one mission."""
        ...


@dataclass(slots=True, eq=False)
class Course:
    """The legs of one mission, one after the other on one map; a fresh pilot flies each.

    Where the area of a leg is a side of what was found, it changes with what is known of that. A leg on a
    side of what was never found is left out.
    """

    planner: Planner
    orders: Orders
    occupancy: OccupancyMap
    """Its area is that of the leg."""
    max_steps: int
    """Of all legs together."""
    prior: Prior | None = None
    """What an earlier survey holds of the map's ground."""
    leg: Flown = field(init=False)
    """The one that is flown, or was the last."""
    over: bool = False
    """No leg is left."""
    asked: Asked = UNASKED
    """What was spent on models so far."""
    _found: dict[int, Bounds] = field(default_factory=dict)
    """The box around what each leg found, by number."""
    _pilot: Pilot = field(init=False)
    _approach: Approach | None = None

    def __post_init__(self) -> None:
        check_flies(self.planner, self.occupancy.protocol)
        self._begin(1, flown=LOOK_AROUND)

    def decide(self, observation: Observation, flown: int) -> Decision:
        """The next move, after so many steps."""
        if self._approach is not None:
            decision = self._approach.decide(observation, self.occupancy)
            if decision is not None:
                return decision
            if self._approach.steps:
                self._pilot = self._begun(self._mission(flown))
            self._approach = None
        with _told(self._pilot, f"step {flown + 1}"):
            decision = self._pilot.decide(observation, self.occupancy)
        check_decision(decision, self.occupancy.protocol, self._pilot.decide, flown + 1)
        for exchange in decision.exchanges:
            self.asked += exchange
        return decision

    def after(self, flown: int, *, done: bool) -> Flown:
        """The leg that a step belonged to, with its outcome if that ended it; then the next one begins.

        Args:
            flown: Steps so far.
            done: The planner said so, and the completion check agreed.
        """
        self._follow()
        leg = self.leg
        found = target_extent(self.occupancy, leg.leg.target) if done or leg.leg.task is Task.FIND else None
        if leg.leg.task is Task.FIND and found is not None:
            leg = replace(leg, outcome=Outcome.FOUND)
        elif done:
            leg = replace(leg, outcome=Outcome.MAPPED if leg.leg.task is Task.MAP else Outcome.NOT_FOUND)
        else:
            return leg
        if found is not None:
            self._found[leg.number] = found
        self._begin(leg.number + 1, flown=max(flown, LOOK_AROUND))
        return leg

    def _follow(self) -> None:
        """More of what the area lies beside may be known now."""
        area = self.leg.leg.area
        if not isinstance(area, SideOf) or area.leg is None:
            return
        of = self.orders.legs[area.leg - 1]
        self._found[area.leg] = connected_extent(self.occupancy, of.target, self._found[area.leg])
        place_now = place(area, self.occupancy.bounds, self._found)
        if place_now != self.leg.area:
            self.occupancy.restrict(place_now)
            self.leg = replace(self.leg, area=place_now)

    def _begin(self, number: int, *, flown: int) -> None:
        """Begin that leg, or the first one after it whose area is known."""
        for later, leg in enumerate(self.orders.legs[number - 1 :], start=number):
            try:
                area = place(leg.area, self.occupancy.bounds, self._found)
            except LookupError:
                continue
            if area != self.occupancy.area:
                self.occupancy.restrict(area)
            self.leg = Flown(later, leg, area)
            mission = self._mission(flown)
            self._pilot = self._begun(mission)
            self._approach = None if area is None else Approach(mission)
            return
        self.over = True

    def _begun(self, mission: Mission) -> Pilot:
        with _told(self.planner, "begin"):
            pilot = self.planner.begin(mission)
        return checked_pilot(pilot, self.planner) if is_own(type(self.planner)) else pilot

    def _mission(self, flown: int) -> Mission:
        occupancy, leg = self.occupancy, self.leg
        return Mission(
            occupancy.protocol,
            occupancy.bounds,
            self.max_steps,
            leg.leg.target,
            leg.area,
            flown,
            self.asked,
            self.prior,
        )


def _told(part: Planner | Pilot, doing: str) -> AbstractContextManager[None]:
    """Have what fails in a planner of one's own told by its line; the package's speak for themselves."""
    file = own_file(type(part)) if is_own(type(part)) else None
    return nullcontext() if file is None else told_where(file, doing=doing)
