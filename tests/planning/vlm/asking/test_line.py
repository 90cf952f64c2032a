"""A line to a model: it answers every question, and says where there is no point in asking."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from dream.planning.vlm.asking import Asking
from dream.types import Asked
from tests.model_server import Response, error, serving
from tests.planning.vlm.asking.counting import GOOD, Number, ask, line


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
