"""Where no answer comes there is a reason in a line, and the operator is told what to look at."""

from __future__ import annotations

import gzip
import json
import random
from dataclasses import replace
from typing import Any

import pytest

from dream.planning.vlm.asking.scrubbing import KEY
from tests.model_server import SECRET, Request, Response, error, says, serving
from tests.planning.vlm.asking.counting import BLIND, GOOD, SO, WRONG, ask, line


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
    monkeypatch.setenv(KEY, SECRET)
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
