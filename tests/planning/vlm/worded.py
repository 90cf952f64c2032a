"""Orders that a model makes of an operator's words, for tests."""

from __future__ import annotations

import json
from typing import Any

from dream.geometry import Bounds
from dream.orders import Leg, Orders, Side, SideOf, Task
from dream.types import Target
from tests.model_server import Server, says

BOX = Bounds(-20.0, -20.0, 20.0, 20.0)
WESTERN = "map only the western half, at most 80 steps"
NORTHERN = "find the wreck, then map the oysters on its north side"


def leg(task: str = "map", target: str = "any", area: str = "everywhere", **further: Any) -> dict[str, Any]:
    return {
        "task": task,
        "target": target,
        "area": area,
        "box": None,
        "side": None,
        "of_leg": None,
        **further,
    }


def reply(*legs: dict[str, Any], max_steps: int | None = None, left_out: str = "") -> dict[str, Any]:
    return {"legs": list(legs), "max_steps": max_steps, "left_out": left_out}


WEST = reply(leg(area="side", side="west"), max_steps=80)
NORTH = reply(leg("find", "wreck"), leg("map", "oysters", "side", side="north", of_leg=1))


ORDERS = Orders(
    (
        Leg(Target.WRECK, Task.FIND),
        Leg(Target.ANY, Task.MAP, SideOf(Side.NORTHWEST, 1)),
        Leg(Target.OYSTERS, Task.MAP, Bounds(-3.5, 0.0, 4.0, 8.0)),
        Leg(Target.ANY, Task.MAP, SideOf(Side.SOUTH)),
    ),
    120,
)


def will_say(model: Server, *replies: dict[str, Any] | str) -> None:
    model.script = [says(one if isinstance(one, str) else json.dumps(one)) for one in replies]
