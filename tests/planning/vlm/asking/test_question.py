"""A question is known by all that its answer may depend on, and says how long the answer may be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from pydantic import BaseModel, Field

from dream.planning.vlm.asking.question import BESIDE, THINKING, TOKEN, Question, RawAnswer
from tests.planning.vlm.asking.counting import question


class Other(BaseModel):
    number: int


@pytest.mark.parametrize(
    "change",
    [
        {"instructions": "Count well."},
        {"text": "How few?"},
        {"pictures": {"map": b"a picture"}},
        {"pictures": {"map": b"another", "camera": b"a picture"}},
        {"pictures": {"camera": b"another", "map": b"a picture"}},
        {"reply": Other},
    ],
    ids=str,
)
def test_another_question_has_another_key(change: dict[str, Any]) -> None:
    asked = question()
    assert asked.key("one") == question().key("one")
    assert replace(asked, prompt="test 2").key("one") == asked.key("one")
    assert asked.key("one") != asked.key("two")
    assert replace(asked, **change).key("one") != asked.key("one")


def test_keys_are_those_of_folders_that_were_kept_before() -> None:
    asked = Question("test 1", "Count.", "How many?", {"map": b"a picture"}, Other)
    assert asked.key("scripted") == "ce2deb1ae6ce8fdbca783cde3a0b57e1"


def test_a_reply_may_be_as_long_as_its_fields() -> None:
    class Wordy(BaseModel):
        why: str = Field(max_length=600)
        how: str = Field(max_length=400)

    assert replace(question(), reply=Wordy).most_tokens == THINKING + BESIDE + 1000 // TOKEN
    assert replace(question(), reply=Other).most_tokens == THINKING + BESIDE


def test_pictures_are_named_in_the_text_where_they_stood() -> None:
    assert question().sent == "Count.\n\n[map]\n[camera]\n\nHow many?"


def test_time_is_kept_to_the_millisecond() -> None:
    assert RawAnswer(fallback="x", requests=2).lasting(1.23456) == RawAnswer((), "x", 2, seconds=1.235)
