"""What a server sends instead of an answer: told in its own words, and tried again only where it may pass."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from typing import Any

import pytest
from pydantic import BaseModel

from dream.geometry import Bounds
from dream.planning.vlm import asking, server_words
from dream.planning.vlm.asking import Answer, Line, Question
from dream.planning.vlm.orders import orders_reply
from dream.planning.vlm.reply import choice_reply, dream_reply, ranked_reply, vanilla_reply
from dream.protocol import DREAM_V1
from tests.model_server import SECRET, Request, Response, error, says, serving
from tests.planning.vlm.counting import GOOD, SO, Number, line

BLIND = "image input is not supported - hint: if this is unexpected, you may need to provide the mmproj"


def ask(on: Line, reply: type[BaseModel] = Number) -> Answer[Any]:
    return on.ask(Question("test 1", "Count.", "How many?", {"map": b"a picture"}, reply)).answer()


def body(content: Any, status: int = 200) -> Response:
    return Response(json.dumps(content).encode(), status, {"retry-after": "0"})


# --------------------------------------------------------------------------------------- where answers stand

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


def test_what_was_thought_does_not_answer_for_what_was_said() -> None:
    with serving(says("I cannot say.", beside={"reasoning_content": SO})) as server:
        answer = ask(line(server))
    assert answer.exchange.fallback == "invalid: no JSON object, asked twice"


def test_a_reply_as_it_came_is_kept_and_answers_again_without_a_model(tmp_path: Any) -> None:
    thought = f"First two,\nthen one more. </think> {SO} So much for that."
    with serving(says(thought)) as server:
        first = ask(line(server, record=str(tmp_path)))
        again = ask(line(server, replay_replies=str(tmp_path)))
        assert len(server.asked) == 1
    assert first.exchange.replies == again.exchange.replies == (thought,)
    assert first.reply == again.reply == Number(why="so", number=3)


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


# ------------------------------------------------------------------------------------- errors of all statuses

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


NEVER = {
    "llama.cpp": (500, BLIND, "rejected", "Does the model take pictures"),
    "Ollama": (500, "this model is missing data required for image input", "rejected", "take pictures"),
    "a router": (503, "No endpoints found: vision is not supported by this model", "rejected", "pictures"),
    "switched off": (500, "Image input is disabled", "rejected", "take pictures"),
    "not switched on": (500, "vision was not enabled when this server started", "rejected", "take pictures"),
    "a part": (500, "unsupported content[].type", "rejected", "take pictures"),
    "a count": (500, "At most 0 image(s) may be provided in one prompt", "rejected", "take pictures"),
    "not yet": (500, "Multimodal input is not supported yet", "rejected", "take pictures"),
    "a context": (
        500,
        "the request exceeds the available context size (4096)",
        "rejected",
        "Does its context",
    ),
    "a prompt": (502, "prompt is too long", "rejected", "Does its context hold"),
    "a model": (
        500,
        "model 'scripted' not found, try pulling it first",
        "denied",
        "have a model of that name",
    ),
}


@pytest.mark.parametrize(("status", "words", "kind", "advice"), NEVER.values(), ids=NEVER)
def test_what_will_never_be_taken_ends_at_the_first_answer_whatever_its_status(
    status: int, words: str, kind: str, advice: str
) -> None:
    with serving(error(status, words)) as server:
        on = line(server)
        answer = ask(on)
        tried = len(server.asked)
        assert answer.exchange.fallback.startswith(f"{kind}: HTTP {status}: {words}")
        assert SECRET not in answer.exchange.fallback
        with pytest.raises(ValueError, match=advice):
            on.insist(answer)
    # What a context has no room for may be the bound on the reply alone.
    assert tried == (2 if "context" in advice else 1)


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (500, "Something went wrong"),
        (503, "Loading model"),
        (500, "The image could not be decoded in time, try again: the vision encoder is not available"),
        (502, "<html>model not found: no images</html>"),
        (529, "The model is overloaded"),
        (503, "Vision is currently not available for this model"),
        (500, "CUDA error: unable to allocate buffer for image embedding"),
        (500, "vision encoder crashed (cannot allocate memory)"),
        (500, "image could not be fetched, cannot connect"),
        (500, "image slice failed: not found in cache"),
        (500, "context size exceeded while other requests are running"),
        (503, "no model loaded yet"),
        (500, "cannot process image: unknown error"),
        (500, "failed to encode the picture, unable to go on"),
        (502, "vision worker not found"),
        (500, "image decoder: too many open files"),
        (500, "a tensor of the multimodal projector is missing"),
        (500, "the model does not exist: the connection to the store was reset"),
    ],
)
def test_what_may_pass_is_tried_again(status: int, words: str) -> None:
    with serving(error(status, words, retry_after_ms="1"), GOOD) as server:
        assert ask(line(server)).reply is not None
        first, second = server.asked
    assert first.body == second.body


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


def test_words_of_a_server_are_short_and_plain_wherever_they_stand() -> None:
    hostile = f"\x1b]0;mine\x07 image input is not supported {SECRET} " + 10_000 * "y "
    for sent in (
        {"error": {"message": hostile}},
        {"detail": [{"msg": hostile}]},
        hostile,
        {"error": hostile},
    ):
        with serving(body(sent, 500)) as server:
            told = ask(line(server)).exchange.fallback
            assert len(server.asked) == 1
        assert told.startswith(r"rejected: HTTP 500: \x1b]0;mine\x07 image input is not supported ... y y")
        assert told.isprintable()
        assert len(told) < server_words.MOST_SAID + 50
        assert SECRET not in told


# ------------------------------------------------------------------------------------------------- limits


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
        ask(line(server), reply)
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
        ask(line(server), dream_reply(DREAM_V1))
        ask(line(server), ranked_reply([4, 5, 6]))
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
        on._forms = (asking._Form(FunctionModel(answer), schema=False),)
        assert ask(on).reply == Number(why="so", number=3)
    assert asked[0]["max_tokens"] == asking.THINKING + asking.BESIDE + 20 // asking.TOKEN


# --------------------------------------------------------------------------------------------------- fuzz

ODD: tuple[Any, ...] = (
    None,
    0,
    -1,
    10**30,
    True,
    "",
    "x",
    "\x1b[2J",
    SECRET,
    [],
    {},
    [[]],
    {"a": {"b": []}},
    [None],
    {"code": 500},
)
REASONS = {
    "invalid",
    "truncated",
    "refused",
    "server",
    "rejected",
    "denied",
    "quota",
    "rate limit",
    "connection",
}


def spoilt(tree: Any, dice: random.Random) -> Any:
    """The same with something odd, or nothing, in the place of a part."""
    if dice.random() < 0.2 or not tree or not isinstance(tree, dict | list):
        return dice.choice(ODD)
    if isinstance(tree, list):
        k = dice.randrange(len(tree))
        return [*tree[:k], spoilt(tree[k], dice), *tree[k + 1 :]]
    name = dice.choice(list(tree))
    if dice.random() < 0.15:
        return {other: part for other, part in tree.items() if other != name}
    return {**tree, name: spoilt(tree[name], dice)}


def test_whatever_a_server_sends_is_an_answer_or_has_a_named_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(asking.KEY, SECRET)
    dice = random.Random(39)
    whole = {**json.loads(GOOD.body), "error": {"message": f"{BLIND} {SECRET}", "type": "error", "code": 500}}
    del whole["usage"]

    def answer(request: Request) -> Response:
        sent = {name: part for name, part in whole.items() if name != "error" or dice.random() < 0.5}
        if dice.random() < 0.3:
            del sent["choices"]
        for _ in range(dice.randint(0, 2)):
            sent = spoilt(sent, dice)
        status = dice.choice((200, 200, 200, 404))
        return Response(json.dumps(sent).encode(), status, {"retry-after-ms": "1"})

    with serving(answer) as server:
        on = line(server)
        counted = [ask(on) for _ in range(24)]
    reasons = {answer.exchange.fallback.partition(":")[0] for answer in counted}
    assert reasons <= {"", *REASONS}
    assert {"", "denied", "rejected", "server"} <= reasons
    for each in counted:
        assert (each.reply is None) == (each.exchange.fallback != "")
        assert each.exchange.fallback.isprintable()
        assert len(each.exchange.fallback) < 400
        assert SECRET not in repr(each)
