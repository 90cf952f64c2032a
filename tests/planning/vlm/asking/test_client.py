"""A question is asked in the strictest form that the server takes, and again where that may help."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from dream.geometry import Bounds
from dream.planning.vlm.asking import client
from dream.planning.vlm.asking.models import RequestForm
from dream.planning.vlm.asking.question import BESIDE, THINKING, TOKEN
from dream.planning.vlm.orders import orders_reply
from dream.planning.vlm.reply import choice_reply, dream_reply, ranked_reply, vanilla_reply
from dream.protocol import DREAM_V1
from tests.model_server import Request, Response, error, says, serving
from tests.planning.vlm.asking.counting import GOOD, SO, WRONG, Number, ask, body, line, question


def test_the_server_gets_instructions_pictures_text_and_the_schema() -> None:
    with serving(GOOD) as server:
        ask(line(server))
        (request,) = server.asked
    body = request.body
    assert body["model"] == "scripted"
    assert body["response_format"]["json_schema"]["strict"]
    assert body["response_format"]["json_schema"]["name"] == "Number"
    system, user = body["messages"]
    assert system["content"] == "Count."
    kinds = [part["type"] for part in user["content"]]
    assert kinds == ["text", "image_url", "text", "image_url", "text"]
    assert user["content"][0]["text"] == "[map]"
    assert user["content"][-1]["text"] == "How many?"


def test_the_temperature_is_sent_where_one_is_given_and_another_one_is_another_question(
    tmp_path: Path,
) -> None:
    with serving(GOOD) as server:
        for temperature in (None, 0.0, 0.7):
            ask(line(server, temperature=temperature, record=str(tmp_path)))
        assert [request.body.get("temperature") for request in server.asked] == [None, 0.0, 0.7]
    assert len(list(tmp_path.glob("*.json"))) == 3


def test_a_reply_that_does_not_fit_is_asked_again_once_with_what_is_wrong() -> None:
    with serving(WRONG, GOOD) as server:
        answer = ask(line(server))
        again = json.dumps(server.asked[1].body["messages"])
    assert answer.reply == Number(why="so", number=3)
    assert answer.exchange.requests == 2
    assert len(answer.exchange.replies) == 2
    assert answer.exchange.tokens_in == 200
    assert "valid integer" in again


def test_a_busy_server_is_tried_again_a_few_times() -> None:
    with serving(error(429, retry_after="0"), error(503, retry_after="0"), GOOD) as server:
        answer = ask(line(server))
    assert answer.reply is not None
    assert len(server.asked) == client.MOST_TRIES


def test_a_server_without_schemas_is_told_in_words() -> None:
    with serving(error(400), GOOD) as server:
        on = line(server)
        assert ask(on).reply is not None
        assert ask(on).reply is not None
    formats = [request.body["response_format"]["type"] for request in server.asked]
    assert formats == ["json_schema", "json_object", "json_object"]
    assert '"number"' in json.dumps(server.asked[1].body["messages"]).replace("\\", "")


def takes(*formats: str | None) -> Callable[[Request], Response]:
    """A server that takes requests with these formats only."""

    def answer(request: Request) -> Response:
        asked = request.body.get("response_format", {}).get("type")
        return GOOD if asked in formats else error(400)

    return answer


@pytest.mark.parametrize("format_taken", ["json_object", None])
def test_a_server_that_takes_another_form_answers_all_that_it_is_asked_at_once(
    format_taken: str | None,
) -> None:
    with serving(takes(format_taken)) as server:
        on = line(server)
        pending = [on.ask(question(str(k))) for k in range(8)]
        assert [one.answer().exchange.fallback for one in pending] == 8 * [""]
        begun = len(server.asked)
        assert ask(on, "later").reply is not None
        assert len(server.asked) == begun + 1  # It is known by now what it takes.


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (500, "response_format json_schema is not supported by this backend"),
        (400, "failed to parse grammar"),
        (501, "not implemented: structured outputs"),
        (200, "guided decoding is unsupported here"),
    ],
)
def test_a_schema_that_will_never_be_taken_is_left_out_without_waiting(status: int, words: str) -> None:
    def answer(request: Request) -> Response:
        if "json_schema" in request.body.get("response_format", {}):
            return body({"error": {"message": words}}, status)
        return GOOD

    with serving(answer) as server:
        on = line(server)
        assert ask(on).reply is not None
        first = len(server.asked)
        assert first <= 3
        assert ask(on).reply is not None
        assert len(server.asked) == first + 1


@pytest.mark.parametrize(
    ("reply", "most"),
    [
        (vanilla_reply(DREAM_V1), 17_408),
        (dream_reply(DREAM_V1), 21_008),
        (ranked_reply([1, 2, 3]), 21_008),
        (choice_reply(["left", "right"]), 18_008),
        (orders_reply(Bounds(0.0, 0.0, 9.0, 9.0)), 17_708),
    ],
)
def test_every_request_says_how_long_its_reply_may_be(reply: type[BaseModel], most: int) -> None:
    with serving(says("{}")) as server:
        ask(line(server), reply=reply)
        assert [request.body["max_tokens"] for request in server.asked] == [most, most]
        assert "max_completion_tokens" not in server.asked[0].body


def bound_by(name: str, words: str) -> Callable[[Request], Response]:
    """A server that takes no bound on a reply but of that name, or none at all, and says so."""

    def answer(request: Request) -> Response:
        sent = {key for key in request.body if key.startswith("max_")}
        return GOOD if sent == ({name} if name else set()) else error(400, words)

    return answer


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (
            "max_completion_tokens",
            "Unsupported parameter: 'max_tokens' is not supported with this model. Use "
            "'max_completion_tokens' instead.",
        ),
        (
            "",
            "This model's maximum context length is 8192 tokens. However, you requested 20000 tokens (3000 "
            "in the messages, 17000 in the completion)",
        ),
        ("", "'max_tokens' or 'max_completion_tokens' is too large: 17408"),
        ("", "max_tokens: 17408 > 8192, which is the maximum allowed number of output tokens"),
    ],
)
def test_a_bound_that_a_server_does_not_take_is_renamed_or_left_out_and_the_schema_stays(
    name: str, words: str
) -> None:
    with serving(bound_by(name, words)) as server:
        on = line(server)
        assert ask(on).reply is not None
        assert ask(on).reply is not None
        assert len(server.asked) == 3
        assert all(request.schema for request in server.asked)


def test_limits_on_lengths_reach_a_server_as_schema() -> None:
    with serving(says("{}")) as server:
        ask(line(server), reply=dream_reply(DREAM_V1))
        ask(line(server), reply=ranked_reply([4, 5, 6]))
        action, ranking = (server.asked[k].schema["properties"] for k in (0, 2))
    # Of 2000 repetitions on, llama.cpp takes no grammar (llama.cpp issue 27087).
    assert [action[step]["maxLength"] for step in ("distribution", "safety", "action")] == 3 * [1200]
    assert "description" not in action["safety"]
    assert (ranking["ranking"]["minItems"], ranking["ranking"]["maxItems"]) == (3, 3)


@pytest.mark.parametrize(
    "words",
    [
        "Invalid schema for response_format: In context=('properties', 'why'), 'maxLength' is not permitted.",
        "number of repetitions exceeds sane defaults, please reduce the number of repetitions",
        "unsupported keyword in schema",
    ],
)
def test_a_server_that_takes_no_limits_in_schemas_is_asked_with_the_schema_without_them(words: str) -> None:
    def answer(request: Request) -> Response:
        return error(400, words) if "maxLength" in request.schema["properties"]["why"] else GOOD

    with serving(answer) as server:
        assert ask(line(server)).reply is not None
        first, second = server.asked
    assert "maxLength" in first.schema["properties"]["why"]
    assert "maxLength=20" in second.schema["properties"]["why"]["description"]


def test_the_makers_own_models_get_a_bound_too() -> None:
    from pydantic_ai.messages import ModelResponse, TextPart
    from pydantic_ai.models.function import AgentInfo, FunctionModel

    asked: list[Any] = []

    def answer(messages: list[Any], info: AgentInfo) -> ModelResponse:
        asked.append(info.model_settings)
        return ModelResponse(parts=[TextPart(f"So: {SO}")])

    with serving(GOOD) as server:
        on = line(server)
        assert on._client is not None
        on._client.forms = (RequestForm(FunctionModel(answer), schema=False),)
        assert ask(on).reply == Number(why="so", number=3)
    assert asked[0]["max_tokens"] == THINKING + BESIDE + 20 // TOKEN
