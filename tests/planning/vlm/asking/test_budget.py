"""No more is spent than may be, whatever is on its way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pydantic_ai.exceptions import UsageLimitExceeded

from dream.planning.vlm.asking import Asking, responses
from dream.planning.vlm.asking.budget import AskingBudget
from dream.planning.vlm.asking.provider import OFFLINE
from dream.types import Asked
from tests.model_server import serving
from tests.planning.vlm.asking.counting import GOOD, WRONG, ask, line, question


def test_the_budget_holds_when_replies_are_played_again(tmp_path: Path) -> None:
    with serving(GOOD) as server:
        on = line(server, max_calls=2, record=str(tmp_path))
        first = [ask(on, str(k)).exchange.fallback for k in range(4)]
        options: dict[str, Any] = {"model": server.address, "model_name": "scripted", "max_calls": 2}
    played = Asking(**options, replay_replies=str(tmp_path)).line()
    assert [ask(played, str(k)).exchange.fallback for k in range(4)] == first


def test_the_budget_of_calls_ends_the_asking() -> None:
    with serving(GOOD) as server:
        on = line(server, max_calls=2)
        kinds = [ask(on).exchange.fallback for _ in range(4)]
    assert kinds == ["", "", "budget: all 2 calls are made", "budget: all 2 calls are made"]
    assert len(server.asked) == 2


def test_the_budget_of_dollars_ends_the_asking(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(responses, "cost_usd", lambda response: 0.4)
    with serving(GOOD) as server:
        on = line(server, max_usd=1.0)
        kinds = [ask(on).exchange.fallback for _ in range(4)]
    assert kinds == ["", "", "", "budget: all 1 USD are spent"]
    assert on.budget.spent.cost_usd == pytest.approx(1.2)


def test_a_call_that_is_left_over_is_not_exceeded_by_asking_again() -> None:
    with serving(WRONG, GOOD) as server:
        answer = ask(line(server, max_calls=1))
    assert len(server.asked) == 1
    assert answer.exchange.fallback == "budget: no call is left to ask again"


def test_questions_on_their_way_count_towards_the_budget() -> None:
    with serving(GOOD) as server:
        on = line(server, max_calls=3)
        pending = [on.ask(question(str(k))) for k in range(5)]
        answers = [one.answer() for one in pending]
    assert [answer.reply is not None for answer in answers] == [True, True, True, False, False]
    assert len(server.asked) == on.budget.spent.calls == 3
    assert on.budget.under_way == 0


def test_questions_on_their_way_count_towards_the_dollars_by_the_dearest_so_far(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(responses, "cost_usd", lambda response: 0.1)
    with serving(GOOD) as server:
        on = line(server, max_usd=0.35)
        ask(on)
        pending = [on.ask(question(str(k))) for k in range(8)]
        answered = [one.answer().reply is not None for one in pending]
    assert sum(answered) == 3
    assert on.budget.spent.cost_usd == pytest.approx(0.4)


def test_asking_again_exceeds_no_budget_either(monkeypatch: pytest.MonkeyPatch) -> None:
    with serving(replace(WRONG, late=0.05)) as server:
        on = line(server, max_calls=9)
        pending = [on.ask(question(str(k))) for k in range(8)]
        reasons = {one.answer().exchange.fallback.partition(":")[0] for one in pending}
        assert ask(on).reply is None
    assert len(server.asked) == on.budget.spent.calls == 9
    assert reasons == {"invalid", "budget"}


@pytest.mark.parametrize("model", ["wire", "http://127.0.0.1:1/v1"])
def test_a_budget_of_dollars_needs_a_price_before_anything_is_asked(model: str) -> None:
    name = "x" if "//" in model else ""
    with pytest.raises(
        ValueError, match=r"max_usd: expected a model whose price is known, got .*--max-calls"
    ):
        Asking(model=model, model_name=name, max_usd=1.0).line()


def test_a_price_that_turns_out_to_be_unknown_has_a_name_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(responses, "has_price", lambda model: True)
    with serving(GOOD) as server:
        on = line(server, max_usd=1.0)
        ask(on)
        assert ask(on).exchange.fallback.startswith("unpriced: the price of scripted at")
        assert len(server.asked) == 1


def test_who_is_asked_where_prices_are_known_may_be_limited_in_dollars(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(OFFLINE, raising=False)
    assert Asking(model="https://api.openai.com/v1", model_name="gpt-4o", max_usd=1.0).line() is not None


def test_requests_that_were_kept_and_those_of_earlier_legs_count_too() -> None:
    budget = AskingBudget(max_calls=5, spent=Asked(calls=2))
    budget.count_played(2)
    budget.count_request()
    with pytest.raises(UsageLimitExceeded):
        budget.count_request()


def test_who_may_not_spend_anything_asks_nothing_and_who_has_no_limit_asks_on() -> None:
    assert AskingBudget(max_calls=0).exhausted() == "budget: all 0 calls are made"
    assert AskingBudget(max_usd=0.0).exhausted() == "budget: all 0 USD are spent"
    assert AskingBudget(spent=Asked(calls=10**6, cost_usd=None)).exhausted() == ""


def test_what_is_under_way_never_makes_room_in_a_budget_that_is_spent() -> None:
    budget = AskingBudget(None, 1.0, "a model", spent=Asked(calls=3, cost_usd=1.0))
    assert budget.exhausted() == "budget: all 1 USD are spent"
    budget.under_way = 2
    assert budget.exhausted() == "budget: all 1 USD are spent"
