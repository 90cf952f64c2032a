"""Every reply becomes a decision of the protocol, or is refused."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from dream.planning.vlm.reply import MOST_WORDS, STEPS, dream_reply, ranked_reply, vanilla_reply
from dream.protocol import DREAM_V1, DREAM_V2, POOL_V1, SurveyProtocol

SIX = dict.fromkeys(STEPS, "Because.")
AHEAD = {"direction": "forward", "turn_deg": 0, "step_m": 2, "done": False}


@pytest.mark.parametrize("protocol", [DREAM_V1, POOL_V1], ids=lambda protocol: protocol.name)
def test_every_action_of_the_protocol_can_be_said_and_nothing_else(protocol: SurveyProtocol) -> None:
    Action = vanilla_reply(protocol)
    said = set()
    schema = Action.model_json_schema()["properties"]
    for turn in schema["turn_deg"]["enum"]:
        for step in schema["step_m"]["enum"]:
            for direction in ("forward",) if turn == 0 else ("left", "right"):
                fields = {"direction": direction, "turn_deg": turn, "step_m": step, "done": False}
                decision = Action.model_validate_json(json.dumps(fields)).decision
                said.add((round(math.remainder(decision.turn, 2.0 * math.pi), 6), decision.advance))
    turns = {round(math.remainder(turn, 2.0 * math.pi), 6) for turn in protocol.turn_angles}
    turns |= {-turn for turn in turns if abs(abs(turn) - math.pi) < 1e-5}
    assert said == {(turn, advance) for turn in turns for advance in (0.0, *protocol.advances)}


def test_in_space_an_action_has_every_climb_and_tilt_of_the_protocol_and_no_other() -> None:
    Action = vanilla_reply(DREAM_V2)
    schema = Action.model_json_schema()["properties"]
    assert schema["climb_m"]["enum"] == [-1, -0.5, 0, 0.5, 1]
    assert schema["tilt_deg"]["enum"] == [-25, 20, 45]
    for climb in schema["climb_m"]["enum"]:
        for tilt in schema["tilt_deg"]["enum"]:
            said = Action.model_validate({**AHEAD, "climb_m": climb, "tilt_deg": tilt}).decision
            assert said.climb == climb
            assert said.tilt is not None
            assert min(abs(said.tilt - allowed) for allowed in DREAM_V2.tilts) < 1e-6
    for wrong in ({"climb_m": 0.7, "tilt_deg": 20}, {"climb_m": 0, "tilt_deg": 30}, {"climb_m": 0}):
        with pytest.raises(ValidationError):
            Action.model_validate({**AHEAD, **wrong})
    done = Action.model_validate({**AHEAD, "climb_m": 1, "tilt_deg": 45, "done": True}).decision
    assert (done.climb, done.tilt) == (0.0, None)


def without_titles(schema: Any) -> Any:
    """The same without the names that pydantic makes up."""
    if isinstance(schema, dict):
        return {key: without_titles(value) for key, value in schema.items() if key != "title"}
    return schema


def test_the_documentation_shows_what_a_reply_must_be() -> None:
    page = Path(__file__).parents[3].joinpath("docs", "models.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"```json\n(.*?)```", page, re.DOTALL)
    assert json.loads(shown) == without_titles(vanilla_reply(DREAM_V1).model_json_schema())
    words = " ".join(page.split())
    reasons = [field for field in dream_reply(DREAM_V1).model_fields if field not in AHEAD]
    others = [field for field in ranked_reply([1, 2]).model_fields if field not in reasons]
    assert f"before these: {', '.join(f'`{field}`' for field in reasons)}, each at most 1,200" in words
    assert all(f"`{field}`" in page for field in others)
    assert MOST_WORDS == 1200


def test_left_is_left() -> None:
    Action = vanilla_reply(DREAM_V1)
    left = Action.model_validate({**AHEAD, "direction": "left", "turn_deg": 30}).decision
    assert left.turn == pytest.approx(math.radians(30.0))
    assert left.advance == 2.0
    right = Action.model_validate({**AHEAD, "direction": "right", "turn_deg": 30}).decision
    assert right.turn == pytest.approx(-math.radians(30.0))


def test_done_stays_where_it_is() -> None:
    decision = vanilla_reply(DREAM_V1).model_validate({**AHEAD, "done": True}).decision
    assert decision.done
    assert decision.stops


def test_the_six_steps_come_before_the_action_and_into_the_decision() -> None:
    Action = dream_reply(DREAM_V1)
    assert tuple(Action.model_fields)[:6] == STEPS
    decision = Action.model_validate({**SIX, **AHEAD, "safety": "Nothing near."}).decision
    assert decision.reasoning.safety == "Nothing near."
    assert decision.reasoning.distribution == "Because."


@pytest.mark.parametrize(
    "change",
    [
        {"turn_deg": 45},
        {"turn_deg": 30},
        {"direction": "left"},
        {"direction": "up"},
        {"step_m": 1.5},
        {"step_m": -1},
        {"step_m": 1e300},
        {"done": "perhaps"},
        {"thrust": 1},
        {"safety": "x" * (MOST_WORDS + 1)},
        {"action": None},
        {"turn_deg": None},
    ],
    ids=str,
)
def test_an_action_outside_the_protocol_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        dream_reply(DREAM_V1).model_validate({**SIX, **AHEAD, **change})


@pytest.mark.parametrize("text", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_numbers_that_are_none_are_refused(text: str) -> None:
    reply = json.dumps(AHEAD).replace('"step_m": 2', f'"step_m": {text}')
    with pytest.raises(ValidationError):
        vanilla_reply(DREAM_V1).model_validate_json(reply)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inside: st.lists(inside, max_size=4) | st.dictionaries(st.text(max_size=10), inside, max_size=4),
    max_leaves=10,
)


@given(st.dictionaries(st.sampled_from([*STEPS, *AHEAD, "other"]), JSON), st.booleans())
def test_whatever_is_said_it_is_an_action_of_the_protocol_or_refused(
    fields: dict[str, Any], complete: bool
) -> None:
    given = {**SIX, **AHEAD, **fields} if complete else fields
    try:
        decision = dream_reply(DREAM_V1).model_validate_json(json.dumps(given)).decision
    except ValidationError:
        return
    assert min(abs(math.remainder(decision.turn - t, 2 * math.pi)) for t in DREAM_V1.turn_angles) < 1e-9
    assert decision.advance in (0.0, *DREAM_V1.advances)


@given(st.sets(st.integers(1, 9), min_size=1), st.data())
def test_a_ranking_names_each_place_once(numbers: set[int], data: st.DataObject) -> None:
    Places = ranked_reply(sorted(numbers))
    rest: dict[str, Any] = {**SIX, "confidence": 0.5, "mission_complete": False}
    order = data.draw(st.permutations(sorted(numbers)))
    assert Places.model_validate({**rest, "ranking": order}).ranking == list(order)
    assert set(Places.model_json_schema()["properties"]["ranking"]["items"].get("enum", numbers)) == numbers
    for wrong in (order[:-1], [*order, order[0]], [0, *order[1:]], [10, *order[1:]]):
        with pytest.raises(ValidationError):
            Places.model_validate({**rest, "ranking": wrong})


@pytest.mark.parametrize("confidence", [-0.1, 1.1, float("nan"), "high"])
def test_confidence_is_a_share(confidence: Any) -> None:
    with pytest.raises(ValidationError):
        ranked_reply([1, 2]).model_validate(
            {**SIX, "ranking": [2, 1], "confidence": confidence, "mission_complete": False}
        )
