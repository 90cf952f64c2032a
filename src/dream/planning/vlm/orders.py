"""An operator's words, turned once by a model into orders; and orders in files."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, Field, ValidationError, create_model, model_validator

from dream.errors import MissionAborted
from dream.geometry import Bounds
from dream.orders import MOST_LEGS, Area, Leg, Orders, Side, SideOf, Task, written
from dream.planning.vlm.asking import Asking, Question
from dream.planning.vlm.asking.failures import INVALID, REFUSED, TRUNCATED
from dream.planning.vlm.prompts import chosen, filled
from dream.planning.vlm.reply import StrictReply
from dream.protocol import SurveyProtocol
from dream.types import Exchange, Target

R = TypeVar("R", bound=BaseModel)

MOST_WORDS = 2000
"""Characters that an operator may say."""
MOST_LEFT_OUT = 600
LEAST_SIDE = 1.0
"""Metres along a box at least."""
MOST_BYTES = 1 << 16
"""A larger file of orders is refused."""
MOST_STEPS = 1_000_000

SideName = Literal["north", "northeast", "east", "southeast", "south", "southwest", "west", "northwest"]


class WrittenBox(StrictReply):
    """A box in the world, metres."""

    x_min_m: float
    y_min_m: float
    x_max_m: float
    y_max_m: float

    @model_validator(mode="after")
    def _large_enough(self) -> WrittenBox:
        if self.x_max_m - self.x_min_m < LEAST_SIDE or self.y_max_m - self.y_min_m < LEAST_SIDE:
            raise ValueError(f"expected a box of at least {LEAST_SIDE:g} m from min to max")
        return self


class WrittenLeg(StrictReply):
    """See `dream.orders.Leg`."""

    task: Literal["map", "find"]
    target: Literal["any", "oysters", "wreck"]
    area: Literal["everywhere", "box", "side"]
    box: Annotated[WrittenBox | None, Field(description="where area is box, else null")]
    side: Annotated[SideName | None, Field(description="where area is side, else null")]
    of_leg: Annotated[int | None, Field(description="number of the earlier leg that found it, or null")]

    @model_validator(mode="after")
    def _consistent(self) -> WrittenLeg:
        if (self.area == "box") != (self.box is not None):
            raise ValueError("area box goes with a box, and others without")
        if (self.area == "side") != (self.side is not None):
            raise ValueError("area side goes with a side, and others without")
        if self.of_leg is not None and self.area != "side":
            raise ValueError("of_leg goes with area side only")
        return self

    @property
    def place(self) -> Area:
        """Where it is."""
        if self.box is not None:
            return Bounds(self.box.x_min_m, self.box.y_min_m, self.box.x_max_m, self.box.y_max_m)
        return None if self.side is None else SideOf(Side(self.side), self.of_leg)


class WrittenOrders(StrictReply):
    """Orders as they stand in a file."""

    legs: Annotated[list[WrittenLeg], Field(min_length=1, max_length=MOST_LEGS)]
    max_steps: Annotated[int | None, Field(description="steps at most in all, or null", ge=1, le=MOST_STEPS)]

    @model_validator(mode="after")
    def _in_order(self) -> WrittenOrders:
        for number, leg in enumerate(self.legs, start=1):
            if leg.of_leg is not None and not 1 <= leg.of_leg < number:
                raise ValueError(f"of_leg of leg {number}: expected the number of an earlier leg")
        return self

    @property
    def orders(self) -> Orders:
        """The same, as they are flown."""
        legs = (Leg(Target(leg.target), Task(leg.task), leg.place) for leg in self.legs)
        return Orders(tuple(legs), self.max_steps)


class AnsweredOrders(WrittenOrders):
    """Orders as a model gives them; `orders_reply` holds them to a survey area."""

    left_out: Annotated[
        str, Field(max_length=MOST_LEFT_OUT, description="what of the words is not in the orders, or empty")
    ]


class _MissionFile(StrictReply):
    format: Literal["dream-mission-1"]
    text: Annotated[str, Field(max_length=MOST_WORDS)]
    orders: WrittenOrders


def orders_reply(bounds: Bounds) -> type[AnsweredOrders]:
    """What a model's answer must be, for a survey area."""

    def check(self: AnsweredOrders) -> AnsweredOrders:
        check_inside(self.orders, bounds)
        return self

    validators: dict[str, Any] = {"_inside": model_validator(mode="after")(check)}
    return create_model("Orders", __base__=AnsweredOrders, __validators__=validators)


@dataclass(frozen=True, slots=True, eq=False)
class Understood:
    """What a model made of an operator's words."""

    orders: Orders
    left_out: str
    """What of the words is not in them, as the model says."""
    exchange: Exchange
    """How it was asked, and what that took."""


def ask_orders(
    asking: Asking, text: str, bounds: Bounds, protocol: SurveyProtocol, labelled: Target
) -> Understood:
    """Orders from an operator's words.

    Args:
        asking: Which model turns them into orders.
        text: The words. They are shown to the model and nothing else.
        bounds: The survey area.
        protocol: By which rules the mission will be flown.
        labelled: The kind of target that the labels show there.

    Raises:
        ValueError: The words are too long or none, the model cannot be asked, or the mission cannot be
            flown here.
        MissionAborted: No answer counted.
    """
    if not text.strip():
        raise ValueError("mission: expected the mission in words, got none")
    if len(text) > MOST_WORDS:
        raise ValueError(f"mission: expected at most {MOST_WORDS} characters, got {len(text)}")
    line = asking.line()
    prompt = chosen("orders", line.prompts)
    values = {
        **{side: f"{value:g}" for side, value in asdict(bounds).items()},
        "labelled": labelled.value,
        "cap": f"{protocol.cap}",
        "advance": f"{max(protocol.advances):g}",
        "most": f"{MOST_LEGS}",
    }
    instructions = filled(prompt, values)
    said = f"The operator says, in JSON:\n{json.dumps(text, ensure_ascii=False)}"
    question = Question(prompt.label, instructions, said, {}, orders_reply(bounds))
    answer = line.insist(line.ask(question).answer())
    if answer.reply is None:
        why = answer.exchange.fallback.rstrip(".… ")
        raise MissionAborted(
            f"mission: expected orders from {asking.label}, got none ({why}). "
            f"{_advice(why)}, or ask another model"
        )
    orders = answer.reply.orders
    check_flyable(orders, bounds, protocol, labelled)
    return Understood(orders, answer.reply.left_out, answer.exchange)


def _advice(fallback: str) -> str:
    """What may help where no orders came: other words where the model said something, else patience."""
    said = fallback.partition(":")[0] in (INVALID, REFUSED, TRUNCATED)
    return "Say it in other words" if said else "Try again"


def check_inside(orders: Orders, bounds: Bounds) -> None:
    """Raise a ValueError where a box does not lie in the survey area."""
    for number, leg in enumerate(orders.legs, start=1):
        box = leg.area
        if isinstance(box, Bounds) and not (
            bounds.contains(box.x_min, box.y_min) and bounds.contains(box.x_max, box.y_max)
        ):
            raise ValueError(
                f"leg {number}: expected a box in the survey area, {_sides(bounds)}, got {_sides(box)}"
            )


def _sides(box: Bounds) -> str:
    return f"x {box.x_min:g} to {box.x_max:g} and y {box.y_min:g} to {box.y_max:g} m"


def check_flyable(orders: Orders, bounds: Bounds, protocol: SurveyProtocol, labelled: Target) -> None:
    """Raise a ValueError where orders cannot be flown in a survey area, by its labels and its protocol."""
    check_inside(orders, bounds)
    if orders.max_steps is not None and orders.max_steps > protocol.cap:
        raise ValueError(
            f"max_steps: expected at most {protocol.cap}, the cap of {protocol.name}, got {orders.max_steps}"
        )
    for number, leg in enumerate(orders.legs, start=1):
        if leg.target not in (Target.ANY, labelled):
            raise ValueError(
                f"leg {number}: expected a target that is labelled here, {labelled.value} or any, got "
                f"{leg.target.value}. The labels of this world know one kind of target"
            )


# ------------------------------------------------------------------------------------------------- files


def read_orders(text: str) -> Orders:
    """Orders from JSON.

    Raises:
        ValueError: They are none.
    """
    return _parsed(WrittenOrders, text, "mission").orders


def write_mission(path: Path, text: str, orders: Orders) -> None:
    """Write a mission: the operator's words, and what they were understood to be."""
    content = {"format": "dream-mission-1", "text": text, "orders": written(orders)}
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def read_mission(path: Path) -> tuple[str, Orders]:
    """A mission that was written: the operator's words, and the orders.

    Raises:
        ValueError: It is no such file; the message says what is wrong.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise ValueError(
            f"--mission: expected a file that dream mission wrote, got {path} ({error.strerror})"
        ) from error
    if len(raw) > MOST_BYTES:
        raise ValueError(f"{path}: expected at most {MOST_BYTES} bytes, got more. Is it a mission?")
    mission = _parsed(_MissionFile, raw, str(path))
    return mission.text, mission.orders.orders


def _parsed(kind: type[R], text: str | bytes, where: str) -> R:
    try:
        return kind.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"])) or "the whole"
        raise ValueError(f"{where}: {place}: {first['msg']}. Expected what dream mission writes") from None
