"""No key is told or kept, and no server gets what is meant for another."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from dream.planning.vlm.asking import scrubbing, server_words
from dream.planning.vlm.asking.scrubbing import KEY
from tests.model_server import SECRET, Response, error, says, serving
from tests.planning.vlm.asking.counting import GOOD, SO, Number, ask, body, line


def test_who_the_server_says_answered_is_kept_in_one_line_and_without_a_key(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(KEY, SECRET)
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


def test_a_key_that_a_server_repeats_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(KEY, SECRET)
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
    monkeypatch.setenv(KEY, key + "-1")
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


def test_only_the_key_for_such_servers_is_sent_to_an_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", SECRET)
    with serving(GOOD) as server:
        ask(line(server))
        monkeypatch.setenv(KEY, "mine")
        ask(line(server))
    assert [request.key for request in server.asked] == ["Bearer none", "Bearer mine"]


def test_no_key_is_in_what_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(KEY, SECRET)
    with serving(GOOD, error(500, retry_after="0")) as server:
        on = line(server, record=str(tmp_path))
        ask(on)
        ask(on, "Another?")
        assert server.asked[0].key == f"Bearer {SECRET}"
    for path in tmp_path.rglob("*"):
        assert path.is_dir() or SECRET.encode() not in path.read_bytes()


def test_what_a_server_finds_wrong_with_a_request_is_told_in_one_short_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(KEY, "secret words")
    said = f"At most 1 image(s)\x1b[31m may be\nprovided, secret words or {SECRET}. " + 400 * "x "
    for sent in ({"error": {"message": said}}, {"message": said}, {"detail": said}, {"error": said}):
        with serving(Response(json.dumps(sent).encode(), 422)) as server:
            on = line(server)
            answer = ask(on)
            fallback = answer.exchange.fallback
            with pytest.raises(ValueError, match=r"got rejected.* Does the model take pictures"):
                on.insist(answer)
        told = r"rejected: HTTP 422: At most 1 image(s)\x1b[31m may be provided, [key] or ... x x "
        assert fallback.startswith(told)
        assert len(fallback) < 250
        assert SECRET not in fallback


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


@pytest.mark.parametrize(
    ("length", "hidden"), [(scrubbing.LEAST_KEY - 1, False), (scrubbing.LEAST_KEY, True)]
)
def test_a_word_too_short_for_a_key_stays(
    length: int, monkeypatch: pytest.MonkeyPatch, *, hidden: bool
) -> None:
    secret = "abcdefghijk"[:length]
    monkeypatch.setenv("SOME_KEY", f" {secret}\n")
    monkeypatch.setenv("SOME_OTHER", "not a key at all")
    told = scrubbing.plain(f"<{secret}> not a key at all")
    assert told == ("<[key]> not a key at all" if hidden else f"<{secret}> not a key at all")


def test_a_long_word_with_digits_in_it_is_told_of_no_server() -> None:
    line = scrubbing.wary_line("a1b2c3d4e5f6g7h8 a1b2c3d4e5f6g7h abcdefghijklmnopq \x1b[31m", 60)
    assert line == r"... a1b2c3d4e5f6g7h abcdefghijklmnopq \x1b[31m"
    assert scrubbing.plain_line("one\ntwo", 5) == "one t"


@pytest.mark.parametrize(
    ("header", "passes"),
    [
        ("Authorization", True),
        ("User-Agent", True),
        ("X-Stainless-Lang", True),
        ("OpenAI-Organization", False),
        ("X-Api-Key", False),
        ("Cookie", False),
    ],
)
def test_a_server_at_an_address_gets_the_clients_own_headers(header: str, *, passes: bool) -> None:
    assert scrubbing.is_passed_on(header) == passes
