"""What a model's reply must be, and the decision that it makes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    create_model,
    model_validator,
)

from dream.protocol import SurveyProtocol
from dream.types import Decision, Reasoning

MOST_WORDS = 1200
"""Characters of one field of reasoning; longer ones are refused."""

Sentences = Annotated[str, Field(max_length=MOST_WORDS)]
STEPS = ("distribution", "target_area", "completion", "next_target", "safety", "action")


class StrictReply(BaseModel):
    """Text from a stranger: bounded, and nothing in it that was not asked for."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Reasoned(StrictReply):
    """The six reasoning steps, which come before the answer."""

    distribution: Sentences
    target_area: Sentences
    completion: Sentences
    next_target: Sentences
    safety: Sentences
    action: Sentences

    @property
    def reasoning(self) -> Reasoning:
        """In the words of the model."""
        return Reasoning(**{step: getattr(self, step) for step in STEPS})


class Acting(StrictReply):
    """A reply that gives an action; `actions` adds the fields of a protocol."""

    @model_validator(mode="after")
    def _consistent(self) -> Acting:
        action: Any = self
        if (action.direction == "forward") != (action.turn_deg == 0):
            raise ValueError("direction forward goes with turn_deg 0, left and right with another")
        return self

    @property
    def decision(self) -> Decision:
        """What the robot is asked to do."""
        action: Any = self
        reasoning = self.reasoning if isinstance(self, Reasoned) else Reasoning()
        if action.done:
            return Decision(done=True, reasoning=reasoning)
        turn = math.radians(action.turn_deg) * (-1.0 if action.direction == "right" else 1.0)
        climb, tilt = getattr(action, "climb_m", 0.0), getattr(action, "tilt_deg", None)
        return Decision(
            turn,
            float(action.step_m),
            reasoning=reasoning,
            climb=float(climb),
            tilt=None if tilt is None else math.radians(tilt),
        )


class _ReasonedActing(Reasoned, Acting):
    pass


def vanilla_reply(protocol: SurveyProtocol) -> type[Acting]:
    """An action of the protocol, without reasons."""
    return create_model("Action", __base__=Acting, **_action_fields(protocol))


def dream_reply(protocol: SurveyProtocol) -> type[Acting]:
    """The six reasoning steps, then an action of the protocol."""
    return create_model("ReasonedAction", __base__=_ReasonedActing, **_action_fields(protocol))


def ranked_reply(numbers: Sequence[int]) -> type[Ranking]:
    """The six reasoning steps, then an order of numbered places.

    Args:
        numbers: Of the places.
    """
    allowed = sorted(numbers)

    def check(ranking: list[int]) -> list[int]:
        if sorted(ranking) != allowed:
            raise ValueError(f"expected each of the numbers {', '.join(map(str, allowed))} once")
        return ranking

    # Servers that hold a model to a schema know enumerations and lengths, but not that each comes once.
    number: Any = Literal[tuple(allowed)]
    count = {"minItems": len(allowed), "maxItems": len(allowed)}
    kind = Annotated[
        list[number],
        AfterValidator(check),
        Field(description="all numbers, the best first", json_schema_extra=count),
    ]
    return create_model("RankedPlaces", __base__=Ranking, ranking=(kind, ...))


class ChosenAnswer(StrictReply):
    """A reply that picks one of the answers that are offered; `choice_reply` adds them."""

    reason: Sentences
    answer: str


def choice_reply(choices: Sequence[str]) -> type[ChosenAnswer]:
    """A short reason, then one of the answers.

    Args:
        choices: The answers that are offered. A number may come as one.
    """
    answer: Any = Literal[tuple(choices)]
    kind = Annotated[answer, BeforeValidator(_as_text)]
    return create_model("Choice", __base__=ChosenAnswer, answer=(kind, ...))


def _as_text(value: Any) -> Any:
    return str(value) if type(value) is int else value


class Ranking(Reasoned):
    """A reply that puts numbered places in order; `ranked_reply` adds the numbers."""

    ranking: list[int]
    confidence: Annotated[float, Field(ge=0.0, le=1.0, description="from 0 to 1, that the first is the best")]
    mission_complete: bool


def _action_fields(protocol: SurveyProtocol) -> dict[str, Any]:
    angles = tuple(sorted({round(math.degrees(abs(turn)), 3) for turn in protocol.turn_angles}))
    turns = tuple(map(_whole, angles))
    lengths = tuple(map(_whole, (0.0, *sorted(protocol.advances))))
    fields: dict[str, Any] = {
        "direction": (Literal["left", "forward", "right"], Field(description="which way to turn first")),
        "turn_deg": (_one_of(turns), Field(description="degrees")),
        "step_m": (_one_of(lengths), Field(description="metres forward after the turn")),
    }
    if protocol.space is not None:
        up = "metres upwards on the way forward, downwards where negative"
        down = "degrees that the camera looks down after that, up where negative"
        tilts = tuple(_whole(round(math.degrees(tilt), 3)) for tilt in sorted(protocol.tilts))
        fields["climb_m"] = (_one_of(tuple(map(_whole, protocol.climbs))), Field(description=up))
        fields["tilt_deg"] = (_one_of(tilts), Field(description=down))
    return {**fields, "done": (bool, Field(description="the mission is complete"))}


def _whole(value: float) -> float:
    """As an integer where it is one: JSON then shows no point."""
    return int(value) if value == int(value) else value


def _one_of(values: tuple[float, ...]) -> Any:
    """A number of a fixed set; in JSON 2 and 2.0 are the same."""

    def check(value: float) -> float:
        if value not in values:
            raise ValueError(f"expected one of {', '.join(map(str, values))}")
        return value

    return Annotated[float, AfterValidator(check), Field(json_schema_extra={"enum": list(values)})]
