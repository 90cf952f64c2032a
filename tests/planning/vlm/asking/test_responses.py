"""An answer counts wherever a model puts it; one that was broken off or withheld does not."""

from __future__ import annotations

import json

import pytest

from tests.model_server import Response, says, serving
from tests.planning.vlm.asking.counting import SO, Number, ask, line

ELSEWHERE = {
    "reasoning_content": says("", beside={"reasoning_content": f"They are three. {SO}"}),
    "reasoning": says(None, beside={"reasoning": SO}),
    "blank text": says(" \n", beside={"reasoning_content": f"```json\n{SO}\n```"}),
    "inside tags": says(f"<think>{SO}</think>"),
    "after tags": says(f'<think>{{"why": "draft", "number": 9}}</think>{SO}'),
    "after a lone tag": says(f"thinking ... </think>\n{SO}"),
    "parts": says(None, beside={"content": [{"type": "text", "text": SO}]}),
    "a call of no tool": says(
        None,
        finish="tool_calls",
        beside={
            "tool_calls": [{"id": "1", "type": "function", "function": {"name": "Number", "arguments": SO}}]
        },
    ),
}


@pytest.mark.parametrize("reply", ELSEWHERE.values(), ids=ELSEWHERE)
def test_an_answer_counts_wherever_it_stands_and_costs_one_request(reply: Response) -> None:
    with serving(reply) as server:
        answer = ask(line(server))
        assert len(server.asked) == 1
    assert answer.reply == Number(why="so", number=3)
    assert answer.exchange.lacks == ("",)
    assert SO in answer.exchange.replies[0]


@pytest.mark.parametrize(
    "reply",
    [
        f"```json\n{SO}\n```",
        f"```\n{SO}\n```",
        f"Here you are:\n```json\n{SO}\n```\nDone.",
        f"```json\n{SO}\n```\nThat is {{all}}.",
        f"```json\n{SO}",
        f"\n {SO} ",
    ],
)
def test_a_fence_around_the_reply_is_taken_off_with_all_around_it(reply: str) -> None:
    with serving(says(reply)) as server:
        assert ask(line(server)).reply == Number(why="so", number=3)
        assert len(server.asked) == 1


def test_what_was_thought_does_not_answer_for_what_was_said() -> None:
    with serving(says("I cannot say.", beside={"reasoning_content": SO})) as server:
        answer = ask(line(server))
    assert answer.exchange.fallback == "invalid: no JSON object, asked twice"


def test_what_each_reply_lacked_is_in_the_exchange_and_the_model_is_told_it() -> None:
    wrong = says('Well: {"why": "so", "number": "many"}')
    with serving(wrong, says('{"why": "so", "thrust": 9}')) as server:
        exchange = ask(line(server)).exchange
        assert "valid integer" in json.dumps(server.asked[1].body["messages"])
    number, thrust = exchange.lacks
    assert number.startswith("number: Input should be a valid integer")
    assert thrust == "number: Field required; thrust: Extra inputs are not permitted"
    assert exchange.fallback == f"invalid: {thrust}, asked twice"
    assert exchange.expected == Number.model_json_schema()


@pytest.mark.parametrize(
    ("reply", "reason"),
    [
        (says(f"It may be {SO}, or rather", finish="length"), "truncated"),
        (says("", finish="length", beside={"reasoning_content": f"perhaps {SO}, or"}), "truncated"),
        (says('{"why": "so", "num', finish="length"), "truncated"),
        (says("As for the number", finish="content_filter"), "refused"),
        (says(None, finish="content_filter"), "refused"),
    ],
)
def test_a_reply_that_was_ended_is_told_at_once_and_what_it_took(reply: Response, reason: str) -> None:
    with serving(reply) as server:
        exchange = ask(line(server)).exchange
        assert len(server.asked) == 1
    assert exchange.fallback.startswith(f"{reason}: ")
    assert (exchange.tokens_in, exchange.tokens_out) == (100, 10)


def test_a_whole_answer_counts_though_the_reply_went_on_until_it_was_ended() -> None:
    with serving(says(SO + 400 * "\n", finish="length")) as server:
        assert ask(line(server)).reply == Number(why="so", number=3)
