"""Answers fit their schema and follow from the pictures; pictures that do not belong together are refused."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from dream.geometry import SE2, Bounds
from dream.orders import Leg, Side, SideOf, Task
from dream.planning.vlm.orders import orders_reply
from dream.planning.vlm.reply import dream_reply, ranked_reply, vanilla_reply
from dream.protocol import DREAM_V1
from dream.standin import sight
from dream.standin.rules import RULES, answer
from dream.standin.sight import UnreadableError
from dream.types import Target
from tests.mapping.analytic import AREA
from tests.standin.sheets import drawn, map_of, png, request, scene

REASONED = dream_reply(DREAM_V1)
PLAIN = vanilla_reply(DREAM_V1)
OCCUPANCY, SHOWN = scene()
TEXT = (
    "... a metre is 32 pixels ... The robot is at x = 0 m, y = 0 m and heads towards 0 degrees (east).\n"
    "3 steps are done; 197 are left at most."
)


def test_an_action_fits_its_schema_and_the_same_question_gets_the_same_answer() -> None:
    reasoned = answer(request(REASONED, SHOWN, TEXT))
    REASONED.model_validate(reasoned)
    plain = answer(request(PLAIN, SHOWN, TEXT))
    PLAIN.model_validate(plain)
    assert plain == {field: reasoned[field] for field in plain}
    assert not plain["done"]
    assert answer(request(REASONED, SHOWN, TEXT)) == reasoned
    assert "(0.0, 0.0)" in reasoned["target_area"]


def test_with_nothing_open_and_nowhere_to_hide_it_says_done() -> None:
    cells = np.full((96, 96), sight.EXPLORED, np.uint8)
    cells[40:44, 60:64] = sight.TARGET
    shown = SHOWN | {"map": png(drawn(map_of(cells, AREA), SE2(0.0, 0.0, 0.0)))}
    assert answer(request(PLAIN, shown, TEXT))["done"]


def test_it_keeps_off_what_is_black() -> None:
    cells = np.full((96, 96), sight.EXPLORED, np.uint8)
    cells[:, 54:56] = sight.SOLID
    cells[70:96, :40] = sight.UNKNOWN
    pose = SE2(0.0, 0.0, 0.0)
    said = answer(request(PLAIN, SHOWN | {"map": png(drawn(map_of(cells, AREA), pose))}, TEXT))
    turn = math.radians(said["turn_deg"]) * (-1.0 if said["direction"] == "right" else 1.0)
    assert said["step_m"] * math.cos(turn) < 1.0


@pytest.mark.parametrize("missing", ["camera", "depth", "labels", "map"])
def test_a_picture_that_is_missing_is_missed(missing: str) -> None:
    kept = {name: file for name, file in SHOWN.items() if name != missing}
    with pytest.raises(UnreadableError, match=rf"\[{missing}\]: expected a picture"):
        answer(request(REASONED, kept, TEXT))


@pytest.mark.parametrize(
    "one, other",
    [("camera", "labels"), ("camera", "depth"), ("depth", "labels"), ("labels", "map"), ("camera", "map")],
)
def test_pictures_that_are_swapped_are_noticed(one: str, other: str) -> None:
    swapped = SHOWN | {one: SHOWN[other], other: SHOWN[one]}
    with pytest.raises(UnreadableError):
        answer(request(REASONED, swapped, TEXT))


def test_a_depth_that_is_upside_down_is_noticed() -> None:
    depth = sight.decode(SHOWN["depth"], "depth")
    with pytest.raises(UnreadableError, match=r"\[depth\]"):
        answer(request(REASONED, SHOWN | {"depth": png(depth[::-1].copy())}, TEXT))


@pytest.mark.parametrize(
    "wrong, named",
    [
        (TEXT.replace("32 pixels", "20 pixels"), "pixels of a metre"),
        (TEXT.replace("x = 0", "x = 1.5"), "expected x 1.5"),
        (TEXT.replace("y = 0", "y = -2"), "expected y -2"),
        (TEXT.replace("0 degrees", "180 degrees"), "expected the heading 180"),
    ],
)
def test_a_map_that_does_not_fit_the_text_is_refused(wrong: str, named: str) -> None:
    with pytest.raises(UnreadableError, match=named):
        answer(request(REASONED, SHOWN, wrong))


def test_a_map_without_what_is_near_and_green_is_refused() -> None:
    cells = np.full((96, 96), sight.EXPLORED, np.uint8)
    shown = SHOWN | {"map": png(drawn(map_of(cells, AREA), SE2(0.0, 0.0, 0.0)))}
    labels = sight.decode(SHOWN["labels"], "labels").copy()
    depth = sight.decode(SHOWN["depth"], "depth")
    labels[(depth > 160) & (labels == sight.COLORS[sight.EXPLORED]).all(axis=-1)] = sight.COLORS[sight.TARGET]
    with pytest.raises(UnreadableError, match="near and green on both"):
        answer(request(REASONED, shown | {"labels": png(labels)}, TEXT))


# ------------------------------------------------------------------------------------------------- rankings


def ranked(places: dict[int, tuple[float, float]]) -> dict[str, bytes]:
    cells = np.full((96, 96), sight.UNKNOWN, np.uint8)
    cells[30:66, 20:80] = sight.EXPLORED
    cells[44:52, 70:80] = sight.TARGET
    return {"map": png(drawn(map_of(cells, AREA), SE2(0.0, 0.0, 0.0), places)), "camera": SHOWN["camera"]}


def test_green_beside_white_comes_first_then_white_then_what_is_known() -> None:
    shown = ranked({4: (0.0, 2.0), 2: (-4.5, 4.0), 7: (7.0, 0.0)})
    said = answer(request(ranked_reply([2, 4, 7]), shown))
    ranked_reply([2, 4, 7]).model_validate(said)
    assert said["ranking"] == [7, 2, 4]


def test_marks_other_than_those_asked_for_are_refused() -> None:
    shown = ranked({1: (0.0, 2.0), 2: (-4.5, 4.0)})
    for numbers in ([1, 2, 3], [1], [1, 3]):
        with pytest.raises(UnreadableError, match="expected the marks"):
            answer(request(ranked_reply(numbers), shown))


BOX = Bounds(-20.0, -20.0, 20.0, 20.0)
WEST = SideOf(Side.WEST)
SAID = {
    "map a box from x=-5 to 5 and y=0 to 10, slowly, after 3 pm, not deeper than 10 m": (
        [Leg(area=Bounds(-5.0, 0.0, 5.0, 10.0))],
        "slowly; after 3 pm; not deeper than 10 m",
    ),
    "map only the western half, at most 80 steps": ([Leg(area=WEST)], ""),
    "find the wreck, then map whatever is on its north side": (
        [Leg(Target.WRECK, Task.FIND), Leg(area=SideOf(Side.NORTH, 1))],
        "",
    ),
    "Find the wreck and map its north side": (
        [Leg(Target.WRECK, Task.FIND), Leg(area=SideOf(Side.NORTH, 1))],
        "",
    ),
    "map the oyster reefs in the south quickly": ([Leg(Target.OYSTERS, area=SideOf(Side.SOUTH))], "quickly"),
    "map the north and the west": ([Leg(area=SideOf(Side.NORTH))], "west"),
    "map the west; be careful": ([Leg(area=WEST)], "be careful"),
    "do not map the west": ([Leg(area=WEST)], "do not"),
    "hello": ([Leg()], "hello"),
    "map all" + " or not" * 200: ([Leg()], None),
}


@pytest.mark.parametrize(("words", "legs", "left_out"), [(said, *meant) for said, meant in SAID.items()])
def test_what_of_an_operators_words_is_no_phrase_that_it_knows_is_said_to_be_left_out(
    words: str, legs: list[Leg], left_out: str | None
) -> None:
    schema = orders_reply(BOX)
    said = answer(request(schema, {}, f"The operator says, in JSON:\n{json.dumps(words)}"))
    understood = schema.model_validate(said)
    assert list(understood.orders.legs) == legs
    assert understood.orders.max_steps == (80 if "80" in words else None)
    assert understood.left_out == left_out or (left_out is None and understood.left_out.endswith(" ..."))


def test_a_schema_without_a_rule_is_refused_with_those_there_are() -> None:
    class Riddle(PLAIN):  # type: ignore[misc, valid-type]
        pass

    with pytest.raises(ValueError, match='no rule for the schema "Riddle"'):
        answer(request(Riddle, SHOWN))
    assert set(RULES) == {"ReasonedAction", "Action", "RankedPlaces", "Choice", "Orders"}
