"""What an operator orders: legs one after the other, each with what it looks for and where, and limits."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from dream.geometry import Bounds
from dream.types import Target

BESIDE = 10.0
"""Metres around what was found that count as beside it."""
MOST_LEGS = 8


class Task(enum.StrEnum):
    """What a leg is flown for."""

    MAP = "map"
    """It ends when the planner is done and the map's completion check agrees, within the leg's area."""
    FIND = "find"
    """It ends as soon as such a target is on the map."""


class Side(enum.StrEnum):
    """A side of the survey area, or of what was found."""

    NORTH = "north"
    NORTHEAST = "northeast"
    EAST = "east"
    SOUTHEAST = "southeast"
    SOUTH = "south"
    SOUTHWEST = "southwest"
    WEST = "west"
    NORTHWEST = "northwest"


@dataclass(frozen=True, slots=True)
class SideOf:
    """The half on that side, or the quarter of the four between.

    Of what was found it reaches from its middle to `BESIDE` metres beyond it.
    """

    side: Side
    leg: int | None = None
    """Number, from 1, of the earlier leg that found it; None for the survey area."""


Area = Bounds | SideOf | None
"""A box in the world, a side of something, or everything."""


@dataclass(frozen=True, slots=True)
class Leg:
    """One thing to do."""

    target: Target = Target.ANY
    task: Task = Task.MAP
    area: Area = None


@dataclass(frozen=True, slots=True)
class Orders:
    """Legs in the order in which they are flown, on one map, and limits over all of them."""

    legs: tuple[Leg, ...]
    max_steps: int | None = None
    """Decisions at most; the protocol's cap where None."""

    def __post_init__(self) -> None:
        if not 1 <= len(self.legs) <= MOST_LEGS:
            raise ValueError(f"legs: expected 1 to {MOST_LEGS}, got {len(self.legs)}")
        if self.max_steps is not None and self.max_steps < 1:
            raise ValueError(f"max_steps: expected at least 1, got {self.max_steps}")
        for number, leg in enumerate(self.legs, start=1):
            other = leg.area.leg if isinstance(leg.area, SideOf) else None
            if other is not None and not 1 <= other < number:
                raise ValueError(f"leg {number}: expected a side of what an earlier leg finds, got {other}")


class Outcome(enum.StrEnum):
    """How a leg ended."""

    MAPPED = "mapped"
    FOUND = "found"
    NOT_FOUND = "not found"
    """All of its area is seen, and there is none."""


@dataclass(frozen=True, slots=True)
class Flown:
    """A leg as it is flown."""

    number: int
    """From 1."""
    leg: Leg
    area: Bounds | None
    """Where it is; everywhere where None."""
    outcome: Outcome | None = None
    """None while it goes on, and where the mission ended before it."""


def everything(target: Target) -> Orders:
    """The orders of whoever gives none: map all of it."""
    return Orders((Leg(target),))


def place(area: Area, bounds: Bounds, found: Mapping[int, Bounds]) -> Bounds | None:
    """Where an area is; everywhere where None.

    Args:
        area: As it was ordered.
        bounds: The survey area.
        found: The boxes around what legs found, by number.

    Raises:
        LookupError: It is a side of what was not found.
    """
    if not isinstance(area, SideOf):
        return area
    if area.leg is None:
        return side_of(bounds, area.side)
    if area.leg not in found:
        raise LookupError(f"leg {area.leg} found nothing")
    box = found[area.leg]
    around = Bounds(box.x_min - BESIDE, box.y_min - BESIDE, box.x_max + BESIDE, box.y_max + BESIDE)
    beside = side_of(around, area.side)
    return Bounds(
        max(beside.x_min, bounds.x_min),
        max(beside.y_min, bounds.y_min),
        min(beside.x_max, bounds.x_max),
        min(beside.y_max, bounds.y_max),
    )


def side_of(box: Bounds, side: Side) -> Bounds:
    """The half of a box on that side of its middle, or the quarter."""
    x, y = 0.5 * (box.x_min + box.x_max), 0.5 * (box.y_min + box.y_max)
    return Bounds(
        x if "east" in side else box.x_min,
        y if "north" in side else box.y_min,
        x if "west" in side else box.x_max,
        y if "south" in side else box.y_max,
    )


def written(orders: Orders) -> dict[str, Any]:
    """Orders as they stand in files; `dream.planning.vlm.orders` reads them."""
    legs = []
    for leg in orders.legs:
        area, kind = leg.area, "everywhere"
        box, side, of_leg = None, None, None
        if isinstance(area, Bounds):
            kind, box = "box", {f"{name}_m": value for name, value in asdict(area).items()}
        elif area is not None:
            kind, side, of_leg = "side", area.side.value, area.leg
        legs.append(
            {
                "task": leg.task.value,
                "target": leg.target.value,
                "area": kind,
                "box": box,
                "side": side,
                "of_leg": of_leg,
            }
        )
    return {"legs": legs, "max_steps": orders.max_steps}


NOUNS = {Target.ANY: "all targets", Target.OYSTERS: "the oysters", Target.WRECK: "the wreck"}


def sentences(orders: Orders, cap: int) -> Sequence[str]:
    """The orders in plain words, a sentence a leg and one for the limit.

    Args:
        orders: What is ordered.
        cap: Steps at most where they do not say.
    """
    legs = [
        f"{number}. {leg.task.value.capitalize()} {_what(leg)} {_where(leg.area)}."
        for number, leg in enumerate(orders.legs, start=1)
    ]
    return [*legs, f"At most {min(orders.max_steps or cap, cap)} steps in all."]


def _what(leg: Leg) -> str:
    return "any target" if leg.task is Task.FIND and leg.target is Target.ANY else NOUNS[leg.target]


def _where(area: Area) -> str:
    if area is None:
        return "in the whole survey area"
    if isinstance(area, Bounds):
        return (
            f"in the box from x = {area.x_min:g} to {area.x_max:g} m "
            f"and from y = {area.y_min:g} to {area.y_max:g} m"
        )
    if area.leg is None:
        part = "half" if area.side in ("north", "east", "south", "west") else "quarter"
        return f"in the {area.side.value}ern {part} of the survey area"
    return f"on the {area.side.value} side of what leg {area.leg} found, up to {BESIDE:g} m from it"
