from __future__ import annotations

import asyncio
import gzip
import importlib.util
import json
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2
import pytest

from dream.planning.vlm import asking, cassette, server_words
from dream.planning.vlm.asking import Answer, Asking, Line, Question
from dream.types import Asked
from tests.model_server import SECRET, Request, Response, error, says, serving
from tests.planning.vlm.counting import GOOD, SO, Number, line

WRONG = says('{"why": "so", "number": "many"}')


def question(words: str = "How many?") -> Question[Number]:
    return Question("test 1", "Count.", words, {"map": b"a picture", "camera": b"another"}, Number)


def ask(on: Line, words: str = "How many?") -> Answer[Number]:
    return on.ask(question(words)).answer()


def test_a_reply_that_fits_is_the_answer_and_all_of_the_exchange_is_kept() -> None:
    with serving(GOOD) as server:
        answer = ask(line(server))
    assert answer.reply == Number(why="so", number=3)
    exchange = answer.exchange
    assert (exchange.fallback, exchange.requests) == ("", 1)
    assert (exchange.tokens_in, exchange.tokens_out, exchange.cost_usd) == (100, 10, None)
    assert exchange.replies == ('{"why": "so", "number": 3}',)
    assert "Count." in exchange.question
    assert "[map]\n[camera]" in exchange.question
    assert exchange.pictures == {"map": b"a picture", "camera": b"another"}
    assert exchange.model == f"scripted at {server.address}"


def test_who_the_server_says_answered_is_kept_in_one_line_and_without_a_key(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(asking.KEY, SECRET)
    with serving(says(SO, model=f"scripted-2026\n{SECRET}" + 300 * "x")) as server:
        exchange = ask(line(server, record=str(tmp_path))).exchange
        assert exchange.answered_by.startswith("scripted-2026 [key]xxx")
        assert len(exchange.answered_by) == server_words.MOST_SAID
        # A kept one says so too, and one kept before this was asked for still answers.
        again = line(server, replay_replies=str(tmp_path))
        assert ask(again).exchange.answered_by == exchange.answered_by
        (path,) = tmp_path.glob("*.json")
        kept = json.loads(path.read_text())
        del kept["answered_by"]
        path.write_text(json.dumps(kept))
        assert ask(line(server, replay_replies=str(tmp_path))).exchange.answered_by == ""
    assert len(server.asked) == 1


@pytest.mark.parametrize(
    ("model", "variable"),
    [
        ("openai:gpt-5", "OPENAI_BASE_URL"),
        ("anthropic:claude-sonnet-4-6", "ANTHROPIC_BASE_URL"),
        ("google:gemini-3.5-flash-lite", "GOOGLE_GEMINI_BASE_URL"),
    ],
)
def test_a_maker_whose_address_is_another_is_not_asked_under_its_name(
    model: str, variable: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(asking.OFFLINE)
    for key in ("OPENAI_API_KEY", "ANTHROPIC_API_KEY", "GOOGLE_API_KEY"):
        monkeypatch.setenv(key, SECRET)
    Asking(model=model).line()
    monkeypatch.setenv(variable, "http://127.0.0.1:1/v1")
    with pytest.raises(
        ValueError, match=f"model: expected {model} to be asked at its maker's, got {variable}"
    ):
        Asking(model=model).line()


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


@pytest.mark.parametrize(
    ("reply", "reason", "requests"),
    [
        (WRONG, "invalid", 2),
        (says("no JSON at all"), "invalid", 2),
        (says('{"why": "' + 21 * "x" + '", "number": 3}'), "invalid", 2),
        (says('{"why": "so", "number": 3, "thrust": 9}'), "invalid", 2),
        (says('{"why": "so", "num'), "invalid", 2),
        (says(None, refusal="I would rather not."), "refused", 1),
        (says("", finish="content_filter"), "refused", 1),
        (error(429, retry_after="0"), "rate limit", 1),
        (error(500, retry_after="0"), "server: HTTP 500", 1),
        (Response(b"<html>not a reply</html>"), "server", 1),
        (replace(GOOD, breaks=True), "connection: it broke", 1),
        (Response(b'"' + 10_000_000 * b"x" + b'"'), "too large", 1),
        (Response(gzip.compress(10_000_000 * b" "), headers={"Content-Encoding": "gzip"}), "too large", 1),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_no_answer_becomes_a_named_fallback(reply: Response, reason: str, requests: int) -> None:
    with serving(reply) as server:
        answer = ask(line(server))
    assert answer.reply is None
    assert answer.exchange.fallback.startswith(reason)
    assert answer.exchange.requests == requests
    assert SECRET not in repr(answer.exchange)


@pytest.mark.parametrize(
    "reply",
    [
        says(SO, choices=[]),
        says(SO, choices="ab"),
        says(SO, choices=[None]),
        says(SO, model=""),
        Response(b"[" * 900_000),
        Response(b""),
        Response(b"null"),
    ],
)
def test_nothing_that_a_server_sends_ends_a_mission(reply: Response) -> None:
    with serving(GOOD, reply) as server:
        on = line(server)
        assert ask(on).reply is not None
        answer = ask(on)
    assert answer.reply is not None or ":" in answer.exchange.fallback


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


def test_a_key_that_a_server_repeats_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(asking.KEY, SECRET)
    with serving(says(json.dumps({"why": SECRET, "number": 3}))) as server:
        answer = ask(line(server, record=str(tmp_path)))
    assert answer.reply == Number(why="[key]", number=3)
    assert SECRET not in repr(answer.exchange)
    assert all(SECRET.encode() not in path.read_bytes() for path in tmp_path.glob("*.json"))


@pytest.mark.parametrize(
    "spell",
    [
        lambda key: "".join(f"\\u{ord(c):04x}" for c in key),
        lambda key: "".join(f"\\u{ord(c):04X}" if k % 2 else c for k, c in enumerate(key)),
        lambda key: key.replace("/", "\\/"),
    ],
    ids=["all of it", "half of it", "slashes"],
)
def test_a_key_that_is_spelt_otherwise_is_not_kept_either(
    spell: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = "sk/0a.b"
    monkeypatch.setenv(asking.KEY, key + "-1")
    with serving(says(f'{{"why": "{spell(key + "-1")}", "number": 3}}')) as server:
        answer = ask(line(server, record=str(tmp_path)))
    assert answer.reply == Number(why="[key]", number=3)
    assert answer.exchange.replies == ('{"why": "[key]", "number": 3}',)
    assert all(key not in path.read_text() for path in tmp_path.glob("*.json"))


def test_an_address_gets_nothing_that_is_meant_for_openai(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_ORG_ID", SECRET)
    monkeypatch.setenv("OPENAI_PROJECT_ID", SECRET)
    monkeypatch.setenv("OPENAI_CUSTOM_HEADERS", f"X-Api-Key: {SECRET}")
    with serving(GOOD) as server:
        assert ask(line(server)).reply is not None
        assert SECRET not in repr(server.asked)


def test_the_budget_holds_when_replies_are_played_again(tmp_path: Path) -> None:
    with serving(GOOD) as server:
        on = line(server, max_calls=2, record=str(tmp_path))
        first = [ask(on, str(k)).exchange.fallback for k in range(4)]
        options: dict[str, Any] = {"model": server.address, "model_name": "scripted", "max_calls": 2}
    played = Asking(**options, replay_replies=str(tmp_path)).line()
    assert [ask(played, str(k)).exchange.fallback for k in range(4)] == first


def test_a_call_that_is_left_over_is_not_exceeded_by_asking_again() -> None:
    with serving(WRONG, GOOD) as server:
        answer = ask(line(server, max_calls=1))
    assert len(server.asked) == 1
    assert answer.exchange.fallback == "budget: no call is left to ask again"


def test_folders_are_looked_at_before_anything_is_asked(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(OSError, match="--record: expected a folder that can be written"):
        Asking(model="http://127.0.0.1:1/v1", model_name="x", record=str(file)).line()
    with pytest.raises(ValueError, match="replay_replies: expected a folder of kept replies"):
        Asking(model="http://127.0.0.1:1/v1", model_name="x", replay_replies=str(tmp_path / "no")).line()


def test_a_busy_server_is_tried_again_a_few_times() -> None:
    with serving(error(429, retry_after="0"), error(503, retry_after="0"), GOOD) as server:
        answer = ask(line(server))
    assert answer.reply is not None
    assert len(server.asked) == asking.MOST_TRIES


def test_a_slow_server_is_not_waited_for() -> None:
    with serving(replace(GOOD, late=3.0)) as server:
        answer = ask(line(server, timeout=0.3))
    assert answer.exchange.fallback == "timeout: no answer within 0.3 s"
    assert answer.exchange.seconds < 2.0


def test_a_server_that_asks_to_wait_longer_than_there_is_time_is_no_slow_one() -> None:
    with serving(error(429, retry_after="30"), GOOD) as server:
        on = line(server, timeout=3.0)
        assert ask(on).exchange.fallback == "rate limit: the server asks to wait, and 3 s were over first"
        assert ask(on).reply is not None


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


def test_what_a_server_finds_wrong_with_a_request_is_told_in_one_short_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(asking.KEY, "secret words")
    said = f"At most 1 image(s)\x1b[31m may be\nprovided, secret words or {SECRET}. " + 400 * "x "
    for body in ({"error": {"message": said}}, {"message": said}, {"detail": said}, {"error": said}):
        with serving(Response(json.dumps(body).encode(), 422)) as server:
            on = line(server)
            answer = ask(on)
            fallback = answer.exchange.fallback
            with pytest.raises(ValueError, match=r"got rejected.* Does the model take pictures"):
                on.insist(answer)
        told = r"rejected: HTTP 422: At most 1 image(s)\x1b[31m may be provided, [key] or ... x x "
        assert fallback.startswith(told)
        assert len(fallback) < 250
        assert SECRET not in fallback


def test_who_has_nothing_left_to_spend_is_told_so_before_the_first_answer() -> None:
    empty = Response(json.dumps({"error": {"message": "empty", "code": "insufficient_quota"}}).encode(), 429)
    with serving(empty) as server:
        on = line(server)
        with pytest.raises(ValueError, match=r"got quota: nothing is left to spend there\. Is there a plan"):
            on.insist(ask(on))


def test_a_model_that_cannot_be_asked_at_all_is_an_error_of_the_operator() -> None:
    with serving(error(401), GOOD, error(401)) as server:
        on = line(server)
        denied = ask(on)
        assert denied.exchange.fallback == "denied: HTTP 401"
        with pytest.raises(
            ValueError, match=r"model: expected scripted at .* to answer, got denied: HTTP 401"
        ):
            on.insist(denied)
        assert on.insist(ask(on)).reply is not None
        assert on.insist(ask(on)).exchange.fallback == "denied: HTTP 401"


def test_nobody_at_the_address_is_an_error_of_the_operator_before_the_first_answer_only() -> None:
    with serving(replace(GOOD, headers={"Connection": "close"})) as server:
        began, known = line(server), line(server)
        ask(known)
    where = server.address.removeprefix("http://").removesuffix("/v1")
    silent = ask(began)
    assert silent.exchange.fallback == f"connection: nothing answers at {where}"
    with pytest.raises(ValueError, match=rf"got connection: nothing answers at {where}\. Is the server runn"):
        began.insist(silent)
    assert known.insist(ask(known)).exchange.fallback == silent.exchange.fallback
    later = Asking(**server.options, timeout=5.0).line(Asked(calls=1))
    assert later.insist(ask(later)).exchange.fallback == silent.exchange.fallback


@pytest.mark.parametrize(
    ("path", "status", "advice"),
    [
        ("", 404, r"Is the address whole\? Most end in /v1: http://127.0.0.1:\d+/v1$"),
        ("/v1", 404, r"Does the server have a model of that name\?$"),
        ("/v1/", 404, r"Does the server have a model of that name\?$"),
        ("/v1", 403, r"Is its name right, and its key in the environment, as DREAM_API_KEY\?$"),
    ],
)
def test_who_is_denied_is_told_what_to_look_at(path: str, status: int, advice: str) -> None:
    with serving(error(status)) as server:
        on = line(server, model=server.address.removesuffix("/v1") + path)
        with pytest.raises(ValueError, match=advice):
            on.insist(ask(on))


def test_only_the_key_for_such_servers_is_sent_to_an_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", SECRET)
    with serving(GOOD) as server:
        ask(line(server))
        monkeypatch.setenv(asking.KEY, "mine")
        ask(line(server))
    assert [request.key for request in server.asked] == ["Bearer none", "Bearer mine"]


def test_threads_that_ask_at_once_share_a_loop_and_a_client(monkeypatch: pytest.MonkeyPatch) -> None:
    def slowly(make: Callable[..., Any]) -> Callable[..., Any]:
        def made(*args: Any, **options: Any) -> Any:
            time.sleep(0.05)
            return make(*args, **options)

        return made

    monkeypatch.setattr(asyncio, "new_event_loop", slowly(asyncio.new_event_loop))
    monkeypatch.setattr(httpx2, "AsyncClient", slowly(httpx2.AsyncClient))
    spec = importlib.util.find_spec(asking.__name__)
    assert spec is not None
    assert spec.loader is not None
    fresh = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fresh)
    with ThreadPoolExecutor(4) as threads:
        assert len(set(threads.map(lambda _: fresh._loop(), range(4)))) == 1
        assert len(set(threads.map(lambda _: fresh._http(address=True, near=True), range(4)))) == 1
    assert fresh._http(address=True, near=False) is not fresh._http(address=True, near=True)


# ------------------------------------------------------------------------------------------------ limits


def test_the_budget_of_calls_ends_the_asking() -> None:
    with serving(GOOD) as server:
        on = line(server, max_calls=2)
        kinds = [ask(on).exchange.fallback for _ in range(4)]
    assert kinds == ["", "", "budget: all 2 calls are made", "budget: all 2 calls are made"]
    assert len(server.asked) == 2


def test_questions_on_their_way_count_towards_the_budget() -> None:
    with serving(GOOD) as server:
        on = line(server, max_calls=3)
        pending = [on.ask(question(str(k))) for k in range(5)]
        answers = [one.answer() for one in pending]
    assert [answer.reply is not None for answer in answers] == [True, True, True, False, False]
    assert len(server.asked) == on.spent.calls == 3
    assert on.under_way == 0


def test_asking_again_exceeds_no_budget_either(monkeypatch: pytest.MonkeyPatch) -> None:
    with serving(replace(WRONG, late=0.05)) as server:
        on = line(server, max_calls=9)
        pending = [on.ask(question(str(k))) for k in range(8)]
        reasons = {one.answer().exchange.fallback.partition(":")[0] for one in pending}
        assert ask(on).reply is None
    assert len(server.asked) == on.spent.calls == 9
    assert reasons == {"invalid", "budget"}


def test_questions_on_their_way_count_towards_the_dollars_by_the_dearest_so_far(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(asking, "_cost", lambda response: 0.1)
    with serving(GOOD) as server:
        on = line(server, max_usd=0.35)
        ask(on)
        pending = [on.ask(question(str(k))) for k in range(8)]
        answered = [one.answer().reply is not None for one in pending]
    assert sum(answered) == 3
    assert on.spent.cost_usd == pytest.approx(0.4)


def test_the_budget_of_dollars_ends_the_asking(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(asking, "_cost", lambda response: 0.4)
    with serving(GOOD) as server:
        on = line(server, max_usd=1.0)
        kinds = [ask(on).exchange.fallback for _ in range(4)]
    assert kinds == ["", "", "", "budget: all 1 USD are spent"]
    assert on.spent.cost_usd == pytest.approx(1.2)


@pytest.mark.parametrize("model", ["wire", "http://127.0.0.1:1/v1"])
def test_a_budget_of_dollars_needs_a_price_before_anything_is_asked(model: str) -> None:
    name = "x" if "//" in model else ""
    with pytest.raises(
        ValueError, match=r"max_usd: expected a model whose price is known, got .*--max-calls"
    ):
        Asking(model=model, model_name=name, max_usd=1.0).line()


def test_a_price_that_turns_out_to_be_unknown_has_a_name_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(asking, "_has_price", lambda model: True)
    with serving(GOOD) as server:
        on = line(server, max_usd=1.0)
        ask(on)
        assert ask(on).exchange.fallback.startswith("unpriced: the price of scripted at")
        assert len(server.asked) == 1


def test_who_is_asked_where_prices_are_known_may_be_limited_in_dollars(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(asking.OFFLINE, raising=False)
    assert Asking(model="https://api.openai.com/v1", model_name="gpt-4o", max_usd=1.0).line() is not None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "model: expected which model to ask"),
        ({"model": "http://127.0.0.1:1/v1"}, "model_name: expected what"),
        ({"model": "openai:gpt-5", "model_name": "x"}, "model_name: expected only beside an address"),
        ({"model": "nonsense"}, "model: expected PROVIDER:NAME, an address or wire, got nonsense"),
        ({"model": "nobody:nothing"}, "model: expected one that can be asked, got nobody:nothing"),
        ({"timeout": 0.0}, "timeout: expected"),
        ({"latency": -1.0}, "latency: expected"),
        ({"max_calls": -1}, "max_calls: expected"),
        ({"max_calls": 1.5}, "max_calls: expected a whole number"),
        ({"max_usd": float("nan")}, "max_usd: expected"),
        ({"record": 3}, "record: expected a folder"),
    ],
)
def test_options_that_cannot_work_are_refused_by_name(
    options: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(asking.OFFLINE, raising=False)
    with pytest.raises(ValueError, match=message):
        Asking(**options).line()


@pytest.mark.parametrize(
    "model", ["openai:gpt-5", "anthropic:claude-sonnet-4-6", "google:gemini-3.5-flash-lite"]
)
def test_a_known_model_without_its_key_says_which_is_missing(
    model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(asking.OFFLINE, raising=False)
    for name in ("OPENAI_API_KEY", "ANTHROPIC_API_KEY", "GOOGLE_API_KEY", "GEMINI_API_KEY"):
        monkeypatch.delenv(name, raising=False)
    missing = {"openai": "OPENAI_API_KEY", "anthropic": "ANTHROPIC_API_KEY", "google": "GOOGLE_API_KEY"}
    key = missing[model.partition(":")[0]]
    with pytest.raises(ValueError, match="API_KEY") as told:
        Asking(model=model).line()
    said = f"model: expected a key in {key}, got none. Say export {key}=..., or try --model wire"
    assert str(told.value) == said


@pytest.mark.parametrize(
    ("model", "meant"),
    [
        ("wier", "wire"),
        ("wier:slow", "wire:slow"),
        ("gpt-5", "openai:gpt-5"),
        ("claude-sonnet-4-6", "anthropic:claude-sonnet-4-6"),
        ("gemini-3.5-flash-lite", "google:gemini-3.5-flash-lite"),
        ("opnai:gpt-5", "openai:gpt-5"),
        ("localhost:8000/v1", "http://localhost:8000/v1"),
    ],
)
def test_a_name_that_is_none_is_answered_with_what_it_may_have_meant(
    model: str, meant: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(asking.OFFLINE, raising=False)
    with pytest.raises(ValueError, match=r"model: expected .*") as told:
        Asking(model=model).line()
    assert str(told.value).endswith(f". Did you mean {meant}?")


@pytest.mark.parametrize("model", ["openai:gpt-5", "http://192.0.2.1:8000/v1", "http://example.org/v1"])
def test_offline_no_model_elsewhere_can_be_asked(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(asking.OFFLINE, "1")
    monkeypatch.setenv("OPENAI_API_KEY", SECRET)
    with pytest.raises(ValueError, match="expected one on this machine while DREAM_OFFLINE is set"):
        Asking(model=model, model_name="x" if "//" in model else "").line()


# ------------------------------------------------------------------------------------- kept and played again


def test_kept_exchanges_answer_without_a_model(tmp_path: Path) -> None:
    script = [GOOD, says('{"why": "then", "number": 4}'), WRONG, WRONG, error(500, retry_after="0")]
    with serving(*script) as server:
        on = line(server, record=str(tmp_path))
        first = [ask(on), ask(on), ask(on), ask(on, "And now?")]
        model = server.address
    played = Asking(model=model, model_name="scripted", replay_replies=str(tmp_path)).line()
    again = [ask(played), ask(played), ask(played), ask(played, "And now?")]
    assert [a.reply for a in again] == [a.reply for a in first]
    assert [a.reply.number if a.reply else None for a in again] == [3, 4, None, None]
    for one, other in zip(first, again, strict=True):
        for name in ("question", "replies", "fallback", "requests", "tokens_in", "seconds"):
            assert getattr(one.exchange, name) == getattr(other.exchange, name)
    pictures = sorted(path.read_bytes() for path in (tmp_path / "pictures").iterdir())
    assert pictures == [b"a picture", b"another"]


@pytest.mark.parametrize(
    "change",
    [
        lambda q: Question(q.prompt, "Count well.", q.text, q.pictures, q.reply),
        lambda q: Question(q.prompt, q.instructions, "How few?", q.pictures, q.reply),
        lambda q: Question(q.prompt, q.instructions, q.text, {**q.pictures, "map": b"other"}, q.reply),
        lambda q: Question(q.prompt, q.instructions, q.text, dict(reversed(q.pictures.items())), q.reply),
    ],
)
def test_a_question_that_was_never_asked_has_no_kept_answer(
    change: Callable[[Question[Number]], Question[Number]], tmp_path: Path
) -> None:
    with serving(GOOD) as server:
        ask(line(server, record=str(tmp_path)))
        on = line(server, replay_replies=str(tmp_path))
    with pytest.raises(FileNotFoundError, match="expected a kept reply to this question"):
        on.ask(change(question())).answer()


def test_what_is_recorded_again_takes_the_place_of_what_was_kept(tmp_path: Path) -> None:
    other = says('{"why": "then", "number": 4}')
    with serving(GOOD, GOOD, other) as server:
        first, again = (line(server, record=str(tmp_path)) for _ in range(2))
        ask(first, "Here?")
        ask(first)
        assert ask(again).reply == Number(why="then", number=4)
        played = line(server, replay_replies=str(tmp_path))
    assert len(list(tmp_path.glob("*.json"))) == 2
    assert ask(played).reply == Number(why="then", number=4)
    assert ask(played, "Here?").reply == Number(why="so", number=3)


def test_an_old_exchange_does_not_answer_for_a_new_one_that_could_not_be_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, content: bytes) -> None:
        raise OSError(28, "No space left on device")

    with serving(GOOD, says('{"why": "then", "number": 4}')) as server:
        ask(line(server, record=str(tmp_path)))
        monkeypatch.setattr(cassette, "_replace", full)
        assert ask(line(server, record=str(tmp_path))).reply == Number(why="then", number=4)
        played = line(server, replay_replies=str(tmp_path))
    with pytest.raises(FileNotFoundError, match="expected a kept reply to this question"):
        ask(played)


def test_a_damaged_exchange_is_refused(tmp_path: Path) -> None:
    with serving(GOOD) as server:
        ask(line(server, record=str(tmp_path)))
        on = line(server, replay_replies=str(tmp_path))
    (path,) = tmp_path.glob("*.json")
    path.write_text(path.read_text().replace('"requests": 1', '"requests": -1'))
    with pytest.raises(ValueError, match=r"\.json: expected a kept exchange"):
        ask(on)


def test_no_key_is_in_what_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(asking.KEY, SECRET)
    with serving(GOOD, error(500, retry_after="0")) as server:
        on = line(server, record=str(tmp_path))
        ask(on)
        ask(on, "Another?")
        assert server.asked[0].key == f"Bearer {SECRET}"
    for path in tmp_path.rglob("*"):
        assert path.is_dir() or SECRET.encode() not in path.read_bytes()
