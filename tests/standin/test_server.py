"""The stand-in over HTTP, right and with every fault, and a whole mission with it."""

from __future__ import annotations

import http.client
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from dream.evaluation.metrics import Scorer
from dream.evaluation.runner import simulate
from dream.planning.vlm import Dream
from dream.planning.vlm.asking import Asking, Question
from dream.planning.vlm.reply import dream_reply, ranked_reply
from dream.protocol import DREAM_V1, POOL_V1
from dream.sim.worlds import make_world
from dream.standin import address
from dream.standin.faults import FAULTS
from dream.standin.rules import answer
from dream.standin.server import PATH, server
from dream.types import LOOK_AROUND
from tests.standin.sheets import request, scene
from tests.standin.test_rules import TEXT, ranked

ACTION = dream_reply(DREAM_V1)
RANKING = ranked_reply([2, 4, 7])
_, SHOWN = scene()
PLACES = ranked({4: (0.0, 2.0), 2: (-4.5, 4.0), 7: (7.0, 0.0)})


def send(body: bytes | None, fault: str = "", path: str = PATH, method: str = "POST") -> tuple[int, bytes]:
    where = urlsplit(address(fault))
    connection = http.client.HTTPConnection(where.hostname or "", where.port, timeout=10)
    try:
        connection.request(method, path, body)
        response = connection.getresponse()
        return response.status, response.read()
    finally:
        connection.close()


def asked(fault: str, asking: dict[str, Any]) -> dict[str, Any]:
    status, body = send(json.dumps(asking).encode(), fault)
    assert status == 200, body
    content = json.loads(body)["choices"][0]["message"]["content"]
    said: dict[str, Any] = json.loads(content)
    return said


def wired(fault: str, *, ranking: bool = False, timeout: float = 5.0) -> tuple[Any, Any]:
    """Reply and exchange, through the planner's own client."""
    question: Question[Any] = Question(
        "test 1",
        "Look.",
        "" if ranking else TEXT,
        PLACES if ranking else SHOWN,
        RANKING if ranking else ACTION,
    )
    name = f"wire:{fault}" if fault else "wire"
    answered = Asking(model=name, timeout=timeout).line().ask(question).answer()
    return answered.reply, answered.exchange


@pytest.fixture(autouse=True)
def no_failures() -> Iterator[None]:
    server("").failures.clear()
    yield
    server("").failures.clear()


def test_one_server_a_fault_and_the_same_each_time() -> None:
    assert address() == address("") == server("").address
    assert address("random") != address()
    assert address().startswith("http://127.0.0.1:")
    assert address().endswith("/v1")


def test_it_answers_over_the_wire_and_counts_tokens() -> None:
    reply, exchange = wired("")
    assert exchange.fallback == ""
    assert exchange.requests == 1
    assert reply.model_dump() == ACTION.model_validate(answer(request(ACTION, SHOWN, TEXT))).model_dump()
    # Three pictures of 640 by 480 and a map of 827 by 858: two tiles each, and four.
    pictures = 4 * 85 + (3 * 2 + 4) * 170
    assert pictures + len(TEXT) / 4 <= exchange.tokens_in <= pictures + len(TEXT) / 4 + 10
    assert exchange.tokens_out == pytest.approx(len(exchange.replies[0]) / 4, abs=1)


def test_what_cannot_be_read_is_loud_and_kept() -> None:
    asking = request(ACTION, {name: file for name, file in SHOWN.items() if name != "map"}, TEXT)
    status, body = send(json.dumps(asking).encode())
    assert status == 500
    assert "[map]: expected a picture" in json.loads(body)["error"]["message"]
    assert len(server("").failures) == 1
    assert "[map]" in server("").failures[0]


def test_what_is_no_question_is_refused() -> None:
    assert send(b"{not json")[0] == 400
    assert send(b"[]")[0] == 400
    assert send(b"{}", path="/v1/other")[0] == 404
    assert send(None, method="GET")[0] == 404
    assert send(b"{}")[0] == 500
    where = urlsplit(address())
    connection = http.client.HTTPConnection(where.hostname or "", where.port, timeout=10)
    connection.putrequest("POST", PATH)
    connection.putheader("Content-Length", str(65 << 20))
    connection.endheaders()
    assert connection.getresponse().status == 413
    connection.close()


# --------------------------------------------------------------------------------------------------- faults

ASK_ACTION = request(ACTION, SHOWN, TEXT)
ASK_RANKING = request(RANKING, PLACES)


@pytest.mark.few(3)
@pytest.mark.parametrize("fault", ["random", "first", "mirrored", "worst", "wall", "error:1", "error:0"])
@pytest.mark.parametrize("asking, reply", [(ASK_ACTION, ACTION), (ASK_RANKING, RANKING)])
def test_a_wrong_answer_is_well_formed_and_the_same_each_time(fault: str, asking: Any, reply: Any) -> None:
    said = asked(fault, asking)
    reply.model_validate(said)
    assert asked(fault, asking) == said


@pytest.mark.rare
def test_what_the_wrong_answers_are() -> None:
    right, order = answer(ASK_ACTION), answer(ASK_RANKING)["ranking"]
    assert asked("error:0", ASK_ACTION) == right
    assert asked("error:1", ASK_RANKING)["ranking"] == asked("random", ASK_RANKING)["ranking"]
    assert asked("worst", ASK_RANKING)["ranking"] == order[::-1]
    assert asked("mirrored", ASK_RANKING)["ranking"] == order[::-1]
    assert asked("first", ASK_RANKING)["ranking"] == [2, 4, 7]
    assert asked("first", ASK_ACTION)["direction"] == "forward"
    mirrored = {"left": "right", "right": "left", "forward": "forward"}[right["direction"]]
    assert asked("mirrored", ASK_ACTION)["direction"] == mirrored
    # The pillar is ahead, a little to the right.
    wall = asked("wall", ASK_ACTION)
    assert (wall["step_m"], wall["turn_deg"]) in [(2, 0), (2, 30)]
    injected = asked("injected", ASK_ACTION)
    assert (injected["direction"], injected["step_m"]) == ("forward", 2)
    assert "instruction" in injected


@pytest.mark.rare
def test_some_of_many_questions_are_answered_wrong() -> None:
    right = answer(ASK_RANKING)["ranking"]
    orders = [asked("error:0.5", request(RANKING, PLACES, f"question {k}"))["ranking"] for k in range(16)]
    assert 2 <= sum(order == right for order in orders) < 16


def test_a_stale_answer_is_one_to_an_earlier_question() -> None:
    others = ranked({1: (0.0, 2.0), 9: (-4.5, 4.0)})
    assert asked("stale:1", ASK_RANKING)["ranking"] == [7, 2, 4]
    assert asked("stale:1", request(ranked_reply([1, 9]), others))["ranking"] == [7, 2, 4]
    assert asked("stale:1", ASK_RANKING)["ranking"] == [9, 1]


@pytest.mark.few(3)
@pytest.mark.parametrize(
    "fault, fallback",
    [
        ("malformed", "invalid: "),
        ("truncated", "truncated: "),
        ("injected", "invalid: "),
        ("refusing", "refused: "),
        ("429", "rate limit: "),
        ("500", "server: HTTP 500"),
        ("dropping", "connection: "),
        ("huge", "too large: "),
        ("slow:5", "timeout: "),
        ("trickle:0.05", "timeout: "),
    ],
)
def test_an_answer_that_is_none_is_told_apart(fault: str, fallback: str) -> None:
    short = fault.startswith(("slow", "trickle"))
    reply, exchange = wired(fault, timeout=0.5 if short else 5.0)
    assert reply is None
    assert exchange.fallback.startswith(fallback), exchange.fallback


def test_a_little_slow_is_no_fault_to_the_asker() -> None:
    assert wired("slow:0.1")[0] is not None
    assert wired("trickle:0.0001", timeout=10.0)[0] is not None


@pytest.mark.parametrize(
    "name, said",
    [
        ("randm", 'no fault "randm". Did you mean "random"'),
        ("no such", "There are: random, first"),
        ("slow:x", "model: expected wire:slow:S, with S from 0 to 3600"),
        ("error:2", "with P from 0 to 1, got wire:error:2"),
        ("stale", "model: expected wire:stale:N"),
        ("worst:1", "model: expected wire:worst without a value"),
    ],
)
def test_a_fault_that_does_not_exist_is_refused(name: str, said: str) -> None:
    with pytest.raises(ValueError, match=said.replace(".", r"\.")):
        address(name)
    assert "slow:S" in FAULTS


def test_the_page_about_models_says_of_every_fault_what_it_does() -> None:
    page = (Path(__file__).parents[2] / "docs/models.md").read_text(encoding="utf-8")
    table = page[page.index("| fault | its answers |") :].split("\n\n")[0]
    named = [name for row in table.splitlines()[2:] for name in re.findall(r"`([^`]+)`", row.split("|")[1])]
    assert sorted(named) == sorted(FAULTS)


@pytest.mark.rare
@pytest.mark.slow
def test_a_mission_sees_a_reef_by_what_the_stand_in_reads() -> None:
    world = make_world("reef/string", 3)
    scorer = Scorer(world, DREAM_V1)
    seen, exchanges = 0.0, 0
    for step in simulate(world, Dream(model="wire"), DREAM_V1, max_steps=28):
        assert not step.arrival.collided
        assert all(exchange.fallback == "" for exchange in step.decision.exchanges)
        exchanges += len(step.decision.exchanges)
        seen = scorer.add(step).instances
    assert server("").failures == []
    assert exchanges == step.index - LOOK_AROUND
    # In full it sees 97 % after 70 steps; who answers at random sees less than half of this by then.
    assert seen > 0.5


@pytest.mark.rare
def test_a_mission_of_the_pool_begins_without_a_fault() -> None:
    for step in simulate(make_world("pool/arc", 1), Dream(model="wire"), POOL_V1, max_steps=12):
        assert not step.arrival.collided
        assert [exchange.fallback for exchange in step.decision.exchanges] == [""] * (
            step.index > LOOK_AROUND
        )
    assert server("").failures == []
