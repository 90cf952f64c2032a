"""Which leg of the orders is flown, and by whom."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from dream.geometry import Bounds
from dream.mapping import OccupancyMap, within
from dream.orders import Flown, Orders, Outcome, SideOf, Task, place
from dream.planning.approach import Approach
from dream.planning.own import check_decision, checked_pilot, is_own, own_file, told_where
from dream.planning.sources.hull import STANDS
from dream.types import LOOK_AROUND, UNASKED, Asked, BoolArray, Decision, Mission, Observation, Target

if TYPE_CHECKING:
    from dream.mapping.prior import Prior
    from dream.mission import Pilot, Planner


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
        found = found_in(self.occupancy, leg.leg.target) if done or leg.leg.task is Task.FIND else None
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
        self._found[area.leg] = grown(self.occupancy, of.target, self._found[area.leg])
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


def found_in(occupancy: OccupancyMap, target: Target) -> Bounds | None:
    """The box around the targets of a kind in the map's area; None where less than `STANDS` m² are known.

    A wreck is what stands up from the seabed, oysters are what does not.
    """
    cells = _known(occupancy, target) & occupancy.to_see
    return _box(cells, occupancy) if np.count_nonzero(cells) * occupancy.protocol.cell**2 >= STANDS else None


def grown(occupancy: OccupancyMap, target: Target, found: Bounds) -> Bounds:
    """The box around all that hangs together with what was found, by what is known of it now."""
    from scipy.ndimage import label

    protocol = occupancy.protocol
    cells = _known(occupancy, target)
    lumps, _ = label(within(cells, 0.5 * protocol.group_radius, protocol.cell), np.ones((3, 3)))
    south, west = occupancy.cell_of(found.x_min, found.y_min)
    north, east = occupancy.cell_of(found.x_max, found.y_max)
    inside = np.s_[south:north, west:east]
    mine = cells & np.isin(lumps, np.unique(lumps[inside][cells[inside]]))
    return _box(mine, occupancy) if mine.any() else found


def _known(occupancy: OccupancyMap, target: Target) -> BoolArray:
    """(rows, cols) cells with such targets."""
    if target is Target.WRECK:
        return occupancy.target & occupancy.solid
    return occupancy.target & ~occupancy.solid if target is Target.OYSTERS else occupancy.target


def _box(cells: BoolArray, occupancy: OccupancyMap) -> Bounds:
    """Around some cells, of which there are any."""
    rows, cols = np.nonzero(cells)
    west, south = occupancy.center_of(rows.min(), cols.min())
    east, north = occupancy.center_of(rows.max(), cols.max())
    half = 0.5 * occupancy.protocol.cell
    return Bounds(float(west) - half, float(south) - half, float(east) + half, float(north) + half)
