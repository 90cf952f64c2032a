"""Kept exchanges answer again without a model, and an old one never for a new one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dream.planning.vlm.asking import Asking, Question, cassette
from tests.model_server import error, says, serving
from tests.planning.vlm.asking.counting import GOOD, SO, WRONG, Number, ask, line, question


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


def test_a_reply_as_it_came_is_kept_and_answers_again_without_a_model(tmp_path: Any) -> None:
    thought = f"First two,\nthen one more. </think> {SO} So much for that."
    with serving(says(thought)) as server:
        first = ask(line(server, record=str(tmp_path)))
        again = ask(line(server, replay_replies=str(tmp_path)))
        assert len(server.asked) == 1
    assert first.exchange.replies == again.exchange.replies == (thought,)
    assert first.reply == again.reply == Number(why="so", number=3)
