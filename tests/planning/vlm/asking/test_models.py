"""A server at an address may send anything with status 200: it is an answer, or an error."""

from __future__ import annotations

from typing import Any

import pytest

from tests.model_server import SECRET, says, serving
from tests.planning.vlm.asking.counting import SO, Number, ask, body, line


@pytest.mark.parametrize(
    "usage",
    [
        None,
        {},
        "lots",
        [100, 10],
        {"prompt_tokens": None, "completion_tokens": None, "total_tokens": None},
        {"prompt_tokens": 100, "completion_tokens": -10, "total_tokens": 90},
        {"prompt_tokens": 10**30, "completion_tokens": 10, "total_tokens": 10**30},
        {"prompt_tokens": -1e300, "completion_tokens": "x", "total_tokens": None},
        {"prompt_tokens": float("nan"), "completion_tokens": float("inf"), "total_tokens": 0},
        {"prompt_tokens": 9, "completion_tokens": 1, "total_tokens": 10, "prompt_tokens_details": "many"},
        {
            "prompt_tokens": 9,
            "completion_tokens": 1,
            "total_tokens": 10,
            "prompt_tokens_details": {"cached_tokens": -5},
        },
    ],
    ids=repr,
)
def test_tokens_that_cannot_be_cost_no_good_answer(usage: Any) -> None:
    # The model is one whose price is known, elsewhere.
    with serving(says(SO, usage=usage, model="gpt-5")) as server:
        answer = ask(line(server))
    assert answer.reply == Number(why="so", number=3)
    exchange = answer.exchange
    assert (exchange.fallback, exchange.requests) == ("", 1)
    assert (exchange.tokens_in, exchange.tokens_out, exchange.cost_usd) == (0, 0, None)


def test_what_a_server_counts_beside_tokens_is_its_own_affair() -> None:
    usage = {"prompt_tokens": 100, "completion_tokens": 10, "total_tokens": 110, "nanoseconds": 10**12}
    with serving(says(SO, usage={**usage, "prompt_tokens_details": None})) as server:
        answer = ask(line(server))
    assert (answer.exchange.tokens_in, answer.exchange.tokens_out) == (100, 10)


WITHIN = {
    "a gateway's": (
        {"error": {"code": 502, "message": "Upstream went away"}, "id": "1"},
        "server: HTTP 200 with an error 502: Upstream went away",
    ),
    "an address": (
        {"error": "Unexpected endpoint or method. (POST /chat/completions)"},
        "denied: HTTP 200 with an error: Unexpected endpoint or method. (POST /chat/completions)",
    ),
    "the older way": (
        {"object": "error", "message": "This model is not a multimodal model", "code": 40303},
        "rejected: HTTP 200 with an error: This model is not a multimodal model",
    ),
    "in a choice": (
        {"choices": [{"index": 0, "error": {"code": 400, "message": "No images, please"}}]},
        "rejected: HTTP 200 with an error 400: No images, please",
    ),
    "by name": (
        {"error": {"message": "Slow down", "type": "rate_limit_error"}},
        "rate limit: the server asks to wait",
    ),
    "nothing left": (
        {"error": {"message": "Empty", "code": "insufficient_quota"}},
        "quota: nothing is left to spend there",
    ),
    "a key": ({"error": {"message": SECRET, "code": 401}}, "denied: HTTP 200 with an error 401"),
    "no choice": (
        {"id": "1", "object": "chat.completion", "choices": []},
        "server: what it sent holds no reply",
    ),
    "null": ({"id": "1", "choices": None, "error": None}, "server: what it sent holds no reply"),
}


@pytest.mark.parametrize(("sent", "reason"), WITHIN.values(), ids=WITHIN)
def test_an_error_that_comes_with_status_200_is_one(sent: Any, reason: str) -> None:
    with serving(body(sent)) as server:
        answer = ask(line(server))
        # It is as much a reply as an answer, and may cost as much.
        assert len(server.asked) == 1
    assert answer.exchange.fallback == reason
    assert answer.reply is None


def test_an_error_beside_an_answer_costs_no_answer() -> None:
    with serving(says(SO, error={"code": 500, "message": "logging failed"})) as server:
        assert ask(line(server)).reply is not None
